"""The paper, computed step by step from the telemetry: every result as data, and a row for each published figure.

A step calls a function of the module of its section; `submit_steps` lists them. Rows are counted in three
sections: results from the telemetry, results from the equations and the published lines alone, and the paper's own figures. A step
that the telemetry does not allow is listed as missing, with the reason.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import xarray as xr

from sunspin.base.errors import InputError, SunspinError
from sunspin.cases import Case
from sunspin.dynamics.ensemble import prepare
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
    timing,
    touchdown,
)
from sunspin.philae.candidates import CandidateSets
from sunspin.philae.collision import AfterCollision
from sunspin.philae.data_check import DataCheck
from sunspin.philae.descent import Descent
from sunspin.philae.mechanics import Mechanics
from sunspin.philae.metrics import Sensitivity, TelemetryScan
from sunspin.philae.published_lines import PublishedLines
from sunspin.philae.rebound import Options, direction_mask, read_truth, select_rebound
from sunspin.philae.row import (
    Row,
    count_verdicts,
    label_synthetic,
    read_tables,
    settle,
    withhold_verdict,
)
from sunspin.philae.steps import REPORTED, Outcome, Step, Steps, run_step
from sunspin.philae.strategies import Strategies
from sunspin.philae.sun_directions import Phases, ReadingNoise
from sunspin.philae.timing import Timing
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
    """All results of the Philae study. A result is None if its step has not ended, or is missing.

    Attributes
    ----------
    noise : noise estimated from the telemetry
    sun : Sun directions of the whole landing
    phases ... timing : results of the steps. In a study that has ended, `phases`, `check`, `mechanics` and `published_lines` are
        never None. `motions` are those for display by title.
    outcomes : the steps that have ended, in the paper's order, with their rows or the reason why there are none
    no_candidates : why there are no candidate motions, so that nothing can be concluded from them; None if there are some
    """

    case: Case
    options: Options
    noise: ReadingNoise
    sun: xr.Dataset
    phases: Phases | None = None
    descent: Descent | None = None
    check: DataCheck | None = None
    scan: TelemetryScan | None = None
    candidate_sets: CandidateSets | None = None
    motions: dict[str, xr.Dataset] | None = None
    collision: AfterCollision | None = None
    speeds: xr.Dataset | None = None
    strategies: Strategies | None = None
    sensitivity: Sensitivity | None = None
    mechanics: Mechanics | None = None
    published_lines: PublishedLines | None = None
    timing: Timing | None = None
    outcomes: tuple[Outcome[Any], ...] = ()
    no_candidates: SunspinError | None = None

    @property
    def synthetic(self) -> bool:
        """True if the telemetry is synthetic."""
        return bool(self.sun.attrs.get("synthetic"))

    @property
    def runs(self) -> int:
        """Number of simulated collisions."""
        return max(LANDING_RUNS // self.options.coarser, LEAST_RUNS)

    @property
    def rows(self) -> list[Row]:
        """Rows of all steps, in the order of the steps."""
        return [row for outcome in self.outcomes for row in outcome.rows]

    @property
    def missing(self) -> dict[str, str]:
        """Why steps have no result, in words, by their keys."""
        return {outcome.key: outcome.reason for outcome in self.outcomes if outcome.error}

    def require_check(self) -> DataCheck:
        """Return the data check, which every study that has ended has."""
        if self.check is None:
            raise RuntimeError("the data check has not ended")
        return self.check

    def counts(self) -> dict[str, dict[str, int]]:
        """Return for each section of `SECTIONS` how many rows agree, differ, are uninformative, and are of another kind."""
        return {
            section: count_verdicts(
                [
                    row
                    for outcome in self.outcomes
                    if outcome.section == section
                    for row in outcome.rows
                ]
            )
            for section in SECTIONS
        }


def compute(case: Case, on_step: Callable[[Study], Any] | None = None, **options: Any) -> Study:
    """Run the study on the case's telemetry, but for the posterior (`add_timing`).

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
    prepare(case.vehicle, [(direction_mask(case), SCAN_BINS), (None, OUTCOME_BINS)])
    with Steps(study.options.workers) as steps:
        so_far = submit_steps(steps, study)
        for _ in steps.as_they_end():
            if on_step is not None:
                on_step(so_far())
    return so_far()


