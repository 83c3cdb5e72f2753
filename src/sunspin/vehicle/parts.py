"""Parts of a vehicle: panels, wheels with their friction, legs, hull, antenna, rules, orbit.

Vectors are in the vehicle's body axes B, values in SI units. :class:`sunspin.vehicle.Vehicle` combines the parts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import InitVar, field
from types import MappingProxyType
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    AliasChoices,
    AliasPath,
    Field,
    PlainValidator,
    StrictBool,
    ValidationInfo,
    model_validator,
)

from sunspin.base.errors import VehicleError
from sunspin.vehicle.part import (
    FloatArray,
    Name,
    Number,
    Part,
    Positive,
    Vector,
    above_zero,
    array,
    as_tuples,
    must,
    no_entries,
    numbers,
    part,
    unit,
)

Noise = Annotated[Number, must(above_zero, "the noise of {name!r} must be positive")] | None

GAIN_UNITS = {"cells": None, "relative_gain": None, "gain_W": "W", "gain_A": "A"}
"""Key of a panel's gain in a file -> unit of the predicted signal (None: relative)."""


def _checked_sigma(sigma: Any) -> Any:
    """Return the sigma of a value, or raise `VehicleError` if it is negative or not finite."""
    values = np.asarray(() if sigma is None else sigma, dtype=np.float64)
    if not (np.isfinite(values) & (values >= 0)).all():
        raise VehicleError("the sigma of a value must be finite and not negative", got=sigma)
    return sigma


@part
class Fact(Part):
    """A number of the vehicle file with its standard deviation (same unit) and its source, if the file states them."""

    value: Annotated[float | tuple[Any, ...], PlainValidator(as_tuples)]
    sigma: Annotated[
        float | tuple[Any, ...] | None, PlainValidator(as_tuples), AfterValidator(_checked_sigma)
    ] = None
    source: str | None = None


@part
class Panel(Part):
    """A flat solar panel: outward unit normal in B, and gain, the signal at normal incidence of sunlight.

    The gain is relative (the number of cells, for example) unless the vehicle's `gain_unit` is "W" or "A". `noise`: standard
    deviation of its reading in the telemetry's unit, instead of that under [telemetry].
    """

    name: Name
    normal_B: Annotated[FloatArray, unit("normal_B of panel {name!r}")]
    gain: Annotated[Number, must(above_zero, "the gain of panel {name!r} must be positive")] = (
        Field(validation_alias=AliasChoices(*GAIN_UNITS))
    )
    noise: Noise = None

    @model_validator(mode="wrap")
    @classmethod
    def _one_gain(cls, given: Any, check: Callable[[Any], Panel], info: ValidationInfo) -> Panel:
        """Return the checked panel; a panel of a file must have exactly one of the gain keys."""
        if not (info.context and isinstance(given, dict)):
            return check(given)
        # other errors of the panel are reported first: the check gets exactly one gain, the first one or an invented one
        gain_keys = [key for key in GAIN_UNITS if key in given]
        panel = check(
            {key: given[key] for key in given if key not in gain_keys[1:]}
            | ({} if gain_keys else {"cells": 1.0})
        )
        if len(gain_keys) != 1:
            what = f"panel {panel.name!r} must give exactly one of {', '.join(GAIN_UNITS)}"
            raise VehicleError(what, got=", ".join(gain_keys) or "none")
        return panel


