"""Many trajectories at once: rows of initial states into blocks of lanes, blocks through the compiled kernel.

The step of a row is a function of that row alone, taken from a fixed ladder; a block holds one rung of the ladder and is
padded with copies of its last row. So the bits of a row do not depend on its neighbours, on the number of threads or on how
rows are cut into chunks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sunspin.errors import InputError, MotionError, sentence
from sunspin.motion import codegen as c
from sunspin.motion import gyrostat as g
from sunspin.motion import modes as m
from sunspin.motion.compiled import Outcome, kernel
from sunspin.vehicle import Vehicle

__all__ = ["BlockResult", "Mask", "Outcome", "Rows", "run_rows"]

LANES = 32
MAX_STEPS = 10**8
LADDER = 2.0**0.25
"""Ratio of neighbouring step counts: at most 19 % more steps than asked for, few enough rungs to fill blocks."""

ERROR_CONSTANT = 3e-6
"""Direction error per radian turned of a step h at rate s is at most this times (s h)^8; measured, see `steps_for`."""

MAX_STEP_ANGLE = 1.0
"""rad turned per step at most: beyond it the error law no longer holds."""


SAMPLES_PER_STEP = 12
"""Samples of r_z in the histogram per step, by interpolation inside the step."""


@dataclass(frozen=True)
class Mask:
    """Directions that count: a disjunction of conjunctions of (panel index, lit?) over panel normals (n, 3)."""

    normals_B: np.ndarray
    clauses: tuple[c.Literals, ...]


@dataclass(frozen=True)
class Rows:
    """Initial states of n trajectories: omega_B (n, 3) rad/s, sun_B (n, 3), wheel speeds (n, n_wheel) rad/s."""

    omega_B: np.ndarray
    sun_B: np.ndarray
    wheel_speed_rad_s: np.ndarray

    def __len__(self) -> int:
        return len(self.omega_B)

    def take(self, index: np.ndarray) -> Rows:
        return Rows(self.omega_B[index], self.sun_B[index], self.wheel_speed_rad_s[index])


def rate_scale(vehicle: Vehicle, rows: Rows) -> np.ndarray:
    """How fast each row turns (n), rad/s: the larger of its rate now and its rate once the wheels' momentum is the body's."""
    momentum = g.total_momentum(vehicle, rows.omega_B, rows.wheel_speed_rad_s)
    later = np.linalg.solve(vehicle.require_inertia(), momentum.T).T
    return np.maximum(np.linalg.norm(rows.omega_B, axis=1), np.linalg.norm(later, axis=1))


def steps_for(vehicle: Vehicle, rows: Rows, duration_s: float, direction_error: float, min_steps: int = 1) -> np.ndarray:
    """Number of steps (n) for each row over `duration_s`, so that the Sun's direction errs by `direction_error` rad.

    At least `min_steps`, rounded up to the ladder.

    The method is of eighth order: the error after turning through an angle s T in steps of angle s h is at most
    ERROR_CONSTANT (s h)^8 s T.
    """
    rate = np.maximum(rate_scale(vehicle, rows), 1e-12)
    turned = rate * abs(duration_s)
    angle = np.minimum((direction_error / (ERROR_CONSTANT * turned)) ** 0.125, MAX_STEP_ANGLE)
    wanted = np.maximum(turned / angle, max(min_steps, 1))
    steps = np.ceil(LADDER ** np.ceil(np.log(wanted) / np.log(LADDER) - 1e-9))
    if steps.max(initial=0) > MAX_STEPS:
        raise MotionError(
            sentence(
                f"a run of {duration_s:g} s at {rate.max():.3g} rad/s needs {steps.max():.3g} steps",
                do="shorten the window, or check the unit of the rates",
            )
        )
    return steps.astype(np.int64)


def structure_of(vehicle: Vehicle, mask: Mask | None, bins: int) -> c.Structure:
    axes = tuple(tuple(c.component(x) for x in wheel.axis_B) for wheel in vehicle.wheels)
    if mask is None:
        return c.Structure(axes, bins=bins, samples=SAMPLES_PER_STEP, lanes=LANES)
    normals = tuple(tuple(c.component(x) for x in normal) for normal in mask.normals_B)
    return c.Structure(axes, normals, mask.clauses, bins, SAMPLES_PER_STEP, LANES)


def _states(vehicle: Vehicle, rows: Rows, commands: Sequence[str]) -> list[list[m.WheelState]]:
    """Wheel states before the first step, one list per row."""
    wheels = list(zip(vehicle.wheels, commands, strict=True))
    return [
        [m.state_under(wheel, command, float(speed)) for (wheel, command), speed in zip(wheels, speeds, strict=True)]
        for speeds in rows.wheel_speed_rad_s
    ]


def _wheel_rows(vehicle: Vehicle, states: list[m.WheelState], p: g.Parameters, dry: Sequence[float]) -> list[float]:
    values: list[float] = []
    for wheel, state, w, limit in zip(vehicle.wheels, states, p.wheels, dry, strict=True):
        free = state.turning is m.Turning.FREE
        watch = state.sign if free and limit > 0 else 0.0
        inverse_limit2 = 1.0 / limit**2 if state.turning is m.Turning.STUCK else 0.0
        values += [*w.axis, w.inverse_inertia, w.free, w.coulomb, w.viscous]
        values += [wheel.inertia_kg_m2, watch, inverse_limit2, limit, 0.0, 0.0]
    return values


def work_array(vehicle: Vehicle, rows: Rows, commands: Sequence[str]) -> np.ndarray:
    """The kernel's rows for each trajectory, (n, rows)."""
    layout = c.Rows(len(vehicle.wheels))
    work = np.zeros((len(rows), layout.count))
    work[:, :3] = g.total_momentum(vehicle, rows.omega_B, rows.wheel_speed_rad_s)
    work[:, 3 : layout.r] = g.axial_momenta(vehicle, rows.omega_B, rows.wheel_speed_rad_s)
    work[:, layout.r : layout.n_state] = rows.sun_B
    dry = [m.friction_limit(wheel, command) for wheel, command in zip(vehicle.wheels, commands, strict=True)]
    cache: dict[tuple, np.ndarray] = {}
    for i, states in enumerate(_states(vehicle, rows, commands)):
        key = tuple((s.turning, s.sign, s.speed if s.turning is m.Turning.HELD else 0.0) for s in states)
        if key not in cache:
            p = m.parameters(vehicle, states)
            cache[key] = np.array([*p.inverse, *p.held_momentum, *_wheel_rows(vehicle, states, p, dry)])
        work[i, layout.inverse :] = cache[key]
    return work


