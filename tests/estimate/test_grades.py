"""A scan in two grades: its sets against those of each motion run, bounds that fail, what is not computed, stores, refusals."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.dynamics.ensemble import Outcome
from sunspin.estimate.scan import grades, volume
from sunspin.estimate.scan.chosen import stored_near_minimum, with_chosen
from sunspin.estimate.scan.rows import EmdRows, Start
from sunspin.estimate.scan.volume import below, near_minimum
from sunspin.output.kinds.scan import scan_summary
from vehicles import FIRST_SUN

PHILAE = ss.load_vehicle("philae")
GRID = [-0.1 + 0.015 * np.arange(25), 0.2 + 0.015 * np.arange(24), 0.06 + 0.015 * np.arange(11)]
TARGETS = [
    np.random.default_rng(1).uniform(0.05, 1, 20),
    np.random.default_rng(2).uniform(-1, 1, 20),
]
FACTORS = [1.1, 1.5]


@pytest.fixture
def small(monkeypatch):
    """Two grades for a grid of some thousand motions."""
    monkeypatch.setattr(grades, "FEWEST_ROWS", 1000)
    monkeypatch.setattr(grades, "CHECKED", 160)


def scanned(target, axes=GRID, **settings):
    return ss.scan(PHILAE, target, FIRST_SUN, *axes, 865.0, 2640.0, **settings)


@pytest.fixture(scope="module")
def each_run():
    return [scanned(target) for target in TARGETS]


@pytest.mark.evidence("scan", "verified", "sets and the smallest of the scan that runs each motion")
def test_sets_are_those_of_the_scan_that_runs_each_motion(small, each_run, reached):
    beyond = []
    for target, wanted in zip(TARGETS, each_run, strict=True):
        limit = 1.2 * float(wanted.min())
        found = scanned(target, factors=FACTORS, thresholds=[limit])
        run = found["exact"].values
        assert 0.15 < run.mean() < 0.9 and found.min() == wanted.min()
        assert np.array_equal(found.values[run], wanted.values[run]) and np.all(
            found["emd_bound"].values[run] == 0
        )
        for factor in FACTORS:
            assert np.array_equal(near_minimum(found, factor), near_minimum(wanted, factor))
        assert np.array_equal(below(found, limit), below(wanted, limit))
        beyond.append((np.abs(found - wanted) > found["emd_bound"]).values[~run])
        assert sum(found.attrs["class_tried"]) > 100
    share = np.concatenate(beyond).mean()
    reached("share of interpolated motions beyond their bounds", share, "", 2e-3)
    assert share < 2e-3


def test_bits_hang_on_neither_order_workers_chunks_nor_resuming(small, tmp_path, monkeypatch):
    target, store = TARGETS[0], tmp_path / "rows"
    found = scanned(target, factors=[1.1])
    monkeypatch.setattr(volume, "CHUNK", 700)
    turned = scanned(target, [axis[::-1] for axis in GRID], factors=[1.1], workers=2, store=store)
    for name in (None, "exact", "emd_bound"):
        one, other = (x if name is None else x[name] for x in (found, turned))
        assert np.array_equal(one.values, other.values[::-1, ::-1, ::-1])
    stages = sorted(store.iterdir())
    assert len(stages) >= 3
    shutil.rmtree(stages[0])
    again = scanned(target, [axis[::-1] for axis in GRID], factors=[1.1], store=store)
    assert np.array_equal(again.values, turned.values) and sorted(store.iterdir()) == stages


def field(shape=(31, 30, 29), bumps=0.0):
    """A smooth function of the place in a grid, and noise in a corner of it; a share of bumps anywhere."""
    rng, at = (
        np.random.default_rng(3),
        np.stack(np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij")),
    )
    smooth = 0.05 + 0.1 * np.abs((at**2).sum(axis=0) - 0.8) + 0.02 * at[0]
    rough = np.where((at > 0.2).all(axis=0), rng.uniform(-0.02, 0.02, shape), 0)
    return smooth + rough + 0.03 * (rng.random(shape) < bumps)


def graded(values, factors=(1.3,), outcome=0):
    outcome = np.broadcast_to(outcome, values.shape).ravel()
    axes = [np.arange(float(n)) ** 1.1 for n in values.shape]
    return grades.Graded(axes, factors, [], lambda index: (values.ravel()[index], outcome[index]))


def test_what_is_rough_is_run_and_what_is_smooth_is_not():
    values = field()
    found = graded(values)
    limit = 1.3 * values.min()
    assert found.exact.mean() < 0.4 and np.array_equal(found.emd < limit, values < limit)
    assert (np.abs(found.emd - values) <= found.bound)[~found.exact].mean() > 0.999
    corner = found.first_bound[20:, 20:, 20:], found.first_bound[:10, :10, :10]
    assert np.median(corner[0][corner[0] > 0]) > 3 * np.median(corner[1][corner[1] > 0])


def test_bounds_that_do_not_hold_are_doubled_and_said(monkeypatch):
    values = field(bumps=0.0)
    monkeypatch.setattr(grades, "ROUGHNESS", 0.01)
    monkeypatch.setattr(grades, "FLOOR", 1e-4)
    said = graded(values).attributes()
    assert sum(said["class_violations"]) > 20 and max(said["class_bound_factor"]) >= 4
    assert max(said["violation_share_below"]) > 0.03
    monkeypatch.undo()
    assert graded(values).attributes()["class_bound_factor"] == [1.0] * 4


def test_what_surrounds_a_motion_that_was_not_computed_is_run():
    values, outcome = field(), np.zeros((31, 30, 29), dtype=np.int8)
    outcome[10, 10, 10], values[10, 10, 10] = next(o for o in Outcome if o != Outcome.FINE), -1.0
    found = graded(values, outcome=outcome)
    assert found.exact[9:12, 9:12, 9:12].all() and found.outcome[10, 10, 10] != Outcome.FINE
    assert np.array_equal(np.delete(found.emd < 0.02, 0, 0), np.delete(values < 0.02, 0, 0))
    assert graded(values, outcome=np.full_like(outcome, outcome[10, 10, 10])).exact.all()


def test_a_set_that_was_not_asked_for_is_refused_where_it_is_open(small):
    found = scanned(TARGETS[1], factors=[1.1])
    with pytest.raises(InputError, match="leaves open on which side"):
        near_minimum(found, 1.5)


def test_what_was_run_is_kept_and_told(small, tmp_path):
    found = scanned(TARGETS[1], factors=[1.1])
    with_chosen(found, xr.Dataset(), 1.1, None, 0, 0).to_netcdf(tmp_path / "scan.nc")
    assert np.array_equal(stored_near_minimum(tmp_path / "scan.nc", 1.1), near_minimum(found, 1.1))
    with pytest.raises(InputError, match="leaves open on which side"):
        stored_near_minimum(tmp_path / "scan.nc", 1.5)
    told = scan_summary(found)
    assert told["rows_run"] == int(found["exact"].sum()) and "interpolated; of" in told.lines[1]


@pytest.mark.parametrize(
    ("speed", "duration", "mode", "wanted"),
    [
        (865, 2640, "coast", True),
        (865, 2640, "hold", False),
        (0, 2640, "coast", False),
        (865, 60, "coast", False),
        (865, 6000, "coast", False),
    ],
)
def test_where_wheels_do_not_slow_down_each_motion_is_run(small, speed, duration, mode, wanted):
    start = Start.on_grid(PHILAE, GRID, FIRST_SUN, speed)
    assert (
        grades.applies(EmdRows(PHILAE, start, TARGETS[0], None, duration, wheel_mode=mode))
        == wanted
    )


def test_with_several_wheels_each_motion_is_run(small):
    two = replace(
        PHILAE,
        wheels=[PHILAE.wheels[0], replace(PHILAE.wheels[0], name="other", axis_B=[1.0, 0.0, 0.0])],
    )
    start = Start.on_grid(two, GRID, FIRST_SUN, [865, 865])
    assert not grades.applies(EmdRows(two, start, TARGETS[0], None, 2640))


def test_small_scans_run_each_motion_and_say_so():
    found = ss.scan(PHILAE, [0.5], FIRST_SUN, [0.1, 0.2], [0.1], [0.0], 865.0, 60.0, factors=[1.1])
    assert (
        found["exact"].all() and (found["emd_bound"] == 0).all() and found.attrs["factors"] == [1.1]
    )


NO_LIMITS = (
    3,
    None,
    "1.1",
    ("x",),
    [None],
    [np.nan],
    [np.inf],
    [-1],
    [0],
    [[1.1, 1.2]],
    [[1.1], [1.2, 1.3]],
    {"a": 1},
    [True],
    [1.1, "x"],
    [1 + 1j],
    np.array([[1.1]]),
    np.array(1.1),
    [10**400],
    [b"2"],
    [object()],
)


@pytest.mark.parametrize("name", ["factors", "thresholds"])
def test_what_are_no_limits_is_a_sentence(name):
    for given in NO_LIMITS:
        with pytest.raises(
            InputError, match=r"(number above 1|positive number) \(found .*give a list of them"
        ):
            ss.scan(PHILAE, [0.5], FIRST_SUN, [0.1], [0.1], [0.0], 865.0, 60.0, **{name: given})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"factors": [1.1, 0.9]}, "a number above 1"),
        ({"thresholds": [np.nan]}, "positive number"),
        ({"target_z": "track", "factors": [1.1]}, "by E runs each motion"),
    ],
)
def test_wrong_limits_are_refused(change, message):
    track = ss.propagate(PHILAE, [0.1, 0, 0], FIRST_SUN, 865.0, [0.0, 10.0])
    target = track if change.get("target_z") else [0.5]
    rest = {key: value for key, value in change.items() if key != "target_z"}
    with pytest.raises(InputError, match=message):
        ss.scan(PHILAE, target, FIRST_SUN, [0.1], [0.1], [0.0], 865.0, 60.0, **rest)


def test_a_store_of_a_scan_that_runs_each_motion_is_refused(small, tmp_path):
    (tmp_path / "zarr.json").write_text("{}")
    with pytest.raises(InputError, match="choose another folder"):
        scanned(TARGETS[0], factors=[1.1], store=tmp_path)
