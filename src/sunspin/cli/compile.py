"""`sunspin compile`."""

from __future__ import annotations

from importlib import resources

import click

from sunspin.cli.changes import Command
from sunspin.cli.common import shared


@click.command("compile", cls=Command)
@click.argument("vehicles", metavar="[VEHICLE]...", nargs=-1)
@shared(out=False)
def compile_kernels(vehicles, output) -> None:
    """Compile the kernels of scans in advance, so that the first scan starts at once.

    The kernels of a vehicle take about half a minute and are kept for this kind of processor. Vehicles with wheels, panels and mask
    along the same axes share them. Without a VEHICLE: Philae, and the vehicle that `sunspin init` writes.

    \b
    Examples:
      sunspin compile
      sunspin compile vehicle.toml
    """
    from sunspin.estimate.scan.volume import compile_kernels as compile_for
    from sunspin.vehicle import load_vehicle

    names = list(vehicles) or [
        "philae",
        str(resources.files("sunspin").joinpath("template", "vehicle.toml")),
    ]
    folder = compile_for([load_vehicle(name) for name in names])
    lines = [f"Scans of {len(names)} vehicles are ready: {folder}"]
    output.report({"vehicles": names, "folder": str(folder)}, lines)
