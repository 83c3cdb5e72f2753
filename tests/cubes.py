"""A cube: the normals of its faces by their names, in capitals and not, and one that is small."""

from __future__ import annotations

import numpy as np

from sunspin.vehicle import Panel, TelemetryForm, Vehicle

FACES = {
    "+X": [1, 0, 0],
    "-X": [-1, 0, 0],
    "+Y": [0, 1, 0],
    "-Y": [0, -1, 0],
    "+Z": [0, 0, 1],
    "-Z": [0, 0, -1],
}

SIDES = {name.lower(): normal for name, normal in FACES.items()}


def small_cube(noise: float = 0.02) -> Vehicle:
    """A cube of the six sides, its moments told, panels read as currents of full Sun one with this noise."""
    return Vehicle(
        "cube",
        inertia_kg_m2=np.diag([0.010, 0.012, 0.008]),
        panels=[Panel(name, normal, 1.0) for name, normal in SIDES.items()],
        telemetry=TelemetryForm(quantity="current_A", noise=noise),
    )
