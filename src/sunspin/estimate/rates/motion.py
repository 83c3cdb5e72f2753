"""One step of the smoother of :mod:`sunspin.estimate.rates`: attitude and rate from one sample to the next, and how they answer.

The equations are those of :mod:`sunspin.dynamics.gyrostat`, compiled. Wheels enter by their momentum, linear in time
between two samples (:mod:`sunspin.estimate.rates.wheels` says how fast they turn). A vehicle without inertia is searched as
a sphere, whose torque-free rate is constant; what it is not are errors of its inertia, or the process noise where that is given.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sunspin.base.errors import InputError
from sunspin.dynamics import gyrostat as g
from sunspin.dynamics.bodies import Bodies
from sunspin.dynamics.step import BodyNumbers, Loads, carry
from sunspin.dynamics.torques import NOTHING, Acting
from sunspin.estimate.effort import spend
from sunspin.estimate.inertia import inertia_errors, unknown_errors
from sunspin.solve.linear import symmetric_inverse
from sunspin.solve.rotations import cross, matrix_from_quaternion, rotate_attitude, rotation_between
from sunspin.vehicle import Vehicle

STEP_ANGLE = 0.4
"""rad turned in one Runge-Kutta step at most: the error over a turn is some 1e-4 rad, far below any panel's."""

MAX_STEPS = 400
"""Steps between two samples; 400 x 0.4 rad are 25 turns, more than sparse directions can tell."""

MOST_NUTATION = 800.0
"""rad that wheels may turn a rate round between two samples: at 2 rad a step the integration still holds."""

LOST_MOMENTUM = 1e6
"""In units of the mean moment times rad/s, where the motion of a trial overflows."""

DIFFERENCE = 1e-5
"""Step of the differences that give the answer of a step to its start, rad and (times the interval) rad/s."""


@dataclass(frozen=True)
class Body:
    """What moves: inertia (3, 3) in units of its mean moment, and `dipole` (3): angular acceleration dipole x field, in rad/s2 per
    unit of the field, zero where there is none; `errors` (m, 3, 3): changes of the inertia by one sigma of each of its errors."""

    inertia: np.ndarray
    dipole: np.ndarray
    spherical: bool
    errors: np.ndarray = field(default_factory=lambda: np.zeros((0, 3, 3)))
    acting: Acting = NOTHING
    unit: float = 1.0  # kg m2, the mean moment: torques are in N m

    @classmethod
    def of(
        cls,
        vehicle: Vehicle,
        dipole: npt.ArrayLike | None = None,
        torques_known: bool = False,
        acting: Acting = NOTHING,
    ) -> Body:
        """The body of a vehicle; a sphere where its inertia is not known, give or take much.

        `torques_known`: the acceleration noise is given, and stands for what the body is not a sphere too.
        """
        pull = np.zeros(3) if dipole is None else np.asarray(dipole, dtype=np.float64)
        if vehicle.inertia_kg_m2 is None and not acting.torques:
            return cls(np.eye(3), pull, True, unknown_errors()[: 0 if torques_known else None])
        unit = mean_moment(vehicle)
        return cls(
            np.array(vehicle.inertia_kg_m2) / unit,
            pull,
            False,
            inertia_errors(vehicle) / unit,
            acting,
            unit,
        )

    def swing(self) -> float:
        """rad/s at which torques swing the body to and fro, at most."""
        if not self.acting.torques:
            return 0.0
        bodies = Bodies.rigid(self.unit * self.inertia)
        least = self.unit * np.linalg.eigvalsh(self.inertia)[0]
        return float(np.sqrt(self.acting.largest(bodies) / max(least, 1e-300)))

    def seen(self, ends: Ends, attitude: np.ndarray, t_s: npt.ArrayLike) -> Ends:
        """`ends` with the nadir, if a torque depends on it, of steps that begin at B_from_N (..., 3, 3) and times (...)."""
        if not self.acting.needs_attitude:
            return ends
        t = np.broadcast_to(t_s, attitude.shape[:-2])
        nadir = self.acting.nadir_B(attitude.reshape(-1, 3, 3), t.ravel())
        return ends._replace(nadir=nadir.reshape(*t.shape, 6))


def mean_moment(vehicle: Vehicle) -> float:
    """Mean moment of inertia (kg m2): the unit of the smoother, which torque-free motion does not know."""
    return float(np.trace(vehicle.require_inertia())) / 3


