"""How panels respond to light: the cosine law and tilted panels; powers, slopes, bounds, albedo."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from sunspin.vehicle.file import parse_vehicle
from sunspin.vehicle.parts import ResponseForm, Tilted
from tests.support.simulate import telemetry_of
from tests.support.vehicles import CUBE_NORMALS, directions

NOISE = 0.004
NAMES = [f"{sign}{axis}" for sign in "+-" for axis in "xyz"]
CUBE = Vehicle(
    "cube",
    gain_unit="A",
    panels=[Panel(name, n, 0.5) for name, n in zip(NAMES, CUBE_NORMALS, strict=True)],
    telemetry=TelemetryForm(quantity="current_A", noise=NOISE),
)
TURN = np.array([0.0, 0.12, 0.15])
FACING = Rotation.from_rotvec(TURN).apply([1.0, 0.0, 0.0])
LAWS = ("cosine", "tilted")


def under(law):
    form = ResponseForm(tilted=Tilted("+x", TURN) if law == "tilted" else None)
    return replace(CUBE, panel_response=form)


def readings(vehicle, n, seed=0, sigma=NOISE):
    sun = directions(n, seed)
    noise = sigma * np.random.default_rng(seed + 1).normal(size=(n, len(vehicle.panels)))
    return np.maximum(ss.panel_power(vehicle, sun) + noise, 0.0), sun


@pytest.mark.parametrize(
    ("law", "sun", "power"),
    [
        ("cosine", [0.8, -0.6, 0.0], [0.4, 0, 0, 0, 0.3, 0]),
        ("tilted", FACING, [0.5, *(0.5 * FACING[1:]), 0, 0, 0]),
    ],
)
def test_powers_of_a_tilted_panel_by_hand(law, sun, power):
    expected = np.maximum(power, 0) + [0, 0, 0, 0, 0, 0.5 * max(-sun[2], 0)]
    np.testing.assert_allclose(ss.panel_power(under(law), sun), expected, atol=1e-15)


@pytest.mark.parametrize("law", LAWS)
def test_slopes_of_a_response_are_those_of_its_powers(law):
    """On directions farther than the step of the differences from an edge, the Sun's and the panels' tilt both."""
    response, sun, step = under(law).response_in(), directions(200, 1), 1e-4
    tilt = 0.05 * np.random.default_rng(2).normal(size=(200, 6, 3))
    power, to_sun, _ = response.slopes(sun, tilt=tilt)
    assert np.array_equal(power, response.power(sun, tilt=tilt))
    for axis in np.eye(3):
        ahead, behind = (Rotation.from_rotvec(sign * step * axis).apply(sun) for sign in (1, -1))
        ends = [response.power(one, tilt=tilt) for one in (ahead, behind)]
        smooth = np.abs(ends[0] + ends[1] - 2 * power) < 1e-7
        of_sun = ((ends[0] - ends[1]) / (2 * step))[smooth]
        expected = (to_sun @ np.cross(axis, sun)[..., None])[..., 0][smooth]
        np.testing.assert_allclose(of_sun, expected, atol=2e-6)
        ends = [response.power(sun, tilt=np.tile(s * step * axis, (6, 1))) for s in (1, -1)]
        smooth = np.abs(ends[0] + ends[1] - 2 * response.power(sun)) < 1e-7
        of_tilt = ((ends[0] - ends[1]) / (2 * step))[smooth]
        expected = (response.slopes(sun, tilt=np.zeros((6, 3))).to_tilt @ axis)[smooth]
        np.testing.assert_allclose(of_tilt, expected, atol=2e-6)
    assert smooth.mean() > 0.95
    steps = [np.cross(axis, sun) for axis in np.eye(3)]
    for turned in (None, tilt):
        plain = response.slopes(sun, tilt=turned)
        changes = response.power_changes(sun, steps, gain=np.full(6, 1.1), tilt=turned)
        for step, along in zip(steps, changes, strict=True):
            slope = 1.1 * np.einsum("npi,ni->np", plain.to_sun, step)
            np.testing.assert_allclose(along, np.where(plain.power > 0, slope, 0.0), atol=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_every_response_scales_with_gain_and_light_and_keeps_its_bounds(law):
    response, sun = under(law).response_in(), directions(60, 4)
    power = response.power(sun)
    assert power.min() >= 0 and np.isnan(response.power(np.full((2, 3), np.nan))).all()
    np.testing.assert_allclose(response.power(sun, gain=np.full(6, 1.1)), 1.1 * power, rtol=1e-14)
    light, by = response.light_power(sun * 3.0)
    np.testing.assert_allclose(light, 3 * power, atol=1e-12)
    by_slope = np.where(power > 0, (by @ sun[..., None])[..., 0], 0)
    np.testing.assert_allclose(by_slope, power, atol=1e-9)
    low, high = response.bounds(sun, 0.2)
    angles = 0.2 * np.random.default_rng(6).uniform(0, 1, (300, 1))
    turns = Rotation.from_rotvec(directions(300, 5) * angles)
    near = np.array([response.power(turn.apply(sun)) for turn in turns])
    assert (near >= low - 1e-12).all() and (near <= high + 1e-12).all()
    assert (high - low).max() < 0.5 * 0.7  # of use, too
    assert np.isnan(response.bounds(np.full((2, 3), np.nan), 0.2)).all()


@pytest.mark.parametrize("law", LAWS)
def test_slopes_of_albedo_agree_with_differences(law):
    response, axis, step = under(law).response_in(), directions(30, 8), 1e-4
    light, slope = response.earthlight(axis, np.full(30, 0.3))
    cosine = CUBE.response_in().earthlight(axis, np.full(30, 0.3))
    for one in np.eye(3):
        ends = [axis * 0.3 + sign * step * one for sign in (1, -1)]
        size = [np.linalg.norm(end, axis=1) for end in ends]
        ahead, behind = (
            response.earthlight(end / length[:, None], length)[0]
            for end, length in zip(ends, size, strict=True)
        )
        np.testing.assert_allclose((ahead - behind) / (2 * step), slope @ one, atol=0.02 * 0.5)
    alike = slice(1 if law == "tilted" else 0, None)
    np.testing.assert_allclose(light[:, alike], cosine[0][:, alike], atol=0.04 * 0.5)


def test_a_tilted_panel_equals_a_panel_with_another_normal():
    """Directions, quality and health as of a vehicle whose file says so."""
    panels = [replace(CUBE.panels[0], normal_B=FACING), *CUBE.panels[1:]]
    both = under("tilted"), replace(CUBE, panels=panels)
    power, _ = readings(both[1], 60)
    data = telemetry_of(CUBE, 30.0 * np.arange(60), power)
    ours, theirs = (ss.sun_directions(vehicle, power) for vehicle in both)
    assert np.array_equal(ours["status"], theirs["status"])
    np.testing.assert_allclose(ours["sun_B"], theirs["sun_B"], atol=1e-6)
    ours, theirs = (ss.panel_quality(vehicle, data) for vehicle in both)
    np.testing.assert_allclose(ours["gain"], theirs["gain"], rtol=1e-4)
    np.testing.assert_allclose(ours["sigma"], theirs["sigma"], rtol=1e-3)
    ours, theirs = (ss.panel_health(vehicle, power)["allowed"] for vehicle in both)
    assert ours == theirs


# ------------------------------------------------------------------------------------------------------- one place, and its file


FILE = """
name = "one"
[[panel]]
name = "a"
normal_B = [1, 0, 0]
gain_W = 1.0
"""


def test_the_vehicle_file_can_tilt_a_panel():
    """A wrong response is refused in one sentence."""
    turn = "turn_B_rad = { value = [0, 0, 0.1], sigma = 0.02, source = 'drawing' }"
    tilted = parse_vehicle(f"{FILE}[panel_response.tilted]\npanel = 'a'\n{turn}", "file")
    assert tilted.facts["panel_response.tilted.turn_B_rad"].sigma == 0.02
    assert ss.panel_power(tilted, [1.0, 0, 0]) == pytest.approx(np.cos(0.1))
    np.testing.assert_allclose(tilted.panel_normals_B[0, 1], np.sin(0.1), rtol=1e-12)
    unknown = "tilted]\npanel = 'b'\nturn_B_rad = [0, 0, 0]"
    for table, words in (
        ("grazing]\nloss = 0.5", ["panel_response.grazing is gone", "leave out"]),
        ("wall]\npanel = 'a'", ["panel_response.wall is gone", "leave out"]),
        ("mirror]\nloss = 1", ["panel_response.mirror", "unknown key", "tilted"]),
        (unknown, ["panel_response.tilted", "not have", "panels: ['a']"]),
    ):
        with pytest.raises(ss.VehicleError) as error:
            parse_vehicle(f"{FILE}[panel_response.{table}", "my.toml")
        assert all(word in str(error.value) for word in ["my.toml", *words])


def test_the_albedo_model_is_that_of_a_wide_disk(reached):
    """Integrated over an evenly bright disk of 66 degrees' radius, for panels turned away from its middle by up to 180 degrees."""
    radius = np.arcsin(6371 / (6371 + 550))  # of the disk from 550 km, rad
    steps = (np.arange(300) + 0.5) / 300 * radius, np.arange(300) / 300 * 2 * np.pi
    away, about = np.meshgrid(*steps)
    level = np.sin(away)
    ray = np.stack([level * np.cos(about), level * np.sin(about), np.cos(away)], axis=-1)
    turned = np.linspace(0, np.pi, 19)
    normals = np.column_stack([np.sin(turned), np.zeros(19), np.cos(turned)])
    area = np.sin(away) * radius / 300 * 2 * np.pi / 300 / (np.pi * np.sin(radius) ** 2)
    true = (np.maximum(ray @ normals.T, 0) * area[..., None]).sum(axis=(0, 1))
    panels = [Panel(f"p{i}", normal, 1.0) for i, normal in enumerate(normals)]
    faces = Vehicle("faces", panels=panels)
    modelled, _ = faces.response_in().earthlight(np.array([0.0, 0.0, 1.0]), np.array(1.0))
    reached("light of the Earth on a panel", np.abs(modelled - true), "of the most", limit=0.06)
    assert np.abs(modelled - true).max() < 0.06
