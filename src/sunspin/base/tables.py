"""Files with rows and columns: CSV, JSON lines, Parquet or NetCDF in, text cells out, or one sentence on what is wrong.

Cells stay text until the vehicle file has said what they are, so that an error can name the line and show what stands there.
"""

from __future__ import annotations

import csv
import hashlib
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd

from sunspin.base.errors import TelemetryError
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
    """A file as text: its cells, indexed by the line of each row and the name of each column, comments, hash; its name in messages;
    a NetCDF file as it is."""

    cells: pd.DataFrame
    comments: list[str]
    sha256: str
    where: str = ""
    data: xr.Dataset | None = None

    @property
    def header(self) -> list[str]:
        return self.cells.columns.tolist()

    def has(self, names: Iterable[str]) -> bool:
        """Whether the table has all of these columns."""
        return set(names) <= set(self.cells.columns)

    def numbers(self, names: Sequence[str]) -> np.ndarray:
        """The cells of these columns as numbers (rows, columns), NaN where one is none.

        A cell may be damaged; `TelemetryError` is raised where the file writes its numbers in a form that is not read: with a
        decimal comma, or no number in a whole column.
        """
        values = np.empty((len(self.cells), len(names)))
        for k, name in enumerate(names):
            cells = self.cells[name].tolist()
            values[:, k] = [plain_number(cell) for cell in cells]
            none = np.flatnonzero(np.isnan(values[:, k])).tolist()
            for i in none:
                comma = DECIMAL_COMMA.fullmatch(cells[i])
                if comma or (len(none) == len(cells) and any(map(str.isdigit, cells[i]))):
                    what = "no cell of this column is a number"
                    what = "the number has a decimal comma" if comma else what
                    do, where = (
                        "write plain decimals with a point, such as -1.5e-3",
                        self.place(i, name),
                    )
                    raise TelemetryError(what, got=cells[i], do=do, where=where)
        return values

    def place(self, row: int, name: str) -> str:
        """A cell in messages."""
        return f"{self.where}, line {self.cells.index[row]}, column {name!r}"


def read_table(path: Path) -> Table:
    """Read a table; the kind of file follows from its first bytes, not from its name."""
    where = str(path)
    content = read_bytes(path, MAX_FILE_BYTES, "telemetry file", TelemetryError, "check the path")
    data, comments = None, []
    if content.startswith(b"PAR1"):
        cells = _of_columns(_parquet(content, where))
    elif content.startswith(b"\x89HDF\r\n\x1a\n"):
        columns, data = _netcdf(content, where)
        cells = _of_columns(columns)
    elif content.startswith(b"CDF"):
        do = "convert it to NetCDF-4 (nccopy -k nc4)"
        raise TelemetryError("this is NetCDF of version 3", do=do, where=where)
    else:
        text = decoded(content, where, TelemetryError, "save it as CSV in UTF-8")
        if not text.strip():
            do = "a CSV with a header and one row per sample"
            raise TelemetryError("the file is empty", do=do, where=where)
        if "\0" in text:
            do = "save it as CSV in UTF-8"
            raise TelemetryError("the file holds binary data", do=do, where=where)
        if text.lstrip()[0] in "{[":
            cells = json_rows(text, where, MAX_COLUMNS, MAX_CELLS)
        elif RAW_FRAME.fullmatch(text.splitlines()[0].strip()):
            cells = _raw_frames(text, where)
        else:
            cells, comments = _csv(text, where)
    if cells.empty:
        raise TelemetryError("the file holds no samples", where=where)
    return Table(cells, comments, hashlib.sha256(content).hexdigest(), where, data)


def _csv(text: str, where: str) -> tuple[pd.DataFrame, list[str]]:
    """Cells and comments. Rows are checked before pandas reads them: it fills short ones up."""
    lines = text.splitlines()
    begin = next((k for k, line in enumerate(lines) if line.strip() and line[0] != "#"), len(lines))
    comments = [words for line in lines[:begin] if (words := line.lstrip("# ").strip())]
    mark = max(DELIMITERS, key=lines[begin].count) if begin < len(lines) else ","
    rows = {
        number: line
        for number, line in enumerate(lines[begin:], begin + 1)
        if line.strip(f' {mark}\t"')
    }
    width = 0
    for number, line in rows.items():
        at = f"{where}, line {number}"
        try:
            quoted = '"' in line
            n = (
                len(next(csv.reader([line], strict=True, delimiter=mark)))
                if quoted
                else line.count(mark) + 1
            )
        except csv.Error as error:
            do = "close the quotes, or remove them"
            raise TelemetryError(f"this is not valid CSV ({error})", do=do, where=at) from None
        width = width or n
        if n != width:
            what = f"the row has {n} values but the header names {width} columns"
            raise TelemetryError(what, do="complete or remove the row", where=at)
        if n > MAX_COLUMNS:
            what = f"the file has more than {MAX_COLUMNS} columns"
            raise TelemetryError(what, got=n, where=where)
    if len(rows) < 2:
        raise TelemetryError("the file has a header but no samples", where=where)
    cells = pd.read_csv(
        io.StringIO("\n".join(rows.values())), sep=mark, header=None, dtype=object, na_filter=False
    )
    header = cells.iloc[0].str.strip()
    for name in header[header.duplicated()]:
        if re.fullmatch(r"[-+.\deE]*", name):
            what = "the first row holds numbers and no names of columns"
            do = "write a header above it"
        else:
            what, do = "two columns share a name", "rename one"
        raise TelemetryError(what, got=name or "an empty cell", do=do, where=where)
    cells = cells.iloc[1:].set_axis(list(rows)[1:]).set_axis(header.tolist(), axis=1)
    return (cells.map(_with_point) if mark == ";" else cells), comments


