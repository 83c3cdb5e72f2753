"""Sun sensors, gyro and magnetometer of a telemetry file, as directions, rates and fields in body axes with their errors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from sunspin.base.tables import TextTable
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

NEIGHBOUR_COSINE = 0.5
"""Smallest cosine between a sensor's y axis and the normal of a neighbour on that side."""

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


def read_sensors(vehicle: Vehicle, table: TextTable) -> dict[str, Any]:
    """Return the variables of sensors for a Dataset over `time`; sensors without columns in the table are left out.

    Returns
    -------
    dict
        `sun_sensor_B` (time, axis): unit vector to the Sun, body axes, with `sun_sensor_cov_B` (time, axis, axis2); NaN if no
        sensor sees the Sun. `sun_sensor_other_B`, `sun_sensor_other_cov_B`: the same with the other sign of a sensor's y, for
        samples in which the sign is ambiguous, else NaN.
        `sun_sensor_angle` (time, sun_sensor, side): rad, angles of the Sun from each sensor's normal; NaN if it does not see the
        Sun or does not measure the angle. `sun_sensor_y_turned` (time, sun_sensor): 1 if the sign of its y is reversed.
        `gyro_B` (time, axis) rad/s; `rate_size` (time) rad/s; `field_B` (time, axis) in the unit of the columns, corrected by zero
        and matrix;
        `attitude_B_from_N` (time, quaternion); `wheel_speed_rad_s` (time, wheel).
        Cells without a number give NaN.
    """
    variables = _sun_variables(vehicle, table)
    for name, variable in VARIABLES.items():
        sensor = vehicle.sensors.with_columns.get(name)
        if sensor is not None and table.has(sensor.names):
            # zero, scale, signs and axes of the vehicle file are applied here
            dimension, value, attrs = sensor.interpret(read_numbers(table, sensor.names))
            variables[variable] = (("time", dimension) if dimension else "time", value, attrs)
    speed_columns = [wheel.speed_column for wheel in vehicle.wheels if wheel.speed_column]
    if speed_columns and table.has(speed_columns):
        speed = np.full((len(table.cells), len(vehicle.wheels)), np.nan)
        for k, wheel in enumerate(vehicle.wheels):
            if wheel.speed_column:
                speed[:, k] = (
                    wheel.speed_scale_rad_s * read_numbers(table, [wheel.speed_column])[:, 0]
                )
        attrs = {"units": "rad s-1", "long_name": "speed of each wheel relative to the body"}
        variables["wheel_speed_rad_s"] = (("time", "wheel"), speed, attrs)
    return variables


def read_columns(table: TextTable, names: Sequence[str]) -> dict[str, Any]:
    """Return the variable `column_reading` (time, column): numbers of columns as the file has them, NaN for fill values."""
    if not names:
        return {}
    about = {"units": "1", "long_name": "reading of a column, as the file has it"}
    return {"column_reading": (("time", "column"), read_numbers(table, list(names)), about)}


def _sun_variables(vehicle: Vehicle, table: TextTable) -> dict[str, Any]:
    """Return the variables of `read_sensors` that come from Sun sensors and the Sun vector."""
    sensors, vector = vehicle.sensors.sun_sensors, vehicle.sensors.sun_vector
    vector = vector if vector is not None and table.has(vector.names) else None
    present = [k for k, sensor in enumerate(sensors) if table.has(sun_sensor_columns(sensor))]
    if not present and vector is None:
        return {}
    # for each sample and sensor: it sees the Sun; the sign of its y is reversed; this sign is uncertain
    lit, turned, ambiguous = np.zeros((3, len(table.cells), len(sensors)), dtype=bool)
    for k in present:
        sensor = sensors[k]
        if sensor.light_column is None:  # then it is assumed to see the Sun always
            lit[:, k] = True
            continue
        light = np.nan_to_num(read_numbers(table, [sensor.light_column])[:, 0], nan=-np.inf)
        lit[:, k] = light > sensor.lit_above
        if sensor.y_turned_above is not None:
            excess = light - sensor.y_turned_above
            turned[:, k] = excess > 0
            ambiguous[:, k] = np.abs(excess) < AMBIGUOUS_SIGMAS * (sensor.y_turned_sigma or 0.0)
    variables: dict[str, Any] = {}
    sun = _combine_sensors(vehicle, table, present, vector, lit, turned)
    if present:
        long_name = "angles of each Sun sensor from its normal, along its x and its y"
        about = {"units": "rad", "long_name": long_name}
        variables["sun_sensor_angle"] = (("time", "sun_sensor", "side"), sun.angle, about)
        about = {"units": "1", "long_name": "1 where a Sun sensor's y runs the other way"}
        flags = turned.astype(np.int8)
        variables["sun_sensor_y_turned"] = (("time", "sun_sensor"), flags, about)
    name = "Sun by the Sun sensors, body axes"
    variables |= _direction_variables("sun_sensor", sun.direction, sun.covariance, name)
    if ambiguous.any():
        # with the less likely signs, in samples in which some sign is uncertain
        other = _combine_sensors(vehicle, table, present, vector, lit, turned ^ ambiguous)
        uncertain = np.asarray(ambiguous.any(axis=1))
        direction = np.where(uncertain[:, None], other.direction, np.nan)
        covariance = np.where(uncertain[:, None, None], other.covariance, np.nan)
        name = "Sun by the Sun sensors, if their y runs the other way"
        variables |= _direction_variables("sun_sensor_other", direction, covariance, name)
    return variables


