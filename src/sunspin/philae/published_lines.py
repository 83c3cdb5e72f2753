"""The paper's four printed lines through our equations: no telemetry is used, and none can change what stands here.

Whether the lines have one distribution of r_z, whether a scan against it finds them again, what they leave of the angular speed
at the touchdown, and what follows for motions on them after the collision (paper, sections 2.3, 3.2, 3.3; Figs. 9, 12, 13).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from sunspin.compute.pool import worker_count
from sunspin.estimate.scan.metrics import emd
from sunspin.estimate.scan.table import Table
from sunspin.landing.outcomes import outcomes
from sunspin.landing.scenario import paper_scenario
from sunspin.landing.tally import lowest_rz, tally
from sunspin.output.figures import COLOURS
from sunspin.philae import rebound as rb
from sunspin.philae.collision import rz_range
from sunspin.philae.level_set import Families, families, rate_axes
from sunspin.philae.row import Row, interval, row
from sunspin.telemetry.case import Case

CHAIN = "published"
LINE_POINTS = 41

POOL_RANGE, POOL_POINTS = (-0.15, 0.3), 16
"""omega_z (rad/s) of the points of each line whose r_z make up the lines' common distribution; how many points."""

FACTOR = 4.0
"""Near-minimum factor against the lines' common distribution: so clean a target has so small a minimum that 1.1 times it
leaves a handful of points. EMD at points of the lines themselves is up to several times the minimum."""

