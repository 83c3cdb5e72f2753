"""Coverage of the paper's method: it is repeated on simulated rebounds whose rates are known.

Run `python -m studies.coverage OUT`.

The direction at the first sample is the published one; sample times, noise and panel misalignments are drawn as for the synthetic
telemetry of the case. Each rebound is scanned on the paper's grid. OUT keeps a file for each rebound, so that the same command
resumes where it stopped, and holds the table and the picture.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from scipy.stats import binomtest

from sunspin.cases import Case, load_case
from sunspin.dynamics.batch import Outcome
from sunspin.dynamics.propagate import propagate
from sunspin.estimate.scan.volume import Histograms
from sunspin.output.figures import COLOURS
from sunspin.philae.data_check import LEAST_DIRECTIONS
from sunspin.philae.metrics import make_near_minimum_set, propagate_grid
from sunspin.philae.rebound import (
    LINE_RANGE,
    Options,
    first_sample_lead_s,
    first_sun,
    nominal_wheel_speeds,
    points_on_lines,
    propagate_back,
    published_lines,
    published_window_s,
    scan_limits,
    start_states,
)
from sunspin.philae.simulation import (
    PhaseSamples,
    add_rebound_noise,
    draw_misaligned_panels,
    draw_rebound_times,
)
from sunspin.philae.threshold import CONFIDENCE, emd_of_truths, quantile_threshold, threshold_index
from sunspin.telemetry.sun import is_reconstructed, sun_directions
from sunspin.telemetry.synthetic import generator
from validation.campaign import command, load_or_make, rows_folder, study_parser

FACTOR = 1.1
"""Factor of the near-minimum set (paper, eq. 14)."""

FACTORS = np.round(np.geomspace(1.05, 12.0, 80), 4)
"""Factors on the smallest EMD for which the size of the set and its smallest speed are kept."""

KINDS = {"lines": "truth on the published lines", "grid": "truth anywhere in the scanned box"}
"""Distributions of the true rates: omega_z even over `rebound.LINE_RANGE` on a published line, or even over the scan range."""


class Grid(NamedTuple):
    """Scan that all rebounds share, and the speed (n) in rad/s of each of its motions at the touchdown."""

    case: Case
    table: Histograms
    speed: np.ndarray


def make_grid(case: Case, coarser: int) -> Grid:
    """Return the scan of every motion of the grid, each propagated once, with its speed at the touchdown.

    `coarser`: only every n-th point of the paper's grid is used.
    """
    table = propagate_grid(
        case, first_sun(case), published_window_s(case), Options(coarser=coarser)
    )
    starts = table.rows.start.take(np.arange(len(table.hist)))
    touchdown_B = propagate_back(case, starts, first_sample_lead_s(case))
    return Grid(case, table, np.linalg.norm(touchdown_B, axis=1))


def simulate_rebound(grid: Grid, kind: str, number: int, seed: int) -> dict[str, Any]:
    """Simulate a rebound of this kind, scan it, and return what the method concludes, with the true values.

    Rebounds with fewer than `LEAST_DIRECTIONS` measured directions are drawn again. Speeds are in rad/s at the touchdown:
    `bound_set` is the smallest in the near-minimum set, `factor_speed` that in the set of each of `FACTORS`, and `factor_count` the
    number of motions in it. `line_angle`: angles (rad) of the fitted lines to the published ones, NaN if no four lines are fitted.
    """
    rng = generator(seed, number)
    case, z = grid.case, np.array([])
    while z.size < LEAST_DIRECTIONS:
        truth = draw_true_rate(case, kind, rng)
        z = simulate_measured_z(case, truth, rng)
    volume = grid.table.volume(z)
    emd = np.where(grid.table.outcome == Outcome.FINE, volume.values.ravel(), np.inf)
    smallest = float(emd.min())
    # motions by increasing EMD: a set holds the first ones, `count` of them
    order = np.argsort(emd, kind="stable")
    slowest = np.minimum.accumulate(grid.speed[order])
    count = np.searchsorted(emd[order], FACTORS * smallest, side="left")
    state = start_states(case, truth, first_sun(case))
    touchdown_B = propagate_back(case, state, first_sample_lead_s(case))
    near = make_near_minimum_set(case, volume, FACTOR, seed=0)
    angles = [float("nan")] * 4  # too few points for four lines
    if near.lines is not None:
        angles = [apart["angle_rad"] for apart in near.deviation]
    return {
        "truth_touchdown_speed": float(np.linalg.norm(touchdown_B)),
        "emd_min": smallest,
        "emd_truth": float(emd_of_truths(case, state, published_window_s(case), [(z, None)])[0]),
        "bound_set": float(grid.speed[emd < FACTOR * smallest].min()),
        "line_angle": angles,
        "factor_count": count.tolist(),
        "factor_speed": slowest[count - 1].tolist(),
    }


def draw_true_rate(case: Case, kind: str, rng: np.random.Generator) -> np.ndarray:
    """Draw a true rate (3) in rad/s at the first sample."""
    if kind == "grid":
        return rng.uniform(*scan_limits(case).T)
    published = published_lines(case)
    line = published[int(rng.integers(len(published)))]
    return points_on_lines([line], [rng.uniform(*LINE_RANGE)])[0, 0]


def simulate_measured_z(case: Case, truth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the r_z (n) that the panels of a simulated motion measure: its reconstructed directions, with noise.

    `truth`: rates (3) in rad/s at the first sample. Misaligned panels make the readings, which are read as those of the drawn ones.
    """
    vehicle = case.vehicle
    t = draw_rebound_times(case, rng)
    tilt, first = draw_misaligned_panels(vehicle, first_sun(case), rng)
    run = propagate(vehicle, truth, first, nominal_wheel_speeds(vehicle), t - t[0], rtol=1e-9)
    samples = PhaseSamples("first_rebound", t, run["sun_B"].values)
    power = add_rebound_noise(vehicle, samples, tilt, None, rng)
    sun = sun_directions(vehicle, power)
    return sun["sun_B"].values[is_reconstructed(sun["status"]), 2]