def _checked_panels(names: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
    """Return the panels of a channel, or raise `VehicleError` if there is none or one is repeated."""
    channel = info.data.get("name")
    if not names:
        raise VehicleError(
            f"channel {channel!r} names no panel", do="list the panels on this input"
        )
    if repeated := [name for name in names if names.count(name) > 1]:
        raise VehicleError(
            f"channel {channel!r} names a panel twice", got=repeated[0], do="keep one of them"
        )
    return names


@part
class Channel(Part):
    """An input of the power system shared by panels: it reads their sum or the largest (diodes or a common tracker).

    `throttled`: if the battery is full, all readings of a sample are reduced by one unknown factor. `noise`: as for a panel.
    """

    name: Name
    panels: Annotated[tuple[Name, ...], AfterValidator(_checked_panels)]
    reads: Literal["sum", "largest"]
    throttled: StrictBool = False
    noise: Noise = None


@part
class Tilted(Part):
    """A panel whose normal is rotated by the rotation vector `turn_B_rad`; the sigma is in the vehicle's facts."""

    panel: Name
    turn_B_rad: Vector


@part
class ResponseForm(Part):
    """Panel misalignment: one tilted panel, and the common misalignment of all panels relative to the body axes.

    `turned_B_rad` is the rotation vector of the common misalignment; sigmas are in the vehicle's facts.
    """

    tilted: Tilted | None = None
    turned_B_rad: Vector | None = None


@part
class SpinDown(Part):
    """The measured spin-down ``c1 exp(c2 t) + c3`` of a wheel (paper, section 2.2)."""

    c1_rad_s: Number
    c2_per_s: Number
    c3_rad_s: Number


FrictionTorque = Annotated[
    Number, must(lambda value: value >= 0, "friction {key} must be zero or positive")
]


@part
class Friction(Part):
    """Bearing friction: the torque on the wheel is ``-sign(W) (coulomb + viscous |W|)`` (paper, eq. 5).

    A `spin_down` may be given in place of both coefficients. The wheel converts it, as the conversion needs its inertia.
    """

    coulomb_N_m: FrictionTorque = 0.0
    viscous_N_m_s: FrictionTorque = 0.0
    spin_down: InitVar[SpinDown | None] = None

    @model_validator(mode="before")
    @classmethod
    def _one_law(cls, given: Any) -> Any:
        """Return what is given, or raise `VehicleError` if it has both a spin-down and coefficients."""
        if (
            isinstance(given, dict)
            and "spin_down" in given
            and given.keys() & {"coulomb_N_m", "viscous_N_m_s"}
        ):
            raise VehicleError(
                "{path} gives both a spin_down and coefficients", do="keep one of them"
            )
        return given

    def __post_init__(self, spin_down: SpinDown | None) -> None:
        if spin_down is not None:
            # no field: `of_wheel` converts it, called by the wheel, which knows its inertia
            vars(self)["measured"] = spin_down

    def of_wheel(self, inertia_kg_m2: float) -> Friction:
        """Return the friction with coefficients, computed from the spin-down if it was given as one."""
        measured = vars(self).get("measured")
        return (
            self
            if measured is None
            else self.from_spin_down(**vars(measured), inertia_kg_m2=inertia_kg_m2)
        )

    @classmethod
    def from_spin_down(
        cls, c1_rad_s: float, c2_per_s: float, c3_rad_s: float, inertia_kg_m2: float
    ) -> Friction:
        """Return the friction of a wheel whose measured spin-down follows ``c1 exp(c2 t) + c3`` (paper, section 2.2).

        That curve obeys dW/dt = c2 W - c2 c3, hence coulomb = c2 c3 J and viscous = -c2 J. `c1` only fixes the time at
        which the record begins.
        """
        if c2_per_s >= 0 or c3_rad_s > 0:
            raise VehicleError(
                "a spin-down c1 exp(c2 t) + c3 needs c2 < 0 and c3 <= 0 to be friction",
                got=f"c1 = {c1_rad_s}, c2 = {c2_per_s}, c3 = {c3_rad_s}",
            )
        return cls(c2_per_s * c3_rad_s * inertia_kg_m2, -c2_per_s * inertia_kg_m2)


@part
class Wheel(Part):
    """A wheel: axis (unit, B), axial inertia, nominal speed relative to the body, friction, brake torque.

    `speed_column` is the telemetry column of its speed, in units of `speed_scale_rad_s` (zero stands for 1 rad/s).
    """

    name: Name
    axis_B: Annotated[FloatArray, unit("axis_B of wheel {name!r}")]
    inertia_kg_m2: Positive
    speed_rad_s: Number = 0.0
    friction: Friction = Friction()
    alternative_frictions: Mapping[str, Friction] = field(default_factory=no_entries)
    brake_torque_N_m: (
        Annotated[Number, must(above_zero, "{key} of wheel {name!r} must be positive")] | None
    ) = None
    speed_column: Name | None = None
    speed_scale_rad_s: Annotated[Number, AfterValidator(lambda scale: scale or 1.0)] = 1.0

    def __post_init__(self) -> None:
        alternatives = {
            name: friction.of_wheel(self.inertia_kg_m2)
            for name, friction in self.alternative_frictions.items()
        }
        vars(self).update(
            friction=self.friction.of_wheel(self.inertia_kg_m2),
            alternative_frictions=MappingProxyType(alternatives),
        )


def _is_point(value: FloatArray) -> bool:
    """Return whether an array is one finite point (3)."""
    return value.shape == (3,) and bool(np.isfinite(value).all())


@part
class Leg(Part):
    """A leg: its tip, which can touch the ground, relative to the vehicle's centre of mass in B (m)."""

    name: Name
    tip_B_m: Annotated[
        FloatArray, array(_is_point, "tip_B_m of leg {name!r} must be three finite numbers")
    ]


def _are_points(value: FloatArray) -> bool:
    """Return whether an array holds at least one finite point, (n, 3)."""
    return (
        value.ndim == 2
        and value.shape[1] == 3
        and len(value) > 0
        and bool(np.isfinite(value).all())
    )


@part
class HullPart(Part):
    """A part of the outer shape that can touch the ground: points (n, 3) in B, in m from the centre of mass.

    The shape is the convex hull of all parts and the legs' tips. `panel` names the panel of which the points are the corners.
    """

    name: Name
    points_B_m: Annotated[
        FloatArray,
        array(
            _are_points, "points_B_m of hull part {name!r} must be points of three finite numbers"
        ),
    ]
    panel: Name | None = None


@part
class Antenna(Part):
    """An antenna that covers directions within half of `opening_rad` of its axis (unit, B)."""

    axis_B: Annotated[FloatArray, unit("antenna.axis_B")]
    opening_rad: Annotated[
        Number,
        must(
            lambda angle: 0 < angle <= 2 * np.pi,
            "antenna.opening_rad must be an angle above 0 and at most 2 pi",
        ),
    ]


@part
class SunRule(Part):
    """A rule that excludes samples from the reconstruction: it applies if all its panels are dark; `reason` says why."""

    all_dark: Annotated[tuple[Name, ...], Field(min_length=1)]
    reason: Name


def _time_sigma(raw: Any, info: ValidationInfo) -> float | None:
    """Return the sigma (s) of a time of [orbit], None if it is not stated; raise `VehicleError` if it is not valid."""
    if raw is None:
        return None
    sigma = numbers(raw) if info.context else raw
    if not isinstance(sigma, float | int) or not 0 <= sigma < np.inf:
        raise VehicleError(
            "the sigma of a time of [orbit] must be one number and not negative", got=raw
        )
    return float(sigma)


Sigma = Annotated[float | None, PlainValidator(_time_sigma)]


def _two_lines(lines: tuple[str, ...]) -> tuple[str, ...]:
    """Return the lines of an element set, or raise `VehicleError` if these are not two (or none)."""
    if len(lines) not in (0, 2):
        raise VehicleError(
            "{path} must be the two lines of a set of elements", got=f"{len(lines)} texts"
        )
    return lines


@part
class StatedOrbit(Part):
    """The orbit as far as it is known: the two lines of elements, or none if the command line gives a file.

    `shift_s`: time by which the vehicle is ahead of the elements along the track. `clock_s`: time by which the telemetry's
    clock is behind UTC. Each has a standard deviation (None: not known).
    """

    tle: Annotated[tuple[Name, ...], AfterValidator(_two_lines)] = ()
    shift_s: Number = 0.0
    shift_sigma_s: Sigma = Field(default=None, validation_alias=AliasPath("shift_s", "sigma"))
    clock_s: Number = 0.0
    clock_sigma_s: Sigma = Field(default=None, validation_alias=AliasPath("clock_s", "sigma"))
