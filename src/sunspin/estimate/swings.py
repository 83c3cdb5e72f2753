"""A body that oscillates at random about rest between the samples: all its motions are counted, not only the most probable ones.

A fit counts the motions near the one that it has found. If readings are coarse and the body oscillates, there are so many motions
that each has hardly any probability. Then some body that turns evenly fits better than each of them by chance. Here all are summed:
the density of the Sun's direction in the body spreads over the sphere as heat does, by spherical harmonics, and each reading weighs
it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.special import sph_harm_y

from sunspin.estimate.chain import RATE, TURN, Fit, costs, equations, fit, log_left_out
from sunspin.estimate.evidence import best_fit, over_shares
from sunspin.estimate.model import AS_STATED, Model, Noise, Observations, Track
from sunspin.estimate.settings import AlternativeSettings, LadderSettings
from sunspin.estimate.terms.term import facing
from sunspin.solve.rotations import rotate_by_smallest
from sunspin.vehicle.response.planes import sphere

EVERYWHERE = 2000
"""Directions on the sphere, 5 degrees apart."""

DEGREE = 24
"""Of the harmonics: a way of 0.15 rad from one reading to the next is distinguished from none."""

ROUGHLY = 0.5
"""Log evidence per sample by which the quick bound may be too low."""

SWINGS = "an oscillation quicker than the samples"
"""Name of the model."""


def swings_by_all_ways(
    nominal: Model, fits: Sequence[Fit], s: AlternativeSettings, ladder_settings: LadderSettings
) -> list[Fit]:
    """Return fits of a body that swings about rest, by each angle of the settings between two samples, under weak torques.

    `fits`: those of the other models; a size of the oscillation that cannot be as probable as the best of them is left out. Only
    the Sun is seen. The log evidence of a size is the log of the mean likelihood over all motions on the sphere, with the same
    constants as that of the other fits. The motion that stands for it is at rest.
    """
    best = best_fit([fitted for fitted in fits if fitted.model.what == AS_STATED])
    obs = nominal.obs
    wanders = np.array(s.swings_rad) / np.sqrt(float(np.median(np.diff(obs.t_s))))
    span_s = float(np.ptp(obs.t_s))
    motion = best.motions.take(np.array([np.argmax(best.log_evidence)]))
    # gains as the best motion has them: errors enlarged by what is unknown of them would count as likelihood
    held = tuple(
        term.with_fixed_unknowns(motion.u[0, own]) for term, own in nominal.terms_with_slices
    )
    known = replace(obs, terms=held)
    alone = _of_known(best.model, motion, known, ladder_settings)
    if not np.isfinite(alone.log_evidence[0]):
        return []
    # The best motion's evidence from all other readings, less the price of their unknowns, counts for the swing too. By the cost
    # alone a true rotation once stood 12 below a swing: its gains, lights and zeros had cost it 28, and the swing nothing.
    others = float(best.log_evidence.max() - alone.log_evidence[0])
    common = others + log_left_out(nominal) + nominal.log_prior
    # what the log of the mean likelihood must be at least
    least = max(float(fitted.log_evidence.max()) for fitted in fits) - s.hopeless - common
    if _bound(alone.model, alone.motions, wanders).max() + ROUGHLY * len(obs) < least:
        return []
    still = _still(motion)
    swinging = []
    for wander, log in zip(wanders, log_mean_likelihood(known, wanders), strict=True):
        if log < least:
            continue
        # under torques that turn the body less over the pass than the swing does, the sum is the same
        weak = [rung for rung in ladder_settings.rungs if rung * span_s / np.sqrt(3) <= wander]
        for rung in weak or [min(ladder_settings.rungs)]:
            model = replace(nominal, noise=Noise(rung, rate=float(wander)), what=SWINGS)
            fitted = fit(model, still, 8)
            # The mean rate is near rest: the readings leave this share of the rates that were possible before, the ratio of the
            # roots of the determinants of both covariances.
            of_rate = np.linalg.slogdet(fitted.motions.covariance[:, 0, RATE, RATE])[1] / 2
            share = of_rate - 3 * np.log(nominal.rate_sigma)
            swinging.append(replace(fitted, log_evidence=log + share + common))
    return swinging


def _of_known(model: Model, motion: Track, known: Observations, s: LadderSettings) -> Fit:
    """Return the fit of a motion (K = 1) of a model to readings of which the unknowns are held.

    The unknowns of the body stay free, and so do those of terms that have some even if held. Their evidence is summed over the
    sizes of their sigmas, as that of the fit is.
    """
    slices = zip(known.terms, model.term_slices, strict=True)
    kept = [motion.u[:, own] for term, own in slices if term.unknowns()]
    u = np.concatenate([motion.u[:, model.inertia_slice], *kept], axis=1)
    begin = Track(motion.attitude, motion.omega, u)
    fitted = fit(replace(model, obs=known), begin, s.steps, s.tolerance)
    return over_shares(fitted, s.beyond_fit)


@cache
def harmonics() -> tuple[np.ndarray, np.ndarray]:
    """Return real harmonics (`EVERYWHERE`, m) at directions all over the sphere, and l (l + 1) of each (m)."""
    x, y, z = sphere(EVERYWHERE).T
    degree, order = (
        part[np.tril_indices(DEGREE + 1)] for part in np.indices((DEGREE + 1, DEGREE + 1))
    )
    values = sph_harm_y(degree, order, np.arccos(z)[:, None], np.arctan2(y, x)[:, None])
    values = values * np.where(order > 0, np.sqrt(2.0), 1.0)
    values = np.concatenate([values.real, values.imag[:, order > 0]], axis=1)
    degree = np.concatenate([degree, degree[order > 0]])
    return values, (degree * (degree + 1)).astype(np.float64)


def log_mean_likelihood(obs: Observations, wander: np.ndarray) -> np.ndarray:
    """Return the log (s) of the mean likelihood of the Sun's readings over all motions of a body that wanders about each axis.

    `wander` (s): it turns by this times the root of the time about each axis, rad s^-0.5. Its first attitude may be any.
    Likelihoods are exp(-cost). This is a filter over the samples: `density` is that of the Sun's direction given the readings so
    far, and the product of its means is the likelihood of all of them.
    """
    everywhere = np.repeat(facing(sphere(EVERYWHERE))[:, None], len(obs), axis=1)
    cost = costs(obs, Track.free(everywhere, np.zeros((EVERYWHERE, len(obs), 3))))
    least = cost.min(axis=0)
    values, order = harmonics()
    density, total = np.ones((EVERYWHERE, len(wander))), np.full(len(wander), -least.sum())
    for k in range(len(obs)):
        if k:  # the density after the time to this sample, by the heat kernel
            decay = np.exp(-order[:, None] * wander**2 * (obs.t_s[k] - obs.t_s[k - 1]) / 2)
            density = values @ (decay * (values.T @ density)) * (4 * np.pi / EVERYWHERE)
            density = np.maximum(density, 0.0)
        density = density * np.exp(least[k] - cost[:, k])[:, None]
        mean = np.maximum(density.mean(axis=0), 1e-300)
        density, total = density / mean, total + np.log(mean)
    return total


def _bound(model: Model, motion: Track, wander: np.ndarray) -> np.ndarray:
    """Return the most (s) that the log of the mean likelihood can be for a body that wanders by `wander` (s) in rad s^-0.5.

    For each sample: of the directions that the Sun may have reached since the sample before, the part that the reading allows. The
    reading is as sharp as at one motion (K = 1), which it fits. So the bound is quick to compute, and far below any fit if readings
    are sharp.
    """
    # torques so strong that they hold nothing: what is left in the matrix are the readings
    readings_only = replace(model, noise=Noise(1.0))
    information = equations(readings_only, motion).diagonal[0, :, TURN, TURN]
    # the two larger eigenvalues: the turn about the Sun is not seen. Areas of both Gaussians are over 2 pi; the sphere has 4 pi.
    across = np.linalg.eigvalsh(information)[:, 1:]
    allowed = 1 / np.sqrt(np.maximum(across.prod(axis=1), 1e-300))
    reach = np.minimum(wander[:, None] ** 2 * np.diff(model.obs.t_s, prepend=-np.inf), 2.0)
    return np.minimum(np.log(allowed / reach), 0.0).sum(axis=1)


def _still(motion: Track) -> Track:
    """Return a motion without a rate that sees the Sun as this one (K = 1) does, and turns least from sample to sample."""
    attitude, sun = motion.attitude.copy(), motion.sun_B
    for i in range(attitude.shape[1] - 1):
        x, y = (
            rotate_by_smallest(sun[:, i], sun[:, i + 1], attitude[:, i, :, axis]) for axis in (0, 1)
        )
        attitude[:, i + 1] = np.stack([x, y, np.cross(x, y)], axis=-1)
    return Track(attitude, np.zeros_like(motion.omega), motion.u)
