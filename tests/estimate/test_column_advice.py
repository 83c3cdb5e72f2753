"""Each advice on columns, signs and axes is followed to the letter in the vehicle file, and has the promised effect."""

import json
import re
import tomllib
from dataclasses import replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.cli.rates import SENSOR_VARIABLES
from sunspin.estimate.column_tests import (
    SENSOR_NAMES,
    BetterChanges,
    ChangeWithRate,
    ContradictingSensor,
    changes_of_sensor,
)
from sunspin.estimate.equivalence import exchange, wheel_changes
from sunspin.estimate.gyro_axes import wrong_gyro_axes
from sunspin.estimate.observe import wheel_models
from sunspin.estimate.rates import rates
from sunspin.estimate.verdict import COLUMNS_UNCHECKED
from sunspin.telemetry.assess import assess
from sunspin.vehicle import Channel, TelemetryForm
from sunspin.vehicle.file import parse_vehicle
from tests.support.passes import printed_rates
from tests.support.simulate import simulated_pass, telemetry_of, uneven_times
from tests.support.vehicles import CUBE_NORMALS

NAMES = ("px", "py", "pz", "mx", "my", "mz")
TEXT = """
name = "cube"
[body]
inertia_kg_m2 = [[0.042, 0, 0], [0, 0.05, 0], [0, 0, 0.03]]
{panels}
[telemetry]
noise = 0.01
[telemetry.columns]
{columns}
"""
OMEGA = np.array([0.02, -0.03, 0.04])
LIMIT = {"max_rate_rad_s": 0.15}


def text_of(columns=NAMES) -> str:
    """Return a vehicle file with six panels of 1 W, the column of each named after the panel of its light."""
    panels = "\n".join(
        f'[[panel]]\nname = "{name}"\nnormal_B = {normal.astype(int).tolist()}\ngain_W = 1.0'
        for name, normal in zip(NAMES, CUBE_NORMALS, strict=True)
    )
    lines = "\n".join(f'{name} = "I_{column}"' for name, column in zip(NAMES, columns, strict=True))
    return TEXT.format(panels=panels, columns=lines)


def written(path, data):
    """Write telemetry to a CSV file of this path, and return the path."""
    start = np.datetime64("2026-01-01T00:00:00.000")
    extra = ["gx", "gy", "gz"] if "gyro_B" in data else []
    lines = ["time," + ",".join([*(f"I_{name}" for name in NAMES), *extra])]
    values = data["power_W"].values
    if extra:
        values = np.concatenate([values, data["gyro_B"].values], axis=1)
    for t, row in zip(data["time"].values, values, strict=True):
        stamp = start + np.timedelta64(round(1000 * t), "ms")
        lines.append(f"{stamp}Z," + ",".join(f"{value:.6f}" for value in row))
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return path


@pytest.fixture(scope="module")
def readings(tmp_path_factory):
    """Return a telemetry file of the cube, and the truth."""
    rng = np.random.default_rng(4)
    craft = parse_vehicle(text_of(), "right")
    data, run = simulated_pass(craft, OMEGA, uneven_times(rng, 24, 12.0, 0.2), rng, albedo=0.0)
    return written(tmp_path_factory.mktemp("advice") / "telemetry.csv", data), run


def estimated(text: str, path, **options):
    """Return the estimate of a vehicle file with a telemetry file."""
    vehicle = parse_vehicle(text, "vehicle.toml")
    return rates(vehicle, ss.read_telemetry(path, vehicle), **LIMIT | options)


def assert_printed(result, deg_s, atol: float) -> None:
    """Check that the first pass is estimated with this rate (3), deg/s."""
    np.testing.assert_allclose(np.degrees(printed_rates(result)[0][0]), deg_s, atol=atol)


def assert_mended(result, deg_s, atol: float = 1e-3) -> None:
    """Check that the first pass is decided with this rate (3), deg/s, and that no column is doubted."""
    assert result["decided"].values.all() and "columns_doubt" not in result.attrs
    assert_printed(result, deg_s, atol)


def pair_exchanged(a: str, b: str) -> str:
    return f"the columns of panels {a} and {b} exchanged"


def with_columns_exchanged(text: str, advice: str) -> str:
    """Return a vehicle file in which the columns are exchanged that an advice names."""
    asked = r"exchange the columns of (\w+) and (\w+) under \[telemetry\.columns\]"
    match = re.search(asked, advice)
    assert match is not None, advice
    column = tomllib.loads(text)["telemetry"]["columns"]
    for name, other in (match.groups(), match.groups()[::-1]):
        line = f'\n{name} = "{column[name]}"'
        assert text.count(line) == 1
        text = text.replace(line, f'\n{name} = "<{column[other]}>"')
    return text.replace('"<', '"').replace('>"', '"')


