"""Taylor series of the motion between events, for all lanes at once (equations: :mod:`sunspin.dynamics.gyrostat`, docs/model.md).

The equations are quadratic, so that the coefficient of order k + 1 follows from those up to k by sums of products:

    omega = A^-1 (H - K - sum_free h u)                               `write_rates`
        A: inertia less J u u^T of the free wheels; K: momentum of the held ones
    dH/dt = H x omega + torque,   dv/dt = v x omega                   `pair_writer`, `write_turned`
    dh/dt = -(sign(W) dry + viscous W),   W = h / J - u.omega         `write_series` (sign(W) dry is the row COULOMB)
    torque = 3 n^2 d x (I d),   dd/dt = d x (omega - turn)            `add_gravity_gradient`, `write_series`

for every vector v that stands in space. Coefficients are scaled by the step: c[k] holds (dt^k / k!) d^k y / dt^k, and the state
after the share x of the step is the sum of c[k] x^k.

The part SPIN H of omega is left out: the rows OMEGA hold omega - SPIN H. H does not notice, since H x H = 0; a direction v is then
seen from axes that turn about H at the rate SPIN |H|, which is most of its motion: what remains is slow, and steps are longer.
`wheels.straighten` brings directions back whenever they are needed.

Torques turn H in space. Then the part left out is SPIN PIVOT, of a vector that stands in space and was H when directions were last
straightened: for them the same holds about PIVOT, exactly, and what remains is slow while H is near it (`wheels.follow_momentum`).
H itself and the torque in space turn with omega, in rows of its own: H does not notice, and a torque that turns it by little in a
step adds little to the last coefficients.

What decides the speed, each found by measuring (`python -m bench kernels` keeps watch):

1. Offsets into arrays are constants, or a loop begins at 0. With an offset that is known at run time only, numba must check for
   negative indices and LLVM gives up vectors: 11 ns instead of 1.4 for a node of the histogram.
2. Sums are written `a = a + m * z - n * y`, a chain of fused operations, and not `a += m * z - n * y`.
3. Several orders in a pass (`move`, `wheels.are_watched`): short dependent chains over few lanes wait for themselves.
4. On processors with AVX-512 LLVM has to be told to use it (`processor`), and the number of rows is no power of two.
5. Arrays may come in one NamedTuple, which costs nothing; argument lists of twenty arrays are not needed.
"""

from __future__ import annotations

import math
from typing import Any

from sunspin.dynamics.kernels.rows import (
    ALLOWED,
    ALONG,
    AXIAL,
    AXIS,
    COULOMB,
    DT,
    FREE,
    GRADIENT,
    HELD_RATE,
    INERTIA,
    INVERSE_H,
    INVERSE_J,
    LIFT,
    NADIR,
    NX,
    NY,
    OMEGA,
    PER_WHEEL,
    PIVOT,
    PULL,
    RATE,
    REST,
    SPIN,
    STATE_ROWS,
    SUN,
    TORQUE,
    TORQUE_B,
    TURN,
    VISCOUS,
    WHEELS,
    H,
    L,
)
from sunspin.dynamics.processor import compiled


@compiled
def write_rates(lanes, n_wheels, k):
    """Write coefficient k of omega less SPIN H, and of u.omega for each wheel."""
    c, p, u = lanes.c, lanes.p, lanes.u
    for l in range(L):
        x, y, z = c[k, H + l], c[k, H + L + l], c[k, H + 2 * L + l]
        c[k, OMEGA + l] = p[REST + l] * x + p[REST + L + l] * y + p[REST + 2 * L + l] * z
        c[k, OMEGA + L + l] = (
            p[REST + L + l] * x + p[REST + 3 * L + l] * y + p[REST + 4 * L + l] * z
        )
        c[k, OMEGA + 2 * L + l] = (
            p[REST + 2 * L + l] * x + p[REST + 4 * L + l] * y + p[REST + 5 * L + l] * z
        )
    if k == 0:  # K is constant
        for l in range(3 * L):
            c[k, OMEGA + l] -= p[HELD_RATE + l]
    for i in range(n_wheels):
        w = i * PER_WHEEL
        for l in range(L):
            h = c[k, AXIAL + i * L + l]
            # LIFT, A^-1 u, is zero for a wheel that is not free
            c[k, OMEGA + l] = c[k, OMEGA + l] - h * u[w + LIFT + l]
            c[k, OMEGA + L + l] = c[k, OMEGA + L + l] - h * u[w + LIFT + L + l]
            c[k, OMEGA + 2 * L + l] = c[k, OMEGA + 2 * L + l] - h * u[w + LIFT + 2 * L + l]
    for i in range(n_wheels):  # all wheels count in omega, hence a second loop
        w = i * PER_WHEEL
        for l in range(L):
            spin = p[SPIN + l]
            x = c[k, OMEGA + l] + spin * c[k, H + l]
            y = c[k, OMEGA + L + l] + spin * c[k, H + L + l]
            z = c[k, OMEGA + 2 * L + l] + spin * c[k, H + 2 * L + l]
            c[k, ALONG + i * L + l] = (
                u[w + AXIS + l] * x + u[w + AXIS + L + l] * y + u[w + AXIS + 2 * L + l] * z
            )


