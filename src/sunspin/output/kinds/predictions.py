"""Predictions of a posterior at other times."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr

from sunspin.output.figures import COLOURS, axes_grid, escape_name, styled
from sunspin.output.kind import KINDS, Context, Drawing, Kind, Summary, Table
from sunspin.output.text import with_range

LEVELS = (0.5, 0.9)
"""Intervals that are reported, as shares of the draws, with as many below as above."""


def intervals(predictions: xr.Dataset) -> list[dict[str, Any]]:
    """Return medians and intervals of what is predicted, a row for each time and quantity; rates in rad/s, angles in rad.

    `sun_off`: angle from the mean direction of the Sun, whose upper ends are the radii of the circles that hold 50 and 90 % of the
    draws.
    """
    table: list[dict[str, Any]] = []
    for i, t_s in enumerate(predictions["predicted_s"].values):
        draws = predictions.isel(predicted_s=i, chain=0)
        omega, sun = draws["omega_B"].values, draws["sun_B"].values
        of_rate = {f"omega_{axis}": omega[:, k] for k, axis in enumerate("xyz")}
        of_sun = {f"sun_{axis}": sun[:, k] for k, axis in enumerate("xyz")}
        angles = {name: draws[name].values for name in ("z_to_sun", "z_to_momentum")}
        mean = np.nanmean(sun, axis=0)
        mean /= max(float(np.linalg.norm(mean)), 1e-12)
        off = {"sun_off": np.arccos(np.clip(sun @ mean, -1.0, 1.0))}
        for unit, quantities in (
            ("rad/s", of_rate | {"rate": draws["rate"].values}),
            ("1", of_sun),
            ("rad", angles | off),
        ):
            for name, values in quantities.items():
                row = {"t_s": float(t_s), "quantity": name, "unit": unit}
                row["median"] = float(np.nanmedian(values))
                for level in LEVELS:
                    # a circle has its mean direction inside
                    ends = (0.0, level) if name in off else (0.5 - level / 2, 0.5 + level / 2)
                    low, high = np.nanquantile(values, ends)
                    percent = f"{100 * level:.0f}"
                    row[f"low_{percent}"] = 0.0 if name in off else float(low)
                    row[f"high_{percent}"] = float(high)
                table.append(row)
    return table


def predictions_summary(predictions: Any) -> Summary:
    """Return the summary of predictions: medians and 90 % intervals at each time."""
    rows, lines, times = intervals(predictions), [], predictions["predicted_s"].values
    after_collision = predictions.get("after_collision", np.zeros(len(times), bool))
    for t, label, after in zip(times, labels(predictions), after_collision, strict=True):
        by_quantity = {row["quantity"]: row for row in rows if row["t_s"] == t}
        radius = np.degrees(
            by_quantity["sun_off"]["high_90"]
        )  # of the cone about the mean direction
        lines += [
            f"  at {label}{', after the collision' if after else ''} (90 % of the draws):",
            f"    angular speed {degrees_text(by_quantity['rate'])} deg/s",
            f"    angle of z to the angular momentum {degrees_text(by_quantity['z_to_momentum'])} deg",
            f"    angle of z to the Sun {degrees_text(by_quantity['z_to_sun'])} deg",
            f"    Sun direction: 90 % within {radius:.1f} deg of the mean (body axes)",
        ]
    # the attribute has the leg that hits and the drawn parameters, or says that no collision was simulated
    collision = str(predictions.attrs.get("collision", ""))
    if collision.startswith("a leg"):
        lines.append(f"    collision: {collision}")
    return Summary({"predicted": rows}, lines)


def degrees_text(row: Mapping[str, float]) -> str:
    """Return median and ends of the 90 % interval of an angle or angular speed (rad, rad/s) as text in degrees."""
    return with_range(*(float(np.degrees(row[key])) for key in ("median", "low_90", "high_90")))


def labels(predictions: Any) -> list[str]:
    """Return the times of predictions in words: as the user gave them if the data have that, else in s."""
    if "asked" in predictions.coords:
        return predictions["asked"].values.astype(str).tolist()
    return [f"{t:g} s" for t in predictions["predicted_s"].values]


def predictions_drawings(predictions: Any, _: Context) -> Iterator[Drawing]:
    """Yield the figure of predictions."""
    yield Drawing(
        "predicted",
        lambda: predicted_figure(predictions, labels(predictions)),
        "Draws of the angular speed, the components of the rate, the direction of the Sun and the angles of z at each time.",
        "What the body did at other times; thick and thin bars: 50 and 90 % of the draws.",
    )


@styled
def predicted_figure(
    predictions: xr.Dataset, labels: list[str], truth: xr.Dataset | None = None
) -> Any:
    """Draw predictions, a row for each time: speed, rate components, Sun direction, angles of z to the Sun and to H.

    H is the angular momentum. `predictions`: from :func:`sunspin.estimate.lander.predict.predict`; `labels`: the times in words;
    `truth`: predictions of one motion, the true one, drawn as dashed lines and as a cross on the sky.
    """
    count = predictions.sizes["predicted_s"]
    dashed = "" if truth is None else "; dashed: the truth"
    name = escape_name(predictions.attrs.get("vehicle", "the body"))
    title = f"What {name} did: draws of the posterior{dashed}"
    figure, grid = axes_grid(13, 2.7 * count + 0.6, count, 4, title, squeeze=False)
    for i, (label, (speed, rates, sky, angles)) in enumerate(zip(labels, grid, strict=True)):
        draws = predictions.isel(predicted_s=i, chain=0)
        true = None if truth is None else truth.isel(predicted_s=i, chain=0, draw=0)
        # axes, variable, component (None: a scalar), colour, label
        histograms = [
            (speed, "rate", None, COLOURS[0], ""),
            *((rates, "omega_B", k, COLOURS[k], rf"$\omega_{a}$") for k, a in enumerate("xyz")),
            (angles, "z_to_momentum", None, COLOURS[3], "z and H"),
            (angles, "z_to_sun", None, COLOURS[4], "z and Sun"),
        ]
        for axes, quantity, k, color, text in histograms:
            index = ... if k is None else (..., k)  # the whole scalar, or a component of the vector
            exact = None if true is None else np.degrees(true[quantity].values)[index]
            _draw_histogram(axes, np.degrees(draws[quantity].values)[index], color, text, exact)
        for data, style in (
            (draws, {"marker": ".", "ms": 1.5, "alpha": 0.3, "color": COLOURS[5]}),
            (true, {"marker": "+", "ms": 9, "color": COLOURS[6]}),
        ):
            if data is not None:
                # azimuth about body z and height above the body's x-y plane
                x, y, z = np.atleast_2d(data["sun_B"].values).T
                height = np.degrees(np.arcsin(np.clip(z, -1, 1)))
                sky.plot(np.degrees(np.arctan2(y, x)), height, ls="", rasterized=True, **style)
        sky.set(xlim=(-180, 180), ylim=(-90, 90), xticks=range(-180, 181, 90))
        sky.set(yticks=range(-90, 91, 45), ylabel="height of the Sun (deg)")
        speed.set_ylabel(f"{label}\ndraws", fontsize=9)
        rates.legend(fontsize=7)
        angles.legend(fontsize=7)
    x_labels = ("angular speed (deg/s)", "components of the rate (deg/s)")
    x_labels += ("azimuth of the Sun about z (deg)", "angle (deg)")
    for axes, x_label in zip(grid[-1], x_labels, strict=True):
        axes.set_xlabel(x_label)
    return figure


def _draw_histogram(axes: Any, values: np.ndarray, color: str, label: str, true: Any) -> None:
    """Draw a histogram, its 50 % and 90 % intervals as bars below, and the true value, if any, as a line."""
    values = values[np.isfinite(values)]
    axes.hist(values, 50, histtype="stepfilled", color=color, alpha=0.6, label=label)
    for level, width in ((0.9, 1.5), (0.5, 4.0)):
        ends = np.quantile(values, [0.5 - level / 2, 0.5 + level / 2])
        style = {"solid_capstyle": "butt", "clip_on": False, "zorder": 5}
        axes.plot(ends, [0, 0], color=color, lw=width, **style)
    if true is not None:
        axes.axvline(float(true), color=COLOURS[6], lw=0.9, ls="--")
    axes.set_yticks([])


def predictions_tables(predictions: Any) -> Iterator[Table]:
    """Yield the table `predicted`: a row for each time and quantity."""
    import pandas as pd

    names = ("t_s", "quantity", "median", "low_90", "high_90")
    headings = {name: name.replace("_", " ") for name in names}
    frame = pd.DataFrame(intervals(predictions))
    yield Table("predicted", frame, "At other times, in rad and rad/s (90 % intervals)", headings)


_predictions = (predictions_summary, predictions_drawings, predictions_tables)
KINDS.update(predictions=Kind("predictions", "predictions", *_predictions))
