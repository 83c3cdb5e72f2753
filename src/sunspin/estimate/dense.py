"""From the samples that a fit has kept to all of them, and to instants between; and how far each sensor is from a motion.

Between two kept samples the motion is carried forward from the first and backward from the second by the equations of motion, and
the two are blended. Unknown torques in between are white angular acceleration whose ends are held: a bridge.
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
"""Turn of body or rate between two instants of a curve, unless that takes more instants than the last number."""

COARSE_RAD, MOST_COARSE = 0.5, 60_000
"""Then they turn by this much, below 30 degrees, so that whoever interpolates goes the right way round. The last number, 8 hours at
60 deg/s, takes 90 MB while it is computed."""

TOGETHER = 1e-4
"""An instant nearer to a sample than this part of the time between two instants is that sample."""


def filled(
    model: Model, motions: Track, t_s: np.ndarray, momentum: np.ndarray, noise: np.ndarray
) -> tuple[Track, np.ndarray]:
    """Return motions carried to all samples, and the derivative (K, n, 3, 6) of their mean rate there.

    The derivative is that by turn and rate at each of the n kept samples; the motions there stay as given. `model`: of the kept
    samples; `motions`: there, with covariance. `t_s` (N), s: all times, the first and the last being kept, with the `momentum` (N,
    3) of the wheels in mean moments times rad/s. `noise` (n - 1), rad/s^1.5: strength of the unknown torques between kept samples.
    """
    kept = model.obs
    # indices into all samples: of the kept ones, and of the others; and which kept one is before each of the others
    of_kept = np.searchsorted(t_s, kept.t_s)
    others = np.setdiff1d(np.arange(len(t_s)), of_kept)
    before = np.searchsorted(of_kept, others) - 1
    span = kept.t_s[before + 1] - kept.t_s[before]
    share = (t_s[others] - kept.t_s[before]) / span
    # a cubic that is level at both ends, so that there the rate of change of the attitude is the rate
    blend = share**2 * (3 - 2 * share)

    k, n, n_all = len(motions), len(kept), len(t_s)
    attitude, omega = np.empty((k, n_all, 3, 3)), np.empty((k, n_all, 3))
    covariance = np.empty((k, n_all, 6, 6))
    attitude[:, of_kept], omega[:, of_kept] = motions.attitude, motions.omega
    covariance[:, of_kept] = motions.covariance
    mean_map = np.zeros((k, n, 3, 6))
    mean_map[..., RATE] = np.eye(3)

    inertia = model.body.inertia_at(motions.u[:, model.inertia_slice])
    propagated: list[Step] = []
    spread = _bridge(share, span, noise[before])
    # forward from the sample before, backward from the one after; covariances are blended as if both were the same motion
    for start, weight in ((before, 1 - blend), (before + 1, blend)):
        dt = t_s[others] - kept.t_s[start]
        momenta = kept.momentum[start], momentum[others]
        stepped = step(inertia, motions.omega[:, start], dt, momenta, derivatives=True)
        by_start = stepped.by_start
        assert by_start is not None
        propagated.append(stepped._replace(turned=stepped.turned @ motions.attitude[:, start]))
        covariance_there = by_start @ motions.covariance[:, start] @ np.swapaxes(by_start, -1, -2)
        spread = spread + weight[:, None, None] * covariance_there
        # a rate at time t contributes weight times its derivative by the state of the kept sample i that it came from
        for i in range(n):
            from_i = start == i
            of_rate = by_start[:, from_i, RATE]
            mean_map[:, i] += np.einsum("m,kmij->kij", weight[from_i], of_rate)
    forward, backward = propagated
    weight = blend[:, None]
    turn = rotation_between(forward.turned, backward.turned)
    attitude[:, others] = rotate_attitude(forward.turned, weight * turn)
    omega[:, others] = forward.omega + weight * (backward.omega - forward.omega)
    covariance[:, others] = spread
    track = replace(motions, attitude=attitude, omega=omega, covariance=covariance)
    return track, mean_map / n_all


def _bridge(share: np.ndarray, span: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return the covariance (m, 6, 6) of turn and rate at a share (m) of intervals (m) in s, under noise (m) in rad/s^1.5.

    The noise is white angular acceleration q; turn and rate are held at both ends of the interval T. Their variances are q^2 T^3
    s^3 / 3 and q^2 T s (1 - 3 s), with s = share (1 - share).
    """
    s = (share * (1 - share))[:, None, None]
    square = (noise**2 * span)[:, None, None] * np.eye(3)
    covariance = np.zeros((len(share), 6, 6))
    covariance[:, TURN, TURN] = square * span[:, None, None] ** 2 * s**3 / 3
    covariance[:, RATE, RATE] = square * s * (1 - 3 * s)
    return covariance


