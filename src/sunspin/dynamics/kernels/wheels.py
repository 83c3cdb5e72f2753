"""Events of wheels, and what a wheel does at them: one lane at a time, except for the test whether an event can happen at all.

A wheel that turns freely comes to rest where its speed W = h / J - u.omega is zero. A wheel that friction holds breaks away where
the torque that this takes, J u.domega/dt, reaches the limit of dry friction (paper, eq. 6). In a step both are polynomials
of its share x, whose coefficients are at hand: u.omega is among the rows of the series, and its derivative needs no second
formula. `are_watched` bounds both for all lanes; where the bound does not exclude an event, `first_event` finds the first zero and
the step is cut there. The polynomials hold for any share of a step, so nothing has to be undone.

A lane is then in a new mode: other wheels turn freely, and A^-1 belongs to another set of them (`set_mode`).
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
"""A wheel at its limit within this share is stuck: whether it breaks away follows from the polynomial of the next step."""

ROUNDING = 1e-11
"""Share of what u.omega does in a step below which a coefficient is rounding."""

NO_ZERO = 2.0
"""More than any share of a step."""

FAR = 0.02
"""Share of itself by which torques may move H before directions turn about where it is then: what this adds to the rest of omega is
a seventh of the rest that Philae's unequal moments leave."""


# ---- where the next event is ---------------------------------------------------------------------
@compiled
def are_watched(lanes, n_wheels, order, margin):
    """Write into `margin` (L) a bound of how far each lane stays from any event in its step; return whether one is not positive.

    Of a turning wheel: |W| at the begin less the sum of |coefficients| x^k. Of a stuck one: the limit less the sum for the slope
    of u.omega. Two orders in a pass.
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

    From a place where the value is a, the slope b and no second derivative exceeds s, the polynomial stays positive up to the zero
    of a + b d - s d^2 / 2: so the march cannot step over a zero. First coefficients up to `floor` are errors of a polynomial that
    has just left zero, and are divided out.
    """
    size = 0.0
    for k in range(degree + 1):
        size += abs(f[k]) * high**k
    begin = 0
    while begin < 2 and abs(f[begin]) <= max(floor, 1e-15 * size):
        begin += 1
    if f[begin] <= 0.0:
        return 0.0
    bend = 0.0
    for k in range(begin + 2, degree + 1):
        bend += (k - begin) * (k - begin - 1) * abs(f[k]) * high ** (k - begin - 2)
    x = 0.0
    for _ in range(10000):
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
    """Return the wheel of the first event of lane l in (0, high], and its place as a share of the step; -1 and `high` if none.

    At an event the polynomial of the step before was zero, and that of the next step is zero but for rounding and for what the
    series has left out. `floor` bounds both. That of a turning wheel is twice that of a stuck one: a wheel that was let go at its
    limit within errors must not be caught again by the same errors, and let go, without end.
    """
    c, p, u, f = lanes.c, lanes.p, lanes.u, lanes.polynomial
    wheel, place = -1, high
    for i in range(n_wheels):
        w, a = i * PER_WHEEL + l, ALONG + i * L + l
        limit = u[w + DRY] * u[w + INVERSE_J] * abs(p[DT + l])  # of u.domega/dt, per step
        floor = ROUNDING * limit + order * (abs(c[order, a]) + abs(c[order - 1, a]))
        for k in range(1, order + 1):
            floor += ROUNDING * k * abs(c[k, a])
        if u[w + SIGN] != 0.0:
            for k in range(order + 1):
                speed = c[k, AXIAL + i * L + l] * u[w + INVERSE_J] - c[k, a]
                f[k] = u[w + SIGN] * speed
            zero = first_zero(f, order, place, 2.0 * floor)
            if zero < NO_ZERO:
                wheel, place = i, zero
        elif u[w + FREE] < 0.5 and u[w + DRY] > 0.0:
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
    """Write into `product` (3) a symmetric matrix times a vector (3): the six rows of `p` from `first` on, in lane l."""
    x, y, z = vector[0], vector[1], vector[2]
    product[0] = p[first + l] * x + p[first + L + l] * y + p[first + 2 * L + l] * z
    product[1] = p[first + L + l] * x + p[first + 3 * L + l] * y + p[first + 4 * L + l] * z
    product[2] = p[first + 2 * L + l] * x + p[first + 4 * L + l] * y + p[first + 5 * L + l] * z


