"""Rates of satellites in orbit: the Earth's light, a magnetic torque, a field that turns. All telemetry is synthetic, made by the
equations of the tests' own and not by the package's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from sunspin.estimate.rates.motion import Body
from sunspin.estimate.rates.observe import observations, passes
from sunspin.estimate.rates.smooth import between
from sunspin.estimate.rates.state import Motion, Observations, Track
from sunspin.estimate.terms.term import normal
from sunspin.solve.rotations import rotate_attitude
from sunspin.vehicle import Panel, Vehicle
from tests.support.simulate import (
    CUBE,
    albedo,
    cube_with_faults,
    cube_with_late_sensor,
    cube_with_sensor,
)

EARTH_RADIUS = np.arcsin(6371 / (6371 + 550))
"""rad; that of the Earth's disk from 550 km."""


def panels_of(normals, gain=1.0):
    return Vehicle(
        "faces", panels=[Panel(f"p{i}", normal, gain) for i, normal in enumerate(normals)]
    ).response_in()


def pass_of(vehicle, data) -> Observations:
    o, why, _ = observations(vehicle, data)
    return o.take(passes(o, why)[0])


def lit_cube() -> tuple[Observations, Track]:
    """A pass under the Earth's light, and a hypothesis about it."""
    rng = np.random.default_rng(5)
    data, run = cube_with_faults((albedo,), rng)
    o = pass_of(CUBE, data)
    o = o.take(slice(1, None))  # at the first, two panels just see the Sun: there is no gradient
    attitude = Rotation.from_quat(run["B_from_N"].sel(time=o.t_s).values).as_matrix()
    return o, Track(attitude[None], run["omega_B"].sel(time=o.t_s).values[None])


def test_the_albedo_model_is_that_of_a_wide_disk(reached):
    """Integrated over an evenly bright disk of 66 degrees' radius, for panels turned away from its middle by up to 180 degrees."""
    away, about = (
        np.stack(x)
        for x in np.meshgrid(
            (np.arange(300) + 0.5) / 300 * EARTH_RADIUS, np.arange(300) / 300 * 2 * np.pi
        )
    )
    ray = np.stack(
        [np.sin(away) * np.cos(about), np.sin(away) * np.sin(about), np.cos(away)], axis=-1
    )
    turned = np.linspace(0, np.pi, 19)
    normals = np.column_stack([np.sin(turned), np.zeros(19), np.cos(turned)])
    area = np.sin(away) * EARTH_RADIUS / 300 * 2 * np.pi / 300 / (np.pi * np.sin(EARTH_RADIUS) ** 2)
    true = (np.maximum(ray @ normals.T, 0) * area[..., None]).sum(axis=(0, 1))
    told, _ = panels_of(normals).earthlight(np.array([0.0, 0.0, 1.0]), np.array(1.0))
    reached("light of the Earth on a panel", np.abs(told - true), "of the most", limit=0.06)
    assert np.abs(told - true).max() < 0.06


def test_the_gradient_by_attitude_gains_albedo_and_zeros_is_that_of_the_cost():
    """By differences of 1e-5 of a sigma, or rad."""
    o, track = lit_cube()
    panels = replace(o.of_sun[0], earth_share=0.1).freed(o.t_s)
    error = 0.3 * np.random.default_rng(3).normal(size=(1, 6 + 6 + 6))
    slope = normal(panels, track, error)[1].sum(axis=1)[0]
    assert [one.kind for one in panels.unknowns()] == 6 * ["gain"] + 6 * ["earth_light"] + 6 * [
        "panel_zero"
    ]
    small = [sign * 1e-5 * one for one in np.eye(len(slope)) for sign in (1, -1)]
    changed = [
        (replace(track, attitude=rotate_attitude(track.attitude, one[:3])), error + one[3:])
        for one in small
    ]
    cost = np.array([normal(panels, seen, off)[2].sum() for seen, off in changed])
    assert len(slope) == 3 + 6 + 6 + 6
    np.testing.assert_allclose(slope, (cost[::2] - cost[1::2]) / 2e-5, rtol=1e-4, atol=1e-4)


def test_without_albedo_no_albedo_is_estimated_and_powers_stay_unchanged():
    data, _ = cube_with_faults((), np.random.default_rng(1))
    o = pass_of(CUBE, data)
    panels = o.of_sun[0]
    assert panels.earth_share < 0.03 and panels.freed(o.t_s).earth is None
    np.testing.assert_array_equal(panels.power, panels.whole[0])


def test_derivatives_of_the_field_by_attitude_agree_with_differences():
    """Residuals between neighbours of a fixed field vanish at the truth; beside it they change as their Jacobians say."""
    rng = np.random.default_rng(6)
    data, run = cube_with_late_sensor("field", 0.0, rng, samples=9)
    o = observations(cube_with_sensor("field", None), data)[0]
    attitude = Rotation.from_quat(run["B_from_N"].values).as_matrix()
    (term,) = o.of_pairs
    o = o.swapped(term, replace(term, field_B=attitude @ [0.6, 0.0, 0.8]))
    motion = Motion(Body.of(CUBE), 1e-5, 0.1)
    here = Track(attitude[None], run["omega_B"].values[None])
    value, first, second = between(o, here, motion)
    assert np.abs(value[..., 6:]).max() < 1e-9
    small = 1e-6 * rng.normal(size=(1, len(o), 3))
    beside = replace(here, attitude=rotate_attitude(attitude[None], small))
    parts = (first, small[:, :-1]), (second, small[:, 1:])
    told = sum(np.einsum("knij,knj->kni", answer[..., 6:, :3], turned) for answer, turned in parts)
    assert np.abs(told).max() > 1e-5
    np.testing.assert_allclose(between(o, beside, motion)[0][..., 6:], told, rtol=0, atol=1e-9)
