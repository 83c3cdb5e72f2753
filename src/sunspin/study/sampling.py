"""How often should a lander sample? What is known of the rotation against sampling period, noise and number of panels.

    python -m sunspin.study.sampling OUT --twins 2

Philae's body and wheel, 45 min of free motion, inertia, friction, wheel speed and brightness uncertain as the posterior assumes.
Widths come from Laplace's method (:mod:`sunspin.study.information`), over motions drawn from a ball of rates; whether one motion is
left or many, from full posteriors of twins, a file in OUT for each, so that the same command goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from sunspin.cases import load_case
from sunspin.infer.posterior import posterior
from sunspin.infer.posterior_model import Model, State, model
from sunspin.study.information import Information, exact_readings, rate_volume, speed_sigma
from sunspin.study.twin import Truth, twin
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

FULL_PERIODS_S, FULL_MAX_RATE = (30, 60, 120, 240, 480), 0.1
"""Full posteriors: periods and ball of rates (rad/s)."""

IRREGULAR = 0.05
"""Sample times are irregular by up to this part of the period in every second full posterior."""


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
    made = []
    for _ in range(count):
        direction = rng.standard_normal((2, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        rate = max_rate * rng.random() ** (1 / 3) * direction[:1]
        made.append(State(rate, direction[1:], np.zeros((1, len(unknown.unknowns)))))
    return made


def with_more_panels(vehicle: Vehicle) -> Vehicle:
    """The vehicle with cells on the sides that have none."""
    gain = float(np.mean(vehicle.panel_gains))
    return replace(vehicle, panels=(*vehicle.panels, *(Panel(name, np.array(normal), gain) for name, normal in MORE_PANELS)))


def widths(vehicle: Vehicle, count: int = MOTIONS, seed: int = 0) -> Widths:
    """Laplace's widths of `count` motions for all periods, noises and sets of panels."""
    more = with_more_panels(vehicle)
    unknown, _ = model(more, {"max_rate_rad_s": 2 * MAX_RATE}, 1.0)
    finest = int(PERIODS_S[0])
    t = np.arange(0.0, WINDOW_S + 0.5 * finest, finest)
    full = float(vehicle.panel_gains.max())
    own = list(range(len(vehicle.panels)))
    sets = {n: list(combinations(range(len(more.panels)), n)) for n in range(1, len(more.panels) + 1)}
    speed = np.empty((len(NOISES), len(PERIODS_S), count))
    volume, by_panels = np.empty_like(speed), {n: np.empty((len(chosen), count)) for n, chosen in sets.items()}
    for m, state in enumerate(motions(unknown, count, MAX_RATE, seed)):
        told = Information(unknown, exact_readings(unknown, state, t, USUAL_NOISE * full), state)
        for i, noise in enumerate(NOISES):
            for j, period in enumerate(PERIODS_S):
                spread = told.covariance(slice(None, None, period // finest), own, noise / USUAL_NOISE)
                speed[i, j, m], volume[i, j, m] = speed_sigma(spread, state.omega[0]), rate_volume(spread)
        for n, chosen in sets.items():
            for i, panels in enumerate(chosen):
                spread = told.covariance(slice(None, None, USUAL_PERIOD_S // finest), list(panels))
                by_panels[n][i, m] = speed_sigma(spread, state.omega[0])
    names = {n: [tuple(more.panel_names[p] for p in panels) for panels in chosen] for n, chosen in sets.items()}
    return Widths(speed, volume, by_panels, names)


def full_posterior(vehicle: Vehicle, period_s: float, irregular: bool, i: int, seed: int, workers: int | None) -> dict[str, Any]:
    """One twin's posterior at one period: how many motions are left, and whether the truth is the first of them."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1, i)))
    scale = vehicle.telemetry.noise / (USUAL_NOISE * float(vehicle.panel_gains.max()))
    unknown, _ = model(vehicle, None, scale)
    state = motions(unknown, 1, FULL_MAX_RATE, int(rng.integers(2**31)))[0]
    t = np.arange(0.0, WINDOW_S + 1.0, period_s)
    if irregular:
        t[1:] += rng.uniform(-IRREGULAR, IRREGULAR, len(t) - 1) * period_s
    telemetry = twin(vehicle, Truth(state.omega[0], state.sun[0], t, scale=scale), seed=int(rng.integers(2**31)))
    tree = posterior(vehicle, telemetry, {"max_rate_rad_s": FULL_MAX_RATE}, seed, draws=2000, workers=workers)
    modes, speed = tree["modes"], np.linalg.norm(tree["posterior"]["omega_B"].values.reshape(-1, 3), axis=1)
    off = state.omega[0] - modes["omega_B"].values
    spread = modes["omega_cov_B"].values + 1e-14 * np.eye(3)
    distance = [float(o @ np.linalg.solve(c, o)) ** 0.5 for o, c in zip(off, spread, strict=True)]
    weight = modes["weight"].values
    true = int(np.argmin(distance))
    return {
        "period_s": period_s, "irregular": irregular, "twin": i, "samples": len(t), "word": tree.attrs["verdict_word"],
        "modes": int((weight >= 0.01).sum()), "weight_of_true": float(weight[true]) if distance[true] < 4.5 else 0.0,
        "volume": float(sum(rate_volume(c) for c, w in zip(spread, weight, strict=True) if w >= 0.01)),
        "speed_sigma": float(speed.std()), "omega": state.omega[0].tolist(),
    }  # fmt: skip


def full_posteriors(
    vehicle: Vehicle, out: Path, twins: int, seed: int = 0, periods: Sequence[float] = FULL_PERIODS_S, workers: int | None = None
) -> list[dict[str, Any]]:
    """Those of `twins` twins at every period, regular and irregular, reading what is in `out` already."""
    out.mkdir(parents=True, exist_ok=True)
    rows = []
    for period in periods:
        for i in range(twins):
            for irregular in (False, True):
                path = out / f"{seed}-{period:g}-{'irregular' if irregular else 'regular'}-{i:03d}.json"
                if not path.is_file():
                    row = full_posterior(vehicle, float(period), irregular, i, seed, workers)
                    part = path.with_suffix(".part")
                    part.write_text(json.dumps(row), "utf-8")
                    part.replace(path)
                rows.append(json.loads(path.read_text("utf-8")))
    return rows


def main(arguments: list[str] | None = None) -> int:
    """Compute widths and full posteriors, and print what they say."""
    parser = argparse.ArgumentParser(prog="python -m sunspin.study.sampling", description=main.__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--twins", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--periods", type=lambda text: [float(x) for x in text.split(",")], default=FULL_PERIODS_S)
    parser.add_argument("--workers", type=int)
    given = parser.parse_args(arguments)
    craft = load_case("philae").vehicle
    found = widths(craft, seed=given.seed)
    usual = NOISES.index(USUAL_NOISE)
    for j, period in enumerate(PERIODS_S):
        speed, volume = np.median(found.speed_by_noise[usual, j]), np.median(found.volume_by_noise[usual, j])
        print(f"period {period:4d} s: sigma of the angular speed {speed:.2g} rad/s, 90 % volume {volume:.2g} (rad/s)^3")
    for n, values in found.speed_by_panels.items():
        each = np.median(values, axis=1)
        best = found.subsets[n][int(np.argmin(each))]
        said = f"median set {np.median(each):.2g}, worst {each.max():.2g}"
        print(f"{n} panels: best {each.min():.2g} rad/s ({', '.join(best)}), {said}")
    for row in full_posteriors(craft, given.out, given.twins, given.seed, given.periods, given.workers):
        print(json.dumps(row))
    return 0


if __name__ == "__main__":
    sys.exit(main())
