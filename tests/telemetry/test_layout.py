"""Files as other programs export them: one row a value, one row a packet, spreadsheet habits, Unix times in any unit."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from datetime import datetime
from functools import partial
from importlib import resources
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import sunspin as ss
from sunspin.base.errors import TelemetryError
from sunspin.base.tables import read_table
from sunspin.vehicle.file import parse_vehicle

TEMPLATE = resources.files("sunspin").joinpath("template")
VEHICLE = parse_vehicle(TEMPLATE.joinpath("vehicle.toml").read_text("utf-8"), "template")
PANELS = list(VEHICLE.telemetry.columns.values())


def template_rows() -> pd.DataFrame:
    """Return the cells of the template's telemetry as texts: time and panels only."""
    with resources.as_file(TEMPLATE.joinpath("telemetry.csv")) as path:
        cells = pd.read_csv(path, comment="#", dtype=str)
    return cells[["time_utc", *PANELS]]


def read_as(path: Path, text: str | bytes, **telemetry):
    """Read a text, or bytes, as telemetry of the template's vehicle, with other values of its [telemetry]."""
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    form = replace(VEHICLE.telemetry, **telemetry)
    return ss.read_telemetry(path, replace(VEHICLE, telemetry=form))


@pytest.fixture
def read(tmp_path):
    return partial(read_as, tmp_path / "telemetry")


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    return read_as(
        tmp_path_factory.mktemp("plain") / "telemetry", template_rows().to_csv(index=False)
    )


@pytest.fixture
def reads_alike(read, expected):
    """Read a text, assert that its samples are those of the template, and return them."""

    def reads_alike(text, **telemetry):
        found = read(text, **telemetry)
        np.testing.assert_allclose(found["time"], expected["time"], atol=1e-6)
        np.testing.assert_array_equal(found["power_W"], expected["power_W"])
        assert found.attrs["epoch_utc"] == expected.attrs["epoch_utc"]
        return found

    return reads_alike


def by_metric(rows: pd.DataFrame) -> pd.DataFrame:
    return rows.melt("time_utc", var_name="Series", value_name="Value")


def databases(rows: pd.DataFrame) -> dict[str, str]:
    """Return rows as Prometheus, YAMCS and InfluxDB (line protocol) write them; the series have the names of the panels."""
    long = rows.melt("time_utc", var_name="name", value_name="value")
    long["unix_s"] = [int(datetime.fromisoformat(cell).timestamp()) for cell in long["time_utc"]]
    result = [
        {
            "metric": {"__name__": name, "job": "eps"},
            "values": part[["unix_s", "value"]].to_numpy().tolist(),
        }
        for name, part in long.groupby("name")
    ]
    matrix = {"resultType": "matrix", "result": result}
    parameters = [
        {
            "id": {"name": row["name"], "namespace": "/SAT"},
            "rawValue": {"type": "UINT32", "uint32Value": 7},
            "engValue": {"type": "FLOAT", "floatValue": float(row["value"])},
            "generationTime": row["time_utc"],
        }
        for row in long.to_dict("records")
    ]
    # one that was not acquired has no value
    parameters.insert(3, {key: parameters[0][key] for key in ("id", "generationTime")})
    lines = [
        f"eps,panel={row['name']},sat=my\\ sat value={row['value']} {row['unix_s']}000000000"
        for row in long.to_dict("records")
    ]
    targets = [
        {"target": name, "datapoints": part[["value", "unix_s"]].to_numpy().tolist()}
        for name, part in long.groupby("name")
    ]
    series = [
        {
            "name": "eps",
            "tags": {"panel": name},
            "columns": ["time", "value"],
            "values": part[["time_utc", "value"]].to_numpy().tolist(),
        }
        for name, part in long.groupby("name")
    ]
    groups = long.astype({"value": float}).groupby("name")
    groups = {name: part[["unix_s", "value"]].to_numpy().T.tolist() for name, part in groups}
    opentsdb = [
        {"metric": "", "tags": {"panel": name}, "dps": list(zip(*pair, strict=True))}
        for name, pair in groups.items()
    ]
    names = {"name": "metric", "unix_s": "timestamp"}
    long["tags"] = [{}] * len(long)
    time = {"name": "Time", "type": "time"}
    fields = {name: {"name": "Value", "labels": {"panel": name}} for name in groups}
    frames = [
        {"schema": {"fields": [time, fields[name]]}, "data": {"values": pair}}
        for name, pair in groups.items()
    ]
    wide = {"schema": {"fields": [time | {"name": "time"}, *({"name": name} for name in groups)]}}
    times = next(iter(groups.values()))[0]
    wide["data"] = {"values": [times, *(values for _, values in groups.values())]}
    return {
        "opentsdb arrays": json.dumps(opentsdb),
        "opentsdb": json.dumps([one | {"dps": dict(one["dps"])} for one in opentsdb]),
        "opentsdb values": json.dumps(long.rename(columns=names).to_dict("records")),
        "grafana frames": json.dumps({"results": {"A": {"frames": frames}}}),
        "grafana frame": json.dumps([wide]),
        "graphite": json.dumps(targets),
        "influx 1": json.dumps({"results": [{"statement_id": 0, "series": series}]}),
        "prometheus": json.dumps({"status": "success", "data": matrix}, indent=1),
        "yamcs lines": "\n".join(map(json.dumps, parameters)),
        "yamcs page": json.dumps({"parameter": parameters}),
        "line protocol": "\n".join(["# DML", *lines]),
        "victoria lines": "\n".join(
            json.dumps(
                {
                    "metric": {"__name__": name, "job": "eps"},
                    "values": values,
                    "timestamps": [round(1000 * time) for time in times],
                }
            )
            for name, (times, values) in groups.items()
        ),
    }