@compiled
def write_rates_under_torques(c, p, k):
    """Write coefficient k of omega, and of omega less SPIN PIVOT instead of omega less SPIN H."""
    for l in range(L):
        spin = p[SPIN + l]
        x, y, z = spin * c[k, H + l], spin * c[k, H + L + l], spin * c[k, H + 2 * L + l]
        c[k, RATE + l] = c[k, OMEGA + l] + x
        c[k, RATE + L + l] = c[k, OMEGA + L + l] + y
        c[k, RATE + 2 * L + l] = c[k, OMEGA + 2 * L + l] + z
        c[k, OMEGA + l] = c[k, RATE + l] - spin * c[k, PIVOT + l]
        c[k, OMEGA + L + l] = c[k, RATE + L + l] - spin * c[k, PIVOT + L + l]
        c[k, OMEGA + 2 * L + l] = c[k, RATE + 2 * L + l] - spin * c[k, PIVOT + 2 * L + l]


@compiled
def add_turned(c, k, V, rate, slope):
    """Add coefficient k of v x w to `slope` (3 L), v and w being the vectors in the rows from V and from `rate`."""
    for i in range(k + 1):
        j = k - i
        for l in range(L):
            x, y, z = c[j, rate + l], c[j, rate + L + l], c[j, rate + 2 * L + l]
            a, b, d = c[i, V + l], c[i, V + L + l], c[i, V + 2 * L + l]
            slope[l] = slope[l] + b * z - d * y
            slope[L + l] = slope[L + l] + d * x - a * z
            slope[2 * L + l] = slope[2 * L + l] + a * y - b * x


@compiled
def write_turned(c, p, k, V, slope):
    """Write coefficient k + 1 of a vector v that stands in space, in the rows from V: of dv/dt = v x omega, under torques."""
    for l in range(3 * L):
        slope[l] = 0.0
    add_turned(c, k, V, RATE, slope)
    write_next(c, p, k, V, slope)


