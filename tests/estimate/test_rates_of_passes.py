"""`rates` from end to end on simulated passes: the truth lies where the sigmas say, and no result hangs on workers."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import xarray as xr

import sunspin as ss
from sunspin.base.errors import InputError, SunspinError
from sunspin.estimate.rates import rates
from sunspin.estimate.settings import RATES
from sunspin.output.kinds.rates import rates_summary
from sunspin.output.template import write_templates
from tests.support.passes import errors_in_sigmas, judged
from tests.support.schemas import schema, stored_schema
from tests.support.simulate import CUBE_WITHOUT_NOISE_STATED, pulls, simulated_pass, uneven_times
from validation.passes import FACES, MOMENTS, spin
from validation.passes import observe as observe_passes


@cache
def two_passes():
    """Return vehicle, telemetry of two passes an hour apart, and the true rates; they are shared and never changed."""
    rng = np.random.default_rng(3)
    runs, data = [], []
    for begin, omega in ((0.0, [0.02, -0.03, 0.04]), (3600.0, [0.021, -0.029, 0.04])):
        t_s = uneven_times(rng, 20, 15.0, 0.2)
        seen, run = simulated_pass(CUBE_WITHOUT_NOISE_STATED, omega, t_s, rng, albedo=0.0)
        data.append(seen.assign_coords(time=seen["time"] + begin))
        runs.append(run.assign_coords(time=run["time"] + begin))
    telemetry = xr.concat(data, "time", data_vars="minimal", combine_attrs="override")
    return CUBE_WITHOUT_NOISE_STATED, telemetry, xr.concat(runs, "time", data_vars="minimal")


def test_two_passes_cover_the_truth_whatever_the_workers():
    vehicle, telemetry, run = two_passes()
    alone, together = (
        rates(vehicle, telemetry, max_rate_rad_s=0.15, workers=workers) for workers in (1, 2)
    )
    xr.testing.assert_allclose(alone, together, rtol=1e-9, atol=1e-9)
    assert alone["decided"].values.all() and alone["fits"].values.all()
    pull = pulls(alone, run)
    assert np.abs(pull).max() < 5 and np.sqrt((pull**2).mean()) < 2


def test_a_bar_of_passes_is_shown_if_progress_is_asked_for(capsys):
    vehicle, telemetry, _ = two_passes()
    rates(vehicle, telemetry, max_rate_rad_s=0.15, effort=1e-6, workers=1)
    assert "rates:" not in capsys.readouterr().err
    rates(vehicle, telemetry, max_rate_rad_s=0.15, effort=1e-6, workers=1, progress=True)
    shown = re.findall(r"rates: .* (\d)/2 ", capsys.readouterr().err.replace("\r", "\n"))
    assert shown[0] == "0" and shown[-1] in "12"


def test_one_pass_a_strength_of_torques_and_settings_can_be_asked_for():
    vehicle, telemetry, _ = two_passes()
    windows: list[slice] = []
    watch = replace(RATES.search, watch=lambda window, motions: windows.append(window))
    asked = {"pass_id": 1, "acceleration_noise": 2e-4, "settings": replace(RATES, search=watch)}
    result = rates(vehicle, telemetry, max_rate_rad_s=0.15, **asked)
    assert windows[-1] == slice(0, 20)
    assert result.attrs["acceleration_noise"] == 2e-4
    assert result.attrs["acceleration_noise_from"] == "given"
    assert result["pass_id"].values.tolist() == [1] and result["time"].values.min() >= 3600
    assert (result["why"].values[:20] == "dropped: in another pass than the one asked for").all()
    with pytest.raises(InputError, match="there is no such pass"):
        rates(vehicle, telemetry, pass_id=2)


def test_simulated_passes_are_not_decided_and_wrong():
    """A body that oscillates between samples."""
    _, row = judged("jitter", 0, 0)
    assert row["listed"] and not (row["decided"] and row["wrong"])


def test_a_step_of_the_rate_is_named_and_its_pass_decided():
    result, row = judged("step of the rate", 0, 9)
    assert "step of the rate" in str(result["model"].values[0])
    assert row["decided"] and row["pull"] < 3


@pytest.mark.parametrize(
    ("options", "words"),
    [
        *(({"max_rate_rad_s": bad}, "max_rate_rad_s must be positive") for bad in (-1.0, np.nan)),
        *(
            ({"acceleration_noise": bad}, "acceleration_noise must lie between")
            for bad in (-1.0, 0.0, 1e-30, 3.0, np.nan)
        ),
        ({"source": "sun_sensor"}, "no Sun from sun_sensor"),
        ({"source": "stars"}, "no Sun from stars"),
        *(
            ({"effort": bad}, "effort must be a positive number")
            for bad in (0, -1, np.nan, True, "ten", None)
        ),
        ({"gap_s": 1e-3}, "no pass has three samples"),
    ],
)
def test_options_out_of_range_are_refused(options, words):
    vehicle, telemetry, _ = two_passes()
    with pytest.raises(InputError, match=words):
        rates(vehicle, telemetry, **options)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda data: data.isel(time=slice(0, 2)), "fewer than three samples"),
        (lambda data: data.drop_vars("power_W"), "no Sun from panels or Sun sensors"),
        (lambda data: data.assign(power_W=0 * data["power_W"]), "fewer than three samples"),
    ],
)
def test_telemetry_without_rates_is_refused(change, words):
    vehicle, telemetry, _ = two_passes()
    with pytest.raises(SunspinError, match=words):
        rates(vehicle, change(telemetry))


@pytest.mark.parametrize("frame", ["body axes", "axes fixed in space"])
def test_an_unmodelled_torque_is_named_and_the_rates_are_right(frame):
    torque = 1e-4 * np.array([1.0, -0.5, 0.5])  # rad/s2 over the mean moment

    def push(_, attitude):
        return (torque if frame == "body axes" else attitude @ torque) * MOMENTS.mean() / MOMENTS

    t_s = np.arange(0.0, 300.0, 10.0)
    omega, attitude = spin(np.radians([2.0, -1.0, 1.5]), t_s, push)
    seen = observe_passes(FACES, omega, attitude, t_s, 0.01, np.random.default_rng(3))
    result = rates(seen.vehicle, seen.telemetry, max_rate_rad_s=0.15)
    assert result["model"].values[0] == f"a steady torque in {frame}"
    truth = omega[np.isin(t_s, result["time"].values)]
    assert np.abs(errors_in_sigmas(result, truth)).max() < 4.5


def test_result_of_rates_has_the_stored_schema(tmp_path):
    vehicle, telemetry = write_templates(tmp_path)
    craft = ss.load_vehicle(vehicle)
    result = ss.rates(craft, ss.read_telemetry(telemetry, craft).isel(time=slice(12)))
    assert schema(result) == stored_schema("rates")
    # an error of the readings that the program assumes is printed with its unit
    for unit, said in {"W": "0.02 W (median)", "": "0.02 (in the unit of the readings)"}.items():
        attrs = {"noise": 0.02, "noise_from": "assumed", "noise_unit": unit}
        assert any(said in line for line in rates_summary(result.assign_attrs(attrs)).lines)
    assert result.attrs["noise_unit"] == "W"
