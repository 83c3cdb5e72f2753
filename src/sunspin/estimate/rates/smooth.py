"""The smoother behind :func:`sunspin.rates`: attitude and rate at every sample, by Gauss-Newton, many hypotheses at once.

The unknowns are the attitude (a turn, 3) and the rate (3) at every sample; what was measured at a sample and the equations of
motion between neighbours are residuals, so that the normal equations are block-tridiagonal and cost a step linear in the
number of samples. Starting every interval anew (multiple shooting) lets a start be poor without the end of a pass being
wild. Only the Sun is known in N, as its z axis: the turn about it is held by a weak prior and reported as unknown.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from sunspin.estimate.rates.motion import Body, Ends, step_with_answer
from sunspin.estimate.rates.state import Motion, Observations, Track
from sunspin.estimate.terms.term import Seen, normal, student
from sunspin.solve.least_squares import least_squares, limit_length
from sunspin.solve.linear import BorderedSystem, invert_bordered, solve_bordered
from sunspin.solve.rotations import rotate_attitude, rotation_between

RATE_LIMIT = 4.0
"""No trial rate exceeds this many times the prior's sigma (twice the largest rate of the search)."""

TURN_PRIOR = 10.0
"""rad; holds the turn about the Sun line, which nothing measures, without telling anything."""

BAD_COST = 3.7
"""Cost per sample beyond which even the best motion does not fit; sound ones, of skCUBE and of twins, stay below 3.6."""

THREE_READINGS = 1.5
"""What three sound readings cost in the mean."""


def measured(o: Observations, track: Seen) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normal matrices (K, n, 6, 6), gradients (K, n, 6) and costs (K, n) of what was measured at each sample."""
    k, n = track.omega.shape[:2]
    matrix, slope, cost = np.zeros((k, n, 6, 6)), np.zeros((k, n, 6)), np.zeros((k, n))
    for term in (*o.of_sun, *o.of_state):
        own, downhill, part = normal(term, track)
        size = downhill.shape[-1]  # of a turn, or of turn and rate
        matrix[..., :size, :size] += own
        slope[..., :size] += downhill
        cost += part
    return matrix, slope, cost


def costs(o: Observations, track: Seen) -> np.ndarray:
    """The costs (K, n) alone."""
    cost = np.zeros(track.omega.shape[:2])
    for term in (*o.of_sun, *o.of_state):
        for value, _ in term.residuals(track):
            cost += student(value)[1]
    return cost


Tied = tuple[np.ndarray, np.ndarray, np.ndarray]
"""What neighbours say: residuals (K, n-1, m), Jacobians (K, n-1, m, 6) to the first and to the second."""


class Intervals(NamedTuple):
    """Between neighbours: lengths (n-1), turns (K, n-1, 3, 3), what acts at the ends, and `whitening` (n-1, 6, 6)."""

    dt: np.ndarray
    relative: np.ndarray
    ends: Ends
    white: np.ndarray

    @classmethod
    def of(cls, o: Observations, track: Track, motion: Motion) -> Intervals:
        dt, start, end = np.diff(o.t_s), track.attitude[:, :-1], track.attitude[:, 1:]
        relative = end @ np.swapaxes(start, -1, -2)
        ends = Ends(momentum=o.momentum[:-1], momentum_end=o.momentum[1:])
        if o.field_at_ends is not None and np.any(motion.body.dipole):
            ends = ends._replace(field=o.field_at_ends[0], field_end=o.field_at_ends[1])
        return cls(
            dt,
            relative,
            motion.body.seen(ends, start, o.t_s[:-1]),
            whitening(dt, *noises(o, motion)),
        )

    def step(self, body: Body, omega: np.ndarray, derive: Callable[..., Any]) -> Any:
        """What a step of the motion (`step` or `step_with_answer`) makes of rates (K, n, 3) at the samples."""
        return derive(
            body, omega[:, :-1], np.broadcast_to(self.dt, self.relative.shape[:2]), self.ends
        )

    def defect(self, omega: np.ndarray, made: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Turns and rates as they are less as the motion makes them (K, n-1, 6), in sigmas."""
        defect = np.concatenate(
            [rotation_between(made, self.relative), omega[:, 1:] - rate], axis=-1
        )
        return np.einsum("nij,knj->kni", self.white, defect)


