"""Rotations of many vectors and attitudes at once.

Attitudes are matrices B_from_N (body from reference frame). Rotations of the body are rotation vectors in body axes B (rad).
`rotate_attitude` and `rotation_between` give the results of SciPy's `Rotation` without its checks, which take most of the time
for small batches (a factor of five).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sunspin.base.lazy import lazy

if TYPE_CHECKING:
    from scipy.spatial import transform
else:
    transform = lazy("scipy.spatial.transform")


def cross_matrix(v: np.ndarray) -> np.ndarray:
    """Return the matrices [v]x (..., 3, 3) with [v]x b = v x b."""
    matrix = np.zeros((*v.shape, 3))
    for k, i, j in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrix[..., i, j], matrix[..., j, i] = -v[..., k], v[..., k]
    return matrix


def rotate_attitude(matrix: np.ndarray, angle_B: np.ndarray) -> np.ndarray:
    """Return attitudes B_from_N (..., 3, 3) after the body has rotated by `angle_B` (..., 3), a rotation vector of any size.

    The matrix exp(-[angle]x) multiplies from the left: a rotation of the body rotates components in B the opposite way.
    """
    square = np.einsum("...i,...i->...", angle_B, angle_B)[..., None, None]
    size = np.sqrt(square)  # angle of the rotation, rad
    # Rodrigues' formula with factors that are finite at zero: sin(size) / size and (1 - cos(size)) / size^2
    sine, versine = np.sinc(size / np.pi), np.sinc(size / (2 * np.pi)) ** 2 / 2
    outer = versine * (angle_B[..., :, None] * angle_B[..., None, :])
    rotation = (1 - versine * square) * np.eye(3) - sine * cross_matrix(angle_B) + outer
    return rotation @ matrix


def rotation_between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the rotation vectors (..., 3) in B by which :func:`rotate_attitude` takes attitude `start` to `end`."""
    q = _long_quaternion(end @ np.swapaxes(start, -1, -2))  # of exp(-[angle]x)
    q = np.where(
        q[..., 3:] < 0, -q, q
    )  # of the two quaternions, that of an angle up to pi; neither has unit length
    sine = np.sqrt(np.einsum("...i,...i->...", q[..., :3], q[..., :3]))[..., None]
    angle = 2 * np.arctan2(sine, q[..., 3:])
    return q[..., :3] * np.where(sine > 0, angle / np.where(sine > 0, sine, 1.0), 0.0)


def _long_quaternion(m: np.ndarray) -> np.ndarray:
    """Return quaternions (..., 4), scalar last and of any length, of the transposes of rotation matrices m (..., 3, 3)."""
    # four times the products q_i q_j of the quaternion's elements; the row with the largest diagonal element is
    # proportional to the quaternion and loses no digits (Shepperd 1978)
    products = np.empty((*m.shape[:-2], 4, 4))
    products[..., :3, :3] = m + np.swapaxes(m, -1, -2)
    trace = m[..., 0, 0] + m[..., 1, 1] + m[..., 2, 2]
    for k, i, j in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        products[..., k, k] += 1 - trace
        products[..., k, 3] = products[..., 3, k] = m[..., i, j] - m[..., j, i]
    products[..., 3, 3] = 1 + trace
    largest = np.argmax(np.einsum("...ii->...i", products), axis=-1)
    rows = products.reshape(-1, 4, 4)[np.arange(largest.size), largest.ravel()]
    return rows.reshape(products.shape[:-1])


def matrix_from_quaternion(quaternion: np.ndarray) -> np.ndarray:
    """Return the matrices (..., 3, 3) of quaternions (..., 4), scalar last, of any length."""
    v, w = quaternion[..., :3], quaternion[..., 3, None, None]
    square = np.einsum("...i,...i->...", v, v)[..., None, None]
    matrix = (w * w - square) * np.eye(3) + 2 * (
        v[..., :, None] * v[..., None, :] + w * cross_matrix(v)
    )
    return matrix / (w * w + square)


def quaternion_from_matrix(matrix: np.ndarray) -> np.ndarray:
    """Return unit quaternions (..., 4), scalar last and of any sign, of rotation matrices (..., 3, 3)."""
    q = _long_quaternion(np.swapaxes(matrix, -1, -2))
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def without_sign_jumps(quaternion: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Return unit quaternions (n, 4) of the same rotations, without sign jumps within a part.

    The scalar is last. q and -q are the same rotation, but interpolation between them passes through zero. `part` (n) is
    constant within a part. Each part begins with a scalar of zero or more.
    """
    if not len(quaternion):
        return quaternion
    same_part = part[1:] == part[:-1]
    jumps = same_part & (np.einsum("ni,ni->n", quaternion[1:], quaternion[:-1]) < 0)
    sign = np.cumprod(np.append(1.0, np.where(jumps, -1.0, 1.0)))
    # for each sample, the index of the first one of its part
    first = np.maximum.accumulate(
        np.append(0, np.where(same_part, 0, np.arange(1, len(quaternion))))
    )
    # relative to the sign of that sample, which gets a scalar of zero or more
    sign = sign * sign[first] * np.where(quaternion[first, 3] < 0, -1.0, 1.0)
    return quaternion * sign[:, None]


def components_after_rotation(vector: np.ndarray, angle_B: np.ndarray) -> np.ndarray:
    """Return body-axis components (..., 3) of space-fixed vectors (..., 3) after the body has rotated by `angle_B` (..., 3)."""
    shape = np.broadcast_shapes(vector.shape, angle_B.shape)
    flat = np.array(np.broadcast_to(vector, shape)).reshape(-1, 3)
    return (
        transform.Rotation.from_rotvec(-np.broadcast_to(angle_B, shape).reshape(-1, 3))
        .apply(flat)
        .reshape(shape)
    )


def rotate_by_smallest(a: np.ndarray, b: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return vectors x (n, 3) after the smallest rotation that takes the unit vectors a (n, 3) to b (n, 3).

    For opposite a and b there is no smallest rotation, and the result is of no use.
    """
    v, cosine = cross(a, b), np.sum(a * b, axis=1, keepdims=True)
    # Rodrigues' formula, in which v has the length of the sine
    return x + cross(v, x) + cross(v, cross(v, x)) / np.maximum(1 + cosine, 1e-9)


def tangent_basis(unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit vectors (n, 3) that form a right-handed frame with each direction (n, 3)."""
    # the x axis, or the y axis for directions near x
    helper = np.where(np.abs(unit[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = cross(unit, helper)
    first = first / np.linalg.norm(first, axis=1, keepdims=True)
    return first, cross(unit, first)


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the cross products of vectors (..., 3), bit by bit those of NumPy, which takes several times as long for few."""
    out = np.empty(a.shape if a.shape == b.shape else np.broadcast_shapes(a.shape, b.shape))
    for k, i, j in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., k] = a[..., i] * b[..., j] - a[..., j] * b[..., i]
    return out


def move_on_sphere(unit: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Return directions (n, 3) moved along great circles by tangent vectors (n, 2) in the frame of `tangent_basis`."""
    e1, e2 = tangent_basis(unit)
    angle = np.linalg.norm(step, axis=1, keepdims=True)
    along = (step[:, :1] * e1 + step[:, 1:] * e2) * np.sinc(angle / np.pi)
    out = np.cos(angle) * unit + along
    return out / np.linalg.norm(out, axis=1, keepdims=True)
