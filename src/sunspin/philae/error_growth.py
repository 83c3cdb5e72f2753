"""Growth of the effect of an input's error with the length of the window: why a fit of E fails after the touchdown.

The direction of a run with one input changed by a little is compared with that of the unchanged run. The motion is not chaotic:
phases drift apart, at a constant rate if a frequency is wrong and at a growing rate if friction is. Beyond a phase error of one
radian E no longer depends on the distance to the truth. So the width of its valley is one radian divided by that growth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.base.errors import InputError, MotionError
from sunspin.compute.rows import ensemble
from sunspin.dynamics.batch import OUTCOME_TEXT, Outcome, Rows, run
from sunspin.dynamics.bodies import Bodies
from sunspin.dynamics.propagate import wheel_speeds
from sunspin.estimate.scan.directions import reconstructible_mask
from sunspin.estimate.scan.metrics import direction_error, emd
from sunspin.estimate.scan.rows import ScanRows, Start, track_rows
from sunspin.estimate.scan.volume import RATES
from sunspin.vehicle import Vehicle

INERTIA = {
    "theta_xx": (0, 0),
    "theta_yy": (1, 1),
    "theta_zz": (2, 2),
    "theta_xy": (0, 1),
    "theta_xz": (0, 2),
    "theta_yz": (1, 2),
}
"""Parameters that are elements of the inertia tensor (kg m2), with their indices."""

FRICTION = {"mu_0": "coulomb_N_m", "mu_1": "viscous_N_m_s"}
"""Parameters that are the friction of every wheel (N m, N m s), with the names of their fields."""

WHEEL_PARAMETERS = (*FRICTION, "J")
"""Parameters of every wheel: friction, and axial inertia J (kg m2)."""

SMALL_CHANGE = 1e-6
"""Relative change of an input for a derivative: it changes phases by far less than a radian, and far more than `TRACK_ERROR`."""

TRACK_ERROR = 1e-11
"""Largest error (rad) of the last direction of a track."""

ONE_PERCENT = 0.01
"""Relative change of an input in `one_percent`."""

STEP_S = 2.0
"""Time between directions of a track, s. The fastest motions of the paper take about 8 s for a revolution."""

FIT_FROM = 0.1
"""Part of the window after which the growth is fitted by a power of time."""


def with_parameter(vehicle: Vehicle, name: str, value: float) -> Vehicle:
    """Return the vehicle with another value of one parameter.

    Parameters
    ----------
    name : "theta_xx", "theta_xy", ..., "mu_0", "mu_1" or "J"
        Element of the inertia tensor (kg m2; symmetric elements change together), or friction (N m; N m s) or axial inertia (kg m2)
        of all wheels.
    """
    if name in INERTIA:
        tensor = np.array(vehicle.require_inertia())
        i, j = INERTIA[name]
        tensor[i, j] = tensor[j, i] = value
        return replace(vehicle, inertia_kg_m2=tensor)
    _require_parameter_of_wheel(vehicle, name)
    wheels = [
        replace(wheel, inertia_kg_m2=value)
        if name == "J"
        else replace(wheel, friction=replace(wheel.friction, **{FRICTION[name]: value}))
        for wheel in vehicle.wheels
    ]
    return replace(vehicle, wheels=tuple(wheels))


def nominal_value(vehicle: Vehicle, name: str) -> float:
    """Return the vehicle's own value of a parameter of `with_parameter`; of wheels, that of the first."""
    if name in INERTIA:
        return float(vehicle.require_inertia()[INERTIA[name]])
    _require_parameter_of_wheel(vehicle, name)
    wheel = vehicle.wheels[0]
    return float(wheel.inertia_kg_m2 if name == "J" else getattr(wheel.friction, FRICTION[name]))


def _require_parameter_of_wheel(vehicle: Vehicle, name: str) -> None:
    """Raise `InputError` unless this is a parameter of wheels and the vehicle has a wheel."""
    if name not in WHEEL_PARAMETERS:
        known = ", ".join([*INERTIA, *WHEEL_PARAMETERS])
        raise InputError("there is no parameter of this name", got=name, do=f"known: {known}")
    if not vehicle.wheels:
        what = f"{name} belongs to a wheel, and {vehicle.name!r} has none"
        raise InputError(what, do="vary its inertia instead")


