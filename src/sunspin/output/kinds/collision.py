"""Simulated collisions, weighted by their agreement with the speeds of a trajectory (paper, section 3.3)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sunspin.landing.tally import read_explained_share, read_facts, read_weightings
from sunspin.output.figures import ABOVE, COLOURS, axes_grid, styled
from sunspin.output.kind import KINDS, Context, Drawing, Kind, Summary
from sunspin.output.text import with_sigma


def collision_summary(runs: Any) -> Summary:
    """Return the summary of collisions: the share that agrees with the trajectory, rates and periods under each weighting."""
    table, agreeing_share = read_weightings(runs), read_explained_share(runs)
    lines = [
        f"collision: {with_sigma(*agreeing_share)} of the runs come near the kernel's jump and speed"
    ]
    for row in table:
        rates = (row[name] for name in ("rate_before", "rate_after"))
        before, after = (with_sigma(*np.degrees(rate), "deg/s") for rate in rates)
        lines.append(
            f"  {row['name']}: effective sample size {row['effective_runs']:.0f}, rate before {before}, after {after}, "
            f"median period after {row['median_period_after']:.1f} s"
        )
    return Summary({"facts": read_facts(runs), "explained": agreeing_share, "table": table}, lines)


def collision_drawings(runs: Any, _: Context) -> Iterator[Drawing]:
    """Yield the figure of simulated collisions."""
    yield Drawing(
        "collision",
        lambda: collision_figure(runs),
        "Simulated collisions against the speeds of the trajectory kernel.",
        "Simulated collisions and what the trajectory shows; angular speeds after it as drawn and weighted by the kernel's speeds.",
    )


@styled
def collision_figure(runs: Any) -> Any:
    """Draw simulated collisions against the speeds of the trajectory kernel, and the angular speed after the collision.

    Left: speed after a collision over the change of velocity. Right: histograms of the angular speed, unweighted and weighted by
    agreement with the kernel, and the range that the magnetometer's period gives.
    """
    figure, (left, right) = axes_grid(11, 4.4, 1, 2, "The collision")
    facts, sigma = read_facts(runs), runs.attrs["sigma_m_s"]
    change, speed = (runs[name].values for name in ("velocity_change", "speed_after"))
    finite = np.isfinite(speed)
    style = {"gridsize": 45, "cmap": "cividis", "mincnt": 1, "linewidth": 0}
    image = left.hexbin(change[finite], speed[finite], **style)
    figure.colorbar(image, ax=left, label="simulated collisions")
    angle = np.linspace(0, 2 * np.pi, 100)
    for radius in (sigma, 2 * sigma):  # circles about the kernel's values, one label for both
        x = facts["velocity_change"] + radius * np.cos(angle)
        y = facts["speed_after"] + radius * np.sin(angle)
        label = "trajectory kernel, 1 and 2 sigma" if radius == sigma else None
        left.plot(x, y, color=COLOURS[1], lw=1.8, label=label)
    left.set_xlabel("change of velocity at the collision (m/s)")
    left.set_ylabel("speed after the collision (m/s)")
    left.legend(loc="lower left", frameon=True)
    left.set_title(f"Impacts at {facts['speed_before']:.3f} m/s and what the trajectory shows")
    rate = np.degrees(np.linalg.norm(runs["omega_after_B"].values, axis=1))
    finite, edges = np.isfinite(rate), np.linspace(0, 60, 61)
    for label, weights, dashes, colour in (
        ("as drawn", None, "-", COLOURS[0]),
        ("weighted by the kernel's speeds", runs["weight"].values[finite], "--", COLOURS[1]),
    ):
        style = {"histtype": "step", "lw": 1.8, "ls": dashes, "color": colour}
        right.hist(rate[finite], edges, weights=weights, density=True, label=label, **style)
    period, width = runs.attrs["period_after_s"], 2 * runs.attrs["sigma_period_s"]
    label = f"magnetometer: {period:g} s, drawn {width:g} s wide to each side"
    slowest, fastest = 360 / (period + width), 360 / (period - width)  # deg/s
    right.axvspan(slowest, fastest, color=COLOURS[2], alpha=0.25, lw=0, label=label)
    right.set(xlabel="angular speed just after the collision (deg/s)", xlim=(0, edges[-1]))
    right.set_ylabel("probability density (s/deg)")
    right.legend(**ABOVE)
    return figure


KINDS.update(collision=Kind("outcomes", "collision", collision_summary, collision_drawings))
