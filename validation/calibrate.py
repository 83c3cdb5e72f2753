"""Calibration of the posterior: simulated cases drawn from its own prior, and the share of the posterior that is likelier than the
truth.

Case i depends on seed and i alone. The kinds "known", "unknown" and "turned" (misaligned panels) are drawn from the prior that the
posterior is given. Telemetry of "swapped" and "wheel_off" follows another model, which the predictive check has to refuse.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations_with_replacement
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sunspin import posterior
from sunspin.estimate.lander.motions import LanderMotions
from sunspin.estimate.lander.priors import with_priors
from sunspin.estimate.lander.window import observe_window
from sunspin.estimate.synthetic import Truth, synthetic_telemetry
from sunspin.solve.rotations import tangent_basis
from sunspin.telemetry.assess import assess
from sunspin.vehicle import Friction, Vehicle
from sunspin.vehicle.response.panels import misalignment_sigma
from validation.truths import is_in_solutions

DIRECTION_ERROR = 1e-5
"""Error of directions (rad) in a density."""

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


ASSUMED = {
    "inertia": 0.01,
    "wheel_speed": 0.005,
    "wheel_inertia": 0.0,
    "friction": 0.05,
    "noise": 0.3,
}
"""Relative sigmas that the posterior assumes if neither the priors nor the vehicle file state one."""


class Unknown(NamedTuple):
    """A number of the vehicle that a case draws: `centre` and one `sigma`, as the posterior names and counts it.

    `index`: of the wheel, of the element of the inertia by rows, of the side of a panel (two each), or of the axis.
    """

    name: str
    kind: str
    centre: float
    sigma: float
    index: int


def unknowns_of(vehicle: Vehicle, priors: dict[str, Any], scale: float) -> list[Unknown]:
    """Return what the posterior does not know of a vehicle under these priors, in a fixed order. Noise is known to a factor."""

    def sigma(key: str, fact: str, value: float) -> float:
        """Return the absolute sigma of a number: of the priors, else of the vehicle file, else assumed."""
        stated = vehicle.facts.get(fact)
        if key not in priors and stated is not None and stated.sigma is not None:
            return float(np.asarray(stated.sigma))
        return abs(value) * float(priors.get(key, ASSUMED[key]))

    unknowns = [
        Unknown("log_scale", "scale", float(np.log(scale)), 1.0, 0),
        Unknown("log_noise", "noise", 0.0, float(priors.get("noise", ASSUMED["noise"])), 0),
    ]
    for i, wheel in enumerate(vehicle.wheels):
        at, tail = f"wheel.{wheel.name}", "" if len(vehicle.wheels) == 1 else f"_{wheel.name}"
        speed, mass = wheel.speed_rad_s, wheel.inertia_kg_m2
        spread = sigma("wheel_speed", f"{at}.speed_rad_s", speed)
        unknowns.append(Unknown(f"wheel_speed{tail}", "wheel_speed", speed, spread, i))
        spread = sigma("wheel_inertia", f"{at}.inertia_kg_m2", mass) / mass
        unknowns.append(Unknown(f"log_wheel_inertia{tail}", "wheel_inertia", 0.0, spread, i))
        for kind, key in (("coulomb", "coulomb_N_m"), ("viscous", "viscous_N_m_s")):
            value = getattr(wheel.friction, key)
            if value:
                spread = sigma("friction", f"{at}.friction.{key}", value) / value
                unknowns.append(Unknown(f"log_{kind}{tail}", kind, 0.0, spread, i))
    tensor, stated = np.array(vehicle.require_inertia()), vehicle.facts.get("body.inertia_kg_m2")
    moments = np.diag(tensor)
    # of a moment relative to itself, of a product relative to the mean moment
    sizes = np.where(np.eye(3, dtype=bool), moments, moments.mean())
    spreads = sizes * float(priors.get("inertia", ASSUMED["inertia"]))
    if "inertia" not in priors and stated is not None and stated.sigma is not None:
        spreads = np.broadcast_to(np.asarray(stated.sigma, dtype=np.float64), (3, 3))
    for a, b in combinations_with_replacement(range(3), 2):
        name = f"inertia_{'xyz'[a]}{'xyz'[b]}"
        unknowns.append(Unknown(name, "inertia", tensor[a, b], float(spreads[a, b]), 3 * a + b))
    own, common = misalignment_sigma(vehicle)
    own = np.full(len(own), priors["tilt"]) if "tilt" in priors else own
    common = float(priors.get("tilt_common", common))
    for j, panel in enumerate(vehicle.panels):
        for side in range(2):
            name = f"tilt_{panel.name}_{side + 1}_rad"
            unknowns.append(Unknown(name, "tilt", 0.0, float(own[j]), 2 * j + side))
    for axis in range(3):
        name = f"tilt_all_{'xyz'[axis]}_rad"
        unknowns.append(Unknown(name, "tilt_common", 0.0, common, axis))
    return [unknown for unknown in unknowns if unknown.sigma > 0]


class PriorDraw(NamedTuple):
    """A motion and a vehicle drawn from the prior.

    Rate (3) in rad/s and direction to the Sun (3) at the first sample; `values` of the unknowns by name; the true `vehicle` with
    speeds of its wheels (n_wheel) in rad/s; rotation vectors of its panels (n_panel, 3) in rad.
    """

    omega_B: np.ndarray
    sun_B: np.ndarray
    values: dict[str, float]
    vehicle: Vehicle
    wheel_speeds: np.ndarray
    tilt_B_rad: np.ndarray


def rate_and_direction(max_rate: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw a rate (3), uniform for |omega| < `max_rate`, and a direction (3), uniform on the sphere."""
    direction = rng.standard_normal((2, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return max_rate * rng.random() ** (1 / 3) * direction[0], direction[1]


def draw_from_prior(
    vehicle: Vehicle, priors: dict[str, Any], scale: float, rng: np.random.Generator
) -> PriorDraw:
    """Draw a motion and a vehicle. The scale stays at its centre, as its prior is nearly flat."""
    unknowns = unknowns_of(vehicle, priors, scale)
    omega, sun = rate_and_direction(priors["max_rate_rad_s"], rng)
    off = rng.standard_normal(len(unknowns))
    wheels, inertia = list(vehicle.wheels), np.array(vehicle.require_inertia())
    tilt = np.zeros((len(vehicle.panels), 3))
    across = np.stack(tangent_basis(vehicle.panel_normals_B), axis=1)
    values = {}
    for unknown, sigmas in zip(unknowns, off, strict=True):
        kind, index = unknown.kind, unknown.index
        step = 0.0 if kind == "scale" else float(unknown.sigma * sigmas)
        values[unknown.name] = value = unknown.centre + step
        if kind == "inertia":
            a, b = divmod(index, 3)
            inertia[a, b] = inertia[b, a] = value
        elif kind == "tilt":
            panel, side = divmod(index, 2)
            tilt[panel] += value * across[panel, side]
        elif kind == "tilt_common":
            tilt[:, index] += value
        elif kind == "wheel_speed":
            wheels[index] = replace(wheels[index], speed_rad_s=value)
        elif kind == "wheel_inertia":
            mass = wheels[index].inertia_kg_m2 * np.exp(value)
            wheels[index] = replace(wheels[index], inertia_kg_m2=float(mass))
        elif kind in ("coulomb", "viscous"):
            friction = wheels[index].friction
            dry, wet = (
                float(np.exp(value)) if kind == one else 1.0 for one in ("coulomb", "viscous")
            )
            friction = Friction(friction.coulomb_N_m * dry, friction.viscous_N_m_s * wet)
            wheels[index] = replace(wheels[index], friction=friction)
    speeds = np.array([wheel.speed_rad_s for wheel in wheels])
    true = replace(vehicle, inertia_kg_m2=inertia, wheels=tuple(wheels))
    return PriorDraw(omega, sun, values, true, speeds, tilt)


class SimulatedCase(NamedTuple):
    """Telemetry of a case, its truth, and the priors for the posterior."""

    telemetry: xr.Dataset
    truth: PriorDraw
    priors: dict[str, Any]


def make(
    vehicle: Vehicle, kind: str, max_rate: float, samples: int, interval_s: float, seed: int, i: int
) -> SimulatedCase:
    """Return telemetry of case i, its truth, and the priors that the posterior is given.

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
    truth = draw_from_prior(vehicle, priors, scale, rng)
    jitter = np.concatenate([[0.0], rng.uniform(-1, 1, samples - 1)])
    t_s = interval_s * np.arange(samples) + jitter * min(JITTER_S, interval_s / 4)
    of_case = Truth(
        truth.omega_B,
        truth.sun_B,
        t_s,
        truth.wheel_speeds * (0.0 if kind == "wheel_off" else 1.0),
        scale=scale,
        noise=vehicle.require_noise() * float(np.exp(truth.values["log_noise"])),
        tilt_B_rad=truth.tilt_B_rad,
    )
    telemetry = synthetic_telemetry(truth.vehicle, of_case, seed=int(rng.integers(2**31)))
    if kind == "swapped":
        value = telemetry["power_W" if "power_W" in telemetry else "current_A"].values
        a, b = rng.choice(value.shape[1], 2, replace=False)
        value[:, [a, b]] = value[:, [b, a]]
    return SimulatedCase(telemetry, truth, priors)


def judge(vehicle: Vehicle, case: SimulatedCase, seed: int) -> dict[str, Any]:
    """Run the posterior on a case and return its verdict and a comparison with the truth.

    "level": share of draws with a higher density than the truth. "listed": the truth is in the list that a user reads. "recalled":
    a solution is within `NEAR_SIGMAS` of it. "error" and "sigma" of the rate in rad/s.
    """
    telemetry, truth, priors = case
    tree = posterior(vehicle, telemetry, priors, seed, workers=1)
    solutions = tree["solutions"].to_dataset()
    *of_draws, of_truth = _log_densities(vehicle, telemetry, priors, tree, truth)
    off = truth.omega_B - solutions["omega_B"].values
    # 1e-14 (rad/s)^2 keeps the covariance of a solution without spread invertible
    covariance = solutions["omega_cov_B"].values + 1e-14 * np.eye(3)
    distance = np.sqrt(np.einsum("mi,mij,mj->m", off, np.linalg.inv(covariance), off))  # sigmas
    return {
        "level": float(np.mean(np.array(of_draws) > of_truth)),
        "listed": is_in_solutions(solutions, truth.omega_B),
        "recalled": bool(distance.min() < NEAR_SIGMAS),
        "word": tree.attrs["verdict_word"],
        "verdict": tree.attrs["verdict"],
        "error": float(np.min(np.linalg.norm(off, axis=1))),
        "sigma": float(np.sqrt(np.trace(covariance[0]))),
    }


def _log_densities(
    vehicle: Vehicle, telemetry: xr.Dataset, priors: dict[str, Any], tree: Any, truth: PriorDraw
) -> np.ndarray:
    """Return the log posterior density (n + 1) of the draws of a result, and of the truth as the last."""
    draws, values = tree["posterior"].to_dataset(), {}
    for name, true in truth.values.items():
        # the speed of the only wheel is in a variable of all wheels
        of_draws = draws["wheel_speed_rad_s"] if name == "wheel_speed" else draws[name]
        values[name] = np.append(of_draws.values.ravel(), true)
    omega, sun = (
        np.vstack([draws[name].values[0], true])
        for name, true in (("omega_B", truth.omega_B), ("sun_B", truth.sun_B))
    )
    return log_density(vehicle, telemetry, priors, omega, sun, values)


def log_density(
    vehicle: Vehicle,
    telemetry: xr.Dataset,
    priors: Mapping[str, Any],
    omega_B: np.ndarray,
    sun_B: np.ndarray,
    values: Mapping[str, np.ndarray],
) -> np.ndarray:
    """Return the log posterior density (n) of motions under the nominal model, up to a constant.

    Rates (rad/s) and directions (n, 3) are those at the first sample; `values`: of the unknowns (n), by name.
    """
    assessment = assess(vehicle, telemetry)
    model, _ = with_priors(assessment, observe_window(assessment), priors)
    motions = LanderMotions(omega_B, sun_B, _in_sigmas(model.unknowns, values))
    return model.log_likelihood(
        model.sun_states(motions, DIRECTION_ERROR), motions.u
    ) + model.log_prior_density(motions)


def _in_sigmas(unknowns: Any, values: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the values (n) of unknowns as deviations (n, m) from their centres in sigmas."""
    columns = [(values[one.name] - one.centre) / one.sigma for one in unknowns]
    return np.stack(columns, axis=1)
