"""The posterior predictive: rates, the Sun and the angle of z at other times."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from sunspin.output.figures import COLOURS, named, titled


def predicted_figure(
    found: xr.Dataset, labels: list[str], truth: xr.Dataset | None = None
) -> Figure:
    """A row for each time: angular speed, components of the rate, direction of the Sun, angles of z from the Sun and from H.

    `found`: of :func:`sunspin.estimate.posterior.predict.predict`; `labels`: the times in words; `truth`: the same of one motion.
    """
    count = found.sizes["predicted_s"]
    figure = Figure(figsize=(13, 2.7 * count + 0.6), layout="constrained")
    grid = figure.subplots(count, 4, squeeze=False)
    for i, moment in enumerate(labels):
        at = found.isel(predicted_s=i, chain=0)
        true = None if truth is None else truth.isel(predicted_s=i, chain=0, draw=0)
        speed, parts, sky, angles = grid[i]
        _spread(
            speed,
            np.degrees(at["rate"].values),
            COLOURS[0],
            None,
            None if true is None else float(np.degrees(true["rate"])),
        )
        speed.set_ylabel(f"{moment}\ndraws", fontsize=9)
        for k, axis in enumerate("xyz"):
            value = None if true is None else float(np.degrees(true["omega_B"].values[k]))
            _spread(
                parts,
                np.degrees(at["omega_B"].values[:, k]),
                COLOURS[k],
                rf"$\omega_{axis}$",
                value,
            )
        _sky(sky, at["sun_B"].values, None if true is None else true["sun_B"].values)
        for name, text, colour in (
            ("z_to_momentum", "z and H", COLOURS[3]),
            ("z_to_sun", "z and Sun", COLOURS[4]),
        ):
            value = None if true is None else float(np.degrees(true[name]))
            _spread(angles, np.degrees(at[name].values), colour, text, value)
        parts.legend(fontsize=7)
        angles.legend(fontsize=7)
        if i == count - 1:
            speed.set_xlabel("angular speed (deg/s)")
            parts.set_xlabel("components of the rate (deg/s)")
            sky.set_xlabel("azimuth of the Sun about z (deg)")
            angles.set_xlabel("angle (deg)")
    marks = "; dashed: the truth" if truth is not None else ""
    text = (
        f"What {named(found.attrs.get('vehicle', 'the body'))} did: draws of the posterior{marks}"
    )
    figure.suptitle(titled(text, found.attrs.get("synthetic")), fontsize=11)
    return figure


def _spread(
    axes: Any, values: np.ndarray, colour: str, label: str | None, true: float | None
) -> None:
    """A histogram with its 50 % and 90 % intervals as bars below."""
    values = values[np.isfinite(values)]
    axes.hist(values, 50, histtype="stepfilled", color=colour, alpha=0.6, label=label)
    for level, width in ((0.9, 1.5), (0.5, 4.0)):
        low, high = np.quantile(values, [0.5 - level / 2, 0.5 + level / 2])
        axes.plot(
            [low, high],
            [0, 0],
            color=colour,
            lw=width,
            solid_capstyle="butt",
            clip_on=False,
            zorder=5,
        )
    if true is not None:
        axes.axvline(true, color=COLOURS[6], lw=0.9, ls="--")
    axes.set_yticks([])


def _sky(axes: Any, sun: np.ndarray, true: np.ndarray | None) -> None:
    axes.plot(*_azimuth_height(sun), ".", ms=1.5, alpha=0.3, color=COLOURS[5], rasterized=True)
    if true is not None:
        axes.plot(*_azimuth_height(true[None]), "+", ms=9, color=COLOURS[6])
    axes.set(
        xlim=(-180, 180), ylim=(-90, 90), xticks=range(-180, 181, 90), yticks=range(-90, 91, 45)
    )
    axes.set_ylabel("height of the Sun (deg)", fontsize=8)
    axes.tick_params(labelsize=8)


def _azimuth_height(sun: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.degrees(np.arctan2(sun[:, 1], sun[:, 0])), np.degrees(
        np.arcsin(np.clip(sun[:, 2], -1, 1))
    )
