"""Response of panels that share inputs of the power system: a reading belongs to an input, not to a panel.

An input is a channel of several panels, of which it reads the sum or the largest, or a single panel. A channel does not say
which of its panels is lit, so that one reading may fit several directions. The sphere is cut into cells by the planes in which
panels graze, and by those in which two panels of a largest-reading channel are equal. In a cell the same panels make the
readings, which are linear in the direction there.
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
    PanelResponse,
    Regions,
    Slopes,
    TrialDirections,
    misfit,
    normalise_readings,
    unweighted_covariance,
)
from sunspin.vehicle.response.planes import ON_PLANE, DirectionSet, minimal_clauses, sphere

CLIMB_STEPS, CLIMB_STARTS = 30, 200
"""Steps and starts of the search for the direction in which a sum of panels is largest."""

SYMMETRY_TOLERANCE, SYMMETRY_DIRECTIONS = 0.3, 500
"""A mirror is a symmetry if it changes no reading by more than this share of the smallest full-Sun reading.
Then motions and their mirror images are hard to tell apart. The second number: directions at which it is tested."""

MAX_SYMMETRIES = 48
"""Order of the symmetry group of a cube, rotations and mirrors."""

MAX_PLANES = 40
"""Planes in which panels graze or are equal; the number of cells grows with their square."""

ARC_ANGLES_RAD = np.arange(-1.4, 1.5, 0.2)
"""Angles at which an arc of equally good directions is sampled."""

NEIGHBOUR_STEPS = np.stack(
    [np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)], axis=-1
)
"""Unit tangent vectors (8, 2) to the directions around one that is tested for a minimum."""

NEIGHBOUR_RAD, DELTA_TOLERANCE = 1e-4, 1e-9
"""A direction is a minimum of Delta if no neighbour at the first distance is smaller by more than the second number."""

CROSSING_RAD = 1e-7
"""Step beyond a plane that enters the next cell."""


@dataclass(frozen=True)
class Input:
    """An input of the telemetry: its name, the indices of its panels, and whether it reads their largest signal or their sum."""

    name: str
    panels: tuple[int, ...]
    largest: bool = False


def full_sun(shared: Input, normals_B: np.ndarray, gains: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the Sun direction (3) for which an input reads most, and that reading.

    `normals_B` (n_panel, 3) and `gains` (n_panel) are those of all panels.
    """
    members = list(shared.panels)  # indices of the panels of this input
    if shared.largest or len(members) == 1:
        best = members[int(np.argmax(gains[members]))]
        return normals_B[best], float(gains[best])
    rows = gains[members, None] * normals_B[members]
    sun = np.concatenate([normals_B[members], sphere(CLIMB_STARTS)])
    # the sum is convex in the direction, so that moving to the direction of its gradient never lowers it
    for _ in range(CLIMB_STEPS):
        slope = (sun @ rows.T > 0) @ rows
        size = np.linalg.norm(slope, axis=1, keepdims=True)
        sun = np.where(size > 0, slope / np.where(size > 0, size, 1.0), sun)
    signal = np.maximum(sun @ rows.T, 0.0).sum(axis=1)
    best = int(np.argmax(signal))
    return sun[best], float(signal[best])


