"""Elements compared with telemetry without attitude: right ones fit, those of another plane are refused."""

from __future__ import annotations

import numpy as np
import pytest

import sunspin as ss
from sunspin.environment.elements import parse_elements
from sunspin.environment.orbit import in_orbit
from sunspin.estimate.orbit import check as orbit_check
from sunspin.estimate.orbit.check import Verdict, check_orbit
from sunspin.estimate.orbit.invariants import fit, predict, seen_in
from sunspin.estimate.orbit.judged import judged_orbit, orbit_of
from sunspin.telemetry.assess import assess
from sunspin.vehicle.parts import Orbit
from tests.support.orbit_cases import check_case
from tests.support.orbits import with_node_turned


@pytest.fixture(scope="module")
def case():
    return check_case(1, 1)


@pytest.fixture
def few_copies(monkeypatch):
    """A fifth of the usual copies: enough where elements are clearly wrong."""
    monkeypatch.setattr(orbit_check, "COPIES", 10)


@pytest.fixture
def one_clock(monkeypatch):
    """Of clocks off by whole hours, which are tried where elements do not fit, one."""
    monkeypatch.setattr(orbit_check, "HOURS", (1,))


@pytest.fixture(scope="module")
def judged(case):
    """The right elements as they are used, and what is said of them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(orbit_check, "COPIES", 20)
        return judged_orbit(orbit(case), *case[:2])


@pytest.fixture(scope="module")
def fits(judged):
    return judged[1]


def orbit(case, by_deg=0.0, **options):
    _, data, given, about = case
    elements = parse_elements("\n".join((given[0], with_node_turned(given[1], by_deg))), "twin")
    options = {"shift_sigma_s": about["sigma_s"]} | options
    return in_orbit(elements, data.attrs["epoch_utc"], data["time"].values, **options)


def test_right_elements_fit_and_their_along_track_offset_is_estimated(case, judged):
    used, found, _ = judged
    about = case[3]
    assert (
        used.shift_s == found.shift_s
        and np.hypot(used.shift_sigma_s, used.clock_sigma_s) < 1.01 * found.shift_sigma_s
    )
    assert (
        found.verdict is Verdict.FITS
        and found.better <= 1
        and found.turn_times < 1.3
        and found.mistaken < 0.01
    )
    assert abs(found.shift_s - about["ahead_s"]) < 4 * found.shift_sigma_s < 0.7 * about["sigma_s"]
    assert (
        found.samples["field"] == about["samples"]
        and found.strength_residual_T < 6e-7
        and found.angle_residual_rad < 0.04
    )
    assert found.eclipse[1] > 5 and found.eclipse[0] <= 1
    scale = np.linalg.norm(found.matrix, axis=1)
    np.testing.assert_allclose(scale, 1e-9, rtol=0.1)  # readings are in nT


def test_elements_of_another_plane_are_refused(case, few_copies, one_clock):
    vehicle, data, _, _ = case
    used, found, words = judged_orbit(orbit(case, by_deg=70.0), vehicle, data)
    assert found.verdict is Verdict.REFUSED and found.turn_times > 1.3
    assert used is None and words.startswith(
        "the orbit is NOT USED: elements not consistent with the telemetry"
    )


def test_a_magnetometer_of_the_wrong_sign_is_detected_by_the_sun(case, fits, few_copies):
    vehicle, data, _, _ = case
    found = check_orbit(orbit(case), vehicle, data.assign(field_B=-data["field_B"]))
    assert found.sign_turned and not fits.sign_turned


def test_a_magnetometer_of_the_wrong_sign_is_detected_even_if_calibration_reverses_it():
    nine = check_case(1, 9)
    given, mirrored = orbit(nine), []
    for sign in (1, -1):
        seen, grid = (
            seen_in(assess(nine[0], nine[1].assign(field_B=sign * nine[1]["field_B"]))),
            orbit_check._Grid.of(given),
        )
        there = predict(given, seen, grid.shifts)
        found = fit(seen, there, grid.prior)
        k = int(found.cost.argmin())
        mirrored.append(orbit_check._mirrored(seen, there.take([k]), found.calibration[k]))
    assert mirrored == [False, True]


def test_few_data_leave_the_orbit_check_inconclusive_and_the_offset_at_its_prior(case, one_clock):
    vehicle, data, _, about = case
    few = data.isel(time=slice(0, 12))
    given = orbit(case)
    used, found, words = judged_orbit(given, vehicle, few)
    assert (
        found.verdict is Verdict.UNDECIDED
        and used is given
        and "the telemetry cannot judge it" in words
    )
    dark = check_orbit(
        orbit(case, shift_sigma_s=30.0), vehicle, data.drop_vars("field_B").isel(time=slice(0, 25))
    )
    assert (
        dark.verdict is Verdict.UNDECIDED
        and dark.matrix is None
        and np.isnan(dark.strength_residual_T)
    )
    assert 10 < dark.shift_sigma_s < 45
    nothing = check_orbit(
        orbit(case, shift_s=4.0, shift_sigma_s=30.0),
        vehicle,
        data.drop_vars(["field_B", "power_W", "panel"]),
    )
    assert nothing.verdict is Verdict.UNDECIDED and nothing.shift_s == 4.0 and nothing.samples == {}


def test_elements_of_the_command_line_override_those_of_the_vehicle_file(case, tmp_path):
    vehicle, data, given, _ = case
    assert orbit_of(vehicle, data) is None
    with pytest.raises(
        ss.InputError, match="an along-track offset needs elements; give --tle FILE"
    ):
        orbit_of(vehicle, data, shift_sigma_s=3.0)
    stated = ss.Vehicle("cube", panels=vehicle.panels, orbit=Orbit(given, -3.0, 7.0, 2.0))
    found = orbit_of(stated, data)
    assert (found.shift_s, found.shift_sigma_s, found.clock_s, found.clock_sigma_s) == (
        -3.0,
        7.0,
        2.0,
        1.0,
    )
    path = tmp_path / "two.tle"
    path.write_text("\n".join((given[0], with_node_turned(given[1], 5.0))), "utf-8")
    other = orbit_of(stated, data, path, 9.0)
    assert (
        other.shift_sigma_s == 9.0
        and other.elements[0].given[1]
        == with_node_turned(given[1], 5.0)
        != found.elements[0].given[1]
    )
    bad = ss.Vehicle("cube", panels=vehicle.panels, orbit=Orbit((given[1], given[0])))
    with pytest.raises(
        ss.InputError,
        match=r"\[orbit\] of cube, line 1: line 2 of the elements comes before line 1",
    ):
        orbit_of(bad, data)


@pytest.mark.real_data
@pytest.mark.long
def test_skcube_is_located_behind_its_sister_satellite_on_the_orbit(data_dir):
    """The elements of VZLUSAT-1, two months later: three crude checks by hand gave -140, -200 and -240 s."""
    text = """1 42790U 17036AB  17236.90928386  .00002510  00000-0  11640-3 0  9996
2 42790  97.4437 295.9456 0012835  41.8426 318.3788 15.20921507  9461"""
    vehicle = ss.load_vehicle("skcube")
    data = ss.read_telemetry(data_dir / "skcube" / "skcube_adcs.csv", vehicle)
    elements = parse_elements(text, "VZLUSAT-1")
    orbit = in_orbit(elements, data.attrs["epoch_utc"], data["time"].values, shift_sigma_s=150.0)
    found = check_orbit(orbit, vehicle, data)
    assert found.verdict is Verdict.FITS and found.better == 0
    assert -240 < found.shift_s < -140 and found.shift_sigma_s < 40
    assert np.degrees(found.angle_residual_rad) < 6 and found.strength_residual_T < 2.5e-6
