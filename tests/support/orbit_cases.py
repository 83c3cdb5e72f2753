"""Simulated CubeSats in orbit, with two-line elements: cases for the check of the elements, and for `rates` with an orbit.

Orbit, field, Sun, torques and light are those of `tests/support/orbits.py`, not the package's. All of it is synthetic.
"""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timedelta
from typing import Any

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from sunspin import rates
from sunspin.base.errors import SunspinError
from sunspin.environment.elements import parse_elements
from sunspin.environment.orbit import Orbit, in_orbit
from sunspin.estimate.orbit.calibration import calibrate_magnetometer
from sunspin.estimate.orbit.check import check_orbit
from sunspin.estimate.orbit.judged import judged_orbit
from sunspin.estimate.settings import ORBIT
from sunspin.telemetry.assess import assess
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from sunspin.vehicle.parts import Fact
from sunspin.vehicle.sensors import Magnetometer, Sensors
from tests.support.orbits import (
    EPOCH,
    Arc,
    Ground,
    drawn_body,
    is_sunlit,
    motion,
    sky,
    two_line_elements,
    with_node_turned,
)
from tests.support.simulate import telemetry_of
from tests.support.vehicles import CUBE_NORMALS, unit_vector
from validation.truths import is_listed, is_wrong

WRONG_DEG = 20.0
"""By how much the node of wrong elements is turned."""

LONGEST_S = 700.0
"""No pass of a file for `rates` is longer."""

SPARSE = {"patches": 2000, "every_s": (20.0, 60.0), "power": (0.4, 1.2)}
"""Arguments of `rates_case`: bodies so fast, and samples so far apart, that whole revolutions hide between them."""

JUDGED = 2
"""Passes of a file that are judged, at most: those that see the Sun in eight samples or more."""

FIELD = Sensors(magnetometer=Magnetometer(("x", "y", "z"), np.zeros(3), 600.0))
PANELS = tuple(Panel(f"p{j}", face, 1.0) for j, face in enumerate(CUBE_NORMALS))


def with_few_copies(monkeypatch: Any, copies: int, hours: tuple[int, ...] = ORBIT.hours) -> None:
    """Compare elements with this number of other orbits, and of clock errors (h), in all that follows: it is quicker."""
    settings = replace(ORBIT, copies=copies, hours=hours)
    for function in (check_orbit, judged_orbit):
        monkeypatch.setitem(function.__kwdefaults__, "settings", settings)


def starts_at(data: xr.Dataset, start: datetime) -> xr.Dataset:
    """Return the telemetry with this time as its epoch."""
    return data.assign_attrs(epoch_utc=start.isoformat() + "Z")


def orbit_of(
    elements: tuple[str, str], data: xr.Dataset, about: dict[str, Any], by_deg: float = 0.0
) -> Orbit:
    """Return the orbit of the elements, with their node turned, at the times of the telemetry."""
    text = "\n".join((elements[0], with_node_turned(elements[1], by_deg)))
    return in_orbit(
        parse_elements(text, "twin"),
        data.attrs["epoch_utc"],
        data["time"].values,
        shift_sigma_s=about["sigma_s"],
    )


# ------------------------------------------------------------------------------------------------------------- check of elements


