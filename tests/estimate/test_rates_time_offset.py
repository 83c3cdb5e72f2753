"""Time offset of sensors, zero and scale of a gyro as unknowns of the rates. All telemetry is synthetic."""

import numpy as np
import pytest

import sunspin as ss
from sunspin.vehicle.file import parse_vehicle
from sunspin.vehicle.sensors import Clock
from tests.support.simulate import cube_with_late_sensor, cube_with_sensor


@pytest.mark.evidence(
    "rates", "modelled", "simulated gyros and quaternions with and without a time offset"
)
@pytest.mark.parametrize(
    ("kind", "seed", "late"),
    [
        pytest.param("attitude", 102, -4.0, marks=pytest.mark.long),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                ("gyro", 101, 5.0),
                ("gyro", 102, -4.0),
                ("gyro", 101, 0.0),
                ("attitude", 101, 5.0),
                ("attitude", 101, 0.0),
            )
        ),
    ],
)
def test_a_time_offset_is_estimated_within_its_sigma(kind, seed, late, reached):
    data, run = cube_with_late_sensor(kind, late, np.random.default_rng(seed))
    result = ss.rates(cube_with_sensor(kind, Clock(0.0, 5.0)), data, max_rate_rad_s=0.15)
    found, sigma = result.attrs["sensors_late_s"], result.attrs["sensors_late_sigma_s"]
    assert abs(found - late) < 3.5 * sigma and sigma < 1.5
    assert "late (vehicle file and data)" in result.attrs["verdict"]
    truth = run["omega_B"].sel(time=result["time"]).values
    assert np.abs(result["omega_mean_B"].values[0, 0] - truth.mean(axis=0)).max() < np.radians(0.1)
    reached(f"lateness found where it was {late} s", found, "s")


@pytest.mark.long
@pytest.mark.parametrize("kind", ["gyro", pytest.param("attitude", marks=pytest.mark.slow)])
def test_sensors_without_a_time_offset_get_no_warning(kind):
    prompt, _ = cube_with_late_sensor(kind, 0.0, np.random.default_rng(101))
    silent = ss.rates(cube_with_sensor(kind, None), prompt, max_rate_rad_s=0.15).attrs
    assert "late" not in silent["verdict"].lower() and np.isnan(silent["sensors_late_s"])


def test_the_time_offset_of_a_vehicle_file_is_read():
    text = 'name = "a"\n[clock]\nsensors_late_s = { value = 1.5, sigma = 2.0, source = "guess" }\n'
    assert parse_vehicle(text, "a").sensors.clock == Clock(1.5, 2.0)
    with pytest.raises(ss.SunspinError, match="sigma of clock.sensors_late_s"):
        parse_vehicle(text.replace("2.0", "-2.0"), "a")


@pytest.mark.long
@pytest.mark.evidence(
    "rates",
    "modelled",
    "a simulated gyro with reversed axes and no time offset",
)
def test_a_gyro_with_reversed_axes_gets_no_warning_on_a_time_offset():
    telemetry, _ = cube_with_late_sensor("gyro", 0.0, np.random.default_rng(0))
    result = ss.rates(cube_with_sensor("gyro", None), telemetry.assign(gyro_B=-telemetry["gyro_B"]))
    assert "LATE" not in result.attrs["verdict"] and np.isnan(result.attrs["sensors_late_s"])
    assert "the gyro read as (-x, -y, -z)" in result.attrs["verdict"]