def collect_values(rebounds: list[dict[str, Any]]) -> dict[str, np.ndarray]:
    """Return the values of all rebounds of a kind by name; "ratio" is the EMD of the true motion over the smallest of the scan."""
    values = {name: np.array([row[name] for row in rebounds]) for name in rebounds[0]}
    return values | {"ratio": values["emd_truth"] / values["emd_min"]}


def format_share(holds: np.ndarray) -> str:
    """Return the share of rebounds (n) for which something `holds` as text, with the 95 % interval (Wilson's)."""
    test = binomtest(int(holds.sum()), holds.size)
    interval = test.proportion_ci(method="wilson")
    return f"{test.statistic:.1%} ({interval.low:.1%} to {interval.high:.1%})"


def table(rebounds: dict[str, dict[str, np.ndarray]], motions: int) -> str:
    """Return the results in Markdown, a line for each kind of truth; `motions` is the number of grid points."""
    limit = f"{FACTOR:g} EMD_min"
    text = (
        f"| | rebounds | truth below {limit} | speed bound of the set below {limit} holds | factor of the 90 % set "
        "| truth in the 90 % set | its share of the box | its smallest speed, rad/s | median angle of each line, deg |\n"
        + "|---"
        * 9
    )
    for kind, values in rebounds.items():
        factor, low, high = quantile_threshold(values["ratio"], CONFIDENCE)
        # calibrated on every second rebound and judged by the others
        half_threshold = quantile_threshold(values["ratio"][::2], CONFIDENCE).value
        k = min(int(np.searchsorted(FACTORS, factor)), len(FACTORS) - 1)  # the next larger factor
        size = np.median(values["factor_count"][:, k]) / motions
        speed = np.quantile(values["factor_speed"][:, k], 0.5, method="higher")
        fitted = values["line_angle"][np.isfinite(values["line_angle"][:, 0])]
        angles = np.degrees(np.median(fitted, axis=0)) if len(fitted) else []
        text += (
            f"|\n| {KINDS[kind]} | {len(values['ratio'])} | {format_share(values['ratio'] < FACTOR)} "
            f"| {format_share(values['bound_set'] <= values['truth_touchdown_speed'])} | {factor:.2f} ({low:.2f} to {high:.2f}) "
            f"| {format_share(values['ratio'][1::2] < half_threshold)} | {size:.0%} | {speed:.3f} "
            f"| {', '.join(f'{angle:.0f}' for angle in angles) or 'none fitted'} "
        )
    return text + "|"


