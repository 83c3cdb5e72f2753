"""Draw docs/images/skcube.png: python docs/skcube_figure.py DATA_FOLDER (see docs/data.md for the data)."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import sunspin as ss
from sunspin.output.figures import COLOURS
from sunspin.output.figures.rates import clock_text, draw_component, largest_passes


def sun_and_rates_figure(
    currents: xr.Dataset, sensors: xr.Dataset, beacons: xr.Dataset, shift_s: float
) -> Figure:
    """Left: the Sun from panel currents against the Sun sensors' readings; right: rates from Sun sensors against the gyro.

    `currents`, `sensors`: results of `rates`; `beacons`: the telemetry of the latter, with its gyro; `shift_s`: time of the
    former's epoch on the latter's clock.
    """
    figure = Figure(figsize=(11, 7.2), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=(1, 1.25), squeeze=False)[0]
    _sun_against_sensors(left, currents, beacons, shift_s)
    known = [
        n for n in largest_passes(sensors) if np.isfinite(_gyro_at(sensors, beacons, n)).all()
    ][-3:]
    grid = right.subplots(3, len(known), sharey="row", squeeze=False)
    for column, number in enumerate(known):
        at = np.flatnonzero(sensors["pass_of"].values == number)
        t = sensors["time"].values[at]
        for k, axes in enumerate(grid[:, column]):
            draw_component(axes, sensors, number, k, "Sun sensors, one sigma")
            gyro = np.degrees(_gyro_at(sensors, beacons, number)[:, k])
            axes.plot((t - t[0]) / 60, gyro, "x", color=COLOURS[6], ms=5, label="gyro")
        grid[0, column].set_title(clock_text(sensors, t[0]), fontsize=8)
        grid[2, column].set_xlabel("time (min)")
    for k, axes in enumerate(grid[:, 0]):
        axes.set_ylabel(rf"$\omega_{'xyz'[k]}$ (deg/s)")
        axes.legend(fontsize=7, loc="best")
    right.suptitle("Body rates, gyro not used", fontsize=10)
    return figure


def _gyro_at(result: xr.Dataset, telemetry: xr.Dataset, number: int) -> np.ndarray:
    at = result["pass_of"].values == number
    return telemetry["gyro_B"].sel(time=result["time"].values[at]).values


def _sun_against_sensors(
    figure: Any, currents: xr.Dataset, beacons: xr.Dataset, shift_s: float
) -> None:
    count = currents.sizes["pass_id"]
    grid = figure.subplots(3, count, sharey=True, squeeze=False)
    for number in range(count):
        at = np.flatnonzero(currents["pass_of"].values == number)
        t = currents["time"].values[at] + shift_s
        near = (beacons["time"].values > t[0] - 60) & (beacons["time"].values < t[-1] + 60)
        minutes = (beacons["time"].values[near] - t[0]) / 60
        for k, axes in enumerate(grid[:, number]):
            sun, sigma = currents["sun_B"].values[at, k], currents["sun_sigma_rad"].values[at]
            axes.errorbar(
                (t - t[0]) / 60,
                sun,
                yerr=sigma,
                fmt=".",
                ms=5,
                lw=0.8,
                color=COLOURS[k],
                label="currents",
            )
            error = np.sqrt(beacons["sun_sensor_cov_B"].values[near, k, k])
            axes.errorbar(
                minutes,
                beacons["sun_sensor_B"].values[near, k],
                yerr=error,
                fmt="s",
                ms=4,
                lw=0.6,
                color=COLOURS[6],
                mfc="none",
                label="Sun sensors",
            )
            axes.set_ylim(-1.3, 1.3)
        grid[0, number].set_title(clock_text(currents, currents["time"].values[at][0]), fontsize=8)
        grid[2, number].set_xlabel("time (min)")
    for k, axes in enumerate(grid[:, 0]):
        axes.set_ylabel(rf"Sun direction $n_{'xyz'[k]}$")
        axes.legend(fontsize=7, loc="best")
    figure.suptitle("The Sun: smoothed from currents, read by sensors", fontsize=10)


folder = Path(sys.argv[1]) / "skcube"
craft = ss.load_vehicle("skcube")
beacons = ss.read_telemetry(folder / "skcube_adcs.csv", craft)
beacons = beacons.isel(
    time=beacons["time"].values > 219_600
)  # 25 June, 20:03 UTC: the coils are off
power = ss.read_telemetry(folder / "skcube_pwr.csv", craft)
shift = np.datetime64(power.attrs["epoch_utc"][:-1]) - np.datetime64(
    beacons.attrs["epoch_utc"][:-1]
)
sensors = ss.rates(craft, beacons.drop_vars("gyro_B"))
figure = sun_and_rates_figure(
    ss.rates(craft, power), sensors, beacons, shift / np.timedelta64(1, "s")
)
figure.savefig(Path(__file__).parent / "images" / "skcube.png", dpi=110)
