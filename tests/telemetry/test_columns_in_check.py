"""`check` names the exchanged columns and reversed panels that the samples do not show."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.output.check.samples import describe_samples, describe_unseen_columns
from sunspin.telemetry.assess import assess
from sunspin.vehicle import Panel, TelemetryForm, Vehicle

NORMALS = np.vstack([np.eye(3), -np.eye(3)])
BOX = Vehicle(
    "box",
    gain_unit="W",
    inertia_kg_m2=np.diag([0.04, 0.05, 0.01]),
    panels=[Panel(name, n, 2.0) for name, n in zip("abcdef", NORMALS, strict=True)],
    telemetry=TelemetryForm(noise=0.02),
)


def looked_at(vehicle: Vehicle, **sensors: np.ndarray):
    """Return the assessment of 30 noisy samples of a body that rotates about an oblique axis; `sensors`: variables (n, 3)."""
    t, rng = 20.0 * np.arange(30), np.random.default_rng(3)
    sun = Rotation.from_rotvec(0.03 * t[:, None] * [0.6, 0.3, 0.74]).apply([0.3, -0.7, 0.65])
    power = ss.panel_power(vehicle, sun) + 0.02 * rng.normal(size=(30, len(vehicle.panels)))
    variables = {name: (("time", "axis"), value) for name, value in sensors.items()}
    variables |= {"power_W": (("time", "panel"), power), "flag": ("time", np.zeros(30, np.uint8))}
    coords = {"time": t, "panel": list(vehicle.panel_names), "axis": list("xyz")}
    attrs = {"unused_columns": "", "missing_sensors": "", "epoch_utc": "2026-01-01T00:00:00Z"}
    return assess(vehicle, xr.Dataset(variables, coords, attrs))


def test_check_names_each_pair_of_opposite_columns_of_a_box() -> None:
    found = describe_unseen_columns(looked_at(BOX))
    pairs = [f"the columns of panels {a} and {b} exchanged" for a, b in ("ad", "be", "cf")]
    assert found.summary["columns_unseen"] == pairs
    assert all(pair in found.lines[0] for pair in pairs)


def test_check_names_no_columns_that_other_sensors_or_a_missing_symmetry_show() -> None:
    measured_rates = np.tile([0.018, 0.009, 0.022], (30, 1))
    with_gyro = looked_at(BOX, gyro_B=measured_rates)
    assert describe_unseen_columns(with_gyro).lines == []


def test_check_is_silent_about_columns_in_a_wrong_unit() -> None:
    assert "columns_unseen" not in describe_samples(looked_at(BOX), misread=True).summary


@pytest.mark.parametrize("speed", [0.0, 300.0])
def test_a_wheel_that_runs_leaves_only_exchanges_along_which_it_does_not_show(speed: float) -> None:
    wheel = ss.Wheel("w", [0, 0, 1], 1e-4, speed)
    changes = describe_unseen_columns(looked_at(replace(BOX, wheels=(wheel,)))).summary
    assert ("the columns of panels a and d exchanged" in changes["columns_unseen"]) == (speed == 0)
