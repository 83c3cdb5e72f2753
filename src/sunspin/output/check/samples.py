"""The check of samples: which are usable, how many sides are lit, the noise, and the rates that the sampling can resolve."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from sunspin.estimate.equivalence import Observed, nominal_momenta, unseen_changes
from sunspin.output.check.findings import Findings
from sunspin.output.text import count_text, size_text, with_sigma
from sunspin.telemetry.assess import LOW_SHARE, Assessment
from sunspin.telemetry.noise import ASSUMED_FROM, ASSUMED_SHARE
from sunspin.telemetry.quality import SURELY_LIT, count_reasons
from sunspin.telemetry.signals import signals
from sunspin.telemetry.sun import LIT_SIGMAS, SunStatus
from sunspin.telemetry.units import reading_unit
from sunspin.vehicle import Vehicle
from sunspin.vehicle.file import find_line, read_vehicle_text
from sunspin.vehicle.sensors import VARIABLES

MOST_UNSEEN = 3
"""Changes of columns that the samples do not show and that are listed by name."""

SHOWN = 30
"""Unused columns that are listed by name."""

MOST_PANELS = 2 / 3
"""A row counts as a sample of the motion if at least this fraction of the panels was read in it. Five of six panels bound the Sun
direction, two leave it open. If a file has a row for each packet, a row has a half or a third of the panels."""

APART_ROWS, APART_SHARE = 0.2, 0.2
"""Smallest share of rows without panels from which they count as packets of other instruments; and their largest distance (median)
from a row with panels, as a share of the interval between such rows."""

PASS_INTERVALS = 6
"""Usual sampling intervals from which a gap separates two passes, as by default in `rates`."""

EVEN_JITTER = 0.02
"""Standard deviation of the intervals within passes, relative to the usual one, below which the sampling counts as even."""


def describe_mismatches(assessment: Assessment, vehicle: str | None = None) -> Findings:
    """Return the findings on what does not match between telemetry and vehicle file: units, gyro axes, sensors, columns.

    `vehicle`: name or path of the vehicle file, from which messages quote the wrong line.
    """
    unit_texts, samples = [], assessment.telemetry
    for wrong in assessment.wrong_units:
        # an entry may name alternative keys or several; the line of the first one is quoted
        key = wrong.key.split(" or ")[0].split(",")[0]
        line = None  # number and text
        if vehicle is not None:
            line = find_line(read_vehicle_text(vehicle), wrong.table, key)
        unit_texts.append(wrong.at(f", line {line[0]} ({line[1][:60]}),") if line else str(wrong))
    unused = [name for name in samples.attrs["unused_columns"].split(", ") if name]
    missing = [name for name in samples.attrs["missing_sensors"].split("; ") if name]
    lines = [f"  WRONG UNIT: {text}" for text in unit_texts]
    axes = None
    # axes cannot be judged in a wrong unit
    gyro_misread = any(wrong.table == "gyro" for wrong in assessment.wrong_units)
    if "gyro_B" in samples and not gyro_misread:
        # imported late, because it brings the compiler
        from sunspin.estimate.gyro_axes import wrong_gyro_axes

        axes = wrong_gyro_axes(assessment)
    lines += [f"  WRONG AXES: {axes}"] if axes else []
    lines += [f"  sensors without columns in this file: {', '.join(missing)}"] if missing else []
    rest = f" and {len(unused) - SHOWN} more" if len(unused) > SHOWN else ""
    lines += [f"  unused columns: {', '.join(unused[:SHOWN])}{rest}"] if unused else []
    panels_misread = any(
        wrong.table == "telemetry" and wrong.key.startswith("scale")
        for wrong in assessment.wrong_units
    )
    summary: dict[str, Any] = {"wrong_units": unit_texts, "wrong_axes": [axes] if axes else []}
    summary |= {"panels_misread": panels_misread}
    summary |= {"missing_sensors": missing, "unused_columns": unused}
    return Findings(summary, lines)


def noise_lines(assessment: Assessment) -> list[str]:
    """Return lines on the noise of panel readings and its source; none if the vehicle file states one noise for all panels."""
    sun = assessment.sun
    noise, source = float(sun.attrs["noise"]), str(sun.attrs["noise_from"])
    noise_of_panel = dict(zip(sun["panel"].values, sun["noise"].values, strict=True))
    one_noise = len({*noise_of_panel.values()}) == 1 or assessment.vehicle.telemetry.has_angles
    if not np.isfinite(noise) or (source == "given" and one_noise):
        return []
    unit_name = reading_unit(assessment.vehicle, signals(assessment.telemetry))
    unit = f" {unit_name}" if unit_name else " (in the unit of the readings)"
    if source == "given":
        values = ", ".join(f"{panel} {size_text(sigma)}" for panel, sigma in noise_of_panel.items())
        return [f"  noise of panel readings, from the vehicle file: {values}{unit}"]
    if source != ASSUMED_FROM:
        return [f"  noise of panel readings: {size_text(noise)}{unit}, {source}"]
    return [
        f"  NOISE NOT STATED: neither the vehicle file nor the samples give the noise of panel readings; {size_text(noise)}{unit}, "
        f"{ASSUMED_SHARE:.0%} of full Sun, is assumed for directions. Write what you know of it, or "
        f"`noise = {size_text(noise)}`, under [telemetry] of the vehicle file"
    ]


def unknown_gain_lines(assessment: Assessment) -> list[str]:
    """Return a line if the gains look like placeholders (`Assessment.doubtful_gains`)."""
    share = assessment.doubtful_gains
    if not share:
        return []
    values = ", ".join(f"{name} {part:.0%}" for name, part in share.items())
    low = ", ".join(name for name, part in share.items() if part < LOW_SHARE)
    return [
        f"  GAINS NOT KNOWN: with the relative gains of the vehicle file the largest readings are {values} of that of panel "
        f"{max(share, key=share.__getitem__)}; if {low} has fewer or weaker cells, the rates are wrong. Give `cells`, `gain_W` or "
        "`gain_A` of each panel, or its relative gain a sigma"
    ]


def describe_unseen_columns(assessment: Assessment) -> Findings:
    """Return the findings on exchanged columns and reversed panels that no estimate of these samples would notice.

    Wheels count at the speed of the vehicle file. `rates`, which knows the motion, may exclude more of the changes.
    """
    vehicle, samples = assessment.vehicle, assessment.telemetry
    observed = Observed.of(vehicle, samples, momenta=nominal_momenta(vehicle))
    changes = [change.what for change, _ in unseen_changes(observed, samples)]
    if not changes:
        return Findings({"columns_unseen": []}, [])
    rest = (
        f"; or {len(changes) - MOST_UNSEEN} more of the kind" if len(changes) > MOST_UNSEEN else ""
    )
    named = "; or ".join(changes[:MOST_UNSEEN])
    return Findings(
        {"columns_unseen": changes},
        [
            f"  columns: the samples would look the same with {named}{rest}, and `rates` would give another motion: "
            "compare columns and normals with the harness drawing, or light one panel with a lamp"
        ],
    )


def describe_samples(assessment: Assessment, misread: bool = False) -> Findings:
    """Return the findings on the quality of panel readings, on other sensors, and on the rates that the sampling can resolve.

    `misread`: whether panels are in a wrong unit; then there are no lines on gains, albedo and lit sides.
    """
    summary: dict[str, Any] = {}
    lines: list[str] = []
    samples = assessment.telemetry
    if assessment.has_panels:
        summary, lines = _describe_panels(assessment)
        unseen = Findings({}, []) if misread else describe_unseen_columns(assessment)
        if misread:
            lines = [f"  {n:6d}  {text}" for text, n in summary["worth"].items()]
        summary |= unseen.summary
        lines += [*unseen.lines, *_apart_rows_lines(assessment)]
    # variable of telemetry -> name of the sensor
    sensors = {"sun_sensor_B": "Sun sensors"}
    sensors |= {variable: name.replace("_", " ") for name, variable in VARIABLES.items()}
    sensors |= {"wheel_speed_rad_s": "wheel speeds"}
    sample_counts = {
        label: int(_is_read(samples[name]).sum())
        for name, label in sensors.items()
        if name in samples
    }
    if sample_counts:
        summary["sensors"] = sample_counts
        counts = ", ".join(f"{label} ({n} samples)" for label, n in sample_counts.items())
        lines.append(f"  other sensors: {counts}")
    sampling = _describe_sampling(assessment)
    return Findings(summary | sampling.summary, lines + sampling.lines)


def _is_read(readings: xr.DataArray) -> np.ndarray:
    """Return in which samples (n) a sensor was read: all of its numbers, or its only one."""
    values = readings.values
    return np.asarray(np.isfinite(values.reshape(len(values), -1)).all(axis=1))


def _describe_panels(assessment: Assessment) -> Findings:
    """Return the findings on the panels: readings that are used, panels without signal, gains, albedo, numbers of lit sides."""
    craft, quality = assessment.vehicle, assessment.quality
    counts_by_reason = count_reasons(quality)
    names = quality["panel"].values.astype(str)
    # Panels without signal: `missed` are those without which the other panels do not account for the full Sun.
    silent, missed = quality["dead"].values, quality["missed"].values
    dead, unlit = names[missed].tolist(), names[silent & ~missed].tolist()
    complete = _complete_samples(assessment)
    lit_sides = _count_lit_sides(craft, assessment.telemetry, quality)[complete]
    summary: dict[str, Any] = {
        "worth": counts_by_reason,
        "dead_panels": dead,
        "unlit_panels": unlit,
        "full_sun": quality.attrs["full_sun"],
        "albedo": quality.attrs["albedo"],
        "samples_by_lit_faces": {k: int(n) for k, n in enumerate(np.bincount(lit_sides)) if n},
    }
    lines = [f"  {n:6d}  {text}" for text, n in counts_by_reason.items()]
    if dead:
        text = "no signal in any sample (failed, or never sunlit); excluded"
        lines.append(f"  panel {', '.join(dead)}: {text}")
    if unlit:
        text = "no signal (failed, or never sunlit; the other panels account for the full Sun); not used"
        lines.append(f"  panel {', '.join(unlit)}: {text}")
    # gain and sigma of each panel, relative to the gain in the vehicle file
    relative_gains = np.stack([quality["gain"].values, quality["gain_sigma"].values], axis=1)
    relative_gains = relative_gains / craft.input_gains[:, None]
    summary["gains"] = dict(zip(names.tolist(), relative_gains.tolist(), strict=True))
    summary["gains_from"] = quality.attrs["gains_from"]
    weak = quality["weak"].values
    # relative gain of the other panels, with which that of a weak panel is compared
    gain_of_others = np.median(relative_gains[~weak, 0]) if (~weak).any() else 1.0
    weak_pairs = (relative_gains[weak] / gain_of_others).tolist()  # gain and sigma
    summary["weak_panels"] = dict(zip(names[weak].tolist(), weak_pairs, strict=True))
    lines += [
        f"  WEAK PANEL: {name} gives {with_sigma(gain, sigma)} of what its gain in the vehicle file says, compared with the other "
        "panels; `sunspin calibrate-sensors` writes a copy with the gains of this file"
        for name, (gain, sigma) in summary["weak_panels"].items()
    ]
    gains = f"  gains: {quality.attrs['gains_from']}"
    if np.isfinite(quality.attrs["spread"]):  # the gains were estimated from the samples
        values = ", ".join(f"{name} {with_sigma(*pair)}" for name, pair in summary["gains"].items())
        gains = (
            f"  estimated gain / gain in the vehicle file, {quality.attrs['gains_from']}: {values}"
        )
    lines += [gains, *unknown_gain_lines(assessment)]
    lines.append(
        f"  albedo and stray light on unlit panels: up to {quality.attrs['albedo']:.0%} of full Sun"
    )
    counts = ", ".join(f"{k} in {n} samples" for k, n in summary["samples_by_lit_faces"].items())
    lit = "inputs" if craft.channels else "faces"
    if not complete.any():
        # each row has only some of the panels, which `_partial_rows_advice` reports
        return Findings(summary, lines)
    lines.append(
        f"  {lit} lit: {counts}; three determine the direction; `sunspin rates` also uses samples with one or two"
    )
    return Findings(summary, lines)


def _count_lit_sides(craft: Vehicle, samples: xr.Dataset, quality: Any) -> np.ndarray:
    """Return the number of lit sides in each sample (n).

    Panels with the same normal count as one side. If panels share inputs (channels), the number of lit inputs is returned.
    """
    # a panel is lit above the light of the Earth and above noise
    albedo = SURELY_LIT * quality.attrs["albedo"] * quality.attrs["full_sun"] * craft.input_gains
    threshold = np.maximum(albedo, LIT_SIGMAS * quality["noise"].values)
    lit = np.nan_to_num(signals(samples)) > threshold
    if craft.channels:
        return lit.sum(axis=1)
    # adding 0.0 turns -0.0 into 0.0, which would be another normal
    normals = np.round([panel.normal_B for panel in craft.panels], 6) + 0.0
    sides, side_of_panel = np.unique(normals, axis=0, return_inverse=True)
    lit_sides = [lit[:, side_of_panel.ravel() == k].any(axis=1) for k in range(len(sides))]
    return np.sum(lit_sides, axis=0)


def sampling_intervals(samples: xr.Dataset) -> np.ndarray:
    """Return the intervals (s) between samples; frames that arrive late or twice are not counted as samples."""
    # a late frame has the time of the latest one before it, and so counts once
    latest_time = np.maximum.accumulate(samples["time"].values)
    return np.diff(np.unique(latest_time))


def _complete_samples(assessment: Assessment) -> np.ndarray:
    """Return in which samples (n) every panel that works was read; a failed panel (`missed`) need not be."""
    quality = assessment.quality
    return np.asarray((quality["reading"].values | quality["missed"].values).all(axis=1))


def _shows_motion(assessment: Assessment) -> np.ndarray:
    """Return which samples (n) give information on the motion: panels in sunlight, or another sensor's direction or rate."""
    samples = assessment.telemetry
    shows = np.zeros(samples.sizes["time"], dtype=bool)
    if assessment.has_panels:
        status, usable = assessment.sun["status"].values, assessment.quality["reading"].values
        value = np.where(usable, signals(samples), np.nan)
        # the fraction is one of the panels that have a reading in any sample
        nearly_complete = usable.sum(axis=1) >= MOST_PANELS * usable.any(axis=0).sum()
        lit = (np.nan_to_num(value) > 0).any(axis=1)
        shows |= ~np.isin(status, (SunStatus.DARK, SunStatus.MISSING))
        # a sample that lacks a panel has no direction, but the others bound it
        shows |= (status == SunStatus.MISSING) & nearly_complete & lit
    for name in ("sun_B", "sun_sensor_B", *VARIABLES.values()):
        if name in samples:
            shows |= _is_read(assessment.sensors[name])
    return shows


