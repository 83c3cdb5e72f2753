"""A scan in two grades: the motions of a coarser grid, then each further one whose place in a set asked for they leave open.

EMD is a smooth function of the initial rates in most of a grid, and rough in connected parts of it: where motions cross an unstable
spin while the wheel runs down, neighbours end up on either side. How rough it is around a motion is seen at the nodes of the
coarser grid: by how much each differs from the curve through its neighbours. The largest such difference nearby bounds the error
of an interpolated motion. What is interpolated nearer to a limit than its bound is run, and each scan tries the bounds on motions
drawn at random.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import maximum_filter

from sunspin.base.errors import InputError, sentence
from sunspin.compute.identity import bits
from sunspin.compute.rows import ensemble
from sunspin.dynamics.ensemble import Outcome, check_commands
from sunspin.dynamics.friction import spin_down_speed
from sunspin.estimate.scan.rows import EmdRows

STRIDE = 2
"""The coarser grid has every second motion along each axis; docs/decisions.md says why not every fourth first."""

FEWEST_POINTS = 9
"""An axis with fewer points is not made coarser: curves go through four neighbours of a node."""

REACH = 2
"""Roughness is the largest difference of a node within so many nodes along each axis; with one, three times as many motions lay
beyond their bounds."""

FEWEST_ROWS = 20_000
"""Of smaller grids each motion is run: to try the bounds of what is interpolated would cost as much."""

ROUGHNESS, FLOOR = 1.25, 3e-3
"""A bound is so many times the roughness and a floor: what a few nodes do not show."""

CLASSES = (4e-3, 8e-3, 16e-3)
"""Bounds at which the classes of interpolated motions part."""

CHECKED, NEAR = 1200, 5e-3
"""So many interpolated motions of all classes, and as many whose bounds end within NEAR of a limit, try the bounds."""

Run = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Row numbers (n) -> EMD and outcome (n)."""


