"""Nodes of the histogram (:mod:`~sunspin.dynamics.kernels.histogram`) in a step of the Taylor kernel: at its thirds and at its end.

Names are those of :mod:`~sunspin.dynamics.kernels.flow`; `nodes` are the working arrays of a histogram.
"""

from __future__ import annotations

import math

import numpy as np

from sunspin.dynamics.kernels.histogram import (
    MIN_WAYS,
    NODE,
    PER_NODE,
    SECONDS,
    add_way,
    begin_way,
)
from sunspin.dynamics.kernels.rows import (
    AXIAL,
    DT,
    HELD_RATE,
    INVERSE,
    INVERSE_H,
    LIFT,
    PER_WHEEL,
    SPIN,
    SUN,
    H,
    L,
)
from sunspin.dynamics.processor import compiled

WAYS = 3
"""Ways in a step, each between two nodes."""


@compiled
def write_state_at(lanes, nodes, n_wheels, order, part):
    """Write H, r and h of all lanes, at the share `part` of the steps that they take, into `nodes.state`.

    The Taylor series is summed by Horner's rule, four orders in a pass.
    """
    c, share, state = lanes.c, lanes.share, nodes.state
    top = 4 * ((order + 3) // 4)
    for j in range((6 + n_wheels) * L):
        state[j] = c[top, j]
    for k in range(top - 4, -1, -4):
        for j in range((6 + n_wheels) * L):
            x = part * share[j]
            state[j] = (((state[j] * x + c[k + 3, j]) * x + c[k + 2, j]) * x + c[k + 1, j]) * x + c[
                k, j
            ]


@compiled
def write_half_angle(lanes, nodes, seconds_before):
    """Write into `nodes.angle` half the angle of the common rotation about H, within +-pi/2.

    The angle is that at the time `seconds_before` (L), s, before that of `lanes.since`; its rate is SPIN |H|.
    """
    p, angle = lanes.p, nodes.angle
    for l in range(L):
        inverse = p[INVERSE_H + l]  # zero at rest, where nothing turns
        rate = p[SPIN + l] / inverse if inverse > 0.0 else 0.0
        turns = (lanes.since[l] - seconds_before[l]) * rate * (1 / (2 * math.pi))
        angle[l] = math.pi * (turns - math.floor(turns + 0.5))


@compiled
def write_node(lanes, nodes, n_wheels, node):
    """Write the direction to the Sun, its slope and the square of the body rate from `nodes.state` into `node` (7 rows).

    `nodes.angle` holds half the angle of the common rotation about H, and is overwritten. `node` is a slice of `nodes.at`, so that
    its rows begin at 0.
    """
    p, u, m, angle = lanes.p, lanes.u, nodes.state, nodes.angle
    # omega = A^-1 (H - K - sum_free h u), written into the rows of the slope until the slope replaces it
    for l in range(L):
        a, b, c = m[H + l], m[H + L + l], m[H + 2 * L + l]
        x = p[INVERSE + l] * a + p[INVERSE + L + l] * b + p[INVERSE + 2 * L + l] * c
        y = p[INVERSE + L + l] * a + p[INVERSE + 3 * L + l] * b + p[INVERSE + 4 * L + l] * c
        z = p[INVERSE + 2 * L + l] * a + p[INVERSE + 4 * L + l] * b + p[INVERSE + 5 * L + l] * c
        node[3 * L + l] = x - p[HELD_RATE + l]
        node[4 * L + l] = y - p[HELD_RATE + L + l]
        node[5 * L + l] = z - p[HELD_RATE + 2 * L + l]
    for i in range(n_wheels):
        w = i * PER_WHEEL
        for l in range(L):
            h = m[AXIAL + i * L + l]
            node[3 * L + l] -= h * u[w + LIFT + l]
            node[4 * L + l] -= h * u[w + LIFT + L + l]
            node[5 * L + l] -= h * u[w + LIFT + 2 * L + l]
    # sine and cosine of the half angle, as polynomials, which compile to vector operations
    for l in range(L):
        f = angle[l]
        q = f * f
        sine = f + f * q * (
            -1 / 6 + q * (1 / 120 + q * (-1 / 5040 + q * (1 / 362880 - q / 39916800)))
        )
        cosine = 1.0 + q * (-1 / 2 + q * (1 / 24 + q * (-1 / 720 + q * (1 / 40320 - q / 3628800))))
        angle[l], angle[L + l] = sine, cosine
    for l in range(L):  # the direction rotated about H by the whole angle (Rodrigues' formula)
        a, b, c = m[H + l], m[H + L + l], m[H + 2 * L + l]
        x, y, z = m[SUN + l], m[SUN + L + l], m[SUN + 2 * L + l]
        i = p[INVERSE_H + l]
        e = 2.0 * angle[l] * angle[l]  # 1 - cosine
        f = 2.0 * angle[l] * angle[L + l] * i  # sine / |H|
        g = 1.0 - e  # cosine
        e = e * i * i * (a * x + b * y + c * z)
        node[l] = g * x + f * (y * c - z * b) + e * a
        node[L + l] = g * y + f * (z * a - x * c) + e * b
        node[2 * L + l] = g * z + f * (x * b - y * a) + e * c
    for l in range(L):  # slope r x omega
        x, y, z = node[l], node[L + l], node[2 * L + l]
        a, b, c = node[3 * L + l], node[4 * L + l], node[5 * L + l]
        node[6 * L + l] = a * a + b * b + c * c
        node[3 * L + l] = y * c - z * b
        node[4 * L + l] = z * a - x * c
        node[5 * L + l] = x * b - y * a


@compiled
def longest_step(nodes, l, duration):
    """Return the longest step (s) of lane l, so that a way is at most `tolerance` rad and a run of `duration` has enough ways."""
    rate = math.sqrt(nodes.at[NODE + 6 * L + l] + 1e-20)
    return WAYS * min(nodes.tolerance / rate, duration / MIN_WAYS)


@compiled
def begin(lanes, nodes, n_wheels):
    """Write the first node of all lanes from their states, after a motion was loaded into a lane or had an event."""
    for j in range((6 + n_wheels) * L):
        nodes.state[j] = lanes.c[0, j]
    write_half_angle(lanes, nodes, np.zeros(L))
    write_node(lanes, nodes, n_wheels, nodes.at[NODE : NODE + PER_NODE])
    begin_way(nodes)


@compiled
def write_inner_nodes(lanes, nodes, n_wheels, order):
    """Write nodes 1 and 2, at one and two thirds of the step that is about to be taken, and the seconds between its nodes.

    It runs before `flow.move`: the coefficients and `lanes.since` are those at the start of the step. Node 0 is there already, and
    `deposit_step` writes node 3.
    """
    seconds_before, at = np.empty(L), nodes.at
    for k in range(1, WAYS):
        write_state_at(lanes, nodes, n_wheels, order, k / WAYS)
        for l in range(L):
            # negative: the node is later than `lanes.since`
            seconds_before[l] = -(k / WAYS) * lanes.share[l] * lanes.p[DT + l]
        write_half_angle(lanes, nodes, seconds_before)
        write_node(lanes, nodes, n_wheels, at[NODE + k * PER_NODE : NODE + (k + 1) * PER_NODE])
    for l in range(L):
        at[SECONDS + l] = lanes.share[l] * lanes.p[DT + l] / WAYS


@compiled
def deposit_step(lanes, nodes, n_wheels):
    """Write node 3, at the end of the step, which has been taken, and add the three ways to the histograms."""
    at = nodes.at
    for j in range((6 + n_wheels) * L):
        nodes.state[j] = lanes.c[0, j]
    write_half_angle(lanes, nodes, np.zeros(L))
    write_node(lanes, nodes, n_wheels, at[NODE + WAYS * PER_NODE : NODE + (WAYS + 1) * PER_NODE])
    # no loop: its indices would not be constants (rule 1 of `flow`), six times slower
    add_way(nodes, 0)
    add_way(nodes, 1)
    add_way(nodes, 2)
    # the last node of this step is the first of the next
    for j in range(PER_NODE):
        at[NODE + j] = at[NODE + WAYS * PER_NODE + j]
