"""Trial motions of a lander: copies of each other are removed, and neighbours are added to motions that are not determined yet.

A few samples allow families of motions, along a line or a surface, that fit equally well. Fits from neighbouring starts end
somewhat apart on it. That distance, as a rotation at the end of the window, grows with the window. Without neighbours in between
the true motion would be lost. All functions take K motions with their fields as in :class:`LanderMotions`.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from sunspin.estimate.lander.motions import RATE, STATE_SIZE, SUN, LanderMotions, ModelFit
from sunspin.estimate.settings import ShootingSettings
from sunspin.solve.rotations import move_on_sphere


def boxes(motions: LanderMotions, reach_s: float, s: ShootingSettings) -> np.ndarray:
    """Return the box of each motion, as integers (K, 6): rates and directions to the Sun, rounded down.

    Boxes are so small that motions in one are alike up to `reach_s` from the reference: `box_rad` in the rotation at that time,
    `box_sun_rad` in the direction at the reference.
    """
    return np.floor(
        np.concatenate([motions.omega * (reach_s / s.box_rad), motions.sun / s.box_sun_rad], axis=1)
    ).astype(np.int64)


def one_each_box(motions: LanderMotions, reach_s: float, s: ShootingSettings) -> LanderMotions:
    """Return the best motion of each box (:func:`boxes`), best first; it gets the number of starts of all motions in the box."""
    order = np.argsort(motions.cost, kind="stable")
    box = boxes(motions.bare.take(order), reach_s, s)
    _, first, inverse = np.unique(box, axis=0, return_index=True, return_inverse=True)
    starts = np.bincount(inverse.ravel(), weights=motions.starts[order]).astype(np.int64)
    by_cost = np.argsort(first, kind="stable")
    return replace(motions.take(order[first[by_cost]]), starts=starts[by_cost])


def one_each_ridge(motions: LanderMotions, s: ShootingSettings) -> LanderMotions:
    """Return the best motion of each ridge; it gets the number of starts of all motions on the ridge. `motions`: the best first.

    Uncertain inertia, friction and wheel speed turn each solution into a ridge: a curved set of motions that fit equally well. It
    extends over many boxes of rate and direction, so :func:`one_each_box` leaves many copies.
    """
    widest = _rate_distances(motions.curvature, s.ridge_chi2)
    chosen, starts, remaining = [], [], np.arange(len(motions))
    while len(remaining):
        best = remaining[0]
        off = np.abs(motions.omega[remaining] - motions.omega[best])
        # few of thousands are near enough in rate that their distance has to be computed
        near = np.all(off <= np.maximum(widest[remaining], widest[best]), axis=1)
        # the best itself, even if its curvature is no number: it must leave `remaining`
        near[0] = True
        candidates = np.flatnonzero(near)
        on_ridge = _squared_distances(motions, best, remaining[candidates]) < s.ridge_chi2
        on_ridge[0] = True
        chosen.append(best)
        starts.append(int(motions.starts[remaining[candidates[on_ridge]]].sum()))
        remaining = np.delete(remaining, candidates[on_ridge])
    return replace(motions.take(np.array(chosen, dtype=int)), starts=np.array(starts))


def distinct_fits(fit: ModelFit, s: ShootingSettings) -> ModelFit:
    """Return motions fitted to all samples without copies and without far less probable ones, by falling evidence.

    A motion is a copy of a better one if their squared distance is below `same_chi2`; the better one gets its starts. The order is
    not by density: if the sigma of a torque is one of several, the density is highest at no torque, in a tiny volume.
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
    """Return the squared distances (k), in sigmas, between the motion with index `one` and those with the indices `others` (k).

    The squared distance of a difference d in coordinates is d . C d, where C is the curvature of the cost at a motion. It is
    computed with the C of either motion, and the smaller result counts: two motions are near if one of them is uncertain by as much
    as they differ.
    """
    difference = motions.bare.take(others).from_centre(motions.bare.take([one]))  # (k, D)
    # first the curvature (D, D) of the one for all, then (k, D, D) of each of the others
    by_curvature = (
        np.sum((difference[:, None, :] @ curvature)[:, 0] * difference, axis=1)
        for curvature in (motions.curvature[one], motions.curvature[others])
    )
    return np.minimum(*by_curvature)


