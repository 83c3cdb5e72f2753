"""Elements, frames, Sun, field and light along an orbit, against published values and other libraries."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from datetime import datetime, timedelta
from importlib import resources

import numpy as np
import pytest

import sunspin as ss
from sunspin.environment.earth import (
    EQUATOR_M,
    Instants,
    J2000_from_TEME,
    earth_from_J2000,
    sun_J2000_m,
)
from sunspin.environment.elements import nearest, parse_elements
from sunspin.environment.ephemeris import read_orbit
from sunspin.environment.field import field_map
from sunspin.environment.light import REFLECTIVITY, albedo_light, covered_fraction, sunlit_fraction
from sunspin.environment.orbit import SunAlongZ, in_orbit
from tests.support.orbits import with_check_digit

VANGUARD = """1 00005U 58002B   00179.78495062  .00000023  00000-0  28098-4 0  4753
2 00005  34.2682 348.7242 1859667 331.7664  19.3264 10.82419157413667
"""
ONE, TWO = VANGUARD.splitlines()
VZLUSAT = """VZLUSAT-1
1 42790U 17036AB  17236.90928386  .00002510  00000-0  11640-3 0  9996
2 42790  97.4437 295.9456 0012835  41.8426 318.3788 15.20921507  9461
"""
EPOCH = "2017-08-24T00:00:00Z"

ISS = {"OBJECT_NAME": "ISS (ZARYA)", "OBJECT_ID": "1998-067A", "INCLINATION": 51.64}
ISS |= {"EPOCH": "2024-03-01T12:00:00.000000", "MEAN_MOTION": 15.49, "ECCENTRICITY": 0.0006}
ISS |= {"RA_OF_ASC_NODE": 120.0, "ARG_OF_PERICENTER": 30.0, "MEAN_ANOMALY": 40.0}
ISS |= {"EPHEMERIS_TYPE": 0, "CLASSIFICATION_TYPE": "U", "NORAD_CAT_ID": 25544}
ISS |= {"ELEMENT_SET_NO": 999, "REV_AT_EPOCH": 44000}
ISS |= {"BSTAR": 0.0001, "MEAN_MOTION_DDOT": 0, "MEAN_MOTION_DOT": 0.0001}


def test_sgp4_gives_the_published_verification_states():
    """The file of Vallado et al. (AIAA 2006-6753) that comes with sgp4: minutes, position (km), velocity (km/s) of its first
    case."""
    (elements,) = parse_elements(VANGUARD, "case")
    lines = resources.files("sgp4").joinpath("tcppver.out").read_text("utf-8").splitlines()
    end = next(k for k, line in enumerate(lines[1:], 1) if line.endswith("xx"))
    table = np.array([line.split()[:7] for line in lines[1:end]], dtype=float)
    assert len(table) > 10
    day, fraction = elements.epoch_jd
    place, speed = elements.states(np.full(len(table), day), fraction + table[:, 0] / 1440)
    # the date's last bit is 40 microseconds
    np.testing.assert_allclose(place / 1e3, table[:, 1:4], atol=2e-5)
    np.testing.assert_allclose(speed / 1e3, table[:, 4:7], atol=2e-8)


def test_TEME_is_rotated_to_J2000_as_published():
    """Vallado, Fundamentals of Astrodynamics and Applications, 4th ed., page 234: three days after the epoch of the case above.

    The book's nutation is that of 1980; the one used here differs by 0.05 arcseconds, 2 m at that distance."""
    (elements,) = parse_elements(VANGUARD, "case")
    day, fraction = np.array(elements.epoch_jd)[:, None]
    when = Instants(day + 3, fraction, 64.184 / 86400)
    place, speed = elements.states(when.jd, when.fraction)
    np.testing.assert_allclose(place[0], [-9060473.73569, 4658709.52502, 813686.73153], atol=0.01)
    turn = J2000_from_TEME(when)[0]
    np.testing.assert_allclose(turn @ place[0], [-9059941.3786, 4659697.2, 813958.8875], atol=2.5)
    turned = turn @ speed[0]
    np.testing.assert_allclose(turned, [-2233.348094, -4110.136162, -3157.394074], atol=2e-3)


