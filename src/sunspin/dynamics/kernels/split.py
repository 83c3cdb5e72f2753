"""The split kernel: histograms of r_z for many motions by a product of rotations, in single precision, for all lanes at once.

In the principal axes (p, q, m) of A^-1 the body rate is omega_i = l_i H_i - w_i. l are the inverse moments, and w = l (K + sum_free
h u) is the part of the wheels: K is the momentum of the driven wheels, h that of a free one along its axis u. H and the direction r
to the Sun both follow dv/dt = v x omega. m is mostly the axis whose moment differs most from the others.

The part l_q H of omega, the common rotation, rotates r about H and does not change H. It commutes with the rest, which rotates H
and r alike, so it is applied exactly, once per step (`write_node`). The rest has three parts, each a rotation about one axis at a
rate that it does not change (:mod:`sunspin.dynamics.principal`):

    main   (l_m - l_q) H_m - w_m  about m
    P      (l_p - l_q) H_p - w_p  about p
    Q                      - w_q  about q

`go_forward` applies main, half of Q, P and half of Q, `go_backward` the reverse. Three of each, with the fractions of McLachlan's
method of order (8, 4) for nearly integrable systems (BIT 35, 1995, 258), make a symmetric step. Rotations keep |H|, |r| and H.r;
the error comes from commutators, which are small if l_p - l_q, w_p and w_q are small compared with main. That of P and Q is of
second order only, but zero unless a wheel has a part along q (`principal.split_steps`). One step covers some two radians of main,
and two ways of the histogram, the arcs of r between its nodes.

Wheels run down by the exact solution of their friction for omega = 0 (`begin_step`); the friction that omega causes is added from
the middle of the step. A step in which a wheel comes to rest is undone and shortened, until the wheel rests at its end. Motions
that the Taylor kernel must compute again are reported in `again`: a wheel that friction holds comes near its limit, or the
motion comes near an unstable spin, where single precision is not enough.

Names and rules of speed are those of :mod:`sunspin.dynamics.kernels.flow`, but w is the array of numbers of the motions, and o is
where the numbers of a wheel begin. p, q, m and x, y, z are the components of H and r in principal axes.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from sunspin.dynamics.kernels import histogram, rows
from sunspin.dynamics.kernels.histogram import (
    NODE,
    PER_NODE,
    SECONDS,
    add_way,
    begin_way,
    take_out,
)
from sunspin.dynamics.kernels.rows import WHEELS, L, Motions
from sunspin.dynamics.processor import cached, compiled, digest

F = np.float32

# ---- rows of `w`: numbers of the motion in a lane; names as in `rows`, other places --------------------
H, SUN = 0, 3 * L  # momentum and direction to the Sun, principal axes p, q, m
STATE = 6 * L  # their number
OLD = 6 * L  # the same at the start of the step (6)
DT = 12 * L
DP, DM = 13 * L, 14 * L  # l_p - l_q and l_m - l_q
INVERSE = 15 * L  # l (3)
# the part w of the wheels at the start of the step, and its change in the step (3 each)
W0, W1 = 18 * L, 21 * L
DRIVEN = 24 * L  # K (3), momentum of the driven wheels
AXES = 27 * L  # rows p, q, m of the rotation from B (9)
# common rotation: cosine, sine / |H|, (1 - cosine) H.r / |H|^2, in the middle and at the end of the step
COMMON = 36 * L
INVERSE_SQUARE = 42 * L  # 1 / |H|^2
SLOWEST, FASTEST = 43 * L, 44 * L  # smallest and largest square of dH/dt in body axes so far
OVERLOAD = 45 * L  # largest torque that a stuck wheel needed, over its limit
NUMBERS = 46

# ---- rows of `u`: numbers of wheel i, from i PER_WHEEL on ---------------------------------------------
AXIS = 0  # u (3), principal axes
# h, and by how much it exceeds the exact sum of its changes (Kahan's summation)
AXIAL, LOW = 3 * L, 4 * L
FREE, COULOMB, VISCOUS, J = 5 * L, 6 * L, 7 * L, 8 * L  # as in `rows`; J in kg m^2
WEAR = 9 * L  # seconds; times the friction torque at the start it is the change of h in the step
SIGN = 10 * L  # of the speed of a wheel that dry friction will stop, else 0
INVERSE_DRY = 11 * L  # 1 / limit of a wheel that is stuck or may become so, else 0
SPEED = 12 * L  # relative to the body, rad/s; only where SIGN is not 0
OLD_SPEED, OLD_AXIAL, OLD_LOW = 13 * L, 14 * L, 15 * L
PER_WHEEL = 16 * L

REST_SPEED = 1e-4
"""rad/s at which a wheel counts as at rest: 1e-7 of Philae's 865 rad/s, the resolution of single precision."""