def coverage_figure(rebounds: dict[str, dict[str, np.ndarray]]) -> Figure:
    """Draw the EMD of the truth against the smallest, how often a set contains the truth, and the angles of the fitted lines."""
    figure = Figure(figsize=(13.0, 4.4), layout="constrained")
    scatter, coverage, line_angles = figure.subplots(1, 3)
    factors = np.geomspace(1.0, 10.0, 200)
    for k, (kind, values) in enumerate(rebounds.items()):
        style = {"color": COLOURS[k], "label": KINDS[kind]}
        scatter.loglog(
            values["emd_min"], values["emd_truth"], "o^"[k], ms=3.5, mfc="none", mew=0.7, **style
        )
        share = (values["ratio"][:, None] < factors).mean(axis=0)
        coverage.semilogx(factors, share, ("-", "--")[k], **style)
    ends = np.array(scatter.get_xlim())
    limit = {"ls": "--", "lw": 1, "color": COLOURS[6], "label": f"{FACTOR:g} times the smallest"}
    scatter.loglog(ends, FACTOR * ends, **limit)
    scatter.set(xlim=ends, xlabel="smallest EMD of the scan", ylabel="EMD of the true motion")
    for axis in (scatter.xaxis, scatter.yaxis):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
    coverage.axvline(FACTOR, **limit)
    coverage.axhline(CONFIDENCE, ls=":", lw=1, color=COLOURS[7])
    coverage.set_xticks([1, 1.5, 2, 3, 5, 10], ["1", "1.5", "2", "3", "5", "10"])
    coverage.minorticks_off()
    coverage.set(
        xlabel="factor on the smallest EMD", ylabel="share of rebounds with the truth in the set"
    )
    bins = np.linspace(0, 90, 31)
    for k, angle in enumerate(rebounds["lines"]["line_angle"].T):
        known = np.degrees(angle[np.isfinite(angle)])
        line_angles.hist(known, bins, histtype="step", lw=1.3, color=COLOURS[k], label=f"L{k + 1}")
    line_angles.set(
        xlabel="angle between fitted and published line (deg)", ylabel="rebounds per 3 deg"
    )
    for axes in (scatter, coverage, line_angles):
        axes.legend(fontsize=8)
    figure.suptitle(
        f"The paper's method on {len(rebounds['lines']['ratio'])} synthetic rebounds of each kind"
    )
    return figure


@command
def main(arguments: list[str] | None = None) -> None:
    """Run the study and write its table and figure."""
    parser = study_parser("coverage", __doc__)
    parser.add_argument("out", type=Path, help="folder of the results")
    parser.add_argument("--twins", type=int, default=300, help="simulated rebounds of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--coarser", type=int, default=1, help="every n-th point of the grid only")
    options = parser.parse_args(arguments)
    threshold_index(options.twins // 2, CONFIDENCE)  # refuses too few rebounds before any is made
    grid, values = make_grid(load_case("philae"), options.coarser), {}
    for kind in KINDS:
        folder = rows_folder(options.out / f"{kind}-seed{options.seed}-coarser{options.coarser}")
        rebounds = [
            load_or_make(
                folder / f"{k}.json", partial(simulate_rebound, grid, kind, k, options.seed)
            )
            for k in range(options.twins)
        ]
        values[kind] = collect_values(rebounds)
    text = table(values, len(grid.speed))
    (options.out / "coverage.md").write_text(text + "\n", "utf-8")
    coverage_figure(values).savefig(options.out / "coverage.png", dpi=150)
    print(text)


if __name__ == "__main__":
    sys.exit(main())
