"""The built-in Philae case: its constants against numbers typed here from the paper, timeline and published figures."""

import dataclasses
import tomllib

import numpy as np
import pytest

import sunspin as ss
from sunspin.cases import parse_published
from sunspin.vehicle.timeline import parse_timeline, utc_seconds

case = ss.load_case("philae")
vehicle = case.vehicle


@pytest.mark.evidence("load_case", "validated", "the paper's Table 2")
def test_mass_and_inertia_are_those_of_table_2():
    inertia = [[13.905, -0.352, -0.015], [-0.352, 12.603, 0.007], [-0.015, 0.007, 16.523]]
    np.testing.assert_array_equal(vehicle.inertia_kg_m2, inertia)
    assert vehicle.mass_kg == 97.63
    (wheel,) = vehicle.wheels
    assert (wheel.inertia_kg_m2, wheel.speed_rad_s) == (0.0058, 865.0)
    assert wheel.axis_B.tolist() == [0.0, 0.0, 1.0]
    # the published figures state the same: they are typed twice, and a slip in either shows here
    mass, of_body, of_wheel = case.published["table_2"].value
    assert (mass, of_wheel) == (97.63, 0.0058)
    np.testing.assert_array_equal(of_body, inertia)


def test_panels_and_legs_are_those_of_section_2_1_and_table_3():
    s = 2**-0.5
    normals = [[0, 1, 0], [s, s, 0], [1, 0, 0], [s, -s, 0], [0, -1, 0], [0, 0, 1]]
    np.testing.assert_allclose(vehicle.panel_normals_B, normals, atol=2e-16)
    assert vehicle.panel_gains.tolist() == [254, 162, 162, 162, 254, 230]
    assert vehicle.panel_names == ("1", "2", "3", "4", "5", "6")
    assert vehicle.sun_rules[0].all_dark == ("3", "5")
    np.testing.assert_array_equal(vehicle.panel_gains, case.published["cells"].value)
    tips = [[1.4780, 0.0118, -0.4078], [-0.7784, 1.3775, -0.4078], [-0.7784, -1.3539, -0.4078]]
    np.testing.assert_array_equal([leg.tip_B_m for leg in vehicle.legs], tips)
    np.testing.assert_array_equal(case.published["table_3"].value, tips)


def test_friction_is_fitted_and_the_printed_pair_is_an_alternative():
    coulomb, viscous = 4.643e-4 * 388.9 * 0.0058, 4.643e-4 * 0.0058
    assert vehicle.wheels[0].friction.coulomb_N_m == pytest.approx(coulomb, rel=1e-12)
    assert vehicle.wheels[0].friction.viscous_N_m_s == pytest.approx(viscous, rel=1e-12)
    printed = vehicle.with_friction("printed").wheels[0].friction
    assert (printed.coulomb_N_m, printed.viscous_N_m_s) == (1.0e-3, 2.6811e-6)


@pytest.mark.parametrize("name", ["philae", "skcube"])
def test_every_number_of_a_built_in_vehicle_file_has_a_source(name):
    def check(value, key):
        if isinstance(value, dict) and "value" in value:
            assert value.get("source", "").strip(), key
        elif isinstance(value, dict):
            for name, item in value.items():
                check(item, f"{key}.{name}")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            for item in value:
                check(item, key)
        else:
            exact_geometry = key.endswith("normal_B")
            is_text = isinstance(value, str) or not contains_number(value)
            assert is_text or exact_geometry, f"{key} has no source"

    def contains_number(value):
        inner = value if isinstance(value, list) else []
        return isinstance(value, int | float) or any(map(contains_number, inner))

    built_in = ss.load_case(name)
    check(tomllib.loads((built_in.folder / "vehicle.toml").read_text("utf-8")), "")
    # the values that are read keep their sources
    facts = built_in.vehicle.facts
    assert len(facts) > 25
    sourceless = {key for key, fact in facts.items() if not (fact.source or "").strip()}
    assert all(key.endswith("normal_B") for key in sourceless)


@pytest.mark.evidence("load_case", "validated", "the paper's Table 1 and the landing kernel")
def test_times_of_the_timeline_are_those_of_table_1():
    seconds = case.timeline.seconds
    assert seconds("separation", "first_touchdown") == pytest.approx(6 * 3600 + 59 * 60 + 3.98)
    assert seconds("first_touchdown", "first_sample_after_touchdown") == pytest.approx(56.02)
    assert seconds("first_sample_after_touchdown", "collision") == 45 * 60
    assert seconds("collision", "second_touchdown") == 65 * 60 + 26
    assert seconds("second_touchdown", "rest") == 5 * 60 + 51
    assert case.timeline.event("first_touchdown").utc == "2014-11-12T15:34:04"
    assert all(event.source.strip() for event in case.timeline.events)


