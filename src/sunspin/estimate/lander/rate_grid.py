"""Attitudes that a body reaches at a few times from rates on a grid.

Runs are made on a coarser grid, and what lies between is interpolated. For that the motion of a sphere with the same momentum is
divided out: in space it turns about its constant momentum H, by H t / I. What is left changes far less with the rate.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from sunspin.dynamics import gyrostat
from sunspin.dynamics.bodies import Bodies
from sunspin.dynamics.processor import cached, compiled, digest
from sunspin.estimate.lander.model import LanderModel
from sunspin.estimate.settings import GridSettings
from sunspin.solve.rotations import cross, tangent_basis
from sunspin.vehicle.response.planes import sphere as even_directions

TRIAL_ERROR = 1e-3
"""Error of directions (rad) in runs of the grid, and in those that only look whether a sample allows a motion."""

RUNS_AT_ONCE, POINTS_AT_ONCE = 16_384, 200_000
"""Motions that are run together by a thread, and points that it fills."""

CORNERS = np.array(list(product((0, 1), repeat=3)))
"""Corners (8, 3) of a cell."""

SPACINGS, TRIED_CELLS = (4, 3, 2), 100
"""How many steps of the grid may lie between two runs, and on how many cells of such a size that is tried."""

FIRST_RATES, BEYOND = 400, 1.02
"""Directions of the fastest rates at the first sample that are followed to the reference, and how much farther rates are searched
than these lead: between the directions they may lead a little farther."""


class Sphere(NamedTuple):
    """A sphere with the momentum of a body: `by_rate` (3, 3) times the rate, and `at_rest` (3), over its moment of inertia, 1/s."""

    by_rate: np.ndarray
    at_rest: np.ndarray

    @classmethod
    def of(cls, model: LanderModel) -> Sphere:
        """Return the sphere of the nominal body, with the mean moment of inertia."""
        speeds = model.nominal_speeds(model.after_s)
        omega = np.concatenate([np.zeros((1, 3)), np.eye(3)])
        momentum = gyrostat.total_momentum(model.vehicle, omega, np.tile(speeds, (4, 1)))
        by_rate = (momentum[1:] - momentum[0]).T
        moment = np.trace(by_rate) / 3
        return cls(by_rate / moment, momentum[0] / moment)

    def turns(self, omega: np.ndarray, times_s: np.ndarray) -> Rotation:
        """Return the rotations (n m) that take components at the start to components at times (m), for rates (n, 3)."""
        rate = omega @ self.by_rate.T + self.at_rest
        return Rotation.from_rotvec(-(rate[:, None] * times_s[:, None]).reshape(-1, 3))


class Reached(NamedTuple):
    """Rates at a reference that motions may have reached: at most `limit` (rad/s), and in an ellipsoid about `centre` (3).

    With c the distance of a rate from the centre, the root of c . inertia . c is at most `most` there; `inertia` (3, 3) is without
    what free wheels carry along their axes.
    """

    limit: float
    centre: np.ndarray
    inertia: np.ndarray
    most: float

    @classmethod
    def of(cls, model: LanderModel, limit: float, fastest: float) -> Reached:
        """Return what the nominal body reaches that is not faster than `fastest` (rad/s) at the first sample.

        Motions take the ball of these rates to a region whose surface comes from the ball's, so that an ellipsoid about rates that
        began there holds all. Wheels that run down push it aside: about rest it would hold 1.8 times as many rates for Philae.
        """
        first, direction = replace(model, after_s=0.0), even_directions(FIRST_RATES)
        rows = first.rows(first.at_centres(fastest * direction, direction))
        reached = first.run(rows, np.array([model.after_s]), TRIAL_ERROR).omega_B[:, 0]
        reached = reached[np.isfinite(reached).all(axis=1)]
        free = [command != "hold" for command in model.commands]
        inertia = gyrostat.free_inertia(Bodies.of(model.vehicle), free)
        bare = cls(limit, reached.mean(axis=0), inertia, np.inf)
        return bare._replace(most=BEYOND * float(np.sqrt(bare.energy(reached).max())))

    def energy(self, omega: np.ndarray) -> np.ndarray:
        """Return twice the energy (n) of rates (n, 3) relative to the centre."""
        off = omega - self.centre
        return np.einsum("ni,ij,nj->n", off, self.inertia, off)

    def within(self, omega: np.ndarray, margin: float) -> np.ndarray:
        """Return which rates (n, 3) are reached, or are within `margin` (rad/s) of such."""
        aside = margin * np.sqrt(np.linalg.eigvalsh(self.inertia)[-1])
        near = np.sum(omega**2, axis=1) <= (self.limit + margin) ** 2
        return near & (self.energy(omega) <= (self.most + aside) ** 2)


@dataclass(frozen=True)
class RateGrid:
    """Attitudes that the body reaches at `times_s` (m) from the reference, for rates on a cubic grid about rest.

    `side` points along an axis, `edge` rad/s apart; `row_of` (side^3): row of each point in `turn` (rows, m, 4), -1 outside the
    ball; quaternions (scalar last) take components at the reference to components at the time.
    """

    times_s: np.ndarray
    edge: float
    side: int
    row_of: np.ndarray
    turn: np.ndarray

    @classmethod
    def of(
        cls,
        model: LanderModel,
        times_s: np.ndarray,
        reached: Reached,
        edge: float,
        s: GridSettings,
        workers: int = 1,
    ) -> RateGrid:
        """Return the grid of rates that may be reached, about the model's reference, in two steps.

        The nominal body is run on a coarser grid, and of its attitudes the rotation of a :class:`Sphere` is divided out. What is
        left is interpolated at each point of the grid, and the sphere's rotation there is multiplied in again (:func:`fill`).
        """
        margin = np.sqrt(3) * edge  # all corners of a cell
        side, points, row_of = lattice(reached, margin, edge)
        spacing = coarsest_spacing(model, times_s, edge, reached.limit, s)
        far = spacing * edge
        coarse_side, coarse_points, coarse_row_of = lattice(reached, margin * (1 + spacing), far)
        sphere = Sphere.of(model)
        with ThreadPoolExecutor(workers) as pool:
            runs = _pieces(rates_at(coarse_points, coarse_side, far), RUNS_AT_ONCE)
            without = pool.map(partial(without_sphere, model, sphere, times_s), runs)
            left = np.concatenate(list(without)).astype(np.float32)
            between = Between(left, coarse_row_of, coarse_side, side, spacing, edge, times_s)
            turn = np.empty((len(points), len(times_s), 4), dtype=np.float32)
            # each thread writes into its part of `turn`
            parts = _pieces(points, POINTS_AT_ONCE), _pieces(turn, POINTS_AT_ONCE)
            list(pool.map(lambda points, turn: fill(points, turn, between, sphere), *parts))
        return cls(times_s, edge, side, row_of, turn)

    def rates(self, points: np.ndarray) -> np.ndarray:
        """Return the rates (n, 3) at points of the cube, by index."""
        return rates_at(points, self.side, self.edge)

    @property
    def away(self) -> np.ndarray:
        """Return how far in the cube the corners (8) of a cell are from its lowest one."""
        return CORNERS @ np.array([self.side**2, self.side, 1])

    @cached_property
    def cells(self) -> np.ndarray:
        """Return the indices of the lowest corners of cells all of whose corners are on the grid."""
        exists = (self.row_of >= 0).reshape((self.side,) * 3)
        is_cell = np.zeros_like(exists)
        last = self.side - 1
        is_cell[:-1, :-1, :-1] = True
        for a, b, c in CORNERS:
            is_cell[:-1, :-1, :-1] &= exists[a : last + a, b : last + b, c : last + c]
        return np.flatnonzero(is_cell)


def rates_at(points: np.ndarray, side: int, edge: float) -> np.ndarray:
    """Return the rates (n, 3) at points, by index, of a cube about rest with `side` points `edge` rad/s apart along an axis."""
    return (np.stack(np.unravel_index(points, (side,) * 3), axis=-1) - side // 2) * edge


def lattice(reached: Reached, margin: float, edge: float) -> tuple[int, np.ndarray, np.ndarray]:
    """Return a cubic grid about rest: number of points along a side, points within a margin (rad/s) of reached rates, and rows.

    Points (n) are indices in the cube (side^3). Rows (side^3): position of each point of the cube among these, -1 for others.
    """
    half = int(np.ceil((reached.limit + margin) / edge))
    side = 2 * half + 1
    axis = (np.arange(side) - half) * edge
    row_of, points = np.full(side**3, -1, dtype=np.int32), []
    for i, x in enumerate(axis):  # a layer at a time, as memory allows
        y, z = np.meshgrid(axis, axis, indexing="ij")
        omega = np.stack([np.full(side**2, x), y.ravel(), z.ravel()], axis=1)
        points.append(np.flatnonzero(reached.within(omega, margin)) + i * side**2)
    index = np.concatenate(points)
    row_of[index] = np.arange(len(index))
    return side, index, row_of


def coarsest_spacing(
    model: LanderModel, times_s: np.ndarray, edge: float, limit: float, s: GridSettings
) -> int:
    """Return the most steps of a grid between runs with which nine of ten attitudes half way between runs are near enough.

    There the error is the largest; elsewhere it is half of that. One step if no larger spacing is good enough.
    """
    rng, sphere = np.random.default_rng(0), Sphere.of(model)
    direction = rng.standard_normal((TRIED_CELLS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    middle = limit * rng.random((TRIED_CELLS, 1)) ** (1 / 3) * direction
    exact = without_sphere(model, sphere, times_s, middle)
    for spacing in SPACINGS:
        corner = middle[:, None] + (CORNERS - 0.5) * (spacing * edge)
        left = without_sphere(model, sphere, times_s, corner.reshape(-1, 3))
        left = left.reshape(TRIED_CELLS, len(CORNERS), *exact.shape[1:])
        alike = np.sum(left * left[:, :1], axis=-1, keepdims=True) >= 0
        mean = np.where(alike, left, -left).mean(axis=1)
        cosine = np.abs(np.sum(mean * exact, axis=-1)) / np.linalg.norm(mean, axis=-1).clip(1e-9)
        off = 2 * np.arccos(np.minimum(cosine, 1.0)).max(axis=1)
        if np.quantile(off, 0.9) <= s.between_rad:
            return spacing
    return 1


def without_sphere(
    model: LanderModel, sphere: Sphere, times_s: np.ndarray, omega: np.ndarray
) -> np.ndarray:
    """Return quaternions (n, m, 4) that follow the turns of a sphere to give the attitudes of the nominal body at times (m)."""
    whole = Rotation.from_quat(attitudes(model, omega, times_s).reshape(-1, 4))
    left = whole * sphere.turns(omega, times_s).inv()
    return left.as_quat().reshape(len(omega), len(times_s), 4)


def attitudes(model: LanderModel, omega: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return the rotations (n, m, 4) of the nominal body at times (m), from rates (n, 3) at the reference.

    A run carries one inertial direction, and the momentum is another: with one across it, a frame before and after.
    """
    omega = omega + 1e-6 * model.max_rate  # no row is exactly at rest
    speeds = np.tile(model.nominal_speeds(model.after_s), (len(omega), 1))
    momentum = gyrostat.total_momentum(model.vehicle, omega, speeds)
    along = momentum / np.linalg.norm(momentum, axis=1, keepdims=True)
    across = tangent_basis(along)[0]
    frame = np.stack([along, across, cross(along, across)], axis=2)
    rows = model.rows(model.at_centres(omega, across))
    turn = np.empty((len(omega), len(times), 4))
    for i, t in enumerate(times):
        moved = model.run(rows, np.array([t]), TRIAL_ERROR)
        h, r = moved.momentum_B[:, 0], moved.sun_B[:, 0]
        with np.errstate(invalid="ignore"):
            h = h / np.linalg.norm(h, axis=1, keepdims=True)
            after = np.stack([h, r, cross(h, r)], axis=2)
            matrix = after @ np.swapaxes(frame, 1, 2)
        matrix[~np.isfinite(matrix).all(axis=(1, 2))] = np.eye(3)
        turn[:, i] = Rotation.from_matrix(matrix).as_quat()
    return turn


