"""Motions fitted to what was observed: attitude and rate at every sample are unknown (multiple shooting).

Readings at a sample and the equations of motion between neighbours are residuals, equation (smoother) of docs/model.md. The normal
equations are a chain of 6 x 6 blocks with a border for the other unknowns; a step of Gauss and Newton costs a time linear in the
number of samples. As each interval has a start of its own, a start may be poor without the end of a pass being wild. Only the Sun
is known in N, as its z axis: the turn about it is held by a weak prior.
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

TURN_PRIOR = 10.0
"""rad; holds the turn about the Sun, which nothing measures, without telling anything."""

DIFFERENCE_RAD = 1e-5
"""Turn by which an attitude is changed for the derivative of a torque."""

LEAST_TURN = 1e-6
"""rad; motions may leave the equations of motion by this in an interval: of two samples a millisecond apart the torques would tell
the turn to 1e-10 rad, and the matrix of a fit lost all digits. A file with such times was given a motion 6 sigma off."""

RATE_LIMIT = 4.0
"""No trial rate exceeds this many sigmas of the prior: a step far out of the basin must not overflow."""


@dataclass(frozen=True)
class Fit:
    """K motions fitted under a model.

    `log_evidence` (K): log of the integral of the posterior density around each, by Laplace's method. `u_covariance` (K, m, m) of
    the unknowns in sigmas; `states_by_u` (K, n, 6, m): change of turn and rate at the samples by one sigma of each unknown.
    `lowest`: the motions where their cost is least, if `motions` are means over several sigmas of unknowns.
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
        """Return some of the motions."""
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
        """Return the motions from which another fit begins: means over sigmas of a torque leave the equations of motion."""
        return self.motions if self.lowest is None else self.lowest


def whitening(noise: Noise, dt: np.ndarray) -> tuple[np.ndarray, float]:
    """Return matrices W (n, 6, 6) that give defects of turn and rate in intervals dt (n), s, unit variance.

    W^T W is the inverse covariance. White angular acceleration q makes the covariance q^2 (dt^3 / 3, dt^2 / 2; dt^2 / 2, dt) of
    turn and rate about each axis. A swing r (`Noise.rate`) adds r^2 dt to the variance of the turn. W is the inverse of its
    Cholesky factor. Second: half the sum of the logs of the determinants of all covariances.
    """
    square = noise.in_intervals(dt) ** 2
    hidden = noise.rate**2 * dt + LEAST_TURN**2  # variance of the turn alone
    # the Cholesky factor (turn, 0; mixed, rate) of the covariance about one axis; its inverse is (1 / turn, 0; -mixed / (turn
    # rate), 1 / rate)
    turn = np.sqrt(square * dt**3 / 3 + hidden)
    mixed = square * dt**2 / 2 / turn
    rate = np.sqrt(square * dt * (square * dt**3 / 12 + hidden)) / turn
    matrix = np.zeros((len(dt), 6, 6))
    for axis in range(3):
        matrix[:, axis, axis] = 1 / turn
        matrix[:, axis + 3, axis] = -mixed / (turn * rate)
        matrix[:, axis + 3, axis + 3] = 1 / rate
    return matrix, float(3 * (np.log(turn) + np.log(rate)).sum())


