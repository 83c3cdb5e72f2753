"""Rate space: near-minimum sets and their lines in 3-D, maps of EMD and of E."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from sunspin.dynamics.gyrostat import total_momentum
from sunspin.output.figures.scan import map_figure
from sunspin.output.kinds.kind import Drawing, synthetic_words
from sunspin.output.kinds.scan import DIMS, chosen
from sunspin.output.report.drawn import item
from sunspin.output.report.read import Results
from sunspin.output.report.section import (
    COLOURS,
    SYMBOLS,
    Drawn,
    Plot,
    Section,
    Special,
    Table,
    camera,
    packed,
    thin,
)
from sunspin.output.text import counted, number_text

PRINTED = "scan_published_lines"
"""The scan against the distribution of the lines that the paper prints: no telemetry enters, so it stands last."""

MEASURED = "scan_telemetry"

MOST_POINTS = 6000
STEPS = 255
"""Values of a volume are drawn in so many steps of their logarithm."""

LEAST = 1e-6
"""Smaller misfits are drawn as this: the colours go with the logarithm."""

MOST_CELLS = 3_000_000
"""Cells of a volume put into the page; larger ones are thinned evenly."""


def _volumes(results: Results) -> list[tuple[str, xr.Dataset, xr.DataArray]]:
    found = []
    for metric in ("emd", "E"):
        for name, data in results.having(metric, *DIMS):
            if set(data[metric].dims) == set(DIMS):
                found.append((name, data, data[metric].transpose(*DIMS)))
    return sorted(found, key=lambda item: item[0] == PRINTED)


def lines(results: Results) -> Section | None:
    """Points of every scan's near-minimum set, what else fits, fitted and published lines."""
    data, views, tables = [], [], []
    for name, scan, volume in _volumes(results):
        first = len(data)
        points, by = chosen(scan)
        if not len(points):
            continue
        fits, told = _candidates(results) if name == MEASURED else ([], "")
        if name == MEASURED and not _all_found(results, scan):
            scan = scan.drop_vars(FITTED, errors="ignore")
        data += [
            *fits,
            *_cloud(scan, points),
            *_line_traces(scan),
            *_marks(results, scan),
            _box(scan),
        ]
        least = f"the smallest, {float(np.nanmin(volume)):.4f}"
        near = (
            f"{by['threshold']:g} ({least})"
            if "threshold" in by
            else f"{by.get('factor', np.nan):g} times {least}"
        )
        text = f"{counted(len(points), 'motion')} with {str(volume.name).replace('emd', 'EMD')} below {near}."
        views.append(
            {
                "label": _label(name, scan),
                "show": list(range(first, len(data))),
                "text": " ".join(part for part in (text, told, _said(results, name)) if part),
            }
        )
        tables += _line_table(scan, _label(name, scan))
    if not data:
        return None
    for k, trace in enumerate(data):
        trace["visible"] = k in views[0]["show"]
    axis = {"showspikes": False, "nticks": 6}
    layout = {
        "scene": {
            **{f"{d[-1]}axis": {**axis, "title": {"text": f"ω{d[-1]} (rad/s)"}} for d in DIMS},
            "aspectmode": "data",
            "camera": camera(1.4, 1.85, 0.85),
        },
        "legend": {"orientation": "h", "y": 0, "yanchor": "top"},
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
    }
    lead = ["Each dot is a motion: the three components of its body rate at the first sample."]
    metrics = {str(volume.name) for _, _, volume in _volumes(results)}
    if "emd" in metrics:
        lead[0] += (
            " Those shown make the Sun stand at each height nearly as often as the target has it there. A distribution of heights "
            "says nothing about timing: a body that turns through the same angles, only faster, fits as well."
        )
    if "E" in metrics:
        lead[0] += (
            " Those chosen by E have the Sun nearly where the panels saw it, sample by sample."
        )
    if results.why_nothing:
        lead.append(
            "No motion is concluded from this telemetry. What is shown is only what the scans gave; the first lines of this page "
            "say why."
        )
    plot = Plot(
        "lines",
        data,
        layout,
        "A cloud of points in the space of the three components of the initial body rate: the motions of the chosen scan whose "
        "misfit is near its smallest. The text below says how many they are.",
        "Drag, or use the arrow keys, to turn; + and − to zoom. Rates in rad/s, body axes."
        + (" Synthetic telemetry." if results.synthetic else ""),
        600,
        views,
        "Target",
        narrow={"scene.camera.eye": {"x": 2.3, "y": 3.0, "z": 1.4}, "font.size": 11},
    )
    title = (
        "The scan of this telemetry, in rate space"
        if results.why_nothing
        else "Motions that fit, in rate space"
    )
    return Section("rate-space", title, lead, [plot, *tables])


def _label(name: str, scan: xr.Dataset) -> str:
    """A scan in the words of its file; the one of the printed lines as what it is."""
    if "about" not in scan.attrs:
        return name
    return (
        f"No telemetry: scan {scan.attrs['about']}"
        if name == PRINTED
        else f"Scan {scan.attrs['about']}"
    )


