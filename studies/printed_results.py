"""What the paper's printed results alone say of Philae's motion: approximate Bayesian computation with simulated rebounds.

Run `python -m studies.printed_results OUT`.

The true rate at the first sample is even over the paper's scanned box. Rebounds are simulated as for `studies.coverage` and scanned
on the paper's grid. Accepted are those with the smallest EMD that the paper prints, and with its four lines, within a tolerance.
Their true motions are a sample of the motion, given the publication.

Few motions are accepted. So a share of the rates is drawn where the motion's own r_z distribution is near that of the published
lines, and each draw has the weight prior over proposal. OUT keeps the draws, so that the same command resumes where it stopped.
With a larger number of draws it adds the missing ones. OUT also holds the table (CSV and text) and the picture.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from tqdm import tqdm

from sunspin.cases import Case, load_case
from sunspin.compute.pool import worker_count
from sunspin.dynamics.batch import Outcome, Rows, run
from sunspin.estimate.scan.histogram import distances_to_target, target_segments
from sunspin.estimate.scan.metrics import emd
from sunspin.estimate.scan.volume import Histograms
from sunspin.landing.tally import Estimate, effective_runs, estimate, probability
from sunspin.output.figures import COLOURS
from sunspin.philae.data_check import LEAST_DIRECTIONS
from sunspin.philae.metrics import make_near_minimum_set, propagate_grid
from sunspin.philae.rebound import (
    Options,
    distances_from_lines,
    first_sample_lead_s,
    first_sun,
    momentum_angles,
    nominal_wheel_speeds,
    propagate_back,
    published_candidates,
    published_window_s,
    scan_grid,
    scan_limits,
    start_states,
)
from sunspin.philae.simulation import (
    PhaseSamples,
    add_rebound_noise,
    draw_misaligned_panels,
    draw_rebound_times,
)
from sunspin.philae.telemetry import common_distribution
from sunspin.telemetry.sun import is_reconstructed, sun_directions
from sunspin.telemetry.synthetic import generator
from validation.campaign import command, load_or_make, rows_folder, study_parser


class Tolerance(NamedTuple):
    """Largest differences from what the paper prints: of the smallest EMD, and mean distance in rad/s of each fitted line."""

    emd_min: float
    line_rad_s: float


TOLERANCES = {
    "wide": Tolerance(0.004, 0.12),
    "medium": Tolerance(0.004, 0.06),
    "strict": Tolerance(0.002, 0.02),
}
"""The strict tolerance is that of the case's own telemetry (`telemetry.Criteria`). The screens are made for the wide one."""

EVEN_SHARE = 0.5
"""Share of the rates that is drawn evenly over the box; no weight exceeds its inverse."""

NEAR_EMD = 0.025
"""Scale (EMD) of the other share. Its density falls as exp(-(d / NEAR_EMD)^2 / 2), where d is the EMD of a motion's own r_z
distribution to the common one of the published lines.
"""

COMMON_EMD = (0.024, 0.1)
"""EMD of measured r_z to the common distribution with which a draw passes the first screen.

Below the lower limit the smallest EMD of the scan is too small, as grid points show the common distribution to 0.003. With an upper
limit of 0.06 a draw that would have been accepted was rejected.
"""

TUBE_RAD_S = 0.12
"""Radius in rad/s of the tubes about the published lines: the wide tolerance. Each must hold motions of the set."""

SUBSET, LEAST_IN_TUBES = 16, 0.3
"""Every n-th motion of the grid makes the third screen. This share of its near-minimum set, at least, must lie in the tubes."""

DIRECTION_ERROR = 1e-4
"""Largest error of a simulated direction in rad: 1 % of the noise."""

UNSCREENED = 100
"""Every n-th draw is scanned without the screens, to count the accepted draws that they would reject."""

BLOCK = 100
"""Number of draws in a file."""

ON_LINE_RAD_S = 0.03
"""Largest distance in rad/s from a published line at which a true rate counts as on it: two steps of the paper's grid."""

LEAST_ACCEPTED = 5
"""Least number of accepted draws from which means and quantiles are given."""

