"""Many motions of a vehicle at once: states at given times, forward or backward, or histograms of r_z, the Sun's height.

Two compiled kernels compute them: one by Taylor series, which does everything, and the split kernel, which is faster but gives
histograms only (:mod:`sunspin.dynamics.kernels`). A motion depends on its own initial state and on the arguments of the call, never
on its neighbours, on threads, or on how many motions are computed in one call.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property

import numpy as np
import numpy.typing as npt

from sunspin.base.errors import InputError, MotionError
from sunspin.dynamics import principal
from sunspin.dynamics.bodies import Bodies
from sunspin.dynamics.gyrostat import axial_momenta, free_inertia, total_momentum
from sunspin.dynamics.kernels import histogram, motions, rows, split
from sunspin.dynamics.kernels.histogram import new_nodes
from sunspin.dynamics.torques import NOTHING, Acting
from sunspin.dynamics.wheel_modes import friction_limit, schedules
from sunspin.solve.linear import extreme_eigenvalues, symmetric_inverse, symmetric_product
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.planes import DirectionSet

DIRECTION_ERROR = 1e-5
"""Default error of the Sun's direction at the end of a run, rad."""

EMD_ERROR = 1e-3
"""Default error of the EMD of a histogram."""

SMALLEST_EMD_ERROR = 2e-4
"""Smaller errors cannot be met: the width of the bins and the method of :mod:`~sunspin.dynamics.kernels.histogram` limit them."""

NODE_ANGLE = 0.9
"""Rotation (rad) between the points of a motion from which a histogram is made (nodes), if the EMD may err by EMD_ERROR. The error
is in proportion to its third power."""

PHASE_ERROR = 1e-2
"""Error of the Sun's direction at the end (rad), if the EMD may err by EMD_ERROR. It may be large, because it is mostly one along
the path of the Sun, which changes the histogram little."""

SPLIT_PHASE_ERROR = 0.1
"""The same (rad) for the split kernel. Motions near an unstable spin, where it would not be enough, are computed again."""

SPLIT_ADVANTAGE = 5.0
"""How many steps of the split kernel cost as much as one of the Taylor kernel."""

SMALLEST_DIRECTION_ERROR = 1e-11
"""What double precision reaches over some thousand radians."""

SAFETY = 1 / 300
"""Share of the allowed error for which steps are chosen: motions near an unstable spin amplify the errors of earlier steps."""

LOOSE_ERROR = 1e-7
"""Error of a whole run, :data:`SAFETY` included, above which a series of lower order is faster."""

MOST_EVENTS = 2000
"""Events of wheels in one motion; more means that a wheel chatters."""

MAX_STEPS = 2_000_000
"""Steps of one motion, some seconds of computing and a thousand times what 45 min of tumbling take. More is a wrong unit."""

RADIANS_A_STEP = 2.0
"""About how far a body rotates in a step: only the refusal of motions that are far too long depends on it."""


class Outcome(IntEnum):
    """How a motion ended; the text is in `OUTCOME_TEXT`."""

    FINE = rows.FINE
    CHATTERS = rows.CHATTERS
    PAST_UNKNOWN = rows.PAST_UNKNOWN
    NOT_FINITE = rows.NOT_FINITE


OUTCOME_TEXT = {
    Outcome.FINE: "computed as asked",
    Outcome.CHATTERS: "a wheel stops and starts too often to be followed",
    Outcome.PAST_UNKNOWN: "running backward, a wheel comes to rest: its past is not determined",
    Outcome.NOT_FINITE: "the motion left the range of numbers",
}


