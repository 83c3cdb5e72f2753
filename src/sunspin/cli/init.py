"""`sunspin init`."""

from __future__ import annotations

from pathlib import Path

import click

from sunspin.cli.common import output_options, report


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@output_options(out=False)
def init(folder: Path, as_json: bool, quiet: bool) -> None:
    """Write a commented vehicle.toml and a telemetry.csv to start from. Existing files are never overwritten.

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
    report({"vehicle": str(vehicle), "telemetry": str(telemetry)}, lines, as_json, quiet)
