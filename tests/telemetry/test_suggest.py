"""The `[telemetry]` section that is suggested for unknown columns: it is followed, and reads the file."""

from __future__ import annotations

import csv
import io
import json
import re
from datetime import UTC, datetime
from functools import cached_property
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import tomlkit
import xarray as xr
from click.testing import CliRunner

import sunspin as ss
from sunspin.base.errors import SunspinError
from sunspin.cli import cli
from sunspin.output.template import write_templates

TEMPLATE = resources.files("sunspin").joinpath("template")
FACES = {"px": "+X", "mx": "-X", "py": "+Y", "my": "-Y", "pz": "+Z"}

STYLES = {
    "I_px [mA]": ("current_A", 0.001, "I_{sign:pn}{axis} [mA]"),
    "iXp": ("current_A", 0.001, "i{AXIS}{sign:pm}"),
    "solar_panel_x_plus_current": ("current_A", 0.001, "solar_panel_{axis}_{word}_current"),
    "SolarPanelXPlusCurrent": ("current_A", 0.001, "SolarPanel{AXIS}{Word}Current"),
    "eps.cur_pos_x (A)": ("current_A", 1.0, "eps.cur_{short}_{axis} (A)"),
    "eps.sp_xp_ma": ("current_A", 0.001, "eps.sp_{axis}{sign:pm}_ma"),
    "iXp.mA": ("current_A", 0.001, "i{AXIS}{sign:pm}.mA"),
    "PXp_W": ("power_W", 1.0, "P{AXIS}{sign:pm}_W"),
    "+X power (mW)": ("power_W", 0.001, "{sign:+-}{AXIS} power (mW)"),
    "sunX+": ("power_W", 1.0, "sun{AXIS}{sign:+-}"),
    "I_+X [µA]": ("current_A", 1e-6, "I_{sign:+-}{AXIS} [µA]"),
    "Current +X (Amps)": ("current_A", 1.0, "Current {sign:+-}{AXIS} (Amps)"),
    "I+X / mA": ("current_A", 0.001, "I{sign:+-}{AXIS} / mA"),
    "mA_px": ("current_A", 0.001, "mA_{sign:pm}{axis}"),
    "IXP": ("current_A", 0.001, "I{AXIS}{sign:PM}"),
    "PXP_mW": ("power_W", 0.001, "P{AXIS}{sign:PM}_mW"),
    "Panel X (+) current [mA]": ("current_A", 0.001, "Panel {AXIS} ({sign:+-}) current [mA]"),
    "I[+X]": ("current_A", 0.001, "I[{sign:+-}{AXIS}]"),
    "+X [%]": ("power_W", 0.01, "{sign:+-}{AXIS} [%]"),
    "+X power (milliwatts)": ("power_W", 0.001, "{sign:+-}{AXIS} power (milliwatts)"),
}
"""Name of the column of +X -> quantity, scale, and the form of all names."""


class Sign(str):
    """A sign that is written as the first of two characters if it is plus, else as the second."""

    def __format__(self, pair: str) -> str:
        return pair[self == "-"]


def column(form: str, face: str) -> str:
    plus = face[0] == "+"
    word = "plus" if plus else "minus"
    words = {"short": "pos" if plus else "neg", "word": word, "Word": word.title()}
    return form.format(sign=Sign(face[0]), axis=face[1].lower(), AXIS=face[1], **words)


def export(form: str, scale: float, time: str = "Time (UTC)") -> str:
    """Return the template's telemetry with other names and units, and columns that are not of panels."""
    text = TEMPLATE.joinpath("telemetry.csv").read_text("utf-8")
    rows = list(csv.reader(line for line in text.splitlines() if not line.startswith("#")))
    names = [time, *(column(form, FACES[name]) for name in rows[0][1:]), "mag_x", "mag_y", "T_px"]
    lines = [
        [row[0], *(f"{float(x) / scale:.6g}" for x in row[1:]), "21000", "-3000", "20.5"]
        for row in rows[1:]
    ]
    out = io.StringIO()
    csv.writer(out).writerows([names, *lines])
    return out.getvalue()


SECONDS = [f"2026-01-01T00:00:{k:02d}Z" for k in range(20)]


def table(names: str, rows, times=SECONDS) -> str:
    """Return a file with these names of times and columns, rows of cells, and cells of times before them."""
    return "\n".join([names, *(f"{time},{row}" for time, row in zip(times, rows, strict=True)), ""])


def two_panels(names: str, times) -> str:
    """Return a file with these names of times, cells of times and readings of panels +X and -X."""
    return table(f"{names},iXp,iXm", [f"{100 + k},{200 - k}" for k in range(len(times))], times)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def template(folder):
    """Put the template's vehicle file into the folder, and its telemetry as `as_expected.csv`."""
    write_templates(folder)
    (folder / "telemetry.csv").rename(folder / "as_expected.csv")


