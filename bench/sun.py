"""Directions to the Sun from panel powers: samples per second of `ss.sun_directions`."""

from __future__ import annotations

import numpy as np

import sunspin as ss
from bench.problem import philae
from bench.table import Table
from bench.timing import medians, say

NOISE = 0.01
"""Of the largest power: enough that no two samples are alike."""


def run(quick: bool) -> Table:
    """Samples per second for telemetry of several lengths, directions drawn evenly over the sphere."""
    vehicle, rng = philae().vehicle, np.random.default_rng(5)
    lengths = (1_000, 10_000) if quick else (1_000, 10_000, 100_000)
    say(f"sun: {lengths} samples")
    power = telemetry(vehicle, lengths[-1], rng)
    seconds = medians({n: lambda n=n: ss.sun_directions(vehicle, power[:n]) for n in lengths}, 3)
    table = Table(
        "sun", "directions to the Sun from panel powers", ("samples", "s", "samples/s", "us/sample")
    )
    for n in lengths:
        taken = seconds[n]
        table.add(n, taken, n / taken, 1e6 * taken / n)
    return table


def telemetry(vehicle: ss.Vehicle, n: int, rng: np.random.Generator) -> np.ndarray:
    """Noisy panel powers (n, n_panel) under random directions to the Sun."""
    directions = rng.normal(size=(n, 3))
    power = ss.panel_power(vehicle, directions / np.linalg.norm(directions, axis=1, keepdims=True))
    return np.clip(power + NOISE * power.max() * rng.normal(size=power.shape), 0.0, None)
