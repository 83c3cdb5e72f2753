"""`sunspin reproduce`."""

from __future__ import annotations

import click

from sunspin.cli.changes import SHORT_OPTIONS, Command, set_options
from sunspin.cli.common import PATH, shared


@click.command(cls=Command)
@click.option(
    "--telemetry", type=PATH, help="Panel powers, in the form of telemetry.csv of a results folder."
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
    help="Simulated flights that calibrate the threshold of --candidates scan. Default: built-in if it applies, else 60; 0: none.",
)
@click.option("--coarser", type=click.IntRange(1, 50), default=1, help="Use every N-th grid point.")
@click.option(
    "--without",
    type=click.Choice(["posterior"]),
    help="Leave out the posterior of the samples, which takes a third of the computing time.",
)
@set_options("study", "collision", short=tuple(SHORT_OPTIONS))
@shared("--seed", "--workers", out="results")
def reproduce(telemetry, output, without, **options) -> None:
    """Reproduce the Philae study: every figure and table of the paper next to the results of this run.

    All conclusions are recomputed from the telemetry given. The built-in telemetry is synthetic, and labelled so, because the
    flight telemetry is not public.

    \b
    Examples:
      sunspin reproduce --out results
      sunspin reproduce --telemetry mine.csv --candidates posterior --out mine
      sunspin reproduce --set wheel.speed_rad_s=833 --set 'body.inertia_kg_m2[2][2]*=0.9' --friction printed --out what-if
    """
    from sunspin.philae.reproduction import reproduce as reproduce_study

    def report_page(written) -> None:
        """Say that the page is there while the posterior is still computed."""
        if not output.quiet:
            text = f"{written.report} is there after {written.seconds:.0f} s; the posterior of the samples follows"
            click.echo(f"sunspin: {text}", err=True)

    written = reproduce_study(
        output.folder,
        telemetry,
        **options,
        progress=output.progress,
        posterior=without is None,
        on_page=report_page,
    )
    output.report(written.summary, written.lines)
