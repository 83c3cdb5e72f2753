"""`sunspin export`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from sunspin.cli.common import output_options, report

FORMATS = ["aem", "aem-xml", "ck", "netcdf", "parquet"]


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option(
    "--format",
    "form",
    type=click.Choice(FORMATS),
    default="aem",
    show_default=True,
    help="What to write.",
)
@click.option(
    "--frame",
    help="Frame to write; a celestial one is refused where the turn about the Sun line is not known.",
)
@click.option(
    "--epoch", help="UTC of time zero, where the results have none (those of `sunspin simulate`)."
)
@click.option(
    "--step",
    type=click.FloatRange(0, min_open=True),
    help="Write an attitude every so many s, interpolated along the "
    "motion between the samples; default: at the samples.",
)
@output_options(default="export")
def export(folder, form, frame, epoch, step, out, as_json, quiet) -> None:
    """Attitude and rates of a results folder in formats that other tools read.

    aem and aem-xml: CCSDS attitude ephemeris message; ck: SPICE kernels (.bc, .tsc, .tf); netcdf: with CF attributes; parquet.

    \b
    Example:
      sunspin simulate philae --omega 0.1,0,0 --sun 0,0,1 --duration 600 --out run
      sunspin export run --format netcdf --epoch 2014-11-12T15:35:00Z --out attitude
    """
    from sunspin.output.export import (
        attitude_of,
        between_samples,
        read_results,
        write_cf,
        write_parquet,
    )
    from sunspin.output.folder import results_folder
    from sunspin.output.text import counted

    data, source = read_results(folder)
    attitude = attitude_of(data, frame, epoch)
    if step is not None:
        attitude = between_samples(attitude, data, step)
    target = results_folder(out, "export")
    if form == "ck":
        from sunspin.output.export.ck import write_ck

        paths = write_ck(target, attitude)
    elif form.startswith("aem"):
        from sunspin.output.export.aem import write_aem

        kind = "xml" if form == "aem-xml" else "kvn"
        paths = [
            write_aem(
                target / ("sunspin.aem" if kind == "kvn" else "sunspin-aem.xml"), attitude, kind
            )
        ]
    elif form == "netcdf":
        paths = [write_cf(target / "attitude.nc", data, attitude)]
    else:
        paths = [write_parquet(target / "attitude.parquet", attitude)]
    summary: dict[str, Any] = {
        "from": str(source),
        "frame": attitude.frame,
        "samples": len(attitude.t_s),
        "segments": len(attitude.parts()),
        "files": [str(path) for path in paths],
    }
    frame = attitude.frame + (f"; {attitude.stands}" if attitude.stands else "")
    line = f"{counted(len(attitude.t_s), 'attitude')} in {counted(len(attitude.parts()), 'segment')}, frame {frame}"
    report(summary, [line, *(f"  {path}" for path in paths)], as_json, quiet)
