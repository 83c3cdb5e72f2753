"""The Earth's light on panels, an unknown of a pass: a vector fixed in space, and what panels read too much all the time.

The light comes from where the Earth is, from a low orbit a wide disk: up to a third of full Sun on a panel that looks there. It
turns with the orbit. Its three components in N and their drift are estimated with the motion: as noise it would drown weak light.
Two opposite panels differ by just the component of the light along them. So the differences of opposite panels follow one vector,
Sun and Earth's light together, that stays in space too: a search uses those and needs to know nothing of the light. An
orbit says where the light comes from and how it changes: then the reflectivity of the ground is one unknown, and a free vector of
a quarter of the size stands for clouds and coasts. Zeros of converters look much the same in the brightness, and are estimated too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from sunspin.environment.light import REFLECTIVITY, REFLECTIVITY_SIGMA
from sunspin.estimate.model import SUN_N, Unknown
from sunspin.estimate.settings import EARTH_KNOWN, EARTH_WIDER, EARTH_ZERO
from sunspin.estimate.terms.term import drifting
from sunspin.solve.rotations import cross_matrix, rotate_attitude
from sunspin.vehicle.response.flat import PanelResponse
from sunspin.vehicle.response.panels import opposite_panels

LIGHT_TURN = 1.5e-3
"""rad/s; the light turns with the orbit, at 1.1e-3, and brightens or fades as the ground below does."""

LEAST_LIGHT = 1e-12
"""Share of full Sun at which light is taken for this weak, so that it has a direction."""

AZIMUTHS = 8
"""Turns about the Sun from which a fit begins if nothing but the known light shows it."""

CORNERS = np.array(list(product([-1.0, 1.0], repeat=3))) / np.sqrt(3)
FIRST_DIRECTIONS, FIRST_SHARES = np.vstack([np.eye(3), -np.eye(3), CORNERS]), (0.4, 0.8)
"""Where a fit begins: the best of these directions, those to the faces and corners of a cube in axes with z along the sum of both
lights, with these parts of the prior's sigma."""


