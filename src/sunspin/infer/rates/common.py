"""Errors that all samples of a pass share, as unknowns of :mod:`sunspin.infer.rates`: a gyro's zero and scale, the body's
inertia, and a clock.

Gyro, magnetometer and attitude of a row may be older than the row's Sun. The states of a fit are then those of the sensors'
instants, and the Sun is seen so much later, after a turn by the rate: which says how late they are wherever the rate changes. A few
unknowns beside the many of the smoother border its block-tridiagonal equations.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunspin.infer.rates.motion import Body, turn
from sunspin.infer.rates.smooth import (
    RATE_LIMIT,
    Motion,
    Observations,
    Track,
    between,
    damping_scale,
    measured,
    normal_equations,
    shortened,
    solve,
    student,
)  # fmt: skip

LOOSE = (1e-4, 2e-5, 4e-6, 1e-6)
"""rad/s^1.5; acceleration noises under which a lateness finds its place."""

LOOSER = (1e-3, 3e-4)
"""rad/s^1.5; those under which the inertia finds its place, where no motion of the file's inertia fits."""


INERTIA_STEP = 0.02
"""Step, in sigmas, of the differences that give the answer of the motion to the inertia."""

MOST_SIGMAS = 4.0
"""No trial inertia is further from that of the vehicle's file than this, in its sigmas."""


class Clock(NamedTuple):
    """How late (s) gyro, magnetometer and attitude of a row are behind its Sun, and the sigma (s) of that; zero: known."""

    late_s: float = 0.0
    sigma_s: float = 0.0


class Common(NamedTuple):
    """K hypotheses with the common errors (K, m) in units of their sigmas, the covariance of those (K, m, m), the answer of the
    states to them (K, n, 6, m), and the blocks of the equations; `seen`: the track at the instants of the Sun."""

    track: Track
    error: np.ndarray
    covariance: np.ndarray
    answer: np.ndarray
    diagonal: np.ndarray
    upper: np.ndarray
    border: np.ndarray
    seen: Track

    def shift(self, slope: np.ndarray) -> np.ndarray:
        """Change (K, n, 6) of the states for a gradient (K, n, 6) that is added."""
        change = solve(self.diagonal, self.upper, slope)[0]
        error = -np.einsum("kab,knib,kni->ka", self.covariance, self.border, change)
        return change + np.einsum("knia,ka->kni", self.answer, error)


class _Equations(NamedTuple):
    diagonal: np.ndarray
    upper: np.ndarray
    slope: np.ndarray
    cost: np.ndarray
    damping: np.ndarray
    border: np.ndarray
    corner: np.ndarray
    error_slope: np.ndarray


def has_common(o: Observations, clock: Clock | None, body: Body) -> bool:
    """Whether a pass has such errors at all."""
    return clock is not None or len(body.errors) > 0 or bool(np.isfinite(o.gyro).all(axis=1).any() and np.any(o.gyro_common))


def acceleration(body: Body, omega: np.ndarray, momentum: np.ndarray) -> np.ndarray:
    """Torque-free angular acceleration (..., 3) rad/s2 of a body at `omega` (..., 3), its wheels' momentum (..., 3) being held."""
    return np.cross(omega @ body.inertia + momentum, omega) @ np.linalg.inv(body.inertia)


def seen_later(o: Observations, track: Track, motion: Motion, late_s: np.ndarray) -> Track:
    """The track `late_s` (K) later than at the samples' states, a fraction of a turn."""
    late = late_s[:, None, None]
    change = acceleration(motion.body, track.omega, o.momentum)
    return Track(turn(track.attitude, late * (track.omega + late / 2 * change)), track.omega + late * change)


def with_common(
    o: Observations, track: Track, motion: Motion, clock: Clock | None, first: np.ndarray | float = 0.0, begin: float = 0.0
) -> Common:
    """K hypotheses fitted with their common errors; `first`: the clock's error to begin with, in sigmas.

    A lateness moves the states of all samples along the motion: where that is stiff it is loosened, and cooled again. `begin`: the
    acceleration noise (rad/s^1.5) under which the hypotheses were found, if they have to be cooled from there.
    """
    error = np.zeros((len(track.omega), _shared(o) + len(motion.body.errors) + (clock is not None)))
    if clock is not None:
        error[:, -1] = first
        begin = max(begin, LOOSE[0])
    for noise in [level for level in (*LOOSER, *LOOSE) if motion.noise < level <= begin]:
        fit = _fitted(o, track, error, replace(motion, noise=noise), clock, 8)
        track, error = fit.track, fit.error
    return _fitted(o, track, error, motion, clock, 20)