def between(o: Observations, track: Track, motion: Motion, over: Intervals | None = None) -> Tied:
    """What the motion (6) and other terms (3 each) say of neighbours."""
    over = Intervals.of(o, track, motion) if over is None else over
    made, rate, answer = over.step(motion.body, track.omega, step_with_answer)
    value = over.defect(track.omega, made, rate)
    first = -np.einsum("nij,knjl->knil", over.white, answer)
    second = np.broadcast_to(over.white, (*value.shape, 6)).copy()
    for term in o.of_pairs:
        more = term.between(o.t_s, over.relative)
        value, first, second = (
            np.concatenate([x, y], axis=2)
            for x, y in zip((value, first, second), more, strict=True)
        )
    return value, first, second


def noises(o: Observations, motion: Motion) -> tuple[np.ndarray, float, np.ndarray]:
    """White angular acceleration (n - 1), rad/s^1.5, between neighbours, white noise of the rate, rad s^-0.5, and the `shares`
    (3, 3) of the body's axes in the former."""
    dt = np.diff(o.t_s)
    acceleration = motion.noise**2 + sum(term.acceleration_noise(dt) ** 2 for term in o.of_motion)
    rate = sum(term.rate_noise() ** 2 for term in o.of_motion)
    return np.sqrt(np.broadcast_to(acceleration, dt.shape)), float(np.sqrt(rate)), motion.shares


EVEN = np.eye(3)
"""Shares of noise without a direction in the body."""


def wandering(
    dt: np.ndarray, acceleration: npt.ArrayLike, rate: float = 0.0, shares: np.ndarray = EVEN
) -> np.ndarray:
    """Covariance (n, 6, 6) of turn and rate that such noises, of :func:`noises`, make in `dt` (n)."""
    covariance = np.zeros((len(dt), 6, 6))
    square = np.square(acceleration)[..., None, None] * shares
    span = dt[:, None, None]
    covariance[:, :3, :3] = square * span**3 / 3 + rate**2 * span * EVEN
    covariance[:, :3, 3:] = covariance[:, 3:, :3] = square * span**2 / 2
    covariance[:, 3:, 3:] = square * span
    return covariance


def whitening(
    dt: np.ndarray, acceleration: npt.ArrayLike, rate: float = 0.0, shares: np.ndarray = EVEN
) -> np.ndarray:
    """Inverse square roots (n, 6, 6) of that covariance, kept: each step of a fit asks for the same."""
    noise = np.asarray(acceleration, dtype=np.float64)
    return _whitening(dt.tobytes(), noise.tobytes(), rate, shares.tobytes())


@lru_cache(maxsize=64)
def _whitening(dt: bytes, acceleration: bytes, rate: float, shares: bytes) -> np.ndarray:
    noise, division = np.frombuffer(acceleration), np.frombuffer(shares).reshape(3, 3)
    found = np.linalg.inv(np.linalg.cholesky(wandering(np.frombuffer(dt), noise, rate, division)))
    found.setflags(write=False)
    return found


def log_noise(o: Observations, motion: Motion) -> float:
    """What motions under other noises differ in, beside their cost: half the log of the determinants of that covariance."""
    return float(np.linalg.slogdet(wandering(np.diff(o.t_s), *noises(o, motion)))[1].sum() / 2)


def cost_limit(o: Observations) -> float:
    """The cost beyond which even the best motion does not fit: so much for each sample's Sun, and what sound readings of the
    other sensors cost in the mean."""
    return BAD_COST * len(o) + THREE_READINGS * sum(term.readings() for term in o.terms)


