"""Fit of several straight lines to a cloud of points, when it is not known which point belongs to which line.

The fit minimises the sum of distances (not squared) of the points from their nearest line, as the paper fits its four lines to the
near-minimum set (section 2.3). Candidates are here lines through pairs of points (not motions, as in the glossary). A search from
many starts selects the set of candidates that fits best (a facility-location problem). Then points are assigned to lines and lines
fitted to their points, in turn. Lines are given by a point ("origin") and a unit direction each. Points are body rates (rad/s).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.optimize import linear_sum_assignment

from sunspin.base.errors import InputError
from sunspin.base.provenance import provenance

Line = tuple[np.ndarray, np.ndarray]
"""A point of the line and its unit direction, (3) each."""

ALL_PAIRS, RANDOM_PAIRS = 60, 4096
"""With at most this many different points each pair gives a candidate line, otherwise this number of random pairs."""

N_CANDIDATES, N_SEARCH_POINTS = 400, 800
"""Largest numbers of candidate lines and of points in the search. The refinement uses all points."""

SEARCH_DISTANCES = 6_000_000
"""Number of point-line distances in the search. It sets the number of starts: small clouds are cheap and need more of them."""

MIN_STARTS, MAX_STARTS = 12, 100
"""Limits of the number of starts of the search."""

N_REFINED = 4
"""Number of the best sets of candidates that are refined. Their order may change: all candidates are lines through two points."""

MAX_ROUNDS = 60
"""Largest number of assignments of points to lines in a refinement."""

TOLERANCE = 1e-12
"""Relative decrease of the sum of distances below which a fit has converged."""

SMOOTHING_STEPS = 40
"""Halvings of the smoothing length, from the width of the cloud down to rounding errors."""

MIN_SLOPE = 1e-9
"""A line along which a component changes by less than this per unit length does not reach other values of the component."""


def distances(points: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return the distances (m, n) of points (n, 3) from lines given by points (m, 3) and unit directions (m, 3)."""
    offset = points[None] - origin[:, None]
    offset -= np.einsum("mni,mi->mn", offset, direction)[..., None] * direction[:, None]
    return np.sqrt(np.einsum("mni,mni->mn", offset, offset))


def fit_lines(points: npt.ArrayLike, n_lines: int = 4, seed: int = 0) -> xr.Dataset:
    """Fit `n_lines` straight lines to points, with the smallest sum of distances to the nearest line.

    Parameters
    ----------
    points : (n, 3)
        At least two per line.
    seed : int
        Seed of the random choice of candidate lines.

    Returns
    -------
    xarray.Dataset
        `point (line, axis)`: a point at the median of the members along the line. `direction (line, axis)`: unit vector, its last
        component that is not zero is positive. `member (n)`: the line of each point. `mean_distance (line)` and `count (line)` of
        its members. Lines are in order of decreasing count.
    """
    cloud = np.asarray(points, dtype=np.float64)
    if cloud.ndim != 2 or cloud.shape[1] != 3 or not np.all(np.isfinite(cloud)):
        raise InputError("points must have the shape (n, 3) and be finite", got=cloud.shape)
    if n_lines < 1:
        raise InputError("n_lines must be at least one", got=n_lines)
    if len(np.unique(cloud, axis=0)) < 2 * n_lines:
        raise InputError(
            f"{n_lines} lines need at least {2 * n_lines} different points",
            got=len(np.unique(cloud, axis=0)),
            do="take a larger near-minimum set or fewer lines",
        )
    # sorted, so that the result does not depend on the order of the points
    ordered = cloud[np.lexsort(cloud.T)]
    best, best_cost = None, np.inf
    for candidates in _search(ordered, n_lines, np.random.default_rng(seed)):
        lines = _refine(ordered, *candidates)
        cost = float(distances(ordered, *lines).min(axis=0).sum())
        if cost < best_cost * (1 - TOLERANCE):
            best, best_cost = lines, cost
    assert best is not None  # the search returns at least one set of candidates
    return _dataset(cloud, *best).assign_attrs(provenance("lines", seed=seed))


