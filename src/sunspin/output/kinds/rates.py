"""Body rates of passes."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from sunspin.environment.frames import J2000, SUN_Z_LOCAL
from sunspin.estimate.rates.hypotheses import AS_STATED
from sunspin.estimate.terms.period import reading_words, unheard
from sunspin.estimate.verdict import upper_text
from sunspin.output.kind import KINDS, Context, Drawing, Kind, Summary, Table
from sunspin.output.kinds.passes import in_degrees, motion_numbers, pass_numbers, passes_table
from sunspin.output.text import (
    clock_text,
    range_text,
    rate_text,
    size_text,
    starts_text,
    with_sigma,
)
from sunspin.vehicle.timeline import utc_after

MOST_UNSEEN = 6
"""Changes that look the same as the file as it is written, at most, that are named."""

RATE = "omega x, y, z at mid-pass, deg/s ± 1 sigma"
RANGE = "range over the pass"
"""What the speed's smallest and largest value in a pass are called: they are no error of the speed."""

HEADING = f"{'samples':>7}  {'speed, deg/s':17}  {RANGE:19}  {RATE:45}  prob  verdict"
"""Of the table of passes behind number and start: a line each. The speed is that at mid-pass with one sigma."""

PASSES_IN_WORDS = 3
"""Of the first passes a page has a sentence each; its table has all."""

COARSE, COARSE_WORD = 0.1, "decided, coarse"
"""A decided rate whose sigma exceeds this part of the speed is called coarse."""


class RateAt(NamedTuple):
    """The rate of the likeliest solution of a pass, deg/s: least, mean and largest speed over the pass; rate (3) and its sigma (3),
    all solutions counted, at the sample nearest to the middle, `at_s` s from the epoch.

    The mean rate is neither: of a body that tumbles, x and y average out, and the size of the mean is not the speed.
    """

    low: float
    mean: float
    high: float
    at_s: float
    omega: np.ndarray
    sigma: np.ndarray


def rate_at(result: Any, k: int) -> RateAt:
    """The rate of pass number `k` of a result of `rates`."""
    at = np.flatnonzero(result["pass_of"].values == k)
    t, omega = result["time"].values[at], np.degrees(result["omega_B"].values[at])
    speed = np.linalg.norm(omega, axis=1)
    middle = int(np.argmin(np.abs(t - (t[0] + t[-1]) / 2)))
    variance = np.diagonal(result["omega_cov_B"].values[at[middle]])
    every, best = result["omega_sigma_all_B"].values[k], result["omega_sigma_B"].values[k, 0]
    variance = variance + np.nan_to_num(np.maximum(every**2 - best**2, 0.0))  # of other solutions
    low, mean, high = float(speed.min()), float(speed.mean()), float(speed.max())
    return RateAt(low, mean, high, float(t[middle]), omega[middle], np.degrees(np.sqrt(variance)))


def rates_summary(result: Any) -> Summary:
    """The verdict, and the solutions of each pass, deg/s."""
    decided, *notes = result.attrs["verdict"].split("\n")
    number = result["pass_of"].values
    begins = [float(result["time"].values[number == k][0]) for k in range(result.sizes["pass_id"])]
    starts = starts_text(result, begins)
    width = max(map(len, ["start (UTC)", *starts]))
    table = [f"pass  {'start (UTC)':{width}}  {HEADING}"]
    passes, lines, in_words = [], [decided], []
    for k, start in enumerate(starts):
        numbers, row, sentence = _pass(result, k)
        passes.append(numbers)
        table.append(f"{numbers['pass_id']:4d}  {start:{width}}  {row}")
        in_words += [sentence] if k < PASSES_IN_WORDS else []
        if numbers.get("model", AS_STATED) != AS_STATED:
            chance = f"{numbers['model_probability']:.2f}"
            notes.append(
                f"pass {numbers['pass_id']}: alternative model {numbers['model']} (probability {chance})"
            )
    if any(row.endswith(COARSE_WORD) for row in table):
        notes.append(f"coarse: one sigma of a component exceeds {COARSE:.0%} of the speed")
    lines += [f"  {note}" for note in notes]
    texts, counts = np.unique(result["why"].values.astype(str), return_counts=True)
    left_out = str(result.attrs.get("panels_left_out", ""))
    numbers: dict[str, Any] = {
        "verdict": result.attrs["verdict"],
        "source": result.attrs["source"],
        "passes": passes,
        "acceleration_noise": result.attrs["acceleration_noise"],
        "max_rate_deg_s": float(np.degrees(result.attrs["max_rate_rad_s"])),
        "samples": dict(zip(texts.tolist(), counts.tolist(), strict=True)),
        "synthetic_telemetry": bool(result.attrs.get("synthetic", 0)),
        "panels_left_out": [name for name in left_out.split(", ") if name],
    }
    if "periods" in result.attrs:
        numbers["periods"] = json.loads(result.attrs["periods"])
        lines += [f"  {_period(result, period)}" for period in numbers["periods"]]
    if left_out:
        why = "no signal in any sample (failed, or never sunlit); excluded"
        lines.append(f"  panel {left_out}: {why}")
    numbers |= {key: result.attrs[key] for key in ("noise", "noise_from") if key in result.attrs}
    if numbers.get("noise_from", "given") != "given":
        size = size_text(numbers["noise"])
        lines.append(f"  error of panel readings: {size} (median), {numbers['noise_from']}")
    lines += _columns_unseen(result, passes)
    numbers["samples_in_passes"] = result.sizes["time"]
    if (kept := int(result.attrs.get("samples_searched", result.sizes["time"]))) < result.sizes[
        "time"
    ]:
        numbers["samples_searched"] = kept
        lines.append(
            f"  {result.sizes['time']} samples used in passes; the search keeps {kept} of them, the others refine what it finds"
        )
    lines += [f"  {count:6d} samples  {text}" for text, count in numbers["samples"].items()]
    return Summary(numbers, lines, table=table, in_words=in_words)


