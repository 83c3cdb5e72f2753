"""`sunspin init`."""

from __future__ import annotations

from pathlib import Path

import click

from sunspin.cli.changes import Command
from sunspin.cli.common import PATH, Output, shared


@click.command(cls=Command)
@click.argument("folder", metavar="DIR", type=PATH)
@click.option(
    "--from",
    "telemetry",
    metavar="FILE",
    type=PATH,
    help="Telemetry: vehicle.toml gets the panels and the [telemetry] section that its columns suggest.",
)
@shared(out=False)
def init(folder: Path, telemetry: Path | None, output: Output) -> None:
    """Create an example vehicle.toml, with comments, and telemetry.csv. Existing files are never overwritten.

    \b
    Examples (the third as for your own telemetry; check what it guessed):
      sunspin init my-satellite
      sunspin check my-satellite/vehicle.toml my-satellite/telemetry.csv
      sunspin init mine --from my-satellite/telemetry.csv
    """
    from sunspin.output.template import write_templates, write_vehicle_for

    if telemetry is not None:
        vehicle, sensors, notes = write_vehicle_for(folder, telemetry)
        lines = [
            f"Wrote {vehicle}: panels and [telemetry] from {telemetry.name}, no inertia and no wheel.",
            "Check times, units, gains and faces in it, which are guesses from the names of the columns.",
            *(f"note: {note}" for note in notes),
        ]
        if sensors:
            tables = ", ".join(f"[{sensor}]" for sensor in sensors)
            lines.append(
                f"Columns of other sensors stand in it as comments ({tables}): remove the # once axes, signs and units are right."
            )
        lines.append(f"Next: sunspin check {vehicle} {telemetry}")
        summary = {"vehicle": str(vehicle), "telemetry": str(telemetry), "notes": notes}
        output.report(summary, lines)
        return
    vehicle, telemetry = write_templates(folder)
    lines = [
        f"Wrote {vehicle} and {telemetry} (synthetic samples).",
        f"Next: sunspin check {vehicle} {telemetry}",
    ]
    output.report({"vehicle": str(vehicle), "telemetry": str(telemetry)}, lines)
