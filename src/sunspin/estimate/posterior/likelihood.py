"""How likely a motion is: the panel readings of all samples, dark ones included, and what else was observed.

A lit reading is the panel's power with Gaussian noise. A dark one is a reading at or below the threshold, so it has the
probability that noise keeps the power there; relative to that of no power, so that panels turned away say nothing. Any reading
may, with probability `OUTLIERS`, have nothing to do with the Sun: a shadow, a spike, a dead panel.

The readings of a throttled sample share a factor that nobody knows. It is put at its best (variable projection), and integrated out
as readings are linear in it: that leaves one power of the noise, so that a sample of two lit panels says of the noise as much as
one reading does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr

from sunspin.dynamics.batch import Outcome
from sunspin.estimate.posterior.data import Readings
from sunspin.estimate.posterior.model import Model, State
from sunspin.estimate.posterior.tags import power_slope, tagged
from sunspin.estimate.terms.reading import LOG_2PI
from sunspin.solve.rotations import move_on_sphere, tangent_basis
from sunspin.vehicle.response.flat import PanelResponse

OUTLIERS = 0.02
"""Probability beforehand that a reading has nothing to do with the Sun."""

DARK_OUTLIER = 0.5
"""Probability that such a reading is dark."""


RATE_STEP = 3e-4
"""Step of the differences in rates, as a turn (rad) over the window; the second order it leaves is a part in a thousand."""

SPOILT, ROUNDS = 5.0, 3
"""Sigmas at which a reading counts half where the factor of a throttled sample is found, and how often it is found anew."""

UNIT_STEP = 1e-4
"""The same of the further unknowns, in prior sigmas, over `UNIT_STEP_S` s; shorter windows take larger ones."""

UNIT_STEP_S, LARGEST_UNIT_STEP = 2700.0, 3e-3

DERIVATIVE_ERROR, ROUGH_ERROR = 1e-7, 1e-5
"""Error of directions (rad) in runs that are subtracted from each other, and while hypotheses are still searched for: a likelihood
whose own error is `SEARCH_ERROR` is asked only where steps lead."""

SEARCH_ERROR = 1e-5


@dataclass(frozen=True)
class Prediction:
    """`sun`, `rate` (n, K, 3): directions and body rates at the samples; `omega` and `at` (n, others, 3): rates and directions at
    the other observations; `fine` (n): the run could be computed."""

    sun: np.ndarray
    rate: np.ndarray
    omega: np.ndarray
    at: np.ndarray
    fine: np.ndarray

    def piece(self, low: int, high: int) -> Prediction:
        part = slice(low, high)
        return Prediction(
            self.sun[part], self.rate[part], self.omega[part], self.at[part], self.fine[part]
        )

    @property
    def seen(self) -> np.ndarray:
        """All that differences depend on (n, K + 2 others, 3): `sun`, `omega`, `at`."""
        return (
            np.concatenate([self.sun, self.omega, self.at], axis=1)
            if self.at.shape[1]
            else self.sun
        )


class Linearised(NamedTuple):
    """Prediction, differences (n, R) measured less predicted, their added variance (n, R), their derivatives (n, R, D), and
    those of what is seen (n, 5 + moving, seen, 3) by rates, direction and the unknowns that have runs of their own."""

    prediction: Prediction
    raw: np.ndarray
    extra: np.ndarray
    jacobian: np.ndarray
    moves: np.ndarray


class Throttle(NamedTuple):
    """Readings (n, K, P) that the Sun's whole light would give, those that count for the factor of their sample, and it (n, K, 1);
    None where inputs are not throttled."""

    light: np.ndarray
    weight: np.ndarray
    factor: np.ndarray | None

    @property
    def power(self) -> np.ndarray:
        return self.light if self.factor is None else self.factor * self.light

    def slope(self, slope: np.ndarray) -> np.ndarray:
        """Derivatives of `power` from those (n, K, P) of the light, the factor following at its best."""
        if self.factor is None:
            return slope
        size = np.sum(self.weight * self.light**2, axis=-1, keepdims=True)
        along = np.sum(self.weight * self.light * slope, axis=-1, keepdims=True)
        return self.factor * (
            slope - self.light * np.divide(along, size, out=np.zeros_like(size), where=size > 0)
        )


class Secant(NamedTuple):
    """How states came to where they are: what was `seen` there (n, seen, 3), and the `step` (n, 5 + moving), zero where unknown."""

    seen: np.ndarray
    step: np.ndarray

    def corrected(self, moves: np.ndarray, seen: np.ndarray) -> np.ndarray:
        """Derivatives (n, 5 + moving, seen, 3) that give the change along the step as it was (Broyden 1965), the step's parts
        counted by how far they move what is seen."""
        flat = moves.reshape(*moves.shape[:2], -1)
        size = self.step * np.sum(flat**2, axis=2)
        length = np.sum(size * self.step, axis=1, keepdims=True)
        share = np.divide(size, length, out=np.zeros_like(size), where=length > 0)
        left = (seen - self.seen).reshape(len(flat), 1, -1) - self.step[:, None] @ flat
        return moves + (share[:, :, None] * left).reshape(moves.shape)


@dataclass(frozen=True)
class Likelihood:
    """A model against readings, its directions good to `direction_error` rad."""

    model: Model
    data: Readings
    direction_error: float = SEARCH_ERROR

    @cached_property
    def _times(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Output times, and where among them the samples (K) and the other observations are."""
        others = np.array([o.t_s for o in self.data.others])
        times, place = np.unique(np.concatenate([self.data.t_s, others]), return_inverse=True)
        place = place.ravel()
        return times, place[: len(self.data)], place[len(self.data) :]

    def predict(self, state: State, error: float | None = None) -> Prediction:
        """Where the Sun is at the samples, and the rates at the times of other observations."""
        times, samples, others = self._times
        rows = self.model.rows(state)
        parts, fine = [], np.ones(len(state), dtype=bool)
        for part in (times[times < 0][::-1], times[times >= 0]):
            if len(part):
                result = self.model.run(rows, part, error or self.direction_error)
                back = slice(None, None, -1 if part[0] < 0 else 1)
                parts.append((result.sun_B[:, back], result.omega_B[:, back]))
                fine &= result.outcome == Outcome.FINE
        sun, omega = (np.concatenate(every, axis=1) for every in zip(*parts, strict=True))
        lost = ~np.isfinite(sun).all(axis=(1, 2)) | ~np.isfinite(omega).all(axis=(1, 2))
        if lost.any():
            sun[lost], omega[lost], fine[lost] = np.nan, np.nan, False
        return Prediction(
            sun[:, samples], omega[:, samples], omega[:, others], sun[:, others], fine
        )

    @cached_property
    def response(self) -> PanelResponse:
        """How the vehicle's panels see light."""
        return self.model.vehicle.response_in()

    def power(self, sun: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Expected readings (n, K, P) of directions (n, K, 3)."""
        return self.throttle(self.light(sun, u)).power

    def light(self, sun: np.ndarray, u: np.ndarray) -> np.ndarray:
        """The same if nothing is throttled."""
        return self.response.power(sun, gain=self.gain(u), tilt=self.tilt(u))

    def throttle(self, light: np.ndarray) -> Throttle:
        """Expected readings (n, K, P) with the factors of their samples; a reading far from its own hardly counts for these."""
        data = self.data
        weight = np.broadcast_to(data.weight, light.shape)
        if not data.throttled:
            return Throttle(light, weight, None)
        factor = data.factor(light, weight)
        for _ in range(ROUNDS):
            weight = data.weight / (
                1.0 + ((data.value - factor * light) / (SPOILT * data.sigma)) ** 2
            )
            factor = data.factor(light, weight)
        return Throttle(light, weight, factor)

    def tilt(self, u: np.ndarray) -> np.ndarray | None:
        """Turns (n, 1, P, 3) of the panels, rad; None where they stand as drawn."""
        turns = self.model.turns
        return None if turns is None else np.tensordot(u, turns, axes=1)[:, None]

    def gain(self, u: np.ndarray) -> np.ndarray:
        """Factors (n, 1, P) on the vehicle's gains: brightness, and each panel's own."""
        model = self.model
        scale = np.zeros(len(u))
        for i in model.where("scale"):
            scale = model.unknowns[i].centre + model.unknowns[i].sigma * u[:, i]
        gains = model.relative(u, "gain", len(model.vehicle.inputs))
        return np.exp(scale[:, None] + gains)[:, None]

    def noise(self, u: np.ndarray) -> np.ndarray:
        """Sigmas (n, P) of readings, in their unit."""
        return self.data.sigma * np.exp(self.model.relative(u, "noise", 1))

    def readings(self, power: np.ndarray, sigma: np.ndarray) -> np.ndarray:
        """Log density (n, K, P) of each reading under expected ones of that shape and `sigma` (n, P)."""
        core = self.sunlight(power, sigma[:, None])
        return np.where(self.data.used, np.logaddexp(core, self.outlier), 0.0)

    def sunlight(self, power: np.ndarray, s: np.ndarray) -> np.ndarray:
        """The same if the reading is the Sun's, times the prior probability of that."""
        data = self.data
        lit = -0.5 * ((data.value - power) / s) ** 2 - np.log(s) - 0.5 * LOG_2PI
        dark = log_ndtr((data.threshold - power) / s) - log_ndtr(data.threshold / s)
        return np.where(data.lit, lit, dark) + np.log1p(-OUTLIERS)

    @cached_property
    def outlier(self) -> np.ndarray:
        """Log density (K, P) of each reading if it has nothing to do with the Sun, times the prior probability of that."""
        return np.log(
            OUTLIERS
            * np.where(self.data.lit, (1 - DARK_OUTLIER) * self.data.outlier_density, DARK_OUTLIER)
        )

    def samples(self, prediction: Prediction, u: np.ndarray) -> np.ndarray:
        """Log density (n, K) of each sample, the error of its time integrated out."""
        noise = self.noise(u)
        if self.model.time_sigma_s:
            out = tagged(self, prediction, u, self.model.time_sigma_s)[0]
        else:
            out = self.readings(self.power(prediction.sun, u), noise).sum(axis=-1)
        return out + self.data.factors * np.log(noise / self.data.sigma)[:, :1]

    def others(self, prediction: Prediction) -> np.ndarray:
        """Log density (n) of the other observations."""
        out = np.zeros(len(prediction.fine))
        for i, o in enumerate(self.data.others):
            out += o.log_density(prediction.at[:, i], prediction.omega[:, i])
        return out

    def __call__(self, state: State, error: float | None = None) -> np.ndarray:
        """Log-likelihood (n)."""
        return self.of(self.predict(state, error), state.u)

    def of(self, prediction: Prediction, u: np.ndarray) -> np.ndarray:
        """Log-likelihood (n) of motions already run."""
        out = self.samples(prediction, u).sum(axis=1) + self.others(prediction)
        return np.where(prediction.fine & np.isfinite(out), out, -np.inf)

    # ---- what least squares needs ------------------------------------------------------------------------------------------

    @cached_property
    def kinds(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of the R residuals, readings first: which are used, which are lit, and log density as an outlier (-inf: cannot be)."""
        more = sum(o.value.size for o in self.data.others)
        fixed = np.ones(more, dtype=bool)
        return (
            np.concatenate([self.data.used.ravel(), fixed]),
            np.concatenate([self.data.lit.ravel(), ~fixed]),
            np.concatenate([self.outlier.ravel(), np.full(more, -np.inf)]),
        )

    @cached_property
    def stated(self) -> np.ndarray:
        """Stated sigma of each residual (R)."""
        more = sum(o.value.size for o in self.data.others)
        return np.append(np.tile(self.data.sigma, len(self.data)), np.ones(more))

    def misfit(self, prediction: Prediction, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Differences (n, R) measured less predicted, and the variance (n, R) that errors of time tags add to them.

        Readings in their unit, a dark one's as far as the prediction is above the threshold; other observations in sigmas.
        """
        data, n = self.data, len(u)
        power = self.power(prediction.sun, u)
        raw = np.where(data.lit, data.value - power, -np.maximum(power - data.threshold, 0.0))
        raw = np.where(data.used & prediction.fine[:, None, None], raw, 0.0).reshape(n, -1)
        parts = [raw] + [
            o.residual(prediction.at[:, i], prediction.omega[:, i])
            for i, o in enumerate(data.others)
        ]
        every = np.concatenate(parts, axis=1)
        extra = np.zeros_like(every)
        if self.model.time_sigma_s:
            slope = power_slope(self, prediction.sun, prediction.rate, u)
            extra[:, : raw.shape[1]] = ((slope * self.model.time_sigma_s) ** 2).reshape(n, -1)
        return every, extra

    def weigh(
        self, raw: np.ndarray, extra: np.ndarray, sigma: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Objective (n), sigma of each residual (n, R) and weights (n, R) that make least squares of it, under `sigma` (n, P).

        The objective is minus the log-likelihood, relative to readings just as predicted under the stated noise; dark readings are
        taken as Gaussian too.
        """
        used, lit, outlier = self.kinds
        s = np.ones_like(extra)
        seen = s[:, : self.data.value.size]
        seen[:] = np.sqrt(np.tile(sigma, len(self.data)) ** 2 + extra[:, : seen.shape[1]])
        best = np.log1p(-OUTLIERS) - np.where(lit, np.log(s) + 0.5 * LOG_2PI, 0.0)
        good = best - 0.5 * (raw / s) ** 2
        total = np.logaddexp(good, outlier)
        stated = np.log1p(-OUTLIERS) - np.where(lit, np.log(self.stated) + 0.5 * LOG_2PI, 0.0)
        cost = np.where(used, np.logaddexp(stated, outlier) - total, 0.0).sum(axis=1)
        cost -= self.data.factors.sum() * np.log(sigma / self.data.sigma)[:, 0]
        return cost, s, np.where(used, np.exp(good - total), 0.0)

    def linearised(
        self,
        state: State,
        still: bool = False,
        moves: np.ndarray | None = None,
        secant: Secant | None = None,
    ) -> Linearised:
        """The differences about states, and how they change.

        In the order rates (rad/s), direction (tangent, rad), u. By differences of runs, so that the jump at a wheel's stop is
        in them; the direction's from one run more, as r0 -> r(t) is a rotation and does not depend on r0 (unless torques do: then
        from two). `still` leaves the unknowns that need a run of their own as they are. With the `moves` of a state near by and the
        `secant` from there it takes one run.
        """
        n, model = len(state), self.model
        error = ROUGH_ERROR if self.direction_error >= SEARCH_ERROR else DERIVATIVE_ERROR
        if moves is not None and secant is not None:
            base = self.predict(state, error)
            return self._put_together(
                state, base, secant.corrected(moves, base.seen), [] if still else model.moving
            )
        window = self.data.reach_s
        step = RATE_STEP / window
        own = self._steps(window)
        moving = [] if still else model.moving
        e1, _ = tangent_basis(state.sun)
        runs = [state] + [
            State(state.omega + step * np.eye(3)[i], state.sun, state.u) for i in range(3)
        ]
        if model.turned:
            runs += [
                State(
                    state.omega, move_on_sphere(state.sun, np.tile(RATE_STEP * x, (n, 1))), state.u
                )
                for x in np.eye(2)
            ]
        else:
            runs.append(State(state.omega, e1, state.u))
        first = len(runs)
        runs += [
            State(state.omega, state.sun, state.u + own[i] * np.eye(state.u.shape[1])[i])
            for i in moving
        ]
        every = self.predict(State.joined(runs), error)
        base, *parts = [every.piece(i * n, (i + 1) * n) for i in range(len(runs))]
        seen = base.seen
        changes = [(p.seen - seen) / step for p in parts[:3]]
        if model.turned:
            changes += [(p.seen - seen) / RATE_STEP for p in parts[3:5]]
        else:
            changes.append(parts[3].seen * self._is_direction)
            changes.append(np.cross(seen, changes[3]))
        changes += [
            (p.seen - seen) / own[i] for p, i in zip(parts[first - 1 :], moving, strict=True)
        ]
        return self._put_together(state, base, np.stack(changes, axis=1), moving)

    def _put_together(
        self, state: State, base: Prediction, moves: np.ndarray, moving: list[int]
    ) -> Linearised:
        """The differences and their derivatives, from those of what is seen (n, 5 + moving, seen, 3)."""
        raw, extra = self.misfit(base, state.u)
        throttle = self.throttle(self.light(base.sun, state.u))
        power = throttle.power
        counts = self.data.used & (
            self.data.lit | (power > self.data.threshold)
        )  # not a dark panel that should be dark
        columns = self._along(base, state.u, list(np.moveaxis(moves, 1, 0)), counts, throttle)
        own_run = iter(columns[5:])
        each = range(state.u.shape[1])
        changes = self._standing(base, state.u, throttle)
        columns = columns[:5] + [
            next(own_run) if i in moving else self._column(changes(i), counts) for i in each
        ]
        jacobian = np.stack(columns, axis=-1)
        jacobian = np.where(np.isfinite(jacobian) & base.fine[:, None, None], jacobian, 0.0)
        return Linearised(base, raw, extra, jacobian, moves)

    @cached_property
    def _is_direction(self) -> np.ndarray:
        """1 where a `Prediction.seen` is a direction to the Sun, 0 where it is a rate (seen, 1)."""
        count, others = len(self.data), len(self.data.others)
        return np.repeat([1.0, 0.0, 1.0], [count, others, others])[:, None]

    def _steps(self, window_s: float) -> np.ndarray:
        """Steps (k) of the differences in the further unknowns."""
        own = min(UNIT_STEP * max(UNIT_STEP_S / window_s, 1.0), LARGEST_UNIT_STEP)
        turned = [
            max(x.sigma * window_s**2 / 2, RATE_STEP) if x.kind == "steady_torque" else 0.0
            for x in self.model.unknowns
        ]
        return np.array([RATE_STEP / turn if turn else own for turn in turned])

    def _along(
        self,
        base: Prediction,
        u: np.ndarray,
        moves: list[np.ndarray],
        counts: np.ndarray,
        throttle: Throttle,
    ) -> list[np.ndarray]:
        """Derivatives (n, R) of the differences along those of the motion (n, K + 2 others, 3); `counts` (n, K, P): readings that
        change."""
        found, gain, tilt, count, others = (
            [],
            self.gain(u),
            self.tilt(u),
            len(self.data),
            self.data.others,
        )
        slopes = self.response.power_changes(
            base.sun, [move[:, :count] for move in moves], gain=gain, tilt=tilt
        )
        for move, slope in zip(moves, slopes, strict=True):
            columns = [np.where(counts, -throttle.slope(slope), 0.0).reshape(len(u), -1)]
            for i, o in enumerate(others):
                omega, at = move[:, count + i], move[:, count + len(others) + i]
                columns.append(-o.slope(base.at[:, i], base.omega[:, i], at, omega) / o.sigma)
            found.append(np.concatenate(columns, axis=1))
        return found

    def _standing(
        self, base: Prediction, u: np.ndarray, throttle: Throttle
    ) -> Callable[[int], np.ndarray]:
        """How powers (n, K, P) change with an unknown that does not change the motion, by its place: scale, gains, tilts."""
        turns, panels = self.model.turns, np.arange(throttle.light.shape[-1])
        to_tilt = (
            None
            if turns is None
            else self.response.slopes(base.sun, gain=self.gain(u), tilt=self.tilt(u)).to_tilt
        )

        def change(i: int) -> np.ndarray:
            unknown = self.model.unknowns[i]
            if turns is not None and to_tilt is not None and turns[i].any():
                return throttle.slope(np.einsum("nkpi,pi->nkp", to_tilt, turns[i]))
            share = {"scale": 1.0, "gain": (panels == unknown.index) * 1.0}.get(unknown.kind, 0.0)
            return throttle.slope(throttle.light * share * unknown.sigma)

        return change

    def _column(self, slope: np.ndarray, counts: np.ndarray) -> np.ndarray:
        """Derivatives (n, R) of the differences where powers change by `slope` (n, K, P) and the other observations do not."""
        more = np.zeros((len(slope), sum(o.value.size for o in self.data.others)))
        return np.concatenate([np.where(counts, -slope, 0.0).reshape(len(slope), -1), more], axis=1)
