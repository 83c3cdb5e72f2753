"""Panels that share an input of the power system: the file, the readings, and the remaining ambiguity."""

from importlib import resources

import numpy as np
import pytest
import xarray as xr

import sunspin as ss
from sunspin.estimate.scan.directions import reconstructible_mask
from sunspin.telemetry.sun import reconstructible_patterns
from sunspin.vehicle.file import parse_vehicle
from sunspin.vehicle.response.flat import normalise_readings
from sunspin.vehicle.response.joined import JoinedResponse
from sunspin.vehicle.response.planes import sphere
from tests.support.vehicles import FACES, directions

THREE = {axis: (f"+{axis}", f"-{axis}") for axis in "XYZ"}
ONE = {"X": THREE["X"]}
MOVES = """
[body]
inertia_kg_m2 = [[0.042, 0, 0], [0, 0.041, 0], [0, 0, 0.012]]
[disturbance]
acceleration_noise = 5e-6
max_rate_rad_s = 0.06
"""
GYRO = '[gyro]\ncolumns = ["gx", "gy", "gz"]\nscale_rad_s = 1.0\nnoise_rad_s = 1e-3\n'
NOISE = 0.005


def text(channels, reads="sum", more="", telemetry="", channel=""):
    panels = "".join(
        f'[[panel]]\nname = "{name}"\nnormal_B = {normal}\ngain_A = 0.5\n'
        for name, normal in FACES.items()
    )
    shared = "".join(
        f'[[channel]]\nname = "{name}"\npanels = [{", ".join(repr(each) for each in names)}]\nreads = "{reads}"\n{channel}\n'
        for name, names in channels.items()
    )
    return f'name = "c"\n{panels}{shared}[telemetry]\nquantity = "current_A"\nnoise = {NOISE}\n{telemetry}\n{more}'


def craft(channels, **said):
    return parse_vehicle(text(channels, **said), "c.toml")


# ------------------------------------------------------------------------------------------------------------------- what is said


def test_readings_of_channels_are_those_of_their_panels():
    """In the order of the panels, a channel where its first panel stands."""
    vehicle = craft({"Y": THREE["Y"], "odd": ("+X", "+Z")})
    assert vehicle.input_names == ("odd", "-X", "Y", "-Z") and len(vehicle.panels) == 6
    for sun, reading in (([0.6, 0, 0.8], [0.7, 0, 0, 0]), ([-0.6, -0.8, 0], [0, 0.3, 0.4, 0])):
        np.testing.assert_allclose(ss.panel_power(vehicle, sun), reading, atol=1e-15)
    np.testing.assert_allclose(vehicle.input_gains, [0.5 * np.sqrt(2), 0.5, 0.5, 0.5], rtol=1e-12)
    largest = craft({"odd": ("+X", "+Z")}, reads="largest")
    np.testing.assert_allclose(ss.panel_power(largest, [0.6, 0.0, 0.8])[0], 0.4, atol=1e-15)
    each = vehicle.response_of_panels().power(np.array([0.6, 0.0, 0.8]))
    np.testing.assert_allclose(each, [0.3, 0, 0, 0, 0.4, 0], atol=1e-15)


WIRED = '[telemetry.columns]\n"+X" = "px"'
SHARED = '[telemetry.columns]\n"+X" = "i"\n"-X" = "i"'


def test_a_wrong_channel_is_refused_in_one_sentence():
    for written, told in (
        (text({"X": ("+X", "top")}), "channel 'X' names a panel that the vehicle does not have"),
        (text({"X": ("+X", "-X"), "Y": ("-X", "+Y")}), "a panel is in two channels"),
        (text({"X": ("+X", "+X")}), "channel 'X' names a panel twice"),
        (text({"X": ()}), "channel 'X' names no panel"),
        (text(ONE, reads="mean"), "should be 'sum' or 'largest'"),
        (text({"+Y": THREE["X"]}), "channel '+Y' is called like a panel that is not in it"),
        (text(ONE, more=WIRED), "telemetry.columns names a panel that is read through a channel"),
        (text(ONE, channel="throttled = true"), "some inputs are throttled and others are not"),
        (text(ONE, channel="throttled = 1"), "should be a valid boolean"),
        (text(ONE, channel="throtled = true"), "did you mean throttled?"),
        (text({}, more=SHARED), "panels that share an input"),
    ):
        with pytest.raises(ss.VehicleError) as caught:
            parse_vehicle(written, "c.toml")
        said = str(caught.value)
        assert told in said and "\n" not in said and said.startswith("c.toml")


