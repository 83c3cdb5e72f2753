"""`sunspin reproduce`: the whole Philae study into a results folder."""

from __future__ import annotations

import hashlib
import json
import re
import shlex
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.base.provenance import version
from sunspin.cases import Case, load_case
from sunspin.output.folder import CITE, Contents, results_folder, write_contents, write_whole
from sunspin.output.kind import Drawing, Table
from sunspin.output.report import write_report
from sunspin.output.text import number_text
from sunspin.philae import pictures
from sunspin.philae.headline import conclusions, headline, score
from sunspin.philae.rebound import published_lines, with_telemetry
from sunspin.philae.row import Row
from sunspin.philae.study import SECTIONS, STEPS, Study, compute, require_wheel
from sunspin.telemetry.reader import read_telemetry
from sunspin.vehicle import load_vehicle
from sunspin.vehicle.assumptions import split
from sunspin.vehicle.changes import Change, Changes, changes_of
from sunspin.vehicle.file import changed_file

SHOWN_BY_THE_PAPER = (
    "structure of Philae; panels, legs, wheel; panel powers and Sun directions over time; Sun directions in four phases; "
    "spin-down of the wheel; three example motions; histograms of r_z in these; E over rates and over parameters; "
    "near-minimum points and four lines; simulated and measured directions of the descent; E against omega_0; "
    "angular velocities at the first touchdown; densities of r_z after the collision, wheel off and held"
).split("; ")
"""What Figs. 1, 2 ... of the paper show."""


class Written(NamedTuple):
    """Where a study was written: the folder, the page in it, and the summary's content."""

    folder: Path
    report: Path
    summary: dict[str, Any]

    @property
    def lines(self) -> list[str]:
        """What is printed of it."""
        summary = self.summary
        lines = [f"Changed for this run: {change}" for change in summary["changes"]]
        lines += [f"Data check: {summary['carries']}", *summary["headline"], *summary["score"]]
        lines += summary["missing"].values()
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
    case, source = _case(telemetry, vehicle, asked)
    if telemetry is not None and Path(out).resolve() in Path(telemetry).resolve().parents:
        what = "the telemetry lies in the results folder, which is replaced"
        raise InputError(what, do="copy it to another place first", where=str(telemetry))
    folder = results_folder(out, "reproduce")
    options: dict[str, Any] = {"source": candidates, "twins": calibrate, "seed": seed}
    options |= {"coarser": coarser, "workers": workers, "progress": progress}
    drawn: pictures.Drawn = {}
    study = compute(case, lambda so_far: pictures.draw(so_far, drawn), **options)
    sheets = pictures.write(drawn, folder)
    write_whole(folder / "timeline.toml", (case.folder / "timeline.toml").read_bytes())
    copy = folder / f"telemetry{source.suffix or '.csv'}"
    write_whole(copy, lambda part: part.write_bytes(source.read_bytes()))

    words = ["sunspin", "reproduce", "--seed", str(seed)]
    chosen = {"telemetry": telemetry, "vehicle": vehicle, "calibrate": calibrate}
    chosen |= {"candidates": None if candidates == "scan" else candidates}
    words += [word for name, x in chosen.items() if x is not None for word in (f"--{name}", str(x))]
    words += [word for change in asked for word in ("--set", str(change))]
    words += [] if coarser == 1 else ["--coarser", str(coarser)]
    summary = summary_of(study, sheets, time.perf_counter() - began)
    summary["changes"] = [str(change) for change in case.changes]
    summary |= {"command": shlex.join(words), "inputs": _inputs(case, vehicle)}
    vehicle_text = changed_file(case.name if vehicle is None else vehicle, split(asked)[0])
    unchanged = telemetry is None and vehicle is None and not asked
    tables = [_contradictions(case)] if unchanged else []
    samples = case.telemetry, study.synthetic
    contents = Contents(datasets(study), sheets, tables, vehicle_text, *samples)
    write_contents(folder, summary, contents)
    return Written(folder, write_report(folder), summary)


