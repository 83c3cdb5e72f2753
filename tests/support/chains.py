"""A model of five directions of the Sun and a gyro, and the motion that it saw: what a chain of states is fitted to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sunspin.estimate.chain import propagate
from sunspin.estimate.model import Body, Model, Noise, Observations, Track
from sunspin.estimate.terms.directions import SunDirections
from sunspin.estimate.terms.inertial import GyroRates
from sunspin.estimate.terms.torques import ConstantTorque
from tests.support.vehicles import units

INERTIA = np.diag([1.25, 1.0, 0.75])
ERRORS = np.array([np.diag([0.02, 0.0, 0.0]), np.diag([0.0, 0.02, 0.0])])
T_S = np.array([0.0, 10.0, 22.0, 31.0, 45.0])
OMEGA = np.array([0.02, -0.03, 0.05])


def problem(noise=1e-4, sigma=0.02, gyro=True, torque=True, seed=1, rate_sigma=0.1):
    """Return a model of five directions with a gyro, and the motion that it saw."""
    rng = np.random.default_rng(seed)
    still = Observations(T_S, np.tile([0.0, 0.0, 0.01], (len(T_S), 1)), ())
    body = Body(INERTIA, ERRORS)
    truth = propagate(Model(still, body, Noise(noise), rate_sigma), 0, np.eye(3)[None], OMEGA[None])
    sun = units(truth.sun_B[0] + sigma * rng.normal(size=(len(T_S), 3)))
    terms = [SunDirections.of(sun, np.tile(sigma**2 * np.eye(3), (len(T_S), 1, 1)))]
    if gyro:
        read = truth.omega[0] + 1e-3 * rng.normal(size=(len(T_S), 3))
        terms.append(GyroRates(read, T_S, 1e-3, np.full(3, 2e-3), 0.0))
    if torque:
        terms.append(
            ConstantTorque.turning("B", [0.3], float(np.ptp(T_S)), INERTIA, still.momentum)
        )
    model = Model(replace(still, terms=tuple(terms)), body, Noise(noise), rate_sigma)
    return model, Track(truth.attitude, truth.omega, np.zeros((1, len(model.unknowns))))
