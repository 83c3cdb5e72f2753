"""Numbers from files and options are plain decimals in ASCII digits; other forms that Python reads are refused."""

import math
import re
from functools import partial

import numpy as np
import pytest

import sunspin as ss
from sunspin.base.errors import InputError, TelemetryError, VehicleError
from sunspin.base.untrusted import plain_number
from sunspin.cli import values
from sunspin.environment.elements import parse_elements
from sunspin.environment.ephemeris import read_orbit
from sunspin.landing.scenario import parse_strategy
from sunspin.vehicle.changes import parse_changes
from sunspin.vehicle.file import parse_vehicle
from tests.support.orbits import with_check_digit

SCRIPTS = (0x660, 0x6F0, 0x966, 0xFF10, 0x1D7CE)
"""Where other scripts have their zero."""


def plain(rng: np.random.Generator) -> str:
    """A plain decimal, in one of the ways in which people write it."""
    size = f"{rng.uniform(0, 100):.{rng.integers(0, 9)}f}"
    forms = [size, size + "e-3", size + "E+2", str(rng.integers(0, 10**6))]
    forms += [f"{rng.integers(0, 9)}.", f".{rng.integers(0, 99)}"]
    return str(rng.choice(["", "", "-", "+"])) + str(rng.choice(np.array(forms, dtype=object)))


def strange(text: str, rng: np.random.Generator) -> str:
    """The same number in a form that is none."""
    digits = [i for i, c in enumerate(text) if c.isdigit()]
    at, zero = int(rng.choice(digits)), int(rng.choice(SCRIPTS))
    head, tail = text[: at + 1], text[at + 1 :]
    forms = [f"{head}_0{tail}", head[:-1] + chr(zero + int(text[at])) + tail, f"{head} 1{tail}"]
    forms += [text.replace("-", "\u2212") if "-" in text else f"\u2212{text}", f"0x{digits[0]}f"]
    forms += ["", " ", *"inf -inf nan Infinity 1e400 --1 1e e5 1.2.3 True".split()]
    forms += [f"{text} W", f"\u00a0{text}", f"{text}j"]
    return str(rng.choice(np.array(forms, dtype=object)))


def test_plain_decimals_are_read_and_no_others():
    rng = np.random.default_rng(1)
    for _ in range(1000):
        text = plain(rng)
        odd = strange(text, rng)
        assert plain_number(text) == plain_number(f" {text}\t") == float(text)
        assert math.isnan(plain_number(odd)), odd


VEHICLE = """
name = "two"
[gyro]
columns = ["gx", "gy", "gz"]
noise_rad_s = 0.001
scale_rad_s = 1
[[panel]]
name = "a"
normal_B = [1, 0, 0]
gain_W = 1
[[panel]]
name = "b"
normal_B = [0, 1, 0]
gain_W = 1
[telemetry]
time_format = "elapsed"
time_column = "t"
epoch_utc = "2026-01-01T00:00:00Z"
columns = { a = "a", b = "b" }
bad_rows = "flag"
"""


def read(folder, cells, mark=","):
    table = folder / "t.csv"
    head = ["t", "a", "b", "gx", "gy", "gz"]
    table.write_text("\n".join(mark.join(row) for row in [head, *cells]) + "\n", "utf-8")
    return ss.read_telemetry(table, parse_vehicle(VEHICLE, "v.toml"))


@pytest.mark.parametrize("seed", range(6))
def test_a_cell_that_is_no_plain_decimal_is_no_reading(seed, tmp_path):
    rng = np.random.default_rng(seed)
    cells = [[str(10 * i), *(f"{v:.4f}" for v in rng.uniform(0.1, 0.9, 5))] for i in range(4)]
    row, column = int(rng.integers(1, 4)), int(rng.integers(1, 6))
    assert not read(tmp_path, cells)["flag"].values.any()  # the right file first
    cells[row][column] = strange(cells[row][column], rng)
    data = read(tmp_path, cells)
    seen = np.column_stack([data["power_W"].values, data["gyro_B"].values])
    assert np.isnan(seen[row, column - 1])
    assert np.isfinite(np.delete(seen.ravel(), 5 * row + column - 1)).all()
    assert bool(data["flag"].values[row]) == (column < 3)
    cells[0][0] = strange("10", rng)
    with pytest.raises(TelemetryError, match="line 2, column 't'"):
        read(tmp_path, cells)


@pytest.mark.parametrize("column", [1, 3])
def test_a_number_in_another_notation_gets_a_message_on_notation(column, tmp_path):
    """A damaged cell is flagged; a decimal comma or a column without a number is the file's way: no sensor is lost in silence."""
    rows = [[str(10 * i), "0.5", "0.25", "0.1", "0.2", "0.3"] for i in range(3)]

    def changed(cells, mark="\t"):
        pairs = zip(rows, cells, strict=True)
        return read(tmp_path, [[*r[:column], cell, *r[column + 1 :]] for r, cell in pairs], mark)

    name = ["t", "a", "b", "gx"][column]
    for cell in ("0,5", "-,5", "1,5e-3"):
        words = rf"line 3, column '{name}': the number has a decimal comma .*{cell}.*point"
        with pytest.raises(TelemetryError, match=words):
            changed(["1", cell, "0.5"])
    for cell in (
        "12 345.5",
        "12.345.678",
        "12'345",
        "12\u202f345,5",
    ):  # only large numbers have them
        words = rf"line 3, column '{name}': the number has a thousands separator .found {cell[:2]}"
        for mark in "\t;":
            with pytest.raises(TelemetryError, match=words):
                changed(["1", cell, "0.5"], mark)
    for cells, mark in ((["88", "1,234", "2,345"], ";"), (["8.5", "1,234", "2,345"], "\t")):
        words = rf"line 3, column '{name}': the number has a decimal comma or a thousands separator"
        with pytest.raises(TelemetryError, match=words):
            changed(cells, mark)
    for cell in ("1_000", "\u0663", "0x10", "0.5 W", "1 e5"):
        words = rf"line 2, column '{name}': no cell of this column is a number \(found {cell}"
        with pytest.raises(TelemetryError, match=words):
            changed([cell] * 3)
        changed([cell, "0.5", cell])  # one number is enough for the others to be damaged
    for cell in ("", "nan", "N/A", "--", "off"):
        changed([cell] * 3)  # a sensor that is off
    comma = changed(["0,5", "1,5e-1", "2"], ";")
    assert comma["power_W"].values[1, 0] == (0.15 if column == 1 else 0.5)
    comma = changed(["0,5", "0,150", "2"])
    assert comma["power_W"].values[1, 0] == (0.15 if column == 1 else 0.5)


