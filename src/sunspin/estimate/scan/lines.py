"""Straight lines through a cloud of points when nobody says which point belongs to which line.

The fit minimises the sum of (not squared) distances of the points to their nearest line, as the paper fits its four lines
to the near-minimum set (section 2.3). Candidate lines through pairs of points, a facility-location search for the best few
of them from many starts, then alternating assignment and refinement of each line to the smallest sum of distances.
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
"""A point of it and its direction, (3) each."""

N_CANDIDATES = 400
N_SEARCH_POINTS = 800
"""Candidate lines and points that the search looks at; all points are used in the refinement."""

SEARCH_WORK = 6_000_000
MIN_STARTS, MAX_STARTS = 12, 100
"""The search begins as often as this many point-line distances allow: small clouds are cheap and need it most."""

N_REFINED = 4
"""So many of the best sets of candidates are refined: the search ranks sets of lines through two points each."""

MAX_ROUNDS = 60
TOLERANCE = 1e-12
"""Relative decrease of the sum of distances below which a refinement has arrived."""

SMOOTHING_STEPS = 40
"""Halvings of the length below which distances are smoothed: from the cloud's own width down to rounding."""


def distances(points: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Distances of points (n, 3) to lines given by points (m, 3) and unit directions (m, 3): (m, n)."""
    offset = points[None] - origin[:, None]
    offset -= np.einsum("mni,mi->mn", offset, direction)[..., None] * direction[:, None]
    return np.sqrt(np.einsum("mni,mni->mn", offset, offset))


def fit_lines(points: npt.ArrayLike, n_lines: int = 4, seed: int = 0) -> xr.Dataset:
    """Fit `n_lines` straight lines to points by the smallest sum of distances to the nearest line.

    Parameters
    ----------
    points : (n, 3)
        At least two per line.
    seed : int
        Of the random choice of candidate lines.

    Returns
    -------
    xarray.Dataset
        `point (line, axis)`: on the line, nearest the middle of its members; `direction (line, axis)`: unit, its last
        component that is not zero positive; `member (n)`: the line of each point; `mean_distance (line)`; `count (line)`.
        Lines are ordered by their number of members, the largest first.
    """
    cloud = np.asarray(points, dtype=np.float64)
    if cloud.ndim != 2 or cloud.shape[1] != 3 or not np.all(np.isfinite(cloud)):
        raise InputError("points must have the shape (n, 3) and be finite", got=cloud.shape)
    if n_lines < 1 or len(np.unique(cloud, axis=0)) < 2 * n_lines:
        raise InputError(
            f"{n_lines} lines need at least {2 * n_lines} different points",
            got=len(np.unique(cloud, axis=0)),
            do="take a larger near-minimum set or fewer lines",
        )
    cloud = cloud[np.lexsort(cloud.T)]  # so that the order of the points does not matter
    found = [
        _refine(cloud, *start) for start in _search(cloud, n_lines, np.random.default_rng(seed))
    ]
    best, best_cost = found[0], _total(cloud, *found[0])
    for lines in found[1:]:
        cost = _total(cloud, *lines)
        if cost < best_cost * (1 - TOLERANCE):
            best_cost, best = cost, lines
    return _dataset(np.asarray(points, dtype=np.float64), *best).assign_attrs(
        provenance("lines", seed=seed)
    )


def _total(cloud: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> float:
    return float(distances(cloud, origin, direction).min(axis=0).sum())


def _candidates(cloud: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Lines (origin, direction) through pairs of different points: all pairs of a small cloud, random ones of a large."""
    distinct = np.unique(cloud, axis=0)
    first, second = (
        np.triu_indices(len(distinct), 1)
        if len(distinct) <= 60
        else rng.integers(len(distinct), size=(2, 4096))
    )
    use = np.flatnonzero(first != second)
    if len(use) > N_CANDIDATES:
        use = rng.choice(use, N_CANDIDATES, replace=False)
    step = distinct[second[use]] - distinct[first[use]]
    return distinct[first[use]], step / np.linalg.norm(step, axis=1, keepdims=True)


def _search(
    cloud: np.ndarray, n_lines: int, rng: np.random.Generator
) -> list[tuple[np.ndarray, np.ndarray]]:
    """The best few sets of candidate lines: a greedy start and random ones, each improved by swaps while they help."""
    sample = (
        cloud
        if len(cloud) <= N_SEARCH_POINTS
        else cloud[rng.choice(len(cloud), N_SEARCH_POINTS, replace=False)]
    )
    origin, direction = _candidates(cloud, rng)
    cost = distances(sample, origin, direction)
    n_starts = int(np.clip(SEARCH_WORK // cost.size, MIN_STARTS, MAX_STARTS))
    starts = [_greedy(cost, n_lines)] + [
        rng.integers(len(cost), size=n_lines).tolist() for _ in range(n_starts - 1)
    ]
    found: dict[tuple[int, ...], float] = {}
    for start in starts:
        chosen = tuple(sorted(_swapped(cost, start)))
        found[chosen] = float(cost[list(chosen)].min(axis=0).sum())
    ranked = sorted(found, key=lambda chosen: (found[chosen], chosen))[:N_REFINED]
    return [(origin[list(chosen)], direction[list(chosen)]) for chosen in ranked]


def _greedy(cost: np.ndarray, n_lines: int) -> list[int]:
    """One candidate (row of `cost`) after the other, each the one that helps most."""
    chosen: list[int] = []
    nearest = np.full(cost.shape[1], np.inf)
    for _ in range(n_lines):
        chosen.append(int(np.argmin(np.minimum(cost, nearest).sum(axis=1))))
        nearest = np.minimum(nearest, cost[chosen[-1]])
    return chosen


def _swapped(cost: np.ndarray, chosen: list[int]) -> list[int]:
    """Exchange one chosen candidate for any other as long as the sum of distances falls."""
    chosen, unchanged, slot = list(chosen), 0, 0
    while unchanged < len(chosen):
        others = [candidate for k, candidate in enumerate(chosen) if k != slot]
        rest = cost[others].min(axis=0) if others else np.full(cost.shape[1], np.inf)
        totals = np.minimum(cost, rest).sum(axis=1)
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
    """Alternate between assigning points and fitting each line to its points, until the assignment settles."""
    origin, direction = origin.copy(), direction.copy()
    member = np.full(len(cloud), -1)
    for _ in range(MAX_ROUNDS):
        before, member = member, distances(cloud, origin, direction).argmin(axis=0)
        changed = np.unique(np.concatenate([before[before != member], member[before != member]]))
        if changed.size == 0:
            break
        for k in changed[changed >= 0]:  # a line whose points stayed the same stays as it is
            mine = cloud[member == k]
            if len(mine) >= 2:
                origin[k], direction[k] = line_through(mine, origin[k], direction[k])
    return origin, direction


def line_through(
    points: np.ndarray, origin: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The line with the smallest sum of distances d to points (n, 3), near a first guess; never worse than the guess.

    Iteratively reweighted least squares on the sum of sqrt(d^2 + s^2), the smoothing s falling by halves from the width of
    the cloud about the guess. Without smoothing, a guess through two of the points would hold on to them for ever: their
    weights 1/d are infinite.
    """
    distance = distances(points, origin[None], direction[None])[0]
    best = distance.sum(), origin, direction
    smoothing = float(distance.max())
    if smoothing <= 0:
        return origin, direction
    floor, previous = smoothing * 0.5**SMOOTHING_STEPS, np.inf
    for _ in range(4 * SMOOTHING_STEPS):
        weight = 1.0 / np.hypot(distance, smoothing)
        centre = weight @ points / weight.sum()
        spread = points - centre
        axis = np.linalg.eigh((weight[:, None] * spread).T @ spread)[1][:, -1]
        distance = distances(points, centre[None], axis[None])[0]
        cost = distance.sum()
        if cost < best[0]:
            best = cost, centre, axis
        if smoothing <= floor and previous - cost < TOLERANCE * cost:
            break
        previous, smoothing = cost, max(smoothing / 2, floor)
    return best[1], best[2]


def _dataset(points: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> xr.Dataset:
    table = distances(points, origin, direction)
    member = table.argmin(axis=0)
    counts = np.bincount(member, minlength=len(origin))
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
    nearest = table.min(axis=0)
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


MIN_SLOPE = 1e-9
"""A line whose unit direction has a smaller component than this does not reach other values of that component."""


def point_at(
    origin: np.ndarray, direction: np.ndarray, axis: int, value: npt.ArrayLike
) -> np.ndarray:
    """Points (..., 3) of a line at which component `axis` has the given values."""
    step = (np.asarray(value, dtype=np.float64) - origin[axis]) / direction[axis]
    return origin + step[..., None] * direction


def line_deviation(
    line_a: Line, line_b: Line, axis: int = 2, low: float = -0.2, high: float = 0.3
) -> dict[str, float]:
    """How far two lines (point, direction) are apart: angle in rad, mean and largest distance over a range of one component.

    Distances are from the points of `line_b` in the range to line `line_a`.
    """
    (point_a, dir_a), (point_b, dir_b) = [
        (np.asarray(p, float), np.asarray(d, float)) for p, d in (line_a, line_b)
    ]
    dir_a, dir_b = dir_a / np.linalg.norm(dir_a), dir_b / np.linalg.norm(dir_b)
    if abs(dir_b[axis]) < MIN_SLOPE:
        raise InputError(
            f"component {axis} hardly changes along the second line, so a range of it is no stretch of the line",
            got=dir_b.tolist(),
            do="choose another axis",
        )
    angle = np.arctan2(np.linalg.norm(np.cross(dir_a, dir_b)), abs(dir_a @ dir_b))
    apart = distances(
        point_at(point_b, dir_b, axis, np.linspace(low, high, 101)), point_a[None], dir_a[None]
    )[0]
    return {"angle_rad": float(angle), "mean": float(apart.mean()), "max": float(apart.max())}


def match_lines(fitted: xr.Dataset, reference: Sequence[Line], **options: Any) -> list[int]:
    """For each reference line (point, direction) the index of the fitted line that is its partner: smallest total distance.

    `options` are those of :func:`line_deviation`, whose mean distance is the cost of a pair.
    """
    lines = list(zip(fitted["point"].values, fitted["direction"].values, strict=True))
    if len(lines) < len(reference):
        raise InputError(
            "there are fewer fitted lines than reference lines",
            got=f"{len(lines)} and {len(reference)}",
        )
    cost = np.array(
        [[line_deviation(line, other, **options)["mean"] for line in lines] for other in reference]
    )
    return [int(index) for index in linear_sum_assignment(cost)[1]]
