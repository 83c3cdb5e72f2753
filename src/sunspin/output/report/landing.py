"""What follows the collision: the Sun's height, what touches first, and other commands to the wheel side by side."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from sunspin.landing.tally import density, tally
from sunspin.output.report.read import Results
from sunspin.output.report.section import COLOURS, SYMBOLS, Plot, Section, Table, packed

FINER = 2
"""Bins of the runs drawn as one."""

KIND_NAMES = {"leg": "a leg", "panel": "a solar panel", "body": "the bare body"}

STRATEGY_NAMES = {
    "off": "off at touchdown (as flown)", "held": "held at speed", "brake": "braked at touchdown",
    "after_rest": "held, off after rest",
}  # fmt: skip

QUANTITIES = (
    ("touch_leg", "A leg touches first", "probability (1)"),
    ("touch_panel", "A panel touches first", "probability (1)"),
    ("rest_leg", "Comes to rest on its legs", "probability (1)"),
    ("leg_tip_speed", "Fastest leg tip at contact", "mean (m/s)"),
    ("antenna_at_rest", "Antenna holds the orbiter at rest", "probability (1)"),
    ("rz_time_below_-0.5", "Upside down to the Sun (r_z < -0.5)", "share of the time (1)"),
    ("rate_after", "Angular speed after the collision", "mean (rad/s)"),
)
"""What is drawn of a comparison: name, heading, axis."""


def strategy_name(name: str) -> str:
    """A command to the wheel in plain words."""
    if name.startswith("delay:"):
        return f"off after {float(name[6:]) / 60:g} min"
    return STRATEGY_NAMES.get(name, name)


def _runs(results: Results) -> list[tuple[str, xr.Dataset]]:
    return [(str(data.attrs.get("strategy", name)), data) for name, data in results.having("rz_share", "omega_after_B")]


def outcomes(results: Results) -> Section | None:
    """Densities of the Sun's height, first contact, rest."""
    found = sorted(_runs(results), key=lambda item: item[0] != "off")
    if not found:
        return None
    told = {name: tally(runs) for name, runs in found}
    items: list[Any] = [_heights(found)]
    contacts = _contacts(told)
    items += [contacts] if contacts else []
    items.append(_numbers(told))
    runs = found[0][1].sizes["run"]
    lead = [
        f"{runs} simulated runs for each command to the wheel. Which leg hit the ground at the collision, from where the blow "
        "came, and how the ground lay at the landing is not known, so it is drawn anew for every run: the spread is what "
        "that ignorance does."
    ]
    begun = results.data.get("candidates")
    if begun is not None and "about" in begun.attrs:
        lead.append(f"The runs begin with {begun.attrs['about']}.")
    missing = str(found[0][1].attrs.get("not_told", ""))
    return Section("outcomes", "What the collision led to", [*lead, *([missing] if missing else [])], items)


def _heights(found: list[tuple[str, xr.Dataset]]) -> Plot:
    data = []
    for k, (name, runs) in enumerate(found):
        curve = density(runs, merge=FINER)
        z, y, error = curve["rz"].values, curve["density"].values, curve["error"].values
        ring = np.concatenate([z, z[::-1]])
        data += [
            {"type": "scatter", "mode": "lines", "x": packed(ring), "y": packed(np.concatenate([y + error, (y - error)[::-1]])),
             "fill": "toself", "fillcolor": f"{COLOURS[k % 7]}:0.25", "line": {"width": 0}, "hoverinfo": "skip",
             "showlegend": False},
            {"type": "scatter", "mode": "lines", "x": packed(z), "y": packed(y), "name": f"wheel {strategy_name(name)}",
             "line": {"color": COLOURS[k % 7], "width": 2.5, "shape": "hvh", "dash": ("solid", "dash", "dot", "dashdot")[k % 4]}},
        ]  # fmt: skip
    layout = {
        "xaxis": {"title": {"text": "r<sub>z</sub>: 1 Sun overhead, −1 Sun underneath (1)"}, "range": [-1, 1]},
        "yaxis": {"title": {"text": "probability density (1)"}, "rangemode": "tozero"},
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom"}, "margin": {"l": 60, "r": 16, "t": 46, "b": 54},
    }  # fmt: skip
    return Plot(
        "heights", data, layout,
        "Probability density of the height of the Sun over the lander between collision and landing, one curve per command to the "
        "wheel, each with a band of one standard error.",
        "How the Sun stood between collision and landing; bands: one standard error.", 380,
    )  # fmt: skip


