"""The posterior in rate space beside the paper's lines."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from sunspin.output.figures import COLOURS, titled
from sunspin.philae.against_lines import Against, along_line

SHOWN = 2500


def draw(result: Against) -> Figure:
    """Three views of rate space with the paper's level set, the printed lines (over the scanned omega_z) and the draws; below the
    draws enlarged, with one cell of the paper's grid."""
    figure = Figure(figsize=(12.5, 6.6), layout="constrained")
    grid = figure.subplots(2, 3)
    shown, cloud = next(
        (name, points) for name, (points, _) in result.sets.items() if points is not None
    )  # the paper's own
    for k, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
        whole, near = grid[0, k], grid[1, k]
        whole.plot(
            cloud[:, i],
            cloud[:, j],
            "s",
            ms=2,
            color=COLOURS[7],
            alpha=0.6,
            rasterized=True,
            label=shown,
        )
        for axes in (whole, near):
            _lines(axes, result, i, j)
            axes.set(xlabel=rf"$\omega_{'xyz'[i]}$ (rad/s)", ylabel=rf"$\omega_{'xyz'[j]}$ (rad/s)")
        whole.plot(
            *result.omega_B[:SHOWN, [i, j]].T,
            ".",
            ms=3,
            color=COLOURS[6],
            rasterized=True,
            label="the posterior",
            zorder=5,
        )
        _enlarged(near, result, i, j)
    handles = {
        str(h.get_label()): h for axes in grid[:, 0] for h in axes.get_legend_handles_labels()[0]
    }  # the lines are in both
    figure.legend(
        handles=list(handles.values()), fontsize=9, loc="outside lower center", ncols=len(handles)
    )
    smallest = min(result.factors.values())
    text = f"Rates at the first sample: the posterior holds 90 % in {_power(result.volume)} (rad/s)$^3$, "
    text += f"at least {smallest:.0f} times less than any of the line sets"
    figure.suptitle(titled(text, result.synthetic), fontsize=11)
    return figure


def _power(value: float) -> str:
    digits, exponent = f"{value:.1e}".split("e")
    return rf"{digits}$\times 10^{{{int(exponent)}}}$"


def _lines(axes: Any, result: Against, i: int, j: int) -> None:
    for k, line in enumerate(result.lines):
        ends = along_line(line, *result.omega_z)
        axes.plot(
            ends[:, i], ends[:, j], "-", lw=1.3, color=COLOURS[k], label=f"L{k + 1}", zorder=3
        )


def _enlarged(axes: Any, result: Against, i: int, j: int) -> None:
    omega, middle = result.omega_B, result.omega_B.mean(axis=0)
    axes.plot(
        *omega[:SHOWN, [i, j]].T,
        ".",
        ms=1.5,
        alpha=0.5,
        color=COLOURS[6],
        rasterized=True,
        zorder=4,
    )
    half = 0.5 * result.step
    axes.add_patch(
        Rectangle(
            (middle[i] - half, middle[j] - half),
            2 * half,
            2 * half,
            fill=False,
            ls="--",
            color=COLOURS[1],
            lw=1.2,
            label="one cell of the paper's grid",
            zorder=5,
        )
    )
    if result.truth is not None:
        axes.plot(
            result.truth[i],
            result.truth[j],
            "+",
            ms=11,
            mew=2,
            color=COLOURS[2],
            label="truth",
            zorder=6,
        )
    reach = 1.2 * max(half, float(np.abs(omega[:, [i, j]] - middle[[i, j]]).max()))
    axes.locator_params(nbins=5)
    axes.set(
        xlim=(middle[i] - reach, middle[i] + reach), ylim=(middle[j] - reach, middle[j] + reach)
    )
