"""What the heights of the Sun leave of the motion: angular speed after the touchdown, and the two angles that they see."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from sunspin.output.figures import ABOVE, COLOURS, titled
from sunspin.output.text import counted
from sunspin.philae import touchdown
from sunspin.philae.candidates import Chain

BEFORE, CHOSEN, RECIPE = "#9a9a9a", COLOURS[0], COLOURS[1]
LEAST_IN_A_BIN = 30
"""Bins are as wide as leaves so many motions in each, on average: fewer would show the steps of the grid."""

MOST_BINS = 40
MOST_POINTS = 6000
"""Motions of a set whose angles are drawn: an even choice where there are more, and those at the ends of either angle."""


def draw(chain: Chain, synthetic: bool) -> Figure:
    """Share of the motions by angular speed at the touchdown, and the smaller and the larger angle of the momentum (Fig. 12)."""
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    speed, angles = figure.subplots(1, 2)
    names = {
        "scan": "the set of the scan",
        "posterior": "draws of the posterior",
        "published": "the published lines, for any data",
    }
    left = names.get(chain.name, f"motions of {chain.name}")
    if chain.calibration is not None:
        level = chain.calibration.factor()[0]
        left = f"the {chain.calibration.confidence:.0%} set, EMD < {level:.2f} EMD_min"
    _draw_speeds(speed, chain, left)
    _draw_angles(angles, chain, left)
    title = "What this telemetry leaves of the motion after the first touchdown"
    figure.suptitle(titled(title, synthetic), fontsize=11)
    return figure


def _draw_speeds(axes: Any, chain: Chain, left: str) -> None:
    """What was possible, what is left of it, and the bound, which counts the cells of the grid and so lies below the least."""
    box, chosen = chain.box.speed_touchdown, chain.chosen.speed_touchdown
    bins = int(np.clip(min(len(box), len(chosen)) / LEAST_IN_A_BIN, 5, MOST_BINS))
    edges = np.linspace(0.0, float(max(box.max(), chosen.max())), bins + 1)
    before, after = (np.histogram(values, edges, density=True)[0] for values in (box, chosen))
    style = {"color": BEFORE, "fill": True, "alpha": 0.45}
    axes.stairs(before, edges, lw=1.8, label="possible before the data", **style)
    axes.stairs(after, edges, lw=1.8, color=CHOSEN, label=f"left: {left}")
    low = touchdown.lower_bound(chain)
    if low > chain.box.speed_range()[0] + touchdown.LEAST_STEP_RAD_S:
        axes.axvspan(0, low, color=CHOSEN, alpha=0.12, lw=0)
        axes.axvline(low, color=CHOSEN, lw=1.4, ls=":", label=f"our lower bound: {low:.3f} rad/s")
    else:
        axes.plot([], [], " ", label="no lower bound follows")
    published = float(chain.case.published["rate_at_touchdown_min"].value)
    label = f"published lower bound: {published:g} rad/s"
    axes.axvline(published, color=RECIPE, ls="--", lw=1.4, label=label)
    axes.set(
        xlabel="angular speed just after the first touchdown (rad/s)", ylabel="density (s/rad)"
    )
    axes.set_xlim(0, edges[-1])
    axes.legend(fontsize=8, ncols=2, **ABOVE)


def _draw_angles(axes: Any, chain: Chain, left: str) -> None:
    """The two angles of every motion: chosen ones over all that were possible."""
    factor = chain.case.assumptions.study.near_minimum_factor
    for name, candidates, marker, colour, size in (
        ("possible before the data", chain.box, "s", "#cccccc", 3.0),
        (f"left: {left}", chain.chosen, "o", CHOSEN, 1.8),
        (f"the paper's recipe, EMD < {factor:g} EMD_min", chain.recipe, "D", RECIPE, 4.0),
    ):
        angles = np.degrees([candidates.smaller_angle, candidates.larger_angle])
        ends = *angles.argmin(axis=1), *angles.argmax(axis=1)
        even = np.arange(0, len(candidates), -(-len(candidates) // MOST_POINTS))
        shown = angles[:, np.union1d(even, ends)]
        style = {"ms": size, "mew": 0, "color": colour, "rasterized": True}
        label = f"{name} ({counted(len(candidates), 'motion')})"
        axes.plot(*shown, marker, label=label, **style)
    small, large = (
        float(np.degrees(angle.max()))
        for angle in (chain.box.smaller_angle, chain.box.larger_angle)
    )
    axes.set(
        xlim=(0, small + 2),
        ylim=(0, 1.3 * large),
        xticks=range(0, int(small) + 2, 15),
        yticks=range(0, int(large) + 16, 30),
        xlabel="smaller of the angles from the momentum to z and to the Sun (deg)",
        ylabel="larger of the two (deg)",
    )
    for handle in axes.legend(fontsize=8, loc="upper left").legend_handles:
        handle.set_markersize(6)
    cell = float(np.degrees(chain.chosen.angle_cell))
    spread = f"; a cell of the grid: {cell:.2g} deg" if cell > 0 else ""
    axes.set_title(f"Angles of the momentum{spread}", fontsize=9)
    axes.grid(lw=0.3)
