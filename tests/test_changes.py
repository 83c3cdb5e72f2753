"""Changed values of a vehicle: by key, within the ranges of the file, stated in the results."""

import json
import tomllib
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import sunspin as ss
from sunspin.base.errors import InputError, SunspinError
from sunspin.cli.changes import load_inputs
from sunspin.cli.common import Group
from sunspin.compute.identity import to_json
from sunspin.dynamics.gyrostat import kinetic_energy
from sunspin.landing.outcomes import default_scenario
from sunspin.landing.scenario import build_scenario, case_scenario, paper_scenario
from sunspin.output.folder import write_netcdf
from sunspin.philae import rebound as rb
from sunspin.philae.candidates import select_start_rates
from sunspin.vehicle.assumptions import AssumptionsFile, assumptions_table, read_assumptions
from sunspin.vehicle.changes import Change, apply_changes, list_settings, parse_changes
from sunspin.vehicle.file import (
    ChangedFile,
    VehicleFile,
    parse_vehicle,
    read_vehicle_table,
    read_vehicle_text,
)

OWN = ss.load_vehicle("philae")


def with_changes(*changes):
    return ss.load_vehicle("philae", changes)


def test_values_change_by_number_factor_or_step():
    keys = "wheel.speed_rad_s body.inertia_kg_m2[2][2] leg[2].tip_B_m[0] panel[6].gain".split()
    ways = ("=833", "*=0.9", "+=0.1", "*=1.1")
    craft = with_changes(*(key + way for key, way in zip(keys, ways, strict=True)))
    assert craft.wheels[0].speed_rad_s == 833
    assert craft.inertia_kg_m2[2, 2] == pytest.approx(0.9 * 16.523)
    assert craft.legs[1].tip_B_m[0] == pytest.approx(-0.6784)
    assert craft.panels[5].gain == pytest.approx(253)
    assert [one.key for one in craft.changes] == keys
    said = "wheel.speed_rad_s = 833 rad/s (was 865 rad/s; paper, section 2.2"
    assert str(craft.changes[0]).startswith(said)
    assert craft.facts["wheel.wheel.speed_rad_s"].source.startswith("set for this run; was 865")
    given = {"wheel.speed_rad_s": 833, "body.inertia_kg_m2[2][2]": "*=0.9"}
    same = ss.load_vehicle("philae", given)
    assert same.wheels[0].speed_rad_s == 833
    assert same.inertia_kg_m2[2, 2] == craft.inertia_kg_m2[2, 2]