def test_columns_exchanged_as_advised_give_the_named_rate(readings):
    path, run = readings
    text = text_of(("py", "px", *NAMES[2:]))
    doubted = estimated(text, path)
    advice = re.search(r"CHECK THE COLUMNS; if it is so, (.*)", doubted.attrs["verdict"])
    assert advice is not None and not doubted["decided"].values.any()
    assert doubted["columns_checked"].values.tolist() == ["doubtful"]
    assert "columns, signs or axes" in str(doubted["why_not_decided"].values[0])
    (named,) = json.loads(doubted.attrs["columns_changes"])
    assert named["do"] == advice[1]
    assert_mended(estimated(with_columns_exchanged(text, advice[1]), path), named["omega_deg_s"])
    true = np.degrees(run["omega_B"].sel(time=named["at_s"], method="nearest").values)
    np.testing.assert_allclose(named["omega_deg_s"], true, atol=0.1)


def test_a_panel_reversed_as_advised_gives_a_decided_pass(readings):
    path, _ = readings
    text = text_of().replace("[0, 1, 0]", "[0, -1, 0]", 1)
    doubted = estimated(text, path)
    changes = {one["what"]: one for one in json.loads(doubted.attrs["columns_changes"])}
    named = changes["panel py looking the other way"]
    assert named["do"] == "reverse normal_B of panel py" and not doubted["decided"].values.any()
    mended = estimated(text.replace("[0, -1, 0]", "[0, 1, 0]", 1), path)
    assert_mended(mended, named["omega_deg_s"])


def test_unchecked_columns_exchanged_give_the_rate_that_is_printed(readings):
    """A cube and its mirror images read the same: each line says what the rate would be."""
    from sunspin.output.kinds.rates import rates_summary

    path, _ = readings
    result = estimated(text_of(), path)
    words = "\n".join(rates_summary(result).lines)
    assert result["decided"].values.all() and "columns_doubt" not in result.attrs
    assert result["columns_checked"].values.tolist() == [COLUMNS_UNCHECKED]
    unseen = json.loads(result.attrs["columns_unseen"])
    pairs = (("px", "mx"), ("py", "my"), ("pz", "mz"))
    assert [one["what"] for one in unseen] == [pair_exchanged(*pair) for pair in pairs]
    for change in unseen:
        pattern = re.escape(f"with {change['what']} it would be ") + r"\(([^)]*)\)"
        match = re.search(pattern, words)
        assert match is not None, words
        advice = change["what"].replace("the columns of panels", "exchange the columns of")
        advice = advice.replace("exchanged", "under [telemetry.columns]")
        exchanged = with_columns_exchanged(text_of(), advice)
        mirrored = estimated(exchanged, path, column_tests=False)
        assert_printed(mirrored, [float(number) for number in match[1].split(",")], atol=0.01)


def test_more_effort_as_advised_tries_every_order_of_columns(readings):
    path, _ = readings
    text = text_of(("py", "px", *NAMES[2:]))
    cut = estimated(text, path, effort=1e-6)
    asked = r"not every other order of columns was tried: give more effort \(`--effort ([\d.]+)`\)"
    match = re.search(asked, cut.attrs["verdict"])
    assert match is not None and cut.attrs["column_tests_cut"] == 1
    done = estimated(text, path, effort=float(match[1]))
    assert done.attrs["column_tests_cut"] == 0 and "not every other" not in done.attrs["verdict"]
    assert "px and py exchanged" in done.attrs["verdict"]


