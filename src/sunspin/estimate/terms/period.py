"""A period seen from outside as evidence: radio fading, a light curve, a magnetometer's swing.

Who sees a period does not know what turned: the body's axis about the momentum (precession), the body about its axis (spin), or
both together (the sum). Each of the three is as likely before; motions are weighted by the mean of the three densities, the draws
of a posterior as those of the modes of `rates`. The rates are those of Euler's angles about the total momentum, wheels included,
averaged over four of the periods seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sunspin.base.errors import InputError
from sunspin.estimate.verdict import LEAST_DRAWS
from sunspin.solve.weights import effective_draws

READINGS = ("precession", "spin", "sum")

HALF_SPAN, INSTANTS = 2.0, 9
"""Periods before and after the instant over which rates are averaged, and at how many instants."""

PARALLEL = 1e-6
"""Squared sine between momentum and axis below which precession and spin fit equally well; their sum can."""

FAR_SIGMAS = 4.0
"""Where no motion has a period as near as this, the period contradicts all of them."""


@dataclass(frozen=True)
class Period:
    """A period (s) with one sigma (s), seen at `t_s` (s from the epoch of the telemetry)."""

    t_s: float
    period_s: float
    sigma_s: float

    def __post_init__(self) -> None:
        for name in ("t_s", "period_s", "sigma_s"):
            value = getattr(self, name)
            if not np.isfinite(value) or (name != "t_s" and not value > 0):
                wanted = "a number of seconds" if name == "t_s" else "a positive number of seconds"
                raise InputError(f"{name} of a period must be {wanted}", got=value)

    @property
    def instants_s(self) -> np.ndarray:
        """Times (s) over which rates are averaged."""
        return self.t_s + np.linspace(-HALF_SPAN, HALF_SPAN, INSTANTS) * self.period_s

    def density(self, periods_s: np.ndarray) -> np.ndarray:
        """Of periods (n, 3) by `READINGS`: density (n, 3) of what was seen; 0 where there is no such period."""
        apart = (np.nan_to_num(periods_s, nan=np.inf) - self.period_s) / self.sigma_s
        return np.exp(-0.5 * apart**2) / (self.sigma_s * np.sqrt(2 * np.pi))

    def nearest_sigmas(self, density: np.ndarray) -> float:
        """How many sigma the nearest of all periods, of these densities, is away."""
        highest = float(density.max()) * self.sigma_s * np.sqrt(2 * np.pi)
        return float(np.sqrt(-2 * np.log(np.clip(highest, 1e-300, 1.0))))


def own_axis(inertia: np.ndarray) -> np.ndarray:
    """The principal axis (3) whose moment of inertia (3, 3) differs most from the other two: a body's own, about which it spins."""
    moments, axes = np.linalg.eigh(inertia)
    apart = [min(abs(moments[i] - other) for other in np.delete(moments, i)) for i in range(3)]
    return axes[:, int(np.argmax(apart))]


def euler_rates(omega_B: np.ndarray, momentum_B: np.ndarray, axis_B: np.ndarray) -> np.ndarray:
    """Precession, spin and their sum (..., 3), rad/s, of rates omega_B (..., 3) with momentum (..., 3), about a body axis (3).

    omega = precession h + spin e + (nutation across both), h along the momentum, e the axis; NaN for the first two where h and e
    are parallel.
    """
    along = momentum_B / np.linalg.norm(momentum_B, axis=-1, keepdims=True)
    cosine, about_h, about_e = along @ axis_B, np.sum(omega_B * along, axis=-1), omega_B @ axis_B
    square = np.where(1 - cosine**2 > PARALLEL, 1 - cosine**2, np.nan)
    opposite = cosine < 0  # the sum of turns about opposite directions is their difference
    total = np.where(opposite, about_h - about_e, about_h + about_e) / (1 + np.abs(cosine))
    return np.stack(
        [(about_h - cosine * about_e) / square, (about_e - cosine * about_h) / square, total],
        axis=-1,
    )


def mean_periods(rates: Sequence[np.ndarray]) -> np.ndarray:
    """Periods (n, 3) in s by `READINGS` of Euler's rates (n, 3), rad/s, at several instants."""
    with np.errstate(divide="ignore"):
        return 2 * np.pi / np.abs(np.mean(rates, axis=0))


class Evidence(NamedTuple):
    """What periods say of draws (n): `density` (n) of all that was seen, `weight` (n) after it, as before where no draw has the
    periods; `shares` (seen, 3) by `READINGS`; how many sigma the nearest draw is off, and how many draws carry the weight."""

    density: np.ndarray
    weight: np.ndarray
    shares: np.ndarray
    nearest_sigmas: float
    effective: float

    @property
    def told(self) -> bool:
        """Whether the draws say what the periods decide."""
        return self.effective >= LEAST_DRAWS and self.nearest_sigmas <= FAR_SIGMAS


def evidence(seen: Sequence[Period], periods: Sequence[np.ndarray], weight: np.ndarray) -> Evidence:
    """Of draws with these periods (n, 3) for each of what was seen, and weights (n), which add to one, before it."""
    each = [one.density(found) for one, found in zip(seen, periods, strict=True)]
    density = np.prod([one.mean(axis=1) for one in each], axis=0)
    nearest = max(one.nearest_sigmas(found) for one, found in zip(seen, each, strict=True))
    total = float(weight @ density)
    if not total > 0:
        return Evidence(density, weight, np.zeros((len(seen), 3)), nearest, 0.0)
    after = weight * density / total
    shares = [
        (after[:, None] * one / np.maximum(one.sum(axis=1, keepdims=True), 1e-300)).sum(axis=0)
        for one in each
    ]
    return Evidence(density, after, np.array(shares), nearest, effective_draws(after))


def unheard(nearest_sigmas: float, effective: float, whose: str) -> str | None:
    """In words, why periods decide nothing among the motions of `whose`, if they do not."""
    if nearest_sigmas > FAR_SIGMAS:
        return f"periods: no solution of {whose} has them; the nearest is {nearest_sigmas:.1f} sigma away"
    if effective < LEAST_DRAWS:
        return f"periods not used: of these draws only {effective:.0f} have them"
    return None


def reading_words(t_s: float, period_s: float, sigma_s: float, shares: Sequence[float]) -> str:
    """What turned with a period, in words."""
    each = ", ".join(f"{name} {share:.0%}" for name, share in zip(READINGS, shares, strict=True))
    return f"period {period_s:g} +- {sigma_s:g} s at {t_s:g} s: {each}"
