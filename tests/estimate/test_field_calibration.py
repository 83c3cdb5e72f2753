"""The magnetometer calibration that `rates` uses: from the fit that estimated the along-track offset."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sunspin.environment.field import MODEL_SIGMA_T
from sunspin.estimate.orbit.field_calibration import FieldCalibration, _of_sensors
from sunspin.estimate.orbit.sensor_calibration import Calibration


def made() -> Calibration:
    """A fit with one Sun sensor and correlated unknowns; every other sigma is larger by the scatter between passes."""
    rng = np.random.default_rng(3)
    half = rng.normal(size=(19, 30)) * 0.01
    half[12] *= 100
    model = half @ half.T
    wider = np.where(np.arange(19) % 2, 2.0, 0.5)
    values = 0.05 * rng.normal(size=19)
    return Calibration(
        values,
        model,
        model * np.outer(wider, wider),
        np.eye(19),
        3e-5,
        600.0,
        1,
        1e-6,
        1.0,
        1.0,
        np.zeros(2),
        np.zeros(2),
        {"field": 300},
    )


def numbers(one: Calibration) -> np.ndarray:
    return np.concatenate([one.matrix_T.ravel(), one.matrix_T @ one.zero, one.values[12:13]])


def test_calibration_errors_follow_from_the_fit_of_matrix_zero_and_position():
    fit = made()
    slope = np.stack(
        [
            (
                numbers(replace(fit, values=fit.values + step))
                - numbers(replace(fit, values=fit.values - step))
            )
            / 2e-6
            for step in 1e-6 * np.eye(19)
        ],
        axis=1,
    )
    found = _of_sensors(fit, fit.shift_s, fit.shift_sigma_s)
    expected = slope @ fit.covariance @ slope.T
    expected[12] /= fit.shift_sigma_s
    expected[:, 12] /= fit.shift_sigma_s
    size = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        found.errors.T @ found.errors / np.outer(size, size),
        expected / np.outer(size, size),
        atol=1e-6,
    )
    np.testing.assert_array_equal(np.diag(fit.covariance) >= np.diag(fit.model), True)
    np.testing.assert_allclose(np.diag(fit.covariance)[1], 4 * np.diag(fit.model)[1], rtol=1e-9)


def test_the_calibration_depends_on_the_along_track_offset():
    """Moved by two sigmas the fit's other unknowns follow their regression on the place, and its sigma is the orbit's."""
    fit = made()
    sigma = fit.shift_sigma_s
    found = _of_sensors(fit, fit.shift_s + 2 * sigma, 5 * sigma)
    follows = fit.values[:13] + 2 * fit.covariance[:13, 12] / sigma
    expected = replace(fit, values=np.concatenate([follows, fit.values[13:]]))
    np.testing.assert_allclose(found.matrix, expected.matrix_T, rtol=1e-9)
    np.testing.assert_allclose(found.zero, expected.matrix_T @ expected.zero, rtol=1e-9)
    np.testing.assert_allclose((found.errors[:, 12] ** 2).sum(), 1.0, rtol=1e-9)


def test_a_reading_whose_field_strength_is_off_has_a_larger_noise():
    calibration = FieldCalibration(1e-9 * np.eye(3), np.zeros(3), np.zeros((13, 13)), 5e-7, 1e-9)
    field = 3e-5 * np.array([[1.0, 0, 0], [0, 0.6, 0.8], [0, 1, 0], [0, 0, 1]])
    reading = 1e9 * field * np.array([1.0, 1.4, 0.8, np.nan])[:, None]
    noise = np.hypot(5e-7, MODEL_SIGMA_T)
    sigma = calibration.sigma_T(reading, field, np.zeros((4, 3)))
    np.testing.assert_allclose(sigma, [noise, 1.2e-5, 6e-6, noise], rtol=1e-9)
    errors = np.zeros((13, 13))
    errors[0, 0] = 1e-9  # of the matrix's first element
    vague = replace(calibration, errors=errors)
    assert (
        vague.sigma_T(1.2 * reading[:1], field[:1], np.zeros((1, 3)))[0] < 1.1 * noise
    )  # it explains the strength along x
    errors = np.zeros((13, 13))
    errors[12, 12] = 1.0  # of the place, a sigma of which changes the strength by 7 uT
    far = replace(calibration, errors=errors)
    assert far.sigma_T(1.2 * reading[:1], field[:1], 0.23 * field[:1])[0] == noise
