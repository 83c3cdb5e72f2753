"""Many trajectories at once: rows of initial states into blocks of lanes, blocks through the compiled kernels.

The step of a row is a function of that row alone; a block holds one rung of the ladder of steps and is padded with copies of
its last row. So a row does not depend on its neighbours, on the number of threads or on how rows are cut into
chunks.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sunspin.base.errors import InputError
from sunspin.dynamics import wheel_modes as m
from sunspin.dynamics.ensemble import codegen as c
from sunspin.dynamics.ensemble import principal
from sunspin.dynamics.ensemble.ahead import compile_ahead, ready_kernel
from sunspin.dynamics.ensemble.compiled import Outcome
from sunspin.dynamics.ensemble.rows import Rows, mode_table, work_array
from sunspin.dynamics.ensemble.steps import (
    MAX_STEPS,
    SEGMENTS,
    UNEVEN,
    Scales,
    plan,
    segments,
)
from sunspin.dynamics.ensemble.tolerance import Accuracy, accuracy
from sunspin.dynamics.torques import NOTHING, Acting
from sunspin.dynamics.torques.acting import Torque, spun
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.planes import DirectionSet

Group = tuple[np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]
"""Numbers of rows with the same plan, and its segments: steps, their lengths (s), outputs due."""

Mask = DirectionSet
"""Directions that count."""


def structure_of(
    vehicle: Vehicle,
    mask: Mask | None,
    bins: int,
    method: str = "series",
    own_bodies: bool = False,
    torques: tuple[Torque, ...] = (),
) -> c.Structure:
    """What the source of the kernel depends on, for rows with the vehicle's own numbers or with theirs; `InputError` for torques
    that turn H in space with the method that keeps it."""
    if torques and method == "split":
        names = ", ".join(torque.name for torque in torques)
        raise InputError(
            "the split method keeps the momentum, which torques change",
            got=names,
            do="run by series",
        )
    axes = tuple(c.components(wheel.axis_B) for wheel in vehicle.wheels)
    oblique = method == "split" and (own_bodies or principal.is_oblique(vehicle))
    if mask is None or not bins:
        return c.Structure(axes, bins=bins, method=method, oblique=oblique, torques=torques)
    normals = tuple(c.components(normal) for normal in mask.normals_B)
    return c.Structure(axes, normals, mask.clauses, bins, method, oblique, torques)


def prepare(
    vehicle: Vehicle, runs: Iterable[tuple[Mask | None, int]], torques: tuple[Torque, ...] = ()
) -> None:
    """Have the kernels for runs with these masks and numbers of bins compiled, in another process, while this one goes on."""
    compile_ahead(structures(vehicle, runs, torques))


def structures(
    vehicle: Vehicle, runs: Iterable[tuple[Mask | None, int]], torques: tuple[Torque, ...] = ()
) -> Iterator[c.Structure]:
    """Of the kernels for runs with these masks and numbers of bins."""
    for mask, bins in runs:
        for method in ("split", "series") if bins and not torques else ("series",):
            yield structure_of(vehicle, mask, bins, method, torques=torques)


def check_commands(vehicle: Vehicle, wheel_mode: str | Sequence[str]) -> tuple[str, ...]:
    """One constant command per wheel."""
    plan = m.schedules(vehicle, wheel_mode)
    if any(len(schedule) > 1 for schedule in plan):
        raise InputError(
            "an ensemble runs with one command per wheel", got=wheel_mode, do="chain two runs"
        )
    return tuple(schedule[0][1] for schedule in plan)


@dataclass(frozen=True)
class BlockResult:
    """What the kernels return for some rows.

    hist (n, bins): time that counts, in s, by r_z over [-1, 1]; track (n, n_out, ...): what `RowLayout` tells at the output
    times, in body axes, told apart by the properties;
    outcome (n); steps (n) and method (n) as planned; evenness (n): smallest over largest speed squared of H in body axes.
    """

    hist: np.ndarray
    track: np.ndarray
    outcome: np.ndarray
    steps: np.ndarray
    method: np.ndarray
    evenness: np.ndarray
    layout: c.RowLayout

    def _part(self, begin: int, count: int) -> np.ndarray:
        return self.track[..., begin : begin + count]

    @property
    def momentum_B(self) -> np.ndarray:
        """H (n, n_out, 3) in N m s."""
        return self._part(0, 3)

    @property
    def axial_momenta(self) -> np.ndarray:
        """h (n, n_out, n_wheel) in N m s."""
        return self._part(self.layout.h, self.layout.n_wheels)

    @property
    def sun_B(self) -> np.ndarray:
        """r (n, n_out, 3)."""
        return self._part(self.layout.r, 3)

    @property
    def carried(self) -> np.ndarray:
        """What torques need of directions (n, n_out, n_carried), as :class:`sunspin.dynamics.torques.Acting` has it."""
        return self._part(self.layout.r + 3, max(self.layout.n_more - 1, 0))

    @property
    def omega_B(self) -> np.ndarray:
        """Body rates (n, n_out, 3) in rad/s."""
        return self._part(self.layout.n_state, 3)

    @property
    def wheel_speed_rad_s(self) -> np.ndarray:
        """Relative to the body (n, n_out, n_wheel); exactly zero where friction holds the wheel."""
        return self._part(self.layout.n_state + 3, self.layout.n_wheels)


def _launch(
    structure: c.Structure,
    work: np.ndarray,
    groups: list[Group],
    modes: np.ndarray,
    normals: np.ndarray,
    result: BlockResult,
) -> None:
    """Run groups of rows of `work` on the processor and put what they give into `result`."""
    run = ready_kernel(structure).run
    for index, parts in groups:
        run(
            work,
            index,
            modes,
            normals,
            *parts,
            result.hist,
            result.track,
            result.outcome,
            result.evenness,
        )


def run_rows(
    vehicle: Vehicle,
    rows: Rows,
    duration_s: npt.ArrayLike,
    *,
    wheel_mode: str | Sequence[str] = "coast",
    direction_error: float | None = None,
    emd_error: float | None = None,
    mask: Mask | None = None,
    bins: int = 0,
    min_steps: int = 1,
    acting: Acting = NOTHING,
    leave_long: bool = False,
) -> BlockResult:
    """Run rows through the kernels on the calling thread (the GIL is released inside).

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
    acting : Acting
        Torques from outside, in an environment in which the rows have their attitudes. They run by series.
    leave_long : bool
        Return rows that need more than `MAX_STEPS` steps with `Outcome.NOT_FINITE` and a track of NaN, instead of refusing all
        rows.

    Raises
    ------
    InputError
        Output times that go to and fro, an error that cannot be met, rows without the attitude that
        torques need.
    MotionError
        A row that needs too many steps, unless `leave_long`.
    """
    ends = np.atleast_1d(np.asarray(duration_s, dtype=np.float64))
    gaps = np.diff(ends, prepend=0.0)
    if not (np.all(gaps >= 0) or np.all(gaps <= 0)):
        raise InputError(
            "output times must all increase or all decrease from the start of the run", got=ends
        )
    if emd_error is not None and not bins:
        raise InputError("an EMD needs a histogram", got="bins = 0")
    wanted = accuracy(direction_error, emd_error)
    commands = check_commands(vehicle, wheel_mode)
    n, layout = len(rows), c.RowLayout.under(acting.torques, len(vehicle.wheels))
    modes = mode_table(vehicle, rows.bodies_of(vehicle), with_frames=bool(bins))
    if acting.torques and not spun(acting.torques):
        modes[..., 0] = 0.0  # no share of H is taken out of omega where H turns in space
    work = work_array(vehicle, rows, commands, modes, acting)
    normals = np.zeros(0, np.float32) if mask is None else mask.kernel_data
    result = BlockResult(
        np.zeros((n, bins), dtype=np.float32),
        np.zeros((n, 0 if bins else ends.size, layout.n_output)),
        np.zeros(n, dtype=np.int64),
        np.zeros(n, dtype=np.int64),
        np.full(n, "series"),
        np.ones(n),
        layout,
    )

    def go(which: np.ndarray, accuracy: Accuracy) -> None:
        scales = Scales(vehicle, rows.take(which), commands, acting)
        most = np.inf if leave_long else MAX_STEPS
        todo = plan(scales, float(ends[-1]), accuracy, bool(bins), min_steps, most)
        if leave_long and (long := todo.steps > MAX_STEPS).any():
            result.outcome[which[long]], result.track[which[long]] = Outcome.NOT_FINITE, np.nan
            if not long.all():
                go(which[~long], accuracy)
            return
        result.steps[which], result.method[which] = todo.steps, todo.method
        by_method: dict[str, list[Group]] = {}
        for group, method, steps, ratio in todo.groups():
            parts = segments(ends, steps, ratio, SEGMENTS, growing=bool(ends[-1] < 0))
            by_method.setdefault(method, []).append((which[group], parts))
        for method, groups in by_method.items():
            structure = structure_of(
                vehicle, mask, bins, method, rows.bodies is not None, acting.torques
            )
            _launch(structure, work, groups, modes, normals, result)

    go(np.arange(n), wanted)
    sensitive = np.flatnonzero(
        (result.method == "split") & ~(result.evenness > UNEVEN) & (result.outcome == Outcome.FINE)
    )
    if sensitive.size:
        go(sensitive, wanted.with_true_phase())
    return result
