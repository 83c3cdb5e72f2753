"""Made-up satellites as their operators would describe them, with telemetry files of known motion. All of it is synthetic.

`six_faces`: a 3U CubeSat, six faces in W, quaternion, eclipse, UTC, CSV. `four_faces`: a 1U, currents in counts of 12 bits that
follow the battery, albedo, a dead cell, a temperature column, Unix milliseconds, semicolons. `wheeled`: a microsatellite with a
momentum wheel, currents in mA, gyro in deg/s, mission-elapsed time, Parquet or NetCDF.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

import sunspin as ss
from sunspin.vehicle.file import parse_vehicle


class Satellite(NamedTuple):
    """A vehicle file, a telemetry file, and the truth: rates omega_B over time in s from the file's first sample."""

    vehicle: Path
    telemetry: Path
    truth: xr.Dataset


SIX = """
name = "six faces"
description = "synthetic: a 3U CubeSat after deployment"
[body]
inertia_kg_m2 = [[0.042, 0, 0], [0, 0.041, 0], [0, 0, 0.009]]
{panels}
[telemetry]
time_column = "timestamp"
noise = 0.03
bad_rows = "flag"
[telemetry.columns]
{columns}
[attitude]
columns = ["q_s", "q_x", "q_y", "q_z"]
scalar = "first"
rotates = "B_to_N"
sigma_rad = 0.01
[disturbance]
acceleration_noise = 1e-5
"""

FOUR = """
name = "four faces"
description = "synthetic: a 1U CubeSat with cells on the sides only"
{panels}
[telemetry]
quantity = "current_A"
time_column = "t_ms"
time_format = "unix"
time_scale_s = 0.001
scale = 0.00025            # a count is 0.25 mA
zero = 12
wraps_at = 4096
noise = 0.004
bad_rows = "flag"
temperature_scale = 0.1
temperature_coefficient_per_K = 0.0006
reference_temperature_C = 28
[telemetry.columns]
{columns}
[telemetry.temperature_columns]
px = "T_px"
mx = "T_mx"
[disturbance]
max_rate_rad_s = 0.12
"""

WHEEL = """
name = "wheeled"
description = "synthetic: a microsatellite with a momentum wheel along y"
[body]
inertia_kg_m2 = [[1.1, 0.02, 0], [0.02, 0.9, 0], [0, 0, 1.3]]
{panels}
[[wheel]]
name = "MW"
axis_B = [0, 1, 0]
inertia_kg_m2 = 1.0e-3
speed_rad_s = 60.0
{speed}
[wheel.friction]
coulomb_N_m = 1.0e-5
viscous_N_m_s = 1.0e-6
[telemetry]
quantity = "current_A"
time_column = "met"
time_format = "elapsed"
epoch_utc = "2026-05-04T03:02:01Z"
scale = 0.001
noise = 0.004
bad_rows = "flag"
[telemetry.columns]
{columns}
[gyro]
columns = ["gx", "gy", "gz"]
scale_rad_s = {{ value = 0.0174533, sigma = 1e-4 }}
zero = {{ value = [0.1, -0.2, 0.05], sigma = 0.02 }}
noise_rad_s = 3e-4
"""

FACES = {
    "px": [1, 0, 0],
    "mx": [-1, 0, 0],
    "py": [0, 1, 0],
    "my": [0, -1, 0],
    "pz": [0, 0, 1],
    "mz": [0, 0, -1],
}


def _text(form: str, names: str, gain: str, **more: str) -> str:
    panels = "\n".join(
        f'[[panel]]\nname = "{name}"\nnormal_B = {FACES[name]}\n{gain}' for name in names.split()
    )
    columns = "\n".join(f'{name} = "I_{name}"' for name in names.split())
    return form.format(panels=panels, columns=columns, **more)


def _sun(rng: np.random.Generator) -> np.ndarray:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def _csv(path: Path, columns: dict[str, object], mark: str = ",") -> Path:
    rows = zip(*columns.values(), strict=True)
    lines = [mark.join(columns), *(mark.join(str(cell) for cell in row) for row in rows)]
    path.write_text("# synthetic: made up for tests\n" + "\n".join(lines) + "\n", "utf-8")
    return path


