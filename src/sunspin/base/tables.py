"""Reading of files with rows and columns: CSV, JSON, line protocol, Parquet or NetCDF in, text cells out.

Cells stay text until the vehicle file has given their meaning, so that an error can name the line and show its content.

JSON has an object per row: one on each line, in a list, or in a page of a web interface (SatNOGS DB, Elasticsearch). Keys name the
columns. A value inside another object or list has both names, joined by a point (`sun.0`, `decoded.eps.u_bat`). A text that
contains an object, such as the field `decoded` of SatNOGS, is read as that object. An object with a list per column is a table too,
and so are the forms that pandas writes.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from sunspin.base.errors import TelemetryError
from sunspin.base.series import (
    is_exported_metric,
    is_line_protocol,
    read_line_protocol,
    rows_of_series,
)
from sunspin.base.untrusted import decode_text, decode_western, plain_number, read_bytes

if TYPE_CHECKING:
    import xarray as xr

MAX_FILE_BYTES = 500_000_000
"""About a year of 1 Hz samples of six panels."""

MAX_COLUMNS = 10_000
"""More than any telemetry has; a file with one line of commas can exceed it."""

MAX_CELLS = 100_000_000
"""Limit for compressed files, which can hold any number of cells in few bytes and would exceed the memory."""

DELIMITERS = ",;\t"
"""Possible delimiters of columns; the one that occurs most often in the header is used, and a bar if none of them does."""

DECIMAL_COMMA = re.compile(r"(\s*[-+]?\d*),(\d+([eE][-+]?\d+)?\s*)", re.ASCII)
"""A number with a decimal comma, as written in files with semicolons or tabs between columns, and in quotes between commas."""

THOUSANDS = re.compile(
    r"\s*[-+]?[1-9]\d{0,2}([,. '\u2019\u00a0\u202f])\d{3}(\1\d{3})*([.,]\d+)?\s*", re.ASCII
)
"""A number with thousands separators; 1,234 may be one, or have a decimal comma."""

MAX_TITLE_LINES = 50
"""Number of lines in which the header is sought below the titles of a report."""

SEPARATOR = re.compile(r"sep=(,|;|\t|\\t|\|)", re.IGNORECASE)
"""A first line that names the delimiter for spreadsheet programs."""

WESTERN_NOTE = "the file is not UTF-8 text: read in the encoding of Western Windows (cp1252)"

ARCHIVES = {
    b"PK\x03\x04": "a spreadsheet or a ZIP archive",
    b"\xd0\xcf\x11\xe0": "a spreadsheet of an old version",
    b"\x1f\x8b": "a compressed file",
}
"""First bytes of files in which a table may be packed -> what they are."""

MAX_DEPTH = 8
"""Nesting of JSON objects; more than any telemetry has."""

RAW_FRAME = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\|[0-9A-Fa-f]+(\|[^|]*)*", re.ASCII)
"""A line of SatNOGS DB's export of raw frames, which has no header."""

FRAME_COLUMNS = ("timestamp", "frame", "observation_id", "observer")
"""Names for the columns of such a line, as in the JSON of the same database; older exports have only the first two."""