def _fitted(o: Observations, track: Track, error: np.ndarray, motion: Motion, clock: Clock | None, steps: int) -> Common:
    """Damped Gauss-Newton on K hypotheses and their common errors at once."""
    parts = _equations(o, track, error, motion, clock)
    damping = np.full(len(error), 1e-3)
    each = np.arange(6)
    for _ in range(steps):
        diagonal = parts.diagonal.copy()
        diagonal[..., each, each] += (damping[:, None] * parts.damping)[:, None]
        change, step, *_ = _solved(parts._replace(diagonal=diagonal))
        omega = shortened(track.omega + change[..., 3:], RATE_LIMIT * motion.rate_prior)
        trial, trial_error = Track(turn(track.attitude, change[..., :3]), omega), error + step
        inertia = slice(_shared(o), _shared(o) + len(motion.body.errors))
        trial_error[:, inertia] = np.clip(trial_error[:, inertia], -MOST_SIGMAS, MOST_SIGMAS)
        new = _equations(o, trial, trial_error, motion, clock)
        better = new.cost < parts.cost
        gained = np.where(better, parts.cost - new.cost, 0.0)
        track = Track(_choose(better, trial.attitude, track.attitude), _choose(better, trial.omega, track.omega))
        error = _choose(better, trial_error, error)
        parts = _Equations(*(_choose(better, a, b) for a, b in zip(new, parts, strict=True)))
        damping = np.where(better, damping / 5, damping * 8)
        if np.all(gained < 1e-3) and np.all(better | (damping > 1e4)):
            break
    _, _, spread, sizes, answer = _solved(parts)
    covariance = solve(parts.diagonal, parts.upper, parts.slope)[1]
    covariance = covariance + np.einsum("knia,kab,knjb->knij", answer, spread, answer)
    fitted = Track(track.attitude, track.omega, parts.cost, -parts.cost - sizes / 2, covariance)
    seen = track if clock is None else seen_later(o, track, motion, _late(clock, error))
    return Common(fitted, error, spread, answer, parts.diagonal, parts.upper, parts.border, seen)


def _shared(o: Observations) -> int:
    """How many errors the samples of the gyro have in common."""
    return o.gyro_common.shape[1] if np.any(o.gyro_common) else 0


def _late(clock: Clock, error: np.ndarray) -> np.ndarray:
    return clock.late_s + clock.sigma_s * error[:, -1]