class NormalEquations:
    """The normal equations of K motions at n samples with m unknowns, while residuals are added to them.

    A residual r with the derivative A and the weight w adds w A^T A to the matrix, and w A^T r to the gradient. The matrix has
    blocks of turn and rate at each sample, `diagonal` (K, n, 6, 6), and between neighbours, `upper` (K, n - 1, 6, 6). The unknowns
    add a `border` (K, n, 6, m) and a `corner` (K, m, m). The gradient is `slope` (K, n, 6) and `border_slope` (K, m). They begin
    with the prior of the unknowns u, which are in sigmas: |u|^2 / 2.
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
        """Add differences (K, n, r) of readings; `unknowns` (m): indices of the unknowns to which their `by_u` belongs."""
        cost, weight = residual.law(residual.value)
        self.cost += cost.sum(axis=1)
        # for turn and rate at the sample: the rows of the state, the derivative A, and w A^T
        of_state = [
            (rows, derivative, _transposed(weight[..., None, None] * derivative))
            for rows, derivative in ((TURN, residual.by_turn), (RATE, residual.by_rate))
            if derivative is not None
        ]
        for rows, _, weighted in of_state:
            self.slope[..., rows] += (weighted @ residual.value[..., None])[..., 0]
            for columns, derivative, _ in of_state:
                self.diagonal[..., rows, columns] += weighted @ derivative
            if residual.by_u is not None:
                self.border[..., rows, unknowns] += weighted @ residual.by_u
        if residual.by_previous is not None:
            # a reading that is compared with the one before couples the turns at both samples; the first sample has none before
            previous = residual.by_previous[:, 1:]
            weighted = _transposed(weight[:, 1:, None, None] * previous)
            self.slope[:, :-1, TURN] += (weighted @ residual.value[:, 1:, :, None])[..., 0]
            self.diagonal[:, :-1, TURN, TURN] += weighted @ previous
            for columns, derivative, _ in of_state:
                self.upper[..., TURN, columns] += weighted @ derivative[:, 1:]
            if residual.by_u is not None:
                self.border[:, :-1, TURN, unknowns] += weighted @ residual.by_u[:, 1:]
        if residual.by_u is not None:
            weighted = _transposed(weight[..., None, None] * residual.by_u)
            self.corner[:, unknowns[:, None], unknowns] += (weighted @ residual.by_u).sum(axis=1)
            of_u = (weighted @ residual.value[..., None]).sum(axis=1)[..., 0]
            self.border_slope[:, unknowns] += of_u

    def add_defects(self, defect: Defects) -> None:
        """Add by how much motions leave the equations of motion in each interval; all weights are one."""
        first_T, second_T = _transposed(defect.by_first), _transposed(defect.by_second)
        self.cost += np.einsum("kni,kni->k", defect.value, defect.value) / 2
        self.diagonal[:, :-1] += first_T @ defect.by_first
        self.diagonal[:, 1:] += second_T @ defect.by_second
        self.upper += first_T @ defect.by_second
        self.slope[:, :-1] += (first_T @ defect.value[..., None])[..., 0]
        self.slope[:, 1:] += (second_T @ defect.value[..., None])[..., 0]
        if self.border_slope.shape[1]:
            by_u_T = _transposed(defect.by_u)
            self.border[:, :-1] += first_T @ defect.by_u
            self.border[:, 1:] += second_T @ defect.by_u
            self.corner += (by_u_T @ defect.by_u).sum(axis=1)
            self.border_slope += (by_u_T @ defect.value[..., None]).sum(axis=1)[..., 0]


def _transposed(matrices: np.ndarray) -> np.ndarray:
    """Return the transposed matrices (..., j, i) of matrices (..., i, j)."""
    return np.swapaxes(matrices, -1, -2)


def equations(model: Model, motions: Track) -> BorderedSystem:
    """Return cost and normal equations of motions: readings, equations of motion between the samples, and priors.

    The prior of the unknowns is there from the start (:class:`NormalEquations`). The damping is scaled by the readings.
    """
    system = NormalEquations(motions)
    for residual, unknowns in readings(model, motions):
        system.add_readings(residual, unknowns)
    # damping in the measure of what was read: in that of the equations of motion, which are stiff where samples are close together,
    # it would hold a whole motion in its place
    damping = damping_scale(system.diagonal, model.obs.t_s)
    system.add_defects(defects(model, motions))

    # in the matrix alone: it holds the turn about the Sun where it is, and prefers none
    system.diagonal[:, 0, TURN, TURN] += _free_turn(model.obs, motions.sun_B[:, 0])
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
    """Yield the differences of all readings, and the indices (m) of the unknowns to which their `by_u` belongs.

    Sensors other than the Sun's may be late: their readings are compared with the motion as it was that much earlier. The latency
    may be an unknown itself, which is then appended to those of the sensor.
    """
    indices, earlier = np.arange(len(model.unknowns)), earlier_states(model, model.obs, motions)
    for term, own in model.terms_with_slices:
        u = motions.u[:, own]
        if earlier is None or term.of_sun:
            for residual in term.residuals(motions, u):
                yield residual, indices[own]
            continue
        for residual in term.residuals(earlier.states, u):
            at_sample, by_late = earlier.derivatives_at_sample(residual)
            if earlier.index is None:
                yield at_sample, indices[own]
                continue
            by_u = earlier.sigma_s * by_late[..., None]
            if at_sample.by_u is not None:
                by_u = np.concatenate([at_sample.by_u, by_u], axis=-1)
            yield at_sample._replace(by_u=by_u), np.append(indices[own], earlier.index)


class Earlier(NamedTuple):
    """K motions as they were `late_s` (K), s, before their samples: what sensors other than the Sun's read there.

    `sigma_s` of the latency, and its `index` among the unknowns of the model, None if it is known exactly; `turned` (K, n, 3, 3):
    since then; `acceleration` (K, n, 3) then, rad/s2.
    """

    late_s: np.ndarray
    sigma_s: float
    index: int | None
    states: States
    turned: np.ndarray
    acceleration: np.ndarray

    def derivatives_at_sample(self, residual: Residual) -> tuple[Residual, np.ndarray]:
        """Return differences computed at the earlier state, with derivatives by the state at the sample and the latency (K, n, r).

        Moving back by T turns the body by -omega T and changes its rate by -(acceleration) T. So by the latency the derivative is
        -(by_turn omega + by_rate acceleration). A change of the rate at the sample also moves the earlier attitude, by -T times it,
        and the earlier rate as much.
        """
        by_late = np.zeros(residual.value.shape)
        by_turn, by_rate, previous = residual.by_turn, residual.by_rate, residual.by_previous
        if by_rate is not None:
            by_late -= np.einsum("knri,kni->knr", by_rate, self.acceleration)
        if by_turn is not None:
            by_late -= np.einsum("knri,kni->knr", by_turn, self.states.omega)
            # a change of the rate moves both of two neighbours nearly alike, and their difference hardly
            if previous is None:
                by_moved = -self.late_s[:, None, None, None] * by_turn
                by_rate = by_moved if by_rate is None else by_rate + by_moved
            by_turn = by_turn @ self.turned
        if previous is not None:
            by_late[:, 1:] -= np.einsum("knri,kni->knr", previous[:, 1:], self.states.omega[:, :-1])
            previous = previous @ at_sample_before(self.turned, axis=1)
        return residual._replace(by_turn=by_turn, by_rate=by_rate, by_previous=previous), by_late


def earlier_states(model: Model, obs: Observations, motions: Track) -> Earlier | None:
    """Return motions as they were `late_s` before their samples, when the sensors other than the Sun's were read.

    They are carried back by the equations of motion; the momentum of the wheels stays that of the sample. None if these sensors are
    read together with the Sun. `obs`: the samples at which the motions are given.
    """
    clocks = [
        (term, own.start)
        for term, own in model.terms_with_slices
        if isinstance(term, Latency) and (term.late_s or term.sigma_s)
    ]
    if not clocks:
        return None
    # a model has one clock; `start`: the place of its latency among the unknowns
    clock, start = clocks[0]
    index = start if clock.sigma_s else None
    error_s = 0.0 if index is None else clock.sigma_s * motions.u[:, index]
    late_s = clock.late_s + error_s + np.zeros(len(motions))
    momentum = obs.momentum
    inertia = model.body.inertia_at(motions.u[:, model.inertia_slice])
    back = np.broadcast_to(-late_s[:, None], motions.omega.shape[:2])
    stepped = step(inertia, motions.omega, back, (momentum, momentum))
    # Euler's equations: I dw/dt = (I w + h) x w
    turning = np.cross(stepped.omega @ inertia + momentum, stepped.omega)
    acceleration = turning @ np.linalg.inv(inertia)
    states = States(stepped.turned @ motions.attitude, stepped.omega)
    return Earlier(late_s, clock.sigma_s, index, states, stepped.turned, acceleration)


class Defects(NamedTuple):
    """By how much K motions leave the equations of motion in n - 1 intervals, in sigmas of unknown torques.

    `value` (K, n - 1, 6) of turn and rate at the end of each interval, and its derivatives: `by_first` and `by_second`
    (K, n - 1, 6, 6) by turn and rate at the two ends, `by_u` (K, n - 1, 6, m) by the unknowns. `by_second` is the whitening itself:
    the derivative of the defect in rad and rad/s is taken as one, which is exact without a defect, and defects are small where a
    fit ends.
    """

    value: np.ndarray
    by_first: np.ndarray
    by_second: np.ndarray
    by_u: np.ndarray

    def unwhitened(self, value: np.ndarray) -> np.ndarray:
        """Return whitened values (K, n - 1, 6) as turns in rad and changes of the rate in rad/s."""
        return np.linalg.solve(self.by_second, value[..., None])[..., 0]


def defects(model: Model, motions: Track) -> Defects:
    """Return by how much motions leave the equations of motion between neighbouring samples, with derivatives."""
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
    for term, own in model.terms_with_slices:
        push = term.added_by_unknowns(motions, dt)
        if push is not None:
            # that what an unknown torque adds depends on the states is left out of `by_start`
            by_u[..., own] = push
            value = value - np.einsum("knim,km->kni", push, motions.u[:, own])
        known = term.added_by_torque(motions, dt)
        if known is not None:
            value = value - known
            if term.about_sun:  # a torque that is known in space depends on the attitude
                by_start[..., TURN] += pushed_by_turn(term, motions, dt, known)
    white, _ = whitening(model.noise, dt)
    by_second = np.broadcast_to(white, (len(value), *white.shape))
    return Defects((white @ value[..., None])[..., 0], -white @ by_start, by_second, -white @ by_u)


def pushed_by_turn(term: Term, motions: Track, dt: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return the derivative (K, n - 1, 6, 3) of what a known torque adds, `known` (K, n - 1, 6), by a turn at the first sample."""
    columns = [
        term.added_by_torque(replace(motions, attitude=rotate_attitude(motions.attitude, turn)), dt)
        - known
        for turn in DIFFERENCE_RAD * np.eye(3)
    ]
    return np.stack(columns, axis=-1) / DIFFERENCE_RAD


