"""`sunspin posterior`."""

from __future__ import annotations

import logging

import click

from sunspin.base.errors import InputError
from sunspin.cli.changes import Command, opened, say_idle, set_options
from sunspin.cli.common import shared
from sunspin.cli.values import Parsed, instants_of, observation, period, prior, times


@click.command(cls=Command)
@click.argument("vehicle")
@click.argument("telemetry", required=False)
@click.option("--phase", help="Use the samples of this phase of the file.")
@click.option(
    "--prior",
    "priors",
    type=Parsed(prior, "KEY=SIGMA"),
    multiple=True,
    help="Prior width, relative; 0 = fixed. Keys: inertia, wheel_speed, wheel_inertia, friction, gain, noise, scale; tilt, "
    "tilt_common (rad); time_s (s); max_rate_rad_s; steady_torque (rotation in deg that it may cause, 300 unless given). "
    "Repeatable.",
)
@click.option(
    "--rate-deg-s",
    "rates",
    type=Parsed(observation, "T,VALUE,SIGMA"),
    multiple=True,
    help="Extra observation of the angular speed, in s and deg/s. Repeatable.",
)
@click.option(
    "--gyro-deg-s",
    "gyros",
    type=Parsed(observation, "T,X,Y,Z,SIGMA"),
    multiple=True,
    help="Extra observation of the body rate, in s and deg/s. Repeatable.",
)
@click.option(
    "--field",
    "fields",
    type=Parsed(observation, "T,X,Y,Z,ANGLE,SIGMA"),
    multiple=True,
    help="Extra magnetic direction in body axes and its angle to the Sun (s, 1, rad, rad). Repeatable.",
)
@click.option(
    "--predict",
    help="Comma-separated times at which to predict the motion: s from the epoch, or UTC such as 16:20 or 2014-11-12T16:20. "
    "For Philae, later times include the collision.",
)
@click.option(
    "--draws", type=click.IntRange(100, 1_000_000), default=4000, help="Draws in the result."
)
@set_options("collision", short=("friction", "restitution", "damper"), idle=("hull", "antenna"))
@shared("--from", "--to", "--wheel-mode", "--period", "--store", "--seed", "--workers", "--data")
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
    **search,
) -> None:
    """Sample the posterior of one stretch of free motion: every solution that fits, with its probability, or none.

    Uses all readings, those of unlit panels included. With --out, writes posterior.nc, solutions.csv, passes.csv, the likeliest
    motion of each solution and figures; with --predict predicted.csv and predicted.png. Without TELEMETRY the case's own is used.

    \b
    Examples:
      sunspin posterior philae --predict 16:20,17:25 --out philae-posterior
      sunspin posterior vehicle.toml telemetry.csv --from 0 --to 900 --prior inertia=0.02 --store rows
    """
    from sunspin.cases import case_telemetry, timeline_of
    from sunspin.estimate.posterior.estimate import posterior as run
    from sunspin.landing.predictions import with_predictions
    from sunspin.telemetry.reader import read_telemetry

    if output.quiet:
        logging.getLogger("sunspin").setLevel(logging.ERROR)
    opening = opened(vehicle, changes)
    craft = opening.craft
    if predict is None:
        say_idle(opening.changes, ("body.mass_kg", "leg", "collision"))  # of a collision
    if telemetry is None and (telemetry := case_telemetry(vehicle)) is None:
        raise InputError("TELEMETRY is missing", do="only a built-in case comes with its own")
    samples = read_telemetry(telemetry, craft)
    epoch = samples.attrs.get("epoch_utc")
    asked = None if predict is None else times(predict, epoch)
    evidence = [period(text, epoch) for text in periods]
    first_s, last_s = instants_of(samples, begin, end)
    output.claim()
    tree = run(
        craft,
        samples,
        dict(priors),
        seed,
        begin_s=first_s,
        end_s=last_s,
        observations=[*rates, *gyros, *fields],
        workers=workers,
        **search,
        progress=output.progress,
        periods=evidence,
    )
    if asked is not None:
        collision, timeline = opening.assumptions.collision, timeline_of(vehicle)
        with_predictions(craft, tree, asked, seed, timeline, collision, workers)
    output.deliver(opening.mark(tree), opening.file, samples)
