"""Model of the Earth's light (albedo) on panels in a pass: an albedo vector in space, and a zero offset of each panel.

From a low orbit the Earth is a wide disk: a panel that faces it gets up to a third of full Sun. The albedo vector points to the
light and is as long as the light on a panel that faces it, in parts of full Sun. Its three components and their linear change over
the pass are estimated with the motion. As noise they would hide weak sunlight. If an orbit gives the vector, the reflectivity of
the ground is one unknown, and a free vector of a quarter of its size stands for clouds and coasts. Zero offsets of converters look
like such light, and are estimated too.

The difference of two opposite panels is the component of the light along their normal. So these differences follow the sum of the
vectors of Sun and Earth's light, which is also fixed in space. A search uses them and need not know the Earth's light.

Shapes: K motions, n samples, p panels, b unknowns of the albedo vector, in sigmas of their priors. N is fixed in space with z
towards the Sun, B are body axes, attitudes are matrices B_from_N.
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
from sunspin.estimate.terms.term import drifting_vector
from sunspin.solve.rotations import cross_matrix, rotate_attitude
from sunspin.vehicle.response.flat import PanelResponse
from sunspin.vehicle.response.panels import opposite_panels

LIGHT_RATE = 1.5e-3
"""Rate (rad/s) at which the albedo vector changes: it rotates with the orbit, at 1.1e-3, its length follows the ground below."""

LEAST_LIGHT = 1e-12
"""Lower limit of the length of the albedo vector, so that it has a direction."""

N_AZIMUTHS = 8
"""Number of rotations about the sum of Sun and Earth's light that are tried if only the known light shows this rotation."""

CORNERS = np.array(list(product([-1.0, 1.0], repeat=3))) / np.sqrt(3)
FIRST_DIRECTIONS, FIRST_SHARES = np.vstack([np.eye(3), -np.eye(3), CORNERS]), (0.4, 0.8)
"""First guesses of an unknown albedo vector: directions to the faces and corners of a cube, in axes with z along the sum of Sun and
Earth's light, and lengths as parts of the prior's sigma."""


