"""Results of the kinds `strategies` (a table of all strategies) and `landing` (that table, all runs and the collision)."""

from __future__ import annotations

from collections.abc import Iterator
from textwrap import fill
from typing import Any

import numpy as np

from sunspin.landing.tally import quantity
from sunspin.output.figures import COLOURS, axes_grid, styled
from sunspin.output.kind import KINDS, Context, Drawing, Kind, Summary, Table
from sunspin.output.kinds.collision import collision_drawings, collision_summary
from sunspin.output.kinds.outcomes import (
    HATCHES,
    clip_errors,
    estimate_lines,
    explain_empty_axes,
    run_lines,
    runs_drawings,
    strategy_name,
)
from sunspin.output.text import capitalize_first, with_sigma


def strategies_summary(table: Any) -> Summary:
    """Return the summary of a comparison of strategies: the estimates of each one with standard errors."""
    estimates, lines = {}, []
    for name in table["strategy"].values.astype(str):
        at = table.sel(strategy=name)
        columns = (at[key].values for key in ("quantity", "value", "error"))
        estimates[name] = {
            str(q): {"value": float(v), "error": float(e)}
            for q, v, e in zip(*columns, strict=True)
            if np.isfinite(v)
        }
        lines += [f"wheels {name}: {table.attrs['runs']} runs", *estimate_lines(estimates[name])]
    numbers: dict[str, Any] = {k: int(table.attrs[k]) for k in ("runs", "seed", "candidates")}
    numbers |= {"not_told": table.attrs["not_told"], "strategies": estimates}
    return Summary(numbers, lines, [numbers["not_told"]] if numbers["not_told"] else [])


def strategies_drawings(table: Any, _: Context) -> Iterator[Drawing]:
    """Yield the figure that compares strategies."""
    alt = "What touches first, on what it rests, antenna, speeds and height of the Sun for each command to the wheel."
    caption = "Means over the runs; bars: one standard error."
    yield Drawing("strategies", lambda: strategies_figure(table), alt, caption)


STACKS = (("touches the ground first", "touch"), ("comes to rest on", "rest"))
"""Stacked bars of :func:`strategies_figure`: title, begin of the names of the quantities."""


@styled
def strategies_figure(table: Any) -> Any:
    """Draw contacts, rest, antenna, speeds, height of the Sun and rates for each strategy, with standard errors."""
    title = f"Momentum-wheel strategies after the touchdown: {table.attrs['runs']} runs each, one standard error"
    figure, grid = axes_grid(11, 6.4, 2, 3, title)
    antenna = {"antenna_share": "in flight", "antenna_at_contact": "at contact"}
    antenna |= {"antenna_at_rest": "at rest"}
    speed = {"contact_speed": "point that touches", "leg_tip_speed": "fastest leg tip"}
    sun = {"rz_time_below_0": "$r_z$ < 0", "rz_time_below_-0.5": "$r_z$ < -0.5"}
    rate = {"rate_before": "before the collision", "rate_after": "after it"}
    # title, label of the axis, quantities with their labels
    dots = (
        ("orbiter in the antenna cone", "probability", antenna),
        ("speed at first contact", "mean speed over ground (m/s)", speed),
        ("Sun below the body's equator", "share of the time", sun),
        ("angular speed", "mean (deg/s)", rate),
    )
    names = table["strategy"].values.astype(str)
    quantities_known = set(table["quantity"].values)
    places = np.arange(len(names))
    for axes, (title, prefix) in zip(grid.flat, STACKS, strict=False):
        bottom = np.zeros(len(names))
        touching = {"leg": "leg", "panel": "panel", "body": "bare body"}
        for k, (kind, label) in enumerate(touching.items()):
            if f"{prefix}_{kind}" in quantities_known:
                at = table.sel(quantity=f"{prefix}_{kind}")
                style = {"color": COLOURS[k], "hatch": HATCHES[k], "alpha": 0.85, "ec": "white"}
                axes.bar(places, at["value"], 0.65, bottom, label=label, **style)
                bottom = bottom + at["value"].values
                bars = clip_errors(bottom, at["error"].values)
                axes.errorbar(places, bottom, bars, fmt="none", ecolor="black", lw=1, capsize=2)
        axes.set(title=title, ylabel="probability", ylim=(0, 1.22))
        if not np.any(bottom):
            explain_empty_axes(axes, "not determined without a hull")
    for axes, (title, label, quantities) in zip(grid.flat[2:], dots, strict=True):
        for k, (name, text) in enumerate(quantities.items()):
            if name in quantities_known:
                at = table[["value", "error"]].sel(quantity=name) * quantity(name).scale
                value, error = at["value"].values, at["error"].values
                bars = error if "(" in label else clip_errors(value, error)  # a share has no unit
                style = {"fmt": "osD"[k], "ms": 5, "color": COLOURS[k], "capsize": 2}
                axes.errorbar(places + 0.12 * (k - 0.5), value, bars, label=text, **style)
        axes.set(title=title, ylabel=label, ylim=(0, 1.3 * max(axes.dataLim.y1, 1e-3)))
        if not quantities_known & set(quantities):
            explain_empty_axes(axes, "not determined by this vehicle and scenario")
    for axes in grid.flat:
        if axes.get_legend_handles_labels()[0]:
            axes.legend(ncols=3, loc="upper center", columnspacing=1, handletextpad=0.3)
        axes.set_xticks(places, [fill(strategy_name(name), 10) for name in names])
        axes.set_xlim(-0.6, len(names) - 0.4)
    return figure


