"""Beacons of the CubeSat skCUBE for the studies that use them (docs/data.md says where they come from)."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np
import xarray as xr

import sunspin as ss
from sunspin.base.errors import InputError

ATTITUDE, POWER = "skcube_adcs.csv", "skcube_pwr.csv"
"""Attitude beacons (Sun sensors, magnetometer, gyro) and power beacons (panel currents)."""

FREE_S = 219_600
"""25 June 2017, 20:03 UTC, in seconds after the first attitude beacon: from here on the coils of the magnetorquers are off."""

LAST_DAY = np.datetime64("2017-06-28")
"""The studies use the gyro up to the day before: its readings of this day are kept for tests."""


def add_data_option(parser: argparse.ArgumentParser) -> None:
    """Add `--data FOLDER`, by default the folder that SUNSPIN_DATA names."""
    default = os.environ.get("SUNSPIN_DATA")
    help_text = "folder of the third-party data (docs/data.md); default: SUNSPIN_DATA"
    parser.add_argument("--data", type=Path, default=default, metavar="FOLDER", help=help_text)


def read_beacons(craft: ss.Vehicle, folder: Path | None, name: str = ATTITUDE) -> xr.Dataset:
    """Return the telemetry of one file of beacons in the data folder.

    Raises
    ------
    InputError
        No folder is given, or it does not hold the file.
    """
    do = "give --data FOLDER, or set SUNSPIN_DATA (docs/data.md)"
    if folder is None:
        raise InputError("the beacons of skCUBE are not in this repository", do=do)
    path = Path(folder) / "skcube" / name
    if not path.is_file():
        raise InputError("there is no such file of beacons", do=do, where=str(path))
    return ss.read_telemetry(path, craft)


def utc(beacons: xr.Dataset) -> np.ndarray:
    """Return the UTC (n) of the samples as datetime64."""
    epoch = np.datetime64(beacons.attrs["epoch_utc"][:-1])  # without the "Z"
    return epoch + (1e9 * beacons["time"].values).astype("timedelta64[ns]")
