"""What `sunspin.estimate.lander.cells` compiles, in NumPy: cells of a grid of rates looked through, and starts settled."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from sunspin.estimate.lander.allowed import cube_nodes, shortfall
from sunspin.estimate.lander.cells import DARK_SLOPE
from sunspin.estimate.lander.grid import MIDDLES, POINTS, Reference
from sunspin.estimate.lander.rate_grid import RateGrid
from sunspin.estimate.settings import GridSettings
from sunspin.estimate.terms.powers import PanelPowers
from sunspin.solve.rotations import cross, move_on_sphere, tangent_basis
from tests.support.vehicles import units

DIFFERENCE = 1e-6
"""Half the difference in place (parts of an edge) and in step (rad) that gives a derivative."""

CORNERS = np.array(list(product((0, 1), repeat=3)))
"""Corners (8, 3) of a cell."""


def corners_of(grid: RateGrid, cells: np.ndarray) -> np.ndarray:
    """Return the attitudes (n, 8, m, 4) at the corners of cells, with signs alike so that they can be interpolated."""
    turn = grid.quaternions[grid.row_of[cells[:, None] + grid.corner_offsets]].astype(np.float64)
    opposite = np.sum(turn * turn[:, :1], axis=-1, keepdims=True) < 0
    return np.where(opposite, -turn, turn)


def corner_weights(x: np.ndarray) -> np.ndarray:
    """Return how much each corner counts (..., 8) at places x (..., 3) of a cell, in parts of its edge."""
    sides = np.where(CORNERS, x[..., None, :], 1 - x[..., None, :])
    return np.prod(sides, axis=-1)


def rotated(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Return vectors (..., 3) rotated by quaternions (..., 4) of any length, scalar last."""
    axis, scalar = quaternion[..., :3], quaternion[..., 3:]
    twice = 2.0 / np.maximum(np.sum(quaternion**2, axis=-1, keepdims=True), 1e-9)
    side = cross(axis, vector)
    return vector + twice * (scalar * side + cross(axis, side))


class Settling(NamedTuple):
    """Starts on their way to the nearest solution in their cells.

    Attitudes at the corners `turn` (S, 8, m, 4); the direction `sun` (S, 3) at the reference with two tangents (S, 2, 3); place `x`
    (S, 3) in the cell and `step` (S, 2) of the direction along the tangents.
    """

    turn: np.ndarray
    sun: np.ndarray
    tangents: np.ndarray
    x: np.ndarray
    step: np.ndarray

    def take(self, which: np.ndarray) -> Settling:
        """Return some of the starts."""
        return Settling(*(part[which] for part in self))


def nearest_node(direction: np.ndarray, size: int) -> np.ndarray:
    """Return the index (...) of the node of a cube nearest to each direction (..., 3)."""
    shape, flat = direction.shape[:-1], direction.reshape(-1, 3)
    axis = np.argmax(np.abs(flat), axis=1)
    top, row, column = (
        np.take_along_axis(flat, (axis[:, None] + k) % 3, axis=1)[:, 0] for k in range(3)
    )
    length = np.maximum(np.abs(top), 1e-300)
    i, j = (np.rint((part / length + 1) * (size / 2)).astype(np.int64) for part in (row, column))
    face = 2 * axis + (top < 0)
    return (face * (size + 1) ** 2 + i * (size + 1) + j).reshape(shape)


