"""The runs of :func:`sunspin.landing.outcomes.outcomes` as a labelled Dataset, with sentences on quantities that are missing."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from sunspin.base.provenance import provenance
from sunspin.compute.identity import to_json
from sunspin.dynamics.batch import OUTCOME_TEXT, Outcome
from sunspin.landing.contact import KINDS
from sunspin.landing.scenario import possible_verticals

if TYPE_CHECKING:
    from sunspin.landing.outcomes import OutcomeRows

BINS = 80
"""Number of bins of r_z over [-1, 1]; the paper's bounds -0.5 and -0.2 are edges of bins."""

VARIABLES = {
    "outcome": ("i1", "1", "0: computed as asked"),
    "candidate": ("i4", "1", "number of the candidate motion"),
    "leg": ("i1", "1", "number of the leg that hits at the collision"),
    "rz_share": ("f4", "1", "share of the time from collision to landing in each bin of r_z"),
    "omega_before_B": ("f8", "rad/s", "body rate just before the collision"),
    "omega_after_B": ("f8", "rad/s", "body rate just after the collision"),
    "momentum_before": ("f8", "N m s", "size of the total angular momentum before the collision"),
    "momentum_after": ("f8", "N m s", "size of the total angular momentum after the collision"),
    "velocity_change": ("f8", "m/s", "impulse over mass at the collision"),
    "speed_after": ("f8", "m/s", "speed of the centre of mass after the collision"),
    "change_to_sun": ("f8", "rad", "angle of the change of velocity at the collision to the Sun"),
    "change_about_sun": (
        "f8",
        "rad",
        "angle of that change about the Sun, from the vertical's side",
    ),
    "contact_point": ("i2", "1", "point that touches the ground first at the landing"),
    "contact_speed": ("f8", "m/s", "speed over ground of the point that touches first"),
    "leg_tip_speed": ("f8", "m/s", "largest speed over ground of an end of a leg at first contact"),
    "leg_tip_bound": ("f8", "m/s", "v + |l| |omega| at first contact (paper, section 4)"),
    "up_z": ("f8", "1", "cosine of the z axis to the ground's normal at first contact"),
    "antenna_share": ("f4", "1", "share of the flight with the orbiter in the antenna's cone"),
    "antenna_at_contact": ("i1", "1", "1: the orbiter is in the antenna cone at first contact"),
    "antenna_at_rest": ("i1", "1", "1: the orbiter is in the antenna cone at rest"),
    "rest_facet": ("i2", "1", "facet on which the vehicle comes to rest, rolling without speed"),
}
"""Type, unit and meaning of each variable; -1 and NaN mean that the value is not known."""


def extra_dimension(name: str) -> str | None:
    """Return the dimension of a variable in addition to the runs: "rz" (length `BINS`), "axis" (length 3) or None."""
    return "rz" if name == "rz_share" else "axis" if name.endswith("_B") else None


