"""Many starts to their best fits at once: damped least squares with weights that let go of outliers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sunspin.compute.identity import code, plain
from sunspin.dynamics import ensemble as k
from sunspin.estimate.posterior.likelihood import Likelihood, moved
from sunspin.estimate.posterior.model import Model, State

FILES = (
    "estimate/posterior/data.py", "estimate/posterior/model.py", "estimate/posterior/likelihood.py", "estimate/posterior/fit.py",
    "estimate/posterior/cells.py", "estimate/posterior/widths.py", "estimate/posterior/tags.py", "estimate/inertia.py",
)  # fmt: skip
"""Files whose text decides what the rows of a posterior give."""

FIRST_DAMPING, LESS, MORE = 1e-3, 0.2, 8.0
"""Of a step, as a part of the curvature; after a step that helped it falls, after one that did not it grows."""

ARRIVED = 1e-3
"""Fall of the objective in a step below which a row has arrived, and waits for the next noise."""

LARGEST_TURN = 0.5
"""rad by which one step may turn the Sun within the window."""

READINGS_AT_ONCE = 2_500_000
"""Derivatives held in memory at once by one worker."""

GPU_TIMES = 8
"""Times as many on a GPU."""

Levels = tuple[tuple[float, int], ...]
"""(factor on the noise, steps) one after the other."""


def chunk_rows(likelihood: Likelihood) -> int:
    """Rows that one worker fits at once: more on a GPU, which few do not fill."""
    size, more = likelihood.data.value.size * likelihood.model.dimension, 1 if likelihood.model.device == "cpu" else GPU_TIMES
    return int(np.clip(more * READINGS_AT_ONCE // max(size, 1), 8, more * 1024))


def asked(function: Any, model: Model) -> dict[str, Any]:
    """The identity of a function of rows: code, device, and all that it is made of."""
    return {**code(*FILES), **k.device_identity(model.device), type(function).__name__.lower(): plain(function)}


@dataclass(frozen=True)
class Fit:
    """Row -> the best fit that its start leads to.

    `levels`: (factor on the noise, steps) one after the other: a wide noise first, so that a start far away is drawn in.
    `still`: leave the unknowns of the motion as they are; `free` (D, q): what these columns do not span too.
    `curved`: give the curvature too, at the noise that fits;
    `normal`: the curvature alone (D, D). `hopeless`: rows whose cost is above that after the first level stay as they are then.
    """

    likelihood: Likelihood
    start: State = field(repr=False)
    levels: Levels
    still: bool = False
    curved: bool = False
    normal: bool = False
    hopeless: float = np.inf
    free: np.ndarray | None = None

    @property
    def n_rows(self) -> int:
        return len(self.start)

    @property
    def outputs(self) -> Mapping[str, Any]:
        d = self.likelihood.model.dimension
        out = {"omega": ("float64", (3,)), "sun": ("float64", (3,)), "u": ("float64", (d - 5,)), "cost": ("float64", ())}
        if self.normal:
            out["normal"] = ("float32", (d, d))
        return {**out, "hessian": ("float64", (d, d)), "readings": ("float64", ())} if self.curved else out

    def identity(self) -> dict[str, Any]:
        return asked(self, self.likelihood.model)

    def __call__(self, index: np.ndarray) -> dict[str, np.ndarray]:
        search = _Search(self.likelihood, self.start.take(index), self.still or self.free is not None)
        search.free = self.free
        (factor, steps), *others = self.levels
        search.go(factor, steps)
        on, left = np.arange(len(index)), None
        if np.isfinite(self.hopeless) and np.any(search.objective > self.hopeless):
            on, left = np.flatnonzero(search.objective <= self.hopeless), self._told(search)
            if not len(on):
                return left
            search.only(on)
        for factor, steps in others:
            search.go(factor, steps)
        if self.free is None:
            search.fit_noise(self.normal)
        if self.curved:
            for _ in range(2):
                search.fit_noise()
                search.step()
                search.step()
        found = self._told(search)
        if left is None:
            return found
        for name, value in found.items():
            left[name][on] = value
        return left

    def _told(self, search: _Search) -> dict[str, np.ndarray]:
        state = search.state
        out = {"omega": state.omega, "sun": state.sun, "u": state.u, "cost": np.array(search.objective)}
        if self.normal:
            out["normal"] = search.curvature().astype(np.float32)
        return {**out, "hessian": search.curvature(), "readings": search.cost} if self.curved else out


class _Search:
    """A batch of starts on its way; every row by itself."""

    def __init__(self, likelihood: Likelihood, state: State, still: bool) -> None:
        self.likelihood, self.state, self.still = likelihood, state, still
        self._prior = np.concatenate([np.zeros(5), np.ones(state.u.shape[1])])
        self._factor = 1.0
        self.free: np.ndarray | None = None
        self._load(state)

    def _load(self, state: State) -> None:
        _, self._raw, self._extra, self._jacobian = self._look(state)
        self._set_off()

    def _set_off(self) -> None:
        """All rows are on their way, with the damping of a first step."""
        self._damping = np.full(len(self.state), FIRST_DAMPING)
        self._arrived = np.zeros(len(self.state), dtype=bool)

    def _look(self, state: State) -> tuple[Any, ...]:
        base, raw, extra, jacobian = self.likelihood.linearised(state, self.still)
        return base.fine & np.isfinite(raw).all(axis=1), raw, extra, jacobian

    def _sigma(self, state: State) -> np.ndarray:
        return self._factor * self.likelihood.noise(state.u)

    def go(self, factor: float, steps: int) -> None:
        """Steps under `factor` times the noise."""
        self.widen(factor)
        for _ in range(steps):
            self.step()

    def only(self, rows: np.ndarray) -> None:
        """Go on with some of the rows."""
        self.state = self.state.take(rows)
        self._raw, self._extra, self._jacobian = self._raw[rows], self._extra[rows], self._jacobian[rows]
        self._set_off()
        self._judge()

    def widen(self, factor: float) -> None:
        """Set the noise to `factor` times what it is."""
        self._factor = factor
        self._set_off()
        self._judge()

    def _judge(self) -> None:
        self.cost, s, w = self.likelihood.weigh(self._raw, self._extra, self._sigma(self.state))
        self._scaled = np.sqrt(w)[:, :, None] * (self._jacobian / s[:, :, None])
        self._residual = np.sqrt(w) * self._raw / s
        self.objective = self.cost + 0.5 * np.sum(self.state.u**2, axis=1)

    def step(self) -> None:
        """One step of the rows that have not arrived."""
        on = np.flatnonzero(~self._arrived)
        if not len(on):
            return
        state = self.state.take(on)
        trial = self._moved(state, self._move(on))
        fine, raw, extra, jacobian = self._look(trial)
        cost = self.likelihood.weigh(raw, extra, self._sigma(trial))[0] + 0.5 * np.sum(trial.u**2, axis=1)
        better = fine & (cost < self.objective[on])
        self._damping[on] *= np.where(better, LESS, MORE)
        self._arrived[on] = better & (cost > self.objective[on] - ARRIVED)
        there = on[better]
        new, omega, sun, u = trial.take(better), np.array(self.state.omega), np.array(self.state.sun), np.array(self.state.u)
        omega[there], sun[there], u[there] = new.omega, new.sun, new.u
        self.state = State(omega, sun, u)
        self._raw[there], self._extra[there], self._jacobian[there] = raw[better], extra[better], jacobian[better]
        self._judge()

    def _move(self, rows: np.ndarray) -> np.ndarray:
        """Damped step (m, D) of some of the rows."""
        scaled, u = self._scaled[rows], self.state.u[rows]
        normal = np.einsum("nri,nrj->nij", scaled, scaled) + np.diag(self._prior)
        gradient = np.einsum("nri,nr->ni", scaled, self._residual[rows])
        gradient[:, 5:] += u
        if self.free is not None:
            normal = np.einsum("ai,nij,jb->nab", self.free.T, normal, self.free)
            gradient = gradient @ self.free
        diagonal = np.einsum("nii->ni", normal)
        floor = 1e-9 * diagonal.max(axis=1, keepdims=True) + 1e-12
        damping = self._damping[rows, None] * diagonal + floor
        damped = normal + np.einsum("ni,ij->nij", damping, np.eye(normal.shape[1]))
        move = -np.linalg.solve(damped, gradient[:, :, None])[:, :, 0]
        return move if self.free is None else move @ self.free.T

    def _moved(self, state: State, move: np.ndarray) -> State:
        window = self.likelihood.data.reach_s
        turn = np.maximum(np.linalg.norm(move[:, :3], axis=1) * window, np.linalg.norm(move[:, 3:5], axis=1))
        turn = np.maximum(turn / LARGEST_TURN, np.abs(move[:, 5:]).max(axis=1, initial=0.0))
        move = move / np.maximum(turn, 1.0)[:, None]
        omega = state.omega + move[:, :3]
        limit = self.likelihood.model.max_rate
        omega = omega * np.minimum(1.0, limit / np.maximum(np.linalg.norm(omega, axis=1, keepdims=True), 1e-12))
        return State(omega, moved(state.sun, move[:, 3:5]), np.clip(state.u + move[:, 5:], -8.0, 8.0))

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
        width, u = model.unknowns[at].sigma, np.array(self.state.u)
        taken, least = (self._taken_up(), 0.0 if self.still else -5.0) if few else (0.0, -5.0)
        for _ in range(8):
            s = self.likelihood.noise(u)
            _, each, w = self.likelihood.weigh(self._raw, self._extra, s)
            share = (s[:, None] / each) ** 2 * w  # time tags' errors do not scale with the noise
            spread = np.sum(np.where(lit, share * (self._raw / each) ** 2, 0.0), axis=1)
            count = np.maximum(np.sum(np.where(lit, share, 0.0), axis=1) - taken, 0.0)
            slope = width * (count - spread) + u[:, at]
            u[:, at] = np.clip(u[:, at] - np.clip(slope / (width**2 * 2 * np.maximum(spread, 0.3 * count) + 1), -1, 1), least, 5)
        self.state = State(self.state.omega, self.state.sun, u)
        self._set_off()
        self._judge()

    def _taken_up(self) -> np.ndarray:
        """How many readings (n) the unknowns of each row answer for, dark ones and priors apart."""
        told = np.einsum("nri,nrj->nij", self._scaled, self._scaled)
        size = np.sqrt(np.einsum("nii->ni", told) + self._prior + 1e-12)  # in these units no number is large
        told /= size[:, :, None] * size[:, None, :]
        whole = told + np.eye(told.shape[1]) * (self._prior / size**2 + 1e-9)[:, :, None]
        return np.trace(np.linalg.solve(whole, told), axis1=1, axis2=2)

    def curvature(self) -> np.ndarray:
        """Second derivatives (n, D, D) of minus the log posterior, by Gauss and Newton."""
        normal = np.einsum("nri,nrj->nij", self._scaled, self._scaled) + np.diag(self._prior)
        model = self.likelihood.model
        for i in model.where("noise"):
            lit = self.likelihood.kinds[1] & self.likelihood.kinds[0]
            squares = np.sum(np.where(lit, self._residual**2, 0.0), axis=1)
            normal[:, 5 + i, 5 + i] = 1 + 2 * model.unknowns[i].sigma ** 2 * squares
        return normal
