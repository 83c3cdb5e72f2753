"""The surroundings of a spacecraft in an orbit about the Earth that others have determined.

Two numbers say how far that orbit may be trusted along its track, each with its error: `shift_s`, how far the spacecraft is ahead
of the elements (negative: it comes later), and `clock_s`, how far the telemetry's clock is behind UTC. The Sun and the Earth's
turn follow the clock, the place follows clock plus shift. The Earth turns by only a degree in four minutes, so that what data
determine well is the sum. What the sum gains in a day, `drift_s_day`, is an error of the elements' mean motion, drag, or a clock
that is slow: data do not part these either.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import date

import numpy as np
import numpy.typing as npt

from sunspin.environment.earth import (
    EQUATOR_M,
    Instants,
    J2000_from_TEME,
    earth_from_J2000,
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
"""ERFA's Sun, parallax of the orbit included."""

CLOCK_SIGMA_S = 1.0
"""Of a telemetry clock of which nothing is said: stamps in whole seconds."""


def age_sigma_s(days: float) -> float:
    """How far elements may be off along the track after so many days, s: 2 km at their epoch and in a low orbit 1.5 km more a day,
    growing with the square of the time as drag's errors do (an assumption; Vallado and Cefola 2012 find 1 to 3 km a day)."""
    return 0.3 + 0.2 * abs(days) + 0.01 * days**2


DRIFT_DAYS = 30.0
"""In so many days the shift may change by its own sigma, whatever made it: another satellite of the same launch, a clock."""


def drift_sigma_s_day(shift_sigma_s: float, days: float) -> float:
    """How much the shift of elements so many days old may change in a day: as :func:`age_sigma_s` grows, and see `DRIFT_DAYS`."""
    return float(np.hypot(0.2 + 0.02 * abs(days), shift_sigma_s / DRIFT_DAYS))


Source = Elements | Ephemeris
"""What gives positions. `states`: positions (n, 3) m and velocities (n, 3) m/s in `frame`, "TEME" or "J2000", at UTC Julian dates
(n) and fractions (n). `days_to`: from its epoch, or the table's nearer end, to a UTC Julian date. `require`: `InputError` where
telemetry at such dates (n) has no position."""


@dataclass(frozen=True)
class Orbit:
    """An environment by elements; times are s from `epoch_utc`, the telemetry's. Made by :func:`in_orbit`.

    `node_rad` turns the whole orbit about the Earth's axis: the orbit check compares with orbits turned at random. The shift is
    that at `middle_jd` (UTC) and drifts by `drift_s_day`.
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

    def days(self, when: Instants) -> np.ndarray:
        """Days (n) from the middle of the telemetry."""
        return (when.jd - self.middle_jd) + when.fraction

    def ahead_s(self, when: Instants) -> np.ndarray:
        """How far the spacecraft is ahead of the elements (n), s."""
        return self.shift_s + self.drift_s_day * self.days(when)

    def ahead_sigma_s(self, when: Instants) -> np.ndarray:
        """One sigma (n) of the place along the track, s: of shift, drift and clock."""
        constant = np.hypot(self.shift_sigma_s, self.clock_sigma_s)
        return np.hypot(constant, self.drift_sigma_s_day * self.days(when))

    def instants(self, t_s: npt.ArrayLike) -> Instants:
        """The true times."""
        t = np.atleast_1d(np.asarray(t_s, dtype=np.float64))
        return Instants.of(self.epoch_utc, t + self.clock_s)

    def states(
        self, when: Instants, ahead_s: npt.ArrayLike | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities (..., n, 3) in J2000, m and m/s, `ahead_s` (..., n) along the track; default: as known."""
        moved = when.later(self.ahead_s(when) if ahead_s is None else ahead_s)
        jd, fraction = (part.ravel() for part in np.broadcast_arrays(moved.jd, moved.fraction))
        epochs = [sum(source.epoch_jd) for source in self.elements]
        which = np.abs((jd + fraction)[:, None] - epochs).argmin(axis=1)
        both = np.empty((2, len(jd), 3))
        for k in np.unique(which):
            both[:, which == k] = self.elements[k].states(jd[which == k], fraction[which == k])
        turn = J2000_from_TEME(when) if self.elements[0].frame == "TEME" else np.eye(3)
        if self.node_rad:
            c, s = np.cos(self.node_rad), np.sin(self.node_rad)
            turn = turn @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        place, speed = rotate_vectors(turn, both.reshape(2, *moved.fraction.shape, 3))
        return place, speed

    def field_map_around(self, when: Instants, place: np.ndarray) -> FieldMap:
        """The field's map that covers these times and places."""
        radius = np.linalg.norm(place, axis=-1)
        return field_map(when.middle_jd, (float(radius.min()), float(radius.max())))

    def at(self, t_s: npt.ArrayLike) -> Surroundings:
        """The surroundings at times (n) in s from the epoch; sigmas are those of shift and clock, and of the models."""
        when = self.instants(t_s)
        sun, turn = sun_J2000_m(when), earth_from_J2000(when)
        place, speed = self.states(when)
        fields = self.field_map_around(when, place)
        ahead, along = self.ahead_s(when), self.ahead_sigma_s(when)

        def seen(at: np.ndarray) -> tuple[np.ndarray, ...]:
            field = rotate_vectors(np.swapaxes(turn, -1, -2), fields.at(rotate_vectors(turn, at)))
            return sunlit_fraction(at, sun), field, albedo_light(at, sun)

        here = seen(place)
        sides = [seen(self.states(when, ahead + side)[0]) for side in (-along, along)]
        lit_sigma, field_sigma, light_sigma = (
            _larger_difference(*three) for three in zip(here, *sides, strict=True)
        )
        to_sun, distance = sun - place, np.linalg.norm(place, axis=1)
        turning = np.cross(place, speed) / distance[:, None] ** 2
        return Surroundings(
            sun_N=to_sun / np.linalg.norm(to_sun, axis=1, keepdims=True),
            sun_sigma_rad=np.full(len(place), SUN_SIGMA_RAD),
            lit=here[0],
            lit_sigma=lit_sigma,
            field_N=here[1],
            field_sigma_T=np.hypot(np.linalg.norm(field_sigma, axis=1), MODEL_SIGMA_T),
            nadir_N=-place / distance[:, None],
            nadir_sigma_rad=np.linalg.norm(turning, axis=1) * along,
            nadir_turn_N=turning,
            earth_radius_rad=np.arcsin(EQUATOR_M / distance),
            albedo_light_N=here[2],
            albedo_sigma=np.hypot(
                np.linalg.norm(light_sigma, axis=1),
                REFLECTIVITY_SIGMA / REFLECTIVITY * np.linalg.norm(here[2], axis=1),
            ),
            field_along_N=(sides[1][1] - sides[0][1]) / 2,
        )

    def notes(self, t_s: npt.ArrayLike) -> list[str]:
        """What has to be said of these elements at these times."""
        when = self.instants(t_s)
        jd = when.jd + when.fraction
        return [*self._before_all(jd), *self._far(jd[[0, -1]])]

    def _before_all(self, jd: np.ndarray) -> list[str]:
        """Return a sentence on samples (n, UTC Julian dates) dated long before the first elements, as by a wrong clock."""
        first = min(sum(source.epoch_jd) for source in self.elements)
        early = jd[jd < first - OLD_DAYS]
        if not early.size:
            return []
        first_day, last_day = _iso_date(early.min()), _iso_date(early.max())
        days = first_day if first_day == last_day else f"{first_day} to {last_day}"
        return [
            f"{early.size} of {jd.size} samples are dated {days}, before the first elements ({_iso_date(first)}): check the clock"
        ]

    def _far(self, ends: np.ndarray) -> list[str]:
        """Return a sentence on elements that are old at either end of the telemetry (2, UTC Julian dates)."""
        days = max(min(abs(source.days_to(jd)) for source in self.elements) for jd in ends)
        if days < OLD_DAYS:
            return []
        known = f"the place along the track is known to some {self.shift_sigma_s:.0f} s"
        if self.shift_sigma_s > self.elements[0].period_s / 4:
            known = "nothing is known of the place along the track; get elements of the days of the telemetry"
        return [f"the elements are {days:.0f} days from the telemetry: {known}"]


