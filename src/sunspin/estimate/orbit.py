"""The orbit that belongs to a telemetry file: from a file of elements, or from the vehicle's own `[orbit]`."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from sunspin.base.errors import InputError, sentence
from sunspin.environment.elements import parse_elements
from sunspin.environment.ephemeris import read_orbit
from sunspin.environment.orbit import Orbit, Source, in_orbit
from sunspin.vehicle import Vehicle
from sunspin.vehicle.parts import Orbit as Stated


def elements_of(
    vehicle: Vehicle, path: Path | str | None = None, shift_sigma_s: float | None = None
) -> tuple[Source, ...] | None:
    """The element sets of a file (TLE, OMM), or its table of positions (OEM, CSV, SPK), else the elements of the vehicle file; None
    without any.

    Raises
    ------
    InputError
        For elements that cannot be used, or a sigma of the shift without elements.
    """
    stated = vehicle.orbit or Stated()
    if path is not None:
        return read_orbit(path)
    if stated.tle:
        return parse_elements("\n".join(stated.tle), f"[orbit] of {vehicle.name}")
    if shift_sigma_s is not None:
        what = "a shift along the track needs elements"
        raise InputError(sentence(what, do="give --tle FILE or --omm FILE, or tle under [orbit] in the vehicle file"))
    return None


def orbit_of(
    vehicle: Vehicle, telemetry: xr.Dataset, elements: Path | str | None = None, shift_sigma_s: float | None = None
) -> Orbit | None:
    """The environment of a telemetry file by the elements of :func:`elements_of`; None without them.

    `shift_sigma_s` goes before that of the vehicle file; without either it follows from the elements' age.
    """
    found, stated = elements_of(vehicle, elements, shift_sigma_s), vehicle.orbit or Stated()
    if found is None:
        return None
    return in_orbit(
        found, str(telemetry.attrs["epoch_utc"]), telemetry["time"].values, shift_s=stated.shift_s,
        shift_sigma_s=stated.shift_sigma_s if shift_sigma_s is None else shift_sigma_s,
        clock_s=stated.clock_s, clock_sigma_s=stated.clock_sigma_s,
    )  # fmt: skip