def six_faces(folder: Path, rng: np.random.Generator, n: int = 90) -> Satellite:
    vehicle = folder / "six.toml"
    vehicle.write_text(_text(SIX, "px mx py my pz mz", "gain_W = 7.0"))
    craft = parse_vehicle(vehicle.read_text(), "six")
    t = np.cumsum(np.round(10 * rng.uniform(0.9, 1.1, n), 3))
    t -= t[0]
    run = ss.propagate(craft, 0.03 * rng.normal(size=3), _sun(rng), None, t)
    power = ss.panel_power(craft, run["sun_B"].values)
    power += 0.03 * rng.normal(size=power.shape) + 7.0 * 0.05 * rng.uniform(size=power.shape) * (
        power == 0
    )
    power[n // 2 : n // 2 + n // 6] = np.abs(0.01 * rng.normal(size=(n // 6, 6)))  # eclipse
    q = run["B_from_N"].values * [-1, -1, -1, 1]
    stamps = [
        str(
            np.datetime64("2026-02-03T04:05:06.000") + np.timedelta64(round(1000 * s), "ms")
        ).replace("T", " ")
        for s in t
    ]
    columns = {"timestamp": stamps} | {
        f"I_{name}": power[:, k].round(3) for k, name in enumerate(FACES)
    }
    columns |= {
        name: q[:, k].round(5) for name, k in (("q_s", 3), ("q_x", 0), ("q_y", 1), ("q_z", 2))
    }
    return Satellite(vehicle, _csv(folder / "six.csv", columns), run)


def four_faces(folder: Path, rng: np.random.Generator, n: int = 60) -> Satellite:
    vehicle = folder / "four.toml"
    vehicle.write_text(_text(FOUR, "px mx py my", "gain_A = 0.5"))
    craft = parse_vehicle(vehicle.read_text(), "four")
    body = ss.Vehicle("truth", inertia_kg_m2=np.diag([0.0021, 0.002, 0.0019]))
    t = np.cumsum(np.round(12 * rng.uniform(0.7, 1.3, n), 3))
    t -= t[0]
    run = ss.propagate(body, 0.03 * rng.normal(size=3), _sun(rng), None, t)
    current = ss.panel_power(craft, run["sun_B"].values)
    current += 0.5 * 0.08 * rng.uniform(size=current.shape)  # the Earth's light
    current[:, 3] *= 0.8  # one string of -y is dead
    warm = np.repeat(20 + 30 * np.sin(t / 500)[:, None], 4, axis=1)
    current *= 1 + 0.0006 * (warm - 28)
    current[rng.uniform(size=n) < 0.15] *= 0.55  # the battery is full
    counts = np.round(current / 0.00025 + 12 + 2 * rng.normal(size=current.shape)).astype(int)
    counts = np.where(counts < 0, counts + 4096, counts)
    counts[7, 1] = 2047
    columns = {"t_ms": (1_760_000_000_000 + np.round(1000 * t)).astype(np.int64)}
    columns |= {f"I_{name}": counts[:, k] for k, name in enumerate("px mx py my".split())}
    columns |= {
        "T_px": [f"{10 * w:.1f}".replace(".", ",") for w in warm[:, 0]],
        "T_mx": (10 * warm[:, 1]).round().astype(int),
    }
    return Satellite(vehicle, _csv(folder / "four.csv", columns, ";"), run)


def wheeled(
    folder: Path, rng: np.random.Generator, n: int = 60, form: str = "parquet", speed: bool = True
) -> Satellite:
    vehicle = folder / "wheel.toml"
    column = 'speed_column = "mw_rpm"\nspeed_scale_rad_s = 0.104719755'
    vehicle.write_text(
        _text(WHEEL, "px mx py my pz mz", "gain_A = 0.8", speed=column if speed else "")
    )
    craft = parse_vehicle(vehicle.read_text(), "wheel")
    t = np.arange(n) * 8.0
    run = ss.propagate(craft, 0.015 * rng.normal(size=3), _sun(rng), 60.0, t)
    current = ss.panel_power(craft, run["sun_B"].values)
    current += 0.004 * rng.normal(size=current.shape) + 0.8 * 0.05 * rng.uniform(
        size=current.shape
    ) * (current == 0)
    gyro = np.degrees(run["omega_B"].values + 3e-4 * rng.normal(size=(n, 3))) + [0.11, -0.19, 0.04]
    columns = {"met": t} | {f"I_{name}": 1000 * current[:, k] for k, name in enumerate(FACES)}
    columns |= {name: gyro[:, k] for k, name in enumerate(("gx", "gy", "gz"))}
    columns |= {"mw_rpm": run["wheel_speed_rad_s"].values[:, 0] / 0.104719755}
    if form == "parquet":
        import pyarrow as pa
        import pyarrow.parquet as pq

        path = folder / "wheel.parquet"
        pq.write_table(pa.table(columns), path)
    elif form == "netcdf":
        path = folder / "wheel.nc"
        data = xr.Dataset(
            {name: ("time", value) for name, value in columns.items()}, attrs={"title": "synthetic"}
        )
        data.to_netcdf(path, engine="h5netcdf")
    else:
        path = _csv(folder / "wheel.csv", columns)
    return Satellite(vehicle, path, run)
