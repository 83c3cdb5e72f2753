"""Exports read by SPICE, by another reader of the CCSDS message, by xarray and pyarrow. Telemetry is synthetic."""

import json
import re
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.cli import cli
from sunspin.output.export import (
    LOCAL_FRAME,
    build_attitude,
    read_attitude_data,
    write_cf,
    write_parquet,
)
from sunspin.output.export.aem import write_aem
from sunspin.output.export.against import against_kernels, against_message
from sunspin.output.export.attitude_message import read_message
from sunspin.output.export.ck import ephemeris_time, write_ck
from sunspin.vehicle import Vehicle
from tests.output.test_export_interpolation import by_spice

BODY = Vehicle("made up", inertia_kg_m2=np.diag([0.04, 0.05, 0.03]))


def motion(t_s, omega_x=0.02):
    return ss.propagate(BODY, [omega_x, -0.05, 0.03], [0.0, 0.6, 0.8], None, t_s)


@pytest.fixture(scope="module")
def result():
    run = motion(np.arange(0, 100, 2.5))
    run = run.assign(pass_of=("time", (run["time"].values > 50).astype(int)))
    run.attrs |= {"epoch_utc": "2014-11-12T15:34:04Z", "synthetic": 1, "vehicle": "made up"}
    return run


def matrix_of_standard(q):
    """CCSDS 504.0-B: direction cosines of frame B in frame A from a quaternion, scalar last; typed from the standard."""
    a, b, c, d = q
    return np.array(
        [
            [a * a - b * b - c * c + d * d, 2 * (a * b + c * d), 2 * (a * c - b * d)],
            [2 * (a * b - c * d), -a * a + b * b - c * c + d * d, 2 * (b * c + a * d)],
            [2 * (a * c + b * d), 2 * (b * c - a * d), -a * a - b * b + c * c + d * d],
        ]
    )


def body_from_n(result):
    return Rotation.from_quat(result["B_from_N"].values).as_matrix()


def quaternions(text, form):
    """The quaternions (n, 4) of a message, scalar last."""
    if form == "xml":
        path = "./body/segment/data/attitudeState/quaternionEphemeris/quaternion"
        states = ElementTree.fromstring(text).findall(path)
        rows = [[state.find(key).text for key in ("Q1", "Q2", "Q3", "QC")] for state in states]
    else:
        rows = [line.split()[1:] for line in text.splitlines() if line.startswith("2014-11-12T")]
    return np.array(rows, dtype=float)


@pytest.mark.parametrize("form", ["1.0", "2.0", "xml"])
def test_an_attitude_message_read_by_its_standard_gives_the_motion(form, result, tmp_path):
    text = write_aem(tmp_path / "a.aem", build_attitude(result), form).read_text()
    rotations = np.array([matrix_of_standard(q) for q in quaternions(text, form)])
    assert np.abs(rotations - body_from_n(result)).max() < 1e-9
    assert "synthetic" in text and LOCAL_FRAME in text and "2014-11-12T15:34:06.500000" in text
    if form == "xml":
        root = ElementTree.fromstring(text)
        assert root.attrib == {"id": "CCSDS_AEM_VERS", "version": "2.0"}
    else:
        assert text.startswith(f"CCSDS_AEM_VERS = {form}\n")
        assert ("QUATERNION_TYPE = LAST" in text) is ("ATTITUDE_DIR" in text) is (form == "1.0")
        assert text.count("META_START") == text.count("DATA_STOP") == 2
    # the Sun stands at (0, 0.6, 0.8) of the body at the start, whose axes are those of N
    assert "those of the body at the start" in text and "Sun" not in text
    assert np.allclose(body_from_n(result)[0], np.eye(3), rtol=0, atol=1e-12)


