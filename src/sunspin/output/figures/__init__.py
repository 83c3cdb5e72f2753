"""Results to figures. Each function returns a matplotlib Figure; `save` writes it as PNG and SVG.

Synthetic telemetry is called so in the title of every figure that shows it.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from sunspin.estimate.scan.lines import Line
from sunspin.output.folder import write_whole
from sunspin.telemetry.sun import STATUS_TEXT, SunStatus

# colour-blind safe (Okabe and Ito)
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#999999")
ABOVE: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.2, "frameon": False}
"""A legend above the axes, where it covers no data."""

matplotlib.rcParams["svg.hashsalt"] = "sunspin"  # the same figure gives the same bytes


def lay_out(figure: Figure) -> Figure:
    """Find the places of axes and labels once and for all: matplotlib does it anew, twice, for each format that is written."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine("none")
    return figure


def save(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write a figure as PNG and SVG."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from")  # names may have letters that the font has not: boxes
        draw = lay_out(figure).savefig
        return [
            write_whole(folder / f"{name}.{suffix}", partial(draw, format=suffix, dpi=130, metadata=metadata))
            for suffix, metadata in (("png", {}), ("svg", {"Date": None}))
        ]


def named(name: Any) -> str:
    """A name from outside as text and never as a formula."""
    return str(name).replace("$", r"\$")


def titled(text: str, synthetic: Any) -> str:
    return f"{text} (synthetic telemetry)" if synthetic else text


def signals_figure(telemetry: xr.Dataset) -> Figure:
    """Signals of the panels against time."""
    figure = Figure(figsize=(10, 3.8), layout="constrained")
    axes = figure.subplots()
    place = _passes_together(telemetry["time"].values)
    _signals(axes, telemetry, place)
    _time_axis(axes, telemetry, place)
    axes.set_title(titled("Panel signals", telemetry.attrs.get("synthetic")), loc="left")
    return figure


def _signals(axes: Any, telemetry: xr.Dataset, place: Passes) -> None:
    name = "power_W" if "power_W" in telemetry else "current_A"
    values, hours = telemetry[name], telemetry["time"].values / 3600
    gaps, x = _long_gaps(hours), place.x(hours)
    line = ".:" if hours.size <= MOST_JOINED else "."  # lines between many samples hide them
    for k, panel in enumerate(values["panel"].values):
        broken = np.insert(values.sel(panel=panel).values, gaps, np.nan)
        axes.plot(np.insert(x, gaps, np.nan), broken, line, ms=4, lw=0.7, color=COLOURS[k % 8], label=f"panel {named(panel)}")
    axes.set_ylabel("power (W)" if name == "power_W" else "current (A)")
    axes.legend(ncols=8, fontsize=8, columnspacing=0.8, handletextpad=0.2, **ABOVE)


MOST_JOINED = 80
"""Samples up to which dotted lines connect them."""

APART = 0.6
"""Part of the whole time, in pauses, from which the pauses are drawn shorter."""

SHORT_H = 1.5
"""Shorter records have an axis in minutes."""

PAUSE_WIDTH, MOST_TICKS = 0.04, 12
"""A shortened pause is this part of all passes together; at most so many passes are named on the axis."""


class Passes(NamedTuple):
    """Where times stand on an axis: `hours` of passes' ends -> `places`; both empty where time runs evenly, in h or in min."""

    hours: np.ndarray
    places: np.ndarray
    in_min: bool = False

    def x(self, hours: np.ndarray) -> np.ndarray:
        """Places of times (h)."""
        return np.interp(hours, self.hours, self.places) if self.hours.size else hours * (60 if self.in_min else 1)


