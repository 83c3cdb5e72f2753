"""Results of `sunspin pointing`: angles of body axes to the Sun, nadir, ram and ground stations."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from sunspin.output.figures import COLOURS, GREY, axes_grid, escape_name, styled
from sunspin.output.figures.rates import largest_passes
from sunspin.output.kind import KINDS, Context, Drawing, Kind, Summary, Table
from sunspin.output.pointing import LARGEST_SIGMA_RAD
from sunspin.output.text import (
    clock_text,
    count_text,
    range_text,
    size_text,
    start_texts,
    times_text,
)

MOST_LINES = 30
"""Number of passes that are printed; the table has all."""


def pointing_summary(data: Any) -> Summary:
    """Return the summary of a result of `pointing`: the range of each angle in each pass, deg, with its median sigma."""
    decided, pass_of = data["decided"].values.astype(bool), data["pass_of"].values
    axes, targets = (data[name].values.astype(str).tolist() for name in ("body_axis", "target"))
    count = f"{int(decided.sum())} of {decided.size} passes decided"
    lines = [
        f"angles of {', '.join(axes)} to {', '.join(targets)}, deg: range over the pass; {count}"
    ]
    begins = [float(data["time"].values[pass_of == k][0]) for k in range(decided.size)]
    passes = []
    for k, start in enumerate(start_texts(data, begins)):
        number, why = int(data["pass_id"].values[k]), str(data["why_not_decided"].values[k])
        entries: dict[str, Any] = {
            "pass_id": number,
            "start": clock_text(data, begins[k]),
            "decided": bool(decided[k]),
            "why_not_decided": why,
            "angles": [],
        }
        passes.append(entries)
        lines.append(f"pass {number}  {start}")
        if not decided[k]:
            lines[-1] += f"  not decided ({why}): no angles"
            continue
        of_pass = data.isel(time=pass_of == k)
        for i, axis in enumerate(axes):
            texts = []
            for j, target in enumerate(targets):
                numbers, text = _angle_numbers(of_pass, i, j)
                entries["angles"].append({"axis": axis, "target": target} | numbers)
                texts.append(f"{target} {text}")
            lines.append(f"  {axis}: {'; '.join(texts)}")
        lines += _visibility_lines(of_pass, entries)
    numbers = {
        "vehicle": data.attrs["vehicle"],
        "axes": axes,
        "targets": targets,
        "stations": str(data.attrs["stations"]).split("; ") if data.attrs["stations"] else [],
        "decided": int(decided.sum()),
        "passes": passes,
        "synthetic_telemetry": bool(data.attrs.get("synthetic")),
    }
    printed = 1 + MOST_LINES * (1 + len(axes))
    notes = (
        [f"  and {len(lines) - printed} more lines: --out writes the table"]
        if len(lines) > printed
        else []
    )
    if data.attrs["columns_unchecked"]:
        notes.append(
            "columns unchecked: the angles hold if columns and signs of the vehicle file are right; `rates` names those that it "
            "cannot check"
        )
    if data.attrs["sun_only"]:
        notes.append(f"only the angle to the Sun is given: {data.attrs['sun_only']}")
    return Summary(numbers, lines[:printed], notes)


def _angle_numbers(of_pass: Any, axis: int, target: int) -> tuple[dict[str, Any], str]:
    """Return range and median sigma (deg) of an angle in one pass, and the same in words."""
    angle, sigma = (
        np.degrees(of_pass[name].values[axis, target])
        for name in ("pointing_angle", "pointing_sigma")
    )
    given, median = np.isfinite(angle), float(np.median(sigma))
    numbers: dict[str, Any] = {"samples": int(given.sum()), "sigma_deg": median}
    if not given.any():
        return numbers | {
            "low_deg": None,
            "high_deg": None,
        }, f"not known (± {size_text(median, 2)})"
    low, high = float(angle[given].min()), float(angle[given].max())
    text = f"{range_text(low, high, median)} (± {size_text(median, 2)})"
    if not given.all():
        text += f" at {int(given.sum())} of {count_text(given.size, 'sample')}"
    return numbers | {"low_deg": low, "high_deg": high}, text


def _visibility_lines(of_pass: Any, entries: dict[str, Any]) -> list[str]:
    """Return a line for each station on the spacecraft's elevation; add the numbers to `entries`."""
    lines = []
    for k, name in enumerate(
        of_pass["station"].values.astype(str) if "station" in of_pass.coords else ()
    ):
        elevation = np.degrees(of_pass["station_elevation"].values[k])
        above = int((elevation > 0).sum())
        entries.setdefault("elevation_deg", {})[name] = float(elevation.max())
        text = "always below the horizon"
        if above:
            count = count_text(elevation.size, "sample")
            text = f"above the horizon in {above} of {count}, highest {elevation.max():.0f} deg"
        lines.append(f"  {name}: {text}")
    return lines


