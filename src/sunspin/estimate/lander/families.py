"""Motions of a lander that are copies of each other, or of one family: found alike, joined, and with neighbours between them.

The readings of a few samples leave families: motions along a line or a surface that fit alike. The fits of neighbouring starts stay
a step apart along it, and as the window grows that step grows: without others between them the true motion would be lost.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from sunspin.estimate.lander.motions import RATE, STATE_SIZE, SUN, ShotFit, Shots, TrialMotions
from sunspin.estimate.settings import ShootingSettings
from sunspin.solve.rotations import move_on_sphere


def boxes(shots: Shots, reach_s: float, s: ShootingSettings) -> np.ndarray:
    """Return boxes (K, 6) of rate and direction: motions in one differ by little at a time `reach_s` from the reference."""
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
    kept = trials.take(order[first[rank]])
    return TrialMotions(kept.shots, starts[rank], kept.curvature, kept.neighbours_s)


def one_each_ridge(trials: TrialMotions, s: ShootingSettings) -> TrialMotions:
    """Return motions (best first) without those on the ridge of a better one, whose starts count for it.

    Uncertain inertia, friction and wheel make a ridge of each motion, which boxes of rate and direction cut into many.
    """
    shots, curvature = trials.shots, trials.curvature
    reach = _reach(curvature, s.ridge_chi2)
    kept, starts, left = [], [], np.arange(len(trials))
    while len(left):
        best = left[0]
        off = np.abs(shots.omega[left] - shots.omega[best])
        # of thousands few are so near in rate that their distance has to be computed
        near = np.all(off <= np.maximum(reach[left], reach[best]), axis=1)
        near[0] = True
        candidates = left[near]
        off = shots.take(candidates).from_centre(shots.take(slice(best, best + 1)))
        distance = np.minimum(_square(off, curvature[best]), _square(off, curvature[candidates]))
        copies = distance < s.ridge_chi2
        copies[0] = True
        kept.append(best)
        starts.append(int(trials.starts[candidates[copies]].sum()))
        near[near] = copies
        left = left[~near]
    joined = trials.take(np.array(kept, dtype=int))
    return TrialMotions(joined.shots, np.array(starts), joined.curvature, joined.neighbours_s)


def distinct_fits(fit: ShotFit, s: ShootingSettings) -> ShotFit:
    """Return motions fitted to all samples without copies, the likeliest first; the starts of copies count for what is kept.

    Copies lie within so many sigmas of either one. Those far less probable than the best are left out. Evidence ranks them, not
    density: where the sigma of a torque is one of several, the density is highest at no torque, in a tiny volume.
    """
    evidence = np.where(np.isfinite(fit.motions.cost), fit.log_evidence, -np.inf)
    order = np.argsort(-evidence, kind="stable")
    kept: list[int] = []
    count: list[int] = []
    for i in order[evidence[order] >= evidence[order[0]] - s.drop]:
        if kept:
            off = fit.motions.take(np.array(kept)).from_centre(fit.motions.take(slice(i, i + 1)))
            of_kept, own = _square(off, fit.curvature[kept]), _square(off, fit.curvature[i])
            distance = np.minimum(of_kept, own)
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
    """Return motions, and after them neighbours of those that are one of a family at a time `reach_s` from the reference.

    A family is uncertain in some combination of rate and direction by more than `family_rad` then. Its neighbours differ along the
    loosest combinations, alone and together. Unknowns stay: what differs by these alone is found from either.
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

    every, parent = Shots.joined(parts), np.concatenate(parents)
    _, first = np.unique(boxes(every, reach_s, s), axis=0, return_index=True)
    kept = np.union1d(first, np.arange(len(trials)))
    own = kept < len(trials)
    starts = np.where(own, trials.starts[parent[kept]], 1)
    return TrialMotions(every.take(kept), starts, neighbours_s=placed_s[parent[kept]])
