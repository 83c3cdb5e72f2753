"""The reference propagator: one motion to machine precision, forward or backward in time, with wheel events.

A run is computed in legs, in each of which every wheel has one command (coast, hold or brake). The Taylor kernel
(:mod:`sunspin.dynamics.kernels.motions`) computes a leg with all its events. A leg ends when a command changes. Backward in time it
also ends when a wheel that friction holds had come to rest. The motion does not determine that time, so the caller states it.
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
from sunspin.dynamics.batch import Motion, Outcome, Problem, Rows, advance, require_followable
from sunspin.dynamics.bodies import Bodies
from sunspin.dynamics.gyrostat import total_momentum
from sunspin.dynamics.kernels.rows import BREAKS_AWAY, OVERLOADED, RESTS, REVERSES, STOPS
from sunspin.dynamics.torques import Acting, Steady, acting
from sunspin.dynamics.wheel_modes import command_at, friction_limit, schedules, switch_times
from sunspin.environment import Environment
from sunspin.environment.frames import BODY_AT_START
from sunspin.vehicle import Vehicle

SUN_LENGTH_TOLERANCE = 1e-3
"""A direction to the Sun printed to three or four digits is taken as it is; beyond this it is an error."""

MAX_RATE = 1e6
"""rad/s; a larger rate of a body or a wheel is refused, because the unit is probably wrong."""

MAX_EVENTS = 100_000
"""Wheel events in one leg; with more, a wheel stops and starts again and again, and the run would not end."""

FIRST_ROOM = 500
"""Events for which there is room at first; a leg with more is computed again."""

SHARE = 0.1
"""Part of `rtol` for which the kernel chooses its steps."""

ABOUT_TO_SLIP = 1e-300
"""rad/s: practically zero, but with a sign. The kernel lets a wheel with this speed turn freely; one with zero is stuck."""

EVENT_TEXT = {
    STOPS: "stops",
    BREAKS_AWAY: "breaks away",
    REVERSES: "reverses",
    RESTS: "breaks away",  # backward: forward in time it breaks away there
}


def propagate(
    vehicle: Vehicle,
    omega_B: npt.ArrayLike,
    sun_B: npt.ArrayLike,
    wheel_speed_rad_s: npt.ArrayLike | None,
    t_s: npt.ArrayLike,
    wheel_mode: Any = "coast",
    stopped_at_s: float | Sequence[float | None] | np.ndarray | None = None,
    rtol: float = 1e-12,
    *,
    environment: Environment | None = None,
    torques: Sequence[str | Steady] = (),
    B_from_N: npt.ArrayLike | None = None,
) -> xr.Dataset:
    """Return the rotation of `vehicle` from its state at ``t_s[0]`` to all times `t_s`, also under torques (paper, eqs. 3-7).

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
        Time at which a wheel that friction holds had come to rest (one value per wheel if there are several). A run backward in
        time needs it, because the motion does not determine it. Nor does it determine in which direction the wheel turned
        before: the sign is that of its speed in the vehicle file.
    rtol : float
        Relative error over the run, down to 1e-13.
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
    if not 0 < rtol < 1:
        raise MotionError("rtol must be between 0 and 1", got=rtol)
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
    plan = schedules(vehicle, wheel_mode)
    attitude = forces.attitude(B_from_N, sun)
    stopped_at = stopped_at_s
    if not isinstance(stopped_at, Sequence | np.ndarray):
        stopped_at = (stopped_at,) * len(vehicle.wheels)
    known = np.array([t for t in stopped_at if t is not None], dtype=np.float64)
    if len(stopped_at) != len(vehicle.wheels) or not np.all(np.isfinite(known)):
        raise MotionError(
            "stopped_at_s must give one finite time (or None) per wheel", got=stopped_at_s
        )
    run = _Run(vehicle, t, forces, tuple(stopped_at), rtol)
    run.begin(omega, sun, speeds, attitude)
    for end in [*switch_times(plan, t[0], t[-1]), t[-1]] if t.size > 1 else []:
        middle = (run.t + end) / 2
        commands = tuple(command_at(schedule, middle) for schedule in plan)
        while run.t != end:
            run.advance(end, commands)
    return _dataset(run)


def _times(t_s: npt.ArrayLike) -> np.ndarray:
    """Return the times (n), s; raise MotionError unless they are finite and all increase or all decrease."""
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