def test_an_off_diagonal_element_sets_its_mirror_and_friction_laws_are_chosen_by_name():
    assert with_changes("body.inertia_kg_m2[0][1]=0.1").inertia_kg_m2[1, 0] == 0.1
    printed = with_changes("wheel.friction=printed").wheels[0].friction
    assert printed == OWN.with_friction("printed").wheels[0].friction
    own = OWN.wheels[0].friction
    stiffer = with_changes("wheel.friction.coulomb_N_m*=1.1").wheels[0].friction
    assert stiffer.coulomb_N_m == pytest.approx(1.1 * own.coulomb_N_m)
    assert stiffer.viscous_N_m_s == own.viscous_N_m_s
    assert with_changes("sun_rule=[]").sun_rules == ()
    # the same value is no change
    assert with_changes("wheel.speed_rad_s=865", "wheel.speed_rad_s*=1") == OWN


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("wheel.sped_rad_s=3", "did you mean speed_rad_s?"),
        ("speed=3", "unknown key 'speed'"),
        ("panel.gain=3", "say which in brackets: 1, 2, 3, 4, 5, 6"),
        ("panel[9].gain=3", "known: 1, 2, 3, 4, 5, 6"),
        ("panel[1].gian=3", "unknown key 'gian'"),
        ("body.mass_kg=-1", "body.mass_kg set: mass_kg must be positive"),
        ("body.inertia_kg_m2[2][2]*=3", "not that of any body"),
        ("panel_response.grazing.loss=2", "panel_response.grazing is gone"),
        ("wheel.friction=plain", "should be a table"),
        ("wheel.speed_rad_s=fast", "a number is expected"),
        ("telemetry.scale*=2", "not set"),
        ("wheel.speed_rad_s", "write KEY=VALUE"),
        ("x" * 200, "write KEY=VALUE"),  # a pattern that splits it in every way never ends
        ("body=3", "should be a table"),
        ("study.lad_s=3", "did you mean lead_s?"),
        ("stud.lead_s=3", "unknown key 'stud'"),
        ("wheel.speed_rad_s=nan", "a number is expected"),
        ("wheel.speed_rad_s=NaN", "finite number"),
        ("wheel.speed_rad_s=1e400", "finite number"),
        ("wheel.speed_rad_s*=inf", "*= needs numbers"),
        ("wheel.speed_rad_s*=1e400", "*= needs numbers"),
        ("wheel.speed_rad_s*=true", "*= needs numbers"),
        ("wheel.speed_rad_s=1\nbody.mass_kg=2", "a number is expected"),
        ("wheel.speed_rad_s-=5", "did you mean speed_rad_s?"),
        ("wheel.friction*=2", "*= needs numbers"),
        ("name*=2", "*= needs numbers"),
        ("wheel..speed_rad_s=3", "write KEY=VALUE"),
        ("wheel]speed_rad_s=3", "write KEY=VALUE"),
        ("[0]=3", "write KEY=VALUE"),
        ("wheel[0][0]=3", "nothing to set"),
        ("body.mass_kg.x=3", "value, sigma, source"),
        ("body.inertia_kg_m2.value.x=3", "which in brackets: 0 to 2"),
        ("body.inertia_kg_m2[][0]=1", "known: 0 to 2"),
        ("body.inertia_kg_m2[-1][0]=1", "known: 0 to 2"),
        ("body.inertia_kg_m2[0][0][0]=1", "nothing to set"),
        ("telemetry.time_column*=2", "*= needs numbers"),
        ("=5", "write KEY=VALUE"),
        ("collision.damper=2", "must be a share between 0 and 1"),
        ("study.mask=none", "'reconstructible' or 'everywhere'"),
    ],
)
def test_invalid_changes_are_refused_with_the_nearest_name_or_the_message_of_the_file(
    change, words
):
    with pytest.raises(SunspinError) as refused:
        ss.load_case("philae", [change])
    assert words in str(refused.value) and "\n" not in str(refused.value)


TEMPLATE = str(resources.files("sunspin").joinpath("template", "vehicle.toml"))


@pytest.mark.parametrize("source", ["philae", "skcube", TEMPLATE])
def test_every_listed_value_can_be_changed(source):
    """Set to itself, times one or plus zero, a value stays and is no change; times two it is twice what it was."""
    listing = list_settings(read_vehicle_table(source), VehicleFile)
    listed = {each.key: each.value for each in listing}
    own = {key: value for key, value in listed.items() if value not in (None, "as below")}
    same = [Change(key, "=", value) for key, value in own.items()]
    assert len(own) > 20 and ss.load_vehicle(source, same) == ss.load_vehicle(source)
    numbers = {key: value for key, value in own.items() if is_numeric(value)}
    assert len(numbers) > 20
    for change, factor in (("*=1", 1), ("+=0", 1), ("*=2", 2)):
        table = read_vehicle_table(source)
        done = apply_changes(table, parse_changes(dict.fromkeys(numbers, change)))
        after = {each.key: each.value for each in list_settings(table, VehicleFile)}
        for key, value in numbers.items():
            np.testing.assert_array_equal(after[key], factor * np.array(value), err_msg=key)
        assert (len(done) > 20) == (factor == 2)
        assert all(each.old_value == numbers[each.key] for each in done)
    for key in listed.keys() - own.keys():  # what the file leaves out is known by its key
        try:
            ss.load_vehicle(source, {key: "x"})
        except ss.VehicleError as error:
            assert "unknown key" not in str(error), key
    assumed = {each.key: each for each in list_settings(assumptions_table(), AssumptionsFile)}
    assert all(each.source for each in assumed.values()) and assumed["study.lead_s"].unit == "s"