def bodies_on_grid(vehicle: Vehicle, parameters: Mapping[str, np.ndarray]) -> Bodies:
    """Return the bodies (n) at the points of a grid of parameters, in C order. `parameters`: values of each, by name."""

    @cache  # the check of a new vehicle takes milliseconds
    def body(*changes: tuple[str, float]) -> Bodies:
        changed = vehicle
        for name, value in changes:
            changed = with_parameter(changed, name, float(value))
        return Bodies.of(changed)

    bodies = []
    for point in product(*parameters.values()):
        changes = list(zip(parameters, point, strict=True))
        # inertias of body and wheels are checked together; friction fits any of them, so it is made once for each value
        rigid = body(*(change for change in changes if change[0] not in FRICTION))
        wheels = body(*(change for change in changes if change[0] in FRICTION))
        friction = {name: getattr(wheels, name) for name in FRICTION.values()}
        bodies.append(replace(rigid, **friction))
    return Bodies.stack(bodies)


@dataclass(frozen=True)
class ReferenceMotion:
    """A motion with which changed ones are compared.

    `omega_B` (3), initial rate in rad/s; `sun_B` (3), unit vector to the Sun at the start; `wheel_speed_rad_s` (n_wheel).
    """

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
    ) -> ReferenceMotion:
        """Return the motion after a check. The direction is made a unit vector; wheel speeds may be a number or None."""
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
        """Return the names of what is changed: rates, moments of inertia, and speed and friction of wheels if there are any."""
        wheel = ("wheel_speed", "mu_0", "mu_1") if self.vehicle.wheels else ()
        return (*RATES, "theta_xx", "theta_yy", "theta_zz", *wheel)

    def with_change(self, name: str, relative: float) -> ReferenceMotion:
        """Return the motion with one input changed by this part of itself, or a rate by this part of the angular speed."""
        if name in RATES:
            step = relative * np.linalg.norm(self.omega_B)
            return replace(self, omega_B=self.omega_B + step * (np.array(RATES) == name))
        if name == "wheel_speed":
            return replace(self, wheel_speed_rad_s=self.wheel_speed_rad_s * (1 + relative))
        value = nominal_value(self.vehicle, name) * (1 + relative)
        return replace(self, vehicle=with_parameter(self.vehicle, name, value))

    def tracks(self, t_s: np.ndarray, changes: Sequence[tuple[str, float]] = ()) -> np.ndarray:
        """Return the directions to the Sun (1 + m, n, 3) in body axes at t_s (n), of this motion and of `changes` (m) of it.

        A change is a pair of an input's name and its relative change. The first of t_s is zero.
        """
        motions = [self, *(self.with_change(*change) for change in changes)]
        start = Rows(
            np.array([motion.omega_B for motion in motions]),
            np.tile(self.sun_B, (len(motions), 1)),
            np.array([motion.wheel_speed_rad_s for motion in motions]),
            Bodies.stack([motion.vehicle for motion in motions]),
        )
        later = run(self.vehicle, start, t_s[1:], error=TRACK_ERROR)
        if later.outcome.any():
            why = OUTCOME_TEXT[Outcome(int(later.outcome.max()))]
            raise MotionError("a motion could not be followed", got=why)
        return np.concatenate([start.sun_B[:, None], later.sun_B], axis=1)


def growth(motion: ReferenceMotion) -> xr.Dataset:
    """Return how the direction error per relative change of each input grows with the length of the window, by differences.

    Returns
    -------
    xarray.Dataset
        On (input, time): `error_rad`, the largest angle so far between changed and unchanged run, divided by the relative change
        (rad; a change of a rate is relative to the angular speed). On `input`: `power`, the exponent of time in a fit to the last
        nine tenths of the window.
    """
    t = np.arange(0.0, motion.duration_s + STEP_S / 2, STEP_S)
    unchanged, *changed = motion.tracks(t, [(name, SMALL_CHANGE) for name in motion.inputs])
    chord = np.linalg.norm(changed - unchanged, axis=2)
    angle = 2 * np.arcsin(np.minimum(chord / 2, 1.0))  # exact for small angles, unlike arccos
    values = np.maximum.accumulate(angle, axis=1) / SMALL_CHANGE
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


