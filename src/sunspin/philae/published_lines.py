"""The paper's four lines with our equations: no telemetry is used, so none can change these results.

Do the lines have one distribution of r_z? Does a scan of this distribution recover them? Which angular speed at the touchdown do
they allow, and which motion after the collision (paper, sections 2.3, 3.2, 3.3; Figs. 9, 12, 13)?
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from sunspin.cases import Case
from sunspin.compute.pool import worker_count
from sunspin.estimate.scan.metrics import emd
from sunspin.landing.outcomes import outcomes
from sunspin.landing.scenario import Scenario, paper_scenario
from sunspin.landing.tally import lowest_rz, tally
from sunspin.output.figures import COLOURS, empty_figure
from sunspin.philae.collision import RARELY, rz_range
from sunspin.philae.metrics import (
    NearMinimum,
    TelemetryScan,
    make_near_minimum_set,
    propagate_grid,
    rate_axes,
    simulate_rz,
)
from sunspin.philae.rebound import (
    LINE_RANGE,
    Options,
    first_sample_lead_s,
    first_sun,
    nominal_wheel_speeds,
    points_on_lines,
    published_candidates,
    published_lines,
    published_window_s,
    rates_at_touchdown,
    smallest_touchdown_speed,
    wheel_speed_at_first_sample,
)
from sunspin.philae.row import Row, interval_90, make_row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LINE_POINTS = 41
"""Number of motions on each line that are propagated back to the touchdown."""

POOL_RANGE, POOL_POINTS = (-0.15, 0.3), 16
"""Range of omega_z (rad/s) and number of the points on each line whose r_z make up the lines' common distribution."""

FACTOR = 4.0
"""Near-minimum factor for the lines' common distribution. So exact a target has so small a minimum that 1.1 times it leaves a
handful of points. The EMD of points on the lines themselves is up to several times the minimum.
"""

LEADS_S = (26.0, 86.0)
"""Limits (s) of the time from touchdown to first sample: 56 s, uncertain by half a minute as "45 min" is rounded."""

NEVER = 0.01
"""Largest share of the runs that counts as "never"; the paper has 400 runs."""


@dataclass(frozen=True)
class PublishedLines:
    """Results from the published lines alone.

    Attributes
    ----------
    pooled : for each line, r_z of the motions begun on it, in view of the panels
    spread : largest EMD of a line's distribution to the common one
    clean : near-minimum set of the scan of their common distribution
    thresholds : for several factors: "factor", number of "points" in the set, "mean_distance" (rad/s) of each line
    near_touchdown, on_lines_touchdown : (n, 3) rates in rad/s at the touchdown of that set, and of points of the lines
    slowest : smallest angular speeds (rad/s) of the lines at the touchdown. Three times of the first sample: earliest,
        nominal, latest. For each: wheel nominal at the first sample, then wheel nominal at the touchdown.
    runs : collisions by wheel strategy at the speed of section 3.3
    slow : collisions with the wheel held, at the speed of section 4
    """

    case: Case
    pooled: list[np.ndarray]
    spread: float
    clean: NearMinimum
    thresholds: list[dict[str, Any]]
    near_touchdown: np.ndarray
    on_lines_touchdown: np.ndarray
    slowest: list[float]
    runs: dict[str, xr.Dataset]
    slow: xr.Dataset


def pool_rz(case: Case) -> list[np.ndarray]:
    """Return for each published line the r_z of motions that begin at `POOL_POINTS` points of it, in view of the panels."""
    starts = points_on_lines(published_lines(case), np.linspace(*POOL_RANGE, POOL_POINTS))
    return [np.concatenate([simulate_rz(case, omega) for omega in line]) for line in starts]


