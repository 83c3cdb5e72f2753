"""A search holds the inertia fast, and must not lose a motion that differs by what the file says of the errors of the inertia."""

from dataclasses import replace

import numpy as np

from sunspin.estimate.model import Body, Model, Noise
from sunspin.estimate.observe import observe
from sunspin.estimate.rates import rates
from sunspin.estimate.starts import _loosened
from sunspin.telemetry.assess import assess
from sunspin.vehicle.parts import Fact
from tests.support.orbit_cases import SPARSE, one_pass, pass_against_truth, rates_case
from tests.support.simulate import CUBE, simulated_pass, uneven_times

OMEGA, RATE_MAX, ERROR = np.array([0.02, -0.03, 0.04]), 0.2, 0.03


def body(sigma: float) -> Body:
    """Return the body of the cube, with this error of every element in mean moments."""
    tensor = np.array(CUBE.inertia_kg_m2)
    wide = tuple(map(tuple, (sigma * np.diag(tensor).mean() * np.ones((3, 3))).tolist()))
    fact = Fact(value=tuple(map(tuple, tensor.tolist())), sigma=wide)
    return Body.of(replace(CUBE, facts={"body.inertia_kg_m2": fact}))


def test_a_body_wanders_in_a_search_by_the_error_of_its_inertia_and_a_sphere_does_not():
    assert np.isclose(body(ERROR).for_search().wander, ERROR)
    assert not len(body(ERROR).for_search().errors)
    assert Body.of(replace(CUBE, inertia_kg_m2=None)).for_search().wander == 0


def test_starts_are_trusted_less_the_farther_a_sample_is_if_the_inertia_has_errors():
    rng = np.random.default_rng(4)
    data, _ = simulated_pass(CUBE, OMEGA, uneven_times(rng, 8, 30.0, 0.2), rng, albedo=0.0)
    obs = observe(assess(CUBE, data)).obs
    spreads = []
    for sigma in (1e-6, ERROR):
        model = Model(obs, body(sigma).for_search(), Noise(0.0), RATE_MAX / 2)
        (panels,) = _loosened(model, 3, 0.0).obs.terms
        spreads.append(panels.sigma.max(axis=1))
    away = np.abs(obs.t_s - obs.t_s[3])
    assert np.isclose(spreads[0][3], spreads[1][3])
    # a panel with the Sun across it reads as much less as the body has turned, up to half a turn or so
    added = np.sqrt(spreads[1] ** 2 - spreads[0] ** 2)
    near = np.argsort(away)[1:3]
    np.testing.assert_allclose(added[near], ERROR * RATE_MAX * away[near], rtol=0.2)
    assert (np.diff(added[3:]) > 0).all()


def test_a_long_body_whose_inertia_is_wrong_by_three_percent_is_found_between_sparse_samples():
    """9 deg/s, samples 37 s apart: without errors of the inertia no start near the truth survived the first five samples."""
    vehicle, data, _, truth, about = rates_case(0, 4, **SPARSE)
    telemetry = one_pass(data, about["begin_s"][1]).drop_vars("field_B")
    row = pass_against_truth(rates(vehicle, telemetry), truth, 0)
    assert row["listed"] and row["decided"] and not row["wrong"]
