"""What follows the collision: the Sun's height, what touches first, and other commands to the wheel side by side."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from sunspin.landing.tally import tally
from sunspin.output.report.drawn import drawn
from sunspin.output.report.read import Results
from sunspin.output.report.section import Section, Table
from sunspin.telemetry.case import case_names

STRATEGY_NAMES = {
    "off": "off at touchdown", "held": "held at speed", "brake": "braked at touchdown", "after_rest": "held, off after rest",
}  # fmt: skip

QUANTITIES = (
    ("touch_leg", "A leg touches first"),
    ("touch_panel", "A panel touches first"),
    ("rest_leg", "Comes to rest on its legs"),
    ("leg_tip_speed", "Fastest leg tip at contact, m/s"),
    ("antenna_at_rest", "Antenna holds the orbiter at rest"),
    ("rz_time_below_-0.5", "Upside down to the Sun (r_z < -0.5)"),
    ("rate_after", "Angular speed after the collision, deg/s"),
)
"""What is listed of a comparison: name, heading; rates stand in files in rad/s."""


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
    return Section("outcomes", "What the collision led to", [*lead, *([missing] if missing else [])], items)


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
    lead = [f"The same {runs} draws for every command, so that differences are known better than the values."]
    if table.attrs.get("vehicle") in case_names():  # of another lander nobody told
        lead[0] += " Switching the wheel off at the touchdown is what was flown."
    rows = [[text, *(_value(table, name, q, text) for name in names)] for q, text in known]
    numbers = Table(["quantity", *map(strategy_name, names)], rows, "In numbers (one standard error)")
    return Section("strategies", "What the wheel could have been told instead", lead, [*drawn(results, "strategies"), numbers])


def _pair(value: float, error: float, decimals: int) -> str:
    """A value with its error, never broken between two lines: the table scrolls instead."""
    return f"{value:.{decimals}f}\u00a0±\u00a0{error:.{decimals}f}"


def _value(table: xr.Dataset, name: str, quantity: str, text: str) -> str:
    unit = float(np.degrees(1.0)) if text.endswith("deg/s") else 1.0
    value, error = (unit * float(table[part].sel(strategy=name, quantity=quantity)) for part in ("value", "error"))
    return _pair(value, error, 3) if np.isfinite(value) else "not told"