def damping_scale(read: np.ndarray, t_s: np.ndarray) -> np.ndarray:
    """Return the damping (K, 6) of turn and rate in the measure of the readings' normal matrices (K, n, 6, 6)."""
    size = np.einsum("knii->kni", read).mean(axis=1)
    turn = size[:, TURN].mean(axis=1, keepdims=True)
    usual_s = np.diff(t_s).mean() if len(t_s) > 1 else 1.0
    rate = size[:, RATE].mean(axis=1, keepdims=True) + turn * usual_s**2
    return np.repeat(np.concatenate([turn, rate], axis=1), 3, axis=1)


def _free_turn(obs: Observations, sun_B: np.ndarray) -> np.ndarray:
    """Return the weak prior (K, 3, 3) of the turn about the Sun (K, 3), which no reading determines; without a Sun, of any turn."""
    if not any(term.of_sun for term in obs.terms):
        return np.tile(np.eye(3) / TURN_PRIOR**2, (len(sun_B), 1, 1))
    return sun_B[:, :, None] * sun_B[:, None, :] / TURN_PRIOR**2


def fit(
    model: Model,
    motions: Track,
    steps: int,
    tolerance: float = TOLERANCE,
    along_equations: bool = False,
) -> Fit:
    """Fit states at all samples and the unknowns by Levenberg and Marquardt's method; return the motions with their evidence.

    Unknowns that `motions` lack, as those of a term that was added last, begin at their centres. `along_equations`: a step leaves
    the equations of motion by no more than its linear theory says (:func:`bent_step`).
    """
    limits = np.array([unknown.limit for unknown in model.unknowns])
    longest = RATE_LIMIT * model.rate_sigma

    def move(state: tuple[np.ndarray, ...], change: tuple[np.ndarray, np.ndarray | None]):
        attitude, omega, u = state
        nodes, shared = change
        u = u if shared is None else np.clip(u + shared, -limits, limits)
        u[:, model.inertia_slice] = model.body.possible(u[:, model.inertia_slice])
        if along_equations:
            bent = bent_step(model, Track(*state), nodes, u)
            return bent.attitude, limit_length(bent.omega, longest), u
        return (
            rotate_attitude(attitude, nodes[..., TURN]),
            limit_length(omega + nodes[..., RATE], longest),
            u,
        )

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
    determinants = inverse.log_determinant / 2
    _, log_width_of_torques = whitening(model.noise, np.diff(model.obs.t_s))
    # Laplace's method; what it leaves out all models of a pass share: see `log_left_out`
    log_evidence = model.log_prior - system.cost - determinants - log_width_of_torques
    # a fit that ended on a slope has a matrix of no minimum, and no evidence
    log_evidence = np.where(np.isfinite(log_evidence), log_evidence, -np.inf)
    return Fit(model, fitted, log_evidence, inverse.border, inverse.sensitivity)


