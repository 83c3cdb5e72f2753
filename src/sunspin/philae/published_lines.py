"""The paper's four lines through our equations: no telemetry is used, and none can change what stands here.

Whether the lines have one distribution of r_z, whether a scan against it finds them again, what they leave of the angular speed
at the touchdown, and what follows for motions on them after the collision (paper, sections 2.3, 3.2, 3.3; Figs. 9, 12, 13).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from sunspin.cases import Case
from sunspin.compute.pool import worker_count
from sunspin.estimate.scan.metrics import emd
from sunspin.landing.outcomes import outcomes
from sunspin.landing.scenario import paper_scenario
from sunspin.landing.tally import lowest_rz, tally
from sunspin.output.figures import COLOURS
from sunspin.philae.collision import RARELY, rz_range
from sunspin.philae.metrics import (
    NearMinimum,
    TelemetryScan,
    near_minimum_set,
    rate_axes,
    run_grid,
    simulated_z,
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
from sunspin.philae.row import Row, interval, row

LINE_POINTS = 41
"""Motions on each line that are run back to the touchdown."""

POOL_RANGE, POOL_POINTS = (-0.15, 0.3), 16
"""omega_z (rad/s) of the points of each line whose r_z make up the lines' common distribution; how many points."""

FACTOR = 4.0
"""Near-minimum factor against the lines' common distribution: so clean a target has so small a minimum that 1.1 times it
leaves a handful of points. EMD at points of the lines themselves is up to several times the minimum."""

LEADS_S = (26.0, 86.0)
"""The first sample came 56 s after the touchdown, uncertain by half a minute: "45 min" before the collision."""

NEVER = 0.01
"""What counts as "never": this share of the runs, the paper having 400."""


@dataclass(frozen=True)
class PublishedLines:
    """What follows from the published lines.

    Attributes
    ----------
    pooled : for each line, reconstructible r_z of motions begun on it
    spread : largest EMD of a line's distribution to the common one
    clean : near-minimum set of the scan against their common distribution
    thresholds : for several factors the "factor", "points" of the set, "mean_distance" (rad/s) of each line
    near_touchdown, on_lines_touchdown : (n, 3) rad/s at the touchdown of that set, and of points of the lines
    slowest : smallest angular speeds (rad/s) of the lines at the touchdown: first sample early, as stated and late, each with the
        wheel nominal there and with the wheel nominal at the touchdown
    runs : strategy -> collisions at the speed of section 3.3; `slow`: with the wheel held, at the speed of section 4
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


def compute(case: Case, scan: TelemetryScan | None, runs: int, options: Options) -> PublishedLines:
    """Run the lines; the motions of `scan` are used where they begin as the paper's do, from one direction over one window."""
    first, window, lines = first_sun(case), published_window_s(case), published_lines(case)
    if scan is not None and scan.rebound.begins_as(first, window):
        table = scan.table
    else:
        table = run_grid(case, first, window, options)

    starts = points_on_lines(lines, np.linspace(*POOL_RANGE, POOL_POINTS))
    pooled = [np.concatenate([simulated_z(case, omega) for omega in line]) for line in starts]
    everything = np.concatenate(pooled)
    volume = table.volume(everything, workers=worker_count(options.workers))
    factors = (1.1, 1.5, 2.0, 3.0, FACTOR, 6.0)
    sets = {each: near_minimum_set(case, volume, each, options.seed) for each in factors}
    thresholds = [
        {
            "factor": factor,
            "points": len(near.points),
            "mean_distance": [apart["mean"] for apart in near.deviation],
        }
        for factor, near in sets.items()
    ]

    nominal = nominal_wheel_speeds(case.vehicle)[0]
    on_lines = points_on_lines(lines, np.linspace(*LINE_RANGE, LINE_POINTS))
    slowest = [
        smallest_touchdown_speed(case, speed, lead)
        for lead in (LEADS_S[0], first_sample_lead_s(case), LEADS_S[1])
        for speed in (nominal, wheel_speed_at_first_sample(case, lead))
    ]

    scenario, motions = paper_scenario(case), published_candidates(case)
    slow = replace(scenario, collision_speed_m_s=case.published["landing_speed"].value)

    def collisions(strategy: str, scenario: Any) -> xr.Dataset:
        how: dict[str, Any] = {"scenario": scenario, "workers": options.workers}
        return outcomes(case.vehicle, motions, strategy, runs, options.seed, **how)

    return PublishedLines(
        case,
        pooled,
        max(emd(z, everything) for z in pooled),
        sets[FACTOR],
        thresholds,
        rates_at_touchdown(case, sets[FACTOR].points, nominal),
        rates_at_touchdown(case, on_lines, nominal),
        slowest,
        {strategy: collisions(strategy, scenario) for strategy in ("off", "held")},
        collisions("held", slow),
    )


