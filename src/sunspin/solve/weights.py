"""Quality of importance weights: the effective number of draws, and whether the largest weights can be trusted."""

from __future__ import annotations

import numpy as np

MIN_TAIL = 30
"""Smallest number of weights to which a tail is fitted."""


def effective_draws(weight: np.ndarray) -> float:
    """Return the number of equally weighted draws with the accuracy of draws with these weights (n) (Kish 1965)."""
    return float(weight.sum() ** 2 / np.sum(weight**2))


def pareto_tail(log_weight: np.ndarray) -> float:
    """Return the shape k of a generalised Pareto distribution fitted to the largest weights (Vehtari et al. 2024).

    Below k = 0.7 the error of importance sampling decreases as expected. Returns inf if there are too few weights for a fit,
    and -1 if all are equal.
    """
    weight = np.sort(np.exp(log_weight - log_weight.max()))
    # size of the tail as recommended there; the threshold is the largest weight below the tail
    count = int(min(0.2 * len(weight), 3 * np.sqrt(len(weight))))
    if count < MIN_TAIL or weight[-count - 1] <= 0:
        return np.inf
    exceedance = weight[-count:] - weight[-count - 1]
    if exceedance[-1] <= 0 or exceedance.mean() < 1e-12 * weight[-1]:
        return -1.0  # the largest weights are equal
    return _pareto_shape(exceedance / exceedance.mean())


def _pareto_shape(x: np.ndarray) -> float:
    """Return the maximum-likelihood shape k of a generalised Pareto distribution for exceedances x.

    With t = k / scale, k is mean(log(1 + t x)), so that only t is searched (Grimshaw 1993).
    """
    # imported here, as the import takes 0.1 s and many estimates do without it
    from scipy.optimize import minimize_scalar

    # t = (e^u - 1) / max(x) keeps 1 + t x positive; u is bracketed on a logarithmic grid on both sides of zero
    def cost(u: float) -> float:
        """Return the negative log likelihood of an exceedance, on average and up to a constant; at u = 0 (k = 0) its limit."""
        t = np.expm1(u) / x.max()
        k = float(np.mean(np.log1p(t * x)))
        return k + (np.log(k / t) if abs(u) > 1e-9 else float(np.log(x.mean())))

    grid = np.concatenate([-np.geomspace(5.0, 1e-3, 40), np.geomspace(1e-3, 8.0, 40)])
    best = int(np.argmin([cost(u) for u in grid]))
    bracket = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    u = minimize_scalar(cost, bounds=bracket, method="bounded", options={"xatol": 1e-6}).x
    return float(np.mean(np.log1p(np.expm1(u) / x.max() * x)))