def is_numeric(value):
    return np.array(value).dtype.kind in "if" and np.size(value) > 0


@pytest.mark.parametrize("source", ["philae", "skcube", TEMPLATE])
def test_the_changed_file_reads_as_the_changed_vehicle(source):
    """Every number changed at once; the comments stay."""
    listed = list_settings(read_vehicle_table(source), VehicleFile)
    asked = parse_changes([f"{one.key}*=1.0001" for one in listed if is_numeric(one.value)])
    text, expected = read_vehicle_text(ChangedFile(source, asked)), read_vehicle_table(source)
    assert len(apply_changes(expected, asked)) > 20
    assert tomllib.loads(text) == expected
    assert sum(line.startswith("#") for line in text.splitlines()) > 5


def test_the_changed_file_is_a_vehicle_file():
    tilted = ['panel_response.tilted.panel="6"', "panel_response.tilted.turn_B_rad=[0.1, 0, 0]"]
    asked = parse_changes(["wheel.friction=printed", "wheel.speed_rad_s=833", *tilted])
    for name in ("philae", "skcube"):
        mine = asked if name == "philae" else ()
        written = parse_vehicle(read_vehicle_text(ChangedFile(name, mine)), "here")
        direct = ss.load_vehicle(name, mine)
        assert to_json(written) == to_json(replace(direct, changes=()))


def test_assumptions_follow_into_the_study():
    changes = "study.lead_s=30 study.target_weights=interval study.mask=everywhere"
    case = ss.load_case("philae", changes.split())
    usual = ss.load_case("philae")
    sun = ss.sun_directions(usual.vehicle, usual.telemetry)
    mine, theirs = rb.make_rebound(case, sun), rb.make_rebound(usual, sun)
    assert mine.lead_s == 30 and theirs.lead_s == pytest.approx(56.02)
    assert rb.first_sample_lead_s(case) == 30 and theirs.weights is None
    assert mine.weights.sum() == pytest.approx(np.ptp(mine.t_s[mine.reconstructed]))
    assert rb.direction_mask(case) is None and rb.direction_mask(usual) is not None
    assert len(case.changes) == 3 and usual.assumptions == read_assumptions()


def test_a_change_of_a_wheel_makes_another_body_and_one_of_a_leg_does_not():
    """The published lines hold for the case as it is; legs do not enter them."""
    case = ss.load_case("philae", ["wheel.speed_rad_s=833"])
    own = rb.motion_and_panel_parameters(OWN)
    assert rb.motion_and_panel_parameters(case.vehicle) != own
    assert rb.motion_and_panel_parameters(with_changes("leg[2].tip_B_m[0]+=0.1")) == own
    facts = {key: fact for key, fact in OWN.facts.items() if not key.startswith("panel")}
    surer = replace(OWN, facts=facts)
    assert rb.motion_and_panel_parameters(surer) == own


def command(*words):
    result = CliRunner().invoke(Group("sunspin"), [str(word) for word in words])
    return result


