"""Which column is which: checked against the motion and not believed, where the wiring as stated does not fit.

One list of changes is tried: two panels' columns exchanged, a panel or a wheel reversed, a second sensor's axes permuted or
reversed, a quaternion read the other way. A change is named only where the file as written does not fit, the change does, and is
better by `CLEARLY` in log evidence; so a file that fits is never accused. Changes that look the same in the telemetry
(:mod:`sunspin.estimate.equivalence`) are named together, each with its motion, and none is recommended.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import permutations, product
from typing import Any, NamedTuple

import numpy as np
import tomlkit
import xarray as xr

from sunspin.estimate.effort import may_go_on
from sunspin.estimate.equivalence import (
    AS_WRITTEN,
    CLEARLY,
    Change,
    Observed,
    alike,
    column_changes,
    equivalence,
    rate_under,
    wheel_changes,
)
from sunspin.telemetry.sun import signals
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.planes import sphere
from sunspin.vehicle.sensors import VARIABLES, Attitude, ThreeAxes

MOST_SQUARE = 30.0
"""No reading of a second sensor, and no sample of panels, speaks more against a change than this squared distance: some are
spikes."""

SENSORS = {"gyro_B": "gyro", "field_B": "magnetometer", "attitude_B_from_N": "quaternion"}
"""Variable of the telemetry -> what a person calls it."""

TABLES = {variable: table for table, variable in VARIABLES.items()}
"""Variable of the telemetry -> the sensor's table in the vehicle file."""

DIRECTIONS, READING_ERROR = 3000, 0.06
"""Directions of the Sun in which samples are compared with the panels, 3.5 degrees apart, and the error of a reading there, as a
share of full Sun: half of that distance, and gains."""

BRIGHTEST = 1.15
"""Brightness of a sample, in full Suns, that panels may show at most. There is no lower limit, since a full battery dims samples:
with one of 0.85 four right passes of skCUBE seemed to have a reversed panel, and of simulated exchanges no more were seen."""

WORTH_A_SEARCH = 30.0
"""Log likelihood of the samples, each by itself, by which a change may be worse than the best and is still searched with: of 60
files with two columns exchanged the right change was at most 0.8 from the best."""

MOST_COMPARED = 60
"""Samples that are compared so, evenly chosen."""

MOST_RUNS = 3
"""Changes that are estimated in full, at most."""

MOST_NAMED = 6
"""Changes that are named, at most; of others the number is given."""


class Named(NamedTuple):
    """A change that fits, with the rate (3) rad/s that it gives; None where that is not known."""

    change: Change
    omega: np.ndarray | None = None


class Better(NamedTuple):
    """The changes that fit where the file as written does not, all those that the telemetry cannot tell apart, and by how much
    their log evidence is better; `at_s`: the time of their rates; `fits`: whether they fit, or only fit better."""

    named: tuple[Named, ...]
    gain: float
    at_s: float = np.nan
    fits: bool = True

    def words(self, clock: Callable[[float], str] = lambda t: f"{t:.0f} s") -> str:
        """For the verdict; `clock`: a time of the telemetry (s) as a person reads it."""
        better = f"the data fit {'' if self.fits else 'better '}with"
        gain = f"(log evidence better by {self.gain:.0f})"
        if len(self.named) == 1:
            one = self.named[0].change
            do = f"; if it is so, {one.do}" if one.do else ""
            check = (
                "CHECK THE SIGNS"
                if one.reversed_wheels and not one.columns
                else "CHECK THE COLUMNS"
            )
            return f"{better} {one.what} {gain}: {check}{do}"
        shown = [
            f"({chr(97 + k)}) {self._line(one, clock)}"
            for k, one in enumerate(self.named[:MOST_NAMED])
        ]
        more = len(self.named) - len(shown)
        others = f"; and {more} other changes" if more else ""
        at = f" at {clock(self.at_s)}" if np.isfinite(self.at_s) else ""
        return (
            f"{better} each of {len(self.named)} changes, and this telemetry cannot tell which is right {gain}: {'; '.join(shown)}"
            f"{others} (rates{at}): CHECK THE COLUMNS, find out which one is right before you change the file"
        )

    @staticmethod
    def _line(one: Named, clock: Callable[[float], str]) -> str:
        do = f" ({one.change.do})" if one.change.axes or one.change.reversed_wheels else ""
        if one.omega is None:
            return f"{one.change.what}{do}"
        rate = ", ".join(f"{value:z.2f}" for value in np.degrees(one.omega))
        return f"{one.change.what}{do}: omega ({rate}) deg/s"


