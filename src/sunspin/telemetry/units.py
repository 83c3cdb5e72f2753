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
from sunspin.vehicle.parts import Wheel
from sunspin.vehicle.response.panels import brightness
from sunspin.vehicle.sensors import Gyro, Magnetometer, SunSensor

UNITS = {
    "power_W": "W",
    "current_A": "A",
    "elevation_deg": "W",
    "incidence_deg": "W",
    "cosine": "W",
}
"""Quantity of panel readings -> its unit. Angles of the Sun are read as powers of flat panels."""

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

    The unit is certain if the gains are in the unit of the file's `quantity`, or if voltages turn currents into powers. With
    relative gains it is that of `quantity` if the file states `telemetry.scale`, unless the readings of bright samples exceed
    `LARGEST`: then the scale may be left over from an example file. Angles of the Sun have no such unit.
    """
    form, unit = vehicle.telemetry, UNITS[vehicle.telemetry.quantity]
    if form.has_angles:
        return ""
    if vehicle.gain_unit == unit or form.has_voltages:
        return unit
    largest = np.where(np.isfinite(value), value, 0.0).max(axis=1, initial=0.0)  # of each sample
    lit = largest[largest > 0]
    bright = float(np.quantile(lit, BRIGHT_QUANTILE)) if lit.size else 0.0
    states_scale = "telemetry.scale" in vehicle.facts
    return unit if states_scale and bright <= LARGEST[unit] else ""


def panel_unit(vehicle: Vehicle, value: np.ndarray) -> WrongUnit | None:
    """Return the wrong unit of panel readings (n, n_panel), compared with gains, stated noise and lit threshold.

    Returns None if all agree, or if fewer than `LEAST_SAMPLES` samples have a reading above zero.
    """
    form, unit = vehicle.telemetry, UNITS[vehicle.telemetry.quantity]
    value = np.where(np.isfinite(value), value, 0.0)
    largest = value.max(axis=1, initial=0.0)
    if np.count_nonzero(largest > 0) < LEAST_SAMPLES:
        return None
    if vehicle.gain_unit == unit and (wrong := _compare_with_gains(vehicle, value, largest)):
        return wrong
    other_unit = "one of them is in another unit"
    bright = float(np.quantile(largest[largest > 0], BRIGHT_QUANTILE))
    noise = None if vehicle.input_noise is None else float(vehicle.input_noise.max())
    limits = {"noise": noise, "lit_threshold": form.lit_threshold}
    above = [key for key, limit in limits.items() if limit is not None and bright < limit]
    if above and _sunlit(vehicle, value, largest):
        key = above[0]
        known_unit = reading_unit(vehicle, value)  # may be empty
        what = (
            f"the brightest samples ({f'{bright:.3g} {known_unit}'.strip()}) show the Sun but do not reach the stated {key} "
            f"({f'{limits[key]:g} {known_unit}'.strip()})"
        )
        scales = "scale, voltage_scale" if form.has_voltages else "scale"
        return WrongUnit(f"{what}: {other_unit}", "telemetry", f"{scales} or {key}")
    if noise is not None and bright > FINEST * noise:
        times = f"more than {FINEST:g} times the stated noise ({noise:g})"
        what = f"readings of {bright:.3g} are {times}, which no telemetry resolves"
        return WrongUnit(f"{what}: {other_unit}", "telemetry", "scale or noise")
    return None


def _compare_with_gains(
    vehicle: Vehicle, value: np.ndarray, largest: np.ndarray
) -> WrongUnit | None:
    """Return the wrong scale of readings (n, n_panel) if full Sun differs from the gains by more than `BEYOND`; else None.

    `largest` (n) is the largest reading of each sample.
    """
    form, gains = vehicle.telemetry, vehicle.input_gains
    # two estimates of full Sun in the readings over that of the gains: a quick one, which usually suffices, and a careful one
    quick = float(np.quantile((value / gains).max(axis=1)[largest > 0], BRIGHT_QUANTILE))
    if 1 / BEYOND < quick < BEYOND:
        return None
    bright = _brightest(value, largest)
    ratio = float(np.median(brightness(vehicle, bright)))
    # noise of panels in the dark is far below the gains too, and shows no wrong unit
    if 1 / BEYOND < ratio < BEYOND or (ratio < 1 and not _sunlit(vehicle, value, largest)):
        return None
    power = round(np.log10(ratio) / 3)  # exponent of the nearest power of 1000
    is_power = power != 0 and 1 / THOUSANDS < ratio / 1000.0**power < THOUSANDS
    times = f"{1000.0 ** abs(power):g}" if is_power else f"{max(ratio, 1 / ratio):.2g}"
    stated = f"{float(gains.max()):.3g} {UNITS[form.quantity]}"
    what = (
        f"the brightest samples read about {times} times {'more' if ratio > 1 else 'less'} than the stated full signal "
        f"of a panel ({stated}): a wrong unit"
    )
    if form.has_voltages:  # currents or voltages may be at fault
        return WrongUnit(what, "telemetry", "scale or voltage_scale")
    scale = float(f"{form.scale * 1000.0**-power:.6g}") if is_power else None
    return WrongUnit(what, "telemetry", "scale", scale)


def _brightest(value: np.ndarray, largest: np.ndarray) -> np.ndarray:
    """Return the readings (m, n_panel) of the samples with the largest readings: at most half of all, so that spikes are few."""
    order = np.argsort(-largest, kind="stable")
    return value[order[: min(BRIGHTEST, max(LEAST_SAMPLES, len(order) // 2))]]


def _sunlit(vehicle: Vehicle, value: np.ndarray, largest: np.ndarray) -> bool:
    """Return whether the Sun made the brightest of the readings (n, n_panel), and not noise in the dark.

    `largest` (n): largest reading of each sample. Sunlight fits the layout of the panels, and noise does not. So the median misfit
    to the best direction must be below `FITS`. The rms misfit must be smaller than after each of `SHUFFLES` random permutations of
    a sample's readings among the panels. Noise may be equal in all panels, or in proportion to their gains. So the readings are
    permuted as they are, and also divided by the gains; both comparisons must agree.
    """
    bright = _brightest(value, largest)
    # usual number of panels in the light
    n_lit = np.median((bright > LIT_SHARE * bright.max(axis=1, keepdims=True)).sum(axis=1))
    # a direction fits any readings of three panels or fewer; `not >=` is also true for NaN, the median of no samples
    if len(vehicle.inputs) <= 3 or not n_lit >= 2 or len(np.unique(bright)) < DISTINCT:
        return False
    best_direction = vehicle.response_in().best_direction
    _, misfit = best_direction(bright)
    if not float(np.median(misfit)) < FITS:
        return False
    # samples to permute: the brightest ones, if above the part `BRIGHT_SHARE` of a bright reading
    order = np.argsort(-largest, kind="stable")[:SHUFFLED]
    floor = BRIGHT_SHARE * float(np.quantile(largest, BRIGHT_QUANTILE))
    true_order = np.maximum(value[order[largest[order] > floor]], 0.0)
    rng, gains = np.random.default_rng(0), vehicle.input_gains
    # noise of each panel, up to a factor: equal, or in proportion to the gain; equal gains make both cases the same
    equal = np.ones_like(gains)
    for noise_scale in [equal] if np.ptp(gains) == 0 else [equal, gains]:
        readings = np.tile(true_order / noise_scale, (SHUFFLES, 1))
        shuffled = rng.permuted(readings, axis=1) * noise_scale
        _, misfit = best_direction(np.concatenate([true_order, shuffled]))
        # mean square of the samples for each order, the true one first
        square = np.mean(misfit.reshape(-1, len(true_order)) ** 2, axis=1)
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

FEWEST_PAIRS, MOST_PAIRS, LAGS = 10, 2000, (1, 2, 4, 8)
"""Smallest number of pairs of samples between which a direction is propagated, largest number used, and their distances in samples.
A slow body needs long intervals to rotate far enough."""

FEWEST_READINGS = 10
"""Smallest number of readings of a gyro or magnetometer from which its unit is judged."""

FIRST_SPEEDS = 10
"""Number of a wheel's first readings that are compared with its nominal speed; afterwards it may coast down."""

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

