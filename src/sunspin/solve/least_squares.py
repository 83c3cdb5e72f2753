"""Damped least squares for many problems at once, each with its own damping and stopping.

Levenberg-Marquardt (Marquardt 1963, J. Soc. Indust. Appl. Math. 11, 431): a step solves the normal equations with a damping
term on their diagonal. If the step lowers the cost, it is taken and the damping decreases; else it is dropped and the damping
increases.

The caller linearises a state, with derivatives, and moves it by a step on its own manifold. The linear solver is
:func:`sunspin.solve.linear.solve_dense`, :func:`sunspin.solve.linear.solve_bordered` or the caller's. The result of a problem
does not depend on the others in the batch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

FIRST_DAMPING, DAMPING_DECREASE, DAMPING_INCREASE = 1e-3, 0.2, 8.0
"""Damping of the first step, and its factors after a step that lowered the cost and one that did not."""

CONVERGED_DAMPING, MAX_DAMPING = 0.1, 1e6
"""A small predicted gain ends a problem only below the first damping; above the second no step lowers the cost."""

TOLERANCE = 1e-4
"""Predicted gain in cost below which a step is the last: 0.014 sigma if the cost is a negative log density.
The achieved gain is no criterion: along a curved valley many small gains follow each other."""


class Stop(IntEnum):
    """Reason why a problem stopped."""

    STEP_LIMIT = 0
    """Not converged within the allowed number of steps."""
    CONVERGED = 1
    """The predicted gain of its last step was below the tolerance."""
    NO_DESCENT = 2
    """No step lowers its cost, however short."""
    INVALID_START = 3
    """Its start has no finite cost."""


class Solution(NamedTuple):
    """State and system of each problem at its lowest cost, in the form given by the caller, and the reason to `stop` (K)."""

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
    length_ratio: Callable[[Any, Any], np.ndarray] | None = None,
    keep: Callable[[Any, Any], Any] | None = None,
) -> Solution:
    """Return a local minimum of each of K costs, by damped Gauss-Newton steps from given starts.

    States, systems and steps are arrays whose first axis is the problem, or (named) tuples of such arrays, or None. The
    functions below are called with the problems that are still running only, and must not change their arguments. Data of a
    single problem, such as its readings, therefore belong in its state.

    Parameters
    ----------
    linearise : state -> system
        Costs and normal equations. `system.cost` (K) is read here, the rest by the solver. A state whose cost is not finite is
        rejected.
    retract : (state, step) -> state
        The state moved by a step.
    solver : (system, damping) -> (step, gain)
        Steps under damping (K), and the decrease of the cost (K) predicted by its quadratic model. A step that is not finite is
        rejected.
    state
        Starts.
    steps : int
        Largest number of trial steps of a problem.
    tolerance : float
        A problem ends with a step whose predicted gain is smaller, in the unit of its cost.
    system : optional
        The linearised starts, if the caller has them.
    limit : state -> state, optional
        Projects a trial state onto the allowed states.
    length_ratio : (state, step) -> (K), optional
        Ratio of the length of a step to the longest allowed; a step with a ratio above one is shortened as a whole.
    keep : (state, system) -> state, optional
        Copies into a trial state what it keeps of its own system, such as derivatives that later steps update.

    Returns
    -------
    Solution
    """
    system = linearise(state) if system is None else system
    damping = np.full(len(system.cost), FIRST_DAMPING)
    running, stop = np.isfinite(system.cost), np.full(len(system.cost), Stop.STEP_LIMIT)
    stop[~running] = Stop.INVALID_START
    for _ in range(steps):
        active = np.flatnonzero(running)
        if not len(active):
            break
        active_state, active_system = _take_sorted(state, active), _take_sorted(system, active)
        step, gain = solver(active_system, damping[active])
        step, finite = _zero_if_not_finite(step)
        if length_ratio is not None:
            excess = np.maximum(length_ratio(active_state, step), 1.0)
            step = _map_arrays(lambda part, by: part / _as_column(by, part), step, excess)
        trial = retract(active_state, step)
        trial = trial if limit is None else limit(trial)
        new = linearise(trial)
        trial = trial if keep is None else keep(trial, new)
        # of the active problems: the step is taken; it was the last because little can be gained, or because no step helps
        better = finite & np.isfinite(new.cost) & (new.cost < active_system.cost)
        # under strong damping a predicted gain is small because the step is short
        converged = finite & (gain < tolerance) & (damping[active] <= CONVERGED_DAMPING)
        damping[active] *= np.where(better, DAMPING_DECREASE, DAMPING_INCREASE)
        no_descent = ~better & (damping[active] > MAX_DAMPING)
        stop[active[converged]], stop[active[no_descent]] = Stop.CONVERGED, Stop.NO_DESCENT
        running[active] = ~(converged | no_descent)
        improved = np.flatnonzero(better)
        state = replace_problems(state, active[better], _take_sorted(trial, improved))
        system = replace_problems(system, active[better], _take_sorted(new, improved))
    return Solution(state, system, stop)


def limit_length(vector: np.ndarray, limit: float) -> np.ndarray:
    """Return vectors (..., d), those longer than `limit` shortened to it; for functions `limit` of :func:`least_squares`."""
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return vector * np.minimum(1.0, limit / np.maximum(length, 1e-300))


def take_problems(tree: Any, rows: np.ndarray) -> Any:
    """Return some problems (rows) of states, systems or steps."""
    return _map_arrays(lambda part: part[rows], tree)


def join_problems(parts: Sequence[Any]) -> Any:
    """Return the problems of several states, systems or steps of the same form, one after another."""
    first = parts[0]
    if not isinstance(first, tuple):
        return None if first is None else np.concatenate(parts)
    joined = [join_problems(some) for some in zip(*parts, strict=True)]
    return type(first)(*joined) if hasattr(first, "_fields") else tuple(joined)


def _arrays(tree: Any) -> Iterator[np.ndarray]:
    """Yield the arrays of a state, system or step."""
    if isinstance(tree, tuple):
        for part in tree:
            yield from _arrays(part)
    elif tree is not None:
        yield tree


def _map_arrays(function: Callable[..., Any], tree: Any, *arguments: Any) -> Any:
    """Apply a function to each array of a (nested) tuple of arrays; further arguments are passed on."""
    if tree is None:
        return None
    if not isinstance(tree, tuple):
        return function(tree, *arguments)
    parts = [_map_arrays(function, part, *arguments) for part in tree]
    return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)


def _take_sorted(tree: Any, rows: np.ndarray) -> Any:
    """Return the problems `rows`, which are in increasing order, without a copy if these are all problems."""
    return _map_arrays(lambda part: part if len(rows) == len(part) else part[rows], tree)


def replace_problems(tree: Any, rows: np.ndarray, new: Any) -> Any:
    """Return a copy in which the problems `rows` (in increasing order) have the values of `new`; `new` itself if these are all."""
    if isinstance(tree, tuple):
        parts = [replace_problems(part, rows, value) for part, value in zip(tree, new, strict=True)]
        return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
    if tree is None or len(rows) == len(tree):
        return new
    replaced = np.array(tree)
    replaced[rows] = new
    return replaced


def _as_column(values: np.ndarray, like: np.ndarray) -> np.ndarray:
    """Return values (K) with trailing axes of length one, to be broadcast against `like` (K, ...)."""
    return values.reshape(-1, *(1,) * (like.ndim - 1))


def _zero_if_not_finite(step: Any) -> tuple[Any, np.ndarray]:
    """Return steps with zero for those that are not finite, and which are finite (K)."""
    finite = np.logical_and.reduce(
        [np.isfinite(part).reshape(len(part), -1).all(axis=1) for part in _arrays(step)]
    )
    if not finite.all():
        step = _map_arrays(lambda part: np.where(_as_column(finite, part), part, 0.0), step)
    return step, finite
