"""Philae's motion for display: complete candidate motions from touchdown to touchdown, and the angular speed with its spread.

Nothing here is compared with the paper; the report draws it. After the collision a candidate is one of many. The leg that hits and
the direction of the impact are drawn once (`telemetry.simulate_collision`) and are the same for all, so that only the motions
differ.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.dates import DateFormatter
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from sunspin.cases import Case
from sunspin.dynamics import gyrostat
from sunspin.dynamics.ensemble import Rows, run_rows
from sunspin.dynamics.propagate import propagate
from sunspin.dynamics.wheel_modes import mode_before
from sunspin.output.figures import COLOURS, titled
from sunspin.philae.candidates import Chain
from sunspin.philae.descent import Descent
from sunspin.philae.metrics import TelemetryScan
from sunspin.philae.rebound import Rebound, event_seconds, nominal_wheel_speeds, read_truth
from sunspin.philae.simulation import State, simulate_collision
from sunspin.telemetry.synthetic import generator
from sunspin.vehicle.response.panels import panel_power

SPREAD_MOTIONS = 150
"""Number of motions drawn from the confidence set; the slowest, the fastest and those of least and largest momentum are added."""


def compute(case: Case, done: dict[str, Any], seed: int = 0) -> dict[str, xr.Dataset]:
    """Return motions by name, as Datasets of `propagate` with panel signals.

    `done` holds the results of earlier steps: `level_set`, `candidates` and, if it was computed, `descent`.
    """
    scan: TelemetryScan = done["level_set"]
    chain: Chain = done["candidates"]
    descent: Descent | None = done.get("descent")
    rebound, chosen = chain.rebound, chain.chosen
    runs = {}
    if scan.truth:
        start = replace(rebound.states(scan.truth["omega_B"]), sun_B=scan.truth["sun_B"][None])
        about = "the motion from which the synthetic telemetry was made"
        runs["Truth"] = propagate_landing(rebound, start, about, read_truth(case).get("seed", seed))
    start = scan.table.rows.start.take(np.array([np.argmin(scan.emd)]))
    about = f"the grid point whose distribution of r_z fits this telemetry best (EMD {scan.smallest:.4f})"
    runs["Best fit"] = propagate_landing(rebound, start, about, seed)
    order = np.argsort(chosen.speed_touchdown)
    for name, at in (("Slowest", 0), ("Middle", len(order) // 2), ("Fastest", -1)):
        start, speed = chosen.states.take(order[[at]]), chosen.speed_touchdown[order[at]]
        about = f"{name.lower()} of {chosen.about}: {speed:.3f} rad/s just after the touchdown"
        runs[f"{name} candidate"] = propagate_landing(rebound, start, about, seed)
    if descent is not None:
        runs["Descent"] = make_descent_motion(case, descent)
    return runs


def propagate_landing(rebound: Rebound, start: Rows, about: str, seed: int) -> xr.Dataset:
    """Return the motion from the first touchdown to the second, through the collision.

    `start` is one state at the candidates' instant. Times are in s from the case's epoch.
    """
    case, timeline = rebound.case, rebound.case.require_timeline()
    impact_s, end_s = (timeline.event(name).t_s for name in ("collision", "second_touchdown"))
    first_s = impact_s - rebound.window_s
    state = State(first_s, start.omega_B[0], start.sun_B[0], start.wheel_speed_rad_s[0])
    collision = simulate_collision(case, state, generator(seed, 3))

    def run(
        state: State, duration_s: float, sign: int = 1, wheel_mode: Any = "coast"
    ) -> xr.Dataset:
        """Return the motion from a state, every second; `sign` -1 runs backward in time."""
        # the fastest motion rotates by half a radian in a step of 1 s
        t = sign * np.arange(0.0, duration_s + 1e-6, 1.0)
        return propagate(case.vehicle, *state[1:], t, wheel_mode=wheel_mode, rtol=1e-9)

    back = run(state, rebound.lead_s, -1, mode_before(start.wheel_speed_rad_s))
    forth = run(state, impact_s - first_s)
    beyond = run(collision.after, end_s - impact_s)
    # each run counts attitude from its own start: that after the collision begins at the attitude of the collision
    at_impact = Rotation.from_quat(forth["B_from_N"].values[-1])
    attitude = (Rotation.from_quat(beyond["B_from_N"].values) * at_impact).as_quat()
    beyond["B_from_N"] = beyond["B_from_N"].copy(data=attitude)
    pieces = (
        (back.isel(time=slice(None, 0, -1)), first_s),
        (forth.isel(time=slice(None, -1)), first_s),
        (beyond, impact_s),
    )
    pieces = [p.drop_dims("event").assign_coords(time=p["time"] + shift) for p, shift in pieces]
    joining: Any = {"data_vars": "minimal", "coords": "minimal", "compat": "override"}
    whole = xr.concat(pieces, "time", join="override", **joining)
    changes = (forth[f"event_{key}"].values for key in ("time_s", "wheel", "what"))
    events = [(t + first_s, f"{wheel} {what}") for t, wheel, what in zip(*changes, strict=True)]
    about += (
        "; after the collision one of many possible motions "
        f"(leg {collision.leg} hits, drawn with seed {seed})"
    )
    return _add_panel_signals(case, whole, about, [*events, (impact_s, "collision")])


def make_descent_motion(case: Case, descent: Descent) -> xr.Dataset:
    """Return the spin about z that fits the descent, time in s from the case's epoch.

    The inertial frame is that of the body at the start, as the rotation about z is not known then.
    """
    start, end = _descent_span(case, descent)
    t = np.arange(0.0, end - start, 20.0)
    rate = np.polynomial.Polynomial(descent.fit.coefficients)
    axis = np.array([0.0, 0.0, 1.0])
    omega = rate(t)[:, None] * axis
    attitude = Rotation.from_rotvec(-rate.integ()(t)[:, None] * axis).as_quat()
    speed = np.tile(nominal_wheel_speeds(case.vehicle), (t.size, 1))
    momentum, body = gyrostat.total_momentum(case.vehicle, omega, speed), ("time", "axis")
    run = xr.Dataset(
        {
            "omega_B": (body, omega, {"units": "rad s-1"}),
            "sun_B": (body, descent.fit.directions(t), {"units": "1"}),
            "wheel_speed_rad_s": (("time", "wheel"), speed, {"units": "rad s-1"}),
            "momentum_B": (body, momentum, {"units": "N m s"}),
            "B_from_N": (("time", "quaternion"), attitude, {"units": "1"}),
        },
        coords={"time": ("time", t + start, {"units": "s"}), "axis": ["x", "y", "z"]},
    )
    about = "the spin about z that fits the directions of the descent, wheel held by its motor"
    return _add_panel_signals(case, run, about, [])


def _descent_span(case: Case, descent: Descent) -> tuple[float, float]:
    """Return the begin of the fit and the first touchdown, in s from the case's epoch."""
    end = case.require_timeline().event("first_touchdown").t_s
    # offset from the telemetry's epoch to the case's
    to_case = end - event_seconds(case, descent.sun, "first_touchdown")
    return float(case.telemetry["time"].values[descent.number[0] - 1]) + to_case, end


