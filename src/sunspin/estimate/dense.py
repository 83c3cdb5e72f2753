"""Motions carried from the samples to which they were fitted to all others, and the misfit of each sensor there.

Between two kept samples a motion is propagated forward from the first and backward from the second by the equations of motion, and
the two are blended. Unknown torques in between are white angular acceleration between known ends: a Brownian bridge.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sunspin.estimate.carry import RATE, TURN, Step, angle_turned, step
from sunspin.estimate.chain import earlier_states
from sunspin.estimate.model import Model, Observations, States, Track
from sunspin.estimate.terms.term import Term
from sunspin.estimate.verdict import in_sigma
from sunspin.solve.rotations import rotate_attitude, rotation_between

CURVE_RAD, LEAST_INSTANTS, MOST_INSTANTS = 0.1, 50, 6000
"""Between two instants of a curve body and rate turn by the angle, unless that takes fewer or more instants than these."""

COARSE_RAD, MOST_COARSE = 0.5, 60_000
"""If it takes more, they turn by this angle: less than 30 degrees, so that interpolation goes the right way round. The last number
of instants, 8 hours at 60 deg/s, takes 90 MB while it is computed."""

SAME_INSTANT = 1e-4
"""An instant of a curve is taken for a sample if it is nearer to it than this part of the time between two instants."""


def propagate_to_all(
    model: Model, motions: Track, t_s: np.ndarray, momentum: np.ndarray, noise: np.ndarray
) -> tuple[Track, np.ndarray]:
    """Propagate K motions from the n kept samples, to which they were fitted, to all N samples of a pass.

    Return the motions at all samples, and the derivative (K, n, 3, 6) of their mean rate over all samples by turn and rate at each
    kept sample. At kept samples states and covariances stay as fitted. At any other sample the state is a blend of two: the motion
    propagated forward from the kept sample before it, and that propagated backward from the kept sample after it.

    `model`: of the kept samples. `t_s` (N), s: times of all samples, the first and the last being kept; `momentum` (N, 3): of the
    wheels in body axes, over the mean moment of inertia, rad/s. `noise` (n - 1), rad/s^1.5: strength of the unknown torques between
    kept samples, whose covariance is added (:func:`_bridge`).
    """
    kept = model.obs
    # indices among all samples: of the kept ones, and of the others
    of_kept = np.searchsorted(t_s, kept.t_s)
    others = np.setdiff1d(np.arange(len(t_s)), of_kept)
    # for each of the others: the kept sample before it, and its share of the interval to the next kept one
    before = np.searchsorted(of_kept, others) - 1
    span = kept.t_s[before + 1] - kept.t_s[before]
    share = (t_s[others] - kept.t_s[before]) / span
    # weight of the backward motion: a cubic of zero slope at both kept samples, so that the blend adds nothing to the rate there
    blend = share**2 * (3 - 2 * share)

    k, n, n_all = len(motions), len(kept), len(t_s)
    attitude, omega = np.empty((k, n_all, 3, 3)), np.empty((k, n_all, 3))
    covariance = np.empty((k, n_all, 6, 6))
    attitude[:, of_kept], omega[:, of_kept] = motions.attitude, motions.omega
    covariance[:, of_kept] = motions.covariance
    # derivative of the sum of the rates at all samples by the state at each kept sample, whose own rate is one of them
    sum_by_kept = np.zeros((k, n, 3, 6))
    sum_by_kept[..., RATE] = np.eye(3)

    inertia = model.body.inertia_at(motions.u[:, model.inertia_slice])
    propagated: list[Step] = []
    covariance_there = _bridge(share, span, noise[before])
    # Forward from the kept sample before, backward from the one after. The weighted mean of their covariances is an upper limit for
    # that of the blend, however the errors of the two are correlated.
    for start, weight in ((before, 1 - blend), (before + 1, blend)):
        dt = t_s[others] - kept.t_s[start]
        momenta = kept.momentum[start], momentum[others]
        stepped = step(inertia, motions.omega[:, start], dt, momenta, derivatives=True)
        by_start = stepped.by_start
        assert by_start is not None
        propagated.append(stepped._replace(turned=stepped.turned @ motions.attitude[:, start]))
        carried = by_start @ motions.covariance[:, start] @ np.swapaxes(by_start, -1, -2)
        covariance_there = covariance_there + weight[:, None, None] * carried
        for i in range(n):
            # the weighted derivatives of the rates at the m samples that are reached from kept sample i
            from_i = start == i
            of_rate = by_start[:, from_i, RATE]
            sum_by_kept[:, i] += np.einsum("m,kmij->kij", weight[from_i], of_rate)
    forward, backward = propagated
    weight = blend[:, None]
    turn = rotation_between(forward.turned, backward.turned)
    attitude[:, others] = rotate_attitude(forward.turned, weight * turn)
    omega[:, others] = forward.omega + weight * (backward.omega - forward.omega)
    covariance[:, others] = covariance_there
    track = replace(motions, attitude=attitude, omega=omega, covariance=covariance)
    return track, sum_by_kept / n_all


def _bridge(share: np.ndarray, span: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return the covariance (m, 6, 6) of turn and rate that unknown torques cause at m instants between two known states.

    The torques are white angular acceleration of the strength q, `noise` (m) in rad/s^1.5. Each instant lies between two kept
    samples that are T apart, `span` (m) in seconds. The time since the first of them is the part `share` (m) of T.

    With p = share (1 - share), each component has the variance q^2 T^3 p^3 / 3 of the turn and q^2 T p (1 - 3 p) of the rate. The
    correlation of turn and rate is left out.
    """
    p = (share * (1 - share))[:, None, None]
    # q^2 T: variance of the rate at the end of the interval, if it were not known there
    free_variance = (noise**2 * span)[:, None, None] * np.eye(3)
    covariance = np.zeros((len(share), 6, 6))
    covariance[:, TURN, TURN] = free_variance * span[:, None, None] ** 2 * p**3 / 3
    covariance[:, RATE, RATE] = free_variance * p * (1 - 3 * p)
    return covariance