class TextTable(NamedTuple):
    """A table as text cells, indexed by the number of each row in the file and by the name of each column.

    `comments` are the texts after `#`; `where` names the file in messages; `data` is the Dataset of a NetCDF file. `counted` says
    what the number of a row counts: each "line" of a text, or each "row" of a file without lines or of a JSON list. `units` has the
    text below the name of each column, if there is a row of units. `notes` are sentences on how the file was read.
    """

    cells: pd.DataFrame
    comments: list[str]
    sha256: str
    where: str = ""
    data: xr.Dataset | None = None
    counted: str = "line"
    units: Mapping[str, str] = MappingProxyType({})
    notes: tuple[str, ...] = ()

    @property
    def header(self) -> list[str]:
        """Names of the columns."""
        return self.cells.columns.tolist()

    def has(self, names: Iterable[str]) -> bool:
        """Return whether the table has all of these columns."""
        return set(names) <= set(self.cells.columns)

    def numbers(self, names: Sequence[str]) -> np.ndarray:
        """Return columns as numbers (rows, columns), with NaN for cells that are not plain numbers.

        Single cells may be damaged. `TelemetryError` is raised for number formats that are not supported: a decimal comma,
        thousands separators (only the largest numbers of a column have them), or text with digits in every cell.
        """
        values = np.empty((len(self.cells), len(names)))
        for k, name in enumerate(names):
            cells = self.cells[name].tolist()
            values[:, k] = [plain_number(cell) for cell in cells]
            not_numbers = np.flatnonzero(np.isnan(values[:, k])).tolist()
            for i in not_numbers:
                has_comma = DECIMAL_COMMA.fullmatch(cells[i]) is not None
                has_thousands = THOUSANDS.fullmatch(cells[i]) is not None
                no_numbers = len(not_numbers) == len(cells)
                has_digits = any(map(str.isdigit, cells[i]))
                if has_comma or has_thousands or (no_numbers and has_digits):
                    what = "no cell of this column is a number"
                    if has_comma:
                        what = "the number has a decimal comma"
                        what += " or a thousands separator" * has_thousands
                    elif has_thousands:
                        what = "the number has a thousands separator"
                    do = "write plain decimals with a point, such as -1.5e-3"
                    raise TelemetryError(what, got=cells[i], do=do, where=self.place(i, name))
        return values

    def place(self, row: int, name: str) -> str:
        """Return the position of the cell in row `row` (counted from 0) and column `name`, in words for messages."""
        return f"{self.where}, {self.row_place(row)}, column {name!r}"

    def row_place(self, row: int) -> str:
        """Return the position of row `row` (counted from 0) in the file, in words for messages, such as "line 3"."""
        return f"{self.counted} {self.cells.index[row]}"


def read_table(path: Path) -> TextTable:
    """Read a table; its first bytes, not its name, decide the file type. Raises `TelemetryError`."""
    where = str(path)
    content = read_bytes(path, MAX_FILE_BYTES, "telemetry file", TelemetryError, "check the path")
    data, comments, counted, units, notes = None, [], "row", {}, ()
    if content.startswith(b"PAR1"):
        cells = _text_cells(_read_parquet(content, where))
    elif content.startswith(b"\x89HDF\r\n\x1a\n"):
        columns, data = _read_netcdf(path)
        cells = _text_cells(columns)
    elif content.startswith(b"CDF"):
        do = "convert it to NetCDF-4 (nccopy -k nc4)"
        raise TelemetryError("this is NetCDF of version 3", do=do, where=where)
    elif kind := next((ARCHIVES[head] for head in ARCHIVES if content.startswith(head)), None):
        what, do = f"this is {kind} and no text", "unpack it, or save its table as CSV in UTF-8"
        raise TelemetryError(what, do=do, where=where)
    else:
        try:
            text = decode_text(content, where, TelemetryError, "save it as CSV in UTF-8")
        except TelemetryError:
            if (western := decode_western(content)) is None:
                raise
            text, notes = western, (WESTERN_NOTE,)
        if "\0" in text or not text.strip():
            what = "the file holds binary data" if text.strip() else "the file is empty"
            do = "give a CSV in UTF-8 with a header and one row per sample"
            raise TelemetryError(what, do=do, where=where)
        if text.lstrip()[0] in "{[":
            cells, counted = _read_json(text, where)
        elif is_line_protocol(text):
            rows, numbers = read_line_protocol(text, where)
            _require_size(len(rows), len(rows[0]), where)
            cells, counted = pd.DataFrame(rows, numbers, dtype=object), "line"
        else:
            cells, comments = _read_csv(text, where)
            (cells, units), counted = _split_units(cells), "line"
    if cells.empty:
        raise TelemetryError("the file holds no samples", where=where)
    return TextTable(
        cells, comments, hashlib.sha256(content).hexdigest(), where, data, counted, units, notes
    )


