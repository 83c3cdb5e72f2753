"""What a motion leads to: runs of one strategy, strategies side by side, both as one tree."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr

from sunspin.landing.tally import quantity, tally
from sunspin.output.kind import Context, Drawing, Summary, Table
from sunspin.output.kinds.collision import collision_drawings, collision_summary
from sunspin.output.text import capital, with_sigma

SHOWN = (
    "touch_leg",
    "touch_panel",
    "touch_body",
    "rest_leg",
    "rest_panel",
    "leg_tip_speed",
    "antenna_share",
    "antenna_at_rest",
    "rz_time_below_-0.5",
    "rate_before",
    "rate_after",
)
"""What is printed of a tally, in this order."""


def _shown(found: Mapping[str, Mapping[str, float]]) -> Iterator[str]:
    """A line for each quantity that is known, in the unit in which it is shown."""
    for name in SHOWN:
        if name in found:
            one = quantity(name)
            value, error = (found[name][key] * one.scale for key in ("value", "error"))
            yield f"  {one.heading}: {value:.4f} +- {error:.4f}"


def outcomes_summary(runs: Any) -> Summary:
    """Estimates over the runs of one strategy."""
    found = {
        q: {"value": float(e.value), "error": float(e.error)}
        for q, e in tally(runs).items()
        if np.isfinite(e.value)
    }
    return Summary(
        {"runs": runs.sizes["run"], "estimates": found}, _lines(runs, found), _not_told(runs)
    )


def _lines(runs: Any, found: Mapping[str, Mapping[str, float]]) -> list[str]:
    failed = int((runs["outcome"].values != 0).sum())
    head = f"wheels {runs.attrs['strategy']}: {runs.sizes['run']} runs"
    head += f", {failed} of them could not be computed" if failed else ""
    return [head, *_shown(found)]


def _not_told(data: Any) -> list[str]:
    return [data.attrs["not_told"]] if data.attrs.get("not_told") else []


def strategies_summary(table: Any) -> Summary:
    """Estimates of each strategy."""
    found, lines = {}, []
    for name in table["strategy"].values:
        at = table.sel(strategy=name)
        parts = (at["quantity"].values, at["value"].values, at["error"].values)
        found[str(name)] = {
            str(q): {"value": float(v), "error": float(e)}
            for q, v, e in zip(*parts, strict=True)
            if np.isfinite(v)
        }
        lines += [f"wheels {name}: {table.attrs['runs']} runs", *_shown(found[str(name)])]
    keys = ("runs", "seed", "candidates")
    numbers = {key: int(table.attrs[key]) for key in keys} | {
        "not_told": table.attrs["not_told"],
        "strategies": found,
    }
    return Summary(numbers, lines, _not_told(table))


def landing_summary(tree: Any) -> Summary:
    """The same, with the runs that could not be computed."""
    told = strategies_summary(tree["strategies"].to_dataset())
    lines: list[str] = []
    for name, runs in runs_of(tree).items():
        lines += _lines(runs, told["strategies"][name])
    numbers = dict(told)
    if "collision" in tree:
        numbers["collision"] = found = collision_summary(tree["collision"].to_dataset())
        lines += found.lines
    return Summary(numbers, lines, told.notes)


def runs_of(tree: Any) -> dict[str, xr.Dataset]:
    """The runs of each strategy, in the order of the strategies."""
    return {
        str(name): tree[f"runs/{name}"].to_dataset()
        for name in tree["strategies"]["strategy"].values
    }


def outcomes_drawings(runs: Any, _: Context) -> Iterator[Drawing]:
    return runs_drawings({str(runs.attrs["strategy"]): runs})


def strategies_drawings(table: Any, _: Context) -> Iterator[Drawing]:
    from sunspin.output.figures import outcomes as figures

    yield Drawing(
        "strategies",
        lambda: figures.strategies_figure(table),
        "What touches first, on what it rests, antenna, speeds and height of the Sun for each command to the wheel.",
        "Means over the runs; bars: one standard error.",
    )


def runs_drawings(runs: Mapping[str, xr.Dataset]) -> Iterator[Drawing]:
    """Figures of the runs of some strategies, those for which the runs tell enough."""
    from sunspin.output.figures import outcomes as figures

    yield Drawing(
        "sun-height",
        lambda: figures.sun_height_figure(runs),
        "Probability density of the height of the Sun over the lander between collision and landing, one curve per command to the "
        "wheel.",
        "How the Sun stood between collision and landing: r_z is 1 with the Sun overhead, -1 underneath; bars: one standard error.",
    )
    if all(np.isfinite(found["up_z"]).any() for found in runs.values()):
        yield Drawing(
            "distributions",
            lambda: figures.distributions_figure(runs),
            "Distributions of the z axis against the ground's normal, the fastest leg tip and the antenna's share of the time.",
            "At the landing and on the way to it, over the runs of each command to the wheel; bars: one standard error.",
        )
    if all("point_kind" in found.coords for found in runs.values()):
        yield Drawing(
            "first-contact",
            lambda: figures.first_contact_figure(runs),
            "Probability of each leg and panel to touch the ground first, by command to the wheel.",
            "What touches the ground first; a corner that panels share counts for each of them; bars: one standard error of the "
            "simulation.",
        )


def landing_drawings(tree: Any, context: Context) -> Iterator[Drawing]:
    yield from strategies_drawings(tree["strategies"].to_dataset(), context)
    yield from runs_drawings(runs_of(tree))
    if "collision" in tree:
        yield from collision_drawings(tree["collision"].to_dataset(), context)


def landing_datasets(tree: Any, _: Context) -> dict[str, xr.Dataset]:
    """The runs of each strategy and their comparison, a file each."""
    runs = {f"outcomes-{name.replace(':', '-')}": data for name, data in runs_of(tree).items()}
    return {"strategies": tree["strategies"].to_dataset()} | runs


def strategies_tables(table: Any) -> Iterator[Table]:
    """A row for each quantity, a column for each strategy: mean and one standard error over the runs."""
    import pandas as pd

    rows = []
    for name in table["quantity"].values.astype(str):
        about, at = quantity(name), table.sel(quantity=name)
        if np.isfinite(at["value"]).any():
            values, errors = at["value"].values * about.scale, at["error"].values * about.scale
            texts = [with_sigma(v, e) for v, e in zip(values, errors, strict=True)]
            rows.append([name, capital(about.heading), *texts])
    names = table["strategy"].values.astype(str)
    frame = pd.DataFrame(rows, columns=["quantity", "what", *names])
    shown = {"what": "quantity"} | {name: strategy_name(name) for name in names}
    yield Table("strategies", frame, "Commands to the wheel (one standard error)", shown)


def landing_tables(tree: Any) -> Iterator[Table]:
    return strategies_tables(tree["strategies"].to_dataset())


STRATEGY_NAMES = {
    "off": "off at touchdown",
    "held": "held at speed",
    "brake": "braked at touchdown",
    "after_rest": "held, off after rest",
}


def strategy_name(name: str) -> str:
    """A command to the wheel in plain words."""
    if name.startswith("delay:"):
        return f"off after {float(name[6:]) / 60:g} min"
    return STRATEGY_NAMES.get(name, name)
