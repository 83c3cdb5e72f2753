"""The check of orbital elements against telemetry, in words, and the orbit that `sunspin rates` may use."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sunspin.environment.elements import nearest
from sunspin.environment.ephemeris import OrbitFile
from sunspin.estimate.orbit.calibration import calibrate_magnetometer
from sunspin.estimate.orbit.check import check_orbit
from sunspin.estimate.orbit.invariants import FEWEST
from sunspin.estimate.orbit.judged import clock_words, drift_words, judged_orbit, orbit_of
from sunspin.output.check.findings import Findings
from sunspin.output.check.samples import noise_lines
from sunspin.output.text import with_sigma
from sunspin.telemetry.assess import Assessment
from sunspin.vehicle.timeline import utc_after

NODE_GAIN = 1.05
"""Factor by which another node must make the residuals smaller for the check to name it."""


class ChosenOrbit(NamedTuple):
    """The orbit that `sunspin rates` uses.

    `orbit` is None if there are no elements or they do not fit the telemetry. `calibration`: of the magnetometer along the orbit,
    None without an orbit or a calibration. `summary` and `lines`: the comparison of elements and telemetry.
    `field_and_sun_disagree`: it leaves no pass decided (:class:`OrbitCheck`).
    """

    orbit: Any
    calibration: Any
    summary: dict[str, Any]
    lines: list[str]
    field_and_sun_disagree: bool = False


def describe_orbit(
    assessment: Assessment, elements: OrbitFile | None, shift_sigma: float | None
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
    assessment: Assessment, elements: OrbitFile | None, shift_sigma: float | None
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
    calibration = (
        None if used is None else calibrate_magnetometer(used, assessment, check.fitted_sensors)
    )
    lines = [f"{words}; {_satellite_text(summary)}", *(f"  {note}" for note in summary["notes"])]
    if craft.input_noise is None and assessment.has_panels:
        lines += noise_lines(assessment)
    disagree = used is not None and check.field_and_sun_disagree
    return ChosenOrbit(used, calibration, {"orbit": summary}, lines, disagree)


def _satellite_text(summary: dict[str, Any]) -> str:
    """Return name and catalogue number of the satellite of the elements."""
    name, number = summary["name"], summary["satellite"]
    return f"{name} ({number})" if name else f"satellite {number}"


def _summary(orbit: Any, samples: xr.Dataset, check: Any) -> dict[str, Any]:
    """Return the numbers of the check of an orbit, the result of `check_orbit`, SI units in the names."""
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
        "verdict": check.verdict.name.lower(),
        "copies": check.copies,
        "better_copies": check.better,
        "copies_expected_better_by_chance": check.better_by_chance,
        "node_turn_rad": check.node_rad,
        "node_turn_times": check.node_factor,
        "shift_s": check.shift_s,
        "shift_sigma_s": check.shift_sigma_s,
        "shift_at_border": check.border,
        "drift_s_day": check.drift_s_day,
        "drift_sigma_s_day": check.drift_sigma_s_day,
        "samples": check.samples,
        "field_residual_T": check.strength_residual_T,
        "sun_field_residual_rad": check.angle_residual_rad,
        "sign_turned": check.sign_turned,
        "turned_axes": check.turned_axes,
        "clock_behind_s": check.clock_behind_s,
        "in_shadow": check.eclipse[1],
        "in_shadow_with_sun": check.eclipse[0],
        "contradicted_by_sun": check.sun_in_shadow.samples,
        "contradicted_by_s": check.sun_in_shadow.beyond_s,
        "notes": orbit.notes(time),
    }
    if check.matrix is not None and check.zero is not None:
        summary["magnetometer"] = {"matrix_T": check.matrix.tolist(), "zero_T": check.zero.tolist()}
    return summary


def _lines(summary: dict[str, Any], check: Any) -> list[str]:
    """Return the check of an orbit in words; `summary`: its numbers, from :func:`_summary`.

    Without samples that can be compared the lines end early.
    """
    lines = [f"Orbit of {_satellite_text(summary)}: {check.verdict.value}"]
    lines += [f"  {note}" for note in summary["notes"]]
    lines += [f"  {text}" for text in (str(check.sun_in_shadow), clock_words(check)) if text]
    if check.sign_turned:
        remedy = "the magnetometer has the opposite sign: change the sign of `matrix` in the vehicle file"
        lines.append(f"  {remedy}")
    if check.turned_axes:
        lines.append(f"  {check.turned_axes}")
    used = ", ".join(f"{what} of {n}" for what, n in check.samples.items() if n)
    if not used:
        return [
            *lines,
            "  no sample can be compared: no magnetic field, Sun direction or eclipse in the file",
        ]
    copies = f"{check.copies} randomised comparison orbits with random node and phase"
    lines.append(f"  {check.better} of {copies} fit better (samples: {used})")
    if check.node_factor > NODE_GAIN:
        turn = f"with the node turned by {np.degrees(check.node_rad):+z.0f} deg"
        lines.append(f"  {turn} residuals are {check.node_factor:.2f} times smaller")
    border = ", at the border of what was tried: widen --tle-shift-sigma" if check.border else ""
    # an orbit 1 s late and a clock 1 s early look the same
    clock = " (includes any clock error)"
    shift = with_sigma(check.shift_s, check.shift_sigma_s, "s")
    lines.append(f"  along-track offset {shift}{drift_words(check)}{clock}{border}")
    if np.isfinite(check.strength_residual_T):
        angle, n = np.degrees(check.angle_residual_rad), check.samples.get("field and Sun", 0)
        remark = f" (too few samples to judge: {n})" if n < FEWEST else ""
        sun = f", Sun-field angle {angle:.1f} deg{remark}" if np.isfinite(angle) else ""
        strength = f"{1e6 * check.strength_residual_T:.2f} uT"
        lines.append(f"  median residuals: field magnitude {strength}{sun}")
        if check.field_and_sun_disagree:
            lines.append(
                "  FIELD AND SUN DISAGREE: axes, matrix or zero of the magnetometer, or columns of the panels, may be wrong. The "
                f"magnitude of the field shows none of these, and {n} samples are too few to judge: give a longer file"
            )
    with_sun, in_eclipse = check.eclipse
    if in_eclipse:
        lines.append(f"  eclipse: {in_eclipse} samples, {with_sun} of them with a Sun signal")
    return lines
