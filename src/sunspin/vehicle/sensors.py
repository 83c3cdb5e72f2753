"""What a vehicle carries beside its panels: Sun sensors, a gyro, a magnetometer; and what is known of its disturbances.

All in body axes. A sensor that reads by itself says what its columns mean (`seen`), and `VARIABLES` where telemetry has that.
A minus before a column of three (`"-wx"`) says that the sensor's axis points against the body's.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, AliasPath, Field, PlainValidator, ValidationInfo

from sunspin.base.errors import VehicleError
from sunspin.vehicle.part import (
    UNIT_TOLERANCE,
    FloatArray,
    Name,
    Number,
    Part,
    Positive,
    Vector,
    array,
    frozen_array,
    numbers,
    part,
    unit,
)

VARIABLES = {"gyro": "gyro_B", "magnetometer": "field_B", "attitude": "attitude_B_from_N"}
"""Sensor, by its table in a vehicle file -> the variable of telemetry with what it saw."""

REVERSED = "-"
"""Before the name of a column whose readings count with the other sign."""

QUATERNION_TOLERANCE = 0.02
"""A quaternion whose length is farther from one than this is none."""

SensorVariable = tuple[str, np.ndarray, dict[str, str]]
"""Second dimension (the first is time), values (n, 3 or 4) and attributes of a variable of telemetry."""


def unwrap_counts(counts: np.ndarray, wraps_at: float | None) -> np.ndarray:
    """Counts whose upper half stands for negative numbers (65535 for -1 where they wrap at 65536)."""
    return (
        counts if wraps_at is None else np.where(counts >= wraps_at / 2, counts - wraps_at, counts)
    )


def _sigma_validator(key: str, *shape: int) -> PlainValidator:
    """The sigma in a value's birth certificate: one number, or one for each component."""

    def check(raw: Any, info: ValidationInfo) -> Any:
        sigma = np.array(given := numbers(raw) if info.context else raw, dtype=np.float64)
        if sigma.shape not in ((), shape) or np.any(sigma < 0):
            what = (
                f"the sigma of {key} must be one number or one for each component, and not negative"
            )
            raise VehicleError(what, got=given)
        return frozen_array(np.broadcast_to(sigma, shape)) if shape else float(sigma)

    return PlainValidator(check)


def _column_rules(n: int, sign: str = "") -> tuple[Any, ...]:
    """The rules for n columns: that many, and each another, though one had the `sign` before it."""

    def check(columns: tuple[str, ...]) -> tuple[str, ...]:
        names = [column.removeprefix(sign) for column in columns]
        if not all(names):
            what = "{path} has a minus and no column after it"
            raise VehicleError(what, got=", ".join(columns), do='"-wx" reads column wx reversed')
        if len(set(names)) < n:
            raise VehicleError(
                "{path} names a column twice", got=", ".join(columns), do="give each axis its own"
            )
        return columns

    return Field(min_length=n, max_length=n), AfterValidator(check)


@part
class ThreeAxes(Part):
    """A sensor with a column for each body axis, x first; with a minus before its name the column counts reversed."""

    columns: Annotated[tuple[Name, ...], *_column_rules(3, REVERSED)]

    @property
    def names(self) -> list[str]:
        """The columns as a telemetry file calls them."""
        return [column.removeprefix(REVERSED) for column in self.columns]

    @property
    def sign(self) -> FloatArray:
        """-1 (3) where the column counts reversed, else 1."""
        return np.array([-1.0 if column.startswith(REVERSED) else 1.0 for column in self.columns])

    def keys_for_axes(self, order: Sequence[int], sign: Sequence[float]) -> dict[str, Any]:
        """Keys of the vehicle file that make of these axes others: each is that of `order`, times `sign`."""
        now = list(order)
        named = [
            REVERSED * bool(s < 0) + self.names[k]
            for k, s in zip(now, self.sign[now] * sign, strict=True)
        ]
        zero, sigma = np.stack([getattr(self, key, np.zeros(3)) for key in ("zero", "zero_sigma")])[
            :, now
        ]
        if np.array_equal(zero, zero[np.argsort(now)]):
            return {"columns": named}
        value = {"value": zero.tolist(), "sigma": sigma.tolist()} if sigma.any() else zero.tolist()
        return {"columns": named, "zero": value}  # it goes with its column


