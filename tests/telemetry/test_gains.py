"""Gains of the panels from samples in full Sun. The readings are synthetic."""

from dataclasses import replace

import numpy as np

import sunspin as ss
from sunspin.telemetry.gains import estimate_gains, with_gains
from sunspin.vehicle import Fact, Panel, Vehicle

NORMALS = np.vstack([np.eye(3), -np.eye(3)])
CUBE = Vehicle("cube", gain_unit="W", panels=[Panel(f"p{k}", NORMALS[k], 2.0) for k in range(6)])
ALIVE = np.zeros(6, dtype=bool)


def readings(craft, n, rng, noise=0.01):
    sun = rng.normal(size=(n, 3))
    sun /= np.linalg.norm(sun, axis=1, keepdims=True)
    return np.maximum(
        ss.panel_power(craft, sun) + noise * rng.normal(size=(n, len(craft.panels))), 0
    )


def test_gains_are_found_and_cover_the_truth_although_a_tenth_of_the_samples_is_spoiled():
    rng = np.random.default_rng(1)
    square = []
    for _ in range(10):
        truth = np.exp(0.08 * rng.normal(size=6))
        value = readings(with_gains(CUBE, truth), 150, rng)
        value[rng.uniform(size=150) < 0.1] *= 0.9
        found = estimate_gains(CUBE, value, 1.0, ALIVE)
        square.append(((found.factor - truth) / found.sigma) ** 2)
        assert np.abs(found.factor - truth).max() < 0.03
    assert 0.2 < np.mean(square) < 2.0


def test_sigmas_go_with_the_gains_they_are_of():
    """The same readings against gains of +x stated right and at half: it is found twice as large, as is its sigma."""
    wide = replace(CUBE, facts={f"panel.p{k}.gain_W": Fact(2.0, 2.0, "assumed") for k in range(6)})
    value = readings(CUBE, 150, np.random.default_rng(4))
    half = estimate_gains(with_gains(wide, np.array([0.5, 1, 1, 1, 1, 1])), value, 1.0, ALIVE)
    right = estimate_gains(wide, value, 1.0, ALIVE)
    np.testing.assert_allclose(half.factor / right.factor, [2, 1, 1, 1, 1, 1], rtol=0.01)
    np.testing.assert_allclose(half.sigma / right.sigma, [2, 1, 1, 1, 1, 1], rtol=0.1)


def test_what_cannot_be_told_is_said_and_left_alone():
    rng = np.random.default_rng(2)
    sides = Vehicle("sides", gain_unit="W", panels=CUBE.panels[:2] + CUBE.panels[3:5])
    for craft, n, word in ((sides, 60, "do not look all around"), (CUBE, 8, "fewer than")):
        found = estimate_gains(
            craft, readings(craft, n, rng), 1.0, np.zeros(len(craft.panels), dtype=bool)
        )
        assert word in found.told and found.spread is None
        np.testing.assert_array_equal(found.factor, 1.0)
