"""Grid search for initial rates, as starts for least squares.

The attitude that the body has reached at the samples next to the reference is computed on a grid of rates, fine enough (turns of
`TURN` rad from point to point at most) to be interpolated between them. Every cell of the grid is looked through on points a
quarter of its edge apart, and the best of each eighth is taken on unless no direction near it agrees with the readings. From
there least squares on the interpolated attitudes finds the nearest solution, kept if it is one within their error. A motion
therefore has a start within an eighth of a cell: about a quarter of a radian at those samples. The initial direction does not
enter the runs: they give rotations.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from inspect import getsource
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sunspin.dynamics import gyrostat as g
from sunspin.dynamics.processor import njit
from sunspin.estimate.posterior import light
from sunspin.estimate.posterior.data import Readings
from sunspin.estimate.posterior.light import between, light_of, nearest_node, nodes, seen
from sunspin.estimate.posterior.model import Model, State
from sunspin.solve.rotations import move_on_sphere, tangent_basis
from sunspin.vehicle.response.panels import panel_power
from sunspin.vehicle.response.planes import sphere


def jit(function: Any) -> Any:
    """Compile a function and keep it until this file or that of the compiled functions it calls (`light`) changes: of itself numba
    looks at a function's own file only."""
    compiled: Any = njit(nogil=True, cache=True)(function)
    if hasattr(compiled, "_cache"):  # numba may be told not to compile
        file = compiled._cache._cache_file
        file._source_stamp = (file._source_stamp, getsource(light))
    return compiled


TURN = 1.6
"""rad by which neighbours of the grid differ at the farthest of the samples tried; interpolated rotations then err by 0.05."""

AMPLIFIED = 1.15
"""rad per (rad/s x s): what a wheel's or uneven moments' nutation adds."""

NEAR, FAR = 0.35, 0.65
"""rad for which a point stands: at a quarter of a cell's edge, and at the middle of an eighth."""

NODES, NODE_RAD = 48, 0.02
"""Cells along an edge of the cube of nodes at which readings are compared with directions, and how far one is from its node."""

SCALE_SHARE = 0.08
"""Relative error of the brightness and of gains while starts are looked for."""

SIGMAS, CAP, LIMIT = 3.0, 16.0, 20.0
"""A reading counts against a point beyond SIGMAS, by the square of what is left, CAP at most (a shadow?); it falls at LIMIT."""

CANDIDATE_GRID = 3000
"""Directions on the sphere, 3.7 degrees apart, of which those that the reference sample allows are starts."""

CANDIDATE_RAD = 0.3
"""Starts stand for directions this near."""

BLUR = 0.07
"""rad: error of interpolated attitudes and brightness, added to the noise while starts settle."""

SETTLED = 36.0
"""Misfit (sum of squares, CAP at most for each reading) up to which a settled start is kept."""

STEPS, ARRIVED, FASTER = 8, 2e-3, 2.0
"""Steps of least squares on the interpolated attitudes at most, the step (of a cell, rad) that is the last, and how many times as
much as the last one each step to come may gain: 3 % of the points that would settle are given up by that, for two fifths less
steps."""

APART = 0.3
"""rad at the samples tried: of starts nearer to each other one is kept."""

MAX_CELLS = 8_000_000
"""Cells times directions beyond this are not looked through: the ball of rates is made smaller, and the verdict says so."""

MAX_STARTS = 40_000_000
"""Cells times directions for which an hour is needed, about: a caller who asks for more is told so."""

TRIAL_ERROR = 1e-3
"""Error of a direction (rad) on the grid."""


def sun_candidates(model: Model, data: Readings, scale: float, sample: int) -> np.ndarray:
    """Directions (n, 3), about `CANDIDATE_RAD` apart, that a sample allows; best first."""
    grid = sphere(CANDIDATE_GRID)
    power = scale * panel_power(model.vehicle, grid)[:, None]
    here = data.take(np.array([sample]))
    gap = (here.factor(power, here.weight) * power)[:, 0] - data.value[sample]
    tolerance = np.hypot(SIGMAS * data.sigma, SCALE_SHARE * scale * model.vehicle.input_gains)
    misfit = np.where(data.used[sample], np.minimum((gap / tolerance) ** 2, CAP), 0.0).sum(axis=1)
    allowed = grid[order := np.argsort(misfit, kind="stable")][misfit[order] < misfit.min() + 1.0]
    kept = allowed[:1]
    while (nearest := (allowed @ kept.T).max(axis=1)).min() < np.cos(CANDIDATE_RAD):
        kept = np.concatenate([kept, allowed[[np.argmin(nearest)]]])
    return kept


