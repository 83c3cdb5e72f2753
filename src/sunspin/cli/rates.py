"""`sunspin rates`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

from sunspin.cli.common import data_option, find_telemetry, output_options, report, store_run

UNUSED = {"gyro": "gyro_B", "magnetometer": "field_B", "attitude": "attitude_B_from_N", "wheels": "wheel_speed_rad_s"}
"""What `--without` may name, and the variable that it takes away."""


@click.command()
@click.argument("vehicle")
@click.argument("telemetry")
@output_options()
@data_option
@click.option("--source", type=click.Choice(["panels", "sun_sensor"]), help="Where the Sun comes from; default: what is there.")
@click.option("--max-rate", type=click.FloatRange(0, min_open=True), help="No rate is faster, deg/s; default: the vehicle's, "
              "else one and a half turns in the usual interval.")
@click.option("--noise", type=click.FloatRange(0, min_open=True), help="Angular acceleration noise, rad/s^1.5; default: the "
              "vehicle's, else what the data support best.")
@click.option("--gap", type=click.FloatRange(0, min_open=True), help="A longer gap parts two passes, s; default: six intervals.")
@click.option("--without", multiple=True, type=click.Choice(list(UNUSED)), help="Do not use this sensor; repeatable.")
def rates(vehicle, telemetry, out, as_json, quiet, data, source, max_rate, noise, gap, without) -> None:  # fmt: skip
    """Body rates and attitude history of each pass, from the Sun seen now and then.

    All motions that the data cannot tell apart are listed with their weights: whole turns more or less between samples, mirror
    images. With --out, writes rates.csv, rates.nc, rates.png and rates.svg.

    \b
    Example:
      sunspin rates skcube skcube/skcube_adcs.csv --without gyro --data DIR --out skcube-rates
    """
    from sunspin.estimate.rates.estimate import rates as run
    from sunspin.telemetry.reader import read_telemetry
    from sunspin.vehicle import load_vehicle

    craft = load_vehicle(vehicle)
    samples = read_telemetry(find_telemetry(telemetry, data), craft)
    used = samples.drop_vars([UNUSED[name] for name in without if UNUSED[name] in samples])
    if out is not None:
        from sunspin.output.folder import results_folder

        results_folder(out, "rates")  # refuse before the work, not after it
    result = run(
        craft, used, source=source, max_rate_rad_s=None if max_rate is None else float(np.radians(max_rate)),
        acceleration_noise=noise, gap_s=gap,
    )  # fmt: skip
    summary, lines = _summary(result)
    if out is not None:
        folder = write(out, result, samples)
        lines += [f"Results: {folder}", store_run(folder, summary, vehicle, samples)]
    report(summary, lines, as_json, quiet)


def _summary(result: Any) -> tuple[dict[str, Any], list[str]]:
    degrees = np.degrees
    passes, lines = [], [result.attrs["verdict"]]
    for k in range(result.sizes["pass_id"]):
        at = np.flatnonzero(result["pass_of"].values == k)
        t = result["time"].values[at]
        n = int(np.isfinite(result["weight"].values[k]).sum())
        sigma = degrees(result["omega_sigma_all_B"].values[k])
        mean = degrees(result["omega_mean_B"].values[k, :n])
        weight = result["weight"].values[k, :n]
        found = [{"weight": float(w), "omega_deg_s": m.tolist()} for w, m in zip(weight, mean, strict=True)]
        span = {"start_s": float(t[0]), "end_s": float(t[-1]), "samples": len(at)}
        passes.append(span | {"sigma_deg_s": sigma.tolist(), "modes": found})
        poor = "  FITS BADLY" if result["cost"].values[k, 0] > result["cost_limit"].values[k] else ""
        others = f", {n - 1} other{'s' if n > 2 else ''}" if n > 1 else ""
        digits = _digits(sigma)
        best = f"omega ({_row(mean[0], digits)}) +- ({_row(sigma, digits)}) deg/s  weight {weight[0]:.2f}{others}{poor}"
        lines.append(f"  {t[0]:10.0f} s  {len(at):3d} samples  {best}")
    texts, counts = np.unique(result["why"].values, return_counts=True)
    lines += [f"  {count:6d}  {text}" for text, count in zip(texts, counts, strict=True)]
    summary = {
        "verdict": result.attrs["verdict"], "source": result.attrs["source"], "passes": passes,
        "acceleration_noise": result.attrs["acceleration_noise"],
        "max_rate_deg_s": float(degrees(result.attrs["max_rate_rad_s"])),
        "samples": {str(text): int(count) for text, count in zip(texts, counts, strict=True)},
        "synthetic_telemetry": bool(result.attrs.get("synthetic", 0)),
    }  # fmt: skip
    return summary, lines


def _digits(sigma: np.ndarray) -> int:
    """Decimals that show the smallest error with one figure, two to five."""
    known = sigma[np.isfinite(sigma) & (sigma > 0)]
    return int(np.clip(-np.floor(np.log10(known.min())), 2, 5)) if len(known) else 2


def _row(values: np.ndarray, digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)


def write(out: Path, result: Any, samples: Any) -> Path:
    """Write rates as CSV, NetCDF and a figure."""
    import pandas as pd

    from sunspin.output.figures import save
    from sunspin.output.figures.rates import rates_figure
    from sunspin.output.folder import results_folder, write_netcdf, write_whole

    folder = results_folder(out, "rates")
    columns: dict[str, np.ndarray] = {"time_s": result["time"].values, "pass": result["pass_of"].values}
    for k, axis in enumerate("xyz"):
        columns[f"omega_{axis}_B_rad_s"] = result["omega_B"].values[:, k]
        columns[f"sigma_{axis}_rad_s"] = np.sqrt(result["omega_cov_B"].values[:, k, k])
    for k, axis in enumerate("xyz"):
        columns[f"sun_{axis}_B"] = result["sun_B"].values[:, k]
    for k, part in enumerate("xyzw"):
        columns[f"q_{part}_B_from_N"] = result["B_from_N"].values[:, k]
    label = "# synthetic telemetry\n" if result.attrs.get("synthetic") else ""
    head = f"{label}# time_s from {result.attrs.get('epoch_utc')}; best motion of each pass; body axes; N: z to the Sun, local\n"
    text = head + pd.DataFrame(columns).to_csv(index=False, float_format="%.9g")
    write_whole(folder / "rates.csv", lambda part: part.write_text(text, "utf-8"))
    write_netcdf(folder / "rates.nc", result)
    save(rates_figure(result, samples), folder, "rates")
    return folder
