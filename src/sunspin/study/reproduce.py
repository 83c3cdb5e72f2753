"""The paper, computed part by part: every result as data, and a row for each published figure beside ours.

A part is a module of this folder with `compute` and `rows`; :data:`PARTS` lists them in the paper's order. A figure that is not
computed has no row, so that none passes unseen; a part for which the telemetry holds no samples is said to be missing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import xarray as xr

from sunspin.cases import Case
from sunspin.errors import InputError, TelemetryError, sentence
from sunspin.infer.mask import reconstructible_mask
from sunspin.infer.rows import BINS as SCAN_BINS
from sunspin.measure.sun import sun_directions
from sunspin.motion import kernel as k
from sunspin.study import (
    contradictions,
    descent,
    landing,
    level_set,
    mechanics,
    motions,
    phases,
    precession,
    sensitivity,
    touchdown,
    worth,
    worth_told,
)
from sunspin.study import inputs as taken
from sunspin.study import rebound as rb
from sunspin.study.outcomes import BINS as OUTCOME_BINS
from sunspin.study.row import Row

LANDING_RUNS = 5_000
"""Simulated collisions: their probabilities err by 0.007 at most, ten times what the paper had; `sunspin outcomes` runs more."""

LEAST_RUNS = 400
"""As many as the paper had."""


MADE_OF = (
    "delta_mean", "delta_shadowed", "nz_folded", "nz_descent", "lit_patterns_before", "lit_patterns_at_rest", "shadowed_panel",
    "sampling_interval", "samples_after_collision", "descent_samples", "descent_rate_cubic", "descent_rate_romap",
)  # fmt: skip
"""Figures from which the synthetic telemetry was made: that they come back tests the code."""

MADE_OF_ALWAYS = ("spin_down_coefficients", "antenna_cone")
"""The same with any telemetry: the spin-down's record is computed, the cone stands in the vehicle file."""


@dataclass(frozen=True)
class Inputs:
    """What parts are computed from: the case with its telemetry, Sun directions, options, results of the parts before."""

    case: Case
    sun: xr.Dataset
    seed: int = 0
    coarser: int = 1
    workers: int | None = None
    progress: bool = False
    done: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Part:
    """One part of the paper: name, heading, how it is computed, its rows; whether the study makes no sense without it."""

    name: str
    title: str
    compute: Callable[[Inputs], Any]
    rows: Callable[[Any], list[Row]]
    needed: bool = False


def _worth(i: Inputs) -> tuple[Case, worth.Worth, list[worth_told.Applied]]:
    found, scan = worth.shipped(i.case), i.done["level_set"]
    if found is None:
        raise InputError(sentence("the case comes without a study of twins", do="sunspin worth"))
    whose = "this telemetry" + (" (synthetic)" if scan.synthetic else "")
    return i.case, found, [worth_told.apply(i.case, found, scan.twin.emd, whose)]


def _landing(i: Inputs) -> landing.Landing:
    runs = max(LANDING_RUNS // i.coarser, LEAST_RUNS)
    return landing.compute(i.case, landing.published_candidates(i.case), n=runs, seed=i.seed, workers=i.workers)


PARTS = (
    Part("phases", "Sections 2.1 and 4: Sun directions, lit panels", lambda i: phases.compute(i.case), phases.rows, True),
    Part("mechanics", "Section 2.2: wheel and example motions", lambda i: mechanics.compute(i.case), mechanics.rows, True),
    Part(
        "sensitivity", "Section 2.3: why a direct fit fails",
        lambda i: sensitivity.compute(i.case, i.sun, i.workers, i.coarser), sensitivity.rows,
    ),
    Part(
        "level_set", "Section 2.3: the scan and its lines",
        lambda i: level_set.compute(i.case, i.sun, i.seed, i.coarser, i.workers, i.progress), level_set.rows, True,
    ),
    Part("descent", "Section 3.1: the descent", lambda i: descent.compute(i.case, i.sun, i.workers), descent.rows),
    Part("precession", "Section 3.2: precession", lambda i: precession.compute(i.case, i.sun, i.workers), precession.rows),
    Part(
        "touchdown", "Section 3.2: the angular speed after the first touchdown",
        lambda i: touchdown.compute(i.case, i.done["level_set"].clean.points), touchdown.rows, True,
    ),
    Part("landing", "Sections 3.3 and 4: after the collision", _landing, landing.rows),
    Part("worth", "What the answer is worth", _worth, lambda r: worth_told.rows(*r)),
    Part("motions", "The motion to look at", lambda i: motions.compute(i.case, i.done, i.seed, i.workers), motions.rows),
    Part("inputs", "Taken over from the paper", lambda i: taken.Taken(i.case, i.sun), taken.rows, True),
    Part(
        "contradictions", "Where the paper is ambiguous or contradicts itself",
        lambda i: contradictions.compute(i.case), contradictions.rows, True,
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Reproduction:
    """All results of the Philae study: `parts` and `rows` by the part's name, `missing` name -> why it could not be computed."""

    case: Case
    seed: int
    sun: xr.Dataset
    parts: dict[str, Any]
    rows_by_part: dict[str, list[Row]]
    missing: dict[str, str]

    @property
    def synthetic(self) -> bool:
        return bool(self.sun.attrs.get("synthetic"))

    @property
    def rows(self) -> list[Row]:
        """All rows, in the paper's order."""
        return [row for rows in self.rows_by_part.values() for row in rows]

    def row(self, name: str) -> Row:
        """The row with this id."""
        return next(row for row in self.rows if row.id == name)


def compute(case: Case, *, seed: int = 0, coarser: int = 1, workers: int | None = None, progress: bool = False) -> Reproduction:
    """Run the whole chain on the case's telemetry.

    Parameters
    ----------
    case : Case
        With the telemetry to use (`rebound.with_telemetry` to put another file in its place). It must hold samples between
        the first touchdown and the collision; what else it does not hold is left out and named in `missing`.
    seed : int
        Of the random choices of the line fit.
    coarser : int
        Use every `coarser`-th grid point of the scan and of the maps; 1 is the paper's grid.
    """
    sun = sun_directions(case.vehicle, case.telemetry)
    rb.rebound_samples(case, sun)  # refused before the work
    inputs = Inputs(case, sun, seed, coarser, workers, progress)
    k.prepare(case.vehicle, [(reconstructible_mask(case.vehicle), SCAN_BINS), (None, OUTCOME_BINS)])
    rows, missing = {}, {}
    for part in PARTS:
        try:
            inputs.done[part.name] = part.compute(inputs)
        except (TelemetryError, InputError) as error:
            if part.needed:
                raise
            missing[part.name] = f"{part.title}: not reproduced, as {error}"
            continue
        made = MADE_OF_ALWAYS + (MADE_OF if sun.attrs.get("synthetic") else ())
        found = [
            replace(row, by_construction=bool(row.agrees) and row.id in made) for row in part.rows(inputs.done[part.name])
        ]
        if found:
            rows[part.name] = found
    return Reproduction(case, seed, sun, inputs.done, rows, missing)


def titles() -> dict[str, str]:
    """Name of each part -> its heading."""
    return {part.name: part.title for part in PARTS}
