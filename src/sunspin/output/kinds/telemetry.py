"""Results of the kinds `telemetry` and `sun_directions`: telemetry as read, and the Sun direction of each sample."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr

from sunspin.output.figures import ABOVE, COLOURS, ON_PAPER, axes_grid, axis_labels, styled
from sunspin.output.figures.time_axis import (
    PAUSE,
    TimeAxis,
    build_time_axis,
    find_gaps,
    label_time_axis,
)
from sunspin.output.kind import KINDS, Context, Drawing, Kind, Summary, Table
from sunspin.output.text import size_text
from sunspin.telemetry.sun import STATUS_TEXT, SunStatus, is_reconstructed

MOST_JOINED = 80
"""Number of samples up to which dotted lines connect them."""

UNKNOWN_WAY = np.radians(60.0)
"""Angle (rad) between successive Sun directions from which no line connects them, as the path in between is not known."""


def telemetry_summary(samples: Any) -> Summary:
    """Return the summary of telemetry: number of samples, their time span, how many are flagged."""
    time = samples["time"].values
    numbers: dict[str, Any] = {
        "samples": int(time.size),
        "span_s": float(np.ptp(time)) if time.size else 0.0,
        "epoch_utc": str(samples.attrs.get("epoch_utc", "")),
        "flagged": int(np.count_nonzero(samples["flag"].values)),
        "synthetic_telemetry": bool(samples.attrs.get("synthetic", 0)),
    }
    kind = "synthetic samples" if numbers["synthetic_telemetry"] else "samples"
    text = f"{numbers['samples']} {kind} over {numbers['span_s']:.0f} s from {numbers['epoch_utc']}"
    return Summary(numbers, [f"{text}; {numbers['flagged']} of them flagged"])


def telemetry_drawings(samples: Any, _: Context) -> Iterator[Drawing]:
    """Yield the figure of telemetry, if it has panels."""
    if "panel" in samples.coords:
        alt = "Signals of the panels against time."
        caption = "Signals of the panels as read."
        yield Drawing("telemetry", lambda: signals_figure(samples), alt, caption)


@styled
def signals_figure(telemetry: xr.Dataset) -> Any:
    """Draw the signals of the panels against time."""
    figure, axes = axes_grid(10, 3.8, title="Panel signals")
    time_axis = build_time_axis(telemetry["time"].values)
    _draw_signals(axes, telemetry, time_axis)
    label_time_axis(axes, telemetry, time_axis)
    return figure


def _draw_signals(axes: Any, telemetry: xr.Dataset, time_axis: TimeAxis) -> None:
    """Draw the signals of the panels into axes, with a legend above them."""
    labels_of_units = {"power_W": "power (W)", "current_A": "current (A)"}
    name = next(name for name in labels_of_units if name in telemetry)
    hours = telemetry["time"].values / 3600
    gaps = find_gaps(hours)  # a NaN before each pause breaks the line
    x = np.insert(time_axis.x(hours), gaps, np.nan)
    line = ".:" if hours.size <= MOST_JOINED else "."  # lines between many samples hide them
    labels = axis_labels(telemetry["panel"].values)
    for k, panel in enumerate(telemetry["panel"].values):
        broken = np.insert(telemetry[name].sel(panel=panel).values, gaps, np.nan)
        text = f"panel {labels[k]}"
        axes.plot(x, broken, line, ms=4, lw=0.7, color=COLOURS[k % 8], label=text)
    axes.set_ylabel(labels_of_units[name])
    # about 120 characters fit side by side; each entry has a line sample and a space besides its name
    columns = int(np.clip(120 // (max(map(len, labels), default=1) + 9), 1, 8))
    axes.legend(ncols=columns, columnspacing=0.8, handletextpad=0.2, **ABOVE)


def sun_summary(sun: Any) -> Summary:
    """Return the summary of Sun directions: how many samples give one, and why the others do not."""
    reconstructed = is_reconstructed(sun["status"])
    sigma = sun["sigma_rad"].values[reconstructed]
    numbers = {
        "samples": int(reconstructed.size),
        "reconstructed": int(reconstructed.sum()),
        "status": status_counts(sun),
        "median_sigma_deg": float(np.degrees(np.median(sigma))) if sigma.size else None,
        "noise": float(sun.attrs["noise"]),
        "noise_from": sun.attrs["noise_from"],
        "synthetic_telemetry": bool(sun.attrs.get("synthetic", 0)),
    }
    lines = [f"Sun direction determined for {reconstructed.sum()} of {reconstructed.size} samples"]
    lines += status_lines(sun)
    if numbers["median_sigma_deg"] is not None:
        size = "" if numbers["noise_from"] == "given" else f"{size_text(numbers['noise'])}, "
        noise = f"(noise: {size}{numbers['noise_from']})"
        lines.append(f"  median 1-sigma error {numbers['median_sigma_deg']:.2f} deg {noise}")
    return Summary(numbers, lines)


def status_counts(sun: Any) -> dict[str, int]:
    """Return the number of samples with each status text, the most frequent first."""
    texts, numbers = np.unique(sun["status_text"].values, return_counts=True)
    order = np.argsort(-numbers, kind="stable")
    return dict(zip(texts[order].tolist(), numbers[order].tolist(), strict=True))


def status_lines(sun: Any) -> list[str]:
    """Return the counts of :func:`status_counts` as lines."""
    return [f"  {number:6d}  {text}" for text, number in status_counts(sun).items()]


def sun_drawings(sun: Any, context: Context) -> Iterator[Drawing]:
    """Yield the figure of Sun directions, if they have times."""
    if "time" in sun.coords:
        yield Drawing(
            "sun",
            lambda: sun_directions_figure(sun, context.telemetry),
            "Panel signals, components of the direction to the Sun with error bars, and the misfit Delta of every sample against "
            "time.",
            "Panel signals; direction to the Sun in body axes, bars: one sigma; grey marks: samples that give no direction, by "
            "reason; how badly the best direction explains a sample (Delta, no unit).",
        )


@styled
def sun_directions_figure(
    sun: xr.Dataset, telemetry: xr.Dataset | None = None, events: Mapping[str, float] | None = None
) -> Any:
    """Draw panel signals (if given), components of the Sun direction, and the misfit Delta of each sample against time.

    Grey marks show samples without a direction, by reason. `events`: name -> time (s from the epoch), drawn as vertical lines.
    """
    hours = (sun["time"].values if "time" in sun.coords else np.arange(sun.sizes["time"])) / 3600
    rows, height = (2, 5.6) if telemetry is None else (3, 8.5)
    title = "Panel signals and the directions to the Sun that follow from them"
    ratios = (3, 3, 1.6)[3 - rows :]
    figure, grid = axes_grid(10, height, rows, 1, title, sharex=True, height_ratios=ratios)
    time_axis = build_time_axis(3600 * hours)
    x, direction, error = time_axis.x(hours), sun["sun_B"].values, sun["sigma_rad"].values
    has_direction = np.isfinite(direction[:, 0])
    if telemetry is not None:
        _draw_signals(grid[0], telemetry, time_axis)
    middle, low = grid[-2:]
    for k, axis in enumerate("xyz"):
        style = {"fmt": ".", "ms": 5, "lw": 0.8, "color": COLOURS[k], "label": f"$n_{axis}$"}
        middle.errorbar(
            x[has_direction], direction[has_direction, k], error[has_direction], **style
        )
    for piece in connected_stretches(hours, sun):
        for k in range(3):
            style = {"lw": 0.6, "alpha": 0.6, "color": COLOURS[k], "zorder": 1}
            middle.plot(x[piece], direction[piece, k], "-", **style)
    markers = {SunStatus.ARC: "|", SunStatus.REGION: "x", SunStatus.DARK: "v", SunStatus.RULE: "s"}
    for status in SunStatus:
        at = sun["status"].values == status
        if status not in (SunStatus.OK, SunStatus.UNCHECKED) and at.any():
            text = f"{re.split('[:(]', STATUS_TEXT[status])[0].strip()} ({at.sum()})"
            # below the components, a line for each status
            height = np.full(at.sum(), -1.1 - 0.05 * (int(status) - 2))
            marker = markers.get(status, "d")
            middle.plot(x[at], height, marker, ms=4, color=COLOURS[7], label=text)
    middle.set(ylim=(-1.5, 1.15), ylabel="Sun direction, body axes")
    middle.legend(ncols=4, fontsize=7, columnspacing=0.8, handletextpad=0.2, **ABOVE)
    status = sun["status"].values
    checked, unchecked = status == SunStatus.OK, status == SunStatus.UNCHECKED
    delta = np.maximum(sun["delta"].values, 1e-4)  # the axis is logarithmic
    low.semilogy(x[checked], delta[checked], ".", color=COLOURS[6], ms=4)
    if unchecked.any():
        text = "exactly three panels lit: always 0"
        zero = np.full(unchecked.sum(), 1e-4)
        low.plot(x[unchecked], zero, "x", color=COLOURS[7], ms=4, label=text)
        low.legend(**ABOVE)
    low.set(ylim=(5e-5, 60 if events else 1), ylabel=r"$\Delta$")  # room for the names of events
    label_time_axis(low, sun, time_axis)
    for k, (event, second) in enumerate((events or {}).items()):
        at = float(time_axis.x(np.asarray(second / 3600)))
        for axes in grid:
            axes.axvline(at, lw=0.8, color=COLOURS[6], alpha=0.6, zorder=0)
        style = {"ha": "right" if k % 2 == 0 and k else "left", "va": "center", "bbox": ON_PAPER}
        low.text(at, 20 / 4 ** (k % 3), f" {event}", fontsize=7, **style)
    return figure


def connected_stretches(hours: np.ndarray, sun: xr.Dataset) -> list[np.ndarray]:
    """Return the indices of the samples of each stretch of Sun directions that a line connects.

    A stretch ends where the phase changes, after more than `PAUSE` usual intervals, and where successive directions differ by more
    than `UNKNOWN_WAY`. A few samples without a direction do not break the line, as in the paper's figure.
    """
    with_direction = np.flatnonzero(np.isfinite(sun["sun_B"].values[:, 0]))
    direction = sun["sun_B"].values[with_direction]
    far = (direction[1:] * direction[:-1]).sum(axis=1) < np.cos(UNKNOWN_WAY)
    phase = sun["phase"].values.astype(str) if "phase" in sun.coords else np.full(hours.size, "")
    usual = float(np.median(np.diff(hours))) if hours.size > 1 else 0.0
    parted = (
        (phase[with_direction[1:]] != phase[with_direction[:-1]])
        | (np.diff(hours[with_direction]) > PAUSE * usual)
        | far
    )
    return [
        piece for piece in np.split(with_direction, np.flatnonzero(parted) + 1) if piece.size > 1
    ]


def sun_tables(sun: Any) -> Iterator[Table]:
    """Yield the table `sun`, a row for each sample: Sun direction, misfit, error, or why there is no direction."""
    import pandas as pd

    time = sun["time"].values if "time" in sun.coords else np.arange(sun.sizes["time"])
    columns = {"time_s": time}
    columns |= {f"sun_{axis}_B": sun["sun_B"].values[:, k] for k, axis in enumerate("xyz")}
    names = ("delta", "sigma_rad", "status_text", "utc", "phase")
    columns |= {name: sun[name].values for name in names if name in sun.variables}
    shown = {"time_s": "time (s)", "delta": "Delta", "sigma_rad": "error (rad)"}
    shown |= {f"sun_{axis}_B": f"Sun {axis}" for axis in "xyz"} | {"status_text": "status"}
    comment = f"time_s from {sun.attrs.get('epoch_utc')}; body axes; sigma_rad is the rms angle of the error"
    yield Table("sun", pd.DataFrame(columns), "Sun direction of each sample", shown, comment)


KINDS.update(
    telemetry=Kind("telemetry", "telemetry", telemetry_summary, telemetry_drawings),
    sun_directions=Kind("sun", "sun", sun_summary, sun_drawings, sun_tables),
)