def _period(result: Any, period: dict[str, Any]) -> str:
    """What a period decides in its pass, in words."""
    k = int(np.flatnonzero(result["pass_id"].values == period["pass"])[0])
    if why_not := unheard(period["nearest_sigmas"], period["effective"], f"pass {period['pass']}"):
        return f"{why_not}; its probabilities stay as they are"
    if not period["told"]:
        return (
            f"periods: the samples of pass {period['pass']} contradict {period['period_s']:g} s at {period['t_s']:g} s: solutions "
            f"that have it hold {period['carried']:.1%} of the probability, which stays as it is"
        )
    said = reading_words(period["t_s"], period["period_s"], period["sigma_s"], period["shares"])
    own, heaviest = period["without"]
    was = f"{own:.0%}" if own == heaviest else f"{own:.0%}, when another held {heaviest:.0%}"
    return f"{said}; in pass {period['pass']} the likeliest motion holds {result['probability'].values[k, 0]:.0%} (without: {was})"


def _columns_unseen(result: Any, passes: list[dict[str, Any]]) -> list[str]:
    """Changes of columns that look the same in the telemetry as the file as it is written, with the rates of the first decided
    pass."""
    sure = [k for k, p in enumerate(passes) if p["decided"] and p["columns_checked"] == "unchecked"]
    if not sure or "columns_unseen" not in result.attrs:
        return []
    rate, changes = rate_at(result, sure[0]), json.loads(result.attrs["columns_unseen"])
    unseen = []
    for change in changes[:MOST_UNSEEN]:
        matrix = np.array(change["matrix"])
        omega = np.linalg.det(matrix) * matrix @ np.radians(rate.omega)
        unseen.append(f"with {change['what']} it would be {rate_text(omega)}")
    rest = len(changes) - MOST_UNSEEN
    more = f"; and with {rest} other changes another" if rest > 0 else ""
    stated = f"{rate_text(np.radians(rate.omega))} at {clock_text(result, rate.at_s)}"
    return [
        f"  columns unchecked: the file as it is written gives {stated}; this telemetry looks the same if the file is wrong in one "
        f"of these ways: {'; '.join(unseen)}{more}"
    ]


def _pass(result: Any, k: int) -> tuple[dict[str, Any], str, str]:
    """Numbers of a pass, its row of the console table behind number and start, and a sentence."""
    at = np.flatnonzero(result["pass_of"].values == k)
    t, rate = result["time"].values[at], rate_at(result, k)
    probability = result["probability"].values[k]
    n = int(np.isfinite(probability).sum())
    mean = np.degrees(result["omega_mean_B"].values[k, :n]).tolist()
    numbers = pass_numbers(result, k) | {
        "start_s": float(t[0]),
        "end_s": float(t[-1]),
        "sigma_deg_s": np.degrees(result["omega_sigma_all_B"].values[k]).tolist(),
        "solutions": [
            {"omega_deg_s": omega} | motion_numbers(result, k, i) for i, omega in enumerate(mean)
        ],
        "speed_deg_s": [rate.low, rate.mean, rate.high],
        "at_s": rate.at_s,
        "omega_at_deg_s": rate.omega.tolist(),
    }
    speed, omega = _speed(numbers, rate), with_sigma(rate.omega, rate.sigma)
    over_the_pass = range_text(rate.low, rate.high, float(rate.sigma.max()))
    # without remedies, which stand in parentheses
    verdict = re.sub(r" \((?!95 %\)).*", "", str(numbers["why_not_decided"])) or "decided"
    if numbers["decided"] and np.max(rate.sigma) > COARSE * rate.mean:
        verdict = COARSE_WORD
    verdict = verdict.replace("several solutions", f"{n} solutions")
    row = f"{len(at):7d}  {speed:17}  {over_the_pass:19}  "
    row += f"{omega[1:-1]:45}  {probability[0]:.2f}  {verdict}"
    called = f"pass {numbers['pass_id']} ({len(at)} samples)"
    sentence = (
        f"{called}: speed {speed} deg/s ({RANGE}: {over_the_pass}), body rate {omega} deg/s at mid-pass; "
        f"{verdict}"
    )
    return numbers, row, sentence


