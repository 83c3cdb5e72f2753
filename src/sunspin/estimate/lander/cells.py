"""The compiled search for starts in the cells of a grid of rates: comparison with the readings, and least squares.

A cell is a cube of rates at the reference. At its eight corners the attitudes at m other samples are known, and in it quaternions
are interpolated. A start is a rate, by its place x (3) in a cell in parts of the edge, and a direction to the Sun at the reference,
by the index of a direction and a step (2) from it in its tangent plane. Begin to read at :func:`search_cells`, the last function.
`tests/estimate/plain_cells.py` does the same in NumPy.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from sunspin.dynamics.processor import cached, compiled, digest
from sunspin.estimate.terms.powers import HALF_WEIGHT, ROUNDS, PanelPowers
from sunspin.vehicle.response.joined import JoinedResponse

DARK_SLOPE = 0.1
"""A panel that was read as lit gets a derivative up to this cosine beyond its edge, so that least squares moves it into the
light."""

SOFT_SIGMAS = 5.0
"""A residual far beyond this many sigmas has little weight in least squares: the reading may be an outlier."""

DAMPING, LEAST_DAMPING = 1e-2, 1e-3
"""Part of the curvature that damps a step by which a start settles, and the least damping."""

LONGEST_PLACE, LONGEST_TURN = 0.25, 0.3
"""Longest step of a place, in parts of the edge, and of a direction, rad."""

FARTHEST_PLACE, KEPT_PLACE = 0.2, 0.5
"""Limits in parts of the edge: of a place outside its cell, and of a settled start from the middle of its eighth. Farther starts
are dropped, as the start of a neighbouring eighth ends at the same motion."""

START_SIZE = 8
OF_CELL, OF_SUN, OF_PLACE, OF_STEP, OF_MISFIT = 0, 1, slice(2, 5), slice(5, 7), 7
"""Columns of a start: index of its cell, index of its direction, place (3), step (2), misfit."""

COORDINATES = 5
"""Of a start in least squares: place (3), then step (2)."""


class PanelTable(NamedTuple):
    """Panels and what they read, as compiled code takes them: p inputs, each of one panel or several.

    `first` (p + 1): the panels of input j are `first[j]` to `first[j + 1]`; `rows` (n_panel, 3): normal times power in full Sun;
    `largest` (p): the input reads the largest of its panels, not their sum; `facing` (p, 3), `full` (p): direction and power of
    its largest reading. `power`, `used` (1 + m, p): readings, those of the reference first; `sigma` (p); `throttled` as in
    :class:`PanelPowers`.
    """

    first: np.ndarray
    rows: np.ndarray
    largest: np.ndarray
    facing: np.ndarray
    full: np.ndarray
    power: np.ndarray
    used: np.ndarray
    sigma: np.ndarray
    throttled: bool

    @classmethod
    def of(cls, panels: PanelPowers) -> PanelTable:
        """Return the panels and readings of some samples."""
        response = panels.response
        count = len(response.gains)
        members, largest = [np.array([k]) for k in range(count)], [False] * count
        if isinstance(response, JoinedResponse):
            members = [np.array(joined.panels) for joined in response.inputs]
            largest = [joined.largest for joined in response.inputs]
        order = np.concatenate(members)
        rows = panels.brightness * response.gains[order, None] * response.normals_B[order]
        full = panels.brightness * response.power(response.facing_B).diagonal()
        first = np.cumsum([0, *(len(panels_of) for panels_of in members)])
        facing, power, used, sigma = response.facing_B, panels.power, panels.used, panels.sigma
        arrays = (first, rows, np.array(largest), facing, full, power, used, sigma)
        return cls(*(np.ascontiguousarray(array) for array in arrays), panels.throttled)


class Tables(NamedTuple):
    """Comparison of the readings of m samples with n directions, the nodes: arrays (m, n) of float32, computed once.

    `near`, `far`: by how much the readings contradict all directions within `near_rad` or `far_rad` (:class:`GridSettings`) of the
    node; `misfit`: sum of squares of the node itself.
    """

    near: np.ndarray
    far: np.ndarray
    misfit: np.ndarray


class Limits(NamedTuple):
    """Fields of :class:`~sunspin.estimate.settings.GridSettings` that compiled code takes."""

    nodes: int
    limit: float
    blur_rad: float
    cap: float
    settled: float
    steps: int
    gain_left: float


class Cells(NamedTuple):
    """Cells in which starts are sought.

    `lowest` (c): index of the lowest corner of each in the cube of a :class:`RateGrid`, `away` (8): what is added for each corner;
    `row_of`, `turn` as there. `suns` (s, 3, 3): directions at the reference, each with two tangents. `middles` (8, 3), `points` (8,
    8, 3): middles of the eighths of a cell, and places in each eighth.
    """

    lowest: np.ndarray
    away: np.ndarray
    row_of: np.ndarray
    turn: np.ndarray
    suns: np.ndarray
    middles: np.ndarray
    points: np.ndarray


class Workspace(NamedTuple):
    """Arrays that compiled code overwrites for each start.

    `q` (4, 4): quaternion of the attitude at a sample and its changes by the place. `here` (3, 3): direction at the reference and
    its changes by the step; `sun` (3), `slope` (5, 3): direction at a sample and its changes by place and step. `light` (p),
    `change` (p, 5): power of each input and its changes; `follows` (5): the part by which a throttled sample's factor falls.
    `normal` (5, 5), `gradient` (5): normal equations, solved by `move` (5).
    """

    q: np.ndarray
    here: np.ndarray
    sun: np.ndarray
    slope: np.ndarray
    light: np.ndarray
    change: np.ndarray
    follows: np.ndarray
    normal: np.ndarray
    gradient: np.ndarray
    move: np.ndarray


# ---- attitudes -------------------------------------------------------------------------------------------------------------


@compiled
def load_corners(cells, cell, corners):
    """Write the quaternions at the corners of a cell (8, m, 4), with the sign of q or -q that is nearer to that of the first."""
    for c in range(8):
        row = cells.row_of[cell + cells.away[c]]
        for m in range(corners.shape[1]):
            alike = 0.0
            for k in range(4):
                corners[c, m, k] = cells.turn[row, m, k]
                alike += corners[c, m, k] * corners[0, m, k]
            if alike < 0:
                for k in range(4):
                    corners[c, m, k] = -corners[c, m, k]


@compiled
def interpolate(corners, m, x, q):
    """Write into q[0] the quaternion of sample m at place x, and into q[1:] its derivatives by x: trilinear, over z, y and x.

    Corner 4 a + 2 b + c is that at the end a of x, b of y and c of z.
    """
    for k in range(4):
        for a in range(2):  # the sides of the cell at x = 0 and x = 1
            low, high = corners[4 * a, m, k], corners[4 * a + 2, m, k]
            rise_low, rise_high = corners[4 * a + 1, m, k] - low, corners[4 * a + 3, m, k] - high
            low, high = low + x[2] * rise_low, high + x[2] * rise_high
            value, by_y = low + x[1] * (high - low), high - low
            by_z = rise_low + x[1] * (rise_high - rise_low)
            if a == 0:
                q[0, k], q[1, k], q[2, k], q[3, k] = value, -value, by_y, by_z
            else:
                q[1, k] += value
                q[0, k] += x[0] * (value - q[0, k])
                q[2, k] += x[0] * (by_y - q[2, k])
                q[3, k] += x[0] * (by_z - q[3, k])


@compiled
def rotate(q, vector, out):
    """Write into `out` a vector rotated by the quaternion q (4), scalar last, of any length."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    twice = 2.0 / max(x * x + y * y + z * z + w * w, 1e-9)
    a = twice * (y * vector[2] - z * vector[1])
    b = twice * (z * vector[0] - x * vector[2])
    c = twice * (x * vector[1] - y * vector[0])
    out[0] = vector[0] + w * a + y * c - z * b
    out[1] = vector[1] + w * b + z * a - x * c
    out[2] = vector[2] + w * c + x * b - y * a