@part
class SunSensor(Part):
    """A two-axis Sun sensor: outward normal, its x axis (its y axis is normal cross x), columns, how it reads.

    It sees the Sun where its light exceeds `lit_above` (unit of the column). The Sun's angle from the normal towards x is
    the reading times `x_scale` (rad); likewise y, or nothing where `y_scale` is None: then it is known only that the Sun is
    in view. `x_sigma_rad` and `y_sigma_rad` are one-sigma errors of these angles. A sensor whose y wraps has
    `y_turned_above`: where its light exceeds that, the Sun being near its normal, y is the reading times `y_turned_scale`;
    `y_turned_sigma`: within two of it from there, y may be the one or the other.
    `x_bias_rad` and `y_bias_rad` are then taken off: the angles read where the Sun stands on the normal.
    """

    left_out = {"y_column": None, "light_column": None, "lit_above": 0.0, "y_scale": None}

    name: Name
    normal_B: Annotated[FloatArray, unit("normal_B of Sun sensor {name!r}")]
    x_axis_B: Annotated[FloatArray, unit("x_axis_B of Sun sensor {name!r}")]
    x_column: Name
    y_column: Name | None
    light_column: Name | None
    lit_above: Number
    x_scale: Number
    y_scale: Number | None
    x_sigma_rad: Positive
    y_sigma_rad: Positive
    y_turned_above: Number | None = None
    y_turned_scale: Number | None = None
    y_turned_sigma: Positive | None = None
    x_bias_rad: Number = 0.0
    y_bias_rad: Number = 0.0

    def __post_init__(self) -> None:
        if abs(self.normal_B @ self.x_axis_B) > UNIT_TOLERANCE:
            raise VehicleError(
                "{path}.x_axis_B must be at right angles to its normal", got=self.x_axis_B.tolist()
            )
        if self.x_column == self.y_column:
            raise VehicleError(
                "{path} names one column for x and y", got=self.x_column, do="give each its own"
            )
        if (self.y_column is None) != (self.y_scale is None):
            raise VehicleError("{path} must give both y_column and y_scale, or neither")
        if (self.y_turned_above is None) != (self.y_turned_scale is None):
            raise VehicleError(
                "{path} must give both y_turned_above and y_turned_scale, or neither"
            )
        if self.y_turned_sigma is not None and self.y_turned_above is None:
            raise VehicleError(
                "{path} has a y_turned_sigma and no y_turned_above, of which it is one sigma"
            )


@part
class SunVector(ThreeAxes):
    """Three columns along the body axes with the direction to the Sun, as somebody has computed it: of any length.

    `sigma_rad`: one sigma of the direction. Where a vector is shorter than half of the longest, no Sun was seen.
    """

    sigma_rad: Positive


@part
class Gyro(ThreeAxes):
    """Three gyro columns along the body axes: rate (rad/s) is `scale_rad_s` times (reading less `zero`), reversed or not.

    `noise_rad_s` is that of one sample, `zero_sigma` (3) and `scale_sigma` are shared by all samples of a pass.
    """

    left_out = {"zero": [0.0, 0.0, 0.0]}

    scale_rad_s: Number
    zero: Vector
    noise_rad_s: Positive
    wraps_at: Positive | None = None
    zero_sigma: Annotated[FloatArray, _sigma_validator("gyro.zero", 3)] = Field(
        default_factory=lambda: frozen_array(np.zeros(3)),
        validation_alias=AliasPath("zero", "sigma"),
    )
    scale_sigma: Annotated[float, _sigma_validator("gyro.scale_rad_s")] = Field(
        default=0.0, validation_alias=AliasPath("scale_rad_s", "sigma")
    )

    def __post_init__(self) -> None:
        if self.scale_rad_s == 0:
            raise VehicleError("{path}.scale_rad_s must not be zero")

    def interpret(self, reading: np.ndarray) -> SensorVariable:
        """Rates of the readings (n, 3) of its columns."""
        value = self.scale_rad_s * self.sign * (unwrap_counts(reading, self.wraps_at) - self.zero)
        return "axis", value, {"units": "rad s-1", "long_name": "gyro, body axes"}


def _is_invertible(matrix: FloatArray) -> bool:
    return (
        matrix.shape == (3, 3) and bool(np.isfinite(matrix).all()) and np.linalg.cond(matrix) < 1e6
    )