class Ends(NamedTuple):
    """What acts on the body at the start and at the end of a step, (..., 3) each or None, in the body's axes of its moment:
    the magnetic field and the momentum of the wheels (mean moment of inertia times rad/s). Linear in between in the body,
    which for the field holds to a few percent up to 40 degrees of turn. For the gravity gradient: the nadir at the start and the
    rate at which it turns in space (..., 6); see :meth:`Body.seen`."""

    field: np.ndarray | None = None
    field_end: np.ndarray | None = None
    momentum: np.ndarray | None = None
    momentum_end: np.ndarray | None = None
    nadir: np.ndarray | None = None

    def spread(self) -> Ends:
        """With one more axis in front."""
        return Ends(*(None if part is None else part[None] for part in self))

    def turned(self, angles_B: np.ndarray) -> Ends:
        """For the body turned at the start by each of the rotation vectors (m, 3), with one more axis (m) in front."""
        spread = self.spread()
        if self.nadir is None:
            return spread
        matrices = rotate_attitude(np.eye(3), angles_B)
        parts = self.nadir.reshape(*self.nadir.shape[:-1], 2, 3)
        turned = np.einsum("mij,...aj->m...ai", matrices, parts)
        return spread._replace(nadir=turned.reshape(len(matrices), *self.nadir.shape))


FREE = Ends()
"""Nothing acts."""


