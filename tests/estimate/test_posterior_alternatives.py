"""Alternative models of a posterior: torques of any size, weighted by evidence. All telemetry is synthetic."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sunspin.estimate.posterior.estimate import _listed
from sunspin.estimate.posterior.hypotheses import Sampled, mixed
from sunspin.estimate.posterior.importance import Sample, _over_sizes
from sunspin.estimate.posterior.mixture import Mixture, Sheet
from sunspin.estimate.posterior.model import State, model, pushed
from sunspin.estimate.terms.steady_torque import sizes
from validation.torques import BOX

SUN, WINDOW_S = np.array([0.6, 0.0, 0.8]), 400.0
PUSHED = pushed(model(BOX, {}, 1.0)[0], "B", WINDOW_S, 300.0)
PLACES = PUSHED.where("steady_torque")


def state_of(torque_deg: np.ndarray) -> State:
    """States whose torque along x turns the body by so much (n) over the window."""
    u = np.zeros((len(torque_deg), len(PUSHED.unknowns)))
    u[:, PLACES[0]] = sizes(WINDOW_S, np.radians(torque_deg)) / PUSHED.unknowns[PLACES[0]].sigma
    return State(np.full((len(u), 3), 0.01), np.tile(SUN, (len(u), 1)), u)


def test_prior_probabilities_of_torque_sizes_add_up_to_one():
    turned = np.geomspace(1e-3, 5e3, 4000)
    state = state_of(turned)
    without = replace(state, u=np.delete(state.u, PLACES, axis=1))
    density = np.exp(PUSHED.log_prior(state) - model(BOX, {}, 1.0)[0].log_prior(without))
    size = state.u[:, PLACES[0]]
    assert np.trapezoid(4 * np.pi * size**3 * density, np.log(size)) == pytest.approx(1.0, rel=1e-3)
    tail = density[np.searchsorted(turned, [30.0, 150.0])]
    assert (
        np.log(tail[0] / tail[1]) < 7.0 < 0.5 * (5**2 - 1)
    )  # a Gaussian of 30 degrees would cost e^12


def fit_of(precise: np.ndarray, told: np.ndarray, fitted: float) -> Mixture:
    """Laplace's component of a fit under one size, of readings that tell the torque (3) with so much precision (3, 3)."""
    d, at = 5 + len(PUSHED.unknowns), 5 + np.array(PLACES)
    covariance = np.eye(d)
    covariance[np.ix_(at, at)] = np.linalg.inv(precise + np.eye(3) / fitted**2)
    centre = State(np.zeros((1, 3)), SUN[None], np.zeros((1, d - 5)))
    centre.u[0, PLACES] = covariance[np.ix_(at, at)] @ precise @ told
    sheet = Sheet.of(d, 1, [], PUSHED.where("scale"))
    return Mixture(
        centre,
        np.eye(5)[None],
        np.zeros((1, sheet.terms, len(sheet.stiff))),
        np.zeros((1, d)),
        covariance[None],
        np.ones(1),
        sheet,
    )


def test_a_torque_size_that_was_not_fitted_gets_its_gaussian_mass():
    """For readings that answer linearly, linear theory is exact: the integral under each size, by the formula of two normals."""
    told, fitted, at = np.array([0.02, -0.01, 0.005]), 0.3, 5 + np.array(PLACES)
    one = fit_of(400.0 * np.eye(3), told, fitted)
    wide, mass, _ = _over_sizes(PUSHED, one, np.zeros(1), np.array([fitted]))

    def log_evidence(share: float) -> float:
        spread = 1 / 400.0 + share**2
        return -0.5 * told @ told / spread - 1.5 * np.log(spread)

    expected = np.array([log_evidence(share) for share in PUSHED.shares])
    np.testing.assert_allclose(
        np.sort(mass - mass.max()), np.sort(expected - expected.max()), atol=1e-9
    )
    torque = one.centre.u[0, PLACES]
    narrow = int(np.argmin(np.linalg.norm(wide.mean[:, at] + torque, axis=1)))
    assert (
        np.abs(wide.mean[narrow, at] + torque).max() < 0.1 * np.abs(told).max()
    )  # no torque where none is expected


def sampled(
    what: str, log_evidence: float, middle: list[float], sigma: float, log_prior: float = 0.0
) -> Any:
    """Draws of one region of rates."""
    rng = np.random.default_rng(len(what))
    omega = middle + sigma * rng.standard_normal((500, 3))
    state = State(omega, np.tile(SUN, (500, 1)), np.zeros((500, 2)))
    drawn = Sample(
        state,
        np.full(500, log_evidence),
        np.zeros(500),
        np.zeros(500, dtype=int),
        np.ones(1),
        np.zeros(1, dtype=int),
        500.0,
        0.0,
        log_evidence,
        np.zeros((1, 3)),
        ridge=np.zeros(1, dtype=int),
    )
    likelihood = SimpleNamespace(
        data=SimpleNamespace(reach_s=100.0), model=SimpleNamespace(unknowns=(0, 0))
    )
    modes = SimpleNamespace(hits=np.array([3]))
    one: Any = SimpleNamespace(what=what, log_prior=log_prior, likelihood=likelihood, modes=modes)
    return Sampled(one, drawn)


def test_evidence_weighs_torques_and_a_curved_ridge_stays_one_solution():
    stated, bent = (
        sampled("as stated", 0.0, [0.1, 0.0, 0.0], 1e-4),
        sampled("a torque", np.log(3.0), [0.103, 0.0, 0.0], 3e-4),
    )
    far = sampled("something else", 0.0, [0.2, 0.0, 0.0], 1e-4, log_prior=np.log(0.5))
    found = mixed([stated, bent, far, sampled("no chance", -20.0, [0.1, 0.0, 0.0], 1e-4)])
    np.testing.assert_allclose(found.weight, np.array([1.0, 3.0, 0.5]) / 4.5, rtol=1e-6)
    np.testing.assert_allclose(
        found.share, [4 / 4.5, 0.5 / 4.5], rtol=1e-6
    )  # bent by 30 sigma, but by 0.3 rad in the window
    assert list(found.said) == ["as stated", "a torque", "something else"] and set(
        found.starts
    ) == {3}
    assert set(found.region[found.of == 2]) == {1} and found.effective == pytest.approx(
        1 / np.sum(np.square(found.weight) / 500)
    )


@pytest.mark.parametrize(
    ("share", "copies", "listed"), [(0.004, 1, 1), (0.004, 40, 2), (0.05, 1, 2), (5e-5, 40, 1)]
)
def test_a_solution_of_few_draws_is_listed_only_with_a_large_probability(share, copies, listed):
    """One draw has no width: it was told with a sigma of zero."""
    region = np.repeat([0, 1], [500, copies])
    log_weight = np.log(np.where(region == 0, (1 - share) / 500, share / copies))
    drawn: Any = SimpleNamespace(
        share=np.array([1 - share, share]), region=region, log_weight=log_weight
    )
    assert _listed(drawn) == listed
