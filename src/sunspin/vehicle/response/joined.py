"""Panels that share inputs of the power system, around any law: a reading belongs to an input and not to a panel.

An input is a channel of several panels, whose sum or largest it reads, or one panel on an input of its own. Which of its panels is
lit it does not say, so one reading may have several directions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sunspin.vehicle.response.protocol import Law, sphere
from sunspin.vehicle.response.tabled import Tabled

CLIMBS, STARTS = 30, 200
"""Steps, and starts, of the search for the direction in which a sum of flat panels gives most."""

LIKE, LOOKS = 0.3, 500
"""A mirror that changes no reading by more than this share of full Sun leaves motions that are nearly alike, and in how many
directions that is looked at."""

MOST_IMAGES = 48
"""Mirrors and turns of a cube; no more are tried."""


@dataclass(frozen=True)
class Input:
    """One reading: its name, which panels it reads, by number, and whether the largest of them and not their sum."""

    name: str
    panels: tuple[int, ...]
    largest: bool = False


def full_signal(one: Input, normals_B: np.ndarray, gains: np.ndarray) -> float:
    """What an input reads at most of flat panels with normals (n_panel, 3) and gains (n_panel)."""
    own = list(one.panels)
    if one.largest or len(own) == 1:
        return float(gains[own].max())
    rows = gains[own, None] * normals_B[own]
    sun = np.concatenate([normals_B[own], sphere(STARTS)])
    for _ in range(CLIMBS):  # the sum is convex in the direction: towards its slope it never falls
        slope = (sun @ rows.T > 0) @ rows
        size = np.linalg.norm(slope, axis=1, keepdims=True)
        sun = np.where(size > 0, slope / np.where(size > 0, size, 1.0), sun)
    return float(np.maximum(sun @ rows.T, 0.0).sum(axis=1).max())


@dataclass(frozen=True)
class Inputs:
    """The law of inputs around that of the panels (None: gain times cosine); `gains` of panels, `full` signals of inputs."""

    law: Law | None
    inputs: tuple[Input, ...]
    gains: tuple[float, ...]
    full: tuple[float, ...]

    def each(self, names: tuple[str, ...], sun_B: np.ndarray, normals_B: np.ndarray, cosine: np.ndarray) -> np.ndarray:
        """Signals (..., n_panel) of the panels."""
        share = cosine if self.law is None else self.law.share(names, sun_B, normals_B, cosine)
        return np.array(self.gains) * np.maximum(share, 0.0)

    def share(self, names: tuple[str, ...], sun_B: np.ndarray, normals_B: np.ndarray, cosine: np.ndarray) -> np.ndarray:
        """Readings (..., n_input) as shares of full signals."""
        signal = self.each(names, sun_B, normals_B, cosine)
        read = [signal[..., list(i.panels)].max(axis=-1) if i.largest else signal[..., list(i.panels)].sum(axis=-1)
                for i in self.inputs]  # fmt: skip
        return np.stack(read, axis=-1) / np.array(self.full)


@dataclass(frozen=True, eq=False)
class Joined(Tabled):
    """Inputs as a :class:`sunspin.vehicle.response.protocol.PanelResponse`: what is said of panels there holds for inputs here."""

    law: Inputs

    def sides(self, sun_B: np.ndarray) -> np.ndarray:
        """Which panels (..., n_panel) make the readings: inside a region of the same ones they are smooth."""
        signal = self.law.each(self.names, sun_B, self.normals_B, sun_B @ self.normals_B.T)
        made = signal > 0
        for one in self.law.inputs:
            if one.largest and len(one.panels) > 1:
                own = signal[..., list(one.panels)]
                first = np.arange(own.shape[-1]) == np.argmax(own, axis=-1)[..., None]
                made[..., list(one.panels)] &= first
        return made

    def _along_sphere(
        self, sun_B: np.ndarray, gain: np.ndarray | None = None, tilt: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Of flat panels in closed form: the slopes of those that make a reading."""
        if self.law.law is not None or tilt is not None:
            return super()._along_sphere(sun_B, gain, tilt)
        sun = np.asarray(sun_B, dtype=np.float64)[..., None, :]
        across = self.normals_B - (sun @ self.normals_B.T)[..., 0, :, None] * sun
        each = (np.array(self.law.gains) * self.sides(sun[..., 0, :]))[..., None] * across
        to_sun = np.stack([each[..., list(one.panels), :].sum(axis=-2) for one in self.law.inputs], axis=-2)
        return self.power(sun_B, gain=gain), (self.strengths(gain) / np.array(self.law.full))[..., None] * to_sun

    @cached_property
    def images(self) -> np.ndarray:
        """Mirrors that exchange two panels of one input, and what they make together, as far as they change no reading much."""
        mirrors = []
        for one in self.law.inputs:
            for i, j in np.argwhere(np.triu(np.ones((len(one.panels),) * 2), 1)):
                across = self.normals_B[one.panels[i]] - self.normals_B[one.panels[j]]
                if (size := np.linalg.norm(across)) > 0:
                    mirrors.append(np.eye(3) - 2 * np.outer(across, across) / size**2)
        found, new = [np.eye(3)], [np.eye(3)]
        while new and len(found) < MOST_IMAGES:
            new = [mirror @ one for one in new for mirror in mirrors]
            new = [one for k, one in enumerate(new) if _is_new(one, found + new[:k]) and self._changes_little(one)]
            found += new
        return np.array(found[:MOST_IMAGES])

    def _changes_little(self, image: np.ndarray) -> bool:
        sun = sphere(LOOKS)
        return bool(np.abs(self.power(sun @ image.T) - self.power(sun)).max() < LIKE * self.gains.min())


def _is_new(one: np.ndarray, found: list[np.ndarray]) -> bool:
    return all(np.abs(one - other).max() > 1e-6 for other in found)