@dataclass(frozen=True)
class EarthLight:
    """Prior of the Earth's light in a pass. Its unknowns u (K, b + p) are those of the albedo vector, then the zeros of panels.

    The albedo vector in parts of full Sun, N, is `known_N` + u[:b] `light_N`. `light_N` (n, b, 3): one sigma of each unknown;
    `known_N` (n, 3): as an orbit predicts it, None (zero) without one. `zeros` (p): one sigma of the zero offset of each panel, in
    the unit of the readings.
    """

    light_N: np.ndarray
    zeros: np.ndarray
    known_N: np.ndarray | None = None

    @classmethod
    def prior(
        cls, t_s: np.ndarray, share: float, full: np.ndarray, known_N: np.ndarray | None = None
    ) -> EarthLight:
        """Return the prior of the light at the times `t_s` (n), s, of a pass.

        `share`: Earth's light on a panel that faces the Earth, as a share of full Sun. `full` (p): reading of each panel when it
        faces the Sun, for a scale of one (`Panels.full_sun`). `known_N` (n, 3): the albedo vector that an orbit predicts, in parts
        of full Sun.

        Without an orbit the vector has six unknowns: three components, and their linear change. With an orbit it has seven: the
        reflectivity of the ground, by which the predicted vector is multiplied, and six of a vector that is added for clouds.
        """
        zeros = EARTH_ZERO * share * full
        # a component has the sigma of the whole vector over sqrt(3)
        if known_N is None:
            return cls(drifting_vector(t_s, EARTH_WIDER * share / np.sqrt(3), LIGHT_RATE), zeros)
        brightness = np.linalg.norm(known_N, axis=1)
        brightest = float(brightness.max())
        # The vector of the clouds grows and fades with the predicted light. Where that is brightest, its sigma is a quarter of the
        # predicted light or of `share`, the larger of both.
        clouds = drifting_vector(t_s, EARTH_KNOWN * max(brightest, share) / np.sqrt(3), LIGHT_RATE)
        clouds = clouds * (brightness / max(brightest, 1e-300))[:, None, None]
        reflectivity = REFLECTIVITY_SIGMA / REFLECTIVITY * known_N
        return cls(np.concatenate([reflectivity[:, None], clouds], axis=1), zeros, known_N)

    def take(self, samples: Any) -> EarthLight:
        """Return the light at some of the samples, by index or slice."""
        known = None if self.known_N is None else self.known_N[samples]
        return replace(self, light_N=self.light_N[samples], known_N=known)

    @property
    def light_slice(self) -> slice:
        """Return the slice of the albedo vector among the unknowns; those of the zeros follow."""
        return slice(0, self.light_N.shape[1])

    def unknowns(self, panels: tuple[str, ...]) -> tuple[Unknown, ...]:
        """Return the unknowns: those of the albedo vector, then the zero of each panel. `panels`: names (p)."""
        sizes = np.linalg.norm(self.light_N, axis=2).max(axis=0)
        names = [f"earth_light_{i}" for i in range(len(sizes))]
        limits = np.full(len(sizes), np.inf)
        if self.known_N is not None:
            names = ["earth_reflectivity", *names[:-1]]
            # the reflectivity is not negative
            limits[0] = REFLECTIVITY / REFLECTIVITY_SIGMA
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
        """Return the Earth's light on panels (K, n, p), in the unit of the readings, and its derivatives (K, n, p, 3 + b + p).

        Equation (earthlight) of docs/model.md. `gain` (K, 1, p) or (K, n, p): factors on the gains; `attitude` (K, n, 3, 3); `u`
        (K, b + p): as in :meth:`unknowns`. The derivatives are by a small rotation of the body (rad, B), then by all of u. Those by
        the zeros are included, but the zeros themselves are not: they do not scale with the gain (:meth:`zero`).
        """
        vector_N = np.einsum("km,nmj->knj", u[:, self.light_slice], self.light_N)
        vector_N = vector_N if self.known_N is None else vector_N + self.known_N
        light_B = (attitude @ vector_N[..., None])[..., 0]
        size = np.maximum(np.linalg.norm(light_B, axis=-1), LEAST_LIGHT)
        power, by_light = response.earthlight(light_B / size[..., None], size)
        power, by_light = power * gain, by_light * gain[..., None]
        # a rotation t of the body moves the albedo vector in body axes by light x t
        by_turn = by_light @ cross_matrix(light_B)
        by_u = by_light @ np.einsum("knji,nmi->knjm", attitude, self.light_N)
        # a zero adds to the reading of its own panel alone
        by_zero = np.broadcast_to(np.diag(self.zeros), (*power.shape, len(self.zeros)))
        return power, np.concatenate([by_turn, by_u, by_zero], axis=-1)

    def zero(self, u: np.ndarray) -> np.ndarray:
        """Return the zero offset of each panel (K, 1, p), the same in all samples, in the unit of the readings."""
        return (u[:, self.light_slice.stop :] * self.zeros)[:, None]

    def first_guess(
        self,
        attitude: np.ndarray,
        cost: Callable[[np.ndarray, np.ndarray], np.ndarray],
        about_sun: bool,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return attitudes (K, n, 3, 3) and unknowns (K, b + p) from which a fit begins: the best of several guesses.

        A search does not know the Earth's light: what it takes for the Sun, the z axis of N in its attitudes `attitude`
        (K, n, 3, 3), is the direction of the sum of Sun and Earth's light. The guesses correct this. `cost`: function of unknowns
        and attitudes that returns the cost (K) of each motion. `about_sun`: the rotation about the Sun is already known.
        """
        count, m = len(attitude), self.light_N.shape[1] + len(self.zeros)
        best_u, least, best_attitude = np.zeros((count, m)), np.full(count, np.inf), attitude
        for to_sum, guess in self._guesses(m, about_sun):
            trial = attitude @ to_sum
            trial_cost = cost(np.tile(guess, (count, 1)), trial)
            better = trial_cost < least
            best_u = np.where(better[:, None], guess, best_u)
            best_attitude = np.where(better[:, None, None, None], trial, best_attitude)
            least = np.minimum(trial_cost, least)
        return best_attitude, best_u

    def _guesses(self, m: int, about_sun: bool) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield guesses of the Earth's light: a rotation matrix (3, 3), and values of the m unknowns.

        The matrix converts vectors from N, with z towards the Sun, to axes with z along the sum of Sun and Earth's light.
        """
        if self.known_N is not None:
            # The light is known in N, so the unknowns are zero. The rotation about the sum of both may be open: several are tried.
            total = SUN_N + self.known_N.mean(axis=0)
            to_sum = _rotation_by_sine(np.cross(total / np.linalg.norm(total), SUN_N))
            for angle in 2 * np.pi / N_AZIMUTHS * np.arange(1 if about_sun else N_AZIMUTHS):
                yield rotate_attitude(to_sum, -angle * SUN_N), np.zeros(m)
            return
        sigma_component = np.linalg.norm(self.light_N[0, 0])  # unknowns 0 to 2: x, y, z, alike
        for direction in FIRST_DIRECTIONS:
            for share in FIRST_SHARES:
                # a component has the sigma of the whole vector over sqrt(3)
                in_sigmas, guess = share * np.sqrt(3) * direction, np.zeros(m)
                # In axes with z along the sum of Sun and Earth's light, the components of both across z cancel.
                light = sigma_component * in_sigmas
                across = np.array([light[0], light[1], 0.0])
                sun = -across + SUN_N * np.sqrt(max(1 - across @ across, 0.0))
                to_sum = _rotation_by_sine(np.cross(SUN_N, sun))
                # the same light in axes with z towards the Sun
                guess[:3] = in_sigmas @ to_sum
                yield to_sum, guess


def with_pair_differences(
    facing_B: np.ndarray,
    full: np.ndarray,
    power: np.ndarray,
    sigma: np.ndarray,
    sigma_light_noise: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return readings and sigmas (n, p) of opposite panels as they would be without the Earth's light, for a search.

    Each reading counts as a part of its panel's full Sun. Of two opposite panels that were both read, the brighter one gets the
    difference of the two, and the other gets zero, since without the Earth's light a panel that faces away from the Sun is dark.
    Both get the sigma of the difference. All other readings stay as they are, with the Earth's light as noise.

    Parameters
    ----------
    facing_B, full : (p, 3) and (p), normals of the panels in body axes, and their readings in full Sun
    power, sigma : (n, p), readings, and their sigmas without the Earth's light, infinite where not read
    sigma_light_noise : (n, p), sigmas with that light as noise
    """
    share, error = power / full, sigma / full
    power, sigma = power.copy(), sigma_light_noise.copy()
    # each pair occurs twice, as (i, j) and (j, i)
    for i, j in np.argwhere(opposite_panels(facing_B)):
        both_read = np.isfinite(error[:, i]) & np.isfinite(error[:, j])
        power[both_read, i] = full[i] * np.maximum(share[both_read, i] - share[both_read, j], 0.0)
        sigma[both_read, i] = full[i] * np.hypot(error[both_read, i], error[both_read, j])
    return power, sigma


def _rotation_by_sine(across: np.ndarray) -> np.ndarray:
    """Return the matrix (3, 3) that rotates vectors about `across` (3), whose length is the sine of the angle."""
    size = np.linalg.norm(across)
    return rotate_attitude(np.eye(3), -across * np.arcsin(min(size, 1.0)) / max(size, 1e-300))
