"""Taylor series of the motion between events, for all lanes at once (equations: :mod:`sunspin.dynamics.gyrostat`, docs/model.md).

The equations are quadratic, so that the coefficient of order k + 1 follows from those up to k by sums of products:

    omega = A^-1 (H - K - sum_free h u)                               `write_rates`
        A: inertia less J u u^T of the free wheels; K: momentum of the held ones
    dH/dt = H x omega + torque,   dv/dt = v x omega                   `pair_writer`, `add_turned`
    dh/dt = -(sign(W) dry + viscous W),   W = h / J - u.omega         `write_series` (sign(W) dry is the row COULOMB)
    torque = 3 n^2 d x (I d),   dd/dt = d x (omega - turn)            `add_gravity_gradient`, `write_series`

for every vector v that is fixed in space. Coefficients are scaled by the step: c[k] holds (dt^k / k!) d^k y / dt^k, and the state
after the share x of the step is the sum of c[k] x^k.

**The common rotation** SPIN H is a part of omega that is treated apart; SPIN is a number in 1/(kg m2) for each lane. Rows OMEGA
hold omega - SPIN H. H itself does not depend on it, since H x H = 0. A direction v is then given in axes that rotate about H at the
rate SPIN |H| relative to the body. That is most of its motion: the rest is slow, and steps are longer. `wheels.straighten` brings
directions back to body axes when they are needed.

Torques change H in space. Then the part treated apart is SPIN PIVOT. PIVOT is a vector fixed in space, equal to H when directions
were last straightened. For directions the same holds about PIVOT, exactly, and the rest is slow while H is near it
(`wheels.follow_momentum`). H itself and the torque in space are integrated with all of omega, which is in the rows RATE.

**Names**: c, p, u are those arrays of :class:`~sunspin.dynamics.kernels.rows.Lanes`, and names in capitals their rows. l counts
lanes, k orders, i wheels; w is where the numbers of a wheel begin. Single letters such as x, y, z and a, b, d are the components of
one vector each.

**What decides the speed**, each point found by measuring (`python -m bench kernels` repeats it):

1. Offsets into arrays are constants, or a loop begins at 0. With an offset that is known at run time only, numba must check for
   negative indices and LLVM gives up vectors: 11 ns instead of 1.4 for a node of the histogram.
2. Sums are written `a = a + m * z - n * y`, a chain of fused operations, and not `a += m * z - n * y`.
3. Several orders are computed in a pass (`move`, `are_watched`): in short chains each operation waits for the one before.
4. On processors with AVX-512 LLVM has to be told to use it (`processor`), and the number of rows is no power of two.
5. Arrays may come in one NamedTuple, which costs nothing.
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
    """Write coefficient k of omega - SPIN H into the rows OMEGA, and of u.omega for each wheel into ALONG.

    omega - SPIN H = (A^-1 - SPIN) H - A^-1 K - sum_free h A^-1 u, with the rows REST, HELD_RATE and LIFT for the three parts.
    """
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
            # LIFT is zero for a wheel that is not free
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
    """Write coefficient k of omega into the rows RATE, and change that in OMEGA from omega - SPIN H to omega - SPIN PIVOT."""
    for l in range(L):
        spin = p[SPIN + l]
        # omega = (omega - SPIN H) + SPIN H
        x, y, z = spin * c[k, H + l], spin * c[k, H + L + l], spin * c[k, H + 2 * L + l]
        c[k, RATE + l] = c[k, OMEGA + l] + x
        c[k, RATE + L + l] = c[k, OMEGA + L + l] + y
        c[k, RATE + 2 * L + l] = c[k, OMEGA + 2 * L + l] + z
        c[k, OMEGA + l] = c[k, RATE + l] - spin * c[k, PIVOT + l]
        c[k, OMEGA + L + l] = c[k, RATE + L + l] - spin * c[k, PIVOT + L + l]
        c[k, OMEGA + 2 * L + l] = c[k, RATE + 2 * L + l] - spin * c[k, PIVOT + 2 * L + l]


@compiled
def add_turned(c, k, V, rate, slope):
    """Add coefficient k of v x w to `slope` (3 L). The vectors v and w are in the rows from V and from `rate` on.

    The coefficient of a product is the sum of the products of coefficients i and k - i.
    """
    for i in range(k + 1):
        j = k - i
        for l in range(L):
            x, y, z = c[j, rate + l], c[j, rate + L + l], c[j, rate + 2 * L + l]
            a, b, d = c[i, V + l], c[i, V + L + l], c[i, V + 2 * L + l]
            slope[l] = slope[l] + b * z - d * y
            slope[L + l] = slope[L + l] + d * x - a * z
            slope[2 * L + l] = slope[2 * L + l] + a * y - b * x


def pair_writer(V: int, U: int, W: int) -> Any:
    """Return a function that writes coefficient k of v x w and of u x w into `slope` (6 L), for two vectors and a rate w.

    They are in the rows from V, U and W on, which are constants of its machine code (rule 1). The products (i, j) and (j, i), with
    j = k - i, are added together, and the rate is read once for both vectors: 0.4 of the time of two calls of `add_turned`.
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
        if k % 2 == 0:  # the product with i = j
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
"""Writers of derivatives: of H and the direction to the Sun, where half of all time is spent, and of the axes x and y of N."""

