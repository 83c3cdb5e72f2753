"""Panel signals as measured and as modelled, and the Sun's path on the body's sphere."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from sunspin.measure.sun import is_reconstructed
from sunspin.tell.report.read import Results
from sunspin.tell.report.section import COLOURS, SYMBOLS, Plot, Section, Table, clock, instants, packed, thin, time_axis

MOST_SAMPLES = 4000
"""Samples drawn in one plot; more are thinned evenly, and the caption says so."""

MODEL_STEP = 3
"""Every so many-th instant of a motion drawn to its end."""

WINDOW_S = 900.0
"""A tumbling body turns some sixty times in it: as much as can be read at once."""

WHOLE = ("Truth", "Descent")
"""Motions that are drawn to their end; for the others the samples soon fall beside the line, which is the point."""

PHASES = {
    "deployment": "legs folded", "descent": "descent", "first_rebound": "bounce to collision",
    "second_rebound": "collision to landing",
    "settling": "settling", "rest": "at rest",
}  # fmt: skip


def signals(data: xr.Dataset) -> xr.DataArray | None:
    """The panels' powers or currents of a telemetry Dataset, (time, panel)."""
    for name in ("power_W", "current_A"):
        if name in data and set(data[name].dims) == {"time", "panel"}:
            return data[name].transpose("time", "panel")
    return None


def powers(results: Results) -> Section | None:
    """One row per panel: dots measured, line modelled, a view for each candidate."""
    samples = results.data.get("telemetry")
    values = None if samples is None else signals(samples)
    if samples is None or values is None or not values.sizes["time"]:
        return None
    results.used.add("telemetry")
    epoch, unit = results.epoch_utc, str(values.attrs.get("units") or ("W" if values.name == "power_W" else "A"))
    names = [str(name) for name in values["panel"].values]
    keep = thin(values.sizes["time"], MOST_SAMPLES)
    t, measured = samples["time"].values[keep], values.values[keep]
    data: list[dict[str, Any]] = []
    views: list[dict[str, Any]] = []
    for title, model in _models(results, names):
        views += _modelled(data, title, model, samples, values, epoch)
    dots = list(range(len(data), len(data) + len(names)))
    data += [
        {"type": "scatter", "mode": "markers", "x": clock(t, epoch), "y": packed(measured[:, k]), "yaxis": _axis(k), "xaxis": "x",
         "marker": {"size": 8, "color": "@ink", "line": {"color": "@paper", "width": 1}},
         "name": "measured" + (" (synthetic)" if results.synthetic else ""), "showlegend": k == 0, "legendgroup": "measured"}
        for k in range(len(names))
    ]  # fmt: skip
    for view in views:
        view["show"] = [*view["show"], *dots]
    if views:
        views.append({"label": "Samples only, the whole file", "show": dots, "range": instants([t[0], t[-1]], epoch), "text": ""})
    top = 1.1 * float(np.nanmax(measured)) if np.isfinite(measured).any() else 1.0
    layout = _rows_layout(names, unit, epoch, top)
    if views:
        layout["xaxis"]["range"] = views[0]["range"]
    caption = (
        f"Signal of each panel in {unit}. Dots: {'synthetic telemetry' if results.synthetic else 'measured'}"
        + (
            f", every {-(-values.sizes['time'] // len(keep))}th of {values.sizes['time']} samples"
            if len(keep) < values.sizes["time"]
            else ""
        )
        + ". "
    )
    if views:
        caption += (
            "Line: what the chosen motion makes of the panels' normals, with one common factor fitted to the samples. Different "
            "motions "
            "share how often the Sun stands how high, not when: only one motion can meet the dots one by one."
        )
    plot = Plot(
        "powers", data, layout,
        f"Signals of {len(names)} panels against time, measured as dots and modelled as lines; each panel rises and falls as it "
        f"turns "
        "to the Sun and away.",
        caption, 90 * len(names) + 110, views, "Modelled motion", numbers=_power_numbers(names, values, unit),
        narrow={"margin": {"l": 48, "r": 12, "t": 30, "b": 50}, "font.size": 11},
    )  # fmt: skip
    return Section(
        "powers", "Panel powers, measured and modelled" if unit == "W" else "Panel signals, measured and modelled", [], [plot]
    )