def pointing_drawings(data: Any, _: Context) -> Iterator[Drawing]:
    """Yield the figure of the angles against time; none if no pass is decided."""
    if not data["decided"].values.any():
        return
    shown, passes = len(largest_passes(data)), data.sizes["pass_id"]
    chosen = f" Shown are the {shown} of {passes} passes with the most samples."
    yield Drawing(
        "pointing",
        lambda: pointing_figure(data),
        "Angles of body axes to the Sun, nadir, ram and stations against time in each pass, with bars of one sigma.",
        "Dots: times of the table, with one sigma; lines: the estimated motion between them. Passes that are not decided are empty."
        + (chosen if shown < passes else ""),
    )


@styled
def pointing_figure(data: Any) -> Any:
    """Draw the angles (deg) of each body axis, a row, in the passes with the most samples, a column each."""
    passes, axes_names = largest_passes(data), data["body_axis"].values.astype(str)
    title = f"Pointing of {escape_name(data.attrs['vehicle'])}"
    size = max(7.5, 2.1 * len(passes)), 1.2 + 2.4 * len(axes_names)
    layout = {"sharey": True, "sharex": "col", "squeeze": False}
    figure, grid = axes_grid(*size, len(axes_names), len(passes), title, **layout)
    for column, number in zip(grid.T, passes, strict=True):
        inside = data["pass_of"].values == number
        t = data["time"].values[inside]
        column[0].set_title(clock_text(data, t[0]), fontsize=8)
        column[-1].set_xlabel("time (min)")
        for i, axes in enumerate(column):
            _draw_angles(axes, data, number, i, t[0])
            if not data["decided"].values[number]:
                axes.text(
                    0.5, 0.5, "not decided", ha="center", color=GREY, transform=axes.transAxes
                )
    for name, row in zip(axes_names, grid, strict=True):
        row[0].set(ylabel=f"angle of {name} (deg)", ylim=(0, 180), yticks=range(0, 181, 45))
    handles = {}
    for axes in grid.flat:
        handles |= dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=5)
    return figure


def _draw_angles(axes: Any, data: Any, number: int, i: int, begin: float) -> None:
    """Draw the angles of body axis number `i` to all targets in one pass."""
    inside = data["pass_of"].values == number
    minutes = (data["time"].values[inside] - begin) / 60
    for j, target in enumerate(data["target"].values.astype(str)):
        colour = COLOURS[j % 6]
        angle, sigma = (
            np.degrees(data[name].values[i, j, inside])
            for name in ("pointing_angle", "pointing_sigma")
        )
        known = np.isfinite(angle)
        if known.any():
            style = {"fmt": ".", "ms": 4, "lw": 0.8, "color": colour, "label": target}
            axes.errorbar(minutes[known], angle[known], sigma[known], **style)
        if "curve_pointing_angle" in data:
            on_curve = data["curve_pass_of"].values == number
            t = (data["curve_time"].values[on_curve] - begin) / 60
            axes.plot(
                t,
                np.degrees(data["curve_pointing_angle"].values[i, j, on_curve]),
                lw=0.8,
                color=colour,
            )


def pointing_tables(data: Any) -> Iterator[Table]:
    """Yield the table `pointing`: a row for each sample and body axis, angles and errors in deg."""
    pass_of, decided = data["pass_of"].values, data["decided"].values.astype(bool)
    why = data["why_not_decided"].values.astype(str)
    frames = []
    too_large = f"error above {np.degrees(LARGEST_SIGMA_RAD):.0f} deg"
    for i, axis in enumerate(data["body_axis"].values.astype(str)):
        columns: dict[str, Any] = {
            "time_s": data["time"].values,
            "utc": times_text(data),
            "pass_id": data["pass_id"].values[pass_of],
            "decided": decided[pass_of],
            "axis": axis,
        }
        for j, target in enumerate(data["target"].values.astype(str)):
            columns[f"{target}_angle_deg"] = np.degrees(data["pointing_angle"].values[i, j])
            columns[f"{target}_angle_sigma_deg"] = np.degrees(data["pointing_sigma"].values[i, j])
        for k, name in enumerate(
            data["station"].values.astype(str) if "station" in data.coords else ()
        ):
            columns[f"{name}_elevation_deg"] = np.degrees(data["station_elevation"].values[k])
            columns[f"{name}_range_km"] = data["station_range"].values[k] / 1e3
        without = ~np.isfinite(data["pointing_angle"].values[i]).any(axis=0)
        columns["why_no_angle"] = np.where(decided[pass_of] & without, too_large, why[pass_of])
        frames.append(pd.DataFrame(columns))
    frame = pd.concat(frames).sort_values("time_s", kind="stable", ignore_index=True)
    headings = {"utc": "UTC", "axis": "axis"}
    for target in data["target"].values.astype(str):
        headings |= {f"{target}_angle_deg": f"{target}, deg", f"{target}_angle_sigma_deg": "±"}
    for name in data["station"].values.astype(str) if "station" in data.coords else ():
        headings |= {f"{name}_elevation_deg": f"elevation at {name}, deg"}
    limit = np.degrees(LARGEST_SIGMA_RAD)
    comment = (
        f"angles between body axis and direction to the target; one sigma; empty if the pass is not decided or the error exceeds "
        f"{limit:.0f} deg"
    )
    yield Table("pointing", frame, "Angles of body axes", headings, comment=comment)


_pointing = (pointing_summary, pointing_drawings, pointing_tables)
KINDS.update(pointing=Kind("pointing", "pointing", *_pointing))
