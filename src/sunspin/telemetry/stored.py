"""Telemetry read back from a results folder (`telemetry.nc`): values are in our units already, and columns have no names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import TelemetryError, sentence
from sunspin.telemetry.sensors import ABSURD
from sunspin.vehicle import Vehicle

KIND = "telemetry"
"""`attrs["kind"]` of such a file."""


def stored_telemetry(data: xr.Dataset, vehicle: Vehicle, path: Path) -> xr.Dataset:
    """What `read_telemetry` gave when the folder was written, if it is that vehicle's.

    Raises
    ------
    TelemetryError
        The file belongs to a vehicle with other panels, sensors or wheels, or somebody has changed it.
    """
    wrong = _wrong(data, vehicle)
    if wrong:
        do = "give the vehicle.toml that lies beside it, or the file from which it was read"
        raise TelemetryError(sentence("the stored telemetry is not that of this vehicle", got=wrong, do=do, where=str(path)))
    return data


def _wrong(data: xr.Dataset, vehicle: Vehicle) -> str:
    """What speaks against it, in words; nothing if it may be used."""
    quantity = vehicle.telemetry.quantity
    sizes = {"panel": len(vehicle.input_names), "sun_sensor": len(vehicle.sensors.sun_sensors), "wheel": len(vehicle.wheels)}
    other = [f"{data.sizes[name]} of {name}" for name, n in sizes.items() if data.sizes.get(name, n) != n]
    if other:
        return ", ".join(other)
    if "panel" in data.sizes and [str(name) for name in _values(data, "panel")] != list(vehicle.input_names):
        return "other panels"
    if "panel" in data.sizes and quantity not in data:
        return f"no {quantity}"
    if not _is_sound(data, "time") or not np.isfinite(_values(data, "time")).all() or not data.sizes["time"]:
        return "times that are no numbers"
    if "flag" not in data or not isinstance(data.attrs.get("epoch_utc"), str):
        return "no flags, or no epoch"
    strange = [str(name) for name in data.data_vars if not _is_sound(data, str(name))]
    return f"{strange[0]} without numbers of a sensible size for each time" if strange else ""


def _values(data: xr.Dataset, name: str) -> Any:
    return data[name].values if name in data.variables else np.zeros(0)


def _is_sound(data: xr.Dataset, name: str) -> bool:
    """Whether a variable is a row of numbers for each time, none beyond all measure."""
    variable = data.variables.get(name)
    if variable is None or variable.dims[:1] != ("time",) or variable.dtype.kind not in "fiu":
        return False
    return not np.any(np.abs(np.nan_to_num(np.asarray(variable.values, dtype=np.float64), posinf=np.inf)) > ABSURD)