def bent_step(model: Model, motions: Track, change: np.ndarray, u: np.ndarray) -> Track:
    """Return motions after a step `change` (K, n, 6) of turns and rates, and with unknowns u (K, m), along the equations of motion.

    A straight step, by what each state changes, violates the equations of motion; under weak torques this defect costs much, so
    that a chain creeps along a valley of inertia and rates. Here the state of the middle sample moves as the step says. All others
    follow from it by the equations of motion, and by the defects that linear theory predicts after the step: it is the step of
    single shooting, of a lifted Newton method (Albersmeyer and Diehl 2010, SIAM J. Optim. 20, 1655).
    """
    obs, dt = model.obs, np.diff(model.obs.t_s)
    defect = defects(model, motions)
    predicted = defect.value + np.einsum("knij,knj->kni", defect.by_first, change[:, :-1])
    predicted += np.einsum("knij,knj->kni", defect.by_second, change[:, 1:])
    predicted += np.einsum("knij,kj->kni", defect.by_u, u - motions.u)
    # what is added to a free motion at the end of each interval: the predicted defect, and torques
    added = defect.unwhitened(predicted)
    for term, own in model.terms_with_slices:
        push, known = term.added_by_unknowns(motions, dt), term.added_by_torque(motions, dt)
        if push is not None:
            added += np.einsum("knim,km->kni", push, u[:, own])
        if known is not None:
            added += known

    inertia = model.body.inertia_at(u[:, model.inertia_slice])
    attitude = rotate_attitude(motions.attitude, change[..., TURN])
    omega = motions.omega + change[..., RATE]
    middle, last = len(obs) // 2, len(obs) - 1
    for start in range(middle, last):
        end = start + 1
        stepped = _step_between(obs, inertia, omega[:, [start]], [start], [end])
        free = stepped.turned[:, 0] @ attitude[:, start]
        attitude[:, end] = rotate_attitude(free, added[:, start, TURN])
        omega[:, end] = stepped.omega[:, 0] + added[:, start, RATE]
    for start in range(middle, 0, -1):
        # Interval k lies between the samples k and k + 1, so this one has the number of `end`. What is added where it ends, at
        # `start`, is taken off before the step back.
        end = start - 1
        free = rotate_attitude(attitude[:, start], -added[:, end, TURN])
        before = omega[:, [start]] - added[:, [end], RATE]
        stepped = _step_between(obs, inertia, before, [start], [end])
        attitude[:, end] = stepped.turned[:, 0] @ free
        omega[:, end] = stepped.omega[:, 0]
    return Track(attitude, omega, u)


