"""Results of `sunspin posterior`: the rate at the first sample, by solution."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from sunspin.estimate.lander.tree import TOO_FEW
from sunspin.estimate.lander.verdict import sigmas
from sunspin.estimate.periods import FAR_SIGMAS, LEAST_DRAWS, ROTATIONS
from sunspin.output.figures import COLOURS, axes_grid, escape_name, styled
from sunspin.output.kind import KINDS, Context, Drawing, Kind, Summary, Table
from sunspin.output.kinds.passes import (
    pass_numbers,
    passes_table,
    rates_in_degrees,
    solution_numbers,
)
from sunspin.output.kinds.predictions import (
    degrees_text,
    predictions_drawings,
    predictions_summary,
    predictions_tables,
)
from sunspin.output.text import number_text, size_text, with_sigma

MOST_SOLUTIONS = 12
"""Solutions that are printed."""

SHOWN_DRAWS = 3000
"""Draws that the figure shows."""

MOST_ROUNDS = 8
"""Largest number of rounds of sampling that are labelled on the axis."""


def posterior_summary(tree: Any) -> Summary:
    """Return the summary of a posterior: verdict, angular speed, solutions, diagnostics, priors, and predictions if any."""
    numbers = main_numbers(tree)
    if (
        "passes" in tree.children
    ):  # the only pass and its solutions, with the same names as in `rates`
        passes = tree["passes"].to_dataset()
        solutions = [solution_numbers(passes, 0, k) for k in range(passes.sizes["solution"])]
        numbers["passes"] = [pass_numbers(passes, 0) | {"solutions": solutions}]
    lines = [numbers["verdict"]]
    if numbers["synthetic_telemetry"]:
        lines.append("  synthetic telemetry: not measured")
    speed = degrees_text(numbers["rate_rad_s"])
    lines.append(f"  angular speed at the first sample: {speed} deg/s (90 % interval)")
    for k, solution in enumerate(numbers["solutions"][:MOST_SOLUTIONS], 1):
        omega = with_sigma(*np.degrees([solution["omega_B"], solution["sigma"]]), "deg/s")
        too_few = solution["effective_draws"] < TOO_FEW
        rough = " (approximate: few draws)" if too_few else ""
        text = f"probability {solution['probability']:.3f}, omega {omega}{rough}"
        lines.append(f"  solution {k}: {text}, chi-square {solution['chi_square']:.0f}")
    lines.append(
        f"  diagnostics: posterior predictive p {number_text(numbers['p_value'], 3)}, effective sample size "
        f"{numbers['effective_draws']:.0f}, Pareto k {numbers['pareto_k']:.2f}"
    )
    numbers |= {name: tree.attrs[name] for name in ("noise", "noise_from") if name in tree.attrs}
    if numbers.get("noise_from", "given") != "given":
        noise = size_text(numbers["noise"])
        lines.append(f"  noise of panel readings: {noise}, {numbers['noise_from']}")
    priors = ", ".join(f"{key} {text}" for key, text in json.loads(tree.attrs["priors"]).items())
    lines.append(f"  priors (relative 1 sigma): {priors}")
    if "hypotheses" in tree.attrs:
        numbers["hypotheses"] = json.loads(tree.attrs["hypotheses"])
        models = (f"{name} {share:.2g}" for name, share in numbers["hypotheses"].items())
        lines.append(f"  model probabilities: {', '.join(models).replace('as stated', 'nominal')}")
    if "period" in tree.children:
        period = tree["period"].to_dataset()
        lines += [f"  {text}" for text in period_sentences(period)]
        effective = float(period.attrs["effective_draws"])
        numbers["period"] = {"told": bool(period.attrs["told"]), "effective_draws": effective}
        for name in ("probability", "solution_probability", "rate_quantile"):
            numbers["period"][name] = period[name].values.tolist()
    if "predictions" in tree.children:
        predictions = predictions_summary(tree["predictions"].to_dataset())
        return Summary(numbers | predictions, lines + predictions.lines)
    return Summary(numbers, lines)


def main_numbers(tree: Any) -> dict[str, Any]:
    """Return the main numbers of a posterior as plain data: verdict, angular speed, solutions, quality of the draws."""
    solutions, about = tree["solutions"], tree.attrs
    rate = np.linalg.norm(tree["posterior"]["omega_B"].values.reshape(-1, 3), axis=1)
    low, median, high = np.quantile(rate, [0.05, 0.5, 0.95]).tolist()
    columns = {name: solutions[name].values for name in ("probability", "omega_B")}
    columns["sigma"] = sigmas(solutions)
    columns |= {
        name: solutions[name].values for name in ("chi_square", "starts", "effective_draws")
    }
    lists = (values.tolist() for values in columns.values())
    return {
        "verdict": about["verdict"],
        "verdict_word": about["verdict_word"],
        "rate_rad_s": {"median": median, "low_90": low, "high_90": high},
        "solutions": [dict(zip(columns, row, strict=True)) for row in zip(*lists, strict=True)],
        "p_value": float(about["p_value"]),
        "effective_draws": float(about["effective_draws"]),
        "pareto_k": float(about["pareto_k"]),
        "synthetic_telemetry": bool(about.get("synthetic", 0)),
    }


def period_sentences(period: Any) -> list[str]:
    """Return what the periods of the group `period` decide, in words."""
    about = period.attrs
    if (nearest := about["nearest_sigmas"]) > FAR_SIGMAS:
        return [
            f"periods: no solution of this posterior has them; the nearest is {nearest:.1f} sigma away"
        ]
    if (effective := about["effective_draws"]) < LEAST_DRAWS:
        return [
            f"periods not used: of these draws only {effective:.0f} have them; ask for more --draws"
        ]
    seen = zip(
        *(np.atleast_1d(about[name]) for name in ("seen_s", "period_s", "sigma_s")),
        period["probability"].values,
        strict=True,
    )
    lines = []
    for t_s, period_s, sigma_s, probability in seen:
        shares = zip(ROTATIONS, probability, strict=True)
        words = ", ".join(f"{name} {share:.0%}" for name, share in shares)
        lines.append(f"period {period_s:g} +- {sigma_s:g} s at {t_s:g} s: {words}")
    (low, middle, high), (low_before, before, high_before) = (
        np.degrees(period[name].values) for name in ("rate_quantile", "rate_quantile_before")
    )
    now, without = (
        period[name].values.max()
        for name in ("solution_probability", "solution_probability_before")
    )
    lines.append(
        f"with periods the angular speed at the first sample is {middle:.3g} deg/s, 90 % in {low:.3g} to {high:.3g} (without: "
        f"{before:.3g}, {low_before:.3g} to {high_before:.3g}); the likeliest solution has {now:.1%} (without: {without:.1%}); "
        f"effective sample size {effective:.0f}"
    )
    return lines


def posterior_drawings(tree: Any, context: Context) -> Iterator[Drawing]:
    """Yield the figures of a posterior: draws of the rate, the search and the sampling, and the predictions."""
    alt = "Draws of the components of the body rate and its size against each other, by solution."
    caption = "Draws of the rate at the first sample, body axes: every pair of components, one colour to a solution."
    yield Drawing("corner", lambda: corner_figure(tree), alt, caption)
    if {"search", "sampling"} <= set(tree.children):
        yield Drawing(
            "search",
            lambda: search_figure(tree),
            "Trial solutions before and after each window, and the log evidence of each round.",
            "Search: trial solutions fitted and kept over growing windows. Sampling: log evidence of each round, with the share of "
            "effective draws and Pareto's k.",
        )
    if "predictions" in tree.children:
        yield from predictions_drawings(tree["predictions"].to_dataset(), context)


@styled
def corner_figure(tree: Any) -> Any:
    """Draw every pair of rate components and speed at the first sample, with a colour for each solution.

    Histograms are on the diagonal, pairs below it; nothing is above it.
    """
    verdict = f": {escape_name(tree.attrs['verdict_word'])}" if "verdict_word" in tree.attrs else ""
    title = f"Body rate of {escape_name(tree.attrs.get('vehicle', 'the body'))} at the first sample{verdict}"
    figure, grid = axes_grid(9, 9, 4, 4, title, sharex="col")
    omega = np.degrees(tree["posterior"]["omega_B"].values.reshape(-1, 3)[:SHOWN_DRAWS])
    solution = tree["posterior"]["solution_id"].values.ravel()[:SHOWN_DRAWS]
    # x, y, z and the angular speed, deg/s
    value = np.column_stack([omega, np.linalg.norm(omega, axis=1)])
    names = (r"$\omega_x$", r"$\omega_y$", r"$\omega_z$", r"$|\omega|$")
    for i, j in np.ndindex(4, 4):
        axes = grid[i, j]
        axes.tick_params(labelsize=7)
        if j > i:
            axes.axis("off")
            continue
        edges = np.histogram_bin_edges(value[:, i], 60)
        for k in np.unique(solution):
            draws, color = value[solution == k], COLOURS[int(k) % 8]
            if i == j:
                axes.hist(draws[:, i], edges, histtype="stepfilled", color=color, alpha=0.7)
            else:
                style = {"ms": 1.5, "alpha": 0.4, "color": color, "rasterized": True}
                axes.plot(draws[:, j], draws[:, i], ".", **style)
        if i == j:
            axes.set_yticks([])
        if i == 3:  # lowest row
            axes.set_xlabel(f"{names[j]} (deg/s)")
            axes.tick_params(axis="x", labelrotation=45)
        if j == 0 and i > 0:  # first column, without its histogram
            axes.set_ylabel(f"{names[i]} (deg/s)")
    return figure


@styled
def search_figure(tree: Any) -> Any:
    """Draw the numbers of trial solutions for each window of the search, and the log evidence of each round of sampling."""
    search, sampling = tree["search"], tree["sampling"]
    figure, (left, right) = axes_grid(9, 3.6, 1, 2, "Search and sampling")
    stage = np.arange(search.sizes["stage"])
    for k, (name, label) in enumerate({"hypotheses": "fitted", "kept": "kept"}.items()):
        count = np.maximum(search[name].values, 1)  # the axis is logarithmic
        left.semilogy(stage, count, "os"[k] + "-", color=COLOURS[k], label=label)
    left.set_xticks(stage, [str(n) for n in search["samples"].values], fontsize=7)
    left.set(xlabel="samples in the window", ylabel="trial solutions")
    left.legend()
    right.plot(sampling["log_evidence"].values, "o-", color=COLOURS[0])
    right.set(xlabel="round, effective share, Pareto's k", ylabel="log evidence")
    # every n-th round has a label, with the smallest n that leaves at most `MOST_ROUNDS`
    stride = max(int(np.ceil(sampling.sizes["round"] / MOST_ROUNDS)), 1)
    rounds = np.arange(0, sampling.sizes["round"], stride)
    labels = [
        f"{i}\n{share:.0%}\n{pareto_k:.2f}"
        for i, share, pareto_k in zip(
            rounds,
            sampling["effective_share"].values[rounds],
            sampling["pareto_k"].values[rounds],
            strict=True,
        )
    ]
    right.set_xticks(rounds, labels, fontsize=7)
    return figure


def posterior_tables(tree: Any) -> Iterator[Table]:
    """Yield the tables of a posterior: its solutions, `passes.csv`, and the predictions if there are any."""
    import pandas as pd

    solutions, sigma = tree["solutions"], sigmas(tree["solutions"])
    columns: dict[str, Any] = {
        name: solutions[name].values for name in ("probability", "log_evidence")
    }
    for k, axis in enumerate("xyz"):
        columns[f"omega_{axis}_B_rad_s"] = solutions["omega_B"].values[:, k]
        columns[f"sigma_{axis}_rad_s"] = sigma[:, k]
    columns |= rates_in_degrees(columns)
    columns |= {name: solutions[name].values for name in ("chi_square", "lit_readings", "starts")}
    headings = {"probability": "probability"}
    for axis in "xyz":
        headings |= {f"omega_{axis}_B_deg_s": f"ω{axis} (deg/s)", f"sigma_{axis}_deg_s": "±"}
    headings |= {"chi_square": "chi-square", "lit_readings": "lit readings", "starts": "starts"}
    title = "Solutions: rates at the first sample, body axes"
    yield Table("solutions", pd.DataFrame(columns), title, headings)
    if "passes" in tree.children:
        yield passes_table(tree["passes"].to_dataset())
    if "predictions" in tree.children:
        yield from predictions_tables(tree["predictions"].to_dataset())


def posterior_datasets(tree: Any, context: Context) -> dict[str, Any]:
    """Return the best motion of each solution, by file name; nothing if the vehicle is not known, which the propagation needs."""
    if context.vehicle is None:
        return {}
    from sunspin.estimate.lander.predict import best_motions

    motions = best_motions(context.craft(), tree)
    return {f"motion-solution-{run.attrs['solution']}": run for run in motions}


_posterior = (posterior_summary, posterior_drawings, posterior_tables, posterior_datasets)
KINDS.update(posterior=Kind("posterior", "posterior", *_posterior))