class Culprit(NamedTuple):
    """The sensor without which the others agree, where no other wiring of it does."""

    sensor: str

    def words(self, clock: Callable[[float], str] | None = None) -> str:
        """For the verdict."""
        return (
            f"without the {self.sensor} the other readings fit: look at its zero, scale, columns and clock (`--without "
            f"{'attitude' if self.sensor == 'quaternion' else self.sensor}` gives the rates of the others)"
        )


Evidence = Callable[[Vehicle, xr.Dataset], float]
Run = Callable[[Vehicle, xr.Dataset], xr.Dataset | None]


def signed_axes() -> Iterator[tuple[str, list[int], tuple[float, ...]]]:
    """The 48 ways to read three columns as axes, in words, with the column and the sign of each axis; the stated one first."""
    for order in permutations(range(3)):
        for sign in product((1.0, -1.0), repeat=3):
            axes = ", ".join(
                f"{'-' if s < 0 else '+'}{'xyz'[k]}" for k, s in zip(order, sign, strict=True)
            )
            yield f"read as ({axes}) of its columns", list(order), sign


def to_write(table: str, keys: Mapping[str, Any]) -> str:
    """What to do, in words: the keys of a table of the vehicle file that say how a sensor is read."""
    lines = " and ".join(tomlkit.dumps(keys).splitlines())
    return f"set {lines} under [{table}] of the vehicle file"


def axes_matrix(order: list[int], sign: tuple[float, ...]) -> np.ndarray:
    """The matrix (3, 3) that reads columns so."""
    return np.eye(3)[order] * np.array(sign)[:, None]


def of_sensor(vehicle: Vehicle, name: str) -> list[Change]:
    """The 48 signed permutations of a sensor's axes, or the four readings of a quaternion; the stated one first."""
    table = TABLES[name]
    read = (_readings if table == "attitude" else _axes)(vehicle.sensors.with_columns[table])
    return [
        Change(f"the {SENSORS[name]} {what}", axes={name: matrix}, do=to_write(table, keys))
        for what, matrix, keys in read
    ]


Read = Iterator[tuple[str, np.ndarray, dict[str, Any]]]
"""In words, the matrix (3, 3) or (4, 4) by which the values are multiplied, and the keys of the vehicle file that say it."""


def _axes(sensor: ThreeAxes) -> Read:
    for what, order, sign in signed_axes():
        yield what, axes_matrix(order, sign), sensor.keys_for_axes(order, sign)


def _readings(sensor: Attitude) -> Read:
    """Of quaternions, scalar last, B_from_N, as the vehicle file states them."""
    other_scalar = np.eye(4)[[3, 0, 1, 2]]  # what stands last is the first of its columns
    away = np.diag([-1.0, -1.0, -1.0, 1.0])
    yield "read as the file states", np.eye(4), sensor.keys_for_convention(False, False)
    yield (
        "read the other way round (B_to_N for N_to_B)",
        away,
        sensor.keys_for_convention(False, True),
    )
    yield "with its scalar at the other end", other_scalar, sensor.keys_for_convention(True, False)
    yield (
        "with its scalar at the other end and read the other way round",
        away @ other_scalar,
        sensor.keys_for_convention(True, True),
    )


