"""The posterior compared with two samplers of other authors, nautilus and emcee, on simulated cases.

    python -m studies.sampler_comparison KIND CASE ... [--walk]

KIND is one of `known` (Philae; inertia, friction and wheel known), `cubesat` (3U, no wheel), `unknown` (Philae; everything
unknown) and `mirror` (a 1U with side panels only: a solution and its mirror solution). CASE is the number of a simulated case. The
study prints, for each solution, log evidence, quantiles of the angular speed and sigmas of the rates. It needs nautilus-sampler 1.0
and, for `--walk`, emcee 3.1. Neither is a dependency of sunspin.

Only the likelihood and the priors of the nuisance parameters are shared. In sunspin's posterior, rates and Sun direction are those
at a reference time; here they are those at the first sample, and the direction has another map.

nautilus (nested importance sampling with neural networks) fills a box around each solution: eight sigmas to each side, along the
axes of the covariance of sunspin's draws. Only the place and the size of the box come from these draws. emcee (an ensemble of
walkers) starts from the draws.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.special import logsumexp

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.cases import load_case
from sunspin.estimate.lander.model import LanderModel
from sunspin.estimate.lander.motions import LanderMotions
from sunspin.estimate.lander.priors import with_priors
from sunspin.estimate.lander.window import observe_window
from sunspin.telemetry.assess import assess
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from validation.calibrate import make
from validation.campaign import command, study_parser

HALF_WIDTH = 8.0
"""Sigmas from the mean of a solution to each face of its box."""

LIVE_POINTS, EFFECTIVE_DRAWS, DRAWS = 800, 3000, 8000
"""Of nautilus: live points, effective draws at which it stops, draws of equal weight that are taken from it."""

WALKERS, STEPS, BURN_IN = 120, 1500, 500
"""Of emcee: walkers, steps of each, and steps that are left out at the beginning."""

DIRECTION_ERROR = 1e-6
"""Error of directions (rad) in the likelihood."""

LOWEST = -1e6
"""Log posterior outside the support, in place of minus infinity, with which nautilus cannot train its networks."""

LEAST_PROBABILITY = 0.01
"""Solutions with a lower probability are not compared."""

SIDES = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0)}


def cubesat() -> Vehicle:
    """Return a 3U CubeSat without a panel on -z: moments of inertia known to 1 %, noise of 2 % of the largest panel."""
    normals = SIDES | {"+z": (0, 0, 1)}
    panels = [Panel(name, normal, 2.3 if "z" in name else 7.0) for name, normal in normals.items()]
    form = TelemetryForm(quantity="power_W", noise=0.14)
    inertia = np.diag([0.042, 0.040, 0.009])
    return Vehicle("3U", inertia_kg_m2=inertia, panels=panels, gain_unit="W", telemetry=form)


def side_panels() -> Vehicle:
    """Return a 1U with panels on four sides only, which cannot distinguish a motion from its mirror image; noise of 2 %."""
    panels = [Panel(name, normal, 1.0) for name, normal in SIDES.items()]
    form = TelemetryForm(quantity="current_A", noise=0.02)
    inertia = np.diag([0.0022, 0.0024, 0.0019])
    return Vehicle("1U", inertia_kg_m2=inertia, panels=panels, telemetry=form)


def philae() -> Vehicle:
    """Return the vehicle of the built-in case."""
    return load_case("philae").vehicle


class Setting(NamedTuple):
    """How cases of one kind are simulated: vehicle, kind in `validation.calibrate`, largest rate (rad/s), samples, interval (s)."""

    vehicle: Callable[[], Vehicle]
    calibration: str
    max_rate_rad_s: float
    samples: int
    interval_s: float


SETTINGS = {
    "known": Setting(philae, "known", 0.25, 16, 20.0),
    "cubesat": Setting(cubesat, "unknown", 0.3, 16, 12.0),
    "unknown": Setting(philae, "unknown", 0.25, 16, 20.0),
    "mirror": Setting(side_panels, "unknown", 0.2, 20, 12.0),
}


class Coordinates:
    """Linear coordinates, in sigmas, around the mean of states of equal weight.

    Rates and nuisance parameters are taken as they are, the Sun direction by Lambert's equal-area map around its mean. `mean` and
    `root` are the mean and the Cholesky factor of the covariance of these values.
    """

    def __init__(self, state: LanderMotions) -> None:
        direction = state.sun.mean(axis=0)
        direction /= np.linalg.norm(direction)
        across = np.linalg.svd(direction[None])[2][1:]  # two unit vectors at right angles to it
        self.frame = np.stack([*across, direction])
        x = self.mapped(state)
        self.mean = x.mean(axis=0)
        # 1e-16 keeps the covariance of almost fixed values positive definite
        self.root = np.linalg.cholesky(np.cov(x.T) + 1e-16 * np.eye(x.shape[1]))

    def mapped(self, state: LanderMotions) -> np.ndarray:
        """Return rates, mapped Sun direction and nuisance parameters (n, D) of states."""
        components = state.sun @ self.frame.T
        stretch = np.sqrt(2.0 / np.maximum(1.0 + components[:, 2:], 1e-12))
        return np.concatenate([state.omega, stretch * components[:, :2], state.u], axis=1)

    def sigmas(self, state: LanderMotions) -> np.ndarray:
        """Return the coordinates (n, D) of states."""
        return np.linalg.solve(self.root, (self.mapped(state) - self.mean).T).T

    def states(self, y: np.ndarray) -> tuple[LanderMotions, np.ndarray]:
        """Return the states at coordinates (n, D), and a mask (n) of those inside the map, which ends at the antipode."""
        x = self.mean + y @ self.root.T
        square = np.sum(x[:, 3:5] ** 2, axis=1)
        inside = square < 4.0  # the map is a disk of radius 2
        square = np.minimum(square, 4.0)
        across = np.sqrt(1.0 - square / 4)[:, None] * x[:, 3:5]
        along = (1.0 - square / 2)[:, None]
        sun = np.concatenate([across, along], axis=1) @ self.frame
        return LanderMotions(
            x[:, :3], sun / np.linalg.norm(sun, axis=1, keepdims=True), x[:, 5:]
        ), inside

    @property
    def log_volume(self) -> float:
        """Log volume of a unit cube of the coordinates."""
        return float(np.log(np.diag(self.root)).sum())


def log_posterior(model: LanderModel, state: LanderMotions, inside: np.ndarray) -> np.ndarray:
    """Return log prior plus log likelihood (n) of states; `LOWEST` outside the support, and where the mask `inside` is false."""
    prior = model.log_prior_density(state)
    support = np.flatnonzero(np.isfinite(prior) & inside)
    values = np.full(len(state), LOWEST)
    if len(support):
        some = state.take(support)
        carried = model.sun_states(some, DIRECTION_ERROR)
        values[support] = prior[support] + model.log_likelihood(carried, some.u)
    return np.where(np.isfinite(values), values, LOWEST)


def nautilus_in_box(
    model: LanderModel, coordinates: Coordinates, seed: int = 1
) -> tuple[float, LanderMotions, int]:
    """Return log evidence, draws and number of calls of the likelihood by nautilus, in the box around a solution."""
    from nautilus import Sampler

    dimensions = len(coordinates.mean)

    def states(unit_cube: np.ndarray) -> tuple[LanderMotions, np.ndarray]:
        return coordinates.states((2 * unit_cube - 1) * HALF_WIDTH)

    sampler = Sampler(
        lambda unit_cube: unit_cube,
        lambda unit_cube: log_posterior(model, *states(unit_cube)),
        n_dim=dimensions,
        n_live=LIVE_POINTS,
        vectorized=True,
        pass_dict=False,
        seed=seed,
        n_networks=1,
    )
    sampler.run(n_eff=EFFECTIVE_DRAWS, discard_exploration=True)
    points, log_weight, _ = sampler.posterior()
    weight = np.exp(log_weight - logsumexp(log_weight))
    drawn = points[np.random.default_rng(seed).choice(len(points), DRAWS, p=weight)]
    # nautilus integrates over a unit cube: the volume of the box is that of the cube of 2 HALF_WIDTH sigmas
    evidence = float(sampler.log_z) + dimensions * np.log(2 * HALF_WIDTH) + coordinates.log_volume
    return evidence, states(drawn)[0], sampler.n_like


def emcee_from(
    model: LanderModel, coordinates: Coordinates, state: LanderMotions
) -> tuple[LanderMotions, float]:
    """Return the states that the walkers of emcee reach from some of these draws, and the longest correlation time in steps."""
    import emcee

    chosen = np.random.default_rng(2).choice(len(state), WALKERS, replace=False)
    start = coordinates.sigmas(state)[chosen]
    moves = [
        (emcee.moves.DEMove(), 0.8),
        (emcee.moves.DESnookerMove(), 0.1),
        (emcee.moves.StretchMove(), 0.1),
    ]
    sampler = emcee.EnsembleSampler(
        WALKERS,
        start.shape[1],
        lambda y: log_posterior(model, *coordinates.states(y)),
        moves=moves,
        vectorize=True,
    )
    sampler.random_state = np.random.RandomState(3).get_state()
    sampler.run_mcmc(start, STEPS)
    correlation = sampler.get_autocorr_time(discard=BURN_IN, quiet=True)
    chain = sampler.get_chain(discard=BURN_IN, flat=True, thin=10)
    return coordinates.states(chain)[0], float(np.max(correlation))


def state_of_draws(model: LanderModel, draws: xr.Dataset) -> LanderMotions:
    """Return the draws of a posterior as states, their nuisance parameters (n, k) in sigmas of the prior."""
    u = np.zeros((draws.sizes["draw"], len(model.unknowns)))
    for i, unknown in enumerate(model.unknowns):
        if unknown.kind == "wheel_speed":  # one variable for all wheels
            value = draws["wheel_speed_rad_s"].values[0, :, unknown.index]
        else:
            value = draws[unknown.name].values[0]
        u[:, i] = (value - unknown.centre) / unknown.sigma
    return LanderMotions(draws["omega_B"].values[0], draws["sun_B"].values[0], u)


def summary(omega: np.ndarray) -> str:
    """Return 5, 50 and 95 % quantiles of the angular speed and the sigmas of rates (n, 3) in rad/s, as text in 1e-3 rad/s."""
    quantiles = 1e3 * np.quantile(np.linalg.norm(omega, axis=1), [0.05, 0.5, 0.95])
    speed = " ".join(f"{quantile:8.2f}" for quantile in quantiles)
    sigmas = " ".join(f"{sigma:6.3f}" for sigma in 1e3 * omega.std(axis=0))
    return f"|omega| {speed}; sigmas {sigmas}"


def compare(kind: str, case: int, walk: bool) -> None:
    """Print the comparison for one simulated case; emcee is included if `walk` is true."""
    setting = SETTINGS[kind]
    craft, max_rate = setting.vehicle(), setting.max_rate_rad_s
    telemetry, _, priors = make(
        craft, setting.calibration, max_rate, setting.samples, setting.interval_s, 0, case
    )
    begin = time.process_time()
    tree = ss.posterior(craft, telemetry, priors, seed=0, workers=1)
    took = time.process_time() - begin
    print(f"{kind} {case}: {tree.attrs['verdict']}; k {tree.attrs['pareto_k']:.2f}; {took:.0f} s")
    assessment = assess(craft, telemetry)
    model, _ = with_priors(assessment, observe_window(assessment), priors)
    draws, solutions = tree["posterior"].to_dataset(), tree["solutions"]
    state, solution_id = state_of_draws(model, draws), draws["solution_id"].values[0]
    # sunspin's prior of the rates is uniform in the searched ball at its reference time, that of the box in the ball of max_rate
    log_volume_ratio = 3 * np.log(tree.attrs["searched_rate_rad_s"] / max_rate)
    probability = solutions["probability"].values
    evidence = solutions["log_evidence"].values + log_volume_ratio
    listed = np.flatnonzero(probability > LEAST_PROBABILITY)
    begin, box_evidence = time.process_time(), []
    for m in listed:
        in_solution = state.take(solution_id == m)
        coordinates = Coordinates(in_solution)
        log_evidence, drawn, calls = nautilus_in_box(model, coordinates)
        box_evidence.append(log_evidence)
        took = time.process_time() - begin
        values = f"sunspin {evidence[m]:.2f}, nautilus {log_evidence:.2f}"
        print(f"  solution {m}: log evidence {values} ({calls} calls, {took:.0f} s)")
        print(
            f"    sunspin  {summary(in_solution.omega)}\n    nautilus {summary(drawn.omega)}",
            flush=True,
        )
        if walk:
            walked, steps = emcee_from(model, coordinates, in_solution)
            print(
                f"    emcee    {summary(walked.omega)}; correlation {steps:.0f} steps", flush=True
            )
    # probability of each solution by nautilus: its share of the evidence
    box_share = np.exp(np.array(box_evidence) - logsumexp(box_evidence))
    by_sunspin, by_nautilus = np.round(probability[listed], 3), np.round(box_share, 3)
    print(f"  probabilities: sunspin {by_sunspin}, nautilus {by_nautilus}", flush=True)


@command
def main(arguments: list[str] | None = None) -> None:
    parser = study_parser("sampler_comparison", __doc__)
    parser.add_argument("kind", choices=SETTINGS, help="kind of the simulated cases")
    parser.add_argument("cases", type=int, nargs="+", help="numbers of the simulated cases")
    parser.add_argument("--walk", action="store_true", help="run emcee too")
    given = parser.parse_args(arguments)
    needed = {"nautilus": "nautilus-sampler"} | ({"emcee": "emcee"} if given.walk else {})
    missing = [package for module, package in needed.items() if find_spec(module) is None]
    if missing:
        do = f"pip install {' '.join(missing)}"
        raise InputError("the samplers of this comparison are not installed", do=do)
    for case in given.cases:
        compare(given.kind, case, given.walk)


if __name__ == "__main__":
    sys.exit(main())
