"""`sunspin reproduce`: the whole Philae study into a results folder."""

from __future__ import annotations

import hashlib
import json
import re
import shlex
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from sunspin.base.errors import InputError
from sunspin.base.provenance import version
from sunspin.output.folder import CITE, Contents, results_folder, write_contents, write_whole
from sunspin.output.kind import Drawing, Table
from sunspin.output.report import write_report
from sunspin.output.text import number_text
from sunspin.philae import rebound as rb
from sunspin.philae.files import datasets
from sunspin.philae.headline import conclusions, headline, score
from sunspin.philae.pictures import Gallery
from sunspin.philae.row import Row
from sunspin.philae.study import (
    SECTIONS,
    STEPS,
    Options,
    Reproduction,
    compute,
    require_wheel,
    with_vehicle,
)
from sunspin.telemetry.case import Case, load_case
from sunspin.telemetry.reader import read_telemetry
from sunspin.vehicle import load_vehicle
from sunspin.vehicle.assumptions import split
from sunspin.vehicle.changes import Change, Changes, changes_of
from sunspin.vehicle.file import changed_file

FIGURES = "The figures of the paper"

SHOWN_BY_THE_PAPER = (
    "structure of Philae",
    "panels, legs, wheel",
    "panel powers and Sun directions over time",
    "Sun directions in four phases",
    "spin-down of the wheel",
    "three example motions",
    "histograms of r_z in these",
    "E over rates and over parameters",
    "near-minimum points and four lines",
    "simulated and measured directions of the descent",
    "E against omega_0",
    "angular velocities at the first touchdown",
    "densities of r_z after the collision, wheel off and held",
)
"""What Figs. 1, 2 ... of the paper show."""


PRINTED = ("delta_mean", "wheel_stop", "emd_min")
"""Rows that are printed with their numbers."""


@dataclass(frozen=True)
class Written:
    """Where a study was written: the folder, the page in it, and the summary's content."""

    folder: Path
    report: Path
    summary: dict[str, Any]

    @property
    def lines(self) -> list[str]:
        """What is printed of it."""
        summary = self.summary
        origin = "synthetic (made from published facts)"
        lines = [f"Changed for this run: {change}" for change in summary["changes"]]
        lines += [
            f"Data check: {summary['carries']}",
            f"Telemetry: {origin if summary['synthetic_telemetry'] else 'measured'}",
        ]
        for row in summary["figures"]:
            if row["id"] in PRINTED:
                unit = "" if row["unit"] == "1" else f" {row['unit']}"
                ours = "none" if row["ours"] is None else f"{row['ours']:.4g}{unit}"
                lines.append(f"  {row['what']}: {ours} (published {row['published']:.4g})")
        lines += [*summary["headline"], *summary["score"], *summary["missing"].values()]
        return [*lines, f"Report: {self.report} (in {summary['seconds']:.0f} s)"]


