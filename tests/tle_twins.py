"""Twins for the orbit check: telemetry of a CubeSat in an orbit drawn at random, and its elements, right or with the node turned.

Nothing of the package's environment makes them: SGP4 and IGRF are called as their authors offer them, the Earth is turned by
Greenwich sidereal time, the Sun is the low-precision formula of the Astronomical Almanac, the shadow a cylinder. All of it is
synthetic.
"""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any

import numpy as np
import ppigrf
import xarray as xr
from scipy.spatial.transform import Rotation
from sgp4.api import Satrec, jday

from strange_twins import FACES, unit
from sunspin.environment.elements import parse_elements
from sunspin.environment.orbit import in_orbit
from sunspin.estimate.orbit.check import check_orbit
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from sunspin.vehicle.sensors import Magnetometer, Sensors

EARTH_KM = 6371.0
EPOCH = datetime(2021, 3, 14, 6)
WRONG_DEG = 20.0
"""By how much the node of wrong elements is turned."""


def lines(rng: np.random.Generator) -> tuple[str, str]:
    """Elements of a low orbit at the epoch."""
    inclination, node, perigee, anomaly = rng.uniform([30, 0, 0, 0], [100, 360, 360, 360])
    day = (EPOCH - datetime(2021, 1, 1)).total_seconds() / 86400 + 1
    first = f"1 99999U 21001A   21{day:012.8f}  .00001000  00000-0  50000-4 0  999"
    shape = f"{int(rng.uniform(5e3, 3e4)):07d} {perigee:8.4f} {anomaly:8.4f} {rng.uniform(14.9, 15.5):11.8f}"
    second = f"2 99999 {inclination:8.4f} {node:8.4f} {shape}    1"
    return tuple(
        text + str(sum(int(c) if c.isdigit() else c == "-" for c in text) % 10)
        for text in (first, second)
    )


def turned(second: str, by_deg: float) -> str:
    text = f"{second[:17]}{(float(second[17:25]) + by_deg) % 360:8.4f}{second[25:68]}"
    return text + str(sum(int(c) if c.isdigit() else c == "-" for c in text) % 10)


def sun_of_date(days: np.ndarray) -> np.ndarray:
    """Directions (n, 3) at days (n) from J2000.0: Astronomical Almanac, page C5, to 0.01 degrees."""
    anomaly = np.radians(357.528 + 0.9856003 * days)
    longitude = np.radians(
        280.460 + 0.9856474 * days + 1.915 * np.sin(anomaly) + 0.020 * np.sin(2 * anomaly)
    )
    tilt = np.radians(23.439 - 4e-7 * days)
    return np.column_stack(
        [np.cos(longitude), np.cos(tilt) * np.sin(longitude), np.sin(tilt) * np.sin(longitude)]
    )


def field_nT(place: np.ndarray, sidereal: np.ndarray, when: datetime) -> np.ndarray:
    """The field (n, 3) in the axes of `place` (n, 3) km, in which the Earth has turned by `sidereal` (n) rad."""
    radius = np.linalg.norm(place, axis=1)
    theta, phi = np.arccos(place[:, 2] / radius), np.arctan2(place[:, 1], place[:, 0])
    up, south, east = (
        part[0]
        for part in ppigrf.igrf_gc(radius, np.degrees(theta), np.degrees(phi - sidereal), when)
    )
    level = up * np.sin(theta) + south * np.cos(theta)
    return np.column_stack(
        [
            level * np.cos(phi) - east * np.sin(phi),
            level * np.sin(phi) + east * np.cos(phi),
            up * np.cos(theta) - south * np.sin(theta),
        ]
    )


def sky(
    given: tuple[str, str], begin: float, t: np.ndarray, ahead: float | np.ndarray
) -> tuple[np.ndarray, ...]:
    """Direction to the Sun (n, 3), field (n, 3) in nT, whether the Sun is up (n) and the ground below lit (n), at s from `begin`
    after the epoch, so many s ahead of the elements."""
    day, fraction = jday(EPOCH.year, EPOCH.month, EPOCH.day, EPOCH.hour, 0, 0)
    true = begin + t
    _, place, _ = Satrec.twoline2rv(*given).sgp4_array(
        np.full(len(t), day), fraction + (true + ahead) / 86400
    )
    days = day - 2451545.0 + fraction + true / 86400
    sidereal = np.radians((280.46061837 + 360.98564736629 * days) % 360)
    sun = sun_of_date(days)
    field = field_nT(place, sidereal, EPOCH + timedelta(seconds=begin))
    along = (place * sun).sum(axis=1)
    lit = (along > 0) | (np.linalg.norm(place - along[:, None] * sun, axis=1) > EARTH_KM)
    return sun, field, lit, along > 0


