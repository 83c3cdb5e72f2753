"""`sunspin init`."""

from __future__ import annotations

from pathlib import Path

import click

from sunspin.cli.changes import Command
from sunspin.cli.common import PATH, Output, shared


@click.command(cls=Command)
@click.argument("folder", metavar="DIR", type=PATH)
@shared(out=False)
def init(folder: Path, output: Output) -> None:
    """Create an example vehicle.toml, with comments, and telemetry.csv. Existing files are never overwritten.

    \b
    Example:
      sunspin init my-satellite
      sunspin check my-satellite/vehicle.toml my-satellite/telemetry.csv
    """
    from sunspin.output.template import write_templates

    vehicle, telemetry = write_templates(folder)
    lines = [
        f"Wrote {vehicle} and {telemetry} (synthetic samples).",
        f"Next: sunspin check {vehicle} {telemetry}",
    ]
    output.report({"vehicle": str(vehicle), "telemetry": str(telemetry)}, lines)