def test_options_and_changes_of_values_accept_the_same_numbers():
    rng, words = np.random.default_rng(0), ("", "True", "nan", "inf", "-inf")
    for _ in range(16):
        good = plain(rng)
        while (odd := strange(good, rng)) in words or odd != odd.strip():
            pass
        assert values.parse_numbers(f"1,{good}", "--omega-deg-s") == [1, float(good)]
        for read, wrong in (
            (partial(values.parse_numbers, name="--omega-deg-s"), f"1,{odd}"),
            (partial(parse_strategy, ss.Vehicle("any")), f"delay:{odd}"),
            (partial(values.parse_period, epoch_utc=None), f"{odd}+-1@10"),
            (partial(values.parse_prior, name="--prior"), f"inertia={odd}"),
            (partial(values.parse_grid, name="--omega-x-deg-s"), f"0:1:{odd}"),
            (partial(values.parse_times, epoch_utc=None), odd),
        ):
            with pytest.raises(InputError):
                read(wrong)


@pytest.mark.parametrize(
    "value", ["1_000", "0x10", "0o7", "0b1", "inf", "-nan", "[1, 1_0]", "[[1, 0, 0], [0, 0x1, 0]]"]
)
def test_a_changed_value_is_written_as_a_plain_decimal(value):
    with pytest.raises(VehicleError, match="number"):
        ss.load_vehicle("philae", [f"body.mass_kg={value}"])
    read = parse_changes(["a=-1.5e-3", "b=[1, 2.5, 3e2]", "c=+2.5", "d=_x", 'e=["a_b", "0x1"]'])
    assert [each.value for each in read] == [-1.5e-3, [1, 2.5, 300.0], 2.5, "_x", ["a_b", "0x1"]]


LINES = """1 25544U 98067A   26001.50000000  .00001000  00000-0  10000-3 0  9990
2 25544  51.6400 100.0000 0001000 100.0000 100.0000 15.50000000    10"""


def test_two_line_elements_with_other_characters_are_read_or_refused_in_one_sentence():
    """SGP4's own reader takes `1 5` for 1, and Python's `isdigit` a small ² for a digit."""
    rng = np.random.default_rng(0)
    first, second = (with_check_digit(line) for line in LINES.splitlines())
    assert len(parse_elements(f"{first}\n{second}", "x")) == 1
    for _ in range(1000):
        lines = [first, second]
        which, at = int(rng.integers(2)), int(rng.integers(2, 68))
        odd = str(rng.choice(list(" _.-+eE0\u00b2\u0663\uff11\u00e9x\u00a0,")))
        lines[which] = with_check_digit(lines[which][:at] + odd + lines[which][at + 1 :])
        try:
            (found,) = parse_elements("\n".join(lines), "x")
        except InputError as error:
            assert str(error).isprintable()
        else:
            assert "\n".join(found.given).isascii()
            angles = [lines[1][at : at + 8] for at in (8, 17, 34, 43)]
            for field in (*angles, lines[1][52:63], lines[0][20:32]):
                assert re.fullmatch(r" *\d+\.\d+", field)
    blank_inside = with_check_digit(second.replace(" 51.6400", "5 1.6400"))
    with pytest.raises(InputError, match="columns are not those"):
        parse_elements(f"{first}\n{blank_inside}", "x")


ROWS = [
    f"2026-01-01T00:{m:02d}:00Z,{7000 * math.cos(m / 16):.6f},{7000 * math.sin(m / 16):.6f},0"
    for m in range(20)
]


@pytest.mark.parametrize("cell", ["1_0", "\u0663", "inf", "nan", "", "0x10", "1 0", "x"])
def test_a_coordinate_that_is_no_plain_decimal_is_refused(cell, tmp_path):
    def ephemeris(rows):
        head = ["# frame: J2000", "time_utc,x_km,y_km,z_km"]
        (tmp_path / "e.csv").write_text("\n".join([*head, *rows]) + "\n", "utf-8")
        return read_orbit(tmp_path / "e.csv")

    assert ephemeris(ROWS)
    with pytest.raises(InputError, match="coordinate of the ephemeris"):
        ephemeris([*ROWS[:9], ROWS[9].rpartition(",")[0] + f",{cell}", *ROWS[10:]])
    times = "now today NaT 2026 2026-000T00:00:00 2026-999T00:00:00 \u0662026-01-01".split()
    for time in (*times, "9" * 30):
        with pytest.raises(InputError, match="time"):
            ephemeris([*ROWS[:9], time + "," + ROWS[9].partition(",")[2], *ROWS[10:]])
