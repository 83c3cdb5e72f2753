"""Environment of a spacecraft in a known orbit about the Earth.

Two numbers with errors describe the uncertainty along the track. `shift_s` is the time by which the spacecraft is ahead of the
elements (negative: behind). `clock_s` is the time by which the telemetry's clock is behind UTC. The Sun and the rotation of the
Earth depend on the clock, the position on clock plus shift. The Earth rotates by only one degree in four minutes, so data
determine mainly the sum. `drift_s_day` is the daily change of the sum, from an error of the mean motion, drag or a slow clock,
which data do not distinguish either.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import date
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sunspin.environment.earth import (
    EQUATOR_M,
    Instants,
    J2000_from_TEME,
    earth_from_J2000,
    rotate_vectors,
    sun_J2000_m,
)
from sunspin.environment.elements import OLD_DAYS, Elements
from sunspin.environment.ephemeris import Ephemeris
from sunspin.environment.field import MODEL_SIGMA_T, FieldMap, field_map
from sunspin.environment.frames import J2000, SUN_Z_LOCAL
from sunspin.environment.light import (
    REFLECTIVITY,
    REFLECTIVITY_SIGMA,
    albedo_light,
    sunlit_fraction,
)
from sunspin.environment.surroundings import Surroundings

SUN_SIGMA_RAD = 1e-5
"""Error of ERFA's Sun direction; the parallax of the orbit is included in the direction."""

CLOCK_SIGMA_S = 1.0
"""Standard deviation of a telemetry clock without further information: time tags in whole seconds."""


def age_sigma_s(days: float) -> float:
    """Return the standard deviation along the track (s) of elements that are `days` old.

    It is 2 km at the epoch and in a low orbit 1.5 km more per day, with a quadratic term for errors of drag. This is an
    assumption; Vallado and Cefola 2012 report 1 to 3 km per day.
    """
    return 0.3 + 0.2 * abs(days) + 0.01 * days**2


DRIFT_DAYS = 30.0
"""Time in which the shift may change by its own sigma for other reasons: another satellite of the same launch, a clock."""


def drift_sigma_s_day(shift_sigma_s: float, days: float) -> float:
    """Return the standard deviation of the drift (s/day): the growth of :func:`age_sigma_s`, and a change within `DRIFT_DAYS`."""
    return float(np.hypot(0.2 + 0.02 * abs(days), shift_sigma_s / DRIFT_DAYS))


Source = Elements | Ephemeris
"""A source of positions, elements or a table.
`states` returns positions (n, 3) m and velocities (n, 3) m/s in `frame`, "TEME" or "J2000", at UTC Julian dates (n) and fractions
(n). `days_to` returns the days from its epoch, or the nearer end of its table, to a UTC Julian date. `require_coverage` raises
`InputError` if it has no positions at Julian dates (n)."""


class _AtPosition(NamedTuple):
    """What depends on the position: visible fraction of the Sun (n), magnetic field (n, 3) in T, albedo vector (n, 3)."""

    lit: np.ndarray
    field_J2000: np.ndarray
    albedo: np.ndarray

    @classmethod
    def of(
        cls, position: np.ndarray, sun: np.ndarray, to_earth: np.ndarray, fields: FieldMap
    ) -> _AtPosition:
        """Return the values at positions (n, 3) m in J2000.

        `sun` (n, 3): position of the Sun in J2000, m; `to_earth` (n, 3, 3): rotation from J2000 to Earth-fixed axes, in which the
        map of the field is.
        """
        field = fields.at(rotate_vectors(to_earth, position))
        field_J2000 = rotate_vectors(np.swapaxes(to_earth, -1, -2), field)
        return cls(sunlit_fraction(position, sun), field_J2000, albedo_light(position, sun))


