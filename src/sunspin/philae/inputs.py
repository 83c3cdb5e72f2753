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
from sunspin.philae.row import Row, row
from sunspin.philae.templates import templates
from sunspin.telemetry.case import Case
from sunspin.vehicle import Vehicle, load_vehicle
from sunspin.vehicle.timeline import utc_seconds


@dataclass(frozen=True)
class Taken:
    """The case and the Sun directions of its telemetry."""

    case: Case
    sun: xr.Dataset


def rows(result: Taken) -> list[Row]:
    """Tables of the paper, figures that are taken over, and simple checks among them."""
    case = result.case
    return [*_table_rows(case), *_checked(result), *_stated_rows(result), *_taken(case)]


def _taken(case: Case) -> list[Row]:
    """Published figures that are inputs, or the other half of a comparison, in the order of `published.toml`."""
    inputs = {
        name: template.values["input"]
        for name, template in templates(case).items()
        if "input" in template.values
    }
    used: dict[str, Any] = {
        "wheel_speed": case.vehicle.wheels[0].speed_rad_s,
        "near_minimum_factor": case.assumptions.study.near_minimum_factor,
    }
    return [
        row(
            case,
            name,
            used.get(name, figure.value),
            **_note(used.get(name, figure.value), figure.value),
        )
        if inputs[name]
        else row(case, name, "not an input")
        for name, figure in case.published.items()
        if name in inputs
    ]


def _note(ours: Any, published: Any) -> dict[str, Any]:
    """The note of a row whose input is not as published in this run; else that of the table stays."""
    return {} if ours == published else {"note": "not as published: this run has another value"}


def _stated_rows(result: Taken) -> list[Row]:
    """Sentences that need no part of their own: lengths of flights, distances, ranges of metrics, the rule on lit panels."""
    case, between = result.case, result.case.require_timeline().seconds
    mask, everywhere = rb.reconstructible_mask(case.vehicle), spiral()
    share = float(np.mean(allows(mask, everywhere)))
    below = float(np.mean(allows(mask, everywhere[everywhere[:, 2] < 0])))
    opposite = np.array([[0.0, 0.0, 1.0]])
    extremes = [
        float(direction_error(opposite, opposite)),
        float(direction_error(-opposite, opposite)),
        emd([1.0], [1.0]),
        emd([-1.0], [1.0]),
    ]
    return [
        row(case, "descent_duration", between("separation", "first_touchdown") / 3600),
        row(case, "duration_after_collision", between("collision", "second_touchdown") / 60),
        row(case, "sun_distance", case.published["ephemeris_sun_distance"].value),
        row(case, "distance_from_target", case.published["trajectory_distance"].value / 1000),
        row(case, "metric_ranges", extremes),
        row(case, "sun_below", below, share=share),
        row(case, "mission", "not computed"),
    ]


def _table_rows(case: Case) -> list[Row]:
    vehicle, paper = case.vehicle, load_vehicle(case.name)
    inertia = np.array(vehicle.require_inertia())
    moments = np.linalg.eigvalsh(inertia)
    legs = np.array([leg.tip_B_m for leg in vehicle.legs])
    middle = legs.mean(axis=0)
    listed = [
        event
        for event in case.require_timeline().events
        if event.source.startswith("paper, Table 1")
    ]
    events = {event.name: event.utc for event in listed}
    off = max(
        (abs(utc_seconds(event.utc, event.refined_utc)) for event in listed if event.refined_utc),
        default=0.0,
    )
    (table_2, table_3, gains), (body, tips, cells) = map(_tables_of, (vehicle, paper))
    return [
        row(case, "table_1", events, published=events, off=off),
        row(
            case,
            "table_2",
            table_2,
            published=body,
            **_note(table_2, body),
            moments=", ".join(f"{x:.3f}" for x in moments),
            unlike=100 * (moments[1] / moments[0] - 1),
        ),
        row(
            case,
            "table_3",
            table_3,
            published=tips,
            **_note(table_3, tips),
            middle=np.hypot(middle[0], middle[1]),
        ),
        row(case, "cells", gains, published=cells, **_note(gains, cells)),
    ]


def _tables_of(vehicle: Vehicle) -> tuple[list[Any], list[Any], list[float]]:
    """Table 2 of a vehicle (mass, inertia tensor, axial inertia of the wheel), Table 3 (ends of the legs), gains of its panels."""
    body = [
        vehicle.require_mass(),
        np.array(vehicle.require_inertia()).tolist(),
        vehicle.wheels[0].inertia_kg_m2,
    ]
    return body, [list(leg.tip_B_m) for leg in vehicle.legs], np.array(vehicle.panel_gains).tolist()


def _checked(result: Taken) -> list[Row]:
    case = result.case
    published = {key: figure.value for key, figure in case.published.items()}
    bound = rb.smallest_on_lines(case, rb.published_lines(case), rb.nominal_speed(case.vehicle)[0])
    found = [
        row(case, "path_duration", published["path_length"] / published["collision_speed"] / 60),
        row(case, "rate_at_touchdown_min_rounded", bound),
    ]
    if case.vehicle.antenna is not None:
        found.append(row(case, "antenna_cone", float(np.degrees(case.vehicle.antenna.opening_rad))))
    return found