def compute(case: Case, scan: TelemetryScan | None, runs: int, options: Options) -> PublishedLines:
    """Simulate motions on the lines.

    The motions of `scan` are used if they begin as the paper's do, from one direction over one window; else the grid is propagated.
    """
    first, window, lines = first_sun(case), published_window_s(case), published_lines(case)
    if scan is not None and scan.rebound.starts_from(first, window):
        table = scan.table
    else:
        table = propagate_grid(case, first, window, options)

    # distribution of r_z of each line, their common distribution, and near-minimum sets of the scan of the latter
    pooled = pool_rz(case)
    common = np.concatenate(pooled)
    volume = table.volume(common, workers=worker_count(options.workers))
    factors = (1.1, 1.5, 2.0, 3.0, FACTOR, 6.0)
    sets = {factor: make_near_minimum_set(case, volume, factor, options.seed) for factor in factors}
    thresholds = [
        {
            "factor": factor,
            "points": len(near.points),
            "mean_distance": [deviation["mean"] for deviation in near.deviation],
        }
        for factor, near in sets.items()
    ]

    # back to the touchdown: smallest speeds for three times of the first sample and two assumptions on the wheel
    nominal = nominal_wheel_speeds(case.vehicle)[0]
    on_lines = points_on_lines(lines, np.linspace(*LINE_RANGE, LINE_POINTS))
    slowest = [
        smallest_touchdown_speed(case, speed, lead)
        for lead in (LEADS_S[0], first_sample_lead_s(case), LEADS_S[1])
        for speed in (nominal, wheel_speed_at_first_sample(case, lead))
    ]

    scenario, motions = paper_scenario(case), published_candidates(case)
    slow = replace(scenario, collision_speed_m_s=case.published["landing_speed"].value)

    def simulate(strategy: str, scenario: Scenario) -> xr.Dataset:
        """Simulate collisions of the motions on the lines."""
        settings: dict[str, Any] = {
            "scenario": scenario,
            "workers": options.workers,
            "until": "flight",
        }
        return outcomes(case.vehicle, motions, strategy, runs, options.seed, **settings)

    return PublishedLines(
        case,
        pooled=pooled,
        spread=max(emd(z, common) for z in pooled),
        clean=sets[FACTOR],
        thresholds=thresholds,
        near_touchdown=rates_at_touchdown(case, sets[FACTOR].points, nominal),
        on_lines_touchdown=rates_at_touchdown(case, on_lines, nominal),
        slowest=slowest,
        runs={strategy: simulate(strategy, scenario) for strategy in ("off", "held")},
        slow=simulate("held", slow),
    )


