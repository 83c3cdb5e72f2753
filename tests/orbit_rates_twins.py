"""Twins for `rates` with an orbit: CubeSats with a dipole in the Earth's field, gravity gradient, clouds, and real elements.

Orbits, field and Sun are those of `tests/tle_twins.py` (SGP4, IGRF, the Almanac), bodies, torques and the patchy light of the
Earth those of `tests/orbit_twins.py`: nothing of the package's environment or dynamics makes them. A file has several passes,
also in the shadow; those judged are drawn. All of it is synthetic.
"""

from __future__ import annotations

from datetime import timedelta
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from sgp4.api import Satrec, jday

import sunspin as ss
from orbit_twins import Ground, drawn_body, motion
from strange_twins import FACES, unit
from sunspin.base.errors import SunspinError
from sunspin.environment.elements import parse_elements
from sunspin.environment.orbit import Orbit, in_orbit
from sunspin.estimate.orbit.field_calibration import field_calibration
from sunspin.estimate.orbit.judged import judged_orbit
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from sunspin.vehicle.parts import Fact
from sunspin.vehicle.sensors import Magnetometer, Sensors
from tle_twins import EARTH_KM, EPOCH, field_nT, lines, sun_of_date, turned
from validation.truths import is_listed, is_wrong

STEP_S, LONGEST_S = 10.0, 700.0
SPARSE = {"patches": 2000, "every_s": (20.0, 60.0), "power": (0.4, 1.2)}
"""Passes of fast bodies whose samples are so far apart that whole turns hide between them."""

JUDGED = 2
"""Passes of a file that are judged, at most: those that see the Sun in eight samples or more."""

FIELD = Sensors(magnetometer=Magnetometer(("x", "y", "z"), np.zeros(3), 600.0))


class Way(NamedTuple):
    """A pass along an orbit: place (km) and field (T) at times from its begin, and the Sun."""

    place: CubicSpline
    field: CubicSpline
    sun: np.ndarray
    radius_km: float
    rate_rad_s: float

    @classmethod
    def of(cls, given: tuple[str, str], begin_s: float, ahead_s: float, span_s: float) -> Way:
        t = np.arange(-STEP_S, span_s + 2 * STEP_S, STEP_S)
        day, fraction = jday(EPOCH.year, EPOCH.month, EPOCH.day, EPOCH.hour, 0, 0)
        _, place, speed = Satrec.twoline2rv(*given).sgp4_array(
            np.full(len(t), day), fraction + (begin_s + t + ahead_s) / 86400
        )
        days = day - 2451545.0 + fraction + (begin_s + t) / 86400
        sidereal = np.radians((280.46061837 + 360.98564736629 * days) % 360)
        field = 1e-9 * field_nT(place, sidereal, EPOCH + timedelta(seconds=begin_s))
        radius = float(np.linalg.norm(place, axis=1).mean())
        rate = float(np.linalg.norm(np.cross(place, speed), axis=1).mean() / radius**2)
        return cls(
            CubicSpline(t, place), CubicSpline(t, field), sun_of_date(days[:1])[0], radius, rate
        )


class Moving(NamedTuple):
    """The same for `orbit_twins.Body.change`, which asks for the field at the place that it was just given."""

    way: Way
    now: list[float]

    @property
    def radius_km(self) -> float:
        return self.way.radius_km

    @property
    def rate_rad_s(self) -> float:
        return self.way.rate_rad_s

    def place_km(self, t: float) -> np.ndarray:
        self.now[0] = t
        return self.way.place(t)

    def field_T(self, place: np.ndarray) -> np.ndarray:
        return self.way.field(self.now[0])


def sunlit(place: np.ndarray, sun: np.ndarray) -> bool:
    along = place @ sun
    return bool(along > 0 or np.linalg.norm(place - along * sun) > EARTH_KM)


