"""Gain times cosine (paper, eq. 1), in closed form.

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

from sunspin.solve.linear import plain_covariance
from sunspin.solve.rotations import moved, seen_turned
from sunspin.vehicle.response.planes import ON_PLANE, Arrangement, arrangement, formula, plane_basis
from sunspin.vehicle.response.protocol import (
    BLUR_NODES,
    BLUR_WEIGHTS,
    Counted,
    Regions,
    Slopes,
    misfit,
    unit_readings,
)

NUMBERS = 10_000_000
"""Candidates times panels times samples solved at once: some 200 MB."""

RANK_TOLERANCE = 1e-6
"""Normals whose smallest singular value is below this lie in one plane (or on one line)."""


def blurred(power, sun_B: np.ndarray, blur_rad: float) -> np.ndarray:
    """The mean of a function `power` over directions that err by `blur_rad`, one sigma to each side."""
    flat = sun_B.reshape(-1, 3)
    each = [
        moved(flat, np.broadcast_to(blur_rad * node, (len(flat), 2))).reshape(sun_B.shape)
        for node in BLUR_NODES
    ]
    return np.einsum("m,m...->...", BLUR_WEIGHTS, np.stack([power(sun) for sun in each]))


def along_normals(vector_B: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Components (..., n_panel) of vectors (..., 3) along normals (..., n_panel, 3), or those (n_panel, 3) of all."""
    if normals.ndim == 2:
        return vector_B @ normals.T
    if normals.shape[-3] == 1:  # alike for many directions
        return vector_B @ np.swapaxes(normals[..., 0, :, :], -1, -2)
    return np.einsum("...i,...pi->...p", vector_B, normals)