class Begun:
    """What `sunspin init --from` makes of a file with this content: its output, the vehicle file and its reading."""

    def __init__(self, content: str | bytes, name: str = "export.csv", out: str = "mine") -> None:
        self.telemetry, self.path = Path(name), Path(out, "vehicle.toml")
        content = content if isinstance(content, bytes) else content.encode()
        self.telemetry.write_bytes(content)
        done = CliRunner().invoke(cli, ["init", out, "--from", name])
        assert done.exit_code == 0, done.exception
        self.output, self.text = done.output, self.path.read_text("utf-8")

    @cached_property
    def form(self):
        return self.craft.telemetry

    @cached_property
    def craft(self) -> ss.Vehicle:
        return ss.load_vehicle(self.path)

    @cached_property
    def data(self) -> xr.Dataset:
        return ss.read_telemetry(self.telemetry, self.craft)

    @property
    def first_s(self) -> float:
        """Time of the first sample, s from 1970."""
        epoch = datetime.fromisoformat(self.data.attrs["epoch_utc"]).timestamp()
        return epoch + float(self.data["time"][0])

    def opened(self, pattern: str, by) -> xr.Dataset:
        """Replace a pattern of the vehicle file, and return the telemetry that it reads then."""
        self.path.write_text(re.sub(pattern, by, self.text, flags=re.MULTILINE), "utf-8")
        return ss.read_telemetry(self.telemetry, ss.load_vehicle(self.path))


def refusal(content: str) -> str:
    """Return the sentence with which `sunspin init --from` refuses a file."""
    Path("export.csv").write_text(content, "utf-8")
    done = CliRunner().invoke(cli, ["init", "mine", "--from", "export.csv"])
    assert isinstance(done.exception, SunspinError) and not Path("mine").exists()
    return str(done.exception)


def suggested(content: str) -> str:
    """Return what `check` prints of a file that the template's vehicle file cannot read."""
    Path("export.csv").write_text(content, "utf-8")
    done = CliRunner().invoke(cli, ["check", "vehicle.toml", "export.csv"])
    assert isinstance(done.exception, SunspinError) and "is missing" in str(done.exception)
    return done.stdout


@pytest.mark.parametrize("style", STYLES)
def test_the_suggested_section_reads_the_file_as_it_is_pasted(style, template):
    quantity, scale, form = STYLES[style]
    printed = suggested(export(form, scale))
    section = printed[printed.index("[telemetry]\n") :]
    right = ss.load_vehicle("vehicle.toml")
    document = tomlkit.parse(Path("vehicle.toml").read_text("utf-8"))
    document["telemetry"] = tomlkit.parse(section)["telemetry"]
    Path("mine.toml").write_text(tomlkit.dumps(document), "utf-8")
    found = ss.read_telemetry("export.csv", ss.load_vehicle("mine.toml"))
    expected = ss.read_telemetry("as_expected.csv", right)
    assert list(found["panel"].values) == list(expected["panel"].values)
    np.testing.assert_allclose(found[quantity], expected["power_W"], rtol=1e-4, atol=1e-3)
    assert found.attrs["epoch_utc"] == expected.attrs["epoch_utc"]
    assert '# not read: "mag_x", "mag_y", "T_px"' in section


def test_the_section_for_a_row_for_each_value_reads_the_file():
    rows = list(csv.reader(io.StringIO(export("I_{sign:pn}{axis} [mA]", 0.001))))
    lines = [
        json.dumps({"name": name, "time": row[0], "value": float(cell)})
        for row in rows[1:]
        for name, cell in zip(rows[0][1:6], row[1:6], strict=True)
    ]
    assert Begun("\n".join(lines), "export.jsonl").data["current_A"].shape == (40, 5)


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("Time,panel,current_mA", "{t},{face},{x}"),
        ("Parameter Name,Generation Time,Raw Value,Eng Value", "/SAT/I_{face}_mA,{t},7,{x}"),
        ("time,face,metric,value", "{t},{face},current_mA,{x}\n{t},{face},temperature_C,21"),
        ("time,face,metric,value", "{t},{face},I_{face}_mA,{x}"),
    ],
)
def test_rows_of_one_value_are_known_by_other_names_of_columns_too(header, row):
    lines = [
        row.format(t=SECONDS[k], face=face, x=400 + k + 100 * (face == "xm"))
        for k in range(9)
        for face in ("xp", "xm")
    ]
    data = Begun("\n".join([header, *lines])).data
    np.testing.assert_allclose(data["current_A"].sel(panel="-X"), 0.5 + 0.001 * np.arange(9))


@pytest.mark.parametrize(
    ("names", "quantity"),
    [
        ("Spannung {},Temperatur {},Strom {}", "current_A"),
        ("Tensión {},Temperatura {},Corriente {}", "current_A"),
        ("Tension {},Courant {}", "current_A"),
        ("Spannung {},Leistung {}", "power_W"),
    ],
)
def test_voltages_in_other_languages_are_no_currents(names, quantity):
    """Voltages were taken for powers, as they come first."""
    columns = [name.format(face) for name in names.split(",") for face in ("X+", "X-")]
    cells = ["4,71"] * (len(columns) - 2) + ["412", "100"]
    text = "\n".join([";".join(["Zeit", *columns]), ";".join(["31.01.2026 11:58:00", *cells])])
    form = Begun(text).form
    assert form.quantity == quantity and form.columns["+X"] == columns[-2]