def _passes_together(time_s: np.ndarray) -> Passes:
    """An axis on which passes that lie far apart stand side by side."""
    hours = np.sort(np.asarray(time_s, dtype=np.float64)) / 3600
    cuts = _long_gaps(hours)
    pauses = hours[cuts] - hours[cuts - 1]
    whole = float(np.ptp(hours)) if hours.size else 0.0
    if not cuts.size or pauses.sum() < APART * whole:
        return Passes(np.zeros(0), np.zeros(0), whole < SHORT_H)
    ends = np.stack([np.insert(hours[cuts], 0, hours[0]), np.append(hours[cuts - 1], hours[-1])], axis=1)
    lengths = np.maximum(ends[:, 1] - ends[:, 0], 1e-6)
    begins = np.cumsum(lengths + PAUSE_WIDTH * lengths.sum()) - lengths
    return Passes(ends.ravel() + np.tile([0.0, 1e-9], len(ends)), np.stack([begins, begins + lengths], axis=1).ravel())


def _time_axis(axes: Any, data: xr.Dataset, place: Passes) -> None:
    """Title of a time axis, and on one with shortened pauses the time at which each pass begins."""
    if not place.hours.size:
        begin = data.attrs.get("epoch_utc", "the first sample")
        axes.set_xlabel(f"time ({'min' if place.in_min else 'h'}) since {begin}")
        return
    begins, at = place.hours[::2], place.places[::2]
    shown = [0]
    for k in range(1, len(at)):
        if at[k] - at[shown[-1]] > (at[-1] - at[0]) / MOST_TICKS:
            shown.append(k)
    epoch = np.datetime64(str(data.attrs.get("epoch_utc", "1970-01-01")).removesuffix("Z"), "s")
    utc = [str(epoch + np.timedelta64(round(3600 * h), "s"))[5:16].replace("T", "\n") for h in begins[shown].tolist()]
    axes.set_xticks(at[shown], utc, fontsize=8)
    for end, begin in zip(place.places[1:-1:2], place.places[2::2], strict=True):
        axes.axvspan(end, begin, color=COLOURS[7], alpha=0.12, lw=0, zorder=0)
    longest = 60 * float(np.diff(place.hours.reshape(-1, 2), axis=1).max())
    axes.set_xlabel(f"UTC at which each pass begins (the longest is {longest:.3g} min; grey: pauses, shortened)")


def gains_figure(quality: xr.Dataset) -> Figure:
    """Gain of each panel with one sigma; dead panels crossed."""
    figure = Figure(figsize=(7, 3.6), layout="constrained")
    axes = figure.subplots()
    place = np.arange(quality.sizes["panel"])
    gain, dead = quality["gain"].values, quality["dead"].values.astype(bool)
    axes.errorbar(place, gain, yerr=quality["gain_sigma"].values, fmt="o", color=COLOURS[0], capsize=3)
    axes.plot(place[dead], gain[dead], "x", ms=10, color=COLOURS[1])
    axes.set_xticks(place, [named(name) for name in quality["panel"].values])
    axes.set_xlabel("panel")
    axes.set_ylabel("gain (unit of the vehicle's gains)")
    axes.set_title(titled("Gains of the panels", quality.attrs.get("synthetic")))
    return figure


def health_figure(health: xr.Dataset) -> Figure:
    """Sets of panels that were lit together and cannot be, a row each with its samples; panels whose loss explains all marked."""
    lit, lost = (health[name].values.astype(bool) for name in ("impossible_lit", "lost"))
    figure = Figure(figsize=(7, 1.6 + 0.35 * max(len(lit), 3)), layout="constrained")
    axes = figure.subplots()
    row, column = np.nonzero(lit)
    axes.plot(column, row, "s", ms=11, color=COLOURS[4], label="lit")
    for k, panels in enumerate(lost[:1]):
        for place in np.flatnonzero(panels):
            axes.axvline(place, color=COLOURS[1], lw=1.4, ls="--", label="its loss explains them" if k == 0 else None)
    axes.set_yticks(range(len(lit)), [f"{n} samples" for n in health["samples"].values])
    axes.set_xticks(range(lit.shape[1]), [named(name) for name in health["panel"].values])
    axes.set(xlabel="panel", xlim=(-0.6, lit.shape[1] - 0.4), ylim=(len(lit) - 0.4, -0.6) if len(lit) else (1, 0))
    handles, labels = axes.get_legend_handles_labels()
    shown = dict(zip(labels, handles, strict=True))
    if shown:
        axes.legend(shown.values(), shown.keys(), ncols=2, fontsize=9, **ABOVE)
    title = "Lit together, which the Sun alone cannot do" if len(lit) else "Nothing was lit that the Sun cannot light"
    axes.set_title(titled(title, health.attrs.get("synthetic")), fontsize=10, loc="left", pad=20)
    return figure