RPM_PER_RAD_S = 60 / (2 * np.pi)
"""One rad/s in revolutions per minute."""

RPM_WITHIN = 0.15
"""Relative tolerance within which the ratio of a wheel's speed to its nominal speed is taken as `RPM_PER_RAD_S`, or its inverse."""


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
        x_angles = telemetry["sun_sensor_angle"].values[:, :, 0].T
        for sensor, x_angle in zip(sensors.sun_sensors, x_angles, strict=True):
            wrong += _check_sun_sensor(sensor, x_angle)
    if "wheel_speed_rad_s" in telemetry:
        speeds = telemetry["wheel_speed_rad_s"].values.T
        for wheel, speed in zip(vehicle.wheels, speeds, strict=True):
            wrong += _check_wheel(wheel, speed)
    temperatures = telemetry.get("panel_temperature_C")
    if temperatures is not None and not np.isfinite(temperatures.values).any():
        what = "no reading of the temperature columns is a panel's temperature in degrees Celsius, and none is used"
        wrong.append(WrongUnit(what, "telemetry", "temperature_scale"))
    return wrong


def _check_sun_sensor(sensor: SunSensor, x_angle: np.ndarray) -> list[WrongUnit]:
    """Return the wrong unit of a Sun sensor, if nearly all of its angles `x_angle` (n), rad, are at the limit STEEPEST_RAD.

    Readings are limited to that angle (`telemetry.sensors`), so degrees that are read as radians nearly all end there.
    """
    is_steep = np.abs(x_angle[np.isfinite(x_angle)]) >= STEEPEST_RAD
    if len(is_steep) < STEEP_SAMPLES or is_steep.mean() <= STEEP_SHARE:
        return []
    what = (
        f"Sun sensor {sensor.name} nearly always reads {np.degrees(STEEPEST_RAD):.0f} degrees or more from its normal: "
        "degrees read as radians"
    )
    return [WrongUnit(what, "[sun_sensor]", "x_scale", sensor.x_scale * np.pi / 180)]


