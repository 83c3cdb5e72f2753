"""Body rates at the end of many short runs, forward or backward, by the ensemble kernel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sunspin.errors import MotionError, sentence
from sunspin.infer.identity import code, plain
from sunspin.infer.rows import Start
from sunspin.motion import gyrostat as g
from sunspin.motion import kernel as k
from sunspin.motion import modes as m
from sunspin.motion.friction import spin_down_time
from sunspin.vehicle import Vehicle

RATE_DIRECTION_ERROR = 1e-9
"""Direction error (rad) at the end that sets the step: rates err by about as much, relatively."""


def end_rates(vehicle: Vehicle, states: k.Rows, duration_s: float) -> np.ndarray:
    """Body rates (n, 3) in rad/s, B, when each of the states (n) has coasted for `duration_s` (negative: backward).

    For runs in which no wheel stops or starts, such as those of the minute between the touchdown and the first sample; others
    are refused, as what is free or held decides how the rate follows from the momenta (paper, eq. 3).
    """
    n_wheel, first = len(vehicle.wheels), states.wheel_speed_rad_s
    if len(states) == 0:
        return np.zeros((0, 3))
    _refuse_stops(vehicle, states, duration_s)
    run = k.run_rows(vehicle, states, np.array([float(duration_s)]), direction_error=RATE_DIRECTION_ERROR)
    end = run.track[:, 0]
    kinds = [m.state_under(wheel, "coast", float(speed)) for wheel, speed in zip(vehicle.wheels, first[0], strict=True)]
    p = m.parameters(vehicle, kinds)
    h = [end[:, 3 + i] for i in range(n_wheel)]
    omega = np.stack(np.broadcast_arrays(*g.body_rate(end[:, :3].T, h, p)), axis=-1)
    if np.any(run.outcome != k.Outcome.FINE):
        raise MotionError(sentence("a motion could not be computed", got=str(k.Outcome(int(run.outcome.max())))))
    return omega


def _refuse_stops(vehicle: Vehicle, states: k.Rows, duration_s: float) -> None:
    """Wheels must stay faster than anything the body can do to them: it turns at |H| over its least moment at most."""
    momentum = np.linalg.norm(g.total_momentum(vehicle, states.omega_B, states.wheel_speed_rad_s), axis=1).max()
    body = 2 * momentum / float(np.linalg.eigvalsh(vehicle.require_inertia())[0])
    for wheel, speeds in zip(vehicle.wheels, np.abs(states.wheel_speed_rad_s).T, strict=True):
        slowest = float(speeds.min())
        if duration_s > 0 and slowest > 0:
            late = duration_s >= spin_down_time(wheel.friction, wheel.inertia_kg_m2, slowest)
            slowest *= 0.0 if late else np.exp(-wheel.friction.viscous_N_m_s / wheel.inertia_kg_m2 * duration_s)
            slowest -= 0.0 if late else wheel.friction.coulomb_N_m / wheel.inertia_kg_m2 * duration_s
        if slowest <= body:
            raise MotionError(
                sentence("a wheel may stop or start within the run", got=f"{duration_s:g} s", do="use propagate for each motion")
            )


@dataclass(frozen=True)
class EndSpeedRows:
    """Row -> angular speed (rad/s) of a motion of the grid after `duration_s`."""

    vehicle: Vehicle
    start: Start
    duration_s: float

    outputs = {"speed": ("float64", ())}

    @property
    def n_rows(self) -> int:
        return len(self.start)

    def identity(self) -> dict[str, Any]:
        return {
            **code(), "rows": "angular speed at the end", "vehicle": plain(self.vehicle), "start": plain(self.start),
            "duration_s": float(self.duration_s), "direction_error": RATE_DIRECTION_ERROR,
        }  # fmt: skip

    def __call__(self, index: np.ndarray) -> dict[str, np.ndarray]:
        omega = end_rates(self.vehicle, self.start.take(index), self.duration_s)
        return {"speed": np.linalg.norm(omega, axis=1)}
