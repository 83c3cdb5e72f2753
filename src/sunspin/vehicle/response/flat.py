"""How panels see light, each on an input of its own: gain times cosine (paper, eq. 1), in closed form.

The rest of the package asks a :class:`PanelResponse` and nothing else about it. Directions `sun_B` (..., 3) are unit vectors in
body axes, results (..., n_panel); all is batched over leading axes, NaN gives NaN and no power is negative. If body and Sun turn
together nothing changes.

The misfit is Delta(n) = |P(n)/|P(n)| - M/|M|| (paper, eq. 2). Minimising it is maximising the cosine between P(n) and M.
Inside a cell of the sphere, where the same panels are lit, P is linear in n and the best n is parallel to pinv(B) M, B being
the lit rows; on an arc between two cells likewise in the arc's plane; vertices are points. The global minimum is among these
few candidates, each linear in M, so it is found without a search and for many samples at once.
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
"""Candidates times panels times samples solved at once: some 200 MB."""

RANK_TOLERANCE = 1e-6
"""Normals whose smallest singular value is below this lie in one plane (or on one line)."""


def unweighted_covariance(design: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Covariance (..., k, k) of unweighted least squares with a `design` (..., m, k), of data with errors `sigma` (m)."""
    turned, least = np.swapaxes(design, -1, -2), np.min(sigma)
    inverse = np.linalg.inv(turned @ design)
    more = inverse @ turned * np.sqrt(sigma**2 - least**2)  # none if all err alike
    return least**2 * inverse + more @ np.swapaxes(more, -1, -2)


class Slopes(NamedTuple):
    """`power` (..., n_panel), and its derivatives (..., n_panel, 3): `to_sun`, along the sphere; `to_tilt`, by a turn (rad, B) of
    each panel, None unless turns were given. At an edge those of the lit side."""

    power: np.ndarray
    to_sun: np.ndarray
    to_tilt: np.ndarray | None


class Regions(NamedTuple):
    """Open regions of the sphere in which the same panels are lit: one direction inside each (n, 3), and `lit` (n, n_panel)."""

    sun_B: np.ndarray
    lit: np.ndarray


