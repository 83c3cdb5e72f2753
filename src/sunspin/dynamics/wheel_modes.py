"""Commands to wheels over time, and the limit of dry friction under them.

Under "hold" a motor keeps the speed. Under "coast" only friction acts, and under "brake" also the brake of the vehicle file.
What a wheel then does (turn freely, stick, break away, reverse) is computed in :mod:`sunspin.dynamics.kernels.wheels`.

The public argument `wheel_mode` gives commands. The *mode* of the kernels is something else: which wheels turn freely at present.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sunspin.base.errors import MotionError
from sunspin.vehicle import Vehicle, Wheel

COMMANDS = ("coast", "hold", "brake")
# entries (time, command), times increasing: the command from that time on
Schedule = tuple[tuple[float, str], ...]


def mode_before(wheel_speed_rad_s: np.ndarray) -> str:
    """Return the command with which motions that have these wheel speeds (n, n_wheel) are run backward, if nothing else is known.

    If all wheels are at rest they are assumed to have been at rest before: the motion does not determine when they stopped.
    """
    return "coast" if np.any(wheel_speed_rad_s) else "hold"


def schedules(vehicle: Vehicle, wheel_mode: Any) -> tuple[Schedule, ...]:
    """Return one schedule per wheel, from the public argument: a command, a schedule, or one of either per wheel."""
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
    """Return whether `item` is a list of pairs (number, text)."""
    return (
        isinstance(item, Sequence)
        and len(item) > 0
        and all(isinstance(e, Sequence) and not isinstance(e, str) and len(e) == 2 for e in item)
        and all(isinstance(e[1], str) and not isinstance(e[0], str | Sequence) for e in item)
    )


def _schedule(item: Any, wheels: Sequence[Wheel]) -> Schedule:
    """Return a command, or a list of pairs, as a schedule for `wheels`; MotionError if they cannot follow it."""
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
    """Return the command in force at time t; before the first entry it is that of the first."""
    current = schedule[0][1]
    for start, command in schedule:
        if start <= t:
            current = command
    return current


def switch_times(all_schedules: Sequence[Schedule], t_from: float, t_to: float) -> list[float]:
    """Return the times strictly between `t_from` and `t_to` at which a command changes, in the order of a run between them."""
    low, high = sorted((t_from, t_to))
    times = {t for schedule in all_schedules for t, _ in schedule if low < t < high}
    return sorted(times, reverse=bool(t_to < t_from))


def friction_limit(wheel: Wheel, command: str, coulomb_N_m: Any = None) -> Any:
    """Return the limit of dry friction (N m): Coulomb friction (the wheel's own unless given), plus the brake if it is on."""
    coulomb = wheel.friction.coulomb_N_m if coulomb_N_m is None else coulomb_N_m
    return coulomb + (wheel.brake_torque_N_m or 0.0 if command == "brake" else 0.0)
