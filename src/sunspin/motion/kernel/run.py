"""Many trajectories at once: rows of initial states into blocks of lanes, blocks through the compiled kernels.

The step of a row is a function of that row alone; a block holds one rung of the ladder of steps and is padded with copies of
its last row. So the bits of a row do not depend on its neighbours, on the number of threads or on how rows are cut into
chunks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sunspin.errors import InputError, sentence
from sunspin.motion import gyrostat as g
from sunspin.motion import modes as m
from sunspin.motion.kernel import codegen as c
from sunspin.motion.kernel import principal
from sunspin.motion.kernel.compiled import Outcome, kernel
from sunspin.motion.kernel.cuda import Group, require_device
from sunspin.motion.kernel.cuda import launch as launch_cuda
from sunspin.motion.kernel.steps import SEGMENTS, UNEVEN, Accuracy, Rows, accuracy, common_spin, free_inertias, plan, segments
from sunspin.vehicle import Vehicle


@dataclass(frozen=True)
class Mask:
    """Directions that count: a disjunction of conjunctions of (panel index, lit?) over panel normals (n, 3)."""

    normals_B: np.ndarray
    clauses: tuple[c.Literals, ...]


def structure_of(vehicle: Vehicle, mask: Mask | None, bins: int, method: str = "series") -> c.Structure:
    """What the source of the kernel for these rows depends on."""
    axes = tuple(tuple(c.component(x) for x in wheel.axis_B) for wheel in vehicle.wheels)
    oblique = method == "split" and principal.is_oblique(vehicle)
    if mask is None or not bins:
        return c.Structure(axes, bins=bins, method=method, oblique=oblique)
    normals = tuple(tuple(c.component(x) for x in normal) for normal in mask.normals_B)
    return c.Structure(axes, normals, mask.clauses, bins, method, oblique)


def _wheel_modes(vehicle: Vehicle, rows: Rows, commands: Sequence[str]) -> Iterator[tuple[np.ndarray, list[m.WheelState]]]:
    """Rows that begin with their wheels in the same mode, and that mode."""
    speeds = np.asarray(rows.wheel_speed_rad_s, dtype=np.float64)
    held = np.array([command == "hold" for command in commands], dtype=bool)
    keys = np.where(held, speeds, np.sign(speeds))
    _, first, group = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(group.ravel(), kind="stable")
    edges = np.searchsorted(group.ravel()[order], np.arange(1, len(first)))
    for row, members in zip(first, np.split(order, edges), strict=True):
        wheels = zip(vehicle.wheels, commands, speeds[row], strict=True)
        yield members, [m.state_under(wheel, command, float(speed)) for wheel, command, speed in wheels]


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
    """The kernel's row of numbers for each trajectory, (n, rows)."""
    layout = c.RowLayout(len(vehicle.wheels))
    work = np.zeros((len(rows), layout.count))
    work[:, :3] = g.total_momentum(vehicle, rows.omega_B, rows.wheel_speed_rad_s)
    work[:, 3 : layout.r] = g.axial_momenta(vehicle, rows.omega_B, rows.wheel_speed_rad_s)
    work[:, layout.r : layout.n_state] = rows.sun_B
    dry = [m.friction_limit(wheel, command) for wheel, command in zip(vehicle.wheels, commands, strict=True)]
    modes = mode_table(vehicle)
    for members, states in _wheel_modes(vehicle, rows, commands):
        p = m.parameters(vehicle, states)
        free = sum(1 << i for i, state in enumerate(states) if state.turning is m.Turning.FREE)
        values = [*modes[free], *p.held_momentum, *_wheel_rows(vehicle, states, p, dry)]
        work[np.ix_(members, np.arange(layout.spin, layout.count))] = values
    return work


def mode_table(vehicle: Vehicle) -> np.ndarray:
    """For every set of free wheels, (2^n, 19): spin, inverse inertia, principal inverse moments and axes."""
    table = []
    for inertia, frame in zip(free_inertias(vehicle), principal.frames(vehicle), strict=True):
        inverse = g.inverse_elements(inertia)
        table.append([common_spin(inverse), *inverse, *frame.inverse, *frame.axes.ravel()])
    return np.array(table)


def check_commands(vehicle: Vehicle, wheel_mode: str | Sequence[str]) -> tuple[str, ...]:
    """One constant command per wheel."""
    plan = m.schedules(vehicle, wheel_mode)
    if any(len(schedule) > 1 for schedule in plan):
        raise InputError(sentence("an ensemble runs with one command per wheel", got=wheel_mode, do="chain two runs"))
    return tuple(schedule[0][1] for schedule in plan)


