"""An attitude sensor: a quaternion from some inertial frame, of which only the turn from sample to sample is used."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from sunspin.estimate.terms.term import PairTerm
from sunspin.solve.rotations import rotation_between
from sunspin.vehicle import Vehicle
from sunspin.vehicle.sensors import VARIABLES


@dataclass(frozen=True)
class Attitude(PairTerm):
    """Attitudes B_from_N (n, 3, 3) of some inertial frame, NaN where not read, with one sigma (rad)."""

    name: ClassVar[str] = "attitude"
    called: ClassVar[str] = "attitude"
    table: ClassVar[str] = "attitude"
    per_sample: ClassVar[tuple[str, ...]] = ("B_from_N",)
    measured: ClassVar[tuple[str, ...]] = per_sample

    B_from_N: np.ndarray
    sigma_rad: float

    @classmethod
    def read(cls, vehicle: Vehicle, telemetry: xr.Dataset) -> Self | None:
        """That of telemetry, if it has one."""
        if VARIABLES[cls.table] not in telemetry:
            return None
        quaternion = np.asarray(telemetry[VARIABLES[cls.table]], dtype=np.float64)
        read, good = np.full((len(quaternion), 3, 3), np.nan), np.isfinite(quaternion).all(axis=1)
        read[good] = Rotation.from_quat(quaternion[good]).as_matrix().reshape(-1, 3, 3)
        part = vehicle.sensors.with_columns.get(cls.table)
        return cls(read, part.sigma_rad if part is not None else np.inf)

    def present(self) -> np.ndarray:
        return np.isfinite(self.B_from_N[:, 0, 0])

    def wider(self, drift_rad: np.ndarray, drift_rad_s: float) -> Self:
        return replace(self, sigma_rad=float(np.hypot(self.sigma_rad, drift_rad.max())))

    def rates(self, index: int, dt: float, rate_max: float) -> np.ndarray:
        """That of the turn, with whole turns more or less."""
        if not np.isfinite(self.B_from_N[index : index + 2]).all():
            return np.zeros((0, 3))
        angle = -Rotation.from_matrix(self.B_from_N[index + 1] @ self.B_from_N[index].T).as_rotvec()
        size = max(float(np.linalg.norm(angle)), 1e-9)
        turns = np.arange(
            -int(rate_max * dt / (2 * np.pi)) - 1, int(rate_max * dt / (2 * np.pi)) + 1
        )
        return angle / dt * (1 + 2 * np.pi * turns[:, None] / size)

    def unrelated(self, t_s: np.ndarray) -> float:
        """A turn to sqrt(2) sigmas, of all turns that there are (8 pi^2)."""
        filled = (2 * np.pi * 2 * self.sigma_rad**2) ** 1.5 / (8 * np.pi**2)
        return self.readings() * min(float(np.log(filled)), 0.0)

    def between(
        self, t_s: np.ndarray, relative: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The turn less that of the given attitudes; small, so that turns add as vectors."""
        pair = self.pairs()
        given = np.where(
            pair[:, None, None],
            self.B_from_N[1:] @ np.swapaxes(self.B_from_N[:-1], -1, -2),
            np.eye(3),
        )
        inverse = np.where(pair, 1 / (np.sqrt(2) * self.sigma_rad), 0.0)[:, None]
        value = rotation_between(np.broadcast_to(given, relative.shape), relative) * inverse
        first, second = np.zeros((*value.shape, 6)), np.zeros((*value.shape, 6))
        second[..., :3] = np.eye(3) * inverse[..., None]
        first[..., :3] = -relative * inverse[..., None]
        return value, first, second