def test_sun_and_earth_fixed_axes_agree_with_astropy():
    coordinates = pytest.importorskip("astropy.coordinates")
    time = pytest.importorskip("astropy.time")
    from astropy.utils import iers

    t = np.arange(0, 400) * 86400.0 + 1234.5
    when = Instants.of("2017-01-01T00:00:00Z", t)
    with iers.conf.set_temp("auto_download", False):
        moments = time.Time("2017-01-01T00:00:00", scale="utc") + time.TimeDelta(t, format="sec")
        theirs = coordinates.get_sun(moments).cartesian.xyz.to_value("m").T
        assert np.linalg.norm(sun_J2000_m(when) - theirs, axis=1).max() < 1e-8 * 1.5e11
        there, fixed = coordinates.ITRS(obstime=moments[:3]), np.empty((3, 3, 3))
        for k, axis in enumerate(np.eye(3)):
            place = 7e6 * axis[:, None] * np.ones(3)
            place = coordinates.CartesianRepresentation(*place, unit="m")
            here = coordinates.GCRS(place, obstime=moments[:3])
            fixed[:, :, k] = here.transform_to(there).cartesian.xyz.to_value("m").T / 7e6
    ours = earth_from_J2000(when.__class__(when.jd[:3], when.fraction[:3], when.tt_ahead))
    assert np.abs(ours - fixed).max() < 5e-5  # UT1 is 0.6 s off UTC then: 9 arcseconds


def test_the_sun_direction_agrees_with_the_almanac():
    """Meeus, Astronomical Algorithms, example 25.b: 1992 October 13, 0 h TD, apparent longitude 199.906016 degrees of date,
    distance 0.99760775 au. Precession from J2000 to that day is 0.10158 degrees along the ecliptic; aberration is in it."""
    when = Instants.of("1992-10-12T23:59:00.816Z", np.zeros(1))
    sun = sun_J2000_m(when)[0]
    tilt = np.radians(23.43929)
    longitude = np.degrees(np.arctan2(np.cos(tilt) * sun[1] + np.sin(tilt) * sun[2], sun[0])) % 360
    precession = 50.29 * (1992.7816 - 2000) / 3600
    assert longitude + precession + 15.908 / 3600 == pytest.approx(199.906016, abs=3e-4)
    assert np.linalg.norm(sun) / 1.495978707e11 == pytest.approx(0.99760775, abs=2e-6)


@pytest.mark.parametrize(
    "row",
    [
        (1954.3, 7498.84, 53.01, 334.96, 14037.24752, -4228.56120, 22947.00787),
        (2010.7, 6862.91, 48.37, 185.20, 19481.61206, 2505.23089, 29114.24165),
    ],
)
def test_the_geomagnetic_field_agrees_with_published_values(row):
    """Year, radius (km), colatitude, longitude (degrees); north, east, down (nT): output of IAGA's own program igrf13syn, as the
    tests of SatelliteToolbox.jl keep it (IGRF13_test_geocentric.txt). Up to 2015 IGRF-14 is the same."""
    year, radius, colatitude, longitude, *expected = row
    jd = 2451544.5 + (year - 2000) * 365.25
    theta, phi = np.radians([colatitude, longitude])
    up = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    east = np.array([-np.sin(phi), np.cos(phi), 0])
    found = 1e9 * field_map(jd, (1e3 * radius, 1e3 * radius)).at(1e3 * radius * up)
    # the map is that of the nearest of days a month apart
    found = [found @ np.cross(up, east), found @ east, -found @ up]
    np.testing.assert_allclose(found, expected, atol=6.0)


def test_the_interpolated_field_agrees_with_IGRF_to_two_nanotesla():
    import ppigrf

    rng = np.random.default_rng(3)
    z, phi = np.append(rng.uniform(-1, 1, 400), [0.99999, -0.99999]), rng.uniform(0, 360, 402)
    radius, theta = rng.uniform(6.7e6, 7.3e6, 402), np.degrees(np.arccos(z))
    jd = 30.0 * round(2457934.5 / 30)  # the day whose map is taken
    day = datetime(2000, 1, 1) + timedelta(days=jd - 2451544.5)
    up, south, east = (part[0] for part in ppigrf.igrf_gc(radius / 1e3, theta, phi, day))
    s, c, t = np.sin(np.radians(phi)), np.cos(np.radians(phi)), np.radians(theta)
    level = up * np.sin(t) + south * np.cos(t)
    north = up * np.cos(t) - south * np.sin(t)
    theirs = np.column_stack([level * c - east * s, level * s + east * c, north])
    place = radius[:, None] * np.column_stack([np.sin(t) * c, np.sin(t) * s, z])
    ours = field_map(jd, (6.7e6, 7.3e6)).at(place)
    assert np.abs(1e9 * ours - theirs).max() < 2.0
    words = r"the Earth's field is known from 1900 to 2030 \(IGRF-14\) .found a time in 2035."
    with pytest.raises(ss.InputError, match=words):
        field_map(2464329.5, (7e6, 7e6))


