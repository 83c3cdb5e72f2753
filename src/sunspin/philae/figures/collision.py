"""The collision against what the trajectory and the magnetometer show of it (paper, section 3.3)."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from sunspin.output.figures import COLOURS
from sunspin.philae.collision import SIGMA_M_S, Conditioned


def collision_figure(found: Conditioned) -> Figure:
    """Simulated collisions against the kernel's speeds, and angular speeds after it as drawn and as weighted."""
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    runs, facts = found.runs, found.facts
    fine = np.isfinite(runs["speed_after"].values)
    image = left.hexbin(
        runs["velocity_change"].values[fine], runs["speed_after"].values[fine], gridsize=45, cmap="cividis", mincnt=1, lw=0
    )
    figure.colorbar(image, ax=left, label="simulated collisions")
    turn = np.linspace(0, 2 * np.pi, 100)
    for k in (1, 2):
        left.plot(
            facts["velocity_change"] + k * SIGMA_M_S * np.cos(turn), facts["speed_after"] + k * SIGMA_M_S * np.sin(turn),
            color=COLOURS[1], lw=1.8, label="trajectory kernel, 1 and 2 sigma" if k == 1 else None,
        )  # fmt: skip
    left.set_xlabel("change of velocity at the collision (m/s)")
    left.set_ylabel("speed after the collision (m/s)")
    left.legend(fontsize=8, loc="lower left")
    left.set_title("Sticking impacts at 0.304 m/s and what the trajectory shows", fontsize=10)
    rate = np.linalg.norm(runs["omega_after_B"].values, axis=1)
    edges = np.linspace(0, 1.0, 51)
    for k, (weight, text) in enumerate(((np.ones_like(rate), "as drawn"), (found.weight, "weighted by the kernel's speeds"))):
        use = np.isfinite(rate)
        right.hist(
            rate[use],
            edges,
            weights=weight[use],
            density=True,
            histtype="step",
            lw=1.8,
            ls=("-", "--")[k],
            color=COLOURS[k],
            label=text,
        )
    right.axvspan(
        2 * np.pi / 28, 2 * np.pi / 20, color=COLOURS[2], alpha=0.25, lw=0, label="magnetometer: 24 s, drawn 4 s wide to each side"
    )
    right.set_xlim(0, 1)
    right.set_xlabel("angular speed just after the collision (rad/s)")
    right.set_ylabel("probability density (s/rad)")
    right.legend(fontsize=8, frameon=False)
    right.set_title("Rates after the collision", fontsize=10)
    return figure
