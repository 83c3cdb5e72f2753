"""Lines through clouds of points: recovery, the smallest sum of distances, independence of order."""

from functools import partial
from itertools import product

import numpy as np
import pytest
from scipy.optimize import minimize

import sunspin as ss
from sunspin.estimate.scan.lines import distances, line_deviation, line_through, match_lines
from sunspin.philae.rebound import published_lines


def cloud(seed: int, noise: float, n: int = 60):
    rng = np.random.default_rng(seed)
    lines = published_lines(ss.load_case("philae"))
    points = [
        p + rng.uniform(-0.4, 0.4, (n, 1)) * d + rng.normal(size=(n, 3)) * noise for p, d in lines
    ]
    return np.concatenate(points), lines


@pytest.mark.evidence(
    "fit_lines", "validated", "the four lines of the paper, from points scattered about them"
)
@pytest.mark.parametrize("seed", range(2))
def test_the_published_lines_are_recovered_from_unlabelled_points(seed, reached):
    points, lines = cloud(seed, 0.008)
    fitted = ss.fit_lines(points, 4, seed=seed)
    for index, line in zip(match_lines(fitted, lines), lines, strict=True):
        deviation = line_deviation(of_line(fitted, index), line)
        assert deviation["mean"] < 0.01 and np.degrees(deviation["angle_rad"]) < 3
        reached("largest mean deviation", deviation["mean"], "rad/s", 0.01)
        reached("largest angle", np.degrees(deviation["angle_rad"]), "deg", 3.0)


def test_outliers_hardly_move_a_line():
    rng = np.random.default_rng(1)
    t = rng.uniform(-1, 1, (80, 1))
    points = t * [0.6, 0.0, 0.8] + rng.normal(size=(80, 3)) * 0.001
    points[:8] += rng.normal(size=(8, 3))
    fitted = ss.fit_lines(points, 1)
    assert abs(fitted["direction"].values[0] @ [0.6, 0, 0.8]) > 0.9999


def test_fitted_lines_do_not_depend_on_the_order_of_points():
    points, _ = cloud(0, 0.01, 30)
    order = np.random.default_rng(5).permutation(len(points))
    a, b = ss.fit_lines(points), ss.fit_lines(points[order])
    np.testing.assert_array_equal(a["point"].values, b["point"].values)
    np.testing.assert_array_equal(a["member"].values[order], b["member"].values)


def of_line(fitted, index):
    return fitted["point"].values[index], fitted["direction"].values[index]


def sum_of_distances(x, points):
    return distances(points, x[None, :3], x[None, 3:] / np.linalg.norm(x[3:]))[0].sum()


@pytest.mark.evidence("fit_lines", "verified", "SciPy's Nelder-Mead")
@pytest.mark.parametrize("guess", ["least squares", "two of the points"])
def test_one_line_reaches_the_smallest_sum_of_distances(guess, reached):
    rng = np.random.default_rng(2)
    points = rng.uniform(-1, 1, (40, 1)) * [0.3, 0.5, 0.81] + rng.standard_t(2, (40, 3)) * 0.05
    middle, axis = points.mean(axis=0), np.linalg.svd(points - points.mean(axis=0))[2][0]
    if guess == "two of the points":  # where plain reweighting would stay for ever
        i, j = np.argsort(points @ axis)[[8, 30]]
        middle, axis = points[i], (points[j] - points[i]) / np.linalg.norm(points[j] - points[i])
    ours = sum_of_distances(np.concatenate(line_through(points, middle, axis)), points)
    start, limits = np.concatenate([middle, axis]), {"maxiter": 20_000, "maxfev": 20_000}
    find = partial(minimize, sum_of_distances, args=(points,), method="Nelder-Mead")
    options = limits | {"xatol": 1e-9, "fatol": 1e-11}
    best = min(find(start + rng.normal(size=6) * 0.02, options=options).fun for _ in range(3))
    assert ours <= best * (1 + 1e-6)
    reached("relative excess of the sum", ours / best - 1, "", 1e-6)