WAYS = 2
"""Ways of the histogram in a step: from its begin to its middle, and on to its end."""

MOST_SHORTENED = 0.02
"""Smallest share to which a step is cut, so that a lane advances: a choice. A step in which a wheel passes rest is cut again."""

UNEVEN = 3e-5
"""If the smallest square of dH/dt in body axes is below this share of the largest, a motion came near an unstable spin.

These are 2 % of the paper's grid. Without the limit the largest error of their EMD is 1.2e-2 instead of 1.2e-3 (3,000 motions).
"""

LAST_SHARE = 1e-3
"""Share of a step within which the rest of a run is due to rounding: the last step is then a whole one, or the run has ended."""

NEAR_LIMIT = 0.9
"""Share of its limit below which a stuck wheel is taken to stay stuck; its load is computed once per step. A choice."""

MAIN = (0.07534696026989288842, 0.51791685468825678230, -0.09326381495814967072)
SIDE = (0.19022593937367661925, 0.84652407044352625706, -1.07350001963440575260 / 2)
"""McLachlan's fractions of the step; the last of SIDE is applied twice in the middle, forward and backward."""


class SplitTask(NamedTuple):
    """What is to be computed: `queue` (n), the motions in order of their numbers of steps, `steps` (n); `duration` in s; `frames`
    (2^n_wheel, 12) as of :func:`sunspin.dynamics.principal.frames`."""

    queue: np.ndarray
    steps: np.ndarray
    duration: float
    frames: np.ndarray


class SplitAnswer(NamedTuple):
    """`hist` (n, bins) s; `again` (n): whether the Taylor kernel must compute the motion."""

    hist: np.ndarray
    again: np.ndarray


class Fractions(NamedTuple):
    """Fractions of a step for which its first half applies the three parts, (3) each; the second half has the reverse order.

    `main`: of main; `side`: of P and Q. `main_time`, `side_time`: times, as shares of the step, at which w is taken for them: the
    middle of main, and the end of main so far.
    """

    main: np.ndarray
    main_time: np.ndarray
    side: np.ndarray
    side_time: np.ndarray


class SplitLanes(NamedTuple):
    """Working arrays: `w` (NUMBERS L) and `u` (WHEELS PER_WHEEL), float32; `fractions` of a step; `left` (L): seconds to the end of
    the run; `step` (L): full length of the step, s."""

    w: np.ndarray
    u: np.ndarray
    fractions: Fractions
    left: np.ndarray
    step: np.ndarray


def fractions_of_step() -> Fractions:
    """Return McLachlan's fractions for the first half of a step."""
    main, side = np.array(MAIN), np.array(SIDE)
    end = np.cumsum(main)
    return Fractions(*(x.astype(F) for x in (main, end - main / 2, side, end)))


# ---- flows -----------------------------------------------------------------------------------------
@compiled
def sine_cosine(x):
    """Return sine and cosine as polynomials, which compile to vector operations: to 6e-8 up to 0.62 rad.

    No angle is larger: a step rotates by at most 1.2 rad of main and 0.6 rad of P or Q (`principal.split_steps`), and the largest
    fractions of these are 0.52 and 0.85. At 1.2 rad the error would be 1.4e-5.
    """
    q = x * x
    sine = x + x * q * (F(-1 / 6) + q * (F(1 / 120) + q * F(-1 / 5040)))
    cosine = F(1) + q * (F(-0.5) + q * (F(1 / 24) + q * (F(-1 / 720) + q * F(1 / 40320))))
    return sine, cosine


