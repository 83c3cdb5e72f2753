"""Why a direct fit fails after the touchdown: how an error of any input grows with the length of the window.

The direction error of a run with one input changed by a little is measured against the unchanged run. The motion is not
chaotic: phases drift apart, at a constant rate where a frequency is off and at a growing one where friction is. Once the
error is of the size of a turn, E no longer tells near from far, so its valley is as narrow as one radian over that growth.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.compute.rows import ensemble
from sunspin.dynamics.propagate import propagate, wheel_speeds
from sunspin.estimate.scan.mask import allows, reconstructible_mask
from sunspin.estimate.scan.metrics import direction_error, emd
from sunspin.estimate.scan.parameters import nominal, variants, varied
from sunspin.estimate.scan.rows import ScanRows, Start, track_rows
from sunspin.vehicle import Vehicle

RATES = ("omega_x", "omega_y", "omega_z")

SMALL_CHANGE = 1e-6
"""Relative change of an input: small against one that turns a phase by a radian, large against the propagator's 1e-12."""

ONE_PERCENT = 0.01

STEP_S = 2.0
"""Between directions of a track, against a fastest turn of about 8 s."""

FIT_FROM = 0.1
"""Part of the window after which the growth is fitted by a power of time."""


@dataclass(frozen=True)
class Motion:
    """A motion to study: vehicle, initial rate (3) rad/s, direction to the Sun (3), wheel speeds (n_wheel) rad/s, length s."""

    vehicle: Vehicle
    omega_B: np.ndarray
    sun_B: np.ndarray
    wheel_speed_rad_s: np.ndarray
    duration_s: float

    @classmethod
    def of(
        cls,
        vehicle: Vehicle,
        omega_B: npt.ArrayLike,
        sun_B: npt.ArrayLike,
        wheel_speed_rad_s: Any,
        duration_s: float,
    ) -> Motion:
        """Checked: the direction is made a unit vector, wheel speeds may be a number or None."""
        sun = np.asarray(sun_B, dtype=np.float64)
        if not (np.isfinite(duration_s) and duration_s > 0):
            raise InputError("duration_s must be positive", got=duration_s)
        speeds = wheel_speeds(vehicle, wheel_speed_rad_s)
        return cls(
            vehicle,
            np.asarray(omega_B, dtype=np.float64),
            sun / np.linalg.norm(sun),
            speeds,
            float(duration_s),
        )

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of what can be changed: rates, moments of inertia, and where there is a wheel its speed and friction."""
        wheel = ("wheel_speed", "mu_0", "mu_1") if self.vehicle.wheels else ()
        return (*RATES, "theta_xx", "theta_yy", "theta_zz", *wheel)

    def changed(self, name: str, relative: float) -> Motion:
        """With one input changed by this part of itself; a rate by this part of the angular speed."""
        if name in RATES:
            step = relative * np.linalg.norm(self.omega_B)
            return replace(self, omega_B=self.omega_B + step * (np.array(RATES) == name))
        if name == "wheel_speed":
            return replace(self, wheel_speed_rad_s=self.wheel_speed_rad_s * (1 + relative))
        value = nominal(self.vehicle, name) * (1 + relative)
        return replace(self, vehicle=varied(self.vehicle, name, value))

    def track(self, t_s: np.ndarray) -> np.ndarray:
        """Directions to the Sun (n, 3) at t_s."""
        run = propagate(self.vehicle, self.omega_B, self.sun_B, self.wheel_speed_rad_s, t_s)
        return run["sun_B"].values


def growth(motion: Motion) -> xr.Dataset:
    """Direction error per relative change of each input against the length of the window, by differences.

    Returns
    -------
    xarray.Dataset
        On (input, time): `error_rad`, the largest angle so far between changed and unchanged run over the relative change
        (rad; of a rate: relative to the angular speed). On `input`: `power`, of time in a fit to the later nine tenths.
    """
    t = np.arange(0.0, motion.duration_s + STEP_S / 2, STEP_S)
    unchanged = motion.track(t)
    error = []
    for name in motion.inputs:
        chord = np.linalg.norm(motion.changed(name, SMALL_CHANGE).track(t) - unchanged, axis=1)
        error.append(
            np.maximum.accumulate(2 * np.arcsin(np.minimum(chord / 2, 1.0))) / SMALL_CHANGE
        )
    values = np.array(error)
    late = t >= FIT_FROM * motion.duration_s
    power = [
        float(np.polyfit(np.log(t[late]), np.log(np.maximum(row[late], 1e-12)), 1)[0])
        for row in values
    ]
    return xr.Dataset(
        {
            "error_rad": (
                ("input", "time"),
                values,
                {"units": "rad", "long_name": "direction error per relative change"},
            ),
            "power": (
                "input",
                power,
                {"units": "1", "long_name": "power of time with which the error grows"},
            ),
        },
        coords={"input": list(motion.inputs), "time": ("time", t, {"units": "s"})},
        attrs={
            "vehicle": motion.vehicle.name,
            "angular_speed_rad_s": float(np.linalg.norm(motion.omega_B)),
        },
    )


def one_percent(motion: Motion, sample_step_s: float) -> xr.Dataset:
    """E and EMD between the motion and the same with one input changed by one percent, the larger of both signs.

    E at samples every `sample_step_s`, EMD over the directions that the panels allow to reconstruct (paper, eqs. 12, 13).
    On `input`: `E`, `emd`.
    """
    t = np.arange(0.0, motion.duration_s + STEP_S / 2, STEP_S)
    every = max(round(sample_step_s / STEP_S), 1)
    mask = reconstructible_mask(motion.vehicle)
    unchanged = motion.track(t)
    seen = unchanged[allows(mask, unchanged), 2]
    if seen.size == 0:
        raise InputError(
            "none of this motion's directions could be reconstructed", do="choose another motion"
        )
    table = np.zeros((len(motion.inputs), 2))
    for i, name in enumerate(motion.inputs):
        for sign in (1, -1):
            track = motion.changed(name, sign * ONE_PERCENT).track(t)
            z = track[allows(mask, track), 2]
            error = direction_error(track[::every], unchanged[::every])
            table[i] = np.maximum(table[i], (error, emd(z, seen) if z.size else 1.0))
    return xr.Dataset(
        {
            "E": ("input", table[:, 0], {"units": "1"}),
            "emd": ("input", table[:, 1], {"units": "1"}),
        },
        coords={"input": list(motion.inputs)},
        attrs={"relative_change": ONE_PERCENT},
    )


def valleys(
    motion: Motion,
    change_rad_s: npt.ArrayLike,
    windows_s: npt.ArrayLike,
    sample_step_s: float,
    workers: int | None = None,
) -> xr.DataArray:
    """E over (window, change of omega_x in rad/s) against the motion's own directions, sampled every `sample_step_s`."""
    change, windows = (np.asarray(x, dtype=np.float64) for x in (change_rad_s, windows_s))
    axes = [motion.omega_B[0] + change, motion.omega_B[1:2], motion.omega_B[2:]]
    start = Start.on_grid(motion.vehicle, axes, motion.sun_B, motion.wheel_speed_rad_s)
    E = []
    for window in windows:
        times = np.arange(0.0, window + sample_step_s / 2, sample_step_s)
        rows = ScanRows(motion.vehicle, start, times, "E", motion.track(times))
        E.append(ensemble(rows, workers=workers)["E"])
    return xr.DataArray(
        np.array(E),
        dims=("window", "change"),
        name="E",
        attrs={"units": "1"},
        coords={
            "window": ("window", windows, {"units": "s"}),
            "change": ("change", change, {"units": "rad s-1"}),
        },
    )