@compiled
def along_axis(u, w, vector):
    """Return u . vector for the wheel whose numbers in a lane are at `w`."""
    return u[w + AXIS] * vector[0] + u[w + AXIS + L] * vector[1] + u[w + AXIS + 2 * L] * vector[2]


@compiled
def write_seen(y, V, lanes, l, seconds, torques, out):
    """Write into `out` (3) the vector in the rows V of `y`, lane l, as the body sees it.

    The rows hold it as seen from axes that have turned for `seconds` about H at the rate SPIN |H|; under torques
    about PIVOT (Rodrigues' formula).
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
    """Bring the directions of lane l back from the axes that turn about H, or PIVOT, to those of the body; PIVOT is then H."""
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
    """After a step under torques: straighten the directions of those lanes in which H has moved far from PIVOT."""
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
    """Load lane l with what depends on which wheels turn freely: A^-1, the share of H left out of omega, A^-1 K and A^-1 u."""
    y, p, u = lanes.y, lanes.p, lanes.u
    straighten(lanes, l, torques)
    mode = 0
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
    """Write omega (3) of lane l in the state `y`: A^-1 (H - K - sum_free h u)."""
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
    """Write the body rate of lane l, and for each wheel that is held the torque J u.domega/dt that this takes, in N m."""
    y, p, u = lanes.y, lanes.p, lanes.u
    write_body_rate(y, lanes, n_wheels, l, omega)
    moment, acceleration = np.empty(3), np.empty(3)
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
    for i in range(n_wheels):  # friction of the wheels that turn
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
    """Let the wheel at `w` turn freely; `sign` is that of its speed."""
    u[w + FREE], u[w + COULOMB] = 1.0, sign * u[w + DRY]
    u[w + SIGN] = sign if u[w + DRY] > 0.0 else 0.0


@compiled
def stick(u, w):
    """Let friction, or a motor, hold the wheel at `w`."""
    u[w + FREE], u[w + COULOMB], u[w + SIGN] = 0.0, 0.0, 0.0


@compiled
def release(lanes, n_wheels, l, modes, torques, wheel):
    """Let a wheel of lane l go that friction cannot hold: it slips against the torque that was needed."""
    omega, holding = np.empty(3), np.empty(WHEELS)
    write_holding(lanes, n_wheels, l, torques, omega, holding)
    w = wheel * PER_WHEEL + l
    lanes.y[AXIAL + wheel * L + l] = along_axis(lanes.u, w, omega) / lanes.u[w + INVERSE_J]
    slip(lanes.u, w, -1.0 if holding[wheel] > 0.0 else 1.0)
    set_mode(lanes, n_wheels, l, modes, torques)


@compiled
def settle(lanes, n_wheels, l, modes, torques):
    """Let those wheels at rest go that friction cannot hold, the most overloaded first: each changes what the rest has to bear."""
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
    """Take lane l through the event of a wheel, and return what the wheel does.

    Forward in time a wheel that comes to rest sticks (STOPS) or goes on into reverse (REVERSES), and a stuck one BREAKS_AWAY.
    Backward, a wheel that passes zero where friction could not hold it had reversed. Where friction could, the wheel RESTS:
    friction forgets what was before. A stuck wheel beyond its limit is OVERLOADED: it cannot have been stuck before.
    """
    u = lanes.u
    w = wheel * PER_WHEEL + l
    backward = lanes.p[DT + l] < 0.0
    if u[w + FREE] < 0.5:
        if backward:
            return OVERLOADED
        release(lanes, n_wheels, l, modes, torques, wheel)
        settle(lanes, n_wheels, l, modes, torques)
        return BREAKS_AWAY
    omega, holding = np.empty(3), np.empty(WHEELS)
    sign = u[w + SIGN]
    write_body_rate(lanes.y, lanes, n_wheels, l, omega)
    lanes.y[AXIAL + wheel * L + l] = along_axis(u, w, omega) / u[w + INVERSE_J]
    stick(u, w)
    set_mode(lanes, n_wheels, l, modes, torques)
    if backward:
        write_holding(lanes, n_wheels, l, torques, omega, holding)
        if abs(holding[wheel]) <= u[w + DRY]:
            return RESTS
        slip(u, w, -sign)
        set_mode(lanes, n_wheels, l, modes, torques)
        return REVERSES
    settle(lanes, n_wheels, l, modes, torques)
    return STOPS if u[w + FREE] < 0.5 else REVERSES
