"""The smoother behind :func:`sunspin.rates`: attitude and rate at every sample, by Gauss-Newton, many hypotheses at once.

The unknowns are the attitude (a turn, 3) and the rate (3) at every sample; what was measured at a sample and the equations of
motion between neighbours are residuals, so that the normal equations are block-tridiagonal and cost a step linear in the
number of samples. Starting every interval anew (multiple shooting) lets a start be poor without the end of a pass being
wild. Only the Sun is known in N, as its z axis: the turn about it is held by a weak prior and reported as unknown.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from sunspin.infer.rates.motion import Body, Ends, step_with_answer, turn, turn_between

STUDENT = 4.0
"""Degrees of freedom of the Student law of measurements: tails that let one bad sample in ten be outvoted."""

FIELD_TURN_RATE = 2.2e-3
"""rad/s; a satellite in low orbit sees the Earth's field turn at about twice its own rate of 1.1e-3 rad/s."""

RATE_LIMIT = 4.0
"""No trial rate exceeds this many times the prior's sigma (twice the largest rate of the search)."""

TURN_PRIOR = 10.0
"""rad; holds the turn about the Sun line, which nothing measures, without telling anything."""

BAD_COST = 3.7
"""Cost per sample beyond which even the best motion does not fit; sound ones, of skCUBE and of twins, stay below 3.6."""

THREE_READINGS = 1.5
"""What three sound readings cost in the mean."""

SUN_N = np.array([0.0, 0.0, 1.0])
"""The Sun in the local frame N."""


PER_SAMPLE = (
    "t_s", "sun_B", "sun_cov", "power", "power_sigma", "scale", "scale_sigma", "gyro", "gyro_common", "field", "momentum",
    "attitude",
)  # fmt: skip
"""What `Observations` holds for each sample."""


@dataclass(frozen=True)
class Observations:
    """What a pass measured, at n samples. NaN or infinite sigma: nothing measured there.

    `t_s` (n); `sun_B` (n, 3), `sun_cov` (n, 3, 3) its covariance (of full rank; NaN: no direction); `power` (n, n_panel) or for
    each hypothesis (K, n, n_panel), `power_sigma` (n, n_panel), `rows` (n_panel, 3) or for each hypothesis (K, n_panel, 3) gain
    times normal with `row_errors` (m, n_panel, 3), one sigma of errors that all samples share, and `row_unknowns`
    (m, n_panel, 3), one sigma of those that are to be estimated; `scale` (n) and `scale_sigma` (n): the factor of all powers of a
    sample and its relative uncertainty; `gyro` (n, 3) rad/s with `gyro_sigma` and `gyro_common` (n, m, 3), one sigma of errors
    that all samples share; `field` (n, 3) with `field_sigma`, in any unit; `momentum` (n, 3) of the wheels, in the body's mean
    moment of inertia times rad/s; `attitude` (n, 3, 3) B_from_N of some inertial frame with `attitude_sigma` (rad), of which only
    the turn from sample to sample is used; `earth_light`: how much of full Sun a panel gets that looks at
    the Earth.
    """

    t_s: np.ndarray
    sun_B: np.ndarray
    sun_cov: np.ndarray
    power: np.ndarray
    power_sigma: np.ndarray
    rows: np.ndarray
    row_errors: np.ndarray
    row_unknowns: np.ndarray
    scale: np.ndarray
    scale_sigma: np.ndarray
    gyro: np.ndarray
    gyro_common: np.ndarray
    gyro_sigma: float
    field: np.ndarray
    field_sigma: float
    momentum: np.ndarray
    attitude: np.ndarray
    attitude_sigma: float
    earth_light: float = 0.0

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def told(self) -> np.ndarray:
        """Which samples have a direction (n)."""
        return np.isfinite(self.sun_cov[:, 0, 0])

    def take(self, index: np.ndarray | slice) -> Observations:
        """The samples `index`."""
        return replace(self, **{name: getattr(self, name)[index] for name in PER_SAMPLE})

    def part(self, low: int, high: int) -> Observations:
        """Samples low to high - 1."""
        return self.take(slice(low, high))

    def wheels(self, start: int, end: int) -> Ends:
        """What the wheels do between two samples."""
        return Ends(momentum=self.momentum[start], momentum_end=self.momentum[end])