RESAMPLED = 200
"""Number of bootstrap samples for the errors of quantiles."""

QUANTITIES = {
    "speed": ("angular speed just after the touchdown", "rad/s"),
    "smaller": ("smaller angle of the angular momentum", "deg"),
    "larger": ("larger angle of the angular momentum", "deg"),
}
"""Meaning and unit of each quantity. The angles are those to the z axis and to the Sun, at the first sample."""

QUANTILES = (0.05, 0.5, 0.95)


class Proposal(NamedTuple):
    """Distribution from which true rates are drawn: an even share, and one with a constant density in each cell of the grid.

    `edges`: limits of the cells in rad/s along each axis. `relative` (n): density of the second share over the even one.
    `cumulative` (n): its cumulative probability.
    """

    edges: list[np.ndarray]
    relative: np.ndarray
    cumulative: np.ndarray

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of cells along each axis."""
        return tuple(len(edges) - 1 for edges in self.edges)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """Draw a rate (3) in rad/s."""
        low, high = np.array([[edges[0], edges[-1]] for edges in self.edges]).T
        share, cell = rng.uniform(size=2)
        if share >= EVEN_SHARE:
            flat = min(int(np.searchsorted(self.cumulative, cell, "right")), self.relative.size - 1)
            index = np.unravel_index(flat, self.shape)
            low = np.array([edges[i] for edges, i in zip(self.edges, index, strict=True)])
            high = np.array([edges[i + 1] for edges, i in zip(self.edges, index, strict=True)])
        return rng.uniform(low, high)

    def weight(self, omega_B: np.ndarray) -> float:
        """Return the prior over the proposal density at a rate (3) of the box in rad/s."""
        index = tuple(
            int(np.clip(np.searchsorted(edges, x, "right") - 1, 0, len(edges) - 2))
            for edges, x in zip(self.edges, omega_B, strict=True)
        )
        relative = self.relative.reshape(self.shape)[index]
        return float(1 / (EVEN_SHARE + (1 - EVEN_SHARE) * relative))


def make_proposal(case: Case, axes: list[np.ndarray], distance: np.ndarray) -> Proposal:
    """Return the proposal for a grid: `distance` (n) is the EMD of each motion's r_z distribution to the common one."""
    edges = [
        np.concatenate([[low], (axis[1:] + axis[:-1]) / 2, [high]])
        for axis, (low, high) in zip(axes, scan_limits(case), strict=True)
    ]
    x, y, z = map(np.diff, edges)
    volume = (x[:, None, None] * y[:, None] * z).ravel()
    density = np.exp(-0.5 * (distance / NEAR_EMD) ** 2)
    probability = volume * density / np.sum(volume * density)
    return Proposal(edges, probability / volume * volume.sum(), np.cumsum(probability))


class Scan(NamedTuple):
    """The paper's scan, once for all draws.

    `common_z`: quantiles of the common r_z distribution of the published lines. `tubes`: for each line the histograms (n, BINS) of
    the motions near it. `subset` (m, BINS): histograms of every `SUBSET`-th motion, and `in_tubes` (m) whether it is in a tube.
    `workers`: number of threads.
    """

    case: Case
    table: Histograms
    proposal: Proposal
    common_z: np.ndarray
    tubes: list[np.ndarray]
    subset: np.ndarray
    in_tubes: np.ndarray
    workers: int


def make_scan(case: Case, coarser: int, workers: int | None) -> Scan:
    """Propagate every motion of the grid once, and make proposal and tubes."""
    options = Options(coarser=coarser, workers=workers, progress=sys.stderr.isatty())
    table = propagate_grid(case, first_sun(case), published_window_s(case), options)
    common_z, threads = common_distribution(case), worker_count(workers)
    fine = table.outcome == Outcome.FINE
    distance = np.where(fine, table.distances(common_z, None, threads), np.inf)
    near = distances_from_lines(case, table.rows.start.take(np.arange(len(fine))).omega_B)
    near = (near < TUBE_RAD_S) & fine
    tubes = [np.ascontiguousarray(table.hist[mask]) for mask in near]
    some = np.flatnonzero(fine)[::SUBSET]
    proposal = make_proposal(case, list(scan_grid(case, coarser).values()), distance)
    subset, in_tubes = np.ascontiguousarray(table.hist[some]), near[:, some].any(axis=0)
    return Scan(case, table, proposal, common_z, tubes, subset, in_tubes, threads)


