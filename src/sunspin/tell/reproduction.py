"""`sunspin reproduce`: the whole Philae study into a results folder."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sunspin.cases import Case, load_case
from sunspin.measure.telemetry import read_telemetry
from sunspin.study import rebound as rb
from sunspin.study.reproduce import Reproduction, compute
from sunspin.tell import figures as fig
from sunspin.tell.report import Picture, number_text, write_report
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
        "figures": [asdict(row) for row in result.rows],
    }
    write_json(folder / "summary.json", summary)
    report = write_report(
        folder / "report.html",
        title="How Philae tumbled: the reconstruction, run again",
        synthetic=result.synthetic,
        conclusions=conclusions(result),
        pictures=pictures,
        rows=result.rows,
        provenance=_provenance(case, summary),
    )
    return Written(folder, report, summary)


def conclusions(result: Reproduction) -> list[str]:
    """What was found, in a few sentences."""
    by_id = {row.id: row for row in result.rows}
    lowest = by_id["rate_at_touchdown_min"]
    distances = [deviation["mean"] for deviation in result.clean.deviation]
    found = [
        f"After its first touchdown Philae turned at {number_text(lowest.ours)} rad/s or faster (published: "
        f"{number_text(lowest.published)}), if its motion lay on one of the four published lines; {lowest.note}.",
    ]
    if distances:
        found.append(
            f"A scan of {result.clean.emd.size:,} initial rates against the distribution of the Sun's height that the "
            f"published lines have in common finds four lines again, {number_text(min(distances))} to "
            f"{number_text(max(distances))} rad/s from the published ones on average; the grid's step is 0.015."
            if result.clean.emd.size == rb.grid_size(result.case)
            else "A scan on a coarser grid than the paper's finds four lines again, "
            f"{number_text(min(distances))} to {number_text(max(distances))} rad/s from the published ones on average."
        )
    told = int(np.isfinite(result.rebound["sun_B"].values[:, 0]).sum())
    sentence = (
        f"Against the {told} directions of this telemetry between touchdown and collision the smallest EMD is "
        f"{float(result.twin.emd.min()):.4f}, with {len(result.twin.points)} grid points within {result.twin.factor} times it"
    )
    if result.truth:
        sentence += (
            f"; the true motion behind the synthetic telemetry reaches {result.truth['emd']:.4f}, so this set alone is "
            "no confidence region"
        )
    return [*found, sentence + "."]


def draw(result: Reproduction, folder: Path) -> list[Picture]:
    """All figures, in the paper's order, as PNG and SVG."""
    case, note = result.case, " Synthetic telemetry." if result.synthetic else ""
    lines = rb.published_lines(case)
    measured = result.rebound["sun_B"].values
    measured_z = measured[np.isfinite(measured[:, 0]), 2]
    fall = result.spin_down
    curves = {
        "published fit, which gives the default friction": fall["record"],
        "rounded friction as printed": fall["printed"],
    }
    makers: list[tuple[str, Callable[[], Any], str, str]] = [
        ("fig03_measured", lambda: fig.sun_directions_figure(result.sun, case.telemetry),
         "Panel powers, components of the Sun direction and Delta against time",
         "Panel powers and reconstructed directions (paper, Fig. 3). Grey marks below: samples that give no direction, by "
         "reason." + note),
        ("fig04_phases", lambda: fig.descent_and_rebound_figure(_phases(result.sun), result.synthetic),
         "Sun directions on the unit sphere in four phases", "Directions in each phase (paper, Fig. 4). Orange: "
         "best fits to sets of lit panels that the Sun alone cannot light." + note),
        ("fig05_spin_down", lambda: fig.spin_down_figure(fall["t_s"], curves), "Wheel speed falling to zero",
         "Spin-down of the wheel (paper, Fig. 5), drawn from the published coefficients."),
        ("fig06_examples", lambda: fig.examples_figure(result.examples),
         "Tracks of the Sun on the sphere and its components against time for three initial rates",
         "Simulated tracks of the Sun in body axes (paper, Fig. 6)."),
        ("fig07_histograms", lambda: fig.histograms_figure(result.examples), "Three histograms of the Sun's z component",
         "Distribution of the z component in those simulations (paper, Fig. 7)."),
        ("fig09_lines", lambda: fig.level_set_figure(
            result.clean.points, result.clean.lines, lines,
            f"EMD < {result.clean.factor:g} EMD_min, target: common distribution of the published lines"),
         "Near-minimum points in rate space along four lines",
         f"Near-minimum set against the published lines' own distribution (paper, Fig. 9): {len(result.clean.points)} points. "
         "The paper's factor of 1.1 would leave a handful of points, the minimum against so clean a target being "
         f"{float(result.clean.emd.min()):.4f}."),
        ("thresholds", lambda: fig.thresholds_figure(result.thresholds, result.clean.factor),
         "Size of the near-minimum set and distance of its lines against the factor",
         "What the factor does: points in the set, and how far its four lines are from the published ones. Dashed: the factor "
         "used above. Fewer points than four lines need have no line."),
        ("fig09_telemetry", lambda: fig.level_set_figure(
            result.twin.points, result.twin.lines, lines,
            f"EMD < {result.twin.factor:g} EMD_min, target: this telemetry" + (" (synthetic)" if result.synthetic else ""),
            result.truth.get("omega_B")),
         "Near-minimum points in rate space for the telemetry",
         f"The same against this telemetry: {len(result.twin.points)} points, smallest EMD "
         f"{float(result.twin.emd.min()):.4f}." + note),
        ("distributions", lambda: fig.distributions_figure(
            measured_z, "measured" + (" (synthetic telemetry)" if result.synthetic else ""),
            {f"L{k + 1} as published": z for k, z in enumerate(result.pooled)}, "What the EMD compares"),
         "Cumulative distributions of the z component",
         "Measured z components, and motions begun on the published lines: these four are nearly one distribution (EMD to "
         f"their mean at most {max(rb.pooled_spread(result.pooled)):.4f}), which is why a line cannot be narrowed to a point."
         + note),
        ("fig12_touchdown", lambda: fig.backward_figure(
            result.touchdown_B, result.published_touchdown_B,
            float(np.linalg.norm(result.published_touchdown_B, axis=1).min())),
         "Body rates at the first touchdown", "Rates at the first touchdown, by running backward (paper, Fig. 12)."),
    ]  # fmt: skip
    pictures = []
    for name, make, alt, caption in makers:
        path = fig.save(make(), folder, name)[0]
        pictures.append(Picture(path, alt, caption))
    return pictures


