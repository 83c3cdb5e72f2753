"""Spinners with coarse Sun sensors under albedo and a magnetometer with a large zero, simulated without the package."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import sunspin as ss
from sunspin.estimate.orbit import check as orbit_check
from sunspin.estimate.orbit.calibration import along_orbit
from sunspin.estimate.orbit.check import Verdict, check_orbit
from sunspin.estimate.orbit.invariants import FEWEST
from sunspin.estimate.orbit.judged import judged_orbit, orbit_of
from sunspin.estimate.orbit.readings import EARTH_RAD, read
from sunspin.estimate.settings import ORBIT
from sunspin.telemetry.assess import assess
from validation.spinners import AS_MOUNTED, Case, make

ROTATED = ((0, -1, 0), (1, 0, 0), (0, 0, 1))
THREE, LARGE_ZERO = ("-X", "-Y", "-Z"), (3.0, -3.0, 2.0)
FEW = replace(ORBIT, copies=10, hours=(1,))
"""A fifth of the usual copies, and one other clock."""


@cache
def spinner(folder, turned=AS_MOUNTED, number=4):
    """A whole orbit, one sample in 10 s, of a body that rotates at 2 deg/s: vehicle, telemetry, right and wrong orbit, truth."""
    case = Case(
        5, number, -2.0, 1, 1.0, THREE, turned, LARGE_ZERO, False, 1.3, True, 0.25, 10.0, 560
    )
    where = folder / f"{turned}-{number}"
    truth = make(case, where)
    vehicle = ss.load_vehicle(where / "vehicle.toml")
    telemetry = ss.read_telemetry(where / "telemetry.csv", vehicle)
    orbits = [orbit_of(vehicle, telemetry, where / f"{name}.tle") for name in ("right", "wrong")]
    return assess(vehicle, telemetry), *orbits, truth


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("spinner")


def error_deg(orbit, assessment, truth):
    """Median angle between the calibrated and the true field."""
    reading = assessment.telemetry["field_B"].values
    column = reading + assessment.vehicle.sensors.magnetometer.zero
    true = np.linalg.solve(np.array(truth["matrix"]), (column - np.array(truth["zero_nT"])).T).T
    ours = along_orbit(orbit, assessment).field(reading)
    cosine = (true * ours).sum(axis=1)
    cosine /= np.linalg.norm(true, axis=1) * np.linalg.norm(ours, axis=1)
    return np.degrees(np.median(np.arccos(np.clip(cosine, -1, 1))))


@pytest.mark.parametrize("number", [2, 4])
def test_albedo_does_not_rotate_the_calibration(folder, number):
    """By 60 deg where panels that the Earth lights count as sunlit."""
    assessment, right, _, truth = spinner(folder, number=number)
    assert error_deg(right, assessment, truth) < 5.0


def test_samples_that_show_field_and_sun_come_first(folder):
    assessment, *_ = spinner(folder, number=3)
    both = read(assessment, 10_000).has_angle.sum()
    readings = read(assessment, ORBIT.samples)
    assert len(readings.t_s) == ORBIT.samples and FEWEST < both < ORBIT.samples / 2
    assert readings.has_angle.sum() == both
    # of three panels none has an opposite one, and the Earth may light all alike
    alone = np.isfinite(readings.panel_sun).all(axis=1)
    assert readings.panel_sigma[alone].min() > EARTH_RAD > readings.panel_sigma[~alone].min()
    assert (readings.light == 0).sum() > 30 and (np.diff(readings.t_s) > 0).all()


def test_right_elements_rank_first_despite_a_large_zero(folder):
    assessment, right, wrong, _ = spinner(folder, number=1)
    check = check_orbit(right, assessment.vehicle, assessment, settings=FEW)
    assert check.verdict is Verdict.FITS and check.better == 0 and check.mistaken < 0.01
    check = check_orbit(wrong, assessment.vehicle, assessment, settings=FEW)
    assert check.verdict is Verdict.REFUSED


def test_rotated_axes_are_named_and_calibrated(folder):
    assessment, right, _, truth = spinner(folder, turned=ROTATED, number=3)
    used, check, words = judged_orbit(right, assessment.vehicle, assessment, settings=FEW)
    assert used is not None and check.angle_residual_rad < 0.1
    assert 'set columns = ["my", "-mx", "mz"]' in words
    assert error_deg(right, assessment, truth) < 5.0
    mounted, right, *_ = spinner(folder, number=3)
    assert not check_orbit(right, mounted.vehicle, mounted, settings=FEW).turned_axes


def test_elements_that_the_angle_to_the_sun_contradicts_do_not_fit(folder, monkeypatch):
    assessment, right, *_ = spinner(folder, number=3)
    readings = read(assessment, ORBIT.samples)
    rng, seen = np.random.default_rng(0), np.flatnonzero(readings.has_angle)
    for count, verdict in ((len(seen), Verdict.UNDECIDED), (FEWEST - 1, Verdict.FITS)):
        sun, side = np.full_like(readings.sun, np.nan), rng.normal(size=(count, 3))
        sun[seen[:count]] = side / np.linalg.norm(side, axis=1, keepdims=True)
        scrambled = readings._replace(sun=sun)
        monkeypatch.setattr(orbit_check, "read", lambda *_, scrambled=scrambled: scrambled)
        check = check_orbit(right, assessment.vehicle, assessment, settings=FEW)
        assert check.verdict is verdict
