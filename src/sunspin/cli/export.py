"""`sunspin export`."""

from __future__ import annotations

import click

from sunspin.cli.changes import Command
from sunspin.cli.common import PATH, POSITIVE, shared

MOST_UNDECIDED = 5
"""Number of passes that are not decided that are printed."""


@click.command(cls=Command)
@click.argument("folder", metavar="DIR", type=PATH)
@click.option(
    "--format",
    "file_format",
    type=click.Choice(["aem", "aem-2", "aem-xml", "ck", "netcdf", "parquet"]),
    default="aem",
    help="Output format.",
)
@click.option(
    "--frame",
    help="Reference frame: J2000, or SUNSPIN_LOCAL if the rotation about the Sun direction is unknown (J2000 is then refused).",
)
@click.option("--epoch", help="UTC of time zero, if the results have none (`sunspin simulate`).")
@click.option(
    "--step",
    type=POSITIVE,
    help="Interval of the attitudes in s, along the motion. Default: at the samples, and for aem and ck also between them if the "
    "body rotates by more than 6 degrees from one to the next.",
)
@shared(out="export")
def export(folder, file_format, frame, epoch, step, output) -> None:
    """Export attitude and rates of a results folder.

    aem, aem-2 and aem-xml: CCSDS attitude ephemeris message, as KVN of version 1.0 or 2.0, or as XML. ck: SPICE kernels (.bc, .tsc,
    .tf). netcdf: with CF attributes. parquet: a table.

    \b
    Example:
      sunspin simulate philae --omega-deg-s 6,0,0 --sun 0,0,1 --duration 600 --out run
      sunspin export run --format netcdf --epoch 2014-11-12T15:35:00Z --out attitude
    """
    import numpy as np

    from sunspin.output.export import build_attitude, read_attitude_data, write_cf, write_parquet
    from sunspin.output.export.aem import write_aem
    from sunspin.output.export.ck import write_ck
    from sunspin.output.folder import results_folder
    from sunspin.output.text import count_text

    data, source = read_attitude_data(folder)
    # attitude messages and kernels are interpolated by their readers, and get attitudes between distant samples as well
    is_interpolated = file_format not in ("netcdf", "parquet")
    attitude = build_attitude(data, frame, epoch, step, dense=is_interpolated)
    target = results_folder(output.folder, "export")
    if file_format == "ck":
        paths = write_ck(target, attitude)
    elif file_format == "netcdf":
        paths = [write_cf(target / "attitude.nc", data, attitude)]
    elif file_format == "parquet":
        paths = [write_parquet(target / "attitude.parquet", attitude)]
    elif file_format == "aem-xml":
        paths = [write_aem(target / "sunspin-aem.xml", attitude, "xml")]
    else:
        version = "2.0" if file_format == "aem-2" else "1.0"
        paths = [write_aem(target / "sunspin.aem", attitude, version)]
    samples, segments = len(attitude.t_s), len(attitude.passes())
    files = [str(path) for path in paths]
    summary = {"from": str(source), "frame": attitude.frame, "samples": samples}
    summary["largest_rotation_deg"] = np.degrees(attitude.largest_rotation())
    frame_text = f"{attitude.frame}; {attitude.orientation}".removesuffix("; ")
    counts = f"{count_text(samples, 'attitude')} in {count_text(segments, 'segment')}"
    line = f"{counts}, frame {frame_text}"
    undecided = list(attitude.undecided.values())
    summary |= {"segments": segments, "files": files, "undecided": undecided}
    notes = undecided[:MOST_UNDECIDED]
    if len(undecided) > len(notes):
        notes.append(f"and {len(undecided) - len(notes)} more passes that are not decided")
    output.report(summary, [line, *notes, *(f"  {path}" for path in files)])
