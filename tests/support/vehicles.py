"""Vehicles for tests: Philae's mechanics in numbers typed here from the paper, cubes, and random physical bodies."""

from __future__ import annotations

import numpy as np

from sunspin.vehicle import Friction, HullPart, Leg, Panel, TelemetryForm, Vehicle, Wheel

FIRST_SUN = np.array([0.1959, 0.5690, 0.7986])  # paper, section 2.3

FACES = {"+X": [1, 0, 0], "-X": [-1, 0, 0], "+Y": [0, 1, 0], "-Y": [0, -1, 0]}
FACES |= {"+Z": [0, 0, 1], "-Z": [0, 0, -1]}
"""Normals of a cube's faces by name."""

LOWER_CASE_FACES = {name.lower(): normal for name, normal in FACES.items()}
"""The same normals, with names in lower case."""

CUBE_NORMALS = np.vstack([np.eye(3), -np.eye(3)])
"""Normals (6, 3) of a cube's faces: first the positive axes, then the negative ones."""


IN_A = TelemetryForm(quantity="current_A", noise=0.002)
HALF_AMPERES = [Panel(f"p{k}", CUBE_NORMALS[k], 0.5) for k in range(6)]
CUBE_OF_CURRENTS = Vehicle("cube", gain_unit="A", panels=HALF_AMPERES, telemetry=IN_A)
"""A cube whose panels are read in A, with a noise of 0.4 % of full Sun."""


def unit_vector(rng: np.random.Generator) -> np.ndarray:
    """Draw a direction (3), uniform on the sphere."""
    vector = rng.standard_normal(3)
    return vector / np.linalg.norm(vector)


def units(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (..., 3) with length one."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def directions(n: int, seed: int = 0) -> np.ndarray:
    """Draw directions (n, 3), uniform on the sphere."""
    return units(np.random.default_rng(seed).normal(size=(n, 3)))


def small_cube(noise: float = 0.02) -> Vehicle:
    """Return a cube with known inertia and a panel on each face; `noise` of the currents, relative to full Sun."""
    panels = [Panel(name, normal, 1.0) for name, normal in LOWER_CASE_FACES.items()]
    form = TelemetryForm(quantity="current_A", noise=noise)
    return Vehicle("cube", np.diag([0.010, 0.012, 0.008]), panels=panels, telemetry=form)


def small_lander(*wheels: Wheel) -> Vehicle:
    """Return a box of 4 kg on three feet, with panels that look along x and z, and these wheels."""
    corners = [[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.2)]
    feet = [Leg("a", [0.3, 0, -0.2]), Leg("b", [-0.15, 0.26, -0.2]), Leg("c", [-0.15, -0.26, -0.2])]
    panels = [Panel("x", [1, 0, 0], 1.0), Panel("z", [0, 0, 1], 1.0)]
    inertia, hull = np.diag([0.042, 0.041, 0.03]), [HullPart("box", corners)]
    return Vehicle("box", inertia, 4.0, panels, list(wheels), feet, hull)


def philae_body(friction: Friction | None = None) -> Vehicle:
    """Return Philae without panels and legs: Table 2, friction from the spin-down test of section 2.2."""
    inertia = [[13.905, -0.352, -0.015], [-0.352, 12.603, 0.007], [-0.015, 0.007, 16.523]]
    friction = friction or Friction.from_spin_down(1271.0, -4.643e-4, -388.9, 0.0058)
    wheel = Wheel("wheel", [0, 0, 1], 0.0058, 865.0, friction)
    return Vehicle("philae body", inertia, 97.63, wheels=[wheel])


def random_vehicle(
    rng: np.random.Generator, n_wheels: int, dry: float = 0.0, viscous: float = 0.0
) -> Vehicle:
    """Draw a body of masses in random places, with wheels on random axes; `dry` (N m) and `viscous` (N m s) friction."""
    points = rng.normal(size=(12, 3)) * [1.0, 0.8, 0.6]
    points -= points.mean(axis=0)
    inertia = np.eye(3) * (points**2).sum() - points.T @ points
    wheels = []
    for i in range(n_wheels):
        axis = rng.normal(size=3)
        friction = Friction(dry * rng.uniform(0.5, 1.5), viscous * rng.uniform(0.5, 1.5))
        wheels.append(Wheel(f"w{i}", axis / np.linalg.norm(axis), 0.02, 0.0, friction))
    return Vehicle("random", inertia, 12.0, wheels=wheels)


SUN_VECTOR_FILE = """
name = "with a Sun vector"
[telemetry]
time_format = "elapsed"
epoch_utc = "2026-01-01T00:00:00Z"
[sun_vector]
columns = ["sx", "sy", "sz"]
sigma_rad = 0.02
"""
"""Text of the file of a vehicle whose telemetry has the direction to the Sun, at times counted from an epoch."""
