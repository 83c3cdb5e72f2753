"""Simulated passes of a cube or a long body: faults of known kinds, a late sensor, fast rotation. All of it is synthetic.

Motion and light are those of the package (`ss.propagate`, `ss.panel_power`). Each function returns the telemetry and the true
motion at its samples.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from sunspin.vehicle.sensors import Attitude, Clock, Gyro, Magnetometer, Sensors
from tests.support.vehicles import CUBE_NORMALS, unit_vector

NAMES = "+x", "+y", "+z", "-x", "-y", "-z"
PANELS = [Panel(name, n, 1.0) for name, n in zip(NAMES, CUBE_NORMALS, strict=True)]
FORM = TelemetryForm(noise=0.01)
CUBE = Vehicle("cube", np.diag([0.042, 0.05, 0.03]), gain_unit="W", panels=PANELS, telemetry=FORM)
CUBE_WITHOUT_NOISE_STATED = Vehicle(
    "cube", np.diag([0.04, 0.05, 0.03]), gain_unit="W", panels=PANELS
)
SIDES = tuple(panel for panel in CUBE.panels if not panel.normal_B[2])
FOUR_SIDES = replace(CUBE, name="four", panels=SIDES)
"""The cube with panels on four sides only: their common brightness gives the size of r_z, not its sign."""

LONG_BODY = Vehicle("fast", inertia_kg_m2=np.diag([0.042, 0.041, 0.008]), telemetry=FORM)
SAMPLES = 40
DIRECTION_SIGMA = 0.02
"""Error of a Sun direction of the long body, rad."""


def telemetry_of(vehicle: Vehicle, t_s: np.ndarray, power: np.ndarray, **more: Any) -> xr.Dataset:
    """Return telemetry in the form of `ss.read_telemetry`: powers or currents (n, P) at times (n), and `more` variables."""
    name = "current_A" if vehicle.telemetry.quantity == "current_A" else "power_W"
    flag = "time", np.zeros(len(t_s), dtype=np.uint8)
    variables = {name: (("time", "panel"), power), "flag": flag, **more}
    attrs = {"epoch_utc": "2026-01-01T00:00:00Z", "synthetic": 1}
    return xr.Dataset(variables, {"time": t_s, "panel": list(vehicle.panel_names)}, attrs)


def uneven_times(
    rng: np.random.Generator, samples: int, interval_s: float, spread: float
) -> np.ndarray:
    """Return times (n) from zero whose intervals are `interval_s`, more or less by the share `spread`."""
    steps = rng.uniform(1 - spread, 1 + spread, samples - 1)
    return np.concatenate([[0.0], np.cumsum(interval_s * steps)])


def simulated_pass(
    vehicle: Vehicle,
    omega_B: np.ndarray,
    t_s: np.ndarray,
    rng: np.random.Generator,
    noise: float = 0.01,
    albedo: float = 0.05,
    speed: list[float] | None = None,
) -> tuple[xr.Dataset, xr.Dataset]:
    """Return telemetry and truth of a given rate (rad/s); each reading has noise and up to `albedo` of stray light."""
    run = ss.propagate(vehicle, omega_B, unit_vector(rng), speed, t_s, wheel_mode="hold")
    power = ss.panel_power(vehicle, run["sun_B"].values)
    power = power + noise * rng.normal(size=power.shape) + albedo * rng.uniform(size=power.shape)
    return telemetry_of(vehicle, t_s, np.maximum(power, 0)), run


# ------------------------------------------------------------------------------------------------------------------------- faults

Fault = Callable[..., np.ndarray]


def albedo(
    power: np.ndarray, rng: np.random.Generator, attitude: Rotation, normals: np.ndarray
) -> np.ndarray:
    """Add the Earth's light: from one inertial direction, up to a tenth of full Sun on panels that face it, lit or not."""
    earth, share = unit_vector(rng), rng.uniform(0.02, 0.1)
    return power + share * np.maximum(attitude.apply(earth) @ normals.T, 0)


