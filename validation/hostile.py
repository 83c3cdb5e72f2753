"""Hostile vehicle files, tables and values of options, each drawn from a generator that the caller passes."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache, partial
from importlib import resources

import numpy as np

from tests.support.corruptions import BYTES, CELLS

NUMBERS = tuple("0 -0.0 1 -1 nan inf 1e308 5e-324 1e12 1e30 1e-30 0.1 1000000000000".split())

WORDS = (
    '""',
    '"x"',
    '"\\u0000"',
    '"\\u001b[31mred\\u001b[0m"',
    '"\\u202egnp"',
    '"<script>alert(1)</script>"',
    '"../../etc/passwd"',
    "'''a\nb'''",
    '"\\U0001F6F0"',
    '"' + "x" * 5000 + '"',
    '"flag"',
    '"elapsed"',
    '"current_A"',
    '"0001-01-01T00:00:00+23:59"',
    '"px"',
    '"e\\u0301"',
)

ODD = (
    "true",
    "2026-01-01T00:00:00Z",
    "[]",
    "{}",
    "[1, 2]",
    "[0, 0, 0]",
    "[1e308, 1e308, 1e308]",
    "[nan, 0, 0]",
    "[[1e308,0,0],[0,1e308,0],[0,0,1e308]]",
    "[[1,0,0],[0,1,0],[0,0,1e-30]]",
    "[[1,0.999999,0],[0.999999,1,0],[0,0,1.5]]",
    "{ value = nan }",
    "{ value = [1, 0, 0] }",
    "{ value = 1, sigma = -1 }",
    '{ value = 1, source = "" }',
    "{ value = { value = 1 } }",
    "{ a = 1 }",
    '["px", "px", "px"]',
    '["px", "nowhere", "py"]',
    "9" * 5000,
    "0x" + "f" * 5000,
    "[" * 4000 + "]" * 4000,
    "[" + "1," * 20000 + "1]",
    '["' + "y" * 2000 + '"]',
    '"unfinished',
    "1.2.3",
)

VALUES = NUMBERS + WORDS + ODD


@cache
def vehicles() -> tuple[str, ...]:
    """Return texts to start from: the template, the template with all its examples made valid, and the built-in ones."""
    package = resources.files("sunspin")
    template = package.joinpath("template", "vehicle.toml").read_text("utf-8")
    opened = re.sub(r"^# (?=\[|[a-zA-Z_]+ = )", "", template, flags=re.MULTILINE)
    built_in = [
        package.joinpath("cases", name, "vehicle.toml").read_text("utf-8")
        for name in ("philae", "skcube")
    ]
    return template, template, template, opened, *built_in


def _pick(rng: np.random.Generator, choices: tuple | list):
    """Draw one of the choices; all are equally probable, and one that is listed twice is drawn twice as often."""
    return choices[int(rng.integers(len(choices)))]


def vehicle(rng: np.random.Generator) -> bytes:
    """Return a vehicle file with one to four errors, one with damaged bytes, or a bomb (a huge or unusual file of `BOMBS`)."""
    text = _pick(rng, vehicles())
    if rng.random() < 0.06:
        return _pick(rng, BOMBS)(text).encode("utf-8", "surrogatepass")
    if rng.random() < 0.1:
        return _pick(rng, BYTES)(text.encode(), rng)
    for _ in range(int(rng.integers(1, 5))):
        text = _pick(rng, EDITS)(text, rng)
    return text.encode("utf-8", "surrogatepass")


def _assignments(text: str) -> list[re.Match]:
    """Return a match for each key and value of a text."""
    return list(re.finditer(r"^([^\s#\[][^=\n]*?)\s*=\s*([^#\n]*)", text, re.MULTILINE))


def _replace_value(text: str, rng: np.random.Generator) -> str:
    """Replace the value of a key; a text without keys gets one at its beginning."""
    match = _pick(rng, _assignments(text) or [re.match("", text)])
    return (
        text[: match.start()]
        + f"{match.group(1) if match.lastindex else 'x'} = {_pick(rng, VALUES)} "
        + text[match.end() :]
    )


def _replace_number(text: str, rng: np.random.Generator) -> str:
    """Replace a number."""
    match = _pick(rng, list(re.finditer(r"(?<![\w.])-?\d[\d.eE+-]*", text)) or [re.match("", text)])
    return text[: match.start()] + _pick(rng, NUMBERS) + text[match.end() :]


def _replace_word(text: str, rng: np.random.Generator) -> str:
    """Replace a quoted string."""
    match = _pick(rng, list(re.finditer(r'"[^"\n]*"', text)) or [re.match("", text)])
    return text[: match.start()] + _pick(rng, WORDS) + text[match.end() :]


def _delete_line(text: str, rng: np.random.Generator) -> str:
    """Delete a line."""
    lines = text.splitlines(keepends=True)
    if lines:
        del lines[int(rng.integers(len(lines)))]
    return "".join(lines)


def _repeat_line(text: str, rng: np.random.Generator) -> str:
    """Repeat a line."""
    lines = text.splitlines(keepends=True) or [""]
    at = int(rng.integers(len(lines)))
    return "".join([*lines[:at], lines[at], *lines[at:]])


def _insert_line(text: str, rng: np.random.Generator) -> str:
    """Insert a line."""
    lines = text.splitlines(keepends=True)
    known = [match.group(1) for match in _assignments(text)] or ["x"]
    new = _pick(
        rng,
        [
            f"{_pick(rng, known)} = {_pick(rng, VALUES)}\n",
            "[[panel]]\n",
            "[body]\n",
            "[a.b.c]\n",
            "[[wheel]]\n",
            "x.y = 1\n",
            "[gyro]\n",
            "[antenna]\n",
            "[[leg]]\n",
            "[telemetry.columns]\n",
            "=\n",
            "\x00\n",
            "\ufeff\n",
        ],
    )
    at = int(rng.integers(len(lines) + 1))
    return "".join([*lines[:at], new, *lines[at:]])


def _swap_tables(text: str, rng: np.random.Generator) -> str:
    """Exchange two tables."""
    parts = re.split(r"^(?=\[)", text, flags=re.MULTILINE)
    i, k = rng.integers(len(parts), size=2)
    parts[i], parts[k] = parts[k], parts[i]
    return "".join(parts)


EDITS = (
    *[_replace_value] * 3,
    *[_replace_number] * 3,
    _replace_word,
    _delete_line,
    _repeat_line,
    _insert_line,
    _swap_tables,
)

AXES = ("[1, 0, 0]", "[0, 1, 0]", "[0, 0, 1]", "[0.6, 0.8, 0]", "[0, 0.6, 0.8]", "[-0.6, 0, 0.8]")


def _repeat_table(
    head: str, line: Callable[[int], str], n: int, keep_panels: bool = True
) -> Callable[[str], str]:
    """Return a function that adds `n` tables of a kind to a text."""

    def bomb(text: str) -> str:
        """Return the text, or a short one without panels, with the tables added."""
        if not keep_panels:
            text = "name = 'many'\n[telemetry]\ntime_column = 'time_utc'\n"
        return text + "\n" + "".join(f"[[{head}]]\nname = 'n{i}'\n{line(i)}" for i in range(n))

    return bomb


def _random_direction(i: int) -> str:
    """Return direction number `i` as text."""
    v = np.random.default_rng(i).normal(size=3)
    return str((v / np.linalg.norm(v)).tolist())


BOMBS: tuple[Callable[[str], str], ...] = (
    _repeat_table(
        "panel", lambda i: f"cells = 1\nnormal_B = {_random_direction(i)}\n", 60, keep_panels=False
    ),
    _repeat_table(
        "panel",
        lambda i: f"cells = 1\nnormal_B = {_random_direction(i)}\n",
        4000,
        keep_panels=False,
    ),
    _repeat_table(
        "panel", lambda i: f"cells = 1\nnormal_B = {AXES[i % 6]}\n", 3000, keep_panels=False
    ),
    _repeat_table("wheel", lambda i: f"inertia_kg_m2 = 1e-7\naxis_B = {AXES[i % 6]}\n", 40),
    _repeat_table("wheel", lambda i: f"inertia_kg_m2 = 1e-9\naxis_B = {AXES[i % 6]}\n", 3000),
    _repeat_table("leg", lambda i: f"tip_B_m = {_random_direction(i)}\n", 8000),
    lambda text: text + "\n[[hull]]\nname = 'h'\npoints_B_m = [" + "[0.1,0.2,0.3]," * 60000 + "]\n",
    lambda text: "x = " + "[" * 200_000,
    lambda text: "a." * 200_000 + "a = 1",
    lambda text: "a = {" * 20_000,
    lambda text: "[" + "a." * 100_000 + "a]",
    lambda text: text + "\n#" + "x" * 2_000_000,
    lambda text: "name = '" + "x" * 900_000 + "'",
    lambda text: text.replace("\n", "\r\n"),
    lambda text: text.replace("\n", "\r"),
    lambda text: "\n" * 900_000,
    lambda text: text + "[[sun_rule]]\nall_dark = ['+X']\nreason = 'r'\n" * 5000,
    lambda text: (
        text + "\n[telemetry.columns]\n" + "".join(f"'c{i}' = 'x'\n" for i in range(30000))
    ),
)


def table(content: bytes, rng: np.random.Generator) -> bytes:
    """Return a CSV with one to three errors, or a bomb of `TABLE_BOMBS`. A table of fewer than four lines is left as it is."""
    if rng.random() < 0.08:
        return _pick(rng, TABLE_BOMBS)(content)
    for _ in range(int(rng.integers(1, 4))):
        if len(content.splitlines()) < 4:
            break
        try:
            content = (
                _pick(rng, CELLS)(content, rng)
                if rng.random() < 0.75
                else _pick(rng, BYTES)(content, rng)
            )
        except (IndexError, ValueError):  # rows of unequal length, or none
            break
    return content


TIMES = (
    b"2016-12-31T23:59:60Z",
    b"0001-01-01T00:00:00+23:59",
    b"9999-12-31T23:59:59Z",
    b"20260101T000000Z",
    b"2026-01-01T24:00:00Z",
    b"2026-01-01 00:00:00 CET",
    b"01/02/2026 12:00:00 AM",
    b"1767225600",
    b"46023.5",
    b"NaT",
)
"""Forms of time for the first cell of a row, right and wrong ones."""


def _map_cells(
    content: bytes, cell: Callable[[int, bytes], bytes], other: bytes | None = None
) -> bytes:
    """Return the table with changed cells, below its comments and header.

    The first cell of each sample is `cell` of the sample's number and the old content. Its remaining cells are `other`, or
    unchanged without it.
    """
    lines = content.splitlines()
    # number of lines before the first sample
    head = next((i for i, line in enumerate(lines) if not line.startswith(b"#")), 0) + 1
    rows = [line.split(b",") for line in lines[head:]]
    lines_out = [
        b",".join([cell(k, row[0]), *(row[1:] if other is None else [other] * (len(row) - 1))])
        for k, row in enumerate(rows)
    ]
    return b"\n".join([*lines[:head], *lines_out]) + b"\n"


def _set_first_time(time: bytes) -> Callable[[bytes], bytes]:
    """Return a function that replaces the time of the first sample."""
    return lambda content: _map_cells(content, lambda k, cell: time if k == 0 else cell)


def _repeat_row(content: bytes, count: int) -> bytes:
    """Return the table with its first sample `count` times."""
    lines = content.splitlines(keepends=True)
    return b"".join(lines[:2]) + lines[2] * count


TABLE_BOMBS: tuple[Callable[[bytes], bytes], ...] = (
    lambda content: b"," * 3_000_000,
    lambda content: b"time_utc,px\n" + b"x" * 3_000_000,
    lambda content: b"time_utc," + b",".join(b"c%d" % i for i in range(200_000)) + b"\n1\n",
    lambda content: (
        b"time_utc,"
        + b",".join(b"c%d" % i for i in range(3000))
        + b"\n"
        + (b"1," * 3000 + b"1\n") * 40
    ),
    lambda content: b'"' + content,
    lambda content: content + b'"\n' * 1000,
    lambda content: _repeat_row(content, 30_000),
    lambda content: b"#" * 2_000_000 + b"\n" + content,
    lambda content: b"# x\n" * 200_000 + content,
    lambda content: content.replace(b"\n", b"\r"),
    lambda content: content.replace(b"\n", b"\r\n\r\n"),
    lambda content: content.replace(b",", b";"),
    lambda content: content.replace(b",", b"\t"),
    lambda content: content.replace(b"\n", b"\xc2\x85"),
    lambda content: b"\xef\xbb\xbf" + content,
    lambda content: b"PAR1" + content,
    lambda content: b"\x89HDF\r\n\x1a\n" + content,
    lambda content: b"CDF\x01" + content,
    lambda content: content.replace(b"0", "\u0660".encode()),
    lambda content: content.replace(b"time_utc", b"\x1b[2Jtime_utc"),
    lambda content: content.decode("utf-8", "replace").encode("utf-16"),
    lambda content: content.decode("utf-8", "replace").encode("cp500", "replace"),
    lambda content: b"".join(content.splitlines(keepends=True)[2:]),
    *(_set_first_time(time) for time in TIMES),
    *(
        partial(_map_cells, cell=lambda _, cell: cell, other=value)
        for value in (b"0", b"1e-300", b"1e-20", b"1e29", b"1_0", b"")
    ),
)


OPTION_NUMBERS = (*NUMBERS, "9" * 400, "", " ", "0x10", "\u0664", "99999999999999999999")
TEXTS = (
    "",
    " ",
    ",",
    "1,2",
    "0,0,0",
    "inf,0,1",
    "1e308,1e308,1e308",
    "0.1,0,0.2",
    "0:1:0.5",
    "0:1:0",
    "0:1:1e-9",
    "-0.1:0.1:0.1",
    "0:inf:1",
    "-1e308:1e308:1e307",
    "0:1:1e-320",
    "a",
    "\u202e",
    "\x1b[31m",
    "x" * 5000,
    "\udcff\udcfe",
    "{0}",
    "--help",
    "-",
    "philae",
    "off",
    "delay:1e308",
    "delay:nan",
    "after_rest",
    "180",
    "J2000",
    "LOCAL",
    "my LOCAL frame'",
    "2026-01-01T00:00:00Z",
    "0001-01-01T00:00:00+23:59",
    "9999-12-31T23:59:59",
    "coast",
    "emd",
    "gyro",
)