write_H_and_torque = pair_writer(H, TORQUE, RATE)
write_sun_and_pivot = pair_writer(SUN, PIVOT, OMEGA)
"""The same under torques: of H and the torque in space, and of the direction to the Sun and PIVOT."""


@compiled
def write_next_pair(c, p, k, V, U, slope):
    """Write coefficient k + 1 of two vectors, in rows from V and U on, from coefficient k of their derivatives, `slope` (6 L)."""
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
    """Add coefficient k of the gravity gradient's torque, 3 n^2 d x (I d) with the nadir d (paper, eq. 23), to dH/dt.

    dH/dt is in the first three rows of `slope`. The coefficient of a product is the sum over i + j = k of d_i x (I d_j). Rule 2 on
    sums is not followed here, since few motions have this torque.
    """
    for i in range(k + 1):
        j = k - i
        for l in range(L):
            # x, y, z: d_j; e, f, g: I d_j, with I as xx, xy, xz, yy, yz, zz; a, b, d: d_i
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
    """Write coefficient k + 1 of a vector, in the rows from V on, from coefficient k of its derivative, `slope` (3 L)."""
    part = 1.0 / (k + 1)
    for j in range(3):
        for l in range(L):
            c[k + 1, V + j * L + l] = part * p[DT + l] * slope[j * L + l]


@compiled
def write_series(lanes, n_wheels, order, torques, attitude):
    """Write all coefficients of the motion up to `order`, from the state in c[0].

    `torques` is a code of `rows`; `attitude`: whether the axes of N are integrated too.
    """
    c, p, u, slope = lanes.c, lanes.p, lanes.u, lanes.slope
    for k in range(order):
        write_rates(lanes, n_wheels, k)
        if torques:
            write_rates_under_torques(c, p, k)
            write_H_and_torque(c, k, slope)
            if k == 0:  # the torque in body axes is constant
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
                # the rate of the nadir is fixed in space
                for l in range(3 * L):
                    slope[l] = 0.0
                add_turned(c, k, TURN, RATE, slope)
                write_next(c, p, k, TURN, slope)
                # the nadir d rotates in space: d x (omega - turn) = turn x d + d x omega
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
"""Order up to which an 8th root is used for the length of a step, and above it a 16th."""


@compiled
def write_share(lanes, order):
    """Write into `share[:L]` the length x of the coming step as a share of DT, so that its error is what is allowed.

    DT is the length that was planned at the step before, by which the coefficients c are scaled. The error of the step is estimated
    by its last term, |c_N| x^N, and may be ALLOWED x DT. Only H and r are looked at: errors of other vectors, which rotate with the
    same omega, are as large. The coefficients are known here and the series is not evaluated yet, so a step that would be too long
    is evaluated at x < 1, and none is repeated. x may exceed one; `motions.GROWTH` limits it.

    Exactly, x is the (N - 1)th root of the ratio ALLOWED DT / |c_N|. The 8th or the 16th root, taken by square roots alone, settles
    at the same length: each step begins from the length of the last one, and in a few steps the ratio, and so x, is 1. The
    coefficient before the last counts by a quarter, a factor found by trial: the last alone may vanish by chance.
    """
    c, p, share = lanes.c, lanes.p, lanes.share
    n, m = order, order - 1
    tiny = 1e-30
    for l in range(L):
        per_H = p[INVERSE_H + l]
        # largest component of H over |H|, then of r, in the last coefficient and in the one before
        last = max(abs(c[n, H + l]), abs(c[n, H + L + l]), abs(c[n, H + 2 * L + l])) * per_H
        before = max(abs(c[m, H + l]), abs(c[m, H + L + l]), abs(c[m, H + 2 * L + l])) * per_H
        last = max(last, abs(c[n, SUN + l]), abs(c[n, SUN + L + l]), abs(c[n, SUN + 2 * L + l]))
        before = max(before, abs(c[m, SUN + l]), abs(c[m, SUN + L + l]), abs(c[m, SUN + 2 * L + l]))
        # allowed over estimated error, of a step of the length DT
        ratio = p[ALLOWED + l] * abs(p[DT + l]) / (max(last, 0.25 * before) + tiny)
        share[l] = math.sqrt(math.sqrt(math.sqrt(ratio)))
    if order > SIXTEENTH_ROOT_ABOVE:
        for l in range(L):
            share[l] = math.sqrt(share[l])


@compiled
def rows_in_use(n_wheels, torques, attitude):
    """Return how many rows of the state, from the first on, have to be advanced; rows are in the order of the module `rows`."""
    of_torques = 6 + WHEELS + 6  # H, r and h; the torque in space and PIVOT
    if torques == GRADIENT:
        return STATE_ROWS
    if attitude:
        return of_torques + 6
    return of_torques if torques else 6 + n_wheels


@compiled
def move(lanes, order, n_rows):
    """Advance the state y by the share x of the step that each lane takes: y + sum of c[k] x^k, by Horner's rule; copy it to c[0].

    Four orders are added in a pass. Coefficients beyond `order` are zero, as are those of rows in use that no equation writes (such
    as the attitude, if it is not computed).
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
    """Return the number at index `row` of the state at the share x of the step: the sum of c[k] x^k."""
    total = c[order, row]
    for k in range(order - 1, -1, -1):
        total = total * x + c[k, row]
    return total
