"""Least-squares fits of motions to readings: attitude and rate at every sample are unknown (multiple shooting).

The cost J of docs/rates.md ("What is minimised") has three parts: readings (:func:`readings`), equations of motion
(:func:`defects`), and the prior of the unknowns and of the rate at the first sample. :func:`equations` adds them. The normal
equations are a chain of 6 x 6 blocks with a border for the unknowns that are constant in a pass, so a Gauss-Newton step takes a
time linear in the number of samples. Each interval starts from its own state, so that errors of a poor start do not grow along the
pass.

Attitudes are B_from_N, where z of N points to the Sun. A state changes by six numbers: a turn (rotation vector in body axes, rad)
and a change of the rate (rad/s). In shapes and einsum strings k is a motion, n a sample or interval, i and j one of the six
numbers, r a reading, m an unknown.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sunspin.estimate.carry import RATE, TURN, Step, step
from sunspin.estimate.copies import distinct
from sunspin.estimate.model import Model, Noise, Observations, States, Track
from sunspin.estimate.settings import SearchSettings
from sunspin.estimate.terms.inertial import Latency
from sunspin.estimate.terms.term import Residual, Term, at_sample_before
from sunspin.solve.least_squares import TOLERANCE, least_squares, limit_length
from sunspin.solve.linear import (
    BorderedSystem,
    DenseSystem,
    invert_bordered,
    solve_bordered,
    solve_dense,
)
from sunspin.solve.rotations import rotate_attitude, rotation_between

SUN_TURN_SIGMA = 10.0
"""rad; prior sigma of the turn about the Sun direction. Nothing measures that turn, and so wide a prior only keeps it finite."""

DIFFERENCE_RAD = 1e-5
"""Turn by which an attitude is changed for the derivative of a torque."""

LEAST_DEFECT_RAD = 1e-6
"""Sigma of the attitude after an interval that is added to that by torques. Without it the equations of motion would fix the turn
between two samples a millisecond apart to 1e-10 rad: a fit lost all digits, and the motion of a file was 6 sigma off."""

RATE_LIMIT = 4.0
"""Largest trial rate, in sigmas of the prior: a step far out of the basin must not overflow."""


@dataclass(frozen=True)
class Fit:
    """K motions fitted under a model.

    `log_evidence` (K): log of the integral of the posterior density around each, by Laplace's method. `u_covariance` (K, m, m): of
    the unknowns, in their prior sigmas; `states_by_u` (K, n, 6, m): change of turn and rate at the samples by one sigma of each
    unknown. `lowest`: the motions of least cost, if `motions` are averages over several prior sigmas (`evidence.sum_over_shares`).
    """

    model: Model
    motions: Track
    log_evidence: np.ndarray
    u_covariance: np.ndarray
    states_by_u: np.ndarray
    lowest: Track | None = None

    def __len__(self) -> int:
        """Return the number of motions."""
        return len(self.log_evidence)

    def take(self, which: np.ndarray | slice) -> Fit:
        """Return the fits of some of the motions, by index or slice."""
        return Fit(
            model=self.model,
            motions=self.motions.take(which),
            log_evidence=self.log_evidence[which],
            u_covariance=self.u_covariance[which],
            states_by_u=self.states_by_u[which],
            lowest=None if self.lowest is None else self.lowest.take(which),
        )

    @property
    def to_begin_from(self) -> Track:
        """Return the motions from which another fit begins: averages over sigmas of a torque violate the equations of motion."""
        return self.motions if self.lowest is None else self.lowest


def whitening(noise: Noise, dt: np.ndarray) -> tuple[np.ndarray, float]:
    """Return matrices W (n, 6, 6) that scale the defects of turn and rate in intervals dt (n), s, to unit covariance.

    Also return half the sum of the logs of the determinants of all covariances.

    White angular acceleration q makes the covariance q^2 (dt^3 / 3, dt^2 / 2; dt^2 / 2, dt) of turn and rate about each axis. White
    noise r of the rate (`Noise.rate`) adds r^2 dt to the variance of the turn. W is the inverse of the Cholesky factor.
    """
    q_square = noise.in_intervals(dt) ** 2
    turn_alone = noise.rate**2 * dt + LEAST_DEFECT_RAD**2
    # The Cholesky factor (a, 0; b, c) of the covariance about one axis has the inverse (1 / a, 0; -b / (a c), 1 / c). Here c^2 =
    # q^2 dt - b^2, without the difference of two nearly equal numbers.
    a = np.sqrt(q_square * dt**3 / 3 + turn_alone)
    b = q_square * dt**2 / 2 / a
    c = np.sqrt(q_square * dt * (q_square * dt**3 / 12 + turn_alone)) / a
    matrix = np.zeros((len(dt), 6, 6))
    for axis in range(3):
        matrix[:, axis, axis] = 1 / a
        matrix[:, axis + 3, axis] = -b / (a * c)
        matrix[:, axis + 3, axis + 3] = 1 / c
    return matrix, float(3 * (np.log(a) + np.log(c)).sum())


class NormalEquations:
    """The normal equations of K motions at n samples with m unknowns, to which residuals are added one after the other.

    A residual r with the derivative A and the weight w adds w A^T A to the matrix, and w A^T r to the gradient. The matrix has
    blocks of turn and rate at each sample, `diagonal` (K, n, 6, 6), and between neighbours, `upper` (K, n - 1, 6, 6). The unknowns
    add a `border` (K, n, 6, m) and a `corner` (K, m, m). The gradient is `slope` (K, n, 6) by the states and `border_slope` (K, m).
    `cost` (K), matrix and gradient begin with the prior |u|^2 / 2 of the unknowns u, which are in sigmas.
    """

    def __init__(self, motions: Track) -> None:
        k, n = motions.omega.shape[:2]
        m = motions.u.shape[1]
        self.cost = (motions.u**2).sum(axis=1) / 2
        self.diagonal, self.slope = np.zeros((k, n, 6, 6)), np.zeros((k, n, 6))
        self.upper = np.zeros((k, n - 1, 6, 6))
        self.border, self.border_slope = np.zeros((k, n, 6, m)), motions.u.copy()
        self.corner = np.repeat(np.eye(m)[None], k, axis=0)

    def add_readings(self, residual: Residual, unknowns: np.ndarray) -> None:
        """Add the predictions less readings (K, n, r) of one sensor, with cost and weights by their law of errors.

        `unknowns` (m): indices of the term's unknowns among all unknowns of the model; `residual.by_u` is the derivative by them.
        """
        cost, weight = residual.law(residual.value)
        self.cost += cost.sum(axis=1)
        # as stacks of matrices, for products: values (K, n, r, 1) and weights (K, n, 1, 1)
        value, weight = residual.value[..., None], weight[..., None, None]
        by_u = residual.by_u
        # for turn and rate at the sample: their slice of the state, the derivative A (K, n, r, 3), and w A^T (K, n, 3, r)
        by_state = [
            (rows, derivative, _transposed(weight * derivative))
            for rows, derivative in ((TURN, residual.by_turn), (RATE, residual.by_rate))
            if derivative is not None
        ]
        for rows, _, weighted in by_state:
            self.slope[..., rows] += (weighted @ value)[..., 0]
            for columns, derivative, _ in by_state:
                self.diagonal[..., rows, columns] += weighted @ derivative
            if by_u is not None:
                self.border[..., rows, unknowns] += weighted @ by_u
        if residual.by_previous is not None:
            # a reading that is compared with the one before couples both samples; the first sample has none before
            previous = residual.by_previous[:, 1:]
            weighted = _transposed(weight[:, 1:] * previous)
            self.slope[:, :-1, TURN] += (weighted @ value[:, 1:])[..., 0]
            self.diagonal[:, :-1, TURN, TURN] += weighted @ previous
            for columns, derivative, _ in by_state:
                self.upper[..., TURN, columns] += weighted @ derivative[:, 1:]
            if by_u is not None:
                self.border[:, :-1, TURN, unknowns] += weighted @ by_u[:, 1:]
        if by_u is not None:
            weighted = _transposed(weight * by_u)
            self.corner[:, unknowns[:, None], unknowns] += (weighted @ by_u).sum(axis=1)
            self.border_slope[:, unknowns] += (weighted @ value).sum(axis=1)[..., 0]

    def add_defects(self, defect: Defects) -> None:
        """Add the deviations from the equations of motion in all intervals: normally distributed, so all weights are one."""
        _, first, second, by_u = defect
        value = defect.value[..., None]
        first_T, second_T = _transposed(first), _transposed(second)
        self.cost += np.einsum("kni,kni->k", defect.value, defect.value) / 2
        # an interval couples the sample where it begins (first) with the one where it ends (second)
        self.diagonal[:, :-1] += first_T @ first
        self.diagonal[:, 1:] += second_T @ second
        self.upper += first_T @ second
        self.slope[:, :-1] += (first_T @ value)[..., 0]
        self.slope[:, 1:] += (second_T @ value)[..., 0]
        if self.border_slope.shape[1]:
            by_u_T = _transposed(by_u)
            self.border[:, :-1] += first_T @ by_u
            self.border[:, 1:] += second_T @ by_u
            self.corner += (by_u_T @ by_u).sum(axis=1)
            self.border_slope += (by_u_T @ value).sum(axis=1)[..., 0]


def _transposed(matrices: np.ndarray) -> np.ndarray:
    """Return the transposed matrices (..., j, i) of matrices (..., i, j)."""
    return np.swapaxes(matrices, -1, -2)


def equations(model: Model, motions: Track) -> BorderedSystem:
    """Return the cost J of motions under a model, and its normal equations.

    The parts are added in this order: prior of the unknowns, readings, equations of motion, prior of the rate at the first sample.
    """
    system = NormalEquations(motions)  # with the prior of the unknowns
    for residual, unknowns in readings(model, motions):
        system.add_readings(residual, unknowns)
    # The damping is scaled by the readings alone, before defects are added. Defects between close samples add huge numbers to the
    # matrix. A damping of their size would hold a whole motion in its place.
    damping = _damping_scale(system.diagonal, model.obs.t_s)
    system.add_defects(defects(model, motions))

    # The prior of the turn about the Sun goes into the matrix alone, which it makes invertible. It prefers no turn: no gradient.
    system.diagonal[:, 0, TURN, TURN] += _sun_turn_prior(model.obs, motions.sun_B[:, 0])
    # the prior of the rate at the first sample
    system.diagonal[:, 0, RATE, RATE] += np.eye(3) / model.rate_sigma**2
    system.slope[:, 0, RATE] += motions.omega[:, 0] / model.rate_sigma**2
    system.cost += (motions.omega[:, 0] ** 2).sum(axis=1) / (2 * model.rate_sigma**2)
    has_unknowns = motions.u.shape[1] > 0
    shared = (system.border, system.corner, system.border_slope) if has_unknowns else (None,) * 3
    return BorderedSystem(
        system.cost, system.diagonal, system.upper, system.slope, damping, *shared
    )


def readings(model: Model, motions: Track) -> Iterator[tuple[Residual, np.ndarray]]:
    """Yield the predictions less readings of each term, and the indices (m) of its unknowns among those of the model.

    The readings of sensors other than the Sun's may be older than their sample. They are compared with the motion at the earlier
    instant, but derivatives are by the states at the samples. If this latency is estimated, it is one more unknown of each sensor.
    """
    indices, earlier = np.arange(len(model.unknowns)), earlier_states(model, model.obs, motions)
    for term, u_slice in model.terms_with_slices:
        u = motions.u[:, u_slice]
        if earlier is None or term.of_sun:
            for residual in term.residuals(motions, u):
                yield residual, indices[u_slice]
            continue
        for residual in term.residuals(earlier.states, u):
            at_sample, by_latency = earlier.derivatives_at_sample(residual)
            if earlier.index is None:  # the latency is known exactly
                yield at_sample, indices[u_slice]
                continue
            by_u = earlier.sigma_s * by_latency[..., None]  # by one sigma of the latency
            if at_sample.by_u is not None:
                by_u = np.concatenate([at_sample.by_u, by_u], axis=-1)
            yield at_sample._replace(by_u=by_u), np.append(indices[u_slice], earlier.index)


class Earlier(NamedTuple):
    """K motions as they were `late_s` (K), s, before their samples, when the sensors other than the Sun's were read.

    `sigma_s`: prior sigma of that latency; `index`: of the latency among the unknowns of the model, None if it is known exactly.
    `states`: attitude and rate then; `turned` (K, n, 3, 3): rotation matrix since the sample, backward in time; `acceleration`
    (K, n, 3) then, rad/s2.
    """

    late_s: np.ndarray
    sigma_s: float
    index: int | None
    states: States
    turned: np.ndarray
    acceleration: np.ndarray

    def derivatives_at_sample(self, residual: Residual) -> tuple[Residual, np.ndarray]:
        """Return `residual`, of the earlier states, with derivatives by the states at the samples; and that by the latency.

        The second result (K, n, r) is in 1/s. The chain rule takes three derivatives of the earlier state, to first order in the
        latency T. A turn at the sample turns the earlier body too, by `turned` times it in the axes of then. A change of the rate
        at the sample changes the earlier rate as much, and turns the earlier body by -T times it. A latency that is longer by dT
        turns the earlier body by -omega dT, and changes its rate by -acceleration dT.
        """
        by_latency = np.zeros(residual.value.shape)
        by_turn, by_rate, previous = residual.by_turn, residual.by_rate, residual.by_previous
        if by_rate is not None:
            by_latency -= np.einsum("knri,kni->knr", by_rate, self.acceleration)
        if by_turn is not None:
            by_latency -= np.einsum("knri,kni->knr", by_turn, self.states.omega)
            # Not for a term that compares neighbours: their rates change alike and turn both alike, and their difference stays.
            if previous is None:
                by_moved = -self.late_s[:, None, None, None] * by_turn
                by_rate = by_moved if by_rate is None else by_rate + by_moved
            by_turn = by_turn @ self.turned
        if previous is not None:
            omega_before = self.states.omega[:, :-1]
            by_latency[:, 1:] -= np.einsum("knri,kni->knr", previous[:, 1:], omega_before)
            previous = previous @ at_sample_before(self.turned, axis=1)
        at_sample = residual._replace(by_turn=by_turn, by_rate=by_rate, by_previous=previous)
        return at_sample, by_latency


def earlier_states(model: Model, obs: Observations, motions: Track) -> Earlier | None:
    """Return motions propagated back to the instants at which the sensors other than the Sun's were read.

    The momentum of the wheels is taken as that at the sample. Return None if these sensors are read together with the Sun. `obs`:
    the samples at which the motions are given.
    """
    clock = model.obs.of_kind(Latency)
    if clock is None or not (clock.late_s or clock.sigma_s):
        return None
    # of the latency among the unknowns
    index = model.term_slices[model.obs.terms.index(clock)].start if clock.sigma_s else None
    error_s = 0.0 if index is None else clock.sigma_s * motions.u[:, index]
    late_s = clock.late_s + error_s + np.zeros(len(motions))
    momentum = obs.momentum
    inertia = model.body.inertia_at(motions.u[:, model.inertia_slice])
    back = np.broadcast_to(-late_s[:, None], motions.omega.shape[:2])
    stepped = step(inertia, motions.omega, back, (momentum, momentum))
    # Euler's equations: I dw/dt = (I w + h) x w; vectors are rows, and the inertia is symmetric
    torque = np.cross(stepped.omega @ inertia + momentum, stepped.omega)
    acceleration = torque @ np.linalg.inv(inertia)
    states = States(stepped.turned @ motions.attitude, stepped.omega)
    return Earlier(late_s, clock.sigma_s, index, states, stepped.turned, acceleration)


class Defects(NamedTuple):
    """Deviations of K motions from the equations of motion in n - 1 intervals, in sigmas of unknown torques (:func:`whitening`).

    `value` (K, n - 1, 6): turn and rate at the end of each interval less those propagated from its start. Derivatives: `by_first`
    and `by_second` (K, n - 1, 6, 6) by turn and rate at start and end, `by_u` (K, n - 1, 6, m) by the unknowns. `by_second` is the
    whitening itself: the derivative of the defect in rad and rad/s is taken as one. That is exact without a defect, and defects are
    small where a fit ends.
    """

    value: np.ndarray
    by_first: np.ndarray
    by_second: np.ndarray
    by_u: np.ndarray

    def unwhitened(self, value: np.ndarray) -> np.ndarray:
        """Return values (K, n - 1, 6), given in sigmas, as turns in rad and changes of the rate in rad/s."""
        return np.linalg.solve(self.by_second, value[..., None])[..., 0]


def defects(model: Model, motions: Track) -> Defects:
    """Return by how much motions deviate from the equations of motion between neighbouring samples, with derivatives.

    Torques that the terms of the model describe belong to the equations of motion.
    """
    body, dt = model.body, np.diff(model.obs.t_s)
    momenta = model.obs.momentum[:-1], model.obs.momentum[1:]
    inertia = body.inertia_at(motions.u[:, model.inertia_slice])
    rates = motions.omega[:, :-1]
    stepped = step(inertia, rates, dt, momenta, derivatives=True, errors=body.errors)
    relative = motions.attitude[:, 1:] @ np.swapaxes(motions.attitude[:, :-1], -1, -2)
    value = np.concatenate(
        [rotation_between(stepped.turned, relative), motions.omega[:, 1:] - stepped.omega], axis=-1
    )
    assert stepped.by_start is not None and stepped.by_inertia is not None
    by_start, by_u = stepped.by_start, np.zeros((*value.shape, motions.u.shape[1]))
    by_u[..., model.inertia_slice] = stepped.by_inertia
    for term, u_slice in model.terms_with_slices:
        by_unknowns = term.added_by_unknowns(motions, dt)
        if by_unknowns is not None:
            # it depends on the states, too: `by_start` leaves that out
            by_u[..., u_slice] = by_unknowns
            value = value - np.einsum("knim,km->kni", by_unknowns, motions.u[:, u_slice])
        known = term.added_by_torque(motions, dt)
        if known is not None:
            value = value - known
            if term.about_sun:  # a torque that is known in space depends on the attitude
                by_start[..., TURN] += _torque_by_turn(term, motions, dt, known)
    white, _ = whitening(model.noise, dt)
    by_second = np.broadcast_to(white, (len(value), *white.shape))
    return Defects((white @ value[..., None])[..., 0], -white @ by_start, by_second, -white @ by_u)


def _torque_by_turn(term: Term, motions: Track, dt: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return the derivative (K, n - 1, 6, 3) of what a known torque adds by a turn of the body, as a difference quotient.

    `known` (K, n - 1, 6): turn (rad) and rate (rad/s) that it adds to the motions in each interval dt.
    """
    columns = [
        term.added_by_torque(replace(motions, attitude=rotate_attitude(motions.attitude, turn)), dt)
        - known
        for turn in DIFFERENCE_RAD * np.eye(3)
    ]
    return np.stack(columns, axis=-1) / DIFFERENCE_RAD