@dataclass(frozen=True)
class Rows:
    """Initial states of n motions: `omega_B` (n, 3) rad/s, `sun_B` (n, 3), `wheel_speed_rad_s` (n, n_wheel).

    `bodies` has the inertia and friction of each motion, leading shape (n,); without it all have the vehicle's. `B_from_N` (n, 4),
    quaternions with the scalar last, is needed by torques that depend on directions other than the Sun's.
    """

    omega_B: np.ndarray
    sun_B: np.ndarray
    wheel_speed_rad_s: np.ndarray
    bodies: Bodies | None = None
    B_from_N: np.ndarray | None = None

    def __len__(self) -> int:
        """Return the number of motions."""
        return len(self.omega_B)

    def take(self, index: np.ndarray) -> Rows:
        """Return the initial states of the motions `index`."""
        bodies = None if self.bodies is None else self.bodies.take(index)
        attitude = None if self.B_from_N is None else self.B_from_N[index]
        return Rows(
            self.omega_B[index], self.sun_B[index], self.wheel_speed_rad_s[index], bodies, attitude
        )

    def bodies_of(self, vehicle: Vehicle) -> Bodies:
        """Return the bodies of the motions, leading shape (n,) or, if all have that of the vehicle, (1,)."""
        return Bodies.of(vehicle, 1) if self.bodies is None else self.bodies


@dataclass(frozen=True)
class Motion:
    """Computed states of n motions at n_out times, in body axes.

    `states` (n, n_out, size): read them through the properties below; NaN after a motion whose `outcome` is not FINE has ended.
    `last` (n, size): the state where the motion ended. `outcome` (n). `events` (n, room, 3): time (s), number of the wheel and what
    it does (codes in :mod:`kernels.rows`), of which the first `n_events` (n) count. `steps` (n): number of integration steps.
    `seconds` (n, bins): how long the Sun stood at each height, (n, 0) unless this was counted.
    """

    states: np.ndarray
    last: np.ndarray
    outcome: np.ndarray
    events: np.ndarray
    n_events: np.ndarray
    steps: np.ndarray
    seconds: np.ndarray
    n_wheels: int

    def at_end(self) -> Motion:
        """Return the states in which the motions ended, as one output (n, 1, size)."""
        return replace(self, states=self.last[:, None])

    @property
    def momentum_B(self) -> np.ndarray:
        """Return the angular momentum H (n, n_out, 3) in N m s."""
        return self.states[..., :3]

    @property
    def axial_momenta(self) -> np.ndarray:
        """Return the axial momentum h of each wheel (n, n_out, n_wheel) in N m s."""
        return self.states[..., 3 : 3 + self.n_wheels]

    @property
    def sun_B(self) -> np.ndarray:
        """Return the direction to the Sun (n, n_out, 3)."""
        return self.states[..., 3 + self.n_wheels : 6 + self.n_wheels]

    @property
    def omega_B(self) -> np.ndarray:
        """Return the body rates (n, n_out, 3) in rad/s."""
        return self.states[..., 6 + self.n_wheels : 9 + self.n_wheels]

    @property
    def wheel_speed_rad_s(self) -> np.ndarray:
        """Return the wheel speeds relative to the body (n, n_out, n_wheel); exactly zero while friction holds a wheel."""
        return self.states[..., 9 + self.n_wheels : 9 + 2 * self.n_wheels]

    @property
    def attitude(self) -> np.ndarray:
        """Return the rotation matrices (n, n_out, 3, 3) to B from the body's axes at the start, if `run` was to compute them."""
        x, y = self.states[..., -6:-3], self.states[..., -3:]
        return np.stack([x, y, np.cross(x, y)], axis=-1)


@dataclass(frozen=True)
class Heights:
    """How long the Sun stood at each height in n motions: `seconds` (n, bins) in bins of r_z over [-1, 1].

    Only times at which its direction counts are included (`counted` of :func:`sun_heights`). `outcome` (n).
    """

    seconds: np.ndarray
    outcome: np.ndarray


def one_command(vehicle: Vehicle, command: str | Sequence[str]) -> tuple[str, ...]:
    """Return one constant command for each wheel; `InputError` for a schedule, `MotionError` for an unknown command."""
    plan = schedules(vehicle, command)
    if any(len(schedule) > 1 for schedule in plan):
        raise InputError(
            "an ensemble runs with one command per wheel", got=command, do="chain two runs"
        )
    return tuple(schedule[0][1] for schedule in plan)


