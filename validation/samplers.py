"""The sampler along exact ridges, compared with that of the present posterior on the same fitted motions.

Both are given the same likelihood, readings and motions. Cases: Philae with unknown moments, friction and wheel speed, 20 s and
120 s apart; boxes without and with an unmodelled torque; Philae's own telemetry. Results lie in a folder, a file a case and seed.

    python -m validation.samplers FOLDER --case twin-0 box-3 --seed 0 1
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from scipy.special import logsumexp

from sunspin.cases import load_case
from sunspin.estimate.posterior import estimate
from sunspin.estimate.posterior.family import apart
from sunspin.estimate.posterior.fit import _turned
from sunspin.estimate.posterior.hypotheses import Hypothesis, Sampled
from sunspin.estimate.posterior.hypotheses import mixed as mixed_sheets
from sunspin.estimate.posterior.likelihood import Likelihood, Prediction
from sunspin.estimate.posterior.model import State
from sunspin.estimation.lander.motions import ShotFit, Shots
from sunspin.estimation.lander.ridges import Equations, Slopes
from sunspin.estimation.lander.sample import mixed, sample
from sunspin.estimation.model import Unknown
from sunspin.estimation.settings import SAMPLING
from sunspin.vehicle import Vehicle
from validation import torques
from validation.calibrate import make

STANDING = ("scale", "gain", "tilt", "tilt_common")
"""Kinds of unknowns that change the readings alone, nearly in proportion."""


LEAST_TURN_RAD = 1e-3
"""Steps that turn the body by less within the window correct no derivatives: runs are good to 1e-5 rad."""


@dataclass(frozen=True)
class SheetTarget:
    """Readings and model of the present posterior, as `sunspin.estimation.lander.sample` asks for them."""

    likelihood: Likelihood

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the unknowns, a torque with its sizes."""
        model = self.likelihood.model
        return tuple(
            Unknown(
                x.name,
                x.kind,
                x.unit,
                x.centre,
                x.sigma,
                x.index,
                shares=model.shares if x.kind == "steady_torque" else (1.0,),
            )
            for x in model.unknowns
        )

    @property
    def standing(self) -> np.ndarray:
        """Return the places of unknowns that change the readings alone."""
        every = enumerate(self.likelihood.model.unknowns)
        return np.array([i for i, x in every if x.kind in STANDING], dtype=np.int64)

    @property
    def bending(self) -> np.ndarray:
        """Return the places of unknowns that change the motion."""
        return np.array(self.likelihood.model.moving, dtype=np.int64)

    @property
    def reach_s(self) -> float:
        """Return the time from the reference to the farthest sample."""
        return self.likelihood.data.reach_s

    @property
    def rate_max(self) -> float:
        """Return the largest rate (rad/s)."""
        return self.likelihood.model.max_rate

    def linearised(
        self, shots: Shots, slopes: Slopes | None = None, wider: float = 1.0
    ) -> Equations:
        """Return the equations in rate, direction and standing unknowns."""
        likelihood, state = self.likelihood, _state(shots)
        if slopes is None:
            found = likelihood.linearised(state, still=True)
        else:
            before = State(slopes.omega, slopes.sun, slopes.u)
            step = apart(state, before)[:, :5]
            bending = self.bending
            alike = np.all(state.u[:, bending] == slopes.u[:, bending], axis=1)
            # what the unknowns have changed is not due to the step; after a tiny one the error of the runs is
            turn = np.maximum(
                np.linalg.norm(step[:, :3], axis=1) * self.reach_s,
                np.linalg.norm(step[:, 3:], axis=1),
            )
            step = np.where((alike & (turn > LEAST_TURN_RAD))[:, None], step, 0.0)
            turned = _turned(before.sun, state.sun, slopes.moves, slopes.seen, step)
            found = likelihood.linearised(state, True, *turned)
        places = np.append(np.arange(5), 5 + self.standing)
        cost, sigma, weight = likelihood.weigh(
            found.raw, found.extra, wider * likelihood.noise(state.u)
        )
        root = np.sqrt(weight) / sigma
        residual, scaled = root * found.raw, root[:, :, None] * found.jacobian[:, :, places]
        matrix = np.swapaxes(scaled, 1, 2) @ scaled
        matrix[:, range(5, len(places)), range(5, len(places))] += 1.0
        slope = np.einsum("nri,nr->ni", scaled, residual)
        slope[:, 5:] += state.u[:, self.standing]
        cost = cost + np.sum(state.u**2 * likelihood.model.precision, axis=1) / 2
        fine = found.prediction.fine & np.isfinite(found.raw).all(axis=1)
        seen = found.prediction.seen
        return Equations(
            np.where(fine, cost, np.inf),
            slope,
            matrix,
            Slopes(state.omega, state.sun, state.u, found.moves, seen),
        )

    def run(self, shots: Shots) -> Prediction:
        """Return what the sensors see."""
        return self.likelihood.predict(_state(shots))

    def standing_slopes(
        self, seen: Prediction, u: np.ndarray, wider: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return slope and curvature of the log likelihood in the standing unknowns."""
        likelihood = self.likelihood
        raw, extra = likelihood.misfit(seen, u)
        _, sigma, weight = likelihood.weigh(raw, extra, wider * likelihood.noise(u))
        throttle = likelihood.throttle(likelihood.light(seen.sun, u))
        counts = likelihood.data.used & (
            likelihood.data.lit | (throttle.power > likelihood.data.threshold)
        )
        changes = likelihood._standing(seen, u, throttle)
        columns = [likelihood._column(changes(int(i)), counts) for i in self.standing]
        root = np.sqrt(weight) / sigma * seen.fine[:, None]
        scaled = root[:, :, None] * np.stack(columns, axis=-1)
        scaled = np.where(np.isfinite(scaled), scaled, 0.0)
        residual = np.where(np.isfinite(raw), root * raw, 0.0)
        return -np.einsum("nri,nr->ni", scaled, residual), np.swapaxes(scaled, 1, 2) @ scaled

    def log_likelihood(self, seen: Prediction, u: np.ndarray) -> np.ndarray:
        """Return the log likelihood."""
        return self.likelihood.of(seen, u)

    def log_prior(self, shots: Shots) -> np.ndarray:
        """Return the log prior density."""
        return self.likelihood.model.log_prior(_state(shots))


def _state(shots: Shots) -> State:
    """Return motions as the present posterior has them."""
    return State(shots.omega, shots.sun, shots.u)


def fit_of(one: Hypothesis) -> tuple[ShotFit, np.ndarray]:
    """Return the motions (K) that were fitted under a model, and the part (K, m) of each sigma under which each was."""
    modes = one.modes
    motions = Shots(modes.state.omega, modes.state.sun, modes.state.u, modes.objective)
    least = 1e-9 * np.eye(modes.hessian.shape[1])
    mass = -modes.objective - np.linalg.slogdet(modes.hessian + least)[1] / 2
    fit = ShotFit(None, motions, modes.hessian, mass, modes.hits)  # ty: ignore[invalid-argument-type]
    under = np.ones_like(motions.u)
    under[:, one.likelihood.model.where("steady_torque")] = modes.share[:, None]
    return fit, under


Made = tuple[Vehicle, xr.Dataset, dict[str, Any] | None]
"""Vehicle, telemetry, and the priors that a posterior is given."""


def cases() -> dict[str, Callable[[], Made]]:
    """Return the cases by name."""
    craft = load_case("philae").vehicle
    every: dict[str, Callable[[], Made]] = {
        "philae": lambda: (craft, load_case("philae").telemetry, None)
    }

    def philae(kind: str, most: float, samples: int, apart_s: float, i: int) -> Made:
        made = make(craft, kind, most, samples, apart_s, 0, i)
        return craft, made.telemetry, made.priors

    def box(level: str, i: int) -> Made:
        made = torques.make(level, 0, i)
        return torques.BOX, made.telemetry, made.priors

    for i in (0, 3, 8, 14, 15, 16, 18, 25):
        every[f"twin-{i}"] = partial(philae, "unknown", 0.25, 16, 20.0, i)
    for kind, i in (("turned", 0), ("turned", 3), ("unknown", 7), ("unknown", 23)):
        every[f"two-{kind}-{i}"] = partial(philae, kind, 0.3, 23, 120.0, i)
    for i in range(6):
        every[f"box-{i}"] = partial(box, "0", i)
    for i in range(5):
        every[f"torque-{i}"] = partial(box, "1e-2", i)
    return every


def found_models(made: Made) -> list[Hypothesis]:
    """Return the models of a posterior with their fitted motions, the nominal one first."""
    kept: list[list[Sampled]] = []
    together = estimate._together

    def keeping(tried: list[Sampled], *more: Any) -> Any:
        kept.append(tried)
        return together(tried, *more)

    estimate._together = keeping
    try:
        estimate.posterior(*made, 0, workers=1)
    finally:
        estimate._together = together
    return [one.hypothesis for one in kept[-1]]


def by_sheets(models: list[Hypothesis], seed: int) -> tuple[dict[str, Any], list[float]]:
    """Return the result of the present sampler, and the log evidence of each model."""
    began, search = time.process_time(), estimate.Search(1, None, False)
    with estimate.Effort(estimate.MOST_EFFORT):
        drawn = estimate._sampled(models[:1], seed, search, 1.0)
        drawn += estimate._sampled(models[1:], seed, search, estimate.OTHERS_DRAWS, drawn[0])
    took, mix = time.process_time() - began, mixed_sheets(drawn)
    row = {"evidence": mix.evidence, "effective": mix.effective, "tail": mix.tail}
    return row | {"share": mix.share[:8].tolist(), "processor_s": took}, [
        one.drawn.evidence for one in drawn
    ]


def by_ridges(models: list[Hypothesis], seed: int) -> tuple[dict[str, Any], list[float]]:
    """Return the result of the sampler along exact ridges, and the log evidence of each model."""
    began, drawn = time.process_time(), []
    for i, one in enumerate(models):
        fit, under = fit_of(one)
        # models beside the nominal one get half the draws, as in the present posterior
        settings = SAMPLING if i == 0 else replace(SAMPLING, draws=1000, wanted=1500.0)
        rng = np.random.default_rng([seed, i])
        drawn.append(sample(SheetTarget(one.likelihood), fit, rng, settings, under=under))
    mix = mixed(drawn, [one.log_prior for one in models], models[0].likelihood.data.reach_s)
    weight = np.exp(mix.log_weight - logsumexp(mix.log_weight))
    row = {"evidence": mix.evidence, "effective": mix.effective, "tail": mix.tail}
    row |= {"outside": mix.outside, "share": np.bincount(mix.region, weights=weight)[:8].tolist()}
    return row | {"processor_s": time.process_time() - began}, [one.evidence for one in drawn]


def compare(name: str, models: list[Hypothesis], seed: int, folder: Path) -> None:
    """Write and print the results of both samplers."""
    row: dict[str, Any] = {"case": name, "seed": seed, "models": [one.what for one in models]}
    for kind, sampler in (("ridges", by_ridges), ("sheets", by_sheets)):
        row[kind], row[f"{kind}_evidence"] = sampler(models, seed)
    (folder / f"{name}-{seed}.json").write_text(json.dumps(row, indent=1))
    print(line(row), flush=True)


def line(row: dict[str, Any]) -> str:
    """Return the row of a table: k, effective draws, share of walkers outside, difference of evidence, and processor time."""
    new, old = row["ridges"], row["sheets"]
    return (
        f"| {row['case']}, {row['seed']} | {old['tail']:.2f} | {new['tail']:.2f} | {old['effective']:.0f} | "
        f"{new['effective']:.0f} | {new['outside']:.3f} | {new['evidence'] - old['evidence']:+.3f} | "
        f"{old['processor_s']:.1f} | {new['processor_s']:.1f} | {np.round(new['share'][:4], 2).tolist()} |"
    )


def main(arguments: list[str] | None = None) -> None:
    """Compare the samplers on some cases."""
    parser = argparse.ArgumentParser(prog="python -m validation.samplers", description=__doc__)
    parser.add_argument(
        "folder", type=Path, help="where results are written, a file a case and seed"
    )
    parser.add_argument("--case", nargs="+", default=list(cases()), help="names of cases")
    parser.add_argument("--seed", nargs="+", type=int, default=[0, 1], help="seeds of the samplers")
    given = parser.parse_args(arguments)
    given.folder.mkdir(parents=True, exist_ok=True)
    for name in given.case:
        models = found_models(cases()[name]())
        for seed in given.seed:
            compare(name, models, seed, given.folder)


if __name__ == "__main__":
    sys.exit(main())
