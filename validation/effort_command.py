"""``python -m validation effort``: simulated files, two of which once took an hour, and the time that `rates` takes."""

from __future__ import annotations

import argparse
import time
from itertools import accumulate

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.vehicle import Panel, TelemetryForm, Vehicle, Wheel
from validation.passes import Made, seen, unit

MOMENTS = (2.1e-4, 2.0e-4, 1.7e-4)
"""kg m2; a PocketQube."""

FACES = {"px": (1, 0, 0), "mx": (-1, 0, 0), "py": (0, 1, 0), "my": (0, -1, 0)}
GAIN_A, NOISE_A, EARTH = 0.08, 0.002, 0.05
"""Current at normal incidence, its noise, and the Earth's light as a part of the former."""

ORBIT_S, LIT_S = 5700.0, 3600.0
DECAY, PUSH = 0.95, 10**-2.6
"""What is left of a rate after a second, and what is added (rad/s): a body that is controlled badly."""

WHEELED, WHEEL_RAD_S = (0.042, 0.05, 0.03), 200.0
"""kg m2, rad/s; a CubeSat."""

LIMIT_S = 240.0
"""Processor time, s: two minutes of two cores."""


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--beacons", type=int, default=875, help="of the PocketQube")
    parser.add_argument("--rows", type=int, default=180, help="of the satellites with nine panels")


def run(options: argparse.Namespace) -> int:
    """Print what was found and what it took; one if any took more than two minutes of two cores."""
    late = False
    for name, (vehicle, telemetry) in {
        "four faces, 60 s apart": pocketqube(options.seed, options.beacons),
        "nine panels, no largest rate": nine_panels(options.seed, options.rows),
        "nine panels and a wheel": nine_panels_and_a_wheel(options.seed, options.rows),
    }.items():
        begin = time.process_time()
        found = ss.rates(vehicle, telemetry)
        took = time.process_time() - begin
        late |= took > LIMIT_S
        cut, passes = found.attrs["cut_passes"], found.sizes["pass_id"]
        print(
            f"{name}: {took:.0f} s of processor, {cut} of {passes} passes cut short; {found.attrs['verdict']}",
            flush=True,
        )
    return int(late)


def pocketqube(seed: int, n: int) -> tuple[Vehicle, xr.Dataset]:
    """`n` beacons of four faces without a stated inertia: 1 deg/s, a third of each orbit dark."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(60 * rng.uniform(0.95, 1.05, n))
    t -= t[0]
    motion = ss.propagate(
        Vehicle("truth", inertia_kg_m2=np.diag(MOMENTS)),
        np.radians(1.0) * unit(rng),
        unit(rng),
        None,
        t,
    )
    panels = tuple(
        Panel(name, np.array(normal, dtype=float), GAIN_A) for name, normal in FACES.items()
    )
    vehicle = Vehicle(
        "pocketqube",
        gain_unit="A",
        panels=panels,
        telemetry=TelemetryForm(quantity="current_A", noise=NOISE_A),
    )
    current = ss.panel_power(vehicle, motion["sun_B"].values)
    current += GAIN_A * EARTH * rng.uniform(size=current.shape)
    current *= (t % ORBIT_S < LIT_S)[:, None]
    current = np.maximum(current + NOISE_A * rng.normal(size=current.shape), 0.0)
    data = {"current_A": (("time", "panel"), current), "flag": ("time", np.zeros(n, np.uint8))}
    return vehicle, xr.Dataset(
        data,
        {"time": t, "panel": list(FACES)},
        {"epoch_utc": "2026-01-01T00:00:00Z", "synthetic": 1},
    )


def nine_panels(seed: int, n: int) -> tuple[Vehicle, xr.Dataset]:
    """`n` rows 30 to 120 s apart of a body that swings within 20 s, under nine panels anyhow; no largest rate is stated."""
    rng = np.random.default_rng(seed)
    normals = np.array([unit(rng) for _ in range(9)])
    t = np.cumsum(np.concatenate([[0.0], rng.uniform(30, 120, n - 1)]))
    pushes = PUSH * rng.normal(size=(int(t[-1]) + 2, 3))
    rate = np.array(list(accumulate(pushes, lambda one, push: DECAY * one + push)))
    turns = Rotation.from_rotvec(-rate).as_matrix()
    attitude = np.array(list(accumulate(turns, lambda one, turn: turn @ one, initial=np.eye(3))))
    at = t.astype(int)
    made: Made = seen(normals, rate[at], attitude[at], at.astype(float), 0.1, rng, False, 1.0)
    return made.vehicle, made.telemetry


def nine_panels_and_a_wheel(seed: int, n: int) -> tuple[Vehicle, xr.Dataset]:
    """`n` rows 30 to 120 s apart of a body that nutates about a strong wheel within 12 s; speeds are measured."""
    rng = np.random.default_rng(seed)
    panels = tuple(Panel(f"p{k}", unit(rng), 1.0) for k in range(9))
    wheel = Wheel("wheel", unit(rng), 1e-4, WHEEL_RAD_S)
    vehicle = Vehicle(
        "wheeled",
        inertia_kg_m2=np.diag(WHEELED),
        gain_unit="W",
        panels=panels,
        wheels=(wheel,),
        telemetry=TelemetryForm(noise=0.02),
    )
    t = np.cumsum(np.concatenate([[0.0], rng.uniform(30, 120, n - 1)]))
    motion = ss.propagate(
        vehicle, np.radians(2.0) * unit(rng), unit(rng), [WHEEL_RAD_S], t, wheel_mode="hold"
    )
    power = ss.panel_power(vehicle, motion["sun_B"].values)
    power = np.maximum(power + 0.02 * rng.normal(size=power.shape), 0.0)
    data = {
        "power_W": (("time", "panel"), power),
        "flag": ("time", np.zeros(n, np.uint8)),
        "wheel_speed_rad_s": (("time", "wheel"), motion["wheel_speed_rad_s"].values),
    }
    attrs = {"epoch_utc": "2026-01-01T00:00:00Z", "synthetic": 1}
    return vehicle, xr.Dataset(data, {"time": t, "panel": list(vehicle.panel_names)}, attrs)
