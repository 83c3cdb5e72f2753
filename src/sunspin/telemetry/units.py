"""Wrong units of a vehicle file that the samples reveal, each with the key to change.

Panels are compared with their gains and noise (mA read as A); the gyro with how the Sun and the field rotate in body axes;
magnetometer, wheel and temperature with the file's values.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import xarray as xr

from sunspin.telemetry.noise import BRIGHT_QUANTILE
from sunspin.telemetry.sensors import STEEPEST_RAD
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import brightness
from sunspin.vehicle.sensors import Gyro, Magnetometer

UNITS = {"power_W": "W", "current_A": "A"}
"""Quantity of panel readings -> its unit."""

LARGEST = {"W": 2000.0, "A": 100.0}
"""No panel of a spacecraft gives more: readings above are counts, although the file states a scale."""

BEYOND = 30.0
"""Largest ratio between full Sun in the readings and in the vehicle file (or its inverse) that correct units and gains can give. At
Jupiter the ratio is 27."""

THOUSANDS = 4.0
"""A ratio within this factor of a power of 1000 is taken as that power."""

BRIGHTEST = 200
"""Largest number of bright samples used."""

FITS = 0.15
"""Median misfit (Delta) of the brightest samples up to which the Sun made them, and not noise in the dark."""

DISTINCT, LIT_SHARE = 10, 0.2
"""In sunlight there are at least so many different readings, and usually two panels above this share of the largest reading. Counts
of noise have neither."""

LEAST_SAMPLES = 5
"""Smallest number of lit samples from which a unit is judged."""

FINEST = 1e5
"""Largest ratio of readings to their noise that words of 16 bits can hold; a larger one means different units."""

SHUFFLES = 99
"""Number of random orders of the readings among the panels that are compared with the true order. Sunlight must fit better in the
true order than in each of them. Noise, which is independent in each panel, does so in one file of a hundred."""

SHUFFLED, BRIGHT_SHARE = 60, 0.3
"""Samples used for that comparison: at most so many, the brightest of those above this share of a bright reading."""


class WrongUnit(NamedTuple):
    """A unit of the vehicle file that contradicts the readings.

    `what`: the contradiction in words; `table` and `key`: the entry of the vehicle file to change; `value`: its right value, None
    if not known.
    """

    what: str
    table: str
    key: str
    value: float | None = None

    def __str__(self) -> str:
        return self.at("")

    def at(self, line: str) -> str:
        """Return the message, with `line` (text) inserted as the place in the vehicle file."""
        do = f"set {self.key} = {self.value:.6g}" if self.value is not None else f"check {self.key}"
        return f"{self.what}; {do} under [{self.table}]{line} of the vehicle file"


def reading_unit(vehicle: Vehicle, value: np.ndarray) -> str:
    """Return the unit of panel readings (n, n_panel), "W" or "A"; an empty text if the vehicle file does not determine it.

    Gains in W or A determine the unit. With relative gains a stated scale does, unless the readings are too large for the unit: the
    scale may be left over from an example file.
    """
    form, unit = vehicle.telemetry, UNITS[vehicle.telemetry.quantity]
    if vehicle.gain_unit == unit or form.has_voltages:
        return unit
    largest = np.where(np.isfinite(value), value, 0.0).max(axis=1, initial=0.0)
    lit = largest[largest > 0]
    full = float(np.quantile(lit, BRIGHT_QUANTILE)) if lit.size else 0.0
    return unit if "telemetry.scale" in vehicle.facts and full <= LARGEST[unit] else ""


def panel_unit(vehicle: Vehicle, value: np.ndarray) -> WrongUnit | None:
    """Return the wrong unit of panel readings (n, n_panel), compared with gains, stated noise and lit threshold; None if all
    agree."""
    form, unit = vehicle.telemetry, UNITS[vehicle.telemetry.quantity]
    value = np.where(np.isfinite(value), value, 0.0)
    largest = value.max(axis=1, initial=0.0)
    if np.count_nonzero(largest > 0) < LEAST_SAMPLES:
        return None
    if vehicle.gain_unit == unit and (wrong := _compare_with_gains(vehicle, value, largest)):
        return wrong
    other_unit = "one of them is in another unit"
    full = float(np.quantile(largest[largest > 0], BRIGHT_QUANTILE))
    noise = None if vehicle.input_noise is None else float(vehicle.input_noise.max())
    limits = {"noise": noise, "lit_threshold": form.lit_threshold}
    above = [key for key, limit in limits.items() if limit is not None and full < limit]
    if above and _sunlit(vehicle, value, largest):
        key = above[0]
        shown = reading_unit(vehicle, value)
        what = (
            f"the brightest samples ({f'{full:.3g} {shown}'.strip()}) show the Sun but do not reach the stated {key} "
            f"({f'{limits[key]:g} {shown}'.strip()})"
        )
        scales = "scale, voltage_scale" if form.has_voltages else "scale"
        return WrongUnit(f"{what}: {other_unit}", "telemetry", f"{scales} or {key}")
    if noise is not None and full > FINEST * noise:
        times = f"more than {FINEST:g} times the stated noise ({noise:g})"
        what = f"readings of {full:.3g} are {times}, which no telemetry resolves"
        return WrongUnit(f"{what}: {other_unit}", "telemetry", "scale or noise")
    return None


def _compare_with_gains(
    vehicle: Vehicle, value: np.ndarray, largest: np.ndarray
) -> WrongUnit | None:
    """Return the wrong scale of readings (n, n_panel) if full Sun differs from the gains by more than `BEYOND`; else None.

    `largest` (n) is the largest reading of each sample.
    """
    form, gains = vehicle.telemetry, vehicle.input_gains
    share = float(np.quantile((value / gains).max(axis=1)[largest > 0], BRIGHT_QUANTILE))
    if 1 / BEYOND < share < BEYOND:
        return None
    bright = _brightest(value, largest)
    ratio = float(np.median(brightness(vehicle, bright)))
    if 1 / BEYOND < ratio < BEYOND or (ratio < 1 and not _sunlit(vehicle, value, largest)):
        return None
    step = round(np.log10(ratio) / 3)  # the nearest power of 1000
    exact = step != 0 and 1 / THOUSANDS < ratio / 1000.0**step < THOUSANDS
    times = f"{1000.0 ** abs(step):g}" if exact else f"{max(ratio, 1 / ratio):.2g}"
    stated = f"{float(gains.max()):.3g} {UNITS[form.quantity]}"
    what = (
        f"the brightest samples read about {times} times {'more' if ratio > 1 else 'less'} than the stated full signal "
        f"of a panel ({stated}): a wrong unit"
    )
    if form.has_voltages:  # currents or voltages may be at fault
        return WrongUnit(what, "telemetry", "scale or voltage_scale")
    scale = float(f"{form.scale * 1000.0**-step:.6g}") if exact else None
    return WrongUnit(what, "telemetry", "scale", scale)


def _brightest(value: np.ndarray, largest: np.ndarray) -> np.ndarray:
    """Return the readings (m, n_panel) of the samples with the largest readings: at most half of all, so that spikes are few."""
    order = np.argsort(-largest, kind="stable")
    return value[order[: min(BRIGHTEST, max(LEAST_SAMPLES, len(order) // 2))]]


def _sunlit(vehicle: Vehicle, value: np.ndarray, largest: np.ndarray) -> bool:
    """Return whether the Sun made the brightest readings (n, n_panel), and not noise in the dark.

    Their misfit must be small, and smaller than in each of `SHUFFLES` random orders of the readings among the panels. The orders
    are tested for noise that is equal for all panels in the readings' unit, and for noise that is equal as a share of each gain.
    """
    bright = _brightest(value, largest)
    two = np.median((bright > LIT_SHARE * bright.max(axis=1, keepdims=True)).sum(axis=1)) >= 2
    if len(vehicle.inputs) <= 3 or not two or len(np.unique(bright)) < DISTINCT:
        return False
    best = vehicle.response_in().best_direction
    if not float(np.median(best(bright)[1])) < FITS:
        return False
    order = np.argsort(-largest, kind="stable")[:SHUFFLED]
    floor = BRIGHT_SHARE * float(np.quantile(largest, BRIGHT_QUANTILE))
    seen = np.maximum(value[order[largest[order] > floor]], 0.0)
    rng, gains = np.random.default_rng(0), vehicle.input_gains
    for unit in (np.ones_like(gains), gains)[: 1 if np.ptp(gains) == 0 else 2]:
        shuffled = rng.permuted(np.tile(seen / unit, (SHUFFLES, 1)), axis=1) * unit
        misfit = best(np.concatenate([seen, shuffled]))[1].reshape(-1, len(seen))
        square = np.mean(misfit**2, axis=1)
        if not square[0] < square[1:].min():
            return False
    return True


GYRO_FACTORS = {
    "degrees read as radians": np.pi / 180,
    "radians read as degrees": 180 / np.pi,
    "a factor of 1000": 1e-3,
    "a factor of 1000 too little": 1e3,
    "thousandths of a degree read as radians": np.pi / 180e3,
}
"""Unit error of a gyro in words -> factor that converts its readings to rad/s."""

WRONG_RAD, RIGHT_RAD = np.radians(20.0), np.radians(15.0)
"""Median angle between a direction propagated with the gyro and the measured one: a gyro is wrong above the first, right below the
second."""

BETTER = 0.35
"""A factor is accepted if its median angle is at most this share of that without a factor and of that of a body at rest."""

PAIRS, MOST_PAIRS, LAGS = 10, 2000, (1, 2, 4, 8)
"""Pairs of samples that are needed, and used at most, and their distances in samples. A slow body needs long intervals to rotate
far enough."""

TOO_FAST = 3.0
"""Ratio of the gyro's median rate to the largest rate of the vehicle file from which the unit is wrong."""