def strategies_tables(table: Any) -> Iterator[Table]:
    """Yield the table `strategies`: a row for each quantity, a column for each strategy, mean and standard error."""
    import pandas as pd

    rows = []
    for name in table["quantity"].values.astype(str):
        label, at = quantity(name), table.sel(quantity=name)
        if np.isfinite(at["value"]).any():
            values, errors = at["value"].values * label.scale, at["error"].values * label.scale
            texts = [with_sigma(v, e) for v, e in zip(values, errors, strict=True)]
            rows.append([name, capitalize_first(label.heading), *texts])
    names = table["strategy"].values.astype(str)
    frame = pd.DataFrame(rows, columns=["quantity", "what", *names])
    shown = {"what": "quantity"} | {name: strategy_name(name) for name in names}
    yield Table("strategies", frame, "Commands to the wheel (one standard error)", shown)


def landing_summary(tree: Any) -> Summary:
    """Return the summary of a landing: the strategies, runs that could not be computed, and the collision if simulated."""
    numbers, lines = strategies_summary(tree["strategies"].to_dataset()), []
    for name, runs in read_runs(tree).items():
        lines += run_lines(runs, numbers["strategies"][name])
    if "collision" in tree:
        numbers["collision"] = collision = collision_summary(tree["collision"].to_dataset())
        lines += collision.lines
    return Summary(numbers, lines, numbers.notes)


def read_runs(tree: Any) -> dict[str, Any]:
    """Return the runs of each strategy by name, in the order of the table."""
    names = tree["strategies"]["strategy"].values.astype(str)
    return {name: tree[f"runs/{name}"].to_dataset() for name in names}


def landing_drawings(tree: Any, context: Context) -> Iterator[Drawing]:
    """Yield the figures of a landing: strategies, runs and collision."""
    yield from strategies_drawings(tree["strategies"].to_dataset(), context)
    yield from runs_drawings(read_runs(tree))
    if "collision" in tree:
        yield from collision_drawings(tree["collision"].to_dataset(), context)


def landing_tables(tree: Any) -> Iterator[Table]:
    """Return the tables of a landing: that of the strategies."""
    return strategies_tables(tree["strategies"].to_dataset())


def landing_datasets(tree: Any, _: Context) -> dict[str, Any]:
    """Return the files of a landing: the table of strategies, and the runs of each strategy."""
    runs = {f"outcomes-{name.replace(':', '-')}": data for name, data in read_runs(tree).items()}
    return {"strategies": tree["strategies"].to_dataset()} | runs


_strategies = (strategies_summary, strategies_drawings, strategies_tables)
_landing = (landing_summary, landing_drawings, landing_tables, landing_datasets)
KINDS.update(
    strategies=Kind("outcomes", "strategies", *_strategies),
    landing=Kind("outcomes", "", *_landing),
)