def _read_csv(text: str, where: str) -> tuple[pd.DataFrame, list[str]]:
    """Return the cells of a CSV text and its comments.

    Rows are counted here before pandas parses them, as pandas fills up short rows without a message. As other programs write them,
    these are accepted: a first line `sep=;`, titles above the header, a delimiter after the last cell, a column without a name, and
    the header again before a further block of rows.
    """
    lines = text.splitlines()
    stated = SEPARATOR.fullmatch(lines[0].strip('" '))
    if stated:
        lines[0] = ""
    begin, lines = _find_header(_tabs_for_blanks(lines))
    # comments before the header and between rows are collected
    comment_lines = [*lines[:begin], *(line for line in lines[begin:] if line.startswith("#"))]
    comments = [comment for line in comment_lines if (comment := line.lstrip("# ").strip())]
    header = lines[begin] if begin < len(lines) else ""
    delimiter, added_header = _delimiter_of(header), {}
    if stated:
        delimiter = stated[1].replace("\\t", "\t")
    if RAW_FRAME.fullmatch(header.strip()):  # a row of frames and no header: add one as line 0
        delimiter = "|"
        added_header = {0: delimiter.join(FRAME_COLUMNS[: header.count(delimiter) + 1])}
    # a header has no numbers; without one, the first rows may be equal
    has_names = np.isnan([plain_number(cell) for cell in header.split(delimiter)]).all()
    # line number in the file -> line, without comments, lines of empty cells and repeated headers
    rows = added_header | {
        number: line
        for number, line in enumerate(lines[begin:], begin + 1)
        if line.strip(f' {delimiter}\t"')
        and line[0] != "#"
        and not (has_names and line == header and number > begin + 1)
    }
    # there may be a delimiter after the last cell of each row, and after the last name too or not
    closing = not added_header and header.rstrip(" ").endswith(delimiter)
    rows_close = closing or all(
        line.rstrip(" ").endswith(delimiter) for line in list(rows.values())[1:]
    )
    width = 0  # number of columns, that of the first row
    for number, line in rows.items():
        at = f"{where}, line {number}"
        n_cells = line.count(delimiter) + 1
        # quoted cells may contain the delimiter
        if '"' in line:
            try:
                n_cells = len(next(csv.reader([line], strict=True, delimiter=delimiter)))
            except csv.Error as error:
                what, do = f"this is not valid CSV ({error})", "close the quotes, or remove them"
                raise TelemetryError(what, do=do, where=at) from None
        width = width or n_cells - closing
        if rows_close and n_cells == width + 1 and line.rstrip(" ").endswith(delimiter):
            rows[number], n_cells = line.rstrip(" ").removesuffix(delimiter), width
        if n_cells != width:
            what = f"the row has {n_cells} values but the header names {width} columns"
            raise TelemetryError(what, do="complete or remove the row", where=at)
    _require_size(1, width, where)
    if len(rows) < 2:
        raise TelemetryError("the file has a header but no samples", where=where)
    cells = pd.read_csv(
        io.StringIO("\n".join(rows.values())),
        sep=delimiter,
        header=None,
        dtype=object,
        na_filter=False,
    )
    names = cells.iloc[0].str.strip()
    if has_names:  # such as the index of pandas
        names = pd.Series(
            [name or f"column {k}" for k, name in enumerate(names, 1)], names.index, dtype=object
        )
    for name in names[names.duplicated()]:
        what, do = "two columns share a name", "rename one"
        if re.fullmatch(
            r"[-+.\deE]*", name
        ):  # the header is missing, and two cells of the first row are equal
            what = "the first row holds numbers and no names of columns"
            do = "write a header above it"
        raise TelemetryError(what, got=name or "an empty cell", do=do, where=where)
    line_numbers = list(rows)[1:]
    cells = cells.iloc[1:].set_axis(line_numbers).set_axis(names.tolist(), axis=1)
    cells = cells.apply(_replace_decimal_commas, local=delimiter == ";")
    return cells, comments


def _delimiter_of(line: str) -> str:
    """Return the delimiter of a line of names; names may contain a bar, so that it counts only without any other."""
    delimiter = max(DELIMITERS, key=line.count)
    return "|" if delimiter not in line and "|" in line else delimiter


def _tabs_for_blanks(lines: list[str]) -> list[str]:
    """Return lines with tabs between their words if blanks separate the columns, as `numpy.savetxt` writes them, else unchanged.

    Then no row has another delimiter, and all have equally many words, three or more. A comment of as many words may be a header.
    """
    rows = [line for line in lines if line.strip() and line[0] != "#"]
    if any(mark in line for line in rows for mark in (*DELIMITERS, "|", '"')):
        return lines
    counts = {len(line.split()) for line in rows}
    if len(counts) != 1 or max(counts) < 3:
        return lines
    return [
        f"{'# ' * line.startswith('#')}{chr(9).join(words)}" if len(words) in counts else line
        for line in lines
        for words in [line.lstrip("# ").split()]
    ]


