"""Attitudes that a body reaches at a few times from rates on a grid.

The equations of motion are integrated (a *run*) on a coarser grid only; attitudes between its points are interpolated. Before the
interpolation the rotation of a sphere with the same angular momentum H is divided out: it rotates about H, which is constant in
space, by H t / I. What is left of the rotation, the *rest*, changes far less with the rate. It is interpolated.
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
"""Error of directions (rad) in runs of the grid, and in those that only test whether the readings of a sample allow a motion."""

RUNS_AT_ONCE, POINTS_AT_ONCE = 16_384, 200_000
"""Motions that a thread integrates together, and points that it interpolates together."""

CORNERS = np.array(list(product((0, 1), repeat=3)))
"""Corners (8, 3) of a cell."""

SPACINGS, TRIED_CELLS = (4, 3, 2), 100
"""How many steps of the grid may lie between two runs, and on how many cells of such a size that is tried."""

FIRST_RATES, BEYOND = 400, 1.02
"""Directions of the fastest rates at the first sample that are followed to the reference, and a factor on the ellipsoid of rates
that these reach: rates between the directions may reach a little farther."""


class Sphere(NamedTuple):
    """The rate (rad/s) of a sphere with the angular momentum H of a body: `by_rate` (3, 3) times the body rate plus `at_rest` (3).

    H = Theta omega + sum J W u is divided by the moment of inertia of the sphere; `at_rest` is the part of the wheels.
    """

    by_rate: np.ndarray
    at_rest: np.ndarray

    @classmethod
    def of(cls, model: LanderModel) -> Sphere:
        """Return the sphere with the mean moment of inertia and the angular momentum of the body and wheels of the vehicle file."""
        speeds = model.nominal_speeds(model.after_s)  # at the model's reference
        # H is linear in omega: at rest it is the part of the wheels, and what unit rates add are the columns of the inertia
        omega = np.concatenate([np.zeros((1, 3)), np.eye(3)])
        momentum = gyrostat.total_momentum(model.vehicle, omega, np.tile(speeds, (4, 1)))
        of_wheels, inertia = momentum[0], (momentum[1:] - momentum[0]).T
        of_sphere = np.trace(inertia) / 3  # its moment of inertia
        return cls(by_rate=inertia / of_sphere, at_rest=of_wheels / of_sphere)

    def rotations(self, omega: np.ndarray, times_s: np.ndarray) -> Rotation:
        """Return the sphere's rotations (n m), for body rates (n, 3): body components at the start to those at times (m)."""
        rate = omega @ self.by_rate.T + self.at_rest
        return Rotation.from_rotvec(-(rate[:, None] * times_s[:, None]).reshape(-1, 3))


class Reached(NamedTuple):
    """Rates that motions may have at a reference: at most `limit` (rad/s), and in an ellipsoid about `centre` (3), rad/s.

    The ellipsoid holds each rate for which sqrt(c . `inertia` c) <= `most`, c being the rate less the centre. `inertia` (3, 3) is
    that of the body without the axial inertia of free wheels, kg m2.
    """

    limit: float
    centre: np.ndarray
    inertia: np.ndarray
    most: float

    @classmethod
    def of(cls, model: LanderModel, limit: float, fastest: float) -> Reached:
        """Return the rates that the nominal body reaches if it is not faster than `fastest` (rad/s) at the first sample.

        The motion maps the ball of rates at the first sample to a region, and its surface to the region's surface. So it is enough
        to follow rates on the surface, and to enclose what they reach in an ellipsoid. Its centre is not at zero because wheels
        that run down drive the body: about zero it would hold 1.8 times as many rates for Philae.
        """
        first, direction = replace(model, after_s=0.0), even_directions(FIRST_RATES)
        # neither the direction to the Sun nor the times of the observations, which still count from the reference, matter here
        rows = first.rows(first.at_centres(fastest * direction, direction))
        reached = first.run(rows, np.array([model.after_s]), TRIAL_ERROR).omega_B[:, 0]
        reached = reached[np.isfinite(reached).all(axis=1)]
        free = [command != "hold" for command in model.commands]
        inertia = gyrostat.free_inertia(Bodies.of(model.vehicle), free)
        unbounded = cls(limit, reached.mean(axis=0), inertia, np.inf)
        return unbounded._replace(most=BEYOND * float(np.sqrt(unbounded.energy(reached).max())))

    def energy(self, omega: np.ndarray) -> np.ndarray:
        """Return twice the kinetic energy (n), J, of rates (n, 3) relative to the centre: c . inertia c."""
        off = omega - self.centre
        return np.einsum("ni,ij,nj->n", off, self.inertia, off)

    def within(self, omega: np.ndarray, margin: float) -> np.ndarray:
        """Return which rates (n, 3) are reached, or are within `margin` (rad/s) of reached ones."""
        # the largest growth of sqrt(c . inertia c) over a distance `margin`
        growth = margin * np.sqrt(np.linalg.eigvalsh(self.inertia)[-1])
        near = np.sum(omega**2, axis=1) <= (self.limit + margin) ** 2
        return near & (self.energy(omega) <= (self.most + growth) ** 2)


