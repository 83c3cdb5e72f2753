"""CCSDS attitude ephemeris message (CCSDS 504.0-B): KVN of version 1.0 or 2.0, as readers refuse one or the other, and XML.

The standard's quaternion q rotates the axes of frame A into those of frame B. With R(q) the rotation of vectors that SciPy makes of
q, components in B are R(q)^T times those in A. The numbers written are therefore the conjugate of `B_from_N`.

The file states no method of interpolation, so readers choose one. The attitudes must be dense (`build_attitude` with `dense`).
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from sunspin.environment.frames import J2000
from sunspin.output.export import AttitudeHistory
from sunspin.output.folder import write_whole

IN_VERSION_1_ALONE = ("ATTITUDE_DIR", "QUATERNION_TYPE")
"""Keys that version 2.0, and so the XML, lacks: it has one direction only, A to B, and one order of the components."""

LONGEST_COMMENT = 240
"""Characters of a comment: a line of the standard has at most 254."""


def write_aem(target: Path, attitude: AttitudeHistory, form: str = "1.0") -> Path:
    """Write an attitude ephemeris message with a segment for each pass, and return its path.

    `form`: "1.0" or "2.0", the version of a KVN file, or "xml".
    """
    utc = np.datetime_as_string(attitude.utc)
    name, number = map(_ascii, (attitude.name, attitude.number))
    object_metadata = {
        "OBJECT_NAME": name or "UNKNOWN",
        "OBJECT_ID": number or name or "UNKNOWN",
        "CENTER_NAME": attitude.centre,
        "REF_FRAME_A": "EME2000" if attitude.frame == J2000 else attitude.frame,
        "REF_FRAME_B": "SC_BODY_1",
        "ATTITUDE_DIR": "A2B",
        "TIME_SYSTEM": "UTC",
    }
    comments = [f"{attitude.frame}: {attitude.orientation}"] if attitude.orientation else []
    comments += ["made from synthetic telemetry"] if "synthetic" in attitude.source else []
    # the CCSDS quaternion rotates axes, B_from_N rotates vectors: one is the conjugate of the other (docs/conventions.md, 19)
    conjugate = attitude.quaternion * np.array([-1.0, -1.0, -1.0, 1.0])
    components = [[f"{x:.15f}" for x in q] for q in conjugate]
    segments = []  # comments, metadata, and (UTC, components) of each attitude
    for samples in attitude.passes():
        metadata = object_metadata | {"START_TIME": utc[samples[0]], "STOP_TIME": utc[samples[-1]]}
        metadata |= {"ATTITUDE_TYPE": "QUATERNION", "QUATERNION_TYPE": "LAST"}
        why = attitude.undecided.get(int(attitude.pass_of[samples[0]]))
        notes = [*comments, *([_ascii(why)[:LONGEST_COMMENT]] if why else [])]
        segments.append((notes, metadata, [(utc[i], components[i]) for i in samples]))
    now = f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%S}"
    header = {"CREATION_DATE": now, "ORIGINATOR": "SUNSPIN"}
    if form == "xml":
        text = _xml(header, segments)
        return write_whole(target, text)
    lines = [f"CCSDS_AEM_VERS = {form}", *(f"{key} = {value}" for key, value in header.items()), ""]
    for notes, metadata, states in segments:
        lines += ["META_START", *(f"COMMENT {text}" for text in notes)]
        lines += [
            f"{key} = {value}"
            for key, value in metadata.items()
            if form == "1.0" or key not in IN_VERSION_1_ALONE
        ]
        lines += ["META_STOP", "", "DATA_START"]
        lines += [" ".join([time, *numbers]) for time, numbers in states]
        lines += ["DATA_STOP", ""]
    return write_whole(target, "\n".join(lines))


def _add_element(
    parent: ElementTree.Element, key: str, text: str | None = None
) -> ElementTree.Element:
    """Add an element with a text to a parent element, and return it."""
    element = ElementTree.SubElement(parent, key)
    element.text = text
    return element


def _ascii(text: str) -> str:
    """Return a text with an underscore for each character that is no printable ASCII: the standard allows no other."""
    return "".join(c if c.isascii() and c.isprintable() else "_" for c in text).strip()


def _xml(header: dict[str, str], segments: list) -> str:
    """Return the message as XML; `segments`: comments, metadata and (UTC, quaternion components) of each pass."""
    root = ElementTree.Element("aem", {"id": "CCSDS_AEM_VERS", "version": "2.0"})
    head, body = _add_element(root, "header"), _add_element(root, "body")
    for key, value in header.items():
        _add_element(head, key, value)
    for notes, metadata, states in segments:
        segment = _add_element(body, "segment")
        metadata_element, data = _add_element(segment, "metadata"), _add_element(segment, "data")
        for text in notes:
            _add_element(metadata_element, "COMMENT", text)
        for key, value in metadata.items():
            if key not in IN_VERSION_1_ALONE:
                _add_element(metadata_element, key, value)
        for utc, components in states:
            state = _add_element(_add_element(data, "attitudeState"), "quaternionEphemeris")
            _add_element(state, "EPOCH", utc)
            quaternion = _add_element(state, "quaternion")
            for key, value in zip(("Q1", "Q2", "Q3", "QC"), components, strict=True):
                _add_element(quaternion, key, value)
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'
