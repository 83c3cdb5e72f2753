"""From the panels' rule of what can be reconstructed to a signed function of directions, for the simulated side.

A simulated track is compared with measured directions only where the Sun could have been reconstructed (paper, section 2.3).
The measuring side says which lit patterns allow that; the panels' response makes of them data that the kernel evaluates at every
step: a short logical formula, or a table of the sphere.
"""

from __future__ import annotations

import numpy as np

from sunspin.base.errors import InputError
from sunspin.telemetry.sun import reconstructible_patterns
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import lit_patterns
from sunspin.vehicle.response.planes import DirectionSet


def reconstructible_mask(vehicle: Vehicle) -> DirectionSet:
    """The directions of the Sun that this vehicle's panels would allow to reconstruct."""
    names = vehicle.input_names
    possible = [frozenset(pattern) for pattern in lit_patterns(vehicle)]
    good = reconstructible_patterns(vehicle)
    wanted = [pattern for pattern in possible if pattern in good]
    if not wanted:
        raise InputError(
            f"no direction of the Sun can be reconstructed with the panels of {vehicle.name!r}",
            do="three lit panels with independent normals are needed somewhere",
        )
    unwanted = [pattern for pattern in possible if pattern not in set(wanted)]
    good, bad = (
        np.array([[name in pattern for name in names] for pattern in some], dtype=bool).reshape(
            -1, len(names)
        )
        for some in (wanted, unwanted)
    )
    return vehicle.response_in().direction_set(good, bad)


def allows(mask: DirectionSet, sun_B: np.ndarray) -> np.ndarray:
    """Whether the mask allows each direction sun_B (..., 3)."""
    return mask.contains(np.asarray(sun_B))
