"""Decoder of skCUBE's raw beacons: as published by the collector of ground station OM3KAA, or as exported from SatNOGS DB.

The collector has one file per frame, named ``<unix receive time>_<station>_...``, in a folder or a zip archive. A file is a KISS
frame with an AX.25 header of 16 bytes, a type byte and little-endian fields. Field lists: repository yangwao/skCube-data-collector
(MIT licence). Frames of SatNOGS are AX.25 without KISS.
"""

from __future__ import annotations

import csv
import io
import re
import struct
import zipfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from sunspin.base.cells import plain_cell
from sunspin.base.errors import TelemetryError
from sunspin.base.tables import read_table
from sunspin.base.untrusted import is_nonempty_file
from sunspin.telemetry.times import parse_utc

FACES = ("Xp", "Xm", "Yp", "Ym", "Zp", "Zm")
"""Sides of the body in the order of the Sun sensors' fields."""

SOLAR = ("Yp", "Xp", "Ym", "Xm", "Zp", "Zm")
"""Sides of the body in the order of the solar panels' fields."""

KISS_BYTES, AX25_BYTES = 2, 16
"""Lengths of the KISS header (FEND and command) and of the AX.25 header before the type byte."""

MAX_FRAMES, MAX_FRAME_BYTES = 1_000_000, 4096
"""Largest number of frames, and of bytes in a frame, that are read."""


def _names(text: str) -> tuple[str, ...]:
    """Return the names of fields from a text in which spaces separate them."""
    return tuple(text.split())


KINDS: dict[str, tuple[struct.Struct, tuple[str, ...]]] = {
    "CDHS": (
        struct.Struct("<BBBHIIBBBBBB12H12BI3B5HB12HBB"),
        _names(
            "antFired antAttempts antFiredInv numReboots time bootLog verProt swVersion swRelease drvVersion drvRelease activeCpu "
            "comRecv comSend comFwd comRecvErr comSendErr comFwdErr rxFwdCam rxFwdPwr rxFwdExp rxFwdCamErr rxFwdPwrErr rxFwdExpErr "
            "unused5 unused6 unused7 unused8 unused9 unused10 unused11 unused12 stackUsageMax cpuUsageAvg cpuUsageMax cpuTemp "
            "taskNumActiv calibMode calibStop calibDlay calibRemainSmpls osBootLog osBootLog2 taskCheckLog delayWrtB7 radOn "
            "radRamPattern1 radRamPattern2 radRamPattern3 radRamPattern4 radRamPattern5 radRamErr radFrmPattern1 radFrmPattern2 "
            "radFrmPattern3 radFrmPattern4 radFrmPattern5 radFrmErr flashBootromCrcWrong flashOperCrcWrong"
        ),
    ),
    "ADCS": (
        struct.Struct("<BBhhh" + "hhB" * 6 + "h" * 16 + "H" * 4),
        (
            "adcsMode",
            "bdK",
            "pwmX",
            "pwmY",
            "pwmZ",
            *(f"sun{face}_{part}" for face in FACES for part in ("x", "y", "irr")),
            *(f"{sensor}{axis}" for sensor in ("gyro", "mag1", "mag2", "acc") for axis in "XYZT"),
            "earthXp",
            "earthXm",
            "earthYp",
            "earthYm",
        ),
    ),
    "COM": (
        struct.Struct("<IHBBH6Hbb6H4B"),
        _names(
            "timestamp fwVersion activeCOM digipeaterMode numberOfReboots outputReflectedPower outputForwardPower "
            "outputReflectedPowerCW outputForwardPowerCW rssi rssiNoise mcuTemperature paTemperature cwBeaconSent packetsSent "
            "correctPacketsReceived brokenPacketReceived comProtocolError gsProtocolError txDisableStatus orbitTime timeslotStart "
            "timeslotEnd"
        ),
    ),
    "PWR": (
        struct.Struct("<III5H15h3H28h5HhI5H"),
        (
            *_names(
                "timestamp fullUptime uptime activeUP fwVer reboots countCOMErrors countPSUErrors"
            ),
            *(f"{letter}{face}" for letter in "it" for face in SOLAR),
            *_names(
                "uBatA uBatB tBat cBatA cBatB capacity iBatA iBatB iBatAmin iBatBmin iBatAmax iBatBmax iBatAavg iBatBavg"
            ),
            *(
                f"i{part}{what}"
                for part in ("CDHS", "COM", "CAM", "EXP", "ADCS")
                for what in ("min", "max", "avg", "actual")
            ),
            *_names(
                "uSYSmin uSYSmax uSYSactual iOverBit connectBit tsTemp countCOMpacket PSUError PSULastError COMError COMLastError "
                "endofdata"
            ),
        ),
    ),
}
"""Kinds of beacons whose fields are published: their binary layout, and the names of the fields."""