def log_left_out(model: Model) -> float:
    """Return by what the log evidence of a fit exceeds the log of the mean likelihood over all motions that its model allows.

    It is the same for all models of a pass that sees the Sun. Prior densities of the first rate, of the defects and of the unknowns
    are normal, with 6 n + m - 3 factors 1 / sqrt(2 pi). That of the first attitude is 1 / (8 pi^2). Laplace's method gives
    sqrt(2 pi) for each of the 6 n + m numbers. Nothing measures the turn about the Sun: its integral is 2 pi, but counts as
    sqrt(2 pi) `TURN_PRIOR`. With the width of the prior of the rate, 1 / (2 `TURN_PRIOR` `rate_sigma`^3) is left of all that.
    """
    return float(np.log(2 * TURN_PRIOR) + 3 * np.log(model.rate_sigma))


def variance_of(fitted: Fit, weights: np.ndarray) -> np.ndarray:
    """Return the variances (K, r) of sums over the samples of turns and rates, with weights (K, n, r, 6).

    It is the variance of the states with the unknowns held, plus what the covariance of the unknowns adds. With the matrix H of the
    normal equations of the states the former is w^T H^-1 w: they are solved once for each row w of the weights.
    """
    system = equations(fitted.model, fitted.motions)._replace(
        border=None, corner=None, border_slope=None
    )
    variances = []
    for row in range(weights.shape[2]):
        # a solver returns the step -H^-1 slope
        w = weights[..., row, :]
        (nodes, _), _ = solve_bordered(system._replace(slope=-w), np.zeros(len(fitted)))
        variances.append(np.einsum("kni,kni->k", w, nodes))
    # the sums change by B u with the unknowns u, whose covariance C adds B C B^T
    by_u = np.einsum("knri,knim->krm", weights, fitted.states_by_u)
    of_u = np.einsum("krm,kmj,krj->kr", by_u, fitted.u_covariance, by_u)
    return np.maximum(np.stack(variances, axis=1), 0.0) + of_u


