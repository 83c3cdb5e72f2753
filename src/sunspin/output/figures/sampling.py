"""How often should a lander sample: widths against period, noise and panels, and whether one motion is left."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from sunspin.landing.sampling import (
    IRREGULAR,
    MOTIONS,
    NOISES,
    PERIODS_S,
    USUAL_NOISE,
    USUAL_PERIOD_S,
    Widths,
)
from sunspin.output.figures import COLOURS


def draw(found: Widths, rows: list[dict[str, Any]]) -> Figure:
    """Sigma of the angular speed against sampling period for each noise, against the number of panels, volume of the rates against
    period, and the motions left: `rows` of :func:`sunspin.landing.sampling.aliases`."""
    figure = Figure(figsize=(12, 8), layout="constrained")
    (width, panels), (volume, left) = figure.subplots(2, 2)
    periods = np.array(PERIODS_S)
    for i, noise in enumerate(NOISES):
        for axes, values in ((width, found.speed_by_noise[i]), (volume, found.volume_by_noise[i])):
            axes.loglog(
                periods,
                np.median(values, axis=1),
                ".-",
                color=COLOURS[i % 8],
                label=f"{100 * noise:g} %",
            )
        if noise == USUAL_NOISE:
            for axes, values in (
                (width, found.speed_by_noise[i]),
                (volume, found.volume_by_noise[i]),
            ):
                axes.fill_between(
                    periods,
                    *np.quantile(values, [0.16, 0.84], axis=1),
                    color=COLOURS[i % 8],
                    alpha=0.2,
                    lw=0,
                )
    for axes in (width, volume):
        axes.axvline(USUAL_PERIOD_S, ls=":", lw=1, color=COLOURS[7])
        axes.set_xlabel("sampling period (s)")
        axes.set_xticks(
            [5, 10, 30, 60, 120, 300, 900],
            ["5", "10", "30", "60", "120", "300", "900"],
            minor=False,
        )
        axes.minorticks_off()
    width.set_ylabel(r"sigma of $|\omega|$ (rad/s)")
    width.set_title("A: width of the right region, six panels", fontsize=9)
    width.legend(fontsize=7, title="noise, of the largest signal", title_fontsize=7)
    volume.set_ylabel("volume that holds 90 % of the rates ((rad/s)$^3$)")
    volume.set_title("C: the same as a volume", fontsize=9)
    _panels(panels, found)
    _left(left, rows)
    text = f"What samples of 45 min tell of the rotation: Philae's body and wheel, median of {MOTIONS} simulated motions"
    figure.suptitle(f"{text} (synthetic)", fontsize=11)
    return figure


def _panels(axes: Any, found: Widths) -> None:
    counts = sorted(found.speed_by_panels)
    each = [np.median(found.speed_by_panels[n], axis=1) for n in counts]
    axes.fill_between(
        counts, [e.min() for e in each], [e.max() for e in each], color=COLOURS[5], alpha=0.3, lw=0
    )
    for values, style, label in (
        (np.min, "o-", "best set"),
        (np.median, "s--", "median set"),
        (np.max, "v:", "worst set"),
    ):
        axes.semilogy(counts, [values(e) for e in each], style, ms=4, color=COLOURS[0], label=label)
    axes.set(
        xlabel="panels (of Philae's six and two more on -x and -z)",
        ylabel=r"sigma of $|\omega|$ (rad/s)",
    )
    axes.set_title(
        f"B: number of panels, {USUAL_PERIOD_S} s, {100 * USUAL_NOISE:g} % noise", fontsize=9
    )
    axes.legend(fontsize=7)


def _left(axes: Any, rows: list[dict[str, Any]]) -> None:
    """Of twins: motions about the truth that fit all samples, each a mark, and their mean."""
    if not rows:
        axes.axis("off")
        return
    periods = np.array(sorted({row["period_s"] for row in rows}))
    for k, irregular in enumerate((False, True)):
        label = (
            f"irregular by up to {100 * IRREGULAR:g} % of the period"
            if irregular
            else "exactly regular"
        )
        each = [
            [
                row["motions"]
                for row in rows
                if row["irregular"] is irregular and row["period_s"] == p
            ]
            for p in periods
        ]
        x = periods * (0.96, 1.04)[k]
        for at, counts in zip(x, each, strict=True):
            axes.plot(
                np.full(len(counts), at),
                counts,
                "o^"[k],
                ms=5,
                mfc="none",
                alpha=0.6,
                color=COLOURS[k],
            )
        at = [
            (x[list(periods).index(r["period_s"])], r["motions"])
            for r in rows
            if r["irregular"] is irregular and r["weight_of_true"] == 0
        ]
        if at:
            axes.plot(*zip(*at, strict=True), "x", ms=6, color=COLOURS[6], zorder=5)
        axes.plot(
            x,
            [np.mean(counts) if counts else np.nan for counts in each],
            "-",
            color=COLOURS[k],
            label=f"{label}, mean",
        )
    axes.set(
        xscale="log",
        ylim=(0, 1.3 * max(row["motions"] for row in rows)),
        xlabel="sampling period (s)",
        ylabel="motions that fit all samples",
    )
    axes.set_xticks(periods, [f"{p:g}" for p in periods])
    axes.minorticks_off()
    twins = len({row["twin"] for row in rows})
    said = f"D: motions left near the truth, up to {twins} twins a period; x: truth not among them"
    axes.set_title(said, fontsize=9)
    axes.legend(fontsize=7)
