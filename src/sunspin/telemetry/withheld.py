"""Sensors that `rates` does not use, and with which its result is compared: a gyro, or an attitude quaternion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.base.tables import read_table
from sunspin.base.untrusted import plain_number
from sunspin.telemetry.reader import columns_of_readings, read_telemetry
from sunspin.vehicle import Vehicle
from sunspin.vehicle.sensors import REVERSED, VARIABLES, Attitude, Gyro

EXACT = 1e-9
"""Error (rad/s or rad) of readings whose error is not stated: normalised differences then count the error of the result alone."""

UNITS_RAD_S = {"deg/s": float(np.radians(1.0)), "rad/s": 1.0}
"""Unit of three columns -> its size in rad/s."""

SCALARS, DIRECTIONS = ("first", "last"), ("N_to_B", "B_to_N")
"""Places of the scalar and directions of a quaternion, as in the table [attitude] of a vehicle file."""

EXAMPLES = "gyro, attitude, wx,wy,wz:deg/s or q0,q1,q2,q3:first,N_to_B"
"""Forms of a comparison, for messages."""


class Withheld(NamedTuple):
    """A sensor that was withheld from the estimate.

    `sensor`: gyro or attitude; `columns`: its columns as given; `variable`: of the telemetry, which the estimate must not have;
    `late_s`: by how much its readings are older than those of the panels in the same row, s.
    """

    sensor: Gyro | Attitude
    columns: tuple[str, ...]
    variable: str
    late_s: float = 0.0

    @property
    def is_gyro(self) -> bool:
        """Return whether it reads rates, and not an attitude."""
        return isinstance(self.sensor, Gyro)


def parse_withheld(text: str, vehicle: Vehicle, without: tuple[str, ...] = ()) -> Withheld:
    """Return the sensor that a text names: "gyro" or "attitude" of the vehicle file, or columns and their convention.

    Three columns are rates along the body axes; after a colon stands their unit, deg/s or rad/s. Four columns are a quaternion;
    after a colon stands the place of its scalar, first or last, and N_to_B (the default) or B_to_N. Both may end with +-SIGMA, in
    the unit or in deg. `without`: sensors of the vehicle file that the estimate does not use either.

    Raises
    ------
    InputError
        The text names no sensor, its convention is missing, or the estimate uses one of the columns.
    """
    clock = vehicle.sensors.clock
    if text in ("gyro", "attitude"):
        sensor = getattr(vehicle.sensors, text)
        if sensor is None:
            what, do = f"the vehicle file has no [{text}]", f"add it, or give columns: {EXAMPLES}"
            raise InputError(f"--compare {text}: {what}", do=do)
        late_s = 0.0 if clock is None else clock.late_s
        return Withheld(sensor, tuple(sensor.columns), VARIABLES[text], late_s)
    named, _, rest = text.rpartition(":")
    columns = tuple(name.strip() for name in named.split(","))
    words = [word.strip() for word in rest.split(",")] if named else []
    if len(columns) not in (3, 4) or not all(columns):
        what = "--compare takes a sensor, or three or four columns with their convention"
        raise InputError(what, got=text, do=f"for example {EXAMPLES}")
    sensor = _read_convention(text, columns, words)
    used = columns_of_readings(vehicle)
    for name in without:
        if (unused := vehicle.sensors.with_columns.get(name)) is not None:
            used -= set(unused.names)
    names = [column.removeprefix(REVERSED) for column in columns]
    if taken := [name for name in names if name in used]:
        what = f"--compare names column {taken[0]!r}, which the estimate uses"
        do = "name the sensor, as in --compare gyro, or exclude it by --without"
        raise InputError(what, got=text, do=do)
    return Withheld(sensor, columns, VARIABLES["gyro" if len(columns) == 3 else "attitude"])


def _read_convention(text: str, columns: tuple[str, ...], words: list[str]) -> Gyro | Attitude:
    """Return a sensor with these columns by the words that follow the colon; `text` is that of the option, for messages."""
    sigma = EXACT
    if words and "+-" in words[-1]:
        last, _, number = words.pop().partition("+-")
        words += [last.strip()] if last.strip() else []
        sigma = plain_number(number.strip())
        if not 0 < sigma < np.inf:
            what = "--compare: the sigma after +- must be a positive number"
            raise InputError(what, got=text, do="for example wx,wy,wz:deg/s+-0.05")
    what = f"--compare does not say how columns {', '.join(columns)} are to be read"
    if len(columns) == 3:
        if len(words) != 1 or words[0] not in UNITS_RAD_S:
            raise InputError(
                what, got=text, do=f"add the unit: {','.join(columns)}:deg/s or :rad/s"
            )
        scale = UNITS_RAD_S[words[0]]
        noise = sigma if sigma == EXACT else sigma * scale
        return Gyro(columns, scale_rad_s=scale, zero=np.zeros(3), noise_rad_s=noise)
    scalar = [word for word in words if word in SCALARS]
    direction = [word for word in words if word in DIRECTIONS] or ["N_to_B"]
    if len(scalar) != 1 or len(direction) != 1 or not set(words) <= {*SCALARS, *DIRECTIONS}:
        do = f"add the place of the scalar and the direction: {','.join(columns)}:first,N_to_B"
        raise InputError(what, got=text, do=do)
    sigma_rad = sigma if sigma == EXACT else float(np.radians(sigma))
    return Attitude(columns, scalar=scalar[0], rotates=direction[0], sigma_rad=sigma_rad)  # ty: ignore[invalid-argument-type]


def read_withheld(withheld: Withheld, vehicle: Vehicle, path: Path) -> xr.DataArray:
    """Return the readings of a withheld sensor: rates (time, axis) in rad/s, or quaternions B_from_N (time, quaternion).

    The file is read as that of a vehicle that has the sensor in the place of its own.

    Raises
    ------
    InputError
        The file has no such columns.
    """
    # stored telemetry would give the sensor that it holds, under any names of columns
    names = [name.removeprefix(REVERSED) for name in withheld.columns]
    if not read_table(path).has(names):
        what = "the telemetry has no columns of the sensor to compare with"
        do = "name columns of the original file"
        raise InputError(what, got=", ".join(withheld.columns), do=do, where=str(path))
    place = {"gyro" if withheld.is_gyro else "attitude": withheld.sensor}
    telemetry = read_telemetry(path, replace(vehicle, sensors=replace(vehicle.sensors, **place)))
    return telemetry[withheld.variable]
