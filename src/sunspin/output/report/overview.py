"""The first picture, and the timeline."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from sunspin.output.kinds.kind import synthetic_words
from sunspin.output.report import drawn
from sunspin.output.report.read import Results
from sunspin.output.report.section import (
    Drawn,
    Plot,
    Section,
    Special,
    Table,
    clock,
    epoch_ms,
    packed,
    utc_text,
)
from sunspin.output.text import turn_text
from sunspin.telemetry.case import load_case

NAMES = {
    "separation": "Separation",
    "unfolding_begins": "Legs begin to unfold",
    "descent_fit_begins": "First clean sample",
    "unfolding_ends": "Legs unfolded",
    "first_touchdown": "First touchdown",
    "first_sample_after_touchdown": "First sample afterwards",
    "collision": "Collision",
    "second_touchdown": "Second touchdown",
    "rest": "At rest",
}
"""Events in plain words."""

TURNS = ((600, "10 min"), (60, "1 min"), (30, "30 s"), (13, "13 s"), (5, "5 s"))
"""Marks on the axis of angular speed: time of one turn in s."""


def hero(results: Results) -> Plot | Drawn | None:
    """The picture of the first screen: the angular speed through the landing, or the main result of another command."""
    if results.why_nothing:  # no picture of a motion where none is concluded
        return drawn.first(results, ("sun",))
    speed = results.first("speed", "speed_after_collision")
    if speed is not None and results.timeline is not None:
        return _speed(results, speed)
    return drawn.first(results)


def _speed(results: Results, speed: xr.Dataset) -> Plot:
    timeline = results.timeline
    assert timeline is not None
    epoch = str(speed.attrs.get("epoch_utc") or timeline.epoch_utc)
    at = {event.name: event.t_s for event in timeline.events}
    data, numbers = _bands(speed, epoch, at)
    data += _descent(speed, epoch, numbers)
    data += _magnetometer(results, epoch, at, numbers)
    ticks = {
        "tickvals": [2 * np.pi / s for s, _ in TURNS],
        "ticktext": [text for _, text in TURNS],
        "type": "log",
        "range": _range(speed),
    }
    zero = epoch_ms(epoch) or 0.0
    day = {
        "type": "date",
        "tickformat": "%H:%M",
        "hoverformat": "%H:%M:%S",
        "showgrid": False,
        "tickangle": 0,
    }
    down, rest = at["first_touchdown"], at["rest"]
    split = (0.0, 0.27), (0.3, 1.0)
    layout = {
        "xaxis": {
            **day,
            "domain": split[0],
            "range": [zero + 1e3 * at["separation"], zero + 1e3 * down],
            "nticks": 3,
        },
        "xaxis2": {
            **day,
            "domain": split[1],
            "range": [zero + 1e3 * (down - 120), zero + 1e3 * (rest + 420)],
            "title": {"text": f"UTC, {epoch[:10]} (left: time compressed)", "standoff": 8},
        },
        "yaxis": {**ticks, "title": {"text": "one turn takes"}},
        "yaxis2": {
            "type": "log",
            "range": ticks["range"],
            "overlaying": "y",
            "anchor": "x2",
            "side": "right",
            "showgrid": False,
            "tickvals": [0.01, 0.03, 0.1, 0.3, 1.0],
            "ticktext": ["0.01", "0.03", "0.1", "0.3", "1"],
            "title": {"text": "angular speed (rad/s)"},
        },
        "shapes": _marks(at, zero),
        "annotations": _labels(at, zero),
        "legend": {"orientation": "h", "y": -0.22, "x": 0},
        "margin": {"l": 62, "r": 62, "t": 46, "b": 60},
    }
    narrow = {
        "legend.y": -0.2,
        "margin": {"l": 50, "r": 44, "t": 40, "b": 56},
        "xaxis.nticks": 2,
        "xaxis2.nticks": 4,
        "xaxis2.title.text": f"UTC, {epoch[:10]}",
        "yaxis2.title.text": "rad/s",
        "font.size": 11,
        "annotations.1.text": "rim",
        "annotations.2.text": "lands",
        "annotations.3.text": "",
    }
    return Plot(
        "speed",
        data,
        layout,
        "How fast Philae turned, against time: the descent as a line, then after the first touchdown a band of rates up to the "
        "collision, and again after it until the second touchdown. The numbers are in the table below the picture.",
        _caption(results, speed),
        430,
        narrow=narrow,
        numbers=Table(
            ["when", "what", "angular speed (rad/s)", "one turn takes"],
            numbers,
            "The picture in numbers",
            closed=True,
        ),
    )


def _range(speed: xr.Dataset) -> list[float]:
    """Ends of the axis of angular speed, as logarithms: the usual ones, further out where a set of motions goes further."""
    known = np.concatenate(
        [speed[name].values.ravel() for name in ("speed", "speed_after_collision")]
    )
    known = known[np.isfinite(known) & (known > 0)]
    low, high = (known.min(), known.max()) if known.size else SHOWN
    return [
        float(np.log10(max(min(SHOWN[0], 0.8 * low), FLOOR))),
        float(np.log10(max(SHOWN[1], 1.2 * high))),
    ]


def _caption(results: Results, speed: xr.Dataset) -> str:
    said = speed.attrs
    about, recipe = (str(said.get(f"about_{name}", name)) for name in STYLE)
    meaning = _meaning(results, str(said.get("chain", "")))
    return (
        f"How fast Philae turned. Band: {about}, from the slowest to the fastest{meaning}. "
        f"Dashed: {recipe}, and its median; it has no stated confidence. After the collision: 95 % of the simulated "
        "collisions of the same motions. Diamonds: what the magnetometer said, which was not used."
        + synthetic_words(results.synthetic)
    )


def _meaning(results: Results, chain: str) -> str:
    """What the band says, and what it does not."""
    if chain == "posterior":
        return ", draws of a probability"
    if chain == "published":
        return "; this telemetry does not enter"
    if chain != "scan":
        return "; their choice is the reader's"
    bound = results.row("rate_at_touchdown_bound") or {}
    below = (
        "bound it from below only"
        if bound.get("informative") is True
        else "bound it neither from below nor from above"
    )
    return (
        f"; every motion in it fits, none is preferred, and the heights of the Sun {below}: beyond that it ends where the scan "
        "ends. Drawn are the motions of the grid; the bound in the text counts the cells between them, too"
    )


STYLE: dict[str, tuple[str, dict[str, Any], str]] = {
    "candidates": ("@blue:0.25", {"width": 0, "color": "@blue:0.25"}, "all that fits"),
    "recipe": (
        "@blue:0",
        {"width": 1.6, "color": "@blue", "dash": "dash"},
        "the paper's recipe on this telemetry",
    ),
}
"""Sets of motions -> fill, outline, name in the legend. The recipe has no stated confidence, so that it is no darker band."""

NAMED = {
    "posterior": "draws of the posterior",
    "published": "the printed lines",
    "scan": "all that fits",
}
"""Source of the candidates -> their name in the legend; others are a file's."""

