"""Which column is which: checked against the motion and not believed, where the wiring as stated does not fit.

Two panels' columns exchanged, a panel mounted the other way round, a second sensor's axes permuted or reversed, a quaternion
read the other way: one change at a time. Another wiring is named only where the stated one does not fit, the other does, and is
better by `CLEARLY` in log evidence; so a file that fits is never accused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from itertools import combinations, islice, permutations, product
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from sunspin.estimate.effort import may_go_on
from sunspin.vehicle import Vehicle
from sunspin.vehicle.changes import toml_text
from sunspin.vehicle.sensors import VARIABLES, Attitude, ThreeAxes

CLEARLY = 10.0
"""Log evidence by which another wiring, or a pass without one of its sensors, must be better before that is named."""

MOST = 60
"""Wirings of panels that are tried; ten panels have as many."""

MOST_SQUARE = 30.0
"""No reading of a second sensor speaks more against a motion than this squared distance: some are spikes."""

ALIKE = 0.01
"""Normals that differ by no more than this are of panels that look the same way."""

READINGS = ("power_W", "current_A")
"""What telemetry calls the readings of panels."""

TABLES = {variable: table for table, variable in VARIABLES.items()}
"""Variable of the telemetry -> the sensor's table in the vehicle file."""

SENSORS = {"gyro_B": "gyro", "field_B": "magnetometer", "attitude_B_from_N": "quaternion"}
"""Variable of the telemetry -> what a person calls it."""


class Wiring(NamedTuple):
    """A vehicle and telemetry as they would be if something were wired otherwise, what, in words, and of a sensor what to do."""

    what: str
    vehicle: Vehicle
    telemetry: xr.Dataset
    do: str = ""


class Better(NamedTuple):
    """The wiring that fits where the stated one does not, and by how much its log evidence is better."""

    wiring: Wiring
    gain: float

    @property
    def words(self) -> str:
        """For the verdict."""
        told = f"the data fit with {self.wiring.what} (log evidence better by {self.gain:.0f}): CHECK THE WIRING"
        return f"{told}; if it is so, {self.wiring.do}" if self.wiring.do else told


class Culprit(NamedTuple):
    """The sensor without which the others agree, where no other wiring of it does."""

    sensor: str

    @property
    def words(self) -> str:
        """For the verdict."""
        return (
            f"without the {self.sensor} the other readings fit: look at its zero, scale, columns and clock (`--without "
            f"{'attitude' if self.sensor == 'quaternion' else self.sensor}` gives the rates of the others)"
        )


Evidence = Callable[[Vehicle, xr.Dataset], float]
Run = Callable[[Vehicle, xr.Dataset], xr.Dataset | None]


def of_panels(vehicle: Vehicle, telemetry: xr.Dataset) -> Iterator[Wiring]:
    """Each pair of inputs exchanged, each panel that has one of its own reversed."""
    if not any(name in telemetry for name in READINGS):
        return
    for a, b in combinations(range(len(vehicle.inputs)), 2):
        yield exchanged(vehicle, telemetry, a, b)
    alone = {one.panels[0] for one in vehicle.inputs if len(one.panels) == 1}
    for k, one in enumerate(vehicle.panels):
        if k not in alone:
            continue
        turned = tuple(replace(p, normal_B=-p.normal_B) if i == k else p for i, p in enumerate(vehicle.panels))
        yield Wiring(f"panel {one.name} looking the other way", replace(vehicle, panels=turned), telemetry)


def exchanged(vehicle: Vehicle, telemetry: xr.Dataset, a: int, b: int) -> Wiring:
    """Two inputs with each other's column."""
    name = next(name for name in READINGS if name in telemetry)
    other, panels = telemetry[name].values.copy(), vehicle.input_names
    other[:, [a, b]] = other[:, [b, a]]
    data = telemetry.assign({name: (telemetry[name].dims, other, telemetry[name].attrs)})
    return Wiring(f"the columns of panels {panels[a]} and {panels[b]} exchanged", vehicle, data)


def mirrors(vehicle: Vehicle) -> Iterator[tuple[int, int, np.ndarray]]:
    """Two panels whose exchange mirrors what all of them see, and the mirror (3, 3): no data of panels alone can tell."""
    if any(len(one.panels) > 1 for one in vehicle.inputs):
        return
    normals = np.array([one.normal_B for one in vehicle.panels]).reshape(-1, 3)
    for a, b in combinations(range(len(normals)), 2):
        apart = normals[a] - normals[b]
        if np.linalg.norm(apart) > ALIKE and np.all(np.abs(np.delete(normals, [a, b], axis=0) @ apart) < ALIKE):
            yield a, b, np.eye(3) - 2 * np.outer(apart, apart) / (apart @ apart)


