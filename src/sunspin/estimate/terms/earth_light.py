"""The Earth's light on the panels, an unknown of a pass: a beam fixed in space, and what panels read too much all the time.

It comes from where the Earth is, from a low orbit a wide disk, up to a third of full Sun on a panel that looks there, and turns
with the orbit. Its three components in N and their drift are estimated with the motion: as noise it would drown weak light.
By the response's `disc` two opposite panels differ by just the component of the beam along them, so the differences of opposite
panels follow one vector, Sun and beam together, that stays in space too: the search uses those, and needs to know nothing of the
beam. An orbit says where the beam comes from and how it changes: then how much the ground throws back is one unknown, and a free
beam of a quarter of the size stands for what clouds and coasts make of it. What a smooth beam leaves stays noise. What panels
read too much all the time, zeros of converters that nobody subtracts, looks much the same in their brightness: it is estimated
beside.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from sunspin.environment.light import REFLECTIVITY, REFLECTIVITY_SIGMA
from sunspin.estimate.terms.term import SUN_N, Unknown, drifting
from sunspin.solve.rotations import cross_matrix
from sunspin.vehicle.response.flat import PanelResponse
from sunspin.vehicle.response.panels import opposite_panels

TURN_RATE = 1.5e-3
"""rad/s; the beam turns with the orbit, 1.1e-3, and brightens or fades as the ground below does."""

WIDER = 1.5
"""Prior sigma of the beam, in units of what faces away from the Sun get on average."""

LEAST_BEAM = 1e-12
"""Share of full Sun at which a beam is taken for this weak, so that it has a direction."""

ZERO = 0.3
"""Prior sigma of what a panel reads too much all the time, in the same units."""

KNOWN = 0.25
"""Part of the Earth's light that an orbit leaves open in direction and change, clouds and coasts being where they are."""

AZIMUTHS = 8
"""Turns about the Sun from which a fit begins that nothing but the known light tells from each other."""

CORNERS = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T / np.sqrt(3)
FIRST_DIRECTIONS, FIRST_SHARES = np.vstack([np.eye(3), -np.eye(3), CORNERS]), (0.4, 0.8)
"""Where a fit begins: the best of these directions in N, with these parts of the prior's sigma."""