def run(
    vehicle: Vehicle,
    initial: Rows,
    times_s: npt.ArrayLike,
    *,
    command: str | Sequence[str] = "coast",
    error: float = DIRECTION_ERROR,
    acting: Acting = NOTHING,
    attitude: bool = False,
    leave_long: bool = False,
) -> Motion:
    """Return the states, at the times `times_s` after the start, of the motions that begin in `initial`.

    Parameters
    ----------
    initial : Rows
        States at time 0.
    times_s : (n_out,) or a number, s
        Increasing, or decreasing for runs backward in time.
    command : str, or one per wheel
        ``"coast"``, ``"hold"`` or ``"brake"``.
    error : float
        Largest error of the Sun's direction at the last time, rad.
    acting : Acting
        Torques, their environment and the time at which the motions begin on its clock.
    attitude : bool
        Whether `Motion.attitude` is computed.
    leave_long : bool
        Give up motions that need more than `MAX_STEPS` steps, with `Outcome.NOT_FINITE`, instead of refusing all.

    Raises
    ------
    InputError
        Times in both directions, an error that cannot be met, rows without the attitude that torques need.
    MotionError
        A motion that needs too many steps, unless `leave_long`; more wheels than there is room for.
    """
    ends = np.atleast_1d(np.asarray(times_s, dtype=np.float64))
    gaps = np.diff(ends, prepend=0.0)
    if not (np.all(gaps >= 0) or np.all(gaps <= 0)):
        raise InputError(
            "output times must all increase or all decrease from the start of the run", got=ends
        )
    check_errors(error, None)
    problem = Problem(vehicle, initial, one_command(vehicle, command), acting)
    if not leave_long:
        require_followable(problem, float(ends[-1]))
    motion = advance(problem, ends, SAFETY * error, attitude)
    if ends[-1] < 0:
        # a wheel that friction holds at rest may have stopped at any time before
        motion.outcome[problem.at_rest] = Outcome.PAST_UNKNOWN
    return motion


def sun_heights(
    vehicle: Vehicle,
    initial: Rows,
    duration_s: float,
    *,
    command: str | Sequence[str] = "coast",
    counted: DirectionSet | None = None,
    bins: int = 256,
    error: float | None = None,
    emd_error: float | None = None,
    acting: Acting = NOTHING,
) -> Heights:
    """Return how long the Sun stands at each height r_z, in motions that begin in `initial`.

    Parameters
    ----------
    initial, command, acting
        As in :func:`run`.
    duration_s : s
        Length of the motions, negative for runs backward in time.
    counted : DirectionSet, optional
        Directions that count; all unless given.
    bins : int
        Of r_z over [-1, 1].
    emd_error, error : float, optional
        Either the error of the EMD of the histogram, 1e-3 unless given, or that of the Sun's direction at the end (rad).

    Raises
    ------
    InputError, MotionError
        As :func:`run`.
    """
    check_errors(error, emd_error)
    problem = Problem(vehicle, initial, one_command(vehicle, command), acting)
    require_followable(problem, duration_s)
    # the errors for which PHASE_ERROR and NODE_ANGLE were set are scaled to the one asked for
    ratio = 1.0 if emd_error is None else emd_error / EMD_ERROR
    phase_error = PHASE_ERROR * ratio if error is None else error
    tolerance = NODE_ANGLE * min(1.0, ratio) ** (1 / 3)
    nodes = new_nodes(*half_spaces(counted), tolerance, bins)
    n = len(initial)
    seconds, outcome = np.zeros((n, bins), np.float32), np.zeros(n, dtype=np.int64)
    remaining = np.arange(n)
    # the steps of the split kernel are chosen for EMD_ERROR (SPLIT_PHASE_ERROR), not for a smaller error or one of directions
    if error is None and ratio >= 1.0:
        remaining = _count_by_split_kernel(problem, duration_s, nodes, seconds)
    if remaining.size:
        rest = replace(problem, initial=initial.take(remaining))
        motion = advance(rest, np.array([duration_s]), SAFETY * phase_error, nodes=nodes)
        seconds[remaining], outcome[remaining] = motion.seconds, motion.outcome
    if duration_s < 0:
        outcome[problem.at_rest] = Outcome.PAST_UNKNOWN
    return Heights(seconds, outcome)


