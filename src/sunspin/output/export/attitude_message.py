"""Reader of CCSDS attitude ephemeris messages (504.0-B) in KVN, version 1.0 or 2.0, to compare a result with them."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation, RotationSpline

from sunspin.base.errors import InputError
from sunspin.base.untrusted import is_nonempty_file, plain_number, read_bytes
from sunspin.environment.frames import J2000
from sunspin.telemetry.times import parse_utc

MAX_BYTES = 200_000_000
"""Largest message: a million attitudes take half of it."""

FARTHEST_RAD = 1.0
"""Attitudes that are farther apart are not interpolated."""

CELESTIAL = ("EME2000", "J2000", "ICRF", "GCRF")
"""Names of the axes of J2000; their differences, 0.1 microradians, do not count."""

BODY = ("SC_BODY", "SC BODY")
"""How names of the body frame begin."""


class Segment(NamedTuple):
    """Attitudes of one segment: times `utc` (n), increasing, `B_from_N` (n, 4), scalar last, and the name of the frame N."""

    utc: np.ndarray
    B_from_N: np.ndarray
    frame: str

    def at(self, utc: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return attitudes B_from_N (m, 4) and body rates (m, 3) in rad/s at times (m); NaN where the message does not show them.

        It does not outside its span, and between attitudes that are more than `FARTHEST_RAD` apart.
        """
        attitude, rate = np.full((len(utc), 4), np.nan), np.full((len(utc), 3), np.nan)
        if len(self.utc) < 2:
            return attitude, rate
        t_s = (self.utc - self.utc[0]) / np.timedelta64(1, "us") / 1e6
        at_s = (utc - self.utc[0]) / np.timedelta64(1, "us") / 1e6
        N_from_B = Rotation.from_quat(self.B_from_N).inv()
        apart = (N_from_B[1:] * N_from_B[:-1].inv()).magnitude()
        interval = np.clip(np.searchsorted(t_s, at_s, "right") - 1, 0, len(apart) - 1)
        shown = (at_s >= t_s[0]) & (at_s <= t_s[-1]) & (apart[interval] <= FARTHEST_RAD)
        if shown.any():
            motion = RotationSpline(t_s, N_from_B)
            attitude[shown] = motion(at_s[shown]).inv().as_quat()
            rate[shown] = motion(at_s[shown], 1)
        return attitude, rate


def is_message(path: Path) -> bool:
    """Return whether a file begins like an attitude ephemeris message, in KVN or XML."""
    if not is_nonempty_file(path):
        return False
    with open(path, "rb") as file:
        return file.read(9).startswith((b"CCSDS_AEM", b"<?xml"))


def read_message(path: Path) -> list[Segment]:
    """Read the segments of an attitude ephemeris message.

    Raises
    ------
    InputError
        Not KVN, a time that is not UTC or cannot be read, an attitude that is no quaternion, or no body frame.
    """
    where, do = str(path), "give the whole message, as `sunspin export --format aem` writes it"
    content = read_bytes(path, MAX_BYTES, "attitude message", InputError, do)
    text = content.decode("ascii", "replace")
    if not text.lstrip().startswith("CCSDS_AEM_VERS"):
        what = "the attitude message is not in KVN"
        raise InputError(what, got=text[:40], do=do, where=where)
    segments: list[Segment] = []
    keys: dict[str, str] = {}
    rows: list[tuple[np.datetime64, list[float]]] = []
    in_data = False
    for number, line in enumerate(text.splitlines(), 1):
        line = line.strip()
        if not line or line.startswith("COMMENT"):
            continue
        if line == "META_START":
            keys, rows = {}, []
        elif line in ("DATA_START", "DATA_STOP"):
            in_data = line == "DATA_START"
            segments += [] if in_data else [_build_segment(keys, rows, where)]
        elif in_data:
            time, *cells = line.split()
            moment, values = parse_utc(time), [plain_number(cell) for cell in cells]
            if moment is None or len(values) < 4 or np.isnan(values).any():
                what = (
                    "a line of an attitude message has a time and the four numbers of a quaternion"
                )
                raise InputError(what, got=line, where=f"{where}, line {number}")
            rows.append((np.datetime64(moment.replace(tzinfo=None), "us"), values[:4]))
        else:
            key, _, value = line.partition("=")
            keys[key.strip()] = value.strip()
    if not segments:
        raise InputError("the attitude message has no segment", do=do, where=where)
    return segments


def _build_segment(
    keys: dict[str, str], rows: list[tuple[np.datetime64, list[float]]], where: str
) -> Segment:
    """Return a segment from its metadata and its rows; `where` names the file in messages.

    The quaternion of the standard rotates the axes of frame A into those of B, and with ATTITUDE_DIR = B2A those of B into A. With
    components of vectors, which sunspin rotates, it is the conjugate.
    """
    kind, scale = keys.get("ATTITUDE_TYPE", ""), keys.get("TIME_SYSTEM", "")
    if not kind.upper().startswith("QUATERNION"):
        what, do = "the attitudes of the message are no quaternions", "write it with quaternions"
        raise InputError(what, got=f"ATTITUDE_TYPE = {kind}", do=do, where=where)
    if scale.upper() != "UTC":
        what, do = "the times of the attitude message are not in UTC", "write it with UTC"
        raise InputError(what, got=f"TIME_SYSTEM = {scale}", do=do, where=where)
    frames = [keys.get(f"REF_FRAME_{side}", "").upper() for side in "AB"]
    is_body = [frame.startswith(BODY) for frame in frames]
    if is_body.count(True) != 1:
        what, do = "one of the two frames of the message must be the body's", "name it SC_BODY_1"
        raise InputError(what, got=" and ".join(frames), do=do, where=where)
    utc = np.array([time for time, _ in rows], dtype="datetime64[us]")
    if not len(rows) or np.any(np.diff(utc) <= np.timedelta64(0, "us")):
        what, do = "the times of the attitude message do not increase", "sort its rows"
        raise InputError(what, do=do, where=where)
    quaternion = np.array([values for _, values in rows])
    if keys.get("QUATERNION_TYPE", "LAST").upper() == "FIRST":
        quaternion = np.roll(quaternion, -1, axis=1)
    if np.any(np.linalg.norm(quaternion, axis=1) == 0):
        raise InputError("a quaternion of the attitude message is zero", where=where)
    rotation = Rotation.from_quat(quaternion)
    # two sides may be exchanged: the direction, and which of the frames is the body
    from_a_to_b = keys.get("ATTITUDE_DIR", "A2B").upper() != "B2A"
    B_from_N = rotation.inv() if from_a_to_b == is_body[1] else rotation
    inertial = frames[is_body.index(False)]
    frame = J2000 if inertial in CELESTIAL else inertial
    return Segment(utc, B_from_N.as_quat(), frame)