@compiled
def rotate(a, b, sine, cosine):
    """Return the components a, b of a fixed vector after the axes have rotated from the axis of a towards that of b."""
    return cosine * a + sine * b, cosine * b - sine * a


@compiled
def turn_main(w, l, fraction, time, v):
    """Return the state `v` (H and r, 6) of lane l after main for a fraction of the step, with the w of the wheels at `time`."""
    p, q, m, x, y, z = v
    wheels = w[W0 + 2 * L + l] + time * w[W1 + 2 * L + l]
    sine, cosine = sine_cosine(fraction * w[DT + l] * (w[DM + l] * m - wheels))
    p, q = rotate(p, q, sine, cosine)
    x, y = rotate(x, y, sine, cosine)
    return p, q, m, x, y, z


@compiled
def turn_sides(w, l, fraction, time, v):
    """Return the state `v` of lane l after half of Q, P and half of Q for a fraction of the step; `time` as in `turn_main`.

    With Q on both sides of P the order is its own reverse, and the error is of the third power of the fraction. P Q alone has an
    error of the second power. With the reverse order in the other half of the step it is still twice as large (20 bodies with
    oblique wheels).
    """
    p, q, m, x, y, z = v
    dt = fraction * w[DT + l]
    half_sine, half_cosine = sine_cosine(F(-0.5) * dt * (w[W0 + L + l] + time * w[W1 + L + l]))
    m, p = rotate(m, p, half_sine, half_cosine)
    z, x = rotate(z, x, half_sine, half_cosine)
    sine, cosine = sine_cosine(dt * (w[DP + l] * p - (w[W0 + l] + time * w[W1 + l])))
    q, m = rotate(q, m, sine, cosine)
    y, z = rotate(y, z, sine, cosine)
    m, p = rotate(m, p, half_sine, half_cosine)
    z, x = rotate(z, x, half_sine, half_cosine)
    return p, q, m, x, y, z


@compiled
def state_of(w, l):
    """Return H and r of lane l (6), principal axes."""
    p, q, m = w[H + l], w[H + L + l], w[H + 2 * L + l]
    return p, q, m, w[SUN + l], w[SUN + L + l], w[SUN + 2 * L + l]


@compiled
def set_state(w, l, v):
    """Set H and r of lane l (6), principal axes."""
    w[H + l], w[H + L + l], w[H + 2 * L + l] = v[0], v[1], v[2]
    w[SUN + l], w[SUN + L + l], w[SUN + 2 * L + l] = v[3], v[4], v[5]


@compiled
def go_forward(w, part, k):
    """Apply main, then Q P Q, for fraction number k of the step, in all lanes."""
    main, side = part.main[k], part.side[k]
    main_time, side_time = part.main_time[k], part.side_time[k]
    for l in range(L):
        v = turn_main(w, l, main, main_time, state_of(w, l))
        set_state(w, l, turn_sides(w, l, side, side_time, v))


@compiled
def go_backward(w, part, k):
    """Apply Q P Q, then main, for fraction number k: the reverse of `go_forward`, in the second half of the step."""
    main, side = part.main[k], part.side[k]
    main_time, side_time = F(1) - part.main_time[k], F(1) - part.side_time[k]
    for l in range(L):
        v = turn_sides(w, l, side, side_time, state_of(w, l))
        set_state(w, l, turn_main(w, l, main, main_time, v))


