"""Dense passes: samples between those that the search keeps, and the mean over all samples."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.estimate.chain import whitening
from sunspin.estimate.dense import curve, propagate_to_all, residuals_by_sensor
from sunspin.estimate.model import Body, Model, Noise, Observations, Track
from sunspin.estimate.observe import HELD, thinned, wheel_models
from sunspin.estimate.settings import RATES
from sunspin.estimate.terms.field import FieldChange
from sunspin.solve.rotations import rotate_attitude
from sunspin.vehicle import Friction, Wheel
from tests.support.passes import slope_of, stated_model
from tests.support.simulate import pulls
from tests.support.vehicles import small_cube

WHEEL = Wheel("wheel", [0, 0, 1], 4e-5, 400.0, Friction(3e-8, 2e-10))
CRAFT = replace(small_cube(), inertia_kg_m2=np.diag([0.045, 0.047, 0.011]), wheels=(WHEEL,))
RATE, SUN, NOISE = np.radians([1.2, -2.5, 3.3]), np.array([0.6, -0.48, 0.64]), 1e-6


@pytest.fixture(scope="module")
def tumble():
    """Return a tumble of 300 samples 2 s apart: telemetry, the true motion, the model of all samples, places of the kept ones."""
    t_s = np.arange(0.0, 600.0, 2.0)
    truth = {"omega_B": RATE, "sun_B": SUN, "t_s": t_s, "wheel_speed_rad_s": 400.0, "scale": 1.0}
    telemetry = ss.twin(CRAFT, truth, seed=3)
    run = ss.propagate(CRAFT, RATE, SUN, 400.0, t_s)
    (momentum,) = (value for name, value in wheel_models(CRAFT, telemetry).items() if name != HELD)
    model = stated_model(CRAFT, telemetry, NOISE, 0.05).with_momentum(momentum)
    return telemetry, run, model, thinned(len(t_s), RATES.passes)


def attitudes(run) -> np.ndarray:
    """Return B_from_N (n, 3, 3) with the Sun along z of N."""
    turn, _ = Rotation.align_vectors(run["sun_B"].values[:1], [[0, 0, 1.0]])
    first = Rotation.from_quat(run["B_from_N"].values[0])
    return (Rotation.from_quat(run["B_from_N"].values) * first.inv() * turn).as_matrix()


def known(model, attitude, omega):
    """Return one motion that is known exactly."""
    n = len(attitude)
    u, covariance = np.zeros((1, len(model.unknowns))), np.zeros((1, n, 6, 6))
    return Track(attitude[None], omega[None], u, np.zeros(1), covariance)


def filled_from(model, kept, attitude, omega):
    """Return the motion carried from the kept samples to all, and the derivative of its mean rate."""
    some, noise = model.seeing(kept), np.full(len(kept) - 1, NOISE)
    motion = known(some, attitude[kept], omega[kept])
    return propagate_to_all(some, motion, model.obs.t_s, model.obs.momentum, noise)


def test_the_motion_between_kept_samples_is_the_true_one(tumble):
    _, run, model, kept = tumble
    omega = run["omega_B"].values
    track = filled_from(model, kept, attitudes(run), omega)[0]
    assert len(kept) <= RATES.passes.most_kept and np.diff(kept).max() > 5
    # a step of a fit is good to 1e-4 of a turn
    np.testing.assert_allclose(track.omega[0], omega, rtol=0, atol=5e-6)
    np.testing.assert_allclose(track.sun_B[0], run["sun_B"].values, rtol=0, atol=2e-4)
    np.testing.assert_array_equal(track.omega[0, kept], omega[kept])
    carried = np.setdiff1d(np.arange(len(omega)), kept)
    assert np.all(np.linalg.eigvalsh(track.covariance[0][carried]) > 0)


@pytest.mark.parametrize(("every", "wheel"), [(3, 0.0), (9, 400.0)])
def test_interpolated_curves_follow_the_true_motion(every, wheel, tumble):
    """With samples up to 80 degrees of turn apart; straight lines between them are far off."""
    at = np.arange(0, 121, every)
    craft = replace(CRAFT, wheels=(replace(WHEEL, speed_rad_s=wheel),))
    obs = tumble[2].obs.take(at)
    obs = replace(obs, momentum=obs.momentum * (wheel > 0))
    model = Model(obs, Body.of(craft), Noise(NOISE), 0.05)
    run = ss.propagate(craft, RATE, SUN, wheel, obs.t_s)
    t_s, track = curve(model, known(model, attitudes(run), run["omega_B"].values), NOISE)
    truth = ss.propagate(craft, RATE, SUN, wheel, t_s)
    omega = truth["omega_B"].values
    np.testing.assert_allclose(track.omega[0], omega, rtol=0, atol=2e-5)
    np.testing.assert_allclose(track.sun_B[0], truth["sun_B"].values, rtol=0, atol=1e-3)
    straight = [np.interp(t_s, obs.t_s, part) for part in run["omega_B"].values.T]
    off = np.abs(np.stack(straight, axis=1) - omega).max()
    assert off > 20 * np.abs(track.omega[0] - omega).max()
    assert np.abs(np.diff(t_s) - (t_s[-1] - t_s[0]) / (len(t_s) - 1)).max() < 1e-9
    assert np.all(np.einsum("nii->ni", track.covariance[0]) >= 0)
    assert np.isfinite(track.covariance).all()


def test_derivatives_of_the_mean_rate_agree_with_differences(tumble):
    _, run, model, kept = tumble
    attitude, omega = attitudes(run), run["omega_B"].values
    answer = filled_from(model, kept, attitude, omega)[1][0]

    def mean(change):
        return filled_from(model, kept, attitude, omega + change)[0].omega[0].mean(axis=0)

    for sample, axis in ((0, 0), (7, 1), (20, 2), (len(kept) - 1, 0)):
        change = np.zeros_like(omega)
        change[kept[sample], axis] = 1e-5
        expected = slope_of(mean, change, 1e-5)
        np.testing.assert_allclose(answer[sample, :, 3 + axis], expected, rtol=0, atol=2e-6)
    assert np.all(answer[..., :3] == 0)  # a turn of the start turns no rate


@pytest.mark.parametrize("share", [0.1, 0.5])
def test_the_error_between_kept_samples_is_that_of_a_bridge_between_both(share, tumble):
    """The product of the two laws that white acceleration gives from either held end, of a sphere."""
    # under so strong torques the 1e-6 rad that a chain allows besides count nothing
    span, noise = 40.0, 0.03

    def spread(dt: float) -> np.ndarray:
        white = whitening(Noise(noise), np.array([dt]))[0][0]
        return np.linalg.inv(white.T @ white)

    rest = (1 - share) * span
    back = np.eye(6)
    back[:3, 3:] = -rest * np.eye(3)  # from the second end back in time
    laws = spread(share * span), back @ spread(rest) @ back.T
    both = np.linalg.inv(sum(np.linalg.inv(law) for law in laws))
    sphere = Body(np.eye(3), np.zeros((0, 3, 3)), sphere=True)
    t_s = np.array([0.0, share * span, span])
    ends = Model(Observations(t_s[::2], np.zeros((2, 3)), ()), sphere, Noise(noise), 0.05)
    still = known(ends, np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3)))
    track = propagate_to_all(ends, still, t_s, np.zeros((3, 3)), np.array([noise]))[0]
    np.testing.assert_allclose(np.diag(track.covariance[0, 1]), np.diag(both), rtol=1e-6)


def test_revolutions_between_kept_samples_contradict_the_magnetometer_there(tumble):
    """Each sensor must fit at all samples: at the kept ones such a motion reads as the true one does."""
    _, run, model, kept = tumble
    attitude, rng = attitudes(run), np.random.default_rng(5)
    field = attitude @ [0.6, 0.0, 0.8] + 0.02 * rng.normal(size=(len(attitude), 3))
    compared = FieldChange(model.obs.t_s, field, 0.02, drift_N=np.zeros((len(field), 0, 3)))
    obs = replace(model.obs, terms=(*model.obs.terms, compared.of_pass(model.obs.t_s)))
    whole = replace(model, obs=obs)
    truth = filled_from(whole, kept, attitude, run["omega_B"].values)[0]
    # one revolution more about z between every two kept samples, and none at them
    phase = np.interp(obs.t_s, obs.t_s[kept], np.arange(len(kept))) % 1.0
    more = rotate_attitude(truth.attitude, 2 * np.pi * phase[:, None] * [0.0, 0.0, 1.0])
    shares = []
    for track in (truth, replace(truth, attitude=more)):
        residual = residuals_by_sensor(obs, whole.seeing(kept), track, kept)["magnetometer"][0]
        assert np.isfinite(residual).sum() > 7 * len(kept)
        shares.append(np.nanmean(residual > 3))
    assert shares[0] < 0.05 and shares[1] > 0.5


@pytest.mark.evidence("rates", "modelled", "the true mean rate of a simulated dense pass")
def test_a_dense_pass_reports_all_samples_and_their_mean(tumble, reached):
    telemetry, run, _, _ = tumble
    found = ss.rates(CRAFT, telemetry, max_rate_rad_s=0.09, acceleration_noise=NOISE)
    assert found.sizes["time"] == telemetry.sizes["time"] == found["misfit"].values[0, 0, 0]
    assert found.attrs["samples_searched"] == len(tumble[3]) and found["fits"].values.all()
    off = pulls(found, run)
    assert np.abs(off).max() < 4.5 and np.sqrt(np.mean(off**2)) < 1.6
    mean = run["omega_B"].values.mean(axis=0)
    between = ss.propagate(CRAFT, RATE, SUN, 400.0, found["curve_time"].values)["omega_B"].values
    off = (found["curve_omega_B"].values - between) / found["curve_omega_sigma_B"].values
    assert np.abs(off).max() < 4.5
    pull = np.abs(found["omega_mean_B"].values[0, 0] - mean) / found["omega_sigma_B"].values[0, 0]
    reached("distance of the mean rate", pull, "sigmas", limit=4.0)
    assert pull.max() < 4.0 and found["omega_sigma_B"].values[0, 0].max() < 2e-3
    kept = tumble[3]  # control: the mean over what is kept is another
    other = np.abs(run["omega_B"].values[kept].mean(axis=0) - mean)
    assert (other / found["omega_sigma_B"].values[0, 0]).max() > 20


def test_wheels_too_fast_for_the_sampling_are_refused(tumble):
    fast = replace(CRAFT, wheels=(replace(WHEEL, speed_rad_s=1e12),))
    with pytest.raises(InputError, match="more than can be followed"):
        ss.rates(fast, tumble[0], acceleration_noise=NOISE)
