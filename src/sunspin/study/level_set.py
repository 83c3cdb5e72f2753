"""The scan of initial rates, its near-minimum set and the lines through it (paper, section 2.3, Fig. 9).

Two targets: the telemetry, and the common distribution of the published lines, which shows them without any telemetry.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from sunspin.cases import Case
from sunspin.infer.metrics import emd
from sunspin.infer.table import make_table
from sunspin.measure.sun import is_reconstructed
from sunspin.study import rebound as rb
from sunspin.study.row import Row, published_row


@dataclass(frozen=True)
class LevelSet:
    """What one pass over the grid gives.

    Attributes
    ----------
    seed : of the random choices of the line fit
    rebound : Dataset of `sun_directions`, first touchdown to collision
    measured_z : (n,) its reconstructed z components
    pooled : for each published line, reconstructible r_z of motions begun on it
    twin, clean : near-minimum set against the telemetry, against the pooled distribution
    truth : "omega_B" (3) rad/s and "emd" where the telemetry is the case's own twin, else empty
    thresholds : rows of `rebound.by_threshold`
    """

    case: Case
    seed: int
    rebound: xr.Dataset
    measured_z: np.ndarray
    pooled: list[np.ndarray]
    twin: rb.Families
    clean: rb.Families
    truth: dict[str, Any]
    thresholds: list[dict[str, Any]]

    @property
    def synthetic(self) -> bool:
        return bool(self.rebound.attrs.get("synthetic"))


def compute(
    case: Case, sun: xr.Dataset, seed: int = 0, coarser: int = 1, workers: int | None = None, progress: bool = False
) -> LevelSet:
    """Scan every `coarser`-th grid point once, compare with both targets; `sun` of `sun_directions`, whole landing."""
    rebound = rb.rebound_samples(case, sun)
    measured_z = rebound["sun_B"].values[is_reconstructed(rebound["status"]), 2]
    pooled = rb.pooled_z(case)
    table = make_table(
        case.vehicle, rb.first_sun(case), rb.grid(case, coarser), rb.nominal_speed(case.vehicle), rb.window_s(case),
        workers=workers, progress=progress,
    )  # fmt: skip
    clean = rb.families(case, table.volume(np.concatenate(pooled)), rb.LINES_FACTOR, seed)
    twin = rb.families(case, table.volume(measured_z), case.published["near_minimum_factor"].value, seed)
    return LevelSet(
        case, seed, rebound, measured_z, pooled, twin, clean, truth_emd(case, measured_z), rb.by_threshold(case, clean.emd, seed)
    )


def truth_emd(case: Case, measured_z: np.ndarray) -> dict[str, Any]:
    """For a twin: its true rate at the first sample after touchdown and the EMD that the truth itself reaches."""
    truth = rb.twin_truth(case)
    if truth is None:
        return {}
    return {"omega_B": truth, "emd": emd(rb.seen_z(case, truth), measured_z)}


def rows(result: LevelSet) -> list[Row]:
    """Figures of section 2.3 beside ours."""
    case, twin, clean, truth = result.case, result.twin, result.clean, result.truth
    smallest, spread = float(twin.emd.min()), max(rb.pooled_spread(result.pooled))
    fifth = case.published["emd_min"].value / 5
    note = f"{len(twin.points)} grid points below {twin.factor} times the smallest"
    if truth:
        note += f"; the truth of the twin reaches {truth['emd']:.4f}"
    found = [
        published_row(case, "emd_min", smallest, None, f"of this telemetry, not of the flown one; {note}"),
        Row(
            "scan_runs", "initial conditions scanned", rb.grid_size(case), int(twin.emd.size), "1", 0,
            bool(twin.emd.size == rb.grid_size(case)),
            "101 x 101 x 41 grid points", "paper, section 2.3, from range and step",
        ),
        Row(
            "lines_common", "the four published lines give one distribution of r_z: largest EMD of a line to the common one",
            0.0, spread, "1", fifth, bool(spread <= fifth),
            f"points with omega_z in {list(rb.POOL_RANGE)} rad/s; tolerance: a fifth of the published smallest EMD",
            "paper, section 2.3, implied by the lines",
        ),
    ]  # fmt: skip
    fitted = [] if clean.lines is None else [clean.lines.isel(line=i) for i in clean.partner]
    for k, (line, deviation) in enumerate(zip(fitted, clean.deviation, strict=True)):
        found.append(
            published_row(
                case, f"line_L{k + 1}",
                [line["point"].values.round(4).tolist(), line["direction"].values.round(4).tolist()], None,
                f"from the published lines' own distribution, EMD below {clean.factor:g} times its minimum: angle "
                f"{np.degrees(deviation['angle_rad']):.1f} deg, mean distance {deviation['mean']:.4f} rad/s, largest "
                f"{deviation['max']:.4f} rad/s over omega_z in {list(rb.LINE_RANGE)}",
            )
        )  # fmt: skip
        found.append(
            Row(
                f"line_L{k + 1}_distance", f"mean distance of our line from L{k + 1}", 0.0, deviation["mean"], "rad/s", 0.03,
                bool(deviation["mean"] <= 0.03), "two grid steps", "paper, section 2.3",
            )
        )  # fmt: skip
    found.append(
        Row(
            "lines_by_threshold", "near-minimum set of the published lines' distribution against the factor on the minimum",
            case.published["near_minimum_factor"].value, result.thresholds, "1 (factor), rad/s (mean distances from L1..L4)", None,
            None, f"EMD_min {float(clean.emd.min()):.4f}; with few points there are no four lines", "paper, section 2.3, Fig. 9",
        )
    )  # fmt: skip
    return found
