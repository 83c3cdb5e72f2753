"""`passes.csv` of `rates` and `posterior`, a row for each solution of each pass, with the same names in `summary.json`."""

from __future__ import annotations

from typing import Any

import numpy as np

from sunspin.output.kind import Table

PASS = ("utc_start", "utc_end", "samples")
"""Columns of a pass."""

CHECKS = tuple(
    "decided unique constrained_x constrained_y constrained_z fits search_complete columns_checked utc_at".split()
)
"""Columns of a pass: verdict, the checks on which it depends, and the time (UTC) of the rates."""

MODEL = ("model", "model_probability")
"""Columns of a pass: the likeliest alternative model. They stand after all others, because scripts read the columns before by
position. `posterior` has no alternative models."""

SPEED = ("constrained_speed", "speed_sigma", "speed_below")
"""Columns of a pass, the last ones: whether the speed is constrained, its sigma and 95 % upper limit (rad/s, all solutions)."""

SPEED_RATES = SPEED[1:]
"""Those of `SPEED` that are in rad/s and have a second column in deg/s."""

SOLUTION = tuple(
    "speed_low speed_median speed_high omega_x omega_y omega_z sigma_x sigma_y sigma_z".split()
)
"""Columns of a solution, rad/s; each has a second column in deg/s."""


def pass_numbers(result: Any, k: int) -> dict[str, Any]:
    """Return the entries of a summary on pass number `k`.

    `result`: a Dataset with the variables of :func:`sunspin.estimate.verdict.passes_table`. Rates are in rad/s and deg/s.
    """
    optional = (name for name in (*MODEL, *SPEED) if name in result)
    names = (*PASS, *CHECKS, "why_not_decided", *optional)
    values: dict[str, Any] = {name: result[name].values[k].item() for name in names}
    return {"pass_id": int(result["pass_id"].values[k])} | values | rates_in_degrees(values)


def solution_numbers(result: Any, k: int, solution: int) -> dict[str, Any]:
    """Return the entries of a summary on one solution of pass number `k`."""
    rates: dict[str, Any] = {name: float(result[name].values[k, solution]) for name in SOLUTION}
    probability = float(result["probability"].values[k, solution])
    return {"solution": solution, "probability": probability} | rates | rates_in_degrees(rates)


def rates_in_degrees(columns: dict[str, Any]) -> dict[str, Any]:
    """Return copies in deg/s, with names that end in `_deg_s`, of all columns that are in rad/s.

    A column is in rad/s if its name ends in `_rad_s`, or is one of `SOLUTION` and `SPEED_RATES`.
    """
    return {
        name.removesuffix("_rad_s") + "_deg_s": np.degrees(value)
        for name, value in columns.items()
        if name.endswith("_rad_s") or name in (*SOLUTION, *SPEED_RATES)
    }


SHOWN = {"pass_id": "pass", "utc_start": "begins (UTC)"}
SHOWN |= {name: name for name in ("samples", "solution", "probability")}
SHOWN |= {"speed_median_deg_s": "speed (deg/s)"}
for axis in "xyz":
    SHOWN |= {f"omega_{axis}_deg_s": f"ω{axis} (deg/s)", f"sigma_{axis}_deg_s": "±"}
SHOWN |= {"decided": "decided", "why_not_decided": "why not", "model": "model of the motion"}
"""Columns that the page shows -> their headings."""


def passes_table(result: Any) -> Table:
    """Return the table `passes`: a row for each solution of each pass."""
    import pandas as pd

    rows = []
    for k in range(result.sizes["pass_id"]):
        of_pass = pass_numbers(result, k)
        # a pass with fewer solutions than others is padded with NaN
        for solution in np.flatnonzero(np.isfinite(result["probability"].values[k])):
            rows.append(of_pass | solution_numbers(result, k, int(solution)))
    # the order of the columns is public: new ones are added at the end
    columns = ("pass_id", *PASS, "solution", "probability", *CHECKS, *SOLUTION)
    columns += (*(f"{name}_deg_s" for name in SOLUTION), *MODEL, "why_not_decided")
    columns += (*SPEED, *(f"{name}_deg_s" for name in SPEED_RATES))
    frame = pd.DataFrame(rows)
    frame = frame[[name for name in columns if name in frame]]
    headings = {name: heading for name, heading in SHOWN.items() if name in frame}
    return Table("passes", frame, "Every solution of every pass", headings)