UNTOLD = np.zeros(0)
"""What stands in a `Track` for what no fit has told yet."""


@dataclass(frozen=True)
class Track:
    """K hypotheses: attitudes B_from_N (K, n, 3, 3), rates (K, n, 3), and once smoothed their `cost` (K) (minus the log of
    the posterior density) and `log_weight` (K) (log of the mass of the mode, by Laplace), `covariance` (K, n, 6, 6)."""

    attitude: np.ndarray
    omega: np.ndarray
    cost: np.ndarray = field(default_factory=lambda: UNTOLD)
    log_weight: np.ndarray = field(default_factory=lambda: UNTOLD)
    covariance: np.ndarray = field(default_factory=lambda: UNTOLD)

    def take(self, index: np.ndarray | slice) -> Track:
        told = (x if x is UNTOLD else x[index] for x in (self.cost, self.log_weight, self.covariance))
        return Track(self.attitude[index], self.omega[index], *told)

    @property
    def sun_B(self) -> np.ndarray:
        return self.attitude @ SUN_N


def joined(tracks: list[Track]) -> Track:
    """All hypotheses of smoothed tracks."""
    each = [(t.attitude, t.omega, t.cost, t.log_weight, t.covariance) for t in tracks]
    return Track(*(np.concatenate(parts) for parts in zip(*each, strict=True)))


@dataclass(frozen=True)
class Motion:
    """How the body moves: the body, the white angular acceleration `noise` (rad/s^1.5), the prior sigma of a rate (rad/s)."""

    body: Body
    noise: float
    rate_prior: float


