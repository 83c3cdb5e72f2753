"""Clocks: restarted uptime, clocks set back, time zones, GPS time and TAI, leap seconds, reset clocks."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo

import erfa
import numpy as np
import pytest
import xarray as xr

import sunspin as ss
from sunspin.base.errors import TelemetryError
from sunspin.output.text import start_texts
from sunspin.telemetry import restarts
from sunspin.telemetry.dates import rewrite_date
from sunspin.telemetry.times import parse_utc
from sunspin.telemetry.timescales import leap_seconds_between, tai_ahead, utc_of_tai
from sunspin.vehicle.craft import LOCAL_FORMATS
from sunspin.vehicle.file import parse_vehicle

VEHICLE = """
name = "two panels"
panel = [
    {{name = "a", normal_B = [1, 0, 0], gain_W = 2}},
    {{name = "b", normal_B = [0, 1, 0], gain_W = 2}},
]
[telemetry]
columns = {{a = "{a}", b = "pb"}}
time_column = "{time_column}"
bad_rows = "{bad_rows}"
{form}
"""
UPTIME = 'time_format = "elapsed"\nreceive_time_column = "rx"\nreceive_time_format = "unix"'
ELAPSED = 'time_format = "elapsed"\nepoch_utc = "2026-01-01T00:00:00Z"'
GPS = 'time_format = "gps"'
GPS_WEEKS = f'{GPS}\nweek_column = "week"'
MINUTES = [f"2026-01-01T00:{k:02d}:00Z" for k in range(10)]
START = 1_767_225_600.0
"""1 January 2026."""


def craft(form, bad_rows="flag", time_column="t", a="pa"):
    text = VEHICLE.format(form=form, bad_rows=bad_rows, time_column=time_column, a=a)
    return parse_vehicle(text, "v.toml")


@pytest.fixture
def read(tmp_path):
    """Read a file with these times, other columns, and readings that differ from row to row."""

    def read(times, form, bad_rows="flag", time_column="t", **columns):
        names = [time_column, *columns, "pa", "pb"]
        power = np.random.default_rng(3).uniform(0.1, 2, (len(times), 2)).round(4)
        cells = zip(times, *columns.values(), *power.T.tolist(), strict=True)
        path = tmp_path / "t.csv"
        path.write_text("\n".join([",".join(names), *(",".join(map(str, row)) for row in cells)]))
        return ss.read_telemetry(path, craft(form, bad_rows, time_column))

    return read


@pytest.fixture
def refused(read):
    """Assert that such a file is refused in a sentence with these words."""

    def refused(words, *arguments, **columns):
        with pytest.raises(TelemetryError, match=words):
            read(*arguments, **columns)

    return refused


def utc(data):
    """Return the date of each sample, s from 1970."""
    return datetime.fromisoformat(data.attrs["epoch_utc"]).timestamp() + data["time"].values


def assert_dated(data, expected, within_s=1e-3):
    """Assert that the samples have these dates, s from 1970."""
    np.testing.assert_allclose(utc(data), expected, rtol=0, atol=within_s)


def notes(data):
    return data.attrs.get("clock_notes", "")


def frames(n, again=slice(0), seed=1):
    """Return frames that differ, some of them once more at the end."""
    cells = np.random.default_rng(seed).uniform(0, 2, (n, 2)).round(3).astype(str)
    return restarts.Frames(np.vstack([cells, cells[again]]))


def two_boots(first=260_040.0):
    """Uptime and received time of rows 20 s apart, with a reset after row 22."""
    received = START + np.cumsum(np.random.default_rng(5).uniform(15, 25, 40)).round()
    uptime = received - received[0] + first
    uptime[22:] = received[22:] - received[22] + 35
    return uptime, received


@pytest.mark.parametrize("first", [40.0, 260_040.0])
@pytest.mark.parametrize("order", ["as received", "newest first", "some not received"])
def test_each_boot_is_dated_by_its_own_received_times(read, first, order):
    """A row without a received time belongs to the boot of its neighbours; a stated epoch dates the nearest boot."""
    uptime, received = two_boots(first)
    cells = received.astype(int).astype(str)
    if order == "some not received":
        cells[[10, 21, 22, 30]] = ""
    way = slice(None, None, -1 if order == "newest first" else 1)
    epoch = datetime.fromtimestamp(received[0] - first, UTC).isoformat()
    for form in (UPTIME, f'{UPTIME}\nepoch_utc = "{epoch}"\ncounts_leap_seconds = false'):
        data = read(uptime[way], form, rx=cells[way])
        assert_dated(data, received, 0.01)
        assert "the uptime starts again: 2 boots" in notes(data)


@pytest.mark.parametrize(("early", "says"), [(43_200, True), (70, True), (30, False)])
def test_an_epoch_that_contradicts_received_times_is_reported(read, early, says):
    uptime = 100 + 20.0 * np.arange(40)
    epoch = f"{datetime.fromtimestamp(START - early, UTC):%Y-%m-%dT%H:%M:%SZ}"
    form = f'{UPTIME}\nepoch_utc = "{epoch}"\ncounts_leap_seconds = false'
    words = f"received times put time zero at 2026-01-01T00:00:00Z; epoch_utc says {epoch}"
    assert (words in notes(read(uptime, form, rx=START + uptime))) == says
    stored = read(uptime, form, rx=START + 50_000 + 0.1 * uptime)
    assert "received times put" not in notes(stored)


def test_leap_seconds_are_counted_from_the_zero_of_each_boot(read):
    """Two of them lie between the boots, none within."""
    zero = np.repeat([datetime(year, 1, 1, tzinfo=UTC).timestamp() for year in (2015, 2020)], 30)
    uptime = np.tile(100 + 20.0 * np.arange(30), 2)
    form = f'{UPTIME}\nepoch_utc = "2015-01-01T00:00:00Z"'
    for counts in ("true", "false"):
        data = read(uptime, f"{form}\ncounts_leap_seconds = {counts}", rx=zero + uptime)
        assert_dated(data, zero + uptime)
    assert "leap" not in notes(read(uptime, form, rx=zero + uptime))


LATE = {
    "a burst of stored rows": lambda up: np.full(up.size, up.max() + 60.0),
    "a playback slower than real time": lambda up: up.max() + 40 + 2.5 * (up - up.min()),
    "newest row first": lambda up: up.max() + 60 + 0.1 * (up.max() - up),
}


@pytest.mark.parametrize("how", LATE)
@pytest.mark.parametrize("first", [0.0, 1e6])
def test_late_downlinks_are_not_taken_for_a_boot(read, how, first):
    """Received minus uptime varies by as much as the rows were stored; the least delay dates them."""
    uptime = first + 20.0 * np.arange(60)
    received = START + LATE[how](uptime - first)
    order = np.argsort(received, kind="stable")
    data = read(uptime[order], UPTIME, rx=received[order])
    assert "boots" not in notes(data)
    assert_dated(data, (received - uptime).min() + uptime, 60.01)


def test_frames_played_back_in_real_time_and_those_of_a_station_an_hour_off_are_no_boot():
    """The live ones date the played back; the uptime exceeds the delay of the playback."""
    uptime = 1e6 + 20.0 * np.arange(60)
    received = START + uptime + np.where(np.arange(60) < 30, 3000.0, 0.0)
    found = restarts.find_boot_starts(uptime, received, frames(60))
    np.testing.assert_allclose(found, [START], rtol=0, atol=1e-6)
    uptime = np.tile(10.0 + 20.0 * np.arange(30), 2)
    received = START + uptime + np.repeat([0.0, 3600.0], 30)
    for seen, boots in ((frames(30, slice(30)), 1), (frames(60), 2)):
        assert len(restarts.find_boot_starts(uptime, received, seen)) == boots


def test_rows_of_telemetry_stored_for_days_are_counted(read):
    uptime = np.concatenate([1e6 + 20.0 * np.arange(30), 5e5 + 20.0 * np.arange(10)])
    received = START + np.concatenate([20.0 * np.arange(30), 700 + np.arange(10)])
    said = notes(read(uptime, UPTIME, rx=received))
    assert "10 rows are dated up to 5.8 days before reception" in said


def test_boots_that_overlap_are_refused_without_received_times(read, refused):
    """Those that do not overlap are noted."""
    uptime, received = two_boots(40.0)
    for bad_rows in ("flag", "refuse"):
        refused("line 24.*start again.*receive_time_column", uptime, ELAPSED, bad_rows)
    refused("line 19.*start again", uptime[::-1], ELAPSED)
    assert_dated(read(uptime, UPTIME, rx=received), received, 0.01)
    assert not notes(read(uptime[:22], ELAPSED)) and not notes(read(uptime[22:], ELAPSED))
    assert read(uptime, ELAPSED, "sort").attrs["rows_sorted"] == 18
    assert "fall by 3.0 days at line 24" in notes(read(two_boots()[0], ELAPSED))


def test_stations_and_playbacks_are_not_taken_for_a_restart():
    live = 3000 + 20.0 * np.arange(40)
    find, twice = restarts.find_uptime_restart, slice(None, None, 2)
    assert find(np.concatenate([live, live[twice]]), frames(40, twice)) is None
    restart = find(np.concatenate([np.delete(live, slice(10, 20)), live[10:20]]), frames(40))
    assert restart is not None and restart.row == 30 and not restart.sure
    assert find(live[::-1], frames(40)) is None


def local(start, rows=40, step=20.0, seed=4):
    """Return UTC instants of rows, irregular."""
    apart = np.random.default_rng(seed).uniform(0.7, 1.3, rows) * step
    return [start + timedelta(seconds=int(each)) for each in np.cumsum(apart)]


SUMMER_ENDS = datetime(2026, 10, 25, 0, 54, tzinfo=UTC)
"""In Central Europe clocks go back at 01:00 UTC, from 03:00 to 02:00."""


def shown(moments, zone):
    return [f"{each.astimezone(ZoneInfo(zone)):%Y-%m-%d %H:%M:%S}" for each in moments]


ZONES = {
    "Europe/Berlin": SUMMER_ENDS,
    "America/New_York": datetime(2026, 11, 1, 5, 54, tzinfo=UTC),
    "Australia/Lord_Howe": datetime(2026, 4, 4, 14, 54, tzinfo=UTC),
}


@pytest.mark.parametrize("zone", ZONES)
@pytest.mark.parametrize("newest", [False, True])
def test_times_of_a_clock_set_back_are_dated_by_its_zone(read, refused, zone, newest):
    moments = local(ZONES[zone])
    cells = shown(moments, zone)[:: -1 if newest else 1]
    stated = f'time_zone = "{zone}"'
    for bad_rows in ("flag", "refuse"):
        refused("go back by (1 h|30 min), as a clock.*time_zone", cells, "", bad_rows)
        if newest and bad_rows == "refuse":
            refused("line 3: time does not increase", cells, stated, bad_rows)
        else:
            data = read(cells, stated, bad_rows)
            assert_dated(data, [each.timestamp() for each in moments])
            assert notes(data) == f"times without a zone are read in {zone}"
    assert read(cells, "", "sort").attrs["rows_sorted"] > 0


@pytest.mark.parametrize("hours", [(1, 0), (0, 2, 1), (2, 1, 0), (1, 2, 0), (2, 0)])
@pytest.mark.parametrize("form", ["", 'time_format = "unix"'])
def test_hours_in_the_wrong_order_are_not_taken_for_a_clock_set_back(read, hours, form):
    """Sorted they join without overlap."""
    times = np.concatenate([START + 3600 * hour + 60.0 * np.arange(60) for hour in hours])
    data = read(times if form else [f"{datetime.fromtimestamp(t, UTC)}" for t in times], form)
    assert_dated(data, np.sort(times), 1e-6)
    falls_once = np.count_nonzero(np.diff(hours) < 0) == 1
    assert ("times fall back once, by" in notes(data)) == falls_once
    assert "time_zone" not in notes(data)


def row_down(cells):
    return [*cells[:5], *cells[6:12], cells[5], *cells[12:]]


BACK = shown(local(SUMMER_ENDS), "Europe/Berlin")
YEAR_BEFORE = shown(local(SUMMER_ENDS - timedelta(days=364)), "Europe/Berlin")
SET_BACK = {
    "a late row": (row_down(BACK), "02:00:"),
    "an early row": (row_down(BACK[::-1])[::-1], "02:00:"),
    "a row of 1970": ([*BACK[:9], "1970-01-01 00:00:05", *BACK[9:]], "02:00:"),
    "two autumns": (YEAR_BEFORE + BACK, "2025-10-26 02:00:"),
}


@pytest.mark.parametrize(("cells", "place"), SET_BACK.values(), ids=SET_BACK)
def test_a_clock_set_back_without_a_zone_is_refused_with_its_times(refused, cells, place):
    for bad_rows in ("flag", "refuse"):
        refused(f"go back by 1 h, as a clock.*{place}", cells, "", bad_rows)


FALL_BACK = datetime(2024, 11, 3, 6, 0, tzinfo=UTC).timestamp()
"""When clocks in New York went back from 02:00 to 01:00."""

REPEATED_HOURS = {
    "a late row": lambda: local(SUMMER_ENDS),
    "two passes": lambda: (
        local(datetime(2026, 10, 25, 0, 10, tzinfo=UTC), 30)
        + local(datetime(2026, 10, 25, 1, 13, tzinfo=UTC), 30, seed=8)
    ),
    "two autumns": lambda: local(SUMMER_ENDS - timedelta(days=364)) + local(SUMMER_ENDS),
    "a row every 20 s": lambda: every(20),
    "a row every 1800 s": lambda: every(1800),
}


def every(apart_s):
    """Return UTC instants of eight hours around the end of summer time in New York."""
    times = FALL_BACK - 4 * 3600 + np.arange(0, 8 * 3600, apart_s)
    return [datetime.fromtimestamp(each, UTC) for each in times]


@pytest.mark.parametrize("what", REPEATED_HOURS)
def test_rows_through_an_hour_that_occurs_twice_keep_their_order(read, refused, what):
    """Passes before and after it are not interleaved; neither a late row nor another autumn moves the hour."""
    moments = REPEATED_HOURS[what]()
    zone = "America/New_York" if "every" in what else "Europe/Berlin"
    cells = shown(moments, zone)
    if what == "a late row":
        cells = [*cells[:30], *cells[31:38], cells[30], *cells[38:]]
    data = read(cells, f'time_zone = "{zone}"')
    assert_dated(data, [each.timestamp() for each in moments], 1e-6)
    if what == "two passes":
        refused("as a clock that is set back", cells, "")


def test_times_that_do_not_exist_in_the_zone_are_refused(read, refused):
    cells = [f"2026-03-29 0{k // 60}:{k % 60:02d}:00" for k in range(110, 210, 10)]
    words = "line 3.*02:00:00 does not exist in Europe/Berlin on 2026-03-29: the times are not of"
    for bad_rows in ("flag", "refuse", "sort"):
        refused(words, cells, 'time_zone = "Europe/Berlin"', bad_rows)
    data = read([cells[0], "2026-03-29 03:00:00"], 'time_zone = "Europe/Berlin"')
    assert data["time"].values.tolist() == [0, 600]


@pytest.mark.parametrize("zone", ["America/New_York", "Pacific/Auckland"])
@pytest.mark.parametrize("day", ["0001-01-01 00:00:00", "9999-12-31 23:59:59"])
def test_dates_at_the_ends_of_the_calendar_are_left_out_with_a_zone(read, zone, day):
    data = read([day, *(text.rstrip("Z") for text in MINUTES)], f'time_zone = "{zone}"')
    assert data.attrs["rows_misdated"] == 1 and data.sizes["time"] == 10


def test_unordered_rows_are_not_taken_for_a_clock_set_back():
    t = 20.0 * np.arange(60)
    find, third = restarts.find_clock_set_back, slice(None, None, 3)
    assert find(np.concatenate([t, t[third]]), frames(60, third), local=True) is None
    assert find(np.r_[t + 3600, t, t + 7200, t + 1800], frames(240), local=False) is None
    swapped = t.copy()
    swapped[[20, 21, 40, 41]] = swapped[[21, 20, 41, 40]]
    stored = [np.r_[t + k * 86400, t + k * 86400 - 1800 - 37 * k] for k in range(1, 6)]
    pairs = np.concatenate([60.0 * np.arange(60) + 3600 * hour for hour in (1, 0, 3, 2)])
    cases = [t[::-1], np.r_[t + 2 * 86400, t], swapped, np.concatenate(stored), pairs]
    for seed in range(5):
        cases.append(np.random.default_rng(seed).permutation(np.r_[t, t + 5000]))
        cases.append(t[np.argsort(t + np.random.default_rng(seed).uniform(0, 200, 60))])
    for times in cases:
        assert find(times, frames(len(times)), local=True) is None


def test_a_fall_of_local_times_that_may_be_a_clock_set_back_is_reported(read):
    before = local(datetime(2026, 10, 25, 0, 40, tzinfo=UTC), 10)
    after = local(datetime(2026, 10, 25, 1, 16, tzinfo=UTC), 10)
    data = read(shown([*before, *after], "Europe/Berlin"), "")
    assert "times fall back once, by 27 min at line 12" in notes(data)


NO_ZONE = "times name no zone: taken as UTC"
INDIA = 'time_zone = "+05:30"'


@pytest.mark.parametrize(
    ("first", "second", "form", "words"),
    [
        ("2026-01-01 00:00:00", "2026-01-01T00:01:00", "", NO_ZONE),
        ("2026-001T00:00:00", "2026-001T00:01:00", "", NO_ZONE),
        ("2026-01-01 00:00:00", "2026-01-01T00:01:00Z", "", "1 time names no zone: taken as UTC"),
        ("2026-01-01 00:00:00Z", "2026-01-01T00:01:00+00:00", "", ""),
        ("20260101T000000Z", "20260101T000100Z", "", ""),
        ("2026-01-01 00:00:00 UTC", "2026-01-01T00:01:00 GMT", "", ""),
        (
            "2026-01-01 05:30:00",
            "2026-01-01 05:31:00",
            INDIA,
            "times without a zone are read in +05:30",
        ),
        ("2026-01-01T00:00:00Z", "2026-01-01T00:01:00Z", INDIA, ""),
        ("2026-01-01T00:01:09.184", "2026-01-01 00:02:09.184 TDB", 'time_format = "tt"', ""),
        ("2461041.5", f"{2461041.5 + 60 / 86400:.10f}", 'time_format = "jd"', ""),
    ],
)
def test_times_are_read_in_the_zone_or_scale_that_they_or_the_file_name(
    read, first, second, form, words
):
    """If none is named it is UTC, which is reported, also in the summary of a result."""
    data = read([first, second], form, "refuse")
    assert notes(data) == words
    assert_dated(data, [START, START + 60], 1e-4 if "jd" in form else 1e-6)
    summary = ss.sun_directions(craft(""), data).sunspin.summary()
    assert summary.get("clock_notes", []) == ([words] if words else [])
    assert summary.lines.count(f"  {words}") == bool(words)


GPS_ZERO = datetime(1980, 1, 6, tzinfo=UTC)


def gps_of(moment):
    """Return GPS seconds of a UTC instant by ERFA, not by the code under test."""
    ahead = erfa.dat(moment.year, moment.month, moment.day, 0.0)
    return (moment - GPS_ZERO).total_seconds() + ahead - 19


@pytest.mark.parametrize("day", [(1999, 8, 22), (2016, 12, 31), (2017, 1, 1), (2026, 3, 4)])
def test_gps_seconds_and_weeks_are_read_as_erfa_counts_leap_seconds(read, day):
    moments = [datetime(*day, tzinfo=UTC) + timedelta(seconds=20 * k) for k in range(5)]
    seconds = np.array([gps_of(each) for each in moments])
    expected = [each.timestamp() for each in moments]
    data = read(seconds, GPS, "refuse")
    assert_dated(data, expected, 1e-5)
    assert not notes(data)
    week, tow = seconds // 604800, 1000 * (seconds % 604800)
    form = f"{GPS_WEEKS}\ntime_scale_s = 0.001"
    assert_dated(read(tow, form, "refuse", week=week.astype(int)), expected, 1e-5)


def test_gps_weeks_that_rolled_over_are_refused_until_the_rollovers_are_stated(read, refused):
    week, tow = [2399 % 1024] * 3, [345_618.0, 345_638.0, 345_658.0]
    refused(r"gps_rollovers .* 2 for 2026-01-01, 1 for", tow, GPS_WEEKS, week=week)
    data = read(tow, f"{GPS_WEEKS}\ngps_rollovers = 2", week=week)
    assert_dated(data, START + np.array([0, 20, 40]), 1e-5)
    old = read(tow, f"{GPS_WEEKS}\ngps_rollovers = 0", week=week)
    assert old.attrs["epoch_utc"].startswith("1986-10-02")
    words = "the GPS week is not of ten bits.* leave gps_rollovers out"
    refused(words, tow, f"{GPS_WEEKS}\ngps_rollovers = 2", week=[2399] * 3)
    refused(words, [1451260818.0, 1451260838.0], f"{GPS}\ngps_rollovers = 2")


def test_tai_is_read_as_seconds_from_1958_or_as_dates(read, refused):
    moments = [datetime(2026, 1, 1, 0, 0, 37 + k, tzinfo=UTC) for k in range(3)]
    form = 'time_format = "tai"'
    dates = [f"{each:%Y-%m-%dT%H:%M:%S}" for each in moments]
    seconds = [(each - datetime(1958, 1, 1, tzinfo=UTC)).total_seconds() for each in moments]
    for cells in (seconds, dates, [f"{date} TAI" for date in dates]):
        assert_dated(read(cells, form, "refuse"), START + np.arange(3), 1e-5)
    refused("TAI time without a zone", ["2026-01-01T00:00:37Z", "2026-01-01T00:00:38Z"], form)


@pytest.mark.parametrize(("name", "scale", "late_s"), [("time_tai", "tai", 37), ("TDB", "tt", 69)])
def test_dates_with_Z_in_a_column_named_after_TAI_or_TDB_are_named(name, scale, late_s, read):
    """Only `init` named them, and the time scale could not be stated."""
    date = datetime.fromtimestamp(START + late_s, UTC).isoformat().replace("+00:00", "Z")
    said = f'times are {late_s} s late; set time_format = "{scale}"'
    for form, words, late in (("", said, late_s), (f'time_format = "{scale}"', "", 0)):
        data = read([date], form, time_column=name)
        assert words in notes(data)
        assert_dated(data, [START + late], 0.2)


COUNTED = {
    "excel": (46023.0, 1 / 86400),
    "mjd": (61041.0, 1 / 86400),
    "datenum": (739983.0, 1 / 86400),
    "labview": (3850070400.0, 1.0),
    "ntp": (3976214400.0, 1.0),
    "filetime": (134116992000000000, 10**7),
    "ticks": (639028224000000000, 10**7),
}
"""1 January 2026 as Excel, MATLAB, LabVIEW, NTP, Windows and .NET count, and counts in a second."""


@pytest.mark.parametrize("key", COUNTED)
def test_counts_of_other_programs_are_read_and_named(key, read, refused):
    """100 ns were read as Unix nanoseconds, so that all rates were 100 times too large; the others as Unix times without a word."""
    zero, second = COUNTED[key]
    stated, expected = f'time_format = "{key}"', START + 10 * np.arange(5)
    counts = [zero + 10 * k * second for k in range(5)]
    cells = [f"{each:.9f}" if isinstance(zero, float) else f"{each:d}" for each in counts]
    assert_dated(read(cells, stated), expected)
    refused(f'set time_format = .*"{key}" for .*2026', cells, 'time_format = "utc"')
    unix = read(cells, 'time_format = "unix"')
    assert f'"{key}"' in notes(unix)
    assert isinstance(zero, float) or np.allclose(utc(unix), expected)
    if second == 1:
        milli = [f"{1e3 * each:.0f}" for each in counts]
        assert_dated(read(milli, f"{stated}\ntime_scale_s = 0.001"), expected)
    if key in LOCAL_FORMATS:
        assert_dated(read(cells, f'{stated}\ntime_zone = "Europe/Berlin"'), expected - 3600)
    # as Unix times these are right, also after a reset to 1970
    for first in (START, START + 0.5e9, zero % 3e6):
        assert not notes(read(first + 10 * np.arange(5.0), 'time_format = "unix"'))


def test_times_increase_through_a_leap_second():
    before = (datetime(2016, 12, 31, 23, 59, 50, tzinfo=UTC)).timestamp()
    tai = before + 36 + np.arange(0, 20, 0.25)
    utc_s = utc_of_tai(tai)
    assert np.all(np.diff(utc_s) > 0) and np.diff(utc_s).max() <= 0.25 + 1e-9
    assert utc_s[0] == before and utc_s[-1] == tai[-1] - 37
    assert leap_seconds_between(before, before + 20) == 1 and tai_ahead(4e9) >= 37


def test_elapsed_times_over_leap_seconds_are_reported_as_not_counting_them(read):
    seconds = [gps_of(datetime(2026, 1, 1, 0, 0, k, tzinfo=UTC)) for k in (0, 20, 40)]
    form = 'time_format = "elapsed"\nepoch_utc = "1980-01-06T00:00:00Z"'
    data = read(seconds, form)
    assert "18 leap seconds after epoch_utc not counted" in notes(data)
    assert 'time_format = "gps"' in notes(data) and utc(data)[0] == START + 18
    counted = read(seconds, f"{form}\ncounts_leap_seconds = true")
    assert_dated(counted, START + np.array([0, 20, 40]), 1e-5)
    plain = read(seconds, f"{form}\ncounts_leap_seconds = false")
    assert utc(plain)[0] == START + 18 and not notes(counted) and not notes(plain)
    assert not notes(read([0, 20, 40], ELAPSED))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (["1970-01-01T00:00:03Z", "1970-01-01T00:00:23Z"], "2 rows dated {0} to {1}"),
        (["2000-01-01T00:00:03Z", "2000-01-01T00:00:23Z"], "2 rows dated {0} to {1}"),
        ([f"2000-01-01T00:{k:02d}:00Z" for k in range(12)], "12 rows dated {0}"),
        (["2035-01-01T00:00:00Z"], "9 years after the others"),
        ([f"2200-01-01T00:{k:02d}:00Z" for k in range(5)], "5 rows dated {0}"),
    ],
    ids=["1970", "2000", "a reset clock, in most rows", "one damaged row", "2200"],
)
def test_rows_dated_decades_apart_are_named_and_left_out(read, refused, wrong, words):
    data = read([*MINUTES[:5], *wrong, *MINUTES[5:]], "")
    assert words.format(*wrong) in notes(data)
    assert ("reset: 55 % of the file, check that" in notes(data)) == (len(wrong) == 12)
    assert data.attrs["rows_misdated"] == len(wrong)
    assert data.attrs["epoch_utc"] == "2026-01-01T00:00:00Z"
    assert data["time"].values.tolist() == (60.0 * np.arange(10)).tolist()
    line = f'line 2.*{len(wrong)} rows? dated .* bad_rows = "flag"'
    refused(line, [*wrong, *MINUTES], "", "refuse")


SUMMER_WITH_OFFSETS = [
    f"{each.astimezone(ZoneInfo('Europe/Berlin'))}" for each in local(SUMMER_ENDS)
]
YEARS = [f"{year}-01-01T00:0{k}:00+00:00" for year in (2020, 2023, 2026) for k in range(3)]


@pytest.mark.parametrize("cells", [SUMMER_WITH_OFFSETS, YEARS], ids=["end of summer", "years"])
def test_the_end_of_summer_time_with_zones_and_passes_in_several_years_are_read(read, cells):
    data = read(cells, "", "refuse")
    assert_dated(data, [datetime.fromisoformat(cell).timestamp() for cell in cells], 1e-6)
    assert not notes(data)


@pytest.mark.parametrize(
    ("form", "words"),
    [
        ('time_zone = "Europe/Nowhere"', "time_zone is not known .*Europe/Berlin"),
        ('time_zone = "../../etc/passwd"', "time_zone is not known"),
        ('time_format = "unix"\ntime_zone = "+01:00"', 'time_zone needs time_format = "utc"'),
        ('week_column = "w"', 'week_column needs time_format = "gps"'),
        ('time_format = "gps"\ngps_rollovers = 1.5', "gps_rollovers must be a whole number"),
        ("counts_leap_seconds = true", "counts_leap_seconds needs"),
        (f"{UPTIME}\ncounts_leap_seconds = true", "counts_leap_seconds needs epoch_utc"),
    ],
)
def test_contradictory_clock_keys_are_refused(form, words):
    with pytest.raises(ss.VehicleError, match=words):
        craft(form)


FRACTION = 'fraction_column = "ms"'
RECEIVED = f'{ELAPSED}\nreceive_time_column = "rx"\nreceive_time_format ='
NO_RECEIVED = "received times are expected to be .*found"
TEN = range(0, 200, 20)
SET_BACK_1_H = START + 20.0 * np.arange(400) - np.repeat([0.0, 3600.0], 200)
ENDS = "1970-01-01T00:00:03Z", "2038-01-01T00:00:03Z"
REFUSE = {"bad_rows": "refuse"}


@pytest.mark.parametrize(
    ("times", "form", "more", "words"),
    [
        ([1, 2], GPS_WEEKS, {"week": [2399, "x"]}, "line 3, column 'week': a GPS week is a whole"),
        ([1, 7e5], GPS_WEEKS, {"week": [2399] * 2}, "line 3, column 't': seconds of the week are"),
        (["nan", "1451260838"], GPS, {}, "column 't': GPS seconds are expected"),
        (TEN, f'{RECEIVED} "unix"', {"rx": ["1700000001000000"] * 10}, NO_RECEIVED),
        (TEN, f'{RECEIVED} "utc"', {"rx": ["14.13.2023 06:30:01"] * 10}, NO_RECEIVED),
        (range(604_000, 604_200, 20), GPS, {}, "seconds of the week.*set week_column"),
        (range(604_000, 604_200, 20), f"{GPS}\ngps_rollovers = 2", {}, "set week_column"),
        ([820497669.184], 'time_format = "tt"', {}, 'for seconds set time_format = "elapsed" and'),
        (["2026-01-01"], 'time_format = "jd"', {}, "Julian Date are expected, such as 2461072.5"),
        (SET_BACK_1_H, 'time_format = "unix"', {}, "go back by 1 h.*file of their own"),
        ([ENDS[0], *MINUTES, ENDS[1]], "", REFUSE, f"line 2.*1 row dated {ENDS[0]}"),
        ([ENDS[1], *MINUTES, ENDS[0]], "", REFUSE, f"line 2.*1 row dated {ENDS[1]}"),
        (MINUTES[:1], FRACTION, {"ms": [1000]}, "'ms': a fraction of a second is a number from 0"),
        (MINUTES[:1], FRACTION, {"ms": [""]}, "column 'ms': a fraction .* .found an empty cell"),
        (MINUTES[:1], FRACTION, {}, "column 'ms' .the fraction of a second. is missing"),
        (["2026-01-01 00:00:00.5"], FRACTION, {"ms": [3]}, "'t': a time with .* whole seconds"),
    ],
)
def test_wrong_times_are_refused_in_plain_words(refused, times, form, more, words):
    refused(words, times, form, **more)


def test_starts_of_passes_show_the_year_if_years_differ():
    data = xr.Dataset(attrs={"epoch_utc": "2025-12-31T23:50:00Z"})
    assert start_texts(data, [0.0, 60.0]) == ["12-31 23:50", "12-31 23:51"]
    assert start_texts(data, [0.0, 660.0]) == ["2025-12-31 23:50", "2026-01-01 00:01"]
    assert start_texts(xr.Dataset(), [0.0, 60.0]) == ["0 s", "60 s"]


def test_a_pass_alone_in_the_repeated_hour_is_named(read):
    """Four passes 95 min apart: the neighbours are too far away to decide which of the two hours it was."""
    starts = FALL_BACK - 900 + 5700 * np.array([-1, 0, 1, 2])
    true = np.concatenate([start + 20.0 * np.arange(24) for start in starts])
    moments = [datetime.fromtimestamp(each, UTC) for each in true]
    data = read(shown(moments, "America/New_York"), 'time_zone = "America/New_York"')
    assert "24 times lie in the hour that a clock there shows twice" in notes(data)


def test_a_gps_week_that_stays_the_same_over_its_end_is_refused(read, refused):
    seconds = (604_700 + 20 * np.arange(10)) % 604_800
    refused("begin again, and the week stays the same", seconds, GPS_WEEKS, week=[2310] * 10)
    data = read(seconds, GPS_WEEKS, week=np.where(seconds > 1e5, 2310, 2311))
    np.testing.assert_allclose(np.diff(data["time"].values), 20.0, rtol=0, atol=1e-6)


NOTATIONS = {
    "German": lambda t: t.strftime("%d.%m.%Y %H:%M:%S.") + f"{t.microsecond // 1000:03d}",
    "LibreOffice": lambda t: f"{t:%d.%m.%y %H:%M:%S}",
    "French": lambda t: f"{t:%d/%m/%Y %H:%M:%S}",
    "American": lambda t: f"{t:%m/%d/%Y %I:%M:%S %p}",
    "ISO, 12 hours": lambda t: f"{t:%Y-%m-%d %I:%M:%S.%f %p}",
    "Chinese": lambda t: f"{t.year}/{t.month}/{t.day} {t.hour}:{t:%M:%S}",
    "MATLAB": lambda t: f"{t:%d-%b-%Y %H:%M:%S.%f}",
    "e-mail": lambda t: f"{t:%a. %d %b %Y %H:%M:%S} +0000".replace(".", ""),
    "Kibana": lambda t: f"{t:%b %d %Y @ %H:%M:%S.%f}",
    "JavaScript": lambda t: f"{t:%a %b %d %Y %H:%M:%S} GMT+0000 (Coordinated Universal Time)",
    "Go": lambda t: f"{t:%Y-%m-%d %H:%M:%S.%f} +0000 UTC",
    "SCOS-2000": lambda t: f"{t:%Y.%j.%H.%M.%S.%f}",
    "ITOS": lambda t: f"{t:%Y:%j:%H:%M:%S.%f}",
    "day of the year": lambda t: f"{t:%Y/%j-%H:%M:%S.%f}",
    "digits": lambda t: f"{t:%Y%m%d%H%M%S}",
    "C": lambda t: f"{t:%a %b} {t.day:2d} {t:%H:%M:%S %Y}",
    "Unix": lambda t: f"{t:%a %b %d %H:%M:%S UTC %Y}",
    "Oracle": lambda t: f"{t:%d-%b-%y %I.%M.%S.%f000 %p}".upper(),
    "SAS": lambda t: f"{t:%d%b%Y:%H:%M:%S.%f}".upper(),
    "year of two digits": lambda t: f"{t:%y/%j-%H:%M:%S.%f}",
    "German month": lambda t: f"{t.day}. {('Januar', 'Februar')[t.month - 1]} {t:%Y %H:%M:%S} Uhr",
}
"""Who writes a time so -> how."""


@pytest.mark.parametrize("program", NOTATIONS)
def test_dates_as_other_programs_write_them_are_read_to_the_millisecond(read, program):
    write = NOTATIONS[program]
    # noon and midnight, the first days of a month and the last ones
    moments = [
        datetime(2026, 1, 28, 11, 59, 58, 125000, UTC) + timedelta(hours=12, seconds=2) * k
        for k in range(12)
    ]
    texts = [write(moment) for moment in moments]
    expected = np.array([moment.timestamp() for moment in moments])
    if ".125" not in texts[0]:
        expected = np.floor(expected)
    assert_dated(read(texts, "", "refuse"), expected, 1e-4)
    rounded = [moment.replace(microsecond=0, tzinfo=None) for moment in moments]
    received = read(rounded, 'receive_time_column = "rx"', rx=texts)["received_s"]
    np.testing.assert_allclose(received, expected - np.floor(moments[0].timestamp()), atol=1e-4)


def test_the_order_of_day_and_month_is_asked_for_unless_a_date_shows_it(read, refused):
    times = [f"03/0{day}/2026 12:00:00" for day in range(4, 8)]
    refused("line 2, column 't': these dates do not show .*day_first", times, "")
    march, april = (datetime(2026, *d, 12, tzinfo=UTC).timestamp() for d in ((3, 4), (4, 3)))
    assert utc(read(times, "day_first = true"))[0] == april
    assert utc(read(times, "day_first = false"))[0] == march
    assert utc(read([*times, "03/31/2026 12:00:00"], ""))[0] == march
    words = "ISO-8601 UTC time is expected .found 31/03/2026"
    refused(words, [*times, "31/03/2026 12:00:00"], "day_first = false")
    refused("column 'day' .the date. is missing", times, 'date_column = "day"')


def test_a_zone_in_the_name_of_the_times_is_named_if_the_file_is_read_as_utc(read):
    for zone, said in {"": True, 'time_zone = "+01:00"': False}.items():
        data = read(["2026-01-01 01:00:00"], zone, time_column="Zeit (MEZ)")
        assert ('says otherwise: set time_zone = "+01:00"' in notes(data)) == said


def test_fractions_in_a_column_of_their_own_are_read_and_named_if_not(read):
    times = [f"2026-01-01T00:00:{10 * k:02d}+01:00" for k in range(5)]
    ms = [7, 999, 120, 0, 501]
    seconds = START - 3600 + 10 * np.arange(5)
    expected = seconds + np.array(ms) / 1000
    assert_dated(read(times, FRACTION, ms=ms), expected, 1e-6)
    assert_dated(read(seconds, f'time_format = "unix"\n{FRACTION}', ms=ms), expected, 1e-6)
    unread = read(times, "", ms=ms)
    assert 'set fraction_column = "ms" and fraction_unit_s = 0.001' in notes(unread)
    for name, values in {"delay_ms": ms, "ms": [7, 1999, 120, 0, 501]}.items():
        assert "fraction" not in notes(read(times, "", **{name: values}))


@pytest.mark.parametrize(("bits", "scale"), [(16, 1.0), (24, 0.1), (32, 0.001)])
def test_a_counter_that_overflows_goes_on(read, bits, scale):
    true = np.arange(40) * 10.0 + 2**bits * scale - 195
    counts = np.round(true / scale).astype(int) % 2**bits
    form = f"{ELAPSED}\ntime_scale_s = {scale}"
    data = read(counts, form, bad_rows="refuse")
    np.testing.assert_allclose(data["time"], true, rtol=0, atol=scale)
    assert f"begin again after {2**bits} counts at line 22: taken as an overflow" in notes(data)
    perhaps_a_reset = [*counts[:20], *(counts[20:] + int(5000 / scale))]
    assert "taken for rows out of order" in notes(read(perhaps_a_reset, form))


def test_a_short_counter_that_overflows_twice_goes_on_and_one_fall_is_a_reset(read, refused):
    """After 12 bits the clock was taken for one that was reset. A single fall may be a reset near 4096."""
    true = np.arange(60) * 200
    data = read(true % 4096, ELAPSED)
    np.testing.assert_array_equal(data["time"], true)
    assert "after 4096 counts at line 23, 2 times in all" in notes(data)
    refused("a clock that was reset", true[:40] % 4096, ELAPSED)
    # a counter of 15 bits that goes on to the second: one reset in 10 000 looks like this
    once = np.arange(60) * 10 + 32768 - 305
    np.testing.assert_array_equal(read(once % 32768, ELAPSED)["time"], once)
    reset = [*once[:31], *range(36, 300, 10)]  # 30 s late
    assert "overflow" not in notes(read(reset, ELAPSED))
    after_a_minute = [0, 20_000, 40_000, 60_000, 5_000, 25_000, 45_000]
    assert "overflow" not in notes(read(after_a_minute, f"{ELAPSED}\ntime_scale_s = 0.001"))


@pytest.mark.parametrize(
    "text", ["26-031", "26.031", "26/031 1", "31 Jan 11:12:07", "jan 31 11:12:07", "2may26"]
)
def test_numbers_and_parts_of_dates_are_no_dates(text):
    assert rewrite_date(text, True) == text


@pytest.mark.parametrize(
    ("month", "number"), [("März", 3), ("Mrz", 3), ("Mai", 5), ("Oktober", 10), ("Dez.", 12)]
)
def test_german_months_are_known(month, number):
    assert parse_utc(rewrite_date(f"2. {month} 2026 11:58:07")).month == number


def test_parts_of_a_date_are_read_and_those_that_are_none_shown(tmp_path):
    """A column that the vehicle file reads, here `second` or `s`, is no part."""

    def read(panel, *dates):
        rows = "".join(f"{date},1,{k}\n" for k, date in enumerate(dates))
        path = tmp_path / "t.csv"
        path.write_text(f"year,month,day,hour,minute,second,{panel},pb\n{rows}")
        return ss.read_telemetry(path, craft("", a=panel))

    data = read("pa", "2026,2,28,23,59,60", "2026,3,1,0,0,10")
    assert data.attrs["epoch_utc"] == "2026-03-01T00:00:00Z"
    assert "times are made of columns year, month, day, hour, minute, second" in notes(data)
    with pytest.raises(TelemetryError, match="line 2, column 't': .*2026 2 30 23 59 60"):
        read("pa", "2026,2,30,23,59,60", "2026,3,1,0,0,10")
    data = read("s", "2026,1,1,0,0,0", "2026,1,1,0,0,9")
    assert data["time"].values.tolist() == [0.0, 9.0] and data.sizes["panel"] == 2