class _CombinedSun(NamedTuple):
    """Sun of all sensors together.

    `direction` (n, 3), body axes, and its `covariance` (n, 3, 3): NaN if no sensor sees the Sun, or if they see different Suns.
    `angle` (n, n_sensor, 2): angles of each Sun sensor, NaN if it does not see the Sun.
    """

    direction: np.ndarray
    covariance: np.ndarray
    angle: np.ndarray


def _combine_sensors(
    vehicle: Vehicle,
    table: TextTable,
    present: Iterable[int],
    vector: SunVector | None,
    lit: np.ndarray,
    y_turned: np.ndarray,
) -> _CombinedSun:
    """Return the mean Sun direction of the sensors, weighted by their information matrices.

    Parameters
    ----------
    present : numbers of the Sun sensors whose columns the table has
    vector : SunVector, optional
        A Sun vector whose columns the table has.
    lit : (n, n_sensor)
        Sensors that see the Sun.
    y_turned : (n, n_sensor)
        Sensors whose y has the reversed sign.
    """
    sensors, n = vehicle.sensors.sun_sensors, len(table.cells)
    angle = np.full((n, len(sensors), 2), np.nan)
    # of each sensor: directions (n, 3), their information matrices (n, 3, 3), and whether it sees the Sun (n)
    views = [] if vector is None else [_sun_vector(vector, table)]
    for k in present:
        angle[lit[:, k], k] = _angles(sensors[k], table, y_turned[:, k])[lit[:, k]]
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
    # directions of sensors that see different Suns cancel in the mean
    length = np.linalg.norm(sun, axis=1)
    agree = seen & (length > AGREE)
    sun[agree] /= length[agree, None]
    sun[~agree], covariance[~agree] = np.nan, np.nan
    return _CombinedSun(sun, covariance, angle)


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


def read_numbers(table: TextTable, names: Any) -> np.ndarray:
    """Return the readings (n, n_column) of columns; NaN for cells without a number and for fill values."""
    values = table.numbers(names)
    values = np.where(np.abs(values) < ABSURD, values, np.nan)
    may_be_fill = np.isin(values, FILLS)
    others = np.where(may_be_fill, 0.0, np.nan_to_num(np.abs(values)))
    largest_other = np.max(others, axis=0, initial=0.0)  # of each column
    return np.where(may_be_fill & (np.abs(values) > FILL_FACTOR * largest_other), np.nan, values)


def _sun_vector(form: SunVector, table: TextTable) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the directions (n, 3) of a Sun vector, their information matrices (n, 3, 3), and whether it sees the Sun (n)."""
    value = form.sign * read_numbers(table, form.names)
    length = np.linalg.norm(value, axis=1)
    longest = float(np.nanmax(length, initial=0.0))
    sees = length > max(SHORTEST * longest, 1 / ABSURD)
    direction = value / np.where(sees, length, 1.0)[:, None]
    # projections along the direction and, by their complement, across it
    along = direction[:, :, None] * direction[:, None, :]
    information = along / RADIAL_SIGMA**2 + (np.eye(3) - along) / form.sigma_rad**2
    return direction, information, sees


def _angles(sensor: SunSensor, table: TextTable, y_turned: np.ndarray) -> np.ndarray:
    """Return the Sun's angles (n, 2), rad, from a sensor's normal towards its x and y axes; NaN if not measured."""
    x = sensor.x_scale * read_numbers(table, [sensor.x_column])[:, 0] - sensor.x_bias_rad
    y = np.full(len(x), np.nan)
    if sensor.y_column is not None and sensor.y_scale is not None:
        scale = np.where(y_turned, sensor.y_turned_scale or 0.0, sensor.y_scale)
        y = scale * read_numbers(table, [sensor.y_column])[:, 0] - sensor.y_bias_rad
    return np.clip(np.stack([x, y], axis=1), -STEEPEST_RAD, STEEPEST_RAD)


def _direction(
    k: int, sensors: Sequence[SunSensor], lit: np.ndarray, angle: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the directions (n, 3) to the Sun of sensor `k`, and their information matrices (n, 3, 3), from its angles (n, 2).

    If the sensor does not measure y, the angle is estimated from which of its neighbours are lit (`lit`, (n, n_sensor)).
    """
    sensor, n = sensors[k], len(angle)
    x_axis_B, y_axis_B = sensor.x_axis_B, np.cross(sensor.normal_B, sensor.x_axis_B)
    x, y = angle.T
    y_sigma = np.full(n, sensor.y_sigma_rad)
    if sensor.y_column is None:
        # lit neighbours that look within 60 degrees of +y or -y: their sum is positive if the Sun is on the side of +y
        cosine = np.array([neighbour.normal_B @ y_axis_B for neighbour in sensors])
        side = (lit * (np.abs(cosine) > NEIGHBOUR_COSINE)) @ np.sign(cosine)
        y = NEIGHBOUR_RAD * np.clip(side, -1, 1)
        y_sigma[side != 0] = min(NEIGHBOUR_SIGMA_RAD, sensor.y_sigma_rad)
    direction = sensor.normal_B + np.tan(x)[:, None] * x_axis_B + np.tan(y)[:, None] * y_axis_B
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    # unit vectors along which the two angles move the direction, and the direction itself
    along_y = np.cross(direction, x_axis_B)
    along_y /= np.linalg.norm(along_y, axis=1, keepdims=True)
    along_x = np.cross(along_y, direction)
    axes = np.stack([along_x, along_y, direction], axis=1)
    sigma = np.stack([np.full(n, sensor.x_sigma_rad), y_sigma, np.full(n, RADIAL_SIGMA)], axis=1)
    return direction, np.einsum("nki,nkj,nk->nij", axes, axes, sigma**-2.0)