def of_sensor(vehicle: Vehicle, telemetry: xr.Dataset, name: str) -> Iterator[Wiring]:
    """The 48 signed permutations of a sensor's axes, or the four readings of a quaternion; the stated one first."""
    value, table = telemetry[name].values, TABLES[name]
    sensor = vehicle.sensors.with_columns[table]
    for what, other, turned, keys in (_readings if table == "attitude" else _axes)(value, sensor):
        data = telemetry.assign({name: (telemetry[name].dims, other, telemetry[name].attrs)})
        do = to_write(table, keys) + panels_instead(vehicle, telemetry, turned)
        yield Wiring(f"the {SENSORS[name]} {what}", vehicle, data, do)


Read = Iterator[tuple[str, np.ndarray, np.ndarray | None, dict[str, Any]]]
"""In words, the values read so, of axes the matrix that reads them so, and the keys of the vehicle file that say it."""


def signed_axes() -> Iterator[tuple[str, list[int], tuple[float, ...]]]:
    """The 48 ways to read three columns as axes, in words, with the column and the sign of each axis; the stated one first."""
    for order in permutations(range(3)):
        for sign in product((1.0, -1.0), repeat=3):
            axes = ", ".join(f"{'-' if s < 0 else '+'}{'xyz'[k]}" for k, s in zip(order, sign, strict=True))
            yield f"read as ({axes}) of its columns", list(order), sign


def to_write(table: str, keys: Mapping[str, Any]) -> str:
    """What to do, in words: the keys of a table of the vehicle file that say how a sensor is read."""
    return f"set {' and '.join(toml_text({table: dict(keys)}).splitlines()[2:])} under [{table}] of the vehicle file"


def axes_matrix(order: list[int], sign: tuple[float, ...]) -> np.ndarray:
    """The matrix (3, 3) that reads columns so."""
    return np.eye(3)[order] * np.array(sign)[:, None]


def panels_instead(vehicle: Vehicle, telemetry: xr.Dataset, turned: np.ndarray | None) -> str:
    """Which two panels' columns, exchanged, would look the same as axes of the only second sensor that are read by a matrix
    (3, 3), in words: mirrored panels show a mirrored motion, in which rates and field have other signs. Else nothing."""
    others = [name for name in (*VARIABLES.values(), "sun_sensor_B") if name in telemetry and telemetry[name].notnull().any()]
    if turned is None or len(others) > 1:
        return ""
    for a, b, mirror in mirrors(vehicle):
        if min(np.abs(turned - mirror).max(), np.abs(turned + mirror).max()) < ALIKE:
            pair = f"{vehicle.panels[a].name} and {vehicle.panels[b].name}"
            return f", or, which looks the same, the columns of panels {pair} are exchanged: find out which before you set it"
    return ""


def _axes(value: np.ndarray, sensor: ThreeAxes) -> Read:
    for what, order, sign in signed_axes():
        yield what, value[:, order] * sign, axes_matrix(order, sign), sensor.read_as(order, sign)


def _readings(value: np.ndarray, sensor: Attitude) -> Read:
    """`value`: scalar last, B_from_N, as the vehicle file states it."""
    other_scalar = value[:, [3, 0, 1, 2]]  # what stands last is the first of its columns
    away = np.array([-1.0, -1.0, -1.0, 1.0])
    yield "read as stated", value, None, sensor.read_as(False, False)
    yield "read the other way round (B_to_N for N_to_B)", value * away, None, sensor.read_as(False, True)
    yield "with its scalar at the other end", other_scalar, None, sensor.read_as(True, False)
    yield "with its scalar at the other end and read the other way round", other_scalar * away, None, sensor.read_as(True, True)


def better(
    vehicle: Vehicle, telemetry: xr.Dataset, evidence: Evidence, run: Run, field_turn_rate: float
) -> Better | Culprit | None:
    """The wiring that fits the telemetry of a pass, which does not fit as stated; else the sensor that is in the way; else None.

    `evidence`: log evidence of a wiring of panels, by a quick search; `run`: the whole estimate, None where there is none;
    `field_turn_rate`: rad/s at which a magnetometer's field turns in space.
    """
    culprit: Better | Culprit | None = None
    for name in SENSORS:
        if name in telemetry and np.isfinite(telemetry[name].values).any() and may_go_on():
            motion = run(vehicle, telemetry.drop_vars(name))
            if motion is None or not _fits(motion):
                continue
            found = _of_second(vehicle, telemetry, name, motion, run, field_turn_rate)
            if found is not None:
                return found
            if culprit is None:
                culprit = _of_mirrors(vehicle, telemetry, name, motion, run, field_turn_rate) or Culprit(SENSORS[name])
    if culprit is not None:
        return culprit
    others = list(islice(of_panels(vehicle, telemetry), MOST))
    if not others:
        return None
    stated = evidence(vehicle, telemetry)
    if not np.isfinite(stated):
        return None
    gains = np.array([evidence(one.vehicle, one.telemetry) - stated if may_go_on() else -np.inf for one in others])
    best = int(np.argmax(gains))
    if not gains[best] > CLEARLY or not _fits(run(others[best].vehicle, others[best].telemetry)):
        return None
    return Better(others[best], float(gains[best]))


