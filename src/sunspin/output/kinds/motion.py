"""Trajectories, impacts, wheels that run down."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sunspin.output.kind import Context, Drawing, Summary, vector
from sunspin.output.text import rate_text

MOST_EVENTS = 20
"""Wheel events that are printed."""


def trajectory_summary(run: Any) -> Summary:
    """The state at the last time, and the wheels' events."""
    t, end = run["time"].values, run.isel(time=-1)
    parts = (run["event_time_s"].values, run["event_wheel"].values, run["event_what"].values)
    events = [
        {"t_s": float(at), "wheel": str(name), "what": str(what)}
        for at, name, what in zip(*parts, strict=True)
    ]
    state = {name: end[name].values.tolist() for name in ("omega_B", "sun_B", "wheel_speed_rad_s")}
    wheels = (
        f", wheels {vector(state['wheel_speed_rad_s'])} rad/s" if state["wheel_speed_rad_s"] else ""
    )
    lines = [
        f"at t = {t[-1]:zg} s: rate {rate_text(state['omega_B'])}, Sun {vector(state['sun_B'])}{wheels}",
        *(
            f"  {event['wheel']} {event['what']} at {event['t_s']:z.3f} s"
            for event in events[:MOST_EVENTS]
        ),
    ]
    if len(events) > MOST_EVENTS:
        lines.append(f"  and {len(events) - MOST_EVENTS} more wheel events")
    return Summary({"t_s": float(t[-1]), **state, "events": events}, lines)


def trajectory_drawings(run: Any, _: Context) -> Iterator[Drawing]:
    from sunspin.output.figures.motion import trajectory_figure

    yield Drawing(
        "trajectory",
        lambda: trajectory_figure(run),
        "Components and size of the body rate and the wheels' speeds against time.",
        "Simulated body rate, body axes, and wheel speeds relative to the body. A simulation has no error bar: it is as sure as "
        "the state that it was started from.",
    )


def impact_summary(hit: Any) -> Summary:
    """Rates, speed and impulse just after the impact, in the middle of the cases where there are many."""
    numbers = {}
    for name in ("omega_B", "wheel_speed_rad_s", "velocity_B", "impulse_B"):
        values = hit[name].values.reshape(-1, hit[name].shape[-1])
        numbers[name] = np.median(values, axis=0).tolist()
    cases = int(np.prod(hit["omega_B"].shape[:-1]))
    head = "after the impact" if cases == 1 else f"after {cases} impacts, medians"
    units = {name: str(hit[name].attrs["units"]) for name in numbers}
    return Summary(
        {"cases": cases, **numbers},
        [head, *(f"  {n} {vector(v)} {units[n]}" for n, v in numbers.items())],
    )


def spin_down_summary(fit: Any) -> Summary:
    """Coefficients with their sigmas, the friction, the residual."""
    sigma = np.sqrt(np.diag(fit["covariance"].values))
    names = ("c1_rad_s", "c2_per_s", "c3_rad_s")
    numbers = {
        name: float(fit[name]) for name in (*names, "coulomb_N_m", "viscous_N_m_s", "rms_rad_s")
    }
    found = [
        f"{n[:2]} = {numbers[n]:.6g} +- {s:.2g} {fit[n].attrs['units']}"
        for n, s in zip(names, sigma, strict=True)
    ]
    return Summary(
        numbers | {"sigma": sigma.tolist(), "samples": fit.sizes["time"]},
        [
            f"wheel speed c1 exp(c2 t) + c3 through {fit.sizes['time']} samples: {', '.join(found)}; "
            f"rms {numbers['rms_rad_s']:.3g} rad s-1",
            f"  friction: {numbers['coulomb_N_m']:.5g} N m, and {numbers['viscous_N_m_s']:.5g} N m s times the speed",
        ],
    )


def spin_down_drawings(fit: Any, _: Context) -> Iterator[Drawing]:
    from sunspin.output.figures.motion import spin_down_figure

    curves = {"recorded": fit["recorded_rad_s"].values, "fitted": fit["fitted_rad_s"].values}
    yield Drawing(
        "spin-down",
        lambda: spin_down_figure(
            fit["time"].values, curves, "A wheel that runs down, and c1 exp(c2 t) + c3"
        ),
        "Size of a wheel's speed against time as recorded and as fitted.",
        "A wheel that runs down: as recorded, and c1 exp(c2 t) + c3.",
    )
