"""What the order and the times of the samples add: the third act of the study, past the paper.

The EMD of r_z ignores when a sample was taken. The posterior (`sunspin.posterior`) compares each reading of the rebound at
its own time, so that it may leave one motion where the EMD leaves a line. Its draws give the angular speed just after the first
touchdown, up to the collision, and, with simulated collisions, after it. For the case's own telemetry the truth is known and shown.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from sunspin.dynamics.batch import Rows, run
from sunspin.estimate.lander.predict import predict
from sunspin.landing.outcomes import outcomes
from sunspin.output.figures import ABOVE, COLOURS, empty_figure, titled
from sunspin.philae.candidates import (
    draws_of_posterior,
    sample_posterior,
    states_dataset,
    touchdown_speeds,
)
from sunspin.philae.metrics import NearMinimum, draw_published_lines, rate_space_views
from sunspin.philae.rebound import Options, Rebound, read_truth, start_states
from sunspin.philae.row import Row, make_row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

QUANTILES = (0.05, 0.5, 0.95)
"""Ends and middle of the shown intervals, which contain 90 % of the probability."""

SPEED_STEP_S = 20.0
"""Time step in s of the angular speed against time."""


@dataclass(frozen=True)
class TrueSpeeds:
    """True angular speeds in rad/s of the case's own telemetry: just after the touchdown, before and after the collision.

    `state`: the true state at the first sample. `speed` (n_time): true angular speed at the times of `Timing.t_s`.
    """

    state: Rows
    touchdown: float
    collision: float
    after: float
    speed: np.ndarray


@dataclass(frozen=True)
class Timing:
    """The posterior of the rebound's readings, and what it predicts.

    Attributes
    ----------
    motions : draws of the posterior at the candidates' instant, as `outcomes` takes them
    touchdown, collision : (n) rad/s, angular speed of the draws just after the first touchdown and just before the collision, each
        with inertia, wheel and friction of its own draw
    verdict : that of the posterior, in words
    t_s : (n_time) times in s from the candidates' instant
    speed : (3, n_time) rad/s, 5, 50 and 95 % quantiles of the angular speed at these times
    after : (n) rad/s, angular speed after simulated collisions of the draws (section 3.3), wheel off
    truth : true values of the case's own synthetic telemetry; None for any other telemetry
    """

    rebound: Rebound
    motions: xr.Dataset
    touchdown: np.ndarray
    collision: np.ndarray
    verdict: str
    t_s: np.ndarray
    speed: np.ndarray
    after: np.ndarray
    truth: TrueSpeeds | None

    @property
    def unique(self) -> bool:
        """True if the posterior has a single solution."""
        return self.verdict.startswith("unique")


def compute(rebound: Rebound, posterior: xr.DataTree | None, runs: int, options: Options) -> Timing:
    """Sample the posterior of the rebound's readings, and simulate `runs` collisions of its draws.

    With a `posterior`, of which the candidates of the study are draws already, that one is used.

    Raises
    ------
    TelemetryError
        No motion explains the readings.
    """
    case = rebound.case
    if posterior is None:
        posterior = sample_posterior(case.vehicle, case.telemetry, rebound.span_s, options)
    motions = states_dataset(*draws_of_posterior(posterior), source="posterior")
    t = np.append(np.arange(0.0, rebound.window_s, SPEED_STEP_S), rebound.window_s)
    # the touchdown first, then from the candidates' instant to the collision
    instant = float(rebound.samples["utc_s"].values[rebound.first])
    times = instant + np.concatenate([[-rebound.lead_s], t])
    rates = predict(case.vehicle, posterior, times, options.workers)["rate"]
    rate = rates.values[0]  # (draw, time)
    rate = rate[np.all(np.isfinite(rate), axis=1)]
    touchdown, collision, speed = rate[:, 0], rate[:, -1], np.quantile(rate[:, 1:], QUANTILES, 0)
    as_in_the_paper, _ = rebound.scenarios()
    collisions = outcomes(
        case.vehicle,
        motions,
        "off",
        runs,
        options.seed,
        scenario=as_in_the_paper,
        until="collision",
        workers=options.workers,
    )
    after = np.linalg.norm(collisions["omega_after_B"].values, axis=1)
    after = after[np.isfinite(after)]
    truth, verdict = _find_truth(rebound, t), str(posterior.attrs["verdict"])
    return Timing(rebound, motions, touchdown, collision, verdict, t, speed, after, truth)


def _speeds(rebound: Rebound, states: Rows, t_s: np.ndarray) -> np.ndarray:
    """Return the angular speeds (n, n_time) in rad/s of motions from `states` (n); the first of t_s is zero."""
    later = run(rebound.case.vehicle, states, t_s[1:], error=1e-4).omega_B
    omega_B = np.concatenate([states.omega_B[:, None], later], axis=1)
    return np.linalg.norm(omega_B, axis=2)


def _find_truth(rebound: Rebound, t_s: np.ndarray) -> TrueSpeeds | None:
    """Return the true values if the telemetry is the case's own synthetic one."""
    known = read_truth(rebound.case)
    if not known:
        return None
    omega, sun, wheel = (
        np.array(known[name]) for name in ("omega_B", "sun_B", "wheel_speed_rad_s")
    )
    state = start_states(rebound.case, omega, sun, wheel)
    before, after = (
        float(np.linalg.norm(known[f"collision_omega_{when}_B"])) for when in ("before", "after")
    )
    touchdown = float(touchdown_speeds(rebound, state)[0])
    return TrueSpeeds(state, touchdown, before, after, _speeds(rebound, state, t_s)[0])


