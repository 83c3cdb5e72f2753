"""A magnetometer by field strength and Sun angle: closed forms, and the calibration that `rates` uses along an orbit."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sunspin.environment.field import MODEL_SIGMA_T
from sunspin.environment.orbit import SunAlongZ
from sunspin.estimate.calibrate import propagated
from sunspin.estimate.orbit.attitudes import FIRST_SENSOR, OrbitModel, OrbitState
from sunspin.estimate.orbit.calibration import (
    Calibration,
    CalibrationStart,
    FieldCalibration,
    calibrate_magnetometer,
    fit_sensors,
    priors,
)
from sunspin.estimate.orbit.invariants import (
    MATRIX,
    ZERO,
    MagnetometerModel,
    MagnetometerState,
    Predicted,
    Sky,
    fit_magnetometer,
)
from sunspin.estimate.orbit.readings import Readings, orbit_readings
from sunspin.telemetry.assess import assess
from tests.support.calibration_cases import calibration_case, orbit_of_case
from tests.support.orbit_cases import check_case, orbit_of
from tests.support.passes import slope_of
from tests.support.vehicles import units

SCALE_T = 6e-8


def shown(field, sun, sun_sigma=0.1):
    """Return readings (n, 3) of a field and of the Sun, without Sun sensors."""
    n = len(field)
    covariance = np.tile(sun_sigma**2 * np.eye(3), (n, 1, 1))
    t_s, no_angle = np.arange(n) * 30.0, np.full((n, 0, 2), np.nan)
    no_turn, sigma = np.zeros((n, 0), dtype=bool), np.full(n, sun_sigma)
    pass_of = np.arange(n) // 20
    return Readings(t_s, field, sun, covariance, np.ones(n), no_angle, no_turn, sun, sigma, pass_of)


def aligned(rng, n=200, noise=12.0):
    """A satellite that its dipole holds along the field, so that readings vary little, with a zero that the file does not know."""
    strength = rng.uniform(2.2e-5, 4.5e-5, n)
    field = strength[:, None] * units([-0.4, -0.9, 0.0] + 0.15 * rng.normal(size=(n, 3)))
    sun = units(rng.normal(size=(n, 3)))
    reading = (field - field.mean(axis=0)) / SCALE_T + noise * rng.normal(size=(n, 3))
    toward = (field * sun).sum(axis=1)
    seen = units(sun + 0.1 * rng.normal(size=(n, 3)))
    return shown(reading, seen), Predicted(strength[None], toward[None], np.ones((1, n)))


def test_a_zero_that_is_exact_on_one_axis_has_a_sigma_that_can_be_inverted():
    vehicle, telemetry, *elements = check_case(1, 1)
    sensors = vehicle.sensors
    stated = replace(sensors.magnetometer, zero_sigma=np.array([30.0, 0.0, 30.0]))
    vehicle = replace(vehicle, sensors=replace(sensors, magnetometer=stated))
    field = 1e3 * np.random.default_rng(6).normal(size=(20, 3))
    orbit = orbit_of(elements[0], telemetry, elements[1])
    prior = priors(vehicle, shown(field, units(field)), orbit)
    np.testing.assert_allclose(prior[ZERO], [30.0, 0.03, 30.0])


def test_an_exact_linear_sensor_gives_back_its_matrix_and_zero_whatever_the_attitudes():
    """In two bodies that are rotated differently: the strength and the angle to the Sun are all that the fit needs."""
    vehicle, data, elements, about = check_case(1, 1)
    orbit, t_s = orbit_of(elements, data, about), data["time"].values
    matrix, zero = np.eye(3) + 0.08 * np.random.default_rng(5).normal(size=(3, 3)), [0.5, -0.3, 0.9]
    sky = Sky.along(orbit, t_s, np.zeros(1))
    for seed in (1, 2):
        attitude = Rotation.random(len(t_s), random_state=seed).as_matrix()
        field, sun = (np.einsum("nij,nj->ni", attitude, v) for v in (sky.field[0], sky.sun))
        reading = np.linalg.solve(matrix, (field / 4e-5).T).T + zero
        readings = shown(reading, sun, 0.03)._replace(t_s=t_s)
        model, state = fit_magnetometer(readings, sky.invariants())
        in_T = model.calibration(state)[0]
        np.testing.assert_allclose(in_T[MATRIX].reshape(3, 3), 4e-5 * matrix, atol=4e-8)
        # the fit with attitudes, from a start that is far off
        bare = replace(vehicle, sensors=replace(vehicle.sensors, magnetometer=None))
        prior = priors(bare, readings, orbit)
        prior[12] = prior[13] = 1e-3  # the place is known
        start = CalibrationStart(4e-5 * np.eye(3), np.zeros(3))
        fitted = fit_sensors(orbit, bare, readings, start, prior)
        np.testing.assert_allclose(fitted.matrix_T, 4e-5 * matrix, atol=4e-8)
        np.testing.assert_allclose(fitted.zero, zero, atol=1e-3)
        assert fitted.strength[1] < 1e-8 and fitted.angle[1] < 1e-3


@pytest.mark.parametrize("of_readings", [False, True])
def test_the_jacobian_of_strength_and_angle_is_that_of_their_residuals(of_readings):
    readings, predicted = aligned(np.random.default_rng(1), 20)
    model = MagnetometerModel(readings, 200.0, 3e-5, of_readings=of_readings)
    unknown = 0.2 * np.random.default_rng(2).normal(size=(1, 12))
    scatter, scale = np.array([[0.1, 0.7]]), np.ones(1)
    parts = (predicted.strength / 3e-5, predicted.toward / 3e-5, scatter, scale)
    state = MagnetometerState(unknown, *parts)
    for which, (_, jacobian) in enumerate(model.residuals(state)):

        def residual(step, which=which):
            return model.residuals(state._replace(unknown=unknown + step))[which][0]

        for k, step in enumerate(1e-6 * np.eye(12)):
            expected, atol = slope_of(residual, step, 1e-6), 1e-5 * np.abs(jacobian).max()
            np.testing.assert_allclose(jacobian[..., k], expected, rtol=1e-5, atol=atol)


def test_the_gradient_with_attitudes_projected_out_is_that_of_the_cost():
    """Of every unknown: matrix, zero, offset, drift, and biases and scales of two Sun sensors, one of them with a rotated y."""
    case = calibration_case(2, 1, gyro=False)
    data = case.telemetry.isel(time=slice(0, None, 4))
    orbit = orbit_of_case(case, data)
    sensors = replace(case.vehicle.sensors, sun_sensors=case.vehicle.sensors.sun_sensors[:2])
    vehicle = replace(case.vehicle, sensors=sensors)
    readings = orbit_readings(assess(case.vehicle, data), 100)
    field, turned = readings.field / 4e4, readings.t_s[:, None] % 50 < [0, 25]
    readings = readings._replace(field=field, angle=readings.angle[:, :2], y_turned=turned)
    sky = Sky.along(orbit, readings.t_s, np.arange(-60.0, 61.0, 20.0))
    rng = np.random.default_rng(0)
    unknown = 0.05 * rng.normal(size=24)
    model = OrbitModel(vehicle, readings, sky, 4e-5, np.eye(24))
    attitude = model.triad_attitudes(unknown)
    for _ in range(20):  # to the attitudes that fit best
        attitude = model.project_out_attitudes(unknown, attitude).attitude
    state = OrbitState(unknown[None], attitude[None])
    gradient = model.linearise(state).slope[0]

    def cost(step):
        return model.linearise(state._replace(unknown=state.unknown + step)).cost[0]

    for k, step in enumerate(1e-5 * np.eye(24)):
        off = abs(slope_of(cost, step, 1e-5) - gradient[k])
        assert off < 0.02 * abs(gradient[k]) + 1e-3, k
    assert (np.abs(gradient) > 0.01).all()


def test_noise_of_the_magnetometer_shrinks_its_matrix_less_by_the_distance_of_readings():
    """Than by the field's strength; noise of an eighth of the field, nearly all that it varies here, shrinks both."""

    def scale(state):
        return np.cbrt(abs(np.linalg.det(np.eye(3) + state.unknown[0, MATRIX].reshape(3, 3))))

    usual = []
    for seed in range(6):
        model, state = fit_magnetometer(*aligned(np.random.default_rng(seed)))
        usual.append(scale(state) * model.unit_T / model.unit / SCALE_T)
        readings, predicted = aligned(np.random.default_rng(seed), noise=60.0)
        model, state = fit_magnetometer(readings, predicted)
        by_strength = MagnetometerModel(readings, model.unit, model.unit_T, of_readings=False).fit(
            state, fit_scatter=True
        )
        assert scale(by_strength) < 0.97 * scale(state)
    assert 0.9 < np.median(usual) < 1.1


