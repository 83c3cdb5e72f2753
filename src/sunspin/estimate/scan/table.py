"""One pass over a grid of initial rates for any number of targets: what each motion shows does not depend on what was measured.

A table keeps the histogram of r_z of every motion; its EMD to a target then costs a microsecond a motion, a fiftieth of the
motion itself, so that many data sets (twins, thresholds, resampled telemetry) take little more than one scan.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.compute.rows import ensemble
from sunspin.estimate.scan.rows import ScanRows, Start, distances_to, target_segments
from sunspin.estimate.scan.volume import volume
from sunspin.vehicle import Vehicle


@dataclass(frozen=True)
class Table:
    """Histograms `hist` (n, BINS; s) and outcomes (n) of the motions of a grid; 1 kB a motion."""

    rows: ScanRows
    hist: np.ndarray
    outcome: np.ndarray

    def distances(
        self, target_z: npt.ArrayLike, weights: npt.ArrayLike | None = None, workers: int = 1
    ) -> np.ndarray:
        """EMD (n) of every motion to measured z components (m), by the same arithmetic as `scan`: 1 where never seen."""
        return distances_to(self.hist, target_segments(target_z, weights), workers)

    def volume(
        self, target_z: npt.ArrayLike, weights: npt.ArrayLike | None = None, workers: int = 1
    ) -> xr.DataArray:
        """The same as a DataArray over (omega_x, omega_y, omega_z), as `scan` returns it."""
        values = {"emd": self.distances(target_z, weights, workers), "outcome": self.outcome}
        return volume(self.rows.vehicle, self.rows, "emd", values, np.size(target_z))


def make_table(
    vehicle: Vehicle,
    sun_B: npt.ArrayLike,
    axes: Mapping[str, np.ndarray],
    wheel_speed_rad_s: Any,
    duration_s: float,
    *,
    mask: str | None = "reconstructible",
    workers: int | None = None,
    progress: bool = False,
) -> Table:
    """Run every motion of a grid once.

    Parameters
    ----------
    sun_B : (3,)
        Direction to the Sun at the start, body axes.
    axes : omega_x, omega_y, omega_z -> 1-D, rad/s
    wheel_speed_rad_s : number, (n_wheel,) or None
    duration_s : s
    mask : "reconstructible", or None: all directions count
    workers, progress
        As in :func:`sunspin.compute.rows.ensemble`.
    """
    grid = [np.asarray(axes[name], dtype=np.float64) for name in ("omega_x", "omega_y", "omega_z")]
    start = Start.on_grid(vehicle, grid, sun_B, wheel_speed_rad_s)
    rows = ScanRows(vehicle, start, float(duration_s), "hist", mask=mask)
    out = ensemble(rows, workers=workers, progress=progress, label="scan")
    return Table(rows, out["hist"], out["outcome"])