def _find_header(lines: list[str]) -> tuple[int, list[str]]:
    """Return the index of the line with the names of the columns, and the lines with that line as a plain one.

    It is the first line that is neither empty nor a comment, with two exceptions. Titles of a report, which fill at most two cells,
    may stand above a header of three columns or more. The header may be the last comment, as `numpy.savetxt` writes it.
    """
    texts = [k for k, line in enumerate(lines) if line.strip() and line[0] != "#"]
    if not texts:
        return len(lines), lines

    def split(line: str, like: str = "") -> list[str]:
        # numbers with decimal commas have more commas than delimiters: the line `like` of names decides
        return [cell.strip(' "') for cell in line.split(_delimiter_of(like or line))]

    def has_number(cells: list[str]) -> bool:
        return not np.isnan([plain_number(cell.replace(",", ".")) for cell in cells]).all()

    begin, first = texts[0], split(lines[texts[0]])
    above = lines[begin - 1] if begin else ""
    names = split(above.lstrip("# "))
    if above.startswith("#") and len(names) == len(first) > 1 and has_number(first):
        if all(names) and not has_number(names):
            return begin - 1, [*lines[: begin - 1], above.lstrip("# "), *lines[begin:]]
    if len([cell for cell in first if cell]) < 3 and not RAW_FRAME.fullmatch(lines[begin].strip()):
        for i, k in enumerate(texts[:MAX_TITLE_LINES]):
            names = split(lines[k])
            # a row of units may stand between the header and the first numbers
            below = [split(lines[j], lines[k]) for j in texts[i + 1 : i + 3]]
            if all(names) and len(names) > 2 and not has_number(names):
                if any(len(cells) == len(names) and has_number(cells) for cells in below):
                    return k, lines
    return begin, lines


def _split_units(cells: pd.DataFrame) -> tuple[pd.DataFrame, dict[str, str]]:
    """Return a table without the row of units below its header, and the unit of each column; no units if there is no such row.

    A row of units has neither numbers nor times; the row below it has a number.
    """
    if len(cells) < 2:
        return cells, {}
    first, second = ([cell.strip() for cell in cells.iloc[k]] for k in (0, 1))
    is_unit = [re.search(r"^[-+.]?\d|\d:\d\d", cell) is None for cell in first]
    if not any(first) or not all(is_unit) or np.isnan([plain_number(c) for c in second]).all():
        return cells, {}
    return cells.iloc[1:], dict(zip(cells.columns, first, strict=True))


def _replace_decimal_commas(column: pd.Series, local: bool) -> pd.Series:
    """Return a column with points in the place of decimal commas.

    It is returned as it is if the commas may separate thousands: each has three digits after it, and the column also has whole
    numbers. Programs with decimal commas separate columns by semicolons (`local`). In other files a column with a decimal point in
    some cell is returned as it is too, and so are commas with three digits after each.
    """
    commas = [cell for cell in column if DECIMAL_COMMA.fullmatch(cell)]
    whole = any(cell.strip().isdigit() and cell.strip("0 ") for cell in column)
    if not commas or ((whole or not local) and all(map(THOUSANDS.fullmatch, commas))):
        return column
    if not local and any("." in cell and np.isfinite(plain_number(cell)) for cell in column):
        return column
    return column.map(
        lambda cell: cell.replace(",", ".") if DECIMAL_COMMA.fullmatch(cell) else cell
    )


