"""What the heights of the Sun leave of the motion: angular speed after the touchdown, and the two angles that they see."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from sunspin.output.figures import ABOVE, COLOURS, titled
from sunspin.output.text import counted
from sunspin.philae import touchdown
from sunspin.philae.candidates import Candidates, Chain

BEFORE, CHOSEN, RECIPE = "#9a9a9a", COLOURS[0], COLOURS[1]
LEAST_IN_A_BIN = 30
"""Bins are as wide as leaves so many motions in each, on average: fewer would show the steps of the grid."""

MOST_BINS = 40
MOST_POINTS = 6000


def draw(chain: Chain, synthetic: bool) -> Figure:
    """Share of the motions by angular speed at the touchdown, and the smaller and the larger angle of the momentum."""
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    speed, angles = figure.subplots(1, 2)
    _speeds(speed, chain)
    _angles(angles, chain)
    figure.suptitle(
        titled("What this telemetry leaves of the motion after the first touchdown", synthetic),
        fontsize=11,
    )
    return figure


def _short(chain: Chain) -> str:
    if chain.calibration is not None:
        return f"the {chain.calibration.confidence:.0%} set, EMD < {chain.calibration.factor()[0]:.2f} EMD_min"
    names = {
        "scan": "the set of the scan",
        "posterior": "draws of the posterior",
        "published": "the printed lines, whatever the data say",
    }
    return names.get(chain.name, f"motions of {chain.name}")


def _speeds(axes: Any, chain: Chain) -> None:
    """What was possible, what is left of it, and the bound, which counts the cells of the grid and so lies below the least."""
    box, chosen = chain.box.speed_touchdown, chain.chosen.speed_touchdown
    bins = int(np.clip(min(len(box), len(chosen)) / LEAST_IN_A_BIN, 5, MOST_BINS))
    edges = np.linspace(0.0, float(max(box.max(), chosen.max())), bins + 1)
    for values, colour, fill, name in (
        (box, BEFORE, True, "possible before the data"),
        (chosen, CHOSEN, False, f"left: {_short(chain)}"),
    ):
        density, _ = np.histogram(values, edges, density=True)
        axes.stairs(
            density, edges, color=colour, lw=1.8, fill=fill, alpha=0.45 if fill else 1.0, label=name
        )
    low = touchdown.lower_bound(chain)
    if low > chain.box.speed_range()[0] + touchdown.LEAST_STEP_RAD_S:
        axes.axvspan(0, low, color=CHOSEN, alpha=0.12, lw=0)
        axes.axvline(low, color=CHOSEN, lw=1.4, ls=":", label=f"our lower bound: {low:.3f} rad/s")
    else:
        axes.plot([], [], " ", label="no lower bound follows")
    published = float(chain.case.published["rate_at_touchdown_min"].value)
    axes.axvline(
        published,
        color=RECIPE,
        ls="--",
        lw=1.4,
        label=f"published lower bound: {published:g} rad/s",
    )
    axes.set(
        xlim=(0, edges[-1]),
        xlabel="angular speed just after the first touchdown (rad/s)",
        ylabel="density (s/rad)",
    )
    axes.legend(fontsize=8, ncols=2, **ABOVE)


def _angles(axes: Any, chain: Chain) -> None:
    """The two angles of every motion: chosen ones over all that were possible."""
    for name, candidates, marker, colour, size in (
        ("possible before the data", chain.box, "s", "#cccccc", 3.0),
        (f"left: {_short(chain)}", chain.chosen, "o", CHOSEN, 1.8),
        (
            f"the paper's recipe, EMD < {chain.case.assumptions.study.near_minimum_factor:g} EMD_min",
            chain.recipe,
            "D",
            RECIPE,
            4.0,
        ),
    ):
        label = f"{name} ({counted(len(candidates), 'motion')})"
        axes.plot(
            *_pair(candidates), marker, ms=size, mew=0, color=colour, label=label, rasterized=True
        )
    ends = np.degrees(
        [np.max(angle) for angle in (chain.box.smaller_angle, chain.box.larger_angle)]
    )
    axes.set(
        xlim=(0, ends[0] + 2),
        ylim=(0, 1.3 * ends[1]),
        xticks=range(0, int(ends[0]) + 2, 15),
        yticks=range(0, int(ends[1]) + 16, 30),
        xlabel="smaller of the angles from the momentum to z and to the Sun (deg)",
        ylabel="larger of the two (deg)",
    )
    legend = axes.legend(fontsize=8, loc="upper left")
    for handle in legend.legend_handles:
        handle.set_markersize(6)
    cell = float(np.degrees(np.median(chain.chosen.angle_cell)))
    spread = f"; a cell of the grid: {cell:.2g} deg" if cell > 0 else ""
    axes.set_title(f"Angles of the momentum{spread}", fontsize=9)
    axes.grid(lw=0.3)


def _pair(candidates: Candidates) -> np.ndarray:
    """Smaller and larger angle (2, n), deg, of at most `MOST_POINTS` of them, evenly, and of those at the ends of either angle."""
    angles = np.stack([candidates.smaller_angle, candidates.larger_angle])
    shown = np.arange(0, len(candidates), -(-len(candidates) // MOST_POINTS))
    return np.degrees(
        angles[:, np.union1d(shown, [*angles.argmin(axis=1), *angles.argmax(axis=1)])]
    )
