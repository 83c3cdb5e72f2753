"""Philae's motion for display: complete candidate motions from touchdown to touchdown, and the angular speed with its spread.

Nothing here is compared with the paper; the report draws it. After the collision a candidate is one of many. The leg that hits and
the direction of the impact are drawn once (`simulation.simulate_collision`) and are the same for all, so that only the motions
differ. The collision of the truth is that of the telemetry.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from sunspin.cases import Case
from sunspin.dynamics import gyrostat
from sunspin.dynamics.batch import Rows, run
from sunspin.dynamics.propagate import propagate
from sunspin.dynamics.wheel_modes import mode_before
from sunspin.output.figures import COLOURS, empty_figure, titled
from sunspin.philae.candidates import CandidateSets
from sunspin.philae.collision import AfterCollision
from sunspin.philae.descent import Descent
from sunspin.philae.metrics import TelemetryScan
from sunspin.philae.rebound import Rebound, event_seconds, nominal_wheel_speeds, read_truth
from sunspin.philae.simulation import State, simulate_collision
from sunspin.telemetry.synthetic import generator
from sunspin.vehicle.response.panels import panel_power

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SPREAD_MOTIONS = 150
"""Number of motions drawn from the chosen candidates. The slowest, the fastest and those of least and largest momentum are added.
"""

DESCENT_STEP_S = 20.0
"""Time step of the descent's motion for display: the body rotates by less than 20 degrees in it."""


