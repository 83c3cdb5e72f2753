"""Orbit of a telemetry file, from a file of elements or from the vehicle file, and whether results may use it."""

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
from sunspin.estimate.settings import ORBIT, OrbitSettings
from sunspin.telemetry.assess import Assessment
from sunspin.vehicle import Vehicle
from sunspin.vehicle.parts import StatedOrbit


def orbit_sources(
    vehicle: Vehicle,
    file: OrbitFile | Path | str | None = None,
    shift_sigma_s: float | None = None,
) -> tuple[Source, ...] | None:
    """Return the element sets (TLE, OMM) or tables of positions (OEM, CSV, SPK) of a file, else the elements of the vehicle file.

    None without any. `shift_sigma_s`: sigma of the along-track offset (s) that the user gave. It is only checked: without elements
    it raises InputError, as do elements that cannot be used.
    """
    if file is not None:
        return read_orbit(file)
    if vehicle.orbit is not None and vehicle.orbit.tle:
        return parse_elements("\n".join(vehicle.orbit.tle), f"[orbit] of {vehicle.name}")
    if shift_sigma_s is not None:
        do = "give --tle FILE or --omm FILE, or tle under [orbit] in the vehicle file"
        raise InputError("an along-track offset needs elements", do=do)
    return None


def orbit_of(
    vehicle: Vehicle,
    telemetry: xr.Dataset,
    elements: OrbitFile | Path | str | None = None,
    shift_sigma_s: float | None = None,
) -> Orbit | None:
    """Return the orbit of a telemetry file, by the elements of :func:`orbit_sources`; None without any.

    `shift_sigma_s`: sigma of the along-track offset in s, in place of that of the vehicle file; without either it follows from the
    age of the elements.
    """
    sources = orbit_sources(vehicle, elements, shift_sigma_s)
    if sources is None:
        return None
    stated = vehicle.orbit or StatedOrbit()
    return in_orbit(
        sources,
        str(telemetry.attrs["epoch_utc"]),
        telemetry["time"].values,
        shift_s=stated.shift_s,
        shift_sigma_s=stated.shift_sigma_s if shift_sigma_s is None else shift_sigma_s,
        clock_s=stated.clock_s,
        clock_sigma_s=stated.clock_sigma_s,
    )


def drift_words(check: OrbitCheck) -> str:
    """Return in words how the along-track offset drifts; empty if no Sun sensors have determined it."""
    if check.fitted_sensors is None:
        return ""
    return f" at mid-file, {check.drift_s_day:+z.1f} ± {check.drift_sigma_s_day:.1f} s a day"


def clock_words(check: OrbitCheck) -> str:
    """Return in words with which error of the telemetry's clock refused elements would fit; empty if with none."""
    hours = round(check.clock_behind_s / 3600)
    if not hours:
        return ""
    side = "behind" if hours > 0 else "ahead of"
    clock = f"they would fit if the telemetry's clock were {abs(hours)} h {side} UTC"
    # of the elements of seven wrong satellites one did
    return f"{clock} (those of another satellite may fit so by chance)"


def judged_orbit(
    orbit: Orbit,
    vehicle: Vehicle,
    telemetry: xr.Dataset | Assessment,
    *,
    settings: OrbitSettings = ORBIT,
) -> tuple[Orbit | None, OrbitCheck, str]:
    """Return the orbit that results may use, its check, and a sentence that says which orbit that is.

    An orbit that fits gets the estimated along-track offset with its sigma. If the telemetry cannot judge it, it is returned as
    given. If it is refused, the first result is None, since no result may depend on it.
    """
    check = check_orbit(orbit, vehicle, telemetry, settings=settings)
    if check.verdict is Verdict.REFUSED:
        why, _, _ = check.verdict.value.partition(";")  # the rest says what to do
        reasons = [why, str(check.sun_in_shadow), clock_words(check)]
        text = "; ".join(reason for reason in reasons if reason)
        text = (
            f"the orbit is NOT USED: {text}; the result is without it (`sunspin check` says more)"
        )
        return None, check, text
    remarks = ""
    if check.sign_turned:
        remarks = "; THE MAGNETOMETER HAS THE OPPOSITE SIGN: change the sign of `matrix` in the vehicle file"
    if check.turned_axes:
        remarks += f"; {check.turned_axes}"
    if check.field_and_sun_disagree:
        angle = f"{np.degrees(check.angle_residual_rad):.0f} deg"
        remarks += f"; FIELD AND SUN DISAGREE by {angle}: look at the axes of the magnetometer and at the panels"
    if check.verdict is Verdict.UNDECIDED:
        offset = f"{orbit.shift_s:+z.0f} ± {orbit.offset_sigma_s:.0f} s along the track"
        text = (
            f"the orbit is used as it was given, {offset}: the telemetry cannot judge it{remarks}"
        )
        return orbit, check, text
    # The estimated offset is the sum of the errors of elements and clock. So the variance of the elements is that of the offset
    # less that of the clock; a clock cannot err by more than the sum does.
    elements_variance = max(check.shift_sigma_s**2 - orbit.clock_sigma_s**2, 0.0)
    fitted = replace(
        orbit,
        shift_s=check.shift_s,
        shift_sigma_s=float(np.sqrt(elements_variance)),
        clock_sigma_s=min(orbit.clock_sigma_s, check.shift_sigma_s),
        drift_s_day=check.drift_s_day,
        drift_sigma_s_day=check.drift_sigma_s_day,
    )
    offset = (
        f"{check.shift_s:+z.0f} ± {check.shift_sigma_s:.0f} s along the track{drift_words(check)}"
    )
    return fitted, check, f"the orbit is used: its elements fit, {offset}{remarks}"
