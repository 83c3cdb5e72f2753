"""The paper, computed step by step from the telemetry: every result as data, and a row for each published figure.

A step is a function below that calls the module of a section, together with the function that makes its rows. Rows are counted in
three sections: results from the telemetry, results from the equations and the published lines alone, and the paper's own figures. A
step that the telemetry does not allow is listed as missing, with the reason.
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
    timing,
    touchdown,
)
from sunspin.philae.rebound import Options, read_truth, select_rebound
from sunspin.philae.row import Row, count_verdicts, label_synthetic, read_tables, settle
from sunspin.telemetry import sun as telemetry_sun
from sunspin.vehicle import Vehicle

LANDING_RUNS = 5_000
"""Number of simulated collisions. Their probabilities err by 0.007 at most. The paper had a tenth; `sunspin outcomes` runs more."""

TIMING_RUNS = 2_000
"""Number of simulated collisions of the posterior's draws."""

LEAST_RUNS = 400
"""Least number of simulated collisions on a coarser grid: as many as the paper had."""

SECTIONS = {
    "telemetry": "From this telemetry",
    "no_telemetry": "The equations and the printed lines: no telemetry",
    "paper": "The paper's own figures",
}
"""Sections that are counted separately. Nothing in the second and third depends on the telemetry."""


@dataclass(frozen=True)
class Study:
    """All results of the Philae study, each by the name of its step.

    `noise`: noise estimated from the telemetry. `sun`: Sun directions of the whole landing. `parts`: results of the steps.
    `rows_by_part`: their rows. `missing`: why a step could not be computed.
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
        """True if the telemetry is synthetic."""
        return bool(self.sun.attrs.get("synthetic"))

    @property
    def candidate_sets(self) -> candidates.CandidateSets | None:
        """Candidate motions on which the conclusions rest; None if nothing can be concluded."""
        return self.parts.get("candidates")

    @property
    def runs(self) -> int:
        """Number of simulated collisions."""
        return max(LANDING_RUNS // self.options.coarser, LEAST_RUNS)

    @property
    def rows(self) -> list[Row]:
        """Rows of all steps, in the order of the steps."""
        return [row for rows in self.rows_by_part.values() for row in rows]

    def counts(self) -> dict[str, dict[str, int]]:
        """Return for each section of `SECTIONS` how many rows agree, differ, are uninformative, and are of another kind."""
        by_part = [
            (step.section, self.rows_by_part.get(step.name, [])) for step in (*STEPS, TIMING)
        ]
        return {
            name: count_verdicts(
                [row for section, rows in by_part if section == name for row in rows]
            )
            for name in SECTIONS
        }


class Step(NamedTuple):
    """One step of the study.

    `compute` returns its result from the study so far, and `rows` the rows of that result, if there are any. `section` is one of
    `SECTIONS`. `needs` are steps without which it cannot be computed. `uses` are steps that it waits for but can do without. If
    `required` is true, its failure ends the study.
    """

    name: str
    title: str
    compute: Callable[[Study], Any]
    rows: Callable[[Any], list[Row]] | None = None
    section: str = "telemetry"
    needs: tuple[str, ...] = ()
    uses: tuple[str, ...] = ()
    required: bool = False


STEPS: list[Step] = []
"""All steps. A step is listed after those that it waits for."""


def step(title: str, rows: Callable[[Any], list[Row]] | None = None, **about: Any) -> Any:
    """Make a function of the study so far the next step, named after the function without its underscore."""

    def add(compute: Any) -> Any:
        """Append the step and return its function unchanged."""
        STEPS.append(Step(compute.__name__.removeprefix("_"), title, compute, rows, **about))
        return compute

    return add


@step("Sections 2.1 and 4: Sun directions, lit panels", sun_directions.rows, required=True)
def _phases(study: Study) -> Any:
    return sun_directions.compute(study.case)


@step("Section 3.1: the descent", descent.rows)
def _descent(study: Study) -> Any:
    return descent.compute(study.case, study.sun)


@step("Data check", data_check.rows, uses=("descent",), required=True)
def _carries(study: Study) -> Any:
    return data_check.compute(study.case, study.sun, study.parts.get("descent"), study.options.seed)


@step("Section 2.3: the scan of this telemetry", metrics.scan_rows)
def _level_set(study: Study) -> Any:
    return metrics.scan_telemetry(study.case, study.sun, study.options)


@step("Section 2.3: the motions that follow", needs=("level_set", "carries"))
def _candidates(study: Study) -> Any:
    return candidates.compute(study.parts["level_set"], study.parts["carries"], study.options)


@step("Section 3.2: after the first touchdown", touchdown.touchdown_rows, needs=("candidates",))
def _touchdown(study: Study) -> Any:
    return study.candidate_sets


@step("The motion to look at", needs=("candidates", "level_set"), uses=("descent",))
def _motions(study: Study) -> Any:
    return motions.compute(study.case, study.parts, study.options.seed)


@step("Section 3.3: after the collision", collision.rows, needs=("candidates",))
def _collision(study: Study) -> Any:
    options = study.options
    return collision.compute(
        study.case, study.parts["candidates"], study.runs, options.seed, workers=options.workers
    )


@step("How fast it turned", needs=("collision",), uses=("descent",))
def _speeds(study: Study) -> Any:
    collisions, seed = study.parts["collision"].weighted, study.options.seed
    return motions.compute_speeds(
        study.parts["candidates"], collisions, study.parts.get("descent"), seed
    )


@step("Section 4: wheel strategies", strategies.rows, needs=("candidates",))
def _strategies(study: Study) -> Any:
    candidate_sets, options = study.parts["candidates"], study.options
    runs = max(study.runs // 5, 1)
    return strategies.compute(
        study.case, candidate_sets, runs, options.seed, workers=options.workers
    )


@step("Section 2.3: why a direct fit fails", metrics.sensitivity_rows, section="no_telemetry")
def _sensitivity(study: Study) -> Any:
    return metrics.compute_sensitivity(study.case, study.sun, study.options)


@step(
    "Section 2.2: wheel and example motions", mechanics.rows, section="no_telemetry", required=True
)
def _mechanics(study: Study) -> Any:
    return mechanics.compute(study.case)


@step(
    "The published lines through our equations",
    published_lines.rows,
    section="no_telemetry",
    uses=("level_set",),
    required=True,
)
def _published_lines(study: Study) -> Any:
    return published_lines.compute(
        study.case, study.parts.get("level_set"), study.runs, study.options
    )


@step(
    "Section 3.2: precession on the published lines",
    mechanics.precession_rows,
    section="no_telemetry",
)
def _precession(study: Study) -> Any:
    return mechanics.compute_precession(study.case)


@step("Taken over from the paper", inputs.rows, section="paper", required=True)
def _inputs(study: Study) -> Any:
    return study.case


TIMING = Step(
    "timing",
    "Past the paper: what the times of the samples add",
    lambda study: timing.compute(
        study.parts["level_set"].rebound, study.candidate_sets, TIMING_RUNS, study.options
    ),
    timing.rows,
    needs=("level_set", "candidates"),
)
"""The last step, which takes as long as all others: it is computed by `add_timing` after the page of the others is there."""


def add_timing(study: Study) -> None:
    """Add the last step to a study: the posterior of the rebound's readings, and what it predicts."""
    _run_step(TIMING, study)


