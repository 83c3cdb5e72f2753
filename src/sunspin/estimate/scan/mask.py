"""From the panels' rule of what can be reconstructed to a short test on directions, for the simulated side.

A simulated track is compared with measured directions only where the Sun could have been reconstructed (paper, section 2.3).
The measuring side says which lit patterns allow that; here the patterns become a short logical formula that the kernel
evaluates at every step.
"""

from __future__ import annotations

import numpy as np

from sunspin.base.errors import InputError, sentence
from sunspin.dynamics.ensemble import Mask
from sunspin.telemetry.sun import reconstructible_patterns
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.cosine import lit_patterns

Cube = frozenset  # of (panel index, lit?): all must hold


def reconstructible_mask(vehicle: Vehicle) -> Mask:
    """The directions of the Sun that this vehicle's panels would allow to reconstruct."""
    names = vehicle.panel_names
    possible = [frozenset(pattern) for pattern in lit_patterns(vehicle)]
    good = reconstructible_patterns(vehicle)
    wanted = [pattern for pattern in possible if pattern in good]
    if not wanted:
        raise InputError(
            sentence(
                f"no direction of the Sun can be reconstructed with the panels of {vehicle.name!r}",
                do="three lit panels with independent normals are needed somewhere",
            )
        )
    unwanted = [pattern for pattern in possible if pattern not in set(wanted)]
    others = np.array([[name in pattern for name in names] for pattern in unwanted], dtype=bool).reshape(-1, len(names))
    cubes = {_shorten(_cube(pattern, names), others) for pattern in wanted}
    chosen = _cover(sorted(cubes, key=lambda cube: (len(cube), sorted(cube))), [_cube(p, names) for p in wanted])
    return Mask(vehicle.panel_normals_B, tuple(tuple(sorted(cube)) for cube in chosen))


def _cube(pattern: frozenset, names: tuple[str, ...]) -> Cube:
    return frozenset((k, name in pattern) for k, name in enumerate(names))


def _shorten(cube: Cube, unwanted: np.ndarray) -> Cube:
    """Drop conditions, dark panels first, as long as no unwanted pattern (n, n_panel) that geometry allows slips in."""
    differs = unwanted != [lit for _, lit in sorted(cube)]
    kept = differs.sum(axis=1)  # conditions that keep each unwanted pattern out
    for literal in sorted(cube, key=lambda item: (item[1], item[0])):
        less = kept - differs[:, literal[0]]
        if np.all(less > 0):
            cube, kept = cube - {literal}, less
    return cube


def _cover(cubes: list[Cube], wanted: list[Cube]) -> list[Cube]:
    """Few cubes that together hold every wanted pattern (greedy)."""
    holds = np.array([[cube <= pattern for pattern in wanted] for cube in cubes])
    left, chosen = np.ones(len(wanted), dtype=bool), []
    while left.any():
        best = int(np.argmax((holds & left).sum(axis=1)))
        chosen.append(cubes[best])
        left &= ~holds[best]
    return chosen


def allows(mask: Mask, sun_B: np.ndarray) -> np.ndarray:
    """Whether the mask allows each direction sun_B (..., 3)."""
    lit = sun_B @ mask.normals_B.T > 0
    clauses = [np.all([lit[..., k] == wanted for k, wanted in clause], axis=0) for clause in mask.clauses]
    return np.any([np.broadcast_to(clause, lit.shape[:-1]) for clause in clauses], axis=0)
