"""Straight lines through a cloud of points when nobody says which point belongs to which line.

The fit minimises the sum of (not squared) distances of the points to their nearest line, as the paper fits its four lines
to the near-minimum set (section 2.3). Candidate lines through pairs of points, a facility-location search for the best few
of them, then alternating assignment and refinement of each line to the smallest sum of distances.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.errors import InputError, sentence

N_CANDIDATES = 600
N_SEARCH_POINTS = 1500
"""Points and candidate lines that the search looks at; all points are used in the refinement."""

N_RESTARTS = 8
MIN_DISTANCE = 1e-9
"""Floor of the distances in the reweighting, so that points on the line do not take all the weight."""


def distances(points: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Distances of points (n, 3) to lines given by points (m, 3) and unit directions (m, 3): (m, n)."""
    offset = points[None] - origin[:, None]
    along = np.einsum("mni,mi->mn", offset, direction)
    return np.sqrt(np.maximum(np.einsum("mni,mni->mn", offset, offset) - along**2, 0.0))


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
        raise InputError(sentence("points must have the shape (n, 3) and be finite", got=cloud.shape))
    if n_lines < 1 or len(np.unique(cloud, axis=0)) < 2 * n_lines:
        raise InputError(
            sentence(
                f"{n_lines} lines need at least {2 * n_lines} different points",
                got=len(np.unique(cloud, axis=0)),
                do="take a larger near-minimum set or fewer lines",
            )
        )
    rng = np.random.default_rng(seed)
    cloud = cloud[np.lexsort(cloud.T)]  # so that the order of the points does not matter
    best_cost, best = np.inf, None
    for _ in range(N_RESTARTS):
        lines = _refine(cloud, *_search(cloud, n_lines, rng))
        cost = distances(cloud, *lines).min(axis=0).sum()
        if cost < best_cost - 1e-12:
            best_cost, best = cost, lines
    return _dataset(np.asarray(points, dtype=np.float64), *best)


def _search(cloud: np.ndarray, n_lines: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """The best few of many candidate lines: greedy choice, then swaps while they help."""
    sample = cloud if len(cloud) <= N_SEARCH_POINTS else cloud[rng.choice(len(cloud), N_SEARCH_POINTS, replace=False)]
    pairs = rng.integers(len(sample), size=(N_CANDIDATES, 2))
    step = sample[pairs[:, 1]] - sample[pairs[:, 0]]
    length = np.linalg.norm(step, axis=1)
    usable = length > 0
    origin, direction = sample[pairs[usable, 0]], step[usable] / length[usable, None]
    cost = distances(sample, origin, direction)
    chosen: list[int] = []
    nearest = np.full(len(sample), np.inf)
    for _ in range(n_lines):
        totals = np.minimum(cost, nearest).sum(axis=1)
        chosen.append(int(np.argmin(totals)))
        nearest = np.minimum(nearest, cost[chosen[-1]])
    improved = True
    while improved:
        improved = False
        for slot in range(n_lines):
            others = [c for k, c in enumerate(chosen) if k != slot]
            rest = cost[others].min(axis=0) if others else np.full(len(sample), np.inf)
            totals = np.minimum(cost, rest).sum(axis=1)
            candidate = int(np.argmin(totals))
            if totals[candidate] < totals[chosen[slot]] - 1e-12:
                chosen[slot], improved = candidate, True
    return origin[chosen], direction[chosen]


def _refine(cloud: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Alternate between assigning points and fitting each line to its points, until the assignment settles."""
    origin, direction = origin.copy(), direction.copy()
    member = None
    for _ in range(50):
        assigned = distances(cloud, origin, direction).argmin(axis=0)
        if member is not None and np.array_equal(assigned, member):
            break
        member = assigned
        for k in range(len(origin)):
            mine = cloud[member == k]
            if len(mine) >= 2:
                origin[k], direction[k] = line_through(mine, origin[k], direction[k])
    return origin, direction


def line_through(points: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The line with the smallest sum of distances to points (n, 3), from a first guess: iteratively reweighted least squares."""
    cost = np.inf
    for _ in range(200):
        distance = distances(points, origin[None], direction[None])[0]
        if cost - distance.sum() < 1e-12 * max(distance.sum(), MIN_DISTANCE):
            break
        cost = distance.sum()
        weight = 1.0 / np.maximum(distance, MIN_DISTANCE)
        centre = weight @ points / weight.sum()
        spread = points - centre
        new_direction = np.linalg.eigh((weight[:, None] * spread).T @ spread)[1][:, -1]
        if distances(points, centre[None], new_direction[None])[0].sum() > cost:
            break
        origin, direction = centre, new_direction
    return origin, direction


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
            "point": (("line", "axis"), origin, {"units": "rad/s"}),
            "direction": (("line", "axis"), direction, {"units": "1"}),
            "mean_distance": ("line", mean, {"units": "rad/s"}),
            "count": ("line", counts),
            "member": ("n", member),
        },
        coords={"axis": ["x", "y", "z"]},
    )


def point_at(origin: np.ndarray, direction: np.ndarray, axis: int, value: npt.ArrayLike) -> np.ndarray:
    """Points (..., 3) of a line at which component `axis` has the given values."""
    step = (np.asarray(value, dtype=np.float64) - origin[axis]) / direction[axis]
    return origin + step[..., None] * direction


def line_deviation(line_a: tuple, line_b: tuple, axis: int = 2, low: float = -0.2, high: float = 0.3) -> dict[str, float]:
    """How far two lines (point, direction) are apart: angle in rad, mean and largest distance over a range of one component.

    Distances are from the points of `line_b` in the range to line `line_a`.
    """
    (point_a, dir_a), (point_b, dir_b) = [(np.asarray(p, float), np.asarray(d, float)) for p, d in (line_a, line_b)]
    dir_a, dir_b = dir_a / np.linalg.norm(dir_a), dir_b / np.linalg.norm(dir_b)
    angle = np.arctan2(np.linalg.norm(np.cross(dir_a, dir_b)), abs(dir_a @ dir_b))
    apart = distances(point_at(point_b, dir_b, axis, np.linspace(low, high, 101)), point_a[None], dir_a[None])[0]
    return {"angle_rad": float(angle), "mean": float(apart.mean()), "max": float(apart.max())}


def match_lines(fitted: xr.Dataset, reference: list[tuple], **options: float) -> list[int]:
    """For each reference line (point, direction) the index of the fitted line that is its partner: smallest total distance."""
    lines = list(zip(fitted["point"].values, fitted["direction"].values, strict=True))
    cost = np.array([[line_deviation(line, other, **options)["mean"] for line in lines] for other in reference])
    choices = permutations(range(len(lines)), len(reference))
    return list(min(choices, key=lambda choice: sum(cost[i, j] for i, j in enumerate(choice))))
