"""Posteriors, and what they predict."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from sunspin.estimate.posterior.period import period_sentences
from sunspin.estimate.posterior.predict import intervals
from sunspin.estimate.posterior.verdict import TOO_FEW, sigmas
from sunspin.estimate.posterior.verdict import summary as main_numbers
from sunspin.output.kind import Context, Drawing, Summary, Table, synthetic_note
from sunspin.output.kinds.passes import in_degrees, motion_numbers, pass_numbers, passes_table
from sunspin.output.text import digits_of

MOST_SOLUTIONS = 12
"""Solutions that are printed."""


def posterior_summary(tree: Any) -> Summary:
    """The verdict, the angular speed, the solutions, what the verdict rests on, and the predictions where there are any."""
    numbers = main_numbers(tree)
    if "passes" in tree.children:
        found = tree["passes"].to_dataset()
        numbers["passes"] = [
            pass_numbers(found, 0)
            | {"solutions": [motion_numbers(found, 0, k) for k in range(found.sizes["solution"])]}
        ]
    rate = numbers["rate_rad_s"]
    lines = [
        numbers["verdict"],
        *(["  synthetic telemetry: not measured"] if numbers["synthetic_telemetry"] else []),
    ]
    speed, low, high = _degrees(rate)
    lines.append(f"  angular speed at the first sample {speed} deg/s, 90 % in {low} to {high}")
    for solution in numbers["solutions"][:MOST_SOLUTIONS]:
        digits = digits_of(np.degrees(solution["sigma"]))
        omega, sigma = (
            ", ".join(f"{x:z.{digits}f}" for x in np.degrees(solution[key]))
            for key in ("omega_B", "sigma")
        )
        rough = (
            ", which is rough: few draws have weight"
            if solution["effective_draws"] < TOO_FEW
            else ""
        )
        error = f"+- ({sigma}) deg/s{rough}"
        lines.append(
            f"  probability {solution['probability']:.3f}  omega ({omega}) {error}  chi-square {solution['chi_square']:.0f}"
        )
    worth = f"worth {numbers['effective_draws']:.0f} draws, Pareto k {numbers['pareto_k']:.2f}"
    lines.append(f"  predictive p {numbers['p_value']:.3g}, {worth}")
    numbers |= {name: tree.attrs[name] for name in ("noise", "noise_from") if name in tree.attrs}
    if numbers.get("noise_from", "given") != "given":
        lines.append(f"  noise of panel readings: {numbers['noise']:.3g}, {numbers['noise_from']}")
    priors = json.loads(tree.attrs["priors"])
    lines.append(
        "  priors, relative sigmas: " + ", ".join(f"{key} {what}" for key, what in priors.items())
    )
    if "hypotheses" in tree.attrs:
        numbers["hypotheses"] = json.loads(tree.attrs["hypotheses"])
        lines.append(
            "  probabilities: "
            + ", ".join(f"{what} {weight:.2g}" for what, weight in numbers["hypotheses"].items())
        )
    if "period" in tree.children:
        seen = tree["period"].to_dataset()
        lines += [f"  {said}" for said in period_sentences(seen)]
        numbers["period"] = {
            "told": bool(seen.attrs["told"]),
            "effective_draws": float(seen.attrs["effective_draws"]),
        } | {
            name: seen[name].values.tolist()
            for name in ("probability", "solution_probability", "rate_quantile")
        }
    if "predictions" in tree.children:
        predicted = predictions_summary(tree["predictions"].to_dataset())
        return Summary(numbers | predicted, lines + predicted.lines)
    return Summary(numbers, lines)


def predictions_summary(found: Any) -> Summary:
    """Medians and intervals at each time."""
    table, lines = intervals(found), []
    for i, (t, label) in enumerate(zip(found["predicted_s"].values, labels(found), strict=True)):
        row = {r["quantity"]: r for r in table if r["t_s"] == t}
        behind = (
            ", after the collision"
            if "after_collision" in found and found["after_collision"].values[i]
            else ""
        )
        speed, low, high = _degrees(row["rate"])
        lines.append(f"  at {label}{behind} (90 % of the draws):")
        lines.append(f"    angular speed {speed} deg/s ({low} to {high})")
        for name, key in (("z from H", "z_to_momentum"), ("z from the Sun", "z_to_sun")):
            median, low, high = (
                np.degrees(row[key][which]) for which in ("median", "low_90", "high_90")
            )
            lines.append(f"    {name} {median:.1f} deg ({low:.1f} to {high:.1f})")
        lines.append(
            f"    the Sun within {np.degrees(row['sun_off']['high_90']):.1f} deg of its mean direction in the body"
        )
    collision = str(found.attrs.get("collision", ""))
    return Summary(
        {"predicted": table},
        lines + ([f"    collision: {collision}"] if collision.startswith("a leg") else []),
    )


def _degrees(rate: dict[str, Any]) -> list[str]:
    """Median and ends of the 90 % interval of an angular speed, deg/s."""
    values = [float(np.degrees(rate[key])) for key in ("median", "low_90", "high_90")]
    digits = digits_of((values[2] - values[1]) / 2)
    return [f"{value:.{digits}f}" for value in values]


def labels(found: Any) -> list[str]:
    """The times of predictions as they were asked for."""
    if "asked" in found.coords:
        return [str(text) for text in found["asked"].values]
    return [f"{t:g} s" for t in found["predicted_s"].values]


def posterior_drawings(tree: Any, context: Context) -> Iterator[Drawing]:
    from sunspin.output.figures.posterior import corner_figure, search_figure

    note = synthetic_note(tree)
    yield Drawing(
        "corner",
        lambda: corner_figure(tree),
        "Draws of the components of the body rate and its size against each other, by solution.",
        "Draws of the rate at the first sample, body axes: every pair of components, one colour to a solution."
        + note,
    )
    if {"search", "sampling"} <= set(tree.children):
        yield Drawing(
            "search",
            lambda: search_figure(tree),
            "Hypotheses before and after each window, and the log evidence of each round.",
            "How the search went: hypotheses fitted and kept over growing windows; and the sampling: log evidence of each round "
            "with the share of effective draws and Pareto's k." + note,
        )
    if "predictions" in tree.children:
        yield from predictions_drawings(tree["predictions"].to_dataset(), context)


def predictions_drawings(found: Any, _: Context) -> Iterator[Drawing]:
    from sunspin.output.figures.predicted import predicted_figure

    yield Drawing(
        "predicted",
        lambda: predicted_figure(found, labels(found)),
        "Draws of the angular speed, the components of the rate, the direction of the Sun and the angles of z at each time.",
        "What the body did at other times; thick and thin bars: 50 and 90 % of the draws."
        + synthetic_note(found),
    )


def posterior_tables(tree: Any) -> Iterator[Table]:
    solutions, sigma = tree["solutions"], sigmas(tree["solutions"])
    columns: dict[str, Any] = {
        "probability": solutions["probability"].values,
        "log_evidence": solutions["log_evidence"].values,
    }
    for k, axis in enumerate("xyz"):
        columns[f"omega_{axis}_B_rad_s"] = solutions["omega_B"].values[:, k]
        columns[f"sigma_{axis}_rad_s"] = sigma[:, k]
    columns |= in_degrees(columns)
    columns |= {name: solutions[name].values for name in ("chi_square", "lit_readings", "starts")}
    shown = {"probability": "probability"}
    for axis in "xyz":
        shown |= {f"omega_{axis}_B_deg_s": f"ω{axis} (deg/s)", f"sigma_{axis}_deg_s": "±"}
    shown |= {"chi_square": "chi-square", "lit_readings": "lit readings", "starts": "starts"}
    yield Table(
        "solutions", pd.DataFrame(columns), "Solutions: rates at the first sample, body axes", shown
    )
    if "passes" in tree.children:
        yield passes_table(tree["passes"].to_dataset())
    if "predictions" in tree.children:
        yield from predictions_tables(tree["predictions"].to_dataset())


def posterior_datasets(tree: Any, context: Context) -> dict[str, Any]:
    """The best motion of each solution."""
    if context.vehicle is None:
        return {}
    from sunspin.estimate.posterior.motion import best_motions

    motions = best_motions(context.craft(), tree)
    return {f"motion-solution-{run.attrs['solution']}": run for run in motions}


PREDICTED = ("t_s", "quantity", "median", "low_90", "high_90")


def predictions_tables(found: Any) -> Iterator[Table]:
    frame = pd.DataFrame(intervals(found))
    shown = {name: name.replace("_", " ") for name in PREDICTED}
    yield Table("predicted", frame, "At other times, in rad and rad/s (90 % intervals)", shown)
