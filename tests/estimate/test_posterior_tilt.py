"""Panels that stand off as drawn: an unknown of the posterior that all samples share, its sigma the file's or the caller's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.estimate.posterior.data import readings
from sunspin.estimate.posterior.likelihood import Likelihood
from sunspin.estimate.posterior.model import State, model
from sunspin.estimate.posterior.tilt import spread, stated_sigma
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from sunspin.vehicle.parts import Fact

RATE, SUN = np.array([0.05, -0.08, 0.11]), np.array([0.3, 0.5, 0.8]) / np.linalg.norm([0.3, 0.5, 0.8])
TILT = 0.09
PRIORS = {"max_rate_rad_s": 0.2, "inertia": 0.0}


@pytest.fixture(scope="module")
def cube() -> Vehicle:
    panels = [Panel("xyzXYZ"[k], normal, 1.0) for k, normal in enumerate(np.concatenate([np.eye(3), -np.eye(3)]))]
    form = TelemetryForm(quantity="current_A", noise=0.01)
    return Vehicle("cube", inertia_kg_m2=np.diag([0.010, 0.012, 0.008]), panels=panels, telemetry=form)


@pytest.fixture(scope="module")
def tilted(cube):
    t = 20.0 * np.arange(12) + np.concatenate([[0.0], np.random.default_rng(0).uniform(-3, 3, 11)])
    return ss.twin(cube, {"omega_B": RATE, "sun_B": SUN, "t_s": t, "scale": 0.5, "tilt_B_rad": TILT}, seed=3)


@pytest.mark.evidence("posterior", "verified", "differences of the misfit, of each panel's turns and of one in common")
def test_derivatives_by_tilts_are_those_of_differences(cube, tilted):
    data, _, _ = readings(cube, tilted)
    unknown, told = model(cube, PRIORS | {"tilt": 0.05, "tilt_common": 0.03}, 0.5)
    assert told["tilt"] == "2.86 deg (given), 1.72 deg common to all panels (given)"
    assert not set(unknown.where("tilt") + unknown.where("tilt_common")) & set(unknown.moving)
    likelihood = Likelihood(unknown, data, 1e-8)
    state = State(RATE[None], SUN[None], np.zeros((1, len(unknown.unknowns))))
    jacobian = likelihood.linearised(state)[3]
    base = likelihood.predict(state)
    places = unknown.where("tilt") + unknown.where("tilt_common")
    assert len(places) == 2 * 6 + 3
    for i in places:
        step = 1e-5 * np.eye(len(unknown.unknowns))[[i]]
        ahead, behind = (likelihood.misfit(base, sign * step)[0] for sign in (1, -1))
        np.testing.assert_allclose((ahead - behind) / 2e-5, jacobian[..., 5 + i], atol=1e-8)
        assert jacobian[..., 5 + i].any()


def test_sigmas_are_those_of_the_file_unless_given(cube):
    assert not stated_sigma(cube).any() and model(cube, PRIORS, 0.5)[0].turns is None
    facts = {"panel.y.normal_B": Fact([0.0, 1.0, 0.0], 0.02), "panel.Z.normal_B": Fact([0.0, 0.0, -1.0], [0.03, 0.04, 0.0])}
    stated = replace(cube, facts=facts)
    assert stated_sigma(stated) == pytest.approx([0, 0.02, 0, 0, 0, 0.05 / 3**0.5])
    unknown, told = model(stated, PRIORS, 0.5)
    named = [x.name for x in unknown.unknowns if x.kind == "tilt"]
    assert named == [f"tilt_{panel}_{side}_rad" for panel in "yZ" for side in (1, 2)]
    assert told["tilt"].endswith("(vehicle file)")
    assert model(stated, PRIORS | {"tilt": 0.0}, 0.5)[0].turns is None
    across = unknown.turns @ cube.panel_normals_B.T  # a turn about the normal itself would change nothing
    assert np.abs(np.einsum("kpp->kp", across)).max() < 1e-15
    assert spread(0.01, cube, model(cube, PRIORS | {"tilt": 0.05}, 0.5)[0].unknowns, 0.5) == pytest.approx(np.hypot(0.01, 0.025))
    with pytest.raises(InputError, match="sigma of tilt must be zero"):
        model(cube, {"tilt": -1.0}, 0.5)


@pytest.mark.evidence("posterior", "modelled", "a twin with tilted panels: known of, and as a negative control unknown")
def test_tilts_are_no_contradiction_once_they_are_known_of(cube, tilted, reached):
    untold = ss.posterior(cube, tilted, PRIORS, seed=0, draws=300, workers=1)
    told = ss.posterior(cube, tilted, PRIORS | {"tilt": TILT}, seed=0, draws=1000, workers=1)
    assert untold.attrs["verdict_word"] == "not explained", untold.attrs["verdict"]
    assert told.attrs["verdict_word"] != "not explained", told.attrs["verdict"]
    off = RATE - told["modes"]["omega_B"].values[0]
    distance = float(off @ np.linalg.solve(told["modes"]["omega_cov_B"].values[0], off)) ** 0.5
    reached("distance of the true rate", distance, "sigmas", limit=16.3**0.5)
    assert distance < 16.3**0.5
    truth = tilted.attrs["truth_tilt_B_rad"].reshape(6, 3)
    assert np.abs(np.einsum("pi,pi->p", truth, cube.panel_normals_B)).max() < 1e-15
    left = told["posterior"]["tilt_x_1_rad"].values.std()
    assert 0 < left < 0.9 * TILT  # the readings tell something of it


def test_a_twin_takes_turns_or_their_sigma(cube, tilted):
    known = {"omega_B": RATE, "sun_B": SUN, "t_s": tilted["time"].values, "scale": 0.5}
    again = ss.twin(cube, known | {"tilt_B_rad": tilted.attrs["truth_tilt_B_rad"].reshape(6, 3)}, seed=3)
    np.testing.assert_array_equal(again["current_A"].values, tilted["current_A"].values)
    assert "truth_tilt_B_rad" not in ss.twin(cube, known, seed=3).attrs
    for wrong in (-0.1, np.zeros((5, 3)) + 0.1, np.full((6, 3), np.nan)):
        with pytest.raises(InputError, match="tilt_B_rad of a twin"):
            ss.twin(cube, known | {"tilt_B_rad": wrong})
