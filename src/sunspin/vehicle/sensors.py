"""Sensors of a vehicle other than its panels (Sun sensors, gyro, magnetometer, attitude), and its disturbances.

Vectors are in body axes B. The method `interpret` of a sensor converts its columns; `VARIABLES` names the resulting telemetry
variables. A minus before one of three columns (`"-wx"`) means that the sensor's axis is opposite to the body's.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal, NamedTuple

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

VARIABLES = {
    "gyro": "gyro_B",
    "rate_size": "rate_size",
    "magnetometer": "field_B",
    "attitude": "attitude_B_from_N",
}
"""Table of a sensor in a vehicle file -> variable of the telemetry."""

REVERSED = "-"
"""Prefix of a column whose readings have the opposite sign."""

QUATERNION_TOLERANCE = 0.02
"""Largest deviation of a quaternion's length from one."""

EXACT_SHARE = 1e-3
"""Sigma of the zero of an axis that is stated without one, relative to the largest sigma of the three: as good as exact, and no
covariance is singular."""


def zero_sigmas(stated: FloatArray) -> FloatArray:
    """Return sigmas (3) of a sensor's zero, in the unit stated: all are positive if any is, so that each axis is an unknown."""
    return np.maximum(stated, EXACT_SHARE * stated.max())


class SensorVariable(NamedTuple):
    """A telemetry variable: name of its second dimension (the first is time; empty if there is none), values (n, 3 or 4) or
    (n), attributes."""

    dimension: str
    values: np.ndarray
    attributes: dict[str, str]


def unwrap_counts(counts: np.ndarray, wraps_at: float | None) -> np.ndarray:
    """Return counts whose upper half represents negative numbers (65535 is -1 for counts that wrap at 65536)."""
    return (
        counts if wraps_at is None else np.where(counts >= wraps_at / 2, counts - wraps_at, counts)
    )


def _sigma_validator(key: str, *shape: int) -> PlainValidator:
    """Return a validator for the sigma of a value: one number, or one for each component; broadcast to `shape`."""

    def check(raw: Any, info: ValidationInfo) -> Any:
        given = numbers(raw) if info.context else raw
        sigma = np.array(given, dtype=np.float64)
        if sigma.shape not in ((), shape) or np.any(sigma < 0):
            what = (
                f"the sigma of {key} must be one number or one for each component, and not negative"
            )
            raise VehicleError(what, got=given)
        return frozen_array(np.broadcast_to(sigma, shape)) if shape else float(sigma)

    return PlainValidator(check)


def _column_rules(n: int, prefix: str = "") -> tuple[Any, ...]:
    """Return the validators for a list of n different columns, each of which may have the given prefix."""

    def check(columns: tuple[str, ...]) -> tuple[str, ...]:
        """Raise `VehicleError` for a prefix without a name and for a repeated name; `Part` fills in `{path}` of a message."""
        names = [column.removeprefix(prefix) for column in columns]
        if not all(names):
            what = "{path} has a minus and no column after it"
            raise VehicleError(what, got=", ".join(columns), do='"-wx" reads column wx reversed')
        if len(set(names)) < len(names):
            raise VehicleError(
                "{path} names a column twice", got=", ".join(columns), do="give each axis its own"
            )
        return columns

    return Field(min_length=n, max_length=n), AfterValidator(check)


@part
class ThreeAxes(Part):
    """A sensor with a column for each body axis, x first; a minus before a name reverses the column."""

    columns: Annotated[tuple[Name, ...], *_column_rules(3, REVERSED)]

    @property
    def names(self) -> list[str]:
        """Names of the columns in a telemetry file."""
        return [column.removeprefix(REVERSED) for column in self.columns]

    @property
    def sign(self) -> FloatArray:
        """Sign (3) of each column: -1 if it is reversed, else 1."""
        return np.array([-1.0 if column.startswith(REVERSED) else 1.0 for column in self.columns])

    def keys_for_axes(self, order: Sequence[int], sign: Sequence[float]) -> dict[str, Any]:
        """Return the keys of the vehicle file that permute the axes: new axis k is axis `order[k]` times `sign[k]`.

        Used to propose a corrected column assignment. The zero is moved with its column if that changes it. Sensors without a
        zero have only the key "columns".
        """
        axes = list(order)
        columns = [
            (REVERSED if column_sign < 0 else "") + self.names[k]
            for k, column_sign in zip(axes, self.sign[axes] * sign, strict=True)
        ]
        zero, sigma = (getattr(self, key, np.zeros(3))[axes] for key in ("zero", "zero_sigma"))
        if np.array_equal(zero, getattr(self, "zero", np.zeros(3))):
            return {"columns": columns}
        value = {"value": zero.tolist(), "sigma": sigma.tolist()} if sigma.any() else zero.tolist()
        return {"columns": columns, "zero": value}