@pytest.mark.evidence("export", "validated", "ccsds-ndm reads the message back")
@pytest.mark.parametrize("form", ["1.0", "xml"])  # it cannot read KVN of version 2.0
def test_another_library_reads_the_attitude_message(form, result, tmp_path):
    ndm_io = pytest.importorskip("ccsds_ndm.ndm_io")
    path = write_aem(tmp_path / "a.aem", build_attitude(result), form)
    segments = ndm_io.NdmIo().from_path(path).body.segment
    assert len(segments) == 2 and segments[0].metadata.ref_frame_a == LOCAL_FRAME
    state = segments[0].data.attitude_state[1]
    q = (state.quaternion_state if form == "1.0" else state.quaternion_ephemeris).quaternion
    rotation = matrix_of_standard([q.q1, q.q2, q.q3, q.qc])
    assert np.abs(rotation - body_from_n(result)[1]).max() < 1e-9


def test_a_motion_simulated_backward_is_exported_in_the_order_of_time(tmp_path, undrawn):
    run = motion(-np.arange(0, 100, 2.5))
    assert not np.signbit(run["time"].values[0])  # zero, which would else be printed as -0
    data, _ = read_attitude_data(run.sunspin.save(tmp_path / "results"))
    back = build_attitude(data, epoch_utc="2026-01-01T00:00:00Z")
    assert back.t_s[0] == -97.5 and np.array_equal(back.omega_B[-1], run["omega_B"].values[0])
    with xr.open_dataset(write_cf(tmp_path / "a.nc", data, back)) as written:
        assert np.array_equal(written["omega_B"].values, back.omega_B)


@pytest.mark.evidence("export", "validated", "NAIF's SPICE reads the kernels back")
def test_spice_reads_its_kernels_back(result, tmp_path, reached):
    sp = pytest.importorskip("spiceypy")
    attitude, epoch = build_attitude(result), result.attrs["epoch_utc"]
    kernels = write_ck(tmp_path, attitude)
    found, rates = by_spice(kernels, epoch, attitude.t_s)
    difference = np.abs(found.as_matrix() - body_from_n(result))
    reached("largest difference of a matrix element", difference, "", 1e-9)
    assert difference.max() < 1e-9 and np.abs(rates - attitude.omega_B).max() < 1e-9
    with pytest.raises(sp.exceptions.SpiceyError):  # the local frame has no place in the sky
        by_spice(kernels, epoch, attitude.t_s[:1], "J2000")


def test_a_kernel_covers_the_ends_of_passes_also_after_a_leap_second(sparse, tmp_path):
    """TDB and UTC differ by another second after 2016, and by milliseconds within months."""
    attitude, epoch = build_attitude(sparse), "2016-12-01T00:00:00"
    later = attitude.t_s + np.where(attitude.pass_of > 0, 100 * 86_400.0, 0.0)
    attitude = attitude._replace(t_s=later, epoch=np.datetime64(epoch, "us"))
    found, _ = by_spice(write_ck(tmp_path, attitude), epoch, later, attitude.frame)
    off = found * Rotation.from_quat(attitude.quaternion).inv()
    assert off.magnitude().max() < 1e-7


@pytest.mark.evidence("compare", "verified", "kernels written here with rates changed by 2 %")
def test_a_comparison_with_kernels_finds_a_changed_motion(result, tmp_path, reached, undrawn):
    """Kernels in the place of ESA's of Philae: written here, in a celestial frame, with the rates changed by a known factor."""
    pytest.importorskip("spiceypy")
    result = result.assign_attrs(celestial_frame="J2000")
    folder = result.sunspin.save(tmp_path / "results")
    known = build_attitude(result, "J2000")
    kernels = write_ck(tmp_path, known._replace(omega_B=1.02 * known.omega_B))
    summary, line = against_kernels(folder, kernels, "SUNSPIN_BODY", "J2000", None)
    assert summary["covered"] == 40 and line.startswith("40 of 40 times covered")
    rms = np.degrees(np.sqrt((known.omega_B**2).mean(axis=0)))
    error = np.abs(summary["rms_deg_s"] / rms - 0.02)
    reached("error of the factor found", error, "", 1e-9)
    assert error.max() < 1e-9
    broken = tmp_path / "broken.bc"
    broken.write_bytes(b"DAF/CK  " + bytes(100))
    message = tmp_path / "m.aem"
    message.write_text("CCSDS_AEM_VERS = 2.0\n")
    for path, words in (
        ("absent.bc", "no such file"),
        (broken, "kernels cannot be used"),
        (message, "AEM. is no SPICE kernel"),
    ):
        with pytest.raises(ss.InputError, match=words):
            against_kernels(folder, [path], "SUNSPIN_BODY", "J2000", None)


