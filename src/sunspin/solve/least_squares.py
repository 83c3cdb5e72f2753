"""Damped least squares on many problems at once, each with its own damping and its own stop.

Levenberg's and Marquardt's method (Marquardt 1963, J. Soc. Indust. Appl. Math. 11, 431): a step solves the normal equations with
something added to their diagonal; a step that lowers the cost is taken and the damping falls, any other is dropped and the damping
grows. The caller linearises, derivatives included, and moves a state by a step, on whatever manifold it lives; the linear solver is
:func:`sunspin.solve.linear.solve_dense`, :func:`sunspin.solve.linear.solve_bordered` or the caller's. What is decided about a problem depends
on that problem alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

FIRST_DAMPING, DAMPING_DECREASE, DAMPING_INCREASE = 1e-3, 0.2, 8.0
"""Damping of a first step; by what it is multiplied after a step that lowered the cost, and after one that did not."""

CONVERGED_DAMPING, MAX_DAMPING = 0.1, 1e6
"""A small gain is promised in earnest only where the damping is below the first; above the second, no step lowers the cost."""

TOLERANCE = 1e-4
"""A step that promises a smaller gain in cost is the last. Where the cost is minus the logarithm of a density, that is 0.014 sigma.
What a step did gain says less: in a bent valley many small gains follow each other."""


class Stop(IntEnum):
    """Why a problem stopped."""

    STEPS = 0
    """It did not: the steps ran out."""
    ARRIVED = 1
    """Its last step promised to gain less than the tolerance."""
    STUCK = 2
    """No step lowers its cost, however short."""
    LOST = 3
    """Its start has no finite cost."""


class Solution(NamedTuple):
    """`state` and `system` as the caller gives them, at the lowest cost that was met; `stop` (K): why each problem stopped."""

    state: Any
    system: Any
    stop: np.ndarray


def least_squares(
    linearise: Callable[[Any], Any],
    retract: Callable[[Any, Any], Any],
    solver: Callable[[Any, np.ndarray], tuple[Any, np.ndarray]],
    state: Any,
    *,
    steps: int,
    tolerance: float = TOLERANCE,
    system: Any = None,
    limit: Callable[[Any], Any] | None = None,
    longest: Callable[[Any, Any], np.ndarray] | None = None,
    carry: Callable[[Any, Any], Any] | None = None,
) -> Solution:
    """The nearest minima of K costs.

    States, systems and steps are arrays whose first axis is the problem, or (named) tuples of such, or None. Functions are called
    with those problems that still go on, and must not change what they are given: what a problem has of its own (its readings, say)
    belongs into its state.

    Parameters
    ----------
    linearise : state -> system
        Costs and normal equations; `system.cost` (K) is read here, the rest by the solver. A cost that is not finite refuses the
        state.
    retract : (state, step) -> state
        The state moved by a step.
    solver : (system, damping) -> (step, gain)
        Steps under damping (K), and by how much they lower the cost (K) where it is quadratic. A step that is not finite is not
        taken.
    state
        Starts.
    steps : int
        Trials of a problem, at most.
    tolerance : float
        A problem ends with a step that promises to gain less, in the unit of its cost.
    system : optional
        The starts linearised, if the caller has that.
    limit : state -> state, optional
        Draws a trial state back to what is allowed.
    longest : (state, step) -> (K), optional
        How many times too long a step is; those that are get shortened as a whole.
    carry : (state, system) -> state, optional
        A trial state with what it takes over from its own system, such as derivatives that steps correct.

    Returns
    -------
    Solution
    """
    system = linearise(state) if system is None else system
    damping = np.full(len(system.cost), FIRST_DAMPING)
    going, stop = np.isfinite(system.cost), np.full(len(system.cost), Stop.STEPS)
    stop[~going] = Stop.LOST
    for _ in range(steps):
        on = np.flatnonzero(going)
        if not len(on):
            break
        here, there = _take_sorted(state, on), _take_sorted(system, on)
        step, gain = solver(there, damping[on])
        step, fine = _zero_if_not_finite(step)
        if longest is not None:
            times = np.maximum(longest(here, step), 1.0)
            step = _map_arrays(lambda part, by: part / _as_column(by, part), step, times)
        trial = retract(here, step)
        trial = trial if limit is None else limit(trial)
        new = linearise(trial)
        trial = trial if carry is None else carry(trial, new)
        better = fine & np.isfinite(new.cost) & (new.cost < there.cost)
        arrived = fine & (gain < tolerance) & (damping[on] <= CONVERGED_DAMPING)
        damping[on] *= np.where(better, DAMPING_DECREASE, DAMPING_INCREASE)
        stuck = ~better & (damping[on] > MAX_DAMPING)
        stop[on[arrived]], stop[on[stuck]] = Stop.ARRIVED, Stop.STUCK
        going[on] = ~(arrived | stuck)
        state, system = (
            _replace_problems(old, on[better], _take_sorted(got, np.flatnonzero(better)))
            for old, got in ((state, trial), (system, new))
        )
    return Solution(state, system, stop)


def limit_length(vector: np.ndarray, limit: float) -> np.ndarray:
    """Vectors (..., d) no longer than `limit`, as a limit of states."""
    size = np.linalg.norm(vector, axis=-1, keepdims=True)
    return vector * np.minimum(1.0, limit / np.maximum(size, 1e-300))


def take_problems(tree: Any, rows: np.ndarray) -> Any:
    """Some problems of states, systems or steps."""
    return _map_arrays(lambda part: part[rows], tree)


def _arrays(tree: Any) -> Iterator[np.ndarray]:
    if isinstance(tree, tuple):
        for part in tree:
            yield from _arrays(part)
    elif tree is not None:
        yield tree


def _map_arrays(function: Callable[..., Any], tree: Any, *more: Any) -> Any:
    """A function on each array of a tree; `more` are handed on."""
    if tree is None:
        return None
    if not isinstance(tree, tuple):
        return function(tree, *more)
    parts = [_map_arrays(function, part, *more) for part in tree]
    return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)


def _take_sorted(tree: Any, rows: np.ndarray) -> Any:
    """The same for rising rows, without a copy where they are all."""
    return _map_arrays(lambda part: part if len(rows) == len(part) else part[rows], tree)


def _replace_problems(tree: Any, rows: np.ndarray, other: Any) -> Any:
    """The tree with some rows replaced; nothing that was handed in is changed."""
    if isinstance(tree, tuple):
        parts = [
            _replace_problems(part, rows, value) for part, value in zip(tree, other, strict=True)
        ]
        return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
    if tree is None or len(rows) == len(tree):
        return other
    whole = np.array(tree)
    whole[rows] = other
    return whole


def _as_column(values: np.ndarray, like: np.ndarray) -> np.ndarray:
    return values.reshape(-1, *(1,) * (like.ndim - 1))


def _zero_if_not_finite(step: Any) -> tuple[Any, np.ndarray]:
    """Steps with zero in place of those that are not finite, and which are (K)."""
    fine = np.logical_and.reduce(
        [np.isfinite(part).reshape(len(part), -1).all(axis=1) for part in _arrays(step)]
    )
    if not fine.all():
        step = _map_arrays(lambda part: np.where(_as_column(fine, part), part, 0.0), step)
    return step, fine