FORMS = ["prometheus", "yamcs lines", "yamcs page", "line protocol", "graphite", "influx 1"]
FORMS += ["opentsdb", "opentsdb arrays", "opentsdb values", "grafana frames", "grafana frame"]
FORMS += ["victoria lines"]


@pytest.mark.parametrize("form", FORMS)
def test_answers_of_databases_of_time_series_are_rows_of_one_value(form, reads_alike):
    text = databases(template_rows())[form]
    time_format = "utc" if "yamcs" in form or form == "influx 1" else "unix"
    reads_alike(text, time_column="time", time_format=time_format)


def test_series_of_several_metrics_and_labels_have_the_names_that_tell_them_apart(tmp_path):
    lines = [
        f'eps,panel={panel},sat=A current={k}i,on=true,text="a, b=c d" 1767225600000000000'
        for k, panel in enumerate(("xp", "xm"))
    ]
    path = tmp_path / "export.lp"
    path.write_text("\n".join(lines))
    cells = read_table(path).cells
    assert cells["series"].tolist()[:3] == ["xp.current", "xp.on", "xp.text"]
    assert cells["value"].tolist()[3:] == ["1", "1", "a, b=c d"]
    path.write_text("\n".join([*lines, "eps,panel=xp current=3"]))
    with pytest.raises(TelemetryError, match="line 3: this is no line of InfluxDB line protocol"):
        read_table(path)


@pytest.mark.parametrize(
    "change", [None, 3, [], [5], [{"metric": 2}], [{"metric": {}, "values": 7}]]
)
def test_an_odd_answer_of_a_database_is_no_traceback(change, read):
    results = [{"series": [change, {"columns": ["time", "a"], "values": change}]}]
    frame = {"schema": {"fields": [{"name": "a", "labels": change}]}, "data": {"values": [change]}}
    for document in (
        {"data": {"resultType": "matrix", "result": change}, "parameter": change},
        {"results": results},
        [{"target": 3, "datapoints": change}, change],
        [{"metric": 3, "tags": {}, "dps": change}],
        [{"schema": {"fields": change}, "data": {"values": change}}],
        {"results": {"A": {"frames": [frame]}}},
    ):
        with pytest.raises(TelemetryError):
            read(json.dumps(document))


