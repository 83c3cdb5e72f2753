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
SPEED = ("constrained_speed", "speed_sigma", "speed_below")
"""Check of the speed, its error and its 95 % upper limit (rad/s, all solutions counted), the last columns."""
OF_A_MOTION = tuple(
    "speed_low speed_median speed_high omega_x omega_y omega_z sigma_x sigma_y sigma_z".split()
)
"""rad/s; each has a column in deg/s too."""


def pass_numbers(result: Any, k: int) -> dict[str, Any]:
    """What a summary says of pass number `k` of a Dataset with the variables of :func:`sunspin.estimate.passes.table`."""
    later = (name for name in (*ADDED, *SPEED) if name in result)
    names = (*OF_A_PASS, *BELIEVED, "why_not_decided", *later)
    values: dict[str, Any] = {name: result[name].values[k].item() for name in names}
    return {"pass_id": int(result["pass_id"].values[k])} | values | in_degrees(values)


def motion_numbers(result: Any, k: int, solution: int) -> dict[str, Any]:
    """The same of one of its motions."""
    rates: dict[str, Any] = {name: float(result[name].values[k, solution]) for name in OF_A_MOTION}
    probability = float(result["probability"].values[k, solution])
    return {"solution": solution, "probability": probability} | rates | in_degrees(rates)


def in_degrees(columns: dict[str, Any]) -> dict[str, Any]:
    """The columns in rad/s, named in deg/s."""
    named = (*OF_A_MOTION, *SPEED[1:])
    rates = [name for name in columns if name.endswith("_rad_s") or name in named]
    return {name.removesuffix("_rad_s") + "_deg_s": np.degrees(columns[name]) for name in rates}


SHOWN = {"pass_id": "pass", "utc_start": "begins (UTC)"}
SHOWN |= {name: name for name in ("samples", "solution", "probability")}
SHOWN |= {"speed_median_deg_s": "speed (deg/s)"}
for axis in "xyz":
    SHOWN |= {f"omega_{axis}_deg_s": f"ω{axis} (deg/s)", f"sigma_{axis}_deg_s": "±"}
SHOWN |= {"decided": "decided", "why_not_decided": "why not", "model": "model of the motion"}
"""Columns on the page."""


def passes_table(result: Any) -> Table:
    """A row for each solution of each pass."""
    import pandas as pd

    rows = []
    for k in range(result.sizes["pass_id"]):
        known = pass_numbers(result, k)
        for solution in np.flatnonzero(np.isfinite(result["probability"].values[k])):
            rows.append(known | motion_numbers(result, k, int(solution)))
    head = ("pass_id", *OF_A_PASS, "solution", "probability", *BELIEVED, *OF_A_MOTION)
    head += (*(f"{name}_deg_s" for name in OF_A_MOTION), *ADDED, "why_not_decided")
    head += (*SPEED, *(f"{name}_deg_s" for name in SPEED[1:]))
    frame = pd.DataFrame(rows)
    frame = frame[[name for name in head if name in frame]]
    shown = {name: heading for name, heading in SHOWN.items() if name in frame}
    return Table("passes", frame, "Every solution of every pass", shown)
