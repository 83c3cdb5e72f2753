"""Body rates at the end of many short runs, forward or backward, by the ensemble kernel."""

from __future__ import annotations

import numpy as np

from sunspin.base.errors import MotionError
from sunspin.dynamics import batch
from sunspin.vehicle import Vehicle

RATE_DIRECTION_ERROR = 1e-9
"""Direction error (rad) at the end that sets the step: rates err by about as much, relatively."""


def end_rates(
    vehicle: Vehicle,
    states: batch.Rows,
    duration_s: float,
    direction_error: float = RATE_DIRECTION_ERROR,
    wheel_mode: str = "coast",
) -> np.ndarray:
    """Body rates (n, 3) in rad/s, B, when each of the states (n) has moved for `duration_s` (negative: backward).

    `direction_error` (rad) of the Sun at the end sets the step; `wheel_mode` is the command of the wheels.

    Raises
    ------
    MotionError
        A motion that cannot be followed, such as one back through the time in which friction holds a wheel.
    """
    if len(states) == 0:
        return np.zeros((0, 3))
    return rates_at_end(
        batch.run(vehicle, states, float(duration_s), command=wheel_mode, error=direction_error)
    )


def rates_at_end(run: batch.Motion) -> np.ndarray:
    """Body rates (n, 3) in rad/s at the last time of a run; `MotionError` if a motion could not be followed."""
    if np.any(run.outcome != batch.Outcome.FINE):
        what = batch.OUTCOME_TEXT[batch.Outcome(int(run.outcome.max()))]
        raise MotionError("a motion could not be followed", got=what)
    return run.omega_B[:, -1]
