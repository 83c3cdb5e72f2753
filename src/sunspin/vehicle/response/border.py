"""A part of the sphere as a signed number: the angle to its border, above 0 inside, on the table of `cube.py`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sunspin.vehicle.response.cube import nodes
from sunspin.vehicle.response.protocol import sphere

LOOKS = 160_000
"""Directions, half a degree apart, among which the other side of the border is looked for."""

NEAREST, HALVINGS = 12, 25
"""Of these, towards which the border is placed, and how often the way there is halved."""


def angle_to_border(counts: Callable[[np.ndarray], np.ndarray], size: int) -> np.ndarray:
    """The signed angle (rad) in float32 at the nodes of a table of `size` cells along an edge, `counts` saying which directions
    (n, 3) are inside."""
    from scipy.spatial import KDTree

    where, looks = nodes(size), sphere(LOOKS)
    inside, seen = counts(where), counts(looks)
    found = np.where(inside, np.pi, -np.pi)
    for side in (True, False):
        other, mine = looks[seen != side], np.flatnonzero(inside == side)
        if not len(other) or not len(mine):
            continue
        count = min(NEAREST, len(other))
        far, nearest = (
            np.asarray(each).reshape(-1, count)
            for each in KDTree(other).query(where[mine], k=count)
        )
        angle = 2 * np.arcsin(np.clip(far[:, 0] / 2, 0, 1))
        near = angle < 6 * np.pi / (2 * size)
        begin, end = where[mine[near], None], other[nearest[near]]
        low, high = np.zeros(end.shape[:2]), np.ones(end.shape[:2])
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            there = begin + middle[..., None] * (end - begin)
            there /= np.linalg.norm(there, axis=-1, keepdims=True)
            still = counts(there.reshape(-1, 3)).reshape(middle.shape) == side
            low, high = np.where(still, middle, low), np.where(still, high, middle)
        crossing = begin + high[..., None] * (end - begin)
        crossing /= np.linalg.norm(crossing, axis=-1, keepdims=True)
        angle[near] = 2 * np.arcsin(
            np.clip(np.linalg.norm(crossing - begin, axis=-1) / 2, 0, 1)
        ).min(axis=1)
        found[mine] = angle if side else -angle
    return found.astype(np.float32)
