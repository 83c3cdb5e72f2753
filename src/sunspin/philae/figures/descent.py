"""The descent: measured and fitted directions to the Sun (paper, Fig. 10), E against the rate (Fig. 11)."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from sunspin.output.figures import COLOURS, titled
from sunspin.philae.descent import Descent

RATE_UNIT = 1e-3
"""Rates are drawn in mrad/s."""


def draw(result: Descent) -> Figure:
    """Directions against the azimuth about z and in time, E over all aliases and near its minimum."""
    figure = Figure(figsize=(11, 8.2), layout="constrained")
    (sphere, rate), (wide, near) = figure.subplots(2, 2)
    _directions(sphere, result)
    _rate(rate, result)
    _aliases(wide, result)
    _minimum(near, result)
    title = f"Descent, samples {result.number[0]} to {result.number[1]}: cubic rate about z"
    figure.suptitle(titled(title, result.synthetic), fontsize=11)
    return figure


def _polar(n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.degrees(np.arctan2(n[:, 1], n[:, 0])), n[:, 2]


def _directions(axes: Any, r: Descent) -> None:
    """As a map of the sphere: azimuth and z. Lines join what was measured to what the fit says."""
    measured, told = r.sun["sun_B"].values, r.told
    azimuth, z = _polar(measured[told])
    fitted, fitted_z = _polar(r.simulated_B[told])
    near = np.abs(azimuth - fitted) < 180  # not across the edge of the map
    axes.plot(
        np.stack([azimuth, fitted])[:, near],
        np.stack([z, fitted_z])[:, near],
        lw=0.6,
        color=COLOURS[7],
    )
    axes.plot(
        azimuth,
        z,
        "o",
        ms=4.5,
        mfc="none",
        color=COLOURS[0],
        label=f"from the telemetry ({told.sum()})",
    )
    axes.plot(fitted, fitted_z, ".", ms=4, color=COLOURS[1], label="fitted, same samples")
    behind = ~told & ~r.predicted
    axes.plot(
        *_polar(r.simulated_B[behind]),
        "+",
        ms=6,
        color=COLOURS[6],
        label=f"fitted, behind the lander ({behind.sum()})",
    )
    odd = ~told & r.predicted
    if odd.any():
        axes.plot(
            *_polar(r.simulated_B[odd]),
            "x",
            ms=6,
            color=COLOURS[3],
            label=f"fitted in view, no direction ({odd.sum()})",
        )
    axes.set(
        xlim=(-185, 185),
        ylim=(0.4, 0.8),
        xlabel="azimuth of the Sun about z (deg)",
        ylabel="$z$ component",
    )
    axes.set_xticks(range(-180, 181, 90))
    axes.legend(fontsize=8, loc="upper left", ncols=2)
    axes.set_title(f"directions to the Sun, body axes; E = {r.fit.E:.2g}", fontsize=9)


def _rate(axes: Any, r: Descent) -> None:
    t = np.linspace(0, float(r.sun["time"].values[-1]), 300)
    powers = t[:, None] ** np.arange(r.fit.coefficients.size)
    spread = np.sqrt(np.einsum("ni,ij,nj->n", powers, r.fit.covariance, powers))
    rate = r.fit.rate(t)
    axes.fill_between(
        t / 3600,
        (rate - 2 * spread) / RATE_UNIT,
        (rate + 2 * spread) / RATE_UNIT,
        color=COLOURS[5],
        alpha=0.5,
        lw=0,
        label="fit, 2 sigma",
    )
    axes.plot(t / 3600, rate / RATE_UNIT, color=COLOURS[0], label="fit")
    printed = np.polynomial.polynomial.polyval(t, r.case.published["descent_rate_cubic"].value)
    axes.plot(t / 3600, printed / RATE_UNIT, "--", color=COLOURS[1], label="published coefficients")
    low, high = r.case.published["descent_rate_range"].value
    axes.axhspan(
        low / RATE_UNIT,
        high / RATE_UNIT,
        color=COLOURS[7],
        alpha=0.25,
        lw=0,
        label="published range",
    )
    axes.set(xlabel="time since the first sample of the fit (h)", ylabel="rate about z (mrad/s)")
    axes.legend(fontsize=8)
    axes.set_title("rate", fontsize=9)


def _aliases(axes: Any, r: Descent) -> None:
    axes.semilogy(
        r.fit.scan_rate / RATE_UNIT,
        r.fit.scan_E,
        lw=0.6,
        color=COLOURS[7],
        label="scan, least over drifts of the rate",
    )
    best = r.fit.aliases[0]
    others = r.fit.aliases[1:4]
    axes.plot(
        others[:, 0] / RATE_UNIT,
        others[:, 1],
        "v",
        ms=6,
        color=COLOURS[1],
        label="next minima, refined",
    )
    axes.plot(best[0] / RATE_UNIT, best[1], "o", ms=6, color=COLOURS[0], label="smallest E")
    axes.axhline(
        r.case.published["descent_E"].value,
        ls=":",
        lw=1,
        color=COLOURS[6],
        label="published E (flown data)",
    )
    axes.set(xlabel="mean rate about z (mrad/s)", ylabel="E")
    axes.legend(fontsize=8, loc="lower left")
    axes.set_title("E over the aliases of the sampling", fontsize=9)


def _minimum(axes: Any, r: Descent) -> None:
    """E against omega_0, the other coefficients as fitted."""
    centre = r.fit.coefficients[0]
    inside = np.abs(r.omega_0 - centre) < 2e-3
    axes.plot(r.omega_0[inside] / RATE_UNIT, r.slice_E[inside], lw=1, color=COLOURS[0])
    axes.axvline(
        r.case.published["descent_rate_cubic"].value[0] / RATE_UNIT,
        ls="--",
        lw=1,
        color=COLOURS[1],
        label="published",
    )
    axes.set(
        xlabel=r"$\omega_0$ (mrad/s), other coefficients as fitted", ylabel="E", ylim=(0, None)
    )
    axes.legend(fontsize=8, loc="lower left")
    axes.set_title(r"E against $\omega_0$", fontsize=9)