def check_case(seed: int, i: int) -> tuple[Vehicle, xr.Dataset, tuple[str, str], dict[str, Any]]:
    """Draw case `i` of a seed: vehicle, telemetry, the two lines, and what was drawn (`ahead_s` of the elements)."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,)))
    elements, sigma = two_line_elements(rng), float(10 ** rng.uniform(0.5, 1.8))
    ahead, begin = sigma * rng.normal(), rng.uniform(0, 5) * 86400
    interval, passes = rng.uniform(20, 60), int(rng.integers(3, 9))
    starts = np.sort(rng.choice(30, passes, replace=False)) * 5600.0 + rng.uniform(0, 2000, passes)
    t = np.concatenate([start + np.arange(0, rng.uniform(300, 650), interval) for start in starts])
    t -= t[0]
    sun, field, lit, day = sky(elements, begin, t, ahead)
    spin = np.radians(10 ** rng.uniform(-0.5, 0.7)) * unit_vector(rng)
    body = Rotation.from_rotvec(t[:, None] * spin) * Rotation.random(
        random_state=int(rng.integers(2**31))
    )
    sun_B, field_B = body.apply(sun), body.apply(field)
    power = np.maximum(sun_B @ CUBE_NORMALS.T, 0) * lit[:, None] * np.exp(0.03 * rng.normal(size=6))
    power = np.maximum(
        power
        + 0.06 * rng.uniform(size=power.shape) * day[:, None]
        + 0.01 * rng.normal(size=power.shape),
        0,
    )
    matrix = np.eye(3) + 0.03 * rng.normal(size=(3, 3))
    reading = field_B @ matrix.T + 4000 * rng.normal(size=3) + 600 * rng.normal(size=field.shape)
    vehicle = Vehicle(
        "in orbit", gain_unit="W", panels=PANELS, telemetry=TelemetryForm(noise=0.01), sensors=FIELD
    )
    data = telemetry_of(vehicle, t, power, field_B=(("time", "axis"), reading))
    return (
        vehicle,
        starts_at(data, EPOCH + timedelta(seconds=begin)),
        elements,
        {
            "ahead_s": ahead,
            "sigma_s": sigma,
            "samples": len(t),
            "passes": passes,
            "lit": float(lit.mean()),
        },
    )


def judge_check(seed: int, i: int) -> dict[str, Any]:
    """Return the checks of case `i`: right elements, their node turned, a clock an hour behind; and `ahead_s`."""
    vehicle, data, elements, about = check_case(seed, i)
    late = data.assign_attrs(
        epoch_utc=(datetime.fromisoformat(data.attrs["epoch_utc"]) - timedelta(hours=1)).isoformat()
    )
    checks: dict[str, Any] = {"ahead_s": about["ahead_s"]}
    for name, by_deg, samples in (
        ("0 deg", 0.0, data),
        ("20 deg", WRONG_DEG, data),
        ("clock", 0.0, late),
    ):
        orbit = orbit_of(elements, samples, about, by_deg)
        checks[name] = check_orbit(orbit, vehicle, samples, seed=i)
    return checks


# -------------------------------------------------------------------------------------------------------------- rates with orbit


def rates_case(
    seed: int,
    i: int,
    patches: int = 20_000,
    every_s: tuple[float, float] = (15, 40),
    power: tuple[float, float] = (-0.5, 0.6),
) -> tuple[Vehicle, xr.Dataset, tuple[str, str], xr.Dataset, dict[str, Any]]:
    """Draw case `i` of a seed: vehicle, telemetry, the two lines, the true motion, and what was drawn.

    A CubeSat with a residual dipole, in the field and the gravity gradient, under clouds; its vehicle file states neither. Several
    passes, some in shadow; `begin_s` of what was drawn names those to judge. A sample is taken `every_s` seconds (a number drawn
    from this range), the rate is 10 to a `power` drawn from that range, deg/s.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,)))
    elements, sigma = two_line_elements(rng), float(10 ** rng.uniform(0.3, 1.3))
    ahead = sigma * rng.normal()
    interval = float(rng.uniform(*every_s))
    passes = int(rng.integers(4, 8))
    ground, body = Ground.drawn(rng, patches), drawn_body(rng)
    speed = np.radians(10 ** rng.uniform(*power))
    starts = np.sort(rng.choice(12, passes, replace=False)) * 5600.0 + rng.uniform(0, 2500, passes)
    starts -= starts[0]
    matrix, zero = np.eye(3) + 0.03 * rng.normal(size=(3, 3)), 4000 * rng.normal(size=3)
    spread, parts = np.exp(0.04 * rng.normal(size=6)), []
    for start in starts:
        t = np.arange(0, rng.uniform(350, LONGEST_S - 50), interval)
        arc = Arc.of(elements, start, ahead, t[-1])
        quaternion, rate = motion(body, arc, speed * unit_vector(rng), t, rng)
        body_from_N, place, field = Rotation.from_quat(quaternion), arc.place_km(t), arc.field_T(t)
        lit = is_sunlit(place, arc.sun)
        light = np.zeros((len(t), 6))
        for k, at in enumerate(place):
            normals = body_from_N[k].inv().apply(CUBE_NORMALS)
            light[k] = np.maximum(normals @ arc.sun, 0) * lit[k] + ground.light(
                at, arc.sun, normals
            )
        light = np.maximum(light * spread + 0.01 * rng.normal(size=light.shape), 0.0)
        reading = (
            1e9 * body_from_N.apply(field) @ matrix.T + zero + 600 * rng.normal(size=field.shape)
        )
        sun = np.tile(arc.sun, (len(t), 1))
        parts.append((start + t, light, reading, quaternion, rate, sun, lit))
    time_s, light, reading, quaternion, rate, sun, _ = (
        np.concatenate(each) for each in zip(*parts, strict=True)
    )
    inertia = np.diag(np.diag(body.inertia) * (1 + 0.02 * rng.normal(size=3)))
    fact = Fact(
        value=tuple(map(tuple, inertia.tolist())),
        sigma=tuple(map(tuple, (0.03 * np.diag(inertia).mean() * np.ones((3, 3))).tolist())),
    )
    known = bool(rng.random() < 0.7)
    vehicle = Vehicle(
        "in orbit",
        inertia_kg_m2=inertia if known else None,
        facts={"body.inertia_kg_m2": fact} if known else {},
        gain_unit="W",
        panels=PANELS,
        telemetry=TelemetryForm(noise=0.01),
        sensors=FIELD,
    )
    data = telemetry_of(vehicle, time_s, light, field_B=(("time", "axis"), reading))
    truth = xr.Dataset(
        {
            "omega_B": (("time", "axis"), rate),
            "B_from_N": (("time", "quaternion"), quaternion),
            "sun_N": (("time", "axis"), sun),
        },
        {"time": time_s},
    )
    about: dict[str, Any] = {"ahead_s": ahead, "sigma_s": sigma}
    sunny = [start for start, one in zip(starts, parts, strict=True) if one[-1].sum() >= 8]
    about["begin_s"] = [float(x) for x in rng.permutation(sunny)[:JUDGED]]
    return vehicle, starts_at(data, EPOCH), elements, truth, about


