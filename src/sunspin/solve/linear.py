"""Normal equations of many least-squares problems at once, and their solution: dense, or block-tridiagonal with a border.

A problem minimises a cost whose quadratic model about its present state is cost + slope.step + step.matrix.step / 2. One whose
matrix is singular or contains non-finite numbers gives a step of NaN and leaves the others alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np


class DenseSystem(NamedTuple):
    """K problems of D unknowns: `cost` (K), `matrix` (K, D, D), `slope` (K, D); `scale` (K, D) is what one unit of damping adds to
    the diagonal (None: the diagonal itself); `kept`: arrays (K, ...) of the same state that the caller wants back."""

    cost: np.ndarray
    matrix: np.ndarray
    slope: np.ndarray
    scale: np.ndarray | None = None
    extras: tuple[np.ndarray, ...] = ()

    @classmethod
    def from_residuals(
        cls, residual: np.ndarray, jacobian: np.ndarray, scale: np.ndarray | None = None
    ) -> DenseSystem:
        """Half the sum of squares of residuals (K, R) with the Jacobian (K, R, D)."""
        turned = np.swapaxes(jacobian, -1, -2)
        return cls(
            (residual**2).sum(axis=1) / 2,
            turned @ jacobian,
            (turned @ residual[..., None])[..., 0],
            scale,
        )


def solve_dense(system: DenseSystem, damping: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Steps (K, D) under `damping` (K), and what they gain (K) by the quadratic model if the damping is small."""
    scale = np.einsum("kii->ki", system.matrix) if system.scale is None else system.scale
    step = _nan_if_singular(
        np.linalg.solve,
        _add_to_diagonal(system.matrix, damping[:, None] * scale),
        -system.slope[..., None],
    )[..., 0]
    return step, -(system.slope * step).sum(axis=1) / 2


class BorderedSystem(NamedTuple):
    """K chains of n nodes with b unknowns each, of which neighbours meet, and m unknowns that meet all.

    `cost` (K); `diagonal` (K, n, b, b), `upper` (K, n-1, b, b), `slope` (K, n, b); `scale` (K, b) is what one unit of damping adds
    to the diagonal of each node; `border` (K, n, b, m), `corner` (K, m, m), `border_slope` (K, m), not damped; None without them.
    """

    cost: np.ndarray
    diagonal: np.ndarray
    upper: np.ndarray
    slope: np.ndarray
    scale: np.ndarray
    border: np.ndarray | None = None
    corner: np.ndarray | None = None
    border_slope: np.ndarray | None = None


class BorderedInverse(NamedTuple):
    """What the inverse of the undamped matrix contains: covariances of the nodes (K, n, b, b) and of the border's unknowns
    (K, m, m), what the nodes change per unit of each of the latter (K, n, b, m), and the logarithm of the determinant (K)."""

    nodes: np.ndarray
    border: np.ndarray
    sensitivity: np.ndarray
    log_determinant: np.ndarray


def solve_bordered(
    system: BorderedSystem, damping: np.ndarray
) -> tuple[tuple[np.ndarray, np.ndarray | None], np.ndarray]:
    """Steps of the nodes (K, n, b) and of the border's unknowns (K, m) under `damping` (K), and what they gain (K) by the quadratic
    model if the damping is small."""
    diagonal = _add_to_diagonal(system.diagonal, (damping[:, None] * system.scale)[:, None])
    factors = _factorise(diagonal, system.upper)
    if system.border is None:
        change, step = -_substitute(factors, system.slope[..., None])[..., 0], None
    else:
        change, step, _, _ = _solve_with_border(factors, system)
    gain = -(system.slope * change).reshape(len(change), -1).sum(axis=1) / 2
    return (change, step), gain if step is None else gain - (system.border_slope * step).sum(
        axis=1
    ) / 2


def invert_bordered(system: BorderedSystem) -> BorderedInverse:
    """Covariances and determinant of the undamped equations."""
    factors = _factorise(system.diagonal, system.upper)
    nodes, size = _diagonal_of_inverse(factors), np.linalg.slogdet(factors.pivots)[1].sum(axis=1)
    if system.border is None:
        k, n, b = system.slope.shape
        return BorderedInverse(nodes, np.zeros((k, 0, 0)), np.zeros((k, n, b, 0)), size)
    _, _, answer, schur = _solve_with_border(factors, system)
    border = _nan_if_singular(np.linalg.inv, schur)
    nodes = nodes + answer @ border[:, None] @ np.swapaxes(answer, -1, -2)
    return BorderedInverse(nodes, border, answer, size + np.linalg.slogdet(schur)[1])


class _Factors(NamedTuple):
    """Block elimination from the first node on: pivots (K, n, b, b), their inverses, and pivot^-1 upper (K, n-1, b, b)."""

    pivots: np.ndarray
    inverse: np.ndarray
    gain: np.ndarray


