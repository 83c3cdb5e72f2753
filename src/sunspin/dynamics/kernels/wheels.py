"""Events of wheels: when the next one happens, and what the wheel does then. Lanes are treated one by one, except in `are_watched`.

A free wheel comes to rest when its speed W = h / J - u.omega is zero. A wheel that friction holds breaks away when the torque that
holds it, J u.domega/dt, reaches the limit of dry friction (paper, eq. 6). In a step both are polynomials of its share x, whose
coefficients are known: u.omega is among the rows of the series, and its derivative follows from it. `are_watched` bounds both for
all lanes. If the bound does not exclude an event, `first_event` computes the first zero, and the step ends there.

After an event a lane is in a new mode: other wheels turn freely, and A^-1 belongs to another set of them (`set_mode`). Names are
those of :mod:`~sunspin.dynamics.kernels.flow`.
"""

from __future__ import annotations

import math

import numpy as np

from sunspin.dynamics.kernels.rows import (
    ALONG,
    AXIAL,
    AXIS,
    BREAKS_AWAY,
    COULOMB,
    DRY,
    DT,
    FREE,
    GRADIENT,
    HELD,
    HELD_RATE,
    INERTIA,
    INVERSE,
    INVERSE_J,
    LIFT,
    NADIR,
    NX,
    NY,
    OVERLOADED,
    PER_WHEEL,
    PIVOT,
    PULL,
    REST,
    RESTS,
    REVERSES,
    ROWS,
    SIGN,
    SPIN,
    STOPS,
    SUN,
    TORQUE,
    TORQUE_B,
    VISCOUS,
    WHEELS,
    H,
    L,
)
from sunspin.dynamics.processor import compiled

MARGIN = 1e-10
"""A wheel whose load exceeds its limit by less than this share stays stuck: the next step shows whether it breaks away."""

ROUNDING = 1e-11
"""Relative error of coefficients of u.omega by rounding."""

NO_ZERO = 2.0
"""Result of `first_zero` if there is none: more than any share of a step."""

FAR = 0.02
"""Part of |H| by which torques may move H from PIVOT before directions are straightened. What this adds to the rest of omega is a
seventh of the rest that Philae's unequal moments leave."""


# ---- where the next event is ---------------------------------------------------------------------
@compiled
def are_watched(lanes, n_wheels, order, margin):
    """Write into `margin` (L) a lower bound of the distance from any event in a step; return whether an event is possible.

    For a turning wheel it is |W| at the start less the sum of |coefficients of W| x^k, for a stuck one the limit less the same sum
    for the derivative of u.omega. An event is possible in a lane if it is not positive. Two orders are added in a pass.
    """
    c, p, u, share, sums = lanes.c, lanes.p, lanes.u, lanes.share, lanes.sums
    for l in range(L):
        margin[l] = 1.0
    for i in range(n_wheels):
        w = i * PER_WHEEL
        for l in range(2 * L):
            sums[l] = 0.0
        for k in range(order + order % 2, 0, -2):
            m, n = float(k), float(k - 1)
            for l in range(L):
                x, j = share[l], u[w + INVERSE_J + l]
                a, b = c[k, ALONG + i * L + l], c[k - 1, ALONG + i * L + l]
                first = abs(c[k, AXIAL + i * L + l] * j - a)
                second = abs(c[k - 1, AXIAL + i * L + l] * j - b)
                # of W, and of the derivative of u.omega
                sums[l] = ((sums[l] + first) * x + second) * x
                sums[L + l] = (sums[L + l] * x + m * abs(a)) * x + n * abs(b)
        for l in range(L):
            j = u[w + INVERSE_J + l]
            turning = abs(c[0, AXIAL + i * L + l] * j - c[0, ALONG + i * L + l]) - sums[l]
            stuck = u[w + DRY + l] * j * abs(p[DT + l]) - sums[L + l]
            turning = turning if u[w + SIGN + l] != 0.0 else 1.0
            stuck = stuck if u[w + DRY + l] > 0.0 else 1.0
            margin[l] = min(margin[l], turning if u[w + FREE + l] > 0.5 else stuck)
    watched = False
    for l in range(L):
        watched |= margin[l] <= 0.0
    return watched


