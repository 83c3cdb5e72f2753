"""Sun and field at the samples of a file for places along an orbit: computed once, interpolated where a fit moves the place."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sunspin.environment.earth import earth_from_J2000, rotate_vectors, sun_J2000_m
from sunspin.environment.light import sunlit_fraction
from sunspin.environment.orbit import Orbit


@dataclass(frozen=True)
class AlongTrack:
    """At n samples and K shifts (s) beside the orbit's own, in Earth-fixed axes: direction to the Sun (n, 3), field (K, n, 3) in T,
    part of the Sun that is seen (K, n); `days` (n) from the middle of the file. The orbit's own drift is in all of them."""

    shifts: np.ndarray
    sun: np.ndarray
    field: np.ndarray
    lit: np.ndarray
    days: np.ndarray

    @classmethod
    def of(
        cls,
        orbit: Orbit,
        t_s: np.ndarray,
        shifts: np.ndarray,
        node_rad: float = 0.0,
        phase_s: float = 0.0,
    ) -> AlongTrack:
        """Of an orbit whose node is turned, and that is so many s farther along."""
        when = orbit.instants(t_s)
        place, _ = replace(orbit, node_rad=orbit.node_rad + node_rad).states(
            when, orbit.ahead_s(when) + phase_s + shifts[:, None]
        )
        sun, turn = sun_J2000_m(when), earth_from_J2000(when)
        fixed = rotate_vectors(turn, place)
        to_sun = rotate_vectors(turn, sun / np.linalg.norm(sun, axis=1, keepdims=True))
        light = sunlit_fraction(place, np.broadcast_to(sun, place.shape))
        return cls(
            shifts, to_sun, orbit.field_map_around(when, place).at(fixed), light, orbit.days(when)
        )

    def take(self, samples: np.ndarray) -> AlongTrack:
        return AlongTrack(
            self.shifts,
            self.sun[samples],
            self.field[:, samples],
            self.lit[:, samples],
            self.days[samples],
        )

    def lit_at(self, shift_s: float) -> np.ndarray:
        """Part of the Sun that is seen (n) at the shift of the table that is nearest."""
        return self.lit[int(np.abs(self.shifts - shift_s).argmin())]

    def at(self, shift_s: float, drift_s_day: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """The field (n, 3) in T and its slope (n, 3) in T/s at an evenly drifting shift, by cubics through four of the shifts,
        which are even; beyond them it stays as it is."""
        step = self.shifts[1] - self.shifts[0]
        place = np.clip(
            (shift_s + drift_s_day * self.days - self.shifts[0]) / step, 0.0, len(self.shifts) - 1.0
        )
        first = np.clip(place.astype(int) - 1, 0, len(self.shifts) - 4)
        x, each = place - first - 1, np.arange(len(place))
        weight = [
            -(x**3) / 6 + x**2 / 2 - x / 3,
            x**3 / 2 - x**2 - x / 2 + 1,
            -(x**3) / 2 + x**2 / 2 + x,
            x**3 / 6 - x / 6,
        ]
        slope = [
            -(x**2) / 2 + x - 1 / 3,
            1.5 * x**2 - 2 * x - 0.5,
            -1.5 * x**2 + x + 1,
            x**2 / 2 - 1 / 6,
        ]
        four = [self.field[first + k, each] for k in range(4)]
        value = sum(w[:, None] * part for w, part in zip(weight, four, strict=True))
        return np.asarray(value), np.asarray(
            sum(w[:, None] * part for w, part in zip(slope, four, strict=True))
        ) / step
