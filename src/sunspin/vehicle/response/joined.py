"""Panels that share inputs of the power system: a reading belongs to an input and not to a panel.

An input is a channel of several panels, whose sum or largest it reads, or one panel on an input of its own. Which of its panels is
lit it does not say, so one reading may have several directions. The planes in which panels graze, and those between two of one
largest, cut the sphere into cells in each of which the same panels make the readings; there these are linear in the direction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from sunspin.base.errors import VehicleError
from sunspin.solve.rotations import move_on_sphere, tangent_basis
from sunspin.vehicle.response.flat import (
    RANK_TOLERANCE,
    Candidates,
    PanelResponse,
    Regions,
    Slopes,
    misfit,
    normalise_readings,
    unweighted_covariance,
)
from sunspin.vehicle.response.planes import ON_PLANE, DirectionSet, minimal_clauses, sphere

CLIMB_STEPS, CLIMB_STARTS = 30, 200
"""Steps, and starts, of the search for the direction in which a sum of panels gives most."""

SYMMETRY_TOLERANCE, SYMMETRY_DIRECTIONS = 0.3, 500
"""A mirror that changes no reading by more than this share of full Sun leaves motions that are nearly alike, and in how many
directions that is looked at."""

MAX_SYMMETRIES = 48
"""Mirrors and turns of a cube; no more are tried."""

MAX_PLANES = 40
"""Planes of panels, and between those of one largest, that a vehicle may have: cells grow with their square."""

ARC_ANGLES_RAD = np.arange(-1.4, 1.5, 0.2)
"""Angles (rad) at which an arc of directions that fit alike is looked at."""

NEIGHBOUR_STEPS = np.stack(
    [np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)], axis=-1
)
NEIGHBOUR_RAD, DELTA_TOLERANCE = 1e-4, 1e-9
"""A direction is a minimum of Delta if no direction so far from it (`AROUND`) has one smaller by so much."""

CROSSING_RAD = 1e-7
"""rad by which the next cell is entered."""


@dataclass(frozen=True)
class Input:
    """One reading: its name, which panels it reads, by number, and whether the largest of them and not their sum."""

    name: str
    panels: tuple[int, ...]
    largest: bool = False


def full_sun(shared: Input, normals_B: np.ndarray, gains: np.ndarray) -> tuple[np.ndarray, float]:
    """The direction (3) in which an input of panels with normals (n_panel, 3) and gains (n_panel) reads most, and what it reads."""
    own = list(shared.panels)
    if shared.largest or len(own) == 1:
        best = own[int(np.argmax(gains[own]))]
        return normals_B[best], float(gains[best])
    rows = gains[own, None] * normals_B[own]
    sun = np.concatenate([normals_B[own], sphere(CLIMB_STARTS)])
    for _ in range(
        CLIMB_STEPS
    ):  # the sum is convex in the direction: towards its slope it never falls
        slope = (sun @ rows.T > 0) @ rows
        size = np.linalg.norm(slope, axis=1, keepdims=True)
        sun = np.where(size > 0, slope / np.where(size > 0, size, 1.0), sun)
    signal = np.maximum(sun @ rows.T, 0.0).sum(axis=1)
    best = int(np.argmax(signal))
    return sun[best], float(signal[best])


@dataclass(frozen=True, eq=False)
class JoinedResponse(PanelResponse):
    """Panels that share inputs: what is said of panels in :class:`PanelResponse` holds for inputs here, but that `normals_B`
    (n_panel, 3) and `gains` (n_panel) are those of the panels."""

    inputs: tuple[Input, ...]

    @cached_property
    def _full(self) -> list[tuple[np.ndarray, float]]:
        return [full_sun(shared, self.normals_B, self.gains) for shared in self.inputs]

    @property
    def facing_B(self) -> np.ndarray:
        return np.array([sun for sun, _ in self._full])

    @property
    def full_sun_readings(self) -> np.ndarray:
        """The largest signal (n_input) of each input."""
        return np.array([signal for _, signal in self._full])

    @property
    def largest_power(self) -> float:
        return float(self.full_sun_readings.max())

    def _made(self, signal: np.ndarray) -> np.ndarray:
        """Which panels (..., n_panel) make the readings, by their signals: inside a cell always the same ones."""
        makes = signal > 0
        for shared in self.inputs:
            if shared.largest and len(shared.panels) > 1:
                own = list(shared.panels)
                first = np.arange(len(own)) == np.argmax(signal[..., own], axis=-1)[..., None]
                makes[..., own] &= first
        return makes

    def _sides(self, sun_B: np.ndarray) -> np.ndarray:
        """The same for directions (..., 3)."""
        return self._made(super().power(sun_B))

    def _summed(self, parts: np.ndarray, axis: int = -1) -> np.ndarray:
        """Of parts of panels, zero where they make no reading, the sums of inputs."""
        each = [np.take(parts, list(own.panels), axis=axis).sum(axis=axis) for own in self.inputs]
        return np.stack(each, axis=axis)

    def _matrix(self, makes: np.ndarray) -> np.ndarray:
        """Readings by direction (..., n_input, 3) where panels `makes` (..., n_panel) make them."""
        return self._summed((makes * self.gains)[..., None] * self.normals_B, axis=-2)

    def _read(self, signal: np.ndarray, gain: np.ndarray | None = None) -> np.ndarray:
        """Readings (..., n_input) of signals (..., n_panel) of the panels."""
        each = [
            (np.max if own.largest else np.sum)(signal[..., list(own.panels)], axis=-1)
            for own in self.inputs
        ]
        return np.stack(each, axis=-1) * (1.0 if gain is None else gain)

    def power(
        self, sun_B: np.ndarray, *, gain: np.ndarray | None = None, tilt: np.ndarray | None = None
    ) -> np.ndarray:
        return self._read(super().power(sun_B, tilt=tilt), gain)

    def slopes(
        self, sun_B: np.ndarray, *, gain: np.ndarray | None = None, tilt: np.ndarray | None = None
    ) -> Slopes:
        signal, to_sun, to_tilt = super().slopes(sun_B, tilt=tilt)
        makes = self._made(signal)[..., None]
        factor = 1.0 if gain is None else np.asarray(gain)[..., None]
        to_sun = self._summed(makes * to_sun, axis=-2) * factor
        if to_tilt is not None:
            to_tilt = self._summed(makes * to_tilt, axis=-2) * factor
        return Slopes(self._read(signal, gain), to_sun, to_tilt)

    def power_changes(
        self,
        sun_B: np.ndarray,
        steps: Sequence[np.ndarray],
        *,
        gain: np.ndarray | None = None,
        tilt: np.ndarray | None = None,
    ) -> list[np.ndarray]:
        to_sun = self.slopes(sun_B, gain=gain, tilt=tilt).to_sun
        return [np.einsum("...pi,...i->...p", to_sun, step) for step in steps]

    def light_power(self, light_B: np.ndarray, unit: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        signal, _ = super().light_power(light_B, unit)
        return self._read(signal), self._matrix(self._made(signal)) / unit

    def earthlight(self, axis_B: np.ndarray, strength: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        signal, slope = super().earthlight(axis_B, np.ones(axis_B.shape[:-1]))
        light = self._read(signal) * np.asarray(strength)[..., None]
        return light, self._summed(self._made(signal)[..., None] * slope, axis=-2)

    def bounds(self, sun_B: np.ndarray, angle: float) -> tuple[np.ndarray, np.ndarray]:
        low, high = super().bounds(sun_B, angle)
        return self._read(low), np.minimum(self._read(high), self.full_sun_readings)

    @cached_property
    def _planes(self) -> np.ndarray:
        """Where a panel grazes, and where two of one largest give alike."""
        normals = [*self.normals_B]
        for shared in self.inputs:
            for i, j in combinations(shared.panels, 2) if shared.largest else ():
                across = self._rows[i] - self._rows[j]
                if (size := np.linalg.norm(across)) > ON_PLANE * self.largest_power:
                    normals.append(across / size)
        kept: list[np.ndarray] = []
        for normal in normals:
            if all(abs(normal @ other) < 1 - 1e-12 for other in kept):
                kept.append(normal)
        if len(kept) > MAX_PLANES:
            what = f"the panels have {len(kept)} planes, more than {MAX_PLANES}"
            do = "leave out panels, or let channels read sums"
            raise VehicleError(f"{what}, where some share an input", do=do)
        return np.array(kept)

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
        design = (self._matrix(self._sides(sun_B)) / self.full_sun_readings[:, None])[lit]
        return int(np.count_nonzero(np.linalg.svd(design, compute_uv=False) > RANK_TOLERANCE))

    def direction_set(self, good: np.ndarray, bad: np.ndarray) -> DirectionSet:
        """By the planes of the cells: which of their sides are those of a cell in which one of the sets is lit."""
        lit, sides = self.regions().lit, self._cells.cell_lit
        wanted = (lit[:, None] == good).all(axis=-1).any(axis=1)
        return DirectionSet(self._planes, minimal_clauses(sides[wanted], sides[~wanted]))

    @cached_property
    def _candidates(self) -> Candidates:
        planes, cells = self._planes, self._cells
        on_arcs = np.unique(np.column_stack([self._sides(cells.arc_B), cells.arc_plane]), axis=0)
        between = [(self._matrix(arc[:-1]), planes[arc[-1]]) for arc in on_arcs]
        between = [(matrix, normal) for matrix, normal in between if matrix.any()]
        return Candidates.from_cells(
            self._within, between, np.concatenate([cells.vertex_B, cells.cell_B])
        )

    @cached_property
    def _within(self) -> list[np.ndarray]:
        """Readings by direction (n_input, 3) in each cell."""
        makes = np.unique(self._sides(self._cells.cell_B), axis=0)
        return [matrix for panels in makes if (matrix := self._matrix(panels)).any()]

    @cached_property
    def _free(self) -> np.ndarray:
        """Per matrix of a cell the direction (3) along which the readings' proportions stay, zeros if there is none."""
        tolerance = RANK_TOLERANCE * self.largest_power
        return np.array(
            [
                np.linalg.svd(matrix)[2][2]
                if np.linalg.matrix_rank(matrix, tolerance) == 2
                else np.zeros(3)
                for matrix in self._within
            ]
        )

    def _all_candidates(self, target: np.ndarray) -> np.ndarray:
        """Directions (n, n_candidate, 3) in which unit readings (n, n_input) may have the least Delta: those of `_candidates`, and more
        along the arcs on which the readings stay as they are."""
        has = self._free.any(axis=1)
        mapped = self._candidates.from_readings(target)
        middle = mapped[:, : len(self._free)][:, has]
        along = [
            np.cos(angle) * middle + np.sin(angle) * self._free[has] for angle in ARC_ANGLES_RAD
        ]
        fixed = np.broadcast_to(
            self._candidates.fixed, (len(target), *self._candidates.fixed.shape)
        )
        return np.concatenate([mapped, fixed, *along], axis=1)

    def near_best(self, readings: np.ndarray, slack: np.ndarray) -> np.ndarray:
        """Of the candidates those from which no way leads down: minima in a cell or on its border; and along arcs where there are
        any."""
        target, (best, delta) = normalise_readings(readings), self.best_direction(readings)
        tried = np.concatenate([best[:, None], self._all_candidates(target)], axis=1)
        fits = misfit(self.power(tried), target[:, None]) <= (delta + slack)[:, None]
        sample, which = np.nonzero(fits & tried.any(axis=-1))  # in the dark there is no candidate
        sun, wanted = tried[sample, which], target[sample]
        near = [
            move_on_sphere(sun, np.tile(NEIGHBOUR_RAD * step, (len(sun), 1)))
            for step in NEIGHBOUR_STEPS
        ]
        lowest = np.min([misfit(self.power(each), wanted) for each in near], axis=0)
        kept = np.zeros(tried.shape[:2], dtype=bool)
        kept[sample, which] = misfit(self.power(sun), wanted) <= lowest + DELTA_TOLERANCE
        kept[:, 0] = True
        return np.where(kept[..., None], tried, np.nan)

    def covariance(self, readings: np.ndarray, lit: np.ndarray, noise: np.ndarray) -> np.ndarray:
        sun, _ = self.best_direction(readings)
        design = self._matrix(self._sides(sun)) * lit[:, None]
        power = self.power(sun) * lit
        bright = (readings * power).sum(axis=1) / np.maximum((power**2).sum(axis=1), 1e-300)
        tangent = np.eye(3) - sun[:, :, None] * sun[:, None, :]
        covariance = np.full((len(sun), 3, 3), np.nan)
        normal = np.swapaxes(design, -1, -2) @ design
        fine = (np.linalg.cond(normal) < RANK_TOLERANCE**-2) & (bright > 0)
        scaled = unweighted_covariance(design[fine], noise) / bright[fine, None, None] ** 2
        covariance[fine] = tangent[fine] @ scaled @ tangent[fine]
        return covariance

    def _unseen(self, sun: np.ndarray, lit: np.ndarray) -> np.ndarray:
        """The tangent (3) at a direction (3) along which the proportions of the lit inputs' readings change least."""
        frame = np.stack(tangent_basis(sun[None]), axis=-1)[0]
        power, to_sun = (value[lit] for value in self.slopes(sun)[:2])
        across = to_sun @ frame
        across = across - np.outer(power, power @ across) / (power @ power)
        return frame @ np.linalg.svd(across)[2][1]

    def arc(self, readings: np.ndarray, lit: np.ndarray) -> np.ndarray:
        target = normalise_readings(np.where(lit, readings, 0.0)[None])
        sun = self._all_candidates(target)[0]
        power = self.power(sun)
        there = ((power > 0) == lit).all(axis=1)
        if not there.any():
            return np.full((2, 3), np.nan)
        away = np.where(there, misfit(power, target), np.inf)
        room = np.where(
            away < away.min() + DELTA_TOLERANCE, np.abs(sun @ self._planes.T).min(axis=1), -1.0
        )
        begin = sun[np.argmax(room)]
        return np.array([self._followed(begin, lit, sign) for sign in (1.0, -1.0)])

    def _followed(self, begin: np.ndarray, lit: np.ndarray, sign: float) -> np.ndarray:
        """The end of an arc: a great circle from one plane to the next."""
        planes, sun, along, left = self._planes, begin, sign * self._unseen(begin, lit), np.pi
        while True:
            here, onward = planes @ sun, planes @ along
            across = np.hypot(here, onward) > ON_PLANE  # not the planes in which the arc lies
            crossing = np.arctan2(-here, onward)[across] % np.pi
            step = min(float(crossing.min(initial=np.pi)), left)
            left -= step
            end, ahead = (
                np.cos(angle) * sun + np.sin(angle) * along for angle in (step, step + CROSSING_RAD)
            )
            if left <= CROSSING_RAD or not np.array_equal(self.power(ahead) > 0, lit):
                return end
            new = self._unseen(ahead, lit)
            along = new * np.copysign(1.0, new @ (np.cos(step) * along - np.sin(step) * sun))
            sun = ahead

    @cached_property
    def symmetries(self) -> np.ndarray:
        """Mirrors that exchange two panels of one input, and what they make together, as far as they change no reading much."""
        mirrors = []
        for shared in self.inputs:
            for i, j in combinations(shared.panels, 2):
                across = self.normals_B[i] - self.normals_B[j]
                if (size := np.linalg.norm(across)) > 0:
                    mirrors.append(np.eye(3) - 2 * np.outer(across, across) / size**2)
        sun, most = sphere(SYMMETRY_DIRECTIONS), SYMMETRY_TOLERANCE * self.full_sun_readings.min()
        images, new = [np.eye(3)], [np.eye(3)]
        while new and len(images) < MAX_SYMMETRIES:
            products, new = [mirror @ image for image in new for mirror in mirrors], []
            for image in products:
                if all(np.abs(image - known).max() > 1e-6 for known in images + new):
                    change = np.abs(self.power(sun @ image.T) - self.power(sun)).max()
                    new += [image] if change < most else []
            images += new
        return np.array(images[:MAX_SYMMETRIES])
