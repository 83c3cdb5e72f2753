"""Figures of what follows a collision. Each function returns a matplotlib Figure; results come from `sunspin.landing`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from sunspin.landing.tally import Estimate, density, quantity, tally
from sunspin.output.figures import COLOURS, named, titled

DOTS = (
    (
        "antenna's cone holds the orbiter",
        "probability",
        (
            ("antenna_share", "in flight"),
            ("antenna_at_contact", "at contact"),
            ("antenna_at_rest", "at rest"),
        ),
    ),
    (
        "speed at first contact",
        "mean speed over ground (m/s)",
        (("contact_speed", "point that touches"), ("leg_tip_speed", "fastest leg tip")),
    ),
    (
        "Sun below the body's equator",
        "share of the time",
        (("rz_time_below_0", "$r_z$ < 0"), ("rz_time_below_-0.5", "$r_z$ < -0.5")),
    ),
    (
        "angular speed",
        "mean (deg/s)",
        (("rate_before", "before the collision"), ("rate_after", "after it")),
    ),
)
"""Panels of the comparison: title, axis, (quantity, label) pairs."""

FINER = 2
"""Bins of the runs drawn as one, 0.05 wide."""

HATCHES = ("", "//", "..", "xx")


def sun_height_figure(runs: Mapping[str, xr.Dataset]) -> Figure:
    """Densities of r_z between collision and landing, one per strategy, area 1, bars of one standard error (paper, Fig. 13)."""
    figure = Figure(figsize=(7.5, 4.2), layout="constrained")
    axes = figure.subplots()
    for k, (name, found) in enumerate(runs.items()):
        curve = density(found, merge=FINER)
        width = 2.0 / curve.sizes["rz"]
        edges = np.append(curve["rz"].values - width / 2, 1.0)
        said = f"{_short(name)}: {found.sizes['run']:,} runs".replace(",", " ").replace("\n", " ")
        colour, alpha = COLOURS[k % 8], 0.45 if k == 0 else 1
        axes.stairs(
            curve["density"].values,
            edges,
            color=colour,
            lw=1.6,
            fill=k == 0,
            alpha=alpha,
            label=said,
        )
        axes.errorbar(
            curve["rz"].values,
            curve["density"].values,
            curve["error"].values,
            fmt="none",
            ecolor=colour,
            elinewidth=1.0,
        )
    axes.set_xlim(-1, 1)
    axes.set_ylim(bottom=0)
    axes.set_xlabel("$r_z$, cosine of the angle between the Sun and the z axis")
    axes.set_ylabel("probability density")
    axes.legend(title="wheel", loc="upper left", frameon=False)
    axes.set_title(titled("Height of the Sun on the way to the landing", _synthetic(runs)))
    return figure


def strategies_figure(table: xr.Dataset) -> Figure:
    """What touches first, on what it rests, antenna, speeds and lost upright axis for each strategy, with standard errors."""
    figure = Figure(figsize=(11, 6.4), layout="constrained")
    parts = figure.subplots(2, 3).ravel()
    names = [str(name) for name in table["strategy"].values]
    known = set(table["quantity"].values)
    stacks = (("touches the ground first", "touch"), ("comes to rest on", "rest"))
    for axes, (title, prefix) in zip(parts, stacks, strict=False):
        _stack(axes, table, names, prefix, known)
        axes.set_title(title, fontsize=10)
    for axes, (title, label, quantities) in zip(parts[2:], DOTS, strict=True):
        for k, (name, text) in enumerate(q for q in quantities if q[0] in known):
            at = table[["value", "error"]].sel(quantity=name) * quantity(name).scale
            place = np.arange(len(names)) + 0.12 * (k - 0.5)
            error = (
                _within(at["value"].values, at["error"].values)
                if label in SHARES
                else at["error"].values
            )
            axes.errorbar(
                place,
                at["value"],
                yerr=error,
                fmt="osD"[k],
                ms=5,
                color=COLOURS[k],
                capsize=2,
                label=text,
            )
        axes.set_title(title, fontsize=10)
        axes.set_ylabel(label)
        axes.set_ylim(0, 1.3 * max([axes.dataLim.y1, 1e-3]))
        if axes.get_legend_handles_labels()[0]:
            axes.legend(
                fontsize=8,
                frameon=False,
                loc="upper center",
                ncols=3,
                columnspacing=1,
                handletextpad=0.3,
            )
        else:
            _nothing(axes, "not determined by this vehicle and scenario")
    for axes in parts:
        axes.set_xticks(range(len(names)), [_short(name) for name in names], fontsize=8)
        axes.set_xlim(-0.6, len(names) - 0.4)
    title = f"Momentum-wheel strategies after the touchdown: {table.attrs['runs']} runs each, one standard error"
    figure.suptitle(titled(title, table.attrs.get("synthetic")))
    return figure


def _synthetic(runs: Mapping[str, xr.Dataset]) -> bool:
    """Whether the motions that the runs begin with follow from synthetic telemetry."""
    return any(found.attrs.get("synthetic") for found in runs.values())


def _short(name: str) -> str:
    if name.startswith("delay:"):
        seconds = float(name[6:])
        return (
            f"off after\n{seconds:g} s" if seconds < 120 else f"off after\n{seconds / 60:.3g} min"
        )
    return {
        "off": "off at\ntouchdown",
        "held": "held",
        "brake": "braked",
        "after_rest": "off after\nrest",
    }.get(name, named(name))


SHARES = ("probability", "share of the time")
"""Axes whose values lie between zero and one."""


def _within(value: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Errors (2, n) below and above that lead to no probability below zero or above one."""
    return np.clip(np.stack([np.minimum(error, value), np.minimum(error, 1 - value)]), 0.0, None)