def test_the_template_shows_a_channel_that_works():
    told = resources.files("sunspin").joinpath("template", "vehicle.toml").read_text("utf-8")
    lines = told[told.index("#   [[channel]]") :].splitlines()[:5]
    added = "\n".join(line.removeprefix("#   ") for line in lines)
    opened = told.replace('"+X" = "px"\n"-X" = "mx"', '"X" = "ix"') + added
    assert parse_vehicle(opened, "template").input_names == ("X", "+Y", "-Y", "+Z")


def test_telemetry_is_read_by_channels(tmp_path):
    file = tmp_path / "samples.csv"
    file.write_text("time,IX_A,+Y,-Y,zp,-Z\n2026-01-01T00:00:00Z,0.1,0,0.2,0,0.3\n")
    vehicle = craft(ONE, more='[telemetry.columns]\n"+Z" = "zp"\n')
    samples = ss.read_telemetry(file, vehicle)
    assert samples["panel"].values.tolist() == ["X", "+Y", "-Y", "+Z", "-Z"]
    assert samples.attrs["unused_columns"] == ""
    np.testing.assert_array_equal(samples["current_A"].values, [[0.1, 0, 0.2, 0, 0.3]])


# --------------------------------------------------------------------------------------------------------------------- directions


@pytest.mark.parametrize(
    ("channels", "reads"), [(THREE, "sum"), (ONE, "largest"), ({"odd": ("+X", "+Y")}, "sum")]
)
def test_directions_that_fit_equally_are_found_and_one_is_given_only_if_unique(channels, reads):
    """Against a fine grid of directions: none fits better, and one is given only where all that fit are in one place."""
    vehicle = craft(channels, reads=reads)
    readings = ss.panel_power(vehicle, directions(12, 1))
    grid = directions(40_000, 2)
    unit = ss.panel_power(vehicle, grid)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    shape = readings / np.linalg.norm(readings, axis=1, keepdims=True)
    away = np.linalg.norm(unit - shape[:, None], axis=-1)
    response = vehicle.response_in()
    delta = response.best_direction(readings)[1]
    assert (delta <= away.min(axis=1) + 1e-12).all()
    alike = response.near_best(readings, np.full(12, 0.05))
    for some, off, least in zip(alike, away, delta, strict=True):
        some = some[np.isfinite(some[:, 0])]
        # an apart neighbourhood without a direction in it were one that is missed
        for place in grid[off < 0.02]:
            assert (some @ place).max() > np.cos(0.3) or least > 0.01
    sun = ss.sun_directions(vehicle, readings)
    given = np.isfinite(sun["sun_B"].values[:, 0])
    for is_given, off in zip(given, away, strict=True):
        near = grid[off < 0.02]
        assert not (is_given and (near @ near.T).min() < np.cos(0.3))


ARCS = [({"odd": ("+X", "+Y")}, "sum"), ({"a": ("+X", "+Y", "-Z"), "b": ("-X", "+Z")}, "largest")]


@pytest.mark.parametrize(("channels", "reads"), [(THREE, "sum"), (ONE, "largest"), *ARCS])
def test_no_direction_of_the_sphere_fits_better_than_the_closed_form(channels, reads):
    vehicle, rng = craft(channels, reads=reads), np.random.default_rng(3)
    readings = ss.panel_power(vehicle, directions(25, 6))
    readings = np.maximum(readings + 0.02 * rng.normal(size=readings.shape), 0.0)
    shape = normalise_readings(ss.panel_power(vehicle, sphere(200_000)))
    least = np.sqrt(np.maximum(2 - 2 * (normalise_readings(readings) @ shape.T).max(axis=1), 0.0))
    assert (vehicle.response_in().best_direction(readings)[1] <= least + 1e-6).all()


