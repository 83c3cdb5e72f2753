"""The solver against published problems, and what it promises of batches, borders and limits.

Rosenbrock, Powell's singular function: Moré, Garbow and Hillstrom 1981, ACM Trans. Math. Softw. 7, 17, problems 1 and 13.
MGH09: NIST Statistical Reference Datasets, nonlinear regression (https://www.itl.nist.gov/div898/strd/nls/nls_main.shtml), with
certified parameters, standard deviations and residual sums of squares; starts 1 and 2 are NIST's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from sunspin.solve.least_squares import (
    Stop,
    join_problems,
    least_squares,
    limit_length,
    take_problems,
)
from sunspin.solve.linear import (
    BorderedSystem,
    DenseSystem,
    extreme_eigenvalues,
    invert_bordered,
    solve_bordered,
    solve_dense,
    symmetric_inverse,
    symmetric_product,
)

MGH09_X = np.array([4.0, 2.0, 1.0, 0.5, 0.25, 0.167, 0.125, 0.1, 0.0833, 0.0714, 0.0625])
MGH09_Y = np.array(
    [0.1957, 0.1947, 0.1735, 0.1600, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246]
)


def mgh09(b):
    x = MGH09_X
    above, below = x**2 + b[:, 1:2] * x, x**2 + b[:, 2:3] * x + b[:, 3:]
    model, first = b[:, :1] * above / below, b[:, :1] / below
    slopes = [above / below, first * x, -model * x / below, -model / below]
    return model - MGH09_Y, np.stack(slopes, axis=-1)


def rosenbrock(b):
    one, zero = np.ones(len(b)), np.zeros(len(b))
    residual = np.stack([10 * (b[:, 1] - b[:, 0] ** 2), 1 - b[:, 0]], axis=1)
    return residual, np.array([[-20 * b[:, 0], 10 * one], [-one, zero]]).transpose(2, 0, 1)


def powell(b):
    w, x, y, z = b.T
    residual = np.stack(
        [w + 10 * x, np.sqrt(5) * (y - z), (x - 2 * y) ** 2, np.sqrt(10) * (w - z) ** 2], axis=1
    )
    one, zero, a, c = np.ones(len(b)), np.zeros(len(b)), 2 * (x - 2 * y), 2 * np.sqrt(10) * (w - z)
    second = [zero, zero, np.sqrt(5) * one, -np.sqrt(5) * one]
    rows = [[one, 10 * one, zero, zero], second, [zero, a, -2 * a, zero], [c, zero, zero, -c]]
    return residual, np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def solved(function, starts, steps=400, tolerance=0.0, **options):
    return least_squares(
        lambda b: DenseSystem.from_residuals(*function(b)),
        lambda b, step: b + step,
        solve_dense,
        np.array(starts, dtype=float),
        steps=steps,
        tolerance=tolerance,
        **options,
    )


def test_the_solver_reaches_the_certified_values_of_nist():
    certified = [1.9280693458e-1, 1.9128232873e-1, 1.2305650693e-1, 1.3606233068e-1]
    deviations = [1.1435312227e-2, 1.9633220911e-1, 8.0842031232e-2, 9.0025542308e-2]
    found = solved(mgh09, [[25, 39, 41.5, 39], [0.25, 0.39, 0.415, 0.39]])
    variance = 2 * found.system.cost / (len(MGH09_X) - len(certified))
    inverse = np.einsum("kii->ki", np.linalg.inv(found.system.matrix))
    sigma = np.sqrt(variance[:, None] * inverse)
    assert found.state == pytest.approx(np.tile(certified, (2, 1)), rel=1e-6)
    assert sigma == pytest.approx(np.tile(deviations, (2, 1)), rel=1e-6)
    assert 2 * found.system.cost == pytest.approx(3.0750560385e-4, rel=1e-9)
    assert np.all(found.stop == Stop.NO_DESCENT)  # at rounding: with no tolerance nothing arrives


def test_the_solver_follows_a_curved_valley_and_reaches_a_singular_minimum():
    found = solved(rosenbrock, [[-1.2, 1.0], [1.2, 1.2]])
    assert found.state == pytest.approx(np.ones((2, 2)), abs=1e-9)
    flat = solved(powell, [[3.0, -1.0, 0.0, 1.0]], steps=60)
    assert np.abs(flat.state).max() < 1e-6 and flat.system.cost[0] < 1e-20


def test_a_batch_equals_each_problem_alone_bit_for_bit():
    starts = np.random.default_rng(0).uniform(-3, 3, (40, 2))
    together = solved(rosenbrock, starts, tolerance=1e-6)
    ends = (solved(rosenbrock, starts, steps=n, tolerance=1e-6).stop for n in (5, 15, 30))
    halted = [np.sum(stop == Stop.STEP_LIMIT) for stop in ends]
    assert 0 < halted[2] < halted[1] <= halted[0]  # they do stop at different times
    for i in range(len(starts)):
        alone = solved(rosenbrock, starts[i : i + 1], tolerance=1e-6)
        assert np.array_equal(alone.state[0], together.state[i])
        assert alone.stop[0] == together.stop[i]
        assert np.array_equal(alone.system.matrix[0], together.system.matrix[i])


class Chain(NamedTuple):
    """A chain of 5 nodes of two unknowns, each also meeting three that all share; K of them, residuals slightly bent."""

    first: np.ndarray
    second: np.ndarray
    shared: np.ndarray
    target: np.ndarray

    @classmethod
    def drawn(cls, rng, k, nodes=5):
        parts = [rng.normal(size=(nodes - 1, 6, m)) for m in (2, 2, 3)]
        return cls(*parts, rng.normal(size=(k, nodes - 1, 6)))

    def value(self, node, error):
        line = np.einsum("nmi,kni->knm", self.first, node[:, :-1])
        line = line + np.einsum("nmi,kni->knm", self.second, node[:, 1:])
        line = line + np.einsum("nmi,ki->knm", self.shared, error)
        return line + 0.1 * np.sin(line) - self.target, 1 + 0.1 * np.cos(line)

    def bordered(self, state):
        value, bend = self.value(*state)
        a, b, c = (bend[..., None] * part for part in (self.first, self.second, self.shared))
        k, n = state[0].shape[:2]
        diagonal = np.zeros((k, n, 2, 2))
        slope = np.zeros((k, n, 2))
        border = np.zeros((k, n, 2, 3))
        for place, part in ((slice(None, -1), a), (slice(1, None), b)):
            diagonal[:, place] += np.einsum("knmi,knmj->knij", part, part)
            slope[:, place] += np.einsum("knmi,knm->kni", part, value)
            border[:, place] += np.einsum("knmi,knmj->knij", part, c)
        cost = (value**2).sum(axis=(1, 2)) / 2 + (state[1] ** 2).sum(axis=1) / 2
        upper = np.einsum("knmi,knmj->knij", a, b)
        corner = np.einsum("knmi,knmj->kij", c, c) + np.eye(3)
        downhill = np.einsum("knmi,knm->ki", c, value) + state[1]
        scale = np.ones((k, 2))
        return BorderedSystem(cost, diagonal, upper, slope, scale, border, corner, downhill)


def whole(system, damping):
    """The matrix (D, D) of the first chain, nodes first, with its right-hand side."""
    _, diagonal, upper, slope, scale, border, corner, border_slope = (part[0] for part in system)
    n, b = slope.shape
    matrix = np.zeros((n * b + len(corner),) * 2)
    for i in range(n):
        at = slice(i * b, (i + 1) * b)
        matrix[at, at] = diagonal[i] + damping * np.diag(scale)
        if i + 1 < n:
            after = slice((i + 1) * b, (i + 2) * b)
            matrix[at, after], matrix[after, at] = upper[i], upper[i].T
    matrix[: n * b, n * b :] = border.reshape(n * b, -1)
    matrix[n * b :, : n * b], matrix[n * b :, n * b :] = border.reshape(n * b, -1).T, corner
    return matrix, -np.concatenate([slope.ravel(), border_slope])


@pytest.mark.evidence("rates", "verified", "NumPy's solution of the whole matrix")
def test_a_bordered_chain_solves_as_the_whole_matrix(reached):
    rng = np.random.default_rng(7)
    system = Chain.drawn(rng, 3).bordered((rng.normal(size=(3, 5, 2)), rng.normal(size=(3, 3))))
    matrix, right = whole(system, 0.3)
    (change, step), gain = solve_bordered(system, np.full(3, 0.3))
    assert step is not None
    assert gain[0] == pytest.approx(right @ np.linalg.solve(matrix, right) / 2)
    off = np.concatenate([change[0].ravel(), step[0]]) - np.linalg.solve(matrix, right)
    reached("difference of the steps", np.abs(off), "", 1e-10)
    assert np.abs(off).max() < 1e-10
    matrix, told = whole(system, 0.0)[0], invert_bordered(system)
    inverse = np.linalg.inv(matrix)
    blocks = np.array([inverse[i : i + 2, i : i + 2] for i in range(0, 10, 2)])
    assert np.abs(told.nodes[0] - blocks).max() < 1e-10
    assert np.abs(told.border[0] - inverse[10:, 10:]).max() < 1e-10
    assert told.log_determinant[0] == pytest.approx(np.linalg.slogdet(matrix)[1])
    sensitivity = -np.linalg.solve(matrix[:10, :10], matrix[:10, 10:])
    assert told.sensitivity[0].reshape(10, 3) == pytest.approx(sensitivity)
    bare = system._replace(border=None, corner=None, border_slope=None)
    (change, step), _ = solve_bordered(bare, np.full(3, 0.3))
    assert step is None
    alone = np.linalg.solve(whole(system, 0.3)[0][:10, :10], right[:10])
    assert change[0].ravel() == pytest.approx(alone)
    block = np.linalg.inv(matrix[:10, :10])[:2, :2]
    assert np.abs(invert_bordered(bare).nodes[0, 0] - block).max() < 1e-10


def test_the_solver_steps_back_from_points_without_derivatives():
    """log x - 3 from x = 200: steps go below zero, where there is no logarithm. One start is there, another has no derivative."""

    def linearise(x):
        with np.errstate(invalid="ignore", divide="ignore"):
            slope = np.where(x == 5.0, np.nan, 1 / x)[..., None]
            return DenseSystem.from_residuals(np.log(x) - 3, slope)

    start = np.array([[0.01], [200.0], [-1.0], [5.0]])
    found = least_squares(
        linearise, lambda x, step: x + step, solve_dense, start, steps=200, tolerance=1e-20
    )
    assert found.state[:2, 0] == pytest.approx(np.exp([3, 3]), rel=1e-8)
    assert found.state[2, 0] == -1.0 and found.stop[2] == Stop.INVALID_START
    assert found.state[3, 0] == 5.0 and found.stop[3] == Stop.NO_DESCENT


def test_a_singular_problem_does_not_stop_the_others_of_a_batch():
    matrix = np.stack([np.eye(2), np.zeros((2, 2)), 2 * np.eye(2)])
    step = solve_dense(DenseSystem(np.zeros(3), matrix, np.ones((3, 2))), np.zeros(3))[0]
    assert np.isnan(step[1]).all() and np.array_equal(step[[0, 2]], [[-1, -1], [-0.5, -0.5]])


def test_states_keep_within_limits_and_steps_within_their_length():
    seen = []

    def linearise(b):
        seen.append(b.copy())
        return DenseSystem.from_residuals(*rosenbrock(b))

    found = least_squares(
        linearise,
        lambda b, step: b + step,
        solve_dense,
        np.array([[-0.4, 0.1], [0.1, 0.1]]),
        steps=300,
        tolerance=0.0,
        limit=lambda b: limit_length(b, 0.5),
        length_ratio=lambda b, step: np.linalg.norm(step, axis=1) / 0.05,
    )
    assert max(np.linalg.norm(b, axis=1).max() for b in seen) <= 0.5 * (1 + 1e-15)
    assert max(np.abs(seen[k + 1] - seen[0]).max() for k in range(4)) <= 4 * 0.05
    angle = np.linspace(0, 2 * np.pi, 1_000_001)
    circle = 0.5 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ring = (rosenbrock(circle)[0] ** 2).sum(axis=1).min() / 2
    # the least on the limit, nearly: the step is not along it
    assert found.system.cost == pytest.approx([ring, ring], rel=0.02)


def test_the_solver_changes_no_argument_and_accepts_an_empty_batch():
    start = np.array([[-1.2, 1.0], [1.0, 1.0]])
    before = start.copy()
    found = solved(rosenbrock, start)
    assert np.array_equal(start, before) and not np.shares_memory(found.state, start)
    assert solved(rosenbrock, np.zeros((0, 2))).stop.shape == (0,)


def test_extreme_eigenvalues_agree_with_lapack():
    """Random matrices to rounding; spheres, and two moments alike or nearly so, to what the closed form can."""
    root = np.random.default_rng(5).normal(size=(500, 3, 3))
    axes = np.linalg.qr(root)[0]
    moments = ([2.0, 2.0, 2.0], [1.0, 1.0, 3.0], [1.0, 3.0, 3.0], [1.0, 1 + 1e-9, 2.0])
    alike = [axes * some @ axes.swapaxes(1, 2) for some in moments]
    for matrix, allowed in (
        (root @ root.swapaxes(1, 2), 1e-13),
        *((each, 1e-8) for each in alike),
        (np.zeros((1, 3, 3)), 0.0),
    ):
        expected = np.linalg.eigvalsh(matrix)
        least, largest = extreme_eigenvalues(matrix)
        for found, wanted in ((least, expected[:, 0]), (largest, expected[:, 2])):
            assert np.abs(found - wanted).max() <= allowed * max(np.abs(expected).max(), 1e-300)


def test_symmetric_inverses_agree_with_lapack():
    """Bodies whose moments differ by up to a thousand, in any axes; and a product with the inverse undoes the matrix."""
    rng = np.random.default_rng(6)
    axes = np.linalg.qr(rng.normal(size=(2, 500, 3, 3)))[0]
    moments = 10.0 ** rng.uniform(-1.5, 1.5, (2, 500, 3))
    matrix = axes * moments[:, :, None] @ axes.swapaxes(-1, -2)
    inverse = symmetric_inverse(matrix)
    whole = inverse[..., [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
    worst = moments.max(axis=-1) / moments.min(axis=-1) ** 2
    assert inverse.shape == (2, 500, 6)
    assert np.all(np.abs(whole - np.linalg.inv(matrix)).max(axis=(-1, -2)) < 1e-13 * worst)
    vector = rng.normal(size=(2, 500, 3))
    back = symmetric_product(inverse, (matrix @ vector[..., None])[..., 0])
    ratio = moments.max(axis=-1) / moments.min(axis=-1)
    assert np.all(np.abs(back - vector).max(axis=-1) < 1e-12 * ratio)


def test_joined_problems_are_those_of_the_parts_one_after_another():
    """Also in nested and named tuples, and where a part of a state is None."""
    systems = [
        DenseSystem(
            np.arange(n) + 1.0, np.ones((n, 2, 2)), np.zeros((n, 2)), None, (np.full(n, n),)
        )
        for n in (2, 3)
    ]
    joined = join_problems(systems)
    assert isinstance(joined, DenseSystem) and joined.scale is None
    assert joined.cost.tolist() == [1.0, 2.0, 1.0, 2.0, 3.0] and joined.matrix.shape == (5, 2, 2)
    assert joined.extras[0].tolist() == [2, 2, 3, 3, 3]
    for rows, part in ((np.arange(2), systems[0]), (np.arange(2, 5), systems[1])):
        np.testing.assert_array_equal(take_problems(joined, rows).cost, part.cost)
