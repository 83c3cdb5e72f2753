"""Interactive views that plotly draws in the browser: the Sun direction on the unit sphere, and rate space."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go
import xarray as xr

from sunspin.dynamics.curve import along_curve
from sunspin.output.curves import pass_motions, with_wheel_speeds
from sunspin.output.figures import COLOURS
from sunspin.output.report.read import Results
from sunspin.vehicle import Vehicle

MOST_MOTIONS = 4
"""Number of motions of a folder that are shown, the first ones."""

MOST_POINTS = 5000
"""Number of points of a cloud; larger clouds are thinned evenly."""

MOST_PATH = 600
"""Number of instants of a path of the Sun; a longer path would cover the sphere."""

GREY, INK = "#808890", "#70787f"
"""Colours of axes and of edges, legible on a light and on a dark page."""

FIRST = ("Truth", "Smallest EMD", "Slowest candidate", "Middle candidate", "Fastest candidate")
"""Titles of the motions of the Philae study, in the order in which they are shown."""


class View(NamedTuple):
    """A figure for the browser.

    `id`: of its HTML element; `title`: heading; `figure`: of plotly; `alt`: what it shows, in words; `caption`; `frames`: of an
    animation, as plain data for plotly.js.
    """

    id: str
    title: str
    figure: go.Figure
    alt: str
    caption: str
    frames: Sequence[dict[str, Any]] = ()


Motions = list[tuple[str, xr.Dataset]]
"""Motions of a folder: title, and Dataset with `B_from_N`, `sun_B` and `omega_B` over `time`."""


def read_motions(results: Results) -> Motions:
    """Return the first `MOST_MOTIONS` motions of a folder; each pass of a result of `rates` is a motion.

    If there are more, their attribute `about` says so. Motions of the Philae study are first, in the order of `FIRST`; the others
    follow in the order of the manifest.
    """
    motions, telemetry, total = [], results.data.get("telemetry"), 0
    for name, data in results.with_variables("B_from_N", "sun_B", "omega_B"):
        if "pass_of" not in data:
            motions.append((str(data.attrs.get("title", name)), along_curve(data)))
            total += 1
            continue
        total += data.sizes["pass_id"]
        wheels = str(data.attrs.get("wheels", ""))
        for title, motion in pass_motions(data):
            # a wheel that changed its speed has none of the speeds of the vehicle file
            if results.vehicle is not None and not data.attrs.get("wheel_change"):
                motion = with_wheel_speeds(motion, results.vehicle, telemetry, wheels)
            motions.append((title, motion))
    rank = {title: k for k, title in enumerate(FIRST)}
    motions = sorted(motions, key=lambda motion: rank.get(motion[0], len(FIRST)))[:MOST_MOTIONS]
    if len(motions) == total:
        return motions
    shown = f"Shown are {len(motions)} of {total} motions"
    return [
        (title, motion.assign_attrs(about=f"{motion.attrs.get('about', '')}. {shown}".strip(". ")))
        for title, motion in motions
    ]


def sun_on_sphere(results: Results, motions: Motions) -> View | None:
    """Return the view of measured Sun directions on the unit sphere in body axes, with the paths of motions; None without data."""
    sun = results.first_with("sun_B", "status")
    traces = _sphere()
    traces_without_data = len(traces)
    if sun is not None:
        has_direction = np.isfinite(sun["sun_B"].values).all(axis=1)
        phase = np.full(has_direction.size, "samples")
        if "phase" in sun.coords:
            phase = sun["phase"].values.astype(str)
        for k, name in enumerate(dict.fromkeys(phase[has_direction])):
            points = _thin(sun["sun_B"].values[has_direction & (phase == name)])
            traces.append(_point_trace(points, name.replace("_", " "), COLOURS[k % 6], 4))
    for k, (title, motion) in enumerate(motions):
        sun_B = motion["sun_B"].values
        path = sun_B / np.linalg.norm(sun_B, axis=1, keepdims=True)
        # slightly outside the unit sphere, so that dots do not hide it
        trace = line_trace(1.004 * path[:MOST_PATH], INK, 3, f"path: {title}")
        traces.append(trace.update(visible=True if k == 0 else "legendonly", showlegend=True))
    if len(traces) == traces_without_data:
        return None
    if results.vehicle is not None and len(results.vehicle.panels):
        traces.append(_panel_labels(results.vehicle))
    figure = go.Figure(traces)
    axis = {"range": [-1.25, 1.25], "nticks": 5}
    axes = {f"{a}axis": {**axis, "title": {"text": f"{a}, body"}} for a in "xyz"}
    figure.update_layout(
        scene=axes, scene_aspectmode="cube", scene_camera_eye={"x": 1.35, "y": -1.4, "z": 0.9}
    )
    return View(
        "sphere",
        "The Sun on the body's sphere",
        set_page_style(figure),
        "A sphere in body axes: dots are directions to the Sun from the panels, lines its path in a motion, labels panel normals.",
        "Directions to the Sun in body axes (unit vectors). Click a path in the legend to show it.",
    )


def _sphere() -> list[Any]:
    """Return the traces of a unit sphere: parallels and meridians, and a pale ball inside that hides the far side."""
    angle, rings = np.linspace(0, 2 * np.pi, 73), []
    gap = np.full((1, 3), np.nan)  # breaks the line between two circles
    for z in np.sin(np.radians([-60, -30, 0, 30, 60])):
        radius = np.sqrt(1 - z**2)
        parallel = [radius * np.cos(angle), radius * np.sin(angle), np.full(73, z)]
        rings += [np.stack(parallel, 1), gap]
    for azimuth in np.radians(np.arange(0, 180, 30)):
        in_equator = np.cos(angle)  # component in the plane of the equator
        meridian = [np.cos(azimuth) * in_equator, np.sin(azimuth) * in_equator, np.sin(angle)]
        rings += [np.stack(meridian, 1), gap]
    theta, phi = np.meshgrid(  # angle from z, azimuth
        np.linspace(0, np.pi, 19), np.linspace(0, 2 * np.pi, 37), indexing="ij"
    )
    ball = 0.98 * np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    )
    pale = [[0, "#b8c0c8"], [1, "#b8c0c8"]]  # a scale of one colour
    surface = go.Surface(
        coordinates(np.moveaxis(ball, 0, -1)),
        surfacecolor=(0 * ball[0]).astype(np.float32),
        colorscale=pale,
        showscale=False,
        hoverinfo="skip",
        opacity=0.35,
    )
    return [surface, line_trace(np.concatenate(rings), GREY, 1)]


def _panel_labels(vehicle: Vehicle) -> go.Scatter3d:
    """Return the names of the panels as labels at their normals; panels with the same normal share a label."""
    # adding 0.0 turns -0.0 into 0.0, which would be another normal
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
    """Yield the views of initial rates that fit: the draws of a posterior, or else the near-minimum set of each scan."""
    draws = results.first_with("omega_B", "log_weight", "solution_id")
    if draws is not None:
        yield _draws_view(draws)
        return
    for k, (_, scan) in enumerate(results.with_variables("near_minimum")):
        yield _scan_view(scan, f"rate-space-{k}")


def _draws_view(draws: xr.Dataset) -> View:
    """Return the view of the draws of a posterior, in deg/s, with a colour for each of the seven solutions that have most draws."""
    omega = np.degrees(draws["omega_B"].values.reshape(-1, 3).astype(float))
    solution = draws["solution_id"].values.ravel()
    numbers, counts = np.unique(solution, return_counts=True)
    traces = [
        _point_trace(_thin(omega[solution == n]), f"solution {n + 1}", COLOURS[k % 6], 2)
        for k, n in enumerate(numbers[np.argsort(-counts)][:7])
    ]
    text = "Draws of the body rate at the first sample, body axes, a colour for each solution."
    return View("rate-space", "Rate space", _rate_figure(traces, "deg/s"), text, text)


def _scan_view(scan: xr.Dataset, element_id: str) -> View:
    """Return the view of the near-minimum set of a scan, in rad/s, with the lines fitted to it and the truth if it is known.

    A set of several groups, as of the Philae study, has `member`, the group of each point.
    """
    points = scan["near_minimum"].values
    group_of = 0 * points[:, 0]
    if "member" in scan and scan["member"].size == len(points):
        group_of = scan["member"].values
    traces = [
        _point_trace(_thin(points[group_of == group]), f"set {int(group) + 1}", COLOURS[i % 6], 3)
        for i, group in enumerate(np.unique(group_of))
    ]
    rates = (scan[f"omega_{axis}"] for axis in "xyz")
    box = [(float(rate.min()), float(rate.max())) for rate in rates]  # of the scanned rates
    # the lines fitted to the set, and in the Philae study those of the paper
    for point, direction, label, colour in (
        ("point", "direction", "fitted lines", INK),
        ("published_point", "published_direction", "published lines", COLOURS[1]),
    ):
        if point in scan and scan[point].ndim == 2:
            pieces = []
            for point_on_line, along in zip(
                scan[point].values, scan[direction].values, strict=True
            ):
                pieces += [_clip_line(point_on_line, along, box), np.full((1, 3), np.nan)]
            path = np.concatenate(pieces)
            traces.append(line_trace(path, colour, 5, label).update(showlegend=True))
    if "truth" in scan:
        name, truth = "truth of the synthetic telemetry", scan["truth"].values[None]
        traces.append(_point_trace(truth, name, COLOURS[4], 8))
    about = str(scan.attrs.get("about", ""))
    caption = (
        f"Each dot is a motion, by its initial body rate: the {len(points)} with a misfit near the smallest. "
        "This set is not a confidence region."
    )
    title = f"Rate space: scan {about}" if about else "Rate space"
    alt = "A cloud of initial body rates whose misfit is near the smallest, and lines through it."
    figure = _rate_figure(traces, "rad/s")
    # the sides of the view are as long as those of the box, but a flat box is made thicker to be seen
    span = np.ptp(box, axis=1) / np.ptp(box, axis=1).max()
    ratio = {axis: max(float(side), 0.2) for axis, side in zip("xyz", span, strict=True)}
    ranges = {f"{axis}axis_range": ends for axis, ends in zip("xyz", box, strict=True)}
    figure.update_scenes({**ranges, "aspectmode": "manual", "aspectratio": ratio})
    return View(element_id, title, figure, alt, caption)


def _rate_figure(traces: list[Any], unit: str) -> go.Figure:
    """Return a figure of rate space with these traces, the unit of the rates at its axes."""
    figure = go.Figure(traces)
    axes = {f"{a}axis": {"title": {"text": f"ω{a} ({unit})"}, "nticks": 6} for a in "xyz"}
    figure.update_layout(
        scene=axes, scene_aspectmode="data", scene_camera_eye={"x": 1.5, "y": 1.7, "z": 1.0}
    )
    return set_page_style(figure)


def _clip_line(
    point: np.ndarray, direction: np.ndarray, box: list[tuple[float, float]]
) -> np.ndarray:
    """Return the ends (2, 3) of the part of a line within the scanned box; NaN if the line misses the box."""
    with np.errstate(divide="ignore", invalid="ignore"):
        # parameters of the line at which it meets the two planes of each axis
        crossings = (np.array(box) - point[:, None]) / direction[:, None]
    # the line enters the box at the last of the nearer planes and leaves it at the first of the farther ones
    enters, leaves = np.nanmax(crossings.min(axis=1)), np.nanmin(crossings.max(axis=1))
    if not enters < leaves:
        return np.full((2, 3), np.nan)
    return point + np.array([[enters], [leaves]]) * direction


def _point_trace(points: np.ndarray, name: str, colour: str, size: float) -> go.Scatter3d:
    """Return the plotly trace of points (n, 3) as dots."""
    marker = {"size": size, "color": colour}
    return go.Scatter3d(coordinates(points), mode="markers", name=name, marker=marker)


def line_trace(points: np.ndarray, colour: str, width: float, name: str = "") -> go.Scatter3d:
    """Return the plotly trace of a line through points (n, 3), broken where they are NaN."""
    style = {"line": {"width": width, "color": colour}, "hoverinfo": "skip"}
    return go.Scatter3d(coordinates(points), mode="lines", name=name, showlegend=False, **style)


def set_page_style(figure: go.Figure) -> go.Figure:
    """Set background and axes for a light and a dark page, and return the figure; a script sets the colour of text."""
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


def _thin(points: np.ndarray) -> np.ndarray:
    """Return every k-th point, with the smallest k that leaves at most `MOST_POINTS`."""
    return points[:: max(int(np.ceil(len(points) / MOST_POINTS)), 1)]


def coordinates(points: np.ndarray) -> dict[str, np.ndarray]:
    """Return points (..., 3) as the arguments x, y, z of a plotly trace, in single precision to keep the page small."""
    return {axis: points[..., k].astype(np.float32) for k, axis in enumerate("xyz")}