@dataclass(frozen=True, eq=False)
class JoinedResponse(PanelResponse):
    """Response of panels that share inputs.

    The methods of :class:`PanelResponse` return values per input here; `normals_B` (n_panel, 3) and `gains` (n_panel) are per
    panel.
    """

    inputs: tuple[Input, ...]

    @cached_property
    def _full(self) -> list[tuple[np.ndarray, float]]:
        """Direction and reading of each input at its largest reading."""
        return [full_sun(shared, self.normals_B, self.gains) for shared in self.inputs]

    @property
    def facing_B(self) -> np.ndarray:
        return np.array([sun for sun, _ in self._full])

    @property
    def full_sun_readings(self) -> np.ndarray:
        """Largest reading (n_input) of each input."""
        return np.array([signal for _, signal in self._full])

    @property
    def largest_power(self) -> float:
        return float(self.full_sun_readings.max())

    def _contributing(self, signal: np.ndarray) -> np.ndarray:
        """Return which panels (..., n_panel) contribute to the readings, from their signals; constant within a cell.

        A channel that reads a sum has all its lit panels, one that reads the largest only that panel.
        """
        contributing = signal > 0
        for shared in self.inputs:
            if shared.largest and len(shared.panels) > 1:
                members = list(shared.panels)
                largest = np.argmax(signal[..., members], axis=-1)[..., None]
                contributing[..., members] &= np.arange(len(members)) == largest
        return contributing

    def _contributing_at(self, sun_B: np.ndarray) -> np.ndarray:
        """Return which panels (..., n_panel) contribute to the readings at directions (..., 3)."""
        return self._contributing(super().power(sun_B))

    def _sum_inputs(self, parts: np.ndarray, axis: int = -1) -> np.ndarray:
        """Return the sums over the panels of each input, for values per panel along `axis`."""
        sums = [
            np.take(parts, list(shared.panels), axis=axis).sum(axis=axis) for shared in self.inputs
        ]
        return np.stack(sums, axis=axis)

    def _matrix(self, contributing: np.ndarray) -> np.ndarray:
        """Return matrices (..., n_input, 3): readings are the matrix times the direction.

        `contributing` (..., n_panel) are the panels that contribute.
        """
        return self._sum_inputs((contributing * self.gains)[..., None] * self.normals_B, axis=-2)

    def _readings(self, signal: np.ndarray, gain: np.ndarray | None = None) -> np.ndarray:
        """Return the readings (..., n_input) for signals (..., n_panel) of the panels and factors `gain` (..., n_input)."""
        readings = [
            (np.max if shared.largest else np.sum)(signal[..., list(shared.panels)], axis=-1)
            for shared in self.inputs
        ]
        return np.stack(readings, axis=-1) * (1.0 if gain is None else gain)

    def power(
        self, sun_B: np.ndarray, *, gain: np.ndarray | None = None, tilt: np.ndarray | None = None
    ) -> np.ndarray:
        return self._readings(super().power(sun_B, tilt=tilt), gain)

    def slopes(
        self, sun_B: np.ndarray, *, gain: np.ndarray | None = None, tilt: np.ndarray | None = None
    ) -> Slopes:
        signal, to_sun, to_tilt = super().slopes(sun_B, tilt=tilt)
        contributing = self._contributing(signal)[..., None]
        factor = 1.0 if gain is None else np.asarray(gain)[..., None]
        to_sun = self._sum_inputs(contributing * to_sun, axis=-2) * factor
        if to_tilt is not None:
            to_tilt = self._sum_inputs(contributing * to_tilt, axis=-2) * factor
        return Slopes(self._readings(signal, gain), to_sun, to_tilt)

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
        return self._readings(signal), self._matrix(self._contributing(signal)) / unit

    def earthlight(self, axis_B: np.ndarray, strength: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        signal, slope = super().earthlight(axis_B, np.ones(axis_B.shape[:-1]))
        light = self._readings(signal) * np.asarray(strength)[..., None]
        return light, self._sum_inputs(self._contributing(signal)[..., None] * slope, axis=-2)

    def bounds(self, sun_B: np.ndarray, angle: float) -> tuple[np.ndarray, np.ndarray]:
        low, high = super().bounds(sun_B, angle)
        return self._readings(low), np.minimum(self._readings(high), self.full_sun_readings)

    @cached_property
    def _planes(self) -> np.ndarray:
        """Return the unit normals (n, 3), each plane once, of the planes that separate cells.

        In such a plane a panel grazes (the Sun is in its plane), or two panels have equal signals, of which an input reads the
        larger.
        """
        normals = [*self.normals_B]
        for shared in self.inputs:
            for i, j in combinations(shared.panels, 2) if shared.largest else ():
                # signals are rows times direction: they are equal where the Sun is perpendicular to the difference of the rows
                difference = self._rows[i] - self._rows[j]
                # panels with equal rows have equal signals everywhere, so that there is no plane
                if (size := np.linalg.norm(difference)) > ON_PLANE * self.largest_power:
                    normals.append(difference / size)
        # opposite normals are the same plane
        kept: list[np.ndarray] = []
        for normal in normals:
            if all(abs(normal @ known) < 1 - 1e-12 for known in kept):
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
        return self._sum_inputs(sun @ self.normals_B.T > ON_PLANE) > 0

    def rank(self, lit: np.ndarray, sun_B: np.ndarray | None = None) -> int:
        if not lit.any():
            return 0
        if sun_B is None:
            cells = self._cells
            directions = np.concatenate([cells.cell_B, cells.arc_B, cells.vertex_B])
            patterns = np.concatenate([self.regions().lit, self.edges()])
            matching = directions[(patterns == lit).all(axis=1)]
            # a pattern that no direction has: as many as there are readings
            return max((self.rank(lit, sun) for sun in matching), default=min(int(lit.sum()), 3))
        design = (self._matrix(self._contributing_at(sun_B)) / self.full_sun_readings[:, None])[lit]
        return int(np.count_nonzero(np.linalg.svd(design, compute_uv=False) > RANK_TOLERANCE))

    def direction_set(self, good: np.ndarray, bad: np.ndarray) -> DirectionSet:
        """Return the set of directions in which the lit inputs are one of the patterns `good` (m, n_input).

        It is described by the sides of the planes, as an input does not show which of its panels is lit.
        """
        # of each cell: the inputs with light, and the side of each plane on which it lies
        lit, sides = self.regions().lit, self._cells.cell_lit
        is_good = (lit[:, None] == good).all(axis=-1).any(axis=1)
        return DirectionSet(self._planes, minimal_clauses(sides[is_good], sides[~is_good]))

    @cached_property
    def _candidates(self) -> TrialDirections:
        cells = self._cells
        # arcs in one plane with the same contributing panels give the same candidate
        contributing_and_plane = np.unique(
            np.column_stack([self._contributing_at(cells.arc_B), cells.arc_plane]), axis=0
        )
        between = []
        for *contributing, plane in contributing_and_plane:
            matrix = self._matrix(np.array(contributing))
            if matrix.any():
                between.append((matrix, self._planes[plane]))
        return TrialDirections.from_cells(
            self._cell_matrices, between, np.concatenate([cells.vertex_B, cells.cell_B])
        )

    @cached_property
    def _cell_matrices(self) -> list[np.ndarray]:
        """Matrices (n_input, 3) of the lit cells that give their readings for a direction; equal ones once."""
        contributing = np.unique(self._contributing_at(self._cells.cell_B), axis=0)
        return [matrix for panels in contributing if (matrix := self._matrix(panels)).any()]

    @cached_property
    def _free(self) -> np.ndarray:
        """Step (n_cell, 3) for each of `_cell_matrices` that leaves the readings of the cell unchanged; zeros if there is none."""
        tolerance = RANK_TOLERANCE * self.largest_power
        return np.array(
            [
                np.linalg.svd(matrix)[2][2]
                if np.linalg.matrix_rank(matrix, tolerance) == 2
                else np.zeros(3)
                for matrix in self._cell_matrices
            ]
        )

    def _all_candidates(self, target: np.ndarray) -> np.ndarray:
        """Return directions (n, n_candidate, 3) among which Delta is smallest, for unit readings (n, n_input).

        These are `_candidates`, and directions along the arcs on which the ratios of the readings do not change.
        """
        has_arc = self._free.any(axis=1)
        mapped = self._candidates.from_readings(target)
        # the first maps are those of the cells, in the order of `_free`
        middle = mapped[:, : len(self._free)][:, has_arc]
        along = [
            np.cos(angle) * middle + np.sin(angle) * self._free[has_arc] for angle in ARC_ANGLES_RAD
        ]
        fixed = np.broadcast_to(
            self._candidates.fixed, (len(target), *self._candidates.fixed.shape)
        )
        return np.concatenate([mapped, fixed, *along], axis=1)

    def near_best(self, readings: np.ndarray, slack: np.ndarray) -> np.ndarray:
        """Return the candidates that are local minima of Delta, in a cell or on its border, and within `slack` of the smallest.

        Along an arc of equally good directions several are returned.
        """
        target, (best, delta) = normalise_readings(readings), self.best_direction(readings)
        tried = np.concatenate([best[:, None], self._all_candidates(target)], axis=1)
        fits = misfit(self.power(tried), target[:, None]) <= (delta + slack)[:, None]
        sample, column = np.nonzero(fits & tried.any(axis=-1))  # zero vectors are no candidates
        sun, sun_target = tried[sample, column], target[sample]
        neighbours = [
            move_on_sphere(sun, np.tile(NEIGHBOUR_RAD * step, (len(sun), 1)))
            for step in NEIGHBOUR_STEPS
        ]
        lowest = np.min([misfit(self.power(each), sun_target) for each in neighbours], axis=0)
        kept = np.zeros(tried.shape[:2], dtype=bool)
        kept[sample, column] = misfit(self.power(sun), sun_target) <= lowest + DELTA_TOLERANCE
        kept[:, 0] = True  # the best
        return np.where(kept[..., None], tried, np.nan)

    def covariance(self, readings: np.ndarray, lit: np.ndarray, noise: np.ndarray) -> np.ndarray:
        sun, _ = self.best_direction(readings)
        design = self._matrix(self._contributing_at(sun)) * lit[:, None]
        power = self.power(sun) * lit
        # factor between readings and signals; 1e-300 replaces a sum of zero
        bright = (readings * power).sum(axis=1) / np.maximum((power**2).sum(axis=1), 1e-300)
        tangent = np.eye(3) - sun[:, :, None] * sun[:, None, :]
        covariance = np.full((len(sun), 3, 3), np.nan)
        normal = np.swapaxes(design, -1, -2) @ design
        solvable = (np.linalg.cond(normal) < RANK_TOLERANCE**-2) & (bright > 0)
        scaled = unweighted_covariance(design[solvable], noise) / bright[solvable, None, None] ** 2
        covariance[solvable] = tangent[solvable] @ scaled @ tangent[solvable]
        return covariance

    def _free_tangent(self, sun: np.ndarray, lit: np.ndarray) -> np.ndarray:
        """Return the tangent (3) at a direction (3) along which the ratios of the lit inputs' readings change least."""
        frame = np.stack(tangent_basis(sun[None]), axis=-1)[0]
        power, to_sun = (value[lit] for value in self.slopes(sun)[:2])
        change = to_sun @ frame
        # the part along the readings themselves changes only the brightness
        change = change - np.outer(power, power @ change) / (power @ power)
        return frame @ np.linalg.svd(change)[2][1]

    def arc(self, readings: np.ndarray, lit: np.ndarray) -> np.ndarray:
        target = normalise_readings(np.where(lit, readings, 0.0)[None])
        sun = self._all_candidates(target)[0]
        power = self.power(sun)
        matching = ((power > 0) == lit).all(axis=1)
        if not matching.any():
            return np.full((2, 3), np.nan)
        delta = np.where(matching, misfit(power, target), np.inf)
        # begin at the best direction that is farthest from all planes
        distance = np.abs(sun @ self._planes.T).min(axis=1)
        is_best = delta < delta.min() + DELTA_TOLERANCE
        begin = sun[np.argmax(np.where(is_best, distance, -1.0))]
        return np.array([self._follow_arc(begin, lit, sign) for sign in (1.0, -1.0)])

    def _follow_arc(self, begin: np.ndarray, lit: np.ndarray, sign: float) -> np.ndarray:
        """Return the end (3) of an arc of directions from `begin` (3) on, in which the readings of the inputs have the same ratios.

        It is a great circle from plane to plane. It ends where other inputs than `lit` have light, or after half a revolution. The
        `sign` (1 or -1) chooses the sense.
        """
        planes, sun = self._planes, begin
        along, remaining = sign * self._free_tangent(begin, lit), np.pi  # unit tangent, angle (rad)
        while True:
            # sun(a) = cos(a) sun + sin(a) along meets a plane where cos(a) height + sin(a) slope = 0
            height, slope = planes @ sun, planes @ along  # (n_plane)
            crossed = np.hypot(height, slope) > ON_PLANE  # excludes planes that contain the arc
            crossing = np.arctan2(-height, slope)[crossed] % np.pi
            step = min(float(crossing.min(initial=np.pi)), remaining)
            remaining -= step
            end, ahead = (
                np.cos(angle) * sun + np.sin(angle) * along for angle in (step, step + CROSSING_RAD)
            )
            if remaining <= CROSSING_RAD or not np.array_equal(self.power(ahead) > 0, lit):
                return end
            # in the next cell other panels contribute: a new great circle, in the same sense
            tangent = self._free_tangent(ahead, lit)
            along = tangent * np.copysign(
                1.0, tangent @ (np.cos(step) * along - np.sin(step) * sun)
            )
            sun = ahead

    @cached_property
    def symmetries(self) -> np.ndarray:
        """Rotations and mirrors (m, 3, 3) of the body that hardly change the readings, the identity first.

        They are products of mirrors that exchange two panels of one input.
        """
        mirrors = []
        for shared in self.inputs:
            for i, j in combinations(shared.panels, 2):
                across = self.normals_B[i] - self.normals_B[j]
                if (size := np.linalg.norm(across)) > 0:
                    mirrors.append(np.eye(3) - 2 * np.outer(across, across) / size**2)
        sun = sphere(SYMMETRY_DIRECTIONS)
        max_change = SYMMETRY_TOLERANCE * self.full_sun_readings.min()
        # multiply by mirrors until no new product is a symmetry
        images, new = [np.eye(3)], [np.eye(3)]
        while new and len(images) < MAX_SYMMETRIES:
            products, new = [mirror @ image for image in new for mirror in mirrors], []
            for image in products:
                # a matrix that is not known yet
                if all(np.abs(image - known).max() > 1e-6 for known in images + new):
                    change = np.abs(self.power(sun @ image.T) - self.power(sun)).max()
                    new += [image] if change < max_change else []
            images += new
        return np.array(images[:MAX_SYMMETRIES])
