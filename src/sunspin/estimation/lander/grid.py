"""Where the search for a lander's motions begins: the reference, and a grid of rates there.

The attitude that the body has reached at the samples next to the reference is computed on a grid of rates, fine enough to be
interpolated. Every cell of the grid is looked through on points a quarter of its edge apart. The best of each eighth is taken,
unless no direction near it agrees with the readings. From there least squares on interpolated attitudes find the nearest
solution: a motion has a start within an eighth of a cell. The initial direction does not enter the runs: they give rotations.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from sunspin.base.errors import InputError
from sunspin.dynamics import batch, gyrostat
from sunspin.estimation.lander.model import LanderModel
from sunspin.estimation.lander.motions import Shots, Trials
from sunspin.estimation.settings import GridSettings
from sunspin.estimation.terms.powers import PanelPowers
from sunspin.solve.rotations import cross, move_on_sphere, tangent_basis
from sunspin.vehicle.response.planes import sphere

TRIAL_ERROR = 1e-3
"""Error of a direction (rad) on the grid."""

DARK_SLOPE = 0.1
"""A dark panel has a slope up to this cosine beyond its edge, so that a start finds into the light."""

CELLS_AT_ONCE = 1500
"""Cells that are looked through together."""

CORNERS = np.array(list(product((0, 1), repeat=3)))
"""Corners (8, 3) of a cell, and its eighths and the points in one, in the same order."""

MIDDLES = 0.25 + 0.5 * CORNERS
"""Middles (8, 3) of the eighths of a cell, in parts of its edge."""

POINTS = 0.5 * CORNERS[:, None] + 0.25 * (0.5 + CORNERS)
"""Points (8 eighths, 8, 3) by which a cell is looked through."""


@dataclass(frozen=True)
class Place:
    """Where the search begins.

    `sample`: the reference, `after_s` after the first sample; `window`: it and its neighbours `tried`, which are in `others` (m);
    `edge`: step of the grid (rad/s); `suns` (c, 3): directions to the Sun at the reference; `limit` (rad/s): rates searched there;
    `max_rate`: ball of rates at the reference that holds what comes of the prior's, `given`, at the first sample, at which no
    motion is faster than `fastest`.
    """

    sample: int
    after_s: float
    window: slice
    others: np.ndarray
    edge: float
    suns: np.ndarray
    limit: float
    max_rate: float
    fastest: float
    given: float

    @property
    def notes(self) -> list[str]:
        """Return what the verdict has to say if not all rates can be searched."""
        if self.limit >= self.max_rate * (1 - 1e-9):
            return []
        return [f"only rates up to {np.degrees(self.limit):.3g} deg/s could be searched"]

    def about(self, model: LanderModel) -> LanderModel:
        """Return a model with its reference here."""
        return model.after(self.after_s, self.max_rate)


# ---- the reference ---------------------------------------------------------------------------------------------------------


def reference(model: LanderModel, s: GridSettings, given_rate: bool = False) -> Place:
    """Return the reference from which the search is the shortest, of those samples at which no wheel can have stopped.

    `given_rate`: the largest rate is the caller's, and refused if it asks for more starts than can be tried.
    """
    place, asked = _shortest(model, s)
    if given_rate and asked > s.most_starts:
        smaller, enough = model, place
        starts = asked
        while starts > s.most_starts:
            # with a smaller ball another reference may be the best one
            limit = 0.99 * largest_ball(s.most_starts / len(enough.suns), enough.edge)
            smaller = replace(smaller, max_rate=float(f"{limit:.3g}"))
            enough, starts = _shortest(smaller, s)
        what = f"max_rate_rad_s asks for {asked:.2g} starts, and {s.most_starts:.0e} at most can be tried in an hour"
        raise InputError(
            what,
            got=f"{model.max_rate:g}",
            do=f"with these samples give {smaller.max_rate:.3g} at most",
        )
    ends = place.about(model).obs.t_s
    _require_computable(place.about(model), ends, min(place.limit, place.max_rate))
    return place


def _shortest(model: LanderModel, s: GridSettings) -> tuple[Place, float]:
    """Return the place with the shortest search, and how many starts it has.

    Starts take time, and so do motions that fit the first few samples. These are about as many as the directions that they allow,
    times the volume of rates in units of the inverse of the time that they reach. It is half as long from the middle of a file.
    """
    t_s, panels = model.obs.t_s, model.panels
    read = np.flatnonzero(panels.present())
    lit = np.flatnonzero(panels.lit.any(axis=1))
    choices = [k for k in lit if _wheels_run(model, t_s[k], s)] or [lit[0]]
    slow = [k for k in choices if model.spun_up(t_s[k]) <= s.most_spun * model.max_rate]
    choices = slow or choices[:1]
    even = np.linspace(0, len(choices) - 1, s.choices).round().astype(int)
    suns: dict[int, np.ndarray] = {}
    best: tuple[float, Place, float] | None = None
    for sample in (choices[i] for i in np.unique(even)):
        near = read[np.argsort(np.abs(t_s[read] - t_s[sample]), kind="stable")[: s.few]]
        for k in (*near, sample):
            if k not in suns:
                suns[k] = possible_directions(panels, k, s)
        at = int(np.searchsorted(read, sample))
        first = min(max(at - 1, 0), max(len(read) - 3, 0))
        tried = read[first : first + 3]
        others = tried[tried != sample]
        after = float(t_s[sample])
        edge = s.turn_rad / (s.amplified * float(np.abs(t_s[others] - after).max()))
        if model.vehicle.channels:
            edge = min(edge, s.shared_edge * model.max_rate)
        ball, fastest = _balls(model, after, s)
        reach = float(np.abs(t_s[near] - after).max())
        took = s.start_cost * len(suns[sample]) * cell_count(ball, edge)
        allowed = np.prod([len(suns[k]) for k in near], dtype=float)
        took += s.window_cost * (fastest * reach) ** 3 * allowed
        if best is not None and took >= best[0]:
            continue
        limit = min(model.max_rate, largest_ball(s.most_cells / len(suns[sample]), edge))
        place = Place(
            int(sample),
            after,
            slice(int(tried[0]), int(tried[-1]) + 1),
            others,
            edge,
            suns[sample],
            # the whole ball that comes of the prior's, unless even the prior's cannot be searched
            limit if limit < model.max_rate else ball,
            ball,
            fastest,
            model.max_rate,
        )
        best = took, place, cell_count(model.max_rate, edge) * len(suns[sample])
    assert best is not None
    return best[1], best[2]


def _wheels_run(model: LanderModel, after_s: float, s: GridSettings) -> bool:
    """Return whether every wheel still has a good part of its speed then, so that motions can be followed back through it."""
    none = np.zeros((1, len(model.unknowns)))
    first, then = model.wheel_speeds(none), replace(model, after_s=after_s).wheel_speeds(none)
    commands = batch.one_command(model.vehicle, model.wheel_mode)
    held = np.array([command == "hold" for command in commands], dtype=bool)
    return after_s == 0.0 or bool(np.all((np.abs(then) > s.speed_left * np.abs(first)) | held))


def _balls(model: LanderModel, after_s: float, s: GridSettings) -> tuple[float, float]:
    """Return a largest rate at a reference that holds what comes of the prior's ball, and one at the first sample (rad/s).

    Wheels that run down hand over their momentum, and unequal moments let the speed vary: the ball's edge moves, and a truth beyond
    it would be lost. But most motions of the wider ball began beyond the largest rate. Those that did by more than what friction is
    not known by are left out.
    """
    if after_s == 0.0:
        return model.max_rate, s.faster_at_first * model.max_rate
    moments = np.linalg.eigvalsh(model.vehicle.require_inertia())
    spun = model.spun_up(after_s)
    stretch = float(np.clip(np.sqrt(moments[-1] / moments[0]), 1.05, 1.5))
    return (
        model.max_rate * stretch + 1.3 * spun,
        s.faster_at_first * model.max_rate + s.spun_unsure * spun,
    )


def cell_count(limit: float, edge: float) -> float:
    """Return about how many cells a ball of rates has."""
    return 4 / 3 * np.pi * (limit / edge + 1.0) ** 3


def largest_ball(cells: float, edge: float) -> float:
    """Return the limit (rad/s) of a ball of rates that has about so many cells."""
    return edge * ((cells / (4 / 3 * np.pi)) ** (1 / 3) - 1)


def _require_computable(model: LanderModel, t_s: np.ndarray, rate_rad_s: float) -> None:
    """Refuse samples (s from the reference) over which the nominal body, at this rate, needs too many steps.

    A wheel at a speed in the wrong unit does that. The sentence names a window that is short enough.
    """
    omega = np.full((1, 3), rate_rad_s / np.sqrt(3))
    nominal = Shots(omega, np.array([[0.0, 0.0, 1.0]]), np.zeros((1, len(model.unknowns))))
    rows = model.rows(nominal)
    commands = batch.one_command(model.vehicle, model.wheel_mode)
    problem = batch.Problem(model.vehicle, rows, commands, model.acting)
    part = 1.0
    while any(
        batch.steps_needed(problem, part * end)[0] > batch.MAX_STEPS
        for end in (t_s.min(), t_s.max())
    ):
        part /= 2
    if part < 1.0:
        span, speeds = float(np.ptp(t_s)), np.abs(rows.wheel_speed_rad_s).max(initial=0.0)
        raise InputError(
            f"the motion over the {span:.6g} s of the samples needs too many steps",
            got=f"rates up to {rate_rad_s:.3g} rad/s, wheels at {speeds:.3g} rad/s",
            do=f"use {part * span:.3g} s of them at most with --from and --to (begin_s, end_s), or check wheel speeds and inertias",
        )


# ---- what readings allow ---------------------------------------------------------------------------------------------------


def possible_directions(panels: PanelPowers, sample: int, s: GridSettings) -> np.ndarray:
    """Return directions to the Sun (c, 3), spaced evenly, that the readings of a sample allow; best first."""
    here = panels.take(slice(sample, sample + 1))
    around = sphere(s.directions)
    light = panels.brightness * panels.response.power(around)[:, None]
    if panels.throttled:
        light = here.best_factor(light)[0] * light
    full = panels.brightness * panels.response.power(panels.response.facing_B).diagonal()
    tolerance = np.hypot(s.sigmas * panels.sigma, s.brightness * full)
    square = np.minimum(((light[:, 0] - here.power[0]) / tolerance) ** 2, s.cap)
    misfit = square @ here.used[0]
    order = np.argsort(misfit, kind="stable")
    allowed = around[order][misfit[order] < misfit.min() + 1.0]
    # the farthest from all that are kept is kept next, until each is near one of them
    kept, nearest = allowed[:1], allowed @ allowed[0]
    while nearest.min() < np.cos(s.directions_rad):
        kept = np.concatenate([kept, allowed[[np.argmin(nearest)]]])
        nearest = np.maximum(nearest, allowed @ kept[-1])
    return kept


def shortfall(
    panels: PanelPowers, sun_B: np.ndarray, angle_rad: float, s: GridSettings
) -> np.ndarray:
    """Return by how much (K, n) readings contradict all directions within an angle of `sun_B` (K, n, 3).

    Of throttled samples all factors are tried on which a reading may decide: if any agrees with all, one at the end of the interval
    that a reading allows does.
    """
    low, high = panels.response.bounds(sun_B, angle_rad)
    low = panels.brightness * low * (1 - s.brightness)
    high = panels.brightness * high * (1 + s.brightness)
    slack = s.sigmas * panels.sigma
    factors: list[np.ndarray | float] = [1.0]
    if panels.throttled:
        factors = []
        for bound, value in ((high, panels.power - slack), (low, panels.power + slack)):
            usable = panels.used & (bound > 0)
            ends = np.divide(
                np.maximum(value, 0.0) + np.zeros_like(bound),
                bound,
                out=np.zeros_like(bound),
                where=usable,
            )
            factors += list(np.moveaxis(ends, -1, 0)[..., None])
    least = np.full(low.shape[:2], np.inf)
    for factor in factors:
        short = np.maximum(factor * low - panels.power, panels.power - factor * high)
        beyond = np.maximum(short / panels.sigma - s.sigmas, 0.0)
        square = np.where(panels.used, np.minimum(beyond**2, s.cap), 0.0).sum(axis=2)
        least = np.minimum(least, square)
    return least


class Nodes:
    """Directions on the faces of a cube, by which readings are compared with any direction once and for all."""

    def __init__(self, size: int) -> None:
        """Place (size + 1)^2 nodes on each of the faces +x, -x, +y, -y, +z, -z, along the next two axes."""
        self.size = size
        side = np.linspace(-1, 1, size + 1)
        row, column = np.meshgrid(side, side, indexing="ij")
        faces = []
        for axis, sign in product(range(3), (1.0, -1.0)):
            face = np.empty((size + 1, size + 1, 3))
            face[..., axis], face[..., (axis + 1) % 3] = sign, row
            face[..., (axis + 2) % 3] = column
            faces.append(face.reshape(-1, 3))
        every = np.concatenate(faces)
        self.directions = every / np.linalg.norm(every, axis=1, keepdims=True)

    def nearest(self, direction: np.ndarray) -> np.ndarray:
        """Return the index (...) of the node nearest to each direction (..., 3)."""
        shape, flat = direction.shape[:-1], direction.reshape(-1, 3)
        axis = np.argmax(np.abs(flat), axis=1)
        top, row, column = (
            np.take_along_axis(flat, (axis[:, None] + k) % 3, axis=1)[:, 0] for k in range(3)
        )
        length = np.maximum(np.abs(top), 1e-300)
        i, j = (
            np.rint((part / length + 1) * (self.size / 2)).astype(np.int64)
            for part in (row, column)
        )
        face = 2 * axis + (top < 0)
        return (face * (self.size + 1) ** 2 + i * (self.size + 1) + j).reshape(shape)


# ---- starts ----------------------------------------------------------------------------------------------------------------


def grid_starts(
    model: LanderModel, place: Place, s: GridSettings, workers: int = 1
) -> Iterator[tuple[slice, Trials]]:
    """Yield the window about the reference, with motions near each one that its readings allow, best first.

    `model`: with its reference at `place`. Torques hardly move a body in three samples, and inertia, friction and wheel are those
    of the nominal body. If no start settles, rest and rotations about the axes are tried, so that the verdict can say by how much
    no motion fits.
    """
    bare = replace(model, frame="", max_rate=place.limit)
    grid = RateGrid.of(bare, place)
    look = LookThrough(grid, bare.panels, place, s)
    pieces = np.array_split(grid.cells, max(1, -(-len(grid.cells) // CELLS_AT_ONCE)))
    with ThreadPoolExecutor(workers) as pool:
        omega, sun, misfit = (
            np.concatenate(part)
            for part in zip(*pool.map(look.settled_starts, pieces), strict=True)
        )
    size = np.linalg.norm(omega, axis=1, keepdims=True)
    omega = omega * np.minimum(1.0, place.limit / np.maximum(size, 1e-12))
    # of starts in one box of rate and direction the best
    order = np.argsort(misfit, kind="stable")
    reach_s = float(np.abs(grid.times_s).max())
    box = np.concatenate([omega[order] * reach_s, sun[order]], axis=1) / s.apart_rad
    _, first, count = np.unique(
        np.floor(box).astype(np.int64), axis=0, return_index=True, return_counts=True
    )
    rank = np.argsort(first)
    best = order[first[rank]]
    shots = Shots(omega[best], sun[best], np.zeros((len(best), len(model.unknowns))))
    slow = bare.first_speed(shots, TRIAL_ERROR) <= place.fastest
    starts = Trials(shots.take(slow), count[rank][slow])
    yield place.window, starts if len(starts) else _anything(model, place)


def _anything(model: LanderModel, place: Place) -> Trials:
    """Return starts if there is no hope: rest, and rotations about the axes."""
    axes = np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    omega = axes * min(0.3, 0.5 * model.max_rate) + 1e-4
    sun = np.tile(place.suns[0], (len(omega), 1))
    shots = Shots(omega, sun, np.zeros((len(omega), len(model.unknowns))))
    return Trials(shots, np.ones(len(omega), dtype=np.int64))


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
    def of(cls, model: LanderModel, place: Place) -> RateGrid:
        """Return the grid of a model with its reference at a place, from runs of the nominal body."""
        times = model.obs.t_s[place.others]
        side = 2 * int(np.ceil(place.limit / place.edge)) + 1
        axis = (np.arange(side) - side // 2) * place.edge
        square = axis[:, None, None] ** 2 + axis[None, :, None] ** 2 + axis**2
        points = np.flatnonzero(square <= (place.limit + np.sqrt(3) * place.edge) ** 2)
        row_of = np.full(side**3, -1, dtype=np.int64)
        row_of[points] = np.arange(len(points))
        whole = cls(times, place.edge, side, row_of, np.zeros((0, len(times), 4)))
        return replace(whole, turn=_attitudes(model, whole.rates(points), times))

    def rates(self, points: np.ndarray) -> np.ndarray:
        """Return the rates (n, 3) at points of the cube, by index."""
        index = np.stack(np.unravel_index(points, (self.side,) * 3), axis=-1)
        return (index - self.side // 2) * self.edge

    @cached_property
    def cells(self) -> np.ndarray:
        """Return the indices of the lowest corners of cells all of whose corners are on the grid."""
        exists = (self.row_of >= 0).reshape((self.side,) * 3)
        whole = np.zeros_like(exists)
        last = self.side - 1
        whole[:-1, :-1, :-1] = True
        for a, b, c in CORNERS:
            whole[:-1, :-1, :-1] &= exists[a : last + a, b : last + b, c : last + c]
        return np.flatnonzero(whole)

    def corners(self, cells: np.ndarray) -> np.ndarray:
        """Return the attitudes (n, 8, m, 4) at the corners of cells, with signs alike so that they can be interpolated."""
        away = CORNERS @ [self.side**2, self.side, 1]
        turn = self.turn[self.row_of[cells[:, None] + away]]
        opposite = np.sum(turn * turn[:, :1], axis=-1, keepdims=True) < 0
        return np.where(opposite, -turn, turn)


def _attitudes(model: LanderModel, omega: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return the rotations (n, m, 4) of the nominal body at times (m), from rates (n, 3) at the reference.

    A run carries one inertial direction, and the momentum is another: with one across it, a frame before and after.
    """
    omega = omega + 1e-6 * model.max_rate  # no row is exactly at rest
    none = np.zeros((len(omega), len(model.unknowns)))
    speeds = model.wheel_speeds(none[:1])
    momentum = gyrostat.total_momentum(
        model.vehicle, omega, np.broadcast_to(speeds, (len(omega), speeds.shape[1]))
    )
    along = momentum / np.linalg.norm(momentum, axis=1, keepdims=True)
    across = tangent_basis(along)[0]
    frame = np.stack([along, across, cross(along, across)], axis=2)
    rows = model.rows(Shots(omega, across, none))
    turn = np.empty((len(omega), len(times), 4))
    for i, t in enumerate(times):
        moved = model.run(rows, np.array([t]), TRIAL_ERROR)
        h, r = moved.momentum_B[:, 0], moved.sun_B[:, 0]
        with np.errstate(invalid="ignore"):
            h = h / np.linalg.norm(h, axis=1, keepdims=True)
            there = np.stack([h, r, cross(h, r)], axis=2)
            matrix = there @ np.swapaxes(frame, 1, 2)
        matrix[~np.isfinite(matrix).all(axis=(1, 2))] = np.eye(3)
        turn[:, i] = Rotation.from_matrix(matrix).as_quat()
    return turn


