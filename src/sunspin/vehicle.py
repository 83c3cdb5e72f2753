"""The vehicle: what the spacecraft is, as frozen data that every other module reads.

Frame B: the vehicle's own body axes, in which every vector below is given. SI units. A vehicle is read from a TOML file by
:func:`load_vehicle` (:mod:`sunspin.vehicle_file` knows the file's form) or built in Python from the classes here; both
ways pass the same physical checks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from sunspin.errors import VehicleError, sentence
from sunspin.notebook import vehicle_html
from sunspin.vehicle_portable import Portable
from sunspin.vehicle_sensors import Sensors

FloatArray = npt.NDArray[np.float64]

MAX_PANELS = 32
"""Each cuts the sphere of directions further, n of them into n (n - 1) + 2 cells; satellites have about ten sides."""

MAX_WHEELS = 8
"""The kernels keep numbers for every set of wheels that turn freely."""

MAX_PARTS = 1000
"""Legs, parts of the hull, rules."""

UNIT_TOLERANCE = 1e-3
"""Vectors within this of length one count as directions written with few digits and are normalised."""

LIMITS = {"panels": MAX_PANELS, "wheels": MAX_WHEELS, "legs": MAX_PARTS, "hull": MAX_PARTS, "sun_rules": MAX_PARTS}

SYMMETRY_TOLERANCE = 1e-9
"""Largest relative difference between mirrored elements of an inertia tensor."""


def frozen_array(value: npt.ArrayLike) -> FloatArray:
    """Return a read-only float64 copy of ``value``."""
    array = np.array(value, dtype=np.float64)
    array.setflags(write=False)
    return array


def direction(value: npt.ArrayLike, key: str) -> FloatArray:
    """Return ``value`` (3) as a read-only unit vector, or raise `VehicleError` if it is not one to three digits."""
    vector = np.array(value, dtype=np.float64)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise VehicleError(sentence(f"{key} must be three finite numbers", got=value))
    length = float(np.linalg.norm(vector))
    if abs(length - 1.0) > UNIT_TOLERANCE:
        raise VehicleError(
            sentence(
                f"{key} must be a unit vector, its length is {length:.6g}",
                got=np.array2string(vector, separator=", "),
                do="divide it by its length or correct its components",
            )
        )
    return frozen_array(vector / length)


@dataclass(frozen=True)
class Fact:
    """A number's birth certificate: its value, one-sigma uncertainty (same unit as the value) and source."""

    value: float | tuple
    sigma: float | tuple | None = None
    source: str | None = None


@dataclass(frozen=True)
class Panel(Portable):
    """A flat solar panel: outward unit normal in B and its gain, the signal at normal incidence of the Sun.

    The gain is relative (a cell count will do) unless the vehicle's `gain_unit` is "W" or "A".
    """

    name: str
    normal_B: FloatArray
    gain: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "normal_B", direction(self.normal_B, f"normal_B of panel {self.name!r}"))
        if not (np.isfinite(self.gain) and self.gain > 0):
            raise VehicleError(sentence(f"the gain of panel {self.name!r} must be positive", got=self.gain))


@dataclass(frozen=True)
class Friction:
    """Bearing friction, torque on the wheel ``-sign(W) (coulomb + viscous |W|)`` (paper, eq. 5)."""

    coulomb_N_m: float = 0.0
    viscous_N_m_s: float = 0.0

    def __post_init__(self) -> None:
        for key in ("coulomb_N_m", "viscous_N_m_s"):
            value = getattr(self, key)
            if not (np.isfinite(value) and value >= 0):
                raise VehicleError(sentence(f"friction {key} must be zero or positive", got=value))

    @classmethod
    def from_spin_down(cls, c1_rad_s: float, c2_per_s: float, c3_rad_s: float, inertia_kg_m2: float) -> Friction:
        """Friction of a wheel whose measured spin-down follows ``c1 exp(c2 t) + c3`` (paper, section 2.2).

        That curve obeys dW/dt = c2 W - c2 c3, hence coulomb = c2 c3 J and viscous = -c2 J. `c1` only fixes the time at
        which the record begins.
        """
        if c2_per_s >= 0 or c3_rad_s > 0:
            raise VehicleError(
                sentence(
                    "a spin-down c1 exp(c2 t) + c3 needs c2 < 0 and c3 <= 0 to be friction",
                    got=f"c1 = {c1_rad_s}, c2 = {c2_per_s}, c3 = {c3_rad_s}",
                )
            )
        return cls(c2_per_s * c3_rad_s * inertia_kg_m2, -c2_per_s * inertia_kg_m2)