def test_a_comparison_with_an_attitude_message_finds_a_changed_motion(result, tmp_path, undrawn):
    """Messages of the same motion agree with it in every form; that of another motion differs as the rates of both do."""
    result = result.assign_attrs(celestial_frame="J2000")
    folder = result.sunspin.save(tmp_path / "results")
    known = build_attitude(result, "J2000", dense=True)
    text = write_aem(tmp_path / "1.aem", known).read_text()
    first = re.sub(r"^(20\S+) (\S+ \S+ \S+) (\S+)$", r"\1 \3 \2", text, flags=re.M)
    back = re.sub(r"^(20\S+ \S+ \S+ \S+) (\S+)$", r"\1 -\2", text, flags=re.M).replace("--", "")
    exchanged = back.replace("A = EME2000", "A = SC_BODY_1").replace("B = SC_BODY_1", "B = EME2000")
    forms = {
        "1.0": text,
        "2.0": write_aem(tmp_path / "2.aem", known, "2.0").read_text(),
        "scalar first": first.replace("TYPE = LAST", "TYPE = FIRST"),
        "B to A": back.replace("A2B", "B2A"),
        "frames exchanged": exchanged,
    }
    for form, message in forms.items():
        (tmp_path / "m.aem").write_text(message)
        summary, line = against_message(folder, tmp_path / "m.aem")
        assert summary["covered"] == 40, form
        assert max(summary["rms_deg_s"]) < 0.01 and summary["largest_attitude_deg"] < 1e-3, form
    other = motion(result["time"].values, omega_x=0.021)
    other = other.assign(pass_of=result["pass_of"]).assign_attrs(result.attrs)
    write_aem(tmp_path / "m.aem", build_attitude(other, "J2000", dense=True))
    done = CliRunner().invoke(cli, ["compare", str(folder), str(tmp_path / "m.aem"), "--json"])
    off = np.degrees((other["omega_B"] - result["omega_B"]).values)
    rms = np.sqrt((off**2).mean(axis=0))
    assert json.loads(done.stdout)["rms_deg_s"] == pytest.approx(rms.tolist(), abs=0.01)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("CCSDS_AEM_VERS", "CCSDS_OEM_VERS", "not in KVN"),
        ("TIME_SYSTEM = UTC", "TIME_SYSTEM = TAI", "not in UTC.*TAI"),
        ("= QUATERNION", "= EULER_ANGLE", "no quaternions.*EULER_ANGLE"),
        ("SC_BODY_1", "CAMERA", "must be the body's.*CAMERA"),
        ("DATA_START", "DATA_START\n2026-01-01T00:00:00 0 0 1", "line 22.*four numbers"),
        ("DATA_START", "DATA_START\n2099-01-01T00:00:00 0 0 0 1", "do not increase"),
        ("DATA_", "DATUM_", "no segment"),
    ],
)
def test_a_faulty_attitude_message_gives_one_sentence(old, new, says, result, tmp_path):
    path = write_aem(tmp_path / "m.aem", build_attitude(result))
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(ss.InputError, match=says):
        read_message(path)


@pytest.mark.parametrize(
    # J2000 is 64.184 s before noon UTC, less a periodic term; TDB - UTC of the landing kernel is 67.184 s
    ("utc", "et"),
    [("2000-01-01T12:00", 64.183927), ("2014-11-12T15:34:04", 469078511.183)],
)
def test_ephemeris_time_of_a_utc_is_the_known_one(utc, et):
    assert ephemeris_time(utc) == pytest.approx(et, abs=2e-3)


