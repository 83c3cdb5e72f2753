"""Twins whose gyro, magnetometer or quaternion lag behind the panels. All of it is synthetic."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

import sunspin as ss
from coverage_twins import CUBE
from sunspin.vehicle import Vehicle
from sunspin.vehicle.sensors import Attitude, Clock, Gyro, Magnetometer, Sensors

GYRO = Gyro(("x", "y", "z"), 1.0, np.zeros(3), 5e-4, zero_sigma=np.full(3, 1e-3), scale_sigma=0.01)
FIELD = Magnetometer(("x", "y", "z"), np.zeros(3), 0.02)
QUATERNION = Attitude(("a", "b", "c", "d"), "last", "N_to_B", 0.01)


def craft(kind: str, clock: Clock | None) -> Vehicle:
    sensors = {
        "gyro": Sensors(gyro=GYRO),
        "field": Sensors(magnetometer=FIELD),
        "attitude": Sensors(attitude=QUATERNION),
    }[kind]
    return replace(CUBE, sensors=replace(sensors, clock=clock))


def twin(
    kind: str, late_s: float, rng: np.random.Generator, samples: int = 40
) -> tuple[xr.Dataset, xr.Dataset]:
    """Telemetry and truth of a cube at about 3 deg/s, seen 10 s apart, whose other sensor is `late_s` behind."""
    t = 60 + np.concatenate([[0.0], np.cumsum(10.0 * rng.uniform(0.8, 1.2, samples - 1))])
    sun = rng.normal(size=3)
    both = np.unique(np.concatenate([[0.0], t, t - late_s]))
    run = ss.propagate(CUBE, 0.03 * rng.normal(size=3), sun / np.linalg.norm(sun), None, both)
    now, then = run.sel(time=t), run.sel(time=t - late_s, method="nearest")
    power = np.maximum(
        ss.panel_power(CUBE, now["sun_B"].values) + 0.01 * rng.normal(size=(samples, 6)), 0.0
    )
    turned = Rotation.from_quat(then["B_from_N"].values)
    scale, zero = 1 + 0.01 * rng.normal(), 1e-3 * rng.normal(size=3)
    made = {
        "gyro": (
            "gyro_B",
            then["omega_B"].values * scale + zero + 5e-4 * rng.normal(size=(samples, 3)),
        ),
        "field": ("field_B", turned.apply([0.6, 0.0, 0.8]) + 0.02 * rng.normal(size=(samples, 3))),
        "attitude": (
            "attitude_B_from_N",
            (Rotation.from_rotvec(0.01 * rng.normal(size=(samples, 3))) * turned).as_quat(),
        ),
    }
    name, value = made[kind]
    variables = {
        "power_W": (("time", "panel"), power),
        "flag": ("time", np.zeros(samples, dtype=np.uint8)),
        name: (("time", "quaternion" if kind == "attitude" else "axis"), value),
    }
    attrs = {"epoch_utc": "2026-01-01T00:00:00Z", "synthetic": 1}
    return xr.Dataset(variables, {"time": t, "panel": list(CUBE.panel_names)}, attrs), now
