"""The vehicle turning in space, as frames that plotly plays in the browser."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import plotly.graph_objects as go
import xarray as xr
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from sunspin.base.errors import SunspinError
from sunspin.output.figures import COLOURS
from sunspin.output.report.read import Results
from sunspin.output.report.views import GREY, INK, Motions, View, line, styled
from sunspin.output.text import capital, clock_text
from sunspin.vehicle import Vehicle

MOST_FRAMES = 300
"""Instants of a motion that are shown."""

LARGEST_TURN = 0.35
"""rad between two instants that are shown, if the data are so fine: beyond it the eye loses the sense of rotation. Motions of more
rotation than so many instants can show are shown in part."""

UNSEEN_TURN = 2.0
"""rad between instants of the data beyond which they do not tell which way the body went: such a motion is not shown."""

PLATE_M = 0.5
"""Distance of a panel's plate from the centre if the vehicle's file has no hull."""


def body_in_motion(results: Results, motions: Motions) -> Iterator[View]:
    """The vehicle turning in space, in each of the motions of the folder that its instants determine."""
    vehicle = results.vehicle
    if vehicle is None:
        return
    for k, (title, run) in enumerate(motions):
        drawn = _motion(vehicle, run)
        if drawn is None:
            continue
        about = capital(str(run.attrs.get("about", "")))
        shape = "The vehicle's file gives no shape: panels are plates of equal size."
        yield View(
            f"motion-{k}",
            title,
            drawn[0],
            "The vehicle in three dimensions as it turns; the line under it states time, angular speed and wheel speeds.",
            (f"{about}. " if about else "")
            + "Gold: direction to the Sun. Blue: angular momentum, or the first axis of rotation if the momentum is not known. "
            f"A panel is the brighter the more sunlight it gets.{'' if vehicle.hull else f' {shape}'}",
            drawn[1],
        )


def _motion(vehicle: Vehicle, run: xr.Dataset) -> tuple[go.Figure, list[dict[str, Any]]] | None:
    """The figure of a motion and its frames; None if its attitude is not known at two instants, or at none so near that a path
    could be seen between them."""
    t = np.asarray(run["time"].values, dtype=float)
    order = np.argsort(t)
    both = np.concatenate([run["B_from_N"].values, run["omega_B"].values], axis=1)[order]
    order = order[np.flatnonzero(np.isfinite(both).all(axis=1))]
    if len(order) < 2:
        return None
    t, speed = t[order], np.linalg.norm(run["omega_B"].values[order], axis=1)
    rotation = np.concatenate([[0.0], np.cumsum(np.diff(t) * (speed[1:] + speed[:-1]) / 2)])
    if np.diff(rotation).max() > UNSEEN_TURN:
        return None
    shown = np.linspace(0.0, min(rotation[-1], LARGEST_TURN * (MOST_FRAMES - 1)), MOST_FRAMES)
    frames = np.unique(np.searchsorted(rotation, shown))
    if rotation[-1] == 0:
        frames = np.array([0, len(t) - 1])
    at = order[frames]
    attitude = Rotation.from_quat(run["B_from_N"].values[at])
    sun, omega = run["sun_B"].values[at], run["omega_B"].values[at]
    known = "momentum_B" in run
    axis = run["momentum_B"].values[at[0]] if known else omega[0]
    to_scene = _scene(attitude[0], sun[0], axis) * attitude.inv()
    vertices, faces, owner, size = _shape(vehicle)
    toward_sun = sun / np.linalg.norm(sun, axis=1, keepdims=True)
    light = vehicle.response_of_panels().power(toward_sun) / vehicle.panel_gains
    wheels = np.zeros((len(at), 0))
    if "wheel_speed_rad_s" in run:
        wheels = run["wheel_speed_rad_s"].values[at].reshape(len(at), -1)
    legs = [(np.zeros(3), leg.tip_B_m, np.full(3, np.nan)) for leg in vehicle.legs]
    lines, reach = np.array(legs).reshape(-1, 3), 1.3 * size
    name = "angular momentum" if known else "axis of rotation"
    still = [
        _arrow(to_scene[0].apply(sun[0]), reach, COLOURS[4], "Sun"),
        _arrow(to_scene[0].apply(axis), reach, COLOURS[0], name),
    ]

    def moving(k: int) -> list[dict[str, Any]]:
        """What changes of the body and of its legs."""
        colours = [_light(light[k, panel]) if panel >= 0 else "#9aa2a9" for panel in owner]
        tips = to_scene[k].apply(lines) if len(lines) else lines
        body, ends = (
            {axis: each.round(6).tolist() for axis, each in zip("xyz", points.T, strict=True)}
            for points in (to_scene[k].apply(vertices), tips)
        )
        return [body | {"facecolor": colours}, ends]

    body, ends = moving(0)
    mesh = go.Mesh3d(
        body | dict(zip("ijk", faces.T, strict=True)),
        flatshading=True,
        hoverinfo="skip",
        lighting={"ambient": 0.85, "diffuse": 0.3},
    )
    figure = go.Figure([mesh, line(lines, INK, 5).update(ends), *still])
    texts = []
    for frame, speeds in zip(frames, wheels, strict=True):
        words = [_clock(run, float(t[frame])), f"{np.degrees(speed[frame]):.3g} deg/s"]
        for wheel, spin in zip(vehicle.wheels, speeds, strict=False):
            words.append(
                f"{wheel.name} {f'{spin:.0f} rad/s' if np.isfinite(spin) else 'not known'}"
            )
        texts.append(", ".join(words))
    # plain data, as plotly.js takes it: the classes of plotly check each trace and would need ten seconds
    poses = [{"name": str(k), "traces": [0, 1], "data": moving(k)} for k in range(len(frames))]
    axes = {f"{a}axis": {"range": [-reach, reach], "visible": False} for a in "xyz"}
    figure.update_layout(
        scene=axes, scene_aspectmode="cube", scene_camera_eye={"x": 0.5, "y": -1.3, "z": 0.4}
    )
    play: dict[str, Any] = {"frame": {"duration": 60, "redraw": True}, "fromcurrent": True}
    play["transition"] = {"duration": 0}
    stop = {"frame": {"duration": 0, "redraw": False}, "mode": "immediate"}
    show = {"frame": {"duration": 0, "redraw": True}, "mode": "immediate"}
    buttons = [
        {"label": "▶ Play", "method": "animate", "args": [None, play]},
        {"label": "❚❚ Pause", "method": "animate", "args": [[None], stop]},
    ]
    steps = [
        {"label": text, "method": "animate", "args": [[str(k)], show]}
        for k, text in enumerate(texts)
    ]
    corner = {"x": 0, "y": 0, "xanchor": "left", "yanchor": "top", "pad": {"t": 8}}
    menu = {"type": "buttons", "direction": "right", **corner, "buttons": buttons}
    shown_now = {
        "prefix": "",
        "font": {"size": 13, "color": GREY},
    }  # page.css sets the theme's colour
    bare = {"ticklen": 0, "minorticklen": 0, "font": {"size": 1, "color": "rgba(0,0,0,0)"}}
    slider = {"currentvalue": shown_now, "pad": {"t": 50}, **bare, "steps": steps}
    figure.update_layout(updatemenus=[menu], sliders=[slider])
    return styled(figure), poses


def _scene(attitude: Rotation, sun_B: np.ndarray, up_B: np.ndarray) -> Rotation:
    """N to the axes of the view: `up_B` up and the Sun to the right, both in body axes at the first instant."""
    up, to_sun = attitude.inv().apply(up_B), attitude.inv().apply(sun_B)
    z = up / np.linalg.norm(up) if np.linalg.norm(up) > 0 else np.array([0.0, 0.0, 1.0])
    side = to_sun - (to_sun @ z) * z
    if np.linalg.norm(side) < 1e-6:
        side = np.eye(3)[int(np.argmin(np.abs(z)))]
        side = side - (side @ z) * z
    x = side / np.linalg.norm(side)
    return Rotation.from_matrix(np.stack([x, np.cross(z, x), z]))


def _shape(vehicle: Vehicle) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Vertices (n, 3) in m, triangles (m, 3), the panel of each (-1: none), and the size in m."""
    hull = _hull(vehicle) if vehicle.hull else None
    vertices, faces, owner = hull or _plates(vehicle)
    size = float(np.linalg.norm(vertices, axis=1).max()) if len(vertices) else 1.0
    size = max([size, *(float(np.linalg.norm(leg.tip_B_m)) for leg in vehicle.legs)])
    return vertices, np.array(faces).reshape(-1, 3), np.array(owner, int), size