@compiled
def first_zero(f, degree, high, floor):
    """Return the first zero in (0, high] of the polynomial f[0] + f[1] x + ..., positive at the start; NO_ZERO if there is none.

    At x it has the value a, the slope b and a second derivative of at most s in size. So it stays positive over a distance d up to
    the zero of a + b d - s d^2 / 2, and steps of this length cannot pass a zero. First coefficients up to `floor` are errors of a
    polynomial that has just left zero: the polynomial is divided by x or x^2 to remove them.
    """
    size = 0.0
    for k in range(degree + 1):
        size += abs(f[k]) * high**k
    begin = 0
    while begin < 2 and abs(f[begin]) <= max(floor, 1e-15 * size):
        begin += 1
    if f[begin] <= 0.0:
        return 0.0
    bend = 0.0  # bound of the second derivative
    for k in range(begin + 2, degree + 1):
        bend += (k - begin) * (k - begin - 1) * abs(f[k]) * high ** (k - begin - 2)
    x = 0.0
    for _ in range(10000):
        # value and slope by Horner's rule
        a, b = f[degree], 0.0
        for k in range(degree - 1, begin - 1, -1):
            b = b * x + a
            a = a * x + f[k]
        if a <= 1e-15 * size:
            return x
        root = math.sqrt(b * b + 2.0 * bend * a)
        if b < 0.0:
            d = 2.0 * a / (root - b)
        else:
            d = (b + root) / bend if bend > 0.0 else 2.0 * high
        if x + d >= high:
            return NO_ZERO
        x += d
        if d < 1e-15 * high:
            return x
    return x


@compiled
def first_event(lanes, n_wheels, order, l, high):
    """Return the wheel of the first event of lane l in (0, high], and its share of the step; -1 and `high` if there is none.

    After an event the polynomial of the next step begins at zero, except for rounding and the truncation of the series. `floor`
    bounds these errors. For a turning wheel it is twice that of a stuck one: otherwise the same errors could stop a wheel that was
    just released at its limit, which would then be released again, without end.
    """
    c, p, u, f = lanes.c, lanes.p, lanes.u, lanes.polynomial
    wheel, place = -1, high
    for i in range(n_wheels):
        w, a = i * PER_WHEEL + l, ALONG + i * L + l
        limit = u[w + DRY] * u[w + INVERSE_J] * abs(p[DT + l])  # of u.domega/dt, per step
        floor = ROUNDING * limit + order * (abs(c[order, a]) + abs(c[order - 1, a]))
        for k in range(1, order + 1):
            floor += ROUNDING * k * abs(c[k, a])
        if u[w + SIGN] != 0.0:  # a turning wheel that dry friction will stop: |W|
            for k in range(order + 1):
                speed = c[k, AXIAL + i * L + l] * u[w + INVERSE_J] - c[k, a]
                f[k] = u[w + SIGN] * speed
            zero = first_zero(f, order, place, 2.0 * floor)
            if zero < NO_ZERO:
                wheel, place = i, zero
        elif u[w + FREE] < 0.5 and u[w + DRY] > 0.0:
            # a stuck wheel: limit +- derivative of u.omega
            for sign in (-1.0, 1.0):
                for k in range(order):
                    f[k] = sign * (k + 1) * c[k + 1, a]
                f[0] += limit
                zero = first_zero(f, order - 1, place, floor)
                if zero < NO_ZERO:
                    wheel, place = i, zero
    return wheel, place


