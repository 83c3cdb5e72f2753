"""Calibration of the posterior: simulated cases drawn from its own prior, and the share of the posterior that is likelier than the
truth.

Case i depends on seed and i alone. The kinds "known", "unknown" and "turned" (misaligned panels) are drawn from the prior that the
posterior is given. Telemetry of "swapped" and "wheel_off" follows another model, which the predictive check has to refuse.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sunspin.estimate.posterior.brightness import brightness
from sunspin.estimate.posterior.data import group, readings
from sunspin.estimate.posterior.estimate import DIRECTION_ERROR, posterior
from sunspin.estimate.posterior.likelihood import Likelihood
from sunspin.estimate.posterior.model import Model, State, model
from sunspin.estimation.synthetic import Truth, synthetic_telemetry
from sunspin.vehicle import Vehicle
from validation.truths import is_in_solutions

KINDS = {"known": 0, "unknown": 1, "swapped": 5, "wheel_off": 6, "turned": 8}
"""Kinds of cases, each with the number that seeds its draws."""

KNOWN = {"inertia": 0.0, "friction": 0.0, "wheel_speed": 0.0}

AS_DRAWN = {"tilt": 0.0, "tilt_common": 0.0}
TURNED = {"tilt": float(np.radians(1.0)), "tilt_common": float(np.radians(5.0))}
"""Sigmas of panel misalignment in rad that give E and Delta of Philae's descent as published; `AS_DRAWN` has none."""

JITTER_S = 6.0
"""Largest irregularity of sample times in s."""

NEAR_SIGMAS = 4.5
"""Largest distance of a solution from the truth, in sigmas of its rates, at which it counts as the true one."""


def rate_and_direction(max_rate: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw a rate (1, 3), uniform for |omega| < `max_rate`, and a direction (1, 3), uniform on the sphere."""
    direction = rng.standard_normal((2, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return max_rate * rng.random() ** (1 / 3) * direction[:1], direction[1:]


def prior_truth(unknown: Model, rng: np.random.Generator) -> State:
    """Draw a state from the prior at the first sample. The scale stays at its centre, as its prior is nearly flat."""
    omega, sun = rate_and_direction(unknown.max_rate, rng)
    u = rng.standard_normal((1, len(unknown.unknowns)))
    u[:, unknown.where("scale")] = 0.0
    return State(omega, sun, u)


class SimulatedCase(NamedTuple):
    """Telemetry of a case, its true state, the model it was drawn from, and the priors for the posterior."""

    telemetry: xr.Dataset
    truth: State
    unknown: Model
    priors: dict[str, Any]


def make(
    vehicle: Vehicle, kind: str, max_rate: float, samples: int, interval_s: float, seed: int, i: int
) -> SimulatedCase:
    """Return telemetry of case i, its truth, the model it was drawn from, and the priors that the posterior is given.

    No torque acts, and the priors say so; `validation/torques.py` covers torques. `max_rate` is in rad/s. Intervals vary by
    `JITTER_S`, or by a quarter if they are short.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i, KINDS[kind])))
    priors: dict[str, Any] = {"max_rate_rad_s": max_rate, "steady_torque": 0.0} | (
        KNOWN if kind == "known" else {}
    )
    priors |= TURNED if kind == "turned" else AS_DRAWN
    # full Sun is so bright that the stated noise is 2 % of the largest panel's signal
    scale = vehicle.require_noise() / (0.02 * float(vehicle.panel_gains.max()))
    unknown, _ = model(vehicle, priors, scale)
    truth = prior_truth(unknown, rng)
    t = interval_s * np.arange(samples) + np.concatenate(
        [[0.0], rng.uniform(-1, 1, samples - 1)]
    ) * min(JITTER_S, interval_s / 4)
    noise = vehicle.require_noise() * float(np.exp(unknown.relative(truth.u, "noise", 1)[0, 0]))
    speeds = unknown.wheel_speeds(truth.u)[0] * (0.0 if kind == "wheel_off" else 1.0)
    # rotation vectors (n_panel, 3) of the panels
    tilt = 0.0 if unknown.turns is None else np.tensordot(truth.u[0], unknown.turns, axes=1)
    truth_of_case = Truth(
        truth.omega[0], truth.sun[0], t, speeds, scale=scale, noise=noise, tilt_B_rad=tilt
    )
    telemetry = synthetic_telemetry(
        unknown.bodies(truth.u).vehicle(vehicle, 0), truth_of_case, seed=int(rng.integers(2**31))
    )
    if kind == "swapped":
        value = telemetry["power_W" if "power_W" in telemetry else "current_A"].values
        a, b = rng.choice(value.shape[1], 2, replace=False)
        value[:, [a, b]] = value[:, [b, a]]
    return SimulatedCase(telemetry, truth, unknown, priors)


