"""Which panels are lit, which lit patterns geometry forbids, and how improbable noise alone makes them (paper, section 4)."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from sunspin.output.figures import ABOVE, COLOURS, ON_PAPER, titled
from sunspin.philae.phases import Phases
from sunspin.telemetry.sun import SunStatus

FLOOR = -20.0
"""log10 of probability below which points are drawn at this height."""


def draw(result: Phases) -> Figure:
    """Lit panels sample by sample; Delta by phase; probability of the forbidden samples under noise."""
    figure = Figure(figsize=(9, 7.4), layout="constrained")
    top, low = figure.subplots(2, 1, height_ratios=(1, 1.15), sharex=True)
    _lit(top, result)
    _probability(low, result)
    figure.suptitle(titled("Health of the panels", result.synthetic), fontsize=11)
    return figure


def _lit(axes: Any, r: Phases) -> None:
    lit = r.sun["lit"].values
    forbidden = r.sun["status"].values == SunStatus.IMPOSSIBLE
    number = np.arange(1, len(lit) + 1)
    for k in range(lit.shape[1]):
        for chosen, colour, label in (
            (~forbidden, COLOURS[0], "pattern allowed"),
            (forbidden, COLOURS[1], "pattern forbidden"),
        ):
            at = lit[:, k] & chosen
            axes.plot(
                number[at],
                np.full(at.sum(), k),
                "|",
                ms=9,
                mew=1.6,
                color=colour,
                label=label if k == 0 else None,
            )
    axes.set_yticks(range(lit.shape[1]), [str(name) for name in r.sun["panel"].values])
    axes.set_ylabel("panel lit")
    axes.set_ylim(-0.6, lit.shape[1] + 0.6)
    handles = [
        axes.plot([], [], "s", color=c, label=x)[0]
        for c, x in ((COLOURS[0], "allowed"), (COLOURS[1], "forbidden"))
    ]
    axes.legend(handles=handles, ncols=2, fontsize=9, **ABOVE)
    explained = " or ".join("-".join(panels) for panels in r.health["explanations"]) or "none"
    what = "smallest set of panels in shadow or dead that explains every forbidden pattern"
    axes.set_title(f"{what}: {explained}", fontsize=10, pad=20)
    _phases(axes, r)


def _phases(axes: Any, r: Phases) -> None:
    edge = 0.5
    for phase in r.phases[:-1]:
        edge += phase.samples
        axes.axvline(edge, lw=0.8, color=COLOURS[7])


def _probability(axes: Any, r: Phases) -> None:
    number = np.arange(1, r.log10_probability.size + 1)
    lit, names = r.sun["lit"].values, r.sun["panel"].values
    for k, pattern in enumerate(r.health["impossible"]):
        at = np.isfinite(r.log10_probability) & np.all(lit == np.isin(names, pattern), axis=1)
        if at.any():
            shown = np.maximum(r.log10_probability[at], FLOOR)
            axes.plot(
                number[at],
                shown,
                "os^Dv"[k % 5],
                ms=5,
                mfc="none",
                color=COLOURS[k % 8],
                label=f"({'-'.join(pattern)})",
            )
    finite = r.log10_probability[np.isfinite(r.log10_probability)]
    bottom = max(FLOOR, float(finite.min(initial=-1.0)))
    axes.set(
        xlabel="number of the sample",
        ylabel="log10 of the probability, at most",
        ylim=(bottom - 1, 2.5),
    )
    axes.set_title(
        "probability that noise alone made the readings of a forbidden sample, by lit panels",
        fontsize=10,
        pad=20,
    )
    if r.health["noise"]:
        axes.legend(fontsize=9, ncols=5, columnspacing=0.8, handletextpad=0.2, **ABOVE)
    _phases(axes, r)
    edge = 0.5
    for k, phase in enumerate(r.phases):
        if phase.samples > 8:
            axes.text(
                edge + phase.samples / 2,
                0.6 + k % 2,
                phase.name.replace("_", " "),
                ha="center",
                fontsize=8,
                color="#555555",
                bbox=ON_PAPER,
            )
        edge += phase.samples
