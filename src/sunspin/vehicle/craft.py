"""The class `Vehicle`: all parts of a spacecraft, and the checks that they form a possible body."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, PlainValidator, StrictBool, ValidationInfo

from sunspin.base.errors import VehicleError
from sunspin.solve.rotations import components_after_rotation
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
    as_tuples,
    checked_value,
    frozen_array,
    must,
    no_entries,
    part,
)
from sunspin.vehicle.parts import (
    Antenna,
    Channel,
    Fact,
    HullPart,
    Leg,
    Panel,
    ResponseForm,
    StatedOrbit,
    SunRule,
    Wheel,
)
from sunspin.vehicle.response.flat import PanelResponse
from sunspin.vehicle.response.joined import Input, JoinedResponse, full_sun
from sunspin.vehicle.sensors import Sensors
from sunspin.vehicle.timeline import parse_zone

MAX_PANELS = 32
"""n panels cut the sphere of directions into n (n - 1) + 2 cells; satellites have about ten sides."""

MAX_WHEELS = 8
"""The compiled kernels hold matrices for every subset of freely turning wheels."""

MAX_PARTS = 1000
"""Limit for legs, parts of the hull, and rules."""

CHANNEL_HINT = "; panels that share an input of the power system are one [[channel]]"
"""Advice in errors about two panels with one column."""

LIMITS = {
    "panels": MAX_PANELS,
    "wheels": MAX_WHEELS,
    "legs": MAX_PARTS,
    "hull": MAX_PARTS,
    "sun_rules": MAX_PARTS,
}
"""Largest number of parts of each kind."""

SYMMETRY_TOLERANCE = 1e-9
"""Largest relative difference between mirrored elements of an inertia tensor."""


Rollovers = Annotated[
    Number, must(lambda value: value in range(8), "{path} must be a whole number from 0 to 7")
]


DATED_FORMATS = ("utc", "gps", "tai", "tt")
"""Values of `time_format` whose times may be dates."""

LOCAL_FORMATS = ("utc", "excel", "datenum", "labview", "ticks")
"""Values of `time_format` whose times may be local: programs count days, seconds or ticks of the clock on the wall."""


@part
class TelemetryForm(Part):
    """Format of this vehicle's telemetry: columns, units, clock, noise. See the file that `sunspin init` writes.

    A value is `scale` (reading - `zero`) / (1 + `temperature_coefficient_per_K` (T - `reference_temperature_C`)). The
    temperature T is `temperature_scale` times its temperature column. Readings of at least half of `wraps_at` are first reduced
    by `wraps_at`. With voltages, columns of currents give powers: a value is multiplied by `voltage_scale` and the column in
    `voltage_columns`, or else in `voltage_column`.

    An input is sampled its entry of `offset_s` later than the time of its row, averaged over `averaged_s` about that instant.
    `receive_time_column`: the time at which a row was received, read in addition to its own time. `time_zone`: zone of times
    without one. `date_column`: dates, if the time column has times of day. `day_first`: order of day and month in dates such as
    31/01/2026; default: as the dates of the file show it. `fraction_column`: fractions of a second in units of `fraction_unit_s`,
    if the time column has whole seconds. `week_column`: GPS weeks; the time column then has seconds of the week,
    and the week number has overflowed `gps_rollovers` times. `counts_leap_seconds`: whether elapsed times include leap seconds.
    `throttled`: if the battery is full, all readings of a sample are reduced by one unknown factor. `sample_span_s`: rows within so
    many seconds, each with some of the columns, are one sample.

    `quantity` "elevation_deg", "incidence_deg" or "cosine": a column has the elevation of the Sun above the plane of the panel,
    its angle from the normal, or the cosine of that angle. The reader makes of it the reading of a flat panel, gain times
    cosine, and zero below zero; `noise` is in deg, or of the cosine.
    """

    quantity: Literal["power_W", "current_A", "elevation_deg", "incidence_deg", "cosine"] = (
        "power_W"
    )
    time_column: Name = "time"
    time_format: Literal[
        "utc",
        "unix",
        "gps",
        "tai",
        "tt",
        "elapsed",
        "jd",
        "mjd",
        "excel",
        "datenum",
        "labview",
        "ntp",
        "filetime",
        "ticks",
    ] = "utc"
    epoch_utc: str | None = None
    columns: Text = field(default_factory=no_entries)
    scale: Positive = 1.0
    noise: Positive | None = None
    lit_threshold: Positive | None = None
    bad_rows: Literal["refuse", "flag", "sort"] = "refuse"
    time_scale_s: Positive = 1.0
    time_zone: Name | None = None
    date_column: Name | None = None
    day_first: StrictBool | None = None
    week_column: Name | None = None
    gps_rollovers: Rollovers | None = None
    counts_leap_seconds: StrictBool | None = None
    receive_time_column: Name | None = None
    receive_time_format: Literal["utc", "unix"] = "utc"
    offset_s: Numbers = field(default_factory=no_entries)
    averaged_s: Annotated[Number, must(lambda value: value >= 0, "{path} must not be negative")] = (
        0.0
    )
    zero: Number = 0.0
    wraps_at: Positive | None = None
    voltage_column: Name | None = None
    voltage_columns: Text = field(default_factory=no_entries)
    voltage_scale: Positive = 1.0
    temperature_columns: Text = field(default_factory=no_entries)
    temperature_scale: Positive = 1.0
    temperature_coefficient_per_K: Number = 0.0
    reference_temperature_C: Number = 25.0
    throttled: StrictBool = False
    sample_span_s: Positive | None = None
    fraction_column: Name | None = None
    fraction_unit_s: Positive = 0.001

    def __post_init__(self) -> None:
        time_columns = (
            self.time_column,
            self.date_column,
            self.week_column,
            self.fraction_column,
            self.receive_time_column,
        )
        columns = [
            *(name for name in time_columns if name is not None),
            *self.columns.values(),
        ]
        if repeated := [name for name in columns if columns.count(name) > 1]:
            what = "telemetry names one column for the time and a panel, or for two panels"
            raise VehicleError(what, got=repeated[0], do=f"give each panel its own{CHANNEL_HINT}")
        if self.has_angles:
            self._require_plain_angles()
        if self.has_voltages and self.quantity != "power_W":
            what = f"telemetry has voltages, with which currents become powers, but telemetry.quantity is {self.quantity}"
            raise VehicleError(what, do='set quantity = "power_W", or leave the voltages out')
        if (
            self.time_format == "elapsed"
            and self.epoch_utc is None
            and self.receive_time_column is None
        ):
            what = "telemetry.time_format is elapsed but telemetry.epoch_utc is missing"
            raise VehicleError(what, do="add the UTC of time zero, or receive_time_column")
        required_format = {
            "time_zone": LOCAL_FORMATS,
            "week_column": ("gps",),
            "gps_rollovers": ("gps",),
            "counts_leap_seconds": ("elapsed",),
        }
        for key, needed in required_format.items():
            if getattr(self, key) is not None and self.time_format not in needed:
                what = f'telemetry.{key} needs time_format = "{needed[0]}"'
                raise VehicleError(what, got=self.time_format, do="set it, or leave the key out")
        if self.date_column is not None and self.time_format not in DATED_FORMATS:
            what = "telemetry.date_column needs times of day in the time column"
            do = 'set time_format = "utc", or leave the key out'
            raise VehicleError(what, got=self.time_format, do=do)
        if self.counts_leap_seconds is not None and self.epoch_utc is None:
            what = "telemetry.counts_leap_seconds needs epoch_utc"
            raise VehicleError(what, do="add the UTC of time zero, or leave the key out")
        if self.time_zone is not None:
            parse_zone(self.time_zone)

    @property
    def has_angles(self) -> bool:
        """True if the columns are angles of the Sun, which the reader turns into readings of flat panels."""
        return self.quantity in ("elevation_deg", "incidence_deg", "cosine")

    @property
    def variable(self) -> str:
        """Name of the variable with the readings in a telemetry Dataset."""
        return "power_W" if self.has_angles else self.quantity

    @property
    def noise_per_gain(self) -> float:
        """Factor from the noise in the file, times the gain, to that of the readings: rad per deg for angles in deg, else 1."""
        in_deg = self.quantity in ("elevation_deg", "incidence_deg")
        return float(np.radians(1.0)) if in_deg else 1.0

    def _require_plain_angles(self) -> None:
        """Raise `VehicleError` for keys that belong to electrical readings."""
        electrical = {
            "voltage_column": self.voltage_column is not None,
            "voltage_columns": bool(self.voltage_columns),
            "temperature_columns": bool(self.temperature_columns),
            "lit_threshold": self.lit_threshold is not None,
            "throttled": self.throttled,
        }
        if wrong := [key for key, given in electrical.items() if given]:
            what = f"telemetry.{wrong[0]} is for powers and currents, but telemetry.quantity is {self.quantity}"
            raise VehicleError(what, do="leave it out")

    @property
    def has_voltages(self) -> bool:
        """True if the columns are currents that voltages convert to powers."""
        return self.voltage_column is not None or bool(self.voltage_columns)


def _require_symmetric(name: str, tensor: np.ndarray) -> None:
    """Raise `VehicleError` if a tensor (3, 3) is not symmetric; `name` says in the message what it is."""
    asymmetry = np.abs(tensor - tensor.T)
    if asymmetry.max() > SYMMETRY_TOLERANCE * np.abs(tensor).max():
        i, j = np.unravel_index(np.argmax(asymmetry), (3, 3))
        elements = f"element [{i}][{j}] is {tensor[i, j]:g} and [{j}][{i}] is {tensor[j, i]:g}"
        raise VehicleError(f"{name} must be symmetric, but {elements}", do="make them equal")


def _physical_inertia(raw: Any, info: ValidationInfo) -> FloatArray:
    """Return a checked inertia tensor (3, 3), made exactly symmetric; raise `VehicleError` if no distribution of mass can have it.

    A file may give `raw` as {value, sigma, source}. Its sigma is not returned, but must be symmetric if it is a tensor.
    """
    key = "inertia_kg_m2"
    given = checked_value(raw, info)
    tensor = as_array(given)
    if tensor.shape != (3, 3) or not np.all(np.isfinite(tensor)):
        got = given.tolist() if isinstance(given, np.ndarray) else given
        raise VehicleError(f"{key} must be three rows of three finite numbers", got=got)
    _require_symmetric(key, tensor)
    sigma = as_array(raw.get("sigma", 0.0)) if isinstance(raw, Mapping) else np.zeros(())
    if sigma.ndim == 2:
        _require_symmetric(f"the sigma of {key}", sigma)
    tensor = (tensor + tensor.T) / 2
    moments = np.linalg.eigvalsh(tensor)  # principal moments, increasing
    moments_text = ", ".join(f"{moment:.6g}" for moment in moments)
    if moments[0] <= 0:
        raise VehicleError(
            f"{key} must be positive definite, its principal moments are {moments_text}",
            do="check signs and units",
        )
    # triangle inequality of the principal moments: I3 <= I1 + I2
    if moments[2] > (moments[0] + moments[1]) * (1 + SYMMETRY_TOLERANCE):
        raise VehicleError(
            f"{key} is not that of any body: principal moments {moments_text} break the rule that the largest is at "
            "most the sum of the other two",
            do="check the tensor (a products-of-inertia sign or a unit may be wrong)",
        )
    return frozen_array(tensor)


Mass = Annotated[Number, must(above_zero, "mass_kg must be positive")]
Inertia = Annotated[FloatArray, PlainValidator(_physical_inertia)]
Facts = Annotated[Mapping[str, Fact], AfterValidator(lambda facts: MappingProxyType(dict(facts)))]


@part
class Vehicle(Part):
    """A rigid spacecraft with any number of panels, wheels and legs.

    The telemetry reads *inputs*: each of the `channels`, and each panel that is in none of them.

    `inertia_kg_m2` (3, 3) is the tensor of the whole vehicle, wheels included, about the common centre of mass. Its
    off-diagonal entries are tensor elements (minus the products of inertia). Mass and inertia may be None; functions that need
    them then raise an error. `changes` lists what was changed in the file for this run (:mod:`sunspin.vehicle.changes`).
    """

    name: Name
    inertia_kg_m2: Inertia | None = None
    mass_kg: Mass | None = None
    panels: tuple[Panel, ...] = ()
    wheels: tuple[Wheel, ...] = ()
    legs: tuple[Leg, ...] = ()
    hull: tuple[HullPart, ...] = ()
    antenna: Antenna | None = None
    orbit: StatedOrbit | None = None
    sun_rules: tuple[SunRule, ...] = ()
    gain_unit: str | None = None
    telemetry: TelemetryForm = TelemetryForm()
    sensors: Sensors = Sensors()
    panel_response: ResponseForm = ResponseForm()
    channels: tuple[Channel, ...] = ()
    facts: Facts = field(default_factory=no_entries)
    changes: tuple[Any, ...] = ()

    def __post_init__(self) -> None:
        for key, most in LIMITS.items():
            if len(getattr(self, key)) > most:
                raise VehicleError(
                    f"a vehicle has at most {most} {key}", got=len(getattr(self, key))
                )
        for key in ("panels", "wheels", "legs", "hull"):
            _require_distinct([part.name for part in getattr(self, key)], key)
        if self.inertia_kg_m2 is not None:
            _require_wheels_fit(self)
        _require_channels_fit(self)
        _require_known_panels(self)
        _require_data_of_all_inputs(self)

    _repr_html_ = vehicle_html

    @property
    def result_attributes(self) -> dict[str, str]:
        """Attributes of results about the vehicle: its name, and the changes made to its file, if any."""
        return {"vehicle": self.name} | (
            {"changes": "\n".join(map(str, self.changes))} if self.changes else {}
        )

    @property
    def panel_names(self) -> tuple[str, ...]:
        """Names of the panels, in the order of the file."""
        return tuple(panel.name for panel in self.panels)

    @property
    def panel_normals_B(self) -> FloatArray:
        """Unit normals (n_panel, 3) in B, including the common misalignment and the tilt of a single panel."""
        normals = np.array([panel.normal_B for panel in self.panels], dtype=np.float64).reshape(
            -1, 3
        )
        common, tilted = self.panel_response.turned_B_rad, self.panel_response.tilted
        # rotating a normal by +angle gives the components seen after the body has rotated by -angle
        if common is not None and common.any():
            normals = components_after_rotation(normals, -common)
        if tilted is not None:
            k = self.panel_names.index(tilted.panel)
            normals[k] = components_after_rotation(normals[k], -tilted.turn_B_rad)
        return normals

    @property
    def panel_gains(self) -> FloatArray:
        """Gains (n_panel)."""
        return np.array([panel.gain for panel in self.panels], dtype=np.float64)

    @property
    def inputs(self) -> tuple[Input, ...]:
        """Inputs of the telemetry, in the order of the panels; a channel has the place of its first panel."""
        names = self.panel_names
        channel_of = {name: channel for channel in self.channels for name in channel.panels}
        inputs: dict[str, Input] = {}
        for k, name in enumerate(names):
            channel = channel_of.get(name)
            if channel is None:
                inputs[name] = Input(name, (k,))
            elif channel.name not in inputs:  # else an earlier panel has added it
                panels = tuple(names.index(panel) for panel in channel.panels)
                inputs[channel.name] = Input(channel.name, panels, channel.reads == "largest")
        return tuple(inputs.values())

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return tuple(each.name for each in self.inputs)

    @property
    def input_gains(self) -> FloatArray:
        """Largest reading of each input (n_input): the gain of a panel, or the maximum of a channel over Sun directions."""
        if not self.channels:
            return self.panel_gains
        return np.array(
            [full_sun(each, self.panel_normals_B, self.panel_gains)[1] for each in self.inputs]
        )

    @property
    def input_noise(self) -> FloatArray | None:
        """Standard deviation of each input's readings (n_input) in the telemetry's unit; None if the file does not state it.

        For angles of the Sun it is that of the readings that are made of them. A noise of the angle is taken as that of the
        cosine: so it is for angles that were computed from currents, and near the normal it is too large for others.
        """
        own_noise = {each.name: each.noise for each in (*self.panels, *self.channels)}
        noise = [own_noise[name] or self.telemetry.noise for name in self.input_names]
        if None in noise:
            return None
        factor = (
            self.telemetry.noise_per_gain * self.input_gains if self.telemetry.has_angles else 1.0
        )
        return np.array(noise, dtype=np.float64) * factor

    @property
    def throttled(self) -> bool:
        """True if all readings of a sample may be reduced by one unknown factor (full battery)."""
        return self.telemetry.throttled or any(channel.throttled for channel in self.channels)

    def response_in(self) -> PanelResponse:
        """Return the response of the inputs to light. The object is cached and shared.

        All other packages use the panels through it.
        """
        return self._response(self.inputs if self.channels else ())

    def response_of_panels(self) -> PanelResponse:
        """Return the response of the single panels, also of those that share an input; used for drawings."""
        return self._response(())

    def _response(self, inputs: tuple[Input, ...]) -> PanelResponse:
        """Return the cached response for these inputs; without any, every panel is an input of its own."""
        return _build_response(as_tuples(self.panel_normals_B), as_tuples(self.panel_gains), inputs)

    def require_inertia(self) -> FloatArray:
        """Return the inertia tensor (3, 3) in kg m2; raise `VehicleError` if it is unknown."""
        if self.inertia_kg_m2 is None:
            raise VehicleError(
                f"vehicle {self.name!r} has no inertia and its motion cannot be computed",
                do="add inertia_kg_m2 under [body] of its file",
            )
        return self.inertia_kg_m2

    def require_mass(self) -> float:
        """Return the mass in kg; raise `VehicleError` if it is unknown."""
        if self.mass_kg is None:
            raise VehicleError(
                f"vehicle {self.name!r} has no mass and an impact cannot be computed",
                do="add mass_kg under [body] of its file",
            )
        return self.mass_kg

    def require_noise(self) -> float:
        """Return the median standard deviation of the readings; raise `VehicleError` if it is unknown."""
        noise = self.input_noise
        if noise is None:
            what = f"vehicle {self.name!r} does not say how noisy its panel readings are"
            raise VehicleError(what, do="add noise under [telemetry] of its file")
        return float(np.median(noise))

    def require_panels(self) -> tuple[Panel, ...]:
        """Return the panels; raise `VehicleError` if there are none."""
        if not self.panels:
            what = f"vehicle {self.name!r} has no solar panel"
            raise VehicleError(what, do="add a [[panel]] table for each to its file")
        return self.panels

    def with_friction(self, name: str) -> Vehicle:
        """Return a copy in which each wheel has its alternative friction `name`; raise `VehicleError` if one lacks it."""
        wheels = []
        for wheel in self.wheels:
            if name not in wheel.alternative_frictions:
                known = ", ".join(sorted(wheel.alternative_frictions)) or "none"
                raise VehicleError(
                    f"wheel {wheel.name!r} has no friction called {name!r}",
                    do=f"known alternatives: {known}",
                )
            wheels.append(replace(wheel, friction=wheel.alternative_frictions[name]))
        return replace(self, wheels=tuple(wheels))


@lru_cache(maxsize=64)
def _build_response(normals_B: tuple, gains: tuple, inputs: tuple[Input, ...]) -> PanelResponse:
    """Return a panel response from hashable data; vehicles with equal panels share one, with its cached geometry."""
    normals, gain = frozen_array(normals_B).reshape(-1, 3), frozen_array(gains)
    return JoinedResponse(normals, gain, inputs) if inputs else PanelResponse(normals, gain)


def _require_distinct(names: list[str], key: str) -> None:
    """Raise `VehicleError` if a name is repeated."""
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise VehicleError(f"two {key} share the name {repeated[0]!r}", do="give each its own name")


def _require_wheels_fit(vehicle: Vehicle) -> None:
    """Raise `VehicleError` if the body without the wheels' axial inertia has no inertia about some axis.

    The equations of motion invert this tensor when all wheels turn freely. The vehicle must have an inertia.
    """
    tensor = np.array(vehicle.inertia_kg_m2)
    for wheel in vehicle.wheels:
        tensor = tensor - wheel.inertia_kg_m2 * np.outer(wheel.axis_B, wheel.axis_B)
    if vehicle.wheels and np.linalg.eigvalsh(tensor)[0] <= 0:
        raise VehicleError(
            "the wheels' axial inertia exceeds that of the whole vehicle, wheels included",
            got=", ".join(
                f"{wheel.name}: {wheel.inertia_kg_m2:g} kg m2" for wheel in vehicle.wheels
            ),
            do="give inertia_kg_m2 of the whole vehicle with its wheels",
        )


def _require_channels_fit(vehicle: Vehicle) -> None:
    """Raise `VehicleError` for channels that contradict the panels or each other.

    Each panel is in at most one channel, each input has its own name, and `throttled` holds for all inputs or for none.
    """
    _require_distinct([channel.name for channel in vehicle.channels], "channels")
    in_channels = [name for channel in vehicle.channels for name in channel.panels]
    for channel in vehicle.channels:
        if unknown := [name for name in channel.panels if name not in vehicle.panel_names]:
            what = f"channel {channel.name!r} names a panel that the vehicle does not have"
            raise VehicleError(what, got=unknown[0], do=f"panels: {[*vehicle.panel_names]}")
        if repeated := [name for name in channel.panels if in_channels.count(name) > 1]:
            what = "a panel is in two channels"
            raise VehicleError(what, got=repeated[0], do="list it on the input that it is wired to")
        if channel.name in set(vehicle.panel_names) - set(in_channels):
            what = f"channel {channel.name!r} is called like a panel that is not in it"
            raise VehicleError(what, do="give the channel another name")
        members = [panel for panel in vehicle.panels if panel.name in channel.panels]
        if noisy := [panel.name for panel in members if panel.noise is not None]:
            what = f"channel {channel.name!r} reads a panel that states a noise of its own"
            raise VehicleError(what, got=noisy[0], do="state the noise of the channel instead")
    throttled = [channel.throttled for channel in vehicle.channels]
    all_throttled = vehicle.telemetry.throttled or (
        all(throttled) and set(in_channels) == set(vehicle.panel_names)
    )
    if any(throttled) and not all_throttled:
        what = "some inputs are throttled and others are not"
        do = "set throttled = true under [telemetry], which is of all inputs, or leave it out"
        raise VehicleError(what, do=do)


def _require_known_panels(vehicle: Vehicle) -> None:
    """Raise `VehicleError` if a table names a panel that does not exist, or a panel where the name of its channel belongs."""
    tilted = vehicle.panel_response.tilted
    # names that must be panels, and names that must be inputs, each with the key that has it
    panel_keys = [] if tilted is None else [("panel_response.tilted", tilted.panel)]
    panel_keys += [
        (f"hull part {part.name!r}", part.panel) for part in vehicle.hull if part.panel is not None
    ]
    input_keys = [
        ("sun_rule.all_dark", name) for rule in vehicle.sun_rules for name in rule.all_dark
    ]
    input_keys += [
        (f"telemetry.{key}", name)
        for key in ("columns", "offset_s", "voltage_columns", "temperature_columns")
        for name in getattr(vehicle.telemetry, key)
    ]
    for known, keys in ((vehicle.panel_names, panel_keys), (vehicle.input_names, input_keys)):
        for key, name in keys:
            if name in known:
                continue
            if name in vehicle.panel_names:
                channel = next(each.name for each in vehicle.channels if name in each.panels)
                what = f"{key} names a panel that is read through a channel"
                raise VehicleError(what, got=name, do=f"name the channel, {channel!r}")
            kind = "panels" if not vehicle.channels else "panels and channels"
            what = f"{key} names a panel that the vehicle does not have"
            raise VehicleError(what, got=name, do=f"{kind}: {sorted(known)}")


def _require_data_of_all_inputs(vehicle: Vehicle) -> None:
    """Raise `VehicleError` if some inputs have a voltage column or a noise and others have none, not even a common one."""
    form = vehicle.telemetry
    if form.has_angles and vehicle.channels:
        what = f"a channel reads powers or currents, but telemetry.quantity is {form.quantity}"
        raise VehicleError(what, got=vehicle.channels[0].name, do="leave out [[channel]]")
    without = [name for name in vehicle.input_names if name not in form.voltage_columns]
    if form.voltage_columns and form.voltage_column is None and without:
        what, where = "a panel has no voltage and others have", "telemetry.voltage_columns"
        do = "add it, or voltage_column for all that have none of their own"
        raise VehicleError(what, got=without[0], do=do, where=where)
    own_noise = {each.name: each.noise for each in (*vehicle.panels, *vehicle.channels)}
    without = [name for name in vehicle.input_names if own_noise[name] is None]
    if form.noise is None and 0 < len(without) < len(vehicle.input_names):
        do = "add it, or noise under [telemetry] for all that have none of their own"
        raise VehicleError("a panel states no noise and others do", got=without[0], do=do)
