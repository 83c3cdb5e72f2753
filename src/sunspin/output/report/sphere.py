"""The Sun's path on the body's sphere."""

from __future__ import annotations

from typing import Any

import numpy as np

from sunspin.output.kinds.kind import synthetic_words
from sunspin.output.report.measured import MOST_SAMPLES, PHASES
from sunspin.output.report.read import Results
from sunspin.output.report.section import (
    COLOURS,
    SYMBOLS,
    Plot,
    Section,
    Table,
    camera,
    motion_order,
    packed,
    thin,
)
from sunspin.output.text import capital
from sunspin.telemetry.sun import is_reconstructed


def sun_path(results: Results) -> Section | None:
    """Measured directions on the unit sphere in body axes, and the candidates' paths."""
    sun = results.first("sun_B", "status")
    data = [*_sphere()]
    base, views, numbers = len(data), [], []
    shown: list[int] = list(range(base))
    if sun is not None:
        told = is_reconstructed(sun["status"].values)
        phase = (
            sun["phase"].values.astype(str)
            if "phase" in sun.coords
            else np.full(told.size, "all samples")
        )
        for k, name in enumerate(dict.fromkeys(phase[told])):
            at = np.flatnonzero(told & (phase == name))
            at = at[thin(at.size, MOST_SAMPLES)]
            shown.append(len(data))
            label = PHASES.get(str(name), str(name))
            data.append(_points(sun["sun_B"].values[at], label, COLOURS[k % 7], SYMBOLS[k % 7]))
            z = sun["sun_B"].values[at, 2]
            numbers.append(
                [label, str(at.size), f"{z.min():.2f} to {z.max():.2f}", f"{z.mean():.2f}"]
            )
    for k, (title, path, note) in enumerate(_paths(results)):
        data.append(
            {
                "type": "scatter3d",
                "mode": "lines",
                "x": packed(path[:, 0] * 1.004),
                "y": packed(path[:, 1] * 1.004),
                "z": packed(path[:, 2] * 1.004),
                "line": {"width": 2.5, "color": "@ink"},
                "name": f"path: {title}",
                "visible": k == 0,
                "hoverinfo": "name",
            }
        )
        views.append({"label": title, "show": [*shown, len(data) - 1], "text": note})
        if not numbers or sun is None:
            numbers.append(
                [
                    title,
                    str(len(path)),
                    f"{path[:, 2].min():.2f} to {path[:, 2].max():.2f}",
                    f"{path[:, 2].mean():.2f}",
                ]
            )
    if len(data) == base:
        return None
    plates = _normals(results)
    for view in views:
        view["show"] = [*view["show"], *range(len(data), len(data) + len(plates))]
    data += plates
    limits = {"range": [-1.25, 1.25], "showspikes": False, "nticks": 5}
    layout = {
        "scene": {
            **{
                f"{axis}axis": {**limits, "title": {"text": f"{axis} component, body"}}
                for axis in "xyz"
            },
            "aspectmode": "cube",
            "camera": camera(1.35, -1.4, 0.9),
        },
        "legend": {"orientation": "h", "y": 0, "yanchor": "top"},
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
    }
    plot = Plot(
        "sphere",
        data,
        layout,
        "A sphere in body axes. Each dot is the direction in which the panels say that the Sun stood; a line is its path in one "
        "motion; labels stand where a panel looks straight at the Sun.",
        "Where the Sun stood as seen from the body. Drag, or use the arrow keys, to turn; + and − to zoom. Directions are unit "
        "vectors without unit." + synthetic_words(results.synthetic and sun is not None),
        560,
        views,
        "Path of",
        narrow={"scene.camera.eye": {"x": 2.0, "y": -2.05, "z": 1.3}, "font.size": 11},
        numbers=Table(
            ["phase", "directions", "range of z", "mean of z"], numbers, "In numbers", closed=True
        ),
    )
    return Section("sun-path", "The Sun's path on the body's sphere", [], [plot])


