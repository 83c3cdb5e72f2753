"""The paper, computed step by step from the telemetry given: every result as data, and a row for each published figure.

A step is a function below that calls a section's module, and the rows that compare with the paper. They count in three
sections: what follows from the telemetry, what the equations and the printed lines give without any, and the paper's own
figures. A step that the telemetry cannot carry is said to be missing, and why.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, as_completed, wait
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import xarray as xr

from sunspin.base.errors import InputError, MotionError, TelemetryError
from sunspin.cases import Case
from sunspin.compute.pool import worker_count
from sunspin.dynamics import ensemble as k
from sunspin.estimate.scan.rows import BINS as SCAN_BINS
from sunspin.landing.outcomes import BINS as OUTCOME_BINS
from sunspin.philae import (
    candidates,
    collision,
    data_check,
    descent,
    inputs,
    mechanics,
    metrics,
    motions,
    published_lines,
    strategies,
    sun_directions,
    touchdown,
)
from sunspin.philae.rebound import Options, direction_mask, select_rebound
from sunspin.philae.row import Row, counts, labelled, settled, tables
from sunspin.telemetry import sun as telemetry_sun
from sunspin.vehicle import Vehicle

LANDING_RUNS = 5_000
"""Simulated collisions: their probabilities err by 0.007 at most, ten times what the paper had; `sunspin outcomes` runs more."""

LEAST_RUNS = 400
"""As many as the paper had."""

SECTIONS = {
    "telemetry": "From this telemetry",
    "no_telemetry": "The equations and the printed lines: no telemetry",
    "paper": "The paper's own figures",
}
"""What is counted apart. Nothing in the second and third changes with the telemetry."""


@dataclass(frozen=True)
class Study:
    """All results of the Philae study, each by the name of its step.

    `noise`: what the file's readings were taken for; `missing`: why a step could not be computed.
    """

    case: Case
    options: Options
    noise: sun_directions.ReadingNoise
    sun: xr.Dataset
    parts: dict[str, Any] = field(default_factory=dict)
    rows_by_part: dict[str, list[Row]] = field(default_factory=dict)
    missing: dict[str, str] = field(default_factory=dict)

    @property
    def synthetic(self) -> bool:
        """Whether the telemetry is."""
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

    def counts(self) -> dict[str, dict[str, int]]:
        """For each section of `SECTIONS` how many rows agree, differ, are uninformative, and how many are of another kind."""
        by_part = [(step.section, self.rows_by_part.get(step.name, [])) for step in STEPS]
        return {
            name: counts([row for section, rows in by_part if section == name for row in rows])
            for name in SECTIONS
        }


class Step(NamedTuple):
    """One step of the study.

    `compute`, `rows`: its result from what there is so far, and the rows of that, if any; `section`: of `SECTIONS`; `needs`: steps
    without which it cannot be computed; `uses`: steps that it waits for and can do without; `needed`: whether the study makes no
    sense without it.
    """

    name: str
    title: str
    compute: Callable[[Study], Any]
    rows: Callable[[Any], list[Row]] | None = None
    section: str = "telemetry"
    needs: tuple[str, ...] = ()
    uses: tuple[str, ...] = ()
    needed: bool = False


STEPS: list[Step] = []
"""In the order of beginning: a step stands after those that it waits for."""


def step(title: str, rows: Callable[[Any], list[Row]] | None = None, **about: Any) -> Any:
    """Make a function of the study so far the next step; the function's name is the step's."""

    def add(compute: Any) -> Any:
        STEPS.append(Step(compute.__name__.removeprefix("_"), title, compute, rows, **about))
        return compute

    return add


@step("Sections 2.1 and 4: Sun directions, lit panels", sun_directions.rows, needed=True)
def _phases(s: Study) -> Any:
    return sun_directions.compute(s.case)


@step("Section 3.1: the descent", descent.rows)
def _descent(s: Study) -> Any:
    return descent.compute(s.case, s.sun)


@step("Data check", data_check.rows, uses=("descent",), needed=True)
def _carries(s: Study) -> Any:
    return data_check.compute(s.case, s.sun, s.parts.get("descent"), s.options.seed)


@step("Section 2.3: the scan of this telemetry", metrics.scan_rows)
def _level_set(s: Study) -> Any:
    return metrics.scan_telemetry(s.case, s.sun, s.options)


@step("Section 2.3: the motions that follow", needs=("level_set", "carries"))
def _candidates(s: Study) -> Any:
    return candidates.compute(s.parts["level_set"], s.parts["carries"], s.options)


@step("Section 3.2: after the first touchdown", touchdown.rows, needs=("candidates",))
def _touchdown(s: Study) -> Any:
    return s.chain


@step("The motion to look at", needs=("candidates", "level_set"), uses=("descent",))
def _motions(s: Study) -> Any:
    return motions.compute(s.case, s.parts, s.options.seed)


@step("Section 3.3: after the collision", collision.rows, needs=("candidates",))
def _collision(s: Study) -> Any:
    chain, o = s.parts["candidates"], s.options
    return collision.compute(s.case, chain, s.runs, o.seed, workers=o.workers)


@step("How fast it turned", needs=("collision",), uses=("descent",))
def _speeds(s: Study) -> Any:
    known, seed = s.parts["collision"].known, s.options.seed
    return motions.speeds(s.parts["candidates"], known, s.parts.get("descent"), seed)


@step("Section 4: wheel strategies", strategies.rows, needs=("candidates",))
def _strategies(s: Study) -> Any:
    chain, o = s.parts["candidates"], s.options
    return strategies.compute(s.case, chain, max(s.runs // 5, 1), o.seed, workers=o.workers)


@step("Section 2.3: why a direct fit fails", metrics.sensitivity_rows, section="no_telemetry")
def _sensitivity(s: Study) -> Any:
    return metrics.sensitivity(s.case, s.sun, s.options)


@step("Section 2.2: wheel and example motions", mechanics.rows, section="no_telemetry", needed=True)
def _mechanics(s: Study) -> Any:
    return mechanics.compute(s.case)


@step(
    "The published lines through our equations",
    published_lines.rows,
    section="no_telemetry",
    uses=("level_set",),
    needed=True,
)
def _published_lines(s: Study) -> Any:
    return published_lines.compute(s.case, s.parts.get("level_set"), s.runs, s.options)


@step(
    "Section 3.2: precession on the published lines",
    mechanics.precession_rows,
    section="no_telemetry",
)
def _precession(s: Study) -> Any:
    return mechanics.precession(s.case)


@step("Taken over from the paper", inputs.rows, section="paper", needed=True)
def _inputs(s: Study) -> Any:
    return s.case


def compute(case: Case, seen: Callable[[Study], Any] | None = None, **options: Any) -> Study:
    """Run the whole chain on the case's telemetry.

    Parameters
    ----------
    case : Case
        With the telemetry to use (`rebound.with_telemetry` to put another file in its place). It must hold samples between the
        first touchdown and the collision; what else it does not hold is left out and named in `missing`.
    seen : callable, optional
        Given what there is so far each time that a step is computed, in the caller's thread, while other steps go on.
    options
        Of :class:`sunspin.philae.rebound.Options`.
    """
    require_wheel(case.vehicle)
    case, noise = sun_directions.with_own_noise(case)
    sun = telemetry_sun.sun_directions(case.vehicle, case.telemetry)
    select_rebound(case, sun)  # refused before the work
    study = Study(case, Options(**options), noise, sun)
    k.prepare(case.vehicle, [(direction_mask(case), SCAN_BINS), (None, OUTCOME_BINS)])
    # more than two would keep more memory and gain nothing: the rows of each step take all cores
    at_once = threading.Semaphore(min(worker_count(study.options.workers), 2))
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
        for each in STEPS:
            futures[each.name] = pool.submit(run, each)
        for future in as_completed(futures.values()):
            future.result()
            if seen is not None:
                seen(study)
    finally:
        stopped.set()  # after an interrupt no further step begins
        pool.shutdown(wait=False)

    if study.chain is None and (rows := study.rows_by_part.get("level_set")):
        # nothing is concluded from these readings, nor judged by them
        kinds = [row.kind.replace("test", "not_comparable") for row in rows]
        rows[:] = [
            replace(row, kind=kind, agrees=None) for row, kind in zip(rows, kinds, strict=True)
        ]
    every: list[Any] = [study.parts, study.rows_by_part, study.missing]
    for entries in every:  # in the order of `STEPS`, whichever ended first
        order = [(step.name, entries[step.name]) for step in STEPS if step.name in entries]
        entries.clear()
        entries.update(order)
    return study


def _run(step: Step, study: Study) -> None:
    """Compute one step and put its result and rows, or why there are none, where the others find them."""
    if not study.parts.keys() >= {*step.needs}:
        study.missing[step.name] = f"{step.title}: not computed, as it rests on what is missing"
        return
    try:
        result = step.compute(study)
        rows = step.rows(result) if step.rows else []
    except (TelemetryError, InputError, MotionError) as error:
        if step.needed or (isinstance(error, InputError) and step.name == "candidates"):
            raise
        study.missing[step.name] = f"{step.title}: not reproduced, as {error}"
        return
    study.parts[step.name] = result
    # a row that names no chain has that of its section; it is put in where the telemetry was made from its figure
    chain, about = "telemetry" if step.section == "telemetry" else "none", tables(study.case)
    whenever = ("always", "synthetic") if study.synthetic else ("always",)
    rows = [replace(row, chain=row.chain or chain) for row in rows]
    rows = [settled(row, about.get(row.id, {}).get("put_in") in whenever) for row in rows]
    if study.synthetic:
        without = "none", "published"
        rows = [row if row.chain in without else labelled(row) for row in rows]
    if rows:
        study.rows_by_part[step.name] = rows


def require_wheel(vehicle: Vehicle) -> None:
    """Refuse a vehicle with which the study makes no sense."""
    vehicle.require_inertia()
    vehicle.require_mass()
    if len(vehicle.wheels) != 1 or not vehicle.legs:
        got = f"{len(vehicle.wheels)} wheels, {len(vehicle.legs)} legs"
        do = "copy the vehicle file of philae and change it"
        raise InputError("the study is of a lander with one wheel and legs", got=got, do=do)