@compiled
def turned_by(q, change, vector, out):
    """Write the change of a rotated vector if its quaternion q (4) changes: a turn by twice the vector part of change q* / q q*."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    half = 2.0 / max(x * x + y * y + z * z + w * w, 1e-9)
    a = half * (w * change[0] - change[3] * x - change[1] * z + change[2] * y)
    b = half * (w * change[1] - change[3] * y - change[2] * x + change[0] * z)
    c = half * (w * change[2] - change[3] * z - change[0] * y + change[1] * x)
    out[0], out[1], out[2] = (
        b * vector[2] - c * vector[1],
        c * vector[0] - a * vector[2],
        a * vector[1] - b * vector[0],
    )


@compiled
def nearest_node(size, x, y, z):
    """Return the index of the node nearest to a direction, in the order of :func:`sunspin.estimate.lander.allowed.cube_nodes`."""
    along = (abs(x), abs(y), abs(z))
    if along[0] >= along[1] and along[0] >= along[2]:
        axis, top, row, column = 0, x, y, z
    elif along[1] >= along[2]:
        axis, top, row, column = 1, y, z, x
    else:
        axis, top, row, column = 2, z, x, y
    length = max(abs(top), 1e-300)
    i = int(np.rint((row / length + 1) * (size / 2)))
    j = int(np.rint((column / length + 1) * (size / 2)))
    face = 2 * axis + (1 if top < 0 else 0)
    return face * (size + 1) * (size + 1) + i * (size + 1) + j


# ---- looking through -------------------------------------------------------------------------------------------------------


@compiled
def contradiction(turns, sun, short, limits, out):
    """Return by how much the worst sample contradicts all directions near `sun` rotated by the quaternions `turns` (m, 4).

    `short`: `near` or `far` of the tables. It ends at the first sample beyond the limit.
    """
    worst = 0.0
    for m in range(len(turns)):
        rotate(turns[m], sun, out)
        worst = max(worst, short[m, nearest_node(limits.nodes, out[0], out[1], out[2])])
        if worst > limits.limit:
            break
    return worst


@compiled
def best_point(corners, places, sun, tables, limits, work):
    """Return the index of the best of the `places` (8, 3) in a cell, and its misfit.

    The misfit is infinite if at each place the readings of some sample contradict the motion.
    """
    least, best = np.inf, 0
    for point in range(8):
        worst, total = 0.0, 0.0
        for m in range(corners.shape[1]):
            interpolate(corners, m, places[point], work.q)
            rotate(work.q[0], sun, work.sun)
            node = nearest_node(limits.nodes, work.sun[0], work.sun[1], work.sun[2])
            worst = max(worst, tables.near[m, node])
            if worst > limits.limit:
                break
            total += tables.misfit[m, node]
        if worst <= limits.limit and total < least:
            least, best = total, point
    return best, least


# ---- least squares ---------------------------------------------------------------------------------------------------------


@compiled
def see(panels, m, sun, slope, work):
    """Write the power of each input in sample m for a direction `sun` (3), and its changes if that changes by `slope` (5, 3).

    Changes of inputs that are dark, as they should be, are not written: these add nothing.
    """
    for j in range(len(panels.full)):
        power, a, b, c = 0.0, 0.0, 0.0, 0.0
        for k in range(panels.first[j], panels.first[j + 1]):
            row = panels.rows[k]
            here = row[0] * sun[0] + row[1] * sun[1] + row[2] * sun[2]
            if here > 0 and panels.largest[j]:
                if here > power:
                    power, a, b, c = here, row[0], row[1], row[2]
            elif here > 0:
                power, a, b, c = power + here, a + row[0], b + row[1], c + row[2]
        work.light[j] = power
        if power <= 0 and not (panels.used[m, j] and panels.power[m, j] > 0):
            continue
        if power <= 0:
            row = panels.facing[j]
            if row[0] * sun[0] + row[1] * sun[1] + row[2] * sun[2] > -DARK_SLOPE:
                a, b, c = panels.full[j] * row[0], panels.full[j] * row[1], panels.full[j] * row[2]
        for i in range(COORDINATES):
            work.change[j, i] = a * slope[i, 0] + b * slope[i, 1] + c * slope[i, 2]


@compiled
def best_factor(panels, m, work):
    """Return the factor that fits the readings of a throttled sample best, and write how it follows the five coordinates.

    As :meth:`PanelPowers.best_factor`; in the derivative the last weights are held.
    """
    least, factor, size = panels.sigma.min(), 1.0, 0.0
    for again in range(ROUNDS + 1):
        along, size = 0.0, 0.0
        work.follows[:] = 0.0
        for j in range(len(panels.full)):
            if not panels.used[m, j]:
                continue
            weight = (least / panels.sigma[j]) ** 2
            if again:
                off = (panels.power[m, j] - factor * work.light[j]) / (
                    HALF_WEIGHT * panels.sigma[j]
                )
                weight /= 1.0 + off * off
            size += weight * work.light[j] ** 2
            along += weight * max(panels.power[m, j], 0.0) * work.light[j]
            if work.light[j] > 0:
                for i in range(COORDINATES):
                    work.follows[i] += weight * work.light[j] * work.change[j, i]
        factor = along / size if size > 0 else 1.0
    for i in range(COORDINATES):
        work.follows[i] = work.follows[i] / size if size > 0 else 0.0
    return factor


@compiled
def add_sample(panels, m, limits, work):
    """Add sample m, whose powers :func:`see` has written, to the normal equations; return the misfit of its readings."""
    misfit, factor = 0.0, 1.0
    if panels.throttled:
        factor = best_factor(panels, m, work)
    for j in range(len(panels.full)):
        power, read = factor * work.light[j], panels.power[m, j]
        # an input that is dark, as it should be, adds nothing
        if not panels.used[m, j] or not (power > 0 or read > 0):
            continue
        # errors of interpolated attitudes blur a reading in proportion to the power in full Sun
        precision = 1.0 / (panels.sigma[j] ** 2 + (limits.blur_rad * factor * panels.full[j]) ** 2)
        square = precision * (power - read) ** 2
        # an outlier counts little: its misfit is capped, its weight in the equations falls
        misfit += min(square, limits.cap)
        weight = precision / (1.0 + square / SOFT_SIGMAS**2)
        if panels.throttled:
            # the factor falls by the share follows[i] for a unit of coordinate i
            for i in range(COORDINATES):
                work.change[j, i] = factor * (work.change[j, i] - work.light[j] * work.follows[i])
        for i in range(COORDINATES):
            pull = weight * work.change[j, i]
            work.gradient[i] += pull * (power - read)
            for k in range(i + 1):  # the lower half: `solve` reads no more
                work.normal[i, k] += pull * work.change[j, k]
    return misfit


@compiled
def solve(normal, gradient, move):
    """Write the damped step that solves normal equations: Cholesky's factor replaces the lower half of `normal` (5, 5)."""
    for i in range(COORDINATES):
        normal[i, i] += DAMPING * normal[i, i] + LEAST_DAMPING
    for i in range(COORDINATES):
        for j in range(i + 1):
            value = normal[i, j]
            for k in range(j):
                value -= normal[i, k] * normal[j, k]
            normal[i, j] = np.sqrt(value) if i == j else value / normal[j, j]
    for i in range(COORDINATES):
        value = -gradient[i]
        for k in range(i):
            value -= normal[i, k] * move[k]
        move[i] = value / normal[i, i]
    for i in range(4, -1, -1):
        for k in range(i + 1, 5):
            move[i] -= normal[k, i] * move[k]
        move[i] /= normal[i, i]


