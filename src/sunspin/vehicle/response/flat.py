"""Response of panels to light, each on an input of its own: gain times cosine of incidence (paper, eq. 1), in closed form.

Other packages use panels only through :class:`PanelResponse`. Directions `sun_B` (..., 3) are unit vectors in body axes B,
results are (..., n_panel). All functions are batched over leading axes; NaN gives NaN, and no signal is negative. A common
rotation of body and Sun changes nothing.

The misfit is Delta(n) = |P(n)/|P(n)| - M/|M|| for measurements M (paper, eq. 2). Minimising it means maximising the cosine
between P(n) and M. In a cell of the sphere, in which the same panels are lit, P(n) = B n is linear, and the best n is parallel
to pinv(B) M. On an arc between two cells the same holds in the plane of the arc; vertices are single directions. One of these
few candidates is the global minimum. All but the vertices are linear in M, so that many samples are computed at once and
without a search.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sunspin.solve.rotations import components_after_rotation
from sunspin.vehicle.response.planes import (
    ON_PLANE,
    Arrangement,
    DirectionSet,
    arrangement,
    minimal_clauses,
    plane_basis,
)

MAX_NUMBERS = 10_000_000
"""Trial directions times panels times samples in one batch: some 200 MB."""

RANK_TOLERANCE = 1e-6
"""A matrix of normals with a singular value below this is singular: the normals are in one plane or on one line."""


def unweighted_covariance(design: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Return the covariance (..., k, k) of unweighted least squares with `design` (..., m, k) and data errors `sigma` (m).

    For A the design and V the diagonal of sigma^2 it is inv(A'A) A'VA inv(A'A). It is split into the covariance for the smallest
    sigma and the excess of the other errors, which is exactly zero for equal errors.
    """
    transposed, least = np.swapaxes(design, -1, -2), np.min(sigma)
    inverse = np.linalg.inv(transposed @ design)
    excess = inverse @ transposed * np.sqrt(sigma**2 - least**2)
    return least**2 * inverse + excess @ np.swapaxes(excess, -1, -2)


class Slopes(NamedTuple):
    """Signals `power` (..., n_panel) and their derivatives (..., n_panel, 3).

    `to_sun`: by the Sun direction, tangential to the sphere. `to_tilt`: by a rotation of each panel (rad, B), None unless tilts
    were given. At the edge of the lit side they are those of the lit side.
    """

    power: np.ndarray
    to_sun: np.ndarray
    to_tilt: np.ndarray | None


class Regions(NamedTuple):
    """Cells of the sphere in which the same panels are lit: a direction inside each (n, 3), and its `lit` panels (n, n_panel)."""

    sun_B: np.ndarray
    lit: np.ndarray


