"""`sunspin scan`."""

from __future__ import annotations

from collections.abc import Callable

import click

from sunspin.base.errors import InputError
from sunspin.cli.changes import LANDING_KEYS, Command, load_inputs, set_options, warn_unused
from sunspin.cli.common import POSITIVE, shared
from sunspin.cli.values import Parsed, parse_grid, parse_limits


def grid_option(axis: str, default: str) -> Callable:
    """Return the decorator for the option of the grid along one axis of the body rate."""
    help_text = f"Grid of omega_{axis} in deg/s: low:high:step, or comma-separated values."
    names = f"--omega-{axis}-deg-s", f"omega_{axis}"
    return click.option(*names, type=Parsed(parse_grid), default=default, help=help_text)


@click.command(cls=Command)
@click.argument("vehicle")
@click.argument("telemetry")
@grid_option("x", "-30:60:0.9")
@grid_option("y", "-30:60:0.9")
@grid_option("z", "-18:18:0.9")
@click.option(
    "--metric",
    type=click.Choice(["emd", "E"]),
    default="emd",
    help="emd: earth mover's distance of the distributions of r_z, times ignored. E: mean misfit of directions, for short windows.",
)
@click.option(
    "--threshold",
    type=POSITIVE,
    help="Select rates whose metric is below this value, not by --factor. Calibrated on simulations, it gives a confidence region.",
)
@click.option(
    "--direction-error",
    type=POSITIVE,
    help="Largest numerical error of the final Sun direction, rad. Default: 1e-3 for E; for emd, what keeps its error below 1e-3.",
)
@click.option(
    "--lines",
    "n_lines",
    type=click.IntRange(0, 20),
    default=4,
    help="Number of straight lines fitted to the selected rates, in the space of omega_x, omega_y, omega_z; 0: none.",
)
@set_options("study.mask", "study.target_weights", short=("friction",), idle=LANDING_KEYS)
@shared(
    *("--from", "--to", "--wheel-speed", "--wheel-mode", "--factor", "--store", "--scheduler"),
    *("--seed", "--workers", "--data"),
)
def scan(
    vehicle,
    telemetry,
    begin,
    end,
    wheel_speed,
    metric,
    factor,
    threshold,
    n_lines,
    changes,
    seed,
    output,
    **scan_options,
) -> None:
    """Scan a grid of initial body rates: which motions reproduce the measured r_z, the body-z component of the Sun direction?

    Motions begin at the first sample with a Sun direction. With --out, writes scan.nc. A scan with a --store can be interrupted
    and resumed. The first scan after the installation takes half a minute longer, to compile the integrators.

    \b
    Examples (the second with the built-in vehicle philae and its telemetry):
      sunspin scan vehicle.toml telemetry.csv --to 160 --omega-x-deg-s=-6:6:1 --omega-y-deg-s=-6:6:1 --omega-z-deg-s=0:6:1
      sunspin scan philae philae --from 25140 --to 27900 --omega-x-deg-s=-30:60:6 --store scan-rows --out scan-results
    """
    from sunspin.estimate.scan.directions import directions_within, target_weights
    from sunspin.estimate.scan.near_minimum import with_near_minimum
    from sunspin.estimate.scan.volume import Propagation
    from sunspin.estimate.scan.volume import scan as scan_rates
    from sunspin.telemetry.reader import read_telemetry

    inputs = load_inputs(vehicle, changes)
    craft, study = inputs.craft, inputs.assumptions.study
    if craft.telemetry.lit_threshold and not craft.channels:
        # the scan uses directions without their sigmas, and here the directions do not depend on the noise
        warn_unused(craft.changes, ("telemetry.noise",))
    samples = read_telemetry(telemetry, craft)
    directions = directions_within(craft, samples, *parse_limits(samples, begin, end))
    speeds = wheel_speed or [wheel.speed_rad_s for wheel in craft.wheels]
    if metric == "E" and inputs.assumptions.changes:
        what, do = "mask and target weights are those of EMD", "leave one of them out"
        raise InputError(what, got="--metric E", do=do)
    # the metric E compares directions at their times, EMD the distribution of their z components
    target, weights = directions, None
    if metric == "emd":
        target = directions["sun_B"].values[:, 2]
        weights = target_weights(study.target_weights, directions["time"].values)
    output.claim()
    # what then remains in `scan_options`: the grid (omega_x, omega_y, omega_z), store, executor and workers
    propagation = Propagation(scan_options.pop("wheel_mode"), scan_options.pop("direction_error"))
    volume = scan_rates(
        craft,
        target,
        directions["sun_B"].values[0],
        wheel_speed_rad_s=speeds or None,
        duration_s=float(directions["time"].values[-1]),
        propagation=propagation,
        weights=weights,
        mask=None if study.mask == "everywhere" else study.mask,
        progress=output.progress,
        **scan_options,
    )
    result = inputs.record_changes(
        with_near_minimum(volume, samples, factor, threshold, n_lines, seed)
    )
    output.deliver(result, inputs.file, samples, {"seed": seed}, main="scan.nc")
