"""The vehicle in 3-D: shape from its file, motions from trajectories, as compact numbers for lander.js."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
import xarray as xr
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from sunspin.output.report.passes import dense, with_wheels
from sunspin.output.report.read import Results
from sunspin.output.report.section import Section, Special, epoch_ms, motion_order
from sunspin.output.text import capital
from sunspin.vehicle import Vehicle

MOST_INSTANTS = 12_000
"""Instants of one motion put into the page; longer ones are thinned where they turn slowly enough, else cut."""

LARGEST_TURN, TOLD_TURN = 0.7, 2.0
"""rad between instants: no instant is left out where the body turned by more, and beyond the second number a path between two
attitudes could not be told."""

PLATE_M = 0.5
"""Distance of a panel's plate from the middle where the vehicle's file has no hull."""


def section(results: Results) -> Section | None:
    """Every motion in the folder whose attitude is known."""
    vehicle = results.vehicle
    if vehicle is None:
        return None
    motions = [
        made
        for name, data in _found(results, vehicle)
        if (made := motion(vehicle, name, data)) is not None
    ]
    if not motions:
        return None
    drawn = bool(vehicle.hull)
    about = (
        "Its shape is the one in the vehicle's file, simplified."
        if drawn
        else "The vehicle's file gives no shape: panels are drawn as plates of equal size."
    )
    lead = [
        (
            "Fixed in space: the line to the Sun (gold) and the total angular momentum (blue arrow), about which the body swings "
            "and turns. "
            if any(m["momentum"] for m in motions)
            else "Fixed in space: the line to the Sun (gold). "
        )
        + f"Panels are coloured by the power that the Sun would give them, dark violet to yellow. {about}"
    ]
    silent = results.summary.get("panels_left_out")
    silent = silent if isinstance(silent, list) else []
    panels = [f"{name}: left out" if name in silent else name for name in vehicle.panel_names]
    content = {
        "motions": [{"name": m["name"], "about": m["about"]} for m in motions],
        "measured": "pass_of" in next(iter(results.having("B_from_N")))[1],
        "panels": panels,
        "wheels": [w.name for w in vehicle.wheels],
        "events": motions[0]["events"],
        "simulated": True,
        "synthetic": results.synthetic,
    }
    data = {
        "shape": shape(vehicle),
        "motions": motions,
        "panels": list(vehicle.panel_names),
        "wheels": [w.name for w in vehicle.wheels],
    }
    return Section(
        "lander", f"{capital(vehicle.name)} in motion", lead, [Special("lander", content, data)]
    )


def _found(results: Results, vehicle: Vehicle) -> list[tuple[str, xr.Dataset]]:
    found, telemetry = [], results.data.get("telemetry")
    for name, data in results.having("B_from_N", "sun_B", "omega_B"):
        doing = str(data.attrs.get("wheels", ""))
        passes = (
            [(title, with_wheels(run, vehicle, telemetry, doing)) for title, run in dense(data)]
            if "pass_of" in data
            else []
        )
        found += passes if "pass_of" in data else [(str(data.attrs.get("title", name)), data)]
    return sorted(found, key=lambda item: motion_order(item[0]))


def motion(vehicle: Vehicle, name: str, data: xr.Dataset) -> dict[str, Any] | None:
    """One motion as base64 of float32 arrays, on even times; None where attitudes are too far apart to be joined."""
    chosen = _even(data)
    if chosen is None:
        return None
    t, attitude, omega, sun, momentum, wheels = chosen
    scene = _scene(attitude, sun, momentum, omega)
    to_scene = scene * attitude.inv()  # B to the scene's axes
    power = (
        vehicle.panels_in().power(sun / np.linalg.norm(sun, axis=1, keepdims=True))
        / vehicle.panel_gains
    )
    zero = epoch_ms(str(data.attrs.get("epoch_utc") or "")) if "epoch_utc" in data.attrs else None
    events = _events(data)
    return {
        "name": name,
        "about": str(data.attrs.get("about", "")),
        "t0": float(t[0]),
        "dt": float(t[1] - t[0]),
        "n": len(t),
        "epoch": zero,
        "q": _b64(to_scene.as_quat()),
        "omega": _b64(np.linalg.norm(omega, axis=1)),
        "momentum": None if momentum is None else _b64(to_scene.apply(momentum)),
        "momentum_max": 0.0 if momentum is None else float(np.linalg.norm(momentum, axis=1).max()),
        "wheel": [_b64(w) for w in wheels.T],
        "wheel_max": [float(np.nan_to_num(np.abs(w)).max()) for w in wheels.T],
        "sun": to_scene.apply(sun)[0].tolist(),
        "power": base64.b64encode(
            np.round(255 * np.clip(power, 0, 1)).astype("u1").tobytes()
        ).decode("ascii"),
        "events": events,
    }


def _b64(values: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")


def _even(data: xr.Dataset) -> tuple | None:
    """Times, attitudes (B from N) and the rest on an even grid; forward in time."""
    t = np.asarray(data["time"].values, dtype=np.float64)
    if t.size < 2:
        return None
    order = np.argsort(t)
    t = t[order]
    step = float(np.median(np.diff(t)))
    names = ["B_from_N", "omega_B", "sun_B"] + (["momentum_B"] if "momentum_B" in data else [])
    columns = {name: np.asarray(data[name].values[order], dtype=np.float64) for name in names}
    wheels = (
        np.asarray(data["wheel_speed_rad_s"].values[order], dtype=np.float64)
        if "wheel_speed_rad_s" in data
        else np.zeros((t.size, 0))
    )
    if wheels.ndim == 1:
        wheels = wheels[:, None]
    good = np.all([np.isfinite(c).all(axis=1) for c in columns.values()], axis=0)
    last = t.size if good.all() else int(np.argmin(good))
    even = np.abs(np.diff(t) - step).max() <= 1e-3 * step
    turn = step * np.linalg.norm(columns["omega_B"], axis=1).max()
    if last < 2 or not even or turn > TOLD_TURN:
        return None
    stride = max(1, min(int(LARGEST_TURN // max(turn, 1e-9)), -(-last // MOST_INSTANTS)))
    keep = np.arange(0, last, stride)[:MOST_INSTANTS]
    q = columns["B_from_N"][keep]
    return (
        t[keep],
        Rotation.from_quat(q),
        columns["omega_B"][keep],
        columns["sun_B"][keep],
        columns["momentum_B"][keep] if "momentum_B" in columns else None,
        wheels[keep],
    )


def _scene(
    attitude: Rotation, sun: np.ndarray, momentum: np.ndarray | None, omega: np.ndarray
) -> Rotation:
    """N to the scene's axes: momentum (or the first axis of rotation) up, the Sun to the right."""
    first = attitude[0].inv()
    up = first.apply(momentum[0] if momentum is not None else omega[0])
    to_sun = first.apply(sun[0])
    if np.linalg.norm(up) < 1e-9 * max(1.0, np.linalg.norm(to_sun)):
        up = np.array([0.0, 0.0, 1.0])
    z = up / np.linalg.norm(up)
    side = to_sun - (to_sun @ z) * z
    if np.linalg.norm(side) < 1e-6:
        side = np.eye(3)[int(np.argmin(np.abs(z)))]
        side = side - (side @ z) * z
    x = side / np.linalg.norm(side)
    return Rotation.from_matrix(np.stack([x, np.cross(z, x), z]))


