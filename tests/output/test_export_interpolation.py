"""Exports interpolated between their records, by SPICE and by a reader of the message, follow the propagated motion."""

import json
from datetime import datetime

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

import sunspin as ss
from sunspin.dynamics import curve
from sunspin.dynamics.curve import with_curve
from sunspin.output.export import LOCAL_FRAME, build_attitude
from sunspin.output.export.aem import write_aem
from sunspin.output.export.ck import ephemeris_time, write_ck
from sunspin.vehicle import Friction, Vehicle, Wheel
from tests.support.commands import sunspin

EPOCH = "2026-01-01T00:00:00Z"
TRIAXIAL = Vehicle("made up", inertia_kg_m2=np.diag([0.02, 0.05, 0.06]))
SLOWING = Wheel("wheel", [0, 0, 1], 2e-4, 300.0, Friction(1e-4, 1e-7))
WHEELED = Vehicle("made up", inertia_kg_m2=np.diag([0.04, 0.05, 0.03]), wheels=[SLOWING])
HEAVY = Wheel("wheel", [0, 0, 1], 2e-4, 500.0, Friction(1e-8, 1e-10))
SLOW = Vehicle("made up", inertia_kg_m2=np.diag([0.1, 0.12, 0.08]), wheels=[HEAVY])

MOTIONS = {
    **{
        f"{speed:g} deg/s every {step} s": (TRIAXIAL, [0, 0, speed], step, "coast")
        for speed, step in ((0.1, 1), (12, 20), (60, 120))
    },
    "tumbling about the middle axis": (TRIAXIAL, [0.05, 12, 0.02], 20, "coast"),
    "tumbling fast, far apart": (TRIAXIAL, [40, 20, -30], 120, "coast"),
    "a wheel runs down and stops": (WHEELED, [1, 0.5, -2], 20, "coast"),
    "nutation about a wheel": (WHEELED, [1, 0.5, -2], 120, "hold"),
    "a slow body about a wheel": (SLOW, [0.01, 0.01, 0], 120, "hold"),
}
LARGEST_ERROR_DEG = 0.1


def propagated(vehicle, omega_deg_s, mode):
    speeds = [wheel.speed_rad_s for wheel in vehicle.wheels] or None
    return lambda t: ss.propagate(vehicle, np.radians(omega_deg_s), [1, 0, 0], speeds, t, mode)


def simulated(name):
    """What `simulate` stores, and the motion at any times between (n) in order."""
    vehicle, omega, step, mode = MOTIONS[name]
    motion = propagated(vehicle, omega, mode)
    run = with_curve(motion(np.arange(0, 601, step)), vehicle.inertia_kg_m2, motion)
    between = np.sort(np.random.default_rng(1).uniform(0.1, 599.9, 200))
    return run, between, motion(np.append(0.0, between)).isel(time=slice(1, None))


def by_spice(kernels, epoch, t_s, local=LOCAL_FRAME):
    """Attitudes and rates (n, 3), body axes, of kernels at times (n)."""
    sp = pytest.importorskip("spiceypy")
    et = ephemeris_time(np.datetime64(epoch.rstrip("Z"), "us") + np.round(t_s * 1e6).astype(int))
    kernels = [str(path) for path in kernels]
    sp.furnsh(kernels)
    try:
        states = [sp.xf2rav(sp.sxform(local, "SUNSPIN_BODY", t)) for t in et]
    finally:
        sp.unload(kernels)
    return Rotation.from_matrix([m for m, _ in states]), np.array([m @ rate for m, rate in states])


def degrees_off(attitude, truth):
    turn = attitude * Rotation.from_quat(truth["B_from_N"].values).inv()
    return np.degrees(turn.magnitude()).max()


@pytest.mark.evidence("export", "validated", "NAIF's SPICE between the records of the kernels")
@pytest.mark.parametrize("name", MOTIONS)
def test_exported_kernels_follow_the_motion_between_their_records(name, tmp_path, reached):
    run, between, truth = simulated(name)
    attitude = build_attitude(run, epoch_utc=EPOCH, dense=True)
    found, rates = by_spice(write_ck(tmp_path, attitude), EPOCH, between)
    reached("largest error of the attitude", degrees_off(found, truth), "deg", LARGEST_ERROR_DEG)
    assert degrees_off(found, truth) < LARGEST_ERROR_DEG
    omega = truth["omega_B"].values
    assert np.abs(rates - omega).max() < 0.03 * np.linalg.norm(omega, axis=1).max()
    assert attitude.largest_rotation() < np.radians(30)


