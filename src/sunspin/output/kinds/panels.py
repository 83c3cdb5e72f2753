"""Results of the kinds `panel_quality` (gains, usable samples) and `panel_health` (impossible illumination patterns)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from sunspin.output.figures import ABOVE, COLOURS, axes_grid, axis_labels, styled
from sunspin.output.kind import KINDS, Context, Drawing, Kind, Summary
from sunspin.output.text import count_text, number_text, set_text, with_sigma
from sunspin.telemetry.health import named_panels

SETS = 8
"""Number of illumination patterns that are printed, the most frequent ones; `--json` has all."""

SIDE_BY_SIDE = 80
"""Characters of all tick labels that fit side by side below an axis of 7 inches."""

NEGLIGIBLE = 1e-6
"""Probability below which an event counts as impossible in printed text."""


def quality_summary(quality: Any) -> Summary:
    """Return the summary of panel quality: samples that are used or why not, the gain of each panel, dead panels."""
    reasons, counts = np.unique(quality["why"].values.astype(str), return_counts=True)
    names = quality["panel"].values.astype(str)
    gain, sigma = quality["gain"].values, quality["gain_sigma"].values
    numbers = {
        "samples": dict(zip(reasons.tolist(), counts.tolist(), strict=True)),
        "dead": names[quality["dead"].values.astype(bool)].tolist(),
        "gain": dict(zip(names.tolist(), gain.tolist(), strict=True)),
        "gain_sigma": dict(zip(names.tolist(), sigma.tolist(), strict=True)),
    }
    lines = [f"quality of {len(quality['use'])} samples of {len(names)} panels"]
    lines += [f"  {count:6d}  {reason}" for reason, count in numbers["samples"].items()]
    for name, value, error in zip(names, gain, sigma, strict=True):
        lines.append(f"  panel {name}: gain {with_sigma(value, error)}")
    if numbers["dead"]:
        lines.append(f"  panels that never see light: {', '.join(numbers['dead'])}")
    return Summary(numbers, lines)


def quality_drawings(quality: Any, _: Context) -> Iterator[Drawing]:
    """Yield the figure of panel gains."""
    alt = "Gain of each panel with its error bar."
    caption = "Gain of each panel in the unit of the vehicle's gains, one sigma; crosses: panels that never see light."
    yield Drawing("panel-quality", lambda: gains_figure(quality), alt, caption)


@styled
def gains_figure(quality: Any) -> Any:
    """Draw the gain of each panel with one sigma; dead panels are crossed out."""
    figure, axes = axes_grid(7, 3.6, title="Gains of the panels")
    place, gain = (
        np.arange(quality.sizes["panel"]),
        quality["gain"].values,
    )  # a place on x per panel
    dead = quality["dead"].values.astype(bool)
    axes.errorbar(place, gain, quality["gain_sigma"], fmt="o", color=COLOURS[0], capsize=3)
    axes.plot(place[dead], gain[dead], "x", ms=10, color=COLOURS[1])
    _label_panels(axes, place, quality["panel"].values)
    axes.set(xlabel="panel", ylabel="gain (unit of the vehicle's gains)")
    return figure


def _label_panels(axes: Any, place: np.ndarray, names: np.ndarray) -> None:
    """Write the names of panels below an axis, upright if they would not fit side by side."""
    labels = axis_labels(names)
    upright = sum(map(len, labels)) > SIDE_BY_SIDE
    axes.set_xticks(place, labels, rotation=90 if upright else 0)


def health_summary(health: Any) -> Summary:
    """Return the summary of panel health: illumination patterns that the Sun cannot cause, and their possible explanations.

    An explanation is a failed panel, or noise.
    """
    allowed, impossible = (
        [set_text(panels) for panels in named_panels(health, name)]
        for name in ("allowed_lit", "impossible_lit")
    )
    probabilities = zip(impossible, health["largest"].values.tolist(), strict=True)
    numbers = {
        "allowed": allowed,
        "impossible": dict(zip(impossible, health["samples"].values.tolist(), strict=True)),
        "explanations": [list(lost) for lost in named_panels(health, "lost")],
        "noise_probability": {lit: value for lit, value in probabilities if np.isfinite(value)},
    }
    return Summary(
        numbers,
        health_lines(numbers) or ["all illumination patterns are physically possible"],
    )


def health_lines(numbers: Mapping[str, Any]) -> list[str]:
    """Return a line on the impossible patterns and what may explain them; none if no pattern is impossible.

    `numbers`: those of :func:`health_summary`. `sunspin check` adds the entry `made_by`, a cause other than a failed panel in
    words, which is empty if there is none.
    """
    if not numbers["impossible"]:
        return []
    by_frequency = sorted(numbers["impossible"].items(), key=lambda item: -item[1])
    printed = by_frequency[:SETS]
    # names with signs, as in "-X, +Y", have commas; such a pattern gets parentheses
    if any("," in lit for lit, _ in printed):
        patterns = "; ".join(f"({lit}) in {count_text(n, 'sample')}" for lit, n in printed)
    else:
        patterns = ", ".join(f"{lit} ({n})" for lit, n in printed)
    patterns += f" and {len(by_frequency) - SETS} other sets" if len(by_frequency) > SETS else ""
    head = "  impossible illumination patterns"
    if made_by := numbers.get("made_by"):
        return [f"{head}, explained by {made_by}: {patterns}"]
    lost = " or ".join(" and ".join(panels) for panels in numbers["explanations"][:3])
    why = f"a failed or shaded panel {lost} would explain" if lost else "no failed panel explains"
    largest, noise = max(numbers["noise_probability"].values(), default=0.0), ""
    if largest > NEGLIGIBLE:
        noise = f"; noise alone makes the likeliest of them with a probability of at most {number_text(largest, 2)}"
    elif numbers["noise_probability"]:
        noise = "; noise alone does not make them"
    return [f"{head}: {patterns}; {why} them{noise}"]


def health_drawings(health: Any, _: Context) -> Iterator[Drawing]:
    """Yield the figure of impossible illumination patterns."""
    yield Drawing(
        "panel-health",
        lambda: health_figure(health),
        "Which panels were lit together although the Sun cannot light them so, and how often.",
        "Sets of panels that were lit together and that the Sun alone cannot light; a panel whose loss explains them is marked.",
    )


@styled
def health_figure(health: Any) -> Any:
    """Draw the impossible illumination patterns, a row each with its number of samples.

    A dashed line marks each panel of the first explanation: the set of panels whose loss explains all patterns.
    """
    lit, lost = (health[name].values.astype(bool) for name in ("impossible_lit", "lost"))
    title = "Nothing was lit that the Sun cannot light"
    if len(lit):
        title = "Lit together, which the Sun alone cannot do"
    figure, axes = axes_grid(7, 1.6 + 0.35 * max(len(lit), 3), title=title)
    row, column = np.nonzero(lit)
    axes.plot(column, row, "s", ms=11, color=COLOURS[4], label="lit")
    for k, panel in enumerate(np.flatnonzero(lost[:1].any(axis=0))):
        label = None if k else "its loss explains them"  # once in the legend
        axes.axvline(panel, color=COLOURS[1], lw=1.4, ls="--", label=label)
    axes.set_yticks(range(len(lit)), [f"{n} samples" for n in health["samples"].values])
    _label_panels(axes, np.arange(lit.shape[1]), health["panel"].values)
    axes.set(xlabel="panel", xlim=(-0.6, lit.shape[1] - 0.4))
    axes.set_ylim((len(lit) - 0.4, -0.6) if len(lit) else (1, 0))
    axes.legend(ncols=2, **ABOVE)
    return figure


KINDS.update(
    panel_quality=Kind("panel_quality", "panel-quality", quality_summary, quality_drawings),
    panel_health=Kind("panel_health", "panel-health", health_summary, health_drawings),
)
