"""Parameters of a vehicle that can be varied: elements of its inertia, friction and inertia of its wheels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np

from sunspin.base.errors import InputError
from sunspin.dynamics.bodies import Bodies
from sunspin.vehicle import Vehicle

INERTIA = {
    "theta_xx": (0, 0),
    "theta_yy": (1, 1),
    "theta_zz": (2, 2),
    "theta_xy": (0, 1),
    "theta_xz": (0, 2),
    "theta_yz": (1, 2),
}
"""Names of the elements of the inertia tensor that can be varied (kg m2)."""

FRICTION = {"mu_0": "coulomb_N_m", "mu_1": "viscous_N_m_s"}
"""Names of the friction of every wheel (N m, N m s) that can be varied, and the fields that hold it."""

WHEEL_PARAMETERS = (*FRICTION, "J")
"""Names of what can be varied of every wheel: friction, and axial inertia (kg m2)."""


def varied(vehicle: Vehicle, name: str, value: float) -> Vehicle:
    """A copy of the vehicle with one parameter replaced.

    Parameters
    ----------
    name : "theta_xx", "theta_xy", ..., "mu_0", "mu_1" or "J"
        Element of the inertia tensor (kg m2, its mirror with it), or friction (N m; N m s) or axial inertia of all wheels.
    """
    if name in INERTIA:
        tensor = np.array(vehicle.require_inertia())
        i, j = INERTIA[name]
        tensor[i, j] = tensor[j, i] = value
        return replace(vehicle, inertia_kg_m2=tensor)
    _check(vehicle, name)
    wheels = [
        replace(wheel, inertia_kg_m2=value)
        if name == "J"
        else replace(wheel, friction=replace(wheel.friction, **{FRICTION[name]: value}))
        for wheel in vehicle.wheels
    ]
    return replace(vehicle, wheels=tuple(wheels))


def nominal(vehicle: Vehicle, name: str) -> float:
    """The vehicle's own value of a parameter that `varied` can replace (of the first wheel, where it is a wheel's)."""
    if name in INERTIA:
        return float(vehicle.require_inertia()[INERTIA[name]])
    _check(vehicle, name)
    wheel = vehicle.wheels[0]
    return float(wheel.inertia_kg_m2 if name == "J" else getattr(wheel.friction, FRICTION[name]))


def _check(vehicle: Vehicle, name: str) -> None:
    """Refuse what is no parameter of a wheel of the vehicle."""
    if name not in WHEEL_PARAMETERS:
        known = ", ".join([*INERTIA, *WHEEL_PARAMETERS])
        raise InputError("there is no parameter of this name", got=name, do=f"known: {known}")
    if not vehicle.wheels:
        what = f"{name} belongs to a wheel, and {vehicle.name!r} has none"
        raise InputError(what, do="vary its inertia instead")


def variants(vehicle: Vehicle, parameters: Mapping[str, np.ndarray]) -> Bodies:
    """The vehicle's numbers (n) at every point of a grid of values of its parameters, in C order."""

    @cache  # a vehicle is checked when it is made, which takes milliseconds
    def body(*changes: tuple[str, float]) -> Bodies:
        craft = vehicle
        for name, value in changes:
            craft = varied(craft, name, float(value))
        return Bodies.of(craft)

    bodies = []
    for point in product(*parameters.values()):
        changes = list(zip(parameters, point, strict=True))
        # inertias must suit each other; friction is free of them
        rigid = body(*(change for change in changes if change[0] not in FRICTION))
        wheels = body(*(change for change in changes if change[0] in FRICTION))
        friction = {name: getattr(wheels, name) for name in FRICTION.values()}
        bodies.append(replace(rigid, **friction))
    return Bodies.stack(bodies)
