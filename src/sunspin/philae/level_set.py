"""The scan of initial rates against the telemetry, and the paper's recipe on it: near-minimum set, lines (section 2.3, Fig. 9).

The paper's own lines, which need no telemetry, are in :mod:`sunspin.philae.published_lines`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from sunspin.base.errors import InputError
from sunspin.compute.pool import worker_count
from sunspin.dynamics.ensemble import Outcome
from sunspin.estimate.scan.lines import Line, fit_lines, line_deviation, match_lines
from sunspin.estimate.scan.metrics import emd
from sunspin.estimate.scan.table import Table
from sunspin.estimate.scan.volume import near_minimum
from sunspin.output.figures import COLOURS
from sunspin.philae import rebound as rb
from sunspin.philae.row import Row, row
from sunspin.telemetry.case import Case

NEAR_RAD_S = 0.03
"""A published line comes out of a set where a fitted one is nearer on average than this, two grid steps."""

BOX = np.array([[-0.5, 1.0], [-0.5, 1.0], [-0.3, 0.3]])
"""rad/s, of the pictures: the scanned range."""

RATE_TICKS = (-0.4, 0.0, 0.4, 0.8)
"""rad/s: as many as stand apart in perspective."""


@dataclass(frozen=True)
class Families:
    """A scan's near-minimum set and the lines through it, `partner[k]` being the line for published line k."""

    emd: xr.DataArray
    factor: float
    points: np.ndarray
    lines: xr.Dataset | None
    partner: list[int]
    deviation: list[dict[str, float]]


def fitted(lines: xr.Dataset) -> list[Line]:
    """Lines of `fit_lines` as (point, unit direction)."""
    return list(zip(lines["point"].values, lines["direction"].values, strict=True))


def families(case: Case, volume: xr.DataArray, factor: float, seed: int) -> Families:
    """Near-minimum set of a scan, four lines through it, and their distance from the published ones."""
    points, published = near_minimum(volume, factor), rb.published_lines(case)
    try:
        lines = fit_lines(points, len(published), seed=seed)
    except InputError:  # a ragged level set may have fewer points than four lines need
        return Families(volume, factor, points, None, [], [])
    compared: dict[str, Any] = {"low": rb.LINE_RANGE[0], "high": rb.LINE_RANGE[1]}
    partner = match_lines(lines, published, **compared)
    ours = [fitted(lines)[k] for k in partner]
    pairs = zip(ours, published, strict=True)
    deviation = [line_deviation(mine, theirs, **compared) for mine, theirs in pairs]
    return Families(volume, factor, points, lines, partner, deviation)


@dataclass(frozen=True)
class Scanned:
    """The scan against the telemetry: its table, EMD (n) of every motion (infinite where it failed), the rebound it is of."""

    rebound: rb.Rebound
    table: Table
    emd: np.ndarray

    @property
    def smallest(self) -> float:
        return float(self.emd.min())


@dataclass(frozen=True)
class LevelSet:
    """The scan against the telemetry.

    Attributes
    ----------
    near : near-minimum set by the paper's factor, and the lines fitted to it
    truth : "omega_B" (3) rad/s, "sun_B" (3), "emd" and its heights "z" where the telemetry is the case's own twin, else empty
    """

    case: Case
    scan: Scanned
    near: Families
    truth: dict[str, Any]

    @property
    def measured_z(self) -> np.ndarray:
        """The z components (n) that the rebound's directions have."""
        return self.scan.rebound.z

    @property
    def synthetic(self) -> bool:
        return bool(self.scan.rebound.samples.attrs.get("synthetic"))

    @property
    def lines_found(self) -> int:
        """How many of the published lines come out of the near-minimum set."""
        return sum(bool(deviation["mean"] <= NEAR_RAD_S) for deviation in self.near.deviation)


def compute(
    case: Case,
    sun: xr.Dataset,
    seed: int = 0,
    coarser: int = 1,
    workers: int | None = None,
    progress: bool = False,
) -> LevelSet:
    """Scan every `coarser`-th grid point against the directions `sun` (of `sun_directions`, whole landing).

    `seed` of the line fit. For a twin `truth` holds its true rate and Sun at the first sample after the touchdown, and the EMD
    that a scan finds at this rate, from the direction that the panels show.
    """
    rebound = rb.rebound_of(case, sun)
    table = rb.grid_table(case, rebound.sun_B, rebound.window_s, coarser, workers, progress)
    volume = table.volume(rebound.z, rebound.weights, worker_count(workers))
    truth: dict[str, Any] = {}
    if twin := rb.twin_file(case):
        z = rb.seen_z(case, np.array(twin["omega_B"]))
        truth = {name: np.array(twin[name]) for name in ("omega_B", "sun_B")}
        truth |= {"emd": emd(z, rebound.z, weights_b=rebound.weights), "z": z}
    distance = np.where(table.outcome == Outcome.FINE, volume.values.ravel(), np.inf)
    near = families(case, volume, case.assumptions.study.near_minimum_factor, seed)
    return LevelSet(case, Scanned(rebound, table, distance), near, truth)


