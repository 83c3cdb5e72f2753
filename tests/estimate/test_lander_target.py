"""The posterior of a lander's model as the sampler asks for it: derivatives against differences, and one posterior."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.dynamics.torques import Steady
from sunspin.estimate.lander.mixture import at_first_sample
from sunspin.estimate.lander.motions import Shots
from sunspin.estimate.lander.priors import constant_torques
from sunspin.estimate.lander.target import LanderTarget
from sunspin.estimate.terms.powers import SunStates
from tests.support.landers import OMEGA, PHILAE, SUN, lander_model, nominal


def near(model, count: int = 3, size: float = 1e-3) -> Shots:
    """Return motions close to that of the telemetry."""
    rng = np.random.default_rng(1)
    step = size * rng.normal(size=(count, 5 + len(model.unknowns)))
    step[:, :3] /= 700.0
    return nominal(model, count).moved(step)


def test_derivatives_of_a_motion_near_by_are_corrected_by_the_step():
    """They are turned into the new tangents, and give what is seen after the step; another body corrects nothing."""
    model = lander_model()
    target, shots = LanderTarget(model), near(model)
    first = target.linearised(shots).slopes
    step = np.zeros((len(shots), 5 + len(model.unknowns)))
    step[:, 3:5] = 0.02
    there = shots.moved(step)
    then = target.linearised(there, first).slopes
    back = np.einsum("kc,kcnw->knw", shots.from_centre(there)[:, :5], then.seen_slopes)
    assert then.seen + back == pytest.approx(first.seen, abs=3e-5)
    other = Shots(shots.omega, shots.sun, shots.u + 0.5)
    assert target.linearised(other, first).slopes.seen_slopes == pytest.approx(first.seen_slopes)


def test_slopes_in_brightness_and_tilts_are_those_of_the_equations_without_the_prior():
    model = lander_model(tilt=0.02)
    target, shots = LanderTarget(model), near(model)
    of = target.linearised(shots)
    slope, curvature = target.reading_slopes(of.slopes.seen, shots.u, 1.0)
    prior = shots.u[:, target.reading_unknowns]
    assert -slope + prior == pytest.approx(of.slope[:, 5:], rel=1e-3, abs=1e-2)
    own = of.matrix[:, 5:, 5:] - np.eye(len(target.reading_unknowns))
    assert curvature == pytest.approx(own, rel=1e-3, abs=1e-2 * np.abs(own).max())


def test_likelihood_is_that_of_the_model():
    model = lander_model()
    target, shots = LanderTarget(model), near(model)
    expected = model.log_likelihood(model.carried(shots, 1e-5), shots.u)
    assert target.log_likelihood(target.run(shots), shots.u) == pytest.approx(expected, abs=1e-3)


def test_simulated_readings_fit_their_motion_as_well_as_real_ones():
    """Real readings that were made by the model itself fit worse than about half of the simulated ones."""
    model = lander_model()
    shots = nominal(model, 400)
    target = LanderTarget(model)
    seen, rng = target.run(shots), np.random.default_rng(0)
    states = SunStates.of(seen[..., :3], seen[..., 3:])
    own = shots.u[:, model.of_panels]
    made = model.panels.replicated(states, own, rng)
    # bright readings scatter by the stated noise about the prediction, but for outliers
    power = model.panels.predicted(states, own, np.zeros(seen.shape[:2]))
    bright = power > 10 * model.panels.sigma
    scatter = ((made.power - power) / model.panels.sigma)[bright]
    assert np.median(np.abs(scatter)) == pytest.approx(0.6745, rel=0.08)
    assert np.mean(np.abs(scatter) > 5) == pytest.approx(0.02, abs=0.006)
    real = made.log_density(states, own)
    worse = target.log_replicated(seen, shots.u, rng) <= real
    assert np.mean(worse) == pytest.approx(0.5, abs=0.08)
    # and far worse ones do not: all readings off by three sigmas
    off = replace(model.panels, power=model.panels.power + 3 * model.panels.sigma)
    worse = target.log_replicated(seen, shots.u, rng) <= off.log_density(states, own)
    assert np.mean(worse) < 0.01


def test_readings_far_from_the_prediction_are_outliers():
    model = lander_model()
    panels = model.panels
    power = panels.power.copy()
    sample, panel = np.argwhere(panels.lit)[0]
    power[sample, panel] += 12 * panels.sigma[panel]
    terms = tuple(replace(panels, power=power) if one is panels else one for one in model.obs.terms)
    spoilt = replace(model, obs=replace(model.obs, terms=terms))
    probability = LanderTarget(spoilt).outlier_probability(nominal(spoilt, 3))
    assert probability[sample, panel] > 0.99
    probability[sample, panel] = 0.0
    assert probability.max() < 0.2
    assert not probability[~panels.used].any()


@pytest.mark.parametrize("frame", ["B", "N"])
def test_motions_at_the_first_sample_lead_to_those_at_the_reference(frame):
    """With the torque as it is given there, whether it is constant in the body or in space."""
    model = next(one for one in constant_torques(lander_model(), {}) if one.frame == frame)
    model = model.after(300.0, model.max_rate)
    shots = nominal(model)
    steady = model.places("steady_torque")
    shots.u[:, steady] = [0.02, -0.03, 0.04]
    first = at_first_sample(model, shots)
    mean = np.trace(PHILAE.require_inertia()) / 3
    torques = [Steady(mean * first.steady[0])]
    run = ss.propagate(
        PHILAE, first.omega[0], first.sun[0], first.wheels[0], [0.0, 300.0], torques=torques
    )
    np.testing.assert_allclose(run["omega_B"].values[1], OMEGA, atol=1e-5)
    np.testing.assert_allclose(run["sun_B"].values[1], SUN, atol=1e-4)