def _damping_scale(of_readings: np.ndarray, t_s: np.ndarray) -> np.ndarray:
    """Return the scale (K, 6) of the damping of turn and rate, from the normal matrices (K, n, 6, 6) of the readings.

    It is the mean of their diagonals over samples and axes. A rate is also determined through the turn that it makes until the
    next sample, in the mean interval.
    """
    size = np.einsum("knii->kni", of_readings).mean(axis=1)
    turn = size[:, TURN].mean(axis=1, keepdims=True)
    interval_s = np.diff(t_s).mean() if len(t_s) > 1 else 1.0
    rate = size[:, RATE].mean(axis=1, keepdims=True) + turn * interval_s**2
    return np.repeat(np.concatenate([turn, rate], axis=1), 3, axis=1)


def _sun_turn_prior(obs: Observations, sun_B: np.ndarray) -> np.ndarray:
    """Return the inverse prior covariance (K, 3, 3) of a turn about the Sun direction (K, 3); without a Sun, about any axis."""
    if not any(term.of_sun for term in obs.terms):
        return np.tile(np.eye(3) / SUN_TURN_SIGMA**2, (len(sun_B), 1, 1))
    return sun_B[:, :, None] * sun_B[:, None, :] / SUN_TURN_SIGMA**2


def fit(
    model: Model,
    motions: Track,
    steps: int,
    tolerance: float = TOLERANCE,
    along_equations: bool = False,
) -> Fit:
    """Return motions (K) fitted in at most `steps` steps of Levenberg and Marquardt's method, with their evidence.

    The states at all samples and the unknowns are fitted. Unknowns that `motions` lack, because their term was added last, begin at
    their centres. `tolerance`: predicted gain in cost below which a fit ends. `along_equations`: steps follow the equations of
    motion (:func:`bent_step`) instead of straight lines.
    """
    limits = np.array([unknown.limit for unknown in model.unknowns])
    largest_rate = RATE_LIMIT * model.rate_sigma

    def move(state: tuple[np.ndarray, ...], change: tuple[np.ndarray, np.ndarray | None]):
        """Return attitudes, rates and unknowns after a step of the states (K, n, 6) and of the unknowns (K, m)."""
        attitude, omega, u = state
        of_states, of_unknowns = change
        u = u if of_unknowns is None else np.clip(u + of_unknowns, -limits, limits)
        u[:, model.inertia_slice] = model.body.possible_errors(u[:, model.inertia_slice])
        if along_equations:
            bent = bent_step(model, Track(*state), of_states, u)
            attitude, omega = bent.attitude, bent.omega
        else:
            attitude = rotate_attitude(attitude, of_states[..., TURN])
            omega = omega + of_states[..., RATE]
        return attitude, limit_length(omega, largest_rate), u

    u = np.zeros((len(motions), len(model.unknowns)))
    u[:, : motions.u.shape[1]] = motions.u[:, : u.shape[1]]
    solution = least_squares(
        lambda state: equations(model, Track(*state)),
        move,
        solve_bordered,
        (motions.attitude, motions.omega, u),
        steps=steps,
        tolerance=tolerance,
    )
    system, inverse = solution.system, invert_bordered(solution.system)
    fitted = Track(*solution.state, system.cost, inverse.nodes)
    # Laplace's method: log(prior) - J - log(det H) / 2, less the sum of log(det Sigma) / 2, as the defects' prior is normalised.
    # What all models of a pass share is left out: see `log_left_out`.
    half_log_det = inverse.log_determinant / 2
    _, log_width_of_torques = whitening(model.noise, np.diff(model.obs.t_s))
    log_evidence = model.log_prior - system.cost - half_log_det - log_width_of_torques
    # A fit that did not reach a minimum may have no determinant, or negative variances by rounding: then it has no evidence.
    valid = np.isfinite(log_evidence) & (np.einsum("knii->kni", inverse.nodes) > 0).all(axis=(1, 2))
    log_evidence = np.where(valid, log_evidence, -np.inf)
    return Fit(model, fitted, log_evidence, inverse.border, inverse.sensitivity)