@dataclass(frozen=True)
class RateGrid:
    """Attitudes that the body reaches at `times_s` (m) from the reference, for rates on a cubic grid about rest.

    The grid has `side` points along an axis, `edge` rad/s apart; a point is counted by its index in the cube (side^3). `row_of`
    (side^3): row of each point in `quaternions` (rows, m, 4), -1 for rates that cannot be reached. The quaternions (scalar last)
    take body components at the reference to body components at the time.
    """

    times_s: np.ndarray
    edge: float
    side: int
    row_of: np.ndarray
    quaternions: np.ndarray

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
        """Return the grid of rates that may be reached at the model's reference, with attitudes at `times_s` (m) from there.

        The nominal body is run on a coarser grid, and the rotation of a :class:`Sphere` is divided out of its attitudes. The rest
        is interpolated at each point of the grid, and the sphere's rotation there is multiplied in again (:func:`fill`).
        """
        margin = np.sqrt(3) * edge  # diagonal of a cell: all its corners are needed
        side, points, row_of = lattice(reached, margin, edge)
        spacing = coarsest_spacing(model, times_s, edge, reached.limit, s)
        coarse_edge = spacing * edge
        coarse_margin = margin * (1 + spacing)
        coarse_side, coarse_points, coarse_row_of = lattice(reached, coarse_margin, coarse_edge)
        sphere = Sphere.of(model)
        with ThreadPoolExecutor(workers) as pool:
            runs = _pieces(rates_at(coarse_points, coarse_side, coarse_edge), RUNS_AT_ONCE)
            rests = pool.map(partial(without_sphere, model, sphere, times_s), runs)
            rest = np.concatenate(list(rests)).astype(np.float32)
            coarse = CoarseGrid(rest, coarse_row_of, coarse_side, side, spacing, edge, times_s)
            quaternions = np.empty((len(points), len(times_s), 4), dtype=np.float32)
            # each thread writes into its part of `quaternions`
            parts = _pieces(points, POINTS_AT_ONCE), _pieces(quaternions, POINTS_AT_ONCE)
            list(pool.map(lambda points, out: fill(points, out, coarse, sphere), *parts))
        return cls(times_s, edge, side, row_of, quaternions)

    def rates(self, points: np.ndarray) -> np.ndarray:
        """Return the rates (n, 3), rad/s, at points (n), given as indices in the cube."""
        return rates_at(points, self.side, self.edge)

    @property
    def corner_offsets(self) -> np.ndarray:
        """Return what leads from the index of a cell's lowest corner to those of its corners (8), in the order of `CORNERS`."""
        return CORNERS @ np.array([self.side**2, self.side, 1])

    @cached_property
    def cells(self) -> np.ndarray:
        """Return the indices of the lowest corners of all cells that have each of their corners in the table of attitudes."""
        known = (self.row_of >= 0).reshape((self.side,) * 3)
        is_cell = np.zeros_like(known)
        last = self.side - 1
        is_cell[:-1, :-1, :-1] = True
        for a, b, c in CORNERS:
            is_cell[:-1, :-1, :-1] &= known[a : last + a, b : last + b, c : last + c]
        return np.flatnonzero(is_cell)


