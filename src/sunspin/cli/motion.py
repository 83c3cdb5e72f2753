"""`sunspin simulate` and `sunspin scan`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

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

MAX_SAMPLES, BYTES_PER_SAMPLE = 2_000_000, 300
"""Output times of one trajectory, and what one takes while it is computed and written."""

MAX_ANGLE_RAD, SECONDS_PER_RAD = 1e6, 4e-6
"""How far a trajectory may turn (a day at 10 rad/s), and the time that takes: beyond, a slip of units is likelier than a wish."""

MAX_GRID = 100_000
"""Values of one axis of a scan's grid."""

WHEEL_MODE = "coast: motor off, friction slows the wheel; hold: the motor keeps its speed; brake: with the vehicle's brake torque."


@click.command()
@click.argument("vehicle")
@click.option("--omega", required=True, help="Body rate at the start, rad/s: x,y,z.")
@click.option("--sun", "sun_B", required=True, help="Unit vector to the Sun at the start, body axes: x,y,z.")
@click.option("--wheel-speed", help="Wheel speeds, rad/s, separated by commas; default: the vehicle's.")
@click.option("--duration", type=float, required=True, help="Length in s; negative runs backward.")
@click.option("--step", type=click.FloatRange(0, min_open=True), default=1.0, show_default=True, help="Output step in s.")
@click.option("--wheel-mode", type=click.Choice(["coast", "hold", "brake"]), default="coast", show_default=True, help=WHEEL_MODE)
@click.option("--stopped-at", type=float, help="When a wheel at rest had stopped, s (to run backward).")
@output_options()
def simulate(vehicle, omega, sun_B, wheel_speed, duration, step, wheel_mode, stopped_at, out, as_json, quiet) -> None:
    """One trajectory: body rates, the Sun in body axes, wheel speeds, attitude, wheel events.

    With --out, writes trajectory.nc.

    \b
    Example:
      sunspin simulate philae --omega 0.1,0,0 --sun 0.1959,0.5690,0.7986 --duration 2760 --out run
    """
    from sunspin.dynamics.propagate import propagate
    from sunspin.vehicle import load_vehicle

    craft = load_vehicle(vehicle)
    speeds = numbers(wheel_speed, "--wheel-speed") if wheel_speed else [wheel.speed_rad_s for wheel in craft.wheels]
    t = _times(duration, step)
    start = numbers(omega, "--omega", 3), numbers(sun_B, "--sun", 3)
    _check_work(craft, start[0], speeds, duration)
    run = propagate(craft, *start, speeds or None, t, wheel_mode=wheel_mode, stopped_at_s=stopped_at)
    end = run.isel(time=-1)
    events = [
        {"t_s": float(at), "wheel": str(name), "what": str(what)}
        for at, name, what in zip(
            run["event_time_s"].values, run["event_wheel"].values, run["event_what"].values, strict=True
        )
    ]
    summary: dict[str, Any] = {
        "t_s": float(t[-1]),
        "omega_B": end["omega_B"].values.tolist(),
        "sun_B": end["sun_B"].values.tolist(),
        "wheel_speed_rad_s": end["wheel_speed_rad_s"].values.tolist(),
        "events": events,
    }
    lines = [
        f"at t = {t[-1]:g} s: rate {_vector(summary['omega_B'])} rad/s, Sun {_vector(summary['sun_B'])}, "
        f"wheels {_vector(summary['wheel_speed_rad_s'])} rad/s",
        *(f"  {event['wheel']} {event['what']} at {event['t_s']:.3f} s" for event in events[:20]),
    ]
    if len(events) > 20:
        lines.append(f"  and {len(events) - 20} more wheel events")
    if out is not None:
        from sunspin.output.folder import results_folder, write_netcdf

        folder = results_folder(out, "simulate")
        lines += [f"Results: {write_netcdf(folder / 'trajectory.nc', run)}", store_run(folder, summary, vehicle)]
    report(summary, lines, as_json, quiet)


def _times(duration: float, step: float) -> np.ndarray:
    """Output times from 0 in steps to the duration, which is the last one whether or not it is a multiple of the step."""
    if not (np.isfinite(duration) and np.isfinite(step)):
        raise InputError(sentence("--duration and --step must be finite", got=f"{duration} s in steps of {step} s"))
    if abs(duration) / step > MAX_SAMPLES:
        raise InputError(
            sentence(
                f"{abs(duration) / step:.3g} output times are more than {MAX_SAMPLES:g} and would take some "
                f"{abs(duration) / step * BYTES_PER_SAMPLE / 1e9:.2g} GB of memory",
                got=f"{duration} s in steps of {step} s", do="use a larger --step",
            )
        )
    count = int(np.floor(abs(duration) / step + 1e-9))
    t = np.copysign(np.arange(count + 1) * step, duration)
    return np.append(t, duration) if abs(duration) > abs(t[-1]) * (1 + 1e-12) else t