def _said(results: Results, name: str) -> str:
    """What a study says of the lines in a scan's set."""
    if name == PRINTED:
        return "No telemetry enters: this is what the paper's own lines and the equations give."
    row = results.row("lines_found") if name == MEASURED else None
    if (
        row is None
        or not isinstance(row.get("ours"), int | float)
        or not isinstance(row.get("published"), int | float)
    ):
        return ""
    return f"Of the {row['published']:g} lines that the paper prints (dashed) {row['ours']:g} come out of them."


FITTED = ("point", "direction", "mean_distance", "count", "member")
"""Variables of the lines fitted to a set."""


def _all_found(results: Results, scan: xr.Dataset) -> bool:
    """Whether the lines fitted to the telemetry's set are all printed ones: a fit of four finds four in any set of points."""
    row = results.row("lines_found")
    return (
        row is not None
        and "published_point" in scan
        and row.get("ours") == row.get("published") == len(scan["published_point"])
    )


def _candidates(results: Results) -> tuple[list[dict[str, Any]], str]:
    """All that fits, as a pale cloud, and what it is; nothing where the telemetry carries no conclusion."""
    found = results.data.get("candidates")
    if (
        results.why_nothing
        or found is None
        or "omega_B" not in found
        or found["omega_B"].dims != ("candidate", "axis")
    ):
        return [], ""
    results.used.add("candidates")
    about = str(found.attrs.get("about", "the candidates"))
    at = found["omega_B"].values[thin(found.sizes["candidate"], MOST_POINTS)]
    cloud = {
        "type": "scatter3d",
        "mode": "markers",
        "x": packed(at[:, 0]),
        "y": packed(at[:, 1]),
        "z": packed(at[:, 2]),
        "marker": {"size": 2, "color": "@grey", "opacity": 0.25},
        "name": "candidates",
        "hoverinfo": "skip",
    }
    return [
        cloud
    ], f"Pale: {len(at)} of the motions from which all else on this page follows, {about}."


def _cloud(scan: xr.Dataset, points: np.ndarray) -> list[dict[str, Any]]:
    member = (
        scan["member"].values
        if "member" in scan and scan["member"].size == len(points)
        else np.zeros(len(points), int)
    )
    found = []
    for k in np.unique(member):
        part = points[member == k]
        part = part[thin(len(part), MOST_POINTS)]
        many = np.unique(member).size > 1
        found.append(
            {
                "type": "scatter3d",
                "mode": "markers",
                "x": packed(part[:, 0]),
                "y": packed(part[:, 1]),
                "z": packed(part[:, 2]),
                "marker": {"size": 3, "color": COLOURS[k % 7], "symbol": SYMBOLS[k % 4]},
                "name": f"family {k + 1}" if many else "near the smallest misfit",
                "hovertemplate": "ωx %{x:.3f}<br>ωy %{y:.3f}<br>ωz %{z:.3f} rad/s",
            }
        )
    return found


def _line_traces(scan: xr.Dataset) -> list[dict[str, Any]]:
    found = []
    for points, directions, name, style in (
        ("point", "direction", "fitted line", {"width": 5, "color": "@ink"}),
        (
            "published_point",
            "published_direction",
            "published line",
            {"width": 6, "color": "@grey", "dash": "dash"},
        ),
    ):
        if points not in scan or scan[points].ndim != 2:
            continue
        box = [scan[d].values for d in DIMS]
        ends = [
            _clipped(p, d, box)
            for p, d in zip(scan[points].values, scan[directions].values, strict=True)
        ]
        gap = np.full((1, 3), np.nan)
        path = np.concatenate([part for pair in ends if len(pair) for part in (pair, gap)] or [gap])
        found.append(
            {
                "type": "scatter3d",
                "mode": "lines",
                "x": packed(path[:, 0]),
                "y": packed(path[:, 1]),
                "z": packed(path[:, 2]),
                "line": style,
                "name": name,
                "connectgaps": False,
                "hoverinfo": "name",
            }
        )
    return found


def _clipped(point: np.ndarray, along: np.ndarray, box: list[np.ndarray]) -> np.ndarray:
    """The stretch (2, 3) of a line within the scanned box."""
    low, high = -np.inf, np.inf
    for p, d, axis in zip(point, along, box, strict=True):
        if abs(d) > 1e-12:
            a, b = sorted(((axis.min() - p) / d, (axis.max() - p) / d))
            low, high = max(low, a), min(high, b)
    return (
        np.array([point + low * along, point + high * along])
        if np.isfinite([low, high]).all() and low < high
        else np.zeros((0, 3))
    )


