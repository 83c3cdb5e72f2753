"""The Earth's magnetic field by IGRF, as a map that is read quickly.

`ppigrf` sums the 195 coefficients; 20,000 places take it a second. A map of 5 degrees in latitude and longitude on a few spheres,
in Earth-fixed components, read by cubic splines and a polynomial of the radius, gives the same field to 2 nT.
"""

from __future__ import annotations

from datetime import datetime, timedelta
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from sunspin.base.errors import InputError
from sunspin.base.lazy import lazy

if TYPE_CHECKING:
    from scipy import ndimage
else:
    ndimage = lazy("scipy.ndimage")

YEARS = (1900.0, 2030.0)
"""Of IGRF-14."""

MODEL_SIGMA_T = 1.5e-7
"""What IGRF leaves out in each component: crust, currents in the ionosphere and around the Earth on a quiet day."""

STEP_DEG = 5
POLE_ROWS = 8
"""Rows of the map beyond each pole, so that its splines have no edge there."""

REFERENCE_M = 6_371_200.0
MAP_DAYS = 30.0
"""The field of one day stands for half this many before and after: it changes by 0.1 uT a year."""


class FieldMap(NamedTuple):
    """Spline coefficients (radii, 3, latitudes, longitudes) of B (r / a)^3 in T, on the spheres a / r = `inverse`."""

    coefficients: np.ndarray
    inverse: np.ndarray

    def at(self, place: np.ndarray) -> np.ndarray:
        """The field (..., 3) in T at Earth-fixed places (..., 3) in m, in Earth-fixed axes."""
        flat = place.reshape(-1, 3)
        radius = np.linalg.norm(flat, axis=1)
        row = (90 - np.degrees(np.arcsin(flat[:, 2] / radius))) / STEP_DEG + POLE_ROWS
        column = np.degrees(np.arctan2(flat[:, 1], flat[:, 0])) % 360 / STEP_DEG + POLE_ROWS
        inverse, field = REFERENCE_M / radius, np.zeros_like(flat)
        for k, node in enumerate(self.inverse):
            others = np.delete(self.inverse, k)
            weight = np.prod((inverse[:, None] - others) / (node - others), axis=1)
            for axis in range(3):
                field[:, axis] += weight * ndimage.map_coordinates(
                    self.coefficients[k, axis], [row, column], prefilter=False
                )
        return (field * inverse[:, None] ** 3).reshape(place.shape)


def field_map(jd: float, radius_m: tuple[float, float]) -> FieldMap:
    """The map for a UTC Julian date and between two radii (m). `InputError` outside the years of IGRF."""
    year = 2000 + (jd - 2451544.5) / 365.25
    if not YEARS[0] <= year < YEARS[1]:
        what = f"the Earth's field is known from {YEARS[0]:.0f} to {YEARS[1]:.0f} (IGRF-14)"
        raise InputError(what, got=f"a time in {year:.0f}", do="check the clock of the telemetry")
    step = 1e4
    low, high = step * np.floor(radius_m[0] / step), step * np.ceil(radius_m[1] / step)
    return _build_field_map(MAP_DAYS * round(jd / MAP_DAYS), float(low), float(high))


@lru_cache(maxsize=8)
def _build_field_map(jd: float, low: float, high: float) -> FieldMap:
    span = REFERENCE_M / low - REFERENCE_M / high
    spheres = 3 + int(np.ceil(12 * span))
    bend = np.cos(np.pi * (np.arange(spheres) + 0.5) / spheres)
    inverse = (
        REFERENCE_M / high + span * (1 + bend) / 2 if span > 0 else np.array([REFERENCE_M / low])
    )
    latitude, longitude = np.arange(90, -91, -STEP_DEG), np.arange(0, 360, STEP_DEG)
    rows = []
    for value in inverse:
        field = value**-3 * _compute_igrf(jd, REFERENCE_M / value, latitude, longitude)
        half = np.roll(field, len(longitude) // 2, axis=2)  # beyond a pole is the other side
        field = np.concatenate(
            [half[:, POLE_ROWS:0:-1], field, half[:, -2 : -2 - POLE_ROWS : -1]], axis=1
        )
        rows.append(
            np.concatenate([field[:, :, -POLE_ROWS:], field, field[:, :, : POLE_ROWS + 1]], axis=2)
        )
    return FieldMap(
        np.array([[ndimage.spline_filter(part) for part in row] for row in rows]), inverse
    )


def _compute_igrf(
    jd: float, radius_m: float, latitude: np.ndarray, longitude: np.ndarray
) -> np.ndarray:
    """The field (3, latitudes, longitudes) in T, in Earth-fixed axes."""
    import ppigrf

    date = datetime(2000, 1, 1) + timedelta(days=jd - 2451544.5)
    # at a pole itself the eastward component is 0 / 0
    colatitude = np.clip(90.0 - latitude, 1e-4, 180 - 1e-4)[:, None]
    up, south, east = (
        part[0] * 1e-9 for part in ppigrf.igrf_gc(radius_m / 1e3, colatitude, longitude[None], date)
    )
    theta, phi = np.radians(colatitude), np.radians(longitude)[None]
    level = up * np.sin(theta) + south * np.cos(theta)
    x, y = level * np.cos(phi) - east * np.sin(phi), level * np.sin(phi) + east * np.cos(phi)
    return np.array([x, y, up * np.cos(theta) - south * np.sin(theta)])
