"""Curved ridges of the posterior, and proposals of motions on them for importance sampling.

Uncertain moments, friction and wheel speeds make the posterior near a motion a thin curved ridge. A proposal has three steps:

1. *Outer* coordinates y are drawn from a mixture of Student laws that is adapted to earlier draws. They are the unknowns on which
   the motion depends, the noise, and the directions of rate and Sun that are weakly constrained even at fixed unknowns.
2. Least squares finds the best *stiff* coordinates z*(y), the other directions of rate and Sun. These are drawn about z*(y) with
   the curvature there. A quadratic regression on earlier points predicts z*(y), and derivatives are those of the nearest point, so
   that a draw takes three runs of its motion.
3. Unknowns that change the readings only (brightness, gains, misalignments) are drawn several times for the given motion.

The density of each step is known, so that the weights are exact. A poor approximation in a proposal makes draws less effective, but
biases no result.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import KDTree
from scipy.special import logsumexp

from sunspin.estimate.lander.motions import STATE_SIZE, SUN, UNKNOWNS, LanderMotions, ModelFit
from sunspin.estimate.lander.outer_law import (
    OuterLaw,
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
    """Coordinates y, z about a fitted motion, the `centre`.

    `basis` (5, 5): combinations of rate and direction, the weakly constrained ones first. The outer coordinates y (d) are the first
    `softs` of these and the unknowns with the indices `outer`; z are the other q = 5 - softs. `curved`: indices of those y in which
    the ridge is curved, the others being the noise.
    """

    centre: LanderMotions
    basis: np.ndarray
    softs: int
    outer: np.ndarray
    curved: np.ndarray

    @classmethod
    def about(
        cls,
        target: LanderTarget,
        centre: LanderMotions,
        covariance: np.ndarray,
        s: SamplingSettings,
    ) -> Chart:
        """Return the coordinates about a motion with the covariance (D, D).

        The combinations are principal directions of the covariance at fixed outer unknowns; rates count as the rotation within the
        window. A direction that is well known at fixed unknowns is stiff, however wide it is otherwise: as an outer coordinate it
        would make the law of y as thin and as curved as the ridge itself.
        """
        outer = np.setdiff1d(np.arange(len(target.model.unknowns)), target.reading_unknowns)
        size = np.diag([target.model.reach_s] * 3 + [1.0] * 2)
        given = covariance[:STATE_SIZE, :STATE_SIZE]
        if len(outer):  # covariance given the unknowns (Schur complement)
            cross = covariance[:STATE_SIZE, STATE_SIZE + outer]
            of_u = covariance[np.ix_(STATE_SIZE + outer, STATE_SIZE + outer)]
            given = given - cross @ np.linalg.solve(of_u, cross.T)
        given = size @ given @ size
        variance, vectors = np.linalg.eigh((given + given.T) / 2)
        softs = int(np.clip(np.sum(variance > s.soft_rad**2), len(outer) == 0, s.most_softs))
        curved = np.append(np.arange(softs), softs + np.searchsorted(outer, target.motion_unknowns))
        return cls(centre, vectors[:, ::-1].T @ size, softs, outer, curved)

    @property
    def dimensions(self) -> int:
        """Return how many outer coordinates there are."""
        return self.softs + len(self.outer)

    @property
    def stiff(self) -> int:
        """Return how many stiff coordinates there are."""
        return STATE_SIZE - self.softs

    def covariance(self, of_motion: np.ndarray) -> np.ndarray:
        """Return a covariance (D, D) of rate, direction and unknowns as that of (y, z)."""
        indices = np.append(np.arange(STATE_SIZE), STATE_SIZE + self.outer)
        whole = np.eye(len(indices))
        whole[:STATE_SIZE, :STATE_SIZE] = self.basis
        in_chart = whole @ of_motion[np.ix_(indices, indices)] @ whole.T
        of_u = np.arange(STATE_SIZE, len(indices))
        order = np.concatenate([np.arange(self.softs), of_u, np.arange(self.softs, STATE_SIZE)])
        return in_chart[np.ix_(order, order)]

    def coordinates(self, motions: LanderMotions) -> tuple[np.ndarray, np.ndarray]:
        """Return y (K, d) and z (K, q) of motions."""
        x = motions.from_centre(self.centre)
        along = x[:, :STATE_SIZE] @ self.basis.T
        y = np.concatenate([along[:, : self.softs], x[:, UNKNOWNS][:, self.outer]], axis=1)
        return y, along[:, self.softs :]

    def motions(self, y: np.ndarray, z: np.ndarray, u: np.ndarray) -> LanderMotions:
        """Return the motions at y (K, d) and z (K, q), their reading unknowns as in u (K, m)."""
        step = np.linalg.solve(self.basis, np.concatenate([y[:, : self.softs], z], axis=1).T).T
        u = np.array(u)
        u[:, self.outer] = self.centre.u[:, self.outer] + y[:, self.softs :]
        at = self.centre.take(np.zeros(len(y), dtype=np.int64)).moved(
            np.concatenate([step, np.zeros_like(u)], axis=1)
        )
        return LanderMotions(at.omega, at.sun, u)

    def log_volume(self, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return the log (K) of the volume in rate, solid angle and unknowns per unit of volume in y, z.

        It is minus infinity beyond half a turn from the centre: there the coordinates would count a direction twice.
        """
        step = np.linalg.solve(self.basis, np.concatenate([y[:, : self.softs], z], axis=1).T).T
        angle = np.linalg.norm(step[:, SUN], axis=1)
        sphere = np.log(np.maximum(np.sinc(angle / np.pi), 1e-300))  # sin(angle) / angle
        return np.where(angle < np.pi, sphere - np.linalg.slogdet(self.basis)[1], -np.inf)

    def stiff_steps(self, motions: LanderMotions, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return the steps (K, 5, q) of rate and direction, in the motions' own tangents, per unit of z while y is held."""
        size, steps = 1e-5, []
        for direction in np.eye(self.stiff):
            shifted = self.motions(y, z + size * direction, motions.u)
            steps.append(shifted.from_centre(motions)[:, :STATE_SIZE] / size)
        return np.stack(steps, axis=2)


class Proposals(NamedTuple):
    """All N proposals from one ridge so far: y (N, d), z (N, q) and the whole motions, `motions`.

    `log_inner` (N): log of the density with which z was drawn given y; `log_mass` (N): log of the posterior density over y and z,
    with the reading unknowns integrated out by :func:`complete_motions`.
    """

    y: np.ndarray
    z: np.ndarray
    log_inner: np.ndarray
    log_mass: np.ndarray
    motions: LanderMotions


class StiffFit(NamedTuple):
    """Points of a ridge: the best stiff coordinates of motions at fixed outer coordinates y (n, d).

    `best` (n, q), and Cholesky factors `root` (n, q, q) of their covariance; u (n, m) with the best reading unknowns; `slopes`:
    derivatives there, but for the last step.
    """

    y: np.ndarray
    best: np.ndarray
    root: np.ndarray
    u: np.ndarray
    slopes: MotionSlopes

    def slopes_near(self, y: np.ndarray, law: OuterLaw) -> MotionSlopes:
        """Return the derivatives at the point nearest to each y (n, d), in sigmas of the law."""
        sigma = np.sqrt(np.einsum("cii->i", law.covariance) / len(law.weight))
        nearest = KDTree(self.y / sigma).query(y / sigma)[1]
        return take_problems(self.slopes, nearest)


@dataclass
class Ridge:
    """A ridge of the posterior and the draws from it.

    `coefficients` (M, q): the best stiff coordinates z*(y) as polynomials of y; `scatter` (q, q): covariance of z about these.
    Laws of y: `first` from the curvature at the motions; `learnt` from the draws; `proposing`: those of the next round, with their
    shares; `laws`: those of all rounds so far, with the number of draws from each. `log_promise`: log probability by Laplace's
    method, up to a constant that all ridges share.
    """

    chart: Chart
    coefficients: np.ndarray
    scatter: np.ndarray
    first: OuterLaw
    proposing: list[tuple[float, OuterLaw]]
    learnt: OuterLaw
    log_promise: float
    laws: list[tuple[int, OuterLaw]]
    proposals: Proposals | None = None
    points: StiffFit | None = None

    @property
    def drawn(self) -> int:
        """Return how many draws were proposed."""
        return sum(count for count, _ in self.laws)

    def best(self, y: np.ndarray) -> np.ndarray:
        """Return the predicted best stiff coordinates (n, q) at y (n, d)."""
        return monomials(y, self.chart.curved) @ self.coefficients

    def log_outer(self, y: np.ndarray, freedom: float) -> np.ndarray:
        """Return the log density (n) with which all rounds together have proposed y (n, d): the mixture of their laws."""
        of_rounds = [
            logsumexp(law.log_densities(y, freedom), axis=1) + np.log(count / self.drawn)
            for count, law in self.laws
        ]
        return np.asarray(logsumexp(of_rounds, axis=0))

    def log_weights(self, freedom: float) -> np.ndarray:
        """Return the log (N) of the posterior density at each proposal over the density with which it was proposed."""
        proposals = self.proposals
        assert proposals is not None
        return proposals.log_mass - proposals.log_inner - self.log_outer(proposals.y, freedom)

    def log_density(self, motions: LanderMotions, freedom: float) -> np.ndarray:
        """Return the log of the approximate number density of this ridge's proposals at motions (n).

        It is over rate, solid angle and unknowns. It divides motions between overlapping ridges; for that it may be
        approximate, as the weights are exact whenever the parts of a motion add to one.
        """
        y, z = self.chart.coordinates(motions)
        root = np.linalg.cholesky(self.scatter)
        off = np.linalg.solve(root, (z - self.best(y)).T).T
        inner = student_log_density(off, freedom) - np.log(np.diag(root)).sum()
        volume = self.chart.log_volume(y, z)
        return np.log(self.drawn) + self.log_outer(y, freedom) + inner - volume


class Peak(NamedTuple):
    """Normal approximation of the posterior about a fitted motion.

    `log_mass`: log of its integral; `step` (D): from the fitted motion to the mean; `covariance` (D, D) of rate, direction and
    unknowns.
    """

    log_mass: float
    step: np.ndarray
    covariance: np.ndarray


def ridges_of(target: LanderTarget, fit: ModelFit, s: SamplingSettings) -> list[Ridge]:
    """Return the ridges on which the fitted motions lie, the most probable first.

    A motion on the ridge of a more probable one becomes a component of its outer law.
    """
    model = target.model
    least = np.diag([model.max_rate**-2] * 3 + [1.0] * 2 + [0.0] * len(model.unknowns))
    covariance = np.linalg.inv(fit.motions.curvature + least)
    covariance = (covariance + np.swapaxes(covariance, 1, 2)) / 2
    log_mass = -fit.motions.cost + np.linalg.slogdet(covariance)[1] / 2
    # An unknown may have several prior sigmas. The weight of its prior in the fit is the inverse square of the effective one, over
    # `Unknown.sigma`.
    fitted_share = 1 / np.sqrt(model.prior_cost(fit.motions.u)[1])
    ridges: list[Ridge] = []
    for i in np.argsort(-log_mass, kind="stable"):
        if log_mass[i] < log_mass.max() + np.log(s.least) or len(ridges) >= s.most_ridges:
            break
        motion = fit.motions.bare.take([i])
        as_fitted = Peak(float(log_mass[i]), np.zeros(len(covariance[i])), covariance[i])
        peaks = over_sizes(target, motion.u[0], as_fitted, fitted_share[i], s)
        for ridge in ridges:
            y, z = ridge.chart.coordinates(motion)
            off = np.concatenate([y, z], axis=1)[0]
            own = ridge.chart.covariance(covariance[i])
            if off @ np.linalg.solve(own, off) < s.on_ridge * len(off):
                added = _components(ridge.chart, peaks, y[0], ridge.log_promise)
                ridge.first = OuterLaw.joined(
                    [(1.0, ridge.first), (float(added.weight.sum()), added)]
                )
                ridge.proposing, ridge.learnt = [(1.0, ridge.first)], ridge.first
                break
        else:
            ridges.append(_ridge_about(target, motion, covariance[i], peaks, s))
    return ridges


def _ridge_about(
    target: LanderTarget,
    centre: LanderMotions,
    covariance: np.ndarray,
    peaks: list[Peak],
    s: SamplingSettings,
) -> Ridge:
    """Return a straight ridge about a motion with the covariance (D, D), before any draw."""
    chart = Chart.about(target, centre, covariance, s)
    d, promise = chart.dimensions, max(peak.log_mass for peak in peaks)
    joint = chart.covariance(covariance)  # of y and z
    of_y, of_z, linear = slice(0, d), slice(d, None), slice(1, 1 + d)
    # z depends on y by the regression of the covariance; terms with products of y are zero until points are known
    coefficients = np.zeros((monomials(np.zeros((1, d)), chart.curved).shape[1], chart.stiff))
    coefficients[linear] = np.linalg.solve(joint[of_y, of_y], joint[of_y, of_z])
    scatter = joint[of_z, of_z] - joint[of_z, of_y] @ coefficients[linear]
    law = _components(chart, peaks, np.zeros(d), promise)
    law = law._replace(covariance=s.widened * law.covariance)
    return Ridge(
        chart=chart,
        coefficients=coefficients,
        scatter=(scatter + scatter.T) / 2,
        first=law,
        proposing=[(1.0, law)],
        learnt=law,
        log_promise=promise,
        laws=[],
    )


def _components(chart: Chart, peaks: list[Peak], y: np.ndarray, log_promise: float) -> OuterLaw:
    """Return an outer law with a component for each peak of a motion at y (d), weighed relative to the mass of their ridge."""
    log_mass, step, covariance = (np.array(values) for values in zip(*peaks, strict=True))
    along = step[:, :STATE_SIZE] @ chart.basis.T
    steps = np.concatenate([along[:, : chart.softs], step[:, STATE_SIZE + chart.outer]], axis=1)
    of_y = slice(0, len(y))
    covariance_y = np.array([chart.covariance(matrix)[of_y, of_y] for matrix in covariance])
    # weights are less unequal than the masses, as Laplace's method may be wrong by a few units of the log
    weight = np.exp(np.clip(0.7 * (log_mass - log_promise), -8.0, 8.0))
    return OuterLaw(weight, y + steps, covariance_y)


def over_sizes(
    target: LanderTarget, u: np.ndarray, fitted: Peak, fitted_share: np.ndarray, s: SamplingSettings
) -> list[Peak]:
    """Return the peaks of a motion with unknowns u (m), one for each combination of prior sigmas that its unknowns may have.

    They follow by linear theory from the peak `fitted`, whose prior sigmas are `fitted_share` (m) times `Unknown.sigma`. Peaks that
    move too far are left out, as linear theory does not hold there: a torque that rotates the momentum about the Sun hardly changes
    readings, and would be placed whole revolutions away.
    """
    peaks = [fitted]
    kinds = dict.fromkeys(
        unknown.kind for unknown in target.model.unknowns if len(unknown.shares) > 1
    )
    for kind in kinds:  # all unknowns of a kind have the same share
        indices = np.array(target.model.indices(kind))
        before = float(fitted_share[indices[0]])
        shares = target.model.unknowns[indices[0]].shares
        resized = (
            _with_prior_sigmas(peak, u, indices, before, share, s)
            for peak in peaks
            for share in shares
        )
        peaks = [peak for peak in resized if peak is not None]
    return peaks


def _with_prior_sigmas(
    peak: Peak, u: np.ndarray, indices: np.ndarray, before: float, share: float, s: SamplingSettings
) -> Peak | None:
    """Return `peak` if the prior sigmas of the unknowns `indices` are `share`, not `before`; None if its mean moves too far.

    Both are factors of `Unknown.sigma`. Let v be these unknowns at the old mean. The new prior adds a v^2 / 2 to the cost, with
    a = 1 / share^2 - 1 / before^2, and a to the curvature. One Newton step d = C g leads to the new mean, with the new covariance C
    and the gradient g = -a v of the log density. The log mass grows by (g d - a v^2) / 2, by half the change of log det C, and by
    the norm of the prior, -log(share / before) for each unknown.
    """
    at, added = STATE_SIZE + indices, share**-2 - before**-2
    precision, gradient = np.linalg.inv(peak.covariance), np.zeros(len(peak.covariance))
    precision[at, at] += added
    value = u[indices] + peak.step[at]  # of the unknowns at the old mean
    gradient[at] = -added * value
    covariance = np.linalg.inv(precision)
    step = covariance @ gradient
    if share > before and np.linalg.norm(value + step[at]) > s.far_torque * share:
        return None  # linear theory does not hold so far away (`over_sizes`)
    gain = (gradient @ step - added * value @ value) / 2
    volume = (np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(peak.covariance)[1]) / 2
    log_mass = peak.log_mass + gain + volume - len(indices) * np.log(share / before)
    return Peak(float(log_mass), peak.step + step, covariance)


def fit_stiff(
    target: LanderTarget, ridge: Ridge, y: np.ndarray, near: MotionSlopes | None
) -> StiffFit:
    """Return the stiff coordinates and reading unknowns of largest posterior density at fixed outer coordinates y (n, d).

    The fit starts on the curve of the ridge. `near`: motions near the starts with their derivatives, if there are any: then few
    steps are enough, mostly one and the last one, whose cost is not computed. The terms are those of the head of this file.
    """
    chart = ridge.chart
    reading, q = target.reading_unknowns, chart.stiff

    # The state of the fit is y, z, u and the derivatives near by, if there are any. A step has q components of z, then those of the
    # reading unknowns.
    def equations(noise_factor: float, state: tuple[Any, ...]) -> DenseSystem:
        """Return the equations of the target in these coordinates, by the chain rule."""
        y, z, u, slopes = state
        motions = chart.motions(y, z, u)
        system = target.linearised(motions, slopes, noise_factor)
        change = np.zeros((len(y), STATE_SIZE + len(reading), q + len(reading)))
        change[:, :STATE_SIZE, :q] = chart.stiff_steps(motions, y, z)
        change[:, STATE_SIZE:, q:] = np.eye(len(reading))
        slope = np.einsum("kij,ki->kj", change, system.slope)
        matrix = np.swapaxes(change, 1, 2) @ system.matrix @ change
        matrix[:, range(q), range(q)] += LOOSEST_RAD**-2
        return DenseSystem(system.cost, matrix, slope, extras=system.extras)

    def moved(state: tuple[Any, ...], step: np.ndarray) -> tuple[Any, ...]:
        """Return the state after a step of stiff coordinates and reading unknowns."""
        y, z, u, slopes = state
        u = np.array(u)
        u[:, reading] += step[:, q:]
        return y, z + step[:, :q], u, slopes

    def with_slopes(state: tuple[Any, ...], system: DenseSystem) -> tuple[Any, ...]:
        """Return the state with the derivatives of its equations, for the next ones."""
        return *state[:3], system.extras

    u = np.tile(chart.centre.u, (len(y), 1)) if near is None else near.u
    state: tuple[Any, ...] = y, ridge.best(y), u, near
    system: DenseSystem | None = None
    # a far start is first fitted under a larger noise, so that no reading counts as an outlier because of the start
    for noise_factor, steps in WARM if near is not None else COLD:
        system = equations(noise_factor, state)
        state = with_slopes(state, system)
        # most predicted starts are so near that the last step is enough; a gain of NaN is far too
        far = np.flatnonzero(~(solve_dense(system, np.zeros(len(y)))[1] < SETTLED_GAIN))
        if len(far):
            solution = least_squares(
                lambda at, noise_factor=noise_factor: equations(noise_factor, at),
                moved,
                solve_dense,
                take_problems(state, far),
                steps=steps,
                tolerance=SETTLED_GAIN,
                system=take_problems(system, far),
                carry=with_slopes,
            )
            state = replace_problems(state, far, solution.state)
            system = replace_problems(system, far, solution.system)
    assert system is not None
    # the last step, if it is short enough for the equations to be linear
    covariance = np.linalg.inv(system.matrix)
    step = -np.einsum("kij,kj->ki", covariance, system.slope)
    length = -np.sum(system.slope * step, axis=1)
    fine = np.isfinite(step).all(axis=1) & (length < LONGEST_SIGMAS**2)
    _, z, u, slopes = moved(state, np.where(fine[:, None], step, 0.0))
    # covariance of z with free reading unknowns, which are drawn too
    of_z = covariance[:, :q, :q]
    root = np.linalg.cholesky((of_z + np.swapaxes(of_z, 1, 2)) / 2)
    return StiffFit(y, z, root, u, slopes)


def reading_law(
    target: LanderTarget, track: np.ndarray, u: np.ndarray, s: SamplingSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Return the best reading unknowns (n, s) given the motions, and the Cholesky factors (n, s, s) of their precision.

    Readings are nearly linear in these unknowns, so that their density given motion and noise is nearly normal: one Newton step
    from u (n, m) finds it.
    """
    before = u[:, target.reading_unknowns]
    slope, curvature = target.reading_slopes(track, u)
    curvature = curvature + np.eye(before.shape[1])  # of the prior
    step = np.linalg.solve(curvature, (slope - before)[:, :, None])[:, :, 0]
    best = before + np.clip(step, -s.reading_step, s.reading_step)
    return best, np.linalg.cholesky(curvature)


def complete_motions(
    target: LanderTarget,
    motions: LanderMotions,
    log_volume: np.ndarray,
    rng: np.random.Generator,
    s: SamplingSettings,
) -> tuple[LanderMotions, np.ndarray]:
    """Return n motions with reading unknowns drawn, and the `log_mass` (n) of each (:class:`Proposals`).

    Several sets of these unknowns are drawn for each motion, which need not run again for them. The mass is the mean of their
    weights, and one set is chosen with a probability in proportion to its weight. With one set only, a draw in the tails of the
    normal law might outweigh all others. The step to the best reading unknowns begins at those of the motions. `log_volume` (n): of
    :meth:`Chart.log_volume`.
    """
    reading = target.reading_unknowns
    count = s.reading_draws if len(reading) else 1
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

    # draw from a normal law: with the Cholesky factor R of its precision a draw is the best plus R^-T times white numbers
    best, root = reading_law(target, track, possible.u, s)
    step = np.linalg.solve(np.swapaxes(root, 1, 2), np.swapaxes(white, 1, 2))
    drawn = best[:, None] + np.swapaxes(step, 1, 2)  # (rows, count, unknowns)
    log_density = np.log(np.einsum("kii->ki", root)).sum(axis=1)[:, None]  # at the middle
    log_law = log_density - np.sum(white**2 + np.log(2 * np.pi), axis=2) / 2

    # weigh each draw by likelihood and prior over that law; `log_mass` has the normal prior at u, that of a draw follows
    before = possible.u[:, None, reading]
    prior_change = (np.sum(before**2, axis=2) - np.sum(drawn**2, axis=2)) / 2
    u_drawn = np.repeat(possible.u, count, axis=0)
    u_drawn[:, reading] = drawn.reshape(len(u_drawn), len(reading))
    log_likelihood = target.log_likelihood(np.repeat(track, count, axis=0), u_drawn)
    log_weight = log_likelihood.reshape(len(rows), count) + prior_change - log_law
    log_weight = np.where(np.isnan(log_weight), -np.inf, log_weight)
    total = logsumexp(log_weight, axis=1, keepdims=True)
    log_mass[rows] += total[:, 0] - np.log(count)

    # choose the draw at which the cumulative weight passes a random part of the total
    share = np.cumsum(np.exp(log_weight - np.where(np.isfinite(total), total, 0.0)), axis=1)
    chosen = np.minimum((share < chance[rows, None] * share[:, -1:]).sum(axis=1), count - 1)
    u = motions.u.copy()
    u[rows[:, None], reading] = drawn[np.arange(len(rows)), chosen]
    return replace(motions, u=u), log_mass


def trace_ridge(
    target: LanderTarget, ridge: Ridge, count: int, rng: np.random.Generator, s: SamplingSettings
) -> None:
    """Fit the curve of a ridge to `count` points at each of several widths about its motion.

    Narrow widths come first, so that their curve and their derivatives give good starts for the wider ones.
    """
    for width in s.trace_widths:
        law = ridge.first
        which = rng.choice(len(law.weight), count, p=law.weight / law.weight.sum())
        root = np.linalg.cholesky(law.covariance)[which]
        white = rng.standard_normal((count, law.mean.shape[1]))
        y = law.mean[which] + width * np.einsum("nij,nj->ni", root, white)
        points = ridge.points
        near = None if points is None else points.slopes_near(y, law)
        stiff = fit_stiff(target, ridge, y, near)
        ridge.points = stiff if points is None else join_problems([points, stiff])
        fit_ridge_curve(ridge, s)


def propose(
    target: LanderTarget, ridge: Ridge, count: int, rng: np.random.Generator, s: SamplingSettings
) -> None:
    """Draw `count` motions from the present laws of a ridge, by the three steps of this module, and add them to its proposals.

    The ridge also gets the new points at which its stiff coordinates were fitted, and the laws, each with its number of draws.
    """
    chart, before = ridge.chart, ridge.points
    assert before is not None
    parts, points = [ridge.proposals] if ridge.proposals is not None else [], [before]
    # divide the draws among the laws by their shares, rounded to whole numbers
    ends = np.round(count * np.cumsum([share for share, _ in ridge.proposing])).astype(int)
    counts = np.diff(np.minimum(ends, count), prepend=0)
    counts[-1] += count - counts.sum()
    drawn = [(int(n), law) for n, (_, law) in zip(counts, ridge.proposing, strict=True) if n]
    y_all = np.concatenate([law.draw(n, rng, s.freedom) for n, law in drawn])
    for y in np.array_split(y_all, -(-count // s.block)):
        stiff = fit_stiff(target, ridge, y, before.slopes_near(y, ridge.learnt))
        step, white = student_draws(s.inner_width * stiff.root, rng, s.freedom)
        volume = np.log(s.inner_width * np.einsum("kii->ki", stiff.root)).sum(axis=1)
        z = stiff.best + step
        motions, log_volume = chart.motions(y, z, stiff.u), chart.log_volume(y, z)
        motions, log_mass = complete_motions(target, motions, log_volume, rng, s)
        log_inner = student_log_density(white, s.freedom) - volume
        parts.append(Proposals(y, z, log_inner, log_mass, motions))
        points.append(stiff)
    motions = LanderMotions.joined([part.motions for part in parts])
    ridge.proposals = Proposals(*join_problems([part[:4] for part in parts]), motions)
    ridge.points = join_problems(points)
    ridge.laws += drawn


def fit_ridge_curve(ridge: Ridge, s: SamplingSettings) -> None:
    """Fit the best stiff coordinates at all known points by quadratic polynomials of the outer ones; far points count less.

    A point counts by 1 / (1 + its squared distance from the middle of the outer law, in sigmas and for each coordinate).
    """
    points, law = ridge.points, ridge.learnt
    assert points is not None
    terms = monomials(points.y, ridge.chart.curved)
    least = s.points_per_term * terms.shape[1]
    good = np.isfinite(points.best).all(axis=1)
    mean = law.weight @ law.mean / law.weight.sum()
    root = np.linalg.cholesky(np.einsum("c,cij->ij", law.weight, law.covariance) / law.weight.sum())
    off = law.straight(points.y) - mean
    far = np.sum(np.linalg.solve(root, off.T) ** 2, axis=0) / len(mean)
    coefficients = ridge.coefficients
    for _ in range(CURVE_FITS):
        # again without points that are far off: least squares has led them to another ridge
        if good.sum() < least:
            return
        weight = 1 / (1 + far[good])[:, None]
        size = np.abs(terms[good]).max(axis=0)
        scaled = weight * terms[good] / size
        # normal equations take a tenth of the time of a singular value decomposition, and are accurate enough for predictions
        normal = scaled.T @ scaled
        normal[np.diag_indices(len(normal))] += RIDGE_FLOOR * np.trace(normal)
        coefficients = np.linalg.solve(normal, scaled.T @ (weight * points.best[good]))
        coefficients /= size[:, None]
        off = np.linalg.norm((points.best - terms @ coefficients) / (1 + far)[:, None], axis=1)
        good &= off <= max(s.off_ridge * float(np.median(off[good])), 1e-12)
    ridge.coefficients = coefficients