def shortfall(
    model: Model, data: Readings, sun: np.ndarray, angle: float, scale: float
) -> np.ndarray:
    """How far (n) readings of samples (K) speak against any direction within `angle` rad of `sun` (n, K, 3)."""
    low, high = model.vehicle.response_in().bounds(sun, angle)
    low, high = scale * low * (1 - SCALE_SHARE), scale * high * (1 + SCALE_SHARE)
    least = np.full(low.shape[:2], np.inf)
    for factor in _factors(data, low, high) if data.throttled else [1.0]:
        beyond = np.maximum(
            np.maximum(factor * low - data.value, data.value - factor * high) / data.sigma - SIGMAS,
            0.0,
        )
        least = np.minimum(least, np.where(data.used, np.minimum(beyond**2, CAP), 0.0).sum(axis=2))
    return least.sum(axis=1)


def _factors(data: Readings, low: np.ndarray, high: np.ndarray) -> Iterator[np.ndarray]:
    """Factors (n, K, 1) of throttled samples among which there is one that agrees with all bounds (n, K, P) where there is any: the
    ends of the intervals that each reading allows."""
    slack = SIGMAS * data.sigma
    for end, value in ((high, data.value - slack), (low, data.value + slack)):
        ends = np.divide(
            np.maximum(value, 0.0), end, out=np.zeros_like(end), where=data.used & (end > 0)
        )
        yield from np.moveaxis(ends, -1, 0)[..., None]


def grid_edge(times: np.ndarray) -> float:
    """Step of the grid, rad/s, for samples at `times` (s from the reference)."""
    return TURN / (AMPLIFIED * float(np.abs(times).max()))


def cell_count(limit: float, edge: float) -> float:
    """Cells in a ball of rates, about."""
    return 4 / 3 * np.pi * (limit / edge + 1.0) ** 3


def largest_ball(cells: float, edge: float) -> float:
    """The limit of a ball of rates that has so many cells, about."""
    return edge * ((cells / (4 / 3 * np.pi)) ** (1 / 3) - 1)