# ---- wheels in a step -------------------------------------------------------------------------------
@compiled
def begin_step(w, u, n_wheels):
    """Save the state, and change h and w of all wheels by the friction of the whole step, as if omega were zero."""
    for j in range(STATE):
        w[OLD + j] = w[j]
    for j in range(3 * L):
        w[W0 + j] = w[INVERSE + j] * w[DRIVEN + j]
        w[W1 + j] = F(0)
    for i in range(n_wheels):
        o = i * PER_WHEEL
        for l in range(L):
            h, free = u[o + AXIAL + l], u[o + FREE + l]
            friction = u[o + COULOMB + l] + u[o + VISCOUS + l] / u[o + J + l] * h
            change = -free * u[o + WEAR + l] * friction
            p = free * w[INVERSE + l] * u[o + AXIS + l]
            q = free * w[INVERSE + L + l] * u[o + AXIS + L + l]
            m = free * w[INVERSE + 2 * L + l] * u[o + AXIS + 2 * L + l]
            w[W0 + l] += p * h
            w[W0 + L + l] += q * h
            w[W0 + 2 * L + l] += m * h
            w[W1 + l] += p * change
            w[W1 + L + l] += q * change
            w[W1 + 2 * L + l] += m * change
            u[o + OLD_AXIAL + l], u[o + OLD_LOW + l] = h, u[o + LOW + l]
            u[o + OLD_SPEED + l] = u[o + SPEED + l]
            # Kahan's summation: thousands of small changes of a large h
            part = change - u[o + LOW + l]
            total = h + part
            u[o + LOW + l] = (total - h) - part
            u[o + AXIAL + l] = total


@compiled
def write_node(lanes, at, n_wheels, k, is_end):
    """Write node k = 1 (middle of the step) or 2 (its end, `is_end`) into `at` (`histogram.Nodes`), in body axes.

    The common rotation of r about H since the start of the step is added first (Rodrigues' formula); at the end the state gets it
    too. In the middle the size of dH/dt is stored, the friction that omega causes is added, and the load of stuck wheels is
    computed. At the end the wheels' speeds are, and H and r are scaled to their lengths, which otherwise change by 1e-3 in a
    thousand steps.
    """
    w, u = lanes.w, lanes.u
    turn, n, time = COMMON + 3 * L * (k - 1), NODE + PER_NODE * k, F(0.5) * F(k)
    for l in range(L):
        p, q, m = w[H + l], w[H + L + l], w[H + 2 * L + l]
        x, y, z = w[SUN + l], w[SUN + L + l], w[SUN + 2 * L + l]
        cosine, sine, along = w[turn + l], w[turn + L + l], w[turn + 2 * L + l]
        x, y, z = (
            cosine * x + sine * (y * m - z * q) + along * p,
            cosine * y + sine * (z * p - x * m) + along * q,
            cosine * z + sine * (x * q - y * p) + along * m,
        )
        # omega = l H - w
        a = w[INVERSE + l] * p - w[W0 + l] - time * w[W1 + l]
        b = w[INVERSE + L + l] * q - w[W0 + L + l] - time * w[W1 + L + l]
        d = w[INVERSE + 2 * L + l] * m - w[W0 + 2 * L + l] - time * w[W1 + 2 * L + l]
        if is_end:
            # a step of Newton's method for 1 / sqrt
            scale = F(1.5) - F(0.5) * (p * p + q * q + m * m) * w[INVERSE_SQUARE + l]
            w[H + l], w[H + L + l], w[H + 2 * L + l] = p * scale, q * scale, m * scale
            scale = F(1.5) - F(0.5) * (x * x + y * y + z * z)
            x, y, z = x * scale, y * scale, z * scale
            w[SUN + l], w[SUN + L + l], w[SUN + 2 * L + l] = x, y, z
        else:
            # dH/dt = H x omega
            e, f, g = q * d - m * b, m * a - p * d, p * b - q * a
            square = e * e + f * f + g * g
            w[SLOWEST + l] = min(w[SLOWEST + l], square)
            w[FASTEST + l] = max(w[FASTEST + l], square)
        # dr/dt = r x omega; then both from principal to body axes
        e, f, g = y * d - z * b, z * a - x * d, x * b - y * a
        for j in range(3):
            to_p, to_q = w[AXES + j * L + l], w[AXES + (3 + j) * L + l]
            to_m = w[AXES + (6 + j) * L + l]
            at[n + j * L + l] = to_p * x + to_q * y + to_m * z
            at[n + (3 + j) * L + l] = to_p * e + to_q * f + to_m * g
        at[n + 6 * L + l] = a * a + b * b + d * d
    for i in range(n_wheels):
        o = i * PER_WHEEL
        for l in range(L):
            p, q, m = w[H + l], w[H + L + l], w[H + 2 * L + l]
            a = w[INVERSE + l] * p - w[W0 + l] - time * w[W1 + l]
            b = w[INVERSE + L + l] * q - w[W0 + L + l] - time * w[W1 + L + l]
            d = w[INVERSE + 2 * L + l] * m - w[W0 + 2 * L + l] - time * w[W1 + 2 * L + l]
            x, y, z = u[o + AXIS + l], u[o + AXIS + L + l], u[o + AXIS + 2 * L + l]
            along = a * x + b * y + d * z
            if is_end:
                u[o + SPEED + l] = u[o + AXIAL + l] / u[o + J + l] - along
            else:
                # friction that omega causes, from the middle of the step; too small for the sum's rounding to matter
                u[o + AXIAL + l] += u[o + FREE + l] * u[o + VISCOUS + l] * w[DT + l] * along
                # torque J u.domega/dt that holds a stuck wheel, over its limit; the friction of other wheels is left out as small
                x, y, z = x * w[INVERSE + l], y * w[INVERSE + L + l], z * w[INVERSE + 2 * L + l]
                torque = x * (q * d - m * b) + y * (m * a - p * d) + z * (p * b - q * a)
                load = abs(torque) * u[o + J + l] * u[o + INVERSE_DRY + l]
                load = F(0) if u[o + FREE + l] > F(0.5) else load
                w[OVERLOAD + l] = max(w[OVERLOAD + l], load)


