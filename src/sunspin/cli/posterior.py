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
    type=Parsed(prior),
    multiple=True,
    help="KEY=SIGMA, relative; 0: known. Keys: inertia, wheel_speed, wheel_inertia, "
    "friction, gain, noise, scale; tilt, tilt_common (rad); also time_s, max_rate_rad_s, steady_torque (deg by which "
    "one may turn the body in this stretch, 300 unless given, 0: none). Repeatable.",
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
    type=Parsed(observation),
    multiple=True,
    help="A magnetic direction in the body, and its known angle from the Sun: "
    "T,X,Y,Z,ANGLE,SIGMA (s, 1, rad, rad). Repeatable.",
)
@click.option(
    "--predict",
    help="Times at which to say what the body did, comma-separated: s from the epoch, or UTC such as 16:20 "
    "or 2014-11-12T16:20. Beyond a collision that a built-in case knows of, through it.",
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
    """Every motion that the panel readings allow, with its probability, or the word that none fits.

    Uses all readings of one stretch of free motion, dark panels included. With --out, writes posterior.nc, corner.png,
    solutions.csv, passes.csv, the likeliest motion of each solution, and with --predict predicted.csv and predicted.png;
    `sunspin report` makes a page of them. Without TELEMETRY the case's own is used.

    \b
    Examples:
      sunspin posterior philae --predict 16:20,17:25 --out philae-posterior
      sunspin posterior vehicle.toml telemetry.csv --from 0 --to 900 --prior inertia=0.02 --store rows
    """
    from sunspin.estimate.posterior.estimate import posterior as run
    from sunspin.landing.predictions import with_predictions
    from sunspin.telemetry.case import case_telemetry, timeline_of
    from sunspin.telemetry.reader import read_telemetry

    if output.quiet:
        logging.getLogger("sunspin").setLevel(logging.ERROR)
    made = opened(vehicle, changes)
    craft = made.craft
    if predict is None:
        say_idle(made.changes, ("body.mass_kg", "leg", "collision"))  # of a collision
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
        with_predictions(
            craft, tree, asked, seed, timeline_of(vehicle), made.assumptions.collision, workers
        )
    output.deliver(made.mark(tree), made.file, samples)
