"""Which column of a magnetometer is which axis, by the angle between field and Sun along an orbit."""

from __future__ import annotations

import numpy as np

from sunspin.estimate.column_tests import changes_of_sensor
from sunspin.estimate.equivalence import ColumnChange, Observed, alike, column_changes
from sunspin.estimate.orbit.invariants import (
    FEWEST,
    Predicted,
    angles,
    field_of,
    fit_magnetometer,
)
from sunspin.estimate.orbit.readings import Readings
from sunspin.telemetry.assess import Assessment
from sunspin.vehicle import Vehicle

LARGEST_ANGLE_RAD, CLEARER = 0.15, 0.5
"""Right elements leave no larger median of the angle between field and Sun, in addition to the error of the Sun's direction: 0.01
to 0.07 rad on simulated spinners whose panels get 10 to 30 % of the Earth's light. Other axes are named if they leave less than the
second as a share of what the stated axes, and any others, leave."""


def turned_axes(readings: Readings, predicted: Predicted, vehicle: Vehicle) -> ColumnChange | None:
    """Return the change of axes with which a magnetometer's angle to the Sun is the predicted one, if with those of the file it is
    not.

    Of the predictions the first offset counts. None also if other axes fit as well. The strength of the field determines zero and
    matrix but for a rotation or a mirror, so the angle alone compares the ways. If all axes point the other way, this is for the
    check of the orbit to say.
    """
    use = readings.has_field
    if readings.has_angle.sum() < FEWEST or vehicle.sensors.magnetometer is None:
        return None
    readings, predicted = readings.take(use), predicted.take(use).at([0])
    # by the strength alone
    _, state, scales = fit_magnetometer(readings.without_sun(), predicted)
    field, known = field_of(readings.field, scales.in_T(state.unknown)[0]), predicted.angles()
    ways = changes_of_sensor(vehicle, "field_B")  # that of the file comes first
    off = [angles(field @ axes_matrix(way).T, readings.sun) - known for way in ways]
    median = np.nanmedian(np.abs(off), axis=1)
    best, second = np.argsort(median)[:2]
    if np.array_equal(axes_matrix(ways[best]), -np.eye(3)):
        return None
    is_clear = median[best] < min(CLEARER * min(median[0], median[second]), LARGEST_ANGLE_RAD)
    return ways[best] if is_clear else None


def axes_matrix(way: ColumnChange) -> np.ndarray:
    """Return the matrix (3, 3) that turns readings of the field into those after a change of axes."""
    return way.axes["field_B"]


def contradicted(readings: Readings, predicted: Predicted, calibration: np.ndarray) -> bool:
    """Return whether the median angle between field and Sun is not as predicted at the first offset.

    It is asked only of `FEWEST` samples or more that show the angle. `calibration` (12): matrix and zero of the magnetometer. The
    stated errors of the Sun's directions are allowed for.
    """
    off = np.abs(angles(field_of(readings.field, calibration), readings.sun) - predicted.angles())
    known = np.isfinite(off)
    if known.sum() < FEWEST:
        return False
    stated = np.sqrt(np.trace(readings.covariance[known], axis1=1, axis2=2) / 2)
    allowed = LARGEST_ANGLE_RAD + np.median(np.minimum(stated, LARGEST_ANGLE_RAD))
    return bool(np.median(off[known]) > allowed)


def axes_words(way: ColumnChange, assessment: Assessment) -> str:
    """Return what :func:`turned_axes` means, what to write into the vehicle file, and what else looks the same."""
    vehicle, telemetry = assessment.vehicle, assessment.telemetry
    columns = column_changes(vehicle, telemetry)
    same = [change.what for change, _ in alike(Observed.of(vehicle, telemetry), way, columns)]
    others = f", or, which looks the same, {' or '.join(same)}: find out which before you set it"
    return (
        f"{way.what} has the angle to the Sun that the orbit predicts, and with the columns of the file it does not"
        f"; {way.do}{others if same else ''}"
    )
