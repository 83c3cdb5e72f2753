"""Dense passes: samples between those that the smoother keeps, and the mean over all samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.estimate.rates.dense import Dense, bridge, curve
from sunspin.estimate.rates.motion import Body
from sunspin.estimate.rates.observe import MAX_SAMPLES, observations, thinned
from sunspin.estimate.rates.smooth import whitening
from sunspin.estimate.rates.state import Motion, Track
from sunspin.estimate.rates.wheels import wheel_momenta
from sunspin.vehicle import Friction, Panel, TelemetryForm, Vehicle, Wheel
from tests.support.vehicles import LOWER_CASE_FACES

WHEEL = Wheel("wheel", [0, 0, 1], 4e-5, 400.0, Friction(3e-8, 2e-10))
CRAFT = Vehicle(
    "uneven",
    inertia_kg_m2=np.diag([0.045, 0.047, 0.011]),
    wheels=[WHEEL],
    panels=[Panel(name, normal, 1.0) for name, normal in LOWER_CASE_FACES.items()],
    telemetry=TelemetryForm(quantity="current_A", noise=0.02),
)
RATE, SUN, NOISE = np.radians([1.2, -2.5, 3.3]), np.array([0.6, -0.48, 0.64]), 1e-6


@pytest.fixture(scope="module")
def pass_():
    """A tumble of 300 samples 2 s apart: observations, the true motion, the samples kept."""
    t = np.arange(0.0, 600.0, 2.0)
    telemetry = ss.twin(
        CRAFT,
        {"omega_B": RATE, "sun_B": SUN, "t_s": t, "wheel_speed_rad_s": 400.0, "scale": 1.0},
        seed=3,
    )
    run = ss.propagate(CRAFT, RATE, SUN, 400.0, t)
    o, _, _ = observations(CRAFT, telemetry, None)
    momenta = wheel_momenta(CRAFT, telemetry)
    o = replace(
        o,
        momentum=next(
            value for name, value in momenta.items() if "coast" in name or len(momenta) == 1
        ),
    )
    return telemetry, run, o, thinned(np.arange(len(t)))


def attitudes(run) -> np.ndarray:
    """B_from_N with the Sun along z of N."""
    from scipy.spatial.transform import Rotation

    turn, _ = Rotation.align_vectors(run["sun_B"].values[:1], [[0, 0, 1.0]])
    first = Rotation.from_quat(run["B_from_N"].values[0])
    return (Rotation.from_quat(run["B_from_N"].values) * first.inv() * turn).as_matrix()


def test_the_motion_between_kept_samples_is_the_true_one(pass_):
    _, run, o, kept = pass_
    attitude, omega, every = attitudes(run), run["omega_B"].values, np.arange(len(o))
    track = Track(
        attitude[None, kept], omega[None, kept], covariance=np.zeros((1, len(kept), 6, 6))
    )
    motion = Motion(Body.of(CRAFT), NOISE, 0.1)
    found = Dense.of(o, every, kept, track, motion).filled(track)
    assert len(kept) <= MAX_SAMPLES and np.diff(kept).max() > 5
    np.testing.assert_allclose(
        found.omega[0], omega, rtol=0, atol=5e-6
    )  # a step of the smoother is good to 1e-4 of a turn
    np.testing.assert_allclose(found.sun_B[0], run["sun_B"].values, rtol=0, atol=2e-4)
    np.testing.assert_array_equal(found.omega[0, kept], omega[kept])
    assert np.all(np.linalg.eigvalsh(found.covariance[0][np.setdiff1d(every, kept)]) > 0)


@pytest.mark.parametrize("every", [3, 6, 9])
@pytest.mark.parametrize("wheel", [400.0, 0.0])
def test_interpolated_curves_follow_the_true_motion(every, wheel, pass_):
    """With samples up to 80 degrees of turn apart; straight lines between them are far off."""
    _, _, o, _ = pass_
    at = np.arange(0, 121, every)
    craft = replace(CRAFT, wheels=(replace(WHEEL, speed_rad_s=wheel),))
    o = replace(o.take(at), momentum=o.momentum[at] * (wheel > 0))
    run = ss.propagate(craft, RATE, SUN, wheel, o.t_s)
    track = Track(
        attitudes(run)[None], run["omega_B"].values[None], covariance=np.zeros((1, len(at), 6, 6))
    )
    t, found = curve(o, track, Motion(Body.of(craft), NOISE, 0.1))
    truth = ss.propagate(craft, RATE, SUN, wheel, t)
    np.testing.assert_allclose(found.omega[0], truth["omega_B"].values, rtol=0, atol=2e-5)
    np.testing.assert_allclose(found.sun_B[0], truth["sun_B"].values, rtol=0, atol=1e-3)
    straight = np.stack([np.interp(t, o.t_s, x) for x in run["omega_B"].values.T], axis=1)
    assert (
        np.abs(straight - truth["omega_B"].values).max()
        > 20 * np.abs(found.omega[0] - truth["omega_B"].values).max()
    )
    assert np.abs(np.diff(t) - (t[-1] - t[0]) / (len(t) - 1)).max() < 1e-9
    assert (
        np.all(np.einsum("nii->ni", found.covariance[0]) >= 0)
        and np.isfinite(found.covariance).all()
    )


def test_derivatives_of_the_mean_rate_agree_with_differences(pass_):
    _, run, o, kept = pass_
    attitude, omega, every = (
        attitudes(run)[None, kept],
        run["omega_B"].values[None, kept],
        np.arange(len(o)),
    )
    motion = Motion(Body.of(CRAFT), NOISE, 0.1)

    def mean(rates: np.ndarray) -> np.ndarray:
        track = Track(attitude, rates, covariance=np.zeros((1, len(kept), 6, 6)))
        return Dense.of(o, every, kept, track, motion).filled(track).omega[0].mean(axis=0)

    answer = Dense.of(o, every, kept, Track(attitude, omega), motion).mean_map()[0]
    for sample, axis in ((0, 0), (7, 1), (20, 2), (len(kept) - 1, 0)):
        change = np.zeros_like(omega)
        change[0, sample, axis] = 1e-5
        expected = (mean(omega + change) - mean(omega - change)) / 2e-5
        np.testing.assert_allclose(answer[sample, :, 3 + axis], expected, rtol=0, atol=2e-6)
    assert np.all(answer[..., :3] == 0)  # a turn of the start turns no rate


@pytest.mark.parametrize("share", [0.1, 0.5, 0.8])
def test_the_error_between_kept_samples_is_that_of_a_bridge_between_both(share):
    """The product of the two laws that white acceleration gives from either held end."""
    span, noise = 40.0, 3e-5

    def spread(dt: float) -> np.ndarray:
        white = whitening(np.array([dt]), noise)[0]
        return np.linalg.inv(white.T @ white)

    rest = (1 - share) * span
    back = np.eye(6)
    back[:3, 3:] = -rest * np.eye(3)  # from the second end back in time
    both = np.linalg.inv(
        np.linalg.inv(spread(share * span)) + np.linalg.inv(back @ spread(rest) @ back.T)
    )
    made = bridge(np.array([share]), np.array([span]), noise)[0]
    np.testing.assert_allclose(np.diag(made), np.diag(both), rtol=1e-6)


@pytest.mark.evidence("rates", "modelled", "the true mean rate of a simulated dense pass")
def test_a_dense_pass_reports_all_samples_and_their_mean(pass_, reached):
    telemetry, run, _, _ = pass_
    found = ss.rates(CRAFT, telemetry, max_rate_rad_s=0.09, acceleration_noise=NOISE)
    assert found.sizes["time"] == telemetry.sizes["time"]
    off = found["omega_B"].values - run["omega_B"].values
    sigma = np.sqrt(np.einsum("nii->ni", found["omega_cov_B"].values))
    assert np.abs(off / sigma).max() < 4.5 and np.sqrt(np.mean((off / sigma) ** 2)) < 1.6
    mean = run["omega_B"].values.mean(axis=0)
    between = ss.propagate(CRAFT, RATE, SUN, 400.0, found["curve_time"].values)["omega_B"].values
    assert (
        np.abs(
            (found["curve_omega_B"].values - between) / found["curve_omega_sigma_B"].values
        ).max()
        < 4.5
    )
    pull = np.abs(found["omega_mean_B"].values[0, 0] - mean) / found["omega_sigma_B"].values[0, 0]
    reached("distance of the mean rate", pull, "sigmas", limit=4.0)
    assert pull.max() < 4.0 and found["omega_sigma_B"].values[0, 0].max() < 2e-3
    kept = thinned(np.arange(len(off)))  # control: the mean over what is kept is another
    other = np.abs(run["omega_B"].values[kept].mean(axis=0) - mean)
    assert (other / found["omega_sigma_B"].values[0, 0]).max() > 20


def test_wheels_too_fast_for_the_sampling_are_refused(pass_):
    wheel = replace(WHEEL, speed_rad_s=1e12)
    with pytest.raises(InputError, match="more than can be followed"):
        ss.rates(replace(CRAFT, wheels=(wheel,)), pass_[0], acceleration_noise=NOISE)


@pytest.mark.parametrize("noise", [0.0, -1e-5, 1e-30, 1e30, np.nan])
def test_an_acceleration_noise_that_no_satellite_has_is_refused(pass_, noise):
    with pytest.raises(InputError, match="acceleration_noise must lie between"):
        ss.rates(CRAFT, pass_[0], acceleration_noise=noise)
