"""Test of a magnetometer's axes along an orbit: which order and signs of its columns give the right angle between field and Sun."""

from __future__ import annotations

import numpy as np

from sunspin.estimate.column_tests import changes_of_sensor
from sunspin.estimate.equivalence import ColumnChange, Observed, column_changes, equivalent_changes
from sunspin.estimate.orbit.invariants import (
    FEWEST,
    Predicted,
    calibrated_field,
    field_sun_angles,
    fit_magnetometer,
)
from sunspin.estimate.orbit.readings import Readings
from sunspin.telemetry.assess import Assessment
from sunspin.vehicle import Vehicle

LARGEST_ANGLE_RAD = 0.15
"""Largest median residual of the angle between field and Sun with right elements, in addition to the error of the Sun's direction.
On simulated spinners whose panels get 10 to 30 % of the Earth's light it was 0.01 to 0.07 rad."""

CLEARER = 0.5
"""Other axes are named if their median residual is below this share of that of the stated axes, and of any others."""


def better_axes(readings: Readings, predicted: Predicted, vehicle: Vehicle) -> ColumnChange | None:
    """Return the change of a magnetometer's axes with which the angle between field and Sun is as predicted; None without one.

    None too if two changes fit nearly as well, or if only the sign of all three axes is wrong, which the check of the orbit
    reports. The strength of the field determines zero and matrix but for a rotation or a mirror, and the angle then judges the
    axes. `predicted`: at its first offset.
    """
    use = readings.has_field
    if readings.has_angle.sum() < FEWEST or vehicle.sensors.magnetometer is None:
        return None
    readings, predicted = readings.take(use), predicted.take(use).at([0])
    model, state = fit_magnetometer(readings.without_sun(), predicted)  # by the strength alone
    field = calibrated_field(readings.field, model.calibration(state)[0])
    changes = changes_of_sensor(vehicle, "field_B")  # the first one keeps the axes of the file
    matrices = [change.axes["field_B"] for change in changes]
    angles = np.array([field_sun_angles(field @ axes.T, readings.sun) for axes in matrices])
    residuals = np.nanmedian(np.abs(angles - predicted.angles()), axis=1)
    best, second = np.argsort(residuals)[:2]
    if np.array_equal(matrices[best], -np.eye(3)):
        return None
    limit = min(CLEARER * min(residuals[0], residuals[second]), LARGEST_ANGLE_RAD)
    return changes[best] if residuals[best] < limit else None


def contradicted(
    readings: Readings, predicted: Predicted, calibration: np.ndarray, fewest: int = FEWEST
) -> bool:
    """Return whether the angle between field and Sun differs from the prediction, in the median over the samples.

    The allowed difference includes the stated errors of the Sun directions. False with fewer than `fewest` samples that show the
    angle. `predicted`: at its first offset. `calibration` (12): matrix and zero of the magnetometer.
    """
    field = calibrated_field(readings.field, calibration)
    difference = np.abs(field_sun_angles(field, readings.sun) - predicted.angles())
    known = np.isfinite(difference)
    if known.sum() < fewest:
        return False
    # sigma of each direction about one axis: its covariance is that about two axes
    sun_sigma = np.sqrt(np.trace(readings.covariance[known], axis1=1, axis2=2) / 2)
    allowed = LARGEST_ANGLE_RAD + np.median(np.minimum(sun_sigma, LARGEST_ANGLE_RAD))
    return bool(np.median(difference[known]) > allowed)


def axes_words(change: ColumnChange, assessment: Assessment) -> str:
    """Return in words a result of :func:`better_axes`, how to correct the vehicle file, and exchanged panels that look the same."""
    vehicle, telemetry = assessment.vehicle, assessment.telemetry
    columns = column_changes(vehicle, telemetry)
    same = [
        other.what
        for other, _ in equivalent_changes(Observed.of(vehicle, telemetry), change, columns)
    ]
    others = f", or, which looks the same, {' or '.join(same)}: find out which before you set it"
    return (
        f"{change.what} has the angle to the Sun that the orbit predicts, and with the columns of the file it does not"
        f"; {change.do}{others if same else ''}"
    )