def rows(r: PublishedLines) -> list[Row]:
    """Each published figure that the lines alone decide, compared with ours."""
    case, clean, off = r.case, r.clean, r.runs["off"]
    paper = {key: figure.value for key, figure in case.published.items()}
    texts: dict[str, Any] = {"chain": "published", "factor": clean.factor, "leads": LEADS_S}

    # section 2.3: one distribution, and the lines that a scan against it gives
    fifth, pool = paper["emd_min"] / 5, list(POOL_RANGE)
    given: dict[str, Any] = {"tolerance": fifth, "omega_z": pool, "agrees": bool(r.spread <= fifth)}
    every = [row(case, "lines_common", r.spread, **texts, **given)]
    for k, apart in enumerate(clean.deviation, 1):
        ours = [vector.round(4).tolist() for vector in apart["line"]]
        angle, over = np.degrees(apart["angle_rad"]), list(LINE_RANGE)
        given = {"angle": angle, "most": apart["max"], "line": f"L{k}", "omega_z": over}
        every += [
            row(case, "line", ours, id=f"line_L{k}", **texts, **given),
            row(case, "line_distance", apart["mean"], id=f"line_L{k}_distance", **texts, **given),
        ]
    given = {"published": paper["near_minimum_factor"], "smallest": float(clean.emd.min())}
    every.append(row(case, "lines_by_threshold", r.thresholds, **texts, **given))

    # section 3.2: back at the touchdown
    given = {"published": paper["rate_at_touchdown_min"], "points": len(r.near_touchdown)}
    near = float(np.linalg.norm(r.near_touchdown, axis=1).min())
    ends = {"low": min(r.slowest), "high": max(r.slowest), "lead": first_sample_lead_s(case)}
    as_stated = r.slowest[2]  # wheel nominal at the first sample
    every.append(row(case, "rate_at_touchdown_min_lines", as_stated, **texts, **given, **ends))
    every.append(row(case, "rate_at_touchdown_min_scan", near, **texts, **given))

    # section 3.3: after the collision
    low, high, reaches = rz_range(off)
    given = {"published": list(paper["rz_range_wheel_off"]), "runs": off.sizes["run"]}
    given |= {"reaches": reaches, "off": tally(off)}
    every.append(row(case, "rz_range_lines", [low, high], **texts, **given))
    for id, where, speed, runs, says in (
        ("rz_held_lines", "section 3.3", "collision_speed", r.runs["held"], ("note",)),
        ("rz_held_slow_collision", "section 4", "landing_speed", r.slow, ("note", "note_slow")),
    ):
        held, lowest = tally(runs), float(np.nanmin(lowest_rz(runs)))
        ever, time = held["rz_ever_below_-0.5"], held["rz_time_below_-0.2"]
        ours, errors = zip(ever, time, strict=True)
        low, high = interval(ours, errors)
        agrees = bool(ever.value <= NEVER and time.value <= RARELY)
        given = {"id": id, "says": says, "agrees": agrees, "low": low, "high": high}
        given |= {"speed": paper[speed], "where": where, "lowest": lowest, "held": held}
        given |= {"never": NEVER, "rarely": RARELY}
        every.append(row(case, "rz_held", list(ours), **texts, **given))
    return every


def touchdown_figure(r: PublishedLines) -> Figure:
    """Body rates at the first touchdown, of the near-minimum set and of the lines (paper, Fig. 12)."""
    figure = Figure(figsize=(6.5, 5.4), layout="constrained")
    axes = rate_axes(figure)
    target = f"EMD < {r.clean.factor:g} EMD_min against the printed lines' distribution, run back"
    label = f"{target} ({len(r.near_touchdown)} motions)"
    dots: dict[str, Any] = {"depthshade": False, "color": COLOURS[0]}
    axes.scatter(*r.near_touchdown.T, s=6, alpha=0.35, lw=0, label=label, **dots)
    dots["color"] = COLOURS[1]
    axes.scatter(*r.on_lines_touchdown.T, s=9, label="the paper's lines, run back", **dots)
    axes.scatter(0, 0, 0, marker="+", s=80, color="#000000", label="no rotation")
    smallest = float(np.linalg.norm(r.on_lines_touchdown, axis=1).min())
    text = rf"smallest $|\omega|$ on the paper's lines {smallest:.4f} rad/s"
    figure.suptitle(f"Rates at the first touchdown; {text}", fontsize=10)
    labels = axes.get_legend_handles_labels()
    figure.legend(*labels, fontsize=9, loc="outside lower center", frameon=False)
    return figure