def rows(result: LevelSet) -> list[Row]:
    """Figures of section 2.3 that need telemetry, beside ours."""
    case, near = result.case, result.near
    whose = "synthetic telemetry" if result.synthetic else "this telemetry"
    points = f"{len(near.points)} grid points below {near.factor} times the smallest"
    if result.truth:
        points += f"; at the true rate of the synthetic telemetry it is {result.truth['emd']:.4f}"
    distances = ", ".join(f"L{k} {apart['mean']:.3f}" for k, apart in enumerate(near.deviation, 1))
    lines: dict[str, Any] = {
        "published": len(rb.published_lines(case)),
        "found": NEAR_RAD_S,
        "omega_z": list(rb.LINE_RANGE),
        "each": f"mean distances of the fitted lines (rad/s): {distances}"
        if distances
        else "too few points in the set for four lines",
    }
    size = int(np.prod([len(axis) for axis in rb.grid(case).values()]))
    whole = True if near.emd.size == size else None
    least, directions = result.scan.smallest, result.measured_z.size
    return [
        row(case, "emd_min", least, whose=whose, directions=directions, near=points),
        row(case, "scan_runs", int(near.emd.size), published=size, agrees=whole),
        row(case, "lines_found", result.lines_found, whose=whose, near=points, **lines),
    ]


def _inside(point: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Ends (2, 3) of a line's part in the scanned box."""
    along = np.abs(direction) > 1e-12  # a line parallel to a pair of faces meets neither
    ends = np.sort((BOX - point[:, None])[along] / direction[along, None], axis=1)
    begin, end = ends[:, 0].max(), ends[:, 1].min()
    return point + np.linspace(begin, max(begin, end), 2)[:, None] * direction


def rate_axes(figure: Figure, *place: int) -> Any:
    """Axes in perspective over the three rates (rad/s)."""
    axes = figure.add_subplot(*place, projection="3d")
    axes.set(xlabel=r"$\omega_x$ (rad/s)", ylabel=r"$\omega_y$ (rad/s)")
    axes.set(zlabel=r"$\omega_z$ (rad/s)", xticks=RATE_TICKS, yticks=RATE_TICKS)
    return axes


def level_set_figure(
    points: np.ndarray,
    lines: xr.Dataset | None,
    published: Sequence[Line],
    title: str,
    truth: np.ndarray | None = None,
) -> Figure:
    """Near-minimum points (n, 3) in rate space with fitted (solid) and published (dashed) lines (paper, Fig. 9)."""
    figure = Figure(figsize=(11, 5.2), layout="constrained")
    member = np.zeros(len(points), int) if lines is None else lines["member"].values
    views = (("perspective", 22, -62), ("from +z", 90, -90))
    for k, (name, elevation, azimuth) in enumerate(views):
        axes = rate_axes(figure, 1, 2, k + 1)
        axes.view_init(elevation, azimuth)
        axes.scatter(*points.T, s=8, c=[COLOURS[m % 8] for m in member], depthshade=False)
        for i, line in enumerate(published):
            label = "the paper's lines" if i == 0 else None
            axes.plot(*_inside(*line).T, "--", lw=1, color="#555555", label=label)
        for i, line in enumerate([] if lines is None else fitted(lines)):
            ends = _inside(*line)
            label = f"fitted line {i + 1} ({int((member == i).sum())} motions)"
            axes.plot(*ends.T, "-", lw=1.6, color=COLOURS[i % 8], label=label)
        if truth is not None:
            label = "truth of the synthetic telemetry"
            axes.scatter(*truth, marker="*", s=130, color="#000000", label=label)
        if k:
            axes.set(zlabel="", zticks=[])
        axes.set(xlim=BOX[0], ylim=BOX[1], zlim=BOX[2])
        axes.set_title(name, fontsize=9)
    figure.suptitle(title, fontsize=11)
    labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(*labels, fontsize=9, ncols=3, loc="outside lower center", frameon=False)
    return figure


def distributions_figure(
    z: np.ndarray, label: str, others: dict[str, np.ndarray], title: str
) -> Figure:
    """Cumulative distributions of r_z that the EMD compares: of directions `z` (n), and of motions by name."""
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axes, level = figure.subplots(), np.arange(1, len(z) + 1) / len(z)
    axes.step(np.sort(z), level, where="post", color=COLOURS[6], label=label)
    for k, (name, values) in enumerate(others.items()):
        # nearly one curve in pairs: each second one in dashes over the first
        style: dict[str, Any] = {
            "lw": 5.0,
            "ls": (0, (1.5, 1.5)) if k % 2 else "-",
            "color": COLOURS[k],
        }
        if name.startswith("truth"):
            style = {"lw": 1.4, "ls": (0, (1, 2)), "color": COLOURS[6]}
        axes.plot(np.sort(values), np.linspace(0, 1, len(values)), label=name, **style)
    axes.set(xlabel="$z$ component of the Sun's direction", ylabel="cumulative distribution")
    axes.set_xlim(-0.05, 1.02)
    axes.legend(fontsize=9)
    axes.set_title(title, fontsize=11)
    return figure
