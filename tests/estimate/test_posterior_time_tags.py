"""Wrong time tags: the likelihood integrated over their errors, and posteriors of such telemetry."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import logsumexp

import sunspin as ss
from sunspin.dynamics import batch
from sunspin.estimate.posterior.data import readings
from sunspin.estimate.posterior.likelihood import Likelihood
from sunspin.estimate.posterior.model import State, model
from sunspin.estimate.posterior.tags import tagged, turned
from sunspin.vehicle import Vehicle
from tests.support.vehicles import small_cube

SUN = np.array([0.3, 0.5, 0.8]) / np.linalg.norm([0.3, 0.5, 0.8])
RATE = np.array([0.08, -0.15, 0.16])
SMALL = {"max_rate_rad_s": 0.3, "inertia": 0.0, "steady_torque": 0.0}


@pytest.fixture(scope="module")
def cube() -> Vehicle:
    return small_cube()


def telemetry_of(vehicle: Vehicle, off_s: float, seed: int = 0):
    """Telemetry of `RATE`, its time tags off by `off_s` (one sigma)."""
    rng = np.random.default_rng(seed)
    t = 15.0 * np.arange(16) + np.concatenate([[0.0], rng.uniform(-2, 2, 15)])
    data = ss.twin(vehicle, {"omega_B": RATE, "sun_B": SUN, "t_s": t}, seed=seed)
    return data.assign_coords(
        time=("time", t + off_s * rng.standard_normal(len(t)), data["time"].attrs)
    )


@pytest.mark.parametrize("off_s", [0.003, 0.03, 0.3])
def test_the_likelihood_integrated_over_time_tag_errors_agrees_with_a_fine_sum(cube, off_s):
    data, _, _ = readings(cube, telemetry_of(cube, off_s))
    likelihood = Likelihood(model(cube, SMALL | {"time_s": off_s}, 1.0)[0], data, 1e-9)
    state = State(RATE[None], SUN[None], np.zeros((1, len(likelihood.model.unknowns))))
    prediction = likelihood.predict(state)
    found, best = tagged(likelihood, prediction, state.u, off_s)
    assert found == pytest.approx(likelihood.samples(prediction, state.u), abs=1e-12)
    shifts = off_s * np.linspace(-6, 6, 2001)
    sun, rate = (np.repeat(x, len(shifts), axis=0) for x in (prediction.sun, prediction.rate))
    power = likelihood.power(
        turned(sun, rate, np.tile(shifts[:, None], (1, len(data)))),
        np.repeat(state.u, len(shifts), 0),
    )
    each = likelihood.readings(
        power, np.repeat(likelihood.noise(state.u), len(shifts), axis=0)
    ).sum(axis=-1)
    prior = -0.5 * (shifts[:, None] / off_s) ** 2 - np.log(off_s) - 0.5 * np.log(2 * np.pi)
    exact = logsumexp(each + prior, axis=0) + np.log(shifts[1] - shifts[0])
    assert np.abs(found[0] - exact).max() < 0.1 and abs(found.sum() - exact.sum()) < 0.3
    without = likelihood.readings(
        likelihood.power(prediction.sun, state.u), likelihood.noise(state.u)
    ).sum(axis=-1)
    assert (
        off_s < 0.1 or abs(without.sum() - exact.sum()) > 10
    )  # negative control: it is not nothing
    assert np.abs(best).max() < 4.0 * off_s + 1e-12


@pytest.mark.long
@pytest.mark.parametrize("max_rate", [0.25, pytest.param(0.3, marks=pytest.mark.slow)])
def test_time_tags_that_are_off_are_reported_and_modelled(max_rate, cube):
    """Said to be exact they are not believed, as the residuals tell; the region that allows for them holds the truth."""
    telemetry, small = telemetry_of(cube, 0.3, seed=1), SMALL | {"max_rate_rad_s": max_rate}
    found = ss.posterior(cube, telemetry, small, seed=0, draws=1000, workers=1)
    assert (
        0.12 < found.attrs["time_sigma_s"] < 0.6
        and "time tags seem to be off" in found.attrs["verdict"]
    ), found.attrs
    assert found.attrs["verdict_word"] == "not sure", found.attrs["verdict"]
    off = _at_first_tag(cube, telemetry) - found["solutions"]["omega_B"].values[0]
    assert off @ np.linalg.solve(found["solutions"]["omega_cov_B"].values[0], off) < 16.3, (
        found.attrs["verdict"]
    )
    told = ss.posterior(cube, telemetry, small | {"time_s": 0.3}, seed=0, draws=1000, workers=1)
    spreads = [tree["solutions"]["omega_cov_B"].values[0] for tree in (found, told)]
    sizes = np.sqrt(np.trace(spreads, axis1=1, axis2=2))
    assert 0.5 < sizes[0] / sizes[1] < 2.0 and "time tags" not in told.attrs["verdict"], sizes


def _at_first_tag(cube: Vehicle, telemetry) -> np.ndarray:
    rows = batch.Rows(RATE[None], SUN[None], np.zeros((1, 0)))
    return batch.run(cube, rows, [float(telemetry["time"].values[0])], error=1e-8).omega_B[0, 0]


def test_exact_time_tags_are_not_modelled_as_off(cube):
    found = ss.posterior(cube, telemetry_of(cube, 0.0), SMALL, seed=0, draws=1000, workers=1)
    assert found.attrs["time_sigma_s"] == 0.0 and found.attrs["verdict_word"] == "unique", (
        found.attrs["verdict"]
    )
