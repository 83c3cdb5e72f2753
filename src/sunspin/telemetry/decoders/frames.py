"""Raw frames from files: a folder or zip archive of a ground station's collector, or an export of SatNOGS DB.

The collector has one file per frame, named ``<unix receive time>_<station>_...``, which holds a KISS frame. Frames of SatNOGS are
AX.25 without KISS.
"""

from __future__ import annotations

import re
import zipfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from sunspin.base.errors import TelemetryError
from sunspin.base.tables import read_table
from sunspin.base.untrusted import is_nonempty_file
from sunspin.telemetry.times import parse_utc

KISS_BYTES, KISS_END = 2, b"\xc0"
"""Length of the KISS header (FEND and command), and the byte FEND that ends a frame."""

MAX_FRAMES, MAX_FRAME_BYTES = 1_000_000, 4096
"""Largest number of frames, and of bytes in a frame, that are read."""

NO_TIME = "the name has no receive time"
"""Why a frame of a collector is not used."""


class Frame(NamedTuple):
    """A raw frame: receive time (unix s, None if unknown), station (empty if unknown), and content from the AX.25 header on."""

    time: float | None
    station: str
    content: bytes


def read_frames(path: Path) -> Iterator[Frame]:
    """Yield the frames of a folder, a SatNOGS export or a zip archive; raise `TelemetryError` if it cannot be read."""
    if path.is_dir():
        files = sorted(entry for entry in path.iterdir() if is_nonempty_file(entry))
        for file in files[:MAX_FRAMES]:
            with open(file, "rb") as stream:
                yield _parse_collector_frame(file.name, stream.read(MAX_FRAME_BYTES))
    # exports of SatNOGS are CSV, which begins with a date, or JSON; a zip archive begins with "PK"
    elif is_nonempty_file(path) and _read_first_byte(path) in b"0123456789{[":
        yield from _read_satnogs_frames(path)
    else:
        yield from _read_zip_frames(path)


def unread_error(unread: dict[str, int], path: Path) -> TelemetryError:
    """Return the error for a file without a single frame that could be decoded; `unread`: reason -> number of frames."""
    if not unread:
        do = "give the folder or zip of raw frames"
        return TelemetryError("no raw beacon here", do=do, where=str(path))
    counts = ", ".join(f"{reason} ({n})" for reason, n in Counter(unread).most_common())
    what = f"none of {sum(unread.values())} frames can be read"
    do = "give raw frames in files named <unix receive time>_<station>, or SatNOGS's export of them"
    return TelemetryError(what, got=counts, do=do, where=str(path))


def unescape(frame: bytes) -> bytes:
    """Return a KISS frame without its escapes (DB DC stands for C0, DB DD for DB)."""
    return re.sub(b"\xdb([\xdc\xdd])", lambda m: b"\xc0" if m[1] == b"\xdc" else b"\xdb", frame)


def _read_first_byte(path: Path) -> bytes:
    """Return the first byte of a file."""
    with open(path, "rb") as stream:
        return stream.read(1)


def _read_zip_frames(path: Path) -> Iterator[Frame]:
    """Yield the frames of a zip archive of the collector; raise a `TelemetryError` if it cannot be read."""
    try:
        if not is_nonempty_file(path):
            raise OSError("no such file, or it is empty, a device or a pipe")
        with zipfile.ZipFile(path) as archive:
            for info in archive.infolist()[:MAX_FRAMES]:
                if not info.is_dir():
                    with archive.open(info) as stream:
                        content = stream.read(MAX_FRAME_BYTES)
                    yield _parse_collector_frame(Path(info.filename).name, content)
    # on damaged archives zipfile raises many exceptions, which are not documented
    except Exception as error:
        do = "give a folder or a zip of raw frames, or SatNOGS's export of them"
        raise TelemetryError(
            f"the raw beacons cannot be read ({error})", do=do, where=str(path)
        ) from None


def _parse_collector_frame(name: str, frame: bytes) -> Frame:
    """Return a frame of the collector, with time and station from the name of its file."""
    match = re.match(r"([0-9]{9,11})_([A-Za-z0-9]+)", name)
    content = unescape(frame.removesuffix(KISS_END))[KISS_BYTES:]
    return Frame(None, "", content) if match is None else Frame(int(match[1]), match[2], content)


def _read_satnogs_frames(path: Path) -> Iterator[Frame]:
    """Yield the frames of an export of SatNOGS DB, from its website or its interface (`timestamp`, `frame`, `observer`)."""
    table = read_table(path)
    if not {"timestamp", "frame"} <= set(table.header):
        what = "raw frames of SatNOGS have a time and a frame each"
        raise TelemetryError(what, got="columns " + ", ".join(table.header)[:200], where=str(path))
    cells = table.cells.iloc[:MAX_FRAMES]
    for k, row in enumerate(cells.to_dict("records")):
        moment, digits = parse_utc(row["timestamp"]), row["frame"]
        try:
            content = bytes.fromhex(digits[: 2 * MAX_FRAME_BYTES])
        except ValueError:
            what, where = (
                "a frame is written in hexadecimal digits",
                f"{path}, {table.row_place(k)}",
            )
            got = digits[:60] or "an empty cell"
            raise TelemetryError(what, got=got, where=where) from None
        time = None if moment is None else moment.timestamp()
        yield Frame(time, row.get("observer", ""), content)
