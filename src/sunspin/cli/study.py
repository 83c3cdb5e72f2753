"""`sunspin reproduce`, `sunspin coverage`, `sunspin report`."""

from __future__ import annotations

from copy import copy
from pathlib import Path

import click

from sunspin.cli.common import on_terminal, output_options, report, run_options


@click.command()
@output_options(default="results")
@run_options
@click.option("--telemetry", type=click.Path(path_type=Path), help="Panel powers to use in the place of the synthetic ones. Start "
              "from a copy of telemetry.csv in an earlier results folder.")
@click.option("--vehicle", type=click.Path(path_type=Path), help="Vehicle file of another body with one wheel and legs.")
@click.option("--candidates", default="scan", show_default=True, metavar="scan|posterior|published|FILE",
              help="Motions that the conclusions follow from: the 90 % set of the scan, the posterior of the readings "
                  "(minutes), the paper's printed lines whatever the telemetry says, or a table with columns omega_x, "
              "omega_y, omega_z (rad/s).")
@click.option("--calibrate", type=click.IntRange(0, 100_000), metavar="N", help="Calibrate the set's threshold on N synthetic "
              "flights like the data. Default: the shipped calibration where it fits them, else 60; 0: none.")
@click.option(
    "--coarser", type=click.IntRange(1, 50), default=1, show_default=True, help="Every n-th grid point only: a quick look."
)
def reproduce(out: Path, as_json: bool, quiet: bool, seed: int, workers: int | None, telemetry: Path | None, vehicle: Path | None,
              candidates: str, calibrate: int | None, coarser: int) -> None:  # fmt: skip
    """Run the whole Philae study: every figure and table of the paper, and where the paper contradicts itself.

    Every conclusion follows from the telemetry given. That which comes with the package is synthetic (the flown one is not public)
    and is called so wherever it shows.

    \b
    Examples:
      sunspin reproduce --out results
      sunspin reproduce --telemetry mine.csv --candidates posterior --out mine
    """
    from sunspin.philae.reproduction import reproduce as run

    written = run(
        out, telemetry, vehicle=vehicle, candidates=candidates, calibrate=calibrate, seed=seed, workers=workers, coarser=coarser,
        progress=on_terminal(quiet),
    )  # fmt: skip
    told = written.summary
    lines = [
        f"What this file can carry: {told['carries']}",
        "Telemetry: " + ("synthetic (made from published facts)" if told["synthetic_telemetry"] else "measured"),
        *(f"  {row['what']}: {_short(row)}" for row in told["figures"] if row["id"] in SHOWN),
        *told["headline"][:2],
        *told["score"],
        *told["missing"].values(),
        f"Report: {written.report} (in {told['seconds']:.0f} s)",
    ]
    report(told, lines, as_json, quiet)


SHOWN = ("delta_mean", "wheel_stop", "emd_min")


def _short(row: dict) -> str:
    unit = "" if row["unit"] == "1" else f" {row['unit']}"
    return f"{row['ours']:.4g}{unit} (published {row['published']:.4g})"


@click.command()
@click.option("--twins", type=click.IntRange(10, 1_000_000), default=400, show_default=True, help="Synthetic rebounds per kind.")
@click.option("--confidence", type=click.FloatRange(0, 1, min_open=True, max_open=True), default=0.9, show_default=True,
              help="Of the region whose threshold on EMD is looked for.")
@click.option("--factor", type=click.FloatRange(1, min_open=True), default=1.1, show_default=True, help="Near-minimum factor.")
@click.option("--coarser", type=click.IntRange(1, 50), default=1, show_default=True, help="Every n-th grid point only.")
@click.option("--store", type=click.Path(path_type=Path), help="Folder that keeps finished twins; the same command resumes.")
@output_options()
@run_options
def coverage(twins, confidence, factor, coarser, store, out, as_json, quiet, seed, workers) -> None:  # fmt: skip
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

    summary = run(
        out, twins, confidence=confidence, factor=factor, coarser=coarser, seed=seed, store=store, workers=workers,
        progress=on_terminal(quiet),
    )  # fmt: skip
    lines = [*summary["sentences"], *(f"  {row['what']}: {_value(row['ours'])} ({row['note']})" for row in summary["figures"])]
    report(summary, lines + ([f"Results: {summary['folder']}"] if summary["folder"] else []), as_json, quiet)


worth = copy(coverage)
worth.name, worth.help = "worth", (coverage.help or "").replace("sunspin coverage", "sunspin worth")


def _value(ours) -> str:
    return ", ".join(f"{x:.4g}" for x in ours) if isinstance(ours, list) else f"{ours:.4g}"


@click.command(name="report")
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@output_options(out=False)
def report_page(folder: Path, as_json: bool, quiet: bool) -> None:
    """One page to look into, from a results folder: DIR/report.html, complete in itself, to open from disk or send away.

    DIR is the --out of an earlier command. What the page does not know how to draw it lists.

    \b
    Example:
      sunspin report rates
    """
    from sunspin.output.report import write_report

    target = write_report(folder)
    size = target.stat().st_size
    report({"report": str(target), "bytes": size}, [f"Report: {target} ({size / 1e6:.1f} MB)"], as_json, quiet)