def curve(model: Model, motion: Track, noise: float) -> tuple[np.ndarray, Track]:
    """Return evenly spaced instants (m), s, which a figure may connect by straight lines, and a motion (K = 1) at them.

    `model`: of all samples of the pass, at which the motion is given; `noise`: strength of unknown torques, rad/s^1.5.
    """
    t_s, momentum = model.obs.t_s, model.obs.momentum
    spans = np.diff(t_s)
    angle = angle_turned(
        model.body.inertia[None], motion.omega[:, :-1], spans, (momentum[:-1], momentum[1:])
    )
    # angle (rad) by which the body would turn in the whole pass, if it always were as fast as in its fastest interval
    turned = float((t_s[-1] - t_s[0]) * np.max(angle / spans))
    most = max(MOST_INSTANTS, min(np.ceil(turned / COARSE_RAD), MOST_COARSE))
    count = int(np.clip(np.ceil(turned / CURVE_RAD), LEAST_INSTANTS, most)) + 1
    instants = np.linspace(t_s[0], t_s[-1], count)
    near_s = (instants[1] - instants[0]) * SAME_INSTANT
    # The motion is computed at all samples and instants, in order of time. A sample takes the place of an instant that is near it.
    next_instant = np.minimum(np.searchsorted(instants, t_s - near_s), count - 1)
    is_sample = np.abs(instants[next_instant] - t_s) <= near_s
    times = np.union1d(np.delete(instants, next_instant[is_sample]), t_s)
    wheels = np.stack([np.interp(times, t_s, part) for part in momentum.T], axis=1)
    track, _ = propagate_to_all(model, motion, times, wheels, np.full(len(spans), noise))
    at = np.searchsorted(times, instants - near_s)
    return instants, Track(
        track.attitude[:, at], track.omega[:, at], track.u, covariance=track.covariance[:, at]
    )


def residuals_by_sensor(
    obs: Observations, model: Model, track: Track, kept: np.ndarray
) -> dict[str, np.ndarray]:
    """Return for each sensor how far its readings are from K motions at N samples (K, N), in sigmas; NaN where it read nothing.

    `obs`, `track`: readings and motions at all samples of a pass. `model`: of the kept samples, to which the motions were fitted;
    `kept` (n): indices of these. At all others the covariance of the motion is added to that of a reading, since the motion was not
    fitted to it. Errors beyond those that the vehicle file states (`Unknown.doubted`) are set to zero: a sensor must fit without
    them.
    """
    was_fitted = np.isin(np.arange(len(obs)), kept)
    spread = np.where(was_fitted[:, None, None], 0.0, track.covariance)
    # an error of a sample's time turns the body about its rate
    turned = obs.time_sigma_s * track.omega
    spread[..., TURN, TURN] += turned[..., :, None] * turned[..., None, :]
    u = track.u * np.array([not unknown.doubted for unknown in model.unknowns], dtype=bool)
    residuals: dict[str, np.ndarray] = {}
    earlier = earlier_states(model, obs, replace(track, u=u))
    # not strict: an alternative model may have a torque as one more term
    for term, fitted, own in zip(obs.terms, model.obs.terms, model.term_slices, strict=False):
        # an alternative model may estimate errors that the nominal one takes for none
        term = term.with_errors_of(fitted)
        freedom = term.freedom()
        if not len(freedom) or not freedom.any():
            continue
        states = track if term.of_sun or earlier is None else earlier.states
        square = _squares(term, states, u[:, own], spread, np.diff(obs.t_s))
        sigmas = np.where(freedom > 0, in_sigma(square, freedom), np.nan)
        # two terms of one sensor share a label: where both read, the second counts
        of_first = residuals.get(term.label, np.nan)
        residuals[term.label] = np.where(np.isnan(sigmas), of_first, sigmas)
    return residuals


def _squares(
    term: Term, states: States, u: np.ndarray, spread: np.ndarray, dt: np.ndarray
) -> np.ndarray:
    """Return the squared size (K, N) of the differences of a term, in sigmas of readings and states together.

    It is d^T (1 + S C S^T)^-1 d. d are the differences in sigmas of the readings, S their slope by turn and rate, and C the
    covariance `spread` (K, N, 6, 6) of the states. `u` (K, m): unknowns of the term. If it compares neighbours, `dt` (N - 1) apart,
    the errors of both attitudes differ by that of the rate times dt.
    """
    square = np.zeros(states.omega.shape[:2])
    for residual in term.residuals(states, u):
        of_states = spread
        if residual.by_previous is not None:
            of_states = np.zeros_like(spread)
            of_states[:, 1:, TURN, TURN] = spread[:, 1:, RATE, RATE] * dt[:, None, None] ** 2
        slope = np.zeros((*residual.value.shape, 6))
        for part, derivative in ((TURN, residual.by_turn), (RATE, residual.by_rate)):
            if derivative is not None:
                slope[..., part] = derivative
        covariance = np.eye(slope.shape[-2]) + slope @ of_states @ np.swapaxes(slope, -1, -2)
        whitened = np.linalg.solve(covariance, residual.value[..., None])[..., 0]
        square += np.einsum("knr,knr->kn", residual.value, whitened)
    return square
