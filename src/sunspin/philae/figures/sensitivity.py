"""Maps of E (paper, Fig. 8), and why a direct fit fails after the touchdown."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from sunspin.estimate.scan.error_growth import ONE_PERCENT, RATES
from sunspin.output.figures import COLOURS, titled
from sunspin.philae.sensitivity import Sensitivity

SYMBOLS = {
    "omega_x": r"$\omega_x$",
    "omega_y": r"$\omega_y$",
    "omega_z": r"$\omega_z$",
    "theta_xx": r"$\theta_{xx}$",
    "theta_yy": r"$\theta_{yy}$",
    "theta_zz": r"$\theta_{zz}$",
    "wheel_speed": r"$\omega_{rot}$",
    "mu_0": r"$\mu_0$",
    "mu_1": r"$\mu_1$",
}


def draw_maps(result: Sensitivity) -> Figure:
    """E over (omega_x, omega_y) and over (mu_0, theta_xx), the axes of the paper's Fig. 8."""
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    length = f"$|r(0)|$ = {result.start_length:.4f} as quoted"
    omega_z = float(result.rates["omega_z"])
    _map(left, result.rates, ("omega_x", "omega_y"), (1.0, 1.0))
    left.set(xlabel=r"$\omega_x$ (rad/s)", ylabel=r"$\omega_y$ (rad/s)")
    left.set_title(rf"A: initial rates, $\omega_z$ = {omega_z:g} rad/s", fontsize=10)
    _map(right, result.parameters, ("mu_0", "theta_xx"), (1e3, 1.0))
    omega = ", ".join(f"{x:g}" for x in result.case.published["E_study_omega"].value)
    right.set(xlabel=r"$\mu_0$ ($10^{-3}$ N m)", ylabel=r"$\theta_{xx}$ (kg m$^2$)")
    right.set_title(rf"B: parameters, $\omega(0)$ = [{omega}] rad/s", fontsize=10)
    figure.suptitle(
        titled(
            f"E against {result.n_samples} directions of the telemetry, {length}", result.synthetic
        ),
        fontsize=10,
    )
    return figure


def _map(axes: Any, error: xr.DataArray, dims: tuple[str, str], scale: tuple[float, float]) -> None:
    x, y = (error[dim].values * factor for dim, factor in zip(dims, scale, strict=True))
    image = axes.pcolormesh(
        x,
        y,
        error.transpose(*reversed(dims)).values,
        shading="nearest",
        cmap="cividis_r",
        rasterized=True,
    )
    axes.figure.colorbar(image, ax=axes, label="E")


def draw_growth(result: Sensitivity) -> Figure:
    """Why the direct fit fails: errors grow with the window, the valley of E narrows, and EMD does not follow."""
    figure = Figure(figsize=(9.5, 9.0), layout="constrained")
    (grow, valley), (changes, width) = figure.subplots(2, 2)
    _growth(grow, result)
    _valleys(valley, result)
    _changes(changes, result)
    _widths(width, result)
    figure.suptitle(
        "Why a direct fit fails after the touchdown (simulated motions only)", fontsize=11
    )
    return figure


def _growth(axes: Any, r: Sensitivity) -> None:
    table = r.growth[0]
    minutes = table["time"].values / 60
    for k, name in enumerate(table["input"].values.tolist()):
        error = ONE_PERCENT * table["error_rad"].sel(input=name).values
        style = "-" if name in RATES else "--" if name.startswith("theta") else ":"
        label = f"{SYMBOLS[name]}, power {float(table['power'].sel(input=name)):.1f}"
        axes.loglog(
            minutes[1:],
            error[1:],
            style,
            lw=1.3,
            color=COLOURS[k % 8] if k < 8 else "#555555",
            label=label,
        )
    axes.axhline(1.0, lw=0.8, color=COLOURS[7])
    axes.text(0.13, 1.1, "one radian", fontsize=9, color="#555555")
    axes.set(
        xlabel="length of the window (min)", ylabel="direction error of 1 %, to first order (rad)"
    )
    axes.set(xlim=(0.1, None), ylim=(1e-4, 60))
    axes.legend(fontsize=9, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.16), frameon=False)
    axes.set_title(f"growth of errors, rates of {r.names[0]}", fontsize=10)


def _valleys(axes: Any, r: Sensitivity) -> None:
    change = 1e3 * r.valley["change"].values
    for k, window in enumerate(r.valley["window"].values):
        error = r.valley.sel(window=window).values
        axes.plot(
            change,
            error,
            lw=1.6 - 0.45 * k,
            color=COLOURS[(5, 1, 6)[k % 3]],
            label=f"{window / 60:g} min",
            zorder=3 - k,
        )
    axes.set(
        xlabel=r"change of $\omega_x$ (mrad/s)", ylabel="E", ylim=(0, 1.25 * float(r.valley.max()))
    )
    axes.legend(
        fontsize=9, title="window", title_fontsize=9, ncols=3, loc="upper center", frameon=False
    )
    axes.set_title("E against the motion's own\ndirections, every 2 min", fontsize=10)


def _changes(axes: Any, r: Sensitivity) -> None:
    names = r.changes[0]["input"].values.tolist()
    place = np.arange(len(names))
    for k, (label, table) in enumerate(zip(r.names, r.changes, strict=True)):
        shift = (k - (len(r.names) - 1) / 2) * 0.15
        axes.semilogy(place + shift, table["E"].values, "o", ms=5, color=COLOURS[k], label=label)
        axes.semilogy(place + shift, table["emd"].values, "^", ms=5, mfc="none", color=COLOURS[k])
    axes.set_xticks(place, [SYMBOLS[name] for name in names])
    axes.axhline(r.case.published["emd_min"].value, ls="--", lw=1, color=COLOURS[7])
    axes.text(
        len(names) - 0.5,
        1.1 * r.case.published["emd_min"].value,
        "smallest EMD of the paper's scan",
        ha="right",
        fontsize=9,
    )
    axes.set(xlabel="input changed by 1 %", ylabel="E (filled), EMD (open)", ylim=(5e-4, 2.5))
    axes.legend(fontsize=9, ncols=len(r.names), loc="upper center")
    axes.set_title("E and EMD between a motion\nand the changed one, 45 min", fontsize=10)


def _widths(axes: Any, r: Sensitivity) -> None:
    """For a rate: one radian over the growth of the error, both ways, against the window."""
    for k, (label, table) in enumerate(zip(r.names, r.growth, strict=True)):
        minutes = table["time"].values[1:] / 60
        steepest = (
            table["error_rad"].sel(input=list(RATES)).max("input").values[1:]
            / table.attrs["angular_speed_rad_s"]
        )
        axes.loglog(minutes, 2 / steepest, lw=1.2, color=COLOURS[k], label=label)
    step = r.case.published["scan_step"].value
    axes.axhline(step, ls="--", lw=1, color=COLOURS[7])
    axes.text(
        0.98,
        1.12 * step,
        "step of the paper's scan",
        fontsize=9,
        ha="right",
        transform=axes.get_yaxis_transform(),
    )
    axes.set(
        xlabel="length of the window (min)",
        ylabel="width of one radian in a rate (rad/s)",
        xlim=(0.5, 50),
        ylim=(5e-4, 1),
    )
    axes.legend(fontsize=9)
    axes.set_title("how near a rate must be\nto fit the whole window", fontsize=10)
