"""A gyro whose columns are not along the body axes that the file states: another order or other signs, as Sun and field show.

Only if the stated rates do not turn these directions as they are seen, and others do: a gyro that fits is not accused. Between two
samples the rate changes evenly, or as wheels turn it round: each reading counts by the better of the two.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from sunspin.estimate.carry import MOST_NUTATION_RAD, nutation, step
from sunspin.estimate.column_tests import axes_matrix, signed_axes, to_write
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
"""Readings whose median angle is less than this many times the least turn the directions as well. The one nearest to the stated is
named, as a component that is small at all times may have any sign."""


def wrong_gyro_axes(assessment: Assessment) -> str | None:
    """Return how the gyro must be read to turn the Sun and the field as they are seen, in words, and what to write.

    None if it does so as the file states, or no other reading does. Sun and field hold still in space. So each of their directions
    in the body, turned by the rates of the gyro, must give those some samples later (:data:`LAGS`); 48 ways to read it are tried.
    """
    vehicle, telemetry = assessment.vehicle, assessment.telemetry
    gyro = vehicle.sensors.gyro
    if gyro is None or "gyro_B" not in telemetry:
        return None
    time, rate = telemetry["time"].values, telemetry["gyro_B"].values
    directions = assessment.still_directions
    ways = list(signed_axes())  # the stated one first
    read = [rate[:, order] * sign for _, order, sign in ways]
    # turns between samples by each way to read the gyro: of a rate that changes evenly, and of a body with wheels (if needed)
    even = [rotations_between_samples(time, rates) for rates in read]
    nutating: list[np.ndarray] | None = None
    for lag in LAGS:
        at_rest = np.zeros_like(even[0])
        stated, without_turn = median_direction_errors(time, directions, [even[0], at_rest], lag)
        if stated <= WRONG_RAD:
            continue
        if nutating is None:
            nutating = _nutating(vehicle, telemetry, read)
        angles = np.min(
            [median_direction_errors(time, directions, t, lag) for t in (even, nutating) if t],
            axis=0,
        )
        # another way must turn the directions well, and clearly better than the stated way and than no turn at all
        least = float(angles.min())
        limit = min(RIGHT_RAD, BETTER * angles[0], BETTER * without_turn)
        if angles[0] <= WRONG_RAD or least >= limit:
            continue
        ties = np.flatnonzero(angles < AS_GOOD * least)
        # of those that are as good the one nearest to the stated axes
        chosen = max(ties, key=lambda k: (np.trace(axes_matrix(*ways[k][1:])), -angles[k]))
        what, order, sign = ways[chosen]
        words = f"the gyro {what} agrees with the Sun directions, and with the columns of the file it does not"
        if len(ties) > 1:
            others = f"{len(ties) - 1} other{'s' if len(ties) > 2 else ''}"
            words += f" (as {others} do: a component that stays small may have any sign)"
        instead = _columns_instead(vehicle, telemetry, axes_matrix(order, sign))
        return f"{words}; {to_write('gyro', gyro.keys_for_axes(order, sign))}{instead}"
    return None


def _columns_instead(vehicle: Vehicle, telemetry: xr.Dataset, matrix: np.ndarray) -> str:
    """Return which columns of panels, exchanged, look the same as a gyro read by a matrix (3, 3), in words; empty if none do."""
    gyro = ColumnChange("the gyro", axes={"gyro_B": matrix})
    wheels = next(iter(wheel_models(vehicle, telemetry)))
    observed = Observed.of(vehicle, telemetry, momenta=momentum_of_each(vehicle, telemetry, wheels))
    same = equivalent_changes(observed, gyro, column_changes(vehicle, telemetry))
    if not same:
        return ""
    either = " or ".join(change.what for change, _ in same)
    return f", or, which looks the same, {either}: find out which before you set it"


def _nutating(vehicle: Vehicle, telemetry: xr.Dataset, read: list[np.ndarray]) -> list[np.ndarray]:
    """Return the turns (n - 1, 3) between samples of a body that moves freely with its wheels, for each reading (n, 3) of the rate.

    The list is empty if inertia or wheels are not known, or if the wheels turn the rate round too often.
    """
    if vehicle.inertia_kg_m2 is None or not vehicle.wheels:
        return []
    body, momentum = Body.of(vehicle), next(iter(wheel_models(vehicle, telemetry).values()))
    dt = np.diff(telemetry["time"].values)
    turned = nutation(body.inertia, momentum[:-1]).max(initial=0.0) * dt.max(initial=0.0)
    if not turned <= MOST_NUTATION_RAD:
        return []
    rates = np.nan_to_num(read)[:, :-1]  # (48, n - 1, 3)
    stepped = step(body.inertia, rates, dt, (momentum[:-1], momentum[1:]))
    # a turn t of the body takes its attitude to exp(-[t x]) times it
    turns = -Rotation.from_matrix(stepped.turned.reshape(-1, 3, 3)).as_rotvec()
    turns = turns.reshape(len(read), -1, 3)
    was_read = np.asarray(np.isfinite(read[0][:-1]).all(axis=1))
    turns[:, ~was_read] = np.nan
    return list(turns)
