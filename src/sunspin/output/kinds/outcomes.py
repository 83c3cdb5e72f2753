"""Results of `sunspin outcomes`: simulated landings of one wheel strategy, and figures that compare strategies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from sunspin.landing.tally import Estimate, density, quantity, tally
from sunspin.output.figures import COLOURS, axes_grid, axis_labels, escape_name, styled
from sunspin.output.kind import KINDS, Context, Drawing, Kind, Summary
from sunspin.output.text import count_text, with_sigma

PRINTED = (
    *("touch_leg", "touch_panel", "touch_body", "rest_leg", "rest_panel", "leg_tip_speed"),
    *("antenna_share", "antenna_at_rest", "rz_time_below_-0.5", "rate_before", "rate_after"),
)
"""Quantities of a tally that are printed, in this order."""

HATCHES = ("", "//", "..", "xx")
"""Fill patterns of bars, so that they differ in print without colour."""


def outcomes_summary(runs: Any) -> Summary:
    """Return the summary of the runs of one strategy: the estimate of each quantity with its standard error."""
    estimates = {
        name: {"value": float(estimate.value), "error": float(estimate.error)}
        for name, estimate in tally(runs).items()
        if np.isfinite(estimate.value)
    }
    numbers = {"runs": runs.sizes["run"], "estimates": estimates}
    undetermined = runs.attrs.get("not_told")  # in words: what the vehicle file does not determine
    return Summary(numbers, run_lines(runs, estimates), [undetermined] if undetermined else [])


def run_lines(runs: Any, estimates: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Return lines on the runs of a strategy: their number, how many failed, and :func:`estimate_lines` of `estimates`."""
    failed = int((runs["outcome"].values != 0).sum())  # 0: the run could be computed
    head = f"wheels {runs.attrs['strategy']}: {runs.sizes['run']} runs"
    head += f", {failed} of them could not be computed" if failed else ""
    return [head, *estimate_lines(estimates)]


