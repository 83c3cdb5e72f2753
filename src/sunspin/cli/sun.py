"""`sunspin sun`."""

from __future__ import annotations

import click

from sunspin.cli.changes import Command
from sunspin.cli.common import POSITIVE, read_inputs, shared


@click.command(cls=Command)
@click.argument("vehicle")
@click.argument("telemetry")
@click.option("--noise", type=POSITIVE, help="1-sigma noise of a panel's value, in W or A.")
@click.option(
    "--lit-threshold",
    "threshold",
    type=POSITIVE,
    help="Panels above this value are lit, in W or A. Default: from the vehicle file, else estimated.",
)
@shared("--data")
def sun(vehicle, telemetry, noise, threshold, output) -> None:
    """Compute each sample's Sun direction in body axes from panel power or current, with 1-sigma error, or why it is unknown.

    With --out, writes sun.csv, sun.nc, sun.png and sun.svg.

    \b
    Examples (the second with the built-in vehicle philae and its telemetry):
      sunspin sun vehicle.toml telemetry.csv --out sun-results
      sunspin sun philae philae
    """
    output.draw_in_background("telemetry")
    from sunspin.telemetry.assess import assess
    from sunspin.telemetry.sun import sun_directions

    craft, samples = read_inputs(vehicle, telemetry)
    output.claim()
    assessment = assess(craft, samples)
    directions = assessment.sun
    if noise is not None or threshold is not None:
        directions = sun_directions(
            craft,
            samples,
            noise=noise,
            lit_threshold=assessment.lit_threshold if threshold is None else threshold,
            quality=assessment.quality,
        )
    output.deliver(directions, vehicle, samples)
