"""Results of `sunspin plan`: which beacon decides which rates."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sunspin.output.figures import BLACK, COLOURS, axes_grid, escape_name, styled
from sunspin.output.kind import KINDS, Context, Drawing, Kind, Summary, Table


def plan_summary(data: Any) -> Summary:
    """Return the summary of a plan: a line for each interval and class of speeds."""
    attrs = data.attrs
    numbers: dict[str, Any] = {
        "vehicle": attrs["vehicle"],
        "samples": int(attrs["samples"]),
        "max_rate_deg_s": float(np.degrees(attrs["max_rate_rad_s"])),
        "bits": int(attrs["bits"]) or None,
        "in_orbit": bool(attrs["in_orbit"]),
        "seed": int(attrs["seed"]),
        "interrupted": bool(attrs["interrupted"]),
        "synthetic_telemetry": True,
        "beacons": _cells(data),
    }
    passes = int(data["passes"].values.sum())
    lines = [
        f"{attrs['vehicle']}: {passes} simulated pass{'' if passes == 1 else 'es'} of {attrs['samples']} samples, "
        f"speeds up to {numbers['max_rate_deg_s']:g} deg/s"
    ]
    table = [
        f"  {'every':>7}  {'speed, deg/s':>13}  {'passes':>6}  {'decided':>7}  {'wrong':>5}  "
        f"{'sigma, deg/s':>12}  {'aliases':>7}  mostly not decided because"
    ]
    for cell in numbers["beacons"]:
        sigma = cell["sigma_deg_s"]
        speeds = f"{cell['speed_from_deg_s']:.2f} to {cell['speed_to_deg_s']:.2f}"
        table.append(
            f"  {cell['every_s']:>5g} s  {speeds:>13}  {cell['passes']:>6}  {cell['decided']:>7}  "
            f"{cell['decided_wrong']:>5}  {'-' if sigma is None else format(sigma, '.3f'):>12}  "
            f"{cell['aliases']:>7.1f}  {cell['why_not_decided']}".rstrip()
        )
    notes = [
        "Simulated: panels alone, without torques; each pass has its own gains, noise and light of the Earth."
    ]
    if attrs["interrupted"]:
        notes.append("Interrupted: the complete rounds only.")
    return Summary(numbers, lines, notes, table)


def _cells(data: Any) -> list[dict[str, Any]]:
    """Return the cells of a plan that have passes, each as a row of the table; `data`: Dataset of `plan`.

    A cell is one interval between samples (s) and one class of speeds (deg/s). `passes`, `decided` and `decided_wrong` count
    passes. `sigma_deg_s`: median sigma of the rightly decided passes, None if there are none; `aliases`: mean number of further
    solutions of a pass; `why_not_decided`: the commonest reason, empty if all are decided.
    """
    # upper limit of each class; the lower one is that of the class before
    high = np.degrees(data["class_high"].values)
    cells = []
    for k, every in enumerate(data["every"].values.tolist()):
        for speed_class in range(data.sizes["speed_class"]):
            here = data.isel(every=k, speed_class=speed_class)
            if not int(here["passes"]):
                continue
            sigma = float(np.degrees(here["rate_sigma"]))
            cells.append(
                {
                    "every_s": every,
                    "speed_from_deg_s": float(high[speed_class - 1]) if speed_class else 0.0,
                    "speed_to_deg_s": float(high[speed_class]),
                    **{name: int(here[name]) for name in ("passes", "decided", "decided_wrong")},
                    "sigma_deg_s": sigma if np.isfinite(sigma) else None,
                    "aliases": float(here["aliases"]),
                    "why_not_decided": str(here["why_not_decided"].values),
                }
            )
    return cells


def plan_drawings(data: Any, _: Context) -> Iterator[Drawing]:
    """Yield the figure of decided shares and errors against the interval between samples."""
    caption = (
        "Left: share of the simulated passes that are decided, in each class of speeds, with one standard error; hatched: decided "
        "and wrong. Right: median one-sigma error of the right decided rates, of which each counts with its largest component."
    )
    yield Drawing(
        "plan",
        lambda: plan_figure(data),
        "Share of decided passes and error of the rate against the interval between samples, for three classes of speeds.",
        caption,
    )


@styled
def plan_figure(data: Any) -> Any:
    """Draw for each interval and class of speeds the decided share with its standard error, and the error of the rate."""
    title = f"Beacons of {escape_name(data.attrs['vehicle'])}: passes of {data.attrs['samples']} samples"
    figure, grid = axes_grid(10.0, 3.8, 1, 2, title)
    share_axes, sigma_axes = grid.flat
    every, classes = data["every"].values, data.sizes["speed_class"]
    high = np.degrees(data["class_high"].values)
    width = 0.8 / classes
    for speed_class in range(classes):
        here = data.isel(speed_class=speed_class)
        passes, decided = here["passes"].values, here["decided"].values
        share, low, top = _share(decided, passes)
        place = np.arange(len(every)) + (speed_class - (classes - 1) / 2) * width
        low_deg_s = high[speed_class - 1] if speed_class else 0
        label = f"{low_deg_s:.2g} to {high[speed_class]:.2g} deg/s"
        share_axes.bar(place, share, width, color=COLOURS[speed_class], label=label)
        wrong = here["decided_wrong"].values / np.maximum(passes, 1)
        share_axes.bar(place, wrong, width, color="none", edgecolor=BLACK, hatch="////", lw=0)
        share_axes.errorbar(
            place, share, [share - low, top - share], fmt="none", ecolor=BLACK, lw=1
        )
        sigma = np.degrees(here["rate_sigma"].values)
        sigma_axes.plot(every, sigma, "o-", color=COLOURS[speed_class])
    share_axes.bar(
        [0], [0], color="none", hatch="////", edgecolor=BLACK, lw=0, label="decided and wrong"
    )
    share_axes.set(ylabel="decided share of the passes", ylim=(0, 1.4))
    share_axes.set_yticks(np.linspace(0, 1, 6))  # above 1 is room for the legend
    share_axes.set_xticks(np.arange(len(every)), [f"{each:g}" for each in every])
    share_axes.legend(ncols=2, loc="upper center", columnspacing=1, handletextpad=0.3)
    sigma_axes.set(ylabel="one sigma of the rate (deg/s)", xscale="log")
    sigma_axes.set_ylim(bottom=0)
    sigma_axes.set_xlim(every.min() / 1.3, every.max() * 1.3)
    if not np.isfinite(data["rate_sigma"]).any():
        place = sigma_axes.transAxes
        sigma_axes.text(0.5, 0.5, "no right decided rate", transform=place, ha="center")
        sigma_axes.set_yticks([])
    sigma_axes.set_xticks(every, [f"{each:g}" for each in every])
    sigma_axes.minorticks_off()
    for axes in grid.flat:
        axes.set_xlabel("seconds between samples")
    return figure


def _share(part: np.ndarray, of: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the share of `part` in `of` passes, and the ends of its one-sigma interval (Wilson), which lie between 0 and 1.

    All are 0 where there are no passes.
    """
    empty, of = of == 0, np.maximum(of, 1)
    share = part / of
    middle = (share + 0.5 / of) / (1 + 1 / of)
    half = np.sqrt(share * (1 - share) / of + 0.25 / of**2) / (1 + 1 / of)
    # of a share of exactly 0 or 1 rounding would put an end of the interval on the wrong side
    low, high = np.minimum(middle - half, share), np.maximum(middle + half, share)
    return share, np.where(empty, share, low), np.where(empty, share, high)


def plan_tables(data: Any) -> Iterator[Table]:
    """Yield the table of intervals and classes of speeds, and that of all passes."""
    import pandas as pd

    headings = {
        "every_s": "every, s",
        "speed_from_deg_s": "speed from, deg/s",
        "speed_to_deg_s": "to",
        "passes": "passes",
        "decided": "decided",
        "decided_wrong": "decided and wrong",
        "sigma_deg_s": "one sigma, deg/s",
        "aliases": "other solutions",
        "why_not_decided": "mostly not decided because",
    }
    yield Table("plan", pd.DataFrame(_cells(data)), "Beacons", headings)
    of_pass = data[[name for name in data if data[name].dims == ("pass",)]].to_dataframe()
    of_pass.columns = [name.removeprefix("pass_") for name in of_pass.columns]
    for name in ("speed", "sigma"):
        of_pass[f"{name}_deg_s"] = np.degrees(of_pass.pop(name))
    yield Table("plan_passes", of_pass.reset_index(drop=True))


KINDS.update(plan=Kind("plan", "plan", plan_summary, plan_drawings, plan_tables))