def _contacts(told: dict[str, dict[str, Any]]) -> Plot | None:
    rows = [(prefix, text) for prefix, text in (("touch", "touches the ground first"), ("rest", "comes to rest on"))]
    labels, bars = [], {kind: ([], []) for kind in KIND_NAMES}
    for prefix, text in rows:
        for name, found in reversed(told.items()):
            if f"{prefix}_leg" not in found:
                continue
            labels.append(f"{text}<br>wheel {strategy_name(name)}")
            for kind, (value, error) in bars.items():
                estimate = found.get(f"{prefix}_{kind}")
                value.append(estimate.value if estimate else 0.0)
                error.append(estimate.error if estimate else 0.0)
    if not labels:
        return None
    data = [
        {"type": "bar", "orientation": "h", "y": labels, "x": packed(value), "name": KIND_NAMES[kind],
         "marker": {"color": COLOURS[k], "pattern": {"shape": ("", "/", ".")[k], "fgcolor": "@paper", "fillmode": "overlay",
         "solidity": 0.3}},
         "error_x": {"type": "data", "array": packed(error), "color": "@ink", "thickness": 1.5},
         "hovertemplate": "%{y}: %{x:.3f}"}
        for k, (kind, (value, error)) in enumerate(bars.items())
    ]  # fmt: skip
    layout = {
        "barmode": "stack", "xaxis": {"title": {"text": "probability (1)"}, "range": [0, 1.05]}, "yaxis": {"automargin": True},
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "traceorder": "normal"}, "margin": {"l": 10, "r": 16,
        "t": 46, "b": 54},
    }  # fmt: skip
    return Plot(
        "contacts", data, layout, "Probabilities that a leg, a panel or the bare body touches the ground first, and of what it "
        "rests on.",
        "Bars: one standard error of the simulation; the hull's own uncertainty is not in them.", 110 + 62 * len(labels),
        narrow={"font.size": 10},
    )  # fmt: skip


def _numbers(told: dict[str, dict[str, Any]]) -> Table:
    names = list(told)
    quantities = list(dict.fromkeys(q for found in told.values() for q in found))
    rows = [
        [q.replace("_", " "), *(_pair(told[n][q].value, told[n][q].error, 4) if q in told[n] else "–" for n in names)]
        for q in quantities
    ]
    return Table(
        ["quantity (probability or share: 1; speeds: m/s; rates: rad/s)", *map(strategy_name, names)],
        rows,
        "In numbers",
        closed=True,
    )


def strategies(results: Results) -> Section | None:
    """Commands to the wheel side by side: one small plot per quantity, common rows."""
    table = results.first("value", "error", "gain")
    if table is None or not {"strategy", "quantity"} <= set(table.dims):
        return None
    known = [q for q in QUANTITIES if q[0] in table["quantity"].values and np.isfinite(table["value"].sel(quantity=q[0])).any()]
    names = [str(name) for name in table["strategy"].values]
    if not known or len(names) < 2:
        return None
    runs = int(table.attrs.get("runs", 0))
    lead = [
        f"The same {runs} draws for every command, so that differences are known better than the values. "
        "Switching the wheel off at the touchdown is what was flown."
    ]
    rows = [[text, *(_value(table, name, q) for name in names)] for q, text, _ in known]
    numbers = Table(["quantity", *map(strategy_name, names)], rows, "In numbers (one standard error)")
    return Section("strategies", "What the wheel could have been told instead", lead, [_grid(table, names, known), numbers])


