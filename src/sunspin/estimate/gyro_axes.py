"""Test of a gyro's axes: whether its columns have another order or other signs than the vehicle file states.

Sun and magnetic field hold still in space for minutes. So a direction to one of them in the body, rotated by the rates of the gyro,
must agree with the one that is measured some samples later. Between two samples the rate changes linearly, or as the wheels turn
it: each way to read the gyro counts by the better of the two.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from sunspin.estimate.carry import MOST_NUTATION_RAD, nutation, step
from sunspin.estimate.column_tests import advice_to_set, axes_matrix, signed_axes
from sunspin.estimate.equivalence import ColumnChange, Observed, column_changes, equivalent_changes
from sunspin.estimate.model import Body
from sunspin.estimate.observe import wheel_models
from sunspin.estimate.wheels import momentum_of_each
from sunspin.telemetry.assess import Assessment
from sunspin.telemetry.units import (
    BETTER,
    LAGS,
    RIGHT_RAD,
    WRONG_RAD,
    median_direction_errors,
    rotations_between_samples,
)
from sunspin.vehicle import Vehicle

AS_GOOD = 1.3
"""Ways to read the gyro are as good as the best if their median error is below this many times the least. The one nearest to the
stated way is named, as a component that is small at all times may have any sign."""


def wrong_gyro_axes(assessment: Assessment) -> str | None:
    """Return in words with which order and signs of its columns the gyro agrees with Sun and field, and which keys to set.

    None if it agrees as the vehicle file states, or with none of the 48 ways to read three columns.
    """
    vehicle, telemetry = assessment.vehicle, assessment.telemetry
    gyro = vehicle.sensors.gyro
    if gyro is None or "gyro_B" not in telemetry:
        return None
    time, rate = telemetry["time"].values, telemetry["gyro_B"].values
    directions = assessment.still_directions
    ways = list(signed_axes())  # the stated one first
    rates = [rate[:, order] * signs for _, order, signs in ways]
    # rotations (n - 1, 3) between samples for each way: by rates interpolated linearly, or by wheels (computed only if needed)
    linear = [rotations_between_samples(time, of_way) for of_way in rates]
    of_body: list[np.ndarray] | None = None
    at_rest = np.zeros_like(linear[0])
    # directions are compared over 1, 2, 4, 8 samples, as a slow body rotates little from one to the next
    for lag in LAGS:
        stated_error, rest_error = median_direction_errors(
            time, directions, [linear[0], at_rest], lag
        )
        if stated_error <= WRONG_RAD:
            continue
        if of_body is None:
            of_body = _rotations_with_wheels(vehicle, telemetry, rates)
        errors = np.min(
            [median_direction_errors(time, directions, r, lag) for r in (linear, of_body) if r],
            axis=0,
        )
        # another way must agree with the directions, and clearly better than the stated way and than a body at rest
        least = float(errors.min())
        limit = min(RIGHT_RAD, BETTER * errors[0], BETTER * rest_error)
        if errors[0] <= WRONG_RAD or least >= limit:
            continue
        ties = np.flatnonzero(errors < AS_GOOD * least)
        # the trace of a matrix of axes is largest for those nearest to the stated ones
        chosen = max(ties, key=lambda k: (np.trace(axes_matrix(*ways[k][1:])), -errors[k]))
        what, order, signs = ways[chosen]
        words = f"the gyro {what} agrees with the Sun directions, and with the columns of the file it does not"
        if len(ties) > 1:
            others = f"{len(ties) - 1} other{'s' if len(ties) > 2 else ''}"
            words += f" (as {others} do: a component that stays small may have any sign)"
        instead = _columns_instead(vehicle, telemetry, axes_matrix(order, signs))
        return f"{words}; {advice_to_set('gyro', gyro.keys_for_axes(order, signs))}{instead}"
    return None


def _columns_instead(vehicle: Vehicle, telemetry: xr.Dataset, matrix: np.ndarray) -> str:
    """Return in words which exchanged columns look the same as a gyro whose rates are multiplied by `matrix` (3, 3), if any do."""
    gyro = ColumnChange("the gyro", axes={"gyro_B": matrix})
    # what the wheels do, in words: the first of the possibilities
    wheels = next(iter(wheel_models(vehicle, telemetry)))
    observed = Observed.of(vehicle, telemetry, momenta=momentum_of_each(vehicle, telemetry, wheels))
    same = equivalent_changes(observed, gyro, column_changes(vehicle, telemetry))
    if not same:
        return ""
    either = " or ".join(change.what for change, _ in same)
    return f", or, which looks the same, {either}: find out which before you set it"


def _rotations_with_wheels(
    vehicle: Vehicle, telemetry: xr.Dataset, rates: list[np.ndarray]
) -> list[np.ndarray]:
    """Return the rotations between samples of a free rigid body with wheels, for each way to read the gyro.

    `rates`: for each way the rates (n, 3) at the samples, rad/s, in body axes, NaN where not read; the equations of motion carry
    each to the next sample. The result has for each way rotation vectors (n - 1, 3), rad, with the sign of
    :func:`rotations_between_samples`, NaN where the rate at the start was not read. It is empty if inertia or wheels are not
    known, or if the wheels turn the vector of the rate by more than `MOST_NUTATION_RAD` between two samples: the integration does
    not follow that.
    """
    if vehicle.inertia_kg_m2 is None or not vehicle.wheels:
        return []
    # by measured speeds, or else by wheels that are held: the first of the possibilities
    body, momentum = Body.of(vehicle), next(iter(wheel_models(vehicle, telemetry).values()))
    dt = np.diff(telemetry["time"].values)
    turned_rad = nutation(body.inertia, momentum[:-1]).max(initial=0.0) * dt.max(initial=0.0)
    if not turned_rad <= MOST_NUTATION_RAD:  # also if it is NaN
        return []
    at_start = np.nan_to_num(rates)[:, :-1]  # (way, n - 1, 3)
    stepped = step(body.inertia, at_start, dt, (momentum[:-1], momentum[1:]))
    # `turned` multiplies attitudes B_from_N: if the body rotates by the vector t, it is exp(-[t x])
    rotations = -Rotation.from_matrix(stepped.turned.reshape(-1, 3, 3)).as_rotvec()
    rotations = rotations.reshape(len(rates), -1, 3)
    # all ways read the same three columns
    was_read = np.asarray(np.isfinite(rates[0][:-1]).all(axis=1))
    rotations[:, ~was_read] = np.nan
    return list(rotations)
