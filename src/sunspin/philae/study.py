"""The paper, computed step by step from the telemetry: every result as data, and a row for each published figure.

A step calls a function of the module of its section; `submit_steps` lists them. Rows are counted in three sections:
results from the telemetry, results from the equations and the published lines alone, and the paper's own figures. A step that the
telemetry does not allow is listed as missing, with the reason.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, as_completed
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import xarray as xr

from sunspin.base.errors import InputError, TelemetryError
from sunspin.cases import Case
from sunspin.compute.helper import Helper
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
from sunspin.philae.candidates import CandidateSets
from sunspin.philae.collision import AfterCollision
from sunspin.philae.data_check import DataCheck
from sunspin.philae.descent import Descent
from sunspin.philae.mechanics import Mechanics, Precession
from sunspin.philae.metrics import Sensitivity, TelemetryScan
from sunspin.philae.published_lines import PublishedLines
from sunspin.philae.rebound import Options, make_rebound, read_truth, select_rebound
from sunspin.philae.row import (
    Row,
    count_verdicts,
    label_synthetic,
    read_tables,
    settle,
    withhold_verdict,
)
from sunspin.philae.steps import REPORTED, StepOutcome, Steps, T, run_step
from sunspin.philae.strategies import Strategies
from sunspin.philae.sun_directions import Phases, ReadingNoise
from sunspin.philae.timing import Timing
from sunspin.telemetry import sun as telemetry_sun
from sunspin.vehicle import Vehicle

LANDING_RUNS = 3_000
"""Number of simulated collisions. Their probabilities err by 0.009 at most. The paper had 400; `sunspin outcomes` runs more."""

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
    """All results of the Philae study.

    `noise`: noise estimated from the telemetry. `sun`: Sun directions of the whole landing. The other fields are the outcomes of
    the steps in the paper's order, `timing` last. In a study that has ended, `phases`, `check`, `mechanics`, `published_lines` and
    `inputs` have a result. `motions` are those for display by title.
    """

    case: Case
    options: Options
    noise: ReadingNoise
    sun: xr.Dataset
    phases: StepOutcome[Phases] = StepOutcome()
    descent: StepOutcome[Descent] = StepOutcome()
    check: StepOutcome[DataCheck] = StepOutcome()
    scan: StepOutcome[TelemetryScan] = StepOutcome()
    candidate_sets: StepOutcome[CandidateSets] = StepOutcome()
    touchdown: StepOutcome[CandidateSets] = StepOutcome()
    motions: StepOutcome[dict[str, xr.Dataset]] = StepOutcome()
    collision: StepOutcome[AfterCollision] = StepOutcome()
    speeds: StepOutcome[xr.Dataset] = StepOutcome()
    strategies: StepOutcome[Strategies] = StepOutcome()
    sensitivity: StepOutcome[Sensitivity] = StepOutcome()
    mechanics: StepOutcome[Mechanics] = StepOutcome()
    published_lines: StepOutcome[PublishedLines] = StepOutcome()
    precession: StepOutcome[Precession] = StepOutcome()
    inputs: StepOutcome[Case] = StepOutcome()
    timing: StepOutcome[Timing] = StepOutcome()

    @property
    def synthetic(self) -> bool:
        """True if the telemetry is synthetic."""
        return bool(self.sun.attrs.get("synthetic"))

    @property
    def outcomes(self) -> list[StepOutcome[Any]]:
        """Outcomes of all steps in the paper's order."""
        return [value for value in vars(self).values() if isinstance(value, StepOutcome)]

    @property
    def rows(self) -> list[Row]:
        """Rows of all steps, in the order of the steps."""
        return [row for outcome in self.outcomes for row in outcome.rows]

    @property
    def missing(self) -> dict[str, str]:
        """Why steps have no result, in words, by their keys."""
        return {outcome.key: outcome.reason for outcome in self.outcomes if outcome.error}

    def counts(self) -> dict[str, dict[str, int]]:
        """Return for each section of `SECTIONS` how many rows agree, differ, are uninformative, and are of another kind."""
        return {
            section: count_verdicts(
                [row for step in self.outcomes if step.section == section for row in step.rows]
            )
            for section in SECTIONS
        }


