"""Rates from sparse Sun directions or powers, simulated with a known truth: coverage, aliases, messages. All data are synthetic."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.estimate.carry import step
from sunspin.estimate.model import SUN_N, Body
from sunspin.output.kinds.rates import rates_tables
from sunspin.vehicle import Fact
from tests.support.simulate import CUBE_WITHOUT_NOISE_STATED as CUBE
from tests.support.simulate import pulls, simulated_pass, uneven_times


def test_parameters_estimated_with_the_motion_cover_the_truth():
    """Moments off by 2 to 3 %, with a stated sigma: each estimate lies where its sigma says."""
    rng, fact = np.random.default_rng(5), Fact(value=0.0, sigma=0.002)
    stated = replace(CUBE, inertia_kg_m2=np.diag([0.041, 0.0485, 0.0305]))
    stated = replace(stated, facts={"body.inertia_kg_m2": fact})
    data, _ = simulated_pass(
        CUBE, [0.03, -0.04, 0.05], uneven_times(rng, 30, 20.0, 0.3), rng, albedo=0.0
    )
    result = ss.rates(stated, data, acceleration_noise=1e-5, max_rate_rad_s=0.15)
    truth = [1.0, 1.25, 0.75, 0.0, 0.0, 0.0]  # in mean moments: xx, yy, zz, xy, xz, yz
    names = result["estimate"].values.tolist()
    value, sigma = (result[f"estimate_{what}"].values[0] for what in ("value", "sigma"))
    assert names[:6] == [f"inertia_{pair}" for pair in ("xx", "yy", "zz", "xy", "xz", "yz")]
    assert np.abs((value[:6] - truth) / sigma[:6]).max() < 3.5 and sigma[:6].max() < 0.05
    assert names[6:] == [f"gain_{panel}" for panel in data["panel"].values]
    assert np.abs((value[6:] - 1.0) / sigma[6:]).max() < 3.5
    table = {table.name: table.frame for table in rates_tables(result)}["estimates"]
    assert table["estimate_value"].tolist() == value.tolist()
    assert set(table["estimate_unit"]) == {"1"}


@pytest.mark.evidence(
    "rates", "modelled", "two simulated tumbling cubes with albedo; twelve in the long test"
)
@pytest.mark.parametrize("passes", [2, pytest.param(12, marks=pytest.mark.long)])
def test_rates_from_powers_with_albedo_cover_the_truth(passes, reached):
    """Tumbling cubes seen every 20 s with Earth's light on dark faces: the truth lies where the sigmas say."""
    rng = np.random.default_rng(8)
    square = []
    for _ in range(passes):
        data, run = simulated_pass(
            CUBE, 0.03 * rng.normal(size=3), uneven_times(rng, 12, 20.0, 0.3), rng
        )
        result = ss.rates(CUBE, data, acceleration_noise=2e-5, max_rate_rad_s=0.15)
        assert result["probability"].values[0, 0] > 0.5
        square.append((pulls(result, run) ** 2).mean())
    assert np.quantile(square, 0.8) < 3.0  # bounded: not over-confident
    reached("squared error over stated variance, mean", np.mean(square))
    assert np.mean(square) > 0.05  # and not so wide as to say nothing
    assert result.attrs["synthetic"] == 1


@pytest.mark.evidence(
    "rates", "modelled", "a simulated body with a wheel; without its wheel it must not fit"
)
def test_rates_of_a_body_with_a_wheel_cover_the_truth():
    wheel = ss.Wheel("w", [0, 0, 1], 3e-4, speed_rad_s=30.0)
    craft = replace(CUBE, wheels=(wheel,))
    rng = np.random.default_rng(3)
    data, run = simulated_pass(
        craft, [0.02, 0.03, -0.01], uneven_times(rng, 14, 15.0, 0.3), rng, speed=[30.0]
    )
    result = ss.rates(craft, data, acceleration_noise=2e-5, max_rate_rad_s=0.05)
    assert (pulls(result, run) ** 2).mean() < 4.0
    without = ss.rates(CUBE, data, acceleration_noise=2e-5, max_rate_rad_s=0.05)
    # the control: without its wheel it does not fit
    assert without["cost"].values[0, 0] > result["cost"].values[0, 0] + 20
    assert "NO SOLUTION FITS" in without.attrs["verdict"]
    assert "NO SOLUTION" not in result.attrs["verdict"]