def _add_panel_signals(
    case: Case, run: xr.Dataset, about: str, events: list[tuple[float, str]]
) -> xr.Dataset:
    """Return the motion with the modelled signal of each panel and its `events`: (s from the case's epoch, description)."""
    signal = {"units": case.vehicle.gain_unit or "1", "long_name": "modelled signal"}
    event_s = np.array([t for t, _ in events], dtype=np.float64)
    what = np.array([what for _, what in events], dtype=np.str_)
    run["panel_signal"] = ("time", "panel"), panel_power(case.vehicle, run["sun_B"].values), signal
    run = run.assign(event_time_s=("event", event_s, {"units": "s"}), event_what=("event", what))
    run = run.assign_coords(panel=np.array(case.vehicle.panel_names, dtype=np.str_))
    epoch = case.require_timeline().epoch_utc
    run.attrs = {"vehicle": case.vehicle.name, "about": about, "epoch_utc": epoch}
    return run


def compute_speeds(
    chain: Chain, collisions: xr.Dataset, descent: Descent | None, seed: int
) -> xr.Dataset:
    """Return the range of angular speeds of the candidates against time, as data for a figure.

    Before the collision: slowest, median and fastest candidate, all equally likely. After it: quantiles 0.025, 0.5 and 0.975 over
    the simulated `collisions` of the candidates. With a `descent` its fitted rate is added.
    """
    case, rebound, timeline = chain.case, chain.rebound, chain.case.require_timeline()
    vehicle, states = case.vehicle, chain.chosen.states
    # an even choice of the states, with those of least and largest angular speed and momentum
    momentum = gyrostat.total_momentum(vehicle, states.omega_B, states.wheel_speed_rad_s)
    sizes = np.linalg.norm(states.omega_B, axis=1), np.linalg.norm(momentum, axis=1)
    edges = [end(size) for size in sizes for end in (np.argmin, np.argmax)]
    count = min(SPREAD_MOTIONS, len(states))
    chosen = generator(seed, 4).choice(len(states), count, replace=False)
    states = states.take(np.unique([*edges, *chosen]))
    t = np.append(np.arange(0.0, rebound.window_s, 30.0), rebound.window_s)
    run = run_rows(vehicle, states, t[1:], direction_error=1e-4).omega_B
    before = np.linalg.norm(np.concatenate([states.omega_B[:, None], run], axis=1), axis=2)
    after = np.linalg.norm(collisions["omega_after_B"].values, axis=1)
    levels = np.nanquantile(after, [0.025, 0.5, 0.975])
    rate, first = {"units": "rad s-1"}, timeline.event("collision").t_s - rebound.window_s
    data = xr.Dataset(
        {
            "speed": (("level", "time"), np.quantile(before, [0.0, 0.5, 1.0], axis=0), rate),
            "speed_after_collision": ("level", levels, rate),
        },
        coords={
            "level": ["low", "middle", "high"],
            "time": ("time", t + first, {"units": "s"}),
        },
        attrs={
            "epoch_utc": timeline.epoch_utc,
            "motions": len(states),
            "collisions": collisions.sizes["run"],
            "chain": chain.name,
            "about": chain.chosen.about,
        },
    )
    if descent is None:
        return data
    begin, end = _descent_span(case, descent)
    t = np.linspace(0.0, end - begin, 100)
    spin = np.abs(np.polynomial.Polynomial(descent.fit.coefficients)(t))
    data = data.assign_coords(descent_time=("descent_time", t + begin, {"units": "s"}))
    return data.assign(descent_speed=("descent_time", spin, rate))


