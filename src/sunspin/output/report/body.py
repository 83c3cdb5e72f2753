"""The rotating vehicle in three dimensions, as an animation that plotly plays in the browser."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go
import xarray as xr
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from sunspin.base.errors import SunspinError
from sunspin.output.figures import COLOURS
from sunspin.output.report.read import Results
from sunspin.output.report.views import GREY, INK, Motions, View, line_trace, set_page_style
from sunspin.output.text import capitalize_first, clock_text
from sunspin.vehicle import Vehicle

MOST_FRAMES = 300
"""Number of frames of an animation."""

LARGEST_ROTATION_RAD = 0.35
"""Rotation between two frames, if the data are dense enough; with more, the eye loses the sense of rotation. The animation ends
when `MOST_FRAMES` are used."""

UNCLEAR_ROTATION_RAD = 2.0
"""Rotation between instants of the data from which the path in between is ambiguous; such a motion is not shown."""

PLATE_DISTANCE_M = 0.5
"""Distance (m) of a panel's plate from the centre, for a vehicle file without hull."""

PLATE_HALF_EDGE_M = 0.45
"""Half the edge (m) of such a plate; plates of a cube leave gaps between them."""


class Mesh(NamedTuple):
    """The body as triangles.

    `vertices` (n, 3): in body axes, m; `faces` (m, 3): indices of the vertices of each triangle; `owner` (m): index of the panel of
    each triangle, -1 for none; `size`: distance of the farthest vertex or leg tip from the origin, m.
    """

    vertices: np.ndarray
    faces: np.ndarray
    owner: np.ndarray
    size: float


def body_in_motion(results: Results, motions: Motions) -> Iterator[View]:
    """Yield a view of the rotating vehicle for each motion whose instants are close enough to show it."""
    vehicle = results.vehicle
    if vehicle is None:
        return
    for k, (title, motion) in enumerate(motions):
        animation = _animate(vehicle, motion)
        if animation is None:
            continue
        figure, frames = animation
        about = capitalize_first(str(motion.attrs.get("about", "")))
        no_hull = " The vehicle's file gives no shape: panels are plates of equal size."
        yield View(
            f"motion-{k}",
            title,
            figure,
            "The vehicle in three dimensions as it rotates; the line under it states time, angular speed and wheel speeds.",
            (f"{about}. " if about else "")
            + "Gold: direction to the Sun. Blue: angular momentum, or the first axis of rotation if the momentum is not known. "
            f"A panel is the brighter the more sunlight it gets.{'' if vehicle.hull else no_hull}",
            frames,
        )


def _animate(vehicle: Vehicle, motion: xr.Dataset) -> tuple[go.Figure, list[dict[str, Any]]] | None:
    """Return the figure of a motion and the frames of its animation as plain data for plotly.js.

    None if the attitude is known at fewer than two instants, or at instants too far apart to see the path in between.
    """
    instants = _choose_instants(motion)
    if instants is None:
        return None
    attitude = Rotation.from_quat(motion["B_from_N"].values[instants])
    sun, omega = motion["sun_B"].values[instants], motion["omega_B"].values[instants]
    has_momentum = "momentum_B" in motion
    up = motion["momentum_B"].values[instants[0]] if has_momentum else omega[0]
    # rotations from body axes to those of the scene, one for each frame
    to_scene = _inertial_to_scene(attitude[0], sun[0], up) * attitude.inv()
    shape = _shape(vehicle)
    toward_sun = sun / np.linalg.norm(sun, axis=1, keepdims=True)
    # signal of each panel (frame, panel) as a fraction of its largest one
    light = vehicle.response_of_panels().power(toward_sun) / vehicle.panel_gains
    # each leg is a line from the origin to its tip, and a NaN ends the line
    legs = [(np.zeros(3), leg.tip_B_m, np.full(3, np.nan)) for leg in vehicle.legs]
    leg_lines, reach = (
        np.array(legs).reshape(-1, 3),
        1.3 * shape.size,
    )  # half the width of the scene
    poses = [_pose(shape, leg_lines, to_scene[k], light[k]) for k in range(len(instants))]
    body, leg_ends = poses[0]
    mesh = go.Mesh3d(
        body | dict(zip("ijk", shape.faces.T, strict=True)),
        flatshading=True,
        hoverinfo="skip",
        lighting={"ambient": 0.85, "diffuse": 0.3},
    )
    up_name = "angular momentum" if has_momentum else "axis of rotation"
    figure = go.Figure(
        [
            mesh,
            line_trace(leg_lines, INK, 5).update(leg_ends),
            # the Sun is to the right of the axis, in the scene and on the screen: names to both sides never overlap
            _arrow(to_scene[0].apply(sun[0]), reach, COLOURS[4], "Sun", "middle right"),
            _arrow(to_scene[0].apply(up), reach, COLOURS[0], up_name, "middle left"),
        ]
    )
    axes = {f"{axis}axis": {"range": [-reach, reach], "visible": False} for axis in "xyz"}
    figure.update_layout(
        scene=axes, scene_aspectmode="cube", scene_camera_eye={"x": 0.5, "y": -1.3, "z": 0.4}
    )
    figure.update_layout(_controls(_frame_texts(vehicle, motion, instants)))
    # plain data for plotly.js: plotly's classes would check each trace and take ten seconds
    frames = [{"name": str(k), "traces": [0, 1], "data": pose} for k, pose in enumerate(poses)]
    return set_page_style(figure), frames


