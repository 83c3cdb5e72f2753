"""The forward model of the panels: direction to the Sun -> power; and which panels can be lit together."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sunspin.vehicle import Vehicle

Pattern = frozenset[str]  # of panel names: the lit ones

ON_PLANE = 1e-9
"""A direction this close to a panel's plane counts as lying in it (cosine of the angle to the normal)."""


def panel_power(vehicle: Vehicle, sun_B: npt.ArrayLike) -> np.ndarray:
    """Signal of each panel, ``gain * max(0, normal . sun)`` (paper, eq. 1).

    Parameters
    ----------
    sun_B : (..., 3)
        Direction to the Sun, body axes.

    Returns
    -------
    (..., n_panel) in the unit of the gains (`vehicle.gain_unit`), or relative.
    """
    vehicle.require_panels()
    cosine = np.asarray(sun_B, dtype=np.float64) @ vehicle.panel_normals_B.T
    return vehicle.panel_gains * np.maximum(0.0, cosine)


def sphere(n: int) -> np.ndarray:
    """About evenly spread directions (n, 3), by Fibonacci's spiral."""
    z = 1 - (2 * np.arange(n) + 1) / n
    longitude = np.pi * (1 + np.sqrt(5)) * np.arange(n)
    return np.stack([np.sqrt(1 - z**2) * np.cos(longitude), np.sqrt(1 - z**2) * np.sin(longitude), z], axis=-1)


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


def arrangement(vehicle: Vehicle) -> Arrangement:
    """The arrangement of great circles that the panels' planes make on the sphere of directions."""
    vehicle.require_panels()
    return _arrangement(tuple(map(tuple, vehicle.panel_normals_B.tolist())))


def lit_patterns(vehicle: Vehicle) -> tuple[Pattern, ...]:
    """The sets of panels that the Sun can light together, for directions in no panel's plane (16 for Philae)."""
    names = np.array(vehicle.panel_names)
    patterns = [frozenset(names[lit].tolist()) for lit in arrangement(vehicle).cell_lit]
    return tuple(sorted(set(patterns), key=lambda pattern: (len(pattern), sorted(pattern))))


def observable_patterns(vehicle: Vehicle) -> frozenset[Pattern]:
    """The lit patterns that a measurement can show: those of `lit_patterns`, and those of directions in a panel's plane.

    A panel that the Sun grazes may read as dark, so the patterns of arcs and vertices occur in real data.
    """
    names, parts = np.array(vehicle.panel_names), arrangement(vehicle)
    vertex_lit = parts.vertex_B @ vehicle.panel_normals_B.T > ON_PLANE
    rows = np.concatenate([parts.cell_lit, parts.arc_lit, vertex_lit])
    return frozenset(frozenset(names[lit].tolist()) for lit in rows)


@lru_cache(maxsize=64)
def _arrangement(normals: tuple[tuple[float, float, float], ...]) -> Arrangement:
    p = np.array(normals)
    vertices = _vertices(p)
    arcs, planes = [], []
    for k in range(len(p)):
        for direction in _arc_midpoints(p[k], vertices):
            arcs.append(direction)
            planes.append(k)
    arc_B = np.array(arcs).reshape(-1, 3)
    cell_B = _cells(p, arc_B, np.array(planes, dtype=int))
    return Arrangement(cell_B, cell_B @ p.T > ON_PLANE, arc_B, arc_B @ p.T > ON_PLANE, np.array(planes, dtype=int), vertices)


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
