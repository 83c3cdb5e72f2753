"""Draws along ridges against densities whose integral, weights and moments are known in closed form."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import logsumexp

from sunspin.estimate.budget import Budget
from sunspin.estimate.lander.mixture import Mixture, join_models
from sunspin.estimate.lander.motions import Draws, LanderMotions, ModelFit
from sunspin.estimate.lander.ridges import ridges_of
from sunspin.estimate.lander.sample import predictive_check, resampled, sample
from sunspin.estimate.lander.target import MotionSlopes
from sunspin.estimate.model import Unknown
from sunspin.estimate.settings import SAMPLING
from sunspin.solve.linear import DenseSystem
from sunspin.solve.rotations import tangent_basis

RATE, TURN = np.array([2e-4, 1e-4, 3e-4]), 0.02
"""Sigmas of the rates (rad/s) about a ridge, and of the direction (rad)."""

REACH_S = 100.0
STRAIGHT, CURVED = 5e-3, 3e-3
"""How the rate x follows an unknown along a ridge (rad/s)."""

BRIGHT, READ = 0.3, 0.2
"""Where the readings put the brightness, and how well, in sigmas of its prior."""


@dataclass(frozen=True)
class Bananas:
    """A posterior with a bent ridge about each motion of `omega` (M, 3) and `sun` (M, 3), which hold parts `weight` (M) of it.

    The rate x follows the unknown `bend` as `STRAIGHT` u + `CURVED` u^2 (rad/s). So the integral over the rates does not depend on
    it. `lowest`: the least `bend` that is possible. The other unknown is a brightness.
    """

    omega: np.ndarray
    sun: np.ndarray
    weight: np.ndarray
    lowest: float = -np.inf
    max_rate: float = 1.0
    reach_s: float = REACH_S
    reading_unknowns = np.array([1])
    motion_unknowns = np.array([0])
    unknowns = tuple(
        Unknown(name, kind, "1", 0.0, 1.0)
        for name, kind in (("bend", "inertia"), ("brightness", "scale"))
    )

    def _off(self, motions: LanderMotions) -> np.ndarray:
        """Differences (K, M, 5) from the ridges, in sigmas."""
        u = motions.u[:, 0]
        ridge = np.zeros((len(u), 1, 3))
        ridge[:, 0, 0] = STRAIGHT * u + CURVED * u**2
        rate = (motions.omega[:, None] - self.omega - ridge) / RATE
        across = np.stack(tangent_basis(self.sun), axis=1)
        side = np.einsum("mai,ki->kma", across, motions.sun) / TURN
        return np.concatenate([rate, side], axis=2)

    def _bright(self, u: np.ndarray) -> np.ndarray:
        return (u[:, 1] - BRIGHT) / READ

    @property
    def model(self) -> "Bananas":
        """Return what stands for the lander's model."""
        return self

    def indices(self, *kinds: str) -> list[int]:
        return [i for i, unknown in enumerate(self.unknowns) if unknown.kind in kinds]

    def prior_cost(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (u**2).sum(axis=1) / 2, np.ones_like(u)

    def track(self, motions: LanderMotions) -> np.ndarray:
        return self._off(motions)

    def log_likelihood(self, seen: np.ndarray, u: np.ndarray) -> np.ndarray:
        each = np.log(self.weight) - (seen**2).sum(axis=2) / 2
        return np.asarray(logsumexp(each, axis=1)) - self._bright(u) ** 2 / 2

    def log_prior_density(self, motions: LanderMotions) -> np.ndarray:
        normal = -np.sum(motions.u**2 + np.log(2 * np.pi), axis=1) / 2
        # the antipodes of the directions have the same components across
        facing = np.any(motions.sun @ self.sun.T > 0, axis=1)
        return np.where(facing & (motions.u[:, 0] >= self.lowest), normal, -np.inf)

    def reading_slopes(self, seen, u):
        pull = -self._bright(u) / READ
        return pull[:, None], np.full((len(u), 1, 1), READ**-2)

    def linearised(
        self, motions: LanderMotions, slopes: MotionSlopes | None = None, noise_factor: float = 1.0
    ):
        off = self._off(motions)
        nearest = np.argmin((off**2).sum(axis=2), axis=1)
        every = np.arange(len(motions))
        residual = np.column_stack([off[every, nearest], self._bright(motions.u)]) / noise_factor
        jacobian = np.zeros((len(motions), 6, 6))
        jacobian[:, range(3), range(3)] = 1 / RATE
        own = np.stack(tangent_basis(motions.sun), axis=1)
        across = np.stack(tangent_basis(self.sun), axis=1)[nearest]
        jacobian[:, 3:5, 3:5] = np.einsum("kai,kbi->kab", across, own) / TURN
        jacobian[:, 5, 5] = 1 / READ
        jacobian /= noise_factor
        matrix = np.swapaxes(jacobian, 1, 2) @ jacobian
        matrix[:, 5, 5] += 1
        slope = np.einsum("kri,kr->ki", jacobian, residual)
        slope[:, 5] += motions.u[:, 1]
        cost = (residual**2).sum(axis=1) / 2 + (motions.u**2).sum(axis=1) / 2
        same = np.zeros((len(motions), 5, 1))
        slopes = MotionSlopes(motions.omega, motions.sun, motions.u, same, same[:, 0])
        return DenseSystem(cost, matrix, slope, extras=slopes)

    def log_replicated(self, seen, u, rng) -> np.ndarray:
        """Log likelihood of six normal readings about the motions."""
        return -np.sum(rng.normal(size=(len(u), 6)) ** 2, axis=1) / 2

    @property
    def log_integral(self) -> float:
        """Log of the integral of the posterior, all of `bend` being possible."""
        solid, _ = quad(lambda a: np.exp(-((np.sin(a) / TURN) ** 2) / 2) * np.sin(a), 0, np.pi / 2)
        bright = READ / np.hypot(READ, 1) * np.exp(-(BRIGHT**2) / 2 / (READ**2 + 1))
        rates = (2 * np.pi) ** 1.5 * np.prod(RATE)
        return float(np.log(rates * 2 * np.pi * solid * bright))

    def fit(self, which: list[int], bend: float = 0.0) -> ModelFit:
        """The motions at a value of `bend` on the ridges, with their curvature."""
        omega = np.array(self.omega[which])
        omega[:, 0] += STRAIGHT * bend + CURVED * bend**2
        u = np.tile([bend, BRIGHT / (1 + READ**2)], (len(which), 1))
        motions = LanderMotions(omega, self.sun[which], u)
        matrix = self.linearised(motions).matrix
        whole = np.zeros((len(which), 7, 7))
        rest = [0, 1, 2, 3, 4, 6]
        whole[np.ix_(range(len(which)), rest, rest)] = matrix
        slope = (STRAIGHT + 2 * CURVED * bend) / RATE[0]
        whole[:, 5, 5] = 1 + slope**2
        whole[:, 0, 5] = whole[:, 5, 0] = -slope / RATE[0]
        cost = -np.log(self.weight[which])
        starts = np.ones(len(which))
        fitted = replace(motions, cost=cost, curvature=whole, starts=starts)
        return ModelFit(None, fitted, -cost)


TIED = 0.01
"""Sigma with which the readings tie the third unknown of :class:`Tied` to the first, in sigmas of their priors."""


@dataclass(frozen=True)
class Tied(Bananas):
    """The same with a third unknown, the friction, that readings tie to the first one along a curve: u0 / 2 + u0^2 / 10."""

    motion_unknowns = np.array([0, 2])
    unknowns = (*Bananas.unknowns, Unknown("friction", "viscous", "1", 0.0, 1.0))

    def _tie(self, u: np.ndarray) -> np.ndarray:
        return (u[:, 2] - u[:, 0] / 2 - u[:, 0] ** 2 / 10) / TIED

    def log_likelihood(self, seen: np.ndarray, u: np.ndarray) -> np.ndarray:
        return super().log_likelihood(seen, u) - self._tie(u) ** 2 / 2

    @property
    def log_integral(self) -> float:
        """Log of the integral of the posterior: the tie is so narrow that the prior of friction is taken on the curve."""
        tied, _ = quad(lambda a: np.exp(-(a**2 + (a / 2 + a**2 / 10) ** 2) / 2), -8, 8)
        return super().log_integral + float(np.log(TIED * tied / np.sqrt(2 * np.pi)))

    def fit(self, which: list[int], bend: float = 0.0) -> ModelFit:
        """The motion with friction on the curve, at a `bend` of zero."""
        fit = super().fit(which)
        whole = np.zeros((len(which), 8, 8))
        whole[:, :7, :7] = fit.motions.curvature
        whole[:, 7, 7] = 1.0
        tie = np.zeros(8)
        tie[5], tie[7] = -0.5 / TIED, 1 / TIED
        u = np.concatenate([fit.motions.u, np.zeros((len(which), 1))], axis=1)
        whole = whole + np.outer(tie, tie)
        return replace(fit, motions=replace(fit.motions, u=u, curvature=whole))


def one(of=Bananas, **changes) -> Bananas:
    omega, sun = np.array([[0.1, 0.05, -0.02]]), np.array([[0.0, 0.6, 0.8]])
    return of(omega, sun, np.ones(1), **changes)


def pair(weight: float) -> Bananas:
    """Two motions, one the mirror image of the other in z."""
    omega = np.array([[0.1, 0.05, -0.02], [-0.1, -0.05, -0.02]])
    sun = np.array([[0.0, 0.6, 0.8], [0.0, 0.6, -0.8]])
    return Bananas(omega, sun, np.array([weight, 1 - weight]))


def drawn(target: Bananas, fit: ModelFit | None = None, seed: int = 0, **changes) -> Draws:
    fit = fit or target.fit([0])
    return sample(target, fit, np.random.default_rng(seed), replace(SAMPLING, **changes))


def weights(draws: Draws) -> np.ndarray:
    return np.exp(draws.log_weight - logsumexp(draws.log_weight))


def shares(draws: Draws) -> np.ndarray:
    return np.bincount(draws.solution, weights=weights(draws))


def moments(draws: Draws) -> tuple[float, float]:
    """Mean and standard deviation of the unknown that bends the ridge."""
    weight = weights(draws)
    mean = weight @ draws.motions.u[:, 0]
    return float(mean), float(np.sqrt(weight @ (draws.motions.u[:, 0] - mean) ** 2))


def test_draws_have_the_evidence_and_moments_of_a_bent_ridge():
    """The ridge is 8 mrad/s long, and as wide as 0.2."""
    target = one()
    draws = drawn(target)
    assert draws.log_evidence == pytest.approx(target.log_integral, abs=0.05)
    assert draws.effective > 0.625 * len(draws) and draws.pareto_k < 0.3
    mean, sigma = moments(draws)
    assert mean == pytest.approx(0.0, abs=0.06) and sigma == pytest.approx(1.0, abs=0.05)
    bright = weights(draws) @ draws.motions.u[:, 1]
    assert bright == pytest.approx(BRIGHT / (1 + READ**2), abs=0.02)
    # a law that ignored the curve would propose rates ten sigmas beside the ridge
    off = target.track(draws.motions)[:, 0]
    assert np.sqrt(weights(draws) @ off**2) == pytest.approx(np.ones(5), abs=0.06)


def test_unknowns_that_readings_tie_along_a_curve_are_drawn_along_it():
    """Evidence by quadrature; laws that know no bend leave fewer effective draws."""
    target = one(Tied)
    few = {"draws": 1000, "rounds": 6, "wanted": 1e9}
    draws, straight = drawn(target, **few), drawn(target, thin=0.0, **few)
    assert draws.log_evidence == pytest.approx(target.log_integral, abs=0.06)
    assert draws.effective > max(1000, 1.5 * straight.effective)


@pytest.mark.parametrize("weight", [0.5, 0.8])
def test_two_motions_keep_their_probabilities(weight):
    target = pair(weight)
    draws = drawn(target, target.fit([0, 1]))
    assert shares(draws) == pytest.approx([weight, 1 - weight], abs=0.02)
    assert draws.log_evidence == pytest.approx(target.log_integral, abs=0.05)


def test_a_motion_fitted_twice_counts_once():
    """Two ridges that are one share their draws, and are one region."""
    target = one()
    fits = [target.fit([0], bend) for bend in (0.0, 0.3)]
    motions = LanderMotions.joined([fit.motions for fit in fits])
    twice = ModelFit(None, motions, np.zeros(2))
    assert len(ridges_of(target, twice, SAMPLING)) == 1
    apart = replace(SAMPLING, on_ridge=0.0)
    assert len(ridges_of(target, twice, apart)) == 2
    draws = drawn(target, twice, on_ridge=0.0)
    assert draws.log_evidence == pytest.approx(target.log_integral, abs=0.05)
    assert len(shares(draws)) == 1


def test_an_unknown_with_a_bound_keeps_half_of_the_posterior():
    target = one(lowest=0.0)
    draws = drawn(target, target.fit([0], 0.3))
    assert draws.log_evidence == pytest.approx(target.log_integral + np.log(0.5), abs=0.06)
    assert moments(draws)[0] == pytest.approx(np.sqrt(2 / np.pi), abs=0.06)
    assert weights(draws)[draws.motions.u[:, 0] < 0].sum() == 0.0


def of_model(evidence: float, region_at: list[float], n: int = 400) -> Draws:
    """Draws of equal weight, spread over regions whose rates x stand at these values."""
    rng = np.random.default_rng(len(region_at))
    region = np.arange(n) % len(region_at)
    omega = 1e-4 * rng.normal(size=(n, 3))
    omega[:, 0] += np.array(region_at)[region]
    motions = LanderMotions(omega, np.tile([0.0, 0.0, 1.0], (n, 1)), rng.normal(size=(n, 2)))
    return Draws(motions, np.full(n, evidence), np.zeros(n, int), region, float(n), 0.0, evidence)


def test_only_a_round_that_is_left_out_counts_as_cut():
    """A budget that the first of two rounds uses up leaves one out; one that the last uses up leaves out nothing."""
    fit = one().fit([0])

    def budget_after(rounds: int, most: float) -> Budget:
        budget = Budget(most)
        settings = replace(SAMPLING, rounds=rounds)
        sample(one(), fit, np.random.default_rng(0), settings, budget)
        return budget

    first_round = budget_after(1, np.inf).used
    assert budget_after(2, first_round).cut
    all_spent = budget_after(2, first_round + 1.0)
    assert all_spent.used >= all_spent.most and not all_spent.cut


def test_models_are_weighed_by_their_evidence():
    mix = join_models([of_model(3.0, [0.0]), of_model(2.0, [0.0])], REACH_S)
    expected = 1 / (1 + np.exp(-1.0))
    assert weights(mix)[mix.model_index == 0].sum() == pytest.approx(expected)
    assert mix.log_evidence == pytest.approx(np.logaddexp(3.0, 2.0))


def test_regions_of_two_models_are_one_if_they_differ_by_a_bend():
    """Half a turn in the window is a bend, whole turns are another motion."""
    bent, turned = 0.5 / REACH_S, 2 * np.pi / REACH_S
    joined = join_models([of_model(0.0, [0.0]), of_model(0.0, [bent])], REACH_S)
    assert shares(joined) == pytest.approx([1.0])
    parted = join_models([of_model(0.0, [0.0]), of_model(-1.0, [turned])], REACH_S)
    assert shares(parted) == pytest.approx([1 / (1 + np.exp(-1)), 1 / (1 + np.e)])


def test_resampled_draws_are_proportional_to_the_weights():
    draws = of_model(0.0, [0.0], n=3)
    draws = replace(draws, log_weight=np.log([1.0, 2.0, 5.0]))
    picked = resampled(draws.log_weight, 800, np.random.default_rng(0))
    assert np.bincount(picked).tolist() == pytest.approx([100, 200, 500], abs=1)


def test_draws_of_two_models_are_evaluated_once_each_and_keep_their_places():
    motions = LanderMotions(
        np.arange(15.0).reshape(5, 3), np.tile([0.0, 0.0, 1.0], (5, 1)), np.zeros((5, 1))
    )
    of_model, region, none = np.array([1, 0, 0, 1, 1]), np.zeros(5, dtype=int), np.zeros(5)
    draws = Draws(motions, none, of_model, region, effective=5.0, pareto_k=0.0, log_evidence=0.0)
    fits: list[Any] = [
        SimpleNamespace(model=SimpleNamespace(unknowns=("brightness",), offset=offset))
        for offset in (0.0, 100.0)
    ]
    mix = Mixture(tuple(fits), draws, np.full(2, 0.5), np.ones(1), workers=2)
    evaluated: list[int] = []

    def of_one(model: Any, motions: LanderMotions) -> tuple[np.ndarray]:
        evaluated.append(len(motions))
        return (model.offset + motions.omega,)

    index = np.array([4, 0, 4, 2, 1, 0])
    (value,) = mix.evaluate(index, of_one)
    np.testing.assert_array_equal(value, motions.omega[index] + 100.0 * of_model[index][:, None])
    assert sorted(evaluated) == [2, 2]


def test_readings_that_no_motion_explains_have_no_chance():
    """Six readings off by a sigma each are usual; off by six sigmas they come from no motion."""
    target = one()
    motion = target.fit([0]).motions
    for sigmas, low, high in ((1.0, 0.2, 0.8), (6.0, 0.0, 0.002)):
        omega = np.tile(motion.omega + sigmas * RATE, (100, 1))
        u = np.tile([0.0, BRIGHT + sigmas * READ], (100, 1))
        side = sigmas * TURN * np.array([[0.0, 0, 0, 1, 1, 0, 0]])
        sun = np.tile(motion.moved(side).sun, (100, 1))
        checked = predictive_check(target, LanderMotions(omega, sun, u), np.random.default_rng(0))
        assert low <= checked.p <= high


class Mistaken(Bananas):
    """A brightness 0.3 above that which slopes and curvature of the readings promise, 1.5 of its sigmas."""

    def log_likelihood(self, seen: np.ndarray, u: np.ndarray) -> np.ndarray:
        right, shifted = self._bright(u), self._bright(u) - 1.5
        return super().log_likelihood(seen, u) + (right**2 - shifted**2) / 2


def test_of_several_sets_of_reading_unknowns_one_is_kept_by_its_weight():
    """The proposals are wrong by 1.5 sigmas, so that the first or a random one of the sets would be too."""
    target = one(Mistaken)
    few, many = (drawn(target, rounds=6, reading_draws=count) for count in (1, 16))
    expected = (BRIGHT + 1.5 * READ) / (1 + READ**2)
    sigma = READ / np.hypot(READ, 1)
    kept = many.motions.u[:, 1]
    assert weights(many) @ kept == pytest.approx(expected, abs=0.2 * sigma)
    assert many.effective / len(many) > 2 * few.effective / len(few)
