"""Rates in a known orbit: field, shadow, torque and calibration, and whole passes. All telemetry is synthetic."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.environment.orbit import SunAlongZ
from sunspin.estimate.orbit.field_calibration import FieldCalibration, field_calibration
from sunspin.estimate.rates.observe import FIELD_ALONE, observations, usable
from sunspin.estimate.rates.search import field_leads
from sunspin.estimate.terms.known_field import KnownField
from sunspin.estimate.terms.magnetic_torque import MagneticTorque
from sunspin.estimate.terms.magnetometer import Magnetometer
from sunspin.estimate.terms.panels import Panels
from sunspin.estimate.terms.term import SUN_N, Seen, normal
from sunspin.output.export import build_attitude
from sunspin.solve.rotations import rotate_attitude
from tests.support.orbit_cases import orbit_of, pass_against_truth, rates_case

CASE_NUMBER = 3
TIMES = np.arange(12) * 30.0


@pytest.fixture(scope="module")
def case():
    return rates_case(1, CASE_NUMBER, patches=1000)


def seen(rng: np.random.Generator) -> Seen:
    return Seen(
        Rotation.from_rotvec(2 * rng.normal(size=(12, 3))).as_matrix()[None],
        rng.normal(size=(1, 12, 3)),
    )


def known_field(rng: np.random.Generator, track: Seen) -> KnownField:
    """Readings of a field that turns, without noise."""
    field_N = 3e-5 * np.column_stack([np.cos(TIMES / 500), np.sin(TIMES / 500), 0.4 + TIMES / 900])
    read = (track.attitude[0] @ field_N[..., None])[..., 0]
    own, along = 1e-6 * rng.normal(size=(2, 12, 13, 3))
    return KnownField(1e9 * read, read, np.full(12, 5e-7), field_N, own, along)


def test_the_gradient_by_a_known_field_is_that_of_the_cost():
    rng = np.random.default_rng(4)
    track = seen(rng)
    term, error = known_field(rng, track), 0.5 * rng.normal(size=(1, 13))
    slope = normal(term, track, error)[1].sum(axis=1)[0]
    small = [sign * 1e-6 * one for one in np.eye(19) for sign in (1, -1)]
    changed = [
        (replace(track, attitude=rotate_attitude(track.attitude, one[:3])), error + one[6:])
        for one in small
    ]
    cost = np.array([normal(term, at, off)[2].sum() for at, off in changed])
    np.testing.assert_allclose(slope, (cost[::2] - cost[1::2]) / 2e-6, rtol=1e-4, atol=1e-3)
    assert np.all(slope[3:6] == 0) and [one.kind for one in term.unknowns()] == 13 * [
        "magnetometer"
    ]


def test_the_rotation_about_the_sun_direction_is_found_from_the_field():
    rng = np.random.default_rng(5)
    track = seen(rng)
    about = Rotation.from_rotvec(2.1 * SUN_N).as_matrix()
    found = known_field(rng, track).begin(replace(track, attitude=track.attitude @ about))
    np.testing.assert_allclose(found, track.attitude, atol=1e-9)


@pytest.mark.parametrize("size", [0.0, 1e-7, 0.01, 0.5, 3.0])
@pytest.mark.parametrize("known", [False, True])
def test_a_magnetic_torque_is_averaged_over_revolutions_between_samples(size, known):
    """Against the sum over 4000 instants of each interval, up to 20 turns of it."""
    rng = np.random.default_rng(11)
    track = seen(rng)
    track = replace(track, omega=np.repeat(size * track.omega[:, :1], 12, axis=1))
    term = MagneticTorque.beside(1e-4, np.tile([0.3, -0.4, 1.2], (12, 1)) if known else None)
    dt = np.diff(TIMES)
    pushed = term.pushes(track, dt)[0, 3]
    share = (np.arange(4000) + 0.5) / 4000
    attitude = rotate_attitude(track.attitude[0, 3], share[:, None] * track.omega[0, 3] * dt[3])
    if known:
        unit = [0.3, -0.4, 1.2] / np.linalg.norm([0.3, -0.4, 1.2])
        each = np.cross(np.eye(3), (attitude @ unit)[:, None]) / np.sqrt(2)
    else:
        columns = np.swapaxes(attitude, 1, 2)
        each = np.cross(np.eye(3)[:, None], columns[:, None]).reshape(-1, 9, 3) / np.sqrt(6)
    acceleration = term.sigma * np.swapaxes(each, 1, 2)
    left = (1 - share)[:, None, None]
    np.testing.assert_allclose(pushed[3:], dt[3] * acceleration.mean(axis=0), atol=1e-8)
    np.testing.assert_allclose(
        pushed[:3], dt[3] ** 2 * (left * acceleration).mean(axis=0), atol=1e-7
    )


def test_a_magnetometer_is_calibrated_along_its_orbit(case):
    vehicle, data, given, truth, about = case
    orbit = replace(orbit_of(given, data, about), shift_s=about["ahead_s"])
    found = field_calibration(orbit, vehicle, data)
    assert isinstance(found, FieldCalibration) and 2e-7 < found.noise_T < 1.2e-6
    true = Rotation.from_quat(truth["B_from_N"].values).apply(orbit.at(data["time"].values).field_N)
    off, spread = (
        found.field(data["field_B"].values) - true,
        np.sqrt((found.columns(data["field_B"].values) ** 2).sum(axis=1)),
    )
    assert np.sqrt(np.mean((off / np.hypot(spread, found.noise_T)) ** 2)) < 1.5
    assert field_calibration(orbit, vehicle, data.drop_vars("field_B")) is None


def test_a_sample_in_shadow_uses_its_field_and_requires_dark_panels(case):
    vehicle, data, given, _, about = case
    orbit = replace(orbit_of(given, data, about), shift_s=about["ahead_s"])
    known, why, _ = observations(
        vehicle, data, None, SunAlongZ(orbit), field_calibration(orbit, vehicle, data)
    )
    plain, told, _ = observations(vehicle, data)
    panels = known.of_sun[0]
    assert isinstance(panels, Panels)
    dark = np.flatnonzero(panels.lit == 0)
    assert len(dark) and set(np.unique(why[dark])) == {FIELD_ALONE + "no panel lit"}
    assert len(usable(known, why)) == len(data["time"]) > len(usable(plain, told))
    assert np.isfinite(panels.sigma[dark]).all() and not known.informed[dark].any()
    assert field_leads(known.take(dark[:6])) and not field_leads(known)


def test_a_stated_zero_sigma_counts_once_if_the_orbit_calibrates(case):
    """The calibration has the zero's error, in tesla; that of the vehicle file is in the unit of the columns."""
    vehicle, data, given, _, about = case
    orbit = orbit_of(given, data, about)
    calibration = field_calibration(orbit, vehicle, data)
    part = replace(vehicle.sensors.magnetometer, zero_sigma=np.full(3, 4.0))
    stated = replace(vehicle, sensors=replace(vehicle.sensors, magnetometer=part))
    here = SunAlongZ(orbit).at(data["time"].values)
    read = [
        replace(Magnetometer.read(craft, data), calibration=calibration)
        for craft in (vehicle, stated)
    ]
    terms = [one.placed(here).forgiving() for one in read]
    assert terms[0].known is not None and terms[1].sigma == terms[0].sigma


@pytest.mark.long
def test_a_pass_in_its_orbit_has_its_attitude_in_J2000(case):
    vehicle, data, given, truth, about = case
    orbit = replace(orbit_of(given, data, about), shift_s=about["ahead_s"], shift_sigma_s=2.0)
    t = data["time"].values - about["begin_s"][0]
    calibration = field_calibration(orbit, vehicle, data)
    result = ss.rates(
        vehicle, data.isel(time=(t > -1) & (t < 700)), environment=orbit, calibration=calibration
    )
    found = pass_against_truth(result, truth, 0)
    assert (
        result.attrs["frame_N"] == "J2000"
        and found["attitude_deg"] < 6
        and max(np.abs(found["pulls"])) < 4
    )
    message = build_attitude(result)
    assert (
        message.number == str(orbit.elements[0].number)
        and message.centre == "EARTH"
        and message.name != "UNKNOWN"
    )
    for name, part in (("B_from_N", "pass_of"), ("curve_B_from_N", "curve_pass_of")):
        q, same = result[name].values, np.diff(result[part].values) == 0
        assert np.einsum("ni,ni->n", q[1:], q[:-1])[same].min() > 0
