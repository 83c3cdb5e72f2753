"""The rows of a scan: initial states on a grid of rates, and what is kept of the motion that follows from each.

Frozen plain data, so that they can be sent to other processes; compiled kernels are found there when they are first needed.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.dynamics import batch
from sunspin.dynamics.bodies import Bodies
from sunspin.dynamics.propagate import SUN_LENGTH_TOLERANCE, wheel_speeds
from sunspin.dynamics.torques import NOTHING, Acting
from sunspin.estimate.scan.end_rates import rates_at_end
from sunspin.estimate.scan.histogram import emd_rows
from sunspin.estimate.scan.mask import reconstructible_mask
from sunspin.estimate.scan.metrics import direction_error
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.planes import DirectionSet

BINS = 256
"""Bins of r_z over [-1, 1]; the CDF is linear inside a bin, the measured one exact. Error below 1e-3, see the tests."""

TRACK_ERROR = 1e-3
"""Default error of the direction (rad) at the last sample for E, which compares directions."""

MAX_TARGET = 4096
"""Target samples beyond this are replaced by as many quantiles: measured tracks have tens, simulated ones 10^5."""


@dataclass(frozen=True)
class Start:
    """Initial states: a grid of body rates (three axes, rad/s), one direction to the Sun (3), wheel speeds (n_wheel) rad/s.

    Under torques (`acting`) also one attitude `B_from_N` (4), scalar last. With `bodies` (m) each of them begins at each rate:
    the grid has a fourth axis.
    """

    omega_x: np.ndarray
    omega_y: np.ndarray
    omega_z: np.ndarray
    sun_B: np.ndarray
    wheel_speed_rad_s: np.ndarray
    acting: Acting = NOTHING
    B_from_N: np.ndarray | None = None
    bodies: Bodies | None = None

    @classmethod
    def on_grid(
        cls,
        vehicle: Vehicle,
        axes: list[np.ndarray],
        sun_B: npt.ArrayLike,
        wheel_speed_rad_s: Any,
        acting: Acting = NOTHING,
        B_from_N: npt.ArrayLike | None = None,
    ) -> Start:
        """Checked: `InputError` for a direction that is none, `MotionError` for speeds that do not fit the wheels, or an attitude
        that does not fit the direction."""
        sun = np.asarray(sun_B, dtype=np.float64)
        if sun.shape != (3,) or not abs(np.linalg.norm(sun) - 1) <= SUN_LENGTH_TOLERANCE:
            raise InputError("sun_B must be a unit vector of three components", got=sun_B)
        speeds, attitude = wheel_speeds(vehicle, wheel_speed_rad_s), acting.attitude(B_from_N, sun)
        x, y, z = axes
        return cls(x, y, z, sun, speeds, acting, attitude if acting.torques else None)

    @property
    def shape(self) -> tuple[int, ...]:
        rates = len(self.omega_x), len(self.omega_y), len(self.omega_z)
        return rates if self.bodies is None else (*rates, *self.bodies.shape)

    def __len__(self) -> int:
        return int(np.prod(self.shape))

    def take(self, index: np.ndarray) -> batch.Rows:
        """States of the rows `index`, in C order of the grid; made chunk by chunk so that no grid is stored."""
        n, (i, j, l, *body) = len(index), np.unravel_index(index, self.shape)
        return batch.Rows(
            np.stack([self.omega_x[i], self.omega_y[j], self.omega_z[l]], axis=-1),
            np.tile(self.sun_B, (n, 1)),
            np.tile(self.wheel_speed_rad_s, (n, 1)),
            None if self.bodies is None else self.bodies.take(*body),
            None if self.B_from_N is None else np.tile(self.B_from_N, (n, 1)),
        )


class Measure(NamedTuple):
    """What a scan keeps of each motion: `of` a run and the scan's target, an array (n, *shape).

    A run is a `batch.Heights` if there are bins, else a `batch.Motion`.
    """

    bins: int
    """Of a histogram of r_z; 0: the run has a track."""
    dtype: str
    shape: tuple[int, ...]
    of: Callable[[Any, Any], np.ndarray]


MEASURES = {
    "emd": Measure(BINS, "float64", (), lambda run, segments: distances_to(run.seconds, segments)),
    "hist": Measure(BINS, "float32", (BINS,), lambda run, _: run.seconds),
    "E": Measure(0, "float64", (), lambda run, sun_B: direction_error(run.sun_B, sun_B)),
    "speed": Measure(0, "float64", (), lambda run, _: np.linalg.norm(rates_at_end(run), axis=1)),
}
"""EMD to a target (paper, eq. 13), the histogram itself (s), E against directions (eq. 12), angular speed at the end (rad/s)."""


@dataclass(frozen=True)
class ScanRows:
    """Row -> what `measure`, a name in `MEASURES`, keeps of one motion of a grid, and its outcome.

    Attributes
    ----------
    t_s : length of the run in s; for E the times (n) of the directions, after the start.
    target : for EMD the pieces that `target_segments` gives, for E the directions (n, 3).
    mask : directions that count in a histogram: "reconstructible", or None for all.
    emd_error, direction_error : error wanted of the EMD, or of the Sun's direction at the end (rad); 1e-3 of what is measured.
    """

    vehicle: Vehicle
    start: Start
    t_s: float | np.ndarray
    measure: str
    target: Any = None
    mask: str | None = None
    wheel_mode: str | tuple[str, ...] = "coast"
    emd_error: float | None = None
    direction_error: float | None = None
    condition: DirectionSet | None = field(init=False)

    def __post_init__(self) -> None:
        if self.mask not in ("reconstructible", None):
            raise InputError('mask must be "reconstructible" or None', got=self.mask)
        batch.one_command(self.vehicle, self.wheel_mode)
        if self.emd_error is None and self.direction_error is None:
            default = (
                ("emd_error", batch.EMD_ERROR) if self.bins else ("direction_error", TRACK_ERROR)
            )
            object.__setattr__(self, *default)
        batch.check_errors(self.direction_error, self.emd_error)
        condition = reconstructible_mask(self.vehicle) if self.mask else None
        object.__setattr__(self, "condition", condition)

    @property
    def bins(self) -> int:
        """Of the histograms that the runs make; 0: they make tracks."""
        return MEASURES[self.measure].bins

    @property
    def outputs(self) -> dict[str, tuple[str, tuple[int, ...]]]:
        measure = MEASURES[self.measure]
        return {self.measure: (measure.dtype, measure.shape), "outcome": ("int8", ())}

    @property
    def n_rows(self) -> int:
        return len(self.start)

    def __call__(self, index: np.ndarray) -> dict[str, np.ndarray]:
        states, acting = self.start.take(index), self.start.acting
        run: batch.Heights | batch.Motion
        if self.bins:
            run = batch.sun_heights(
                self.vehicle,
                states,
                float(self.t_s),
                command=self.wheel_mode,
                counted=self.condition,
                error=self.direction_error,
                emd_error=self.emd_error,
                acting=acting,
            )
        else:
            error = TRACK_ERROR if self.direction_error is None else self.direction_error
            run = batch.run(
                self.vehicle,
                states,
                self.t_s,
                command=self.wheel_mode,
                error=error,
                acting=acting,
            )
        values = MEASURES[self.measure].of(run, self.target)
        return {self.measure: values, "outcome": run.outcome.astype(np.int8)}


def track_rows(vehicle: Vehicle, start: Start, track: xr.Dataset, **options: Any) -> ScanRows:
    """E against the directions that a track gives: `sun_B (time, axis)` at `time`, s after the start. `options`: of `ScanRows`."""
    sun_B = np.asarray(track["sun_B"], dtype=np.float64)
    known = np.all(np.isfinite(sun_B), axis=1)
    if not known.any():
        raise InputError("the track holds no direction to compare with")
    times = np.asarray(track["time"], dtype=np.float64)[known]
    return ScanRows(vehicle, start, times, "E", sun_B[known], **options)


def distances_to(
    hist: np.ndarray, segments: tuple[np.ndarray, ...], workers: int = 1
) -> np.ndarray:
    """EMD (n) of histograms (n, BINS) to the target of `target_segments`; 1, the largest there is, where nothing was seen.

    `workers`: threads, each of which takes its share of the rows.
    """
    emd, share = np.empty(len(hist)), -(-len(hist) // workers) or 1

    def fill(at: int) -> None:
        emd_rows(hist[at : at + share], *segments, emd[at : at + share])

    if workers == 1:
        fill(0)
    else:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(fill, range(0, len(hist), share)))
    return emd


def target_segments(
    target_z: npt.ArrayLike, weights: npt.ArrayLike | None = None
) -> tuple[np.ndarray, ...]:
    """The target's CDF as constant pieces inside the kernel's bins: (bin, low, high, level); low, high are fractions."""
    z = np.asarray(target_z, dtype=np.float64).ravel()
    w = np.ones_like(z) if weights is None else np.asarray(weights, dtype=np.float64).ravel()
    if (
        z.size == 0
        or w.shape != z.shape
        or not np.all(np.isfinite(z))
        or np.abs(z).max() > 1 + 1e-6
    ):
        raise InputError(
            "target_z must be one or more values in [-1, 1], with as many weights if any"
        )
    if not (np.all(w >= 0) and w.sum() > 0):
        raise InputError("weights must not be negative and not all zero")
    order = np.argsort(z, kind="stable")
    if z.size > MAX_TARGET:  # their distribution moves by less than 1 / MAX_TARGET
        levels = (np.arange(MAX_TARGET) + 0.5) / MAX_TARGET
        z = z[order][np.searchsorted(np.cumsum(w[order]) / w.sum(), levels)]
        w, order = np.ones(MAX_TARGET), np.arange(MAX_TARGET)
    place = np.clip((z[order] + 1) * BINS / 2, 0, BINS)
    knots = np.unique(np.concatenate([np.arange(BINS + 1, dtype=float), place]))
    cdf = np.concatenate([[0.0], np.cumsum(w[order])]) / w.sum()
    bin_of = np.minimum(np.floor(knots[:-1]).astype(np.int64), BINS - 1)
    level = cdf[np.searchsorted(place, knots[:-1], side="right")]
    return bin_of, knots[:-1] - bin_of, knots[1:] - bin_of, level
