"""Exports of databases of time series: one row for each value, with the columns time, series and value.

Prometheus, YAMCS, Graphite, OpenTSDB, Grafana and InfluxDB 1 answer in JSON, InfluxDB exports line protocol.
"""

from __future__ import annotations

import re
from typing import Any

from sunspin.base.errors import TelemetryError

ITEM = r"(?:\\.|[^\s,=\\])+"
"""A name or the value of a tag in line protocol: blanks, commas and equals signs in it stand after a backslash."""

VALUE = r'(?:"(?:\\.|[^"\\])*"|[^\s,"]+)'
FIELD = rf"{ITEM}={VALUE}"

LINE_PROTOCOL = re.compile(
    rf"(?P<measurement>(?:\\.|[^\s,\\#])(?:\\.|[^\s,\\])*)(?P<tags>(?:,{ITEM}={ITEM})*)"
    rf" +(?P<fields>{FIELD}(?:,{FIELD})*)(?: +(?P<time>-?\d+))?"
)
"""A line of InfluxDB line protocol, such as `eps,panel=xp current=0.41,mode=2i 1700000000000000000`."""

TRUTH = {"t": "1", "true": "1", "f": "0", "false": "0"}
"""Truth values in line protocol, in small letters."""

EXPORT_HEAD = re.compile(r"\s*(#.*|CREATE DATABASE .*)?", re.IGNORECASE)
"""Lines without values, as `influx_inspect export` writes them above the others."""

UNNAMED = ("value", "_value")
"""Names of fields that say nothing on what the value is."""


def rows_of_series(document: Any) -> list[dict[str, Any]] | None:
    """Return the rows of a JSON answer of a database of time series, or of Grafana; None for any other document.

    Prometheus: `{"data": {"resultType": "matrix", "result": [{"metric": {...}, "values": [[t, "v"], ...]}]}}`. YAMCS: objects with
    `id`, `engValue` (else `rawValue`) and `generationTime`, one or a list, alone or under `parameter`. Graphite: objects with
    `target` and `datapoints`, which are pairs of value and time. InfluxDB 1: several series with `columns`, `values`, `tags`.
    OpenTSDB: objects with `metric`, `tags`, and `dps` or `timestamp` and `value`. Grafana: data frames with `schema` and `data`,
    in a list or under `results`. VictoriaMetrics: a list of the lines of its export (:func:`is_exported_metric`).
    """
    if isinstance(document, list) and document and all(map(is_exported_metric, document)):
        pairs = [zip(item["timestamps"], item["values"], strict=True) for item in document]
        return _rows_of_prometheus(
            [
                {"metric": item["metric"], "values": list(map(list, pair))}
                for item, pair in zip(document, pairs, strict=True)
            ]
        )
    data = document.get("data") if isinstance(document, dict) else None
    if isinstance(data, dict) and data.get("resultType") in ("matrix", "vector"):
        return _rows_of_prometheus(data.get("result"))
    if isinstance(document, dict) and isinstance(document.get("results"), list):
        return _rows_of_influx(document["results"])
    if frames := _frames_of(document):
        return _rows_of_frames(frames)
    if isinstance(document, list) and document and all(map(_is_metric, document)):
        return _rows_of_opentsdb(document)
    if isinstance(document, list) and document and all(map(_is_target, document)):
        return [
            {"time": time, "series": item["target"], "value": value}
            for item in document
            for value, time in item["datapoints"]
        ]
    items = document.get("parameter") if isinstance(document, dict) else document
    items = items if isinstance(items, list) else [document]
    # a parameter that was not acquired has no value
    acquired = [item for item in items if not _is_parameter(item, with_value=False)]
    if not items or not all(map(_is_parameter, acquired)):
        return None
    rows = []
    for item in acquired:
        value = item.get("engValue") or item["rawValue"]
        # such as {"type": "FLOAT", "floatValue": 1.5}
        numbers = [value[key] for key in value if key.endswith("Value")]
        time = item.get("generationTimeUTC") or item.get("generationTime")
        name = item["id"]["name"]
        rows.append({"time": time, "series": name, "value": numbers[0] if numbers else None})
    return rows


def is_exported_metric(item: Any) -> bool:
    """Return whether a JSON value is a line of the export of VictoriaMetrics, with lists of values and of times of one series."""
    if not isinstance(item, dict) or not isinstance(item.get("metric"), dict):
        return False
    values, times = item.get("values"), item.get("timestamps")
    return isinstance(values, list) and isinstance(times, list) and len(values) == len(times)


