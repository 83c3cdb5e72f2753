"""A noise for each panel: what uses it, and that equal ones are the same as a common noise."""

from dataclasses import replace
from importlib import resources

import numpy as np
import pytest

import sunspin as ss
from sunspin.estimate.lander.window import observe_window
from sunspin.output.check.samples import noise_lines
from sunspin.philae.sun_directions import apply_measured_noise
from sunspin.telemetry.assess import assess
from sunspin.telemetry.health import noise_alone
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from sunspin.vehicle.response.flat import unweighted_covariance

NORMALS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
TURNED = np.array([[1, 1, 1], [-1, -1, 1], [-1, 1, -1], [1, -1, -1]]) / np.sqrt(3)
GAINS = np.array([10.0, 10, 1, 1, 4, 4, 2, 10, 1, 4])
NOISE = 0.01 * GAINS


def craft(**form) -> Vehicle:
    """Ten panels whose full signals and noises have ratios up to 10."""
    panels = zip(np.concatenate([NORMALS, TURNED]), GAINS, NOISE, strict=True)
    return Vehicle(
        "unlike",
        inertia_kg_m2=np.diag([0.010, 0.012, 0.008]),
        panels=[Panel(str(k), n, g, noise=s) for k, (n, g, s) in enumerate(panels)],
        gain_unit="W",
        telemetry=TelemetryForm(**form),
    )


def track(n: int = 20, **more):
    truth = {"omega_B": [0.011, -0.017, 0.009], "sun_B": [0.6, 0.0, 0.8]}
    return ss.twin(craft(), truth | {"t_s": 20.0 * np.arange(n)} | more, seed=5)


def template(noise_of_each: bool) -> Vehicle:
    vehicle = ss.load_vehicle(str(resources.files("sunspin") / "template" / "vehicle.toml"))
    common = vehicle.telemetry.noise
    if not noise_of_each:
        return vehicle
    panels = tuple(replace(panel, noise=common) for panel in vehicle.panels)
    return replace(vehicle, panels=panels, telemetry=replace(vehicle.telemetry, noise=None))


def test_the_same_noise_for_each_panel_equals_a_common_noise():
    one, each = template(False), template(True)
    file = str(resources.files("sunspin") / "template" / "telemetry.csv")
    samples = ss.read_telemetry(file, one)
    for make in (ss.sun_directions, ss.panel_quality, ss.panel_health):
        before, after = make(one, samples), make(each, ss.read_telemetry(file, each))
        assert set(before) == set(after)
        for name in before.variables:
            assert np.array_equal(before[name], after[name], before[name].dtype.kind == "f"), name
        assert before.attrs.get("noise") == after.attrs.get("noise")
    first, second = (observe_window(assess(vehicle, samples)) for vehicle in (one, each))
    assert np.array_equal(first.obs.terms[0].sigma, second.obs.terms[0].sigma)
    assert first.noise_from == second.noise_from
    # the usual formula, to the last bit
    design = np.random.default_rng(0).normal(size=(5, 3))
    usual = 0.3**2 * np.linalg.inv(design.T @ design)
    assert np.array_equal(unweighted_covariance(design, np.full(5, 0.3)), usual)


def test_panel_noise_changes_errors_of_directions_and_not_directions():
    suns = np.random.default_rng(1).normal(size=(4000, 3))
    suns /= np.linalg.norm(suns, axis=1, keepdims=True)
    exact = ss.panel_power(craft(), suns)
    read = exact + np.where(exact > 0, NOISE * np.random.default_rng(2).normal(size=exact.shape), 0)
    alike = replace(craft(), panels=[replace(x, noise=0.03) for x in craft().panels])
    found, other = ss.sun_directions(craft(), read), ss.sun_directions(alike, read)
    assert np.array_equal(found["best_B"], other["best_B"])
    assert np.array_equal(found["lit_threshold"], 3 * NOISE)
    assert found.attrs["noise_from"] == "given"
    good = (found["status"] <= 1) & ((exact > 6 * NOISE) | (exact == 0)).all(axis=1)
    off = np.linalg.norm(found["sun_B"] - suns, axis=1)[good] / found["sigma_rad"][good]
    assert good.sum() > 1000 and 0.9 < np.sqrt(np.mean(off**2)) < 1.1
    off = np.linalg.norm(other["sun_B"] - suns, axis=1)[good] / other["sigma_rad"][good]
    assert np.sqrt(np.mean(off**2)) > 1.3  # one noise of all is mildly over-sure
    chance = noise_alone(craft(), read[:500], NOISE, 3 * NOISE).probability
    assert all(np.mean(chance < level) <= level for level in (0.01, 0.1, 0.5))