def sun_directions_figure(
    sun: xr.Dataset, telemetry: xr.Dataset | None = None, events: Mapping[str, float] | None = None
) -> Figure:
    """Panel signals where they are given, Sun direction components and Delta against time; samples without a direction by reason.

    `events`: name -> s of the telemetry's clock, marked by lines across all three.
    """
    hours = (sun["time"].values if "time" in sun.coords else np.arange(sun.sizes["time"])) / 3600
    figure = Figure(figsize=(10, 8.5 if telemetry is not None else 5.6), layout="constrained")
    parts = figure.subplots(3 if telemetry is not None else 2, 1, sharex=True,
                            height_ratios=(3, 3, 1.6)[0 if telemetry is not None else 1 :])  # fmt: skip
    middle, low = parts[-2:]
    place = _passes_together(3600 * hours)
    x = place.x(hours)
    told = np.isfinite(sun["sun_B"].values[:, 0])
    error = sun["sigma_rad"].values
    if telemetry is not None:
        _signals(parts[0], telemetry, place)
    figure.suptitle(titled("Panel signals and the directions to the Sun that follow from them", sun.attrs.get("synthetic")))
    for k, axis in enumerate("xyz"):
        middle.errorbar(
            x[told], sun["sun_B"].values[told, k], yerr=error[told], fmt=".", ms=5, lw=0.8, color=COLOURS[k],
            label=f"$n_{axis}$",
        )  # fmt: skip
    for piece in _connected(hours, sun):
        for k in range(3):
            middle.plot(x[piece], sun["sun_B"].values[piece, k], "-", lw=0.6, alpha=0.6, color=COLOURS[k], zorder=1)
    _mark_reasons(middle, x, sun)
    middle.set_ylim(-1.5, 1.15)
    middle.set_ylabel("Sun direction, body axes")
    middle.legend(ncols=4, fontsize=7, columnspacing=0.8, handletextpad=0.2, **ABOVE)
    checked, unchecked = (sun["status"].values == status for status in (SunStatus.OK, SunStatus.UNCHECKED))
    low.semilogy(x[checked], np.maximum(sun["delta"].values[checked], 1e-4), ".", color=COLOURS[6], ms=4)
    low.plot(
        x[unchecked], np.full(unchecked.sum(), 1e-4), "x", color=COLOURS[7], ms=4,
        label="exactly three panels lit: 0 whatever the powers",
    )  # fmt: skip
    low.set_ylim(5e-5, 60 if events else 1)  # room for the names of events
    if unchecked.any():
        low.legend(fontsize=8, **ABOVE)
    low.set_ylabel(r"$\Delta$")
    _time_axis(low, sun, place)
    for k, (event, second) in enumerate((events or {}).items()):
        at = float(place.x(np.asarray(second / 3600)))
        for axes in parts:
            axes.axvline(at, lw=0.8, color=COLOURS[6], alpha=0.6, zorder=0)
        low.text(at, 20 / 4 ** (k % 3), f" {event}", fontsize=7, va="center", ha="right" if k % 2 == 0 and k else "left")
    return figure


PAUSE = 10
"""Steps between samples after which no line connects them."""

TURNED = np.radians(60.0)
"""Angle between directions beyond which no line connects them."""


def _long_gaps(hours: np.ndarray) -> np.ndarray:
    """Where the line between samples is broken: pauses of more than ten times the usual step."""
    steps = np.diff(hours)
    return np.flatnonzero(steps > PAUSE * np.median(steps)) + 1 if steps.size else np.zeros(0, int)


