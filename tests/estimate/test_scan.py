"""The scan compared with tracks by heyoka and distances by SciPy; its histogram, mask, store, and independence of workers."""

import numpy as np
import pytest
import xarray as xr
from scipy.stats import wasserstein_distance

import sunspin as ss
from sunspin.estimate.scan.directions import reconstructible_mask
from sunspin.estimate.scan.histogram import BINS, distances_to_target, target_segments
from sunspin.estimate.scan.near_minimum import near_minimum, with_near_minimum
from sunspin.output.kinds.scan import scan_summary
from sunspin.telemetry.sun import reconstructible_patterns
from tests.support.vehicles import FIRST_SUN

PHILAE = ss.load_vehicle("philae")
AXES = ("omega_x", "omega_y", "omega_z")


def reference_emd(omega, target):
    track = ss.propagate(PHILAE, omega, FIRST_SUN, 865.0, np.linspace(0, 2700, 27001), rtol=1e-9)[
        "sun_B"
    ].values
    seen = track[reconstructible_mask(PHILAE).contains(track), 2]
    return wasserstein_distance(seen, target) / 2


@pytest.mark.evidence(
    "scan", "validated", "SciPy's Wasserstein distance of densely sampled heyoka trajectories"
)
def test_scan_emd_agrees_with_the_reference(reached):
    rng, error = np.random.default_rng(1), []
    target = rng.uniform(0.05, 0.98, 15)
    for omega in rng.uniform([-0.5, -0.5, -0.3], [1, 1, 0.3], (16, 3)):
        ours = ss.scan(PHILAE, target, FIRST_SUN, *omega[:, None], 865.0, 2700.0)
        error.append(abs(ours.item() - reference_emd(omega, target)))
    error = np.array(error)
    reached("largest difference of EMD", error, "", 1e-3)
    reached("motions", error.size)
    assert error.max() < 1e-3


def test_the_scan_mask_allows_what_the_panels_allow():
    n = np.random.default_rng(0).normal(size=(20_000, 3))
    for vehicle in (PHILAE, ss.load_vehicle("skcube")):
        names = np.array(vehicle.panel_names)
        good = reconstructible_patterns(vehicle)
        lit = ss.panel_power(vehicle, n) > 0
        expected = [frozenset(names[row].tolist()) in good for row in lit]
        assert np.array_equal(reconstructible_mask(vehicle).contains(n), expected)


@pytest.mark.evidence("scan", "verified", "one and three threads, and single motions")
def test_workers_do_not_change_a_scan():
    axes = [np.linspace(-0.4, 0.9, 30), np.linspace(-0.4, 0.9, 30), np.linspace(-0.2, 0.2, 11)]
    begin, end = (PHILAE, [0.2, 0.5, 0.9], FIRST_SUN), (865.0, 300.0)
    runs = [ss.scan(*begin, *axes, *end, workers=workers) for workers in (1, 3)]
    np.testing.assert_allclose(runs[0], runs[1], rtol=1e-9)
    alone = ss.scan(*begin, axes[0][7], axes[1][3], axes[2][5], *end)
    assert alone.item() == pytest.approx(runs[0].values[7, 3, 5], rel=1e-9)


@pytest.mark.evidence("scan", "modelled", "a Sun track simulated by its own model")
def test_the_track_metric_finds_the_truth():
    truth = np.array([0.1, -0.05, 0.02])
    t = np.array([0.0, 31.0, 64.0, 90.0, 131.0, 160.0])
    run = ss.propagate(PHILAE, truth, FIRST_SUN, 865.0, t)
    track = xr.Dataset({"sun_B": run["sun_B"]})
    axes = [np.linspace(v - 0.02, v + 0.02, 5) for v in truth]
    volume = ss.scan(PHILAE, track, FIRST_SUN, *axes, 865.0)
    best = np.unravel_index(volume.values.argmin(), volume.shape)
    assert best == (2, 2, 2)
    assert volume.values.min() < 1e-4


@pytest.mark.evidence("near_minimum", "verified", "a volume of a few points, by hand")
def test_the_near_minimum_set_by_hand():
    """Motions that failed are never in it."""
    coords = {"omega_x": [0.5], "omega_y": [0.1, 0.2], "omega_z": [-0.1, 0.1]}
    volume = xr.DataArray([[[1.0, 1.05], [2.0, 1.11]]], coords, AXES)
    np.testing.assert_array_equal(near_minimum(volume, 1.1), [[0.5, 0.1, -0.1], [0.5, 0.1, 0.1]])
    np.testing.assert_array_equal(near_minimum(volume - 1.0), [[0.5, 0.1, -0.1]])  # smallest: 0
    coords = {"omega_x": [0.5], "omega_y": [0.1], "omega_z": [-0.1, 0.0, 0.1]}
    volume = xr.DataArray([[[0.0, 1.0, 1.05]]], coords, AXES)
    volume = volume.assign_coords(outcome=(AXES, [[[3, 0, 0]]]))
    np.testing.assert_array_equal(near_minimum(volume, 1.1)[:, 2], [0.0, 0.1])
    with pytest.raises(ss.InputError, match="outcome"):
        near_minimum(volume.assign_coords(outcome=volume["outcome"] * 0 + 3))


