"""Figures of the paper that the study takes over: tables, windows and grids, and how each is used here.

With these rows every figure of `published.toml` has a row, which a test ensures. Those that can be checked are checked.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sunspin.cases import Case
from sunspin.estimate.scan.metrics import direction_error, emd
from sunspin.landing.scenario import spiral
from sunspin.philae.rebound import (
    nominal_wheel_speeds,
    reconstructible_mask,
    smallest_touchdown_speed,
)
from sunspin.philae.row import Row, make_row, read_tables
from sunspin.vehicle import Vehicle
from sunspin.vehicle.part import as_tuples
from sunspin.vehicle.timeline import utc_seconds


def rows(case: Case) -> list[Row]:
    """Return the rows of the paper's tables, of simple checks among its figures, and of figures that are taken over.

    Figures that are taken over are in the order of `published.toml`, which says for each how it is "used", or what it is only
    "compared" with.
    """
    vehicle, timeline = case.vehicle, case.require_timeline()
    paper = {key: figure.value for key, figure in case.published.items()}

    def taken_over(name: str, ours: Any, **given: Any) -> Row:
        """Return the row of an input, with another note if this run has another value than the published one."""
        if as_tuples(ours) != paper[name]:
            given["note"] = "not as published: this run has another value"
        return make_row(case, name, ours, **given)

    # Tables 1 to 3 and the panels' cells
    schedule = [event for event in timeline.events if event.source.startswith("paper, Table 1")]
    times = {event.name: event.utc for event in schedule}
    refinements_s = [abs(utc_seconds(e.utc, e.refined_utc)) for e in schedule if e.refined_utc]
    body, tips, cells = _published_tables(vehicle)
    moments = np.linalg.eigvalsh(vehicle.require_inertia())
    moments_text = ", ".join(f"{moment:.3f}" for moment in moments)
    unlike = 100 * (moments[1] / moments[0] - 1)  # difference of the two smaller ones, %
    off_s, middle_m = max(refinements_s, default=0.0), np.linalg.norm(np.mean(tips, axis=0)[:2])
    of_times = f"times of the case's timeline; those in the trajectory kernel differ by {off_s:.2f} s at most"
    of_body = (
        f"principal moments {moments_text}: a possible body, {unlike:.0f} % from a symmetric one"
    )
    of_tips = f"their middle is {middle_m:.3f} m from the z axis, so the origin, which is not named, is likely the centre of mass"
    result = [
        taken_over("table_1", times, note=f"used as published; {of_times}"),
        taken_over("table_2", body, note=f"used as published; {of_body}"),
        taken_over("table_3", tips, note=f"as published; {of_tips}"),
        taken_over("cells", cells),
    ]

    # statements that need no simulation: durations, shares of the sphere, ranges of E and EMD
    # shares of all directions, and of those below the xy plane, that the panels can reconstruct
    mask, everywhere = reconstructible_mask(vehicle), spiral()  # directions (n, 3) evenly spread
    share = float(np.mean(mask.contains(everywhere)))
    share_below = float(np.mean(mask.contains(everywhere[everywhere[:, 2] < 0])))
    # E and EMD of equal and of opposite directions: the ends of their ranges
    up = np.array([[0.0, 0.0, 1.0]])
    E_range = [float(direction_error(sun, up)) for sun in (up, -up)]
    emd_range = [emd([1.0], [1.0]), emd([-1.0], [1.0])]
    slowest = smallest_touchdown_speed(case, nominal_wheel_speeds(vehicle)[0])
    ours: dict[str, Any] = {
        "path_duration": paper["path_length"] / paper["collision_speed"] / 60,
        "rate_at_touchdown_min_rounded": slowest,
        "descent_duration": timeline.seconds("separation", "first_touchdown") / 3600,
        "duration_after_collision": timeline.seconds("collision", "second_touchdown") / 60,
        "sun_distance": paper["ephemeris_sun_distance"],
        "distance_from_target": paper["trajectory_distance"] / 1000,
        "metric_ranges": [*E_range, *emd_range],
        "mission": "not computed",
    }
    if vehicle.antenna is not None:
        ours["antenna_cone"] = float(np.degrees(vehicle.antenna.opening_rad))
    result += [make_row(case, name, value) for name, value in ours.items()]
    criteria = (
        "panel 6 lit, three panels at least, 3 and 5 not both dark; for these normals 5/16 = 0.3125"
    )
    note = f"of all directions {share:.4f}: {criteria}"
    result.append(make_row(case, "sun_below", share_below, note=note))

    # figures that the study uses, or that it only compares with a computed one; these two may be changed for a run
    in_this_run: dict[str, Any] = {
        "wheel_speed": vehicle.wheels[0].speed_rad_s,
        "near_minimum_factor": case.assumptions.study.near_minimum_factor,
    }
    for name, about in read_tables(case).items():
        if "compared" in about:
            note = f"only compared; {about['compared']}"
            result.append(make_row(case, name, "not an input", note=note))
        elif "used" in about:
            note = f"used as published; {about['used']}"
            result.append(taken_over(name, in_this_run.get(name, paper[name]), note=note))
    return result


def _published_tables(vehicle: Vehicle) -> tuple[list[Any], list[Any], list[float]]:
    """Return Table 2 (mass, inertia tensor, axial inertia of the wheel), Table 3 (ends of the legs) and the panel gains of a
    vehicle.
    """
    inertia = np.array(vehicle.require_inertia()).tolist()
    body = [vehicle.require_mass(), inertia, vehicle.wheels[0].inertia_kg_m2]
    return body, [list(leg.tip_B_m) for leg in vehicle.legs], np.array(vehicle.panel_gains).tolist()
