"""A simulated motion, and the spin-down of a wheel, against time."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from sunspin.output.figures import ABOVE, COLOURS, named


def trajectory_figure(run: xr.Dataset) -> Figure:
    """Components and size of the body rate (deg/s), and the speeds of the wheels where there are any, against time."""
    wheels = run.sizes.get("wheel", 0)
    figure = Figure(figsize=(10, 6 if wheels else 3.6), layout="constrained")
    parts = figure.subplots(
        2 if wheels else 1, 1, sharex=True, squeeze=False, height_ratios=(3, 2) if wheels else (1,)
    )[:, 0]
    t, omega = run["time"].values, np.degrees(run["omega_B"].values)
    for k, axis in enumerate("xyz"):
        parts[0].plot(
            t,
            omega[:, k],
            color=COLOURS[k],
            ls=("-", "--", ":")[k],
            lw=1.2,
            label=rf"$\omega_{axis}$",
        )
    parts[0].plot(t, np.linalg.norm(omega, axis=1), color=COLOURS[6], lw=1.6, label=r"$|\omega|$")
    parts[0].set_ylabel("body rate (deg/s)")
    parts[0].legend(ncols=4, fontsize=9, **ABOVE)
    for k in range(wheels):
        name = named(run["wheel"].values[k]) if "wheel" in run.coords else f"wheel {k + 1}"
        parts[1].plot(
            t, run["wheel_speed_rad_s"].values[:, k], color=COLOURS[k % 7], lw=1.4, label=name
        )
    if wheels:
        parts[1].set_ylabel("wheel speed (rad/s)")
        parts[1].legend(ncols=4, fontsize=9, **ABOVE)
    parts[-1].set_xlabel("time (s)")
    return figure


def spin_down_figure(
    t_s: np.ndarray,
    curves: dict[str, np.ndarray],
    title: str = "Spin-down of the wheel, computed from published friction (no measured record is public)",
) -> Figure:
    """Wheel speed against time for several friction laws (paper, Fig. 5), or as recorded and fitted."""
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    for k, (label, speed) in enumerate(curves.items()):
        axes.plot(t_s / 60, speed, "-" if k == 0 else "--", color=COLOURS[k], label=label)
    axes.set_xlabel("time (min)")
    axes.set_ylabel("wheel speed (rad/s)")
    axes.set_ylim(bottom=-20)
    axes.axhline(0, lw=0.5, color=COLOURS[7])
    axes.legend()
    axes.set_title(title, fontsize=9)
    return figure
