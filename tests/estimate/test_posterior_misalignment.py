"""Panel misalignment as an unknown of the posterior, with a sigma from the file or the caller."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.estimate.posterior.data import readings
from sunspin.estimate.posterior.fit import Fit
from sunspin.estimate.posterior.likelihood import Likelihood
from sunspin.estimate.posterior.model import State, model
from sunspin.estimate.posterior.tilt import spread
from sunspin.estimate.posterior.turns import drawn_turns
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from sunspin.vehicle.file import parse_vehicle
from sunspin.vehicle.parts import Fact
from sunspin.vehicle.response.panels import misalignment_sigma

RATE, SUN = (
    np.array([0.05, -0.08, 0.11]),
    np.array([0.3, 0.5, 0.8]) / np.linalg.norm([0.3, 0.5, 0.8]),
)
TILT = 0.04
PRIORS = {"max_rate_rad_s": 0.2, "inertia": 0.0, "steady_torque": 0.0}


@pytest.fixture(scope="module")
def cube() -> Vehicle:
    panels = [
        Panel("xyzXYZ"[k], normal, 1.0)
        for k, normal in enumerate(np.concatenate([np.eye(3), -np.eye(3)]))
    ]
    form = TelemetryForm(quantity="current_A", noise=0.005)
    return Vehicle(
        "cube", inertia_kg_m2=np.diag([0.010, 0.012, 0.008]), panels=panels, telemetry=form
    )


def simulated(cube, seed):
    t = 20.0 * np.arange(12) + np.concatenate([[0.0], np.random.default_rng(0).uniform(-3, 3, 11)])
    return ss.twin(
        cube, {"omega_B": RATE, "sun_B": SUN, "t_s": t, "scale": 0.5, "tilt_B_rad": TILT}, seed=seed
    )


@pytest.fixture(scope="module")
def tilted(cube):
    return simulated(cube, 3)


@pytest.mark.evidence(
    "posterior", "verified", "finite differences by each panel's misalignment and by the common one"
)
def test_derivatives_by_panel_misalignment_agree_with_differences(cube, tilted):
    data, _, _ = readings(cube, tilted)
    unknown, told = model(cube, PRIORS | {"tilt": 0.05, "tilt_common": 0.03}, 0.5)
    assert (told["tilt"], told["tilt_common"]) == ("2.86 deg (given)", "1.72 deg (given)")
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


def test_misalignment_sigmas_come_from_the_file_unless_given(cube):
    assert (
        not np.any([*misalignment_sigma(cube)[0], misalignment_sigma(cube)[1]])
        and model(cube, PRIORS, 0.5)[0].turns is None
    )
    facts = {
        "panel.y.normal_B": Fact([0.0, 1.0, 0.0], 0.02),
        "panel.Z.normal_B": Fact([0.0, 0.0, -1.0], [0.03, 0.04, 0.0]),
    }
    stated = replace(cube, facts=facts)
    assert misalignment_sigma(stated)[0] == pytest.approx([0, 0.02, 0, 0, 0, 0.05 / 3**0.5])
    unknown, told = model(stated, PRIORS, 0.5)
    named = [x.name for x in unknown.unknowns if x.kind == "tilt"]
    assert named == [f"tilt_{panel}_{side}_rad" for panel in "yZ" for side in (1, 2)]
    assert told["tilt"].endswith("(vehicle file)")
    assert model(stated, PRIORS | {"tilt": 0.0}, 0.5)[0].turns is None
    form = "[panel_response]\nturned_B_rad = { value = [0, 0, 0.2], sigma = 0.05 }\n"
    file = parse_vehicle(
        'name = "a"\n[[panel]]\nname = "x"\nnormal_B = [1, 0, 0]\ngain_A = 1\n' + form, "here"
    )
    assert misalignment_sigma(file)[1] == 0.05
    np.testing.assert_allclose(file.panel_normals_B, [[np.cos(0.2), np.sin(0.2), 0]], atol=1e-15)
    np.testing.assert_allclose(ss.panel_power(file, [0, 1, 0]), [np.sin(0.2)], atol=1e-15)
    across = (
        unknown.turns @ cube.panel_normals_B.T
    )  # a turn about the normal itself would change nothing
    assert np.abs(np.einsum("kpp->kp", across)).max() < 1e-15
    wide = spread(
        0.005, cube, model(cube, PRIORS | {"tilt": 0.03, "tilt_common": 0.04}, 0.5)[0].unknowns, 0.5
    )
    assert wide == pytest.approx(
        np.hypot(0.005, 0.015 * (2 / 3) ** 0.5)
    )  # the common turn is an unknown of the search
    with pytest.raises(InputError, match="sigma of tilt must be zero"):
        model(cube, {"tilt": -1.0}, 0.5)


@pytest.mark.evidence(
    "posterior",
    "modelled",
    "best fits of simulated telemetry with tilted panels; negative control: tilt not modelled",
)
def test_a_misalignment_sigma_widens_the_rates_by_as_much_as_it_moves_them(cube, reached):
    """Squared distances of true rates from best fits, three degrees of freedom each: right where tilts are unknowns only."""
    found = {0.0: [], TILT: []}
    for seed in range(8):
        data, _, _ = readings(cube, simulated(cube, seed))
        for tilt, squares in found.items():
            unknown, _ = model(cube, PRIORS | {"tilt": tilt, "noise": 0.0}, 0.5)
            start = State(RATE[None], SUN[None], np.zeros((1, len(unknown.unknowns))))
            fit = Fit(Likelihood(unknown, data, 1e-8), start, ((3.0, 4), (1.0, 12)), curved=True)(
                np.arange(1)
            )
            off = fit["omega"][0] - RATE
            squares.append(off @ np.linalg.solve(np.linalg.inv(fit["hessian"][0])[:3, :3], off))
    wrong, right = (float(np.sum(squares)) for squares in found.values())
    reached("squared distance of true rates, of 24", right, "", limit=chi2.ppf(0.999, 24))
    assert chi2.ppf(0.001, 24) < right < chi2.ppf(0.999, 24) < wrong


@pytest.mark.evidence(
    "posterior",
    "verified",
    "the integral over misalignments by draws of the prior",
)
def test_misalignments_drawn_given_the_motion_have_the_stated_density(cube, tilted, reached):
    data, _, _ = readings(cube, tilted)
    unknown, _ = model(cube, PRIORS | {"tilt": 0.004, "tilt_common": 0.004, "noise": 0.0}, 0.5)
    likelihood = Likelihood(unknown, replace(data, sigma=np.full(6, 0.03)), 1e-8)
    n, rng = 3_000, np.random.default_rng(1)
    state = State(RATE[None], SUN[None], np.zeros((1, len(unknown.unknowns))))
    one = likelihood.predict(state)
    every = replace(
        one,
        **{key: np.broadcast_to(value, (n, *value.shape[1:])) for key, value in vars(one).items()},
    )
    white = rng.standard_normal((n, len(unknown.unknowns)))
    white[:, unknown.where("scale")] = 0.0
    u, density = drawn_turns(likelihood, every, white)
    assert (u != white).any(axis=0).sum() == 15 and np.abs(u - white).max() > 0.1
    prior = -0.5 * np.sum(u**2 + np.log(2 * np.pi) * (u != 0), axis=1)
    drawn, plain = likelihood.of(every, u) + prior - density, likelihood.of(every, white)
    told, expected = np.exp(drawn - plain.max()), np.exp(plain - plain.max())
    assert (
        told.std() < 0.1 * told.mean() < expected.std()
    )  # all but Gaussian: the draws are worth as many of the posterior's own
    off = abs(told.mean() / expected.mean() - 1) / (expected.std() / expected.mean() / n**0.5)
    reached("integral over turns, sampling errors off", off, "", limit=4)
    assert off < 4


def test_simulated_telemetry_takes_misalignments_or_their_sigma(cube, tilted):
    known = {"omega_B": RATE, "sun_B": SUN, "t_s": tilted["time"].values, "scale": 0.5}
    again = ss.twin(
        cube, known | {"tilt_B_rad": tilted.attrs["truth_tilt_B_rad"].reshape(6, 3)}, seed=3
    )
    np.testing.assert_array_equal(again["current_A"].values, tilted["current_A"].values)
    assert "truth_tilt_B_rad" not in ss.twin(cube, known, seed=3).attrs
    for wrong in (-0.1, np.zeros((5, 3)) + 0.1, np.full((6, 3), np.nan)):
        with pytest.raises(InputError, match="tilt_B_rad of a twin"):
            ss.twin(cube, known | {"tilt_B_rad": wrong})
