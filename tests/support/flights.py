"""A cube that tumbles along an orbit drawn at random, whose panels are read; its clock may be off. All of it is synthetic.

SGP4, Sun and the cylinder of shadow are those of `tests/support/orbits.py`, not the package's.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation
from sgp4.api import Satrec, jday

from sunspin.environment.elements import parse_elements
from sunspin.environment.orbit import in_orbit
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from tests.support.orbits import EARTH_KM, EPOCH, sun_of_date, two_line_elements
from tests.support.simulate import telemetry_of
from tests.support.vehicles import CUBE_NORMALS, unit_vector

PERIOD_S = 5700.0
RELATIVE = Vehicle("cube", panels=[Panel(f"p{j}", n, 1.0) for j, n in enumerate(CUBE_NORMALS)])
CUBE = replace(RELATIVE, gain_unit="W", telemetry=TelemetryForm(noise=0.01))


class Flight:
    """An orbit, and what the cube reads along it at times in s from its epoch."""

    def __init__(self, seed: int, span_s: float = PERIOD_S, step_s: float = 30.0) -> None:
        self.rng = np.random.default_rng(seed)
        self.given = two_line_elements(self.rng)
        self.t = np.arange(0.0, span_s, step_s)

    def sky(self, late_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the Sun's direction (n, 3), whether it is up (n) and the ground below lit (n), `late_s` after the times."""
        day, fraction = jday(EPOCH.year, EPOCH.month, EPOCH.day, EPOCH.hour, 0, 0)
        fraction = fraction + (self.t + late_s) / 86400
        _, place, _ = Satrec.twoline2rv(*self.given).sgp4_array(np.full(len(self.t), day), fraction)
        sun = sun_of_date(day - 2451545.0 + fraction)
        along = (place * sun).sum(axis=1)
        away = np.linalg.norm(place - along[:, None] * sun, axis=1)
        return sun, (along > 0) | (away > EARTH_KM), along > 0

    def telemetry(self, late_s: float = 0.0, albedo: float = 0.1) -> xr.Dataset:
        """Return readings whose times are behind the true ones by `late_s`."""
        sun, self.lit, day = self.sky(late_s)
        spin = np.radians(3.0) * unit_vector(self.rng)
        first = Rotation.random(random_state=int(self.rng.integers(2**31)))
        sun_B = (Rotation.from_rotvec(self.t[:, None] * spin) * first).apply(sun)
        power = np.maximum(sun_B @ CUBE_NORMALS.T, 0) * self.lit[:, None]
        power += albedo * self.rng.uniform(size=power.shape) * day[:, None]
        return self.dataset(power + 0.01 * self.rng.normal(size=power.shape))

    def dataset(self, power: np.ndarray) -> xr.Dataset:
        """Return readings (n, 6) as telemetry."""
        data = telemetry_of(CUBE, self.t[: len(power)], np.maximum(power, 0))
        return data.assign_attrs(epoch_utc=EPOCH.isoformat() + "Z", synthetic=1)

    def orbit(self, **options):
        """Return the environment of the orbit's own elements."""
        elements = parse_elements("\n".join(self.given), "flight")
        return in_orbit(elements, EPOCH.isoformat() + "Z", self.t, **options)