def test_the_lit_part_of_the_sun_is_that_of_overlapping_discs():
    apart = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 9.0])
    equal = covered_fraction(apart, np.ones(6), np.ones(6))
    lens = [(2 * np.arccos(d / 2) - d / 2 * np.sqrt(4 - d * d)) / np.pi for d in apart[1:5]]
    np.testing.assert_allclose(equal, [1.0, *lens, 0.0], atol=1e-12)
    # a straight border, and an annular eclipse
    apart, size, of_sun = np.array([[1.0, 0.1], [0.01, 0.5], [1.0, 0.2]])
    straight, annular = covered_fraction(apart, size, of_sun)
    assert straight == pytest.approx(0.5, abs=5e-3) and annular == pytest.approx(0.16)


def test_eclipse_lasts_as_long_as_the_shadow_is_wide():
    """A circular orbit at 400 km in the plane of the Sun: in shadow over 2 asin(R / r) of its angle, penumbrae of the Sun's
    disc."""
    r, angle = EQUATOR_M + 4e5, np.linspace(0, 2 * np.pi, 200_001)[:-1]
    place = r * np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    sun = np.tile([1.495978707e11, 0, 0], (len(angle), 1))
    part = sunlit_fraction(place, sun)
    assert (1 - part).mean() == pytest.approx(2 * np.arcsin(EQUATOR_M / r) / (2 * np.pi), rel=1e-3)
    penumbra = ((part > 0) & (part < 1)).mean() * 2 * np.pi / 2
    # the Sun's disc of 0.533 degrees crosses the horizon; the limb is seen at cos(angle) = R / r
    assert penumbra == pytest.approx(2 * 6.957e8 / 1.495978707e11, rel=0.02)
    assert part[0] == 1.0 and part[len(part) // 2] == 0.0 and part.min() >= 0 and part.max() <= 1


def test_the_shadow_has_the_oblateness_of_the_earth():
    """Two kilometres inside and outside the limb of WGS 84: the polar radius is 21.4 km shorter than that of the equator."""
    pole = 6_356_752.3
    across = [[0, pole - 2e3], [0, pole + 2e3], [EQUATOR_M - 2e3, 0], [EQUATOR_M + 2e3, 0]]
    behind = np.column_stack([np.full(4, -1e5), across])
    assert sunlit_fraction(behind, np.array([[1.495978707e11, 0, 0]])).tolist() == [0, 1, 0, 1]


def test_albedo_of_the_full_earth_agrees_with_the_closed_form():
    """Far away over the noon point the Earth is a Lambert sphere at full phase: 2/3 albedo (R / d)^2."""
    d = 1e10
    light = albedo_light(np.array([[d, 0, 0]]), np.array([[1.5e13, 0, 0]]))[0]
    full = -2 / 3 * REFLECTIVITY * (EQUATOR_M / d) ** 2
    np.testing.assert_allclose(light, [full, 0, 0], rtol=2e-2, atol=1e-12)
    places = EQUATOR_M * np.array([[1.0001, 0, 0], [-1.1, 0, 0]])
    near = albedo_light(places, np.array([[1.5e13, 0, 0]] * 2))
    # over the ground: a plane that fills half the sky
    assert -near[0, 0] == pytest.approx(REFLECTIVITY, rel=0.02)
    assert np.array_equal(near[1], [0, 0, 0])


def test_sun_field_and_nadir_follow_the_orbit_with_their_errors():
    elements = parse_elements(VZLUSAT, "case")
    t = np.arange(0, 5700, 20.0)
    orbit = in_orbit(elements, EPOCH, t, shift_sigma_s=10)
    here = orbit.at(t)
    assert orbit.frame_N == "J2000" and elements[0].name == "VZLUSAT-1" and orbit.notes(t) == []
    assert 0.6 < here.lit.mean() < 0.7  # 500 km high
    turned = np.diff(here.nadir_N, axis=0) / 20
    middle = (here.nadir_turn_N[1:] + here.nadir_turn_N[:-1]) / 2
    nadir = (here.nadir_N[1:] + here.nadir_N[:-1]) / 2
    np.testing.assert_allclose(np.cross(middle, nadir), turned, atol=2e-6)
    sigma_deg = np.degrees(here.nadir_sigma_rad).mean()
    assert sigma_deg == pytest.approx(np.hypot(10, 1) * 360 / 5680, rel=0.02)
    strength = np.linalg.norm(here.field_N, axis=1)
    assert 1.8e-5 < strength.min() < 2.5e-5 and 4e-5 < strength.max() < 5.5e-5
    assert np.all(here.field_sigma_T >= 1.5e-7) and here.field_sigma_T.max() < 3e-6
    border = np.flatnonzero(np.diff(here.lit))
    assert len(border) and np.median(here.lit_sigma) == 0
    assert np.all(here.lit_sigma[border] + here.lit_sigma[border + 1] > 0.5)
    assert np.all(here.albedo_sigma >= 0.49 * np.linalg.norm(here.albedo_light_N, axis=1))
    moved = in_orbit(elements, EPOCH, t, shift_s=20, shift_sigma_s=10).at(t)
    np.testing.assert_allclose(moved.nadir_N[:-1], here.nadir_N[1:], atol=1e-6)
    late = in_orbit(elements, EPOCH, t, clock_s=20, shift_sigma_s=10).at(t)
    np.testing.assert_allclose(late.field_N[:-1], here.field_N[1:], atol=1e-12)


def test_the_error_of_a_drifting_along_track_offset_grows_away_from_mid_file():
    elements = parse_elements(VZLUSAT, "case")
    t = 86400 * np.array([0.0, 1.0, 2.0])
    plain = in_orbit(elements, EPOCH, t, shift_s=-5.0, shift_sigma_s=10.0)
    days = abs(elements[0].days_to(plain.middle_jd))
    assert plain.drift_sigma_s_day == pytest.approx(np.hypot(0.2 + 0.02 * days, 1 / 3))
    orbit = replace(plain, drift_s_day=20.0, drift_sigma_s_day=3.0)
    when = orbit.instants(t)
    np.testing.assert_allclose(orbit.ahead_s(when), [-25.0, -5.0, 15.0], atol=1e-4)
    np.testing.assert_allclose(orbit.ahead_sigma_s(when) ** 2, [110.0, 101.0, 110.0], rtol=1e-6)
    shifts = enumerate((-25.0, -5.0, 15.0))
    at = [replace(plain, shift_s=shift).states(when)[0][k] for k, shift in shifts]
    np.testing.assert_allclose(orbit.states(when)[0], at, atol=1.0)
    turning = 360 / 5680 * orbit.ahead_sigma_s(when)
    np.testing.assert_allclose(np.degrees(orbit.at(t).nadir_sigma_rad), turning, rtol=0.02)


def test_an_orbit_gives_torques_in_J2000_and_the_same_surroundings_with_the_sun_along_z():
    elements = parse_elements(VZLUSAT, "case")
    orbit = in_orbit(elements, EPOCH, [0.0, 600.0], shift_sigma_s=10)
    cube = ss.Vehicle("cube", inertia_kg_m2=np.diag([0.002, 0.005, 0.006]))
    sun = orbit.at(0.0).sun_N[0]
    start, t = ([0, 0, 0.01], sun, None), np.array([0.0, 300.0, 600.0])
    calm = ss.propagate(cube, *start, t, environment=orbit)
    pulled = ss.propagate(cube, *start, t, environment=orbit, torques=["gravity_gradient"])
    assert pulled.attrs["frame_N"] == "J2000"
    here = orbit.at(0.0)
    lever = np.cross(here.nadir_N[0], cube.inertia_kg_m2 @ here.nadir_N[0])
    torque = 3 * np.sum(here.nadir_turn_N[0] ** 2) * lever
    change = (pulled["momentum_B"] - calm["momentum_B"]).values[1]
    assert 0.2 < np.linalg.norm(change) / (300 * np.linalg.norm(torque)) < 1.5
    local = SunAlongZ(orbit)
    np.testing.assert_allclose(local.at(0.0).sun_N[0], [0, 0, 1], atol=1e-12)
    there, turned = orbit.at(t), local.at(t)
    for name in ("field_N", "nadir_N", "albedo_light_N", "nadir_turn_N"):
        expected = (getattr(there, name) * there.sun_N).sum(axis=1)
        found = (getattr(turned, name) * turned.sun_N).sum(axis=1)
        np.testing.assert_allclose(found, expected, atol=1e-12)
    assert local.frame_N == "sun_z_local"


OLD = "the elements are 61 days from the telemetry: the place along the track is known to some 50 s"


def test_the_nearest_elements_are_used_with_a_warning_if_they_are_old():
    """And a warning counts the samples that are dated long before the first ones."""
    far = parse_elements(VZLUSAT, "case")
    for epoch, days, dated in (
        ("2017-06-25", [0.0, 0.07], ["2 of 2 samples are dated 2017-06-25"]),
        ("2017-08-20", [-50, -20, 0], ["2 of 3 samples are dated 2017-07-01 to 2017-07-31"]),
        ("2017-08-20", [0.0, 40.0], []),
    ):
        t = 86400.0 * np.array(days)
        notes = in_orbit(far, f"{epoch}T00:00:00Z", t).notes(t)
        before = ", before the first elements (2017-08-24): check the clock"
        assert [note for note in notes if "first" in note] == [text + before for text in dated]
        assert (OLD in notes) == (epoch == "2017-06-25")
    later_lines = _line(VZLUSAT, "17236.90928386", "17240.90928386")
    (later,) = parse_elements(later_lines, "case")
    both = parse_elements(later_lines + VZLUSAT, "case")
    assert [one.epoch_jd for one in both] == [far[0].epoch_jd, later.epoch_jd]
    assert nearest(both, sum(far[0].epoch_jd) + 1.9).epoch_jd == far[0].epoch_jd
    assert nearest(both, sum(far[0].epoch_jd) + 2.1).epoch_jd == later.epoch_jd


def _line(text: str, old: str, new: str) -> str:
    """Text in lines with `old` replaced and the check digits of lines of 69 characters made right again."""
    lines = [line.replace(old, new) for line in text.splitlines()]
    lines = [with_check_digit(line) if len(line) == 69 else line for line in lines]
    return "\n".join(lines) + "\n"


def _kvn(fields: dict) -> str:
    return "CCSDS_OMM_VERS = 2.0\n" + "\n".join(f"{key} = {value}" for key, value in fields.items())


def _xml(fields: dict) -> str:
    inner = "".join(f"<{key}>{value}</{key}>" for key, value in fields.items())
    return f"<?xml version='1.0'?><ndm><omm><body><segment>{inner}</segment></body></omm></ndm>"


FORMS = {
    "json": lambda fields: json.dumps([fields]),
    "csv": lambda fields: ",".join(fields) + "\n" + ",".join(map(str, fields.values())) + "\n",
    "kvn": _kvn,
    "xml": _xml,
}


URN = '"urn:ccsds:schema:ndmxml"'
PREFIXED = re.sub("(ndm|omm)>", r"n:\1>", _xml(ISS))
WRITTEN = {
    **{form: write(ISS) for form, write in FORMS.items()},
    "object": json.dumps(ISS),
    "namespace": PREFIXED.replace("<n:ndm>", f"<n:ndm xmlns:n={URN}>"),
    "default namespace": _xml(ISS).replace("<ndm>", f"<ndm xmlns={URN}>"),
    "comments": _kvn(ISS).replace("EPOCH", "COMMENT a = 1\nCOMMENT a = 1\nEPOCH", 1),
    "semicolons": FORMS["csv"](ISS).replace(",", ";"),
    "tabs": "\n" + FORMS["csv"](ISS).replace(",", "\t"),
    "page": json.dumps({"totalItems": 1, "member": [ISS]}),
    "small letters": json.dumps({key.lower(): value for key, value in ISS.items()}),
    "blank in the epoch": json.dumps(ISS).replace("T12:00:00", " 12:00:00"),
    "closing semicolons": _kvn(ISS).replace("\n", ";\n"),
    "CDATA": _xml(ISS).replace(">ISS (ZARYA)<", "><![CDATA[ISS (ZARYA)]]><"),
    "UTF-16": FORMS["csv"](ISS),  # a download with PowerShell
}


@pytest.mark.parametrize("form", WRITTEN)
def test_an_OMM_is_read_in_each_of_its_forms(form, tmp_path):
    path = tmp_path / "omm"
    path.write_text(WRITTEN[form], "utf-16" if form == "UTF-16" else "utf-8")
    (elements,) = read_orbit(path)
    assert (elements.number, elements.name) == (25544, "ISS (ZARYA)")
    assert sum(elements.epoch_jd) == pytest.approx(2460371.0, abs=1e-9)
    assert elements.period_s == pytest.approx(86400 / 15.49)
    place, _ = elements.states(*(np.array([part]) for part in elements.epoch_jd))
    assert np.linalg.norm(place) == pytest.approx(6.79e6, rel=3e-3)


def test_the_name_above_two_lines_may_have_an_accent_in_the_encoding_of_Windows(tmp_path):
    (tmp_path / "tle.txt").write_bytes(VZLUSAT.replace("VZLUSAT-1", "ÑUSAT-1").encode("cp1252"))
    (elements,) = read_orbit(tmp_path / "tle.txt")
    assert (elements.name, elements.number) == ("ÑUSAT-1", 42790)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("epoch", "more", "utc"),
    [
        ("2024-03-01T12:00:37", {"TIME_SYSTEM": "TAI"}, ISS["EPOCH"]),
        ("2024-03-01T12:00:37", {"TIME_SYSTEM": "tai"}, ISS["EPOCH"]),
        ("2024-03-01T12:01:09.184", {"TIME_SYSTEM": "TT"}, ISS["EPOCH"]),
        ("2024-03-01T12:00:18", {"TIME_SYSTEM": "GPS"}, ISS["EPOCH"]),
        # the leap second at the end of 2016: TAI is 36 s ahead before, 37 s after
        ("2017-01-01T00:00:10", {"TIME_SYSTEM": "TAI"}, "2016-12-31T23:59:34.000000"),
        ("2017-01-01T00:00:40", {"TIME_SYSTEM": "TAI"}, "2017-01-01T00:00:03.000000"),
        # former messages of Space-Track have the microseconds in a key of their own
        ("2024-03-01 12:00:00", {"EPOCH_MICROSECONDS": "43200"}, "2024-03-01T12:00:00.043200"),
        # by the day of the year, with nanoseconds, without a fraction
        ("2024-061T12:00:00Z", {}, ISS["EPOCH"]),
        ("2024-03-01T12:00:00.000000123", {}, ISS["EPOCH"]),
        ("2024-03-01T12:00:00", {}, ISS["EPOCH"]),
    ],
)
def test_an_epoch_written_otherwise_or_of_another_time_system_becomes_the_same_UTC(
    epoch, more, utc, form
):
    """Since 2017 TAI is 37 s ahead of UTC, TT 32.184 s ahead of TAI, and GPS 19 s behind TAI."""
    (elements,) = parse_elements(FORMS[form](ISS | {"EPOCH": epoch} | more), "case")
    (expected,) = parse_elements(json.dumps(ISS | {"EPOCH": utc}), "case")
    assert elements.epoch_jd == expected.epoch_jd
    assert dict(elements.given)["EPOCH"] == dict(expected.given)["EPOCH"] == utc