def _describe_sampling(assessment: Assessment) -> Findings:
    """Return the findings on the rates that the sampling can resolve.

    Only samples with information on the motion count; copies and frozen samples do not.
    """
    samples = assessment.telemetry
    present = _shows_motion(assessment) & ~assessment.repeats.frozen
    gaps = sampling_intervals(samples.isel(time=present))
    if len(gaps) < 2:
        line = (
            f"  too few directions to estimate a rate: {present.sum()} of {count_text(present.size, 'sample')} give one"
            f"{_partial_rows_advice(samples)}"
        )
        return Findings({"directions": int(present.sum())}, [line])
    interval_s = float(np.median(gaps))
    # half a revolution per interval: a faster rotation gives the same directions as a slower one the other way round
    clear_rate = 180 / interval_s
    within_passes = gaps[gaps < PASS_INTERVALS * interval_s]
    jitter = float(np.std(within_passes) / interval_s)
    unambiguous = "are unambiguous (half a revolution between samples); faster rates alias"
    lines = [f"  sampling: rates up to {clear_rate:.3g} deg/s {unambiguous}"]
    # uneven intervals would distinguish rates that differ by a whole revolution per interval
    if jitter < EVEN_JITTER:
        text = f"rates that differ by {360 / interval_s:.3g} deg/s are indistinguishable (aliases)"
        lines.append(f"  even sampling: {text}")
    summary = {
        "directions": int(present.sum()),
        "clear_rate_deg_s": clear_rate,
        "relative_jitter": jitter,
    }
    return Findings(summary, lines)


