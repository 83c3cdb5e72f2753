"""`sunspin reproduce`: the whole Philae study into a results folder."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import xarray as xr

from sunspin.cases import Case, load_case
from sunspin.measure.telemetry import read_telemetry
from sunspin.study import rebound as rb
from sunspin.study import worth_told
from sunspin.study.reproduce import Reproduction, compute, titles
from sunspin.study.row import STATEMENT
from sunspin.tell.pictures import draw
from sunspin.tell.report import number_text, write_report
from sunspin.tell.results import results_folder, write_json, write_netcdf


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
    _write_data(result, folder)
    summary = {
        "version": metadata.version("sunspin"),
        "seed": seed,
        "synthetic_telemetry": result.synthetic,
        "seconds": round(time.perf_counter() - began, 1),
        "missing": result.missing,
        "figures": [asdict(row) for row in result.rows],
    }
    write_json(folder / "summary.json", summary)
    report = write_report(
        folder / "report.html",
        title="How Philae tumbled: the reconstruction, run again",
        synthetic=result.synthetic,
        conclusions=conclusions(result),
        pictures=pictures,
        rows={titles()[name]: rows for name, rows in result.rows_by_part.items()},
        provenance=_provenance(case, summary),
    )
    return Written(folder, report, summary)


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


def _write_data(result: Reproduction, folder: Path) -> None:
    attrs = {"synthetic": int(result.synthetic), "seed": result.seed, "sunspin_version": metadata.version("sunspin")}
    write_netcdf(folder / "sun.nc", result.sun)
    scan = result.parts["level_set"]
    for name, family in (("scan_telemetry", scan.twin), ("scan_published_lines", scan.clean)):
        data = family.emd.to_dataset().assign_attrs(attrs)
        if family.lines is not None:
            data = data.merge(family.lines.rename({"axis": "line_axis", "n": "near_point"}))
        data["near_minimum"] = (("near_point", "rate_axis"), family.points, {"units": "rad/s", "factor": family.factor})
        write_netcdf(folder / f"{name}.nc", data)
    backward = xr.Dataset(
        {"omega_B": (("point", "axis"), result.parts["touchdown"].omega_B, {"units": "rad/s"})},
        coords={"axis": ["x", "y", "z"]},
        attrs=attrs,
    )
    write_netcdf(folder / "touchdown.nc", backward)


def _provenance(case: Case, summary: dict[str, Any]) -> dict[str, Any]:
    return {
        "version": f"sunspin {summary['version']}",
        "seed": summary["seed"],
        "telemetry": f"{case.telemetry.attrs['file']}, SHA-256 {case.telemetry.attrs['sha256']}",
        "telemetry is synthetic": "yes" if summary["synthetic_telemetry"] else "no",
        "seconds": summary["seconds"],
        "model and published figures": "Baranyai, Balazs, Varkonyi: Partial reconstruction of the rotational motion of Philae "
        "spacecraft during its landing on comet 67P/Churyumov-Gerasimenko",
        "run again with": f"sunspin reproduce --seed {summary['seed']}",
    }
