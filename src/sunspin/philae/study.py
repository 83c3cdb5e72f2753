"""The paper, computed part by part from the telemetry given: every result as data, and a row for each published figure.

A part is a module of this folder with `compute` and `rows`; :data:`PARTS` lists them in the order in which they are begun, each as
soon as the parts that it uses are there: kernels leave Python's lock to others, and few parts alone keep two cores busy. Parts are
counted in three sections: what follows from the telemetry, what the equations and the printed lines give without any, and the
paper's own figures. A part that the telemetry cannot carry is said to be missing, and why.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
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
    descent,
    landing,
    level_set,
    mechanics,
    motions,
    phases,
    precession,
    published_lines,
    sensitivity,
    touchdown,
)
from sunspin.philae import inputs as taken
from sunspin.philae import rebound as rb
from sunspin.philae.reading_noise import ReadingNoise, with_own_noise
from sunspin.philae.row import Row, counts, settled
from sunspin.telemetry.case import Case
from sunspin.telemetry.sun import sun_directions
from sunspin.vehicle import Vehicle

LANDING_RUNS = 5_000
"""Simulated collisions: their probabilities err by 0.007 at most, ten times what the paper had; `sunspin outcomes` runs more."""

LEAST_RUNS = 400
"""As many as the paper had."""

PUT_IN = (
    "delta_mean",
    "delta_max",
    "delta_shadowed",
    "nz_folded",
    "nz_descent",
    "lit_patterns_before",
    "lit_patterns_at_rest",
    "shadowed_panel",
    "panel_1_rotation",
    "sampling_interval",
    "samples_after_collision",
    "descent_samples",
    "descent_rate_cubic",
    "descent_rate_range",
    "descent_rate_romap",
    "descent_E",
)
"""Figures from which the synthetic telemetry was made, for which its noise, the turns of its panels or a shadow were chosen: that
they come back tests the code."""

PUT_IN_ALWAYS = ("spin_down_coefficients", "antenna_cone")
"""The same with any telemetry: the spin-down's record is computed, the cone stands in the vehicle file."""

PARTS_AT_ONCE = 2
"""More would keep more memory and gain nothing: each part's rows take all cores."""

SECTIONS = {
    "telemetry": "From this telemetry",
    "no_telemetry": "The equations and the printed lines: no telemetry",
    "paper": "The paper's own figures",
}
"""What is counted apart. Nothing in the second and third changes with the telemetry."""


@dataclass(frozen=True)
class Options:
    """How the study is run: see :func:`compute`."""

    source: str = "scan"
    twins: int | None = None
    seed: int = 0
    coarser: int = 1
    workers: int | None = None
    progress: bool = False