def power_limited(power: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Lower all readings of some samples by one factor, as a full battery does."""
    limited = rng.uniform(size=len(power)) < 0.15
    return np.where(limited[:, None], power * rng.uniform(0.1, 0.75, (len(power), 1)), power)


def dead_string(power: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Lower the readings of one panel to 80 %, as a dead string of cells does."""
    return power * np.where(np.arange(power.shape[1]) == rng.integers(power.shape[1]), 0.8, 1.0)


def quantised(power: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Round readings to steps of 4 % of full Sun."""
    return np.round(power / 0.04) * 0.04


FAULTS_OF_FOUR_SIDES = (dead_string, albedo, power_limited, quantised)
"""The faults of the simulated files of `FOUR_SIDES`."""


def cube_with_faults(
    faults: tuple[Fault, ...], rng: np.random.Generator, vehicle: Vehicle = CUBE
) -> tuple[xr.Dataset, xr.Dataset]:
    """Return telemetry and truth of a cube at up to about 3 deg/s, 40 samples about 10 s apart, with these faults."""
    t = uneven_times(rng, SAMPLES, 10.0, 0.2)
    sun = unit_vector(rng)
    run = ss.propagate(vehicle, 0.025 * rng.normal(size=3), sun, None, t)
    power = ss.panel_power(vehicle, run["sun_B"].values)
    attitude = Rotation.from_quat(run["B_from_N"].values)
    for fault in faults:
        power = fault(power, rng, *((attitude, vehicle.panel_normals_B) if fault is albedo else ()))
    noise = 0.01 * rng.normal(size=power.shape) if quantised not in faults else 0.0
    return telemetry_of(vehicle, t, np.maximum(power + noise, 0.0)), run


# -------------------------------------------------------------------------------------------------------------------- late sensor

GYRO = Gyro(("x", "y", "z"), 1.0, np.zeros(3), 5e-4, zero_sigma=np.full(3, 1e-3), scale_sigma=0.01)
MAGNETOMETER = Magnetometer(("x", "y", "z"), np.zeros(3), 0.02)
QUATERNION = Attitude(("a", "b", "c", "d"), "last", "N_to_B", 0.01)


def cube_with_sensor(kind: str, clock: Clock | None) -> Vehicle:
    """Return the cube with a "gyro", a magnetometer ("field") or a quaternion ("attitude"); `clock` states its time offset."""
    sensors = {"gyro": ("gyro", GYRO), "field": ("magnetometer", MAGNETOMETER)}
    name, sensor = sensors.get(kind, ("attitude", QUATERNION))
    return replace(CUBE, sensors=replace(Sensors(clock=clock), **{name: sensor}))


def cube_with_late_sensor(
    kind: str, late_s: float, rng: np.random.Generator, samples: int = 40
) -> tuple[xr.Dataset, xr.Dataset]:
    """Return telemetry and truth of a cube at about 3 deg/s, 10 s sampling, whose sensor of this kind is `late_s` behind."""
    t = 60 + uneven_times(rng, samples, 10.0, 0.2)
    sun, every_time = unit_vector(rng), np.unique(np.concatenate([[0.0], t, t - late_s]))
    run = ss.propagate(CUBE, 0.03 * rng.normal(size=3), sun, None, every_time)
    at_row, at_sensor = run.sel(time=t), run.sel(time=t - late_s, method="nearest")
    power = ss.panel_power(CUBE, at_row["sun_B"].values) + 0.01 * rng.normal(size=(samples, 6))
    attitude = Rotation.from_quat(at_sensor["B_from_N"].values)
    scale, zero = 1 + 0.01 * rng.normal(), 1e-3 * rng.normal(size=3)
    # all three are drawn, in this order, so that a seed gives the same motion and noise for each kind
    gyro = at_sensor["omega_B"].values * scale + zero + 5e-4 * rng.normal(size=(samples, 3))
    field = attitude.apply([0.6, 0.0, 0.8]) + 0.02 * rng.normal(size=(samples, 3))
    quaternion = Rotation.from_rotvec(0.01 * rng.normal(size=(samples, 3))) * attitude
    readings = {
        "gyro": {"gyro_B": (("time", "axis"), gyro)},
        "field": {"field_B": (("time", "axis"), field)},
        "attitude": {"attitude_B_from_N": (("time", "quaternion"), quaternion.as_quat())},
    }
    return telemetry_of(CUBE, t, np.maximum(power, 0.0), **readings[kind]), at_row


# ------------------------------------------------------------------------------------------------------------------ fast rotation


def fast_body(
    interval_s: float, rng: np.random.Generator, samples: int = 40
) -> tuple[Vehicle, xr.Dataset, xr.Dataset]:
    """Return vehicle, telemetry (Sun directions) and truth of a long body at 5 to 30 deg/s, samples about `interval_s` apart.

    Up to one revolution hides between two samples, and the vehicle states no largest rate.
    """
    axis, sun = rng.normal(size=3), unit_vector(rng)
    t = uneven_times(rng, samples, interval_s, 0.2)
    omega = np.radians(rng.uniform(5, 30)) * axis / np.linalg.norm(axis)
    run = ss.propagate(LONG_BODY, omega, sun, None, t)
    directions = run["sun_B"].values + DIRECTION_SIGMA * rng.normal(size=(samples, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    covariance = np.tile(DIRECTION_SIGMA**2 * np.eye(3), (samples, 1, 1))
    sun = {"sun_B": (("time", "axis"), directions)}
    sun["sun_cov_B"] = ("time", "axis", "axis2"), covariance
    data = telemetry_of(LONG_BODY, t, np.zeros((samples, 0)), **sun)
    return LONG_BODY, data.drop_vars(("power_W", "panel")), run


def pulls(result: xr.Dataset, run: xr.Dataset) -> np.ndarray:
    """Return the errors (n, 3) of the best solution's rates in their own sigmas."""
    off = result["omega_B"].values - run["omega_B"].sel(time=result["time"]).values
    return off / np.sqrt(np.einsum("nii->ni", result["omega_cov_B"].values))


def has_true_mean_rate(result: xr.Dataset, run: xr.Dataset) -> np.ndarray:
    """Return for each solution of the first pass whether its mean rate is the true one, within five sigma or 0.1 deg/s."""
    at = result["time"].values[result["pass_of"].values == 0]
    truth = run["omega_B"].sel(time=at).values.mean(axis=0)
    miss = np.abs(result["omega_mean_B"].values[0] - truth)
    return (miss < np.maximum(5 * result["omega_sigma_B"].values[0], np.radians(0.1))).all(axis=1)