def test_decimal_commas_in_quotes_are_read_in_a_file_with_commas(read, reads_alike):
    rows = template_rows()
    quoted = rows[PANELS].map(lambda cell: f'"{cell.replace(".", ",")}"')
    cells = zip(rows["time_utc"], *quoted.values.T, strict=True)
    text = "\n".join([",".join(rows), *map(",".join, cells)])
    reads_alike(text)
    # these may be thousands
    with pytest.raises(TelemetryError, match="decimal comma or a thousands separator"):
        read(re.sub('"[^"]*"', '"1,234"', text))


INFLUX = """#group,false,false,true,true,false,false,true,true
#datatype,string,long,dateTime:RFC3339,dateTime:RFC3339,dateTime:RFC3339,double,string,string
#default,_result,,,,,,,
,result,table,_start,_stop,_time,_value,_field,_measurement
"""


def influx(rows: pd.DataFrame) -> str:
    """Return annotated CSV as InfluxDB writes it: a block with its header for each series."""
    blocks = []
    for table, (name, part) in enumerate(by_metric(rows).groupby("Series", sort=False)):
        ends = "2026-01-01T00:00:00Z,2026-01-02T00:00:00Z"
        lines = [
            f",,{table},{ends},{time},{value},{name},eps"
            for time, value in zip(part["time_utc"], part["Value"], strict=True)
        ]
        blocks.append(INFLUX + "\n".join(lines))
    return "\n\n".join(blocks) + "\n"


def lines_of_metrics(rows: pd.DataFrame) -> str:
    return "\n".join(
        json.dumps({"name": name, "time": time, "value": float(value)})
        for time, name, value in by_metric(rows).itertuples(index=False)
    )


EXPORTS = {
    "Grafana": (lambda rows: by_metric(rows).to_csv(sep=";", index=False), "time_utc"),
    "InfluxDB": (influx, "_time"),
    "JSON lines": (lines_of_metrics, "time"),
    "any order": (lambda rows: by_metric(rows).sample(frac=1, random_state=1).to_csv(), "time_utc"),
    "fractions": (lambda rows: by_metric(rows).assign(ms="0").to_csv(index=False), "time_utc"),
}


@pytest.mark.parametrize("export", EXPORTS)
def test_a_row_for_each_value_reads_as_a_row_for_each_sample(export, reads_alike):
    write, time_column = EXPORTS[export]
    fraction = {"fraction_column": "ms"} if export == "fractions" else {}
    found = reads_alike(write(template_rows()), time_column=time_column, **fraction)
    assert "rows of one value each, named in column" in found.attrs["clock_notes"]


@pytest.mark.parametrize(
    "cell", ['{{panel="{0}",job="eps"}}', "panel={0},host=o", '{{"a": "{0}"}}']
)
def test_labels_in_a_column_tell_series_of_one_metric_apart(cell, reads_alike):
    rows = by_metric(template_rows())
    rows = rows.assign(labels=rows["Series"].map(cell.format), Series="i")
    columns = {face: f"{name}.i" for face, name in VEHICLE.telemetry.columns.items()}
    reads_alike(rows.rename(columns={"Series": "metric"}).to_csv(index=False), columns=columns)


def test_labels_of_json_lines_tell_series_of_one_metric_apart(reads_alike):
    rows = by_metric(template_rows()).rename(columns={"Value": "value"})
    lines = [
        json.dumps(row | {"metric": "i", "labels": {"job": "eps", "face": row.pop("Series")}})
        for row in rows.to_dict("records")
    ]
    columns = {face: f"{name}.i" for face, name in VEHICLE.telemetry.columns.items()}
    reads_alike("\n".join(lines), columns=columns)


def test_two_sources_of_one_value_are_refused_with_the_column_that_tells_them_apart(read):
    rows = by_metric(template_rows())
    both = pd.concat([rows.assign(host="a"), rows.assign(host="b", Value="9.9")])
    said = "two values of 'px' for one time .* keep the rows of one source .column 'host' has 'a'"
    with pytest.raises(TelemetryError, match=said):
        read(both.to_csv(index=False))
    # the same values twice are no contradiction
    twice = pd.concat([rows.assign(host="a"), rows.assign(host="b")])
    assert read(twice.to_csv(index=False)).sizes["time"] == len(template_rows())


