"""How far each sensor's readings lie from the motions of a pass of :mod:`sunspin.estimate.rates`, sensor by sensor, in sigmas.

On all samples of a pass and not only on those that the search kept: a motion that stops and goes in between fits the kept ones.
There the attitude was carried, and its own covariance counts beside the noise of the reading.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sunspin.estimate.rates.common_errors import Clock, places_of
from sunspin.estimate.rates.state import Motion, Observations, Track
from sunspin.estimate.terms.term import Seen, StateTerm, SunTerm
from sunspin.estimate.verdict import in_sigma


class Fitted(NamedTuple):
    """A pass as it was fitted: the samples kept `o`, the modes there at the sensors' instants, their common errors (K, m)."""

    o: Observations
    track: Track
    error: np.ndarray
    motion: Motion
    clock: Clock | None


def residuals(
    every: Observations, kept: np.ndarray, whole: Track, fit: Fitted
) -> dict[str, np.ndarray]:
    """Sensor -> residuals (K, n) in sigmas of the modes `whole` (K) at the samples of `every` (n), the last of each pair where
    neighbours are compared, NaN where it read nothing; `kept`: the places of the samples that the motions were fitted to."""
    places = places_of(fit.o, fit.motion, fit.clock)
    carried = ~np.isin(np.arange(len(every)), kept)
    spread = np.where(carried[:, None, None], whole.covariance, 0.0)
    found = {}
    for term, (_, place) in zip(every.of_sun, places.sun, strict=True):
        found[term.called] = _at_samples(term, whole, fit.error[:, place], spread[..., :3, :3])
    attitude, omega = whole.attitude.copy(), whole.omega.copy()
    attitude[:, kept], omega[:, kept] = fit.track.attitude, fit.track.omega
    for term, (_, place) in zip(every.of_state, places.state, strict=True):
        if term.present().any():
            left = _at_samples(term, Seen(attitude, omega), fit.error[:, place], spread)
            unknown = carried & (
                fit.clock is not None
            )  # carried to the Sun's instants, which are not its own
            found[term.called] = np.where(unknown, np.nan, left)
    relative = fit.track.attitude[:, 1:] @ np.swapaxes(fit.track.attitude[:, :-1], -1, -2)
    for term, place in places.pairs:
        value = term.between(fit.o.t_s, relative)[0]
        value = value + np.einsum(
            "knim,km->kni", term.gained(fit.o.t_s, fit.track), fit.error[:, place]
        )
        found[term.called] = np.full(omega.shape[:2], np.nan)
        found[term.called][:, kept[1:]] = np.where(
            term.pairs(), in_sigma((value**2).sum(axis=-1), 3), np.nan
        )
    return found


def _at_samples(
    term: SunTerm | StateTerm, seen: Seen, error: np.ndarray, spread: np.ndarray
) -> np.ndarray:
    """Residuals (K, n) of a term under the covariance (K, n, 3 or 6, 3 or 6) of its readings and of the states together."""
    square = np.zeros(seen.omega.shape[:2])
    for value, slope in term.residuals(seen, error):
        to_state = slope[..., : spread.shape[-1]]
        both = np.eye(value.shape[-1]) + to_state @ spread @ np.swapaxes(to_state, -1, -2)
        square += (value * np.linalg.solve(both, value[..., None])[..., 0]).sum(axis=-1)
    freedom = term.freedom()
    return np.where(freedom > 0, in_sigma(square, freedom), np.nan)