def _case(
    telemetry: str | Path | None, vehicle: str | Path | None, changes: tuple[Change, ...]
) -> tuple[Case, Path]:
    """The case with the vehicle, the changes and the telemetry given, all refused before any work; the file of the telemetry."""
    of_vehicle, of_study = split(changes)
    case = load_case("philae", changes if vehicle is None else of_study)
    source = case.folder / "telemetry.csv" if telemetry is None else Path(telemetry)
    if vehicle is not None:
        craft = load_vehicle(vehicle, of_vehicle)
        require_wheel(craft)
        case = replace(case, vehicle=craft)
    if telemetry is None and vehicle is None:
        return case, source
    return with_telemetry(case, read_telemetry(source, case.vehicle)), source


def _inputs(case: Case, vehicle: str | Path | None) -> list[dict[str, str]]:
    """The files that the study was made from, with their hashes."""
    # a vehicle may be named after a built-in case
    own = vehicle is None or not Path(vehicle).is_file()
    files = {"vehicle": case.folder / "vehicle.toml" if own else Path(vehicle)}
    files |= {name: case.folder / f"{name}.toml" for name in ("timeline", "published")}
    about = {key: str(case.telemetry.attrs[key]) for key in ("file", "sha256")}
    inputs = [{"what": "telemetry"} | about]
    for name, path in files.items():
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        inputs.append({"what": name, "file": path.name, "sha256": digest})
    return inputs


def summary_of(study: Study, sheets: list[Drawing], seconds: float) -> dict[str, Any]:
    """What `summary.json` says of the results."""
    counts, chain, missing = study.counts(), study.chain, study.missing
    stop = ""
    if "candidates" in missing:
        texts = [missing[name] for name in ("candidates", "level_set") if name in missing]
        cut = ": not reproduced, as "
        reasons = [text.split(cut, 1)[1] for text in texts if cut in text]
        why = (reasons or texts)[0].rstrip(".")
        stop = f"Nothing follows from this telemetry about the motion after the first touchdown: {why}."
    sections = [(step.title, step.section, study.rows_by_part.get(step.name, [])) for step in STEPS]
    sections.append(("The figures of the paper", "paper", figure_rows(sheets)))
    rows = [
        asdict(row) | {"part": title, "section": SECTIONS[section]}
        for title, section, of_section in sections
        for row in of_section
    ]
    apart = {"without_telemetry": counts["no_telemetry"], "paper": counts["paper"]}
    return {
        "version": version(),
        "title": "How Philae tumbled",
        "seed": study.options.seed,
        "synthetic_telemetry": study.synthetic,
        "seconds": round(seconds, 1),
        "chain": study.options.source,
        "carries": study.parts["carries"].first_line,
        "noise": study.noise.about,
        "calibration": str(chain.calibration) if chain and chain.calibration else None,
        "missing": missing,
        "stop": stop,
        "headline": headline(study),
        "conclusions": conclusions(study),
        "score": score(study),
        "counts": counts["telemetry"] | apart,
        "cite": CITE,
        "figures": rows,
    }


def figure_rows(sheets: list[Drawing]) -> list[Row]:
    """One row for each numbered figure of the paper: what it shows, the files that show it here."""
    rows = []
    for number, shows in enumerate(SHOWN_BY_THE_PAPER, 1):
        mine = [p for p in sheets if re.match(rf"fig(\d\d_)*{number:02d}_", p.name)]
        absent = "not drawn" if number > 2 else "not drawn: a picture of the lander"
        row = Row(
            id=f"figure_{number}",
            what=f"Fig. {number}",
            published=shows,
            ours=", ".join(f"{p.name}.png" for p in mine) or absent,
            note=" ".join(p.caption for p in mine),
            source=f"paper, Fig. {number}",
            kind="not_comparable",
            chain="none",
        )
        rows.append(row)
    return rows


