"""What the paper states and the study takes over: tables, windows, grids; each with what is made of it here.

So that every figure of `published.toml` has a row (a test holds the two together), and what can be checked is checked.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from sunspin.cases import Case
from sunspin.study import rebound as rb
from sunspin.study.row import Row, published_row

TAKEN = {
    "wheel_speed": "at the touchdown and, as in the paper, at the first sample; see the contradictions",
    "example_rates": "Figs. 6 and 7",
    "example_duration": "Figs. 6 and 7",
    "first_sun": "start of the scan, of the twins and of the way back",
    "first_sun_E_study": "start of the maps of E only; its length is not one, see the contradictions",
    "scan_duration": "window of the scan",
    "scan_omega_x": "grid of the scan",
    "scan_omega_y": "grid of the scan",
    "scan_omega_z": "grid of the scan",
    "scan_step": "grid of the scan",
    "near_minimum_factor": "set of the telemetry's scan; what it is worth is in the rows on twins",
    "E_study_box": "Fig. 8 A",
    "E_study_omega": "Fig. 8 B",
    "E_study_coulomb": "Fig. 8 B",
    "E_study_inertia": "Fig. 8 B",
    "descent_span": "end of the descent's fit",
    "duration_after_collision": "window of Fig. 13",
    "gravity": "weight at rest",
    "kernel_speed_before": "collision and its weights",
    "kernel_speed_after": "weights of the collisions",
    "kernel_speed_before_landing": "second touchdown",
    "kernel_speed_after_landing": "not used",
    "kernel_path_length": "row on the path",
    "romap_period_before": "weights of the collisions, speed of a leg's end",
    "energy_absorbed": "see the contradictions",
    "trajectory_speed_after_touchdown": "see the contradictions: energy absorbed",
    "touchdown_energy_before": "see the contradictions: energy absorbed",
    "touchdown_energy_after": "see the contradictions: energy absorbed",
    "window_before_collision": "see the contradictions",
    "window_first_sample": "see the contradictions",
    "round_mass": "see the contradictions",
    "cited_section": "see the contradictions",
    "last_section": "see the contradictions",
}
"""Published figures that are inputs or the other half of a comparison -> where they are used."""


@dataclass(frozen=True)
class Taken:
    """The case and the Sun directions of its telemetry."""

    case: Case
    sun: xr.Dataset


def rows(result: Taken) -> list[Row]:
    """Tables of the paper, figures that are taken over, and simple checks among them."""
    case, source = result.case, "used as published; "
    taken = [
        Row(key, figure.what, figure.value, figure.value, figure.unit, None, None, source + TAKEN[key], f"paper, {figure.place}")
        for key, figure in case.published.items() if key in TAKEN
    ]  # fmt: skip
    return [*_table_rows(case), *_checked(result), *taken]


def _table_rows(case: Case) -> list[Row]:
    vehicle = case.vehicle
    inertia = np.array(vehicle.require_inertia())
    moments = np.linalg.eigvalsh(inertia)
    legs = np.array([leg.tip_B_m for leg in vehicle.legs])
    middle = legs.mean(axis=0)
    events = {event.name: event.utc for event in case.timeline.events if event.source.startswith("paper, Table 1")}
    return [
        _table("table_1", "Table 1: schedule of events", events, "UTC", "times of the case's timeline", "Table 1"),
        _table(
            "table_2", "Table 2: mass, inertia tensor, axial inertia of the wheel",
            [vehicle.require_mass(), inertia.tolist(), vehicle.wheels[0].inertia_kg_m2], "kg, kg m2, kg m2",
            f"principal moments {', '.join(f'{x:.3f}' for x in moments)}: a possible body, "
            f"{100 * (moments[1] / moments[0] - 1):.0f} % from a symmetric one", "Table 2",
        ),
        _table(
            "table_3", "Table 3: ends of the legs", legs.tolist(), "m",
            "the origin is not named; their middle is "
            f"{np.hypot(middle[0], middle[1]):.3f} m from the z axis, so it is likely the centre of mass, as the equations of "
            f"impact "
            "need it", "Table 3",
        ),
        _table(
            "cells", "solar cells of the panels", np.array(vehicle.panel_gains).tolist(), "1", "relative gains", "section 2.1",
        ),
    ]  # fmt: skip


def _table(name: str, what: str, value: Any, unit: str, note: str, place: str) -> Row:
    return Row(name, what, value, value, unit, None, None, f"used as published; {note}", f"paper, {place}")


def _checked(result: Taken) -> list[Row]:
    case, time = result.case, result.sun["time"].values
    published = {key: figure.value for key, figure in case.published.items()}
    twin = "synthetic telemetry, made so" if result.sun.attrs.get("synthetic") else "the telemetry"
    touchdown, collision, second = (
        rb.case_seconds(case, result.sun, name) for name in ("first_touchdown", "collision", "second_touchdown")
    )
    flight = (time >= touchdown) & (time < collision)
    bound = rb.smallest_on_lines(case, rb.published_lines(case), rb.nominal_speed(case.vehicle)[0])
    found = [
        published_row(
            case, "sampling_interval", float(np.median(np.diff(time[flight]))) / 60 if flight.sum() > 1 else None,
            0.3 if flight.sum() > 1 else None, f"median between first touchdown and collision; {twin}",
        ),
        published_row(
            case, "samples_after_collision", int(np.count_nonzero((time >= collision) & (time < second))), 0.0, twin,
        ),
        published_row(
            case, "path_duration", published["path_length"] / published["collision_speed"] / 60, 0.1,
            "published path over published speed: they agree with each other",
        ),
        published_row(case, "rate_at_touchdown_min_rounded", bound, 0.01, "on the published lines, as in section 3.2"),
    ]  # fmt: skip
    if case.vehicle.antenna is not None:
        opening = float(np.degrees(case.vehicle.antenna.opening_rad))
        found.append(published_row(case, "antenna_cone", opening, 1e-6, "in the vehicle file; what it sees is in the rows on rest"))
    return found
