"""The mixture that proposes draws: its densities, its quadratic transform, and solutions that share draws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.estimate.posterior.data import readings
from sunspin.estimate.posterior.importance import BLOCK, DEFENCE, pooled, regions, sample
from sunspin.estimate.posterior.likelihood import Likelihood
from sunspin.estimate.posterior.mixture import Mixture, Sheet
from sunspin.estimate.posterior.model import State, model
from sunspin.estimate.posterior.modes import Modes
from sunspin.solve.rotations import move_on_sphere
from sunspin.vehicle import Panel, TelemetryForm, Vehicle

UNKNOWNS = 4
SHEET = Sheet.of(5 + UNKNOWNS, softs=2, moving=(1, 2), brightness=(0,))


def mixture(seed: int, count: int) -> Mixture:
    """Unbent components about a few motions."""
    rng = np.random.default_rng(seed)
    d = 5 + UNKNOWNS
    centre = State(
        0.1 * rng.standard_normal((count, 3)),
        move_on_sphere(np.tile([0.0, 0.6, 0.8], (count, 1)), rng.normal(size=(count, 2))),
        rng.standard_normal((count, UNKNOWNS)),
    )
    root = 0.1 * rng.standard_normal((count, d, d)) + 0.3 * np.eye(d)
    bend = np.zeros((count, SHEET.terms, len(SHEET.stiff)))
    bend[:, : len(SHEET.along)] = rng.standard_normal((count, len(SHEET.along), len(SHEET.stiff)))
    weight = rng.uniform(0.5, 1.0, count)
    basis = np.tile(np.diag([50.0] * 3 + [1.0] * 2), (count, 1, 1))
    return Mixture(
        centre,
        basis,
        bend,
        np.zeros((count, d)),
        root @ root.swapaxes(1, 2),
        weight / weight.sum(),
        SHEET,
    )


def density(of: Mixture, state: State) -> np.ndarray:
    return np.exp(of.log_densities(state)).sum(axis=1)


def test_the_pooled_mixture_has_the_density_of_all_rounds():
    """Each round but the first begins with the same defence, which is kept once."""
    first = mixture(0, 4)
    wide = replace(first, covariance=2 * first.covariance, weight=DEFENCE * first.weight)
    later = [
        Mixture.joined([wide, replace(m, weight=(1 - DEFENCE) * m.weight)])
        for m in (mixture(1, 3), mixture(2, 5))
    ]
    tried = [(0.1, first), (0.02, later[0]), (0.3, later[1])]
    state = first.draw(200, np.random.default_rng(3))
    made = pooled(tried)
    assert len(made.weight) == 4 + 4 + 3 + 5 and made.weight.sum() == pytest.approx(1.0)
    expected = sum(share * density(m, state) for share, m in tried) / sum(
        share for share, _ in tried
    )
    np.testing.assert_allclose(density(made, state), expected, rtol=1e-9)


def test_the_quadratic_transform_is_inverted_exactly_and_keeps_volume():
    """Every coordinate is stiff or along the sheet; what is bent comes back, and densities are those of the straight sheet."""
    assert sorted([*SHEET.stiff, *SHEET.along]) == list(range(5 + UNKNOWNS)) and set(
        SHEET.bending
    ) <= set(SHEET.along)
    straight = mixture(6, 1)
    bent = replace(straight, bend=np.random.default_rng(7).normal(0, 0.05, straight.bend.shape))
    x = np.random.default_rng(8).normal(0, 0.3, (40, 5 + UNKNOWNS))
    here = np.zeros(40, dtype=int)
    one, other = straight.states(x, here), bent.states(x, here)
    np.testing.assert_allclose(bent.coordinates(other, 0), x, rtol=0, atol=1e-9)
    assert (
        np.abs(other.u[:, 0] - one.u[:, 0]).max() > 0.01
    )  # the brightness is bent with the motion

    def in_the_chart(of: Mixture, state: State) -> np.ndarray:
        """Density without the chart's own stretching of the sphere."""
        return of.log_densities(state)[:, 0] + np.log(
            np.sinc(np.arccos(state.sun @ of.centre.sun[0]) / np.pi)
        )

    np.testing.assert_allclose(
        in_the_chart(bent, other), in_the_chart(straight, one), rtol=0, atol=1e-7
    )


def test_mixture_components_that_share_draws_are_one_solution():
    """Two that share all their draws and one apart, with draws enough for several blocks; the last has no weight at all."""
    n = 2 * BLOCK + 7
    share = np.full((n, 4), 1e-9)
    share[: n // 3, 2] = 1.0
    share[n // 3 :, :2] = 0.5
    share[:, 3] = 1e-30
    parts = np.log(share)
    region, component = regions(np.zeros(n), parts, np.log(share.sum(axis=1)))
    assert component.tolist() == [0, 0, 1, -1]
    assert np.all(region[: n // 3] == 1) and np.all(region[n // 3 :] == 0)


RATE, SUN = np.array([0.05, -0.08, 0.11]), np.array([0.36, 0.48, 0.8])


def cube_and_modes(max_rate: float, objective: list[float]) -> tuple[Likelihood, Modes]:
    """Readings of a cube, and modes at a radian per second from each other, the first the true motion."""
    panels = [
        Panel("xyzXYZ"[k], normal, 1.0)
        for k, normal in enumerate(np.concatenate([np.eye(3), -np.eye(3)]))
    ]
    cube = Vehicle(
        "cube",
        inertia_kg_m2=np.diag([0.010, 0.012, 0.008]),
        panels=panels,
        telemetry=TelemetryForm(noise=0.005),
    )
    data, _, _ = readings(
        cube, ss.twin(cube, {"omega_B": RATE, "sun_B": SUN, "t_s": 20.0 * np.arange(6)})
    )
    priors = {"max_rate_rad_s": max_rate, "inertia": 0.0, "steady_torque": 0.0}
    unknown, _ = model(cube, priors, 0.5)
    n, k = len(objective), len(unknown.unknowns)
    state = State(
        RATE + np.arange(n)[:, None] * [1.0, 0.0, 0.0], np.tile(SUN, (n, 1)), np.zeros((n, k))
    )
    hessian = np.tile(1e6 * np.eye(5 + k), (n, 1, 1))
    likelihood = Likelihood(unknown, data, 1e-8)
    return likelihood, Modes(state, np.array(objective), hessian, np.ones(n), (), ())


def all_rows(rows, *_):
    return rows(np.arange(rows.n_rows))


def test_there_is_no_sample_if_the_prior_allows_no_proposed_rate():
    """All draws are faster than the prior allows: that ends in nothing to weigh, and not in an error."""
    assert sample(*cube_and_modes(0.05, [0.0]), 0, all_rows, 1000) is None
