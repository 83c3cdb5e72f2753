"""The paper, computed step by step from the telemetry given: every result as data, and a row for each published figure.

A step is a module of this folder: its `compute`, and `rows` that compare with the paper. They count in three sections: what
follows from the telemetry, what the equations and the printed lines give without any, and the paper's own figures. A step that
the telemetry cannot carry is said to be missing, and why.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, as_completed, wait
from dataclasses import dataclass, field, replace
from typing import Any

import xarray as xr

from sunspin.base.errors import InputError, MotionError, TelemetryError
from sunspin.compute.pool import worker_count
from sunspin.dynamics import ensemble as k
from sunspin.estimate.scan.rows import BINS as SCAN_BINS
from sunspin.landing.outcomes import BINS as OUTCOME_BINS
from sunspin.philae import (
    candidates,
    carries,
    collision,
    descent,
    inputs,
    mechanics,
    metrics,
    motions,
    precession,
    published_lines,
    strategies,
    touchdown,
)
from sunspin.philae import rebound as rb
from sunspin.philae import sun_directions as phases
from sunspin.philae.rebound import Options
from sunspin.philae.row import Row, counts, settled, tables
from sunspin.philae.sun_directions import ReadingNoise, with_own_noise
from sunspin.telemetry.case import Case
from sunspin.telemetry.sun import sun_directions
from sunspin.vehicle import Vehicle

LANDING_RUNS = 5_000
"""Simulated collisions: their probabilities err by 0.007 at most, ten times what the paper had; `sunspin outcomes` runs more."""

LEAST_RUNS = 400
"""As many as the paper had."""

STEPS_AT_ONCE = 2
"""More would keep more memory and gain nothing: the rows of each step take all cores."""

SECTIONS = {
    "telemetry": "From this telemetry",
    "no_telemetry": "The equations and the printed lines: no telemetry",
    "paper": "The paper's own figures",
}
"""What is counted apart. Nothing in the second and third changes with the telemetry."""


@dataclass(frozen=True)
class Reproduction:
    """All results of the Philae study, each by the name of its step.

    `noise`: what the file's readings were taken for; `options`: how the study was run; `missing`: why a step could not be
    computed.
    """

    case: Case
    options: Options
    noise: ReadingNoise
    sun: xr.Dataset
    parts: dict[str, Any] = field(default_factory=dict)
    rows_by_part: dict[str, list[Row]] = field(default_factory=dict)
    missing: dict[str, str] = field(default_factory=dict)

    @property
    def seed(self) -> int:
        return self.options.seed

    @property
    def synthetic(self) -> bool:
        return bool(self.sun.attrs.get("synthetic"))

    @property
    def chain(self) -> candidates.Chain | None:
        """The motions from which the conclusions follow; None where nothing can be concluded."""
        return self.parts.get("candidates")

    @property
    def runs(self) -> int:
        """Simulated collisions."""
        return max(LANDING_RUNS // self.options.coarser, LEAST_RUNS)

    @property
    def rows(self) -> list[Row]:
        """All rows, in the order of the steps."""
        return [row for rows in self.rows_by_part.values() for row in rows]

    def row(self, name: str) -> Row:
        """The row with this id."""
        return next(row for row in self.rows if row.id == name)

    def counts(self) -> dict[str, dict[str, int]]:
        """For each section of `SECTIONS` how many rows agree, differ, are uninformative, and how many are of another kind."""
        of_section: dict[str, list[Row]] = {name: [] for name in SECTIONS}
        for step in STEPS:
            of_section[step.section] += self.rows_by_part.get(step.name, [])
        return {name: counts(rows) for name, rows in of_section.items()}


@dataclass(frozen=True)
class Step:
    """One step of the study.

    Attributes
    ----------
    name, title : of the step
    section : of `SECTIONS`
    compute, rows : its result from what there is so far, and the rows of its result
    needs : steps without which it cannot be computed
    uses : steps that it waits for and can do without
    needed : whether the study makes no sense without it
    """

    name: str
    title: str
    section: str
    compute: Callable[[Reproduction], Any]
    rows: Callable[[Any], list[Row]] = lambda _: []
    needs: tuple[str, ...] = ()
    uses: tuple[str, ...] = ()
    needed: bool = False


def _collision(s: Reproduction) -> collision.AfterCollision:
    o, chain = s.options, s.parts["candidates"]
    return collision.compute(s.case, chain, s.runs, o.seed, workers=o.workers)


def _strategies(s: Reproduction) -> strategies.Strategies:
    o, chain = s.options, s.parts["candidates"]
    return strategies.compute(s.case, chain, max(s.runs // 5, 1), o.seed, workers=o.workers)


STEPS = (
    Step(
        "phases",
        "Sections 2.1 and 4: Sun directions, lit panels",
        "telemetry",
        lambda s: phases.compute(s.case),
        phases.rows,
        needed=True,
    ),
    Step(
        "descent",
        "Section 3.1: the descent",
        "telemetry",
        lambda s: descent.compute(s.case, s.sun),
        descent.rows,
    ),
    Step(
        "carries",
        "Data check",
        "telemetry",
        lambda s: carries.compute(s.case, s.sun, s.parts.get("descent"), s.seed),
        carries.rows,
        uses=("descent",),
        needed=True,
    ),
    Step(
        "level_set",
        "Section 2.3: the scan of this telemetry",
        "telemetry",
        lambda s: metrics.scan_telemetry(s.case, s.sun, s.options),
        metrics.scan_rows,
    ),
    Step(
        "candidates",
        "Section 2.3: the motions that follow",
        "telemetry",
        lambda s: candidates.compute(s.parts["level_set"], s.parts["carries"], s.options),
        needs=("level_set", "carries"),
    ),
    Step(
        "touchdown",
        "Section 3.2: after the first touchdown",
        "telemetry",
        lambda s: s.parts["candidates"],
        touchdown.rows,
        needs=("candidates",),
    ),
    Step(
        "collision",
        "Section 3.3: after the collision",
        "telemetry",
        _collision,
        collision.rows,
        needs=("candidates",),
    ),
    Step(
        "strategies",
        "Section 4: wheel strategies",
        "telemetry",
        _strategies,
        strategies.rows,
        needs=("candidates",),
    ),
    Step(
        "sensitivity",
        "Section 2.3: why a direct fit fails",
        "no_telemetry",
        lambda s: metrics.sensitivity(s.case, s.sun, s.options),
        metrics.sensitivity_rows,
    ),
    Step(
        "motions",
        "The motion to look at",
        "telemetry",
        lambda s: motions.compute(s.case, s.parts, s.seed, s.options.workers),
        needs=("candidates", "level_set"),
        uses=("descent",),
    ),
    Step(
        "mechanics",
        "Section 2.2: wheel and example motions",
        "no_telemetry",
        lambda s: mechanics.compute(s.case),
        mechanics.rows,
        needed=True,
    ),
    Step(
        "published_lines",
        "The published lines through our equations",
        "no_telemetry",
        lambda s: published_lines.compute(s.case, s.parts.get("level_set"), s.runs, s.options),
        published_lines.rows,
        uses=("level_set",),
        needed=True,
    ),
    Step(
        "precession",
        "Section 3.2: precession on the published lines",
        "no_telemetry",
        lambda s: precession.compute(s.case),
        precession.rows,
    ),
    Step(
        "inputs",
        "Taken over from the paper",
        "paper",
        lambda s: s.case,
        inputs.rows,
        needed=True,
    ),
)
"""In the order of beginning: a step stands after those that it waits for."""


def compute(
    case: Case,
    options: Options | None = None,
    seen: Callable[[Reproduction], Any] | None = None,
    **chosen: Any,
) -> Reproduction:
    """Run the whole chain on the case's telemetry.

    Parameters
    ----------
    case : Case
        With the telemetry to use (`rebound.with_telemetry` to put another file in its place) and the vehicle
        (`with_vehicle`). It must hold samples between the first touchdown and the collision; what else it does not hold is left
        out and named in `missing`.
    options : :class:`sunspin.philae.rebound.Options`, or its fields as keywords
    seen : callable, optional
        Given what there is so far each time that a step is computed.
    """
    options = options or Options(**chosen)
    require_wheel(case.vehicle)
    case, noise = with_own_noise(case)
    sun = sun_directions(case.vehicle, case.telemetry)
    rb.rebound_samples(case, sun)  # refused before the work
    study = Reproduction(case, options, noise, sun)
    k.prepare(case.vehicle, [(rb.counted(case), SCAN_BINS), (None, OUTCOME_BINS)])
    at_once = threading.Semaphore(min(worker_count(options.workers), STEPS_AT_ONCE))
    stopped, futures = threading.Event(), dict[str, Future]()

    def run(step: Step) -> None:
        wait([futures[name] for name in (*step.needs, *step.uses) if name in futures])
        with at_once:
            if stopped.is_set():
                return
            try:
                _run(step, study)
            except BaseException:
                stopped.set()
                raise

    pool = ThreadPoolExecutor(len(STEPS), thread_name_prefix="step")
    try:
        for step in STEPS:
            futures[step.name] = pool.submit(run, step)
        for future in as_completed(futures.values()):
            future.result()
            if seen is not None:
                seen(study)
    finally:
        stopped.set()  # after an interrupt no further step begins
        pool.shutdown(wait=False)
    return _in_order(study)


def _run(step: Step, study: Reproduction) -> None:
    """Compute one step and put its result and rows, or why there are none, where the others find them."""
    if not study.parts.keys() >= {*step.needs}:
        study.missing[step.name] = f"{step.title}: nothing is concluded"
        return
    try:
        result = step.compute(study)
        rows = [_settled(row, step, study) for row in step.rows(result)]
    except (TelemetryError, InputError, MotionError) as error:
        if step.needed or (isinstance(error, InputError) and step.name == "candidates"):
            raise
        study.missing[step.name] = f"{step.title}: not reproduced, as {error}"
        return
    study.parts[step.name] = result
    if rows:
        study.rows_by_part[step.name] = rows


def _settled(row: Row, step: Step, study: Reproduction) -> Row:
    """The row with the chain of its section where it names none; put in where the telemetry was made from its figure."""
    row = (
        row
        if row.chain
        else replace(row, chain="telemetry" if step.section == "telemetry" else "none")
    )
    put_in = tables(study.case).get(row.id, {}).get("put_in")
    return settled(row, put_in == "always" or (put_in == "synthetic" and study.synthetic))


def _in_order(study: Reproduction) -> Reproduction:
    """The same with everything in the order of `STEPS`, whichever ended first."""
    rows = dict(study.rows_by_part)
    if "candidates" not in study.parts and "level_set" in rows:
        # nothing is concluded from these readings, nor judged by them
        rows["level_set"] = [
            replace(row, kind=row.kind.replace("test", "not_comparable"), agrees=None)
            for row in rows["level_set"]
        ]

    def ordered(entries: dict[str, Any]) -> dict[str, Any]:
        return {step.name: entries[step.name] for step in STEPS if step.name in entries}

    return replace(
        study,
        parts=ordered(study.parts),
        rows_by_part=ordered(rows),
        missing=ordered(study.missing),
    )


def require_wheel(vehicle: Vehicle) -> None:
    """Refuse a vehicle with which the study makes no sense."""
    vehicle.require_inertia()
    vehicle.require_mass()
    if len(vehicle.wheels) != 1 or not vehicle.legs:
        raise InputError(
            "the study is of a lander with one wheel and legs",
            got=f"{len(vehicle.wheels)} wheels, {len(vehicle.legs)} legs",
            do="copy the vehicle file of philae and change it",
        )


def with_vehicle(case: Case, vehicle: Vehicle, telemetry: xr.Dataset) -> Case:
    """The case with another vehicle, and telemetry read with its columns."""
    return rb.with_telemetry(replace(case, vehicle=vehicle), telemetry)