def cross_matrix(v: np.ndarray) -> np.ndarray:
    """[v]x (..., 3, 3): [v]x b = v x b."""
    zero = np.zeros_like(v[..., 0])
    rows = [[zero, -v[..., 2], v[..., 1]], [v[..., 2], zero, -v[..., 0]], [-v[..., 1], v[..., 0], zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def measured(observations: Observations, track: Track) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normal matrices (K, n, 6, 6), gradients (K, n, 6) and costs (K, n) of what was measured at each sample."""
    k, n = track.omega.shape[:2]
    matrix, slope = np.zeros((k, n, 6, 6)), np.zeros((k, n, 6))
    matrix[..., :3, :3], slope[..., :3], cost = sun_measured(observations, track)
    known = np.all(np.isfinite(observations.gyro), axis=1)
    if known.any():
        value = np.where(known[:, None], (track.omega - np.nan_to_num(observations.gyro)) / observations.gyro_sigma, 0.0)
        weight, part = student(value)
        matrix[..., 3:, 3:] += (weight * known)[..., None, None] * np.eye(3) / observations.gyro_sigma**2
        slope[..., 3:] += (weight * known)[..., None] * value / observations.gyro_sigma
        cost += part
    return matrix, slope, cost


def sun_measured(o: Observations, track: Track, unknowns: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normal matrices (K, n, 3 + m, 3 + m), gradients (K, n, 3 + m) and costs (K, n) of the Sun at each sample, to a turn and to
    one sigma of each of `unknowns` (m, n_panel, 3), errors of gain times normal."""
    unknowns = np.zeros((0, *o.rows.shape[-2:])) if unknowns is None else unknowns
    k, n, size = *track.omega.shape[:2], 3 + len(unknowns)
    matrix, slope, cost = np.zeros((k, n, size, size)), np.zeros((k, n, size)), np.zeros((k, n))
    sun = track.sun_B
    answer = cross_matrix(sun)  # the Sun's direction in the body answers sun x turn
    for value, jacobian in _sun_residuals(o, sun, answer, unknowns):
        weight, part = student(value)
        matrix += np.einsum("kn,knmi,knmj->knij", weight, jacobian, jacobian)
        slope += np.einsum("kn,knmi,knm->kni", weight, jacobian, value)
        cost += part
    return matrix, slope, cost


def _sun_residuals(o: Observations, sun: np.ndarray, answer: np.ndarray, unknowns: np.ndarray):
    told = o.told
    if told.any():
        white = np.zeros((len(o), 3, 3))
        white[told] = np.swapaxes(np.linalg.cholesky(np.linalg.inv(o.sun_cov[told])), -1, -2)
        jacobian = white @ answer
        jacobian = np.concatenate([jacobian, np.zeros((*jacobian.shape[:-1], len(unknowns)))], axis=-1)
        yield np.einsum("nij,knj->kni", white, sun - np.where(told[:, None], o.sun_B, 0.0)), jacobian
    if o.power.size and np.isfinite(o.power_sigma).any():
        yield _power_residuals(o, sun, answer, unknowns)


def _power_residuals(o: Observations, sun: np.ndarray, answer: np.ndarray, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Powers less the model's (K, n, n_panel + 1), in sigma, the scale of each sample being put at its best (variable projection),
    and their Jacobian (K, n, n_panel + 1, 3 + m) to a turn and to the `unknowns`.

    The scale's own prior is one more residual, so a scale known, half known and free are one formula.
    """
    inverse = np.where(np.isfinite(o.power_sigma), 1 / o.power_sigma, 0.0)
    target = np.nan_to_num(o.power) * inverse
    target = np.concatenate([target, np.broadcast_to((1 / o.scale_sigma)[:, None], (*target.shape[:-1], 1))], axis=-1)
    cosine = sun @ np.swapaxes(o.rows, -1, -2)
    shape = np.maximum(cosine, 0.0) * inverse * o.scale[:, None]
    shape = np.concatenate([shape, np.broadcast_to((1 / o.scale_sigma)[:, None], (*shape.shape[:2], 1))], axis=-1)
    size = (shape**2).sum(axis=-1, keepdims=True)
    best = np.maximum((shape * target).sum(axis=-1, keepdims=True) / size, 0.0)
    to_turn = np.expand_dims(o.rows, -3) @ answer
    change = np.concatenate([to_turn, np.einsum("knj,mpj->knpm", sun, unknowns)], axis=-1)
    change = ((cosine > 0) * inverse * o.scale[:, None])[..., None] * change
    change = np.concatenate([change, np.zeros((*change.shape[:2], 1, change.shape[-1]))], axis=-2) * best[..., None]
    unit = shape / np.sqrt(size)
    change = change - unit[..., None] * np.einsum("...m,...mi->...i", unit, change)[..., None, :]
    return best * shape - target, change


def student(value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weight and cost of residual vectors (..., m) under a Student law of `STUDENT` degrees of freedom."""
    square = (value**2).sum(axis=-1)
    return (STUDENT + 2) / (STUDENT + square), (STUDENT + 2) / 2 * np.log1p(square / STUDENT)


def between(o: Observations, track: Track, motion: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What the motion and the field say of neighbours: residuals (K, n-1, m), Jacobians to the first and second of them."""
    dt = np.diff(o.t_s)
    start, end = track.attitude[:, :-1], track.attitude[:, 1:]
    relative = end @ np.swapaxes(start, -1, -2)
    met = np.all(np.isfinite(o.field), axis=1)
    pair = met[:-1] & met[1:]
    b0, b1 = np.nan_to_num(o.field[:-1]) * pair[:, None], np.nan_to_num(o.field[1:]) * pair[:, None]
    ends = Ends(momentum=o.momentum[:-1], momentum_end=o.momentum[1:])
    if pair.any() and np.any(motion.body.dipole):
        ends = ends._replace(field=b0, field_end=b1)
    ends = Ends(*(None if part is None else np.broadcast_to(part, (*relative.shape[:2], 3)) for part in ends))
    made, rate, answer = step_with_answer(motion.body, track.omega[:, :-1], np.broadcast_to(dt, relative.shape[:2]), ends)
    defect = np.concatenate([turn_between(made, relative), track.omega[:, 1:] - rate], axis=-1)
    white = whitening(dt, motion.noise)
    value = np.einsum("nij,knj->kni", white, defect)
    first = -np.einsum("nij,knjl->knil", white, answer)
    second = np.broadcast_to(white, (*value.shape, 6)).copy()
    if pair.any() and np.isfinite(o.field_sigma):
        more = _field_residuals(o, relative, b0, b1, pair, dt)
        value, first, second = (np.concatenate([x, y], axis=2) for x, y in zip((value, first, second), more, strict=True))
    known = np.isfinite(o.attitude[:, 0, 0])
    if (pair := known[:-1] & known[1:]).any():
        more = _attitude_residuals(o, relative, pair)
        value, first, second = (np.concatenate([x, y], axis=2) for x, y in zip((value, first, second), more, strict=True))
    return value, first, second


def _attitude_residuals(o, relative, pair):
    """The turn between neighbours less that of the given attitudes, in sigma; small, so that turns add as vectors."""
    given = np.where(pair[:, None, None], o.attitude[1:] @ np.swapaxes(o.attitude[:-1], -1, -2), np.eye(3))
    inverse = np.where(pair, 1 / (np.sqrt(2) * o.attitude_sigma), 0.0)[:, None]
    value = turn_between(np.broadcast_to(given, relative.shape), relative) * inverse
    first, second = np.zeros((*value.shape, 6)), np.zeros((*value.shape, 6))
    second[..., :3] = np.eye(3) * inverse[..., None]
    first[..., :3] = -relative * inverse[..., None]
    return value, first, second


def whitening(dt: np.ndarray, noise: float) -> np.ndarray:
    """Inverse square roots (n, 6, 6) of the covariance of turn and rate that white angular acceleration makes in `dt` (n)."""
    covariance = np.zeros((len(dt), 6, 6))
    eye = np.eye(3)
    covariance[:, :3, :3] = (dt**3 / 3)[:, None, None] * eye
    covariance[:, :3, 3:] = covariance[:, 3:, :3] = (dt**2 / 2)[:, None, None] * eye
    covariance[:, 3:, 3:] = dt[:, None, None] * eye
    return np.linalg.inv(np.linalg.cholesky(covariance)) / noise


def _field_residuals(o, relative, b0, b1, pair, dt):
    sigma = np.sqrt(2 * o.field_sigma**2 + (np.linalg.norm(b0, axis=1) * FIELD_TURN_RATE * dt) ** 2)
    inverse = np.where(pair, 1 / sigma, 0.0)[:, None]
    carried = np.einsum("knij,nj->kni", relative, b0)
    value = (carried - b1) * inverse
    first, second = np.zeros((*value.shape, 6)), np.zeros((*value.shape, 6))
    second[..., :3] = cross_matrix(carried) * inverse[..., None]
    first[..., :3] = -relative @ cross_matrix(b0) * inverse[..., None]
    return value, first, second


def cost_limit(o: Observations) -> float:
    """The cost beyond which even the best motion does not fit: so much for each sample's Sun, and what sound readings of the
    other sensors cost in the mean."""
    more = [np.all(np.isfinite(o.gyro), axis=1)]
    field_known = np.all(np.isfinite(o.field), axis=1)
    for known, used in ((field_known, np.isfinite(o.field_sigma)), (np.isfinite(o.attitude[:, 0, 0]), True)):
        more.append(known[:-1] & known[1:] & used)
    return BAD_COST * len(o) + THREE_READINGS * sum(int(part.sum()) for part in more)


def normal_equations(o: Observations, track: Track, motion: Motion) -> tuple[np.ndarray, ...]:
    """Diagonal (K, n, 6, 6) and upper (K, n-1, 6, 6) blocks, gradient (K, n, 6), cost (K) of the whole pass; and what one unit
    of damping adds to the diagonal (K, 6)."""
    diagonal, slope, cost = measured(o, track)
    damping = damping_scale(diagonal, o.t_s)
    value, first, second = between(o, track, motion)
    diagonal[:, :-1] += np.swapaxes(first, -1, -2) @ first
    diagonal[:, 1:] += np.swapaxes(second, -1, -2) @ second
    upper = np.swapaxes(first, -1, -2) @ second
    slope[:, :-1] += np.einsum("knmi,knm->kni", first, value)
    slope[:, 1:] += np.einsum("knmi,knm->kni", second, value)
    total = cost.sum(axis=1) + (value**2).sum(axis=(1, 2)) / 2
    sun = track.sun_B[:, 0]
    diagonal[:, 0, :3, :3] += sun[:, :, None] * sun[:, None, :] / TURN_PRIOR**2
    diagonal[:, 0, 3:, 3:] += np.eye(3) / motion.rate_prior**2
    slope[:, 0, 3:] += track.omega[:, 0] / motion.rate_prior**2
    return diagonal, upper, slope, total + (track.omega[:, 0] ** 2).sum(axis=1) / (2 * motion.rate_prior**2), damping


def damping_scale(told: np.ndarray, t_s: np.ndarray) -> np.ndarray:
    """Damping (K, 6) of turn and rate in the measure of what was measured (K, n, 6, 6): one in that of the equations of motion,
    which are stiff where samples are close together, would hold a whole hypothesis in its place."""
    size = np.einsum("knii->kni", told).mean(axis=1)
    turn_size = size[:, :3].mean(axis=1, keepdims=True)
    step_s = np.diff(t_s).mean() if len(t_s) > 1 else 1.0
    rate_size = size[:, 3:].mean(axis=1, keepdims=True) + turn_size * step_s**2
    return np.repeat(np.concatenate([turn_size, rate_size], axis=1), 3, axis=1)


def solve(diagonal: np.ndarray, upper: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Step (K, n, 6), marginal covariances (K, n, 6, 6) and log determinant (K) of block-tridiagonal normal equations."""
    n = diagonal.shape[1]
    pivots, carried = diagonal.copy(), -slope
    gain = np.zeros_like(upper)
    for i in range(n - 1):
        gain[:, i] = np.linalg.solve(pivots[:, i], upper[:, i])
        pivots[:, i + 1] = pivots[:, i + 1] - np.swapaxes(upper[:, i], -1, -2) @ gain[:, i]
        carried[:, i + 1] = carried[:, i + 1] - np.einsum("kji,kj->ki", gain[:, i], carried[:, i])
    inverse = np.linalg.inv(pivots)
    change, covariance = np.einsum("knij,knj->kni", inverse, carried), inverse.copy()
    for i in range(n - 2, -1, -1):
        change[:, i] -= np.einsum("kij,kj->ki", gain[:, i], change[:, i + 1])
        covariance[:, i] += gain[:, i] @ covariance[:, i + 1] @ np.swapaxes(gain[:, i], -1, -2)
    return change, covariance, np.linalg.slogdet(pivots)[1].sum(axis=1)


def shortened(omega: np.ndarray, limit: float) -> np.ndarray:
    """Rates (..., 3) shortened to `limit`: a step far out of the basin must not overflow."""
    size = np.linalg.norm(omega, axis=-1, keepdims=True)
    return omega * np.minimum(1.0, limit / np.maximum(size, 1e-300))


def smooth(o: Observations, track: Track, motion: Motion, steps: int = 8) -> Track:
    """Damped Gauss-Newton on K hypotheses at once; returns them with cost, weight and covariance."""
    damping = np.full(len(track.omega), 1e-3)
    parts = normal_equations(o, track, motion)
    each = np.arange(6)
    for _ in range(steps):
        diagonal = parts[0].copy()
        diagonal[..., each, each] += (damping[:, None] * parts[4])[:, None]
        change = solve(diagonal, parts[1], parts[2])[0]
        omega = shortened(track.omega + change[..., 3:], RATE_LIMIT * motion.rate_prior)
        trial = Track(turn(track.attitude, change[..., :3]), omega)
        new = normal_equations(o, trial, motion)
        better = new[3] < parts[3]
        track = Track(*(np.where(better.reshape(-1, *(1,) * (a.ndim - 1)), a, b)
                        for a, b in ((trial.attitude, track.attitude), (trial.omega, track.omega))))  # fmt: skip
        gained = np.where(better, parts[3] - new[3], 0.0)
        parts = tuple(np.where(better.reshape(-1, *(1,) * (a.ndim - 1)), a, b) for a, b in zip(new, parts, strict=True))
        damping = np.where(better, damping / 5, damping * 8)
        if np.all((gained < 1e-3) & (damping < 1e6) & better):
            break
    covariance, size = solve(parts[0], parts[1], parts[2])[1:]
    return Track(track.attitude, track.omega, parts[3], -parts[3] - size / 2, covariance)
