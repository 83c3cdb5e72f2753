"""Rows of a scan: each is a motion with an initial state on a grid of body rates, of which the scan keeps one quantity.

All classes are frozen data without compiled code, so that they can be sent to other processes.
"""

from __future__ import annotations

from collections.abc import Callable
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
from sunspin.estimate.scan.directions import reconstructible_mask
from sunspin.estimate.scan.histogram import BINS, distances_to_target
from sunspin.estimate.scan.metrics import direction_error
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.planes import DirectionSet

TRACK_ERROR = 1e-3
"""Allowed error of the direction (rad) at the last sample if E is computed and no other error is given."""


@dataclass(frozen=True)
class Start:
    """Initial states on a grid of body rates, all with the same Sun direction and wheel speeds.

    Attributes
    ----------
    omega_x, omega_y, omega_z : (n_x), (n_y), (n_z) rad/s, axes of the grid
    sun_B : (3), direction to the Sun, body axes
    wheel_speed_rad_s : (n_wheel)
    acting : torques on the body
    B_from_N : (4), attitude as a quaternion, scalar last; needed only with torques
    bodies : (m), bodies in place of the vehicle's own, which are the last axis of the grid; None: the vehicle's
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
        """Return the states on a grid with `axes` (omega_x, omega_y, omega_z), rad/s, after a check of the arguments.

        Raises `InputError` if `sun_B` is not a unit vector, and `MotionError` if the speeds do not fit the wheels or the attitude
        does not fit the direction.
        """
        sun = np.asarray(sun_B, dtype=np.float64)
        if sun.shape != (3,) or not abs(np.linalg.norm(sun) - 1) <= SUN_LENGTH_TOLERANCE:
            raise InputError("sun_B must be a unit vector of three components", got=sun_B)
        speeds, attitude = wheel_speeds(vehicle, wheel_speed_rad_s), acting.attitude(B_from_N, sun)
        x, y, z = axes
        return cls(
            omega_x=x,
            omega_y=y,
            omega_z=z,
            sun_B=sun,
            wheel_speed_rad_s=speeds,
            acting=acting,
            B_from_N=attitude if acting.torques else None,
        )

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the shape of the grid: (n_x, n_y, n_z), or (n_x, n_y, n_z, m) with bodies."""
        rates = len(self.omega_x), len(self.omega_y), len(self.omega_z)
        return rates if self.bodies is None else (*rates, *self.bodies.shape)

    def __len__(self) -> int:
        """Return the number of states."""
        return int(np.prod(self.shape))

    def take(self, index: np.ndarray) -> batch.Rows:
        """Return the states of the rows `index` (n), numbered in C order of the grid. No array of the whole grid is made."""
        n, (x, y, z, *body) = len(index), np.unravel_index(index, self.shape)
        return batch.Rows(
            np.stack([self.omega_x[x], self.omega_y[y], self.omega_z[z]], axis=-1),
            np.tile(self.sun_B, (n, 1)),
            np.tile(self.wheel_speed_rad_s, (n, 1)),
            None if self.bodies is None else self.bodies.take(*body),
            None if self.B_from_N is None else np.tile(self.B_from_N, (n, 1)),
        )


class Measure(NamedTuple):
    """A quantity that a scan keeps of each motion.

    Attributes
    ----------
    histogram : True if it is computed from a histogram of r_z (`batch.Heights`), False if from directions (`batch.Motion`)
    dtype, shape : type and shape of the quantity of one motion
    compute : function of the results of n motions and of the scan's target that returns the quantities (n, *shape)
    """

    histogram: bool
    dtype: str
    shape: tuple[int, ...]
    compute: Callable[[Any, Any], np.ndarray]


MEASURES = {
    # the target of the EMD: segments of `target_segments`
    "emd": Measure(True, "float64", (), lambda run, cdf: distances_to_target(run.seconds, cdf)),
    "hist": Measure(True, "float32", (BINS,), lambda run, _: run.seconds),
    "E": Measure(False, "float64", (), lambda run, sun_B: direction_error(run.sun_B, sun_B)),
}
"""Quantities by name: EMD to a target (paper, eq. 13), the histogram of r_z itself (s in each bin), E to directions (eq. 12)."""


@dataclass(frozen=True)
class ScanRows:
    """All motions of a grid, for `compute.rows.ensemble`: a call runs some of them and returns one measure and the outcome of each.

    Attributes
    ----------
    wheel_mode : "coast", "hold", "brake", or one for each wheel
    t_s : length of the run in s; for E the times (n) of the directions, s after the start
    measure : a name in `MEASURES`
    target : data to which motions are compared: for EMD the result of `target_segments`, for E the directions (n, 3), else None
    mask : directions that count in a histogram: "reconstructible", or None for all
    emd_error, direction_error : allowed error of the EMD, or of the Sun direction at the end (rad). If neither is given, it is 1e-3
        of the EMD, or 1e-3 rad for E.
    condition : the set of directions that `mask` names, `counted` of :func:`batch.sun_heights`; None if all count
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
        """Check the options, and set the default error and `condition`."""
        if self.mask not in ("reconstructible", None):
            raise InputError('mask must be "reconstructible" or None', got=self.mask)
        batch.one_command(self.vehicle, self.wheel_mode)  # only for its check of the mode
        if self.emd_error is None and self.direction_error is None:
            if MEASURES[self.measure].histogram:
                object.__setattr__(self, "emd_error", batch.EMD_ERROR)
            else:
                object.__setattr__(self, "direction_error", TRACK_ERROR)
        batch.check_errors(self.direction_error, self.emd_error)
        condition = reconstructible_mask(self.vehicle) if self.mask else None
        object.__setattr__(self, "condition", condition)

    @property
    def outputs(self) -> dict[str, tuple[str, tuple[int, ...]]]:
        """Return the dtype and the shape of each result of one motion, by name."""
        measure = MEASURES[self.measure]
        return {self.measure: (measure.dtype, measure.shape), "outcome": ("int8", ())}

    @property
    def n_rows(self) -> int:
        """Return the number of motions."""
        return len(self.start)

    def __call__(self, index: np.ndarray) -> dict[str, np.ndarray]:
        """Run the motions of the rows `index` (n) and return their measure and outcome (n, ...), by name."""
        states, acting = self.start.take(index), self.start.acting
        run: batch.Heights | batch.Motion
        measure = MEASURES[self.measure]
        if measure.histogram:
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
                self.vehicle, states, self.t_s, command=self.wheel_mode, error=error, acting=acting
            )
        values = measure.compute(run, self.target)
        return {self.measure: values, "outcome": run.outcome.astype(np.int8)}


def track_rows(vehicle: Vehicle, start: Start, track: xr.Dataset, **options: Any) -> ScanRows:
    """Return the rows of a scan that compare each motion with a measured track of the Sun, by the direction error E.

    track : Dataset
        `sun_B (time, axis)`, unit vectors in body axes, at `time`, s after the start. Samples without a direction are left out.
    options
        Further fields of `ScanRows`.

    Raises
    ------
    InputError
        No sample of the track has a direction.
    """
    sun_B = np.asarray(track["sun_B"], dtype=np.float64)
    known = np.all(np.isfinite(sun_B), axis=1)
    if not known.any():
        raise InputError("the track holds no direction to compare with")
    times = np.asarray(track["time"], dtype=np.float64)[known]
    return ScanRows(vehicle, start, t_s=times, measure="E", target=sun_B[known], **options)
