"""The vehicle and its file: what is refused, with which message."""

import pickle
from dataclasses import FrozenInstanceError, fields, replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.vehicle import SpinDown, SunRule, TelemetryForm
from sunspin.vehicle.file import parse_vehicle
from sunspin.vehicle.part import Part
from sunspin.vehicle.sensors import Clock

GOOD = """
name = "v"
[body]
mass_kg = 10
inertia_kg_m2 = [[1, 0, 0], [0, 2, 0], [0, 0, 2.5]]
[[panel]]
name = "a"
normal_B = [1, 0, 0]
cells = 10
[[wheel]]
name = "w"
axis_B = [0, 0.6, 0.8]
inertia_kg_m2 = { value = 0.01, sigma = 0.001, source = "datasheet" }
[wheel.friction]
coulomb_N_m = 1e-3
"""


def load(tmp_path, text):
    path = tmp_path / "vehicle.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return ss.load_vehicle(path)


@pytest.mark.evidence("load_vehicle", "verified", "a file with every kind of entry")
def test_a_good_vehicle_file_is_read(tmp_path):
    vehicle = load(tmp_path, GOOD)
    assert vehicle.wheels[0].friction.coulomb_N_m == 1e-3
    assert vehicle.facts["wheel.w.inertia_kg_m2"].source == "datasheet"
    assert vehicle.facts["wheel.w.inertia_kg_m2"].sigma == 0.001
    np.testing.assert_allclose(np.linalg.norm(vehicle.wheels[0].axis_B), 1.0, rtol=1e-15)


SPIN_DOWN = "spin_down = { c1_rad_s = 1, c2_per_s = -1, c3_rad_s = -1 }\n"
GYRO = '[gyro]\ncolumns = ["x", "y", "z"]\nscale_rad_s = 1\nnoise_rad_s = 1\nzero_sigma = 1\n'
CLOCK = "[clock]\nsensors_late_s = { value = 1, sigma = -1 }\n"
KNOWN = "known keys: columns, scale_rad_s, zero, noise_rad_s, wraps_at"


@pytest.mark.evidence("load_vehicle", "verified", "files with one mistake each")
@pytest.mark.parametrize(
    ("old", "new", "parts"),  # without an old part the new one is added, or is the file
    [
        (None, "", ["empty"]),
        (None, GOOD.encode("utf-16")[:-1], ["not UTF-16"]),
        ("mass_kg", "mas_kg", ["body.mas_kg", "unknown key", "mass_kg, inertia_kg_m2"]),
        ("[1, 0, 0], [0, 2", "[1, 0.1, 0], [0, 2", ["symmetric", "0.1"]),
        ("[0, 0, 2.5]", "[0, 0, 5]", ["not that of any body", "1, 2, 5"]),
        ("[[1, 0, 0]", "[[-1, 0, 0]", ["positive definite"]),
        ("[body]", "max_rate_rad_s = 1\n[body]", ["max_rate_rad_s belongs under [disturbance]"]),
        ("[body]", "tip_B_m = 1\n[body]", ["tip_B_m belongs under [[leg]]"]),
        ("= [1, 0, 0]", "= [1, 0, 1]", ["normal_B of panel 'a'", "unit vector", "1.414"]),
        ("= [1, 0, 0]", "= [1, 0]", ["normal_B", "three finite numbers"]),
        ("= [1, 0, 0]", "= [1, [0], 0]", ["normal_B of panel 'a'", "three finite numbers"]),
        ("cells = 10", "cells = -1", ["gain of panel 'a'", "positive"]),
        ("cells = 10", "", ["panel 'a'", "exactly one of cells"]),
        ("cells = 10", 'cells = "10"', ["panel[0].cells", "a number is expected"]),
        ("mass_kg = 10", "mass_kg = nan", ["body.mass_kg", "finite number"]),
        ("mass_kg = 10", "mass_kg =", ["not valid TOML", "line"]),
        ('name = "w"', "", ["wheel[0].name", "missing"]),
        ("value = 0.01", "value = 3.0", ["axial inertia exceeds"]),
        ("= 1e-3", "= -1e-3", ["coulomb_N_m", "zero or positive"]),
        ("", '[[sun_rule]]\nall_dark = ["z"]\nreason = "r"\n', ["does not have", "z"]),
        ("", '[[leg]]\nname = "1"\ntip_B_m = [1, 2]\n', ["tip_B_m of leg '1'"]),
        ('"datasheet"', '""', ["source must be a text that is not empty"]),
        # names of Python as keys, tables of another kind
        ("cells", "gain", ["panel[0].gain", "unknown key", "name, normal_B, cells, relative_gain"]),
        ("cells", "cels", ["panel[0].cels", "unknown key"]),
        ("cells = 10", "cells = 10\ngain_W = 2", ["exactly one of cells", "cells, gain_W"]),
        ("", SPIN_DOWN, ["wheel.w.friction gives both a spin_down"]),
        ("", "[telemetry]\nnoise = 0\n", ["telemetry.noise must be positive (found 0.0)"]),
        ("", GYRO, ["gyro.zero_sigma", KNOWN]),
        ("", CLOCK, ["the sigma of clock.sensors_late_s"]),
        ("[[panel]]", "[panel]", ["panel: should be a valid list"]),
        ("[body]", "[[body]]", ["body: should be a table"]),
    ],
)
def test_bad_vehicle_files_are_refused_in_one_sentence(tmp_path, old, new, parts):
    with pytest.raises(ss.VehicleError) as error:
        load(tmp_path, new if old is None else GOOD.replace(old, new) if old else GOOD + new)
    message = str(error.value)
    assert "vehicle.toml" in message and "\n" not in message
    for part in parts:
        assert part in message, message


