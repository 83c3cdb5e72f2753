"""Files of made-up satellites, as their operators would write them: vehicle, telemetry, elements. All of it is synthetic.

`six_faces`: a 3U CubeSat, six panels in W, quaternion, eclipse, UTC, CSV. `four_faces`: a 1U, currents in counts of 12 bits that
follow the battery, albedo, a dead string, a temperature column, Unix milliseconds, semicolons. `wheeled`: a microsatellite with a
momentum wheel, currents in mA, gyro in deg/s, mission-elapsed time, Parquet, NetCDF or CSV. `Spinner`: a satellite that spins in
an orbit, with or without what a file may state; its Sun and field are those of `tests/support/orbits.py`, not the package's.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.vehicle.file import parse_vehicle
from tests.support.orbits import EPOCH, sky, two_line_elements
from tests.support.vehicles import FACES as CUBE_FACES
from tests.support.vehicles import unit_vector


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

SHORT_NAMES = {
    name.lower().translate(str.maketrans("+-", "pm")): n for name, n in CUBE_FACES.items()
}


def _text(form: str, names: str, gain: str, **more: str) -> str:
    panels = "\n".join(
        f'[[panel]]\nname = "{name}"\nnormal_B = {SHORT_NAMES[name]}\n{gain}'
        for name in names.split()
    )
    columns = "\n".join(f'{name} = "I_{name}"' for name in names.split())
    return form.format(panels=panels, columns=columns, **more)


def _csv(path: Path, columns: dict[str, object], mark: str = ",") -> Path:
    rows = zip(*columns.values(), strict=True)
    lines = [mark.join(columns), *(mark.join(str(cell) for cell in row) for row in rows)]
    path.write_text("# synthetic: made up for tests\n" + "\n".join(lines) + "\n", "utf-8")
    return path


def six_faces(folder: Path, rng: np.random.Generator, n: int = 90) -> Satellite:
    """Write the files of the 3U CubeSat, `n` samples about 10 s apart."""
    vehicle = folder / "six.toml"
    vehicle.write_text(_text(SIX, "px mx py my pz mz", "gain_W = 7.0"))
    craft = parse_vehicle(vehicle.read_text(), "six")
    t = np.cumsum(np.round(10 * rng.uniform(0.9, 1.1, n), 3))
    t -= t[0]
    run = ss.propagate(craft, 0.03 * rng.normal(size=3), unit_vector(rng), None, t)
    power = ss.panel_power(craft, run["sun_B"].values)
    noise, stray = rng.normal(size=power.shape), rng.uniform(size=power.shape)
    power += 0.03 * noise + 7.0 * 0.05 * stray * (power == 0)
    power[n // 2 : n // 2 + n // 6] = np.abs(0.01 * rng.normal(size=(n // 6, 6)))  # eclipse
    q = run["B_from_N"].values * [-1, -1, -1, 1]
    times = np.datetime64("2026-02-03T04:05:06.000") + np.round(1000 * t).astype("timedelta64[ms]")
    columns = {"timestamp": [str(time).replace("T", " ") for time in times]}
    columns |= {f"I_{name}": power[:, k].round(3) for k, name in enumerate(SHORT_NAMES)}
    columns |= {f"q_{name}": q[:, k].round(5) for name, k in zip("sxyz", (3, 0, 1, 2), strict=True)}
    return Satellite(vehicle, _csv(folder / "six.csv", columns), run)


def four_faces(folder: Path, rng: np.random.Generator, n: int = 60) -> Satellite:
    """Write the files of the 1U, `n` samples about 12 s apart."""
    vehicle = folder / "four.toml"
    vehicle.write_text(_text(FOUR, "px mx py my", "gain_A = 0.5"))
    craft = parse_vehicle(vehicle.read_text(), "four")
    body = ss.Vehicle("truth", inertia_kg_m2=np.diag([0.0021, 0.002, 0.0019]))
    t = np.cumsum(np.round(12 * rng.uniform(0.7, 1.3, n), 3))
    t -= t[0]
    run = ss.propagate(body, 0.03 * rng.normal(size=3), unit_vector(rng), None, t)
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
    columns["T_px"] = [f"{10 * w:.1f}".replace(".", ",") for w in warm[:, 0]]
    columns["T_mx"] = (10 * warm[:, 1]).round().astype(int)
    return Satellite(vehicle, _csv(folder / "four.csv", columns, ";"), run)


def wheeled(
    folder: Path, rng: np.random.Generator, n: int = 60, form: str = "parquet", speed: bool = True
) -> Satellite:
    """Write the files of the microsatellite as "parquet", "netcdf" or "csv"; `speed`: with a column of the wheel speed."""
    vehicle = folder / "wheel.toml"
    column = 'speed_column = "mw_rpm"\nspeed_scale_rad_s = 0.104719755'
    text = _text(WHEEL, "px mx py my pz mz", "gain_A = 0.8", speed=column if speed else "")
    vehicle.write_text(text)
    craft = parse_vehicle(vehicle.read_text(), "wheel")
    t = np.arange(n) * 8.0
    run = ss.propagate(craft, 0.015 * rng.normal(size=3), unit_vector(rng), 60.0, t)
    current = ss.panel_power(craft, run["sun_B"].values)
    noise, stray = rng.normal(size=current.shape), rng.uniform(size=current.shape)
    current += 0.004 * noise + 0.8 * 0.05 * stray * (current == 0)
    gyro = np.degrees(run["omega_B"].values + 3e-4 * rng.normal(size=(n, 3))) + [0.11, -0.19, 0.04]
    columns = {"met": t} | {f"I_{name}": 1000 * current[:, k] for k, name in enumerate(SHORT_NAMES)}
    columns |= {name: gyro[:, k] for k, name in enumerate(("gx", "gy", "gz"))}
    columns |= {"mw_rpm": run["wheel_speed_rad_s"].values[:, 0] / 0.104719755}
    if form == "parquet":
        import pyarrow as pa
        import pyarrow.parquet as pq

        path = folder / "wheel.parquet"
        pq.write_table(pa.table(columns), path)
    elif form == "netcdf":
        path = folder / "wheel.nc"
        data = xr.Dataset({name: ("time", value) for name, value in columns.items()})
        data.assign_attrs(title="synthetic").to_netcdf(path, engine="h5netcdf")
    else:
        path = _csv(folder / "wheel.csv", columns)
    return Satellite(vehicle, path, run)


# -------------------------------------------------------------------------------------------------------------- spinner in orbit

SPINNER_FACES = ["-X", "-Y", "-Z", "+X", "+Y", "+Z"]
GAIN_KEYS = ("relative_gain", "gain_A", "gain_W")
SPIN_AXIS = np.array([0.1, 0.05, 1.0]) / np.linalg.norm([0.1, 0.05, 1.0])


@dataclass(frozen=True)
class Spinner:
    """A spinner and what its files state.

    `faces` with panels; `samples`, `interval_s` apart; spin about nearly z; `noise` relative to full Sun; `key` and size of the
    gains; the `stated` noise (relative to full Sun, None: none); whether readings may be negative, and some missing or zero
    (`outliers`); whether there is a magnetometer, whether the vehicle file has the elements, and whether the Sun is up.
    """

    faces: tuple[str, ...] = ("-X", "-Y", "-Z")
    samples: int = 60
    interval_s: float = 1.0
    rate_deg_s: float = 40.0
    noise: float = 0.0
    key: str = "relative_gain"
    gain: float = 1.0
    stated: float | None = None
    negative: bool = False
    outliers: bool = False
    magnetometer: bool = True
    orbit: bool = False
    lit: bool = True

    @classmethod
    def drawn(cls, seed: int) -> Self:
        """Draw a spinner of any kind."""
        rng = np.random.default_rng(seed)
        faces = tuple(rng.permutation(SPINNER_FACES)[: rng.integers(1, 7)].tolist())
        yes = rng.random(6) < [0.5, 0.3, 0.7, 0.5, 0.85, 0.5]
        return cls(
            faces,
            int(rng.choice([1, 3, 6, 12, 25])),
            float(rng.choice([1.0, 10.0])),
            float(rng.choice([3.0, 40.0])),
            float(rng.choice([0.0, 0.01])),
            str(rng.choice(GAIN_KEYS)),
            float(rng.choice([1.0, 2.5e-3, 900.0])),
            0.015 if yes[5] else None,
            *map(bool, yes[:5]),
        )

    def write(self, folder: Path, seed: int = 0) -> tuple[str, str, str]:
        """Write vehicle file, telemetry and elements into a folder and return their paths."""
        rng, n = np.random.default_rng(seed), self.samples
        elements, t = two_line_elements(rng), self.interval_s * np.arange(n)
        for begin in np.arange(0.0, 6000.0, 200.0):
            sun, field, up, _ = sky(elements, begin, t, 0.0)
            if (up == self.lit).all():
                break
        turn = Rotation.from_rotvec(-t[:, None] * np.radians(self.rate_deg_s) * SPIN_AXIS)
        body = turn * Rotation.random(random_state=seed)
        normals = np.array([CUBE_FACES[face] for face in self.faces], dtype=float)
        full = np.maximum(body.apply(sun) @ normals.T, 0)
        light = full * up[:, None] + self.noise * rng.normal(size=full.shape)
        light += 0.03 * np.abs(rng.normal(size=full.shape)) * up[:, None]  # stray light
        power = self.gain * (light if self.negative else np.maximum(light, 0))
        zero = np.array([0.6, -2.0, 2.2]) * np.linalg.norm(field, axis=1).mean()  # thrice the field
        reading = body.apply(field) + zero + 200 * rng.normal(size=field.shape)
        if self.outliers:
            power[rng.random(power.shape) < 0.1], reading[rng.random(n) < 0.15] = np.nan, 0.0
            reading[rng.random(n) < 0.1] = np.nan
        columns = {face: power[:, k] for k, face in enumerate(self.faces)}
        columns |= {f"m{axis}": reading[:, k] for k, axis in enumerate("xyz") if self.magnetometer}
        rows = [",".join(["time_utc", *columns])]
        for k in range(n):
            utc = (EPOCH + timedelta(seconds=float(begin + t[k]))).isoformat() + "Z"
            cells = (f"{column[k]:.6g}".replace("nan", "") for column in columns.values())
            rows.append(",".join([utc, *cells]))
        folder.mkdir(parents=True, exist_ok=True)
        paths = folder / "vehicle.toml", folder / "telemetry.csv", folder / "my.tle"
        for path, lines in zip(paths, ([self._vehicle(elements)], rows, elements), strict=True):
            path.write_text("\n".join(lines) + "\n", "utf-8")
        vehicle, telemetry, orbit = map(str, paths)
        return vehicle, telemetry, orbit

    def _vehicle(self, elements: tuple[str, str]) -> str:
        gain = 1.0 if self.key == "relative_gain" else self.gain
        parts = ['name = "spinner"', "[body]"]
        parts += ["inertia_kg_m2 = [[0.042, 0, 0], [0, 0.041, 0], [0, 0, 0.008]]"]
        for face in self.faces:
            normal = list(CUBE_FACES[face])
            parts += ["[[panel]]", f'name = "{face}"', f"normal_B = {normal}"]
            parts += [f"{self.key} = {gain}"]
        quantity = "current_A" if self.key == "gain_A" else "power_W"
        parts += ["[telemetry]", f'quantity = "{quantity}"']
        parts += ['time_column = "time_utc"', 'bad_rows = "flag"']
        parts += [] if self.stated is None else [f"noise = {self.stated * self.gain:.6g}"]
        parts += ["[telemetry.columns]", *(f'"{face}" = "{face}"' for face in self.faces)]
        if self.magnetometer:
            parts += ["[magnetometer]", 'columns = ["mx", "my", "mz"]', "scale_T = 1e-9"]
        parts += ["[disturbance]", f"max_rate_rad_s = {1.5 * np.radians(self.rate_deg_s):.4f}"]
        if self.orbit:
            parts += ["[orbit]", f"tle = {list(elements)}".replace("'", '"')]
        return "\n".join(parts)


UNSTATED = Spinner()
"""Coarse Sun sensors on three faces, no noise stated, no reading below zero, at most three panels lit in a sample."""