def test_init_from_a_file_knows_its_panels_and_makes_no_inertia_and_no_wheel_up(folder):
    """The comments follow what they explain, and a commented key stays valid when it is opened."""
    text = export("i{AXIS}{sign:pm}", 0.001)
    begun = Begun(text)
    craft = begun.craft
    assert list(craft.panel_names) == ["+X", "-X", "+Y", "-Y", "+Z"]
    assert not craft.wheels and craft.inertia_kg_m2 is None and craft.mass_kg is None
    assert not (folder / "mine" / "telemetry.csv").exists()
    done = CliRunner().invoke(cli, ["check", "mine/vehicle.toml", "export.csv"])
    assert done.exit_code == 0 and "40 samples" in done.output
    again = CliRunner().invoke(cli, ["init", "mine", "--from", "export.csv"])
    assert "is there already" in str(again.exception)
    lines = TEMPLATE.joinpath("vehicle.toml").read_text("utf-8").splitlines()
    before = {line: lines[k - 1] for k, line in enumerate(lines)}
    lines = begun.text.splitlines()
    for first, line in zip(lines, lines[1:], strict=False):
        # a line that continues the remark of a key must not follow another key
        assert not re.match(r"#\s{10}", line) or first == before[line]
    begun.opened("# noise = 0.02", "noise = 0.02")
    assert ss.load_vehicle(begun.path).telemetry.noise == 0.02
    # two satellites of an operator are told apart by their names
    for stem in ("norte", 'a "quoted" name'):
        assert Begun(text, f"{stem}.csv", f"of {stem[0]}").craft.name == stem


NORMALS = {"px": [1, 0, 0], "mx": [-1, 0, 0], "py": [0, 1, 0], "my": [0, -1, 0], "pz": [0, 0, 1]}
ANGLES = {
    "elevation by name, deg": ("elev_{}", "elevation_deg", 1.0),
    "elevation by name, rad": ("elev_{}", "elevation_deg", np.pi / 180),
    "elevation by value": ("sun_{}", "elevation_deg", 1.0),
    "an angle with a sign": ("sun_angle_{}_deg", "elevation_deg", 1.0),
    "incidence by name": ("aoi_{} [deg]", "incidence_deg", 1.0),
    "an angle beyond 90": ("sunAngle_{} (rad)", "incidence_deg", np.pi / 180),
    "cosine by name": ("cos_{}", "cosine", 1.0),
    "cosine by value": ("sun_{}", "cosine", 1.0),
}
"""Form of the columns' names, quantity, and its unit in degrees (of cosines 1)."""


@pytest.mark.parametrize(("form", "quantity", "unit"), ANGLES.values(), ids=ANGLES)
def test_init_from_a_file_of_angles_knows_which_they_are(form, quantity, unit):
    sun = np.random.default_rng(0).normal(size=(20, 3))
    cosine = (sun / np.linalg.norm(sun, axis=1, keepdims=True)) @ np.array(list(NORMALS.values())).T
    angle = np.degrees(np.arcsin(cosine))
    value = {"elevation_deg": angle, "incidence_deg": 90 - angle, "cosine": cosine}[quantity] * unit
    names = "time," + ",".join(map(form.format, NORMALS))
    begun = Begun(table(names, [",".join(f"{x:.5f}" for x in row) for row in value]))
    assert begun.form.quantity == quantity
    found = begun.data["power_W"].sel(panel=[FACES[face] for face in NORMALS]).values
    np.testing.assert_allclose(found, np.maximum(cosine, 0.0), atol=1e-3)


