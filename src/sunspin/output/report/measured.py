"""Panel signals as measured and as modelled."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation, Slerp

from sunspin.base.errors import SunspinError
from sunspin.output.report.passes import dense
from sunspin.output.report.read import Results
from sunspin.output.report.section import (
    Plot,
    Section,
    Table,
    clock,
    instants,
    motion_order,
    packed,
    thin,
    time_axis,
    utc_text,
)
from sunspin.output.text import capital
from sunspin.telemetry.quality import USED, panel_quality
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import panel_power

MOST_SAMPLES = 4000
"""Samples drawn in one plot; more are thinned evenly, and the caption says so."""

TURN = 0.2
"""rad between instants that are drawn: panels' curves bend."""

FINEST = 10
"""Instants drawn between two of a motion, at most."""

LATER_STEP = 3
"""After the first minutes every so many-th instant of a motion is drawn: nobody can read more."""

PAUSE, MOST_STRETCHES = 10, 12
"""Usual steps between samples after which another stretch begins, and how many of the longest have a view of their own."""

WINDOW_S = 900.0
"""A tumbling body turns some sixty times in it: as much as can be read at once."""

WHOLE = ("Truth", "Descent")
"""Motions that are drawn to their end; for the others the samples soon fall beside the line, which is the point."""

PHASES = {
    "deployment": "legs folded",
    "descent": "descent",
    "first_rebound": "bounce to collision",
    "second_rebound": "collision to landing",
    "settling": "settling",
    "rest": "at rest",
}


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
    epoch, unit = (
        results.epoch_utc,
        str(values.attrs.get("units") or ("W" if values.name == "power_W" else "A")),
    )
    names = [str(name) for name in values["panel"].values]
    keep = thin(values.sizes["time"], MOST_SAMPLES)
    t, measured = samples["time"].values[keep], values.values[keep]
    data: list[dict[str, Any]] = []
    views: list[dict[str, Any]] = []
    lost, counts = _left_out(results, samples, names)
    for title, model in _models(results, names):
        views += _modelled(data, title, model, samples, values, epoch, ~lost, counts)
    dots = list(range(len(data), len(data) + len(names)))
    data += [
        {
            "type": "scatter",
            "mode": "markers",
            "x": clock(t, epoch),
            "y": packed(measured[:, k]),
            "yaxis": _axis(k),
            "xaxis": "x",
            "marker": {
                "size": 8,
                "color": "@muted" if lost[k] else "@ink",
                "symbol": "x-thin-open" if lost[k] else "circle",
                "line": {"color": "@paper", "width": 1},
            },
            "name": "telemetry (synthetic)" if results.synthetic else "measured",
            "legendgroup": "measured",
            "showlegend": k == int(np.argmax(~lost)),
        }
        for k in range(len(names))
    ]
    for view in views:
        view["show"] = [*view["show"], *dots]
    modelled = bool(views)
    if not modelled:
        views = _stretches(t, dots, epoch)
    if views:
        views.append(
            {
                "label": "Samples only, the whole file",
                "show": dots,
                "range": instants([t[0], t[-1]], epoch),
                "text": "",
            }
        )
    top = 1.1 * float(np.nanmax(measured)) if np.isfinite(measured).any() else 1.0
    titles = [
        f"{'panel ' if name.isdigit() else ''}{name} ({unit})" + ("<br>left out" if lost[k] else "")
        for k, name in enumerate(names)
    ]
    layout = _rows_layout(titles, time_axis(epoch, t), top)
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
    if modelled:
        caption += (
            "Line: what the chosen motion makes of the panels' normals, with one common factor fitted to the samples and panels "
            "that count."
        )
    if lost.any():
        left = ", ".join(name for name, is_lost in zip(names, lost, strict=True) if is_lost)
        line = "; grey line: what it would read if it worked" if modelled else ""
        caption += f" Left out, as it never reads anything: {left} (crosses{line})."
    if results.command == "reproduce" and modelled:
        caption += (
            " Different motions share how often the Sun stands how high, not when: only "
            "one motion can meet the dots one by one."
        )
    plot = Plot(
        "powers",
        data,
        layout,
        f"Signals of {len(names)} panels against time, dots of the telemetry and modelled lines; each panel rises and falls as it "
        "turns to the Sun and away.",
        caption,
        90 * len(names) + 110,
        views,
        "Modelled motion" if modelled else "Part of the file",
        numbers=_power_numbers(names, values, unit),
        narrow={"margin": {"l": 48, "r": 12, "t": 30, "b": 50}, "font.size": 11},
    )
    seen = "synthetic" if results.synthetic else "measured"
    what = f"Panel {'powers' if unit == 'W' else 'signals'}, {seen}"
    return Section("powers", what + (" and modelled" if modelled else ""), [], [plot])