# ---- modes ---------------------------------------------------------------------------------------
@compiled
def multiply(p, first, l, vector, product):
    """Write into `product` (3) a symmetric matrix, the six rows of `p` from `first` on in lane l, times a vector (3)."""
    x, y, z = vector[0], vector[1], vector[2]
    product[0] = p[first + l] * x + p[first + L + l] * y + p[first + 2 * L + l] * z
    product[1] = p[first + L + l] * x + p[first + 3 * L + l] * y + p[first + 4 * L + l] * z
    product[2] = p[first + 2 * L + l] * x + p[first + 4 * L + l] * y + p[first + 5 * L + l] * z


@compiled
def along_axis(u, w, vector):
    """Return u . vector for the wheel whose numbers in a lane begin at `w`."""
    return u[w + AXIS] * vector[0] + u[w + AXIS + L] * vector[1] + u[w + AXIS + 2 * L] * vector[2]


@compiled
def write_seen(y, V, lanes, l, seconds, torques, out):
    """Write into `out` (3), in body axes, the direction in the rows of `y` from V on, lane l.

    The rows hold it in axes that have rotated for `seconds` about H at the rate SPIN |H|, under torques about PIVOT. It is rotated
    back with Rodrigues' formula.
    """
    P = PIVOT if torques else H
    x, y_, z = y[V + l], y[V + L + l], y[V + 2 * L + l]
    a, b, c = y[P + l], y[P + L + l], y[P + 2 * L + l]
    square = a * a + b * b + c * c
    if lanes.p[SPIN + l] == 0.0 or square == 0.0:
        out[0], out[1], out[2] = x, y_, z
        return
    size = math.sqrt(square)
    angle = lanes.p[SPIN + l] * size * seconds
    cosine, sine = math.cos(angle), math.sin(angle) / size
    along = (1.0 - cosine) * (a * x + b * y_ + c * z) / square
    out[0] = cosine * x + sine * (y_ * c - z * b) + along * a
    out[1] = cosine * y_ + sine * (z * a - x * c) + along * b
    out[2] = cosine * z + sine * (x * b - y_ * a) + along * c


@compiled
def straighten(lanes, l, torques):
    """Bring the directions of lane l back from the axes that rotate about H, or PIVOT, to body axes, and set PIVOT to H."""
    out = np.empty(3)
    for V in (SUN, NX, NY):
        write_seen(lanes.y, V, lanes, l, lanes.since[l], torques, out)
        for j in range(3):
            lanes.y[V + j * L + l] = out[j]
    if torques:
        for j in range(3):
            lanes.y[PIVOT + j * L + l] = lanes.y[H + j * L + l]
    lanes.since[l] = 0.0


@compiled
def follow_momentum(lanes, torques):
    """Straighten the directions of those lanes in which H has moved far from PIVOT; needed after a step under torques."""
    y = lanes.y
    for l in range(L):
        off, size = 0.0, 0.0
        for j in range(3):
            off += (y[H + j * L + l] - y[PIVOT + j * L + l]) ** 2
            size += y[PIVOT + j * L + l] ** 2
        if off > FAR**2 * size:
            straighten(lanes, l, torques)
            for V in (SUN, PIVOT, NX, NY):
                for j in range(3):
                    lanes.c[0, V + j * L + l] = y[V + j * L + l]