@pytest.mark.parametrize("form", ["SatNOGS", "Space-Track", "N2YO", "lines"])
def test_lines_of_elements_in_JSON_are_read_as_lines(form):
    one, two = VZLUSAT.splitlines()[-2:]
    text = {
        "SatNOGS": [{"tle0": "0 VZLUSAT-1", "tle1": one, "tle2": two, "sat_id": "A"}],
        "Space-Track": [{"OBJECT_NAME": "VZLUSAT-1", "TLE_LINE1": one, "TLE_LINE2": two}],
        "N2YO": {"info": {"satid": 42790}, "name": "VZLUSAT-1", "tle": f"{one}\r\n{two}"},
        "lines": {"name": "VZLUSAT-1", "line1": one, "line2": two},
    }[form]
    (elements,) = parse_elements(json.dumps(text) + "\n", "case")
    (plain,) = parse_elements(f"{one}\n{two}", "case")
    assert (elements.given, elements.name) == (plain.given, "VZLUSAT-1")


SYSTEMS = ".* give EPOCH and TIME_SYSTEM in one of UTC, TAI, TT, TDT, TDB, GPS"


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("REF_FRAME", "EME2000", "REF_FRAME of the OMM is not TEME, the frame of SGP4 .found EME2"),
        ("REF_FRAME", "TOD", "REF_FRAME of the OMM is not TEME"),
        ("CENTER_NAME", "MOON", "CENTER_NAME of the OMM is not EARTH .found MOON."),
        ("TIME_SYSTEM", "SCLK", "TIME_SYSTEM of the OMM cannot be converted to UTC .found SCLK."),
        ("TIME_SYSTEM", "UT1", SYSTEMS),
        ("EPHEMERIS_TYPE", 4, "the ephemeris type .* not for SGP4 .found 4 .SGP4-XP.."),
        ("EPHEMERIS_TYPE", 6, "the ephemeris type .* not for SGP4 .found 6."),
        ("MEAN_ELEMENT_THEORY", "SGP4-XP", "the OMM's elements are not for SGP4 .found SGP4-XP."),
        ("NORAD_CAT_ID", "I5544", "the catalogue number .* cannot be read .found I5544."),
        ("NORAD_CAT_ID", "1234567890", "the catalogue number .* cannot be read"),
        ("NORAD_CAT_ID", -5, "the catalogue number .* cannot be read"),
    ],
)
def test_an_OMM_of_another_theory_than_SGP4_is_refused(key, value, message, form):
    with pytest.raises(ss.InputError, match=f"case: {message}"):
        parse_elements(FORMS[form](ISS | {key: value}), "case")


