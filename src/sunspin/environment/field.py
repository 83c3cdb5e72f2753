"""The Earth's magnetic field (IGRF), interpolated in a map for speed.

`ppigrf` sums the 195 coefficients at 20,000 positions per second. A map with 5 degrees in latitude and longitude on a few
spheres, in Earth-fixed components, gives the same field to 2 nT. It is interpolated by cubic splines on each sphere and by a
polynomial in the radius.
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
"""Years for which IGRF-14 is defined."""

MODEL_SIGMA_T = 1.5e-7
"""Error of IGRF in each component on a quiet day: crust, and currents in the ionosphere and around the Earth."""

STEP_DEG = 5
"""Grid step of the map."""
POLE_ROWS = 8
"""Rows of the map beyond each pole, and columns beyond each end of the longitudes, so that its splines have no boundary there."""

REFERENCE_M = 6_371_200.0
"""Reference radius of IGRF."""
MAP_DAYS = 30.0
"""Time step of maps: the field changes by 0.1 uT a year, so that of one day is used for half a step on both sides."""


RADIUS_STEP_M = 1e4
"""Step to which the radii of a map are rounded."""


class FieldMap(NamedTuple):
    """A map of the field on spheres of different radii.

    `coefficients` (radii, 3, latitudes, longitudes): spline coefficients of B (r / a)^3 in T; `inverse` (radii): a / r. Here r is
    the radius of a sphere, a `REFERENCE_M`. The grid begins `POLE_ROWS` steps beyond the north pole and west of longitude zero.
    """

    coefficients: np.ndarray
    inverse: np.ndarray

    def at(self, position: np.ndarray) -> np.ndarray:
        """Return the field (..., 3) in T at Earth-fixed positions (..., 3) in m, in Earth-fixed axes."""
        flat = position.reshape(-1, 3)
        radius = np.linalg.norm(flat, axis=1)
        latitude = np.degrees(np.arcsin(flat[:, 2] / radius))
        longitude = np.degrees(np.arctan2(flat[:, 1], flat[:, 0])) % 360
        # fractional indices
        row, column = (90 - latitude) / STEP_DEG + POLE_ROWS, longitude / STEP_DEG + POLE_ROWS
        inverse, field = REFERENCE_M / radius, np.zeros_like(flat)
        for k, node in enumerate(self.inverse):
            # Lagrange polynomial in a / r that is one at this sphere and zero at the others
            others = np.delete(self.inverse, k)
            weight = np.prod((inverse[:, None] - others) / (node - others), axis=1)
            for axis in range(3):
                field[:, axis] += weight * ndimage.map_coordinates(
                    self.coefficients[k, axis], [row, column], prefilter=False
                )
        return (field * inverse[:, None] ** 3).reshape(position.shape)


def field_map(jd: float, radius_m: tuple[float, float]) -> FieldMap:
    """Return the map for a UTC Julian date and positions between two radii (m).

    Raises `InputError` outside the years of IGRF. Date and radii are rounded, so that maps can be cached.
    """
    year = 2000 + (jd - 2451544.5) / 365.25
    if not YEARS[0] <= year < YEARS[1]:
        what = f"the Earth's field is known from {YEARS[0]:.0f} to {YEARS[1]:.0f} (IGRF-14)"
        raise InputError(what, got=f"a time in {year:.0f}", do="check the clock of the telemetry")
    low = RADIUS_STEP_M * np.floor(radius_m[0] / RADIUS_STEP_M)
    high = RADIUS_STEP_M * np.ceil(radius_m[1] / RADIUS_STEP_M)
    return _build_field_map(MAP_DAYS * round(jd / MAP_DAYS), float(low), float(high))


@lru_cache(maxsize=8)
def _build_field_map(jd: float, low: float, high: float) -> FieldMap:
    """Return the map for a UTC Julian date and positions between the radii `low` and `high` (m).

    B (r / a)^3 is smooth in a / r: few spheres, at Chebyshev nodes of it, suffice for a circular orbit; an eccentric one gets more.
    """
    span = REFERENCE_M / low - REFERENCE_M / high
    spheres = 3 + int(np.ceil(12 * span))
    chebyshev = np.cos(np.pi * (np.arange(spheres) + 0.5) / spheres)  # nodes from -1 to 1
    inverse = REFERENCE_M / high + span * (1 + chebyshev) / 2
    if span == 0:  # both radii are equal: one sphere
        inverse = np.array([REFERENCE_M / low])
    latitude, longitude = np.arange(90, -91, -STEP_DEG), np.arange(0, 360, STEP_DEG)
    coefficients = []
    for value in inverse:
        # B (r / a)^3 (3, latitudes, longitudes), then continued by `POLE_ROWS` on all sides, so that splines have no boundary
        field = value**-3 * _compute_igrf(jd, REFERENCE_M / value, latitude, longitude)
        # rows beyond a pole repeat those before it, in reverse order, with the longitudes of the opposite meridian
        opposite = np.roll(field, len(longitude) // 2, axis=2)
        north, south = opposite[:, POLE_ROWS:0:-1], opposite[:, -2 : -2 - POLE_ROWS : -1]
        field = np.concatenate([north, field, south], axis=1)
        # columns beyond an end of the longitudes are those at the other end
        west, east = field[:, :, -POLE_ROWS:], field[:, :, : POLE_ROWS + 1]
        field = np.concatenate([west, field, east], axis=2)
        coefficients.append([ndimage.spline_filter(component) for component in field])
    return FieldMap(np.array(coefficients), inverse)


def _compute_igrf(
    jd: float, radius_m: float, latitude: np.ndarray, longitude: np.ndarray
) -> np.ndarray:
    """Return the field (3, latitudes, longitudes) in T, in Earth-fixed axes, for grids of latitude and longitude (deg)."""
    import ppigrf

    date = datetime(2000, 1, 1) + timedelta(days=jd - 2451544.5)
    # at a pole itself ppigrf computes 0 / 0 for the eastward component
    colatitude = np.clip(90.0 - latitude, 1e-4, 180 - 1e-4)[:, None]
    up, south, east = (
        component[0] * 1e-9  # from nT, and without the dimension of dates
        for component in ppigrf.igrf_gc(radius_m / 1e3, colatitude, longitude[None], date)
    )
    theta, phi = np.radians(colatitude), np.radians(longitude)[None]
    # from up, south and east to Earth-fixed x, y and z; `outward` is perpendicular to the Earth's axis
    outward = up * np.sin(theta) + south * np.cos(theta)
    x, y = outward * np.cos(phi) - east * np.sin(phi), outward * np.sin(phi) + east * np.cos(phi)
    return np.array([x, y, up * np.cos(theta) - south * np.sin(theta)])
