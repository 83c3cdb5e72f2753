"""Draw docs/images/skcube.png: python docs/skcube_figure.py DATA_FOLDER (see docs/data.md for the data)."""

import sys
from pathlib import Path

import numpy as np

import sunspin as ss
from sunspin.output.figures.rates import sun_and_rates_figure

folder = Path(sys.argv[1]) / "skcube"
craft = ss.load_vehicle("skcube")
beacons = ss.read_telemetry(folder / "skcube_adcs.csv", craft)
beacons = beacons.isel(time=beacons["time"].values > 219_600)  # 25 June, 20:03 UTC: the coils are off
power = ss.read_telemetry(folder / "skcube_pwr.csv", craft)
shift = np.datetime64(power.attrs["epoch_utc"][:-1]) - np.datetime64(beacons.attrs["epoch_utc"][:-1])
sensors = ss.rates(craft, beacons.drop_vars("gyro_B"))
figure = sun_and_rates_figure(ss.rates(craft, power), sensors, beacons, shift / np.timedelta64(1, "s"))
figure.savefig(Path(__file__).parent / "images" / "skcube.png", dpi=110)
