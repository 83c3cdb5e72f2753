"""Gyro axes on a body whose strong wheel rotates the rate between samples. All telemetry is synthetic."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

import sunspin as ss
from sunspin.estimate.gyro_axes import wrong_gyro_axes
from sunspin.telemetry.assess import assess
from sunspin.vehicle import Panel, TelemetryForm, Vehicle, Wheel
from sunspin.vehicle.sensors import Sensors
from tests.support.simulate import GYRO, telemetry_of
from tests.support.vehicles import unit_vector, units

AXIS = units(np.array([0.2, 0.9, 0.4]))


def odd(i: int, speed_rad_s: float) -> tuple[Vehicle, xr.Dataset]:
    """Twelve panels somehow, a wheel that turns a rate round by 12 rad in an interval of 12 s at 300 rad/s, a gyro."""
    rng = np.random.default_rng(i)
    normals = units(rng.normal(size=(12, 3)))
    panels = [Panel(f"p{k}", n, rng.uniform(0.5, 1.5)) for k, n in enumerate(normals)]
    inertia = np.array([[0.9, 0.05, 0.02], [0.05, 1.2, -0.03], [0.02, -0.03, 1.5]])
    gyro = replace(GYRO, noise_rad_s=1e-3)
    craft = Vehicle(
        "odd",
        inertia_kg_m2=inertia,
        gain_unit="W",
        panels=panels,
        telemetry=TelemetryForm(noise=0.02),
        wheels=(Wheel("w", AXIS, 0.004, speed_rad_s),),
        sensors=Sensors(gyro=gyro),
    )
    t, omega, sun = np.arange(40) * 12.0, unit_vector(rng), unit_vector(rng)
    run = ss.propagate(craft, np.radians(3.0) * omega, sun, [speed_rad_s], t)
    power = ss.panel_power(craft, run["sun_B"].values) + 0.02 * rng.normal(size=(40, 12))
    rate = run["omega_B"].values
    read = rate * (1 + 0.01 * rng.normal()) + 1e-3 * rng.normal(size=3)
    read = read + 1e-3 * rng.normal(size=rate.shape)
    data = telemetry_of(craft, t, np.maximum(power, 0.0), gyro_B=(("time", "axis"), read))
    return craft, data


@pytest.mark.parametrize(("count", "named"), [(1, 2), pytest.param(6, 12, marks=pytest.mark.slow)])
@pytest.mark.evidence(
    "rates",
    "modelled",
    "a gyro with one axis reversed on a body whose wheel rotates the rate between samples",
)
def test_a_reversed_gyro_axis_is_named_even_if_a_wheel_rotates_the_rate_between_samples(
    count, named
):
    """Three axes of each satellite reversed; the right reading is never accused, and no other is named."""
    told = []
    for i in range(count):
        vehicle, telemetry = odd(i, 300.0 if i % 2 else 100.0)
        assert wrong_gyro_axes(assess(vehicle, telemetry)) is None
        for k in range(3):
            read = telemetry["gyro_B"].values * (1 - 2 * np.eye(3)[k])
            signs = ", ".join(f"{'-' if j == k else '+'}{axis}" for j, axis in enumerate("xyz"))
            misread = telemetry.assign(gyro_B=(("time", "axis"), read))
            found = wrong_gyro_axes(assess(vehicle, misread))
            told.append(None if found is None else f"({signs})" in found)
    assert False not in told and told.count(True) >= named