def rows(lines: PublishedLines) -> list[Row]:
    """Return the published figures that the lines alone determine, compared with ours."""
    case, clean, off = lines.case, lines.clean, lines.runs["off"]
    paper = {key: figure.value for key, figure in case.published.items()}
    rz, low, high = rz_range(off), min(lines.slowest), max(lines.slowest)
    notes = {
        "lines_common": f"points with omega_z in {list(POOL_RANGE)} rad/s; criterion: a fifth of the published smallest EMD",
        "line_distance": f"criterion: two grid steps; found at {clean.factor:g} times the smallest EMD, which is our choice, where "
        "the paper has 1.1",
        "lines_by_threshold": f"EMD_min {float(clean.emd.min()):.4f}; with few points there are no four lines",
        "rate_at_touchdown_min_lines": f"first sample {first_sample_lead_s(case):.0f} s after the touchdown; with {LEADS_S[0]:g} "
        f"to {LEADS_S[1]:g} s, or the wheel nominal at the touchdown: {low:.4f} to {high:.4f}",
        "rate_at_touchdown_min_scan": f"{len(lines.near_touchdown)} grid points at {clean.factor:g} times the smallest EMD (our "
        "factor)",
        "rz_range_lines": f"{off.sizes['run']} runs, every one reaches {rz.highest_minimum:.2f} or lower; below -0.5 for "
        f"{tally(off)['rz_time_below_-0.5']} of the time",
    }
    row_of = partial(make_row, case, notes=notes, chain="published")

    # section 2.3: one distribution, and the lines that a scan against it gives
    # "one distribution": they differ by at most a fifth of the smallest EMD of the paper's scan
    fifth = paper["emd_min"] / 5
    common: dict[str, Any] = {"tolerance": fifth, "agrees": bool(lines.spread <= fifth)}
    result = [row_of("lines_common", lines.spread, **common)]
    for k, deviation in enumerate(clean.deviation, 1):
        ours = [vector.round(4).tolist() for vector in deviation["line"]]
        note = (
            f"EMD below {clean.factor:g} times the smallest (our factor; the paper's 1.1 leaves a handful of points): angle "
            f"{np.degrees(deviation['angle_rad']):.1f} deg, largest distance {deviation['max']:.4f} rad/s over omega_z in "
            f"{list(LINE_RANGE)}"
        )
        texts: dict[str, Any] = {"id": f"line_L{k}_distance", "published": f"the line L{k}"}
        texts["what"] = f"mean distance of our line from the printed L{k}"
        result.append(row_of("line", ours, id=f"line_L{k}", note=note))
        result.append(row_of("line_distance", deviation["mean"], **texts))
    factor, published = paper["near_minimum_factor"], paper["rate_at_touchdown_min"]
    result.append(row_of("lines_by_threshold", lines.thresholds, published=factor))

    # section 3.2: back at the touchdown
    slowest_of_set = float(np.linalg.norm(lines.near_touchdown, axis=1).min())
    as_stated = lines.slowest[2]  # nominal time of the first sample, wheel nominal at it
    given: dict[str, Any] = {"published": published, "low": low, "high": high}
    result.append(row_of("rate_at_touchdown_min_lines", as_stated, **given))
    result.append(row_of("rate_at_touchdown_min_scan", slowest_of_set, published=published))

    # section 3.3: after the collision
    reached, published = [rz.lowest, rz.highest], list(paper["rz_range_wheel_off"])
    result.append(row_of("rz_range_lines", reached, published=published))
    likelier = "; the likelier reading of what was computed"
    for id, where, speed, runs, remark in (
        ("rz_held_lines", "section 3.3", "collision_speed", lines.runs["held"], ""),
        ("rz_held_slow_collision", "section 4", "landing_speed", lines.slow, likelier),
    ):
        held, lowest = tally(runs), float(np.nanmin(lowest_rz(runs)))
        # share of the runs that fall below -0.5, and of the time spent below -0.2
        ever, time = held["rz_ever_below_-0.5"], held["rz_time_below_-0.2"]
        values, errors = (ever.value, time.value), (ever.error, time.error)
        low, high = interval_90(values, errors)
        agrees = bool(ever.value <= NEVER and time.value <= RARELY)
        given = {"id": id, "agrees": agrees, "low": low, "high": high}
        given["what"] = (
            f"wheel held, collision at {paper[speed]:g} m/s ({where}): runs with r_z below -0.5, time with r_z below -0.2"
        )
        given["note"] = (
            f"criterion: at most {NEVER:.0%} of the runs and {RARELY:.0%} of the time; the time below -0.5 is "
            f"{held['rz_time_below_-0.5']}, the lowest r_z {lowest:.2f}{remark}"
        )
        result.append(row_of("rz_held", list(values), **given))
    return result


def lines_touchdown_figure(lines: PublishedLines) -> Figure:
    """Draw body rates at the first touchdown of the near-minimum set and of the lines (paper, Fig. 12)."""
    figure = empty_figure(6.5, 5.4)
    axes = rate_axes(figure)
    target = "against the printed lines' distribution, run back"
    label = f"EMD < {lines.clean.factor:g} EMD_min {target} ({len(lines.near_touchdown)} motions)"
    dots: dict[str, Any] = {"depthshade": False, "color": COLOURS[0]}
    axes.scatter(*lines.near_touchdown.T, s=6, alpha=0.35, lw=0, label=label, **dots)
    dots["color"] = COLOURS[1]
    axes.scatter(*lines.on_lines_touchdown.T, s=9, label="the paper's lines, run back", **dots)
    axes.scatter(0, 0, 0, marker="+", s=80, color="#000000", label="no rotation")
    smallest = float(np.linalg.norm(lines.on_lines_touchdown, axis=1).min())
    text = rf"smallest $|\omega|$ on the paper's lines {smallest:.4f} rad/s"
    figure.suptitle(f"Rates at the first touchdown; {text}", fontsize=10)
    labels = axes.get_legend_handles_labels()
    figure.legend(*labels, fontsize=9, loc="outside lower center", frameon=False)
    return figure
