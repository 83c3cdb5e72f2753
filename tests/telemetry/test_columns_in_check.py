"""`check` names mistakes of columns that the samples do not show, and proposes a span for rows of one instant."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.output.check.samples import describe_samples, describe_unseen_columns
from sunspin.telemetry.assess import Assessment, assess
from sunspin.vehicle import Panel, TelemetryForm, Vehicle

NORMALS = np.vstack([np.eye(3), -np.eye(3)])
BOX = Vehicle(
    "box",
    gain_unit="W",
    inertia_kg_m2=np.diag([0.04, 0.05, 0.01]),
    panels=[Panel(name, n, 2.0) for name, n in zip("abcdef", NORMALS, strict=True)],
    telemetry=TelemetryForm(noise=0.02),
)
T = 20.0 * np.arange(30)
"""Times of samples, s."""


def looked_at(
    vehicle: Vehicle,
    t: np.ndarray,
    without_panels: slice | np.ndarray = slice(0),
    **sensors: np.ndarray,
) -> Assessment:
    """Return the assessment of noisy samples at times t (n), s, of a body that rotates about an oblique axis.

    `without_panels`: rows (slice or mask) without readings of panels; `sensors`: variables (n, 3) of the telemetry.
    """
    sun = Rotation.from_rotvec(0.03 * t[:, None] * [0.6, 0.3, 0.74]).apply([0.3, -0.7, 0.65])
    power = ss.panel_power(vehicle, sun)
    power += 0.02 * np.random.default_rng(3).normal(size=power.shape)
    power[without_panels] = np.nan
    variables = {name: (("time", "axis"), value) for name, value in sensors.items()}
    variables |= {"power_W": (("time", "panel"), power)}
    variables |= {"flag": ("time", np.isnan(power).all(axis=1).astype(np.uint8))}
    coords = {"time": t, "panel": list(vehicle.panel_names), "axis": list("xyz")}
    attrs = {"unused_columns": "", "missing_sensors": "", "epoch_utc": "2026-01-01T00:00:00Z"}
    return assess(vehicle, xr.Dataset(variables, coords, attrs))


def test_check_names_each_pair_of_opposite_columns_of_a_box() -> None:
    found = describe_unseen_columns(looked_at(BOX, T))
    pairs = [f"the columns of panels {a} and {b} exchanged" for a, b in ("ad", "be", "cf")]
    assert found.summary["columns_unseen"] == pairs
    assert all(pair in found.lines[0] for pair in pairs)


def test_check_names_no_columns_that_other_sensors_or_a_missing_symmetry_show() -> None:
    measured_rates = np.tile([0.018, 0.009, 0.022], (30, 1))
    with_gyro = looked_at(BOX, T, gyro_B=measured_rates)
    assert describe_unseen_columns(with_gyro).lines == []


def test_check_is_silent_about_columns_in_a_wrong_unit() -> None:
    assert "columns_unseen" not in describe_samples(looked_at(BOX, T), misread=True).summary


@pytest.mark.parametrize("speed", [0.0, 300.0])
def test_a_wheel_that_runs_leaves_only_exchanges_along_which_it_does_not_show(speed: float) -> None:
    wheel = ss.Wheel("w", [0, 0, 1], 1e-4, speed)
    changes = describe_unseen_columns(looked_at(replace(BOX, wheels=(wheel,)), T)).summary
    assert ("the columns of panels a and d exchanged" in changes["columns_unseen"]) == (speed == 0)


def test_check_proposes_a_span_for_rows_of_other_instruments_close_to_those_of_panels() -> None:
    def proposals(apart_s: float, **form: float) -> list[str]:
        t = np.sort(np.concatenate([T, T + apart_s]))
        vehicle = replace(BOX, telemetry=replace(BOX.telemetry, **form))
        lines = describe_samples(looked_at(vehicle, t, slice(1, None, 2))).lines
        return [line for line in lines if "sample_span_s = " in line]

    (line,) = proposals(0.4)
    assert "30 rows have no panel and lie 0.4 s from" in line
    assert "sample_span_s = 0.48" in line  # a fifth more than the distance
    # half-way between the rows of panels they are samples of their own, and a stated span is not proposed again
    assert proposals(10.0) == []
    assert proposals(0.4, sample_span_s=1.0) == []


def test_the_proposed_span_ignores_rows_whose_row_of_panels_was_lost_or_that_follow_the_pass() -> (
    None
):
    lost = np.array([7, 12, 13])
    late = T[-1] + 700.0 * np.arange(1, 6)
    others = np.concatenate([T - 2.0, late])
    t = np.sort(np.concatenate([np.delete(T, lost), others]))
    lines = describe_samples(looked_at(BOX, t, np.isin(t, others))).lines
    (line,) = [line for line in lines if "sample_span_s = " in line]
    assert "27 rows have no panel and lie 2 s from" in line and "sample_span_s = 2.4 " in line