class LookThrough:
    """Readings of the reference and of the samples next to it, against the cells of a grid of rates."""

    def __init__(
        self, grid: RateGrid, panels: PanelPowers, reference: Reference, s: GridSettings
    ) -> None:
        """Compare the readings of all nodes of the sphere with those of the samples."""
        self.grid, self.reference, self.s = grid, reference, s
        samples = np.array([reference.sample, *reference.others])
        self.panels = panels.take(samples)  # the reference first
        full = panels.response.power(panels.response.facing_B).diagonal()
        self.full = panels.brightness * full
        self.nodes = cube_nodes(s.nodes)
        others = panels.take(reference.others)
        seen = np.broadcast_to(self.nodes[:, None], (len(self.nodes), len(reference.others), 3))
        near, far = s.near_rad + s.node_rad, s.far_rad + s.node_rad
        self.short_near, self.short_far = (
            shortfall(others, seen, angle, s).T.copy() for angle in (near, far)
        )
        light = panels.brightness * others.response.power(seen)
        light = others.best_factor(light)[0] * light if others.throttled else light
        square = np.minimum(((light - others.power) / others.sigma) ** 2, 1e6)
        self.misfit = np.where(others.used, square, 0.0).sum(axis=2).T.copy()

    def settled_starts(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the starts of cells (by index): rates (n, 3), directions (n, 3) at the reference, and misfits (n)."""
        s, turn = self.s, corners_of(self.grid, cells)
        tangents = np.stack(tangent_basis(self.reference.suns), axis=1)
        # the middle of each eighth of a cell, for each direction: does any direction near it agree?
        middles = self._interpolated(turn, corner_weights(MIDDLES))
        cell, eighth, sun = self._agreeing(middles)
        at = corner_weights(POINTS)[eighth]  # (S, 8 points, 8 corners)
        points = self._interpolated(turn[cell], at)
        directions = rotated(points, self.reference.suns[sun][:, None, None])
        worst, total = self._against(directions, self.short_near)
        total[worst > s.limit] = np.inf
        best = np.argmin(total, axis=1)
        some = np.isfinite(total[np.arange(len(total)), best])
        cell, eighth, sun, best = cell[some], eighth[some], sun[some], best[some]
        place, suns = POINTS[eighth, best], self.reference.suns[sun]
        starts = Settling(turn[cell], suns, tangents[sun], place, np.zeros((len(cell), 2)))
        starts, misfit = self.settle(starts)
        near = np.abs(starts.x - MIDDLES[eighth]).max(axis=1, initial=0.0) < 0.5
        settled = near & (misfit <= s.settled)
        starts, cell = starts.take(settled), cell[settled]
        omega = self.grid.rates(cells[cell]) + starts.x * self.grid.edge
        length = np.linalg.norm(starts.step, axis=1, keepdims=True)
        angle = np.divide(np.arctan(length), length, out=np.ones_like(length), where=length > 0)
        return omega, move_on_sphere(starts.sun, starts.step * angle), misfit[settled]

    def _interpolated(self, turn: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return attitudes (n, p, m, 4), of any length, interpolated between corners (n, 8, m, 4) with weights (.., p, 8)."""
        flat = turn.reshape(len(turn), 8, -1)
        weighted = weights @ flat
        return weighted.reshape(*weighted.shape[:2], -1, 4)

    def _agreeing(self, middles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return cells, eighths and directions, by index, whose middles (n, 8, m, 4) the readings do not contradict."""
        found = []
        for k, sun in enumerate(self.reference.suns):
            worst, _ = self._against(rotated(middles, sun), self.short_far)
            cell, eighth = np.nonzero(worst <= self.s.limit)
            found.append(np.stack([cell, eighth, np.full(len(cell), k)]))
        cell, eighth, sun = np.concatenate(found, axis=1)
        return cell, eighth, sun

    def _against(self, directions: np.ndarray, short: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return by how much readings contradict all directions near (n, p, m, 3), worst sample (n, p), and the misfit (n, p)."""
        node = nearest_node(directions, self.s.nodes)
        m = np.arange(len(short))
        return short[m, node].max(axis=2), self.misfit[m, node].sum(axis=2)

    def settle(self, starts: Settling) -> tuple[Settling, np.ndarray]:
        """Return starts after least squares for place and direction, and their misfits (S).

        Those whose misfit does not fall fast enough to become small end early.
        """
        s = self.s
        x, step, misfit = starts.x.copy(), starts.step.copy(), np.full(len(starts.x), np.inf)
        going = np.arange(len(x))
        for taken in range(s.steps + 1):
            if not len(going):
                break
            now = starts.take(going)._replace(x=x[going], step=step[going])
            after, normal, gradient = self._equations(now)
            gained, misfit[going] = np.maximum(misfit[going] - after, 0.0), after
            if taken == s.steps:
                break
            hopeful = after - s.gain_left * gained <= s.settled
            going, normal, gradient = going[hopeful], normal[hopeful], gradient[hopeful]
            places = np.arange(5)
            normal[:, places, places] += 1e-2 * normal[:, places, places] + 1e-3
            move = -np.linalg.solve(normal, gradient[..., None])[..., 0]
            longest = np.abs(move[:, :3]).max(axis=1, initial=0.0) / 0.25
            across = np.abs(move[:, 3:]).max(axis=1, initial=0.0) / 0.3
            move /= np.maximum(np.maximum(longest, across), 1.0)[:, None]
            x[going] = np.clip(x[going] + move[:, :3], -0.2, 1.2)
            step[going] += move[:, 3:]
        return starts._replace(x=x, step=step), misfit

    def _equations(self, now: Settling) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the misfit (S) of starts, and normal equations (S, 5, 5), (S, 5) for place and direction."""
        panels, s = self.panels, self.s
        sun = self._directions(now)
        slopes = panels.response.slopes(sun)
        light, to_sun = panels.brightness * slopes.power, panels.brightness * slopes.to_sun
        # a dark input near its edge has the slope of its light, so that a start finds into it
        facing = panels.response.facing_B
        dark = (light <= 0) & (sun @ facing.T > -DARK_SLOPE)
        to_sun = np.where(dark[..., None], self.full[:, None] * facing, to_sun)
        change = to_sun @ self._slopes(now)
        factor: np.ndarray | float = 1.0
        if panels.throttled:
            factor, weight = panels.best_factor(light)
            size = np.sum(weight * light**2, axis=-1)[..., None, None]
            part = np.sum((weight * light)[..., None] * change, axis=-2, keepdims=True)
            share = np.divide(part, size, out=np.zeros_like(part), where=size > 0)
            change = factor[..., None] * (change - light[..., None] * share)
            light = factor * light
        full = factor * self.full
        precision = 1.0 / (panels.sigma**2 + (s.blur_rad * full) ** 2)
        counts = panels.used & ((light > 0) | (panels.power > 0))
        gap = light - panels.power
        square = np.where(counts, precision * gap**2, 0.0)
        weight = np.where(counts, precision, 0.0) / (1.0 + square / 25.0)
        count = len(now.x)
        flat = change.reshape(count, -1, 5)
        weighted = np.swapaxes(flat * weight.reshape(count, -1, 1), 1, 2)
        misfit = np.minimum(square, s.cap).sum(axis=(1, 2))
        return misfit, weighted @ flat, (weighted @ gap.reshape(count, -1, 1))[..., 0]

    def _directions(self, now: Settling) -> np.ndarray:
        """Return the directions to the Sun (S, 1 + m, 3), the reference first."""
        here = units(now.sun + np.einsum("sa,sai->si", now.step, now.tangents))[:, None]
        attitude = self._interpolated(now.turn, corner_weights(now.x)[:, None])[:, 0]
        return np.concatenate([here, rotated(attitude, here)], axis=1)

    def _slopes(self, now: Settling) -> np.ndarray:
        """Return the derivatives (S, 1 + m, 3, 5) of the directions for place and step, by differences."""
        columns = []
        for h in DIFFERENCE * np.eye(5):
            ahead, back = (
                self._directions(now._replace(x=now.x + to[:3], step=now.step + to[3:]))
                for to in (h, -h)
            )
            columns.append((ahead - back) / (2 * DIFFERENCE))
        return np.stack(columns, axis=-1)
