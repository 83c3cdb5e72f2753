"""Which column of a magnetometer is which axis, by the angle between field and Sun along an orbit."""

from __future__ import annotations

from itertools import permutations, product
from typing import NamedTuple

import numpy as np
import tomlkit

from sunspin.estimation.orbit.invariants import (
    FEWEST,
    Predicted,
    angles,
    calibrated,
    field_of,
)
from sunspin.estimation.orbit.readings import Readings
from sunspin.telemetry.assess import Assessment

LARGEST_ANGLE_RAD, CLEARER = 0.15, 0.5
"""Right elements leave no larger median of the angle between field and Sun, in addition to the error of the Sun's direction: 0.01
to 0.07 rad on simulated spinners whose panels get 10 to 30 % of the Earth's light. Other axes are named if they leave less than the
second as a share of what the stated axes, and any others, leave."""


class Axes(NamedTuple):
    """One way to read three columns as axes: axis k is column `order[k]` times `sign[k]`."""

    order: tuple[int, ...]
    sign: tuple[float, ...]

    def __str__(self) -> str:
        """Return the way in words."""
        columns = ("-+"[s > 0] + "xyz"[k] for k, s in zip(self.order, self.sign, strict=True))
        return f"read as ({', '.join(columns)}) of its columns"


WAYS = [
    Axes(order, sign) for order in permutations(range(3)) for sign in product((1.0, -1.0), repeat=3)
]
"""All 48 ways; the first is that of the file."""


def axes_matrix(way: Axes) -> np.ndarray:
    """Return the matrix (3, 3) that turns readings into those of another way."""
    return np.eye(3)[list(way.order)] * np.array(way.sign)[:, None]


def turned_axes(readings: Readings, predicted: Predicted) -> Axes | None:
    """Return the axes with which a magnetometer's angle to the Sun is the predicted one (first place), if it is not as stated.

    None also if other axes fit as well. The strength of the field determines zero and matrix but for a rotation or a mirror, so the
    angle alone compares the ways. If all axes point the other way, this is for the check of the orbit to say.
    """
    use = readings.has_field
    if readings.has_angle.sum() < FEWEST:
        return None
    readings, predicted = readings.take(use), predicted.take(use).at([0])
    _, state, scales = calibrated(readings.without_sun(), predicted)
    field = field_of(readings.field, scales.in_T(state.unknown)[0])
    known = predicted.angles()
    off = [angles(field @ axes_matrix(way).T, readings.sun) - known for way in WAYS]
    left = np.nanmedian(np.abs(off), axis=1)
    best, second = np.argsort(left)[:2]
    if np.array_equal(axes_matrix(WAYS[best]), -np.eye(3)):
        return None
    clear = left[best] < min(CLEARER * min(left[0], left[second]), LARGEST_ANGLE_RAD)
    return WAYS[best] if clear else None


def contradicted(readings: Readings, predicted: Predicted, calibration: np.ndarray) -> bool:
    """Return whether `FEWEST` samples or more show an angle between field and Sun that is not the predicted one (first place)."""
    off = np.abs(angles(field_of(readings.field, calibration), readings.sun) - predicted.angles())
    known = np.isfinite(off)
    if known.sum() < FEWEST:
        return False
    stated = np.sqrt(np.trace(readings.covariance[known], axis1=1, axis2=2) / 2)
    allowed = LARGEST_ANGLE_RAD + np.median(np.minimum(stated, LARGEST_ANGLE_RAD))
    return bool(np.median(off[known]) > allowed)


def axes_words(way: Axes, assessment: Assessment) -> str:
    """Return what :func:`turned_axes` means, and what to write into the vehicle file."""
    magnetometer = assessment.vehicle.sensors.magnetometer
    do = ""
    if magnetometer is not None:
        keys = magnetometer.keys_for_axes(way.order, way.sign)
        lines = " and ".join(tomlkit.dumps(keys).splitlines())
        do = f"; set {lines} under [magnetometer] of the vehicle file"
    return (
        f"the magnetometer {way} has the angle to the Sun that the orbit predicts, and with the columns of the file it does not"
        f"{do}"
    )