def misfit(signal: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return Delta (...) between signals (..., n_panel) of any brightness and unit vectors `target` (..., n_panel).

    Signals that are all zero have the largest possible misfit, 2.
    """
    length = np.linalg.norm(signal, axis=-1, keepdims=True)
    unit = signal / np.where(length > 0, length, 1.0)
    return np.where(length[..., 0] > 0, np.linalg.norm(unit - target, axis=-1), 2.0)


def normalise_readings(readings: np.ndarray) -> np.ndarray:
    """Return readings (n, n_panel) divided by their length; zeros stay zero."""
    length = np.linalg.norm(readings, axis=1)
    return readings / np.where(length > 0, length, 1.0)[:, None]


def components_along_normals(vector_B: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return the components (..., n_panel) of vectors (..., 3) along panel normals.

    The normals are (n_panel, 3), or (..., n_panel, 3) if they differ between vectors.
    """
    if normals.ndim == 2:
        return vector_B @ normals.T
    if normals.shape[-3] == 1:  # the same normals for many directions
        return vector_B @ np.swapaxes(normals[..., 0, :, :], -1, -2)
    return np.einsum("...i,...pi->...p", vector_B, normals)


class TrialDirections(NamedTuple):
    """Directions among which the smallest Delta is found.

    `maps` (n_map, 3, n_panel) convert readings to directions; `fixed` (n, 3) do not depend on the readings.
    """

    maps: np.ndarray
    fixed: np.ndarray

    @classmethod
    def from_cells(
        cls,
        within: Iterable[np.ndarray],
        between: Iterable[tuple[np.ndarray, np.ndarray]],
        fixed: np.ndarray,
    ) -> TrialDirections:
        """Return the candidates of cells, arcs and fixed directions.

        `within`: a matrix (n_panel, 3) for each cell, by which the signal is linear in the direction. `between`: for each arc
        such a matrix, and the normal (3) of the plane of the arc.
        """
        maps = [np.linalg.pinv(rows) for rows in within]
        for rows, normal in between:
            basis = plane_basis(normal)
            maps.append(basis @ np.linalg.pinv(rows @ basis))
        return cls(np.array(maps), fixed)

    def from_readings(self, target: np.ndarray) -> np.ndarray:
        """Return the candidates (n, n_map, 3) of `maps` for readings `target` (n, n_panel), zero for dark samples."""
        candidates = np.einsum("mik,nk->nmi", self.maps, target)
        length = np.linalg.norm(candidates, axis=2, keepdims=True)
        return candidates / np.where(length > 0, length, 1.0)

    def best_direction(
        self, power: Callable[[np.ndarray], np.ndarray], readings: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the candidates (n, 3) with the smallest Delta, and that Delta (n).

        `power` gives signals (..., n_panel) for directions; `readings` are (n, n_panel).
        """
        fixed, fixed_signal = self.fixed, power(self.fixed)
        direction, delta = np.zeros((len(readings), 3)), np.full(len(readings), 2.0)
        # as many readings at a time as memory allows
        chunk = max(1, MAX_NUMBERS // ((len(self.maps) + len(fixed)) * readings.shape[1]))
        for start in range(0, len(readings), chunk):
            rows = slice(start, start + chunk)
            target = normalise_readings(readings[rows])
            candidates = self.from_readings(target)
            deltas = misfit(power(candidates), target[:, None, :])
            deltas_fixed = misfit(
                np.broadcast_to(fixed_signal, (len(target), *fixed_signal.shape)),
                target[:, None, :],
            )
            best, best_fixed = np.argmin(deltas, axis=1), np.argmin(deltas_fixed, axis=1)
            smallest, smallest_fixed = np.min(deltas, axis=1), np.min(deltas_fixed, axis=1)
            # a fixed direction must be clearly better, so that rounding does not decide between equal ones
            use_fixed = smallest_fixed < smallest - 1e-14
            mapped = candidates[np.arange(len(target)), best]
            direction[rows] = np.where(use_fixed[:, None], fixed[best_fixed], mapped)
            delta[rows] = np.minimum(smallest_fixed, smallest)
        return direction, delta


@dataclass(frozen=True, eq=False)
class PanelResponse:
    """Response of panels with normals (n_panel, 3) and gains (n_panel): signal = ``gain * max(0, normal . sun)``."""

    normals_B: np.ndarray
    gains: np.ndarray

    @property
    def facing_B(self) -> np.ndarray:
        """Direction (n_panel, 3) of the Sun for which each panel has its largest signal."""
        return self.normals_B

    @cached_property
    def _rows(self) -> np.ndarray:
        """Gain times normal (n_panel, 3): in a cell the signals of lit panels are these rows times the direction."""
        return self.gains[:, None] * self.normals_B

    @property
    def largest_power(self) -> float:
        """Largest component of gain times normal, a scale for signals."""
        return np.abs(self._rows).max()

    def _turned(self, tilt: np.ndarray | None) -> np.ndarray:
        """Return the normals (n_panel, 3), or rotated by vectors `tilt` (..., n_panel, 3) in rad normals of that shape."""
        if tilt is None:
            return self.normals_B
        return components_after_rotation(self.normals_B, -np.asarray(tilt, dtype=np.float64))

    def _strengths(self, gain: np.ndarray | None) -> np.ndarray:
        """Return the gains (n_panel), multiplied by factors `gain` (..., n_panel) if given."""
        return self.gains if gain is None else self.gains * gain

    def power(
        self, sun_B: np.ndarray, *, gain: np.ndarray | None = None, tilt: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the signal of each panel (..., n_panel).

        `gain` (..., n_panel): factors on the gains. `tilt` (..., n_panel, 3): rotation vectors of the panels, rad in B.
        """
        cosine = components_along_normals(sun_B, self._turned(tilt))
        return self._strengths(gain) * np.maximum(0.0, cosine)

    def slopes(
        self, sun_B: np.ndarray, *, gain: np.ndarray | None = None, tilt: np.ndarray | None = None
    ) -> Slopes:
        """Return the signals of :meth:`power` with their derivatives."""
        normals, strength = self._turned(tilt), self._strengths(gain)
        cosine = components_along_normals(sun_B, normals)
        sun = sun_B[..., None, :]
        lit = (strength * (cosine >= 0))[..., None]
        to_sun = lit * (normals - cosine[..., None] * sun)
        to_tilt = None if tilt is None else lit * np.cross(normals, sun)
        return Slopes(strength * np.maximum(0.0, cosine), to_sun, to_tilt)

    def power_changes(
        self,
        sun_B: np.ndarray,
        steps: Sequence[np.ndarray],
        *,
        gain: np.ndarray | None = None,
        tilt: np.ndarray | None = None,
    ) -> list[np.ndarray]:
        """Return the derivatives of the signals, each (..., n_panel), along `steps` (..., 3) of the Sun vector.

        Panels without signal have the derivative zero.
        """
        normals, strength = self._turned(tilt), self._strengths(gain)
        lit = components_along_normals(sun_B, normals) > 0
        return [
            strength * np.where(lit, components_along_normals(step, normals), 0.0) for step in steps
        ]

    def light_power(self, light_B: np.ndarray, unit: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Return signals (..., n_panel) under a light vector, direction times brightness, and their derivative by this vector.

        `unit` divides both. The derivative, (..., n_panel, 3) or (n_panel, 3), holds only where the signal is not zero.
        """
        rows = self._rows / unit
        return np.maximum(0.0, light_B @ rows.T), rows

    def earthlight(self, axis_B: np.ndarray, strength: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return signals (..., n_panel) under the Earth, and their derivative (..., n_panel, 3) by the vector strength times axis.

        `axis_B` (..., 3) is the direction of the Earth, `strength` (...) the signal of a panel with gain 1 that faces it. A
        panel at an angle a to the Earth gets ((1 + cos a) / 2)^2 of it, equation (earthlight) of docs/model.md. To 0.05 of the
        maximum this is the light of a uniform disk of 66 degrees' radius, the Earth seen from 550 km.
        """
        share = (1 + axis_B @ self.normals_B.T) / 2
        axis = axis_B[..., None, :]
        slope = share[..., None] * (axis + self.normals_B) - share[..., None] ** 2 * axis
        return self.gains * share**2 * np.asarray(strength)[..., None], self.gains[:, None] * slope

    def bounds(self, sun_B: np.ndarray, angle: float) -> tuple[np.ndarray, np.ndarray]:
        """Return bounds of the smallest and the largest signal for any Sun within `angle` (rad) of `sun_B`."""
        incidence = np.arccos(np.clip(sun_B @ self.normals_B.T, -1.0, 1.0))
        low = self.gains * np.maximum(np.cos(np.minimum(incidence + angle, np.pi)), 0.0)
        return low, self.gains * np.maximum(np.cos(np.maximum(incidence - angle, 0.0)), 0.0)

    @property
    def _planes(self) -> np.ndarray:
        """Unit normals (n, 3) of the planes that separate cells."""
        return self.normals_B

    @cached_property
    def _cells(self) -> Arrangement:
        """Cells, arcs and vertices into which the planes cut the sphere."""
        return arrangement(tuple(map(tuple, self._planes.tolist())))

    def regions(self) -> Regions:
        """Return the sets of panels that can be lit together, and a direction for each."""
        return Regions(self._cells.cell_B, self._cells.cell_lit)

    def edges(self) -> np.ndarray:
        """Return the lit panels (m, n_panel) in directions between cells.

        A panel at grazing incidence may read as dark, so that these sets occur in telemetry.
        """
        return np.concatenate(
            [self._cells.arc_lit, self._cells.vertex_B @ self.normals_B.T > ON_PLANE]
        )

    @cached_property
    def _candidates(self) -> TrialDirections:
        """Candidates for the direction with the smallest Delta: of each cell, arc and vertex; dark cells and arcs have none."""
        cells, rows = self._cells, self._rows
        cell_maps = [rows * lit[:, None] for lit in cells.cell_lit if lit.any()]
        arc_maps_and_normals = [
            (rows * lit[:, None], self.normals_B[k])
            for lit, k in zip(cells.arc_lit, cells.arc_plane, strict=True)
            if lit.any()
        ]
        return TrialDirections.from_cells(
            # inside a cell with fewer than three lit panels many directions fit equally well: its `cell_B` is one of them
            cell_maps,
            arc_maps_and_normals,
            np.concatenate([cells.vertex_B, cells.cell_B]),
        )

    def best_direction(self, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the directions (n, 3) of the global minimum of Delta (paper, eq. 2), and Delta (n), for readings (n, n_panel)."""
        return self._candidates.best_direction(self.power, readings)

    def near_best(self, readings: np.ndarray, slack: np.ndarray) -> np.ndarray:
        """Return local minima of Delta that exceed the smallest by at most `slack` (n): directions (n, k, 3), NaN if absent.

        The best comes first. For panels with an input each it is the only one, as no two directions fit equally well.
        """
        return self.best_direction(readings)[0][:, None]

    @property
    def symmetries(self) -> np.ndarray:
        """Rotations and mirrors (m, 3, 3) of the body that hardly change the readings, the identity first.

        Panels with an input each have only the identity.
        """
        return np.eye(3)[None]

    def rank(self, lit: np.ndarray, sun_B: np.ndarray | None = None) -> int:
        """Return how many of three quantities (direction and brightness) readings of the panels `lit` (n_panel) determine.

        By default for a direction in which exactly these panels are lit, otherwise at `sun_B` (3). For panels with an input each
        the direction makes no difference.
        """
        values = np.linalg.svd(self.normals_B[lit], compute_uv=False) if lit.any() else np.zeros(0)
        return int(np.count_nonzero(values > RANK_TOLERANCE))

    def covariance(self, readings: np.ndarray, lit: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Return the covariance (n, 3, 3) of unit Sun directions that least squares gives from readings (n, n_panel).

        `lit` (n_panel, bool): the panels used, the same for all rows. `noise` (n_panel): standard deviation of each reading. The
        covariance is zero along the direction itself.
        """
        design = self._rows * lit[:, None]
        light = readings @ np.linalg.pinv(design).T  # direction times brightness
        length = np.linalg.norm(light, axis=1)
        direction = light / length[:, None]
        # the error of a unit vector is the tangential part of that of `light`, divided by its length
        tangent = np.eye(3) - direction[:, :, None] * direction[:, None, :]
        scaled = unweighted_covariance(design, noise) / length[:, None, None] ** 2
        return tangent @ scaled @ tangent

    def arc(self, readings: np.ndarray, lit: np.ndarray) -> np.ndarray:
        """Return the ends (2, 3) of the arc of directions that fit readings of the panels `lit` (n_panel); NaN if there is none.

        The lit panels must have rank 2. Dark panels limit the arc: the Sun must be behind them.
        """
        design = self._rows[lit]
        middle = np.linalg.pinv(design) @ readings[lit]
        middle /= np.linalg.norm(middle)
        free = np.linalg.svd(design)[2][
            2
        ]  # unit vector at right angles to the normals of the lit panels
        # directions n(a) = cos(a) middle + sin(a) free have the same ratios of readings
        low, high = -np.pi / 2, np.pi / 2
        for normal in self.normals_B[~lit]:
            at_middle, at_free = normal @ middle, normal @ free
            # the panel is dark where cos(a) at_middle + sin(a) at_free <= 0: on one side of its only zero in (low, high)
            if at_free > RANK_TOLERANCE:
                high = min(high, np.arctan2(-at_middle, at_free))
            elif at_free < -RANK_TOLERANCE:
                low = max(low, np.arctan2(at_middle, -at_free))
        if low > high:
            return np.full((2, 3), np.nan)
        return np.array([np.cos(angle) * middle + np.sin(angle) * free for angle in (low, high)])

    def direction_set(self, good: np.ndarray, bad: np.ndarray) -> DirectionSet:
        """Return the set of directions in which the lit panels are one of the patterns `good` (m, n_panel).

        `bad` (m, n_panel) are all other patterns that occur.
        """
        return DirectionSet(self.normals_B, minimal_clauses(good, bad))