@pytest.fixture(scope="module")
def sparse():
    """Two passes with samples 37 degrees of turn apart, and between them a curve as `rates` stores it, 0.1 rad apart; no sign of
    its quaternions belongs to that of its neighbour."""
    run, curve = motion(10.5 * np.arange(12)), motion(10.5 / 6 * np.arange(67))
    sign = np.where(np.arange(67) % 3, 1.0, -1.0)[:, None]
    run = run.assign(
        pass_of=("time", (np.arange(12) >= 6).astype(int)),
        B_from_N=run["B_from_N"] * sign[:12],
        curve_B_from_N=(("curve_time", "quaternion"), curve["B_from_N"].values * sign),
        curve_omega_B=(("curve_time", "axis"), curve["omega_B"].values),
        curve_pass_of=("curve_time", (np.arange(67) >= 36).astype(int)),
    ).assign_coords(curve_time=curve["time"].values)
    keep = np.delete(np.arange(67), range(31, 36))  # no curve between the passes
    run.attrs |= {"epoch_utc": "2014-11-12T15:34:04Z", "vehicle": "made up"}
    return run.isel(curve_time=keep).assign_attrs(frame_N="sun_z_local")


@pytest.mark.parametrize("form", ["1.0", "2.0", "xml"])
def test_exported_quaternions_never_change_sign_between_neighbours(form, sparse, tmp_path):
    """And a pass that is not decided is named in its segment."""
    verdict = {"decided": [True, False], "why_not_decided": ["", "several solutions, ±"]}
    result = sparse.assign({name: ("pass_id", values) for name, values in verdict.items()})
    attitude = build_attitude(result.assign_coords(pass_id=[3, 4]))
    text = write_aem(tmp_path / "a.aem", attitude, form).read_text()
    for q in np.split(quaternions(text, form), [6]):
        assert len(q) == 6 and q[0, 3] >= 0 and np.einsum("ni,ni->n", q[1:], q[:-1]).min() > 0.9
    words = "pass 4 is not decided (several solutions, _): another motion may be the right one"
    assert text.count(words) == 1 and text.isascii()
    # after the attitudes of the first segment
    assert text.index("2014-11-12T15:34:56.5") < text.index(words) < text.rindex("START_TIME")
    rows = pd.read_parquet(write_parquet(tmp_path / "a.parquet", attitude))
    assert rows["decided"].tolist() == [True] * 6 + [False] * 6


def test_exported_attitudes_on_a_grid_follow_the_motion_between_samples(sparse, tmp_path):
    dense = build_attitude(sparse, step_s=0.7)
    assert [len(samples) for samples in dense.passes()] == [76, 76]
    assert np.ptp(dense.t_s[:76]) == pytest.approx(52.5)
    truth = motion(dense.t_s)
    cosine = np.abs(np.einsum("ni,ni->n", dense.quaternion, truth["B_from_N"].values))
    assert np.degrees(2 * np.arccos(np.minimum(cosine, 1.0))).max() < 1e-4
    assert np.abs(dense.omega_B - truth["omega_B"].values).max() < 1e-4
    for q in np.split(dense.quaternion, 2):
        assert np.einsum("ni,ni->n", q[1:], q[:-1]).min() > 0.99
    with xr.open_dataset(write_cf(tmp_path / "a.nc", sparse, dense), engine="h5netcdf") as data:
        assert data.sizes["time"] == 152 and "sun_B" not in data
        assert np.array_equal(data["B_from_N"].values, dense.quaternion)


