"""How often the paper's method finds the truth: the method on twins of known truth (paper, sections 2.3 and 3.2)."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from sunspin.output.figures import COLOURS
from sunspin.philae.coverage import Coverage, Share, Twins
from sunspin.philae.threshold import CONFIDENCE
from sunspin.telemetry.case import Case

NAMES = {"lines": "truth on the published lines", "grid": "truth anywhere in the box"}
DEGREES = np.degrees(1.0)
BOUND_TOP = 0.4
"""rad/s; end of the axis of lower bounds."""


def draw(case: Case, study: Coverage) -> Figure:
    """EMD of the truth against the smallest; coverage against the factor; the lines' wandering; the lower bound."""
    figure = Figure(figsize=(9.5, 9.0), layout="constrained")
    (scatter, cover), (turned, bound) = figure.subplots(2, 2)
    twins, published = study.twins, case.published
    _scatter(scatter, twins, study.factor, published["emd_min"].value)
    _coverage(cover, twins, study.factor)
    _turned(turned, twins["lines"], study.factor)
    _bound(bound, twins["lines"], published["rate_at_touchdown_min"].value)
    figure.suptitle(
        f"The method repeated on synthetic rebounds of known truth: {twins['lines'].n} twins of each kind",
        fontsize=11,
    )
    return figure


def _scatter(axes: Any, each: dict[str, Twins], factor: float, published: float) -> None:
    for k, (kind, twins) in enumerate(each.items()):
        axes.loglog(
            twins.twin["emd_min"],
            twins.twin["emd_truth"],
            "o^"[k],
            ms=3.5,
            mfc="none",
            mew=0.7,
            color=COLOURS[k],
            label=NAMES[kind],
        )
    low, high = axes.get_xlim()
    x = np.array([low, high])
    axes.loglog(x, x, lw=0.8, color=COLOURS[7])
    axes.loglog(x, factor * x, "--", lw=1, color=COLOURS[6], label=f"{factor:g} times the smallest")
    axes.axvline(published, ls=":", lw=1.2, color=COLOURS[2], label="published smallest EMD")
    axes.set(xlim=(low, high), xlabel="smallest EMD of the scan", ylabel="EMD of the true motion")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
    axes.legend(fontsize=9, loc="lower right")
    axes.set_title("the truth is rarely the best", fontsize=10)


def _coverage(axes: Any, each: dict[str, Twins], chosen: float) -> None:
    at = np.geomspace(1.0, 10.0, 200)
    for k, (kind, twins) in enumerate(each.items()):
        shares = [twins.in_set(factor) for factor in at]
        band = np.array([share.interval for share in shares])
        axes.fill_between(at, band[:, 0], band[:, 1], color=COLOURS[k], alpha=0.25, lw=0)
        axes.semilogx(
            at,
            [share.value for share in shares],
            "-" if k == 0 else "--",
            color=COLOURS[k],
            label=NAMES[kind],
        )
    axes.axvline(chosen, ls="--", lw=1, color=COLOURS[6], label=f"the paper's {chosen:g}")
    axes.axhline(CONFIDENCE, ls=":", lw=1, color=COLOURS[7])
    axes.set_xticks([1, 1.5, 2, 3, 5, 10], ["1", "1.5", "2", "3", "5", "10"])
    axes.minorticks_off()
    axes.set(
        xlabel="factor on the smallest EMD",
        ylabel="share of twins whose truth lies in the set",
        ylim=(0, 1.02),
    )
    axes.legend(fontsize=9, loc="lower right")
    axes.set_title(
        "how often the level set holds the truth\n(band: 95 % sampling error)", fontsize=10
    )


def _turned(axes: Any, lines: Twins, factor: float) -> None:
    bins = np.linspace(0, 90, 31)
    for k in range(lines.twin["line_angle"].shape[1]):
        angle = lines.twin["line_angle"][:, k] * DEGREES
        angle = angle[np.isfinite(angle)]
        median = f", median {np.median(angle):.0f} deg" if angle.size else ""
        axes.hist(angle, bins, histtype="step", lw=1.3, color=COLOURS[k], label=f"L{k + 1}{median}")
    fitted = Share(int(np.isfinite(lines.twin["line_angle"][:, 0]).sum()), lines.n)
    axes.set(xlabel="angle between fitted and published line (deg)", ylabel="twins per 3 deg")
    axes.legend(fontsize=9)
    axes.set_title(
        f"lines fitted to EMD < {factor:g} EMD_min;\npossible in {fitted.value:.0%} of the twins",
        fontsize=10,
    )


def _bound(axes: Any, lines: Twins, published: float) -> None:
    table = lines.levels
    speed = np.where(np.isfinite(table["speed"]), table["speed"], np.nan)
    top = np.where(
        np.isfinite(speed[:, 2]), speed[:, 2], BOUND_TOP
    )  # more than 5 % of the sets are empty and bound nothing
    axes.fill_between(
        table["at"],
        speed[:, 0],
        top,
        color=COLOURS[0],
        alpha=0.25,
        lw=0,
        label="5 to 95 % of the twins",
    )
    axes.plot(table["at"], speed[:, 1], color=COLOURS[0], label="median twin")
    axes.plot([], [], color=COLOURS[3], label="share of twins in which it is a bound (right)")
    value, low, high = lines.threshold(CONFIDENCE, False)
    axes.axvspan(low, high, color=COLOURS[4], alpha=0.35, lw=0)
    axes.axvline(value, lw=1, color=COLOURS[4], label=f"holds the truth with {CONFIDENCE:.0%}")
    axes.axhline(published, ls="--", lw=1, color=COLOURS[6], label="published bound")
    axes.set(
        xlabel="threshold on EMD",
        ylabel=r"smallest $|\omega|$ at the touchdown (rad/s)",
        xlim=(table["at"][0], 0.12),
    )
    axes.set_ylim(0, BOUND_TOP)
    right = axes.twinx()
    right.plot(table["at"], table["holds"] / lines.n, color=COLOURS[3], lw=1)
    right.set(ylim=(0, 1.02), ylabel="share of twins")
    axes.legend(
        fontsize=9,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.17),
        ncols=2,
        frameon=False,
        columnspacing=0.8,
    )
    axes.set_title("lower bound on the angular speed,\ntruth on the published lines", fontsize=10)
