"""What follows the collision: the Sun's height, what touches first, and other commands to the wheel side by side."""

from __future__ import annotations

import numpy as np
import xarray as xr

from sunspin.landing.tally import ONE_PANEL, QUANTITIES, Estimate, quantity, tally
from sunspin.output.report.drawn import drawn
from sunspin.output.report.read import Results
from sunspin.output.report.section import Section, Table
from sunspin.output.text import capital, with_sigma
from sunspin.telemetry.case import case_names

STRATEGY_NAMES = {
    "off": "off at touchdown",
    "held": "held at speed",
    "brake": "braked at touchdown",
    "after_rest": "held, off after rest",
}

LISTED = (
    "touch_leg",
    "touch_panel",
    "rest_leg",
    "leg_tip_speed",
    "antenna_at_rest",
    "rz_time_below_-0.5",
    "rate_after",
)
"""Quantities of a comparison."""


def strategy_name(name: str) -> str:
    """A command to the wheel in plain words."""
    if name.startswith("delay:"):
        return f"off after {float(name[6:]) / 60:g} min"
    return STRATEGY_NAMES.get(name, name)


def outcomes(results: Results) -> Section | None:
    """Densities of the Sun's height, first contact, rest."""
    found = list(results.runs().items())
    if not found:
        return None
    items = [*drawn(results, "outcomes"), _numbers({name: tally(runs) for name, runs in found})]
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
    return Section(
        "outcomes", "What the collision led to", [*lead, *([missing] if missing else [])], items
    )


def _numbers(told: dict[str, dict[str, Estimate]]) -> Table:
    known = {q for found in told.values() for q in found}
    listed = [*QUANTITIES, *sorted(q for q in known if q.startswith(ONE_PANEL))]
    rows = [
        [capital(quantity(q).heading), *(_pair(q, found.get(q)) for found in told.values())]
        for q in listed
        if q in known
    ]
    return Table(
        ["quantity", *map(strategy_name, told)],
        rows,
        "In numbers (one standard error)",
        closed=True,
    )


def strategies(results: Results) -> Section | None:
    """Commands to the wheel side by side: one small plot per quantity, common rows."""
    table = results.first("value", "error", "gain")
    if table is None or not {"strategy", "quantity"} <= set(table.dims):
        return None
    known = [
        q
        for q in LISTED
        if q in table["quantity"].values and np.isfinite(table["value"].sel(quantity=q)).any()
    ]
    names = [str(name) for name in table["strategy"].values]
    if not known or len(names) < 2:
        return None
    runs = int(table.attrs.get("runs", 0))
    lead = [
        f"The same {runs} draws for every command, so that differences are known better than the values."
    ]
    if table.attrs.get("vehicle") in case_names():  # of another lander nobody told
        lead[0] += " Switching the wheel off at the touchdown is what was flown."
    rows = [
        [capital(quantity(q).heading), *(_value(table, name, q) for name in names)] for q in known
    ]
    numbers = Table(
        ["quantity", *map(strategy_name, names)], rows, "In numbers (one standard error)"
    )
    return Section(
        "strategies",
        "What the wheel could have been told instead",
        lead,
        [*drawn(results, "strategies"), numbers],
    )


def _pair(name: str, found: Estimate | None) -> str:
    """A value with its error, never broken between two lines: the table scrolls instead."""
    if found is None or not np.isfinite(found.value):
        return "–"
    scale = quantity(name).scale
    return with_sigma(scale * found.value, scale * found.error).replace(" ", "\u00a0")


def _value(table: xr.Dataset, strategy: str, name: str) -> str:
    at = table.sel(strategy=strategy, quantity=name)
    return _pair(name, Estimate(float(at["value"]), float(at["error"])))
