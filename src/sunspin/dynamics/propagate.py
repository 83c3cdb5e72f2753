"""The reference propagator: one motion to machine precision, forward or backward, with wheel events.

The kernel of :mod:`sunspin.dynamics.kernels.motions` computes a leg of the run, in which each wheel has one command, with all its
events. A leg ends where a command changes and, backward in time, where a wheel that is stuck had come to rest: that time has to be
given, since friction that holds a wheel forgets its past.
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
from sunspin.dynamics.batch import Motion, Outcome, Problem, Rows, advance, require_followable
from sunspin.dynamics.bodies import Bodies
from sunspin.dynamics.kernels.rows import BREAKS_AWAY, OVERLOADED, RESTS, REVERSES, STOPS
from sunspin.dynamics.torques import Acting, Steady, acting
from sunspin.environment import Environment
from sunspin.environment.frames import BODY_AT_START
from sunspin.vehicle import Vehicle

SUN_LENGTH_TOLERANCE = 1e-3
"""A direction to the Sun printed to three or four digits is taken as it is; beyond this it is an error."""

MAX_RATE = 1e6
"""rad/s; a body or wheel said to turn faster is a slip of units."""

MAX_EVENTS = 100_000
"""Wheel events in one run; more means that the wheel chatters and the run would not end."""

FIRST_ROOM = 500
"""Events for which there is room at first; a leg with more is computed again."""

SHARE = 0.1
"""Share of `rtol` that the kernel's law of steps may use up."""

ABOUT_TO_SLIP = 1e-300
"""rad/s: a speed that is zero but for its sign. A wheel with it turns freely; one with zero is stuck."""

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
    plan = m.schedules(vehicle, wheel_mode)
    attitude = forces.attitude(B_from_N, sun)
    run = _Run(vehicle, t, forces, _stop_times(vehicle, stopped_at_s), rtol)
    run.begin(omega, sun, speeds, attitude)
    for end in [*m.switch_times(plan, t[0], t[-1]), t[-1]] if t.size > 1 else []:
        middle = (run.t + end) / 2
        commands = tuple(m.command_at(schedule, middle) for schedule in plan)
        while run.t != end:
            run.advance(end, commands)
    return _dataset(run)


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


def _stop_times(
    vehicle: Vehicle, stopped_at_s: float | Sequence[float | None] | None
) -> tuple[float | None, ...]:
    """Return the time at which each wheel had stopped, or None."""
    n = len(vehicle.wheels)
    times = stopped_at_s if isinstance(stopped_at_s, Sequence) else (stopped_at_s,) * n
    if len(times) != n:
        raise MotionError("stopped_at_s must give one time (or None) per wheel", got=stopped_at_s)
    return tuple(times)