def test_synthetic_data_have_the_noise_of_each_panel():
    samples = track(1000)
    exact = ss.panel_power(craft(), samples["true_sun_B"].values)
    pull = np.where(exact > 0, (samples["power_W"].values - exact) / NOISE, np.nan)
    assert np.all(np.abs(np.sqrt(np.nanmean(pull**2, axis=0)) - 1) < 0.1)
    assert np.array_equal(samples.attrs["truth_noise"], NOISE)
    line = "  noise of panel readings, from the vehicle file: 0 0.1, 1 0.1, 2 0.01"
    assert noise_lines(assess(craft(), samples))[0].startswith(line)
    case = ss.load_case("philae")
    shape = np.linspace(1.0, 2.0, len(case.vehicle.panels))
    panels = [replace(x, noise=0.02 * s) for x, s in zip(case.vehicle.panels, shape, strict=True)]
    own = replace(case, vehicle=replace(case.vehicle, panels=tuple(panels)))
    own.__dict__["telemetry"] = case.telemetry
    scaled, noise = apply_measured_noise(own)
    ratio = scaled.vehicle.input_noise / np.median(shape)
    np.testing.assert_allclose(ratio / shape * np.median(shape) ** 2, noise.lit, rtol=1e-9)


def test_rates_and_posterior_use_the_noise_of_each_panel():
    samples = track(12)
    quality = ss.panel_quality(craft(), samples)
    assert np.allclose(quality["noise"], NOISE, rtol=1e-3)
    rates = ss.rates(craft(), samples, max_rate_rad_s=0.1)
    truth = np.array(samples.attrs["truth_omega_B"])
    sigma = np.sqrt(np.trace(rates["omega_cov_B"].values[0]))
    assert np.linalg.norm(rates["omega_B"].values[0] - truth) < 3 * sigma < 0.01
    priors = {"max_rate_rad_s": 0.05, "tilt": 0, "tilt_common": 0, "scale": 0, "gain": 0}
    tree = ss.posterior(craft(), samples, priors, seed=0, draws=300, workers=1)
    away = tree["posterior"]["omega_B"].values.reshape(-1, 3) - truth
    assert np.sqrt(np.mean(away**2)) < 1e-3 and tree.attrs["noise"] == np.median(NOISE)
    assert abs(tree.attrs["noise_sigmas"]) < 3 and tree.attrs["p_value"] > 0.01


def test_wrong_panel_noises_are_refused(tmp_path):
    text = (resources.files("sunspin") / "template" / "vehicle.toml").read_text()
    file = tmp_path / "vehicle.toml"

    def refused(changed: str, *words: str) -> None:
        file.write_text(changed)
        with pytest.raises(ss.VehicleError) as error:
            ss.load_vehicle(str(file))
        assert all(word in str(error.value) for word in words), error.value

    own = text.replace('name = "+X"\nnormal_B', 'name = "+X"\nnoise = 0.01\nnormal_B', 1)
    file.write_text(own)
    assert ss.load_vehicle(str(file)).input_noise.tolist() == [0.01, 0.02, 0.02, 0.02, 0.02]
    refused(own.replace("noise = 0.01\n", "noise = 0\n"), "the noise of '+X' must be positive")
    refused(own.replace("\nnoise = 0.02", "\n#"), "states no noise and others do", "found -X")
    channel = '[[channel]]\nname = "X"\npanels = ["+X", "-X"]\nreads = "sum"\nnoise = 0.03\n'
    refused(own + channel, "channel 'X' reads a panel that states a noise of its own")
