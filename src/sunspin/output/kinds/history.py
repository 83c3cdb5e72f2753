"""Results of `sunspin history`: many passes of one satellite against time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sunspin.output.figures import BLACK, COLOURS, GREY, axes_grid, escape_name, styled
from sunspin.output.history import DAY_S
from sunspin.output.kind import KINDS, Context, Drawing, Kind, Summary, Table
from sunspin.output.text import signed_text, with_sigma

LARGEST_AXIS_SIGMA_RAD = 1.0
"""A spin axis with a larger error is not shown: the errors of an axis that is not known at all are 1 to 2 rad."""

MOST_LINES = 30
"""Number of passes that are printed; the table has all."""


def history_summary(data: Any) -> Summary:
    """Return the summary of a history: number of passes, trend, jumps, and a line for each pass."""
    attrs, decided = data.attrs, data["decided"].values
    speed, sigma = np.degrees(data["speed_median"]).values, np.degrees(data["speed_sigma"]).values
    trend, error = np.degrees([attrs["trend"], attrs["trend_sigma"]]).tolist()
    numbers: dict[str, Any] = {
        "vehicle": attrs["vehicle"],
        "results": int(attrs["results"]),
        "passes": int(decided.size),
        "decided": int(decided.sum()),
        "from": str(data["utc_at"].values[0]),
        "to": str(data["utc_at"].values[-1]),
        "synthetic_telemetry": bool(attrs["synthetic"]),
        "trend_deg_s_day": trend if np.isfinite(trend) else None,
        "trend_sigma_deg_s_day": error if np.isfinite(error) else None,
        "jumps": attrs["jumps"].splitlines(),
        "vehicles_differ": attrs["vehicles_differ"],
    }
    passes = "1 pass" if decided.size == 1 else f"{decided.size} passes"
    lines = [
        f"{attrs['vehicle']}: {passes} from {numbers['from'][:16]} to {numbers['to'][:16]} UTC, "
        f"{decided.sum()} decided"
    ]
    if numbers["trend_deg_s_day"] is None:
        lines.append("trend of the speed: not determined (it takes at least five decided passes)")
    else:
        lines.append(_trend_text(trend, error, float(speed[decided][-1])))
        lines += _gap_lines(data["time"].values[decided] / DAY_S)
    if differ := attrs["vehicles_differ"]:
        lines.append(
            f"VEHICLE FILES DIFFER in panels or inertia: {differ}. If they are of two satellites, give the results of one"
        )
    lines += [f"JUMP of the speed before {jump}" for jump in numbers["jumps"]]
    for k in range(min(decided.size, MOST_LINES)):
        axis, turn = data["spin_axis_B"].values[k], data["spin_axis_sigma_rad"].values[k]
        size = with_sigma(speed[k], sigma[k], "deg/s")
        about = "({:+.2f}, {:+.2f}, {:+.2f})".format(*axis) + f" ± {np.degrees(turn):.1f} deg"
        if not turn <= LARGEST_AXIS_SIGMA_RAD:
            about = "an unknown axis"
        verdict = "" if decided[k] else f"  not decided: {data['why_not_decided'].values[k]}"
        lines.append(f"  {data['utc_at'].values[k][:16]}  {size}  about {about}{verdict}")
    rest = decided.size - MOST_LINES
    notes = [f"  and {rest} more passes: --out writes the whole table"] if rest > 0 else []
    if not np.isfinite(data["momentum"]).any():
        notes.append("momentum: not determined (no inertia in the vehicle file, or a wheel)")
    return Summary(numbers, lines, notes)


def _trend_text(trend: float, error: float, latest: float) -> str:
    """Return the trend (deg/s per day) with its error in words; `latest` is the speed of the last decided pass in deg/s."""
    size = f"trend of the speed: {signed_text(trend, error, 'deg/s per day')}"
    if abs(trend) < 2 * error:
        return f"{size} (within two sigma of none)"
    if trend < 0:
        half = f"{latest / (2 * -trend):.3g} days after the last decided pass"
        return f"{size}: it slows down, by half in {half} at this pace"
    twice = f"{latest / trend:.3g} days after the last decided pass"
    return f"{size}: it spins up, to twice its speed in {twice} at this pace"


def _gap_lines(days: np.ndarray) -> list[str]:
    """Return a sentence if one gap between decided passes at times (n), days, takes more than half of all days; else none.

    The trend is then the difference of the speeds on both sides, and how the speed wandered in between is not known.
    """
    gap, span = float(np.diff(days).max()), float(np.ptp(days))
    if gap <= span / 2:
        return []
    return [
        f"  the trend rests on a gap of {gap:.3g} of {span:.3g} days without a decided pass: a jump or a slow change in it would "
        "look the same, and the error of the trend does not count it"
    ]


def history_drawings(data: Any, _: Context) -> Iterator[Drawing]:
    """Yield the figure of speed, spin axis and momentum against time."""
    caption = (
        "Each point is a pass; open points are not decided and do not count in the trend. Bars are one sigma; directions of the "
        "momentum have none, and the inertia is taken as exact. The grey line is the trend with its jumps. The second panel shows "
        "the components of the unit vector along the rate at mid-pass, in body axes. Directions are left out if the error of the "
        f"spin axis exceeds {np.degrees(LARGEST_AXIS_SIGMA_RAD):.0f} degrees."
    )
    yield Drawing(
        "history",
        lambda: history_figure(data),
        "Speed, direction of the spin axis in the body and angular momentum of each pass against time.",
        caption,
    )


@styled
def history_figure(data: Any) -> Any:
    """Draw speed and spin axis, and where they are known the size and the direction of the angular momentum, against time."""
    days, decided = data["time"].values / DAY_S, data["decided"].values
    has_momentum = bool(np.isfinite(data["momentum"]).any())
    has_sun = bool(np.isfinite(data["momentum_sun_rad"]).any())
    in_space = bool(np.isfinite(data["momentum_J2000"]).any())
    rows = 2 + has_momentum + has_sun + in_space
    title = f"History of {escape_name(data.attrs['vehicle'])}"
    figure, grid = axes_grid(9.0, 1.2 + 1.9 * rows, rows=rows, title=title, sharex=True)
    panels = iter(grid)
    axes = next(panels)
    speed, sigma = np.degrees(data["speed_median"]).values, np.degrees(data["speed_sigma"]).values
    _draw_points(axes, days, speed, sigma, decided, BLACK, "speed")
    _draw_trend(axes, data, days)
    axes.set_ylabel("speed (deg/s)")
    axes.set_ylim(0.0, 1.1 * float(np.nanmax(speed + sigma)))
    axes = next(panels)
    turn = data["spin_axis_sigma_rad"].values
    known = turn <= LARGEST_AXIS_SIGMA_RAD
    for k, name in enumerate("xyz"):
        values = np.where(known, data["spin_axis_B"].values[:, k], np.nan)
        error = turn * np.sqrt(np.maximum(1 - values**2, 0.0))  # largest change by such a turn
        _draw_points(axes, days, values, error, decided, COLOURS[k], name)
    axes.set(ylabel="spin axis in the\nbody (unit vector)", ylim=(-1.1, 1.1))
    axes.legend(ncols=3, loc="upper right", bbox_to_anchor=(1.0, 1.2))
    no_error = np.zeros(len(days))
    if has_momentum:
        axes = next(panels)
        size, error = data["momentum"].values, data["momentum_sigma"].values
        _draw_points(axes, days, size, error, decided, BLACK, "momentum")
        axes.set_ylabel("angular momentum\n(N m s)")
        axes.set_ylim(bottom=max(0.0, axes.get_ylim()[0]))
    if has_sun:
        axes = next(panels)
        angle = np.where(known, np.degrees(data["momentum_sun_rad"].values), np.nan)
        _draw_points(axes, days, angle, no_error, decided, BLACK, "angle")
        axes.set(ylabel="momentum to the\nSun (deg)", ylim=(0, 180))
    if in_space:
        axes = next(panels)
        for k, name in enumerate("xyz"):
            values = np.where(known, data["momentum_J2000"].values[:, k], np.nan)
            _draw_points(axes, days, values, no_error, decided, COLOURS[k], name)
        axes.set(ylabel="momentum in J2000\n(unit vector)", ylim=(-1.1, 1.1))
    axes.set_xlabel(f"time (days) since {data.attrs['epoch_utc'][:16]} UTC")
    return figure


def _draw_points(
    axes: Any,
    days: np.ndarray,
    values: np.ndarray,
    error: np.ndarray,
    decided: np.ndarray,
    colour: str,
    label: str,
) -> None:
    """Draw a point for each pass with its error: filled if the pass is decided, else open and pale."""
    for mask, style in ((decided, {}), (~decided, {"mfc": "none", "alpha": 0.6})):
        if mask.any():
            # one entry in the legend, also without a decided pass
            name = label if mask is decided or not decided.any() else None
            size = {"fmt": "o", "ms": 3.5, "lw": 0.8}
            point = days[mask], values[mask], error[mask]
            axes.errorbar(*point, color=colour, label=name, **size, **style)


def _draw_trend(axes: Any, data: Any, days: np.ndarray) -> None:
    """Draw the trend through the decided passes, in pieces between the jumps, each at the mean of its passes."""
    slope = data.attrs["trend"]
    if not np.isfinite(slope):
        return
    decided = data["decided"].values
    edges = [
        float(np.searchsorted(data["utc_at"].values, line[:16].replace(" ", "T")))
        for line in data.attrs["jumps"].splitlines()
    ]
    piece = np.searchsorted(edges, np.arange(len(days)), side="right")
    for k in np.unique(piece):
        inside = (piece == k) & decided
        if inside.sum() > 1:
            t = days[inside]
            level = float(np.mean(data["speed_median"].values[inside] - slope * t))
            ends = np.array([t[0], t[-1]])
            axes.plot(ends, np.degrees(level + slope * ends), color=GREY, lw=1.5, zorder=0)


def history_tables(data: Any) -> Iterator[Table]:
    """Yield the table of all passes."""
    names = ["utc_at", "decided", "probability", "samples", "why_not_decided", "folder"]
    frame = data[names].to_dataframe().reset_index(drop=True)
    for name in ("speed_median", "speed_sigma", "speed_low", "speed_high"):
        frame[f"{name}_deg_s"] = np.degrees(data[name].values)
    for k, axis in enumerate("xyz"):
        frame[f"omega_{axis}_deg_s"] = np.degrees(data["omega_B"].values[:, k])
        frame[f"sigma_{axis}_deg_s"] = np.degrees(data["omega_sigma_B"].values[:, k])
        frame[f"spin_axis_{axis}"] = data["spin_axis_B"].values[:, k]
    frame["spin_axis_sigma_deg"] = np.degrees(data["spin_axis_sigma_rad"].values)
    frame["momentum_N_m_s"] = data["momentum"].values
    frame["momentum_sigma_N_m_s"] = data["momentum_sigma"].values
    frame["momentum_sun_deg"] = np.degrees(data["momentum_sun_rad"].values)
    for k, axis in enumerate("xyz"):
        frame[f"momentum_J2000_{axis}"] = data["momentum_J2000"].values[:, k]
    headings = {
        "utc_at": "UTC at mid-pass",
        "decided": "decided",
        "speed_median_deg_s": "speed, deg/s",
        "speed_sigma_deg_s": "one sigma, deg/s",
        "spin_axis_x": "spin axis x",
        "spin_axis_y": "y",
        "spin_axis_z": "z",
        "spin_axis_sigma_deg": "its error, deg",
    }
    yield Table("history", frame, "Passes", headings)


_history = (history_summary, history_drawings, history_tables)
KINDS.update(history=Kind("history", "history", *_history))
