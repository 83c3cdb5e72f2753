"""Other columns, axes and signs for a pass that does not fit as the vehicle file has them.

One list of changes is tried: two panels' columns exchanged, a panel or a wheel reversed, a second sensor's axes permuted or
reversed, a quaternion read the other way. A change is named only if the file as it is written does not fit, the change does, and is
better by :data:`CLEARLY` in log evidence; so a file that fits is never accused. Changes that look the same in the telemetry
(:mod:`sunspin.estimation.equivalence`) are named together, each with its motion, and none is recommended.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Any, NamedTuple

import numpy as np
import tomlkit
import xarray as xr

from sunspin.estimation.budget import Budget
from sunspin.estimation.equivalence import (
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
from sunspin.estimation.settings import FIELD_TURN
from sunspin.telemetry.sun import signals
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.planes import sphere
from sunspin.vehicle.sensors import VARIABLES, Attitude, ThreeAxes

MOST_SQUARE = 30.0
"""Squared distance up to which a reading of a second sensor, or a sample of panels, counts against a change: some are spikes."""

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
    """A change that fits, with the rate (3) in rad/s that it gives, if that is known."""

    change: Change
    omega: np.ndarray | None = None


@dataclass(frozen=True)
class Better:
    """The changes that fit better than the file as it is written, all those that the telemetry cannot distinguish.

    `gain`: by how much their log evidence is better; `at_s`: the time of their rates; `fits`: whether they fit, or only fit better.
    """

    named: tuple[Named, ...]
    gain: float
    at_s: float = np.nan
    fits: bool = True

    def words(self, clock: Callable[[float], str] = lambda t: f"{t:.0f} s") -> str:
        """Return a sentence for the verdict; `clock`: function from a time of the telemetry (s) to its words."""
        better = f"the data fit {'' if self.fits else 'better '}with"
        gain = f"(log evidence better by {self.gain:.0f})"
        if len(self.named) == 1:
            change = self.named[0].change
            do = f"; if it is so, {change.do}" if change.do else ""
            signs = change.reversed_wheels and not change.columns
            check = "CHECK THE SIGNS" if signs else "CHECK THE COLUMNS"
            return f"{better} {change.what} {gain}: {check}{do}"
        shown = [f"({chr(97 + k)}) {_line(one)}" for k, one in enumerate(self.named[:MOST_NAMED])]
        more = len(self.named) - len(shown)
        others = f"; and {more} other changes" if more else ""
        at = f" at {clock(self.at_s)}" if np.isfinite(self.at_s) else ""
        return (
            f"{better} each of {len(self.named)} changes, and this telemetry cannot tell which is right {gain}: {'; '.join(shown)}"
            f"{others} (rates{at}): CHECK THE COLUMNS, find out which one is right before you change the file"
        )


def _line(one: Named) -> str:
    """Return a change of several in words, with its rate."""
    do = f" ({one.change.do})" if one.change.axes or one.change.reversed_wheels else ""
    if one.omega is None:
        return f"{one.change.what}{do}"
    rate = ", ".join(f"{value:z.2f}" for value in np.degrees(one.omega))
    return f"{one.change.what}{do}: omega ({rate}) deg/s"


@dataclass(frozen=True)
class Culprit:
    """The sensor without which the others agree, and that no other columns or axes of it explain."""

    sensor: str

    def words(self, clock: Callable[[float], str] | None = None) -> str:
        """Return a sentence for the verdict; no time is in it."""
        del clock
        option = "attitude" if self.sensor == "quaternion" else self.sensor
        return (
            f"without the {self.sensor} the other readings fit: look at its zero, scale, columns and clock (`--without {option}` "
            "gives the rates of the others)"
        )


@dataclass(frozen=True)
class Trials:
    """How changes are judged: `evidence` by a quick search, `run` by the whole estimate, None without a result; the `budget`."""

    evidence: Callable[[Vehicle, xr.Dataset], float]
    run: Callable[[Vehicle, xr.Dataset], xr.Dataset | None]
    budget: Budget

    def fitting(self, vehicle: Vehicle, telemetry: xr.Dataset) -> xr.Dataset | None:
        """Return the estimate, if it fits."""
        result = self.run(vehicle, telemetry)
        return result if result is not None and bool(result["fits"].values.all()) else None


def what_fits_better(
    observed: Observed, telemetry: xr.Dataset, trials: Trials
) -> Better | Culprit | None:
    """Return the changes that fit the telemetry of a pass which does not fit as written; else the sensor in the way; else None."""
    culprit: Better | Culprit | None = None
    for name in SENSORS:
        if name not in telemetry or not np.isfinite(telemetry[name].values).any():
            continue
        if trials.budget.exhausted():
            break
        motion = trials.fitting(observed.vehicle, telemetry.drop_vars(name))
        if motion is None:
            continue
        better = _other_axes(observed, telemetry, name, motion, trials)
        if better is not None:
            return better
        if culprit is None:
            exchanged = _exchanged_by_sensor(observed, telemetry, name, motion, trials)
            culprit = exchanged or Culprit(SENSORS[name])
    if culprit is not None or not observed.panels:
        return culprit
    return _other_panels(observed, telemetry, trials)


# ------------------------------------------------------------------------------------------------------ columns of panels, wheels


def _other_panels(observed: Observed, telemetry: xr.Dataset, trials: Trials) -> Better | None:
    """Return changes of columns, panels and wheels that fit.

    Of each class that looks the same one is tried, by a quick search and then in full. First those of one mistake, then a
    mistake of the columns together with reversed wheels.
    """
    vehicle = observed.vehicle
    stated = trials.evidence(vehicle, telemetry)
    if not np.isfinite(stated):
        return None
    columns = column_changes(vehicle, telemetry)
    wheels = wheel_changes(vehicle) if len(observed.momenta) else []
    every = [AS_WRITTEN, *columns, *wheels]
    cost = sample_costs(vehicle, telemetry, every)
    order = np.argsort(cost, kind="stable")
    near = [int(k) for k in order if k and cost[k] <= cost[1:].min() + WORTH_A_SEARCH]
    likely = [(every[k], float(cost[k])) for k in near]
    names = [wheel.name for wheel in vehicle.wheels]
    both = [
        (change.with_wheels(wheel.reversed_wheels, names), of_samples)
        for change, of_samples in likely
        if change.columns
        for wheel in wheels
    ]
    for level in (likely, both):
        better = _best_of(observed, telemetry, level, float(cost[0]), stated, trials)
        if better is not None:
            return better
    return None


def _best_of(
    observed: Observed,
    telemetry: xr.Dataset,
    level: Sequence[tuple[Change, float]],
    cost_as_written: float,
    stated: float,
    trials: Trials,
) -> Better | None:
    """Return the best of some changes, given with what they cost the samples, and all that look the same, if they fit.

    `cost_as_written`: what the file as it is written costs the samples; `stated`: its log evidence.
    """
    known = [(AS_WRITTEN, cost_as_written)]
    for change, cost in level:  # what looks the same has the same dark panels, and so the same cost
        same = (other for other, of_other in known if abs(cost - of_other) < CLEARLY)
        if not any(len(equivalence(observed, other, change)) for other in same):
            known.append((change, cost))
    classes = [change for change, _ in known[1:]]
    gains = np.full(len(classes), -np.inf)
    for k, change in enumerate(classes):
        if trials.budget.exhausted():
            break
        gains[k] = trials.evidence(*change.applied(observed.vehicle, telemetry)) - stated
    ranked = [int(k) for k in np.argsort(-gains, kind="stable") if gains[k] > CLEARLY]

    named: list[Named] = []
    best, at_s = -np.inf, np.nan
    for k in ranked[:MOST_RUNS]:
        if gains[k] < best - CLEARLY:
            break
        result = trials.fitting(*classes[k].applied(observed.vehicle, telemetry))
        if result is not None:
            best, at_s = max(best, float(gains[k])), rate_in_the_middle(result)[1]
            named += with_equivalents(observed, classes[k], result, [one for one, _ in level])
    return Better(tuple(named), best, at_s) if named else None


def with_equivalents(
    observed: Observed, change: Change, result: xr.Dataset, others: Sequence[Change]
) -> list[Named]:
    """Return a change and all others that look the same, with their rates; `result`: the estimate with the change."""
    omega, _ = rate_in_the_middle(result)
    seen = replace(observed, sun_B=np.nan_to_num(result["sun_B"].values))
    same = alike(seen, change, [one for one in others if one.what != change.what])
    return [Named(change, omega), *(Named(one, rate_under(m, omega)) for one, m in same)]


def rate_in_the_middle(result: xr.Dataset) -> tuple[np.ndarray, float]:
    """Return the rate (3) in rad/s at the sample nearest to the middle of a result, and its time in s."""
    t = result["time"].values
    at = int(np.argmin(np.abs(t - (t[0] + t[-1]) / 2)))
    return result["omega_B"].values[at], float(t[at])


def implausible(vehicle: Vehicle, telemetry: xr.Dataset) -> bool:
    """Return whether the samples, each by itself, fit some change of columns far better than the file as it is written."""
    cost = sample_costs(vehicle, telemetry, [AS_WRITTEN, *column_changes(vehicle, telemetry)])
    return bool(cost[0] > cost.min() + WORTH_A_SEARCH)


def sample_costs(vehicle: Vehicle, telemetry: xr.Dataset, changes: Sequence[Change]) -> np.ndarray:
    """Return the log likelihood (m) that samples lose under each change, each by itself in the best direction of the Sun.

    The brightness of each sample is free, up to :data:`BRIGHTEST`.
    """
    sun, gains = sphere(DIRECTIONS), vehicle.input_gains
    stride = -(-max(telemetry.sizes["time"], 1) // MOST_COMPARED)
    telemetry = telemetry.isel(time=slice(None, None, stride))
    noise = 0.0 if vehicle.input_noise is None else (vehicle.input_noise / gains).max()
    error = float(np.hypot(READING_ERROR, noise))
    lit = (np.nan_to_num(signals(telemetry)) > error * gains.max()).any(axis=1)
    squares = []
    for change in changes:
        changed, data = change.applied(vehicle, telemetry.isel(time=lit))
        read = np.nan_to_num(signals(data)) / gains
        light = changed.response_in().power(sun) / gains
        # |read - level * light|^2 of each sample (n) and direction (d), first at the best level
        size, along = np.maximum((light**2).sum(axis=1), 1e-12), read @ light.T
        whole = (read**2).sum(axis=1)[:, None]
        free = np.maximum(along, 0.0) / size
        best = np.argmin(whole - free * np.maximum(along, 0.0), axis=1)
        scale = 1.0
        if vehicle.gain_unit is None and len(read):
            scale = float(np.quantile(free[np.arange(len(read)), best], 0.9))
        level = np.minimum(free, BRIGHTEST * scale)
        squares.append((whole + level * (level * size - 2 * along)).min(axis=1) / error**2)
    each = np.array(squares)
    if not each.size:
        return np.zeros(len(changes))
    # the Earth's light may be more than that error
    each /= max(1.0, float(np.median(each, axis=1).min()) / len(gains))
    return np.minimum(each, MOST_SQUARE).sum(axis=1) / 2


# ------------------------------------------------------------------------------------------------------------------ other sensors


def signed_axes() -> Iterator[tuple[str, list[int], tuple[float, ...]]]:
    """Yield the 48 ways to read three columns as axes: in words, with column and sign of each axis; the stated one first."""
    for order in permutations(range(3)):
        for sign in product((1.0, -1.0), repeat=3):
            axes = ", ".join(
                f"{'-' if s < 0 else '+'}{'xyz'[k]}" for k, s in zip(order, sign, strict=True)
            )
            yield f"read as ({axes}) of its columns", list(order), sign


def axes_matrix(order: Sequence[int], sign: Sequence[float]) -> np.ndarray:
    """Return the matrix (3, 3) that reads columns in this order and with these signs."""
    return np.eye(3)[list(order)] * np.array(sign)[:, None]


def to_write(table: str, keys: Mapping[str, Any]) -> str:
    """Return what to do, in words: the keys of a table of the vehicle file that say how a sensor is read."""
    lines = " and ".join(tomlkit.dumps(keys).splitlines())
    return f"set {lines} under [{table}] of the vehicle file"


def changes_of_sensor(vehicle: Vehicle, name: str) -> list[Change]:
    """Return the 48 signed permutations of a sensor's axes, or the four readings of a quaternion; the stated one first."""
    table = TABLES[name]
    part = vehicle.sensors.with_columns[table]
    ways = _readings(part) if isinstance(part, Attitude) else _axes(part)
    return [
        Change(f"the {SENSORS[name]} {what}", axes={name: matrix}, do=to_write(table, keys))
        for what, matrix, keys in ways
    ]


