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

NO_MISFIT = 1e-4
"""Value at which smaller misfits Delta are drawn on their logarithmic axis; that of a direction from three panels is 0."""

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
    """Draw the signals of the panels into axes, powers or currents, with a legend above them."""
    axis_titles = {"power_W": "power (W)", "current_A": "current (A)"}
    name = next(name for name in axis_titles if name in telemetry)
    hours = telemetry["time"].values / 3600
    gaps = find_gaps(hours)  # a NaN before each pause breaks the line
    x = np.insert(time_axis.x(hours), gaps, np.nan)
    line = ".:" if hours.size <= MOST_JOINED else "."  # lines between many samples hide them
    labels = axis_labels(telemetry["panel"].values)
    for k, panel in enumerate(telemetry["panel"].values):
        signal = np.insert(telemetry[name].sel(panel=panel).values, gaps, np.nan)
        label = f"panel {labels[k]}"
        axes.plot(x, signal, line, ms=4, lw=0.7, color=COLOURS[k % 8], label=label)
    is_angle = telemetry[name].attrs.get("units") == "1"
    axes.set_ylabel("gain × cosine" if is_angle else axis_titles[name])
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
        source = numbers["noise_from"]
        # the size of a given noise is in the vehicle file, maybe one for each panel
        size = f"{size_text(numbers['noise'])} {sun.attrs.get('noise_unit', '')}".strip()
        noise = source if source == "given" else f"{size}, {source}"
        lines.append(
            f"  median 1-sigma error {numbers['median_sigma_deg']:.2f} deg (noise: {noise})"
        )
    return Summary(numbers, lines)


def status_counts(sun: Any) -> dict[str, int]:
    """Return the number of samples with each status text, the most frequent first."""
    texts, counts = np.unique(sun["status_text"].values, return_counts=True)
    by_frequency = np.argsort(-counts, kind="stable")
    return dict(zip(texts[by_frequency].tolist(), counts[by_frequency].tolist(), strict=True))


def status_lines(sun: Any) -> list[str]:
    """Return the counts of :func:`status_counts` as lines."""
    return [f"  {count:6d}  {text}" for text, count in status_counts(sun).items()]


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
    ratios = (3, 3, 1.6)[-rows:]  # of signals, if drawn, directions and misfit
    figure, grid = axes_grid(10, height, rows, 1, title, sharex=True, height_ratios=ratios)
    time_axis = build_time_axis(3600 * hours)
    x = time_axis.x(hours)
    if telemetry is not None:
        _draw_signals(grid[0], telemetry, time_axis)
    sun_axes, misfit_axes = grid[-2:]
    _draw_directions(sun_axes, sun, x, connected_stretches(hours, sun))
    _draw_misfits(misfit_axes, sun, x)
    top = 60 if events else 1  # room for the names of events
    misfit_axes.set(ylim=(5e-5, top), ylabel=r"$\Delta$")
    label_time_axis(misfit_axes, sun, time_axis)
    for k, (event, second) in enumerate((events or {}).items()):
        place = float(time_axis.x(np.asarray(second / 3600)))
        for axes in grid:
            axes.axvline(place, lw=0.8, color=COLOURS[6], alpha=0.6, zorder=0)
        # names at three heights, and on alternating sides of their lines, overlap less; the first is at the left edge
        side = "right" if k % 2 == 0 and k > 0 else "left"
        style = {"ha": side, "va": "center", "bbox": ON_PAPER}
        misfit_axes.text(place, 20 / 4 ** (k % 3), f" {event}", fontsize=7, **style)
    return figure