def _apart_rows_lines(assessment: Assessment) -> list[str]:
    """Return a line if rows without panels lie close to rows with panels, as with a packet for each instrument; else none."""
    samples, span_s = assessment.telemetry, assessment.vehicle.telemetry.sample_span_s
    has_panels = np.isfinite(signals(samples)).any(axis=1)
    if span_s or not 2 <= has_panels.sum() <= (1 - APART_ROWS) * has_panels.size:
        return []
    t_s, with_panels = (
        samples["time"].values[~has_panels],
        np.sort(samples["time"].values[has_panels]),
    )
    interval_s = float(np.median(np.diff(with_panels)))
    # distance of each row without panels to the nearest row with panels
    after = np.clip(np.searchsorted(with_panels, t_s), 1, len(with_panels) - 1)
    apart_s = np.minimum(np.abs(t_s - with_panels[after - 1]), np.abs(with_panels[after] - t_s))
    if not 0 < np.median(apart_s) < APART_SHARE * interval_s:
        return []
    # other rows belong to no row with panels: it was lost, or the packet came after the pass
    near_s = apart_s[apart_s < APART_SHARE * interval_s]
    span_s = 1.2 * float(np.quantile(near_s, 0.95))
    return [
        f"  {len(near_s)} rows have no panel and lie {np.median(near_s):.2g} s from a row with panels (median): if they are "
        f"packets of one instant, set sample_span_s = {span_s:.2g} under [telemetry], and rows so close become one sample"
    ]


def _partial_rows_advice(samples: xr.Dataset) -> str:
    """Return advice, to be appended to a sentence, if each row has only some of the panels, as a row for each packet; else ""."""
    if "panel" not in samples.coords:
        return ""
    has_reading = np.isfinite(signals(samples))  # (sample, panel)
    most_in_row = int(has_reading.sum(axis=1).max(initial=0))
    panels = int(has_reading.any(axis=0).sum())  # that have a reading in any row
    if not 0 < most_in_row < MOST_PANELS * panels:
        return ""
    do = "set sample_span_s under [telemetry] to the time in which all are read"
    return f". A row has readings of {most_in_row} of {panels} panels at most: {do}"