@dataclass(frozen=True)
class Attitudes:
    """Row -> rotations of the body at the `times` (m, s from the reference), for the rates of a grid with step `edge`.

    As unit quaternions (scalar last) that take components at the reference to components at the time.
    """

    model: Model
    times: np.ndarray
    edge: float

    @property
    def outputs(self) -> Mapping[str, Any]:
        return {"turn": ("float32", (len(self.times), 4))}

    @property
    def side(self) -> int:
        """Points of the grid along an axis."""
        return 2 * int(np.ceil(self.model.max_rate / self.edge)) + 1

    @cached_property
    def places(self) -> np.ndarray:
        """Places (n) in the cube of the grid's points within a cell's diagonal of the ball."""
        axis = (np.arange(self.side) - self.side // 2) * self.edge
        square = axis[:, None, None] ** 2 + axis[None, :, None] ** 2 + axis**2
        return np.flatnonzero(square <= (self.model.max_rate + np.sqrt(3) * self.edge) ** 2)

    @property
    def n_rows(self) -> int:
        return len(self.places)

    def rates(self, places: np.ndarray) -> np.ndarray:
        """Rates (n, 3) at places of the cube; halves and quarters between points are made by the caller."""
        return (
            np.stack(np.unravel_index(places, (self.side,) * 3), axis=-1) - self.side // 2
        ) * self.edge

    def __call__(self, index: np.ndarray) -> dict[str, np.ndarray]:
        model = self.model
        omega = self.rates(self.places[index]) + 1e-6 * self.edge  # no row is exactly at rest
        nominal = State(
            omega,
            np.tile([0.0, 0.0, 1.0], (len(omega), 1)),
            np.zeros((len(omega), len(model.unknowns))),
        )
        rows = model.rows(nominal)
        momentum = g.total_momentum(model.vehicle, omega, rows.wheel_speed_rad_s)
        along = momentum / np.linalg.norm(momentum, axis=1, keepdims=True)
        across = tangent_basis(along)[
            0
        ]  # any inertial direction will do for the run; one across H makes a frame with it
        rows = model.rows(State(omega, across, nominal.u))
        frame = np.stack([along, across, np.cross(along, across)], axis=2)
        turns = np.empty((len(omega), len(self.times), 4), dtype=np.float32)
        for i, t in enumerate(self.times):
            run = model.run(rows, [t], TRIAL_ERROR)
            h, r = run.momentum_B[:, 0], run.sun_B[:, 0]
            h = h / np.linalg.norm(h, axis=1, keepdims=True)
            reached = np.stack([h, r, np.cross(h, r)], axis=2)
            with np.errstate(invalid="ignore"):
                turn = np.einsum("nij,nkj->nik", reached, frame)
            good = np.isfinite(turn).all(axis=(1, 2))
            turn[~good] = np.eye(3)
            turns[:, i] = Rotation.from_matrix(turn).as_quat()
        return {"turn": turns}


def first_speed(model: Model, state: State) -> np.ndarray:
    """Angular speeds (n) at the first sample of motions given at the reference, rad/s; infinite where they cannot be computed."""
    if not (model.after_s and len(state)):
        return np.linalg.norm(state.omega, axis=1)
    speed = np.linalg.norm(
        model.run(model.rows(state), [-model.after_s], TRIAL_ERROR).omega_B[:, 0], axis=1
    )
    return np.where(np.isfinite(speed), speed, np.inf)


@dataclass(frozen=True)
class Starts:
    """The starts in the cells between the rows of `attitudes`, of which `turn` is the result.

    `data` are the samples tried and `here` the reference's readings (P), `suns` (c, 3) directions there.
    """

    attitudes: Attitudes
    turn: np.ndarray
    data: Readings
    here: np.ndarray
    here_used: np.ndarray
    suns: np.ndarray
    scale: float

    @cached_property
    def row_of(self) -> np.ndarray:
        """Row of the grid at each place of the cube, -1 outside the ball."""
        rows = np.full(self.attitudes.side**3, -1, dtype=np.int64)
        rows[self.attitudes.places] = np.arange(len(self.attitudes.places))
        return rows

    @cached_property
    def cells(self) -> np.ndarray:
        """Places (n) of the lowest corners of cells all of whose corners are on the grid."""
        side = self.attitudes.side
        there = (self.row_of >= 0).reshape((side,) * 3)
        whole = np.ones((side - 1,) * 3, dtype=bool)
        for a in (0, 1):
            for b in (0, 1):
                for c in (0, 1):
                    whole &= there[a : side - 1 + a, b : side - 1 + b, c : side - 1 + c]
        full = np.zeros((side,) * 3, dtype=bool)
        full[:-1, :-1, :-1] = whole
        return np.flatnonzero(full)

    def found(self, workers: int) -> tuple[State, np.ndarray]:
        """The starts, best first, and how many points of the grid settled there."""
        side = self.attitudes.side
        corners = np.array([[a, b, c] for a in (0, 1) for b in (0, 1) for c in (0, 1)]) @ [
            side**2,
            side,
            1,
        ]
        law = light_of(self.attitudes.model.vehicle, (NEAR + NODE_RAD, FAR + NODE_RAD))
        law, readings = (
            law._replace(gains=self.scale * law.gains),
            (self.data.value, self.data.used, self.data.sigma),
        )
        throttled = self.data.throttled
        frame = np.stack([self.suns, *tangent_basis(self.suns)], axis=1)
        fixed = (
            self.row_of,
            corners,
            self.turn,
            frame,
            *told(nodes(NODES), law, *readings, throttled),
            law,
            np.concatenate([self.here[None], self.data.value]),
            np.concatenate([self.here_used[None], self.data.used]),
            self.data.sigma,
            throttled,
        )
        pieces = np.array_split(self.cells, max(1, len(self.cells) // 5_000))
        with ThreadPoolExecutor(workers) as pool:
            parts = list(pool.map(lambda cells: look_through(cells, *fixed), pieces))
        rows = np.concatenate(parts)  # place, sun, x, y, z, two tangent steps, misfit
        cell, sun = rows[:, 0].astype(np.int64), rows[:, 1].astype(np.int64)
        omega = self.attitudes.rates(cell) + rows[:, 2:5] * self.attitudes.edge
        size = np.linalg.norm(omega, axis=1, keepdims=True)
        omega = omega * np.minimum(1.0, self.attitudes.model.max_rate / np.maximum(size, 1e-12))
        state = State(
            omega,
            move_on_sphere(self.suns[sun], rows[:, 5:7]),
            np.zeros((len(rows), len(self.attitudes.model.unknowns))),
        )
        best, count = _distinct(state, rows[:, 7], float(np.abs(self.data.t_s).max()))
        return state.take(best), count


def _distinct(state: State, cost: np.ndarray, reach_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Of states in one box of rate and direction, `APART` wide at `reach_s` s, the best and their number; best first."""
    order = np.argsort(cost, kind="stable")
    box = np.concatenate([state.omega[order] * (reach_s / APART), state.sun[order] / APART], axis=1)
    _, first, count = np.unique(
        np.floor(box).astype(np.int64), axis=0, return_index=True, return_counts=True
    )
    rank = np.argsort(first)
    return order[first[rank]], count[rank]


@jit
def _load(quaternions, rows, turn):
    """The rotations at the corners of a cell, with signs alike so that they can be interpolated."""
    for corner in range(8):
        for m in range(turn.shape[1]):
            same = 0.0
            for q in range(4):
                quaternions[corner, m, q] = turn[rows[corner], m, q]
                same += turn[rows[corner], m, q] * quaternions[0, m, q]
            if same < 0:
                for q in range(4):
                    quaternions[corner, m, q] = -quaternions[corner, m, q]


@jit
def _best_point(turns, sun, short, misfit):
    """The best point of an eighth of a cell, and its misfit: infinite where none will do."""
    least, best = np.inf, 0
    for point in range(8):
        worst, total = _against(turns[point], sun, short, misfit)
        if worst <= LIMIT and total < least:
            least, best = total, point
    return best, least


@jit
def _points():
    """Places in a cell: points (8, 8, 3) by the eighth that they lie in, and the middles (8, 3) of these; the weights of either."""
    points, middles = np.empty((8, 8, 3)), np.empty((8, 3))
    of_points, of_middles = np.empty((8, 8, 8)), np.empty((8, 8))
    for eighth in range(8):
        for i in range(3):
            at = 0.5 * (eighth >> (2 - i) & 1)
            middles[eighth, i] = at + 0.25
            for point in range(8):
                points[eighth, point, i] = at + 0.25 * (0.5 + (point >> (2 - i) & 1))
        _weights(middles[eighth], of_middles[eighth])
        for point in range(8):
            _weights(points[eighth, point], of_points[eighth, point])
    return points, middles, of_points, of_middles


@jit
def look_through(
    cells, row_of, corners, turn, suns, short, total, law, value, used, sigma, throttled
):
    """The settled starts of cells, (n, 8): place, direction, x, y, z in the cell, two steps of the direction, misfit. Of
    readings `value`, `used` (1 + m, n_panel) the first are the reference's."""
    room = 1024
    found = np.empty((room, 8))
    count = 0
    quaternions = np.empty((8, turn.shape[1], 4))
    middle, turns = np.empty((turn.shape[1], 3, 3)), np.empty((8, turn.shape[1], 3, 3))
    points, middles, of_points, of_middles = _points()
    for i in range(len(cells)):
        _load(quaternions, row_of[cells[i] + corners], turn)
        for eighth in range(8):
            _rotations(quaternions, of_middles[eighth], middle)
            turned = False
            for c in range(len(suns)):
                if _against(middle, suns[c, 0], short[1], total)[0] > LIMIT:
                    continue
                if not turned:  # the same for all directions
                    turned = True
                    for point in range(8):
                        _rotations(quaternions, of_points[eighth, point], turns[point])
                best, least = _best_point(turns, suns[c, 0], short[0], total)
                if least == np.inf:
                    continue
                begin = points[eighth, best]
                x, step, misfit = _settle(
                    quaternions, begin, suns[c], law, value, used, sigma, throttled
                )
                if misfit <= SETTLED and np.abs(x - middles[eighth]).max() < 0.5:
                    if count == room:
                        room *= 2
                        more = np.empty((room, 8))
                        more[:count] = found
                        found = more
                    found[count, 0], found[count, 1] = cells[i], c
                    found[count, 2:5], found[count, 5:7], found[count, 7] = x, step, misfit
                    count += 1
    return found[:count]


@jit
def _weights(x, out):
    """How much each corner (8) counts at x (3, parts of the cell)."""
    for corner in range(8):
        out[corner] = (
            (x[0] if corner & 4 else 1 - x[0])
            * (x[1] if corner & 2 else 1 - x[1])
            * (x[2] if corner & 1 else 1 - x[2])
        )


@jit
def _rotations(quaternions, weights, out):
    """The rotations (m, 3, 3) interpolated with the weights of the corners (8)."""
    for m in range(len(out)):
        a, b, c, d = 0.0, 0.0, 0.0, 0.0
        for corner in range(8):
            w = weights[corner]
            a += w * quaternions[corner, m, 0]
            b += w * quaternions[corner, m, 1]
            c += w * quaternions[corner, m, 2]
            d += w * quaternions[corner, m, 3]
        half = 2.0 / max(a * a + b * b + c * c + d * d, 1e-9)
        out[m, 0, 0], out[m, 0, 1], out[m, 0, 2] = (
            1 - half * (b * b + c * c),
            half * (a * b - c * d),
            half * (a * c + b * d),
        )
        out[m, 1, 0], out[m, 1, 1], out[m, 1, 2] = (
            half * (a * b + c * d),
            1 - half * (a * a + c * c),
            half * (b * c - a * d),
        )
        out[m, 2, 0], out[m, 2, 1], out[m, 2, 2] = (
            half * (a * c - b * d),
            half * (b * c + a * d),
            1 - half * (a * a + b * b),
        )


@jit
def told(nodes, law, value, used, sigma, throttled):
    """What speaks against all directions within each angle (2) of nodes (n, 3), for samples (m): (2, m, n); and what against the
    nodes themselves (m, n)."""
    count, low, high = len(law.turns), np.empty(len(law.gains)), np.empty(len(law.gains))
    short = np.zeros((count, len(value), len(nodes)), np.float32)
    misfit = np.zeros((len(value), len(nodes)), np.float32)
    for m in range(len(value)):
        for i in range(len(nodes)):
            x, y, z = nodes[i, 0], nodes[i, 1], nodes[i, 2]
            factor = _factor(law, nodes[i], value[m], used[m])[0] if throttled else 1.0
            for j in range(len(law.gains)):
                if used[m, j]:
                    misfit[m, i] += min(
                        (
                            (factor * law.gains[j] * seen(law, j, x, y, z)[0] - value[m, j])
                            / sigma[j]
                        )
                        ** 2,
                        1e6,
                    )
            for angle in range(count):
                for j in range(len(law.gains)):
                    low[j], high[j] = between(law, angle, j, x, y, z)
                    low[j], high[j] = (
                        law.gains[j] * low[j] * (1 - SCALE_SHARE),
                        law.gains[j] * high[j] * (1 + SCALE_SHARE),
                    )
                short[angle, m, i] = _short(low, high, value[m], used[m], sigma, throttled)
    return short, misfit


@jit
def _factor(law, r, value, used):
    """The factor with which a throttled sample fits a direction r (3) best, and the sum of squares of its powers."""
    along, size = 0.0, 0.0
    for j in range(len(law.gains)):
        if used[j]:
            power = law.gains[j] * seen(law, j, r[0], r[1], r[2])[0]
            along += power * max(value[j], 0.0)
            size += power * power
    return (along / size if size > 0 else 1.0), size


@jit
def _short(low, high, value, used, sigma, throttled):
    """What speaks against powers between bounds (n_panel); of a throttled sample against all factors on them: if any agrees with
    every reading, one does at the end of the interval that a reading allows."""
    least, n = np.inf, len(low)
    for end in range(2 * n if throttled else 1):
        factor, j = 1.0, end % n
        if throttled:
            slack = SIGMAS * sigma[j]
            bound, reach = (high[j], value[j] - slack) if end < n else (low[j], value[j] + slack)
            factor = max(reach, 0.0) / bound if used[j] and bound > 0 else 0.0
        total = 0.0
        for j in range(n):
            beyond = (
                max(factor * low[j] - value[j], value[j] - factor * high[j]) / sigma[j] - SIGMAS
            )
            if used[j] and beyond > 0:
                total += min(beyond * beyond, CAP)
        least = min(least, total)
    return least


@jit
def _against(turns, sun, short, misfit):
    """What speaks against all directions near that of a point with rotations `turns` (m, 3, 3), in the worst sample; its own
    misfit, unless the former is beyond the limit. By tables `short`, `misfit` (m, n) of nodes."""
    worst, total = 0.0, 0.0
    for m in range(len(turns)):
        t = turns[m]
        x = t[0, 0] * sun[0] + t[0, 1] * sun[1] + t[0, 2] * sun[2]
        y = t[1, 0] * sun[0] + t[1, 1] * sun[1] + t[1, 2] * sun[2]
        z = t[2, 0] * sun[0] + t[2, 1] * sun[1] + t[2, 2] * sun[2]
        node = nearest_node(NODES, x, y, z)
        worst = max(worst, short[m, node])
        if worst > LIMIT:
            break
        total += misfit[m, node]
    return worst, total


@jit
def _gather(normal, gradient, r, column, law, value, used, m, sigma, throttled, change, follows):
    """Add the readings of sample m to the normal equations; its misfit. `r` (3) is the direction, `column` (5, 3) its derivatives;
    a throttled one has its best factor. `change`, `follows` (5): room to work in."""
    misfit, factor = 0.0, 1.0
    if throttled:
        factor, size = _factor(law, r, value[m], used[m])
        follows[:] = 0.0
        for j in range(len(law.gains)):
            share, x, y, z = seen(law, j, r[0], r[1], r[2])
            if used[m, j] and share > 0:
                for i in range(5):
                    along = column[i, 0] * x + column[i, 1] * y + column[i, 2] * z
                    follows[i] += law.gains[j] ** 2 * share * along / size
    for j in range(len(law.gains)):
        share, x, y, z = seen(law, j, r[0], r[1], r[2])
        if not used[m, j] or (share <= 0 and value[m, j] <= 0):
            continue
        gain = factor * law.gains[j]
        precision = 1.0 / (sigma[j] * sigma[j] + (BLUR * gain) ** 2)
        gap = value[m, j] - gain * share
        square = precision * gap * gap
        misfit += min(square, CAP)
        weight = precision / (1.0 + square / 25.0)
        for i in range(5):
            along = column[i, 0] * x + column[i, 1] * y + column[i, 2] * z
            change[i] = -gain * (along - share * follows[i])
            gradient[i] += weight * change[i] * gap
            for q in range(i + 1):
                normal[i, q] += weight * change[i] * change[q]
    return misfit


@jit
def _solve(normal, gradient, move):
    """The step of normal equations (5, 5), of which the lower half is given and overwritten, by Cholesky's factors."""
    for i in range(5):
        for j in range(i + 1):
            value = normal[i, j]
            for q in range(j):
                value -= normal[i, q] * normal[j, q]
            normal[i, j] = np.sqrt(value) if i == j else value / normal[j, j]
    for i in range(5):
        value = -gradient[i]
        for q in range(i):
            value -= normal[i, q] * move[q]
        move[i] = value / normal[i, i]
    for i in range(4, -1, -1):
        for q in range(i + 1, 5):
            move[i] -= normal[q, i] * move[q]
        move[i] /= normal[i, i]


@jit
def _between(quaternions, m, x, q):
    """Rotation m interpolated at x (3, parts of the cell), a quaternion of any length in q[0], and its changes with x in q[1:]."""
    for k in range(4):
        q[0, k], q[1, k], q[2, k], q[3, k] = 0.0, 0.0, 0.0, 0.0
        for i in range(2):
            u, du = (x[0], 1.0) if i else (1 - x[0], -1.0)
            low, other = quaternions[4 * i, m, k], quaternions[4 * i + 2, m, k]
            slope, others = quaternions[4 * i + 1, m, k] - low, quaternions[4 * i + 3, m, k] - other
            low, other = low + x[2] * slope, other + x[2] * others
            here = low + x[1] * (other - low)
            q[0, k] += u * here
            q[1, k] += du * here
            q[2, k] += u * (other - low)
            q[3, k] += u * (slope + x[1] * (others - slope))


@jit
def _times(q, vector, out):
    """`vector` turned by the quaternion q[0], of any length."""
    a, b, c, d = q[0, 0], q[0, 1], q[0, 2], q[0, 3]
    half = 2.0 / max(a * a + b * b + c * c + d * d, 1e-9)
    x, y, z = (
        b * vector[2] - c * vector[1],
        c * vector[0] - a * vector[2],
        a * vector[1] - b * vector[0],
    )
    out[0] = vector[0] + half * (d * x + b * z - c * y)
    out[1] = vector[1] + half * (d * y + c * x - a * z)
    out[2] = vector[2] + half * (d * z + a * y - b * x)


@jit
def _change(q, i, r, out):
    """How r (3), a vector turned by the quaternion q[0], changes with that by q[i]: by a turn about the vector in q[i] times the
    conjugate of q[0]; into out[i - 1]."""
    a, b, c, d = q[0, 0], q[0, 1], q[0, 2], q[0, 3]
    e, f, g, h = q[i, 0], q[i, 1], q[i, 2], q[i, 3]
    half = 2.0 / max(a * a + b * b + c * c + d * d, 1e-9)
    x, y, z = (
        half * (d * e - h * a - f * c + g * b),
        half * (d * f - h * b - g * a + e * c),
        half * (d * g - h * c - e * b + f * a),
    )
    out[i - 1, 0], out[i - 1, 1], out[i - 1, 2] = (
        y * r[2] - z * r[1],
        z * r[0] - x * r[2],
        x * r[1] - y * r[0],
    )


@jit
def _there(quaternions, m, x, sun, frame, r, column, q):
    """The direction r (3) in sample m, 0 the reference, and its derivatives `column` (5, 3) by place in the cell and direction;
    q (4, 4): room to work in."""
    if m == 0:
        column[:3] = 0.0
        r[:], column[3], column[4] = sun, frame[1], frame[2]
        return
    _between(quaternions, m - 1, x, q)
    _times(q, sun, r)
    for i in range(3):
        _change(q, 1 + i, r, column)
    for i in range(2):
        _times(q, frame[1 + i], column[3 + i])


@jit
def _settle(quaternions, x, frame, law, value, used, sigma, throttled):
    """Least squares from x for the place in the cell and the direction: place, the direction's two steps, misfit. Where this does
    not fall fast enough to become `SETTLED` it ends early."""
    x, step, sun = x.copy(), np.zeros(2), frame[0].copy()
    r, column, q, change, follows = (
        np.empty(3),
        np.empty((5, 3)),
        np.empty((4, 4)),
        np.empty(5),
        np.zeros(5),
    )
    normal, gradient, move = np.empty((5, 5)), np.empty(5), np.empty(5)
    misfit, arrived = np.inf, False
    for iteration in range(STEPS + 1):
        normal[:], gradient[:] = 0.0, 0.0
        before, misfit = misfit, 0.0
        for m in range(len(value)):
            _there(quaternions, m, x, sun, frame, r, column, q)
            misfit += _gather(
                normal, gradient, r, column, law, value, used, m, sigma, throttled, change, follows
            )
        if (
            iteration > 1
            and misfit - (STEPS - iteration) * FASTER * max(before - misfit, 0.0) > SETTLED
        ):
            break
        if iteration == STEPS or arrived:
            break
        for i in range(5):
            normal[i, i] += 1e-2 * normal[i, i] + 1e-3
        _solve(normal, gradient, move)
        longest, across = (
            max(abs(move[0]), abs(move[1]), abs(move[2])),
            max(abs(move[3]), abs(move[4])),
        )
        size = max(longest / 0.25, across / 0.3, 1.0)
        arrived = max(longest, across) < ARRIVED
        for i in range(3):
            x[i] = min(1.2, max(-0.2, x[i] + move[i] / size))
        for i in range(2):
            step[i] += move[3 + i] / size
        for i in range(3):
            sun[i] = (frame[0, i] + step[0] * frame[1, i] + step[1] * frame[2, i]) / np.sqrt(
                1 + step[0] ** 2 + step[1] ** 2
            )
    length = np.sqrt(step[0] ** 2 + step[1] ** 2)
    if length > 0:
        step *= np.arctan(length) / length
    return x, step, misfit
