"""Comparison of results with a known rate: when a rate is wrong, and when the truth is among the solutions."""

from __future__ import annotations

import numpy as np
import xarray as xr

WRONG_SIGMAS, WRONG_RAD_S = 5.0, np.radians(0.1)
"""A rate is wrong if a component differs by more than both limits: sigmas and rad/s."""

SLOW_PART = 5.0
"""For slow bodies a fifth of the rate replaces `WRONG_RAD_S`: at 0.24 deg/s an error of 0.1 deg/s is large."""

LISTED_PROBABILITY = 1e-3
"""Least probability of a solution in the list that a user reads."""


def is_wrong(omega: np.ndarray, sigma: np.ndarray, truth: np.ndarray) -> bool:
    """Return whether a rate `omega` (3) with its `sigma` (3) misses the true rate (3), all rad/s."""
    miss = np.abs(omega - truth)
    least = min(WRONG_RAD_S, float(np.linalg.norm(truth)) / SLOW_PART)
    return bool(((miss > WRONG_SIGMAS * sigma) & (miss > least)).any())


def is_listed(
    omega: np.ndarray, sigma: np.ndarray, probability: np.ndarray, truth: np.ndarray
) -> bool:
    """Return whether one of K solutions is the true rate.

    Parameters
    ----------
    omega, sigma : (K, 3), rad/s
        Rates and one-sigma errors at one instant; NaN if there are fewer solutions.
    probability : (K)
    truth : (3), rad/s
        The true rate at that instant. A solution agrees with it if each component differs by at most five sigma, or by a fifth of
        the true speed if that is more.
    """
    allowed = np.maximum(WRONG_SIGMAS * sigma, np.linalg.norm(truth) / SLOW_PART)
    near = (np.abs(omega - truth) <= allowed).all(axis=1)
    return bool((near & (np.nan_to_num(probability) > LISTED_PROBABILITY)).any())


def is_in_solutions(solutions: xr.Dataset, truth: np.ndarray) -> bool:
    """Return whether the group `solutions` of a posterior contains the true rate (3), rad/s, at the first sample."""
    spread = solutions["omega_cov_B"].values
    sigma = np.sqrt(np.maximum(np.diagonal(spread, axis1=1, axis2=2), 0.0))
    return is_listed(solutions["omega_B"].values, sigma, solutions["probability"].values, truth)