def bent_step(model: Model, motions: Track, change: np.ndarray, u: np.ndarray) -> Track:
    """Return motions after a step along the equations of motion: `change` (K, n, 6) of turns and rates, new unknowns u (K, m).

    A straight step adds `change` to all states. They then violate the equations of motion, which are not linear. Under weak torques
    such defects cost much, so only short straight steps along a valley of inertia and rates are accepted. Here only the state of
    the middle sample is changed. The others follow by the equations of motion and the defect that linear theory predicts at the end
    of each interval. This is the step of a lifted Newton method (Albersmeyer and Diehl 2010, SIAM J. Optim. 20, 1655).
    """
    obs, dt = model.obs, np.diff(model.obs.t_s)
    defect = defects(model, motions)
    # (K, n - 1, 6) defects after the step by linear theory, in sigmas
    predicted = defect.value + np.einsum("knij,knj->kni", defect.by_first, change[:, :-1])
    predicted += np.einsum("knij,knj->kni", defect.by_second, change[:, 1:])
    predicted += np.einsum("knim,km->kni", defect.by_u, u - motions.u)
    # turn and rate that are added to a torque-free motion at the end of each interval: the predicted defect, and what torques add
    added = defect.unwhitened(predicted)
    for term, u_slice in model.terms_with_slices:
        by_unknowns, known = term.added_by_unknowns(motions, dt), term.added_by_torque(motions, dt)
        if by_unknowns is not None:
            added += np.einsum("knim,km->kni", by_unknowns, u[:, u_slice])
        if known is not None:
            added += known

    inertia = model.body.inertia_at(u[:, model.inertia_slice])
    # after a straight step; below, all states but that of the middle sample are replaced
    attitude = rotate_attitude(motions.attitude, change[..., TURN])
    omega = motions.omega + change[..., RATE]
    middle, last = len(obs) // 2, len(obs) - 1
    for start in range(middle, last):
        end = start + 1
        stepped = _step_between(obs, inertia, omega[:, [start]], [start], [end])
        torque_free = stepped.turned[:, 0] @ attitude[:, start]
        attitude[:, end] = rotate_attitude(torque_free, added[:, start, TURN])
        omega[:, end] = stepped.omega[:, 0] + added[:, start, RATE]
    for later in range(middle, 0, -1):
        # backward over the interval that has the index of its first sample; first, what is added at its end is subtracted
        earlier = later - 1
        attitude_before = rotate_attitude(attitude[:, later], -added[:, earlier, TURN])
        omega_before = omega[:, [later]] - added[:, [earlier], RATE]
        stepped = _step_between(obs, inertia, omega_before, [later], [earlier])
        attitude[:, earlier] = stepped.turned[:, 0] @ attitude_before
        omega[:, earlier] = stepped.omega[:, 0]
    return Track(attitude, omega, u)


