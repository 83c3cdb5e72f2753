"""What a wheel is told to do (its command, over time) and what it does (turn freely, be stuck, be held by its motor).

Sticking and breaking away follow Coulomb's law as in the paper, eq. (6): a wheel at rest on the body stays at rest as long as
the torque that this needs is within the friction limit; beyond it the wheel slips against the torque that was needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from sunspin.base.errors import MotionError
from sunspin.dynamics import gyrostat as g
from sunspin.solve.linear import symmetric_inverse
from sunspin.vehicle import Vehicle, Wheel

COMMANDS = ("coast", "hold", "brake")
Schedule = tuple[tuple[float, str], ...]  # (from this time on, this command), times increasing


def mode_before(wheel_speed_rad_s: np.ndarray) -> str:
    """The command under which motions with these speeds of the wheels (n, n_wheels) are run backward, where nothing else is known:
    wheels at rest are taken to have stood still, since friction that holds a wheel forgets how it came to rest."""
    return "coast" if np.any(wheel_speed_rad_s) else "hold"


class Turning(Enum):
    """How a wheel moves relative to the body."""

    FREE = "turns freely"
    STUCK = "is stuck by friction"
    HELD = "is held at its speed by the motor"


@dataclass(frozen=True)
class WheelState:
    """One wheel between two events: how it turns, its speed (held or stuck), the sign and friction limit that apply."""

    turning: Turning
    command: str
    speed: float  # rad/s at the start of the interval
    sign: float  # of the speed, for the friction law; 0 where there is no dry friction
    limit: float  # N m, dry friction (and brake) that can hold the wheel
    watch_from: float | None = (
        None  # s; a wheel that has just begun to slip is watched for a stop only from here on
    )


def schedules(vehicle: Vehicle, wheel_mode: Any) -> tuple[Schedule, ...]:
    """One schedule per wheel from the public argument: a command, a schedule, or one of either per wheel."""
    n = len(vehicle.wheels)
    if isinstance(wheel_mode, str) or _is_schedule(wheel_mode):
        return (_schedule(wheel_mode, vehicle.wheels),) * n
    if isinstance(wheel_mode, Sequence) and len(wheel_mode) == n:
        return tuple(
            _schedule(item, (wheel,))
            for item, wheel in zip(wheel_mode, vehicle.wheels, strict=True)
        )
    raise MotionError(
        "wheel_mode must be a command, a schedule [(t_s, command), ...] or one of these per wheel",
        got=wheel_mode,
        do=f"the vehicle has {n} wheel(s)",
    )


def _is_schedule(item: Any) -> bool:
    return (
        isinstance(item, Sequence)
        and len(item) > 0
        and all(isinstance(e, Sequence) and not isinstance(e, str) and len(e) == 2 for e in item)
        and all(isinstance(e[1], str) and not isinstance(e[0], str | Sequence) for e in item)
    )


def _schedule(item: Any, wheels: Sequence[Wheel]) -> Schedule:
    if isinstance(item, str):
        entries: Schedule = ((-np.inf, item),)
    elif _is_schedule(item):
        entries = tuple((float(t), str(command)) for t, command in item)
    else:
        raise MotionError("a wheel's mode must be a command or a schedule", got=item)
    times = [t for t, _ in entries]
    if (
        any(not later > earlier for earlier, later in zip(times, times[1:], strict=False))
        or np.isnan(times).any()
    ):
        raise MotionError("the times of a wheel schedule must increase", got=times)
    for _, command in entries:
        if command not in COMMANDS:
            raise MotionError(f"wheel mode must be one of {', '.join(COMMANDS)}", got=command)
        if command == "brake":
            for wheel in wheels:
                if wheel.brake_torque_N_m is None:
                    raise MotionError(
                        f"wheel {wheel.name!r} has no brake",
                        do="add brake_torque_N_m to it in the vehicle file",
                    )
    return entries


def command_at(schedule: Schedule, t: float) -> str:
    """The command in force at time t; before the first entry the first one holds."""
    current = schedule[0][1]
    for start, command in schedule:
        if start <= t:
            current = command
    return current


def switch_times(all_schedules: Sequence[Schedule], t_from: float, t_to: float) -> list[float]:
    """Times strictly inside (t_from, t_to) at which some command changes, in the order in which the run meets them."""
    low, high = sorted((t_from, t_to))
    times = {t for schedule in all_schedules for t, _ in schedule if low < t < high}
    return sorted(times, reverse=bool(t_to < t_from))


def state_under(
    wheel: Wheel, command: str, speed: float, coulomb_N_m: float | None = None
) -> WheelState:
    """How a wheel of this speed turns under a command; one at rest counts as stuck until `settle` has judged it."""
    limit = float(friction_limit(wheel, command, coulomb_N_m))
    if command == "hold":
        return WheelState(Turning.HELD, command, speed, 0.0, 0.0)
    if speed == 0.0 and limit > 0:
        return WheelState(Turning.STUCK, command, 0.0, 0.0, limit)
    return WheelState(Turning.FREE, command, speed, float(np.sign(speed)), limit)


def friction_limit(wheel: Wheel, command: str, coulomb_N_m: Any = None) -> Any:
    """Dry torque (N m) that opposes the wheel: Coulomb friction (the wheel's, or another), and the brake where it is on."""
    coulomb = wheel.friction.coulomb_N_m if coulomb_N_m is None else coulomb_N_m
    return coulomb + (wheel.brake_torque_N_m or 0.0 if command == "brake" else 0.0)


def parameters(
    vehicle: Vehicle, states: Sequence[WheelState], outside: tuple[g.OutsideTorque, ...] = ()
) -> g.Parameters:
    """Numbers for :func:`sunspin.dynamics.gyrostat.rhs` in this combination of wheel states."""
    free = [state.turning is Turning.FREE for state in states]
    held = np.zeros(3)
    wheels = []
    for wheel, state, is_free in zip(vehicle.wheels, states, free, strict=True):
        if not is_free:
            held += wheel.inertia_kg_m2 * state.speed * wheel.axis_B
        wheels.append(
            g.WheelParameters(
                tuple(wheel.axis_B.tolist()),
                1.0 / wheel.inertia_kg_m2,
                float(is_free),
                state.sign * state.limit,
                wheel.friction.viscous_N_m_s,
            )
        )
    inverse = tuple(symmetric_inverse(g.free_inertia(vehicle, free)).tolist())
    return g.Parameters(inverse, tuple(held.tolist()), tuple(wheels), outside)


def settle(
    vehicle: Vehicle,
    H: np.ndarray,
    states: Sequence[WheelState],
    h: np.ndarray,
    outside: tuple[g.OutsideTorque, ...],
    directions: g.Directions,
    t_s: float,
) -> tuple[WheelState, ...]:
    """Decide which of the wheels at rest (turning STUCK) stay stuck; those that cannot begin to slip.

    Stuck wheels couple, so the one that is most overloaded is released first and the others are judged again.
    """
    states = tuple(states)
    while True:
        worst, worst_ratio, worst_torque = -1, 1.0, 0.0
        p = parameters(vehicle, states, outside)
        for i, (wheel, state) in enumerate(zip(vehicle.wheels, states, strict=True)):
            if state.turning is not Turning.STUCK:
                continue
            torque = g.holding_torque(H, h, p, p.wheels[i], wheel.inertia_kg_m2, directions, t_s)
            if abs(torque) > worst_ratio * state.limit:
                worst, worst_ratio, worst_torque = i, abs(torque) / state.limit, torque
        if worst < 0:
            return states
        slipping = WheelState(
            Turning.FREE,
            states[worst].command,
            0.0,
            -float(np.sign(worst_torque)),
            states[worst].limit,
        )
        states = states[:worst] + (slipping,) + states[worst + 1 :]