def _contradictions(case: Case) -> Table:
    """Statements of the paper that contradict its own figures or public facts, as a study computed them once."""
    import pandas as pd

    study = json.loads((case.folder / "contradictions.json").read_text("utf-8"))
    shown = {"what": "statement", "sentence": "the paper says", "published": "published"}
    shown |= {"ours": "recomputed", "unit": "unit", "other_reading": "other reading"}
    shown |= {"changes": "what it changes", "strength": "strength"}
    rows = [
        {name: "" if row.get(name) == "1" else number_text(row.get(name), 4) for name in shown}
        | {"strength": "weak" if row["weak"] else "strong"}
        for row in study["statements"]
    ]
    title = (
        "Where the paper contradicts itself (it judges the paper and not this run; weak: a matter of wording, or nearly explained "
        f"by the other reading). Computed on {study['made']} by {study['command']}"
    )
    return Table("contradictions", pd.DataFrame(rows), title, shown, prose=True)


# ---- NetCDF files ------------------------------------------------------------------------------------------------------------


def datasets(study: Study) -> dict[str, xr.Dataset]:
    """File name -> data of every step that was computed: what the report is made from, and what a reader may compute with."""
    parts, lines, rate = study.parts, study.parts["published_lines"], {"units": "rad s-1"}
    scans = [("scan_published_lines", lines.clean, "the common distribution of the printed lines")]
    if (scan := parts.get("level_set")) is not None:
        scans.insert(0, ("scan_telemetry", scan.near, "the directions of this telemetry"))
    files = {"sun": study.sun}
    printed = [np.array(each) for each in zip(*published_lines(study.case), strict=True)]
    for name, family, target in scans:
        data = family.emd.to_dataset()
        if family.lines is not None:
            data = data.merge(family.lines.rename({"axis": "line_axis", "n": "near_point"}))
        near, by = rate | {"factor": family.factor}, ("published_line", "rate_axis")
        data["near_minimum"] = ("near_point", "rate_axis"), family.points, near
        data["published_point"] = by, printed[0], rate
        data["published_direction"] = by, printed[1], {"units": "1"}
        files[name] = data.assign_attrs(kind="scan", about=f"against {target}")
    if scan is not None and scan.truth:
        files["scan_telemetry"]["truth"] = "rate_axis", scan.truth["omega_B"], rate
    touchdown = {
        "omega_B": (("point", "axis"), lines.near_touchdown, rate),
        "published_B": (("published", "axis"), lines.on_lines_touchdown, rate),
    }
    files["touchdown"] = xr.Dataset(touchdown, coords={"axis": ["x", "y", "z"]})
    if study.chain is not None:
        chosen = study.chain.chosen
        table, every = chosen.dataset(), -(-len(chosen) // 20_000)  # an even draw of more
        for name, unit, about in (
            ("speed_touchdown", "rad s-1", "just after the first touchdown"),
            ("theta", "rad", "angle from the momentum to the z axis"),
            ("alpha", "rad", "angle from the momentum to the Sun"),
        ):
            table[name] = "candidate", getattr(chosen, name), {"units": unit, "long_name": about}
        files["candidates"] = table.isel(candidate=slice(None, None, every))
    if "sensitivity" in parts:
        files["map_rates"] = parts["sensitivity"].rates.to_dataset()
        files["map_parameters"] = data = parts["sensitivity"].parameters.to_dataset()
        data["mu_0"].attrs["units"] = "N m"
        data["theta_xx"].attrs["units"] = "kg m2"
    if "collision" in parts:
        runs = parts["collision"].runs["chosen"]
        files |= {f"outcomes-{name}": each for name, each in runs.items()}
    if "strategies" in parts:
        files["strategies"] = parts["strategies"].table
    for name, run in parts.get("motions", {}).items():
        files[f"motion-{name.lower().replace(' ', '-')}"] = run.assign_attrs(title=name)
    if "speeds" in parts:
        files["speed"] = parts["speeds"]
    attrs = {"synthetic": int(study.synthetic), "seed": study.options.seed}
    attrs["sunspin_version"] = version()
    return {name: data.assign_attrs(attrs) for name, data in files.items()}
