"""The rate against time in short windows of passes that no free body explains: lines, figure and table."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sunspin.output.kind import Drawing, Table
from sunspin.vehicle.timeline import utc_after


def window_lines(result: Any) -> list[str]:
    """Return lines on the passes whose rate is given in short windows; empty if there are none."""
    if "window_time" not in result:
        return []
    lines, decided = [], result["window_decided"].values
    for pass_id in np.unique(result["window_pass"].values):
        inside = result["window_pass"].values == pass_id
        lines.append(
            f"  pass {pass_id}: no free motion fits, so windows.csv has the rate in {inside.sum()} short windows, "
            f"{int(decided[inside].sum())} of them decided"
        )
    return lines


def window_numbers(result: Any) -> dict[str, Any]:
    """Return the entries of the summary: `controlled`, in words by pass, and `windows`, rates in deg/s; empty if there are none."""
    if "window_time" not in result:
        return {}
    columns = {
        "pass_id": result["window_pass"].values,
        "time_s": result["window_time"].values,
        "samples": result["window_samples"].values,
        "omega_deg_s": np.degrees(result["window_omega_B"].values),
        "sigma_deg_s": np.degrees(result["window_sigma_B"].values),
        "decided": result["window_decided"].values,
        "why_not_decided": result["window_why"].values.astype(str),
    }
    windows = [
        {name: values[k].tolist() for name, values in columns.items()}
        for k in range(result.sizes["window"])
    ]
    controlled = [line for line in str(result.attrs.get("controlled", "")).split("\n") if line]
    return {"controlled": controlled, "windows": windows}


def window_tables(result: Any) -> Iterator[Table]:
    """Yield the table `windows`, a row for each window, if there are any."""
    import pandas as pd

    if "window_time" not in result:
        return
    epoch = str(result.attrs.get("epoch_utc", ""))
    omega, sigma = result["window_omega_B"].values, result["window_sigma_B"].values
    time = result["window_time"].values
    columns: dict[str, Any] = {
        "pass_id": result["window_pass"].values,
        "time_s": time,
        "utc": [utc_after(float(t), epoch, 3) if epoch else "" for t in time],
        "begin_s": result["window_begin"].values,
        "end_s": result["window_end"].values,
        "samples": result["window_samples"].values,
    }
    for unit, factor in (("rad_s", 1.0), ("deg_s", np.degrees(1.0))):
        columns |= {f"omega_{axis}_B_{unit}": factor * omega[:, k] for k, axis in enumerate("xyz")}
        columns |= {f"sigma_{axis}_{unit}": factor * sigma[:, k] for k, axis in enumerate("xyz")}
        columns[f"speed_{unit}"] = factor * np.linalg.norm(omega, axis=1)
        columns[f"speed_sigma_{unit}"] = factor * result["window_speed_sigma"].values
    columns["decided"] = result["window_decided"].values
    why = result["window_why"].values.astype(str)
    columns["why_not_decided"] = why
    shown = {
        "pass_id": "pass",
        "utc": "middle (UTC)",
        "samples": "samples",
        "speed_deg_s": "speed, deg/s",
        "speed_sigma_deg_s": "±",
        "decided": "decided",
        "why_not_decided": "why not",
    }
    comment = f"time_s from {epoch}; most probable solution of each window; body axes"
    title = "Rate in short windows of passes that no free motion fits"
    yield Table("windows", pd.DataFrame(columns), title, shown, comment=comment)


def window_drawings(result: Any) -> Iterator[Drawing]:
    """Yield the figure of the rate in windows, if there are any."""
    from sunspin.output.figures.windows import windows_figure

    if "window_time" not in result:
        return
    yield Drawing(
        "windows",
        lambda: windows_figure(result),
        "Body rate in short windows against time, with error bars of one sigma.",
        "Body rate in short windows of the passes that no free motion fits, each fitted by itself. Filled: decided. Open: not "
        "decided; windows.csv says why.",
    )