@compiled
def equations(corners, start, frame, panels, limits, work):
    """Write the normal equations of a start into `work.normal` (lower half) and `work.gradient`, and return its misfit.

    Samples are the reference (m = 0), then those of `corners`. `work.slope`: derivatives of a sample's Sun by the five coordinates.
    `start` (5): its place x (3) in its cell, then the step (2) that leads from the direction `frame[0]` to the Sun at the reference
    along the tangents `frame[1:]`.
    """
    x, step = start[:3], start[3:]
    for i in range(COORDINATES):
        work.gradient[i] = 0.0
        for k in range(i + 1):
            work.normal[i, k] = 0.0
    here = work.here  # the direction at the reference, and its derivatives by the two steps
    for k in range(3):
        here[0, k] = frame[0, k] + step[0] * frame[1, k] + step[1] * frame[2, k]
    length = np.sqrt(here[0, 0] ** 2 + here[0, 1] ** 2 + here[0, 2] ** 2)
    for k in range(3):
        here[0, k] /= length
    # of a unit vector: the derivatives before it was normalised, over the length, less their part along it
    for i in range(1, 3):
        along = here[0, 0] * frame[i, 0] + here[0, 1] * frame[i, 1] + here[0, 2] * frame[i, 2]
        for k in range(3):
            here[i, k] = (frame[i, k] - along * here[0, k]) / length
    misfit = 0.0
    for m in range(1 + corners.shape[1]):
        if m == 0:  # the reference, whose direction does not depend on the rate
            for k in range(3):
                work.slope[0, k], work.slope[1, k], work.slope[2, k] = 0.0, 0.0, 0.0
                work.slope[3, k], work.slope[4, k] = here[1, k], here[2, k]
            see(panels, m, here[0], work.slope, work)
        else:
            interpolate(corners, m - 1, x, work.q)
            rotate(work.q[0], here[0], work.sun)
            for i in range(3):
                turned_by(work.q[0], work.q[1 + i], work.sun, work.slope[i])
            for i in range(2):
                rotate(work.q[0], here[1 + i], work.slope[3 + i])
            see(panels, m, work.sun, work.slope, work)
        misfit += add_sample(panels, m, limits, work)
    return misfit