def better(
    vehicle: Vehicle,
    telemetry: xr.Dataset,
    observed: Observed,
    evidence: Evidence,
    run: Run,
    field_turn_rate: float,
) -> Better | Culprit | None:
    """The changes that fit the telemetry of a pass, which does not fit as written; else the sensor that is in the way; else None.

    `observed`: what the pass has read; `evidence`: log evidence of a vehicle and telemetry, by a quick search; `run`: the whole
    estimate, None where there is none; `field_turn_rate`: rad/s at which a magnetometer's field turns in space.
    """
    culprit: Better | Culprit | None = None
    for name in SENSORS:
        if name in telemetry and np.isfinite(telemetry[name].values).any() and may_go_on():
            motion = run(vehicle, telemetry.drop_vars(name))
            if motion is None or not _fits(motion):
                continue
            found = _of_second(observed, telemetry, name, motion, run, field_turn_rate)
            if found is not None:
                return found
            if culprit is None:
                culprit = _of_exchanged(
                    observed, telemetry, name, motion, run, field_turn_rate
                ) or Culprit(SENSORS[name])
    if culprit is not None or not observed.panels:
        return culprit
    return _of_panels(observed, telemetry, evidence, run)


def _of_panels(
    observed: Observed, telemetry: xr.Dataset, evidence: Evidence, run: Run
) -> Better | None:
    """Changes of columns, panels and wheels, one of each class of those that look the same, by quick searches and then in full."""
    vehicle = observed.vehicle
    stated = evidence(vehicle, telemetry)
    if not np.isfinite(stated):
        return None
    columns, wheels = (
        column_changes(vehicle, telemetry),
        wheel_changes(vehicle) if len(observed.momenta) else [],
    )
    every = [AS_WRITTEN, *columns, *wheels]
    cost = _sample_costs(vehicle, telemetry, every)
    near = [
        int(k)
        for k in np.argsort(cost, kind="stable")
        if k and cost[k] <= cost[1:].min() + WORTH_A_SEARCH
    ]
    likely = [(every[k], cost[k]) for k in near]
    names = [wheel.name for wheel in vehicle.wheels]
    both = [
        (one.with_wheels(w.reversed_wheels, names), c)
        for one, c in likely
        if one.columns
        for w in wheels
    ]
    for level in (likely, both):
        changes, known = [one for one, _ in level], [(AS_WRITTEN, cost[0])]
        for one, c in level:  # what looks the same has the same dark panels, and so the same cost
            if not any(
                abs(c - other_c) < CLEARLY and len(equivalence(observed, other, one))
                for other, other_c in known
            ):
                known.append((one, c))
        classes = [one for one, _ in known[1:]]
        gains = [
            evidence(*one.applied(vehicle, telemetry)) - stated if may_go_on() else -np.inf
            for one in classes
        ]
        ranked = sorted(
            (k for k in range(len(classes)) if gains[k] > CLEARLY), key=lambda k: -gains[k]
        )
        named: list[Named] = []
        best, at_s = -np.inf, np.nan
        for k in ranked[:MOST_RUNS]:
            if gains[k] < best - CLEARLY:
                break
            result = run(*classes[k].applied(vehicle, telemetry))
            if result is not None and _fits(result):
                best, at_s = max(best, gains[k]), _middle(result)[1]
                named += _members(observed, classes[k], result, changes)
        if named:
            return Better(tuple(named), best, at_s)
    return None


def _members(
    observed: Observed, change: Change, result: xr.Dataset, others: Sequence[Change]
) -> list[Named]:
    """A change and all others that look the same, with their rates, where the estimate with the change gave a result."""
    omega, _ = _middle(result)
    seen = replace(observed, sun_B=np.nan_to_num(result["sun_B"].values))
    same = alike(seen, change, [one for one in others if one is not change])
    return [Named(change, omega), *(Named(one, rate_under(m, omega)) for one, m in same)]


def _middle(result: xr.Dataset) -> tuple[np.ndarray, float]:
    """Rate (3), rad/s, at the sample nearest to the middle of a result, and its time."""
    t = result["time"].values
    at = int(np.argmin(np.abs(t - (t[0] + t[-1]) / 2)))
    return result["omega_B"].values[at], float(t[at])


