"""Trial motions of a lander that are copies of each other, and neighbours placed between motions of one family.

A few samples allow families of motions, along a line or a surface, that fit equally well. Fits from neighbouring starts end a step
apart on it. That step grows with the window, and without neighbours between them the true motion would be lost.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from sunspin.estimate.lander.motions import RATE, STATE_SIZE, SUN, LanderMotions, ModelFit
from sunspin.estimate.settings import ShootingSettings
from sunspin.solve.rotations import move_on_sphere


def boxes(motions: LanderMotions, reach_s: float, s: ShootingSettings) -> np.ndarray:
    """Return the index (K, 6) of the box of rate and direction of each motion.

    In one box motions are alike up to `reach_s` from the reference.
    """
    return np.floor(
        np.concatenate([motions.omega * (reach_s / s.box_rad), motions.sun / s.box_sun_rad], axis=1)
    ).astype(np.int64)


def one_each_box(motions: LanderMotions, reach_s: float, s: ShootingSettings) -> LanderMotions:
    """Return the best motion of each box, best first, with all its starts."""
    order = np.argsort(motions.cost, kind="stable")
    box = boxes(motions.bare.take(order), reach_s, s)
    _, first, inverse = np.unique(box, axis=0, return_index=True, return_inverse=True)
    starts = np.bincount(inverse.ravel(), weights=motions.starts[order]).astype(np.int64)
    rank = np.argsort(first, kind="stable")
    return replace(motions.take(order[first[rank]]), starts=starts[rank])


def one_each_ridge(motions: LanderMotions, s: ShootingSettings) -> LanderMotions:
    """Return the best motion of each ridge; its number of starts is that of all motions on the ridge. `motions`: the best first.

    Uncertain inertia, friction and wheel speed turn each solution into a ridge. It extends over many boxes of rate and direction,
    so :func:`one_each_box` leaves many copies.
    """
    reach = _reach(motions.curvature, s.ridge_chi2)
    chosen, starts, remaining = [], [], np.arange(len(motions))
    while len(remaining):
        best = remaining[0]
        off = np.abs(motions.omega[remaining] - motions.omega[best])
        # few of thousands are near enough in rate that their distance has to be computed
        near = np.all(off <= np.maximum(reach[remaining], reach[best]), axis=1)
        near[0] = True
        candidates = remaining[near]
        on_ridge = _squared_distances(motions, best, candidates) < s.ridge_chi2
        on_ridge[0] = True
        chosen.append(best)
        starts.append(int(motions.starts[candidates[on_ridge]].sum()))
        near[near] = on_ridge  # from here on it marks those on the ridge, which are removed
        remaining = remaining[~near]
    return replace(motions.take(np.array(chosen, dtype=int)), starts=np.array(starts))


def distinct_fits(fit: ModelFit, s: ShootingSettings) -> ModelFit:
    """Return motions fitted to all samples without copies and without far less probable ones, by falling evidence.

    Copies are within so many sigmas of either one; the better one gets their starts. The order is not by density: if the sigma of
    a torque is one of several, the density is highest at no torque, in a tiny volume.
    """
    motions = fit.motions
    evidence = np.where(np.isfinite(motions.cost), fit.log_evidence, -np.inf)
    order = np.argsort(-evidence, kind="stable")
    kept: list[int] = []
    starts: list[int] = []
    for i in order[evidence[order] >= evidence[order[0]] - s.drop]:
        if kept:
            distance = _squared_distances(motions, i, np.array(kept))
            nearest = int(np.argmin(distance))
            if distance[nearest] < s.same_chi2:
                starts[nearest] += int(motions.starts[i])
                continue
        kept.append(int(i))
        starts.append(int(motions.starts[i]))
    fit = fit.take(np.array(kept))
    return replace(fit, motions=replace(fit.motions, starts=np.array(starts)))


def _squared_distances(motions: LanderMotions, one: int, others: np.ndarray) -> np.ndarray:
    """Return squared distances (k) of motions with the indices `others` (k) from one motion, in the larger sigma of both."""
    off = motions.bare.take(others).from_centre(motions.bare.take([one]))
    by_curvature = (
        np.sum((off[:, None, :] @ curvature)[:, 0] * off, axis=1)
        for curvature in (motions.curvature[one], motions.curvature[others])
    )
    return np.minimum(*by_curvature)


def _reach(curvature: np.ndarray, chi2: float) -> np.ndarray:
    """Return bounds (K, 3) of how far the rates of motions on one ridge are apart, by curvatures (K, D, D); inf: unbounded."""
    size = np.sqrt(np.einsum("kdd->kd", curvature)).clip(1e-12)
    values, vectors = np.linalg.eigh(curvature / (size[:, :, None] * size[:, None, :]))
    across = np.sum(vectors[:, RATE] ** 2 / values[:, None].clip(1e-300), axis=2)
    return np.where(values[:, :1] > 1e-12, np.sqrt(1.01 * chi2 * across) / size[:, RATE], np.inf)


def with_neighbours(
    motions: LanderMotions, reach_s: float, max_rate: float, s: ShootingSettings
) -> LanderMotions:
    """Return motions, and after them neighbours of those that belong to a family, for a window up to `reach_s` from the reference.

    A motion belongs to a family if some combination of rate and direction leaves the attitude at that time uncertain by more than
    `family_rad`. Its neighbours are displaced along the most uncertain combinations, alone and together. Their unknowns are the
    same, as a fit finds those from either.
    """
    size = np.array([reach_s] * 3 + [1.0] * 2)  # rad at that time per unit of each coordinate
    least = np.diag([max_rate**-2] * 3 + [1.0] * 2)  # information of the prior
    information = motions.curvature[:, :STATE_SIZE, :STATE_SIZE] + least
    values, vectors = np.linalg.eigh(np.linalg.inv(information) * size[:, None] * size)
    loosest = slice(None, -s.family_directions - 1, -1)  # eigenvalues rise
    width, along = np.sqrt(values[:, loosest].clip(0)), vectors[:, :, loosest]
    # again only if the window has grown enough since neighbours were last placed
    due = s.again_from * motions.neighbours_s < reach_s
    free = (width > s.family_rad) & due[:, None]
    placed_s = np.where(free.any(axis=1), reach_s, motions.neighbours_s)
    given = replace(motions.bare, starts=motions.starts, neighbours_s=placed_s)
    parts = [given]
    # a neighbour for each choice of signs of the directions, 0: not along it
    for signs in product((0, 1, -1), repeat=s.family_directions):
        which = np.flatnonzero(signs)
        rows = np.flatnonzero(free[:, which].all(axis=1)) if len(which) else which
        if not len(rows):
            continue
        step = s.neighbour_rad * along[rows] @ np.array(signs, dtype=np.float64) / size
        own = given.take(rows)
        omega, sun = own.omega + step[:, RATE], move_on_sphere(own.sun, step[:, SUN])
        parts.append(replace(own, omega=omega, sun=sun, starts=np.ones_like(own.starts)))

    # all given motions, and of neighbours the first in each box that no other motion is in
    every = LanderMotions.joined(parts)
    _, first = np.unique(boxes(every, reach_s, s), axis=0, return_index=True)
    return every.take(np.union1d(first, np.arange(len(motions))))
