"""Telemetry: signals of the panels, directions to the Sun that they give, gains and health of the panels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from sunspin.output.figures import ABOVE, COLOURS, ON_PAPER, named, titled
from sunspin.telemetry.sun import STATUS_TEXT, SunStatus

MOST_JOINED = 80
"""Samples up to which dotted lines connect them."""

APART = 0.6
"""Part of the whole time, in pauses, from which the pauses are drawn shorter."""

SHORT_H = 1.5
"""Shorter records have an axis in minutes."""

PAUSE_WIDTH, MOST_TICKS = 0.04, 12
"""A shortened pause is this part of all passes together; at most so many passes are named on the axis."""

PAUSE = 10
"""Steps between samples after which no line connects them."""

TURNED = np.radians(60.0)
"""Angle between directions beyond which no line connects them."""


def signals_figure(telemetry: xr.Dataset) -> Figure:
    """Signals of the panels against time."""
    figure = Figure(figsize=(10, 3.8), layout="constrained")
    axes = figure.subplots()
    place = _passes_together(telemetry["time"].values)
    _signals(axes, telemetry, place)
    _time_axis(axes, telemetry, place)
    axes.set_title(titled("Panel signals", telemetry.attrs.get("synthetic")), loc="left")
    return figure


def gains_figure(quality: xr.Dataset) -> Figure:
    """Gain of each panel with one sigma; dead panels crossed."""
    figure = Figure(figsize=(7, 3.6), layout="constrained")
    axes = figure.subplots()
    place = np.arange(quality.sizes["panel"])
    gain, dead = quality["gain"].values, quality["dead"].values.astype(bool)
    axes.errorbar(
        place, gain, yerr=quality["gain_sigma"].values, fmt="o", color=COLOURS[0], capsize=3
    )
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
            axes.axvline(
                place,
                color=COLOURS[1],
                lw=1.4,
                ls="--",
                label="its loss explains them" if k == 0 else None,
            )
    axes.set_yticks(range(len(lit)), [f"{n} samples" for n in health["samples"].values])
    axes.set_xticks(range(lit.shape[1]), [named(name) for name in health["panel"].values])
    axes.set(
        xlabel="panel",
        xlim=(-0.6, lit.shape[1] - 0.4),
        ylim=(len(lit) - 0.4, -0.6) if len(lit) else (1, 0),
    )
    handles, labels = axes.get_legend_handles_labels()
    shown = dict(zip(labels, handles, strict=True))
    if shown:
        axes.legend(shown.values(), shown.keys(), ncols=2, fontsize=9, **ABOVE)
    title = (
        "Lit together, which the Sun alone cannot do"
        if len(lit)
        else "Nothing was lit that the Sun cannot light"
    )
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
    parts = figure.subplots(
        3 if telemetry is not None else 2,
        1,
        sharex=True,
        height_ratios=(3, 3, 1.6)[0 if telemetry is not None else 1 :],
    )
    middle, low = parts[-2:]
    place = _passes_together(3600 * hours)
    x = place.x(hours)
    told = np.isfinite(sun["sun_B"].values[:, 0])
    error = sun["sigma_rad"].values
    if telemetry is not None:
        _signals(parts[0], telemetry, place)
    figure.suptitle(
        titled(
            "Panel signals and the directions to the Sun that follow from them",
            sun.attrs.get("synthetic"),
        )
    )
    for k, axis in enumerate("xyz"):
        middle.errorbar(
            x[told],
            sun["sun_B"].values[told, k],
            yerr=error[told],
            fmt=".",
            ms=5,
            lw=0.8,
            color=COLOURS[k],
            label=f"$n_{axis}$",
        )
    for piece in _connected(hours, sun):
        for k in range(3):
            middle.plot(
                x[piece],
                sun["sun_B"].values[piece, k],
                "-",
                lw=0.6,
                alpha=0.6,
                color=COLOURS[k],
                zorder=1,
            )
    _mark_reasons(middle, x, sun)
    middle.set_ylim(-1.5, 1.15)
    middle.set_ylabel("Sun direction, body axes")
    middle.legend(ncols=4, fontsize=7, columnspacing=0.8, handletextpad=0.2, **ABOVE)
    checked, unchecked = (
        sun["status"].values == status for status in (SunStatus.OK, SunStatus.UNCHECKED)
    )
    low.semilogy(
        x[checked], np.maximum(sun["delta"].values[checked], 1e-4), ".", color=COLOURS[6], ms=4
    )
    low.plot(
        x[unchecked],
        np.full(unchecked.sum(), 1e-4),
        "x",
        color=COLOURS[7],
        ms=4,
        label="exactly three panels lit: 0 whatever the powers",
    )
    low.set_ylim(5e-5, 60 if events else 1)  # room for the names of events
    if unchecked.any():
        low.legend(fontsize=8, **ABOVE)
    low.set_ylabel(r"$\Delta$")
    _time_axis(low, sun, place)
    for k, (event, second) in enumerate((events or {}).items()):
        at = float(place.x(np.asarray(second / 3600)))
        for axes in parts:
            axes.axvline(at, lw=0.8, color=COLOURS[6], alpha=0.6, zorder=0)
        low.text(
            at,
            20 / 4 ** (k % 3),
            f" {event}",
            fontsize=7,
            va="center",
            ha="right" if k % 2 == 0 and k else "left",
            bbox=ON_PAPER,
        )
    return figure


def _signals(axes: Any, telemetry: xr.Dataset, place: Passes) -> None:
    name = "power_W" if "power_W" in telemetry else "current_A"
    values, hours = telemetry[name], telemetry["time"].values / 3600
    gaps, x = _long_gaps(hours), place.x(hours)
    line = ".:" if hours.size <= MOST_JOINED else "."  # lines between many samples hide them
    for k, panel in enumerate(values["panel"].values):
        broken = np.insert(values.sel(panel=panel).values, gaps, np.nan)
        axes.plot(
            np.insert(x, gaps, np.nan),
            broken,
            line,
            ms=4,
            lw=0.7,
            color=COLOURS[k % 8],
            label=f"panel {named(panel)}",
        )
    axes.set_ylabel("power (W)" if name == "power_W" else "current (A)")
    axes.legend(ncols=8, fontsize=8, columnspacing=0.8, handletextpad=0.2, **ABOVE)


class Passes(NamedTuple):
    """Where times stand on an axis: `hours` of passes' ends -> `places`; both empty where time runs evenly, in h or in min."""

    hours: np.ndarray
    places: np.ndarray
    in_min: bool = False

    def x(self, hours: np.ndarray) -> np.ndarray:
        """Places of times (h)."""
        return (
            np.interp(hours, self.hours, self.places)
            if self.hours.size
            else hours * (60 if self.in_min else 1)
        )


