"""`sunspin reproduce`."""

from __future__ import annotations

from pathlib import Path

import click

from sunspin.cli.common import on_terminal, output_options, report, run_options


@click.command()
@output_options(default="results")
@run_options
@click.option("--telemetry", type=click.Path(path_type=Path), help="Panel powers to use in the place of the synthetic ones.")
@click.option(
    "--coarser", type=click.IntRange(1, 50), default=1, show_default=True, help="Every n-th grid point only: a quick look."
)
def reproduce(out: Path, as_json: bool, quiet: bool, seed: int, workers: int | None, telemetry: Path | None, coarser: int):
    """Run the Philae study from panel powers to the angular speed at touchdown.

    The telemetry that comes with the package is synthetic (the flown one is not public) and is called so wherever it shows.

    \b
    Example:
      sunspin reproduce --out results
    """
    from sunspin.tell.reproduction import reproduce as run

    written = run(out, telemetry, seed=seed, workers=workers, coarser=coarser, progress=on_terminal(quiet))
    compared = [row for row in written.summary["figures"] if row["agrees"] is not None]
    agreeing = sum(row["agrees"] for row in compared)
    lines = [
        "Telemetry: " + ("synthetic (made from published facts)" if written.summary["synthetic_telemetry"] else "measured"),
        *(f"  {row['what']}: {_short(row)}" for row in written.summary["figures"] if row["id"] in SHOWN),
        f"{agreeing} of {len(compared)} compared figures agree with the paper, in {written.summary['seconds']:.0f} s",
        f"Report: {written.report}",
    ]
    report(written.summary, lines, as_json, quiet)


SHOWN = ("delta_mean", "wheel_stop", "emd_min", "rate_at_touchdown_min")


def _short(row: dict) -> str:
    unit = "" if row["unit"] == "1" else f" {row['unit']}"
    return f"{row['ours']:.4g}{unit} (published {row['published']:.4g})"
