"""Results of `propagate` (trajectories), `impact` and `fit_spin_down` (a wheel that runs down)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sunspin.output.figures import ABOVE, COLOURS, axes_grid, axis_labels, styled
from sunspin.output.kind import KINDS, Context, Drawing, Kind, Summary
from sunspin.output.text import number_text, rate_text, with_sigma

MOST_EVENTS = 20
"""Number of wheel events that are printed."""


def trajectory_summary(run: Any) -> Summary:
    """Return the summary of a trajectory: the state at the last time, and the wheel events."""
    t, end = run["time"].values, run.isel(time=-1)
    names = {"event_time_s": "t_s", "event_wheel": "wheel", "event_what": "what"}
    columns = (run[name].values.tolist() for name in names)
    events = [dict(zip(names.values(), row, strict=True)) for row in zip(*columns, strict=True)]
    state = {name: end[name].values.tolist() for name in ("omega_B", "sun_B", "wheel_speed_rad_s")}
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
    """Draw components and size of the body rate (deg/s), and wheel speeds if there are any, against time."""
    wheels, rows = run.sizes.get("wheel", 0), 2 if run.sizes.get("wheel", 0) else 1
    layout: dict[str, Any] = {"sharex": True, "squeeze": False, "height_ratios": (3, 2)[:rows]}
    figure, grid = axes_grid(10, 3.6 * rows**0.7, rows, **layout)
    t, omega = run["time"].values, np.degrees(run["omega_B"].values)
    rates, speeds = grid[0, 0], grid[-1, 0]
    for k, axis in enumerate("xyz"):
        label, dashes = rf"$\omega_{axis}$", ("-", "--", ":")[k]
        rates.plot(t, omega[:, k], color=COLOURS[k], ls=dashes, lw=1.2, label=label)
    rates.plot(t, np.linalg.norm(omega, axis=1), color=COLOURS[6], lw=1.6, label=r"$|\omega|$")
    rates.set_ylabel("body rate (deg/s)")
    names = axis_labels(run["wheel"].values) if "wheel" in run.coords else []
    for k in range(wheels):
        name = names[k] if names else f"wheel {k + 1}"
        speed = run["wheel_speed_rad_s"].values[:, k]
        speeds.plot(t, speed, color=COLOURS[k % 7], lw=1.4, label=name)
        speeds.set_ylabel("wheel speed (rad/s)")
    for axes in grid[:, 0]:
        axes.legend(ncols=4, **ABOVE)
    speeds.set_xlabel("time (s)")
    return figure


def impact_summary(hit: Any) -> Summary:
    """Return the summary of impacts: rates, speed and impulse just after; medians if there are several cases."""
    cases = int(np.prod(hit["omega_B"].shape[:-1]))
    numbers, lines = {}, ["after the impact" if cases == 1 else f"after {cases} impacts, medians"]
    for name in ("omega_B", "wheel_speed_rad_s", "velocity_B", "impulse_B"):
        values = np.median(hit[name].values.reshape(-1, hit[name].shape[-1]), axis=0)
        numbers[name] = values.tolist()
        text = f"{number_text(numbers[name])} {hit[name].attrs['units']}"
        lines.append(f"  {name} {rate_text(values) if name == 'omega_B' else text}")
    return Summary({"cases": cases, **numbers}, lines)


def spin_down_summary(fit: Any) -> Summary:
    """Return the summary of a spin-down fit: coefficients with sigmas, friction, rms residual."""
    sigma, names = np.sqrt(np.diag(fit["covariance"].values)), ("c1_rad_s", "c2_per_s", "c3_rad_s")
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
    """Draw wheel speeds (rad/s) by label against time, of several friction laws (paper, Fig. 5) or recorded and fitted."""
    published = "computed from published friction (no measured record is public)"
    figure, axes = axes_grid(7, 4, title=title or f"Spin-down of the wheel, {published}")
    for k, (label, speed) in enumerate(curves.items()):
        axes.plot(t_s / 60, speed, "-" if k == 0 else "--", color=COLOURS[k], label=label)
    axes.set(xlabel="time (min)", ylabel="wheel speed (rad/s)")
    axes.set_ylim(bottom=-20)
    axes.axhline(0, lw=0.5, color=COLOURS[7])
    axes.legend()
    return figure


KINDS.update(
    trajectory=Kind("simulate", "trajectory", trajectory_summary, trajectory_drawings),
    impact=Kind("impact", "impact", impact_summary),
    spin_down=Kind("spin_down", "spin-down", spin_down_summary, spin_down_drawings),
)