def _modelled(
    data: list[dict[str, Any]], title: str, model: xr.Dataset, samples: xr.Dataset, values: xr.DataArray, epoch: str | None
) -> list[dict[str, Any]]:
    """Append a model's lines to the traces; the views that show them: a few minutes, and all of it where that can be read."""
    t = model["time"].values
    factor = scale_of(samples["time"].values, values.values, t, model["panel_signal"].values)
    long = title in WHOLE
    keep = np.arange(0, t.size, MODEL_STEP if t.size > 2000 else 1) if long else np.flatnonzero(t <= t[0] + WINDOW_S)
    first = len(data)
    for k in range(values.sizes["panel"]):
        data.append({
            "type": "scatter", "mode": "lines", "x": clock(t[keep], epoch), "y": packed(factor * model["panel_signal"].values[keep,
            k]),
            "yaxis": _axis(k), "xaxis": "x", "legendgroup": "modelled", "line": {"width": 1.4, "color": "@orange"},
            "name": "modelled",
            "showlegend": k == 0, "visible": first == 0,
        })  # fmt: skip
    show, about = list(range(first, len(data))), str(model.attrs.get("about", ""))
    spans = [(f"{title}, the first {WINDOW_S / 60:g} min", min(t[0] + WINDOW_S, t[-1]))] if t[-1] > t[0] + 3 * WINDOW_S else []
    spans += [(f"{title}, all of it", t[-1])] if long or not spans else []
    if title == "Descent":
        spans = spans[-1:]
    return [
        {
            "label": label,
            "show": show,
            "range": instants([t[0] - 0.01 * (end - t[0]), end + 0.01 * (end - t[0])], epoch),
            "text": about,
        }
        for label, end in spans
    ]


def _axis(k: int) -> str:
    return "y" if k == 0 else f"y{k + 1}"


def _rows_layout(names: list[str], unit: str, epoch: str | None, top: float) -> dict[str, Any]:
    n = len(names)
    layout: dict[str, Any] = {"xaxis": {**time_axis(epoch), "anchor": "y" if n == 1 else f"y{n}"}}
    for k, name in enumerate(names):
        height = 1.0 / n
        layout["yaxis" if k == 0 else f"yaxis{k + 1}"] = {
            "domain": [1 - (k + 1) * height + 0.012, 1 - k * height], "range": [-0.04 * top, top], "nticks": 3,
            "title": {"text": f"{name} ({unit})", "font": {"size": 12}, "standoff": 4}, "zeroline": False,
        }  # fmt: skip
    layout["legend"] = {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0}
    layout["margin"] = {"l": 64, "r": 20, "t": 30, "b": 54}
    return layout


def _models(results: Results, names: list[str]) -> list[tuple[str, xr.Dataset]]:
    found = [
        (str(data.attrs.get("title", name)), data)
        for name, data in results.having("panel_signal", "B_from_N") if data["panel_signal"].shape[1] == len(names)
    ]  # fmt: skip
    order = {"Truth": 0, "Best fit": 1, "Descent": 9}
    return sorted(found, key=lambda item: (order.get(item[0], 5), item[0]))


def scale_of(t: np.ndarray, measured: np.ndarray, when: np.ndarray, modelled: np.ndarray) -> float:
    """The factor, by least squares over samples within the model's time, that brings the model to the measured signals."""
    inside = (t >= when[0]) & (t <= when[-1]) & np.isfinite(measured).all(axis=1)
    if not inside.any():
        return 1.0
    there = np.stack([np.interp(t[inside], when, column) for column in modelled.T], axis=1)
    power = float((there**2).sum())
    return float((there * measured[inside]).sum()) / power if power > 0 else 1.0


def _power_numbers(names: list[str], values: xr.DataArray, unit: str) -> Table:
    rows = []
    for k, name in enumerate(names):
        column = values.values[:, k]
        known = column[np.isfinite(column)]
        if known.size:
            rows.append([name, f"{known.mean():.4g}", f"{known.max():.4g}", f"{np.mean(known <= 0):.0%}"])
    return Table(
        ["panel", f"mean ({unit})", f"largest ({unit})", "share of samples at or below zero"], rows, "In numbers", closed=True
    )


