"""The set of motions that a scan leaves, its lines and thresholds (paper, Fig. 9), and both run back to the touchdown (Fig. 12)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from sunspin.estimate.scan.lines import Line
from sunspin.output.figures import COLOURS

RATE_TICKS = (-0.4, 0.0, 0.4, 0.8)
"""rad/s: as many as stand apart in perspective."""


def level_set_figure(
    points: np.ndarray,
    lines: Any,
    published: Sequence[Line],
    title: str,
    truth: np.ndarray | None = None,
) -> Figure:
    """Near-minimum points in rate space with fitted (solid) and published (dashed) lines (paper, Fig. 9)."""
    figure = Figure(figsize=(11, 5.2), layout="constrained")
    views = (("perspective", 22, -62), ("from +z", 90, -90))
    member = np.zeros(len(points), int) if lines is None else lines["member"].values
    for k, (name, elevation, azimuth) in enumerate(views):
        axes = figure.add_subplot(1, 2, k + 1, projection="3d")
        axes.view_init(elevation, azimuth)
        axes.scatter(*points.T, s=8, c=[COLOURS[m % 8] for m in member], depthshade=False)
        for i, (point, direction) in enumerate(published):
            label = "the paper's lines" if i == 0 else None
            axes.plot(*_clipped(point, direction).T, "--", lw=1, color="#555555", label=label)
        if lines is not None:
            for i, (point, direction) in enumerate(
                zip(lines["point"].values, lines["direction"].values, strict=True)
            ):
                count = f"fitted line {i + 1} ({int((member == i).sum())} motions)"
                axes.plot(
                    *_clipped(point, direction).T, "-", lw=1.6, color=COLOURS[i % 8], label=count
                )
        if truth is not None:
            axes.scatter(
                *truth, marker="*", s=130, color="#000000", label="truth of the synthetic telemetry"
            )
        axes.set_xlabel(r"$\omega_x$ (rad/s)")
        axes.set_ylabel(r"$\omega_y$ (rad/s)")
        axes.set_zlabel(r"$\omega_z$ (rad/s)" if k == 0 else "")
        if k:
            axes.zaxis.set_ticks([])
        axes.set(
            xlim=(-0.5, 1), ylim=(-0.5, 1), zlim=(-0.3, 0.3), xticks=RATE_TICKS, yticks=RATE_TICKS
        )
        axes.set_title(name, fontsize=9)
    figure.suptitle(title, fontsize=11)
    figure.legend(
        *figure.axes[0].get_legend_handles_labels(),
        fontsize=9,
        ncols=3,
        loc="outside lower center",
        frameon=False,
    )
    return figure


def _clipped(point: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The part of a line inside the scanned box."""
    low, high = np.array([-0.5, -0.5, -0.3]), np.array([1.0, 1.0, 0.3])
    along = np.abs(direction) > 1e-12  # a line parallel to a pair of faces meets neither
    ends = np.sort(
        np.array(
            [(low - point)[along] / direction[along], (high - point)[along] / direction[along]]
        ),
        axis=0,
    )
    begin, end = ends[0].max(), ends[1].min()
    return point + np.linspace(begin, max(begin, end), 2)[:, None] * direction


def thresholds_figure(table: list[dict[str, Any]], chosen: float) -> Figure:
    """Points of the near-minimum set, and distance of its lines from the published ones, against the factor."""
    figure = Figure(figsize=(8, 3.6), layout="constrained")
    figure.suptitle("Near-minimum set of the published lines' distribution", fontsize=10)
    left, right = figure.subplots(1, 2)
    factors = [row["factor"] for row in table]
    left.semilogy(factors, [max(row["points"], 1) for row in table], "o-", color=COLOURS[0])
    left.set_ylabel("points in the set")
    for k in range(4):
        fitted = [(row["factor"], row["mean_distance"][k]) for row in table if row["mean_distance"]]
        right.plot(*zip(*fitted, strict=True), "o-", ms=4, color=COLOURS[k], label=f"L{k + 1}")
    right.set_yscale("log")
    right.set_ylabel("mean distance from the paper's line (rad/s)", fontsize=9)
    right.legend(fontsize=8)
    for axes in (left, right):
        axes.axvline(chosen, lw=0.8, ls="--", color=COLOURS[7])
        axes.set_xlabel("factor on the smallest EMD")
    return figure


def distributions_figure(
    z: np.ndarray, weights_label: str, others: dict[str, np.ndarray], title: str
) -> Figure:
    """Cumulative distributions of r_z that the EMD compares."""
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axes = figure.subplots()
    axes.step(
        np.sort(z),
        np.arange(1, len(z) + 1) / len(z),
        where="post",
        color=COLOURS[6],
        label=weights_label,
    )
    for k, (label, values) in enumerate(
        others.items()
    ):  # nearly one curve in pairs: each second one in dashes over the first
        style: dict[str, Any] = {
            "lw": 5.0,
            "ls": (0, (1.5, 1.5)) if k % 2 else "-",
            "color": COLOURS[k],
        }
        if label.startswith("truth"):
            style = {"lw": 1.4, "ls": (0, (1, 2)), "color": COLOURS[6]}
        axes.plot(np.sort(values), np.linspace(0, 1, len(values)), label=label, **style)
    axes.set_xlabel("$z$ component of the Sun's direction")
    axes.set_ylabel("cumulative distribution")
    axes.set_xlim(-0.05, 1.02)
    axes.legend(fontsize=9)
    axes.set_title(title, fontsize=11)
    return figure


def backward_figure(
    rates: np.ndarray, published: np.ndarray, smallest: float, label: str
) -> Figure:
    """Body rates at the first touchdown (paper, Fig. 12); `label` says which set of motions `rates` (n, 3) are."""
    figure = Figure(figsize=(6.5, 5.4), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    axes.scatter(
        *rates.T,
        s=6,
        color=COLOURS[0],
        alpha=0.35,
        lw=0,
        depthshade=False,
        label=f"{label} ({len(rates)} motions)",
    )
    axes.scatter(
        *published.T, s=9, color=COLOURS[1], depthshade=False, label="the paper's lines, run back"
    )
    axes.scatter(0, 0, 0, marker="+", s=80, color="#000000", label="no rotation")
    axes.set_xlabel(r"$\omega_x$ (rad/s)")
    axes.set_ylabel(r"$\omega_y$ (rad/s)")
    axes.set_zlabel(r"$\omega_z$ (rad/s)")
    axes.set(xticks=RATE_TICKS, yticks=RATE_TICKS)
    figure.suptitle(
        rf"Rates at the first touchdown; smallest $|\omega|$ on the paper's lines {smallest:.4f} rad/s",
        fontsize=10,
    )
    figure.legend(
        *axes.get_legend_handles_labels(), fontsize=9, loc="outside lower center", frameon=False
    )
    return figure
