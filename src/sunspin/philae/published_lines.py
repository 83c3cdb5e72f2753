"""The paper's four printed lines through our equations: no telemetry is used, and none can change what stands here.

Whether the lines have one distribution of r_z, whether a scan against it finds them again, what they leave of the angular speed
at the touchdown, and what follows for motions on them after the collision (paper, sections 2.3, 3.2, 3.3; Figs. 9, 12, 13).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from sunspin.estimate.scan.lines import point_at
from sunspin.estimate.scan.table import Table, make_table
from sunspin.landing.outcomes import outcomes
from sunspin.landing.scenario import Scenario, paper_scenario
from sunspin.landing.tally import Estimate, lowest_rz, tally
from sunspin.philae import landing
from sunspin.philae import rebound as rb
from sunspin.philae.row import Row, interval, published_row
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
    case: Case, table: Table | None = None, seed: int = 0, coarser: int = 1, runs: int = 5000, workers: int | None = None
) -> PublishedLines:
    """Run the lines; `table` of the scan from the published first direction over the published window, if there is one."""
    if table is None:
        table = make_table(
            case.vehicle, rb.first_sun(case), rb.grid(case, coarser), rb.nominal_speed(case.vehicle), rb.window_s(case),
            workers=workers,
        )  # fmt: skip
    pooled, speed = rb.pooled_z(case), rb.nominal_speed(case.vehicle)[0]
    clean = rb.families(case, table.volume(np.concatenate(pooled)), rb.LINES_FACTOR, seed)
    omega_z = np.linspace(*rb.LINE_RANGE, LINE_POINTS)
    on_lines = np.concatenate([point_at(point, along, 2, omega_z) for point, along in rb.published_lines(case)])
    fast = paper_scenario(case)
    slow = replace(fast, collision_speed_m_s=case.published["landing_speed"].value)

    def collide(scenario: Scenario, strategy: str) -> xr.Dataset:
        starts = rb.published_candidates(case)
        return outcomes(case.vehicle, starts, strategy, runs, seed, scenario=scenario, workers=workers)

    return PublishedLines(
        case, pooled, clean, rb.by_threshold(case, clean.emd, seed), rb.at_touchdown(case, clean.points, speed),
        rb.at_touchdown(case, on_lines, speed), _bounds(case), {name: collide(fast, name) for name in ("off", "held")},
        {"held": collide(slow, "held")},
    )  # fmt: skip


def _bounds(case: Case) -> list[tuple[float, float, float]]:
    """Smallest speed on the lines at the touchdown: first sample early, as stated, late; wheel nominal there or at touchdown."""
    found = []
    for lead in (LEADS_S[0], rb.after_touchdown_s(case), LEADS_S[1]):
        for speed in (rb.nominal_speed(case.vehicle)[0], rb.speed_at_first_sample(case, lead)):
            found.append((lead, speed, rb.smallest_on_lines(case, rb.published_lines(case), speed, lead)))
    return found


def rows(result: PublishedLines) -> list[Row]:
    """Each published figure that the printed lines alone decide, beside ours."""
    return [replace(row, chain=CHAIN) for row in (*_line_rows(result), *_touchdown_rows(result), *_collision_rows(result))]


def _line_rows(r: PublishedLines) -> list[Row]:
    case, clean = r.case, r.clean
    spread, fifth = max(rb.pooled_spread(r.pooled)), case.published["emd_min"].value / 5
    found = [
        Row(
            "lines_common", "largest EMD of a printed line's distribution of r_z to the common one of all four",
            "similar (the lines hold equally good fits)", spread, "1", fifth, bool(spread <= fifth),
            f"points with omega_z in {list(rb.POOL_RANGE)} rad/s; criterion: a fifth of the published smallest EMD",
            "paper, section 2.3, implied by the lines",
        )
    ]  # fmt: skip
    fitted = [] if clean.lines is None else [clean.lines.isel(line=i) for i in clean.partner]
    for k, (line, deviation) in enumerate(zip(fitted, clean.deviation, strict=True)):
        found.append(
            published_row(
                case, f"line_L{k + 1}",
                [line["point"].values.round(4).tolist(), line["direction"].values.round(4).tolist()], None,
                f"from the printed lines' own distribution, EMD below {clean.factor:g} times its minimum (the factor is ours: the "
                "paper's 1.1 leaves a handful of points against so clean a target): angle "
                f"{np.degrees(deviation['angle_rad']):.1f} "
                f"deg, largest distance {deviation['max']:.4f} rad/s over omega_z in {list(rb.LINE_RANGE)}", kind="not_comparable",
            )
        )  # fmt: skip
        found.append(
            Row(
                f"line_L{k + 1}_distance", f"mean distance of our line from the printed L{k + 1}", f"the line L{k + 1}",
                deviation["mean"], "rad/s", 0.03, bool(deviation["mean"] <= 0.03),
                f"criterion: two grid steps; found at {clean.factor:g} times the smallest EMD, which is our choice, where "
                "the paper has 1.1", "paper, section 2.3",
            )
        )  # fmt: skip
    found.append(
        Row(
            "lines_by_threshold", "near-minimum set of the printed lines' distribution against the factor on the minimum",
            case.published["near_minimum_factor"].value, r.thresholds, "1 (factor), rad/s (mean distances from L1..L4)", None,
            None, f"EMD_min {float(clean.emd.min()):.4f}; with few points there are no four lines", "paper, section 2.3, Fig. 9",
            kind="not_comparable",
        )
    )  # fmt: skip
    return found


def _touchdown_rows(r: PublishedLines) -> list[Row]:
    case, published = r.case, r.case.published["rate_at_touchdown_min"].value
    as_stated = r.bounds[2][2]
    least, most = (float(f([bound for _, _, bound in r.bounds])) for f in (np.min, np.max))
    near = float(np.linalg.norm(r.near_touchdown, axis=1).min())
    lead = rb.after_touchdown_s(case)
    return [
        Row(
            "rate_at_touchdown_min_lines", "smallest angular speed just after the first touchdown, motions on the printed lines",
            published, as_stated, "rad/s", 0.01, bool(abs(as_stated - published) <= 0.01),
            f"first sample {lead:.0f} s after the touchdown, wheel at its nominal speed there. The lead is known to half a minute "
            f"({LEADS_S[0]:g} to {LEADS_S[1]:g} s) and the wheel may have been nominal at the touchdown instead: {least:.4f} to "
            f"{most:.4f}, the interval given", "paper, section 3.2, Fig. 12", low=least, high=most,
        ),
        Row(
            "rate_at_touchdown_min_scan", "the same, over the near-minimum set of the printed lines' distribution", published, near,
            "rad/s", 0.01, bool(abs(near - published) <= 0.01),
            f"{len(r.near_touchdown)} grid points at {r.clean.factor:g} times the smallest EMD (our factor)", "paper, section 3.2",
        ),
    ]  # fmt: skip


def _collision_rows(r: PublishedLines) -> list[Row]:
    case = r.case
    told = {name: tally(runs) for name, runs in r.runs.items()}
    slow = {name: tally(runs) for name, runs in r.slow.items()}
    low, high, reaches = landing.rz_range(r.runs["off"])
    fast_v, slow_v = case.published["collision_speed"].value, case.published["landing_speed"].value
    lowest = {v: float(np.nanmin(lowest_rz(runs["held"]))) for v, runs in ((fast_v, r.runs), (slow_v, r.slow))}

    def p(found: dict[str, Estimate], bound: str) -> str:
        return f"{found[f'rz_ever_below_{bound}']} of the runs, {found[f'rz_time_below_{bound}']} of the time"

    def held(found: dict[str, Estimate]) -> list[float]:
        return [found["rz_ever_below_-0.5"].value, found["rz_time_below_-0.2"].value]

    def error(found: dict[str, Estimate]) -> list[float]:
        return [found["rz_ever_below_-0.5"].error, found["rz_time_below_-0.2"].error]

    def as_stated(found: dict[str, Estimate]) -> bool:
        never, rarely = held(found)
        return bool(never <= NEVER and rarely <= RARELY)

    criterion = f"criterion: below -0.5 in at most {NEVER:.0%} of the runs, below -0.2 for at most {RARELY:.0%} of the time"
    kept = []
    for name, v, found in (("rz_held_lines", fast_v, told["held"]), ("rz_held_slow_collision", slow_v, slow["held"])):
        bounds = interval(held(found), error(found))
        where = "section 3.3" if name == "rz_held_lines" else "section 4"
        kept.append(
            Row(
                name, f"wheel held, collision at {v:g} m/s ({where}): runs with r_z below -0.5, time with r_z below -0.2",
                "never below -0.5, rarely below -0.2", held(found), "1", None, as_stated(found),
                f"{criterion}; below -0.5 {p(found, '-0.5')}; below -0.2 {p(found, '-0.2')}; lowest {lowest[v]:.2f}"
                + ("; the likelier reading of what was computed" if name == "rz_held_slow_collision" else ""),
                "paper, section 4, Fig. 13", low=bounds[0], high=bounds[1],
            )
        )  # fmt: skip
    return [
        Row(
            "rz_range_lines", "range that r_z reaches after the collision, wheel off, motions on the printed lines",
            list(case.published["rz_range_wheel_off"].value), [low, high], "1", 0.03,
            bool(max(abs(low + 1), abs(high - 1)) <= 0.03),
            f"{r.runs['off'].sizes['run']} runs; the run that is lowered least still reaches {reaches:.2f}; below -0.5 "
            f"{p(told['off'], '-0.5')}", "paper, section 3.3, Fig. 13",
        ),
        *kept,
    ]  # fmt: skip
