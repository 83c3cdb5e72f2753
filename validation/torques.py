"""Posteriors of simulated cases with an unmodelled steady torque, or with moments of inertia that differ from the stated ones.

The body is a box with six panels and no wheel, so that a posterior takes seconds. Case i of a level depends on seed, level and i
alone. Cases with even numbers have their torque fixed in body axes, the others in space.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.stats import chi2

from sunspin import posterior
from sunspin.base.errors import SunspinError
from sunspin.dynamics.torques import Steady
from sunspin.estimate.synthetic import Truth, synthetic_telemetry
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from validation.calibrate import AS_DRAWN, draw_from_prior
from validation.truths import WRONG_SIGMAS, is_in_solutions

LEVELS = {
    "0": (0.0, 0.0),
    "1e-4": (1e-4, 0.0),
    "1e-3": (1e-3, 0.0),
    "3e-3": (3e-3, 0.0),
    "1e-2": (1e-2, 0.0),
    "inertia": (0.0, 0.05),
}
"""Levels by name: change of the rate by the torque over the window in rad/s, and relative error of the stated moments."""

SAMPLES, INTERVALS_S, TURN = 20, (10.0, 60.0), 2.5
"""Number of samples, range of their intervals in s (log-uniform), and largest rotation within an interval in rad."""

NORMALS = np.kron(np.eye(3), [[1], [-1]])

BOX = Vehicle(
    "box",
    inertia_kg_m2=np.diag([0.010, 0.012, 0.008]),
    panels=[
        Panel(name, n, 1.0) for name, n in zip("+x -x +y -y +z -z".split(), NORMALS, strict=True)
    ],
    telemetry=TelemetryForm(quantity="current_A", noise=0.02),
)


class SimulatedCase(NamedTuple):
    """Telemetry of a case, its true rate (3) in rad/s at the first sample, and the priors for the posterior."""

    telemetry: xr.Dataset
    omega_B: np.ndarray
    priors: dict[str, Any]


def make(level: str, seed: int, i: int) -> SimulatedCase:
    """Return the telemetry of case i with its true rate and the priors that the posterior is given."""
    change, moment_sigma = LEVELS[level]
    rng = np.random.default_rng(
        np.random.SeedSequence(seed, spawn_key=(i, list(LEVELS).index(level)))
    )
    interval = float(np.exp(rng.uniform(*np.log(INTERVALS_S))))
    jitter = np.concatenate([[0.0], rng.uniform(-1, 1, SAMPLES - 1)])
    t = interval * np.arange(SAMPLES) + jitter * interval / 4
    priors = {"max_rate_rad_s": min(0.25, TURN / interval)} | AS_DRAWN
    scale = BOX.require_noise() / (0.02 * float(BOX.panel_gains.max()))
    truth = draw_from_prior(BOX, priors, scale, rng)
    moments = np.array(truth.vehicle.require_inertia())
    moments[np.diag_indices(3)] *= 1 + moment_sigma * rng.standard_normal(3)
    body = replace(truth.vehicle, inertia_kg_m2=moments)
    # the torque (N m) that changes the rate by `change` about an axis with the mean moment
    torque = rng.standard_normal(3)
    torque *= change / (t[-1] - t[0]) * np.trace(moments) / 3 / np.linalg.norm(torque)
    # rows: fixed in body axes, fixed in space
    steady = Steady(np.stack([torque, np.zeros(3)] if i % 2 == 0 else [np.zeros(3), torque]))
    truth_of_case = Truth(
        truth.omega_B,
        truth.sun_B,
        t,
        truth.wheel_speeds,
        scale=scale,
        noise=BOX.require_noise(),
        torques=[steady] if change else [],
    )
    return SimulatedCase(
        synthetic_telemetry(body, truth_of_case, seed=int(rng.integers(2**31))),
        truth.omega_B,
        priors,
    )


def judge(level: str, seed: int, i: int) -> dict[str, Any]:
    """Run the posterior on a case and return its verdict and its distance from the truth.

    "wrong": the verdict is confident, and no solution of 1 % or more is within `WRONG_SIGMAS` of the truth. "level": probability
    of a smaller distance than that of the nearest solution, by a normal law in three dimensions.
    """
    case = make(level, seed, i)
    try:
        tree = posterior(BOX, case.telemetry, case.priors, seed, workers=1)
    except SunspinError as error:
        return {"word": "refused", "verdict": str(error), "listed": False}
    solutions = tree["solutions"]
    errors, covariances = (
        case.omega_B - solutions["omega_B"].values,
        solutions["omega_cov_B"].values,
    )
    # distance of each solution from the truth, in sigmas
    distances = [
        float(np.sqrt(error @ np.linalg.solve(covariance, error)))
        for error, covariance in zip(errors, covariances, strict=True)
    ]
    is_probable = solutions["probability"].values >= 0.01
    word = tree.attrs["verdict_word"]
    confident = word in ("unique", "aliases")
    return {
        "word": word,
        "verdict": tree.attrs["verdict"],
        "listed": is_in_solutions(solutions.to_dataset(), case.omega_B),
        "far": distances[:5],
        "level": float(chi2.cdf(min(distances) ** 2, 3)),
        "wrong": bool(confident and np.min(np.array(distances)[is_probable]) > WRONG_SIGMAS),
        "sigma": float(np.sqrt(np.trace(covariances[0]) / 3)),
        "error": float(np.linalg.norm(errors[0])),
    }