def _pieces(array: np.ndarray, most: int) -> list[np.ndarray]:
    """Return an array in pieces of so many rows at most."""
    return [array[k : k + most] for k in range(0, len(array), most)]


# ---- between runs ----------------------------------------------------------------------------------------------------------


class Between(NamedTuple):
    """A coarse grid of runs, and the finer grid that is filled by interpolation between them.

    Of the runs: `left` (rows, m, 4), quaternions of :func:`without_sphere`, `row_of` (coarse_side^3) and `coarse_side` as in
    :class:`RateGrid`; they are `spacing` steps of the finer grid apart. `side`, `edge` of the finer grid.
    """

    left: np.ndarray
    row_of: np.ndarray
    coarse_side: int
    side: int
    spacing: int
    edge: float
    times_s: np.ndarray


@compiled
def interpolated(between, m, low, part, q):
    """Write the quaternion of time m at the place `part` (3) of the cell with the lowest corner `low` (3), made a unit one."""
    side, first = between.coarse_side, 0
    q[:] = 0.0
    for corner in range(8):
        index, weight = 0, 1.0
        for axis in range(3):
            upper = corner >> (2 - axis) & 1
            index = index * side + low[axis] + upper
            weight *= part[axis] if upper else 1.0 - part[axis]
        row = between.row_of[index] if weight > 0 else first
        if corner == 0:
            first = row
        alike = 0.0
        for k in range(4):
            alike += between.left[row, m, k] * between.left[first, m, k]
        for k in range(4):
            q[k] += (weight if alike >= 0 else -weight) * between.left[row, m, k]
    q /= np.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)


