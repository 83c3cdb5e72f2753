"""Frames decoded by the program of satnogs-decoders: a stand-in with its documented output, and the program itself if installed."""

import csv
import json
import os
import shutil
import stat
import struct
import sys
import tomllib

import pytest
from click.testing import CliRunner

import sunspin as ss
from sunspin.base.tables import read_table
from sunspin.cli import cli
from sunspin.telemetry.decoders import satnogs
from sunspin.telemetry.decoders.satnogs import Decoded, decode_by_program, decoded_csv
from sunspin.telemetry.decoders.skcube import KINDS, decode_beacons

STAND_IN = f"""#!{sys.executable}
import csv, json, sys
name, option, file, *rest = sys.argv[1:]
assert option == "--filename" and rest == ["--format", "csv", "-v"], sys.argv
points = []
for time, digits in csv.reader(open(file, encoding="utf-8"), delimiter="|"):
    content = bytes.fromhex(digits)
    print(f"Decoding frame (l={{len(content)}}):{{digits}}\\n", file=sys.stderr)
    why = None if name.capitalize() == "Cubesat" else f"module 'satnogsdecoders.decoder' has no attribute '{{name.capitalize()}}'"
    if why is None and len(content) < 3:
        why = f"requested 3 bytes, but only {{len(content)}} bytes available"
    if why:
        print("^~~~ Invalid frame!", file=sys.stderr)
        print(why, file=sys.stderr)
        continue
    kind, x, y = content[:3]
    fields = {{"panel_x_plus_current": x, "panel_y_plus_current": y}} if kind == 1 else {{"call": "OM,3", "bins": [x, y]}}
    tags = {{"satellite": "", "decoder": name, "station": "", "observer": "", "source": "", "version": "9.9"}}
    points.append({{"time": time, "measurement": "", "tags": tags, "fields": fields}})
print(json.dumps(points, indent=4))
"""
"""Program with the call and the output of `decode_multiple` 1.131."""


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Put a program decode_multiple into a folder, which becomes the first of PATH."""

    def put(text=STAND_IN):
        program = tmp_path / "decode_multiple"
        program.write_text(text, encoding="utf-8")
        program.chmod(program.stat().st_mode | stat.S_IXUSR)
        monkeypatch.setenv("PATH", os.pathsep.join([str(tmp_path), os.environ["PATH"]]))

    return put


@pytest.fixture
def raw(tmp_path):
    """Frames of SatNOGS DB, not in the order of their times."""
    path = tmp_path / "frames.csv"
    frames = ["2026-01-01 00:01:00|010a14", "2026-01-01 00:03:00|01", "2026-01-01 00:00:00|010b15"]
    frames += ["2026-01-01 00:04:00|0102", "2026-01-01 00:02:00|02161f"]
    path.write_text("\n".join(frames) + "\n", encoding="utf-8")
    return path


def decode(*arguments):
    """Run `sunspin decode`; return exit code, standard output and the one sentence of an error."""
    done = CliRunner().invoke(cli, ["decode", *map(str, arguments)])
    return done.exit_code, done.output, str(done.exception or "")


def test_frames_are_decoded_with_their_own_times_and_bad_ones_are_counted(raw, install):
    """The table has a column for each field, and empty cells without it."""
    install()
    decoded = decode_by_program("cubesat", raw)
    assert [time - 1767225600 for time, *_ in decoded.rows] == [0, 60, 120]
    assert decoded.rows[0][2] == {"panel_x_plus_current": 11, "panel_y_plus_current": 21}
    assert decoded.unread == {"requested N bytes, but only N bytes available": 2}
    assert decoded.version == "9.9"
    rows = list(csv.DictReader(decoded_csv(decoded).splitlines()))
    assert list(rows[0]) == (
        "received_utc station panel_x_plus_current panel_y_plus_current call bins".split()
    )
    assert [row["panel_x_plus_current"] for row in rows] == ["11", "10", ""]
    assert rows[2]["call"] == "OM;3" and rows[2]["bins"] == "[22 31]"
    with pytest.raises(ss.InputError, match=r"no decoder of this name \(found nosuch\)"):
        decode_by_program("nosuch", raw)


def test_the_command_writes_a_table_and_a_column_map_from_which_init_makes_a_vehicle(
    raw, tmp_path, install
):
    install()
    out = tmp_path / "out"
    code, printed, _ = decode(raw, "--decoder", "cubesat", "--out", out, "--json")
    summary = json.loads(printed)
    assert code == 0 and summary["frames"] == 3 and summary["satnogs_decoders"] == "9.9"
    table = (out / "cubesat.csv").read_text("utf-8").splitlines()
    assert next(csv.DictReader(table))["received_utc"] == "2026-01-01T00:00:00.000Z"
    section = tomllib.loads((out / "cubesat_columns.toml").read_text("utf-8"))["telemetry"]
    assert section["time_column"] == "received_utc" and section["quantity"] == "current_A"
    assert section["columns"] == {"+X": "panel_x_plus_current", "+Y": "panel_y_plus_current"}
    words = ["init", str(tmp_path / "mine"), "--from", str(out / "cubesat.csv")]
    assert CliRunner().invoke(cli, words).exit_code == 0
    assert ss.load_vehicle(tmp_path / "mine" / "vehicle.toml").panel_names == ("+X", "+Y")


def test_without_the_program_one_sentence_says_what_to_install(raw, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    code, printed, why = decode(raw, "--decoder", "cubesat", "--out", tmp_path / "out")
    assert code != 0 and printed == "" and "\n" not in why
    assert "satnogs-decoders, which is not installed; install it with pipx install" in why
    assert not (tmp_path / "out").exists()


def test_a_folder_that_is_not_ours_is_refused_before_the_program_runs(raw, tmp_path, install):
    started = tmp_path / "started"
    install(f"#!{sys.executable}\nopen({str(started)!r}, 'w')\n")
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis.txt").write_text("mine", "utf-8")
    code, _, why = decode(raw, "--decoder", "cubesat", "--out", other)
    assert code != 0 and "not empty and not a results folder" in why and not started.exists()


def test_only_names_reach_the_program(raw, install, tmp_path, monkeypatch):
    install(f"#!{sys.executable}\nraise SystemExit('started')\n")
    for name in ("--help", "../skcube", "a b", "", "x;ls"):
        with pytest.raises(ss.InputError, match="a name of letters"):
            decode_by_program(name, raw)
    monkeypatch.chdir(tmp_path)
    code, _, why = decode(raw, "--decoder", "a b")
    assert code != 0 and "a name of letters" in why and not (tmp_path / "a b").exists()


@pytest.mark.parametrize(
    "body",
    [
        "raise SystemExit('broken')",
        "print('no JSON')",
        "print('[1]')",
        'print(\'[{"time": "7", "fields": {}, "tags": {}}]\')',
        'print(\'[{"time": "0", "fields": 3, "tags": {}}]\')',
        'print(\'[{"time": "0", "fields": {}, "tags": 1}]\')',
    ],
)
def test_a_program_that_fails_or_prints_something_else_is_refused(body, raw, install):
    install(f"#!{sys.executable}\n{body}\n")
    with pytest.raises(ss.InputError, match="failed or printed something unknown"):
        decode_by_program("cubesat", raw)


def test_a_program_that_does_not_end_is_ended(raw, install, monkeypatch):
    install(f"#!{sys.executable}\nimport time\ntime.sleep(60)\n")
    monkeypatch.setattr(satnogs, "START_S", 0.2)
    with pytest.raises(ss.InputError, match="does not end: 5 frames"):
        decode_by_program("cubesat", raw)


AX25 = bytes.fromhex("9e9a66968282e09e9a72a682a86103f0")
"""Header of skCUBE's frames."""