def outcome_dataset(rows: OutcomeRows, values: dict[str, np.ndarray]) -> xr.Dataset:
    """Return the results of an ensemble of `OutcomeRows` (name of `VARIABLES` -> array over runs) as a Dataset over `run`.

    Points and facets of the shape are coordinates, so that their numbers in the runs can be read without the vehicle.
    """
    vehicle, scenario, shape = rows.vehicle, rows.scenario, rows.shape
    data = {}
    for name, array in values.items():
        _, units, text = VARIABLES[name]
        extra = extra_dimension(name)
        dims = ("run",) if extra is None else ("run", extra)
        data[name] = (dims, array, {"units": units, "long_name": text})
    edges = np.linspace(-1.0, 1.0, BINS + 1)
    rz = {"units": "1", "long_name": "middle of the bin of r_z"}
    coords: dict[str, Any] = {
        "run": np.arange(len(values["outcome"])),
        "rz": ("rz", (edges[1:] + edges[:-1]) / 2, rz),
        "axis": ["x", "y", "z"],
    }
    kinds = np.array(KINDS)
    if shape is not None:
        # a point that is no leg's tip has the number -1, and so the last name
        leg_names = np.array([*(leg.name for leg in vehicle.legs), ""], dtype=np.str_)
        coords |= {
            "point_B_m": (("point", "axis"), shape.points_B_m, {"units": "m"}),
            "point_kind": ("point", kinds[shape.kind]),
            "point_leg": ("point", shape.leg),
            "point_leg_name": ("point", leg_names[shape.leg]),
            "point_on_panel": (("point", "panel"), shape.panels),
            "panel": ("panel", np.array(vehicle.panel_names, dtype=np.str_)),
        }
    if shape is not None and shape.outward_B is not None:
        coords["facet_normal_B"] = (("facet", "axis"), shape.outward_B, {"units": "1"})
        coords["facet_kind"] = ("facet", kinds[shape.facet_kind])
    result = xr.Dataset(data, coords)
    result["outcome"].attrs |= {
        "flag_values": [int(code) for code in Outcome],
        "flag_meanings": " ".join(code.name.lower() for code in Outcome),
    }
    return result.assign_attrs(
        provenance("outcomes", **vehicle.result_attributes)
        | {
            "seed": rows.seed,
            "strategy": rows.strategy.name,
            "schedule": json.dumps(to_json(rows.strategy.schedule)),
            "scenario": json.dumps(to_json(scenario), sort_keys=True),
            "vertical": possible_verticals(vehicle, scenario.vertical)[1],
            "candidates": len(rows.candidates),
            "not_told": " ".join(_explain_missing(rows, values)),
            "not_computed": "; ".join(f"{int(code)}: {OUTCOME_TEXT[code]}" for code in Outcome),
            "source": "paper, sections 3.3 and 4; distributions of what is not known: sunspin.landing.scenario",
        }
    )


def _explain_missing(rows: OutcomeRows, values: dict[str, np.ndarray]) -> Iterator[str]:
    """Yield a sentence for each quantity that cannot be computed for this vehicle file, or in some runs.

    `values` are those of :func:`outcome_dataset`.
    """
    vehicle, shape = rows.vehicle, rows.shape
    runs_on = [
        wheel.name
        for wheel in vehicle.wheels
        if wheel.friction.coulomb_N_m == wheel.friction.viscous_N_m_s == 0
    ]
    if runs_on and any("coast" in command for _, command in rows.strategy.schedule):
        yield (
            f"Without friction in the vehicle file (wheel {', '.join(runs_on)}) a wheel hardly slows down when its motor is off, "
            "so all commands but the brake give nearly the same motion."
        )
    if rows.until != "landing":
        yield f"The simulation ends with the {rows.until}: nothing later is reported."
    if rows.scenario.collision_speed_m_s is None:
        yield "There is no collision in this scenario, so none is reported."
    elif not rows.collides:
        missing = "legs" if not vehicle.legs else "mass"
        yield (
            f"Without {missing} in the vehicle file the collision cannot be computed, so the motion continues undisturbed."
        )
    if rows.until != "landing":
        return
    if shape is None:
        yield "Without a hull and legs in the vehicle file it is unknown what touches the ground first."
    elif not rows.lands:
        yield (
            f"At {rows.scenario.landing_speed_m_s:g} m/s the last metres may take {rows.approach_s:.0f} s, longer than the "
            "flight: it is unknown what touches the ground first."
        )
    elif not shape.complete:
        yield "Without a hull in the vehicle file only the legs can touch first: body, panels and rest are not reported."
    elif shape.outward_B is None:
        yield "The hull has no volume around the centre of mass, so it is unknown on what the vehicle comes to rest."
    if not vehicle.legs:
        yield "Without legs in the vehicle file no speed of a leg's end is reported."
    if vehicle.antenna is None:
        yield "Without an antenna in the vehicle file it is unknown whether the orbiter is in its cone."
    # computed runs without a first contact, or without visibility of the antenna if no contact is computed
    missing_in = (
        values["contact_point"] < 0
        if rows.lands
        else np.isnan(values["antenna_share"]) & (vehicle.antenna is not None)
    )
    if count := int(np.count_nonzero(missing_in & (values["outcome"] == 0))):
        yield (
            f"In {count} of {len(missing_in)} runs momentum and Sun were parallel at a time: how far the vehicle is turned "
            "about them is not known then, so first contact, antenna and rest are not reported."
        )