SHOWN = (0.006, 2.2)
"""Angular speeds (rad/s) that the axis covers at least."""

FLOOR = 1e-4
"""Smaller speeds (rad/s), such as none at all, are drawn as this."""


def _bands(
    speed: xr.Dataset, epoch: str, at: dict[str, float]
) -> tuple[list[dict[str, Any]], list[list[str]]]:
    data: list[dict[str, Any]] = []
    numbers: list[list[str]] = []
    t = speed["time"].values
    after = np.array([at["collision"], at["second_touchdown"]])
    for name in STYLE:
        if name not in speed["set"].values:
            continue
        colour, line, label = STYLE[name]
        if name == "candidates":
            label = NAMED.get(str(speed.attrs.get("chain", "scan")), "motions of the file")
        drawn = {
            key: speed[key].sel(set=name).clip(min=FLOOR)
            for key in ("speed", "speed_after_collision")
        }
        before = {
            level: drawn["speed"].sel(level=level).values for level in ("low", "middle", "high")
        }
        then = {
            level: float(drawn["speed_after_collision"].sel(level=level))
            for level in ("low", "middle", "high")
        }
        for k, (x, low, high) in enumerate(
            [
                (t, before["low"], before["high"]),
                (after, np.full(2, then["low"]), np.full(2, then["high"])),
            ]
        ):
            ring = np.concatenate([x, x[::-1]])
            data.append(
                {
                    "type": "scatter",
                    "mode": "lines",
                    "x": clock(ring, epoch),
                    "y": packed(np.concatenate([high, low[::-1]])),
                    "fill": "toself",
                    "fillcolor": colour,
                    "line": line,
                    "name": label,
                    "legendgroup": name,
                    "showlegend": k == 0,
                    "xaxis": "x2",
                    "yaxis": "y",
                    "hoverinfo": "skip",
                }
            )
        if name == "recipe":
            for k, (x, y) in enumerate(
                [(t, before["middle"]), (after, np.full(2, then["middle"]))]
            ):
                data.append(
                    {
                        "type": "scatter",
                        "mode": "lines",
                        "x": clock(x, epoch),
                        "y": packed(y),
                        "line": {"width": 2, "color": "@blue"},
                        "name": "its median",
                        "showlegend": k == 0,
                        "legendgroup": "median",
                        "xaxis": "x2",
                        "yaxis": "y",
                    }
                )
        for when, found in (
            ("first sample", {k: v[0] for k, v in before.items()}),
            ("before the collision", {k: v[-1] for k, v in before.items()}),
            ("after the collision", then),
        ):
            levels = (
                "2.5 %, median, 97.5 % of the collisions"
                if found is then
                else "slowest, median, fastest"
            )
            numbers.append([when, f"{label}: {levels}", *_three(found)])
    return data, numbers


def _three(found: dict[str, float]) -> list[str]:
    speeds = [found[level] for level in ("low", "middle", "high")]
    return [", ".join(f"{s:.3g}" for s in speeds), ", ".join(turn_text(s) for s in speeds)]


