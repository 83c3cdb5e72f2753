"""`sunspin posterior`."""

from __future__ import annotations

import logging

import click

from sunspin.cli.changes import Changeable, opened, say_idle, set_options
from sunspin.cli.common import find_telemetry, shared
from sunspin.cli.values import field, instants_of, observation, periods_of, prior, times


@click.command(cls=Changeable)
@click.argument("vehicle")
@click.argument("telemetry", required=False)
@click.option("--phase", help="Use the samples of this phase of the file.")
@click.option(
    "--prior",
    "priors",
    multiple=True,
    help="KEY=SIGMA, relative; 0: known. Keys: inertia, wheel_speed, wheel_inertia, "
    "friction, gain, noise, scale; tilt, tilt_common (rad); also time_s, max_rate_rad_s, steady_torque (deg by which "
    "one may turn the body in this stretch, 300 unless given, 0: none). Repeatable.",
)
@click.option(
    "--rate-deg-s",
    "rates",
    multiple=True,
    metavar="T,VALUE,SIGMA",
    help="Extra observation of the angular speed, in s and deg/s. Repeatable.",
)
@click.option(
    "--gyro-deg-s",
    "gyros",
    multiple=True,
    metavar="T,X,Y,Z,SIGMA",
    help="Extra observation of the body rate, in s and deg/s. Repeatable.",
)
@click.option(
    "--field",
    "fields",
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
    "--draws",
    type=click.IntRange(100, 1_000_000),
    default=4000,
    show_default=True,
    help="Draws in the result.",
)
@set_options("collision", short=("friction", "restitution", "damper"), idle=("hull", "antenna"))
@shared("--from", "--to", "--wheel-mode", "--period", "--store", "--seed", "--workers", "--data")
def posterior(
    vehicle,
    telemetry,
    begin,
    end,
    phase,
    priors,
    rates,
    gyros,
    fields,
    wheel_mode,
    predict,
    periods,
    draws,
    store,
    sets,
    seed,
    workers,
    data,
    output,
    **short,
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
    from sunspin.telemetry.case import timeline_of
    from sunspin.telemetry.reader import read_telemetry

    if output.quiet:
        logging.getLogger("sunspin").setLevel(logging.ERROR)
    made = opened(vehicle, sets, short)
    craft = made.craft
    if predict is None:
        say_idle(made.changes, ("body.mass_kg", "leg", "collision"))  # of a collision
    samples = read_telemetry(find_telemetry(telemetry, data, vehicle), craft)
    seen = [observation("rate", text) for text in rates]
    seen += [observation("gyro", text) for text in gyros]
    seen += [field(text) for text in fields]
    asked = None if predict is None else times(predict, samples.attrs.get("epoch_utc"))
    evidence = periods_of(periods, samples)
    first_s, last_s = instants_of(samples, begin, end)
    output.claim()
    tree = run(
        craft,
        samples,
        dict(prior(text) for text in priors),
        seed,
        begin_s=first_s,
        end_s=last_s,
        phase=phase,
        observations=seen,
        wheel_mode=wheel_mode,
        draws=draws,
        workers=workers,
        store=store,
        progress=output.progress,
        periods=evidence,
    )
    if asked is not None:
        with_predictions(
            craft, tree, asked, seed, timeline_of(vehicle), made.assumptions.collision, workers
        )
    output.deliver(made.mark(tree), made.file, samples)