def compute(
    case: Case,
    on_step: Callable[[Study], Any] | None = None,
    helper: Helper | None = None,
    **options: Any,
) -> Study:
    """Run the study on the case's telemetry, but for the posterior (`add_timing`).

    Parameters
    ----------
    case : Case
        With the telemetry to use (`rebound.with_telemetry` sets another file). It must contain samples between first touchdown and
        collision. Steps that need other samples are left out and named in `missing`.
    on_step : callable, optional
        Called with the study so far after each step, in the caller's thread, while other steps run.
    helper : Helper, optional
        Samples the posterior for `add_timing` meanwhile. Only if the candidates do not come from the posterior.
    options
        Of :class:`sunspin.philae.rebound.Options`.
    """
    require_wheel(case.vehicle)
    case, noise = sun_directions.apply_measured_noise(case)
    sun = telemetry_sun.sun_directions(case.vehicle, case.telemetry)
    select_rebound(case, sun)  # raises an error before any work if the file has no samples there
    study = Study(case, Options(**options), noise, sun)
    if helper is not None:
        with suppress(TelemetryError):  # which the scan reports
            span_s = make_rebound(case, sun).span_s
            # without progress, whose lines would stand between those of the other steps
            silent = replace(study.options, progress=False)
            helper.start(candidates.sample_posterior, case.vehicle, case.telemetry, span_s, silent)
    with Steps(study.options.workers) as steps:
        so_far = submit_steps(steps, study)
        for step in as_completed(steps.submitted):
            step.result()  # raises the error of a step that ends the study
            if on_step is not None:
                on_step(so_far())
    return so_far()


