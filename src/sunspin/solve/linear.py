"""Normal equations of many least-squares problems at once, and their solution: dense, or block-tridiagonal with a border.

Near its present state the cost of a problem is approximated by cost + slope.step + step.matrix.step / 2. A problem whose matrix
is singular or not finite gives a step of NaN and does not affect the others.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np


class DenseSystem(NamedTuple):
    """Normal equations of K problems with D unknowns.

    `cost` (K), `matrix` (K, D, D), `slope` (K, D). `scale` (K, D) is added to the diagonal per unit of damping; None: the
    diagonal of the matrix (Marquardt's choice). `extras` are arrays (K, ...) of the same state that the caller wants back, in a
    tuple or a named one.
    """

    cost: np.ndarray
    matrix: np.ndarray
    slope: np.ndarray
    scale: np.ndarray | None = None
    extras: Any = ()

    @classmethod
    def from_residuals(
        cls, residual: np.ndarray, jacobian: np.ndarray, scale: np.ndarray | None = None
    ) -> DenseSystem:
        """Return the system whose cost is half the sum of squares of residuals (K, R), with their Jacobian (K, R, D).

        `scale` is that of the class.
        """
        transposed = np.swapaxes(jacobian, -1, -2)
        return cls(
            (residual**2).sum(axis=1) / 2,
            transposed @ jacobian,
            (transposed @ residual[..., None])[..., 0],
            scale,
        )


def solve_dense(system: DenseSystem, damping: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return steps (K, D) under `damping` (K), and the decrease of cost (K) that the quadratic model predicts for small damping."""
    scale = np.einsum("kii->ki", system.matrix) if system.scale is None else system.scale
    step = _nan_if_singular(
        np.linalg.solve,
        _add_to_diagonal(system.matrix, damping[:, None] * scale),
        -system.slope[..., None],
    )[..., 0]
    return step, -(system.slope * step).sum(axis=1) / 2


class BorderedSystem(NamedTuple):
    """Normal equations of K chains of n nodes with b unknowns each, and m unknowns that all nodes share (the border).

    Only neighbouring nodes are coupled. `cost` (K); `diagonal` (K, n, b, b), `upper` (K, n-1, b, b), `slope` (K, n, b); `scale`
    (K, b) is added to the diagonal of each node per unit of damping. `border` (K, n, b, m), `corner` (K, m, m) and
    `border_slope` (K, m) are not damped; None without shared unknowns.
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
    """Parts of the inverse of an undamped bordered matrix.

    `nodes` (K, n, b, b) and `border` (K, m, m): covariances of the nodes and of the shared unknowns. `sensitivity` (K, n, b,
    m): change of the nodes per unit of each shared unknown. `log_determinant` (K): of the matrix.
    """

    nodes: np.ndarray
    border: np.ndarray
    sensitivity: np.ndarray
    log_determinant: np.ndarray


def solve_bordered(
    system: BorderedSystem, damping: np.ndarray
) -> tuple[tuple[np.ndarray, np.ndarray | None], np.ndarray]:
    """Return steps under `damping` (K), and the decrease of cost (K) that the quadratic model predicts for small damping.

    The steps are those of the nodes (K, n, b) and of the shared unknowns (K, m), None without these.
    """
    diagonal = _add_to_diagonal(system.diagonal, (damping[:, None] * system.scale)[:, None])
    factors = _factorise(diagonal, system.upper)
    if system.border is None:
        node_step, shared_step = -_substitute(factors, system.slope[..., None])[..., 0], None
    else:
        node_step, shared_step, _, _ = _solve_with_border(factors, system)
    # at the minimum of the quadratic model the cost is lower by -slope.step / 2
    gain = -(system.slope * node_step).reshape(len(node_step), -1).sum(axis=1) / 2
    if shared_step is not None:
        gain = gain - (system.border_slope * shared_step).sum(axis=1) / 2
    return (node_step, shared_step), gain


def invert_bordered(system: BorderedSystem) -> BorderedInverse:
    """Return the covariances and the determinant of the undamped equations.

    With shared unknowns, the covariance of a node is that for fixed shared unknowns plus what their covariance adds through the
    sensitivity.
    """
    factors = _factorise(system.diagonal, system.upper)
    nodes = _diagonal_of_inverse(factors)
    log_determinant = np.linalg.slogdet(factors.pivots)[1].sum(axis=1)
    if system.border is None:
        k, n, b = system.slope.shape
        return BorderedInverse(nodes, np.zeros((k, 0, 0)), np.zeros((k, n, b, 0)), log_determinant)
    _, _, sensitivity, schur = _solve_with_border(factors, system)
    border = _nan_if_singular(np.linalg.inv, schur)
    nodes = nodes + sensitivity @ border[:, None] @ np.swapaxes(sensitivity, -1, -2)
    return BorderedInverse(
        nodes, border, sensitivity, log_determinant + np.linalg.slogdet(schur)[1]
    )


class _Factors(NamedTuple):
    """Block LU factors, eliminated from the first node on.

    `pivots` (K, n, b, b), their `inverse`, and `gain` = pivot^-1 upper (K, n-1, b, b).
    """

    pivots: np.ndarray
    inverse: np.ndarray
    gain: np.ndarray


def _factorise(diagonal: np.ndarray, upper: np.ndarray) -> _Factors:
    """Return the factors of block-tridiagonal matrices; their lower blocks are the transposed upper ones."""
    pivots, gain = diagonal.copy(), np.zeros_like(upper)
    for i in range(upper.shape[1]):
        gain[:, i] = _nan_if_singular(np.linalg.solve, pivots[:, i], upper[:, i])
        pivots[:, i + 1] -= np.swapaxes(upper[:, i], -1, -2) @ gain[:, i]
    return _Factors(pivots, _nan_if_singular(np.linalg.inv, pivots), gain)


def _substitute(factors: _Factors, right: np.ndarray) -> np.ndarray:
    """Return the solutions (K, n, b, r) for r right-hand sides (K, n, b, r), by forward and backward substitution."""
    right = right.copy()
    gain_T = np.swapaxes(factors.gain, -1, -2)
    for i in range(right.shape[1] - 1):
        right[:, i + 1] -= gain_T[:, i] @ right[:, i]
    right = factors.inverse @ right
    for i in range(right.shape[1] - 2, -1, -1):
        right[:, i] -= factors.gain[:, i] @ right[:, i + 1]
    return right


def _diagonal_of_inverse(factors: _Factors) -> np.ndarray:
    """Return the diagonal blocks (K, n, b, b) of the inverse, by recursion from the last node."""
    covariance, gain_T = factors.inverse.copy(), np.swapaxes(factors.gain, -1, -2)
    for i in range(covariance.shape[1] - 2, -1, -1):
        covariance[:, i] += factors.gain[:, i] @ covariance[:, i + 1] @ gain_T[:, i]
    return covariance


def _solve_with_border(factors: _Factors, system: BorderedSystem) -> tuple[np.ndarray, ...]:
    """Return the steps of nodes and shared unknowns, the nodes' sensitivity to these, and the Schur complement (K, m, m).

    Let A be the matrix of the nodes, B the border, g the slope of the nodes and h that of the shared unknowns. For a step s of
    these, the nodes' step is -A^-1 (g + B s). The equations of the shared unknowns then become S s = -(h - B^T A^-1 g). The Schur
    complement is S = corner - B^T A^-1 B.
    """
    assert system.border is not None
    assert system.corner is not None and system.border_slope is not None
    # one substitution for slope and border: the loop over the nodes takes the time
    right = -np.concatenate([system.slope[..., None], system.border], axis=-1)
    solution = _substitute(factors, right)
    step_if_fixed, sensitivity = solution[..., 0], solution[..., 1:]  # -A^-1 g and -A^-1 B
    k, n, b, m = system.border.shape
    border_T = np.swapaxes(system.border.reshape(k, n * b, m), -1, -2)
    product = border_T @ solution.reshape(k, n * b, 1 + m)
    schur = system.corner + product[..., 1:]
    reduced_slope = system.border_slope[..., None] + product[..., :1]
    shared_step = _nan_if_singular(np.linalg.solve, schur, -reduced_slope)[..., 0]
    node_step = step_if_fixed + (sensitivity @ shared_step[:, None, :, None])[..., 0]
    return node_step, shared_step, sensitivity, schur


def _add_to_diagonal(matrix: np.ndarray, addend: np.ndarray) -> np.ndarray:
    """Return a copy of matrices (..., d, d) with `addend` (..., d) added to their diagonals."""
    matrix, index = matrix.copy(), np.arange(matrix.shape[-1])
    matrix[..., index, index] += addend
    return matrix


def _nan_if_singular(function: Callable[..., Any], *stacks: np.ndarray) -> np.ndarray:
    """Apply a function of NumPy's linear algebra to stacks of matrices; singular ones give NaN.

    NumPy raises LinAlgError for a whole stack if one of its matrices is singular; then the function is applied to each matrix.
    """
    try:
        return function(*stacks)
    except np.linalg.LinAlgError:
        if stacks[0].ndim == 2:
            return np.full_like(stacks[-1], np.nan)
        return np.stack(
            [_nan_if_singular(function, *matrices) for matrices in zip(*stacks, strict=True)]
        )


def extreme_eigenvalues(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the smallest and the largest eigenvalue (...) of symmetric matrices (..., 3, 3), in closed form.

    Several times as fast as LAPACK. Accurate to rounding, or to 1e-8 of the largest eigenvalue if two are nearly equal. The
    roots of the cubic are trigonometric: O. K. Smith, Comm. ACM 4 (1961), 168.
    """
    # diagonal a, b, c; above it xy = f, xz = e, yz = d
    a, b, c = (matrix[..., k, k] for k in range(3))
    f, e, d = matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2]
    mean = (a + b + c) / 3  # of the eigenvalues; without it their sum is zero
    a, b, c = a - mean, b - mean, c - mean
    spread = np.sqrt((a * a + b * b + c * c + 2 * (d * d + e * e + f * f)) / 6)
    determinant = a * (b * c - d * d) - f * (f * c - d * e) + e * (f * d - b * e)
    cube = np.where(spread > 0, spread, 1.0) ** 3
    angle = np.arccos(np.clip(determinant / (2 * cube), -1, 1)) / 3
    return mean + 2 * spread * np.cos(angle + 2 * np.pi / 3), mean + 2 * spread * np.cos(angle)


def symmetric_inverse(matrix: np.ndarray) -> np.ndarray:
    """Return the inverses of symmetric matrices (..., 3, 3) as (xx, xy, xz, yy, yz, zz) (..., 6), by cofactors.

    Several times as fast as LAPACK. The relative error is rounding times the ratio of the eigenvalues.
    """
    # diagonal a, b, c; above it xy = f, xz = e, yz = d
    a, b, c = (matrix[..., k, k] for k in range(3))
    f, e, d = matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2]
    xx, xy, xz = b * c - d * d, e * d - c * f, f * d - b * e
    inverse = np.stack([xx, xy, xz, a * c - e * e, f * e - a * d, a * b - f * f], axis=-1)
    return inverse / (a * xx + f * xy + e * xz)[..., None]


def symmetric_product(elements: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Multiply symmetric matrices, given as (xx, xy, xz, yy, yz, zz) (..., 6), by vectors (..., 3)."""
    xx, xy, xz, yy, yz, zz = np.moveaxis(elements, -1, 0)
    x, y, z = np.moveaxis(vector, -1, 0)
    return np.stack(
        [xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z], axis=-1
    )
