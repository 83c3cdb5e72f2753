"""Files with rows and columns: CSV, JSON lines, Parquet or NetCDF in, text cells out, or one sentence on what is wrong.

Cells stay text until the vehicle file has said what they are, so that an error can name the line and show what stands there.
"""

from __future__ import annotations

import csv
import hashlib
import io
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sunspin.base.errors import TelemetryError, sentence
from sunspin.base.json_rows import json_rows
from sunspin.base.untrusted import decoded, plain_number, read_bytes

if TYPE_CHECKING:
    import xarray as xr

MAX_FILE_BYTES = 500_000_000
"""A year of 1 Hz samples of six panels is about this much."""

MAX_COLUMNS = 10_000
"""No telemetry has more; a file of one line of commas does."""

MAX_CELLS = 100_000_000
"""Cells of a file in columns, which may hold any number of them in few bytes: beyond these it would not fit into memory."""

DELIMITERS = ",;\t"
"""What may part the columns: the one that the header has most of."""

DECIMAL_COMMA = re.compile(r"(\s*[-+]?\d*),(\d+([eE][-+]?\d+)?\s*)", re.ASCII)
"""A number as written where the semicolon parts the columns."""

RAW_FRAME = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\|[0-9A-Fa-f]+(\|[^|]*)*", re.ASCII)
"""A line of SatNOGS DB's export of raw frames, which has no header."""

FRAME_COLUMNS = ("timestamp", "frame", "observation_id", "observer")
"""Its columns, named as in the same data base's JSON; the last two are in later exports."""


class Table(NamedTuple):
    """A file as text: header, rows of cells, the line each row stands on, comments, hash; a NetCDF file as it is; its name in
    messages."""

    header: list[str]
    rows: list[list[str]]
    lines: list[int]
    comments: list[str]
    sha256: str
    data: xr.Dataset | None = None
    where: str = ""

    def numbers(self, columns: Sequence[int]) -> np.ndarray:
        """The cells of these columns as numbers (rows, columns), NaN where one is none.

        A cell may be damaged; `TelemetryError` is raised where the file writes its numbers in a form that is not read: with a
        decimal comma, or no number in a whole column.
        """
        values = np.array([[plain_number(row[at]) for at in columns] for row in self.rows]).reshape(
            len(self.rows), len(columns)
        )
        none = np.isnan(values)
        empty = np.flatnonzero(none.all(axis=0)).tolist()
        for i, k in np.argwhere(none):
            cell = self.rows[i][columns[k]]
            comma = DECIMAL_COMMA.fullmatch(cell)
            if comma or (k in empty and any(map(str.isdigit, cell))):
                what = (
                    "the number has a decimal comma"
                    if comma
                    else "no cell of this column is a number"
                )
                do = "write plain decimals with a point, such as -1.5e-3"
                raise TelemetryError(
                    sentence(what, got=cell, do=do, where=self.place(i, columns[k]))
                )
        return values

    def place(self, row: int, column: int) -> str:
        """A cell in messages."""
        return f"{self.where}, line {self.lines[row]}, column {self.header[column]!r}"


def read_table(path: Path) -> Table:
    """Read a table; the kind of file is told by its first bytes, not by its name."""
    return _read(path, str(path))._replace(where=str(path))


def _read(path: Path, where: str) -> Table:
    content = read_bytes(path, MAX_FILE_BYTES, "telemetry file", TelemetryError, "check the path")
    if content[:4] == b"PAR1":
        return _from_columns(_parquet(content, where), where, content)
    if content[:8] == b"\x89HDF\r\n\x1a\n":
        columns, data = _netcdf(content, where)
        return _from_columns(columns, where, content)._replace(data=data)
    if content[:3] == b"CDF":
        raise TelemetryError(
            sentence(
                "this is NetCDF of version 3",
                do="convert it to NetCDF-4 (nccopy -k nc4)",
                where=where,
            )
        )
    return _from_text(content, where)


def _from_text(content: bytes, where: str) -> Table:
    text = decoded(content, where, TelemetryError, "save it as CSV in UTF-8")
    if not text.strip():
        raise TelemetryError(
            sentence(
                "the file is empty", do="a CSV with a header and one row per sample", where=where
            )
        )
    if "\0" in text:
        raise TelemetryError(
            sentence("the file holds binary data", do="save it as CSV in UTF-8", where=where)
        )
    sha256 = hashlib.sha256(content).hexdigest()
    if text.lstrip()[0] in "{[":
        return Table(*json_rows(text, where, MAX_COLUMNS, MAX_CELLS), [], sha256)
    lines = text.splitlines()
    if RAW_FRAME.fullmatch(lines[0].strip()):
        return _raw_frames(lines, where, sha256)
    return _split(text, where, sha256)


def _raw_frames(lines: list[str], where: str, sha256: str) -> Table:
    rows, numbers = [], []
    for number, line in enumerate(lines, 1):
        cells = line.strip().split("|")
        if not RAW_FRAME.fullmatch(line.strip()) or len(cells) > len(FRAME_COLUMNS):
            if not line.strip():
                continue
            what = "a line of raw frames is a time, a bar and the frame in hexadecimal digits"
            raise TelemetryError(
                sentence(what, got=line[:60], do="remove the line", where=f"{where}, line {number}")
            )
        rows.append(cells + [""] * (len(FRAME_COLUMNS) - len(cells)))
        numbers.append(number)
    return Table(list(FRAME_COLUMNS), rows, numbers, [], sha256)