def _check_work(craft, omega: list[float], speeds: list[float], duration: float) -> None:
    """Refuse a trajectory that turns unreasonably far, with an estimate of the time."""
    tensor = craft.require_inertia()
    if len(speeds) != len(craft.wheels):
        return  # said better where the trajectory begins
    with np.errstate(all="ignore"):
        spins = sum((wheel.inertia_kg_m2 * s * wheel.axis_B for wheel, s in zip(craft.wheels, speeds, strict=True)), np.zeros(3))
        rate = np.linalg.norm(tensor @ np.array(omega) + spins) / np.linalg.eigvalsh(tensor)[0]
    angle = float(max(rate, np.linalg.norm(omega)) * abs(duration))
    if angle > MAX_ANGLE_RAD:
        raise InputError(
            sentence(
                f"the body turns by up to {angle:.3g} rad in this time, more than {MAX_ANGLE_RAD:g}, which would take some "
                f"{angle * SECONDS_PER_RAD:.2g} s", got=f"{duration:g} s at {angle / abs(duration):.3g} rad/s",
                do="check the units, or run it in parts from Python (sunspin.propagate)",
            )
        )  # fmt: skip


def _vector(values: list[float]) -> str:
    return "[" + ", ".join(f"{value:.5g}" for value in values) + "]"


@click.command()
@click.argument("vehicle")
@click.argument("telemetry")
@click.option("--from", "begin", type=float, default=None, help="First time to use, s of the file's clock.")
@click.option("--to", "end", type=float, default=None, help="Last time to use.")
@click.option("--omega-x", default="-0.5:1:0.015", show_default=True, help="Grid of omega_x, rad/s: low:high:step, or "
              "values with commas.")
@click.option("--omega-y", default="-0.5:1:0.015", show_default=True, help="Grid of omega_y.")
@click.option("--omega-z", default="-0.3:0.3:0.015", show_default=True, help="Grid of omega_z.")
@click.option("--wheel-speed", help="Wheel speeds at the first sample used, rad/s; default: the vehicle's.")
@click.option("--wheel-mode", type=click.Choice(["coast", "hold", "brake"]), default="coast", show_default=True, help=WHEEL_MODE)
@click.option("--metric", type=click.Choice(["emd", "E"]), default="emd", show_default=True, help="emd compares the distributions "
              "of the Sun's height, whatever the timing; E compares direction by direction and wants a short window.")
@click.option("--factor", type=click.FloatRange(1, min_open=True), default=1.1, show_default=True, help="Near-minimum factor.")
@click.option("--threshold", type=click.FloatRange(0, min_open=True), help="Take the points below this value instead: one that was "
              "calibrated, such as by `sunspin worth`, makes the set a confidence region.")
@click.option("--direction-error", type=click.FloatRange(0, min_open=True), help="Error allowed of simulated directions at the "
              "end, rad. Default: for EMD, what an error of 1e-3 of the EMD allows, which is fastest; for E, 1e-3.")
@device_option
@click.option("--lines", "n_lines", type=click.IntRange(0, 20), default=4, show_default=True, help="Lines to fit; 0: none.")
@click.option("--store", type=click.Path(path_type=Path), help="Folder that keeps what is computed: after a crash, a power cut "
              "or Ctrl-C the same command goes on where it stopped. Other inputs need another folder.")
@click.option("--scheduler", metavar="ADDRESS", help="Run on a Dask cluster: tcp://host:8786, or `local` for --workers processes "
              "on this machine. Needs pip install \"sunspin[cluster]\".")