def _events(data: xr.Dataset) -> list[dict[str, Any]]:
    times = np.asarray(data["time"].values, dtype=float)
    found = [{"t": float(times.min()), "what": "begin"}]
    if "event_time_s" in data:
        what = data["event_what"].values.astype(str)
        who = data["event_wheel"].values.astype(str) if "event_wheel" in data else None
        for k, at in enumerate(np.atleast_1d(data["event_time_s"].values)[:20]):
            found.append(
                {"t": float(at), "what": what[k] if who is None else f"{who[k]} {what[k]}"}
            )
    return [*found, {"t": float(times.max()), "what": "end"}]


def shape(vehicle: Vehicle) -> dict[str, Any]:
    """Vertices (m, body axes), triangles with the panel each belongs to (-1: none), and lines for legs."""
    if vehicle.hull:
        vertices, faces, owner = _hull(vehicle)
    else:
        vertices, faces, owner = _plates(vehicle)
    size = float(np.linalg.norm(vertices, axis=1).max()) if len(vertices) else 1.0
    legs = []
    low = vertices[:, 2].min() if len(vertices) else 0.0
    for leg in vehicle.legs:
        foot = leg.tip_B_m
        hip = np.array(
            [
                0.35 * foot[0] / max(np.linalg.norm(foot[:2]), 1e-9),
                0.35 * foot[1] / max(np.linalg.norm(foot[:2]), 1e-9),
                low,
            ]
        )
        legs.append([hip.tolist(), foot.tolist()])
        size = max(size, float(np.linalg.norm(foot)))
    return {
        "vertices": vertices.tolist(),
        "faces": faces,
        "owner": owner,
        "legs": legs,
        "size": size,
        "wheel_axes": [w.axis_B.tolist() for w in vehicle.wheels],
    }


def _hull(vehicle: Vehicle) -> tuple[np.ndarray, list[list[int]], list[int]]:
    points = np.unique(np.concatenate([part.points_B_m for part in vehicle.hull]).round(9), axis=0)
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return _plates(vehicle)
    corners = [
        (list(vehicle.panel_names).index(part.panel), {tuple(p) for p in part.points_B_m.round(9)})
        for part in vehicle.hull
        if part.panel in vehicle.panel_names
    ]
    faces, owner = [], []
    for simplex, normal in zip(hull.simplices, hull.equations[:, :3], strict=True):
        a, b, c = points[simplex]
        turned = simplex if np.cross(b - a, c - a) @ normal > 0 else simplex[::-1]
        mine = {tuple(p) for p in points[simplex]}
        faces.append([int(i) for i in turned])
        owner.append(next((k for k, corner in corners if mine <= corner), -1))
    return points, faces, owner


def _plates(vehicle: Vehicle) -> tuple[np.ndarray, list[list[int]], list[int]]:
    vertices, faces, owner = [], [], []
    for k, normal in enumerate(vehicle.panel_normals_B):
        side = np.eye(3)[int(np.argmin(np.abs(normal)))]
        u = np.cross(normal, side)
        u /= np.linalg.norm(u)
        v = np.cross(normal, u)
        base = len(vertices)
        vertices += [
            PLATE_M * normal + 0.45 * (a * u + b * v)
            for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
        ]
        faces += [[base, base + 1, base + 2], [base, base + 2, base + 3]]
        owner += [k, k]
    return np.array(vertices).reshape(-1, 3), faces, owner
