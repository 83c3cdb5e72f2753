"""Sensor models of the estimators: derivatives, a second magnetometer, a sensor left out. All telemetry is synthetic."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.estimate.rates import estimate
from sunspin.estimate.rates.common_errors import places_of, with_common
from sunspin.estimate.rates.hypotheses import (
    AS_STATED,
    Fit,
    Hypothesis,
    odd_one,
    ranked,
    sensors_left_out,
)
from sunspin.estimate.rates.motion import Body
from sunspin.estimate.rates.observe import observations
from sunspin.estimate.rates.smooth import cost_limit
from sunspin.estimate.rates.state import Motion, Track
from sunspin.estimate.terms.gyro import Gyro
from sunspin.estimate.terms.magnetometer import Magnetometer
from sunspin.estimate.terms.term import Seen, facing, normal
from sunspin.solve.rotations import rotate_attitude
from sunspin.vehicle.sensors import Sensors
from tests.support.simulate import CUBE, GYRO, MAGNETOMETER, cube_with_late_sensor


def craft():
    return replace(CUBE, sensors=Sensors(gyro=GYRO, magnetometer=MAGNETOMETER))


def only(o, kind):
    """The term of a kind."""
    (term,) = (term for term in o.terms if isinstance(term, kind))
    return term


def both(samples=9, seed=4):
    """A pass seen by panels, a gyro and a magnetometer, and its truth."""
    (data, run), (other, _) = (
        cube_with_late_sensor(kind, 0.0, np.random.default_rng(seed), samples)
        for kind in ("gyro", "field")
    )
    o = observations(craft(), data.assign(field_B=other["field_B"]))[0]
    attitude = Rotation.from_quat(run["B_from_N"].values).as_matrix()
    sun_N = attitude[0].T @ run["sun_B"].values[0]
    return o, Track(
        (attitude @ facing(sun_N))[None], run["omega_B"].values[None]
    )  # z of N to the Sun


@pytest.mark.evidence("rates", "verified", "finite differences of the cost of a gyro's readings")
def test_the_gradient_by_gyro_parameters_is_that_of_the_cost():
    o, truth = both()
    gyro, rng = only(o, Gyro), np.random.default_rng(1)
    seen, error = (
        Seen(truth.attitude, truth.omega + 1e-3 * rng.normal(size=truth.omega.shape)),
        rng.normal(size=(1, 4)),
    )
    slope = normal(gyro, seen, error)[1]

    def cost(omega, off):
        return normal(gyro, Seen(seen.attitude, omega), off)[2].sum()

    for k in range(3):
        step = 1e-8 * np.eye(3)[k]
        told = (cost(seen.omega + step, error) - cost(seen.omega - step, error)) / 2e-8
        assert slope[..., 3 + k].sum() == pytest.approx(told, rel=1e-5)
    for k in range(4):
        step = 1e-6 * np.eye(4)[k]
        told = (cost(seen.omega, error + step) - cost(seen.omega, error - step)) / 2e-6
        assert slope[..., 6 + k].sum() == pytest.approx(told, rel=1e-5)


@pytest.mark.evidence(
    "rates", "modelled", "a simulated magnetometer whose zero is off by its stated sigma"
)
def test_an_uncertain_magnetometer_zero_is_estimated():
    """Taken for exact, a zero off by a third of the field bends the motion by many sigmas; with its sigma stated it does not."""
    o, truth = both()
    o = replace(o, terms=tuple(term for term in o.terms if not isinstance(term, Gyro)))
    exact = only(o, Magnetometer)
    off = np.array([0.3, -0.25, 0.2])
    wrong = replace(exact, field_B=exact.field_B + off)
    pulls, motion = [], Motion(Body.of(craft()), 1e-5, 0.1)
    for zero_B in (np.zeros((0, 3)), 0.3 * np.eye(3)):
        pass_ = replace(
            o,
            terms=tuple(
                replace(wrong, zero_B=zero_B) if term is exact else term for term in o.terms
            ),
        )
        fit = with_common(pass_.freed(), truth, motion, None)
        sigma = np.sqrt(np.diagonal(fit.track.covariance[0, :, 3:, 3:], axis1=1, axis2=2))
        pulls.append(np.sqrt((((fit.track.omega[0] - truth.omega[0]) / sigma) ** 2).mean()))
    assert pulls[1] < 1.6 < 3 < pulls[0], pulls
    zero = [one.kind == "field_zero" for one in places_of(pass_.freed(), motion, None).unknowns]
    sigma = 0.3 * np.sqrt(np.diagonal(fit.covariance[0])[zero])
    found = 0.3 * fit.error[0, zero]
    assert np.all(np.abs(found - off) < 3 * sigma) and np.sum(sigma < 0.15) > 1, (found, sigma)


@pytest.mark.evidence(
    "rates",
    "modelled",
    "a simulated magnetometer with soft iron and an uncalibrated zero",
)
def test_an_uncertain_magnetometer_matrix_is_estimated():
    """Of a fast spinner soft iron turns the axis by degrees: in every draw by more sigmas where the matrix is taken for exact."""
    rng, motion, o, truth = np.random.default_rng(3), Motion(Body.of(craft()), 1e-5, 0.1), *both()
    o = replace(o, terms=tuple(term for term in o.terms if not isinstance(term, Gyro)))
    exact, pulls = only(o, Magnetometer), {0.0: [], 0.05: []}
    for _ in range(8):
        bent = replace(
            exact, field_B=exact.field_B @ (np.eye(3) + 0.05 * rng.normal(size=(3, 3))).T
        )
        for sigma, of_these in pulls.items():
            pass_ = replace(
                o,
                terms=tuple(
                    replace(bent, matrix_sigma=sigma) if term is exact else term for term in o.terms
                ),
            )
            fit = with_common(pass_.freed(), truth, motion, None)
            off = fit.track.omega[0] - truth.omega[0]
            covariance = fit.track.covariance[0, :, 3:, 3:]
            of_these.append(
                np.sqrt(np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariance), off).mean() / 3)
            )
    assert (
        np.median(pulls[0.05]) < 1.3
        and max(pulls[0.05]) < 2
        and all(np.array(pulls[0.0]) > pulls[0.05])
    ), pulls


def test_the_derivative_by_the_matrix_is_the_change_of_the_residuals():
    o, truth = both(samples=4)
    term = replace(only(o, Magnetometer), matrix_sigma=0.03, turn_rate=0.0)
    relative = truth.attitude[:, 1:] @ np.swapaxes(truth.attitude[:, :-1], -1, -2)
    columns = term.gained(o.t_s, Seen(truth.attitude, truth.omega))
    for k, element in enumerate(np.eye(9).reshape(9, 3, 3)):
        less = replace(term, field_B=term.field_B - 0.03 * term.field_B @ element.T)
        change = less.between(o.t_s, relative)[0] - term.between(o.t_s, relative)[0]
        np.testing.assert_allclose(columns[..., k - 9], change, atol=1e-9)


def test_a_sensor_that_disagrees_is_left_out_by_evidence():
    """A gyro turned by 60 degrees: of all alternatives the one without it fits and is best; with a sound gyro all are worse."""
    o, truth = both(samples=20)
    motion = Motion(Body.of(craft()), 1e-5, 0.1)
    gyro = only(o, Gyro)
    turned = replace(
        gyro, rate_B=gyro.rate_B @ rotate_attitude(np.eye(3), np.radians([60.0, 0.0, 0.0])).T
    )

    def run(one):
        fit = with_common(one.o.freed(), truth, one.motion, None)
        return Fit(fit.track.log_weight, bool(fit.track.cost[0] < cost_limit(one.o)))

    for pass_, named in ((o.swapped(gyro, turned), "without the gyro"), (o, None)):
        stated = Hypothesis(AS_STATED, pass_, np.arange(len(o)), motion)
        others = sensors_left_out(stated)
        assert [one.what for one in others] == [
            "without the Sun",
            "without the gyro",
            "without the magnetometer",
        ]
        judged = ranked([stated, *others], run)
        odd = odd_one(judged)
        assert (None if odd is None else odd.hypothesis.what) == named
        assert judged[0].hypothesis.what == (named or AS_STATED)


@pytest.mark.long
def test_panels_that_contradict_gyro_and_magnetometer_are_left_out(monkeypatch):
    """Panels of another time: without the Sun the others fit, the attitude's free turns held weakly. No wiring is tried."""
    monkeypatch.setattr(estimate, "better", lambda *given: None)
    (data, _), (other, _) = (
        cube_with_late_sensor(kind, 0.0, np.random.default_rng(4), 20) for kind in ("gyro", "field")
    )
    power = data["power_W"].values[np.random.default_rng(0).permutation(20)]
    data = data.assign(field_B=other["field_B"], power_W=(data["power_W"].dims, power))
    found = ss.rates(craft(), data, max_rate_rad_s=0.1, acceleration_noise=1e-5, column_tests=True)
    assert (
        not found["fits"].values.any()
        and "without the Sun the other readings fit" in found.attrs["verdict"]
    )