def submit_steps(steps: Steps, study: Study) -> Callable[[], Study]:
    """Submit all steps but the last, and return a function that returns the study with the outcomes so far.

    `study` has no outcome yet. A step waits for those whose outcome it takes by `of`.
    """
    case, sun, options, run, of = study.case, study.sun, study.options, steps.run, steps.of
    seed, workers = options.seed, options.workers
    runs = max(LANDING_RUNS // options.coarser, LEAST_RUNS)

    # ---- The telemetry ----
    phases = run(
        "phases",
        "Sections 2.1 and 4: Sun directions, lit panels",
        lambda: sun_directions.compute(case),
        sun_directions.rows,
        fatal=REPORTED,
    )
    spin = run(
        "descent", "Section 3.1: the descent", lambda: descent.compute(case, sun), descent.rows
    )
    check = run(
        "carries",
        "Data check",
        lambda: data_check.compute(case, sun, of(spin).result, seed),
        data_check.rows,
        fatal=REPORTED,
    )
    scan = run(
        "level_set",
        "Section 2.3: the scan of this telemetry",
        lambda: metrics.scan_telemetry(case, sun, options),
        metrics.scan_rows,
    )

    # ---- The equations, the printed lines and the paper's own figures: these run while others would wait for the scan ----
    no_telemetry: Any = {"section": "no_telemetry"}
    sensitivity = run(
        "sensitivity",
        "Section 2.3: why a direct fit fails",
        lambda: metrics.compute_sensitivity(case, sun, options),
        metrics.sensitivity_rows,
        **no_telemetry,
    )
    examples = run(
        "mechanics",
        "Section 2.2: wheel and example motions",
        lambda: mechanics.compute(case),
        mechanics.rows,
        fatal=REPORTED,
        **no_telemetry,
    )
    precession = run(
        "precession",
        "Section 3.2: precession on the published lines",
        lambda: mechanics.compute_precession(case),
        mechanics.precession_rows,
        **no_telemetry,
    )
    own = {"section": "paper", "fatal": REPORTED}
    own_figures = run("inputs", "Taken over from the paper", lambda: case, inputs.rows, **own)
    on_lines = run(
        "published_lines",
        "The published lines through our equations",
        lambda: published_lines.compute(case, of(scan).result, runs, options),
        published_lines.rows,
        fatal=REPORTED,
        **no_telemetry,
    )

    # ---- The motions that fit the telemetry ----
    candidate_sets = run(
        "candidates",
        "Section 2.3: the motions that follow",
        lambda: candidates.compute(of(scan).get(), of(check).get(), options),
        fatal=(InputError,),  # the file that `options.source` names is not valid
    )

    def sets() -> CandidateSets:
        """Return the candidates to a step that needs them."""
        return of(candidate_sets).get()

    at_touchdown = run(
        "touchdown", "Section 3.2: after the first touchdown", sets, touchdown.touchdown_rows
    )
    displayed = run(
        "motions",
        "The motion to look at",
        lambda: motions.compute(of(scan).get(), sets(), of(spin).result, seed),
    )
    after_collision = run(
        "collision",
        "Section 3.3: after the collision",
        lambda: collision.compute(case, sets(), runs, seed, workers=workers),
        collision.rows,
    )
    speeds = run(
        "speeds",
        "How fast it turned",
        lambda: motions.compute_speeds(of(after_collision).get(), of(spin).result, seed),
    )
    by_strategy = run(
        "strategies",
        "Section 4: wheel strategies",
        lambda: strategies.compute(case, sets(), max(runs // 5, 1), seed, workers=workers),
        strategies.rows,
    )

    def settled(step: Future[StepOutcome[T]]) -> StepOutcome[T]:
        """Return the outcome of a step with its rows as they are counted; an empty one if it has not ended."""
        return settle_rows(study, step.result()) if step.done() else StepOutcome()

    def so_far() -> Study:
        """Return the study with the outcomes of the steps that have ended."""
        of_scan, of_candidates = settled(scan), settled(candidate_sets)
        if of_candidates.error:  # no motion of the scan was accepted, so its rows judge nothing
            of_scan = replace(of_scan, rows=tuple(map(withhold_verdict, of_scan.rows)))
        return replace(
            study,
            phases=settled(phases),
            descent=settled(spin),
            check=settled(check),
            scan=of_scan,
            candidate_sets=of_candidates,
            touchdown=settled(at_touchdown),
            motions=settled(displayed),
            collision=settled(after_collision),
            speeds=settled(speeds),
            strategies=settled(by_strategy),
            sensitivity=settled(sensitivity),
            mechanics=settled(examples),
            published_lines=settled(on_lines),
            precession=settled(precession),
            inputs=settled(own_figures),
        )

    return so_far


def add_timing(study: Study, helper: Helper | None = None) -> Study:
    """Return the study with its last step: the posterior of the rebound's readings, and what it predicts.

    The posterior takes longer than any other step. With the `helper` of `compute` it is sampled meanwhile, else now.
    """

    def compute_last() -> Timing:
        """Return what follows from the posterior, or raise `MissingResult` without candidates."""
        sets = study.candidate_sets.get()
        posterior = sets.posterior if helper is None else helper.result()
        return timing.compute(sets.rebound, posterior, TIMING_RUNS, study.options)

    title = "Past the paper: what the times of the samples add"
    outcome = run_step("timing", title, compute_last, timing.rows)
    return replace(study, timing=settle_rows(study, outcome))


def settle_rows(study: Study, outcome: StepOutcome[T]) -> StepOutcome[T]:
    """Return the outcome of a step with its rows as they are counted: with their source, kind and verdict."""
    case = study.case
    # a row without a source (`chain`) has that of its section; it is "put_in" if the telemetry was made from its figure or selected
    # for it, as the case's own file was
    section_source = "telemetry" if outcome.section == "telemetry" else "none"
    rows = [replace(row, chain=row.chain or section_source) for row in outcome.rows]
    tables = read_tables(case)
    put_in = {"always"}
    put_in |= {"synthetic"} if study.synthetic else set()
    put_in |= {"built_in"} if read_truth(case) else set()
    rows = [settle(row, tables.get(row.id, {}).get("put_in") in put_in) for row in rows]
    if study.synthetic:
        no_telemetry = "none", "published"
        rows = [row if row.chain in no_telemetry else label_synthetic(row) for row in rows]
    return replace(outcome, rows=tuple(rows))


def require_wheel(vehicle: Vehicle) -> None:
    """Raise an error for a vehicle that the study does not cover: without inertia, mass, one wheel and legs."""
    vehicle.require_inertia()
    vehicle.require_mass()
    if len(vehicle.wheels) != 1 or not vehicle.legs:
        got = f"{len(vehicle.wheels)} wheels, {len(vehicle.legs)} legs"
        do = "copy the vehicle file of philae and change it"
        raise InputError("the study is of a lander with one wheel and legs", got=got, do=do)
