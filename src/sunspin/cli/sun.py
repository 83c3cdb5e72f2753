"""`sunspin sun`."""

from __future__ import annotations

import click

from sunspin.cli.common import claim, data_option, deliver, output_options, read_both


@click.command()
@click.argument("vehicle")
@click.argument("telemetry")
@output_options()
@data_option
@click.option(
    "--noise",
    type=click.FloatRange(0, min_open=True),
    help="One sigma of a panel's value, in W or A.",
)
@click.option(
    "--lit-threshold",
    "threshold",
    type=click.FloatRange(0, min_open=True),
    help="A panel is lit above this, in W or A; default: the vehicle's, else from noise and light on dark faces.",
)
def sun(vehicle, telemetry, out, as_json, quiet, data, noise, threshold) -> None:
    """Directions to the Sun from panel powers or currents, each with its uncertainty or the reason why there is none.

    With --out, writes sun.csv, sun.nc, sun.png and sun.svg.

    \b
    Examples:
      sunspin sun vehicle.toml telemetry.csv --out sun-results
      sunspin sun philae philae
    """
    from sunspin.telemetry.assess import assess
    from sunspin.telemetry.sun import sun_directions

    craft, samples = read_both(vehicle, telemetry, data)
    claim(out, "sun")
    assessment = assess(craft, samples)
    directions = assessment.sun
    if noise is not None or threshold is not None:
        directions = sun_directions(
            craft, samples, noise=noise, lit_threshold=threshold or assessment.lit_threshold
        )
    deliver(directions, out, as_json, quiet, vehicle, samples)
