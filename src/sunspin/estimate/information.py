"""How much readings tell of a motion, to first order: Laplace's method with the derivatives that the posterior's search uses.

What it cannot know is whether another motion fits as well (aliases), and that the region is a bent sheet; for both there is the
full posterior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import gammaincinv

from sunspin.estimate.posterior.data import Readings
from sunspin.estimate.posterior.likelihood import Likelihood
from sunspin.estimate.posterior.model import Model, State

LEVEL = 0.9
"""Part of the probability that the volumes hold."""


@dataclass(frozen=True)
class Information:
    """One motion (one row of `state`, at the first sample) and the readings that are to tell it.

    Derivatives are in sigmas of the noise of `state`, for each reading in the order samples, panels, and for each number of other
    observations; unknowns in the order rates (rad/s), direction (rad), further unknowns (prior sigmas).
    """

    model: Model
    data: Readings
    state: State

    @cached_property
    def slopes(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives (K, P, D) of readings and (M, D) of other observations, times the root of the weight that each has."""
        likelihood = Likelihood(self.model, self.data)
        _, raw, extra, jacobian, _ = likelihood.linearised(self.state)
        _, sigma, weight = likelihood.weigh(raw, extra, likelihood.noise(self.state.u))
        scaled = np.sqrt(weight)[0, :, None] * jacobian[0] / sigma[0, :, None]
        count = self.data.value.size
        return scaled[:count].reshape(*self.data.value.shape, -1), scaled[count:]

    @cached_property
    def _each(self) -> np.ndarray:
        """Information (K, P, D, D) of each reading."""
        slopes = self.slopes[0]
        return np.einsum("kpi,kpj->kpij", slopes, slopes)

    def covariance(
        self,
        samples: Any = slice(None),
        panels: Any = slice(None),
        noise: float = 1.0,
        fixed: Sequence[str] = (),
        others: Any = slice(None),
    ) -> np.ndarray:
        """Covariance (5, 5) of rate and direction, everything else integrated out.

        `samples`, `panels`, `others`: which of them are used (indices or a mask); `noise`: in units of the state's; `fixed`: kinds
        of unknowns that are known exactly ("inertia", "wheel_speed", "coulomb", "viscous", "scale", "noise", ...).
        """
        total = self._each[samples][:, panels].sum(axis=(0, 1)) / noise**2
        more = self.slopes[1][others]
        total = total + more.T @ more
        kept = [
            *range(5),
            *(5 + i for i, x in enumerate(self.model.unknowns) if x.kind not in fixed),
        ]
        prior = np.zeros(len(total))
        prior[:3], prior[3:5], prior[5:] = (
            self.model.max_rate**-2,
            1.0,
            1.0,
        )  # all but flat: an answer where nothing is told
        information = (total + np.diag(prior))[np.ix_(kept, kept)]
        scale = 1 / np.sqrt(np.diag(information))
        return (np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale))[
            :5, :5
        ]


def rate_volume(covariance: np.ndarray) -> float:
    """Volume in (rad/s)^3 of the ellipsoid that holds 90 % of the rates; `covariance` (>= 3, >= 3), rates first."""
    radius = float(np.sqrt(2 * gammaincinv(1.5, LEVEL)))
    return float(4 / 3 * np.pi * radius**3 * np.sqrt(max(np.linalg.det(covariance[:3, :3]), 0.0)))


def speed_sigma(covariance: np.ndarray, omega: np.ndarray) -> float:
    """One sigma of the angular speed in rad/s at a rate `omega` (3)."""
    along = omega / np.linalg.norm(omega)
    return float(np.sqrt(along @ covariance[:3, :3] @ along))


def exact_readings(model: Model, state: State, t_s: np.ndarray, sigma: float) -> Readings:
    """Readings (K, P) without noise that a motion makes at times `t_s` after the first, dark panels at zero."""
    panels = len(model.vehicle.inputs)
    ones = np.ones((len(t_s), panels), dtype=bool)
    threshold = float(model.vehicle.telemetry.lit_threshold or 0.0)
    empty = Readings(t_s, np.zeros(ones.shape), ones, ~ones, sigma, threshold, 1.0)
    blank = Likelihood(model, empty)
    prediction = blank.predict(state)
    value = blank.power(prediction.sun, state.u)[0]
    lit = value > threshold
    return Readings(t_s, np.where(lit, value, 0.0), ones, lit, sigma, threshold, float(value.max()))
