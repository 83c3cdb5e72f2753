"""Directions to the Sun on the sphere of the body: of each phase (paper, Fig. 4) and of example motions (Figs. 6 and 7)."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from sunspin.output.figures import COLOURS, titled
from sunspin.telemetry.sun import SunStatus


def descent_and_rebound_figure(parts: dict[str, xr.Dataset], synthetic: bool) -> Figure:
    """Reconstructed directions on the sphere for each phase of the motion (paper, Fig. 4)."""
    figure = Figure(figsize=(11, 3.4), layout="constrained")
    for k, (name, phase) in enumerate(parts.items()):
        axes = _sphere(figure, len(parts), k)
        n = phase["sun_B"].values
        n = n[np.isfinite(n[:, 0])]
        axes.plot(*n.T, ":", lw=0.6, color=COLOURS[7])
        axes.scatter(*n.T, s=9, color=COLOURS[0], depthshade=False)
        impossible = phase["status"].values == SunStatus.IMPOSSIBLE
        doubtful = phase["best_B"].values[impossible & (phase["n_lit"].values >= 3)]
        axes.scatter(*doubtful.T, s=9, color=COLOURS[1], depthshade=False)
        more = f", {len(doubtful)} doubtful" if len(doubtful) else ""
        title = f"{chr(65 + k)}: {name}\n{len(n)} of {phase.sizes['time']} samples{more}"
        axes.set_title(title, fontsize=9)
    figure.suptitle(titled("Directions to the Sun in body axes", synthetic), fontsize=10)
    return figure


def examples_figure(runs: list[xr.Dataset]) -> Figure:
    """The Sun's track on the sphere and its components for several initial rates (paper, Fig. 6)."""
    figure = Figure(figsize=(11, 7.5), layout="constrained")
    upper, lower = figure.subfigures(2, 1, height_ratios=(1.2, 1), squeeze=False)[:, 0]
    components = lower.subplots(3, len(runs), sharex=True, sharey=True, squeeze=False)
    for k, run in enumerate(runs):
        r, minutes = run["sun_B"].values, run["time"].values / 60
        axes = _sphere(upper, len(runs), k)
        axes.plot(*r.T, lw=0.4, color=COLOURS[0])
        axes.set_title(_initial_rate(run), fontsize=9)
        for i, name in enumerate("xyz"):
            components[i, k].plot(minutes, r[:, i], lw=0.5, color=COLOURS[i])
            components[i, 0].set_ylabel(f"$r_{name}$")
        components[2, k].set_xlabel("time (min)")
    return figure


def histograms_figure(runs: list[xr.Dataset]) -> Figure:
    """Distribution of r_z over each run, as densities of area 1 (paper, Fig. 7)."""
    figure = Figure(figsize=(10, 3.2), layout="constrained")
    for axes, run in zip(figure.subplots(1, len(runs)), runs, strict=True):
        axes.hist(run["sun_B"].values[:, 2], bins=60, range=(-1, 1), density=True, color=COLOURS[0])
        axes.set(xlabel="$r_z$", ylabel="density")
        axes.set_title(_initial_rate(run), fontsize=9)
    return figure


def _initial_rate(run: xr.Dataset) -> str:
    rate = ", ".join(f"{x:.4g}" for x in run["omega_B"].values[0])
    return rf"$\omega(0)$ = [{rate}] rad/s"


def _sphere(figure: Any, columns: int, k: int) -> Any:
    """Axes `k` of a row, with the unit sphere of the body."""
    axes = figure.add_subplot(1, columns, k + 1, projection="3d")
    u, v = np.mgrid[0 : 2 * np.pi : 25j, 0 : np.pi : 13j]
    x, y, z = np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)
    axes.plot_wireframe(x, y, z, lw=0.25, color="#cccccc")
    axes.set_box_aspect((1, 1, 1), zoom=1.05)
    for name in "xyz":
        getattr(axes, f"set_{name}ticks")([-1, 0, 1])
        axes.tick_params(axis=name, labelsize=6, pad=-3)
    axes.set_xlabel("x", labelpad=-6, fontsize=8)
    axes.set_ylabel("y", labelpad=-6, fontsize=8)
    # matplotlib's own label of z is lost behind the next sphere
    axes.text(1.15, 1.15, 1.35, "z", ha="center", fontsize=8)
    return axes