def _entry(sources: int) -> Any:
    """Return the cached entry point; `sources` is the digest of what it is compiled from (:mod:`sunspin.dynamics.processor`)."""

    @cached("compiling the grid of rates of a posterior, once (some 5 s)")
    def fill(points, turn, between, sphere):
        """Write the attitudes (n, m, 4) at points (n) of a grid, by index: the turn of the sphere, and then what is left."""
        _ = sources
        low, part, omega = np.empty(3, dtype=np.int64), np.empty(3), np.empty(3)
        rate, q = np.empty(3), np.empty(4)
        for p in range(len(points)):
            index = points[p]
            for axis in range(2, -1, -1):
                steps = index % between.side - between.side // 2
                index //= between.side
                cell = steps // between.spacing
                low[axis] = cell + between.coarse_side // 2
                part[axis] = (steps - cell * between.spacing) / between.spacing
                omega[axis] = steps * between.edge
            rate[:] = sphere.at_rest
            for a in range(3):
                for b in range(3):
                    rate[a] += sphere.by_rate[a, b] * omega[b]
            length = max(np.sqrt(rate[0] ** 2 + rate[1] ** 2 + rate[2] ** 2), 1e-300)
            for m in range(len(between.times_s)):
                interpolated(between, m, low, part, q)
                half = -length * between.times_s[m] / 2
                size, d = np.sin(half) / length, np.cos(half)
                a, b, c = size * rate[0], size * rate[1], size * rate[2]
                turn[p, m, 0] = q[3] * a + q[0] * d + q[1] * c - q[2] * b
                turn[p, m, 1] = q[3] * b + q[1] * d + q[2] * a - q[0] * c
                turn[p, m, 2] = q[3] * c + q[2] * d + q[0] * b - q[1] * a
                turn[p, m, 3] = q[3] * d - q[0] * a - q[1] * b - q[2] * c

    return fill


fill = _entry(digest(__file__))
