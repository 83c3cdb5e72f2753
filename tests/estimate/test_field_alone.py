"""A magnetometer alone, without an orbit: rates relative to the field, and what stays unknown. All telemetry is synthetic."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.cli import cli
from sunspin.environment.frames import FIELD_Z_LOCAL
from sunspin.estimate.rates.observe import observations, usable
from sunspin.estimate.terms.field_direction import FieldDirection, TurningAxes
from sunspin.estimate.terms.magnetometer import TURN_RATE
from sunspin.telemetry.synthetic import telemetry_dataset
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from sunspin.vehicle.sensors import Disturbance, Magnetometer, Sensors

PART = Magnetometer(("x", "y", "z"), np.zeros(3), 400.0, zero_sigma=np.full(3, 300.0))
CUBE = Vehicle(
    "cube",
    np.diag([0.02, 0.028, 0.012]),
    panels=(Panel("+X", [1, 0, 0], 1.0),),
    gain_unit="W",
    telemetry=TelemetryForm(noise=0.01),
    sensors=Sensors(
        magnetometer=PART, disturbance=Disturbance(acceleration_noise=2e-5, max_rate_rad_s=0.05)
    ),
)


def telemetry(seed: int, samples: int = 24):
    """A body that turns without torques in a field that turns by 0.1 deg/s, and its rates."""
    rng = np.random.default_rng(seed)
    t = 15.0 * np.arange(samples)
    omega = np.radians(1.5) * rng.normal(size=3)
    run = ss.propagate(CUBE, omega, [0.6, 0.0, 0.8], None, t)
    axis = rng.normal(size=3)
    field = 3e4 * Rotation.from_rotvec(1.7e-3 * t[:, None] * axis / np.linalg.norm(axis)).apply(
        [0.2, 0.5, -0.8]
    )
    read = Rotation.from_quat(run["B_from_N"].values).apply(field) + 400 * rng.normal(
        size=field.shape
    )
    data = telemetry_dataset(
        CUBE, t, np.ones((samples, 1)), run["sun_B"].values, "2026-01-01T00:00:00Z", {}
    )
    return data.assign(field_B=(("time", "axis"), read)).drop_vars(["power_W", "panel"]), run[
        "omega_B"
    ].values


def test_a_magnetometer_with_stated_noise_replaces_the_sun_direction():
    data, _ = telemetry(1)
    o, why, source = observations(CUBE, data)
    assert source == "field" and [type(term) for term in o.terms] == [FieldDirection, TurningAxes]
    assert (
        len(usable(o, why)) == len(data["time"])
        and np.ptp(np.linalg.norm(o.terms[0].direction_B, axis=1)) < 1e-12
    )
    sigma = np.sqrt(np.trace(o.terms[0].covariance[0]) / 3)
    assert (
        450 / 3.1e4 < sigma < 550 / 2.6e4
        and o.terms[1].hidden_variance(np.ones(3)) == TURN_RATE**2 / 3
    )
    blunt = replace(CUBE, sensors=replace(CUBE.sensors, magnetometer=replace(PART, noise=None)))
    with pytest.raises(
        ss.InputError,
        match=r"a magnetometer alone needs its `noise` in the vehicle file, or an orbit",
    ):
        observations(blunt, data)


@pytest.mark.evidence("rates", "modelled", "a simulated magnetometer alone, without an orbit")
@pytest.mark.long
def test_rates_from_the_field_alone_are_right_and_name_what_is_unknown(tmp_path):
    pulls = []
    for seed in (1, 2, 3):
        data, omega = telemetry(seed)
        found = ss.rates(CUBE, data)
        at = int(np.argmin(np.abs(data["time"].values - data["time"].values.mean())))
        best, sigma = (
            np.array([found[f"{name}_{axis}"].values[0, 0] for axis in "xyz"])
            for name in ("omega", "sigma")
        )
        pulls.append((best - omega[at]) / sigma)
        assert np.all(sigma > TURN_RATE / np.sqrt(3)) and found.attrs["frame_N"] == FIELD_Z_LOCAL
        assert (
            np.isnan(found["sun_B"].values).all()
            and np.isfinite(found["field_direction_B"].values).all()
        )
        assert "NO ORBIT" in found.attrs["verdict"]
    assert np.abs(pulls).max() < 4
    found.sunspin.save(tmp_path / "out")
    done = CliRunner().invoke(cli, ["report", str(tmp_path / "out")], catch_exceptions=False)
    assert done.exit_code == 0
    (page,) = (tmp_path / "out").glob("*.html")
    assert "could not be made" not in page.read_text("utf-8")
