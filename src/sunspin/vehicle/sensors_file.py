"""The tables of a vehicle file about Sun sensors, gyro, magnetometer and disturbances."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from sunspin.base.errors import VehicleError, sentence
from sunspin.vehicle import parts
from sunspin.vehicle import sensors as s
from sunspin.vehicle.form import Form, Name, Value, scalar, take


class SunSensorForm(Form):
    name: Name
    normal_B: Value
    x_axis_B: Value
    x_column: Name
    y_column: str | None = None
    light_column: str | None = None
    lit_above: Value | None = None
    x_scale: Value
    y_scale: Value | None = None
    x_sigma_rad: Value
    y_sigma_rad: Value
    y_turned_above: Value | None = None
    y_turned_scale: Value | None = None


class GyroForm(Form):
    columns: Annotated[list[str], Field(min_length=3, max_length=3)]
    scale_rad_s: Value
    zero: Value | None = None
    noise_rad_s: Value
    wraps_at: Value | None = None


class AttitudeForm(Form):
    columns: Annotated[list[str], Field(min_length=4, max_length=4)]
    scalar: Literal["first", "last"]
    rotates: Literal["N_to_B", "B_to_N"]
    sigma_rad: Value


class MagnetometerForm(Form):
    columns: Annotated[list[str], Field(min_length=3, max_length=3)]
    zero: Value | None = None
    noise: Value | None = None
    wraps_at: Value | None = None


class DisturbanceForm(Form):
    acceleration_noise: Value | None = None
    noise_without_field: Value | None = None
    dipole: Value | None = None
    max_rate_rad_s: Value | None = None


class ClockForm(Form):
    sensors_late_s: Value


def read_sensor_forms(form: Any, facts: dict[str, parts.Fact]) -> s.Sensors:
    """The sensors of a checked vehicle file; every value's birth certificate goes to `facts`."""
    return s.Sensors(
        tuple(_sun_sensor(sensor, facts) for sensor in form.sun_sensor),
        None if form.gyro is None else _gyro(form.gyro, facts),
        None if form.attitude is None else _attitude(form.attitude, facts),
        None if form.magnetometer is None else _magnetometer(form.magnetometer, facts),
        _disturbance(form.disturbance, facts),
        None if form.clock is None else _clock(form.clock, facts),
    )


def _vector(facts: dict[str, parts.Fact], key: str, given: Any) -> np.ndarray:
    value = np.array(take(facts, key, given) if given is not None else np.zeros(3), dtype=np.float64)
    if value.shape != (3,):
        raise VehicleError(sentence(f"{key} must be three numbers", got=value.tolist()))
    return parts.frozen_array(value)


def _positive(facts: dict[str, parts.Fact], key: str, given: Any) -> float | None:
    value = scalar(facts, key, given)
    if value is not None and not value > 0:
        raise VehicleError(sentence(f"{key} must be positive", got=value))
    return value


def _above_zero(facts: dict[str, parts.Fact], key: str, given: Any) -> float:
    """A positive number that the form requires."""
    value = _positive(facts, key, given)
    if value is None:
        raise VehicleError(sentence(f"{key} is missing"))
    return value


def _three(columns: list[str]) -> tuple[str, str, str]:
    x, y, z = columns
    return x, y, z