def compute(case: Case, on_step: Callable[[Study], Any] | None = None, **options: Any) -> Study:
    """Run the whole study on the case's telemetry.

    Parameters
    ----------
    case : Case
        With the telemetry to use (`rebound.with_telemetry` sets another file). It must contain samples between first touchdown and
        collision. Steps that need other samples are left out and named in `missing`.
    on_step : callable, optional
        Called with the study so far after each step, in the caller's thread, while other steps run.
    options
        Of :class:`sunspin.philae.rebound.Options`.
    """
    require_wheel(case.vehicle)
    case, noise = sun_directions.apply_measured_noise(case)
    sun = telemetry_sun.sun_directions(case.vehicle, case.telemetry)
    select_rebound(case, sun)  # raises an error before any work if the file has no samples there
    study = Study(case, Options(**options), noise, sun)
    # Each step has a thread that waits for the steps it needs. Only two compute at a time: the kernels of a step use all cores, so
    # that more would take memory and gain nothing.
    running = threading.Semaphore(min(worker_count(study.options.workers), 2))
    stopped, futures = threading.Event(), dict[str, Future]()

    def run(step: Step) -> None:
        """Wait for the steps before, then compute the step unless another one has failed."""
        wait([futures[name] for name in (*step.needs, *step.uses) if name in futures])
        with running:
            if stopped.is_set():
                return
            try:
                _run_step(step, study)
            except BaseException:
                stopped.set()
                raise

    pool = ThreadPoolExecutor(len(STEPS), thread_name_prefix="step")
    try:
        for step in STEPS:
            futures[step.name] = pool.submit(run, step)
        for future in as_completed(futures.values()):
            future.result()
            if on_step is not None:
                on_step(study)
    finally:
        stopped.set()  # after an interrupt no further step begins
        pool.shutdown(wait=False)

    if study.candidate_sets is None and (rows := study.rows_by_part.get("level_set")):
        # the scan was computed but not accepted, so its rows judge nothing
        kinds = [row.kind.replace("test", "not_comparable") for row in rows]
        rows[:] = [
            replace(row, kind=kind, agrees=None) for row, kind in zip(rows, kinds, strict=True)
        ]
    # the steps ended in any order; results are listed in the order of `STEPS`
    results: list[Any] = [study.parts, study.rows_by_part, study.missing]
    for entries in results:
        order = [(step.name, entries[step.name]) for step in STEPS if step.name in entries]
        entries.clear()
        entries.update(order)
    return study


