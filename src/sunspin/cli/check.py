"""`sunspin check`."""

from __future__ import annotations

import click

from sunspin.base.errors import InputError
from sunspin.cli.changes import Command
from sunspin.cli.common import shared


@click.command(cls=Command)
@click.argument("vehicle")
@click.argument("telemetry", required=False)
@shared("--data", "--tle", "--tle-shift-sigma", out=False)
def check(vehicle, telemetry, elements, shift_sigma, output) -> None:
    """Check a vehicle file and telemetry: what they contain, what is wrong and which rates they can determine.

    If the telemetry has none of the columns that the vehicle file names, a [telemetry] section that would read it is printed.

    With an orbit, also check whether the telemetry was taken in it: strength of the magnetic field, its angle to the Sun, eclipses.

    \b
    Examples (the second with the built-in vehicle philae and its telemetry):
      sunspin check vehicle.toml telemetry.csv
      sunspin check philae philae
    """
    from sunspin.estimate.orbit.judged import orbit_sources
    from sunspin.output.check.files import describe_telemetry, describe_vehicle
    from sunspin.output.check.orbit import describe_orbit
    from sunspin.output.template import suggest_telemetry
    from sunspin.telemetry.reader import MissingColumn
    from sunspin.vehicle import load_vehicle

    craft = load_vehicle(vehicle)
    # raises errors of the elements before the long work
    orbit_sources(craft, elements, shift_sigma)
    summary, lines = describe_vehicle(craft)
    if telemetry is not None:
        try:
            samples = describe_telemetry(craft, telemetry, vehicle)
        except MissingColumn:
            if section := suggest_telemetry(telemetry, craft):
                title = (
                    f"A [telemetry] section that would read {telemetry.name}; check it before use:"
                )
                output.report(
                    summary | {"suggested": section}, [*lines, title, "", *section.split("\n")]
                )
            raise
        orbit = describe_orbit(samples.assessment, elements, shift_sigma)
        summary |= {"telemetry": samples.summary} | orbit.summary
        lines += samples.lines + orbit.lines
    elif elements is not None:
        raise InputError("elements are compared with telemetry", do="give TELEMETRY too")
    output.report(summary, lines)
