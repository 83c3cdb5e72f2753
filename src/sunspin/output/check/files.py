"""The checks of a vehicle file and of a telemetry file: what they contain, and what can be determined from them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sunspin.base.provenance import clock_notes
from sunspin.output.check.findings import Findings
from sunspin.output.check.repeats import describe_repeats
from sunspin.output.check.samples import (
    describe_mismatches,
    describe_samples,
    noise_lines,
    sampling_intervals,
)
from sunspin.output.kinds.panels import health_lines, health_summary
from sunspin.output.kinds.telemetry import status_counts, status_lines
from sunspin.output.text import count_text
from sunspin.telemetry.assess import Assessment, assess
from sunspin.telemetry.health import NOISE, find_cause_without_loss
from sunspin.telemetry.reader import FLAGS, read_telemetry
from sunspin.telemetry.sun import reconstructible_patterns
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import lit_patterns
from sunspin.vehicle.timeline import utc_after

UNTIL_UNIT_IS_FIXED = "  Sun directions, gains and lit panels are not reported until the unit is fixed (`--json` lists them)"


class TelemetryFindings(NamedTuple):
    """The assessment of a telemetry file, with the summary and the lines of its check."""

    assessment: Assessment
    summary: dict[str, Any]
    lines: list[str]


def describe_vehicle(craft: Vehicle) -> Findings:
    """Return the findings on a vehicle: its parts, the Sun directions that its panels determine, values without a source."""
    summary: dict[str, Any] = {
        "vehicle": craft.name,
        "panels": list(craft.panel_names),
        "wheels": [wheel.name for wheel in craft.wheels],
        "legs": [leg.name for leg in craft.legs],
        "inertia_given": craft.inertia_kg_m2 is not None,
        "without_source": sorted(key for key, fact in craft.facts.items() if fact.source is None),
    }
    parts = ", ".join(
        count_text(len(summary[f"{part}s"]), part) for part in ("panel", "wheel", "leg")
    )
    inertia = "given"
    if not summary["inertia_given"]:
        inertia = (
            "not given: `rates` starts from equal moments, `simulate` and `scan` are not available"
        )
    lines = [f"Vehicle {craft.name}: {parts}; inertia {inertia}"]
    if craft.panels:
        possible, reconstructible = len(lit_patterns(craft)), len(reconstructible_patterns(craft))
        summary |= {"lit_patterns": possible, "reconstructible": reconstructible}
        lines += [
            f"  geometry: {possible} panel combinations can be sunlit; {reconstructible} of them determine the Sun direction"
        ]
    if craft.channels:
        joined_as = {"largest": "the largest", "sum": "the sum"}
        inputs = "; ".join(
            f"{channel.name} ({joined_as[channel.reads]} of {', '.join(channel.panels)})"
            for channel in craft.channels
        )
        summary["channels"] = {channel.name: list(channel.panels) for channel in craft.channels}
        # sign changes of the direction's components that no reading shows, with that of no component
        count = len(craft.response_in().symmetries)
        ambiguity = f", so each sample allows {count} Sun directions" if count > 1 else ""
        lines += [
            f"  shared inputs: {inputs}. The readings do not show which panel is lit{ambiguity}"
        ]
    unsourced = summary["without_source"]
    if unsourced:
        names = ", ".join(unsourced[:3]) + (", ..." if len(unsourced) > 3 else "")
        lines.append(
            f"  {count_text(len(unsourced), 'value')} in the vehicle file cite no source: {names}"
        )
    return Findings(summary, lines)


def describe_telemetry(craft: Vehicle, path: Path, vehicle: str) -> TelemetryFindings:
    """Read and assess a telemetry file and return the findings: its contents, and what can be determined from it.

    `vehicle`: name or file of `craft`, from which messages quote lines.
    """
    samples = read_telemetry(path, craft)
    assessment = assess(craft, samples)
    time, flag = samples["time"].values, samples["flag"].values
    gaps = sampling_intervals(samples)
    interval_s = None  # smallest, median and largest
    if gaps.size:
        interval_s = [float(gaps.min()), float(np.median(gaps)), float(gaps.max())]
    summary: dict[str, Any] = {
        "file": str(path),
        "samples": int(time.size),
        "synthetic": bool(samples.attrs["synthetic"]),
        "epoch_utc": str(samples.attrs["epoch_utc"]),
        "span_s": float(np.ptp(time)) if time.size else 0.0,
        "interval_s": interval_s,
        "flags": {
            text: n
            for bit, text in FLAGS.items()
            if bit and (n := int(np.count_nonzero(flag & bit)))
        },
    }
    kind = "synthetic sample" if summary["synthetic"] else "sample"
    epoch = summary["epoch_utc"]
    begin = utc_after(float(time.min()), epoch) if time.size else epoch
    size = f"{count_text(time.size, kind)} over {summary['span_s']:.0f} s"
    lines = [f"Telemetry {path.name}: {size} from {begin}"]
    if time.size and round(float(time[0])):  # the first sample is not at time zero
        before = f"{time.min():.0f} s before the first sample"
        lines.append(f"  time zero: {epoch}, {before}")
    if interval_s:
        least, median, largest = interval_s
        lines.append(
            f"  sampling interval: {least:.6g} s min, {median:.6g} s median, {largest:.6g} s max"
        )
    if craft.telemetry.has_angles and assessment.has_panels:
        quantity = craft.telemetry.quantity
        what = {
            "elevation_deg": "elevations of the Sun (deg)",
            "incidence_deg": "angles of the Sun from the normal (deg)",
            "cosine": "cosines of the angle of incidence",
        }[quantity]
        summary["panels_read"] = quantity
        lines.append(
            f"  panels: {what} are read as signals of flat panels, gain * cosine; a panel that faces away is dark"
        )
    if notes := clock_notes(samples):
        summary["clock_notes"] = notes
        lines += [f"  {note}" for note in notes]
    changed_rows = {
        "rows_sorted": "rows sorted by time",
        "rows_merged": "duplicate rows merged",
        "rows_misdated": "rows left out: dated years from the others",
        "rows_of_others": "rows left out: only columns that are not used have a value",
    }
    for key, text in changed_rows.items():
        if key in samples.attrs:
            summary[key] = int(samples.attrs[key])
            lines.append(f"  {summary[key]:6d}  {text}")
    lines += [f"  {n:6d}  flagged: {text}" for text, n in summary["flags"].items()]
    repeats, mismatches = describe_repeats(assessment), describe_mismatches(assessment, vehicle)
    summary |= repeats.summary | mismatches.summary
    lines += repeats.lines + mismatches.lines
    if assessment.has_panels:
        panels = _describe_panels(assessment)
        summary |= panels.summary
        # a wrong unit makes Sun directions and lit panels wrong, so their lines would mislead
        lines += [UNTIL_UNIT_IS_FIXED] if summary["panels_misread"] else panels.lines
    usability = describe_samples(assessment, summary["panels_misread"])
    return TelemetryFindings(assessment, summary | usability.summary, lines + usability.lines)


def _describe_panels(assessment: Assessment) -> Findings:
    """Return the findings on the Sun directions from the panels and on illumination patterns that the Sun cannot cause."""
    sun, quality = assessment.sun, assessment.quality
    health = health_summary(assessment.health)
    # of a long file only every `health_stride`-th sample was checked: that many, rounded up
    checked = -(-assessment.telemetry.sizes["time"] // assessment.health_stride)
    without_loss = find_cause_without_loss(assessment.health, checked)
    missed = quality["panel"].values[quality["missed"].values].tolist()
    if missed and health["impossible"] and without_loss != NOISE:
        # If panels are misaligned, the patterns may point to another panel than the one without signal.
        health["explanations"], without_loss = [missed], ""
    summary = {
        "status": status_counts(sun),
        "noise": float(sun.attrs["noise"]),
        "noise_from": str(sun.attrs["noise_from"]),
        **{key: health[key] for key in ("impossible", "explanations", "noise_probability")},
        "noise_made": without_loss == NOISE,
        "made_by": without_loss,
        "health_of_every": assessment.health_stride,
    }
    return Findings(summary, status_lines(sun) + health_lines(summary) + noise_lines(assessment))