class Places(NamedTuple):
    """Where the least Delta of flat panels may lie: `maps` (n_map, 3, n_panel) turn readings into directions, `fixed` (n, 3) are
    directions."""

    maps: np.ndarray
    fixed: np.ndarray

    def mapped(self, target: np.ndarray) -> np.ndarray:
        """The candidates (n, n_map, 3) that depend on the readings."""
        candidates = np.einsum("mik,nk->nmi", self.maps, target)
        length = np.linalg.norm(candidates, axis=2, keepdims=True)
        return candidates / np.where(length > 0, length, 1.0)

    def candidates(self, readings: np.ndarray) -> np.ndarray:
        """All of them (n, n_candidate, 3)."""
        fixed = np.broadcast_to(self.fixed, (len(readings), *self.fixed.shape))
        return np.concatenate([self.mapped(unit_readings(readings)), fixed], axis=1)

    def best(
        self, power: Callable[[np.ndarray], np.ndarray], readings: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The direction (n, 3) with the least Delta (n) between `power` and readings (n, n_panel)."""
        fixed, fixed_shape = self.fixed, power(self.fixed)
        direction, delta = np.zeros((len(readings), 3)), np.full(len(readings), 2.0)
        chunk = max(1, NUMBERS // ((len(self.maps) + len(fixed)) * readings.shape[1]))
        for start in range(0, len(readings), chunk):
            part = slice(start, start + chunk)
            target = unit_readings(readings[part])
            candidates = self.mapped(target)
            away = misfit(power(candidates), target[:, None, :])
            away_fixed = misfit(
                np.broadcast_to(fixed_shape, (len(target), *fixed_shape.shape)), target[:, None, :]
            )
            best, best_fixed = np.argmin(away, axis=1), np.argmin(away_fixed, axis=1)
            each = np.arange(len(target))
            use_fixed = away_fixed[each, best_fixed] < away[each, best] - 1e-14
            direction[part] = np.where(
                use_fixed[:, None], fixed[best_fixed], candidates[each, best]
            )
            delta[part] = np.minimum(away_fixed[each, best_fixed], away[each, best])
        return direction, delta


def places_of(
    within: Iterable[np.ndarray],
    between: Iterable[tuple[np.ndarray, np.ndarray]],
    fixed: np.ndarray,
) -> Places:
    """The candidates of cells in which power is a matrix (n_panel, 3) times the direction, and of arcs, each a matrix and the
    normal (3) of its plane."""
    maps = [np.linalg.pinv(rows) for rows in within]
    for rows, normal in between:
        basis = plane_basis(normal)
        maps.append(basis @ np.linalg.pinv(rows @ basis))
    return Places(np.array(maps), fixed)


@dataclass(frozen=True, eq=False)
class Flat:
    """Panels by their normals (n_panel, 3) and gains (n_panel): what is the same whether or not they share inputs."""

    normals_B: np.ndarray
    gains: np.ndarray

    def cosines(self, sun_B: np.ndarray, tilt: np.ndarray | None) -> np.ndarray:
        """Of the angles (..., n_panel) between the Sun and normals turned by `tilt`."""
        return along_normals(sun_B, self.turned(tilt))

    def turned(self, tilt: np.ndarray | None) -> np.ndarray:
        """Normals (..., n_panel, 3) turned by rotation vectors of that shape."""
        return (
            self.normals_B
            if tilt is None
            else seen_turned(self.normals_B, -np.asarray(tilt, dtype=np.float64))
        )

    def strengths(self, gain: np.ndarray | None) -> np.ndarray:
        """Gains (..., n_panel) with their factors."""
        return self.gains if gain is None else self.gains * gain

    def power(
        self,
        sun_B: np.ndarray,
        *,
        gain: np.ndarray | None = None,
        tilt: np.ndarray | None = None,
        blur_rad: float = 0.0,
    ) -> np.ndarray:
        if blur_rad:
            return blurred(lambda sun: self._power(sun, gain, tilt), sun_B, blur_rad)
        return self._power(sun_B, gain, tilt)

    def _power(
        self, sun_B: np.ndarray, gain: np.ndarray | None, tilt: np.ndarray | None
    ) -> np.ndarray:
        """The signals under a Sun whose direction does not err."""
        raise NotImplementedError

    def disc(self, axis_B: np.ndarray, strength: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The Earth fills a disk of 66 degrees' radius seen from 550 km: on a panel turned away by an angle a its light falls as
        ((1 + cos a) / 2)^2, to 0.05 of what it is at most."""
        part = (1 + axis_B @ self.normals_B.T) / 2
        axis = axis_B[..., None, :]
        slope = part[..., None] * (axis + self.normals_B) - part[..., None] ** 2 * axis
        return self.gains * part**2 * np.asarray(strength)[..., None], self.gains[:, None] * slope

    def bounds(self, sun_B: np.ndarray, angle: float) -> tuple[np.ndarray, np.ndarray]:
        off = np.arccos(np.clip(sun_B @ self.normals_B.T, -1.0, 1.0))
        low = self.gains * np.maximum(np.cos(np.minimum(off + angle, np.pi)), 0.0)
        return low, self.gains * np.maximum(np.cos(np.maximum(off - angle, 0.0)), 0.0)

    @cached_property
    def _places(self) -> Places:
        """Where the least Delta may lie."""
        raise NotImplementedError

    def candidates(self, share: np.ndarray) -> np.ndarray:
        return self._places.candidates(share)

    def best(self, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self._places.best(self.power, readings)


class Cosine(Flat):
    """``gain * max(0, normal . sun)``. Names and shapes as in :class:`sunspin.vehicle.response.protocol.PanelResponse`."""

    @property
    def facing_B(self) -> np.ndarray:
        return self.normals_B

    @cached_property
    def _rows(self) -> np.ndarray:
        """Gain times normal (n_panel, 3): in a region power is linear in the direction."""
        return self.gains[:, None] * self.normals_B

    @property
    def largest(self) -> float:
        return np.abs(self._rows).max()

    def _power(
        self, sun_B: np.ndarray, gain: np.ndarray | None, tilt: np.ndarray | None
    ) -> np.ndarray:
        return self.strengths(gain) * np.maximum(0.0, self.cosines(sun_B, tilt))

    def slopes(
        self, sun_B: np.ndarray, *, gain: np.ndarray | None = None, tilt: np.ndarray | None = None
    ) -> Slopes:
        normals, strength = self.turned(tilt), self.strengths(gain)
        cosine = along_normals(sun_B, normals)
        sun = sun_B[..., None, :]
        lit = (strength * (cosine >= 0))[..., None]
        to_sun = lit * (normals - cosine[..., None] * sun)
        to_tilt = None if tilt is None else lit * np.cross(normals, sun)
        return Slopes(strength * np.maximum(0.0, cosine), to_sun, to_tilt)

    def along(
        self,
        sun_B: np.ndarray,
        steps: Sequence[np.ndarray],
        *,
        gain: np.ndarray | None = None,
        tilt: np.ndarray | None = None,
    ) -> list[np.ndarray]:
        normals, strength = self.turned(tilt), self.strengths(gain)
        lit = along_normals(sun_B, normals) > 0
        return [strength * np.where(lit, along_normals(step, normals), 0.0) for step in steps]

    def under(self, light_B: np.ndarray, unit: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        rows = self._rows / unit
        return np.maximum(0.0, light_B @ rows.T), rows

    @cached_property
    def _cells(self) -> Arrangement:
        return arrangement(tuple(map(tuple, self.normals_B.tolist())))

    def regions(self) -> Regions:
        return Regions(self._cells.cell_B, self._cells.cell_lit)

    def edges(self) -> np.ndarray:
        return np.concatenate(
            [self._cells.arc_lit, self._cells.vertex_B @ self.normals_B.T > ON_PLANE]
        )

    @cached_property
    def _places(self) -> Places:
        cells, rows = self._cells, self._rows
        within = [rows * lit[:, None] for lit in cells.cell_lit if lit.any()]
        between = [
            (rows * lit[:, None], self.normals_B[k])
            for lit, k in zip(cells.arc_lit, cells.arc_plane, strict=True)
            if lit.any()
        ]
        return places_of(within, between, np.concatenate([cells.vertex_B, cells.cell_B]))

    def alike(self, readings: np.ndarray, slack: np.ndarray) -> np.ndarray:
        return self.best(readings)[0][:, None]

    @property
    def images(self) -> np.ndarray:
        return np.eye(3)[None]

    def rank(self, lit: np.ndarray, sun_B: np.ndarray | None = None) -> int:
        values = np.linalg.svd(self.normals_B[lit], compute_uv=False) if lit.any() else np.zeros(0)
        return int(np.count_nonzero(values > RANK_TOLERANCE))

    def covariance(self, readings: np.ndarray, lit: np.ndarray, noise: np.ndarray) -> np.ndarray:
        design = self._rows * lit[:, None]
        x = readings @ np.linalg.pinv(design).T
        length = np.linalg.norm(x, axis=1)
        n = x / length[:, None]
        tangent = np.eye(3) - n[:, :, None] * n[:, None, :]
        scaled = plain_covariance(design, noise) / length[:, None, None] ** 2
        return tangent @ scaled @ tangent

    def arc(self, readings: np.ndarray, lit: np.ndarray) -> np.ndarray:
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

    def counted(self, good: np.ndarray, bad: np.ndarray) -> Counted:
        return Counted(self.normals_B, formula(good, bad))
