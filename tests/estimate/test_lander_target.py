"""The posterior of a lander's model as the sampler asks for it: derivatives against differences, one posterior, errors of times."""

from dataclasses import replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.dynamics.torques import Steady
from sunspin.estimate.lander.fit import FINAL_ERROR, SEARCH_ERROR, FitProblem, Fitting
from sunspin.estimate.lander.mixture import at_first_sample
from sunspin.estimate.lander.motions import LanderMotions
from sunspin.estimate.lander.priors import constant_torques, with_priors
from sunspin.estimate.lander.target import LanderTarget
from sunspin.estimate.lander.window import observe_window
from sunspin.estimate.terms.powers import SunStates
from sunspin.telemetry.assess import assess
from tests.support.landers import (
    NOISE,
    OMEGA,
    PHILAE,
    SUN,
    lander_model,
    lander_telemetry,
    noisy,
    nominal,
)


def near(model, count: int = 3, size: float = 1e-3) -> LanderMotions:
    """Return motions close to that of the telemetry."""
    rng = np.random.default_rng(1)
    step = size * rng.normal(size=(count, 5 + len(model.unknowns)))
    step[:, :3] /= 700.0
    return nominal(model, count).moved(step)


def test_likelihood_is_that_of_the_model():
    """To rounding for runs of the same error, and far below one for runs a thousand times as exact."""
    model = lander_model()
    target, motions = LanderTarget(model), near(model)
    expected = model.log_likelihood(model.sun_states(motions, SEARCH_ERROR), motions.u)
    assert target.log_likelihood(target.track(motions), motions.u) == pytest.approx(
        expected, abs=1e-9
    )
    exact = model.log_likelihood(model.sun_states(motions, 1e-3 * SEARCH_ERROR), motions.u)
    assert expected == pytest.approx(exact, abs=0.05)


def test_simulated_readings_fit_their_motion_as_well_as_real_ones():
    """Real readings that were made by the model itself fit worse than about half of the simulated ones."""
    model = lander_model()
    motions = nominal(model, 400)
    target = LanderTarget(model)
    track, rng = target.track(motions), np.random.default_rng(0)
    states = SunStates.of(track[..., :3], track[..., 3:])
    own = motions.u[:, model.of_panels]
    made = model.panels.replicated(states, own, rng)
    # bright readings scatter by the stated noise about the prediction, but for outliers
    power = model.panels.predicted(states, own, np.zeros(track.shape[:2]))
    bright = power > 10 * model.panels.sigma
    scatter = ((made.power - power) / model.panels.sigma)[bright]
    assert np.median(np.abs(scatter)) == pytest.approx(0.6745, rel=0.08)
    assert np.mean(np.abs(scatter) > 5) == pytest.approx(0.02, abs=0.006)
    real = made.log_density(states, own)
    worse = target.log_replicated(track, motions.u, rng) <= real
    assert np.mean(worse) == pytest.approx(0.5, abs=0.08)
    # and far worse ones do not: all readings off by three sigmas
    off = replace(model.panels, power=model.panels.power + 3 * model.panels.sigma)
    worse = target.log_replicated(track, motions.u, rng) <= off.log_density(states, own)
    assert np.mean(worse) < 0.01


def test_noise_of_dark_panels_is_no_sunlight_if_the_file_states_no_threshold():
    """Else half of the dark readings are lit ones without power, and no simulated readings fit as well as the real ones."""
    form = replace(noisy().telemetry, lit_threshold=None)
    telemetry = lander_telemetry(100.0 * np.arange(8), NOISE)
    assessment = assess(replace(PHILAE, telemetry=form), telemetry)
    panels = with_priors(assessment, observe_window(assessment), {})[0].panels
    assert np.array_equal(panels.lit, panels.power > 3 * NOISE)
    assert panels.lit.sum() < (panels.power > 0).sum() - 5


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
    motions = nominal(model)
    motions.u[:, model.indices("steady_torque")] = [0.02, -0.03, 0.04]
    first = at_first_sample(model, motions)
    state = first.omega[0], first.sun[0], first.wheels[0]
    torques = [Steady(np.trace(PHILAE.require_inertia()) / 3 * first.steady[0])]
    run = ss.propagate(PHILAE, *state, [0.0, 300.0], torques=torques)
    np.testing.assert_allclose(run["omega_B"].values[1], OMEGA, atol=1e-5)
    np.testing.assert_allclose(run["sun_B"].values[1], SUN, atol=1e-4)