def log_left_out(model: Model) -> float:
    """Return by how much the log evidence of a fit exceeds the log of the mean likelihood over all motions that its model allows.

    It is the same for all models of a pass that sees the Sun. Prior densities of the first rate, of the defects and of the unknowns
    are normal, with 6 n + m - 3 factors 1 / sqrt(2 pi). That of the first attitude is 1 / (8 pi^2). Laplace's method gives
    sqrt(2 pi) for each of the 6 n + m numbers. Nothing measures the turn about the Sun: its integral is 2 pi, but counts as
    sqrt(2 pi) `SUN_TURN_SIGMA`. With the width of the prior of the rate, the product of all these factors is
    1 / (2 `SUN_TURN_SIGMA` `rate_sigma`^3).
    """
    return float(np.log(2 * SUN_TURN_SIGMA) + 3 * np.log(model.rate_sigma))


def variance_of(fitted: Fit, weights: np.ndarray) -> np.ndarray:
    """Return the variances (K, c) of c linear combinations of the turns (rad) and rates (rad/s) at all samples.

    `weights` (K, n, c, 6): weight of each number of each state. The variance for fixed unknowns is w^T H^-1 w, where H is the
    matrix of the undamped normal equations of the states. The covariance of the unknowns adds the other part.
    """
    # without border: the equations of the states for fixed unknowns
    system = equations(fitted.model, fitted.motions)._replace(
        border=None, corner=None, border_slope=None
    )
    undamped, variances = np.zeros(len(fitted)), []
    for number in range(weights.shape[2]):
        w = weights[..., number, :]
        # a step is -H^-1 slope, here H^-1 w
        (inverse_times_w, _), _ = solve_bordered(system._replace(slope=-w), undamped)
        variances.append(np.einsum("kni,kni->k", w, inverse_times_w))
    # the combinations change by B u with the unknowns u, whose covariance C adds B C B^T (p counts unknowns a second time)
    by_u = np.einsum("knci,knim->kcm", weights, fitted.states_by_u)
    of_u = np.einsum("kcm,kmp,kcp->kc", by_u, fitted.u_covariance, by_u)
    return np.maximum(np.stack(variances, axis=1), 0.0) + of_u


