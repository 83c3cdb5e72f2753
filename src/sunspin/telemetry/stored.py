"""Telemetry read back from a results folder (`telemetry.nc`): values are in our units already, and columns have no names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from sunspin.base.errors import TelemetryError
from sunspin.base.tables import Table
from sunspin.telemetry.sensors import ABSURD, read_sensors, sensor_parts
from sunspin.vehicle import Vehicle
from sunspin.vehicle.timeline import parse_instant

KIND = "telemetry"
"""`attrs["kind"]` of such a file."""

TEXTS = ("epoch_utc", "unused_columns", "missing_sensors")
"""Attributes that are read as texts."""


def stored_telemetry(data: xr.Dataset, vehicle: Vehicle, path: Path) -> xr.Dataset:
    """What `read_telemetry` gave when the folder was written, if it is that vehicle's; what it never gives is left out.

    Raises
    ------
    TelemetryError
        The file belongs to a vehicle with other panels, sensors or wheels, or somebody has changed it.
    """
    known = _known(vehicle)
    kept = {*known, "time", "panel", "axis", "phase"}
    data = data.drop_vars([name for name in data.variables if name not in kept])
    if wrong := _wrong(data, vehicle, known):
        do = "give the vehicle.toml of its folder, or the file from which it was read"
        raise TelemetryError(
            "the stored telemetry is not that of this vehicle", got=wrong, do=do, where=str(path)
        )
    return data


def _known(vehicle: Vehicle) -> dict[str, xr.Variable]:
    """The variables that telemetry of a vehicle may have, of one sample."""
    columns = [name for _, _, names in sensor_parts(vehicle) for name in names]
    sample = pd.DataFrame(dict.fromkeys(columns, "0"), index=[1])
    of_sensors = read_sensors(vehicle, Table(sample, [], ""))
    for name in ("B", "cov_B"):  # this sample does not leave open how to read it, others may
        if f"sun_sensor_{name}" in of_sensors:
            of_sensors[f"sun_sensor_other_{name}"] = of_sensors[f"sun_sensor_{name}"]
    number, panels = np.zeros(1), (("time", "panel"), np.zeros((1, len(vehicle.input_names))))
    of_panels = {vehicle.telemetry.quantity: panels, "panel_temperature_C": panels}
    others = {"flag": ("time", number.astype(np.uint8)), "received_s": ("time", number)}
    forms = (others | of_panels | of_sensors).items()
    return {name: xr.Variable(*form[:2]) for name, form in forms}


def _wrong(data: xr.Dataset, vehicle: Vehicle, known: dict[str, xr.Variable]) -> str:
    """What speaks against it, in words; nothing if it may be used."""
    texts = [data.attrs.get(name) for name in TEXTS]
    if (
        not all(isinstance(text, str) for text in texts)
        or parse_instant(data.attrs["epoch_utc"]) is None
    ):
        return "no epoch, or no word on its columns"
    time, phase = data.variables.get("time"), data.variables.get("phase")
    plain = time is not None and time.dims == ("time",) and time.dtype.kind == "f"
    if not plain or not time.size or not (np.abs(time.values) < ABSURD).all():
        return "no times, or times that are no numbers"
    if phase is not None and (phase.dims != ("time",) or phase.dtype.kind not in "UO"):
        return "phases that are no texts"
    panels = [str(name) for name in data["panel"].values] if "panel" in data.coords else []
    if "panel" in data.sizes and panels != list(vehicle.input_names):
        return "other panels"
    if "flag" not in data or len(data.data_vars) == 1:
        return "no flags, or no reading"
    for name, stored in data.variables.items():
        if (form := known.get(str(name))) is None:
            continue
        alike = [(each.dims, each.shape[1:], each.dtype.kind) for each in (stored, form)]
        if alike[0] != alike[1]:
            return f"another form of {name}"
        if np.any(np.abs(stored.values[~np.isnan(stored.values)]) > ABSURD):
            return f"{name} beyond all measure"
    return ""
