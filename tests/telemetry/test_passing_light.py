"""Earth's light in a few samples only: it is in the errors of these samples, and in no others."""

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.telemetry.assess import assess
from sunspin.telemetry.gains import FAINT
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


def judged(light: np.ndarray, t: np.ndarray = T) -> xr.Dataset:
    """Return the quality of readings at times t (n) of a rotating box; `light` (n): on the panel opposite to the Sun."""
    sun = Rotation.from_rotvec(0.03 * t[:, None] * [0.6, 0.3, 0.74]).apply([0.3, -0.7, 0.65])
    power = ss.panel_power(BOX, sun)
    power += NOISE * np.random.default_rng(4).normal(size=power.shape)
    power[np.arange(len(t)), (power.argmax(axis=1) + 3) % 6] += light
    variables = {"power_W": (("time", "panel"), np.maximum(power, 0.0))}
    coords = {"time": t, "panel": list(BOX.panel_names)}
    attrs = {"unused_columns": "", "missing_sensors": "", "epoch_utc": "2026-01-01T00:00:00Z"}
    variables |= {"flag": ("time", np.zeros(len(t), np.uint8))}
    return assess(BOX, xr.Dataset(variables, coords, attrs)).quality


def sigmas(light: np.ndarray, t: np.ndarray = T) -> np.ndarray:
    """Return sigma of each reading (n, 6), where the errors of gains are modelled."""
    return np.asarray(judged(light, t)["sigma_beside_gains"].values)


@pytest.mark.parametrize("size", [0.08, 0.2, 0.5])
def test_light_at_the_end_of_a_pass_is_in_the_errors_of_its_samples_alone(size: float) -> None:
    """Half of full Sun is too much for the Earth: exchanged columns look like that, and must not fit because of wider errors."""
    light = np.where(T >= T[-5], size, 0.0)
    without, with_light = sigmas(0.0 * T), sigmas(light)
    if size > 0.3:
        np.testing.assert_allclose(with_light, without, atol=0.02)
        return
    near = T >= T[-5 - PASSING_NEAR]
    assert (with_light[light > 0] > 0.9 * size).all()
    # the other samples keep the errors that they have without the light
    np.testing.assert_allclose(with_light[~near], without[~near], rtol=0.3)
    assert without.max() < 0.05


@pytest.mark.parametrize("gap_s", [20.0, 5600.0])
def test_light_at_the_end_of_a_pass_is_not_in_the_errors_of_the_next_pass(gap_s: float) -> None:
    """But a lost packet does not end it."""
    t = np.where(T < 800.0, T, T + gap_s)
    light = np.where((T >= 700.0) & (T < 800.0), 0.15, 0.0)
    after = np.flatnonzero(T >= 800.0)[:PASSING_NEAR]
    assert np.all(sigmas(light, t)[after].max(axis=1) > 0.1) == (gap_s < 100.0)


def test_a_modelled_light_leaves_no_error_of_lit_panels_on_unlit_ones() -> None:
    quality = judged(np.where(T >= T[-5], 0.15, 0.0))
    assert quality.attrs["earth_light"] <= FAINT  # else it is not added
    modelled = quality["sigma_beside_earth"].values
    np.testing.assert_allclose(modelled.min(axis=1), modelled.min(), rtol=0.02)
