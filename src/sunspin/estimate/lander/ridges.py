"""Curved ridges of the posterior, and proposals of motions on them for importance sampling.

Uncertain moments, friction and wheel speeds make the posterior near a motion a thin curved ridge. A proposal has three steps:

1. *Outer* coordinates y are drawn from a mixture of Student distributions that is adapted to earlier draws. They are the unknowns
   on which the motion depends, the noise, and the directions of rate and Sun that are weakly constrained even at fixed unknowns.
2. Least squares finds the best *stiff* coordinates z*(y), the other directions of rate and Sun. z is drawn about z*(y) with the
   covariance that the curvature there gives. To take few runs of a motion, the fit starts from a quadratic regression of z* on
   earlier points, and from the derivatives at the nearest of them: with this a draw takes three runs.
3. Unknowns that change the readings only (brightness, gains, misalignments) are drawn several times for the given motion.

The density of each step is known, so that the weights are exact. A poor approximation in a proposal makes draws less effective, but
biases no result.

Shapes: D coordinates of a motion (:mod:`sunspin.estimate.lander.motions`), d outer and q stiff ones, m unknowns of the model, of
which s are reading unknowns. A *root* is a Cholesky factor; *white* numbers are independent with a variance of one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree
from scipy.special import logsumexp

from sunspin.estimate.lander.motions import STATE_SIZE, SUN, UNKNOWNS, LanderMotions, ModelFit
from sunspin.estimate.lander.outer_law import (
    StudentMixture,
    monomials,
    student_draws,
    student_log_density,
)
from sunspin.estimate.lander.target import LanderTarget, MotionSlopes
from sunspin.estimate.settings import SamplingSettings
from sunspin.solve.least_squares import (
    join_problems,
    least_squares,
    replace_problems,
    take_problems,
)
from sunspin.solve.linear import DenseSystem, solve_dense

LOOSEST_RAD = 3.0
"""Largest sigma (rad) of a stiff direction: a full circle has no more directions."""

LONGEST_SIGMAS = 3.0
"""A last step of least squares that is longer than this, in its own sigmas, is not taken, as the equations are not linear so
far."""

COLD, WARM = ((3.0, 2), (1.0, 4)), ((1.0, 3),)
"""(factor on the noise, steps) of least squares from a start far from the ridge, and from one that is predicted."""

RIDGE_FLOOR = 1e-13
"""Part of the trace that is added to the diagonal of the normal equations of a ridge's curve. Terms without points are then
zero."""

CURVE_FITS = 3
"""Fits of a ridge's curve, each without the points that were far from the one before."""

SETTLED_GAIN = 4.0
"""A step is tried if it promises at least this gain in cost: 2.8 sigma of the stiff coordinates. The rest is done by a last step
whose cost is not computed. With 1.0 a draw of Philae takes 3.5 runs instead of 2.8, and draws are not better."""


