"""Results of `propagate` (trajectories), `impact` and `fit_spin_down` (a wheel that runs down)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sunspin.dynamics.curve import along_curve
from sunspin.output.figures import (
    ABOVE,
    BLACK,
    COLOURS,
    GREY,
    axes_grid,
    axis_labels,
    styled,
)
from sunspin.output.kind import KINDS, Context, Drawing, Kind, Summary
from sunspin.output.text import number_text, rate_text, with_sigma

MOST_EVENTS = 20
"""Number of wheel events that are printed."""

LEAST_SPAN = 0.02
"""The axis of the wheel speeds spans at least this share of the largest one."""


def trajectory_summary(run: Any) -> Summary:
    """Return the summary of a trajectory: the state at the last time, and the wheel events."""
    t, last = run["time"].values, run.isel(time=-1)
    events = [
        {"t_s": t_s, "wheel": wheel, "what": what}
        for t_s, wheel, what in zip(
            run["event_time_s"].values.tolist(),
            run["event_wheel"].values.tolist(),
            run["event_what"].values.tolist(),
            strict=True,
        )
    ]
    state = {name: last[name].values.tolist() for name in ("omega_B", "sun_B", "wheel_speed_rad_s")}
    speeds = state["wheel_speed_rad_s"]
    wheels = f", wheels {number_text(speeds)} rad/s" if speeds else ""
    rate, sun = rate_text(state["omega_B"]), number_text(state["sun_B"])
    lines = [f"at t = {t[-1]:zg} s: rate {rate}, Sun {sun}{wheels}"]
    for event in events[:MOST_EVENTS]:
        lines.append(f"  {event['wheel']} {event['what']} at {event['t_s']:z.3f} s")
    if len(events) > MOST_EVENTS:
        lines.append(f"  and {len(events) - MOST_EVENTS} more wheel events")
    return Summary({"t_s": float(t[-1]), **state, "events": events}, lines)


def trajectory_drawings(run: Any, _: Context) -> Iterator[Drawing]:
    """Yield the figure of a trajectory."""
    yield Drawing(
        "trajectory",
        lambda: trajectory_figure(run),
        "Components and size of the body rate and the wheels' speeds against time.",
        "Simulated body rate, body axes, and wheel speeds relative to the body. A simulation has no error bar: it is as sure as "
        "the state that it was started from.",
    )


@styled
def trajectory_figure(run: Any) -> Any:
    """Draw the body rate (deg/s) against time, and below it the wheel speeds if the vehicle has wheels.

    The components of the rate have the first three colours and different dashes, its size is black. The curves pass through the
    instants between output times, if the result has them.
    """
    run = along_curve(run)
    wheels = run.sizes.get("wheel", 0)
    rows, height = (2, 5.85) if wheels else (1, 3.6)
    layout: dict[str, Any] = {"sharex": True, "squeeze": False, "height_ratios": (3, 2)[:rows]}
    figure, grid = axes_grid(10, height, rows, **layout)
    t, omega = run["time"].values, np.degrees(run["omega_B"].values)
    rate_axes, bottom_axes = grid[0, 0], grid[-1, 0]  # the same without wheels
    for k, axis in enumerate("xyz"):
        label, dashes = rf"$\omega_{axis}$", ("-", "--", ":")[k]
        rate_axes.plot(t, omega[:, k], color=COLOURS[k], ls=dashes, lw=1.2, label=label)
    speed = np.linalg.norm(omega, axis=1)
    rate_axes.plot(t, speed, color=BLACK, lw=1.6, label=r"$|\omega|$")
    rate_axes.set_ylabel("body rate (deg/s)")
    names = axis_labels(run["wheel"].values) if "wheel" in run.coords else []
    for k in range(wheels):
        name = names[k] if names else f"wheel {k + 1}"
        wheel_speed = run["wheel_speed_rad_s"].values[:, k]
        colour = COLOURS[k % 7]  # all but grey, which is for auxiliary lines
        bottom_axes.plot(t, wheel_speed, color=colour, lw=1.4, label=name)
        bottom_axes.set_ylabel("wheel speed (rad/s)")
    if wheels:  # a speed that hardly changes looks constant
        low, high = bottom_axes.get_ylim()
        middle, half = (low + high) / 2, max(high - low, LEAST_SPAN * max(abs(low), abs(high))) / 2
        bottom_axes.set_ylim(middle - half, middle + half)
    for axes in grid[:, 0]:
        axes.legend(ncols=4, **ABOVE)
    bottom_axes.set_xlabel("time (s)")
    return figure


def impact_summary(hit: Any) -> Summary:
    """Return the summary of impacts: body rate, wheel speeds, velocity just after, and impulse; medians over several cases."""
    cases = int(np.prod(hit["omega_B"].shape[:-1]))  # the last dimension is x, y, z
    numbers, lines = {}, ["after the impact" if cases == 1 else f"after {cases} impacts, medians"]
    for name in ("omega_B", "wheel_speed_rad_s", "velocity_B", "impulse_B"):
        median = np.median(hit[name].values.reshape(-1, hit[name].shape[-1]), axis=0)
        numbers[name] = median.tolist()
        text = f"{number_text(numbers[name])} {hit[name].attrs['units']}"
        lines.append(f"  {name} {rate_text(median) if name == 'omega_B' else text}")
    return Summary({"cases": cases, **numbers}, lines)


def spin_down_summary(fit: Any) -> Summary:
    """Return the summary of a spin-down fit: coefficients with sigmas, friction, rms residual."""
    names = ("c1_rad_s", "c2_per_s", "c3_rad_s")
    sigma = np.sqrt(np.diag(fit["covariance"].values))  # in the order of the names
    frictions = "coulomb_N_m", "viscous_N_m_s"
    numbers = {name: float(fit[name]) for name in (*names, *frictions, "rms_rad_s")}
    coefficients = ", ".join(
        f"{name[:2]} = {with_sigma(numbers[name], error, fit[name].attrs['units'])}"
        for name, error in zip(names, sigma, strict=True)
    )
    coulomb, viscous, rms = (number_text(numbers[name]) for name in (*frictions, "rms_rad_s"))
    n = fit.sizes["time"]
    through = f"wheel speed c1 exp(c2 t) + c3 through {n} samples"
    lines = [f"{through}: {coefficients}; rms {rms} rad s-1"]
    lines += [f"  friction: {coulomb} N m, and {viscous} N m s times the speed"]
    return Summary(numbers | {"sigma": sigma.tolist(), "samples": n}, lines)


def spin_down_drawings(fit: Any, _: Context) -> Iterator[Drawing]:
    """Yield the figure of a spin-down fit."""
    curves = {"recorded": fit["recorded_rad_s"].values, "fitted": fit["fitted_rad_s"].values}
    title = "A wheel that runs down, and c1 exp(c2 t) + c3"
    yield Drawing(
        "spin-down",
        lambda: spin_down_figure(fit["time"].values, curves, title),
        "Size of a wheel's speed against time as recorded and as fitted.",
        "A wheel that runs down: as recorded, and c1 exp(c2 t) + c3.",
    )


@styled
def spin_down_figure(t_s: np.ndarray, curves: dict[str, np.ndarray], title: str = "") -> Any:
    """Draw wheel speeds (rad/s, by label) against time: of several friction laws (paper, Fig. 5), or recorded and fitted.

    The default title is that of the paper's figure.
    """
    published = "computed from published friction (no measured record is public)"
    figure, axes = axes_grid(7, 4, title=title or f"Spin-down of the wheel, {published}")
    for k, (label, speed) in enumerate(curves.items()):
        axes.plot(t_s / 60, speed, "-" if k == 0 else "--", color=COLOURS[k], label=label)
    axes.set(xlabel="time (min)", ylabel="wheel speed (rad/s)")
    axes.set_ylim(bottom=-20)  # shows the line at zero above the edge
    axes.axhline(0, lw=0.5, color=GREY)
    axes.legend()
    return figure


KINDS.update(
    trajectory=Kind("simulate", "trajectory", trajectory_summary, trajectory_drawings),
    impact=Kind("impact", "impact", impact_summary),
    spin_down=Kind("spin_down", "spin-down", spin_down_summary, spin_down_drawings),
)