def rows(timing: Timing) -> list[Row]:
    """Return the angular speeds at the touchdown, at the collision and after it, compared with what the paper says."""
    truth, result = timing.truth, []
    for name, speeds, true in (
        ("timed_rate_at_touchdown", timing.touchdown, truth and truth.touchdown),
        ("timed_rate_at_collision", timing.collision, truth and truth.collision),
        ("timed_rate_after_collision", timing.after, truth and truth.after),
    ):
        low, middle, high = np.quantile(speeds, QUANTILES).tolist()
        known = "not known" if true is None else f"{true:.4f} rad/s"
        before = f"median; {low:.4f} to {high:.4f} is 90 % probable; truth: {known}"
        notes = {
            "timed_rate_at_touchdown": f"{before}. The posterior: {timing.verdict}",
            "timed_rate_at_collision": before,
            "timed_rate_after_collision": f"median over simulated collisions as in section 3.3, wheel off; {low:.3f} to {high:.3f} "
            f"is 90 % probable, as leg and direction of the impact are not known; truth: {known}",
        }
        result.append(make_row(timing.rebound.case, name, middle, notes, low=low, high=high))
    return result


def describe(timing: Timing) -> str:
    """Return the third act in a sentence or two."""
    truth = timing.truth
    slow, middle, fast = np.quantile(timing.touchdown, QUANTILES)
    solutions = "one motion" if timing.unique else "more than one motion"
    text = (
        f"the posterior of the same samples, which uses their order and times, leaves {solutions}: {middle:.3f} rad/s "
        f"({slow:.3f} to {fast:.3f}, 90 % probable) just after the touchdown"
    )
    text += f", where {truth.touchdown:.3f} is true" if truth else ""
    slow, middle, fast = np.quantile(timing.collision, QUANTILES)
    text += f"; {middle:.4f} rad/s ({slow:.4f} to {fast:.4f}) just before the collision"
    text += f" ({truth.collision:.4f} is true)" if truth else ""
    slow, _, fast = np.quantile(timing.after, QUANTILES)
    text += f". After it the unknown impact leaves {slow:.2f} to {fast:.2f} rad/s"
    text += f" ({truth.after:.2f} is true)." if truth else "."
    return f"What timing adds: {text}"


