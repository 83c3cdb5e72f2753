"""How the planes of flat panels cut the sphere of directions: which panels can be lit together, and a short formula for some."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from sunspin.vehicle.response.protocol import Literals

ON_PLANE = 1e-9
"""A direction this close to a panel's plane counts as lying in it (cosine of the angle to the normal)."""

Cube = frozenset  # of (panel index, lit?): all must hold


class Arrangement(NamedTuple):
    """How the planes of the panels cut the sphere: one interior direction per open cell, arc and vertex, and what is lit.

    Directions are (n, 3); `lit` arrays are (n, n_panel) of bool; `arc_plane` (n_arc) is the panel in whose plane an arc lies.
    """

    cell_B: np.ndarray
    cell_lit: np.ndarray
    arc_B: np.ndarray
    arc_lit: np.ndarray
    arc_plane: np.ndarray
    vertex_B: np.ndarray


@lru_cache(maxsize=64)
def arrangement(normals: tuple[tuple[float, float, float], ...]) -> Arrangement:
    """The arrangement of great circles that the planes of panels with these normals make on the sphere of directions."""
    p = np.array(normals)
    vertices = _vertices(p)
    arcs, planes = [], []
    for k in range(len(p)):
        for direction in _arc_midpoints(p[k], vertices):
            arcs.append(direction)
            planes.append(k)
    arc_B = np.array(arcs).reshape(-1, 3)
    cell_B = _cells(p, arc_B, np.array(planes, dtype=int))
    return Arrangement(
        cell_B,
        cell_B @ p.T > ON_PLANE,
        arc_B,
        arc_B @ p.T > ON_PLANE,
        np.array(planes, dtype=int),
        vertices,
    )


def _distinct(directions: np.ndarray) -> np.ndarray:
    kept: list[np.ndarray] = []
    for direction in directions:
        if not kept or np.max(np.array(kept) @ direction) < 1 - 1e-12:
            kept.append(direction)
    return np.array(kept).reshape(-1, 3)


def _vertices(p: np.ndarray) -> np.ndarray:
    """Directions in which two planes meet, both signs."""
    found = []
    for i in range(len(p)):
        for j in range(i):
            line = np.cross(p[i], p[j])
            length = np.linalg.norm(line)
            if length > ON_PLANE:
                found += [line / length, -line / length]
    return _distinct(np.array(found).reshape(-1, 3))


def plane_basis(normal: np.ndarray) -> np.ndarray:
    """Two orthonormal vectors (3, 2) that span the plane of a normal."""
    return np.linalg.svd(normal[None])[2][1:].T


def _arc_midpoints(normal: np.ndarray, vertices: np.ndarray) -> list[np.ndarray]:
    """The middle of each arc into which the vertices cut the great circle of a plane."""
    basis = plane_basis(normal)
    on_circle = vertices[np.abs(vertices @ normal) < ON_PLANE]
    if len(on_circle) == 0:
        return [basis[:, 0]]
    angles = np.sort(np.arctan2(on_circle @ basis[:, 1], on_circle @ basis[:, 0]))
    middles = (angles + np.append(angles[1:], angles[0] + 2 * np.pi)) / 2
    return [basis @ [np.cos(angle), np.sin(angle)] for angle in middles]


def _cells(p: np.ndarray, arcs: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """An interior direction of each open cell: step off the middle of each arc to both sides of its plane."""
    found = []
    for arc, k in zip(arcs, planes, strict=True):
        distances = np.abs(p @ arc)
        room = np.min(distances[distances > ON_PLANE], initial=1.0) / 2
        for side in (1.0, -1.0):
            direction = arc + side * room * p[k]
            found.append(direction / np.linalg.norm(direction))
    lit = np.array(found).reshape(-1, 3) @ p.T > 0
    _, first = np.unique(lit, axis=0, return_index=True)
    return np.array(found)[np.sort(first)]


def formula(good: np.ndarray, bad: np.ndarray) -> tuple[Literals, ...]:
    """A short disjunction of conjunctions that holds for the sets of lit panels `good` (m, n_panel) and for none of `bad`."""
    wanted = [_cube(lit) for lit in good]
    cubes = {_shorten(cube, bad) for cube in wanted}
    return tuple(
        tuple(sorted(cube))
        for cube in _cover(sorted(cubes, key=lambda cube: (len(cube), sorted(cube))), wanted)
    )


def _cube(lit: np.ndarray) -> Cube:
    return frozenset(enumerate(lit.tolist()))


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
