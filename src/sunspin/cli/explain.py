"""`sunspin explain`."""

from __future__ import annotations

import click

from sunspin.cli.changes import Command
from sunspin.cli.common import Output, shared


@click.command(cls=Command)
@click.argument("labels", metavar="[LABEL]...", nargs=-1)
@shared(out=False)
def explain(labels: tuple[str, ...], output: Output) -> None:
    """Print what a verdict or a warning means, and what to do. Without LABEL: list the labels.

    The last line of `check`, `sun`, `rates` and `posterior` names the labels of what was printed.

    \b
    Example:
      sunspin explain poor-fit
    """
    from sunspin.output.verdicts import ANCHORS, read_section

    texts = {label: read_section(label) for label in labels}
    lines = "\n\n".join(texts.values()).splitlines() if texts else list(ANCHORS)
    output.report({"labels": texts or list(ANCHORS)}, lines)
