"""Interactive views that plotly draws in the browser: the Sun on the body's sphere, and rate space."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go
import xarray as xr

from sunspin.output.curves import dense, with_wheels
from sunspin.output.figures import COLOURS
from sunspin.output.report.read import Results
from sunspin.vehicle import Vehicle

MOST_MOTIONS = 4
"""Motions of one folder that are shown, the first ones."""

MOST_POINTS = 5000
"""Points of a cloud; larger ones are thinned evenly."""

MOST_PATH = 600
"""Instants of a motion whose Sun is drawn as a path: a longer one covers the sphere."""

GREY, INK = "#808890", "#70787f"
"""Axes and edges, legible on light and on dark paper."""

FIRST = ("Truth", "Best fit", "Slowest candidate", "Middle candidate", "Fastest candidate")
"""Motions of the Philae study in the order in which they are shown."""


class View(NamedTuple):
    """A figure for the browser: its heading, the plotly figure, what it shows in words, its caption, the frames of a motion."""

    id: str
    title: str
    figure: go.Figure
    alt: str
    caption: str
    frames: Sequence[dict[str, Any]] = ()


Motions = list[tuple[str, xr.Dataset]]


def motions_of(results: Results) -> Motions:
    """The first motions (title, Dataset with `B_from_N`, `sun_B`, `omega_B`) of the folder, the passes of `rates` one by one."""
    known, telemetry = [], results.data.get("telemetry")
    for name, data in results.having("B_from_N", "sun_B", "omega_B"):
        if "pass_of" not in data:
            known.append((str(data.attrs.get("title", name)), data))
            continue
        wheels = str(data.attrs.get("wheels", ""))
        for title, run in dense(data):
            if results.vehicle is not None:
                run = with_wheels(run, results.vehicle, telemetry, wheels)
            known.append((title, run))
    rank = {title: k for k, title in enumerate(FIRST)}
    return sorted(known, key=lambda item: rank.get(item[0], len(FIRST)))[:MOST_MOTIONS]


def sun_on_sphere(results: Results, motions: Motions) -> View | None:
    """Measured directions to the Sun on the unit sphere in body axes, and the paths of motions."""
    sun = results.first("sun_B", "status")
    traces = _sphere()
    bare = len(traces)
    if sun is not None:
        known = np.isfinite(sun["sun_B"].values).all(axis=1)
        phase = np.full(known.size, "samples")
        if "phase" in sun.coords:
            phase = sun["phase"].values.astype(str)
        for k, name in enumerate(dict.fromkeys(phase[known])):
            points = _thinned(sun["sun_B"].values[known & (phase == name)])
            traces.append(_cloud(points, name.replace("_", " "), COLOURS[k % 6], 4))
    for k, (title, run) in enumerate(motions):
        path = run["sun_B"].values / np.linalg.norm(run["sun_B"].values, axis=1, keepdims=True)
        trace = line(1.004 * path[:MOST_PATH], INK, 3, f"path: {title}")
        traces.append(trace.update(visible=True if k == 0 else "legendonly", showlegend=True))
    if len(traces) == bare:
        return None
    if results.vehicle is not None and len(results.vehicle.panels):
        traces.append(_normals(results.vehicle))
    figure = go.Figure(traces)
    axis = {"range": [-1.25, 1.25], "nticks": 5}
    axes = {f"{a}axis": {**axis, "title": {"text": f"{a}, body"}} for a in "xyz"}
    figure.update_layout(
        scene=axes, scene_aspectmode="cube", scene_camera_eye={"x": 1.35, "y": -1.4, "z": 0.9}
    )
    return View(
        "sphere",
        "The Sun on the body's sphere",
        styled(figure),
        "A sphere in body axes: dots are directions to the Sun from the panels, lines its path in a motion, labels panel normals.",
        "Directions to the Sun in body axes (unit vectors). Click a path in the legend to show it.",
    )


def _sphere() -> list[Any]:
    """Parallels and meridians, and a pale ball inside that hides the far side."""
    turn, gap, rings = np.linspace(0, 2 * np.pi, 73), np.full((1, 3), np.nan), []
    for height in np.sin(np.radians([-60, -30, 0, 30, 60])):
        flat = np.sqrt(1 - height**2)
        rings += [np.stack([flat * np.cos(turn), flat * np.sin(turn), np.full(73, height)], 1), gap]
    for azimuth in np.radians(np.arange(0, 180, 30)):
        side = np.cos(turn)
        rings += [np.stack([np.cos(azimuth) * side, np.sin(azimuth) * side, np.sin(turn)], 1), gap]
    v, u = np.meshgrid(np.linspace(0, np.pi, 19), np.linspace(0, 2 * np.pi, 37), indexing="ij")
    ball = 0.98 * np.stack([np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)])
    pale = [[0, "#b8c0c8"], [1, "#b8c0c8"]]
    surface = go.Surface(
        places(np.moveaxis(ball, 0, -1)),
        surfacecolor=(0 * ball[0]).astype(np.float32),
        colorscale=pale,
        showscale=False,
        hoverinfo="skip",
        opacity=0.35,
    )
    return [surface, line(np.concatenate(rings), GREY, 1)]


def _normals(vehicle: Vehicle) -> go.Scatter3d:
    """Names of the panels where they look; panels of one normal share a label."""
    normals = np.round(vehicle.panel_normals_B, 6) + 0.0
    sides, side_of = np.unique(normals, axis=0, return_inverse=True)
    names = np.array(vehicle.panel_names)
    texts = [", ".join(names[side_of.ravel() == k]) for k in range(len(sides))]
    return go.Scatter3d(
        dict(zip("xyz", 1.1 * sides.T, strict=True)),
        mode="text",
        text=texts,
        hoverinfo="skip",
        showlegend=False,
    )


def rate_space(results: Results) -> Iterator[View]:
    """Initial rates that fit: draws of a posterior, or the near-minimum sets of scans with their lines."""
    draws = results.first("omega_B", "log_weight", "solution_id")
    if draws is not None:
        omega = np.degrees(draws["omega_B"].values.reshape(-1, 3).astype(float))
        solution = draws["solution_id"].values.ravel()
        numbers, counts = np.unique(solution, return_counts=True)
        traces = [
            _cloud(_thinned(omega[solution == n]), f"solution {n + 1}", COLOURS[k % 6], 2)
            for k, n in enumerate(numbers[np.argsort(-counts)][:7])
        ]
        text = "Draws of the body rate at the first sample, body axes, a colour for each solution."
        yield View("rate-space", "Rate space", _rates(traces, "deg/s"), text, text)
        return
    for k, (_, scan) in enumerate(results.having("near_minimum")):
        points = scan["near_minimum"].values
        member = 0 * points[:, 0]
        if "member" in scan and scan["member"].size == len(points):
            member = scan["member"].values
        traces = [
            _cloud(_thinned(points[member == group]), f"set {int(group) + 1}", COLOURS[i % 6], 3)
            for i, group in enumerate(np.unique(member))
        ]
        rates = (scan[f"omega_{a}"] for a in "xyz")
        box = [(float(rate.min()), float(rate.max())) for rate in rates]
        for point, direction, label, colour in (
            ("point", "direction", "fitted lines", INK),
            ("published_point", "published_direction", "published lines", COLOURS[1]),
        ):
            if point in scan and scan[point].ndim == 2:
                both, gap = (
                    zip(scan[point].values, scan[direction].values, strict=True),
                    [[np.nan] * 3],
                )
                path = np.concatenate([e for p, d in both for e in (_clipped(p, d, box), gap)])
                traces.append(line(path, colour, 5, label).update(showlegend=True))
        if "truth" in scan:
            name, point = "truth of the synthetic telemetry", scan["truth"].values[None]
            traces.append(_cloud(point, name, COLOURS[4], 8))
        about = str(scan.attrs.get("about", ""))
        caption = (
            f"Each dot is a motion, by its initial body rate: the {len(points)} with a misfit near the smallest. "
            "This set is not a confidence region."
        )
        title = f"Rate space: scan {about}" if about else "Rate space"
        alt = (
            "A cloud of initial body rates whose misfit is near the smallest, and lines through it."
        )
        figure = _rates(traces, "rad/s")
        span = np.ptp(box, axis=1) / np.ptp(box, axis=1).max()
        ratio = {a: max(float(part), 0.2) for a, part in zip("xyz", span, strict=True)}
        ends = {f"{a}axis_range": ends for a, ends in zip("xyz", box, strict=True)}
        figure.update_scenes({**ends, "aspectmode": "manual", "aspectratio": ratio})
        yield View(f"rate-space-{k}", title, figure, alt, caption)


def _rates(traces: list[Any], unit: str) -> go.Figure:
    figure = go.Figure(traces)
    axes = {f"{a}axis": {"title": {"text": f"ω{a} ({unit})"}, "nticks": 6} for a in "xyz"}
    figure.update_layout(
        scene=axes, scene_aspectmode="data", scene_camera_eye={"x": 1.5, "y": 1.7, "z": 1.0}
    )
    return styled(figure)


def _clipped(point: np.ndarray, along: np.ndarray, box: list[tuple[float, float]]) -> np.ndarray:
    """The stretch (2, 3) of a line within the scanned box; NaN if there is none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = (np.array(box) - point[:, None]) / along[:, None]
    low, high = np.nanmax(ends.min(axis=1)), np.nanmin(ends.max(axis=1))
    return point + np.array([[low], [high]]) * along if low < high else np.full((2, 3), np.nan)