def fit_of_one_sensor() -> Calibration:
    """Return a fit with one Sun sensor and correlated unknowns; every other sigma is larger by the scatter between passes."""
    rng = np.random.default_rng(3)
    half = rng.normal(size=(19, 30)) * 0.01
    half[12] *= 100
    model = half @ half.T
    wider = np.where(np.arange(19) % 2, 2.0, 0.5)
    robust = model * np.outer(wider, wider)
    values, nothing = 0.05 * rng.normal(size=19), np.zeros(2)
    units, noise = (3e-5, 600.0, 1), (1e-6, 1.0)
    return Calibration(
        values, model, robust, np.eye(19), *units, *noise, nothing, nothing, {"field": 300}
    )


def numbers(fit: Calibration) -> np.ndarray:
    return np.concatenate([fit.matrix_T.ravel(), fit.matrix_T @ fit.zero, fit.values[12:13]])


def test_errors_of_matrix_zero_and_place_follow_from_the_covariance_of_the_fit():
    fit = fit_of_one_sensor()

    def changed(step):
        return numbers(replace(fit, values=fit.values + step))

    slope = np.stack([slope_of(changed, step, 1e-6) for step in 1e-6 * np.eye(19)], axis=1)
    calibration = fit.magnetometer(fit.shift_s, fit.shift_sigma_s)
    expected = slope @ fit.covariance @ slope.T
    expected[12] /= fit.shift_sigma_s
    expected[:, 12] /= fit.shift_sigma_s
    size = np.sqrt(np.diag(expected))
    ours, scale = calibration.errors.T @ calibration.errors, np.outer(size, size)
    np.testing.assert_allclose(ours / scale, expected / scale, atol=1e-6)
    np.testing.assert_allclose(
        np.diag(fit.covariance)[1], 4 * np.diag(fit.by_curvature)[1], rtol=1e-9
    )
    assert (np.diag(fit.covariance) >= np.diag(fit.by_curvature)).all()
    assert fit.bias.shape == (1, 2) and fit.scale[0, 0] == 1 + fit.values[FIRST_SENSOR + 2]