def _axes(sensor: ThreeAxes) -> Iterator[tuple[str, np.ndarray, dict[str, Any]]]:
    """Yield ways to read axes: in words, the matrix (3, 3) by which values are multiplied, and keys of the vehicle file."""
    for what, order, sign in signed_axes():
        yield what, axes_matrix(order, sign), sensor.keys_for_axes(order, sign)


def _readings(sensor: Attitude) -> Iterator[tuple[str, np.ndarray, dict[str, Any]]]:
    """Yield ways to read quaternions (scalar last, B_from_N as the vehicle file has them), with matrices (4, 4)."""
    scalar_first = np.eye(4)[[3, 0, 1, 2]]  # what stands last is the first of its columns
    inverse = np.diag([-1.0, -1.0, -1.0, 1.0])
    yield "read as the file states", np.eye(4), sensor.keys_for_convention(False, False)
    turned_round = "read the other way round (B_to_N for N_to_B)"
    yield turned_round, inverse, sensor.keys_for_convention(False, True)
    other_end = "with its scalar at the other end"
    yield other_end, scalar_first, sensor.keys_for_convention(True, False)
    both = f"{other_end} and read the other way round"
    yield both, inverse @ scalar_first, sensor.keys_for_convention(True, True)


def _other_axes(
    observed: Observed, telemetry: xr.Dataset, name: str, motion: xr.Dataset, trials: Trials
) -> Better | None:
    """Return other axes of one sensor, judged by the motion of all others, with exchanged columns that look the same."""
    vehicle = observed.vehicle
    changes = changes_of_sensor(vehicle, name)
    read = telemetry[name].sel(time=motion["time"].values).values
    costs = np.array([_cost(motion, read @ one.axes[name].T, name, vehicle) for one in changes])
    best = int(np.argmin(costs))
    gain = float(costs[0] - costs[best])  # the first is the stated one
    if not gain > CLEARLY:
        return None
    result = trials.fitting(*changes[best].applied(vehicle, telemetry))
    if result is None:
        return None
    ties = [
        int(k)
        for k in np.flatnonzero(costs < costs[best] + CLEARLY)
        if k != best and costs[0] - costs[k] > CLEARLY
    ]
    ties.sort(key=lambda k: -np.trace(changes[k].axes[name]))
    omega, at_s = rate_in_the_middle(result)
    others = [*column_changes(vehicle, telemetry), *wheel_changes(vehicle)]
    named = with_equivalents(observed, changes[best], result, others)
    return Better((*named, *(Named(changes[k], omega) for k in ties)), gain, at_s)


