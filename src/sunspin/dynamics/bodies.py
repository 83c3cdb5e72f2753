"""The numbers of a vehicle that its motion depends on: for one vehicle, or one set for each of many trajectories."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from sunspin.vehicle import Vehicle


@dataclass(frozen=True)
class Bodies:
    """Inertia and friction of the same vehicle in n variants (leading shape (n,)), or of the vehicle as it is (leading shape ()).

    inertia_kg_m2 (..., 3, 3), locked; wheel_inertia_kg_m2 (..., n_wheel), axial; coulomb_N_m and viscous_N_m_s (..., n_wheel).
    The directions of the wheels' axes, axes_B (n_wheel, 3), are the same in all variants. `steady_N_m` (..., 2, 3): steady torques
    that they bring with them (:class:`sunspin.dynamics.torques.Steady`).
    """

    inertia_kg_m2: np.ndarray
    wheel_inertia_kg_m2: np.ndarray
    coulomb_N_m: np.ndarray
    viscous_N_m_s: np.ndarray
    steady_N_m: np.ndarray
    axes_B: np.ndarray

    @classmethod
    def of(cls, vehicle: Vehicle | Bodies, n: int | None = None) -> Bodies:
        """The vehicle's own numbers, `n` times over or (None) once, without a leading dimension."""
        if isinstance(vehicle, Bodies):
            return vehicle
        wheels = vehicle.wheels
        body = cls(
            np.array(vehicle.require_inertia()),
            np.array([wheel.inertia_kg_m2 for wheel in wheels]),
            np.array([wheel.friction.coulomb_N_m for wheel in wheels]),
            np.array([wheel.friction.viscous_N_m_s for wheel in wheels]),
            np.zeros((2, 3)),
            np.array([wheel.axis_B for wheel in wheels]).reshape(-1, 3),
        )
        return body if n is None else body.take(np.zeros(n, dtype=np.int64))

    @classmethod
    def rigid(cls, inertia_kg_m2: np.ndarray) -> Bodies:
        """Bodies (...) without wheels."""
        none = np.zeros((*inertia_kg_m2.shape[:-2], 0))
        still = np.zeros((*inertia_kg_m2.shape[:-2], 2, 3))
        return cls(inertia_kg_m2, none, none, none, still, np.zeros((0, 3)))

    @classmethod
    def stack(cls, vehicles: Sequence[Vehicle | Bodies]) -> Bodies:
        """The numbers of vehicles (n) that differ in inertia and friction only."""
        variants = [cls.of(vehicle) for vehicle in vehicles]
        names = [field.name for field in fields(cls)[:-1]]
        return replace(
            variants[0],
            **{name: np.stack([getattr(body, name) for body in variants]) for name in names},
        )

    def take(self, index: np.ndarray) -> Bodies:
        """The variants of these numbers; a single one is repeated."""
        changes = {}
        for field in fields(self)[:-1]:
            value = getattr(self, field.name)
            changes[field.name] = (value[None] if not self.shape else value)[index]
        return replace(self, **changes)

    def vehicle(self, vehicle: Vehicle, row: int) -> Vehicle:
        """`vehicle` with the inertia and friction of one of the variants."""
        wheels = tuple(
            replace(
                wheel,
                inertia_kg_m2=float(self.wheel_inertia_kg_m2[row, i]),
                friction=replace(
                    wheel.friction,
                    coulomb_N_m=float(self.coulomb_N_m[row, i]),
                    viscous_N_m_s=float(self.viscous_N_m_s[row, i]),
                ),
            )
            for i, wheel in enumerate(vehicle.wheels)
        )
        return replace(vehicle, inertia_kg_m2=self.inertia_kg_m2[row], wheels=wheels)

    @property
    def shape(self) -> tuple[int, ...]:
        """() or (n,)."""
        return self.inertia_kg_m2.shape[:-2]

    @property
    def n_wheels(self) -> int:
        return len(self.axes_B)