def estimate_lines(estimates: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Return a line for each quantity of `PRINTED` that has been estimated, in that order: its mean and standard error.

    `estimates`: name of the quantity -> its "value" and "error" as stored; `quantity` gives the factor to the unit of the line.
    """
    lines = []
    for name in PRINTED:
        if name in estimates:
            text, unit, scale = quantity(name)
            value, error = (estimates[name][key] * scale for key in ("value", "error"))
            lines.append(f"  {text}: {with_sigma(value, error, unit)}")
    return lines


def outcomes_drawings(runs: Any, _: Context) -> Iterator[Drawing]:
    """Return the figures of the runs of one strategy."""
    return runs_drawings({str(runs.attrs["strategy"]): runs})


def runs_drawings(runs: dict[str, Any]) -> Iterator[Drawing]:
    """Yield the figures that compare the runs of strategies (name -> runs).

    Without ground contacts in the runs, or without points of a hull, the figures that need them are left out.
    """
    yield Drawing(
        "sun-height",
        lambda: sun_height_figure(runs),
        "Probability density of the height of the Sun over the lander on the way to the landing, a curve for each command to the "
        "wheel.",
        "How the Sun stood on the way to the landing, after the collision if there is one: r_z is 1 with the Sun overhead, -1 "
        "underneath; bars: one standard error.",
    )
    if all(np.isfinite(data["up_z"]).any() for data in runs.values()):
        alt = "Distributions of the z axis against the ground's normal, the fastest leg tip and the antenna's share of the time."
        caption = "At the landing and on the way to it, over the runs of each command to the wheel; bars: one standard error."
        yield Drawing("distributions", lambda: distributions_figure(runs), alt, caption)
    if all("point_kind" in data.coords for data in runs.values()):
        yield Drawing(
            "first-contact",
            lambda: first_contact_figure(runs),
            "Probability of each leg and panel to touch the ground first, by command to the wheel.",
            "What touches the ground first; a corner that panels share counts for each of them; bars: one standard error of the "
            "simulation.",
        )


def strategy_name(name: str) -> str:
    """Return a wheel strategy, such as "delay:60", in plain words."""
    if name.startswith("delay:"):
        seconds = float(name.removeprefix("delay:"))
        return f"off after {seconds:g} s" if seconds < 120 else f"off after {seconds / 60:.3g} min"
    words = {"off": "off at touchdown", "brake": "braked", "after_rest": "off after rest"}
    return words.get(name, escape_name(name))


@styled
def sun_height_figure(runs: dict[str, Any]) -> Any:
    """Draw the density of r_z on the way to the landing for each strategy, with one standard error (paper, Fig. 13)."""
    figure, axes = axes_grid(9.2, 4.2, title="Height of the Sun on the way to the landing")
    for k, (name, data) in enumerate(runs.items()):
        curve = density(data, merge=2)  # bins 0.05 wide
        half_bin = 1 / curve.sizes["rz"]  # r_z from -1 to 1
        value, edges = curve["density"].values, np.append(curve["rz"] - half_bin, 1.0)
        # the first strategy is a filled area, so that the lines of the others are seen on it
        style = {"color": COLOURS[k % 8], "lw": 1.6, "fill": k == 0, "alpha": 1 if k else 0.45}
        label = f"{strategy_name(name)}: {count_text(data.sizes['run'], 'run')}"
        axes.stairs(value, edges, label=label, **style)
        axes.errorbar(curve["rz"], value, curve["error"], fmt="none", ecolor=COLOURS[k % 8], lw=1)
    axes.set(xlim=(-1, 1), xlabel="$r_z$, cosine of the angle between the Sun and the z axis")
    axes.set_ylabel("probability density")
    axes.set_ylim(bottom=0)
    # to the right of the axes, where it hides no curve
    axes.legend(title="wheel", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


DISTRIBUTIONS = (
    ("up_z", (-1, 1, 41), "cosine of z axis to the ground's normal at contact", ""),
    ("leg_tip_speed", (0, None, 51), "fastest leg tip at first contact (m/s)", " (s/m)"),
    ("antenna_share", (0, 1, 26), "share of time, orbiter in the antenna's cone", ""),
)
"""Quantities of :func:`distributions_figure`: name, edges of the bins (first, last, number), label, unit of the density.

If the last edge is None, it is the largest value of all runs.
"""


@styled
def distributions_figure(runs: dict[str, Any], published_tip_speed: float | None = None) -> Any:
    """Draw the distributions of `DISTRIBUTIONS` over the runs of each strategy.

    `published_tip_speed` (m/s): the paper's estimate of the fastest leg tip, drawn as a line.
    """
    figure, grid = axes_grid(11.5, 3.9, 1, 3, "At the landing, and on the way to it")
    for axes, (name, bins, label, unit) in zip(grid, DISTRIBUTIONS, strict=True):
        every = np.concatenate(
            [data[name].values[np.isfinite(data[name].values)] for data in runs.values()]
        )
        if not every.size:
            explain_empty_axes(axes, "not determined by this vehicle")
        first, last, number = bins
        if (
            last is None
        ):  # a lander may be slower or faster than any other; 1e-3 for one that does not move
            last = max(every.max(initial=0.0), 1e-3)
        edges, width = np.linspace(first, last, number), (last - first) / (number - 1)
        for k, (strategy, data) in enumerate(runs.items()):
            values = data[name].values[np.isfinite(data[name].values)]
            share = np.histogram(values, edges)[0] / max(values.size, 1)
            error = np.sqrt(share * (1 - share) / max(values.size, 1)) / width  # binomial
            style = {"color": COLOURS[k % 8], "ls": ("-", "--", "-.", ":")[k % 4]}
            axes.stairs(share / width, edges, lw=1.6, label=strategy_name(strategy), **style)
            middle = (edges[1:] + edges[:-1]) / 2
            axes.errorbar(middle, share / width, error, fmt="none", ecolor=COLOURS[k % 8], lw=0.8)
        axes.set(xlabel=label, ylabel=f"probability density{unit}", xlim=(first, last))
        axes.set_ylim(bottom=0)
    if published_tip_speed is not None:
        label = f"paper: {published_tip_speed:g} m/s"
        grid[1].axvline(published_tip_speed, color=COLOURS[6], lw=1, ls=":", label=label)
    grid[1].legend()
    return figure


@styled
def first_contact_figure(runs: dict[str, Any]) -> Any:
    """Draw the probability of each leg and panel to touch the ground first, by strategy.

    A corner that several panels share counts for each of them, so that the sum may exceed 1.
    """
    title = "What touches the ground first; a shared corner counts for each panel"
    figure, axes = axes_grid(8.5, 4, title=title)
    labels: list[str] = []
    for k, (name, data) in enumerate(runs.items()):
        estimates = _first_contacts(data)
        value, error = np.transpose(list(estimates.values()))
        labels, width = list(estimates), 0.8 / len(runs)
        # the bars of all strategies stand side by side, centred on the tick
        place = np.arange(len(labels)) + width * (k - (len(runs) - 1) / 2)
        style = {"color": COLOURS[k % 8], "hatch": HATCHES[k % 4], "ec": "white", "capsize": 2}
        error_bars = clip_errors(value, error)
        axes.bar(place, value, width, yerr=error_bars, label=strategy_name(name), **style)
    axes.set_xticks(range(len(labels)), labels)
    axes.set_ylabel("probability of touching first")
    axes.legend(title="wheel")
    return figure


def _first_contacts(runs: Any) -> dict[str, Estimate]:
    """Return the probability with standard error of each leg, each panel of the hull and the bare body to touch first, by label."""
    # point of the hull that touches first in each run, -1 for none; leg of each point, -1 for none
    estimates, touching_point = tally(runs), runs["contact_point"].values
    contacts, leg_of_point = {}, runs["point_leg"].values
    touching_leg = leg_of_point[touching_point[touching_point >= 0]]
    tips = np.flatnonzero(leg_of_point >= 0)
    for tip in tips[np.argsort(leg_of_point[tips])]:
        share = float(np.mean(touching_leg == leg_of_point[tip]))
        error = np.sqrt(share * (1 - share) / runs.sizes["run"])
        name = escape_name(runs["point_leg_name"].values[tip])
        contacts[f"leg {name}"] = Estimate(share, float(error))
    panels = runs["panel"].values[runs["point_on_panel"].values.any(axis=0)]
    labels = {
        f"touch_panel_{panel}": f"panel {label}"
        for panel, label in zip(panels, axis_labels(panels), strict=True)
    }
    labels["touch_body"] = "bare body"
    return contacts | {
        label: estimates[name] for name, label in labels.items() if name in estimates
    }


def clip_errors(value: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Return the lengths (2, n) of error bars below and above probabilities (n), cut so that bars end at 0 and 1.

    A length is never negative, even if a sum of probabilities exceeds 1 by rounding.
    """
    return np.clip(np.stack([np.minimum(error, value), np.minimum(error, 1 - value)]), 0.0, None)


def explain_empty_axes(axes: Any, why: str) -> None:
    """Write on axes without data why there are none, and remove the ticks of their scale."""
    axes.text(0.5, 0.5, why, transform=axes.transAxes, ha="center", fontsize=9)
    axes.set_yticks([])


KINDS.update(outcomes=Kind("outcomes", "outcomes", outcomes_summary, outcomes_drawings))
