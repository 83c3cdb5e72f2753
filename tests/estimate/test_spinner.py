"""Spinners with coarse Sun sensors under albedo and a magnetometer with a large zero, simulated without the package."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import sunspin as ss
from sunspin.estimate.orbit import check as orbit_check
from sunspin.estimate.orbit.check import Verdict, check_orbit
from sunspin.estimate.orbit.field_calibration import field_calibration
from sunspin.estimate.orbit.invariants import FEWEST, MOST_SAMPLES, seen_in
from sunspin.estimate.orbit.judged import judged_orbit, orbit_of
from sunspin.estimate.rates.common_errors import with_common
from sunspin.estimate.rates.dense import Dense
from sunspin.estimate.rates.finish import leading
from sunspin.estimate.rates.motion import Body
from sunspin.estimate.rates.observe import observations, passes, thinned, usable
from sunspin.estimate.rates.residuals import Fitted, panels_as_read, residuals
from sunspin.estimate.rates.state import Motion
from sunspin.estimate.terms.magnetometer import Magnetometer
from sunspin.estimate.terms.panels import Panels
from sunspin.estimate.terms.sensors import read_terms
from sunspin.solve.rotations import rotate_attitude
from sunspin.telemetry.assess import assess
from validation.spinners import AS_MOUNTED, Case, make

ROTATED = ((0, -1, 0), (1, 0, 0), (0, 0, 1))
THREE, LARGE_ZERO = ("-X", "-Y", "-Z"), (3.0, -3.0, 2.0)
FOUR = ("-X", "+Y", "-Z", "+X")


@cache
def spinner(folder, faces=THREE, turned=AS_MOUNTED, number=4, axis=1):
    """A whole orbit, one sample in 10 s, of a body that turns at 2 deg/s: vehicle, telemetry, right and wrong orbit, truth."""
    case = Case(
        5, number, -2.0, axis, 1.0, faces, turned, LARGE_ZERO, False, 1.3, True, 0.25, 10.0, 560
    )
    where = folder / f"{faces}-{turned}-{number}-{axis}"
    truth = make(case, where)
    vehicle = ss.load_vehicle(where / "vehicle.toml")
    telemetry = ss.read_telemetry(where / "telemetry.csv", vehicle)
    orbits = [orbit_of(vehicle, telemetry, where / f"{name}.tle") for name in ("right", "wrong")]
    return vehicle, telemetry, *orbits, truth


@pytest.fixture(autouse=True)
def few_copies(monkeypatch):
    """A fifth of the usual copies, and one clock off by an hour."""
    monkeypatch.setattr(orbit_check, "COPIES", 10)
    monkeypatch.setattr(orbit_check, "HOURS", (1,))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("spinner")


def error_deg(made, truth, telemetry, vehicle):
    """Median angle between the calibrated and the true field."""
    reading = telemetry["field_B"].values
    column = reading + vehicle.sensors.magnetometer.zero
    true = np.linalg.solve(np.array(truth["matrix"]), (column - np.array(truth["zero_nT"])).T).T
    found = made.field(reading)
    cosine = (
        (true * found).sum(axis=1) / np.linalg.norm(true, axis=1) / np.linalg.norm(found, axis=1)
    )
    return np.degrees(np.median(np.arccos(np.clip(cosine, -1, 1))))


@pytest.mark.parametrize("number", [2, 4])
def test_albedo_does_not_rotate_the_magnetometer_calibration(folder, number):
    vehicle, telemetry, right, _, truth = spinner(folder, number=number)
    made = field_calibration(right, vehicle, telemetry)
    assert (
        error_deg(made, truth, telemetry, vehicle) < 5.0
    )  # 60 deg where panels that the Earth lights count as sunlit


def test_samples_that_show_field_and_sun_are_kept_first(folder):
    vehicle, telemetry, *_ = spinner(folder, number=3)
    both = np.isfinite(seen_in(assess(vehicle, telemetry), 10_000).sun).all(axis=1).sum()
    seen = seen_in(assess(vehicle, telemetry))
    assert len(seen.t_s) == MOST_SAMPLES and FEWEST < both < MOST_SAMPLES / 2
    assert np.isfinite(seen.field + seen.sun).all(axis=1).sum() == both
    assert (seen.light == 0).sum() > 30 and (np.diff(seen.t_s) > 0).all()


def test_right_elements_fit_best_despite_a_large_magnetometer_zero(folder):
    vehicle, telemetry, right, wrong, _ = spinner(folder, number=1)
    found = check_orbit(right, vehicle, telemetry)
    assert found.verdict is Verdict.FITS and found.better == 0 and found.mistaken < 0.01
    assert check_orbit(wrong, vehicle, telemetry).verdict is Verdict.REFUSED


def test_rotated_magnetometer_axes_are_named_and_calibrated(folder):
    vehicle, telemetry, right, _, truth = spinner(folder, turned=ROTATED, number=3)
    used, found, words = judged_orbit(right, vehicle, telemetry)
    assert used is not None and found.angle_residual_rad < 0.1
    assert 'set columns = ["my", "-mx", "mz"]' in words
    assert error_deg(field_calibration(right, vehicle, telemetry), truth, telemetry, vehicle) < 5.0
    mounted = spinner(folder, number=3)
    assert not check_orbit(mounted[2], *mounted[:2]).turned_axes


def test_elements_that_the_sun_field_angle_contradicts_do_not_fit(folder, monkeypatch):
    vehicle, telemetry, right, *_ = spinner(folder, number=3)
    seen = seen_in(assess(vehicle, telemetry))
    rng, shown = np.random.default_rng(0), np.flatnonzero(np.isfinite(seen.sun).all(axis=1))
    for count, verdict in ((len(shown), Verdict.UNDECIDED), (FEWEST - 1, Verdict.FITS)):
        sun = np.full_like(seen.sun, np.nan)
        sun[shown[:count]] = (side := rng.normal(size=(count, 3))) / np.linalg.norm(
            side, axis=1, keepdims=True
        )
        scrambled = seen._replace(sun=sun)
        monkeypatch.setattr(orbit_check, "seen_in", lambda *_, scrambled=scrambled: scrambled)
        assert check_orbit(right, vehicle, telemetry).verdict is verdict


def test_readings_of_a_spinner_determine_the_zero_across_its_axis(folder):
    vehicle, telemetry, *_, truth = spinner(folder, number=1)
    terms, _ = read_terms(assess(vehicle, telemetry), "panels")
    read = next(term for term in terms if type(term) is Magnetometer)
    off = (telemetry["field_B"].values - read.field_B)[0] - np.array(truth["zero_nT"])
    sigma = np.sqrt((read.zero_B**2).sum(axis=0))
    assert (np.abs(off) < 3 * sigma).all()
    assert (sigma[[0, 2]] < 3000).all() and vehicle.sensors.magnetometer.zero_sigma.min() > 1e5
    assert (
        read.forgiving().sigma < 4000
    )  # the zero along the axis is open, and moves no neighbours apart


@pytest.fixture(scope="module")
def searched(folder):
    """Of a pass of 15 minutes at 6 deg/s: vehicle, telemetry, all samples, those kept, the best modes and how it moves."""
    zero, where = (0.2, -0.3, 0.25), folder / "searched"
    case = Case(5, 2, -6.0, 1, 1.0, FOUR, AS_MOUNTED, zero, True, 1.3, True, 0.1, 2.0, 450)
    make(case, where)
    vehicle = ss.load_vehicle(where / "vehicle.toml")
    telemetry = ss.read_telemetry(where / "telemetry.csv", vehicle)
    o, why, _ = observations(vehicle, telemetry)
    (kept,) = passes(o, why)
    motion = Motion(Body.of(vehicle), 2e-5, 0.1)
    return vehicle, telemetry, usable(o, why), kept, leading(o.take(kept), motion, 0.2), motion


def scale(searched, telemetry):
    """By what the sigmas of panels are smaller than presumed."""
    vehicle, _, whole, kept, track, motion = searched
    o = observations(vehicle, telemetry)[0]
    before, after = (
        next(term for term in each.terms if isinstance(term, Panels))
        for each in (o, panels_as_read(o, [(whole, kept, track)], motion))
    )
    read = np.isfinite(before.sigma)
    return np.unique((after.sigma[read] / before.sigma[read]).round(9))


def test_the_panel_noise_is_estimated_from_the_scatter_of_readings(searched):
    telemetry = searched[1]
    (as_read,) = scale(searched, telemetry)
    assert 0.2 <= as_read < 0.8  # 1 % of noise, where 2 to 3 % are presumed
    noisy = telemetry.copy()
    rng = np.random.default_rng(3)
    noisy["current_A"] = noisy["current_A"] + 0.02 * 0.1 * rng.normal(size=noisy["current_A"].shape)
    assert (scale(searched, noisy) == 1.0).all()


def test_revolutions_between_kept_samples_contradict_the_magnetometer_in_between(searched):
    vehicle, telemetry, index, kept, track, motion = searched
    o = observations(vehicle, telemetry)[0]
    part, place, best = o.take(kept).freed(), np.searchsorted(index, kept), track.take(slice(1))
    fit = with_common(part, best, motion, None)
    every = o.take(index).freed()
    dense = Dense.of(o.take(index), np.arange(len(index)), place, fit.track, motion)
    seen = dense.filled(fit.track)
    time = np.interp(every.t_s, every.t_s[place], np.arange(len(place)))
    angle = 2 * np.pi * (time - np.floor(time))[:, None] * [0, 1, 0]  # about the axis of the spin
    more = replace(seen, attitude=rotate_attitude(seen.attitude, angle[None]))
    right, turned_once_more = (
        residuals(every, place, each, Fitted(part, fit.track, fit.error, motion, None))
        for each in (seen, more)
    )
    assert np.nanmean(np.abs(right["magnetometer"]) > 3) < 0.05
    assert np.nanmean(np.abs(turned_once_more["magnetometer"]) > 3) > 0.5
    assert np.isfinite(right["magnetometer"]).sum() > 10 * len(kept)


def test_samples_kept_of_a_pass_from_shadow_are_dense_in_sunlight():
    kept = thinned(np.arange(2800), 2300)
    assert len(kept) <= 40 and kept[0] == 0 and kept[-1] == 2799
    steps = np.diff(kept)
    assert steps.max() < 350 and (steps[np.abs(kept[:-1] - 2300) < 2] == 1).all()
    assert (
        np.maximum(steps[1:], steps[:-1]) <= np.ceil(1.4 * np.minimum(steps[1:], steps[:-1]) + 1)
    ).all()
