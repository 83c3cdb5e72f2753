"""Terms of torques: what a torque adds to the state of a motion in the intervals between samples, to first order.

The state is a turn, a rotation of the body as a rotation vector (rad), and the rate (rad/s), both in body axes B at the end of an
interval. Shapes: K motions, n samples, n - 1 intervals dt (s), m unknowns in sigmas of their priors. N is fixed in space, attitudes
are matrices B_from_N. Torques are angular accelerations (rad/s2) of a body with the mean moment, as inertia is in mean moments.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np

from sunspin.estimate.model import States, Unknown
from sunspin.estimate.settings import DIPOLE_SIZES
from sunspin.estimate.terms.term import Term
from sunspin.solve.rotations import cross, cross_matrix, rotate_attitude

Frame = Literal["B", "N"]

WORDS: dict[Frame, str] = {"B": "body axes", "N": "axes fixed in space"}
"""Axes in which a torque is constant, in words."""

QUADRATURE = np.polynomial.legendre.leggauss(5)
"""Nodes in [-1, 1] and weights of Gauss's quadrature over an interval, for bodies that rotate by less than a revolution in it."""

RAMP_SIGMAS, RAMP_DIFFERENCE = 2.0, 1e-3
"""Errors of a wheel's change, in sigmas: the largest ones in a fit, and the difference for derivatives."""

SHORTEST_RAMP_S = 0.5
"""A wheel takes at least so long to change its speed."""

UNEVEN, KNOTS = 0.3, 4
"""The momentum of a wheel may deviate from its ramp by this part of the change (one sigma), independently at so many times."""

SERIES_TERMS = 12
"""Number of terms of the exponential series. Its remainder is 1e-14 for matrices with a norm of a half."""