def speed_figure(case: Case, speed: xr.Dataset, synthetic: bool) -> Figure:
    """Draw the angular speed against time: the descent's fit, the band of the candidates, the magnetometer.

    Parameters
    ----------
    speed : Dataset of :func:`compute_speeds`
    """
    timeline, published = case.require_timeline(), case.published
    at = {event.name: event.t_s for event in timeline.events}
    epoch = np.datetime64(timeline.epoch_utc.removesuffix("Z"), "ms")

    def clock(seconds: Any) -> Any:
        """Return UTC times for seconds from the case's epoch."""
        return epoch + np.round(1000 * np.asarray(seconds)).astype("timedelta64[ms]")

    figure = Figure(figsize=(11, 5), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1, 2.6))
    if "descent_speed" in speed:
        t, spin = clock(speed["descent_time"].values), speed["descent_speed"].values
        left.plot(t, spin, color=COLOURS[2], lw=2.5, label="fit of the descent")
    after, floor = speed["speed_after_collision"].expand_dims(time=2, axis=-1), 1e-4
    bands = [
        (clock(speed["time"].values), speed["speed"].clip(min=floor)),
        (clock([at["collision"], at["second_touchdown"]]), after.clip(min=floor)),
    ]
    label = "all candidates: slowest to fastest"
    for t, band in bands:
        low, _, high = band.values
        right.fill_between(t, low, high, color=COLOURS[0], alpha=0.25, lw=0, label=label)
        label = None
    marks: dict[str, Any] = {"marker": "D", "ls": "", "ms": 7, "color": COLOURS[6]}
    middle_s = (at["separation"] + at["first_touchdown"]) / 2
    spin = published["descent_rate_romap"].value
    left.plot(clock(middle_s), spin, label="magnetometer (not used)", **marks)
    for t, name in ((-240, "romap_period_before"), (600, "romap_period_after")):
        right.plot(clock(at["collision"] + t), 2 * np.pi / published[name].value, **marks)
    texts = "bounce", "hits crater rim", "lands"
    events = "first_touchdown", "collision", "second_touchdown"
    for name, text in zip(events, texts, strict=True):
        right.axvline(clock(at[name]), color=COLOURS[7], ls=":", lw=1)
        above = right.get_xaxis_transform()
        right.text(clock(at[name]), 1.01, text, fontsize=8, transform=above, ha="center")
    left.set(xlim=clock([at["separation"], at["first_touchdown"]]), title="descent")
    right.set_xlim(clock([at["first_touchdown"] - 120.0, at["second_touchdown"] + 120.0]))
    drawn = np.concatenate([band.values.ravel() for _, band in bands])
    left.set_yscale("log")
    left.set_ylim(min(0.006, 0.8 * np.nanmin(drawn)), max(2.2, 1.2 * np.nanmax(drawn)))
    left.set_ylabel("angular speed (rad/s)")
    periods = right.secondary_yaxis("right")
    named = {600: "10 min", 60: "1 min", 30: "30 s", 13: "13 s", 5: "5 s"}
    periods.set_yticks([2 * np.pi / seconds for seconds in named], list(named.values()))
    periods.minorticks_off()
    periods.set_ylabel("rotation period")
    for axes in (left, right):
        axes.xaxis.set_major_formatter(DateFormatter("%H:%M"))
        axes.tick_params(axis="x", labelrotation=30)
        axes.set_xlabel(f"UTC, {timeline.epoch_utc[:10]}")
    figure.legend(ncols=2, fontsize=8, loc="outside lower center", frameon=False)
    figure.suptitle(titled("How fast Philae turned", synthetic), fontsize=11)
    return figure