def _count_by_split_kernel(
    problem: Problem, duration_s: float, nodes: histogram.Nodes, seconds: np.ndarray
) -> np.ndarray:
    """Write into `seconds` (n, bins) the histograms of motions that suit the split kernel; return the indices of the others.

    It computes motions with one body, without torques, forward in time. It needs many steps if moments of inertia differ much or
    wheels turn fast; then the Taylor kernel takes less time. It also reports motions that it cannot compute well.
    """
    every = np.arange(len(problem.initial))
    if problem.acting.torques or problem.initial.bodies is not None or not duration_s > 0:
        return every
    arrays, bodies = problem.in_arrays(), problem.bodies
    omega, speeds = arrays.omega_B, arrays.speeds
    with np.errstate(over="ignore", invalid="ignore"):
        momentum = total_momentum(bodies, omega, speeds)
        size = np.linalg.norm(momentum, axis=1)
        axial = axial_momenta(bodies, omega, speeds)
        # mean of the rates at the start and once all wheels have come to rest
        later = symmetric_product(problem.modes[:, 0, 1:], momentum)
        rate = 0.5 * (np.linalg.norm(omega, axis=1) + np.linalg.norm(later, axis=1))
        frame = principal.frames(problem.vehicle, bodies)
        # steps of either kernel, at least those that the nodes of the histogram need
        ways = np.maximum(rate * duration_s / nodes.tolerance, histogram.MIN_WAYS)
        steps = principal.split_steps(bodies, frame, (size, axial), duration_s, SPLIT_PHASE_ERROR)
        steps = np.ceil(np.maximum(steps, ways / split.WAYS))
        by_series = np.maximum(rate * duration_s / RADIANS_A_STEP, histogram.MIN_WAYS / 3)
        # a comparison with NaN is false: states that are not finite are left to the Taylor kernel
        chosen = np.flatnonzero(steps < SPLIT_ADVANTAGE * by_series)
    of_chosen = arrays._replace(
        omega_B=omega[chosen], sun_B=arrays.sun_B[chosen], speeds=speeds[chosen]
    )
    answer = split.run(of_chosen, steps[chosen], duration_s, plain(frame), nodes)
    seconds[chosen] = answer.hist
    return np.setdiff1d(every, chosen[~answer.again])


def half_spaces(counted: DirectionSet | None) -> tuple[np.ndarray, np.ndarray]:
    """Return the conditions of a set of directions as the kernels read them: normals (n, 3), and where each clause ends (n_clause).

    A direction counts if in some clause its products with all normals are positive. Each clause has an even number of normals, the
    last one twice if need be. Both arrays are empty if all directions count: without a set, or if a clause has no conditions.
    """
    nothing = np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    if counted is None or any(not clause for clause in counted.clauses):
        return nothing
    normals: list[np.ndarray] = []
    ends = []
    for clause in counted.clauses:
        sides = [counted.normals_B[k] * (1.0 if side else -1.0) for k, side in clause]
        normals += sides + sides[-1:] * (len(sides) % 2)
        ends.append(len(normals))
    return np.array(normals), np.array(ends, dtype=np.int64)


def check_errors(error: float | None, emd_error: float | None) -> None:
    """Raise InputError for an error that cannot be met, and if both are given."""
    if error is not None and emd_error is not None:
        raise InputError(
            "ask for an error of the direction or of the EMD", got="both", do="give one of them"
        )
    for name, value, smallest in (
        ("direction_error", error, SMALLEST_DIRECTION_ERROR),
        ("emd_error", emd_error, SMALLEST_EMD_ERROR),
    ):
        if value is not None and not smallest <= value < np.inf:
            raise InputError(f"{name} must be at least {smallest:g}", got=value, do="ask for less")


