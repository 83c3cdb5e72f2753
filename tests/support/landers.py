"""Simulated passes for `posterior`: Philae, and a 3U CubeSat with a wheel that runs down. All of it is synthetic."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr

import sunspin as ss
from sunspin.cases import load_case
from sunspin.dynamics.torques import Steady
from sunspin.estimate.lander.model import LanderModel
from sunspin.estimate.lander.motions import LanderMotions
from sunspin.estimate.lander.priors import with_priors
from sunspin.estimate.lander.window import observe_window
from sunspin.estimate.settings import POSTERIOR, SAMPLING
from sunspin.telemetry.assess import assess
from sunspin.vehicle import Friction, Panel, TelemetryForm, Vehicle, Wheel
from tests.support.philae import with_panels_as_drawn
from tests.support.simulate import telemetry_of
from tests.support.vehicles import LOWER_CASE_FACES

FEW = replace(POSTERIOR, sampling=replace(SAMPLING, draws=800, wanted=700.0))
"""Settings with fewer draws than usual."""


def sigmas_off(tree: xr.DataTree, omega_B: np.ndarray) -> np.ndarray:
    """Return how many sigmas each solution of a posterior is from a rate (3)."""
    solutions = tree["solutions"].to_dataset()
    off, covariance = omega_B - solutions["omega_B"].values, solutions["omega_cov_B"].values
    return np.sqrt(np.einsum("ki,kij,kj->k", off, np.linalg.inv(covariance), off))


def _dataset(vehicle: Vehicle, t_s: np.ndarray, power: np.ndarray) -> xr.Dataset:
    attrs = {"epoch_utc": "2014-11-12T15:34:04Z", "synthetic": 1, "quantity": "power_W"}
    return telemetry_of(vehicle, t_s, np.maximum(power, 0.0)).assign_attrs(attrs)


DIM_OMEGA, DIM_SUN = np.array([0.05, -0.08, 0.11]), np.array([0.3, 0.5, 0.8]) / np.sqrt(0.98)
"""Rate (rad/s) and direction to the Sun at the first sample of :func:`dim_telemetry`."""


def dim_telemetry(vehicle: Vehicle, t_s: np.ndarray) -> xr.Dataset:
    """Return telemetry of a body that begins with `DIM_OMEGA` and `DIM_SUN`, in a third of the Sun's light."""
    truth = {"omega_B": DIM_OMEGA, "sun_B": DIM_SUN, "t_s": t_s, "scale": 0.37}
    return ss.twin(vehicle, truth, seed=1)


# ------------------------------------------------------------------------------------------------------------------------- Philae

PHILAE = with_panels_as_drawn(load_case("philae").vehicle)
OMEGA, SUN = np.array([0.05, -0.08, 0.04]), np.array([0.6, 0.0, 0.8])
"""Rate (rad/s) and direction to the Sun of Philae at the first sample."""

NOISE = 12.0
"""Noise in the unit of the gains: 2 % of full Sun on the largest panel."""


def noisy(vehicle: Vehicle = PHILAE) -> Vehicle:
    """Return the vehicle with `NOISE` stated."""
    return replace(vehicle, telemetry=replace(vehicle.telemetry, noise=NOISE))


def lander_telemetry(t_s: np.ndarray, noise: float = 0.0) -> xr.Dataset:
    """Return telemetry of Philae's panels, in a motion that begins with `OMEGA`, `SUN` and the wheel as in its file."""
    wheels = [wheel.speed_rad_s for wheel in PHILAE.wheels]
    power = 2.5 * ss.panel_power(
        PHILAE, ss.propagate(PHILAE, OMEGA, SUN, wheels, t_s)["sun_B"].values
    )
    return _dataset(
        PHILAE, t_s, power + noise * np.random.default_rng(0).standard_normal(power.shape)
    )


def lander_model(
    t_s: np.ndarray | None = None, noise: float | None = None, **priors
) -> LanderModel:
    """Return the model of Philae with its readings at times (n); with a `noise`, `NOISE` is stated."""
    t_s = 100.0 * np.arange(8) if t_s is None else t_s
    vehicle = PHILAE if noise is None else noisy()
    assessment = assess(vehicle, lander_telemetry(t_s, noise or 0.0))
    return with_priors(assessment, observe_window(assessment), priors)[0]


def nominal(model: LanderModel, count: int = 1) -> LanderMotions:
    """Return the motion of the telemetry, so many times over."""
    u = np.zeros((count, len(model.unknowns)))
    return LanderMotions(np.tile(OMEGA, (count, 1)), np.tile(SUN, (count, 1)), u)


# --------------------------------------------------------------------------------------------------------------------------- box

BOX_OMEGA, BOX_SUN = np.array([0.04, -0.05, 0.03]), np.array([0.48, 0.6, 0.64])
BOX_T_S = 15.0 * np.arange(9)
BOX_NOISE_W = 0.1
BOX_PRIORS = {"max_rate_rad_s": 0.1, "steady_torque": 0.0}


def box() -> Vehicle:
    """Return a 3U CubeSat with a wheel that runs down, and a panel on each side but -z."""
    faces = [face for face in LOWER_CASE_FACES.items() if face[0] != "-z"]
    return Vehicle(
        "box",
        inertia_kg_m2=np.diag([0.042, 0.040, 0.009]),
        panels=[Panel(name, normal, 2.3 if "z" in name else 7.0) for name, normal in faces],
        wheels=[Wheel("W", (0, 0, 1), 1e-5, 100.0, Friction(1e-6, 1e-9))],
        gain_unit="W",
        telemetry=TelemetryForm(quantity="power_W", noise=BOX_NOISE_W),
    )


def box_telemetry(
    torque_N_m: np.ndarray | None = None, steps: int = 0, step_rad_s: float = 0.0
) -> xr.Dataset:
    """Return telemetry that begins with `BOX_OMEGA` and `BOX_SUN`, under a torque constant in the body if there is one.

    After nine samples the rate jumps by `step_rad_s` about each axis, and as many samples as `steps` follow, 15 s apart.
    """
    craft = box()
    torques = [] if torque_N_m is None else [Steady(np.stack([torque_N_m, np.zeros(3)]))]
    run = ss.propagate(craft, BOX_OMEGA, BOX_SUN, [100.0], BOX_T_S, torques=torques)
    t_s, sun = BOX_T_S, run["sun_B"].values
    if steps:
        omega, speed = run["omega_B"].values[-1] + step_rad_s, run["wheel_speed_rad_s"].values[-1]
        after_s = BOX_T_S[1] * np.arange(1, steps + 1)
        after = ss.propagate(craft, omega, sun[-1], speed, np.append(0.0, after_s))
        t_s, sun = np.append(t_s, t_s[-1] + after_s), np.vstack([sun, after["sun_B"].values[1:]])
    power = ss.panel_power(craft, sun)
    noise = BOX_NOISE_W * np.random.default_rng(0).standard_normal(power.shape)
    return _dataset(craft, t_s, power + noise)