def judge(
    vehicle: Vehicle,
    telemetry: xr.Dataset,
    truth: State,
    unknown: Model,
    priors: dict[str, Any],
    seed: int,
) -> dict[str, Any]:
    """Run the posterior on a case and return its verdict and a comparison with the truth.

    "level": share of draws with a higher density than the truth. "listed": the truth is in the list that a user reads. "recalled":
    a solution is within `NEAR_SIGMAS` of it. "error" and "sigma" of the rate in rad/s.
    """
    tree = posterior(vehicle, telemetry, priors, seed, workers=1)
    draws, solutions = group(tree, "posterior"), group(tree, "solutions")
    # u of the draws, in the order of the model that knows the scale's centre
    data, _, _ = readings(vehicle, telemetry)
    model_, _ = model(vehicle, priors, brightness(vehicle, data))
    u = np.stack([_draws_of_unknown(draws, x.name) for x in model_.unknowns], axis=1)
    centre, sigma = (
        np.array([getattr(x, key) for x in model_.unknowns]) for key in ("centre", "sigma")
    )
    drawn = State(draws["omega_B"].values[0], draws["sun_B"].values[0], (u - centre) / sigma)
    # the true state in the units of this model, whose scale has another centre
    true_u = np.array(truth.u)
    for i in model_.where("scale"):
        true_u[:, i] = (unknown.values(truth.u)[:, i] - centre[i]) / sigma[i]
    true_state = State(truth.omega, truth.sun, true_u)
    likelihood = Likelihood(
        replace(model_, time_sigma_s=tree.attrs["time_sigma_s"]), data, DIRECTION_ERROR
    )
    density = draws["log_likelihood_sum"].values[0] + model_.log_prior(drawn)
    true_density = float(likelihood(true_state)[0] + model_.log_prior(true_state)[0])
    off = truth.omega[0] - solutions["omega_B"].values
    # 1e-14 (rad/s)^2 keeps the covariance of a solution without spread invertible
    covariance = solutions["omega_cov_B"].values + 1e-14 * np.eye(3)
    distance = np.sqrt(np.einsum("mi,mij,mj->m", off, np.linalg.inv(covariance), off))  # sigmas
    return {
        "level": float(np.mean(density > true_density)),
        "listed": is_in_solutions(solutions, truth.omega[0]),
        "recalled": bool(distance.min() < NEAR_SIGMAS),
        "word": tree.attrs["verdict_word"],
        "verdict": tree.attrs["verdict"],
        "error": float(np.min(np.linalg.norm(off, axis=1))),
        "sigma": float(np.sqrt(np.trace(covariance[0]))),
    }


def _draws_of_unknown(draws: xr.Dataset, name: str) -> np.ndarray:
    """Return the draws (n) of an unknown by its name; the speed of the only wheel is in a variable of all wheels."""
    return (
        draws["wheel_speed_rad_s"].values[0][:, 0]
        if name.startswith("wheel_speed")
        else draws[name].values[0]
    )