PANEL, WHEEL = ss.Panel("a", [1, 0, 0], 2.0), ss.Wheel("w", [0, 0, 1], 0.01)
CRAFT = ss.Vehicle("v", np.diag([1.0, 2.0, 2.5]), 10.0, panels=[PANEL], wheels=[WHEEL])
FORM = CRAFT.telemetry


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: replace(CRAFT, mass_kg=-1), "mass_kg must be positive (found -1.0)"),
        (lambda: replace(CRAFT, inertia_kg_m2=np.diag([1, 2, 9])), "not that of any body"),
        (lambda: replace(CRAFT, panels=[PANEL, PANEL]), "two panels share the name 'a'"),
        (lambda: replace(CRAFT, panels=[3]), "panels[0]: should be an instance of Panel (found 3)"),
        (lambda: replace(CRAFT, mass="3"), "Vehicle, mass: unknown key 'mass'; known keys: name, "),
        (lambda: replace(PANEL, gain=0.0), "the gain of panel 'a' must be positive"),
        (lambda: replace(PANEL, gain="2"), "Panel, gain: a number is expected, not '2'"),
        (lambda: replace(WHEEL, inertia_kg_m2=np.nan), "must be positive (found nan)"),
        (lambda: replace(FORM, noise=-0.1), "TelemetryForm.noise must be positive (found -0.1)"),
        (
            lambda: replace(FORM, quantity="power"),
            "TelemetryForm, quantity: should be 'power_W', '",
        ),
        (lambda: ss.Panel("a", [1, 0, 0]), "Panel, gain: this key is missing"),
        (lambda: SunRule([], "r"), "SunRule, all_dark: List should have at least 1 item"),
    ],
)
def test_vehicles_made_or_changed_in_python_pass_the_checks_of_a_file(make, said):
    with pytest.raises(ss.VehicleError) as error:
        make()
    assert said in str(error.value) and "\n" not in str(error.value)


def test_vehicle_parts_are_compared_and_hashed_by_content():
    for name in ("philae", "skcube"):
        one, two = ss.load_vehicle(name), ss.load_vehicle(name)
        other = pickle.loads(pickle.dumps(one))
        assert one == two == other and len({one, two}) == 1
        with pytest.raises(ValueError, match="read-only"):
            other.panels[0].normal_B[0] = 1.0
        with pytest.raises(TypeError):
            other.facts["x"] = 1
        assert replace(one, name="other") != one
    assert replace(PANEL, normal_B=[0, 1, 0]) != PANEL == ss.Panel("a", np.array([1.0, 0, 0]), 2)
    assert PANEL != 3


def test_every_vehicle_part_is_frozen():
    kinds, waiting = [], [Part]
    while waiting:
        kinds += (found := waiting.pop().__subclasses__())
        waiting += found
    assert {ss.Vehicle, ss.Panel, ss.Wheel, TelemetryForm} <= set(kinds)
    for kind in kinds:
        with pytest.raises(FrozenInstanceError):
            setattr(object.__new__(kind), fields(kind)[0].name, None)


def test_a_spin_down_gives_the_wheel_its_friction():
    measured = SpinDown(1271.0, -4.643e-4, -388.9)
    wheel = ss.Wheel("w", [0, 0, 1], 0.0058, friction=ss.Friction(spin_down=measured))
    assert wheel.friction == ss.Friction.from_spin_down(1271.0, -4.643e-4, -388.9, 0.0058)
    assert wheel.friction == ss.load_vehicle("philae").wheels[0].friction


def test_a_vehicle_file_needs_only_what_is_used(tmp_path):
    """Unknown names of a vehicle are refused with the known ones."""
    panel = '[[panel]]\nname = "a"\nnormal_B = [0, 0, 1]\ngain_W = 2\n'
    vehicle = load(tmp_path, f'name = "panels only"\n{panel}')
    with pytest.raises(ss.VehicleError, match=r"inertia_kg_m2 under \[body\]"):
        ss.propagate(vehicle, [0, 0, 0.1], [1, 0, 0], None, [0.0, 1.0])
    with pytest.raises(ss.VehicleError, match="philae, skcube"):
        ss.load_vehicle("filae")
    offset = '{ value = 1.5, sigma = 2.0, source = "guess" }'
    stated = f'name = "a"\n[clock]\nsensors_late_s = {offset}\n'
    assert parse_vehicle(stated, "a").sensors.clock == Clock(1.5, 2.0)