def _exchanged_by_sensor(
    observed: Observed, telemetry: xr.Dataset, name: str, motion: xr.Dataset, trials: Trials
) -> Better | None:
    """Return changes of columns that only the sensor `name` can see, if it fits the motion as they show it.

    `motion`: without that sensor, whose readings contradict it.
    """
    vehicle = observed.vehicle
    sun = np.nan_to_num(motion["sun_B"].values)
    without = replace(observed, sensors=observed.sensors - {name}, sun_B=sun)
    changes = alike(without, AS_WRITTEN, column_changes(vehicle, telemetry))
    read = telemetry[name].sel(time=motion["time"].values).values
    motions = [motion, *(_mapped(motion, matrix) for _, matrix in changes)]
    costs = np.array([_cost(one, read, name, vehicle) for one in motions])
    best = int(np.argmin(costs))
    gain = float(costs[0] - costs[best])
    if not gain > CLEARLY:
        return None
    result = trials.fitting(*changes[best - 1][0].applied(vehicle, telemetry))
    if result is None:
        return None
    omega, at_s = rate_in_the_middle(result)
    near = [int(k) for k in np.argsort(costs) if costs[k] < costs[best] + CLEARLY and k]
    to_best = changes[best - 1][1].T
    named = [Named(changes[k - 1][0], rate_under(changes[k - 1][1] @ to_best, omega)) for k in near]
    return Better(tuple(named), gain, at_s)