@dataclass(frozen=True)
class ConstantTorque(Term):
    """An unknown torque that is constant over a pass in the axes `frame`: in the body (leak, thruster) or in space (drag, gravity).

    `sigma` (rad/s2): largest sigma of a component; `shares`: equally likely sigmas, as factors of it. `inertia` (3, 3) in mean
    moments; `momentum` (n, 3): of the wheels, in mean moments times rad/s.
    """

    name: ClassVar[str] = "constant_torque"
    label: ClassVar[str] = "constant torque"
    per_sample: ClassVar[tuple[str, ...]] = ("momentum",)

    frame: Frame
    sigma: float
    shares: tuple[float, ...]
    inertia: np.ndarray
    momentum: np.ndarray

    @classmethod
    def turning(
        cls,
        frame: Frame,
        turns_rad: Sequence[float],
        duration_s: float,
        inertia: np.ndarray,
        momentum: np.ndarray,
    ) -> ConstantTorque:
        """Return a torque that would rotate a body at rest by one of the angles `turns_rad` (sigmas, equally likely) in a pass.

        The angle a T^2 / 2, not the acceleration a, decides how well data over the duration T show a torque.
        """
        largest = max(turns_rad)
        shares = tuple(turn / largest for turn in sorted(turns_rad, reverse=True))
        return cls(frame, 2 * largest / duration_s**2, shares, inertia, momentum)

    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the three components of the torque as unknowns."""
        return tuple(
            Unknown(
                f"steady_{axis}", "steady_torque", "rad/s2", 0.0, self.sigma, i, shares=self.shares
            )
            for i, axis in enumerate("xyz")
        )

    def added_by_unknowns(self, states: States, dt: np.ndarray) -> np.ndarray:
        """Return turn and rate (K, n - 1, 6, 3) that one sigma of each component adds in the intervals dt (n - 1)."""
        added = added_by_torques(states, dt, self.inertia, self.momentum, self.frame)
        # unknowns in N: the attitude gives the torque in body axes at the start of the interval
        return self.sigma * (added if self.frame == "B" else added @ states.attitude[:, :-1])


@dataclass(frozen=True)
class Ramp:
    """A quantity that changes linearly by `size` from the time `begin_s` to `end_s`, and back at once at `until_s` (s)."""

    begin_s: float
    end_s: float
    size: float
    until_s: float = np.inf

    def done(self, t_s: np.ndarray) -> np.ndarray:
        """Return the part of the change (n), from 0 to 1, that is done at times (n)."""
        done = np.clip((t_s - self.begin_s) / (self.end_s - self.begin_s), 0.0, 1.0)
        return np.where(t_s > self.until_s, 0.0, done)

    def change(self, t_s: np.ndarray) -> np.ndarray:
        """Return the change (n) at times (n)."""
        return self.size * self.done(t_s)

    def integral(self, t_s: np.ndarray) -> np.ndarray:
        """Return the integral (n) of the change up to times (n), none of which is after `until_s`."""
        of_ramp = (self.end_s - self.begin_s) / 2 * self.done(t_s) ** 2
        return self.size * (of_ramp + np.maximum(t_s - self.end_s, 0.0))


@dataclass(frozen=True)
class WheelChange(Term):
    """The torque of a wheel whose momentum changes along a ramp with errors, on a command to its motor or brake.

    The body gains what the wheel loses. The momentum that is left in the wheel turns the rate of the body at another frequency.

    `t_s` (n): times of the samples; `axis_B` (3): axis of the wheel; `ramp`: the change that is assumed, in mean moments times
    rad/s; `time_sigma_s`: sigma of its begin and of its end, zero in a search. `inertia` (3, 3) in mean moments; `momentum` (n, 3):
    of all wheels at the samples, with the assumed change.
    """

    name: ClassVar[str] = "wheel_change"
    label: ClassVar[str] = "wheel"
    per_sample: ClassVar[tuple[str, ...]] = ("t_s", "momentum")

    t_s: np.ndarray
    axis_B: np.ndarray
    ramp: Ramp
    time_sigma_s: float
    inertia: np.ndarray
    momentum: np.ndarray

    def for_search(self) -> list[WheelChange]:
        """Return the wheel with exactly the assumed change, as a search allows strong unknown torques anyway."""
        return [replace(self, time_sigma_s=0.0)]

    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the errors of size, begin and end of the ramp, then those of the momentum at the knots (:meth:`_at_knots`)."""
        if not self.time_sigma_s:
            return ()
        size = abs(self.ramp.size)
        units_and_sigmas = [
            ("rad/s", size),
            ("s", self.time_sigma_s),
            ("s", self.time_sigma_s),
            *[("rad/s", UNEVEN * size)] * KNOTS,
        ]
        return tuple(
            Unknown(f"wheel_change_{i}", "wheel_change", unit, 0.0, sigma, i, RAMP_SIGMAS)
            for i, (unit, sigma) in enumerate(units_and_sigmas)
        )

    def with_errors(self, u: np.ndarray) -> Ramp:
        """Return the ramp with errors u (3), in sigmas, of its size, begin and end."""
        size = self.ramp.size + abs(self.ramp.size) * float(u[0])
        begin_s = self.ramp.begin_s + self.time_sigma_s * float(u[1])
        end_s = self.ramp.end_s + self.time_sigma_s * float(u[2])
        return Ramp(begin_s, max(end_s, begin_s + SHORTEST_RAMP_S), size, self.ramp.until_s)

    def added_by_unknowns(self, states: States, dt: np.ndarray) -> np.ndarray | None:
        """Return turn and rate (K, n - 1, 6, m) that one sigma of each error adds in the intervals dt (n - 1).

        A momentum p along the axis a exerts the torque -dp/dt a - w x p a on a body with the rate w; its mean in an interval acts.
        """
        if not self.time_sigma_s:
            return None
        momentum, beyond = self._by_errors
        omega = (states.omega[:, :-1] + states.omega[:, 1:]) / 2
        mean, change = (momentum[:-1] + momentum[1:]) / 2, np.diff(momentum, axis=0) / dt[:, None]
        torque = -self.axis_B[:, None] * change[:, None]
        torque = torque - cross(omega, self.axis_B)[..., None] * mean[:, None]
        added = added_by_torques(states, dt, self.inertia, self.momentum, "B") @ torque
        added[..., :3, :] += self._turned_by(states, dt)[..., None] * beyond[:, None]
        return added

    def added_by_torque(self, states: States, dt: np.ndarray) -> np.ndarray:
        """Return turn and rate (K, n - 1, 6) that the assumed ramp adds where it begins or ends within an interval.

        Motions are propagated with a momentum of the wheels that is linear between samples.
        """
        turn = self._turned_by(states, dt) * self._beyond_trapezoid(self.ramp)[:, None]
        return np.concatenate([turn, np.zeros_like(turn)], axis=-1)

    def _turned_by(self, states: States, dt: np.ndarray) -> np.ndarray:
        """Return the turn (K, n - 1, 3) at the end of each interval by a unit integral of the momentum in the middle of it."""
        turn = -np.linalg.solve(self.inertia, self.axis_B)
        half = states.omega[:, :-1] * dt[:, None] / 2
        return rotate_attitude(np.broadcast_to(np.eye(3), (*half.shape, 3)), half) @ turn

    @cached_property
    def _by_errors(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives, by one sigma of each of m errors, of the momentum (n, m) and of :meth:`_beyond_trapezoid` (n - 1, m)."""
        momentum_0, beyond_0 = self.ramp.change(self.t_s), self._beyond_trapezoid(self.ramp)
        ramps = [self.with_errors(u) for u in RAMP_DIFFERENCE * np.eye(3)]
        momentum = np.stack([ramp.change(self.t_s) - momentum_0 for ramp in ramps], axis=1)
        beyond = np.stack([self._beyond_trapezoid(ramp) - beyond_0 for ramp in ramps], axis=1)
        momentum, beyond = momentum / RAMP_DIFFERENCE, beyond / RAMP_DIFFERENCE
        # between samples the errors at the knots are taken as linear, so they add nothing to the second derivative
        at_knots = self._at_knots()
        momentum = np.concatenate([momentum, at_knots], axis=1)
        return momentum, np.concatenate([beyond, np.zeros_like(at_knots[1:])], axis=1)

    def _at_knots(self) -> np.ndarray:
        """Return the momentum (n, `KNOTS`) at the samples by one sigma of its error at each of several times about the ramp.

        The ramp need not be straight. Without these errors the rate at samples within it was up to 16 sigma off.
        """
        margin_s = self.time_sigma_s / 2
        first_s, last_s = self.ramp.begin_s - margin_s, self.ramp.end_s + margin_s
        knots_s = np.linspace(first_s, last_s, KNOTS + 2)
        hats = [np.interp(self.t_s, knots_s, hat) for hat in np.eye(KNOTS + 2)[1:-1]]
        return UNEVEN * abs(self.ramp.size) * np.stack(hats, axis=1)

    def _beyond_trapezoid(self, ramp: Ramp) -> np.ndarray:
        """Return the integral (n - 1) of a ramp over each interval, less that of a change that is linear in the interval."""
        change = ramp.change(self.t_s)
        trapezoid = np.diff(self.t_s) * (change[:-1] + change[1:]) / 2
        # zero again at the end of a pass, hence in all later ones
        return np.where(
            self.t_s[1:] > ramp.until_s, 0.0, np.diff(ramp.integral(self.t_s)) - trapezoid
        )


@dataclass(frozen=True)
class MagneticTorque(Term):
    """The torque m x b of an unknown magnetic dipole m fixed in the body, in a field b.

    The residual dipole of a CubeSat accelerates it by 1e-6 to 1e-4 rad/s2 in the same direction for minutes, while white angular
    acceleration of the same size averages out.

    `field_N` (n, 3): the field of a known orbit, in units of its median strength. Then the three components of the dipole are
    unknown. Without it (None), dipole and field are both unknown, the field is constant in N, and the torque is linear in the nine
    products of their components. `sigma` (rad/s2): sigma of the acceleration by the largest dipole, zero if none is modelled; the
    smaller ones of :data:`DIPOLE_SIZES` are equally likely.
    """

    name: ClassVar[str] = "magnetic_torque"
    label: ClassVar[str] = "magnetic torque"
    per_sample: ClassVar[tuple[str, ...]] = ("field_N",)

    field_N: np.ndarray | None = None
    sigma: float = DIPOLE_SIZES[0]

    @classmethod
    def in_field(cls, field_N: np.ndarray | None) -> MagneticTorque:
        """Return the torque in a field (n, 3) of any unit, N, or in an unknown field (None)."""
        if field_N is None:
            return cls()
        return cls(field_N=field_N / np.median(np.linalg.norm(field_N, axis=1)))

    def for_search(self) -> list[MagneticTorque]:
        """Return the torque without a dipole, as a search allows strong unknown torques anyway."""
        return [replace(self, sigma=0.0)]

    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the components of the dipole, or their products with those of an unknown field."""
        if not self.sigma:
            return ()
        shares = tuple(size / DIPOLE_SIZES[0] for size in DIPOLE_SIZES)
        if self.field_N is not None:
            # m x b of a random dipole m with unit sigmas and a unit vector b has a variance of two
            size, names = self.sigma / np.sqrt(2), [f"dipole_{axis}" for axis in "xyz"]
        else:
            # nine products with unit sigmas give a torque with a variance of six
            size = self.sigma / np.sqrt(6)
            names = [f"magnetic_{dipole}{axis}" for dipole in "xyz" for axis in "xyz"]
        return tuple(
            Unknown(name, "magnetic_torque", "rad/s2", 0.0, size, i, shares=shares)
            for i, name in enumerate(names)
        )

    def added_by_unknowns(self, states: States, dt: np.ndarray) -> np.ndarray | None:
        """Return the turn and rate (K, n - 1, 6, m) that one sigma of each unknown adds by the end of each interval dt (n - 1).

        Approximations: the body is a sphere, keeps the interval's first rate, and sees the mean field at its mean attitude.
        """
        if not self.sigma:
            return None
        # An acceleration a(s) at the time s in the interval adds the rate dt <a> and the turn dt^2 / 2 <a>_early. <a> is the plain
        # mean; <a>_early has the weight 2 (dt - s) / dt, as an early acceleration acts on the attitude for longer. For a field that
        # is linear in s the two means are its values at dt / 2 and dt / 3. `size` below: sigma of an unknown, as in `unknowns`.
        even, early = averaged_attitudes(states, dt)
        if self.field_N is None:
            size = self.sigma / np.sqrt(6)
            for_turn, for_rate = _torques_of_products(early), _torques_of_products(even)
        else:
            first, last = self.field_N[:-1], self.field_N[1:]
            size = self.sigma / np.sqrt(2)
            # a unit dipole along axis j has the torque e_j x b = -b x e_j: column j of the matrix of -b x
            for_turn = -cross_matrix(np.einsum("knij,nj->kni", early, (2 * first + last) / 3))
            for_rate = -cross_matrix(np.einsum("knij,nj->kni", even, (first + last) / 2))
        span = dt[:, None, None]
        return size * np.concatenate([span**2 / 2 * for_turn, span * for_rate], axis=2)


def added_by_torques(
    states: States, dt: np.ndarray, inertia: np.ndarray, momentum: np.ndarray, frame: Frame
) -> np.ndarray:
    """Return turn and rate (K, n - 1, 6, 3) that a unit torque along each body axis adds in the intervals dt (n - 1), s.

    At the start of the interval the torque is along a body axis. From then on it is constant in the axes `frame`. Under a torque T
    small deviations from a motion, t of the turn and r of the rate, in body axes, follow linear equations in the time s:

        dt/ds = -w x t + r;  I dr/ds = (I w + h) x r - w x (I r) + T;  dT/ds = 0, or -w x T for one constant in space.

    Here I is the inertia (3, 3); w and h are means over both ends of the interval, of the rate and of the `momentum` (n, 3) of the
    wheels. So the matrix of this system is constant. Its exponential gives t and r at the end of the interval for a T at its start.
    """
    # places of t, r and T in the vector of the system
    turn, rate, torque = slice(0, 3), slice(3, 6), slice(6, 9)
    omega = (states.omega[:, :-1] + states.omega[:, 1:]) / 2
    omega_cross = cross_matrix(omega)
    inverse = np.linalg.inv(inertia)
    total = omega @ inertia + (momentum[:-1] + momentum[1:]) / 2
    system = np.zeros((*omega.shape[:2], 9, 9))
    system[..., turn, turn] = -omega_cross
    system[..., turn, rate] = np.eye(3)
    system[..., rate, rate] = inverse @ (cross_matrix(total) - omega_cross @ inertia)
    system[..., rate, torque] = inverse
    if frame == "N":
        system[..., torque, torque] = -omega_cross
    return exponential(system * dt[:, None, None])[..., :6, torque]


def averaged_attitudes(states: States, dt: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two means of the attitudes (K, n - 1, 3, 3) over each interval dt (n - 1), for a body that keeps its first rate.

    The first is the plain mean, the second has the weight 2 (1 - v) at the time v, from 0 to 1 in an interval. Rodrigues' formula
    gives the rotation of the body by the angle x v about the axis e as cos I + (1 - cos) e e^T - sin [e x]. So only the means of
    cos(x v) and sin(x v) are needed. With sinc x = sin(x) / x they are:

        plain: sinc x and (x / 2) sinc(x / 2)^2;
        early: sinc(x / 2)^2 and 2 (1 - sinc x) / x.
    """
    angle = states.omega[:, :-1] * dt[:, None]
    x = np.linalg.norm(angle, axis=-1)[..., None, None]
    axis = angle[..., None, :] / np.maximum(x, 1e-300)
    across, along = cross_matrix(axis[..., 0, :]), np.swapaxes(axis, -1, -2) @ axis
    sinc, sinc_half_squared = np.sinc(x / np.pi), np.sinc(x / (2 * np.pi)) ** 2
    # of cosine and sine, plain and early
    means = (
        (sinc, x / 2 * sinc_half_squared),
        (sinc_half_squared, 2 * (1 - sinc) / np.maximum(x, 1e-300)),
    )
    even, early = (
        (cosine * np.eye(3) + (1 - cosine) * along - sine * across) @ states.attitude[:, :-1]
        for cosine, sine in means
    )
    return even, early


def _torques_of_products(attitude: np.ndarray) -> np.ndarray:
    """Return the torques (..., 3, 9) of unit dipoles along body axis j in unit fields along axis l of N, in the order (j, l).

    With the attitude A = B_from_N (..., 3, 3) they are e_j x A e_l.
    """
    torque = np.einsum("jim,...ml->...ijl", cross_matrix(np.eye(3)), attitude)
    return torque.reshape(*attitude.shape[:-1], 9)


@dataclass(frozen=True)
class StatedDipole(Term):
    """The known torque of a dipole that the vehicle file states, in the field that a magnetometer reads.

    `dipole` (3), rad/s2 per unit of the magnetometer: the angular acceleration is dipole x field. `field_B` (n, 3): readings, zero
    where nothing was read. Between two samples the field is taken as linear in time in body axes, which holds to a few percent if
    the body rotates by up to 40 degrees.
    """

    name: ClassVar[str] = "dipole"
    label: ClassVar[str] = "dipole"
    per_sample: ClassVar[tuple[str, ...]] = ("field_B",)

    dipole: np.ndarray
    field_B: np.ndarray

    def added_by_torque(self, states: States, dt: np.ndarray) -> np.ndarray:
        """Return turn and rate (K, n - 1, 6) that the torque adds in the intervals dt (n - 1)."""
        acceleration, span = np.cross(self.dipole, self.field_B), dt[:, None]
        first, last = acceleration[:-1], acceleration[1:]
        # second and first integral of an acceleration that is linear in time
        added = [span**2 * (2 * first + last) / 6, span * (first + last) / 2]
        return np.broadcast_to(np.concatenate(added, axis=1), (*states.omega[:, 1:].shape[:2], 6))


@dataclass(frozen=True)
class GravityTorque(Term):
    """The gravity-gradient torque 3 n^2 nadir x (I nadir), equation (gravity_gradient) of docs/model.md.

    `nadir_N` (n, 3): unit vectors; `strength` (n): 3 n^2 in 1/s2 with the orbital rate n; `inertia` (3, 3) in mean moments.
    """

    name: ClassVar[str] = "gravity_gradient"
    label: ClassVar[str] = "gravity gradient"
    about_sun: ClassVar[bool] = True
    per_sample: ClassVar[tuple[str, ...]] = ("nadir_N", "strength")

    nadir_N: np.ndarray
    strength: np.ndarray
    inertia: np.ndarray

    def added_by_torque(self, states: States, dt: np.ndarray) -> np.ndarray:
        """Return turn and rate (K, n - 1, 6) that the torque adds in the intervals dt (n - 1), by Gauss's quadrature.

        The body keeps its first rate in each interval.
        """
        inverse, added = np.linalg.inv(self.inertia), 0.0
        for node, weight in zip(*QUADRATURE, strict=True):
            # time of the node from 0 to 1 in the interval
            share = (1 + node) / 2
            attitude = rotate_attitude(
                states.attitude[:, :-1], share * dt[:, None] * states.omega[:, :-1]
            )
            nadir = (1 - share) * self.nadir_N[:-1] + share * self.nadir_N[1:]
            nadir_B = np.einsum("knij,nj->kni", attitude, nadir)
            torque = self.strength[:-1, None] * cross(nadir_B, nadir_B @ self.inertia)
            rate = weight / 2 * dt[:, None] * (torque @ inverse)
            # the added rate rotates the body for the rest of the interval
            added = added + np.concatenate([(1 - share) * dt[:, None] * rate, rate], axis=-1)
        return np.asarray(added)


def exponential(matrix: np.ndarray) -> np.ndarray:
    """Return the exponentials of matrices (..., d, d) by scaling and squaring: exp(M) is exp(M / 2^s) squared s times.

    All matrices have the same s, so that the norm of each M / 2^s is at most a half. Its exponential is a short power series.
    """
    largest_norm = float(np.abs(matrix).sum(axis=-1).max(initial=0.0))
    halvings = max(0, int(np.ceil(np.log2(max(largest_norm, 1e-300)))) + 1)
    small, eye = matrix / 2.0**halvings, np.eye(matrix.shape[-1])
    # Horner's scheme of the series
    result = eye + small / SERIES_TERMS
    for k in range(SERIES_TERMS - 1, 0, -1):
        result = eye + small @ result / k
    for _ in range(halvings):
        result = result @ result
    return result