def _stack(axes, table: xr.Dataset, names: list[str], prefix: str, known: set[str]) -> None:
    bottom = np.zeros(len(names))
    for k, kind in enumerate(("leg", "panel", "body")):
        if f"{prefix}_{kind}" not in known:
            continue
        at = table.sel(quantity=f"{prefix}_{kind}")
        label = {"leg": "leg", "panel": "panel", "body": "bare body"}[kind]
        axes.bar(
            range(len(names)),
            at["value"],
            0.65,
            bottom,
            color=COLOURS[k],
            hatch=HATCHES[k],
            alpha=0.85,
            label=label,
            ec="white",
        )
        bottom = bottom + at["value"].values
        error = _within(bottom, at["error"].values)
        axes.errorbar(
            range(len(names)),
            bottom,
            yerr=error,
            fmt="none",
            ecolor="black",
            elinewidth=1,
            capsize=2,
        )
    axes.set_ylabel("probability")
    axes.set_ylim(0, 1.22)
    if np.any(bottom):
        axes.legend(ncols=3, fontsize=8, frameon=False, loc="upper center")
    else:
        _nothing(axes, "not determined without a hull")


def _nothing(axes, why: str) -> None:
    """Say in an empty panel why it is, and leave out the ticks of its scale."""
    axes.text(0.5, 0.5, why, transform=axes.transAxes, ha="center", fontsize=9)
    axes.set_yticks([])


def distributions_figure(
    runs: Mapping[str, xr.Dataset], published_tip_speed: float | None = None
) -> Figure:
    """Distributions over runs for each strategy: z axis against the ground's normal, fastest leg tip, antenna's share of time.

    `published_tip_speed` (m/s): the paper's estimate, drawn as a line.
    """
    figure = Figure(figsize=(11.5, 3.9), layout="constrained")
    parts = figure.subplots(1, 3)
    panels = (
        (
            "up_z",
            np.linspace(-1, 1, 41),
            "cosine of z axis to the ground's normal at contact",
            "probability density",
        ),
        (
            "leg_tip_speed",
            np.linspace(0, 2, 51),
            "fastest leg tip at first contact (m/s)",
            "probability density (s/m)",
        ),
        (
            "antenna_share",
            np.linspace(0, 1, 26),
            "share of time, orbiter in the antenna's cone",
            "probability density",
        ),
    )
    for axes, (name, edges, x, y) in zip(parts, panels, strict=True):
        if not any(np.isfinite(found[name].values).any() for found in runs.values()):
            _nothing(axes, "not determined by this vehicle")
        for k, (strategy, found) in enumerate(runs.items()):
            values = found[name].values[np.isfinite(found[name].values)]
            counts = np.histogram(values, edges)[0] / max(values.size, 1)
            width = edges[1] - edges[0]
            label = _short(strategy).replace("\n", " ")
            line = ("-", "--", "-.", ":")[k % 4]
            axes.stairs(counts / width, edges, color=COLOURS[k % 8], lw=1.6, ls=line, label=label)
            error = np.sqrt(counts * (1 - counts) / max(values.size, 1)) / width
            axes.errorbar(
                (edges[1:] + edges[:-1]) / 2,
                counts / width,
                error,
                fmt="none",
                ecolor=COLOURS[k % 8],
                elinewidth=0.8,
            )
        axes.set_xlabel(x)
        axes.set_ylabel(y)
        axes.set_ylim(bottom=0)
        axes.set_xlim(edges[0], edges[-1])
    if published_tip_speed is not None:
        parts[1].axvline(
            published_tip_speed,
            color=COLOURS[6],
            lw=1,
            ls=":",
            label=f"paper: {published_tip_speed:g} m/s",
        )
    parts[1].legend(fontsize=8, frameon=False)
    figure.suptitle(titled("At the landing, and on the way to it", _synthetic(runs)))
    return figure


def first_contact_figure(runs: Mapping[str, xr.Dataset]) -> Figure:
    """Which leg or panel touches the ground first, by strategy; corners that panels share count for each of them."""
    figure = Figure(figsize=(8.5, 4), layout="constrained")
    axes = figure.subplots()
    labels: list[str] = []
    for k, (name, found) in enumerate(runs.items()):
        values = _parts(found)
        labels = list(values)
        place = np.arange(len(labels)) + 0.8 / len(runs) * (k - (len(runs) - 1) / 2)
        axes.bar(
            place,
            [v.value for v in values.values()],
            0.8 / len(runs),
            yerr=_within(
                *(
                    np.array([getattr(v, part) for v in values.values()])
                    for part in ("value", "error")
                )
            ),
            color=COLOURS[k % 8],
            hatch=HATCHES[k % 4],
            ec="white",
            label=_short(name).replace("\n", " "),
            capsize=2,
        )
    axes.set_xticks(range(len(labels)), labels, fontsize=9)
    axes.set_ylabel("probability of touching first")
    axes.legend(title="wheel", frameon=False)
    axes.set_title(
        titled(
            "What touches the ground first; a shared corner counts for each panel", _synthetic(runs)
        ),
        fontsize=10,
    )
    return figure


def _parts(runs: xr.Dataset) -> dict[str, Estimate]:
    found = tally(runs)
    n, point = runs.sizes["run"], runs["contact_point"].values
    parts = {}
    for leg in range(int(runs["point_leg"].max()) + 1):
        share = float(np.mean(runs["point_leg"].values[point][point >= 0] == leg))
        parts[f"leg {leg + 1}"] = Estimate(share, float(np.sqrt(share * (1 - share) / n)))
    parts |= {
        f"panel {named(p)}": found[f"touch_panel_{p}"]
        for p in runs["panel"].values
        if f"touch_panel_{p}" in found
    }
    return parts | ({"bare body": found["touch_body"]} if "touch_body" in found else {})
