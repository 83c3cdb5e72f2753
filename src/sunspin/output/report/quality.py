"""What each sample is worth: status, misfit, error, one line per sample."""

from __future__ import annotations

import numpy as np
import xarray as xr

from sunspin.output.report.drawn import drawn
from sunspin.output.report.measured import PHASES
from sunspin.output.report.read import Results
from sunspin.output.report.section import Section, Table, utc_text
from sunspin.output.text import capital
from sunspin.telemetry.sun import is_reconstructed

MOST_LINES = 1000
"""Samples listed one by one; of longer files the first are, and the counts cover all."""


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
    )
    lead = [
        f"{told} of {status.size} samples give a direction to the Sun; for each of the others the reason is named."
    ]
    items = [verdicts, *drawn(results, "sun_directions"), _list(results, sun)]
    return Section("quality", "Data quality, sample by sample", lead, items)


def _list(results: Results, sun: xr.Dataset) -> Table:
    n = sun.sizes["time"]
    rows = []
    lit = sun["lit"].values if "lit" in sun else None
    names = sun["panel"].values.astype(str) if "panel" in sun.coords else []
    for i in range(min(n, MOST_LINES)):
        on = (
            ""
            if lit is None
            else "-".join(name for name, is_lit in zip(names, lit[i], strict=True) if is_lit)
        )
        sigma = np.degrees(sun["sigma_rad"].values[i])
        phase = str(sun["phase"].values[i]) if "phase" in sun.coords else ""
        rows.append(
            [
                str(i + 1),
                utc_text(float(sun["time"].values[i]), results.epoch_utc),
                PHASES.get(phase, phase),
                on or "none",
                _number(sun["delta"].values[i], 4),
                _number(sigma, 2),
                str(sun["status_text"].values[i]),
            ]
        )
    left = "" if n <= MOST_LINES else f", the first {MOST_LINES} of {n}"
    return Table(
        [
            "sample",
            "UTC" if results.epoch_utc else "time",
            "phase",
            "lit panels",
            "Delta",
            "error (deg)",
            "verdict",
        ],
        rows,
        f"All samples{left}",
        closed=True,
    )


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "–"
