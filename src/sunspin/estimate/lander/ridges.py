"""A ridge of the posterior: its coordinates, the laws from which motions on it are proposed, and what was proposed.

Uncertain moments, friction and wheel speeds turn the posterior about a motion into a thin curved ridge. A proposal has three steps:

1. *Outer* coordinates y come from a mixture of Student laws, which learns from the draws. They are the unknowns on which the motion
   depends, the noise, and those directions of rate and Sun that are weakly constrained even if the unknowns are held.
2. For each y least squares finds the best *stiff* coordinates z*(y), the other directions of rate and Sun. They are drawn about
   z*(y), with their own curvature there. A quadratic regression on earlier points predicts z*(y), and derivatives come from the
   nearest point, so that a draw takes three runs of its motion.
3. Unknowns that change the readings only (brightness, gains, misalignments) are drawn given the motion, several times.

The density of each step is known, so that the weights are exact. An approximation in a proposal costs draws, but changes no result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy.special import gammaln, logsumexp

from sunspin.estimate.lander.motions import SUN, UNKNOWNS, ShotFit, Shots
from sunspin.estimate.model import Unknown
from sunspin.estimate.settings import SamplingSettings
from sunspin.solve.least_squares import least_squares, replace_problems, take_problems
from sunspin.solve.linear import DenseSystem, solve_dense
from sunspin.solve.weights import effective_draws

FIVE = 5
"""Directions of rate and Sun together."""

LOOSEST_RAD = 3.0
"""No stiff direction is drawn wider than with this sigma (rad): beyond it a direction has come round."""

LONGEST_SIGMAS = 3.0
"""A last step of least squares longer than this, in its own sigmas, is not taken: there the equations are not linear."""

COLD, WARM = ((3.0, 2), (1.0, 4)), ((1.0, 3),)
"""(factor on the noise, steps) of least squares from a start far from the ridge, and from one that is predicted."""

SETTLED_GAIN = 4.0
"""Gain in cost that a step must promise to be tried, and for another to follow: 2.8 sigma of the stiff coordinates. What is left is
taken by a last step that is not tried. With 1.0 a draw of Philae takes 3.5 runs instead of 2.8, and draws are not better."""


class Slopes(NamedTuple):
    """Derivatives at K motions, from which those at motions near by begin.

    `shots`: the motions; `moves` (K, 5, ...): change of what sensors see per unit of rate and direction; `seen` (K, ...): that.
    """

    omega: np.ndarray
    sun: np.ndarray
    u: np.ndarray
    moves: np.ndarray
    seen: np.ndarray


class Equations(NamedTuple):
    """Normal equations of K motions in their five directions, and in the unknowns on which the readings alone depend.

    `cost` (K): minus the log of the posterior density, up to a constant; `slope` (K, q) and `matrix` (K, q, q).
    """

    cost: np.ndarray
    slope: np.ndarray
    matrix: np.ndarray
    slopes: Slopes


class Target(Protocol):
    """A posterior that is sampled: of one model, with K motions evaluated at once.

    Its unknowns have a standard normal prior.
    """

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the unknowns (m)."""
        ...

    @property
    def standing(self) -> np.ndarray:
        """Return the places of unknowns that change the readings only."""
        ...

    @property
    def bending(self) -> np.ndarray:
        """Return the places of unknowns that change the motion."""
        ...

    @property
    def reach_s(self) -> float:
        """Return the time from the reference to the farthest sample."""
        ...

    @property
    def rate_max(self) -> float:
        """Return the largest rate (rad/s)."""
        ...

    def linearised(
        self, shots: Shots, slopes: Slopes | None = None, wider: float = 1.0
    ) -> Equations:
        """Return the equations under `wider` times the noise.

        Derivatives begin with the `slopes` of motions near by, if given, and are corrected by what a step in rate and direction
        alone has changed.
        """
        ...

    def run(self, shots: Shots) -> Any:
        """Return what sensors see of the motions."""
        ...

    def standing_slopes(
        self, seen: Any, u: np.ndarray, wider: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return slope (K, s) and curvature (K, s, s) of the log likelihood in the standing unknowns, under `wider` noise."""
        ...

    def log_likelihood(self, seen: Any, u: np.ndarray) -> np.ndarray:
        """Return the log likelihood (K)."""
        ...

    def log_prior(self, shots: Shots) -> np.ndarray:
        """Return the log prior density (K) over rates (rad/s), directions and unknowns; minus infinity where none is possible."""
        ...


class Bend(NamedTuple):
    """Coordinates y (d) in which the t thin directions `across` (d, t) of a curved ridge follow the f others.

    `along` (f, d): those others as combinations of y - `centre` (d); `answer` (M, t): what the thin ones follow, by
    :func:`monomials` of the others. Straight coordinates are y without that. Both have the same volume, since `along` times
    `across` is zero.
    """

    centre: np.ndarray
    across: np.ndarray
    along: np.ndarray
    answer: np.ndarray

    def straight(self, y: np.ndarray) -> np.ndarray:
        """Return the straight coordinates (n, d) of points y (n, d)."""
        return y - self._followed(y)

    def bent(self, straight: np.ndarray) -> np.ndarray:
        """Return the points y (n, d) at straight coordinates (n, d)."""
        return straight + self._followed(straight)

    def _followed(self, y: np.ndarray) -> np.ndarray:
        """Return by how much (n, d) the thin directions follow; it is the same for y and for its straight coordinates."""
        free = (y - self.centre) @ self.along.T
        return monomials(free, np.arange(free.shape[1])) @ self.answer @ self.across.T

    @classmethod
    def of(cls, y: np.ndarray, weight: np.ndarray, s: SamplingSettings) -> Bend | None:
        """Return how the weighted draws y (n, d) are bent; None if no direction follows the others, or the draws are too few."""
        centre, count = weight @ y, effective_draws(weight)
        off = y - centre
        sigma = np.sqrt(weight @ off**2)
        if not np.all(sigma > 0):
            return None
        # principal directions of the correlation: of independent coordinates all would have size one
        value, vector = np.linalg.eigh((weight[:, None] * off).T @ off / np.outer(sigma, sigma))
        size = np.sqrt(value.clip(1e-12))
        white, root = (off / sigma) @ vector / size, np.sqrt(weight)[:, None]
        thin = size < s.thin
        while thin.any():
            terms = monomials(white[:, ~thin], np.arange(int(np.sum(~thin))))
            if count < s.draws_per_term * terms.shape[1]:
                return None
            answer = np.linalg.lstsq(root * terms, root * white[:, thin], rcond=1e-10)[0]
            left = weight @ (white[:, thin] - terms @ answer) ** 2
            straight = left * count / (count - terms.shape[1]) > s.straight**2
            if not straight.any():
                across = vector[:, thin] * (size[thin] * sigma[:, None])
                return cls(
                    centre, across, (vector[:, ~thin] / size[~thin] / sigma[:, None]).T, answer
                )
            thin[np.flatnonzero(thin)[straight]] = False
        return None


class Law(NamedTuple):
    """A mixture of Student laws in d dimensions: `weight` (C), `mean` (C, d), `covariance` (C, d, d).

    `stands_on` (C): the draw on which a component stands, -1 for none. Means and covariances are in the straight coordinates of
    `bend`, if there is one.
    """

    weight: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    stands_on: np.ndarray
    bend: Bend | None = None

    def straight(self, y: np.ndarray) -> np.ndarray:
        """Return points y (n, d) in the coordinates of the means."""
        return y if self.bend is None else self.bend.straight(y)

    def draw(self, n: int, rng: np.random.Generator, freedom: float) -> np.ndarray:
        """Return n draws (n, d), stratified over the components."""
        edges = np.cumsum(self.weight) / self.weight.sum()
        which = np.searchsorted(edges, (np.arange(n) + rng.random()) / n)
        which = np.minimum(which, len(edges) - 1)
        step, _ = student_draws(np.linalg.cholesky(self.covariance)[which], rng, freedom)
        y = self.mean[which] + step
        return y if self.bend is None else self.bend.bent(y)

    def log_densities(self, y: np.ndarray, freedom: float) -> np.ndarray:
        """Return the log density (n, C) of each component times its weight at y (n, d)."""
        root, y = np.linalg.cholesky(self.covariance), self.straight(y)
        # all draws so far pass here in each round: a product with the inverse takes a sixth of the time of a solution
        parts = [
            student_log_density((y - mean) @ whitening.T, freedom)
            + np.log(np.diag(whitening)).sum()
            for whitening, mean in zip(np.linalg.inv(root), self.mean, strict=True)
        ]
        with np.errstate(divide="ignore"):
            return np.stack(parts, axis=1) + np.log(self.weight / self.weight.sum())

    @staticmethod
    def joined(parts: Sequence[tuple[float, Law]]) -> Law:
        """Return one mixture of several in these shares, all with the bend of the first."""
        weight = np.concatenate([share * law.weight / law.weight.sum() for share, law in parts])
        mean = np.concatenate([law.mean for _, law in parts])
        covariance = np.concatenate([law.covariance for _, law in parts])
        stands_on = np.concatenate([law.stands_on for _, law in parts])
        return Law(weight, mean, covariance, stands_on, parts[0][1].bend)


def student_draws(
    root: np.ndarray, rng: np.random.Generator, freedom: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return draws (n, d) about zero of Student laws with Cholesky factors `root` (n, d, d), and the same in sigmas."""
    n, d = root.shape[:2]
    white = rng.standard_normal((n, d)) * np.sqrt(freedom / rng.chisquare(freedom, n))[:, None]
    return np.einsum("nij,nj->ni", root, white), white


def student_log_density(white: np.ndarray, freedom: float) -> np.ndarray:
    """Return the log density (n) of a Student law at distances (n, d) in sigmas."""
    d = white.shape[1]
    constant = gammaln((freedom + d) / 2) - gammaln(freedom / 2) - d / 2 * np.log(freedom * np.pi)
    return constant - (freedom + d) / 2 * np.log1p((white**2).sum(axis=1) / freedom)


@dataclass(frozen=True)
class Chart:
    """Coordinates y, z about a fitted motion, the `centre`.

    `basis` (5, 5) turns steps of rate and direction into five directions, the weakly constrained ones first. y are `softs` of these
    and the unknowns at `outer`; z are the other q directions. `bending` (of y): coordinates in which the ridge is curved.
    """

    centre: Shots
    basis: np.ndarray
    softs: int
    outer: np.ndarray
    bending: np.ndarray

    @classmethod
    def about(
        cls, target: Target, centre: Shots, covariance: np.ndarray, s: SamplingSettings
    ) -> Chart:
        """Return the coordinates about a motion with the covariance (D, D).

        The directions are those of the covariance while the outer unknowns are held, with rates as the turn within the window. One
        that is then known well is stiff, however wide it is when the unknowns vary: as an outer coordinate it would make the law
        of y as thin and as curved as the ridge itself.
        """
        outer = np.setdiff1d(np.arange(len(target.unknowns)), target.standing)
        size = np.diag([target.reach_s] * 3 + [1.0] * 2)
        own, cross = covariance[:FIVE, :FIVE], covariance[:FIVE, FIVE + outer]
        of_u = covariance[np.ix_(FIVE + outer, FIVE + outer)]
        held = own - cross @ np.linalg.solve(of_u, cross.T) if len(outer) else own
        held = size @ held @ size
        variance, vectors = np.linalg.eigh((held + held.T) / 2)
        softs = int(np.clip(np.sum(variance > s.soft_rad**2), len(outer) == 0, s.most_softs))
        bending = np.append(np.arange(softs), softs + np.searchsorted(outer, target.bending))
        return cls(centre, vectors[:, ::-1].T @ size, softs, outer, bending)

    @property
    def dimensions(self) -> int:
        """Return how many outer coordinates there are."""
        return self.softs + len(self.outer)

    @property
    def stiff(self) -> int:
        """Return how many stiff coordinates there are."""
        return FIVE - self.softs

    def covariance(self, of_motion: np.ndarray) -> np.ndarray:
        """Return a covariance (D, D) of rate, direction and unknowns as that of (y, z)."""
        places = np.append(np.arange(FIVE), FIVE + self.outer)
        whole = np.eye(len(places))
        whole[:FIVE, :FIVE] = self.basis
        found = whole @ of_motion[np.ix_(places, places)] @ whole.T
        of_u = np.arange(FIVE, len(places))
        order = np.concatenate([np.arange(self.softs), of_u, np.arange(self.softs, FIVE)])
        return found[np.ix_(order, order)]

    def coordinates(self, shots: Shots) -> tuple[np.ndarray, np.ndarray]:
        """Return y (K, d) and z (K, q) of motions."""
        x = shots.from_centre(self.centre)
        along = x[:, :FIVE] @ self.basis.T
        y = np.concatenate([along[:, : self.softs], x[:, UNKNOWNS][:, self.outer]], axis=1)
        return y, along[:, self.softs :]

    def motions(self, y: np.ndarray, z: np.ndarray, u: np.ndarray) -> Shots:
        """Return the motions at y (K, d) and z (K, q), their standing unknowns as in u (K, m)."""
        step = np.linalg.solve(self.basis, np.concatenate([y[:, : self.softs], z], axis=1).T).T
        u = np.array(u)
        u[:, self.outer] = self.centre.u[:, self.outer] + y[:, self.softs :]
        at = self.centre.take(np.zeros(len(y), dtype=np.int64)).moved(
            np.concatenate([step, np.zeros_like(u)], axis=1)
        )
        return Shots(at.omega, at.sun, u)

    def log_volume(self, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return the log (K) of the volume in rate, solid angle and unknowns per unit of volume in y, z.

        It is minus infinity beyond half a turn from the centre: there the coordinates would count a direction twice.
        """
        step = np.linalg.solve(self.basis, np.concatenate([y[:, : self.softs], z], axis=1).T).T
        angle = np.linalg.norm(step[:, SUN], axis=1)
        sphere = np.log(np.maximum(np.sinc(angle / np.pi), 1e-300))  # sin(angle) / angle
        return np.where(angle < np.pi, sphere - np.linalg.slogdet(self.basis)[1], -np.inf)

    def stiff_steps(self, shots: Shots, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return the steps (K, 5, q) of rate and direction, in the motions' own tangents, per unit of z while y is held."""
        size, steps = 1e-5, []
        for one in np.eye(self.stiff):
            there = self.motions(y, z + size * one, shots.u)
            steps.append(there.from_centre(shots)[:, :FIVE] / size)
        return np.stack(steps, axis=2)


def monomials(y: np.ndarray, bending: np.ndarray) -> np.ndarray:
    """Return one, the coordinates y (n, d), and the products of any two of those that bend a ridge (n, M)."""
    i, j = np.triu_indices(len(bending))
    part = y[:, bending]
    return np.concatenate([np.ones((len(y), 1)), y, part[:, i] * part[:, j]], axis=1)


class Pool(NamedTuple):
    """All proposals from one ridge so far (N).

    `y` (N, d) and `z` (N, q); `log_inner` (N): log density of z given y; `log_mass` (N): log of the posterior density over y, z,
    less that of the draw of the standing unknowns.
    """

    y: np.ndarray
    z: np.ndarray
    log_inner: np.ndarray
    log_mass: np.ndarray
    shots: Shots


class Known(NamedTuple):
    """Points y (N, d) at which the best stiff coordinates (N, q) of a ridge are known, and the derivatives there."""

    y: np.ndarray
    best: np.ndarray
    slopes: Slopes


@dataclass
class Ridge:
    """A ridge of the posterior and what was drawn from it.

    `answer` (M, q): the best stiff coordinates as polynomials of y; `scatter` (q, q): covariance of z about these. `first`: outer
    law from the curvature; `proposing`: those that propose now, with their shares; `learnt`: the one that the draws have taught;
    `laws`: those of all rounds, with the number of draws of each.
    """

    chart: Chart
    answer: np.ndarray
    scatter: np.ndarray
    first: Law
    proposing: list[tuple[float, Law]]
    learnt: Law
    log_promise: float
    laws: list[tuple[int, Law]]
    pool: Pool | None = None
    known: Known | None = None

    @property
    def drawn(self) -> int:
        """Return how many draws were proposed."""
        return sum(count for count, _ in self.laws)

    def best(self, y: np.ndarray) -> np.ndarray:
        """Return the predicted best stiff coordinates (n, q) at y (n, d)."""
        return monomials(y, self.chart.bending) @ self.answer

    def log_outer(self, y: np.ndarray, freedom: float, draws: bool = False) -> np.ndarray:
        """Return the log density (n) with which all rounds together proposed y (n, d).

        `draws`: y are the ridge's own draws, in order. A component that stands on a draw does not count for it: it stands there
        because the draw's weight was large, and would make it small. With it the evidence is short by 0.03 to 0.06.
        """
        every = []
        for count, law in self.laws:
            of_each = law.log_densities(y, freedom)
            if draws:
                own = np.flatnonzero(law.stands_on >= 0)
                of_each[law.stands_on[own], own] = -np.inf
            every.append(logsumexp(of_each, axis=1) + np.log(count / self.drawn))
        return np.asarray(logsumexp(every, axis=0))

    def log_share(self, shots: Shots, freedom: float) -> np.ndarray:
        """Return about the log of how often this ridge has proposed motions (n), per unit of their own volume.

        It only divides motions between ridges that overlap: the weights stay exact as long as the divisions add to one.
        """
        y, z = self.chart.coordinates(shots)
        root = np.linalg.cholesky(self.scatter)
        off = np.linalg.solve(root, (z - self.best(y)).T).T
        inner = student_log_density(off, freedom) - np.log(np.diag(root)).sum()
        volume = self.chart.log_volume(y, z)
        return np.log(self.drawn) + self.log_outer(y, freedom) + inner - volume


def ridges_of(
    target: Target, fit: ShotFit, under: np.ndarray | None, s: SamplingSettings
) -> list[Ridge]:
    """Return the ridges on which the fitted motions lie, the most probable first.

    A motion on the ridge of a more probable one becomes a component of its outer law. `under` (K, m): part of the sigma of each
    unknown under which each motion was fitted, if it has several (:attr:`Unknown.shares`); default: the whole.
    """
    least = np.diag([target.rate_max**-2] * 3 + [1.0] * 2 + [0.0] * len(target.unknowns))
    covariance = np.linalg.inv(fit.curvature + least)
    covariance = (covariance + np.swapaxes(covariance, 1, 2)) / 2
    mass = -fit.motions.cost + np.linalg.slogdet(covariance)[1] / 2
    under = np.ones_like(fit.motions.u) if under is None else under
    ridges: list[Ridge] = []
    for i in np.argsort(-mass, kind="stable"):
        if mass[i] < mass.max() + np.log(s.least) or len(ridges) >= s.most_ridges:
            break
        one = fit.motions.take([i])
        sized = over_sizes(target, one, covariance[i], float(mass[i]), under[i], s)
        for ridge in ridges:
            y, z = ridge.chart.coordinates(one)
            off = np.concatenate([y, z], axis=1)[0]
            own = ridge.chart.covariance(covariance[i])
            if off @ np.linalg.solve(own, off) < s.on_ridge * len(off):
                added = _components(ridge.chart, sized, y[0], ridge.log_promise)
                ridge.first = Law.joined([(1.0, ridge.first), (float(added.weight.sum()), added)])
                ridge.proposing, ridge.learnt = [(1.0, ridge.first)], ridge.first
                break
        else:
            ridges.append(_begun(target, one, covariance[i], sized, s))
    return ridges


def _begun(
    target: Target,
    centre: Shots,
    covariance: np.ndarray,
    sized: list[tuple[float, np.ndarray, np.ndarray]],
    s: SamplingSettings,
) -> Ridge:
    """Return a ridge about a motion, straight as its covariance (D, D) has it."""
    chart = Chart.about(target, centre, covariance, s)
    d, promise = chart.dimensions, max(mass for mass, _, _ in sized)
    whole = chart.covariance(covariance)
    answer = np.zeros((monomials(np.zeros((1, d)), chart.bending).shape[1], chart.stiff))
    answer[1 : 1 + d] = np.linalg.solve(whole[:d, :d], whole[:d, d:])
    scatter = whole[d:, d:] - whole[d:, :d] @ answer[1 : 1 + d]
    law = _components(chart, sized, np.zeros(d), promise)
    law = law._replace(covariance=s.widened * law.covariance)
    return Ridge(chart, answer, (scatter + scatter.T) / 2, law, [(1.0, law)], law, promise, [])


def _components(
    chart: Chart, sized: list[tuple[float, np.ndarray, np.ndarray]], y: np.ndarray, log_one: float
) -> Law:
    """Return the components of an outer law for a motion at y (d), weighed relative to the log mass `log_one`."""
    mass, step, covariance = (np.array(every) for every in zip(*sized, strict=True))
    d = len(y)
    steps = np.concatenate([step[:, :FIVE] @ chart.basis.T, step[:, FIVE + chart.outer]], axis=1)
    steps = np.concatenate([steps[:, : chart.softs], steps[:, FIVE:]], axis=1)
    every = np.array([chart.covariance(one)[:d, :d] for one in covariance])
    # less unequal than the masses: Laplace's method may be wrong by a few units
    weight = np.exp(np.clip(0.7 * (mass - log_one), -8.0, 8.0))
    return Law(weight, y + steps, every, np.full(len(weight), -1))


def over_sizes(
    target: Target,
    centre: Shots,
    covariance: np.ndarray,
    mass: float,
    under: np.ndarray,
    s: SamplingSettings,
) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """Return log mass, step from the centre (D) and covariance (D, D) under each share that the sigmas of unknowns may have.

    By linear theory from a fit `under` one share of each unknown (m). Far beyond the fitted size it does not hold: a torque that
    turns the momentum about the Sun is hardly seen, and would be put whole turns away. Such shares are left out.
    """
    found = [(mass, np.zeros(len(covariance)), covariance)]
    several = [one for one in target.unknowns if len(one.shares) > 1]
    for kind in dict.fromkeys(one.kind for one in several):
        places = np.array([i for i, one in enumerate(target.unknowns) if one.kind == kind])
        fitted = float(under[places[0]])
        found = [
            sized
            for one in found
            for share in target.unknowns[places[0]].shares
            if (sized := _resized(one, centre.u[0], places, share, fitted, s.far_torque))
        ]
    return found


def _resized(
    one: tuple[float, np.ndarray, np.ndarray],
    u: np.ndarray,
    places: np.ndarray,
    share: float,
    under: float,
    far: float,
) -> tuple[float, np.ndarray, np.ndarray] | None:
    """Return log mass, step and covariance with another share of the sigmas of the unknowns at `places`; None if it is too far."""
    mass, before, covariance = one
    at, more = FIVE + places, share**-2 - under**-2
    precision, pull = np.linalg.inv(covariance), np.zeros(len(covariance))
    precision[at, at] += more
    size = u[places] + before[at]
    pull[at] = -more * size
    spread = np.linalg.inv(precision)
    step = spread @ pull
    if share > under and np.linalg.norm(size + step[at]) > far * share:
        return None
    gain = (pull @ step - more * size @ size) / 2
    volume = (np.linalg.slogdet(spread)[1] - np.linalg.slogdet(covariance)[1]) / 2
    total = mass + gain + volume - len(places) * np.log(share / under)
    return float(total), before + step, spread


def settled(
    target: Target, chart: Chart, y: np.ndarray, z: np.ndarray, u: np.ndarray, near: Slopes | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, Slopes]:
    """Return the best stiff coordinates (n, q) at y (n, d), the Cholesky factors (n, q, q) of their covariance, u with the best
    standing unknowns, and the derivatives there.

    Starts are z (n, q) and u (n, m). With the derivatives of motions near by few steps are enough: most often one, and another that
    is not tried.
    """
    standing, q = target.standing, chart.stiff

    def equations(wider: float, state: tuple[Any, ...]) -> DenseSystem:
        y, z, u, *slopes = state
        shots = chart.motions(y, z, u)
        of = target.linearised(shots, Slopes(*slopes) if slopes else None, wider)
        step = np.zeros((len(y), FIVE + len(standing), q + len(standing)))
        step[:, :FIVE, :q] = chart.stiff_steps(shots, y, z)
        step[:, FIVE:, q:] = np.eye(len(standing))
        slope = np.einsum("kij,ki->kj", step, of.slope)
        matrix = np.swapaxes(step, 1, 2) @ of.matrix @ step
        matrix[:, range(q), range(q)] += LOOSEST_RAD**-2
        return DenseSystem(of.cost, matrix, slope, extras=tuple(of.slopes))

    def moved(state: tuple[Any, ...], step: np.ndarray) -> tuple[Any, ...]:
        u = np.array(state[2])
        u[:, standing] += step[:, q:]
        return (state[0], state[1] + step[:, :q], u, *state[3:])

    def carried(state: tuple[Any, ...], system: DenseSystem) -> tuple[Any, ...]:
        return (*state[:3], *system.extras)

    state: tuple[Any, ...] = (y, z, u, *(near or ()))
    system: DenseSystem | None = None
    # from afar under a wider noise first, so that no reading counts as an outlier because the start is off
    for wider, steps in WARM if near is not None else COLD:
        system = equations(wider, state)
        state = carried(state, system)
        # most predicted starts are so near that a step need not be tried
        far = np.flatnonzero(~(solve_dense(system, np.zeros(len(y)))[1] < SETTLED_GAIN))
        if len(far):
            found = least_squares(
                lambda at, wider=wider: equations(wider, at),
                moved,
                solve_dense,
                take_problems(state, far),
                steps=steps,
                tolerance=SETTLED_GAIN,
                system=take_problems(system, far),
                carry=carried,
            )
            state = replace_problems(state, far, found.state)
            system = replace_problems(system, far, found.system)
    assert system is not None
    covariance = np.linalg.inv(system.matrix)
    step = -np.einsum("kij,kj->ki", covariance, system.slope)
    length = -np.sum(system.slope * step, axis=1)
    fine = np.isfinite(step).all(axis=1) & (length < LONGEST_SIGMAS**2)
    _, z, u, *slopes = moved(state, np.where(fine[:, None], step, 0.0))
    inner = covariance[:, :q, :q]  # over the standing unknowns, as they are drawn too
    return z, np.linalg.cholesky((inner + np.swapaxes(inner, 1, 2)) / 2), u, Slopes(*slopes)


def standing_law(
    target: Target, seen: Any, u: np.ndarray, s: SamplingSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Return the best standing unknowns (n, s) given the motions, and the Cholesky factors (n, s, s) of their precision.

    Readings hardly bend with these, so that given motion and noise they are all but normal. Steps begin at u (n, m).
    """
    places, u = target.standing, np.array(u)
    curvature = np.tile(np.eye(len(places)), (len(u), 1, 1))
    for wider in s.standing_noise:
        slope, of_readings = target.standing_slopes(seen, u, wider)
        curvature = of_readings + np.eye(len(places))
        step = np.linalg.solve(curvature, (slope - u[:, places])[:, :, None])[:, :, 0]
        u[:, places] += np.clip(step, -s.standing_step, s.standing_step)
    return u[:, places], np.linalg.cholesky(curvature)


def weighed(
    target: Target,
    chart: Chart,
    y: np.ndarray,
    z: np.ndarray,
    u: np.ndarray,
    rng: np.random.Generator,
    s: SamplingSettings,
) -> tuple[Shots, np.ndarray]:
    """Return the motions at y, z with standing unknowns drawn about u (n, m), and the log (n) of their posterior density over y, z
    less that of this draw.

    For each motion several sets of standing unknowns are drawn, which take no run. One is kept, by its weight, and the density is
    the mean over all: the normal law has too light tails, and a single draw may outweigh all others.
    """
    shots, places, count = chart.motions(y, z, u), target.standing, s.standing_draws
    white = rng.standard_normal((len(y), count, len(places)))
    chance = rng.random(len(y))
    log_mass = chart.log_volume(y, z) + target.log_prior(shots)
    rows = np.flatnonzero(np.isfinite(log_mass))
    log_mass[np.setdiff1d(np.arange(len(y)), rows)] = -np.inf
    if not len(rows):
        return shots, log_mass
    some, white = shots.take(rows), white[rows]
    seen = target.run(some)
    best, root = standing_law(target, seen, some.u, s)
    step = np.linalg.solve(np.swapaxes(root, 1, 2), np.swapaxes(white, 1, 2))
    drawn = best[:, None] + np.swapaxes(step, 1, 2)
    # the prior of these unknowns is normal: of it the density at u is known, and that of each draw follows
    before = some.u[:, None, places]
    of_prior = (np.sum(before**2, axis=2) - np.sum(drawn**2, axis=2)) / 2
    volume = np.log(np.einsum("kii->ki", root)).sum(axis=1)[:, None]
    of_draw = volume - np.sum(white**2 + np.log(2 * np.pi), axis=2) / 2
    every = np.repeat(some.u, count, axis=0)
    every[:, places] = drawn.reshape(len(every), len(places))
    of_readings = target.log_likelihood(np.repeat(seen, count, axis=0), every)
    log_weight = of_readings.reshape(len(rows), count) + of_prior - of_draw
    log_weight = np.where(np.isnan(log_weight), -np.inf, log_weight)
    whole = logsumexp(log_weight, axis=1, keepdims=True)
    log_mass[rows] += whole[:, 0] - np.log(count)
    share = np.cumsum(np.exp(log_weight - np.where(np.isfinite(whole), whole, 0.0)), axis=1)
    kept = np.minimum((share < chance[rows, None] * share[:, -1:]).sum(axis=1), count - 1)
    shots.u[rows[:, None], places] = drawn[np.arange(len(rows)), kept]
    return shots, log_mass


def trace_ridge(
    target: Target, ridge: Ridge, count: int, rng: np.random.Generator, s: SamplingSettings
) -> None:
    """Learn where a ridge runs, from `count` points at each of several widths about its motion.

    A narrow part comes first: its curve takes the starts of the wider ones near the ridge.
    """
    for width in s.trace_widths:
        law = ridge.first
        which = rng.choice(len(law.weight), count, p=law.weight / law.weight.sum())
        root = np.linalg.cholesky(law.covariance)[which]
        white = rng.standard_normal((count, law.mean.shape[1]))
        y = law.mean[which] + width * np.einsum("nij,nj->ni", root, white)
        u = np.tile(ridge.chart.centre.u, (count, 1))
        if ridge.known is not None:
            u = ridge.known.slopes.u[nearest_points(ridge.known.y, y, ridge.first)]
        best, _, _, slopes = settled(target, ridge.chart, y, ridge.best(y), u, None)
        ridge.known = _joined([ridge.known, Known(y, best, slopes)])
        follow(ridge, s)


def propose(
    target: Target, ridge: Ridge, count: int, rng: np.random.Generator, s: SamplingSettings
) -> None:
    """Add `count` draws from the present outer laws of a ridge to its pool."""
    chart, before = ridge.chart, ridge.known
    assert before is not None
    pools, known = [ridge.pool] if ridge.pool is not None else [], [before]
    ends = np.round(count * np.cumsum([share for share, _ in ridge.proposing])).astype(int)
    counts = np.diff(np.minimum(ends, count), prepend=0)
    counts[-1] += count - counts.sum()
    drawn = [(int(n), law) for n, (_, law) in zip(counts, ridge.proposing, strict=True) if n]
    y_all = np.concatenate([law.draw(n, rng, s.freedom) for n, law in drawn])
    for y in np.array_split(y_all, -(-count // s.block)):
        near = Slopes(*(part[nearest_points(before.y, y, ridge.learnt)] for part in before.slopes))
        best, root, u, slopes = settled(target, chart, y, ridge.best(y), near.u, near)
        step, white = student_draws(s.inner_width * root, rng, s.freedom)
        volume = np.log(s.inner_width * np.einsum("kii->ki", root)).sum(axis=1)
        shots, log_mass = weighed(target, chart, y, best + step, u, rng, s)
        log_inner = student_log_density(white, s.freedom) - volume
        pools.append(Pool(y, best + step, log_inner, log_mass, shots))
        known.append(Known(y, best, slopes))
    every = (np.concatenate([getattr(p, name) for p in pools]) for name in Pool._fields[:4])
    ridge.pool = Pool(*every, Shots.joined([p.shots for p in pools]))
    ridge.known = _joined(known)
    ridge.laws += drawn


def _joined(parts: Sequence[Known | None]) -> Known:
    """Return the points of several parts."""
    some = [part for part in parts if part is not None]
    slopes = Slopes(
        *(np.concatenate(every) for every in zip(*(p.slopes for p in some), strict=True))
    )
    return Known(
        np.concatenate([p.y for p in some]), np.concatenate([p.best for p in some]), slopes
    )


def nearest_points(known: np.ndarray, y: np.ndarray, law: Law) -> np.ndarray:
    """Return which of the draws at `known` (N, d) is the nearest to each y (n, d), in sigmas of the law."""
    from scipy.spatial import KDTree

    size = np.sqrt(np.einsum("cii->i", law.covariance) / len(law.weight))
    return KDTree(known / size).query(y / size)[1]


def follow(ridge: Ridge, s: SamplingSettings) -> None:
    """Fit the best stiff coordinates at all known points by quadratic polynomials of the outer ones; far points count less."""
    known = ridge.known
    assert known is not None
    terms = monomials(known.y, ridge.chart.bending)
    least = s.points_per_term * terms.shape[1]
    good = np.isfinite(known.best).all(axis=1)
    mean = ridge.learnt.weight @ ridge.learnt.mean / ridge.learnt.weight.sum()
    spread = np.einsum("c,cij->ij", ridge.learnt.weight, ridge.learnt.covariance)
    root = np.linalg.cholesky(spread / ridge.learnt.weight.sum())
    off = ridge.learnt.straight(known.y) - mean
    far = np.sum(np.linalg.solve(root, off.T) ** 2, axis=0) / len(mean)
    answer = ridge.answer
    for _ in range(3):  # points that least squares has led to another ridge are left out
        if good.sum() < least:
            return
        weight = 1 / (1 + far[good])[:, None]
        size = np.abs(terms[good]).max(axis=0)
        scaled = weight * terms[good] / size
        answer = np.linalg.lstsq(scaled, weight * known.best[good], rcond=1e-10)[0] / size[:, None]
        off = np.linalg.norm((known.best - terms @ answer) / (1 + far)[:, None], axis=1)
        good &= off <= max(s.off_ridge * float(np.median(off[good])), 1e-12)
    ridge.answer = answer