def make(seed: int, i: int) -> tuple[Vehicle, xr.Dataset, tuple[str, str], dict[str, Any]]:
    """Vehicle, telemetry, the two lines, and what was drawn: `ahead_s` of the elements, `days` since their epoch."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,)))
    given, sigma = lines(rng), float(10 ** rng.uniform(0.5, 1.8))
    ahead, begin = sigma * rng.normal(), rng.uniform(0, 5) * 86400
    interval, passes = rng.uniform(20, 60), int(rng.integers(3, 9))
    starts = np.sort(rng.choice(30, passes, replace=False)) * 5600.0 + rng.uniform(0, 2000, passes)
    t = np.concatenate([start + np.arange(0, rng.uniform(300, 650), interval) for start in starts])
    t -= t[0]
    sun, field, lit, day = sky(given, begin, t, ahead)
    spin = np.radians(10 ** rng.uniform(-0.5, 0.7)) * unit(rng)
    body = Rotation.from_rotvec(t[:, None] * spin) * Rotation.random(
        random_state=int(rng.integers(2**31))
    )
    sun_B, field_B = body.apply(sun), body.apply(field)
    power = np.maximum(sun_B @ FACES.T, 0) * lit[:, None] * np.exp(0.03 * rng.normal(size=6))
    power = np.maximum(
        power
        + 0.06 * rng.uniform(size=power.shape) * day[:, None]
        + 0.01 * rng.normal(size=power.shape),
        0,
    )
    matrix = np.eye(3) + 0.03 * rng.normal(size=(3, 3))
    reading = field_B @ matrix.T + 4000 * rng.normal(size=3) + 600 * rng.normal(size=field.shape)
    sensors = Sensors(magnetometer=Magnetometer(("x", "y", "z"), np.zeros(3), 600.0))
    vehicle = Vehicle(
        "in orbit",
        gain_unit="W",
        panels=[Panel(f"p{j}", face, 1.0) for j, face in enumerate(FACES)],
        telemetry=TelemetryForm(noise=0.01),
        sensors=sensors,
    )
    variables = {
        "power_W": (("time", "panel"), power),
        "flag": ("time", np.zeros(len(t), dtype=np.uint8)),
        "field_B": (("time", "axis"), reading),
    }
    attrs = {"epoch_utc": (EPOCH + timedelta(seconds=begin)).isoformat() + "Z", "synthetic": 1}
    data = xr.Dataset(variables, {"time": t, "panel": list(vehicle.panel_names)}, attrs)
    return (
        vehicle,
        data,
        given,
        {
            "ahead_s": ahead,
            "sigma_s": sigma,
            "samples": len(t),
            "passes": passes,
            "lit": float(lit.mean()),
        },
    )


def judge(seed: int, i: int) -> dict[str, Any]:
    """Checks of the elements as they are, of the same with their node turned, and of a clock that is an hour behind; `ahead_s`."""
    vehicle, data, given, about = make(seed, i)
    late = data.assign_attrs(
        epoch_utc=(datetime.fromisoformat(data.attrs["epoch_utc"]) - timedelta(hours=1)).isoformat()
    )
    found: dict[str, Any] = {"ahead_s": about["ahead_s"]}
    for name, by_deg, samples in (
        ("0 deg", 0.0, data),
        ("20 deg", WRONG_DEG, data),
        ("clock", 0.0, late),
    ):
        elements = parse_elements("\n".join((given[0], turned(given[1], by_deg))), "twin")
        orbit = in_orbit(
            elements,
            samples.attrs["epoch_utc"],
            samples["time"].values,
            shift_sigma_s=about["sigma_s"],
        )
        found[name] = check_orbit(orbit, vehicle, samples, seed=i)
    return found
