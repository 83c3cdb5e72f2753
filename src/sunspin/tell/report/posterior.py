"""The posterior: which motions the telemetry allows and with what weight."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from sunspin.tell.report.read import Results
from sunspin.tell.report.section import COLOURS, SYMBOLS, Plot, Section, Table, packed, thin

MOST = 4000


def _groups(results: Results) -> tuple[xr.Dataset | None, xr.Dataset | None]:
    draws = results.first("omega_B", "log_weight", "mode_id")
    modes = next((data for name, data in results.data.items() if name.endswith("/modes")), None)
    return (None, None) if draws is None or draws["omega_B"].ndim != 2 else (draws, modes)


def section(results: Results) -> Section | None:
    """Draws of the initial rate by mode, and the table of modes."""
    draws, _ = _groups(results)
    if draws is None:
        return None
    verdict = str(draws.attrs.get("verdict", results.summary.get("verdict", "")))
    weight, mode = _weights(draws), draws["mode_id"].values
    rows = []
    for k in sorted(np.unique(mode), key=lambda k: -weight[mode == k].sum()):
        part, w = np.degrees(draws["omega_B"].values[mode == k]), weight[mode == k]
        mean = np.average(part, axis=0, weights=w if w.sum() > 0 else None)
        sigma = np.sqrt(np.average((part - mean) ** 2, axis=0, weights=w if w.sum() > 0 else None))
        rows.append([str(k), str(len(part)), f"{w.sum():.3g}", *(f"{m:.4g} ± {s:.2g}" for m, s in zip(mean, sigma, strict=True))])
    table = Table(["mode", "draws", "weight (1)", "ωx (deg/s)", "ωy (deg/s)", "ωz (deg/s)"], rows[:50], "Modes, heaviest first")
    return Section("posterior", "The posterior", [verdict] if verdict else [], [_cloud(draws), table])


def _weights(draws: xr.Dataset) -> np.ndarray:
    log = np.nan_to_num(draws["log_weight"].values.astype(float), nan=-np.inf)
    if not np.isfinite(log).any():
        return np.full(log.size, 1 / max(log.size, 1))
    weight = np.exp(log - log[np.isfinite(log)].max())
    return weight / weight.sum()


def _cloud(draws: xr.Dataset) -> Plot:
    mode, omega = draws["mode_id"].values, draws["omega_B"].values
    weight, data = _weights(draws), []
    order = sorted(np.unique(mode), key=lambda k: -weight[mode == k].sum())[:7]
    for k, number in enumerate(order):
        at = np.flatnonzero(mode == number)
        at = at[thin(at.size, MOST // len(order))]
        data.append({
            "type": "scatter3d", "mode": "markers", "x": packed(omega[at, 0]), "y": packed(omega[at, 1]), "z": packed(omega[at, 2]),
            "name": f"mode {number}, weight {weight[mode == number].sum():.2g}",
            "marker": {"size": 3, "color": COLOURS[k], "symbol": SYMBOLS[k % 4]},
        })  # fmt: skip
    layout: dict[str, Any] = {
        "scene": {f"{d}axis": {"title": {"text": f"ω{d} (rad/s)"}, "showspikes": False} for d in "xyz"},
        "legend": {"orientation": "h", "y": 0, "yanchor": "top"}, "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
    }  # fmt: skip
    return Plot(
        "posterior", data, layout, "Draws of the posterior in the space of the three components of the initial body rate, marked "
        "by mode.",
        "Draws of the rate at the first sample, body axes; unweighted, so look at each mode's weight. Drag or use the arrow keys "
        "to turn.", 560,
    )  # fmt: skip


def picture(results: Results) -> Plot | None:
    """Two components of the rate, a sign per mode, size by weight."""
    draws, _ = _groups(results)
    if draws is None:
        return None
    mode, omega = draws["mode_id"].values, np.degrees(draws["omega_B"].values)
    weight, data = _weights(draws), []
    for k, number in enumerate(sorted(np.unique(mode), key=lambda k: -weight[mode == k].sum())[:7]):
        at = np.flatnonzero(mode == number)
        at = at[thin(at.size, 1000)]
        share = weight[mode == number].sum()
        for j, axis in enumerate("xyz"):
            data.append({
                "type": "box", "x": [f"ω{axis}"] * at.size, "y": packed(omega[at, j]), "name": f"mode {number}, weight {share:.2g}",
                "legendgroup": str(number), "showlegend": j == 0, "marker": {"color": COLOURS[k]}, "offsetgroup": str(number),
                "boxpoints": False,
            })  # fmt: skip
    layout = {
        "boxmode": "group", "yaxis": {"title": {"text": "rate at the first sample (deg/s)"}},
        "xaxis": {"title": {"text": "component, body axes"}},
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom"}, "margin": {"l": 60, "r": 16, "t": 46, "b": 54},
    }  # fmt: skip
    return Plot(
        "rates-by-mode",
        data,
        layout,
        "Boxes of each component of the rate for the heaviest modes.",
        "Quartiles and range of each mode.",
        400,
    )