NO_PANELS = "no columns look like currents or powers"
NO_TIMES = "no columns look like times"
SPREADSHEET = "a spreadsheet left minutes and seconds of it"
GRAFANA = "without `Formatted data`"
NO_UNIT = "its unit is not known"
NO_NUMBERS = "column 'iXp' may be of a panel, but its cells are not numbers"
UNREAD = "column 'Time' may hold times, but they cannot be read, such as"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        # a magnetometer has three axes and no signs; a file without times cannot be read
        ("t,mx,my,mz\n2026-01-01T00:00:00Z,1,2,3\n", [NO_PANELS]),
        ("t,a,b,c\n2026-01-01T00:00:00Z,1,2,3\n", [NO_PANELS]),
        ("a,px,nx,b\nnoon,1,2,3\n", [NO_TIMES]),
        ("when,left,right\nnoon,1,2\n", ["when, left, right"]),
        # temperatures below zero are no angles, other readings of a panel no currents
        ("time,T_px,T_mx\n2026-01-01,-10,10\n2026-01-02,9,-9\n", [NO_PANELS]),
        ("time,TXP,TXM\n2026-01-01,20,30\n", [NO_PANELS]),
        ("time,VXP,VXM\n2026-01-01,20,30\n", [NO_PANELS]),
        ("time,U_PX [V],U_MX [V]\n2026-01-01,20,30\n", [NO_PANELS]),
        ("time,T_PX_raw,T_MX_raw\n2026-01-01,20,30\n", [NO_PANELS]),
        ("time,mag_xP,mag_xM\n2026-01-01,20,30\n", [NO_PANELS]),
        # a temperature, a time since the start of the file, days whose time of day is elsewhere
        ("TT_1,seconds_of_day,iXp [mA],iXm [mA]\n20.0,0,1,2\n20.05,1,1,2\n", [NO_TIMES]),
        ("ET,seconds_of_day,iXp [mA],iXm [mA]\n0.0,0,1,2\n10.0,1,1,2\n", [NO_TIMES]),
        ("julian_day,seconds_of_day,iXp [mA],iXm [mA]\n2461000,0,1,2\n2461000,1,1,2\n", [NO_TIMES]),
        (
            "time,iXp [cnt; mA = 0.12*N],iXm [cnt; mA = 0.12*N]\n2026-01-01,20,30\n",
            [NO_UNIT, "scale"],
        ),
        # what a cell is that is no number or no time: spreadsheets show times with a fraction as minutes and seconds
        ("time,iXp,iXm\n2026-01-01,412 mA,412 mA\n", [NO_NUMBERS, "412 mA", GRAFANA]),
        ("time,iXp,iXm\n2026-01-01,0x1f,0x1f\n", [NO_NUMBERS, "0x1f"]),
        ("time,iXp,iXm\n2026-01-01,'412','412'\n", [NO_NUMBERS, "'412'"]),
        ("Time,iXp,iXm\n58:00.3,1,2\n", [f"{UNREAD} '58:00.3'", SPREADSHEET]),
        ("Time,iXp,iXm\n2026-01-31 12:00:00 CET,1,2\n", [f"{UNREAD} '2026-01-31 12:00:00 CET'"]),
    ],
)
def test_a_file_that_says_nothing_on_panels_or_times_is_refused(content, words, template):
    """And nothing is suggested."""
    said = refusal(content)
    assert all(word in said for word in words), said
    for hint in (GRAFANA, SPREADSHEET):
        assert (hint in said) == any(hint in word for word in words)
    if "t,mx" in content or "t,a" in content or "a,px" in content:
        assert "[telemetry]" not in suggested(content)


@pytest.mark.parametrize(
    ("cells", "lines"),
    [
        ("17672256{:02d}", ['time_format = "unix"']),
        ("17672256{:02d}000", ['time_format = "unix"', "time_scale_s = 0.001"]),
        ("1{:02d}", ['time_format = "elapsed"', "REPLACE by the UTC of time zero"]),
        ("61071.000{:02d}", ['time_format = "mjd"']),
        ("740013.500{:02d}", ['time_format = "datenum"']),
        ("6390000000{:02d}000000", ['time_format = "ticks"']),
        ("1341000000{:02d}000000", ['time_format = "filetime"']),
        ("2026/01/01 00:00:{:02d} UTC", ['time_format = "utc"']),
        ("46023.000{:02d}", ['time_format = "excel"']),
        ("31/01/2026 00:00:{:02d}", ['time_format = "utc"', "day_first = true"]),
        ("03/01/2026 00:00:{:02d}", ["day_first = true ", "# check this"]),
        ("20260131,300{:02d}", ['time_format = "elapsed"', 'time_column = "timestamp"']),
    ],
)
def test_the_form_of_times_follows_from_their_size(cells, lines, template):
    names = "date,timestamp" if "," in cells else "timestamp"
    times = [cells.format(k) for k in range(40, 80 if "," in cells else 60)]
    printed = suggested(two_panels(names, times))
    assert all(line in printed for line in lines)


@pytest.mark.parametrize(
    ("columns", "lines"),
    [
        ({"time_gps": "2026-01-01 00:00:18", "utc": "2026-01-01 00:00:00"}, 'time_column = "utc"'),
        ({"Received Time": "2026-01-01 05:00", "Time": "2026-01-01 00:00"}, 'time_column = "Time"'),
        ({"gps_time": "1451260818"}, 'time_format = "gps"'),
        ({"gps_time": "2026-01-01 00:00:18"}, 'time_format = "gps"'),
        ({"GPS Time": "2026-01-01 00:00:18 GPS"}, 'time_format = "gps"'),
        ({"Time (CET)": "2026-01-01 01:00:00"}, 'time_zone = "+01:00"'),
        ({"time UTC-3:30": "2025-12-31 20:30:00"}, 'time_zone = "-03:30"'),
        ({"Date": "2026-01-01", "Time (CET)": "01:00:00"}, 'time_zone = "+01:00"'),
        ({"Time [UTC]": "2026-01-01 00:00:00"}, 'time_format = "utc"'),
        ({"gps_time": "2026-01-01T00:00:00Z"}, 'time_format = "utc"'),
    ],
)
def test_times_of_reception_and_of_GPS_are_not_taken_for_UTC_of_the_samples(columns, lines):
    begun = Begun(two_panels(",".join(columns), [",".join(columns.values())]))
    assert lines in begun.text
    assert begun.data.attrs["epoch_utc"] == "2026-01-01T00:00:00Z"


