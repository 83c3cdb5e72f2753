"""The case's own synthetic telemetry: a simulated landing, selected because it agrees with what the paper prints.

The panel powers measured in flight are not public. A landing drawn at random does not show what the paper prints of its telemetry:
the set of motions that fit is ragged, and no lines follow from it. This module draws simulated landings from a seed until one shows
all of it, within `Criteria`:

1. panels and descent are drawn together, and accepted by the descent's n_z, Delta and E;
2. `REBOUNDS_PER_DESCENT` first rebounds are drawn for these panels. The true rate lies within `TRUTH_OFFSET_RAD_S` of the published
   line L1 or L3, near one of the three points that "one revolution in 13 s" may mean. A rebound is accepted by the smallest EMD of
   the paper's scan, by the four lines through its near-minimum set, and by the Sun's height;
3. the collision is drawn for this rebound, and accepted by the share of negative r_z after it.

A selected file tests nothing that it was selected for. Most landings with such a motion do not show it: the number of the draw says
how rare it is. ``python -m sunspin.philae.telemetry --seed N OUT.csv`` repeats the search; ``--draw K`` makes draw K at once.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError, SunspinError, TelemetryError
from sunspin.base.provenance import version
from sunspin.cases import Case, load_case
from sunspin.compute.pool import process_pool, worker_count
from sunspin.dynamics.batch import Outcome
from sunspin.estimate.scan.histogram import distances_to_target, target_segments
from sunspin.estimate.scan.metrics import emd
from sunspin.estimate.scan.volume import Histograms
from sunspin.philae.data_check import LEAST_DIRECTIONS
from sunspin.philae.descent import find_first_clean_sample
from sunspin.philae.metrics import make_near_minimum_set, propagate_grid
from sunspin.philae.published_lines import pool_rz
from sunspin.philae.rebound import (
    LINE_RANGE,
    Options,
    distances_from_lines,
    first_sun,
    points_on_lines,
    published_lines,
    published_window_s,
)
from sunspin.philae.simulation import (
    CELL_W,
    PhaseSamples,
    RestingSun,
    SimulatedCollision,
    State,
    add_noise,
    add_rebound_noise,
    describe_truth,
    draw_misaligned_panels,
    draw_rebound_times,
    find_first_state,
    join_phases,
    propagate_directions,
    simulate_collision,
    simulate_descent,
    simulate_ground_phases,
    simulate_second_rebound,
)
from sunspin.philae.spin import fit_spin
from sunspin.philae.sun_directions import share_in_shadowed_range
from sunspin.telemetry.health import panel_health
from sunspin.telemetry.sun import SunStatus, is_reconstructed, sun_directions
from sunspin.telemetry.synthetic import (
    csv_text,
    generator,
    refuse_existing,
    truth_text,
    write_new,
)
from sunspin.vehicle import Vehicle

SEED, DRAW = 0, 35_913
"""Seed and draw of the committed file: the first seed, none was picked, and its first draw that is accepted."""

REBOUNDS_PER_DESCENT = 500
"""Number of first rebounds that are drawn for the panels of one accepted descent, which takes as long to find as they do."""

READINGS_OF_13_S = {1: (-0.016, 0.20, -0.04), 3: (0.084, 0.18, 0.03)}
"""omega_z in rad/s at the first sample of the motions on the lines L1 and L3 with one revolution in 13 s before the collision.

The 13 s (ROMAP team, 2014) are read as the period of |omega|, of omega_z, or of the precession |H| / I_perp. L2 and L4 have the
same distributions of r_z.
"""

READING_RANGE_RAD_S = 0.03
"""Largest difference in rad/s between the true omega_z and its reading of 13 s, before the offset from the line."""

TRUTH_OFFSET_RAD_S = 0.01
"""Largest distance in rad/s of the true rate from a point of its published line: two thirds of the paper's grid step."""

TUBE_RAD_S = 0.02
"""Radius in rad/s of the tubes about the published lines in which the second screen compares motions."""

FOLDED_TRANSMISSION = (0.3, 1.0)
"""Range from which the part of the light that reaches a side panel past the folded legs is drawn."""