def propagate(model: Model, sample: int, attitude: np.ndarray, omega: np.ndarray) -> Track:
    """Return the motions, without unknowns, that have attitudes (K, 3, 3) and rates (K, 3) at a sample."""
    k, n = len(omega), len(model.obs)
    motions = Track.free(np.empty((k, n, 3, 3)), np.empty((k, n, 3)))
    motions.attitude[:, sample], motions.omega[:, sample] = attitude, omega
    _propagate_outward(model, motions, sample, sample)
    return motions


def _propagate_outward(
    model: Model, motions: Track, first: int, last: int, by_state: np.ndarray | None = None
) -> None:
    """Fill in motions (K), which are given from sample `first` to `last`, at all other samples.

    If asked for, also their derivatives `by_state` (K, n, 6, 6) by turn and rate at one sample, which are given as the motions are:
    products of those of the steps. Steps go both ways at once while both go on: one takes nearly as long for two intervals as for
    one.
    """
    attitude, omega = motions.attitude, motions.omega
    n, inertia = omega.shape[1], model.body.inertia
    for k in range(max(first, n - 1 - last)):
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
    """Propagate the rates `omega` (K, i, 3) from i samples `start` to the samples `end`; `inertia` (3, 3), or (K, 3, 3)."""
    momenta = obs.momentum[start], obs.momentum[end]
    return step(inertia, omega, obs.t_s[end] - obs.t_s[start], momenta, derivatives)


def fit_single_shooting(model: Model, sample: int, motions: Track, steps: int) -> Track:
    """Fit attitude and rate at one sample, all else following by the equations of motion alone (single shooting).

    It is for samples that are close together. A step of a chain is a straight line in the states of all samples, but motions that
    obey the equations of motion are curved, so that a chain moves by short steps only. Here a step changes six numbers, and the
    other samples follow exactly: it may be long. The model has no unknowns. `motions` (K): the fit begins at their states at
    `sample`; they are returned at all samples.
    """
    n = len(model.obs)
    largest_rate = RATE_LIMIT * model.rate_sigma

    def linearise(state: tuple[np.ndarray, np.ndarray]) -> DenseSystem:
        """Return cost and normal equations (K, 6, 6) of attitudes (K, 3, 3) and rates (K, 3) at the sample.

        The six numbers are turn, then rate. There are no defects: the other samples follow exactly.
        """
        omega = state[1]
        k = len(omega)
        # motions at all samples, and their derivatives by turn and rate at the sample
        track = Track.free(np.empty((k, n, 3, 3)), np.empty((k, n, 3)))
        by_state = np.empty((k, n, 6, 6))
        track.attitude[:, sample], track.omega[:, sample], by_state[:, sample] = *state, np.eye(6)
        _propagate_outward(model, track, sample, sample, by_state)
        previous_by_state = at_sample_before(by_state, axis=1)
        matrix, slope, cost = np.zeros((k, 6, 6)), np.zeros((k, 6)), np.zeros(k)
        for term in model.obs.terms:
            for residual in term.residuals(track, track.u):
                part, weight = residual.law(residual.value)
                cost += part.sum(axis=1)
                # chain rule: the rows of `by_state` are changes of a sample's turn and rate by the six numbers
                derivative = sum(
                    by @ of_sample[..., rows, :]
                    for of_sample, rows, by in (
                        (by_state, TURN, residual.by_turn),
                        (by_state, RATE, residual.by_rate),
                        (previous_by_state, TURN, residual.by_previous),
                    )
                    if by is not None
                )
                weighted = np.swapaxes(weight[..., None, None] * derivative, -1, -2)
                matrix += (weighted @ derivative).sum(axis=1)
                slope += (weighted @ residual.value[..., None]).sum(axis=1)[..., 0]
        matrix[:, TURN, TURN] += _free_turn(model.obs, track.sun_B[:, sample])
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
    return replace(Track.free(*solution.system.extras), cost=solution.system.cost)


