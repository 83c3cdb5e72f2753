"""Field strength and the angle between field and Sun: calibration of a magnetometer. All telemetry is synthetic."""

from __future__ import annotations

import numpy as np
import pytest

from sunspin.environment.elements import parse_elements
from sunspin.environment.orbit import in_orbit
from sunspin.estimate.orbit.along_track import AlongTrack
from sunspin.estimate.orbit.invariants import Model, Predicted, Seen, State, calibrated
from tests.support.orbit_cases import check_case

SCALE_T, NOISE = 6e-8, 12.0


def aligned(rng: np.random.Generator, n: int = 200) -> tuple[Seen, Predicted]:
    """A satellite that its dipole holds along the field, so that readings vary little, about a zero that the file does not know."""
    strength = rng.uniform(2.2e-5, 4.5e-5, n)
    unit = [-0.4, -0.9, 0.0] + 0.15 * rng.normal(size=(n, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    field = strength[:, None] * unit
    sun = rng.normal(size=(n, 3))
    sun /= np.linalg.norm(sun, axis=1, keepdims=True)
    reading = field / SCALE_T - field.mean(axis=0) / SCALE_T + NOISE * rng.normal(size=(n, 3))
    seen = sun + 0.1 * rng.normal(size=(n, 3))
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    there = Predicted(strength[None], (field * sun).sum(axis=1)[None], np.ones((1, n)))
    return Seen(
        np.arange(n) * 30.0, reading, seen, np.tile(0.01 * np.eye(3), (n, 1, 1)), np.ones(n)
    ), there


@pytest.mark.parametrize("of_readings", [False, True])
def test_the_gradient_of_field_strength_and_angle_is_that_of_the_residuals(of_readings):
    seen, there = aligned(np.random.default_rng(1), 20)
    model = Model(seen.field / 200, seen.sun, seen.covariance, of_readings)
    unknown = 0.2 * np.random.default_rng(2).normal(size=(1, 12))
    state = State(
        unknown, there.strength / 3e-5, there.to_sun / 3e-5, np.array([[0.1, 0.7]]), np.ones(1)
    )
    _, _, *slopes = model.residuals(state)
    for k, one in enumerate(1e-6 * np.eye(12)):
        sides = [model.residuals(state._replace(unknown=unknown + sign * one)) for sign in (1, -1)]
        for which, slope in enumerate(slopes):
            expected = (sides[0][which] - sides[1][which]) / 2e-6
            np.testing.assert_allclose(
                slope[..., k], expected, rtol=1e-5, atol=1e-5 * np.abs(slope).max()
            )


def test_noise_of_the_magnetometer_does_not_shrink_its_matrix():
    """Fitted to the strength alone the scale is 0.5 to 0.7 of the true one here."""
    scales = []
    for seed in range(6):
        seen, there = aligned(np.random.default_rng(seed))
        matrix = calibrated(seen, there).values[0, :9].reshape(3, 3)
        scales.append(np.cbrt(abs(np.linalg.det(matrix))) / SCALE_T)
    assert 0.85 < np.median(scales) < 1.15


def test_the_field_interpolated_between_offsets_is_that_of_the_orbit():
    _, data, given, _ = check_case(1, 1)
    orbit = in_orbit(
        parse_elements("\n".join(given), "twin"),
        data.attrs["epoch_utc"],
        data["time"].values,
        shift_sigma_s=9.0,
    )
    t = data["time"].values[:40]
    table = AlongTrack.of(orbit, t, np.arange(-60.0, 61.0, 20.0))
    field, slope = table.at(33.0)
    moved = AlongTrack.of(orbit, t, np.array([32.0, 33.0, 34.0]))
    assert (
        np.abs(field - moved.field[1]).max() < 1e-8
        and np.abs(slope - (moved.field[2] - moved.field[0]) / 2).max() < 1e-9
    )
    drifting, _ = table.at(0.0, 10.0)
    assert np.abs(drifting - table.at(0.0)[0]).max() > 1e-10 and np.isfinite(table.at(1e5)[0]).all()
