"""How much of the Sun is seen past the Earth, and the light that the Earth throws back."""

from __future__ import annotations

import numpy as np

from sunspin.environment.earth import EQUATOR_M, FLATTENING, SUN_M
from sunspin.solve.rotations import tangent_basis

REFLECTIVITY, REFLECTIVITY_SIGMA = 0.3, 0.15
"""The part of the sunlight that the Earth throws back, and how much it differs from place to place: Bond albedo of 0.29 to 0.31 in
the mean, 0.1 over open sea to 0.7 over thick cloud (Stephens et al. 2015, Rev. Geophys. 53, 141)."""

RINGS, SPOKES = 8, 24
"""Of the Earth's disc, over which its light is summed: to 1 % of the largest, as more of them do not change it further."""

CHUNK = 4000


def sunlit_fraction(place: np.ndarray, sun: np.ndarray) -> np.ndarray:
    """The part (...) of the Sun's disc that is seen, 0 to 1, from places (..., 3) with the Sun at `sun` (..., 3): m from the
    Earth's centre, in axes whose z is the Earth's.

    Both are discs on the sky; the flattened Earth is made a sphere by stretching z. The air, which bends and reddens the light over
    the last 20 km, is left out: a penumbra lasts 8 s in a low orbit and the air makes it some 3 s longer.
    """
    stretch = np.array([1.0, 1.0, 1 / (1 - FLATTENING)])
    place, to_sun = place * stretch, (sun - place) * stretch
    distance, far = np.linalg.norm(place, axis=-1), np.linalg.norm(to_sun, axis=-1)
    earth, disc = np.arcsin(np.minimum(EQUATOR_M / distance, 1.0)), np.arcsin(SUN_M / far)
    apart = np.arccos(np.clip(-(place * to_sun).sum(axis=-1) / distance / far, -1, 1))
    return 1 - covered_fraction(apart, disc, earth)


def covered_fraction(apart: np.ndarray, disc: np.ndarray, before: np.ndarray) -> np.ndarray:
    """The part of a disc of radius `disc` that one of radius `before` covers whose middle is `apart` (all rad, all small or the
    border nearly straight)."""
    x = np.clip((apart**2 + disc**2 - before**2) / (2 * np.maximum(apart, 1e-12)), -disc, disc)
    y = np.clip(apart - x, -before, before)
    half = np.sqrt(np.maximum(disc**2 - x**2, 0))
    lens = disc**2 * np.arccos(x / disc) + before**2 * np.arccos(y / before) - apart * half
    partly = np.clip(lens / (np.pi * disc**2), 0, 1)
    whole = np.where(before >= disc, 1.0, (before / disc) ** 2)
    return np.where(
        apart >= disc + before, 0.0, np.where(apart <= np.abs(before - disc), whole, partly)
    )


def albedo_light(place: np.ndarray, sun: np.ndarray) -> np.ndarray:
    """The Earth's light (n, 3) in parts of full Sun, from where it comes: the sum over the lit cap that is seen, each piece of
    ground scattering evenly to all sides (Lambert) with one reflectivity. A panel that sees the whole disc gets the component
    along its normal. `place`, `sun` (n, 3) in m from the Earth's centre; the Earth is a sphere here."""
    if len(place) > CHUNK:
        cuts = range(0, len(place), CHUNK)
        return np.concatenate(
            [albedo_light(place[at : at + CHUNK], sun[at : at + CHUNK]) for at in cuts]
        )
    distance = np.linalg.norm(place, axis=-1)
    down = -place / distance[:, None]
    across, third = tangent_basis(down)
    edge = np.sqrt(1 - (EQUATOR_M / distance) ** 2)  # cosine of the disc's radius
    node, weight = np.polynomial.legendre.leggauss(RINGS)
    cosine = edge[:, None] + (1 - edge[:, None]) * (node + 1) / 2  # even in solid angle
    sine = np.sqrt(1 - cosine**2)
    turn = 2 * np.pi * (np.arange(SPOKES) + 0.5) / SPOKES
    round_ = np.cos(turn)[:, None] * across[:, None] + np.sin(turn)[:, None] * third[:, None]
    ray = (
        cosine[:, :, None, None] * down[:, None, None] + sine[:, :, None, None] * round_[:, None]
    )  # (n, rings, spokes, 3)
    way = distance[:, None] * (cosine - np.sqrt(np.maximum(cosine**2 - edge[:, None] ** 2, 0)))
    ground = (place[:, None, None] + way[:, :, None, None] * ray) / EQUATOR_M
    to_sun = sun / np.linalg.norm(sun, axis=1, keepdims=True)
    bright = np.maximum(np.einsum("nrsi,ni->nrs", ground, to_sun), 0)
    solid = (1 - edge)[:, None, None] * weight[:, None] / 2 * 2 * np.pi / SPOKES
    return REFLECTIVITY / np.pi * np.einsum("nrs,nrsi->ni", bright * solid, ray)
