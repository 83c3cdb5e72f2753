"""Body rates of passes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from sunspin.environment.frames import J2000, SUN_Z_LOCAL
from sunspin.estimate.terms.period import reading_words, unheard
from sunspin.output.kind import Context, Drawing, Summary, Table, synthetic_note
from sunspin.output.kinds.passes import in_degrees, motion_numbers, pass_numbers, passes_table
from sunspin.output.kinds.rate_words import clock_of, rate_at
from sunspin.output.text import digits_of
from sunspin.vehicle.timeline import utc_after

AS_STATED = "as stated"
"""The model of a pass that nothing was added to."""

MOST_UNSEEN = 6
"""Changes that look the same as the file as it is written, at most, that are named."""


def rates_summary(result: Any) -> Summary:
    """The verdict, and the motions of each pass, deg/s."""
    found = [_pass(result, k) for k in range(result.sizes["pass_id"])]
    texts, counts = np.unique(result["why"].values, return_counts=True)
    numbers: dict[str, Any] = {
        "verdict": result.attrs["verdict"],
        "source": result.attrs["source"],
        "passes": [numbers for numbers, _ in found],
        "acceleration_noise": result.attrs["acceleration_noise"],
        "max_rate_deg_s": float(np.degrees(result.attrs["max_rate_rad_s"])),
        "samples": {str(text): int(count) for text, count in zip(texts, counts, strict=True)},
        "synthetic_telemetry": bool(result.attrs.get("synthetic", 0)),
        "panels_left_out": [
            name for name in result.attrs.get("panels_left_out", "").split(", ") if name
        ],
    }
    lines = [result.attrs["verdict"], *(line for _, line in found)]
    if "periods" in result.attrs:
        numbers["periods"] = json.loads(result.attrs["periods"])
        lines += [f"  {_period(result, one)}" for one in numbers["periods"]]
    counted = [f"  {count:6d} samples  {text}" for text, count in zip(texts, counts, strict=True)]
    silent = [
        f"  panel {', '.join(numbers['panels_left_out'])} never reads anything: dead, or never in the Sun; left out"
    ]
    lines += silent if numbers["panels_left_out"] else []
    numbers |= {
        name: result.attrs[name] for name in ("noise", "noise_from") if name in result.attrs
    }
    if numbers.get("noise_from", "given") != "given":
        lines.append(
            f"  error of panel readings: {numbers['noise']:.3g} (median), {numbers['noise_from']}"
        )
    return Summary(numbers, [*lines, *_columns_unseen(result, numbers["passes"]), *counted])


def _period(result: Any, one: dict[str, Any]) -> str:
    """What a period decides in its pass, in words."""
    k = int(np.flatnonzero(result["pass_id"].values == one["pass"])[0])
    if why_not := unheard(one["nearest_sigmas"], one["effective"], f"pass {one['pass']}"):
        return f"{why_not}; its probabilities stay as they are"
    if not one["told"]:
        return (
            f"periods: the samples of pass {one['pass']} speak against {one['period_s']:g} s at {one['t_s']:g} s: motions that "
            f"have it hold {one['carried']:.1%} of the probability, which stays as it is"
        )
    said = reading_words(one["t_s"], one["period_s"], one["sigma_s"], one["shares"])
    own, heaviest = one["without"]
    was = f"{own:.0%}" if own == heaviest else f"{own:.0%}, when another held {heaviest:.0%}"
    return f"{said}; in pass {one['pass']} the likeliest motion holds {result['probability'].values[k, 0]:.0%} (without: {was})"


def _columns_unseen(result: Any, passes: list[dict[str, Any]]) -> list[str]:
    """Changes of columns that look the same in the telemetry as the file as it is written, with the rates of the first decided
    pass."""
    sure = [
        k
        for k, one in enumerate(passes)
        if one["decided"] and one["columns_checked"] == "unchecked"
    ]
    if not sure or "columns_unseen" not in result.attrs:
        return []
    rate = rate_at(result, sure[0])
    digits = digits_of(rate.sigma)

    def shown(omega: np.ndarray) -> str:
        return f"({', '.join(f'{value:z.{digits}f}' for value in omega)})"

    unseen = []
    for one in json.loads(result.attrs["columns_unseen"]):
        matrix = np.array(one["matrix"])
        unseen.append(
            f"with {one['what']} it would be {shown(np.linalg.det(matrix) * matrix @ rate.omega)} deg/s"
        )
    more = (
        f"; and with {len(unseen) - MOST_UNSEEN} other changes another"
        if len(unseen) > MOST_UNSEEN
        else ""
    )
    return [
        f"  columns unchecked: the file as it is written gives {shown(rate.omega)} deg/s at {clock_of(result, rate.at_s)}; this "
        f"telemetry looks the same if the file is wrong in one of these ways: {'; '.join(unseen[:MOST_UNSEEN])}{more}"
    ]


def _pass(result: Any, k: int) -> tuple[dict[str, Any], str]:
    at = np.flatnonzero(result["pass_of"].values == k)
    t = result["time"].values[at]
    n = int(np.isfinite(result["probability"].values[k]).sum())
    sigma = np.degrees(result["omega_sigma_all_B"].values[k])
    mean = np.degrees(result["omega_mean_B"].values[k, :n])
    probability = result["probability"].values[k, :n]
    numbers = pass_numbers(result, k)
    numbers |= {
        "start_s": float(t[0]),
        "end_s": float(t[-1]),
        "sigma_deg_s": sigma.tolist(),
        "solutions": [
            {"omega_deg_s": m.tolist()} | motion_numbers(result, k, i) for i, m in enumerate(mean)
        ],
    }
    others = f", {n - 1} other{'s' if n > 2 else ''}" if n > 1 else ""
    rate = rate_at(result, k)
    numbers |= {
        "speed_deg_s": [rate.low, rate.mean, rate.high],
        "at_s": rate.at_s,
        "omega_at_deg_s": rate.omega.tolist(),
    }
    best = (
        f"speed {rate.speed} deg/s; omega {rate.components} deg/s at {clock_of(result, rate.at_s)}"
    )
    best += f"  probability {probability[0]:.2f}{others}  {numbers['why_not_decided'] or 'decided'}"
    if numbers.get("model", AS_STATED) != AS_STATED:
        best += f"  likeliest: {numbers['model']} (probability {numbers['model_probability']:.2f})"
    return numbers, f"  {t[0]:z10.0f} s  {len(at):3d} samples  {best}"


def rates_drawings(result: Any, context: Context) -> Iterator[Drawing]:
    from sunspin.output.figures.rates import rates_figure

    yield Drawing(
        "rates",
        lambda: rates_figure(result, context.telemetry),
        "The three components of the body rate against time in each pass, with bands of one sigma.",
        f"Body rate of the likeliest motion of each pass, body axes; bands: one sigma of that motion. {_decided(result)}"
        + synthetic_note(result),
    )
    if result.attrs.get("frame_N") == J2000 and "turn_sigma_rad" in result:
        from sunspin.output.figures.rates import attitude_figure

        yield Drawing(
            "attitude",
            lambda: attitude_figure(result),
            "The four components of the attitude quaternion against time in each pass.",
            "Attitude of the likeliest solution of each pass: rotation from J2000 to body axes, scalar last (w). Above each pass "
            "the root mean square of the angle by which it may be off." + synthetic_note(result),
        )
    if "residual" in result:
        from sunspin.output.figures.residuals import residuals_figure

        yield Drawing(
            "residuals",
            lambda: residuals_figure(result),
            "Residuals of each sensor in sigmas against time in each pass, with the limit of three sigma.",
            "Size of the difference between readings and what the likeliest solution predicts, all numbers of a reading together, "
            "in sigmas of what was assumed: noise, and of panels also other light. Farther out than six: at the edge. A wave, or "
            "many readings beyond three sigma, speak against the solution."
            + synthetic_note(result),
        )
    if context.telemetry is None or context.vehicle is None:
        return
    from sunspin.output.curves import dense
    from sunspin.output.figures.panel_signals import panel_signals_figure

    samples, vehicle = context.telemetry, context.craft()
    runs = dense(result)
    if "panel" in samples.coords and runs:
        yield Drawing(
            "signals",
            lambda: panel_signals_figure(samples, runs, vehicle),
            "Signal of each panel against time in up to four passes: samples as dots, the solution's prediction as a line.",
            "Panel signals of the passes with the most samples: dots are samples, lines what the likeliest solution predicts, with "
            "one factor for each pass." + synthetic_note(result),
        )


def _decided(result: Any) -> str:
    sure = result["decided"].values
    others = (
        "" if sure.all() else "; of the others look at what is said of each, and at all motions"
    )
    return f"{int(sure.sum())} of {sure.size} passes are decided{others}."


def rates_tables(result: Any) -> Iterator[Table]:
    import pandas as pd

    epoch = result.attrs.get("epoch_utc")
    utc = ["" if epoch is None else utc_after(float(t), epoch, 3) for t in result["time"].values]
    columns: dict[str, Any] = {
        "time_s": result["time"].values,
        "utc": utc,
        "pass": result["pass_of"].values,
    }
    columns["pass_id"] = result["pass_id"].values[result["pass_of"].values]
    for k, axis in enumerate("xyz"):
        columns[f"omega_{axis}_B_rad_s"] = result["omega_B"].values[:, k]
        columns[f"sigma_{axis}_rad_s"] = np.sqrt(result["omega_cov_B"].values[:, k, k])
    columns |= in_degrees(columns)
    for k, axis in enumerate("xyz"):
        columns[f"sun_{axis}_B"] = result["sun_B"].values[:, k]
    for k, part in enumerate("xyzw"):
        columns[f"q_{part}_B_from_N"] = result["B_from_N"].values[:, k]
    columns["sun_sigma_rad"] = result["sun_sigma_rad"].values
    if "turn_sigma_rad" in result:  # the root mean square of the angle by which the attitude is off
        angles = result["sun_sigma_rad"].values, result["turn_sigma_rad"].values
        columns["attitude_sigma_rad"] = np.hypot(*angles)
    frame = (
        "z to the Sun, local"
        if result.attrs.get("frame_N") == SUN_Z_LOCAL
        else result.attrs.get("frame_N")
    )
    comment = f"time_s from {epoch}; best motion of each pass; body axes; N: {frame}"
    yield passes_table(result)
    if result.sizes.get("estimate"):
        frame = (
            result[["estimate_value", "estimate_sigma", "estimate_unit"]]
            .to_dataframe()
            .reset_index()
            .dropna()
        )
        shown = {"pass_id": "pass", "estimate": "estimate", "estimate_value": "value"}
        shown |= {"estimate_sigma": "±", "estimate_unit": "unit"}
        yield Table("estimates", frame, "Estimated with the motion", shown)
    yield Table("rates", pd.DataFrame(columns), comment=comment)
