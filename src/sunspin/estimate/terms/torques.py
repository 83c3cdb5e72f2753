"""Torques as terms: what an unknown torque adds to turn and rate over the intervals between samples, to first order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from sunspin.estimate.model import States, Unknown
from sunspin.estimate.settings import DIPOLE_SIZES
from sunspin.estimate.terms.term import Term
from sunspin.solve.rotations import cross, cross_matrix, rotate_attitude

Frame = Literal["B", "N"]

WORDS: dict[Frame, str] = {"B": "body axes", "N": "axes fixed in space"}
"""In which axes a torque is constant, in words."""

INSTANTS = np.polynomial.legendre.leggauss(5)
"""Instants, from -1 to 1, and weights for a mean over an interval in which a slow body turns by less than a revolution."""

SERIES = 12
"""Terms of the exponential series of matrices of norm a half, whose remainder is 1e-14."""


@dataclass(frozen=True)
class ConstantTorque(Term):
    """A torque that is constant over a pass, in the body (a leak, a thruster) or in space (drag, gravity).

    A torque that changes the rate by dw over the time T turns the body by dw T / 2. This angle, not the acceleration, decides how
    well the data show it. `sigma` (rad/s2): that of the largest of the `shares`; `inertia` (3, 3) and `momentum` (n, 3) as in a
    model.
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
        """Return a torque that turns the body by one of these angles (one sigma each, equally likely) in the duration of a pass."""
        largest = max(turns_rad)
        shares = tuple(turn / largest for turn in sorted(turns_rad, reverse=True))
        return cls(frame, 2 * largest / duration_s**2, shares, inertia, momentum)

    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the three components, as angular accelerations of a body with the mean moment."""
        return tuple(
            Unknown(
                f"steady_{axis}", "steady_torque", "rad/s2", 0.0, self.sigma, i, shares=self.shares
            )
            for i, axis in enumerate("xyz")
        )

    def added_by_unknowns(self, states: States, dt: np.ndarray) -> np.ndarray:
        """Return turn and rate (K, n - 1, 6, 3) that one sigma of each component adds over the intervals dt (n - 1).

        Small deviations from a motion, in body axes, follow linear equations in time s: a turn t, a rate r, under a torque T:

            dt/ds = -w x t + r;  I dr/ds = (I w + h) x r - w x (I r) + T;  dT/ds = 0, or -w x T for one constant in space.

        Here w is the mean rate of the interval, I the inertia, h the momentum of the wheels. The matrix of this system is constant:
        its exponential gives t and r at the end for each T at the start.
        """
        turn, rate, torque = slice(0, 3), slice(3, 6), slice(6, 9)
        omega = (states.omega[:, :-1] + states.omega[:, 1:]) / 2
        turning = cross_matrix(omega)
        inverse = np.linalg.inv(self.inertia)
        momentum = omega @ self.inertia + (self.momentum[:-1] + self.momentum[1:]) / 2
        system = np.zeros((*omega.shape[:2], 9, 9))
        system[..., turn, turn] = -turning
        system[..., turn, rate] = np.eye(3)
        system[..., rate, rate] = inverse @ (cross_matrix(momentum) - turning @ self.inertia)
        system[..., rate, torque] = inverse
        if self.frame == "N":
            system[..., torque, torque] = -turning
        added = self.sigma * exponential(system * dt[:, None, None])[..., :6, torque]
        # unknowns in N: the attitude gives the torque in body axes at the start of the interval
        return added if self.frame == "B" else added @ states.attitude[:, :-1]


@dataclass(frozen=True)
class MagneticTorque(Term):
    """The torque of a magnetic dipole fixed in the body, in a field fixed in N.

    A CubeSat's residual dipole accelerates it by 1e-6 to 1e-4 rad/s2, the same way for minutes, while white angular acceleration of
    the same size averages out. `field_N` (n, 3): the field in units of its usual size, if an orbit knows it; then the three
    components of the dipole are unknown. Else dipole and field are both unknown, and the torque is linear in the nine products of
    their components. `sigma` (rad/s2): that of the acceleration by the largest dipole, zero if none is modelled; a dipole is not
    known to a power of ten, so smaller ones are equally likely.
    """

    name: ClassVar[str] = "magnetic_torque"
    label: ClassVar[str] = "magnetic torque"
    per_sample: ClassVar[tuple[str, ...]] = ("field_N",)

    field_N: np.ndarray | None = None
    sigma: float = DIPOLE_SIZES[0]

    @classmethod
    def in_field(cls, field_N: np.ndarray | None) -> MagneticTorque:
        """Return the torque in a field (n, 3) in any unit, or in an unknown one."""
        if field_N is None:
            return cls()
        return cls(field_N=field_N / np.median(np.linalg.norm(field_N, axis=1)))

    def for_search(self) -> list[MagneticTorque]:
        """Return the torque with a dipole of zero: a search has strong unknown torques."""
        return [replace(self, sigma=0.0)]

    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the components of the dipole, or their products with those of the field."""
        if not self.sigma:
            return ()
        shares = tuple(size / DIPOLE_SIZES[0] for size in DIPOLE_SIZES)
        if self.field_N is not None:
            # a dipole and a direction at random: m x b has a variance of two
            size, names = self.sigma / np.sqrt(2), [f"dipole_{axis}" for axis in "xyz"]
        else:
            # products of a variance of one give a torque of six
            size = self.sigma / np.sqrt(6)
            names = [f"magnetic_{dipole}{axis}" for dipole in "xyz" for axis in "xyz"]
        return tuple(
            Unknown(name, "magnetic_torque", "rad/s2", 0.0, size, i, shares=shares)
            for i, name in enumerate(names)
        )

    def added_by_unknowns(self, states: States, dt: np.ndarray) -> np.ndarray | None:
        """Return turn and rate (K, n - 1, 6, m) that one sigma of each unknown adds, by the attitude averaged over each interval.

        The body keeps its first rate: if it turns several times between two samples only the field along the axis is left, and the
        torque along the axis averages out.
        """
        if not self.sigma:
            return None
        # An acceleration a(s) adds the rate dt <a> and the turn dt^2 / 2 <a>_early. The second mean has the weight 2 (dt - s) / dt,
        # as what acts early turns the body longer. Of a field that is linear in s these means are at a half and at a third of the
        # interval.
        even, early = averaged_attitudes(states, dt)
        if self.field_N is None:
            size = self.sigma / np.sqrt(6)
            for_turn, for_rate = _products(early), _products(even)
        else:
            first, last = self.field_N[:-1], self.field_N[1:]
            size = self.sigma / np.sqrt(2)
            # e_j x b is what the matrix of -b x does to e_j
            for_turn = -cross_matrix(np.einsum("knij,nj->kni", early, (2 * first + last) / 3))
            for_rate = -cross_matrix(np.einsum("knij,nj->kni", even, (first + last) / 2))
        span = dt[:, None, None]
        return size * np.concatenate([span**2 / 2 * for_turn, span * for_rate], axis=2)