def _factorise(diagonal: np.ndarray, upper: np.ndarray) -> _Factors:
    pivots, gain = diagonal.copy(), np.zeros_like(upper)
    for i in range(upper.shape[1]):
        gain[:, i] = _nan_if_singular(np.linalg.solve, pivots[:, i], upper[:, i])
        pivots[:, i + 1] -= np.swapaxes(upper[:, i], -1, -2) @ gain[:, i]
    return _Factors(pivots, _nan_if_singular(np.linalg.inv, pivots), gain)


def _substitute(factors: _Factors, right: np.ndarray) -> np.ndarray:
    """Solutions (K, n, b, r) for right-hand sides of that shape."""
    right = right.copy()
    turned = np.swapaxes(factors.gain, -1, -2)
    for i in range(right.shape[1] - 1):
        right[:, i + 1] -= turned[:, i] @ right[:, i]
    right = factors.inverse @ right
    for i in range(right.shape[1] - 2, -1, -1):
        right[:, i] -= factors.gain[:, i] @ right[:, i + 1]
    return right


def _diagonal_of_inverse(factors: _Factors) -> np.ndarray:
    """Blocks (K, n, b, b) on the diagonal of the inverse."""
    covariance, turned = factors.inverse.copy(), np.swapaxes(factors.gain, -1, -2)
    for i in range(covariance.shape[1] - 2, -1, -1):
        covariance[:, i] += factors.gain[:, i] @ covariance[:, i + 1] @ turned[:, i]
    return covariance


def _solve_with_border(factors: _Factors, system: BorderedSystem) -> tuple[np.ndarray, ...]:
    """Steps of nodes and border, what the nodes change per unit of the border's unknowns, and the Schur complement (K, m, m)."""
    assert system.border is not None
    assert system.corner is not None and system.border_slope is not None
    # all at once: the loop over nodes is what costs
    right = -np.concatenate([system.slope[..., None], system.border], axis=-1)
    both = _substitute(factors, right)
    change, answer = both[..., 0], both[..., 1:]
    k, n, b, m = system.border.shape
    dot = np.swapaxes(system.border.reshape(k, n * b, m), -1, -2) @ both.reshape(k, n * b, 1 + m)
    schur, downhill = system.corner + dot[..., 1:], system.border_slope[..., None] + dot[..., :1]
    step = _nan_if_singular(np.linalg.solve, schur, -downhill)[..., 0]
    return change + (answer @ step[:, None, :, None])[..., 0], step, answer, schur


def _add_to_diagonal(matrix: np.ndarray, more: np.ndarray) -> np.ndarray:
    """A copy with `more` added to the diagonals."""
    matrix, each = matrix.copy(), np.arange(matrix.shape[-1])
    matrix[..., each, each] += more
    return matrix


def _nan_if_singular(function: Callable[..., Any], *stacks: np.ndarray) -> np.ndarray:
    """A function of linear algebra on stacks of matrices, with NaN where one of them is singular."""
    try:
        return function(*stacks)
    except np.linalg.LinAlgError:
        if stacks[0].ndim == 2:
            return np.full_like(stacks[-1], np.nan)
        return np.stack([_nan_if_singular(function, *each) for each in zip(*stacks, strict=True)])


def extreme_eigenvalues(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest eigenvalue (...) of symmetric matrices (..., 3, 3), in closed form: many times as fast as LAPACK's.

    Good to 1e-8 of the largest where two are nearly alike, else to rounding.

    The roots of the cubic are trigonometric: O. K. Smith, Comm. ACM 4 (1961), 168.
    """
    a, b, c = (matrix[..., k, k] for k in range(3))
    f, e, d = matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2]
    mean = (a + b + c) / 3
    a, b, c = a - mean, b - mean, c - mean
    spread = np.sqrt((a * a + b * b + c * c + 2 * (d * d + e * e + f * f)) / 6)
    determinant = a * (b * c - d * d) - f * (f * c - d * e) + e * (f * d - b * e)
    cube = np.where(spread > 0, spread, 1.0) ** 3
    angle = np.arccos(np.clip(determinant / (2 * cube), -1, 1)) / 3
    return mean + 2 * spread * np.cos(angle + 2 * np.pi / 3), mean + 2 * spread * np.cos(angle)


def symmetric_inverse(matrix: np.ndarray) -> np.ndarray:
    """The inverse of symmetric matrices (..., 3, 3) as (xx, xy, xz, yy, yz, zz) (..., 6), by cofactors: many times as fast as
    LAPACK's, and good to rounding times the ratio of the eigenvalues."""
    a, b, c = (matrix[..., k, k] for k in range(3))
    f, e, d = matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2]
    xx, xy, xz = b * c - d * d, e * d - c * f, f * d - b * e
    inverse = np.stack([xx, xy, xz, a * c - e * e, f * e - a * d, a * b - f * f], axis=-1)
    return inverse / (a * xx + f * xy + e * xz)[..., None]


def symmetric_product(elements: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Symmetric matrices, given as (xx, xy, xz, yy, yz, zz) (..., 6), times vectors (..., 3)."""
    xx, xy, xz, yy, yz, zz = np.moveaxis(elements, -1, 0)
    x, y, z = np.moveaxis(vector, -1, 0)
    return np.stack(
        [xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z], axis=-1
    )