def _rate_distances(curvature: np.ndarray, chi2: float) -> np.ndarray:
    """Return bounds (K, 3), rad/s, of the distance of rates within `chi2` of motions with curvatures C (K, D, D); inf: unbounded.

    All d with d . C d < chi2 have |d_i| < sqrt(chi2 (C^-1)_ii).
    """
    # C is scaled to a unit diagonal, as the units of its coordinates differ; its inverse is the sum of v v' / value
    scale = np.sqrt(np.einsum("kdd->kd", curvature)).clip(1e-12)
    values, vectors = np.linalg.eigh(curvature / (scale[:, :, None] * scale[:, None, :]))
    inverse = np.sum(vectors[:, RATE] ** 2 / values[:, None].clip(1e-300), axis=2)
    return np.where(values[:, :1] > 1e-12, np.sqrt(1.01 * chi2 * inverse) / scale[:, RATE], np.inf)


def with_neighbours(
    motions: LanderMotions, reach_s: float, max_rate: float, s: ShootingSettings
) -> LanderMotions:
    """Return the motions, then neighbours of those that belong to a family, for a window up to `reach_s` from the reference.

    A motion belongs to a family if some combination of rate and direction leaves the attitude at that time uncertain by more than
    `family_rad`. Its neighbours are displaced along the most uncertain combinations, alone and together. They have the unknowns of
    that motion, which the next fit changes. The prior limits rates to `max_rate` (rad/s).

    Along the most uncertain one there are more, up to `valley_sigmas`. A few samples of a slow body hardly determine the rate
    about the Sun direction: the cost has a long flat valley, of which one motion is kept. In a larger window the valley breaks into
    several minima.
    """
    # covariance of rate and direction with a weak prior, as a rotation (rad) at that time
    to_rad = np.array([reach_s] * 3 + [1.0] * 2)
    of_prior = np.diag([max_rate**-2] * 3 + [1.0] * 2)
    information = motions.curvature[:, :STATE_SIZE, :STATE_SIZE] + of_prior
    values, vectors = np.linalg.eigh(np.linalg.inv(information) * to_rad[:, None] * to_rad)
    loosest = slice(None, -s.family_directions - 1, -1)  # eigenvalues rise
    width, along = np.sqrt(values[:, loosest].clip(0)), vectors[:, :, loosest]
    # again only if the window has grown enough since neighbours were last placed
    due = s.again_from * motions.neighbours_s < reach_s
    free = (width > s.family_rad) & due[:, None]
    placed_s = np.where(free.any(axis=1), reach_s, motions.neighbours_s)
    originals = replace(motions.bare, starts=motions.starts, neighbours_s=placed_s)
    parts = [originals]
    # a neighbour for each choice of signs: forward, backward, or 0 for no displacement along that combination
    for signs in product((0, 1, -1), repeat=s.family_directions):
        used = np.flatnonzero(signs)
        rows = np.flatnonzero(free[:, used].all(axis=1)) if len(used) else used
        if not len(rows):
            continue
        step = s.neighbour_rad * along[rows] @ np.array(signs, dtype=np.float64) / to_rad
        moved = originals.take(rows)
        parts.append(_displaced(moved, step))
    # farther along the loosest combination, from the best motions: where there are more, starts are dense
    is_leading = motions.cost < np.min(motions.cost, initial=np.inf) + s.valley_leading
    in_valley = np.flatnonzero((free[:, 0] & is_leading)[: s.valley_motions])
    for number in range(2, s.valley_each + 1):
        rows = in_valley[number * s.neighbour_rad < s.valley_sigmas * width[in_valley, 0]]
        for side in (1.0, -1.0):
            step = side * number * s.neighbour_rad * along[rows, :, 0] / to_rad
            parts.append(_displaced(originals.take(rows), step))

    # all original motions, and the first neighbour in each box that holds no other motion
    every = LanderMotions.joined(parts)
    _, first = np.unique(boxes(every, reach_s, s), axis=0, return_index=True)
    return every.take(np.union1d(first, np.arange(len(motions))))


def _displaced(motions: LanderMotions, step: np.ndarray) -> LanderMotions:
    """Return motions (K) displaced by steps (K, 5) of rate (rad/s) and direction (rad), as starts of their own."""
    omega, sun = motions.omega + step[:, RATE], move_on_sphere(motions.sun, step[:, SUN])
    return replace(motions, omega=omega, sun=sun, starts=np.ones_like(motions.starts))
