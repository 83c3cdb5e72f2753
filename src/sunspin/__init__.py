"""sunspin: how a spacecraft tumbles, told by the power of its solar panels.

Public names are loaded on first use, so that ``import sunspin`` and ``sunspin --help`` stay fast.
"""

from __future__ import annotations

from importlib import import_module, metadata

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
    "rates": "sunspin.infer.rates",
    "propagate": "sunspin.motion.propagate",
    "impact": "sunspin.motion.impact",
    "fit_spin_down": "sunspin.motion.friction",
    "direction_error": "sunspin.infer.metrics",
    "emd": "sunspin.infer.metrics",
    "scan": "sunspin.infer.scan",
    "ensemble": "sunspin.infer.ensemble",
    "fit_lines": "sunspin.infer.lines",
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


def __getattr__(name: str):
    if name == "__version__":
        return metadata.version("sunspin")
    if name not in _HOME:
        raise AttributeError(f"module 'sunspin' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
