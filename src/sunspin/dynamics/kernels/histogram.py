"""Histograms of r_z, the height of the Sun, from nodes along the motion: float32, for all lanes at once.

Nodes are instants at which the direction r to the Sun, its derivative and the body rate are known, at most `tolerance` rad of
rotation apart. The piece of the motion between two nodes is a *way*. On it r is a cubic (Hermite's, from r and its derivative at
both ends) plus the fourth-order term of a rotation (`write_way`).

Only directions inside a *mask* count. A way is cut into PIECES. In each, the part inside is computed from the signed distances of
its ends to the edge of the mask (`write_signed`, `counted`). The times inside the mask on the whole way have a total, a mean and a
variance. They are replaced by the three points of Gauss-Legendre quadrature with the same total, mean and variance, whose weights
go into the bins of their r_z (`write_points`). Nodes 0.9 rad apart give an EMD with an error of 1e-3. Counting samples needs eight
per radian for the same error.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunspin.dynamics.kernels.rows import L
from sunspin.dynamics.processor import compiled

F = np.float32

PIECES = 4
"""Pieces of a way, in each of which the motion may cross the edge of the mask once."""

MIN_WAYS = 1024
"""Smallest number of ways in a run: the histogram of a slow motion would be coarse otherwise."""

# ---- rows of `at`: seconds between neighbouring nodes, then the nodes ----------------------------
SECONDS = 0
NODE = L  # node k at NODE + k PER_NODE: direction to the Sun (3), its slope in 1/s (3), square of the body rate; body axes
PER_NODE = 7 * L
MOST_NODES = 4

# ---- rows of `way` -------------------------------------------------------------------------------
POINT = 0  # x, y, z of the ends of the pieces, PIECES rows each
# signed distances to the edge of the mask: of the node where the way begins, then of the ends of the pieces
SIGNED = 3 * PIECES * L
LOWEST = SIGNED + (PIECES + 1) * L  # scratch: smallest product with the normals of a clause
CURVE = LOWEST + PIECES * L  # coefficients of r_z along the way (5)
WAY_ROWS = 3 * PIECES + PIECES + 1 + PIECES + 5


class Nodes(NamedTuple):
    """Working arrays of the histograms of L motions, and the mask.

    `at` (1 + 7 MOST_NODES rows), `way` (WAY_ROWS rows); `bin` and `weight` (PIECES rows): points that stand for a way; `hist` (L
    bins): seconds in bins of r_z over [-1, 1]. `state` and `angle`: scratch of the integrators. The mask, `normals` (n, 3) and
    `ends` (n_clause): a direction counts if in one of the clauses its products with all normals are positive. Clause i ends before
    `ends[i]` and has an even number of normals. Without clauses all directions count. `tolerance`: rad between nodes.
    """

    at: np.ndarray
    way: np.ndarray
    bin: np.ndarray
    weight: np.ndarray
    hist: np.ndarray
    state: np.ndarray
    angle: np.ndarray
    normals: np.ndarray
    ends: np.ndarray
    tolerance: float


@compiled
def write_signed(way, first, count, normals, ends):
    """Write the signed distances to the edge of the mask, positive inside, of `count` points of a way from index `first` on.

    The distance is the largest over the clauses of the smallest product with a normal of the clause.
    """
    start_value = F(1.0) if len(ends) == 0 else F(-1e30)
    for j in range(count):
        way[SIGNED + L + first + j] = start_value
    start = 0
    for end in ends:
        for k in range(start, end, 2):  # two normals in a pass
            a, b, c = normals[k, 0], normals[k, 1], normals[k, 2]
            d, e, f = normals[k + 1, 0], normals[k + 1, 1], normals[k + 1, 2]
            for j in range(count):
                x = way[POINT + first + j]
                y = way[POINT + PIECES * L + first + j]
                z = way[POINT + 2 * PIECES * L + first + j]
                low = min(a * x + b * y + c * z, d * x + e * y + f * z)
                way[LOWEST + j] = low if k == start else min(way[LOWEST + j], low)
        for j in range(count):
            way[SIGNED + L + first + j] = max(way[SIGNED + L + first + j], way[LOWEST + j])
        start = end


@compiled
def write_way(at, way, k):
    """Write the ends of the pieces of the way from node k to node k + 1, and the coefficients of r_z along it.

    r_z is a polynomial of degree 4 in the share t of the way, 0 to 1.
    """
    n, e = NODE + PER_NODE * k, NODE + PER_NODE * (k + 1)
    for j in range(3):
        o = POINT + j * PIECES * L
        for l in range(L):
            dt = at[SECONDS + l]
            # `bend`: difference of the slopes. A rotation by the angle w adds the fourth-order term w^2 / 24 bend t^2 (1 - t)^2
            turn = dt * dt * at[e + 6 * L + l] * F(1 / 24)
            # values p, q and slopes b, d at both ends
            p, q = at[n + j * L + l], at[e + j * L + l]
            b, d = dt * at[n + (3 + j) * L + l], dt * at[e + (3 + j) * L + l]
            across, bend, slopes, middle = q - p, b - d, b + d, F(0.5) * (p + q)
            # r at 1/4, 1/2 and 3/4 of the way
            even = middle + (F(3 / 32) + F(9 / 256) * turn) * bend
            odd = F(-11 / 32) * across + F(3 / 64) * slopes
            way[o + l], way[o + L + l] = even + odd, middle + (F(1 / 8) + F(1 / 16) * turn) * bend
            way[o + 2 * L + l], way[o + 3 * L + l] = even - odd, q
            if j == 2:
                quartic = turn * bend
                cubic = slopes - across - across - quartic - quartic
                way[CURVE + l], way[CURVE + L + l] = p, b
                way[CURVE + 2 * L + l] = across - b - cubic - quartic
                way[CURVE + 3 * L + l], way[CURVE + 4 * L + l] = cubic, quartic


@compiled
def counted(a, b, bend, k):
    """Return length, first and second moment of the part of piece k inside the mask, in units of a piece from the start of the way.

    The signed distance goes from a to b in the piece. `bend`: its second difference, by which its zero is corrected from that of a
    straight line.
    """
    inverse = F(1) / (b - a + F(1e-30))
    t = -a * inverse
    t = min(max(t + F(0.5) * bend * t * (F(1) - t) * inverse, F(0)), F(1))
    # t: the crossing; without one the part is the whole piece (a > 0) or nothing
    t = t if a * b < F(0) else F(1)
    length = t if a > F(0) else F(1) - t
    centre = k + (F(0.5) * t if a > F(0) else F(0.5) + F(0.5) * t)
    return length, length * centre, length * (centre * centre + F(1 / 12) * length * length)


@compiled
def write_points(at, way, bins, weight, n_bins):
    """Write the bins of the three points that stand for the part of a way inside the mask, and their weights in seconds.

    Weights are that of both outer points and that of the middle one: 5/18 and 8/18 of the time inside.
    """
    part, half, last = F(1 / PIECES), F(n_bins / 2), np.int32(n_bins - 1)
    for l in range(L):
        # signed distances at the ends of the four pieces, and their second differences
        a, b, c = way[SIGNED + l], way[SIGNED + L + l], way[SIGNED + 2 * L + l]
        d, e = way[SIGNED + 3 * L + l], way[SIGNED + 4 * L + l]
        p, q, r = a - b - b + c, b - c - c + d, c - d - d + e
        f0, m0, s0 = counted(a, b, p, F(0))
        f1, m1, s1 = counted(b, c, F(0.5) * (p + q), F(1))
        f2, m2, s2 = counted(c, d, F(0.5) * (q + r), F(2))
        f3, m3, s3 = counted(d, e, r, F(3))
        way[SIGNED + l] = e  # the next way begins where this one ends
        length = f0 + f1 + f2 + f3
        inverse = F(1) / (length + F(1e-30))
        mean = (m0 + m1 + m2 + m3) * inverse
        variance = (s0 + s1 + s2 + s3) * inverse - mean * mean
        # the outer points of the quadrature are sqrt(9/5) standard deviations from the mean
        spread = part * F(math.sqrt(9 / 5)) * math.sqrt(max(variance, F(0)))
        mean *= part
        seconds = length * abs(at[SECONDS + l]) * part
        for k in range(3):
            t = mean - spread if k == 0 else (mean + spread if k == 1 else mean)
            z = way[CURVE + 3 * L + l] + t * way[CURVE + 4 * L + l]
            z = way[CURVE + l] + t * (way[CURVE + L + l] + t * (way[CURVE + 2 * L + l] + t * z))
            place = np.int32((z + F(1)) * half)
            bins[k * L + l] = max(min(place, last), np.int32(0))  # in range for any z
        weight[l], weight[L + l] = F(5 / 18) * seconds, F(4 / 9) * seconds


@compiled
def add_way(nodes, k):
    """Add the part inside the mask of the way from node k to node k + 1 to the histograms of all lanes."""
    write_way(nodes.at, nodes.way, k)
    write_signed(nodes.way, 0, PIECES * L, nodes.normals, nodes.ends)
    n_bins = len(nodes.hist) // L
    write_points(nodes.at, nodes.way, nodes.bin, nodes.weight, n_bins)
    for j in range(3):
        for l in range(L):
            # unsigned indices need no check for negative ones
            place = np.uint64(l * n_bins) + np.uint32(nodes.bin[j * L + l])
            nodes.hist[place] += nodes.weight[(j // 2) * L + l]


@compiled
def begin_way(nodes):
    """Write the signed distance of node 0, where the next way begins, in all lanes."""
    at, way = nodes.at, nodes.way
    # `write_signed` takes points at the ends of pieces: node 0 as that of the first, whose distance is then moved to the row before
    for l in range(L):
        way[POINT + l] = at[NODE + l]
        way[POINT + PIECES * L + l] = at[NODE + L + l]
        way[POINT + 2 * PIECES * L + l] = at[NODE + 2 * L + l]
    write_signed(way, 0, L, nodes.normals, nodes.ends)
    for l in range(L):
        way[SIGNED + l] = way[SIGNED + L + l]


@compiled
def take_out(nodes, l, hist):
    """Write the histogram of lane l into `hist` (bins) and empty it for the next motion."""
    n_bins = len(hist)
    own = nodes.hist[l * n_bins : (l + 1) * n_bins]
    for b in range(n_bins):
        hist[b] = own[b]
        own[b] = F(0)


def new_nodes(normals: np.ndarray, ends: np.ndarray, tolerance: float, bins: int) -> Nodes:
    """Return working arrays (:class:`Nodes`), filled with zeros, with which a run makes histograms of r_z with `bins` bins.

    `normals` (n, 3) and `ends` (n_clause): the mask, as :func:`sunspin.dynamics.batch.half_spaces` returns it. `tolerance`: largest
    rotation between two nodes, rad.
    """
    return Nodes(
        at=np.zeros(L + PER_NODE * MOST_NODES, F),
        way=np.zeros(WAY_ROWS * L, F),
        bin=np.zeros(PIECES * L, np.int32),
        weight=np.zeros(PIECES * L, F),
        hist=np.zeros(L * bins, F),
        # total momentum H (3), direction to the Sun (3), momenta h of at most four wheels
        state=np.zeros(10 * L),
        # half the angle of the common rotation about H, later its sine and cosine
        angle=np.zeros(2 * L),
        normals=np.ascontiguousarray(normals, F).reshape(-1, 3),
        ends=np.ascontiguousarray(ends, np.int64),
        tolerance=float(tolerance),
    )