@dataclass(frozen=True)
class Orbit:
    """Environment of a spacecraft in an orbit, made by :func:`in_orbit`. Times are s from `epoch_utc` of the telemetry.

    `node_rad` rotates the whole orbit about the Earth's axis: the orbit check compares with randomly rotated orbits. The shift
    holds at `middle_jd` (UTC) and drifts by `drift_s_day`.
    """

    epoch_utc: str
    elements: tuple[Source, ...]
    shift_s: float
    shift_sigma_s: float
    clock_s: float = 0.0
    clock_sigma_s: float = CLOCK_SIGMA_S
    node_rad: float = 0.0
    drift_s_day: float = 0.0
    drift_sigma_s_day: float = 0.0
    middle_jd: float = 0.0
    frame_N: str = J2000

    @property
    def offset_sigma_s(self) -> float:
        """Standard deviation of the along-track offset at mid-file, s: of the elements and of the clock together."""
        return float(np.hypot(self.shift_sigma_s, self.clock_sigma_s))

    def days(self, when: Instants) -> np.ndarray:
        """Return the days (n) from the middle of the telemetry."""
        return (when.jd - self.middle_jd) + when.fraction

    def ahead_s(self, when: Instants) -> np.ndarray:
        """Return the time (n) by which the spacecraft is ahead of the elements, s."""
        return self.shift_s + self.drift_s_day * self.days(when)

    def ahead_sigma_s(self, when: Instants) -> np.ndarray:
        """Return the standard deviation (n) of the position along the track in s of flight, from shift, drift and clock."""
        return np.hypot(self.offset_sigma_s, self.drift_sigma_s_day * self.days(when))

    def instants(self, t_s: npt.ArrayLike) -> Instants:
        """Return the true instants of telemetry times (n), corrected for the clock."""
        t = np.atleast_1d(np.asarray(t_s, dtype=np.float64))
        return Instants.of(self.epoch_utc, t + self.clock_s)

    def states(
        self, when: Instants, ahead_s: npt.ArrayLike | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (m) and velocities (m/s), both (..., n, 3) in J2000, at instants `when` (n).

        The spacecraft is taken to be `ahead_s` (..., n) seconds of flight ahead of its elements; by default as far as the orbit
        itself says (`self.ahead_s`).
        """
        moved = when.later(self.ahead_s(when) if ahead_s is None else ahead_s)
        jd, fraction = (part.ravel() for part in np.broadcast_arrays(moved.jd, moved.fraction))
        # each time uses the elements with the nearest epoch
        epochs = [sum(source.epoch_jd) for source in self.elements]
        nearest = np.abs((jd + fraction)[:, None] - epochs).argmin(axis=1)
        states = np.empty((2, len(jd), 3))  # positions, velocities
        for k in np.unique(nearest):
            uses_k = nearest == k
            states[:, uses_k] = self.elements[k].states(jd[uses_k], fraction[uses_k])
        # precession and nutation of the telemetry times serve for all shifts, which are short
        to_J2000 = J2000_from_TEME(when) if self.elements[0].frame == "TEME" else np.eye(3)
        # a comparison orbit of the orbit check is rotated about the Earth's axis
        if self.node_rad:
            c, s = np.cos(self.node_rad), np.sin(self.node_rad)
            to_J2000 = to_J2000 @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        position, velocity = rotate_vectors(to_J2000, states.reshape(2, *moved.fraction.shape, 3))
        return position, velocity

    def field_map_around(self, when: Instants, position: np.ndarray) -> FieldMap:
        """Return the map of the magnetic field that covers these times and positions (..., 3) in m."""
        radius = np.linalg.norm(position, axis=-1)
        return field_map(when.middle_jd, (float(radius.min()), float(radius.max())))

    def at(self, t_s: npt.ArrayLike) -> Surroundings:
        """Return the surroundings at times (n) in s from the epoch, in J2000.

        Errors come from shift and clock, and from the models. The errors that shift and clock cause are differences to the values
        at positions one standard deviation ahead and behind along the track.
        """
        when = self.instants(t_s)
        sun, to_earth = sun_J2000_m(when), earth_from_J2000(when)
        position, velocity = self.states(when)
        fields = self.field_map_around(when, position)
        ahead, ahead_sigma = self.ahead_s(when), self.ahead_sigma_s(when)
        position_behind, _ = self.states(when, ahead - ahead_sigma)
        position_in_front, _ = self.states(when, ahead + ahead_sigma)
        here, behind, in_front = (
            _AtPosition.of(each, sun, to_earth, fields)
            for each in (position, position_behind, position_in_front)
        )
        lit_sigma, field_sigma, albedo_sigma = (
            _larger_difference(*values) for values in zip(here, behind, in_front, strict=True)
        )
        to_sun, distance = sun - position, np.linalg.norm(position, axis=1)
        # angular velocity of the position vector, and so of the nadir
        nadir_rate = np.cross(position, velocity) / distance[:, None] ** 2
        return Surroundings(
            sun_N=to_sun / np.linalg.norm(to_sun, axis=1, keepdims=True),
            sun_sigma_rad=np.full(len(position), SUN_SIGMA_RAD),
            lit=here.lit,
            lit_sigma=lit_sigma,
            field_N=here.field_J2000,
            field_sigma_T=np.hypot(np.linalg.norm(field_sigma, axis=1), MODEL_SIGMA_T),
            nadir_N=-position / distance[:, None],
            nadir_sigma_rad=np.linalg.norm(nadir_rate, axis=1) * ahead_sigma,
            nadir_turn_N=nadir_rate,
            earth_radius_rad=np.arcsin(EQUATOR_M / distance),
            albedo_light_N=here.albedo,
            albedo_sigma=np.hypot(
                np.linalg.norm(albedo_sigma, axis=1),
                REFLECTIVITY_SIGMA / REFLECTIVITY * np.linalg.norm(here.albedo, axis=1),
            ),
            field_along_N=(in_front.field_J2000 - behind.field_J2000) / 2,
        )

    def notes(self, t_s: npt.ArrayLike) -> list[str]:
        """Return warnings about the elements for telemetry at these times: samples before all elements, and old elements."""
        when = self.instants(t_s)
        jd = when.jd + when.fraction
        return [*self._warn_of_early_samples(jd), *self._warn_of_old_elements(jd[[0, -1]])]

    def _warn_of_early_samples(self, jd: np.ndarray) -> list[str]:
        """Return a warning if samples (n, UTC Julian dates) are long before the first elements, as with a wrong clock."""
        first = min(sum(source.epoch_jd) for source in self.elements)
        early = jd[jd < first - OLD_DAYS]
        if not early.size:
            return []
        first_day, last_day = _iso_date(early.min()), _iso_date(early.max())
        days = first_day if first_day == last_day else f"{first_day} to {last_day}"
        return [
            f"{early.size} of {jd.size} samples are dated {days}, before the first elements ({_iso_date(first)}): check the clock"
        ]

    def _warn_of_old_elements(self, ends: np.ndarray) -> list[str]:
        """Return a warning if the nearest elements are old at either end of the telemetry (2, UTC Julian dates).

        If the error along the track exceeds a quarter of a revolution, the warning says that nothing is known of the position.
        """
        days = max(min(abs(source.days_to(jd)) for source in self.elements) for jd in ends)
        if days < OLD_DAYS:
            return []
        known = f"the place along the track is known to some {self.shift_sigma_s:.0f} s"
        if self.shift_sigma_s > self.elements[0].period_s / 4:
            known = "nothing is known of the place along the track; get elements of the days of the telemetry"
        return [f"the elements are {days:.0f} days from the telemetry: {known}"]


def _iso_date(jd: float) -> str:
    """Return the day of a Julian date in ISO-8601."""
    return date.fromordinal(int(np.floor(jd - 1_721_424.5))).isoformat()  # day 1: JD 1721425.5


@dataclass(frozen=True)
class SunAlongZ:
    """An orbit's environment in axes with z along the Sun direction at each time, as `rates` uses it.

    x is perpendicular to the Earth's axis. The axes rotate with the Sun at 2e-7 rad/s, which is neglected.
    """

    orbit: Orbit
    frame_N: str = SUN_Z_LOCAL

    def at(self, t_s: npt.ArrayLike) -> Surroundings:
        """Return the surroundings at times (n), with all vectors in these axes."""
        here = self.orbit.at(t_s)
        matrix = _axes_along_z(here.sun_N)
        vectors = {name: rotate_vectors(matrix, getattr(here, name)) for name in VECTORS}
        return replace(here, **vectors)

    def N_from_J2000(self, t_s: npt.ArrayLike) -> np.ndarray:
        """Return matrices (n, 3, 3) from J2000 to these axes."""
        when = self.orbit.instants(t_s)
        to_sun = sun_J2000_m(when) - self.orbit.states(when)[0]
        return _axes_along_z(to_sun / np.linalg.norm(to_sun, axis=1, keepdims=True))


VECTORS = ("sun_N", "field_N", "field_along_N", "nadir_N", "nadir_turn_N", "albedo_light_N")
"""Fields of the surroundings that have components in N."""


def _axes_along_z(sun: np.ndarray) -> np.ndarray:
    """Return matrices (n, 3, 3) from J2000 to axes with z along unit directions `sun` (n, 3).

    x is perpendicular to the Earth's axis, along which the Sun never is.
    """
    x_axis = np.cross([0.0, 0.0, 1.0], sun)
    x_axis /= np.linalg.norm(x_axis, axis=1, keepdims=True)
    return np.stack([x_axis, np.cross(sun, x_axis), sun], axis=1)


def _larger_difference(here: np.ndarray, behind: np.ndarray, in_front: np.ndarray) -> np.ndarray:
    """Return the larger of the differences of a value to those behind and ahead along the track."""
    return np.maximum(np.abs(behind - here), np.abs(in_front - here))


def in_orbit(
    elements: tuple[Source, ...],
    epoch_utc: str,
    t_s: npt.ArrayLike,
    *,
    shift_s: float = 0.0,
    shift_sigma_s: float | None = None,
    clock_s: float = 0.0,
    clock_sigma_s: float | None = None,
) -> Orbit:
    """Return the environment of telemetry whose times (n) count from `epoch_utc`, in an orbit.

    `elements` are element sets or a table of positions (`read_orbit`). Of several element sets, each time uses the one with the
    nearest epoch. `shift_s`, `clock_s` and their sigmas (s): see the module; by default the sigma of the shift is that of the
    elements' age, and that of the clock 1 s. The drift is 0, with the sigma of :func:`drift_sigma_s_day`.
    """
    clock_sigma = CLOCK_SIGMA_S if clock_sigma_s is None else clock_sigma_s
    orbit = Orbit(epoch_utc, elements, shift_s, 0.0, clock_s, clock_sigma)
    when = orbit.instants(t_s)
    evaluated = when.later(shift_s)  # instants at which the elements are evaluated
    elements[0].require_coverage(evaluated.jd + evaluated.fraction)
    middle = float((when.jd + when.fraction).mean())
    days = min((source.days_to(middle) for source in elements), key=abs)
    sigma = age_sigma_s(days) if shift_sigma_s is None else shift_sigma_s
    drift_sigma = drift_sigma_s_day(sigma, days)
    return replace(orbit, shift_sigma_s=sigma, drift_sigma_s_day=drift_sigma, middle_jd=middle)
