"""A body that oscillates at random about rest between the samples; its evidence is a sum over all motions on the sphere.

The evidence of a fit counts only motions near the most probable one. If readings are coarse and the body oscillates, very many
motions fit, each with hardly any probability, and some body that turns evenly fits better than each of them by chance. So the
motions are summed here. The probability density of the Sun's direction in the body diffuses over the sphere, as heat does, and each
reading multiplies it by its likelihood. Spherical harmonics make the diffusion simple.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.special import sph_harm_y

from sunspin.estimate.chain import RATE, TURN, Fit, costs, equations, fit, log_left_out
from sunspin.estimate.evidence import best_nominal_fit, sum_over_shares
from sunspin.estimate.model import Model, Noise, Observations, Track
from sunspin.estimate.settings import AlternativeSettings, LadderSettings
from sunspin.estimate.terms.term import facing
from sunspin.solve.rotations import rotate_by_smallest
from sunspin.vehicle.response.planes import sphere

DIRECTIONS = 2000
"""Directions on the sphere, 5 degrees apart."""

DEGREE = 24
"""Largest degree of the spherical harmonics: a change of 0.15 rad from one reading to the next is resolved."""

BOUND_ERROR = 0.5
"""Log likelihood per sample by which the quick bound (:func:`_upper_bound`) may be too low."""

SWINGS = "an oscillation quicker than the samples"
"""Name of the model."""


def fits_of_oscillation(
    nominal: Model, fits: Sequence[Fit], s: AlternativeSettings, ladder_settings: LadderSettings
) -> list[Fit]:
    """Return fits of a body that oscillates at random about rest: one for each size of the settings and each weak torque.

    Each size (`s.swings_rad`) is a model of its own. Its log evidence is the log of the mean likelihood over all motions
    (:func:`log_mean_likelihood`), with the same constants as that of the other fits; the motion in the fit is at rest. `fits`:
    those of all other models. Sizes that are hopeless compared with the best of them are left out. Only the Sun may be measured.
    """
    best = best_nominal_fit(fits)
    motion, obs = best.motions, nominal.obs
    # in the time T the body turns by the wander times sqrt(T) about each axis, rad s^-0.5
    wanders = np.array(s.swings_rad) / np.sqrt(float(np.median(np.diff(obs.t_s))))
    # with gains and the like held as the best motion has them: errors enlarged by their uncertainty would count as likelihood
    held_terms = tuple(
        term.with_fixed_unknowns(motion.u[0, own]) for term, own in nominal.terms_with_slices
    )
    held = replace(obs, terms=held_terms)
    best_held = _fit_to_held(best.model, motion, held, ladder_settings)
    if not np.isfinite(best_held.log_evidence[0]):
        return []
    # What the unknowns change in the best motion's evidence, and readings that `held` lacks, count for the oscillation too. Else a
    # true rotation once stood 12 below an oscillation: its gains, lights and zeros had cost it 28, and the oscillation nothing.
    of_unknowns = float(best.log_evidence[0] - best_held.log_evidence[0])
    constant = of_unknowns + log_left_out(nominal) + nominal.log_prior
    # what the log of the mean likelihood must be at least
    least = max(float(fitted.log_evidence.max()) for fitted in fits) - s.hopeless - constant
    bound = _upper_bound(best_held.model, best_held.motions, wanders)
    if bound.max() + BOUND_ERROR * len(obs) < least:
        return []
    at_rest = _at_rest(motion)
    span_s = float(np.ptp(obs.t_s))
    oscillating = []
    for wander, log_likelihood in zip(wanders, log_mean_likelihood(held, wanders), strict=True):
        if log_likelihood < least:
            continue
        # torques hardly change the sum if they turn the body less over the pass T, by q sqrt(T^3 / 3), than the oscillation, by
        # wander sqrt(T): it counts under each of them
        weak = [rung for rung in ladder_settings.rungs if rung * span_s / np.sqrt(3) <= wander]
        for rung in weak or [min(ladder_settings.rungs)]:
            model = replace(nominal, noise=Noise(rung, rate=float(wander)), what=SWINGS)
            fitted = fit(model, at_rest, 8)
            # the readings leave this share of the prior of the rate: ratio of the roots of both covariances' determinants
            log_root = np.linalg.slogdet(fitted.motions.covariance[:, 0, RATE, RATE])[1] / 2
            log_share = log_root - 3 * np.log(nominal.rate_sigma)
            log_evidence = log_likelihood + log_share + constant
            oscillating.append(replace(fitted, log_evidence=log_evidence))
    return oscillating


def _fit_to_held(model: Model, motion: Track, held: Observations, s: LadderSettings) -> Fit:
    """Return the fit of a motion (K = 1) of `model` to readings `held`, whose terms are `Term.with_fixed_unknowns`.

    The unknowns of the body stay free, and so do those of terms that have some even then. Evidence is summed as in other fits.
    """
    slices = zip(held.terms, model.term_slices, strict=True)
    free = [motion.u[:, own] for term, own in slices if term.unknowns()]
    u = np.concatenate([motion.u[:, model.inertia_slice], *free], axis=1)
    begin = Track(motion.attitude, motion.omega, u)
    fitted = fit(replace(model, obs=held), begin, s.steps, s.tolerance)
    return sum_over_shares(fitted, s.beyond_fit)


@cache
def harmonics() -> tuple[np.ndarray, np.ndarray]:
    """Return the m real spherical harmonics up to `DEGREE` at directions all over the sphere (`DIRECTIONS`, m), and l (l + 1) (m).

    l is the degree of each. By diffusion a harmonic decays at a rate proportional to l (l + 1). The real harmonics are the real and
    imaginary parts of the complex ones of order zero and above. A factor of sqrt(2) for orders above zero makes them orthonormal.
    """
    x, y, z = sphere(DIRECTIONS).T
    degree, order = np.tril_indices(DEGREE + 1)  # all pairs with order <= degree
    values = sph_harm_y(degree, order, np.arccos(z)[:, None], np.arctan2(y, x)[:, None])
    values = values * np.where(order > 0, np.sqrt(2.0), 1.0)
    # the imaginary parts of order zero are zero
    values = np.concatenate([values.real, values.imag[:, order > 0]], axis=1)
    degree = np.concatenate([degree, degree[order > 0]])
    return values, (degree * (degree + 1)).astype(np.float64)


def log_mean_likelihood(obs: Observations, wander: np.ndarray) -> np.ndarray:
    """Return the log (w) of the mean likelihood of the Sun's readings over all motions of a body that wanders about each axis.

    `wander` (w), rad s^-0.5: in the time T the body turns by this times sqrt(T) about each axis, one sigma. Its first attitude may
    be any. The likelihood of a direction at a sample is exp(-cost). This is a filter over the samples: `density` is that of the
    Sun's direction given the readings so far, and the product of its means is the likelihood of all of them.
    """
    attitudes = np.repeat(facing(sphere(DIRECTIONS))[:, None], len(obs), axis=1)
    cost = costs(obs, Track.unfitted(attitudes, np.zeros((DIRECTIONS, len(obs), 3))))
    least = cost.min(axis=0)  # taken out of the exponentials, against underflow
    values, l_times_l_plus_1 = harmonics()
    density, total = np.ones((DIRECTIONS, len(wander))), np.full(len(wander), -least.sum())
    for k in range(len(obs)):
        if k:
            # diffusion over the time T to this sample: each harmonic decays by exp(-l (l + 1) wander^2 T / 2)
            interval_s = obs.t_s[k] - obs.t_s[k - 1]
            decay = np.exp(-l_times_l_plus_1[:, None] * wander**2 * interval_s / 2)
            # sum over the directions, each of which stands for the area 4 pi / DIRECTIONS
            density = values @ (decay * (values.T @ density)) * (4 * np.pi / DIRECTIONS)
            density = np.maximum(density, 0.0)
        density = density * np.exp(least[k] - cost[:, k])[:, None]
        mean = np.maximum(density.mean(axis=0), 1e-300)
        density, total = density / mean, total + np.log(mean)
    return total


def _upper_bound(model: Model, motion: Track, wander: np.ndarray) -> np.ndarray:
    """Return an approximate upper bound (w) of :func:`log_mean_likelihood` for bodies that wander by `wander` (w), rad s^-0.5.

    Of the directions that the Sun may have reached since the sample before, a reading allows a share. The logs of these shares are
    added up. The errors of the readings are those at one motion (K = 1), which must fit. The bound is quick to compute.
    """
    # torques so strong that the equations of motion determine nothing: the matrix is that of the readings
    readings_only = replace(model, noise=Noise(1.0))
    information = equations(readings_only, motion).diagonal[0, :, TURN, TURN]
    # Two areas, over 2 pi. `allowed` by a reading is that of a Gaussian: the two larger eigenvalues are of turns that move the Sun.
    # `reach` of the Sun is that of a Gaussian too, but at most 2, the whole sphere. At the first sample it is 2.
    across = np.linalg.eigvalsh(information)[:, 1:]
    allowed = 1 / np.sqrt(np.maximum(across.prod(axis=1), 1e-300))
    reach = np.minimum(wander[:, None] ** 2 * np.diff(model.obs.t_s, prepend=-np.inf), 2.0)
    return np.minimum(np.log(allowed / reach), 0.0).sum(axis=1)


def _at_rest(motion: Track) -> Track:
    """Return attitudes that see the Sun as a motion (K = 1) does and turn least from sample to sample, with rates of zero."""
    attitude, sun = motion.attitude.copy(), motion.sun_B
    for i in range(attitude.shape[1] - 1):
        # the first two columns are the x and y axis of N, in body axes; z is the Sun
        x, y = (
            rotate_by_smallest(sun[:, i], sun[:, i + 1], attitude[:, i, :, axis]) for axis in (0, 1)
        )
        attitude[:, i + 1] = np.stack([x, y, np.cross(x, y)], axis=-1)
    return Track(attitude, np.zeros_like(motion.omega), motion.u)
