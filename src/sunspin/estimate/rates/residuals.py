"""How far each sensor's readings lie from the motions of a pass of :mod:`sunspin.estimate.rates`, sensor by sensor, in sigmas.

On all samples of a pass and not only on those that the search kept: a motion that stops and goes in between fits the kept ones.
There the attitude was carried, and its own covariance counts beside the noise of the reading.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sunspin.estimate.rates import field
from sunspin.estimate.rates.common import Clock, Common, lit_with, places_of
from sunspin.estimate.rates.light import STUDENT, sun_measured
from sunspin.estimate.rates.smooth import between, field_pairs
from sunspin.estimate.rates.state import Motion, Observations, Track
from sunspin.estimate.verdict import in_sigma

SUN_FREEDOM = 2
"""Degrees of freedom of a direction."""

MOTION = 6
"""Residuals of turn and rate that stand before those of field and attitude between two samples."""


class Fitted(NamedTuple):
    """A pass as it was fitted: the samples kept `o`, the modes there at the sensors' instants, their common errors (K, m)."""

    o: Observations
    track: Track
    error: np.ndarray
    motion: Motion
    clock: Clock | None

    @classmethod
    def of(cls, o: Observations, track: Track, common: Common | None, motion: Motion, clock: Clock | None) -> Fitted:
        """From a fit with errors in common, or one without any."""
        if common is None:
            return cls(o, track, np.zeros((len(track.omega), places_of(o, motion, None).count)), motion, None)
        return cls(o, common.track, common.error, motion, clock)


def residuals(every: Observations, kept: np.ndarray, whole: Track, fit: Fitted) -> dict[str, np.ndarray]:
    """Sensor -> residuals (K, n) in sigmas of the modes `whole` (K) at the samples of `every` (n), the last of each pair where
    neighbours are compared, NaN where it read nothing; `kept`: the places of the samples that the motions were fitted to."""
    found = {"Sun": _sun(every, kept, whole, fit)}
    known = np.asarray(np.isfinite(every.gyro).all(axis=1))
    if known.any():
        found["gyro"] = _gyro(every, known, kept, whole, fit)
    for name, pairs in _neighbours(fit).items():
        found[name] = np.full(found["Sun"].shape, np.nan)
        found[name][:, kept[1:]] = pairs
    return found


def _carried(every: Observations, kept: np.ndarray) -> np.ndarray:
    """Which samples (n) the motions were carried to."""
    return ~np.isin(np.arange(len(every)), kept)


def _sun(every: Observations, kept: np.ndarray, track: Track, fit: Fitted) -> np.ndarray:
    lit = lit_with(every, fit.error, places_of(fit.o, fit.motion, fit.clock))
    matrix, slope, cost = sun_measured(lit, track)
    square = STUDENT * np.expm1(2 * cost / (STUDENT + 2))  # the Student law's cost, turned round
    weight = (STUDENT + 2) / (STUDENT + square)
    told, pull = matrix[..., :3, :3] / weight[..., None, None], slope[..., :3] / weight[..., None]
    # by Woodbury the square under the covariance of reading and carried attitude together
    spread = track.covariance[..., :3, :3]
    answer = (np.linalg.solve(np.eye(3) + spread @ told, spread) @ pull[..., None])[..., 0]
    square = square - _carried(every, kept) * (pull * answer).sum(axis=-1)
    freedom = SUN_FREEDOM * every.told.astype(int)
    if every.power.size:
        freedom = freedom + np.isfinite(every.power_sigma).sum(axis=-1)
    return np.where(freedom > 0, in_sigma(square, freedom), np.nan)


def _gyro(every: Observations, known: np.ndarray, kept: np.ndarray, whole: Track, fit: Fitted) -> np.ndarray:
    omega, carried = whole.omega.copy(), _carried(every, kept)
    omega[:, kept] = fit.track.omega
    value = omega - np.where(known[:, None], every.gyro, 0.0)
    place = places_of(fit.o, fit.motion, fit.clock).gyro
    error = fit.error[:, place]
    value = value + np.einsum("ka,nai->kni", error, np.nan_to_num(every.gyro_common[:, : error.shape[1]]))
    spread = every.gyro_sigma**2 * np.eye(3) + carried[:, None, None] * whole.covariance[..., 3:, 3:]
    square = (value * np.linalg.solve(spread, value[..., None])[..., 0]).sum(axis=-1)
    late = carried if fit.clock is not None else np.zeros(len(every), dtype=bool)  # carried to the Sun's instants, not the gyro's
    return np.where(known & ~late, in_sigma(square, 3), np.nan)


def _neighbours(fit: Fitted) -> dict[str, np.ndarray]:
    """What a magnetometer and an attitude sensor say of the turn from each kept sample to the next (K, n - 1)."""
    o, value = fit.o, between(fit.o, fit.track, fit.motion)[0][..., MOTION:]
    found, met = {}, field_pairs(o)
    if met.any() and np.isfinite(o.field_sigma):
        part, value = value[..., :3], value[..., 3:]
        if field.count(o):
            drift = fit.error[:, places_of(o, fit.motion, fit.clock).field]
            part = part + np.einsum("knim,km->kni", field.gained(o, fit.track), drift)
        found["magnetometer"] = np.where(met, in_sigma((part**2).sum(axis=-1), 3), np.nan)
    known = np.isfinite(o.attitude[:, 0, 0])
    if (known := known[:-1] & known[1:]).any():
        found["attitude"] = np.where(known, in_sigma((value**2).sum(axis=-1), 3), np.nan)
    return found
