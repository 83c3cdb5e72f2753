"""How often should a lander sample? What is known of the rotation against sampling period, noise and number of panels.

    python -m sunspin.landing.sampling OUT --twins 4

Philae's body and wheel, 45 min of free motion, inertia, friction, wheel speed and brightness uncertain as the posterior assumes.
Widths come from Laplace's method (:mod:`sunspin.estimate.information`), over motions drawn from a ball of rates. Whether aliases
are left is found on twins: the posterior's search is begun from all motions about a turn a period around the truth, and what fits
all samples is counted; a lower bound, as motions further off are not looked for. A file in OUT for
each twin: the same command goes on.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.special import logsumexp

from sunspin.compute.campaign import command, kept, rows_folder
from sunspin.estimate.information import Information, exact_readings, rate_volume, speed_sigma
from sunspin.estimate.posterior.data import Readings, readings
from sunspin.estimate.posterior.model import Model, State, model, rate_and_direction
from sunspin.estimate.posterior.modes import Plan, Search
from sunspin.estimate.posterior.predict import run_to
from sunspin.estimate.posterior.tilt import AS_DRAWN
from sunspin.estimate.synthetic import Truth, synthetic_telemetry
from sunspin.telemetry.case import load_case
from sunspin.vehicle import Panel, Vehicle

WINDOW_S = 2700.0
"""From the first sample to the collision."""

PERIODS_S = (5, 10, 20, 30, 60, 90, 120, 180, 240, 300, 450, 675, 900)
NOISES = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1)
"""One sigma of a reading as a part of the largest panel's full signal."""

USUAL_NOISE, USUAL_PERIOD_S = 0.02, 120
"""Close to Philae's: 1.8 % and two minutes."""

MORE_PANELS = (("-x", (-1.0, 0.0, 0.0)), ("-z", (0.0, 0.0, -1.0)))
"""Sides that Philae has no cells on; as gain the mean of its panels."""

MOTIONS, MAX_RATE = 24, 0.4
"""Motions over which medians are taken, and the ball (rad/s) that they are drawn from."""

ALIAS_PERIODS_S, ALIAS_RATE = (30, 60, 120, 240, 450, 900), 0.4
"""Twins whose neighbours are counted: periods, and the ball of rates (rad/s) they are drawn from."""

IRREGULAR = 0.05
"""Sample times are irregular by up to this part of the period in every second run."""

TURNS, GRID_RAD = 1.3, 1.4
"""How far from the truth starts are, in turns a period, and their distance from each other as a turn (rad) in a period."""

LINK_SIGMAS, NEAR_SIGMAS = 2.0, 4.0
"""Modes nearer to each other than this are one motion; a mode nearer to the truth than this is the true one."""


@dataclass(frozen=True)
class Widths:
    """Sigma of the angular speed (rad/s) and 90 % volume of the rates ((rad/s)^3), one value for each motion.

    `by_noise`: (noises, periods, motions); `by_panels`: number of panels -> (subsets, motions) at the usual period and noise, with
    `subsets`: number -> names of the panels of each.
    """

    speed_by_noise: np.ndarray
    volume_by_noise: np.ndarray
    speed_by_panels: dict[int, np.ndarray]
    subsets: dict[int, list[tuple[str, ...]]]