@pytest.mark.parametrize("form", ["1.0", "xml"])
def test_an_interpolated_attitude_message_follows_the_motion(form, tmp_path):
    ndm_io = pytest.importorskip("ccsds_ndm.ndm_io")
    run, between, truth = simulated("tumbling fast, far apart")
    path = write_aem(tmp_path / "a", build_attitude(run, epoch_utc=EPOCH, dense=True), form)
    (segment,) = ndm_io.NdmIo().from_path(path).body.segment
    assert segment.metadata.interpolation_method is None  # nothing is promised
    kind = "quaternion_state" if form == "1.0" else "quaternion_ephemeris"
    each = [getattr(state, kind) for state in segment.data.attitude_state]
    start = datetime.fromisoformat(EPOCH.rstrip("Z"))
    t = [(datetime.fromisoformat(one.epoch) - start).total_seconds() for one in each]
    q = [[getattr(one.quaternion, k) for k in ("q1", "q2", "q3", "qc")] for one in each]
    # the message rotates axes, SciPy vectors: each is the other's inverse
    assert degrees_off(Slerp(t, Rotation.from_quat(q))(between).inv(), truth) < LARGEST_ERROR_DEG


@pytest.mark.parametrize("duration", [600, -600])
def test_simulate_and_export_give_a_kernel_of_the_motion(duration, tmp_path, undrawn):
    """240 degrees from one output to the next, of which every reader goes 120 degrees back."""
    sunspin("init", "sat", cwd=tmp_path)
    start = "--omega-deg-s=0,0,12", "--sun=1,0,0", f"--duration={duration}", "--step=20"
    stopped = ("--wheel-mode=hold",)
    sunspin("simulate", "sat/vehicle.toml", *start, *stopped, "--out=sim", cwd=tmp_path)
    made = ("export", "sim", "--format=ck", f"--epoch={EPOCH}", "--json")
    summary = json.loads(sunspin(*made, "--out=kernels", cwd=tmp_path).out)
    assert summary["largest_rotation_deg"] < 6
    stepped = json.loads(sunspin(*made, "--step=1", "--out=stepped", cwd=tmp_path).out)
    assert stepped["samples"] == 601 and 11 < stepped["largest_rotation_deg"] < 13
    vehicle = ss.load_vehicle(tmp_path / "sat" / "vehicle.toml")
    between = np.linspace(0.5, 599.5, 100) * np.sign(duration)
    truth = propagated(vehicle, [0, 0, 12], "hold")(np.append(0.0, between))
    for each in (summary, stepped):
        kernels = [tmp_path / file for file in each["files"]]
        found, rates = by_spice(kernels, EPOCH, between)
        assert degrees_off(found, truth.isel(time=slice(1, None))) < 1.0
        assert np.abs(np.degrees(rates) - [0, 0, 12]).max() < 0.3
    about = f"--epoch={EPOCH}", "--frame=SUNSPIN_BODY", f"--base={LOCAL_FRAME}", "--json"
    compared = json.loads(sunspin("compare", "sim", *summary["files"], *about, cwd=tmp_path).out)
    assert compared["covered"] >= 30 and max(compared["rms_deg_s"]) < 1e-4


def test_a_trajectory_too_coarse_to_interpolate_is_refused_with_a_step_that_works():
    """So is a step that is no duration, or over half a revolution, but for a file that nobody interpolates."""
    motion = propagated(TRIAXIAL, [0, 0, 12], "coast")
    dense = {"epoch_utc": EPOCH, "dense": True}
    with pytest.raises(ss.InputError, match=r"up to 240 degrees between.*again with --step 2\.1"):
        build_attitude(motion(np.arange(0, 601, 20.0)), **dense)
    fine = build_attitude(motion(np.arange(0, 601, 2.1)), **dense)
    assert fine.largest_rotation() < 0.11
    run, *_ = simulated("12 deg/s every 20 s")
    for step_s in (np.inf, np.nan, 1e-9):
        with pytest.raises(ss.InputError, match="--step"):
            build_attitude(run, step_s=step_s, **dense)
    words = "rotates by up to 240 degrees in this --step.*--step 2.4 or less"
    with pytest.raises(ss.InputError, match=words):
        build_attitude(run, step_s=20, **dense)
    assert build_attitude(run, step_s=2.4, **dense).largest_rotation() < np.pi
    assert len(build_attitude(run, step_s=20, epoch_utc=EPOCH).t_s) == 31


