"""The posterior against the paper's answer: how much smaller its region of rates is than lines of equal EMD (section 2.3).

The lines' volume is counted three ways: the paper's level set (EMD below 1.1 times the smallest) of the same telemetry; level
sets whose factor holds the truth of 90 % of twins (:mod:`sunspin.philae.coverage`); and the printed lines as tubes one grid
step wide.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sunspin.estimate.information import rate_volume
from sunspin.estimate.scan.lines import distances, point_at
from sunspin.estimate.scan.volume import near_minimum
from sunspin.philae import coverage, threshold
from sunspin.philae import rebound as rb
from sunspin.telemetry.case import Case
from sunspin.telemetry.sun import is_reconstructed, sun_directions

COUNTS = 0.01
"""Regions of less weight are left out of the posterior's volume."""


@dataclass(frozen=True)
class Against:
    """The comparison.

    Attributes
    ----------
    omega_B : (n, 3) draws of the posterior, rad/s
    volume : of its regions that hold 90 % of their rates, (rad/s)^3
    sets : name -> (points (m, 3) in rad/s or None, volume in (rad/s)^3)
    lines : (point, direction) of L1..L4; `nearest`: the one nearest to the posterior's mean, counted from 0; `distance` from it
    truth : (3) rad/s, where the telemetry is the case's own twin
    step : of the grid, rad/s; `omega_z`: ends of the scanned range, rad/s
    """

    omega_B: np.ndarray
    volume: float
    sets: dict[str, tuple[np.ndarray | None, float]]
    lines: list[tuple[np.ndarray, np.ndarray]]
    nearest: int
    distance: float
    truth: np.ndarray | None
    step: float
    omega_z: tuple[float, float]
    synthetic: bool

    @property
    def factors(self) -> dict[str, float]:
        """How many times each set is larger than the posterior's region."""
        return {name: size / self.volume for name, (_, size) in self.sets.items()}


def posterior_volume(tree: Any) -> float:
    """(rad/s)^3 that hold 90 % of the rates, summed over the regions; each an ellipsoid of the draws' covariance."""
    modes = tree["modes"]
    told = modes["weight"].values >= COUNTS
    return float(sum(rate_volume(c) for c in modes["omega_cov_B"].values[told]))


def against(
    case: Case, tree: Any, coarser: int = 1, workers: int | None = None, progress: bool = False
) -> Against:
    """Scan the grid against the case's telemetry and compare its level sets with the posterior of the same samples."""
    rebound = rb.rebound_samples(case, sun_directions(case.vehicle, case.telemetry))
    measured_z = rebound["sun_B"].values[is_reconstructed(rebound["status"]), 2]
    emd = rb.scan_against(case, measured_z, coarser, workers, progress)
    step = coarser * float(case.published["scan_step"].value)
    factor = case.assumptions.study.near_minimum_factor
    factors = {f"EMD < {factor:g} EMD_min": factor}
    known = coverage.shipped(case)
    for prior, twins in () if known is None else known.twins.items():
        factor = twins.threshold(threshold.CONFIDENCE, relative=True)[0]
        factors[f"EMD < {factor:.2f} EMD_min (90 %, {prior})"] = factor
    sets: dict[str, tuple[np.ndarray | None, float]] = {}
    for name, factor in factors.items():
        points = near_minimum(emd, factor)
        sets[name] = points, len(points) * step**3
    lines = rb.published_lines(case)
    low, high = case.published["scan_omega_z"].value
    length = sum((high - low) / abs(direction[2]) for _, direction in lines)
    sets["printed lines, one grid step wide"] = (
        None,
        float(length * case.published["scan_step"].value ** 2),
    )
    omega = tree["posterior"]["omega_B"].values.reshape(-1, 3)
    origin, along = (np.array(part) for part in zip(*lines, strict=True))
    apart = distances(omega.mean(axis=0)[None], origin, along)[:, 0]
    return Against(
        omega,
        posterior_volume(tree),
        sets,
        lines,
        int(np.argmin(apart)),
        float(apart.min()),
        rb.twin_truth(case),
        step,
        (low, high),
        bool(case.telemetry.attrs.get("synthetic")),
    )


def along_line(line: tuple[np.ndarray, np.ndarray], low: float, high: float) -> np.ndarray:
    """Ends (2, 3) of a line where omega_z is `low` and `high`."""
    return point_at(*line, 2, np.array([low, high]))