def test_more_planes_than_can_be_cut_are_refused():
    """Eleven panels on one input of which the largest is read: 55 planes between them."""
    names = [f"p{k}" for k in range(11)]
    panels = "".join(
        f'[[panel]]\nname = "{name}"\nnormal_B = {normal}\ngain_A = 0.5\n'
        for name, normal in zip(names, directions(11).tolist(), strict=True)
    )
    shared = f'[[channel]]\nname = "all"\npanels = {names}\nreads = "largest"\n'
    vehicle = parse_vehicle(f'name = "c"\n{panels}{shared}', "c.toml")
    with pytest.raises(ss.VehicleError, match="66 planes, more than 40"):
        ss.sun_directions(vehicle, np.ones((1, 1)))


@pytest.mark.parametrize("reads", ["sum", "largest"])
def test_the_mask_of_a_scan_counts_what_channels_allow(reads):
    vehicle, sun = craft({"odd": ("+X", "+Y")}, reads=reads), directions(20_000, 3)
    good, names = reconstructible_patterns(vehicle), np.array(vehicle.input_names)
    lit = ss.panel_power(vehicle, sun) > 0
    expected = [frozenset(names[row].tolist()) in good for row in lit]
    assert np.mean(reconstructible_mask(vehicle).contains(sun) != expected) < 1e-3


def test_with_three_channels_no_pattern_gives_a_direction():
    assert not reconstructible_patterns(craft(THREE))
    assert reconstructible_patterns(craft({"odd": ("+X", "+Y")}))
    symmetries = [craft(channels).response_in().symmetries for channels in (THREE, ONE, {})]
    assert [*map(len, symmetries)] == [8, 2, 1]


@pytest.mark.parametrize("reads", ["sum", "largest"])
def test_slopes_of_channel_readings_agree_with_differences(reads):
    response = craft({"odd": ("+X", "+Y"), "Z": THREE["Z"]}, reads=reads).response_in()
    sun = directions(50, 5)
    gain = np.array([1.1, 0.9, 1.2, 1.0])
    assert isinstance(response, JoinedResponse)
    step, slope = 1e-6, response.slopes(sun, gain=gain).to_sun
    for axis in np.eye(3):
        across = axis - (sun @ axis)[:, None] * sun
        ends = [response.power(sun + sign * step * across, gain=gain) for sign in (1, -1)]
        difference = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(np.einsum("npi,ni->np", slope, across), difference, atol=1e-5)


# ------------------------------------------------------------------------------------------------------------------------- motion


def flight(vehicle, seed, samples=16, step_s=12.0):
    rng = np.random.default_rng(seed)
    t = np.cumsum(step_s * rng.uniform(0.8, 1.2, samples))
    omega, sun = 0.03 * directions(1, seed + 1)[0], directions(1, seed + 2)[0]
    known = {"omega_B": omega, "sun_B": sun, "t_s": t - t[0], "noise": NOISE}
    data = ss.twin(vehicle, known, seed=seed)
    truth = ss.propagate(vehicle, omega, sun, [], data["time"].values)
    if vehicle.sensors.gyro:
        read = truth["omega_B"].values + 1e-3 * rng.normal(size=(samples, 3))
        data["gyro_B"] = ("time", "axis"), read
    if vehicle.throttled:
        share = xr.DataArray(rng.uniform(0.2, 1.0, samples), dims="time")
        data["current_A"] = data["current_A"] * share
    return data, truth


def away(result, truth):
    """Distance (K) of the modes from the truth, in the largest of the components' sigmas."""
    omega, sigma = (
        np.stack([result[f"{name}_{axis}"].values[0] for axis in "xyz"], axis=-1)
        for name in ("omega", "sigma")
    )
    middle = np.argmin(np.abs(truth["time"].values - truth["time"].values[-1] / 2))
    return np.abs((omega - truth["omega_B"].values[middle]) / sigma).max(axis=-1)


