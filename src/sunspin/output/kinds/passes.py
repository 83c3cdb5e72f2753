"""`passes.csv`, and the same names in `summary.json`: a row for every motion of every pass, of `rates` and of `posterior`."""

from __future__ import annotations

from typing import Any

import numpy as np

from sunspin.output.kind import Table

OF_A_PASS = ("utc_start", "utc_end", "samples")
BELIEVED = tuple(
    "decided unique constrained_x constrained_y constrained_z fits search_complete columns_checked utc_at".split()
)
ADDED = ("model", "model_probability")
"""Columns of a pass that came later, after all others, as scripts read those by place; `posterior` has no models."""
OF_A_MOTION = tuple(
    "speed_low speed_median speed_high omega_x omega_y omega_z sigma_x sigma_y sigma_z".split()
)
"""rad/s; each has a column in deg/s too."""


def pass_numbers(found: Any, k: int) -> dict[str, Any]:
    """What a summary says of pass number `k` of a Dataset with the variables of :func:`sunspin.estimate.passes.table`."""
    names = (*OF_A_PASS, *BELIEVED, "why_not_decided", *(name for name in ADDED if name in found))
    values = {name: found[name].values[k].item() for name in names}
    return {"pass_id": int(found["pass_id"].values[k])} | values


def motion_numbers(found: Any, k: int, solution: int) -> dict[str, Any]:
    """The same of one of its motions."""
    rates: dict[str, Any] = {name: float(found[name].values[k, solution]) for name in OF_A_MOTION}
    probability = float(found["probability"].values[k, solution])
    return {"solution": solution, "probability": probability} | rates | in_degrees(rates)


def in_degrees(columns: dict[str, Any]) -> dict[str, Any]:
    """The columns in rad/s, named in deg/s."""
    rates = {name: value for name, value in columns.items() if not name.endswith("_deg_s")}
    return {
        (name.removesuffix("_rad_s") + "_deg_s"): np.degrees(value)
        for name, value in rates.items()
        if name.endswith("_rad_s") or name in OF_A_MOTION
    }


SHOWN = {
    "pass_id": "pass",
    "utc_start": "begins (UTC)",
    "samples": "samples",
    "solution": "solution",
    "probability": "probability",
    "speed_median_deg_s": "speed (deg/s)",
    **{
        f"{what}_{axis}_deg_s": f"ω{axis} (deg/s)" if what == "omega" else "±"
        for axis in "xyz"
        for what in ("omega", "sigma")
    },
    "decided": "decided",
    "why_not_decided": "why not",
    "model": "model of the motion",
}
"""Columns on the page."""


def passes_table(found: Any) -> Table:
    """A row for each solution of each pass."""
    import pandas as pd

    rows = []
    for k in range(found.sizes["pass_id"]):
        known = pass_numbers(found, k)
        for solution in np.flatnonzero(np.isfinite(found["probability"].values[k])):
            motion = motion_numbers(found, k, int(solution))
            first = ("pass_id", *OF_A_PASS)
            last = (*(name for name in ADDED if name in known), "why_not_decided")
            rows.append(
                {name: known[name] for name in first}
                | {name: motion[name] for name in ("solution", "probability")}
                | {name: known[name] for name in BELIEVED}
                | motion
                | {name: known[name] for name in last}
            )
    frame = pd.DataFrame(rows)
    shown = {name: heading for name, heading in SHOWN.items() if name in frame}
    return Table("passes", frame, "Every solution of every pass", shown)