TYPES = {0x01: "CDHS", 0x02: "ADCS", 0x03: "COM", 0x05: "PWR"}
"""Type byte -> kind of beacon."""

OTHER = "other"
"""Kind of all beacons with another type byte, whose content is written in hexadecimal digits."""


class Beacons(NamedTuple):
    """Decoded beacons, and the frames that could not be read.

    `rows`: kind -> rows of receive time (unix s), station, and fields in the order of `KINDS` (of `OTHER`: one field of hexadecimal
    digits). `unread`: reason -> number of frames.
    """

    rows: dict[str, list[tuple[float, str, tuple[Any, ...]]]]
    unread: dict[str, int]

    @property
    def kinds(self) -> dict[str, int]:
        """Number of frames of each kind."""
        return {kind: len(rows) for kind, rows in self.rows.items()}


class Frame(NamedTuple):
    """A raw frame: receive time (unix s, None if unknown), station (empty if unknown) and content from the type byte on."""

    time: float | None
    station: str
    content: bytes


def unescape(frame: bytes) -> bytes:
    """Return a KISS frame without its escapes (DB DC stands for C0, DB DD for DB)."""
    return re.sub(b"\xdb([\xdc\xdd])", lambda m: b"\xc0" if m[1] == b"\xdc" else b"\xdb", frame)


def decode_beacons(path: Any) -> Beacons:
    """Decode all raw frames of a folder, a zip archive or a SatNOGS export; rows are sorted by receive time.

    A frame that cannot be decoded is counted in `Beacons.unread`.

    Raises
    ------
    TelemetryError
        No frame can be read.
    """
    rows: dict[str, list[tuple[float, str, tuple[Any, ...]]]] = {}
    unread: Counter[str] = Counter()
    for time, station, content in _read_frames(Path(path)):
        kind = TYPES.get(content[0], OTHER) if content else ""
        if time is None:
            unread["the name has no receive time"] += 1
        elif not kind:
            unread["too short for a beacon"] += 1
        elif kind == OTHER:
            rows.setdefault(OTHER, []).append((time, station, (content.hex(),)))
        elif len(content) <= KINDS[kind][0].size:  # the fields come after the type byte
            unread[f"a {kind} beacon is cut off"] += 1
        else:
            fields = KINDS[kind][0].unpack_from(content[1:])
            rows.setdefault(kind, []).append((time, station, fields))
    if not rows and not unread:
        raise TelemetryError(
            "no raw beacon here", do="give the folder or zip of raw frames", where=str(path)
        )
    if not rows:
        counts = ", ".join(f"{reason} ({n})" for reason, n in unread.most_common())
        raise TelemetryError(
            f"none of {unread.total()} frames can be read",
            got=counts,
            do="give raw frames in files named <unix receive time>_<station>, or SatNOGS's export of them",
            where=str(path),
        )
    return Beacons({kind: sorted(rows[kind]) for kind in sorted(rows)}, dict(unread))


def beacons_csv(beacons: Beacons, kind: str) -> str:
    """Return the beacons of a kind as CSV text; the built-in vehicle skCUBE reads that of the kinds ADCS and PWR."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["unix_s_rx", "station", *(KINDS[kind][1] if kind in KINDS else ("frame",))])
    writer.writerows(
        [f"{time:.12g}", plain_cell(station), *fields]
        for time, station, fields in beacons.rows[kind]
    )
    return text.getvalue()


def _read_frames(path: Path) -> Iterator[Frame]:
    """Yield the frames of a folder, a SatNOGS export or a zip archive."""
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
    content = unescape(frame)[KISS_BYTES + AX25_BYTES :]
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
        station = row.get("observer", "")
        time = None if moment is None else moment.timestamp()
        yield Frame(time, station, content[AX25_BYTES:])
