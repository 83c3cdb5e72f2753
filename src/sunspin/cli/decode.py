"""`sunspin decode`."""

from __future__ import annotations

from pathlib import Path

import click

from sunspin.cli.changes import Command
from sunspin.cli.common import PATH, Output, shared


@click.command(cls=Command)
@click.argument("raw", type=PATH)
@click.option("--decoder", type=click.Choice(["skcube"]), default="skcube", help="Frame format.")
@shared(out="skcube")
def decode(raw: Path, decoder: str, output: Output) -> None:
    """Decode raw skCUBE beacons to CSV, a table for each kind of beacon: skcube_adcs.csv, skcube_pwr.csv and so on.

    RAW is a folder or zip of frames from the repository yangwao/skCube-data-collector, or frames from SatNOGS DB (CSV or JSON).
    Beacons whose fields are not published are written to skcube_other.csv in hexadecimal.

    \b
    Example:
      sunspin decode skcube_raw_23_27_june.zip --out skcube
    """
    from sunspin.output.folder import results_folder, write_whole
    from sunspin.telemetry.decoders.skcube import beacons_csv, decode_beacons

    beacons = decode_beacons(raw)
    folder = results_folder(output.folder, "decode")
    files: dict[str, str] = {}
    for kind in beacons.rows:
        text, target = beacons_csv(beacons, kind), folder / f"{decoder}_{kind.lower()}.csv"
        files[kind] = str(write_whole(target, text))
    lines = [f"{n:6d}  {kind} beacons: {files[kind]}" for kind, n in beacons.kinds.items()]
    lines += [f"{n:6d}  not read: {why}" for why, n in beacons.unread.items()]
    attitude = {"attitude_beacons": beacons.kinds.get("ADCS", 0), "file": files.get("ADCS")}
    summary = {"frames": beacons.kinds, "unread": beacons.unread, "files": files, **attitude}
    output.report(summary, lines)