@compiled
def take_step(lanes, at, n_wheels):
    """Advance all lanes by a step, and write its two nodes into `at`."""
    w = lanes.w
    begin_step(w, lanes.u, n_wheels)
    for k in range(3):
        go_forward(w, lanes.fractions, k)
    write_node(lanes, at, n_wheels, 1, False)
    for k in range(2, -1, -1):
        go_backward(w, lanes.fractions, k)
    write_node(lanes, at, n_wheels, 2, True)


# ---- one lane ---------------------------------------------------------------------------------------
@compiled
def set_step(lanes, n_wheels, l, dt):
    """Set the step of lane l to dt seconds, with the common rotation about H (COMMON) and the WEAR of its wheels."""
    w, u = lanes.w, lanes.u
    w[DT + l] = dt
    p, q, m = float(w[H + l]), float(w[H + L + l]), float(w[H + 2 * L + l])
    square = p * p + q * q + m * m
    size = math.sqrt(square)
    along = p * w[SUN + l] + q * w[SUN + L + l] + m * w[SUN + 2 * L + l]
    for k in range(2):
        angle = w[INVERSE + L + l] * size * dt * (k + 1) / 2
        turn = COMMON + 3 * k * L + l
        w[turn] = math.cos(angle)
        w[turn + L] = math.sin(angle) / size if size > 0.0 else 0.0
        w[turn + 2 * L] = (1.0 - math.cos(angle)) * along / square if size > 0.0 else 0.0
    for i in range(n_wheels):
        o = i * PER_WHEEL + l
        x = u[o + VISCOUS] / u[o + J] * dt
        # (1 - exp(-x)) / x, by its series where x is small or, without viscous friction, zero
        u[o + WEAR] = dt * (-math.expm1(-x) / x if abs(x) > 1e-6 else 1.0 - 0.5 * x)


