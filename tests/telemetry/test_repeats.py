"""Frozen telemetry, copied frames and held values: none is used as a measurement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.estimate.lander.window import observe_window
from sunspin.estimate.observe import ALONE, observe, split_passes
from sunspin.estimate.scan.directions import directions_within
from sunspin.estimate.settings import RATES
from sunspin.output.check.repeats import describe_repeats
from sunspin.output.check.samples import describe_samples
from sunspin.telemetry.assess import assess
from sunspin.telemetry.sun import is_reconstructed
from tests.support.simulate import telemetry_of
from tests.support.vehicles import CUBE_OF_CURRENTS as CUBE

COUNT = 0.5 / 255
"""Step of 8 bits, A."""


def tumbling(n, seed=0, apart=20.0, rate=3.0, noise=0.002, step=0.001):
    """Times (n), s, and currents (n, 6) of a cube that rotates about a fixed axis, deg/s."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(apart * rng.uniform(0.9, 1.1, n))
    axis, sun = rng.normal(size=(2, 3))
    turn = Rotation.from_rotvec(np.radians(rate) * t[:, None] * axis / np.linalg.norm(axis))
    power = ss.panel_power(CUBE, turn.apply(sun / np.linalg.norm(sun)))
    return t, np.round((power + noise * rng.normal(size=(n, 6))) / step) * step


def file(t, value, **more):
    """A telemetry Dataset of panel currents and other variables (n, 3)."""
    others = {name: (("time", "axis"), each) for name, each in more.items()}
    data = telemetry_of(CUBE, t, value, **others).assign_coords(axis=list("xyz"))
    return data.assign_attrs(unused_columns="", missing_sensors="")


def brightest(value):
    """The panel that is lit most often."""
    return int((value > 0.1).sum(axis=0).argmax())


def looked_at(t, value, vehicle=CUBE, **more):
    return assess(vehicle, file(t, value, **more))


def with_copies(t, value, late_s, every):
    """The file with a copy of every so many samples, later by `late_s`, in the order of time; and which are copies."""
    times = np.concatenate([t, t[::every] + late_s])
    order = np.argsort(times)
    copies = np.arange(len(times)) >= len(t)
    return times[order], np.concatenate([value, value[::every]])[order], copies[order]


@pytest.mark.parametrize("count", [7, 80])
def test_a_frozen_end_of_any_length_is_named_and_left_out(count):
    t, value = tumbling(40)
    t = np.concatenate([t, t[-1] + 20.0 * np.arange(1, count + 1)])
    frozen = looked_at(t, np.concatenate([value, np.tile(value[-1], (count, 1))]))
    assert np.flatnonzero(frozen.repeats.frozen).tolist() == list(range(40, 40 + count))
    summary, lines = describe_repeats(frozen)
    assert summary["frozen"] == [[t[40], t[-1]]] and "FROZEN from 2026-01-01T00:1" in lines[0]
    assert all("stale" in text for text in frozen.quality["why"].values[40:])


@pytest.mark.parametrize("fill", [np.nan, 999.0], ids=["empty", "999"])
@pytest.mark.parametrize("cells", [1, 6])
def test_a_frozen_half_is_named_even_with_empty_cells(cells, fill):
    t, value = tumbling(80)
    value[40:] = value[39]
    value[[50, 60, 45, 55, 65, 70][:cells], 1] = fill
    frozen = looked_at(t, value)
    assert np.flatnonzero(frozen.repeats.frozen).tolist() == list(range(40, 80))
    assert describe_repeats(frozen)[0]["frozen"] == [[t[40], t[-1]]]
    assert all("stale" in text for text in frozen.quality["why"].values[40:])


