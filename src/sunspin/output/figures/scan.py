"""A scan of rate space."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from sunspin.output.figures import COLOURS

LEAST = 1e-6
"""Smaller misfits are drawn as this: the colours go with the logarithm."""


AXES = {
    "omega_x": (r"$\omega_x$ (rad/s)", 1.0),
    "omega_y": (r"$\omega_y$ (rad/s)", 1.0),
    "omega_z": (r"$\omega_z$ (rad/s)", 1.0),
    "mu_0": ("dry friction of the wheel (mN m)", 1e3),
    "theta_xx": (r"moment of inertia $\theta_{xx}$ (kg m$^2$)", 1.0),
}
"""Dimension of a map -> title of its axis, factor from SI."""


def scan_figure(volume: xr.DataArray, points: np.ndarray) -> Figure:
    """The smallest misfit over omega_z for every omega_x and omega_y, and `points` (n, 3), the motions near the smallest of all."""
    figure = Figure(figsize=(7.5, 5.6), layout="constrained")
    axes = figure.subplots()
    least = np.maximum(volume.min("omega_z").transpose("omega_y", "omega_x").values, LEAST)
    low, high = np.nanmin(least), np.nanmax(least)
    image = axes.pcolormesh(
        volume["omega_x"].values,
        volume["omega_y"].values,
        least,
        shading="nearest",
        cmap="cividis_r",
        rasterized=True,
        norm=LogNorm(low, max(high, 1.001 * low)),
    )
    for side, axis in (("top", "x"), ("right", "y")):  # the grid is that of the options, rad/s
        other = getattr(axes, f"secondary_{axis}axis")(side, functions=(np.degrees, np.radians))
        getattr(other, f"set_{axis}label")(rf"$\omega_{axis}$ (deg/s)")
    figure.colorbar(
        image, ax=axes, label=f"smallest {'EMD' if volume.name == 'emd' else 'E'} over $\\omega_z$"
    )
    axes.plot(
        *points[:, :2].T,
        "o",
        ms=5,
        mfc="none",
        mec=COLOURS[1],
        mew=1.2,
        label="motions that fit nearly as well as the best",
    )
    axes.set_xlabel(r"$\omega_x$ (rad/s)")
    axes.set_ylabel(r"$\omega_y$ (rad/s)")
    figure.legend(fontsize=8, loc="outside lower center", frameon=False)
    return figure
