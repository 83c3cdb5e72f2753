"""Panels that share inputs of the power system, around any law: a reading belongs to an input and not to a panel.

An input is a channel of several panels, whose sum or largest it reads, or one panel on an input of its own. Which of its panels is
lit it does not say, so one reading may have several directions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sunspin.solve.rotations import moved
from sunspin.vehicle.response.cosine import RANK_TOLERANCE, Places, places_of
from sunspin.vehicle.response.planes import ON_PLANE, arrangement
from sunspin.vehicle.response.protocol import Law, misfit, sphere, unit_readings
from sunspin.vehicle.response.tabled import AROUND, Tabled

CLIMBS, STARTS = 30, 200
"""Steps, and starts, of the search for the direction in which a sum of flat panels gives most."""

LIKE, LOOKS = 0.3, 500
"""A mirror that changes no reading by more than this share of full Sun leaves motions that are nearly alike, and in how many
directions that is looked at."""

MOST_IMAGES = 48
"""Mirrors and turns of a cube; no more are tried."""


MOST_PLANES = 40
"""Planes of flat panels, and between those of one largest: with more the sphere is looked through as for other laws."""

ALONG = np.arange(-1.4, 1.5, 0.2)
"""Angles (rad) at which an arc of directions that fit alike is looked at."""

DOWN_RAD, DOWN = 1e-4, 1e-9
"""A direction is a minimum of Delta if no direction so far from it has one smaller by so much."""


BEYOND = 1e-7
"""rad by which the next cell is entered."""


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

    def each(
        self, names: tuple[str, ...], sun_B: np.ndarray, normals_B: np.ndarray, cosine: np.ndarray
    ) -> np.ndarray:
        """Signals (..., n_panel) of the panels."""
        share = cosine if self.law is None else self.law.share(names, sun_B, normals_B, cosine)
        return np.array(self.gains) * np.maximum(share, 0.0)

    def share(
        self, names: tuple[str, ...], sun_B: np.ndarray, normals_B: np.ndarray, cosine: np.ndarray
    ) -> np.ndarray:
        """Readings (..., n_input) as shares of full signals."""
        signal = self.each(names, sun_B, normals_B, cosine)
        read = [
            signal[..., list(i.panels)].max(axis=-1)
            if i.largest
            else signal[..., list(i.panels)].sum(axis=-1)
            for i in self.inputs
        ]
        return np.stack(read, axis=-1) / np.array(self.full)


class FlatInputs(NamedTuple):
    """Candidates for the least Delta, and per cell the direction (3) along which the readings' proportions stay, zeros if none."""

    places: Places
    free: np.ndarray

    def candidates(self, target: np.ndarray) -> np.ndarray:
        """The candidates (n, n_candidate, 3) for unit readings (n, n_input), and more along the arcs on which these stay as they
        are."""
        has = self.free.any(axis=1)
        middle = self.places.mapped(target)[:, : len(self.free)][:, has]
        along = [np.cos(angle) * middle + np.sin(angle) * self.free[has] for angle in ALONG]
        return np.concatenate([self.places.candidates(target), *along], axis=1)


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
        to_sun = np.stack(
            [each[..., list(one.panels), :].sum(axis=-2) for one in self.law.inputs], axis=-2
        )
        return self.power(sun_B, gain=gain), (self.strengths(gain) / np.array(self.law.full))[
            ..., None
        ] * to_sun

    @cached_property
    def _flat(self) -> FlatInputs | None:
        """Of flat panels, where the least Delta may lie: in a cell in which the same panels make the readings these are linear in
        the direction, as of panels that share no input."""
        if self.law.law is not None:
            return None
        rows, planes = np.array(self.law.gains)[:, None] * self.normals_B, self._planes
        if len(planes) > MOST_PLANES:
            return None
        cells = arrangement(tuple(map(tuple, planes.tolist())))
        made = np.unique(self.sides(cells.cell_B), axis=0)
        sums = np.array([np.isin(np.arange(len(rows)), one.panels) for one in self.law.inputs])
        within = [matrix for one in made if (matrix := (sums * one) @ rows).any()]
        on_arcs = np.unique(np.column_stack([self.sides(cells.arc_B), cells.arc_plane]), axis=0)
        between = [((sums * one[:-1]) @ rows, planes[one[-1]]) for one in on_arcs]
        between = [(matrix, normal) for matrix, normal in between if matrix.any()]
        ranks = np.array(
            [np.linalg.matrix_rank(matrix, RANK_TOLERANCE * self.largest) for matrix in within]
        )
        free = [
            np.linalg.svd(matrix)[2][2] if rank == 2 else np.zeros(3)
            for matrix, rank in zip(within, ranks, strict=True)
        ]
        return FlatInputs(
            places_of(within, between, np.concatenate([cells.vertex_B, cells.cell_B])),
            np.array(free),
        )

    @cached_property
    def _planes(self) -> np.ndarray:
        """Unit normals (n, 3) of the planes that part the cells: where a panel grazes, and where two of one largest give alike."""
        rows, found = np.array(self.law.gains)[:, None] * self.normals_B, [*self.normals_B]
        for one in self.law.inputs:
            for i, j in (
                np.argwhere(np.triu(np.ones((len(one.panels),) * 2), 1)) if one.largest else ()
            ):
                across = rows[one.panels[i]] - rows[one.panels[j]]
                if (size := np.linalg.norm(across)) > ON_PLANE * self.largest:
                    found.append(across / size)
        kept: list[np.ndarray] = []
        for normal in found:
            if all(abs(normal @ other) < 1 - 1e-12 for other in kept):
                kept.append(normal)
        return np.array(kept)

    def best(self, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (
            super().best(readings)
            if self._flat is None
            else self._flat.places.best(self.power, readings)
        )

    def candidates(self, share: np.ndarray) -> np.ndarray:
        return (
            super().candidates(share) if self._flat is None else self._flat.places.candidates(share)
        )

    def alike(self, readings: np.ndarray, slack: np.ndarray) -> np.ndarray:
        """Of the candidates those from which no way leads down: minima in a cell or on its border; and along arcs where there are
        any."""
        if self._flat is None:
            return super().alike(readings, slack)
        target, limit = unit_readings(readings), self.best(readings)[1] + slack
        found = np.concatenate(
            [self.best(readings)[0][:, None], self._flat.candidates(target)], axis=1
        )
        fits = misfit(self.power(found), target[:, None]) <= limit[:, None]
        sample, which = np.nonzero(
            fits & found.any(axis=-1)
        )  # where all is dark there is no candidate
        sun, wanted = found[sample, which], target[sample]
        here, lowest = misfit(self.power(sun), wanted), np.full(len(sun), np.inf)
        for step in AROUND[::2]:
            lowest = np.minimum(
                lowest,
                misfit(self.power(moved(sun, np.tile(DOWN_RAD * step, (len(sun), 1)))), wanted),
            )
        kept = np.zeros(found.shape[:2], dtype=bool)
        kept[sample, which] = here <= lowest + DOWN
        kept[:, 0] = True
        return np.where(kept[..., None], found, np.nan)

    def arc(self, readings: np.ndarray, lit: np.ndarray) -> np.ndarray:
        if self._flat is None:
            return super().arc(readings, lit)
        target = unit_readings(np.where(lit, readings, 0.0)[None])
        sun = self._flat.candidates(target)[0]
        power = self.power(sun)
        there = ((power > 0) == lit).all(axis=1)
        if not there.any():
            return np.full((2, 3), np.nan)
        away = np.where(there, misfit(power, target), np.inf)
        room = np.where(away < away.min() + DOWN, np.abs(sun @ self._planes.T).min(axis=1), -1.0)
        begin = sun[np.argmax(room)]
        return np.array([self._followed(begin, lit, sign) for sign in (1.0, -1.0)])

    def _followed(self, begin: np.ndarray, lit: np.ndarray, sign: float) -> np.ndarray:
        """Of flat panels an arc is a great circle from one plane to the next."""
        if self._flat is None:
            return super()._followed(begin, lit, sign)
        planes, sun, along, left = self._planes, begin, sign * self._unseen(begin, lit), np.pi
        while True:
            here, onward = planes @ sun, planes @ along
            crossing = (
                np.arctan2(-here, onward)[np.hypot(here, onward) > ON_PLANE] % np.pi
            )  # not those in which the arc lies
            step = min(float(crossing.min(initial=np.pi)), left)
            left -= step
            end, ahead = (
                np.cos(angle) * sun + np.sin(angle) * along for angle in (step, step + BEYOND)
            )
            if left <= BEYOND or not np.array_equal(self.power(ahead) > 0, lit):
                return end
            new = self._unseen(ahead, lit)
            along = new * np.copysign(1.0, new @ (np.cos(step) * along - np.sin(step) * sun))
            sun = ahead

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
            new = [
                one
                for k, one in enumerate(new)
                if _is_new(one, found + new[:k]) and self._changes_little(one)
            ]
            found += new
        return np.array(found[:MOST_IMAGES])

    def _changes_little(self, image: np.ndarray) -> bool:
        sun = sphere(LOOKS)
        return bool(
            np.abs(self.power(sun @ image.T) - self.power(sun)).max() < LIKE * self.gains.min()
        )


def _is_new(one: np.ndarray, found: list[np.ndarray]) -> bool:
    return all(np.abs(one - other).max() > 1e-6 for other in found)
