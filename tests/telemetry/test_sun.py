"""Panels and Sun directions: geometry, the exact minimum compared with brute force, status, uncertainty over many directions."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import chi2, kstest

import sunspin as ss
from sunspin.telemetry.assess import assess
from sunspin.telemetry.sun import SunStatus, is_reconstructed, reconstructible_patterns
from sunspin.vehicle import Panel, Vehicle
from sunspin.vehicle.response.panels import lit_patterns, panel_power
from tests.support.simulate import telemetry_of
from tests.support.vehicles import directions


def random_panels(seed: int, n: int) -> Vehicle:
    rng, normals = np.random.default_rng(seed), directions(n, seed + 1000)
    panels = [Panel(str(k), p, rng.uniform(0.5, 2)) for k, p in enumerate(normals)]
    return Vehicle("random", panels=panels)


PHILAE = ss.load_vehicle("philae")


@pytest.mark.evidence("panel_power", "verified", "computed by hand from Philae's table of panels")
def test_panel_power_by_hand():
    side = 162 * 0.6
    expected = [0, side / np.sqrt(2), side, side / np.sqrt(2), 0, 230 * 0.8]
    np.testing.assert_allclose(panel_power(PHILAE, [0.6, 0.0, 0.8]), expected, rtol=1e-12)


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(1, 6))]
)
def test_illumination_patterns_of_any_vehicle_are_those_of_random_directions(seed):
    vehicle = random_panels(seed, 5)
    names = np.array(vehicle.panel_names)
    lit = np.unique(panel_power(vehicle, directions(100_000)) > 0, axis=0)
    shown = {frozenset(names[row].tolist()) for row in lit}
    assert shown <= set(lit_patterns(vehicle))
    # n great circles in general position cut the sphere into n(n-1)+2
    assert len(set(lit_patterns(vehicle))) == 5 * 4 + 2


@pytest.mark.evidence("sun_directions", "verified", "5/16 of the sphere, from the normals by hand")
def test_philae_reconstructs_the_sun_in_five_sixteenths_of_the_sphere(reached):
    n = directions(40_000)
    azimuth = np.degrees(np.arctan2(n[:, 1], n[:, 0]))
    expected = (n[:, 2] > 0) & (azimuth > -135) & (azimuth < 90)
    names = np.array(PHILAE.panel_names)
    lit = panel_power(PHILAE, n) > 0
    good = reconstructible_patterns(PHILAE)
    assert np.array_equal([frozenset(names[row].tolist()) in good for row in lit], expected)
    reached("share of directions that can be reconstructed", expected.mean())
    assert expected.mean() == pytest.approx(5 / 16, abs=0.01)


@pytest.mark.evidence(
    "sun_directions", "verified", "5,000 directions through the forward model and back"
)
@pytest.mark.parametrize("case", ["philae", "skcube"])
def test_noise_free_powers_give_the_true_direction(case, reached):
    vehicle, n = ss.load_vehicle(case), directions(5000, 3)
    sun = ss.sun_directions(vehicle, panel_power(vehicle, n), lit_threshold=1e-9)
    told = is_reconstructed(sun["status"])
    assert told.mean() > 0.25
    assert np.abs(sun["sun_B"].values - n)[told].max() < 1e-9
    assert sun["delta"].values[told].max() < 1e-9
    reached("largest error of a component", np.abs(sun["sun_B"].values - n)[told], "", 1e-9)
    assert np.all(np.isnan(sun["sun_B"].values[~told]))


def misfit(vehicle, n, power):
    shape = panel_power(vehicle, n / np.linalg.norm(n))
    size = np.linalg.norm(shape)
    return 2.0 if size == 0 else np.linalg.norm(shape / size - power / np.linalg.norm(power))


@pytest.mark.evidence(
    "sun_directions", "verified", "SciPy's Nelder-Mead over the sphere, inconsistent powers too"
)
@pytest.mark.parametrize("seed", range(4))
def test_the_best_direction_is_the_global_minimum_for_any_powers(seed, reached):
    """Random, also inconsistent powers, against a dense search with local polish."""
    rng = np.random.default_rng(seed)
    vehicle = PHILAE if seed % 2 else random_panels(seed, int(rng.integers(3, 7)))
    size = 1, len(vehicle.panels)
    power = rng.uniform(0, 1, size) * rng.integers(0, 2, size)
    power[0, 0] += 0.1
    n, delta = vehicle.response_in().best_direction(power)
    grid = directions(20_000, 9)
    shape = panel_power(vehicle, grid)
    size = np.linalg.norm(shape, axis=1)
    unit = shape / np.where(size > 0, size, 1)[:, None]
    found = np.where(size > 0, np.linalg.norm(unit - power / np.linalg.norm(power), axis=1), 2.0)
    search = {"method": "Nelder-Mead", "options": {"xatol": 1e-10, "fatol": 1e-12, "maxiter": 4000}}
    starts = grid[np.argsort(found)[:5]]
    ends = [minimize(lambda x: misfit(vehicle, x, power[0]), one, **search) for one in starts]
    best = min(2.0, *(end.fun for end in ends))
    assert delta[0] <= best + 1e-7
    reached("Delta above the best that the search found", delta[0] - best, "", 1e-7)
    assert misfit(vehicle, n[0], power[0]) == pytest.approx(delta[0], abs=1e-12)


def test_a_swapped_or_scaled_panel_raises_the_misfit_if_more_than_three_are_lit():
    n = directions(3000, 5)
    power = panel_power(PHILAE, n)
    four = (power > 0).sum(axis=1) >= 5
    swapped, scaled = power[:, [0, 2, 1, 3, 4, 5]], power * [1, 1.3, 1, 1, 1, 1]
    for wrong in (swapped[four], scaled[four]):
        assert np.median(ss.sun_directions(PHILAE, wrong)["delta"].values) > 0.02
    assert ss.sun_directions(PHILAE, power[four])["delta"].values.max() < 1e-9


def test_three_lit_panels_are_reported_as_unchecked():
    right = panel_power(PHILAE, [[-0.3, -0.6, 0.7]])
    sun = ss.sun_directions(PHILAE, [right[0], right[0] * [1, 1, 1, 2, 1, 1]], lit_threshold=1e-6)
    assert (sun["status"].values == SunStatus.UNCHECKED).all()
    assert "exactly three" in sun["status_text"].values[0]
    assert sun["delta"].values[1] < 1e-9


def test_every_sample_without_a_direction_has_a_status():
    lit = {
        SunStatus.DARK: [0, 0, 0, 0, 0, 0],
        SunStatus.REGION: [1, 0, 0, 0, 0, 0],
        SunStatus.ARC: [0, 0, 1, 1, 1, 0],
        SunStatus.RULE: [1, 1, 0, 0, 0, 1],
        SunStatus.IMPOSSIBLE: [0, 1, 1, 0, 0, 1],
        SunStatus.MISSING: [np.nan, 1, 1, 0, 0, 1],
    }
    sun = ss.sun_directions(PHILAE, np.array([*lit.values()], dtype=float), lit_threshold=0.1)
    assert sun["status"].values.tolist() == list(lit)
    assert all(len(text) > 10 for text in sun["status_text"].values)


def arc_ends(craft, power):
    """Return the ends of the arc of directions of one sample, the lower one first."""
    sun = ss.sun_directions(craft, power, lit_threshold=1e-9)
    assert sun["status"].values[0] == SunStatus.ARC
    return sorted(sun["sun_arc_B"].values[0].tolist(), key=lambda end: end[2])


def test_an_arc_of_directions_without_dark_panels_is_half_a_circle():
    """Two lit panels in one plane and no other: from one pole of that plane over what they see to the other."""
    craft = Vehicle("two", panels=[Panel("a", [1, 0, 0], 1.0), Panel("b", [0, 1, 0], 1.0)])
    ends = arc_ends(craft, [[0.6, 0.8]])
    np.testing.assert_allclose(ends, [[0, 0, -1], [0, 0, 1]], rtol=0, atol=1e-12)
    # at z < 0 Philae's side powers fix the azimuth only: the arc runs from the horizon to the nadir
    n = np.array([0.7, -0.3, -0.5]) / np.linalg.norm([0.7, -0.3, -0.5])
    azimuth = np.array([0.7, -0.3, 0]) / np.linalg.norm([0.7, -0.3, 0])
    ends = arc_ends(PHILAE, panel_power(PHILAE, n[None]))
    np.testing.assert_allclose(ends, [[0, 0, -1], azimuth], atol=1e-9)


@pytest.mark.evidence(
    "sun_directions", "verified", "4,000 noisy samples; half of the true noise must be detected"
)
def test_direction_covariance_covers_as_stated_and_detects_a_wrong_noise(reached):
    rng = np.random.default_rng(0)
    n = np.array([0.5, 0.3, 0.81]) / np.linalg.norm([0.5, 0.3, 0.81])
    power = panel_power(PHILAE, n)
    noisy = power + np.where(power > 0, rng.normal(size=(4000, 6)) * 2.0, 0)
    chi2 = []
    for assumed in (2.0, 1.0):
        sun = ss.sun_directions(PHILAE, noisy, noise=assumed)
        error = sun["sun_B"].values - n
        basis = np.linalg.svd(n[None])[2][1:]
        reduced = np.einsum("ai,nij,bj->nab", basis, sun["sun_cov_B"].values, basis)
        flat = error @ basis.T
        chi2.append(np.einsum("na,nab,nb->n", flat, np.linalg.inv(reduced), flat).mean())
    reached("chi-square, two degrees of freedom", chi2[0])
    reached("with half the noise assumed", chi2[1])
    assert chi2[0] == pytest.approx(2.0, abs=0.15)  # two degrees of freedom
    assert chi2[1] > 6.0
    sun = ss.sun_directions(PHILAE, noisy, noise=2.0)
    angle = np.arccos(np.clip(sun["sun_B"].values @ n, -1, 1))
    rms = np.sqrt((angle**2).mean())
    assert np.median(sun["sigma_rad"].values) == pytest.approx(rms, rel=0.1)


def test_panel_noise_is_estimated_if_panels_are_redundant():
    rng = np.random.default_rng(1)
    vehicle = Vehicle("philae without noise", panels=PHILAE.panels)
    power = panel_power(vehicle, np.tile([[0.8, 0.1, 0.59]], (4000, 1)))
    noisy = power + np.where(power > 0, rng.normal(size=power.shape) * 1.5, 0)
    assert ss.sun_directions(vehicle, noisy).attrs["noise"] == pytest.approx(1.5, rel=0.05)


@pytest.mark.parametrize(
    "normals",
    [[[1, 0, 0]], [[1, 0, 0], [-1, 0, 0]], [[1, 0, 0], [1, 0, 0]], [[1, 0, 0], [0, 1, 0]]],
)
def test_degenerate_panels_give_no_direction(normals):
    vehicle = Vehicle("few", panels=[Panel(str(k), p, 1.0) for k, p in enumerate(normals)])
    sun = ss.sun_directions(vehicle, panel_power(vehicle, directions(50)), lit_threshold=1e-9)
    assert not is_reconstructed(sun["status"]).any()
    assert sun["delta"].values[sun["n_lit"].values > 0].max() < 1e-9


def test_direction_covariance_covers_over_all_directions():
    """Squared distance of the truth in the stated tangent covariance: chi-square of two degrees of freedom."""
    rng, noise = np.random.default_rng(0), 1.5
    sun = rng.normal(size=(3000, 3))
    sun /= np.linalg.norm(sun, axis=1)[:, None]
    power = ss.panel_power(PHILAE, sun)
    power = power[clear := (power > 0).sum(axis=1) >= 3]
    power = np.where(power > 0, power + rng.normal(size=power.shape) * noise, 0.0)
    least = np.where(power != 0, power, np.inf).min(axis=1)
    enough = least > 6 * noise  # grazing panels are no longer linear
    found = ss.sun_directions(PHILAE, power, noise=noise, lit_threshold=3 * noise)
    use = is_reconstructed(found["status"]) & enough
    told = found["sun_B"].values[use]
    basis = np.linalg.svd(told[:, None, :])[2][:, 1:]
    tangent = np.einsum("nai,nij,nbj->nab", basis, found["sun_cov_B"].values[use], basis)
    error = np.einsum("nai,ni->na", basis, sun[clear][use] - told)
    square = np.einsum("na,nab,nb->n", error, np.linalg.inv(tangent), error)
    assert len(square) > 300
    for level in (0.5, 0.68, 0.95):
        held = np.mean(square < chi2(2).ppf(level))
        assert held == pytest.approx(level, abs=4 * np.sqrt(level * (1 - level) / len(square)))
    assert kstest(square, chi2(2).cdf).statistic < 1.95 / np.sqrt(len(square))  # the 0.1 % point


def test_small_panels_of_a_body_with_wings_count_as_lit_in_the_light_of_the_earth():
    """The Earth lights each panel with the same share of its full Sun: the largest one sets no threshold for the others."""
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    gains = np.array([1.0, 1.0, 0.2, 1.0, 1.0, 0.2])
    panels = [Panel(str(k), normals[k], gain=gains[k]) for k in range(6)]
    craft = Vehicle("wings", panels=panels)
    sun = directions(200)
    value = gains * (np.maximum(sun @ normals.T, 0) + 0.15 * np.maximum(-sun @ normals.T, 0))
    found = assess(craft, telemetry_of(craft, 30.0 * np.arange(200), value)).sun
    threshold = found["lit_threshold"].values / gains
    assert np.ptp(threshold) < 1e-9 and 0.2 < threshold[0] < 0.4
    clear = (np.abs(sun) > 0.4).all(axis=1)
    assert clear.sum() > 20 and is_reconstructed(found["status"].values)[clear].all()