@compiled
def set_mode(lanes, motions, frames, l, row, body):
    """Write the numbers of lane l that depend on which wheels turn freely, and its state from H and r in body axes, `body` (6).

    frames : (2^n_wheel, 12)
        As of :func:`sunspin.dynamics.principal.frames`.
    """
    w, u = lanes.w, lanes.u
    n_wheels = len(motions.axes)
    mode = 0  # bit i: wheel i turns freely
    for i in range(n_wheels):
        if u[i * PER_WHEEL + FREE + l] > F(0.5):
            mode |= 1 << i
    for k in range(3):
        a = frames[mode, 3 + 3 * k : 6 + 3 * k]
        w[INVERSE + k * L + l] = frames[mode, k]
        w[H + k * L + l] = a[0] * body[0] + a[1] * body[1] + a[2] * body[2]
        w[SUN + k * L + l] = a[0] * body[3] + a[1] * body[4] + a[2] * body[5]
        driven = 0.0
        for i in range(n_wheels):
            axis = motions.axes[i]
            along = a[0] * axis[0] + a[1] * axis[1] + a[2] * axis[2]
            u[i * PER_WHEEL + AXIS + k * L + l] = along
            if motions.driven[i]:
                driven += along * motions.wheels[0, i, 0] * motions.speeds[row, i]
        w[DRIVEN + k * L + l] = driven
        for j in range(3):
            w[AXES + (3 * k + j) * L + l] = a[j]
    w[DP + l] = frames[mode, 0] - frames[mode, 1]
    w[DM + l] = frames[mode, 2] - frames[mode, 1]
    square = body[0] ** 2 + body[1] ** 2 + body[2] ** 2
    w[INVERSE_SQUARE + l] = 1.0 / square if square > 0.0 else 0.0


@compiled
def load(lanes, motions, frames, l, row):
    """Load motion `row` in its initial state into lane l, with a step of no length; `frames` as of `set_mode`.

    The caller (`run_block`) writes node 0 at the end of that step, and then sets the true step.
    """
    w, u = lanes.w, lanes.u
    n_wheels, inertia, body = len(motions.axes), motions.inertia[0], np.empty(6)
    omega, speeds = motions.omega_B[row], motions.speeds[row]
    # `body` in body axes: H = Theta omega + sum J W u, with the speed W of each wheel about its axis u, then r
    for k in range(3):
        body[k] = inertia[k, 0] * omega[0] + inertia[k, 1] * omega[1] + inertia[k, 2] * omega[2]
        body[3 + k] = motions.sun_B[row, k]
    for i in range(n_wheels):
        o, axis = i * PER_WHEEL + l, motions.axes[i]
        axial_inertia, dry = motions.wheels[0, i, 0], motions.wheels[0, i, 1]
        driven = motions.driven[i]
        for k in range(3):
            body[k] += axial_inertia * speeds[i] * axis[k]
        along = axis[0] * omega[0] + axis[1] * omega[1] + axis[2] * omega[2]
        sign = 1.0 if speeds[i] > 0.0 else -1.0 if speeds[i] < 0.0 else 0.0
        # A wheel is driven by its motor, stuck (at rest, with dry friction), or free: only then friction changes its momentum.
        free = not driven and not (sign == 0.0 and dry > 0.0)
        u[o + AXIAL] = axial_inertia * (speeds[i] + along)
        u[o + LOW], u[o + SPEED] = 0.0, speeds[i]
        u[o + J], u[o + VISCOUS] = axial_inertia, motions.wheels[0, i, 2]
        u[o + FREE] = 1.0 if free else 0.0
        u[o + COULOMB] = sign * dry if free else 0.0
        u[o + SIGN] = sign if free and dry > 0.0 else 0.0
        u[o + INVERSE_DRY] = 1.0 / dry if dry > 0.0 and not driven else 0.0
    # SLOWEST is a minimum over the run, the others are maxima
    w[SLOWEST + l], w[FASTEST + l], w[OVERLOAD + l] = 1e30, 0.0, 0.0
    set_mode(lanes, motions, frames, l, row, body)  # reads FREE of the wheels
    set_step(lanes, n_wheels, l, 0.0)