def _speed(numbers: dict[str, Any], rate: RateAt) -> str:
    """Return the speed of a pass at mid-pass in deg/s with its sigma, or the upper limit if its sigma exceeds it."""
    below = numbers.get("speed_below_deg_s", np.nan)
    if not numbers.get("constrained_speed", True) and np.isfinite(below):
        return f"below {upper_text(below)} (95 %)"
    return with_sigma(float(np.linalg.norm(rate.omega)), numbers.get("speed_sigma_deg_s", np.nan))


def rates_drawings(result: Any, context: Context) -> Iterator[Drawing]:
    from sunspin.output.curves import dense
    from sunspin.output.figures.panel_signals import panel_signals_figure
    from sunspin.output.figures.rates import attitude_figure, rates_figure
    from sunspin.output.figures.residuals import residuals_figure

    sure, look = result["decided"].values, "look at what is said of each, and at all solutions"
    others = "" if sure.all() else f"; of the others {look}"
    yield Drawing(
        "rates",
        lambda: rates_figure(result, context.telemetry),
        "The three components of the body rate against time in each pass, with bands of one sigma.",
        "Body rate of the likeliest solution of each pass, body axes; bands: one sigma of that solution. "
        f"{int(sure.sum())} of {sure.size} passes are decided{others}.",
    )
    if result.attrs.get("frame_N") == J2000 and "turn_sigma_rad" in result:
        yield Drawing(
            "attitude",
            lambda: attitude_figure(result),
            "The four components of the attitude quaternion against time in each pass.",
            "Attitude of the likeliest solution of each pass: rotation from J2000 to body axes, scalar last (w). Above each pass "
            "the root mean square of the angle by which it may be off.",
        )
    if "residual" in result:
        yield Drawing(
            "residuals",
            lambda: residuals_figure(result),
            "Residuals of each sensor in sigmas against time in each pass, with the limit of three sigma.",
            "Size of the difference between readings and what the likeliest solution predicts, all numbers of a reading together, "
            "in sigmas of what was assumed: noise, and of panels also other light. Farther out than six: at the edge. A wave, or "
            "many readings beyond three sigma, mean that the solution is wrong.",
        )
    if context.telemetry is None or context.vehicle is None:
        return
    samples, vehicle = context.telemetry, context.craft()
    if "panel" in samples.coords and (runs := dense(result)):
        left_out = str(result.attrs.get("panels_left_out", "")).split(", ")
        used = np.char.startswith(result["why"].values.astype(str), "used")
        yield Drawing(
            "signals",
            lambda: panel_signals_figure(samples, runs, vehicle, used, left_out),
            "Signal of each panel against time in up to four passes: samples as dots, the solution's prediction as a line.",
            "Panel signals of the passes with the most samples: dots are samples, lines what the likeliest solution predicts, with "
            "one factor for each pass.",
        )


def rates_tables(result: Any) -> Iterator[Table]:
    import pandas as pd

    epoch, frame = (result.attrs.get(name) for name in ("epoch_utc", "frame_N"))
    number = result["pass_of"].values
    time, rate, sun, q = (result[name].values for name in ("time", "omega_B", "sun_B", "B_from_N"))
    columns: dict[str, Any] = {
        "time_s": time,
        "utc": ["" if epoch is None else utc_after(t, epoch, 3) for t in time.tolist()],
        "pass": number,
        "pass_id": result["pass_id"].values[number],
    }
    for k, axis in enumerate("xyz"):
        columns[f"omega_{axis}_B_rad_s"] = rate[:, k]
        columns[f"sigma_{axis}_rad_s"] = np.sqrt(result["omega_cov_B"].values[:, k, k])
    columns |= in_degrees(columns)
    columns |= {f"sun_{axis}_B": sun[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"q_{axis}_B_from_N": q[:, k] for k, axis in enumerate("xyzw")}
    columns["sun_sigma_rad"] = result["sun_sigma_rad"].values
    if "turn_sigma_rad" in result:  # the root mean square of the angle by which the attitude is off
        angles = result["sun_sigma_rad"].values, result["turn_sigma_rad"].values
        columns["attitude_sigma_rad"] = np.hypot(*angles)
    frame = "z to the Sun, local" if frame == SUN_Z_LOCAL else frame
    comment = f"time_s from {epoch}; likeliest solution of each pass; body axes; N: {frame}"
    yield passes_table(result)
    if result.sizes.get("estimate"):
        names = ["estimate_value", "estimate_sigma", "estimate_unit"]
        frame = result[names].to_dataframe().reset_index().dropna()
        shown = {"pass_id": "pass", "estimate": "estimate", "estimate_value": "value"}
        shown |= {"estimate_sigma": "±", "estimate_unit": "unit"}
        yield Table("estimates", frame, "Estimated with the motion", shown)
    yield Table("rates", pd.DataFrame(columns), comment=comment)


KINDS.update(rates=Kind("rates", "rates", rates_summary, rates_drawings, rates_tables))
