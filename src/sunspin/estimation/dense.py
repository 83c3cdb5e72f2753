"""From the samples that a fit has kept to all of them, and to instants between; and how far each sensor is from a motion.

Between two kept samples the motion is carried on from the first and back from the second by the equations of motion, and the two
are blended. Unknown torques in between are white angular acceleration whose ends are held: a bridge.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sunspin.estimation.carry import Step, angle_turned, step
from sunspin.estimation.chain import earlier_states, latency
from sunspin.estimation.model import Model, Observations, States, Track
from sunspin.estimation.terms.term import Term
from sunspin.estimation.verdict import in_sigma
from sunspin.solve.rotations import rotate_attitude, rotation_between

CURVE_RAD, LEAST_INSTANTS, MOST_INSTANTS = 0.1, 50, 6000
"""Turn of body or rate between two instants of a curve, unless that takes more instants than the last number."""

COARSE_RAD, MOST_COARSE = 0.5, 60_000
"""Then they turn by this much, below 30 degrees, so that whoever interpolates goes the right way round. The last number, 8 hours at
60 deg/s, takes 90 MB while it is computed."""

TOGETHER = 1e-4
"""An instant nearer to a sample than this part of the time between two instants is that sample."""


@dataclass(frozen=True)
class Filled:
    """K motions carried from kept samples (n) to all (N).

    `track`: at all samples, at the kept ones as given. `mean_map` (K, n, 3, 6): what the mean rate over all samples answers to turn
    and rate at the kept ones.
    """

    track: Track
    mean_map: np.ndarray


def filled(
    model: Model, motions: Track, t_s: np.ndarray, momentum: np.ndarray, noise: np.ndarray
) -> Filled:
    """Carry motions to all samples.

    Parameters
    ----------
    model : Model
        Of the kept samples.
    motions : Track
        Motions there, with covariance.
    t_s : (N), s
        All times, those of the kept samples among them, the first and the last being kept.
    momentum : (N, 3)
        Momentum of the wheels, in mean moments times rad/s.
    noise : (n - 1), rad/s^1.5
        Strength of the unknown torques in the intervals between kept samples.
    """
    kept = model.obs
    there = np.searchsorted(t_s, kept.t_s)
    new = np.setdiff1d(np.arange(len(t_s)), there)
    before = np.searchsorted(there, new) - 1
    span = kept.t_s[before + 1] - kept.t_s[before]
    share = (t_s[new] - kept.t_s[before]) / span
    # level at both ends, so that there the rate of change of the attitude is the rate
    blend = share**2 * (3 - 2 * share)

    k, n, every = len(motions), len(kept), len(t_s)
    attitude, omega = np.empty((k, every, 3, 3)), np.empty((k, every, 3))
    covariance = np.empty((k, every, 6, 6))
    attitude[:, there], omega[:, there] = motions.attitude, motions.omega
    covariance[:, there] = motions.covariance
    mean_map = np.zeros((k, n, 3, 6))
    mean_map[..., 3:] = np.eye(3)

    inertia = model.body.inertia_at(motions.u[:, model.of_body])
    ways: list[Step] = []
    spread = _bridge(share, span, noise[before])
    for start, weight in ((before, 1 - blend), (before + 1, blend)):
        dt = t_s[new] - kept.t_s[start]
        momenta = kept.momentum[start], momentum[new]
        way = step(inertia, motions.omega[:, start], dt, momenta, answers=True)
        by_start = way.by_start
        assert by_start is not None
        ways.append(way._replace(turned=way.turned @ motions.attitude[:, start]))
        answered = by_start @ motions.covariance[:, start] @ np.swapaxes(by_start, -1, -2)
        spread = spread + weight[:, None, None] * answered
        for place in range(n):
            here = start == place
            mean_map[:, place] += np.einsum("m,kmij->kij", weight[here], by_start[:, here, 3:])
    on, back = ways
    weight = blend[:, None]
    attitude[:, new] = rotate_attitude(on.turned, weight * rotation_between(on.turned, back.turned))
    omega[:, new] = on.omega + weight * (back.omega - on.omega)
    covariance[:, new] = spread
    track = replace(motions, attitude=attitude, omega=omega, covariance=covariance)
    return Filled(track, mean_map / every)


def _bridge(share: np.ndarray, span: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return the covariance (m, 6, 6) of turn and rate at a share (m) of intervals (m) in s whose ends are held, under noise (m).

    That of a bridge of the integral and the twofold integral of white angular acceleration.
    """
    s = (share * (1 - share))[:, None, None]
    square = (noise**2 * span)[:, None, None] * np.eye(3)
    covariance = np.zeros((len(share), 6, 6))
    covariance[:, :3, :3] = square * span[:, None, None] ** 2 * s**3 / 3
    covariance[:, 3:, 3:] = square * s * (1 - 3 * s)
    return covariance