@dataclass(frozen=True)
class EarthLight:
    """The prior of the light of a pass at n samples, in shares of full Sun.

    The light is a vector: `known_N` (n, 3), which an orbit predicts, or zero without one, and b unknowns in addition. `light_N` (n,
    b, 3): one sigma of each of them. `zeros` (p), unit of the readings: one sigma of what each panel reads too much. The unknowns u
    (K, b + p) are those of the vector, then those of the zeros.
    """

    light_N: np.ndarray
    zeros: np.ndarray
    known_N: np.ndarray | None = None

    @classmethod
    def prior(
        cls, t_s: np.ndarray, share: float, full: np.ndarray, known_N: np.ndarray | None = None
    ) -> EarthLight:
        """Return the light before the data, at the times of a pass.

        `share`: what sides away from the Sun get, of full Sun; `full` (p): what each panel gets of a Sun that it faces.
        """
        zeros = EARTH_ZERO * share * full
        if known_N is None:
            return cls(drifting(t_s, EARTH_WIDER * share / np.sqrt(3), LIGHT_TURN), zeros)
        # one unknown for the reflectivity of the ground; six for what clouds and coasts add, in proportion to the light
        brightness = np.linalg.norm(known_N, axis=1)
        brightest = float(brightness.max())
        clouds = drifting(t_s, EARTH_KNOWN * max(brightest, share) / np.sqrt(3), LIGHT_TURN)
        clouds = clouds * (brightness / max(brightest, 1e-300))[:, None, None]
        reflectivity = REFLECTIVITY_SIGMA / REFLECTIVITY * known_N
        return cls(np.concatenate([reflectivity[:, None], clouds], axis=1), zeros, known_N)

    def take(self, samples: Any) -> EarthLight:
        """Return the light at some of the samples."""
        known = None if self.known_N is None else self.known_N[samples]
        return replace(self, light_N=self.light_N[samples], known_N=known)

    @property
    def light_slice(self) -> slice:
        """Return where the unknowns of the vector stand; those of the zeros follow."""
        return slice(0, self.light_N.shape[1])

    def unknowns(self, panels: tuple[str, ...]) -> tuple[Unknown, ...]:
        """Return the unknowns of the light: those of the vector, then the zero of each panel."""
        sizes = np.linalg.norm(self.light_N, axis=2).max(axis=0)
        names = [f"earth_light_{i}" for i in range(len(sizes))]
        limits = np.full(len(sizes), np.inf)
        if self.known_N is not None:
            names = ["earth_reflectivity", *names[:-1]]
            limits[0] = REFLECTIVITY / REFLECTIVITY_SIGMA  # no ground reflects less than nothing
        vector = [
            Unknown(names[i], "earth_light", "1", 0.0, float(sizes[i]), i, float(limits[i]))
            for i in range(len(sizes))
        ]
        zeros = [
            Unknown(f"zero_{name}", "panel_zero", "reading", 0.0, float(size), i)
            for i, (name, size) in enumerate(zip(panels, self.zeros, strict=True))
        ]
        return (*vector, *zeros)

    def on_panels(
        self, response: PanelResponse, gain: np.ndarray, attitude: np.ndarray, u: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the Earth's light on panels (K, n, p) with factors `gain`, in the unit of the readings, and its derivatives.

        Equation (earthlight) of docs/model.md. `u` (K, b + p): as in :meth:`unknowns`. The derivatives (K, n, p, 3 + b + p) are by
        a turn of the body, then by all of u. Those by the zeros are here too, though their value is not: :meth:`zero` gives it, as
        a zero does not scale with the gain.
        """
        vector_N = np.einsum("km,nmj->knj", u[:, self.light_slice], self.light_N)
        vector_N = vector_N if self.known_N is None else vector_N + self.known_N
        light_B = (attitude @ vector_N[..., None])[..., 0]
        size = np.maximum(np.linalg.norm(light_B, axis=-1), LEAST_LIGHT)
        power, by_light = response.earthlight(light_B / size[..., None], size)
        power, by_light = power * gain, by_light * gain[..., None]
        by_u = by_light @ np.einsum("knji,nmi->knjm", attitude, self.light_N)
        # a zero adds to the reading of its own panel alone
        by_zero = np.broadcast_to(np.diag(self.zeros), (*power.shape, len(self.zeros)))
        return power, np.concatenate([by_light @ cross_matrix(light_B), by_u, by_zero], axis=-1)

    def zero(self, u: np.ndarray) -> np.ndarray:
        """Return what panels read too much (K, 1, p), alike in all samples."""
        of_zeros = slice(self.light_slice.stop, None)
        return (u[:, of_zeros] * self.zeros)[:, None]

    def begin(
        self,
        attitude: np.ndarray,
        cost: Callable[[np.ndarray, np.ndarray], np.ndarray],
        about_sun: bool,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return attitudes (K, n, 3, 3) and unknowns (K, b + p) from which a fit begins.

        A search knows no light of the Earth: the z axis of its attitudes (K, n, 3, 3), which it takes for the Sun, is that of the
        sum of both lights. There are b unknowns of the light's vector, then those of p zeros. `cost`: function of unknowns and
        attitudes to the cost (K); `about_sun`: whether the turn about the Sun is known already.
        """
        count, m = len(attitude), self.light_N.shape[1] + len(self.zeros)
        u, least, best = np.zeros((count, m)), np.full(count, np.inf), attitude
        for to_sum, guess in self._first_guesses(m, about_sun):
            turned = attitude @ to_sum  # z to the Sun in place of z along the sum of both lights
            new = cost(np.tile(guess, (count, 1)), turned)
            better = new < least
            u = np.where(better[:, None], guess, u)
            best = np.where(better[:, None, None, None], turned, best)
            least = np.minimum(new, least)
        return best, u

    def _first_guesses(self, m: int, about_sun: bool) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield first guesses of the light: a rotation (3, 3) and the unknowns (m).

        The rotation takes components in axes with z to the Sun to those in axes with z along the sum of Sun and Earth's light.
        """
        if self.known_N is not None:
            # The light is known in N, so the unknowns are zero. The turn about the sum of both lights may be open: then several
            # are tried.
            total = SUN_N + self.known_N.mean(axis=0)
            back = _rotation_by_sine(np.cross(total / np.linalg.norm(total), SUN_N))
            for angle in 2 * np.pi / AZIMUTHS * np.arange(1 if about_sun else AZIMUTHS):
                yield rotate_attitude(back, -angle * SUN_N), np.zeros(m)
            return
        sigma_component = np.linalg.norm(self.light_N[0, 0])
        for direction in FIRST_DIRECTIONS:
            for share in FIRST_SHARES:
                # a component has the sigma of the whole vector over sqrt(3)
                in_sigmas, trial = share * np.sqrt(3) * direction, np.zeros(m)
                # The guess is in axes with z along the sum of Sun and light: their components across z cancel.
                light = sigma_component * in_sigmas
                across = np.array([light[0], light[1], 0.0])
                sun = -across + SUN_N * np.sqrt(max(1 - across @ across, 0.0))
                back = _rotation_by_sine(np.cross(SUN_N, sun))
                trial[:3] = in_sigmas @ back  # the same light in axes with z to the Sun
                yield back, trial


def with_pair_differences(
    facing_B: np.ndarray,
    full: np.ndarray,
    readings: tuple[np.ndarray, np.ndarray],
    sigma_light_noise: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return readings and sigmas (n, p) with those of two opposite panels replaced by their difference, on the brighter one.

    The darker one reads zero: so does a panel without Earth's light that faces away from the Sun. `facing_B` (p, 3): normals;
    `full` (p): readings of full Sun; `readings`: values (n, p), and their sigmas without the Earth's light; `sigma_light_noise`
    (n, p): sigmas with that light as noise, which stay where the opposite panel was not read.
    """
    share, error = readings[0] / full, readings[1] / full
    power, sigma = readings[0].copy(), sigma_light_noise.copy()
    for i, j in np.argwhere(opposite_panels(facing_B)):  # each pair twice, as (i, j) and (j, i)
        read = np.isfinite(error[:, i]) & np.isfinite(error[:, j])  # samples in which both were
        power[read, i] = full[i] * np.maximum(share[read, i] - share[read, j], 0.0)
        sigma[read, i] = full[i] * np.hypot(error[read, i], error[read, j])
    return power, sigma


def _rotation_by_sine(across: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) about a vector (3) that is as long as the sine of its angle."""
    size = np.linalg.norm(across)
    return rotate_attitude(np.eye(3), -across * np.arcsin(min(size, 1.0)) / max(size, 1e-300))