@pytest.mark.evidence("fit_lines", "verified", "all 128 assignments of the points")
@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2))]
)
def test_two_lines_through_few_points_are_the_best_of_all_assignments(seed):
    points = np.random.default_rng(seed).uniform(-1, 1, (8, 3))

    def cost(mine):
        if len(mine) < 3:
            return 0.0
        first = mine.mean(axis=0), np.linalg.svd(mine - mine.mean(axis=0))[2][0]
        return sum_of_distances(np.concatenate(line_through(mine, *first)), mine)

    shares = [np.array([0, *share], dtype=bool) for share in product([0, 1], repeat=7)]
    best = min(cost(points[share]) + cost(points[~share]) for share in shares)
    fitted = ss.fit_lines(points, 2)
    ours = distances(points, fitted["point"].values, fitted["direction"].values).min(axis=0).sum()
    assert ours <= best * (1 + 1e-6)


@pytest.mark.parametrize("per_line", [3, 8])
def test_lines_are_fitted_to_few_irregular_points(per_line):
    rng = np.random.default_rng(per_line)
    lines = published_lines(ss.load_case("philae"))
    points = np.concatenate([p + np.linspace(-0.4, 0.4, per_line)[:, None] * d for p, d in lines])
    fitted = ss.fit_lines(points + rng.normal(size=points.shape) * 1e-4, 4)
    for index, line in zip(match_lines(fitted, lines), lines, strict=True):
        assert line_deviation(of_line(fitted, index), line)["max"] < 2e-3
    assert fitted["count"].values.tolist() == [per_line] * 4


def test_the_dataset_of_lines_holds_their_points_and_distances():
    points, _ = cloud(3, 0.01, 25)
    fitted = ss.fit_lines(points)
    origin, direction, member = (fitted[name].values for name in ("point", "direction", "member"))
    table = distances(points, origin, direction)
    np.testing.assert_array_equal(member, table.argmin(axis=0))
    np.testing.assert_array_equal(fitted["count"].values, np.bincount(member, minlength=4))
    assert np.all(np.diff(fitted["count"].values) <= 0)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1, atol=1e-12)
    assert np.all(direction[:, 2] > 0)
    for k in range(4):
        assert fitted["mean_distance"].values[k] == pytest.approx(table[k, member == k].mean())


def test_line_deviation_by_hand():
    """The z axis against a line that leaves it at atan(3/4): 0.3 away at height 0.4, whichever way the line points."""
    other = (np.array([0.3, 0, 0.4]), np.array([0.6, 0, 0.8]))
    for z in (2.0, -2.0):
        deviation = line_deviation((np.zeros(3), np.array([0, 0, z])), other, low=0.0, high=0.4)
        assert deviation["angle_rad"] == pytest.approx(np.arctan(0.75))
        assert deviation["max"] == pytest.approx(0.3)
        assert deviation["mean"] == pytest.approx(0.15)


def test_lines_are_paired_all_together():
    """The nearest fitted line of both references is line 0; together they are nearest when one of them takes line 1."""
    up = np.array([0, 0, 1.0])
    fitted = ss.fit_lines([[0, 0, 0], [0, 0, 1], [0, 0, 2], [10, 0, 0], [10, 0, 1]], 2)
    reference = [(np.array([4.0, 0, 0]), up), (np.array([0.5, 0, 0]), up)]
    assert match_lines(fitted, reference) == [1, 0]


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((20, 3)), "at least 8 different points"),
        (np.zeros((4, 2)), r"shape \(n, 3\) and be finite"),
        (np.full((9, 3), np.nan), r"shape \(n, 3\) and be finite"),
    ],
)
def test_points_that_allow_no_lines_are_refused(points, message):
    with pytest.raises(ss.InputError, match=message):
        ss.fit_lines(points, 4)
    with pytest.raises(ss.InputError, match="n_lines must be at least one"):
        ss.fit_lines(np.eye(3), 0)


def test_lines_that_cannot_be_compared_are_refused():
    up, along = (np.zeros(3), np.array([0, 0, 1.0])), (np.zeros(3), np.array([1.0, 0, 0]))
    with pytest.raises(ss.InputError, match="choose another axis"):
        line_deviation(up, along)
    with pytest.raises(ss.InputError, match="fewer fitted lines"):
        match_lines(ss.fit_lines([[0, 0, 0], [0, 0, 1]], 1), [up, up])
