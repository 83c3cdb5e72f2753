"""What the paper states and the study takes over: tables, windows, grids; each with what is made of it here.

So that every figure of `published.toml` has a row (a test holds the two together), and what can be checked is checked.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from sunspin.estimate.scan.mask import allows
from sunspin.estimate.scan.metrics import direction_error, emd
from sunspin.landing.scenario import spiral
from sunspin.philae import rebound as rb
from sunspin.philae.row import Row, published_row, source_of
from sunspin.telemetry.case import Case
from sunspin.vehicle.timeline import utc_seconds

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
    "gravity": "weight at rest",
    "kernel_speed_before": "collision and its weights",
    "kernel_speed_after": "weights of the collisions",
    "kernel_speed_before_landing": "second touchdown",
    "kernel_speed_after_landing": "nothing",
    "kernel_path_length": "see the contradictions: speed at the collision",
    "trajectory_straight_path": "see the contradictions: speed at the collision",
    "romap_period_before": "weights of the collisions, speed of a leg's end",
    "energy_absorbed": "see the contradictions",
    "trajectory_speed_after_touchdown": "see the contradictions: energy absorbed",
    "touchdown_energy_before": "see the contradictions: energy absorbed",
    "touchdown_energy_after": "see the contradictions: energy absorbed",
    "window_before_collision": "see the contradictions",
    "window_first_sample": "see the contradictions",
    "cited_section": "see the contradictions",
    "last_section": "see the contradictions",
    "ephemeris_sun_distance": "row on the Sun's distance",
    "trajectory_distance": "row on the distance from the target",
}
"""Published figures that are inputs or the other half of a comparison -> where they are used."""


MISSION = {
    "distance from the Earth, million km": 500, "separation from the comet at, km": 22.5, "size of the comet, km": [2, 4],
    "contact lost after, h": 60, "hibernation, months": 6, "then until contact, months": 1,
}  # fmt: skip
"""Round figures of the introduction that are no part of the reconstruction."""


@dataclass(frozen=True)
class Taken:
    """The case and the Sun directions of its telemetry."""

    case: Case
    sun: xr.Dataset


def rows(result: Taken) -> list[Row]:
    """Tables of the paper, figures that are taken over, and simple checks among them."""
    case = result.case
    taken = [_taken(key, figure) for key, figure in case.published.items() if key in TAKEN]
    return [*_table_rows(case), *_checked(result), *_stated_rows(result), *taken]


def _taken(key: str, figure: Any) -> Row:
    used = not TAKEN[key].startswith(("see the contradictions", "nothing"))
    note = f"used as published; {TAKEN[key]}" if used else f"only compared; {TAKEN[key]}".replace("; nothing", ", in a test")
    ours = figure.value if used else "not an input"
    return Row(key, figure.what, figure.value, ours, figure.unit, None, None, note, source_of(figure.place))


def _stated_rows(result: Taken) -> list[Row]:
    """Sentences that need no part of their own: lengths of flights, distances, ranges of metrics, the rule on lit panels."""
    case, between = result.case, result.case.require_timeline().seconds
    mask, everywhere = rb.reconstructible_mask(case.vehicle), spiral()
    share = float(np.mean(allows(mask, everywhere)))
    below = float(np.mean(allows(mask, everywhere[everywhere[:, 2] < 0])))
    opposite = np.array([[0.0, 0.0, 1.0]])
    extremes = [
        float(direction_error(opposite, opposite)), float(direction_error(-opposite, opposite)), emd([1.0], [1.0]),
        emd([-1.0], [1.0]),
    ]  # fmt: skip
    away = case.published["trajectory_distance"].value
    return [
        published_row(
            case, "descent_duration", between("separation", "first_touchdown") / 3600, 0.1, "Table 1, separation to first "
                "touchdown",
            kind="arithmetic", chain="none",
        ),
        published_row(
            case, "duration_after_collision", between("collision", "second_touchdown") / 60, 1.0, "Table 1",
            kind="arithmetic", chain="none",
        ),
        published_row(
            case, "sun_distance", case.published["ephemeris_sun_distance"].value, 0.05, "published: about; ours: ephemeris kernel",
            kind="arithmetic", chain="none",
        ),
        published_row(
            case, "distance_from_target", away / 1000, 0.1,
            "ours: first touchdown to rest in the trajectory kernel, comet-fixed; the published one is from the target point, "
            "which the first touchdown missed by some 0.1 km", kind="arithmetic", chain="none",
        ),
        Row(
            "metric_ranges", "least and largest value: E, then EMD", [0.0, 1.0, 0.0, 1.0], extremes, "1", 1e-12,
            bool(np.allclose(extremes, [0, 1, 0, 1], rtol=0, atol=1e-12)), "equal and opposite directions", "paper, section 2.3",
            kind="arithmetic", chain="none",
        ),
        Row(
            "sun_below", "share of the directions with z < 0 from which the panels tell the Sun", "none", below, "1",
            0.0, below == 0, f"of all directions {share:.4f}: panel 6 lit, three panels at least, 3 and 5 not both dark; for these "
            "normals 5/16 = 0.3125", "paper, section 2.1", kind="arithmetic", chain="none",
        ),
        Row(
            "mission", "facts of the mission in the introduction", MISSION, "not computed", "see the names", None, None,
            "nothing in this study depends on them", "paper, section 1",
        ),
    ]  # fmt: skip


def _table_rows(case: Case) -> list[Row]:
    vehicle = case.vehicle
    inertia = np.array(vehicle.require_inertia())
    moments = np.linalg.eigvalsh(inertia)
    legs = np.array([leg.tip_B_m for leg in vehicle.legs])
    middle = legs.mean(axis=0)
    listed = [event for event in case.require_timeline().events if event.source.startswith("paper, Table 1")]
    events = {event.name: event.utc for event in listed}
    off = max((abs(utc_seconds(event.utc, event.refined_utc)) for event in listed if event.refined_utc), default=0.0)
    return [
        _table(
            "table_1", "Table 1: schedule of events", events, "UTC",
            f"times of the case's timeline; those in the trajectory kernel differ by {off:.2f} s at most", "Table 1",
        ),
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
            "impact need it", "Table 3",
        ),
        _table(
            "cells", "solar cells of the panels", np.array(vehicle.panel_gains).tolist(), "1", "relative gains", "section 2.1",
        ),
    ]  # fmt: skip


def _table(name: str, what: str, value: Any, unit: str, note: str, place: str) -> Row:
    return Row(name, what, value, value, unit, None, None, f"used as published; {note}", f"paper, {place}")


def _checked(result: Taken) -> list[Row]:
    case = result.case
    published = {key: figure.value for key, figure in case.published.items()}
    bound = rb.smallest_on_lines(case, rb.published_lines(case), rb.nominal_speed(case.vehicle)[0])
    found = [
        published_row(
            case, "path_duration", published["path_length"] / published["collision_speed"] / 60, 0.1,
            "published path over published speed: they agree with each other", kind="arithmetic", chain="none",
        ),
        published_row(
            case, "rate_at_touchdown_min_rounded", bound, 0.01, "on the published lines, as in section "
                "3.2", kind="arithmetic", chain="none",
        ),
    ]  # fmt: skip
    if case.vehicle.antenna is not None:
        opening = float(np.degrees(case.vehicle.antenna.opening_rad))
        found.append(published_row(case, "antenna_cone", opening, 1e-6, "in the vehicle file; what it sees is in the rows on rest"))
    return found
