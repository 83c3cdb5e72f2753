"""How bright the Sun is in the readings, before any motion is known: the scale about which the posterior searches."""

from __future__ import annotations

import numpy as np
from scipy.special import logsumexp

from sunspin.estimate.posterior.cells import CANDIDATE_GRID, CAP
from sunspin.estimate.posterior.data import Readings
from sunspin.telemetry.sun import LIT_SIGMAS, is_reconstructed, sun_directions
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response import panels
from sunspin.vehicle.response.planes import sphere

LEAST_SEEN, MOST_SEEN = 0.5, 1.2
"""Range of the scale that few panels ask for, in which gains with a unit may be right."""

MOST_SAMPLES = 40
"""Samples looked at, those with the most light: they bound the scale."""

BETWEEN_RAD = 0.03
"""How far any direction is from the nearest of those tried."""

STEP, LEAST, WIDEST = 0.02, 0.03, 3.0
"""Scales tried: steps of their logarithm, and between which parts of the brightest reading they lie at most."""


def brightness(vehicle: Vehicle, data: Readings) -> float:
    """A first guess of the scale, signal of a panel of gain one at normal incidence.

    The median over samples that give a direction, else the likeliest scale. Gains in a unit are then believed instead where they
    can be, as their prior is narrow. A sample gives a direction by panels that are lit beyond noise: half of the dark panels' noise
    is above a small lit threshold, and with 2 to 4 % of it one guess in three was off by more than 10 %, up to a factor of 5; where
    it was, no start settled.
    """
    value = np.where(data.used, data.value, 0.0)
    sure = np.maximum(data.threshold, LIT_SIGMAS * data.sigma)
    status = sun_directions(vehicle, value, noise=data.sigma, lit_threshold=sure)["status"].values
    told = is_reconstructed(status) & data.used.all(axis=1)
    if told.any():
        return float(np.median(panels.brightness(vehicle, value[told])))
    least = _likeliest(vehicle, np.maximum(value, 0.0), data)
    return 1.0 if vehicle.gain_unit is not None and LEAST_SEEN < least < MOST_SEEN else least


def _likeliest(vehicle: Vehicle, value: np.ndarray, data: Readings) -> float:
    """The scale under which readings (K, P) are the likeliest, each sample's direction being anywhere on the sphere.

    A scale at which every sample has a direction is not enough: too bright a Sun is not contradicted where no panel looks along it.
    But directions near the edge of what panels see would have to be the rule then, and readings just below the largest rare.
    """
    light = value / vehicle.input_gains
    brightest = np.argsort(-np.linalg.norm(light, axis=1), kind="stable")[:MOST_SAMPLES]
    brightest = brightest[
        light[brightest].max(axis=1) > 0
    ]  # the dark samples of an eclipse bound nothing
    largest = light[brightest].max(axis=1)
    scales = np.exp(
        np.arange(
            np.log(max(np.median(largest), LEAST * largest.max())),
            np.log(WIDEST * largest.max()),
            STEP,
        )
    )
    seen = panels.panel_power(vehicle, sphere(CANDIDATE_GRID))
    density = np.zeros(len(scales))
    for i, scale in enumerate(scales):
        sigma = np.hypot(data.sigma, BETWEEN_RAD * scale * vehicle.input_gains)
        for k in brightest:
            off = np.minimum(((scale * seen - value[k]) / sigma) ** 2, CAP) @ data.used[k]
            density[i] += float(logsumexp(-0.5 * off)) - float(np.log(sigma) @ data.used[k])
    return float(scales[np.argmax(density)])
