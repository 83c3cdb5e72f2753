"""Errors that all samples of a pass share, as unknowns of :mod:`sunspin.estimate.rates`: a gyro's zero and scale, the body's
inertia, a magnetic torque, how the field turns, gains of panels that brightness alone does not tell, the Earth's light, and a
clock; in this order.

Gyro, magnetometer and attitude of a row may be older than the row's Sun. The states of a fit are then those of the sensors'
instants, and the Sun is seen so much later, after a turn by the rate: which says how late they are wherever the rate changes. A few
unknowns beside the many of the smoother border its block-tridiagonal equations.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunspin.estimate.rates import field, torque
from sunspin.estimate.rates.earth import begun, lit_by
from sunspin.estimate.rates.light import student, sun_measured
from sunspin.estimate.rates.motion import Body
from sunspin.estimate.rates.smooth import between, damping_scale, followed, moved, normal_equations, whitening
from sunspin.estimate.rates.state import Motion, Observations, Track
from sunspin.solve.least_squares import least_squares, take
from sunspin.solve.linear import Bordered, bordered, spread
from sunspin.solve.rotations import turn

LOOSE = (1e-4, 2e-5, 4e-6, 1e-6)
"""rad/s^1.5; acceleration noises under which a lateness finds its place."""

LOOSER = (1e-3, 3e-4)
"""rad/s^1.5; those under which the inertia finds its place, where no motion of the file's inertia fits."""


INERTIA_STEP = 0.02
"""Step, in sigmas, of the differences that give the answer of the motion to the inertia."""

MOST_SIGMAS = 4.0
"""No trial inertia or gain is further from that of the vehicle's file than this, in its sigmas."""


THINNEST, DRAWN_IN = 0.1, 10
"""No principal moment is less than this part of the mean one, and no second moment of the masses less than minus this; a trial
beyond is drawn in by a fifth, so many times at most."""


class Clock(NamedTuple):
    """How late (s) gyro, magnetometer and attitude of a row are behind its Sun, and the sigma (s) of that; zero: known."""

    late_s: float = 0.0
    sigma_s: float = 0.0


class Common(NamedTuple):
    """K hypotheses with the common errors (K, m) in units of their sigmas, the covariance of those (K, m, m), the answer of the
    states to them (K, n, 6, m), and the equations; `seen`: the track at the instants of the Sun."""

    track: Track
    error: np.ndarray
    covariance: np.ndarray
    answer: np.ndarray
    system: Bordered
    seen: Track

    def take(self, index: np.ndarray) -> Common:
        """The hypotheses `index`."""
        error, covariance, answer, system = take(self[1:-1], index)
        return Common(self.track.take(index), error, covariance, answer, system, self.seen.take(index))


def of_a_body(body: Body, error: np.ndarray) -> np.ndarray:
    """Errors of the inertia (K, r), in sigmas, drawn in as far as they must be for a tensor that a body may have, nearly."""
    error = error.copy()
    for _ in range(DRAWN_IN):
        inertia = body.inertia + np.einsum("kr,rij->kij", error, body.errors)
        about = np.trace(inertia, axis1=1, axis2=2)[:, None, None] / 2 * np.eye(3) - inertia  # the masses' second moments
        wrong = (np.linalg.eigvalsh(about)[:, 0] < -THINNEST) | (np.linalg.eigvalsh(inertia)[:, 0] < THINNEST)
        if not wrong.any():
            return error
        error[wrong] *= 0.8
    error[wrong] = 0.0
    return error


def has_common(o: Observations, clock: Clock | None, motion: Motion) -> bool:
    """Whether a pass has such errors at all."""
    gyro = np.isfinite(o.gyro).all(axis=1).any() and np.any(o.gyro_common)
    light = len(o.row_unknowns) + o.light_unknowns > 0
    return clock is not None or len(motion.body.errors) > 0 or motion.torque > 0 or light or bool(gyro)


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
    places = places_of(o, motion, clock)
    error = np.zeros((len(track.omega), places.count))
    if o.light_unknowns:
        track, error[:, places.earth] = begun(o, track)
    if clock is not None:
        error[:, -1] = first
        begin = max(begin, LOOSE[0])
    for noise in [level for level in (*LOOSER, *LOOSE) if motion.noise < level <= begin]:
        fit = _fitted(o, track, error, replace(motion, noise=noise), clock, 8)
        track, error = fit.track, fit.error
    return _fitted(o, track, error, motion, clock, 20)


def cooler(o: Observations, fit: Common, motion: Motion, clock: Clock | None = None, steps: int = 8) -> Common:
    """A fit brought to a stiffer motion."""
    return _fitted(o, fit.track, fit.error, motion, clock, steps)


