"""A gyro whose columns are not along the body axes as stated: another order or other signs, as the Sun and the field show.

Only where the rates as stated do not turn these directions as they are seen, and others do: a gyro that fits is not accused.
Between two samples the rate changes evenly, or as wheels turn it round: each reading counts by the better of the two.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from sunspin.estimate.equivalence import Change, Observed, alike, column_changes
from sunspin.estimate.rates.motion import MOST_NUTATION, Body, Ends, nutation, step
from sunspin.estimate.rates.wheels import momentum_of_each, wheel_momenta
from sunspin.estimate.wiring import axes_matrix, signed_axes, to_write
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
"""Readings whose median angle is less than this many times the least turn the directions as well: the one nearest to the stated
is named, as a component that is small at all times may have any sign."""


def wrong_gyro_axes(assessment: Assessment) -> str | None:
    """How the gyro of `read_telemetry` must be read to turn the Sun and the field as they are seen, in words, and what to write;
    None where it does so as stated, or no other reading does."""
    vehicle, telemetry = assessment.vehicle, assessment.telemetry
    gyro = vehicle.sensors.gyro
    if gyro is None or "gyro_B" not in telemetry:
        return None
    time, rate = telemetry["time"].values, telemetry["gyro_B"].values
    seen = assessment.still_directions
    ways = list(signed_axes())
    read = [rate[:, order] * sign for _, order, sign in ways]
    even, nutating = [rotations_between_samples(time, one) for one in read], None
    for lag in LAGS:
        stated, still = median_direction_errors(time, seen, [even[0], np.zeros_like(even[0])], lag)
        if stated <= WRONG_RAD:
            continue
        nutating = _nutating(vehicle, telemetry, read) if nutating is None else nutating
        angles = np.min(
            [
                median_direction_errors(time, seen, turns, lag)
                for turns in (even, nutating)
                if turns
            ],
            axis=0,
        )
        least = float(angles.min())
        if angles[0] > WRONG_RAD and least < min(RIGHT_RAD, BETTER * angles[0], BETTER * still):
            ties = np.flatnonzero(angles < AS_GOOD * least)
            chosen = max(ties, key=lambda k: (np.trace(axes_matrix(*ways[k][1:])), -angles[k]))
            what, order, sign = ways[chosen]
            found = f"the gyro {what} agrees with the Sun directions, and with the columns of the file it does not"
            if len(ties) > 1:
                others = f"{len(ties) - 1} other{'s' if len(ties) > 2 else ''}"
                found += f" (as {others} do: a component that stays small may have any sign)"
            instead = _columns_instead(vehicle, telemetry, axes_matrix(order, sign))
            return f"{found}; {to_write('gyro', gyro.keys_for_axes(order, sign))}{instead}"
    return None


def _columns_instead(vehicle: Vehicle, telemetry: xr.Dataset, matrix: np.ndarray) -> str:
    """Which columns of panels, exchanged, look the same as a gyro read by a matrix (3, 3), in words; empty if none do."""
    gyro = Change("the gyro", axes={"gyro_B": matrix})
    wheels = next(iter(wheel_momenta(vehicle, telemetry)))
    observed = Observed.of(vehicle, telemetry, momenta=momentum_of_each(vehicle, telemetry, wheels))
    if not (same := alike(observed, gyro, column_changes(vehicle, telemetry))):
        return ""
    either = " or ".join(change.what for change, _ in same)
    return f", or, which looks the same, {either}: find out which before you set it"


def _nutating(vehicle: Vehicle, telemetry: xr.Dataset, read: list[np.ndarray]) -> list[np.ndarray]:
    """For each reading (n, 3) of the rate at the samples, the turns (n - 1, 3) of the body that moves freely from there with its
    wheels; none where they are not known, or turn the rate round too often."""
    if vehicle.inertia_kg_m2 is None or not vehicle.wheels:
        return []
    body, momentum = Body.of(vehicle), next(iter(wheel_momenta(vehicle, telemetry).values()))
    dt = np.diff(telemetry["time"].values)
    if not nutation(body, momentum[:-1]).max(initial=0.0) * dt.max(initial=0.0) <= MOST_NUTATION:
        return []
    held = Ends(momentum=momentum[:-1], momentum_end=momentum[1:])
    made, _ = step(body, np.nan_to_num(read)[:, :-1], np.tile(dt, (len(read), 1)), held)
    turns = -Rotation.from_matrix(made.reshape(-1, 3, 3)).as_rotvec().reshape(len(read), -1, 3)
    turns[:, ~np.asarray(np.isfinite(read[0][:-1]).all(axis=1))] = np.nan
    return list(turns)
