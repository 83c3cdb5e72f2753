"""CCSDS attitude ephemeris message (CCSDS 504.0-B): KVN of version 1.0 and XML of version 2.0.

KVN is written as version 1.0, which every reader knows; what it says is the same. The standard's quaternion turns the axes of
frame A into those of frame B, so that a vector's components in B are R(q)^T times those in A, with R the rotation of vectors
that SciPy calls by the same q: the numbers written are the conjugate of `B_from_N`.
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from sunspin.environment.frames import J2000
from sunspin.output.export import Attitude
from sunspin.output.folder import write_whole

BODY_FRAME = "SC_BODY_1"
ORIGINATOR = "SUNSPIN"


def ccsds_quaternion(attitude: Attitude) -> np.ndarray:
    """Quaternions (n, 4), scalar last, as the standard means them: from N (A) to the body (B)."""
    return attitude.quaternion * np.array([-1.0, -1.0, -1.0, 1.0])


def write_aem(target: Path, attitude: Attitude, form: str = "kvn") -> Path:
    """Write an AEM, `form` "kvn" or "xml", one segment per pass."""
    stamp = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S")
    text = _kvn(attitude, stamp) if form == "kvn" else _xml(attitude, stamp)
    return write_whole(target, lambda part: part.write_text(text, "utf-8"))


def _comments(attitude: Attitude) -> list[str]:
    lines = [f"{attitude.frame}: {attitude.stands}"] if attitude.stands else []
    return [*lines, "made from synthetic telemetry"] if attitude.synthetic else lines


def _plain(text: str) -> str:
    """A name on one line of printable ASCII, as the standard wants."""
    return "".join(c if c.isascii() and c.isprintable() else "_" for c in text).strip()


def _metadata(attitude: Attitude, part: np.ndarray) -> list[tuple[str, str]]:
    return [
        ("OBJECT_NAME", _plain(attitude.name) or "UNKNOWN"),
        ("OBJECT_ID", _plain(attitude.number) or _plain(attitude.name) or "UNKNOWN"),
        ("CENTER_NAME", attitude.centre),
        (
            "REF_FRAME_A",
            "EME2000" if attitude.frame == J2000 else attitude.frame,
        ),  # as the standard calls it
        ("REF_FRAME_B", BODY_FRAME),
        ("ATTITUDE_DIR", "A2B"),
        ("TIME_SYSTEM", "UTC"),
        ("START_TIME", attitude.utc(part[0])),
        ("STOP_TIME", attitude.utc(part[-1])),
        ("ATTITUDE_TYPE", "QUATERNION"),
        ("QUATERNION_TYPE", "LAST"),
    ]


def _kvn(attitude: Attitude, stamp: str) -> str:
    q = ccsds_quaternion(attitude)
    lines = ["CCSDS_AEM_VERS = 1.0", f"CREATION_DATE = {stamp}", f"ORIGINATOR = {ORIGINATOR}", ""]
    for part in attitude.parts():
        lines += ["META_START", *(f"COMMENT {text}" for text in _comments(attitude))]
        lines += [f"{key} = {value}" for key, value in _metadata(attitude, part)]
        lines += ["META_STOP", "", "DATA_START"]
        lines += [" ".join([attitude.utc(i), *(f"{x:.15f}" for x in q[i])]) for i in part]
        lines += ["DATA_STOP", ""]
    return "\n".join(lines)


def _xml(attitude: Attitude, stamp: str) -> str:
    q = ccsds_quaternion(attitude)
    root = ElementTree.Element("aem", {"id": "CCSDS_AEM_VERS", "version": "2.0"})
    header = ElementTree.SubElement(root, "header")
    _add(header, "CREATION_DATE", stamp)
    _add(header, "ORIGINATOR", ORIGINATOR)
    body = ElementTree.SubElement(root, "body")
    for part in attitude.parts():
        segment = ElementTree.SubElement(body, "segment")
        metadata = ElementTree.SubElement(segment, "metadata")
        for text in _comments(attitude):
            _add(metadata, "COMMENT", text)
        for key, value in _metadata(attitude, part):
            if key not in (
                "ATTITUDE_DIR",
                "QUATERNION_TYPE",
            ):  # version 2.0 knows one direction, A to B, and one order only
                _add(metadata, key, value)
        data = ElementTree.SubElement(segment, "data")
        for i in part:
            state = ElementTree.SubElement(
                ElementTree.SubElement(data, "attitudeState"), "quaternionEphemeris"
            )
            _add(state, "EPOCH", attitude.utc(i))
            numbers = ElementTree.SubElement(state, "quaternion")
            for key, value in zip(("Q1", "Q2", "Q3", "QC"), q[i], strict=True):
                _add(numbers, key, f"{value:.15f}")
    ElementTree.indent(root)
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        + ElementTree.tostring(root, encoding="unicode")
        + "\n"
    )


def _add(parent: ElementTree.Element, key: str, text: str) -> None:
    ElementTree.SubElement(parent, key).text = text
