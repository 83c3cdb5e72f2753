"""Ways to damage a telemetry or vehicle file: as bad disks, bad links and bad exports leave them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Corruption = Callable[[bytes, np.random.Generator], bytes]


def flipped(content: bytes, rng: np.random.Generator) -> bytes:
    """Return the content with a few bits flipped."""
    data = bytearray(content)
    for at in rng.integers(0, len(data), size=int(rng.integers(1, 6))):
        data[at] ^= 1 << int(rng.integers(8))
    return bytes(data)


def truncated(content: bytes, rng: np.random.Generator) -> bytes:
    return content[: int(rng.integers(0, len(content)))]


def doubled(content: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(0, len(content)))
    return content[at:] + content[:at]


def with_nul(content: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(0, len(content)))
    return content[:at] + bytes(int(rng.integers(1, 40))) + content[at:]


def empty(content: bytes, rng: np.random.Generator) -> bytes:
    return (b"", b"\n\n", b"#", b"\xef\xbb\xbf")[int(rng.integers(4))]


def noise(content: bytes, rng: np.random.Generator) -> bytes:
    return content[:8] + rng.integers(0, 256, size=500, dtype=np.uint8).tobytes()


def encoded(content: bytes, rng: np.random.Generator) -> bytes:
    codes = "utf-16", "latin-1", "utf-32", "utf-8-sig"
    text = content.decode("utf-8", "replace") + "\u00b0"
    return text.encode(codes[int(rng.integers(4))], "replace")


BYTES: tuple[Corruption, ...] = (flipped, truncated, doubled, with_nul, empty, noise, encoded)


def _cells(change: Callable[[list[list[str]], np.random.Generator], None]) -> Corruption:
    def corrupt(content: bytes, rng: np.random.Generator) -> bytes:
        lines = content.decode("utf-8", "replace").splitlines()
        head = [line for line in lines if line.startswith("#")]
        body = [line for line in lines if not line.startswith("#")]
        mark = ";" if body and body[0].count(";") > body[0].count(",") else ","
        rows = [line.split(mark) for line in body]
        change(rows, rng)
        return ("\n".join([*head, *(mark.join(row) for row in rows)]) + "\n").encode()

    corrupt.__name__ = change.__name__
    return corrupt


def missing_column(rows: list[list[str]], rng: np.random.Generator) -> None:
    k = int(rng.integers(len(rows[0])))
    for row in rows:
        del row[k]


def swapped_columns(rows: list[list[str]], rng: np.random.Generator) -> None:
    i, k = rng.integers(len(rows[0]), size=2)
    for row in rows[1:]:
        row[i], row[k] = row[k], row[i]


ODD = [
    *("nan inf -inf 1e308 -1e300 1e-320".split() + ["", "null", "N/A", "0x1F", "True", "--"]),
    *("9" * 400, "1_000", "\u0664\u0662", "2026-13-45T99:99:99", "0001-01-01T00:00:00+23:59"),
    *("9999-12-31T23:59:59-23:59", '"', "=1+1", "\u202e12", "1,5"),
]


def odd_cells(rows: list[list[str]], rng: np.random.Generator) -> None:
    for _ in range(int(rng.integers(1, 8))):
        row = rows[int(rng.integers(1, len(rows)))]
        row[int(rng.integers(len(row)))] = ODD[int(rng.integers(len(ODD)))]


def odd_column(rows: list[list[str]], rng: np.random.Generator) -> None:
    k, odd = int(rng.integers(len(rows[0]))), ODD[int(rng.integers(len(ODD)))]
    for row in rows[1:]:
        row[k] = odd


def scaled_column(rows: list[list[str]], rng: np.random.Generator) -> None:
    k, factor = int(rng.integers(len(rows[0]))), 10.0 ** float(rng.integers(-12, 12))
    for row in rows[1:]:
        try:
            row[k] = repr(float(row[k]) * factor)
        except ValueError:
            row[k] = row[k][::-1]


def shuffled_rows(rows: list[list[str]], rng: np.random.Generator) -> None:
    rows[1:] = [rows[1 + i] for i in rng.permutation(len(rows) - 1)]


def few_rows(rows: list[list[str]], rng: np.random.Generator) -> None:
    del rows[1 + int(rng.integers(0, 5)) :]


def repeated_rows(rows: list[list[str]], rng: np.random.Generator) -> None:
    rows[2:] = [list(rows[1]) for _ in rows[2:]]


def repeated_header(rows: list[list[str]], rng: np.random.Generator) -> None:
    rows[0][int(rng.integers(len(rows[0])))] = rows[0][0]


CELLS: tuple[Corruption, ...] = tuple(
    _cells(change)
    for change in (
        *(missing_column, swapped_columns, odd_cells, odd_column, scaled_column),
        *(shuffled_rows, few_rows, repeated_rows, repeated_header),
    )
)