PUBLISHED = {"COMMENT": "GENERATED VIA A PUBLIC API", "CREATION_DATE": "2024-03-01T18:00:00"}
PUBLISHED |= {"ORIGINATOR": "SOMEBODY", "CENTER_NAME": "EARTH", "REF_FRAME": "TEME"}
PUBLISHED |= {"TIME_SYSTEM": "UTC", "MEAN_ELEMENT_THEORY": "SGP4"}


@pytest.mark.parametrize("form", FORMS)
def test_published_OMMs_are_read_with_and_without_the_keys_of_their_theory(form):
    (plain,) = parse_elements(FORMS[form](ISS), "case")
    for more in (
        PUBLISHED,
        {"EPHEMERIS_TYPE": 2, "MEAN_ELEMENT_THEORY": "SGP/SGP4"},
        {"REF_FRAME": "TEME of Date", "CENTER_NAME": "Earth"},
        {"EPHEMERIS_TYPE": "", "TIME_SYSTEM": "", "REV_AT_EPOCH": ""},
        {"ELEMENT_SET_NO": "", "CLASSIFICATION_TYPE": "", "OBJECT_ID": "1998-067ABCDEFGH"},
    ):
        (elements,) = parse_elements(FORMS[form](ISS | more), "case")
        assert replace(elements, where="", given=()) == replace(plain, where="", given=())
        assert dict(elements.given) == dict(plain.given)


