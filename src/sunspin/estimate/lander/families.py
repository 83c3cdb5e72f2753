"""Trial motions of a lander that are copies of each other, and neighbours placed between motions of one family.

A few samples allow families of motions, along a line or a surface, that fit equally well. Fits from neighbouring starts end a step
apart on it. That step grows with the window, and without neighbours between them the true motion would be lost.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from sunspin.estimate.lander.motions import RATE, STATE_SIZE, SUN, ShotFit, Shots, TrialMotions
from sunspin.estimate.settings import ShootingSettings
from sunspin.solve.rotations import move_on_sphere


def boxes(shots: Shots, reach_s: float, s: ShootingSettings) -> np.ndarray:
    """Return the index (K, 6) of the box of rate and direction of each motion: in one box motions are alike for `reach_s`."""
    return np.floor(
        np.concatenate([shots.omega * (reach_s / s.box_rad), shots.sun / s.box_sun_rad], axis=1)
    ).astype(np.int64)


def one_each_box(trials: TrialMotions, reach_s: float, s: ShootingSettings) -> TrialMotions:
    """Return the best motion of each box, best first, with all its starts."""
    order = np.argsort(trials.cost, kind="stable")
    box = boxes(trials.shots.take(order), reach_s, s)
    _, first, inverse = np.unique(box, axis=0, return_index=True, return_inverse=True)
    starts = np.bincount(inverse.ravel(), weights=trials.starts[order]).astype(np.int64)
    rank = np.argsort(first, kind="stable")
    return replace(trials.take(order[first[rank]]), starts=starts[rank])


def one_each_ridge(trials: TrialMotions, s: ShootingSettings) -> TrialMotions:
    """Return motions (best first) without those on the ridge of a better one, which gets their starts.

    Uncertain inertia, friction and wheel turn each solution into a ridge, which extends over many boxes of rate and direction.
    """
    shots, curvature = trials.shots, trials.curvature
    reach = _reach(curvature, s.ridge_chi2)
    chosen, starts, remaining = [], [], np.arange(len(trials))
    while len(remaining):
        best = remaining[0]
        off = np.abs(shots.omega[remaining] - shots.omega[best])
        # few of thousands are near enough in rate that their distance has to be computed
        near = np.all(off <= np.maximum(reach[remaining], reach[best]), axis=1)
        near[0] = True
        candidates = remaining[near]
        off = shots.take(candidates).from_centre(shots.take(slice(best, best + 1)))
        distance = np.minimum(_square(off, curvature[best]), _square(off, curvature[candidates]))
        copies = distance < s.ridge_chi2
        copies[0] = True
        chosen.append(best)
        starts.append(int(trials.starts[candidates[copies]].sum()))
        near[near] = copies
        remaining = remaining[~near]
    best_ones = trials.take(np.array(chosen, dtype=int))
    return replace(best_ones, starts=np.array(starts))


def distinct_fits(fit: ShotFit, s: ShootingSettings) -> ShotFit:
    """Return motions fitted to all samples without copies and without far less probable ones, by falling evidence.

    Copies are within so many sigmas of either one; the better one gets their starts. The order is not by density: if the sigma of
    a torque is one of several, the density is highest at no torque, in a tiny volume.
    """
    evidence = np.where(np.isfinite(fit.motions.cost), fit.log_evidence, -np.inf)
    order = np.argsort(-evidence, kind="stable")
    kept: list[int] = []
    count: list[int] = []
    for i in order[evidence[order] >= evidence[order[0]] - s.drop]:
        if kept:
            off = fit.motions.take(np.array(kept)).from_centre(fit.motions.take(slice(i, i + 1)))
            distance = np.minimum(_square(off, fit.curvature[kept]), _square(off, fit.curvature[i]))
            nearest = int(np.argmin(distance))
            if distance[nearest] < s.same_chi2:
                count[nearest] += int(fit.starts[i])
                continue
        kept.append(int(i))
        count.append(int(fit.starts[i]))
    return replace(fit.take(np.array(kept)), starts=np.array(count))


def _square(off: np.ndarray, metric: np.ndarray) -> np.ndarray:
    """Return squared lengths (k) of vectors (k, D) under one metric (D, D), or under one each (k, D, D)."""
    return np.sum((off[:, None, :] @ metric)[:, 0] * off, axis=1)


def _reach(curvature: np.ndarray, chi2: float) -> np.ndarray:
    """Return bounds (K, 3) of how far the rates of motions on one ridge are apart, by curvatures (K, D, D); inf: unbounded."""
    size = np.sqrt(np.einsum("kdd->kd", curvature)).clip(1e-12)
    values, vectors = np.linalg.eigh(curvature / (size[:, :, None] * size[:, None, :]))
    across = np.sum(vectors[:, RATE] ** 2 / values[:, None].clip(1e-300), axis=2)
    return np.where(values[:, :1] > 1e-12, np.sqrt(1.01 * chi2 * across) / size[:, RATE], np.inf)


def with_neighbours(
    trials: TrialMotions, reach_s: float, max_rate: float, s: ShootingSettings
) -> TrialMotions:
    """Return motions, and after them neighbours of those that belong to a family, for a window up to `reach_s` from the reference.

    A motion belongs to a family if some combination of rate and direction leaves the attitude at that time uncertain by more than
    `family_rad`. Its neighbours are displaced along the most uncertain combinations, alone and together. Their unknowns are the
    same, as a fit finds those from either.
    """
    size = np.array([reach_s] * 3 + [1.0] * 2)  # rad at that time per unit of each coordinate
    least = np.diag([max_rate**-2] * 3 + [1.0] * 2)  # information of the prior
    information = trials.curvature[:, :STATE_SIZE, :STATE_SIZE] + least
    values, vectors = np.linalg.eigh(np.linalg.inv(information) * size[:, None] * size)
    loosest = slice(None, -s.family_directions - 1, -1)  # eigenvalues rise
    width, along = np.sqrt(values[:, loosest].clip(0)), vectors[:, :, loosest]
    # again only if the window has grown enough since neighbours were last placed
    due = s.again_from * trials.neighbours_s < reach_s
    free = (width > s.family_rad) & due[:, None]
    placed_s = np.where(free.any(axis=1), reach_s, trials.neighbours_s)

    parts, parents = [trials.shots], [np.arange(len(trials))]
    # a neighbour for each choice of signs of the directions, 0: not along it
    for signs in product((0, 1, -1), repeat=s.family_directions):
        which = np.flatnonzero(signs)
        rows = np.flatnonzero(free[:, which].all(axis=1)) if len(which) else which
        if not len(rows):
            continue
        step = s.neighbour_rad * along[rows] @ np.array(signs, dtype=np.float64) / size
        own = trials.shots.take(rows)
        sun = move_on_sphere(own.sun, step[:, SUN])
        parts.append(Shots(own.omega + step[:, RATE], sun, own.u, own.cost))
        parents.append(rows)

    # all given motions, and of neighbours the first in each box that no other motion is in
    every, parent = Shots.joined(parts), np.concatenate(parents)
    _, first = np.unique(boxes(every, reach_s, s), axis=0, return_index=True)
    chosen = np.union1d(first, np.arange(len(trials)))
    is_given = chosen < len(trials)
    starts = np.where(is_given, trials.starts[parent[chosen]], 1)
    return TrialMotions(every.take(chosen), starts, neighbours_s=placed_s[parent[chosen]])