def _iso_date(jd: float) -> str:
    """Return the day of a Julian date as ISO-8601 writes it."""
    return date.fromordinal(int(np.floor(jd - 1_721_424.5))).isoformat()


@dataclass(frozen=True)
class SunAlongZ:
    """An orbit's environment in axes whose z is the Sun's direction at each time, as `rates` wants it, their x at right angles to
    the Earth's axis. They turn in space with the Sun, by 2e-7 rad/s, which is left out wherever N stands still."""

    orbit: Orbit
    frame_N: str = SUN_Z_LOCAL

    def at(self, t_s: npt.ArrayLike) -> Surroundings:
        here = self.orbit.at(t_s)
        matrix = _axes_along_z(here.sun_N)
        vectors = {name: rotate_vectors(matrix, getattr(here, name)) for name in VECTORS}
        return replace(here, **vectors)

    def N_from_J2000(self, t_s: npt.ArrayLike) -> np.ndarray:
        """Matrices (n, 3, 3) from J2000 to these axes."""
        when = self.orbit.instants(t_s)
        to_sun = sun_J2000_m(when) - self.orbit.states(when)[0]
        return _axes_along_z(to_sun / np.linalg.norm(to_sun, axis=1, keepdims=True))


VECTORS = ("sun_N", "field_N", "field_along_N", "nadir_N", "nadir_turn_N", "albedo_light_N")
"""What of the surroundings has components in N."""


def _axes_along_z(sun: np.ndarray) -> np.ndarray:
    """Matrices (n, 3, 3) to axes with z along directions (n, 3) that are never those of the Earth's axis."""
    first = np.cross([0.0, 0.0, 1.0], sun)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(sun, first), sun], axis=1)


def rotate_vectors(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Matrices (n, 3, 3) times vectors (..., n, 3)."""
    return (matrix @ vector[..., None])[..., 0]


def _larger_difference(here: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """How much a value differs along the track: the larger difference of the two sides."""
    return np.maximum(np.abs(before - here), np.abs(after - here))


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
    """The environment of telemetry whose times (n) count from `epoch_utc`, in an orbit by these elements (`read_elements`), or by
    this table of positions (`read_ephemeris`).

    Of several element sets the one whose epoch is nearest serves each time. `shift_s`, `clock_s` and their sigmas (s): see the
    module; by default the shift is as uncertain as the elements are old, and the clock by 1 s. The shift's drift is 0, as uncertain
    as :func:`drift_sigma_s_day` says.
    """
    clock_sigma = CLOCK_SIGMA_S if clock_sigma_s is None else clock_sigma_s
    orbit = Orbit(epoch_utc, elements, shift_s, 0.0, clock_s, clock_sigma)
    when = orbit.instants(t_s)
    elements[0].require_coverage(when.later(shift_s).jd + when.later(shift_s).fraction)
    middle = float((when.jd + when.fraction).mean())
    days = min((source.days_to(middle) for source in elements), key=abs)
    sigma = age_sigma_s(days) if shift_sigma_s is None else shift_sigma_s
    drift_sigma = drift_sigma_s_day(sigma, days)
    return replace(orbit, shift_sigma_s=sigma, drift_sigma_s_day=drift_sigma, middle_jd=middle)
