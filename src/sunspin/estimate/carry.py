"""Motions propagated from one instant to another by the equations of motion, with derivatives by their start and by the inertia.

The integration is that of :mod:`sunspin.dynamics.step`. Derivatives are differences of runs with the same steps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sunspin.base.errors import InputError
from sunspin.dynamics.step import carry_bodies
from sunspin.solve.rotations import cross_matrix, rotate_attitude, rotation_between

STEP_RAD, LEAST_STEPS, MOST_STEPS = 0.4, 2, 400
"""Angle by which the body turns in one Runge-Kutta step, at most: the error over a revolution is 1e-4 rad, below that of any panel.
Then the least and largest number of steps in an interval: 400 are 25 revolutions, more than sparse directions can show."""

MOST_NUTATION_RAD = 800.0
"""Angle by which wheels may turn the vector of the rate between two samples: 2 rad in each step, which the integration follows."""

DIFFERENCE = 1e-5
"""For derivatives by the rate at the start: change of the rate times the interval, rad."""

INERTIA_DIFFERENCE = 0.02
"""For derivatives by an error of the inertia: change of the error, in its sigmas."""

TURN, RATE = slice(0, 3), slice(3, 6)
"""Where a small rotation (rad, body axes) and the rate (rad/s) stand among the six numbers of a change of state."""


class Step(NamedTuple):
    """K motions at the ends of n intervals.

    `turned` (K, n, 3, 3): the rotation matrix that takes the attitude at the start to that at the end; `omega` (K, n, 3): rates at
    the end, rad/s. If wanted, derivatives of turn and rate at the end: `by_start` (K, n, 6, 6) by those at the start, `by_inertia`
    (K, n, 6, e) by one sigma of each error of the inertia.
    """

    turned: np.ndarray
    omega: np.ndarray
    by_start: np.ndarray | None = None
    by_inertia: np.ndarray | None = None


def nutation(inertia: np.ndarray, momentum: np.ndarray) -> np.ndarray:
    """Return the angular frequency (..., n), rad/s, at which wheels turn the vector of the rate in the body: that of the nutation.

    `inertia` (..., 3, 3) in mean moments; `momentum` (n, 3) of the wheels in mean moments times rad/s. The wheels add I^-1 (w x h)
    to dw/dt; the eigenvalues of I^-1 [h x] are 0 and +-i sqrt(h.I h / det I).
    """
    square = np.einsum("...ni,...ij,...nj->...n", momentum, inertia, momentum)
    return np.sqrt(square / np.linalg.det(inertia)[..., None])


def require_followed(inertia: np.ndarray, momentum: np.ndarray, longest_s: float) -> None:
    """Raise InputError if wheels of the `momentum` (n, 3) turn the rate too far in the longest interval (s) to be propagated."""
    turned = float(np.max(nutation(inertia, np.nan_to_num(momentum)), initial=0.0)) * longest_s
    if not turned <= MOST_NUTATION_RAD:
        raise InputError(
            f"the wheels turn a rate of the body round by {turned:.3g} rad between two samples, more than can be followed",
            do="check the wheels' speeds and inertia and their units, or use samples closer together",
        )


def angle_turned(
    inertia: np.ndarray,
    omega: np.ndarray,
    dt: npt.ArrayLike,
    momenta: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """Return the angle (..., n), rad, by which body and rate turn at most in intervals `dt` (n), s, with rates `omega` (..., n, 3).

    `inertia` (..., 3, 3) in mean moments; `momenta`: two (n, 3), of the wheels at start and end of each interval.
    """
    frequency = np.maximum(*(nutation(inertia, momentum) for momentum in momenta))
    return (np.linalg.norm(omega, axis=-1) + frequency) * np.abs(dt)


def step(
    inertia: np.ndarray,
    omega: np.ndarray,
    dt: np.ndarray,
    momenta: tuple[np.ndarray, np.ndarray],
    derivatives: bool = False,
    errors: np.ndarray | None = None,
) -> Step:
    """Propagate K motions over n intervals each by the equations of motion; return them at the ends, with derivatives if wanted.

    Vectors are in body axes; inertia and momenta are divided by the mean moment of inertia. `inertia` (3, 3) of all motions or
    (K, 3, 3) of each; `omega` (K, n, 3): rates at the starts of the intervals, rad/s; `dt` (n): their lengths, s, negative backward
    in time; `momenta`: momentum (n, 3) of all wheels at the starts, and at the ends, rad/s; it is linear between. `derivatives`: by
    turn and rate at the start, and by one sigma of each of the `errors` (e, 3, 3) of the inertia.
    """
    # a sphere without wheels has a constant rate, and needs no integration
    exact = errors is None or not len(errors)
    sphere = inertia.ndim == 2 and bool((inertia == inertia[0, 0] * np.eye(3)).all())
    if exact and sphere and not (momenta[0].any() or momenta[1].any()):
        return _constant_rate_step(omega, dt, derivatives)
    bodies = inertia[None] if inertia.ndim == 2 else inertia  # (1 or K, 3, 3)
    angle = angle_turned(bodies, omega, dt, momenta)
    counts = np.clip(np.ceil(angle / STEP_RAD), LEAST_STEPS, MOST_STEPS).astype(np.int64)
    if not derivatives:
        turned, rate = carry_bodies(bodies[None], omega[None], dt, counts, momenta)
        return Step(turned[0], rate[0])

    # the first axis counts runs: the motion itself, three with a changed rate, and one with each error of the inertia
    errors = np.zeros((0, 3, 3)) if errors is None else errors
    of_rates, of_errors = slice(1, 4), slice(4, None)
    # One component of the rate is changed so that the body turns by DIFFERENCE (rad) more in the interval. In an interval of length
    # zero the change is as for 1 s.
    span_s = np.where(dt == 0, 1.0, dt)[:, None]
    rates = np.repeat(omega[None], 4 + len(errors), axis=0)
    rates[of_rates] += np.eye(3)[:, None, None] * (DIFFERENCE / span_s)
    bodies = np.repeat(bodies[None], len(rates), axis=0)
    bodies[of_errors] += INERTIA_DIFFERENCE * errors[:, None]
    turned, rate = carry_bodies(bodies, rates, dt, counts, momenta)
    change = np.concatenate([rotation_between(turned[0], turned[1:]), rate[1:] - rate[0]], axis=-1)
    change = np.moveaxis(change, 0, -1)  # (K, n, 6, runs but the first), relative to the first
    by_rate, by_error = change[..., :3], change[..., 3:]
    by_start = np.zeros((*omega.shape[:-1], 6, 6))
    # a turn at the start turns the end too: `turned` gives its components in body axes at the end; it changes no rate
    by_start[..., TURN, TURN] = turned[0]
    by_start[..., RATE] = by_rate * span_s[..., None] / DIFFERENCE
    return Step(turned[0], rate[0], by_start, by_error / INERTIA_DIFFERENCE)


def _constant_rate_step(omega: np.ndarray, dt: np.ndarray, derivatives: bool) -> Step:
    """Return the motions of a sphere without wheels after intervals `dt` (n), s, with derivatives by the start if wanted.

    The rates `omega` (K, n, 3), rad/s in body axes, are constant. The body rotates by the angle x about the axis a.

    Let the rate change by dw. Then each part du of the interval adds a turn dw dt du. If the part u of the interval is still to
    come, a rotation by u x converts this turn to the body axes of the end. So the derivative of the turn at the end by the rate is
    dt times the mean of these rotation matrices over u from 0 to 1. With sinc(x) = sin(x) / x and the matrix C of the cross
    product, C v = a x v, the mean is

        sinc(x) I + (1 - sinc(x)) a a^T - (1 - cos x) / x C.
    """
    rotation = omega * np.asarray(dt)[..., None]  # rotation vectors
    turned = rotate_attitude(np.broadcast_to(np.eye(3), (*omega.shape, 3)), rotation)
    if not derivatives:
        return Step(turned, omega.copy())
    x = np.linalg.norm(rotation, axis=-1)[..., None, None]
    axis = rotation[..., None, :] / np.maximum(x, np.finfo(float).tiny)  # a^T, (K, n, 1, 3)
    # sinc(x) and sinc(x / 2); NumPy's function is sin(pi x) / (pi x)
    sinc, sinc_of_half = np.sinc(x / np.pi), np.sinc(x / (2 * np.pi))
    along = np.swapaxes(axis, -1, -2) @ axis
    cross = cross_matrix(axis[..., 0, :])
    # (1 - cos x) / x = 2 sin^2(x / 2) / x = x / 2 sinc(x / 2)^2
    mean = sinc * np.eye(3) + (1 - sinc) * along - x / 2 * sinc_of_half**2 * cross
    by_start = np.zeros((*omega.shape[:-1], 6, 6))
    by_start[..., TURN, TURN] = turned
    by_start[..., TURN, RATE] = np.asarray(dt)[..., None, None] * mean
    by_start[..., RATE, RATE] = np.eye(3)
    return Step(turned, omega.copy(), by_start, np.zeros((*omega.shape[:-1], 6, 0)))
