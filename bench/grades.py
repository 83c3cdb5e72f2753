"""A scan in two grades against running each motion: how many times faster, for the same sets, and what the motions run are for."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import xarray as xr

from bench.problem import philae
from bench.table import Table
from bench.timing import cores, say, timings
from sunspin.estimate.scan.grades import nodes
from sunspin.philae import rebound

QUICK_POINTS = 29
"""Of the paper's grid on each axis, about its middle: just enough motions to be run in two grades."""

FACTORS: dict[str, tuple[float, ...]] = {
    "each motion": (),
    "1.1": (1.1,),
    "1.1 and 4.33": (1.1, 4.33),
}
"""Sets asked for: the paper's, and with it the 90 % set of the built-in telemetry."""

COLUMNS = (
    "set",
    "rows run",
    "nodes",
    "open",
    "tried",
    "s",
    "in use",
    "faster by",
    "motions in another set",
)


def run(quick: bool) -> Table:
    """Each set asked for, in one run on all cores."""
    problem, found = philae(), dict[str, xr.DataArray]()
    axes = {
        name: middle(axis) if quick else axis for name, axis in rebound.grid(problem.case).items()
    }

    def scan(name: str) -> Callable[[], None]:
        return lambda: found.update({name: problem.scan(axes, factors=FACTORS[name])})

    say("grades: timing")
    times = timings({name: scan(name) for name in FACTORS}, 1 if quick else 3)
    whole = found["each motion"].values
    table = Table(
        "grades", f"a scan of {whole.size:,} motions in two grades, {cores()} cores", COLUMNS
    )
    for name, factors in FACTORS.items():
        one, timing = found[name], times[name]
        parts = (whole.size, None, None, None)
        if factors:
            exact, tried = int(one["exact"].sum()), sum(one.attrs["class_tried"])
            first = int(np.prod([len(nodes(len(axis))) for axis in axes.values()]))
            parts = (exact, first, exact - first - tried, tried)
        other = sum(
            int(np.sum((one.values <= f * one.min().item()) != (whole <= f * whole.min())))
            for f in factors
        )
        table.add(
            name,
            *parts,
            timing.median,
            timing.cores_used,
            times["each motion"].against(timing),
            other,
        )
    table.notes.append(
        "nodes: of the coarser grid; open: interpolation leaves their sets open; tried: to try the bounds."
    )
    return table


def middle(axis: np.ndarray) -> np.ndarray:
    """QUICK_POINTS of an axis about its middle."""
    first = (len(axis) - QUICK_POINTS) // 2
    return axis[first : first + QUICK_POINTS]