def _is_parameter(item: Any, with_value: bool = True) -> bool:
    """Return whether a JSON value is a parameter as YAMCS writes it, with a value or without."""
    if not isinstance(item, dict) or not isinstance(item.get("id"), dict):
        return False
    is_dated = "generationTimeUTC" in item or "generationTime" in item
    value = item.get("engValue") or item.get("rawValue")
    return is_dated and "name" in item["id"] and (isinstance(value, dict) is with_value)


def _is_target(item: Any) -> bool:
    """Return whether a JSON value is a series of Graphite."""
    points = item.get("datapoints") if isinstance(item, dict) and "target" in item else None
    return isinstance(points, list) and all(isinstance(x, list) and len(x) == 2 for x in points)


def _rows_of_influx(results: list[Any]) -> list[dict[str, Any]] | None:
    """Return the rows of several series of InfluxDB 1, as `GROUP BY` of a tag gives; None if there are not several."""
    lists = [item.get("series") for item in results if isinstance(item, dict)]
    series = [one for each in lists if isinstance(each, list) for one in each]
    if len(series) < 2:
        return None
    labels: list[dict[str, str]] = []
    values: list[tuple[Any, Any]] = []
    for one in series:
        columns, rows = (
            (one.get("columns"), one.get("values")) if isinstance(one, dict) else ([], [])
        )
        if not (isinstance(columns, list) and isinstance(rows, list) and columns[:1] == ["time"]):
            return None
        tags = one.get("tags")
        tags = tags if isinstance(tags, dict) else {}
        label = {key: str(text) for key, text in {"measurement": one.get("name"), **tags}.items()}
        for row in rows:
            if not isinstance(row, list) or len(row) != len(columns):
                return None
            labels += [label | {"field": str(name)} for name in columns[1:]]
            values += [(row[0], value) for value in row[1:]]
    names = name_series(labels, "field")
    pairs = zip(names, values, strict=True)
    return [{"time": time, "series": name, "value": value} for name, (time, value) in pairs]


def _rows_of_prometheus(result: Any) -> list[dict[str, Any]] | None:
    """Return the rows of the list `result` of an answer of Prometheus; None if it is none."""
    pairs: list[list[Any]] = []
    labels: list[dict[str, str]] = []
    for item in result if isinstance(result, list) else []:
        metric = item.get("metric") if isinstance(item, dict) else None
        if not isinstance(metric, dict):
            return None
        values = item.get("values", [item.get("value")])
        is_list = isinstance(values, list)
        if not is_list or not all(isinstance(pair, list) and len(pair) == 2 for pair in values):
            return None
        labels.append({"__name__": "", **{key: str(value) for key, value in metric.items()}})
        pairs.append(values)
    names = name_series(labels, "__name__")
    rows = [
        {"time": time, "series": name, "value": value}
        for name, values in zip(names, pairs, strict=True)
        for time, value in values
    ]
    return rows or None


def _is_metric(item: Any) -> bool:
    """Return whether a JSON value is a series or a value as OpenTSDB writes it."""
    if not isinstance(item, dict) or not isinstance(item.get("tags"), dict) or "metric" not in item:
        return False
    points = item.get("dps")
    if isinstance(points, list):
        return all(isinstance(pair, list) and len(pair) == 2 for pair in points)
    return isinstance(points, dict) or {"timestamp", "value"} <= set(item)