@part
class Magnetometer(ThreeAxes):
    """Three columns along the body axes, in any unit: field is `matrix` times (reading less `zero`), reversed or not.

    `matrix` (3, 3) is soft iron, axes and unequal scales, near one. `noise` (same unit) is None where the reading may not be used
    as a direction (zero or axes not known well enough). `scale_T`: a unit in tesla; None where not known. `zero_sigma` (3) is
    shared by all samples of a pass.
    """

    left_out = {"zero": [0.0, 0.0, 0.0], "noise": None}

    zero: Vector
    noise: Positive | None
    wraps_at: Positive | None = None
    matrix: Annotated[
        FloatArray,
        array(_is_invertible, "{path} must be three rows of three numbers that can be inverted"),
    ] = Field(default_factory=lambda: frozen_array(np.eye(3)))
    scale_T: Positive | None = None
    zero_sigma: Annotated[FloatArray, _sigma_validator("magnetometer.zero", 3)] = Field(
        default_factory=lambda: frozen_array(np.zeros(3)),
        validation_alias=AliasPath("zero", "sigma"),
    )

    def interpret(self, reading: np.ndarray) -> SensorVariable:
        """Fields of the readings (n, 3) of its columns, in their unit."""
        value = (self.sign * (unwrap_counts(reading, self.wraps_at) - self.zero)) @ self.matrix.T
        return (
            "axis",
            value,
            {"long_name": "magnetometer less its zero, times its matrix, body axes"},
        )

    def keys_for_axes(self, order: Sequence[int], sign: Sequence[float]) -> dict[str, Any]:
        turned = np.eye(3)[list(order)] * np.array(sign)[:, None]
        matrix = turned @ self.matrix @ turned.T + 0.0  # of the axes as they then are
        return super().keys_for_axes(order, sign) | (
            {} if np.array_equal(matrix, self.matrix) else {"matrix": matrix.tolist()}
        )


@part
class Attitude(Part):
    """Four columns with somebody's attitude as a quaternion: where its scalar stands, which way it turns, its error.

    `rotates`: "N_to_B" if it takes components in the reference frame to components in the body, "B_to_N" for the opposite.
    """

    columns: Annotated[tuple[Name, ...], *_column_rules(4)]
    scalar: Literal["first", "last"]
    rotates: Literal["N_to_B", "B_to_N"]
    sigma_rad: Positive

    @property
    def names(self) -> tuple[str, ...]:
        """The columns as a telemetry file calls them."""
        return self.columns

    def interpret(self, reading: np.ndarray) -> SensorVariable:
        """Unit quaternions B_from_N, scalar last, of the readings (n, 4) of its columns; NaN where they hold no unit quaternion."""
        value = reading[:, [1, 2, 3, 0]] if self.scalar == "first" else reading
        value = value * [-1.0, -1.0, -1.0, 1.0] if self.rotates == "B_to_N" else value
        size = np.linalg.norm(value, axis=1, keepdims=True)
        good = np.abs(size - 1) < QUATERNION_TOLERANCE
        about = {
            "units": "1",
            "long_name": "attitude as given, scalar last, from reference frame to body",
        }
        return "quaternion", np.where(good, value / np.where(good, size, 1.0), np.nan), about

    def keys_for_convention(self, scalar: bool, way: bool) -> dict[str, str]:
        """Keys of the vehicle file with the scalar at the other end, or the other way round."""
        keys = {"scalar": "first" if self.scalar == "last" else "last"} if scalar else {}
        return keys | (
            {"rotates": "N_to_B" if self.rotates == "B_to_N" else "B_to_N"} if way else {}
        )


@part
class Disturbance(Part):
    """What turns the vehicle beside its own motion.

    `acceleration_noise` (rad/s^1.5): white angular acceleration; after t seconds a rate has wandered by this times sqrt(t).
    `noise_without_field`: the same where the dipole's torque is not modelled, the field not being measured.
    `dipole` (3): angular acceleration dipole x field, rad/s2 per unit of the magnetometer. `max_rate_rad_s`: no rate is
    faster.
    """

    acceleration_noise: Positive | None = None
    noise_without_field: Positive | None = None
    dipole: Vector | None = None
    max_rate_rad_s: Positive | None = None


@part
class Clock(Part):
    """How late gyro, magnetometer and attitude of a row are behind its panels and Sun sensors (s), and one sigma of that; with
    zero it is known."""

    late_s: Number = Field(validation_alias="sensors_late_s")
    sigma_s: Annotated[float, _sigma_validator("clock.sensors_late_s")] = Field(
        default=0.0, validation_alias=AliasPath("sensors_late_s", "sigma")
    )


@part
class Sensors(Part):
    """All of these; what is absent is empty or None."""

    sun_sensors: tuple[SunSensor, ...] = ()
    sun_vector: SunVector | None = None
    gyro: Gyro | None = None
    attitude: Attitude | None = None
    magnetometer: Magnetometer | None = None
    disturbance: Disturbance = Disturbance()
    clock: Clock | None = None

    @property
    def with_columns(self) -> dict[str, Any]:
        """The sensors whose columns go along the axes of the body, by their table in the vehicle file."""
        return {name: sensor for name, sensor in vars(self).items() if hasattr(sensor, "columns")}
