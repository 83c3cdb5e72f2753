"""Run the whole Philae study into a results folder: `sunspin reproduce`."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shlex
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.base.extras import require_extra
from sunspin.base.provenance import version
from sunspin.cases import Case, load_case
from sunspin.compute.helper import helper_process
from sunspin.compute.pool import worker_count
from sunspin.output.folder import (
    CITE,
    Contents,
    results_folder,
    write_data,
    write_manifest,
    write_whole,
)
from sunspin.output.kind import Drawing, Table
from sunspin.output.report import write_report
from sunspin.output.text import number_text
from sunspin.philae import pictures, timing
from sunspin.philae.headline import conclusions, headline, score
from sunspin.philae.rebound import published_lines, with_telemetry
from sunspin.philae.row import Row
from sunspin.philae.study import SECTIONS, Study, add_timing, compute, require_wheel
from sunspin.telemetry.reader import read_telemetry
from sunspin.vehicle import load_vehicle
from sunspin.vehicle.assumptions import split_changes
from sunspin.vehicle.changes import Change, Changes, parse_changes
from sunspin.vehicle.file import attach_changes

PAPER_FIGURES = (
    "structure of Philae; panels, legs, wheel; panel powers and Sun directions over time; Sun directions in four phases; "
    "spin-down of the wheel; three example motions; histograms of r_z in these; E over rates and over parameters; "
    "near-minimum points and four lines; simulated and measured directions of the descent; E against omega_0; "
    "angular velocities at the first touchdown; densities of r_z after the collision, wheel off and held"
).split("; ")
"""Content of Figs. 1, 2 ... of the paper."""


class Written(NamedTuple):
    """A study that was written: its folder, its page `report.html`, the content of its summary, and the time until then in s."""

    folder: Path
    report: Path
    summary: dict[str, Any]
    seconds: float

    @property
    def lines(self) -> list[str]:
        """Lines that the command prints."""
        summary = self.summary
        lines = [f"Changed for this run: {change}" for change in summary["changes"]]
        lines += [f"Data check: {summary['carries']}", *summary["headline"], *summary["score"]]
        lines += summary["missing"].values()
        return [*lines, f"Report: {self.report} (in {self.seconds:.0f} s)"]


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
    posterior: bool = True,
    on_page: Callable[[Written], Any] | None = None,
) -> Written:
    """Run the Philae study and write figures, `summary.json`, NetCDF files, the telemetry used and `report.html` to a folder.

    Every conclusion follows from the telemetry given: its noise and lit threshold, its first direction after the touchdown, its
    scan, and the motions that fit it.

    Parameters
    ----------
    out : path
        Results folder; created if missing, refused if it contains anything but an earlier run of this command.
    telemetry : path, optional
        A file with the columns of the case's telemetry; default: the synthetic one of the package. A copy of the file is written
        to the folder as `telemetry.csv`.
    vehicle : path, optional
        A vehicle file for another body with one wheel and legs; default: Philae's.
    candidates : str or path
        Source of the motions for touchdown, collision and landing. With "scan" it is the 90 % confidence set of the
        scan, "posterior" draws of the posterior (takes minutes), "published" the paper's lines for any telemetry. A file is a
        table with columns omega_x, omega_y, omega_z in rad/s.
    calibrate : int, optional
        Number of simulated flights with known truth from which the threshold of the set is calibrated for these data. Default: the
        shipped calibration if it fits the data, else 60. Zero: no calibration is made, and nothing is concluded if none fits.
    seed, workers, progress
        Seed of all random choices, threads, progress bar.
    coarser : int
        Use every n-th point of the scan's grid, for a quick look.
    changes : dict or list of str, optional
        Values of the vehicle or of the study's assumptions to change, as in :func:`sunspin.load_case`.
    posterior : bool
        Add the posterior of the rebound's readings, which uses the times of the samples, when all else is written.
    on_page : callable, optional
        Called with the result as written before the posterior is added.
    """
    require_extra("study", "the Philae study")
    began = time.perf_counter()
    requested = parse_changes(changes)
    case, source = _load_inputs(telemetry, vehicle, requested)
    if telemetry is not None and Path(out).resolve() in Path(telemetry).resolve().parents:
        what = "the telemetry lies in the results folder, which is replaced"
        raise InputError(what, do="copy it to another place first", where=str(telemetry))
    folder = results_folder(out, "reproduce")
    options: dict[str, Any] = {"source": candidates, "simulations": calibrate, "seed": seed}
    options |= {"coarser": coarser, "workers": workers, "progress": progress}

    # the command that repeats this run
    command = ["sunspin", "reproduce", "--seed", str(seed)]
    given = {"telemetry": telemetry, "vehicle": vehicle, "calibrate": calibrate}
    given |= {"candidates": None if candidates == "scan" else candidates}
    for name, value in given.items():
        command += [] if value is None else [f"--{name}", str(value)]
    for change in requested:
        command += ["--set", str(change)]
    command += [] if coarser == 1 else ["--coarser", str(coarser)]
    command += [] if posterior else ["--without", "posterior"]

    named_vehicle = case.name if vehicle is None else vehicle
    vehicle_text = attach_changes(named_vehicle, split_changes(requested)[0])
    # the stored contradictions of the paper were computed from the unchanged case
    unchanged = telemetry is None and vehicle is None and not requested
    tables = [_contradictions(case)] if unchanged else []
    drawn: pictures.Drawn = {}
    on_disk: set[str] = set()  # data of this run that are written

    def write(study: Study) -> Written:
        """Write inputs, pictures, summary, data and page of the study."""
        write_whole(folder / "timeline.toml", (case.folder / "timeline.toml").read_bytes())
        telemetry_copy = folder / f"telemetry{source.suffix or '.csv'}"
        write_whole(telemetry_copy, lambda part: part.write_bytes(source.read_bytes()))
        drawings = pictures.write_pictures(study, drawn, folder)
        summary = make_summary(study, drawings, time.perf_counter() - began)
        summary["changes"] = [str(change) for change in case.changes]
        summary |= {"command": shlex.join(command), "inputs": _hash_inputs(case, vehicle)}
        samples = case.telemetry, study.synthetic
        contents = Contents(make_datasets(study), drawings, tables, vehicle_text, *samples)
        # the posterior adds data and changes none
        unwritten = {name: data for name, data in contents.data.items() if name not in on_disk}
        write_data(folder, replace(contents, data=unwritten))
        on_disk.update(unwritten)
        write_manifest(folder, summary, contents)
        report = write_report(folder)
        return Written(folder, report, summary, time.perf_counter() - began)

    # the posterior needs no result of the other steps, unless their candidates are its draws
    processes = worker_count(workers) if posterior and candidates != "posterior" else 1
    with helper_process(processes, _prepare_posterior) as helper:
        study = compute(
            case, lambda so_far: pictures.draw_pictures(so_far, drawn), helper, **options
        )
        written = write(study)
        if not posterior or study.candidate_sets.result is None:
            return written
        if on_page is not None:
            on_page(written)
        study = add_timing(study, helper)
        pictures.draw_pictures(study, drawn)
        return write(study)


def _prepare_posterior() -> None:
    """Import what a posterior needs, and leave the processor to the other steps, so that their page is there early."""
    os.nice(10)
    import_module("sunspin.estimate.posterior")


def _load_inputs(
    telemetry: str | Path | None, vehicle: str | Path | None, changes: tuple[Change, ...]
) -> tuple[Case, Path]:
    """Return the case with the given vehicle, changes and telemetry, and the telemetry's file.

    All errors in them are raised here, before any work.
    """
    of_vehicle, of_study = split_changes(changes)
    case = load_case("philae", changes if vehicle is None else of_study)
    source = case.folder / "telemetry.csv" if telemetry is None else Path(telemetry)
    if vehicle is not None:
        craft = load_vehicle(vehicle, of_vehicle)
        require_wheel(craft)
        case = replace(case, vehicle=craft)
    if telemetry is None and vehicle is None:
        return case, source
    return with_telemetry(case, read_telemetry(source, case.vehicle)), source


def _hash_inputs(case: Case, vehicle: str | Path | None) -> list[dict[str, str]]:
    """Return the files that the study was made from, with their hashes."""
    # `vehicle` is a file, or the name of a built-in case
    built_in = vehicle is None or not Path(vehicle).is_file()
    files = {"vehicle": case.folder / "vehicle.toml" if built_in else Path(vehicle)}
    files |= {name: case.folder / f"{name}.toml" for name in ("timeline", "published")}
    about = {key: str(case.telemetry.attrs[key]) for key in ("file", "sha256")}
    inputs = [{"what": "telemetry"} | about]
    for name, path in files.items():
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        inputs.append({"what": name, "file": path.name, "sha256": digest})
    return inputs


def make_summary(study: Study, drawings: list[Drawing], seconds: float) -> dict[str, Any]:
    """Return the content of `summary.json`."""
    counts = study.counts()
    sets, no_candidates = study.candidate_sets.result, study.candidate_sets.error
    calibration = sets and sets.calibration
    # the reason why the report has no conclusions on the motion; empty if it has
    stop = ""
    if no_candidates:
        why = str(no_candidates).rstrip(".")
        stop = f"Nothing follows from this telemetry about the motion after the first touchdown: {why}."
    sections = [(outcome.title, outcome.section, outcome.rows) for outcome in study.outcomes]
    sections.append(("The figures of the paper", "paper", tuple(make_figure_rows(drawings))))
    rows = [
        asdict(row) | {"part": title, "section": SECTIONS[section]}
        for title, section, of_section in sections
        for row in of_section
    ]
    other_counts = {"without_telemetry": counts["no_telemetry"], "paper": counts["paper"]}
    return {
        "version": version(),
        "title": "How Philae tumbled",
        "seed": study.options.seed,
        "synthetic_telemetry": study.synthetic,
        "seconds": round(seconds, 1),
        "chain": study.options.source,
        "carries": study.check.get().first_line,
        "noise": study.noise.about,
        "calibration": str(calibration) if calibration else None,
        "missing": study.missing,
        "stop": stop,
        "headline": headline(study),
        "conclusions": conclusions(study),
        "score": score(study),
        "counts": counts["telemetry"] | other_counts,
        "cite": CITE,
        "figures": rows,
    }


def make_figure_rows(drawings: list[Drawing]) -> list[Row]:
    """Return one row for each numbered figure of the paper: its content, and the files that show it here."""
    rows = []
    for number, shows in enumerate(PAPER_FIGURES, 1):
        # a file such as fig10_11_descent shows two figures
        pattern = rf"fig(\d\d_)*{number:02d}_"
        showing = [drawing for drawing in drawings if re.match(pattern, drawing.name)]
        # Figs. 1 and 2 show the lander
        absent = "not drawn" if number > 2 else "not drawn: a picture of the lander"
        row = Row(
            id=f"figure_{number}",
            what=f"Fig. {number}",
            published=shows,
            ours=", ".join(f"{drawing.name}.png" for drawing in showing) or absent,
            note=" ".join(drawing.caption for drawing in showing),
            source=f"paper, Fig. {number}",
            kind="not_comparable",
            chain="none",
        )
        rows.append(row)
    return rows


def _contradictions(case: Case) -> Table:
    """Return the table of the paper's statements that contradict its own figures or public facts, as stored with the case."""
    import pandas as pd

    study = json.loads((case.folder / "contradictions.json").read_text("utf-8"))
    # keys of the stored statements -> headings of the table
    headings = {"what": "statement", "sentence": "the paper says", "published": "published"}
    headings |= {"ours": "recomputed", "unit": "unit", "other_reading": "other reading"}
    headings |= {"changes": "what it changes", "strength": "strength"}
    rows = [
        # "1" is the unit of a number without unit and is not shown
        {name: "" if row.get(name) == "1" else number_text(row.get(name), 4) for name in headings}
        | {"strength": "weak" if row["weak"] else "strong"}
        for row in study["statements"]
    ]
    title = (
        "Where the paper contradicts itself (it judges the paper and not this run; weak: a matter of wording, or nearly explained "
        f"by the other reading). Computed on {study['made']} by {study['command']}"
    )
    return Table("contradictions", pd.DataFrame(rows), title, headings, prose=True)