def _cloud(points: np.ndarray, name: str, colour: str, size: float) -> go.Scatter3d:
    marker = {"size": size, "color": colour}
    return go.Scatter3d(places(points), mode="markers", name=name, marker=marker)


def line(points: np.ndarray, colour: str, width: float, name: str = "") -> go.Scatter3d:
    """A line through points (n, 3), broken where they are NaN."""
    style = {"line": {"width": width, "color": colour}, "hoverinfo": "skip"}
    return go.Scatter3d(places(points), mode="lines", name=name, showlegend=False, **style)


def styled(figure: go.Figure) -> go.Figure:
    """Paper and axes that a light and a dark page share; the page's script sets the colour of the text."""
    figure.update_layout(
        template=None,
        paper_bgcolor="rgba(0,0,0,0)",
        legend={"orientation": "h", "y": 0, "yanchor": "top"},
        margin={"l": 0, "r": 0, "t": 0, "b": 0},
        uirevision="kept",
    )
    plain = {"showbackground": False, "showspikes": False, "gridcolor": GREY, "color": GREY}
    figure.update_scenes(xaxis=plain, yaxis=plain, zaxis=plain)
    return figure


def _thinned(points: np.ndarray) -> np.ndarray:
    return points[:: -(-len(points) // MOST_POINTS) or 1]


def places(points: np.ndarray) -> dict[str, np.ndarray]:
    """Points (..., 3) as plotly takes them, with the digits that the page stores."""
    return {axis: points[..., k].astype(np.float32) for k, axis in enumerate("xyz")}
