"""Files with rows and columns: CSV, JSON, Parquet or NetCDF in, text cells out, or one sentence on what is wrong.

Cells stay text until the vehicle file has said what they are, so that an error can name the line and show what stands there.

JSON has an object a row: in lines, in a list, or in a page of SatNOGS DB's interface. Columns are named by keys; what lies inside
of another object or list has both names with a point between (`sun.0`, `decoded.eps.u_bat`). A text that holds an object itself, as
the field `decoded` of SatNOGS, is read as that object.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from sunspin.base.errors import TelemetryError
from sunspin.base.untrusted import decode_text, plain_number, read_bytes

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

MAX_DEPTH = 8
"""Objects of JSON inside of each other; no telemetry has more."""

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
                    do = "write plain decimals with a point, such as -1.5e-3"
                    raise TelemetryError(what, got=cells[i], do=do, where=self.place(i, name))
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
        cells = _text_cells(_read_parquet(content, where))
    elif content.startswith(b"\x89HDF\r\n\x1a\n"):
        columns, data = _read_netcdf(path)
        cells = _text_cells(columns)
    elif content.startswith(b"CDF"):
        do = "convert it to NetCDF-4 (nccopy -k nc4)"
        raise TelemetryError("this is NetCDF of version 3", do=do, where=where)
    else:
        text = decode_text(content, where, TelemetryError, "save it as CSV in UTF-8")
        if "\0" in text or not text.strip():
            what = "the file holds binary data" if text.strip() else "the file is empty"
            do = "give a CSV in UTF-8 with a header and one row per sample"
            raise TelemetryError(what, do=do, where=where)
        if text.lstrip()[0] in "{[":
            cells = _read_json(text, where)
        else:
            cells, comments = _read_csv(text, where)
    if cells.empty:
        raise TelemetryError("the file holds no samples", where=where)
    return Table(cells, comments, hashlib.sha256(content).hexdigest(), where, data)


def _read_csv(text: str, where: str) -> tuple[pd.DataFrame, list[str]]:
    """Cells and comments. Rows are checked before pandas reads them: it fills short ones up."""
    lines = text.splitlines()
    begin = next((k for k, line in enumerate(lines) if line.strip() and line[0] != "#"), len(lines))
    remarks = [*lines[:begin], *(line for line in lines[begin:] if line.startswith("#"))]
    comments = [words for line in remarks if (words := line.lstrip("# ").strip())]
    first = lines[begin] if begin < len(lines) else ""
    mark, header = max(DELIMITERS, key=first.count), {}
    if RAW_FRAME.fullmatch(first.strip()):
        mark, header = "|", {0: "|".join(FRAME_COLUMNS[: first.count("|") + 1])}
    rows = header | {
        number: line
        for number, line in enumerate(lines[begin:], begin + 1)
        if line.strip(f' {mark}\t"') and line[0] != "#"
    }
    width = 0
    for number, line in rows.items():
        at = f"{where}, line {number}"
        n = line.count(mark) + 1
        if '"' in line:
            try:
                n = len(next(csv.reader([line], strict=True, delimiter=mark)))
            except csv.Error as error:
                what, do = f"this is not valid CSV ({error})", "close the quotes, or remove them"
                raise TelemetryError(what, do=do, where=at) from None
        width = width or n
        if n != width:
            what = f"the row has {n} values but the header names {width} columns"
            raise TelemetryError(what, do="complete or remove the row", where=at)
    _require_size(1, width, where)
    if len(rows) < 2:
        raise TelemetryError("the file has a header but no samples", where=where)
    cells = pd.read_csv(
        io.StringIO("\n".join(rows.values())), sep=mark, header=None, dtype=object, na_filter=False
    )
    names = cells.iloc[0].str.strip()
    for name in names[names.duplicated()]:
        what, do = "two columns share a name", "rename one"
        if re.fullmatch(r"[-+.\deE]*", name):
            what = "the first row holds numbers and no names of columns"
            do = "write a header above it"
        raise TelemetryError(what, got=name or "an empty cell", do=do, where=where)
    cells = cells.iloc[1:].set_axis(list(rows)[1:]).set_axis(names.tolist(), axis=1)
    if mark == ";":
        cells = cells.map(lambda c: c.replace(",", ".") if DECIMAL_COMMA.fullmatch(c) else c)
    return cells, comments


def _read_json(text: str, where: str) -> pd.DataFrame:
    """Cells (empty where a row has no such key), indexed by the line of each row, or counted from one in a list or page; columns
    in the order in which they come."""
    texts = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    first = texts[0][1].strip()
    if not (first[0] == "{" and first[-1] == "}"):  # else each line is an object by itself
        texts = [(1, text)]
    rows: list[dict[str, str]] = []
    lines: list[int] = []
    for number, line in texts:
        try:
            item = json.loads(line, object_pairs_hook=_object_without_repeats)
        except (ValueError, RecursionError) as error:  # of a key twice too, or thousands of digits
            why = getattr(error, "msg", str(error))[:100]
            why = "it is nested too deeply" if isinstance(error, RecursionError) else why
            what, at = f"this is not valid JSON ({why})", number + getattr(error, "lineno", 1) - 1
            do = "write one object a line"
            raise TelemetryError(what, do=do, where=f"{where}, line {at}") from None
        page = item.get("results") if isinstance(item, dict) else item
        for at, row in enumerate(page, 1) if isinstance(page, list) else [(number, item)]:
            place = f"{where}, line {at}"
            if not isinstance(row, dict):
                what = "a row of a JSON file must be an object"
                raise TelemetryError(what, got=str(row)[:60], where=place)
            rows.append(dict(_leaves(row, "", place, 0)))
            lines.append(at)
    names = dict.fromkeys(name for row in rows for name in row)
    _require_size(len(rows), len(names), where)
    cells = [[row.get(name, "") for name in names] for row in rows]
    return pd.DataFrame(cells, lines, list(names), dtype=object)


def _require_size(rows: int, columns: int, where: str) -> None:
    if columns > MAX_COLUMNS or rows * columns > MAX_CELLS:
        what = f"the file has more than {MAX_COLUMNS} columns or more than {MAX_CELLS:.0e} cells"
        got = f"{rows} rows of {columns}"
        raise TelemetryError(what, got=got, do="cut it into parts", where=where)


def _object_without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(dict(pairs)) < len(pairs):
        raise ValueError("a key stands twice in an object")
    return dict(pairs)


def _leaves(item: Any, name: str, where: str, depth: int) -> Iterator[tuple[str, str]]:
    """Names and texts of what lies in an object or list, however deep."""
    if depth > MAX_DEPTH:
        what = f"objects lie more than {MAX_DEPTH} deep in each other"
        raise TelemetryError(what, where=where)
    if isinstance(item, str) and item[:1] == "{" and item[-1:] == "}":
        try:
            item = json.loads(item, object_pairs_hook=_object_without_repeats)
        except (ValueError, RecursionError):
            pass  # a text that only looks like an object stays a text
    if isinstance(item, dict | list):
        for key, value in item.items() if isinstance(item, dict) else enumerate(item):
            inner = f"{name}.{key}" if name else str(key).strip()
            yield from _leaves(value, inner, where, depth + 1)
    else:
        yield name, "" if item is None else str(int(item) if isinstance(item, bool) else item)


def _read_parquet(content: bytes, where: str) -> dict[str, np.ndarray]:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq

        file = pq.ParquetFile(pa.BufferReader(content))
        _require_size(file.metadata.num_rows, file.metadata.num_columns, where)
        table = file.read()
        return {str(name): table[name].to_numpy() for name in table.column_names}
    except TelemetryError:
        raise
    except Exception as error:  # a damaged file makes the library raise whatever comes
        what = f"this Parquet file cannot be read ({str(error)[:200]})"
        do = 'save it as CSV, or install pyarrow with pip install "sunspin[parquet]"'
        raise TelemetryError(what, do=do, where=where) from None


def _read_netcdf(path: Path) -> tuple[dict[str, np.ndarray], xr.Dataset]:
    """Every variable over the one dimension that the samples share; (time, panel) becomes a column per panel. And the whole."""
    from sunspin.base.netcdf import read_netcdf

    data = read_netcdf(path, str(path), TelemetryError)
    own = [name for name in data.sizes if name in data.coords or len(data.sizes) == 1]
    longest = max(own, key=lambda name: data.sizes[name], default=None)
    axis = "time" if "time" in data.sizes else longest
    if axis is None:
        what = "the NetCDF file has no dimension of samples"
        raise TelemetryError(what, do="name it time", where=str(path))
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


def _text_cells(columns: Mapping[str, np.ndarray]) -> pd.DataFrame:
    """Columns as text cells, rows counted from one."""
    cells = {}
    for name, column in columns.items():
        values = column.tolist()
        if np.issubdtype(column.dtype, np.datetime64):
            times = np.asarray(column, dtype="datetime64[us]")
            values = ["" if np.isnat(time) else f"{time}Z" for time in times]
        elif np.issubdtype(column.dtype, np.number) and column.dtype.kind != "c":
            values = column.astype(np.float64).tolist()
        cells[name] = [str(value) for value in values]  # complex cells are no numbers of ours
    return pd.DataFrame(cells, dtype=object).rename(index=lambda row: row + 1)
