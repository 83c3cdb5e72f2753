"""skCUBE, June 2017, real telemetry: the decoder, currents compared with Sun sensors, rates with the gyro."""

import csv
import json
import zipfile

import numpy as np
import pytest
from click.testing import CliRunner

import sunspin as ss
from studies.skcube_gyro import fit, neighbouring_beacons
from sunspin.cli.decode import decode
from sunspin.telemetry.decoders.skcube import KINDS, beacons_csv, decode_beacons

FREE_S, LAST_S = 219_600, 476_000
"""The coils were off from the pass of 25 June 20:13 UTC on, the last two passes begin on 28 June 19:18: seconds after the first
beacon of the file."""


def frame(kind, fields):
    content = bytes(18) + bytes([kind]) + fields
    return content.replace(b"\xdb", b"\xdb\xdd").replace(b"\xc0", b"\xdb\xdc")


TYPE = {"CDHS": 1, "ADCS": 2, "COM": 3, "PWR": 5}


def numbers(kind):
    """Fields of a beacon, each another."""
    return list(range(len(KINDS[kind][1])))


def test_the_decoder_removes_escapes_and_counts_unreadable_frames(tmp_path):
    adcs, form = numbers("ADCS"), KINDS["ADCS"][0]
    adcs[2] = -16320  # C0 40 in two bytes, little endian: an escape inside a field
    raw = tmp_path / "raw.zip"
    with zipfile.ZipFile(raw, "w") as archive:
        archive.writestr("1498201375_OM3KAA__skCUBE.gsr", frame(2, form.pack(*adcs)))
        archive.writestr("1498201376_OM3KAA__skCUBE.gsr", frame(2, form.pack(*adcs)[:20]))
        archive.writestr("1498201377_OM3KAA__skCUBE.gsr", frame(1, b"whatever"))
        archive.writestr("1498201378_OM3KAA__skCUBE.gsr", b"")
        archive.writestr("1498201379_OM3KAA__skCUBE.gsr", frame(4, b"\x01\x02"))
        archive.writestr("notes.txt", b"no beacon")
    beacons = decode_beacons(raw)
    assert beacons.rows["ADCS"] == [(1498201375, "OM3KAA", tuple(adcs))]
    assert beacons.counts == {"ADCS": 1, "other": 1} and sum(beacons.unread.values()) == 4
    assert beacons_csv(beacons, "ADCS").splitlines()[0].startswith("unix_s_rx,station,adcsMode")
    others = beacons_csv(beacons, "other").splitlines()
    assert others == ["unix_s_rx,station,frame", "1498201379,OM3KAA,040102"]


@pytest.mark.parametrize("form", ["csv", "page", "lines"])
def test_decode_writes_every_kind_of_beacon_of_a_satnogs_export(form, tmp_path):
    frames = []
    for k, (kind, (packed, _)) in enumerate(KINDS.items()):
        content = bytes(16) + bytes([TYPE[kind]]) + packed.pack(*numbers(kind))
        frames.append((f"2017-06-23 07:02:5{k}", content.hex().upper()))
    objects = [
        {"timestamp": t.replace(" ", "T") + "Z", "frame": digits, "observer": "OM3KAA"}
        for t, digits in frames
    ]
    text = {
        "csv": "".join(f"{t}|{digits}\n" for t, digits in frames),
        "page": json.dumps({"next": None, "results": objects}),
        "lines": "\n".join(map(json.dumps, objects)),
    }
    raw = tmp_path / "export"
    raw.write_text(text[form])
    words = [str(raw), "--out", str(tmp_path / "out"), "--json"]
    done = CliRunner().invoke(decode, words, catch_exceptions=False)
    assert json.loads(done.stdout)["frames"] == dict.fromkeys(KINDS, 1)
    for k, kind in enumerate(KINDS):
        with open(tmp_path / "out" / f"skcube_{kind.lower()}.csv", encoding="utf-8") as file:
            (row,) = csv.DictReader(file)
        assert float(row.pop("unix_s_rx")) == 1498201370 + k
        assert row.pop("station") == ("" if form == "csv" else "OM3KAA")
        assert row == {name: str(n) for name, n in zip(KINDS[kind][1], numbers(kind), strict=True)}


HOSTILE = (
    '{"timestamp": "2017-06-23T07:02:55Z", "frame": "xyz"}',  # not hexadecimal
    '[{"timestamp": "2017-06-23T07:02:55Z"}]',  # no frames
    "2017-06-23 07:02:55|00FF\nnonsense\n",
    '{"timestamp": ',
)


def test_a_damaged_export_and_a_file_without_beacons_are_refused_in_one_sentence(tmp_path):
    contents = {text.encode(): "export" for text in HOSTILE}
    contents |= {b"": "raw beacons cannot be read", b"PK\x03\x04 cut off": "cannot be read"}
    for content, words in contents.items():
        (tmp_path / "export").write_bytes(content)
        with pytest.raises(ss.TelemetryError, match=words) as told:
            decode_beacons(tmp_path / "export")
        assert "\n" not in str(told.value)
    (tmp_path / "empty").mkdir()
    with pytest.raises(ss.TelemetryError, match="no raw beacon here"):
        decode_beacons(tmp_path / "empty")


@pytest.mark.evidence("decode", "validated", "the published table of skCUBE's attitude beacons")
@pytest.mark.real_data
def test_the_decoded_table_equals_the_published_one(data_dir, reached):
    beacons = decode_beacons(data_dir / "skcube" / "skcube_raw_23_27_june.zip")
    assert beacons.counts == {"ADCS": 252, "CDHS": 265, "COM": 301}
    assert set(beacons.unread) == {"too short for a beacon"}
    ours = beacons_csv(beacons, "ADCS").splitlines()
    theirs = (data_dir / "skcube" / "skcube_adcs.csv").read_text().splitlines()[: len(ours)]
    assert ours == theirs
    reached("beacons equal in every number", len(beacons.rows["ADCS"]))


