"""Earth's light in a few samples only: it is in the errors of these samples, and in no others."""

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.telemetry.assess import assess
from sunspin.telemetry.quality import PASSING_NEAR
from sunspin.vehicle import Panel, TelemetryForm, Vehicle

NOISE = 0.005
NORMALS = np.vstack([np.eye(3), -np.eye(3)])
BOX = Vehicle(
    "box",
    gain_unit="W",
    panels=[Panel(f"p{k}", n, 1.0) for k, n in enumerate(NORMALS)],
    telemetry=TelemetryForm(noise=NOISE),
)
T = 20.0 * np.arange(60)
"""Times of samples, s."""


def sigmas(light: np.ndarray) -> np.ndarray:
    """Return sigma of each reading (n, 6) of a rotating box; `light` (n): what the Earth adds to the panel opposite to the Sun."""
    sun = Rotation.from_rotvec(0.03 * T[:, None] * [0.6, 0.3, 0.74]).apply([0.3, -0.7, 0.65])
    power = ss.panel_power(BOX, sun)
    power += NOISE * np.random.default_rng(4).normal(size=power.shape)
    power[np.arange(len(T)), (power.argmax(axis=1) + 3) % 6] += light
    variables = {"power_W": (("time", "panel"), np.maximum(power, 0.0))}
    coords = {"time": T, "panel": list(BOX.panel_names)}
    attrs = {"unused_columns": "", "missing_sensors": "", "epoch_utc": "2026-01-01T00:00:00Z"}
    variables |= {"flag": ("time", np.zeros(len(T), np.uint8))}
    quality = assess(BOX, xr.Dataset(variables, coords, attrs)).quality
    return np.asarray(quality["sigma_beside_gains"].values)


@pytest.mark.parametrize("size", [0.08, 0.2])
def test_light_at_the_end_of_a_pass_is_in_the_errors_of_its_samples_alone(size: float) -> None:
    light = np.where(T >= T[-5], size, 0.0)
    without, with_light = sigmas(0.0 * T), sigmas(light)
    near = T >= T[-5 - PASSING_NEAR]
    assert (with_light[light > 0] > 0.9 * size).all()
    # the other samples keep the errors that they have without the light
    np.testing.assert_allclose(with_light[~near], without[~near], rtol=0.3)
    assert without.max() < 0.05


def test_a_reading_too_large_for_the_light_of_the_earth_leaves_the_errors_alone() -> None:
    """Exchanged columns look like that: they must not fit because errors were widened."""
    light = np.where(T >= T[-5], 0.5, 0.0)
    np.testing.assert_allclose(sigmas(light), sigmas(0.0 * T), atol=0.02)