REST_RANGE_DEG = 15.0
"""Largest difference of azimuth and inclination of the Sun's path at rest from those of `simulation.RestingSun`, degrees."""

MOST_DRAWS = 20_000
"""Number of draws of one phase after which it is given up."""

COMMON_EMD = (0.028, 0.045)
"""EMD to the common distribution of the published lines with which a rebound passes the first screen: 0.4 of the draws do.

Points of the lines differ from this distribution by 0.002 to 0.006 in EMD, so that a rebound outside seldom has the published
smallest EMD.
"""

COMMON_QUANTILES = 4000
"""Number of quantiles that stand for the common distribution of the published lines."""


@dataclass(frozen=True)
class Criteria:
    """Largest differences from the printed figures with which a landing is accepted.

    Attributes
    ----------
    sun_z : mean n_z of the descent (0.60)
    delta_mean : mean Delta of the samples that nothing shadows (0.015)
    delta_max : largest of these Delta, less and more than the printed one (0.07)
    descent_E : E of the descent (0.0028)
    emd_min : smallest EMD of the paper's scan (0.0326)
    line_rad_s : mean distance in rad/s of each fitted line from its published one
    height_deg : smallest and largest height of the Sun between touchdown and collision (10 and 80 degrees): a tenth of the range
    folded_z : mean n_z of the samples before the legs unfold (0.8)
    shadowed : least share of the Delta before the unfolding, and at rest, that is in the printed range (0.1 to 0.2)
    negative : least share of the samples after the collision with r_z < 0, which the paper calls "often"
    """

    sun_z: float = 0.01
    delta_mean: float = 0.002
    delta_max: tuple[float, float] = (0.015, 0.010)
    descent_E: float = 0.0004
    emd_min: float = 0.002
    line_rad_s: float = 0.02
    height_deg: float = 7.0
    folded_z: float = 0.05
    shadowed: float = 0.9
    negative: float = 0.3


CRITERIA = Criteria()


