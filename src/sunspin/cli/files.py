"""`sunspin init` and `sunspin check`."""

from __future__ import annotations

import os
from importlib import resources
from pathlib import Path
from typing import Any

import click

from sunspin.base.errors import InputError, OutputError, sentence
from sunspin.cli.common import data_option, find_telemetry, output_options, report
from sunspin.cli.orbit import about_orbit, orbit_options

HEALTH_SAMPLES = 3000
"""Impossible lit patterns are explained on at most this many samples, evenly chosen: a day at 1 Hz must not take minutes."""

NOT_READ = "  directions, gains and lit faces say nothing while the readings are in a wrong unit; `--json` has them"

TEMPLATES = ("vehicle.toml", "telemetry.csv")


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@output_options(out=False)
def init(folder: Path, as_json: bool, quiet: bool) -> None:
    """Write a commented vehicle.toml and a telemetry.csv to start from. Existing files are never overwritten.

    \b
    Example:
      sunspin init my-satellite
      sunspin check my-satellite/vehicle.toml my-satellite/telemetry.csv
    """
    vehicle, telemetry = _write_templates(folder)
    lines = [f"Wrote {vehicle} and {telemetry} (synthetic samples).", f"Next: sunspin check {vehicle} {telemetry}"]
    report({"vehicle": str(vehicle), "telemetry": str(telemetry)}, lines, as_json, quiet)


def _write_templates(folder: Path) -> list[Path]:
    """Both files or none: what was written is taken back when the second cannot be."""
    source = resources.files("sunspin").joinpath("template")
    targets = [folder / name for name in TEMPLATES]
    for target in targets:
        if os.path.lexists(target):
            raise OutputError(sentence("this file is there already", do="choose another folder", where=str(target)))
    written: list[Path] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for target in targets:
            with open(target, "x", encoding="utf-8") as file:
                written.append(target)
                file.write(source.joinpath(target.name).read_text(encoding="utf-8"))
    except OSError as error:
        for target in written:
            target.unlink(missing_ok=True)
        raise OutputError(
            sentence(f"files cannot be written here ({error.strerror or error})", do="choose another folder", where=str(folder))
        ) from None
    return targets


@click.command()
@click.argument("vehicle")
@click.argument("telemetry", required=False)
@output_options(out=False)
@data_option
@orbit_options
def check(vehicle, telemetry, as_json, quiet, data, elements, shift_sigma) -> None:
    """Say what is wrong with a vehicle file and telemetry, or what they hold and what can be learnt from them.

    With orbital elements, say too whether the telemetry was taken in that orbit: whether strength of the field, its angle to the
    Sun and eclipses follow from it.

    \b
    Examples:
      sunspin check vehicle.toml telemetry.csv
      sunspin check philae philae
    """
    from sunspin.estimate.orbit.judged import elements_of
    from sunspin.vehicle import load_vehicle

    craft = load_vehicle(vehicle)
    elements_of(craft, elements, shift_sigma)  # what is wrong with them is said before the work
    summary, lines = _about_vehicle(craft)
    if telemetry is not None:
        samples, about, more = _about_telemetry(craft, find_telemetry(telemetry, data), vehicle)
        summary, lines = summary | {"telemetry": about}, lines + more
        about, more = about_orbit(craft, samples, elements, shift_sigma)
        summary, lines = summary | about, lines + more
    elif elements is not None:
        raise InputError(sentence("elements are compared with telemetry", do="give TELEMETRY too"))
    report(summary, lines, as_json, quiet)


def _about_vehicle(craft: Any) -> tuple[dict[str, Any], list[str]]:
    summary: dict[str, Any] = {
        "vehicle": craft.name,
        "panels": list(craft.panel_names),
        "wheels": [wheel.name for wheel in craft.wheels],
        "legs": [leg.name for leg in craft.legs],
        "inertia_given": craft.inertia_kg_m2 is not None,
        "without_source": sorted(key for key, fact in craft.facts.items() if fact.source is None),
    }
    parts = ", ".join(_counted(len(summary[key]), key[:-1]) for key in ("panels", "wheels", "legs"))
    known = "given" if summary["inertia_given"] else "not given (for `rates` a sphere; nothing can be simulated)"
    lines = [f"Vehicle {craft.name}: {parts}; inertia {known}"]
    if craft.panels:
        from sunspin.telemetry.sun import reconstructible_patterns
        from sunspin.vehicle.response.panels import lit_patterns

        summary |= {"lit_patterns": len(lit_patterns(craft)), "reconstructible": len(reconstructible_patterns(craft))}
        lines.append(
            f"  the Sun can light {summary['lit_patterns']} sets of panels; {summary['reconstructible']} of them give a direction"
        )
    if craft.channels:
        about = [f"{one.name} ({'the largest' if one.reads == 'largest' else 'the sum'} of {', '.join(one.panels)})"
                 for one in craft.channels]  # fmt: skip
        summary["channels"] = {one.name: list(one.panels) for one in craft.channels}
        copies = len(craft.response_in().images)
        alike = f", so that {copies} directions fit a sample alike" if copies > 1 else ""
        lines.append(f"  inputs of several panels: {'; '.join(about)}; which of them is lit is not told{alike}")
    bare = summary["without_source"]
    if bare:
        shown = ", ".join(bare[:3]) + (", ..." if len(bare) > 3 else "")
        lines.append(f"  {_counted(len(bare), 'value')} without a source: {shown}")
    return summary, lines