def _run_step(step: Step, study: Study) -> None:
    """Compute one step and store its result and rows in the study, or the reason why there are none."""
    if not study.parts.keys() >= {*step.needs}:
        study.missing[step.name] = f"{step.title}: not computed, as it rests on what is missing"
        return
    try:
        result = step.compute(study)
        rows = step.rows(result) if step.rows else []
    except (TelemetryError, InputError, MotionError) as error:
        if step.required or (isinstance(error, InputError) and step.name == "candidates"):
            raise
        study.missing[step.name] = f"{step.title}: not reproduced, as {error}"
        return
    study.parts[step.name] = result
    # a row without a source (`chain`) has that of its section; it is "put_in" if the telemetry was made from its figure or selected
    # for it, as the case's own file was
    section_source = "telemetry" if step.section == "telemetry" else "none"
    rows = [replace(row, chain=row.chain or section_source) for row in rows]
    tables = read_tables(study.case)
    put_in = {"always"}
    put_in |= {"synthetic"} if study.synthetic else set()
    put_in |= {"built_in"} if read_truth(study.case) else set()
    rows = [settle(row, tables.get(row.id, {}).get("put_in") in put_in) for row in rows]
    if study.synthetic:
        no_telemetry = "none", "published"
        rows = [row if row.chain in no_telemetry else label_synthetic(row) for row in rows]
    if rows:
        study.rows_by_part[step.name] = rows


def require_wheel(vehicle: Vehicle) -> None:
    """Raise an error for a vehicle that the study does not cover: without inertia, mass, one wheel and legs."""
    vehicle.require_inertia()
    vehicle.require_mass()
    if len(vehicle.wheels) != 1 or not vehicle.legs:
        got = f"{len(vehicle.wheels)} wheels, {len(vehicle.legs)} legs"
        do = "copy the vehicle file of philae and change it"
        raise InputError("the study is of a lander with one wheel and legs", got=got, do=do)