def test_the_smallest_emd_is_that_of_a_motion_that_could_be_computed():
    coords = {"omega_x": [0.5], "omega_y": [0.1], "omega_z": [-0.1, 0.0, 0.1]}
    volume = xr.DataArray([[[0.0, 0.2, 0.1]]], coords, AXES, "emd", {"vehicle": "a"})
    volume = volume.assign_coords(outcome=(AXES, [[[3, 0, 0]]]))
    summary = scan_summary(volume)
    assert (summary["minimum"], summary["best_omega_B"]) == (0.1, [0.5, 0.1, 0.1])
    with pytest.raises(ss.InputError, match=r"the smallest is 0\.1000"):
        with_near_minimum(volume, xr.Dataset(), 1.1, 0.05, 0, 0)
    none = volume.assign_coords(outcome=volume["outcome"] * 0 + 3)
    with pytest.raises(ss.InputError, match="no motion of the grid could be computed"):
        with_near_minimum(none, xr.Dataset(), 1.1, 0.05, 0, 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"target_z": []}, "target_z"),
        ({"target_z": [1.2]}, "target_z"),
        ({"omega_x": np.linspace(0, 1, 10**6), "omega_y": np.linspace(0, 1, 10**6)}, "larger step"),
        ({"omega_z": [np.nan]}, "omega_z"),
        ({"sun_B": [1, 1, 1]}, "unit vector"),
        ({"duration_s": 0.0}, "duration_s"),
        ({"workers": 0}, "workers"),
    ],
)
def test_bad_arguments_of_a_scan_are_named(change, message):
    arguments = {name: [0.1] for name in AXES} | {"target_z": [0.5], "sun_B": FIRST_SUN}
    arguments |= {"wheel_speed_rad_s": 865.0, "duration_s": 60.0} | change
    with pytest.raises(ss.InputError, match=message):
        ss.scan(PHILAE, **arguments)


def test_a_scan_store_is_resumed_with_another_mass_and_refused_with_another_wheel(tmp_path):
    """What only a landing asks for does not belong to a scan."""

    def run(*changes):
        craft = ss.load_vehicle("philae", changes)
        axes = [0.1], [0.2], [0.0, 0.1]
        target, store = [0.2, 0.8], tmp_path / "rows"
        return ss.scan(craft, target, FIRST_SUN, *axes, 865.0, 60.0, store=store)

    first = run()
    assert run("body.mass_kg=90", "leg[2].tip_B_m[0]+=0.1").values.tolist() == first.values.tolist()
    with pytest.raises(ss.InputError, match="one of other inputs"):
        run("wheel.inertia_kg_m2*=1.1")


Z = (np.arange(400_000) + 0.5) / 200_000 - 1


def area(hist, target, weights) -> float:
    """Half the integral of |C_r - C_n| over [-1, 1], by the midpoint rule."""
    ours = np.interp(
        Z, np.linspace(-1, 1, BINS + 1), np.concatenate([[0.0], np.cumsum(hist)]) / hist.sum()
    )
    order = np.argsort(target)
    steps = np.concatenate([[0.0], np.cumsum(weights[order])]) / weights.sum()
    return float(np.abs(ours - steps[np.searchsorted(target[order], Z, side="right")]).mean())


@pytest.mark.parametrize("seed", range(2))
def test_histogram_emd_is_half_the_area_between_the_distributions(seed):
    rng = np.random.default_rng(seed)
    hist = rng.exponential(1.0, (6, BINS)) * (rng.random((6, BINS)) < rng.uniform(0.02, 1, (6, 1)))
    hist[:, : rng.integers(1, 40)] = 0.0  # both distributions are zero there
    hist = np.append(hist, np.zeros((1, BINS)), axis=0)
    target, weights = rng.uniform(-0.8, 1, 17), rng.uniform(0, 1, 17)
    target[:3] = target[3]
    emd = distances_to_target(hist.astype(np.float32), target_segments(target, weights))
    expected = [area(row, target, weights) for row in hist[:-1]]
    np.testing.assert_allclose(emd[:-1], expected, rtol=0, atol=2e-6)
    assert emd[-1] == 1  # nothing was seen
