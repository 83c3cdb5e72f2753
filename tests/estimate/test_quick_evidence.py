"""The quick evidence of a pass: with motions that are known it needs no search, and without wheels nobody asks for it."""

import numpy as np
import xarray as xr

from sunspin.estimate import wheels
from sunspin.estimate.budget import Budget
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


def test_a_body_without_wheels_has_no_wheel_in_doubt_and_no_search():
    model, budget = stated(), Budget.of(1.0)
    telemetry = xr.Dataset(coords={"time": model.obs.t_s})
    every = np.arange(len(model.obs))
    fits = PassFits(model, (), RATES.ladder.rungs, np.zeros(0))
    only, fitter = (
        Pass(every, every),
        PassFitter(RATES, budget, lambda _, models, *__: list(models)),
    )
    searches = wheels.search_reversed(assess(CUBE, telemetry), "none", model, only, fitter)
    assert not searches.momenta and not searches.evidence
    compared = [wheels.FittedPass(only, model, fits)]
    assert wheels.doubted_signs(model.obs, compared, searches, fitter) is None
