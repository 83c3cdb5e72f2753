"""Decoder of skCUBE's raw beacons: as published by the collector of ground station OM3KAA, or as exported from SatNOGS DB.

The collector has one file per frame, named ``<unix receive time>_<station>_...``, in a folder or a zip: a KISS frame with an AX.25
header of 16 bytes, a type byte and little-endian fields. Field lists: repository yangwao/skCube-data-collector (MIT licence).
SatNOGS's frames are AX.25 without KISS.
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
SOLAR = ("Yp", "Xp", "Ym", "Xm", "Zp", "Zm")
KISS_BYTES, AX25_BYTES = 2, 16
"""FEND and the KISS command; the AX.25 header before the type byte."""

MAX_FRAMES, MAX_FRAME_BYTES = 1_000_000, 4096


def _names(text: str) -> tuple[str, ...]:
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
"""Types of beacons whose fields are published: their binary form, and the names of the fields."""

TYPES = {0x01: "CDHS", 0x02: "ADCS", 0x03: "COM", 0x05: "PWR"}

OTHER = "other"
"""What is none of these: written as it came."""


class Beacons(NamedTuple):
    """Decoded beacons: of each kind rows of (unix time, station, fields as `KINDS` has them, of `OTHER` in hexadecimal digits),
    and how many frames could not be read, by reason."""

    rows: dict[str, list[tuple[float, str, tuple[Any, ...]]]]
    unread: dict[str, int]

    @property
    def kinds(self) -> dict[str, int]:
        """How many frames of each kind there are."""
        return {kind: len(rows) for kind, rows in self.rows.items()}


Frame = tuple[float | None, str, bytes]
"""When (unix s) and where a frame was received, None and empty where its name does not say; its content from the type byte on."""


def unescape(frame: bytes) -> bytes:
    """A KISS frame without its escapes (DB DC is C0, DB DD is DB)."""
    return re.sub(b"\xdb([\xdc\xdd])", lambda m: b"\xc0" if m[1] == b"\xdc" else b"\xdb", frame)


def decode_beacons(path: Any) -> Beacons:
    """Return all raw frames of a folder, a zip or a SatNOGS export, oldest first; a frame that cannot be read is counted.

    Raises
    ------
    TelemetryError
        No frame can be read.
    """
    rows: dict[str, list[tuple[float, str, tuple[Any, ...]]]] = {}
    unread: Counter[str] = Counter()
    for time, station, content in _frames(Path(path)):
        kind = TYPES.get(content[0], OTHER) if content else ""
        if time is None:
            unread["the name has no receive time"] += 1
        elif not kind:
            unread["too short for a beacon"] += 1
        elif kind == OTHER:
            rows.setdefault(OTHER, []).append((time, station, (content.hex(),)))
        elif len(content) <= KINDS[kind][0].size:
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
    """The beacons of a kind as CSV; that of the attitude and power beacons is what the built-in vehicle reads."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["unix_s_rx", "station", *(KINDS[kind][1] if kind in KINDS else ("frame",))])
    writer.writerows(
        [f"{time:.12g}", plain_cell(station), *fields]
        for time, station, fields in beacons.rows[kind]
    )
    return text.getvalue()


def _frames(path: Path) -> Iterator[Frame]:
    if path.is_dir():
        for file in sorted(entry for entry in path.iterdir() if is_nonempty_file(entry))[
            :MAX_FRAMES
        ]:
            with open(file, "rb") as stream:
                yield _of_collector(file.name, stream.read(MAX_FRAME_BYTES))
    elif is_nonempty_file(path) and _begins(path)[:1] in b"0123456789{[":
        yield from _of_satnogs(path)
    else:
        yield from _zipped(path)


def _begins(path: Path) -> bytes:
    with open(path, "rb") as stream:
        return stream.read(4)


def _zipped(path: Path) -> Iterator[Frame]:
    try:
        if not is_nonempty_file(path):
            raise OSError("no such file, or it is empty, a device or a pipe")
        with zipfile.ZipFile(path) as archive:
            for info in archive.infolist()[:MAX_FRAMES]:
                if not info.is_dir():
                    with archive.open(info) as stream:
                        yield _of_collector(Path(info.filename).name, stream.read(MAX_FRAME_BYTES))
    except (
        Exception
    ) as error:  # what zipfile raises on a damaged archive is not documented, and is much
        do = "give a folder or a zip of raw frames, or SatNOGS's export of them"
        raise TelemetryError(
            f"the raw beacons cannot be read ({error})", do=do, where=str(path)
        ) from None


def _of_collector(name: str, frame: bytes) -> Frame:
    named = re.match(r"([0-9]{9,11})_([A-Za-z0-9]+)", name)
    content = unescape(frame)[KISS_BYTES + AX25_BYTES :]
    return (None, "", content) if named is None else (int(named[1]), named[2], content)


def _of_satnogs(path: Path) -> Iterator[Frame]:
    """Frames of SatNOGS DB, as its website exports them or its interface gives them (`timestamp`, `frame`, `observer`)."""
    table = read_table(path)
    if not {"timestamp", "frame"} <= set(table.header):
        what = "raw frames of SatNOGS have a time and a frame each"
        raise TelemetryError(what, got="columns " + ", ".join(table.header)[:200], where=str(path))
    cells = table.cells.iloc[:MAX_FRAMES]
    for line, row in zip(cells.index, cells.to_dict("records"), strict=True):
        moment, frame = parse_utc(row["timestamp"]), row["frame"]
        try:
            content = bytes.fromhex(frame[: 2 * MAX_FRAME_BYTES])
        except ValueError:
            what, where = "a frame is written in hexadecimal digits", f"{path}, line {line}"
            got = frame[:60] or "an empty cell"
            raise TelemetryError(what, got=got, where=where) from None
        station = row.get("observer", "")
        yield None if moment is None else moment.timestamp(), station, content[AX25_BYTES:]