def sun_path(results: Results) -> Section | None:
    """Measured directions on the unit sphere in body axes, and the candidates' paths."""
    sun = results.first("sun_B", "status")
    data = [*_sphere()]
    base, views, numbers = len(data), [], []
    shown: list[int] = list(range(base))
    if sun is not None:
        told = is_reconstructed(sun["status"].values)
        phase = sun["phase"].values.astype(str) if "phase" in sun.coords else np.full(told.size, "all samples")
        for k, name in enumerate(dict.fromkeys(phase[told])):
            at = np.flatnonzero(told & (phase == name))
            at = at[thin(at.size, MOST_SAMPLES)]
            shown.append(len(data))
            label = PHASES.get(str(name), str(name))
            data.append(_points(sun["sun_B"].values[at], label, COLOURS[k % 7], SYMBOLS[k % 8]))
            z = sun["sun_B"].values[at, 2]
            numbers.append([label, str(at.size), f"{z.min():.2f} to {z.max():.2f}", f"{z.mean():.2f}"])
    for k, (title, path, note) in enumerate(_paths(results)):
        data.append({
            "type": "scatter3d", "mode": "lines", "x": packed(path[:, 0] * 1.004), "y": packed(path[:, 1] * 1.004),
            "z": packed(path[:, 2] * 1.004), "line": {"width": 2.5, "color": "@ink"}, "name": f"path: {title}", "visible": k == 0,
            "hoverinfo": "name",
        })  # fmt: skip
        views.append({"label": title, "show": [*shown, len(data) - 1], "text": note})
        if not numbers or sun is None:
            numbers.append([title, str(len(path)), f"{path[:, 2].min():.2f} to {path[:, 2].max():.2f}", f"{path[:, 2].mean():.2f}"])
    if len(data) == base:
        return None
    plates = _normals(results)
    for view in views:
        view["show"] = [*view["show"], *range(len(data), len(data) + len(plates))]
    data += plates
    limits = {"range": [-1.25, 1.25], "showspikes": False, "nticks": 5}
    layout = {
        "scene": {
            "xaxis": {**limits, "title": {"text": "x (1)"}}, "yaxis": {**limits, "title": {"text": "y (1)"}},
            "zaxis": {**limits, "title": {"text": "z (1)"}}, "aspectmode": "cube", "camera": {"eye": {"x": 0.95, "y": -1.0,
            "z": 0.6}},
        },
        "legend": {"orientation": "h", "y": 0, "yanchor": "top"}, "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
    }  # fmt: skip
    plot = Plot(
        "sphere", data, layout,
        "A sphere in body axes. Each dot is the direction in which the panels say that the Sun stood; a line is its path in one "
        "motion; "
        "labels stand where a panel looks straight at the Sun.",
        "Where the Sun stood as seen from the body. Drag, or use the arrow keys, to turn; + and − to zoom. Directions are unit "
        "vectors without unit." + (" Synthetic telemetry." if results.synthetic and sun is not None else ""),
        560, views, "Path of", narrow={"scene.camera.eye": {"x": 1.25, "y": -1.3, "z": 0.8}},
        numbers=Table(["phase", "directions", "range of z", "mean of z"], numbers, "In numbers", closed=True),
    )  # fmt: skip
    return Section("sun-path", "The Sun's path on the body's sphere", [], [plot])


def _points(sun: np.ndarray, label: str, colour: str, symbol: str) -> dict[str, Any]:
    return {
        "type": "scatter3d", "mode": "markers", "x": packed(sun[:, 0]), "y": packed(sun[:, 1]), "z": packed(sun[:, 2]),
        "name": label,
        "marker": {"size": 5, "color": colour, "symbol": symbol}, "hovertemplate": "x %{x:.3f}<br>y %{y:.3f}<br>z %{z:.3f}",
    }  # fmt: skip