def valley_width(valley: xr.DataArray) -> np.ndarray:
    """Full width (n_window) in rad/s of the valley around no change, at half its depth (from zero to the median of E)."""
    change, widths = valley["change"].values, []
    for row in valley.values:
        above = row > np.median(row) / 2
        left, right = change[above & (change < 0)], change[above & (change > 0)]
        widths.append(
            (right.min() if right.size else np.inf) - (left.max() if left.size else -np.inf)
        )
    return np.array(widths)


def parameter_map(
    motion: Motion,
    track: xr.Dataset,
    parameters: Mapping[str, np.ndarray],
    workers: int | None = None,
) -> xr.DataArray:
    """E over a grid of the vehicle's parameters (names of `varied`) for a motion's start, against the directions of a track.

    `track`: `sun_B (time, axis)` at `time`, s after the start; samples without a direction take no part.
    """
    rates = [motion.omega_B[i : i + 1] for i in range(3)]
    start = Start.on_grid(motion.vehicle, rates, motion.sun_B, motion.wheel_speed_rad_s)
    start = replace(start, bodies=variants(motion.vehicle, parameters))
    E = ensemble(track_rows(motion.vehicle, start, track), workers=workers)["E"]
    coords = {name: np.asarray(values, dtype=np.float64) for name, values in parameters.items()}
    shape = [len(values) for values in coords.values()]
    return xr.DataArray(E.reshape(shape), coords, list(coords), name="E", attrs={"units": "1"})


def of_length(error: Any, length: float) -> Any:
    """E for a start direction of another length than one: the motion is linear in it, so E = (1 - length (1 - 2 E_1)) / 2."""
    return (1 - length * (1 - 2 * error)) / 2
