"""`sunspin report`."""

from __future__ import annotations

from pathlib import Path

import click

from sunspin.cli.changes import Command
from sunspin.cli.common import PATH, Output, shared


@click.command("report", cls=Command)
@click.argument("folder", metavar="DIR", type=PATH)
@shared(out=False)
def report_page(folder: Path, output: Output) -> None:
    """Make an HTML report from a results folder (the --out of another command): DIR/report.html, a single file.

    \b
    Example:
      sunspin report skcube-rates
    """
    from sunspin.output.report import write_report

    target = write_report(folder)
    size = target.stat().st_size
    output.report(
        {"report": str(target), "bytes": size}, [f"Report: {target} ({size / 1e6:.3g} MB)"]
    )