def _read_json(text: str, where: str) -> tuple[pd.DataFrame, str]:
    """Return the rows of a JSON text as a table of texts, and what its index counts; a cell is empty if its row lacks the key.

    The text is one object a line, a list of objects, or one object with a table in it (:func:`_rows_of_page`). Keys of nested
    objects become columns of their own, in the order of their first occurrence. The index is the "line" of each row, in a list or
    page the number of the "row" from one.
    """
    documents = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    first_line = documents[0][1].strip()
    # JSON lines if the first line is a complete object, else one document
    if not (first_line[0] == "{" and first_line[-1] == "}"):
        documents = [(1, text)]
    items = [(number, _parse_json(document, number, where)) for number, document in documents]
    if all(is_exported_metric(item) for _, item in items):
        # a series in each line: their labels are compared
        items = [(1, [item for _, item in items])]
    rows: list[dict[str, str]] = []
    numbers: list[int] = []
    counted = "line"
    for line_number, item in items:
        objects, first_number = [item], line_number
        page = series = rows_of_series(item)
        if series is None and isinstance(item, list):
            page = item
        elif series is None and isinstance(item, dict):
            # of several lines each is a row, with any lists in it
            page = item.get("results") if len(items) > 1 else _rows_of_page(item)
        if isinstance(page, list):
            objects, first_number, counted = page, len(rows) + 1, "row"
        for number, row in enumerate(objects, first_number):
            place = f"{where}, {counted} {number}"
            if not isinstance(row, dict):
                what = "a row of a JSON file must be an object"
                raise TelemetryError(what, got=str(row)[:60], where=place)
            rows.append(dict(_leaves(row, "", place, 0)))
            numbers.append(number)
    names = dict.fromkeys(name for row in rows for name in row)
    _require_size(len(rows), len(names), where)
    cells = [[row.get(name, "") for name in names] for row in rows]
    return pd.DataFrame(cells, numbers, list(names), dtype=object), counted


def _parse_json(document: str, line_number: int, where: str) -> Any:
    """Return the value of a JSON text that begins in line `line_number` of the file; raise `TelemetryError` if it is not valid."""
    try:
        return json.loads(document, object_pairs_hook=_object_without_repeats)
    # ValueError also for a repeated key and for a number of thousands of digits
    except (ValueError, RecursionError) as error:
        why = getattr(error, "msg", str(error))[:100]
        why = "it is nested too deeply" if isinstance(error, RecursionError) else why
        # a syntax error names its line within the document
        error_line = line_number + getattr(error, "lineno", 1) - 1
        what, do = f"this is not valid JSON ({why})", "write one object a line"
        raise TelemetryError(what, do=do, where=f"{where}, line {error_line}") from None


def _rows_of_page(page: dict[str, Any], depth: int = 0) -> list[Any] | None:
    """Return the rows of the table in a JSON object; None if it is a single row.

    The table is the longest list of objects, at any `depth` of other objects; or lists of equal length, one for each column; or an
    object for each column with the rows 0, 1, ..., as pandas writes it; or rows as lists with their names in `columns`.
    """
    if isinstance(page.get("results"), list):
        series = [one for item in page["results"] if _is_table(item) for one in item["series"]]
        # InfluxDB 1 has a list of series in each result, and this is the table if there is one
        return _rows_of_page(series[0]) if len(series) == 1 else page["results"]
    if not page:
        return None
    names = page.get("columns")
    lists = page.get("data", page.get("values"))
    if isinstance(names, list) and isinstance(lists, list) and all(map(_is_list, lists)):
        return [dict(zip(map(str, names), row, strict=False)) for row in lists]
    columns = list(page.values())
    length = len(columns[0]) if isinstance(columns[0], dict | list) else 0
    if depth == 0 and len(columns) > 1 and length > 1:
        keys = [str(k) for k in range(length)]
        if all(isinstance(column, dict) and list(column) == keys for column in columns):
            columns = [list(column.values()) for column in columns]
        if all(_is_list(column) and len(column) == length for column in columns):
            return [dict(zip(page, row, strict=True)) for row in zip(*columns, strict=True)]
    found = []
    for item in page.values():
        if isinstance(item, list) and len(item) > 1 and all(isinstance(row, dict) for row in item):
            found.append(item)
        elif isinstance(item, dict) and depth < MAX_DEPTH:
            found += [rows] if (rows := _rows_of_page(item, depth + 1)) else []
    found.sort(key=len)
    return found[-1] if found and len(found[-1]) > len((found[-2:-1] or [[]])[0]) else None


def _is_table(result: Any) -> bool:
    """Return whether a result of a query has series with columns and values."""
    series = result.get("series") if isinstance(result, dict) else None
    return isinstance(series, list) and all(
        isinstance(one, dict) and {"columns", "values"} <= set(one) for one in series
    )


def _is_list(item: Any) -> bool:
    """Return whether a JSON value is a list."""
    return isinstance(item, list)


def _require_size(rows: int, columns: int, where: str) -> None:
    """Raise `TelemetryError` if a table has too many columns or cells."""
    if columns > MAX_COLUMNS or rows * columns > MAX_CELLS:
        what = f"the file has more than {MAX_COLUMNS} columns or more than {MAX_CELLS:.0e} cells"
        got = f"{rows} rows of {columns}"
        raise TelemetryError(what, got=got, do="cut it into parts", where=where)


