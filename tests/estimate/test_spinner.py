"""Spinners with coarse Sun sensors that the Earth lights, a magnetometer with a large zero, and an orbit: made by no code of the package."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import sunspin as ss
from sunspin.estimate.orbit import check as orbit_check
from sunspin.estimate.orbit.check import Verdict, check_orbit
from sunspin.estimate.orbit.field_calibration import field_calibration
from sunspin.estimate.orbit.invariants import FEWEST, contradicted, predict, seen_in
from sunspin.estimate.orbit.judged import judged_orbit, orbit_of
from sunspin.estimate.rates.observe import thinned
from sunspin.estimate.terms.magnetometer import Magnetometer
from sunspin.estimate.terms.sensors import read_terms
from validation.spinners import Case, make

AS_MOUNTED = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
THREE, LARGE_ZERO = ("-X", "-Y", "-Z"), (1.5, -2.0, 2.0)


@cache
def spinner(folder, faces=THREE, turned=AS_MOUNTED, number=4, axis=1):
    """A whole orbit, one sample in 10 s, of a body that turns at 2 deg/s: vehicle, telemetry, right and wrong orbit, truth."""
    case = Case(5, number, -2.0, axis, 1.0, faces, turned, LARGE_ZERO, False, 1.3, True, 0.25, 10.0, 560)
    where = folder / f"{faces}-{turned}-{number}-{axis}"
    truth = make(case, where)
    vehicle = ss.load_vehicle(where / "vehicle.toml")
    telemetry = ss.read_telemetry(where / "telemetry.csv", vehicle)
    orbits = [orbit_of(vehicle, telemetry, where / f"{name}.tle") for name in ("right", "wrong")]
    return vehicle, telemetry, *orbits, truth


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("spinner")


def error_deg(made, truth, telemetry, vehicle):
    """Median angle between the calibrated and the true field."""
    reading = telemetry["field_B"].values
    column = reading + vehicle.sensors.magnetometer.zero
    true = np.linalg.solve(np.array(truth["matrix"]), (column - np.array(truth["zero_nT"])).T).T
    found = made.field(reading)
    cosine = (true * found).sum(axis=1) / np.linalg.norm(true, axis=1) / np.linalg.norm(found, axis=1)
    return np.degrees(np.median(np.arccos(np.clip(cosine, -1, 1))))
