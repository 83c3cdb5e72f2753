"""The numbers of a vehicle that its motion depends on: for one vehicle, or one set for each of many trajectories."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from sunspin.vehicle import Vehicle


@dataclass(frozen=True)
class Bodies:
    """Inertia and friction of the same vehicle in n variants (leading shape (n,)), or of the vehicle as it is (leading shape ()).

    `inertia_kg_m2` (..., 3, 3): of the body with its wheels locked; `wheel_inertia_kg_m2` (..., n_wheel): axial; `coulomb_N_m` and
    `viscous_N_m_s` (..., n_wheel): friction of the wheels. `steady_N_m` (..., 2, 3): steady torques that act on each variant
    (:class:`sunspin.dynamics.torques.Steady`). The directions of the wheels' axes, `axes_B` (n_wheel, 3), are the same in all.
    """

    inertia_kg_m2: np.ndarray
    wheel_inertia_kg_m2: np.ndarray
    coulomb_N_m: np.ndarray
    viscous_N_m_s: np.ndarray
    steady_N_m: np.ndarray
    axes_B: np.ndarray

    @classmethod
    def of(cls, vehicle: Vehicle | Bodies, n: int | None = None) -> Bodies:
        """Return the numbers of a vehicle: `n` equal variants or, for None, one without a leading dimension.

        :class:`Bodies` are returned as they are, so that functions can take either.
        """
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
        """Return bodies (...) with these inertias (..., 3, 3), without wheels and steady torques."""
        no_wheel = np.zeros((*inertia_kg_m2.shape[:-2], 0))
        no_torque = np.zeros((*inertia_kg_m2.shape[:-2], 2, 3))
        return cls(inertia_kg_m2, no_wheel, no_wheel, no_wheel, no_torque, np.zeros((0, 3)))

    @classmethod
    def stack(cls, vehicles: Sequence[Vehicle | Bodies]) -> Bodies:
        """Return n vehicles that differ only in inertia and friction as n variants."""
        variants = [cls.of(vehicle) for vehicle in vehicles]
        names = [field.name for field in fields(cls)[:-1]]  # all but `axes_B`
        return replace(
            variants[0],
            **{name: np.stack([getattr(body, name) for body in variants]) for name in names},
        )

    def take(self, index: np.ndarray) -> Bodies:
        """Return the variants `index`; bodies without a leading dimension count as one variant."""
        changes = {}
        for field in fields(self)[:-1]:  # all but `axes_B`
            value = getattr(self, field.name)
            changes[field.name] = (value[None] if not self.shape else value)[index]
        return replace(self, **changes)

    def vehicle(self, vehicle: Vehicle, row: int) -> Vehicle:
        """Return `vehicle` with the inertia and friction of the variant `row`."""
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
        """Return the leading shape of the variants: () or (n,)."""
        return self.inertia_kg_m2.shape[:-2]

    @property
    def n_wheels(self) -> int:
        """Return the number of wheels."""
        return len(self.axes_B)
