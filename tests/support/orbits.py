"""Orbits about the Earth and bodies in them, by equations of the tests' own: SGP4, IGRF, the Almanac's Sun, a cylinder of shadow.

Nothing of the package's environment or dynamics is used: SGP4 and IGRF are called as their authors offer them, and Greenwich
sidereal time gives the rotation of the Earth. N is the true equator and equinox of date. All of it is synthetic.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta
from typing import Any, NamedTuple

import numpy as np
import ppigrf
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from sgp4.api import Satrec, jday

from tests.support.vehicles import unit_vector

EARTH_KM = 6371.0
EPOCH = datetime(2021, 3, 14, 6)
STEP_S = 10.0
"""Interval of the instants between which `Arc` interpolates place and field."""


def two_line_elements(rng: np.random.Generator) -> tuple[str, str]:
    """Draw the two lines of a low orbit at `EPOCH`."""
    inclination, node, perigee, anomaly = rng.uniform([30, 0, 0, 0], [100, 360, 360, 360])
    day = (EPOCH - datetime(2021, 1, 1)).total_seconds() / 86400 + 1
    first = f"1 99999U 21001A   21{day:012.8f}  .00001000  00000-0  50000-4 0  999"
    shape = f"{int(rng.uniform(5e3, 3e4)):07d} {perigee:8.4f} {anomaly:8.4f} {rng.uniform(14.9, 15.5):11.8f}"
    second = f"2 99999 {inclination:8.4f} {node:8.4f} {shape}    1"
    return with_check_digit(first), with_check_digit(second)


def with_check_digit(line: str) -> str:
    """Return the first 68 characters of a line, followed by their check digit."""
    # digits in ASCII only: `isdigit` is true for a small ² too
    digits = [int(c) if c in "0123456789" else int(c == "-") for c in line[:68]]
    return line[:68] + str(sum(digits) % 10)


def with_node_turned(second: str, by_deg: float) -> str:
    """Return the second line with its ascending node turned by an angle."""
    node = (float(second[17:25]) + by_deg) % 360
    return with_check_digit(f"{second[:17]}{node:8.4f}{second[25:68]}")


def days_since_j2000(t_s: np.ndarray) -> np.ndarray:
    """Return days since J2000.0 at seconds after `EPOCH`."""
    day, fraction = jday(EPOCH.year, EPOCH.month, EPOCH.day, EPOCH.hour, 0, 0)
    return day - 2451545.0 + fraction + t_s / 86400


def place_and_speed(elements: tuple[str, str], t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return place (n, 3) km and velocity (n, 3) km/s by SGP4 at seconds after `EPOCH`."""
    day, fraction = jday(EPOCH.year, EPOCH.month, EPOCH.day, EPOCH.hour, 0, 0)
    days = np.full(len(t_s), day), fraction + t_s / 86400
    _, place, speed = Satrec.twoline2rv(*elements).sgp4_array(*days)
    return place, speed


def sidereal_angle(days: np.ndarray) -> np.ndarray:
    """Return the mean sidereal angle of Greenwich, rad, at days since J2000.0."""
    return np.radians((280.46061837 + 360.98564736629 * days) % 360)


def sun_of_date(days: np.ndarray) -> np.ndarray:
    """Return Sun directions (n, 3) at days (n) since J2000.0: Astronomical Almanac, page C5, to 0.01 degrees."""
    anomaly = np.radians(357.528 + 0.9856003 * days)
    circular = 280.460 + 0.9856474 * days
    longitude = np.radians(circular + 1.915 * np.sin(anomaly) + 0.020 * np.sin(2 * anomaly))
    tilt, across = np.radians(23.439 - 4e-7 * days), np.sin(longitude)
    return np.column_stack([np.cos(longitude), np.cos(tilt) * across, np.sin(tilt) * across])


def field_nT(place: np.ndarray, sidereal: np.ndarray, when: datetime) -> np.ndarray:
    """Return IGRF (n, 3) nT in the axes of `place` (n, 3) km, in which the Earth is turned by `sidereal` (n) rad."""
    radius = np.linalg.norm(place, axis=1)
    theta, phi = np.arccos(place[:, 2] / radius), np.arctan2(place[:, 1], place[:, 0])
    field = ppigrf.igrf_gc(radius, np.degrees(theta), np.degrees(phi - sidereal), when)
    up, south, east = (part[0] for part in field)
    level = up * np.sin(theta) + south * np.cos(theta)
    x = level * np.cos(phi) - east * np.sin(phi)
    y = level * np.sin(phi) + east * np.cos(phi)
    return np.column_stack([x, y, up * np.cos(theta) - south * np.sin(theta)])


def is_sunlit(place: np.ndarray, sun: np.ndarray) -> np.ndarray:
    """Return whether places (..., 3) km are outside the Earth's cylinder of shadow; `sun` (..., 3) is the Sun direction."""
    along = (place * sun).sum(axis=-1)
    off_axis = np.linalg.norm(place - along[..., None] * sun, axis=-1)
    return (along > 0) | (off_axis > EARTH_KM)