def rates_at(points: np.ndarray, side: int, edge: float) -> np.ndarray:
    """Return the rates (n, 3) at points (n), indices in a cube about zero with `side` points, `edge` rad/s apart, along an axis."""
    return (np.stack(np.unravel_index(points, (side,) * 3), axis=-1) - side // 2) * edge


def lattice(reached: Reached, margin: float, edge: float) -> tuple[int, np.ndarray, np.ndarray]:
    """Return a cubic grid of rates about zero as (side, points, row_of), with points within a margin (rad/s) of reached rates.

    `side`: number of points along an axis, `edge` rad/s apart. `points` (n): indices in the cube (side^3) of those within the
    margin. `row_of` (side^3): position of each point of the cube in `points`, -1 for the others.
    """
    half = int(np.ceil((reached.limit + margin) / edge))
    side = 2 * half + 1
    axis = (np.arange(side) - half) * edge
    row_of, layers = np.full(side**3, -1, dtype=np.int32), []
    for i, x in enumerate(axis):  # a layer at a time, to limit memory
        y, z = np.meshgrid(axis, axis, indexing="ij")
        omega = np.stack([np.full(side**2, x), y.ravel(), z.ravel()], axis=1)
        layers.append(np.flatnonzero(reached.within(omega, margin)) + i * side**2)
    points = np.concatenate(layers)
    row_of[points] = np.arange(len(points))
    return side, points, row_of


def coarsest_spacing(
    model: LanderModel, times_s: np.ndarray, edge: float, limit: float, s: GridSettings
) -> int:
    """Return the largest number of grid steps between runs for which interpolation errs by at most `between_rad`.

    Random cells with rates up to `limit` (rad/s) are tried. The error is that of the attitude in the middle of eight runs, where it
    is largest, and nine of ten cells must keep the bound. One step if no larger spacing is good enough.
    """
    rng, sphere = np.random.default_rng(0), Sphere.of(model)
    direction = rng.standard_normal((TRIED_CELLS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    middle = limit * rng.random((TRIED_CELLS, 1)) ** (1 / 3) * direction
    exact = without_sphere(model, sphere, times_s, middle)
    for spacing in SPACINGS:
        corner = middle[:, None] + (CORNERS - 0.5) * (spacing * edge)
        rest = without_sphere(model, sphere, times_s, corner.reshape(-1, 3))
        rest = rest.reshape(TRIED_CELLS, len(CORNERS), *exact.shape[1:])
        # the mean of the corners; q and -q are the same attitude, and the sign nearer to the first corner is taken
        same_side = np.sum(rest * rest[:, :1], axis=-1, keepdims=True) >= 0
        mean = np.where(same_side, rest, -rest).mean(axis=1)
        cosine = np.abs(np.sum(mean * exact, axis=-1)) / np.linalg.norm(mean, axis=-1).clip(1e-9)
        error_rad = 2 * np.arccos(np.minimum(cosine, 1.0)).max(axis=1)
        if np.quantile(error_rad, 0.9) <= s.between_rad:
            return spacing
    return 1


def without_sphere(
    model: LanderModel, sphere: Sphere, times_s: np.ndarray, omega: np.ndarray
) -> np.ndarray:
    """Return the rest (n, m, 4), quaternions, of the nominal body's rotation to times (m) after that of the sphere.

    Rotation of the body = rest * rotation of the sphere, from the reference with rates `omega` (n, 3).
    """
    body = Rotation.from_quat(attitudes(model, omega, times_s).reshape(-1, 4))
    rest = body * sphere.rotations(omega, times_s).inv()
    return rest.as_quat().reshape(len(omega), len(times_s), 4)


def attitudes(model: LanderModel, omega: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return the rotations (n, m, 4) of the nominal body from the reference to times (m), from rates (n, 3) at the reference.

    A run gives two directions that are fixed in space, in body axes: the angular momentum, and a "Sun" that is placed at right
    angles to it. With their cross product they are a frame; the frames before and after give the rotation. Motions that could not
    be computed do not rotate.
    """
    omega = omega + 1e-6 * model.max_rate  # no motion is exactly at rest
    speeds = np.tile(model.nominal_speeds(model.after_s), (len(omega), 1))
    momentum = gyrostat.total_momentum(model.vehicle, omega, speeds)
    along = momentum / np.linalg.norm(momentum, axis=1, keepdims=True)
    across = tangent_basis(along)[0]
    before = np.stack([along, across, cross(along, across)], axis=2)
    rows = model.rows(model.at_centres(omega, across))
    quaternions = np.empty((len(omega), len(times), 4))
    for i, t in enumerate(times):
        run = model.run(rows, np.array([t]), TRIAL_ERROR)
        along, across = run.momentum_B[:, 0], run.sun_B[:, 0]
        with np.errstate(invalid="ignore"):
            along = along / np.linalg.norm(along, axis=1, keepdims=True)
            after = np.stack([along, across, cross(along, across)], axis=2)
            matrix = after @ np.swapaxes(before, 1, 2)
        matrix[~np.isfinite(matrix).all(axis=(1, 2))] = np.eye(3)
        quaternions[:, i] = Rotation.from_matrix(matrix).as_quat()
    return quaternions


def _pieces(array: np.ndarray, most: int) -> list[np.ndarray]:
    """Return an array in pieces of at most `most` rows."""
    return [array[k : k + most] for k in range(0, len(array), most)]


# ---- interpolation between runs --------------------------------------------------------------------------------------------


class CoarseGrid(NamedTuple):
    """A coarse grid of runs, and the size of the finer grid that is filled by interpolation between them.

    `rest` (rows, m, 4): quaternions of :func:`without_sphere` for the runs; `row_of` (coarse_side^3) and `coarse_side` as in
    :class:`RateGrid`. Runs are `spacing` steps of the finer grid apart. `side`, `edge`: of the finer grid.
    """

    rest: np.ndarray
    row_of: np.ndarray
    coarse_side: int
    side: int
    spacing: int
    edge: float
    times_s: np.ndarray


@compiled
def write_interpolated(coarse, m, low, part, q):
    """Write the rest of the rotation (:func:`without_sphere`) to time m into q (4): trilinear between the runs at a cell's corners.

    `coarse`: :class:`CoarseGrid`. `low` (3): indices of the cell's lowest corner along its axes; `part` (3): place, 0 to below 1.
    """
    side, first = coarse.coarse_side, 0
    q[:] = 0.0
    for corner in range(8):
        index, weight = 0, 1.0
        for axis in range(3):
            upper = corner >> (2 - axis) & 1
            index = index * side + low[axis] + upper
            weight *= part[axis] if upper else 1.0 - part[axis]
        # A corner without weight may lie outside the table. The first corner always has weight, as `part` is below 1.
        row = coarse.row_of[index] if weight > 0 else first
        if corner == 0:
            first = row
        product = 0.0
        for k in range(4):
            product += coarse.rest[row, m, k] * coarse.rest[first, m, k]
        # q and -q are the same attitude: the sign nearer to the first corner is taken
        for k in range(4):
            q[k] += (weight if product >= 0 else -weight) * coarse.rest[row, m, k]
    q /= np.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)


def _entry(sources: int) -> Any:
    """Return the compiled `fill`; `sources` is the digest of its sources (:mod:`sunspin.dynamics.processor`)."""

    @cached("compiling the grid of rates of a posterior, once (some 5 s)")
    def fill(points, quaternions, coarse, sphere):
        """Write `quaternions` (n, m, 4) at points (n), indices in the finer grid: interpolated rest * rotation of the sphere."""
        _ = sources
        low, part, omega = np.empty(3, dtype=np.int64), np.empty(3), np.empty(3)
        rate, q = np.empty(3), np.empty(4)
        for p in range(len(points)):
            # the point along each axis: steps from zero, cell of the coarse grid, place in that cell, body rate
            index = points[p]
            for axis in range(2, -1, -1):
                steps = index % coarse.side - coarse.side // 2
                index //= coarse.side
                cell = steps // coarse.spacing
                low[axis] = cell + coarse.coarse_side // 2
                part[axis] = (steps - cell * coarse.spacing) / coarse.spacing
                omega[axis] = steps * coarse.edge
            rate[:] = sphere.at_rest
            for a in range(3):
                for b in range(3):
                    rate[a] += sphere.by_rate[a, b] * omega[b]
            length = max(np.sqrt(rate[0] ** 2 + rate[1] ** 2 + rate[2] ** 2), 1e-300)
            for m in range(len(coarse.times_s)):
                write_interpolated(coarse, m, low, part, q)
                # quaternion (a, b, c, d) of the sphere's rotation by -rate t, then the product q * (a, b, c, d)
                half = -length * coarse.times_s[m] / 2
                size, d = np.sin(half) / length, np.cos(half)
                a, b, c = size * rate[0], size * rate[1], size * rate[2]
                quaternions[p, m, 0] = q[3] * a + q[0] * d + q[1] * c - q[2] * b
                quaternions[p, m, 1] = q[3] * b + q[1] * d + q[2] * a - q[0] * c
                quaternions[p, m, 2] = q[3] * c + q[2] * d + q[0] * b - q[1] * a
                quaternions[p, m, 3] = q[3] * d - q[0] * a - q[1] * b - q[2] * c

    return fill


fill = _entry(digest(__file__))
