"""What each sample is worth: status, misfit, error, one line per sample."""

from __future__ import annotations

import numpy as np
import xarray as xr

from sunspin.output.report.measured import PHASES
from sunspin.output.report.read import Results
from sunspin.output.report.section import (
    COLOURS,
    SYMBOLS,
    Plot,
    Section,
    Table,
    clock,
    packed,
    thin,
    time_axis,
    utc_text,
)
from sunspin.output.text import capital
from sunspin.telemetry.sun import SunStatus, is_reconstructed

MOST_LINES = 1000
"""Samples listed one by one; of longer files the first are, and the counts cover all."""

LEAST_DELTA = 1e-4

SHORT = {
    "OK": "direction, checked", "UNCHECKED": "direction, unchecked (three panels)", "IMPOSSIBLE": "impossible set of lit panels",
    "RULE": "excluded by a rule", "ARC": "only an arc", "REGION": "only a region", "DARK": "no panel lit",
    "MISSING": "missing or flagged",
}  # fmt: skip
"""Verdicts in a few words, for the legend."""


def section(results: Results) -> Section | None:
    """Counts of every verdict, Delta against time, and the list."""
    sun = results.first("sun_B", "status", "status_text")
    if sun is None or not sun.sizes.get("time"):
        return None
    status = sun["status"].values
    told = int(is_reconstructed(status).sum())
    texts, counts = np.unique(sun["status_text"].values.astype(str), return_counts=True)
    order = np.argsort(-counts)
    verdicts = Table(
        ["verdict", "samples", "share"],
        [[capital(str(texts[k])), str(counts[k]), f"{counts[k] / status.size:.0%}"] for k in order],
        "Verdicts on the samples",
    )  # fmt: skip
    lead = [f"{told} of {status.size} samples give a direction to the Sun; for each of the others the reason is named."]
    return Section("quality", "Data quality, sample by sample", lead, [verdicts, _plot(results, sun), _list(results, sun)])


def _plot(results: Results, sun: xr.Dataset) -> Plot:
    data, status = [], sun["status"].values
    for k, kind in enumerate(SunStatus):
        at = np.flatnonzero(status == kind)
        at = at[thin(at.size, 4000)]
        if not at.size:
            continue
        delta = np.maximum(np.nan_to_num(sun["delta"].values[at], nan=LEAST_DELTA), LEAST_DELTA)
        data.append({
            "type": "scatter", "mode": "markers", "x": clock(sun["time"].values[at], results.epoch_utc), "y": packed(delta),
            "marker": {"size": 7, "color": COLOURS[k % 8], "symbol": SYMBOLS[k % 8]}, "name": SHORT.get(kind.name,
            kind.name.lower().replace("_", " ")),
            "hovertemplate": "%{x}<br>Delta %{y:.4f}",
        })  # fmt: skip
    layout = {
        "xaxis": time_axis(results.epoch_utc, sun["time"].values),
        "yaxis": {"type": "log", "title": {"text": "misfit Delta (1)"}, "dtick": 1, "exponentformat": "none",
        "range": [np.log10(LEAST_DELTA) - 0.2, 0.1]},
        "legend": {"orientation": "h", "y": -0.24, "yanchor": "top"}, "margin": {"l": 66, "r": 16, "t": 10, "b": 54},
    }  # fmt: skip
    return Plot(
        "delta", data, layout, "Misfit Delta of every sample against time, marked by the verdict on the sample; the table lists "
        "them.",
        f"How badly the best direction explains a sample (Delta, no unit; {LEAST_DELTA:g} stands for smaller values and for "
        "samples in which exactly three lit panels leave nothing to "
        "check).", 460, narrow={"legend.y": -0.2, "legend.font.size": 10, "margin.l": 52},
    )  # fmt: skip


def _list(results: Results, sun: xr.Dataset) -> Table:
    n = sun.sizes["time"]
    rows = []
    lit = sun["lit"].values if "lit" in sun else None
    names = sun["panel"].values.astype(str) if "panel" in sun.coords else []
    for i in range(min(n, MOST_LINES)):
        on = "" if lit is None else "-".join(name for name, is_lit in zip(names, lit[i], strict=True) if is_lit)
        sigma = np.degrees(sun["sigma_rad"].values[i])
        phase = str(sun["phase"].values[i]) if "phase" in sun.coords else ""
        rows.append([
            str(i + 1), utc_text(float(sun["time"].values[i]), results.epoch_utc), PHASES.get(phase, phase), on or "none",
            _number(sun["delta"].values[i], 4), _number(sigma, 2), str(sun["status_text"].values[i]),
        ])  # fmt: skip
    left = "" if n <= MOST_LINES else f", the first {MOST_LINES} of {n}"
    return Table(
        ["sample", "UTC" if results.epoch_utc else "time", "phase", "lit panels", "Delta (1)", "error (deg)", "verdict"], rows,
        f"All samples{left}", closed=True,
    )  # fmt: skip


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "–"