def may_be_accepted(scan: Scan, z: np.ndarray, common_emd: float) -> bool:
    """Return whether the screens let measured r_z (n) pass; `common_emd` is its EMD to the common distribution.

    If each published line has motions of the near-minimum set in its tube, the smallest EMD of each tube is between the smallest of
    the scan and `near_minimum_factor` times it. No smallest EMD of some motions is below that of the scan.
    """
    if not COMMON_EMD[0] < common_emd < COMMON_EMD[1]:
        return False
    factor = scan.case.assumptions.study.near_minimum_factor
    printed, segments = scan.case.published["emd_min"].value, target_segments(z, None)
    tolerance, least = TOLERANCES["wide"].emd_min, []
    for tube in scan.tubes:
        smallest = distances_to_target(tube, segments, scan.workers).min(initial=np.inf)
        if not printed - tolerance <= smallest < factor * (printed + tolerance):
            return False
        least.append(smallest)
    if max(least) >= factor * min(least):
        return False
    subset = distances_to_target(scan.subset, segments, scan.workers)
    bound = min(subset.min(initial=np.inf), *least)
    if bound < printed - tolerance or max(least) >= factor * bound:
        return False
    near = subset < factor * bound
    return not near.any() or bool(scan.in_tubes[near].mean() >= LEAST_IN_TUBES)


class Rebound(NamedTuple):
    """A simulated rebound: true rate (3) in rad/s and Sun direction (3) at its first sample, readings (n, n_panel)."""

    omega_B: np.ndarray
    sun_B: np.ndarray
    power: np.ndarray


def simulate_rebounds(scan: Scan, seed: int, numbers: range) -> list[Rebound]:
    """Draw true rates and simulate the readings of their rebounds: each follows from seed and number, within `DIRECTION_ERROR`."""
    vehicle = scan.case.vehicle
    drawn = []
    for number in numbers:
        rng = generator(seed, number)
        omega_B, t = scan.proposal.draw(rng), draw_rebound_times(scan.case, rng)
        tilt, first = draw_misaligned_panels(vehicle, first_sun(scan.case), rng)
        drawn.append((rng, omega_B, t, tilt, first))
    # One run of the compiled kernel for all motions, with output at the times of all of them: a run for each takes longer.
    all_times = np.unique(np.concatenate([t[1:] - t[0] for _, _, t, _, _ in drawn]))
    n, speed = len(drawn), nominal_wheel_speeds(vehicle)
    states = Rows(
        np.array([omega_B for _, omega_B, *_ in drawn]),
        np.array([first for *_, first in drawn]),
        np.tile(np.array(speed), (n, 1)),
    )
    motions = run(vehicle, states, all_times, error=DIRECTION_ERROR).sun_B
    rebounds = []
    for (rng, omega_B, t, tilt, first), sun_B in zip(drawn, motions, strict=True):
        later = sun_B[np.searchsorted(all_times, t[1:] - t[0])]
        samples = PhaseSamples("first_rebound", t, np.concatenate([first[None], later]))
        power = add_rebound_noise(vehicle, samples, tilt, None, rng)
        rebounds.append(Rebound(omega_B, first, power))
    return rebounds


def repeat_scan(scan: Scan, z: np.ndarray, without_screens: bool) -> dict[str, Any]:
    """Repeat the paper's scan with measured r_z (n), if the screens let it pass; values that were not computed are None."""
    result: dict[str, Any] = {"passed": False, "emd_min": None, "line_rad_s": [None] * 4}
    if z.size < LEAST_DIRECTIONS:  # nothing would be concluded from them
        return result
    result["passed"] = may_be_accepted(scan, z, emd(z, scan.common_z))
    if not (result["passed"] or without_screens):
        return result
    volume = scan.table.volume(z, None, scan.workers)
    smallest = float(volume.values.ravel()[scan.table.outcome == Outcome.FINE].min())
    result["emd_min"] = smallest
    if abs(smallest - scan.case.published["emd_min"].value) <= TOLERANCES["wide"].emd_min:
        factor = scan.case.assumptions.study.near_minimum_factor
        deviation = make_near_minimum_set(scan.case, volume, factor, seed=0).deviation
        if deviation:  # else the set has too few points for four lines
            result["line_rad_s"] = [float(line["mean"]) for line in deviation]
    return result


