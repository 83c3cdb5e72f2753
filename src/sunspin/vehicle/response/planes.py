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

Cube = frozenset
"""A clause as a set, in which conditions can be removed."""


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
        lit = sun_B @ self.normals_B.T > 0
        clauses = [
            np.all([lit[..., k] == side for k, side in clause], axis=0) for clause in self.clauses
        ]
        return np.any([np.broadcast_to(clause, lit.shape[:-1]) for clause in clauses], axis=0)

    @property
    def kernel_data(self) -> np.ndarray:
        """Components of the normals in one row, as compiled code reads them (float32)."""
        return np.asarray(self.normals_B, dtype=np.float32).ravel()


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
    """Return the arrangement of the planes with these normals on the sphere of directions."""
    p = np.array(normals)
    # vertices: the two opposite directions in which two planes meet
    vertices: list[np.ndarray] = []
    for i, j in np.argwhere(np.tri(len(p), k=-1)):
        line = np.cross(p[i], p[j])
        length = np.linalg.norm(line)
        for vertex in (line / length, -line / length) if length > ON_PLANE else ():
            if not vertices or np.max(np.array(vertices) @ vertex) < 1 - 1e-12:
                vertices.append(vertex)
    vertex_B = np.array(vertices).reshape(-1, 3)
    # arcs: the vertices in a plane divide its great circle
    arcs, planes, cells = [], [], []
    for k, normal in enumerate(p):
        basis = plane_basis(normal)
        on_circle = vertex_B[np.abs(vertex_B @ normal) < ON_PLANE] @ basis
        if len(on_circle) == 0:
            arcs.append(basis[:, 0])
        else:
            angles = np.sort(np.arctan2(on_circle[:, 1], on_circle[:, 0]))
            middles = (angles + np.append(angles[1:], angles[0] + 2 * np.pi)) / 2
            arcs += [basis @ [np.cos(angle), np.sin(angle)] for angle in middles]
        planes += [k] * (len(arcs) - len(planes))
    # cells: a step from an arc to each side, shorter than the distance to any plane, ends in a cell
    for arc, k in zip(arcs, planes, strict=True):
        distances = np.abs(p @ arc)
        room = np.min(distances[distances > ON_PLANE], initial=1.0) / 2
        for direction in (arc + room * p[k], arc - room * p[k]):
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

    Conditions are removed greedily, and then a small cover of `good` is chosen greedily. The result is short, not always
    shortest.
    """
    patterns: list[Cube] = [frozenset(enumerate(lit.tolist())) for lit in good]
    shortened = set()
    # remove conditions, those of dark panels first, as long as every pattern of `bad` still violates one
    for cube in patterns:
        differs = bad != [lit for _, lit in sorted(cube)]
        kept = differs.sum(axis=1)  # number of conditions that each pattern of `bad` violates
        for literal in sorted(cube, key=lambda item: (item[1], item[0])):
            violated = kept - differs[:, literal[0]]
            if np.all(violated > 0):
                cube, kept = cube - {literal}, violated
        shortened.add(cube)
    cubes = sorted(shortened, key=lambda cube: (len(cube), sorted(cube)))
    holds = np.array([[cube <= pattern for pattern in patterns] for cube in cubes])
    uncovered, chosen = np.ones(len(patterns), dtype=bool), []
    # greedy cover: the clause that holds for most of the remaining patterns
    while uncovered.any():
        best = int(np.argmax((holds & uncovered).sum(axis=1)))
        chosen.append(tuple(sorted(cubes[best])))
        uncovered &= ~holds[best]
    return tuple(chosen)