def _connected(hours: np.ndarray, sun: xr.Dataset) -> list[np.ndarray]:
    """Indices of the directions that a line connects: successive ones of one phase, no more than `PAUSE` usual steps apart, and not
    so far from each other that the way between them is not known.

    A few samples without a direction in between do not break the line, as in the paper's figure.
    """
    told = np.flatnonzero(np.isfinite(sun["sun_B"].values[:, 0]))
    direction = sun["sun_B"].values[told]
    far = (direction[1:] * direction[:-1]).sum(axis=1) < np.cos(TURNED)
    phase = sun["phase"].values.astype(str) if "phase" in sun.coords else np.full(hours.size, "")
    usual = float(np.median(np.diff(hours))) if hours.size > 1 else 0.0
    parted = (phase[told[1:]] != phase[told[:-1]]) | (np.diff(hours[told]) > PAUSE * usual) | far
    return [piece for piece in np.split(told, np.flatnonzero(parted) + 1) if piece.size > 1]


def _mark_reasons(axes: Any, hours: np.ndarray, sun: xr.Dataset) -> None:
    markers = {SunStatus.ARC: "|", SunStatus.REGION: "x", SunStatus.DARK: "v", SunStatus.RULE: "s"}
    for status in SunStatus:
        at = sun["status"].values == status
        if status in (SunStatus.OK, SunStatus.UNCHECKED) or not at.any():
            continue
        text = STATUS_TEXT[status].split(":")[0].split(";")[0]
        height = np.full(at.sum(), -1.1 - 0.05 * (int(status) - 2))
        axes.plot(hours[at], height, markers.get(status, "d"), ms=4, color=COLOURS[7], label=f"{text} ({at.sum()})")


def descent_and_rebound_figure(parts: dict[str, xr.Dataset], synthetic: bool) -> Figure:
    """Reconstructed directions on the sphere for each phase of the motion (paper, Fig. 4)."""
    figure = Figure(figsize=(11, 3.4), layout="constrained")
    for k, (name, part) in enumerate(parts.items()):
        axes = figure.add_subplot(1, len(parts), k + 1, projection="3d")
        _sphere(axes)
        n = part["sun_B"].values
        n = n[np.isfinite(n[:, 0])]
        axes.plot(*n.T, ":", lw=0.6, color=COLOURS[7])
        axes.scatter(*n.T, s=9, color=COLOURS[0], depthshade=False)
        doubtful = part["best_B"].values[(part["status"].values == SunStatus.IMPOSSIBLE) & (part["n_lit"].values >= 3)]
        axes.scatter(*doubtful.T, s=9, color=COLOURS[1], depthshade=False)
        more = f", {len(doubtful)} doubtful" if len(doubtful) else ""
        axes.set_title(f"{chr(65 + k)}: {name}\n{len(n)} of {part.sizes['time']} samples{more}", fontsize=9)
    figure.suptitle(titled("Directions to the Sun in body axes", synthetic), fontsize=10)
    return figure


def _sphere(axes: Any) -> None:
    u, v = np.mgrid[0 : 2 * np.pi : 25j, 0 : np.pi : 13j]
    axes.plot_wireframe(np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v), lw=0.25, color="#cccccc")
    axes.set_box_aspect((1, 1, 1), zoom=1.15)
    for name in "xyz":
        getattr(axes, f"set_{name}label")(f"{name}", labelpad=-6, fontsize=8)
        getattr(axes, f"set_{name}ticks")([-1, 0, 1])
        axes.tick_params(axis=name, labelsize=6, pad=-3)


def spin_down_figure(
    t_s: np.ndarray, curves: dict[str, np.ndarray],
    title: str = "Spin-down of the wheel, computed from published friction (no measured record is public)",
) -> Figure:  # fmt: skip
    """Wheel speed against time for several friction laws (paper, Fig. 5), or as recorded and fitted."""
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    for k, (label, speed) in enumerate(curves.items()):
        axes.plot(t_s / 60, speed, "-" if k == 0 else "--", color=COLOURS[k], label=label)
    axes.set_xlabel("time (min)")
    axes.set_ylabel("wheel speed (rad/s)")
    axes.set_ylim(bottom=-20)
    axes.axhline(0, lw=0.5, color=COLOURS[7])
    axes.legend()
    axes.set_title(title, fontsize=9)
    return figure


