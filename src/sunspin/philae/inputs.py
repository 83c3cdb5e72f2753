"""What the paper states and the study takes over: tables, windows, grids; each with what is made of it here.

So that every figure of `published.toml` has a row (a test holds the two together), and what can be checked is checked.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sunspin.estimate.scan.mask import allows
from sunspin.estimate.scan.metrics import direction_error, emd
from sunspin.landing.scenario import spiral
from sunspin.philae import rebound as rb
from sunspin.philae.row import Row, row, tables
from sunspin.telemetry.case import Case
from sunspin.vehicle import Vehicle, load_vehicle
from sunspin.vehicle.timeline import utc_seconds


def rows(case: Case) -> list[Row]:
    """Tables of the paper, simple checks among its figures, figures that are taken over."""
    return [*_table_rows(case), *_stated_rows(case), *_taken(case)]


def _taken(case: Case) -> list[Row]:
    """Published figures that are inputs, or the other half of a comparison, in the order of `published.toml`."""
    in_this_run: dict[str, Any] = {
        "wheel_speed": case.vehicle.wheels[0].speed_rad_s,
        "near_minimum_factor": case.assumptions.study.near_minimum_factor,
    }
    rows = []
    for name, about in tables(case).items():
        if "compared" in about:
            note = f"only compared; {about['compared']}"
            rows.append(row(case, name, "not an input", note=note))
        elif "used" in about:
            published = case.published[name].value
            ours = in_this_run.get(name, published)
            note = _changed(ours, published) or {"note": f"used as published; {about['used']}"}
            rows.append(row(case, name, ours, **note))
    return rows


def _changed(ours: Any, published: Any) -> dict[str, Any]:
    """The note of a row whose input is not as published in this run; none where it is."""
    return {} if ours == published else {"note": "not as published: this run has another value"}


def _stated_rows(case: Case) -> list[Row]:
    """Sentences that need no computation of their own: lengths of flights, distances, ranges of metrics, the rule on lit panels."""
    paper = {key: figure.value for key, figure in case.published.items()}
    between = case.require_timeline().seconds
    mask, everywhere = rb.reconstructible_mask(case.vehicle), spiral()
    share = float(np.mean(allows(mask, everywhere)))
    below = float(np.mean(allows(mask, everywhere[everywhere[:, 2] < 0])))
    up = np.array([[0.0, 0.0, 1.0]])
    errors = [float(direction_error(sun, up)) for sun in (up, -up)]
    ours: dict[str, Any] = {
        "path_duration": paper["path_length"] / paper["collision_speed"] / 60,
        "rate_at_touchdown_min_rounded": rb.smallest_on_lines(
            case, rb.nominal_speed(case.vehicle)[0]
        ),
        "descent_duration": between("separation", "first_touchdown") / 3600,
        "duration_after_collision": between("collision", "second_touchdown") / 60,
        "sun_distance": paper["ephemeris_sun_distance"],
        "distance_from_target": paper["trajectory_distance"] / 1000,
        "metric_ranges": [*errors, emd([1.0], [1.0]), emd([-1.0], [1.0])],
        "mission": "not computed",
    }
    if case.vehicle.antenna is not None:
        ours["antenna_cone"] = float(np.degrees(case.vehicle.antenna.opening_rad))
    rows = [row(case, name, value) for name, value in ours.items()]
    return [*rows, row(case, "sun_below", below, share=share)]


def _table_rows(case: Case) -> list[Row]:
    """Tables 1 to 3 and the panels' cells: the paper's, and those of this run."""
    schedule = [
        event
        for event in case.require_timeline().events
        if event.source.startswith("paper, Table 1")
    ]
    times = {event.name: event.utc for event in schedule}
    refined = [
        abs(utc_seconds(event.utc, event.refined_utc)) for event in schedule if event.refined_utc
    ]
    (body, tips, cells), published = map(_tables_of, (case.vehicle, load_vehicle(case.name)))
    moments = np.linalg.eigvalsh(case.vehicle.require_inertia())
    texts: dict[str, dict[str, Any]] = {
        "table_2": {
            "moments": ", ".join(f"{moment:.3f}" for moment in moments),
            "unlike": 100 * (moments[1] / moments[0] - 1),
        },
        "table_3": {"middle": np.linalg.norm(np.mean(tips, axis=0)[:2])},
        "cells": {},
    }
    ours = zip(texts, (body, tips, cells), published, strict=True)
    return [
        row(case, "table_1", times, published=times, off=max(refined, default=0.0)),
        *(
            row(case, name, mine, published=theirs, **_changed(mine, theirs), **texts[name])
            for name, mine, theirs in ours
        ),
    ]


def _tables_of(vehicle: Vehicle) -> tuple[list[Any], list[Any], list[float]]:
    """Table 2 of a vehicle (mass, inertia tensor, axial inertia of the wheel), Table 3 (ends of the legs), gains of its panels."""
    inertia = np.array(vehicle.require_inertia()).tolist()
    body = [vehicle.require_mass(), inertia, vehicle.wheels[0].inertia_kg_m2]
    return body, [list(leg.tip_B_m) for leg in vehicle.legs], np.array(vehicle.panel_gains).tolist()