@part
class SunSensor(Part):
    """A two-axis Sun sensor: outward normal, x axis (the y axis is normal cross x), columns and scales.

    The Sun is in view if the light exceeds `lit_above` (unit of the column). The angle from the normal towards x is the reading
    times `x_scale` (rad), less `x_bias_rad`; `x_sigma_rad` is its standard deviation. The same holds for y. If `y_scale` is
    None, only the presence of the Sun is known in addition to x.

    A sensor whose y reading wraps has `y_turned_above`: if the light exceeds it, the Sun being near the normal, y is the
    reading times `y_turned_scale`. Within two `y_turned_sigma` of that limit y may have either scale.
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
    """The direction to the Sun, computed elsewhere, in three columns along the body axes; of any length.

    `sigma_rad`: standard deviation of the direction. A vector shorter than half of the longest one means that no Sun was seen.
    """

    sigma_rad: Positive


@part
class Gyro(ThreeAxes):
    """Three gyro columns along the body axes: the rate (rad/s) is `scale_rad_s` (reading - `zero`), with the column's sign.

    `noise_rad_s` is that of one sample; the errors `zero_sigma` (3) and `scale_sigma` are common to all samples of a pass.
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
        """Return rates in body axes (rad/s) from readings (n, 3) of the columns."""
        value = self.scale_rad_s * self.sign * (unwrap_counts(reading, self.wraps_at) - self.zero)
        about = {"units": "rad s-1", "long_name": "gyro, body axes"}
        return SensorVariable("axis", value, about)


@part
class RateSize(Part):
    """One column with the size of the body rate, without its axis: the size (rad/s) is `scale_rad_s` times the reading.

    `noise_rad_s` is that of one sample; the error `scale_sigma` is common to all samples of a pass.
    """

    column: Name
    scale_rad_s: Number
    noise_rad_s: Positive
    scale_sigma: Annotated[float, _sigma_validator("rate_size.scale_rad_s")] = Field(
        default=0.0, validation_alias=AliasPath("scale_rad_s", "sigma")
    )

    def __post_init__(self) -> None:
        if self.scale_rad_s <= 0:
            raise VehicleError("{path}.scale_rad_s must be positive", got=self.scale_rad_s)

    @property
    def columns(self) -> tuple[str, ...]:
        """Return its one column, as other sensors list theirs."""
        return (self.column,)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns in a telemetry file."""
        return (self.column,)

    def interpret(self, reading: np.ndarray) -> SensorVariable:
        """Return sizes (n) in rad/s from readings (n, 1) of the column; NaN for a negative one, which is no size."""
        value = self.scale_rad_s * reading[:, 0]
        about = {"units": "rad s-1", "long_name": "size of the body rate as it was read"}
        return SensorVariable("", np.where(value >= 0, value, np.nan), about)


def _is_invertible(matrix: FloatArray) -> bool:
    """Return whether an array is a finite matrix (3, 3) that can be inverted (condition number below 1e6)."""
    return (
        matrix.shape == (3, 3) and bool(np.isfinite(matrix).all()) and np.linalg.cond(matrix) < 1e6
    )


@part
class Magnetometer(ThreeAxes):
    """Three magnetometer columns along the body axes: the field is `matrix` (reading - `zero`), with the sign of each column.

    Readings have any unit. `matrix` (3, 3), near the identity, corrects soft iron, misalignment and unequal scales. `noise`
    (same unit) is None if zero or axes are not known well enough to use the direction. `scale_T`: the unit in tesla, None if
    unknown. `zero_sigma` (3) is common to all samples of a pass.
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
        """Return fields in body axes from readings (n, 3) of the columns, in their unit."""
        value = (self.sign * (unwrap_counts(reading, self.wraps_at) - self.zero)) @ self.matrix.T
        about = {"long_name": "magnetometer less its zero, times its matrix, body axes"}
        return SensorVariable("axis", value, about)

    def keys_for_axes(self, order: Sequence[int], sign: Sequence[float]) -> dict[str, Any]:
        """Return the keys that permute the axes, the matrix included; see `ThreeAxes.keys_for_axes`."""
        permutation = np.eye(3)[list(order)] * np.array(sign)[:, None]
        matrix = permutation @ self.matrix @ permutation.T + 0.0  # + 0.0 removes the sign of -0.0
        return super().keys_for_axes(order, sign) | (
            {} if np.array_equal(matrix, self.matrix) else {"matrix": matrix.tolist()}
        )


