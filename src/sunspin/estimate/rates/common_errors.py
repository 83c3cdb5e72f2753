"""Errors that all samples of a pass share, as unknowns of :mod:`sunspin.estimate.rates`, in one list: of sensors of the state, the
inertia, of terms that move the body or compare neighbours, of sensors of the Sun, and of a clock; in this order.

Gyro, magnetometer and attitude of a row may be older than the row's Sun. The states of a fit are then those of the sensors'
instants, and the Sun is seen so much later, after a turn by the rate: which says how late they are wherever the rate changes. A few
unknowns beside the many of the smoother border its block-tridiagonal equations.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import permutations
from typing import Any, NamedTuple

import numpy as np

from sunspin.estimate.rates.motion import Body, step
from sunspin.estimate.rates.smooth import (
    Intervals,
    between,
    damping_scale,
    followed,
    moved,
    noises,
    normal_equations,
    whitening,
)
from sunspin.estimate.rates.state import Motion, Observations, Track
from sunspin.estimate.terms.term import StateTerm, SunTerm, Term, Unknown, normal
from sunspin.solve.least_squares import TOLERANCE, least_squares, take_problems
from sunspin.solve.linear import BorderedSystem, invert_bordered, solve_bordered
from sunspin.solve.rotations import rotate_attitude

LOOSE = (1e-4, 2e-5, 4e-6, 1e-6)
"""rad/s^1.5; acceleration noises under which a lateness finds its place."""

LOOSER = (1e-3, 3e-4)
"""rad/s^1.5; those under which the inertia finds its place, where no motion of the file's inertia fits."""


INERTIA_STEP = 0.02
"""Step, in sigmas, of the differences that give the answer of the motion to the inertia."""

MOST_SIGMAS = 4.0
"""No trial inertia is further from that of the vehicle's file than this, in its sigmas."""


THINNEST, DRAWN_IN = 0.1, 10
"""No principal moment is less than this part of the mean one, and no second moment of the masses less than minus this; a trial
beyond is drawn in by a fifth, so many times at most."""


class Clock(NamedTuple):
    """How late (s) gyro, magnetometer and attitude of a row are behind its Sun, and the sigma (s) of that; zero: known."""

    late_s: float = 0.0
    sigma_s: float = 0.0


OTHER_BODIES = np.array(list(permutations((1.0, 0.0, -1.0))))
"""Sigmas by which the three moments differ from those of a sphere: each axis the longest, the middle and the shortest."""


class Common(NamedTuple):
    """K hypotheses with the common errors (K, m) in units of their sigmas, the covariance of those (K, m, m), the answer of the
    states to them (K, n, 6, m), and the equations; `seen`: the track at the instants of the Sun."""

    track: Track
    error: np.ndarray
    covariance: np.ndarray
    answer: np.ndarray
    system: BorderedSystem
    seen: Track

    def take(self, index: np.ndarray) -> Common:
        """The hypotheses `index`."""
        error, covariance, answer, system = take_problems(self[1:-1], index)
        return Common(
            self.track.take(index), error, covariance, answer, system, self.seen.take(index)
        )


def of_a_body(body: Body, error: np.ndarray) -> np.ndarray:
    """Errors of the inertia (K, r), in sigmas, drawn in as far as they must be for a tensor that a body may have, nearly."""
    error = error.copy()
    for _ in range(DRAWN_IN):
        inertia = body.inertia + np.einsum("kr,rij->kij", error, body.errors)
        about = (
            np.trace(inertia, axis1=1, axis2=2)[:, None, None] / 2 * np.eye(3) - inertia
        )  # the masses' second moments
        wrong = (np.linalg.eigvalsh(about)[:, 0] < -THINNEST) | (
            np.linalg.eigvalsh(inertia)[:, 0] < THINNEST
        )
        if not wrong.any():
            return error
        error[wrong] *= 0.8
    error[wrong] = 0.0
    return error


def has_common(o: Observations, clock: Clock | None, motion: Motion) -> bool:
    """Whether a pass has such errors at all."""
    return clock is not None or places_of(o, motion, clock).n > 0


def acceleration(body: Body, omega: np.ndarray, momentum: np.ndarray) -> np.ndarray:
    """Torque-free angular acceleration (..., 3) rad/s2 of a body at `omega` (..., 3), its wheels' momentum (..., 3) being held."""
    return np.cross(omega @ body.inertia + momentum, omega) @ np.linalg.inv(body.inertia)