def test_catalogue_numbers_of_up_to_nine_digits_padded_or_not_are_read():
    for number in (999999999, 799500123, "000025544", " 25544 ", 25544.0, "A5544", 340000):
        (elements,) = parse_elements(json.dumps(ISS | {"NORAD_CAT_ID": number}), "case")
        assert elements.number == {"A5544": 105544}.get(number, int(float(str(number).strip("A"))))
        place, _ = elements.states(*(np.array([part]) for part in elements.epoch_jd))
        assert np.linalg.norm(place) == pytest.approx(6.79e6, rel=3e-3)
    (plain,) = parse_elements(VANGUARD, "case")
    for first, second in (("00005", "    5"), ("    5", "00005"), ("5    ", "    5")):
        text = f"{ONE[:2]}{first}{ONE[7:]}\n{TWO[:2]}{second}{TWO[7:]}"
        (elements,) = parse_elements(text, "case")
        assert elements.number == 5 and elements.given == plain.given
    both = json.dumps([ISS, ISS | {"NORAD_CAT_ID": "00025544", "EPOCH": "2024-03-02T12:00:00"}])
    assert [one.number for one in parse_elements(both, "case")] == [25544, 25544]


SISTERS = [
    ISS | {"NORAD_CAT_ID": 270_000_001 + k, "OBJECT_NAME": f"FLOCK 4X-{k}"} for k in range(9)
]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("satellite", ["270000003", " 270000003 ", "FLOCK 4X-2", "flock 4x-2"])
def test_one_of_many_satellites_is_chosen_by_number_or_name(form, satellite):
    messages = [_xml(fields).split("<ndm>")[1].removesuffix("</ndm>") for fields in SISTERS]
    rows = [SISTERS[0], *(fields.values() for fields in SISTERS)]
    text = {
        "json": json.dumps(SISTERS),
        "csv": "\n".join(",".join(map(str, row)) for row in rows),
        "kvn": "\n".join(map(_kvn, SISTERS)),
        "xml": f"<ndm>{''.join(messages)}</ndm>",
    }[form]
    (elements,) = parse_elements(text, "case", satellite)
    assert (elements.number, elements.name) == (270_000_003, "FLOCK 4X-2")