def corner_weights(x: np.ndarray) -> np.ndarray:
    """Return how much each corner counts (..., 8) at places x (..., 3) of a cell, in parts of its edge."""
    sides = np.where(CORNERS, x[..., None, :], 1 - x[..., None, :])
    return np.prod(sides, axis=-1)


def corner_slopes(x: np.ndarray) -> np.ndarray:
    """Return the derivatives (..., 8, 3) of :func:`corner_weights` by the place."""
    sides = np.where(CORNERS, x[..., None, :], 1 - x[..., None, :])
    signs = np.where(CORNERS, 1.0, -1.0)
    others = sides[..., [1, 0, 0]] * sides[..., [2, 2, 1]]
    return signs * others


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


class LookThrough:
    """Readings of the reference and of the samples next to it, against the cells of a grid of rates."""

    def __init__(self, grid: RateGrid, panels: PanelPowers, place: Place, s: GridSettings) -> None:
        """Compare the readings of all nodes of the sphere with those of the samples."""
        self.grid, self.place, self.s = grid, place, s
        samples = np.array([place.sample, *place.others])
        self.panels = panels.take(samples)  # the reference first
        full = panels.response.power(panels.response.facing_B).diagonal()
        self.full = panels.brightness * full
        self.nodes = Nodes(s.nodes)
        others = panels.take(place.others)
        seen = np.broadcast_to(
            self.nodes.directions[:, None], (len(self.nodes.directions), len(place.others), 3)
        )
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
        s, turn = self.s, self.grid.corners(cells)
        tangents = np.stack(tangent_basis(self.place.suns), axis=1)
        # the middle of each eighth of a cell, for each direction: does any direction near it agree?
        middles = self._interpolated(turn[:, None], corner_weights(MIDDLES))
        cell, eighth, sun = self._agreeing(middles)
        at = corner_weights(POINTS)[eighth]  # (S, 8 points, 8 corners)
        points = self._interpolated(turn[cell][:, None], at)
        directions = rotated(points, self.place.suns[sun][:, None, None])
        worst, total = self._against(directions, self.short_near)
        total[worst > s.limit] = np.inf
        best = np.argmin(total, axis=1)
        some = np.isfinite(total[np.arange(len(total)), best])
        cell, eighth, sun, best = cell[some], eighth[some], sun[some], best[some]
        starts = Settling(
            turn[cell],
            self.place.suns[sun],
            tangents[sun],
            POINTS[eighth, best],
            np.zeros((len(cell), 2)),
        )
        starts, misfit = self.settle(starts)
        near = np.abs(starts.x - MIDDLES[eighth]).max(axis=1, initial=0.0) < 0.5
        settled = near & (misfit <= s.settled)
        starts, cell = starts.take(settled), cell[settled]
        omega = self.grid.rates(cells[cell]) + starts.x * self.grid.edge
        length = np.linalg.norm(starts.step, axis=1, keepdims=True)
        angle = np.divide(np.arctan(length), length, out=np.ones_like(length), where=length > 0)
        return omega, move_on_sphere(starts.sun, starts.step * angle), misfit[settled]

    def _interpolated(self, turn: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return attitudes (n, p, m, 4), of any length, interpolated between corners (n, 1, 8, m, 4) with weights (.., p, 8)."""
        flat = turn.reshape(len(turn), 8, -1)
        weighted = weights @ flat
        return weighted.reshape(*weighted.shape[:2], -1, 4)

    def _agreeing(self, middles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return cells, eighths and directions, by index, whose middles (n, 8, m, 4) the readings do not contradict."""
        found = []
        for k, sun in enumerate(self.place.suns):
            worst, _ = self._against(rotated(middles, sun), self.short_far)
            cell, eighth = np.nonzero(worst <= self.s.limit)
            found.append(np.stack([cell, eighth, np.full(len(cell), k)]))
        cell, eighth, sun = np.concatenate(found, axis=1)
        return cell, eighth, sun

    def _against(self, directions: np.ndarray, short: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return by how much readings contradict all directions near (n, p, m, 3), worst sample (n, p), and the misfit (n, p)."""
        node = self.nodes.nearest(directions)
        m = np.arange(len(short))
        return short[m, node].max(axis=2), self.misfit[m, node].sum(axis=2)

    def settle(self, starts: Settling) -> tuple[Settling, np.ndarray]:
        """Return starts after least squares for place and direction, and their misfits (S).

        Those whose misfit does not fall fast enough to become small end early.
        """
        s = self.s
        x, step, misfit = starts.x.copy(), starts.step.copy(), np.full(len(starts.x), np.inf)
        going = np.arange(len(x))
        for left in range(s.steps, -1, -1):
            if not len(going):
                break
            now = starts.take(going)._replace(x=x[going], step=step[going])
            after, normal, gradient = self._equations(now)
            gained, misfit[going] = np.maximum(misfit[going] - after, 0.0), after
            if left == 0:
                break
            if left < s.steps - 1:
                hopeful = after - left * s.faster * gained <= s.settled
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
        sun, slope = self._directions(now)
        slopes = panels.response.slopes(sun)
        light, to_sun = panels.brightness * slopes.power, panels.brightness * slopes.to_sun
        # a dark input near its edge has the slope of its light, so that a start finds into it
        facing = panels.response.facing_B
        dark = (light <= 0) & (sun @ facing.T > -DARK_SLOPE)
        to_sun = np.where(dark[..., None], self.full[:, None] * facing, to_sun)
        change = to_sun @ slope
        factor: np.ndarray | float = 1.0
        if panels.throttled:
            factor, weight = panels.best_factor(light)
            size = np.sum(weight * light**2, axis=-1)[..., None, None]
            part = np.sum((weight * light)[..., None] * change, axis=-2, keepdims=True)
            share = np.divide(part, size, out=np.zeros_like(part), where=size > 0)
            light, change = (
                factor * light,
                factor[..., None] * (change - light[..., None] * share),
            )
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

    def _directions(self, now: Settling) -> tuple[np.ndarray, np.ndarray]:
        """Return the directions to the Sun (S, 1 + m, 3), the reference first, and their derivatives (S, 1 + m, 3, 5)."""
        count, others = len(now.x), now.turn.shape[2]
        here = now.sun + np.einsum("sa,sai->si", now.step, now.tangents)
        here /= np.linalg.norm(here, axis=1, keepdims=True)
        flat = now.turn.reshape(count, 8, -1)
        q = (corner_weights(now.x)[:, None] @ flat).reshape(count, others, 4)
        by_x = (np.swapaxes(corner_slopes(now.x), 1, 2) @ flat).reshape(count, 3, others, 4)
        sun = np.empty((count, 1 + others, 3))
        slope = np.zeros((count, 1 + others, 3, 5))
        sun[:, 0], slope[:, 0, :, 3:] = here, np.swapaxes(now.tangents, 1, 2)
        there = rotated(q, here[:, None])
        sun[:, 1:] = there
        for a in range(2):
            slope[:, 1:, :, 3 + a] = rotated(q, now.tangents[:, None, a])
        # a change p of a quaternion q turns by twice the vector part of p q* over |q|^2
        half = np.sum(q**2, axis=-1, keepdims=True)[:, None]
        v, w = q[:, None, :, :3], q[:, None, :, 3:]
        dv, dw = by_x[..., :3], by_x[..., 3:]
        turn = 2.0 * (w * dv - dw * v - cross(dv, v)) / half
        slope[:, 1:, :, :3] = np.moveaxis(cross(turn, there[:, None]), 1, -1)
        return sun, slope
