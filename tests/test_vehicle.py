"""The vehicle and its file: what is refused, and in which words."""

import numpy as np
import pytest

import sunspin as ss

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
def test_a_good_file(tmp_path):
    vehicle = load(tmp_path, GOOD)
    assert vehicle.wheels[0].friction.coulomb_N_m == 1e-3
    assert vehicle.facts["wheel.w.inertia_kg_m2"].source == "datasheet"
    assert vehicle.facts["wheel.w.inertia_kg_m2"].sigma == 0.001
    np.testing.assert_allclose(np.linalg.norm(vehicle.wheels[0].axis_B), 1.0, rtol=1e-15)


def test_it_is_frozen(tmp_path):
    vehicle = load(tmp_path, GOOD)
    with pytest.raises(AttributeError):
        vehicle.mass_kg = 3.0
    with pytest.raises(ValueError, match="read-only"):
        vehicle.inertia_kg_m2[0, 0] = 5.0


@pytest.mark.evidence("load_vehicle", "verified", "files with one mistake each")
@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (lambda t: "", ["empty"]),
        (lambda t: t.replace("mass_kg", "mas_kg"), ["body.mas_kg", "unknown key", "mass_kg, inertia_kg_m2"]),
        (lambda t: t.replace("[1, 0, 0], [0, 2", "[1, 0.1, 0], [0, 2"), ["symmetric", "0.1"]),
        (lambda t: t.replace("[0, 0, 2.5]", "[0, 0, 5]"), ["not that of any body", "1, 2, 5"]),
        (lambda t: t.replace("[[1, 0, 0]", "[[-1, 0, 0]"), ["positive definite"]),
        (lambda t: t.replace("normal_B = [1, 0, 0]", "normal_B = [1, 0, 1]"), ["normal_B of panel 'a'", "unit vector", "1.414"]),
        (lambda t: t.replace("normal_B = [1, 0, 0]", "normal_B = [1, 0]"), ["normal_B", "three finite numbers"]),
        (lambda t: t.replace("cells = 10", "cells = -1"), ["gain of panel 'a'", "positive"]),
        (lambda t: t.replace("cells = 10", ""), ["panel 'a'", "exactly one of cells"]),
        (lambda t: t.replace("cells = 10", 'cells = "10"'), ["panel[0].cells", "a number is expected"]),
        (lambda t: t.replace("mass_kg = 10", "mass_kg = nan"), ["body.mass_kg", "finite number"]),
        (lambda t: t.replace("mass_kg = 10", "mass_kg ="), ["not valid TOML", "line"]),
        (lambda t: t.replace('name = "w"', ""), ["wheel[0].name", "missing"]),
        (lambda t: t.replace("value = 0.01", "value = 3.0"), ["axial inertia exceeds"]),
        (lambda t: t.replace("coulomb_N_m = 1e-3", "coulomb_N_m = -1e-3"), ["coulomb_N_m", "zero or positive"]),
        (lambda t: t.encode("utf-16"), ["not UTF-8"]),
        (lambda t: t + '[[sun_rule]]\nall_dark = ["z"]\nreason = "r"\n', ["does not have", "z"]),
        (lambda t: t + '[[leg]]\nname = "1"\ntip_B_m = [1, 2]\n', ["tip_B_m of leg '1'"]),
        (lambda t: t.replace('source = "datasheet"', 'source = ""'), ["source must be a text that is not empty"]),
    ],
)
def test_bad_files_are_refused_in_one_sentence(tmp_path, change, parts):
    with pytest.raises(ss.VehicleError) as error:
        load(tmp_path, change(GOOD))
    message = str(error.value)
    assert "vehicle.toml" in message and "\n" not in message
    for part in parts:
        assert part in message, message


def test_unknown_names_list_the_known_ones():
    with pytest.raises(ss.VehicleError, match="philae, skcube"):
        ss.load_vehicle("filae")


def test_a_file_needs_only_what_is_used(tmp_path):
    vehicle = load(tmp_path, 'name = "panels only"\n[[panel]]\nname = "a"\nnormal_B = [0, 0, 1]\ngain_W = 2\n')
    with pytest.raises(ss.VehicleError, match=r"inertia_kg_m2 under \[body\]"):
        ss.propagate(vehicle, [0, 0, 0.1], [1, 0, 0], None, [0.0, 1.0])