class Graded:
    """The motions of a grid, run or interpolated such that they settle which is the smallest and who lies below each limit.

    Attributes
    ----------
    emd, outcome, exact : arrays over the grid
        `exact`: the motion was run.
    tried, violations : (n_class)
        Interpolated motions that were run to try their bounds, and how many of them lay beyond.
    """

    def __init__(
        self,
        axes: Sequence[np.ndarray],
        factors: Sequence[float],
        thresholds: Sequence[float],
        run: Run,
    ) -> None:
        """`axes`: rates in ascending order; `factors` times the smallest EMD and `thresholds` are the limits."""
        self.axes, self.factors, self.thresholds, self.run = axes, factors, thresholds, run
        shape = tuple(len(axis) for axis in axes)
        self.emd, self.outcome = np.full(shape, np.nan), np.full(shape, Outcome.FINE, np.int8)
        self.exact, self.first_bound = np.zeros(shape, dtype=bool), np.zeros(shape)
        self.scale = np.ones(len(CLASSES) + 1)
        self.tried, self.violations = np.zeros((2, len(CLASSES) + 1), dtype=int)
        self._interpolate()
        self._settle()
        self._check()

    @property
    def bound(self) -> np.ndarray:
        """Of the error of each EMD, against running the motion; 0 where it was run."""
        return np.where(self.exact, 0.0, self.first_bound * self.scale[self._class()])

    def _class(self) -> np.ndarray:
        return np.searchsorted(CLASSES, self.first_bound)

    def _known(self) -> np.ndarray:
        """EMD of motions that were run and could be computed, else NaN."""
        return np.where(self.exact & (self.outcome == Outcome.FINE), self.emd, np.nan)

    def _smallest(self) -> float:
        return float(np.fmin.reduce(self._known(), axis=None, initial=np.inf))

    def _limits(self) -> list[float]:
        return [*(factor * self._smallest() for factor in self.factors), *self.thresholds]

    def _run(self, chosen: np.ndarray) -> np.ndarray:
        """Run these motions, and say which lay beyond their bounds: motions near one of those may err as much as it."""
        index, interpolated, bound = np.flatnonzero(chosen), self.emd.copy(), self.bound
        self.emd.ravel()[index], self.outcome.ravel()[index] = self.run(index)
        self.exact |= chosen
        error = np.where(chosen, np.abs(self._known() - interpolated), 0.0)
        beyond = error > bound  # false where either is NaN
        if beyond.any():
            nearby = maximum_filter(
                np.where(beyond, error, 0.0), size=2 * REACH * STRIDE + 1, mode="constant"
            )
            self.first_bound = np.where(
                self.exact, self.first_bound, np.maximum(self.first_bound, nearby)
            )
        return beyond

    def _interpolate(self) -> None:
        """Run the coarser grid and interpolate the motions between, with their bounds."""
        places = [nodes(len(axis)) for axis in self.axes]
        there = np.zeros(self.emd.shape, dtype=bool)
        there[np.ix_(*places)] = True
        self._run(there)
        emd, x = (
            self._known()[np.ix_(*places)],
            [axis[at] for axis, at in zip(self.axes, places, strict=True)],
        )
        rough = maximum_filter(_roughness(emd, x), size=2 * REACH + 1, mode="nearest")
        for k, axis in enumerate(self.axes):
            if len(x[k]) < len(axis):
                emd, rough = _between(emd, k, x[k], axis), _larger(rough, k, x[k], axis)
        self.emd = np.where(self.exact, self.emd, np.clip(emd, 0, 1))
        self.first_bound = np.where(self.exact, 0.0, ROUGHNESS * rough + FLOOR)

    def _settle(self) -> None:
        """Run what may be the smallest or on either side of a limit, until nothing is: limits fall with the smallest."""
        while True:
            bound = self.bound
            settled = self.emd - bound > self._smallest()
            for limit in self._limits():
                settled &= np.abs(self.emd - limit) > bound
            if not (
                chosen := ~settled & ~self.exact
            ).any():  # NaN, beside what could not be computed, is never settled
                return
            self._run(chosen)

    def _check(self) -> None:
        """Try the bounds; those of a class with a motion beyond are doubled, what that opens is run, and they are tried again."""
        rng, doubtful = np.random.default_rng(0), np.ones(len(self.scale), dtype=bool)
        while doubtful.any():
            chosen, kind = self._sample(rng, doubtful), self._class()
            beyond = self._run(chosen)
            tried, bad = (
                np.bincount(kind[of], minlength=len(self.scale)) for of in (chosen, beyond)
            )
            self.tried, self.violations, doubtful = (
                self.tried + tried,
                self.violations + bad,
                bad > 0,
            )
            self.scale[doubtful] *= 2
            self._settle()

    def _sample(self, rng: np.random.Generator, classes: np.ndarray) -> np.ndarray:
        """Interpolated motions of these classes, half of them near a limit."""
        kind, chosen = self._class(), np.zeros(self.emd.shape, dtype=bool)
        gap = np.min([np.abs(self.emd - limit) for limit in self._limits()], axis=0) - self.bound
        for among in (gap < NEAR, gap < np.inf):
            for one in np.flatnonzero(classes):
                there = np.flatnonzero(among & (kind == one) & ~self.exact & ~chosen)
                chosen.ravel()[
                    rng.choice(there, min(CHECKED // len(classes), len(there)), replace=False)
                ] = True
        return chosen

    def reorder(self, places: Sequence[np.ndarray]) -> None:
        """Put the points of each axis where `places` says."""
        at = np.ix_(*places)
        self.axes = [axis[of] for axis, of in zip(self.axes, places, strict=True)]
        self.emd, self.outcome, self.exact, self.first_bound = (
            values[at] for values in (self.emd, self.outcome, self.exact, self.first_bound)
        )

    def attributes(self) -> dict[str, Any]:
        """What the result says of the bounds, by class; `violation_share_below` is the 95 % limit of the share beyond them."""
        from scipy.stats import beta

        tried, bad = (
            np.maximum(self.tried, 1),
            np.minimum(self.violations, np.maximum(self.tried, 1) - 1),
        )
        return {
            "class_from_bound": [0.0, *CLASSES],
            "class_bound_factor": self.scale.tolist(),
            "class_tried": self.tried.tolist(),
            "class_violations": self.violations.tolist(),
            "violation_share_below": beta.ppf(0.95, bad + 1, tried - bad).tolist(),
        }


@dataclass(frozen=True)
class ChosenRows:
    """Some rows of a scan, as rows of their own: what a stage of a scan in two grades runs and keeps."""

    rows: EmdRows
    chosen: np.ndarray

    outputs = EmdRows.outputs

    @property
    def n_rows(self) -> int:
        return len(self.chosen)

    def identity(self) -> dict[str, Any]:
        return self.rows.identity() | {"chosen": bits(self.chosen)}

    def __call__(self, index: np.ndarray) -> dict[str, np.ndarray]:
        return self.rows(self.chosen[index])


def applies(rows: EmdRows) -> bool:
    """Whether a scan may interpolate: many rows, and one wheel that slows down all the time; with several it was not tried.

    Motions near an unstable spin differ from their neighbours. Where wheels keep their momentum these are thin surfaces in the
    grid, which the coarser one does not see; a wheel that slows down carries them over many points, all of which become rough. So
    in each half of the run the wheels must give off more momentum than a motion has REACH nodes of the coarser grid farther on.
    """
    start, vehicle = rows.start, rows.vehicle
    given_off_B = np.zeros((2, 3))
    commands = check_commands(vehicle, rows.wheel_mode)
    for wheel, speed, command in zip(
        vehicle.wheels, start.wheel_speed_rad_s, commands, strict=True
    ):
        times, friction = rows.duration_s * np.array([0.0, 0.5, 1.0]), wheel.friction
        slowed = spin_down_speed(
            friction.coulomb_N_m, friction.viscous_N_m_s, wheel.inertia_kg_m2, speed, times
        )
        given_off_B += np.outer(
            wheel.inertia_kg_m2 * np.diff(slowed) * (command != "hold"), wheel.axis_B
        )
    axes = [
        axis for axis in (start.omega_x, start.omega_y, start.omega_z) if len(axis) >= FEWEST_POINTS
    ]
    step = max((np.diff(np.sort(axis)).max() for axis in axes), default=np.inf)
    apart = REACH * STRIDE * step * np.linalg.eigvalsh(vehicle.require_inertia())[-1]
    enough = bool(np.all(np.linalg.norm(given_off_B, axis=1) >= apart))
    return rows.n_rows >= FEWEST_ROWS and len(vehicle.wheels) == 1 and enough


def in_two_grades(
    rows: EmdRows,
    factors: Sequence[float],
    thresholds: Sequence[float],
    store: str | Path | None = None,
    **settings: Any,
) -> Graded:
    """The grid of `rows` in two grades, in the order of its axes; `settings` as in :func:`sunspin.compute.rows.ensemble`.

    A `store` gets a folder for each stage, so that other limits find there what they share.
    """
    if store is not None and (Path(store) / "zarr.json").exists():
        raise InputError(
            sentence(
                "the store is of a scan that runs each motion",
                do="choose another folder",
                where=str(store),
            )
        )
    start = rows.start
    axes = (start.omega_x, start.omega_y, start.omega_z)
    order = [np.argsort(axis) for axis in axes]
    number = np.arange(rows.n_rows).reshape(start.shape)[np.ix_(*order)].ravel()

    def run(index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        chosen = number[index]
        folder = None if store is None else Path(store) / bits(chosen)[:16]
        out = ensemble(ChosenRows(rows, chosen), store=folder, label="scan", **settings)
        return out["emd"], out["outcome"]

    found = Graded(
        [axis[of] for axis, of in zip(axes, order, strict=True)], factors, thresholds, run
    )
    found.reorder([np.argsort(of) for of in order])
    return found


def nodes(n: int) -> np.ndarray:
    """Places of the coarser grid on an axis of n points; the last is always one."""
    return np.union1d(np.arange(0, n, STRIDE), n - 1) if n >= FEWEST_POINTS else np.arange(n)


def _roughness(emd: np.ndarray, axes: list[np.ndarray]) -> np.ndarray:
    """Difference of each node from the curve through its four neighbours on an axis, the largest over the axes; inf next to NaN."""
    rough = np.zeros(emd.shape)
    for k, x in enumerate(axes):
        if len(x) < 5:
            continue
        inner = np.arange(2, len(x) - 2)
        missed = np.abs(
            _curve(emd, k, inner[:, None] + [-2, -1, 1, 2], x, x[inner])
            - np.take(emd, inner, axis=k)
        )
        part = np.moveaxis(rough, k, 0)[2:-2]
        np.maximum(part, np.moveaxis(missed, k, 0), out=part)
    return np.where(np.isnan(rough), np.inf, rough)


def _curve(
    values: np.ndarray, k: int, nodes: np.ndarray, x: np.ndarray, to: np.ndarray
) -> np.ndarray:
    """Along axis k, at `to` (m): the cubics through the values at `nodes` (m, 4) of x, by Lagrange's weights."""
    near, found = x[nodes], np.zeros(())
    for i in range(4):
        weight = np.ones(len(to))
        for j in {0, 1, 2, 3} - {i}:
            weight *= (to - near[:, j]) / (near[:, i] - near[:, j])
        found = found + np.take(values, nodes[:, i], axis=k) * np.expand_dims(
            weight, [a for a in range(values.ndim) if a != k]
        )
    return found


def _between(values: np.ndarray, k: int, x: np.ndarray, to: np.ndarray) -> np.ndarray:
    """Along axis k, values at nodes x, at `to`: the cubic through the two nodes on either side."""
    first = np.clip(np.searchsorted(x, to, side="right") - 2, 0, len(x) - 4)
    return _curve(values, k, first[:, None] + np.arange(4), x, to)


def _larger(values: np.ndarray, k: int, x: np.ndarray, to: np.ndarray) -> np.ndarray:
    """Along axis k, values at nodes x, at `to`: the larger of the two nodes beside."""
    low, high = np.searchsorted(x, to, side="right") - 1, np.searchsorted(x, to, side="left")
    return np.maximum(np.take(values, low, axis=k), np.take(values, high, axis=k))