@compiled
def settle(corners, start, frame, panels, limits, work):
    """Move a `start` (5), place and step, to the nearest solution by Gauss-Newton, and return its misfit.

    It ends early if `gain_left` times what the last step has gained would leave the misfit too large.
    """
    misfit = np.inf
    for taken in range(limits.steps + 1):
        before, misfit = misfit, equations(corners, start, frame, panels, limits, work)
        gained = max(before - misfit, 0.0)
        if taken == limits.steps or misfit - limits.gain_left * gained > limits.settled:
            break
        move = work.move
        solve(work.normal, work.gradient, move)
        place = max(abs(move[0]), abs(move[1]), abs(move[2])) / LONGEST_PLACE
        turn = max(abs(move[3]), abs(move[4])) / LONGEST_TURN
        size = max(place, turn, 1.0)
        for i in range(COORDINATES):
            start[i] += move[i] / size
        for i in range(3):
            start[i] = min(max(start[i], -FARTHEST_PLACE), 1.0 + FARTHEST_PLACE)
    return misfit


def _entry(sources: int) -> Any:
    """Return the cached entry point; `sources` is the digest of what it is compiled from (:mod:`sunspin.dynamics.processor`)."""

    @cached("compiling the search for starts of a posterior, once (some 10 s)")
    def search_cells(cells, tables, panels, limits):
        """Return the starts (n, START_SIZE) that settle in cells: of each eighth of a cell and each direction one at most."""
        _ = sources
        count, starts = 0, np.empty((256, START_SIZE))
        p, others = len(panels.full), cells.turn.shape[1]
        corners = np.empty((8, others, 4))
        q, here, sun, slope = np.empty((4, 4)), np.empty((3, 3)), np.empty(3), np.empty((5, 3))
        light, change, follows = np.empty(p), np.empty((p, 5)), np.empty(5)
        normal, gradient, move = np.empty((5, 5)), np.empty(5), np.empty(5)
        work = Workspace(q, here, sun, slope, light, change, follows, normal, gradient, move)
        turns, start = np.empty((others, 4)), np.empty(COORDINATES)
        for cell in cells.lowest:
            load_corners(cells, cell, corners)
            for eighth in range(8):
                middle = cells.middles[eighth]
                for m in range(others):
                    interpolate(corners, m, middle, work.q)
                    turns[m] = work.q[0]
                for s in range(len(cells.suns)):
                    # does any direction near the middle agree with the readings?
                    frame = cells.suns[s]
                    far = contradiction(turns, frame[0], tables.far, limits, work.sun)
                    if far > limits.limit:
                        continue
                    # which point of the eighth fits best, if any?
                    points = cells.points[eighth]
                    best, least = best_point(corners, points, frame[0], tables, limits, work)
                    if least == np.inf:
                        continue
                    # does it settle in this eighth?
                    start[:3], start[3:] = points[best], 0.0
                    misfit = settle(corners, start, frame, panels, limits, work)
                    aside = np.abs(start[:3] - middle).max()
                    if misfit > limits.settled or aside >= KEPT_PLACE:
                        continue
                    if count == len(starts):
                        starts = np.concatenate((starts, np.empty_like(starts)))
                    starts[count, OF_CELL], starts[count, OF_SUN] = cell, s
                    starts[count, OF_PLACE], starts[count, OF_STEP] = start[:3], start[3:]
                    starts[count, OF_MISFIT] = misfit
                    count += 1
        return starts[:count]

    return search_cells


search_cells = _entry(digest(__file__))