def _stretches(t: np.ndarray, dots: list[int], epoch: str | None) -> list[dict[str, Any]]:
    """A view of each stretch between long pauses, the longest few: on one axis they would be specks beside emptiness."""
    steps = np.diff(t)
    parts = np.split(t, np.flatnonzero(steps > PAUSE * np.median(steps)) + 1) if steps.size else []
    longest = sorted((part for part in parts if part.size > 1), key=lambda part: -part.size)[
        :MOST_STRETCHES
    ]
    shown = sorted(longest, key=lambda part: float(part[0]))
    margins = [0.01 * float(np.ptp(part)) for part in shown]
    return [
        {
            "label": f"Pass at {utc_text(float(part[0]), epoch, date=True)}",
            "show": dots,
            "text": "",
            "range": instants([part[0] - margin, part[-1] + margin], epoch),
        }
        for part, margin in zip(shown, margins, strict=True)
        if len(parts) > 1
    ]


def _left_out(
    results: Results, samples: xr.Dataset, names: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Which panels (n_panel) never read anything, and which samples (n) count in full: not those that the battery limits."""
    none, every = np.zeros(len(names), dtype=bool), np.ones(samples.sizes["time"], dtype=bool)
    if results.vehicle is None or list(results.vehicle.input_names) != names:
        return none, every
    try:
        quality = panel_quality(results.vehicle, samples)
    except SunspinError:  # samples of any origin: they are shown as they are
        return none, every
    full = quality["use"].values == USED
    return quality["dead"].values.astype(bool), full if full.any() else every


def _modelled(
    data: list[dict[str, Any]],
    title: str,
    model: xr.Dataset,
    samples: xr.Dataset,
    values: xr.DataArray,
    epoch: str | None,
    works: np.ndarray,
    counts: np.ndarray,
) -> list[dict[str, Any]]:
    """Append a model's lines to the traces; the views that show them: a few minutes, and all of it where that can be read."""
    t, signal = model["time"].values, model["panel_signal"].values
    factor = scale_of(
        samples["time"].values[counts], values.values[counts][:, works], t, signal[:, works]
    )
    long = title in WHOLE or "region" in model.attrs  # a region of a posterior fits all samples
    early = t <= t[0] + WINDOW_S
    keep = (
        np.flatnonzero(early | (np.arange(t.size) % LATER_STEP == 0))
        if long
        else np.flatnonzero(early)
    )
    first = len(data)
    for k in range(values.sizes["panel"]):
        data.append(
            {
                "type": "scatter",
                "mode": "lines",
                "x": clock(t[keep], epoch),
                "y": packed(factor * signal[keep, k]),
                "yaxis": _axis(k),
                "xaxis": "x",
                "legendgroup": "modelled",
                "line": {"width": 1.4, "color": "@orange"}
                if works[k]
                else {"width": 1, "color": "@grey", "dash": "dot"},
                "name": "modelled",
                "showlegend": k == int(np.argmax(works)),
                "visible": first == 0,
            }
        )
    show, about = list(range(first, len(data))), capital(str(model.attrs.get("about", "")))
    spans = (
        [(f"{title}, the first {WINDOW_S / 60:g} min", min(t[0] + WINDOW_S, t[-1]))]
        if t[-1] > t[0] + 3 * WINDOW_S
        else []
    )
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


def _rows_layout(titles: list[str], axis: dict[str, Any], top: float) -> dict[str, Any]:
    n = len(titles)
    layout: dict[str, Any] = {"xaxis": {**axis, "anchor": "y" if n == 1 else f"y{n}"}}
    for k, title in enumerate(titles):
        height = 1.0 / n
        layout["yaxis" if k == 0 else f"yaxis{k + 1}"] = {
            "domain": [1 - (k + 1) * height + 0.012, 1 - k * height],
            "range": [-0.04 * top, top],
            "nticks": 3,
            "title": {"text": title, "font": {"size": 12}, "standoff": 4},
            "zeroline": False,
        }
    layout["legend"] = {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0}
    layout["margin"] = {"l": 64, "r": 20, "t": 46, "b": 54}
    return layout


def _models(results: Results, names: list[str]) -> list[tuple[str, xr.Dataset]]:
    found = [
        (str(data.attrs.get("title", name)), data)
        for name, data in results.having("panel_signal", "B_from_N")
        if data["panel_signal"].shape[1] == len(names)
    ]
    found = [(title, _finer(data, results.vehicle, names)) for title, data in found]
    return sorted(found, key=lambda item: motion_order(item[0])) + _of_passes(results, names)


def _finer(model: xr.Dataset, vehicle: Vehicle | None, names: list[str]) -> xr.Dataset:
    """A motion with instants between its own in its first minutes, where it turns far from one to the next."""
    t = model["time"].values
    if (
        vehicle is None
        or list(vehicle.input_names) != names
        or t.size < 2
        or not np.all(np.diff(t) > 0)
        or "sun_B" not in model
    ):
        return model
    fastest = (
        float(np.nanmax(np.linalg.norm(model["omega_B"].values, axis=1)))
        if "omega_B" in model
        else 0.0
    )
    parts = int(min(np.ceil(fastest * float(np.median(np.diff(t))) / TURN), FINEST))
    early = t[t <= t[0] + WINDOW_S]
    if parts < 2 or early.size < 2:
        return model
    fine = np.unique(
        np.concatenate([early[:-1, None] + np.arange(parts) / parts * np.diff(early)[:, None]])
    )
    attitude = Rotation.from_quat(model["B_from_N"].values)
    sun = Slerp(t, attitude)(fine).apply(attitude[0].inv().apply(model["sun_B"].values[0]))
    late = t >= early[-1]
    signal = np.concatenate([panel_power(vehicle, sun), model["panel_signal"].values[late]])
    return xr.Dataset(
        {"panel_signal": (("time", "panel"), signal)},
        coords={"time": np.concatenate([fine, t[late]])},
        attrs=model.attrs,
    )


def _of_passes(results: Results, names: list[str]) -> list[tuple[str, xr.Dataset]]:
    """What the motions found by `sunspin rates` make of the panels."""
    found = results.first("B_from_N", "sun_B", "omega_B", "pass_of")
    if found is None or results.vehicle is None or list(results.vehicle.input_names) != names:
        return []
    made = []
    for title, run in dense(found):
        sun = run["sun_B"].values
        signal = panel_power(results.vehicle, sun / np.linalg.norm(sun, axis=1, keepdims=True))
        made.append((title, run.assign(panel_signal=(("time", "panel"), signal))))
    return made


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
            rows.append(
                [name, f"{known.mean():.4g}", f"{known.max():.4g}", f"{np.mean(known <= 0):.0%}"]
            )
    return Table(
        ["panel", f"mean ({unit})", f"largest ({unit})", "share of samples at or below zero"],
        rows,
        "In numbers",
        closed=True,
    )