PUBLIC = {
    "ADCS": "adcs_mode bd_k",
    "COM": (
        "timestamp fwversion activecom digipeatermode noofreboots outputreflpower outputforwardpower outputreflpowercw "
        "outputforwardpowercw rssi rssinoise mcutemperature patemperature cwbeaconsent packetsent correctpacketsreceived "
        "brokenpacketsreceived comprotocolerror gsprotocolerror txdisablestatus orbittime timeslotstart timeslotend"
    ),
    "PWR": (
        "timestamp fulluptime uptime active_procesor fw_version number_of_reboots countcomerrors countpsuerrors solar_j_current "
        "solar_k_current solar_l_current solar_m_current solar_u_current solar_d_current solar_j_temp solar_k_temp solar_l_temp "
        "solar_m_temp solar_u_temp solar_d_temp battery_a_voltage battery_b_voltage battery_temp - battery_a_capacity "
        "bat_capacity battery_a_current battery_b_current battery_a_min_current battery_b_min_current battery_a_max_current "
        "battery_b_max_current battery_a_avg_current battery_b_avg_current chds_min_current chds_max_current chds_avg_current "
        "chds_actual_current - - - - cam_min_current cam_max_current cam_avg_current cam_actual_current exp_min_current "
        "exp_max_current exp_avg_current exp_actual_current adcs_min_current adcs_max_current adcs_avg_current "
        "adcs_actual_current sys_voltage_min sys_voltage_max sys_voltage_actual nadprudy stav_pripojenia ts_temp countpacket "
        "psu_error psu_lasterror com_error com_lasterror"
    ),
}
"""Names by which the public decoder prints our fields in the order of `KINDS`; - for those that it does not print.

It is asked for with a capital letter, as `skcube` is our own. Its layout of PWR is longer than ours, which ends with `endofdata`.
Its layout of ADCS has one byte for each of the three coils, the field list of the team two, so that the later fields are
shifted. With two bytes Sun sensors and gyro agree with the panels.
"""