def _with_point(cell: str) -> str:
    match = DECIMAL_COMMA.fullmatch(cell) if "," in cell else None
    return cell if match is None else f"{match[1]}.{match[2]}"


def _raw_frames(text: str, where: str) -> pd.DataFrame:
    rows = {}
    for number, line in enumerate(text.splitlines(), 1):
        cells = line.strip().split("|")
        if not RAW_FRAME.fullmatch(line.strip()) or len(cells) > len(FRAME_COLUMNS):
            if not line.strip():
                continue
            what = "a line of raw frames is a time, a bar and the frame in hexadecimal digits"
            at = f"{where}, line {number}"
            raise TelemetryError(what, got=line[:60], do="remove the line", where=at)
        rows[number] = cells + [""] * (len(FRAME_COLUMNS) - len(cells))
    return pd.DataFrame.from_dict(rows, "index", dtype=object, columns=list(FRAME_COLUMNS))


def _parquet(content: bytes, where: str) -> dict[str, np.ndarray]:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        do = 'pip install "sunspin[parquet]", or save the file as CSV'
        raise TelemetryError("reading Parquet needs pyarrow", do=do, where=where) from None
    try:
        about = pq.read_metadata(pa.BufferReader(content))
        if about.num_rows * max(about.num_columns, 1) > MAX_CELLS:
            what = f"the file has more than {MAX_CELLS:.0e} cells"
            got = f"{about.num_rows} rows of {about.num_columns}"
            raise TelemetryError(what, got=got, do="cut it into parts", where=where)
        table = pq.read_table(pa.BufferReader(content))
        return {str(name): table[name].to_numpy() for name in table.column_names}
    except TelemetryError:
        raise
    except Exception as error:  # a damaged file makes the library raise whatever comes
        what = f"this Parquet file cannot be read ({str(error)[:200]})"
        raise TelemetryError(what, where=where) from None


def _netcdf(content: bytes, where: str) -> tuple[dict[str, np.ndarray], xr.Dataset]:
    """Every variable over the one dimension that the samples share; (time, panel) becomes a column per panel. And the whole."""
    from sunspin.base.netcdf import read_netcdf

    data = read_netcdf(io.BytesIO(content), where, TelemetryError)
    sizes = {
        name: size
        for name, size in data.sizes.items()
        if name in data.coords or len(data.sizes) == 1
    }
    axis = "time" if "time" in data.sizes else max(sizes, key=sizes.__getitem__, default=None)
    if axis is None:
        what = "the NetCDF file has no dimension of samples"
        raise TelemetryError(what, do="name it time", where=where)
    columns: dict[str, np.ndarray] = {}
    for name, variable in data.variables.items():
        if variable.dims == (axis,):
            columns[str(name)] = variable.values
        elif variable.ndim == 2 and axis in variable.dims and len(set(variable.dims)) == 2:
            (second,) = set(variable.dims) - {axis}
            labels = data[second].values if second in data.coords else range(data.sizes[second])
            values = variable.transpose(axis, second).values
            columns.update((str(label), values[:, k]) for k, label in enumerate(labels))
    return columns, data


def _of_columns(columns: Mapping[str, np.ndarray]) -> pd.DataFrame:
    """Columns as text cells, rows counted from one."""
    cells = {name: _as_text(column) for name, column in columns.items()}
    table = pd.DataFrame(cells, dtype=object)
    return table.set_axis(np.arange(1, len(table) + 1))


def _as_text(column: np.ndarray) -> list[str]:
    if np.issubdtype(column.dtype, np.datetime64):
        times = np.asarray(column, dtype="datetime64[us]")
        return ["" if np.isnat(time) else f"{time}Z" for time in times]
    if np.issubdtype(column.dtype, np.number) and column.dtype.kind != "c":
        return [repr(value) for value in column.astype(np.float64).tolist()]
    return [str(value) for value in column.tolist()]  # complex cells are no numbers of ours
