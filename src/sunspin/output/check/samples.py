"""What `sunspin check` says of the samples' worth: which are usable and why, how many faces, what rates the sampling can tell."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from sunspin.estimate.rates.gyro_axes import wrong_gyro_axes
from sunspin.output.text import counted, size_text, with_sigma
from sunspin.telemetry.assess import Assessment
from sunspin.telemetry.noise import ASSUMED_FROM, ASSUMED_SHARE
from sunspin.telemetry.quality import SURELY_LIT, count_reasons
from sunspin.telemetry.sun import LIT_SIGMAS, SunStatus, signals
from sunspin.telemetry.units import reading_unit
from sunspin.vehicle import Vehicle
from sunspin.vehicle.file import find_line, read_vehicle_text
from sunspin.vehicle.sensors import VARIABLES

SHOWN = 30
"""Columns listed by name."""

MOST_PANELS = 2 / 3
"""A row without readings of all panels shows the Sun if it has this part of them: five of six bound its direction, two leave it
open. Rows of one packet among several have a half or a third."""


def doubts(assessment: Assessment, vehicle: str | None = None) -> tuple[dict[str, Any], list[str]]:
    """Summary and lines on what file and vehicle file do not share: units, sensors, columns; `vehicle` is that file."""
    units, samples = [], assessment.telemetry
    for wrong in assessment.wrong_units:
        line, key = None, wrong.key.split(" or ")[0].split(",")[0]
        if vehicle is not None:
            line = find_line(read_vehicle_text(vehicle), wrong.table, key)
        units.append(wrong.at(f", line {line[0]} ({line[1][:60]}),") if line else str(wrong))
    unused = [name for name in samples.attrs["unused_columns"].split(", ") if name]
    missing = [name for name in samples.attrs["missing_sensors"].split("; ") if name]
    lines = [f"  WRONG UNIT: {text}" for text in units]
    gyro_misread = any(wrong.table == "gyro" for wrong in assessment.wrong_units)
    axes = None if gyro_misread else wrong_gyro_axes(assessment)
    lines += [f"  WRONG AXES: {axes}"] if axes else []
    lines += [f"  sensors without columns in this file: {', '.join(missing)}"] if missing else []
    more = f" and {len(unused) - SHOWN} more" if len(unused) > SHOWN else ""
    lines += [f"  unused columns: {', '.join(unused[:SHOWN])}{more}"] if unused else []
    misread = any(
        wrong.table == "telemetry" and wrong.key.startswith("scale")
        for wrong in assessment.wrong_units
    )
    summary: dict[str, Any] = {"wrong_units": units, "wrong_axes": [axes] if axes else []}
    summary |= {"panels_misread": misread, "missing_sensors": missing, "unused_columns": unused}
    return summary, lines


def noise_lines(assessment: Assessment) -> list[str]:
    """Return what the error of directions from panels rests on; nothing if the vehicle file states one noise for all panels."""
    sun = assessment.sun
    noise, source = float(sun.attrs["noise"]), str(sun.attrs["noise_from"])
    own = dict(zip(sun["panel"].values, sun["noise"].values, strict=True))
    if not np.isfinite(noise) or (source == "given" and len({*own.values()}) == 1):
        return []
    known = reading_unit(assessment.vehicle, signals(assessment.telemetry))
    unit = f" {known}" if known else " (in the unit of the readings)"
    if source == "given":
        each = ", ".join(f"{panel} {size_text(sigma)}" for panel, sigma in own.items())
        return [f"  noise of panel readings, from the vehicle file: {each}{unit}"]
    if source != ASSUMED_FROM:
        return [f"  noise of panel readings: {size_text(noise)}{unit}, {source}"]
    return [
        f"  NOISE NOT STATED: neither the vehicle file nor the samples give the noise of panel readings; {size_text(noise)}{unit}, "
        f"{ASSUMED_SHARE:.0%} of full Sun, is assumed for directions. Write what you know of it, or "
        f"`noise = {size_text(noise)}`, under [telemetry] of the vehicle file"
    ]


def worth(assessment: Assessment, misread: bool = False) -> tuple[dict[str, Any], list[str]]:
    """Summary and lines on quality of the panel readings, on other sensors, and on sampling against rate; of panels `misread`, in a
    wrong unit, no lines on what their numbers would mean."""
    summary: dict[str, Any] = {}
    lines: list[str] = []
    samples = assessment.telemetry
    if assessment.has_panels:
        about, lines = _panels(assessment)
        summary |= about
        lines = [f"  {n:6d}  {text}" for text, n in about["worth"].items()] if misread else lines
    alone = {variable: name.replace("_", " ") for name, variable in VARIABLES.items()}
    sensors = {"sun_sensor_B": "Sun sensors"} | alone | {"wheel_speed_rad_s": "wheel speeds"}
    there = {
        label: int(np.isfinite(samples[name].values).all(axis=1).sum())
        for name, label in sensors.items()
        if name in samples
    }
    if there:
        summary["sensors"] = there
        others = ", ".join(f"{label} ({n} samples)" for label, n in there.items())
        lines.append(f"  other sensors: {others}")
    about, more = _sampling(assessment)
    return summary | about, lines + more


def _panels(assessment: Assessment) -> tuple[dict[str, Any], list[str]]:
    craft, quality = assessment.vehicle, assessment.quality
    why = count_reasons(quality)
    names = quality["panel"].values.astype(str)
    silent, missed = quality["dead"].values, quality["missed"].values
    dead, unlit = names[missed].tolist(), names[silent & ~missed].tolist()
    whole = _whole(assessment)
    faces = np.bincount(_lit(craft, assessment.telemetry, quality)[whole])
    summary: dict[str, Any] = {
        "worth": why,
        "dead_panels": dead,
        "unlit_panels": unlit,
        "full_sun": quality.attrs["full_sun"],
        "albedo": quality.attrs["albedo"],
        "samples_by_lit_faces": {int(k): int(n) for k, n in enumerate(faces) if n},
    }
    lines = [f"  {n:6d}  {text}" for text, n in why.items()]
    if dead:
        text = "no signal in any sample (failed, or never sunlit); excluded"
        lines.append(f"  panel {', '.join(dead)}: {text}")
    if unlit:
        text = (
            "no signal, probably never sunlit (the other panels account for the full Sun); not used"
        )
        lines.append(f"  panel {', '.join(unlit)}: {text}")
    pairs = np.stack([quality["gain"].values, quality["gain_sigma"].values], axis=1)
    pairs = pairs / craft.input_gains[:, None]
    summary["gains"] = dict(zip(names.tolist(), pairs.tolist(), strict=True))
    summary["gains_from"] = quality.attrs["gains_from"]
    weak = quality["weak"].values
    usual = np.median(pairs[~weak, 0]) if (~weak).any() else 1.0
    weak_pairs = (pairs[weak] / usual).tolist()
    summary["weak_panels"] = dict(zip(names[weak].tolist(), weak_pairs, strict=True))
    lines += [
        f"  WEAK PANEL: {name} gives {with_sigma(g, s)} of what its gain in the vehicle file says, compared with the other panels; "
        "`sunspin calibrate-sensors` writes a copy with the gains of this file"
        for name, (g, s) in summary["weak_panels"].items()
    ]
    gains = f"  gains: {quality.attrs['gains_from']}"
    if np.isfinite(quality.attrs["spread"]):
        each = ", ".join(f"{name} {with_sigma(*pair)}" for name, pair in summary["gains"].items())
        gains = (
            f"  estimated gain / gain in the vehicle file, {quality.attrs['gains_from']}: {each}"
        )
    lines.append(gains)
    lines.append(
        f"  albedo and stray light on unlit panels: up to {quality.attrs['albedo']:.0%} of full Sun"
    )
    often = ", ".join(f"{k} in {n} samples" for k, n in summary["samples_by_lit_faces"].items())
    lit = "inputs" if craft.channels else "faces"
    if not whole.any():
        return summary, lines  # of parts of a frame: `_sampling` says so
    lines.append(
        f"  {lit} lit: {often}; three determine the direction; `sunspin rates` also uses samples with one or two"
    )
    return summary, lines


def _lit(craft: Vehicle, samples: xr.Dataset, quality: Any) -> np.ndarray:
    """How many faces (n) are lit, panels of one face counting once; with channels how many inputs."""
    light = SURELY_LIT * quality.attrs["albedo"] * quality.attrs["full_sun"] * craft.input_gains
    floor = np.maximum(light, LIT_SIGMAS * quality["noise"].values)
    lit = np.nan_to_num(signals(samples)) > floor
    if craft.channels:
        return lit.sum(axis=1)
    _, face = np.unique(
        np.round([panel.normal_B for panel in craft.panels], 6) + 0.0, axis=0, return_inverse=True
    )
    return (lit.astype(int) @ np.eye(face.max() + 1, dtype=int)[face.ravel()] > 0).sum(axis=1)


def intervals(samples: xr.Dataset) -> np.ndarray:
    """Intervals (s) between the samples whose time is in order; late and repeated frames are no samples."""
    latest = np.unique(np.maximum.accumulate(samples["time"].values))
    return np.diff(latest)


def _whole(assessment: Assessment) -> np.ndarray:
    """Return the samples (n) in which every panel was read that works."""
    quality = assessment.quality
    return np.asarray((quality["reading"].values | quality["missed"].values).all(axis=1))


def _shows_motion(assessment: Assessment) -> np.ndarray:
    """Return which samples (n) say something of the motion: panels show the Sun, or a sensor gives a direction or a rate."""
    samples = assessment.telemetry
    shows = np.zeros(samples.sizes["time"], dtype=bool)
    if assessment.has_panels:
        status, read = assessment.sun["status"].values, assessment.quality["reading"].values
        value = np.where(read, signals(samples), np.nan)
        # of the panels that have a reading anywhere: a column that is always empty hides nothing
        complete = read.sum(axis=1) >= MOST_PANELS * read.any(axis=0).sum()
        lit = (np.nan_to_num(value) > 0).any(axis=1)
        shows |= ~np.isin(status, (SunStatus.DARK, SunStatus.MISSING))
        shows |= (status == SunStatus.MISSING) & complete & lit
    for name in ("sun_B", "sun_sensor_B", *VARIABLES.values()):
        if name in samples:
            shows |= np.isfinite(assessment.sensors[name].values).all(axis=1)
    return shows


def _sampling(assessment: Assessment) -> tuple[dict[str, Any], list[str]]:
    """Return summary and lines on the rates that the sampling can determine. Rows without a direction are no samples of the
    motion, so they do not count, and
    neither do copies and frozen ones."""
    samples = assessment.telemetry
    present = _shows_motion(assessment) & ~assessment.repeats.frozen
    gaps = intervals(samples.isel(time=present))
    if len(gaps) < 2:
        return {"directions": int(present.sum())}, [
            f"  too few directions to estimate a rate: {present.sum()} of {counted(present.size, 'sample')} give one"
            f"{_parts_of_panels(samples)}"
        ]
    usual = float(np.median(gaps))
    clear = 180 / usual
    near = gaps[gaps < 6 * usual]
    jitter = float(np.std(near) / usual)
    unambiguous = "are unambiguous (half a revolution between samples); faster rates alias"
    lines = [f"  sampling: rates up to {clear:.3g} deg/s {unambiguous}"]
    if jitter < 0.02:
        text = f"rates that differ by {360 / usual:.3g} deg/s are indistinguishable (aliases)"
        lines.append(f"  even sampling: {text}")
    return {
        "directions": int(present.sum()),
        "clear_rate_deg_s": clear,
        "relative_jitter": jitter,
    }, lines


def _parts_of_panels(samples: xr.Dataset) -> str:
    """Return what to do if no row has a reading of every panel, as in a file with a row for each packet; else nothing."""
    if "panel" not in samples.coords:
        return ""
    read = np.isfinite(signals(samples))
    most, panels = int(read.sum(axis=1).max(initial=0)), int(read.any(axis=0).sum())
    if not 0 < most < MOST_PANELS * panels:
        return ""
    return f". A row has readings of {most} of {panels} panels at most: write the readings of one time in one row"