OFFSET = 30.0
"""Ratio of a magnetometer's stated zero to its readings from which the unit is wrong."""

ABSURD_ACCELERATION = 0.1
"""rad/s2: more than any dipole in a planet's field causes."""

STEEP_SHARE, STEEP_SAMPLES = 0.85, 30
"""Share of a Sun sensor's readings at the steepest angle from which its unit is wrong, and smallest number of readings. The share
is 0.55 for a sensor that continues to read while the Sun is behind it. It is 0.96 for angles spread over 40 degrees to each side,
in degrees read as radians."""

RPM = 60 / (2 * np.pi)
"""One rad/s in revolutions per minute."""

RPM_WITHIN = 0.15
"""Relative tolerance within which the ratio of a wheel's speed to its nominal speed is taken as `RPM`, or as its inverse."""


def wrong_units(
    vehicle: Vehicle, telemetry: xr.Dataset, still_directions: Callable[[], list[np.ndarray]]
) -> list[WrongUnit]:
    """Return all units of sensors, wheels and temperatures that the samples of `read_telemetry` contradict.

    Parameters
    ----------
    still_directions : callable
        Returns measured directions that are fixed in space, as unit vectors (n, 3) in body axes. Called only if there is a gyro,
        which is compared with them.
    """
    sensors, wrong = vehicle.sensors, []
    if sensors.gyro is not None and "gyro_B" in telemetry:
        limit = sensors.disturbance.max_rate_rad_s
        wrong += _check_gyro(sensors.gyro, limit, telemetry, still_directions())
    if sensors.magnetometer is not None and "field_B" in telemetry:
        field, dipole = telemetry["field_B"].values, sensors.disturbance.dipole
        wrong += _check_magnetometer(sensors.magnetometer, dipole, field)
    if "sun_sensor_angle" in telemetry:
        angles = telemetry["sun_sensor_angle"].values[:, :, 0].T
        for sensor, angle in zip(sensors.sun_sensors, angles, strict=True):
            steep = np.abs(angle[np.isfinite(angle)]) >= STEEPEST_RAD
            if len(steep) >= STEEP_SAMPLES and steep.mean() > STEEP_SHARE:
                what = (
                    f"Sun sensor {sensor.name} nearly always reads {np.degrees(STEEPEST_RAD):.0f} degrees or more from its normal: "
                    "degrees read as radians"
                )
                value = sensor.x_scale * np.pi / 180
                wrong.append(WrongUnit(what, "[sun_sensor]", "x_scale", value))
    if "wheel_speed_rad_s" in telemetry:
        speeds = telemetry["wheel_speed_rad_s"].values.T
        for wheel, speed in zip(vehicle.wheels, speeds, strict=True):
            # only the first ones: the wheel may coast down afterwards
            speed = np.abs(speed[np.isfinite(speed)])[:PAIRS]
            known = len(speed) and wheel.speed_rad_s
            ratio = float(np.median(speed)) / abs(wheel.speed_rad_s) if known else 0.0
            for factor in (RPM, 1 / RPM):
                if abs(ratio / factor - 1) < RPM_WITHIN:
                    what = (
                        f"wheel {wheel.name} reads {ratio:.3g} times its nominal speed: "
                        "revolutions a minute taken for rad/s or back"
                    )
                    value = wheel.speed_scale_rad_s / factor
                    wrong.append(WrongUnit(what, "[wheel]", "speed_scale_rad_s", value))
    warmth = telemetry.get("panel_temperature_C")
    if warmth is not None and not np.isfinite(warmth.values).any():
        what = "no reading of the temperature columns is a panel's temperature in degrees Celsius, and none is used"
        wrong.append(WrongUnit(what, "telemetry", "temperature_scale"))
    return wrong