def pair_writer(V: int, U: int, W: int) -> Any:
    """Return the function that writes coefficient k of v x w and u x w for two vectors into `slope` (6 L), w being a rate.

    They lie in the rows from V, U and W, constants of its machine code (rule 1). The products (i, j) and (j, i), j = k - i, are
    added together, and the rate is read once for both vectors: 0.4 of the time of two calls of `write_turned`.
    """

    @compiled
    def write_turned_pair(c, k, slope):
        """Write coefficient k of both derivatives."""
        for l in range(6 * L):
            slope[l] = 0.0
        for i in range((k + 1) // 2):
            j = k - i
            for l in range(L):
                x, y, z = c[j, W + l], c[j, W + L + l], c[j, W + 2 * L + l]
                p, q, r = c[i, W + l], c[i, W + L + l], c[i, W + 2 * L + l]
                a, b, d = c[i, V + l], c[i, V + L + l], c[i, V + 2 * L + l]
                e, f, g = c[j, V + l], c[j, V + L + l], c[j, V + 2 * L + l]
                slope[l] = slope[l] + b * z - d * y + f * r - g * q
                slope[L + l] = slope[L + l] + d * x - a * z + g * p - e * r
                slope[2 * L + l] = slope[2 * L + l] + a * y - b * x + e * q - f * p
                a, b, d = c[i, U + l], c[i, U + L + l], c[i, U + 2 * L + l]
                e, f, g = c[j, U + l], c[j, U + L + l], c[j, U + 2 * L + l]
                slope[3 * L + l] = slope[3 * L + l] + b * z - d * y + f * r - g * q
                slope[4 * L + l] = slope[4 * L + l] + d * x - a * z + g * p - e * r
                slope[5 * L + l] = slope[5 * L + l] + a * y - b * x + e * q - f * p
        if k % 2 == 0:  # the product in the middle is its own partner
            i = k // 2
            for l in range(L):
                x, y, z = c[i, W + l], c[i, W + L + l], c[i, W + 2 * L + l]
                a, b, d = c[i, V + l], c[i, V + L + l], c[i, V + 2 * L + l]
                slope[l] = slope[l] + b * z - d * y
                slope[L + l] = slope[L + l] + d * x - a * z
                slope[2 * L + l] = slope[2 * L + l] + a * y - b * x
                a, b, d = c[i, U + l], c[i, U + L + l], c[i, U + 2 * L + l]
                slope[3 * L + l] = slope[3 * L + l] + b * z - d * y
                slope[4 * L + l] = slope[4 * L + l] + d * x - a * z
                slope[5 * L + l] = slope[5 * L + l] + a * y - b * x

    return write_turned_pair


write_H_and_sun, write_attitude = pair_writer(H, SUN, OMEGA), pair_writer(NX, NY, OMEGA)
"""Half of all time is spent in the first. H x omega is H x (omega - SPIN H)."""

write_H_and_torque, write_sun_and_pivot = (
    pair_writer(H, TORQUE, RATE),
    pair_writer(SUN, PIVOT, OMEGA),
)
"""The same under torques."""


@compiled
def write_next_pair(c, p, k, V, U, slope):
    """Write coefficient k + 1 of two vectors in the rows from V and U from coefficient k of their derivatives, `slope` (6 L)."""
    part = 1.0 / (k + 1)
    for l in range(L):
        d = part * p[DT + l]
        c[k + 1, V + l] = d * slope[l]
        c[k + 1, V + L + l] = d * slope[L + l]
        c[k + 1, V + 2 * L + l] = d * slope[2 * L + l]
        c[k + 1, U + l] = d * slope[3 * L + l]
        c[k + 1, U + L + l] = d * slope[4 * L + l]
        c[k + 1, U + 2 * L + l] = d * slope[5 * L + l]


@compiled
def add_gravity_gradient(c, p, k, slope):
    """Add coefficient k of the gravity gradient, 3 n^2 d x (I d) with the nadir d (eq. 23), to the first three rows of `slope`.

    Few motions have it, so that the rule on sums (2) is not followed here.
    """
    for i in range(k + 1):
        j = k - i
        for l in range(L):
            x, y, z = c[j, NADIR + l], c[j, NADIR + L + l], c[j, NADIR + 2 * L + l]
            e = p[INERTIA + l] * x + p[INERTIA + L + l] * y + p[INERTIA + 2 * L + l] * z
            f = p[INERTIA + L + l] * x + p[INERTIA + 3 * L + l] * y + p[INERTIA + 4 * L + l] * z
            g = p[INERTIA + 2 * L + l] * x + p[INERTIA + 4 * L + l] * y + p[INERTIA + 5 * L + l] * z
            a, b, d = c[i, NADIR + l], c[i, NADIR + L + l], c[i, NADIR + 2 * L + l]
            slope[l] += p[PULL + l] * (b * g - d * f)
            slope[L + l] += p[PULL + l] * (d * e - a * g)
            slope[2 * L + l] += p[PULL + l] * (a * f - b * e)


@compiled
def write_next(c, p, k, V, slope):
    """Write coefficient k + 1 of the vector in the rows from V from coefficient k of its derivative, `slope` (3 L)."""
    part = 1.0 / (k + 1)
    for j in range(3):
        for l in range(L):
            c[k + 1, V + j * L + l] = part * p[DT + l] * slope[j * L + l]


@compiled
def write_series(lanes, n_wheels, order, torques, attitude):
    """Write all coefficients of the motion up to `order`, from the state in c[0]."""
    c, p, u, slope = lanes.c, lanes.p, lanes.u, lanes.slope
    for k in range(order):
        write_rates(lanes, n_wheels, k)
        if torques:
            write_rates_under_torques(c, p, k)
            write_H_and_torque(c, k, slope)
            if k == 0:
                for l in range(3 * L):
                    slope[l] += p[TORQUE_B + l]
            for l in range(3 * L):
                slope[l] += c[k, TORQUE + l]
            if torques == GRADIENT:
                add_gravity_gradient(c, p, k, slope)
            write_next_pair(c, p, k, H, TORQUE, slope)
            write_sun_and_pivot(c, k, slope)
            write_next_pair(c, p, k, SUN, PIVOT, slope)
            if torques == GRADIENT:
                write_turned(c, p, k, TURN, slope)
                # the nadir d turns in space: d x (omega - turn) = turn x d + d x omega
                for l in range(3 * L):
                    slope[l] = 0.0
                add_turned(c, k, TURN, NADIR, slope)
                add_turned(c, k, NADIR, RATE, slope)
                write_next(c, p, k, NADIR, slope)
        else:
            write_H_and_sun(c, k, slope)
            write_next_pair(c, p, k, H, SUN, slope)
        if attitude:
            write_attitude(c, k, slope)
            write_next_pair(c, p, k, NX, NY, slope)
        part, dry = 1.0 / (k + 1), 1.0 if k == 0 else 0.0  # dry friction is constant between events
        for i in range(n_wheels):
            w = i * PER_WHEEL
            for l in range(L):
                speed = c[k, AXIAL + i * L + l] * u[w + INVERSE_J + l] - c[k, ALONG + i * L + l]
                friction = dry * u[w + COULOMB + l] + u[w + VISCOUS + l] * speed
                c[k + 1, AXIAL + i * L + l] = -part * p[DT + l] * u[w + FREE + l] * friction
    if n_wheels:
        write_rates(lanes, n_wheels, order)  # the events need u.omega to the last order


SIXTEENTH_ROOT_ABOVE = 11
"""Order up to which an 8th root serves for the length of a step, and above it a 16th."""


@compiled
def write_share(lanes, order):
    """Write into `share[:L]` the share x of the step that keeps the error allowed per second: |c_N| x^N = allowed x dt.

    H and r alone steer the step: errors of other vectors, which turn with the same omega, are as large. x is found after the
    coefficients and before the series is evaluated, and may exceed one; so no step is repeated. `motions.GROWTH` limits it. The
    root taken is the 8th or the 16th, not the (N - 1)th: each step begins from the length of the last one, and in a few steps the
    length settles where x is one, which is where the last coefficient is what is allowed. The coefficient before the last counts
    by a quarter, found by trial: the last alone may vanish by chance.
    """
    c, p, share = lanes.c, lanes.p, lanes.share
    tiny = 1e-30
    for l in range(L):
        per_H = p[INVERSE_H + l]
        a = (
            max(abs(c[order, H + l]), abs(c[order, H + L + l]), abs(c[order, H + 2 * L + l]))
            * per_H
        )
        n = order - 1
        b = max(abs(c[n, H + l]), abs(c[n, H + L + l]), abs(c[n, H + 2 * L + l])) * per_H
        a = max(
            a,
            abs(c[order, SUN + l]),
            abs(c[order, SUN + L + l]),
            abs(c[order, SUN + 2 * L + l]),
        )
        b = max(b, abs(c[n, SUN + l]), abs(c[n, SUN + L + l]), abs(c[n, SUN + 2 * L + l]))
        ratio = p[ALLOWED + l] * abs(p[DT + l]) / (max(a, 0.25 * b) + tiny)
        share[l] = math.sqrt(math.sqrt(math.sqrt(ratio)))
    if order > SIXTEENTH_ROOT_ABOVE:
        for l in range(L):
            share[l] = math.sqrt(share[l])


@compiled
def rows_in_use(n_wheels, torques, attitude):
    """Return how many rows of the state, from the first on, take part in the motion; their order is that of `rows`."""
    of_torques = 6 + WHEELS + 6  # H, r and h; the torque in space and PIVOT
    if torques == GRADIENT:
        return STATE_ROWS
    if attitude:
        return of_torques + 6
    return of_torques if torques else 6 + n_wheels


@compiled
def move(lanes, order, n_rows):
    """Advance the state y by the share of the step that each lane goes, four orders in a pass, and copy it to c[0].

    `share` holds the share of each lane in all rows. Coefficients beyond `order` are zero, as the arrays of a run are made for its
    order; so are those of rows in use that no equation writes (the attitude, if only torques are asked for).
    """
    c, y, share, sums = lanes.c, lanes.y, lanes.share, lanes.sums
    top = 4 * ((order + 3) // 4)
    for j in range(n_rows * L):
        sums[j] = c[top, j]
    for k in range(top - 4, 0, -4):
        for j in range(n_rows * L):
            x = share[j]
            sums[j] = (((sums[j] * x + c[k + 3, j]) * x + c[k + 2, j]) * x + c[k + 1, j]) * x + c[
                k, j
            ]
    for j in range(n_rows * L):
        x = share[j]
        y[j] += (((sums[j] * x + c[3, j]) * x + c[2, j]) * x + c[1, j]) * x
        c[0, j] = y[j]


@compiled
def value_at(c, order, row, x):
    """Return what stands in one place of a row at the share x of the step: the sum of c[k] x^k."""
    total = c[order, row]
    for k in range(order - 1, -1, -1):
        total = total * x + c[k, row]
    return total
