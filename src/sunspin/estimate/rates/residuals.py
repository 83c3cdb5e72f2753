"""How far each sensor's readings lie from the motions of a pass of :mod:`sunspin.estimate.rates`, sensor by sensor, in sigmas.

On all samples of a pass and not only on those that the search kept: a motion that stops and goes in between fits the kept ones.
There the attitude was carried, and its own covariance counts beside the noise of the reading.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from sunspin.estimate.rates.common_errors import Clock, Common, places_of, with_common
from sunspin.estimate.rates.dense import Dense
from sunspin.estimate.rates.state import Motion, Observations, Track
from sunspin.estimate.terms.magnetometer import Magnetometer
from sunspin.estimate.terms.panels import Panels
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
    relative = whole.attitude[:, 1:] @ np.swapaxes(whole.attitude[:, :-1], -1, -2)
    turned = spread[:, 1:, 3:, 3:] * np.diff(every.t_s)[:, None, None] ** 2
    for term, (_, place) in zip(every.of_pairs, places.pairs, strict=True):
        value, _, second = term.between(every.t_s, relative)
        value = value + np.einsum(
            "knim,km->kni", term.gained(every.t_s, whole), fit.error[:, place]
        )
        left = in_sigma(_whitened(value, second[..., :3], turned), 3)
        found[term.called] = np.full(omega.shape[:2], np.nan)
        found[term.called][:, 1:] = np.where(term.pairs(), left, np.nan)
    return found


def estimates(fit: Common, at: Fitted) -> tuple[dict[str, tuple[str, float, float]], ...]:
    """Of each mode what was estimated with it: name -> unit, value, one sigma. Gains are factors on those of the vehicle file,
    moments of inertia in units of the mean one, the Earth's light is the mean over the pass in axes of N."""
    places, body = places_of(at.o, at.motion, at.clock), at.motion.body
    every, each = np.eye(places.n), []
    for k, x in enumerate(places.unknowns):
        if x.kind in ("steady_torque", "gyro_zero", "gyro_scale", "clock", "panel_zero"):
            each.append((x.name, x.unit, x.centre, x.sigma * every[k]))
    for i, j in [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)] if len(body.errors) else ():
        name = f"inertia_{'xyz'[i]}{'xyz'[j]}"
        each.append((name, "1", body.inertia[i, j], body.errors[:, i, j] @ every[places.inertia]))
    for term, place in places.sun:
        if not isinstance(term, Panels):
            continue
        free, rows = term.gain_unknowns, every[place]
        for k, name in enumerate(term.names if len(free) else ()):
            each.append((f"gain_{name}", "1", term.gain[k], free[:, k] @ rows[: len(free)]))
        if term.earth is not None:
            beam, known = term.earth.beam_N.mean(axis=0), term.earth.known_N
            for k, axis in enumerate("xyz"):
                centre = 0.0 if known is None else float(known[:, k].mean())
                slope = beam[:, k] @ rows[len(free) : len(free) + len(beam)]
                each.append((f"earth_light_{axis}", "full Sun", centre, slope))
    return tuple(
        {
            name: (unit, float(centre + slope @ error), float(np.sqrt(slope @ covariance @ slope)))
            for name, unit, centre, slope in each
        }
        for error, covariance in zip(fit.error, fit.covariance, strict=True)
    )


def _at_samples(
    term: SunTerm | StateTerm, seen: Seen, error: np.ndarray, spread: np.ndarray
) -> np.ndarray:
    """Residuals (K, n) of a term under the covariance (K, n, 3 or 6, 3 or 6) of its readings and of the states together."""
    freedom = term.freedom()
    return np.where(freedom > 0, in_sigma(_square(term, seen, error, spread), freedom), np.nan)


def _square(
    term: SunTerm | StateTerm, seen: Seen, error: np.ndarray, spread: np.ndarray
) -> np.ndarray:
    """Their squares (K, n), summed over the numbers of a reading."""
    square = np.zeros(seen.omega.shape[:2])
    for value, slope in term.residuals(seen, error):
        square += _whitened(value, slope[..., : spread.shape[-1]], spread)
    return square


def _whitened(value: np.ndarray, slope: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Squares (K, n) of residuals (K, n, m) that answer by a slope (K, n, m, d) to what is known to a covariance (K, n, d, d)."""
    both = np.eye(value.shape[-1]) + slope @ spread @ np.swapaxes(slope, -1, -2)
    return (value * np.linalg.solve(both, value[..., None])[..., 0]).sum(axis=-1)


FINEST = 0.2
"""No panel's readings are taken for better than this part of their sigma."""


def panels_as_read(
    o: Observations, passes: Iterable[tuple[np.ndarray, np.ndarray, Track]], motion: Motion
) -> Observations:
    """What is observed, with the sigmas of panels in `passes` (all samples, those kept, modes) no larger than readings scatter
    about the best motion, if a magnetometer says how the body turns: other light, temperature and shadows, which are presumed in
    addition to the noise, may be less. Only samples that no fit has used count, and the quarter of a pass that scatters most."""
    panels = next((term for term in o.terms if isinstance(term, Panels)), None)
    read = any(term.present().any() for term in o.terms if isinstance(term, Magnetometer))
    if panels is None or not read:
        return o
    factor = np.ones((len(o), 1))
    for whole, kept, track in passes:
        fitted, every, place = o.take(kept).freed(), o.take(whole), np.searchsorted(whole, kept)
        unused = np.setdiff1d(np.arange(len(whole)), place)
        if len(unused) < len(kept):
            continue
        fit = with_common(fitted, track.take(np.array([0])), motion, None)
        seen = Dense.of(every, np.arange(len(whole)), place, fit.track, motion).filled(fit.track)
        at = [at for term, at in places_of(fitted, motion, None).sun if isinstance(term, Panels)]
        term = panels.take(whole).freed(every.t_s)
        square = _square(term, seen, fit.error[:, at[0]], seen.covariance[..., :3, :3])[0]
        factor[whole] = max(
            np.sqrt(square[quarter].sum() / max(term.freedom()[quarter].sum(), 1))
            for quarter in np.array_split(unused, 4)
        )
    return o.swapped(panels, panels.coarser(np.clip(factor, FINEST, 1.0)))