@dataclass(frozen=True)
class EarthLight:
    """`beam_N` (n, u, 3), shares of full Sun: one sigma of each unknown of the beam; `zeros` (n_panel), unit of the powers: one
    sigma of what each panel reads too much; `known_N` (n, 3): the beam that an orbit predicts, None without one."""

    beam_N: np.ndarray
    zeros: np.ndarray
    known_N: np.ndarray | None = None

    @classmethod
    def prior(
        cls, t_s: np.ndarray, share: float, gain: np.ndarray, known_N: np.ndarray | None = None
    ) -> EarthLight:
        """Of a pass at these times, if faces away from the Sun get this share of full Sun, on panels of these gains; `known_N`
        (n, 3): the light where an orbit knows it."""
        if known_N is None:
            return cls(drifting(t_s, WIDER * share / np.sqrt(3), TURN_RATE), ZERO * share * gain)
        bright = np.linalg.norm(known_N, axis=1)
        most = float(bright.max())
        left = (
            drifting(t_s, KNOWN * max(most, share) / np.sqrt(3), TURN_RATE)
            * (bright / max(most, 1e-300))[:, None, None]
        )
        reflectivity = REFLECTIVITY_SIGMA / REFLECTIVITY * known_N
        return cls(
            np.concatenate([reflectivity[:, None], left], axis=1), ZERO * share * gain, known_N
        )

    def take(self, index: np.ndarray | slice) -> EarthLight:
        """The samples `index`."""
        return replace(
            self,
            beam_N=self.beam_N[index],
            known_N=None if self.known_N is None else self.known_N[index],
        )

    def unknowns(self, panels: tuple[str, ...]) -> tuple[Unknown, ...]:
        """The beam's and each panel's."""
        sizes = np.linalg.norm(self.beam_N, axis=2).max(axis=0)
        names = (
            [f"earth_beam_{i}" for i in range(len(sizes) - 1)] if self.known_N is not None else []
        )
        names = (
            ["earth_reflectivity", *names]
            if names
            else [f"earth_beam_{i}" for i in range(len(sizes))]
        )
        limit = [
            np.inf if name != "earth_reflectivity" else REFLECTIVITY / REFLECTIVITY_SIGMA
            for name in names
        ]
        beam = [
            Unknown(name, "earth_light", "1", 0.0, float(size), i, limit=most)
            for i, (name, size, most) in enumerate(zip(names, sizes, limit, strict=True))
        ]
        zeros = zip(panels, self.zeros, strict=True)
        return (
            *beam,
            *(
                Unknown(f"zero_{name}", "panel_zero", "reading", 0.0, float(s), i)
                for i, (name, s) in enumerate(zeros)
            ),
        )

    def light(
        self, response: PanelResponse, gain: np.ndarray, attitude: np.ndarray, error: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Light of the beam (K, n, n_panel) on panels with factors `gain`, and its derivative (K, n, n_panel, 3 + u) to a turn and
        the unknowns."""
        beam_N = np.einsum("km,nmj->knj", error[:, : self.beam_N.shape[1]], self.beam_N)
        beam_N = beam_N if self.known_N is None else beam_N + self.known_N
        beam = (attitude @ beam_N[..., None])[..., 0]
        size = np.maximum(np.linalg.norm(beam, axis=-1), LEAST_BEAM)
        more, to_beam = response.earthlight(beam / size[..., None], size)
        more, to_beam = more * gain, to_beam * gain[..., None]
        own = np.einsum("knpj,knji,nmi->knpm", to_beam, attitude, self.beam_N)
        zeros = np.broadcast_to(np.diag(self.zeros), (*more.shape, len(self.zeros)))
        return more, np.concatenate([to_beam @ cross_matrix(beam), own, zeros], axis=-1)

    def zero(self, error: np.ndarray) -> np.ndarray:
        """What panels read too much (K, 1, n_panel)."""
        return (error[:, self.beam_N.shape[1] :] * self.zeros)[:, None]

    def begin(
        self,
        attitude: np.ndarray,
        cost: Callable[[np.ndarray, np.ndarray], np.ndarray],
        turned: bool = False,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Hypotheses (K, n, 3, 3) whose z axis is where Sun and beam together were taken for the Sun: with z to the Sun itself, and
        where a fit of the beam begins (K, u), in sigmas. `cost` (K) of unknowns and attitudes; `turned`: the turn about the Sun is
        that of N."""
        k, u = len(attitude), self.beam_N.shape[1] + len(self.zeros)
        error, least, found = np.zeros((k, u)), np.full(k, np.inf), attitude
        for back, trial in self._first(u, turned):
            new = cost(np.tile(trial, (k, 1)), attitude @ back)
            better = new < least
            error = np.where(better[:, None], trial, error)
            found = np.where(better[:, None, None, None], attitude @ back, found)
            least = np.minimum(new, least)
        return found, error

    def _first(self, u: int, turned: bool) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Where a fit may begin: what turns the attitudes (3, 3), and the unknowns (u)."""
        if self.known_N is not None:
            both = SUN_N + self.known_N.mean(axis=0)
            across = np.cross(both / np.linalg.norm(both), SUN_N)
            size = np.linalg.norm(across)
            back = Rotation.from_rotvec(
                across * np.arcsin(min(size, 1.0)) / max(size, 1e-300)
            ).as_matrix()
            for angle in 2 * np.pi / AZIMUTHS * np.arange(1 if turned else AZIMUTHS):
                yield Rotation.from_rotvec(angle * SUN_N).as_matrix() @ back, np.zeros(u)
            return
        sigma = np.linalg.norm(self.beam_N[0, 0])
        for direction in FIRST_DIRECTIONS:
            for share in FIRST_SHARES:
                beam, trial = share * np.sqrt(3) * direction, np.zeros(u)
                back = _sun_first(sigma * beam)
                trial[:3] = beam @ back
                yield back, trial


def pairs_differing(
    facing: np.ndarray,
    gain: np.ndarray,
    whole: np.ndarray,
    whole_sigma: np.ndarray,
    power: np.ndarray,
    sigma: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Powers and sigmas (n, n_panel) with those of two opposite panels replaced by their difference, on the brighter one."""
    share, error = whole / gain, whole_sigma / gain
    power, sigma = power.copy(), sigma.copy()
    for i, j in np.argwhere(opposite_panels(facing)):
        both = np.isfinite(error[:, i]) & np.isfinite(error[:, j])
        power[both, i] = gain[i] * np.maximum(share[both, i] - share[both, j], 0.0)
        sigma[both, i] = gain[i] * np.hypot(error[both, i], error[both, j])
    return power, sigma


def _sun_first(beam: np.ndarray) -> np.ndarray:
    """The matrix (3, 3) that takes components in the frame with z to the Sun to those in the frame with z to Sun and beam together,
    in which this is the beam (3)."""
    across = np.array([beam[0], beam[1], 0.0])
    sun = -across + SUN_N * np.sqrt(max(1 - across @ across, 0.0))
    axis = np.cross(
        SUN_N, sun
    )  # as long as the sine of the angle between them, which is less than a quarter turn
    return Rotation.from_rotvec(
        axis * np.arcsin(min(np.linalg.norm(axis), 1.0)) / max(np.linalg.norm(axis), 1e-300)
    ).as_matrix()
