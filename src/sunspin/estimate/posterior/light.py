"""How a vehicle's inputs see light inside compiled code: numbers, the functions that read them, and nodes on the sphere."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from sunspin.dynamics.processor import njit
from sunspin.vehicle import Vehicle

BEYOND = 0.1
"""A dark panel has a slope up to this cosine beyond its edge: what settles there finds into the light."""

jit = njit(nogil=True, cache=True)


class Light(NamedTuple):
    """`gains` (n_input): full signals; panels in the order of their inputs, those of input k from `first[k]` to `first[k + 1]`:
    unit normals `normals_B` (n_panel, 3) and `parts` (n_panel), gains over the full signal of their input; `largest` (n_input):
    whether the largest of them is read and not their sum; `turns` (n_angle, 2): cosine and sine of the angles of the bounds."""

    gains: np.ndarray
    first: np.ndarray
    normals_B: np.ndarray
    parts: np.ndarray
    largest: np.ndarray
    turns: np.ndarray


def light_of(vehicle: Vehicle, angles: tuple[float, ...]) -> Light:
    """The same of a vehicle, for bounds within `angles` (rad)."""
    inputs, full = vehicle.inputs, np.array(vehicle.input_gains)
    panels = np.concatenate([np.array(each.panels) for each in inputs])
    counts = [len(each.panels) for each in inputs]
    return Light(
        full,
        np.cumsum([0, *counts]),
        vehicle.panel_normals_B[panels],
        vehicle.panel_gains[panels] / np.repeat(full, counts),
        np.array([each.largest for each in inputs]),
        np.stack([np.cos(angles), np.sin(angles)], axis=1),
    )


@jit
def seen(light, k, x, y, z):
    """What input k reads over its full signal for a Sun in this direction, and its slope; of dark panels that of the nearest to
    the light."""
    share, a, b, c = 0.0, 0.0, 0.0, 0.0
    nearest = -BEYOND
    for p in range(light.first[k], light.first[k + 1]):
        part, n = light.parts[p], light.normals_B[p]
        cosine = n[0] * x + n[1] * y + n[2] * z
        if cosine > 0.0 and not light.largest[k]:
            if share == 0.0:
                a, b, c = 0.0, 0.0, 0.0
            share += part * cosine
            a, b, c = a + part * n[0], b + part * n[1], c + part * n[2]
        elif cosine > 0.0:
            if part * cosine > share:
                share, a, b, c = part * cosine, part * n[0], part * n[1], part * n[2]
        elif share == 0.0 and cosine > nearest:
            nearest, a, b, c = cosine, part * n[0], part * n[1], part * n[2]
    return share, a, b, c


@jit
def between(light, angle, k, x, y, z):
    """Bounds of what input k reads over its full signal for any Sun within angle number `angle` of this direction."""
    cos, sin = light.turns[angle, 0], light.turns[angle, 1]
    low, high = 0.0, 0.0
    for p in range(light.first[k], light.first[k + 1]):
        part, n = light.parts[p], light.normals_B[p]
        cosine = min(1.0, max(-1.0, n[0] * x + n[1] * y + n[2] * z))
        sine = np.sqrt(1.0 - cosine * cosine)
        up = 1.0 if cosine > cos else cosine * cos + sine * sin
        down = -1.0 if cosine < -cos else cosine * cos - sine * sin
        if light.largest[k]:
            low, high = max(low, part * down), max(high, part * up)
        else:
            low, high = low + part * max(down, 0.0), high + part * max(up, 0.0)
    return low, min(high, 1.0)


@lru_cache(maxsize=8)
def nodes(size: int) -> np.ndarray:
    """Directions (6 (size + 1)^2, 3) on the faces +x, -x, +y, -y, +z, -z of a cube, on each the next two axes along rows and
    columns."""
    side = np.linspace(-1, 1, size + 1)
    u, v = np.meshgrid(side, side, indexing="ij")
    faces = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            face = np.empty((size + 1, size + 1, 3))
            face[..., axis], face[..., (axis + 1) % 3], face[..., (axis + 2) % 3] = sign, u, v
            faces.append(face.reshape(-1, 3))
    every = np.concatenate(faces)
    every /= np.linalg.norm(every, axis=1, keepdims=True)
    every.setflags(write=False)
    return every


@jit
def nearest_node(size, x, y, z):
    """The number of the node nearest to a direction of any length."""
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        face, top, u, v, sign = 0, ax, y, z, x
    elif ay >= az:
        face, top, u, v, sign = 2, ay, z, x, y
    else:
        face, top, u, v, sign = 4, az, x, y, z
    if sign < 0:
        face += 1
    row, column = (u / top + 1) * (size / 2), (v / top + 1) * (size / 2)
    row = row if row > 0 else 0.0  # a number that is none has a node, too
    column = column if column > 0 else 0.0
    i, j = int(min(row, size - 1)), int(min(column, size - 1))
    at = face * (size + 1) * (size + 1) + i * (size + 1) + j
    return at + (size + 1 if row - i > 0.5 else 0) + (1 if column - j > 0.5 else 0)
