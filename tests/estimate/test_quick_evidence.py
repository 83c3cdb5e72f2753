"""The quick evidence of a pass: with motions that are known it needs no search, and without wheels nobody asks for it."""

import numpy as np
import xarray as xr

from sunspin.estimate import wheels
from sunspin.estimate.budget import Budget
from sunspin.estimate.carry import step
from sunspin.estimate.evidence import PassFits, leading
from sunspin.estimate.model import Body, Model, Noise
from sunspin.estimate.observe import Pass, observe
from sunspin.estimate.one_pass import PassFitter, one_pass
from sunspin.estimate.quick import MOTIONS, quick_evidence
from sunspin.estimate.settings import RATES
from sunspin.telemetry.assess import assess
from tests.support.simulate import CUBE, simulated_pass, uneven_times

OMEGA = np.array([0.02, -0.03, 0.04])


def stated() -> Model:
    """Return the model of a pass of twenty samples."""
    rng = np.random.default_rng(4)
    data, _ = simulated_pass(CUBE, OMEGA, uneven_times(rng, 20, 12.0, 0.2), rng, albedo=0.0)
    return Model(observe(assess(CUBE, data)).obs, Body.of(CUBE), Noise(1e-4), 0.075)


def test_motions_that_are_known_have_the_evidence_of_a_search():
    model, budget = stated(), Budget.of(1.0)
    known = leading(one_pass(model, RATES, budget).fits, MOTIONS, RATES.search)
    searched = quick_evidence(model, RATES, Budget.of(1.0))
    spared = Budget.of(1.0)
    assert abs(quick_evidence(model, RATES, spared, known) - searched) < 0.05
    assert spared.used == 0


def test_a_body_without_wheels_has_no_wheel_in_doubt_and_no_search(monkeypatch):
    def fail(*_):
        raise AssertionError("a search")

    monkeypatch.setattr(wheels, "quick_evidence", fail)
    model, budget = stated(), Budget.of(1.0)
    telemetry = xr.Dataset(coords={"time": model.obs.t_s})
    every = np.arange(len(model.obs))
    fits = PassFits(model, (), RATES.ladder.rungs, np.zeros(0))
    compared = [wheels.FittedPass(Pass(every, every), model, fits)]
    fitter = PassFitter(RATES, budget, fail)
    assert (
        wheels.doubted_signs(assess(CUBE, telemetry), model.obs, "none", compared, fitter) is None
    )


def test_one_inertia_for_all_motions_carries_them_as_one_of_each_does():
    rng = np.random.default_rng(1)
    omega, dt = 0.1 * rng.normal(size=(5, 4, 3)), np.array([7.0, 11.0, 20.0, 31.0])
    inertia, errors = np.diag([0.8, 1.0, 1.2]), 0.1 * np.eye(3)[:, :, None] * np.eye(3)[:, None]
    momenta = 0.02 * rng.normal(size=(2, 4, 3))
    shared = step(inertia, omega, dt, tuple(momenta), True, errors)
    each = step(np.repeat(inertia[None], 5, axis=0), omega, dt, tuple(momenta), True, errors)
    for one, other in zip(shared, each, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-14)