def costs(obs: Observations, motions: Track) -> np.ndarray:
    """Return the cost of the readings (K, n) of motions without unknowns."""
    total = np.zeros(motions.omega.shape[:2])
    for term in obs.terms:
        for residual in term.residuals(motions, motions.u):
            total += residual.law(residual.value)[0]
    return total


class Chain:
    """How a search fits, compares and carries motions under a model without unknowns: see :class:`search.Carrier`."""

    def __init__(self, model: Model, settings: SearchSettings) -> None:
        self.model, self.s, self.t_s = model, settings, model.obs.t_s

    def cost_limit(self, window: slice) -> float:
        """Return the cost that a true motion does not exceed in a window."""
        return self.model.obs.take(window).cost_limit

    def joined(self, motions: list[Track]) -> Track:
        """Return the motions of several searches."""
        return Track.joined(motions)

    def fit(self, motions: Track, window: slice) -> Track:
        """Return motions fitted to a window."""
        return fit(self.model.seeing(window), motions, steps=4).motions

    def kept(self, motions: Track, window: slice) -> Track:
        """Return motions without copies and without improbable ones, best first."""
        return motions.take(distinct(motions, self.t_s[window], self.s))

    def widened(self, motions: Track, window: slice, wider: slice) -> Track:
        """Return motions carried to the samples of a wider window, and others along what the window leaves open of the rate."""
        model = self.model.seeing(wider)
        first, last = window.start - wider.start, window.stop - wider.start
        n, k = wider.stop - wider.start, len(motions)
        wide = Track.free(np.empty((k, n, 3, 3)), np.empty((k, n, 3)))
        wide.attitude[:, first:last], wide.omega[:, first:last] = motions.attitude, motions.omega
        _propagate_outward(model, wide, first, last - 1)
        middle = (window.stop - window.start) // 2
        others = along_the_valley(self.model.seeing(window), motions, middle, self.s)
        return Track.joined([wide, propagate(model, first + middle, *others)])


def along_the_valley(
    model: Model, motions: Track, middle: int, s: SearchSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Return further attitudes (K, 3, 3) and rates (K, 3) at the sample `middle`, on either side of motions.

    They differ in the rate along its least certain direction. A few samples of the Sun hardly show the rate about the Sun
    direction, so that the cost has a long flat valley, in which a fit ends anywhere. As the window grows, the valley bends and
    breaks into several minima, and a motion ends in the nearest of them: a slow body was lost so. Here the valley is sampled as
    densely as a fit moves. Motions that do not fit have no further ones, since their covariance is wrong, nor have those far from
    the best.
    """
    limit = s.valley_fits * model.obs.cost_limit
    limit = min(limit, motions.cost.min(initial=np.inf) + s.valley_leading)
    motions = motions.take(np.flatnonzero(motions.cost < limit))
    covariance = np.nan_to_num(motions.covariance[:, middle])
    variance, axes = np.linalg.eigh(covariance[:, RATE, RATE])
    sigma, axis = np.sqrt(np.maximum(variance[:, -1], 0.0)), axes[:, :, -1]
    # an error of the rate turns the body by that times the time to the farther end of the window
    spacing = 2 * s.basin_rad / np.abs(model.obs.t_s - model.obs.t_s[middle]).max()
    sides = np.clip(np.ceil(s.valley_sigmas * sigma / spacing - 0.5), 0, s.valley_each).astype(int)
    # the attitude that goes with a rate, by the covariance: the Sun stays where it was seen
    turn_per_rate = np.einsum("kij,kj->ki", covariance[:, TURN, RATE], axis)
    turn_per_rate /= np.maximum(variance[:, -1:], np.finfo(float).tiny)
    # motions come best first: what is cut off belongs to the worse ones
    which = np.repeat(np.arange(len(sigma)), 2 * sides)[: s.valley_most]
    # 1, ..., n and -1, ..., -n steps of the spacing from each motion
    steps = [np.concatenate([np.arange(1, n + 1), -np.arange(1, n + 1)]) for n in sides]
    change = spacing * np.concatenate([np.zeros(0), *steps])[: s.valley_most, None]
    omega = motions.omega[which, middle] + change * axis[which]
    attitude = rotate_attitude(motions.attitude[which, middle], change * turn_per_rate[which])
    slow = np.linalg.norm(omega, axis=1) < model.rate_max
    return attitude[slow], omega[slow]
