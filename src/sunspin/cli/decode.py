"""`sunspin decode`."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import click

from sunspin.cli.changes import Command
from sunspin.cli.common import PATH, Output, shared


@click.command(cls=Command)
@click.argument("raw", type=PATH)
@click.option(
    "--decoder",
    default="skcube",
    metavar="NAME",
    help="Frame format: skcube, or a decoder of the program satnogs-decoders, such as cubebel1.",
)
@shared(out=True)
def decode(raw: Path, decoder: str, output: Output) -> None:
    """Decode raw frames to CSV. RAW: a folder or zip of frames in files named <unix time>_<station>, or frames from SatNOGS DB.

    skcube writes a table for each kind of beacon: skcube_adcs.csv, skcube_pwr.csv and so on. Beacons whose fields are not
    published are written to skcube_other.csv in hexadecimal. Raw beacons: repository yangwao/skCube-data-collector.

    For other satellites, install the public program satnogs-decoders (pipx install satnogs-decoders; licence AGPL-3.0). sunspin
    runs it and writes all fields to NAME.csv, and to NAME_columns.toml which columns may be panels, if their names tell.

    --out: default is the name of the decoder.

    \b
    Examples (the second needs satnogs-decoders):
      sunspin decode skcube_raw_23_27_june.zip --out skcube
      sunspin decode frames.csv --decoder cubebel1 --out decoded
    """
    folder = output.folder or Path(decoder)
    if decoder == "skcube":
        _decode_skcube(raw, folder, output)
    else:
        _decode_by_program(raw, decoder, folder, output)


def _decode_skcube(raw: Path, folder: Path, output: Output) -> None:
    """Decode skCUBE's beacons, write a table (CSV) for each of their kinds, and report how many were decoded and why others not."""
    from sunspin.output.folder import results_folder, write_whole
    from sunspin.telemetry.decoders.skcube import beacons_csv, decode_beacons

    beacons = decode_beacons(raw)
    counts = beacons.counts  # kind -> number of beacons
    results_folder(folder, "decode")
    files: dict[str, str] = {}
    for kind in counts:
        text, target = beacons_csv(beacons, kind), folder / f"skcube_{kind.lower()}.csv"
        files[kind] = str(write_whole(target, text))
    lines = [f"{n:6d}  {kind} beacons: {files[kind]}" for kind, n in counts.items()]
    lines += [f"{n:6d}  not read: {why}" for why, n in beacons.unread.items()]
    summary: dict[str, Any] = {"frames": counts, "unread": beacons.unread, "files": files}
    # the beacons of the kind ADCS hold the attitude
    summary |= {"attitude_beacons": counts.get("ADCS", 0), "file": files.get("ADCS")}
    output.report(summary, lines)


def _decode_by_program(raw: Path, decoder: str, folder: Path, output: Output) -> None:
    """Write a table (CSV) of the frames that satnogs-decoders decodes, and a [telemetry] section if columns look like panels."""
    from sunspin.base.tables import read_table
    from sunspin.output.folder import results_folder, write_whole
    from sunspin.telemetry.decoders.satnogs import (
        decode_by_program,
        decoded_csv,
        require_decoder_name,
    )
    from sunspin.telemetry.suggest import suggest_section

    require_decoder_name(decoder)  # it names the folder if none is given
    # a folder that cannot be written is refused before the program runs, which may take minutes
    results_folder(folder, "decode")
    decoded = decode_by_program(decoder, raw)
    table = write_whole(folder / f"{decoder}.csv", decoded_csv(decoded))
    frames = len(decoded.rows)
    lines = [f"{frames:6d}  frames: {table}"]
    lines += [f"{n:6d}  not read: {why}" for why, n in decoded.unread.items()]
    summary: dict[str, Any] = {"frames": frames, "unread": decoded.unread, "file": str(table)}
    summary |= {"decoder": decoder, "satnogs_decoders": decoded.version, "columns": None}
    suggestion = suggest_section(read_table(table))
    map_file = folder / f"{decoder}_columns.toml"
    if suggestion is None:
        map_file.unlink(missing_ok=True)  # of an earlier run
        lines.append("No column map: no names of columns look like panels on two sides")
    else:
        about = f"# Columns of {table.name} that look like panels, by their names; check units and sides before use.\n"
        columns = write_whole(map_file, about + suggestion.section)
        summary["columns"] = str(columns)
        lines.append(f"Column map, a guess from the names: {columns}")
        lines.append(f"Next: sunspin init DIR --from {shlex.quote(str(table))}")
    output.report(summary, lines)
