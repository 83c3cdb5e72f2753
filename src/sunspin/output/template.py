"""The files that a user starts from: an example, or a vehicle file for a telemetry file."""

from __future__ import annotations

import os
import re
from importlib import resources
from pathlib import Path

import numpy as np

from sunspin.base.atomic_write import make_folder
from sunspin.base.errors import OutputError, TelemetryError, printable
from sunspin.base.tables import read_table
from sunspin.telemetry.reader import columns_of_readings
from sunspin.telemetry.suggest import (
    AxisColumns,
    Suggestion,
    explain_missing,
    suggest_section,
    toml_string,
)
from sunspin.vehicle import Vehicle

FACES = {
    f"{sign}{axis}": tuple(value if k == n else 0 for k in range(3))
    for sign, value in (("+", 1), ("-", -1))
    for n, axis in enumerate("XYZ")
}
"""Faces of a box and their outward normals."""

SHOWN = 12
"""Columns that are listed by name if none can be read."""

DARK_SHARE = 0.05
"""Share of the largest reading of all panels below which a panel is taken as failed or never sunlit."""

ON_FACE = 0.9
"""Least cosine between a panel's normal and that of the face on which it is taken to be."""


def write_templates(folder: Path) -> list[Path]:
    """Write an example vehicle.toml and telemetry.csv into a folder and return their paths; write both or none.

    Raises
    ------
    OutputError
        One of the files exists, or the folder cannot be written.
    """
    names = ("vehicle.toml", "telemetry.csv")
    return _write(folder, {name: _template(name) for name in names})


def write_vehicle_for(folder: Path, telemetry: Path) -> tuple[Path, list[str], list[str]]:
    """Write a vehicle.toml that reads a telemetry file into a folder; return its path, the sensors in its comments, and notes.

    The notes are sentences on times that may be misread and on columns of panels that are not read.

    It has a panel of unknown gain for each face that a column names, and neither inertia nor wheels. The columns of a gyro and of a
    magnetometer stand in comments, as their axes are not known.

    Raises
    ------
    TelemetryError
        The file cannot be read, or no two columns name faces.
    OutputError
        The file exists, or the folder cannot be written.
    """
    table = read_table(telemetry)
    suggestion = suggest_section(table)
    if suggestion is None:
        what, do = explain_missing(table)
        shown = ", ".join(table.header[:SHOWN]) + (", ..." if len(table.header) > SHOWN else "")
        raise TelemetryError(what, got=shown, do=do, where=str(telemetry))
    text = _template("vehicle.toml")
    panels = "".join(
        f'[[panel]]\nname = "{face}"\nnormal_B = {list(FACES[face])}\n'
        f"relative_gain = 1.0                   # REPLACE by cells, gain_W or gain_A{_seen(suggestion, face)}\n"
        for face in sorted(suggestion.columns, key=lambda face: face[::-1])
    )
    text = _replace(text, '[[panel]]\nname = "+X"', "\n# Panels that share an input", panels)
    # the example's own keys of [telemetry] end where its columns end
    section, columns = suggestion.section.split("[telemetry.columns]\n")
    begin, end = text.index("[telemetry]\n"), text.index("# [telemetry.offset_s]")
    keys, is_kept = [], False
    for example in text[begin:end].splitlines():
        line = f"# {example}" if example.startswith("noise =") else example
        # lines that begin with blanks continue the remark of the line before
        is_kept = line.startswith("#") and (is_kept or re.match(r"#\s{10}", line) is None)
        if is_kept:
            keys.append(line)
    text = (
        text[:begin] + section + "\n".join(keys) + "\n[telemetry.columns]\n" + columns + text[end:]
    )
    # made-up values of the example would act as if they were known
    text = _comment_out(text, "[[wheel]]", "# [wheel.alternative_frictions")
    for key in ("mass_kg", "inertia_kg_m2", "max_rate_rad_s"):
        text = re.sub(rf"^{key} =", f"# {key} =", text, count=1, flags=re.MULTILINE)
    for sensor, triple in suggestion.sensors.items():
        text = _fill_sensor(text, sensor, triple)
    # satellites of one operator need names of their own: `sunspin history` refuses to mix two names
    head = {
        "name": telemetry.stem,
        "description": f"Made by sunspin init from {telemetry.name}; to be completed.",
    }
    for key, value in head.items():
        line = f"{key} = {toml_string(printable(value))}"
        text = re.sub(
            rf"^{key} = .*$", lambda _, line=line: line, text, count=1, flags=re.MULTILINE
        )
    (path,) = _write(folder, {"vehicle.toml": text})
    return path, list(suggestion.sensors), suggestion.notes


