"""Sun sensors, gyro and magnetometer of a telemetry file, as directions, rates and fields in body axes with their errors."""

from __future__ import annotations

from typing import Any

import numpy as np

from sunspin.base.tables import Table
from sunspin.vehicle import Vehicle
from sunspin.vehicle.sensors import VARIABLES, SunSensor, SunVector

RADIAL_SIGMA = 0.02
"""Sigma along the direction itself: a chord is shorter than its arc, and the covariance must have full rank."""

ABSURD = 1e12
"""A cell beyond this is no reading in any unit."""

AGREE = 0.5
"""Sensors that see different Suns cancel: a mean direction shorter than this is none."""

SHORTEST = 0.5
"""A Sun vector shorter than this part of the longest is none: some computers write zeros in the dark, others what is left of it."""

NEIGHBOUR_RAD = 0.73
"""Where a sensor's neighbour is lit too and the angle towards it is not read, the Sun stands about 42 degrees off."""

NEIGHBOUR_SIGMA_RAD = 0.2

BOTH_SIGMAS = 2.0
"""Within so many sigmas of the light at which a sensor's y turns, it may be read either way."""

STEEPEST_RAD = 1.4
"""No Sun sensor reads an angle from its normal beyond this."""


def sensor_columns(vehicle: Vehicle) -> list[str]:
    """Columns that the vehicle's sensors read."""
    sensors = vehicle.sensors
    names = [
        name
        for s in sensors.sun_sensors
        for name in (s.x_column, s.y_column, s.light_column)
        if name
    ]
    names += [name for part in sensors.with_columns.values() for name in part.names]
    return names + [wheel.speed_column for wheel in vehicle.wheels if wheel.speed_column]


def read_sensors(vehicle: Vehicle, table: Table) -> dict[str, Any]:
    """Variables for a Dataset over `time` from the sensor columns that the table has (missing ones are left out).

    `sun_sensor_B` (time, axis) unit, body axes, with `sun_sensor_cov_B` (time, axis, axis2): NaN where no sensor sees the Sun;
    `sun_sensor_other_B`, `sun_sensor_other_cov_B`: the same read the other way where a sensor's y may be turned or not, else NaN;
    `sun_sensor_angle` (time, sun_sensor, side) rad, the angles of each from its normal, NaN where it sees no Sun or reads none;
    `sun_sensor_y_turned` (time, sun_sensor), where its y runs the other way; `gyro_B` (time, axis) rad/s; `field_B` (time, axis) in
    the column's unit, zero taken off, times the matrix;
    `attitude_B_from_N` (time, quaternion); `wheel_speed_rad_s` (time, wheel).
    Cells without a number are NaN.
    """
    found: dict[str, Any] = {}
    sensors = vehicle.sensors
    present = [
        s
        for s in sensors.sun_sensors
        if all(n in table.header for n in (s.x_column, s.y_column, s.light_column) if n)
    ]
    vector = sensors.sun_vector
    vector = (
        vector
        if vector is not None and all(name in table.header for name in vector.names)
        else None
    )
    if present or vector is not None:
        sun, covariance, angle = _sun(present, vector, table, sensors.sun_sensors)
        if present:
            about = {
                "units": "rad",
                "long_name": "angles of each Sun sensor from its normal, along its x and its y",
            }
            found["sun_sensor_angle"] = (("time", "sun_sensor", "side"), angle, about)
            turned = np.stack([_turned(sensor, table) for sensor in sensors.sun_sensors], axis=1)
            found["sun_sensor_y_turned"] = (
                ("time", "sun_sensor"),
                turned.astype(np.int8),
                {"units": "1"},
            )
        found["sun_sensor_B"] = (
            ("time", "axis"),
            sun,
            {"units": "1", "long_name": "Sun by the Sun sensors, body axes"},
        )
        found["sun_sensor_cov_B"] = (("time", "axis", "axis2"), covariance, {"units": "1"})
        if (unsure := np.any([_unsure(sensor, table) for sensor in present], axis=0)).any():
            sun, covariance, _ = _sun(present, vector, table, sensors.sun_sensors, other=True)
            sun[~unsure], covariance[~unsure] = np.nan, np.nan
            about = {
                "units": "1",
                "long_name": "Sun by the Sun sensors, if their y runs the other way",
            }
            found["sun_sensor_other_B"] = (("time", "axis"), sun, about)
            found["sun_sensor_other_cov_B"] = (
                ("time", "axis", "axis2"),
                covariance,
                {"units": "1"},
            )
    for name, variable in VARIABLES.items():
        sensor = sensors.with_columns.get(name)
        if sensor is not None and all(column in table.header for column in sensor.names):
            along, value, about = sensor.seen(_numbers(table, sensor.names))
            found[variable] = (("time", along), value, about)
    speeds = [wheel.speed_column for wheel in vehicle.wheels]
    if speeds and all(name in table.header for name in speeds if name) and any(speeds):
        nothing = np.full(len(table.cells), np.nan)
        value = [
            nothing
            if w.speed_column is None
            else w.speed_scale_rad_s * _numbers(table, [w.speed_column])[:, 0]
            for w in vehicle.wheels
        ]
        found["wheel_speed_rad_s"] = (
            ("time", "wheel"),
            np.stack(value, axis=1),
            {"units": "rad s-1"},
        )
    return found


def _numbers(table: Table, names: Any) -> np.ndarray:
    values = table.numbers(names)
    return np.where(np.abs(values) < ABSURD, values, np.nan)