def _rows_of_opentsdb(items: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows of series of OpenTSDB, or of single values."""
    labels = [
        {**{key: str(text) for key, text in item["tags"].items()}, "metric": str(item["metric"])}
        for item in items
    ]
    rows = []
    for name, item in zip(name_series(labels, "metric"), items, strict=True):
        points = item.get("dps", [[item.get("timestamp"), item.get("value")]])
        pairs = points.items() if isinstance(points, dict) else points
        rows += [{"time": time, "series": name, "value": value} for time, value in pairs]
    return rows


def _frames_of(document: Any) -> list[dict[str, Any]]:
    """Return the data frames in a JSON answer of Grafana, which have equally long columns; empty for any other document."""
    frames = document if isinstance(document, list) else [document]
    results = document.get("results") if isinstance(document, dict) else None
    if isinstance(results, dict):
        lists = [one.get("frames") for one in results.values() if isinstance(one, dict)]
        frames = [frame for each in lists if isinstance(each, list) for frame in each]
    for frame in frames:
        try:
            fields, columns = frame["schema"]["fields"], frame["data"]["values"]
            lengths = {len(column) if isinstance(column, list) else -1 for column in columns}
            is_frame = len(fields) == len(columns) and len(lengths) == 1 and -1 not in lengths
            labels = [
                field.get("labels") or {} for field in fields if isinstance(field["name"], str)
            ]
            if not is_frame or [isinstance(each, dict) for each in labels] != [True] * len(fields):
                return []
        except (AttributeError, KeyError, TypeError):
            return []
    return frames


def _rows_of_frames(frames: list[dict[str, Any]]) -> list[dict[str, Any]] | None:
    """Return the rows of data frames of Grafana; those of a single frame without labels have its columns.

    None if one of several frames has no column of times.
    """
    labels: list[dict[str, str]] = []
    series: list[tuple[list[Any], list[Any]]] = []
    for frame in frames:
        fields, columns = frame["schema"]["fields"], frame["data"]["values"]
        names = [field["name"] for field in fields]
        if len(frames) == 1 and not any(field.get("labels") for field in fields):
            return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]
        times = [k for k, field in enumerate(fields) if field.get("type") == "time"]
        if not times:
            return None
        for k, field in enumerate(fields):
            if k != times[0]:
                tags = {key: str(text) for key, text in (field.get("labels") or {}).items()}
                # a field of Prometheus is named Value
                name = tags.pop("__name__", names[k]) if names[k].lower() in UNNAMED else names[k]
                labels.append({**tags, "field": name})
                series.append((columns[times[0]], columns[k]))
    return [
        {"time": time, "series": name, "value": value}
        for name, pair in zip(name_series(labels, "field"), series, strict=True)
        for time, value in zip(*pair, strict=True)
    ]


def name_series(labels: list[dict[str, str]], last: str) -> list[str]:
    """Return the name of each series (n): its labels that are not the same in all of them, and the label `last`, joined by points.

    The label `last` is left out if it is empty, or says nothing (`UNNAMED`) and there are others.
    """
    keys = list(dict.fromkeys(key for label in labels for key in label if key != last))
    differ = [key for key in keys if len({label.get(key) for label in labels}) > 1]
    names = []
    for label in labels:
        parts = [label[key] for key in differ if label.get(key)]
        if label[last] and not (parts and label[last].lower() in UNNAMED):
            parts.append(label[last])
        names.append(".".join(parts) or "value")
    return names


def is_line_protocol(text: str) -> bool:
    """Return whether the first line of a text that is no comment is one of InfluxDB line protocol, with a time."""
    lines = (line for line in text.splitlines() if not EXPORT_HEAD.fullmatch(line))
    match = LINE_PROTOCOL.fullmatch(next(lines, "").strip())
    return match is not None and len(match["time"] or "") > 8


def read_line_protocol(text: str, where: str) -> tuple[list[dict[str, str]], list[int]]:
    """Return the rows of a text in line protocol, one for each field, and the number of the line of each.

    Raises
    ------
    TelemetryError
        A line is none of line protocol, or has no time.
    """
    labels: list[dict[str, str]] = []
    values: list[tuple[str, str]] = []
    numbers: list[int] = []
    for number, line in enumerate(text.splitlines(), 1):
        if EXPORT_HEAD.fullmatch(line):
            continue
        match = LINE_PROTOCOL.fullmatch(line.strip())
        if match is None or match["time"] is None:
            what = "this is no line of InfluxDB line protocol with a time, as those above"
            do = "correct or remove it"
            raise TelemetryError(what, got=line[:60], do=do, where=f"{where}, line {number}")
        tags = re.findall(rf",({ITEM})=({ITEM})", match["tags"])
        for name, value in re.findall(rf"({ITEM})=({VALUE})", match["fields"]):
            label = {"measurement": match["measurement"], **dict(tags), "field": name}
            labels.append({key: re.sub(r"\\(.)", r"\1", text) for key, text in label.items()})
            value = TRUTH.get(value.lower(), value)
            value = re.sub(r"(?<=\d)[iu]$", "", value).strip('"')
            values.append((match["time"], value))
            numbers.append(number)
    names = name_series(labels, "field")
    rows = [
        {"time": time, "series": name, "value": value}
        for name, (time, value) in zip(names, values, strict=True)
    ]
    return rows, numbers