def _directions(vehicle: Vehicle, power: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the Sun directions (n, 3) that readings (n, n_panel) show, NaN where they show none; the mask of these; Delta (n)."""
    sun = sun_directions(vehicle, power)
    return sun["sun_B"].values, is_reconstructed(sun["status"]), sun["delta"].values


def _not_found(problem: str) -> InputError:
    """Return the error of a phase that is given up."""
    return InputError(problem, got=f"{MOST_DRAWS} draws", do="take another seed or draw")


# ---- Panels and descent ------------------------------------------------------------------------------------------------------


class DrawnDescent(NamedTuple):
    """An accepted descent and the panels that it was drawn with.

    `tilt` (n_panel, 3): rotations of the panels in rad. `phases`, `power`: samples and readings with legs folded and unfolded.
    `draws`: number of descents drawn until this one was accepted.
    """

    tilt: np.ndarray
    phases: tuple[PhaseSamples, PhaseSamples]
    power: list[np.ndarray]
    draws: int


def draw_descent(case: Case, seed: int, number: int) -> DrawnDescent:
    """Draw panels and descent number `number` of a seed until n_z, Delta and E of the descent are as printed."""
    vehicle, rng = case.vehicle, generator(seed, 1, number)
    printed_E = case.published["descent_E"].value
    for draws in range(1, MOST_DRAWS + 1):
        tilt, _ = draw_misaligned_panels(vehicle, first_sun(case), rng)
        if tilt is None:
            raise InputError("the panels need misalignments", do="use the vehicle file of philae")
        sun_z = find_true_sun_z(case, tilt)
        if not 0.4 < sun_z < 0.75:  # also NaN: these panels show nothing like the printed n_z
            continue
        folded, unfolded = simulate_descent(case, rng, sun_z)
        power = add_noise(vehicle, unfolded, tilt, None, rng)
        sun_B, seen, delta = _directions(vehicle, power)
        mean_z = float(sun_B[seen, 2].mean())
        if abs(mean_z - case.published["nz_descent"].value) > CRITERIA.sun_z:
            continue
        if not has_printed_delta(case, delta[seen]):
            continue
        if abs(fit_spin(unfolded.t_s - unfolded.t_s[0], sun_B).E - printed_E) > CRITERIA.descent_E:
            continue
        folded, folded_power = draw_folded_samples(case, folded, power, tilt, rng)
        return DrawnDescent(tilt, (folded, unfolded), [folded_power, power], draws)
    raise _not_found("no panels show what is printed of the descent")


def draw_folded_samples(
    case: Case,
    folded: PhaseSamples,
    unfolded_power: np.ndarray,
    tilt: np.ndarray,
    rng: np.random.Generator,
) -> tuple[PhaseSamples, np.ndarray]:
    """Draw what the folded legs let through to each side panel, until the samples before the unfolding are as printed.

    Accepted are a mean n_z and Delta as printed, and legs whose effect ends by the rule of the study just before `unfolded_power`
    (n, n_panel), the readings of the descent. Return the samples and their readings (m, n_panel).
    """
    vehicle, low, high = case.vehicle, *FOLDED_TRANSMISSION
    printed_z = case.published["nz_folded"].value
    for _ in range(MOST_DRAWS):
        transmission = np.append(rng.uniform(low, high, len(vehicle.panels) - 1), 1.0)
        samples = folded._replace(transmission=transmission)
        power = add_noise(vehicle, samples, tilt, None, rng)
        sun = sun_directions(vehicle, np.concatenate([power, unfolded_power]))
        legs, seen = np.arange(sun.sizes["time"]) < len(power), is_reconstructed(sun["status"])
        delta = sun["delta"].values[legs & (sun["status"].values == SunStatus.OK)]
        sun_z = sun["sun_B"].values[legs & seen, 2]
        shadowed = share_in_shadowed_range(case, delta) >= CRITERIA.shadowed
        if shadowed and sun_z.size and abs(sun_z.mean() - printed_z) <= CRITERIA.folded_z:
            with suppress(TelemetryError):
                if find_first_clean_sample(sun)[0] == len(power):
                    return samples, power
    raise _not_found("no folded legs show what is printed of the first samples")


def find_true_sun_z(case: Case, tilt: np.ndarray) -> float:
    """Return the true Sun's z in the descent with which panels rotated by `tilt` show the printed mean n_z, or NaN."""
    printed = sun_z = case.published["nz_descent"].value
    azimuth = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    # the shown n_z changes nearly as the true one does, so that three steps converge
    for _ in range(3):
        if not abs(sun_z) < 1:  # also if no direction was shown
            return np.nan
        flat = np.sqrt(1 - sun_z**2)
        circle = np.stack(
            [flat * np.cos(azimuth), flat * np.sin(azimuth), np.full(azimuth.size, sun_z)], axis=1
        )
        power = CELL_W * case.vehicle.response_in().power(circle, tilt=tilt)
        sun_B, seen, _ = _directions(case.vehicle, power)
        sun_z += printed - (sun_B[seen, 2].mean() if seen.any() else np.nan)
    return float(sun_z)


def has_printed_delta(case: Case, delta: np.ndarray) -> bool:
    """Return whether the mean and the largest of Delta (n) are as printed."""
    mean, largest = (case.published[name].value for name in ("delta_mean", "delta_max"))
    less, more = CRITERIA.delta_max
    near_mean = abs(delta.mean() - mean) <= CRITERIA.delta_mean
    return bool(near_mean and largest - less < delta.max() < largest + more)


# ---- First rebound -----------------------------------------------------------------------------------------------------------


class ReboundDraw(NamedTuple):
    """A first rebound: true state at its first sample, samples, readings (n, n_panel), measured r_z (m) of its directions."""

    start: State
    samples: PhaseSamples
    power: np.ndarray
    z: np.ndarray


def draw_rebound(case: Case, seed: int, number: int, tilt: np.ndarray) -> ReboundDraw:
    """Draw first rebound number `number` of a seed with panels rotated by `tilt` (n_panel, 3)."""
    vehicle, rng = case.vehicle, generator(seed, 2, number)
    line_number = list(READINGS_OF_13_S)[rng.integers(2)]
    reading = READINGS_OF_13_S[line_number][rng.integers(3)]
    omega_z = reading + rng.uniform(-READING_RANGE_RAD_S, READING_RANGE_RAD_S)
    line = published_lines(case)[line_number - 1]
    offset = rng.standard_normal(3)  # even in a ball
    offset *= TRUTH_OFFSET_RAD_S * np.cbrt(rng.uniform()) / np.linalg.norm(offset)
    start = find_first_state(case, tilt, points_on_lines([line], [omega_z])[0, 0] + offset)
    t = draw_rebound_times(case, rng)
    samples = PhaseSamples("first_rebound", t, propagate_directions(vehicle, start, t))
    power = add_rebound_noise(vehicle, samples, tilt, None, rng)
    sun_B, seen, _ = _directions(vehicle, power)
    return ReboundDraw(start, samples, power, sun_B[seen, 2])


def find_likely_rebounds(
    seed: int, number: int, common_z: np.ndarray
) -> list[tuple[int, ReboundDraw]]:
    """Return those of the rebounds of descent `number`, with their numbers, that pass the first screen.

    There are none if no descent with the panels of this number is as printed. `common_z` (n): quantiles of
    the common r_z distribution of the published lines (`common_distribution`).
    """
    case = load_case("philae")
    try:
        descent = draw_descent(case, seed, number)
    except InputError:  # none of `MOST_DRAWS` was accepted
        return []
    first, (low, high) = number * REBOUNDS_PER_DESCENT, COMMON_EMD
    likely = []
    for k in range(first, first + REBOUNDS_PER_DESCENT):
        draw = draw_rebound(case, seed, k, descent.tilt)
        if draw.z.size >= LEAST_DIRECTIONS and low < emd(draw.z, common_z) < high:
            likely.append((k, draw))
    return likely


def common_distribution(case: Case) -> np.ndarray:
    """Return quantiles (n) of r_z over points of all four published lines, which have nearly the same distribution."""
    z = np.concatenate(pool_rz(case))
    return np.quantile(z, (np.arange(COMMON_QUANTILES) + 0.5) / COMMON_QUANTILES)


class PrintedScan:
    """The paper's scan, once for all rebounds, and the tubes of motions about the four published lines."""

    def __init__(self, case: Case) -> None:
        """Propagate the motions of the paper's grid: a minute and a half on one core, 430 MB."""
        self.case = case
        self.table: Histograms = propagate_grid(
            case, first_sun(case), published_window_s(case), Options()
        )
        self.fine = self.table.outcome == Outcome.FINE
        start = self.table.rows.start.take(np.arange(len(self.fine)))
        omega_z = start.omega_B[:, 2]
        usable = (omega_z > LINE_RANGE[0]) & (omega_z < LINE_RANGE[1]) & self.fine
        near = distances_from_lines(case, start.omega_B) < TUBE_RAD_S
        tubes = [np.flatnonzero(of_line & usable) for of_line in near]
        self._tube_ends = np.cumsum([len(tube) for tube in tubes])[:-1]
        self._tube_hist = np.ascontiguousarray(self.table.hist[np.concatenate(tubes)])

    def may_show_lines(self, z: np.ndarray) -> bool:
        """Return whether the near-minimum set may have motions near all four lines: the second screen, by their tubes alone."""
        distance = distances_to_target(self._tube_hist, target_segments(z, None), 1)
        least = [tube.min() for tube in np.split(distance, self._tube_ends)]
        factor = self.case.assumptions.study.near_minimum_factor
        printed = self.case.published["emd_min"].value
        near_printed = abs(min(least) - printed) <= CRITERIA.emd_min
        return bool(near_printed and max(least) < factor * min(least))

    def shows_lines(self, z: np.ndarray) -> bool:
        """Return whether the scan of measured r_z (n) has the printed smallest EMD and gives the four published lines."""
        volume = self.table.volume(z, None, worker_count(None))
        smallest = float(volume.values.ravel()[self.fine].min())
        if abs(smallest - self.case.published["emd_min"].value) > CRITERIA.emd_min:
            return False
        factor = self.case.assumptions.study.near_minimum_factor
        deviation = make_near_minimum_set(self.case, volume, factor, seed=0).deviation
        return bool(deviation) and all(line["mean"] <= CRITERIA.line_rad_s for line in deviation)


def has_printed_heights(case: Case, rebound: ReboundDraw) -> bool:
    """Return whether the Sun's height over the xy plane ranges as printed from the first sample to the collision."""
    start = rebound.start
    t = start.t_s + np.arange(0.0, published_window_s(case), 5.0)
    z = propagate_directions(case.vehicle, start, t)[:, 2]
    heights = np.degrees(np.arcsin([z.min(), z.max()]))
    difference = heights - case.published["sun_height_range"].value
    return bool(np.all(np.abs(difference) <= CRITERIA.height_deg))


def find_printed_rebounds(
    case: Case, seed: int, first: int = 0, workers: int | None = None
) -> Iterator[int]:
    """Yield the numbers of the draws of a seed, from draw `first` on, that show what the paper prints; report to stderr.

    Every draw follows from seed and number alone, so that an interrupted search can continue from any draw.
    """
    common_z, scan = common_distribution(case), PrintedScan(case)
    size = worker_count(workers)
    screen = partial(find_likely_rebounds, seed, common_z=common_z)
    with process_pool(size) as pool:
        # blocks of one descent for each process, in the order of the draws
        for block in count(first // REBOUNDS_PER_DESCENT, size):
            compute = map if pool is None else pool.map
            for likely in compute(screen, range(block, block + size)):
                for number, draw in likely:
                    passes = number >= first and scan.may_show_lines(draw.z)
                    if passes and scan.shows_lines(draw.z) and has_printed_heights(case, draw):
                        yield number
            print(f"{(block + size) * REBOUNDS_PER_DESCENT} drawn", file=sys.stderr, flush=True)


# ---- The whole landing -------------------------------------------------------------------------------------------------------


def draw_collision(
    case: Case, seed: int, start: State, tilt: np.ndarray
) -> tuple[SimulatedCollision, PhaseSamples, np.ndarray]:
    """Draw the collision of the motion through `start` until r_z is often negative after it.

    Return the collision, the samples after it, and their readings (n, n_panel).
    """
    for number in range(MOST_DRAWS):
        rng = generator(seed, 3, number)
        collision = simulate_collision(case, start, rng)
        samples = simulate_second_rebound(case, collision.after, rng)
        if np.mean(samples.sun_B[:, 2] < 0) >= CRITERIA.negative:
            return collision, samples, add_noise(case.vehicle, samples, tilt, None, rng)
    raise _not_found("no collision gives r_z that is often negative")


def draw_rest(
    case: Case, seed: int, after: State, tilt: np.ndarray
) -> tuple[tuple[PhaseSamples, PhaseSamples], list[np.ndarray]]:
    """Draw the Sun's path and the shadows at rest until lit patterns and Delta are as printed; return samples and readings.

    `after`: state just after the collision.
    """
    vehicle, usual = case.vehicle, RestingSun()
    printed = {
        frozenset(map(str, pattern)) for pattern in case.published["lit_patterns_at_rest"].value
    }
    # the study estimates the noise from the file; the patterns must be impossible with an estimate that is too large
    form = vehicle.telemetry
    noisier = replace(vehicle, telemetry=replace(form, noise=1.3 * vehicle.require_noise()))
    for number in range(MOST_DRAWS):
        rng = generator(seed, 4, number)
        azimuth, inclination = rng.uniform(-REST_RANGE_DEG, REST_RANGE_DEG, 2)
        early, late = (
            np.clip(np.array(part) * (1 + rng.uniform(-0.3, 0.3, len(part))), 0.0, 1.0)
            for part in (usual.early, usual.late)
        )
        resting = RestingSun(
            usual.azimuth_deg + azimuth,
            usual.inclination_deg + inclination,
            (*early[:-1], 1.0),
            (*late[:-1], 1.0),
        )
        phases = simulate_ground_phases(case, after, rng, rng, resting_sun=resting)
        power = [add_noise(vehicle, samples, tilt, None, rng) for samples in phases]
        data = join_phases(case, [*phases], power, {})
        health, sun = panel_health(noisier, data), sun_directions(vehicle, data)
        impossible = sun["status"].values == SunStatus.IMPOSSIBLE
        rest, n_lit = data["phase"].values == "rest", sun["n_lit"].values
        judged = rest & ((sun["status"].values == SunStatus.OK) | (impossible & (n_lit >= 3)))
        inside = share_in_shadowed_range(case, sun["delta"].values[judged])
        as_printed = {frozenset(pattern) for pattern in health["impossible"]} == printed
        if as_printed and [*health["explanations"]] == [("1",)] and inside >= CRITERIA.shadowed:
            return phases, power
    raise _not_found("no path of the Sun shows what is printed of the samples at rest")


def make_landing(case: Case, seed: int, number: int) -> xr.Dataset:
    """Return the telemetry of draw `number` of a seed: the whole landing, in the form of :func:`sunspin.read_telemetry`."""
    vehicle = case.vehicle
    descent = draw_descent(case, seed, number // REBOUNDS_PER_DESCENT)
    rebound = draw_rebound(case, seed, number, descent.tilt)
    collision, after, after_power = draw_collision(case, seed, rebound.start, descent.tilt)
    ground, ground_power = draw_rest(case, seed, collision.after, descent.tilt)
    truth = {
        "seed": seed,
        "draw": number,
        "descent_draws": descent.draws,
        "noise": vehicle.require_noise(),
        **describe_truth(case, rebound.start, collision),
        "tilt_B_rad": descent.tilt.ravel(),
    }
    phases = [*descent.phases, rebound.samples, after, *ground]
    power = [*descent.power, rebound.power, after_power, *ground_power]
    return join_phases(case, phases, power, truth)


def main(arguments: list[str] | None = None) -> int:
    """Write synthetic telemetry of Philae's landing that agrees with what the paper prints, and its truth next to it."""
    parser = argparse.ArgumentParser(
        prog="python -m sunspin.philae.telemetry",
        description=f"{main.__doc__} The search takes an hour or more of two cores; with --draw the landing is made at once.",
    )
    add = parser.add_argument
    add("out", type=Path, help="CSV file to write; the truth goes to twin_truth.toml there")
    add("--seed", type=int, default=SEED, help="of all that is drawn (default: %(default)s)")
    add("--draw", type=int, help="make this draw, whether it agrees with the paper or not")
    add("--from", dest="first", type=int, default=0, help="search from this draw on")
    add("--force", action="store_true", help="replace existing files")
    options = parser.parse_args(arguments)
    case, truth = load_case("philae"), options.out.parent / "twin_truth.toml"
    try:
        for path in (options.out, truth):  # before the search, which takes long
            refuse_existing(path, options.force)
        number = options.draw
        if number is None:
            number = next(find_printed_rebounds(case, options.seed, options.first))
        selected = options.draw is None or (options.seed, number) == (SEED, DRAW)
        why = (
            "selected because it shows what the paper prints of the telemetry"
            if selected
            else "not compared with what the paper prints of the telemetry"
        )
        telemetry = make_landing(case, options.seed, number)
        command = f"python -m sunspin.philae.telemetry --seed {options.seed} --draw {number}"
        comments = [
            f"synthetic: not measured; made by sunspin {version()} from published facts",
            f"synthetic: {command} {options.out.name}",
            f"synthetic: draw {number} of first rebounds, {why}",
        ]
        behind_them = "the truth behind them is in twin_truth.toml"
        scale = f"synthetic: powers in W on an arbitrary scale; {behind_them}"
        about = f"The truth behind {options.out.name}; see sunspin.philae.simulation for how each part was chosen."
        text = csv_text(case.vehicle, telemetry, [*comments, scale])
        write_new(options.out, text, options.force)
        write_new(truth, truth_text(telemetry, [*comments, about]), options.force)
    except SunspinError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