def test_at_another_offset_the_calibration_follows_its_regression_on_the_place():
    fit = fit_of_one_sensor()
    sigma = fit.shift_sigma_s
    calibration = fit.magnetometer(fit.shift_s + 2 * sigma, 5 * sigma)
    follows = fit.values[:13] + 2 * fit.covariance[:13, 12] / sigma
    expected = replace(fit, values=np.concatenate([follows, fit.values[13:]]))
    np.testing.assert_allclose(calibration.matrix, expected.matrix_T, rtol=1e-9)
    np.testing.assert_allclose(calibration.zero, expected.matrix_T @ expected.zero, rtol=1e-9)
    np.testing.assert_allclose((calibration.errors[:, 12] ** 2).sum(), 1.0, rtol=1e-9)


def test_directions_of_panels_turn_all_fields_by_one_angle():
    """No field changes along itself."""
    fit, turned_rad = fit_of_one_sensor(), 0.03
    field, variances = 3e-5 * np.array([0.6, 0.0, 0.8]), []
    for common_error in (0.0, turned_rad):
        fitted = replace(fit, turned_rad=common_error)
        calibration = fitted.magnetometer(fit.shift_s, fit.shift_sigma_s)
        reading = np.linalg.solve(calibration.matrix, field + calibration.zero)
        columns = calibration.reading_errors(reading[None])[0]
        variances.append(columns.T @ columns)
    across = field @ field * np.eye(3) - np.outer(field, field)
    expected = turned_rad**2 * across
    np.testing.assert_allclose(variances[1] - variances[0], expected, atol=1e-6 * expected.max())
    # the calibrated matrix states this error too
    scaled = [
        propagated(
            replace(fit, turned_rad=error), lambda each: (each.matrix_T / each.scale_T).ravel()
        )[1]
        for error in (0.0, turned_rad)
    ]
    added = np.sqrt(scaled[1] ** 2 - scaled[0] ** 2)
    np.testing.assert_allclose(added[~np.eye(3, dtype=bool).ravel()], turned_rad, rtol=0.2)