def _object_without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return a JSON object as a dict; raise ValueError if a key is repeated."""
    if len(dict(pairs)) < len(pairs):
        raise ValueError("a key stands twice in an object")
    return dict(pairs)


def _leaves(item: Any, name: str, where: str, depth: int) -> Iterator[tuple[str, str]]:
    """Yield the column names and texts of all values in a JSON object or list, at any depth.

    `item` is the object or a value in it, `name` the names of the objects around it, joined by points, and `depth` their number.
    Null gives an empty text, true and false give 1 and 0. `where` names the row in messages.
    """
    if depth > MAX_DEPTH:
        what = f"objects lie more than {MAX_DEPTH} deep in each other"
        raise TelemetryError(what, where=where)
    if isinstance(item, str) and item[:1] == "{" and item[-1:] == "}":
        try:
            item = json.loads(item, object_pairs_hook=_object_without_repeats)
        except (ValueError, RecursionError):
            pass  # a text in braces that is not JSON stays a text
    if isinstance(item, dict | list):
        for key, value in item.items() if isinstance(item, dict) else enumerate(item):
            full_name = f"{name}.{key}" if name else str(key).strip()
            yield from _leaves(value, full_name, where, depth + 1)
    else:
        yield name, "" if item is None else str(int(item) if isinstance(item, bool) else item)


def _read_parquet(content: bytes, where: str) -> dict[str, np.ndarray]:
    """Return the columns of a Parquet file."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq

        file = pq.ParquetFile(pa.BufferReader(content))
        _require_size(file.metadata.num_rows, file.metadata.num_columns, where)
        table = file.read()
        return {str(name): table[name].to_numpy() for name in table.column_names}
    except TelemetryError:
        raise
    except Exception as error:  # on damaged files the library raises errors of any type
        what = f"this Parquet file cannot be read ({str(error)[:200]})"
        do = 'save it as CSV, or install pyarrow with pip install "sunspin[parquet]"'
        raise TelemetryError(what, do=do, where=where) from None


def _read_netcdf(path: Path) -> tuple[dict[str, np.ndarray], xr.Dataset]:
    """Return the columns of a NetCDF file and its whole Dataset.

    A variable over the dimension of samples is a column. One with a second dimension, such as (time, panel), gives a column per
    label.
    """
    from sunspin.base.netcdf import read_netcdf

    data = read_netcdf(path, str(path), TelemetryError)
    # only a dimension with a coordinate, or the single one of a file, can be that of the samples
    candidates = [name for name in data.sizes if name in data.coords or len(data.sizes) == 1]
    longest = max(candidates, key=lambda name: data.sizes[name], default=None)
    sample_dimension = "time" if "time" in data.sizes else longest
    if sample_dimension is None:
        what = "the NetCDF file has no dimension of samples"
        raise TelemetryError(what, do="name it time", where=str(path))
    columns: dict[str, np.ndarray] = {}
    for name, variable in data.variables.items():
        dimensions = set(variable.dims)
        if variable.dims == (sample_dimension,):
            columns[str(name)] = variable.values
        # the second condition leaves out a dimension that occurs twice
        elif variable.ndim == 2 and len(dimensions) == 2 and sample_dimension in dimensions:
            (second,) = dimensions - {sample_dimension}
            labels = data[second].values if second in data.coords else range(data.sizes[second])
            values = variable.transpose(sample_dimension, second).values
            columns.update((str(label), values[:, k]) for k, label in enumerate(labels))
    return columns, data


def _text_cells(columns: Mapping[str, np.ndarray]) -> pd.DataFrame:
    """Return columns as text cells, with rows numbered from one."""
    cells = {}
    # complex numbers and objects become texts that are not plain numbers
    for name, column in columns.items():
        values = column.tolist()
        if np.issubdtype(column.dtype, np.datetime64):
            times = np.asarray(column, dtype="datetime64[us]")
            values = ["" if np.isnat(time) else f"{time}Z" for time in times]
        elif np.issubdtype(column.dtype, np.number) and column.dtype.kind != "c":
            values = column.astype(np.float64).tolist()
        cells[name] = [str(value) for value in values]
    return pd.DataFrame(cells, dtype=object).rename(index=lambda row: row + 1)
