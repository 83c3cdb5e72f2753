"""Decoder of skCUBE's raw beacons, as published by the collector of ground station OM3KAA.

One file per frame, named ``<unix receive time>_<station>_...``, in a folder or a zip: a KISS frame with an AX.25 header of 16
bytes, a type byte and little-endian fields. Field lists: repository yangwao/skCube-data-collector (MIT licence).
"""

from __future__ import annotations

import csv
import io
import re
import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from sunspin.base.errors import TelemetryError, sentence
from sunspin.base.untrusted import is_plain

TYPES = {0x01: "CDHS", 0x02: "ADCS", 0x03: "COM", 0x05: "PWR"}
ADCS = struct.Struct("<BBhhh" + "hhB" * 6 + "h" * 16 + "H" * 4)
HEADER_BYTES = 18
"""FEND, KISS command and the AX.25 header before the type byte."""

MAX_FRAMES, MAX_FRAME_BYTES = 1_000_000, 4096
FACES = ("Xp", "Xm", "Yp", "Ym", "Zp", "Zm")
ADCS_COLUMNS = (
    "adcsMode", "bdK", "pwmX", "pwmY", "pwmZ",
    *(f"sun{face}_{part}" for face in FACES for part in ("x", "y", "irr")),
    *(f"{sensor}{axis}" for sensor in ("gyro", "mag1", "mag2", "acc") for axis in "XYZT"),
    "earthXp", "earthXm", "earthYp", "earthYm",
)  # fmt: skip


class Beacons(NamedTuple):
    """Decoded attitude beacons: rows of (unix time, station, fields as `ADCS_COLUMNS`), how many frames of each kind there
    were, and how many could not be read, by reason."""

    adcs: list[tuple[int, str, tuple[int, ...]]]
    kinds: dict[str, int]
    unread: dict[str, int]


def unescape(frame: bytes) -> bytes:
    """A KISS frame without its escapes (DB DC is C0, DB DD is DB)."""
    return re.sub(b"\xdb([\xdc\xdd])", lambda m: b"\xc0" if m[1] == b"\xdc" else b"\xdb", frame)


def decode_beacons(path: Any) -> Beacons:
    """Read all raw frames of a folder or zip, oldest first; a frame that cannot be read is counted, never fatal."""
    rows, kinds, unread = [], {}, {}
    for name, frame in _frames(Path(path)):
        named = re.match(r"(\d{9,11})_([A-Za-z0-9]+)", name)
        if named is None:
            unread["the name has no receive time"] = unread.get("the name has no receive time", 0) + 1
            continue
        content = unescape(frame)
        kind = TYPES.get(content[HEADER_BYTES], "unknown type") if len(content) > HEADER_BYTES else "too short"
        kinds[kind] = kinds.get(kind, 0) + 1
        fields = content[HEADER_BYTES + 1 :]
        if kind == "ADCS" and len(fields) < ADCS.size:
            unread["an attitude beacon is cut off"] = unread.get("an attitude beacon is cut off", 0) + 1
        elif kind == "ADCS":
            rows.append((int(named[1]), named[2], ADCS.unpack_from(fields)))
    if not kinds:
        raise TelemetryError(sentence("no raw beacon here", do="give the folder or zip of raw frames", where=str(path)))
    return Beacons(sorted(rows), kinds, unread)


def adcs_csv(beacons: Beacons) -> str:
    """The attitude beacons as the CSV that the built-in vehicle reads."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["unix_s_rx", "station", *ADCS_COLUMNS])
    writer.writerows([time, station, *fields] for time, station, fields in beacons.adcs)
    return text.getvalue()


def _frames(path: Path) -> Iterator[tuple[str, bytes]]:
    where = str(path)
    try:
        if path.is_dir():
            for file in sorted(entry for entry in path.iterdir() if is_plain(entry))[:MAX_FRAMES]:
                with open(file, "rb") as stream:
                    yield file.name, stream.read(MAX_FRAME_BYTES)
            return
        if not is_plain(path):
            raise OSError("no such file, or it is empty, a device or a pipe")
        with zipfile.ZipFile(path) as archive:
            for info in archive.infolist()[:MAX_FRAMES]:
                if not info.is_dir():
                    with archive.open(info) as stream:
                        yield Path(info.filename).name, stream.read(MAX_FRAME_BYTES)
    except Exception as error:  # what zipfile raises on a damaged archive is not documented, and is much
        raise TelemetryError(
            sentence(f"the raw beacons cannot be read ({error})", do="give a folder or a zip of raw frames", where=where)
        ) from None