def _vector(value: npt.ArrayLike, name: str) -> np.ndarray:
    """Return an argument as a vector (3); raise MotionError, with its name, if it is something else."""
    vector = np.asarray(value, dtype=np.float64)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise MotionError(
            f"{name} must be three finite numbers", got=f"shape {vector.shape}: {value}"
        )
    return vector


def wheel_speeds(vehicle: Vehicle, wheel_speed_rad_s: npt.ArrayLike | None) -> np.ndarray:
    """Return the public wheel-speed argument (None, number or one per wheel) as an array (n_wheel) in rad/s."""
    n = len(vehicle.wheels)
    speeds = np.zeros(0)
    if wheel_speed_rad_s is not None:
        speeds = np.atleast_1d(np.asarray(wheel_speed_rad_s, dtype=np.float64))
    if speeds.shape != (n,) or not np.all(np.isfinite(speeds)):
        raise MotionError(
            f"wheel_speed_rad_s must give one finite number for each of the {n} wheel(s) of {vehicle.name!r}",
            got=wheel_speed_rad_s,
        )
    return speeds


@dataclass
class _Run:
    """A run between two legs: its arguments, the state at time `t`, and the outputs and events so far.

    `stopped_at`: for each wheel the time at which it had come to rest, or None. `sun_N` (3): direction to the Sun; `attitude` (4):
    quaternion at the first time. The state at `t`: `omega` (3) in rad/s, `speeds` (n_wheel) in rad/s, exactly zero while friction
    holds a wheel, and `matrix` (3, 3), the attitude B_from_N. `torque_B` and `torque_N` (3): torques that are steady in the body
    and in space, N m. `outputs` (n_time, ...) by name; the first `filled` are written. `events`: time, wheel, what it does.
    """

    vehicle: Vehicle
    times: np.ndarray
    acting: Acting
    stopped_at: tuple[float | None, ...]
    rtol: float
    sun_N: np.ndarray = field(default_factory=lambda: np.zeros(3))
    attitude: np.ndarray = field(default_factory=lambda: np.zeros(4))
    t: float = 0.0
    omega: np.ndarray = field(default_factory=lambda: np.zeros(3))
    speeds: np.ndarray = field(default_factory=lambda: np.zeros(0))
    matrix: np.ndarray = field(default_factory=lambda: np.eye(3))
    torque_B: np.ndarray = field(default_factory=lambda: np.zeros(3))
    torque_N: np.ndarray = field(default_factory=lambda: np.zeros(3))
    filled: int = 0
    outputs: dict[str, np.ndarray] = field(default_factory=dict)
    events: list[tuple[float, str, str]] = field(default_factory=list)

    @property
    def backward(self) -> bool:
        """Return whether the run goes backward in time."""
        return bool(self.times[-1] < self.times[0])

    def begin(
        self, omega: np.ndarray, sun_B: np.ndarray, speeds: np.ndarray, attitude: np.ndarray
    ) -> None:
        """Set the state at the first time, and write the first output."""
        from scipy.spatial.transform import Rotation

        bodies, n = Bodies.of(self.vehicle), self.times.size
        self.t, self.omega, self.speeds = float(self.times[0]), omega, speeds.copy()
        self.attitude, self.matrix = attitude, Rotation.from_quat(attitude).as_matrix()
        self.sun_N = self.matrix.T @ sun_B
        self.torque_B, space_B = self.acting.steady(bodies)
        self.torque_N = self.matrix.T @ space_B
        first = {
            "omega_B": omega,
            "sun_B": sun_B,
            "wheel_speed_rad_s": speeds,
            "momentum_B": total_momentum(bodies, omega, speeds),
            "matrix": self.matrix,
        }
        for name, value in first.items():
            self.outputs[name] = np.empty((n, *value.shape))
            self.outputs[name][0] = value
        self.filled = 1

    def advance(self, end: float, commands: tuple[str, ...]) -> None:
        """Compute a leg up to time `end`, or, backward in time, up to the time before at which a stuck wheel had come to rest."""
        if self.backward:
            end = self._backward_end(end, commands)
            if end == self.t:
                return
        # output times in this leg
        due = self.times[self.filled :]
        due = due[due >= end] if self.backward else due[due <= end]
        motion = self._leg(np.append(due, end) - self.t, commands)
        events = motion.events[0, : motion.n_events[0]]
        begin, outcome = self.t, motion.outcome[0]
        if outcome == Outcome.PAST_UNKNOWN:
            # the leg has ended where the wheel had come to rest; later outputs belong to the next leg
            self.t = begin + float(events[-1, 0])
            due = due[due > self.t]
        elif outcome == Outcome.NOT_FINITE:
            raise MotionError(
                f"the motion left the range of numbers after t = {begin:zg} s",
                do="check the rates' unit",
            )
        else:
            self.t = end
        last = motion.at_end()
        for wheel in self._released(commands, events, last.wheel_speed_rad_s[0, 0]):
            self._add_event(begin, wheel, BREAKS_AWAY)
        for seconds, wheel, what in events:
            self._add_event(begin + seconds, int(wheel), int(what))
        # outputs of this leg, after those of the legs before
        to = slice(self.filled, self.filled + len(due))
        for name in ("omega_B", "sun_B", "wheel_speed_rad_s", "momentum_B"):
            self.outputs[name][to] = getattr(motion, name)[0, : len(due)]
        self.outputs["matrix"][to] = motion.attitude[0, : len(due)] @ self.matrix
        self.filled += len(due)
        self.omega, self.speeds = last.omega_B[0, 0], last.wheel_speed_rad_s[0, 0].copy()
        self.matrix = last.attitude[0, 0] @ self.matrix

    def _released(
        self, commands: tuple[str, ...], events: np.ndarray, at_end: np.ndarray
    ) -> list[int]:
        """Return the wheels that are at rest at the start of a leg and that friction cannot hold there.

        The kernel releases them without an event. They are recognised by what follows: another event than breaking away, or
        a speed at the end of the leg, `at_end` (n_wheel). After an event of another wheel the time is unknown: none is returned.
        """
        released = []
        for i, (wheel, command) in enumerate(zip(self.vehicle.wheels, commands, strict=True)):
            dry = command != "hold" and friction_limit(wheel, command) > 0.0
            if self.backward or not dry or self.speeds[i] != 0.0:
                continue
            first = events[0] if len(events) else None
            if at_end[i] != 0.0 if first is None else first[1] == i and first[2] != BREAKS_AWAY:
                released.append(i)
        return released

    def _leg(self, seconds: np.ndarray, commands: tuple[str, ...]) -> Motion:
        """Return the motion from the present state to `seconds` (n_out) after it, with all its events."""
        from scipy.spatial.transform import Rotation

        bodies = Bodies.of(self.vehicle, 1)
        forces = replace(self.acting, start_s=self.t)
        if self.acting.torques:
            # the kernel takes both steady torques in body axes at the start of the leg
            torque = np.stack([self.torque_B, self.matrix @ self.torque_N])
            bodies = replace(bodies, steady_N_m=torque[None])
            not_steady = [x for x in forces.torques if not isinstance(x, Steady)]
            forces = replace(forces, torques=(*not_steady, Steady()))
        initial = Rows(
            self.omega[None],
            (self.matrix @ self.sun_N)[None],
            self.speeds[None],
            bodies,
            Rotation.from_matrix(self.matrix).as_quat()[None],
        )
        problem = Problem(self.vehicle, initial, commands, forces)
        require_followable(problem, seconds[-1])
        # the error allowed for the run is shared by its legs in proportion to their length
        total = abs(self.times[-1] - self.times[0])
        error = SHARE * max(self.rtol, 1e-13) * (abs(seconds[-1]) / total if total else 1.0)
        room = FIRST_ROOM
        while True:
            motion = advance(problem, seconds, error, True, room)
            if motion.outcome[0] != Outcome.CHATTERS:
                return motion
            if room >= MAX_EVENTS:
                last = self.t + motion.events[0, -1, 0]
                raise MotionError(
                    f"more than {MAX_EVENTS} wheel events by t = {last:zg} s: the wheel chatters"
                )
            room = min(10 * room, MAX_EVENTS)

    def _add_event(self, t: float, wheel: int, what: int) -> None:
        """Add an event of a wheel (codes in :mod:`kernels.rows`); `MotionError` for one that a stuck wheel cannot have had."""
        name = self.vehicle.wheels[wheel].name
        if what == OVERLOADED:
            raise MotionError(
                f"wheel {name!r} cannot have been stuck before t = {t:z.6g} s: friction was too weak",
                do="give the time it stopped as stopped_at_s, or begin later",
            )
        if what == RESTS:
            self._require_past(wheel, t)
        self.events.append((t, name, EVENT_TEXT[what]))

    def _backward_end(self, end: float, commands: tuple[str, ...]) -> float:
        """Return how far back the next leg may go: to `end`, or to the latest time at which a stuck wheel had come to rest.

        Wheels that had come to rest at the present time turn freely before it. Their sign is that of the speed in the vehicle file.
        """
        for i, wheel in enumerate(self.vehicle.wheels):
            limit = friction_limit(wheel, commands[i])
            # only wheels at rest that friction holds
            if self.speeds[i] != 0.0 or commands[i] == "hold" or limit == 0.0:
                continue
            stopped = self._require_past(i, self.t)
            if stopped == self.t:
                self.speeds[i] = -ABOUT_TO_SLIP if wheel.speed_rad_s < 0 else ABOUT_TO_SLIP
                self.events.append((self.t, wheel.name, "stops"))
            else:
                end = max(end, stopped)
        return end

    def _require_past(self, wheel: int, t: float) -> float:
        """Return the time at which a wheel that is at rest at `t` had stopped; `MotionError` if it is unknown or after `t`."""
        stopped, name = self.stopped_at[wheel], self.vehicle.wheels[wheel].name
        if stopped is None:
            raise MotionError(
                f"wheel {name!r} is at rest at t = {t:z.6g} s and a wheel that sticks forgets its past",
                do="give the time it stopped as stopped_at_s",
            )
        if stopped > t:
            raise MotionError(
                f"stopped_at_s = {stopped:g} s lies after t = {t:zg} s, at which the wheel is already at rest"
            )
        return stopped