@dataclass(frozen=True)
class Problem:
    """Motions to be computed: a vehicle, n initial states, one command per wheel, and the torques that act."""

    vehicle: Vehicle
    initial: Rows
    commands: tuple[str, ...]
    acting: Acting = NOTHING

    def __post_init__(self) -> None:
        """Raise MotionError for more wheels than the kernels have room for."""
        n_wheels = len(self.vehicle.wheels)
        if n_wheels > rows.WHEELS:
            raise MotionError(
                f"a vehicle may have {rows.WHEELS} wheels at most", got=f"{n_wheels} wheels"
            )

    @cached_property
    def bodies(self) -> Bodies:
        """Return inertia and friction of the bodies, leading shape (n,) or (1,)."""
        return self.initial.bodies_of(self.vehicle)

    @cached_property
    def speeds(self) -> np.ndarray:
        """Return the wheel speeds at the start (n, n_wheel), rad/s."""
        speeds = np.asarray(self.initial.wheel_speed_rad_s, dtype=np.float64)
        return np.ascontiguousarray(speeds.reshape(len(self.initial), len(self.vehicle.wheels)))

    @cached_property
    def driven(self) -> np.ndarray:
        """Return whether a motor holds the speed of each wheel (n_wheel)."""
        return np.array([command == "hold" for command in self.commands], dtype=bool)

    @cached_property
    def dry(self) -> np.ndarray:
        """Return the limit of dry friction and brake of each wheel (n or 1, n_wheel), N m."""
        limits = np.array(self.bodies.coulomb_N_m, dtype=np.float64)
        for i, (wheel, command) in enumerate(zip(self.vehicle.wheels, self.commands, strict=True)):
            limits[:, i] = friction_limit(wheel, command, limits[:, i])
        return limits

    @property
    def at_rest(self) -> np.ndarray:
        """Return whether any wheel of each motion (n) begins at rest and may be held there by friction."""
        return ((self.speeds == 0) & (self.dry > 0) & ~self.driven).any(axis=-1)

    @cached_property
    def modes(self) -> np.ndarray:
        """Return what depends on which wheels turn freely, for every set of them: (n or 1, 2^n_wheel, 7).

        First SPIN, 1/(kg m2), of the part SPIN H of omega that the Taylor kernel treats apart
        (:mod:`~sunspin.dynamics.kernels.flow`); then the six elements of A^-1. SPIN is half way between the extreme 1 / moments, so
        that the rest of omega is slowest.
        """
        sets = principal.free_sets(len(self.vehicle.wheels))
        inertia = np.stack([free_inertia(self.bodies, free) for free in sets], axis=1)
        smallest, largest = extreme_eigenvalues(inertia)
        spin = 0.5 / smallest + 0.5 / largest
        return np.concatenate([spin[..., None], symmetric_inverse(inertia)], axis=-1)

    @property
    def torques(self) -> int:
        """Return which torques act, as a code of :mod:`kernels.rows`; `acting.torques` are the torques themselves."""
        if self.acting.needs_attitude:
            return rows.GRADIENT
        return rows.STEADY if self.acting.torques else rows.NO_TORQUE

    def nadir(self) -> np.ndarray:
        """Return the nadir and its rate of rotation (n, 2, 3), body axes at the start; zero (1, 2, 3) if no torque needs them."""
        if self.torques != rows.GRADIENT:
            return np.zeros((1, 2, 3))
        if self.initial.B_from_N is None:
            raise InputError(
                "torques that depend on directions need the attitude of each row",
                do="give B_from_N",
            )
        from scipy.spatial.transform import Rotation

        matrices = Rotation.from_quat(self.initial.B_from_N).as_matrix()
        return self.acting.nadir_B(matrices, self.acting.start_s).reshape(-1, 2, 3)

    def in_arrays(self) -> rows.Motions:
        """Return initial states and bodies as arrays for the kernels."""
        bodies = self.bodies
        wheels = np.stack([bodies.wheel_inertia_kg_m2, self.dry, bodies.viscous_N_m_s], axis=-1)
        return rows.Motions(
            *map(plain, (self.initial.omega_B, self.initial.sun_B, self.speeds)),
            plain(bodies.inertia_kg_m2),
            plain(wheels),
            plain(bodies.axes_B),
            self.driven,
            plain(self.modes),
            plain(self.acting.steady(bodies)),
            plain(self.nadir()),
            self.acting.gradient_strength(),
        )


def plain(values: npt.ArrayLike) -> np.ndarray:
    """Return values as a contiguous, writable float64 array: for another kind a kernel would be compiled once more."""
    return np.require(values, np.float64, ["C", "W"])