def test_names_that_the_vehicle_file_does_not_know_are_listed(read):
    rows = by_metric(template_rows()).replace({"Series": {"px": "eps.ipx"}})
    rows["Series"] = "raw." + rows["Series"]
    with pytest.raises(TelemetryError, match="column 'px' .*found columns time_utc, raw.eps"):
        read(rows.to_csv(index=False))


def packets(rows: pd.DataFrame, delay_s: float = 0.4) -> pd.DataFrame:
    """Return three packets for each sample, each with some of the panels and its own time."""
    parts = []
    for k, names in enumerate((PANELS[:2], PANELS[2:4], PANELS[4:])):
        part = rows.copy()
        part[[name for name in PANELS if name not in names]] = ""
        time = pd.to_datetime(rows["time_utc"]) + pd.Timedelta(seconds=k * delay_s)
        part["time_utc"] = time.dt.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
        parts.append(part)
    return pd.concat(parts).sort_values("time_utc")


def test_packets_within_a_stated_span_are_one_sample(read, reads_alike, expected):
    text = packets(template_rows()).to_csv(index=False)
    found = reads_alike(text, sample_span_s=2.0)
    notes = found.attrs["clock_notes"].splitlines()
    n = len(template_rows())
    assert notes[0] == f"{3 * n} rows are {n} samples, each of rows within 2 s"
    assert notes[1].startswith("columns read later than the sample's time: ")
    assert f"{PANELS[3]} by 0.4 s" in notes[1] and f"{PANELS[4]} by 0.8 s" in notes[1]
    assert "offset_s of a panel" in notes[1] and "-sensors_late_s" in notes[1]
    # a reading that a sample already has begins the next sample
    reads_alike(text, sample_span_s=1000.0)
    # a span changes nothing where each row is a sample
    plain = read(template_rows().to_csv(index=False), sample_span_s=2.0)
    assert plain.drop_attrs().identical(expected.drop_attrs())
    assert plain.attrs.get("clock_notes") == expected.attrs.get("clock_notes")


def with_units_and_blanks(rows: pd.DataFrame) -> str:
    """Return a table below titles, with a row of units, decimal commas and fractions of seconds."""
    units = pd.DataFrame([["[UTC]", *["[W]"] * len(PANELS)]], columns=rows.columns)
    text = pd.concat([units, rows]).to_csv(index=False, sep=";", decimal=",").replace(".", ",")
    return "Mission;Demo\nExport;1,2\n\n" + text.replace("Z;", ",000Z;")


HABITS = {
    "sep=;": lambda rows: "sep=;\n" + rows.to_csv(sep=";", index=False),
    "sep=,": lambda rows: '"sep=,"\r\n' + rows.to_csv(index=False, lineterminator="\r\n"),
    "closing comma": lambda rows: rows.to_csv(index=False).replace("\n", ",\n"),
    "closing semicolon": lambda rows: rows.to_csv(sep=";", index=False).replace("\n", ";\n"),
    "closing header": lambda rows: rows.to_csv(index=False).replace("\n", ",\n", 1),
    "closing rows": lambda rows: (
        rows.to_csv(index=False).replace("\n", ",\n").replace(",\n", "\n", 1)
    ),
    "bars": lambda rows: rows.to_csv(sep="|", index=False),
    "UTF-16": lambda rows: rows.to_csv(sep="\t", index=False).encode("utf-16"),
    "decimal commas": lambda rows: rows.to_csv(sep="\t", index=False).replace(".", ","),
    "titles": lambda rows: (
        "Report of one orbit;;\n\nOperator;Max\n" + rows.to_csv(sep=";", index=False)
    ),
    "savetxt": lambda rows: "# made with numpy\n# " + rows.to_csv(index=False),
    "units": lambda rows: rows.to_csv(index=False).replace("\n", "\nUTC,W,W,W,W,W\n", 1),
    "blanks": lambda rows: rows.to_csv(sep=" ", index=False).replace(" ", "   "),
    "savetxt with blanks": lambda rows: "# made with numpy\n# " + rows.to_csv(sep=" ", index=False),
    "titles, units, decimal commas": with_units_and_blanks,
    "an index": lambda rows: rows.to_csv(),
}


