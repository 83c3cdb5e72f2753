"""Many starts to their best fits at once: least squares with weights that let go of outliers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from sunspin.estimate.posterior.family import apart
from sunspin.estimate.posterior.likelihood import Likelihood, Secant
from sunspin.estimate.posterior.model import State
from sunspin.solve.least_squares import least_squares, limit_length, take_problems
from sunspin.solve.linear import DenseSystem, solve_dense
from sunspin.solve.rotations import move_on_sphere, tangent_basis

FLOOR = 1e-9
"""Part of the largest curvature that is added to all: directions that nothing tells are left alone."""

FAR = 8.0
"""No unknown is farther from the centre of its prior, in its sigmas."""

INSIDE = 0.95
"""Part of the distance to bodies that cannot exist up to which fits go: draws about them stay among those that can."""

LARGEST_TURN = 0.5
"""rad by which one step may turn the Sun within the window."""

FITTED = 40
"""Runs of its motion that a fit takes as long as: each unknown and each step needs one. Measured on Philae, 25 to 50."""

READINGS_AT_ONCE = 2_500_000
"""Derivatives held in memory at once by one worker."""

_Point = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Secant]
"""Rates, directions and unknowns, the derivatives of what is seen there, and how they came there."""

Levels = tuple[tuple[float, int], ...]
"""(factor on the noise, steps) one after the other."""


def chunk_rows(likelihood: Likelihood) -> int:
    """Rows that one worker fits at once."""
    size = likelihood.data.value.size * likelihood.model.dimension
    return int(np.clip(READINGS_AT_ONCE // max(size, 1), 8, 1024))


class Begun(NamedTuple):
    """States near those that a fit begins with, a state for each, their derivatives (n, 5 + moving, seen, 3), and what is seen."""

    state: State
    moves: np.ndarray
    seen: np.ndarray


@dataclass(frozen=True)
class OfStates:
    """What a function of rows has in common with others whose rows are hypotheses."""

    likelihood: Likelihood
    state: State = field(repr=False)

    @property
    def n_rows(self) -> int:
        return len(self.state)


@dataclass(frozen=True)
class Slopes(OfStates):
    """Row -> derivatives of what is seen of a motion, and that."""

    still: bool

    @property
    def outputs(self) -> Mapping[str, Any]:
        data, moving = self.likelihood.data, [] if self.still else self.likelihood.model.moving
        seen = len(data) + 2 * len(data.others)
        return {"moves": ("float64", (5 + len(moving), seen, 3)), "seen": ("float64", (seen, 3))}

    def __call__(self, index: np.ndarray) -> dict[str, np.ndarray]:
        found = self.likelihood.linearised(self.state.take(index), self.still)
        return {"moves": found.moves, "seen": found.prediction.seen}


@dataclass(frozen=True)
class Fit:
    """Row -> the best fit that its start leads to.

    `levels`: (factor on the noise, steps) one after the other: a wide noise first, so that a start far away is drawn in.
    `still`: leave the unknowns of the motion as they are; `free` (D, q): what these columns do not span too.
    `curved`: give the curvature too, at the noise that fits;
    `normal`: the curvature alone (D, D). `hopeless`: rows whose cost is above that after the first level stay as they are then.
    `begun`: derivatives of states near by to begin with; `promising`: rows whose cost is at most that then have their own found,
    and take two steps more.
    """

    likelihood: Likelihood
    start: State = field(repr=False)
    levels: Levels
    still: bool = False
    curved: bool = False
    normal: bool = False
    hopeless: float = np.inf
    free: np.ndarray | None = None
    begun: Begun | None = field(default=None, repr=False)
    promising: float = np.inf

    @property
    def n_rows(self) -> int:
        return len(self.start)

    @property
    def outputs(self) -> Mapping[str, Any]:
        d = self.likelihood.model.dimension
        out = {
            "omega": ("float64", (3,)),
            "sun": ("float64", (3,)),
            "u": ("float64", (d - 5,)),
            "cost": ("float64", ()),
        }
        if self.normal:
            out["normal"] = ("float32", (d, d))
        return (
            {**out, "hessian": ("float64", (d, d)), "readings": ("float64", ())}
            if self.curved
            else out
        )

    def __call__(self, index: np.ndarray) -> dict[str, np.ndarray]:
        search = _Search(
            self.likelihood, self.start.take(index), self.still or self.free is not None, self.free
        )
        search.refresh(
            None
            if self.begun is None
            else Begun(self.begun.state.take(index), *(x[index] for x in self.begun[1:]))
        )
        (factor, steps), *others = self.levels
        search.go(factor, steps)
        on, left = self._dropped(search, self.hopeless, np.arange(len(index)), {})
        if not len(on):
            return left
        for factor, steps in others:
            if self.curved:
                search.refresh()
            search.go(factor, steps)
        if self.free is None:
            search.fit_noise(self.normal)
        if self.begun is not None:
            on, left = self._dropped(search, self.promising, on, left)
            if not len(on):
                return left
            search.refresh()
            search.steps(2)
            search.fit_noise(self.normal)
        if self.curved:
            for _ in range(2):
                search.refresh()
                search.fit_noise()
                search.steps(2)
        return self._with(left, on, search)

    def _dropped(
        self, search: _Search, most: float, on: np.ndarray, left: dict[str, np.ndarray]
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """The rows that go on, those of at most a cost, of the rows `on`; and what is told of all, as they are now."""
        if not np.any(search.objective > most):
            return on, left
        left, rows = self._with(left, on, search), np.flatnonzero(search.objective <= most)
        search.only(rows)
        return on[rows], left

    def _with(
        self, left: dict[str, np.ndarray], on: np.ndarray, search: _Search
    ) -> dict[str, np.ndarray]:
        """What was told of all rows, with what is told of the rows `on` now."""
        found = self._told(search)
        for name, value in left.items():
            value[on] = found[name]
        return left or found

    def _told(self, search: _Search) -> dict[str, np.ndarray]:
        state = search.state
        out = {
            "omega": state.omega,
            "sun": state.sun,
            "u": state.u,
            "cost": np.array(search.objective),
        }
        if self.normal:
            out["normal"] = search.curvature().astype(np.float32)
        return (
            {**out, "hessian": search.curvature(), "readings": search.readings}
            if self.curved
            else out
        )


class _Search:
    """A batch of starts on its way; every row by itself. Derivatives of the motion are found once, by many runs, and then corrected
    by what each step shows, which takes one."""

    def __init__(
        self, likelihood: Likelihood, state: State, still: bool, free: np.ndarray | None = None
    ) -> None:
        state = replace(state, u=likelihood.model.possible(state.u, INSIDE))
        self.likelihood, self.state, self.still, self.free = likelihood, state, still, free
        self._moving = [*range(5), *(5 + i for i in likelihood.model.moving if not still)]
        self._prior = np.concatenate([np.zeros(5), likelihood.model.precision])
        self._factor = 1.0

    def refresh(self, begun: Begun | None = None) -> None:
        """Linearise anew at the present state, or with what is `begun` near by."""
        if begun is None:
            self._system = self._seen_from(self.state)
            return
        step = apart(self.state, begun.state)[:, self._moving]
        self._system = self._seen_from(
            self.state, *_turned(begun.state.sun, self.state.sun, begun.moves, begun.seen, step)
        )

    @property
    def objective(self) -> np.ndarray:
        """Minus the log posterior density (n), up to a constant, under the present noise."""
        return self._system.cost

    @property
    def readings(self) -> np.ndarray:
        """The same (n) without the priors."""
        return self.objective - self._of_prior(self.state.u)

    def _of_prior(self, u: np.ndarray) -> np.ndarray:
        return 0.5 * np.sum(self._prior[5:] * u**2, axis=1)

    def go(self, factor: float, steps: int) -> None:
        """Steps under `factor` times the noise."""
        self._factor = factor
        self._judge()
        self.steps(steps)

    def steps(self, count: int) -> None:
        """Steps of least squares, begun anew."""
        found = least_squares(
            self._linearised,
            self._moved,
            solve_dense,
            self._carried((self.state.omega, self.state.sun, self.state.u), self._system),
            steps=count,
            system=self._system,
            length_ratio=self._longest,
            limit=self._limited,
            carry=self._carried,
        )
        self.state, self._system = State(*found.state[:3]), found.system

    def _carried(self, state: tuple[Any, ...], system: DenseSystem) -> _Point:
        """States with their derivatives and what is seen there, no step having been taken from them yet."""
        moves, seen = system.extras[4:]
        return (
            state[0],
            state[1],
            state[2],
            moves,
            Secant(seen, np.zeros((len(seen), len(self._moving)))),
        )

    def only(self, rows: np.ndarray) -> None:
        """Go on with some of the rows."""
        self.state, self._system = self.state.take(rows), take_problems(self._system, rows)

    def _linearised(self, state: _Point) -> DenseSystem:
        return self._seen_from(State(*state[:3]), state[3], state[4])

    def _seen_from(
        self, state: State, moves: np.ndarray | None = None, secant: Secant | None = None
    ) -> DenseSystem:
        base, raw, extra, jacobian, moves = self.likelihood.linearised(
            state, self.still, moves, secant
        )
        return self._weighed(
            state.u,
            raw,
            extra,
            jacobian,
            base.fine & np.isfinite(raw).all(axis=1),
            moves,
            base.seen,
        )

    def _judge(self) -> None:
        """Weigh the same differences anew, under another noise."""
        self._system = self._weighed(self.state.u, *self._system.extras)

    def _scaled(
        self, u: np.ndarray, raw: np.ndarray, extra: np.ndarray, jacobian: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """Cost (n) of the readings, their residuals (n, R) and derivatives (n, R, D), weighed."""
        cost, s, w = self.likelihood.weigh(raw, extra, self._factor * self.likelihood.noise(u))
        return cost, np.sqrt(w) * raw / s, np.sqrt(w)[:, :, None] * (jacobian / s[:, :, None])

    def _weighed(
        self,
        u: np.ndarray,
        raw: np.ndarray,
        extra: np.ndarray,
        jacobian: np.ndarray,
        fine: np.ndarray,
        *motion: np.ndarray,
    ) -> DenseSystem:
        cost, residual, scaled = self._scaled(u, raw, extra, jacobian)
        normal = np.swapaxes(scaled, 1, 2) @ scaled + np.diag(self._prior)
        gradient = np.einsum("nri,nr->ni", scaled, residual)
        gradient[:, 5:] += self._prior[5:] * u
        if self.free is not None:
            normal = np.einsum("ai,nij,jb->nab", self.free.T, normal, self.free)
            gradient = gradient @ self.free
        scale = np.einsum("nii->ni", normal).copy()
        floor = FLOOR * scale.max(axis=1) + 1e-12
        normal = normal + floor[:, None, None] * np.eye(normal.shape[1])
        cost = np.where(fine, cost + self._of_prior(u), np.inf)
        return DenseSystem(cost, normal, gradient, scale, (raw, extra, jacobian, fine, *motion))

    def _whole(self, step: np.ndarray) -> np.ndarray:
        return step if self.free is None else step @ self.free.T

    def _longest(self, state: _Point, step: np.ndarray) -> np.ndarray:
        move, window = self._whole(step), self.likelihood.data.reach_s
        turn = np.maximum(
            np.linalg.norm(move[:, :3], axis=1) * window, np.linalg.norm(move[:, 3:5], axis=1)
        )
        pushed = (
            np.linalg.norm(self.likelihood.model.relative(move[:, 5:], "steady_torque", 3), axis=1)
            * window**2
            / 2
        )
        return np.maximum(
            np.maximum(turn, pushed) / LARGEST_TURN, np.abs(move[:, 5:]).max(axis=1, initial=0.0)
        )

    def _moved(self, state: _Point, step: np.ndarray) -> _Point:
        move = self._whole(step)
        sun = move_on_sphere(state[1], move[:, 3:5])
        came = _turned(state[1], sun, state[3], state[4].seen, move[:, self._moving])
        return state[0] + move[:, :3], sun, state[2] + move[:, 5:], *came

    def _limited(self, state: _Point) -> _Point:
        model = self.likelihood.model
        omega, u = (
            limit_length(state[0], model.max_rate),
            model.possible(np.clip(state[2], -FAR, FAR), INSIDE),
        )
        whole = (omega == state[0]).all(axis=1) & (u == state[2]).all(
            axis=1
        )  # of a step cut off nothing is learnt
        return (
            omega,
            state[1],
            u,
            state[3],
            state[4]._replace(step=np.where(whole[:, None], state[4].step, 0.0)),
        )

    def fit_noise(self, few: bool = False) -> None:
        """Set the noise to its best value for the present residuals, by a few Newton steps in its logarithm.

        `few`: as many readings as there are numbers fitted tell nothing of it, and a few samples not that it is less than stated.
        Else a family of motions that fit the first samples seems to be one motion, known to a tenth of its width.
        """
        model = self.likelihood.model
        places = model.where("noise")
        if not places:
            return
        at, lit = places[0], self.likelihood.kinds[1] & self.likelihood.kinds[0]
        width, u, (raw, extra, *_) = (
            model.unknowns[at].sigma,
            np.array(self.state.u),
            self._system.extras,
        )
        taken, least = (self._taken_up(), 0.0 if self.still else -5.0) if few else (0.0, -5.0)
        for _ in range(8):
            _, each, w = self.likelihood.weigh(raw, extra, self.likelihood.noise(u))
            share = (1 - extra / each**2) * w  # time tags' errors do not scale with the noise
            spread = np.sum(np.where(lit, share * (raw / each) ** 2, 0.0), axis=1)
            count = np.maximum(
                np.sum(np.where(lit, share, 0.0), axis=1)
                - taken
                - self.likelihood.data.factors.sum(),
                0.0,
            )
            slope = width * (count - spread) + u[:, at]
            u[:, at] = np.clip(
                u[:, at]
                - np.clip(slope / (width**2 * 2 * np.maximum(spread, 0.3 * count) + 1), -1, 1),
                least,
                5,
            )
        self.state = State(self.state.omega, self.state.sun, u)
        self._judge()

    def _taken_up(self) -> np.ndarray:
        """How many readings (n) the unknowns of each row answer for, dark ones and priors apart."""
        scaled = self._scaled(self.state.u, *self._system.extras[:3])[2]
        told = np.swapaxes(scaled, 1, 2) @ scaled
        size = np.sqrt(
            np.einsum("nii->ni", told) + self._prior + 1e-12
        )  # in these units no number is large
        told /= size[:, :, None] * size[:, None, :]
        whole = told + np.eye(told.shape[1]) * (self._prior / size**2 + 1e-9)[:, :, None]
        return np.trace(np.linalg.solve(whole, told), axis1=1, axis2=2)

    def curvature(self) -> np.ndarray:
        """Second derivatives (n, D, D) of minus the log posterior, by Gauss and Newton."""
        _, residual, scaled = self._scaled(self.state.u, *self._system.extras[:3])
        normal = np.swapaxes(scaled, 1, 2) @ scaled + np.diag(self._prior)
        model = self.likelihood.model
        for i in model.where("noise"):
            lit = self.likelihood.kinds[1] & self.likelihood.kinds[0]
            squares = np.sum(np.where(lit, residual**2, 0.0), axis=1)
            normal[:, 5 + i, 5 + i] = 1 + 2 * model.unknowns[i].sigma ** 2 * squares
        return normal


def _turned(
    sun: np.ndarray, there: np.ndarray, moves: np.ndarray, seen: np.ndarray, step: np.ndarray
) -> tuple[np.ndarray, Secant]:
    """Derivatives and a step, given in the tangents at directions `sun`, in those at the directions `there` that it led to."""
    across = np.stack(tangent_basis(there), axis=1) @ np.swapaxes(
        np.stack(tangent_basis(sun), axis=1), 1, 2
    )
    moves, step = np.array(moves), np.array(step)
    moves[:, 3:5] = (across @ moves[:, 3:5].reshape(len(moves), 2, -1)).reshape(
        len(moves), 2, *moves.shape[2:]
    )
    step[:, 3:5] = (across @ step[:, 3:5, None])[:, :, 0]
    return moves, Secant(seen, step)