def make(
    seed: int,
    i: int,
    patches: int = 20_000,
    every_s: tuple[float, float] = (15, 40),
    power: tuple[float, float] = (-0.5, 0.6),
) -> tuple[Vehicle, xr.Dataset, tuple[str, str], xr.Dataset, dict[str, Any]]:
    """Vehicle, telemetry, the two lines, the true motion, and how far the orbit is known; a sample `every_s`, rates of 10 to this
    `power` deg/s."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,)))
    given, sigma = lines(rng), float(10 ** rng.uniform(0.3, 1.3))
    ahead, interval, passes = (
        sigma * rng.normal(),
        float(rng.uniform(*every_s)),
        int(rng.integers(4, 8)),
    )
    ground, body = Ground.drawn(rng, patches), drawn_body(rng)
    body, speed = body._replace(coil=0.0), np.radians(10 ** rng.uniform(*power))
    starts = np.sort(rng.choice(12, passes, replace=False)) * 5600.0 + rng.uniform(0, 2500, passes)
    starts -= starts[0]
    matrix, zero = np.eye(3) + 0.03 * rng.normal(size=(3, 3)), 4000 * rng.normal(size=3)
    spread, parts = np.exp(0.04 * rng.normal(size=6)), []
    for start in starts:
        t = np.arange(0, rng.uniform(350, LONGEST_S - 50), interval)
        way = Way.of(given, start, ahead, t[-1])
        moving: Any = Moving(way, [0.0])
        quaternion, rate = motion(body, moving, speed * unit(rng), t, rng)
        body_from_N, place, field = Rotation.from_quat(quaternion), way.place(t), way.field(t)
        power = np.zeros((len(t), 6))
        for k, at in enumerate(place):
            normals = body_from_N[k].inv().apply(FACES)
            power[k] = np.maximum(normals @ way.sun, 0) * sunlit(at, way.sun) + ground.light(
                at, way.sun, normals
            )
        power = np.maximum(power * spread + 0.01 * rng.normal(size=power.shape), 0.0)
        reading = (
            1e9 * body_from_N.apply(field) @ matrix.T + zero + 600 * rng.normal(size=field.shape)
        )
        lit = [sunlit(at, way.sun) for at in place]
        parts.append(
            (
                start + t,
                power,
                reading,
                quaternion,
                rate,
                np.tile(way.sun, (len(t), 1)),
                np.array(lit),
            )
        )
    time_s, power, reading, quaternion, rate, sun, lit = (
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
        panels=tuple(Panel(f"p{j}", face, 1.0) for j, face in enumerate(FACES)),
        telemetry=TelemetryForm(noise=0.01),
        sensors=FIELD,
    )
    variables = {
        "power_W": (("time", "panel"), power),
        "flag": ("time", np.zeros(len(time_s), dtype=np.uint8)),
        "field_B": (("time", "axis"), reading),
    }
    attrs = {"epoch_utc": EPOCH.isoformat() + "Z", "synthetic": 1}
    data = xr.Dataset(variables, {"time": time_s, "panel": list(vehicle.panel_names)}, attrs)
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
    return vehicle, data, given, truth, about


def orbit_of(
    given: tuple[str, str], data: xr.Dataset, about: dict[str, Any], by_deg: float = 0.0
) -> Orbit:
    elements = parse_elements("\n".join((given[0], turned(given[1], by_deg))), "twin")
    return in_orbit(
        elements, data.attrs["epoch_utc"], data["time"].values, shift_sigma_s=about["sigma_s"]
    )


def one_pass(data: xr.Dataset, begin_s: float) -> xr.Dataset:
    """The samples of the pass that begins then."""
    t = data["time"].values - begin_s
    return data.isel(time=(t > -1) & (t < LONGEST_S))


def judged(result: xr.Dataset, truth: xr.Dataset, k: int) -> dict[str, Any]:
    """Rate at the middle, and in an orbit the attitude, against the truth of pass `k`."""
    t = result["time"].values[result["pass_of"].values == k]
    true = truth.sel(time=t)
    at = int(np.argmin(np.abs(t - (t[0] + t[-1]) / 2)))
    omegas, sigmas = (
        np.stack([result[f"{name}_{axis}"].values[k] for axis in "xyz"], axis=1)
        for name in ("omega", "sigma")
    )
    omega_true, sigma = true["omega_B"].values[at], sigmas[0]
    miss = omegas[0] - omega_true
    found = {
        "pulls": (miss / sigma).tolist(),
        "miss_deg_s": np.degrees(miss).tolist(),
        "sigma_deg_s": np.degrees(sigma).tolist(),
        "decided": bool(result["decided"].values[k]),
    }
    found["wrong"] = is_wrong(omegas[0], sigma, omega_true)
    found["listed"] = is_listed(omegas, sigmas, result["probability"].values[k], omega_true)
    if result.attrs["frame_N"] == "J2000":
        # the twins' N is the true equator of 2021, 0.3 deg from J2000
        ours, theirs = (
            Rotation.from_quat(each["B_from_N"].values) for each in (result.sel(time=t), true)
        )
        found["attitude_deg"] = float(np.degrees(np.median((ours.inv() * theirs).magnitude())))
    return found


def judge(seed: int, i: int) -> dict[str, Any]:
    """What `rates` says of passes without an orbit and with the right one; and with the magnetometer alone."""
    vehicle, data, given, truth, about = make(seed, i)
    for name, by_deg in (("without", None), ("right", 0.0), ("field alone", 0.0)):
        orbit, check = None, None
        if by_deg is not None:
            orbit, check, _ = judged_orbit(orbit_of(given, data, about, by_deg), vehicle, data)
        if name == "field alone" and orbit is None:
            continue
        calibration = (
            None
            if orbit is None or check is None
            else field_calibration(orbit, vehicle, data, check.made)
        )
        dropped = ["power_W", "panel"] if name == "field alone" else []
        about[name] = {"passes": []}
        for begin in about["begin_s"][: 1 if dropped else None]:
            try:
                result = ss.rates(
                    vehicle,
                    one_pass(data, begin).drop_vars(dropped),
                    environment=orbit,
                    calibration=calibration,
                )
                about[name]["passes"].append(judged(result, truth, 0))
            except SunspinError as error:
                about[name]["passes"].append({"refused": str(error), "listed": False})
    return about
