"""The reference propagator: one trajectory to machine precision, forward or backward, with wheel events.

Between events the system is smooth and integrated by Taylor's method (:mod:`sunspin.dynamics.taylor`); a wheel that stops,
breaks away or reverses, and a change of command, end one smooth piece and begin the next (:mod:`sunspin.dynamics.wheel_modes`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.base.errors import MotionError
from sunspin.base.provenance import provenance
from sunspin.dynamics import gyrostat as g
from sunspin.dynamics import wheel_modes as m
from sunspin.dynamics.bodies import Bodies
from sunspin.dynamics.taylor import integrator, parameter_values
from sunspin.dynamics.torques import NOTHING, Acting, Steady, acting
from sunspin.dynamics.torques.acting import OWN, PER_DIRECTION, directions_of, needed, outside
from sunspin.environment import Environment
from sunspin.environment.frames import BODY_AT_START
from sunspin.vehicle import Vehicle

SUN_LENGTH_TOLERANCE = 1e-3
"""A direction to the Sun printed to three or four digits is taken as it is; beyond this it is an error."""

TAKE_OFF_ANGLE = 1e-3
"""rad that the body turns while a wheel that begins to slip gathers speed; only then its speed is told from rounding."""

ROUNDING_SPEED = 1e-9
"""rad/s; a slipping wheel slower than this has just begun to."""

MAX_RATE = 1e6
"""rad/s; a body or wheel said to turn faster is a slip of units."""

PIECE_ANGLE = 1e4
"""rad turned by momentum over the smallest moment of inertia, at most, in one piece: bounds the memory of dense output."""

MAX_EVENTS = 100_000
"""Wheel events in one run; more means that the wheel chatters and the run would not end."""


@dataclass
class _Run:
    """The state of a run between pieces: time, y = (H, h, r, what torques carry, q), the wheels, the events so far."""

    vehicle: Vehicle
    t: float
    y: np.ndarray
    wheels: tuple[m.WheelState, ...]
    backward: bool
    stopped_at: tuple[float | None, ...]
    events: list[tuple[float, str, str]]
    pending: int | None = None  # event that ended the last piece
    acting: Acting = NOTHING
    outside_values: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def momentum(self) -> np.ndarray:
        return self.y[:3]

    @property
    def axial(self) -> np.ndarray:
        return self.y[3 : 3 + len(self.wheels)]

    @property
    def outside(self) -> tuple[g.OutsideTorque, ...]:
        return outside(self.acting.torques, self.outside_values)

    @property
    def directions(self) -> g.Directions:
        return directions_of(self.acting.torques, self.y[3 + len(self.wheels) : -4])

    def settled(self) -> tuple[m.WheelState, ...]:
        """The wheels, those let go that friction cannot hold."""
        return m.settle(
            self.vehicle,
            self.momentum,
            self.wheels,
            self.axial,
            self.outside,
            self.directions,
            self.t,
        )

    def note(self, wheel: int, what: str) -> None:
        self.events.append((self.t, self.vehicle.wheels[wheel].name, what))


def propagate(
    vehicle: Vehicle,
    omega_B: npt.ArrayLike,
    sun_B: npt.ArrayLike,
    wheel_speed_rad_s: npt.ArrayLike | None,
    t_s: npt.ArrayLike,
    wheel_mode: Any = "coast",
    stopped_at_s: float | Sequence[float | None] | None = None,
    rtol: float = 1e-12,
    *,
    environment: Environment | None = None,
    torques: Sequence[str | Steady] = (),
    B_from_N: npt.ArrayLike | None = None,
) -> xr.Dataset:
    """Rotation of `vehicle` from the state given at ``t_s[0]``, on all of `t_s` (paper, eqs. 3-7), and under torques.

    Parameters
    ----------
    vehicle : Vehicle
    omega_B : (3,) rad/s
        Body rate at ``t_s[0]``, body axes.
    sun_B : (3,)
        Direction to the Sun at ``t_s[0]``, body axes; used as given, its length must be 1 to three digits.
    wheel_speed_rad_s : (n_wheel,) or a number or None
        Wheel speeds relative to the body at ``t_s[0]``.
    t_s : (n_time,) s
        Strictly increasing, or strictly decreasing for a run backward in time.
    wheel_mode : str, schedule, or one per wheel
        ``"coast"`` (friction only), ``"hold"`` (a motor keeps the speed), ``"brake"`` (torque in the vehicle file, then
        stuck), or ``[(t_s, mode), ...]``: each mode from its time on.
    stopped_at_s : number, optional
        When a wheel that is stuck had stopped (one value per wheel where there are several). Sticking forgets the past, so
        a run backward out of a stuck phase needs it.
    rtol : float
        Relative error wanted over the run, down to 1e-13.
    environment : Environment, optional
        What surrounds the body, such as :func:`sunspin.environment.circular`, on the clock of `t_s`.
    torques : list, optional
        Names of torques that act on the body (`sunspin.dynamics.torques.TORQUES`), or steady ones (`Steady` there).
    B_from_N : (4,), optional
        Attitude at ``t_s[0]``, scalar last, from the environment's N; the body's axes at ``t_s[0]`` are N unless given.

    Returns
    -------
    xarray.Dataset
        On `time`: `omega_B` (rad/s), `sun_B`, `wheel_speed_rad_s`, `momentum_B` (N m s), `B_from_N` (quaternion, scalar
        last; N is B at ``t_s[0]``, or the environment's), and `nadir_B` where a torque needs it. On `event`: `event_time_s`,
        `event_wheel`, `event_what`.

    Raises
    ------
    MotionError
        Bad arguments, a past that the data do not determine, or a torque without the environment that it needs.
    """
    t = _times(t_s)
    forces = acting(torques, environment, t[0])
    run, plan = _start(
        vehicle, omega_B, sun_B, wheel_speed_rad_s, t, wheel_mode, stopped_at_s, forces, B_from_N
    )
    ta = integrator(len(vehicle.wheels), forces.torques, _tolerance(rtol))
    y = np.empty((t.size, run.y.size))
    omega = np.empty((t.size, 3))
    speeds = np.empty((t.size, len(vehicle.wheels)))
    y[0] = run.y
    omega[0], speeds[0] = _vector(omega_B, "omega_B"), [w.speed for w in run.wheels]
    filled = 1
    stops = [*m.switch_times(plan, t[0], t[-1]), t[-1]] if t.size > 1 else []
    for t_stop in stops:
        _command(run, plan, (run.t + t_stop) / 2)
        while run.t != t_stop:
            dense = _piece(run, ta, t_stop)
            done = t >= run.t if run.backward else t <= run.t
            inside = slice(filled, max(filled, int(np.count_nonzero(done))))
            if dense is not None and inside.stop > inside.start:
                y[inside] = dense(t[inside])
                omega[inside], speeds[inside] = _observe(run.vehicle, run.wheels, y[inside])
            filled = inside.stop
            _change_modes(run, ta)
    return _dataset(vehicle, t, y, omega, speeds, run, rtol)


def _times(t_s: npt.ArrayLike) -> np.ndarray:
    t = np.atleast_1d(np.asarray(t_s, dtype=np.float64)) + 0.0  # no minus zero
    steps = np.diff(t)
    if (
        t.ndim != 1
        or t.size == 0
        or not np.all(np.isfinite(t))
        or not (np.all(steps > 0) or np.all(steps < 0))
    ):
        raise MotionError(
            "t_s must be finite times that all increase, or all decrease", got=f"shape {t.shape}"
        )
    return t


def _tolerance(rtol: float) -> float:
    """heyoka's tolerance is per step; a thousand steps must stay within `rtol`."""
    if not 0 < rtol < 1:
        raise MotionError("rtol must be between 0 and 1", got=rtol)
    return max(rtol * 1e-3, float(np.finfo(float).eps))


def _vector(value: npt.ArrayLike, name: str) -> np.ndarray:
    vector = np.asarray(value, dtype=np.float64)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise MotionError(
            f"{name} must be three finite numbers", got=f"shape {vector.shape}: {value}"
        )
    return vector


def wheel_speeds(vehicle: Vehicle, wheel_speed_rad_s: npt.ArrayLike | None) -> np.ndarray:
    """The public wheel-speed argument (None, number or one per wheel) as an array (n_wheel) in rad/s."""
    n = len(vehicle.wheels)
    speeds = (
        np.zeros(0)
        if wheel_speed_rad_s is None
        else np.atleast_1d(np.asarray(wheel_speed_rad_s, dtype=np.float64))
    )
    if speeds.shape != (n,) or not np.all(np.isfinite(speeds)):
        raise MotionError(
            f"wheel_speed_rad_s must give one finite number for each of the {n} wheel(s) of {vehicle.name!r}",
            got=wheel_speed_rad_s,
        )
    return speeds


def _start(
    vehicle, omega_B, sun_B, wheel_speed_rad_s, t, wheel_mode, stopped_at_s, forces, B_from_N
) -> tuple[_Run, tuple]:
    from scipy.spatial.transform import Rotation

    omega, sun = _vector(omega_B, "omega_B"), _vector(sun_B, "sun_B")
    if abs(np.linalg.norm(sun) - 1) > SUN_LENGTH_TOLERANCE:
        raise MotionError(
            "sun_B must be a unit vector",
            got=f"length {np.linalg.norm(sun):.6g}",
            do="divide it by its length",
        )
    speeds = wheel_speeds(vehicle, wheel_speed_rad_s)
    fastest = max(np.abs(omega).max(), np.abs(speeds).max(initial=0.0))
    if fastest > MAX_RATE:
        raise MotionError(
            f"a rate exceeds {MAX_RATE:g} rad/s", got=f"{fastest:g} rad/s", do="is it in deg/s?"
        )
    plan = m.schedules(vehicle, wheel_mode)
    stopped = (
        stopped_at_s
        if isinstance(stopped_at_s, Sequence)
        else (stopped_at_s,) * len(vehicle.wheels)
    )
    if len(stopped) != len(vehicle.wheels):
        raise MotionError("stopped_at_s must give one time (or None) per wheel", got=stopped_at_s)
    attitude = forces.attitude(B_from_N, sun)
    bodies = Bodies.of(vehicle)
    carried = forces.carried(
        Rotation.from_quat(attitude).as_matrix()[None], own=forces.own(bodies)
    )[0]
    y = np.concatenate(
        [
            g.total_momentum(vehicle, omega, speeds),
            g.axial_momenta(vehicle, omega, speeds),
            sun,
            carried,
            attitude,
        ]
    )
    wheels = tuple(m.WheelState(m.Turning.HELD, "hold", float(speed), 0.0, 0.0) for speed in speeds)
    backward = t.size > 1 and t[-1] < t[0]
    values = forces.values(bodies)
    return _Run(
        vehicle,
        float(t[0]),
        y,
        wheels,
        backward,
        tuple(stopped),
        [],
        acting=forces,
        outside_values=values,
    ), plan


def _command(run: _Run, plan: tuple, t: float) -> None:
    """Give each wheel the command in force at `t`, the middle of the interval that begins now."""
    _refresh(run)
    run.wheels = tuple(
        m.state_under(wheel, m.command_at(schedule, t), state.speed)
        for wheel, schedule, state in zip(run.vehicle.wheels, plan, run.wheels, strict=True)
    )
    if run.backward:
        for i in range(len(run.wheels)):
            _require_known_past(run, i)
    else:
        run.wheels = run.settled()


def _refresh(run: _Run) -> None:
    """Bring the speeds noted in `run.wheels`, and h of wheels that were not free, up to the present state."""
    omega, speeds = _observe(run.vehicle, run.wheels, run.y[None])
    exact = [
        s if w.turning is m.Turning.FREE else w.speed
        for s, w in zip(speeds[0], run.wheels, strict=True)
    ]
    run.wheels = tuple(replace(w, speed=float(s)) for w, s in zip(run.wheels, exact, strict=True))
    run.y[3 : 3 + len(exact)] = g.axial_momenta(run.vehicle, omega[0], np.array(exact))


def _observe(
    vehicle: Vehicle, wheels: tuple[m.WheelState, ...], y: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """omega (n, 3) and wheel speeds (n, n_wheel) of states y (n, ...) while the wheels are in these states."""
    p = m.parameters(vehicle, wheels)
    H, h = y[:, :3].T, y[:, 3 : 3 + len(wheels)].T
    omega = g.body_rate(H, h, p)
    speeds = [
        g.wheel_speed(h[i], omega, p.wheels[i])
        if state.turning is m.Turning.FREE
        else np.full(len(y), state.speed)
        for i, state in enumerate(wheels)
    ]
    return np.stack(omega, axis=-1), np.stack(speeds, axis=-1) if speeds else np.zeros((len(y), 0))


def _piece(run: _Run, ta, t_stop: float):
    """Integrate to `t_stop`, a wheel event, or the time a stuck wheel had stopped; return the dense output."""
    values = parameter_values(run.vehicle, run.wheels, run.backward, run.outside_values)
    fastest = np.linalg.norm(run.momentum) * np.linalg.norm(values[:6])
    longest = PIECE_ANGLE / max(fastest, 1e-12)
    target = max(t_stop, run.t - longest) if run.backward else min(t_stop, run.t + longest)
    if run.backward:
        for state, stopped in zip(run.wheels, run.stopped_at, strict=True):
            if (
                state.turning is m.Turning.STUCK
                and stopped is not None
                and target < stopped < run.t
            ):
                target = stopped
    for state in run.wheels:
        if state.watch_from is not None:
            target = (
                max(target, state.watch_from) if run.backward else min(target, state.watch_from)
            )
    if target == run.t:
        raise MotionError(
            f"the body turns too fast to be followed at t = {run.t:zg} s",
            do="check the rates' unit",
        )
    ta.pars[:] = values
    ta.state[:] = run.y
    ta.time = run.t
    result = ta.propagate_until(target, c_output=True)
    outcome, dense = int(result[0]), result[4]
    run.y = ta.state.copy()
    run.pending = -outcome - 1 if -2 * len(run.wheels) <= outcome < 0 else None
    run.t = float(ta.time if run.pending is not None else target)
    if not np.all(np.isfinite(run.y)):
        raise MotionError(
            f"the motion left the range of numbers at t = {run.t:zg} s", do="check the rates' unit"
        )
    return dense


def _change_modes(run: _Run, ta) -> None:
    """Handle what ended the piece: an event of a wheel, or the known stop of a stuck wheel on the way back."""
    if len(run.events) > MAX_EVENTS:
        raise MotionError(
            f"more than {MAX_EVENTS} wheel events by t = {run.t:zg} s: the wheel chatters"
        )
    if run.pending is not None:
        wheel, is_breakaway = divmod(run.pending, 2)
        _breakaway(run, wheel) if is_breakaway else _stop(run, wheel)
    elif run.backward:
        for i, (state, stopped) in enumerate(zip(run.wheels, run.stopped_at, strict=True)):
            if state.turning is m.Turning.STUCK and stopped == run.t:
                _release_backward(run, i)
    if run.wheels:
        ta.reset_cooldowns()
        _watch_slipping_wheels(run)


def _watch_slipping_wheels(run: _Run) -> None:
    """Begin to watch wheels that have gathered speed since they began to slip; one that has not is still stuck."""
    _refresh(run)
    omega = float(np.linalg.norm(_observe(run.vehicle, run.wheels, run.y[None])[0]))
    for i, state in enumerate(run.wheels):
        if state.turning is not m.Turning.FREE or state.limit == 0:
            continue
        if state.watch_from == run.t:
            gathered = state.sign * state.speed > 0
            turning = (
                state if gathered else replace(state, turning=m.Turning.STUCK, speed=0.0, sign=0.0)
            )
            _set_wheel(run, i, replace(turning, watch_from=None))
        elif state.watch_from is None and abs(state.speed) < ROUNDING_SPEED:
            delay = TAKE_OFF_ANGLE / max(omega, 1e-6)
            _set_wheel(
                run, i, replace(state, watch_from=run.t + (-delay if run.backward else delay))
            )


def _set_wheel(run: _Run, i: int, state: m.WheelState) -> None:
    run.wheels = run.wheels[:i] + (state,) + run.wheels[i + 1 :]


def _stop(run: _Run, i: int) -> None:
    """Wheel i reaches zero speed: it sticks if friction can hold it, else it goes on into reverse."""
    _refresh(run)
    before = run.wheels[i]
    _set_wheel(run, i, m.WheelState(m.Turning.STUCK, before.command, 0.0, 0.0, before.limit))
    _refresh(run)
    settled = run.settled()
    if run.backward:
        if settled[i].turning is m.Turning.FREE:
            # it passed through zero; backward in time it leaves with the opposite sign
            _set_wheel(run, i, replace(before, speed=0.0, sign=-before.sign))
            run.note(i, "reverses")
        else:
            _require_known_past(run, i)
            run.note(i, "breaks away")
        return
    run.note(i, "stops" if settled[i].turning is m.Turning.STUCK else "reverses")
    run.wheels = settled


def _breakaway(run: _Run, i: int) -> None:
    """The torque that keeps wheel i stuck reaches the friction limit."""
    if run.backward:
        raise MotionError(
            f"wheel {run.vehicle.wheels[i].name!r} cannot have been stuck before t = {run.t:z.6g} s: friction was too weak",
            do="give the time it stopped as stopped_at_s, or begin later",
        )
    before = run.wheels[i]
    p, inertia = (
        m.parameters(run.vehicle, run.wheels, run.outside),
        run.vehicle.wheels[i].inertia_kg_m2,
    )
    torque = g.holding_torque(
        run.momentum, run.axial, p, p.wheels[i], inertia, run.directions, run.t
    )
    _refresh(run)
    _set_wheel(
        run,
        i,
        m.WheelState(m.Turning.FREE, before.command, 0.0, -float(np.sign(torque)), before.limit),
    )
    run.wheels = run.settled()
    run.note(i, "breaks away")


def _release_backward(run: _Run, i: int) -> None:
    """Backward in time, the moment at which wheel i had stopped: before it the wheel was turning."""
    _refresh(run)
    before = run.wheels[i]
    sign = -1.0 if run.vehicle.wheels[i].speed_rad_s < 0 else 1.0
    _set_wheel(run, i, m.WheelState(m.Turning.FREE, before.command, 0.0, sign, before.limit))
    run.note(i, "stops")


def _require_known_past(run: _Run, i: int) -> None:
    state, stopped = run.wheels[i], run.stopped_at[i]
    if state.turning is m.Turning.STUCK and stopped is None:
        raise MotionError(
            f"wheel {run.vehicle.wheels[i].name!r} is at rest at t = {run.t:z.6g} s and a wheel that "
            "sticks forgets its past",
            do="give the time it stopped as stopped_at_s",
        )
    if state.turning is m.Turning.STUCK and stopped is not None and stopped >= run.t:
        if stopped > run.t:
            raise MotionError(
                f"stopped_at_s = {stopped:g} s lies after t = {run.t:zg} s, at which the wheel is already at rest"
            )
        _release_backward(run, i)


def _dataset(vehicle, t, y, omega, speeds, run: _Run, rtol) -> xr.Dataset:
    n, events, environment = len(vehicle.wheels), run.events, run.acting.environment
    body = ("time", "axis")
    return xr.Dataset(
        {
            "omega_B": (body, omega, {"units": "rad s-1", "long_name": "body rate, body axes"}),
            "sun_B": (
                body,
                y[:, 3 + n : 6 + n],
                {"units": "1", "long_name": "direction to the Sun, body axes"},
            ),
            "wheel_speed_rad_s": (
                ("time", "wheel"),
                speeds,
                {"units": "rad s-1", "long_name": "relative to the body"},
            ),
            "momentum_B": (
                body,
                y[:, :3],
                {"units": "N m s", "long_name": "total angular momentum, body axes"},
            ),
            "B_from_N": (
                ("time", "quaternion"),
                y[:, -4:],
                {
                    "units": "1",
                    "long_name": "attitude, scalar last; N is " + _named_frame(environment),
                },
            ),
            **{
                f"{name}_B": (
                    body,
                    y[:, at : at + 3],
                    {"units": "1", "long_name": f"direction of the {name}, body axes"},
                )
                for name, at in zip(
                    needed(run.acting.torques),
                    range(6 + n, y.shape[1], PER_DIRECTION),
                    strict=False,
                )
                if name != OWN
            },
            "event_time_s": (
                "event",
                np.array([e[0] for e in events], dtype=np.float64),
                {"units": "s"},
            ),
            "event_wheel": ("event", np.array([e[1] for e in events], dtype=np.str_)),
            "event_what": ("event", np.array([e[2] for e in events], dtype=np.str_)),
        },
        coords={
            "time": ("time", t, {"units": "s"}),
            "axis": ["x", "y", "z"],
            "wheel": np.array([wheel.name for wheel in vehicle.wheels], dtype=np.str_),
            "quaternion": ["x", "y", "z", "w"],
        },
        attrs=provenance("trajectory", **vehicle.result_attributes)
        | {
            "rtol": rtol,
            "frame_N": BODY_AT_START if environment is None else environment.frame_N,
            "source": "paper, eqs. 3-7; Taylor integration by heyoka",
        },
    )


def _named_frame(environment: Environment | None) -> str:
    return "B at the first time" if environment is None else "the environment's"
