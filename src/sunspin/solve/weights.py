"""What weighted draws are worth, and whether their largest weights may be trusted."""

from __future__ import annotations

import numpy as np

MIN_TAIL = 30
"""Weights that a tail must have to be fitted."""


def effective_draws(weight: np.ndarray) -> float:
    """How many draws of equal weight as many of these weights (n) are worth (Kish 1965)."""
    return float(weight.sum() ** 2 / np.sum(weight**2))


def pareto_tail(log_weight: np.ndarray) -> float:
    """Shape k of the generalised Pareto law of the largest weights (Vehtari et al. 2024): errors shrink as expected below 0.7."""
    weight = np.sort(np.exp(log_weight - log_weight.max()))
    count = int(min(0.2 * len(weight), 3 * np.sqrt(len(weight))))
    if count < MIN_TAIL or weight[-count - 1] <= 0:
        return np.inf
    beyond = weight[-count:] - weight[-count - 1]
    if beyond[-1] <= 0 or beyond.mean() < 1e-12 * weight[-1]:
        return -1.0  # all alike
    return _pareto_shape(beyond / beyond.mean())


def _pareto_shape(x: np.ndarray) -> float:
    """Shape k of the likeliest generalised Pareto law: with t = k / scale, k = mean log(1 + t x), which leaves t alone
    to be sought (Grimshaw 1993)."""
    # imported here: 0.1 s that nobody else needs at the start of an estimate
    from scipy.optimize import minimize_scalar

    def cost(at: float) -> float:
        t = np.expm1(at) / x.max()
        k = float(np.mean(np.log1p(t * x)))
        return k + (np.log(k / t) if abs(at) > 1e-9 else float(np.log(x.mean())))

    steps = np.concatenate([-np.geomspace(5.0, 1e-3, 40), np.geomspace(1e-3, 8.0, 40)])
    best = int(np.argmin([cost(at) for at in steps]))
    around = steps[max(best - 1, 0)], steps[min(best + 1, len(steps) - 1)]
    at = minimize_scalar(cost, bounds=around, method="bounded", options={"xatol": 1e-6}).x
    return float(np.mean(np.log1p(np.expm1(at) / x.max() * x)))
