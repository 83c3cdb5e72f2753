"""Which estimation package is judged: the one place that says it.

Campaigns take what they judge from here. A process judges one package; its workers are told which when they start.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

import numpy as np
import xarray as xr

from sunspin.vehicle import Vehicle

MODULES = {
    "rates": {"estimate": "sunspin.estimate.rates"},
    "check_orbit": {"estimate": "sunspin.estimate.orbit.check"},
    "orbit_of": {"estimate": "sunspin.estimate.orbit.judged"},
    "calibrate_sensors": {"estimate": "sunspin.estimate.calibrate"},
    "posterior": {"estimate": "sunspin.estimate.posterior"},
    "predict": {"estimate": "sunspin.estimate.lander.predict"},
}
"""Functions that are judged -> packages that have them, that of the commands first -> their modules."""

ROOMS = ("estimate",)
"""Packages that can be judged."""

OF_COMMANDS = "commands"
"""Judge for each function the package that the commands use."""

_judged = [OF_COMMANDS]
"""The package that this process judges."""


def judge_room(room: str) -> None:
    """Judge this package from now on in this process."""
    if room not in (*ROOMS, OF_COMMANDS):
        raise ValueError(f"no such package: {room}; one of {', '.join((*ROOMS, OF_COMMANDS))}")
    _judged[0] = room


def room() -> str:
    """Return the package that this process judges, or :data:`OF_COMMANDS`."""
    return _judged[0]


def rates(*arguments: Any, **options: Any) -> Any:
    """Estimate rates with the package that is judged."""
    return _of_room("rates")(*arguments, **options)


def check_orbit(*arguments: Any, **options: Any) -> Any:
    """Check an orbit against telemetry with the package that is judged."""
    return _of_room("check_orbit")(*arguments, **options)


def orbit_of(*arguments: Any, **options: Any) -> Any:
    """Return the orbit of a telemetry file as the package that is judged makes it."""
    return _of_room("orbit_of")(*arguments, **options)


def calibrate_sensors(*arguments: Any, **options: Any) -> Any:
    """Calibrate sensors with the package that is judged."""
    return _of_room("calibrate_sensors")(*arguments, **options)


def posterior(*arguments: Any, **options: Any) -> Any:
    """Sample a posterior with the package that is judged."""
    return _of_room("posterior")(*arguments, **options)


def predict(*arguments: Any, **options: Any) -> Any:
    """Predict the motion by the draws of a posterior with the package that is judged."""
    return _of_room("predict")(*arguments, **options)


def log_density(
    vehicle: Vehicle,
    telemetry: xr.Dataset,
    priors: Mapping[str, Any],
    omega_B: np.ndarray,
    sun_B: np.ndarray,
    values: Mapping[str, np.ndarray],
) -> np.ndarray:
    """Return the log posterior density (n) of motions under the nominal model of the package that is judged, up to a constant.

    Rates (rad/s) and directions (n, 3) are those at the first sample; `values`: of the unknowns (n), by name.
    """
    from sunspin.estimate.lander.motions import Shots
    from sunspin.estimate.lander.priors import with_priors
    from sunspin.estimate.lander.window import observe_window
    from sunspin.telemetry.assess import assess

    assessment = assess(vehicle, telemetry)
    model, _ = with_priors(assessment, observe_window(assessment), priors)
    shots = Shots(omega_B, sun_B, _in_sigmas(model.unknowns, values))
    return model.log_likelihood(shots, DIRECTION_ERROR) + model.log_prior_density(shots)


DIRECTION_ERROR = 1e-5
"""Error of directions (rad) in a density."""


def _in_sigmas(unknowns: Any, values: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the values (n) of unknowns as deviations (n, m) from their centres in sigmas."""
    columns = [(values[one.name] - one.centre) / one.sigma for one in unknowns]
    return np.stack(columns, axis=1)


def _room_of(name: str) -> str:
    """Return the package whose function of this name is judged."""
    rooms = MODULES[name]
    return next(iter(rooms)) if room() == OF_COMMANDS else room()


def _of_room(name: str) -> Callable[..., Any]:
    """Return a function of the package that is judged."""
    judged = _room_of(name)
    if judged not in MODULES[name]:
        raise ValueError(f"the package {judged} has no {name}")
    return getattr(import_module(MODULES[name][judged]), name)
