"""The scan of initial rates against the telemetry, and the paper's recipe on it: near-minimum set, lines (section 2.3, Fig. 9).

The paper's own lines, which need no telemetry, are in :mod:`sunspin.philae.published_lines`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from sunspin.compute.pool import worker_count
from sunspin.estimate.scan.metrics import emd
from sunspin.estimate.scan.table import make_table
from sunspin.philae import rebound as rb
from sunspin.philae.candidates import Scanned, scanned
from sunspin.philae.row import Row, row
from sunspin.telemetry.case import Case

FOUND_RAD_S = 0.03
"""A published line is found again where a fitted one is nearer on average than this, two grid steps."""


@dataclass(frozen=True)
class LevelSet:
    """The scan against the telemetry.

    Attributes
    ----------
    seed : of the random choices of the line fit
    scan : table, EMD of every motion, the rebound
    near : near-minimum set by the paper's factor, and the lines fitted to it
    truth : "omega_B" (3) rad/s, "emd" and its heights "z" where the telemetry is the case's own twin, else empty
    """

    case: Case
    seed: int
    scan: Scanned
    near: rb.Families
    truth: dict[str, Any]

    @property
    def measured_z(self) -> np.ndarray:
        """The z components (n) that the rebound's directions have."""
        return self.scan.rebound.z

    @property
    def synthetic(self) -> bool:
        return bool(self.scan.rebound.samples.attrs.get("synthetic"))

    @property
    def lines_found(self) -> int:
        """How many of the published lines come out of the near-minimum set."""
        return sum(bool(deviation["mean"] <= FOUND_RAD_S) for deviation in self.near.deviation)


def compute(
    case: Case,
    sun: xr.Dataset,
    seed: int = 0,
    coarser: int = 1,
    workers: int | None = None,
    progress: bool = False,
) -> LevelSet:
    """Scan every `coarser`-th grid point against the directions `sun` (of `sun_directions`, whole landing)."""
    rebound = rb.rebound_of(case, sun)
    table = make_table(
        case.vehicle,
        rebound.sun_B,
        rb.grid(case, coarser),
        rb.nominal_speed(case.vehicle),
        rebound.window_s,
        workers=workers,
        progress=progress,
        mask=None if rb.counted(case) is None else "reconstructible",
    )
    volume = table.volume(rebound.z, rebound.weights, worker_count(workers))
    near = rb.families(case, volume, case.assumptions.study.near_minimum_factor, seed)
    return LevelSet(
        case,
        seed,
        scanned(rebound, table, volume.values),
        near,
        truth_emd(case, rebound.z, rebound.weights),
    )


def truth_emd(case: Case, measured_z: np.ndarray, weights: np.ndarray | None) -> dict[str, Any]:
    """For a twin: its true rate and Sun at the first sample after touchdown, and the EMD that a scan finds at this rate, from the
    direction that the panels show."""
    known = rb.twin_file(case)
    if not known:
        return {}
    omega, sun = (np.array(known[key]) for key in ("omega_B", "sun_B"))
    z = rb.seen_z(case, omega)
    return {"omega_B": omega, "sun_B": sun, "emd": emd(z, measured_z, weights_b=weights), "z": z}


def rows(result: LevelSet) -> list[Row]:
    """Figures of section 2.3 that need telemetry, beside ours."""
    case, near, truth = result.case, result.near, result.truth
    whose = "synthetic telemetry" if result.synthetic else "this telemetry"
    told = f"{len(near.points)} grid points below {near.factor} times the smallest"
    if truth:
        told += f"; at the true rate of the synthetic telemetry it is {truth['emd']:.4f}"
    count, runs = len(rb.published_lines(case)), int(near.emd.size)
    each = ", ".join(
        f"L{i + 1} {deviation['mean']:.3f}" for i, deviation in enumerate(near.deviation)
    )
    each = (
        f"mean distances of the fitted lines (rad/s): {each}"
        if each
        else "too few points in the set for four lines"
    )
    return [
        row(
            case,
            "emd_min",
            result.scan.smallest,
            whose=whose,
            directions=result.measured_z.size,
            near=told,
        ),
        row(
            case,
            "scan_runs",
            runs,
            published=rb.grid_size(case),
            agrees=True if runs == rb.grid_size(case) else None,
        ),
        row(
            case,
            "lines_found",
            result.lines_found,
            published=count,
            whose=whose,
            found=FOUND_RAD_S,
            omega_z=list(rb.LINE_RANGE),
            each=each,
            near=told,
        ),
    ]
