"""Geometry of flat panels: how their planes cut the sphere of directions, and short descriptions of sets of cells."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

Clause = tuple[tuple[int, bool], ...]
"""A conjunction of conditions (index of a plane, True for the side of its normal)."""

ON_PLANE = 1e-9
"""A direction with a smaller component along the normal is in the plane."""

Conditions = frozenset[tuple[int, bool]]
"""A clause as a set, from which conditions can be removed."""


@dataclass(frozen=True)
class DirectionSet:
    """A set of directions as data, for compiled kernels and for Python.

    A direction belongs to it if it satisfies one of the `clauses`. Each is a conjunction of conditions on the sides of planes
    with normals `normals_B` (n, 3). Kernels evaluate it as a signed function: the maximum over the clauses of the minimum of
    the distances from the planes.
    """

    normals_B: np.ndarray
    clauses: tuple[Clause, ...]

    def contains(self, sun_B: np.ndarray) -> np.ndarray:
        """Return whether each direction (..., 3) belongs to the set."""
        on_side = sun_B @ self.normals_B.T > 0  # (..., n): on the side of each plane's normal
        holds = [
            np.all([on_side[..., k] == side for k, side in clause], axis=0)
            for clause in self.clauses
        ]
        # a clause without conditions is a single True
        return np.any([np.broadcast_to(each, on_side.shape[:-1]) for each in holds], axis=0)


def sphere(n: int) -> np.ndarray:
    """Return n nearly evenly spread directions (n, 3), by the Fibonacci spiral."""
    z = 1 - (2 * np.arange(n) + 1) / n
    longitude = np.pi * (1 + np.sqrt(5)) * np.arange(n)
    return np.stack(
        [np.sqrt(1 - z**2) * np.cos(longitude), np.sqrt(1 - z**2) * np.sin(longitude), z], axis=-1
    )


class Arrangement(NamedTuple):
    """Cells, arcs and vertices into which the planes of the panels cut the sphere.

    Each cell and arc has one interior direction (n, 3) and its lit panels (n, n_panel); `arc_plane` (n_arc) is the index of the
    panel in whose plane the arc lies.
    """

    cell_B: np.ndarray
    cell_lit: np.ndarray
    arc_B: np.ndarray
    arc_lit: np.ndarray
    arc_plane: np.ndarray
    vertex_B: np.ndarray


@lru_cache(maxsize=64)
def arrangement(normals: tuple[tuple[float, float, float], ...]) -> Arrangement:
    """Return the arrangement of the planes with these unit normals on the sphere of directions.

    All planes contain the centre of the sphere and cut it in great circles.
    """
    p = np.array(normals)  # (n_panel, 3)
    # vertices: the two opposite directions in which two planes meet
    vertices: list[np.ndarray] = []
    for i, j in np.argwhere(np.tri(len(p), k=-1)):
        line = np.cross(p[i], p[j])
        length = np.linalg.norm(line)
        for vertex in (line / length, -line / length) if length > ON_PLANE else ():
            # more than two planes may meet in one vertex, which is kept once
            if not vertices or np.max(np.array(vertices) @ vertex) < 1 - 1e-12:
                vertices.append(vertex)
    vertex_B = np.array(vertices).reshape(-1, 3)
    # arcs: the vertices in a plane divide its great circle
    arcs, planes, cells = [], [], []
    for k, normal in enumerate(p):
        basis = plane_basis(normal)
        on_circle = vertex_B[np.abs(vertex_B @ normal) < ON_PLANE] @ basis
        if len(on_circle) == 0:  # a single plane: its whole circle is one arc
            arcs.append(basis[:, 0])
        else:
            angles = np.sort(np.arctan2(on_circle[:, 1], on_circle[:, 0]))
            middles = (angles + np.append(angles[1:], angles[0] + 2 * np.pi)) / 2
            arcs += [basis @ [np.cos(angle), np.sin(angle)] for angle in middles]
        planes += [k] * (len(arcs) - len(planes))
    # cells: a step from an arc to each side, shorter than the distance to any plane, ends in a cell
    for arc, k in zip(arcs, planes, strict=True):
        distances = np.abs(p @ arc)
        step = np.min(distances[distances > ON_PLANE], initial=1.0) / 2
        for direction in (arc + step * p[k], arc - step * p[k]):
            cells.append(direction / np.linalg.norm(direction))
    cell_B, arc_B = np.array(cells), np.array(arcs).reshape(-1, 3)
    # each cell is reached from several arcs: keep the first direction
    _, first = np.unique(cell_B.reshape(-1, 3) @ p.T > 0, axis=0, return_index=True)
    cell_B = cell_B[np.sort(first)]
    lit, arc_lit = cell_B @ p.T > ON_PLANE, arc_B @ p.T > ON_PLANE
    return Arrangement(cell_B, lit, arc_B, arc_lit, np.array(planes, dtype=int), vertex_B)


def plane_basis(normal: np.ndarray) -> np.ndarray:
    """Return two orthonormal vectors (3, 2) that span the plane with this normal."""
    return np.linalg.svd(normal[None])[2][1:].T


def minimal_clauses(good: np.ndarray, bad: np.ndarray) -> tuple[Clause, ...]:
    """Return few short clauses that hold for all patterns `good` (m, n_panel) and for none of `bad`.

    A pattern has a truth value for each plane: whether a direction is on the side of its normal. Conditions are removed greedily,
    and then a small cover of `good` is chosen greedily. The result is short, not always shortest.
    """
    patterns: list[Conditions] = [frozenset(enumerate(lit.tolist())) for lit in good]
    shortened = set()
    # remove conditions, those of dark panels first, as long as every pattern of `bad` still violates one
    for pattern, lit in zip(patterns, good, strict=True):
        conditions, violates = pattern, bad != lit  # violates: (pattern of `bad`, condition)
        n_violated = violates.sum(axis=1)
        for plane, side in sorted(pattern, key=lambda condition: (condition[1], condition[0])):
            n_without = n_violated - violates[:, plane]
            if np.all(n_without > 0):
                conditions, n_violated = conditions - {(plane, side)}, n_without
        shortened.add(conditions)
    clauses = sorted(shortened, key=lambda clause: (len(clause), sorted(clause)))
    # a clause holds for the patterns that contain all its conditions
    holds = np.array([[clause <= pattern for pattern in patterns] for clause in clauses])
    uncovered, chosen = np.ones(len(patterns), dtype=bool), []
    # greedy cover: the clause that holds for most of the remaining patterns
    while uncovered.any():
        best = int(np.argmax((holds & uncovered).sum(axis=1)))
        chosen.append(tuple(sorted(clauses[best])))
        uncovered &= ~holds[best]
    return tuple(chosen)
