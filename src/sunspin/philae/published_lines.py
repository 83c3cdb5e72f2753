"""The paper's four printed lines through our equations: no telemetry is used, and none can change what stands here.

Whether the lines have one distribution of r_z, whether a scan against it finds them again, what they leave of the angular speed
at the touchdown, and what follows for motions on them after the collision (paper, sections 2.3, 3.2, 3.3; Figs. 9, 12, 13).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from sunspin.compute.pool import worker_count
from sunspin.estimate.scan.lines import point_at
from sunspin.estimate.scan.table import Table, make_table
from sunspin.landing.outcomes import outcomes
from sunspin.landing.scenario import Scenario, paper_scenario
from sunspin.landing.tally import Estimate, lowest_rz, tally
from sunspin.philae import rebound as rb
from sunspin.philae.collision import rz_range
from sunspin.philae.row import Row, interval, row
from sunspin.telemetry.case import Case

CHAIN = "published"
LINE_POINTS = 41

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
    thresholds : rows of `rebound.by_threshold`
    near_touchdown, on_lines_touchdown : (n, 3) rad/s at the touchdown of that set, and of points of the lines
    bounds : (lead s, wheel speed rad/s, smallest angular speed rad/s at the touchdown), for the leads possible
    runs : strategy -> collisions at the speed of section 3.3; `slow`: with the wheel held, at the speed of section 4
    """

    case: Case
    pooled: list[np.ndarray]
    clean: rb.Families
    thresholds: list[dict[str, Any]]
    near_touchdown: np.ndarray
    on_lines_touchdown: np.ndarray
    bounds: list[tuple[float, float, float]]
    runs: dict[str, xr.Dataset]
    slow: dict[str, xr.Dataset]


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
        table = make_table(
            case.vehicle,
            rb.first_sun(case),
            rb.grid(case, coarser),
            rb.nominal_speed(case.vehicle),
            rb.window_s(case),
            workers=workers,
            mask=None if rb.counted(case) is None else "reconstructible",
        )
    pooled, speed = rb.pooled_z(case), rb.nominal_speed(case.vehicle)[0]
    clean = rb.families(
        case,
        table.volume(np.concatenate(pooled), workers=worker_count(workers)),
        rb.LINES_FACTOR,
        seed,
    )
    omega_z = np.linspace(*rb.LINE_RANGE, LINE_POINTS)
    on_lines = np.concatenate(
        [point_at(point, along, 2, omega_z) for point, along in rb.published_lines(case)]
    )
    fast = paper_scenario(case)
    slow = replace(fast, collision_speed_m_s=case.published["landing_speed"].value)

    def collide(scenario: Scenario, strategy: str) -> xr.Dataset:
        starts = rb.published_candidates(case)
        return outcomes(
            case.vehicle, starts, strategy, runs, seed, scenario=scenario, workers=workers
        )

    return PublishedLines(
        case,
        pooled,
        clean,
        rb.by_threshold(case, clean.emd, seed),
        rb.at_touchdown(case, clean.points, speed),
        rb.at_touchdown(case, on_lines, speed),
        _bounds(case),
        {name: collide(fast, name) for name in ("off", "held")},
        {"held": collide(slow, "held")},
    )


def _bounds(case: Case) -> list[tuple[float, float, float]]:
    """Smallest speed on the lines at the touchdown: first sample early, as stated, late; wheel nominal there or at touchdown."""
    found = []
    for lead in (LEADS_S[0], rb.after_touchdown_s(case), LEADS_S[1]):
        for speed in (rb.nominal_speed(case.vehicle)[0], rb.speed_at_first_sample(case, lead)):
            found.append(
                (lead, speed, rb.smallest_on_lines(case, rb.published_lines(case), speed, lead))
            )
    return found


def rows(result: PublishedLines) -> list[Row]:
    """Each published figure that the printed lines alone decide, beside ours."""
    return [
        replace(one, chain=CHAIN)
        for one in (*_line_rows(result), *_touchdown_rows(result), *_collision_rows(result))
    ]


