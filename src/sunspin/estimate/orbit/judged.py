"""The orbit that belongs to a telemetry file: from a file of elements, or from the vehicle's own `[orbit]`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.environment.elements import parse_elements
from sunspin.environment.ephemeris import OrbitFile, read_orbit
from sunspin.environment.orbit import Orbit, Source, in_orbit
from sunspin.estimate.orbit.check import OrbitCheck, Verdict, check_orbit
from sunspin.telemetry.assess import Assessment
from sunspin.vehicle import Vehicle
from sunspin.vehicle.parts import Orbit as Stated


def elements_of(
    vehicle: Vehicle,
    file: OrbitFile | Path | str | None = None,
    shift_sigma_s: float | None = None,
) -> tuple[Source, ...] | None:
    """The element sets of a file (TLE, OMM), or its table of positions (OEM, CSV, SPK), else the elements of the vehicle file; None
    without any.

    Raises
    ------
    InputError
        For elements that cannot be used, or a sigma of the shift without elements.
    """
    stated = vehicle.orbit or Stated()
    if file is not None:
        return read_orbit(file)
    if stated.tle:
        return parse_elements("\n".join(stated.tle), f"[orbit] of {vehicle.name}")
    if shift_sigma_s is not None:
        what = "an along-track offset needs elements"
        raise InputError(
            what, do="give --tle FILE or --omm FILE, or tle under [orbit] in the vehicle file"
        )
    return None


def orbit_of(
    vehicle: Vehicle,
    telemetry: xr.Dataset,
    elements: OrbitFile | Path | str | None = None,
    shift_sigma_s: float | None = None,
) -> Orbit | None:
    """The environment of a telemetry file by the elements of :func:`elements_of`; None without them.

    `shift_sigma_s` goes before that of the vehicle file; without either it follows from the elements' age.
    """
    found, stated = elements_of(vehicle, elements, shift_sigma_s), vehicle.orbit or Stated()
    if found is None:
        return None
    return in_orbit(
        found,
        str(telemetry.attrs["epoch_utc"]),
        telemetry["time"].values,
        shift_s=stated.shift_s,
        shift_sigma_s=stated.shift_sigma_s if shift_sigma_s is None else shift_sigma_s,
        clock_s=stated.clock_s,
        clock_sigma_s=stated.clock_sigma_s,
    )


def drifting(found: OrbitCheck) -> str:
    """How the shift changes, in words, where the telemetry has shown it."""
    if found.made is None:
        return ""
    return f" at mid-file, {found.drift_s_day:+z.1f} ± {found.drift_sigma_s_day:.1f} s a day"


def clock_off(found: OrbitCheck) -> str:
    """What clock would make elements fit that do not, in words; empty where none would."""
    hours = round(found.clock_behind_s / 3600)
    side = "behind" if hours > 0 else "ahead of"
    return (
        f"they would fit if the telemetry's clock were {abs(hours)} h {side} UTC" if hours else ""
    )


def judged_orbit(
    orbit: Orbit, vehicle: Vehicle, telemetry: xr.Dataset | Assessment
) -> tuple[Orbit | None, OrbitCheck, str]:
    """An orbit as the telemetry leaves it, what the check found (:mod:`sunspin.estimate.orbit.check`), and what follows, in words.

    Elements that fit get the shift that was found, with its sigma; where the telemetry cannot tell, they stay as they were;
    refused ones are None: no answer may rest on them.
    """
    found = check_orbit(orbit, vehicle, telemetry)
    sign = (
        "; THE MAGNETOMETER HAS THE OPPOSITE SIGN: change the sign of `matrix` in the vehicle file"
        if found.sign_turned
        else ""
    )
    sign += f"; {found.turned_axes}" if found.turned_axes else ""
    if found.verdict is Verdict.REFUSED:
        why = found.verdict.value.split(";")[0]
        reasons = "".join(
            f"; {text}" for text in (str(found.sun_in_shadow), clock_off(found)) if text
        )
        return (
            None,
            found,
            f"the orbit is NOT USED: {why}{reasons}; the result is without it (`sunspin check` says more)",
        )
    if found.verdict is Verdict.UNDECIDED:
        sigma = float(np.hypot(orbit.shift_sigma_s, orbit.clock_sigma_s))
        along = f"{orbit.shift_s:+z.0f} +- {sigma:.0f} s along the track"
        return (
            orbit,
            found,
            f"the orbit is used as it was given, {along}: the telemetry cannot judge it{sign}",
        )
    # the shift found is that of place and clock together, of which the data determine the sum
    rest = float(np.sqrt(max(found.shift_sigma_s**2 - orbit.clock_sigma_s**2, 0.0)))
    known = replace(
        orbit,
        shift_s=found.shift_s,
        shift_sigma_s=rest,
        clock_sigma_s=min(orbit.clock_sigma_s, found.shift_sigma_s),
        drift_s_day=found.drift_s_day,
        drift_sigma_s_day=found.drift_sigma_s_day,
    )
    shift = f"{found.shift_s:+z.0f} +- {found.shift_sigma_s:.0f} s along the track{drifting(found)}"
    return known, found, f"the orbit is used: its elements fit, {shift}{sign}"
