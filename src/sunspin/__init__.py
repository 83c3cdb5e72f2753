"""sunspin: estimates how a spacecraft tumbles from the power of its solar panels.

Public names are imported at their first use, so that ``import sunspin`` and ``sunspin --help`` stay fast. The accessor ``.sunspin``
of Datasets is registered as soon as xarray is imported, so Datasets opened from files have it too.
"""

from __future__ import annotations

import sys
from difflib import get_close_matches
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import TYPE_CHECKING, Any

# What type checkers and editors see. A test compares these names with those of _MODULES below.
if TYPE_CHECKING:
    from sunspin.cases import (
        Case as Case,
        load_case as load_case,
        load_example as load_example,
    )
    from sunspin.base.errors import (
        InputError as InputError,
        MotionError as MotionError,
        OutputError as OutputError,
        SunspinError as SunspinError,
        TelemetryError as TelemetryError,
        VehicleError as VehicleError,
    )
    from sunspin.estimate.scan.lines import fit_lines as fit_lines
    from sunspin.estimate.scan.metrics import direction_error as direction_error, emd as emd
    from sunspin.estimate.calibrate import calibrate_sensors as calibrate_sensors
    from sunspin.estimate.lander.predict import predict as predict
    from sunspin.estimate.periods import Period as Period
    from sunspin.estimate.posterior import posterior as posterior
    from sunspin.estimate.rates import rates as rates
    from sunspin.estimate.scan.near_minimum import near_minimum as near_minimum
    from sunspin.estimate.scan.volume import Propagation as Propagation, scan as scan
    from sunspin.telemetry.health import panel_health as panel_health
    from sunspin.vehicle.response.panels import panel_power as panel_power
    from sunspin.telemetry.assess import panel_quality as panel_quality
    from sunspin.telemetry.sun import SunStatus as SunStatus, sun_directions as sun_directions
    from sunspin.telemetry.reader import read_telemetry as read_telemetry
    from sunspin.dynamics.friction import fit_spin_down as fit_spin_down
    from sunspin.dynamics.impact import impact as impact
    from sunspin.dynamics.propagate import propagate as propagate
    from sunspin.landing.outcomes import outcomes as outcomes
    from sunspin.landing.scenario import Scenario as Scenario
    from sunspin.output.compare import compare as compare
    from sunspin.output.history import history as history
    from sunspin.output.pointing import pointing as pointing
    from sunspin.planning import plan as plan
    from sunspin.philae.simulation import twin as twin
    from sunspin.philae.reproduction import reproduce as reproduce
    from sunspin.vehicle import (
        Antenna as Antenna,
        Channel as Channel,
        Friction as Friction,
        HullPart as HullPart,
        Leg as Leg,
        Panel as Panel,
        Vehicle as Vehicle,
        Wheel as Wheel,
        load_vehicle as load_vehicle,
    )

    __version__: str

_MODULES = {
    "Case": "sunspin.cases",
    "load_case": "sunspin.cases",
    "load_example": "sunspin.cases",
    "Vehicle": "sunspin.vehicle",
    "Panel": "sunspin.vehicle",
    "Wheel": "sunspin.vehicle",
    "Friction": "sunspin.vehicle",
    "Leg": "sunspin.vehicle",
    "HullPart": "sunspin.vehicle",
    "Antenna": "sunspin.vehicle",
    "Channel": "sunspin.vehicle",
    "load_vehicle": "sunspin.vehicle",
    "read_telemetry": "sunspin.telemetry.reader",
    "panel_power": "sunspin.vehicle.response.panels",
    "sun_directions": "sunspin.telemetry.sun",
    "SunStatus": "sunspin.telemetry.sun",
    "panel_health": "sunspin.telemetry.health",
    "panel_quality": "sunspin.telemetry.assess",
    "calibrate_sensors": "sunspin.estimate.calibrate",
    "rates": "sunspin.estimate.rates",
    "Period": "sunspin.estimate.periods",
    "propagate": "sunspin.dynamics.propagate",
    "impact": "sunspin.dynamics.impact",
    "fit_spin_down": "sunspin.dynamics.friction",
    "direction_error": "sunspin.estimate.scan.metrics",
    "emd": "sunspin.estimate.scan.metrics",
    "scan": "sunspin.estimate.scan.volume",
    "Propagation": "sunspin.estimate.scan.volume",
    "near_minimum": "sunspin.estimate.scan.near_minimum",
    "fit_lines": "sunspin.estimate.scan.lines",
    "posterior": "sunspin.estimate.posterior",
    "predict": "sunspin.estimate.lander.predict",
    "twin": "sunspin.philae.simulation",
    "outcomes": "sunspin.landing.outcomes",
    "Scenario": "sunspin.landing.scenario",
    "compare": "sunspin.output.compare",
    "history": "sunspin.output.history",
    "pointing": "sunspin.output.pointing",
    "plan": "sunspin.planning",
    "reproduce": "sunspin.philae.reproduction",
    "SunspinError": "sunspin.base.errors",
    "VehicleError": "sunspin.base.errors",
    "TelemetryError": "sunspin.base.errors",
    "MotionError": "sunspin.base.errors",
    "InputError": "sunspin.base.errors",
    "OutputError": "sunspin.base.errors",
}
"""Public name -> module that defines it."""

__all__ = ["__version__", *_MODULES]


class _AfterXarray(MetaPathFinder):
    """A finder of xarray that imports the accessor as soon as xarray itself has been imported.

    The finder leaves the search to the others, and only extends the loader that they find.
    """

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        """Return the spec of xarray, whose loader also imports the accessor; None for other modules, or if there is no xarray.

        The import takes this finder off the list of finders, as it is needed only once.
        """
        if fullname != "xarray":
            return None
        other_finders = (finder for finder in sys.meta_path if finder is not self)
        specs = (finder.find_spec(fullname, path, target) for finder in other_finders)
        spec = next((spec for spec in specs if spec is not None), None)
        if spec is not None and spec.loader is not None:
            loader, execute_xarray = spec.loader, spec.loader.exec_module

            def execute_with_accessor(module: ModuleType) -> None:
                execute_xarray(module)
                if self in sys.meta_path:
                    sys.meta_path.remove(self)
                import_module(_ACCESSOR)

            # a loader serves a single import, so no other module is affected
            loader.exec_module = execute_with_accessor
        return spec


_ACCESSOR = "sunspin.output.result"
"""Module that registers the accessor; it imports nothing that draws."""

if "xarray" in sys.modules:
    import_module(_ACCESSOR)
else:
    sys.meta_path.insert(0, _AfterXarray())


def __getattr__(name: str) -> Any:
    """Return a public name, imported at its first use; raise `AttributeError` for any other name."""
    if name == "__version__":
        from importlib import metadata  # takes as long to import as the rest of the command line

        return metadata.version("sunspin")
    if name not in _MODULES:
        similar = get_close_matches(name, _MODULES, n=1)
        hint = f"; did you mean {similar[0]!r}?" if similar else ""
        raise AttributeError(f"module 'sunspin' has no attribute {name!r}{hint}")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