@pytest.mark.parametrize("fill", ["65535", "-999"])
def test_fill_values_say_nothing_on_the_unit_of_a_column(fill):
    """Currents in A were taken as mA, and every panel as lit."""
    cells = [f"0.4{k:02d},0.001" for k in range(20)]
    cells[3] = f"{fill},{fill}"
    begun = Begun(table("time,i_px,i_mx", cells))
    assert "A, guessed by the size (up to 0.419)" in begun.text
    assert "it reads hardly anything" in begun.text and begun.form.scale == 1.0


def test_a_counter_of_milliseconds_since_the_start_is_no_unix_time(template):
    printed = suggested(two_panels("uptime_ms", 2**32 - 90_000 + 10_000 * np.arange(9)))
    assert 'time_format = "elapsed"' in printed and "time_scale_s = 0.001" in printed


@pytest.mark.parametrize("date", ["2026-01-31", "31.01.2026", "31/01/2026", "01/31/26"])
def test_a_date_and_a_time_of_day_in_two_columns_and_a_row_of_units_are_read(date):
    """Dates alone were taken as times: all samples at midnight."""
    rows = "".join(f"{date},09:15:{k:02d}.125,{300 + k},{200 - k}\n" for k in range(20))
    begun = Begun(f"Date,Time,iXp,iXm\n,,mA,mA\n{rows}")
    assert begun.data.attrs["epoch_utc"] == "2026-01-31T09:15:00.125000Z"
    assert "# not read" not in begun.text
    np.testing.assert_allclose(begun.data["time"], np.arange(20))
    currents = begun.data["current_A"].sel(panel="+X")
    np.testing.assert_allclose(currents, 0.3 + 0.001 * np.arange(20))


@pytest.mark.parametrize(
    ("names", "cells"),
    [
        ("Date,Time,ms", "31.01.2026,09:15:{s:02d},{ms}"),
        ("UTC,Milliseconds", "2026-01-31T09:15:{s:02d}Z,{ms}"),
        ("Time (s),Time (µs)", "{unix},{ms}000"),
        ("timestamp,fraction", "2026-01-31 09:15:{s:02d},0.{ms:03d}"),
        ("obc_time_sec,obc_time_subsec", "{unix},{sub}"),
        ("gps_week,TOW_ms", "2403,{tow}{ms:03d}"),
        ("mjd", "{mjd:.9f}"),
        ("date,time", "20260131,915{s:02d}.{ms:03d}"),
        ("year,month,day,hour,minute,second", "2026,1,31,9,15,{s}.{ms:03d}"),
        ("time,year,month,day,hour,minute,second", "{s},2026,1,31,9,15,{s}.{ms:03d}"),
        ("time_s,year,month,day,hour,minute,second", "{s},2026,1,31,9,15,{s}.{ms:03d}"),
        ("time,date_time", "{s},2026-01-31 09:15:{s:02d}.{ms:03d}"),
        ("year,month,day,hour_of_day,minute,second", "2026,1,31,9,15,{s}.{ms:03d}"),
        ("YYYY,MM,DD,hh,mm,ss,ms", "26,01,31,09,15,{s:02d},{ms}"),
        ("YYYY,DDD,HH,MM,SS,ms", "2026,031,09,15,{s:02d},{ms}"),
        ("Year,DOY,Seconds of day", "2026,31,{day:.3f}"),
        ("year,doy", "2026,{doy:.9f}"),
        ("tv_sec,tv_usec", "{unix},{ms}000"),
        ("header.stamp.secs,header.stamp.nsecs", "{unix},{ms}000000"),
        ("TIMESEC,TIMEUS", "{unix},{ms}000"),
        ("RECEIVED_TIMESECONDS,PACKET_TIMESECONDS", "1769859999.5,{unix}.{ms:03d}"),
        ("WN,SOW,ms", "2403,{tow},{ms}"),
        ("time_jd", "{jd:.10f}"),
        ("time", "{jd:.10f}"),
    ],
)
def test_times_in_several_columns_and_other_counts_are_read_to_the_millisecond(names, cells):
    zero, lines = 1769850900, []  # 2026-01-31T09:15:00Z
    milli = [(370 * k + 991) % 1000 for k in range(20)]
    for k, ms in enumerate(milli):
        counts = {"s": k, "ms": ms, "unix": zero + k, "sub": int(65.536 * ms)}
        counts |= {"tow": (zero + k - 315964800 + 18) % 604800}
        counts |= {"mjd": (zero + k + ms / 1000) / 86400 + 40587}
        counts |= {"jd": counts["mjd"] + 2400000.5, "day": 33300 + k + ms / 1000}
        counts |= {"doy": 31 + counts["day"] / 86400}
        lines.append(f"{cells.format(**counts)},{300 + k},{200 - k},5")
    data = Begun("\n".join([f"{names},iXp [mA],iXm [mA],latency_ms", *lines])).data
    epoch = datetime.fromisoformat(data.attrs["epoch_utc"]).timestamp()
    expected = zero + np.arange(20) + np.array(milli) / 1000
    np.testing.assert_allclose(epoch + data["time"].values, expected, rtol=0, atol=1e-4)


