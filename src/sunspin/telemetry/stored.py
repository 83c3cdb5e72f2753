"""Telemetry read back from a results folder (`telemetry.nc`): a Dataset of `read_telemetry`, with no columns left to interpret."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from sunspin.base.errors import TelemetryError
from sunspin.base.tables import TextTable
from sunspin.telemetry.sensors import ABSURD, read_sensors, sensor_columns
from sunspin.vehicle import Vehicle
from sunspin.vehicle.timeline import parse_instant

KIND = "telemetry"
"""`attrs["kind"]` of stored telemetry."""

TEXTS = ("epoch_utc", "unused_columns", "missing_sensors")
"""Attributes that must be present and be texts."""


def restore_telemetry(data: xr.Dataset, vehicle: Vehicle, path: Path) -> xr.Dataset:
    """Return the telemetry stored in a results folder, without variables that `read_telemetry` never returns.

    Parameters
    ----------
    data : xarray.Dataset
        Content of the file `path`, which only names it in messages.
    vehicle : Vehicle
        Its panels, sensors and wheels must be those of the file.

    Raises
    ------
    TelemetryError
        The file belongs to a vehicle with other panels, sensors or wheels, or somebody has changed it.
    """
    expected = _expected_variables(vehicle)
    kept = {*expected, "time", "panel", "axis", "phase"}
    data = data.drop_vars([name for name in data.variables if name not in kept])
    if mismatch := _describe_mismatch(data, vehicle, expected):
        do = "give the vehicle.toml of its folder, or the file from which it was read"
        raise TelemetryError(
            "the stored telemetry is not that of this vehicle", got=mismatch, do=do, where=str(path)
        )
    return data


def _expected_variables(vehicle: Vehicle) -> dict[str, xr.Variable]:
    """Return each variable that telemetry of a vehicle may have, with its dimensions and type, for a file of one sample."""
    # the sensors' variables are those that a table with a single row of zeros gives
    columns = [name for sensor in sensor_columns(vehicle) for name in sensor.columns]
    sample = pd.DataFrame(dict.fromkeys(columns, "0"), index=[1])
    sensor_variables = read_sensors(vehicle, TextTable(sample, [], ""))
    # the second Sun direction exists only in files with an ambiguous sign of y, which zeros do not have
    for name in ("B", "cov_B"):
        if f"sun_sensor_{name}" in sensor_variables:
            sensor_variables[f"sun_sensor_other_{name}"] = sensor_variables[f"sun_sensor_{name}"]
    panels = (("time", "panel"), np.zeros((1, len(vehicle.input_names))))
    variables = {
        "flag": ("time", np.zeros(1, dtype=np.uint8)),
        "received_s": ("time", np.zeros(1)),
        vehicle.telemetry.variable: panels,
        "panel_temperature_C": panels,
        **sensor_variables,
    }
    # attributes, which follow dimensions and values, are left out
    return {name: xr.Variable(*parts[:2]) for name, parts in variables.items()}


def _describe_mismatch(data: xr.Dataset, vehicle: Vehicle, expected: dict[str, xr.Variable]) -> str:
    """Return in words why stored telemetry is not that of the vehicle, or is damaged; an empty text if neither.

    `expected`: the variables of :func:`_expected_variables` by name, with the dimensions and types that stored ones must have.
    """
    texts = [data.attrs.get(name) for name in TEXTS]
    if (
        not all(isinstance(text, str) for text in texts)
        or parse_instant(data.attrs["epoch_utc"]) is None
    ):
        return "no epoch, or no word on its columns"
    time, phase = data.variables.get("time"), data.variables.get("phase")
    has_floats = time is not None and time.dims == ("time",) and time.dtype.kind == "f"
    if not has_floats or not time.size or not (np.abs(time.values) < ABSURD).all():
        return "no times, or times that are no numbers"
    if phase is not None and (phase.dims != ("time",) or phase.dtype.kind not in "UO"):
        return "phases that are no texts"
    panels = [str(name) for name in data["panel"].values] if "panel" in data.coords else []
    if "panel" in data.sizes and panels != list(vehicle.input_names):
        return "other panels"
    if "flag" not in data or len(data.data_vars) == 1:  # the flags alone
        return "no flags, or no reading"
    for name, stored in data.variables.items():
        if (pattern := expected.get(str(name))) is None:  # time, panel, axis or phase
            continue
        # the first dimension, the number of samples, may differ: `pattern` has one sample
        form, expected_form = (
            (each.dims, each.shape[1:], each.dtype.kind) for each in (stored, pattern)
        )
        if form != expected_form:
            return f"another form of {name}"
        if np.any(np.abs(stored.values[~np.isnan(stored.values)]) > ABSURD):
            return f"{name} beyond all measure"
    return ""