def _points(sun: np.ndarray, label: str, colour: str, symbol: str) -> dict[str, Any]:
    return {
        "type": "scatter3d",
        "mode": "markers",
        "x": packed(sun[:, 0]),
        "y": packed(sun[:, 1]),
        "z": packed(sun[:, 2]),
        "name": label,
        "marker": {"size": 5, "color": colour, "symbol": symbol},
        "hovertemplate": "x %{x:.3f}<br>y %{y:.3f}<br>z %{z:.3f}",
    }


def _sphere() -> list[dict[str, Any]]:
    """Parallels and meridians of the unit sphere, as one line with gaps, and a pale ball inside."""
    turn = np.linspace(0, 2 * np.pi, 73)
    rings = []
    for height in np.sin(np.radians([-60, -30, 0, 30, 60])):
        flat = np.sqrt(1 - height**2)
        rings.append(
            np.stack([flat * np.cos(turn), flat * np.sin(turn), np.full(turn.size, height)], axis=1)
        )
    for azimuth in np.radians(np.arange(0, 180, 30)):
        rings.append(
            np.stack(
                [np.cos(azimuth) * np.cos(turn), np.sin(azimuth) * np.cos(turn), np.sin(turn)],
                axis=1,
            )
        )
    gap = np.full((1, 3), np.nan)
    lines = np.concatenate([part for ring in rings for part in (ring, gap)])
    v, u = np.meshgrid(np.linspace(0, np.pi, 19), np.linspace(0, 2 * np.pi, 37), indexing="ij")
    ball = 0.985 * np.stack([np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)])
    flat = {"showscale": False, "hoverinfo": "skip", "showlegend": False}
    return [
        {
            "type": "surface",
            "x": packed(ball[0]),
            "y": packed(ball[1]),
            "z": packed(ball[2]),
            "opacity": 1.0,
            "surfacecolor": packed(np.zeros_like(ball[0])),
            "colorscale": [[0, "@ball"], [1, "@ball"]],
            "lighting": {"ambient": 0.95, "diffuse": 0.1, "specular": 0.0},
            "contours": {k: {"highlight": False} for k in "xyz"},
            **flat,
        },
        {
            "type": "scatter3d",
            "mode": "lines",
            "x": packed(lines[:, 0]),
            "y": packed(lines[:, 1]),
            "z": packed(lines[:, 2]),
            "line": {"width": 1, "color": "@muted"},
            "connectgaps": False,
            "hoverinfo": "skip",
            "showlegend": False,
        },
    ]


def _normals(results: Results) -> list[dict[str, Any]]:
    if results.vehicle is None or not results.vehicle.panels:
        return []
    face, of_face = np.unique(
        np.round(results.vehicle.panel_normals_B, 6) + 0.0, axis=0, return_inverse=True
    )
    names = [
        ", ".join(np.array(results.vehicle.panel_names)[of_face.ravel() == k])
        for k in range(len(face))
    ]
    normal = 1.12 * face
    return [
        {
            "type": "scatter3d",
            "mode": "text",
            "x": packed(normal[:, 0]),
            "y": packed(normal[:, 1]),
            "z": packed(normal[:, 2]),
            "text": names,
            "textfont": {"size": 13, "color": "@ink"},
            "showlegend": False,
            "hovertext": [f"panel {name}" for name in names],
            "hoverinfo": "text",
        }
    ]


PATH_S = 300.0
"""A candidate's path is drawn for so long; longer ones cover the sphere."""


def _paths(results: Results) -> list[tuple[str, np.ndarray, str]]:
    found = []
    for name, data in sorted(results.having("sun_B", "momentum_B", "B_from_N")):
        t = data["time"].values
        at = np.flatnonzero(np.abs(t - t[0]) <= PATH_S)
        at = at[thin(at.size, 1500)]
        title = str(data.attrs.get("title", name))
        note = f"The first {abs(t[at[-1]] - t[0]) / 60:.3g} min. {capital(str(data.attrs.get('about', '')))}"
        found.append((title, data["sun_B"].values[at], note))
    return sorted(found, key=lambda item: motion_order(item[0]))