def _descent(speed: xr.Dataset, epoch: str, numbers: list[list[str]]) -> list[dict[str, Any]]:
    if "descent_speed" not in speed:
        return []
    rate = speed["descent_speed"].values
    numbers.insert(
        0,
        [
            "descent",
            "fitted rate, smallest to largest",
            f"{rate.min():.4g} to {rate.max():.4g}",
            turn_text(rate.mean()),
        ],
    )
    return [
        {
            "type": "scatter",
            "mode": "lines",
            "x": clock(speed["descent_time"].values, epoch),
            "y": packed(rate),
            "xaxis": "x",
            "yaxis": "y",
            "line": {"width": 3, "color": "@green"},
            "name": "fit of the descent",
        }
    ]


def _magnetometer(
    results: Results, epoch: str, at: dict[str, float], numbers: list[list[str]]
) -> list[dict[str, Any]]:
    if results.vehicle is None or results.vehicle.name != "philae":
        return []
    published = load_case("philae").published
    mean = (at["separation"] + at["first_touchdown"]) / 2
    points = [
        (mean, published["descent_rate_romap"].value, "x"),
        (at["collision"] - 240, 2 * np.pi / published["romap_period_before"].value, "x2"),
        (at["collision"] + 600, 2 * np.pi / published["romap_period_after"].value, "x2"),
    ]
    data = []
    for k, (t, rate, axis) in enumerate(points):
        numbers.append(
            [utc_text(t, epoch), "magnetometer (not used)", f"{rate:.3g}", turn_text(rate)]
        )
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "x": clock([t], epoch),
                "y": [rate],
                "xaxis": axis,
                "yaxis": "y",
                "marker": {
                    "symbol": "diamond",
                    "size": 12,
                    "color": "@orange",
                    "line": {"color": "@paper", "width": 1.5},
                },
                "name": "magnetometer (not used)",
                "legendgroup": "romap",
                "showlegend": k == 0,
            }
        )
    data.append(
        {
            "type": "scatter",
            "x": [None],
            "y": [None],
            "xaxis": "x2",
            "yaxis": "y2",
            "showlegend": False,
            "hoverinfo": "skip",
        }
    )
    return data


MARKED = ("first_touchdown", "collision", "second_touchdown", "rest")


def _marks(at: dict[str, float], zero: float) -> list[dict[str, Any]]:
    return [
        {
            "type": "line",
            "xref": "x2",
            "yref": "paper",
            "x0": zero + 1e3 * at[name],
            "x1": zero + 1e3 * at[name],
            "y0": 0,
            "y1": 1,
            "line": {"color": "@muted", "width": 1.2, "dash": "dot"},
        }
        for name in MARKED
    ]


def _labels(at: dict[str, float], zero: float) -> list[dict[str, Any]]:
    texts = {
        "first_touchdown": "bounce",
        "collision": "hits crater rim",
        "second_touchdown": "lands",
        "rest": "at rest",
    }
    found = [
        {
            "xref": "x2",
            "yref": "paper",
            "x": zero + 1e3 * at[name],
            "y": 1.0,
            "yanchor": "bottom",
            "showarrow": False,
            "text": texts[name],
            "xanchor": {"first_touchdown": "left", "rest": "left", "second_touchdown": "right"}.get(
                name, "center"
            ),
            "font": {"size": 12},
        }
        for name in MARKED
    ]
    found.append(
        {
            "xref": "x domain",
            "yref": "paper",
            "x": 0.5,
            "y": 1.0,
            "yanchor": "bottom",
            "showarrow": False,
            "text": "descent",
            "font": {"size": 12},
        }
    )
    return found


def timeline(results: Results) -> Section | None:
    """Events in order of time."""
    if results.timeline is None:
        return None
    epoch, events, last = results.timeline.epoch_utc, [], None
    moving = sorted(results.named("motion-"))
    spans = [(float(d["time"].values[0]), float(d["time"].values[-1])) for _, d in moving]
    for event in results.timeline.events:
        gap = "" if last is None else _gap(event.t_s - last)
        seen = any(low - 1.5 <= event.t_s <= high + 1.5 for low, high in spans)
        events.append(
            {
                "name": NAMES.get(event.name, event.name.replace("_", " ")),
                "utc": utc_text(event.t_s, epoch),
                "note": event.note,
                "source": event.refined_source or event.source,
                "gap": gap,
                "seek": event.t_s if seen else None,
            }
        )
        last = event.t_s
    phases = [
        [
            p.name.replace("_", " "),
            utc_text(p.begin_s, epoch),
            utc_text(p.end_s, epoch) if np.isfinite(p.end_s) else "open",
            p.note,
        ]
        for p in results.timeline.phases
    ]
    return Section(
        "timeline",
        "What happened when",
        [f"All times are UTC on {epoch[:10]}."],
        [
            Special("timeline", {"events": events}),
            Table(["phase", "from", "to", "what"], phases, "Phases", closed=True),
        ],
    )


def _gap(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.0f} s later"
    return (
        f"{seconds / 60:.0f} min later"
        if seconds < 7200
        else f"{int(seconds // 3600)} h {int(seconds % 3600 // 60)} min later"
    )