def _check_gyro(
    gyro: Gyro, limit: float | None, telemetry: xr.Dataset, seen: list[np.ndarray]
) -> list[WrongUnit]:
    """Return the wrong unit of a gyro, if there is one.

    Its rates are compared with the rotation of measured directions `seen` (n, 3) that are fixed in space, else with the largest
    rate `limit` (rad/s) of the vehicle file.
    """
    time, rate = telemetry["time"].values, telemetry["gyro_B"].values
    rotations = rotations_between_samples(time, rate)
    # nominal, a body at rest, and with each factor
    hypotheses = [factor * rotations for factor in (1.0, 0.0, *GYRO_FACTORS.values())]
    for lag in LAGS:
        stated, still, *angles = median_direction_errors(time, seen, hypotheses, lag)
        best = int(np.argmin(angles))
        least = min(RIGHT_RAD, BETTER * stated, BETTER * still)
        if stated > WRONG_RAD and angles[best] < least:
            name, factor = list(GYRO_FACTORS.items())[best]
            what = f"with its rates times {factor:.4g} the gyro agrees with the Sun directions, and without it does not: {name}"
            return [WrongUnit(what, "gyro", "scale_rad_s", gyro.scale_rad_s * factor)]
    size = np.linalg.norm(rate[np.isfinite(rate).all(axis=1)], axis=1)
    if limit is None or len(size) < PAIRS or np.median(size) < TOO_FAST * limit:
        return []
    what = f"the gyro reads {np.degrees(np.median(size)):.3g} deg/s, and max_rate_rad_s says at most {np.degrees(limit):.3g} deg/s"
    return [WrongUnit(what, "gyro", "scale_rad_s")]


