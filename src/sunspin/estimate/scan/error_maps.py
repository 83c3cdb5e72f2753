"""Maps of E over initial rates, and over parameters of any vehicle (paper, section 2.3, Fig. 8)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.compute.rows import ensemble
from sunspin.dynamics import ensemble as k
from sunspin.estimate.scan.metrics import direction_error
from sunspin.estimate.scan.rows import TRACK_DIRECTION_ERROR, Start, TrackRows
from sunspin.vehicle import Vehicle

INERTIA = {
    "theta_xx": (0, 0),
    "theta_yy": (1, 1),
    "theta_zz": (2, 2),
    "theta_xy": (0, 1),
    "theta_xz": (0, 2),
    "theta_yz": (1, 2),
}
"""Names of the elements of the inertia tensor that can be varied (kg m2)."""

WHEEL_PARAMETERS = ("mu_0", "mu_1", "J")
"""Names of the parameters of every wheel that can be varied: friction (N m, N m s) and axial inertia (kg m2)."""


def varied(vehicle: Vehicle, name: str, value: float) -> Vehicle:
    """A copy of the vehicle with one parameter replaced.

    Parameters
    ----------
    name : "theta_xx", "theta_xy", ..., "mu_0", "mu_1" or "J"
        Element of the inertia tensor (kg m2, its mirror with it), or friction (N m; N m s) or axial inertia of all wheels.
    """
    if name in INERTIA:
        tensor = np.array(vehicle.require_inertia())
        i, j = INERTIA[name]
        tensor[i, j] = tensor[j, i] = value
        return replace(vehicle, inertia_kg_m2=tensor)
    if name not in WHEEL_PARAMETERS:
        known = ", ".join([*INERTIA, *WHEEL_PARAMETERS])
        raise InputError("there is no parameter of this name", got=name, do=f"known: {known}")
    if not vehicle.wheels:
        raise InputError(
            f"{name} belongs to a wheel, and {vehicle.name!r} has none",
            do="vary its inertia instead",
        )
    wheels = []
    for wheel in vehicle.wheels:
        if name == "J":
            wheels.append(replace(wheel, inertia_kg_m2=value))
        else:
            key = {"mu_0": "coulomb_N_m", "mu_1": "viscous_N_m_s"}[name]
            wheels.append(replace(wheel, friction=replace(wheel.friction, **{key: value})))
    return replace(vehicle, wheels=tuple(wheels))


def nominal(vehicle: Vehicle, name: str) -> float:
    """The vehicle's own value of a parameter that `varied` can replace (of the first wheel, where it is a wheel's)."""
    if name in INERTIA:
        return float(vehicle.require_inertia()[INERTIA[name]])
    if not vehicle.wheels:
        raise InputError(
            f"{name} belongs to a wheel, and {vehicle.name!r} has none",
            do="vary its inertia instead",
        )
    wheel = vehicle.wheels[0]
    values = {
        "mu_0": wheel.friction.coulomb_N_m,
        "mu_1": wheel.friction.viscous_N_m_s,
        "J": wheel.inertia_kg_m2,
    }
    return float(values[name])


@dataclass(frozen=True)
class ParameterRows:
    """Row -> E of one start with two parameters of the vehicle replaced; rows in C order of the grid of their values.

    `measured` (n, 3) are directions at `times` (n, s after the start).
    """

    vehicle: Vehicle
    names: tuple[str, str]
    values: tuple[np.ndarray, np.ndarray]
    start: Start
    measured: np.ndarray
    times: np.ndarray

    outputs = {"E": ("float64", ()), "outcome": ("int8", ())}

    @property
    def n_rows(self) -> int:
        return len(self.values[0]) * len(self.values[1])

    def __call__(self, index: np.ndarray) -> dict[str, np.ndarray]:
        bodies = self.bodies(*np.unravel_index(index, self.shape))
        rows = replace(self.start.take(np.zeros(len(index), dtype=np.int64)), bodies=bodies)
        run = k.run_rows(self.vehicle, rows, self.times, direction_error=TRACK_DIRECTION_ERROR)
        error = np.array([direction_error(sun, self.measured) for sun in run.sun_B])
        return {"E": error, "outcome": run.outcome.astype(np.int8)}

    @property
    def shape(self) -> tuple[int, int]:
        return len(self.values[0]), len(self.values[1])

    def bodies(self, i: np.ndarray, j: np.ndarray) -> k.Bodies:
        """The vehicles at points (n) of the grid. A vehicle is checked when it is made: for each point where two values must suit
        each other, else, of friction and an inertia, for each value."""
        (one, other), (first, second) = self.names, self.values
        if (one in INERTIA) == (other in INERTIA) or "J" in self.names:
            at = zip(first[i], second[j], strict=True)
            return k.Bodies.stack(
                [varied(varied(self.vehicle, one, float(a)), other, float(b)) for a, b in at]
            )
        along = [
            k.Bodies.stack([varied(self.vehicle, name, float(value)) for value in axis])
            for name, axis in zip(self.names, self.values, strict=True)
        ]
        of_wheels, of_body = (
            (along[1].take(j), along[0].take(i))
            if one in INERTIA
            else (along[0].take(i), along[1].take(j))
        )
        return replace(of_wheels, inertia_kg_m2=of_body.inertia_kg_m2)


def rate_map(
    vehicle: Vehicle,
    track: xr.Dataset,
    sun_B: Any,
    axes: list[np.ndarray],
    wheel_speed_rad_s: Any,
    workers: int | None = None,
) -> xr.DataArray:
    """E over a grid of initial rates (omega_x, omega_y, omega_z in rad/s) against the measured directions of a track."""
    measured, times = _known(track)
    start = Start.on_grid(
        vehicle, [np.asarray(axis, dtype=np.float64) for axis in axes], sun_B, wheel_speed_rad_s
    )
    out = ensemble(TrackRows(vehicle, start, measured, times), workers=workers, chunk=1024)
    dims = ("omega_x", "omega_y", "omega_z")
    coords = {dim: (dim, axis, {"units": "rad s-1"}) for dim, axis in zip(dims, axes, strict=True)}
    return xr.DataArray(
        out["E"].reshape(start.shape), dims=dims, coords=coords, name="E", attrs={"units": "1"}
    )


def parameter_map(
    vehicle: Vehicle,
    track: xr.Dataset,
    sun_B: Any,
    omega_B: Any,
    wheel_speed_rad_s: Any,
    parameters: Mapping[str, np.ndarray],
    workers: int | None = None,
) -> xr.DataArray:
    """E over a grid of two of the vehicle's parameters (names of `varied`), from one initial rate omega_B (3) in rad/s."""
    if len(parameters) != 2:
        raise InputError("a map needs exactly two parameters", got=", ".join(parameters))
    measured, times = _known(track)
    start = Start.on_grid(
        vehicle, [np.array([float(rate)]) for rate in omega_B], sun_B, wheel_speed_rad_s
    )
    (one, first), (other, second) = (
        (name, np.asarray(axis, dtype=np.float64)) for name, axis in parameters.items()
    )
    for name, axis in ((one, first), (other, second)):
        varied(
            vehicle, name, float(axis[0])
        )  # a name or value that will not do is refused before the work
    rows = ParameterRows(vehicle, (one, other), (first, second), start, measured, times)
    out = ensemble(rows, workers=workers, chunk=1024)
    return xr.DataArray(
        out["E"].reshape(rows.shape),
        dims=(one, other),
        coords={one: first, other: second},
        name="E",
        attrs={"units": "1"},
    )


def _known(track: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    n = np.asarray(track["sun_B"], dtype=np.float64)
    known = np.all(np.isfinite(n), axis=1)
    if not known.any():
        raise InputError("the track holds no direction to compare with")
    return n[known], np.asarray(track["time"], dtype=np.float64)[known]


def of_length(error: Any, length: float) -> Any:
    """E for a start direction of another length than one: the motion is linear in it, so E = (1 - length (1 - 2 E_1)) / 2."""
    return (1 - length * (1 - 2 * error)) / 2