def _split(text: str, where: str, sha256: str) -> Table:
    comments: list[str] = []
    lines = text.splitlines()
    skipped = 0
    while skipped < len(lines) and (lines[skipped].startswith("#") or not lines[skipped].strip()):
        comments.append(lines[skipped].lstrip("# ").strip())
        skipped += 1
    mark = max(DELIMITERS, key=lines[skipped].count) if skipped < len(lines) else ","
    reader = csv.reader(lines[skipped:], strict=True, delimiter=mark)
    records = _records(reader, skipped, where)
    header = next(records, (0, []))[1]
    header = [cell.strip() for cell in header]
    if len(header) > MAX_COLUMNS:
        raise TelemetryError(
            sentence(f"the file has more than {MAX_COLUMNS} columns", got=len(header), where=where)
        )
    rows, numbers = [], []
    for number, cells in records:
        if len(cells) != len(header):
            raise TelemetryError(
                sentence(
                    f"the row has {len(cells)} values but the header names {len(header)} columns",
                    do="complete or remove the row",
                    where=f"{where}, line {number}",
                )
            )
        rows.append([_with_point(cell) for cell in cells] if mark == ";" else cells)
        numbers.append(number)
    if not rows:
        raise TelemetryError(sentence("the file has a header but no samples", where=where))
    repeated = sorted(name for name, count in Counter(header).items() if count > 1)
    if repeated and re.fullmatch(r"[-+.\deE]*", repeated[0]):
        what, do = "the first row holds numbers and no names of columns", "write a header above it"
        raise TelemetryError(sentence(what, got=repeated[0] or "an empty cell", do=do, where=where))
    if repeated:
        raise TelemetryError(
            sentence("two columns share a name", got=repeated[0], do="rename one", where=where)
        )
    return Table(header, rows, numbers, [c for c in comments if c], sha256)


def _with_point(cell: str) -> str:
    found = DECIMAL_COMMA.fullmatch(cell) if "," in cell else None
    return cell if found is None else f"{found[1]}.{found[2]}"


def _records(reader: Any, skipped: int, where: str) -> Iterator[tuple[int, list[str]]]:
    while True:
        begins = reader.line_num + 1
        try:
            cells = next(reader)
        except StopIteration:
            return
        except csv.Error as error:
            raise TelemetryError(
                sentence(
                    f"this is not valid CSV ({error})",
                    where=f"{where}, line {skipped + reader.line_num}",
                )
            ) from None
        if reader.line_num > begins:
            what = "a text in quotes goes on in the next line"
            raise TelemetryError(
                sentence(
                    what,
                    do="close the quotes, or remove them",
                    where=f"{where}, line {skipped + begins}",
                )
            )
        if cells and any(cell.strip() for cell in cells):
            yield skipped + reader.line_num, cells


def _parquet(content: bytes, where: str) -> dict[str, np.ndarray]:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise TelemetryError(
            sentence(
                "reading Parquet needs pyarrow",
                do='pip install "sunspin[parquet]", or save the file as CSV',
                where=where,
            )
        ) from None
    try:
        about = pq.read_metadata(pa.BufferReader(content))
        if about.num_rows * max(about.num_columns, 1) > MAX_CELLS:
            raise TelemetryError(
                sentence(
                    f"the file has more than {MAX_CELLS:.0e} cells",
                    got=f"{about.num_rows} rows of {about.num_columns}",
                    do="cut it into parts",
                    where=where,
                )
            )
        table = pq.read_table(pa.BufferReader(content))
        return {str(name): table[name].to_numpy() for name in table.column_names}
    except TelemetryError:
        raise
    except Exception as error:  # a damaged file makes the library raise whatever comes
        raise TelemetryError(
            sentence(f"this Parquet file cannot be read ({str(error)[:200]})", where=where)
        ) from None


def _netcdf(content: bytes, where: str) -> tuple[dict[str, np.ndarray], xr.Dataset]:
    """Every variable over the one dimension that the samples share; (time, panel) becomes a column per panel. And the whole."""
    from sunspin.base.netcdf import read_netcdf

    data = read_netcdf(io.BytesIO(content), where, TelemetryError)
    sizes = {
        name: size
        for name, size in data.sizes.items()
        if name in data.coords or len(data.sizes) == 1
    }
    axis = (
        "time" if "time" in data.sizes else max(sizes, key=lambda name: sizes[name], default=None)
    )
    if axis is None:
        raise TelemetryError(
            sentence("the NetCDF file has no dimension of samples", do="name it time", where=where)
        )
    found: dict[str, np.ndarray] = {}
    for name, variable in data.variables.items():
        if variable.dims == (axis,):
            found[str(name)] = variable.values
        elif (
            variable.ndim == 2 and axis in variable.dims and (other := set(variable.dims) - {axis})
        ):
            (second,) = other
            labels = data[second].values if second in data.coords else range(data.sizes[second])
            for k, label in enumerate(labels):
                found[str(label)] = variable.transpose(axis, second).values[:, k]
    return found, data


def _from_columns(columns: dict[str, np.ndarray], where: str, content: bytes) -> Table:
    header = list(columns)
    cells = [_as_text(column) for column in columns.values()]
    rows = [list(row) for row in zip(*cells, strict=True)]
    if not rows:
        raise TelemetryError(sentence("the file holds no samples", where=where))
    return Table(
        header, rows, list(range(1, len(rows) + 1)), [], hashlib.sha256(content).hexdigest()
    )


def _as_text(column: np.ndarray) -> list[str]:
    if np.issubdtype(column.dtype, np.datetime64):
        return [
            str(value) + "Z" if value == value else ""
            for value in np.asarray(column, dtype="datetime64[us]")
        ]
    if (
        np.issubdtype(column.dtype, np.number) and column.dtype.kind != "c"
    ):  # complex cells are no numbers of ours
        return [repr(value) for value in column.astype(np.float64).tolist()]
    return [str(value) for value in column.tolist()]
