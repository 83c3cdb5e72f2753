"""The chain of the Philae study on coarse grids: what a telemetry file leaves, without figures and pages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from sunspin.cases import Case, load_case
from sunspin.errors import SunspinError
from sunspin.measure.sun import sun_directions
from sunspin.study import candidates, carries, descent, level_set, touchdown
from sunspin.study import rebound as rb
from sunspin.study.readings import with_own_noise
from sunspin.study.row import Row, settled

COARSER = 5
"""21 x 21 x 9 motions."""

TWINS = 60


@dataclass(frozen=True)
class Found:
    """What the file carries; its scan and its chain of candidates, or why there is none."""

    case: Case
    carries: carries.Carries
    scan: level_set.LevelSet | None
    chain: candidates.Chain | None
    why: str

    @property
    def rows(self) -> dict[str, Row]:
        """Rows of the scan and of the touchdown as they count."""
        found = level_set.rows(self.scan) if self.scan else []
        found = found + (touchdown.rows(self.chain) if self.chain else [])
        return {row.id: settled(row) for row in found}


def chain_of(telemetry: xr.Dataset | None = None, source: str = "scan", coarser: int = COARSER, **options: Any) -> Found:
    """The chain on a telemetry file, the built-in one unless given."""
    case = load_case("philae")
    case = case if telemetry is None else rb.with_telemetry(case, telemetry)
    case, _ = with_own_noise(case, carries.whole_panels(case, case.telemetry))
    sun = sun_directions(case.vehicle, case.telemetry)
    try:
        fit = descent.compute(case, sun)
    except SunspinError:
        fit = None
    looked = carries.compute(case, sun, fit)
    scan = chain = None
    why = ""
    try:
        scan = level_set.compute(case, sun, coarser=coarser)
        chain = candidates.compute(scan.scan, looked, source, **({"twins": TWINS} | options))
    except SunspinError as error:
        why = str(error)
    return Found(case, looked, scan, chain, why)


def chain_on_the_lines(case: Case) -> candidates.Chain:
    """The printed lines as candidates, a coarse grid as the box and some of it as the paper's own set."""
    rebound = rb.rebound_of(case, sun_directions(case.vehicle, case.telemetry))
    grid = np.stack(np.meshgrid(*rb.grid(case, 15).values(), indexing="ij"), axis=-1).reshape(-1, 3)
    lines = rb.published_candidates(case)
    sets = {"set": ("published", lines), "box": ("scan", grid), "recipe": ("scan", lines[::7])}
    chosen, box, recipe = (
        candidates.described(rebound, name, chain, f"{name} of the test", rebound.states(points), 0)
        for name, (chain, points) in sets.items()
    )
    return candidates.Chain(case, rebound, chosen, box, recipe, None, float("nan"), 0.02)