@compiled
def end_step(lanes, motions, frames, at, l, row):
    """Test in lane l whether a wheel that dry friction will stop has come to rest in the step; return whether the step is valid.

    If a wheel is past rest, the step is not valid: it is undone, and a shorter one is set. A wheel at rest sticks from now on.
    `at`: nodes of the step (`histogram.Nodes`); `row`: the motion in the lane; `frames` as of `set_mode`.
    """
    w, u = lanes.w, lanes.u
    n_wheels = len(motions.axes)
    share, sticks = 1.0, False
    for i in range(n_wheels):
        o = i * PER_WHEEL + l
        after, before = u[o + SIGN] * u[o + SPEED], u[o + SIGN] * u[o + OLD_SPEED]
        # The wheel came to rest where the speed, as linear between both, is zero. In a lane whose run has ended the step has no
        # length, and both speeds are equal.
        if after < -REST_SPEED and after != before:
            share = min(share, max(before / (before - after), MOST_SHORTENED))
    if share < 1.0:
        # restore the state and the wheels; nodes 1 and 2 of the step become copies of node 0, with no time between them
        for j in range(6):
            w[j * L + l] = w[OLD + j * L + l]
        for i in range(n_wheels):
            o = i * PER_WHEEL + l
            u[o + AXIAL], u[o + LOW] = u[o + OLD_AXIAL], u[o + OLD_LOW]
            u[o + SPEED] = u[o + OLD_SPEED]
        for j in range(7):
            at[NODE + PER_NODE + j * L + l] = at[NODE + j * L + l]
            at[NODE + 2 * PER_NODE + j * L + l] = at[NODE + j * L + l]
        at[SECONDS + l] = 0.0
        set_step(lanes, n_wheels, l, w[DT + l] * share)
        return False
    for i in range(n_wheels):
        o = i * PER_WHEEL + l
        if u[o + SIGN] != F(0) and u[o + SIGN] * u[o + SPEED] <= REST_SPEED:
            u[o + FREE], u[o + SIGN], u[o + COULOMB], sticks = 0.0, 0.0, 0.0, True
    if sticks:
        body = np.zeros(6)  # H and r in body axes
        for j in range(3):
            for k in range(3):
                axis = w[AXES + (3 * k + j) * L + l]
                body[j] += axis * w[H + k * L + l]
                body[3 + j] += axis * w[SUN + k * L + l]
        set_mode(lanes, motions, frames, l, row, body)
    # Only after an event in this lane. `end_step` runs in all lanes if a wheel in any of them is at rest, and `set_step` computes
    # the common rotation anew from the rounded state. So without this condition a lane's result would depend on its neighbours.
    if sticks or w[DT + l] != F(lanes.step[l]):
        set_step(lanes, n_wheels, l, lanes.step[l])
    return True


# ---- the run ----------------------------------------------------------------------------------------
@compiled
def any_wheel_came_to_rest(u, n_wheels):
    """Return whether in any lane the step took a wheel that dry friction will stop to rest (`REST_SPEED`) or past it."""
    at_rest = False
    for i in range(n_wheels):
        o = i * PER_WHEEL
        for l in range(L):
            sign = u[o + SIGN + l]
            at_rest |= sign * u[o + SPEED + l] < F(REST_SPEED) and sign != F(0)
    return at_rest