def _marks(results: Results, scan: xr.Dataset) -> list[dict[str, Any]]:
    marks = []
    vehicle = results.vehicle
    if (
        vehicle is not None
        and vehicle.inertia_kg_m2 is not None
        and vehicle.wheels
        and "published_point" in scan
    ):
        still = total_momentum(
            vehicle, np.zeros(3), np.array([w.speed_rad_s for w in vehicle.wheels])
        )
        marks.append(
            (
                -np.linalg.solve(vehicle.require_inertia(), still),
                "body cancels the wheel: no momentum",
                "cross",
            )
        )
    if "truth" in scan:
        marks.append((scan["truth"].values, "truth of the synthetic telemetry", "diamond"))
    return [
        {
            "type": "scatter3d",
            "mode": "markers",
            "x": [p[0]],
            "y": [p[1]],
            "z": [p[2]],
            "name": name,
            "marker": {
                "size": 7,
                "color": "@gold",
                "symbol": symbol,
                "line": {"color": "@ink", "width": 1},
            },
        }
        for p, name, symbol in marks
    ]


def _box(scan: xr.Dataset) -> dict[str, Any]:
    """The scanned box, unseen: axes of the plot reach as far, however few motions fit."""
    ends = {d[-1]: [float(scan[d].min()), float(scan[d].max())] for d in DIMS}
    unseen = {"marker": {"size": 1}, "opacity": 0, "showlegend": False, "hoverinfo": "skip"}
    return {"type": "scatter3d", "mode": "markers", **ends, **unseen}


def _line_table(scan: xr.Dataset, about: str) -> list[Table]:
    if "point" not in scan or scan["point"].ndim != 2:
        return []
    rows = [
        [
            str(k + 1),
            number_text(np.round(p, 4).tolist()),
            number_text(np.round(d, 4).tolist()),
            str(int(c)),
        ]
        for k, (p, d, c) in enumerate(
            zip(scan["point"].values, scan["direction"].values, scan["count"].values, strict=True)
        )
    ]
    return [
        Table(
            ["family", "point (rad/s)", "direction", "motions"],
            rows,
            f"Fitted lines. {about}",
            closed=True,
        )
    ]


def maps(results: Results) -> Section | None:
    """Volumes as slices with a slider, and maps of E."""
    items: list[Any] = []
    volumes = [_volume(name, scan, volume) for name, scan, volume in _volumes(results)]
    if volumes:
        items.append(
            Special(
                "slices",
                {"volumes": volumes, "synthetic": results.synthetic},
                {"volumes": [v.pop("packed") for v in volumes]},
            )
        )
    items += _flat(results)
    if not items:
        return None
    lead = [
        "EMD compares how often the Sun stands at each height, E where it stands at each sample; both are 0 for a perfect fit and "
        "have no unit. EMD changes slowly with the rate and has valleys wide enough to scan. E has many narrow ones: it "
        "cannot be fitted directly."
    ]
    if results.command == "reproduce":
        lead.append(
            "Stripes are no error: where the momentum begins across the z axis (at the nominal wheel speed the lowest ωz), the "
            "body falls to one side or the other as the wheel slows, in turn from one rate to the next."
        )
    return Section("maps", "Maps of the misfit", lead, items)


def _volume(name: str, scan: xr.Dataset, volume: xr.DataArray) -> dict[str, Any]:
    stride = int(np.ceil((volume.size / MOST_CELLS) ** (1 / 3)))
    volume = volume[::stride, ::stride, ::stride]
    values = volume.values
    low = float(np.nanmin(values))
    log = np.log10(np.maximum(values, LEAST))
    ends = float(np.nanmin(log)), float(np.nanmax(log))
    scaled = np.nan_to_num(
        np.round((log - ends[0]) / max(ends[1] - ends[0], 1e-9) * (STEPS - 1)) + 1, nan=0.0
    )
    axes = [volume[d].values for d in DIMS]
    best = np.unravel_index(np.nanargmin(values), values.shape)
    metric = "EMD" if volume.name == "emd" else "E"
    return {
        "label": f"{_label(name, scan)}, {metric}",
        "best": number_text([float(a[i]) for a, i in zip(axes, best, strict=True)], 4),
        "low": f"{low:.4f}",
        "metric": metric,
        "slices": len(axes[2]),
        "start": int(best[2]),
        "packed": {
            "values": packed(np.moveaxis(scaled, 2, 0).reshape(len(axes[2]), -1), "u1")["bdata"],
            "shape": list(values.shape),
            "low": ends[0],
            "high": ends[1],
            "x": axes[0].tolist(),
            "y": axes[1].tolist(),
            "z": axes[2].tolist(),
            "metric": metric,
            "best": [int(i) for i in best],
        },
    }


def _flat(results: Results) -> list[Drawn]:
    found = []
    for name, data in results.having("E"):
        field = data["E"].squeeze()
        if field.ndim != 2:
            continue
        x, y = (str(d) for d in field.dims)
        low, high = float(np.nanmin(field)), float(np.nanmax(field))
        found.append(
            item(
                results,
                Drawing(
                    f"map-{name}",
                    partial(map_figure, field),
                    f"Map of E over {x} and {y}, between {low:.2f} and {high:.2f}: "
                    "in valleys a motion fits better than its neighbours.",
                    f"E over {x} and {y}; darker is worse; a perfect fit is 0, and the smallest value here is {low:.2f}."
                    + synthetic_words(results.synthetic),
                ),
            )
        )
    return found
