"""Decoder of skCUBE's raw beacons: as published by the collector of ground station OM3KAA, or as exported from SatNOGS DB.

A frame has an AX.25 header of 16 bytes, a type byte and little-endian fields. Field lists: repository yangwao/skCube-data-collector
(MIT licence).
"""

from __future__ import annotations

import csv
import io
import struct
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

from sunspin.base.cells import plain_cell
from sunspin.telemetry.decoders.frames import NO_TIME, read_frames, unread_error

FACES = ("Xp", "Xm", "Yp", "Ym", "Zp", "Zm")
"""Sides of the body in the order of the Sun sensors' fields."""

SOLAR = ("Yp", "Xp", "Ym", "Xm", "Zp", "Zm")
"""Sides of the body in the order of the solar panels' fields."""

AX25_BYTES = 16
"""Length of the AX.25 header before the type byte."""


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
    def counts(self) -> dict[str, int]:
        """Number of beacons of each kind."""
        return {kind: len(rows) for kind, rows in self.rows.items()}


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
    for time, station, frame in read_frames(Path(path)):
        content = frame[AX25_BYTES:]
        kind = TYPES.get(content[0], OTHER) if content else ""
        if time is None:
            unread[NO_TIME] += 1
        elif not kind:
            unread["too short for a beacon"] += 1
        elif kind == OTHER:
            rows.setdefault(OTHER, []).append((time, station, (content.hex(),)))
        elif len(content) <= KINDS[kind][0].size:  # the fields come after the type byte
            unread[f"a {kind} beacon is cut off"] += 1
        else:
            fields = KINDS[kind][0].unpack_from(content[1:])
            rows.setdefault(kind, []).append((time, station, fields))
    if not rows:
        raise unread_error(unread, path)
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
