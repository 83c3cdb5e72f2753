"""The check of orbital elements against telemetry, in words, and the orbit that `sunspin rates` may use."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sunspin.environment.elements import nearest
from sunspin.estimate.orbit.check import check_orbit
from sunspin.estimate.orbit.field_calibration import field_calibration
from sunspin.estimate.orbit.invariants import FEWEST
from sunspin.estimate.orbit.judged import clock_off, drifting, judged_orbit, orbit_of
from sunspin.output.check.findings import Findings
from sunspin.output.check.samples import noise_lines
from sunspin.output.text import with_sigma
from sunspin.telemetry.assess import Assessment
from sunspin.vehicle.timeline import utc_after


class ChosenOrbit(NamedTuple):
    """The orbit that `sunspin rates` uses.

    `orbit` is None if there are no elements or they do not fit the telemetry. `calibration`: of the magnetometer along the orbit,
    None without an orbit or a calibration. `summary` and `lines`: the comparison of elements and telemetry.
    """

    orbit: Any
    calibration: Any
    summary: dict[str, Any]
    lines: list[str]


def describe_orbit(
    assessment: Assessment, elements: Path | None, shift_sigma: float | None
) -> Findings:
    """Return the findings on whether orbital elements are consistent with the telemetry; empty without elements.

    `elements`: file of elements, default those of the vehicle file; `shift_sigma`: sigma of the along-track offset, s.
    """
    craft, samples = assessment.vehicle, assessment.telemetry
    orbit = orbit_of(craft, samples, elements, shift_sigma)
    if orbit is None:
        return Findings({}, [])
    check = check_orbit(orbit, craft, assessment)
    summary = _summary(orbit, samples, check)
    return Findings({"orbit": summary}, _lines(summary, check))


def choose_orbit(
    assessment: Assessment, elements: Path | None, shift_sigma: float | None
) -> ChosenOrbit:
    """Return the orbit of the elements if the telemetry is consistent with it, with the calibration of the magnetometer.

    The parameters are those of :func:`describe_orbit`.
    """
    craft, samples = assessment.vehicle, assessment.telemetry
    orbit = orbit_of(craft, samples, elements, shift_sigma)
    if orbit is None:
        return ChosenOrbit(None, None, {}, [])
    used, check, words = judged_orbit(orbit, craft, assessment)
    summary: dict[str, Any] = _summary(orbit, samples, check) | {"used": used is not None}
    calibration = None if used is None else field_calibration(used, craft, assessment, check.made)
    lines = [f"{words}; {_satellite_text(summary)}", *(f"  {note}" for note in summary["notes"])]
    if craft.input_noise is None and assessment.has_panels:
        lines += noise_lines(assessment)
    return ChosenOrbit(used, calibration, {"orbit": summary}, lines)


def _satellite_text(summary: dict[str, Any]) -> str:
    """Return name and catalogue number of the satellite of the elements."""
    name, number = summary["name"], summary["satellite"]
    return f"{name} ({number})" if name else f"satellite {number}"


def _summary(orbit: Any, samples: xr.Dataset, fit: Any) -> dict[str, Any]:
    """Return the numbers of the comparison `fit` of an orbit with the samples, SI units in the names."""
    time = samples["time"].values
    middle = orbit.instants(time).middle_jd
    elements = nearest(orbit.elements, middle)
    day, fraction = elements.epoch_jd
    summary = {
        # 2451545.0 is the Julian date of 2000-01-01T12:00
        "epoch_utc": utc_after((day - 2451545.0 + fraction) * 86400, "2000-01-01T12:00:00Z"),
        "age_days": elements.days_to(middle),
        "satellite": elements.number,
        "name": elements.name,
        "verdict": fit.verdict.name.lower(),
        "copies": fit.copies,
        "better_copies": fit.better,
        "copies_expected_better_by_chance": fit.mistaken,
        "node_turn_rad": fit.turn_rad,
        "node_turn_times": fit.turn_times,
        "shift_s": fit.shift_s,
        "shift_sigma_s": fit.shift_sigma_s,
        "shift_at_border": fit.border,
        "drift_s_day": fit.drift_s_day,
        "drift_sigma_s_day": fit.drift_sigma_s_day,
        "samples": fit.samples,
        "field_residual_T": fit.strength_residual_T,
        "sun_field_residual_rad": fit.angle_residual_rad,
        "sign_turned": fit.sign_turned,
        "turned_axes": fit.turned_axes,
        "clock_behind_s": fit.clock_behind_s,
        "in_shadow": fit.eclipse[1],
        "in_shadow_with_sun": fit.eclipse[0],
        "contradicted_by_sun": fit.sun_in_shadow.samples,
        "contradicted_by_s": fit.sun_in_shadow.beyond_s,
        "notes": orbit.notes(time),
    }
    if fit.matrix is not None and fit.zero is not None:
        summary["magnetometer"] = {"matrix_T": fit.matrix.tolist(), "zero_T": fit.zero.tolist()}
    return summary


def _lines(summary: dict[str, Any], fit: Any) -> list[str]:
    """Return the comparison of an orbit with the samples in words."""
    lines = [f"Orbit of {_satellite_text(summary)}: {fit.verdict.value}"]
    lines += [f"  {note}" for note in summary["notes"]]
    lines += [f"  {text}" for text in (str(fit.sun_in_shadow), clock_off(fit)) if text]
    if fit.sign_turned:
        remedy = "the magnetometer has the opposite sign: change the sign of `matrix` in the vehicle file"
        lines.append(f"  {remedy}")
    if fit.turned_axes:
        lines.append(f"  {fit.turned_axes}")
    used = ", ".join(f"{what} of {n}" for what, n in fit.samples.items() if n)
    if not used:
        return [
            *lines,
            "  no sample can be compared: no magnetic field, Sun direction or eclipse in the file",
        ]
    copies = f"{fit.copies} randomised comparison orbits with random node and phase"
    lines.append(f"  {fit.better} of {copies} fit better (samples: {used})")
    if fit.turn_times > 1.05:
        turn = f"with the node turned by {np.degrees(fit.turn_rad):+z.0f} deg"
        lines.append(f"  {turn} residuals are {fit.turn_times:.2f} times smaller")
    border = ", at the border of what was tried: widen --tle-shift-sigma" if fit.border else ""
    # an orbit 1 s late and a clock 1 s early look the same
    clock = " (includes any clock error)"
    shift = with_sigma(fit.shift_s, fit.shift_sigma_s, "s")
    lines.append(f"  along-track offset {shift}{drifting(fit)}{clock}{border}")
    if np.isfinite(fit.strength_residual_T):
        angle, n = np.degrees(fit.angle_residual_rad), fit.samples.get("field and Sun", 0)
        few = f" (too few samples to judge: {n})" if n < FEWEST else ""
        sun = f", Sun-field angle {angle:.1f} deg{few}" if np.isfinite(angle) else ""
        strength = f"{1e6 * fit.strength_residual_T:.2f} uT"
        lines.append(f"  median residuals: field magnitude {strength}{sun}")
    seen, dark = fit.eclipse
    if dark:
        lines.append(f"  eclipse: {dark} samples, {seen} of them with a Sun signal")
    return lines