def propagate(model: Model, sample: int, attitude: np.ndarray, omega: np.ndarray) -> Track:
    """Return, at all samples, the motions without unknowns that have these attitudes (K, 3, 3) and rates (K, 3) at one `sample`."""
    k, n = len(omega), len(model.obs)
    motions = Track.unfitted(np.empty((k, n, 3, 3)), np.empty((k, n, 3)))
    motions.attitude[:, sample], motions.omega[:, sample] = attitude, omega
    _propagate_outward(model, motions, sample, sample)
    return motions


def _propagate_outward(
    model: Model, motions: Track, first: int, last: int, by_state: np.ndarray | None = None
) -> None:
    """Fill in motions (K) at all samples by propagation from those of the samples `first` to `last`, where they are given.

    `by_state` (K, n, 6, 6): derivatives of the motions by turn and rate at one sample, given at the same samples and filled in at
    the others by the chain rule.
    """
    attitude, omega = motions.attitude, motions.omega
    n, inertia = omega.shape[1], model.body.inertia
    for k in range(max(first, n - 1 - last)):
        # One step forward and one backward together, while both lie in the pass: two intervals take nearly as long as one.
        steps = (last + k, last + k + 1), (first - k, first - k - 1)
        start, end = map(list, zip(*((i, j) for i, j in steps if 0 <= j < n), strict=True))
        derivatives = by_state is not None
        stepped = _step_between(model.obs, inertia, omega[:, start], start, end, derivatives)
        attitude[:, end] = stepped.turned @ attitude[:, start]
        omega[:, end] = stepped.omega
        if by_state is not None and stepped.by_start is not None:
            by_state[:, end] = stepped.by_start @ by_state[:, start]


