"""`sunspin reproduce`: the whole Philae study into a results folder."""

from __future__ import annotations

import hashlib
import re
import shlex
import time
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from sunspin.cases import Case, load_case
from sunspin.measure.telemetry import read_telemetry
from sunspin.study import rebound as rb
from sunspin.study import worth_told
from sunspin.study.reproduce import Reproduction, compute, titles
from sunspin.study.row import STATEMENT, Row
from sunspin.tell.headline import headline
from sunspin.tell.pictures import draw
from sunspin.tell.report import write_report
from sunspin.tell.results import CITE, Picture, results_folder, write_run
from sunspin.tell.stored import store
from sunspin.tell.text import number_text

FIGURES = "The figures of the paper"

SHOWN_BY_THE_PAPER = (
    "structure of Philae", "panels, legs, wheel", "panel powers and Sun directions over time", "Sun directions in four phases",
    "spin-down of the wheel", "three example motions", "histograms of r_z in these", "E over rates and over parameters",
    "near-minimum points and four lines", "simulated and measured directions of the descent", "E against omega_0",
    "angular velocities at the first touchdown", "densities of r_z after the collision, wheel off and held",
)  # fmt: skip
"""What Figs. 1, 2 ... of the paper show."""


@dataclass(frozen=True)
class Written:
    """Where a study was written: the folder, the page in it, and the summary's content."""

    folder: Path
    report: Path
    summary: dict[str, Any]


def reproduce(
    out: str | Path = "results",
    telemetry: str | Path | None = None,
    *,
    seed: int = 0,
    workers: int | None = None,
    coarser: int = 1,
    progress: bool = False,
) -> Written:
    """Run the Philae study and write figures, `summary.json`, NetCDF files and `report.html` to a folder.

    Parameters
    ----------
    out : path
        Results folder; made if it is not there, refused if it holds anything but an earlier run of this command.
    telemetry : path, optional
        A file with the columns of the case's telemetry; default: the synthetic one that comes with the package.
    seed, workers, progress
        Random choices of the line fit, threads, progress bar.
    coarser : int
        Use every n-th point of the scan's grid, for a quick look.
    """
    began = time.perf_counter()
    case = load_case("philae")
    if telemetry is not None:
        case = rb.with_telemetry(case, read_telemetry(telemetry, case.vehicle))
    folder = results_folder(out, "reproduce")
    result = compute(case, seed=seed, coarser=coarser, workers=workers, progress=progress)
    pictures = draw(result, folder)
    store(result, folder)
    by_part = {titles()[name]: rows for name, rows in result.rows_by_part.items()} | {FIGURES: figure_rows(pictures)}
    summary = {
        "version": metadata.version("sunspin"),
        "title": "How Philae tumbled",
        "seed": seed,
        "synthetic_telemetry": result.synthetic,
        "seconds": round(time.perf_counter() - began, 1),
        "missing": result.missing,
        "headline": headline(result),
        "conclusions": conclusions(result),
        "command": _command(telemetry, seed, coarser),
        "inputs": _inputs(case),
        "cite": CITE,
        "figures": [asdict(row) | {"part": part} for part, rows in by_part.items() for row in rows],
    }
    write_run(folder, summary, case.name, case.telemetry, pictures)
    return Written(folder, write_report(folder, ours=True), summary)


def _command(telemetry: str | Path | None, seed: int, coarser: int) -> str:
    words = ["sunspin", "reproduce", "--seed", str(seed)]
    words += [] if telemetry is None else ["--telemetry", str(telemetry)]
    return shlex.join(words + ([] if coarser == 1 else ["--coarser", str(coarser)]))


def _inputs(case: Case) -> list[dict[str, str]]:
    """The files that the study was made from, with their hashes."""
    said = case.telemetry.attrs
    found = [{"what": "telemetry", "file": str(said["file"]), "sha256": str(said["sha256"])}]
    for name in ("vehicle.toml", "timeline.toml", "published.toml"):
        digest = hashlib.sha256((case.folder / name).read_bytes()).hexdigest()
        found.append({"what": name.removesuffix(".toml"), "file": name, "sha256": digest})
    return found


def figure_rows(pictures: list[Picture]) -> list[Row]:
    """One row for each numbered figure of the paper: what it shows, the files that show it here."""
    found = []
    for number, shows in enumerate(SHOWN_BY_THE_PAPER, 1):
        mine = [p for p in pictures if re.match(rf"fig(\d\d_)*{number:02d}_", p.path.name)]
        ours = ", ".join(p.path.name for p in mine) or ("not drawn" if number > 2 else "not drawn: a picture of the lander")
        note = " ".join(p.caption for p in mine)
        found.append(Row(f"figure_{number}", f"Fig. {number}", shows, ours, "1", None, None, note, f"paper, Fig. {number}"))
    return found


def conclusions(result: Reproduction) -> list[str]:
    """What was found, in a few sentences; what could not be computed."""
    lowest, scan = result.row("rate_at_touchdown_min"), result.parts["level_set"]
    found = [
        f"After its first touchdown Philae turned at {number_text(lowest.ours)} rad/s or faster (published: "
        f"{number_text(lowest.published)}), if its motion lay on one of the four published lines; {lowest.note}.",
    ]
    if distances := [deviation["mean"] for deviation in scan.clean.deviation]:
        found.append(
            f"The lines follow from the model: against the lines' own distribution of r_z the scan finds four lines that are "
            f"{min(distances):.3f} to {max(distances):.3f} rad/s from the published ones on average (grid step "
            f"{result.case.published['scan_step'].value} rad/s)."
        )
    sentence = (
        f"Against the {scan.measured_z.size} reconstructed directions of this telemetry between touchdown and collision the "
        f"smallest "
        f"EMD is {float(scan.twin.emd.min()):.4f}, with {len(scan.twin.points)} grid points within {scan.twin.factor} times it"
    )
    if scan.truth:
        sentence += (
            f"; the true motion behind the synthetic telemetry reaches {scan.truth['emd']:.4f}, so this set alone is "
            "no confidence region"
        )
    found.append(sentence + ".")
    if "worth" in result.parts:
        found += worth_told.sentences(result.parts["worth"][1])
    wrong = [row for row in result.rows if row.agrees is False]
    apart = [row for row in wrong if not row.id.startswith(STATEMENT)]
    if apart:
        found.append("Not as published: " + "; ".join(f"{row.what} ({row.source.removeprefix('paper, ')})" for row in apart) + ".")
    found.append(
        f"{len(wrong) - len(apart)} statements of the paper contradict its own figures or public facts; the last table has each "
        "with the recomputed value and what it changes."
    )
    return found + [f"{why.rstrip('.')}." for why in result.missing.values()]