def misfit(shape: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Delta (...) between signals (..., n_panel) of any brightness and unit vectors `target` (..., n_panel); 2 in the dark."""
    size = np.linalg.norm(shape, axis=-1, keepdims=True)
    unit = shape / np.where(size > 0, size, 1.0)
    return np.where(size[..., 0] > 0, np.linalg.norm(unit - target, axis=-1), 2.0)


def normalise_readings(readings: np.ndarray) -> np.ndarray:
    """Readings (n, n_panel) as unit vectors; zeros stay."""
    size = np.linalg.norm(readings, axis=1)
    return readings / np.where(size > 0, size, 1.0)[:, None]


def components_along_normals(vector_B: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Components (..., n_panel) of vectors (..., 3) along normals (..., n_panel, 3), or those (n_panel, 3) of all."""
    if normals.ndim == 2:
        return vector_B @ normals.T
    if normals.shape[-3] == 1:  # alike for many directions
        return vector_B @ np.swapaxes(normals[..., 0, :, :], -1, -2)
    return np.einsum("...i,...pi->...p", vector_B, normals)


class Candidates(NamedTuple):
    """Where the least Delta of flat panels may lie: `maps` (n_map, 3, n_panel) turn readings into directions, `fixed` (n, 3) are
    directions."""

    maps: np.ndarray
    fixed: np.ndarray

    @classmethod
    def from_cells(
        cls,
        within: Iterable[np.ndarray],
        between: Iterable[tuple[np.ndarray, np.ndarray]],
        fixed: np.ndarray,
    ) -> Candidates:
        """Those of cells in which power is a matrix (n_panel, 3) times the direction, and of arcs, each a matrix and the normal (3)
        of its plane."""
        maps = [np.linalg.pinv(rows) for rows in within]
        for rows, normal in between:
            basis = plane_basis(normal)
            maps.append(basis @ np.linalg.pinv(rows @ basis))
        return cls(np.array(maps), fixed)

    def from_readings(self, target: np.ndarray) -> np.ndarray:
        """The candidates (n, n_map, 3) that depend on the readings."""
        candidates = np.einsum("mik,nk->nmi", self.maps, target)
        length = np.linalg.norm(candidates, axis=2, keepdims=True)
        return candidates / np.where(length > 0, length, 1.0)

    def best_direction(
        self, power: Callable[[np.ndarray], np.ndarray], readings: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The direction (n, 3) with the least Delta (n) between `power` and readings (n, n_panel)."""
        fixed, fixed_shape = self.fixed, power(self.fixed)
        direction, delta = np.zeros((len(readings), 3)), np.full(len(readings), 2.0)
        chunk = max(1, MAX_NUMBERS // ((len(self.maps) + len(fixed)) * readings.shape[1]))
        for start in range(0, len(readings), chunk):
            rows = slice(start, start + chunk)
            target = normalise_readings(readings[rows])
            candidates = self.from_readings(target)
            away = misfit(power(candidates), target[:, None, :])
            away_fixed = misfit(
                np.broadcast_to(fixed_shape, (len(target), *fixed_shape.shape)), target[:, None, :]
            )
            best, best_fixed = np.argmin(away, axis=1), np.argmin(away_fixed, axis=1)
            each = np.arange(len(target))
            use_fixed = away_fixed[each, best_fixed] < away[each, best] - 1e-14
            direction[rows] = np.where(
                use_fixed[:, None], fixed[best_fixed], candidates[each, best]
            )
            delta[rows] = np.minimum(away_fixed[each, best_fixed], away[each, best])
        return direction, delta


@dataclass(frozen=True, eq=False)
class PanelResponse:
    """How the panels of a vehicle see light, by their normals (n_panel, 3) and gains (n_panel): ``gain * max(0, normal . sun)``."""

    normals_B: np.ndarray
    gains: np.ndarray

    @property
    def facing_B(self) -> np.ndarray:
        """The direction (n_panel, 3) in which each panel gets most."""
        return self.normals_B

    @cached_property
    def _rows(self) -> np.ndarray:
        """Gain times normal (n_panel, 3): in a region power is linear in the direction."""
        return self.gains[:, None] * self.normals_B

    @property
    def largest_power(self) -> float:
        """A number of the size of the largest power."""
        return np.abs(self._rows).max()

    def _turned(self, tilt: np.ndarray | None) -> np.ndarray:
        """Normals (n_panel, 3), or turned by rotation vectors `tilt` (..., n_panel, 3) normals of that shape."""
        if tilt is None:
            return self.normals_B
        return components_after_rotation(self.normals_B, -np.asarray(tilt, dtype=np.float64))

    def _strengths(self, gain: np.ndarray | None) -> np.ndarray:
        return self.gains if gain is None else self.gains * gain

    def power(
        self, sun_B: np.ndarray, *, gain: np.ndarray | None = None, tilt: np.ndarray | None = None
    ) -> np.ndarray:
        """Signal of each panel; with factors `gain` (..., n_panel) on its gain, or turned by `tilt` (..., n_panel, 3) rad in B."""
        cosine = components_along_normals(sun_B, self._turned(tilt))
        return self._strengths(gain) * np.maximum(0.0, cosine)

    def slopes(
        self, sun_B: np.ndarray, *, gain: np.ndarray | None = None, tilt: np.ndarray | None = None
    ) -> Slopes:
        """The same with its derivatives."""
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
        """How powers change (each (..., n_panel)) with the Sun along each of `steps` (..., 3): not at all where they are zero."""
        normals, strength = self._turned(tilt), self._strengths(gain)
        lit = components_along_normals(sun_B, normals) > 0
        return [
            strength * np.where(lit, components_along_normals(step, normals), 0.0) for step in steps
        ]

    def light_power(self, light_B: np.ndarray, unit: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Signals (..., n_panel), in `unit`s, under a light `light_B` (..., 3), direction times brightness, and their derivative by
        it, which (..., n_panel, 3) or (n_panel, 3) holds where the signal is not zero."""
        rows = self._rows / unit
        return np.maximum(0.0, light_B @ rows.T), rows

    def earthlight(self, axis_B: np.ndarray, strength: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signals (..., n_panel) under the Earth about `axis_B`, `strength` (...) being what a panel of gain 1 gets that looks
        there; and their derivative (..., n_panel, 3) by the vector strength times axis.

        The Earth fills a disk of 66 degrees' radius seen from 550 km: on a panel turned away by an angle a its light falls as
        ((1 + cos a) / 2)^2, to 0.05 of what it is at most."""
        share = (1 + axis_B @ self.normals_B.T) / 2
        axis = axis_B[..., None, :]
        slope = share[..., None] * (axis + self.normals_B) - share[..., None] ** 2 * axis
        return self.gains * share**2 * np.asarray(strength)[..., None], self.gains[:, None] * slope

    def bounds(self, sun_B: np.ndarray, angle: float) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest signal for any Sun within `angle` rad, or a little beyond."""
        off = np.arccos(np.clip(sun_B @ self.normals_B.T, -1.0, 1.0))
        low = self.gains * np.maximum(np.cos(np.minimum(off + angle, np.pi)), 0.0)
        return low, self.gains * np.maximum(np.cos(np.maximum(off - angle, 0.0)), 0.0)

    @property
    def _planes(self) -> np.ndarray:
        """Unit normals (n, 3) of the planes that part the regions."""
        return self.normals_B

    @cached_property
    def _cells(self) -> Arrangement:
        return arrangement(tuple(map(tuple, self._planes.tolist())))

    def regions(self) -> Regions:
        """Which panels can be lit together, and where."""
        return Regions(self._cells.cell_B, self._cells.cell_lit)

    def edges(self) -> np.ndarray:
        """What is lit (m, n_panel) in directions between regions, where a panel that the Sun grazes may read as dark."""
        return np.concatenate(
            [self._cells.arc_lit, self._cells.vertex_B @ self.normals_B.T > ON_PLANE]
        )

    @cached_property
    def _candidates(self) -> Candidates:
        cells, rows = self._cells, self._rows
        within = [rows * lit[:, None] for lit in cells.cell_lit if lit.any()]
        between = [
            (rows * lit[:, None], self.normals_B[k])
            for lit, k in zip(cells.arc_lit, cells.arc_plane, strict=True)
            if lit.any()
        ]
        return Candidates.from_cells(
            within, between, np.concatenate([cells.vertex_B, cells.cell_B])
        )

    def best_direction(self, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The direction (n, 3) with the smallest Delta (n) (paper, eq. 2) for readings (n, n_panel): the global minimum."""
        return self._candidates.best_direction(self.power, readings)

    def near_best(self, readings: np.ndarray, slack: np.ndarray) -> np.ndarray:
        """Directions (n, k, 3), the best first, with a Delta that exceeds the smallest by no more than `slack` (n); else NaN. Of
        panels that share no input the best alone: no two fit alike."""
        return self.best_direction(readings)[0][:, None]

    @property
    def symmetries(self) -> np.ndarray:
        """Mirrors and turns (m, 3, 3) of the body that change readings little or not at all, the first of them none at all."""
        return np.eye(3)[None]

    def rank(self, lit: np.ndarray, sun_B: np.ndarray | None = None) -> int:
        """How many numbers of three, direction and brightness, panels `lit` (n_panel) tell there, by default where they are lit."""
        values = np.linalg.svd(self.normals_B[lit], compute_uv=False) if lit.any() else np.zeros(0)
        return int(np.count_nonzero(values > RANK_TOLERANCE))

    def covariance(self, readings: np.ndarray, lit: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Tangent covariance (n, 3, 3) of directions told by readings (n, n_panel), of which `lit` (n_panel) count."""
        design = self._rows * lit[:, None]
        x = readings @ np.linalg.pinv(design).T
        length = np.linalg.norm(x, axis=1)
        n = x / length[:, None]
        tangent = np.eye(3) - n[:, :, None] * n[:, None, :]
        scaled = unweighted_covariance(design, noise) / length[:, None, None] ** 2
        return tangent @ scaled @ tangent

    def arc(self, readings: np.ndarray, lit: np.ndarray) -> np.ndarray:
        """Ends (2, 3) of the arc of directions that panels `lit` (n_panel), of rank 2, with readings (n_panel) leave; else NaN."""
        design = self._rows[lit]
        middle = np.linalg.pinv(design) @ readings[lit]
        middle /= np.linalg.norm(middle)
        free = np.linalg.svd(design)[2][2]
        low, high = -np.pi / 2, np.pi / 2  # n(a) = cos(a) middle + sin(a) free
        for normal in self.normals_B[~lit]:
            a, b = normal @ middle, normal @ free
            if abs(b) > RANK_TOLERANCE:
                crossing = np.arctan2(-a, b) if b > 0 else np.arctan2(a, -b)
                low, high = (low, min(high, crossing)) if b > 0 else (max(low, crossing), high)
        if low > high:
            return np.full((2, 3), np.nan)
        return np.array([np.cos(angle) * middle + np.sin(angle) * free for angle in (low, high)])

    def direction_set(self, good: np.ndarray, bad: np.ndarray) -> DirectionSet:
        """The directions in which one of the sets of panels `good` (m, n_panel) is lit and none of `bad`, all of them shown."""
        return DirectionSet(self.normals_B, minimal_clauses(good, bad))
