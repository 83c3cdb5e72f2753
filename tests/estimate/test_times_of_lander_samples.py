"""Errors of the times of a lander's samples: integrated out of the likelihood, and followed by the fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sunspin.base.errors import InputError
from sunspin.estimate.lander.fit import FINAL_ERROR, FitProblem, Fitting
from sunspin.estimate.lander.motions import Shots
from sunspin.estimate.lander.priors import with_priors
from sunspin.estimate.lander.target import LanderTarget
from sunspin.estimate.lander.window import observe_window
from sunspin.estimate.posterior import posterior
from sunspin.estimate.terms.powers import SunStates
from sunspin.telemetry.assess import assess
from tests.support.landers import (
    BOX_OMEGA,
    BOX_PRIORS,
    BOX_T_S,
    FEW,
    NOISE,
    OMEGA,
    PHILAE,
    SUN,
    box,
    box_telemetry,
    lander_model,
    lander_telemetry,
    sigmas_off,
)
from tests.support.passes import slope_of

TIME_S = 0.5
"""Sigma of the times: the body turns by 0.05 rad in it."""


def late_model(time_s=TIME_S, noise=NOISE):
    """Return the model of Philae with samples 20 s apart, and errors of their times."""
    return lander_model(20.0 * np.arange(8), noise, time_s=time_s)


def off(model, count=1, size=2e-3):
    """Return motions near that of the telemetry."""
    rng = np.random.default_rng(2)
    omega = OMEGA + size * rng.standard_normal((count, 3)) / 10
    return Shots(omega, np.tile(SUN, (count, 1)), np.zeros((count, len(model.unknowns))))


def test_the_density_of_a_sample_is_the_integral_over_its_time():
    """Gauss-Hermite quadrature of the exact times' density, each sample by itself, agrees to 0.005 a sample."""
    model = late_model()
    exact = replace(model.panels, time_s=0.0)
    shots = off(model)
    states, own = model.carried(shots, 1e-9).seen, shots.u[:, model.of_panels]
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
    shots = Shots(OMEGA + line, sun, np.zeros((count, len(model.unknowns))))
    density = LanderTarget(model).log_likelihood(LanderTarget(model).run(shots), shots.u)
    assert np.ptp(density) > 20.0
    assert np.abs(np.diff(density, 2)).max() < 0.3


def test_noise_is_not_taken_for_less_because_times_fit_it():
    """Times at their best take up one reading of each sample: the noise of a fit stays within 2.5 sigmas of the true one."""
    model = late_model(2.0)
    free = np.ones(len(model.unknowns), dtype=bool)
    fitting = Fitting(FitProblem(model, free, FINAL_ERROR), off(model, size=0.0))
    fitting.go(1.0, 8)
    fitting.fit_noise()
    fitted = fitting.shots.u[0, model.places("noise")[0]]
    value = fitting.problem.of_panels(fitting.linear.value)
    own = fitting.shots.u[:, model.of_panels]
    of_all = model.panels.best_noise(value, own, np.zeros(1), -5.0)
    assert abs(fitted) < 2.5
    assert fitted > of_all[0, model.panels.places("noise")[0]] + 0.3


def test_slopes_are_those_of_the_cost_with_times_at_their_best():
    model = late_model()
    shots, target = off(model), LanderTarget(model)
    problem, base = target._problem, target.linearised(shots)

    def cost(change):
        """Return the cost of a motion of another rate, whose times are at their best."""
        motion = replace(shots, omega=shots.omega + change)
        seen, _ = problem.seen(motion, 1e-10)
        still = np.zeros((len(motion), 5, *seen.shape[1:]))
        linear = problem.differences(motion, seen, still)
        return problem.system(motion.u, linear, 1.0).cost[0]

    for axis, change in enumerate(1e-6 * np.eye(3)):
        assert base.slope[0, axis] == pytest.approx(slope_of(cost, change, 1e-6), rel=0.02, abs=3.0)


def test_curvature_is_less_by_what_the_times_take_up():
    """That of the fit is the change of the slope about a motion that fits exactly; with exact times it is far larger."""
    model = late_model(noise=0.0)
    target, shots = LanderTarget(model), off(model, size=0.0)
    matrix = target.linearised(shots).matrix[0, :3, :3]

    def slopes(change):
        return target.linearised(replace(shots, omega=shots.omega + change)).slope[0, :3]

    for axis, change in enumerate(2e-5 * np.eye(3)):
        expected, scale = slope_of(slopes, change, 2e-5), np.abs(matrix).max()
        assert matrix[axis] == pytest.approx(expected, rel=0.05, abs=0.03 * scale)
    exact = LanderTarget(late_model(0.0, noise=0.0)).linearised(shots).matrix[0, :3, :3]
    assert np.linalg.eigvalsh(exact).max() > 1.2 * np.linalg.eigvalsh(matrix).max()


def test_the_posterior_takes_samples_that_are_off_in_time():
    """Times off by 2 s, a tenth of a radian: taken for exact they look like noise; stated, the truth is within its sigmas."""
    craft, telemetry, rng = box(), box_telemetry(), np.random.default_rng(5)
    off_s = np.append(0.0, 2.0 * rng.standard_normal(len(BOX_T_S) - 1))
    late = telemetry.assign_coords(time=BOX_T_S + off_s)
    priors = (BOX_PRIORS | {"time_s": 2.0}, BOX_PRIORS)
    stated, exact = (posterior(craft, late, p, workers=1, settings=FEW) for p in priors)
    assert exact.attrs["noise_sigmas"] > 2 > abs(stated.attrs["noise_sigmas"])
    assert stated.attrs["log_evidence"] > exact.attrs["log_evidence"] + 3
    assert stated.attrs["time_sigma_s"] == 2.0
    assert sigmas_off(stated, BOX_OMEGA)[0] < 3.5


def test_throttled_panels_with_errors_of_times_are_refused():
    vehicle = replace(PHILAE, telemetry=replace(PHILAE.telemetry, throttled=True))
    assessment = assess(vehicle, lander_telemetry(20.0 * np.arange(8)))
    with pytest.raises(InputError, match="errors of times"):
        with_priors(assessment, observe_window(assessment), {"time_s": 0.5})
