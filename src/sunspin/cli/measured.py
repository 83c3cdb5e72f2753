"""`sunspin sun`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

from sunspin.cli.common import data_option, find_telemetry, output_options, report, store_run


@click.command()
@click.argument("vehicle")
@click.argument("telemetry")
@output_options()
@data_option
@click.option("--noise", type=click.FloatRange(0, min_open=True), help="One sigma of a panel's value, in W or A.")
@click.option("--lit-threshold", "threshold", type=click.FloatRange(0, min_open=True),
              help="A panel is lit above this, in W or A; default: the vehicle's, else from noise and light on dark faces.")
def sun(vehicle, telemetry, out, as_json, quiet, data, noise, threshold) -> None:
    """Directions to the Sun from panel powers or currents, each with its uncertainty or the reason why there is none.

    With --out, writes sun.csv, sun.nc, sun.png and sun.svg.

    \b
    Examples:
      sunspin sun vehicle.toml telemetry.csv --out sun-results
      sunspin sun philae philae
    """
    from sunspin.telemetry.quality import lit_threshold
    from sunspin.telemetry.reader import read_telemetry
    from sunspin.telemetry.sun import is_reconstructed, sun_directions
    from sunspin.vehicle import load_vehicle

    craft = load_vehicle(vehicle)
    samples = read_telemetry(find_telemetry(telemetry, data), craft)
    directions = sun_directions(craft, samples, noise=noise, lit_threshold=threshold or lit_threshold(craft, samples))
    told = is_reconstructed(directions["status"])
    sigma = directions["sigma_rad"].values[told]
    summary: dict[str, Any] = {
        "samples": int(told.size),
        "reconstructed": int(told.sum()),
        "status": counts(directions),
        "median_sigma_deg": float(np.degrees(np.median(sigma))) if sigma.size and np.isfinite(sigma).all() else None,
        "noise_from": directions.attrs["noise_from"],
        "synthetic_telemetry": bool(samples.attrs["synthetic"]),
    }
    lines = [f"{told.sum()} of {told.size} samples give a direction to the Sun", *status_lines(directions)]
    if summary["median_sigma_deg"] is not None:
        lines.append(f"  median uncertainty {summary['median_sigma_deg']:.2f} deg (noise: {summary['noise_from']})")
    if out is not None:
        folder = write(out, directions, samples)
        lines += [f"Results: {folder}", store_run(folder, summary, vehicle, samples)]
    report(summary, lines, as_json, quiet)


def counts(directions: Any) -> dict[str, int]:
    """Number of samples per status sentence."""
    texts, numbers = np.unique(directions["status_text"].values, return_counts=True)
    return dict(sorted(zip(texts.tolist(), numbers.tolist(), strict=True), key=lambda item: -item[1]))


def status_lines(directions: Any) -> list[str]:
    return [f"  {number:6d}  {text}" for text, number in counts(directions).items()]


def write(out: Path, directions: Any, samples: Any) -> Path:
    """Write directions as CSV, NetCDF and a figure."""
    from sunspin.output.figures import save, sun_directions_figure
    from sunspin.output.folder import results_folder, write_netcdf, write_whole

    folder = results_folder(out, "sun")
    table = directions[["sun_B", "delta", "sigma_rad", "status_text"]]
    flat = table.drop_vars("sun_B").drop_vars([name for name in ("panel", "axis") if name in table.coords], errors="ignore")
    frame = flat.to_dataframe()
    for k, axis in enumerate("xyz"):
        frame.insert(k, f"sun_{axis}_B", directions["sun_B"].values[:, k])
    frame.index.name = "time_s"
    label = "# synthetic telemetry\n" if samples.attrs["synthetic"] else ""
    head = f"{label}# time_s from {samples.attrs['epoch_utc']}; body axes; sigma_rad is the rms angle of the error\n"
    write_whole(folder / "sun.csv", lambda part: part.write_text(head + frame.to_csv(float_format="%.9g"), "utf-8"))
    write_netcdf(folder / "sun.nc", directions)
    save(sun_directions_figure(directions, samples), folder, "sun")
    return folder