@part
class Attitude(Part):
    """Four columns with an attitude quaternion computed elsewhere: place of the scalar, direction of the rotation, error.

    `rotates`: "N_to_B" if it transforms components in the reference frame to body components, "B_to_N" for the opposite.
    """

    columns: Annotated[tuple[Name, ...], *_column_rules(4)]
    scalar: Literal["first", "last"]
    rotates: Literal["N_to_B", "B_to_N"]
    sigma_rad: Positive

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns in a telemetry file."""
        return self.columns

    def interpret(self, reading: np.ndarray) -> SensorVariable:
        """Return unit quaternions B_from_N, scalar last, from readings (n, 4); NaN where the length is not near one."""
        value = reading[:, [1, 2, 3, 0]] if self.scalar == "first" else reading
        # the conjugate is the inverse rotation
        value = value * [-1.0, -1.0, -1.0, 1.0] if self.rotates == "B_to_N" else value
        length = np.linalg.norm(value, axis=1, keepdims=True)
        good = np.abs(length - 1) < QUATERNION_TOLERANCE
        about = {
            "units": "1",
            "long_name": "attitude as given, scalar last, from reference frame to body",
        }
        unit_quaternion = np.where(good, value / np.where(good, length, 1.0), np.nan)
        return SensorVariable("quaternion", unit_quaternion, about)

    def keys_for_convention(self, other_scalar: bool, other_direction: bool) -> dict[str, str]:
        """Return the keys of the vehicle file for the other place of the scalar, the opposite direction, or both."""
        keys = {"scalar": "first" if self.scalar == "last" else "last"} if other_scalar else {}
        return keys | (
            {"rotates": "N_to_B" if self.rotates == "B_to_N" else "B_to_N"}
            if other_direction
            else {}
        )


@part
class Disturbance(Part):
    """Unmodelled torques on the vehicle.

    `acceleration_noise` (rad/s^1.5): white angular acceleration; the rate random-walks by this times sqrt(t) in t seconds.
    `noise_without_field`: the same if the field is not measured and so the torque of the dipole is not modelled. `dipole` (3):
    angular acceleration is dipole x field, in rad/s2 per unit of the magnetometer. `max_rate_rad_s`: upper limit of the rate.
    """

    acceleration_noise: Positive | None = None
    noise_without_field: Positive | None = None
    dipole: Vector | None = None
    max_rate_rad_s: Positive | None = None


@part
class Clock(Part):
    """Time offset of gyro, magnetometer and attitude: how much older their readings are than the Sun's in the same row (s).

    It is negative for sensors that are sampled after panels and Sun sensors. `sigma_s`: standard deviation of the offset; with zero
    it is known exactly.
    """

    late_s: Number = Field(validation_alias="sensors_late_s")
    sigma_s: Annotated[float, _sigma_validator("clock.sensors_late_s")] = Field(
        default=0.0, validation_alias=AliasPath("sensors_late_s", "sigma")
    )


@part
class Sensors(Part):
    """All sensors; absent ones are empty or None."""

    sun_sensors: tuple[SunSensor, ...] = ()
    sun_vector: SunVector | None = None
    gyro: Gyro | None = None
    rate_size: RateSize | None = None
    attitude: Attitude | None = None
    magnetometer: Magnetometer | None = None
    disturbance: Disturbance = Disturbance()
    clock: Clock | None = None

    @property
    def with_columns(self) -> dict[str, Any]:
        """Return the sensors of :data:`VARIABLES` and the Sun vector, by their table in the vehicle file."""
        return {name: sensor for name, sensor in vars(self).items() if hasattr(sensor, "columns")}