@pytest.mark.parametrize(
    ("first", "second"),
    [("raw", "eng"), ("max", "mean"), ("ADC", "calibrated"), ("min [mA]", "[mA]")],
)
def test_of_several_groups_calibrated_means_are_taken(first, second):
    names = [f"I_{face} {kind}" for kind in (first, second) for face in ("xp", "xn")]
    data = Begun(f"time,{','.join(names)}\n2026-01-01,900,800,400,300\n").data
    assert data["current_A"].values[0].tolist() == [0.4, 0.3]


@pytest.mark.parametrize(
    ("name", "scale"),
    [
        ("time [h]", 3600),
        ("t_min", 60),
        ("uptime_us", 1e-6),
        ("Time (µs)", 1e-6),
        ("time_of_day_ms", 1e-3),
        ("Time of day [s]", None),
        ("mission_day_time", None),
    ],
)
def test_the_unit_in_the_name_of_elapsed_times_is_read(name, scale, template):
    printed = suggested(two_panels(name, range(30, 39)))
    assert re.findall(r"time_scale_s = (\S+)", printed) == ([] if scale is None else [f"{scale:g}"])


MIDSUMMER = 1782000000
"""2026-06-21T00:00:00Z as Unix time."""

GPS = 18 - 315964800
"""Seconds of GPS, less those of Unix."""


@pytest.mark.parametrize(
    ("name", "zero", "noted"),
    [
        ("CUC coarse time", MIDSUMMER + 37 + 378691200, "check time_format: as CUC from 1958"),
        ("time_tai1958_s", MIDSUMMER + 37 + 378691200, ""),
        ("time_gpst_s", MIDSUMMER + GPS, ""),
        ("cuc_time", MIDSUMMER, "as CUC from 1970 the times are of 2026"),
        ("cuc_time", MIDSUMMER + GPS, "as CUC from 1980 the times are of 2026"),
        ("cuc_seconds", MIDSUMMER - 946684800, "as CUC from 2000 the times are of 2026"),
        ("time_tdb", MIDSUMMER + 69.184 - 946728000, ""),
        ("time_tt", MIDSUMMER + 69.184, ""),
        ("ET", MIDSUMMER + 69.184 - 946728000, ""),
        ("time_j2000_s", MIDSUMMER + 69.184 - 946728000, ""),
        ("Time (J2000) [ms]", (MIDSUMMER + 69.184 - 946728000) * 1000, ""),
        ("obt_unix", MIDSUMMER, ""),
        ("obt", MIDSUMMER, ""),
        ("time [µs]", MIDSUMMER * 10**6, ""),
        ("ntp_time", MIDSUMMER + 2208988800, ""),
        ("labview time", MIDSUMMER + 2082844800, ""),
        ("filetime", (MIDSUMMER + 11644473600) * 10**7, ""),
    ],
)
def test_counts_from_other_epochs_than_1970_are_dated_by_the_name_of_the_column(name, zero, noted):
    units = {"(J2000) [ms]": 1000, "µs": 10**6, "file": 10**7}
    unit = next((unit for word, unit in units.items() if word in name), 1)
    begun = Begun(two_panels(name, [zero + 10 * unit * k for k in range(9)]))
    assert noted in begun.output if noted else "note:" not in begun.output
    assert begun.first_s == pytest.approx(MIDSUMMER, abs=1e-3)
    assert np.ptp(begun.data["time"].values) == pytest.approx(80, abs=1e-3)


UNIX_OR_GPS = 'as GPS seconds the times are of 2036, as Unix times ("unix") of 2026'


@pytest.mark.parametrize(
    ("name", "zero", "words"),
    [
        ("obt", MIDSUMMER + GPS, "(GPS) shows 2026"),
        ("time", MIDSUMMER + 2082844800, "as Unix times these are of 2092"),
        ("cuc_time", 12345, ""),
        ("gps_time", MIDSUMMER, UNIX_OR_GPS),
    ],
)
def test_a_count_that_may_have_another_epoch_than_1970_is_named(name, zero, words):
    begun = Begun(two_panels(name, zero + 10 * np.arange(9)))
    assert words in begun.output
    assert words or "REPLACE by the UTC of time zero" in begun.text


def test_TAI_from_1970_is_named_and_read_as_the_note_says():
    begun = Begun(two_panels("time_tai", MIDSUMMER + 37 + 10 * np.arange(9)))
    assert "for TAI from 1970 (2026) set" in begun.output
    (note,) = re.findall(r"for TAI from 1970 .*? set (.*)", begun.text)
    stated = note.replace(", ", "\n").replace(" and ", "\n")
    begun.opened(r'^time_format = "tai".*', lambda _: stated)
    assert begun.first_s == pytest.approx(MIDSUMMER, abs=1e-3)