TIME_S = 0.5
"""Sigma of the times: the body turns by 0.05 rad in it."""


def late_model(time_s=TIME_S, noise=NOISE):
    """Return the model of Philae with samples 20 s apart, and errors of their times."""
    return lander_model(20.0 * np.arange(8), noise, time_s=time_s)


def off(model):
    """Return a motion near that of the telemetry."""
    change = 2e-4 * np.random.default_rng(2).standard_normal((1, 3))
    return replace(nominal(model), omega=OMEGA + change)


def test_the_density_of_a_sample_is_the_integral_over_its_time():
    """Gauss-Hermite quadrature of the exact times' density, each sample by itself, agrees to 0.005 a sample."""
    model = late_model()
    exact = replace(model.panels, time_s=0.0)
    motions = off(model)
    states, own = model.sun_states(motions, 1e-9), motions.u[:, model.of_panels]
    nodes, weight = np.polynomial.hermite_e.hermegauss(201)
    total = 0.0
    for k in range(len(model.obs)):
        here = SunStates.of(states.sun_B[:, [k]], states.omega[:, [k]])
        one, each = exact.take(slice(k, k + 1)), []
        late = replace(one, time_s=TIME_S)
        for node in nodes:
            power = late.predicted(here, own, np.full((1, 1), TIME_S * node))
            each.append(np.exp(one._log_densities(power, own)[0, 0][one.used[0]].sum()))
        total += np.log(np.average(each, weights=weight))
    found = model.panels.log_density(states, own)[0]
    assert found == pytest.approx(total, abs=0.005 * len(model.obs))
    # and differs much from that of exact times
    assert abs(exact.log_density(states, own)[0] - total) > 1.0


def test_the_density_has_no_jumps_where_a_panel_lights_up_within_the_error_of_a_time():
    """Second differences along a line of rates are small: both peaks of the error count. About one it jumps by 2.9."""
    model, count = late_model(2.0), 161
    line = np.linspace(-6e-3, 6e-3, count)[:, None] * np.array([1.0, -0.5, 0.7])
    sun = np.tile(SUN, (count, 1))
    motions = LanderMotions(OMEGA + line, sun, np.zeros((count, len(model.unknowns))))
    density = LanderTarget(model).log_likelihood(LanderTarget(model).track(motions), motions.u)
    assert np.ptp(density) > 20.0
    assert np.abs(np.diff(density, 2)).max() < 0.3


def test_noise_is_not_taken_for_less_because_times_fit_it():
    """Times at their best take up one reading of each sample: the noise of a fit stays within 2.5 sigmas of the true one."""
    model = late_model(2.0)
    free = np.ones(len(model.unknowns), dtype=bool)
    fitting = Fitting(FitProblem(model, free, FINAL_ERROR), nominal(model))
    fitting.fit_under(1.0, 8)
    fitting.fit_noise()
    fitted = fitting.motions.u[0, model.indices("noise")[0]]
    value = fitting.problem.panel_residuals(fitting.system.extras.residuals)
    own = fitting.motions.u[:, model.of_panels]
    of_all = model.panels.best_noise(value, own, np.zeros(1), -5.0)
    assert abs(fitted) < 2.5
    assert fitted > of_all[0, model.panels.indices("noise")[0]] + 0.3


def test_throttled_panels_with_errors_of_times_are_refused():
    vehicle = replace(PHILAE, telemetry=replace(PHILAE.telemetry, throttled=True))
    assessment = assess(vehicle, lander_telemetry(20.0 * np.arange(8)))
    with pytest.raises(InputError, match="errors of times"):
        with_priors(assessment, observe_window(assessment), {"time_s": 0.5})
