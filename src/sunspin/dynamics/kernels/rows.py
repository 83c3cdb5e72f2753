"""Positions of numbers in the arrays of the kernels, in which L motions advance together.

Each motion occupies a lane. A row holds one number of all lanes, one after the other, so that the processor's vectors hold the same
number of several motions: number X of lane l is at index X + l, and X is a multiple of L. A vector takes three rows, a symmetric
matrix six (xx, xy, xz, yy, yz, zz). Symbols are those of :mod:`sunspin.dynamics.gyrostat`.

A wheel is *free*, or it is held: *driven* if a motor keeps its speed, *stuck* if friction keeps it at rest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

L = 32
"""Number of lanes. 16 take 1.05 to 1.2 of the time on a processor with vectors of eight numbers."""

WHEELS = 4
"""Largest number of wheels."""

# ---- the state, and its coefficients -------------------------------------------------------------
H = 0  # total angular momentum, N m s
SUN = 3 * L  # direction to the Sun
AXIAL = 6 * L  # h of wheel i at AXIAL + i L, N m s
TORQUE = AXIAL + WHEELS * L  # the torque that is constant in space, N m
# under torques: a vector fixed in space, equal to H when directions were last straightened (`wheels.straighten`)
PIVOT = TORQUE + 3 * L
NX, NY = PIVOT + 3 * L, PIVOT + 6 * L  # the axes x and y of N, which give the attitude
NADIR = NY + 3 * L
TURN = NADIR + 3 * L  # rate at which the nadir rotates in space, rad/s
STATE_ROWS = 6 + WHEELS + 18
OMEGA = STATE_ROWS * L  # omega less SPIN H, under torques less SPIN PIVOT
RATE = OMEGA + 3 * L  # omega, under torques only
ALONG = RATE + 3 * L  # u.omega of wheel i at ALONG + i L
# no power of two: the rows would compete for few places in the processor's cache
ROWS = STATE_ROWS + 6 + WHEELS + 1

# ---- numbers of the motion in a lane -------------------------------------------------------------
DT = 0  # length of the step, s, negative backward in time
SPIN = L  # the part SPIN H, or SPIN PIVOT, of omega is treated apart (`flow`); 1/(kg m2)
HELD = 2 * L  # K, momentum of the wheels that do not turn freely (3)
INVERSE = 5 * L  # A^-1: xx, xy, xz, yy, yz, zz
TORQUE_B = 11 * L  # torque that is constant in body axes (3), N m
PULL = 14 * L  # 3 n^2 of the gravity gradient, 1/s2
INERTIA = 15 * L  # of the body with its wheels, six elements as INVERSE
INVERSE_H = 21 * L  # 1 / |H|
ALLOWED = 22 * L  # error allowed per second
REST = 23 * L  # A^-1 less SPIN (6)
HELD_RATE = 29 * L  # A^-1 K (3)
NUMBERS = 32

# ---- numbers of wheel i in a lane, from i PER_WHEEL on -------------------------------------------
AXIS = 0  # u (3)
FREE = 3 * L  # 1 if the wheel turns freely, 0 if friction or a motor holds it
COULOMB = 4 * L  # sign of the speed times DRY; 0 unless it turns freely
VISCOUS = 5 * L  # N m s
INVERSE_J = 6 * L  # 1 / J
DRY = 7 * L  # limit of dry friction and brake, N m; 0 if a motor holds the wheel
SIGN = 8 * L  # sign of the speed of a wheel that dry friction will stop, else 0
KEPT = 9 * L  # speed at which a motor holds the wheel, rad/s
LIFT = 10 * L  # A^-1 u (3) of a wheel that turns freely, else 0
PER_WHEEL = 13 * L

# ---- how a motion ends, and what a motion is run for ---------------------------------------------
FINE, CHATTERS, PAST_UNKNOWN, NOT_FINITE = 0, 1, 2, 3
# what a wheel does at an event (`wheels.pass_event`)
STOPS, BREAKS_AWAY, REVERSES, RESTS, OVERLOADED = range(5)
# torques: none; constant in body axes and in space; these and the gravity gradient
NO_TORQUE, STEADY, GRADIENT = range(3)


class Lanes(NamedTuple):
    """Working arrays of the lanes, float64.

    `c` (orders, ROWS L): coefficients of the Taylor series, scaled by the step; those beyond the order are zero. `y` (ROWS L): the
    state at the start of the step. `p` (NUMBERS L): numbers of the motion; `u` (WHEELS PER_WHEEL): numbers of its wheels. `share`
    (STATE_ROWS L): the part of its step that a lane takes, repeated for each row of the state. `since` (L): seconds since
    directions were last straightened (`wheels.straighten`). `slope` (6 L), `sums` (ROWS L), `polynomial` (orders), `spare` (ROWS
    L): scratch.
    """

    c: np.ndarray
    y: np.ndarray
    p: np.ndarray
    u: np.ndarray
    share: np.ndarray
    since: np.ndarray
    slope: np.ndarray
    sums: np.ndarray
    polynomial: np.ndarray
    spare: np.ndarray


class Motions(NamedTuple):
    """Initial states of n motions, and their bodies; arrays with a first axis of 1 or n hold one body for all or one for each.

    `omega_B` (n, 3) rad/s, `sun_B` (n, 3), `speeds` (n, n_wheel) rad/s; `inertia` (1 or n, 3, 3) kg m2; `wheels` (1 or n, n_wheel,
    3): J in kg m2, limit of dry friction with the brake in N m, viscous friction in N m s; `axes` (n_wheel, 3); `driven`
    (n_wheel): whether a motor holds the speed of the wheel. `modes` (1 or n, 2^n_wheel, 7): SPIN, and the six elements of A^-1,
    for each set of free wheels, bit i of whose number is wheel i. `steady` (1 or n, 2, 3) N m: torques that are constant in body
    axes and in space, both in body axes at the start; `nadir` (1 or n, 2, 3): direction, and its rate of rotation in rad/s, in
    body axes at the start; `pull`: 3 n^2 of the gravity gradient in 1/s2.
    """

    omega_B: np.ndarray
    sun_B: np.ndarray
    speeds: np.ndarray
    inertia: np.ndarray
    wheels: np.ndarray
    axes: np.ndarray
    driven: np.ndarray
    modes: np.ndarray
    steady: np.ndarray
    nadir: np.ndarray
    pull: float


class Task(NamedTuple):
    """What is to be computed of the motions.

    `ends` (n_out) s: times of output, increasing or decreasing from 0; `order` of the series; `allowed`: error per second of H, as
    a part of |H|, and of directions; `torques`: NO_TORQUE, STEADY or GRADIENT; `attitude`: whether it is computed; `most_events`
    and `most_steps` of a motion.
    """

    ends: np.ndarray
    order: int
    allowed: float
    torques: int
    attitude: bool
    most_events: int
    most_steps: int


class Answer(NamedTuple):
    """Results for n motions.

    `states` (n, n_out, size): H, h, direction to the Sun, omega, speeds of the wheels and, if computed, the axes x and y of N, all
    in body axes; `last` (n, size): the same where the motion ended; `outcome` (n); `events` (n, room, 3): time in s, wheel, what
    it does; `n_events` (n); `steps` (n): number of steps; `hist` (n, bins) in s, or (n, 0).
    """

    states: np.ndarray
    last: np.ndarray
    outcome: np.ndarray
    events: np.ndarray
    n_events: np.ndarray
    steps: np.ndarray
    hist: np.ndarray
