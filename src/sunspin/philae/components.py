"""How much the three components of the Sun's direction say: the paper keeps r_z and finds little in r_x and r_y (section 2.3).

The same scan is made with the distribution of each component, on every few grid points; for each the threshold of a 90 % set is
calibrated on the same synthetic rebounds. What a component says is what its set leaves of the scanned box.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sunspin.compute.rows import ensemble
from sunspin.dynamics import ensemble as k
from sunspin.estimate.scan.mask import allows
from sunspin.estimate.scan.rows import BINS, distances_to, target_segments
from sunspin.philae import rebound as rb
from sunspin.philae import threshold
from sunspin.philae.row import Row, row
from sunspin.telemetry.case import Case
from sunspin.vehicle import Vehicle

TWINS = 60
COARSER = 5
"""Every fifth grid point: what is compared is three sets on one grid."""

STEP_S = 4.0
"""Between instants of a simulated track, which counts as the time that a component spends in a bin."""

DIRECTION_ERROR = 1e-2
"""Of the directions (rad): less than a bin."""

CHUNK = 256
"""Motions whose tracks are in memory at once: 8 MB for 45 minutes."""


@dataclass(frozen=True)
class Components:
    """For x, y and z: smallest EMD, factor of the 90 % set, share of the scanned box that it holds."""

    case: Case
    emd_min: dict[str, float]
    factor: dict[str, float]
    share: dict[str, float]
    synthetic: bool
    twins: int
    motions: int


@dataclass(frozen=True)
class ComponentRows:
    """Row -> histograms (3, BINS) of the reconstructible r_x, r_y and r_z of one motion over `duration_s`."""

    vehicle: Vehicle
    states: k.Rows
    duration_s: float
    mask: k.Mask | None

    outputs = {"hist": ("float32", (3, BINS))}

    @property
    def n_rows(self) -> int:
        return len(self.states)

    def __call__(self, index: np.ndarray) -> dict[str, np.ndarray]:
        t = np.arange(STEP_S, self.duration_s + STEP_S / 2, STEP_S)
        track = k.run_rows(
            self.vehicle, self.states.take(index), t, direction_error=DIRECTION_ERROR
        ).sun_B
        seen = (
            np.ones(track.shape[:-1], dtype=bool) if self.mask is None else allows(self.mask, track)
        )
        place = np.clip(((track + 1) * BINS / 2).astype(int), 0, BINS - 1)
        number = np.broadcast_to(np.arange(len(index))[:, None], seen.shape)[seen] * BINS
        count = [
            np.bincount(number + place[..., axis][seen], minlength=len(index) * BINS)
            for axis in range(3)
        ]
        return {
            "hist": np.stack(count, axis=0)
            .reshape(3, len(index), BINS)
            .swapaxes(0, 1)
            .astype(np.float32)
        }


def compute(
    case: Case,
    rebound: rb.Rebound,
    seed: int = 0,
    coarser: int = 1,
    workers: int | None = None,
    twins: int = TWINS,
) -> Components:
    """Scan with each component in turn, and calibrate each."""
    axes = rb.grid(case, coarser * COARSER).values()
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    alike = threshold.alike_rebounds(rebound, twins, seed)
    starts = np.concatenate([grid, [one.omega_B for one in alike]])
    rows = ComponentRows(case.vehicle, rebound.states(starts), rebound.window_s, rb.counted(case))
    hist = ensemble(rows, workers=workers, chunk=CHUNK)["hist"]
    found: dict[str, tuple[float, float, float]] = {}
    for axis, name in enumerate("xyz"):
        scan, true = (
            np.ascontiguousarray(hist[part, axis])
            for part in (slice(None, len(grid)), slice(len(grid), None))
        )
        targets = [target_segments(one.seen_B[:, axis], one.weights) for one in alike]
        ratio = [
            distances_to(true[i : i + 1], target)[0] / distances_to(scan, target).min()
            for i, target in enumerate(targets)
        ]
        factor = float(
            np.sort(ratio)[
                threshold.check_confidence(len(ratio), case.assumptions.study.confidence)
            ]
        )
        measured = rebound.samples["sun_B"].values[rebound.told, axis]
        emd = distances_to(scan, target_segments(measured, rebound.weights))
        found[name] = float(emd.min()), factor, float(np.mean(emd < factor * emd.min()))
    emd_min, factor, share = ({name: values[i] for name, values in found.items()} for i in range(3))
    return Components(
        case,
        emd_min,
        factor,
        share,
        bool(rebound.samples.attrs.get("synthetic")),
        len(alike),
        len(grid),
    )


def rows(r: Components) -> list[Row]:
    """The paper's remark on r_x and r_y beside what the three scans leave."""
    shares = [r.share[name] for name in "xyz"]
    whose = "synthetic telemetry" if r.synthetic else "this telemetry"
    each = "; ".join(
        f"r_{n}: smallest EMD {r.emd_min[n]:.4f}, set below {r.factor[n]:.2f} times it"
        for n in "xyz"
    )
    return [
        row(
            r.case,
            "components",
            shares,
            agrees=bool(shares[2] < min(shares[:2])),
            confidence=r.case.assumptions.study.confidence,
            whose=whose,
            each=each,
            twins=r.twins,
            motions=r.motions,
        )
    ]