def sky(
    elements: tuple[str, str], begin_s: float, t_s: np.ndarray, ahead_s: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return Sun direction (n, 3), field (n, 3) nT, whether the satellite is sunlit (n), and whether the ground below is (n).

    `t_s` counts from `begin_s` after `EPOCH`; the satellite is `ahead_s` ahead of its elements.
    """
    place, _ = place_and_speed(elements, begin_s + t_s + ahead_s)
    days = days_since_j2000(begin_s + t_s)
    sun = sun_of_date(days)
    field = field_nT(place, sidereal_angle(days), EPOCH + timedelta(seconds=begin_s))
    return sun, field, is_sunlit(place, sun), (place * sun).sum(axis=1) > 0


class Arc(NamedTuple):
    """A part of an orbit: place (km) and field (T) at seconds from its begin, the Sun, mean radius and angular rate."""

    place_km: CubicSpline
    field_T: CubicSpline
    sun: np.ndarray
    radius_km: float
    rate_rad_s: float

    @classmethod
    def of(cls, elements: tuple[str, str], begin_s: float, ahead_s: float, span_s: float) -> Arc:
        """Return the arc of `span_s` that begins `begin_s` after `EPOCH`, `ahead_s` ahead of the elements."""
        t = np.arange(-STEP_S, span_s + 2 * STEP_S, STEP_S)
        place, speed = place_and_speed(elements, begin_s + t + ahead_s)
        days = days_since_j2000(begin_s + t)
        when = EPOCH + timedelta(seconds=begin_s)
        field = 1e-9 * field_nT(place, sidereal_angle(days), when)
        radius = float(np.linalg.norm(place, axis=1).mean())
        rate = float(np.linalg.norm(np.cross(place, speed), axis=1).mean() / radius**2)
        sun = sun_of_date(days[:1])[0]
        return cls(CubicSpline(t, place), CubicSpline(t, field), sun, radius, rate)


class Ground(NamedTuple):
    """Patches of the Earth of equal area: directions from its centre (m, 3) and albedo (m)."""

    up: np.ndarray
    albedo: np.ndarray

    @classmethod
    def drawn(cls, rng: np.random.Generator, patches: int = 20_000) -> Ground:
        """Draw albedos of 0.3, more or less by half, in clouds of 500 km and seas of 3000 km."""
        z = 1 - (2 * np.arange(patches) + 1) / patches
        turn = np.pi * (3 - np.sqrt(5)) * np.arange(patches)
        level = np.sqrt(1 - z**2)
        up = np.column_stack([level * np.cos(turn), level * np.sin(turn), z])
        waves = np.array([rng.uniform(2, 12) * unit_vector(rng) for _ in range(8)])
        return cls(up, 0.3 * np.exp(0.2 * np.sin(up @ waves.T + rng.uniform(0, 6, 8)).sum(axis=1)))

    def light(self, place: np.ndarray, sun: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Return the reflected light on panels with normals (p, 3) in N, relative to full Sun; patches are Lambert scatterers."""
        seen = self.up @ place > EARTH_KM
        up, albedo = self.up[seen], self.albedo[seen]
        ray = EARTH_KM * up - place
        distance = np.linalg.norm(ray, axis=1)
        ray = ray / distance[:, None]
        area = 4 * np.pi * EARTH_KM**2 / len(self.up)
        towards = np.maximum(-np.einsum("mi,mi->m", up, ray), 0)
        sent = albedo * np.maximum(up @ sun, 0) * towards / np.pi
        return np.maximum(normals @ ray.T, 0) @ (sent * area / distance**2)


class Body(NamedTuple):
    """Inertia (3, 3) kg m2 and residual magnetic dipole (3) A m2."""

    inertia: np.ndarray
    dipole: np.ndarray

    def change(self, arc: Arc) -> Callable[[float, np.ndarray], np.ndarray]:
        """Return the right-hand side for the quaternion B_from_N (scalar last) and the rate in B."""
        inverse = np.linalg.inv(self.inertia)

        def f(t: float, y: np.ndarray) -> np.ndarray:
            body_from_N, w = Rotation.from_quat(y[:4]), y[4:]
            up = body_from_N.apply(arc.place_km(t) / arc.radius_km)
            magnetic = np.cross(self.dipole, body_from_N.apply(arc.field_T(t)))
            gravity = 3 * arc.rate_rad_s**2 * np.cross(up, self.inertia @ up)
            spin = 0.5 * np.append(-y[3] * w - np.cross(w, y[:3]), w @ y[:3])
            torque = magnetic + gravity
            return np.concatenate([spin, inverse @ (torque - np.cross(w, self.inertia @ w))])

        return f


def drawn_body(rng: np.random.Generator) -> Body:
    """Draw a CubeSat of one to three units of 1.3 kg, with masses in random places."""
    units = int(rng.integers(1, 4))
    places = rng.uniform(-0.05, 0.05, (60, 3)) * [1, 1, units]
    places -= places.mean(axis=0)
    inertia = 1.3 * units / 60 * (np.eye(3) * (places**2).sum() - places.T @ places)
    if rng.random() < 0.25:
        rng.uniform()  # a number that nothing uses, so that what is drawn next stays the same for each seed
    return Body(inertia, units * 10 ** rng.uniform(-3, -1.7) * unit_vector(rng))


def motion(
    body: Body, arc: Arc, omega_B: np.ndarray, t: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return quaternions (n, 4) B_from_N and rates (n, 3) rad/s at times t (n), from a random attitude."""
    attitude = Rotation.random(random_state=int(rng.integers(2**31)))
    start = np.concatenate([attitude.as_quat(), omega_B])
    precise: dict[str, Any] = {"method": "DOP853", "rtol": 1e-9, "atol": 1e-11}
    solved = solve_ivp(body.change(arc), (0.0, t[-1]), start, t_eval=t, **precise)
    quaternion = solved.y[:4].T
    return quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True), solved.y[4:].T