def inverse_table(vehicle: Vehicle) -> np.ndarray:
    """Inverse inertia (2^n, 6) for every set of free wheels (bit i: wheel i is free)."""
    n = len(vehicle.wheels)
    sets = [[bool(mask >> i & 1) for i in range(n)] for mask in range(2**n)]
    return np.array([g.inverse_elements(g.free_inertia(vehicle, free)) for free in sets])


def check_commands(vehicle: Vehicle, wheel_mode: str | Sequence[str]) -> tuple[str, ...]:
    """One constant command per wheel."""
    plan = m.schedules(vehicle, wheel_mode)
    if any(len(schedule) > 1 for schedule in plan):
        raise InputError(sentence("an ensemble runs with one command per wheel", got=wheel_mode, do="chain two runs"))
    return tuple(schedule[0][1] for schedule in plan)


@dataclass(frozen=True)
class BlockResult:
    """What the kernel returns for some rows: histogram (n, bins + 1), track (n, n_out, n_state), outcome (n)."""

    hist: np.ndarray
    track: np.ndarray
    outcome: np.ndarray


def run_rows(
    vehicle: Vehicle,
    rows: Rows,
    duration_s: np.ndarray | float,
    *,
    wheel_mode: str | Sequence[str] = "coast",
    direction_error: float = 1e-5,
    mask: Mask | None = None,
    bins: int = 0,
    min_steps: int = 1,
) -> BlockResult:
    """Run rows through the kernel on the calling thread (the GIL is released inside).

    Parameters
    ----------
    duration_s : number or (n_out,)
        Length of the run in s, or increasing (decreasing: backward) times of output, counted from the start of the run.
    direction_error : float
        Error wanted of the Sun's direction at the end, rad.
    bins : int
        Bins of the histogram of r_z over [-1, 1], filled after every step (0: none).
    min_steps : int
        At least this many steps over the whole run, for a histogram dense enough.
    """
    ends = np.atleast_1d(np.asarray(duration_s, dtype=np.float64))
    gaps = np.diff(ends, prepend=0.0)
    if not (np.all(gaps >= 0) or np.all(gaps <= 0)):
        raise InputError(sentence("output times must all increase or all decrease from the start of the run", got=ends))
    n, n_wheel = len(rows), len(vehicle.wheels)
    layout = c.Rows(n_wheel)
    module = kernel(structure_of(vehicle, mask, bins))
    commands = check_commands(vehicle, wheel_mode)
    work = work_array(vehicle, rows, commands)
    steps = steps_for(vehicle, rows, ends[-1], direction_error, min_steps)
    inverses = np.ascontiguousarray(np.broadcast_to(inverse_table(vehicle).ravel(), (LANES, 6 * 2**n_wheel)))
    normals = np.zeros(0) if mask is None else np.ascontiguousarray(mask.normals_B, dtype=np.float64).ravel()
    hist = np.zeros((n, bins + 1), dtype=np.int32)
    n_out = ends.size if not bins else 0
    track = np.zeros((n, n_out, layout.n_state))
    outcome = np.zeros(n, dtype=np.int64)
    order = np.argsort(steps, kind="stable")
    edges = np.flatnonzero(np.diff(steps[order])) + 1
    for group in np.split(order, edges):
        counts = np.maximum(np.ceil(np.abs(gaps) / abs(ends[-1] or 1.0) * steps[group[0]] - 1e-9), gaps != 0)
        counts = counts.astype(np.int64)
        dts = gaps / np.maximum(counts, 1)
        for start in range(0, len(group), LANES):
            take = group[start : start + LANES]
            lanes = np.append(take, np.full(LANES - len(take), take[-1]))
            block_hist = np.zeros((LANES, bins + 1), dtype=np.int32)
            block_track = np.zeros((n_out, layout.n_state, LANES))
            block_outcome = np.zeros(LANES, dtype=np.int64)
            w = np.ascontiguousarray(work[lanes].T).ravel()
            module.run(w, inverses, normals, counts, dts, block_hist, block_track, block_outcome)
            hist[take] = block_hist[: len(take)]
            track[take] = np.moveaxis(block_track, 2, 0)[: len(take)]
            outcome[take] = block_outcome[: len(take)]
    return BlockResult(hist, track, outcome)