def _phases(sun: xr.Dataset) -> dict[str, xr.Dataset]:
    """The Sun samples by phase, in order of time."""
    if "phase" not in sun.coords:
        return {"all samples": sun}
    groups = {
        "descent": ["descent"],
        "first touchdown to collision": ["first_rebound"],
        "collision to second touchdown": ["second_rebound"],
        "after the second touchdown": ["settling", "rest"],
    }
    return {name: sun.isel(time=np.flatnonzero(np.isin(sun["phase"].values, parts))) for name, parts in groups.items()}


def _write_data(result: Reproduction, folder: Path) -> None:
    attrs = {"synthetic": int(result.synthetic), "seed": result.seed, "sunspin_version": metadata.version("sunspin")}
    write_netcdf(folder / "sun.nc", result.sun)
    for name, family in (("scan_telemetry", result.twin), ("scan_published_lines", result.clean)):
        data = family.emd.to_dataset().assign_attrs(attrs)
        if family.lines is not None:
            data = data.merge(family.lines.rename({"axis": "line_axis", "n": "near_point"}))
        data["near_minimum"] = (("near_point", "rate_axis"), family.points, {"units": "rad/s", "factor": family.factor})
        write_netcdf(folder / f"{name}.nc", data)
    backward = xr.Dataset(
        {"omega_B": (("point", "axis"), result.touchdown_B, {"units": "rad/s"})},
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
