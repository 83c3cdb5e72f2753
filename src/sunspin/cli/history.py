"""`sunspin history`."""

from __future__ import annotations

from pathlib import Path

import click

from sunspin.cli.changes import Command
from sunspin.cli.common import PATH, Output, shared


@click.command(cls=Command)
@click.argument("folders", metavar="RESULTS...", nargs=-1, required=True, type=PATH)
@shared()
def history(folders: tuple[Path, ...], output: Output) -> None:
    """Collect the passes of many results of `rates`: speed, spin axis and momentum against time, trend and jumps of the speed.

    RESULTS are folders that `rates --out` wrote, or folders that hold such folders. The trend uses the decided passes only.
    With --out, writes history.csv, history.nc and a figure.

    \b
    Example:
      sunspin rates vehicle.toml telemetry.csv --out week/monday
      sunspin history week
    """
    from sunspin.output.history import history as collect

    output.claim()
    output.deliver(collect(folders), main="history.csv")