def test_three_channels_leave_eight_symmetric_solutions():
    vehicle = craft(THREE, more=MOVES)
    data, truth = flight(vehicle, 0)
    result = ss.rates(vehicle, data)
    assert not result["decided"].values[0] and not result["unique"].values[0]
    assert result["fits"].values[0]
    assert np.nanmin(away(result, truth)) < 4
    sizes = np.abs(np.stack([result[f"omega_{axis}"].values[0, :8] for axis in "xyz"], axis=-1))
    assert np.ptp(sizes, axis=0).max() < 1e-3  # eight motions of one size, component by component
    assert "7 symmetric solutions" in result.attrs["verdict"]


@pytest.mark.long
def test_a_gyro_decides_the_rates_of_three_channels_and_not_the_attitude():
    vehicle = craft(THREE, more=MOVES + GYRO)
    data, truth = flight(vehicle, 1)
    result = ss.rates(vehicle, data)
    assert result["decided"].values[0] and away(result, truth)[0] < 4
    assert "attitude is unknown" in result.attrs["verdict"]


def test_power_limited_samples_are_used_by_their_ratios():
    """A full battery leaves a fifth of the light in some samples: none is left out, and their directions are as good."""
    vehicle = craft(THREE, more=MOVES, channel="throttled = true")
    data, truth = flight(vehicle, 3)
    quality = ss.panel_quality(vehicle, data)
    assert (quality["use"].values == 0).all() and quality["scale_sigma"].values.min() >= 2
    size = np.linalg.norm(data["current_A"].values, axis=1)
    np.testing.assert_allclose(quality["scale"].values * 0.5, size, rtol=0.1)
    assert np.nanmin(away(ss.rates(vehicle, data), truth)) < 4


def nearest(tree, truth):
    """Distance of the nearest mode of a posterior from the truth, in its sigmas (of three components together)."""
    modes = tree["solutions"]
    gaps = modes["omega_B"].values - truth["omega_B"].values[0]
    return min(
        np.sqrt(gap @ np.linalg.solve(cov, gap))
        for gap, cov in zip(gaps, modes["omega_cov_B"].values, strict=True)
    )


@pytest.mark.long
@pytest.mark.parametrize(
    "throttled", [pytest.param("", marks=pytest.mark.slow), "throttled = true"]
)
def test_the_posterior_of_three_channels_lists_the_truth_among_symmetric_solutions(throttled):
    vehicle = craft(THREE, more=MOVES, channel=throttled)
    data, truth = flight(vehicle, 0, samples=12, step_s=6.0)
    priors = {"steady_torque": 0} if throttled else {}
    tree = ss.posterior(vehicle, data, priors, seed=1, draws=300)
    assert nearest(tree, truth) < 4 and tree.attrs["verdict_word"] != "unique"
    assert "7 symmetric solutions" in tree.attrs["verdict"]


@pytest.mark.evidence(
    "posterior",
    "modelled",
    "simulated passes whose samples are lowered to 20 to 100 % by unknown factors",
)
def test_the_posterior_of_power_limited_panels_uses_their_ratios():
    """The truth is found and decided; there is no brightness to be told."""
    vehicle = craft({}, more=MOVES, telemetry="throttled = true")
    data, truth = flight(vehicle, 1, samples=8, step_s=6.0)
    tree = ss.posterior(vehicle, data, {"steady_torque": 0}, seed=1, draws=300)
    assert nearest(tree, truth) < 4
    assert tree.attrs["verdict_word"] == "unique"
    assert tree["passes"]["decided"].values[0]
    assert "log_scale" not in tree["posterior"] and "throttled" in str(tree.attrs)
    with pytest.raises(ss.InputError, match=r"turns of panels that .* are throttled"):
        ss.posterior(vehicle, data, {"tilt": 0.02})
