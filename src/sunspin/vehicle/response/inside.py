"""A response inside compiled code: numbers, and the functions that read them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sunspin.compute.compiler import compiled_with
from sunspin.vehicle.response import cube
from sunspin.vehicle.response.cube import SphereTable, place, size_of

BEYOND = 0.1
"""The cosine's law has a slope up to this cosine beyond a panel's edge: what settles there finds into the light."""

jit = compiled_with(cube)


class Inside(NamedTuple):
    """`normals_B` (n_panel, 3) and `gains` (n_panel); `turns` (n_angle, 2): cosine and sine of the angles of the bounds.

    Of a law other than the cosine's also `table`, the numbers of a `SphereTable` of `size` cells, and `caps` (n_angle,
    6 (cap_size + 1)^2, n_panel, 2): least and largest share within each angle of what lies nearest to a node. Else sizes are 0.
    """

    normals_B: np.ndarray
    gains: np.ndarray
    turns: np.ndarray
    size: int
    table: np.ndarray
    cap_size: int
    caps: np.ndarray

    @classmethod
    def of(
        cls,
        normals_B: np.ndarray,
        gains: np.ndarray,
        angles: tuple[float, ...],
        table: SphereTable | None = None,
        caps: list[np.ndarray] | None = None,
    ) -> Inside:
        """The same for bounds within `angles` (rad): of the cosine's law, or by the tables of another."""
        turns = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        size, numbers = (
            (0, np.zeros(0, np.float32)) if table is None else (table.size, table.numbers.ravel())
        )
        over = np.zeros((0, 0, 0, 2), np.float32) if caps is None else np.stack(caps)
        cap_size = 0 if caps is None else size_of(over.shape[1])
        return cls(np.array(normals_B), np.array(gains), turns, size, numbers, cap_size, over)


@jit
def seen(law, k, x, y, z):
    """The power of panel k over its gain for a Sun in this direction, and its slope."""
    if law.size == 0:
        a, b, c = law.normals_B[k, 0], law.normals_B[k, 1], law.normals_B[k, 2]
        cosine = a * x + b * y + c * z
        if cosine <= -BEYOND:
            return 0.0, 0.0, 0.0, 0.0
        return max(cosine, 0.0), a, b, c
    at, u, v = place(law.size, x, y, z)
    row = 4 * len(law.gains)
    p, q = at * row + 4 * k, (at + law.size + 1) * row + 4 * k
    wp, wr, wq, ws, t = (1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v, law.table
    return (
        wp * t[p] + wr * t[p + row] + wq * t[q] + ws * t[q + row],
        wp * t[p + 1] + wr * t[p + row + 1] + wq * t[q + 1] + ws * t[q + row + 1],
        wp * t[p + 2] + wr * t[p + row + 2] + wq * t[q + 2] + ws * t[q + row + 2],
        wp * t[p + 3] + wr * t[p + row + 3] + wq * t[q + 3] + ws * t[q + row + 3],
    )


@jit
def between(law, angle, k, x, y, z):
    """Least and largest power of panel k over its gain for any Sun within angle number `angle` of this direction."""
    if law.size == 0:
        cos, sin, n = law.turns[angle, 0], law.turns[angle, 1], law.normals_B
        cosine = min(1.0, max(-1.0, n[k, 0] * x + n[k, 1] * y + n[k, 2] * z))
        sine = np.sqrt(1.0 - cosine * cosine)
        up = 1.0 if cosine > cos else cosine * cos + sine * sin
        down = -1.0 if cosine < -cos else cosine * cos - sine * sin
        return max(down, 0.0), max(up, 0.0)
    node = nearest_node(law.cap_size, x, y, z)
    return float(law.caps[angle, node, k, 0]), float(law.caps[angle, node, k, 1])


@jit
def nearest_node(size, x, y, z):
    at, u, v = place(size, x, y, z)
    return at + (size + 1 if u > 0.5 else 0) + (1 if v > 0.5 else 0)


@jit
def nearest(size, sun):
    """The numbers (n) of the nodes of a cube of `size` cells nearest to directions (n, 3)."""
    found = np.empty(len(sun), np.int64)
    for i in range(len(sun)):
        found[i] = nearest_node(size, sun[i, 0], sun[i, 1], sun[i, 2])
    return found


@jit
def over_caps(where, cosine, looks, least, most):
    """Of bounds `least`, `most` (m, n_panel) at directions `looks` (m, 3) the least and largest (n, n_panel, 2) within the angle of
    this cosine about each of `where` (n, 3)."""
    found = np.empty((len(where), least.shape[1], 2), np.float32)
    found[:, :, 0], found[:, :, 1] = np.inf, -np.inf
    for i in range(len(where)):
        for m in range(len(looks)):
            if (
                where[i, 0] * looks[m, 0] + where[i, 1] * looks[m, 1] + where[i, 2] * looks[m, 2]
                >= cosine
            ):
                for k in range(least.shape[1]):
                    found[i, k, 0] = min(found[i, k, 0], least[m, k])
                    found[i, k, 1] = max(found[i, k, 1], most[m, k])
    return found