def _fitted(o: Observations, track: Track, error: np.ndarray, motion: Motion, clock: Clock | None, steps: int) -> Common:
    """K hypotheses and their common errors fitted at once."""
    places = places_of(o, motion, clock)

    def limit(state: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
        error = state[2].copy()
        for place in (places.inertia, places.gains):
            error[:, place] = np.clip(error[:, place], -MOST_SIGMAS, MOST_SIGMAS)
        error[:, places.inertia] = of_a_body(motion.body, error[:, places.inertia])
        return state[0], followed(state[1], motion), error

    found = least_squares(
        lambda state: _equations(o, Track(state[0], state[1]), state[2], motion, clock),
        lambda state, step: (*moved(state[:2], step), state[2] + step[1]),
        bordered, (track.attitude, track.omega, error), steps=steps, limit=limit,
    )  # fmt: skip
    (attitude, omega, error), system, told = found.state, found.system, spread(found.system)
    fitted = Track(attitude, omega, system.cost, -system.cost - told.log_size / 2, told.nodes)
    seen = fitted if clock is None else seen_later(o, fitted, motion, _late(clock, error))
    return Common(fitted, error, told.border, told.answer, system, seen)


class _Places(NamedTuple):
    """Where each kind of error stands among all `count` of them."""

    gyro: slice
    inertia: slice
    torque: slice
    field: slice
    gains: slice
    earth: slice
    clock: slice
    count: int

    @property
    def moving(self) -> slice:
        """Inertia, torque and how the field turns."""
        return slice(self.inertia.start, self.field.stop)

    @property
    def light(self) -> slice:
        """Gains and the Earth's light."""
        return slice(self.gains.start, self.earth.stop)


def places_of(o: Observations, motion: Motion, clock: Clock | None) -> _Places:
    gyro = o.gyro_common.shape[1] if np.any(o.gyro_common) else 0
    moving = [len(motion.body.errors), torque.count(motion), field.count(o)]
    edges = np.cumsum([0, gyro, *moving, len(o.row_unknowns), o.light_unknowns, int(clock is not None)])
    spans = [slice(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)]
    return _Places(spans[0], spans[1], spans[2], spans[3], spans[4], spans[5], spans[6], int(edges[-1]))


def lit_with(o: Observations, error: np.ndarray, places: _Places) -> Observations:
    """The same with the gains and the Earth's light of each hypothesis off by those of its errors (K, m), in sigmas."""
    lit = lit_by(o, error[:, places.earth]) if o.light_unknowns else o
    return replace(lit, rows=o.rows + np.einsum("km,mpj->kpj", error[:, places.gains], o.row_unknowns))


def _late(clock: Clock, error: np.ndarray) -> np.ndarray:
    return clock.late_s + clock.sigma_s * error[:, -1]


def _equations(o: Observations, track: Track, error: np.ndarray, motion: Motion, clock: Clock | None) -> Bordered:
    n, places = len(o), places_of(o, motion, clock)
    blind = np.full((n, 3, 3), np.nan)
    nothing = replace(o, sun_cov=blind, power=np.zeros((n, 0)), power_sigma=np.zeros((n, 0)), gyro=np.full((n, 3), np.nan))
    own = error[:, places.moving].size > 0  # else one body serves all at once
    each = [np.array([k]) for k in range(len(error))] if own else [slice(None)]
    moved = [moving(nothing, track.take(k), motion, error[k, places.moving][0]) for k in each]
    diagonal, upper, slope, cost, inside, between_errors, downhill = (np.concatenate(parts) for parts in zip(*moved, strict=True))
    border = np.zeros((*slope.shape, places.count))
    corner = np.repeat(np.eye(places.count)[None], len(error), axis=0)
    error_slope = error.copy()
    border[..., places.moving] += inside
    corner[:, places.moving, places.moving] += between_errors
    error_slope[:, places.moving] += downhill
    sun = sun_part(o, track, error, motion, clock)
    cost = cost + (error**2).sum(axis=1) / 2 + sun.cost
    slope, border, corner, error_slope = slope + sun.slope, border + sun.border, corner + sun.corner, error_slope + sun.error_slope
    told = sun.matrix
    cost += _add_gyro(o, track, error[:, places.gyro], places.gyro, told, slope, border, corner, error_slope)
    return Bordered(cost, diagonal + told, upper, slope, damping_scale(told, o.t_s), border, corner, error_slope)


def moving(o: Observations, track: Track, motion: Motion, error: np.ndarray) -> tuple[np.ndarray, ...]:
    """What the motion of K hypotheses says, with inertia, torque and field off by `error` (r) sigmas: blocks (K, n, 6, 6) and
    (K, n-1, 6, 6), gradient (K, n, 6), cost (K), and of the errors border (K, n, 6, r), corner (K, r, r) and gradient (K, r)."""
    of_inertia, of_others = error[: len(motion.body.errors)], error[len(motion.body.errors) :]
    inertia = motion.body.inertia + np.tensordot(of_inertia, motion.body.errors, axes=1)
    sphere = motion.body.spherical and not len(of_inertia)
    motion = replace(motion, body=replace(motion.body, inertia=inertia, spherical=sphere))
    cost, diagonal, upper, slope, *_ = normal_equations(o, track, motion)
    r = len(error)
    border, corner, downhill = np.zeros((*slope.shape, r)), np.zeros((len(cost), r, r)), np.zeros((len(cost), r))
    if not r:
        return diagonal, upper, slope, cost, border, corner, downhill
    value, first, second = between(o, track, motion)
    answer = [np.zeros((*value.shape, 0))]
    for change in motion.body.errors:
        other = replace(motion, body=replace(motion.body, inertia=inertia + INERTIA_STEP * change))
        answer.append(((between(o, track, other)[0] - value) / INERTIA_STEP)[..., None])
    if len(of_others):
        pulled = _linear(o, track, motion, value.shape)
        more = pulled @ of_others
        cost = cost + ((2 * value + more) * more).sum(axis=(1, 2)) / 2
        slope[:, :-1] += np.einsum("knmi,knm->kni", first, more)
        slope[:, 1:] += np.einsum("knmi,knm->kni", second, more)
        value, answer = value + more, [*answer, pulled]
    answers = np.concatenate(answer, axis=-1)
    border[:, :-1] += np.einsum("knmi,knmr->knir", first, answers)
    border[:, 1:] += np.einsum("knmi,knmr->knir", second, answers)
    corner += np.einsum("knmr,knms->krs", answers, answers)
    downhill += np.einsum("knmr,knm->kr", answers, value)
    return diagonal, upper, slope, cost, border, corner, downhill


def _linear(o: Observations, track: Track, motion: Motion, shape: tuple[int, ...]) -> np.ndarray:
    """What one sigma of each unknown of torque and field adds to the residuals between neighbours (K, n - 1, m) = `shape`; that it
    changes with the states is left out of their equations."""
    spans = np.diff(o.t_s)
    parts = np.zeros((*shape, torque.count(motion) + field.count(o)))
    if motion.torque:
        parts[:, :, :6, : torque.UNKNOWNS] = -whitening(spans, motion.noise) @ torque.gained(track, motion, spans)
    if field.count(o):
        parts[:, :, 6:9, -field.count(o) :] = field.gained(o, track)
    return parts


class SunPart(NamedTuple):
    """What the Sun's readings say: blocks (K, n, 6, 6), gradient (K, n, 6), border (K, n, 6, m), corner (K, m, m) and gradient
    (K, m) of the errors in common, cost (K)."""

    matrix: np.ndarray
    slope: np.ndarray
    border: np.ndarray
    corner: np.ndarray
    error_slope: np.ndarray
    cost: np.ndarray


def sun_part(o: Observations, track: Track, error: np.ndarray, motion: Motion, clock: Clock | None) -> SunPart:
    """The Sun's readings, which answer to the states, to the gains and to how late the states are, at errors (K, m)."""
    places = places_of(o, motion, clock)
    late = np.zeros(len(error)) if clock is None else _late(clock, error)
    seen = track if clock is None else seen_later(o, track, motion, late)
    matrix, slope, cost = sun_measured(lit_with(o, error, places), seen, o.row_unknowns)
    # of a turn at the Sun's instant and the gains, what the states (6) and the errors (m) of the equations do to each
    bridge = np.zeros((*track.omega.shape[:2], slope.shape[-1], 6 + places.count))
    bridge[..., :3, :3] = seen.attitude @ np.swapaxes(track.attitude, -1, -2) if clock is not None else np.eye(3)
    bridge[..., :3, 3:6] = late[:, None, None, None] * np.eye(3)  # a rate turns it for as long as the state is late
    bridge[..., 3:, 6:][..., places.light] = np.eye(bridge.shape[-2] - 3)
    if clock is not None:
        bridge[..., :3, -1] = clock.sigma_s * seen.omega
    carried = np.swapaxes(bridge, -1, -2)
    matrix, slope = carried @ matrix @ bridge, (carried @ slope[..., None])[..., 0]
    corner, error_slope = matrix[..., 6:, 6:].sum(axis=1), slope[..., 6:].sum(axis=1)
    return SunPart(matrix[..., :6, :6].copy(), slope[..., :6], matrix[..., :6, 6:], corner, error_slope, cost.sum(axis=1))


def _add_gyro(o, track, error, place, told, slope, border, corner, error_slope) -> np.ndarray:
    known = np.isfinite(o.gyro).all(axis=1)
    if not known.any():
        return np.zeros(len(error))
    column = np.nan_to_num(o.gyro_common[:, : error.shape[1]]) * known[:, None, None] / o.gyro_sigma
    value = np.where(known[:, None], (track.omega - np.nan_to_num(o.gyro)) / o.gyro_sigma, 0.0)
    value = value + np.einsum("ka,nai->kni", error, column)
    weight, cost = student(value)
    weight = weight * known
    told[..., 3:, 3:] += weight[..., None, None] * np.eye(3) / o.gyro_sigma**2
    slope[..., 3:] += weight[..., None] * value / o.gyro_sigma
    border[..., 3:, place] += np.einsum("kn,nai->knia", weight, column) / o.gyro_sigma
    corner[:, place, place] += np.einsum("kn,nai,nbi->kab", weight, column, column)
    error_slope[:, place] += np.einsum("kn,nai,kni->ka", weight, column, value)
    return cost.sum(axis=1)