@pytest.fixture(scope="module")
def free_passes(data_dir):
    """Rates from the Sun sensors (and the magnetometer's torque) of passes of free motion, without the gyro; and it.

    Passes of seven samples or more where the gyro was read, and the last two of all.
    """
    craft = ss.load_vehicle("skcube")
    data = ss.read_telemetry(data_dir / "skcube" / "skcube_adcs.csv", craft)
    data = data.isel(time=data["time"].values > FREE_S)
    time = data["time"].values
    number = np.cumsum(np.diff(time, prepend=time[0]) > 1200)
    known = np.isfinite(data["gyro_B"].values).all(axis=1)
    data = data.isel(time=(np.bincount(number)[number] >= 7) & (known | (time > LAST_S)))
    return ss.rates(craft, data.drop_vars("gyro_B")), data


@pytest.mark.evidence(
    "rates", "validated", "the gyro of skCUBE, 25 to 27 June 2017 (calibrated on the same passes)"
)
@pytest.mark.real_data
def test_rates_from_sun_sensors_agree_with_the_gyro(free_passes, reached):
    """The eight passes of 25 to 27 June with seven samples or more: the figures rest on 78 samples of them."""
    result, data = free_passes
    gyro = data["gyro_B"].sel(time=result["time"]).values
    known = np.isfinite(gyro).all(axis=1)
    count = np.bincount(result["pass_of"].values)[result["pass_of"].values]
    use = known & (count >= 7)
    assert 70 <= use.sum() <= 110
    error = np.degrees(result["omega_B"].values - gyro)[use]
    # deg/s; the rates are 0.5 to 1.2 deg/s
    assert np.all(np.median(np.abs(error), axis=0) < [0.16, 0.14, 0.18])
    # coverage: error of a pass's mean against what it says, all modes counted, and the gyro's own zero (0.05 deg/s)
    square = []
    for number in np.unique(result["pass_of"].values[use]):
        at = result["pass_of"].values == number
        miss = np.degrees((result["omega_B"].values - gyro)[at].mean(axis=0))
        sigma = np.degrees(result["omega_sigma_all_B"].values[number])
        square.append((miss / np.hypot(sigma, 0.05)) ** 2)
    assert 0.2 < np.mean(square) < 2.5
    reached("median error, worst axis", np.median(np.abs(error), axis=0), "deg/s")
    reached("squared error over stated variance", np.mean(square))
    reached("samples", use.sum())


@pytest.mark.evidence("rates", "validated", "the Sun sensors of skCUBE, 28 June 2017: two passes")
@pytest.mark.real_data
def test_currents_of_28_june_agree_with_the_sun_sensors(data_dir, free_passes, reached):
    """Only the passes just out of eclipse say something: 16 samples; the rest is dropped and says why."""
    craft = ss.load_vehicle("skcube")
    data = ss.read_telemetry(data_dir / "skcube" / "skcube_pwr.csv", craft)
    result = ss.rates(craft, data)
    why = result["why"].values
    assert sum(text == "used" for text in why) == 8
    assert sum("far below full Sun" in text for text in why) == 35
    assert result.sizes["pass_id"] == 2
    sensors, _ = free_passes
    begin, end = (np.datetime64(each.attrs["epoch_utc"][:-1]) for each in (sensors, data))
    start = result["time"].values + (end - begin) / np.timedelta64(1, "s")
    for number in range(2):
        when = start[result["pass_of"].values == number].mean()
        nearest = int(np.abs(sensors["time"].values - when).argmin())
        other = int(sensors["pass_of"].values[nearest])
        miss = result["omega_mean_B"].values[number, 0] - sensors["omega_mean_B"].values[other, 0]
        pair = (result, number), (sensors, other)
        sigma = np.hypot(*(one["omega_sigma_all_B"].values[k] for one, k in pair))
        assert np.all(np.abs(miss[:2]) < 2 * sigma[:2])
        assert np.abs(miss[2]) < 3 * sigma[2]
        reached("difference in stated sigma, worst axis", np.abs(miss / sigma), "", 3.0)


@pytest.mark.evidence(
    "rates",
    "validated",
    "skCUBE's Sun sensors, 23 to 27 June: the simpler fit of studies/skcube_gyro.py",
)
@pytest.mark.real_data
@pytest.mark.long  # the quick test of the gyro's scale is that of the rates above, which are held against it
def test_scale_and_zero_of_the_gyro_are_those_that_propagate_the_measured_sun(data_dir, reached):
    """140 pairs of beacons, the gyro of 28 June not read; the vehicle file's values agree within two sigma of both."""
    craft = ss.load_vehicle("skcube")
    data = ss.read_telemetry(data_dir / "skcube" / "skcube_adcs.csv", craft)
    found = neighbouring_beacons(craft, data)
    assert len(found.t_s) == 140 and found.day.max() < np.datetime64("2017-06-28")
    value, sigma, cost = fit(found, craft.sensors.disturbance.acceleration_noise)
    gyro = craft.sensors.gyro
    stated = np.array([np.degrees(gyro.scale_rad_s), *gyro.zero])
    both = np.hypot(sigma, [np.degrees(gyro.scale_sigma), *gyro.zero_sigma])
    assert np.all(np.abs(value - stated) < 2 * both)
    reached("scale, deg/s per count", value[0])
    # the control: the Sun carried the wrong way fits worse
    turned = found._replace(first=found.second, second=found.first)
    assert fit(turned, craft.sensors.disturbance.acceleration_noise)[2] > cost + 10
