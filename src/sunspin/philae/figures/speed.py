"""How fast Philae turned, from the separation to the second touchdown."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.dates import DateFormatter
from matplotlib.figure import Figure

from sunspin.output.figures import COLOURS, titled
from sunspin.telemetry.case import Case

MARGIN_S = 120.0
"""Time drawn before the first and after the second touchdown."""

RANGE_RAD_S = (0.006, 2.2)
"""Angular speeds that the axis covers at least."""

FLOOR_RAD_S = 1e-4
"""Smaller speeds, such as none at all, are drawn as this."""


def draw(case: Case, speed: xr.Dataset, synthetic: bool) -> Figure:
    """Angular speed against time: the descent's fit, bands of the candidates and of the paper's recipe, the magnetometer.

    Parameters
    ----------
    speed : Dataset of :func:`sunspin.philae.motions.speeds`
    """
    timeline = case.require_timeline()
    at = {event.name: event.t_s for event in timeline.events}
    epoch = np.datetime64(timeline.epoch_utc.removesuffix("Z"), "ms")

    def clock(seconds: Any) -> Any:
        return epoch + np.round(1000 * np.asarray(seconds)).astype("timedelta64[ms]")

    figure = Figure(figsize=(11, 5), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1, 2.6))
    if "descent_speed" in speed:
        t = clock(speed["descent_time"].values)
        left.plot(
            t, speed["descent_speed"].values, color=COLOURS[2], lw=2.5, label="fit of the descent"
        )
    after = clock([at["collision"], at["second_touchdown"]])
    for name, colour, label in (
        ("candidates", COLOURS[0], "all candidates: slowest to fastest"),
        ("recipe", COLOURS[1], "the paper's recipe on this telemetry, and its median"),
    ):
        if name not in speed["set"].values:
            continue
        before, then = (
            speed[part].sel(set=name).clip(min=FLOOR_RAD_S)
            for part in ("speed", "speed_after_collision")
        )
        filled = name == "candidates"
        for t, band in ((clock(speed["time"].values), before), (after, then)):
            low, middle, high = (
                np.broadcast_to(band.sel(level=level).values, len(t))
                for level in ("low", "middle", "high")
            )
            if filled:
                right.fill_between(t, low, high, color=colour, alpha=0.25, lw=0, label=label)
            else:
                right.plot(t, low, "--", color=colour, lw=1.2, label=label)
                right.plot(t, high, "--", color=colour, lw=1.2)
                right.plot(t, middle, color=colour, lw=1.6)
            label = None
    published = case.published
    marks: dict[str, Any] = {"marker": "D", "ls": "", "ms": 7, "color": COLOURS[6]}
    marks["label"] = "magnetometer (not used)"
    middle = (at["separation"] + at["first_touchdown"]) / 2
    left.plot(clock(middle), published["descent_rate_romap"].value, **marks)
    for t, name in ((-240, "romap_period_before"), (600, "romap_period_after")):
        right.plot(clock(at["collision"] + t), 2 * np.pi / published[name].value, **marks)
        marks["label"] = None
    above: dict[str, Any] = {"transform": right.get_xaxis_transform(), "ha": "center"}
    for name, text in (
        ("first_touchdown", "bounce"),
        ("collision", "hits crater rim"),
        ("second_touchdown", "lands"),
    ):
        right.axvline(clock(at[name]), color=COLOURS[7], ls=":", lw=1)
        right.text(clock(at[name]), 1.01, text, fontsize=8, **above)
    left.set(xlim=clock([at["separation"], at["first_touchdown"]]), title="descent")
    right.set_xlim(clock([at["first_touchdown"] - MARGIN_S, at["second_touchdown"] + MARGIN_S]))
    left.set_yscale("log")
    drawn = np.concatenate(
        [speed[part].values.ravel() for part in ("speed", "speed_after_collision")]
    )
    drawn = drawn[np.isfinite(drawn)].clip(min=FLOOR_RAD_S)
    left.set_ylim(min(RANGE_RAD_S[0], 0.8 * drawn.min()), max(RANGE_RAD_S[1], 1.2 * drawn.max()))
    left.set_ylabel("angular speed (rad/s)")
    periods = right.secondary_yaxis("right")
    named = {600: "10 min", 60: "1 min", 30: "30 s", 13: "13 s", 5: "5 s"}
    periods.set_yticks([2 * np.pi / seconds for seconds in named], list(named.values()))
    periods.minorticks_off()
    periods.set_ylabel("rotation period")
    for axes in (left, right):
        axes.xaxis.set_major_formatter(DateFormatter("%H:%M"))
        axes.tick_params(axis="x", labelrotation=30)
        axes.set_xlabel(f"UTC, {timeline.epoch_utc[:10]}")
    handles = [
        item
        for axes in (left, right)
        for item in zip(*axes.get_legend_handles_labels(), strict=True)
    ]
    shown = {text: handle for handle, text in handles}
    figure.legend(
        shown.values(), shown.keys(), ncols=2, fontsize=8, loc="outside lower center", frameon=False
    )
    figure.suptitle(titled("How fast Philae turned", synthetic), fontsize=11)
    return figure
