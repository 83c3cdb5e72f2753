"""`passes.csv`, and the same names in `summary.json`: a row for every motion of every pass, of `rates` and of `posterior`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sunspin.output.folder import write_whole
from sunspin.output.kinds.kind import synthetic_label

OF_A_PASS = ("utc_start", "utc_end", "samples")
BELIEVED = (
    "decided",
    "unique",
    "informed_x",
    "informed_y",
    "informed_z",
    "fits",
    "search_complete",
    "wiring",
    "utc_at",
)
ADDED = ("model", "model_weight")
"""Columns of a pass that came later, after all others, as scripts read those by place; `posterior` has no models."""
OF_A_MOTION = (
    "speed_low",
    "speed_median",
    "speed_high",
    "omega_x",
    "omega_y",
    "omega_z",
    "sigma_x",
    "sigma_y",
    "sigma_z",
)
"""rad/s; each has a column in deg/s too."""


def pass_numbers(found: Any, k: int) -> dict[str, Any]:
    """What a summary says of pass number `k` of a Dataset with the variables of :func:`sunspin.estimate.passes.table`."""
    names = (*OF_A_PASS, *BELIEVED, "why_not_decided", *(name for name in ADDED if name in found))
    told = {name: found[name].values[k].item() for name in names}
    return {"pass_id": int(found["pass_id"].values[k])} | told


def motion_numbers(found: Any, k: int, mode: int) -> dict[str, Any]:
    """The same of one of its motions."""
    told = {name: float(found[name].values[k, mode]) for name in OF_A_MOTION}
    return (
        {"mode": mode, "weight": float(found["weight"].values[k, mode])} | told | in_degrees(told)
    )


def in_degrees(told: dict[str, Any]) -> dict[str, Any]:
    return {f"{name}_deg_s": float(np.degrees(value)) for name, value in told.items()}


def write_passes(found: Any, folder: Path, label: Any) -> None:
    """Write `passes.csv`; `label`: the result that says whether the telemetry is synthetic."""
    import pandas as pd

    rows = []
    for k in range(found.sizes["pass_id"]):
        told = pass_numbers(found, k)
        for mode in np.flatnonzero(np.isfinite(found["weight"].values[k])):
            motion = motion_numbers(found, k, int(mode))
            first = ("pass_id", *OF_A_PASS)
            rows.append(
                {name: told[name] for name in first}
                | {name: motion[name] for name in ("mode", "weight")}
                | {name: told[name] for name in BELIEVED}
                | motion
                | {name: told[name] for name in ADDED if name in told}
            )
    text = synthetic_label(label) + pd.DataFrame(rows).to_csv(index=False, float_format="%.9g")
    write_whole(folder / "passes.csv", lambda part: part.write_text(text, "utf-8"))
