"""The compiled search for starts in the cells of a grid of rates: comparison with the readings, and least squares.

The reference is one sample; the search compares readings there and at m other samples. A cell is a cube of body rates at the
reference. At its eight corners the attitudes at the m samples are known as quaternions; inside it these are interpolated.

A start has five coordinates. Three give the rate: its place x in a cell, in parts of the edge. Two give the direction to the Sun at
the reference: a step along two tangents of a listed direction. Begin to read at :func:`search_cells`, the last function.
`tests/estimate/plain_cells.py` does the same in NumPy.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from sunspin.dynamics.processor import cached, compiled, digest
from sunspin.estimate.terms.powers import HALF_WEIGHT, ROUNDS, PanelPowers
from sunspin.vehicle.response.joined import JoinedResponse

DARK_SLOPE = 0.1
"""If a panel was read as lit but computed as dark, its power has a derivative as long as the cosine of incidence exceeds minus
this. So least squares can move it into the light."""

SOFT_SIGMAS = 5.0
"""A residual far beyond this many sigmas has little weight in least squares: the reading may be an outlier."""

DAMPING, LEAST_DAMPING = 1e-2, 1e-3
"""Damping of a least-squares step: part of each diagonal element of the normal equations, and what is added to all of them."""

LONGEST_PLACE, LONGEST_TURN = 0.25, 0.3
"""Longest change in one least-squares step: of the place x, in parts of the edge, and of the direction to the Sun, rad."""

FARTHEST_PLACE, KEPT_PLACE = 0.2, 0.5
"""Limits in parts of the edge: of a place outside its cell, and of a settled start from the middle of its eighth. Farther starts
are dropped, as the start of a neighbouring eighth ends at the same motion."""

START_SIZE = 8
OF_CELL, OF_SUN, OF_PLACE, OF_STEP, OF_MISFIT = 0, 1, slice(2, 5), slice(5, 7), 7
"""Columns of a start: index of its cell, index of its direction, place (3), step (2), misfit."""

COORDINATES = 5
"""Coordinates of a start in least squares: place (3), then step (2)."""


class PanelTable(NamedTuple):
    """Panels and their readings, as arrays for compiled code. There are p inputs, each with the power of one or more panels.

    `first` (p + 1): the panels of input j are `first[j]` to `first[j + 1] - 1`; `rows` (n_panel, 3): normal times power in full
    Sun; `largest` (p): whether the input reads the largest of its panels, not their sum; `facing` (p, 3), `full` (p): direction
    to the Sun for which the input reads most, and that power. `power`, `used` (1 + m, p): readings, and whether they count, first
    those of the reference; `sigma` (p): their errors. `throttled`: a common factor of each sample is unknown
    (:class:`PanelPowers`).
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
        """Return the table of a panel term that holds the reference sample first, then the m other samples."""
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
    """Misfit of the readings of m samples for n directions to the Sun, the nodes: arrays (m, n) of float32, computed once.

    `near`, `far`: lower bound of the misfit of all directions within `near_rad` or `far_rad` (:class:`GridSettings`) of the node,
    in squared sigmas (:func:`~sunspin.estimate.lander.allowed.shortfall`); `misfit`: sum of squares at the node itself.
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
    """Cells in which starts are sought, with the attitudes at the points of their grid.

    `lowest` (c): index of the lowest corner of each cell in the cube of a :class:`RateGrid`; `corner_offsets` (8) lead from there
    to all corners; `row_of`, `quaternions` as in that class. `suns` (s, 3, 3): directions to the Sun at the reference, each with
    two tangents. `middles` (8, 3), `points` (8, 8, 3): middles of the eighths of a cell, and eight places in each eighth.
    """

    lowest: np.ndarray
    corner_offsets: np.ndarray
    row_of: np.ndarray
    quaternions: np.ndarray
    suns: np.ndarray
    middles: np.ndarray
    points: np.ndarray


class Workspace(NamedTuple):
    """Arrays that compiled code overwrites for each start. A slope is a derivative by the five coordinates of the start.

    `q` (4, 4): quaternion of the attitude at a sample, and its derivatives by the place. `reference_sun` (3, 3): direction at the
    reference, and its derivatives by the step; `sun` (3), `sun_slope` (5, 3): direction at a sample. `power` (p), `power_slope`
    (p, 5): computed power of each input; `factor_fall` (5): relative fall of a throttled sample's factor for a unit of each
    coordinate. `normal` (5, 5), `gradient` (5): normal equations; `move` (5): their solution.
    """

    q: np.ndarray
    reference_sun: np.ndarray
    sun: np.ndarray
    sun_slope: np.ndarray
    power: np.ndarray
    power_slope: np.ndarray
    factor_fall: np.ndarray
    normal: np.ndarray
    gradient: np.ndarray
    move: np.ndarray


# ---- attitudes -------------------------------------------------------------------------------------------------------------


@compiled
def load_corners(cells, cell, corners):
    """Write the quaternions at the corners of a cell into `corners` (8, m, 4), with signs that suit interpolation.

    q and -q are the same attitude; of the two the one nearer to the quaternion of the first corner is taken.
    """
    for c in range(8):
        row = cells.row_of[cell + cells.corner_offsets[c]]
        for m in range(corners.shape[1]):
            product = 0.0
            for k in range(4):
                corners[c, m, k] = cells.quaternions[row, m, k]
                product += corners[c, m, k] * corners[0, m, k]
            if product < 0:
                for k in range(4):
                    corners[c, m, k] = -corners[c, m, k]


@compiled
def interpolate(corners, m, x, q):
    """Write the quaternion (4) of sample m at the place x (3) in a cell into q[0], its derivatives by the three x into q[1:4].

    It is interpolated trilinearly and is not a unit quaternion. `corners` (8, m, 4) as of :func:`load_corners`: corner
    4 a + 2 b + c is at the end a (0 or 1) of the first axis, b of the second, c of the third.
    """
    for k in range(4):
        # a = 0 and 1: the faces of the cell at the two ends of the first axis
        for a in range(2):
            # on the two edges of the face at the ends of the second axis, `low` and `high`: along the third axis
            low, high = corners[4 * a, m, k], corners[4 * a + 2, m, k]
            rise_low, rise_high = corners[4 * a + 1, m, k] - low, corners[4 * a + 3, m, k] - high
            low, high = low + x[2] * rise_low, high + x[2] * rise_high
            # on the face: along the second axis, with the derivatives by x[1] and x[2]
            value, by_y = low + x[1] * (high - low), high - low
            by_z = rise_low + x[1] * (rise_high - rise_low)
            # between the faces: along the first axis; the derivative by x[0] is the difference of their values
            if a == 0:
                q[0, k], q[1, k], q[2, k], q[3, k] = value, -value, by_y, by_z
            else:
                q[1, k] += value
                q[0, k] += x[0] * (value - q[0, k])
                q[2, k] += x[0] * (by_y - q[2, k])
                q[3, k] += x[0] * (by_z - q[3, k])


@compiled
def interpolated(corners, m, x):
    """Return the quaternion of sample m at the place x (3) in a cell, as :func:`interpolate` does, without derivatives.

    Most places need no derivatives, and a tuple stays in registers.
    """
    return (
        _at_place(corners, m, x, 0),
        _at_place(corners, m, x, 1),
        _at_place(corners, m, x, 2),
        _at_place(corners, m, x, 3),
    )


@compiled
def _at_place(corners, m, x, k):
    """Return element k of the quaternion of sample m at the place x (3) in a cell."""
    y, z = x[1], x[2]
    # along the third axis on the four edges, then along the second on the two faces, then between these
    edge_00 = corners[0, m, k] + z * (corners[1, m, k] - corners[0, m, k])
    edge_01 = corners[2, m, k] + z * (corners[3, m, k] - corners[2, m, k])
    edge_10 = corners[4, m, k] + z * (corners[5, m, k] - corners[4, m, k])
    edge_11 = corners[6, m, k] + z * (corners[7, m, k] - corners[6, m, k])
    face_0 = edge_00 + y * (edge_01 - edge_00)
    face_1 = edge_10 + y * (edge_11 - edge_10)
    return face_0 + x[0] * (face_1 - face_0)


@compiled
def rotated(q, vector):
    """Return a vector (3) rotated by q (4), a quaternion of any length, scalar last."""
    # with the vector part v and the scalar w of the unit quaternion: r + w t + v x t, t = 2 v x r
    x, y, z, w = q[0], q[1], q[2], q[3]
    twice = 2.0 / max(x * x + y * y + z * z + w * w, 1e-9)
    a = twice * (y * vector[2] - z * vector[1])
    b = twice * (z * vector[0] - x * vector[2])
    c = twice * (x * vector[1] - y * vector[0])
    return (
        vector[0] + w * a + y * c - z * b,
        vector[1] + w * b + z * a - x * c,
        vector[2] + w * c + x * b - y * a,
    )


@compiled
def write_rotation_slope(q, change, vector, out):
    """Write into `out` (3) the derivative of a rotated vector, given the derivative `change` (4) of its quaternion q (4).

    `vector` (3) is the vector after rotation. The rotation changes by the small rotation vector (a, b, c), twice the vector part
    of the quaternion product change q* / |q|^2, and the vector by (a, b, c) x vector.
    """
    x, y, z, w = q[0], q[1], q[2], q[3]
    scale = 2.0 / max(x * x + y * y + z * z + w * w, 1e-9)
    a = scale * (w * change[0] - change[3] * x - change[1] * z + change[2] * y)
    b = scale * (w * change[1] - change[3] * y - change[2] * x + change[0] * z)
    c = scale * (w * change[2] - change[3] * z - change[0] * y + change[1] * x)
    out[0], out[1], out[2] = (
        b * vector[2] - c * vector[1],
        c * vector[0] - a * vector[2],
        a * vector[1] - b * vector[0],
    )


@compiled
def nearest_node(size, x, y, z):
    """Return the index, in :func:`~sunspin.estimate.lander.allowed.cube_nodes` of `size`, of the node near a direction (x, y, z).

    The direction may have any length. Of the nodes on the face of the cube that it hits, the one nearest to the hit is taken.
    """
    along = (abs(x), abs(y), abs(z))
    # the axis across the face that the direction hits, its component `top` along that axis, and those along the next two axes
    if along[0] >= along[1] and along[0] >= along[2]:
        axis, top, row, column = 0, x, y, z
    elif along[1] >= along[2]:
        axis, top, row, column = 1, y, z, x
    else:
        axis, top, row, column = 2, z, x, y
    # divided by |top|, the last two are coordinates on the face, from -1 to 1; nodes are 2 / size apart
    length = max(abs(top), 1e-300)
    i = int(np.rint((row / length + 1) * (size / 2)))
    j = int(np.rint((column / length + 1) * (size / 2)))
    face = 2 * axis + (1 if top < 0 else 0)
    return face * (size + 1) * (size + 1) + i * (size + 1) + j


# ---- comparison with tabulated misfits -------------------------------------------------------------------------------------


@compiled
def worst_bound(quaternions, sun, bounds, limits):
    """Return the largest lower bound, over m samples, of the misfit of all motions near one.

    That motion takes the direction `sun` (3) at the reference to each sample by `quaternions` (m, 4). `bounds` (m, n): `near` or
    `far` of :class:`Tables`. Samples after the first one beyond the limit are left out.
    """
    worst = 0.0
    for m in range(len(quaternions)):
        x, y, z = rotated(quaternions[m], sun)
        worst = max(worst, bounds[m, nearest_node(limits.nodes, x, y, z)])
        if worst > limits.limit:
            break
    return worst


@compiled
def best_point(corners, places, sun, tables, limits):
    """Return the index of the best of the `places` (8, 3) in a cell, and its misfit, for one direction `sun` (3).

    A place at which the `near` bound of some sample exceeds the limit is left out. If all are, the misfit is infinite.
    """
    least, best = np.inf, 0
    for point in range(8):
        worst, total = 0.0, 0.0  # largest bound of a sample; sum of the misfits
        for m in range(corners.shape[1]):
            x, y, z = rotated(interpolated(corners, m, places[point]), sun)
            node = nearest_node(limits.nodes, x, y, z)
            worst = max(worst, tables.near[m, node])
            if worst > limits.limit:
                break
            total += tables.misfit[m, node]
        if worst <= limits.limit and total < least:
            least, best = total, point
    return best, least


# ---- least squares ---------------------------------------------------------------------------------------------------------


@compiled
def write_powers(panels, m, sun, sun_slope, work):
    """Write `work.power` and `work.power_slope` of sample m for a direction `sun` (3) and its slope (5, 3).

    Slopes of inputs that are dark and were read as dark are not written: these inputs add nothing to the equations.
    """
    for j in range(len(panels.full)):
        # the power of the input, and its derivative (a, b, c) by the direction to the Sun
        power, a, b, c = 0.0, 0.0, 0.0, 0.0
        for k in range(panels.first[j], panels.first[j + 1]):
            row = panels.rows[k]
            of_panel = row[0] * sun[0] + row[1] * sun[1] + row[2] * sun[2]
            if of_panel > 0 and panels.largest[j]:
                if of_panel > power:
                    power, a, b, c = of_panel, row[0], row[1], row[2]
            elif of_panel > 0:
                power, a, b, c = power + of_panel, a + row[0], b + row[1], c + row[2]
        work.power[j] = power
        if power <= 0 and not (panels.used[m, j] and panels.power[m, j] > 0):
            continue
        if power <= 0:  # read as lit, but computed as dark: see DARK_SLOPE
            row = panels.facing[j]
            if row[0] * sun[0] + row[1] * sun[1] + row[2] * sun[2] > -DARK_SLOPE:
                a, b, c = panels.full[j] * row[0], panels.full[j] * row[1], panels.full[j] * row[2]
        for i in range(COORDINATES):
            work.power_slope[j, i] = a * sun_slope[i, 0] + b * sun_slope[i, 1] + c * sun_slope[i, 2]


@compiled
def best_factor(panels, m, work):
    """Return the factor by which computed powers fit the readings of a throttled sample m best, and write `work.factor_fall`.

    The factor is that of weighted least squares, sum(w y p) / sum(w p^2) with readings y and powers p. Weights w fall for
    outliers, and are computed again with each factor, as in :meth:`PanelPowers.best_factor`. `factor_fall` is exact for fixed
    weights and readings that fit, y = factor p.
    """
    least, factor, square = panels.sigma.min(), 1.0, 0.0
    for round_number in range(ROUNDS + 1):
        product, square = 0.0, 0.0
        work.factor_fall[:] = 0.0
        for j in range(len(panels.full)):
            if not panels.used[m, j]:
                continue
            weight = (least / panels.sigma[j]) ** 2
            if round_number:
                residual = (panels.power[m, j] - factor * work.power[j]) / (
                    HALF_WEIGHT * panels.sigma[j]
                )
                weight /= 1.0 + residual * residual
            square += weight * work.power[j] ** 2
            product += weight * max(panels.power[m, j], 0.0) * work.power[j]
            if work.power[j] > 0:
                for i in range(COORDINATES):
                    work.factor_fall[i] += weight * work.power[j] * work.power_slope[j, i]
        factor = product / square if square > 0 else 1.0
    for i in range(COORDINATES):
        work.factor_fall[i] = work.factor_fall[i] / square if square > 0 else 0.0
    return factor


@compiled
def add_sample(panels, m, limits, work):
    """Add sample m, whose powers :func:`write_powers` has written, to the normal equations; return the misfit of its readings."""
    misfit, factor = 0.0, 1.0
    if panels.throttled:
        factor = best_factor(panels, m, work)
    for j in range(len(panels.full)):
        power, read = factor * work.power[j], panels.power[m, j]
        # an input that is dark and was read as dark adds nothing
        if not panels.used[m, j] or not (power > 0 or read > 0):
            continue
        # errors of interpolated attitudes blur a reading in proportion to the power in full Sun
        precision = 1.0 / (panels.sigma[j] ** 2 + (limits.blur_rad * factor * panels.full[j]) ** 2)
        square = precision * (power - read) ** 2
        # an outlier counts little: its misfit is capped, its weight in the equations falls
        misfit += min(square, limits.cap)
        weight = precision / (1.0 + square / SOFT_SIGMAS**2)
        if panels.throttled:
            # slope of factor times power; where powers rise, the factor falls by the share `factor_fall`
            for i in range(COORDINATES):
                fall = work.power[j] * work.factor_fall[i]
                work.power_slope[j, i] = factor * (work.power_slope[j, i] - fall)
        for i in range(COORDINATES):
            weighted = weight * work.power_slope[j, i]
            work.gradient[i] += weighted * (power - read)
            for k in range(i + 1):  # the lower half: `solve_damped` reads no more
                work.normal[i, k] += weighted * work.power_slope[j, k]
    return misfit


@compiled
def solve_damped(normal, gradient, move):
    """Write into `move` (5) the solution of the damped normal equations, (N + damping) move = -gradient.

    `normal` (5, 5) holds N = J^T W J; only its lower half is read, and Cholesky's factor replaces it. `gradient` (5): that of half
    the weighted sum of squares. The damping is on the diagonal: DAMPING times that of N, plus LEAST_DAMPING.
    """
    for i in range(COORDINATES):
        normal[i, i] += DAMPING * normal[i, i] + LEAST_DAMPING
    for i in range(COORDINATES):  # Cholesky's factor
        for j in range(i + 1):
            value = normal[i, j]
            for k in range(j):
                value -= normal[i, k] * normal[j, k]
            normal[i, j] = np.sqrt(value) if i == j else value / normal[j, j]
    for i in range(COORDINATES):  # forward, then backward substitution
        value = -gradient[i]
        for k in range(i):
            value -= normal[i, k] * move[k]
        move[i] = value / normal[i, i]
    for i in range(COORDINATES - 1, -1, -1):
        for k in range(i + 1, COORDINATES):
            move[i] -= normal[k, i] * move[k]
        move[i] /= normal[i, i]


@compiled
def write_equations(corners, start, frame, panels, limits, work):
    """Write the normal equations of a start into `work.normal` (lower half) and `work.gradient`, and return its misfit.

    Samples are the reference (m = 0), then those of `corners`. `start` (5): its place x (3) in its cell, then the step (2) along
    the tangents `frame[1:]` that leads from the direction `frame[0]` to the Sun at the reference.
    """
    x, step = start[:3], start[3:]
    for i in range(COORDINATES):
        work.gradient[i] = 0.0
        for k in range(i + 1):
            work.normal[i, k] = 0.0
    sun, sun_slope = work.reference_sun, work.sun_slope
    for k in range(3):
        sun[0, k] = frame[0, k] + step[0] * frame[1, k] + step[1] * frame[2, k]
    length = np.sqrt(sun[0, 0] ** 2 + sun[0, 1] ** 2 + sun[0, 2] ** 2)
    for k in range(3):
        sun[0, k] /= length
    # derivatives of a vector v over its length by the step: (dv - n (n . dv)) / |v|, n = v / |v|
    for i in range(1, 3):
        along = sun[0, 0] * frame[i, 0] + sun[0, 1] * frame[i, 1] + sun[0, 2] * frame[i, 2]
        for k in range(3):
            sun[i, k] = (frame[i, k] - along * sun[0, k]) / length
    misfit = 0.0
    for m in range(1 + corners.shape[1]):
        if m == 0:  # the reference, whose direction does not depend on the rate
            for k in range(3):
                sun_slope[0, k], sun_slope[1, k], sun_slope[2, k] = 0.0, 0.0, 0.0
                sun_slope[3, k], sun_slope[4, k] = sun[1, k], sun[2, k]
            write_powers(panels, m, sun[0], sun_slope, work)
        else:
            interpolate(corners, m - 1, x, work.q)
            work.sun[0], work.sun[1], work.sun[2] = rotated(work.q[0], sun[0])
            for i in range(3):
                write_rotation_slope(work.q[0], work.q[1 + i], work.sun, sun_slope[i])
            for i in range(2):
                a, b, c = rotated(work.q[0], sun[1 + i])
                sun_slope[3 + i, 0], sun_slope[3 + i, 1], sun_slope[3 + i, 2] = a, b, c
            write_powers(panels, m, work.sun, sun_slope, work)
        misfit += add_sample(panels, m, limits, work)
    return misfit


@compiled
def settle(corners, start, frame, panels, limits, work):
    """Move a `start` (5), place and step, toward the nearest local minimum by damped Gauss-Newton steps, and return its misfit.

    Arguments as of :func:`write_equations`. Steps end early if the start will hardly be kept: if its misfit would stay above
    `limits.settled` even after a further fall of `limits.gain_left` times that in the last step.
    """
    misfit = np.inf
    for taken in range(limits.steps + 1):
        before, misfit = misfit, write_equations(corners, start, frame, panels, limits, work)
        gained = max(before - misfit, 0.0)
        if taken == limits.steps or misfit - limits.gain_left * gained > limits.settled:
            break
        move = work.move
        solve_damped(work.normal, work.gradient, move)
        # a step beyond the longest change of place or direction is shortened
        place = max(abs(move[0]), abs(move[1]), abs(move[2])) / LONGEST_PLACE
        direction = max(abs(move[3]), abs(move[4])) / LONGEST_TURN
        excess = max(place, direction, 1.0)
        for i in range(COORDINATES):
            start[i] += move[i] / excess
        for i in range(3):
            start[i] = min(max(start[i], -FARTHEST_PLACE), 1.0 + FARTHEST_PLACE)
    return misfit


def _entry(sources: int) -> Any:
    """Return the compiled `search_cells`; `sources` is the digest of its sources (:mod:`sunspin.dynamics.processor`)."""

    @cached("compiling the search for starts of a posterior, once (some 10 s)")
    def search_cells(cells, tables, panels, limits):
        """Return the starts (n, START_SIZE) that settle in cells: at most one for each eighth of a cell and each direction.

        Arguments are :class:`Cells`, :class:`Tables`, :class:`PanelTable` and :class:`Limits`. For each eighth and direction,
        cheap tests come first: a bound at its middle, then misfits from tables at eight places, then least squares from the best.
        """
        _ = sources
        count, starts = 0, np.empty((256, START_SIZE))
        p, samples = len(panels.full), cells.quaternions.shape[1]
        corners = np.empty((8, samples, 4))
        work = Workspace(
            q=np.empty((4, 4)),
            reference_sun=np.empty((3, 3)),
            sun=np.empty(3),
            sun_slope=np.empty((5, 3)),
            power=np.empty(p),
            power_slope=np.empty((p, 5)),
            factor_fall=np.empty(5),
            normal=np.empty((5, 5)),
            gradient=np.empty(5),
            move=np.empty(5),
        )
        at_middle, start = np.empty((samples, 4)), np.empty(COORDINATES)
        for cell in cells.lowest:
            load_corners(cells, cell, corners)
            for eighth in range(8):
                middle = cells.middles[eighth]
                for m in range(samples):
                    x, y, z, w = interpolated(corners, m, middle)
                    at_middle[m, 0], at_middle[m, 1], at_middle[m, 2], at_middle[m, 3] = x, y, z, w
                for s in range(len(cells.suns)):
                    # can any motion near that of the middle agree with the readings?
                    frame = cells.suns[s]
                    bound = worst_bound(at_middle, frame[0], tables.far, limits)
                    if bound > limits.limit:
                        continue
                    # which place in the eighth fits best, if any?
                    places = cells.points[eighth]
                    best, least = best_point(corners, places, frame[0], tables, limits)
                    if least == np.inf:
                        continue
                    # does it settle in this eighth?
                    start[:3], start[3:] = places[best], 0.0
                    misfit = settle(corners, start, frame, panels, limits, work)
                    distance = np.abs(start[:3] - middle).max()
                    if misfit > limits.settled or distance >= KEPT_PLACE:
                        continue
                    if count == len(starts):  # no room is left: double it
                        starts = np.concatenate((starts, np.empty_like(starts)))
                    starts[count, OF_CELL], starts[count, OF_SUN] = cell, s
                    starts[count, OF_PLACE], starts[count, OF_STEP] = start[:3], start[3:]
                    starts[count, OF_MISFIT] = misfit
                    count += 1
        return starts[:count]

    return search_cells


search_cells = _entry(digest(__file__))
