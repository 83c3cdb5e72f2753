"""What the heights of the Sun leave of the motion: angular speed after the touchdown, and the two angles that they see."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from sunspin.study.candidates import Candidates, Chain
from sunspin.tell.figures import COLOURS, _title

BINS = 60


def draw(chain: Chain, synthetic: bool) -> Figure:
    """Densities of the angular speed at the touchdown, and of the smaller and the larger angle of the momentum."""
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    speed, angles = figure.subplots(1, 2)
    _densities(speed, chain, lambda c: c.speed_touchdown)
    published = float(chain.case.published["rate_at_touchdown_min"].value)
    speed.axvline(published, color=COLOURS[1], ls="--", lw=1.2, label=f"published lower bound {published} rad/s")
    low = chain.chosen.speed_range()[0]
    speed.axvline(low, color=COLOURS[2], lw=1.4, label=f"lower bound from these candidates {low:.3f} rad/s")
    speed.set(xlabel="angular speed just after the first touchdown (rad/s)", ylabel="density (s/rad)")
    speed.legend(fontsize=7)
    for name, candidates, colour, size in (
        ("possible before the data", chain.box, "#bbbbbb", 1), (_short(chain), chain.chosen, COLOURS[0], 1),
        ("the paper's recipe on this telemetry", chain.recipe, COLOURS[1], 6),
    ):  # fmt: skip
        every = max(len(candidates) // 6000, 1)
        pair = np.degrees(np.stack([candidates.smaller_angle, candidates.larger_angle])[:, ::every])
        angles.plot(*pair, ".", ms=size, color=colour, label=name, rasterized=True)
    angles.set(xlabel="smaller of the angles from H to z and to the Sun (deg)", ylabel="larger of them (deg)")
    angles.legend(fontsize=7, markerscale=4)
    figure.suptitle(_title("What this telemetry leaves of the motion after the first touchdown", synthetic), fontsize=11)
    return figure


def _short(chain: Chain) -> str:
    return {"scan": "the 90 % set of the scan", "published": "the printed lines"}.get(chain.name, f"candidates: {chain.name}")


def _densities(axes: Any, chain: Chain, values: Any) -> None:
    edges = np.linspace(0.0, float(values(chain.box).max()), BINS + 1)

    def steps(candidates: Candidates, colour: str, name: str) -> None:
        density, _ = np.histogram(values(candidates), edges, density=True)
        axes.stairs(density, edges, color=colour, lw=1.5, label=name)

    steps(chain.box, "#999999", "possible before the data")
    steps(chain.chosen, COLOURS[0], _short(chain))
