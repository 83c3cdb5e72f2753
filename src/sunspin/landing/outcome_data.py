"""The runs of :func:`sunspin.landing.outcomes.outcomes` as a labelled Dataset, with what could not be told and why."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.provenance import provenance
from sunspin.compute.identity import plain
from sunspin.dynamics.ensemble import OUTCOME_TEXT, Outcome
from sunspin.landing.contact import KINDS, Shape
from sunspin.landing.scenario import verticals
from sunspin.vehicle import Vehicle

DESCRIBED = {
    "outcome": ("1", "0: computed as asked"),
    "candidate": ("1", "number of the candidate motion"),
    "leg": ("1", "number of the leg that hits at the collision"),
    "rz_share": ("1", "share of the time from collision to landing in each bin of r_z"),
    "omega_before_B": ("rad/s", "body rate just before the collision"),
    "omega_after_B": ("rad/s", "body rate just after the collision"),
    "momentum_before": ("N m s", "size of the total angular momentum before the collision"),
    "momentum_after": ("N m s", "size of the total angular momentum after the collision"),
    "velocity_change": ("m/s", "impulse over mass at the collision"),
    "change_to_sun": ("rad", "angle between the change of velocity at the collision and the Sun"),
    "change_about_sun": (
        "rad",
        "angle of that change about the Sun, from the side on which the touchdown's vertical lies",
    ),
    "speed_after": ("m/s", "speed of the centre of mass after the collision"),
    "contact_point": ("1", "point that touches the ground first at the landing"),
    "lowest_point": (
        "1",
        "lowest point at the time of landing, had the vehicle not turned while it came down",
    ),
    "contact_speed": ("m/s", "speed over ground of the point that touches first"),
    "leg_tip_speed": ("m/s", "largest speed over ground of an end of a leg at first contact"),
    "leg_tip_bound": ("m/s", "v + |l| |omega| at first contact (paper, section 4)"),
    "up_z": ("1", "cosine of the angle between z axis and the ground's normal at first contact"),
    "antenna_share": (
        "1",
        "share of the time from collision to landing in which the antenna's cone holds the orbiter",
    ),
    "antenna_at_contact": ("1", "1: the cone holds the orbiter at first contact"),
    "antenna_at_rest": ("1", "1: the cone holds the orbiter once at rest"),
    "rest_facet": (
        "1",
        "facet of the hull on which the vehicle comes to rest, rolling without speed",
    ),
}
"""Unit and meaning of each variable."""


def dataset(rows: Any, values: dict[str, np.ndarray]) -> xr.Dataset:
    """The results of an ensemble of `OutcomeRows` as a Dataset over `run`."""
    shape: Shape | None = rows.shape
    data = {}
    for name, array in values.items():
        extra = {"rz_share": ("rz",)}.get(name, ("axis",) if array.ndim == 2 else ())
        units, text = DESCRIBED[name]
        data[name] = (("run", *extra), array, {"units": units, "long_name": text})
    bins = values["rz_share"].shape[1]
    edges = np.linspace(-1.0, 1.0, bins + 1)
    result = xr.Dataset(
        data,
        coords={
            "run": np.arange(len(values["outcome"])),
            "rz": (
                "rz",
                (edges[1:] + edges[:-1]) / 2,
                {"units": "1", "long_name": "middle of the bin of r_z"},
            ),
            "axis": ["x", "y", "z"],
        },
    )
    result["outcome"].attrs |= {
        "flag_values": [int(o) for o in Outcome],
        "flag_meanings": " ".join(o.name.lower() for o in Outcome),
    }
    result = _with_shape(result, rows.vehicle, shape).assign_attrs(_attrs(rows))
    result.attrs["not_told"] = " ".join(
        filter(None, [result.attrs["not_told"], _without_attitude(rows, values)])
    )
    return result


def _without_attitude(rows: Any, values: dict[str, np.ndarray]) -> str:
    """In how many runs momentum and Sun were parallel, as far as that shows."""
    if rows.lands:
        lost = values["contact_point"] < 0
    elif rows.vehicle.antenna is not None:
        lost = np.isnan(values["antenna_share"])
    else:
        return ""
    count = int(np.count_nonzero(lost & (values["outcome"] == 0)))
    if count == 0:
        return ""
    return (
        f"In {count} of {len(lost)} runs momentum and Sun were parallel at a time: how far the vehicle is turned about them is not "
        "known then, so nothing is told of first contact, antenna and rest."
    )


def _with_shape(result: xr.Dataset, vehicle: Vehicle, shape: Shape | None) -> xr.Dataset:
    """The shape's points and facets as coordinates, so that the numbers in the runs can be read without the vehicle."""
    if shape is None:
        return result
    names = np.array(KINDS)
    result = result.assign_coords(
        point_B_m=(("point", "axis"), shape.points_B_m, {"units": "m"}),
        point_kind=("point", names[shape.kind]),
        point_leg=("point", shape.leg),
        point_on_panel=(("point", "panel"), shape.panels),
        panel=("panel", np.array(vehicle.panel_names, dtype=np.str_)),
    )
    if shape.outward_B is None:
        return result
    return result.assign_coords(
        facet_normal_B=(("facet", "axis"), shape.outward_B, {"units": "1"}),
        facet_kind=("facet", names[shape.facet_kind]),
    )


def _attrs(rows: Any) -> dict[str, Any]:
    vehicle, scenario = rows.vehicle, rows.scenario
    return provenance("outcomes", **vehicle.said) | {
        "seed": rows.seed,
        "strategy": rows.strategy.name,
        "schedule": json.dumps(plain(rows.strategy.schedule)),
        "scenario": json.dumps(plain(scenario), sort_keys=True),
        "vertical": verticals(vehicle, scenario.vertical)[1],
        "candidates": len(rows.candidates.omega_B),
        "not_told": " ".join(not_told(rows)),
        "not_computed": _failures(),
        "source": "paper, sections 3.3 and 4; distributions of what is not known: sunspin.landing.scenario",
    }


def _failures() -> str:
    return "; ".join(f"{int(o)}: {OUTCOME_TEXT[o]}" for o in Outcome)


def not_told(rows: Any) -> list[str]:
    """One sentence for each thing that this vehicle's file does not allow to tell."""
    vehicle, shape = rows.vehicle, rows.shape
    found = []
    if rows.scenario.collision_speed_m_s is None:
        found.append("There is no collision in this scenario, so nothing is told of one.")
    elif not rows.collides:
        missing = "legs" if not vehicle.legs else "mass"
        found.append(
            f"Without {missing} in the vehicle file the collision cannot be computed, so the motion goes on undisturbed."
        )
    if shape is None:
        found.append(
            "Without a hull and legs in the vehicle file it cannot be told what touches the ground first."
        )
    elif not rows.lands:
        found.append(
            f"At {rows.scenario.landing_speed_m_s:g} m/s the last metres may take {rows.approach_s:.0f} s, longer than the "
            "flight: what touches the ground first cannot be told."
        )
    elif not shape.complete:
        found.append(
            "Without a hull in the vehicle file only the legs can touch first: nothing is told of body, panels and rest."
        )
    elif shape.outward_B is None:
        found.append(
            "The hull has no volume around the centre of mass, so it cannot be told on what the vehicle comes to rest."
        )
    if not vehicle.legs:
        found.append("Without legs in the vehicle file no speed of an end of a leg can be told.")
    if vehicle.antenna is None:
        found.append(
            "Without an antenna in the vehicle file it cannot be told whether it serves the orbiter."
        )
    return found