def _sun(
    sensors: list[SunSensor],
    vector: SunVector | None,
    table: Table,
    every: tuple[SunSensor, ...],
    other: bool = False,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The Sun from all sensors that see it, each weighted by its information about each axis, and the angles (n, every, 2);
    `other`: where a y may be turned or not, read the less likely way."""
    n = len(table.cells)
    angles = np.full((n, len(every), 2), np.nan)
    light = np.array([_light(sensor, table) for sensor in sensors]).reshape(len(sensors), n).T
    lit = light > [sensor.lit_above for sensor in sensors]
    information, weighted, seen = np.zeros((n, 3, 3)), np.zeros((n, 3)), []
    for k, sensor in enumerate(sensors):
        x, y = _angles(sensor, table, other)
        angles[lit[:, k], every.index(sensor)] = np.column_stack([x, y])[lit[:, k]]
        seen.append((*_one_sensor(sensor, sensors, lit, x, y), lit[:, k]))
    for direction, part, sees in [*seen, *([] if vector is None else [_vector(vector, table)])]:
        use = sees & np.isfinite(direction).all(axis=1)
        information[use] += part[use]
        weighted[use] += np.einsum("nij,nj->ni", part[use], direction[use])
    seen = np.trace(information, axis1=1, axis2=2) > 0
    covariance, sun = np.full((n, 3, 3), np.nan), np.full((n, 3), np.nan)
    covariance[seen] = np.linalg.inv(information[seen])
    sun[seen] = np.einsum("nij,nj->ni", covariance[seen], weighted[seen])
    size = np.linalg.norm(sun, axis=1)
    agree = seen & (size > AGREE)
    sun[agree] /= size[agree, None]
    sun[~agree], covariance[~agree] = np.nan, np.nan
    return sun, covariance, angles


def _vector(form: SunVector, table: Table) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Directions (n, 3) with their information (n, 3, 3), and where the Sun was seen (n)."""
    value = form.sign * _numbers(table, form.names)
    size = np.linalg.norm(value, axis=1)
    longest = float(np.nanmax(size, initial=0.0))
    sees = size > max(SHORTEST * longest, 1 / ABSURD)
    direction = value / np.where(sees, size, 1.0)[:, None]
    along = direction[:, :, None] * direction[:, None, :]
    return direction, along / RADIAL_SIGMA**2 + (np.eye(3) - along) / form.sigma_rad**2, sees


def _light(sensor: SunSensor, table: Table) -> np.ndarray:
    if sensor.light_column is None:
        return np.full(len(table.cells), np.inf)
    return np.nan_to_num(_numbers(table, [sensor.light_column])[:, 0], nan=-np.inf)


def _angles(sensor: SunSensor, table: Table, other: bool) -> tuple[np.ndarray, np.ndarray]:
    """The Sun's angles (n) from a sensor's normal towards its x and its y; NaN where it reads none; `other`: as `_sun` has it."""
    x = np.clip(
        sensor.x_scale * _numbers(table, [sensor.x_column])[:, 0] - sensor.x_bias_rad,
        -STEEPEST_RAD,
        STEEPEST_RAD,
    )
    if sensor.y_column is None or sensor.y_scale is None:
        return x, np.full(len(x), np.nan)
    turned = _turned(sensor, table) ^ (other & _unsure(sensor, table))
    scale = np.where(turned, sensor.y_turned_scale or 0.0, sensor.y_scale)
    return x, np.clip(
        scale * _numbers(table, [sensor.y_column])[:, 0] - sensor.y_bias_rad,
        -STEEPEST_RAD,
        STEEPEST_RAD,
    )


def _turned(sensor: SunSensor, table: Table) -> np.ndarray:
    """Whether the y of each row (n) runs the other way."""
    if sensor.y_turned_above is None or sensor.light_column not in table.header:
        return np.zeros(len(table.cells), dtype=bool)
    return _light(sensor, table) > sensor.y_turned_above


def _unsure(sensor: SunSensor, table: Table) -> np.ndarray:
    """Whether the y of each row (n) may be turned or not, its light being near that at which it turns."""
    if (
        sensor.y_turned_above is None
        or sensor.y_turned_sigma is None
        or sensor.light_column not in table.header
    ):
        return np.zeros(len(table.cells), dtype=bool)
    return (
        np.abs(_light(sensor, table) - sensor.y_turned_above) < BOTH_SIGMAS * sensor.y_turned_sigma
    )


def _one_sensor(
    sensor: SunSensor, sensors: list[SunSensor], lit: np.ndarray, x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Directions (n, 3) of one sensor and their information (n, 3, 3), from its angles (n)."""
    u, v = sensor.x_axis_B, np.cross(sensor.normal_B, sensor.x_axis_B)
    n = len(x)
    y_sigma = np.full(n, sensor.y_sigma_rad)
    if sensor.y_column is None:
        towards = np.array([other.normal_B @ v for other in sensors])
        beside = (lit * (np.abs(towards) > 0.5)) @ np.sign(towards)
        y = NEIGHBOUR_RAD * np.clip(beside, -1, 1)
        y_sigma[beside != 0] = min(NEIGHBOUR_SIGMA_RAD, sensor.y_sigma_rad)
    direction = sensor.normal_B + np.tan(x)[:, None] * u + np.tan(y)[:, None] * v
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    across = np.cross(direction, u)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    along = np.cross(across, direction)
    parts = (
        (along, np.full(n, sensor.x_sigma_rad)),
        (across, y_sigma),
        (direction, np.full(n, RADIAL_SIGMA)),
    )
    information = [
        axis[:, :, None] * axis[:, None, :] / (sigma**2)[:, None, None] for axis, sigma in parts
    ]
    return direction, np.sum(information, axis=0)