@dataclass(frozen=True)
class BlockResult:
    """What the kernels return for some rows.

    hist (n, bins): time that counts, in s, by r_z over [-1, 1]; track (n, n_out, n_state): H, h, r;
    outcome (n); steps (n) and method (n) as planned; evenness (n): smallest over largest speed squared of H in body axes.
    """

    hist: np.ndarray
    track: np.ndarray
    outcome: np.ndarray
    steps: np.ndarray
    method: np.ndarray
    evenness: np.ndarray


def _launch(
    structure: c.Structure, work: np.ndarray, groups: list[Group], modes: np.ndarray, normals: np.ndarray, result: BlockResult
) -> None:
    """Run groups of rows of `work` on the processor and put what they give into `result`."""
    run = kernel(structure).run
    for index, parts in groups:
        run(work, index, modes, normals, *parts, result.hist, result.track, result.outcome, result.evenness)


def run_rows(
    vehicle: Vehicle,
    rows: Rows,
    duration_s: np.ndarray | float,
    *,
    wheel_mode: str | Sequence[str] = "coast",
    direction_error: float | None = None,
    emd_error: float | None = None,
    mask: Mask | None = None,
    bins: int = 0,
    min_steps: int = 1,
    device: str = "cpu",
) -> BlockResult:
    """Run rows through the kernels on the calling thread (the GIL is released inside), or on a GPU.

    Parameters
    ----------
    duration_s : number or (n_out,)
        Length of the run in s, or increasing (decreasing: backward) times of output, counted from the start of the run.
    direction_error : float, optional
        Error wanted of the Sun's direction at the end, rad; 1e-5 unless given.
    emd_error : float, optional
        Instead, for a histogram: error wanted of the EMD to whatever distribution. The direction at the end may then be far
        out where the distribution is not.
    bins : int
        Bins of the histogram of r_z over [-1, 1] (0: none, and `track` is filled).
    min_steps : int
        At least this many steps over the whole run.
    device : "cpu" or "cuda"
        Where the rows run: with the same steps, and within the same errors, but not to the same bits.

    Raises
    ------
    InputError
        Output times that go to and fro, an error that cannot be met, a device that is not there.
    """
    require_device(device)
    ends = np.atleast_1d(np.asarray(duration_s, dtype=np.float64))
    gaps = np.diff(ends, prepend=0.0)
    if not (np.all(gaps >= 0) or np.all(gaps <= 0)):
        raise InputError(sentence("output times must all increase or all decrease from the start of the run", got=ends))
    if emd_error is not None and not bins:
        raise InputError(sentence("an EMD needs a histogram", got="bins = 0"))
    wanted = accuracy(direction_error, emd_error)
    commands = check_commands(vehicle, wheel_mode)
    n, layout = len(rows), c.RowLayout(len(vehicle.wheels))
    work, modes = work_array(vehicle, rows, commands), mode_table(vehicle).ravel()
    normals = np.zeros(0, np.float32) if mask is None else np.asarray(mask.normals_B, dtype=np.float32).ravel()
    result = BlockResult(
        np.zeros((n, bins), dtype=np.float32), np.zeros((n, 0 if bins else ends.size, layout.n_state)),
        np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64), np.full(n, "series"), np.ones(n),
    )  # fmt: skip

    def go(which: np.ndarray, accuracy: Accuracy) -> None:
        todo = plan(vehicle, rows.take(which), commands, float(ends[-1]), accuracy, bool(bins), min_steps)
        result.steps[which], result.method[which] = todo.steps, todo.method
        by_method: dict[str, list[Group]] = {}
        for group, method, steps, ratio in todo.groups():
            parts = segments(ends, steps, ratio, SEGMENTS, growing=bool(ends[-1] < 0))
            by_method.setdefault(method, []).append((which[group], parts))
        for method, groups in by_method.items():
            launch = launch_cuda if device == "cuda" else _launch
            launch(structure_of(vehicle, mask, bins, method), work, groups, modes, normals, result)

    go(np.arange(n), wanted)
    sensitive = np.flatnonzero((result.method == "split") & ~(result.evenness > UNEVEN) & (result.outcome == Outcome.FINE))
    if sensitive.size:
        go(sensitive, wanted.with_true_phase())
    return result