def _step_between(
    obs: Observations,
    inertia: np.ndarray,
    omega: np.ndarray,
    start: list[int],
    end: list[int],
    derivatives: bool = False,
) -> Step:
    """Propagate K motions from each sample of `start` to that of `end` at the same place, later or earlier.

    `omega` (K, len(start), 3): rates at `start`, rad/s, B. `inertia`, in mean moments: (3, 3) of all motions, or (K, 3, 3) of each.
    `derivatives`: whether to return those by turn and rate at the start too.
    """
    momenta = obs.momentum[start], obs.momentum[end]
    return step(inertia, omega, obs.t_s[end] - obs.t_s[start], momenta, derivatives)


def fit_single_shooting(model: Model, sample: int, motions: Track, steps: int) -> Track:
    """Fit K motions by their attitude and rate at one `sample`, in at most `steps` steps, and return them at all samples.

    The states at the other samples follow by the equations of motion (single shooting). So a step changes six numbers and may be
    long. A multiple-shooting fit changes the states of all samples linearly, which violates the equations of motion; so its steps
    must be short if samples are close together. The model has no unknowns. The fit begins at the states of `motions` at the sample.
    """
    n = len(model.obs)
    largest_rate = RATE_LIMIT * model.rate_sigma

    def linearise(state: tuple[np.ndarray, np.ndarray]) -> DenseSystem:
        """Return cost and normal equations (K, 6, 6) of readings and priors for attitudes (K, 3, 3), rates (K, 3) at the sample."""
        omega = state[1]
        k = len(omega)
        # motions at all samples, and their derivatives by turn and rate at the sample
        track = Track.unfitted(np.empty((k, n, 3, 3)), np.empty((k, n, 3)))
        by_state = np.empty((k, n, 6, 6))
        track.attitude[:, sample], track.omega[:, sample] = state
        by_state[:, sample] = np.eye(6)
        _propagate_outward(model, track, sample, sample, by_state)
        previous_by_state = at_sample_before(by_state, axis=1)
        matrix, slope, cost = np.zeros((k, 6, 6)), np.zeros((k, 6)), np.zeros(k)
        for term in model.obs.terms:
            for residual in term.residuals(track, track.u):
                cost_of_samples, weight = residual.law(residual.value)
                cost += cost_of_samples.sum(axis=1)
                # chain rule: derivative by turn and rate at each sample, times the derivative of these by the six numbers
                derivative = sum(
                    by_sample @ sample_by_state[..., rows, :]
                    for by_sample, sample_by_state, rows in (
                        (residual.by_turn, by_state, TURN),
                        (residual.by_rate, by_state, RATE),
                        (residual.by_previous, previous_by_state, TURN),
                    )
                    if by_sample is not None
                )
                weighted = _transposed(weight[..., None, None] * derivative)
                matrix += (weighted @ derivative).sum(axis=1)
                slope += (weighted @ residual.value[..., None]).sum(axis=1)[..., 0]
        matrix[:, TURN, TURN] += _sun_turn_prior(model.obs, track.sun_B[:, sample])
        matrix[:, RATE, RATE] += np.eye(3) / model.rate_sigma**2
        slope[:, RATE] += omega / model.rate_sigma**2
        cost += (omega**2).sum(axis=1) / (2 * model.rate_sigma**2)
        return DenseSystem(cost, matrix, slope, extras=(track.attitude, track.omega))

    solution = least_squares(
        linearise,
        lambda state, change: (
            rotate_attitude(state[0], change[:, TURN]),
            limit_length(state[1] + change[:, RATE], largest_rate),
        ),
        solve_dense,
        (motions.attitude[:, sample], motions.omega[:, sample]),
        steps=steps,
    )
    return replace(Track.unfitted(*solution.system.extras), cost=solution.system.cost)