@dataclass(frozen=True)
class Wheel(Portable):
    """A wheel: axis (unit, B), axial inertia J, nominal speed relative to the body, friction, brake; its speed's column if any."""

    name: str
    axis_B: FloatArray
    inertia_kg_m2: float
    speed_rad_s: float = 0.0
    friction: Friction = Friction()
    alternative_frictions: Mapping[str, Friction] = field(default_factory=dict)
    brake_torque_N_m: float | None = None
    speed_column: str | None = None
    speed_scale_rad_s: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "axis_B", direction(self.axis_B, f"axis_B of wheel {self.name!r}"))
        object.__setattr__(self, "alternative_frictions", MappingProxyType(dict(self.alternative_frictions)))
        if not (np.isfinite(self.inertia_kg_m2) and self.inertia_kg_m2 > 0):
            raise VehicleError(
                sentence(f"inertia_kg_m2 of wheel {self.name!r} must be positive", got=self.inertia_kg_m2)
            )
        if self.brake_torque_N_m is not None and not (
            np.isfinite(self.brake_torque_N_m) and self.brake_torque_N_m > 0
        ):
            raise VehicleError(
                sentence(f"brake_torque_N_m of wheel {self.name!r} must be positive", got=self.brake_torque_N_m)
            )


@dataclass(frozen=True)
class Leg(Portable):
    """A leg: its end, where it can touch the ground, from the vehicle's centre of mass in B (m)."""

    name: str
    tip_B_m: FloatArray

    def __post_init__(self) -> None:
        tip = np.array(self.tip_B_m, dtype=np.float64)
        if tip.shape != (3,) or not np.all(np.isfinite(tip)):
            raise VehicleError(sentence(f"tip_B_m of leg {self.name!r} must be three finite numbers", got=self.tip_B_m))
        object.__setattr__(self, "tip_B_m", frozen_array(tip))


@dataclass(frozen=True)
class HullPart(Portable):
    """A part of the outer shape that can touch the ground: points (n, 3) in m from the centre of mass, B.

    The convex hull of all parts and of the legs' ends is the shape. `panel` names the panel whose corners the points are.
    """

    name: str
    points_B_m: FloatArray
    panel: str | None = None

    def __post_init__(self) -> None:
        points = np.array(self.points_B_m, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0 or not np.all(np.isfinite(points)):
            raise VehicleError(
                sentence(f"points_B_m of hull part {self.name!r} must be points of three finite numbers", got=self.points_B_m)
            )
        object.__setattr__(self, "points_B_m", frozen_array(points))


@dataclass(frozen=True)
class Antenna(Portable):
    """An antenna that serves directions within half of `opening_rad` of its axis (unit, B)."""

    axis_B: FloatArray
    opening_rad: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "axis_B", direction(self.axis_B, "antenna.axis_B"))
        if not (np.isfinite(self.opening_rad) and 0 < self.opening_rad <= 2 * np.pi):
            raise VehicleError(
                sentence("antenna.opening_rad must be an angle above 0 and at most 2 pi", got=self.opening_rad)
            )


@dataclass(frozen=True)
class SunRule:
    """A rule that forbids a reconstruction: it applies when all named panels are dark (`reason` says why)."""

    all_dark: tuple[str, ...]
    reason: str