def test_commands_list_the_changes_and_print_them(tmp_path):
    listed = json.loads(command("simulate", "philae", "--set", "list", "--json").output)
    assert {"wheel.speed_rad_s", "body.inertia_kg_m2"} <= {one["key"] for one in listed}
    speed = next(one for one in listed if one["key"] == "wheel.speed_rad_s")
    assert speed["value"] == 865 and speed["unit"] == "rad/s"
    assert speed["source"].startswith("paper")
    assert "study.lead_s" in command("reproduce", "--set", "list").output
    for name in ("scan", "posterior", "outcomes", "simulate"):  # without a run's arguments
        assert "wheel.speed_rad_s" in command(name, "--set", "list").output, name
    changes = ("--set", "wheel.speed_rad_s=833")
    ran = command(*SIMULATE.split(), *changes, "--out", tmp_path / "run")
    assert ran.exit_code == 0
    assert "Changed for this run: wheel.speed_rad_s = 833 rad/s" in ran.output
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["changes"][0].startswith("wheel.speed_rad_s = 833")
    assert "833" in (tmp_path / "run" / "vehicle.toml").read_text()


SIMULATE = "simulate philae --omega-deg-s 0,0,0 --sun 0,0,1 --duration 1"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (f"{SIMULATE} --set study.mask=everywhere", "does not use that assumption"),
        (f"{SIMULATE} --set study.leed_s=3", "did you mean lead_s?"),
        (
            "outcomes philae --set wheel.speed_rad_s=833",
            "give --scan scan.nc, or give --omega-deg-s",
        ),
        ("outcomes philae --scan scan.nc --omega-deg-s 0,0,60", "give one of them"),
        ("outcomes philae --lead 5 --set study.lead_s=30", "--lead and --set study.lead_s say"),
        (
            f"{SIMULATE} --wheel-speed 800 --set wheel[wheel].speed_rad_s=833",
            "--wheel-speed and --set wheel[wheel].speed_rad_s say the same thing",
        ),
    ],
)
def test_a_command_refuses_a_change_that_it_cannot_use(words, said):
    result = command(*words.split())
    assert isinstance(result.exception, SunspinError) and said in str(result.exception)


def test_a_change_that_a_command_does_not_use_is_reported_and_not_listed():
    """A change without effect is no error, as one set of changes may go through several commands, but it is not silent."""
    words = SIMULATE.split()
    changes = "--set panel[2].gain*=2 --set body.mass_kg=90 --set body.inertia_kg_m2[0][1]*=2"
    ran = command(*words, *changes.split())
    said = [line for line in ran.stderr.splitlines() if "changes nothing here" in line]
    assert ran.exit_code == 0
    assert [line.split()[1] for line in said] == ["panel[2].gain", "body.mass_kg"]
    refused = command(*words, "--set", "panel[9].gain=3")
    assert "no [9] here" in str(refused.exception) and "changes nothing" not in refused.stderr
    listed = json.loads(command("simulate", "philae", "--set", "list", "--json").output)
    assert {one["key"].partition(".")[0] for one in listed} == {"body", "wheel"}


def test_short_names_of_changes_work_in_several_commands(tmp_path):
    """--friction wherever a wheel runs; --restitution and --damper where there may be a blow."""
    usual = "simulate philae --omega-deg-s 6,0,0 --sun 0,0,1 --duration 60".split()
    said = [command(*usual, *more).output.splitlines() for more in ((), ("--friction", "printed"))]
    assert said[1][0].startswith("Changed for this run: wheel.friction = printed")
    assert said[0][-1] != said[1][-1]
    options = "--omega-deg-s 6,-12,6 --runs 50 --strategy off --friction printed"
    words = ("outcomes", "philae", *options.split())
    extra = ((), ("--restitution", "0.4"), ("--set", "collision.restitution=0.4"))
    ran = [command(*words, *more).output for more in extra]
    options = "--runs 50 --strategy off --set telemetry.noise*=2"
    noisier = command("outcomes", "philae", *options.split())
    assert "telemetry.noise changes nothing here" in noisier.stderr
    assert "a leg touches first" in noisier.output
    rates = [[line for line in out.splitlines() if "angular speed after" in line] for out in ran]
    assert rates[0] and rates[0] != rates[1] == rates[2]
    assert "collision.restitution = 0.4 (was 0" in ran[1]


