"""Vehicles for tests: Philae's mechanics in numbers typed here from the paper, and random physical ones."""

from __future__ import annotations

import numpy as np

from sunspin.vehicle import Friction, Vehicle, Wheel

FIRST_SUN = np.array([0.1959, 0.5690, 0.7986])  # paper, section 2.3


def philae_body(friction: Friction | None = None) -> Vehicle:
    """Philae without panels and legs: Table 2, friction from the spin-down test of section 2.2."""
    inertia = [[13.905, -0.352, -0.015], [-0.352, 12.603, 0.007], [-0.015, 0.007, 16.523]]
    friction = friction or Friction.from_spin_down(1271.0, -4.643e-4, -388.9, 0.0058)
    return Vehicle(
        "philae body", inertia, 97.63, wheels=[Wheel("wheel", [0, 0, 1], 0.0058, 865.0, friction)]
    )


def random_vehicle(
    rng: np.random.Generator, n_wheels: int, dry: float = 0.0, viscous: float = 0.0
) -> Vehicle:
    """A body of masses in random places, with wheels on random axes."""
    points = rng.normal(size=(12, 3)) * [1.0, 0.8, 0.6]
    points -= points.mean(axis=0)
    inertia = np.eye(3) * (points**2).sum() - points.T @ points
    wheels = []
    for i in range(n_wheels):
        axis = rng.normal(size=3)
        friction = Friction(dry * rng.uniform(0.5, 1.5), viscous * rng.uniform(0.5, 1.5))
        wheels.append(Wheel(f"w{i}", axis / np.linalg.norm(axis), 0.02, 0.0, friction))
    return Vehicle("random", inertia, 12.0, wheels=wheels)