def costs(obs: Observations, motions: Track) -> np.ndarray:
    """Return the cost of the readings at each sample (K, n), minus their log density, of motions without unknowns."""
    total = np.zeros(motions.omega.shape[:2])
    for term in obs.terms:
        for residual in term.residuals(motions, motions.u):
            total += residual.law(residual.value)[0]
    return total


class Chain:
    """How a search fits, compares and propagates motions under its model (:class:`search.Carrier`).

    Windows are slices of the n samples; motions of a window are given at its samples.
    """

    def __init__(self, model: Model, settings: SearchSettings) -> None:
        self.model, self.s, self.t_s = model, settings, model.obs.t_s

    def cost_limit(self, window: slice) -> float:
        """Return the cost that a true motion does not exceed in a window."""
        return self.model.obs.take(window).cost_limit

    def joined(self, motions: list[Track]) -> Track:
        """Return the motions of several searches as one track."""
        return Track.joined(motions)

    def fit(self, motions: Track, window: slice) -> Track:
        """Return motions fitted to a window."""
        return fit(self.model.seeing(window), motions, steps=self.s.steps).motions

    def kept(self, motions: Track, window: slice) -> Track:
        """Return motions without duplicates and without improbable ones, best first."""
        return motions.take(distinct(motions, self.t_s[window], self.s))

    def widened(self, motions: Track, window: slice, wider: slice) -> Track:
        """Return the motions of a window propagated to a wider one, and further ones along the weakly constrained rate."""
        model = self.model.seeing(wider)
        first, last = window.start - wider.start, window.stop - wider.start
        n, k = wider.stop - wider.start, len(motions)
        propagated = Track.unfitted(np.empty((k, n, 3, 3)), np.empty((k, n, 3)))
        propagated.attitude[:, first:last] = motions.attitude
        propagated.omega[:, first:last] = motions.omega
        _propagate_outward(model, propagated, first, last - 1)
        middle = (window.stop - window.start) // 2
        further = along_the_valley(self.model.seeing(window), motions, middle, self.s)
        return Track.joined([propagated, propagate(model, first + middle, *further)])