def reproduce(
    out: str | Path = "results",
    telemetry: str | Path | None = None,
    *,
    vehicle: str | Path | None = None,
    candidates: str = "scan",
    calibrate: int | None = None,
    seed: int = 0,
    workers: int | None = None,
    coarser: int = 1,
    changes: Changes = None,
    progress: bool = False,
) -> Written:
    """Run the Philae study and write figures, `summary.json`, NetCDF files, the telemetry used and `report.html` to a folder.

    Every conclusion follows from the telemetry given: its noise and lit threshold, its first direction after the touchdown, its
    scan, and the motions that the scan leaves.

    Parameters
    ----------
    out : path
        Results folder; made if it is not there, refused if it holds anything but an earlier run of this command.
    telemetry : path, optional
        A file with the columns of the case's telemetry; default: the synthetic one that comes with the package. The file that
        was used is written to the folder as `telemetry.csv`, to copy and change.
    vehicle : path, optional
        A vehicle file for another body with one wheel and legs; default: Philae's.
    candidates : "scan", "posterior", "published" or a file
        Motions from which the touchdown, the collision and what follows are computed: the 90 % set of the scan, draws of the
        posterior (minutes), the paper's printed lines whatever the telemetry says, or a table with columns omega_x, omega_y,
        omega_z in rad/s.
    calibrate : int, optional
        Synthetic flights of known truth from which the set's threshold is calibrated for these data; default: the shipped
        calibration where it fits them, else 60. Zero: none, and no conclusion where none fits.
    seed, workers, progress
        All random choices, threads, progress bar.
    coarser : int
        Use every n-th point of the scan's grid, for a quick look.
    changes : dict or list of str, optional
        Values of the vehicle or of the study's assumptions to change, as in :func:`sunspin.load_case`.
    """
    began = time.perf_counter()
    asked = changes_of(changes)
    case = _case(telemetry, vehicle, asked)
    options = Options(candidates, calibrate, seed, coarser, workers, progress)
    source = _source(case, telemetry)
    if telemetry is not None and Path(out).resolve() in Path(telemetry).resolve().parents:
        raise InputError(
            "the telemetry lies in the results folder, which is replaced",
            do="copy it to another place first",
            where=str(telemetry),
        )
    folder = results_folder(out, "reproduce")
    with Gallery() as gallery:
        result = compute(case, options, gallery.begin)
        pictures = gallery.write(result, folder)
    timeline = (case.folder / "timeline.toml").read_bytes()
    write_whole(folder / "timeline.toml", timeline)
    write_whole(
        folder / f"telemetry{source.suffix or '.csv'}",
        lambda part: part.write_bytes(source.read_bytes()),
    )
    summary = _summary(result, pictures, time.perf_counter() - began)
    summary |= {
        "changes": [str(change) for change in case.changes],
        "command": _command(telemetry, vehicle, options, asked),
        "inputs": _inputs(case, vehicle),
    }
    vehicle_text = changed_file(case.name if vehicle is None else vehicle, split(asked)[0])
    unchanged = telemetry is None and vehicle is None and not asked
    tables = [_contradictions(case)] if unchanged else []
    contents = Contents(
        datasets(result), pictures, tables, vehicle_text, case.telemetry, result.synthetic
    )
    write_contents(folder, summary, contents)
    return Written(folder, write_report(folder), summary)


def _summary(result: Reproduction, pictures: list[Drawing], seconds: float) -> dict[str, Any]:
    """What `summary.json` says of the results."""
    counts, chain = result.counts(), result.chain
    rows = [
        asdict(row) | {"part": step.title, "section": SECTIONS[step.section]}
        for step in STEPS
        for row in result.rows_by_part.get(step.name, [])
    ]
    rows += [
        asdict(row) | {"part": FIGURES, "section": SECTIONS["paper"]}
        for row in figure_rows(pictures)
    ]
    return {
        "version": version(),
        "title": "How Philae tumbled",
        "seed": result.seed,
        "synthetic_telemetry": result.synthetic,
        "seconds": round(seconds, 1),
        "chain": result.options.source,
        "carries": result.parts["carries"].first_line,
        "noise": result.noise.told,
        "calibration": str(chain.calibration) if chain and chain.calibration else None,
        "missing": result.missing,
        "stop": _no_conclusion(result),
        "headline": headline(result),
        "conclusions": conclusions(result),
        "score": score(result),
        "counts": counts["telemetry"]
        | {"without_telemetry": counts["no_telemetry"], "paper": counts["paper"]},
        "cite": CITE,
        "figures": rows,
    }


def _no_conclusion(result: Reproduction) -> str:
    """Why nothing follows from this telemetry about the motion after the first touchdown; empty if something does."""
    if "candidates" not in result.missing:
        return ""
    texts = [result.missing[name] for name in ("candidates", "level_set") if name in result.missing]
    reasons = [
        text.split(": not reproduced, as ", 1)[-1] for text in texts if "not reproduced, as" in text
    ]
    why = (reasons or texts)[0].rstrip(".")
    return f"Nothing follows from this telemetry about the motion after the first touchdown: {why}."