def test_a_satellite_of_a_TLE_file_is_chosen_and_a_missing_one_is_refused_with_similar_names():
    both = VANGUARD + VZLUSAT
    for satellite, number in (("42790", 42790), ("vzlusat-1", 42790), ("5", 5)):
        (elements,) = parse_elements(both, "case", satellite)
        assert elements.number == number
    for satellite in ("vzlusat", "42791"):
        message = rf"no elements of '{satellite}' .found .*42790 .VZLUSAT-1.*; give one of its 2"
        with pytest.raises(ss.InputError, match=message):
            parse_elements(both, "case", satellite)


TAI = ISS | {"TIME_SYSTEM": "TAI"}
NO_BSTAR = {key: value for key, value in ISS.items() if key != "BSTAR"}
MANY = "the file has elements of 2 satellites .found 5, 42790 .VZLUSAT-1..; name yours with --norad"
UNREAD = "the catalogue number of the satellite cannot be read .found "
OF_TYPE_4 = _line(f"{ONE[:62]}4{ONE[63:]}\n{TWO}", "", "")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (VANGUARD.replace("4753", "4754"), "line 1: the checksum of the line is 3, but its last"),
        (f"{TWO}\n{ONE}", "line 2 of the elements comes before line 1; exchange"),
        (_line(VANGUARD, "2 00005", "2 00006"), "of different satellites .found 00005 and 00006."),
        (_line(VANGUARD, "00179", "00479"), "day of the year must be from 1 to 366 .found 479"),
        (_line(VANGUARD, "348.7242", "34x.7242"), "line 2: the columns are not those of a line"),
        (ONE, "line 1 of the elements has no line 2"),
        (VANGUARD[:60], "a line of elements has 69 characters .found 60."),
        (VANGUARD + VZLUSAT, MANY),
        (OF_TYPE_4, "case, line 1: .* the elements are not for SGP4 .found 4 .SGP4-XP.."),
        (VANGUARD.replace(" 00005", " I0005"), f"{UNREAD}I0005."),
        (VANGUARD.replace(" 00005", " O0005"), f"{UNREAD}O0005."),
        ("", "no orbital elements here; give two lines that begin with 1 and 2, an OMM, or a CSV"),
        ("{", "this is not valid JSON"),
        ("[1]", "the JSON is not an OMM"),
        (json.dumps(NO_BSTAR), "the OMM lacks a key .found BSTAR."),
        (json.dumps(NO_BSTAR | {"EPHEMERIS_TYPE": 4, "BTERM": 0.02}), "not for SGP4"),
        (json.dumps([ISS, ISS | {"REF_FRAME": "GCRF"}]), "^case, message 2: REF_FRAME of the OMM"),
        (VANGUARD.replace("1 0", "1\xa00"), "column 2 .found no-break space, U.00A0.;"),
        (VANGUARD.replace("2 0", "2\t0"), "in column 2 .found a control character, U.0009.;"),
        (VANGUARD.replace("00000-0", "00000\N{EN DASH}0"), "column 51 .found en dash, U.2013.;"),
        (json.dumps(ISS | {"ECCENTRICITY": "high"}), "ECCENTRICITY must be a number .found high."),
        (json.dumps(ISS | {"EPOCH": "soon"}), "EPOCH must be a time such as .* .found soon."),
        (json.dumps(TAI | {"EPOCH": "2023-366T12:00:00"}), "EPOCH must be a time such as"),
        (json.dumps(TAI | {"EPOCH": "2024-13-01T12:00:00"}), "EPOCH must be a time such as"),
        (json.dumps(TAI | {"EPOCH": "0001-01-01T00:00:00"}), "EPOCH must be a time such as"),
        (json.dumps(ISS | {"MEAN_MOTION": 0}), "the elements are those of no orbit"),
        ("<omm><a>", "this is not valid XML"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><omm/>', "a document type, which can define entities"),
    ],
)
def test_damaged_elements_are_refused_in_one_sentence(text, message):
    with pytest.raises(ss.InputError, match=message.replace("(", r"\(")) as said:
        parse_elements(text, "case")
    assert "\n" not in str(said.value) and re.match("case", str(said.value))


def test_elements_of_a_decayed_satellite_are_refused_as_decayed():
    low = parse_elements(_line(VZLUSAT, "15.20921507", "16.40921507"), "case")
    words = "case, line 3: these elements cannot be propagated to the telemetry: .*; give"
    with pytest.raises(ss.InputError, match=words):
        in_orbit(low, "2019-08-24T00:00:00Z", [0.0]).at([0.0])