def _line_rows(r: PublishedLines) -> list[Row]:
    case, clean = r.case, r.clean
    spread, fifth = max(rb.pooled_spread(r.pooled)), case.published["emd_min"].value / 5
    found = [
        row(
            case,
            "lines_common",
            spread,
            tolerance=fifth,
            agrees=bool(spread <= fifth),
            omega_z=list(rb.POOL_RANGE),
        )
    ]
    fitted = [] if clean.lines is None else [clean.lines.isel(line=i) for i in clean.partner]
    for k, (line, deviation) in enumerate(zip(fitted, clean.deviation, strict=True)):
        name = f"L{k + 1}"
        found += [
            row(
                case,
                "line",
                [
                    line["point"].values.round(4).tolist(),
                    line["direction"].values.round(4).tolist(),
                ],
                id=f"line_{name}",
                factor=clean.factor,
                angle=np.degrees(deviation["angle_rad"]),
                most=deviation["max"],
                omega_z=list(rb.LINE_RANGE),
            ),
            row(
                case,
                "line_distance",
                deviation["mean"],
                id=f"line_{name}_distance",
                line=name,
                factor=clean.factor,
            ),
        ]
    factor = case.published["near_minimum_factor"].value
    return [
        *found,
        row(
            case,
            "lines_by_threshold",
            r.thresholds,
            published=factor,
            smallest=float(clean.emd.min()),
        ),
    ]


def _touchdown_rows(r: PublishedLines) -> list[Row]:
    case, published = r.case, r.case.published["rate_at_touchdown_min"].value
    as_stated = r.bounds[2][2]
    least, most = (float(f([bound for _, _, bound in r.bounds])) for f in (np.min, np.max))
    near = float(np.linalg.norm(r.near_touchdown, axis=1).min())
    return [
        row(
            case,
            "rate_at_touchdown_min_lines",
            as_stated,
            published=published,
            low=least,
            high=most,
            lead=rb.after_touchdown_s(case),
            leads=LEADS_S,
        ),
        row(
            case,
            "rate_at_touchdown_min_scan",
            near,
            published=published,
            points=len(r.near_touchdown),
            factor=r.clean.factor,
        ),
    ]


def _collision_rows(r: PublishedLines) -> list[Row]:
    case = r.case
    told = {name: tally(runs) for name, runs in r.runs.items()}
    slow = {name: tally(runs) for name, runs in r.slow.items()}
    low, high, reaches = rz_range(r.runs["off"])
    fast_v, slow_v = case.published["collision_speed"].value, case.published["landing_speed"].value
    lowest = {
        v: float(np.nanmin(lowest_rz(runs["held"])))
        for v, runs in ((fast_v, r.runs), (slow_v, r.slow))
    }

    def held(found: dict[str, Estimate]) -> list[float]:
        return [found["rz_ever_below_-0.5"].value, found["rz_time_below_-0.2"].value]

    def error(found: dict[str, Estimate]) -> list[float]:
        return [found["rz_ever_below_-0.5"].error, found["rz_time_below_-0.2"].error]

    def as_stated(found: dict[str, Estimate]) -> bool:
        never, rarely = held(found)
        return bool(never <= NEVER and rarely <= RARELY)

    kept = []
    for name, where, v, found in (
        ("rz_held_lines", "section 3.3", fast_v, told["held"]),
        ("rz_held_slow_collision", "section 4", slow_v, slow["held"]),
    ):
        bounds = interval(held(found), error(found))
        kept.append(
            row(
                case,
                "rz_held",
                held(found),
                says=("note", "note_slow") if v == slow_v else ("note",),
                id=name,
                agrees=as_stated(found),
                low=bounds[0],
                high=bounds[1],
                speed=v,
                where=where,
                never=NEVER,
                rarely=RARELY,
                held=found,
                lowest=lowest[v],
            )
        )
    whole = list(case.published["rz_range_wheel_off"].value)
    runs = r.runs["off"].sizes["run"]
    return [
        row(
            case,
            "rz_range_lines",
            [low, high],
            published=whole,
            runs=runs,
            reaches=reaches,
            off=told["off"],
        ),
        *kept,
    ]
