"""`sunspin posterior`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from sunspin.base.errors import InputError, sentence
from sunspin.cli.common import (
    data_option,
    device_option,
    find_telemetry,
    numbers,
    on_terminal,
    output_options,
    report,
    run_options,
    store_run,
)


@click.command()
@click.argument("vehicle")
@click.argument("telemetry", required=False)
@click.option("--from", "begin", type=float, help="Use samples from this time on, s from the epoch.")
@click.option("--to", "end", type=float, help="Use samples up to this time, s from the epoch.")
@click.option("--phase", help="Use the samples of this phase of the file.")
@click.option("--prior", "priors", multiple=True, help="KEY=SIGMA, relative; 0: known. Keys: inertia, wheel_speed, wheel_inertia, "
              "friction, gain, noise, scale; also time_s, max_rate_rad_s, and in s how long "
              "before the first sample the wheels were released, wheel_off_s, with sigma wheel_off. Repeatable.")
@click.option("--rate", "rates", multiple=True, help="An angular speed seen otherwise: T,VALUE,SIGMA (s, rad/s). Repeatable.")
@click.option("--gyro", "gyros", multiple=True, help="A body rate seen otherwise: T,X,Y,Z,SIGMA (s, rad/s). Repeatable.")
@click.option("--field", "fields", multiple=True, help="A magnetic direction in the body, and its known angle from the Sun: "
              "T,X,Y,Z,ANGLE,SIGMA (s, 1, rad, rad). Repeatable.")
@click.option("--wheel-mode", type=click.Choice(["coast", "hold", "brake"]), default="coast", show_default=True,
              help="What the wheels do in this stretch.")
@click.option("--predict", help="Times at which to say what the body did, comma-separated: s from the epoch, or UTC such as 16:20 "
              "or 2014-11-12T16:20. Beyond a collision that a built-in case knows of, through it.")
@click.option("--draws", type=click.IntRange(100, 1_000_000), default=4000, show_default=True, help="Draws in the result.")
@click.option("--store", type=click.Path(path_type=Path), help="Folder that keeps what is computed: after a crash, a power cut "
              "or Ctrl-C the same command goes on where it stopped. Other inputs need another folder.")
@device_option
@output_options()
@run_options
@data_option
def posterior(vehicle, telemetry, begin, end, phase, priors, rates, gyros, fields, wheel_mode, predict, draws, store, device, out,
              as_json, quiet, seed, workers, data) -> None:  # fmt: skip
    """Every motion that the panel readings allow, with its probability, or the word that none fits.

    Uses all readings of one stretch of free motion, dark panels included. With --out, writes posterior.nc, corner.png,
    modes.csv, the likeliest motion of each region, and with --predict predicted.csv and predicted.png; `sunspin report` makes
    a page of them. Without TELEMETRY the case's own is used.

    \b
    Examples:
      sunspin posterior philae --predict 16:20,17:25 --out philae-posterior
      sunspin posterior vehicle.toml telemetry.csv --from 0 --to 900 --prior inertia=0.02 --store rows
    """
    from sunspin.estimate.posterior.estimate import posterior as run
    from sunspin.estimate.posterior.verdict import summary as told
    from sunspin.telemetry.reader import read_telemetry
    from sunspin.vehicle import load_vehicle

    craft = load_vehicle(vehicle)
    samples = _own(vehicle) if telemetry is None else read_telemetry(find_telemetry(telemetry, data), craft)
    seen = [_observation("rate", text, 1) for text in rates] + [_observation("gyro", text, 3) for text in gyros]
    seen += [_field(text) for text in fields]
    times = None if predict is None else _times(predict, samples.attrs.get("epoch_utc"))
    if out is not None:
        from sunspin.output.folder import results_folder

        results_folder(out, "posterior")  # refuse before the work, not after it
    tree = run(
        craft, samples, dict(_prior(text) for text in priors), seed, begin_s=begin, end_s=end, phase=phase, observations=seen,
        wheel_mode=wheel_mode, draws=draws, workers=workers, store=store, progress=on_terminal(quiet), device=device,
    )  # fmt: skip
    summary = told(tree)
    lines = _lines(summary, tree)
    if times is not None:
        summary["predicted"], more = _predicted(craft, tree, times, seed)
        lines += more
    if out is not None:
        folder = write(out, craft, tree)
        lines += [f"Results: {folder}", store_run(folder, summary, vehicle, samples)]
    report(summary, lines, as_json, quiet)


def _own(name: str) -> Any:
    from sunspin.telemetry.case import case_names, load_case

    if name not in case_names():
        raise InputError(sentence("TELEMETRY is missing", do="only a built-in case comes with its own"))
    return load_case(name).telemetry


def _prior(text: str) -> tuple[str, float]:
    key, _, value = text.partition("=")
    return key.strip(), numbers(value, f"--prior {key.strip()}", 1)[0]


def _observation(kind: str, text: str, count: int) -> dict[str, Any]:
    t, *value, sigma = numbers(text, f"--{kind}", count + 2)
    return {"kind": kind, "t_s": t, "value": value, "sigma": sigma}


def _field(text: str) -> dict[str, Any]:
    t, x, y, z, angle, sigma = numbers(text, "--field", 6)
    return {"kind": "field", "t_s": t, "value": [x, y, z], "angle_rad": angle, "sigma": sigma}


def _lines(summary: dict[str, Any], tree: Any) -> list[str]:
    lines = [summary["verdict"]]
    if summary["synthetic_telemetry"]:
        lines.append("  synthetic telemetry: not measured")
    rate = summary["rate_rad_s"]
    low, high = rate["low_90"], rate["high_90"]
    lines.append(f"  angular speed at the first sample {rate['median']:.4f} rad/s, 90 % in {low:.4f} to {high:.4f}")
    for mode in summary["modes"][:12]:
        omega, sigma = (", ".join(f"{x:.4f}" for x in mode[key]) for key in ("omega_B", "sigma"))
        fit = f"chi-square {mode['chi_square']:.0f}"
        lines.append(f"  weight {mode['weight']:.3f}  omega ({omega}) +- ({sigma}) rad/s  {fit}")
    worth = f"worth {summary['effective_draws']:.0f} draws, Pareto k {summary['pareto_k']:.2f}"
    lines.append(f"  predictive p {summary['p_value']:.3g}, {worth}")
    priors = json.loads(tree.attrs["priors"])
    lines.append("  priors, relative sigmas: " + ", ".join(f"{key} {what}" for key, what in priors.items()))
    return lines


def _times(text: str, epoch_utc: str | None) -> dict[float, str]:
    """s from the epoch -> what was asked for, in order of time."""
    from sunspin.vehicle.timeline import utc_seconds

    times = {}
    for part in (piece.strip() for piece in text.split(",")):
        if ":" not in part:
            times[numbers(part, "--predict", 1)[0]] = f"{part} s"
        elif epoch_utc is None:
            raise InputError(sentence("the telemetry has no epoch, so a time must be in s", got=part))
        else:
            utc = part if "T" in part else f"{epoch_utc[:10]}T{part}"
            times[utc_seconds(utc, epoch_utc)] = f"{utc.rstrip('Z')} UTC"
    return dict(sorted(times.items()))


def _predicted(vehicle: Any, tree: Any, times: dict[float, str], seed: int) -> tuple[list[dict[str, Any]], list[str]]:
    """Run the draws to the times; they become the group `predictions` of the tree. Rows of the table, and lines for a person."""
    import numpy as np
    import xarray as xr

    from sunspin.estimate.posterior.predict import intervals
    from sunspin.landing.afterwards import predicted

    found = predicted(vehicle, tree, list(times), seed)
    found = found.assign_coords(asked=("predicted_s", list(times.values())))
    tree["predictions"] = xr.DataTree(found)
    table, lines = intervals(found), []
    for i, label in enumerate(times.values()):
        row = {r["quantity"]: r for r in table if r["t_s"] == found["predicted_s"].values[i]}
        speed, lean, sun, off = (row[name] for name in ("rate", "z_to_momentum", "z_to_sun", "sun_off"))
        behind = ", after the collision" if found["after_collision"].values[i] else ""
        lines.append(f"  at {label}{behind} (90 % of the draws):")
        lines.append(f"    angular speed {speed['median']:.4f} rad/s ({speed['low_90']:.4f} to {speed['high_90']:.4f})")
        for name, angle in (("z from H", lean), ("z from the Sun", sun)):
            median, low, high = (np.degrees(angle[key]) for key in ("median", "low_90", "high_90"))
            lines.append(f"    {name} {median:.1f} deg ({low:.1f} to {high:.1f})")
        lines.append(f"    the Sun within {np.degrees(off['high_90']):.1f} deg of its mean direction in the body")
    if found.attrs["collision"].startswith("a leg"):
        lines.append(f"    collision: {found.attrs['collision']}")
    return table, lines


def write(out: Path, vehicle: Any, tree: Any) -> Path:
    """Write the posterior as NetCDF, its modes as CSV, the best motion of each, and a corner plot."""
    import pandas as pd

    from sunspin.estimate.posterior.motion import best_motions
    from sunspin.output.figures import save
    from sunspin.output.figures.posterior import corner_figure, search_figure
    from sunspin.output.folder import results_folder, write_netcdf, write_whole

    folder = results_folder(out, "posterior")
    write_netcdf(folder / "posterior.nc", tree)
    modes = tree["modes"]
    columns: dict[str, Any] = {"weight": modes["weight"].values, "log_evidence": modes["log_evidence"].values}
    for k, axis in enumerate("xyz"):
        columns[f"omega_{axis}_B_rad_s"] = modes["omega_B"].values[:, k]
        columns[f"sigma_{axis}_rad_s"] = modes["omega_cov_B"].values[:, k, k] ** 0.5
    columns |= {name: modes[name].values for name in ("chi_square", "lit_readings", "starts")}
    label = "# synthetic telemetry\n" if tree.attrs.get("synthetic") else ""
    text = label + pd.DataFrame(columns).to_csv(index=False, float_format="%.9g")
    write_whole(folder / "modes.csv", lambda part: part.write_text(text, "utf-8"))
    for run in best_motions(vehicle, tree):
        write_netcdf(folder / f"motion-region-{run.attrs['region']}.nc", run)
    save(corner_figure(tree), folder, "corner")
    save(search_figure(tree), folder, "search")
    if "predictions" in tree.children:
        from sunspin.estimate.posterior.predict import intervals
        from sunspin.output.figures.predicted import predicted_figure

        found = tree["predictions"].to_dataset()
        table = label + pd.DataFrame(intervals(found)).to_csv(index=False, float_format="%.9g")
        write_whole(folder / "predicted.csv", lambda part: part.write_text(table, "utf-8"))
        save(predicted_figure(found, [str(x) for x in found["asked"].values]), folder, "predicted")
    return folder