def _choose_instants(motion: xr.Dataset) -> np.ndarray | None:
    """Return the indices of the times of a motion that are frames of its animation, evenly spaced in rotation, not in time.

    None as for :func:`_animate`. A motion that rotates too much for `MOST_FRAMES` ends early; one at rest has its first and last
    instant.
    """
    t = np.asarray(motion["time"].values, dtype=float)
    by_time = np.argsort(t)
    states = np.concatenate([motion["B_from_N"].values, motion["omega_B"].values], axis=1)[by_time]
    known = by_time[np.flatnonzero(np.isfinite(states).all(axis=1))]
    if len(known) < 2:
        return None
    speed = np.linalg.norm(motion["omega_B"].values[known], axis=1)
    # rotation (rad) since the first instant, by the trapezoidal rule
    rotation = np.concatenate([[0.0], np.cumsum(np.diff(t[known]) * (speed[1:] + speed[:-1]) / 2)])
    if np.diff(rotation).max() > UNCLEAR_ROTATION_RAD:
        return None
    if rotation[-1] == 0:
        return known[[0, -1]]
    end = min(rotation[-1], LARGEST_ROTATION_RAD * (MOST_FRAMES - 1))
    return known[np.unique(np.searchsorted(rotation, np.linspace(0.0, end, MOST_FRAMES)))]


def _pose(
    shape: Mesh, leg_lines: np.ndarray, to_scene: Rotation, light: np.ndarray
) -> list[dict[str, Any]]:
    """Return the coordinates of body and legs in one frame, and the colours of the body's triangles.

    `leg_lines` (n, 3): points of the legs in body axes; `light` (panel): signal of each panel as a fraction of its largest.
    """
    colours = [_panel_colour(light[panel]) if panel >= 0 else "#9aa2a9" for panel in shape.owner]
    leg_points = to_scene.apply(leg_lines) if len(leg_lines) else leg_lines
    body, legs = (
        {axis: values.round(6).tolist() for axis, values in zip("xyz", points.T, strict=True)}
        for points in (to_scene.apply(shape.vertices), leg_points)
    )
    return [body | {"facecolor": colours}, legs]


def _frame_texts(vehicle: Vehicle, motion: xr.Dataset, instants: np.ndarray) -> list[str]:
    """Return for each frame its time, the angular speed and the wheel speeds, in words; `instants`: indices of its times."""
    t, speed = motion["time"].values, np.linalg.norm(motion["omega_B"].values, axis=1)
    wheel_speeds = np.zeros((len(t), 0))
    if "wheel_speed_rad_s" in motion:
        wheel_speeds = motion["wheel_speed_rad_s"].values.reshape(len(t), -1)
    texts = []
    for k in instants:
        words = [_time_text(motion, float(t[k])), f"{np.degrees(speed[k]):.3g} deg/s"]
        for wheel, wheel_speed in zip(vehicle.wheels, wheel_speeds[k], strict=False):
            known = np.isfinite(wheel_speed)
            words.append(f"{wheel.name} {f'{wheel_speed:.0f} rad/s' if known else 'not known'}")
        texts.append(", ".join(words))
    return texts


def _controls(texts: list[str]) -> dict[str, Any]:
    """Return the parts of plotly's layout that play an animation: two buttons, and a slider with a text for each frame."""
    play: dict[str, Any] = {"frame": {"duration": 60, "redraw": True}, "fromcurrent": True}
    play["transition"] = {"duration": 0}
    stop = {"frame": {"duration": 0, "redraw": False}, "mode": "immediate"}
    show = {"frame": {"duration": 0, "redraw": True}, "mode": "immediate"}
    # plotly's convention: None plays all frames, [None] stops, [name] shows one frame
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
    # page.css replaces the colour by that of the theme
    current_text = {"prefix": "", "font": {"size": 13, "color": GREY}}
    # no ticks and labels along the slider
    bare = {"ticklen": 0, "minorticklen": 0, "font": {"size": 1, "color": "rgba(0,0,0,0)"}}
    slider = {"currentvalue": current_text, "pad": {"t": 50}, **bare, "steps": steps}
    return {"updatemenus": [menu], "sliders": [slider]}


