"""Generated vehicle and telemetry files with one fault: each is refused with one sentence that names it."""

from __future__ import annotations

import random

import pytest

import sunspin as ss
from sunspin.telemetry.reader import read_telemetry
from sunspin.vehicle.file import parse_vehicle
from validation.border import CommandResult, judge, sunspin

BASE = """
name = "v"
[body]
mass_kg = {mass}
inertia_kg_m2 = {inertia}
[[panel]]
name = "+X"
normal_B = [1, 0, 0]
gain_W = {gain}
[[panel]]
name = "-X"
normal_B = [-1, 0, 0]
gain_W = 1.0
[[wheel]]
name = "w"
axis_B = [0, 0, 1]
inertia_kg_m2 = {wheel}
speed_rad_s = {speed}
[wheel.friction]
coulomb_N_m = {coulomb}
viscous_N_m_s = {viscous}
[telemetry]
noise = 0.01
[telemetry.columns]
"+X" = {x}
"-X" = {minus}
[gyro]
columns = {gyro}
scale_rad_s = 1.0
noise_rad_s = 0.001
"""
RIGHT = {
    "mass": "10.0",
    "inertia": "[[1, 0, 0], [0, 1, 0], [0, 0, 1]]",
    "gain": "1.0",
    "wheel": "0.01",
    "speed": "100.0",
    "coulomb": "1e-5",
    "viscous": "1e-6",
    "x": '"px"',
    "minus": '"mx"',
    "gyro": '["gx", "gy", "gz"]',
}
VALUES = ("mass", "gain", "wheel", "speed", "coulomb", "viscous", "inertia")
GOOD_SIGMAS = ("0", "0.5", "1e-9")
SQUARE = "[[0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]"
BAD_SIGMAS = (*"-1 -1e-9 [0.1] [] nan inf true".split(), '"0.1"', "[0.1, 0.2]")
BAD_SIGMAS += ("[[0.1, 0.2], [0.3, 0.4]]", "[[0.1], [0.2, 0.3]]", "[0.1, 0.2, 0.3]")
BAD_SIGMAS += ("[[-1, 0, 0], [0, 1, 0], [0, 0, 1]]",)


def made(**wrong: str) -> str:
    return BASE.format(**RIGHT | wrong)


def refused(text: str, *words: str) -> None:
    with pytest.raises(ss.VehicleError) as told:
        parse_vehicle(text, "v.toml")
    said = str(told.value)
    assert said.isprintable() and said.startswith("v.toml"), said
    assert all(word in said for word in words), said


@pytest.mark.parametrize("key", VALUES)
def test_a_sigma_of_another_form_than_its_value_is_refused(key):
    def with_sigma(sigma):
        return made(**{key: f"{{value = {RIGHT[key]}, sigma = {sigma}}}"})

    for sigma in (*GOOD_SIGMAS, *([SQUARE] if key == "inertia" else [])):
        parse_vehicle(with_sigma(sigma), "v.toml")
    for sigma in (*BAD_SIGMAS, *([] if key == "inertia" else [SQUARE])):
        refused(with_sigma(sigma))


def test_a_sigma_of_an_angle_in_degrees_is_refused():
    text = made().replace("normal_B = [1, 0, 0]", "normal_B = { value = [1, 0, 0], sigma = HERE }")
    assert parse_vehicle(text.replace("HERE", "1"), "v.toml").facts["panel.+X.normal_B"].sigma == 1
    words = "the sigma of panel.+X.normal_B is in rad and not above 1", "one degree is"
    refused(text.replace("HERE", "1.1"), *words)
    turned = "[panel_response]\nturned_B_rad = { value = [0, 0, 0], sigma = 5 }\n"
    refused(made() + turned, "turned_B_rad is in rad and not above 1")
    refused(made(gyro='["gx", "gy"]'), "gyro.columns: List should have at least 3 items, not 2")


def test_a_sigma_of_a_tensor_must_be_symmetric():
    """Else one half of it would be read and the other ignored."""
    rng = random.Random(3)
    for _ in range(20):
        sigma = [[0.1] * 3 for _ in range(3)]
        i, j = rng.sample(range(3), 2)
        sigma[i][j] = rng.choice([0.0, 0.2, 1e-3])
        text = made(inertia=f"{{value = {RIGHT['inertia']}, sigma = {sigma}}}")
        refused(text, "sigma of inertia_kg_m2 must be symmetric")