def simulate_block(scan: Scan, seed: int, block: int) -> dict[str, Any]:
    """Simulate the draws of one file and repeat the scan for each."""
    numbers = range(block * BLOCK, (block + 1) * BLOCK)
    rebounds = simulate_rebounds(scan, seed, numbers)
    # the estimator takes all samples of all rebounds at once
    sun = sun_directions(scan.case.vehicle, np.concatenate([r.power for r in rebounds]))
    seen, z = is_reconstructed(sun["status"]), sun["sun_B"].values[:, 2]
    ends = np.cumsum([len(rebound.power) for rebound in rebounds])[:-1]
    parts, draws = zip(np.split(z, ends), np.split(seen, ends), strict=True), []
    for number, rebound, (z_of_draw, known) in zip(numbers, rebounds, parts, strict=True):
        truth = {"omega_B": rebound.omega_B.tolist(), "sun_B": rebound.sun_B.tolist()}
        truth["weight"] = scan.proposal.weight(rebound.omega_B)
        draws.append(truth | repeat_scan(scan, z_of_draw[known], number % UNSCREENED == 0))
    return {"draws": draws}


def load_or_make_draws(
    folder: Path, n: int, make: Callable[[int], dict[str, Any]]
) -> list[dict[str, Any]]:
    """Return the first `n` draws from the files of a folder; `make` makes the blocks that are not there."""
    rows: list[dict[str, Any]] = []
    for block in tqdm(range(-(-n // BLOCK)), desc=f"blocks of {BLOCK} draws"):
        rows += load_or_make(folder / f"{block}.json", partial(make, block))["draws"]
    return rows[:n]


class Draws(NamedTuple):
    """Draws as arrays (n): weights, quantities by name, distances to the nearest published line in rad/s.

    `accepted`: mask of the accepted ones for each tolerance. `passed`: mask of those that the screens let pass.
    """

    weight: np.ndarray
    values: dict[str, np.ndarray]
    from_line: np.ndarray
    accepted: dict[str, np.ndarray]
    passed: np.ndarray


def describe_motions(case: Case, states: Rows) -> dict[str, np.ndarray]:
    """Return the quantities of motions from their states at the first sample."""
    back = propagate_back(case, states, first_sample_lead_s(case))
    momentum = momentum_angles(case.vehicle, states)
    angles = np.degrees([momentum.theta_rad, momentum.alpha_rad])
    speed = np.linalg.norm(back, axis=1)
    return {"speed": speed, "smaller": angles.min(axis=0), "larger": angles.max(axis=0)}


def collect_draws(case: Case, rows: list[dict[str, Any]]) -> Draws:
    """Return the draws as arrays, with the motions that they stand for and whether they are accepted."""
    columns = {name: np.array([row[name] for row in rows], dtype=float) for name in rows[0]}
    omega, speed = columns["omega_B"], nominal_wheel_speeds(case.vehicle)
    values = describe_motions(
        case, Rows(omega, columns["sun_B"], np.tile(np.array(speed), (len(rows), 1)))
    )
    from_line = distances_from_lines(case, omega).min(axis=0)
    off = np.abs(columns["emd_min"] - case.published["emd_min"].value)
    line = columns["line_rad_s"].max(axis=1)  # NaN, and so not accepted, if there is none
    accepted = {
        name: (off <= tolerance.emd_min) & (line <= tolerance.line_rad_s)
        for name, tolerance in TOLERANCES.items()
    }
    passed = columns["passed"].astype(bool)
    # an unscreened draw that the screens reject is a check only: the other draws had no such chance
    accepted = {name: mask & passed for name, mask in accepted.items()} | {
        f"{name} without screens": mask & ~passed for name, mask in accepted.items()
    }
    return Draws(columns["weight"], values, from_line, accepted, passed)


def weighted_quantile(x: np.ndarray, weight: np.ndarray, level: float) -> float:
    """Return the smallest value of x (n) at which the weights reach a share `level`."""
    order = np.argsort(x)
    reached = np.cumsum(weight[order])
    index = int(np.searchsorted(reached, level * reached[-1]))
    return float(x[order][min(index, x.size - 1)])


def estimate_quantile(x: np.ndarray, weight: np.ndarray, level: float) -> Estimate:
    """Return a weighted quantile of x (n) and its bootstrap error."""
    rng, resampled = np.random.default_rng(0), []
    for _ in range(RESAMPLED if x.size > 1 else 0):
        index = rng.integers(x.size, size=x.size)
        resampled.append(weighted_quantile(x[index], weight[index], level))
    error = float(np.std(resampled)) if resampled else float("nan")
    return Estimate(weighted_quantile(x, weight, level), error)


def make_table(case: Case, draws: Draws) -> pd.DataFrame:
    """Return all results: a line for each of quantity, statistic and sample, with the error (one sigma, of the sampling only)."""
    lines: list[tuple[Any, ...]] = []
    paper_speed = case.published["rate_at_touchdown_min"].value
    samples = {"prior": np.ones(draws.weight.size, dtype=bool)}
    samples |= {name: draws.accepted[name] for name in TOLERANCES}
    for sample, mask in samples.items():
        weight = draws.weight[mask]
        lines.append((sample, "number of draws", "", "count", int(mask.sum()), np.nan))
        effective = effective_runs(weight) if mask.any() else 0.0
        lines.append((sample, "effective number", "", "count", effective, np.nan))
        chance = Estimate(1.0, np.nan) if mask.all() else estimate(draws.weight * mask)
        lines.append((sample, "probability of acceptance", "", "mean", *chance))
        if mask.sum() < LEAST_ACCEPTED:
            continue
        for name, (meaning, unit) in QUANTITIES.items():
            x = draws.values[name][mask]
            lines.append((sample, meaning, unit, "mean", *estimate(x, weight)))
            for level in QUANTILES:
                value = estimate_quantile(x, weight, level)
                lines.append((sample, meaning, unit, f"quantile {level:.0%}", *value))
        near, slow = (
            probability(true[mask], weight)
            for true in (draws.from_line <= ON_LINE_RAD_S, draws.values["speed"] < paper_speed)
        )
        on_line = f"share within {ON_LINE_RAD_S:g} rad/s of a published line"
        lines.append((sample, on_line, "", "mean", *near))
        below = f"share with an angular speed below {paper_speed:g} rad/s"
        lines.append((sample, below, "", "mean", *slow))
    names = ["sample", "quantity", "unit", "statistic", "value", "error"]
    return pd.DataFrame(lines, columns=names)


def format_table(table: pd.DataFrame, draws: Draws) -> str:
    """Return the results in Markdown, a column for each sample."""
    titles = {"prior": "prior"} | {
        name: f"{name}: EMD within {t.emd_min:g}, lines within {t.line_rad_s:g} rad/s"
        for name, t in TOLERANCES.items()
    }
    text = "| | " + " | ".join(titles.values()) + " |\n" + "|---" * (1 + len(titles)) + "|\n"
    keys = table[["quantity", "unit", "statistic"]]
    for quantity, unit, statistic in keys.drop_duplicates().to_numpy().tolist():
        group = table[(keys == [quantity, unit, statistic]).all(axis=1)]
        label = quantity + (f", {unit}" if unit else "")
        label += f": {statistic}" if unit else ""
        cells = []
        for sample in titles:
            rows = group[group["sample"] == sample]
            cells.append("too few draws")
            if len(rows):
                value, error = (float(rows[name].iloc[0]) for name in ("value", "error"))
                digits = ".2g" if quantity.startswith("probability") else ".3f"
                digits = ".1f" if unit == "deg" else digits
                cells[-1] = f"{value:{digits}}"
                cells[-1] += f" +- {error:{digits}}" if np.isfinite(error) else ""
                if statistic == "count":
                    cells[-1] = f"{value:,.0f}"
                elif not value and quantity.startswith("probability"):
                    cells[-1] = f"none of {draws.weight.size:,}"
        text += "| " + " | ".join([label, *cells]) + " |\n"
    text += (
        f"\nEvery {UNSCREENED}th draw is scanned without screens. Accepted ones that the screens "
    )
    counts = []
    for name in TOLERANCES:
        kept = int(draws.accepted[name][::UNSCREENED].sum())
        rejected = int(draws.accepted[f"{name} without screens"].sum())
        counts.append(f"{kept} and {rejected} ({name})")
    text += f"keep and reject: {', '.join(counts)}. Simulated: {draws.weight.size:,} draws.\n"
    return text


def printed_figure(case: Case, draws: Draws) -> Figure:
    """Draw speed and angles of the prior and of the accepted motions, with the medians of the published lines."""
    figure = Figure(figsize=(13.0, 4.4), layout="constrained")
    states = start_states(case, published_candidates(case), first_sun(case))
    on_lines = describe_motions(case, states)
    for axes, (name, (meaning, unit)) in zip(
        figure.subplots(1, 3), QUANTITIES.items(), strict=True
    ):
        x = draws.values[name]
        axes.ecdf(x, draws.weight, color="#aaaaaa", lw=4, label="prior: even in the box")
        for k, (tolerance, limits) in enumerate(TOLERANCES.items()):
            mask = draws.accepted[tolerance]
            if not mask.any():
                continue
            label = f"{tolerance}: EMD ±{limits.emd_min:g}, lines {limits.line_rad_s:g} rad/s"
            label += f" ({mask.sum()} accepted, effective {effective_runs(draws.weight[mask]):.0f})"
            style: dict[str, Any] = {"color": COLOURS[k], "ls": ("-", "--", ":")[k]}
            axes.ecdf(x[mask], draws.weight[mask], lw=1.5, label=label, **style)
        median = float(np.median(on_lines[name]))
        axes.axvline(median, ls="-.", lw=1.0, color="#000000", label="published lines, median")
        axes.set(xlabel=f"{meaning} ({unit})", ylabel="share of the motions below (1)")
        axes.set_xlim(0, 1.4 if name == "speed" else 120)
    handles = figure.axes[0].get_legend_handles_labels()
    figure.legend(*handles, fontsize=8, ncols=2, loc="outside lower center", frameon=False)
    figure.suptitle(
        f"Motions of simulated rebounds that show the paper's printed results ({draws.weight.size:,} draws)"
    )
    return figure


@command
def main(arguments: list[str] | None = None) -> None:
    """Run the study and write its table and figure."""
    parser = study_parser("printed_results", __doc__)
    parser.add_argument("out", type=Path, help="folder of the results")
    parser.add_argument("--draws", type=int, default=20_000, help="simulated rebounds")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--coarser", type=int, default=1, help="every n-th point of the grid only")
    parser.add_argument("--workers", type=int, help="threads (default: one for each core)")
    options = parser.parse_args(arguments)
    if options.draws < 1:
        raise ValueError(f"--draws must be at least 1 (got {options.draws})")
    case, folder = load_case("philae"), f"draws-seed{options.seed}-coarser{options.coarser}"
    # not made if all draws are there
    scan = cache(partial(make_scan, case, options.coarser, options.workers))
    rows = load_or_make_draws(
        rows_folder(options.out / folder),
        options.draws,
        lambda block: simulate_block(scan(), options.seed, block),
    )
    draws = collect_draws(case, rows)
    table = make_table(case, draws)
    text = format_table(table, draws)
    table.to_csv(options.out / "printed_results.csv", index=False)
    (options.out / "printed_results.md").write_text(text, "utf-8")
    printed_figure(case, draws).savefig(options.out / "printed_results.png", dpi=150)
    print(text)


if __name__ == "__main__":
    sys.exit(main())
