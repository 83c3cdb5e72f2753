"""Numbers on the sphere as a table on the six faces of a cube, and its one compiled reader."""

from __future__ import annotations

from functools import lru_cache
from inspect import getsource
from typing import NamedTuple

import numpy as np

from sunspin.compute.compiler import njit


class SphereTable(NamedTuple):
    """Powers and slopes for any direction, as shares of each panel's gain: `numbers` (6 (size + 1)^2, n_panel, 4) in float32, of
    each the power and its slope along the sphere (3, B).

    `error`: the largest difference from the law beside edges (of the powers); `edges`: the part of the sphere beside edges, where a
    panel is lit at one corner of a cell and dark at another, or its power jumps.
    """

    size: int
    numbers: np.ndarray
    error: float
    edges: float

    def read(self, sun_B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Shares (..., n_panel) and slopes (..., n_panel, 3) at directions (..., 3)."""
        flat = np.ascontiguousarray(sun_B, dtype=np.float32).reshape(-1, 3)
        out = np.empty((len(flat), self.numbers.shape[1] * 4), dtype=np.float32)
        read_all(self.size, self.numbers.ravel(), flat, out)
        found = out.reshape(*sun_B.shape[:-1], -1, 4)
        return found[..., 0], found[..., 1:]


@lru_cache(maxsize=8)
def nodes(size: int) -> np.ndarray:
    """Directions (6 (size + 1)^2, 3) of the nodes: faces +x, -x, +y, -y, +z, -z, on each the next two axes along rows and
    columns."""
    side = np.linspace(-1, 1, size + 1)
    u, v = np.meshgrid(side, side, indexing="ij")
    found = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            face = np.empty((size + 1, size + 1, 3))
            face[..., axis], face[..., (axis + 1) % 3], face[..., (axis + 2) % 3] = sign, u, v
            found.append(face.reshape(-1, 3))
    every = np.concatenate(found)
    every /= np.linalg.norm(every, axis=1, keepdims=True)
    every.setflags(write=False)
    return every


jit = njit(nogil=True, cache=True)


@jit
def place(size, x, y, z):
    """The first corner of the cell that a direction of any length lies in, and how far in it lies along rows and columns."""
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        face, top, u, v, sign = 0, ax, y, z, x
    elif ay >= az:
        face, top, u, v, sign = 2, ay, z, x, y
    else:
        face, top, u, v, sign = 4, az, x, y, z
    if sign < 0:
        face += 1
    half = size / 2
    row, column = (u / top + 1) * half, (v / top + 1) * half
    row, column = (
        row if row > 0 else 0.0,
        column if column > 0 else 0.0,
    )  # a number that is none is in the table, too
    i, j = int(min(row, size - 1)), int(min(column, size - 1))
    return face * (size + 1) * (size + 1) + i * (size + 1) + j, row - i, column - j


@jit
def read(size, numbers, columns, k, x, y, z):
    """Column k of a table of 6 (size + 1)^2 rows of `columns` numbers, at a direction: linear along rows and columns."""
    at, u, v = place(size, x, y, z)
    first, second = at * columns + k, (at + size + 1) * columns + k
    below = (1 - v) * numbers[first] + v * numbers[first + columns]
    above = (1 - v) * numbers[second] + v * numbers[second + columns]
    return (1 - u) * below + u * above


TEXT = "\n\n".join(getsource(reader.py_func) for reader in (place, read))
"""The reader as text, for kernels: compiled with their settings."""


def size_of(rows: int) -> int:
    """Cells along an edge of the cube of a table of 6 (size + 1)^2 rows."""
    return round((rows / 6) ** 0.5) - 1


def read_one(table: np.ndarray, sun_B: np.ndarray) -> np.ndarray:
    """A table (6 (size + 1)^2) of one number at directions (..., 3)."""
    flat = np.ascontiguousarray(sun_B, dtype=np.float32).reshape(-1, 3)
    out = np.empty((len(flat), 1), dtype=np.float32)
    read_all(size_of(len(table)), table, flat, out)
    return out.reshape(sun_B.shape[:-1])


@jit
def read_all(size, numbers, sun, out):
    """Every column of a table (as one row of numbers) at directions (n, 3)."""
    columns = out.shape[1]
    for i in range(len(sun)):
        finite = np.isfinite(sun[i, 0] + sun[i, 1] + sun[i, 2])
        for k in range(columns):
            out[i, k] = (
                read(size, numbers, columns, k, sun[i, 0], sun[i, 1], sun[i, 2])
                if finite
                else np.nan
            )