def seen_later(o: Observations, track: Track, motion: Motion, late_s: np.ndarray) -> Track:
    """The track `late_s` (K) later than at the samples' states, a fraction of a turn."""
    late = late_s[:, None, None]
    change = acceleration(motion.body, track.omega, o.momentum)
    return Track(
        rotate_attitude(track.attitude, late * (track.omega + late / 2 * change)),
        track.omega + late * change,
    )


def with_common(
    o: Observations,
    track: Track,
    motion: Motion,
    clock: Clock | None,
    first: np.ndarray | float = 0.0,
    begin: float = 0.0,
) -> Common:
    """K hypotheses fitted with their common errors; `first`: the clock's error to begin with, in sigmas.

    A lateness moves the states of all samples along the motion: where that is stiff it is loosened, and cooled again. `begin`: the
    acceleration noise (rad/s^1.5) under which the hypotheses were found, if they have to be cooled from there.
    """
    places = places_of(o, motion, clock)
    error = np.zeros((len(track.omega), places.n))
    about = [attitude for term, _ in places.state if (attitude := term.begin(track)) is not None]
    track = replace(track, attitude=about[0]) if about else track
    for term, place in places.sun:
        attitude, error[:, place] = term.begin(track, bool(about))
        track = replace(track, attitude=attitude)
    if clock is not None:
        error[:, -1] = first
        begin = max(begin, LOOSE[0])
    for noise in [level for level in (*LOOSER, *LOOSE) if motion.noise < level <= begin]:
        fit = _fitted(o, track, error, replace(motion, noise=noise), clock, 8)
        track, error = fit.track, fit.error
    return _fitted(o, track, error, motion, clock, 20)


def cooler(
    o: Observations, fit: Common, motion: Motion, clock: Clock | None = None, steps: int = 8
) -> Common:
    """A fit brought to a stiffer motion."""
    return _fitted(o, fit.track, fit.error, motion, clock, steps)


def from_other_bodies(o: Observations, fit: Common, motion: Motion, clock: Clock | None) -> Common:
    """A fit, and, if the inertia is not known at all, its best mode fitted from six bodies with other moments too.

    A body that turns about a principal axis answers to no small change of its moments, nor of the rates across that axis while
    the moments are alike: a fit that begins at a sphere may stay there although the body nutates.
    """
    if not (motion.body.spherical and len(motion.body.errors)):
        return fit
    place = places_of(o, motion, clock).inertia
    best = fit.take(np.full(len(OTHER_BODIES), np.argmin(fit.track.cost)))
    error = best.error.copy()
    error[:, place] += (
        OTHER_BODIES
        @ np.einsum("rii->ir", motion.body.errors)
        / np.linalg.norm(motion.body.errors, axis=(1, 2))
    )
    return both(o, fit, best._replace(error=error), motion, clock)


def both(
    o: Observations, fit: Common, other: Common, motion: Motion, clock: Clock | None
) -> Common:
    """The hypotheses of two fits, fitted from where these stand."""
    parts = ((x.track.attitude, x.track.omega, x.error) for x in (fit, other))
    attitude, omega, error = (np.concatenate(part) for part in zip(*parts, strict=True))
    return _fitted(o, Track(attitude, omega), error, motion, clock, 20)


def again(
    o: Observations,
    fit: Common,
    before: Observations,
    motion: Motion,
    clock: Clock | None,
    steps: int,
    tolerance: float,
) -> Common:
    """Other observations of the same samples fitted from where a fit of those `before` ended, with the same errors in common."""
    old, new = (
        [one.name for one in places_of(each, motion, clock).unknowns] for each in (before, o)
    )
    error = np.zeros((len(fit.error), len(new)))
    for i, name in enumerate(new):
        if name in old:
            error[:, i] = fit.error[:, old.index(name)]
    return _fitted(o, fit.track, error, motion, clock, steps, tolerance)


