"""The vehicle: what the spacecraft is, as frozen data that every other module reads.

Frame B: the vehicle's own body axes, in which every vector below is given. SI units. A vehicle is read from a TOML file by
:func:`load_vehicle` (:mod:`sunspin.vehicle.file` knows the file's form) or built in Python from the classes here; both
ways pass the same physical checks.
"""

from __future__ import annotations

from sunspin.vehicle.changes import Changes
from sunspin.vehicle.craft import LIMITS, TelemetryForm, Vehicle
from sunspin.vehicle.part import FloatArray, direction, frozen_array
from sunspin.vehicle.parts import (
    Antenna,
    Channel,
    Fact,
    Friction,
    HullPart,
    Leg,
    Panel,
    SpinDown,
    SunRule,
    Wheel,
)

__all__ = [
    "LIMITS",
    "Antenna",
    "Channel",
    "Fact",
    "FloatArray",
    "Friction",
    "HullPart",
    "Leg",
    "Panel",
    "SpinDown",
    "SunRule",
    "TelemetryForm",
    "Vehicle",
    "Wheel",
    "direction",
    "frozen_array",
    "load_vehicle",
]


def load_vehicle(source: object, changes: Changes = None) -> Vehicle:
    """Read a vehicle.

    Parameters
    ----------
    source : str or path
        The name of a built-in case (``"philae"``, ``"skcube"``) or the path of a ``vehicle.toml``.
    changes : dict or list of str, optional
        Values that take the place of those in the file, by their keys in it: ``{"wheel.speed_rad_s": 833,
        "body.inertia_kg_m2[2][2]": "*=0.9", "wheel.friction": "printed"}``, or ``["wheel.speed_rad_s=833"]``. Parts of a list go
        by their names (``panel[+X].gain``) or places; an element beside the diagonal of an inertia sets its mirror. The file's
        ranges hold, and results say what was changed.

    Raises
    ------
    VehicleError
        With the file, the key, what was found there and what to do.
    InputError
        A change of what the file does not have.
    """
    from sunspin.vehicle.file import read_vehicle

    return read_vehicle(source, changes)
