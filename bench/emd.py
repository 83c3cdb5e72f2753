"""Distance between two samples of r_z: ss.emd, SciPy and POT on as many values as one motion of the scan gives."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable

import numpy as np
from scipy.stats import wasserstein_distance

import sunspin as ss
from bench.problem import philae
from bench.timing import Table, medians

SAMPLES, TARGET = 30_000, 20
FUSED = "ss.scan on one core, the motion included"


def run(quick: bool) -> Table:
    """Measure the time of a distance on one core."""
    rng = np.random.default_rng(4)
    z, target = rng.uniform(-1, 1, SAMPLES), rng.uniform(0, 1, TARGET)
    table = Table(
        f"emd: distances of {SAMPLES} against {TARGET} samples", ("by", "ms", "largest difference")
    )
    ways: dict[str, Callable[[], float]] = {
        "ss.emd": lambda: ss.emd(z, target),
        "scipy wasserstein_distance": lambda: float(wasserstein_distance(z, target)) / 2,
    }
    if importlib.util.find_spec("ot"):
        import ot

        ways["POT wasserstein_1d"] = lambda: float(ot.wasserstein_1d(z, target, p=1)) / 2
        ways["POT emd2_1d"] = lambda: float(ot.emd2_1d(z, target, metric="cityblock")) / 2
    else:
        table.notes.append("POT is not installed (the extra `bench`): its rows are left out.")
    values = {name: call() for name, call in ways.items()}
    work: dict[str, Callable] = dict(ways)
    # a whole scan, whose time is divided by its number of motions
    axes = philae().axes(8, 8, 8) if quick else philae().axes(16, 16, 16)
    work[FUSED] = lambda: philae().scan(axes, workers=1)
    seconds = medians(work, 3 if quick else 9)
    for name in ways:
        table.rows.append((name, 1e3 * seconds[name], abs(values[name] - values["ss.emd"])))
    seconds_per_motion = seconds[FUSED] / np.prod([len(axis) for axis in axes.values()])
    table.rows.append((FUSED, 1e3 * seconds_per_motion, None))
    table.notes.append(
        "SciPy's and POT's values are halved: the paper's distance is half of theirs."
    )
    return table
