"""Invalid times and headers: the message shows what they look like and what to write."""

from importlib import resources

import pytest

import sunspin as ss
from sunspin.telemetry.quality import _earth_light
from sunspin.vehicle.file import parse_vehicle

TEMPLATE = resources.files("sunspin").joinpath("template", "vehicle.toml").read_text("utf-8")


@pytest.mark.parametrize(
    ("time", "words"),
    [
        ("2016-12-31T23:59:60Z", "leap seconds are not known"),
        ("2016-12-31 23:59:60.25+00:00", "leap seconds are not known"),
        ("1767225600", 'if it is in seconds, set time_format = "unix"'),
        ("46023.5", 'if it is in seconds, set time_format = "unix"'),
        ("1767225600000", "Unix time in ms, us or ns, set time_format = .unix."),
        ("01.01.2026 00:00:00", "write it as 2026-01-31T23:59:59Z"),
        ("2026-01-01T00:00:00+25:00", "write it as 2026-01-31T23:59:59Z"),
        ("nan", "write it as 2026-01-31T23:59:59Z"),
    ],
)
def test_an_invalid_time_is_refused_with_the_form_to_write(tmp_path, time, words):
    file = tmp_path / "t.csv"
    file.write_text(f"time_utc,px,mx,py,my,pz\n{time},1,0,1,0,1\n")
    words = f"line 2, column 'time_utc': an ISO-8601 UTC time is expected .*{words}"
    with pytest.raises(ss.SunspinError, match=words):
        ss.read_telemetry(file, parse_vehicle(TEMPLATE, "v.toml"))


@pytest.mark.parametrize(
    "first", ["2026-01-01T00:00:00Z,0.000,0.000,1,2,3", "2026-01-01T00:00:00Z,,,1,2,3"]
)
def test_a_file_without_a_header_is_reported(tmp_path, first):
    file = tmp_path / "t.csv"
    file.write_text(f"{first}\n{first}\n")
    words = "the first row holds numbers and no names of columns"
    with pytest.raises(ss.SunspinError, match=words):
        ss.read_telemetry(file, parse_vehicle(TEMPLATE, "v.toml"))


def test_the_albedo_estimate_takes_readings_of_any_size():
    """A scale that is off by hundreds of powers of ten: squares of Python's numbers would end in an error."""
    assert _earth_light(1e200, 100, 0.0) > 1e199 and _earth_light(0.1, 100, 0.2) == 0.0