def test_a_posterior_without_predictions_does_not_use_a_change_of_the_collision(monkeypatch):
    monkeypatch.setattr("sunspin.estimate.posterior.posterior", refuse)
    changes = "--restitution 0.2 --set body.mass_kg=90".split()
    without, predicted = (
        command("posterior", "philae", *words, *changes).stderr.splitlines()
        for words in ((), ("--predict", "17:25"))
    )
    unused = [line.split()[1] for line in without if "nothing here" in line]
    assert unused == ["body.mass_kg", "collision.restitution"]
    assert not any("nothing here" in line for line in predicted)


def refuse(*_, **__):
    raise InputError("not run")


def test_outcomes_name_the_vehicle_of_the_motions_of_a_scan(tmp_path):
    axes = {f"omega_{axis}": [0.0, 0.1] for axis in "xyz"}
    volume = xr.DataArray(np.arange(1.0, 9.0).reshape(2, 2, 2), axes, list(axes), "emd")
    changed = with_changes("wheel.speed_rad_s=833").result_attributes["changes"]
    attrs = {"vehicle": "philae", "changes": f"{changed}\nstudy.mask = everywhere"}
    scan = volume.to_dataset().assign_attrs(attrs)
    write_netcdf(tmp_path / "scan.nc", scan)
    for sets, words in (
        (("wheel.speed_rad_s=833",), ""),
        ((), "of another body than this run's: philae, wheel.speed_rad_s = 833"),
    ):
        craft = load_inputs("philae", parse_changes(sets)).craft
        points, whose = select_start_rates(craft, [], tmp_path / "scan.nc", 1.1)
        assert len(points) == 1 and words in whose and ("another body" in whose) is bool(words)


def test_a_landing_scenario_has_the_wheel_of_the_changed_vehicle():
    craft = with_changes("wheel.speed_rad_s=833")
    assert build_scenario("philae", craft, {}).wheel_speed_rad_s == (833.0,)
    assert default_scenario(craft).wheel_speed_rad_s == (833.0,)
    assert default_scenario(OWN).wheel_speed_rad_s == (865.0,)
    changes = "collision.restitution=0.2 collision.damper=0.5 study.lead_s=30"
    case = ss.load_case("philae", changes.split())
    found = case_scenario(case)
    assert (found.restitution, found.damper, found.lead_s) == (0.2, 0.5, 30.0)
    assert paper_scenario(case).restitution == 0.2


@pytest.mark.parametrize(("restitution", "damper"), [(0, 0), (1, 0), (0, 1), (0.4, 0.3), (1, 1)])
def test_an_impact_of_a_changed_vehicle_never_adds_energy(restitution, damper):
    rng, leg = np.random.default_rng(3), OWN.legs[1].tip_B_m
    omega, velocity = rng.normal(0, 0.3, (50, 3)), rng.normal(0, 0.3, (50, 3))
    hit = ss.impact(OWN, omega, 300.0, velocity, "2", restitution=restitution, damper=damper)

    def energy(omega, velocity, speed):
        return kinetic_energy(OWN, omega, speed) + OWN.mass_kg * (velocity**2).sum(axis=1) / 2

    after = hit["omega_B"].values, hit["velocity_B"].values
    lost = energy(omega, velocity, np.full((50, 1), 300.0))
    lost -= energy(*after, hit["wheel_speed_rad_s"].values)
    assert np.all(lost > -1e-10)
    before, behind = velocity + np.cross(omega, leg), after[1] + np.cross(after[0], leg)
    if damper == 0:
        np.testing.assert_allclose(behind, -restitution * before, atol=1e-12)
    if damper == 1:
        assert np.all(hit["impulse_B"].values[:, 2] == 0)
        np.testing.assert_allclose(behind[:, :2], -restitution * before[:, :2], atol=1e-12)
    if restitution == 1 and damper == 0:
        np.testing.assert_allclose(lost, 0, atol=1e-10)