def motions(unknown: Model, count: int, max_rate: float, seed: int) -> list[State]:
    """Motions at the first sample: rates uniform in a ball, directions on the sphere, everything else as it should be."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
    nothing = np.zeros((1, len(unknown.unknowns)))
    return [State(*rate_and_direction(max_rate, rng), nothing) for _ in range(count)]


def with_more_panels(vehicle: Vehicle) -> Vehicle:
    """The vehicle with cells on the sides that have none."""
    gain = float(np.mean(vehicle.panel_gains))
    return replace(
        vehicle,
        panels=(
            *vehicle.panels,
            *(Panel(name, np.array(normal), gain) for name, normal in MORE_PANELS),
        ),
    )


def widths(vehicle: Vehicle, count: int = MOTIONS, seed: int = 0) -> Widths:
    """Laplace's widths of `count` motions for all periods, noises and sets of panels."""
    more = with_more_panels(vehicle)
    unknown, _ = model(more, {"max_rate_rad_s": 2 * MAX_RATE} | AS_DRAWN, 1.0)
    finest = int(PERIODS_S[0])
    t = np.arange(0.0, WINDOW_S + 0.5 * finest, finest)
    full = float(vehicle.panel_gains.max())
    own = list(range(len(vehicle.panels)))
    sets = {
        n: list(combinations(range(len(more.panels)), n)) for n in range(1, len(more.panels) + 1)
    }
    speed = np.empty((len(NOISES), len(PERIODS_S), count))
    volume, by_panels = (
        np.empty_like(speed),
        {n: np.empty((len(chosen), count)) for n, chosen in sets.items()},
    )
    for m, state in enumerate(motions(unknown, count, MAX_RATE, seed)):
        told = Information(unknown, exact_readings(unknown, state, t, USUAL_NOISE * full), state)
        for i, noise in enumerate(NOISES):
            for j, period in enumerate(PERIODS_S):
                spread = told.covariance(
                    slice(None, None, period // finest), own, noise / USUAL_NOISE
                )
                speed[i, j, m], volume[i, j, m] = (
                    speed_sigma(spread, state.omega[0]),
                    rate_volume(spread),
                )
        for n, chosen in sets.items():
            for i, panels in enumerate(chosen):
                spread = told.covariance(slice(None, None, USUAL_PERIOD_S // finest), list(panels))
                by_panels[n][i, m] = speed_sigma(spread, state.omega[0])
    names = {
        n: [tuple(more.panel_names[p] for p in panels) for panels in chosen]
        for n, chosen in sets.items()
    }
    return Widths(speed, volume, by_panels, names)


class Near(Search):
    """The search of the posterior, begun from given motions instead of from all."""

    def __init__(self, start: State, workers: int | None) -> None:
        super().__init__(workers, None, False)
        self.start = start

    def starts(
        self, model: Model, data: Readings, chosen: Plan, scale: float
    ) -> tuple[State, np.ndarray]:
        """The given ones, each standing for itself, other unknowns at their centres."""
        return replace(self.start, u=np.zeros((len(self.start), len(model.unknowns)))), np.ones(
            len(self.start), dtype=np.int64
        )


def around(truth: State, period_s: float) -> State:
    """Starts on a grid of rates about a motion (one row), as far as `TURNS` turns in a period more or less."""
    step, radius = GRID_RAD / period_s, TURNS * 2 * np.pi / period_s
    axis = np.arange(-radius, radius + 0.5 * step, step)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    grid = np.concatenate([np.zeros((1, 3)), grid[np.linalg.norm(grid, axis=1) <= radius]])
    n = len(grid)
    return State(truth.omega + grid, np.tile(truth.sun, (n, 1)), np.empty((n, 0)))


def neighbours_left(
    vehicle: Vehicle, period_s: float, irregular: bool, i: int, seed: int, workers: int | None
) -> dict[str, Any]:
    """One twin: how many motions within a turn or so a period of the truth fit all samples, and the weight of the right one.

    Weights by Laplace's method; modes nearer to each other than a third of a turn a period, or than
    their own widths, are one motion.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1, i)))
    scale = vehicle.require_noise() / (USUAL_NOISE * float(vehicle.panel_gains.max()))
    unknown, _ = model(vehicle, {"max_rate_rad_s": 2.0} | AS_DRAWN, scale)
    state = motions(unknown, 1, ALIAS_RATE, int(rng.integers(2**31)))[0]
    t = np.arange(0.0, WINDOW_S + 1.0, period_s)
    jitter = rng.uniform(-IRREGULAR, IRREGULAR, len(t) - 1)
    t[1:] += period_s * jitter * irregular
    telemetry = synthetic_telemetry(
        vehicle, Truth(state.omega[0], state.sun[0], t, scale=scale), seed=int(rng.integers(2**31))
    )
    data, _, _ = readings(vehicle, telemetry)
    middle = np.arange(len(t) // 4, max(len(t) // 2, len(t) // 4 + 2))
    anchor = int(middle[np.argmax(data.lit[middle].sum(axis=1))])
    there = replace(unknown, after_s=float(data.t_s[anchor]))
    run = run_to(vehicle, unknown.rows(state), [there.after_s])
    truth = State(run["omega_B"][:, 0], run["sun_B"][:, 0], state.u)
    chosen = Plan(
        anchor, np.array([anchor - 1, anchor + 1]), GRID_RAD / period_s, truth.sun, there.max_rate
    )
    found = Near(around(truth, period_s), workers).modes(there, data.since(anchor), chosen, scale)
    log_weight = -found.objective - 0.5 * np.linalg.slogdet(found.hessian)[1]
    spread = np.linalg.inv(found.hessian)[:, :3, :3]
    apart = 2 * np.pi / period_s / 3
    label = linked(found.state.omega, spread, apart)
    names = np.unique(label)
    each = np.array([logsumexp(log_weight[label == name]) for name in names])
    weight = np.exp(each - logsumexp(each))
    off = found.state.omega - truth.omega[0]
    right = (np.linalg.norm(off, axis=1) < apart) | (
        np.einsum("ni,nij,nj->n", off, np.linalg.inv(spread), off) < NEAR_SIGMAS**2
    )
    of_true = np.isin(names, label[right])
    return {
        "period_s": period_s,
        "irregular": irregular,
        "twin": i,
        "samples": len(t),
        "motions": int((weight >= 0.01).sum()),
        "weight_of_true": float(weight[of_true].sum()),
        "omega": state.omega[0].tolist(),
    }


def linked(points: np.ndarray, covariance: np.ndarray, apart: float) -> np.ndarray:
    """Labels (n) of rates (n, 3) of which chains with gaps below `apart`, or within `LINK_SIGMAS` of both, are one.

    `covariance` (n, 3, 3): uncertain constants make one motion a long sheet, on which least squares stops in several places.
    """
    gap = points[:, None] - points[None]
    both = np.linalg.inv(covariance[:, None] + covariance[None])
    near = (np.linalg.norm(gap, axis=-1) < apart) | (
        np.einsum("abi,abij,abj->ab", gap, both, gap) < LINK_SIGMAS**2
    )
    return connected_components(csr_matrix(near), directed=False)[1]


def aliases(
    vehicle: Vehicle,
    out: Path,
    twins: int,
    seed: int = 0,
    periods: Sequence[float] = ALIAS_PERIODS_S,
    workers: int | None = None,
) -> list[dict[str, Any]]:
    """Those of `twins` twins at every period, regular and irregular, reading what is in `out` already."""
    rows_folder(out)
    rows = []
    for i in range(twins):
        for period in periods:
            for irregular in (False, True):
                path = (
                    out
                    / f"{seed}-{period:g}-{'irregular' if irregular else 'regular'}-{i:03d}.json"
                )
                rows.append(
                    kept(
                        path,
                        partial(
                            neighbours_left, vehicle, float(period), irregular, i, seed, workers
                        ),
                    )
                )
    return rows


@command
def main(arguments: list[str] | None = None) -> None:
    """Compute widths and aliases, and print what they say."""
    parser = argparse.ArgumentParser(
        prog="python -m sunspin.landing.sampling", description=main.__doc__
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("--twins", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--periods", type=lambda text: [float(x) for x in text.split(",")], default=ALIAS_PERIODS_S
    )
    parser.add_argument("--workers", type=int)
    given = parser.parse_args(arguments)
    craft = load_case("philae").vehicle
    found = widths(craft, seed=given.seed)
    usual = NOISES.index(USUAL_NOISE)
    for j, period in enumerate(PERIODS_S):
        speed, volume = (
            np.median(found.speed_by_noise[usual, j]),
            np.median(found.volume_by_noise[usual, j]),
        )
        print(
            f"period {period:4d} s: sigma of the angular speed {speed:.2g} rad/s, 90 % volume {volume:.2g} (rad/s)^3"
        )
    for n, values in found.speed_by_panels.items():
        each = np.median(values, axis=1)
        best = found.subsets[n][int(np.argmin(each))]
        said = f"median set {np.median(each):.2g}, worst {each.max():.2g}"
        print(f"{n} panels: best {each.min():.2g} rad/s ({', '.join(best)}), {said}")
    for row in aliases(craft, given.out, given.twins, given.seed, given.periods, given.workers):
        print(json.dumps(row))


if __name__ == "__main__":
    sys.exit(main())