@compiled
def run_block(first, task, lanes, motions, nodes, answer):
    """Compute L motions of the queue, from number `first` on: write their histograms into `answer.hist`, and `answer.again`.

    Each lane takes steps of its own length until its run has ended, and then steps of no length until all lanes have ended. Lanes
    beyond the end of the queue compute its last motion once more; their results are dropped.
    """
    w, u, at, queue, frames = lanes.w, lanes.u, nodes.at, task.queue, task.frames
    n_wheels, last = len(motions.axes), len(queue) - 1
    for l in range(L):
        row = queue[min(first + l, last)]  # lanes beyond the queue compute the last motion too
        load(lanes, motions, frames, l, row)
        lanes.step[l], lanes.left[l] = task.duration / task.steps[row], task.duration
    # Node 0, where the first way begins, is the end of a step of no length, which `load` has set: `begin_step` writes the w that
    # the node needs, `write_node` writes it as node 2.
    begin_step(w, u, n_wheels)
    write_node(lanes, at, n_wheels, 2, True)
    for j in range(PER_NODE):
        at[NODE + j] = at[NODE + 2 * PER_NODE + j]
    begin_way(nodes)
    for l in range(L):
        set_step(lanes, n_wheels, l, lanes.step[l])
    alive = True
    while alive:
        take_step(lanes, at, n_wheels)
        for l in range(L):
            at[SECONDS + l] = F(1 / WAYS) * w[DT + l]  # of each way
        # the time left; a step in which a wheel has passed rest is undone and takes no time
        if any_wheel_came_to_rest(u, n_wheels):
            for l in range(L):
                dt = w[DT + l]  # `end_step` may set another step
                if end_step(lanes, motions, frames, at, l, queue[min(first + l, last)]):
                    lanes.left[l] -= dt
        else:
            for l in range(L):
                lanes.left[l] -= w[DT + l]
        # no loop: its indices would not be constants (rule 1 of `flow`), six times slower
        add_way(nodes, 0)
        add_way(nodes, 1)
        # the last node of this step is the first of the next
        for j in range(PER_NODE):
            at[NODE + j] = at[NODE + 2 * PER_NODE + j]
        alive = False
        for l in range(L):
            # A step that would pass the end of the run is shortened to what is left. If this is only rounding, the run has
            # ended, and the step gets no length.
            if lanes.left[l] < w[DT + l] * (1.0 - LAST_SHARE) and w[DT + l] != 0.0:
                if lanes.left[l] < LAST_SHARE * lanes.step[l]:
                    lanes.left[l] = 0.0
                lanes.step[l] = lanes.left[l]
                set_step(lanes, n_wheels, l, lanes.left[l])
            alive |= w[DT + l] > 0.0
    for l in range(L):
        if first + l <= last:
            row = queue[first + l]
            take_out(nodes, l, answer.hist[row])
            # even: never near an unstable spin (UNEVEN), or dH/dt is always zero
            even = w[SLOWEST + l] > F(UNEVEN) * w[FASTEST + l] or w[FASTEST + l] == F(0)
            # "not <", so that a NaN is computed again too
            answer.again[row] = not even or not w[OVERLOAD + l] < F(NEAR_LIMIT)
    nodes.hist[:] = F(0)  # of lanes beyond the queue, which are not taken out


def new_lanes() -> SplitLanes:
    """Return the working arrays of L lanes without motions."""
    return SplitLanes(
        np.zeros(NUMBERS * L, F),
        np.zeros(WHEELS * PER_WHEEL, F),
        fractions_of_step(),
        np.zeros(L),
        np.zeros(L),
    )


def _entry(sources: int) -> Any:
    """Return the entry point, whose machine code is stored on disk and compiled again when a source file has changed.

    `sources`: the digest of the files that it is compiled from (:func:`sunspin.dynamics.processor.digest`).
    """

    @cached("compiling the integrator of scans, once (some 10 s)")
    def run(task, lanes, motions, nodes, answer):
        """Compute the motions of a task, L at a time (:func:`run_block`)."""
        _ = sources  # so the closure holds the digest, which becomes a key of numba's cache
        for first in range(0, len(task.queue), L):
            run_block(first, task, lanes, motions, nodes, answer)

    return run


_run = _entry(digest(*(str(module.__file__) for module in (rows, histogram)), __file__))


def run(
    motions: Motions, steps: np.ndarray, duration_s: float, frames: np.ndarray, nodes: Any
) -> SplitAnswer:
    """Return the histograms of r_z for n motions of one body, and which of them the Taylor kernel must compute again.

    The motions go forward in time, without torques.

    motions : Motions
        Initial states (n), and one body for all.
    steps : (n)
        Number of steps of each motion (:func:`sunspin.dynamics.principal.split_steps`).
    duration_s : float
        Length of the run, s, above zero.
    frames : (2^n_wheel, 12)
        Principal axes for each set of free wheels (:func:`sunspin.dynamics.principal.frames`).
    nodes : histogram.Nodes
        Working arrays of the histograms of L motions, and the mask.
    """
    n, bins = len(motions.omega_B), len(nodes.hist) // L
    answer = SplitAnswer(np.zeros((n, bins), F), np.zeros(n, dtype=np.bool_))
    if n:
        # L motions run side by side until the last of them ends, so those with similar numbers of steps run together
        queue = np.argsort(steps, kind="stable")
        task = SplitTask(queue, steps, float(duration_s), frames)
        _run(task, new_lanes(), motions, nodes, answer)
    return answer
