"""Body rates at the end of many short runs, forward or backward, by the ensemble kernel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sunspin.base.errors import MotionError
from sunspin.dynamics import ensemble as k
from sunspin.estimate.scan.rows import Start
from sunspin.vehicle import Vehicle

RATE_DIRECTION_ERROR = 1e-9
"""Direction error (rad) at the end that sets the step: rates err by about as much, relatively."""


def end_rates(
    vehicle: Vehicle,
    states: k.Rows,
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
    run = k.run_rows(
        vehicle, states, float(duration_s), wheel_mode=wheel_mode, direction_error=direction_error
    )
    if np.any(run.outcome != k.Outcome.FINE):
        raise MotionError(
            "a motion could not be followed", got=k.OUTCOME_TEXT[k.Outcome(int(run.outcome.max()))]
        )
    return run.omega_B[:, 0]


@dataclass(frozen=True)
class EndSpeedRows:
    """Row -> angular speed (rad/s) of a motion of the grid after `duration_s`."""

    vehicle: Vehicle
    start: Start
    duration_s: float
    direction_error: float = RATE_DIRECTION_ERROR
    wheel_mode: str = "coast"

    outputs = {"speed": ("float64", ())}

    @property
    def n_rows(self) -> int:
        return len(self.start)

    def __call__(self, index: np.ndarray) -> dict[str, np.ndarray]:
        omega = end_rates(
            self.vehicle,
            self.start.take(index),
            self.duration_s,
            self.direction_error,
            self.wheel_mode,
        )
        return {"speed": np.linalg.norm(omega, axis=1)}