@pytest.mark.parametrize("form", ["1.0", "2.0", "xml"])
def test_object_and_centre_of_a_message_come_from_the_elements(form, sparse, tmp_path):
    def said(**attrs):
        attitude = build_attitude(sparse.assign_attrs(**attrs))
        lines = write_aem(tmp_path / "a.aem", attitude, form).read_text().splitlines()
        for key in ("OBJECT_NAME", "OBJECT_ID", "CENTER_NAME"):
            line = next(line for line in lines if key in line).replace(f"</{key}>", "")
            yield line.split(">" if form == "xml" else "= ")[1]

    assert [*said()] == ["made up", "made up", "UNKNOWN"]
    assert [*said(orbit=42789, orbit_name="SKCUBE\n\u00e9")] == ["SKCUBE__", "42789", "EARTH"]
    assert next(said(orbit=42789)) == "made up"  # two lines without a name


def test_exported_netcdf_and_parquet_state_frame_and_units(result, tmp_path):
    attitude = build_attitude(result)
    with xr.open_dataset(write_cf(tmp_path / "a.nc", result, attitude), engine="h5netcdf") as data:
        assert data.attrs["Conventions"].startswith("CF-") and data.attrs["frame"] == LOCAL_FRAME
        assert "synthetic" in data.attrs["source"]
        assert str(data["time"].values[1]).startswith("2014-11-12T15:34:06.5")
        assert data["omega_B"].attrs["units"] == "rad s-1"
    pq = pytest.importorskip("pyarrow.parquet")
    table = pq.read_table(write_parquet(tmp_path / "a.parquet", attitude))
    assert table.schema.metadata[b"frame"] == LOCAL_FRAME.encode()
    assert np.array_equal(table["q_w_B_from_N"].to_numpy(), attitude.quaternion[:, 3])


def test_results_without_a_usable_attitude_are_refused(result, sparse, tmp_path, undrawn):
    """Or without a second direction for a celestial frame; or with a motion too coarse to interpolate."""
    with pytest.raises(ss.InputError, match="not a results folder"):
        read_attitude_data(tmp_path)
    vehicle, telemetry = ss.load_example()
    folder = ss.sun_directions(vehicle, telemetry).sunspin.save(tmp_path / "sun")
    with pytest.raises(ss.InputError, match="no attitude here"):
        read_attitude_data(folder)
    time, quaternion, bare = (
        result["time"].values,
        result["B_from_N"],
        sparse.drop_dims("curve_time"),
    )
    coarse = bare.isel(time=slice(None, None, 3)).drop_vars("pass_of")
    undated, sun_z = result.assign_attrs(epoch_utc="x"), result.assign_attrs(frame_N="sun_z_local")
    j2000, new = {"frame": "EME2000"}, {"epoch_utc": "2020-01-01"}
    for data, options, words in (
        (result.drop_vars("B_from_N"), {}, "no B_from_N"),
        (undated, {}, "--epoch"),
        (result.assign(B_from_N=quaternion * 1.1), {}, "not unit quaternions"),
        (result.assign(omega_B=("time", time)), {}, "do not belong together"),
        (result.assign(omega_B=result["omega_B"] * np.nan), {}, "rates are not within"),
        (result.assign(pass_of=("time", np.full(len(time), "x"))), {}, "do not belong together"),
        (result.assign_coords(time=time * 0), {}, "do not increase"),
        (result, new, "another UTC of their time zero .*leave --epoch out"),
        (result, j2000, "axes are those of the body at the start of the run"),
        (sun_z, j2000, "rotation about it is arbitrary.*an orbit and a magnetometer"),
        (coarse, {"step_s": 5.0}, "rotates by up to 11[12] degrees between the instants"),
        (sparse, {"step_s": 1e-9}, "more than 1000000 attitudes"),
        (sparse.drop_vars("curve_B_from_N"), {"step_s": 1.0}, "no curve_B_from_N"),
    ):
        with pytest.raises(ss.InputError, match=words):
            build_attitude(data, **options)
    assert str(build_attitude(undated, **new).epoch).startswith("2020")
    known = result.assign_attrs(celestial_frame="EME2000")
    assert build_attitude(known, **j2000).frame == build_attitude(known).frame == "EME2000"
    assert len(build_attitude(bare, step_s=5.0).t_s) == 22  # 37 degrees apart