def _fits(result: xr.Dataset | None) -> bool:
    return result is not None and bool(result["fits"].values.all())


def _of_second(
    vehicle: Vehicle, telemetry: xr.Dataset, name: str, motion: xr.Dataset, run: Run, field_turn_rate: float
) -> Better | None:
    """Another wiring of one sensor, judged by the motion that all others tell."""
    others = list(of_sensor(vehicle, telemetry, name))
    read = [one.telemetry[name].sel(time=motion["time"].values).values for one in others]
    costs = np.array([_squares(motion, value, name, vehicle, field_turn_rate).clip(max=MOST_SQUARE).sum() / 2 for value in read])
    best = int(np.argmin(costs))
    gain = float(costs[0] - costs[best])  # the first is the stated one
    if not gain > CLEARLY or not _fits(run(vehicle, others[best].telemetry)):
        return None
    return Better(others[best], gain)


def _of_mirrors(
    vehicle: Vehicle, telemetry: xr.Dataset, name: str, motion: xr.Dataset, run: Run, field_turn_rate: float
) -> Better | None:
    """Two panels exchanged, judged by a sensor that the motion without it contradicts: mirrored, that motion fits the panels."""
    made = [] if not any(one in telemetry for one in READINGS) else list(mirrors(vehicle))
    value = telemetry[name].sel(time=motion["time"].values).values
    costs = [
        _squares(one, value, name, vehicle, field_turn_rate).clip(max=MOST_SQUARE).sum() / 2
        for one in (motion, *(_mirrored(motion, mirror) for _, _, mirror in made))
    ]
    best = int(np.argmin(costs))
    gain = float(costs[0] - costs[best])
    if not gain > CLEARLY:
        return None
    a, b, _ = made[best - 1]
    other = exchanged(vehicle, telemetry, a, b)
    return Better(other, gain) if _fits(run(vehicle, other.telemetry)) else None


def _mirrored(motion: xr.Dataset, mirror: np.ndarray) -> xr.Dataset:
    """The motion that mirrored panels show."""
    attitude = mirror @ Rotation.from_quat(motion["B_from_N"].values).as_matrix() @ mirror
    return motion.assign(
        omega_B=(motion["omega_B"].dims, -motion["omega_B"].values @ mirror.T),
        B_from_N=(motion["B_from_N"].dims, Rotation.from_matrix(attitude).as_quat()),
    )


def _squares(motion: xr.Dataset, value: np.ndarray, name: str, vehicle: Vehicle, field_turn_rate: float) -> np.ndarray:
    """Squared distances, in sigmas, of a sensor's readings (n, 3 or 4) from a motion, where both are known."""
    sensors, inside = vehicle.sensors, motion["pass_of"].values[1:] == motion["pass_of"].values[:-1]
    known = np.asarray(np.isfinite(value).all(axis=1))
    pairs = inside & known[1:] & known[:-1]
    if name == "gyro_B" and sensors.gyro is not None:
        gyro, spread = sensors.gyro, np.einsum("nii->ni", motion["omega_cov_B"].values)
        own = gyro.noise_rad_s**2 + (gyro.scale_rad_s * gyro.zero_sigma) ** 2 + (value * gyro.scale_sigma / gyro.scale_rad_s) ** 2
        return ((value - motion["omega_B"].values) ** 2 / (spread + own)).sum(axis=1)[known]
    turned = Rotation.from_quat(motion["B_from_N"].values)
    if name == "field_B" and sensors.magnetometer is not None and sensors.magnetometer.noise is not None:
        fixed = turned.inv().apply(np.where(known[:, None], value, 0.0))
        turning = field_turn_rate * np.diff(motion["time"].values) * np.linalg.norm(fixed[:-1], axis=1)
        spread = 2 * sensors.magnetometer.noise**2 + turning**2
        return ((np.diff(fixed, axis=0) ** 2).sum(axis=1) / spread)[pairs]
    if name == "attitude_B_from_N" and sensors.attitude is not None:
        given = Rotation.from_quat(np.where(known[:, None], value, [0.0, 0.0, 0.0, 1.0]))
        off = ((given[1:] * given[:-1].inv()).inv() * (turned[1:] * turned[:-1].inv())).magnitude()
        return (off / (np.sqrt(2) * sensors.attitude.sigma_rad))[pairs] ** 2
    return np.zeros(0)