def _sun_sensor(form: SunSensorForm, facts: dict[str, parts.Fact]) -> s.SunSensor:
    key = f"sun_sensor.{form.name}"
    normal = parts.direction(take(facts, f"{key}.normal_B", form.normal_B), f"normal_B of Sun sensor {form.name!r}")
    x_axis = parts.direction(take(facts, f"{key}.x_axis_B", form.x_axis_B), f"x_axis_B of Sun sensor {form.name!r}")
    if abs(normal @ x_axis) > parts.UNIT_TOLERANCE:
        raise VehicleError(sentence(f"{key}.x_axis_B must be at right angles to its normal", got=x_axis.tolist()))
    if (form.y_column is None) != (form.y_scale is None):
        raise VehicleError(sentence(f"{key} must give both y_column and y_scale, or neither"))
    if (form.y_turned_above is None) != (form.y_turned_scale is None):
        raise VehicleError(sentence(f"{key} must give both y_turned_above and y_turned_scale, or neither"))
    return s.SunSensor(
        form.name, normal, x_axis, form.x_column, form.y_column, form.light_column,
        scalar(facts, f"{key}.lit_above", form.lit_above) or 0.0,
        scalar(facts, f"{key}.x_scale", form.x_scale),
        scalar(facts, f"{key}.y_scale", form.y_scale),
        _above_zero(facts, f"{key}.x_sigma_rad", form.x_sigma_rad),
        _above_zero(facts, f"{key}.y_sigma_rad", form.y_sigma_rad),
        scalar(facts, f"{key}.y_turned_above", form.y_turned_above),
        scalar(facts, f"{key}.y_turned_scale", form.y_turned_scale),
    )  # fmt: skip


def _gyro(form: GyroForm, facts: dict[str, parts.Fact]) -> s.Gyro:
    noise = _above_zero(facts, "gyro.noise_rad_s", form.noise_rad_s)
    scale = scalar(facts, "gyro.scale_rad_s", form.scale_rad_s)
    if scale == 0:
        raise VehicleError(sentence("gyro.scale_rad_s must not be zero"))
    zero_sigma = np.broadcast_to(_sigma(form.zero, "gyro.zero"), 3)
    scale_sigma = float(_sigma(form.scale_rad_s, "gyro.scale_rad_s"))
    wraps = _positive(facts, "gyro.wraps_at", form.wraps_at)
    return s.Gyro(_three(form.columns), scale, _vector(facts, "gyro.zero", form.zero), noise, wraps, zero_sigma, scale_sigma)


def _attitude(form: AttitudeForm, facts: dict[str, parts.Fact]) -> s.Attitude:
    sigma = _above_zero(facts, "attitude.sigma_rad", form.sigma_rad)
    a, b, c, d = form.columns
    return s.Attitude((a, b, c, d), form.scalar, form.rotates, sigma)


def _sigma(given: Any, key: str) -> np.ndarray:
    """The stated sigma of a value, zero where none is stated."""
    if given is None or given.sigma is None:
        return np.zeros(())
    sigma = np.array(given.sigma, dtype=np.float64)
    if sigma.shape not in ((), np.shape(given.value)) or np.any(sigma < 0):
        what = f"the sigma of {key} must be one number or one for each component, and not negative"
        raise VehicleError(sentence(what, got=given.sigma))
    return sigma


def _magnetometer(form: MagnetometerForm, facts: dict[str, parts.Fact]) -> s.Magnetometer:
    noise = _positive(facts, "magnetometer.noise", form.noise)
    wraps = _positive(facts, "magnetometer.wraps_at", form.wraps_at)
    return s.Magnetometer(_three(form.columns), _vector(facts, "magnetometer.zero", form.zero), noise, wraps)


def _clock(form: ClockForm, facts: dict[str, parts.Fact]) -> s.Clock:
    late = scalar(facts, "clock.sensors_late_s", form.sensors_late_s)
    return s.Clock(late, float(_sigma(form.sensors_late_s, "clock.sensors_late_s")))


def _disturbance(form: DisturbanceForm, facts: dict[str, parts.Fact]) -> s.Disturbance:
    return s.Disturbance(
        _positive(facts, "disturbance.acceleration_noise", form.acceleration_noise),
        _positive(facts, "disturbance.noise_without_field", form.noise_without_field),
        None if form.dipole is None else _vector(facts, "disturbance.dipole", form.dipole),
        _positive(facts, "disturbance.max_rate_rad_s", form.max_rate_rad_s),
    )