def _mapped(motion: xr.Dataset, matrix: np.ndarray) -> xr.Dataset:
    """Return the motion of a body that a rotation or mirror (3, 3) has mapped."""
    # imported late: `check`, which names the ways of a sensor, does not wait for it
    from scipy.spatial.transform import Rotation

    attitude = matrix @ Rotation.from_quat(motion["B_from_N"].values).as_matrix() @ matrix.T
    return motion.assign(
        omega_B=(motion["omega_B"].dims, rate_under(matrix, motion["omega_B"].values)),
        B_from_N=(motion["B_from_N"].dims, Rotation.from_matrix(attitude).as_quat()),
    )


def _cost(motion: xr.Dataset, value: np.ndarray, name: str, vehicle: Vehicle) -> float:
    """Return the log likelihood that readings (n, 3 or 4) of a sensor lose along a motion, the square of each bounded."""
    return float(np.minimum(_squares(motion, value, name, vehicle), MOST_SQUARE).sum() / 2)


def _squares(motion: xr.Dataset, value: np.ndarray, name: str, vehicle: Vehicle) -> np.ndarray:
    """Return squared distances, in sigmas, of a sensor's readings (n, 3 or 4) from a motion, where both are known.

    Those of a field and of an attitude are changes from sample to sample: their frame in space is not known.
    """
    from scipy.spatial.transform import Rotation

    sensors = vehicle.sensors
    known = np.asarray(np.isfinite(value).all(axis=1))
    inside = motion["pass_of"].values[1:] == motion["pass_of"].values[:-1]
    pairs = inside & known[1:] & known[:-1]
    if name == "gyro_B" and sensors.gyro is not None:
        gyro = sensors.gyro
        spread = np.einsum("nii->ni", motion["omega_cov_B"].values)
        zero, scale = gyro.scale_rad_s * gyro.zero_sigma, gyro.scale_sigma / gyro.scale_rad_s
        own = gyro.noise_rad_s**2 + zero**2 + (value * scale) ** 2
        return ((value - motion["omega_B"].values) ** 2 / (spread + own)).sum(axis=1)[known]
    turned = Rotation.from_quat(motion["B_from_N"].values)
    magnetometer = sensors.magnetometer
    if name == "field_B" and magnetometer is not None and magnetometer.noise is not None:
        in_space = turned.inv().apply(np.where(known[:, None], value, 0.0))
        strength = np.linalg.norm(in_space[:-1], axis=1)
        turning = FIELD_TURN * np.diff(motion["time"].values) * strength
        spread = 2 * magnetometer.noise**2 + turning**2
        return ((np.diff(in_space, axis=0) ** 2).sum(axis=1) / spread)[pairs]
    if name == "attitude_B_from_N" and sensors.attitude is not None:
        read = Rotation.from_quat(np.where(known[:, None], value, [0.0, 0.0, 0.0, 1.0]))
        off = ((read[1:] * read[:-1].inv()).inv() * (turned[1:] * turned[:-1].inv())).magnitude()
        return (off / (np.sqrt(2) * sensors.attitude.sigma_rad))[pairs] ** 2
    return np.zeros(0)