def _check_wheel(wheel: Wheel, speed: np.ndarray) -> list[WrongUnit]:
    """Return the wrong unit of a wheel, if its first speeds (n, rad/s) are its nominal speed in revolutions per minute, or back."""
    first_speeds = np.abs(speed[np.isfinite(speed)])[:FIRST_SPEEDS]
    if not len(first_speeds) or not wheel.speed_rad_s:
        return []
    ratio = float(np.median(first_speeds)) / abs(wheel.speed_rad_s)
    for factor in (RPM_PER_RAD_S, 1 / RPM_PER_RAD_S):
        if abs(ratio / factor - 1) < RPM_WITHIN:
            what = (
                f"wheel {wheel.name} reads {ratio:.3g} times its nominal speed: "
                "revolutions a minute taken for rad/s or back"
            )
            scale = wheel.speed_scale_rad_s / factor
            return [WrongUnit(what, "[wheel]", "speed_scale_rad_s", scale)]
    return []


def _check_gyro(
    gyro: Gyro, limit: float | None, telemetry: xr.Dataset, seen: list[np.ndarray]
) -> list[WrongUnit]:
    """Return the wrong unit of a gyro, if there is one.

    Its rates are compared with the rotation of measured directions `seen` (n, 3) that are fixed in space. If these do not
    contradict, they are compared with the largest rate `limit` (rad/s) of the vehicle file.
    """
    time, rate = telemetry["time"].values, telemetry["gyro_B"].values
    rotations = rotations_between_samples(time, rate)
    # with the stated unit, for a body at rest, and with each factor
    hypotheses = [factor * rotations for factor in (1.0, 0.0, *GYRO_FACTORS.values())]
    for lag in LAGS:
        stated_rad, still_rad, *factor_rad = median_direction_errors(time, seen, hypotheses, lag)
        best = int(np.argmin(factor_rad))
        limit_rad = min(RIGHT_RAD, BETTER * stated_rad, BETTER * still_rad)
        if stated_rad > WRONG_RAD and factor_rad[best] < limit_rad:
            name, factor = list(GYRO_FACTORS.items())[best]
            what = f"with its rates times {factor:.4g} the gyro agrees with the Sun directions, and without it does not: {name}"
            return [WrongUnit(what, "gyro", "scale_rad_s", gyro.scale_rad_s * factor)]
    size = np.linalg.norm(rate[np.isfinite(rate).all(axis=1)], axis=1)
    if limit is None or len(size) < FEWEST_READINGS or np.median(size) < TOO_FAST * limit:
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

    With fewer than `FEWEST_PAIRS` pairs of measured directions, all angles are zero.

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

    begin = np.arange(max(len(time) - lag, 0))
    # samples from which all rotations over the next `lag` samples are known, which are the same for all hypotheses
    known = np.isfinite(rotations[0]).all(axis=1) & (np.diff(time) > 0)
    known = np.all([known[begin + k] for k in range(lag)], axis=0)
    starts = []  # of each direction: the samples from which it is propagated
    for direction in seen:
        measured = np.isfinite(direction[begin] + direction[begin + lag]).all(axis=1)
        samples = begin[known & measured]
        starts.append(samples[:: -(-len(samples) // MOST_PAIRS) or 1])
    start = np.concatenate([np.zeros(0, dtype=int), *starts])
    if len(start) < FEWEST_PAIRS:
        return [0.0] * len(rotations)
    first, last = (
        np.concatenate([each[samples + k] for each, samples in zip(seen, starts, strict=True)])
        for k in (0, lag)
    )
    angles = []
    for hypothesis in rotations:
        direction = first
        for k in range(lag):
            # in body axes a fixed direction rotates opposite to the body
            direction = Rotation.from_rotvec(-hypothesis[start + k]).apply(direction)
        sine = np.linalg.norm(np.cross(direction, last), axis=1)
        cosine = (direction * last).sum(axis=1)
        angles.append(float(np.median(np.arctan2(sine, cosine))))
    return angles


def _check_magnetometer(
    magnetometer: Magnetometer, dipole: np.ndarray | None, field: np.ndarray
) -> list[WrongUnit]:
    """Return which values of the vehicle file seem to have a wrong unit: the magnetometer's zero or noise, the residual dipole.

    `field` (n, 3): body axes, unit of the columns, after zero and matrix. `dipole` (3): dipole x field is in rad/s2.
    """
    field = field[np.isfinite(field).all(axis=1)]
    strength = 0.0
    if len(field) >= FEWEST_READINGS:
        strength = float(np.median(np.linalg.norm(field, axis=1)))
    if strength == 0:  # too few readings, or a sensor that reads zero
        return []
    zero, noise = np.linalg.norm(magnetometer.zero), magnetometer.noise
    # back to the readings of the columns: matrix, sign and zero are undone
    raw = field @ np.linalg.inv(magnetometer.matrix).T * magnetometer.sign + magnetometer.zero
    reading = float(np.median(np.linalg.norm(raw, axis=1)))
    if zero > OFFSET * reading:  # the field is wrong too, so neither noise nor dipole can be judged
        what = f"the magnetometer reads {reading:.3g} and its stated zero is {zero:.3g}: the zero is in another unit"
        return [WrongUnit(what, "magnetometer", "zero")]
    wrong = []
    # a field weaker than half of its noise could not be measured
    if noise is not None and not 0.5 * noise < strength < FINEST * noise:
        what = f"the field reads {strength:.3g} and its stated noise is {noise:g}: the noise is in another unit than the columns"
        wrong.append(WrongUnit(what, "magnetometer", "noise"))
    acceleration = 0.0 if dipole is None else float(np.linalg.norm(dipole)) * strength
    if acceleration > ABSURD_ACCELERATION:
        what = f"dipole times field is {acceleration:.2g} rad/s2, too much for any dipole: it is stated for a field in another unit"
        wrong.append(WrongUnit(what, "disturbance", "dipole"))
    return wrong