def compute(
    scan: TelemetryScan, candidate_sets: CandidateSets, descent: Descent | None, seed: int = 0
) -> dict[str, xr.Dataset]:
    """Return motions by name, as Datasets of `propagate` with panel signals.

    They are the truth (of the case's own synthetic telemetry), the best grid point, the slowest, the median and the fastest
    candidate, and the descent if it was computed. The attribute `about` of a motion says in words how it was selected.
    """
    case, rebound, chosen = candidate_sets.case, candidate_sets.rebound, candidate_sets.chosen
    motions = {}
    if scan.truth:
        start = replace(rebound.states(scan.truth["omega_B"]), sun_B=scan.truth["sun_B"][None])
        about = "the motion from which the synthetic telemetry was made"
        motions["Truth"] = propagate_landing(rebound, start, about, seed, read_truth(case))
    start = scan.table.rows.start.take(np.array([np.argmin(scan.emd)]))
    about = f"the grid point whose distribution of r_z fits this telemetry best (EMD {scan.smallest:.4f})"
    motions["Smallest EMD"] = propagate_landing(rebound, start, about, seed)
    by_speed = np.argsort(chosen.speed_touchdown)
    for name, rank in (("Slowest", 0), ("Middle", len(by_speed) // 2), ("Fastest", -1)):
        candidate = by_speed[rank]
        start, speed = chosen.states.take(np.array([candidate])), chosen.speed_touchdown[candidate]
        about = f"{name.lower()} of {chosen.about}: {speed:.3f} rad/s just after the touchdown"
        motions[f"{name} candidate"] = propagate_landing(rebound, start, about, seed)
    if descent is not None:
        motions["Descent"] = make_descent_motion(case, descent)
    return motions


def propagate_landing(
    rebound: Rebound, start: Rows, about: str, seed: int, truth: dict[str, Any] | None = None
) -> xr.Dataset:
    """Return the motion from the first touchdown to the second, through the collision.

    `start` is one state at the candidates' instant. `about` says in words how it was selected. The collision is drawn with `seed`,
    or is that of a known `truth` (`rebound.read_truth`).
    Times are in s from the case's epoch, the inertial frame N is that of the body at the candidates' instant.
    """
    case, timeline = rebound.case, rebound.case.require_timeline()
    impact_s, end_s = (timeline.event(name).t_s for name in ("collision", "second_touchdown"))
    start_s = impact_s - rebound.window_s
    state = State(start_s, start.omega_B[0], start.sun_B[0], start.wheel_speed_rad_s[0])
    if truth:
        names = "omega_after_B", "sun_B", "wheel_speed_after_rad_s"
        after = State(impact_s, *(np.array(truth[f"collision_{name}"]) for name in names))
        impact = f"the collision that the telemetry contains (leg {truth['collision_leg']} hits)"
    else:
        collision = simulate_collision(case, state, generator(seed, 3))
        after = collision.after
        impact = (
            "after the collision one of many possible motions "
            f"(leg {collision.leg} hits, drawn with seed {seed})"
        )
    before_start = _propagate_each_second(
        case, state, -rebound.lead_s, mode_before(start.wheel_speed_rad_s)
    )
    before_collision = _propagate_each_second(case, state, impact_s - start_s)
    after_collision = _propagate_each_second(case, after, end_s - impact_s)
    # each part counts its attitude from its own start: refer the last part to the start of the motion
    attitude_at_impact = Rotation.from_quat(before_collision["B_from_N"].values[-1])
    attitude = Rotation.from_quat(after_collision["B_from_N"].values) * attitude_at_impact
    after_collision = after_collision.assign(
        B_from_N=after_collision["B_from_N"].copy(data=attitude.as_quat())
    )
    # Each part with the time at which its clock begins. The backward part is reversed. The instants at which two parts meet are
    # taken from the later part only.
    parts = (
        (before_start.isel(time=slice(None, 0, -1)), start_s),
        (before_collision.isel(time=slice(None, -1)), start_s),
        (after_collision, impact_s),
    )
    on_one_clock = [
        part.drop_dims("event").assign_coords(time=part["time"] + zero_s) for part, zero_s in parts
    ]
    # "event" has a length of its own in each part, and constant variables are the same in all: take those of the first part
    joining: Any = {"data_vars": "minimal", "coords": "minimal", "compat": "override"}
    motion = xr.concat(on_one_clock, "time", join="override", **joining)
    wheel_events = (before_collision[f"event_{key}"].values for key in ("time_s", "wheel", "what"))
    events = [
        (t_s + start_s, f"{wheel} {what}") for t_s, wheel, what in zip(*wheel_events, strict=True)
    ]
    return _complete_for_display(
        case, motion, f"{about}; {impact}", [*events, (impact_s, "collision")]
    )


def _propagate_each_second(
    case: Case, state: State, duration_s: float, wheel_mode: Any = "coast"
) -> xr.Dataset:
    """Return the motion from a state, every second up to `duration_s` (negative: backward); time in s from the state."""
    # the fastest motion rotates by half a radian in a step of 1 s; 1e-6 s keeps the last step if the duration is whole seconds
    t = np.copysign(np.arange(0.0, abs(duration_s) + 1e-6, 1.0), duration_s)
    return propagate(
        case.vehicle,
        state.omega_B,
        state.sun_B,
        state.wheel_speed_rad_s,
        t,
        wheel_mode=wheel_mode,
        rtol=1e-9,
    )


def make_descent_motion(case: Case, descent: Descent) -> xr.Dataset:
    """Return the spin about z that fits the descent, time in s from the case's epoch.

    The inertial frame is that of the body at the start, as the rotation about z is not known then.
    """
    start_s, end_s = _descent_span(case, descent)
    t = np.arange(0.0, end_s - start_s, DESCENT_STEP_S)
    rate = np.polynomial.Polynomial(
        descent.fit.coefficients
    )  # rad/s about z, t in s from the start
    z_axis = np.array([0.0, 0.0, 1.0])
    omega_B = rate(t)[:, None] * z_axis
    # the integral of the rate is the angle of the body in N; B_from_N rotates by the opposite angle
    B_from_N = Rotation.from_rotvec(-rate.integ()(t)[:, None] * z_axis).as_quat()
    wheel_speed = np.tile(nominal_wheel_speeds(case.vehicle), (t.size, 1))
    momentum_B = gyrostat.total_momentum(case.vehicle, omega_B, wheel_speed)
    by_axis = ("time", "axis")
    motion = xr.Dataset(
        {
            "omega_B": (by_axis, omega_B, {"units": "rad s-1"}),
            "sun_B": (by_axis, descent.fit.directions(t), {"units": "1"}),
            "wheel_speed_rad_s": (("time", "wheel"), wheel_speed, {"units": "rad s-1"}),
            "momentum_B": (by_axis, momentum_B, {"units": "N m s"}),
            "B_from_N": (("time", "quaternion"), B_from_N, {"units": "1"}),
        },
        coords={"time": ("time", t + start_s, {"units": "s"}), "axis": ["x", "y", "z"]},
    )
    about = "the spin about z that fits the directions of the descent, wheel held by its motor"
    return _complete_for_display(case, motion, about, [])


def _descent_span(case: Case, descent: Descent) -> tuple[float, float]:
    """Return the begin of the fit and the first touchdown, in s from the case's epoch."""
    touchdown_s = case.require_timeline().event("first_touchdown").t_s
    # offset from the telemetry's epoch to the case's
    to_case_s = touchdown_s - event_seconds(case, descent.sun, "first_touchdown")
    first_sample = descent.number[0] - 1  # numbers count from 1
    return float(case.telemetry["time"].values[first_sample]) + to_case_s, touchdown_s


def _complete_for_display(
    case: Case, motion: xr.Dataset, about: str, events: list[tuple[float, str]]
) -> xr.Dataset:
    """Return a copy of the motion with what the report shows: modelled panel signals, events and attributes.

    `about` says in words which motion it is. `events` are pairs of the time (s from the case's epoch) and a description. The
    attributes of `motion` are replaced.
    """
    signal_attrs = {"units": case.vehicle.gain_unit or "1", "long_name": "modelled signal"}
    signal = panel_power(case.vehicle, motion["sun_B"].values)  # (n_time, n_panel)
    event_s = np.array([t_s for t_s, _ in events], dtype=np.float64)
    descriptions = np.array([description for _, description in events], dtype=np.str_)
    completed = motion.assign(
        panel_signal=(("time", "panel"), signal, signal_attrs),
        event_time_s=("event", event_s, {"units": "s"}),
        event_what=("event", descriptions),
    ).assign_coords(panel=np.array(case.vehicle.panel_names, dtype=np.str_))
    epoch = case.require_timeline().epoch_utc
    completed.attrs = {"vehicle": case.vehicle.name, "about": about, "epoch_utc": epoch}
    return completed


def compute_speeds(collision: AfterCollision, descent: Descent | None, seed: int) -> xr.Dataset:
    """Return the range of angular speeds of the candidates against time, as data for a figure.

    Before the collision: slowest, median and fastest candidate, all equally likely. After it: quantiles 0.025, 0.5 and 0.975 over
    the simulated collisions of the candidates, at the kernel's speeds. With a `descent` its fitted rate is added.
    """
    candidate_sets, collisions = collision.candidate_sets, collision.weighted
    case, rebound = candidate_sets.case, candidate_sets.rebound
    timeline = case.require_timeline()
    vehicle, states = case.vehicle, candidate_sets.chosen.states
    # an even choice of the states, with those of least and largest angular speed and momentum
    momentum = gyrostat.total_momentum(vehicle, states.omega_B, states.wheel_speed_rad_s)
    sizes = np.linalg.norm(states.omega_B, axis=1), np.linalg.norm(momentum, axis=1)
    extremes = [index_of(size) for size in sizes for index_of in (np.argmin, np.argmax)]
    count = min(SPREAD_MOTIONS, len(states))
    drawn = generator(seed, 4).choice(len(states), count, replace=False)
    states = states.take(np.unique([*extremes, *drawn]))
    # every half minute, and the collision
    t = np.append(np.arange(0.0, rebound.window_s, 30.0), rebound.window_s)
    later_omega_B = run(vehicle, states, t[1:], error=1e-4).omega_B
    omega_B = np.concatenate([states.omega_B[:, None], later_omega_B], axis=1)  # (n, n_time, 3)
    band_before = np.quantile(np.linalg.norm(omega_B, axis=2), [0.0, 0.5, 1.0], axis=0)
    after = np.linalg.norm(collisions["omega_after_B"].values, axis=1)
    band_after = np.nanquantile(after, [0.025, 0.5, 0.975])
    rate_attrs = {"units": "rad s-1"}
    start_s = timeline.event("collision").t_s - rebound.window_s
    data = xr.Dataset(
        {
            "speed": (("level", "time"), band_before, rate_attrs),
            "speed_after_collision": ("level", band_after, rate_attrs),
        },
        coords={"level": ["low", "middle", "high"], "time": ("time", t + start_s, {"units": "s"})},
        attrs={
            "epoch_utc": timeline.epoch_utc,
            "motions": len(states),
            "collisions": collisions.sizes["run"],
            "chain": candidate_sets.source,
            "about": candidate_sets.chosen.about,
        },
    )
    if descent is None:
        return data
    begin_s, end_s = _descent_span(case, descent)
    t = np.linspace(0.0, end_s - begin_s, 100)
    spin = np.abs(np.polynomial.Polynomial(descent.fit.coefficients)(t))
    data = data.assign_coords(descent_time=("descent_time", t + begin_s, {"units": "s"}))
    return data.assign(descent_speed=("descent_time", spin, rate_attrs))


def speed_figure(case: Case, speed: xr.Dataset, synthetic: bool) -> Figure:
    """Draw the angular speed against time: the descent's fit, the band of the candidates, the magnetometer.

    The left axes show the descent, the right ones the time from first to second touchdown.

    Parameters
    ----------
    speed : Dataset of :func:`compute_speeds`
    """
    from matplotlib.dates import DateFormatter

    timeline, published = case.require_timeline(), case.published
    event_s = {event.name: event.t_s for event in timeline.events}
    epoch = np.datetime64(timeline.epoch_utc.removesuffix("Z"), "ms")

    def clock(seconds: Any) -> Any:
        """Return UTC times for seconds from the case's epoch."""
        return epoch + np.round(1000 * np.asarray(seconds)).astype("timedelta64[ms]")

    figure = empty_figure(11, 5)
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1, 2.6))
    if "descent_speed" in speed:
        t, spin = clock(speed["descent_time"].values), speed["descent_speed"].values
        left.plot(t, spin, color=COLOURS[2], lw=2.5, label="fit of the descent")
    # the band after the collision is constant in time; a logarithmic axis needs speeds above zero
    after, floor = speed["speed_after_collision"].expand_dims(time=2, axis=-1), 1e-4
    bands = [
        (clock(speed["time"].values), speed["speed"].clip(min=floor)),
        (clock([event_s["collision"], event_s["second_touchdown"]]), after.clip(min=floor)),
    ]
    label = "all candidates: slowest to fastest"
    for t, band in bands:
        low, _, high = band.values
        right.fill_between(t, low, high, color=COLOURS[0], alpha=0.25, lw=0, label=label)
        label = None  # one entry of the legend for both bands
    marks: dict[str, Any] = {"marker": "D", "ls": "", "ms": 7, "color": COLOURS[6]}
    middle_s = (event_s["separation"] + event_s["first_touchdown"]) / 2
    spin = published["descent_rate_romap"].value
    left.plot(clock(middle_s), spin, label="magnetometer (not used)", **marks)
    # no time is published for either period: the marks stand 4 min before and 10 min after the collision
    for offset_s, name in ((-240, "romap_period_before"), (600, "romap_period_after")):
        time = clock(event_s["collision"] + offset_s)
        right.plot(time, 2 * np.pi / published[name].value, **marks)
    for name, text in (
        ("first_touchdown", "bounce"),
        ("collision", "hits crater rim"),
        ("second_touchdown", "lands"),
    ):
        right.axvline(clock(event_s[name]), color=COLOURS[7], ls=":", lw=1)
        above = right.get_xaxis_transform()
        right.text(clock(event_s[name]), 1.01, text, fontsize=8, transform=above, ha="center")
    left.set(xlim=clock([event_s["separation"], event_s["first_touchdown"]]), title="descent")
    right.set_xlim(clock([event_s["first_touchdown"] - 120.0, event_s["second_touchdown"] + 120.0]))
    speeds = np.concatenate([band.values.ravel() for _, band in bands])
    left.set_yscale("log")
    # at least from 0.006 to 2.2 rad/s, so that figures of different telemetry can be compared
    left.set_ylim(min(0.006, 0.8 * np.nanmin(speeds)), max(2.2, 1.2 * np.nanmax(speeds)))
    left.set_ylabel("angular speed (rad/s)")
    periods = right.secondary_yaxis("right")
    period_texts = {600: "10 min", 60: "1 min", 30: "30 s", 13: "13 s", 5: "5 s"}
    rates = [2 * np.pi / period_s for period_s in period_texts]
    periods.set_yticks(rates, list(period_texts.values()))
    periods.minorticks_off()
    periods.set_ylabel("rotation period")
    for axes in (left, right):
        axes.xaxis.set_major_formatter(DateFormatter("%H:%M"))
        axes.tick_params(axis="x", labelrotation=30)
        axes.set_xlabel(f"UTC, {timeline.epoch_utc[:10]}")
    figure.legend(ncols=2, fontsize=8, loc="outside lower center", frameon=False)
    figure.suptitle(titled("How fast Philae turned", synthetic), fontsize=11)
    return figure