def advance(
    problem: Problem,
    ends: np.ndarray,
    error: float,
    attitude: bool = False,
    room: int = 0,
    nodes: histogram.Nodes | None = None,
) -> Motion:
    """Compute motions with the Taylor kernel, without the checks of :func:`run`.

    `ends` (n_out): output times, s after the start. `error`: of H as a part of |H|, and of directions (rad), at the last time.
    `room`: number of wheel events to keep; a motion with more ends there. 0: none are kept. With `nodes`, a histogram of the Sun's
    height is counted.
    """
    n, n_wheels = len(problem.initial), len(problem.vehicle.wheels)
    size = 9 + 2 * n_wheels + (6 if attitude else 0)
    arrays = problem.in_arrays()
    if nodes is not None and problem.torques:
        # a histogram rotates directions about H, which torques move: no part of omega is treated apart
        arrays.modes[..., 0] = 0.0
    duration = abs(float(ends[-1]))
    # order 14 takes 6 to 9 % less time than 17 for directions to 1e-4 or 1e-3 rad; a histogram needs short steps in any case
    precise = 17 if error > 1e-9 else 20
    task = rows.Task(
        ends=plain(ends),
        order=14 if error > LOOSE_ERROR and nodes is None else precise,
        allowed=error / duration if duration else 1.0,
        torques=problem.torques,
        attitude=attitude,
        most_events=room or MOST_EVENTS,
        most_steps=MAX_STEPS,
    )
    bins = 0 if nodes is None else len(nodes.hist) // rows.L
    answer = rows.Answer(
        states=np.zeros((n, len(ends), size)),
        last=np.zeros((n, size)),
        outcome=np.zeros(n, dtype=np.int64),
        events=np.zeros((n, room, 3)),
        n_events=np.zeros(n, dtype=np.int64),
        steps=np.zeros(n, dtype=np.int64),
        hist=np.zeros((n, bins), dtype=np.float32),
    )
    # the order in which the kernel takes the motions, fast ones first, as they need most steps; and how many it has taken
    speed = np.nan_to_num(np.abs(arrays.omega_B).sum(axis=1))
    queue = np.append(np.argsort(-speed, kind="stable"), 0)
    work = new_nodes(*half_spaces(None), 1.0, 0) if nodes is None else nodes
    motions.run(queue, arrays, task, answer, work)
    return Motion(*answer, n_wheels)


def steps_needed(problem: Problem, duration_s: float) -> tuple[float, float]:
    """Return about how many steps the longest of the motions takes, and its rate of rotation (rad/s).

    The rate is that at the start or, if larger, that once the wheels' momentum is the body's. The rate of the nutation that each
    wheel causes is added.
    """
    bodies, omega = problem.bodies, problem.initial.omega_B
    with np.errstate(over="ignore", invalid="ignore"):
        momentum = total_momentum(bodies, omega, problem.speeds)
        rate = problem.modes[:, 0, 0] * np.linalg.norm(momentum, axis=-1)
        rate = np.maximum(np.linalg.norm(omega, axis=1), rate)
        # a wheel's momentum h u turns omega about itself by about |A^-1 u| h
        for i, axis in enumerate(bodies.axes_B):
            response = symmetric_product(problem.modes[:, -1, 1:], axis)
            spin = bodies.wheel_inertia_kg_m2[:, i] * np.abs(problem.speeds[:, i])
            rate = rate + np.linalg.norm(response, axis=-1) * spin
    fastest = float(np.nan_to_num(rate).max(initial=0.0))
    return fastest * abs(duration_s) / RADIANS_A_STEP, fastest


def require_followable(problem: Problem, duration_s: float) -> None:
    """Raise MotionError for motions that would take more than `MAX_STEPS` steps."""
    steps, rate = steps_needed(problem, duration_s)
    if steps > MAX_STEPS:
        raise MotionError(
            f"a run of {duration_s:g} s at {rate:.3g} rad/s ({np.degrees(rate):.3g} deg/s) needs "
            f"{steps:.3g} steps",
            do="shorten the window, or check the unit of the rates: rad/s, not deg/s",
        )