def curve(model: Model, motion: Track, noise: float) -> tuple[np.ndarray, Track]:
    """Return even instants (m) in s, and one motion there: so close that straight lines between them will do.

    `model`: of all samples of the pass, at which the motion (K = 1) is known.
    """
    t_s, momentum = model.obs.t_s, model.obs.momentum
    spans = np.diff(t_s)
    angle = angle_turned(
        model.body.inertia[None], motion.omega[:, :-1], spans, (momentum[:-1], momentum[1:])
    )
    turned = float((t_s[-1] - t_s[0]) * np.max(angle / spans))
    most = max(MOST_INSTANTS, min(np.ceil(turned / COARSE_RAD), MOST_COARSE))
    count = int(np.clip(np.ceil(turned / CURVE_RAD), LEAST_INSTANTS, most)) + 1
    instants = np.linspace(t_s[0], t_s[-1], count)
    near = (instants[1] - instants[0]) * TOGETHER
    # samples and instants in one order; an instant next to a sample is left out, and read off there
    place = np.minimum(np.searchsorted(instants, t_s - near), count - 1)
    met = np.abs(instants[place] - t_s) <= near
    every = np.union1d(np.delete(instants, place[met]), t_s)
    wheels = np.stack([np.interp(every, t_s, part) for part in momentum.T], axis=1)
    track = filled(model, motion, every, wheels, np.full(len(spans), noise)).track
    at = np.searchsorted(every, instants - near)
    return instants, Track(
        track.attitude[:, at], track.omega[:, at], track.u, covariance=track.covariance[:, at]
    )


def residuals_by_sensor(
    obs: Observations, model: Model, track: Track, kept: np.ndarray
) -> dict[str, np.ndarray]:
    """Return for each sensor how far its readings are from motions at all samples (K, n), in sigmas; NaN where it read nothing.

    Where the attitude was carried its own covariance is added to the noise of the reading. Errors that the vehicle file does not
    state are not granted: a sensor fits if its readings agree with what the file states. `kept`: places of the fitted samples.
    """
    carried = ~np.isin(np.arange(len(obs)), kept)
    spread = np.where(carried[:, None, None], track.covariance, 0.0)
    granted = np.array([not unknown.doubted for unknown in model.unknowns], dtype=bool)
    u = track.u * granted
    residuals: dict[str, np.ndarray] = {}
    late = latency(model, u)
    earlier = (
        None if late is None else earlier_states(replace(model, obs=obs), track, late.late_s).states
    )
    for term, place in zip(obs.terms, model.of_terms, strict=False):
        freedom = term.freedom()
        if not len(freedom) or not freedom.any():
            continue
        seen = track if term.of_sun or earlier is None else earlier
        square = _square(term, seen, u[:, place], spread, np.diff(obs.t_s))
        sigmas = np.where(freedom > 0, in_sigma(square, freedom), np.nan)
        residuals[term.label] = np.where(
            np.isnan(sigmas), residuals.get(term.label, np.nan), sigmas
        )
    return residuals


def _square(
    term: Term, seen: States, u: np.ndarray, spread: np.ndarray, dt: np.ndarray
) -> np.ndarray:
    """Return the squares (K, n) of a term's differences under the covariance of readings and states together.

    Of neighbours, dt (n - 1) apart, the errors of the attitudes are those that the rate makes in between.
    """
    square = np.zeros(seen.omega.shape[:2])
    for residual in term.residuals(seen, u):
        if residual.by_previous is not None:
            between = np.zeros_like(spread)
            turned = spread[:, 1:, 3:, 3:] * dt[:, None, None] ** 2
            between[:, 1:, :3, :3] = turned
            spread = between
        slope = np.zeros((*residual.value.shape, 6))
        for rows, derivative in ((slice(0, 3), residual.by_turn), (slice(3, 6), residual.by_rate)):
            if derivative is not None:
                slope[..., rows] = derivative
        covariance = np.eye(slope.shape[-2]) + slope @ spread @ np.swapaxes(slope, -1, -2)
        whitened = np.linalg.solve(covariance, residual.value[..., None])[..., 0]
        square += np.einsum("knr,knr->kn", residual.value, whitened)
    return square
