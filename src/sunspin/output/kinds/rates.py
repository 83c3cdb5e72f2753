"""Body rates of passes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from sunspin.output.folder import write_whole
from sunspin.output.kinds.kind import Beside, Drawing, Summary, synthetic_label, synthetic_note
from sunspin.output.kinds.rate_words import clock_of, rate_at

READ = {"power_W", "current_A", "sun_sensor_B", "gyro_B"}
"""Variables of telemetry of which residuals are drawn."""


def rates_summary(result: Any) -> Summary:
    """The verdict, and the motions of each pass, deg/s."""
    found = [_pass(result, k) for k in range(result.sizes["pass_id"])]
    texts, counts = np.unique(result["why"].values, return_counts=True)
    numbers = {
        "verdict": result.attrs["verdict"], "source": result.attrs["source"], "passes": [numbers for numbers, _ in found],
        "acceleration_noise": result.attrs["acceleration_noise"],
        "max_rate_deg_s": float(np.degrees(result.attrs["max_rate_rad_s"])),
        "samples": {str(text): int(count) for text, count in zip(texts, counts, strict=True)},
        "synthetic_telemetry": bool(result.attrs.get("synthetic", 0)),
    }  # fmt: skip
    lines = [result.attrs["verdict"], *(line for _, line in found)]
    return Summary(numbers, lines + [f"  {count:6d}  {text}" for text, count in zip(texts, counts, strict=True)])


def _pass(result: Any, k: int) -> tuple[dict[str, Any], str]:
    at = np.flatnonzero(result["pass_of"].values == k)
    t = result["time"].values[at]
    n = int(np.isfinite(result["weight"].values[k]).sum())
    sigma = np.degrees(result["omega_sigma_all_B"].values[k])
    mean = np.degrees(result["omega_mean_B"].values[k, :n])
    weight = result["weight"].values[k, :n]
    numbers = {
        "start_s": float(t[0]), "end_s": float(t[-1]), "samples": len(at), "sigma_deg_s": sigma.tolist(),
        "modes": [{"weight": float(w), "omega_deg_s": m.tolist()} for w, m in zip(weight, mean, strict=True)],
    }  # fmt: skip
    poor = "  FITS BADLY" if result["cost"].values[k, 0] > result["cost_limit"].values[k] else ""
    others = f", {n - 1} other{'s' if n > 2 else ''}" if n > 1 else ""
    rate = rate_at(result, k)
    numbers |= {"speed_deg_s": [rate.low, rate.mean, rate.high], "at_s": rate.at_s, "omega_at_deg_s": rate.omega.tolist()}
    best = f"speed {rate.speed} deg/s; omega {rate.components} deg/s at {clock_of(result, rate.at_s)}"
    best += f"  weight {weight[0]:.2f}{others}{poor}"
    return numbers, f"  {t[0]:10.0f} s  {len(at):3d} samples  {best}"


def rates_drawings(result: Any, beside: Beside) -> Iterator[Drawing]:
    from sunspin.output.figures.rates import rates_figure

    yield Drawing(
        "rates", lambda: rates_figure(result, beside.telemetry),
        "The three components of the body rate against time in each pass, with bands of one sigma.",
        f"Body rate of the likeliest motion of each pass, body axes; bands: one sigma of that motion. {_decided(result)}"
        + synthetic_note(result),
    )  # fmt: skip
    if beside.telemetry is not None and beside.vehicle is not None and set(beside.telemetry.data_vars) & READ:
        from sunspin.output.figures.residuals import residuals_figure
        from sunspin.vehicle import Vehicle, load_vehicle

        samples, craft = beside.telemetry, beside.vehicle
        vehicle = craft if isinstance(craft, Vehicle) else load_vehicle(craft)
        yield Drawing(
            "residuals", lambda: residuals_figure(result, samples, vehicle),
            "Residuals of each sensor in sigmas against time in each pass, and their distribution beside that of the stated noise.",
            "Readings less what the likeliest motion predicts, in sigmas of their noise (grey: one sigma; farther out than six: at "
            "the edge). Right, a predictive check: bars are the residuals, the line is how they scatter if the motion is right and "
            "the noise as stated. A wave, or more readings beyond three sigma than noise makes, speaks against the motion. "
            "A sensor marked as not used was kept out of the fit." + synthetic_note(result),
        )  # fmt: skip


def _decided(result: Any) -> str:
    weight = np.nan_to_num(result["weight"].values[:, 0])
    sure = int((weight >= 0.9).sum())
    return f"It holds at least 90 % of the weight in {sure} of {weight.size} passes; in the others look at the list of motions too."


def rates_tables(result: Any, folder: Path, _: Beside) -> None:
    import pandas as pd

    columns: dict[str, np.ndarray] = {"time_s": result["time"].values, "pass": result["pass_of"].values}
    for k, axis in enumerate("xyz"):
        columns[f"omega_{axis}_B_rad_s"] = result["omega_B"].values[:, k]
        columns[f"sigma_{axis}_rad_s"] = np.sqrt(result["omega_cov_B"].values[:, k, k])
    for k, axis in enumerate("xyz"):
        columns[f"sun_{axis}_B"] = result["sun_B"].values[:, k]
    for k, part in enumerate("xyzw"):
        columns[f"q_{part}_B_from_N"] = result["B_from_N"].values[:, k]
    head = f"# time_s from {result.attrs.get('epoch_utc')}; best motion of each pass; body axes; N: z to the Sun, local\n"
    text = synthetic_label(result) + head + pd.DataFrame(columns).to_csv(index=False, float_format="%.9g")
    write_whole(folder / "rates.csv", lambda part: part.write_text(text, "utf-8"))
