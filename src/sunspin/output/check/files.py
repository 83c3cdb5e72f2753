"""What `sunspin check` says of a vehicle file and of telemetry: what they hold, and what can be learnt from them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sunspin.base.provenance import clock_notes
from sunspin.output.check.repeats import repeat_lines
from sunspin.output.check.samples import doubts, intervals, noise_lines, worth
from sunspin.output.kinds.panels import health_lines, health_summary
from sunspin.output.kinds.telemetry import status_counts, status_lines
from sunspin.output.text import counted
from sunspin.telemetry.assess import Assessment, assess
from sunspin.telemetry.health import NOISE, find_cause_without_loss
from sunspin.telemetry.reader import FLAGS, read_telemetry
from sunspin.telemetry.sun import reconstructible_patterns
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import lit_patterns
from sunspin.vehicle.timeline import utc_after

NOT_READ = "  Sun directions, gains and lit panels are not reported until the unit is fixed (`--json` lists them)"


def about_vehicle(craft: Vehicle) -> tuple[dict[str, Any], list[str]]:
    """Summary and lines on a vehicle: its parts, what light tells of it, values without a source."""
    summary: dict[str, Any] = {
        "vehicle": craft.name,
        "panels": list(craft.panel_names),
        "wheels": [wheel.name for wheel in craft.wheels],
        "legs": [leg.name for leg in craft.legs],
        "inertia_given": craft.inertia_kg_m2 is not None,
        "without_source": sorted(key for key, fact in craft.facts.items() if fact.source is None),
    }
    parts = ", ".join(counted(len(summary[key]), key[:-1]) for key in ("panels", "wheels", "legs"))
    known = "given"
    if not summary["inertia_given"]:
        known = (
            "not given: `rates` starts from equal moments, `simulate` and `scan` are not available"
        )
    lines = [f"Vehicle {craft.name}: {parts}; inertia {known}"]
    if craft.panels:
        lit, clear = len(lit_patterns(craft)), len(reconstructible_patterns(craft))
        summary |= {"lit_patterns": lit, "reconstructible": clear}
        lines += [
            f"  geometry: {lit} panel combinations can be sunlit; {clear} of them determine the Sun direction"
        ]
    if craft.channels:
        reads = {"largest": "the largest", "sum": "the sum"}
        about = "; ".join(
            f"{channel.name} ({reads[channel.reads]} of {', '.join(channel.panels)})"
            for channel in craft.channels
        )
        summary["channels"] = {channel.name: list(channel.panels) for channel in craft.channels}
        copies = len(craft.response_in().symmetries)
        alike = f", so each sample allows {copies} Sun directions" if copies > 1 else ""
        lines += [f"  shared inputs: {about}. The readings do not show which panel is lit{alike}"]
    bare = summary["without_source"]
    if bare:
        shown = ", ".join(bare[:3]) + (", ..." if len(bare) > 3 else "")
        lines.append(f"  {counted(len(bare), 'value')} in the vehicle file cite no source: {shown}")
    return summary, lines


def about_telemetry(
    craft: Vehicle, path: Path, vehicle: str
) -> tuple[Assessment, dict[str, Any], list[str]]:
    """The assessment of telemetry, with summary and lines on what it holds and what can be determined from it; `vehicle`: the file
    of `craft`."""
    samples = read_telemetry(path, craft)
    assessment = assess(craft, samples)
    time, flag = samples["time"].values, samples["flag"].values
    gaps = intervals(samples)
    spread = [float(gaps.min()), float(np.median(gaps)), float(gaps.max())] if gaps.size else None
    summary: dict[str, Any] = {
        "file": str(path),
        "samples": int(time.size),
        "synthetic": bool(samples.attrs["synthetic"]),
        "epoch_utc": str(samples.attrs["epoch_utc"]),
        "span_s": float(np.ptp(time)) if time.size else 0.0,
        "interval_s": spread,
        "flags": {
            text: n
            for bit, text in FLAGS.items()
            if bit and (n := int(np.count_nonzero(flag & bit)))
        },
    }
    kind = "synthetic sample" if summary["synthetic"] else "sample"
    epoch = summary["epoch_utc"]
    begin = utc_after(float(time.min()), epoch) if time.size else epoch
    size = f"{counted(time.size, kind)} over {summary['span_s']:.0f} s"
    lines = [f"Telemetry {path.name}: {size} from {begin}"]
    if time.size and round(float(time[0])):
        before = f"{time.min():.0f} s before the first sample"
        lines.append(f"  time zero: {epoch}, {before}")
    if spread:
        apart = "  sampling interval: {:.6g} s min, {:.6g} s median, {:.6g} s max"
        lines.append(apart.format(*spread))
    if notes := clock_notes(samples):
        summary["clock_notes"] = notes
        lines += [f"  {note}" for note in notes]
    order = {
        "rows_sorted": "rows sorted by time",
        "rows_merged": "duplicate rows merged",
        "rows_misdated": "rows left out: dated years from the others",
    }
    for key, text in order.items():
        if key in samples.attrs:
            summary[key] = int(samples.attrs[key])
            lines.append(f"  {summary[key]:6d}  {text}")
    lines += [f"  {n:6d}  flagged: {text}" for text, n in summary["flags"].items()]
    for about, more in (repeat_lines(assessment), doubts(assessment, vehicle)):
        summary, lines = summary | about, lines + more
    if assessment.has_panels:
        about, more = _about_panels(assessment)
        lines += [NOT_READ] if summary["panels_misread"] else more
        summary |= about
    about, more = worth(assessment, summary["panels_misread"])
    return assessment, summary | about, lines + more


def _about_panels(assessment: Assessment) -> tuple[dict[str, Any], list[str]]:
    sun, quality = assessment.sun, assessment.quality
    health = health_summary(assessment.health)
    looked_at = -(-assessment.telemetry.sizes["time"] // assessment.health_stride)
    without_loss = find_cause_without_loss(assessment.health, looked_at)
    missed = quality["panel"].values[quality["missed"].values].tolist()
    if missed and health["impossible"] and without_loss != NOISE:
        # patterns may blame another where panels are turned
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
    return summary, status_lines(sun) + health_lines(summary) + noise_lines(assessment)