@pytest.mark.parametrize("key", ["axis_B", "speed_rad_s", "speed_scale_rad_s"])
def test_the_opposite_sign_of_each_key_that_is_named_reverses_the_wheel(key):
    """The advice is "look at the signs of its axis_B, speed_rad_s and speed_scale_rad_s"."""
    wheel = {"axis_B": [0.0, 0.6, 0.8], "speed_rad_s": 40.0, "speed_scale_rad_s": 0.5}
    if key == "speed_scale_rad_s":  # of a column; else the speed is nominal
        wheel["speed_column"] = "rpm"
    else:
        del wheel["speed_scale_rad_s"]

    def momentum(values: dict, change=None) -> np.ndarray:
        lines = "\n".join(f"{name} = {json.dumps(value)}" for name, value in values.items())
        text = f'{text_of()}[[wheel]]\nname = "w"\ninertia_kg_m2 = 3e-4\n{lines}\n'
        vehicle = parse_vehicle(text, "vehicle.toml")
        data = telemetry_of(vehicle, np.arange(3.0), np.ones((3, 6)))
        if "speed_column" in values:  # which reads 80
            speed = vehicle.wheels[0].speed_scale_rad_s * np.full((3, 1), 80.0)
            data = data.assign(wheel_speed_rad_s=(("time", "wheel"), speed))
        if change is not None:
            vehicle, data = change(vehicle).applied(vehicle, data)
        return next(iter(wheel_models(vehicle, data).values()))

    as_named = momentum(wheel, lambda vehicle: wheel_changes(vehicle)[0])
    value = wheel[key]
    other = [-one for one in value] if isinstance(value, list) else -value
    assert np.abs(as_named).max() > 0
    np.testing.assert_allclose(momentum(wheel | {key: other}), as_named, atol=1e-15)


def test_the_advice_for_exchanged_columns_and_a_reversed_wheel_is_to_change_both():
    vehicle = parse_vehicle(text_of() + WHEEL.format(sign=""), "vehicle.toml")
    both = exchange(vehicle, 0, 4).with_wheels((0,), ["w"])
    words = BetterChanges((ChangeWithRate(both),), 20.0).words()
    advice = words.partition("if it is so, ")[2]
    exchanged = tomllib.loads(with_columns_exchanged(text_of(), advice))["telemetry"]["columns"]
    assert (exchanged["px"], exchanged["my"]) == ("I_my", "I_px")
    assert "look at the signs of axis_B, speed_rad_s and speed_scale_rad_s of w" in advice


@pytest.mark.parametrize("name", SENSOR_NAMES)
def test_each_sensor_in_the_way_is_named_by_the_option_that_leaves_it_out(name):
    match = re.search(r"`--without (\w+)`", ContradictingSensor(SENSOR_NAMES[name]).words())
    assert match is not None and SENSOR_VARIABLES[match[1]] == name


ATTITUDE = """
[attitude]
columns = ["qa", "qb", "qc", "qd"]
scalar = "{scalar}"
rotates = "{rotates}"
sigma_rad = 0.01
"""


@pytest.mark.parametrize("scalar", ["first", "last"])
@pytest.mark.parametrize("rotates", ["N_to_B", "B_to_N"])
def test_a_quaternion_read_as_advised_is_the_one_that_was_meant(scalar, rotates):
    text = text_of() + ATTITUDE.format(scalar=scalar, rotates=rotates)
    vehicle = parse_vehicle(text, "vehicle.toml")
    raw = np.random.default_rng(3).normal(size=(5, 4))
    raw /= np.linalg.norm(raw, axis=1, keepdims=True)
    read = vehicle.sensors.attitude.interpret(raw).values
    ways = changes_of_sensor(vehicle, "attitude_B_from_N")
    for way in ways[1:]:  # the first is that of the file
        match = re.fullmatch(r"set (.*) under \[attitude\] of the vehicle file", way.do)
        assert match is not None, way.do
        changed = text
        for line in match[1].split(" and "):
            key = line.split(" = ")[0]
            changed, count = re.subn(rf"(?m)^{key} = .*$", line, changed)
            assert count == 1
        sensor = parse_vehicle(changed, "vehicle.toml").sensors.attitude
        meant = read @ way.axes["attitude_B_from_N"].T
        np.testing.assert_allclose(sensor.interpret(raw).values, meant, atol=1e-12)


WHEEL = """
[[wheel]]
name = "w"
axis_B = [0, {sign}1, 0]
inertia_kg_m2 = 3e-4
speed_rad_s = 40.0
"""