def _fitted(
    o: Observations,
    track: Track,
    error: np.ndarray,
    motion: Motion,
    clock: Clock | None,
    steps: int,
    tolerance: float = TOLERANCE,
) -> Common:
    """K hypotheses and their common errors fitted at once."""
    places = places_of(o, motion, clock)
    farthest = np.array([unknown.limit for unknown in places.unknowns])

    def limit(state: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
        error = np.clip(state[2], -farthest, farthest)
        error[:, places.inertia] = of_a_body(motion.body, error[:, places.inertia])
        return state[0], followed(state[1], motion), error

    unseen = replace(
        o, terms=tuple(term for term in o.terms if not isinstance(term, SunTerm | StateTerm))
    )
    found = least_squares(
        lambda state: _equations(
            o, unseen, places, Track(state[0], state[1]), state[2], motion, clock
        ),
        lambda state, step: (*moved(state[:2], step), state[2] + step[1]),
        solve_bordered,
        (track.attitude, track.omega, error),
        steps=steps,
        tolerance=tolerance,
        limit=limit,
    )
    (attitude, omega, error), system, told = (
        found.state,
        found.system,
        invert_bordered(found.system),
    )
    fitted = Track(
        attitude, omega, system.cost, -system.cost - told.log_determinant / 2, told.nodes
    )
    seen = fitted if clock is None else seen_later(o, fitted, motion, _late(clock, error))
    return Common(fitted, error, told.border, told.sensitivity, system, seen)


Placed = tuple[tuple[Any, slice], ...]
"""Terms, and where the unknowns of each stand."""


class Places(NamedTuple):
    """The list of all unknowns of a pass, and where those of each term, of the inertia and of the clock stand in it."""

    unknowns: tuple[Unknown, ...]
    state: Placed
    inertia: slice
    motion: Placed
    pairs: Placed
    sun: Placed
    clock: slice

    @property
    def n(self) -> int:
        return len(self.unknowns)

    @property
    def moving(self) -> slice:
        """Inertia and what terms of the motion and of neighbours have."""
        return slice(
            self.inertia.start,
            [self.inertia, *(place for _, place in (*self.motion, *self.pairs))][-1].stop,
        )


def places_of(o: Observations, motion: Motion, clock: Clock | None) -> Places:
    """Those of a pass."""
    every: list[Unknown] = []

    def add(unknowns: Iterable[Unknown]) -> slice:
        start = len(every)
        every.extend(unknowns)
        return slice(start, len(every))

    def of(terms: Iterable[Term]) -> Placed:
        return tuple((term, add(term.unknowns())) for term in terms)

    sizes = np.linalg.norm(motion.body.errors, axis=(1, 2))
    late = (
        ()
        if clock is None
        else (Unknown("late_s", "clock", "s", clock.late_s, clock.sigma_s, scope="file"),)
    )
    state = of(o.of_state)
    inertia = add(
        Unknown(f"inertia_{i}", "inertia", "1", 0.0, float(x), i, limit=MOST_SIGMAS)
        for i, x in enumerate(sizes)
    )
    moved, pairs, sun = of(o.of_motion), of(o.of_pairs), of(o.of_sun)
    last = add(late)
    return Places(tuple(every), state, inertia, moved, pairs, sun, last)


def _late(clock: Clock, error: np.ndarray) -> np.ndarray:
    return clock.late_s + clock.sigma_s * error[:, -1]


def _equations(
    o: Observations,
    unseen: Observations,
    places: Places,
    track: Track,
    error: np.ndarray,
    motion: Motion,
    clock: Clock | None,
) -> BorderedSystem:
    """`unseen`: the observations without what was seen of the states themselves."""
    own = error[:, places.inertia].size > 0  # else one body serves all at once
    each = [np.array([k]) for k in range(len(error))] if own else [slice(None)]
    moved = [moving(unseen, track.take(k), motion, error[k, places.moving]) for k in each]
    diagonal, upper, slope, cost, inside, between_errors, downhill = (
        np.concatenate(parts) for parts in zip(*moved, strict=True)
    )
    border = np.zeros((*slope.shape, places.n))
    corner = np.repeat(np.eye(places.n)[None], len(error), axis=0)
    error_slope = error.copy()
    border[..., places.moving] += inside
    corner[:, places.moving, places.moving] += between_errors
    error_slope[:, places.moving] += downhill
    sun = sun_part(o, places, track, error, motion, clock)
    cost = cost + (error**2).sum(axis=1) / 2 + sun.cost
    slope, border, corner, error_slope = (
        slope + sun.slope,
        border + sun.border,
        corner + sun.corner,
        error_slope + sun.error_slope,
    )
    told = sun.matrix
    for term, place in places.state:
        matrix, gradient, part = normal(term, track, error[:, place])
        told += matrix[..., :6, :6]
        slope += gradient[..., :6]
        border[..., place] += matrix[..., :6, 6:]
        corner[:, place, place] += matrix[..., 6:, 6:].sum(axis=1)
        error_slope[:, place] += gradient[..., 6:].sum(axis=1)
        cost += part.sum(axis=1)
    return BorderedSystem(
        cost, diagonal + told, upper, slope, damping_scale(told, o.t_s), border, corner, error_slope
    )


def moving(
    o: Observations, track: Track, motion: Motion, error: np.ndarray
) -> tuple[np.ndarray, ...]:
    """What the motion of K hypotheses says, with inertia and the unknowns of its terms and of neighbours off by `error` (K, r)
    sigmas, the inertia of all being that of the first: blocks (K, n, 6, 6) and (K, n-1, 6, 6), gradient (K, n, 6), cost (K), and of
    the errors border (K, n, 6, r), corner (K, r, r) and gradient (K, r)."""
    of_inertia, of_others = error[0, : len(motion.body.errors)], error[:, len(motion.body.errors) :]
    inertia = motion.body.inertia + np.tensordot(of_inertia, motion.body.errors, axes=1)
    sphere = motion.body.spherical and not len(of_inertia)
    motion = replace(motion, body=replace(motion.body, inertia=inertia, spherical=sphere))
    over = Intervals.of(o, track, motion)
    tied = between(o, track, motion, over)
    cost, diagonal, upper, slope, *_ = normal_equations(o, track, motion, tied)
    r = error.shape[1]
    border, corner, downhill = (
        np.zeros((*slope.shape, r)),
        np.zeros((len(cost), r, r)),
        np.zeros((len(cost), r)),
    )
    if not r:
        return diagonal, upper, slope, cost, border, corner, downhill
    value, first, second = tied
    answer = [np.zeros((*value.shape, 0))]
    for change in motion.body.errors:
        body = replace(motion.body, inertia=inertia + INERTIA_STEP * change)
        other = over.defect(track.omega, *over.step(body, track.omega, step))
        changed = np.zeros_like(value)  # what other terms say of neighbours does not know the body
        changed[..., :6] = (other - value[..., :6]) / INERTIA_STEP
        answer.append(changed[..., None])
    if of_others.size:
        pulled = _linear(o, track, motion, value.shape)
        more = np.einsum("knmr,kr->knm", pulled, of_others)
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
    """What one sigma of each unknown of these terms adds to the residuals between neighbours (K, n - 1, m) = `shape`; that it
    changes with the states is left out of their equations."""
    spans = np.diff(o.t_s)
    white, found = -whitening(spans, *noises(o, motion)), []
    for term in o.of_motion:
        found.append((slice(0, 6), white @ term.pushes(track, spans)))
    for i, term in enumerate(o.of_pairs):
        found.append((slice(6 + 3 * i, 9 + 3 * i), term.gained(o.t_s, track)))
    columns = []
    for rows, part in found:
        column = np.zeros((*shape, part.shape[-1]))
        column[:, :, rows] = part
        columns.append(column)
    return np.concatenate(columns, axis=-1)


class SunPart(NamedTuple):
    """What the Sun's readings say: blocks (K, n, 6, 6), gradient (K, n, 6), border (K, n, 6, m), corner (K, m, m) and gradient
    (K, m) of the errors in common, cost (K)."""

    matrix: np.ndarray
    slope: np.ndarray
    border: np.ndarray
    corner: np.ndarray
    error_slope: np.ndarray
    cost: np.ndarray


def sun_part(
    o: Observations,
    places: Places,
    track: Track,
    error: np.ndarray,
    motion: Motion,
    clock: Clock | None,
) -> SunPart:
    """The Sun's readings, which answer to the states, to their own unknowns and to how late the states are, at errors (K, m)."""
    late = np.zeros(len(error)) if clock is None else _late(clock, error)
    seen = track if clock is None else seen_later(o, track, motion, late)
    size = 6 + places.n
    matrix, slope = (
        np.zeros((*track.omega.shape[:2], size, size)),
        np.zeros((*track.omega.shape[:2], size)),
    )
    cost = np.zeros(len(error))
    for term, place in places.sun:
        own, downhill, part = normal(term, seen, error[:, place])
        # of a turn at the Sun's instant and the term's unknowns, what the states (6) and all unknowns (m) do to each
        bridge = np.zeros((*track.omega.shape[:2], downhill.shape[-1], size))
        bridge[..., :3, :3] = (
            seen.attitude @ np.swapaxes(track.attitude, -1, -2) if clock is not None else np.eye(3)
        )
        bridge[..., :3, 3:6] = late[:, None, None, None] * np.eye(
            3
        )  # a rate turns it for as long as the state is late
        bridge[..., 3:, 6:][..., place] = np.eye(bridge.shape[-2] - 3)
        if clock is not None:
            bridge[..., :3, -1] = clock.sigma_s * seen.omega
        carried = np.swapaxes(bridge, -1, -2)
        matrix += carried @ own @ bridge
        slope += (carried @ downhill[..., None])[..., 0]
        cost += part.sum(axis=1)
    corner, error_slope = matrix[..., 6:, 6:].sum(axis=1), slope[..., 6:].sum(axis=1)
    return SunPart(
        matrix[..., :6, :6].copy(), slope[..., :6], matrix[..., :6, 6:], corner, error_slope, cost
    )