def _draw_directions(
    axes: Any, sun: xr.Dataset, x: np.ndarray, stretches: list[np.ndarray]
) -> None:
    """Draw the components of the Sun direction with one sigma, and grey marks for samples without one, by status.

    `x`: positions (n) of the samples on the time axis; `stretches`: indices of the samples that a line connects.
    """
    direction, error = sun["sun_B"].values, sun["sigma_rad"].values
    has_direction = np.isfinite(direction[:, 0])
    for k, axis in enumerate("xyz"):
        style = {"fmt": ".", "ms": 5, "lw": 0.8, "color": COLOURS[k], "label": f"$n_{axis}$"}
        axes.errorbar(x[has_direction], direction[has_direction, k], error[has_direction], **style)
    for samples in stretches:
        for k in range(3):
            style = {"lw": 0.6, "alpha": 0.6, "color": COLOURS[k], "zorder": 1}
            axes.plot(x[samples], direction[samples, k], "-", **style)
    markers = {SunStatus.ARC: "|", SunStatus.REGION: "x", SunStatus.DARK: "v", SunStatus.RULE: "s"}
    for status in SunStatus:
        at = sun["status"].values == status
        if status not in (SunStatus.OK, SunStatus.UNCHECKED) and at.any():
            # the begin of the text, without its explanation
            label = f"{re.split('[:(]', STATUS_TEXT[status])[0].strip()} ({at.sum()})"
            # below the components, a line for each status; those without direction count from 2
            height = np.full(at.sum(), -1.1 - 0.05 * (int(status) - 2))
            marker = markers.get(status, "d")
            axes.plot(x[at], height, marker, ms=4, color=COLOURS[7], label=label)
    axes.set(ylim=(-1.5, 1.15), ylabel="Sun direction, body axes")
    axes.legend(ncols=4, fontsize=7, columnspacing=0.8, handletextpad=0.2, **ABOVE)


def _draw_misfits(axes: Any, sun: xr.Dataset, x: np.ndarray) -> None:
    """Draw the misfit Delta of each sample with a direction on a logarithmic axis, at positions `x` (n) of the samples.

    A direction from exactly three panels has no misfit to check; grey crosses mark it.
    """
    status = sun["status"].values
    checked, unchecked = status == SunStatus.OK, status == SunStatus.UNCHECKED
    delta = np.maximum(sun["delta"].values, NO_MISFIT)
    axes.semilogy(x[checked], delta[checked], ".", color=COLOURS[6], ms=4)
    if unchecked.any():
        label = "exactly three panels lit: always 0"
        zero = np.full(unchecked.sum(), NO_MISFIT)
        axes.plot(x[unchecked], zero, "x", color=COLOURS[7], ms=4, label=label)
        axes.legend(**ABOVE)


def connected_stretches(hours: np.ndarray, sun: xr.Dataset) -> list[np.ndarray]:
    """Return the indices of the samples of each stretch of Sun directions that a line connects.

    A stretch ends where the phase changes, after more than `PAUSE` usual intervals, and where successive directions differ by more
    than `UNKNOWN_WAY`. A few samples without a direction do not break the line, as in the paper's figure.
    """
    with_direction = np.flatnonzero(np.isfinite(sun["sun_B"].values[:, 0]))
    direction = sun["sun_B"].values[with_direction]
    far = (direction[1:] * direction[:-1]).sum(axis=1) < np.cos(UNKNOWN_WAY)
    phase = sun["phase"].values.astype(str) if "phase" in sun.coords else np.full(hours.size, "")
    usual_interval = float(np.median(np.diff(hours))) if hours.size > 1 else 0.0
    separated = (
        (phase[with_direction[1:]] != phase[with_direction[:-1]])
        | (np.diff(hours[with_direction]) > PAUSE * usual_interval)
        | far
    )
    stretches = np.split(with_direction, np.flatnonzero(separated) + 1)
    return [samples for samples in stretches if samples.size > 1]


def sun_tables(sun: Any) -> Iterator[Table]:
    """Yield the table `sun`, a row for each sample: Sun direction, misfit, error, or why there is no direction."""
    import pandas as pd

    time = sun["time"].values if "time" in sun.coords else np.arange(sun.sizes["time"])
    columns = {"time_s": time}
    columns |= {f"sun_{axis}_B": sun["sun_B"].values[:, k] for k, axis in enumerate("xyz")}
    names = ("delta", "sigma_rad", "status_text", "utc", "phase")
    columns |= {name: sun[name].values for name in names if name in sun.variables}
    headings = {"time_s": "time (s)", "delta": "Delta", "sigma_rad": "error (rad)"}
    headings |= {f"sun_{axis}_B": f"Sun {axis}" for axis in "xyz"} | {"status_text": "status"}
    comment = f"time_s from {sun.attrs.get('epoch_utc')}; body axes; sigma_rad is the rms angle of the error"
    yield Table("sun", pd.DataFrame(columns), "Sun direction of each sample", headings, comment)


KINDS.update(
    telemetry=Kind("telemetry", "telemetry", telemetry_summary, telemetry_drawings),
    sun_directions=Kind("sun", "sun", sun_summary, sun_drawings, sun_tables),
)