@pytest.mark.parametrize("name", ["time_tai", "time_tt", "time (TDB)", "gps_time"])
def test_dates_in_another_scale_than_UTC_are_converted_or_named(name):
    ahead_s = {"time_tai": 37.0, "gps_time": 18.0}.get(name, 69.184)
    date = datetime.fromtimestamp(MIDSUMMER + ahead_s, UTC).isoformat().removesuffix("+00:00")
    begun = Begun(two_panels(name, [date]))
    assert "note:" not in begun.output
    assert begun.first_s == pytest.approx(MIDSUMMER, abs=1e-3)
    zulu = Begun(two_panels(name, [f"{date}Z"]), out="utc")
    assert "and the dates UTC, by which they are read" in zulu.output


@pytest.mark.parametrize(("stem", "time_format"), [("sat_gps", "gps"), ("sat", "unix")])
def test_the_name_of_a_file_says_that_old_Unix_times_are_of_GPS(stem, time_format):
    begun = Begun(two_panels("time", MIDSUMMER + GPS + 10 * np.arange(9)), f"{stem}.csv")
    assert ("by the name of the file; as" in begun.output) == (time_format == "gps")
    assert f'time_format = "{time_format}"' in begun.text
    assert time_format == "gps" or "since 1970: 2016" in begun.text


def test_days_of_MJD_from_2000_are_not_of_the_19th_century():
    begun = Begun(two_panels("MJD2000", [f"{9668 + k / 8640:.9f}" for k in range(9)]))
    assert begun.form.epoch_utc == "2000-01-01T00:00:00Z"


@pytest.mark.parametrize("form", ["I_{}_{} [mA]", "{}_string{}_mA", "I{}{}"])
def test_further_strings_of_panels_are_named_and_equal_columns_are_none(form):
    faces = [face.upper() if form == "I{}{}" else face for face in ("xp", "xm", "yp", "ym")]
    names = [form.format(face, string) for face in faces for string in (1, 2)]
    cells = [",".join(str(300 + (7 * k + 11 * c) % 90) for c in range(8)) for k in range(20)]
    output = Begun(table(f"time,{','.join(names)}", cells)).output
    (line,) = [line for line in output.splitlines() if "further strings" in line]
    assert all((f'"{name}"' in line) == (name in names[1::2]) for name in names)
    pairs = [f"{100 + k},{200 - k}" for k in range(20)]
    equal = table("time,iXp,iXm,iXp.1,iXm.1", [f"{pair},{pair}" for pair in pairs])
    assert "strings" not in Begun(equal, out="other").output


def test_faces_with_numbers_and_some_with_two_strings_are_one_group():
    names = "I_xp_1,I_xp_2,I_xm_1,I_xm_2,I_yp,I_ym"
    columns = Begun(f"time,{names}\n2026-01-01,400,3,2,300,9,5\n").form.columns
    assert columns == {"+X": "I_xp_1", "-X": "I_xm_1", "+Y": "I_yp", "-Y": "I_ym"}


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252", "cp850", "cp437"])
def test_microamperes_are_read_in_the_encodings_of_Windows_and_DOS(encoding):
    """Of DOS, the sign for micro is another letter, and the unit was guessed as mA."""
    text = table("time,I xp µA,I xm µA", [f"{400000 - k},{300 + k}" for k in range(20)])
    assert Begun(text.encode(encoding)).form.scale == 1e-6


def test_panels_in_another_unit_than_the_others_are_named():
    names = "I_xp [mA],I_yp [mA],I_xn [A],I_yp [A],P_yn [mW],V_yn [V]"
    text = Begun(f"time,{names}\n2026-01-01,400,300,0.1,0.3,9,5\n").text
    assert '"I_xn [A]"' in text.partition("PANELS IN ANOTHER UNIT")[2].splitlines()[0]


def test_negative_numbers_of_a_converter_are_no_light():
    begun = Begun(table("time,iXp,iXm", [f"{400 - k},{65533 + k % 3}" for k in range(20)]))
    assert begun.data["current_A"].sel(panel="-X").values.max() < 0
    with pytest.raises(SunspinError, match="negative numbers .*set wraps_at = 65536"):
        begun.opened("^wraps_at.*$", "")


@pytest.mark.parametrize(
    ("unit", "scale"), [("[10 uA]", 1e-5), ("(x0.122 mA)", 1.22e-4), ("[0.5 mA/LSB]", 5e-4)]
)
def test_a_multiple_in_the_unit_of_a_column_is_the_scale(unit, scale):
    form = Begun(f"time,iXp_raw {unit},iXm_raw {unit}\n2026-01-01,2000,300\n").form
    assert (form.quantity, form.scale) == ("current_A", pytest.approx(scale))


@pytest.mark.parametrize("unit", ["Zähler", "cuentas", "digits", "DN"])
def test_a_unit_of_counts_in_another_language_is_one(unit):
    form = Begun(f"time,I +X ({unit}),I -X ({unit})\n2026-01-01,2000,300\n").form
    assert (form.quantity, form.scale) == ("current_A", 1.0)


