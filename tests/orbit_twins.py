"""Twins for `rates` in orbit about the Earth, moved by equations of their own. All of it is synthetic.

A CubeSat with a residual magnetic dipole tumbles in the Earth's field and in its gravity's gradient, of which the vehicle file says
nothing; the Sun goes down; the Earth reflects light on every face, unevenly, from below, and below turns with the orbit, as does
the field that a magnetometer reads. Nothing of the package's own dynamics or panel model is used to make them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from strange_twins import FACES, unit
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from sunspin.vehicle.parts import Fact
from sunspin.vehicle.sensors import Attitude, Gyro, Magnetometer, Sensors

EARTH_KM, MU_KM3_S2, FIELD_T = 6371.0, 398600.4, 3.0e-5
"""Radius and gravity of the Earth; strength of its dipole field at the equator."""

SENSORS = {
    "none": Sensors(),
    "gyro": Sensors(
        gyro=Gyro(
            ("x", "y", "z"), 1.0, np.zeros(3), 1e-3, zero_sigma=np.full(3, 2e-3), scale_sigma=0.01
        )
    ),
    "field": Sensors(magnetometer=Magnetometer(("x", "y", "z"), np.zeros(3), 500.0)),
    "attitude": Sensors(attitude=Attitude(("a", "b", "c", "d"), "last", "N_to_B", 0.01)),
}


class Orbit(NamedTuple):
    """A circular orbit: radius (km), axes (2, 3) of its plane in N, where it begins (rad); the dipole's axis and the Sun (3)."""

    radius_km: float
    plane: np.ndarray
    phase_rad: float
    dipole: np.ndarray
    sun: np.ndarray

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Orbit:
        """Begun in the Sun, and up to 700 km high."""
        up = unit(rng)
        across = np.cross(up, unit(rng))
        plane = np.array([up, across / np.linalg.norm(across)])
        orbit = cls(EARTH_KM + rng.uniform(400, 700), plane, 0.0, unit(rng), unit(rng))
        while not orbit.sunlit(orbit.place_km(0.0)):
            orbit = orbit._replace(phase_rad=rng.uniform(0, 2 * np.pi))
        return orbit

    @property
    def rate_rad_s(self) -> float:
        return float(np.sqrt(MU_KM3_S2 / self.radius_km**3))

    def place_km(self, t: float) -> np.ndarray:
        angle = self.phase_rad + self.rate_rad_s * t
        return self.radius_km * (np.cos(angle) * self.plane[0] + np.sin(angle) * self.plane[1])

    def field_T(self, place: np.ndarray) -> np.ndarray:
        up = place / np.linalg.norm(place)
        return (
            FIELD_T * (EARTH_KM / self.radius_km) ** 3 * (3 * (self.dipole @ up) * up - self.dipole)
        )

    def sunlit(self, place: np.ndarray) -> bool:
        along = place @ self.sun
        return bool(along > 0 or np.linalg.norm(place - along * self.sun) > EARTH_KM)