def _contradictions(case: Case) -> Table:
    """Statements of the paper that contradict its own figures or public facts, as a study computed them once."""
    import pandas as pd

    study = json.loads((case.folder / "contradictions.json").read_text("utf-8"))
    shown = {
        "what": "statement",
        "sentence": "the paper says",
        "published": "published",
        "ours": "recomputed",
        "unit": "unit",
        "other_reading": "other reading",
        "changes": "what it changes",
        "strength": "strength",
    }
    rows = [
        {name: "" if row.get(name) == "1" else number_text(row.get(name), 4) for name in shown}
        | {"strength": "weak" if row["weak"] else "strong"}
        for row in study["statements"]
    ]
    title = (
        "Where the paper contradicts itself (it judges the paper and not this run; weak: a matter of wording, or nearly explained "
        f"by the other reading). Computed on {study['made']} by {study['command']}"
    )
    return Table("contradictions", pd.DataFrame(rows), title, shown)


def _case(
    telemetry: str | Path | None, vehicle: str | Path | None, changes: tuple[Change, ...]
) -> Case:
    """The case with the vehicle, the changes and the telemetry given; all refused before any work."""
    of_vehicle, of_study = split(changes)
    case = load_case("philae", changes if vehicle is None else of_study)
    if vehicle is not None:
        craft = load_vehicle(vehicle, of_vehicle)
        require_wheel(craft)
        return with_vehicle(case, craft, read_telemetry(_source(case, telemetry), craft))
    return (
        case
        if telemetry is None
        else rb.with_telemetry(case, read_telemetry(telemetry, case.vehicle))
    )


def _source(case: Case, telemetry: str | Path | None) -> Path:
    return case.folder / "telemetry.csv" if telemetry is None else Path(telemetry)


def _command(
    telemetry: str | Path | None,
    vehicle: str | Path | None,
    options: Options,
    changes: tuple[Change, ...],
) -> str:
    words = ["sunspin", "reproduce", "--seed", str(options.seed)]
    given = {"telemetry": telemetry, "vehicle": vehicle, "calibrate": options.twins}
    for name, value in given.items():
        words += [] if value is None else [f"--{name}", str(value)]
    words += [] if options.source == "scan" else ["--candidates", options.source]
    words += [word for change in changes for word in ("--set", str(change))]
    return shlex.join(words + ([] if options.coarser == 1 else ["--coarser", str(options.coarser)]))


def _inputs(case: Case, vehicle: str | Path | None) -> list[dict[str, str]]:
    """The files that the study was made from, with their hashes."""
    telemetry, own = case.telemetry.attrs, case.folder / "vehicle.toml"
    files = {"vehicle": own if vehicle is None else Path(vehicle)}
    files |= {name: case.folder / f"{name}.toml" for name in ("timeline", "published")}
    inputs = [
        {"what": "telemetry", "file": str(telemetry["file"]), "sha256": str(telemetry["sha256"])}
    ]
    for name, path in files.items():
        # a vehicle may be named after a built-in case
        file = path if path.is_file() else own
        digest = hashlib.sha256(file.read_bytes()).hexdigest()
        inputs.append({"what": name, "file": path.name, "sha256": digest})
    return inputs


def figure_rows(pictures: list[Drawing]) -> list[Row]:
    """One row for each numbered figure of the paper: what it shows, the files that show it here."""
    rows = []
    for number, shows in enumerate(SHOWN_BY_THE_PAPER, 1):
        mine = [p for p in pictures if re.match(rf"fig(\d\d_)*{number:02d}_", p.name)]
        absent = "not drawn" if number > 2 else "not drawn: a picture of the lander"
        row = Row(
            id=f"figure_{number}",
            what=f"Fig. {number}",
            published=shows,
            ours=", ".join(f"{p.name}.png" for p in mine) or absent,
            unit="1",
            tolerance=None,
            agrees=None,
            note=" ".join(p.caption for p in mine),
            source=f"paper, Fig. {number}",
            kind="not_comparable",
            chain="none",
        )
        rows.append(row)
    return rows
