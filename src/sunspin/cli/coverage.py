"""`sunspin coverage`, and `sunspin worth`, its earlier name."""

from __future__ import annotations

from copy import copy

import click

from sunspin.cli.changes import LANDING, Changeable, asked, say_idle, set_options
from sunspin.cli.common import (
    factor_option,
    on_terminal,
    output_options,
    report,
    run_options,
    store_option,
)


@click.command(cls=Changeable)
@click.option(
    "--twins",
    type=click.IntRange(10, 1_000_000),
    default=400,
    show_default=True,
    help="Synthetic rebounds per kind.",
)
@click.option(
    "--confidence",
    type=click.FloatRange(0, 1, min_open=True, max_open=True),
    default=0.9,
    show_default=True,
    help="Of the region whose threshold on EMD is looked for.",
)
@factor_option
@click.option(
    "--coarser",
    type=click.IntRange(1, 50),
    default=1,
    show_default=True,
    help="Every n-th grid point only.",
)
@store_option("Folder that keeps finished twins; the same command resumes.")
@set_options("study.lead_s", "study.mask", short=("friction",), idle=LANDING)
@output_options()
@run_options
def coverage(
    twins, confidence, factor, coarser, store, sets, friction, out, as_json, quiet, seed, workers
) -> None:
    """Coverage of the paper's method: it is repeated on synthetic rebounds whose truth is known.

    How far the lines move from one data set to the next, how often the truth lies in the near-minimum set, which threshold
    makes that set a confidence region, and what the lower bound on the angular speed at the touchdown is then. `sunspin scan`
    takes such a threshold as --threshold.

    \b
    Examples:
      sunspin coverage --out coverage-results
      sunspin coverage --twins 2000 --confidence 0.95 --store coverage-twins --out coverage-results
    """
    from sunspin.philae.coverage_results import coverage as run

    changes = asked(sets, ("study.lead_s", "study.mask"), friction=friction)
    say_idle(changes)
    found = run(
        out,
        twins,
        confidence=confidence,
        factor=factor,
        coarser=coarser,
        seed=seed,
        store=store,
        workers=workers,
        progress=on_terminal(quiet),
        changes=changes,
    )
    summary = found.said()
    folder = [f"Results: {summary['folder']}"] if summary["folder"] else []
    report(summary, [*str(found.sunspin.summary()).splitlines(), *folder], as_json, quiet)


worth = copy(coverage)
worth.name, worth.help = "worth", (coverage.help or "").replace("sunspin coverage", "sunspin worth")