@dataclass(frozen=True)
class Inputs:
    """What parts are computed from: the case with its telemetry, Sun directions, options, results of the parts before."""

    case: Case
    sun: xr.Dataset
    options: Options = Options()
    done: dict[str, Any] = field(default_factory=dict)

    @property
    def runs(self) -> int:
        """Simulated collisions."""
        return max(LANDING_RUNS // self.options.coarser, LEAST_RUNS)


@dataclass(frozen=True)
class Part:
    """One part of the paper.

    Attributes
    ----------
    name, title : of the part
    section : of `SECTIONS`
    compute, rows : how it is computed, and its rows
    needs : parts without which it cannot be computed
    uses : parts that it waits for and can do without
    needed : whether the study makes no sense without it
    """

    name: str
    title: str
    section: str
    compute: Callable[[Inputs], Any]
    rows: Callable[[Any], list[Row]]
    needs: tuple[str, ...] = ()
    uses: tuple[str, ...] = ()
    needed: bool = False

    def of(self, inputs: Inputs) -> tuple[Any, list[Row]]:
        """Its result and rows; of the parts before it sees those that it names."""
        seen = {
            name: inputs.done[name] for name in (*self.needs, *self.uses) if name in inputs.done
        }
        result = self.compute(replace(inputs, done=seen))
        synthetic = bool(inputs.sun.attrs.get("synthetic"))
        return result, [_settled(row, self, synthetic) for row in self.rows(result)]


def _candidates(i: Inputs) -> candidates.Chain:
    o = i.options
    return candidates.compute(
        i.done["level_set"].scan,
        i.done["carries"],
        o.source,
        o.twins,
        o.seed,
        workers=o.workers,
        progress=o.progress,
    )


def _published_lines(i: Inputs) -> published_lines.PublishedLines:
    part = i.done.get("level_set")
    table = part.scan.table if part is not None and part.scan.rebound.as_published else None
    return published_lines.compute(
        i.case, table, i.options.seed, i.options.coarser, i.runs, i.options.workers
    )


PARTS = (
    Part(
        "phases",
        "Sections 2.1 and 4: Sun directions, lit panels",
        "telemetry",
        lambda i: phases.compute(i.case),
        phases.rows,
        needed=True,
    ),
    Part(
        "descent",
        "Section 3.1: the descent",
        "telemetry",
        lambda i: descent.compute(i.case, i.sun),
        descent.rows,
    ),
    Part(
        "carries",
        "What this file can carry",
        "telemetry",
        lambda i: carries.compute(i.case, i.sun, i.done.get("descent"), i.options.seed),
        carries.rows,
        uses=("descent",),
        needed=True,
    ),
    Part(
        "level_set",
        "Section 2.3: the scan of this telemetry",
        "telemetry",
        lambda i: level_set.compute(
            i.case, i.sun, i.options.seed, i.options.coarser, i.options.workers, i.options.progress
        ),
        level_set.rows,
    ),
    Part(
        "candidates",
        "Section 2.3: the motions that follow",
        "telemetry",
        _candidates,
        lambda _: [],
        ("level_set", "carries"),
    ),
    Part(
        "touchdown",
        "Section 3.2: after the first touchdown",
        "telemetry",
        lambda i: touchdown.compute(i.done["candidates"]),
        touchdown.rows,
        ("candidates",),
    ),
    Part(
        "landing",
        "Sections 3.3 and 4: after the collision",
        "telemetry",
        lambda i: landing.compute(
            i.case, i.done["candidates"], n=i.runs, seed=i.options.seed, workers=i.options.workers
        ),
        landing.rows,
        ("candidates",),
    ),
    Part(
        "sensitivity",
        "Section 2.3: why a direct fit fails",
        "no_telemetry",
        lambda i: sensitivity.compute(i.case, i.sun, i.options.workers, i.options.coarser),
        sensitivity.rows,
    ),
    Part(
        "motions",
        "The motion to look at",
        "telemetry",
        lambda i: motions.compute(i.case, i.done, i.options.seed, i.options.workers),
        motions.rows,
        ("candidates", "level_set"),
        ("descent",),
    ),
    Part(
        "mechanics",
        "Section 2.2: wheel and example motions",
        "no_telemetry",
        lambda i: mechanics.compute(i.case),
        mechanics.rows,
        needed=True,
    ),
    Part(
        "published_lines",
        "The published lines through our equations",
        "no_telemetry",
        _published_lines,
        published_lines.rows,
        uses=("level_set",),
        needed=True,
    ),
    Part(
        "precession",
        "Section 3.2: precession on the published lines",
        "no_telemetry",
        lambda i: precession.compute(i.case),
        precession.rows,
    ),
    Part(
        "inputs",
        "Taken over from the paper",
        "paper",
        lambda i: taken.Taken(i.case, i.sun),
        taken.rows,
        needed=True,
    ),
)
"""In the order of beginning."""

CHAIN_OF = {"telemetry": "telemetry", "no_telemetry": "none", "paper": "none"}
"""Section -> what made those of its rows that do not say so themselves."""


@dataclass(frozen=True)
class Reproduction:
    """All results of the Philae study: `parts` and `rows` by the part's name, `missing` name -> why it could not be computed.

    `noise`: what the file's readings were taken for; `options`: how the study was run.
    """

    case: Case
    options: Options
    noise: ReadingNoise
    sun: xr.Dataset
    parts: dict[str, Any]
    rows_by_part: dict[str, list[Row]]
    missing: dict[str, str]

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
    def rows(self) -> list[Row]:
        """All rows, in the order of the parts."""
        return [row for rows in self.rows_by_part.values() for row in rows]

    def row(self, name: str) -> Row:
        """The row with this id."""
        return next(row for row in self.rows if row.id == name)

    def counts(self) -> dict[str, dict[str, int]]:
        """For each section of `SECTIONS` how many rows agree, differ, are uninformative, and how many are of another kind."""
        by_section: dict[str, list[Row]] = {name: [] for name in SECTIONS}
        for part in PARTS:
            by_section[part.section] += self.rows_by_part.get(part.name, [])
        return {name: counts(rows) for name, rows in by_section.items()}


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
    options : Options, or its fields as keywords
        source : "scan", "posterior", "published" or a file: where candidates come from (:mod:`sunspin.philae.candidates`);
        twins : synthetic rebounds of a calibration (zero: none is made); seed : of all random choices;
        coarser : every so many-th grid point of the scan and of the maps, 1 is the paper's grid.
    seen : callable, optional
        Given what there is so far each time that a part is computed.
    """
    options = options or Options(**chosen)
    require_wheel(case.vehicle)
    case, noise = with_own_noise(case, carries.whole_panels(case, case.telemetry))
    sun = sun_directions(case.vehicle, case.telemetry)
    rb.rebound_samples(case, sun)  # refused before the work
    inputs = Inputs(case, sun, options)
    k.prepare(case.vehicle, [(rb.counted(case), SCAN_BINS), (None, OUTCOME_BINS)])
    found = Reproduction(case, options, noise, sun, inputs.done, {}, {})
    for part, ended in _computed(inputs):
        if isinstance(ended, str):
            found.missing[part.name] = ended
            continue
        try:
            inputs.done[part.name], rows = ended.result()
        except (TelemetryError, InputError, MotionError) as error:
            if part.needed or (isinstance(error, InputError) and part.name == "candidates"):
                raise
            found.missing[part.name] = f"{part.title}: not reproduced, as {error}"
            continue
        if rows:
            found.rows_by_part[part.name] = rows
        if seen is not None:
            seen(found)
    return _in_order(found)


def _computed(inputs: Inputs) -> Iterator[tuple[Part, Future | str]]:
    """Each part once it has ended, or why it has not begun. A part begins when all that it waits for has ended."""
    at_once = min(worker_count(inputs.options.workers), PARTS_AT_ONCE)
    waiting, running = list(PARTS), {}
    over = {name for part in PARTS for name in (*part.needs, *part.uses)} - {
        part.name for part in PARTS
    }
    pool = ThreadPoolExecutor(at_once, thread_name_prefix="part")
    try:
        while waiting or running:
            for part in [part for part in waiting if over.issuperset((*part.needs, *part.uses))]:
                if why := _absent(part, inputs):
                    waiting.remove(part)
                    over.add(part.name)
                    yield part, why
                elif len(running) < at_once:
                    waiting.remove(part)
                    running[pool.submit(part.of, inputs)] = part
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                part = running.pop(future)
                over.add(part.name)
                yield part, future
    finally:  # after an error nobody waits for the others
        pool.shutdown(wait=False, cancel_futures=True)


def _absent(part: Part, inputs: Inputs) -> str:
    return "" if inputs.done.keys() >= {*part.needs} else f"{part.title}: nothing is concluded"


def _in_order(found: Reproduction) -> Reproduction:
    """The same with everything in the order of `PARTS`, whichever ended first."""
    rows = dict(found.rows_by_part)
    if (
        "candidates" not in found.parts and "level_set" in rows
    ):  # nothing is concluded from these readings, nor judged by them
        kept = rows["level_set"]
        rows["level_set"] = [
            replace(row, kind=row.kind.replace("test", "not_comparable"), agrees=None)
            for row in kept
        ]
    by_name = {"parts": found.parts, "rows_by_part": rows, "missing": found.missing}
    return replace(
        found,
        **{
            field: {p.name: of[p.name] for p in PARTS if p.name in of}
            for field, of in by_name.items()
        },
    )


def _settled(row: Row, part: Part, synthetic: bool) -> Row:
    row = row if row.chain else replace(row, chain=CHAIN_OF[part.section])
    return settled(row, row.id in PUT_IN_ALWAYS or (synthetic and row.id in PUT_IN))


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


def titles() -> dict[str, str]:
    """Name of each part -> its heading."""
    return {part.name: part.title for part in PARTS}


def sections() -> dict[str, str]:
    """Name of each part -> its section."""
    return {part.name: part.section for part in PARTS}
