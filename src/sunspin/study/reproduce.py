"""The paper, computed: every result of the reconstruction as data, and a row for each published figure beside ours.

The rows of what follows the collision, of the descent's cubic and of the sensitivity of E are not computed here yet; a
figure that is not computed has no row, so that none passes unseen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from sunspin.cases import Case
from sunspin.infer.lines import point_at
from sunspin.infer.metrics import emd
from sunspin.measure.health import panel_health
from sunspin.measure.sun import is_reconstructed, sun_directions
from sunspin.motion.friction import fit_spin_down, spin_down_curve, spin_down_speed, spin_down_time
from sunspin.motion.propagate import propagate
from sunspin.study import rebound as rb
from sunspin.study.row import Row, published_row

SHADOWED_PHASES = ("deployment", "settling", "rest")
"""Phases whose samples the paper leaves out of its statistics of Delta."""


@dataclass(frozen=True)
class Reproduction:
    """All results of the Philae study."""

    case: Case
    seed: int
    sun: xr.Dataset
    rebound: xr.Dataset
    examples: list[xr.Dataset]
    spin_down: dict[str, Any]
    pooled: list[np.ndarray]
    twin: rb.Families
    clean: rb.Families
    touchdown_B: np.ndarray
    published_touchdown_B: np.ndarray
    truth: dict[str, Any]
    thresholds: list[dict[str, Any]]
    rows: list[Row]

    @property
    def synthetic(self) -> bool:
        return bool(self.sun.attrs.get("synthetic"))


def compute(case: Case, *, seed: int = 0, coarser: int = 1, workers: int | None = None, progress: bool = False) -> Reproduction:
    """Run the whole chain on the case's telemetry.

    Parameters
    ----------
    case : Case
        With the telemetry to use (`rebound.with_telemetry` to put another file in its place).
    seed : int
        Of the random choices of the line fit.
    coarser : int
        Use every `coarser`-th grid point of the scans; 1 is the paper's grid.
    """
    sun = sun_directions(case.vehicle, case.telemetry)
    rebound = rb.rebound_samples(case, sun)
    measured_z = rebound["sun_B"].values[is_reconstructed(rebound["status"]), 2]
    pooled = rb.pooled_z(case)
    clean = rb.families(
        case, rb.scan_against(case, np.concatenate(pooled), coarser, workers, progress), rb.LINES_FACTOR, seed
    )
    factor = case.published["near_minimum_factor"].value
    twin = rb.families(case, rb.scan_against(case, measured_z, coarser, workers, progress), factor, seed)
    speed = rb.nominal_speed(case.vehicle)[0]
    omega_z = np.linspace(*rb.LINE_RANGE, 41)
    on_lines = np.concatenate([point_at(point, direction, 2, omega_z) for point, direction in rb.published_lines(case)])
    partial = {
        "case": case,
        "seed": seed,
        "sun": sun,
        "rebound": rebound,
        "examples": examples(case),
        "spin_down": spin_down(case),
        "pooled": pooled,
        "twin": twin,
        "clean": clean,
        "touchdown_B": rb.at_touchdown(case, clean.points, speed),
        "published_touchdown_B": rb.at_touchdown(case, on_lines, speed),
        "truth": truth_emd(case, measured_z),
        "thresholds": rb.by_threshold(case, clean.emd, seed),
    }
    return Reproduction(**partial, rows=rows(partial))


def examples(case: Case) -> list[xr.Dataset]:
    """The example trajectories of Figs. 6 and 7."""
    t = np.arange(0.0, 60.0 * case.published["example_duration"].value + 0.5, 1.0)
    return [
        propagate(case.vehicle, omega, rb.first_sun(case), rb.nominal_speed(case.vehicle), t)
        for omega in case.published["example_rates"].value
    ]


def spin_down(case: Case) -> dict[str, Any]:
    """Fig. 5: the wheel on a body that stays at rest, with the fitted and with the printed friction; the fit recovered."""
    wheel = case.vehicle.wheels[0]
    printed = case.vehicle.with_friction("printed").wheels[0].friction
    c1, c2, c3 = case.published["spin_down_coefficients"].value
    t = np.linspace(0.0, 0.999 * np.log(-c3 / c1) / c2, 200)  # up to just before the stop
    record = spin_down_curve(t, c1, c2, c3)
    fit = fit_spin_down(t, record, wheel.inertia_kg_m2)
    return {
        "t_s": t,
        "record": record,
        "fit": fit,
        "printed": spin_down_speed(printed, wheel.inertia_kg_m2, record[0], t),
        "stop_printed_s": spin_down_time(printed, wheel.inertia_kg_m2, wheel.speed_rad_s),
    }


def truth_emd(case: Case, measured_z: np.ndarray) -> dict[str, Any]:
    """For a twin: its true rate at the first sample after touchdown and the EMD that the truth itself reaches."""
    truth = rb.twin_truth(case)
    if truth is None:
        return {}
    return {"omega_B": truth, "emd": emd(rb.seen_z(case, truth), measured_z)}


def rows(r: dict[str, Any]) -> list[Row]:
    """The published figures beside ours."""
    return [*_measure_rows(r), *_motion_rows(r), *_scan_rows(r), *_touchdown_rows(r), *_health_rows(r)]


def _measure_rows(r: dict[str, Any]) -> list[Row]:
    case, sun = r["case"], r["sun"]
    kept = is_reconstructed(sun["status"])
    if "phase" in sun.coords:
        kept &= ~np.isin(sun["phase"].values, SHADOWED_PHASES)
    delta = sun["delta"].values[kept]
    twin = "the telemetry is synthetic: its noise was chosen for this figure" if sun.attrs.get("synthetic") else ""
    return [
        published_row(case, "delta_mean", float(delta.mean()), 0.005, twin),
        published_row(case, "delta_max", float(delta.max()), 0.03, twin),
    ]


def _motion_rows(r: dict[str, Any]) -> list[Row]:
    case, fall = r["case"], r["spin_down"]
    still = r["examples"][0]
    stop = [float(t) for t in still["event_time_s"].values]
    z = still["sun_B"].values[:, 2]
    fit = fall["fit"]
    return [
        published_row(
            case, "spin_down_coefficients", [fit.c1_rad_s, fit.c2_per_s, fit.c3_rad_s], [0.1, 1e-8, 0.1],
            "fitted to a record made from the published coefficients: the measured one is not public",
        ),
        published_row(case, "friction_coulomb", fit.friction.coulomb_N_m, 1e-4, "not rounded; it follows from c2 c3 J"),
        published_row(case, "friction_viscous", fit.friction.viscous_N_m_s, 2e-8, "J = 0.0058; the printed value implies 0.005775"),
        published_row(
            case, "wheel_stop", stop[0] / 60 if stop else None, 0.5,
            f"with the printed, rounded friction {fall['stop_printed_s'] / 60:.1f} min",
        ),
        Row(
            "example_still_z", "omega = 0: range of r_z over 46 min (published: constant)", [0.7986, 0.7986],
            [float(z.min()), float(z.max())], "1", 0.01, bool(np.ptp(z) < 0.01),
            "Philae is not quite axisymmetric, so it is nearly constant", "paper, section 2.2, Fig. 6 A",
        ),
    ]  # fmt: skip


def _scan_rows(r: dict[str, Any]) -> list[Row]:
    case, twin, clean, truth = r["case"], r["twin"], r["clean"], r["truth"]
    smallest, spread = float(twin.emd.min()), max(rb.pooled_spread(r["pooled"]))
    note = f"{len(twin.points)} grid points below {twin.factor} times the smallest"
    if truth:
        note += f"; the truth of the twin reaches {truth['emd']:.4f}"
    found = [
        published_row(case, "emd_min", smallest, None, f"of this telemetry, not of the flown one; {note}"),
        Row(
            "scan_runs", "initial conditions scanned", rb.grid_size(case), int(twin.emd.size), "1", 0,
            bool(twin.emd.size == rb.grid_size(case)),
            "101 x 101 x 41 grid points", "paper, section 2.3, from range and step",
        ),
        Row(
            "lines_common", "the four published lines give one distribution of r_z: largest EMD of a line to the common one",
            0.0, spread, "1", 0.0064, bool(spread <= 0.0064),
            f"points with omega_z in {list(rb.POOL_RANGE)} rad/s", "paper, section 2.3, implied by the lines",
        ),
    ]  # fmt: skip
    for k, deviation in enumerate(clean.deviation):
        line = clean.lines.isel(line=clean.partner[k])
        found.append(
            published_row(
                case, f"line_L{k + 1}",
                [line["point"].values.round(4).tolist(), line["direction"].values.round(4).tolist()], None,
                f"from the published lines' own distribution, EMD below {clean.factor:g} times its minimum: angle "
                f"{np.degrees(deviation['angle_rad']):.1f} deg, mean distance {deviation['mean']:.4f} rad/s, largest "
                f"{deviation['max']:.4f} rad/s over omega_z in {list(rb.LINE_RANGE)}",
            )
        )  # fmt: skip
        found.append(
            Row(
                f"line_L{k + 1}_distance", f"mean distance of our line from L{k + 1}", 0.0, deviation["mean"], "rad/s", 0.03,
                bool(deviation["mean"] <= 0.03), "two grid steps", "paper, section 2.3",
            )
        )  # fmt: skip
    found.append(
        Row(
            "lines_by_threshold", "near-minimum set of the published lines' distribution against the factor on the minimum",
            case.published["near_minimum_factor"].value, r["thresholds"], "1 (factor), rad/s (mean distances from L1..L4)", None,
            None, f"EMD_min {float(clean.emd.min()):.4f}; with few points there are no four lines", "paper, section 2.3, Fig. 9",
        )
    )  # fmt: skip
    return found


def _touchdown_rows(r: dict[str, Any]) -> list[Row]:
    case = r["case"]
    nominal, coasted = rb.nominal_speed(case.vehicle)[0], rb.speed_at_first_sample(case)
    lines = rb.published_lines(case)
    as_published = rb.smallest_on_lines(case, lines, nominal)
    as_coasted = rb.smallest_on_lines(case, lines, coasted)
    ours = float(np.linalg.norm(r["touchdown_B"], axis=1).min())
    return [
        published_row(
            case, "rate_at_touchdown_min", as_published, 0.01,
            f"on the published lines, wheel at {nominal:g} rad/s at the first sample; at {coasted:.0f} rad/s there (865 at "
            f"touchdown) {as_coasted:.4f}",
        ),
        Row(
            "rate_at_touchdown_min_scan", "the same, over the near-minimum set of the published lines' distribution",
            case.published["rate_at_touchdown_min"].value, ours, "rad/s", 0.01,
            bool(abs(ours - case.published["rate_at_touchdown_min"].value) <= 0.01),
            f"{len(r['clean'].points)} grid points, run back with the wheel at {nominal:g} rad/s at the first sample",
            "paper, section 3.2",
        ),
    ]  # fmt: skip


def _health_rows(r: dict[str, Any]) -> list[Row]:
    case, sun = r["case"], r["sun"]
    health = panel_health(case.vehicle, sun)
    published = {frozenset(map(str, pattern)) for pattern in case.published["lit_patterns_at_rest"].value}
    ours = {frozenset(pattern) for pattern in health["impossible"]}
    note = "synthetic telemetry, made with panel 1 in shadow at rest" if sun.attrs.get("synthetic") else ""
    explained = [list(panels) for panels in health["explanations"]]
    return [
        Row(
            "lit_patterns_at_rest", case.published["lit_patterns_at_rest"].what, sorted(map(sorted, published)),
            sorted(map(sorted, ours)), "1", 0, bool(published <= ours), note, "paper, section 4",
        ),
        Row(
            "shadowed_panel", case.published["shadowed_panel"].what, [["1"]], explained, "1", 0,
            bool(explained == [["1"]]), note, "paper, section 4",
        ),
    ]  # fmt: skip
