"""Gyro axes on a body whose strong wheel rotates the rate between samples. All telemetry is synthetic."""

from typing import NamedTuple

import numpy as np
import pytest
import xarray as xr

import sunspin as ss
from sunspin.estimate.gyro_axes import wrong_gyro_axes
from sunspin.telemetry.assess import assess
from sunspin.vehicle import Panel, TelemetryForm, Vehicle, Wheel
from sunspin.vehicle.sensors import Gyro, Sensors

AXIS = np.array([0.2, 0.9, 0.4]) / np.linalg.norm([0.2, 0.9, 0.4])


class Odd(NamedTuple):
    """An irregular body, its telemetry and the true rates (n, 3)."""

    vehicle: Vehicle
    telemetry: xr.Dataset
    omega: np.ndarray


def odd(i: int, speed_rad_s: float) -> Odd:
    """Twelve panels somehow, a wheel that turns a rate round by 12 rad in an interval of 12 s at 300 rad/s, a gyro."""
    rng = np.random.default_rng(i)
    normals = rng.normal(size=(12, 3))
    panels = tuple(
        Panel(f"p{k}", n / np.linalg.norm(n), rng.uniform(0.5, 1.5)) for k, n in enumerate(normals)
    )
    inertia = np.array([[0.9, 0.05, 0.02], [0.05, 1.2, -0.03], [0.02, -0.03, 1.5]])
    gyro = Gyro(
        ("x", "y", "z"), 1.0, np.zeros(3), 1e-3, zero_sigma=np.full(3, 1e-3), scale_sigma=0.01
    )
    craft = Vehicle(
        "odd",
        inertia_kg_m2=inertia,
        gain_unit="W",
        panels=panels,
        telemetry=TelemetryForm(noise=0.02),
        wheels=(Wheel("w", AXIS, 0.004, speed_rad_s),),
        sensors=Sensors(gyro=gyro),
    )
    t, omega, sun = np.arange(40) * 12.0, rng.normal(size=3), rng.normal(size=3)
    run = ss.propagate(
        craft,
        np.radians(3.0) * omega / np.linalg.norm(omega),
        sun / np.linalg.norm(sun),
        [speed_rad_s],
        t,
    )
    power = np.maximum(
        ss.panel_power(craft, run["sun_B"].values) + 0.02 * rng.normal(size=(40, 12)), 0.0
    )
    rate = run["omega_B"].values
    read = (
        rate * (1 + 0.01 * rng.normal())
        + 1e-3 * rng.normal(size=3)
        + 1e-3 * rng.normal(size=rate.shape)
    )
    data = {
        "power_W": (("time", "panel"), power),
        "gyro_B": (("time", "axis"), read),
        "flag": ("time", np.zeros(40, np.uint8)),
    }
    attrs = {"epoch_utc": "2026-01-01T00:00:00Z", "synthetic": 1}
    return Odd(craft, xr.Dataset(data, {"time": t, "panel": list(craft.panel_names)}, attrs), rate)


@pytest.mark.parametrize(("count", "named"), [(1, 2), pytest.param(6, 12, marks=pytest.mark.long)])
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
        made = odd(i, 300.0 if i % 2 else 100.0)
        assert wrong_gyro_axes(assess(made.vehicle, made.telemetry)) is None
        for k in range(3):
            read = made.telemetry["gyro_B"].values * (1 - 2 * np.eye(3)[k])
            signs = ", ".join(f"{'-' if j == k else '+'}{axis}" for j, axis in enumerate("xyz"))
            misread = made.telemetry.assign(gyro_B=(("time", "axis"), read))
            found = wrong_gyro_axes(assess(made.vehicle, misread))
            told.append(None if found is None else f"({signs})" in found)
    assert False not in told and told.count(True) >= named
