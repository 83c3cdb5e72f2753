"""Units that a vehicle file gets wrong, as the samples show, each with the key to change.

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

LARGEST = {"W": 2000.0, "A": 100.0}
"""More than any panel of a spacecraft gives: readings above are counts, although the file states a scale."""

BEYOND = 30.0
"""Full Sun as read over as stated, or its inverse: nothing but a wrong unit or a wrong gain makes it more. At Jupiter it is 27."""

THOUSANDS = 4.0
"""A ratio within this factor of a power of 1000 is that power."""

BRIGHTEST = 200
"""Samples that are looked at."""

FITS = 0.15
"""Median misfit (Delta) of the brightest samples up to which the Sun made them, and not noise in the dark."""

DISTINCT, LIT_SHARE = 10, 0.2
"""Sunlight has at least so many different readings, and usually two panels above this share of the largest: counts of noise have
not."""

LEAST_SAMPLES = 5

FINEST = 1e5
"""Readings over their noise, which words of 16 bits hold: more is another unit."""

SHUFFLES = 99
"""Of noise in the dark no panel knows of the others. Sunlight must fit better than each of so many random orders of its readings
among the panels, which noise does in one file of a hundred, however small."""

SHUFFLED, BRIGHT_SHARE = 60, 0.3
"""Samples of which this is asked, at most: the brightest of those above this part of what is bright."""


class WrongUnit(NamedTuple):
    """What the readings show, and the key of the vehicle file to change: its table, its name, the value it should have (None: not
    known)."""

    what: str
    table: str
    key: str
    value: float | None = None

    def __str__(self) -> str:
        return self.at("")

    def at(self, line: str) -> str:
        """The sentence, with a line of the file named in it."""
        do = f"set {self.key} = {self.value:.6g}" if self.value is not None else f"check {self.key}"
        return f"{self.what}; {do} under [{self.table}]{line} of the vehicle file"


def reading_unit(vehicle: Vehicle, value: np.ndarray) -> str:
    """Return the unit of panel readings (n, n_panel), "W" or "A"; nothing if the vehicle file does not give it.

    Gains in W or A give the unit. With relative gains a stated scale gives it, unless the readings are too large for the unit:
    the scale of an example file may have been left as it was.
    """
    form, unit = vehicle.telemetry, UNITS[vehicle.telemetry.quantity]
    if vehicle.gain_unit == unit or form.has_voltages:
        return unit
    largest = np.where(np.isfinite(value), value, 0.0).max(axis=1, initial=0.0)
    lit = largest[largest > 0]
    full = float(np.quantile(lit, BRIGHT_QUANTILE)) if lit.size else 0.0
    return unit if "telemetry.scale" in vehicle.facts and full <= LARGEST[unit] else ""


def panel_unit(vehicle: Vehicle, value: np.ndarray) -> WrongUnit | None:
    """The wrong unit of panel readings (n, n_panel): of their scale against the gains, or of the stated noise; None if neither is
    wrong."""
    form, unit = vehicle.telemetry, UNITS[vehicle.telemetry.quantity]
    value = np.where(np.isfinite(value), value, 0.0)
    largest = value.max(axis=1, initial=0.0)
    if np.count_nonzero(largest > 0) < LEAST_SAMPLES:
        return None
    if vehicle.gain_unit == unit and (wrong := _against_gains(vehicle, value, largest)):
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


def _against_gains(vehicle: Vehicle, value: np.ndarray, largest: np.ndarray) -> WrongUnit | None:
    """The wrong scale of readings (n, n_panel), if full Sun is far from the gains."""
    form, gains = vehicle.telemetry, vehicle.input_gains
    share = float(np.quantile((value / gains).max(axis=1)[largest > 0], BRIGHT_QUANTILE))
    if 1 / BEYOND < share < BEYOND:
        return None
    bright = _brightest(value, largest)
    ratio = float(np.median(brightness(vehicle, bright)))
    if 1 / BEYOND < ratio < BEYOND or (ratio < 1 and not _sunlit(vehicle, value, largest)):
        return None
    step = round(np.log10(ratio) / 3)
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
    """The brightest samples, without the very brightest, which may be spikes."""
    order = np.argsort(-largest, kind="stable")
    return value[order[: min(BRIGHTEST, max(LEAST_SAMPLES, len(order) // 2))]]


def _sunlit(vehicle: Vehicle, value: np.ndarray, largest: np.ndarray) -> bool:
    """Whether the Sun made the brightest of these readings: they fit directions, and better as they stand than in each of many
    random orders among the panels, with noise that is alike in the readings' unit, and in parts of each panel's gain."""
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
"""What the readings may be, and what makes rad/s of them then."""

TURNS_WRONG, TURNS_RIGHT = np.radians(20.0), np.radians(15.0)
"""Median angle between a direction as the gyro carries it on and as it is seen: at least, for a wrong gyro; at most, for a right
one."""

BETTER = 0.35
"""A factor carries directions on better than none, and than a body at rest, if its median angle is this part of theirs."""

PAIRS, MOST_PAIRS, LAGS = 10, 2000, (1, 2, 4, 8)
"""Pairs of samples needed and used at most, and how many samples apart: a slow body must turn far enough to tell."""

TOO_FAST = 3.0
"""Median rate of the gyro over the largest rate of the vehicle file."""

OFFSET = 30.0
"""A zero over the readings: more is another unit."""

ABSURD_ACCELERATION = 0.1
"""rad/s2: no dipole in a planet's field turns a spacecraft so."""

