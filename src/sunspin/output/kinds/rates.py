"""Results of `sunspin rates`: body rates and attitude of each pass."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from sunspin.environment.frames import J2000, SUN_Z_LOCAL
from sunspin.estimate.model import AS_STATED
from sunspin.estimate.observe import middle_sample
from sunspin.estimate.periods import FAR_SIGMAS, LEAST_DRAWS, ROTATIONS
from sunspin.estimate.verdict import upper_text
from sunspin.output.compared import compared_drawings, compared_summary, compared_tables
from sunspin.output.kind import KINDS, Context, Drawing, Kind, Summary, Table
from sunspin.output.kinds.passes import (
    pass_numbers,
    passes_table,
    rates_in_degrees,
    solution_numbers,
)
from sunspin.output.text import (
    clock_text,
    range_text,
    rate_text,
    size_text,
    start_texts,
    times_text,
    with_sigma,
)
from sunspin.output.windows import window_drawings, window_lines, window_numbers, window_tables

MOST_UNSEEN = 6
"""Largest number of column changes, which the telemetry cannot distinguish from the vehicle file, that are named."""

RATE = "omega x, y, z at mid-pass, deg/s ± 1 sigma"
RANGE = "range over the pass"
"""Heading of the smallest and largest speed in a pass, which are not an error of the speed."""

HEADING = f"{'samples':>7}  {'speed, deg/s':17}  {RANGE:19}  {RATE:45}  prob  verdict"
"""Heading of the console table of passes, after number and start. The speed is that at mid-pass with one sigma."""

PASSES_IN_WORDS = 3
"""Number of passes for which a page has a sentence; its table has all passes."""

COARSE = 0.1
"""A decided rate is called coarse if the sigma of a component exceeds this fraction of the speed."""

COARSE_WORD = "decided, coarse"
"""Verdict in the console table for such a rate."""


class RateAt(NamedTuple):
    """The rate of the likeliest solution of a pass, all in deg/s.

    The mean of the rate vector is not used: in a tumbling body x and y average out, and the size of the mean is not the speed.

    Attributes
    ----------
    low, mean, high : smallest, mean and largest speed over the pass
    at_s : time of the sample nearest to mid-pass, s from the epoch
    omega : rate (3) at that sample, body axes
    sigma : its sigma (3), with the spread of the other solutions
    """

    low: float
    mean: float
    high: float
    at_s: float
    omega: np.ndarray
    sigma: np.ndarray


def rate_at(result: Any, k: int) -> RateAt:
    """Return the rate of the likeliest solution of pass number `k` of a result of `rates`."""
    samples = np.flatnonzero(result["pass_of"].values == k)
    t, omega = result["time"].values[samples], np.degrees(result["omega_B"].values[samples])
    speed = np.linalg.norm(omega, axis=1)
    middle = middle_sample(t)
    variance = np.diagonal(result["omega_cov_B"].values[samples[middle]])
    # The covariance of samples is that of the likeliest solution. The sigmas of the mean rate, over all solutions and of the
    # likeliest one, give the additional variance from the other solutions.
    sigma_all, sigma_best = (
        result["omega_sigma_all_B"].values[k],
        result["omega_sigma_B"].values[k, 0],
    )
    variance = variance + np.nan_to_num(np.maximum(sigma_all**2 - sigma_best**2, 0.0))
    low, mean, high = float(speed.min()), float(speed.mean()), float(speed.max())
    return RateAt(low, mean, high, float(t[middle]), omega[middle], np.degrees(np.sqrt(variance)))


def rates_summary(result: Any) -> Summary:
    """Return the summary of `rates`: the verdict, a line and the solutions of each pass (deg/s), and remarks on the data."""
    verdict, *notes = result.attrs["verdict"].split("\n")
    pass_of = result["pass_of"].values
    begins = [float(result["time"].values[pass_of == k][0]) for k in range(result.sizes["pass_id"])]
    starts = start_texts(result, begins)
    width = max(map(len, ["start (UTC)", *starts]))
    table = [f"pass  {'start (UTC)':{width}}  {HEADING}"]
    passes, sentences = [], []
    for k, start in enumerate(starts):
        summary = _summarize_pass(result, k)
        entries = summary.entries
        passes.append(entries)
        table.append(f"{entries['pass_id']:4d}  {start:{width}}  {summary.row}")
        sentences.append(summary.sentence)
        if entries.get("model", AS_STATED) != AS_STATED:
            probability = f"{entries['model_probability']:.2f}"
            notes.append(
                f"pass {entries['pass_id']}: alternative model {entries['model']} (probability {probability})"
            )
    if any(row.endswith(COARSE_WORD) for row in table):
        notes.append(f"coarse: one sigma of a component exceeds {COARSE:.0%} of the speed")
    lines = [verdict, *(f"  {note}" for note in notes)]
    reasons, counts = np.unique(result["why"].values.astype(str), return_counts=True)
    left_out = str(result.attrs.get("panels_left_out", ""))
    numbers: dict[str, Any] = {
        "verdict": result.attrs["verdict"],
        "source": result.attrs["source"],
        "passes": passes,
        "acceleration_noise": result.attrs["acceleration_noise"],
        "max_rate_deg_s": float(np.degrees(result.attrs["max_rate_rad_s"])),
        "samples": dict(zip(reasons.tolist(), counts.tolist(), strict=True)),
        "synthetic_telemetry": bool(result.attrs.get("synthetic", 0)),
        "panels_left_out": [name for name in left_out.split(", ") if name],
    }
    if "periods" in result.attrs:
        numbers["periods"] = json.loads(result.attrs["periods"])
        lines += [f"  {_period_sentence(result, period)}" for period in numbers["periods"]]
    if left_out:
        why = "no signal in any sample (failed, or never sunlit); excluded"
        lines.append(f"  panel {left_out}: {why}")
    numbers |= {key: result.attrs[key] for key in ("noise", "noise_from") if key in result.attrs}
    if numbers.get("noise_from", "given") != "given":
        unit = str(result.attrs.get("noise_unit", ""))
        size = f"{size_text(numbers['noise'])} {unit or '(in the unit of the readings)'}"
        lines.append(f"  error of panel readings: {size} (median), {numbers['noise_from']}")
    lines += _unseen_column_lines(result, passes)
    in_passes = result.sizes["time"]
    numbers["samples_in_passes"] = in_passes
    # the search thins long passes
    if (searched := int(result.attrs.get("samples_searched", in_passes))) < in_passes:
        numbers["samples_searched"] = searched
        lines.append(
            f"  {in_passes} samples used in passes; the search keeps {searched} of them, the others refine what it finds"
        )
    lines += [f"  {count:6d} samples  {reason}" for reason, count in numbers["samples"].items()]
    numbers |= window_numbers(result)
    lines += window_lines(result)
    compared, compared_lines = compared_summary(result)
    numbers |= compared
    lines += compared_lines
    return Summary(numbers, lines, table=table, in_words=sentences[:PASSES_IN_WORDS])


def _period_sentence(result: Any, period: dict[str, Any]) -> str:
    """Return a sentence on how an observed period changes the probabilities of the solutions of its pass.

    They stay as they are if no solution is near the period, if too few draws have it, or if the samples contradict it.
    `period`: its entry in the attribute `periods` of the result.
    """
    k = int(np.flatnonzero(result["pass_id"].values == period["pass"])[0])
    if (nearest := period["nearest_sigmas"]) > FAR_SIGMAS:
        return (
            f"periods: no solution of pass {period['pass']} has them; the nearest is {nearest:.1f} sigma away; its probabilities "
            "stay as they are"
        )
    if period["effective"] < LEAST_DRAWS:
        return (
            f"periods not used: of the draws of pass {period['pass']} only {period['effective']:.0f} have them; its probabilities "
            "stay as they are"
        )
    if not period["told"]:
        return (
            f"periods: the samples of pass {period['pass']} contradict {period['period_s']:g} s at {period['t_s']:g} s: solutions "
            f"that have it hold {period['carried']:.1%} of the probability, which stays as it is"
        )
    shares = zip(ROTATIONS, period["shares"], strict=True)
    words = f"period {period['period_s']:g} +- {period['sigma_s']:g} s at {period['t_s']:g} s: "
    words += ", ".join(f"{name} {share:.0%}" for name, share in shares)
    now = result["probability"].values[k, 0]
    # probabilities without the period: of the solution that is now the likeliest, and of the one that was the likeliest then
    same_solution, largest = period["without"]
    without = f"{same_solution:.0%}"
    if same_solution != largest:
        without += f", when another held {largest:.0%}"
    return f"{words}; in pass {period['pass']} the likeliest motion holds {now:.0%} (without: {without})"


def _unseen_column_lines(result: Any, passes: list[dict[str, Any]]) -> list[str]:
    """Return a line on changes of columns and signs that this telemetry cannot distinguish from the vehicle file, if any.

    The line states the rate of the first decided pass with unchecked columns, and what it would be under each change. `passes`: the
    entries of the summary.
    """
    unchecked = [
        k
        for k, entries in enumerate(passes)
        if entries["decided"] and entries["columns_checked"] == "unchecked"
    ]
    if not unchecked or "columns_unseen" not in result.attrs:
        return []
    rate, changes = rate_at(result, unchecked[0]), json.loads(result.attrs["columns_unseen"])
    alternatives = []
    for change in changes[:MOST_UNSEEN]:
        matrix = np.array(change["matrix"])
        # a rate is an axial vector: a mirror image (determinant -1) also changes its sign
        omega = np.linalg.det(matrix) * matrix @ np.radians(rate.omega)
        alternatives.append(f"with {change['what']} it would be {rate_text(omega)}")
    rest = len(changes) - MOST_UNSEEN
    others = f"; and with {rest} other changes another" if rest > 0 else ""
    stated = f"{rate_text(np.radians(rate.omega))} at {clock_text(result, rate.at_s)}"
    return [
        f"  columns unchecked: the file as it is written gives {stated}; this telemetry looks the same if the file is wrong in one "
        f"of these ways: {'; '.join(alternatives)}{others}"
    ]


class PassSummary(NamedTuple):
    """The summary of a pass: entries of `summary.json`, row of the console table (after number and start), and a sentence."""

    entries: dict[str, Any]
    row: str
    sentence: str


def _summarize_pass(result: Any, k: int) -> PassSummary:
    """Return the summary of pass number `k` of a result of `rates`."""
    t, rate = result["time"].values[result["pass_of"].values == k], rate_at(result, k)
    probability = result["probability"].values[k]
    solutions = int(np.isfinite(probability).sum())  # padded with NaN
    mean_rates = np.degrees(result["omega_mean_B"].values[k, :solutions]).tolist()
    numbers = pass_numbers(result, k) | {
        "start_s": float(t[0]),
        "end_s": float(t[-1]),
        "sigma_deg_s": np.degrees(result["omega_sigma_all_B"].values[k]).tolist(),
        "solutions": [
            {"omega_deg_s": mean} | solution_numbers(result, k, i)
            for i, mean in enumerate(mean_rates)
        ],
        "speed_deg_s": [rate.low, rate.mean, rate.high],
        "at_s": rate.at_s,
        "omega_at_deg_s": rate.omega.tolist(),
    }
    speed, omega = _speed_text(numbers, rate), with_sigma(rate.omega, rate.sigma)
    over_the_pass = range_text(rate.low, rate.high, float(rate.sigma.max()))
    # parentheses hold remedies, which are left out with all that follows; "(95 %)" belongs to the limit of the speed
    verdict = re.sub(r" \((?!95 %\)).*", "", str(numbers["why_not_decided"])) or "decided"
    if numbers["decided"] and np.max(rate.sigma) > COARSE * rate.mean:
        verdict = COARSE_WORD
    verdict = verdict.replace("several solutions", f"{solutions} solutions")
    row = f"{len(t):7d}  {speed:17}  {over_the_pass:19}  "
    row += f"{omega.strip('()'):45}  {probability[0]:.2f}  {verdict}"
    name = f"pass {numbers['pass_id']} ({len(t)} samples)"
    sentence = (
        f"{name}: speed {speed} deg/s ({RANGE}: {over_the_pass}), body rate {omega} deg/s at mid-pass; "
        f"{verdict}"
    )
    return PassSummary(numbers, row, sentence)


def _speed_text(numbers: dict[str, Any], rate: RateAt) -> str:
    """Return the speed of a pass at mid-pass (deg/s) with its sigma, or its upper limit if the data do not constrain it."""
    limit = numbers.get("speed_below_deg_s", np.nan)
    if not numbers.get("constrained_speed", True) and np.isfinite(limit):
        return f"below {upper_text(limit)} (95 %)"
    return with_sigma(float(np.linalg.norm(rate.omega)), numbers.get("speed_sigma_deg_s", np.nan))


def rates_drawings(result: Any, context: Context) -> Iterator[Drawing]:
    """Yield the figures of `rates`: rates, attitude in J2000, residuals, panel signals; each if the result has the data."""
    from sunspin.output.curves import pass_motions
    from sunspin.output.figures.panel_signals import panel_signals_figure
    from sunspin.output.figures.rates import attitude_figure, rates_figure
    from sunspin.output.figures.residuals import residuals_figure

    decided = result["decided"].values
    others = "; of the others look at what is said of each, and at all solutions"
    yield Drawing(
        "rates",
        lambda: rates_figure(result, context.telemetry),
        "The three components of the body rate against time in each pass, with bands of one sigma.",
        "Body rate of the likeliest solution of each pass, body axes; bands: one sigma of that solution. "
        f"{int(decided.sum())} of {decided.size} passes are decided{'' if decided.all() else others}.",
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
    yield from window_drawings(result)
    yield from compared_drawings(result)
    if context.telemetry is None or context.vehicle is None:
        return
    samples, vehicle = context.telemetry, context.craft()
    if "panel" in samples.coords and (motions := pass_motions(result)):
        left_out = str(result.attrs.get("panels_left_out", "")).split(", ")
        used = np.char.startswith(result["why"].values.astype(str), "used")
        yield Drawing(
            "signals",
            lambda: panel_signals_figure(samples, motions, vehicle, used, left_out),
            "Signal of each panel against time in up to four passes: samples as dots, the solution's prediction as a line.",
            "Panel signals of the passes with the most samples: dots are samples, lines what the likeliest solution predicts, with "
            "the estimated gains and one factor for each pass.",
        )


def rates_tables(result: Any) -> Iterator[Table]:
    """Yield the tables of `rates`: `passes`, `estimates` of nuisance parameters, and `rates` with a row for each sample."""
    import pandas as pd

    epoch, frame_N = (result.attrs.get(name) for name in ("epoch_utc", "frame_N"))
    pass_of = result["pass_of"].values
    time, rate, sun = (result[name].values for name in ("time", "omega_B", "sun_B"))
    quaternion = result["B_from_N"].values
    columns: dict[str, Any] = {
        "time_s": time,
        "utc": times_text(result),
        "pass": pass_of,
        "pass_id": result["pass_id"].values[pass_of],
    }
    for k, axis in enumerate("xyz"):
        columns[f"omega_{axis}_B_rad_s"] = rate[:, k]
        columns[f"sigma_{axis}_rad_s"] = np.sqrt(result["omega_cov_B"].values[:, k, k])
    columns |= rates_in_degrees(columns)
    columns |= {f"sun_{axis}_B": sun[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"q_{axis}_B_from_N": quaternion[:, k] for k, axis in enumerate("xyzw")}
    columns["sun_sigma_rad"] = result["sun_sigma_rad"].values
    if "turn_sigma_rad" in result:
        # Rms angle of the attitude error: the errors of the Sun direction and of the rotation about it are perpendicular.
        columns["attitude_sigma_rad"] = np.hypot(
            result["sun_sigma_rad"].values, result["turn_sigma_rad"].values
        )
    N_in_words = "z to the Sun, local" if frame_N == SUN_Z_LOCAL else frame_N
    comment = f"time_s from {epoch}; likeliest solution of each pass; body axes; N: {N_in_words}"
    yield passes_table(result)
    yield from window_tables(result)
    yield from compared_tables(result)
    if result.sizes.get("estimate"):
        names = ["estimate_value", "estimate_sigma", "estimate_unit"]
        # a pass without an estimate has NaN
        estimates = result[names].to_dataframe().reset_index().dropna()
        headings = {"pass_id": "pass", "estimate": "estimate", "estimate_value": "value"}
        headings |= {"estimate_sigma": "±", "estimate_unit": "unit"}
        yield Table("estimates", estimates, "Estimated with the motion", headings)
    yield Table("rates", pd.DataFrame(columns), comment=comment)


KINDS.update(rates=Kind("rates", "rates", rates_summary, rates_drawings, rates_tables))