def one_percent(motion: ReferenceMotion, sample_step_s: float) -> xr.Dataset:
    """Return `E` and `emd` on `input` between the motion and itself with that input changed by one percent.

    Each is the larger one for the two signs of the change. E is computed from samples every `sample_step_s`, the EMD from the
    directions that the panels allow to reconstruct (paper, eqs. 12, 13).
    """
    t = np.arange(0.0, motion.duration_s + STEP_S / 2, STEP_S)
    every = max(round(sample_step_s / STEP_S), 1)
    mask = reconstructible_mask(motion.vehicle)
    changes = [(name, sign * ONE_PERCENT) for name in motion.inputs for sign in (1, -1)]
    unchanged, *changed = motion.tracks(t, changes)
    seen = unchanged[mask.contains(unchanged), 2]
    if seen.size == 0:
        raise InputError(
            "none of this motion's directions could be reconstructed", do="choose another motion"
        )
    table = np.zeros((len(motion.inputs), 2))
    for k, track in enumerate(changed):
        z = track[mask.contains(track), 2]
        error = direction_error(track[::every], unchanged[::every])
        of_input = table[k // 2]
        of_input[:] = np.maximum(of_input, (error, emd(z, seen) if z.size else 1.0))
    return xr.Dataset(
        {
            "E": ("input", table[:, 0], {"units": "1"}),
            "emd": ("input", table[:, 1], {"units": "1"}),
        },
        coords={"input": list(motion.inputs)},
        attrs={"relative_change": ONE_PERCENT},
    )


def valleys(
    motion: ReferenceMotion,
    change_rad_s: npt.ArrayLike,
    windows_s: npt.ArrayLike,
    sample_step_s: float,
    workers: int | None = None,
) -> xr.DataArray:
    """Return E over (window, change of omega_x in rad/s) against the motion's own directions, sampled every `sample_step_s`."""
    change, windows = (np.asarray(x, dtype=np.float64) for x in (change_rad_s, windows_s))
    axes = [motion.omega_B[0] + change, motion.omega_B[1:2], motion.omega_B[2:]]
    start = Start.on_grid(motion.vehicle, axes, motion.sun_B, motion.wheel_speed_rad_s)
    E = []
    for window in windows:
        times = np.arange(0.0, window + sample_step_s / 2, sample_step_s)
        rows = ScanRows(motion.vehicle, start, times, "E", motion.tracks(times)[0])
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
    """Return the full width (n_window), rad/s, of the valley around no change at half of the median of E; infinite if open."""
    change, widths = valley["change"].values, []
    for row in valley.values:
        above = row > np.median(row) / 2
        left = change[above & (change < 0)].max(initial=-np.inf)
        right = change[above & (change > 0)].min(initial=np.inf)
        widths.append(right - left)
    return np.array(widths)


def parameter_map(
    motion: ReferenceMotion,
    track: xr.Dataset,
    parameters: Mapping[str, np.ndarray],
    workers: int | None = None,
) -> xr.DataArray:
    """Return E over a grid of parameters (names of `with_parameter`) for a motion's start, against the directions of a track.

    `track`: `sun_B (time, axis)` at `time`, s after the start. Samples without a direction are left out.
    """
    rates = [motion.omega_B[i : i + 1] for i in range(3)]
    start = Start.on_grid(motion.vehicle, rates, motion.sun_B, motion.wheel_speed_rad_s)
    start = replace(start, bodies=bodies_on_grid(motion.vehicle, parameters))
    E = ensemble(track_rows(motion.vehicle, start, track), workers=workers)["E"]
    coords = {name: np.asarray(values, dtype=np.float64) for name, values in parameters.items()}
    shape = [len(values) for values in coords.values()]
    return xr.DataArray(E.reshape(shape), coords, list(coords), name="E", attrs={"units": "1"})


def error_of_start_length(error: Any, length: float) -> Any:
    """Return E for a start direction of this length, from E_1 for a unit vector.

    The directions are linear in the start, so E = (1 - length (1 - 2 E_1)) / 2.
    """
    return (1 - length * (1 - 2 * error)) / 2