# ---- NetCDF files ------------------------------------------------------------------------------------------------------------


def make_datasets(study: Study) -> dict[str, xr.Dataset]:
    """Return the data of every computed step by file name, for the report and for further computation.

    Files of steps that were not computed are left out.
    """
    scan, lines, rate = study.scan.result, study.published_lines.result, {"units": "rad s-1"}
    scans = []
    if scan is not None:
        scans.append(("scan_telemetry", scan.near, "the directions of this telemetry"))
    if lines is not None:
        target = "the common distribution of the printed lines"
        scans.append(("scan_published_lines", lines.clean, target))
    files = {"sun": study.sun}
    points, directions = map(np.array, zip(*published_lines(study.case), strict=True))
    for name, near, target in scans:
        data = near.emd.to_dataset()
        if near.lines is not None:
            data = data.merge(near.lines.rename({"axis": "line_axis", "n": "near_point"}))
        set_attrs, line_dims = rate | {"factor": near.factor}, ("published_line", "rate_axis")
        data["near_minimum"] = ("near_point", "rate_axis"), near.points, set_attrs
        data["published_point"] = line_dims, points, rate
        data["published_direction"] = line_dims, directions, {"units": "1"}
        files[name] = data.assign_attrs(kind="scan", about=f"against {target}")
    if scan is not None and scan.truth:
        files["scan_telemetry"]["truth"] = "rate_axis", scan.truth["omega_B"], rate
    if lines is not None:
        touchdown = {
            "omega_B": (("point", "axis"), lines.near_touchdown, rate),
            "published_B": (("published", "axis"), lines.on_lines_touchdown, rate),
        }
        files["touchdown"] = xr.Dataset(touchdown, coords={"axis": ["x", "y", "z"]})
    if study.candidate_sets.result is not None:
        chosen = study.candidate_sets.result.chosen
        # at most 20,000 of the candidates, evenly chosen; the division rounds up
        table, every = chosen.dataset(), -(-len(chosen) // 20_000)
        for name, unit, about in (
            ("speed_touchdown", "rad s-1", "just after the first touchdown"),
            ("theta", "rad", "angle from the momentum to the z axis"),
            ("alpha", "rad", "angle from the momentum to the Sun"),
        ):
            table[name] = "candidate", getattr(chosen, name), {"units": unit, "long_name": about}
        files["candidates"] = table.isel(candidate=slice(None, None, every))
    if (maps := study.sensitivity.result) is not None:
        files["map_rates"] = maps.rates.to_dataset()
        files["map_parameters"] = data = maps.parameters.to_dataset()
        data["mu_0"].attrs["units"] = "N m"
        data["theta_xx"].attrs["units"] = "kg m2"
    if study.collision.result is not None:
        runs = study.collision.result.runs["chosen"]
        files |= {f"outcomes-{name}": data for name, data in runs.items()}
    if study.strategies.result is not None:
        files["strategies"] = study.strategies.result.table
    for name, motion in (study.motions.result or {}).items():
        files[f"motion-{name.lower().replace(' ', '-')}"] = motion.assign_attrs(title=name)
    if study.speeds.result is not None:
        files["speed"] = study.speeds.result
    if study.timing.result is not None:
        files |= timing.datasets(study.timing.result)
    attrs = {"synthetic": int(study.synthetic), "seed": study.options.seed}
    attrs["sunspin_version"] = version()
    return {name: data.assign_attrs(attrs) for name, data in files.items()}