FACTORS = (1.1, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
"""Near-minimum factors of the table that shows what the choice does; `FACTOR` is one of them."""

LEADS_S = (26.0, 86.0)
"""The first sample came 56 s after the touchdown, uncertain by half a minute: "45 min" before the collision."""

RARELY, NEVER = 0.05, 0.01
"""What counts as "rarely": this share of the time; and as "never": this share of the runs, the paper having 400."""


@dataclass(frozen=True)
class PublishedLines:
    """What follows from the printed lines.

    Attributes
    ----------
    pooled : for each line, reconstructible r_z of motions begun on it
    clean : near-minimum set of the scan against their common distribution
    thresholds : for each of `FACTORS` the "factor", "points" of the set, "mean_distance" (rad/s) of each line
    near_touchdown, on_lines_touchdown : (n, 3) rad/s at the touchdown of that set, and of points of the lines
    bounds : (lead s, wheel speed rad/s, smallest angular speed rad/s at the touchdown): first sample early, as stated, late; wheel
        nominal there or at the touchdown
    runs : strategy -> collisions at the speed of section 3.3; `slow`: with the wheel held, at the speed of section 4
    """

    case: Case
    pooled: list[np.ndarray]
    clean: Families
    thresholds: list[dict[str, Any]]
    near_touchdown: np.ndarray
    on_lines_touchdown: np.ndarray
    bounds: list[tuple[float, float, float]]
    runs: dict[str, xr.Dataset]
    slow: dict[str, xr.Dataset]


def pooled_z(case: Case) -> list[np.ndarray]:
    """For each published line, the reconstructible r_z of motions begun at points along it."""
    starts = rb.on_lines(rb.published_lines(case), np.linspace(*POOL_RANGE, POOL_POINTS))
    return [np.concatenate([rb.seen_z(case, omega) for omega in line]) for line in starts]


def pooled_spread(pooled: list[np.ndarray]) -> list[float]:
    """EMD of each line's distribution to the common one."""
    everything = np.concatenate(pooled)
    return [emd(z, everything) for z in pooled]


def compute(
    case: Case,
    table: Table | None = None,
    seed: int = 0,
    coarser: int = 1,
    runs: int = 5000,
    workers: int | None = None,
) -> PublishedLines:
    """Run the lines; `table` of the scan from the published first direction over the published window, if there is one."""
    if table is None:
        table = rb.grid_table(case, rb.first_sun(case), rb.window_s(case), coarser, workers)
    pooled, lines = pooled_z(case), rb.published_lines(case)
    volume = table.volume(np.concatenate(pooled), workers=worker_count(workers))
    sets = {factor: families(case, volume, factor, seed) for factor in FACTORS}
    thresholds = [
        {
            "factor": factor,
            "points": len(near.points),
            "mean_distance": [apart["mean"] for apart in near.deviation],
        }
        for factor, near in sets.items()
    ]
    nominal = rb.nominal_speed(case.vehicle)[0]
    on_lines = rb.on_lines(lines, np.linspace(*rb.LINE_RANGE, LINE_POINTS))
    bounds = [
        (lead, speed, rb.smallest_on_lines(case, lines, speed, lead))
        for lead in (LEADS_S[0], rb.after_touchdown_s(case), LEADS_S[1])
        for speed in (nominal, rb.speed_at_first_sample(case, lead))
    ]
    fast = paper_scenario(case)
    slow = replace(fast, collision_speed_m_s=case.published["landing_speed"].value)
    starts = rb.published_candidates(case)
    options: dict[str, Any] = {"seed": seed, "workers": workers}
    return PublishedLines(
        case,
        pooled,
        sets[FACTOR],
        thresholds,
        rb.at_touchdown(case, sets[FACTOR].points, nominal),
        rb.at_touchdown(case, on_lines, nominal),
        bounds,
        {
            name: outcomes(case.vehicle, starts, name, runs, scenario=fast, **options)
            for name in ("off", "held")
        },
        {"held": outcomes(case.vehicle, starts, "held", runs, scenario=slow, **options)},
    )


def rows(result: PublishedLines) -> list[Row]:
    """Each published figure that the printed lines alone decide, beside ours."""
    every = (*_line_rows(result), *_touchdown_rows(result), *_collision_rows(result))
    return [replace(each, chain=CHAIN) for each in every]


def _line_rows(r: PublishedLines) -> list[Row]:
    case, clean = r.case, r.clean
    spread, fifth = max(pooled_spread(r.pooled)), case.published["emd_min"].value / 5
    agrees, pool = bool(spread <= fifth), list(POOL_RANGE)
    every = [row(case, "lines_common", spread, tolerance=fifth, agrees=agrees, omega_z=pool)]
    for k, apart in enumerate(clean.deviation):
        assert clean.lines is not None
        line, name = clean.lines.isel(line=clean.partner[k]), f"L{k + 1}"
        ours = [line[of].values.round(4).tolist() for of in ("point", "direction")]
        fields: dict[str, Any] = {"factor": clean.factor, "omega_z": list(rb.LINE_RANGE)}
        fields |= {"angle": np.degrees(apart["angle_rad"]), "most": apart["max"]}
        to_line: dict[str, Any] = {"id": f"line_{name}_distance", "line": name}
        every += [
            row(case, "line", ours, id=f"line_{name}", **fields),
            row(case, "line_distance", apart["mean"], factor=clean.factor, **to_line),
        ]
    least, factor = float(clean.emd.min()), case.published["near_minimum_factor"].value
    table = row(case, "lines_by_threshold", r.thresholds, published=factor, smallest=least)
    return [*every, table]


def _touchdown_rows(r: PublishedLines) -> list[Row]:
    published = r.case.published["rate_at_touchdown_min"].value
    speeds = [smallest for _, _, smallest in r.bounds]
    near = float(np.linalg.norm(r.near_touchdown, axis=1).min())
    return [
        row(
            r.case,
            "rate_at_touchdown_min_lines",
            speeds[2],  # as stated, wheel nominal at the first sample
            published=published,
            low=float(min(speeds)),
            high=float(max(speeds)),
            lead=rb.after_touchdown_s(r.case),
            leads=LEADS_S,
        ),
        row(
            r.case,
            "rate_at_touchdown_min_scan",
            near,
            published=published,
            points=len(r.near_touchdown),
            factor=r.clean.factor,
        ),
    ]


def _collision_rows(r: PublishedLines) -> list[Row]:
    case, off = r.case, r.runs["off"]
    low, high, reaches = rz_range(off)
    every = [
        row(
            case,
            "rz_range_lines",
            [low, high],
            published=list(case.published["rz_range_wheel_off"].value),
            runs=off.sizes["run"],
            reaches=reaches,
            off=tally(off),
        )
    ]
    for name, where, speed, runs, says in (
        ("rz_held_lines", "section 3.3", "collision_speed", r.runs, ("note",)),
        ("rz_held_slow_collision", "section 4", "landing_speed", r.slow, ("note", "note_slow")),
    ):
        held = tally(runs["held"])
        shares = [held[key] for key in ("rz_ever_below_-0.5", "rz_time_below_-0.2")]
        never, rarely = (share.value for share in shares)
        bounds = interval([never, rarely], [share.error for share in shares])
        every.append(
            row(
                case,
                "rz_held",
                [never, rarely],
                says=says,
                id=name,
                agrees=bool(never <= NEVER and rarely <= RARELY),
                low=bounds[0],
                high=bounds[1],
                speed=case.published[speed].value,
                where=where,
                never=NEVER,
                rarely=RARELY,
                held=held,
                lowest=float(np.nanmin(lowest_rz(runs["held"]))),
            )
        )
    return every


def thresholds_figure(table: list[dict[str, Any]], chosen: float) -> Figure:
    """Points of the near-minimum set, and distance of its lines from the published ones, against the factor."""
    figure = Figure(figsize=(8, 3.6), layout="constrained")
    figure.suptitle("Near-minimum set of the published lines' distribution", fontsize=10)
    left, right = figure.subplots(1, 2)
    factors, points = zip(
        *((each["factor"], max(each["points"], 1)) for each in table), strict=True
    )
    left.semilogy(factors, points, "o-", color=COLOURS[0])
    left.set_ylabel("points in the set")
    fitted = [each for each in table if each["mean_distance"]]
    for k in range(4):
        distance = [each["mean_distance"][k] for each in fitted]
        style = {"ms": 4, "color": COLOURS[k], "label": f"L{k + 1}"}
        right.plot([each["factor"] for each in fitted], distance, "o-", **style)
    right.set_yscale("log")
    right.set_ylabel("mean distance from the paper's line (rad/s)", fontsize=9)
    right.legend(fontsize=8)
    for axes in (left, right):
        axes.axvline(chosen, lw=0.8, ls="--", color=COLOURS[7])
        axes.set_xlabel("factor on the smallest EMD")
    return figure


def backward_figure(
    rates: np.ndarray, published: np.ndarray, smallest: float, label: str
) -> Figure:
    """Body rates at the first touchdown (paper, Fig. 12); `label` says which set of motions `rates` (n, 3) are."""
    figure = Figure(figsize=(6.5, 5.4), layout="constrained")
    axes = rate_axes(figure)
    label = f"{label} ({len(rates)} motions)"
    dots = {"depthshade": False, "color": COLOURS[0]}
    axes.scatter(*rates.T, s=6, alpha=0.35, lw=0, label=label, **dots)
    dots["color"] = COLOURS[1]
    axes.scatter(*published.T, s=9, label="the paper's lines, run back", **dots)
    axes.scatter(0, 0, 0, marker="+", s=80, color="#000000", label="no rotation")
    figure.suptitle(
        rf"Rates at the first touchdown; smallest $|\omega|$ on the paper's lines {smallest:.4f} rad/s",
        fontsize=10,
    )
    labels = axes.get_legend_handles_labels()
    figure.legend(*labels, fontsize=9, loc="outside lower center", frameon=False)
    return figure
