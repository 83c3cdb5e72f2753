"""Figure of skCUBE: Sun directions from panel currents and from Sun sensors, body rates compared with the gyro.

    python -m studies.skcube_figure OUT --data FOLDER

OUT holds the figure, skcube.png; that of the documentation is in docs/images. The rates come from the Sun sensors and the
magnetometer, not from the gyro, in passes after the coils were switched off.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import sunspin as ss
from studies.skcube_data import FREE_S, POWER, add_data_option, read_beacons
from sunspin.output.figures import COLOURS
from sunspin.output.figures.rates import clock_text, draw_component, largest_passes
from validation.campaign import command, rows_folder, study_parser

LAST_PASSES = 3
"""Passes with a gyro reading at every sample that are drawn: the last ones."""

MARGIN_S = 60.0
"""Sun sensor readings are drawn from this long before a pass of panel currents to this long after it."""


def gyro_of_pass(result: xr.Dataset, beacons: xr.Dataset, number: int) -> np.ndarray:
    """Return the gyro's rates (n, 3) in rad/s at the samples of a pass, NaN where the beacon has none."""
    samples = result["pass_of"].values == number
    return beacons["gyro_B"].sel(time=result["time"].values[samples]).values


def draw_sun(panel: Any, currents: xr.Dataset, beacons: xr.Dataset, offset_s: float) -> None:
    """Draw the components of the Sun direction for each pass of panel currents, with the Sun sensors' readings near it."""
    count, beacon_s = currents.sizes["pass_id"], beacons["time"].values
    grid = panel.subplots(3, count, sharey=True, squeeze=False)
    for number in range(count):
        samples = np.flatnonzero(currents["pass_of"].values == number)
        t = currents["time"].values[samples] + offset_s
        near = (beacon_s > t[0] - MARGIN_S) & (beacon_s < t[-1] + MARGIN_S)
        for k, axes in enumerate(grid[:, number]):
            axes.errorbar(
                (t - t[0]) / 60,
                currents["sun_B"].values[samples, k],
                yerr=currents["sun_sigma_rad"].values[samples],
                fmt=".",
                ms=5,
                lw=0.8,
                color=COLOURS[k],
                label="currents",
            )
            axes.errorbar(
                (beacon_s[near] - t[0]) / 60,
                beacons["sun_sensor_B"].values[near, k],
                yerr=np.sqrt(beacons["sun_sensor_cov_B"].values[near, k, k]),
                fmt="s",
                ms=4,
                lw=0.6,
                color=COLOURS[6],
                mfc="none",
                label="Sun sensors",
            )
            axes.set_ylim(-1.3, 1.3)
        start = clock_text(currents, currents["time"].values[samples][0])
        grid[0, number].set_title(start, fontsize=8)
        grid[2, number].set_xlabel("time (min)")
    for k, axes in enumerate(grid[:, 0]):
        axes.set_ylabel(rf"Sun direction $n_{'xyz'[k]}$")
        axes.legend(fontsize=7, loc="best")
    panel.suptitle("The Sun: smoothed from currents, read by sensors", fontsize=10)


def draw_rates(panel: Any, sensors: xr.Dataset, beacons: xr.Dataset) -> None:
    """Draw the body rates of the last passes whose gyro readings are complete, with these readings."""
    complete = [
        number
        for number in largest_passes(sensors)
        if np.isfinite(gyro_of_pass(sensors, beacons, number)).all()
    ][-LAST_PASSES:]
    grid = panel.subplots(3, len(complete), sharey="row", squeeze=False)
    for column, number in enumerate(complete):
        t = sensors["time"].values[sensors["pass_of"].values == number]
        gyro = np.degrees(gyro_of_pass(sensors, beacons, number))
        for k, axes in enumerate(grid[:, column]):
            draw_component(axes, sensors, number, k, "Sun sensors, one sigma")
            axes.plot((t - t[0]) / 60, gyro[:, k], "x", color=COLOURS[6], ms=5, label="gyro")
        grid[0, column].set_title(clock_text(sensors, t[0]), fontsize=8)
        grid[2, column].set_xlabel("time (min)")
    for k, axes in enumerate(grid[:, 0]):
        axes.set_ylabel(rf"$\omega_{'xyz'[k]}$ (deg/s)")
        axes.legend(fontsize=7, loc="best")
    panel.suptitle("Body rates, gyro not used", fontsize=10)


def draw(currents: xr.Dataset, sensors: xr.Dataset, beacons: xr.Dataset, offset_s: float) -> Figure:
    """Return the figure. Left: Sun directions from panel currents and from Sun sensors; right: body rates and the gyro's readings.

    `currents` and `sensors` are results of `rates`; `beacons` is the telemetry of `sensors` with its gyro; `offset_s` is the epoch
    of `currents` on the clock of `beacons`.
    """
    figure = Figure(figsize=(11, 7.2), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=(1, 1.25), squeeze=False)[0]
    draw_sun(left, currents, beacons, offset_s)
    draw_rates(right, sensors, beacons)
    return figure


def epoch(telemetry: xr.Dataset) -> np.datetime64:
    """Return the UTC of time zero, which the attribute has with a final "Z"."""
    return np.datetime64(telemetry.attrs["epoch_utc"][:-1])


@command
def main(arguments: list[str] | None = None) -> None:
    parser = study_parser("skcube_figure", __doc__)
    parser.add_argument("out", type=Path, help="folder of the figure")
    add_data_option(parser)
    given, craft = parser.parse_args(arguments), ss.load_vehicle("skcube")
    beacons = read_beacons(craft, given.data)
    beacons = beacons.isel(time=beacons["time"].values > FREE_S)
    power = read_beacons(craft, given.data, POWER)
    offset_s = float((epoch(power) - epoch(beacons)) / np.timedelta64(1, "s"))
    sensors = ss.rates(craft, beacons.drop_vars("gyro_B"))
    figure = draw(ss.rates(craft, power), sensors, beacons, offset_s)
    path = rows_folder(given.out) / "skcube.png"
    figure.savefig(path, dpi=110)
    print(f"written: {path}")


if __name__ == "__main__":
    sys.exit(main())