def implausible(vehicle: Vehicle, telemetry: xr.Dataset) -> bool:
    """Whether the samples, each by itself, fit some change of columns far better than the file as it is written."""
    cost = _sample_costs(vehicle, telemetry, [AS_WRITTEN, *column_changes(vehicle, telemetry)])
    return bool(cost[0] > cost.min() + WORTH_A_SEARCH)


def _sample_costs(vehicle: Vehicle, telemetry: xr.Dataset, changes: Sequence[Change]) -> np.ndarray:
    """Log likelihood (m), less that of the best conceivable, that samples cost which are each compared by themselves with every
    direction of the Sun under each change."""
    sun, gains = sphere(DIRECTIONS), vehicle.input_gains
    telemetry = telemetry.isel(
        time=slice(None, None, -(-max(telemetry.sizes["time"], 1) // MOST_COMPARED))
    )
    known_scale = vehicle.gain_unit is not None
    noise = 0.0 if vehicle.input_noise is None else (vehicle.input_noise / gains).max()
    error = float(np.hypot(READING_ERROR, noise))
    lit = (np.nan_to_num(signals(telemetry)) > error * gains.max()).any(axis=1)
    squares = []
    for change in changes:
        other, data = change.applied(vehicle, telemetry.isel(time=lit))
        read = np.nan_to_num(signals(data)) / gains
        light = other.response_in().power(sun) / gains
        size, along = np.maximum((light**2).sum(axis=1), 1e-12), read @ light.T
        whole = (read**2).sum(axis=1)[:, None]
        free = np.maximum(along, 0.0) / size
        best = np.argmin(whole - free * np.maximum(along, 0.0), axis=1)
        scale = (
            1.0
            if known_scale or not len(read)
            else float(np.quantile(free[np.arange(len(read)), best], 0.9))
        )
        level = np.minimum(free, BRIGHTEST * scale)
        squares.append((whole + level * (level * size - 2 * along)).min(axis=1) / error**2)
    each = np.array(squares)
    if not each.size:
        return np.zeros(len(changes))
    each /= max(
        1.0, float(np.median(each, axis=1).min()) / len(gains)
    )  # where the Earth's light is more than that error
    return np.minimum(each, MOST_SQUARE).sum(axis=1) / 2


def _fits(result: xr.Dataset | None) -> bool:
    return result is not None and bool(result["fits"].values.all())


def _of_second(
    observed: Observed,
    telemetry: xr.Dataset,
    name: str,
    motion: xr.Dataset,
    run: Run,
    field_turn_rate: float,
) -> Better | None:
    """Other axes of one sensor, judged by the motion that all others tell, with the exchanged columns that look the same."""
    vehicle, others = observed.vehicle, of_sensor(observed.vehicle, name)
    read = telemetry[name].sel(time=motion["time"].values).values
    squares = [
        _squares(motion, read @ one.axes[name].T, name, vehicle, field_turn_rate) for one in others
    ]
    costs = np.array([square.clip(max=MOST_SQUARE).sum() / 2 for square in squares])
    best = int(np.argmin(costs))
    gain = float(costs[0] - costs[best])  # the first is the stated one
    if not gain > CLEARLY:
        return None
    result = run(*others[best].applied(vehicle, telemetry))
    if result is None or not _fits(result):
        return None
    ties = [
        k
        for k in np.flatnonzero(costs < costs[best] + CLEARLY)
        if k != best and costs[0] - costs[k] > CLEARLY
    ]
    ties.sort(key=lambda k: -np.trace(others[k].axes[name]))
    omega, at_s = _middle(result)
    named = _members(
        observed,
        others[best],
        result,
        [*column_changes(vehicle, telemetry), *wheel_changes(vehicle)],
    )
    return Better((*named, *(Named(others[k], omega) for k in ties)), gain, at_s)


def _of_exchanged(
    observed: Observed,
    telemetry: xr.Dataset,
    name: str,
    motion: xr.Dataset,
    run: Run,
    field_turn_rate: float,
) -> Better | None:
    """Changes of columns that the others cannot see, judged by a sensor that the motion without it contradicts: as these changes
    show the motion, it may fit."""
    vehicle = observed.vehicle
    without = replace(
        observed, sensors=observed.sensors - {name}, sun_B=np.nan_to_num(motion["sun_B"].values)
    )
    made = alike(without, AS_WRITTEN, column_changes(vehicle, telemetry))
    value = telemetry[name].sel(time=motion["time"].values).values
    costs = np.array(
        [
            _squares(one, value, name, vehicle, field_turn_rate).clip(max=MOST_SQUARE).sum() / 2
            for one in (motion, *(_mapped(motion, matrix) for _, matrix in made))
        ]
    )
    best = int(np.argmin(costs))
    gain = float(costs[0] - costs[best])
    if not gain > CLEARLY:
        return None
    result = run(*made[best - 1][0].applied(vehicle, telemetry))
    if result is None or not _fits(result):
        return None
    omega, at_s = _middle(result)
    near = [k for k in np.argsort(costs) if costs[k] < costs[best] + CLEARLY and k]
    to_best = made[best - 1][1].T
    return Better(
        tuple(Named(made[k - 1][0], rate_under(made[k - 1][1] @ to_best, omega)) for k in near),
        gain,
        at_s,
    )


def _mapped(motion: xr.Dataset, matrix: np.ndarray) -> xr.Dataset:
    """The motion that a body shows which a rotation or mirror (3, 3) has mapped."""
    from scipy.spatial.transform import Rotation

    attitude = matrix @ Rotation.from_quat(motion["B_from_N"].values).as_matrix() @ matrix.T
    return motion.assign(
        omega_B=(motion["omega_B"].dims, rate_under(matrix, motion["omega_B"].values)),
        B_from_N=(motion["B_from_N"].dims, Rotation.from_matrix(attitude).as_quat()),
    )


def _squares(
    motion: xr.Dataset, value: np.ndarray, name: str, vehicle: Vehicle, field_turn_rate: float
) -> np.ndarray:
    """Squared distances, in sigmas, of a sensor's readings (n, 3 or 4) from a motion, where both are known."""
    from scipy.spatial.transform import Rotation

    sensors, inside = vehicle.sensors, motion["pass_of"].values[1:] == motion["pass_of"].values[:-1]
    known = np.asarray(np.isfinite(value).all(axis=1))
    pairs = inside & known[1:] & known[:-1]
    if name == "gyro_B" and sensors.gyro is not None:
        gyro, spread = sensors.gyro, np.einsum("nii->ni", motion["omega_cov_B"].values)
        own = (
            gyro.noise_rad_s**2
            + (gyro.scale_rad_s * gyro.zero_sigma) ** 2
            + (value * gyro.scale_sigma / gyro.scale_rad_s) ** 2
        )
        return ((value - motion["omega_B"].values) ** 2 / (spread + own)).sum(axis=1)[known]
    turned = Rotation.from_quat(motion["B_from_N"].values)
    if (
        name == "field_B"
        and sensors.magnetometer is not None
        and sensors.magnetometer.noise is not None
    ):
        fixed = turned.inv().apply(np.where(known[:, None], value, 0.0))
        turning = (
            field_turn_rate * np.diff(motion["time"].values) * np.linalg.norm(fixed[:-1], axis=1)
        )
        spread = 2 * sensors.magnetometer.noise**2 + turning**2
        return ((np.diff(fixed, axis=0) ** 2).sum(axis=1) / spread)[pairs]
    if name == "attitude_B_from_N" and sensors.attitude is not None:
        given = Rotation.from_quat(np.where(known[:, None], value, [0.0, 0.0, 0.0, 1.0]))
        off = ((given[1:] * given[:-1].inv()).inv() * (turned[1:] * turned[:-1].inv())).magnitude()
        return (off / (np.sqrt(2) * sensors.attitude.sigma_rad))[pairs] ** 2
    return np.zeros(0)