@pytest.mark.parametrize("habit", HABITS)
def test_habits_of_spreadsheets_are_read(habit, reads_alike):
    reads_alike(HABITS[habit](template_rows()))


def test_the_index_of_pandas_without_a_name_is_a_column_that_can_be_named(reads_alike):
    text = template_rows().set_index("time_utc").rename_axis(index=None).to_csv()
    reads_alike(text, time_column="column 1")


@pytest.mark.parametrize("form", ["columns", "split", "list", "records", "hits", "influx 1"])
def test_a_JSON_document_with_a_table_in_it_reads_as_that_table(form, reads_alike):
    """In one document a table was read as a single sample of its first row."""
    rows = template_rows()
    records = rows.to_dict("records")
    series = {"name": "eps", "columns": list(rows), "values": rows.to_numpy().tolist()}
    documents = {
        "list": rows.to_dict("list"),
        "records": {"units": [{"px": "W"}, {"mx": "W"}], "data": records},
        "hits": {"took": 3, "hits": {"total": {"value": 2}, "hits": records}},
        "influx 1": {"results": [{"statement_id": 0, "series": [series]}]},
    }
    reads_alike(json.dumps(documents[form]) if form in documents else rows.to_json(orient=form))


def test_a_row_that_is_too_long_is_refused_after_a_closing_delimiter_too(read):
    lines = template_rows().to_csv(index=False).splitlines()
    text = "\n".join([lines[0] + ",", lines[1] + ",", lines[2] + ",7"])
    said = "line 3: the row has 7 values but the header names 6 columns"
    with pytest.raises(TelemetryError, match=said):
        read(text)


@pytest.mark.parametrize(
    ("unit", "per_second"), [("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9)]
)
def test_Unix_times_in_smaller_units_are_known_by_their_size(unit, per_second, reads_alike):
    rows = template_rows()
    seconds = (pd.to_datetime(rows["time_utc"]) - pd.Timestamp(0, tz="UTC")).dt.total_seconds()
    rows["time_utc"] = [f"{round(second * per_second)}" for second in seconds]
    text = rows.to_csv(index=False)
    found = reads_alike(text, time_format="unix")
    assert f"times taken as Unix {unit} by their size" in found.attrs["clock_notes"]
    # a stated unit is not changed
    stated = reads_alike(text, time_format="unix", time_scale_s=1 / per_second)
    assert "clock_notes" not in stated.attrs


def test_rows_of_several_sources_cut_times_and_the_other_sign_are_named(read):
    def notes(rows):
        return read(rows.to_csv(index=False), bad_rows="flag").attrs.get("clock_notes", "")

    rows = template_rows()
    second = rows.assign(**{PANELS[0]: "0.123"})
    mixed = notes(pd.concat([rows.assign(sat="A"), second.assign(sat="B")]))
    assert "40 of 80 rows have the time of the row before" in mixed and "'sat' differs" in mixed
    assert "column 'sat' has 2 values (A, B): keep the rows of one satellite" in mixed
    cut = notes(rows.assign(time_utc=rows["time_utc"].str[:16] + "Z"))
    assert "its times are cut" in cut and "keep the rows" not in cut
    assert not notes(rows.assign(sat="A", sat_mode=["SAFE", "SUN"] * 20))
    rows[PANELS] = "-" + rows[PANELS]
    assert "all panel readings are negative" in notes(rows)


@pytest.mark.parametrize(
    ("head", "what"),
    [(b"PK\x03\x04", "a spreadsheet or a ZIP"), (b"\x1f\x8b", "a compressed file")],
)
def test_packed_files_are_refused_by_their_name(head, what, read):
    with pytest.raises(TelemetryError, match=f"this is {what}.*; unpack it, or save"):
        read(head + bytes(range(200)))