@pytest.mark.slow
def test_each_of_several_changes_gives_the_rate_that_is_printed_with_it(tmp_path):
    """Mirrors along x and z reverse the wheel too; the advice is to find out which is right before the file is changed."""
    rng = np.random.default_rng(2)
    right = parse_vehicle(text_of() + WHEEL.format(sign=""), "right")
    t_s, omega = np.arange(20) * 10.0, [0.02, 0.03, -0.01]
    data, run = simulated_pass(right, omega, t_s, rng, albedo=0.0, speed=[40.0])
    path = written(tmp_path / "telemetry.csv", data)
    wrong = text_of() + WHEEL.format(sign="-")
    limit = {"max_rate_rad_s": 0.06, "column_tests": False}
    doubted = estimated(wrong, path, **limit)
    named = json.loads(doubted.attrs["columns_changes"])
    assert not doubted["decided"].values.any() and doubted["columns_checked"].values == "doubtful"
    assert "the sign of a wheel" in doubted["why_not_decided"].values[0]
    rate = {change["what"]: change["omega_deg_s"] for change in named}
    wheel, mirrored = "wheel w turning the other way", pair_exchanged("px", "mx")
    assert set(rate) == {wheel, mirrored, pair_exchanged("pz", "mz")}
    assert "find out which one is right" in doubted.attrs["verdict"]
    truth = np.degrees(run["omega_B"].values[9:11])
    assert np.abs(truth - rate[wheel]).max(axis=1).min() < 0.5
    np.testing.assert_allclose(rate[mirrored], rate[wheel] * np.array([1, -1, -1]), atol=1e-6)
    for change in named:
        mended = text_of() + WHEEL.format(sign="")
        if "wheel" not in change["what"]:
            mended = with_columns_exchanged(wrong, change["do"])
        assert_mended(estimated(mended, path, **limit), change["omega_deg_s"], atol=0.05)


GYRO = """
[gyro]
columns = ["gx", "gy", "gz"]
scale_rad_s = 1.0
noise_rad_s = 5e-4
zero = { value = [0, 0, 0], sigma = 1e-4 }
"""


@pytest.fixture(scope="module")
def with_gyro(tmp_path_factory):
    """Return a telemetry file of the cube with a gyro."""
    rng = np.random.default_rng(4)
    craft = parse_vehicle(text_of(), "right")
    data, run = simulated_pass(craft, OMEGA, uneven_times(rng, 40, 8.0, 0.2), rng, albedo=0.0)
    read = run["omega_B"].values + 5e-4 * rng.normal(size=(40, 3))
    data = data.assign(gyro_B=(("time", "axis"), read))
    return written(tmp_path_factory.mktemp("gyro") / "telemetry.csv", data)


def test_a_gyro_read_as_check_advises_or_the_columns_exchanged_instead_remove_the_warning(
    with_gyro,
):
    """With +x and -x exchanged a right gyro seems to have y and z reversed: either change makes both agree."""

    def warned(text: str) -> str | None:
        vehicle = parse_vehicle(text, "vehicle.toml")
        return wrong_gyro_axes(assess(vehicle, ss.read_telemetry(with_gyro, vehicle)))

    text = text_of(("mx", *NAMES[1:3], "px", *NAMES[4:])) + GYRO
    words = warned(text)
    assert words is not None and "find out which before you set it" in words
    match = re.search(r"set (columns = \[.*?\]) under \[gyro\]", words)
    assert match is not None, words
    assert warned(text.replace('columns = ["gx", "gy", "gz"]', match[1])) is None
    alike = r"which looks the same, the columns of panels (\w+) and (\w+) exch"
    exchanged = re.search(alike, words)
    assert exchanged is not None, words
    advice = "exchange the columns of {} and {} under [telemetry.columns]"
    assert warned(with_columns_exchanged(text, advice.format(*exchanged.groups()))) is None


def test_a_gyro_resolves_the_symmetric_solutions_of_a_shared_input(with_gyro):
    """The advice of panels that share an input: "A gyro, magnetometer or Sun sensor resolves this"."""
    vehicle = parse_vehicle(text_of() + GYRO, "vehicle.toml")
    data = ss.read_telemetry(with_gyro, vehicle)
    channels = (Channel("x", ("px", "mx"), "sum"),)
    craft = replace(vehicle, channels=channels, telemetry=TelemetryForm(noise=0.01))
    power = data["power_W"].values
    summed = np.column_stack([power[:, 0] + power[:, 3], power[:, [1, 2, 4, 5]]])
    of_inputs = data.drop_dims("panel").assign_coords(panel=list(craft.input_names))
    of_inputs = of_inputs.assign(power_W=(("time", "panel"), summed))
    alone = rates(craft, of_inputs.drop_vars("gyro_B"), max_rate_rad_s=0.15)
    assert "A gyro, magnetometer or Sun sensor resolves this" in alone.attrs["verdict"]
    assert not alone["unique"].values.any()
    resolved = rates(craft, of_inputs, max_rate_rad_s=0.15)
    assert resolved["decided"].values.all()
