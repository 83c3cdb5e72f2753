"""Twins for `calibrate-sensors`: telemetry of a CubeSat in an orbit drawn at random, its sensors off by known errors, or by none.

The orbit is that of tests/tle_twins.py, which nothing of the package's environment makes. All of it is synthetic.
"""

from __future__ import annotations

from datetime import timedelta
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.linalg import polar
from scipy.spatial.transform import Rotation

from strange_twins import FACES, unit
from sunspin.environment.elements import parse_elements
from sunspin.environment.orbit import drift_sigma_s_day, in_orbit
from sunspin.estimate.calibrate.sensors import calibrate_sensors
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from sunspin.vehicle.sensors import Disturbance, Gyro, Magnetometer, Sensors, SunSensor
from tle_twins import EPOCH, lines, sky

SIDES = [[0, 1, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 0]]
"""The x axis of the Sun sensor on each face."""

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
"""One sigma of the errors of the sensors."""


class Twin(NamedTuple):
    """A vehicle whose file knows nothing of the errors, its telemetry, its elements, what the file's keys should be, how far the
    satellite is ahead of the elements in the middle (s), and what that gains in a day."""

    vehicle: Vehicle
    telemetry: xr.Dataset
    elements: tuple[str, str]
    shift_sigma_s: float
    truth: dict[str, np.ndarray]
    along_track: tuple[float, float] = (0.0, 0.0)


def side_of(face: np.ndarray, k: int) -> np.ndarray:
    x = np.array(SIDES[k], dtype=float)
    x -= (x @ face) * face
    return x / np.linalg.norm(x)


def make(seed: int, i: int, off: float = 1.0, gyro: bool = True) -> Twin:
    """Twin number `i`; `off`: its errors over their usual size, 0 for sensors that are as the file says."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,)))
    given, sigma = lines(rng), float(10 ** rng.uniform(0.5, 1.5))
    ahead, begin = sigma * rng.normal(), rng.uniform(0, 5) * 86400
    starts = np.sort(rng.choice(30, 8, replace=False)) * 5600.0 + rng.uniform(0, 2000, 8)
    passes = [start + np.arange(0, rng.uniform(400, 650), 25.0) for start in starts]
    t = np.concatenate(passes)
    which = np.repeat(np.arange(8), [len(one) for one in passes])
    t = t - t[0]
    drift = drift_sigma_s_day(sigma, begin / 86400) * np.random.default_rng([seed, i]).normal()
    sun, field, lit, _ = sky(given, begin, t, ahead + drift * (t - t.mean()) / 86400)
    spin = np.radians(0.5 + 2.0 * rng.uniform(size=(8, 1))) * np.array(
        [unit(rng) for _ in range(8)]
    )
    start = Rotation.random(8, random_state=int(rng.integers(2**31)))
    body = (
        Rotation.from_rotvec((t - t[np.searchsorted(which, which)])[:, None] * -spin[which])
        * start[which]
    )
    sun_B, field_B = body.apply(sun), body.apply(field)
    rate_B = spin[which]
    errors = {name: off * size for name, size in SIZES.items()}
    matrix, zero = (
        np.eye(3) + errors["matrix"] * rng.normal(size=(3, 3)),
        errors["zero"] * rng.normal(size=3),
    )
    reading = field_B @ matrix.T + zero + FIELD_SIGMA_NT * rng.normal(size=field_B.shape)
    gain = np.exp(errors["gain"] * rng.normal(size=6))
    power = np.maximum(
        gain * np.maximum(sun_B @ FACES.T, 0) * lit[:, None]
        + POWER_SIGMA * rng.normal(size=(len(t), 6)),
        0,
    )
    truth: dict[str, np.ndarray] = {f"panel.p{k}.gain_W": gain[k : k + 1] for k in range(6)}
    angle = np.full((len(t), 6, 2), np.nan)
    sensors = []
    for k, face in enumerate(FACES):
        x = side_of(face, k)
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
    gyro_zero, gyro_scale = (
        errors["gyro_zero"] * rng.normal(size=3),
        1 + errors["gyro_scale"] * rng.normal(),
    )
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
        panels=[Panel(f"p{j}", face, 1.0) for j, face in enumerate(FACES)],
        telemetry=TelemetryForm(noise=POWER_SIGMA),
        sensors=suite,
    )
    variables = {
        "power_W": (("time", "panel"), power),
        "flag": ("time", np.zeros(len(t), dtype=np.uint8)),
        "field_B": (("time", "axis"), reading),
        "gyro_B": (("time", "axis"), rates),
        "sun_sensor_angle": (("time", "sun_sensor", "side"), angle),
        "sun_sensor_y_turned": (("time", "sun_sensor"), np.zeros((len(t), 6), dtype=np.int8)),
    }
    attrs = {
        "epoch_utc": (EPOCH + timedelta(seconds=begin)).isoformat() + "Z",
        "synthetic": 1,
        "file": "twin.csv",
    }
    data = xr.Dataset(variables, {"time": t, "panel": list(vehicle.panel_names)}, attrs)
    return Twin(
        vehicle, data if gyro else data.drop_vars("gyro_B"), given, sigma, truth, (ahead, drift)
    )


def deviations(twin: Twin, found: xr.Dataset) -> dict[str, list[float]]:
    """By key, how far each number that was written is off, in its sigmas."""
    off: dict[str, list[float]] = {}
    for name in dict.fromkeys(found["key"].values.tolist()):
        part = found.isel(quantity=np.flatnonzero(found["key"].values == name))
        value = part["value"].values
        if part["written"].values.all() and name in twin.truth:
            symmetric = name == "magnetometer.matrix" and np.allclose(
                value[[1, 2, 5]], value[[3, 6, 7]], rtol=1e-9, atol=0
            )
            truth = twin.truth["stretch" if symmetric else name]
            off[name] = ((value - truth) / part["sigma"].values).tolist()
    return off


def judge(seed: int, i: int) -> dict[str, Any]:
    """Deviations from the truth: of sensors that are off in twins with even numbers, of sensors that are not in the others."""
    what, off = ("off", 1.0) if i % 2 == 0 else ("clean", 0.0)
    twin = make(seed, i, off)
    data = twin.telemetry
    elements = parse_elements("\n".join(twin.elements), "twin")
    orbit = in_orbit(
        elements, data.attrs["epoch_utc"], data["time"].values, shift_sigma_s=twin.shift_sigma_s
    )
    found = calibrate_sensors(twin.vehicle, data, orbit)
    along_track = {
        f"orbit.{name}": [
            (found.attrs[name] - true) / found.attrs[name.replace("_s", "_sigma_s", 1)]
        ]
        for name, true in zip(("shift_s", "drift_s_day"), twin.along_track, strict=True)
    }
    return {what: deviations(twin, found) | along_track}