def curve(model: Model, motion: Track, noise: float) -> tuple[np.ndarray, Track]:
    """Return even instants (m) in s, and one motion there: so close that a figure may connect them by straight lines.

    `model`: of all samples of the pass, at which the motion (K = 1) is known; `noise`: strength of unknown torques, rad/s^1.5.
    """
    t_s, momentum = model.obs.t_s, model.obs.momentum
    spans = np.diff(t_s)
    angle = angle_turned(
        model.body.inertia[None], motion.omega[:, :-1], spans, (momentum[:-1], momentum[1:])
    )
    # how far it would turn if it always were as fast as in its fastest interval
    turned = float((t_s[-1] - t_s[0]) * np.max(angle / spans))
    most = max(MOST_INSTANTS, min(np.ceil(turned / COARSE_RAD), MOST_COARSE))
    count = int(np.clip(np.ceil(turned / CURVE_RAD), LEAST_INSTANTS, most)) + 1
    instants = np.linspace(t_s[0], t_s[-1], count)
    near = (instants[1] - instants[0]) * TOGETHER
    # The motion is filled in at all samples and instants in one order. Of an instant next to a sample only the sample is taken.
    next_instant = np.minimum(np.searchsorted(instants, t_s - near), count - 1)
    is_sample = np.abs(instants[next_instant] - t_s) <= near
    times = np.union1d(np.delete(instants, next_instant[is_sample]), t_s)
    wheels = np.stack([np.interp(times, t_s, part) for part in momentum.T], axis=1)
    track, _ = filled(model, motion, times, wheels, np.full(len(spans), noise))
    at = np.searchsorted(times, instants - near)
    return instants, Track(
        track.attitude[:, at], track.omega[:, at], track.u, covariance=track.covariance[:, at]
    )


def residuals_by_sensor(
    obs: Observations, model: Model, track: Track, kept: np.ndarray
) -> dict[str, np.ndarray]:
    """Return for each sensor how far its readings are from motions at all samples (K, N), in sigmas; NaN where it read nothing.

    `obs`, `track`: readings and motions at all N samples; `model`: of the kept samples, to which the motions were fitted; `kept`
    (n): which those are. At all others the covariance of the motion itself is added to the noise of a reading, since the motion was
    not fitted to it. Errors that the vehicle file does not state (`Unknown.doubted`) are put to zero: a sensor fits if its readings
    agree with what the file states.
    """
    was_fitted = np.isin(np.arange(len(obs)), kept)
    spread = np.where(was_fitted[:, None, None], 0.0, track.covariance)
    # an error of a sample's time turns the body about its rate
    turned = obs.time_sigma_s * track.omega
    spread[..., TURN, TURN] += turned[..., :, None] * turned[..., None, :]
    u = track.u * np.array([not unknown.doubted for unknown in model.unknowns], dtype=bool)
    residuals: dict[str, np.ndarray] = {}
    earlier = earlier_states(model, obs, replace(track, u=u))
    for term, fitted, own in zip(obs.terms, model.obs.terms, model.term_slices, strict=False):
        # an alternative model may estimate errors that the nominal one takes for none
        term = term.with_errors_of(fitted)
        freedom = term.freedom()
        if not len(freedom) or not freedom.any():
            continue
        states = track if term.of_sun or earlier is None else earlier.states
        square = _squares(term, states, u[:, own], spread, np.diff(obs.t_s))
        sigmas = np.where(freedom > 0, in_sigma(square, freedom), np.nan)
        # two terms of one sensor share a label: the second counts where it read
        known = residuals.get(term.label, np.nan)
        residuals[term.label] = np.where(np.isnan(sigmas), known, sigmas)
    return residuals


def _squares(
    term: Term, states: States, u: np.ndarray, spread: np.ndarray, dt: np.ndarray
) -> np.ndarray:
    """Return squared differences (K, N) of a term, under the noise of its readings and the covariance of the states together.

    They are d^T (1 + S C S^T)^-1 d. S is the slope of the differences d by turn and rate, C the covariance `spread` (K, N, 6, 6).
    If neighbours are compared, dt (N - 1) apart, the errors of both attitudes differ by that of the rate times dt.
    """
    square = np.zeros(states.omega.shape[:2])
    for residual in term.residuals(states, u):
        if residual.by_previous is not None:
            of_turn = np.zeros_like(spread)
            of_turn[:, 1:, TURN, TURN] = spread[:, 1:, RATE, RATE] * dt[:, None, None] ** 2
            spread = of_turn
        slope = np.zeros((*residual.value.shape, 6))
        for part, derivative in ((TURN, residual.by_turn), (RATE, residual.by_rate)):
            if derivative is not None:
                slope[..., part] = derivative
        covariance = np.eye(slope.shape[-2]) + slope @ spread @ np.swapaxes(slope, -1, -2)
        whitened = np.linalg.solve(covariance, residual.value[..., None])[..., 0]
        square += np.einsum("knr,knr->kn", residual.value, whitened)
    return square