def test_phases_follow_each_other_without_gap():
    phases = case.timeline.phases
    names = "deployment descent first_rebound second_rebound settling rest".split()
    assert [phase.name for phase in phases] == names
    assert all(a.end_s == b.begin_s for a, b in zip(phases, phases[1:], strict=False))
    assert phases[-1].end_s == np.inf
    at = case.timeline.event("collision").t_s
    assert case.timeline.phase_at(at) == "second_rebound"
    assert case.timeline.phase_at(at - 0.001) == "first_rebound"
    assert case.timeline.phase_at(-1.0) is None
    # the telemetry counts from the same instant
    assert case.telemetry.attrs["epoch_utc"] == case.timeline.epoch_utc + "Z"
    assert case.telemetry.attrs["synthetic"] == 1


@pytest.mark.evidence(
    "load_case", "validated", "the paper's figures, where the case states them too"
)
def test_published_figures_agree_with_the_case_where_both_state_them():
    figure = {key: one.value for key, one in case.published.items()}
    assert figure["wheel_speed"] == vehicle.wheels[0].speed_rad_s
    window_s = case.timeline.seconds("first_sample_after_touchdown", "collision")
    assert figure["scan_duration"] * 60 == window_s
    printed = vehicle.wheels[0].alternative_frictions["printed"]
    assert figure["friction_coulomb"] == printed.coulomb_N_m
    assert figure["friction_viscous"] == printed.viscous_N_m_s
    reach = max(np.linalg.norm(leg.tip_B_m) for leg in vehicle.legs)
    speed = figure["landing_speed"] + reach * figure["rate_at_collision"]
    assert speed == pytest.approx(figure["leg_tip_speed"], abs=0.02)
    # the published number of runs is that of the published grid
    ranges = (figure[f"scan_omega_{axis}"] for axis in "xyz")
    points = [round((high - low) / figure["scan_step"]) + 1 for low, high in ranges]
    assert np.prod(points) == figure["scan_runs"] == 418241


def test_a_case_cannot_be_changed():
    with pytest.raises(dataclasses.FrozenInstanceError):
        case.name = "other"
    with pytest.raises(TypeError):
        case.published["emd_min"] = None


def test_names_that_a_case_or_its_timeline_lacks_are_refused():
    with pytest.raises(ss.InputError, match="no built-in case.*rosetta.*philae"):
        ss.load_case("rosetta")
    with pytest.raises(ss.InputError, match="no event of this name .*landing.*collision"):
        case.timeline.event("landing")
    with pytest.raises(ss.InputError, match="no phase"):
        case.timeline.phase("landing")
    # a study of a case without a timeline ended in a traceback
    assert case.require_timeline() is case.timeline
    with pytest.raises(ss.InputError, match="'skcube' has no timeline"):
        ss.load_case("skcube").require_timeline()


BEGIN = "epoch_utc = '2014-11-12T00:00:00'\n"
EVENT = f"{BEGIN}[[event]]\nname = 'a'\n"
REVERSED = f"{EVENT}utc = '2014-11-12T02:00:00'\nsource = 's'\n[[event]]\nname = 'b'\n"
REVERSED += "utc = '2014-11-12T01:00:00'\nsource = 's'\n"
REVERSED += "[[phase]]\nname = 'p'\nbegin = 'a'\nend = 'b'"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("epoch_utc = ", "not valid TOML"),
        ("[[event]]\nname = 'a'", "'epoch_utc' is missing"),
        (f"{EVENT}utc = 'noon'\nsource = 's'", "ISO-8601.*noon"),
        (f"{EVENT}utc = '2014-11-12'\nsource = ' '", "empty source"),
        (f"{EVENT}when = 1\nsource = 's'", "unknown key 'when'"),
        (REVERSED, "ends before it begins"),
    ],
)
def test_mistakes_in_a_timeline_file_are_named(text, message):
    with pytest.raises(ss.InputError, match=f"here.toml.*{message}"):
        parse_timeline(text, "here.toml")


def test_utc_is_read_with_and_without_a_zone():
    assert utc_seconds("2014-11-12T16:20:00+01:00", "2014-11-12T15:20:00Z") == 0.0
    assert utc_seconds("2014-11-12T15:34:03.98", "2014-11-12T15:34:00") == pytest.approx(3.98)


def test_a_published_figure_without_place_is_refused():
    with pytest.raises(ss.InputError, match="here.toml, x"):
        parse_published("[x]\nvalue = 1\nunit = '1'\nwhat = 'w'", "here.toml")
    with pytest.raises(ss.InputError, match="none of them empty"):
        parse_published("[x]\nvalue = 1\nunit = '1'\nwhat = 'w'\nplace = ' '", "here.toml")