@output_options()
@run_options
@data_option
def scan(vehicle, telemetry, begin, end, omega_x, omega_y, omega_z, wheel_speed, wheel_mode, metric, factor, threshold,
         direction_error, n_lines, store, scheduler, device, out, as_json, quiet, seed, workers,
         data) -> None:  # fmt: skip
    """Scan initial rates: which motions show the Sun at the heights that the panels saw?

    The run begins at the first sample that gives a direction. With --out, writes scan.nc. A long scan can be stopped and
    resumed if it has a --store. The first run for a kind of vehicle compiles its kernel, for some ten seconds.

    \b
    Examples:
      sunspin scan vehicle.toml telemetry.csv --to 160 --omega-x=-0.1:0.1:0.02 --omega-y=-0.1:0.1:0.02 --omega-z=0:0.1:0.02
      sunspin scan philae philae --from 25140 --to 27900 --omega-x=-0.5:1:0.1 --store scan-rows --out scan-results
    """
    from sunspin.estimate.scan.lines import fit_lines
    from sunspin.estimate.scan.volume import below, near_minimum
    from sunspin.estimate.scan.volume import scan as run_scan
    from sunspin.output.folder import results_folder, write_netcdf
    from sunspin.telemetry.reader import read_telemetry
    from sunspin.vehicle import load_vehicle

    craft = load_vehicle(vehicle)
    samples = read_telemetry(find_telemetry(telemetry, data), craft)
    track = _track(craft, samples, begin, end)
    speeds = numbers(wheel_speed, "--wheel-speed") if wheel_speed else [wheel.speed_rad_s for wheel in craft.wheels]
    target = track if metric == "E" else track["sun_B"].values[:, 2]
    x, y, z = _grid(omega_x, "--omega-x"), _grid(omega_y, "--omega-y"), _grid(omega_z, "--omega-z")
    if not factor > 1:  # nan passes the range of the option
        raise InputError(sentence("--factor must exceed 1", got=factor))
    folder = None if out is None else results_folder(out, "scan")  # refuse before the work, not after it
    volume = run_scan(
        craft, target, track["sun_B"].values[0], x, y, z, speeds or None, float(track["time"].values[-1]),
        wheel_mode=wheel_mode, direction_error=direction_error, workers=workers, store=store, scheduler=scheduler,
        device=device, progress=on_terminal(quiet),
    )  # fmt: skip
    points = near_minimum(volume, factor) if threshold is None else below(volume, threshold)
    if not len(points):
        raise InputError(sentence("no motion of the grid comes below "
        "--threshold", got=threshold, do=f"the smallest is {float(volume.min()):.4f}"))
    summary: dict[str, Any] = {
        "metric": metric,
        "rows": int(volume.size),
        "minimum": float(volume.min()),
        "best_omega_B": points[np.argmin([volume.sel(_at(p), method="nearest").item() for p in points])].tolist(),
        "near_minimum_points": len(points),
    }
    lines = [
        f"{volume.size} motions against {track.sizes['time']} directions: smallest {metric} {summary['minimum']:.4f} at "
        f"{_vector(summary['best_omega_B'])} rad/s; {len(points)} points "
        + (f"within {factor:g} times it" if threshold is None else f"below {threshold:g}")
    ]
    if n_lines and len(points) >= 2 * n_lines:
        fitted = fit_lines(points, n_lines, seed=seed)
        summary["lines"] = [
            {"point": p.tolist(), "direction": d.tolist(), "points": int(c)}
            for p, d, c in zip(fitted["point"].values, fitted["direction"].values, fitted["count"].values, strict=True)
        ]
        lines += [f"  line through {_vector(x['point'])} along {_vector(x['direction'])}" for x in summary["lines"]]
    if folder is not None:
        lines.append(f"Results: {write_netcdf(folder / 'scan.nc', _stored(volume, points, factor, threshold))}")
        lines.append(store_run(folder, summary | {"seed": seed}, vehicle, samples))
    report(summary, lines, as_json, quiet)


def _stored(volume, points: np.ndarray, factor: float, threshold: float | None):
    """The scan with the points that were chosen from it."""
    said = {"units": "rad s-1"} | ({"factor": factor} if threshold is None else {"threshold": threshold})
    return volume.to_dataset().assign(near_minimum=(("near_point", "rate_axis"), points, said))


def _at(point: np.ndarray) -> dict[str, float]:
    return dict(zip(("omega_x", "omega_y", "omega_z"), point.tolist(), strict=True))


def _grid(text: str, name: str) -> np.ndarray:
    """low:high:step, or values separated by commas."""
    if ":" not in text:
        return np.array(numbers(text, name))
    from sunspin.estimate.scan.volume import check_size

    parts = text.split(":")
    if len(parts) != 3:
        raise InputError(sentence(f"{name} must be low:high:step", got=text, do=f"for example {name}=-0.1:0.1:0.02"))
    low, high, step = numbers(",".join(parts), name, 3)
    count = (high - low) / step + 1 if step > 0 and high >= low else np.nan
    if not np.isfinite(count):
        raise InputError(sentence(f"{name} must be low:high:step, finite and with a positive step", got=text))
    if count > MAX_GRID:
        check_size(count, 1, 1)
        raise InputError(sentence(f"{name} has {count:.3g} values, more than {MAX_GRID}", got=text, do="use a larger step"))
    return np.linspace(low, low + step * round((high - low) / step), round((high - low) / step) + 1)


def _track(craft, samples, begin: float | None, end: float | None):
    """The directions in the window, time counted from the first."""
    from sunspin.telemetry.sun import is_reconstructed, sun_directions

    sun = sun_directions(craft, samples)
    time = sun["time"].values
    low, high = -np.inf if begin is None else begin, np.inf if end is None else end
    use = is_reconstructed(sun["status"]) & (time >= low) & (time <= high)
    if use.sum() < 2:
        raise InputError(
            sentence(
                "fewer than two samples in this window give a direction of the Sun",
                got=f"{int(use.sum())} of {int(((time >= low) & (time <= high)).sum())} samples",
                do="widen --from and --to; `sunspin sun` says why samples give none",
                where=str(samples.attrs.get("file", "")),
            )
        )
    track = sun[["sun_B"]].isel(time=np.flatnonzero(use))
    return track.assign_coords(time=track["time"] - track["time"].values[0])
