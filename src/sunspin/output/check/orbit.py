"""Whether telemetry was taken in an orbit: the check in words, and the orbit that may be used."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sunspin.environment.elements import nearest
from sunspin.estimate.orbit.check import check_orbit
from sunspin.estimate.orbit.field_calibration import field_calibration
from sunspin.estimate.orbit.invariants import FEWEST
from sunspin.estimate.orbit.judged import clock_off, drifting, judged_orbit, orbit_of
from sunspin.output.check.samples import noise_lines
from sunspin.output.text import with_sigma
from sunspin.telemetry.assess import Assessment
from sunspin.vehicle.timeline import utc_after


def about_orbit(
    assessment: Assessment, elements: Path | None, shift_sigma: float | None
) -> tuple[dict[str, Any], list[str]]:
    """Summary and lines on whether the elements are consistent with the telemetry; empty without elements."""
    craft, samples = assessment.vehicle, assessment.telemetry
    orbit = orbit_of(craft, samples, elements, shift_sigma)
    if orbit is None:
        return {}, []
    check = check_orbit(orbit, craft, assessment)
    summary = _summary(orbit, samples, check)
    return {"orbit": summary}, _lines(summary, check)


def orbit_used(
    assessment: Assessment, elements: Path | None, shift_sigma: float | None
) -> tuple[Any, Any, dict[str, Any], list[str]]:
    """The orbit that the telemetry allows to use (None: no), the magnetometer's calibration along it, and summary and lines on the
    orbit; nothing where there are no elements."""
    craft, samples = assessment.vehicle, assessment.telemetry
    orbit = orbit_of(craft, samples, elements, shift_sigma)
    if orbit is None:
        return None, None, {}, []
    used, check, words = judged_orbit(orbit, craft, assessment)
    summary: dict[str, Any] = _summary(orbit, samples, check) | {"used": used is not None}
    calibration = None if used is None else field_calibration(used, craft, assessment, check.made)
    lines = [f"{words}; {_named(summary)}", *(f"  {note}" for note in summary["notes"])]
    if craft.input_noise is None and assessment.has_panels:
        lines += noise_lines(assessment.sun)
    return used, calibration, {"orbit": summary}, lines


def _named(summary: dict[str, Any]) -> str:
    name, number = summary["name"], summary["satellite"]
    return f"{name} ({number})" if name else f"satellite {number}"


def _summary(orbit: Any, samples: xr.Dataset, found: Any) -> dict[str, Any]:
    time = samples["time"].values
    middle = orbit.instants(time).middle
    elements = nearest(orbit.elements, middle)
    day, fraction = elements.epoch_jd
    summary = {
        "epoch_utc": utc_after((day - 2451545.0 + fraction) * 86400, "2000-01-01T12:00:00Z"),
        "age_days": elements.days_to(middle),
        "satellite": elements.number,
        "name": elements.name,
        "verdict": found.verdict.name.lower(),
        "copies": found.copies,
        "better_copies": found.better,
        "copies_expected_better_by_chance": found.mistaken,
        "node_turn_rad": found.turn_rad,
        "node_turn_times": found.turn_times,
        "shift_s": found.shift_s,
        "shift_sigma_s": found.shift_sigma_s,
        "shift_at_border": found.border,
        "drift_s_day": found.drift_s_day,
        "drift_sigma_s_day": found.drift_sigma_s_day,
        "samples": found.samples,
        "field_residual_T": found.strength_residual_T,
        "sun_field_residual_rad": found.angle_residual_rad,
        "sign_turned": found.sign_turned,
        "turned_axes": found.turned_axes,
        "clock_behind_s": found.clock_behind_s,
        "in_shadow": found.eclipse[1],
        "in_shadow_with_sun": found.eclipse[0],
        "notes": orbit.notes(time),
    }
    if found.matrix is not None and found.zero is not None:
        summary["magnetometer"] = {"matrix_T": found.matrix.tolist(), "zero_T": found.zero.tolist()}
    return summary


def _lines(summary: dict[str, Any], found: Any) -> list[str]:
    lines = [f"Orbit of {_named(summary)}: {found.verdict.value}"]
    lines += [f"  {note}" for note in summary["notes"]]
    if off := clock_off(found):
        lines.append(f"  {off}")
    if found.sign_turned:
        turned = "the magnetometer has the opposite sign: change the sign of `matrix` in the vehicle file"
        lines.append(f"  {turned}")
    if found.turned_axes:
        lines.append(f"  {found.turned_axes}")
    used = ", ".join(f"{what} of {n}" for what, n in found.samples.items() if n)
    if not used:
        return [
            *lines,
            "  no sample can be compared: no magnetic field, Sun direction or eclipse in the file",
        ]
    copies = f"{found.copies} randomised comparison orbits with random node and phase"
    lines.append(f"  {found.better} of {copies} fit better (samples: {used})")
    if found.turn_times > 1.05:
        turn = f"with the node turned by {np.degrees(found.turn_rad):+z.0f} deg"
        lines.append(f"  {turn} residuals are {found.turn_times:.2f} times smaller")
    border = ", at the border of what was tried: widen --tle-shift-sigma" if found.border else ""
    both = " (includes any clock error)"
    shift = with_sigma(found.shift_s, found.shift_sigma_s, "s")
    lines.append(f"  along-track offset {shift}{drifting(found)}{both}{border}")
    if np.isfinite(found.strength_residual_T):
        angle, n = np.degrees(found.angle_residual_rad), found.samples.get("field and Sun", 0)
        few = f" (too few samples to judge: {n})" if n < FEWEST else ""
        sun = f", Sun-field angle {angle:.1f} deg{few}" if np.isfinite(angle) else ""
        strength = f"{1e6 * found.strength_residual_T:.2f} uT"
        lines.append(f"  median residuals: field magnitude {strength}{sun}")
    seen, dark = found.eclipse
    if dark:
        lines.append(f"  eclipse: {dark} samples, {seen} of them with a Sun signal")
    return lines