def submit_steps(steps: Steps, study: Study) -> Callable[[], Study]:
    """Submit all steps, and return a function that returns the study with the results so far, in the paper's order.

    `study` has the case, the options and the Sun directions, but no result. A step takes the result of another one by `get` (if it
    is missing, its own is too) or by `get_if_computed`.
    """
    case, sun, options, runs = study.case, study.sun, study.options, study.runs
    seed, workers, run = options.seed, options.workers, steps.run

    # ---- Of the telemetry ----
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
        lambda: data_check.compute(case, sun, spin.get_if_computed(), seed),
        data_check.rows,
        fatal=REPORTED,
    )
    scan = run(
        "level_set",
        "Section 2.3: the scan of this telemetry",
        lambda: metrics.scan_telemetry(case, sun, options),
        metrics.scan_rows,
    )

    # ---- The equations and the paper's own figures. They run next, as all others wait for the scan ----
    equations: dict[str, Any] = {"section": "no_telemetry"}
    sensitivity = run(
        "sensitivity",
        "Section 2.3: why a direct fit fails",
        lambda: metrics.compute_sensitivity(case, sun, options),
        metrics.sensitivity_rows,
        **equations,
    )
    examples = run(
        "mechanics",
        "Section 2.2: wheel and example motions",
        lambda: mechanics.compute(case),
        mechanics.rows,
        fatal=REPORTED,
        **equations,
    )
    precession = run(
        "precession",
        "Section 3.2: precession on the published lines",
        lambda: mechanics.compute_precession(case),
        mechanics.precession_rows,
        **equations,
    )
    own_figures = run(
        "inputs",
        "Taken over from the paper",
        lambda: case,
        inputs.rows,
        section="paper",
        fatal=REPORTED,
    )
    on_lines = run(
        "published_lines",
        "The published lines through our equations",
        lambda: published_lines.compute(case, scan.get_if_computed(), runs, options),
        published_lines.rows,
        fatal=REPORTED,
        **equations,
    )

    # ---- The motions that fit the telemetry ----
    candidate_sets = run(
        "candidates",
        "Section 2.3: the motions that follow",
        lambda: candidates.compute(scan.get(), check.get(), options),
        fatal=(InputError,),  # the file that `options.source` names is not valid
    )
    at_touchdown = run(
        "touchdown",
        "Section 3.2: after the first touchdown",
        candidate_sets.get,
        touchdown.touchdown_rows,
    )
    displayed = run(
        "motions",
        "The motion to look at",
        lambda: motions.compute(scan.get(), candidate_sets.get(), spin.get_if_computed(), seed),
    )
    after_collision = run(
        "collision",
        "Section 3.3: after the collision",
        lambda: collision.compute(case, candidate_sets.get(), runs, seed, workers=workers),
        collision.rows,
    )
    speeds = run(
        "speeds",
        "How fast it turned",
        lambda: motions.compute_speeds(after_collision.get(), spin.get_if_computed(), seed),
    )
    few = max(runs // 5, 1)
    by_strategy = run(
        "strategies",
        "Section 4: wheel strategies",
        lambda: strategies.compute(case, candidate_sets.get(), few, seed, workers=workers),
        strategies.rows,
    )
    of_telemetry = (
        phases,
        spin,
        check,
        scan,
        candidate_sets,
        at_touchdown,
        displayed,
        after_collision,
    )
    of_equations = sensitivity, examples, on_lines, precession, own_figures
    in_order: list[Step[Any]] = [*of_telemetry, speeds, by_strategy, *of_equations]

    def so_far() -> Study:
        """Return the study with the results of the steps that have ended."""
        no_candidates = candidate_sets.outcome and candidate_sets.outcome.error
        outcomes = [settle_rows(study, step.outcome) for step in in_order if step.outcome]
        if no_candidates is not None:
            # no motion of the scan was accepted, so its rows judge nothing
            outcomes = [
                replace(outcome, rows=tuple(map(withhold_verdict, outcome.rows)))
                if outcome.result is scan.result
                else outcome
                for outcome in outcomes
            ]
        return replace(
            study,
            phases=phases.result,
            descent=spin.result,
            check=check.result,
            scan=scan.result,
            candidate_sets=candidate_sets.result,
            motions=displayed.result,
            collision=after_collision.result,
            speeds=speeds.result,
            strategies=by_strategy.result,
            sensitivity=sensitivity.result,
            mechanics=examples.result,
            published_lines=on_lines.result,
            outcomes=tuple(outcomes),
            no_candidates=no_candidates,
        )

    return so_far


def add_timing(study: Study) -> Study:
    """Return the study with its last step: the posterior of the rebound's readings, and what it predicts.

    It takes as long as all others, and runs when their page is there. It needs the candidates: without them the study is returned.
    """
    if (candidate_sets := study.candidate_sets) is None:
        return study
    outcome = run_step(
        "timing",
        "Past the paper: what the times of the samples add",
        lambda: timing.compute(
            candidate_sets.rebound, candidate_sets.posterior, TIMING_RUNS, study.options
        ),
        timing.rows,
    )
    outcomes = *study.outcomes, settle_rows(study, outcome)
    return replace(study, timing=outcome.result, outcomes=outcomes)


def settle_rows(study: Study, outcome: Outcome[Any]) -> Outcome[Any]:
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