@pytest.fixture(scope="module")
def evenly_spaced():
    """Rates of a body of unknown inertia from samples 40 s apart, the body, telemetry and true motion."""
    data, run = simulated_pass(
        CUBE, [0.004, -0.003, 0.012], np.arange(6) * 40.0, np.random.default_rng(1), noise=0.02
    )
    craft = replace(CUBE, inertia_kg_m2=None)
    return ss.rates(craft, data, acceleration_noise=1e-4, max_rate_rad_s=0.16), craft, data, run


def test_evenly_spaced_samples_have_aliases_that_are_listed(evenly_spaced):
    result, _, _, run = evenly_spaced
    weight = result["probability"].values[0]
    assert np.isfinite(weight).sum() >= 2
    assert np.nansum(weight) == pytest.approx(1.0, abs=0.02)
    truth = run["omega_B"].values.mean(axis=0)
    found = result["omega_mean_B"].values[0, np.isfinite(weight)]
    assert np.min(np.linalg.norm(found - truth, axis=1)) < 0.004
    assert "1 pass with several solutions" in result.attrs["verdict"] or weight[0] >= 0.9
    assert "others" not in result.attrs["verdict"]  # there is one pass


@pytest.mark.evidence("rates", "modelled", "simulated telemetry with a gyro")
def test_a_gyro_decides_between_aliases_and_narrows_the_rate(evenly_spaced):
    from sunspin.vehicle.sensors import Gyro, Sensors

    alone, craft, data, run = evenly_spaced
    craft = replace(craft, sensors=Sensors(gyro=Gyro(("x", "y", "z"), 1.0, np.zeros(3), 5e-4)))
    gyro = run["omega_B"].values + 5e-4 * np.random.default_rng(2).normal(size=(6, 3))
    both = ss.rates(
        craft,
        data.assign(gyro_B=(("time", "axis"), gyro)),
        acceleration_noise=1e-4,
        max_rate_rad_s=0.16,
    )
    assert both["probability"].values[0, 0] > 0.9 and (pulls(both, run) ** 2).mean() < 4.0
    assert np.all(both["omega_sigma_all_B"].values[0] < alone["omega_sigma_all_B"].values[0])
    assert both.attrs["gyro_used"] == 1 and alone.attrs["gyro_used"] == 0


def test_the_estimated_attitude_rotates_the_sun_of_N_into_the_body():
    rng = np.random.default_rng(4)
    data, _ = simulated_pass(CUBE, [0.01, 0.02, 0.0], uneven_times(rng, 8, 20.0, 0.3), rng)
    result = ss.rates(CUBE, data, acceleration_noise=2e-5, max_rate_rad_s=0.04)
    turned = Rotation.from_quat(result["B_from_N"].values).apply(SUN_N)
    assert np.abs(turned - result["sun_B"].values).max() < 1e-12
    for name, least in (("B_from_N", 0.0), ("curve_B_from_N", 0.99)):
        q = result[name].values
        assert np.einsum("ni,ni->n", q[1:], q[:-1]).min() > least


@pytest.mark.evidence("rates", "verified", "the reference propagator over one interval")
def test_a_motion_step_agrees_with_the_reference_propagator(reached):
    t = np.array([0.0, 25.0])
    run = ss.propagate(CUBE, [0.03, -0.02, 0.05], [0.0, 0.0, 1.0], None, t)
    wheels, body = np.zeros((1, 3)), Body.of(CUBE)
    start = np.array([[[0.03, -0.02, 0.05]]])
    end = step(body.inertia, start, np.array([25.0]), (wheels, wheels))
    assert np.abs(end.omega[0, 0] - run["omega_B"].values[1]).max() < 1e-6
    off = np.abs(end.turned[0, 0] @ SUN_N - run["sun_B"].values[1])
    reached("difference of the direction", off, "", 1e-4)
    assert off.max() < 1e-4


def test_with_a_largest_rate_below_every_solution_nothing_fits_and_is_decided():
    data, _ = simulated_pass(
        CUBE,
        [0.0, 0.05, 0.0],
        np.arange(6) * 20.0,
        np.random.default_rng(5),
        noise=0.001,
        albedo=0.0,
    )
    result = ss.rates(CUBE, data, acceleration_noise=1e-6, max_rate_rad_s=1e-4)
    assert not result["fits"].values.any() and not result["decided"].values.any()
    assert "NO SOLUTION FITS" in result.attrs["verdict"]
