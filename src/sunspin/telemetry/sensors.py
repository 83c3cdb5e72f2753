"""Sun sensors, gyro and magnetometer of a telemetry file, as directions, rates and fields in body axes with their errors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from sunspin.base.tables import Table
from sunspin.vehicle import Vehicle
from sunspin.vehicle.sensors import VARIABLES, SunSensor, SunVector

RADIAL_SIGMA = 0.02
"""Sigma (unit vectors) along the direction itself: a chord is shorter than its arc, and the covariance must have full rank."""

ABSURD = 1e12
"""A number larger than this is not a reading in any unit."""

FILLS = (-99, -999, -9999, -32768, -2147483648, 999, 9999, 32767, 65535, 2147483647, 4294967295)
"""Numbers that programs write if a sensor was not read: limits of integer types, and nines."""

FILL_FACTOR = 3.0
"""Such a number is a fill value if it is so many times larger than all other numbers of its column."""

AGREE = 0.5
"""Sensors that see different Suns cancel: if the mean direction is shorter than this, there is no direction."""

SHORTEST = 0.5
"""A Sun vector shorter than this share of the longest one is no reading: in the dark, some computers write zeros or small
numbers."""

NEIGHBOUR_RAD = 0.73
"""Angle from a sensor's normal towards a neighbouring sensor that is lit, too, if it is not measured: about 42 degrees."""

NEIGHBOUR_SIGMA_RAD = 0.2
"""One sigma of that angle."""

AMBIGUOUS_SIGMAS = 2.0
"""Within so many sigmas of the light at which a sensor's y changes its sign, both signs are possible."""

STEEPEST_RAD = 1.4
"""Largest angle from its normal that a Sun sensor measures."""


class SensorColumns(NamedTuple):
    """Columns that a sensor reads: its table in the vehicle file, its name in words, and the names of the columns."""

    section: str
    name: str
    columns: list[str]


def sun_sensor_columns(sensor: SunSensor) -> list[str]:
    """Return the names of the columns that a Sun sensor reads."""
    return [name for name in (sensor.x_column, sensor.y_column, sensor.light_column) if name]


def sensor_columns(vehicle: Vehicle) -> Iterator[SensorColumns]:
    """Yield the columns of each sensor of the vehicle, wheel speeds included."""
    for sensor in vehicle.sensors.sun_sensors:
        columns = sun_sensor_columns(sensor)
        yield SensorColumns("[sun_sensor]", f"Sun sensor {sensor.name}", columns)
    for section, axes in vehicle.sensors.with_columns.items():
        yield SensorColumns(section, section.replace("_", " "), list(axes.names))
    for wheel in vehicle.wheels:
        if wheel.speed_column:
            yield SensorColumns("[wheel]", f"speed of wheel {wheel.name}", [wheel.speed_column])


def read_sensors(vehicle: Vehicle, table: Table) -> dict[str, Any]:
    """Return the variables of sensors for a Dataset over `time`; sensors without columns in the table are left out.

    Returns
    -------
    dict
        `sun_sensor_B` (time, axis): unit vector to the Sun, body axes, with `sun_sensor_cov_B` (time, axis, axis2); NaN if no
        sensor sees the Sun. `sun_sensor_other_B`, `sun_sensor_other_cov_B`: the same with the other sign of a sensor's y, for
        samples in which the sign is ambiguous, else NaN.
        `sun_sensor_angle` (time, sun_sensor, side): rad, angles of the Sun from each sensor's normal; NaN if it does not see the
        Sun or does not measure the angle. `sun_sensor_y_turned` (time, sun_sensor): 1 if the sign of its y is reversed.
        `gyro_B` (time, axis) rad/s; `field_B` (time, axis) in the unit of the columns, corrected by zero and matrix;
        `attitude_B_from_N` (time, quaternion); `wheel_speed_rad_s` (time, wheel).
        Cells without a number give NaN.
    """
    variables = _sun_variables(vehicle, table)
    for name, variable in VARIABLES.items():
        sensor = vehicle.sensors.with_columns.get(name)
        if sensor is not None and table.has(sensor.names):
            dimension, value, attrs = sensor.interpret(_numbers(table, sensor.names))
            variables[variable] = (("time", dimension), value, attrs)
    speed_columns = [wheel.speed_column for wheel in vehicle.wheels if wheel.speed_column]
    if speed_columns and table.has(speed_columns):
        speed = np.full((len(table.cells), len(vehicle.wheels)), np.nan)
        for k, wheel in enumerate(vehicle.wheels):
            if wheel.speed_column:
                speed[:, k] = wheel.speed_scale_rad_s * _numbers(table, [wheel.speed_column])[:, 0]
        attrs = {"units": "rad s-1", "long_name": "speed of each wheel relative to the body"}
        variables["wheel_speed_rad_s"] = (("time", "wheel"), speed, attrs)
    return variables