@dataclass(frozen=True)
class TelemetryForm(Portable):
    """How the telemetry of this vehicle is written: columns, units, clock, noise. See the file `sunspin init` writes.

    A value is `scale` (reading - `zero`), the reading less `wraps_at` where at least half of that, over 1 +
    `temperature_coefficient_per_K` (T - `reference_temperature_C`), T being `temperature_scale` times its temperature column.
    """

    quantity: str = "power_W"
    time_column: str = "time"
    time_format: str = "utc"
    epoch_utc: str | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    scale: float = 1.0
    noise: float | None = None
    lit_threshold: float | None = None
    bad_rows: str = "refuse"
    time_scale_s: float = 1.0
    zero: float = 0.0
    wraps_at: float | None = None
    temperature_columns: Mapping[str, str] = field(default_factory=dict)
    temperature_scale: float = 1.0
    temperature_coefficient_per_K: float = 0.0
    reference_temperature_C: float = 25.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", MappingProxyType(dict(self.columns)))
        object.__setattr__(self, "temperature_columns", MappingProxyType(dict(self.temperature_columns)))


@dataclass(frozen=True)
class Vehicle(Portable):
    """A rigid spacecraft with any number of panels, wheels and legs.

    `inertia_kg_m2` (3, 3) is the tensor of the whole vehicle, wheels included, about the joint centre of mass, off-diagonal
    entries being tensor elements (minus the products of inertia). Mass and inertia may be unknown (None): then what needs
    them says so.
    """

    name: str
    inertia_kg_m2: FloatArray | None = None
    mass_kg: float | None = None
    panels: tuple[Panel, ...] = ()
    wheels: tuple[Wheel, ...] = ()
    legs: tuple[Leg, ...] = ()
    hull: tuple[HullPart, ...] = ()
    antenna: Antenna | None = None
    sun_rules: tuple[SunRule, ...] = ()
    gain_unit: str | None = None
    telemetry: TelemetryForm = TelemetryForm()
    sensors: Sensors = Sensors()
    facts: Mapping[str, Fact] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for key in ("panels", "wheels", "legs", "hull", "sun_rules"):
            object.__setattr__(self, key, tuple(getattr(self, key)))
        object.__setattr__(self, "facts", MappingProxyType(dict(self.facts)))
        for key, most in LIMITS.items():
            if len(getattr(self, key)) > most:
                raise VehicleError(sentence(f"a vehicle has at most {most} {key}", got=len(getattr(self, key))))
        for key in ("panels", "wheels", "legs", "hull"):
            _require_distinct([part.name for part in getattr(self, key)], key)
        if self.mass_kg is not None and not (np.isfinite(self.mass_kg) and self.mass_kg > 0):
            raise VehicleError(sentence("mass_kg must be positive", got=self.mass_kg))
        if self.inertia_kg_m2 is not None:
            object.__setattr__(self, "inertia_kg_m2", _physical_inertia(self.inertia_kg_m2))
            _require_wheels_fit(self)
        _require_known_panels(self)

    _repr_html_ = vehicle_html

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


def _physical_inertia(value: npt.ArrayLike) -> FloatArray:
    """Check that ``value`` is the inertia tensor of some distribution of mass."""
    key = "inertia_kg_m2"
    tensor = np.array(value, dtype=np.float64)
    if tensor.shape != (3, 3) or not np.all(np.isfinite(tensor)):
        raise VehicleError(sentence(f"{key} must be three rows of three finite numbers", got=np.asarray(value).tolist()))
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
    named += [("telemetry.columns", name) for name in vehicle.telemetry.columns]
    named += [(f"hull part {part.name!r}", part.panel) for part in vehicle.hull if part.panel is not None]
    for key, name in named:
        if name not in known:
            raise VehicleError(
                sentence(f"{key} names a panel that the vehicle does not have", got=name, do=f"panels: {sorted(known)}")
            )


def load_vehicle(source: object) -> Vehicle:
    """Read a vehicle.

    Parameters
    ----------
    source : str or path
        The name of a built-in case (``"philae"``, ``"skcube"``) or the path of a ``vehicle.toml``.

    Raises
    ------
    VehicleError
        With the file, the key, what was found there and what to do.
    """
    from sunspin.vehicle_file import read_vehicle

    return read_vehicle(source)