def _quaternions(matrices: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Return unit quaternions (n, 4), scalar last, of matrices (n, 3, 3), without sign jumps: each is near the one before.

    q and -q are the same attitude. The first quaternion has the sign that is nearer to `first` (4).
    """
    from scipy.spatial.transform import Rotation

    quaternions = Rotation.from_matrix(matrices).as_quat()
    jumps = np.einsum("ni,ni->n", quaternions, np.vstack([first, quaternions[:-1]])) < 0
    return quaternions * np.where(np.cumsum(jumps) % 2, -1.0, 1.0)[:, None]


def _dataset(run: _Run) -> xr.Dataset:
    """Return the outputs and events of a run that has ended, as described in :func:`propagate`."""
    out, events, environment = run.outputs, run.events, run.acting.environment

    def variable(values: np.ndarray, last: str, units: str, long_name: str) -> Any:
        """Return a variable over time and the dimension `last`."""
        return ("time", last), values, {"units": units, "long_name": long_name}

    frame = "B at the first time" if environment is None else "the environment's"
    speeds, momentum = out["wheel_speed_rad_s"], out["momentum_B"]
    attitude = _quaternions(out["matrix"], run.attitude)
    about = f"attitude, scalar last; N is {frame}"
    variables: dict[str, Any] = {
        "omega_B": variable(out["omega_B"], "axis", "rad s-1", "body rate, body axes"),
        "sun_B": variable(out["sun_B"], "axis", "1", "direction to the Sun, body axes"),
        "wheel_speed_rad_s": variable(speeds, "wheel", "rad s-1", "relative to the body"),
        "momentum_B": variable(momentum, "axis", "N m s", "total angular momentum, body axes"),
        "B_from_N": variable(attitude, "quaternion", "1", about),
    }
    if run.acting.needs_attitude:
        nadir = run.acting.nadir_B(out["matrix"], run.times)[:, :3]
        variables["nadir_B"] = variable(nadir, "axis", "1", "direction of the nadir, body axes")
    event_times = np.array([event[0] for event in events], dtype=np.float64)
    return xr.Dataset(
        variables
        | {
            "event_time_s": ("event", event_times, {"units": "s"}),
            "event_wheel": ("event", np.array([event[1] for event in events], dtype=np.str_)),
            "event_what": ("event", np.array([event[2] for event in events], dtype=np.str_)),
        },
        coords={
            "time": ("time", run.times, {"units": "s"}),
            "axis": ["x", "y", "z"],
            "wheel": np.array([wheel.name for wheel in run.vehicle.wheels], dtype=np.str_),
            "quaternion": ["x", "y", "z", "w"],
        },
        attrs=provenance("trajectory", **run.vehicle.result_attributes)
        | {
            "rtol": run.rtol,
            "frame_N": BODY_AT_START if environment is None else environment.frame_N,
            "source": "paper, eqs. 3-7; integration by Taylor series",
        },
    )
