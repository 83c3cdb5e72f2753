"""The swing of the z axis and of the Sun's height on the published lines (paper, section 3.2)."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from sunspin.output.figures import COLOURS
from sunspin.philae.precession import Precession


def draw(result: Precession) -> Figure:
    """Height of the Sun on each line, whole window and its first and last ten minutes; nutation angle; swing of the axis."""
    figure = Figure(figsize=(11.5, 7), layout="constrained")
    upper, lower = figure.subfigures(2, 1, squeeze=False)[:, 0]
    heights = upper.subplots(1, 4, sharey=True)
    for k, axes in enumerate(heights):
        _heights(axes, result, k)
    heights[0].set_ylim(
        min(-5.0, heights[0].dataLim.y0, *(axes.dataLim.y0 for axes in heights)) - 1, 92
    )
    upper.legend(
        *heights[0].get_legend_handles_labels(),
        fontsize=8,
        ncols=4,
        loc="outside lower center",
        frameon=False,
    )
    nutation, swing = lower.subplots(1, 2)
    _nutation(nutation, result)
    _swing(swing, result)
    figure.suptitle(
        "Precession on the paper's lines, simulated from the first sample to the collision",
        fontsize=11,
    )
    return figure


def _heights(axes: Any, r: Precession, k: int) -> None:
    line = r.lines[k]
    low, high = np.degrees(line.height).T
    axes.fill_between(r.omega_z, low, high, color=COLOURS[5], alpha=0.4, lw=0, label="whole window")
    for style, label, z in (
        ("--", "first 10 min", line.z_first),
        ("-", "last 10 min", line.z_last),
    ):
        for i, end in enumerate(np.degrees(np.arcsin(z)).T):
            axes.plot(
                r.omega_z, end, style, lw=1.2, color=COLOURS[6], label=label if i == 0 else None
            )
    for i, height in enumerate(r.case.published["sun_height_range"].value):
        axes.axhline(
            height, ls=":", lw=1.2, color=COLOURS[1], label="published" if i == 0 else None
        )
    axes.set(xlabel=r"$\omega_z$ at the first sample (rad/s)", title=f"L{k + 1}")
    if k == 0:
        axes.set_ylabel("height of the Sun (deg)")


def _nutation(axes: Any, r: Precession) -> None:
    for k, line in enumerate(r.lines):
        low, high = np.degrees(line.nutation).T
        axes.fill_between(r.omega_z, low, high, color=COLOURS[k], alpha=0.15, lw=0)
        axes.plot(r.omega_z, np.degrees(line.nutation_first), "--", lw=1.2, color=COLOURS[k])
        axes.plot(
            r.omega_z,
            np.degrees(line.nutation_last),
            "-",
            lw=1.2,
            color=COLOURS[k],
            label=f"L{k + 1}",
        )
    axes.set(xlabel=r"$\omega_z$ at the first sample (rad/s)", ylabel="angle between z and H (deg)")
    axes.set_ylim(20, max(70.0, *(8 + np.degrees(line.nutation.max()) for line in r.lines)))
    axes.legend(fontsize=8, ncols=4)
    axes.set_title(
        "nutation: range in the window, mean of first (dashed) and last 10 min", fontsize=9
    )


def _swing(axes: Any, r: Precession) -> None:
    for k, line in enumerate(r.lines):
        height = np.degrees(np.diff(line.height, axis=1)[:, 0])
        axes.plot(
            height,
            np.degrees(line.axis_swing),
            "os^D"[k],
            ms=5,
            mfc="none",
            color=COLOURS[k],
            label=f"L{k + 1}",
        )
    low, high = r.case.published["sun_height_range"].value
    axes.plot([50, 130], [50, 130], lw=0.8, color=COLOURS[7])
    axes.text(100, 103, "equal", fontsize=8, color="#555555", rotation=38)
    axes.plot(high - low, high - low, "*", ms=12, color=COLOURS[6], label="published")
    axes.set(
        xlabel="range of the Sun's height (deg)",
        ylabel="swing of the z axis in inertial space (deg)",
    )
    axes.set(
        xlim=(55, 120),
        ylim=(55, max(130.0, *(1.05 * np.degrees(line.axis_swing.max()) for line in r.lines))),
    )
    axes.legend(fontsize=8, loc="lower right")
    axes.set_title("the height's range is not the axis's swing", fontsize=9)
