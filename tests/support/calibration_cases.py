"""Simulated cases for `calibrate-sensors`: a CubeSat in orbit, its sensors off by known errors, or by none.

The orbit is that of `tests/support/orbits.py`, not the package's. All of it is synthetic.
"""

from __future__ import annotations

from datetime import timedelta
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.linalg import polar
from scipy.spatial.transform import Rotation

from sunspin import calibrate_sensors
from sunspin.environment.elements import parse_elements
from sunspin.environment.orbit import Orbit, drift_sigma_s_day, in_orbit
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from sunspin.vehicle.sensors import Disturbance, Gyro, Magnetometer, Sensors, SunSensor
from tests.support.orbits import EPOCH, sky, two_line_elements
from tests.support.simulate import telemetry_of
from tests.support.vehicles import CUBE_NORMALS, unit_vector

SENSOR_X_AXES = [[0, 1, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 0]]
"""The x axis of the Sun sensor on each face, before it is made perpendicular to the face's normal."""

VIEW = np.radians(60)
SUN_SIGMA, FIELD_SIGMA_NT, GYRO_SIGMA, POWER_SIGMA = 0.03, 300.0, 5e-4, 0.01
SIZES = {
    "zero": 5000.0,
    "matrix": 0.05,
    "bias": 0.04,
    "scale": 0.05,
    "gain": 0.05,
    "gyro_zero": 0.01,
    "gyro_scale": 0.05,
}
"""One sigma of each sensor error."""


class CalibrationCase(NamedTuple):
    """What is given and what is true.

    `vehicle`: as its file states it, without the errors; `truth`: by key of the file, what it should be; `along_track`: how far
    the satellite is ahead of its elements at mid-file (s), and the drift of that (s/day).
    """

    vehicle: Vehicle
    telemetry: xr.Dataset
    elements: tuple[str, str]
    shift_sigma_s: float
    truth: dict[str, np.ndarray]
    along_track: tuple[float, float] = (0.0, 0.0)


def sensor_x_axis(face: np.ndarray, k: int) -> np.ndarray:
    """Return the x axis of the Sun sensor on face `k`, perpendicular to its normal."""
    x = np.array(SENSOR_X_AXES[k], dtype=float)
    x -= (x @ face) * face
    return x / np.linalg.norm(x)


