"""`sunspin reproduce`."""

from __future__ import annotations

import click

from sunspin.cli.changes import SHORT, Command, set_options
from sunspin.cli.common import PATH, shared


@click.command(cls=Command)
@click.option(
    "--telemetry",
    type=PATH,
    help="Panel powers to use in the place of the synthetic ones. Start "
    "from a copy of telemetry.csv in an earlier results folder.",
)
@click.option("--vehicle", type=PATH, help="Vehicle file of another body with one wheel and legs.")
@click.option(
    "--candidates",
    default="scan",
    metavar="scan|posterior|published|FILE",
    help="Motions that the conclusions use: scan (90 % confidence set), posterior (slower), published (the paper's "
    "lines), or a table with columns omega_x, omega_y, omega_z (rad/s).",
)
@click.option(
    "--calibrate",
    type=click.IntRange(0, 100_000),
    metavar="N",
    help="Calibrate the set's threshold on N synthetic "
    "flights like the data. Default: the shipped calibration where it fits them, else 60; 0: none.",
)
@click.option(
    "--coarser",
    type=click.IntRange(1, 50),
    default=1,
    help="Every n-th grid point only: a quick look.",
)
@set_options("study", "collision", short=tuple(SHORT))
@shared("--seed", "--workers", out="results")
def reproduce(telemetry, output, **options) -> None:
    """Run the whole Philae study: every figure and table of the paper beside what this run gives.

    Every conclusion follows from the telemetry given. That which comes with the package is synthetic (the flown one is not public)
    and is called so wherever it shows.

    \b
    Examples:
      sunspin reproduce --out results
      sunspin reproduce --telemetry mine.csv --candidates posterior --out mine
      sunspin reproduce --set wheel.speed_rad_s=833 --set 'body.inertia_kg_m2[2][2]*=0.9' --friction printed --out what-if
    """
    from sunspin.philae.reproduction import reproduce as run

    written = run(output.folder, telemetry, **options, progress=output.progress)
    output.report(written.summary, written.lines)
