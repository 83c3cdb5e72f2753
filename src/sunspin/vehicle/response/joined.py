"""Panels that share inputs of the power system: a reading belongs to an input and not to a panel.

An input is a channel of several panels, whose sum or largest it reads, or one panel on an input of its own. Which of its panels is
lit it does not say, so one reading may have several directions. The planes in which panels graze, and those between two of one
largest, cut the sphere into cells in each of which the same panels make the readings; there these are linear in the direction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sunspin.base.errors import VehicleError
from sunspin.solve.linear import plain_covariance
from sunspin.solve.rotations import moved, tangents
from sunspin.vehicle.response.cosine import (
    RANK_TOLERANCE,
    Flat,
    Places,
    along_normals,
    places_of,
)
from sunspin.vehicle.response.planes import ON_PLANE, Arrangement, arrangement, formula
from sunspin.vehicle.response.protocol import (
    Counted,
    Regions,
    Slopes,
    misfit,
    sphere,
    unit_readings,
)

CLIMBS, STARTS = 30, 200
"""Steps, and starts, of the search for the direction in which a sum of panels gives most."""

LIKE, LOOKS = 0.3, 500
"""A mirror that changes no reading by more than this share of full Sun leaves motions that are nearly alike, and in how many
directions that is looked at."""

MOST_IMAGES = 48
"""Mirrors and turns of a cube; no more are tried."""

MOST_PLANES = 40
"""Planes of panels, and between those of one largest, that a vehicle may have: cells grow with their square."""

ALONG = np.arange(-1.4, 1.5, 0.2)
"""Angles (rad) at which an arc of directions that fit alike is looked at."""

AROUND = np.stack([np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)], axis=-1)
DOWN_RAD, DOWN = 1e-4, 1e-9
"""A direction is a minimum of Delta if no direction so far from it (`AROUND`) has one smaller by so much."""

BEYOND = 1e-7
"""rad by which the next cell is entered."""


@dataclass(frozen=True)
class Input:
    """One reading: its name, which panels it reads, by number, and whether the largest of them and not their sum."""

    name: str
    panels: tuple[int, ...]
    largest: bool = False


def full_sun(one: Input, normals_B: np.ndarray, gains: np.ndarray) -> tuple[np.ndarray, float]:
    """The direction (3) in which an input of panels with normals (n_panel, 3) and gains (n_panel) reads most, and what it reads."""
    own = list(one.panels)
    if one.largest or len(own) == 1:
        best = own[int(np.argmax(gains[own]))]
        return normals_B[best], float(gains[best])
    rows = gains[own, None] * normals_B[own]
    sun = np.concatenate([normals_B[own], sphere(STARTS)])
    for _ in range(CLIMBS):  # the sum is convex in the direction: towards its slope it never falls
        slope = (sun @ rows.T > 0) @ rows
        size = np.linalg.norm(slope, axis=1, keepdims=True)
        sun = np.where(size > 0, slope / np.where(size > 0, size, 1.0), sun)
    signal = np.maximum(sun @ rows.T, 0.0).sum(axis=1)
    best = int(np.argmax(signal))
    return sun[best], float(signal[best])


@dataclass(frozen=True, eq=False)
class Joined(Flat):
    """Inputs as a :class:`sunspin.vehicle.response.protocol.PanelResponse`: what is said of panels there holds for inputs here.

    `normals_B` (n_panel, 3) and `gains` (n_panel) are those of the panels.
    """

    inputs: tuple[Input, ...]

    @cached_property
    def _full(self) -> list[tuple[np.ndarray, float]]:
        return [full_sun(one, self.normals_B, self.gains) for one in self.inputs]

    @property
    def facing_B(self) -> np.ndarray:
        return np.array([sun for sun, _ in self._full])

    @property
    def full(self) -> np.ndarray:
        """The largest signal (n_input) of each input."""
        return np.array([signal for _, signal in self._full])

    @property
    def largest(self) -> float:
        return float(self.full.max())

    # ------------------------------------------------------------------------------------------------------- readings and slopes

    def _made(self, signal: np.ndarray) -> np.ndarray:
        """Which panels (..., n_panel) make the readings, by their signals: inside a cell always the same ones."""
        made = signal > 0
        for one in self.inputs:
            if one.largest and len(one.panels) > 1:
                own = list(one.panels)
                first = np.arange(len(own)) == np.argmax(signal[..., own], axis=-1)[..., None]
                made[..., own] &= first
        return made

    def sides(self, sun_B: np.ndarray) -> np.ndarray:
        """The same for directions (..., 3)."""
        return self._made(self.gains * np.maximum(sun_B @ self.normals_B.T, 0.0))

    def _summed(self, parts: np.ndarray, axis: int = -1) -> np.ndarray:
        """Of parts of panels, zero where they make no reading, the sums of inputs."""
        each = [np.take(parts, list(one.panels), axis=axis).sum(axis=axis) for one in self.inputs]
        return np.stack(each, axis=axis)

    def _power(
        self, sun_B: np.ndarray, gain: np.ndarray | None, tilt: np.ndarray | None
    ) -> np.ndarray:
        return self._read(self.gains * np.maximum(self.cosines(sun_B, tilt), 0.0), gain)

    def _read(self, signal: np.ndarray, gain: np.ndarray | None = None) -> np.ndarray:
        """Readings (..., n_input) of signals (..., n_panel) of the panels."""
        each = [
            signal[..., list(one.panels)].max(axis=-1)
            if one.largest
            else signal[..., list(one.panels)].sum(axis=-1)
            for one in self.inputs
        ]
        return np.stack(each, axis=-1) * (1.0 if gain is None else gain)

    def slopes(
        self, sun_B: np.ndarray, *, gain: np.ndarray | None = None, tilt: np.ndarray | None = None
    ) -> Slopes:
        normals, sun = self.turned(tilt), sun_B[..., None, :]
        cosine = along_normals(sun_B, normals)
        signal = self.gains * np.maximum(cosine, 0.0)
        strength = (self.gains * self._made(signal))[..., None]
        factor = 1.0 if gain is None else np.asarray(gain)[..., None]
        to_sun = self._summed(strength * (normals - cosine[..., None] * sun), axis=-2) * factor
        if tilt is None:
            return Slopes(self._read(signal, gain), to_sun, None)
        to_tilt = self._summed(strength * np.cross(normals, sun), axis=-2) * factor
        return Slopes(self._read(signal, gain), to_sun, to_tilt)

    def along(
        self,
        sun_B: np.ndarray,
        steps: Sequence[np.ndarray],
        *,
        gain: np.ndarray | None = None,
        tilt: np.ndarray | None = None,
    ) -> list[np.ndarray]:
        to_sun = self.slopes(sun_B, gain=gain, tilt=tilt).to_sun
        return [np.einsum("...pi,...i->...p", to_sun, step) for step in steps]

    def under(self, light_B: np.ndarray, unit: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        signal = self.gains * np.maximum(light_B @ self.normals_B.T, 0.0)
        return self._read(signal) / unit, self.design(light_B) / unit

    def design(self, light_B: np.ndarray) -> np.ndarray:
        """The derivative (..., n_input, 3) of readings by the vector brightness times direction."""
        return self._summed((self.gains * self.sides(light_B))[..., None] * self.normals_B, axis=-2)

    def disc(self, axis_B: np.ndarray, strength: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As of panels that share no input (:class:`sunspin.vehicle.response.cosine.Cosine`), summed or the largest."""
        signal, slope = super().disc(axis_B, np.ones(axis_B.shape[:-1]))
        light = self._read(signal) * np.asarray(strength)[..., None]
        return light, self._summed(self._made(signal)[..., None] * slope, axis=-2)

    def bounds(self, sun_B: np.ndarray, angle: float) -> tuple[np.ndarray, np.ndarray]:
        low, high = super().bounds(sun_B, angle)
        return self._read(low), np.minimum(self._read(high), self.full)

    # --------------------------------------------------------------------------------------------------------------------- cells

    @cached_property
    def _planes(self) -> np.ndarray:
        """Unit normals (n, 3) of the planes that part the cells: where a panel grazes, and where two of one largest give alike."""
        rows, normals = self.gains[:, None] * self.normals_B, [*self.normals_B]
        for one in self.inputs:
            for i, j in (
                np.argwhere(np.triu(np.ones((len(one.panels),) * 2), 1)) if one.largest else ()
            ):
                across = rows[one.panels[i]] - rows[one.panels[j]]
                if (size := np.linalg.norm(across)) > ON_PLANE * self.largest:
                    normals.append(across / size)
        kept: list[np.ndarray] = []
        for normal in normals:
            if all(abs(normal @ other) < 1 - 1e-12 for other in kept):
                kept.append(normal)
        if len(kept) > MOST_PLANES:
            what = f"the panels have {len(kept)} planes, more than {MOST_PLANES}"
            do = "leave out panels, or let channels read sums"
            raise VehicleError(f"{what}, where some share an input", do=do)
        return np.array(kept)

    @cached_property
    def _cells(self) -> Arrangement:
        return arrangement(tuple(map(tuple, self._planes.tolist())))

    def regions(self) -> Regions:
        return Regions(self._cells.cell_B, self.power(self._cells.cell_B) > 0)

    def edges(self) -> np.ndarray:
        sun = np.concatenate([self._cells.arc_B, self._cells.vertex_B])
        return self._summed(sun @ self.normals_B.T > ON_PLANE) > 0

    def rank(self, lit: np.ndarray, sun_B: np.ndarray | None = None) -> int:
        if not lit.any():
            return 0
        if sun_B is None:
            cells = self._cells
            every = np.concatenate([cells.cell_B, cells.arc_B, cells.vertex_B])
            shown = np.concatenate([self.regions().lit, self.edges()])
            there = every[(shown == lit).all(axis=1)]
            return max((self.rank(lit, sun) for sun in there), default=min(int(lit.sum()), 3))
        design = (self.design(sun_B) / self.full[:, None])[lit]
        return int(np.count_nonzero(np.linalg.svd(design, compute_uv=False) > RANK_TOLERANCE))

    def counted(self, good: np.ndarray, bad: np.ndarray) -> Counted:
        """By the planes of the cells: which of their sides are those of a cell in which one of the sets is lit."""
        lit, sides = self.regions().lit, self._cells.cell_lit
        wanted = (lit[:, None] == good).all(axis=-1).any(axis=1)
        return Counted(self._planes, formula(sides[wanted], sides[~wanted]))

    @cached_property
    def _places(self) -> Places:
        """Where the least Delta may lie: in a cell readings are linear in the direction, as of panels that share no input."""
        planes, cells = self._planes, self._cells
        on_arcs = np.unique(np.column_stack([self.sides(cells.arc_B), cells.arc_plane]), axis=0)
        between = [(self._matrix(one[:-1]), planes[one[-1]]) for one in on_arcs]
        between = [(matrix, normal) for matrix, normal in between if matrix.any()]
        fixed = np.concatenate([cells.vertex_B, cells.cell_B])
        return places_of(self._within, between, fixed)

    def _matrix(self, made: np.ndarray) -> np.ndarray:
        """Readings by direction (n_input, 3) where panels `made` (n_panel) make them."""
        return self._summed((made * self.gains)[:, None] * self.normals_B, axis=-2)

    @cached_property
    def _within(self) -> list[np.ndarray]:
        """These matrices of the cells."""
        made = np.unique(self.sides(self._cells.cell_B), axis=0)
        return [matrix for one in made if (matrix := self._matrix(one)).any()]

    @cached_property
    def _free(self) -> np.ndarray:
        """Per matrix of a cell the direction (3) along which the readings' proportions stay, zeros if there is none."""
        tolerance = RANK_TOLERANCE * self.largest
        return np.array(
            [
                np.linalg.svd(matrix)[2][2]
                if np.linalg.matrix_rank(matrix, tolerance) == 2
                else np.zeros(3)
                for matrix in self._within
            ]
        )

    def _all_candidates(self, target: np.ndarray) -> np.ndarray:
        """The candidates (n, n_candidate, 3) for unit readings (n, n_input), and more along the arcs on which these stay as they
        are."""
        has = self._free.any(axis=1)
        middle = self._places.mapped(target)[:, : len(self._free)][:, has]
        along = [np.cos(angle) * middle + np.sin(angle) * self._free[has] for angle in ALONG]
        return np.concatenate([self._places.candidates(target), *along], axis=1)

    def alike(self, readings: np.ndarray, slack: np.ndarray) -> np.ndarray:
        """Of the candidates those from which no way leads down: minima in a cell or on its border; and along arcs where there are
        any."""
        target, limit = unit_readings(readings), self.best(readings)[1] + slack
        found = np.concatenate(
            [self.best(readings)[0][:, None], self._all_candidates(target)], axis=1
        )
        fits = misfit(self.power(found), target[:, None]) <= limit[:, None]
        sample, which = np.nonzero(
            fits & found.any(axis=-1)
        )  # where all is dark there is no candidate
        sun, wanted = found[sample, which], target[sample]
        here, lowest = misfit(self.power(sun), wanted), np.full(len(sun), np.inf)
        for step in AROUND:
            lowest = np.minimum(
                lowest,
                misfit(self.power(moved(sun, np.tile(DOWN_RAD * step, (len(sun), 1)))), wanted),
            )
        kept = np.zeros(found.shape[:2], dtype=bool)
        kept[sample, which] = here <= lowest + DOWN
        kept[:, 0] = True
        return np.where(kept[..., None], found, np.nan)

    def covariance(self, readings: np.ndarray, lit: np.ndarray, noise: np.ndarray) -> np.ndarray:
        sun, _ = self.best(readings)
        design = self.design(sun) * lit[:, None]
        power = self.power(sun) * lit
        bright = (readings * power).sum(axis=1) / np.maximum((power**2).sum(axis=1), 1e-300)
        tangent = np.eye(3) - sun[:, :, None] * sun[:, None, :]
        covariance = np.full((len(sun), 3, 3), np.nan)
        normal = np.swapaxes(design, -1, -2) @ design
        fine = (np.linalg.cond(normal) < RANK_TOLERANCE**-2) & (bright > 0)
        scaled = plain_covariance(design[fine], noise) / bright[fine, None, None] ** 2
        covariance[fine] = tangent[fine] @ scaled @ tangent[fine]
        return covariance

    def _unseen(self, sun: np.ndarray, lit: np.ndarray) -> np.ndarray:
        """The tangent (3) at a direction (3) along which the proportions of the lit inputs' readings change least."""
        frame = np.stack(tangents(sun[None]), axis=-1)[0]
        power, to_sun = (value[lit] for value in self.slopes(sun)[:2])
        across = to_sun @ frame
        across = across - np.outer(power, power @ across) / (power @ power)
        return frame @ np.linalg.svd(across)[2][1]

    def arc(self, readings: np.ndarray, lit: np.ndarray) -> np.ndarray:
        target = unit_readings(np.where(lit, readings, 0.0)[None])
        sun = self._all_candidates(target)[0]
        power = self.power(sun)
        there = ((power > 0) == lit).all(axis=1)
        if not there.any():
            return np.full((2, 3), np.nan)
        away = np.where(there, misfit(power, target), np.inf)
        room = np.where(away < away.min() + DOWN, np.abs(sun @ self._planes.T).min(axis=1), -1.0)
        begin = sun[np.argmax(room)]
        return np.array([self._followed(begin, lit, sign) for sign in (1.0, -1.0)])

    def _followed(self, begin: np.ndarray, lit: np.ndarray, sign: float) -> np.ndarray:
        """The end of an arc: a great circle from one plane to the next."""
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
        for one in self.inputs:
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
                if all(np.abs(one - other).max() > 1e-6 for other in found + new[:k])
                and self._changes_little(one)
            ]
            found += new
        return np.array(found[:MOST_IMAGES])

    def _changes_little(self, image: np.ndarray) -> bool:
        sun = sphere(LOOKS)
        return bool(
            np.abs(self.power(sun @ image.T) - self.power(sun)).max() < LIKE * self.full.min()
        )
