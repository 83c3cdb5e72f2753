"""Rates from sparse Sun directions or powers, simulated with a known truth: coverage, aliases, times. All data are synthetic."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.estimate.model import SUN_N, Body, Model, Noise, Observations, Track
from sunspin.estimate.observe import rounded_to_s
from sunspin.estimate.one_pass import with_time_errors
from sunspin.estimate.terms.directions import SunDirections
from sunspin.output.kinds.rates import rates_tables
from sunspin.solve.rotations import components_after_rotation
from sunspin.vehicle import Fact, TelemetryForm
from sunspin.vehicle.sensors import Gyro, Sensors
from tests.support.passes import errors_in_sigmas, tumbling_pass
from tests.support.simulate import CUBE_WITHOUT_NOISE_STATED as CUBE
from tests.support.simulate import pulls, simulated_pass, telemetry_of, uneven_times
from tests.support.vehicles import units
from validation.passes import FACES, observe, spin


def test_parameters_estimated_with_the_motion_cover_the_truth():
    """Moments off by 2 to 3 %, with a stated sigma: each estimate lies where its sigma says."""
    fact = Fact(value=0.0, sigma=0.002)
    stated = replace(CUBE, inertia_kg_m2=np.diag([0.041, 0.0485, 0.0305]))
    stated = replace(stated, facts={"body.inertia_kg_m2": fact})
    data, _ = tumbling_pass(CUBE, 30, 20.0, seed=5, omega_B=[0.03, -0.04, 0.05], spread=0.3)
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
    light = {"albedo": 0.05, "speed": [30.0]}
    data, run = tumbling_pass(craft, 14, 15.0, 3, [0.02, 0.03, -0.01], spread=0.3, **light)
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
    light, omega = {"albedo": 0.05, "noise": 0.02}, [0.004, -0.003, 0.012]
    data, run = tumbling_pass(CUBE, 6, 40.0, seed=1, omega_B=omega, spread=0.0, **light)
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
    alone, craft, data, run = evenly_spaced
    craft = replace(craft, sensors=Sensors(gyro=Gyro(("x", "y", "z"), 1.0, np.zeros(3), 5e-4)))
    gyro = run["omega_B"].values + 5e-4 * np.random.default_rng(2).normal(size=(6, 3))
    seen = data.assign(gyro_B=(("time", "axis"), gyro))
    both = ss.rates(craft, seen, acceleration_noise=1e-4, max_rate_rad_s=0.16)
    assert both["probability"].values[0, 0] > 0.9 and (pulls(both, run) ** 2).mean() < 4.0
    assert np.all(both["omega_sigma_all_B"].values[0] < alone["omega_sigma_all_B"].values[0])
    assert both.attrs["gyro_used"] == 1 and alone.attrs["gyro_used"] == 0


def test_the_estimated_attitude_rotates_the_sun_of_N_into_the_body():
    omega = [0.01, 0.02, 0.0]
    data, _ = tumbling_pass(CUBE, 8, 20.0, seed=4, omega_B=omega, spread=0.3, albedo=0.05)
    result = ss.rates(CUBE, data, acceleration_noise=2e-5, max_rate_rad_s=0.04)
    turned = Rotation.from_quat(result["B_from_N"].values).apply(SUN_N)
    assert np.abs(turned - result["sun_B"].values).max() < 1e-12
    for name, least in (("B_from_N", 0.0), ("curve_B_from_N", 0.99)):
        q = result[name].values
        assert np.einsum("ni,ni->n", q[1:], q[:-1]).min() > least


def test_with_a_largest_rate_below_every_solution_nothing_fits_and_is_decided():
    still = {"spread": 0.0, "noise": 0.001}
    data, _ = tumbling_pass(CUBE, 6, 20.0, seed=5, omega_B=[0.0, 0.05, 0.0], **still)
    result = ss.rates(CUBE, data, acceleration_noise=1e-6, max_rate_rad_s=1e-4)
    assert not result["fits"].values.any() and not result["decided"].values.any()
    assert "NO SOLUTION FITS" in result.attrs["verdict"]


def test_a_largest_rate_that_nobody_stated_is_named_if_it_is_low():
    """One and a half revolutions between samples 45 s apart are 12 deg/s; the advice is to state a larger rate."""
    data, _ = tumbling_pass(CUBE, 20, 45.0, seed=5, omega_B=[0.03, -0.04, 0.05], spread=0.3)
    assumed = ss.rates(CUBE, data, acceleration_noise=1e-5)
    assert assumed["decided"].values[0] and "no rate above 1" in assumed.attrs["verdict"]
    stated = ss.rates(CUBE, data, acceleration_noise=1e-5, max_rate_rad_s=np.radians(20))
    assert stated["decided"].values[0] and "no rate above" not in stated.attrs["verdict"]


OFFSET_S = np.array([-2.0, 3.0, 0.0, 5.0, 1.0, -4.0])


@pytest.mark.long
def test_stated_reading_offsets_give_right_rates_that_would_be_wrong_without():
    """At 4 deg/s some panels are read 20 degrees late: unstated, the rate is off three times as far, and nothing shows it (of
    twelve seeds five were decided beyond three sigma then)."""
    rng = np.random.default_rng(1)
    axis, sun = units(rng.normal(size=(2, 3)))
    t = uneven_times(rng, 25, 8.0, 0.2)
    run = ss.propagate(CUBE, np.radians(4) * axis, sun, None, t)
    omega, sun = run["omega_B"].values, run["sun_B"].values
    light = [
        ss.panel_power(CUBE, components_after_rotation(sun, late * omega))[:, k]
        for k, late in enumerate(OFFSET_S)
    ]
    power = np.stack(light, axis=1) + 0.01 * rng.normal(size=(25, 6))
    data = telemetry_of(CUBE, t, np.maximum(power, 0))
    offsets = dict(zip(CUBE.panel_names, OFFSET_S, strict=True))
    pulls, misses = [], []
    for stated in (False, True):
        form = TelemetryForm(noise=0.01, offset_s=offsets if stated else {})
        craft = replace(CUBE, telemetry=form)
        result = ss.rates(craft, data, max_rate_rad_s=0.1, acceleration_noise=2e-5)
        miss = result["omega_mean_B"].values[0, 0] - omega.mean(axis=0)
        misses.append(np.degrees(np.abs(miss).max()))
        pulls.append(np.abs(miss / result["omega_sigma_B"].values[0, 0]).max())
    assert pulls[1] < 2 and 3 * misses[1] < misses[0], (pulls, misses)


# ---- times in whole seconds: recognised, and counted among the errors of readings -------------------------------------------


@pytest.mark.parametrize(
    ("t_s", "unit_s"),
    [
        (np.round(10.3 * np.arange(20)), 1.0),  # a device with an interval of its own
        (1.7e9 + np.round(10.3 * np.arange(20)), 1.0),
        (np.round(10.03 * np.arange(40), 1), 0.1),
        (10.3 * np.arange(20), 0.0),
        (10.0 * np.arange(20), 0.0),
        (np.delete(10.0 * np.arange(20), [3, 4, 9]), 0.0),  # rows are missing
        (np.add.outer(60.0 * np.arange(4), np.arange(5)).ravel(), 0.0),  # bursts, a second apart
        (np.array([0.0, 30.0, 50.0, 75.0]), 0.0),  # whole multiples of 5 s
        (np.round(np.arange(20) * 15 / 86400, 5) * 86400, 0.864),  # days with five digits
        (np.array([7.0]), 0.0),
    ],
)
def test_times_are_rounded_if_a_unit_divides_them_and_no_multiple_of_it_does(t_s, unit_s):
    assert rounded_to_s(t_s) == unit_s
    assert rounded_to_s(np.append(t_s, t_s[-1])) == unit_s  # a row that came twice


def made_pass(seed, interval_s, rounded):
    """Return a box at 14 deg/s, sampled at an even interval with times in whole seconds or as they are."""
    rng = np.random.default_rng(seed)
    t_s = interval_s * np.arange(45)
    start = rng.normal(size=3)
    start *= np.radians(14.0) / np.linalg.norm(start)
    made = observe(FACES, *spin(start, t_s), t_s, 0.01, rng)
    times = np.round(t_s) if rounded else t_s
    return made._replace(telemetry=made.telemetry.assign_coords(time=times))


def test_rates_of_times_in_whole_seconds_are_decided_and_within_their_errors():
    """A body turns by 4 deg in the error of a time. Without it five of eight such passes are POOR FIT, one is decided and off.

    The sigmas of the same pass with exact times are much smaller.
    """
    made, exact = (made_pass(2, 5.3, rounded) for rounded in (True, False))
    result, of_exact = (ss.rates(one.vehicle, one.telemetry) for one in (made, exact))
    assert result["decided"].values[0] and "count as rounded" in result.attrs["verdict"]
    assert np.abs(errors_in_sigmas(result, made.omega)).max() < 4.5
    assert of_exact["sigma_x"].values[0, 0] < result["sigma_x"].values[0, 0] / 1.5
    assert "rounded" not in of_exact.attrs["verdict"]


def test_errors_of_times_turn_directions_across_the_motion_and_cost_the_density_that_they_spread():
    """A body turns at 0.1 rad/s about an axis 30 degrees from the Sun: a time off by 0.5 s moves the Sun by 0.025 rad."""
    axis = np.array([0.0, np.sin(np.pi / 6), np.cos(np.pi / 6)])
    covariance = np.broadcast_to(0.01**2 * np.eye(3), (6, 3, 3))
    sun = SunDirections.of(np.broadcast_to(SUN_N, (6, 3)), covariance)
    obs = Observations(np.arange(6.0), np.zeros((6, 3)), (sun,), 0.5)
    model = Model(obs, Body(np.eye(3), np.zeros((0, 3, 3))), Noise(1e-4), 0.1)
    attitude = np.broadcast_to(np.eye(3), (1, 6, 3, 3))
    motion = Track.unfitted(attitude, np.broadcast_to(0.1 * axis, (1, 6, 3)))
    wider = with_time_errors(model, [motion], 0.02)
    assert np.allclose(wider.obs.terms[0].covariance[:, 0, 0], 0.01**2 + 0.025**2)
    # the density at the centre of two normal numbers falls by the ratio of their variances
    assert np.isclose(wider.log_prior, -6 * np.log(1 + 2.5**2))
    assert with_time_errors(model, [motion], 0.03) is model