def _sun_variables(vehicle: Vehicle, table: Table) -> dict[str, Any]:
    """Return the variables of `read_sensors` that come from Sun sensors and the Sun vector."""
    sensors, vector = vehicle.sensors.sun_sensors, vehicle.sensors.sun_vector
    vector = vector if vector is not None and table.has(vector.names) else None
    present = {
        k: sensor for k, sensor in enumerate(sensors) if table.has(sun_sensor_columns(sensor))
    }
    if not present and vector is None:
        return {}
    n = len(table.cells)
    lit, turned, ambiguous = np.zeros((3, n, len(sensors)), dtype=bool)
    for k, sensor in present.items():
        if sensor.light_column is None:  # then it is assumed to see the Sun always
            lit[:, k] = True
            continue
        light = np.nan_to_num(_numbers(table, [sensor.light_column])[:, 0], nan=-np.inf)
        lit[:, k] = light > sensor.lit_above
        if sensor.y_turned_above is not None:
            excess = light - sensor.y_turned_above
            turned[:, k] = excess > 0
            ambiguous[:, k] = np.abs(excess) < AMBIGUOUS_SIGMAS * (sensor.y_turned_sigma or 0.0)
    angle = np.full((n, len(sensors), 2), np.nan)

    def combine_sensors(y_turned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the Sun (n, 3) and its covariance (n, 3, 3): the mean over sensors, weighted by their information matrices.

        `y_turned` (n, n_sensor) marks reversed signs of y. The angles of the sensors are written into `angle`.
        """
        views = [] if vector is None else [_sun_vector(vector, table)]
        for k, sensor in present.items():
            angle[lit[:, k], k] = _angles(sensor, table, y_turned[:, k])[lit[:, k]]
            views.append((*_direction(k, sensors, lit, angle[:, k]), lit[:, k]))
        information, weighted = np.zeros((n, 3, 3)), np.zeros((n, 3))
        for direction, weight, sees in views:
            use = sees & np.isfinite(direction).all(axis=1)
            information[use] += weight[use]
            weighted[use] += np.einsum("nij,nj->ni", weight[use], direction[use])
        covariance, sun = np.full((n, 3, 3), np.nan), np.full((n, 3), np.nan)
        seen = np.trace(information, axis1=1, axis2=2) > 0
        covariance[seen] = np.linalg.inv(information[seen])
        sun[seen] = np.einsum("nij,nj->ni", covariance[seen], weighted[seen])
        size = np.linalg.norm(sun, axis=1)
        agree = seen & (size > AGREE)
        sun[agree] /= size[agree, None]
        sun[~agree], covariance[~agree] = np.nan, np.nan
        return sun, covariance

    variables: dict[str, Any] = {}
    # the unlikely signs first, so that `angle` ends with the likely ones
    alternative = combine_sensors(turned ^ ambiguous) if ambiguous.any() else None
    sun, covariance = combine_sensors(turned)
    if present:
        long_name = "angles of each Sun sensor from its normal, along its x and its y"
        about = {"units": "rad", "long_name": long_name}
        variables["sun_sensor_angle"] = (("time", "sun_sensor", "side"), angle, about)
        about = {"units": "1", "long_name": "1 where a Sun sensor's y runs the other way"}
        flags = turned.astype(np.int8)
        variables["sun_sensor_y_turned"] = (("time", "sun_sensor"), flags, about)
    name = "Sun by the Sun sensors, body axes"
    variables |= _direction_variables("sun_sensor", sun, covariance, name)
    if alternative is not None:
        some = np.asarray(ambiguous.any(axis=1))
        sun = np.where(some[:, None], alternative[0], np.nan)
        covariance = np.where(some[:, None, None], alternative[1], np.nan)
        name = "Sun by the Sun sensors, if their y runs the other way"
        variables |= _direction_variables("sun_sensor_other", sun, covariance, name)
    return variables


def _direction_variables(
    prefix: str, sun: np.ndarray, covariance: np.ndarray, name: str
) -> dict[str, Any]:
    """Return the variables of a direction (n, 3) and its covariance (n, 3, 3), with units and long names."""
    about = {"units": "1", "long_name": name}
    about_covariance = {"units": "1", "long_name": f"covariance: {name}"}
    return {
        f"{prefix}_B": (("time", "axis"), sun, about),
        f"{prefix}_cov_B": (("time", "axis", "axis2"), covariance, about_covariance),
    }


def _numbers(table: Table, names: Any) -> np.ndarray:
    """Return the readings (n, n_column) of columns; NaN for cells without a number and for fill values."""
    values = table.numbers(names)
    values = np.where(np.abs(values) < ABSURD, values, np.nan)
    fill = np.isin(values, FILLS)
    largest = np.max(np.where(fill, 0.0, np.nan_to_num(np.abs(values))), axis=0, initial=0.0)
    return np.where(fill & (np.abs(values) > FILL_FACTOR * largest), np.nan, values)


def _sun_vector(form: SunVector, table: Table) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the directions (n, 3) of a Sun vector, their information matrices (n, 3, 3), and whether it sees the Sun (n)."""
    value = form.sign * _numbers(table, form.names)
    size = np.linalg.norm(value, axis=1)
    longest = float(np.nanmax(size, initial=0.0))
    sees = size > max(SHORTEST * longest, 1 / ABSURD)
    direction = value / np.where(sees, size, 1.0)[:, None]
    along = direction[:, :, None] * direction[:, None, :]
    return direction, along / RADIAL_SIGMA**2 + (np.eye(3) - along) / form.sigma_rad**2, sees


def _angles(sensor: SunSensor, table: Table, y_turned: np.ndarray) -> np.ndarray:
    """Return the Sun's angles (n, 2), rad, from a sensor's normal towards its x and y axes; NaN if not measured."""
    x = sensor.x_scale * _numbers(table, [sensor.x_column])[:, 0] - sensor.x_bias_rad
    y = np.full(len(x), np.nan)
    if sensor.y_column is not None and sensor.y_scale is not None:
        scale = np.where(y_turned, sensor.y_turned_scale or 0.0, sensor.y_scale)
        y = scale * _numbers(table, [sensor.y_column])[:, 0] - sensor.y_bias_rad
    return np.clip(np.stack([x, y], axis=1), -STEEPEST_RAD, STEEPEST_RAD)


def _direction(
    k: int, sensors: Sequence[SunSensor], lit: np.ndarray, angle: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the directions (n, 3) to the Sun of sensor `k`, and their information matrices (n, 3, 3), from its angles (n, 2).

    If the sensor does not measure y, the angle is estimated from which of its neighbours are lit (`lit`, (n, n_sensor)).
    """
    sensor, n = sensors[k], len(angle)
    u, v = sensor.x_axis_B, np.cross(sensor.normal_B, sensor.x_axis_B)
    x, y = angle.T
    y_sigma = np.full(n, sensor.y_sigma_rad)
    if sensor.y_column is None:
        towards = np.array([neighbour.normal_B @ v for neighbour in sensors])
        side = (lit * (np.abs(towards) > 0.5)) @ np.sign(towards)
        y = NEIGHBOUR_RAD * np.clip(side, -1, 1)
        y_sigma[side != 0] = min(NEIGHBOUR_SIGMA_RAD, sensor.y_sigma_rad)
    direction = sensor.normal_B + np.tan(x)[:, None] * u + np.tan(y)[:, None] * v
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    across = np.cross(direction, u)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    along = np.cross(across, direction)
    axes = np.stack([along, across, direction], axis=1)
    sigma = np.stack([np.full(n, sensor.x_sigma_rad), y_sigma, np.full(n, RADIAL_SIGMA)], axis=1)
    return direction, np.einsum("nki,nkj,nk->nij", axes, axes, sigma**-2.0)