def examples_figure(runs: list[xr.Dataset]) -> Figure:
    """The Sun's track on the sphere and its components for several initial rates (paper, Fig. 6)."""
    figure = Figure(figsize=(11, 7.5), layout="constrained")
    rows = figure.subfigures(2, 1, height_ratios=(1.2, 1), squeeze=False)[:, 0]
    lower = rows[1].subplots(3, len(runs), sharex=True, sharey=True, squeeze=False)
    for k, run in enumerate(runs):
        r, minutes = run["sun_B"].values, run["time"].values / 60
        axes = rows[0].add_subplot(1, len(runs), k + 1, projection="3d")
        _sphere(axes)
        axes.plot(*r.T, lw=0.4, color=COLOURS[0])
        omega = ", ".join(f"{x:.4g}" for x in run["omega_B"].values[0])
        axes.set_title(rf"$\omega(0)$ = [{omega}] rad/s", fontsize=9)
        for i, name in enumerate("xyz"):
            lower[i, k].plot(minutes, r[:, i], lw=0.5, color=COLOURS[i])
            lower[i, 0].set_ylabel(f"$r_{name}$")
        lower[2, k].set_xlabel("time (min)")
    return figure


def histograms_figure(runs: list[xr.Dataset]) -> Figure:
    """Distribution of r_z over each run, as densities of area 1 (paper, Fig. 7)."""
    figure = Figure(figsize=(10, 3.2), layout="constrained")
    for axes, run in zip(figure.subplots(1, len(runs)), runs, strict=True):
        axes.hist(run["sun_B"].values[:, 2], bins=60, range=(-1, 1), density=True, color=COLOURS[0])
        axes.set_xlabel("$r_z$")
        omega = ", ".join(f"{x:.4g}" for x in run["omega_B"].values[0])
        axes.set_title(rf"$\omega(0)$ = [{omega}] rad/s", fontsize=9)
        axes.set_ylabel("density")
    return figure


def level_set_figure(
    points: np.ndarray, lines: Any, published: Sequence[Line], title: str, truth: np.ndarray | None = None
) -> Figure:
    """Near-minimum points in rate space with fitted (solid) and published (dashed) lines (paper, Fig. 9)."""
    figure = Figure(figsize=(11, 5.2), layout="constrained")
    views = (("perspective", 22, -62), ("from +z", 90, -90))
    member = np.zeros(len(points), int) if lines is None else lines["member"].values
    for k, (name, elevation, azimuth) in enumerate(views):
        axes = figure.add_subplot(1, 2, k + 1, projection="3d")
        axes.view_init(elevation, azimuth)
        axes.scatter(*points.T, s=8, c=[COLOURS[m % 8] for m in member], depthshade=False)
        for i, (point, direction) in enumerate(published):
            label = "the paper's lines" if i == 0 else None
            axes.plot(*_clipped(point, direction).T, "--", lw=1, color="#555555", label=label)
        if lines is not None:
            for i, (point, direction) in enumerate(zip(lines["point"].values, lines["direction"].values, strict=True)):
                count = f"fitted line {i + 1} ({int((member == i).sum())} motions)"
                axes.plot(*_clipped(point, direction).T, "-", lw=1.6, color=COLOURS[i % 8], label=count)
        if truth is not None:
            axes.scatter(*truth, marker="*", s=130, color="#000000", label="truth of the synthetic telemetry")
        axes.set_xlabel(r"$\omega_x$ (rad/s)")
        axes.set_ylabel(r"$\omega_y$ (rad/s)")
        axes.set_zlabel(r"$\omega_z$ (rad/s)" if k == 0 else "")
        if k:
            axes.zaxis.set_ticks([])
        axes.set(xlim=(-0.5, 1), ylim=(-0.5, 1), zlim=(-0.3, 0.3))
        axes.set_title(name, fontsize=9)
    figure.suptitle(title, fontsize=11)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), fontsize=9, ncols=3, loc="outside lower center", frameon=False)
    return figure


