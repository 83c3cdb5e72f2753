"""Which estimation package is judged: the one place that says it.

Campaigns take what they judge from here. A process judges one package; its workers are told which when they start.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

ROOMS = {"estimation": "sunspin.estimation.rates"}
"""Packages that can be judged -> the module of each that has the function `rates`."""

ORBIT = {
    "estimation": {
        "check_orbit": "sunspin.estimation.orbit.check",
        "orbit_of": "sunspin.estimation.orbit.judged",
        "calibrate_sensors": "sunspin.estimation.calibrate",
    },
}
"""Packages that can be judged -> functions of orbits and sensors -> their modules."""

OF_COMMANDS = "estimation"
"""The package that the commands use."""

_judged = [OF_COMMANDS]
"""The package that this process judges."""


def judge_room(room: str) -> None:
    """Judge this package from now on in this process."""
    if room not in ROOMS:
        raise ValueError(f"no such package: {room}; one of {', '.join(ROOMS)}")
    _judged[0] = room


def room() -> str:
    """Return the package that this process judges."""
    return _judged[0]


def rates(*arguments: Any, **options: Any) -> Any:
    """Estimate rates with the package that is judged."""
    run: Callable[..., Any] = import_module(ROOMS[room()]).rates
    return run(*arguments, **options)


def check_orbit(*arguments: Any, **options: Any) -> Any:
    """Check an orbit against telemetry with the package that is judged."""
    return _of_orbit("check_orbit")(*arguments, **options)


def orbit_of(*arguments: Any, **options: Any) -> Any:
    """Return the orbit of a telemetry file as the package that is judged makes it."""
    return _of_orbit("orbit_of")(*arguments, **options)


def calibrate_sensors(*arguments: Any, **options: Any) -> Any:
    """Calibrate sensors with the package that is judged."""
    return _of_orbit("calibrate_sensors")(*arguments, **options)


def _of_orbit(name: str) -> Callable[..., Any]:
    """Return a function of orbits and sensors of the package that is judged."""
    return getattr(import_module(ORBIT[room()][name]), name)
