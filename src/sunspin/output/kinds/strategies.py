"""Results of the kinds `strategies` (a table of all strategies) and `landing` (that table, all runs and the collision)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
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
from sunspin.output.text import capitalize_first, count_text, with_sigma

COMPARED = ("rest_leg", "touch_leg")
"""Quantities that the first line compares, the first one that all strategies have: what a lander is for."""


def strategies_summary(table: Any) -> Summary:
    """Return the summary of a comparison of strategies: the estimates of each one with standard errors."""
    estimates, lines = {}, []
    for name in table["strategy"].values.astype(str):
        of_strategy = table.sel(strategy=name)
        columns = (of_strategy[column].values for column in ("quantity", "value", "error"))
        estimates[name] = {
            str(quantity_name): {"value": float(value), "error": float(error)}
            for quantity_name, value, error in zip(*columns, strict=True)
            if np.isfinite(value)
        }
        lines += [f"wheels {name}: {table.attrs['runs']} runs", *estimate_lines(estimates[name])]
    numbers: dict[str, Any] = {key: int(table.attrs[key]) for key in ("runs", "seed", "candidates")}
    undetermined = table.attrs["not_told"]  # in words: what the vehicle file does not determine
    numbers |= {"not_told": undetermined, "strategies": estimates}
    return Summary(numbers, lines, [undetermined] if undetermined else [])


def strategies_drawings(table: Any, _: Context) -> Iterator[Drawing]:
    """Yield the figure that compares strategies."""
    alt = "What touches first, on what it rests, antenna, speeds and height of the Sun for each command to the wheel."
    caption = "Means over the runs; bars: one standard error."
    yield Drawing("strategies", lambda: strategies_figure(table), alt, caption)


STACKS = (("touches the ground first", "touch"), ("comes to rest on", "rest"))
"""Stacked bars of :func:`strategies_figure`: title, begin of the names of the quantities."""

PARTS = {"leg": "leg", "panel": "panel", "body": "bare body"}
"""Parts of a stack from below: end of the name of the quantity -> label."""

DOTS = (
    (
        "orbiter in the antenna cone",
        "probability",
        {
            "antenna_share": "in flight",
            "antenna_at_contact": "at contact",
            "antenna_at_rest": "at rest",
        },
    ),
    (
        "speed at first contact",
        "mean speed over ground (m/s)",
        {"contact_speed": "point that touches", "leg_tip_speed": "fastest leg tip"},
    ),
    (
        "Sun below the body's equator",
        "share of the time",
        {"rz_time_below_0": "$r_z$ < 0", "rz_time_below_-0.5": "$r_z$ < -0.5"},
    ),
    (
        "angular speed",
        "mean (deg/s)",
        {"rate_before": "before the collision", "rate_after": "after it"},
    ),
)
"""Axes with dots of :func:`strategies_figure`: title, label of the y axis, and quantities -> their labels."""


@styled
def strategies_figure(table: Any) -> Any:
    """Draw contacts, rest, antenna, speeds, height of the Sun and rates for each strategy, with standard errors.

    The first two of the six axes have the stacked bars of `STACKS`, the others the dots of `DOTS`; quantities that the table lacks
    are left out.
    """
    title = f"Momentum-wheel strategies after the touchdown: {table.attrs['runs']} runs each, one standard error"
    figure, grid = axes_grid(11, 6.4, 2, 3, title)
    strategies = table["strategy"].values.astype(str)
    place = np.arange(len(strategies))
    for axes, (title, prefix) in zip(grid.flat, STACKS, strict=False):
        _draw_stack(axes, table, prefix)
        axes.set(title=title, ylabel="probability", ylim=(0, 1.22))  # room for the legend above 1
    for axes, (title, label, quantities) in zip(grid.flat[2:], DOTS, strict=True):
        _draw_dots(axes, table, quantities, probability="(" not in label)  # no unit in the label
        top = 1.3 * max(axes.dataLim.y1, 1e-3)  # room for the legend, even if all values are 0
        axes.set(title=title, ylabel=label, ylim=(0, top))
    for axes in grid.flat:
        if axes.get_legend_handles_labels()[0]:
            axes.legend(ncols=3, loc="upper center", columnspacing=1, handletextpad=0.3)
        axes.set_xticks(place, [fill(strategy_name(name), 10) for name in strategies])
        axes.set_xlim(-0.6, len(strategies) - 0.4)
    return figure


def _draw_stack(axes: Any, table: Any, prefix: str) -> None:
    """Draw for each strategy a bar of the probabilities of the `PARTS`, stacked; the error bars are at the top of each part.

    `prefix`: "touch" or "rest", with which the names of the quantities begin.
    """
    place = np.arange(table.sizes["strategy"])
    top = np.zeros(len(place))  # of the parts drawn so far
    for k, (part, label) in enumerate(PARTS.items()):
        if f"{prefix}_{part}" in table["quantity"].values:
            estimates = table.sel(quantity=f"{prefix}_{part}")
            style = {"color": COLOURS[k], "hatch": HATCHES[k], "alpha": 0.85, "ec": "white"}
            axes.bar(place, estimates["value"], 0.65, top, label=label, **style)
            top = top + estimates["value"].values
            error_bars = clip_errors(top, estimates["error"].values)
            axes.errorbar(place, top, error_bars, fmt="none", ecolor="black", lw=1, capsize=2)
    if not np.any(top):
        explain_empty_axes(axes, "not determined without a hull")


def _draw_dots(axes: Any, table: Any, quantities: Mapping[str, str], probability: bool) -> None:
    """Draw dots with error bars for each strategy and quantity (name -> label), side by side.

    `probability`: whether the values are probabilities, so that their error bars end at 0 and 1.
    """
    place = np.arange(table.sizes["strategy"])
    known = [name for name in quantities if name in table["quantity"].values]
    for k, (name, label) in enumerate(quantities.items()):
        if name in known:
            estimates = table[["value", "error"]].sel(quantity=name) * quantity(name).scale
            value, error = estimates["value"].values, estimates["error"].values
            error_bars = clip_errors(value, error) if probability else error
            style = {"fmt": "osD"[k], "ms": 5, "color": COLOURS[k], "capsize": 2}
            axes.errorbar(place + 0.12 * (k - 0.5), value, error_bars, label=label, **style)
    if not known:
        explain_empty_axes(axes, "not determined by this vehicle and scenario")


def strategies_tables(table: Any) -> Iterator[Table]:
    """Yield the table `strategies`: a row for each quantity, a column for each strategy, mean and standard error."""
    import pandas as pd

    rows = []
    for name in table["quantity"].values.astype(str):
        in_words, estimates = quantity(name), table.sel(quantity=name)
        if np.isfinite(estimates["value"]).any():
            values = estimates["value"].values * in_words.scale
            errors = estimates["error"].values * in_words.scale
            cells = map(with_sigma, values, errors)
            rows.append([name, capitalize_first(in_words.heading), *cells])
    strategies = table["strategy"].values.astype(str)
    frame = pd.DataFrame(rows, columns=["quantity", "what", *strategies])
    headings = {"what": "quantity"} | {name: strategy_name(name) for name in strategies}
    yield Table("strategies", frame, "Commands to the wheel (one standard error)", headings)


def landing_summary(tree: Any) -> Summary:
    """Return the summary of a landing: the strategies, runs that could not be computed, and the collision if simulated."""
    strategies = strategies_summary(tree["strategies"].to_dataset())
    numbers, lines = dict(strategies), []
    if len(numbers["strategies"]) > 1:
        lines.append(_comparison_line(numbers["strategies"], numbers["runs"]))
    for name, runs in read_runs(tree).items():
        lines += run_lines(runs, numbers["strategies"][name])
    if "collision" in tree:
        numbers["collision"] = collision = collision_summary(tree["collision"].to_dataset())
        lines += collision.lines
    return Summary(numbers, lines, strategies.notes)


def _comparison_line(estimates: dict[str, dict[str, Any]], runs: int) -> str:
    """Return the line that compares strategies in one quantity of `COMPARED`.

    `estimates`: strategy -> quantity -> "value" and "error" as stored.
    """
    head = f"{len(estimates)} commands to the wheel, {count_text(runs, 'run')} each"
    for name in COMPARED:
        if all(name in of_strategy for of_strategy in estimates.values()):
            text, unit, scale = quantity(name)
            values = (
                f"{strategy} {with_sigma(*(scale * each[name][key] for key in ('value', 'error')), unit)}"
                for strategy, each in estimates.items()
            )
            return f"{head}; {text}: {', '.join(values)}"
    return head


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