def _about_telemetry(craft: Any, path: Path, vehicle: str) -> tuple[Any, dict[str, Any], list[str]]:
    import numpy as np

    from sunspin.cli.check_words import doubts, intervals, worth
    from sunspin.telemetry.reader import FLAGS, read_telemetry
    from sunspin.vehicle.timeline import utc_after

    samples = read_telemetry(path, craft)
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
        "flags": {text: n for bit, text in FLAGS.items() if bit and (n := int(np.count_nonzero(flag & bit)))},
    }
    kind = "synthetic sample" if summary["synthetic"] else "sample"
    begin = utc_after(float(time.min()), summary["epoch_utc"]) if time.size else summary["epoch_utc"]
    lines = [f"Telemetry {path.name}: {_counted(time.size, kind)} over {summary['span_s']:.0f} s from {begin}"]
    if time.size and round(float(time[0])):
        lines.append(f"  times are counted from {summary['epoch_utc']}, {time.min():.0f} s before the first sample")
    if spread:
        lines.append("  {:.6g} s apart at least, {:.6g} s in the middle, {:.6g} s at most".format(*spread))
    for key, text in (("rows_sorted", "put in the order of time"), ("rows_merged", "repeats merged")):
        if key in samples.attrs:
            summary[key] = int(samples.attrs[key])
            lines.append(f"  {summary[key]:6d}  {text}")
    lines += [f"  {n:6d}  flagged: {text}" for text, n in summary["flags"].items()]
    about, more = doubts(craft, samples, vehicle)
    summary, lines = summary | about, lines + more
    if "panel" in samples.coords:
        about, more = _about_panels(craft, samples)
        summary, lines = summary | about, lines + ([NOT_READ] if summary["panels_misread"] else more)
    about, more = worth(craft, samples, summary["panels_misread"])
    return samples, summary | about, lines + more


def _about_panels(craft: Any, samples: Any) -> tuple[dict[str, Any], list[str]]:
    from sunspin.output.kinds.seen import health_lines, health_summary, status_counts, status_lines
    from sunspin.telemetry.health import noise_made, panel_health
    from sunspin.telemetry.quality import lit_threshold
    from sunspin.telemetry.sun import sun_directions

    threshold = lit_threshold(craft, samples)
    sun = sun_directions(craft, samples, lit_threshold=threshold)
    stride = -(-samples.sizes["time"] // HEALTH_SAMPLES)
    found = panel_health(craft, samples.isel(time=slice(None, None, stride)), lit_threshold=threshold)
    health = health_summary(found)
    summary = {
        "status": status_counts(sun), "noise_from": str(sun.attrs["noise_from"]),
        **{key: health[key] for key in ("impossible", "explanations", "noise_probability")},
        "noise_made": noise_made(found, -(-samples.sizes["time"] // stride)), "health_of_every": stride,
    }  # fmt: skip
    return summary, status_lines(sun) + health_lines(summary)


def _counted(n: int, noun: str) -> str:
    return f"{n} {noun}" + ("" if n == 1 else "s")


@click.command()
@click.argument("raw", type=click.Path(path_type=Path))
@click.option("--decoder", type=click.Choice(["skcube"]), default="skcube", show_default=True, help="Whose frames these are.")
@output_options(default="skcube")
def decode(raw: Path, decoder: str, out: Path, as_json: bool, quiet: bool) -> None:
    """Decode raw beacons of skCUBE, a table for each kind of beacon: skcube_adcs.csv, skcube_pwr.csv and so on.

    RAW is a folder or zip of frames as the collector publishes them, or an export of frames from SatNOGS DB (CSV or JSON). Beacons
    of a kind whose fields are not published are written in hexadecimal digits, to skcube_other.csv.

    \b
    Example:
      sunspin decode skcube_raw_23_27_june.zip --out skcube
    """
    from sunspin.output.folder import results_folder, write_whole
    from sunspin.telemetry.decoders.skcube import beacons_csv, decode_beacons

    beacons = decode_beacons(raw)
    folder = results_folder(out, "decode")
    files: dict[str, str] = {}
    for kind in beacons.rows:
        text, target = beacons_csv(beacons, kind), folder / f"{decoder}_{kind.lower()}.csv"
        files[kind] = str(write_whole(target, lambda part, text=text: part.write_text(text, "utf-8")))
    lines = [f"{n:6d}  {kind} beacons: {files[kind]}" for kind, n in beacons.kinds.items()]
    lines += [f"{n:6d}  not read: {why}" for why, n in beacons.unread.items()]
    attitude = {"attitude_beacons": beacons.kinds.get("ADCS", 0), "file": files.get("ADCS")}
    report({"frames": beacons.kinds, "unread": beacons.unread, "files": files, **attitude}, lines, as_json, quiet)
