"""Twins for `rates` in orbit about the Earth, moved by equations of their own. All of it is synthetic.

A CubeSat with a residual magnetic dipole tumbles in the Earth's field and in its gravity's gradient, of which the vehicle file says
nothing; the Earth reflects light on every face, unevenly, from below. Nothing of the package's own dynamics or panel model is used
to make them. An orbit has `radius_km`, `rate_rad_s`, `place_km(t)` and `field_T(place)` (`tests/orbit_rates_twins.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from strange_twins import unit

EARTH_KM = 6371.0
"""Radius of the Earth."""


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

    def change(self, orbit: Any) -> Callable[[float, np.ndarray], np.ndarray]:
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
    body: Body, orbit: Any, omega_B: np.ndarray, t: np.ndarray, rng: np.random.Generator
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
