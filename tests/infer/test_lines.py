"""Lines through clouds of points: recovery, the smallest sum of distances, independence of order."""

import numpy as np
import pytest
from scipy.optimize import minimize

import sunspin as ss
from sunspin.infer.lines import distances, line_deviation, line_through, match_lines
from sunspin.study.rebound import published_lines


def cloud(seed: int, noise: float, n: int = 60):
    rng = np.random.default_rng(seed)
    lines = published_lines(ss.load_case("philae"))
    points = [p + rng.uniform(-0.4, 0.4, (n, 1)) * d + rng.normal(size=(n, 3)) * noise for p, d in lines]
    return np.concatenate(points), lines


@pytest.mark.parametrize("seed", range(4))
def test_the_paper_lines_are_recovered_from_unlabelled_points(seed):
    points, lines = cloud(seed, 0.008)
    fitted = ss.fit_lines(points, 4, seed=seed)
    for index, line in zip(match_lines(fitted, lines), lines, strict=True):
        found = (fitted["point"].values[index], fitted["direction"].values[index])
        deviation = line_deviation(found, line)
        assert deviation["mean"] < 0.01
        assert np.degrees(deviation["angle_rad"]) < 3


def test_outliers_hardly_move_a_line():
    rng = np.random.default_rng(1)
    t = rng.uniform(-1, 1, (80, 1))
    points = t * [0.6, 0.0, 0.8] + rng.normal(size=(80, 3)) * 0.001
    points[:8] += rng.normal(size=(8, 3))
    fitted = ss.fit_lines(points, 1)
    assert abs(fitted["direction"].values[0] @ [0.6, 0, 0.8]) > 0.9999


def test_the_order_of_points_does_not_matter():
    points, _ = cloud(0, 0.01, 30)
    order = np.random.default_rng(5).permutation(len(points))
    a, b = ss.fit_lines(points), ss.fit_lines(points[order])
    np.testing.assert_array_equal(a["point"].values, b["point"].values)
    np.testing.assert_array_equal(a["member"].values[order], b["member"].values)


def test_one_line_reaches_the_smallest_sum_of_distances():
    rng = np.random.default_rng(2)
    points = rng.uniform(-1, 1, (40, 1)) * [0.3, 0.5, 0.81] + rng.standard_t(2, (40, 3)) * 0.05
    start = points.mean(axis=0), np.linalg.svd(points - points.mean(axis=0))[2][0]

    def cost(x):
        return distances(points, x[None, :3], x[None, 3:] / np.linalg.norm(x[3:]))[0].sum()

    ours = cost(np.concatenate(line_through(points, *start)))
    best = min(
        minimize(cost, np.concatenate(start) + rng.normal(size=6) * 0.02, method="Nelder-Mead", options={"maxiter": 20_000}).fun
        for _ in range(3)
    )
    assert ours <= best * (1 + 1e-4)


def test_too_few_points_are_refused():
    with pytest.raises(ss.InputError, match="at least 8 different points"):
        ss.fit_lines(np.zeros((20, 3)), 4)