class Ground(NamedTuple):
    """Patches of the Earth: directions from its centre (m, 3), each of the same area, and how much light they throw back (m)."""

    up: np.ndarray
    albedo: np.ndarray

    @classmethod
    def drawn(cls, rng: np.random.Generator, patches: int = 20_000) -> Ground:
        """Of albedo 0.3, more or less by half, in clouds of 500 km and seas of 3000 km."""
        z, turn = (
            1 - (2 * np.arange(patches) + 1) / patches,
            np.pi * (3 - np.sqrt(5)) * np.arange(patches),
        )
        up = np.column_stack(
            [np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z]
        )
        waves = np.array([rng.uniform(2, 12) * unit(rng) for _ in range(8)])
        return cls(up, 0.3 * np.exp(0.2 * np.sin(up @ waves.T + rng.uniform(0, 6, 8)).sum(axis=1)))

    def light(self, place: np.ndarray, sun: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """On faces (p, 3) in N, in full Suns: each patch scatters evenly to all sides (Lambert)."""
        seen = self.up @ place > EARTH_KM
        up, albedo = self.up[seen], self.albedo[seen]
        ray = EARTH_KM * up - place
        distance = np.linalg.norm(ray, axis=1)
        ray = ray / distance[:, None]
        area = 4 * np.pi * EARTH_KM**2 / len(self.up)
        sent = (
            albedo
            * np.maximum(up @ sun, 0)
            * np.maximum(-np.einsum("mi,mi->m", up, ray), 0)
            / np.pi
        )
        return np.maximum(normals @ ray.T, 0) @ (sent * area / distance**2)


class Body(NamedTuple):
    """Inertia (3, 3) kg m2 and magnetic dipole (3) A m2, and the gain of a detumbling coil, A m2 s/T (zero: none)."""

    inertia: np.ndarray
    dipole: np.ndarray
    coil: float

    def change(self, orbit: Orbit) -> Callable[[float, np.ndarray], np.ndarray]:
        """Right-hand side for the quaternion B_from_N (scalar last) and the rate in B."""
        inverse = np.linalg.inv(self.inertia)

        def f(t: float, y: np.ndarray) -> np.ndarray:
            turned, w = Rotation.from_quat(y[:4]), y[4:]
            place = orbit.place_km(t)
            up, field = turned.apply(place / orbit.radius_km), turned.apply(orbit.field_T(place))
            moment = self.dipole + self.coil * np.cross(
                w, field
            )  # -k dB/dt, and B seen from the body turns by -w
            torque = np.cross(moment, field) + 3 * orbit.rate_rad_s**2 * np.cross(
                up, self.inertia @ up
            )
            spin = 0.5 * np.append(-y[3] * w - np.cross(w, y[:3]), w @ y[:3])
            return np.concatenate([spin, inverse @ (torque - np.cross(w, self.inertia @ w))])

        return f


def drawn_body(rng: np.random.Generator) -> Body:
    """One to three units of 1.3 kg, their masses in places drawn."""
    units = int(rng.integers(1, 4))
    places = rng.uniform(-0.05, 0.05, (60, 3)) * [1, 1, units]
    places -= places.mean(axis=0)
    inertia = 1.3 * units / 60 * (np.eye(3) * (places**2).sum() - places.T @ places)
    coil = 10 ** rng.uniform(3.3, 4.3) * units if rng.random() < 0.25 else 0.0
    return Body(inertia, units * 10 ** rng.uniform(-3, -1.7) * unit(rng), coil)


def motion(
    body: Body, orbit: Orbit, omega_B: np.ndarray, t: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Quaternions (n, 4) B_from_N and rates (n, 3) at times t (n)."""
    start = np.concatenate(
        [Rotation.random(random_state=int(rng.integers(2**31))).as_quat(), omega_B]
    )
    solved = solve_ivp(
        body.change(orbit), (0.0, t[-1]), start, method="DOP853", t_eval=t, rtol=1e-9, atol=1e-11
    )
    quaternion = solved.y[:4].T
    return quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True), solved.y[4:].T


ORBIT_S = 5700.0


def times(rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """One to three passes of 5 to 10 min, an orbit apart, beacons up to 45 s apart; and how far apart."""
    interval = float(10 ** rng.uniform(0.3, 1.65))
    passes = []
    for k in range(int(rng.integers(1, 4))):
        n = int(rng.uniform(300, 600) / interval)
        passes.append(
            ORBIT_S * k
            + np.concatenate([[0.0], np.cumsum(interval * rng.uniform(0.9, 1.1, max(n, 9)))])
        )
    return np.concatenate(passes), interval


def read(
    kind: str,
    quaternion: np.ndarray,
    omega: np.ndarray,
    field: np.ndarray,
    rng: np.random.Generator,
) -> dict[str, Any]:
    """What the other sensor reads: rates (n, 3), a field (n, 3) in nT, or a quaternion (n, 4)."""
    shape = omega.shape
    if kind == "gyro":
        value = (
            omega * (1 + 0.01 * rng.normal())
            + 2e-3 * rng.normal(size=3)
            + 1e-3 * rng.normal(size=shape)
        )
        return {"gyro_B": (("time", "axis"), value)}
    if kind == "field":
        return {"field_B": (("time", "axis"), 1e9 * field + 500.0 * rng.normal(size=shape))}
    if kind == "attitude":
        value = (
            Rotation.from_rotvec(0.01 * rng.normal(size=shape)) * Rotation.from_quat(quaternion)
        ).as_quat()
        return {"attitude_B_from_N": (("time", "quaternion"), value)}
    return {}


def make(seed: int, i: int) -> tuple[Vehicle, xr.Dataset, xr.Dataset, dict[str, Any]]:
    """The vehicle as it is told, telemetry, the true motion, and what was drawn."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,)))
    orbit, ground, (body, units) = Orbit.drawn(rng), Ground.drawn(rng), drawn_body(rng)
    omega, (t, interval) = np.radians(10 ** rng.uniform(-0.5, 0.8)) * unit(rng), times(rng)
    sensor, (told, stated, sure) = (
        str(rng.choice([*SENSORS, "none"])),
        rng.random(3) < [0.7, 0.7, 0.5],
    )
    faces = FACES if rng.random() < 0.6 else np.delete(FACES, rng.integers(6), axis=0)
    quaternion, rate = motion(body, orbit, omega, t, rng)
    turned = Rotation.from_quat(quaternion)
    power, earth = np.zeros((len(t), len(faces))), np.zeros(len(t))
    for k, at in enumerate(t):
        place_km, normals = orbit.place_km(at), turned[k].inv().apply(faces)
        direct = np.maximum(normals @ orbit.sun, 0) if orbit.sunlit(place_km) else 0.0
        light = ground.light(place_km, orbit.sun, normals)
        power[k], earth[k] = direct + light, light.max()
    power = power * np.exp(0.04 * rng.normal(size=len(faces)))
    power = np.maximum(power + 0.01 * rng.normal(size=power.shape), 0.0)
    given = np.diag(np.diag(body.inertia) * (1 + 0.02 * rng.normal(size=3)))
    sigma = 0.03 * np.diag(given).mean() * np.ones((3, 3))
    fact = Fact(
        value=tuple(map(tuple, given.tolist())),
        sigma=tuple(map(tuple, sigma.tolist())) if sure else None,
    )
    vehicle = Vehicle(
        "in orbit",
        inertia_kg_m2=given if told else None,
        facts={"body.inertia_kg_m2": fact} if told else {},
        gain_unit="W",
        panels=[Panel(f"p{j}", face, 1.0) for j, face in enumerate(faces)],
        telemetry=TelemetryForm(noise=0.01 if stated else None),
        sensors=SENSORS[sensor],
    )
    field = turned.apply(np.array([orbit.field_T(orbit.place_km(at)) for at in t]))
    pull = float(
        np.median(
            np.linalg.norm(np.linalg.solve(body.inertia, np.cross(body.dipole, field).T), axis=0)
        )
    )
    variables = {
        "power_W": (("time", "panel"), power),
        "flag": ("time", np.zeros(len(t), dtype=np.uint8)),
        **read(sensor, quaternion, rate, field, rng),
    }
    attrs = {"epoch_utc": "2026-01-01T00:00:00Z", "synthetic": 1}
    run = xr.Dataset(
        {"omega_B": (("time", "axis"), rate), "B_from_N": (("time", "quaternion"), quaternion)},
        {"time": t},
    )
    about = {
        "deg_s": float(np.degrees(np.linalg.norm(omega))),
        "interval_s": interval,
        "samples": len(t),
        "panels": len(faces),
        "sensor": sensor,
        "inertia": bool(told),
        "sure": bool(sure),
        "stated": bool(stated),
        "units": units,
        "pull_rad_s2": pull,
        "coil": body.coil,
        "earth": float(np.median(earth)),
    }
    return (
        vehicle,
        xr.Dataset(variables, {"time": t, "panel": list(vehicle.panel_names)}, attrs),
        run,
        about,
    )
