"""The vehicle: a description of the spacecraft as frozen data, used by all other packages.

Vectors are in the vehicle's body axes B, values in SI units. A vehicle is read from a TOML file by :func:`load_vehicle`
(:mod:`sunspin.vehicle.file` defines the file's keys) or built in Python from the classes here, with the same physical checks.
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
        Values that replace those in the file, by their keys: ``{"wheel.speed_rad_s": 833, "body.inertia_kg_m2[2][2]": "*=0.9",
        "wheel.friction": "printed"}``, or ``["wheel.speed_rad_s=833"]``. Parts of a list are given by name (``panel[+X].gain``)
        or index. An off-diagonal element of an inertia tensor also sets its mirrored element. The file's ranges hold, and
        results list the changes.

    Raises
    ------
    VehicleError
        With the file, the key, the offending value and the advice.
    InputError
        For a change of something that the file does not have.
    """
    from sunspin.vehicle.file import read_vehicle

    return read_vehicle(source, changes)
