"""`sunspin posterior`."""

from __future__ import annotations

import logging
from collections.abc import Callable

import click

from sunspin.base.errors import InputError
from sunspin.cli.changes import Command, load_inputs, set_options, warn_unused
from sunspin.cli.common import shared
from sunspin.cli.values import (
    Parsed,
    parse_limits,
    parse_observation,
    parse_period,
    parse_prior,
    parse_times,
)


def observation_option(name: str, text_type: Parsed, about: str) -> Callable:
    """Return the decorator for the repeatable option --`name` of an observation of the quantity `about`.

    The command receives it in the plural of the first word of its name: rates, gyros or fields.
    """
    parameter = f"{name.partition('-')[0]}s"
    help_text = f"Extra observation of the {about}. Repeatable."
    return click.option(f"--{name}", parameter, type=text_type, multiple=True, help=help_text)


@click.command(cls=Command)
@click.argument("vehicle")
@click.argument("telemetry", required=False)
@click.option("--phase", help="Use only the samples with this value in the `phase` column.")
@click.option(
    "--prior",
    "priors",
    type=Parsed(parse_prior, "KEY=SIGMA"),
    multiple=True,
    help="Prior 1-sigma, relative; 0 = fixed. Keys: inertia, wheel_speed, wheel_inertia, friction, gain (of each panel), noise, "
    "scale (of all panels). In rad: tilt (of each panel), tilt_common (of all). In s: time_s (of each sample). Upper limits: "
    "max_rate_rad_s; steady_torque (rotation in deg that it causes, default 300). Repeatable.",
)
@observation_option(
    "rate-deg-s", Parsed(parse_observation, "T,VALUE,SIGMA"), "angular speed, in s and deg/s"
)
@observation_option(
    "gyro-deg-s", Parsed(parse_observation, "T,X,Y,Z,SIGMA"), "body rate, in s and deg/s"
)
@observation_option(
    "field",
    Parsed(parse_observation, "T,X,Y,Z,ANGLE,SIGMA"),
    "magnetic direction X,Y,Z in body axes (any length), with its ANGLE to the Sun and SIGMA of the angle, rad",
)
@click.option(
    "--predict",
    help="Comma-separated times at which to predict the motion: seconds from the epoch, or UTC such as 17:25 or 2014-11-12T17:25. "
    "For Philae, times after the collision (16:20) include its effect.",
)
@click.option(
    "--draws", type=click.IntRange(100, 1_000_000), default=4000, help="Draws in the result."
)
@set_options("collision", short=("friction", "restitution", "damper"), idle=("hull", "antenna"))
@shared("--from", "--to", "--wheel-mode", "--period", "--seed", "--workers", "--data")
def posterior(
    vehicle,
    telemetry,
    begin,
    end,
    priors,
    rates,
    gyros,
    fields,
    predict,
    periods,
    changes,
    seed,
    workers,
    output,
    **sampling_options,
) -> None:
    """Sample the posterior of a stretch of motion without impacts: each solution that fits and its probability, or that none fits.

    Uses all readings, also of unlit panels. Without TELEMETRY that of the built-in vehicle is used. --out writes posterior.nc,
    solutions.csv, passes.csv, the likeliest motion of each solution and figures; with --predict predicted.csv and predicted.png.

    \b
    Examples:
      sunspin posterior philae --predict 16:20,17:25 --out philae-posterior
      sunspin posterior vehicle.toml telemetry.csv --from 0 --to 900 --prior inertia=0.02 --out posterior
    """
    output.draw_in_background("posterior", workers)
    from sunspin.cases import case_telemetry_path, read_timeline
    from sunspin.estimate.posterior import posterior as sample_posterior
    from sunspin.landing.predictions import add_predictions
    from sunspin.telemetry.reader import read_telemetry

    if output.quiet:
        logging.getLogger("sunspin").setLevel(logging.ERROR)
    inputs = load_inputs(vehicle, changes)
    craft = inputs.craft
    if predict is None:
        # without predictions after the collision, nothing uses its parameters
        warn_unused(inputs.changes, ("body.mass_kg", "leg", "collision"))
    if telemetry is None and (telemetry := case_telemetry_path(vehicle)) is None:
        raise InputError("TELEMETRY is missing", do="only a built-in case comes with its own")
    samples = read_telemetry(telemetry, craft)
    epoch = samples.attrs.get("epoch_utc")
    predicted_times = None if predict is None else parse_times(predict, epoch)
    observed_periods = [parse_period(text, epoch) for text in periods]
    first_s, last_s = parse_limits(samples, begin, end)
    output.claim()
    # `sampling_options`: phase, draws and wheel_mode
    tree = sample_posterior(
        craft,
        samples,
        dict(priors),
        seed,
        begin_s=first_s,
        end_s=last_s,
        observations=[*rates, *gyros, *fields],
        workers=workers,
        **sampling_options,
        progress=output.progress,
        periods=observed_periods,
    )
    if predicted_times is not None:
        collision, timeline = inputs.assumptions.collision, read_timeline(vehicle)
        add_predictions(craft, tree, predicted_times, seed, timeline, collision, workers)
    output.deliver(inputs.record_changes(tree), inputs.file, samples)