def posterior_figure(timing: Timing, near: NearMinimum, synthetic: bool) -> Figure:
    """Draw the published lines, the near-minimum set and the posterior in the space of initial rates, in two views."""
    case, truth = timing.rebound.case, timing.truth
    figure = empty_figure(11, 5.4)
    draws = timing.motions["omega_B"].values
    draws = draws[:: max(len(draws) // 1000, 1)]
    for axes in rate_space_views(figure, case):
        label = f"EMD < {near.factor:g} EMD_min ({len(near.points)} motions)"
        axes.scatter(*near.points.T, s=4, c="#cccccc", linewidths=0, label=label, zorder=1)
        draw_published_lines(axes, case)
        label = f"posterior of the same samples ({len(draws)} of its draws)"
        axes.scatter(*draws.T, s=7, c=COLOURS[0], linewidths=0, label=label, zorder=4)
        if truth is not None:
            label, at = "truth of the synthetic telemetry", truth.state.omega_B[0]
            style: dict[str, Any] = {"facecolors": "none", "edgecolors": COLOURS[1], "zorder": 5}
            axes.scatter(*at, marker="*", s=160, label=label, **style)
    what = "one motion" if timing.unique else "more than one motion"
    title = f"With the times of the samples {what} of the lines remains"
    figure.suptitle(titled(title, synthetic), fontsize=11)
    labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(*labels, fontsize=9, ncols=2, loc="outside lower center", frameon=False)
    return figure


def speeds_figure(timing: Timing, near_minimum: np.ndarray, synthetic: bool) -> Figure:
    """Draw the angular speed just after the touchdown, up to the collision, and after it, by the posterior.

    `near_minimum` (n): angular speeds in rad/s just after the touchdown of the motions of the paper's recipe, drawn too.
    """
    truth = timing.truth
    figure = empty_figure(11, 4.4)
    first, middle, last = figure.subplots(1, 3)
    touchdown, after = "just after the first touchdown", "after the collision"
    for axes, speeds, of_lines, true, when in (
        (first, timing.touchdown, near_minimum, truth and truth.touchdown, touchdown),
        (last, timing.after, near_minimum[:0], truth and truth.after, after),
    ):
        both = np.concatenate([speeds, of_lines])
        edges = np.linspace(0.0, 1.05 * float(np.quantile(both, 0.999)), 60)
        if of_lines.size:
            label = "EMD near its minimum"
            axes.hist(of_lines, edges, density=True, color="#bbbbbb", label=label)
        axes.hist(speeds, edges, density=True, color=COLOURS[0], alpha=0.8, label="posterior")
        if true is not None:
            axes.axvline(true, color="#000000", lw=1.4, ls=":", label="truth")
        axes.set(xlabel=f"angular speed {when} (rad/s)", xlim=(0, edges[-1]))
        axes.set_ylabel("density (s/rad)")
    published = float(timing.rebound.case.published["rate_at_touchdown_min"].value)
    label = f"published lower bound: {published:g} rad/s"
    first.axvline(published, color=COLOURS[1], ls="--", lw=1.4, label=label)
    minutes = timing.t_s / 60
    label = "posterior, 5 to 95 %"
    low, centre, high = timing.speed
    middle.fill_between(minutes, low, high, color=COLOURS[0], alpha=0.35, lw=0, label=label)
    middle.plot(minutes, centre, color=COLOURS[0], lw=1.2)
    if truth is not None:
        middle.plot(minutes, truth.speed, color="#000000", lw=1.4, ls=":", label="truth")
    middle.set(
        xlabel="time from the first sample to the collision (min)", ylabel="angular speed (rad/s)"
    )
    middle.set_ylim(0.8 * float(low.min()), 1.1 * float(high.max()))
    for axes in (first, middle, last):
        axes.legend(fontsize=8, **ABOVE)
    title = titled(
        "What the times of the samples add: the posterior and its predictions", synthetic
    )
    figure.suptitle(title, fontsize=11)
    return figure


def datasets(timing: Timing) -> dict[str, xr.Dataset]:
    """Return the draws of the posterior, and the angular speed against time, by file name."""
    attrs = {"units": "rad s-1"}
    speed = xr.Dataset(
        {
            "speed": (("quantile", "time"), timing.speed, attrs),
            "after": ("run", timing.after, attrs),
        },
        coords={"quantile": list(QUANTILES), "time": ("time", timing.t_s, {"units": "s"})},
    )
    for name, values in (("touchdown", timing.touchdown), ("collision", timing.collision)):
        speed[name] = "draw", values, attrs
    return {"timing": timing.motions, "timing_speed": speed}