@dataclass(frozen=True)
class Chart:
    """Coordinates (y, z) of motions about a fitted one, the `centre`.

    `basis` (5, 5): its rows are combinations of the five state coordinates (rate, direction), the weakly constrained ones first.
    The outer coordinates y (d) are the first `weak` of these and the unknowns with the indices `outer_unknowns`; the stiff ones z
    (q) are the other 5 - `weak`. `curved`: indices of the coordinates y along which the ridge may curve, all but the noise.
    """

    centre: LanderMotions
    basis: np.ndarray
    weak: int
    outer_unknowns: np.ndarray
    curved: np.ndarray

    @classmethod
    def about(
        cls,
        target: LanderTarget,
        centre: LanderMotions,
        covariance: np.ndarray,
        settings: SamplingSettings,
    ) -> Chart:
        """Return the coordinates about a motion whose coordinates have the covariance (D, D).

        The combinations are principal directions of the covariance at fixed outer unknowns; rates count as the rotation within the
        window. A direction that is well known at fixed unknowns is stiff, however wide it is otherwise: as an outer coordinate it
        would make the distribution of y as thin and as curved as the ridge itself.
        """
        unknowns = np.setdiff1d(np.arange(len(target.model.unknowns)), target.reading_unknowns)
        to_rad = np.diag([target.model.reach_s] * 3 + [1.0] * 2)
        conditional = covariance[:STATE_SIZE, :STATE_SIZE]
        if len(unknowns):  # covariance of the state at fixed unknowns (Schur complement)
            cross = covariance[:STATE_SIZE, STATE_SIZE + unknowns]
            of_u = covariance[np.ix_(STATE_SIZE + unknowns, STATE_SIZE + unknowns)]
            conditional = conditional - cross @ np.linalg.solve(of_u, cross.T)
        conditional = to_rad @ conditional @ to_rad
        variance, vectors = np.linalg.eigh((conditional + conditional.T) / 2)
        # without outer unknowns one combination at least is outer, so that y is not empty
        weak = int(np.sum(variance > settings.weak_rad**2))
        weak = int(np.clip(weak, len(unknowns) == 0, settings.most_weak))
        of_motion = np.searchsorted(
            unknowns, target.motion_unknowns
        )  # their places among the outer
        curved = np.append(np.arange(weak), weak + of_motion)
        return cls(centre, vectors[:, ::-1].T @ to_rad, weak, unknowns, curved)

    @property
    def dimensions(self) -> int:
        """Return the number d of outer coordinates."""
        return self.weak + len(self.outer_unknowns)

    @property
    def stiff(self) -> int:
        """Return the number q of stiff coordinates."""
        return STATE_SIZE - self.weak

    def covariance(self, of_motion: np.ndarray) -> np.ndarray:
        """Return the covariance (d + q, d + q) of (y, z) from that of the coordinates of a motion (D, D)."""
        kept = np.append(np.arange(STATE_SIZE), STATE_SIZE + self.outer_unknowns)
        whole = np.eye(len(kept))
        whole[:STATE_SIZE, :STATE_SIZE] = self.basis
        by_basis = whole @ of_motion[np.ix_(kept, kept)] @ whole.T
        # from the order weak, stiff, unknowns to weak, unknowns, stiff
        of_u = np.arange(STATE_SIZE, len(kept))
        order = np.concatenate([np.arange(self.weak), of_u, np.arange(self.weak, STATE_SIZE)])
        return by_basis[np.ix_(order, order)]

    def coordinates(self, motions: LanderMotions) -> tuple[np.ndarray, np.ndarray]:
        """Return y (K, d) and z (K, q) of motions."""
        x = motions.from_centre(self.centre)
        combined = x[:, :STATE_SIZE] @ self.basis.T
        outer = x[:, UNKNOWNS][:, self.outer_unknowns]
        return np.concatenate([combined[:, : self.weak], outer], axis=1), combined[:, self.weak :]

    def _state_steps(self, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return the steps (K, 5) of rate and direction from the centre to y (K, d) and z (K, q)."""
        combined = np.concatenate([y[:, : self.weak], z], axis=1)
        return np.linalg.solve(self.basis, combined.T).T

    def motions(self, y: np.ndarray, z: np.ndarray, u: np.ndarray) -> LanderMotions:
        """Return the motions at y (K, d) and z (K, q), with the reading unknowns of u (K, m)."""
        step, u = self._state_steps(y, z), np.array(u)
        u[:, self.outer_unknowns] = self.centre.u[:, self.outer_unknowns] + y[:, self.weak :]
        centres = self.centre.take(np.zeros(len(y), dtype=np.int64))
        moved = centres.moved(np.concatenate([step, np.zeros_like(u)], axis=1))
        return LanderMotions(moved.omega, moved.sun, u)

    def log_volume(self, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return the log (K) of the volume in rate, solid angle and unknowns per unit of volume in y, z.

        It is minus infinity beyond half a turn from the centre: there the coordinates would count a direction twice.
        """
        angle = np.linalg.norm(self._state_steps(y, z)[:, SUN], axis=1)
        sphere = np.log(np.maximum(np.sinc(angle / np.pi), 1e-300))  # sin(angle) / angle
        return np.where(angle < np.pi, sphere - np.linalg.slogdet(self.basis)[1], -np.inf)

    def slopes_by_stiff(self, motions: LanderMotions, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return the derivatives (K, 5, q) of rate and direction by the stiff coordinates z at fixed y, from differences.

        `motions`: those at y (K, d) and z (K, q). Changes of a direction are along two tangents at it, not at the centre.
        """
        size, slopes = 1e-5, []
        for direction in np.eye(self.stiff):
            shifted = self.motions(y, z + size * direction, motions.u)
            slopes.append(shifted.from_centre(motions)[:, :STATE_SIZE] / size)
        return np.stack(slopes, axis=2)


class Proposals(NamedTuple):
    """All N proposals from one ridge so far: y (N, d), z (N, q) and the whole `motions`.

    `log_inner` (N): log of the density with which z was drawn given y; `log_mass` (N): log of the posterior density over y and z,
    with the reading unknowns integrated out by :func:`draw_reading_unknowns`.
    """

    y: np.ndarray
    z: np.ndarray
    log_inner: np.ndarray
    log_mass: np.ndarray
    motions: LanderMotions


class RidgePoints(NamedTuple):
    """n points of a ridge: at outer coordinates `y` (n, d) the best stiff ones, `best` (n, q), by least squares.

    `root` (n, q, q): Cholesky factors of the covariance of z about `best`; `u` (n, m): unknowns, with the best reading unknowns;
    `slopes`: motions with their derivatives, one last step before the best.
    """

    y: np.ndarray
    best: np.ndarray
    root: np.ndarray
    u: np.ndarray
    slopes: MotionSlopes

    def slopes_near(self, y: np.ndarray, mixture: StudentMixture) -> MotionSlopes:
        """Return the derivatives at the point nearest to each y (n, d), in mean sigmas of the components of a mixture."""
        sigma = np.sqrt(np.einsum("cii->i", mixture.covariance) / len(mixture.weight))
        nearest = KDTree(self.y / sigma).query(y / sigma)[1]
        return take_problems(self.slopes, nearest)


@dataclass
class Ridge:
    """A ridge of the posterior and the draws from it; `settings` of the sampling.

    The curve of the ridge, z*(y), is a polynomial of y with the `coefficients` (M, q); `scatter` (q, q): covariance of z about it.
    Mixtures from which y is drawn: `first` follows from the curvature at the fitted motions, `adapted` from the draws.
    `next_round`: (share of the draws, mixture) of the next round; `past`: (number of draws, mixture) of all rounds so far.
    `laplace_log_mass`: log probability by Laplace's method, up to a constant that all ridges share.
    """

    settings: SamplingSettings
    chart: Chart
    coefficients: np.ndarray
    scatter: np.ndarray
    first: StudentMixture
    next_round: list[tuple[float, StudentMixture]]
    adapted: StudentMixture
    laplace_log_mass: float
    past: list[tuple[int, StudentMixture]]
    proposals: Proposals | None = None
    points: RidgePoints | None = None

    @property
    def draw_count(self) -> int:
        """Return the number N of draws so far."""
        return sum(count for count, _ in self.past)

    def curve(self, y: np.ndarray) -> np.ndarray:
        """Return z*(y), the predicted best stiff coordinates (n, q) at y (n, d)."""
        return monomials(y, self.chart.curved) @ self.coefficients

    def log_outer(self, y: np.ndarray) -> np.ndarray:
        """Return the log density (n) with which all rounds together have proposed y (n, d): the mixture of their mixtures."""
        freedom, of_rounds = self.settings.freedom, []
        for count, mixture in self.past:
            log_density = logsumexp(mixture.log_densities(y, freedom), axis=1)
            of_rounds.append(log_density + np.log(count / self.draw_count))
        return np.asarray(logsumexp(of_rounds, axis=0))

    def log_weights(self) -> np.ndarray:
        """Return the log (N) of the posterior density at each proposal over the density with which it was proposed."""
        proposals = self.proposals
        assert proposals is not None
        return proposals.log_mass - proposals.log_inner - self.log_outer(proposals.y)

    def log_density(self, motions: LanderMotions) -> np.ndarray:
        """Return the log of how many draws of this ridge there are per rate, solid angle and unknowns at motions (n).

        It is approximate, as if z were drawn about the curve with `scatter`. It only divides motions between overlapping ridges,
        and weights are exact whenever the parts of a motion add to one.
        """
        y, z = self.chart.coordinates(motions)
        root = np.linalg.cholesky(self.scatter)
        white = np.linalg.solve(root, (z - self.curve(y)).T).T
        inner = student_log_density(white, self.settings.freedom) - np.log(np.diag(root)).sum()
        volume = self.chart.log_volume(y, z)
        return np.log(self.draw_count) + self.log_outer(y) + inner - volume


class Peak(NamedTuple):
    """Normal approximation of the posterior about a fitted motion.

    `log_mass`: log of its integral; `step` (D): from the fitted motion to the mean; `covariance` (D, D).
    """

    log_mass: float
    step: np.ndarray
    covariance: np.ndarray


def ridges_of(target: LanderTarget, fit: ModelFit, settings: SamplingSettings) -> list[Ridge]:
    """Return the ridges on which the fitted motions lie, the most probable first.

    A motion on the ridge of a more probable one becomes a component of the mixture of that ridge.
    """
    model = target.model
    # information of the prior of the state; the curvature has that of the unknowns
    prior = np.diag([model.max_rate**-2] * 3 + [1.0] * 2 + [0.0] * len(model.unknowns))
    covariance = np.linalg.inv(fit.motions.curvature + prior)
    covariance = (covariance + np.swapaxes(covariance, 1, 2)) / 2
    log_mass = -fit.motions.cost + np.linalg.slogdet(covariance)[1] / 2
    # An unknown may have several prior sigmas. The weight of its prior in the fit is the inverse square of the effective one, over
    # `Unknown.sigma`.
    fitted_share = 1 / np.sqrt(model.prior_cost(fit.motions.u)[1])
    ridges: list[Ridge] = []
    for i in np.argsort(-log_mass, kind="stable"):
        improbable = log_mass[i] < log_mass.max() + np.log(settings.least)
        if improbable or len(ridges) >= settings.most_ridges:
            break
        motion = fit.motions.bare.take([i])
        as_fitted = Peak(float(log_mass[i]), np.zeros(len(covariance[i])), covariance[i])
        far = settings.far_torque
        peaks = over_prior_sigmas(target, motion.u[0], as_fitted, fitted_share[i], far)
        for ridge in ridges:
            y, z = ridge.chart.coordinates(motion)
            off = np.concatenate([y, z], axis=1)[0]
            own = ridge.chart.covariance(covariance[i])
            if off @ np.linalg.solve(own, off) < settings.on_ridge * len(off):
                added = _mixture_of(peaks, ridge.chart, y[0], ridge.laplace_log_mass)
                mass = float(added.weight.sum())
                ridge.first = StudentMixture.joined([(1.0, ridge.first), (mass, added)])
                ridge.next_round, ridge.adapted = [(1.0, ridge.first)], ridge.first
                break
        else:  # on none of the ridges so far
            ridges.append(_ridge_about(target, motion, covariance[i], peaks, settings))
    return ridges


def _ridge_about(
    target: LanderTarget,
    centre: LanderMotions,
    covariance: np.ndarray,
    peaks: list[Peak],
    settings: SamplingSettings,
) -> Ridge:
    """Return a ridge about a motion with the covariance (D, D), before any draw: its curve is a straight line as yet."""
    chart = Chart.about(target, centre, covariance, settings)
    d, largest = chart.dimensions, max(peak.log_mass for peak in peaks)
    joint = chart.covariance(covariance)
    of_y, of_z, linear_terms = slice(0, d), slice(d, None), slice(1, 1 + d)
    # z depends on y by the regression of the covariance; terms with products of y are zero until points are known
    coefficients = np.zeros((monomials(np.zeros((1, d)), chart.curved).shape[1], chart.stiff))
    coefficients[linear_terms] = np.linalg.solve(joint[of_y, of_y], joint[of_y, of_z])
    scatter = joint[of_z, of_z] - joint[of_z, of_y] @ coefficients[linear_terms]
    mixture = _mixture_of(peaks, chart, np.zeros(d), largest)
    mixture = mixture._replace(covariance=settings.widened * mixture.covariance)
    return Ridge(
        settings=settings,
        chart=chart,
        coefficients=coefficients,
        scatter=(scatter + scatter.T) / 2,
        first=mixture,
        next_round=[(1.0, mixture)],
        adapted=mixture,
        laplace_log_mass=largest,
        past=[],
    )


def _mixture_of(
    peaks: list[Peak], chart: Chart, y: np.ndarray, ridge_log_mass: float
) -> StudentMixture:
    """Return a mixture of outer coordinates with a component for each peak of a motion, which is at y (d).

    Its weights are relative to `ridge_log_mass`, the log mass of the ridge on which the motion lies.
    """
    log_mass, step, covariance = (np.array(values) for values in zip(*peaks, strict=True))
    combined = step[:, :STATE_SIZE] @ chart.basis.T
    outer = step[:, STATE_SIZE + chart.outer_unknowns]
    y_steps = np.concatenate([combined[:, : chart.weak], outer], axis=1)
    of_y = slice(0, len(y))
    covariance_y = np.array([chart.covariance(matrix)[of_y, of_y] for matrix in covariance])
    # weights are less unequal than the masses, as Laplace's method may be wrong by a few units of the log
    weight = np.exp(np.clip(0.7 * (log_mass - ridge_log_mass), -8.0, 8.0))
    return StudentMixture(weight, y + y_steps, covariance_y)


def over_prior_sigmas(
    target: LanderTarget, u: np.ndarray, fitted: Peak, fitted_share: np.ndarray, farthest: float
) -> list[Peak]:
    """Return the peaks of a motion with unknowns u (m), one for each combination of prior sigmas that its unknowns may have.

    They follow by linear theory from the peak `fitted`, whose prior sigmas are `fitted_share` (m) times `Unknown.sigma`. Peaks
    farther than `farthest` prior sigmas from the centres are left out, as linear theory does not hold there: a torque that rotates
    the momentum about the Sun hardly changes readings, and would be placed whole revolutions away.
    """
    peaks = [fitted]
    unknowns = target.model.unknowns
    # all unknowns of a kind have the same share
    for kind in dict.fromkeys(x.kind for x in unknowns if len(x.shares) > 1):
        indices = np.array(target.model.indices(kind))
        before = float(fitted_share[indices[0]])
        pairs = ((peak, share) for peak in peaks for share in unknowns[indices[0]].shares)
        resized = [_with_prior_sigmas(*pair, u, indices, before, farthest) for pair in pairs]
        peaks = [peak for peak in resized if peak is not None]
    return peaks


def _with_prior_sigmas(
    peak: Peak, share: float, u: np.ndarray, indices: np.ndarray, before: float, farthest: float
) -> Peak | None:
    """Return `peak` for prior sigmas `share` of the unknowns `indices` in place of `before`, both factors of `Unknown.sigma`.

    It is None if a larger sigma leads farther than `farthest` of these sigmas from the centre. Let v be these unknowns at the old
    mean. The new prior adds a v^2 / 2 to the cost, with a = 1 / share^2 - 1 / before^2, and a to the curvature. One Newton step
    d = C g leads to the new mean, with the new covariance C and the gradient g = -a v of the log density. The log mass grows by
    (g d - a v^2) / 2, by half the change of log det C, and by the norm of the prior, -log(share / before) for each unknown.
    """
    at, added = STATE_SIZE + indices, share**-2 - before**-2
    precision, gradient = np.linalg.inv(peak.covariance), np.zeros(len(peak.covariance))
    precision[at, at] += added
    value = u[indices] + peak.step[at]  # v
    gradient[at] = -added * value
    covariance = np.linalg.inv(precision)
    step = covariance @ gradient
    if share > before and np.linalg.norm(value + step[at]) > farthest * share:
        return None
    gain = (gradient @ step - added * value @ value) / 2
    volume = (np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(peak.covariance)[1]) / 2
    log_mass = peak.log_mass + gain + volume - len(indices) * np.log(share / before)
    return Peak(float(log_mass), peak.step + step, covariance)


class StiffState(NamedTuple):
    """State of the fit of stiff coordinates: y (n, d), z (n, q), unknowns `u` (n, m); `slopes`: derivatives near by, if any."""

    y: np.ndarray
    z: np.ndarray
    u: np.ndarray
    slopes: MotionSlopes | None


def fit_stiff(
    target: LanderTarget, ridge: Ridge, y: np.ndarray, near: MotionSlopes | None
) -> RidgePoints:
    """Return the stiff coordinates and reading unknowns of largest posterior density at fixed outer coordinates y (n, d).

    The fit starts on the curve of the ridge. `near`: motions near the starts with their derivatives, if there are any: then few
    steps are enough, mostly one and the last one, whose cost is not computed.
    """
    chart = ridge.chart
    reading, q = target.reading_unknowns, chart.stiff
    # a step has q components of z, then those of the reading unknowns
    of_z, of_reading = slice(0, q), slice(q, None)

    def equations(noise_factor: float, state: StiffState) -> DenseSystem:
        """Return the normal equations in z and the reading unknowns, from those of rate, direction and reading unknowns."""
        motions = chart.motions(state.y, state.z, state.u)
        system = target.linearised(motions, state.slopes, noise_factor)
        # chain rule with the derivatives `change` (n, 5 + s, q + s) of the old coordinates by the new ones
        change = np.zeros((len(motions), STATE_SIZE + len(reading), q + len(reading)))
        change[:, :STATE_SIZE, of_z] = chart.slopes_by_stiff(motions, state.y, state.z)
        change[:, STATE_SIZE:, of_reading] = np.eye(len(reading))
        slope = np.einsum("kij,ki->kj", change, system.slope)
        matrix = np.swapaxes(change, 1, 2) @ system.matrix @ change
        matrix[:, range(q), range(q)] += LOOSEST_RAD**-2
        return DenseSystem(system.cost, matrix, slope, extras=system.extras)

    def moved(state: StiffState, step: np.ndarray) -> StiffState:
        """Return the state after a step (n, q + s)."""
        u = np.array(state.u)
        u[:, reading] += step[:, of_reading]
        return state._replace(z=state.z + step[:, of_z], u=u)

    def with_slopes(state: StiffState, system: DenseSystem) -> StiffState:
        """Return the state with the derivatives of its equations, for the next ones."""
        return state._replace(slopes=system.extras)

    u = np.tile(chart.centre.u, (len(y), 1)) if near is None else near.u
    state = StiffState(y, ridge.curve(y), u, near)
    system: DenseSystem | None = None
    # a far start is first fitted under a larger noise, so that no reading counts as an outlier because of the start
    for noise_factor, steps in WARM if near is not None else COLD:
        system = equations(noise_factor, state)
        state = with_slopes(state, system)
        # Most predicted starts are so near that the last step is enough. Starts whose predicted gain is not a number count as far.
        gain = solve_dense(system, np.zeros(len(y)))[1]
        far = np.flatnonzero(~(gain < SETTLED_GAIN))
        if len(far):
            solution = least_squares(
                lambda at, noise_factor=noise_factor: equations(noise_factor, at),
                moved,
                solve_dense,
                take_problems(state, far),
                steps=steps,
                tolerance=SETTLED_GAIN,
                system=take_problems(system, far),
                keep=with_slopes,
            )
            state = replace_problems(state, far, solution.state)
            system = replace_problems(system, far, solution.system)
    assert system is not None
    # the last step, if it is short enough for the equations to be linear
    covariance = np.linalg.inv(system.matrix)
    step = -np.einsum("kij,kj->ki", covariance, system.slope)
    squared_length = -np.sum(system.slope * step, axis=1)  # in sigmas
    short = np.isfinite(step).all(axis=1) & (squared_length < LONGEST_SIGMAS**2)
    end = moved(state, np.where(short[:, None], step, 0.0))
    # covariance of z with free reading unknowns, which are drawn too
    covariance_z = covariance[:, of_z, of_z]
    root = np.linalg.cholesky((covariance_z + np.swapaxes(covariance_z, 1, 2)) / 2)
    assert end.slopes is not None
    return RidgePoints(y, end.z, root, end.u, end.slopes)


def draw_reading_unknowns(
    target: LanderTarget,
    motions: LanderMotions,
    log_volume: np.ndarray,
    rng: np.random.Generator,
    settings: SamplingSettings,
) -> tuple[LanderMotions, np.ndarray]:
    """Return n motions with reading unknowns drawn, and the `log_mass` (n) of each (:class:`Proposals`).

    Several sets of these unknowns are drawn for each motion, which need not run again for them. The mass is the mean of their
    weights, and one set is chosen with a probability in proportion to its weight. With one set only, a draw in the tails of the
    normal distribution might outweigh all others. The step to the best reading unknowns begins at those of the motions.
    `log_volume` (n): of :meth:`Chart.log_volume`.
    """
    reading = target.reading_unknowns
    count = settings.reading_draws if len(reading) else 1
    white = rng.standard_normal((len(motions), count, len(reading)))
    chance = rng.random(len(motions))
    log_mass = log_volume + target.model.log_prior_density(motions)
    # a motion beyond the coordinates or the prior has no mass, and need not run
    rows = np.flatnonzero(np.isfinite(log_mass))
    log_mass[np.setdiff1d(np.arange(len(motions)), rows)] = -np.inf
    if not len(rows):
        return motions, log_mass
    possible, white = motions.take(rows), white[rows]
    track = target.track(possible)

    # Readings are nearly linear in these unknowns, so that their density given motion and noise is nearly normal. One Newton step
    # leads to its middle.
    before = possible.u[:, reading]
    slope, curvature = target.reading_slopes(track, possible.u)
    precision = curvature + np.eye(len(reading))  # with that of the prior
    step = np.linalg.solve(precision, (slope - before)[:, :, None])[:, :, 0]
    best = before + np.clip(step, -settings.reading_step, settings.reading_step)
    # with the Cholesky factor R of its precision a draw is the best plus R^-T times white numbers
    root = np.linalg.cholesky(precision)
    step = np.linalg.solve(np.swapaxes(root, 1, 2), np.swapaxes(white, 1, 2))
    drawn = best[:, None] + np.swapaxes(step, 1, 2)  # (rows, count, s)
    log_determinant = np.log(np.einsum("kii->ki", root)).sum(axis=1)[:, None]  # of R
    log_drawn = log_determinant - np.sum(white**2 + np.log(2 * np.pi), axis=2) / 2

    # weigh each draw by likelihood and prior over the density `log_drawn`; `log_mass` has the normal prior at the u before
    prior_change = (np.sum(before[:, None] ** 2, axis=2) - np.sum(drawn**2, axis=2)) / 2
    u_drawn = np.repeat(possible.u, count, axis=0)
    u_drawn[:, reading] = drawn.reshape(len(u_drawn), len(reading))
    log_likelihood = target.log_likelihood(np.repeat(track, count, axis=0), u_drawn)
    log_weight = log_likelihood.reshape(len(rows), count) + prior_change - log_drawn
    log_weight = np.where(np.isnan(log_weight), -np.inf, log_weight)
    total = logsumexp(log_weight, axis=1, keepdims=True)
    log_mass[rows] += total[:, 0] - np.log(count)

    # choose the set at which the cumulative weight passes a random part of the total
    share = np.cumsum(np.exp(log_weight - np.where(np.isfinite(total), total, 0.0)), axis=1)
    chosen = np.minimum((share < chance[rows, None] * share[:, -1:]).sum(axis=1), count - 1)
    u = motions.u.copy()
    u[rows[:, None], reading] = drawn[np.arange(len(rows)), chosen]
    return replace(motions, u=u), log_mass


def trace_ridge(target: LanderTarget, ridge: Ridge, count: int, rng: np.random.Generator) -> None:
    """Fit `count` points of a ridge at each of several widths about its motion, and the curve to these; both change the ridge.

    Narrow widths come first, so that their curve and their derivatives give good starts for the wider ones.
    """
    for width in ridge.settings.trace_widths:
        mixture = ridge.first
        component = rng.choice(len(mixture.weight), count, p=mixture.weight / mixture.weight.sum())
        root = np.linalg.cholesky(mixture.covariance)[component]
        white = rng.standard_normal((count, mixture.mean.shape[1]))
        y = mixture.mean[component] + width * np.einsum("nij,nj->ni", root, white)
        before = ridge.points
        near = None if before is None else before.slopes_near(y, mixture)
        points = fit_stiff(target, ridge, y, near)
        ridge.points = points if before is None else join_problems([before, points])
        fit_ridge_curve(ridge)


def propose(target: LanderTarget, ridge: Ridge, count: int, rng: np.random.Generator) -> None:
    """Draw `count` motions from the mixtures of a ridge for this round, by the three steps of this module; they change the ridge.

    Added are the proposals, the points at which stiff coordinates were fitted, and each mixture with its number of draws.
    """
    chart, before, settings = ridge.chart, ridge.points, ridge.settings
    assert before is not None
    proposals, points = [ridge.proposals] if ridge.proposals is not None else [], [before]
    # divide the draws among the mixtures by their shares, rounded to whole numbers
    ends = np.round(count * np.cumsum([share for share, _ in ridge.next_round])).astype(int)
    counts = np.diff(np.minimum(ends, count), prepend=0)
    counts[-1] += count - counts.sum()
    mixtures = [mixture for _, mixture in ridge.next_round]
    divided = [(int(n), mixture) for n, mixture in zip(counts, mixtures, strict=True) if n]
    y_all = np.concatenate([mixture.draw(n, rng, settings.freedom) for n, mixture in divided])
    for y in np.array_split(y_all, -(-count // settings.block)):
        fitted = fit_stiff(target, ridge, y, before.slopes_near(y, ridge.adapted))
        root = settings.inner_width * fitted.root
        step, white = student_draws(root, rng, settings.freedom)
        z = fitted.best + step
        log_determinant = np.log(np.einsum("kii->ki", root)).sum(axis=1)
        log_inner = student_log_density(white, settings.freedom) - log_determinant
        motions, log_volume = chart.motions(y, z, fitted.u), chart.log_volume(y, z)
        motions, log_mass = draw_reading_unknowns(target, motions, log_volume, rng, settings)
        proposals.append(Proposals(y, z, log_inner, log_mass, motions))
        points.append(fitted)
    motions = LanderMotions.joined([part.motions for part in proposals])
    ridge.proposals = Proposals(*join_problems([part[:4] for part in proposals]), motions)
    ridge.points = join_problems(points)
    ridge.past += divided


def fit_ridge_curve(ridge: Ridge) -> None:
    """Fit the curve of a ridge, quadratic polynomials of y, to all its points, or leave it if the points are too few.

    A point counts by 1 / (1 + its squared distance from the mean of the adapted mixture, in sigmas and for each coordinate).
    """
    points, mixture, settings = ridge.points, ridge.adapted, ridge.settings
    assert points is not None
    terms = monomials(points.y, ridge.chart.curved)
    fewest = settings.points_per_term * terms.shape[1]
    used = np.isfinite(points.best).all(axis=1)
    total = mixture.weight.sum()
    mean = mixture.weight @ mixture.mean / total
    root = np.linalg.cholesky(np.einsum("c,cij->ij", mixture.weight, mixture.covariance) / total)
    white = np.linalg.solve(root, (mixture.straight(points.y) - mean).T)
    distance = np.sum(white**2, axis=0) / len(mean)
    coefficients = ridge.coefficients
    for _ in range(CURVE_FITS):
        # again without points that are far off: least squares has led them to another ridge
        if used.sum() < fewest:
            return
        weight = 1 / (1 + distance[used])[:, None]
        size = np.abs(terms[used]).max(axis=0)
        scaled = weight * terms[used] / size
        # normal equations take a tenth of the time of a singular value decomposition, and are accurate enough for predictions
        normal = scaled.T @ scaled
        normal[np.diag_indices(len(normal))] += RIDGE_FLOOR * np.trace(normal)
        coefficients = np.linalg.solve(normal, scaled.T @ (weight * points.best[used]))
        coefficients /= size[:, None]
        misfit = (points.best - terms @ coefficients) / (1 + distance)[:, None]
        off = np.linalg.norm(misfit, axis=1)
        used &= off <= max(settings.off_ridge * float(np.median(off[used])), 1e-12)
    ridge.coefficients = coefficients