def _candidates(cloud: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return the points and directions, (m, 3) each, of candidate lines through pairs of different points of the cloud (n, 3)."""
    distinct = np.unique(cloud, axis=0)
    if len(distinct) <= ALL_PAIRS:
        first, second = np.triu_indices(len(distinct), 1)
    else:
        first, second = rng.integers(len(distinct), size=(2, RANDOM_PAIRS))
    use = np.flatnonzero(first != second)
    if len(use) > N_CANDIDATES:
        use = rng.choice(use, N_CANDIDATES, replace=False)
    step = distinct[second[use]] - distinct[first[use]]
    return distinct[first[use]], step / np.linalg.norm(step, axis=1, keepdims=True)


def _search(
    cloud: np.ndarray, n_lines: int, rng: np.random.Generator
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return up to `N_REFINED` sets of candidate lines, that with the smallest sum of distances to the points `cloud` (n, 3) first.

    Each set is given as points and directions (n_lines, 3). The first start of the search is greedy, the others are random. Each is
    improved by exchanging one line at a time (:func:`_exchanged`). Starts that end at the same set count once.
    """
    sample = cloud
    if len(cloud) > N_SEARCH_POINTS:
        sample = cloud[rng.choice(len(cloud), N_SEARCH_POINTS, replace=False)]
    origin, direction = _candidates(cloud, rng)
    # distances (m, n) of n points from m candidates
    cost = distances(sample, origin, direction)
    # a start needs about as many distances as `cost` has: a small cloud gets more starts
    n_starts = int(np.clip(SEARCH_DISTANCES // cost.size, MIN_STARTS, MAX_STARTS))
    starts = [_greedy(cost, n_lines)] + [
        rng.integers(len(cost), size=n_lines).tolist() for _ in range(n_starts - 1)
    ]
    # sum of distances for each set of candidates that a start reaches
    total: dict[tuple[int, ...], float] = {}
    for start in starts:
        chosen = tuple(sorted(_exchanged(cost, start)))
        total[chosen] = float(cost[list(chosen)].min(axis=0).sum())
    ranked = sorted(total, key=lambda chosen: (total[chosen], chosen))[:N_REFINED]
    return [(origin[list(chosen)], direction[list(chosen)]) for chosen in ranked]


def _greedy(cost: np.ndarray, n_lines: int) -> list[int]:
    """Return candidates (indices) chosen one after the other, each of which reduces the sum of distances most.

    `cost` (m, n): distances of n points from m candidates.
    """
    chosen: list[int] = []
    nearest = np.full(cost.shape[1], np.inf)
    for _ in range(n_lines):
        chosen.append(int(np.argmin(np.minimum(cost, nearest).sum(axis=1))))
        nearest = np.minimum(nearest, cost[chosen[-1]])
    return chosen


def _exchanged(cost: np.ndarray, chosen: list[int]) -> list[int]:
    """Return the chosen candidates (indices) after exchanges of single ones, until no exchange reduces the sum of distances.

    `cost` (m, n): distances of n points from m candidates.
    """
    chosen, unchanged, slot = list(chosen), 0, 0
    while unchanged < len(chosen):
        others = [candidate for k, candidate in enumerate(chosen) if k != slot]
        to_others = cost[others].min(axis=0) if others else np.full(cost.shape[1], np.inf)
        # sum of distances with each of the m candidates in this slot
        totals = np.minimum(cost, to_others).sum(axis=1)
        best = int(np.argmin(totals))
        better = totals[best] < totals[chosen[slot]] * (1 - TOLERANCE)
        if better:
            chosen[slot] = best
        unchanged = 0 if better else unchanged + 1
        slot = (slot + 1) % len(chosen)
    return chosen


def _refine(
    cloud: np.ndarray, origin: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the points and directions (n_lines, 3) of lines, refined from those given by `origin` and `direction`.

    Two steps alternate until no point changes its line, or `MAX_ROUNDS` times: each point of `cloud` (n, 3) is assigned to its
    nearest line, and each line is fitted to its points. A line with fewer than two points stays as it is.
    """
    origin, direction = origin.copy(), direction.copy()
    member = np.full(len(cloud), -1)
    for _ in range(MAX_ROUNDS):
        before, member = member, distances(cloud, origin, direction).argmin(axis=0)
        moved = before != member
        # lines that have lost or gained a point; in the first round points come from -1, no line
        changed = np.unique(np.concatenate([before[moved], member[moved]]))
        if changed.size == 0:
            break
        for k in changed[changed >= 0]:
            members = cloud[member == k]
            if len(members) >= 2:
                origin[k], direction[k] = line_through(members, origin[k], direction[k])
    return origin, direction


def line_through(
    points: np.ndarray, origin: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the line (point, direction) near a guess with the smallest sum of distances d from points (n, 3), or the guess.

    The method is iteratively reweighted least squares for the sum of sqrt(d^2 + s^2). The smoothing length s is halved in each
    step, from the width of the cloud about the guess. Without it, a guess through two of the points would never leave them, because
    their weights 1/d are infinite.
    """
    distance = distances(points, origin[None], direction[None])[0]
    best_cost, best = distance.sum(), (origin, direction)
    smoothing = float(distance.max())
    if smoothing <= 0:
        return best
    floor, previous = smoothing * 0.5**SMOOTHING_STEPS, np.inf
    for _ in range(4 * SMOOTHING_STEPS):
        weight = 1.0 / np.hypot(distance, smoothing)
        centre = weight @ points / weight.sum()
        offset = points - centre
        # along the weighted points: the eigenvector of the largest eigenvalue
        axis = np.linalg.eigh((weight[:, None] * offset).T @ offset)[1][:, -1]
        distance = distances(points, centre[None], axis[None])[0]
        cost = distance.sum()
        if cost < best_cost:
            best_cost, best = cost, (centre, axis)
        if smoothing <= floor and previous - cost < TOLERANCE * cost:
            break
        previous, smoothing = cost, max(smoothing / 2, floor)
    return best


def _dataset(points: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> xr.Dataset:
    """Return the Dataset of `fit_lines` for points (n, 3) and lines (n_lines, 3).

    The lines are put in order; their points are centred and their directions get the sign that `fit_lines` documents.
    """
    distance = distances(points, origin, direction)
    member = distance.argmin(axis=0)
    counts = np.bincount(member, minlength=len(origin))
    # lines in order of decreasing count; `rank` (n_lines): new number of each
    order = np.lexsort((*origin.T, -counts))
    rank = np.argsort(order)
    origin, direction, counts = origin[order], direction[order], counts[order]
    member = rank[member]
    for k in range(len(origin)):
        if counts[k]:
            middle = np.median((points[member == k] - origin[k]) @ direction[k])
            origin[k] = origin[k] + middle * direction[k]
        last = np.flatnonzero(np.abs(direction[k]) > 1e-12)[-1]
        direction[k] *= np.sign(direction[k, last])
    nearest = distance.min(axis=0)
    mean = [float(nearest[member == k].mean()) if counts[k] else 0.0 for k in range(len(origin))]
    return xr.Dataset(
        {
            "point": (("line", "axis"), origin, {"units": "rad s-1"}),
            "direction": (("line", "axis"), direction, {"units": "1"}),
            "mean_distance": ("line", mean, {"units": "rad s-1"}),
            "count": ("line", counts),
            "member": ("n", member),
        },
        coords={"axis": ["x", "y", "z"]},
    )


def point_at(
    origin: np.ndarray, direction: np.ndarray, axis: int, value: npt.ArrayLike
) -> np.ndarray:
    """Return the points (..., 3) of a line at which the component `axis` (0, 1 or 2) has the values `value` (...)."""
    step = (np.asarray(value, dtype=np.float64) - origin[axis]) / direction[axis]
    return origin + step[..., None] * direction


def line_deviation(
    line_a: Line, line_b: Line, axis: int = 2, low: float = -0.2, high: float = 0.3
) -> dict[str, float]:
    """Return the angle between two lines (`angle_rad`), and the `mean` and `max` distance of a piece of one from the other.

    The distances are those of points of `line_b`, at which the component `axis` is between `low` and `high`, from `line_a`.
    """
    (point_a, dir_a), (point_b, dir_b) = [
        (np.asarray(point, float), np.asarray(along, float)) for point, along in (line_a, line_b)
    ]
    dir_a, dir_b = dir_a / np.linalg.norm(dir_a), dir_b / np.linalg.norm(dir_b)
    if abs(dir_b[axis]) < MIN_SLOPE:
        raise InputError(
            f"component {axis} hardly changes along the second line, so a range of it is no stretch of the line",
            got=dir_b.tolist(),
            do="choose another axis",
        )
    angle = np.arctan2(np.linalg.norm(np.cross(dir_a, dir_b)), abs(dir_a @ dir_b))
    piece = point_at(point_b, dir_b, axis, np.linspace(low, high, 101))
    distance = distances(piece, point_a[None], dir_a[None])[0]
    return {"angle_rad": float(angle), "mean": float(distance.mean()), "max": float(distance.max())}


def match_lines(fitted: xr.Dataset, reference: Sequence[Line], **options: Any) -> list[int]:
    """Return for each reference line the index of its fitted line: the assignment with the smallest sum of mean distances.

    `fitted`: lines of `fit_lines`; `options`: keyword arguments of :func:`line_deviation`, which gives the mean distances.
    """
    lines = list(zip(fitted["point"].values, fitted["direction"].values, strict=True))
    if len(lines) < len(reference):
        got = f"{len(lines)} and {len(reference)}"
        raise InputError("there are fewer fitted lines than reference lines", got=got)
    deviation = [
        [line_deviation(line, published, **options)["mean"] for line in lines]
        for published in reference
    ]
    return [int(index) for index in linear_sum_assignment(np.array(deviation))[1]]