def _sphere() -> list[dict[str, Any]]:
    """Parallels and meridians of the unit sphere, as one line with gaps, and a pale ball inside."""
    turn = np.linspace(0, 2 * np.pi, 73)
    rings = []
    for height in np.sin(np.radians([-60, -30, 0, 30, 60])):
        flat = np.sqrt(1 - height**2)
        rings.append(np.stack([flat * np.cos(turn), flat * np.sin(turn), np.full(turn.size, height)], axis=1))
    for azimuth in np.radians(np.arange(0, 180, 30)):
        rings.append(np.stack([np.cos(azimuth) * np.cos(turn), np.sin(azimuth) * np.cos(turn), np.sin(turn)], axis=1))
    gap = np.full((1, 3), np.nan)
    lines = np.concatenate([part for ring in rings for part in (ring, gap)])
    v, u = np.meshgrid(np.linspace(0, np.pi, 19), np.linspace(0, 2 * np.pi, 37), indexing="ij")
    ball = 0.985 * np.stack([np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)])
    flat = {"showscale": False, "hoverinfo": "skip", "showlegend": False}
    return [
        {"type": "surface", "x": packed(ball[0]), "y": packed(ball[1]), "z": packed(ball[2]), "opacity": 1.0,
         "surfacecolor": packed(np.zeros_like(ball[0])), "colorscale": [[0, "@ball"], [1, "@ball"]],
         "lighting": {"ambient": 0.95, "diffuse": 0.1, "specular": 0.0}, "contours": {k: {"highlight": False} for k in "xyz"},
         **flat},
        {"type": "scatter3d", "mode": "lines", "x": packed(lines[:, 0]), "y": packed(lines[:, 1]), "z": packed(lines[:, 2]),
         "line": {"width": 1, "color": "@muted"}, "connectgaps": False, "hoverinfo": "skip", "showlegend": False},
    ]  # fmt: skip


def _normals(results: Results) -> list[dict[str, Any]]:
    if results.vehicle is None or not results.vehicle.panels:
        return []
    normal = 1.12 * results.vehicle.panel_normals_B
    return [{
        "type": "scatter3d", "mode": "text", "x": packed(normal[:, 0]), "y": packed(normal[:, 1]), "z": packed(normal[:, 2]),
        "text": [f"{name}" for name in results.vehicle.panel_names], "textfont": {"size": 13, "color": "@ink"}, "showlegend": False,
        "hovertext": [f"panel {name}" for name in results.vehicle.panel_names], "hoverinfo": "text",
    }]  # fmt: skip


PATH_S = 300.0
"""A candidate's path is drawn for so long; longer ones cover the sphere."""


def _paths(results: Results) -> list[tuple[str, np.ndarray, str]]:
    found = []
    for name, data in sorted(results.having("sun_B", "momentum_B", "B_from_N")):
        t = data["time"].values
        at = np.flatnonzero(np.abs(t - t[0]) <= PATH_S)
        at = at[thin(at.size, 1500)]
        title = str(data.attrs.get("title", name))
        note = f"The first {abs(t[at[-1]] - t[0]) / 60:.3g} min. {str(data.attrs.get('about', ''))}"
        found.append((title, data["sun_B"].values[at], note))
    order = {"Truth": 0, "Best fit": 1}
    return sorted(found, key=lambda item: order.get(item[0], 5))


def picture(results: Results) -> Plot | None:
    """First picture of a folder with directions only: the three components with their errors against time."""
    sun = results.first("sun_B", "status", "sigma_rad")
    if sun is None:
        return None
    told = np.flatnonzero(is_reconstructed(sun["status"].values))
    told = told[thin(told.size, MOST_SAMPLES)]
    if not told.size:
        return None
    sigma = np.nan_to_num(sun["sigma_rad"].values[told], posinf=0.0)
    data = [
        {"type": "scatter", "mode": "markers", "x": clock(sun["time"].values[told], results.epoch_utc),
         "y": packed(sun["sun_B"].values[told, k]), "error_y": {"type": "data", "array": packed(sigma), "width": 0, "thickness": 1},
         "marker": {"size": 6, "color": COLOURS[k], "symbol": SYMBOLS[k]}, "name": f"n<sub>{axis}</sub>"}
        for k, axis in enumerate("xyz")
    ]  # fmt: skip
    layout = {
        "xaxis": time_axis(results.epoch_utc), "yaxis": {"title": {"text": "direction to the Sun, body axes (1)"}, "range": [-1.1,
        1.1]},
        "legend": {"orientation": "h", "y": 1.0, "yanchor": "bottom"}, "margin": {"l": 60, "r": 16, "t": 30, "b": 54},
    }  # fmt: skip
    return Plot(
        "sun", data, layout, "Components of the direction to the Sun against time, with error bars.",
        "Direction to the Sun in body axes; bars: one sigma." + (" Synthetic telemetry." if results.synthetic else ""), 380,
    )  # fmt: skip
