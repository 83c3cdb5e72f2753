"""The vehicle: its parts together, and what makes them possible as one body."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from types import MappingProxyType
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, PlainValidator, ValidationInfo

from sunspin.base.errors import VehicleError, sentence
from sunspin.vehicle.notebook import vehicle_html
from sunspin.vehicle.part import (
    FloatArray,
    Name,
    Number,
    Numbers,
    Part,
    Positive,
    Text,
    above_zero,
    as_array,
    bare,
    frozen_array,
    must,
    no_entries,
    part,
)
from sunspin.vehicle.parts import Antenna, Fact, HullPart, Leg, Orbit, Panel, SunRule, Wheel
from sunspin.vehicle.response.choice import ResponseForm, response_of
from sunspin.vehicle.response.protocol import PanelResponse
from sunspin.vehicle.sensors import Sensors

MAX_PANELS = 32
"""Each cuts the sphere of directions further, n of them into n (n - 1) + 2 cells; satellites have about ten sides."""

MAX_WHEELS = 8
"""The kernels keep numbers for every set of wheels that turn freely."""

MAX_PARTS = 1000
"""Legs, parts of the hull, rules."""

LIMITS = {"panels": MAX_PANELS, "wheels": MAX_WHEELS, "legs": MAX_PARTS, "hull": MAX_PARTS, "sun_rules": MAX_PARTS}

SYMMETRY_TOLERANCE = 1e-9
"""Largest relative difference between mirrored elements of an inertia tensor."""


@part
class TelemetryForm(Part):
    """How the telemetry of this vehicle is written: columns, units, clock, noise. See the file `sunspin init` writes.

    A value is `scale` (reading - `zero`), the reading less `wraps_at` where at least half of that, over 1 +
    `temperature_coefficient_per_K` (T - `reference_temperature_C`), T being `temperature_scale` times its temperature column.
    Columns of currents give powers where there are voltages: then a value is that times `voltage_scale` times the panel's entry in
    `voltage_columns`, or where it has none `voltage_column`. A panel is read its entry of `offset_s` later than its row's time,
    and over `averaged_s` about that instant. `receive_time_column`: when a row was received, kept beside its own time.
    """

    quantity: Literal["power_W", "current_A"] = "power_W"
    time_column: Name = "time"
    time_format: Literal["utc", "unix", "elapsed"] = "utc"
    epoch_utc: str | None = None
    columns: Text = field(default_factory=no_entries)
    scale: Positive = 1.0
    noise: Positive | None = None
    lit_threshold: Positive | None = None
    bad_rows: Literal["refuse", "flag"] = "refuse"
    time_scale_s: Positive = 1.0
    receive_time_column: Name | None = None
    receive_time_format: Literal["utc", "unix"] = "utc"
    offset_s: Numbers = field(default_factory=no_entries)
    averaged_s: Annotated[Number, must(lambda value: value >= 0, "{path} must not be negative")] = 0.0
    zero: Number = 0.0
    wraps_at: Positive | None = None
    voltage_column: Name | None = None
    voltage_columns: Text = field(default_factory=no_entries)
    voltage_scale: Positive = 1.0
    temperature_columns: Text = field(default_factory=no_entries)
    temperature_scale: Positive = 1.0
    temperature_coefficient_per_K: Number = 0.0
    reference_temperature_C: Number = 25.0

    def __post_init__(self) -> None:
        used = [self.time_column, *([self.receive_time_column] if self.receive_time_column else []), *self.columns.values()]
        if twice := [name for name in used if used.count(name) > 1]:
            what = "telemetry names one column for the time and a panel, or for two panels"
            raise VehicleError(sentence(what, got=twice[0], do="give each panel its own"))
        if self.has_voltages and self.quantity != "power_W":
            what = "telemetry has voltages, with which currents become powers, but telemetry.quantity is current_A"
            raise VehicleError(sentence(what, do='set quantity = "power_W", or leave the voltages out'))
        if self.time_format == "elapsed" and self.epoch_utc is None and self.receive_time_column is None:
            what = "telemetry.time_format is elapsed but telemetry.epoch_utc is missing"
            raise VehicleError(sentence(what, do="add the UTC of time zero, or receive_time_column"))

    @property
    def has_voltages(self) -> bool:
        """Whether the columns are currents and powers are made of them."""
        return self.voltage_column is not None or bool(self.voltage_columns)


def _physical_inertia(raw: Any, info: ValidationInfo) -> FloatArray:
    """Check that a value is the inertia tensor of some distribution of mass."""
    key = "inertia_kg_m2"
    given = bare(raw, info)
    tensor = as_array(given)
    if tensor.shape != (3, 3) or not np.all(np.isfinite(tensor)):
        shown = given.tolist() if isinstance(given, np.ndarray) else given
        raise VehicleError(sentence(f"{key} must be three rows of three finite numbers", got=shown))
    size = float(np.abs(tensor).max())
    if np.abs(tensor - tensor.T).max() > SYMMETRY_TOLERANCE * size:
        i, j = np.unravel_index(np.argmax(np.abs(tensor - tensor.T)), (3, 3))
        raise VehicleError(
            sentence(
                f"{key} must be symmetric, but element [{i}][{j}] is {tensor[i, j]:g} and [{j}][{i}] is {tensor[j, i]:g}",
                do="make them equal",
            )
        )
    tensor = (tensor + tensor.T) / 2
    moments = np.linalg.eigvalsh(tensor)
    shown = ", ".join(f"{moment:.6g}" for moment in moments)
    if moments[0] <= 0:
        raise VehicleError(
            sentence(f"{key} must be positive definite, its principal moments are {shown}", do="check signs and units")
        )
    if moments[2] > (moments[0] + moments[1]) * (1 + SYMMETRY_TOLERANCE):
        raise VehicleError(
            sentence(
                f"{key} is not that of any body: principal moments {shown} break the rule that the largest is at most the "
                "sum of the other two",
                do="check the tensor (a products-of-inertia sign or a unit may be wrong)",
            )
        )
    return frozen_array(tensor)


Mass = Annotated[Number, must(above_zero, "mass_kg must be positive")]
Inertia = Annotated[FloatArray, PlainValidator(_physical_inertia)]
Facts = Annotated[Mapping[str, Fact], AfterValidator(lambda facts: MappingProxyType(dict(facts)))]


@part
class Vehicle(Part):
    """A rigid spacecraft with any number of panels, wheels and legs.

    `inertia_kg_m2` (3, 3) is the tensor of the whole vehicle, wheels included, about the joint centre of mass, off-diagonal
    entries being tensor elements (minus the products of inertia). Mass and inertia may be unknown (None): then what needs
    them says so. `changes`: what was set for this run beside the file (:mod:`sunspin.vehicle.changes`), for results to say.
    """

    name: Name
    inertia_kg_m2: Inertia | None = None
    mass_kg: Mass | None = None
    panels: tuple[Panel, ...] = ()
    wheels: tuple[Wheel, ...] = ()
    legs: tuple[Leg, ...] = ()
    hull: tuple[HullPart, ...] = ()
    antenna: Antenna | None = None
    orbit: Orbit | None = None
    sun_rules: tuple[SunRule, ...] = ()
    gain_unit: str | None = None
    telemetry: TelemetryForm = TelemetryForm()
    sensors: Sensors = Sensors()
    panel_response: ResponseForm = ResponseForm()
    facts: Facts = field(default_factory=no_entries)
    changes: tuple[Any, ...] = ()

    beside = ("changes",)

    def __post_init__(self) -> None:
        for key, most in LIMITS.items():
            if len(getattr(self, key)) > most:
                raise VehicleError(sentence(f"a vehicle has at most {most} {key}", got=len(getattr(self, key))))
        for key in ("panels", "wheels", "legs", "hull"):
            _require_distinct([part.name for part in getattr(self, key)], key)
        if self.inertia_kg_m2 is not None:
            _require_wheels_fit(self)
        _require_known_panels(self)

    _repr_html_ = vehicle_html

    @property
    def said(self) -> dict[str, str]:
        """What results say of the vehicle in their attributes: its name, and what was changed where anything was."""
        return {"vehicle": self.name} | ({"changes": "\n".join(map(str, self.changes))} if self.changes else {})

    @property
    def panel_names(self) -> tuple[str, ...]:
        return tuple(panel.name for panel in self.panels)

    @property
    def panel_normals_B(self) -> FloatArray:
        """Unit normals (n_panel, 3)."""
        return np.array([panel.normal_B for panel in self.panels], dtype=np.float64).reshape(-1, 3)

    @property
    def panel_gains(self) -> FloatArray:
        """Gains (n_panel)."""
        return np.array([panel.gain for panel in self.panels], dtype=np.float64)

    def response_in(self, phase: str | None = None) -> PanelResponse:
        """How the panels see light in a phase of the vehicle's timeline: by one law in all phases, as yet.

        The rest of the package asks nothing but this about it; the answer is kept and shared.
        """
        normals, gains = map(tuple, self.panel_normals_B.tolist()), tuple(self.panel_gains.tolist())
        return response_of(self.panel_response.law, self.panel_names, tuple(normals), gains)

    def require_inertia(self) -> FloatArray:
        """The inertia tensor (3, 3) in kg m2, or a `VehicleError` that says where to add it."""
        if self.inertia_kg_m2 is None:
            raise VehicleError(
                sentence(
                    f"vehicle {self.name!r} has no inertia and its motion cannot be computed",
                    do="add inertia_kg_m2 under [body] of its file",
                )
            )
        return self.inertia_kg_m2

    def require_mass(self) -> float:
        """The mass in kg, or a `VehicleError` that says where to add it."""
        if self.mass_kg is None:
            raise VehicleError(
                sentence(
                    f"vehicle {self.name!r} has no mass and an impact cannot be computed",
                    do="add mass_kg under [body] of its file",
                )
            )
        return self.mass_kg

    def require_noise(self) -> float:
        """One sigma of a panel reading, in the unit of the readings, or a `VehicleError` that says where to add it."""
        if self.telemetry.noise is None:
            what = f"vehicle {self.name!r} does not say how noisy its panel readings are"
            raise VehicleError(sentence(what, do="add noise under [telemetry] of its file"))
        return self.telemetry.noise

    def require_panels(self) -> tuple[Panel, ...]:
        """The panels, or a `VehicleError` that says where to add them."""
        if not self.panels:
            what = f"vehicle {self.name!r} has no solar panel"
            raise VehicleError(sentence(what, do="add a [[panel]] table for each to its file"))
        return self.panels

    def with_friction(self, name: str) -> Vehicle:
        """A copy in which each wheel uses its alternative friction called `name`."""
        wheels = []
        for wheel in self.wheels:
            if name not in wheel.alternative_frictions:
                known = ", ".join(sorted(wheel.alternative_frictions)) or "none"
                raise VehicleError(
                    sentence(f"wheel {wheel.name!r} has no friction called {name!r}", do=f"known alternatives: {known}")
                )
            wheels.append(replace(wheel, friction=wheel.alternative_frictions[name]))
        return replace(self, wheels=tuple(wheels))


def _require_distinct(names: list[str], key: str) -> None:
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise VehicleError(sentence(f"two {key} share the name {repeated[0]!r}", do="give each its own name"))


def _require_wheels_fit(vehicle: Vehicle) -> None:
    """The body that is left when every wheel turns freely must still have inertia about every axis."""
    tensor = np.array(vehicle.inertia_kg_m2)
    for wheel in vehicle.wheels:
        tensor = tensor - wheel.inertia_kg_m2 * np.outer(wheel.axis_B, wheel.axis_B)
    if vehicle.wheels and np.linalg.eigvalsh(tensor)[0] <= 0:
        raise VehicleError(
            sentence(
                "the wheels' axial inertia exceeds that of the whole vehicle, wheels included",
                got=", ".join(f"{wheel.name}: {wheel.inertia_kg_m2:g} kg m2" for wheel in vehicle.wheels),
                do="give inertia_kg_m2 of the whole vehicle with its wheels",
            )
        )


def _require_known_panels(vehicle: Vehicle) -> None:
    known = set(vehicle.panel_names)
    named = [("sun_rule.all_dark", name) for rule in vehicle.sun_rules for name in rule.all_dark]
    form = vehicle.telemetry
    named += [("panel_response", name) for name in vehicle.panel_response.panels]
    named += [("telemetry.columns", name) for name in form.columns]
    named += [("telemetry.offset_s", name) for name in form.offset_s]
    named += [("telemetry.voltage_columns", name) for name in form.voltage_columns]
    named += [(f"hull part {part.name!r}", part.panel) for part in vehicle.hull if part.panel is not None]
    for key, name in named:
        if name not in known:
            raise VehicleError(
                sentence(f"{key} names a panel that the vehicle does not have", got=name, do=f"panels: {sorted(known)}")
            )
    without = [name for name in vehicle.panel_names if name not in form.voltage_columns]
    if form.voltage_columns and form.voltage_column is None and without:
        what, do = "a panel has no voltage and others have", "add it, or voltage_column for all that have none of their own"
        raise VehicleError(sentence(what, got=without[0], do=do, where="telemetry.voltage_columns"))
