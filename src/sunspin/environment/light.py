"""Eclipses by the Earth, and sunlight reflected by the Earth (albedo)."""

from __future__ import annotations

import numpy as np

from sunspin.environment.earth import EQUATOR_M, FLATTENING, SUN_M
from sunspin.solve.rotations import tangent_basis

REFLECTIVITY, REFLECTIVITY_SIGMA = 0.3, 0.15
"""Reflected share of sunlight, and the standard deviation of its local variation.
Bond albedo is 0.29 to 0.31 on average, 0.1 over open sea and 0.7 over thick cloud (Stephens et al. 2015, Rev. Geophys. 53, 141)."""

RINGS, SPOKES = 8, 24
"""Rings and sectors of the Earth's disc over which its light is summed; more change the sum by less than 1 % of its maximum."""

CHUNK = 4000
"""Positions computed at once."""


def sunlit_fraction(position: np.ndarray, sun: np.ndarray) -> np.ndarray:
    """Return the visible fraction (...) of the Sun's disc, 0 to 1, from positions (..., 3) with the Sun at `sun` (..., 3).

    Both are in m from the Earth's centre, in axes whose z is the Earth's. Sun and Earth are discs on the sky; the flattened
    Earth is made a sphere by stretching z. The atmosphere, which bends and reddens the light over the last 20 km, is ignored:
    it would lengthen a penumbra of 8 s in low orbit by some 3 s.
    """
    stretch = np.array([1.0, 1.0, 1 / (1 - FLATTENING)])
    position, to_sun = position * stretch, (sun - position) * stretch
    distance, sun_distance = np.linalg.norm(position, axis=-1), np.linalg.norm(to_sun, axis=-1)
    # below the surface, as for a damaged position, the Earth is half the sky
    earth_radius = np.arcsin(np.minimum(EQUATOR_M / distance, 1.0))  # angular radii, rad
    sun_radius = np.arcsin(SUN_M / sun_distance)
    cosine = -(position * to_sun).sum(axis=-1) / distance / sun_distance
    between_centres = np.arccos(np.clip(cosine, -1, 1))
    return 1 - covered_fraction(between_centres, sun_radius, earth_radius)


def covered_fraction(apart: np.ndarray, disc: np.ndarray, cover: np.ndarray) -> np.ndarray:
    """Return the fraction of a disc of radius `disc` covered by one of radius `cover`, with centres `apart` (all in rad).

    The formula is planar: it holds for small angles, or if the edge of the covering disc is nearly straight. It is used if the
    edges intersect; otherwise nothing is covered, the whole disc, or in its inside an area as large as a smaller covering disc.
    """
    # distances of the chord through both intersections from the centres, and half its length
    x = np.clip((apart**2 + disc**2 - cover**2) / (2 * np.maximum(apart, 1e-12)), -disc, disc)
    y = np.clip(apart - x, -cover, cover)
    half = np.sqrt(np.maximum(disc**2 - x**2, 0))
    # area of the lens in which the discs overlap
    lens = disc**2 * np.arccos(x / disc) + cover**2 * np.arccos(y / cover) - apart * half
    intersecting = np.clip(lens / (np.pi * disc**2), 0, 1)
    enclosed = np.where(cover >= disc, 1.0, (cover / disc) ** 2)
    overlapping = np.where(apart <= np.abs(cover - disc), enclosed, intersecting)
    return np.where(apart >= disc + cover, 0.0, overlapping)


def albedo_light(position: np.ndarray, sun: np.ndarray) -> np.ndarray:
    """Return the albedo vector (n, 3): Earth-reflected light in parts of full Sun, towards its source.

    It is the sum over the sunlit, visible cap of the Earth, a sphere here. Each piece of ground scatters evenly (Lambert) with
    the same reflectivity. A panel that sees the whole disc gets the component along its normal. `position`, `sun` (n, 3) are in m
    from the Earth's centre.
    """
    if len(position) > CHUNK:  # the rays of many positions would take too much memory
        starts = range(0, len(position), CHUNK)
        return np.concatenate(
            [albedo_light(position[k : k + CHUNK], sun[k : k + CHUNK]) for k in starts]
        )
    distance = np.linalg.norm(position, axis=-1)
    down = -position / distance[:, None]
    across, third = tangent_basis(down)
    edge = np.sqrt(1 - (EQUATOR_M / distance) ** 2)  # cosine of the angular radius of the Earth
    # Gauss-Legendre nodes in the cosine of the angle from the nadir, even in solid angle: a ring each
    node, weight = np.polynomial.legendre.leggauss(RINGS)
    cosine = edge[:, None] + (1 - edge[:, None]) * (node + 1) / 2
    sine = np.sqrt(1 - cosine**2)
    azimuth = 2 * np.pi * (np.arange(SPOKES) + 0.5) / SPOKES
    radial = np.cos(azimuth)[:, None] * across[:, None] + np.sin(azimuth)[:, None] * third[:, None]
    # unit rays from the spacecraft to the ground (n, rings, spokes, 3)
    ray = cosine[:, :, None, None] * down[:, None, None] + sine[:, :, None, None] * radial[:, None]
    # length of each ray to the ground
    length = distance[:, None] * (cosine - np.sqrt(np.maximum(cosine**2 - edge[:, None] ** 2, 0)))
    ground_normal = (position[:, None, None] + length[:, :, None, None] * ray) / EQUATOR_M
    to_sun = sun / np.linalg.norm(sun, axis=1, keepdims=True)
    sun_height = np.maximum(np.einsum("nrsi,ni->nrs", ground_normal, to_sun), 0)  # sine, 0 at night
    # of each ray: the ring's part of the cosines (the weights sum to 2) times the spoke's part of the azimuths
    solid_angle = (1 - edge)[:, None, None] * weight[:, None] / 2 * 2 * np.pi / SPOKES
    # radiance of the ground in parts of full Sun (reflectivity / pi times the sine of the Sun's height), summed along the rays
    return REFLECTIVITY / np.pi * np.einsum("nrs,nrsi->ni", sun_height * solid_angle, ray)