def step(
    body: Body,
    omega: np.ndarray,
    dt: np.ndarray,
    ends: Ends = FREE,
    counts: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Relative attitude (..., 3, 3) and rate (..., 3) after `dt` (...) s, from rates `omega` (..., 3) rad/s.

    `counts` (...): steps to take, of :func:`steps_of` where they are not given.
    """
    spend(dt.size)
    if body.spherical:
        return _sphere(body, omega, np.asarray(dt), ends.field, ends.field_end)
    return _runge_kutta(
        body,
        omega,
        np.asarray(dt),
        ends,
        steps_of(body, omega, dt, ends) if counts is None else counts,
    )


def _sphere(
    body: Body,
    omega: np.ndarray,
    dt: np.ndarray,
    field: np.ndarray | None,
    field_end: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    """A sphere's rate is its integrated torque; its turn is Magnus' series to fourth order on two halves of the interval."""
    still = np.broadcast_to(np.eye(3), (*omega.shape, 3))
    size = dt[..., None]
    if field is None or field_end is None or not np.any(body.dipole):
        return rotate_attitude(still, omega * size), omega.copy()
    first, change = cross(body.dipole, field), cross(body.dipole, field_end - field)

    def rate(s: float) -> np.ndarray:
        return omega + size * (s * first + s**2 / 2 * change)

    matrix = still
    for start in (0.0, 0.5):
        a, b = (rate(start + 0.25 * (1 + sign / np.sqrt(3))) for sign in (-1, 1))
        half = size / 2
        matrix = rotate_attitude(
            matrix, half / 2 * (a + b) - np.sqrt(3) / 12 * half**2 * cross(b, a)
        )
    return matrix, rate(1.0)


def angle_turned(body: Body, omega: np.ndarray, dt: npt.ArrayLike, ends: Ends) -> np.ndarray:
    """rad (...) by which body and rate turn at most in intervals `dt` (...) that begin at rates `omega` (..., 3)."""
    wheels = [
        nutation(body, part) for part in (ends.momentum, ends.momentum_end) if part is not None
    ]
    swing = np.max(wheels, axis=0) if wheels else 0.0
    return (np.linalg.norm(omega, axis=-1) + swing + body.swing()) * np.abs(dt)


def steps_of(body: Body, omega: np.ndarray, dt: npt.ArrayLike, ends: Ends) -> np.ndarray:
    """Runge-Kutta steps (...) for intervals that begin at rates `omega` (..., 3)."""
    return np.clip(np.ceil(angle_turned(body, omega, dt, ends) / STEP_ANGLE), 2, MAX_STEPS).astype(
        np.int64
    )


def _runge_kutta(
    body: Body, omega: np.ndarray, dt: np.ndarray, ends: Ends, counts: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    shape = omega.shape[:-1]
    n = int(np.prod(shape))

    def flat(values: npt.ArrayLike | None, *size: int) -> np.ndarray:
        return np.broadcast_to(0.0 if values is None else values, (*shape, *size)).reshape(n, *size)

    held, held_end = flat(ends.momentum, 3), flat(ends.momentum_end, 3)
    no_field = (np.zeros((0, 3)),) * 2
    field = (
        no_field
        if ends.field is None or ends.field_end is None
        else (flat(ends.field, 3), flat(ends.field_end, 3))
    )
    start = [flat(omega @ body.inertia, 3) + held, flat((0.0, 0.0, 0.0, 1.0), 4)]
    if ends.nadir is not None:
        start.append(flat(ends.nadir, 6))
    rigid = Bodies.rigid(body.unit * body.inertia)
    numbers = BodyNumbers(
        body.inertia,
        body.dipole,
        body.acting.steady(rigid)[0] / body.unit,
        body.acting.gradient_strength(),
    )
    # no step is fine enough for some trials: they must cost much, not fail
    states = np.concatenate(start, axis=1)
    y = carry(states, flat(dt), flat(counts), Loads(held, held_end, *field), numbers)
    q = y[:, 3:7]
    lost = ~np.isfinite(y).all(axis=1) | ~np.any(q, axis=1)
    y[lost], q[lost] = LOST_MOMENTUM, (0.0, 0.0, 0.0, 1.0)
    p = g.Parameters(tuple(symmetric_inverse(body.inertia)), tuple(held_end.T), ())
    rate = np.stack(g.body_rate(y[:, :3].T, (), p), axis=-1)
    return matrix_from_quaternion(q).reshape(*omega.shape, 3), rate.reshape(omega.shape)


def load(body: Body) -> None:
    """Load what is compiled for a body, a quarter of a second, so that copies of this process have it."""
    if not body.spherical and not body.acting.torques:
        _runge_kutta(body, np.zeros((1, 3)), np.ones(1), FREE, np.ones(1, dtype=np.int64))


def nutation(body: Body, momentum: np.ndarray) -> np.ndarray:
    """rad/s (...) at which momenta (..., 3) of wheels turn a rate of the body round.

    Beside it, dw/dt = I^-1 (w x h), and the eigenvalues of I^-1 [h x] are 0 and +-i sqrt(h.I h / det I).
    """
    return np.sqrt(
        np.einsum("...i,ij,...j->...", momentum, body.inertia, momentum)
        / np.linalg.det(body.inertia)
    )


def require_followed(body: Body, momentum: np.ndarray, longest_s: float) -> None:
    """Refuse wheels whose momenta (n, 3) turn a rate of the body round too often in the longest interval (s) to be followed."""
    turned = float(np.max(nutation(body, np.nan_to_num(momentum)), initial=0.0)) * longest_s
    if not turned <= MOST_NUTATION:
        raise InputError(
            f"the wheels turn a rate of the body round by {turned:.3g} rad between two samples, more than can be followed",
            do="check the wheels' speeds and inertia and their units, or use samples closer together",
        )


def step_with_answer(
    body: Body, omega: np.ndarray, dt: np.ndarray, ends: Ends = FREE
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """:func:`step`, and its answer (..., 6, 6): turn and rate at the end for a turn and rate at the start, body axes."""
    size = np.asarray(dt)[..., None]
    shifts = np.concatenate([np.zeros((1, 3)), np.eye(3)]) * DIFFERENCE
    many = omega[None] + shifts.reshape(4, *(1,) * (omega.ndim - 1), 3) / size
    # the same for all, or their differences would be those of the steps
    counts = None if body.spherical else steps_of(body, omega, dt, ends)
    matrix, rate = step(body, many, np.broadcast_to(dt, many.shape[:-1]), ends.spread(), counts)
    answer = np.zeros((*omega.shape[:-1], 6, 6))
    answer[..., :3, :3] = matrix[0]  # a turn at the start is the same turn in the axes of the end
    answer[..., :3, 3:] = np.moveaxis(
        rotation_between(matrix[0], matrix[1:]) * size / DIFFERENCE, 0, -1
    )
    answer[..., 3:, 3:] = np.moveaxis((rate[1:] - rate[0]) * size / DIFFERENCE, 0, -1)
    if ends.nadir is not None:
        _add_turns(answer, body, omega, dt, ends, counts, matrix[0], rate[0])
    return matrix[0], rate[0], answer


def _add_turns(
    answer: np.ndarray,
    body: Body,
    omega: np.ndarray,
    dt: np.ndarray,
    ends: Ends,
    counts: np.ndarray | None,
    matrix: np.ndarray,
    rate: np.ndarray,
) -> None:
    """Into an answer (..., 6, 6): what a turn at the start does besides, where torques depend on directions in space."""
    small = DIFFERENCE * np.eye(3)
    many = np.broadcast_to(omega, (3, *omega.shape))
    ended, rates = step(
        body, many, np.broadcast_to(dt, many.shape[:-1]), ends.turned(small), counts
    )
    for k in range(3):
        answer[..., :3, k] = (
            rotation_between(matrix, ended[k] @ rotate_attitude(np.eye(3), small[k])) / DIFFERENCE
        )
        answer[..., 3:, k] = (rates[k] - rate) / DIFFERENCE