def calibration_case(seed: int, i: int, off: float = 1.0, gyro: bool = True) -> CalibrationCase:
    """Draw case `i` of a seed; `off`: its errors relative to their usual size, 0 for sensors that are as the file states."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,)))
    elements, sigma = two_line_elements(rng), float(10 ** rng.uniform(0.5, 1.5))
    ahead, begin = sigma * rng.normal(), rng.uniform(0, 5) * 86400
    starts = np.sort(rng.choice(30, 8, replace=False)) * 5600.0 + rng.uniform(0, 2000, 8)
    passes = [start + np.arange(0, rng.uniform(400, 650), 25.0) for start in starts]
    t = np.concatenate(passes)
    which = np.repeat(np.arange(8), [len(one) for one in passes])
    t = t - t[0]
    drift = drift_sigma_s_day(sigma, begin / 86400) * np.random.default_rng([seed, i]).normal()
    sun, field, lit, _ = sky(elements, begin, t, ahead + drift * (t - t.mean()) / 86400)
    spin = np.radians(0.5 + 2.0 * rng.uniform(size=(8, 1))) * np.array(
        [unit_vector(rng) for _ in range(8)]
    )
    start = Rotation.random(8, random_state=int(rng.integers(2**31)))
    body = (
        Rotation.from_rotvec((t - t[np.searchsorted(which, which)])[:, None] * -spin[which])
        * start[which]
    )
    sun_B, field_B = body.apply(sun), body.apply(field)
    rate_B = spin[which]
    errors = {name: off * size for name, size in SIZES.items()}
    matrix = np.eye(3) + errors["matrix"] * rng.normal(size=(3, 3))
    zero = errors["zero"] * rng.normal(size=3)
    reading = field_B @ matrix.T + zero + FIELD_SIGMA_NT * rng.normal(size=field_B.shape)
    gain = np.exp(errors["gain"] * rng.normal(size=6))
    power = np.maximum(
        gain * np.maximum(sun_B @ CUBE_NORMALS.T, 0) * lit[:, None]
        + POWER_SIGMA * rng.normal(size=(len(t), 6)),
        0,
    )
    truth: dict[str, np.ndarray] = {f"panel.p{k}.gain_W": gain[k : k + 1] for k in range(6)}
    angle = np.full((len(t), 6, 2), np.nan)
    sensors = []
    for k, face in enumerate(CUBE_NORMALS):
        x = sensor_x_axis(face, k)
        y = np.cross(face, x)
        sees = (sun_B @ face > np.cos(VIEW)) & (lit > 0.5)
        for side, axis in enumerate((x, y)):
            bias, scale = errors["bias"] * rng.normal(), 1 + errors["scale"] * rng.normal()
            true = np.arctan2(sun_B @ axis, sun_B @ face)
            angle[sees, k, side] = (scale * true + bias + SUN_SIGMA * rng.normal(size=len(t)))[sees]
            truth[f"sun_sensor.s{k}.{'xy'[side]}_bias_rad"] = np.array([bias / scale])
            truth[f"sun_sensor.s{k}.{'xy'[side]}_scale"] = np.array([1 / scale])
        sensors.append(
            SunSensor(f"s{k}", face, x, f"x{k}", f"y{k}", None, 0.0, 1.0, 1.0, SUN_SIGMA, SUN_SIGMA)
        )
    true_matrix, scale = np.linalg.inv(matrix), np.cbrt(np.linalg.det(np.linalg.inv(matrix)))
    truth |= {
        "magnetometer.zero": zero,
        "magnetometer.matrix": (true_matrix / scale).ravel(),
        "stretch": (polar(true_matrix)[1] / scale).ravel(),
        "magnetometer.scale_T": np.array([1e-9 * scale]),
    }
    gyro_zero = errors["gyro_zero"] * rng.normal(size=3)
    gyro_scale = 1 + errors["gyro_scale"] * rng.normal()
    rates = gyro_scale * rate_B + gyro_zero + GYRO_SIGMA * rng.normal(size=(len(t), 3))
    truth |= {"gyro.zero": gyro_zero, "gyro.scale_rad_s": np.array([1 / gyro_scale])}
    suite = Sensors(
        tuple(sensors),
        gyro=Gyro(("a", "b", "c"), 1.0, np.zeros(3), GYRO_SIGMA),
        magnetometer=Magnetometer(("x", "y", "z"), np.zeros(3), FIELD_SIGMA_NT),
        disturbance=Disturbance(acceleration_noise=1e-5, max_rate_rad_s=0.06),
    )
    vehicle = Vehicle(
        "twin",
        gain_unit="W",
        panels=[Panel(f"p{j}", face, 1.0) for j, face in enumerate(CUBE_NORMALS)],
        telemetry=TelemetryForm(noise=POWER_SIGMA),
        sensors=suite,
    )
    data = telemetry_of(
        vehicle,
        t,
        power,
        field_B=(("time", "axis"), reading),
        gyro_B=(("time", "axis"), rates),
        sun_sensor_angle=(("time", "sun_sensor", "side"), angle),
        sun_sensor_y_turned=(("time", "sun_sensor"), np.zeros((len(t), 6), dtype=np.int8)),
    )
    start = (EPOCH + timedelta(seconds=begin)).isoformat() + "Z"
    data = data.assign_attrs(epoch_utc=start, file="twin.csv")
    return CalibrationCase(
        vehicle, data if gyro else data.drop_vars("gyro_B"), elements, sigma, truth, (ahead, drift)
    )


def deviations(case: CalibrationCase, result: xr.Dataset) -> dict[str, list[float]]:
    """Return by key how far each number that was written is off, in its sigmas."""
    off: dict[str, list[float]] = {}
    for name in dict.fromkeys(result["key"].values.tolist()):
        part = result.isel(quantity=np.flatnonzero(result["key"].values == name))
        value = part["value"].values
        if part["written"].values.all() and name in case.truth:
            symmetric = name == "magnetometer.matrix" and np.allclose(
                value[[1, 2, 5]], value[[3, 6, 7]], rtol=1e-9, atol=0
            )
            truth = case.truth["stretch" if symmetric else name]
            off[name] = ((value - truth) / part["sigma"].values).tolist()
    return off


def orbit_of_case(case: CalibrationCase, data: xr.Dataset) -> Orbit:
    """Return the orbit of a case's elements at the times of telemetry."""
    elements, t_s = parse_elements("\n".join(case.elements), "twin"), data["time"].values
    return in_orbit(elements, data.attrs["epoch_utc"], t_s, shift_sigma_s=case.shift_sigma_s)


def judge_calibration(seed: int, i: int) -> dict[str, Any]:
    """Return the errors of case `i`, in sigmas: its sensors are off if `i` is even, else as the file states."""
    what, off = ("off", 1.0) if i % 2 == 0 else ("clean", 0.0)
    case = calibration_case(seed, i, off)
    result = calibrate_sensors(case.vehicle, case.telemetry, orbit_of_case(case, case.telemetry))
    along_track = {
        f"orbit.{name}": [
            (result.attrs[name] - true) / result.attrs[name.replace("_s", "_sigma_s", 1)]
        ]
        for name, true in zip(("shift_s", "drift_s_day"), case.along_track, strict=True)
    }
    return {what: deviations(case, result) | along_track}