@pytest.mark.parametrize("frames", [2, 4])
def test_frames_repeated_by_a_looping_buffer_are_named(frames):
    t, value = tumbling(40)
    t = np.concatenate([t, t[-1] + 20.0 * np.arange(1, 61)])
    looped = looked_at(t, np.concatenate([value, np.tile(value[-frames:], (60 // frames, 1))]))
    assert np.flatnonzero(looped.repeats.frozen).tolist() == list(range(40, 100))
    assert "60 samples equal to earlier ones" in describe_repeats(looped)[1][0]


@pytest.mark.parametrize("late_s", [1.0, 13.0, 30.0])
def test_copies_of_frames_without_noise_are_left_out(late_s):
    t, value = tumbling(40, apart=3.0, noise=0.0, step=COUNT)
    t, value, copies = with_copies(t, value, late_s, 3)
    # the last copy may come next to its frame, which chance does as well
    assert np.array_equal(looked_at(t, value).repeats.frozen[:-1], copies[:-1])


def test_held_gyro_readings_are_not_used_as_samples():
    t, value = tumbling(120)
    gyro = np.repeat(0.05 + 0.01 * np.random.default_rng(1).normal(size=(24, 3)), 5, axis=0)
    in_shadow = np.arange(120) % 5 > 0
    value[in_shadow] = np.round(np.random.default_rng(2).normal(size=(96, 6))) * 0.001
    assert describe_samples(looked_at(t, value, gyro_B=gyro))[0]["directions"] == 24


def test_a_frozen_time_range_splits_the_pass():
    t, value = tumbling(80)
    value[30:50] = value[29]
    first, second = split_passes(observe(looked_at(t, value)), None, RATES.passes)
    assert first.samples[-1] == 29 and second.samples[0] == 50


@pytest.mark.parametrize(
    ("late_s", "every"),
    [(2.0, 1), (3.0, 3), (25.0, 1), (45.0, 2)],
    ids="next third after far".split(),
)
def test_copies_of_a_frame_are_left_out_at_any_share(late_s, every):
    t, value, copies = with_copies(*tumbling(40), late_s, every)
    found = looked_at(t, value)
    assert np.array_equal(found.repeats.frozen, copies)
    own, every_own = looked_at(t[~copies], value[~copies]), describe_samples(found)[0]
    assert every_own["clear_rate_deg_s"] == describe_samples(own)[0]["clear_rate_deg_s"]
    assert every_own["samples_by_lit_faces"] == describe_samples(own)[0]["samples_by_lit_faces"]


def test_copies_of_a_frame_are_left_out_in_many_short_passes():
    t, value = tumbling(48, step=COUNT)
    t = t + 5000.0 * (np.arange(48) // 4)
    t, value, copies = with_copies(t, value, 2.0, 1)
    assert np.array_equal(looked_at(t, value).repeats.frozen, copies)


@pytest.mark.parametrize("late_s", [1.0, 25.0], ids=["next", "with another between"])
def test_one_copy_in_each_of_many_short_passes_is_left_out(late_s):
    """A second ground station adds a frame now and then: one pass does not show it, all together do."""
    t, value = tumbling(160, rate=1.5, step=COUNT)
    t = t + 5000.0 * (np.arange(160) // 8)
    t, value, copies = with_copies(t, value, late_s, 8)
    assert np.array_equal(looked_at(t, value).repeats.frozen, copies)


@pytest.mark.parametrize("every", [20, 2], ids=["one copy", "many"])
def test_a_beacon_that_a_second_station_hears_seconds_later_is_left_out(every):
    """Its counts are as coarse as those of a slow body, so that chance alone does not show the copies."""
    t, value = tumbling(30, rate=0.4, apart=45.0, step=COUNT)
    value[20] = [0.04, 0, 0, 0, 0, 0]  # light of the Earth alone
    t, value, copies = with_copies(t, value, 1.5, every)
    assert np.array_equal(looked_at(t, value).repeats.frozen, copies) and copies.any()


def test_copies_a_second_later_do_not_hide_that_times_are_rounded():
    t, value = tumbling(30, rate=0.4, apart=45.0, step=COUNT)
    files = [(np.round(t), value), with_copies(np.round(t), value, 1.0, 5)[:2]]
    sigmas = [observe(looked_at(*each)).obs.time_sigma_s for each in files]
    assert sigmas == pytest.approx([1 / np.sqrt(12)] * 2)


def test_frames_that_a_slow_body_sends_in_pairs_are_kept_if_some_pairs_differ():
    t, value = tumbling(450, rate=0.02, apart=3.0, noise=0.0, step=COUNT)
    kept = np.arange(450) % 15 < 2  # two 3 s apart, in each 45 s
    rows = value[kept]
    assert 0.5 < (rows[1::2] == rows[::2]).all(axis=1).mean() < 0.9
    assert not looked_at(t[kept], rows).repeats.frozen.any()


@pytest.mark.parametrize("times", [2, 5])
def test_held_samples_are_left_out_and_their_number_is_reported(times):
    t, value = tumbling(40, apart=10.0, step=COUNT)
    each = (t[:, None] + 10.0 / times * np.arange(times)).ravel()
    found = looked_at(np.sort(each), np.repeat(value, times, axis=0))
    assert np.array_equal(found.repeats.frozen, np.arange(40 * times) % times > 0)
    assert describe_repeats(found)[0]["repeated_each"] == times


def held_nine_times():
    t, value = tumbling(3, apart=200.0)
    return looked_at((t[:, None] + 20.0 * np.arange(9)).ravel(), np.repeat(value, 9, axis=0))


def test_repeats_among_too_few_readings_are_reported_and_kept_and_the_rates_not_decided():
    found, held = held_nine_times(), "each reading is repeated 9 times: held values?"
    assert not found.repeats.frozen.any() and found.repeats.unsure.all()
    assert describe_repeats(found)[1][0].startswith(f"  {held}")
    quick = {"effort": 0.02, "max_rate_rad_s": 0.02, "column_tests": False}
    result = ss.rates(CUBE, found, **quick)
    assert not result["decided"].any() and held in str(result["why_not_decided"].values[0])


def test_the_number_of_samples_used_is_that_of_the_passes():
    t, value = tumbling(120)
    t[118:] += 10_000.0  # two samples alone
    said: list[str] = []
    found = looked_at(t, value)
    result = ss.rates(CUBE, found, effort=0.02, column_tests=False, progress=said.append)
    used = np.char.startswith(result["why"].values.astype(str), "used")
    assert used.sum() == result["samples"].values.sum() == 118
    assert result["why"].values[-1] == ALONE
    kept = result.attrs["samples_searched"]
    assert said[0].startswith(f"118 samples used in 1 pass, thinned to {kept} for the search")


@pytest.mark.parametrize(
    "made",
    [
        {"rate": 0.05, "apart": 1.0, "noise": 0.0, "step": COUNT},
        {"rate": 0.3, "apart": 1.0, "noise": 0.0, "step": COUNT},
        {"rate": 3.0, "apart": 1.0, "noise": 0.0, "step": 4 * COUNT},
        {"rate": 1e-4, "apart": 10.0, "noise": COUNT / 3, "step": COUNT},
        {"rate": 1e-4, "apart": 10.0, "noise": COUNT, "step": COUNT},
    ],
    ids="slow usual coarse rest noisy".split(),
)
def test_coarse_counts_and_bodies_at_rest_are_not_called_frozen(made):
    for seed in range(4):
        repeats = looked_at(*tumbling(300, seed, **made)).repeats
        assert not repeats.frozen.any() and not repeats.columns.any()


def test_zeros_in_shadow_are_not_called_repeats():
    t, value = tumbling(60)
    value[20:45] = 0.0
    found = looked_at(t, value)
    assert not found.repeats.frozen.any() and not found.repeats.unsure.any()
    assert (found.quality["why"].values[20:45] == "dropped: no panel lit").all()


@pytest.mark.parametrize("count", [12, 60])
@pytest.mark.parametrize("longer", [1.0, 0.9997, 0.999])
@pytest.mark.parametrize("each_turn", [3, 6])
def test_a_spinner_in_step_with_its_sampling_is_not_called_frozen(each_turn, longer, count):
    """Without noise, a turn of about 20 s shows the same few directions again and again."""
    t = 20.0 / each_turn * np.arange(count)
    for seed in range(3):
        axis, sun = np.random.default_rng(seed).normal(size=(2, 3))
        turn = 2 * np.pi / (20.0 * longer) * t[:, None] * axis / np.linalg.norm(axis)
        seen = Rotation.from_rotvec(turn).apply(sun / np.linalg.norm(sun))
        for step in (COUNT, 4 * COUNT, 0.001):
            value = np.round(ss.panel_power(CUBE, seen) / step) * step
            assert not looked_at(t, value).repeats.frozen.any()


def test_panels_that_repeat_while_the_gyro_changes_are_called_held():
    t, value = tumbling(120)
    value[60:100] = value[59]
    gyro = 0.05 + 0.001 * np.random.default_rng(1).normal(size=(120, 3))
    repeats = looked_at(t, value, gyro_B=gyro).repeats
    assert not repeats.frozen.any()
    assert np.flatnonzero(repeats.held["panels"]).tolist() == list(range(60, 100))
    assert not repeats.held["gyro_B"].any()


def test_a_gyro_that_repeats_while_panels_change_is_left_out():
    t, value = tumbling(120)
    gyro = np.repeat(0.05 + 0.01 * np.random.default_rng(1).normal(size=(24, 3)), 5, axis=0)
    found = looked_at(t, value, gyro_B=gyro)
    assert not found.repeats.repeated("panels").any()
    read = np.isfinite(found.sensors["gyro_B"].values).all(axis=1)
    assert np.flatnonzero(read).tolist() == list(range(0, 120, 5))
    assert "the gyro repeats the last reading in 96 samples" in describe_repeats(found)[1][0]


def test_held_values_of_a_panel_read_less_often_are_named_and_left_out():
    t, value = tumbling(120, apart=5.0)
    k = brightest(value)
    value[:, k] = np.repeat(value[::4, k], 4)
    found = looked_at(t, value)
    assert np.flatnonzero(found.repeats.columns.any(axis=0)).tolist() == [k]
    assert f"p{k} in" in describe_repeats(found)[1][0]
    lit, late = value[:, k] > 0.1, np.arange(120) % 4 > 0
    assert not found.quality["reading"].values[lit & late, k].any()
    assert found.quality["reading"].values[~late, k].all()
    assert not is_reconstructed(found.sun["status"].values[lit & late]).any()


def dimmed(share):
    def spoil(t, value):
        value[20:26] *= share
        return np.arange(20, 26), slice(None)

    return spoil


def filled(rows, columns, number):
    def spoil(t, value):
        value[rows, columns] = number
        return np.array(rows), columns

    return spoil


def repeated(t, value):
    value[20:30] = value[19]
    return np.arange(20, 30), slice(None)


def late(t, value):
    t[20] = t[18]
    return np.array([20]), slice(None)


def dead(t, value):
    k = brightest(value)
    lit = np.flatnonzero(value[:, k] > 0.1)
    value[:, k] = 0.0
    return lit, k


ROWS, CELLS = ([20, 31], slice(None)), ([20, 31, 40], [0, 3, 5])
FAULTS = {
    **{str(value): filled(*CELLS, float(value)) for value in (-999, -1, 65535)},
    **{"not a number": filled(*CELLS, np.nan), "row without numbers": filled(*ROWS, np.nan)},
    **{"row of -999": filled(*ROWS, -999.0), "row of 65535": filled(*ROWS, 65535.0)},
    **{"frozen": repeated, "late": late, "dead panel": dead},
    **{"battery-limited": dimmed(0.6), "idle": dimmed(0.2), "nothing lit": dimmed(0.0)},
}
WITHOUT_NOISE = ("-999", "frozen", "dead panel", "battery-limited")


@pytest.mark.parametrize(
    ("fault", "noise"),
    [*((fault, 0.002) for fault in FAULTS), *((fault, None) for fault in WITHOUT_NOISE)],
)
def test_repeated_readings_are_used_by_no_command(fault, noise):
    """Nor other readings that are known as wrong; with a stated noise and with one that is estimated."""
    t, value = tumbling(60)
    rows, panel = FAULTS[fault](t, value)
    vehicle = replace(CUBE, telemetry=replace(CUBE.telemetry, noise=noise))
    found = looked_at(t, value, vehicle)
    assert not found.quality["measured"].values[rows, panel].any()
    # sun, check
    status = ss.sun_directions(vehicle, found.telemetry)["status"].values
    assert np.array_equal(status, found.sun["status"].values)
    assert not is_reconstructed(status[rows]).any() and is_reconstructed(status).sum() > 5
    # scan
    seen = is_reconstructed(found.sun["status"]).sum()
    assert directions_within(vehicle, found, None, None).sizes["time"] == seen
    # posterior
    window = observe_window(found)
    t_used, count = window.obs.t_s + window.start_s, len(window.obs)
    place = np.minimum(np.searchsorted(t_used, t[rows]), count - 1)
    there = np.isin(np.round(t[rows], 9), np.round(t_used, 9))
    used = window.obs.terms[0].used[place, panel].reshape(len(rows), -1).any(axis=1)
    assert not (there & used).any() or fault == "late"
    # rates
    seen = observe(found)
    sigma, why = seen.obs.terms[0].sigma[rows, panel], seen.why
    largest = value[rows].max(axis=1) if fault == "battery-limited" else np.full(len(rows), np.inf)
    assert (sigma.reshape(len(rows), -1).min(axis=1) >= 0.49 * largest).all()
    # of these two the other readings of the sample are used as they are
    assert "used" not in why[rows] or fault in ("not a number", "dead panel")