def rotations_between_samples(time: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Return the rotation vectors (n - 1, 3), rad, between samples of a rate (n, 3) that changes linearly with time."""
    return (rate[1:] + rate[:-1]) / 2 * np.diff(time)[:, None]


def median_direction_errors(
    time: np.ndarray, seen: list[np.ndarray], rotations: list[np.ndarray], lag: int
) -> list[float]:
    """Return for each hypothesis the median angle (rad) between propagated and measured directions that are fixed in space.

    With fewer than `PAIRS` pairs of measured directions, all angles are zero.

    Parameters
    ----------
    seen : list of (n, 3)
        Measured unit vectors in body axes, one array for each direction; NaN without a measurement.
    rotations : list of (n - 1, 3)
        The hypotheses: rotation vectors between successive samples, rad.
    lag : int
        Number of samples over which a direction is propagated.
    """
    from scipy.spatial.transform import Rotation

    n = len(time) - lag
    begin = np.arange(max(n, 0))
    good = np.isfinite(rotations[0]).all(axis=1) & (np.diff(time) > 0)
    good = np.all([good[begin + k] for k in range(lag)], axis=0)
    # of each direction k, the samples from which it is propagated
    pairs = [
        (k, begin[good & np.isfinite(each[begin] + each[begin + lag]).all(axis=1)])
        for k, each in enumerate(seen)
    ]
    pairs = [(k, at[:: -(-len(at) // MOST_PAIRS) or 1]) for k, at in pairs]
    if sum(len(at) for _, at in pairs) < PAIRS:
        return [0.0] * len(rotations)
    at = np.concatenate([at for _, at in pairs])
    first, last = (np.concatenate([seen[k][at + ahead] for k, at in pairs]) for ahead in (0, lag))
    angles = []
    for each in rotations:
        direction = first
        for k in range(lag):
            # in body axes a fixed direction rotates opposite to the body
            direction = Rotation.from_rotvec(-each[at + k]).apply(direction)
        across = np.linalg.norm(np.cross(direction, last), axis=1)
        angles.append(float(np.median(np.arctan2(across, (direction * last).sum(axis=1)))))
    return angles


def _check_magnetometer(
    magnetometer: Magnetometer, dipole: np.ndarray | None, field: np.ndarray
) -> list[WrongUnit]:
    """Return the wrong units of a magnetometer's zero or noise and of the residual dipole, from the field (n, 3) in body axes."""
    field = field[np.isfinite(field).all(axis=1)]
    size = float(np.median(np.linalg.norm(field, axis=1))) if len(field) >= PAIRS else 0.0
    if size == 0:
        return []
    zero, noise = np.linalg.norm(magnetometer.zero), magnetometer.noise
    # back to the readings of the columns, before zero and matrix were applied
    raw = field @ np.linalg.inv(magnetometer.matrix).T * magnetometer.sign + magnetometer.zero
    reading = float(np.median(np.linalg.norm(raw, axis=1)))
    if zero > OFFSET * reading:  # then neither noise nor dipole can be judged
        what = f"the magnetometer reads {reading:.3g} and its stated zero is {zero:.3g}: the zero is in another unit"
        return [WrongUnit(what, "magnetometer", "zero")]
    wrong = []
    if noise is not None and not 0.5 * noise < size < FINEST * noise:
        what = f"the field reads {size:.3g} and its stated noise is {noise:g}: the noise is in another unit than the columns"
        wrong.append(WrongUnit(what, "magnetometer", "noise"))
    if dipole is not None and (turn := np.linalg.norm(dipole) * size) > ABSURD_ACCELERATION:
        what = f"dipole times field is {turn:.2g} rad/s2, more than any dipole's: it is per another unit than the columns"
        wrong.append(WrongUnit(what, "disturbance", "dipole"))
    return wrong
