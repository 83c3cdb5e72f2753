"""Panels that do not stand as drawn: turns of their normals, the same in all samples, as unknowns of the posterior.

Each panel's own turn is two angles about axes across its normal, and one turn may be common to all panels (the axes in which they
were drawn are not those of inertia and wheel). A turn by an angle changes a panel's reading as a Sun moved by that angle would, in
all samples alike: as noise of each reading it would be taken for many independent errors, and rates for better known than they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sunspin.estimate.terms.term import Unknown
from sunspin.solve.rotations import tangents
from sunspin.vehicle import Vehicle

KIND, COMMON = "tilt", "tilt_common"
"""Kinds of the unknowns: of one panel, and of all together."""


def stated_sigma(vehicle: Vehicle) -> np.ndarray:
    """Sigma (n_panel) in rad of the normals' directions as the vehicle's file has it, to each side; 0 where it states none.

    Of a unit vector the sigma of each component; where these differ, their root mean square.
    """
    facts = [vehicle.facts.get(f"panel.{panel.name}.normal_B") for panel in vehicle.panels]
    return np.array([0.0 if fact is None or fact.sigma is None else np.sqrt(np.mean(np.square(fact.sigma))) for fact in facts])


def unknowns(vehicle: Vehicle, own_rad: np.ndarray, common_rad: float) -> list[Unknown]:
    """Those of turns with sigmas `own_rad` (n_panel) of each panel and `common_rad` of all, about each axis."""
    made = [
        Unknown(f"tilt_{panel.name}_{side + 1}_rad", KIND, "rad", 0.0, float(own_rad[j]), 2 * j + side)
        for j, panel in enumerate(vehicle.panels) for side in range(2)
    ]  # fmt: skip
    return made + [Unknown(f"tilt_all_{'xyz'[axis]}_rad", COMMON, "rad", 0.0, common_rad, axis) for axis in range(3)]


def turns(vehicle: Vehicle, unknown: Sequence[Unknown]) -> np.ndarray:
    """Turns (k, n_panel, 3) in rad of all panels by one sigma of each unknown (k): zero for those that are no tilts."""
    out = np.zeros((len(unknown), len(vehicle.panels), 3))
    across = np.stack(tangents(vehicle.panel_normals_B), axis=1)
    for i, x in enumerate(unknown):
        if x.kind == KIND:
            panel, side = divmod(x.index, 2)
            out[i, panel] = x.sigma * across[panel, side]
        elif x.kind == COMMON:
            out[i, :, x.index] = x.sigma
    return out


def spread(sigma: float, vehicle: Vehicle, unknown: Sequence[Unknown], scale: float) -> float:
    """Sigma of a reading with what turns may add to that of its noise: for the search for starts, which knows no turn."""
    size = np.sqrt((turns(vehicle, unknown) ** 2).sum(axis=0).max(initial=0.0))  # of the panel that may be off most, about an axis
    return float(np.hypot(sigma, size * scale * vehicle.panel_gains.max())) if size else sigma


def told(priors: Mapping[str, Any], vehicle: Vehicle) -> tuple[np.ndarray, float, str]:
    """Sigmas of `unknowns`, given or stated, and the words for that; what is given is checked by the caller."""
    common = float(priors.get("tilt_common", 0.0))
    if "tilt" in priors:
        own, source = np.full(len(vehicle.panels), float(priors["tilt"])), "given"
    else:
        own = stated_sigma(vehicle)
        source = "vehicle file" if own.any() else "assumed"
    words = f"{np.degrees(own.max(initial=0.0)):.3g} deg ({source})"
    return own, common, words + (f", {np.degrees(common):.3g} deg common to all panels (given)" if common else "")