@compiled
def set_mode(lanes, n_wheels, l, modes, torques):
    """Write the numbers of lane l that depend on which wheels turn freely: SPIN, A^-1, A^-1 less SPIN, A^-1 K and A^-1 u.

    Also copy the state `y` into c[0], where the series of the next step begins. `modes` (2^n_wheels, 7): SPIN and A^-1 of this
    motion for each set of free wheels, as in :class:`rows.Motions`; `torques`: their code in `rows`.
    """
    y, p, u = lanes.y, lanes.p, lanes.u
    # the directions are in axes that rotate by the old SPIN: they are brought back to body axes before it changes
    straighten(lanes, l, torques)
    mode = 0  # bit i: wheel i turns freely
    for i in range(n_wheels):
        if u[i * PER_WHEEL + FREE + l] > 0.5:
            mode |= 1 << i
    p[SPIN + l] = modes[mode, 0]
    for k in range(6):
        p[INVERSE + k * L + l] = modes[mode, 1 + k]
        p[REST + k * L + l] = modes[mode, 1 + k]
    for k in (0, 3, 5):  # the diagonal
        p[REST + k * L + l] -= p[SPIN + l]
    vector, product = np.empty(3), np.empty(3)
    for k in range(3):
        vector[k] = p[HELD + k * L + l]
    multiply(p, INVERSE, l, vector, product)
    for k in range(3):
        p[HELD_RATE + k * L + l] = product[k]
    for i in range(n_wheels):
        w = i * PER_WHEEL + l
        for k in range(3):
            vector[k] = u[w + AXIS + k * L]
        multiply(p, INVERSE, l, vector, product)
        for k in range(3):
            u[w + LIFT + k * L] = u[w + FREE] * product[k]
    for j in range(ROWS):
        lanes.c[0, j * L + l] = y[j * L + l]


@compiled
def write_body_rate(y, lanes, n_wheels, l, omega):
    """Write omega (3) of lane l for the state `y`: A^-1 (H - K - sum_free h u)."""
    p, u = lanes.p, lanes.u
    rest = np.empty(3)
    for k in range(3):
        rest[k] = y[H + k * L + l] - p[HELD + k * L + l]
        for i in range(n_wheels):
            w = i * PER_WHEEL + l
            rest[k] -= u[w + FREE] * y[AXIAL + i * L + l] * u[w + AXIS + k * L]
    multiply(p, INVERSE, l, rest, omega)


@compiled
def write_holding(lanes, n_wheels, l, torques, omega, holding):
    """Write `omega` (3) of lane l, and into `holding` (n_wheel) the torque J u.domega/dt, N m, which keeps the speed of each wheel.

    domega/dt = A^-1 (H x omega + torques - sum_free M u), with the friction torque M on a free wheel.
    """
    y, p, u = lanes.y, lanes.p, lanes.u
    write_body_rate(y, lanes, n_wheels, l, omega)
    moment, acceleration = np.empty(3), np.empty(3)
    # H x omega, external torques, then the friction of free wheels
    a, b, c = y[H + l], y[H + L + l], y[H + 2 * L + l]
    moment[0] = b * omega[2] - c * omega[1]
    moment[1] = c * omega[0] - a * omega[2]
    moment[2] = a * omega[1] - b * omega[0]
    if torques:
        for k in range(3):
            moment[k] += p[TORQUE_B + k * L + l] + y[TORQUE + k * L + l]
    if torques == GRADIENT:
        nadir, product = np.empty(3), np.empty(3)
        for k in range(3):
            nadir[k] = y[NADIR + k * L + l]
        multiply(p, INERTIA, l, nadir, product)
        moment[0] += p[PULL + l] * (nadir[1] * product[2] - nadir[2] * product[1])
        moment[1] += p[PULL + l] * (nadir[2] * product[0] - nadir[0] * product[2])
        moment[2] += p[PULL + l] * (nadir[0] * product[1] - nadir[1] * product[0])
    for i in range(n_wheels):
        w = i * PER_WHEEL + l
        speed = y[AXIAL + i * L + l] * u[w + INVERSE_J] - along_axis(u, w, omega)
        friction = -u[w + FREE] * (u[w + COULOMB] + u[w + VISCOUS] * speed)
        for k in range(3):
            moment[k] -= friction * u[w + AXIS + k * L]
    multiply(p, INVERSE, l, moment, acceleration)
    for i in range(n_wheels):
        w = i * PER_WHEEL + l
        holding[i] = along_axis(u, w, acceleration) / u[w + INVERSE_J]