def averaged_attitudes(states: States, dt: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return attitudes (K, n - 1, 3, 3) averaged over each interval of a body that keeps its first rate.

    First evenly, then with the weight 2 (1 - u) of a time u from 0 to 1. Rodrigues' formula gives the turn by x u about the axis e
    as cos I + (1 - cos) e e^T - sin [e x]. So only the means of cos(x u) and sin(x u) are needed. With sinc x = sin(x) / x:

        evenly: sinc x and (x / 2) sinc(x / 2)^2;
        early: sinc(x / 2)^2 and 2 (1 - sinc x) / x.
    """
    angle = states.omega[:, :-1] * dt[:, None]
    x = np.linalg.norm(angle, axis=-1)[..., None, None]
    axis = angle[..., None, :] / np.maximum(x, 1e-300)
    across, along = cross_matrix(axis[..., 0, :]), np.swapaxes(axis, -1, -2) @ axis
    sinc, sinc_half_squared = np.sinc(x / np.pi), np.sinc(x / (2 * np.pi)) ** 2
    means = (  # of cosine and sine
        (sinc, x / 2 * sinc_half_squared),
        (sinc_half_squared, 2 * (1 - sinc) / np.maximum(x, 1e-300)),
    )
    even, early = (
        (cosine * np.eye(3) + (1 - cosine) * along - sine * across) @ states.attitude[:, :-1]
        for cosine, sine in means
    )
    return even, early


def _products(attitude: np.ndarray) -> np.ndarray:
    """Return the torques e_j x A e_l (..., 3, 9) of dipoles along j in fields along l of space, for all j and l in this order."""
    torque = np.einsum("jim,...ml->...ijl", cross_matrix(np.eye(3)), attitude)
    return torque.reshape(*attitude.shape[:-1], 9)


@dataclass(frozen=True)
class StatedDipole(Term):
    """The torque of a dipole that the vehicle file states, in the field that a magnetometer reads.

    `dipole` (3): the angular acceleration is dipole x field, in rad/s2 per unit of the magnetometer; `field_B` (n, 3), zero where
    it read nothing. Between two samples the field is linear in the body, which holds to a few percent up to 40 degrees of turn.
    """

    name: ClassVar[str] = "dipole"
    label: ClassVar[str] = "dipole"
    per_sample: ClassVar[tuple[str, ...]] = ("field_B",)

    dipole: np.ndarray
    field_B: np.ndarray

    def added_by_torque(self, states: States, dt: np.ndarray) -> np.ndarray:
        """Return turn and rate (K, n - 1, 6) that the torque adds in intervals dt (n - 1)."""
        acceleration, span = np.cross(self.dipole, self.field_B), dt[:, None]
        first, last = acceleration[:-1], acceleration[1:]
        # integrals of an acceleration that is linear in time
        added = [span**2 * (2 * first + last) / 6, span * (first + last) / 2]
        return np.broadcast_to(np.concatenate(added, axis=1), (*states.omega[:, 1:].shape[:2], 6))


@dataclass(frozen=True)
class GravityTorque(Term):
    """The torque 3 n^2 nadir x (I nadir) of the Earth's attraction, equation (gravity_gradient) of docs/model.md.

    `nadir_N` (n, 3); `strength` (n): 3 n^2 in 1/s2; `inertia` (3, 3) in mean moments.
    """

    name: ClassVar[str] = "gravity_gradient"
    label: ClassVar[str] = "gravity gradient"
    about_sun: ClassVar[bool] = True
    per_sample: ClassVar[tuple[str, ...]] = ("nadir_N", "strength")

    nadir_N: np.ndarray
    strength: np.ndarray
    inertia: np.ndarray

    def added_by_torque(self, states: States, dt: np.ndarray) -> np.ndarray:
        """Return turn and rate (K, n - 1, 6) that the torque adds, summed over instants of a body that keeps its first rate."""
        inverse, added = np.linalg.inv(self.inertia), 0.0
        for node, weight in zip(*INSTANTS, strict=True):  # Gauss's quadrature over the interval
            share = (1 + node) / 2
            attitude = rotate_attitude(
                states.attitude[:, :-1], share * dt[:, None] * states.omega[:, :-1]
            )
            nadir = (1 - share) * self.nadir_N[:-1] + share * self.nadir_N[1:]
            nadir_B = np.einsum("knij,nj->kni", attitude, nadir)
            torque = self.strength[:-1, None] * cross(nadir_B, nadir_B @ self.inertia)
            rate = weight / 2 * dt[:, None] * (torque @ inverse)
            # a rate that is gained now turns the body for the rest of the interval
            added = added + np.concatenate([(1 - share) * dt[:, None] * rate, rate], axis=-1)
        return np.asarray(added)


def exponential(matrix: np.ndarray) -> np.ndarray:
    """Return the exponentials of matrices (..., d, d): exp(M) is exp(M / 2^s) squared s times, and that is a short series.

    All matrices have the same s, which makes the norm of each at most a half.
    """
    largest = float(np.abs(matrix).sum(axis=-1).max(initial=0.0))
    halvings = max(0, int(np.ceil(np.log2(max(largest, 1e-300)))) + 1)
    small, eye = matrix / 2.0**halvings, np.eye(matrix.shape[-1])
    result = eye + small / SERIES
    for k in range(SERIES - 1, 0, -1):  # Horner's scheme
        result = eye + small @ result / k
    for _ in range(halvings):
        result = result @ result
    return result