def _hull(vehicle: Vehicle) -> tuple[np.ndarray, list[Any], list[int]] | None:
    """The convex hull of the stated corners; None if they lie in a plane."""
    points = np.unique(np.concatenate([part.points_B_m for part in vehicle.hull]).round(9), axis=0)
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return None
    names = vehicle.panel_names
    corners = [
        (names.index(part.panel), {*map(tuple, part.points_B_m.round(9))})
        for part in vehicle.hull
        if part.panel in names
    ]
    owner = [
        next((k for k, corner in corners if {*map(tuple, points[face])} <= corner), -1)
        for face in hull.simplices
    ]
    return points, list(hull.simplices), owner


def _plates(vehicle: Vehicle) -> tuple[np.ndarray, list[Any], list[int]]:
    """A square plate for each panel."""
    vertices, faces, owner = [], [], []
    for k, normal in enumerate(vehicle.panel_normals_B):
        u = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
        u /= np.linalg.norm(u)
        v, base = np.cross(normal, u), 4 * k
        corners = ((-1, -1), (1, -1), (1, 1), (-1, 1))
        vertices += [PLATE_M * normal + 0.45 * (a * u + b * v) for a, b in corners]
        faces += [[base, base + 1, base + 2], [base, base + 2, base + 3]]
        owner += [k, k]
    return np.array(vertices).reshape(-1, 3), faces, owner


def _light(share: float) -> str:
    """The colour of a panel that gets this share of its largest signal: dark blue to yellow."""
    dark, bright = np.array([40, 60, 110]), np.array([250, 205, 60])
    red, green, blue = (dark + float(np.clip(share, 0, 1)) * (bright - dark)).astype(int)
    return f"#{red:02x}{green:02x}{blue:02x}"


def _arrow(direction: np.ndarray, length: float, colour: str, name: str) -> go.Scatter3d:
    tip = direction / max(float(np.linalg.norm(direction)), 1e-30) * length
    return go.Scatter3d(
        {axis: [0, end] for axis, end in zip("xyz", tip, strict=True)},
        mode="lines+markers+text",
        line={"width": 6, "color": colour},
        marker={"size": [0, 6], "color": colour},
        text=["", name],
        textfont={"color": colour},
        hoverinfo="skip",
        showlegend=False,
    )


def _clock(data: xr.Dataset, seconds: float) -> str:
    try:
        text = clock_text(data, seconds)
    except SunspinError:  # an epoch that is none
        return f"{seconds:.1f} s"
    return f"{text[11:19]} UTC" if text.endswith("Z") else f"{seconds:.1f} s"