def one_pass(data: xr.Dataset, begin_s: float) -> xr.Dataset:
    """Return the samples of the pass that begins at `begin_s`."""
    t = data["time"].values - begin_s
    return data.isel(time=(t > -1) & (t < LONGEST_S))


def sparse_pass(seed: int, i: int, which: int = 0) -> tuple[Vehicle, xr.Dataset, xr.Dataset]:
    """Return vehicle, telemetry of panels alone and truth of a pass in orbit with whole revolutions between its samples."""
    vehicle, data, _, truth, about = rates_case(seed, i, **SPARSE)
    return vehicle, one_pass(data, about["begin_s"][which]).drop_vars("field_B"), truth


def pass_against_truth(result: xr.Dataset, truth: xr.Dataset, k: int) -> dict[str, Any]:
    """Return the errors of pass `k`: of the rate at its middle and, with an orbit, of the attitude."""
    t = result["time"].values[result["pass_of"].values == k]
    true = truth.sel(time=t)
    at = int(np.argmin(np.abs(t - (t[0] + t[-1]) / 2)))
    omegas, sigmas = (
        np.stack([result[f"{name}_{axis}"].values[k] for axis in "xyz"], axis=1)
        for name in ("omega", "sigma")
    )
    omega_true, sigma = true["omega_B"].values[at], sigmas[0]
    miss = omegas[0] - omega_true
    row = {
        "pulls": (miss / sigma).tolist(),
        "miss_deg_s": np.degrees(miss).tolist(),
        "sigma_deg_s": np.degrees(sigma).tolist(),
        "decided": bool(result["decided"].values[k]),
    }
    row["wrong"] = is_wrong(omegas[0], sigma, omega_true)
    row["listed"] = is_listed(omegas, sigmas, result["probability"].values[k], omega_true)
    if result.attrs["frame_N"] == "J2000":
        # N of these cases is the true equator of 2021, 0.3 deg from J2000
        ours, theirs = (
            Rotation.from_quat(each["B_from_N"].values) for each in (result.sel(time=t), true)
        )
        row["attitude_deg"] = float(np.degrees(np.median((ours.inv() * theirs).magnitude())))
    return row


def judge_rates(seed: int, i: int) -> dict[str, Any]:
    """Return the errors of `rates` without an orbit, with the right one, and with the magnetometer alone."""
    vehicle, data, elements, truth, about = rates_case(seed, i)
    for name, by_deg in (("without", None), ("right", 0.0), ("field alone", 0.0)):
        orbit, check = None, None
        if by_deg is not None:
            orbit, check, _ = judged_orbit(orbit_of(elements, data, about, by_deg), vehicle, data)
        if name == "field alone" and orbit is None:
            continue
        calibration = (
            None
            if orbit is None or check is None
            else calibrate_magnetometer(orbit, assess(vehicle, data), check.fitted_sensors)
        )
        dropped = ["power_W", "panel"] if name == "field alone" else []
        about[name] = {"passes": []}
        for begin in about["begin_s"][: 1 if dropped else None]:
            try:
                result = rates(
                    vehicle,
                    one_pass(data, begin).drop_vars(dropped),
                    environment=orbit,
                    calibration=calibration,
                )
                about[name]["passes"].append(pass_against_truth(result, truth, 0))
            except SunspinError as error:
                about[name]["passes"].append({"refused": str(error), "listed": False})
    return about