def _choose(better: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where(better.reshape(-1, *(1,) * (a.ndim - 1)), a, b)


def _solved(p: _Equations) -> tuple[np.ndarray, ...]:
    """Steps of states (K, n, 6) and errors (K, m), the errors' covariance, the log determinant, the states' answer (K, n, 6, m)."""
    right = np.concatenate([p.slope[..., None], p.border], axis=-1)  # all at once: most of the time is the loop over samples
    k, many = len(p.slope), right.shape[-1]
    each = np.moveaxis(right, -1, 1).reshape(k * many, *p.slope.shape[1:])
    change, _, size = solve(np.repeat(p.diagonal, many, axis=0), np.repeat(p.upper, many, axis=0), each)
    both = np.moveaxis(change.reshape(k, many, *p.slope.shape[1:]), 1, -1)
    change, answer, size = both[..., 0], both[..., 1:], size[::many]
    schur = p.corner + np.einsum("knia,knib->kab", p.border, answer)
    right = -p.error_slope - np.einsum("knia,kni->ka", p.border, change)
    step = np.linalg.solve(schur, right[..., None])[..., 0]
    change = change + np.einsum("knia,ka->kni", answer, step)
    return change, step, np.linalg.inv(schur), size + np.linalg.slogdet(schur)[1], answer


def _equations(o: Observations, track: Track, error: np.ndarray, motion: Motion, clock: Clock | None) -> _Equations:
    n = len(o)
    blind = np.full((n, 3, 3), np.nan)
    nothing = replace(o, sun_cov=blind, power=np.zeros((n, 0)), power_sigma=np.zeros((n, 0)), gyro=np.full((n, 3), np.nan))
    first = _shared(o)
    moved = [moving(nothing, track.take(np.array([k])), motion, error[k, first : first + len(motion.body.errors)])
             for k in range(len(error))]  # fmt: skip
    diagonal, upper, slope, cost, inside, between_errors, downhill = (np.concatenate(parts) for parts in zip(*moved, strict=True))
    place = slice(first, first + inside.shape[-1])
    border = np.zeros((*slope.shape, error.shape[1]))
    corner = np.repeat(np.eye(error.shape[1])[None], len(error), axis=0)
    error_slope = error.copy()
    border[..., place] += inside
    corner[:, place, place] += between_errors
    error_slope[:, place] += downhill
    told = np.zeros_like(diagonal)
    cost = cost + (error**2).sum(axis=1) / 2
    cost += _add_sun(o, track, error, motion, clock, told, slope, border, corner, error_slope)
    cost += _add_gyro(o, track, error, told, slope, border, corner, error_slope)
    return _Equations(diagonal + told, upper, slope, cost, damping_scale(told, o.t_s), border, corner, error_slope)


def moving(o: Observations, track: Track, motion: Motion, error: np.ndarray) -> tuple[np.ndarray, ...]:
    """What the motion of one hypothesis says, with the inertia off by `error` (r) sigmas: blocks (1, n, 6, 6) and (1, n-1, 6, 6),
    gradient (1, n, 6), cost (1), and of the inertia's errors border (1, n, 6, r), corner (1, r, r) and gradient (1, r)."""
    inertia = motion.body.inertia + np.tensordot(error, motion.body.errors, axes=1)
    motion = replace(motion, body=replace(motion.body, inertia=inertia))
    diagonal, upper, slope, cost, _ = normal_equations(o, track, motion)
    r = len(error)
    border, corner, downhill = np.zeros((*slope.shape, r)), np.zeros((1, r, r)), np.zeros((1, r))
    if not r:
        return diagonal, upper, slope, cost, border, corner, downhill
    value, first, second = between(o, track, motion)
    answer = []
    for change in motion.body.errors:
        other = replace(motion, body=replace(motion.body, inertia=inertia + INERTIA_STEP * change))
        answer.append((between(o, track, other)[0] - value) / INERTIA_STEP)
    answers = np.stack(answer, axis=-1)
    border[:, :-1] += np.einsum("knmi,knmr->knir", first, answers)
    border[:, 1:] += np.einsum("knmi,knmr->knir", second, answers)
    corner += np.einsum("knmr,knms->krs", answers, answers)
    downhill += np.einsum("knmr,knm->kr", answers, value)
    return diagonal, upper, slope, cost, border, corner, downhill


def _add_sun(o, track, error, motion, clock, told, slope, border, corner, error_slope) -> np.ndarray:
    blind = replace(o, gyro=np.full((len(o), 3), np.nan))
    if clock is None:
        matrix, change, cost = measured(blind, track)
        told += matrix
        slope += change
        return cost.sum(axis=1)
    late = _late(clock, error)
    seen = seen_later(o, track, motion, late)
    matrix, change, cost = measured(blind, seen)
    matrix, change = matrix[..., :3, :3], change[..., :3]
    bridge = np.zeros((*track.omega.shape, 6))  # a turn at the state turns the Sun's instant, and a rate for as long as it is late
    bridge[..., :3] = seen.attitude @ np.swapaxes(track.attitude, -1, -2)
    bridge[..., 3:] = late[:, None, None, None] * np.eye(3)
    along = clock.sigma_s * seen.omega
    told += np.swapaxes(bridge, -1, -2) @ matrix @ bridge
    slope += np.einsum("knij,kni->knj", bridge, change)
    border[..., -1] += np.einsum("knij,kni->knj", bridge, np.einsum("knij,knj->kni", matrix, along))
    corner[:, -1, -1] += np.einsum("kni,knij,knj->k", along, matrix, along)
    error_slope[:, -1] += np.einsum("kni,kni->k", along, change)
    return cost.sum(axis=1)


def _add_gyro(o, track, error, told, slope, border, corner, error_slope) -> np.ndarray:
    known = np.isfinite(o.gyro).all(axis=1)
    if not known.any():
        return np.zeros(len(error))
    shared = _shared(o)
    column = np.nan_to_num(o.gyro_common[:, :shared]) * known[:, None, None] / o.gyro_sigma
    value = np.where(known[:, None], (track.omega - np.nan_to_num(o.gyro)) / o.gyro_sigma, 0.0)
    value = value + np.einsum("ka,nai->kni", error[:, :shared], column)
    weight, cost = student(value)
    weight = weight * known
    told[..., 3:, 3:] += weight[..., None, None] * np.eye(3) / o.gyro_sigma**2
    slope[..., 3:] += weight[..., None] * value / o.gyro_sigma
    border[..., 3:, :shared] += np.einsum("kn,nai->knia", weight, column) / o.gyro_sigma
    corner[:, :shared, :shared] += np.einsum("kn,nai,nbi->kab", weight, column, column)
    error_slope[:, :shared] += np.einsum("kn,nai,kni->ka", weight, column, value)
    return cost.sum(axis=1)