def _passes_together(time_s: np.ndarray) -> Passes:
    """An axis on which passes that lie far apart stand side by side."""
    hours = np.sort(np.asarray(time_s, dtype=np.float64)) / 3600
    cuts = _long_gaps(hours)
    pauses = hours[cuts] - hours[cuts - 1]
    whole = float(np.ptp(hours)) if hours.size else 0.0
    if not cuts.size or pauses.sum() < APART * whole:
        return Passes(np.zeros(0), np.zeros(0), whole < SHORT_H)
    ends = np.stack(
        [np.insert(hours[cuts], 0, hours[0]), np.append(hours[cuts - 1], hours[-1])], axis=1
    )
    lengths = np.maximum(ends[:, 1] - ends[:, 0], 1e-6)
    begins = np.cumsum(lengths + PAUSE_WIDTH * lengths.sum()) - lengths
    return Passes(
        ends.ravel() + np.tile([0.0, 1e-9], len(ends)),
        np.stack([begins, begins + lengths], axis=1).ravel(),
    )


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
    utc = [
        str(epoch + np.timedelta64(round(3600 * h), "s"))[5:16].replace("T", "\n")
        for h in begins[shown].tolist()
    ]
    axes.set_xticks(at[shown], utc, fontsize=8)
    for end, begin in zip(place.places[1:-1:2], place.places[2::2], strict=True):
        axes.axvspan(end, begin, color=COLOURS[7], alpha=0.12, lw=0, zorder=0)
    longest = 60 * float(np.diff(place.hours.reshape(-1, 2), axis=1).max())
    axes.set_xlabel(
        f"UTC at which each pass begins (the longest is {longest:.3g} min; grey: pauses, shortened)"
    )


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
        axes.plot(
            hours[at],
            height,
            markers.get(status, "d"),
            ms=4,
            color=COLOURS[7],
            label=f"{text} ({at.sum()})",
        )