def test_one_column_for_two_panels_or_axes_is_refused():
    refused(made(minus='"px"'), "px", "two panels")
    refused(made(x='"time"'), "time")
    for k in range(3):
        names = ["gx", "gy", "gz"]
        names[k] = names[k - 1]
        refused(made(gyro=str(names).replace("'", '"')), "gyro.columns", "twice")


def test_column_names_with_unprintable_characters_are_refused():
    for name in ("a\\nb", "\\u0000", "a\\tb", "\\u001b[2J", "\\u202e", "\\r"):
        refused(made(x=f'"{name}"'), "printable")
        refused(made(gyro=f'["{name}", "gy", "gz"]'), "printable")


def test_a_misspelt_key_is_named_with_the_nearest_known():
    rng = random.Random(2)
    renamed = made().replace("noise_rad_s", "noise_deg_s")
    refused(renamed, "unknown key 'noise_deg_s'", "did you mean noise_rad_s?")
    keys = "scale_rad_s columns noise_rad_s gain_W speed_rad_s axis_B normal_B mass_kg coulomb_N_m"
    for key in keys.split():
        for _ in range(5):
            at = rng.randrange(len(key))
            slips = [key[:at] + "q" + key[at + 1 :], key[:at] + "q" + key[at:], f"{key}s"]
            wrong = rng.choice(slips)
            start = made().index(f"\n{key} =")
            text = made()[: start + 1] + wrong + made()[start + 1 + len(key) :]
            refused(text, f"unknown key '{wrong}'", f"did you mean {key}?")


def test_tables_with_a_shared_column_or_a_quoted_line_break_are_refused(tmp_path):
    text = made().replace('"+X" = "px"\n', '"+X" = "-X"\n').replace('"-X" = "mx"\n', "")
    craft = parse_vehicle(text, "v.toml")
    path = tmp_path / "t.csv"
    path.write_text("time,-X\n2026-01-01T00:00:00Z,1\n2026-01-01T00:00:01Z,1\n")
    with pytest.raises(ss.TelemetryError, match="two panels read one column"):
        read_telemetry(path, craft)
    craft = parse_vehicle(made(), "v.toml")
    for text in (
        'time,px,mx\n2026-01-01T00:00:00Z,"1\n2",1\n',
        'time,px,"m\nx"\n2026-01-01T00:00:00Z,1,1\n',
    ):
        path.write_text(text)
        with pytest.raises(ss.TelemetryError, match="line [12].*close the quotes"):
            read_telemetry(path, craft)
    path.write_text('time,"px","mx"\n"2026-01-01T00:00:00Z","1","2"\n')
    assert read_telemetry(path, craft)["power_W"].values.tolist() == [[1.0, 2.0]]


def test_a_grid_with_repeated_rates_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert sunspin("init", ".", "--quiet") == CommandResult(0, "", "")
    for axis in ("0,0", "0,-0.0", "0.1,0.2,0.1"):
        rates = f"--omega-x-deg-s={axis} --omega-y-deg-s=0 --omega-z-deg-s=0"
        told = sunspin("scan", "vehicle.toml", "telemetry.csv", *rates.split())
        assert judge(told).what == "refused" and "omega_x has a rate twice" in told.err


REVERSED = ('["-", "gy", "gz"]', '["gx", "-gx", "gz"]', '["-gx", "-gx", "gz"]', '["-gx"]', "true")
REVERSED += ('["-gx", "gy", "gz", "-gw"]', '"-gx,-gy,-gz"', "[-1, 2, 3]", '["-gx", 3, "gz"]')
REVERSED += ('["", "gy", "gz"]', '[["-gx"], "gy", "gz"]', '{ x = "-gx" }', '["-gx\\n", "gy", "gz"]')
REVERSED += ('["-gx\\u0000", "gy", "gz"]', f'["-{"g" * 200}", "gy", "gz"]')


@pytest.mark.parametrize(
    ("table", "more"),
    [
        ("gyro", "scale_rad_s = 1\nnoise_rad_s = 1"),
        ("magnetometer", "noise = 1"),
        ("sun_vector", "sigma_rad = 0.1"),
    ],
)
def test_invalid_columns_of_three_axes_are_refused_in_one_sentence(table, more):
    for columns in REVERSED:
        with pytest.raises(ss.VehicleError, match=rf"^v.toml[:,] {table}.columns") as told:
            parse_vehicle(f'name = "v"\n[{table}]\ncolumns = {columns}\n{more}\n', "v.toml")
        assert "\n" not in str(told.value)
