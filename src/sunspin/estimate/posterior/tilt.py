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
from sunspin.solve.rotations import tangent_basis
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import misalignment_sigma

KIND, COMMON = "tilt", "tilt_common"
"""Kinds of the unknowns: of one panel, and of all together."""

KINDS = (KIND, COMMON)

LIT_SINE = 2 / 3
"""Mean square of the sine of the angle between a normal and the Suns that light its panel."""


def unknowns(vehicle: Vehicle, own_rad: np.ndarray, common_rad: float) -> list[Unknown]:
    """Those of turns with sigmas `own_rad` (n_panel) of each panel and `common_rad` of all, about each axis."""
    made = [
        Unknown(
            f"tilt_{panel.name}_{side + 1}_rad", KIND, "rad", 0.0, float(own_rad[j]), 2 * j + side
        )
        for j, panel in enumerate(vehicle.panels)
        for side in range(2)
    ]
    return made + [
        Unknown(f"tilt_all_{'xyz'[axis]}_rad", COMMON, "rad", 0.0, common_rad, axis)
        for axis in range(3)
    ]


def turns(vehicle: Vehicle, unknown: Sequence[Unknown]) -> np.ndarray:
    """Turns (k, n_panel, 3) in rad of all panels by one sigma of each unknown (k): zero for those that are no tilts."""
    out = np.zeros((len(unknown), len(vehicle.panels), 3))
    across = np.stack(tangent_basis(vehicle.panel_normals_B), axis=1)
    for i, x in enumerate(unknown):
        if x.kind == KIND:
            panel, side = divmod(x.index, 2)
            out[i, panel] = x.sigma * across[panel, side]
        elif x.kind == COMMON:
            out[i, :, x.index] = x.sigma
    return out


def spread(
    sigma: np.ndarray, vehicle: Vehicle, unknown: Sequence[Unknown], scale: float
) -> np.ndarray:
    """Sigmas (P) of readings with what the panels' own turns add to those of their noise, for the search, which does not know
    these: the root mean square over panels and over Suns in front of them."""
    own = [x for x in unknown if x.kind == KIND]
    off = (np.cross(turns(vehicle, own), vehicle.panel_normals_B) ** 2).sum(
        axis=(0, 2)
    ) / 2  # to each side
    size = np.sqrt(np.mean(off * vehicle.panel_gains**2) * LIT_SINE) if len(off) else 0.0
    return np.hypot(sigma, size * scale) if size else sigma


def told(priors: Mapping[str, Any], vehicle: Vehicle) -> tuple[np.ndarray, float, dict[str, str]]:
    """Sigmas of `unknowns`, given or stated, and the words for that; what is given is checked by the caller."""
    own, common = misalignment_sigma(vehicle)
    own = np.full(len(own), float(priors["tilt"])) if "tilt" in priors else own
    common = float(priors.get("tilt_common", common))
    sizes = {"tilt": float(own.max(initial=0.0)), "tilt_common": common}
    sources = {
        key: "given" if key in priors else "vehicle file" if size else "assumed"
        for key, size in sizes.items()
    }
    return (
        own,
        common,
        {key: f"{np.degrees(size):.3g} deg ({sources[key]})" for key, size in sizes.items()},
    )
