"""`sunspin report`."""

from __future__ import annotations

from pathlib import Path

import click

from sunspin.cli.common import output_options, report


@click.command(name="report")
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@output_options(out=False)
def report_page(folder: Path, as_json: bool, quiet: bool) -> None:
    """One page to look into, from a results folder: DIR/report.html, complete in itself, to open from disk or send away.

    DIR is the --out of an earlier command.

    \b
    Example:
      sunspin report rates
    """
    from sunspin.output.report import write_report
    from sunspin.output.text import size_text

    target = write_report(folder)
    size = target.stat().st_size
    report(
        {"report": str(target), "bytes": size},
        [f"Report: {target} ({size_text(size)})"],
        as_json,
        quiet,
    )
