"""How the planes of flat panels cut the sphere of directions: which panels can be lit together, and a short formula for some."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

Clause = tuple[tuple[int, bool], ...]
"""A conjunction: (panel index, lit?) ..."""

ON_PLANE = 1e-9
"""A direction this close to a panel's plane counts as lying in it (cosine of the angle to the normal)."""

Cube = frozenset  # of (panel index, lit?): all must hold


@dataclass(frozen=True)
class DirectionSet:
    """A signed function on the sphere, above 0 where a direction counts: as data, for kernels and for Python.

    It is the largest over `clauses` of the smallest of distances from the planes of `normals_B` (n, 3), each clause a conjunction
    of (number of the plane, which side?).
    """

    normals_B: np.ndarray
    clauses: tuple[Clause, ...]

    def contains(self, sun_B: np.ndarray) -> np.ndarray:
        """Whether each direction (..., 3) counts."""
        lit = sun_B @ self.normals_B.T > 0
        clauses = [
            np.all([lit[..., k] == wanted for k, wanted in clause], axis=0)
            for clause in self.clauses
        ]
        return np.any([np.broadcast_to(clause, lit.shape[:-1]) for clause in clauses], axis=0)

    @property
    def kernel_data(self) -> np.ndarray:
        """What compiled code reads, in float32."""
        return np.asarray(self.normals_B, dtype=np.float32).ravel()


def sphere(n: int) -> np.ndarray:
    """About evenly spread directions (n, 3), by Fibonacci's spiral."""
    z = 1 - (2 * np.arange(n) + 1) / n
    longitude = np.pi * (1 + np.sqrt(5)) * np.arange(n)
    return np.stack(
        [np.sqrt(1 - z**2) * np.cos(longitude), np.sqrt(1 - z**2) * np.sin(longitude), z], axis=-1
    )


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
    vertices: list[np.ndarray] = []  # directions in which two planes meet, both signs
    for i, j in np.argwhere(np.tri(len(p), k=-1)):
        line = np.cross(p[i], p[j])
        length = np.linalg.norm(line)
        for vertex in (line / length, -line / length) if length > ON_PLANE else ():
            if not vertices or np.max(np.array(vertices) @ vertex) < 1 - 1e-12:
                vertices.append(vertex)
    vertex_B = np.array(vertices).reshape(-1, 3)
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
    for arc, k in zip(arcs, planes, strict=True):  # a step to both sides of an arc ends in a cell
        distances = np.abs(p @ arc)
        room = np.min(distances[distances > ON_PLANE], initial=1.0) / 2
        for direction in (arc + room * p[k], arc - room * p[k]):
            cells.append(direction / np.linalg.norm(direction))
    cell_B, arc_B = np.array(cells), np.array(arcs).reshape(-1, 3)
    _, first = np.unique(cell_B.reshape(-1, 3) @ p.T > 0, axis=0, return_index=True)
    cell_B = cell_B[np.sort(first)]
    lit, arc_lit = cell_B @ p.T > ON_PLANE, arc_B @ p.T > ON_PLANE
    return Arrangement(cell_B, lit, arc_B, arc_lit, np.array(planes, dtype=int), vertex_B)


def plane_basis(normal: np.ndarray) -> np.ndarray:
    """Two orthonormal vectors (3, 2) that span the plane of a normal."""
    return np.linalg.svd(normal[None])[2][1:].T


def minimal_clauses(good: np.ndarray, bad: np.ndarray) -> tuple[Clause, ...]:
    """A short disjunction of conjunctions that holds for the sets of lit panels `good` (m, n_panel) and for none of `bad`."""
    wanted: list[Cube] = [frozenset(enumerate(lit.tolist())) for lit in good]
    shortened = set()
    for (
        cube
    ) in wanted:  # without conditions, of dark panels first, as long as nothing of `bad` slips in
        differs = bad != [lit for _, lit in sorted(cube)]
        kept = differs.sum(axis=1)  # conditions that keep each unwanted pattern out
        for literal in sorted(cube, key=lambda item: (item[1], item[0])):
            less = kept - differs[:, literal[0]]
            if np.all(less > 0):
                cube, kept = cube - {literal}, less
        shortened.add(cube)
    cubes = sorted(shortened, key=lambda cube: (len(cube), sorted(cube)))
    holds = np.array([[cube <= pattern for pattern in wanted] for cube in cubes])
    left, chosen = np.ones(len(wanted), dtype=bool), []
    while left.any():  # few of them that together hold every wanted pattern
        best = int(np.argmax((holds & left).sum(axis=1)))
        chosen.append(tuple(sorted(cubes[best])))
        left &= ~holds[best]
    return tuple(chosen)