def _clipped(point: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The part of a line inside the scanned box."""
    low, high = np.array([-0.5, -0.5, -0.3]), np.array([1.0, 1.0, 0.3])
    along = np.abs(direction) > 1e-12  # a line parallel to a pair of faces meets neither
    ends = np.sort(np.array([(low - point)[along] / direction[along], (high - point)[along] / direction[along]]), axis=0)
    begin, end = ends[0].max(), ends[1].min()
    return point + np.linspace(begin, max(begin, end), 2)[:, None] * direction


def thresholds_figure(table: list[dict[str, Any]], chosen: float) -> Figure:
    """Points of the near-minimum set, and distance of its lines from the published ones, against the factor."""
    figure = Figure(figsize=(8, 3.6), layout="constrained")
    figure.suptitle("Near-minimum set of the published lines' distribution", fontsize=10)
    left, right = figure.subplots(1, 2)
    factors = [row["factor"] for row in table]
    left.semilogy(factors, [max(row["points"], 1) for row in table], "o-", color=COLOURS[0])
    left.set_ylabel("points in the set")
    for k in range(4):
        fitted = [(row["factor"], row["mean_distance"][k]) for row in table if row["mean_distance"]]
        right.plot(*zip(*fitted, strict=True), "o-", ms=4, color=COLOURS[k], label=f"L{k + 1}")
    right.set_yscale("log")
    right.set_ylabel("mean distance from the paper's line (rad/s)", fontsize=9)
    right.legend(fontsize=8)
    for axes in (left, right):
        axes.axvline(chosen, lw=0.8, ls="--", color=COLOURS[7])
        axes.set_xlabel("factor on the smallest EMD")
    return figure


def distributions_figure(z: np.ndarray, weights_label: str, others: dict[str, np.ndarray], title: str) -> Figure:
    """Cumulative distributions of r_z that the EMD compares."""
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axes = figure.subplots()
    axes.step(np.sort(z), np.arange(1, len(z) + 1) / len(z), where="post", color=COLOURS[6], label=weights_label)
    for k, (label, values) in enumerate(others.items()):  # nearly one curve: wide below narrow, so that each is seen
        style: dict[str, Any] = {"lw": 7 - 1.6 * k, "alpha": 0.45}
        if k >= 2:
            style = {"lw": 2.2, "ls": (0, (2, 2) if k == 2 else (1, 3))}
        style = {"lw": 2.0} if label.startswith("truth") else style
        axes.plot(np.sort(values), np.linspace(0, 1, len(values)), color=COLOURS[k], label=label, **style)
    axes.set_xlabel("$z$ component of the Sun's direction")
    axes.set_ylabel("cumulative distribution")
    axes.set_xlim(-0.05, 1.02)
    axes.legend(fontsize=9)
    axes.set_title(title, fontsize=11)
    return figure


def backward_figure(rates: np.ndarray, published: np.ndarray, smallest: float, label: str) -> Figure:
    """Body rates at the first touchdown (paper, Fig. 12); `label` says which set of motions `rates` (n, 3) are."""
    figure = Figure(figsize=(6.5, 5.4), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    axes.scatter(*rates.T, s=6, color=COLOURS[0], alpha=0.35, lw=0, depthshade=False, label=f"{label} ({len(rates)} motions)")
    axes.scatter(*published.T, s=9, color=COLOURS[1], depthshade=False, label="the paper's lines, run back")
    axes.scatter(0, 0, 0, marker="+", s=80, color="#000000", label="no rotation")
    axes.set_xlabel(r"$\omega_x$ (rad/s)")
    axes.set_ylabel(r"$\omega_y$ (rad/s)")
    axes.set_zlabel(r"$\omega_z$ (rad/s)")
    figure.suptitle(rf"Rates at the first touchdown; smallest $|\omega|$ on the paper's lines {smallest:.4f} rad/s", fontsize=10)
    figure.legend(*axes.get_legend_handles_labels(), fontsize=9, loc="outside lower center", frameon=False)
    return figure