def test_init_from_a_file_names_other_sensors_in_comments_that_can_be_opened():
    """A gyro in deg/s, a magnetometer in nT. No unit is invented for raw counts, and times in milliseconds are read."""
    names, *rows = csv.reader(io.StringIO(export("adc_{sign:pm}{axis}", 0.001)))
    sensors = [*(f"gyr_{a}_dps" for a in "xyz"), *(f"MAG_{a} [nT]" for a in "XYZ")]
    times = [1767225600000 + 20000 * k for k in range(len(rows))]
    read = [f"{','.join(row[1:6])},1.5,-2,3,20000,-5000,30000" for row in rows]
    begun = Begun(table(",".join(["ts_ms", *names[1:6], *sensors]), read, times))
    assert begun.form.quantity == "current_A" and begun.form.scale == 1.0
    assert begun.data.attrs["epoch_utc"].startswith("2026-01-01T00:00:00")
    assert 1000.0 < begun.data["current_A"].max() < 10000.0
    assert "[gyro], [magnetometer]" in begun.output and "field_B" not in begun.data
    keys = r"\[gyro\]|\[magnetometer\]|columns = .*(gyr_x|MAG_X)|scale_T|scale_rad_s = .*rate = "
    data = begun.opened(rf"^# (?={keys}|noise_rad_s = 8e-4)", "")
    np.testing.assert_allclose(data["gyro_B"].values[0], np.radians([1.5, -2.0, 3.0]), rtol=1e-5)
    assert ss.load_vehicle(begun.path).sensors.magnetometer.scale_T == 1e-9
    np.testing.assert_allclose(data["field_B"].values[0], [20000, -5000, 30000])


@pytest.mark.parametrize(
    ("gyro", "field", "sizes"),
    [
        ("adcs.gyro_{}_dps", "adcs.mag_{}_uT", ("0.0174533", "1e-06")),
        ("gyro_{}_deg_s", "/SAT/adcs/mag_{}_nT", ("0.0174533", "1e-09")),
        ("rate_{}_rad_s", "mag_{}_T", ("1", "1")),
        ("gyro_{} mdps", "Mag {} (mGauss)", ("1.74533e-05", "1e-07")),
    ],
)
def test_the_unit_in_the_names_of_a_sensors_columns_is_its_scale(gyro, field, sizes):
    """`uT` is microtesla and no word `u` before tesla."""
    names = ",".join(sensor.format(axis) for sensor in (gyro, field) for axis in "xyz")
    file = table(
        f"time,i_xp_A,i_xm_A,{names}", [f"{0.4 - k},{k},1,2,3,20,-5,30" for k in range(20)]
    )
    text = Begun(file).text
    found = re.findall(r"^# (?:scale_rad_s = (\S+) +# rate|scale_T = (\S+))", text, re.MULTILINE)
    assert ("".join(found[0]), "".join(found[1])) == sizes


@pytest.mark.parametrize(
    ("names", "cells", "wings"),
    [
        ("i_xp_ma,i_xm_ma,i_wing1_ma,i_wing2_ma,u_wing1_mv,i_xp_mv", "{},8000,3300", [3, 4]),
        ("Panel +X Current,Panel -X Current,Wing 1 Current,Wing 1 Temperature", "8000", [3]),
        ("Strom +X [mA],Strom -X [mA],Strom Flügel 1 [mA],Spannung Flügel 1 [mV]", "8000", [3]),
    ],
)
def test_init_names_columns_that_differ_from_those_of_panels_only_in_the_face(names, cells, wings):
    """In other words than `panel` too: wings, by the number of their column. Neither voltages nor temperatures are named."""
    rows = [f"400,0,{300 + k},{cells.format(20 + k)}" for k in range(20)]
    text = Begun(table(f"time,{names}", rows)).text
    (line,) = re.findall("^# perhaps panels.*", text, re.MULTILINE)
    named = ", ".join(f'"{names.split(",")[column - 1]}"' for column in wings)
    assert line.endswith(f"each needs a [[panel]]: {named}")


@pytest.mark.parametrize(
    ("stronger", "gain", "is_named"),
    [
        (1.0, "relative_gain = 1", True),
        (3.5, "relative_gain = 1", False),
        (1.0, "cells = 2", False),
    ],
)
def test_check_names_a_panel_whose_placeholder_gain_its_readings_deny(stronger, gain, is_named):
    rows = list(csv.reader(io.StringIO(export("i{AXIS}{sign:pm}", 0.001))))
    for row in rows[1:]:
        # +Z of the example has 2 cells, the others have 7
        row[5] = str(stronger * float(row[5]))
    begun = Begun("\n".join(map(",".join, rows)))
    # without -Y the data determine no gain
    text = begun.text
    begin = text.index('[[panel]]\nname = "-Y"')
    text = text[:begin] + text[text.index('[[panel]]\nname = "+Z"') :]
    text = text.replace('"-Y" = "iYm"\n', "").replace("relative_gain = 1.0 ", f"{gain} ")
    begun.path.write_text(text, "utf-8")
    done = CliRunner().invoke(cli, ["check", str(begun.path), "export.csv"])
    assert done.exit_code == 0, done.output
    assert ("GAINS NOT KNOWN" in done.output) == is_named
    assert not is_named or "if +Z has" in done.output