def _seen(suggestion: Suggestion, face: str) -> str:
    """Return the largest reading of a face in words, as a remark on its gain; empty for angles."""
    largest = suggestion.largest[face]
    if np.isnan(largest):
        return ""
    share = largest / max(*suggestion.largest.values(), 1e-300)
    if share < DARK_SHARE:
        return "; it reads hardly anything: failed, or never sunlit"
    return f"; its largest reading is {share:.0%} of the largest of all panels"


def _fill_sensor(text: str, sensor: str, triple: AxisColumns) -> str:
    """Return a vehicle file whose commented example of a sensor names the columns of the telemetry, still as a comment."""
    begin = text.index(f"# [{sensor}]\n")
    head, example = text[:begin], text[begin:]
    columns = ", ".join(map(toml_string, triple.columns))
    # one replacement each: the example of the sensor comes first in the rest of the text
    example = re.sub(
        r"# columns = \[[^]]*\] *", lambda _: f"# columns = [{columns}]   ", example, count=1
    )
    key = {"gyro": "scale_rad_s", "magnetometer": "scale_T"}[sensor]
    if triple.unit is not None:
        example = re.sub(
            rf"# {key} = \S+", lambda _: f"# {key} = {triple.unit:.6g}", example, count=1
        )
    return head + example


def suggest_telemetry(telemetry: Path, vehicle: Vehicle) -> str:
    """Return a `[telemetry]` section that would read a file, with the names of the vehicle's panels; empty if there is none.

    There is none either if the file has a column that the vehicle file reads: then the section is right, and a column is missing.
    """
    table, panels = read_table(telemetry), {}
    if columns_of_readings(vehicle) & set(table.header):
        return ""
    for name, normal in zip(vehicle.panel_names, vehicle.panel_normals_B, strict=True):
        for face, axis in FACES.items():
            if normal @ np.array(axis) > ON_FACE:
                panels.setdefault(face, name)
    suggestion = suggest_section(table, panels)
    return suggestion.section if suggestion else ""


def _template(name: str) -> str:
    """Return the text of a file of the example."""
    return resources.files("sunspin").joinpath("template", name).read_text(encoding="utf-8")


def _replace(text: str, first: str, after: str, new: str) -> str:
    """Return a text with `new` from the first occurrence of `first` up to `after`."""
    begin = text.index(first)
    return text[:begin] + new + text[text.index(after, begin) :]


def _comment_out(text: str, first: str, after: str) -> str:
    """Return a text whose lines from the first that begins with `first` up to `after` are comments."""
    begin = text.index(f"\n{first}") + 1
    end = text.index(after, begin)
    lines = text[begin:end].splitlines(keepends=True)
    return text[:begin] + "".join(x if x.startswith("#") else f"# {x}" for x in lines) + text[end:]


def _write(folder: Path, texts: dict[str, str]) -> list[Path]:
    """Write texts into new files of a folder, all or none, and return their paths; raise `OutputError` if one exists."""
    targets = [folder / name for name in texts]
    for target in targets:
        if os.path.lexists(target):
            what, do = "this file is there already", "choose another folder"
            raise OutputError(what, do=do, where=str(target))
    created: list[Path] = []
    try:
        make_folder(folder)
        for target in targets:
            with open(target, "x", encoding="utf-8") as file:
                created.append(target)
                file.write(texts[target.name])
    except OSError as error:
        for target in created:
            target.unlink(missing_ok=True)
        what = f"files cannot be written here ({error.strerror or error})"
        raise OutputError(what, do="choose another folder", where=str(folder)) from None
    return targets