STEEP_SHARE, STEEP_SAMPLES = 0.85, 30
"""Part of its readings, of so many at least, that a Sun sensor has at the steepest angle: it is 0.55 for one that reads on while
the Sun turns behind it, and 0.96 for angles spread over 40 degrees to each side that are read as radians."""

RPM = 60 / (2 * np.pi)

RPM_WITHIN = 0.15
"""Wheel speed over the nominal one, relative to `RPM`."""


def wrong_units(
    vehicle: Vehicle, telemetry: xr.Dataset, still_directions: Callable[[], list[np.ndarray]]
) -> list[WrongUnit]:
    """Every unit of sensors, wheels and temperatures that the samples of `read_telemetry` contradict; `still_directions` gives unit
    directions (n, 3), body axes, that keep still in space, for the gyro."""
    sensors, wrong = vehicle.sensors, []
    if sensors.gyro is not None and "gyro_B" in telemetry:
        limit = sensors.disturbance.max_rate_rad_s
        wrong += _gyro(sensors.gyro, limit, telemetry, still_directions())
    if sensors.magnetometer is not None and "field_B" in telemetry:
        field, dipole = telemetry["field_B"].values, sensors.disturbance.dipole
        wrong += _magnetometer(sensors.magnetometer, dipole, field)
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
            speed = np.abs(speed[np.isfinite(speed)])[:PAIRS]  # it may coast down afterwards
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


def _gyro(
    gyro: Gyro, limit: float | None, telemetry: xr.Dataset, seen: list[np.ndarray]
) -> list[WrongUnit]:
    time, rate = telemetry["time"].values, telemetry["gyro_B"].values
    turns = even_turns(time, rate)
    read_as = [factor * turns for factor in (1.0, 0.0, *GYRO_FACTORS.values())]
    for lag in LAGS:
        stated, still, *angles = carried_by(time, seen, read_as, lag)
        best = int(np.argmin(angles))
        least = min(TURNS_RIGHT, BETTER * stated, BETTER * still)
        if stated > TURNS_WRONG and angles[best] < least:
            name, factor = list(GYRO_FACTORS.items())[best]
            what = f"with its rates times {factor:.4g} the gyro agrees with the Sun directions, and without it does not: {name}"
            return [WrongUnit(what, "gyro", "scale_rad_s", gyro.scale_rad_s * factor)]
    size = np.linalg.norm(rate[np.isfinite(rate).all(axis=1)], axis=1)
    if limit is None or len(size) < PAIRS or np.median(size) < TOO_FAST * limit:
        return []
    what = f"the gyro reads {np.degrees(np.median(size)):.3g} deg/s, and max_rate_rad_s says at most {np.degrees(limit):.3g} deg/s"
    return [WrongUnit(what, "gyro", "scale_rad_s")]


def even_turns(time: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """The turns (n - 1, 3), rad, of a body whose rate (n, 3) changes evenly from sample to sample."""
    return (rate[1:] + rate[:-1]) / 2 * np.diff(time)[:, None]


def carried_by(
    time: np.ndarray, seen: list[np.ndarray], turns: list[np.ndarray], lag: int
) -> list[float]:
    """Median angle (rad), for each set of turns (n - 1, 3) between neighbours, between directions that stand still in space as they
    are carried on over `lag` samples and as they are seen there. Zero where too few are seen."""
    from scipy.spatial.transform import Rotation

    n = len(time) - lag
    begin = np.arange(max(n, 0))
    good = np.isfinite(turns[0]).all(axis=1) & (np.diff(time) > 0)
    good = np.all([good[begin + k] for k in range(lag)], axis=0)
    pairs = [
        (k, begin[good & np.isfinite(each[begin] + each[begin + lag]).all(axis=1)])
        for k, each in enumerate(seen)
    ]
    pairs = [(k, at[:: -(-len(at) // MOST_PAIRS) or 1]) for k, at in pairs]
    if sum(len(at) for _, at in pairs) < PAIRS:
        return [0.0] * len(turns)
    at = np.concatenate([at for _, at in pairs])
    first, then = (np.concatenate([seen[k][at + ahead] for k, at in pairs]) for ahead in (0, lag))
    angles = []
    for each in turns:
        direction = first
        for k in range(lag):
            direction = Rotation.from_rotvec(-each[at + k]).apply(direction)
        across = np.linalg.norm(np.cross(direction, then), axis=1)
        angles.append(float(np.median(np.arctan2(across, (direction * then).sum(axis=1)))))
    return angles


def _magnetometer(
    magnetometer: Magnetometer, dipole: np.ndarray | None, field: np.ndarray
) -> list[WrongUnit]:
    field = field[np.isfinite(field).all(axis=1)]
    size = float(np.median(np.linalg.norm(field, axis=1))) if len(field) >= PAIRS else 0.0
    if size == 0:
        return []
    zero, noise = np.linalg.norm(magnetometer.zero), magnetometer.noise
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