@dataclass
class _Run:
    """A run between two legs: what is asked for, the state at time `t`, and the outputs and events so far.

    `sun_N` (3); `attitude` (4): quaternion at the first time. Of now: `matrix` (3, 3), attitude B from N, and `speeds` (n_wheel),
    exactly zero where friction holds a wheel. `torque_B` and `torque_N` (3): steady torques in N m. `outputs` (n_time, ...) are
    written from the first on; `filled` counts them.
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
        """Whether the run goes backward in time."""
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
            "momentum_B": g.total_momentum(bodies, omega, speeds),
            "matrix": self.matrix,
        }
        for name, value in first.items():
            self.outputs[name] = np.empty((n, *value.shape))
            self.outputs[name][0] = value
        self.filled = 1

    def advance(self, end: float, commands: tuple[str, ...]) -> None:
        """Go on to `end`, or to the time before it at which a wheel that is stuck had come to rest."""
        if self.backward:
            end = self._backward_end(end, commands)
            if end == self.t:
                return
        due = self.times[self.filled :]
        due = due[due >= end] if self.backward else due[due <= end]
        motion = self._leg(np.append(due, end) - self.t, commands)
        events = motion.events[0, : motion.n_events[0]]
        begin, outcome = self.t, motion.outcome[0]
        if outcome == Outcome.PAST_UNKNOWN:
            # the state where the wheel had come to rest; what lies beyond belongs to the next leg
            self.t = begin + float(events[-1, 0])
            due = due[due > self.t]
        elif outcome == Outcome.NOT_FINITE:
            raise MotionError(
                f"the motion left the range of numbers after t = {begin:zg} s",
                do="check the rates' unit",
            )
        else:
            self.t = end
        for seconds, wheel, what in events:
            self._note(begin + seconds, int(wheel), int(what))
        self._write(motion, len(due))
        last = motion.at_end()
        self.omega, self.speeds = last.omega_B[0, 0], last.wheel_speed_rad_s[0, 0].copy()
        self.matrix = last.attitude[0, 0] @ self.matrix

    def _leg(self, seconds: np.ndarray, commands: tuple[str, ...]) -> Motion:
        """Compute a leg from the present state to `seconds` (n_out) after it, with room for all its events."""
        from scipy.spatial.transform import Rotation

        bodies = Bodies.of(self.vehicle, 1)
        forces = replace(self.acting, start_s=self.t)
        if self.acting.torques:  # a torque in space is given in the body's axes of now
            torque = np.stack([self.torque_B, self.matrix @ self.torque_N])
            bodies = replace(bodies, steady_N_m=torque[None])
            others = [x for x in forces.torques if not isinstance(x, Steady)]
            forces = replace(forces, torques=(*others, Steady()))
        initial = Rows(
            self.omega[None],
            (self.matrix @ self.sun_N)[None],
            self.speeds[None],
            bodies,
            Rotation.from_matrix(self.matrix).as_quat()[None],
        )
        problem = Problem(self.vehicle, initial, commands, forces)
        require_followable(problem, seconds[-1])
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

    def _write(self, motion: Motion, count: int) -> None:
        """Write the first `count` outputs of a leg after those of the legs before."""
        to = slice(self.filled, self.filled + count)
        for name in ("omega_B", "sun_B", "wheel_speed_rad_s", "momentum_B"):
            self.outputs[name][to] = getattr(motion, name)[0, :count]
        self.outputs["matrix"][to] = motion.attitude[0, :count] @ self.matrix
        self.filled += count

    def _note(self, t: float, wheel: int, what: int) -> None:
        """Note an event of a wheel; `MotionError` for one that shows that it cannot have been stuck."""
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
        """Return how far back the next leg may go: to where the first of the wheels that are stuck had come to rest.

        Wheels that had come to rest just now are let go, and turn as the vehicle says that they do.
        """
        for i, wheel in enumerate(self.vehicle.wheels):
            limit = m.friction_limit(wheel, commands[i])
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
        """Return when a wheel that is at rest at `t` had stopped; `MotionError` if that is not known, or lies after `t`."""
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
    """Return unit quaternions (n, 4), scalar last, of matrices (n, 3, 3): neighbours on one side, the first next to `first`."""
    from scipy.spatial.transform import Rotation

    quaternions = Rotation.from_matrix(matrices).as_quat()
    turned = np.einsum("ni,ni->n", quaternions, np.vstack([first, quaternions[:-1]])) < 0
    return quaternions * np.where(np.cumsum(turned) % 2, -1.0, 1.0)[:, None]


def _dataset(run: _Run) -> xr.Dataset:
    """Return the outputs and events of a run that has ended."""
    out, events, environment = run.outputs, run.events, run.acting.environment
    body = ("time", "axis")
    variables: dict[str, Any] = {
        "omega_B": (
            body,
            out["omega_B"],
            {"units": "rad s-1", "long_name": "body rate, body axes"},
        ),
        "sun_B": (
            body,
            out["sun_B"],
            {"units": "1", "long_name": "direction to the Sun, body axes"},
        ),
        "wheel_speed_rad_s": (
            ("time", "wheel"),
            out["wheel_speed_rad_s"],
            {"units": "rad s-1", "long_name": "relative to the body"},
        ),
        "momentum_B": (
            body,
            out["momentum_B"],
            {"units": "N m s", "long_name": "total angular momentum, body axes"},
        ),
        "B_from_N": (
            ("time", "quaternion"),
            _quaternions(out["matrix"], run.attitude),
            {"units": "1", "long_name": "attitude, scalar last; N is " + _named_frame(environment)},
        ),
    }
    if run.acting.needs_attitude:
        variables["nadir_B"] = (
            body,
            run.acting.nadir_B(out["matrix"], run.times)[:, :3],
            {"units": "1", "long_name": "direction of the nadir, body axes"},
        )
    return xr.Dataset(
        variables
        | {
            "event_time_s": (
                "event",
                np.array([e[0] for e in events], dtype=np.float64),
                {"units": "s"},
            ),
            "event_wheel": ("event", np.array([e[1] for e in events], dtype=np.str_)),
            "event_what": ("event", np.array([e[2] for e in events], dtype=np.str_)),
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


def _named_frame(environment: Environment | None) -> str:
    return "B at the first time" if environment is None else "the environment's"