def normal_equations(
    o: Observations, track: Track, motion: Motion, tied: Tied | None = None
) -> BorderedSystem:
    """Those of the whole pass, a node of turn and rate (6) at each sample, without errors in common; `tied`: as `between` says."""
    diagonal, slope, cost = measured(o, track)
    damping = damping_scale(diagonal, o.t_s)
    value, first, second = between(o, track, motion) if tied is None else tied
    diagonal[:, :-1] += np.swapaxes(first, -1, -2) @ first
    diagonal[:, 1:] += np.swapaxes(second, -1, -2) @ second
    upper = np.swapaxes(first, -1, -2) @ second
    slope[:, :-1] += np.einsum("knmi,knm->kni", first, value)
    slope[:, 1:] += np.einsum("knmi,knm->kni", second, value)
    total = cost.sum(axis=1) + (value**2).sum(axis=(1, 2)) / 2
    diagonal[:, 0, :3, :3] += free_turn(o, track.sun_B[:, 0])
    diagonal[:, 0, 3:, 3:] += np.eye(3) / motion.rate_prior**2
    slope[:, 0, 3:] += track.omega[:, 0] / motion.rate_prior**2
    total += (track.omega[:, 0] ** 2).sum(axis=1) / (2 * motion.rate_prior**2)
    return BorderedSystem(total, diagonal, upper, slope, damping)


def free_turn(o: Observations, sun_B: np.ndarray) -> np.ndarray:
    """The weak prior (K, 3, 3) of what no reading says of the attitude: the turn about the Sun (K, 3); without a Sun, any turn."""
    if not o.of_sun:
        return np.tile(np.eye(3) / TURN_PRIOR**2, (len(sun_B), 1, 1))
    return sun_B[:, :, None] * sun_B[:, None, :] / TURN_PRIOR**2


def damping_scale(told: np.ndarray, t_s: np.ndarray) -> np.ndarray:
    """Damping (K, 6) of turn and rate in the measure of what was measured (K, n, 6, 6): one in that of the equations of motion,
    which are stiff where samples are close together, would hold a whole hypothesis in its place."""
    size = np.einsum("knii->kni", told).sum(axis=1) / len(t_s)
    turn_size = size[:, :3].sum(axis=1, keepdims=True) / 3
    step_s = np.diff(t_s).mean() if len(t_s) > 1 else 1.0
    rate_size = size[:, 3:].sum(axis=1, keepdims=True) / 3 + turn_size * step_s**2
    return np.repeat(np.concatenate([turn_size, rate_size], axis=1), 3, axis=1)


def smooth(o: Observations, track: Track, motion: Motion, steps: int = 8) -> Track:
    """K hypotheses fitted at once; returns them with cost, weight and covariance."""
    found = least_squares(
        lambda state: normal_equations(o, Track(state[0], state[1]), motion),
        moved,
        solve_bordered,
        (track.attitude, track.omega),
        steps=steps,
        limit=lambda state: (state[0], followed(state[1], motion)),
    )
    (attitude, omega), told = found.state, invert_bordered(found.system)
    return Track(
        attitude,
        omega,
        found.system.cost,
        -found.system.cost - told.log_determinant / 2,
        told.nodes,
    )


def moved(
    state: tuple[np.ndarray, np.ndarray], step: tuple[np.ndarray, None]
) -> tuple[np.ndarray, np.ndarray]:
    """Attitudes and rates after a step of turns and rates."""
    return rotate_attitude(state[0], step[0][..., :3]), state[1] + step[0][..., 3:]


def followed(omega: np.ndarray, motion: Motion) -> np.ndarray:
    """Trial rates (..., 3) no larger than the integration can follow: a step far out of the basin must not overflow."""
    return limit_length(omega, RATE_LIMIT * motion.rate_prior)
