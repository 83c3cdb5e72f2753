"""The rows of a scan: initial states on a grid of rates, and what each one's Sun track is worth against the measured one.

Frozen plain data, so that they can be sent to other processes; compiled kernels are found there when they are first needed.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from sunspin.base.errors import InputError
from sunspin.dynamics import ensemble as k
from sunspin.dynamics.propagate import SUN_LENGTH_TOLERANCE, wheel_speeds
from sunspin.dynamics.torques import NOTHING, Acting
from sunspin.estimate.scan.histogram import emd_rows
from sunspin.estimate.scan.mask import reconstructible_mask
from sunspin.estimate.scan.metrics import direction_error
from sunspin.vehicle import Vehicle

BINS = 256
"""Bins of r_z over [-1, 1]; the CDF is linear inside a bin, the measured one exact. Error below 1e-3, see the tests."""

TRACK_DIRECTION_ERROR = 1e-3
"""Default error of the direction (rad) at the last sample for E, which compares directions."""

MAX_TARGET = 4096
"""Target samples beyond this are replaced by as many quantiles: measured tracks have tens, simulated ones 10^5."""


@dataclass(frozen=True)
class Start:
    """Initial states: a grid of body rates (three axes, rad/s), one direction to the Sun (3), wheel speeds (n_wheel) rad/s.

    Under torques (`acting`) also one attitude `B_from_N` (4), scalar last.
    """

    omega_x: np.ndarray
    omega_y: np.ndarray
    omega_z: np.ndarray
    sun_B: np.ndarray
    wheel_speed_rad_s: np.ndarray
    acting: Acting = NOTHING
    B_from_N: np.ndarray | None = None

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
        x, y, z = axes
        attitude = acting.attitude(B_from_N, sun)
        return cls(
            x,
            y,
            z,
            sun,
            wheel_speeds(vehicle, wheel_speed_rad_s),
            acting,
            attitude if acting.torques else None,
        )

    @property
    def shape(self) -> tuple[int, int, int]:
        return len(self.omega_x), len(self.omega_y), len(self.omega_z)

    def __len__(self) -> int:
        return int(np.prod(self.shape))

    def take(self, index: np.ndarray) -> k.Rows:
        """States of the rows `index`, in C order of the grid; made chunk by chunk so that no grid is stored."""
        where = np.unravel_index(index, self.shape)
        axes = (self.omega_x, self.omega_y, self.omega_z)
        omega = np.stack([axis[i] for axis, i in zip(axes, where, strict=True)], axis=-1)
        n = len(index)
        attitude = None if self.B_from_N is None else np.tile(self.B_from_N, (n, 1))
        return k.Rows(
            omega,
            np.tile(self.sun_B, (n, 1)),
            np.tile(self.wheel_speed_rad_s, (n, 1)),
            B_from_N=attitude,
        )


@dataclass(frozen=True)
class EmdRows:
    """Row -> EMD between the distributions of r_z, simulated over `duration_s` and given as `target_z` with `weights`.

    Simulated so that the EMD errs by `emd_error` (1e-3 unless given), or that the Sun's direction at the end errs by
    `direction_error` rad.
    """

    vehicle: Vehicle
    start: Start
    target_z: npt.ArrayLike
    weights: npt.ArrayLike | None
    duration_s: float
    mask: str | None = "reconstructible"
    wheel_mode: str | tuple[str, ...] = "coast"
    emd_error: float | None = None
    direction_error: float | None = None
    condition: k.Mask | None = field(init=False)
    segments: tuple[np.ndarray, ...] = field(init=False, repr=False)

    outputs = {"emd": ("float64", ()), "outcome": ("int8", ())}

    def __post_init__(self) -> None:
        if self.duration_s is None or not (np.isfinite(self.duration_s) and self.duration_s != 0):
            raise InputError("duration_s must be the length of the run in s", got=self.duration_s)
        if self.mask not in ("reconstructible", None):
            raise InputError('mask must be "reconstructible" or None', got=self.mask)
        k.check_commands(self.vehicle, self.wheel_mode)
        if self.emd_error is None and self.direction_error is None:
            object.__setattr__(self, "emd_error", k.EMD_ERROR)
        k.accuracy(self.direction_error, self.emd_error)
        object.__setattr__(
            self, "condition", reconstructible_mask(self.vehicle) if self.mask else None
        )
        object.__setattr__(self, "segments", target_segments(self.target_z, self.weights))

    @property
    def n_rows(self) -> int:
        return len(self.start)

    def __call__(self, index: np.ndarray) -> dict[str, np.ndarray]:
        emd, seen, outcome = self._distances(self.start.take(index))
        return {"emd": np.where(seen == 0, 1.0, emd), "outcome": outcome.astype(np.int8)}

    def _distances(self, states: k.Rows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """EMD, time (s) that the mask let pass, and outcome of each state (n)."""
        hist, outcome = histograms(
            self.vehicle,
            states,
            self.duration_s,
            self.condition,
            self.wheel_mode,
            emd_error=self.emd_error,
            direction_error=self.direction_error,
            acting=self.start.acting,
        )
        return *distances_to(hist, self.segments), outcome


def histograms(
    vehicle: Vehicle,
    states: k.Rows,
    duration_s: float,
    condition: k.Mask | None,
    wheel_mode: str | tuple[str, ...] = "coast",
    *,
    emd_error: float | None = k.EMD_ERROR,
    direction_error: float | None = None,
    bins: int = BINS,
    acting: Acting = NOTHING,
) -> tuple[np.ndarray, np.ndarray]:
    """Time (s) by r_z (n, bins) in the run of each state, of directions that the mask lets pass; outcome (n)."""
    result = k.run_rows(
        vehicle,
        states,
        float(duration_s),
        wheel_mode=wheel_mode,
        direction_error=direction_error,
        emd_error=emd_error,
        mask=condition,
        bins=bins,
        acting=acting,
    )
    return result.hist, result.outcome


def distances_to(
    hist: np.ndarray, segments: tuple[np.ndarray, ...], workers: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """EMD (n) of histograms (n, BINS) to the target of `target_segments`, NaN where nothing was seen; time seen (n).

    `workers`: threads, each of which takes its share of the rows.
    """
    emd, seen = np.empty(len(hist)), np.empty(len(hist))
    bin_of, low, high, level = segments

    def some(part: slice) -> None:
        emd_rows(hist[part], bin_of, low, high, level, emd[part], seen[part])

    if workers == 1:
        some(slice(None))
    else:
        share = -(-len(hist) // workers) or 1
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(some, [slice(at, at + share) for at in range(0, len(hist), share)]))
    return emd, seen


@dataclass(frozen=True)
class TrackRows:
    """Row -> E, the mean misfit of directions at `times` (n, s after the start) against `measured` (n, 3).

    The direction at the last of them errs by `direction_error` rad.
    """

    vehicle: Vehicle
    start: Start
    measured: np.ndarray
    times: np.ndarray
    wheel_mode: str | tuple[str, ...] = "coast"
    direction_error: float = TRACK_DIRECTION_ERROR

    outputs = {"E": ("float64", ()), "outcome": ("int8", ())}

    def __post_init__(self) -> None:
        k.check_commands(self.vehicle, self.wheel_mode)
        k.accuracy(self.direction_error, None)

    @property
    def n_rows(self) -> int:
        return len(self.start)

    def __call__(self, index: np.ndarray) -> dict[str, np.ndarray]:
        result = k.run_rows(
            self.vehicle,
            self.start.take(index),
            self.times,
            wheel_mode=self.wheel_mode,
            direction_error=self.direction_error,
            acting=self.start.acting,
        )
        simulated = result.sun_B
        return {
            "E": direction_error(simulated, self.measured),
            "outcome": result.outcome.astype(np.int8),
        }


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
    if z.size > MAX_TARGET:
        z, w = _thinned(z, w)
    order = np.argsort(z, kind="stable")
    place = np.clip((z[order] + 1) * BINS / 2, 0, BINS)
    knots = np.concatenate([np.arange(BINS + 1, dtype=float), place])
    knots = np.unique(knots)
    cdf = np.concatenate([[0.0], np.cumsum(w[order])]) / w.sum()
    bin_of = np.minimum(np.floor(knots[:-1]).astype(np.int64), BINS - 1)
    level = cdf[np.searchsorted(place, knots[:-1], side="right")]
    return bin_of, knots[:-1] - bin_of, knots[1:] - bin_of, level


def _thinned(z: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """MAX_TARGET quantiles in the place of a larger sample: the distribution moves by less than 1 / MAX_TARGET."""
    order = np.argsort(z, kind="stable")
    cdf = np.cumsum(w[order]) / w.sum()
    levels = (np.arange(MAX_TARGET) + 0.5) / MAX_TARGET
    return z[order][np.searchsorted(cdf, levels)], np.ones(MAX_TARGET)
