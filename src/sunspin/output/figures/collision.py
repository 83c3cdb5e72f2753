"""The collision against what the trajectory and the magnetometer show of it (paper, section 3.3)."""

from __future__ import annotations

import json

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from sunspin.landing.weighted import facts_of
from sunspin.output.figures import ABOVE, COLOURS, titled


def collision_figure(found: xr.Dataset) -> Figure:
    """Simulated collisions against the kernel's speeds, and angular speeds after it as drawn and as weighted."""
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    facts, sigma = facts_of(found), found.attrs["sigma_m_s"]
    fine = np.isfinite(found["speed_after"].values)
    image = left.hexbin(
        found["velocity_change"].values[fine],
        found["speed_after"].values[fine],
        gridsize=45,
        cmap="cividis",
        mincnt=1,
        lw=0,
    )
    figure.colorbar(image, ax=left, label="simulated collisions")
    turn = np.linspace(0, 2 * np.pi, 100)
    for k in (1, 2):
        left.plot(
            facts["velocity_change"] + k * sigma * np.cos(turn),
            facts["speed_after"] + k * sigma * np.sin(turn),
            color=COLOURS[1],
            lw=1.8,
            label="trajectory kernel, 1 and 2 sigma" if k == 1 else None,
        )
    left.set_xlabel("change of velocity at the collision (m/s)")
    left.set_ylabel("speed after the collision (m/s)")
    left.legend(fontsize=8, loc="lower left")
    impacts = "Sticking impacts" if _sticks(found) else "Impacts"
    left.set_title(
        f"{impacts} at {facts['speed_before']:.3f} m/s and what the trajectory shows", fontsize=10
    )
    rate = np.linalg.norm(found["omega_after_B"].values, axis=1)
    edges = np.linspace(0, 1.0, 51)
    weighted = found["weight"].values, "weighted by the kernel's speeds"
    for k, (weight, text) in enumerate(((np.ones_like(rate), "as drawn"), weighted)):
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
    period, wide = found.attrs["period_after_s"], 2 * found.attrs["sigma_period_s"]
    right.axvspan(
        2 * np.pi / (period + wide),
        2 * np.pi / (period - wide),
        color=COLOURS[2],
        alpha=0.25,
        lw=0,
        label=f"magnetometer: {period:g} s, drawn {wide:g} s wide to each side",
    )
    right.set_xlim(0, 1)
    right.set_xlabel("angular speed just after the collision (rad/s)")
    right.set_ylabel("probability density (s/rad)")
    right.legend(fontsize=8, **ABOVE)
    figure.suptitle(titled("The collision", found.attrs.get("synthetic")), fontsize=11)
    return figure


def _sticks(found: xr.Dataset) -> bool:
    """Whether the blow was taken for one at which the point that hits sticks; not so where the scenario cannot be read."""
    try:
        scenario = json.loads(str(found.attrs.get("scenario", "{}")))
    except ValueError:
        return False
    return isinstance(scenario, dict) and not any(
        scenario.get(name) for name in ("restitution", "damper")
    )