def test_a_motion_longer_than_a_curve_may_be_is_simulated_in_parts(monkeypatch):
    monkeypatch.setattr(curve, "MOST_INSTANTS", 100)
    monkeypatch.setattr("sunspin.output.export.MOST_INSTANTS", 100)
    motion = propagated(TRIAXIAL, [0, 0, 12], "coast")

    def exported(duration):
        run = motion(np.arange(0, duration + 1, 20.0))
        run = with_curve(run, TRIAXIAL.inertia_kg_m2, motion)
        return build_attitude(run, epoch_utc=EPOCH, dense=True)

    with pytest.raises(ss.InputError, match="in parts, with a --duration of 100"):
        exported(600)
    assert exported(100).largest_rotation() < 0.11


def test_an_attitude_is_not_interpolated_across_a_gap(tmp_path):
    """Two passes of 12 deg/s with a curve each, 20 s between samples, 70 s between the passes."""
    motion = propagated(TRIAXIAL, [1, 2, 12], "coast")
    passes = [np.arange(0, 201, 20.0), np.arange(270, 501, 20.0)]
    fine = [np.linspace(t[0], t[-1], 10 * len(t)) for t in passes]
    run, between = motion(np.concatenate(passes)), motion(np.concatenate(fine))
    run = run.assign(
        pass_of=("time", np.repeat([0, 1], [len(t) for t in passes])),
        curve_B_from_N=(("curve_time", "quaternion"), between["B_from_N"].values),
        curve_omega_B=(("curve_time", "axis"), between["omega_B"].values),
        curve_pass_of=("curve_time", np.repeat([0, 1], [len(t) for t in fine])),
    ).assign_coords(curve_time=between["time"].values)
    run.attrs["kind"] = "rates"
    attitude = build_attitude(run, epoch_utc=EPOCH, dense=True)
    kernels = write_ck(tmp_path, attitude)
    at = np.array([7.0, 133.0, 199.0, 271.0, 391.0])
    found, _ = by_spice(kernels, EPOCH, at)
    truth = motion(np.append(0.0, at)).isel(time=slice(1, None))
    assert degrees_off(found, truth) < LARGEST_ERROR_DEG
    sp = pytest.importorskip("spiceypy")
    with pytest.raises(sp.exceptions.SpiceyError):
        by_spice(kernels, EPOCH, np.array([235.0]))
    lone = run.drop_dims("curve_time")
    words = "a shorter stretch of time: `sunspin rates --from --to`"
    with pytest.raises(ss.InputError, match=words):
        build_attitude(lone, epoch_utc=EPOCH, dense=True)


def test_samples_of_a_uniform_rotation_are_exported_unchanged():
    motion = propagated(TRIAXIAL, [0.2, 0.1, 2], "coast")
    run = motion(np.arange(0, 601, 2.0))
    attitude = build_attitude(run, epoch_utc=EPOCH, dense=True)
    assert np.array_equal(attitude.t_s, run["time"].values)
    assert "curve_time" not in with_curve(run, TRIAXIAL.inertia_kg_m2, motion)


@pytest.mark.parametrize("name", ["12 deg/s every 20 s", "a wheel runs down and stops"])
def test_attitude_and_rate_at_any_time_are_those_of_the_motion(name):
    """The interpolation has a knot where a wheel stops."""
    run, between, truth = simulated(name)
    assert run.sizes["event"] == ("wheel" in name)
    assert np.isin(run["event_time_s"].values, run["curve_time"].values).all()
    run = run.assign_attrs(epoch_utc=EPOCH)
    found = run.sunspin.at(between)
    assert degrees_off(Rotation.from_quat(found["B_from_N"].values), truth) < LARGEST_ERROR_DEG
    utc = np.datetime64(EPOCH.rstrip("Z"), "us") + (between * 1e6).astype("timedelta64[us]")
    for times in (utc, [f"{time}Z" for time in utc]):
        again = run.sunspin.at(times)
        np.testing.assert_allclose(again["omega_B"], found["omega_B"], atol=1e-6)
    ends = run["time"].values[[0, -1]]
    outside = run.sunspin.at([ends[0] - 1.0, ends[1] + 1.0])
    assert np.isnan(outside["B_from_N"]).all() and (outside["pass_of"] == -1).all()


def test_a_time_that_cannot_be_read_and_a_result_without_attitude_are_refused():
    run, *_ = simulated("12 deg/s every 20 s")
    with pytest.raises(
        ss.InputError, match=r"this time cannot be read \(found noon\); give seconds"
    ):
        run.assign_attrs(epoch_utc=EPOCH).sunspin.at(["noon"])
    with pytest.raises(ss.InputError, match="no UTC of its time zero.*give times in seconds"):
        run.sunspin.at(["2026-01-31T12:00:00Z"])
    with pytest.raises(ss.InputError, match="several dimensions"):
        run.sunspin.at([[1.0, 2.0]])
    with pytest.raises(ss.InputError, match="the results have no"):
        ss.load_case("philae").telemetry.sunspin.at([0.0])
