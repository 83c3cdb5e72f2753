"""Frames decoded by the program `decode_multiple` of the package satnogs-decoders, which has decoders for hundreds of satellites.

The package has the licence AGPL-3.0. It is run as a separate program if the user has installed it, and is neither imported nor
distributed with sunspin. Call and output are those of version 1.131: `decode_multiple NAME --filename FILE --format csv -v`, where
FILE has lines `time|frame in hexadecimal digits`. It prints a JSON list of objects with `time`, as in the file, `fields` and
`tags`. With -v it also prints, on standard error, why a frame is not valid.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from sunspin.base.cells import plain_cell
from sunspin.base.errors import InputError
from sunspin.telemetry.decoders.frames import NO_TIME, Frame, read_frames, unread_error
from sunspin.vehicle.timeline import utc_after

PROGRAM = "decode_multiple"
"""Name of the program."""

DECODER_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,99}")
"""Form of the name of a decoder; nothing else reaches the program."""

START_S, FRAMES_PER_S = 60, 20
"""Time limit of the program: a start, and at least so many frames in a second. It decodes some 2,000 on an idle core."""

UNIX_EPOCH = "1970-01-01T00:00:00Z"
"""UTC from which receive times are counted."""

INVALID = "^~~~ Invalid frame!"
"""Line on standard error before the reason why a frame is not valid."""

REASON_CHARACTERS = 100
"""Longest reason that is kept."""


class Decoded(NamedTuple):
    """Frames that a program has decoded.

    `rows`: receive time (unix s), station, and the fields by name, sorted by time. `unread`: reason -> number of frames. `version`:
    that of the program, empty if it does not say.
    """

    rows: list[tuple[float, str, dict[str, Any]]]
    unread: dict[str, int]
    version: str


def require_decoder_name(decoder: str) -> None:
    """Raise `InputError` if a text cannot be the name of a decoder, which a program and a folder get."""
    if not DECODER_NAME.fullmatch(decoder):
        what, do = "a decoder has a name of letters, digits and _", "give one such as cubebel1"
        raise InputError(what, got=decoder, do=do)


def decode_by_program(decoder: str, path: Path) -> Decoded:
    """Decode raw frames of a folder, a zip archive or a SatNOGS export with a decoder of satnogs-decoders.

    Raises
    ------
    InputError
        The program is not installed, has no decoder of this name, or fails.
    TelemetryError
        No frame can be read.
    """
    require_decoder_name(decoder)
    # also next to this Python, whose environment need not be active
    folders = os.pathsep.join([os.environ.get("PATH", ""), str(Path(sys.executable).parent)])
    program = shutil.which(PROGRAM, path=folders)
    if program is None:
        what = f"the decoder {decoder!r} needs the program {PROGRAM} of satnogs-decoders, which is not installed"
        do = "install it with pipx install satnogs-decoders, or use --decoder skcube"
        raise InputError(what, do=do)
    frames, unread = [], Counter[str]()
    for frame in read_frames(path):
        if frame.time is None:
            unread[NO_TIME] += 1
        else:
            frames.append(frame)
    if not frames:
        raise unread_error(unread, path)
    points, errors = _run(program, decoder, frames)
    if not points and f"has no attribute {decoder.capitalize()!r}" in errors:
        what, do = "satnogs-decoders has no decoder of this name", "check the name or update it"
        raise InputError(what, got=decoder, do=do)
    messages, refused = errors.splitlines(), 0
    for line, reason in zip(messages, messages[1:], strict=False):
        if line == INVALID:
            # numbers, such as counts of bytes, differ from frame to frame
            refused += 1
            unread[re.sub(r"0x[0-9a-f]+|\d+", "N", reason)[:REASON_CHARACTERS] or "not valid"] += 1
    silent = len(frames) - len({int(point["time"]) for point in points}) - refused
    if silent > 0:
        unread["no reason given"] += silent
    rows, version = [], ""
    for point in points:
        frame = frames[int(point["time"])]
        rows.append((frame.time, frame.station, dict(point["fields"])))
        version = str(point["tags"].get("version", ""))
    if not rows:
        raise unread_error(unread, path)
    return Decoded(sorted(rows, key=lambda row: row[:2]), dict(unread), version)


def _run(program: str, decoder: str, frames: list[Frame]) -> tuple[list[dict[str, Any]], str]:
    """Run the program on frames; return its objects, whose `time` is the number of the frame, and its standard error.

    The program copies the first cell of a line into `time`, so a number in place of a time shows which frame an object is from.
    """
    with TemporaryDirectory(prefix="sunspin-") as folder:
        file = Path(folder) / "frames.csv"
        lines = (f"{k}|{frame.content.hex()}\n" for k, frame in enumerate(frames))
        file.write_text("".join(lines), encoding="ascii", newline="\n")
        command = [program, decoder, "--filename", str(file), "--format", "csv", "-v"]
        seconds = START_S + len(frames) / FRAMES_PER_S
        try:
            done = subprocess.run(command, capture_output=True, timeout=seconds)
        except subprocess.TimeoutExpired:
            what = f"{PROGRAM} does not end: {len(frames)} frames in {seconds:.0f} s"
            raise InputError(what, do="give fewer frames", where=program) from None
        except OSError as error:
            what = f"{PROGRAM} cannot be started ({error.strerror or error})"
            raise InputError(what, do="install satnogs-decoders again", where=program) from None
    errors = done.stderr.decode("utf-8", "replace")
    points: list[dict[str, Any]] = []
    try:
        points = json.loads(done.stdout)
        numbers = [int(point["time"]) for point in points]
        is_expected = isinstance(points, list) and all(
            isinstance(point["fields"], dict) and isinstance(point["tags"], dict)
            for point in points
        )
    except (ValueError, LookupError, TypeError, OverflowError, RecursionError):
        numbers, is_expected = [], False
    if done.returncode or not is_expected or not set(numbers) <= set(range(len(frames))):
        last = (errors.strip().splitlines() or ["no reason is known"])[-1][:300]
        what = (
            f"{PROGRAM} failed or printed something unknown (exit code {done.returncode}: {last})"
        )
        raise InputError(what, do="update satnogs-decoders", where=program)
    return points, errors


def decoded_csv(decoded: Decoded) -> str:
    """Return decoded frames as CSV text: receive time (UTC), station, and all fields; a cell is empty if a frame lacks the field.

    A list becomes a text such as [1 2 3].
    """
    names = list(dict.fromkeys(name for *_, fields in decoded.rows for name in fields))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    own = "received_utc", "station"
    # a field of the satellite may have the name of a column of ours
    headings = (f"decoded_{name}" if name in own else plain_cell(name) for name in names)
    writer.writerow([*own, *headings])
    for time, station, fields in decoded.rows:
        cells = (fields.get(name) for name in names)
        texts = (
            json.dumps(cell, separators=(" ", ":")) if isinstance(cell, list | dict) else cell
            for cell in cells
        )
        writer.writerow(
            [utc_after(time, UNIX_EPOCH, 3), plain_cell(station), *map(plain_cell, texts)]
        )
    return text.getvalue()