@compiled
def slip(u, w, sign):
    """Mark the wheel whose numbers begin at `w` as free; `sign` is that of its speed."""
    u[w + FREE], u[w + COULOMB] = 1.0, sign * u[w + DRY]
    u[w + SIGN] = sign if u[w + DRY] > 0.0 else 0.0


@compiled
def stick(u, w):
    """Mark the wheel whose numbers begin at `w` as held by friction or a motor."""
    u[w + FREE], u[w + COULOMB], u[w + SIGN] = 0.0, 0.0, 0.0


@compiled
def release(lanes, n_wheels, l, modes, torques, wheel):
    """Release a wheel of lane l that friction cannot hold: it begins to turn against the torque that would hold it."""
    omega, holding = np.empty(3), np.empty(WHEELS)
    write_holding(lanes, n_wheels, l, torques, omega, holding)
    w = wheel * PER_WHEEL + l
    lanes.y[AXIAL + wheel * L + l] = along_axis(lanes.u, w, omega) / lanes.u[w + INVERSE_J]
    slip(lanes.u, w, -1.0 if holding[wheel] > 0.0 else 1.0)
    set_mode(lanes, n_wheels, l, modes, torques)


@compiled
def settle(lanes, n_wheels, l, modes, torques):
    """Release the wheels at rest that friction cannot hold, one by one: each release changes the load of the others.

    The wheel with the largest load over its limit is released first.
    """
    u = lanes.u
    omega, holding = np.empty(3), np.empty(WHEELS)
    for _ in range(n_wheels):
        write_holding(lanes, n_wheels, l, torques, omega, holding)
        worst, load = -1, 1.0 + MARGIN
        for i in range(n_wheels):
            w = i * PER_WHEEL + l
            if u[w + FREE] < 0.5 and u[w + DRY] > 0.0 and abs(holding[i]) > load * u[w + DRY]:
                worst, load = i, abs(holding[i]) / u[w + DRY]
        if worst < 0:
            return
        release(lanes, n_wheels, l, modes, torques, worst)


@compiled
def pass_event(lanes, n_wheels, l, modes, torques, wheel):
    """Change the mode of lane l at the event of the wheel numbered `wheel`, and return what that wheel does (a code of `rows`).

    A free wheel has come to rest. If friction can hold it, it sticks: STOPS forward in time; RESTS backward in time, where its
    motion before is not determined. If friction cannot hold it, it turns the other way after, or before, the event: REVERSES.
    A stuck wheel has reached the limit of friction. Forward in time it begins to turn: BREAKS_AWAY. Backward in time it cannot
    have been stuck before: OVERLOADED. `modes`, `torques`: as in `set_mode`.
    """
    u = lanes.u
    w = wheel * PER_WHEEL + l
    backward = lanes.p[DT + l] < 0.0
    if u[w + FREE] < 0.5:  # a stuck wheel
        if backward:
            return OVERLOADED
        release(lanes, n_wheels, l, modes, torques, wheel)
        settle(lanes, n_wheels, l, modes, torques)
        return BREAKS_AWAY
    omega, holding = np.empty(3), np.empty(WHEELS)
    sign = u[w + SIGN]
    # the speed is zero but for rounding: h = J u.omega makes it exactly zero
    write_body_rate(lanes.y, lanes, n_wheels, l, omega)
    lanes.y[AXIAL + wheel * L + l] = along_axis(u, w, omega) / u[w + INVERSE_J]
    # the wheel is first held; then the torque that would hold it shows whether friction can
    stick(u, w)
    set_mode(lanes, n_wheels, l, modes, torques)
    if backward:
        write_holding(lanes, n_wheels, l, torques, omega, holding)
        if abs(holding[wheel]) <= u[w + DRY]:
            return RESTS
        slip(u, w, -sign)
        set_mode(lanes, n_wheels, l, modes, torques)
        return REVERSES
    # forward in time: release the wheel again if friction cannot hold it
    settle(lanes, n_wheels, l, modes, torques)
    return STOPS if u[w + FREE] < 0.5 else REVERSES