def _pair(value: float, error: float, decimals: int) -> str:
    """A value with its error, never broken between two lines: the table scrolls instead."""
    return f"{value:.{decimals}f}\u00a0±\u00a0{error:.{decimals}f}"


def _value(table: xr.Dataset, name: str, quantity: str) -> str:
    value, error = (float(table[part].sel(strategy=name, quantity=quantity)) for part in ("value", "error"))
    return _pair(value, error, 3) if np.isfinite(value) else "not told"


def _grid(table: xr.Dataset, names: list[str], known: list[tuple[str, str, str]]) -> Plot:
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {"annotations": [], "margin": {"l": 10, "r": 16, "t": 28, "b": 46}, "showlegend": False}
    narrow: dict[str, Any] = {"font.size": 10}
    columns, lines = 2, -(-len(known) // 2)
    labels = [strategy_name(name) for name in names]
    for k, (quantity, heading, axis) in enumerate(known):
        row, column = divmod(k, columns)
        at = table.sel(quantity=quantity)
        suffix = "" if k == 0 else str(k + 1)
        data.append({
            "type": "scatter", "mode": "markers", "x": packed(at["value"].values), "y": labels, "xaxis": f"x{suffix}",
            "yaxis": f"y{suffix}",
            "error_x": {"type": "data", "array": packed(np.nan_to_num(at["error"].values)), "color": "@ink", "thickness": 1.5,
            "width": 4},
            "marker": {"size": 10, "color": COLOURS[0], "symbol": SYMBOLS[0]}, "hovertemplate": "%{y}: %{x:.3f}<extra></extra>",
        })  # fmt: skip
        top, bottom = 1 - row / lines, 1 - (row + 1) / lines
        domain_x, domain_y = ([0.0, 0.42], [0.58, 1.0])[column], [bottom + 0.13 / lines * 2, top - 0.1 / lines]
        layout[f"xaxis{suffix}"] = {
            "domain": domain_x, "anchor": f"y{suffix}", "title": {"text": axis, "standoff": 4, "font": {"size": 12}},
            "rangemode": "tozero", "nticks": 5,
        }  # fmt: skip
        layout[f"yaxis{suffix}"] = {
            "domain": domain_y, "anchor": f"x{suffix}", "autorange": "reversed", "automargin": column == 0, "showticklabels": True,
            "type": "category", "tickfont": {"size": 11},
        }  # fmt: skip
        layout["annotations"].append({
            "text": f"<b>{heading}</b>", "xref": f"x{suffix} domain", "yref": f"y{suffix} domain", "x": 0, "y": 1.0,
            "yanchor": "bottom",
            "xanchor": "left", "showarrow": False, "font": {"size": 12.5},
        })  # fmt: skip
        # the labels leave a phone half its width: there a heading ends where its plot ends
        narrow |= {f"annotations.{k}.{key}": value for key, value in (("x", 1), ("xanchor", "right"), ("font.size", 11.5))}
        height = 1 / len(known)
        narrow[f"xaxis{suffix}.domain"] = [0, 1]
        narrow[f"yaxis{suffix}.domain"] = [1 - (k + 1) * height + 0.3 * height, 1 - k * height - 0.16 * height]
    narrow["height"] = 210 * len(known)
    return Plot(
        "strategy-grid", data, layout,
        "For each command to the wheel a dot with its standard error, for each quantity a small plot; the table below has the "
        "numbers.",
        "Dots: means over the runs; bars: one standard error.", 215 * lines, narrow=narrow,
    )  # fmt: skip


def picture(results: Results) -> Plot | None:
    """First picture of a folder of outcomes: what touches first, else the Sun's height."""
    found = _runs(results)
    if not found:
        return None
    told = {name: tally(runs) for name, runs in found}
    return _contacts(told) or _heights(found)