def along_the_valley(
    model: Model, motions: Track, middle: int, s: SearchSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Return further trial attitudes (N, 3, 3) and rates (N, 3) at the sample `middle`, on either side of fitted motions (K).

    They differ from these in the rate along its least certain direction. A few samples of the Sun hardly determine the rate about
    the Sun direction: the cost has a long flat valley, in which a fit ends anywhere. As the window grows, the valley bends and
    breaks into several minima, and a motion ends in the nearest of them: a slow body was lost so. Here the valley is sampled as
    densely as a fit moves. Motions that do not fit get no further ones, since their covariance is wrong, nor do those far from the
    best.
    """
    limit = s.valley_fits * model.obs.cost_limit
    limit = min(limit, motions.cost.min(initial=np.inf) + s.valley_leading)
    motions = motions.take(np.flatnonzero(motions.cost < limit))
    covariance = np.nan_to_num(motions.covariance[:, middle])
    # the last eigenvalue is the largest: sigma and direction of the least certain component of each rate
    variance, axes = np.linalg.eigh(covariance[:, RATE, RATE])
    sigma, axis = np.sqrt(np.maximum(variance[:, -1], 0.0)), axes[:, :, -1]
    # rates this far apart (rad/s) differ by two basins as turns at the farther end of the window
    spacing = 2 * s.basin_rad / np.abs(model.obs.t_s - model.obs.t_s[middle]).max()
    # how many on either side: up to half a spacing short of `valley_sigmas`
    sides = np.clip(np.ceil(s.valley_sigmas * sigma / spacing - 0.5), 0, s.valley_each).astype(int)
    # the attitude that goes with a rate, by regression on the covariance: the Sun stays where it was seen
    turn_per_rate = np.einsum("kij,kj->ki", covariance[:, TURN, RATE], axis)
    turn_per_rate /= np.maximum(variance[:, -1:], np.finfo(float).tiny)
    # motions come best first: what is cut off belongs to the worse ones
    which = np.repeat(np.arange(len(sigma)), 2 * sides)[: s.valley_most]
    # 1, ..., n and -1, ..., -n steps of the spacing from each motion
    steps = [np.concatenate([np.arange(1, n + 1), -np.arange(1, n + 1)]) for n in sides]
    change = spacing * np.concatenate([np.zeros(0), *steps])[: s.valley_most, None]
    omega = motions.omega[which, middle] + change * axis[which]
    attitude = rotate_attitude(motions.attitude[which, middle], change * turn_per_rate[which])
    within_limit = np.linalg.norm(omega, axis=1) < model.rate_max
    return attitude[within_limit], omega[within_limit]