def _inertial_to_scene(attitude: Rotation, sun_B: np.ndarray, up_B: np.ndarray) -> Rotation:
    """Return the rotation from N to the axes of the scene: z along `up_B`, the Sun in the x-z plane on the side of +x.

    `attitude` is B_from_N at the first instant; `sun_B` and `up_B` are in body axes at that instant.
    """
    up, to_sun = attitude.inv().apply(up_B), attitude.inv().apply(sun_B)
    z = up / np.linalg.norm(up) if np.linalg.norm(up) > 0 else np.array([0.0, 0.0, 1.0])
    side = to_sun - (to_sun @ z) * z
    if np.linalg.norm(side) < 1e-6:  # the Sun is along z: any x axis will do
        side = np.eye(3)[int(np.argmin(np.abs(z)))]
        side = side - (side @ z) * z
    x = side / np.linalg.norm(side)
    return Rotation.from_matrix(np.stack([x, np.cross(z, x), z]))


def _shape(vehicle: Vehicle) -> Mesh:
    """Return the shape of the vehicle: its hull, or plates for its panels if it has none."""
    hull = _hull(vehicle) if vehicle.hull else None
    vertices, faces, owner = hull or _plates(vehicle)
    size = float(np.linalg.norm(vertices, axis=1).max()) if len(vertices) else 1.0
    size = max([size, *(float(np.linalg.norm(leg.tip_B_m)) for leg in vehicle.legs)])
    return Mesh(vertices, np.array(faces).reshape(-1, 3), np.array(owner, int), size)


def _hull(vehicle: Vehicle) -> tuple[np.ndarray, list[Any], list[int]] | None:
    """Return the convex hull of the corners in the vehicle file as in `Mesh`, without size; None if they lie in a plane."""
    points = np.unique(np.concatenate([part.points_B_m for part in vehicle.hull]).round(9), axis=0)
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return None
    # a triangle belongs to a panel if all its corners are corners of the part of that panel
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
    """Return vertices, faces and owner as in `Mesh`: a square plate of two triangles for each panel."""
    vertices, faces, owner = [], [], []
    for k, normal in enumerate(vehicle.panel_normals_B):
        # unit vectors along the edges; the first is across the axis that is farthest from the normal
        u = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
        u /= np.linalg.norm(u)
        v = np.cross(normal, u)
        corners = ((-1, -1), (1, -1), (1, 1), (-1, 1))
        vertices += [
            PLATE_DISTANCE_M * normal + PLATE_HALF_EDGE_M * (a * u + b * v) for a, b in corners
        ]
        first = 4 * k  # index of the plate's first vertex
        faces += [[first, first + 1, first + 2], [first, first + 2, first + 3]]
        owner += [k, k]
    return np.array(vertices).reshape(-1, 3), faces, owner


def _panel_colour(share: float) -> str:
    """Return the colour of a panel at this fraction of its largest signal, from dark blue to yellow."""
    dark, bright = np.array([40, 60, 110]), np.array([250, 205, 60])
    red, green, blue = (dark + float(np.clip(share, 0, 1)) * (bright - dark)).astype(int)
    return f"#{red:02x}{green:02x}{blue:02x}"


def _arrow(direction: np.ndarray, length: float, colour: str, name: str, side: str) -> go.Scatter3d:
    """Return an arrow from the origin with its name on one side of the tip (`side`); a zero direction gives a point."""
    tip = direction / max(float(np.linalg.norm(direction)), 1e-30) * length
    return go.Scatter3d(
        {axis: [0, end] for axis, end in zip("xyz", tip, strict=True)},
        mode="lines+markers+text",
        line={"width": 6, "color": colour},
        marker={"size": [0, 6], "color": colour},
        text=["", name],
        textposition=side,
        textfont={"color": colour},
        hoverinfo="skip",
        showlegend=False,
    )


def _time_text(data: xr.Dataset, seconds: float) -> str:
    """Return a time (s from the epoch) as UTC of the day, or in s if the epoch is missing or invalid."""
    try:
        text = clock_text(data, seconds)
    except SunspinError:
        return f"{seconds:.1f} s"
    return f"{text[11:19]} UTC" if text.endswith("Z") else f"{seconds:.1f} s"
