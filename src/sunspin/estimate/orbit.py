"""The orbit that belongs to a telemetry file: from a file of elements, or from the vehicle's own `[orbit]`."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from sunspin.base.errors import InputError, sentence
from sunspin.environment.elements import parse_elements, read_elements
from sunspin.environment.orbit import Orbit, in_orbit
from sunspin.vehicle import Vehicle
from sunspin.vehicle.parts import Orbit as Stated


def orbit_of(
    vehicle: Vehicle, telemetry: xr.Dataset, elements: Path | str | None = None, shift_sigma_s: float | None = None
) -> Orbit | None:
    """The environment of a telemetry file by a file of elements (TLE, OMM), else by those of the vehicle file; None without either.

    `shift_sigma_s` goes before that of the vehicle file; without either it follows from the elements' age.

    Raises
    ------
    InputError
        For elements that cannot be used, or a sigma of the shift without elements.
    """
    stated = vehicle.orbit or Stated()
    if elements is None and not stated.tle:
        if shift_sigma_s is not None:
            what = "a shift along the track needs elements"
            raise InputError(sentence(what, do="give --tle FILE or --omm FILE, or tle under [orbit] in the vehicle file"))
        return None
    where = f"[orbit] of {vehicle.name}"
    found = read_elements(elements) if elements is not None else parse_elements("\n".join(stated.tle), where)
    return in_orbit(
        found, str(telemetry.attrs["epoch_utc"]), telemetry["time"].values, shift_s=stated.shift_s,
        shift_sigma_s=stated.shift_sigma_s if shift_sigma_s is None else shift_sigma_s,
        clock_s=stated.clock_s, clock_sigma_s=stated.clock_sigma_s,
    )  # fmt: skip
