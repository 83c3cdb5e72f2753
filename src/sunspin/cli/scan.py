"""`sunspin scan`."""

from __future__ import annotations

import click

from sunspin.base.errors import InputError, sentence
from sunspin.cli.changes import LANDING, Changeable, opened, say_idle, set_options
from sunspin.cli.common import (
    claim,
    data_option,
    deliver,
    factor_option,
    find_telemetry,
    on_terminal,
    output_options,
    run_options,
    store_option,
    wheel_mode_option,
)
from sunspin.cli.values import grid, instants_of, numbers


@click.command(cls=Changeable)
@click.argument("vehicle")
@click.argument("telemetry")
@click.option("--from", "begin", help="First time to use: UTC, or s from the epoch.")
@click.option("--to", "end", help="Last time to use, likewise.")
@click.option(
    "--omega-x",
    default="-0.5:1:0.015",
    show_default=True,
    help="Grid of omega_x, rad/s (0.1 rad/s: 5.73 deg/s): low:high:step, or values with commas.",
)
@click.option(
    "--omega-y", default="-0.5:1:0.015", show_default=True, help="Grid of omega_y, rad/s."
)
@click.option(
    "--omega-z", default="-0.3:0.3:0.015", show_default=True, help="Grid of omega_z, rad/s."
)
@click.option(
    "--wheel-speed", help="Wheel speeds at the first sample used, rad/s; default: the vehicle's."
)
@wheel_mode_option()
@click.option(
    "--metric",
    type=click.Choice(["emd", "E"]),
    default="emd",
    show_default=True,
    help="emd compares the distributions "
    "of the Sun's height, whatever the timing; E compares direction by direction and wants a short window.",
)
@factor_option
@click.option(
    "--threshold",
    type=click.FloatRange(0, min_open=True),
    help="Take the points below this value instead: one that was "
    "calibrated on simulated flights of known truth makes the set a confidence region.",
)
@click.option(
    "--direction-error",
    type=click.FloatRange(0, min_open=True),
    help="Error allowed of simulated directions at the "
    "end, rad. Default: for EMD, what an error of 1e-3 of the EMD allows, which is fastest; for E, 1e-3.",
)
@click.option(
    "--lines",
    "n_lines",
    type=click.IntRange(0, 20),
    default=4,
    show_default=True,
    help="Lines to fit; 0: none.",
)
@store_option()
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Run on a Dask cluster: tcp://host:8786, or `local` for --workers processes "
    'on this machine. Needs pip install "sunspin[cluster]".',
)
@set_options("study.mask", "study.target_weights", short=("friction",), idle=LANDING)
@output_options()
@run_options
@data_option
def scan(
    vehicle,
    telemetry,
    begin,
    end,
    omega_x,
    omega_y,
    omega_z,
    wheel_speed,
    wheel_mode,
    metric,
    factor,
    threshold,
    direction_error,
    n_lines,
    store,
    scheduler,
    sets,
    friction,
    out,
    as_json,
    quiet,
    seed,
    workers,
    data,
) -> None:
    """Scan initial rates: which motions show the Sun at the heights that the panels saw?

    The run begins at the first sample that gives a direction. With --out, writes scan.nc. A long scan can be stopped and
    resumed if it has a --store. The first run for a kind of vehicle compiles its kernel, for some twenty seconds, unless
    `sunspin compile` has done so.

    \b
    Examples:
      sunspin scan vehicle.toml telemetry.csv --to 160 --omega-x=-0.1:0.1:0.02 --omega-y=-0.1:0.1:0.02 --omega-z=0:0.1:0.02
      sunspin scan philae philae --from 25140 --to 27900 --omega-x=-0.5:1:0.1 --store scan-rows --out scan-results
    """
    from sunspin.estimate.scan.chosen import with_chosen
    from sunspin.estimate.scan.volume import scan as run_scan
    from sunspin.estimate.scan.window import directions_within, target_weights
    from sunspin.telemetry.reader import read_telemetry

    made = opened(vehicle, sets, {"friction": friction}, {"wheel_speed": wheel_speed})
    craft, study = made.craft, made.assumptions.study
    if (
        craft.telemetry.lit_threshold and not craft.channels
    ):  # then directions do not depend on the noise, only their sigmas do
        say_idle(craft.changes, ("telemetry.noise",))
    samples = read_telemetry(find_telemetry(telemetry, data), craft)
    track = directions_within(craft, samples, *instants_of(samples, begin, end))
    speeds = (
        numbers(wheel_speed, "--wheel-speed")
        if wheel_speed
        else [wheel.speed_rad_s for wheel in craft.wheels]
    )
    if metric == "E" and made.assumptions.changes:
        raise InputError(
            sentence(
                "mask and target weights are those of EMD",
                got="--metric E",
                do="leave one of them out",
            )
        )
    target = track if metric == "E" else track["sun_B"].values[:, 2]
    x, y, z = grid(omega_x, "--omega-x"), grid(omega_y, "--omega-y"), grid(omega_z, "--omega-z")
    if not factor > 1:  # nan passes the range of the option
        raise InputError(sentence("--factor must exceed 1", got=factor))
    claim(out, "scan")
    volume = run_scan(
        craft,
        target,
        track["sun_B"].values[0],
        x,
        y,
        z,
        speeds or None,
        float(track["time"].values[-1]),
        wheel_mode=wheel_mode,
        direction_error=direction_error,
        workers=workers,
        store=store,
        scheduler=scheduler,
        progress=on_terminal(quiet),
        mask=None if study.mask == "everywhere" else study.mask,
        weights=None
        if metric == "E"
        else target_weights(study.target_weights, track["time"].values),
    )
    found = made.mark(with_chosen(volume, samples, factor, threshold, n_lines, seed))
    deliver(found, out, as_json, quiet, made.file, samples, {"seed": seed}, main="scan.nc")
