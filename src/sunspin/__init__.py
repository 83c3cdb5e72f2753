"""sunspin: how a spacecraft tumbles, told by the power of its solar panels.

Public names are loaded on first use, so that ``import sunspin`` and ``sunspin --help`` stay fast.
"""

from __future__ import annotations

from importlib import import_module, metadata
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # what type checkers and editors see; test_house_rules.py compares it with the names below
    from sunspin.cases import Case as Case, load_case as load_case
    from sunspin.errors import (
        InputError as InputError,
        Interrupted as Interrupted,
        MotionError as MotionError,
        OutputError as OutputError,
        SunspinError as SunspinError,
        TelemetryError as TelemetryError,
        VehicleError as VehicleError,
    )
    from sunspin.infer.ensemble import ensemble as ensemble
    from sunspin.infer.lines import fit_lines as fit_lines
    from sunspin.infer.metrics import direction_error as direction_error, emd as emd
    from sunspin.infer.posterior.estimate import posterior as posterior
    from sunspin.infer.rates.estimate import rates as rates
    from sunspin.infer.scan import near_minimum as near_minimum, scan as scan
    from sunspin.measure.health import panel_health as panel_health
    from sunspin.measure.panels import panel_power as panel_power
    from sunspin.measure.quality import panel_quality as panel_quality
    from sunspin.measure.sun import SunStatus as SunStatus, sun_directions as sun_directions
    from sunspin.measure.telemetry import read_telemetry as read_telemetry
    from sunspin.motion.friction import fit_spin_down as fit_spin_down
    from sunspin.motion.impact import impact as impact
    from sunspin.motion.propagate import propagate as propagate
    from sunspin.study.outcomes import outcomes as outcomes
    from sunspin.study.scenario import Scenario as Scenario
    from sunspin.study.twin import twin as twin
    from sunspin.tell.reproduction import reproduce as reproduce
    from sunspin.tell.worth import worth as worth
    from sunspin.vehicle import (
        Antenna as Antenna,
        Friction as Friction,
        HullPart as HullPart,
        Leg as Leg,
        Panel as Panel,
        Vehicle as Vehicle,
        Wheel as Wheel,
        load_vehicle as load_vehicle,
    )

    __version__: str

_HOME = {
    "Case": "sunspin.cases",
    "load_case": "sunspin.cases",
    "Vehicle": "sunspin.vehicle",
    "Panel": "sunspin.vehicle",
    "Wheel": "sunspin.vehicle",
    "Friction": "sunspin.vehicle",
    "Leg": "sunspin.vehicle",
    "HullPart": "sunspin.vehicle",
    "Antenna": "sunspin.vehicle",
    "load_vehicle": "sunspin.vehicle",
    "read_telemetry": "sunspin.measure.telemetry",
    "panel_power": "sunspin.measure.panels",
    "sun_directions": "sunspin.measure.sun",
    "SunStatus": "sunspin.measure.sun",
    "panel_health": "sunspin.measure.health",
    "panel_quality": "sunspin.measure.quality",
    "rates": "sunspin.infer.rates.estimate",
    "propagate": "sunspin.motion.propagate",
    "impact": "sunspin.motion.impact",
    "fit_spin_down": "sunspin.motion.friction",
    "direction_error": "sunspin.infer.metrics",
    "emd": "sunspin.infer.metrics",
    "scan": "sunspin.infer.scan",
    "near_minimum": "sunspin.infer.scan",
    "ensemble": "sunspin.infer.ensemble",
    "fit_lines": "sunspin.infer.lines",
    "posterior": "sunspin.infer.posterior.estimate",
    "twin": "sunspin.study.twin",
    "outcomes": "sunspin.study.outcomes",
    "Scenario": "sunspin.study.scenario",
    "reproduce": "sunspin.tell.reproduction",
    "worth": "sunspin.tell.worth",
    "SunspinError": "sunspin.errors",
    "VehicleError": "sunspin.errors",
    "TelemetryError": "sunspin.errors",
    "MotionError": "sunspin.errors",
    "InputError": "sunspin.errors",
    "OutputError": "sunspin.errors",
    "Interrupted": "sunspin.errors",
}

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return metadata.version("sunspin")
    if name not in _HOME:
        raise AttributeError(f"module 'sunspin' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