needs_program = pytest.mark.skipif(
    shutil.which(satnogs.PROGRAM) is None, reason="needs satnogs-decoders"
)


def both_decoders(path, kind):
    """Yield our fields and the public ones of each beacon of a kind."""
    number = {"ADCS": 2, "COM": 3, "PWR": 5}[kind]
    decoded = decode_by_program("Skcube", path)
    public = [fields for *_, fields in decoded.rows if int(fields["packet_type"]) == number]
    ours = [values for *_, values in decode_beacons(path).rows[kind]]
    assert len(ours) == len(public) > 0
    yield from zip(ours, public, strict=True)


def assert_agreement(ours, public, kind):
    """Assert that the fields that the public decoder prints are ours."""
    for name, value in zip(PUBLIC[kind].split(), ours, strict=False):
        assert name == "-" or int(public[name]) == value, name


@needs_program
@pytest.mark.parametrize("kind", PUBLIC)
def test_our_decoder_of_skcube_agrees_with_the_public_one(kind, tmp_path):
    form, names = KINDS[kind]
    values = [3 + k for k in range(len(names))]
    content = AX25 + bytes([{"ADCS": 2, "COM": 3, "PWR": 5}[kind]]) + form.pack(*values)
    raw = tmp_path / "frames.csv"
    raw.write_text(f"2017-06-23 07:02:55|{(content + bytes(40)).hex()}\n", encoding="utf-8")
    ((ours, public),) = both_decoders(raw, kind)
    assert list(ours) == values
    assert_agreement(ours, public, kind)


@needs_program
@pytest.mark.real_data
def test_our_decoder_of_skcube_agrees_with_the_public_one_on_real_beacons(data_dir):
    raw = data_dir / "skcube" / "skcube_raw_23_27_june.zip"
    beacons = list(both_decoders(raw, "COM"))
    assert len(beacons) == 301
    for ours, public in beacons:
        assert_agreement(ours, public, "COM")
    for ours, public in both_decoders(raw, "ADCS"):
        assert_agreement(ours, public, "ADCS")
        coils = struct.pack("<hhh", *ours[2:5])
        assert bytes(public[f"max_pwm_coil_{axis}"] for axis in "xyz") == coils[:3]


def test_text_from_the_radio_cannot_break_the_table(tmp_path):
    fields = {"call": "OM\x00KSK\x85\u2028\x1c", "station": "of the satellite"}
    path = tmp_path / "decoded.csv"
    text = decoded_csv(Decoded([(1767225600.0, "graz", fields)], {}, ""))
    path.write_text(text, encoding="utf-8")
    table = read_table(path)
    assert table.header == ["received_utc", "station", "call", "decoded_station"]
    cells = [cell.strip() for cell in table.cells.iloc[0]]
    assert cells[1:] == ["graz", "OM KSK", "of the satellite"]
