"""Rotations of many vectors and attitudes, on SciPy's; attitudes are matrices B_from_N, turns rotation vectors of the body."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sunspin.base.lazy import lazy

if TYPE_CHECKING:
    from scipy.spatial import transform
else:
    transform = lazy("scipy.spatial.transform")


def cross_matrix(v: np.ndarray) -> np.ndarray:
    """[v]x (..., 3, 3): [v]x b = v x b."""
    zero = np.zeros_like(v[..., 0])
    rows = [[zero, -v[..., 2], v[..., 1]], [v[..., 2], zero, -v[..., 0]], [-v[..., 1], v[..., 0], zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def turn(matrix: np.ndarray, angle_B: np.ndarray) -> np.ndarray:
    """Attitudes (..., 3, 3), B_from_N, turned by small or large rotation vectors (..., 3) of the body, in body axes."""
    shape = np.broadcast_shapes(matrix.shape[:-2], angle_B.shape[:-1])
    flat = transform.Rotation.from_rotvec(-np.broadcast_to(angle_B, (*shape, 3)).reshape(-1, 3)).as_matrix()
    return flat.reshape(*shape, 3, 3) @ matrix


def turn_between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Rotation vectors (..., 3) of the body that :func:`turn` needs to go from attitude `start` to `end`."""
    relative = end @ np.swapaxes(start, -1, -2)
    return -transform.Rotation.from_matrix(relative.reshape(-1, 3, 3)).as_rotvec().reshape(*relative.shape[:-2], 3)


def seen_turned(vector: np.ndarray, angle_B: np.ndarray) -> np.ndarray:
    """Components (..., 3) in body axes of vectors (..., 3) fixed in space after the body has turned by `angle_B` (..., 3)."""
    shape = np.broadcast_shapes(vector.shape, angle_B.shape)
    flat = np.array(np.broadcast_to(vector, shape)).reshape(-1, 3)
    return transform.Rotation.from_rotvec(-np.broadcast_to(angle_B, shape).reshape(-1, 3)).apply(flat).reshape(shape)


def smallest_turn(a: np.ndarray, b: np.ndarray, x: np.ndarray) -> np.ndarray:
    """x (n, 3) under the smallest rotation that takes the unit vectors a to b."""
    v, c = np.cross(a, b), np.sum(a * b, axis=1, keepdims=True)
    return x + np.cross(v, x) + np.cross(v, np.cross(v, x)) / np.maximum(1 + c, 1e-9)


def tangents(unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (n, 3) that make a right-handed frame with each direction (n, 3)."""
    other = np.where(np.abs(unit[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = _cross(unit, other)
    first = first / np.linalg.norm(first, axis=1, keepdims=True)
    return first, _cross(unit, first)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """NumPy's `cross` of vectors (n, 3), bit by bit; for few of them it takes several times as long."""
    out = np.empty(a.shape)
    for k, i, j in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[:, k] = a[:, i] * b[:, j] - a[:, j] * b[:, i]
    return out


def moved(unit: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Directions (n, 3) moved along great circles by tangent vectors (n, 2) in the frame of `tangents`."""
    e1, e2 = tangents(unit)
    angle = np.linalg.norm(step, axis=1, keepdims=True)
    along = (step[:, :1] * e1 + step[:, 1:] * e2) * np.sinc(angle / np.pi)
    out = np.cos(angle) * unit + along
    return out / np.linalg.norm(out, axis=1, keepdims=True)