def test_a_reading_whose_strength_is_off_has_a_larger_noise():
    nothing = np.zeros((13, 13))
    calibration = FieldCalibration(1e-9 * np.eye(3), np.zeros(3), nothing, 5e-7)
    field = 3e-5 * np.array([[1.0, 0, 0], [0, 0.6, 0.8], [0, 1, 0], [0, 0, 1]])
    reading = 1e9 * field * np.array([1.0, 1.4, 0.8, np.nan])[:, None]
    noise = np.hypot(5e-7, MODEL_SIGMA_T)
    sigma = calibration.sigma_T(reading, field, np.zeros((4, 3)))
    np.testing.assert_allclose(sigma, [noise, 1.2e-5, 6e-6, noise], rtol=1e-9)
    # an error of the matrix's first element, or of the place, may explain the strength along x
    first, place = nothing.copy(), nothing.copy()
    first[0, 0], place[12, 12] = 1e-9, 1.0
    vague, far = (replace(calibration, errors=errors) for errors in (first, place))
    assert vague.sigma_T(1.2 * reading[:1], field[:1], np.zeros((1, 3)))[0] < 1.1 * noise
    assert far.sigma_T(1.2 * reading[:1], field[:1], 0.23 * field[:1])[0] == noise


def test_the_calibration_along_an_orbit_is_within_its_errors_of_the_true_sensor():
    squares = []
    for i in range(4):
        case = calibration_case(3, i, gyro=False)
        data = case.telemetry.drop_vars(["sun_sensor_angle", "sun_sensor_y_turned"])
        data = data.isel(time=slice(None, None, 2))
        orbit = orbit_of_case(case, data)
        sensors = replace(case.vehicle.sensors, sun_sensors=())
        assessment = assess(replace(case.vehicle, sensors=sensors), data)
        calibration = calibrate_magnetometer(SunAlongZ(orbit), assessment)
        scale = case.truth["magnetometer.scale_T"]
        true_matrix = (case.truth["magnetometer.matrix"] * scale).reshape(3, 3)
        true_zero = true_matrix @ case.truth["magnetometer.zero"]
        off_matrix, off_zero = true_matrix - calibration.matrix, true_zero - calibration.zero
        off = np.concatenate([off_matrix.ravel(), off_zero])
        covariance = calibration.errors[:, :12].T @ calibration.errors[:, :12]
        squares.append(off @ np.linalg.solve(covariance, off) / 12)
        assert 1.5e-7 < calibration.noise_T < 6e-7  # 300 nT
    assert max(squares) < 4 and np.mean(squares) < 2
    assert calibrate_magnetometer(None, assessment) is None
    assert calibrate_magnetometer(orbit, assess(case.vehicle, data.drop_vars("field_B"))) is None


@pytest.mark.parametrize("count", [1, 3])
def test_few_readings_leave_the_calibration_wide_and_finite(count):
    vehicle, data, given, about = check_case(0, 1)
    data = data.isel(time=slice(0, count))
    calibration = calibrate_magnetometer(orbit_of(given, data, about), assess(vehicle, data))
    reading = data["field_B"].values
    field, columns = calibration.field(reading), calibration.reading_errors(reading)
    size = np.linalg.norm(field, axis=1)
    assert np.isfinite(calibration.errors).all()
    # the strength is known as well as it was read, the direction is not
    strength = np.sqrt((np.einsum("nei,ni->ne", columns, field / size[:, None]) ** 2).sum(axis=1))
    assert (strength < 2e-6).all()
    spread = np.sqrt((columns**2).sum(axis=(1, 2)) / 2) / size
    assert (np.degrees(spread) > 8.0).all()
