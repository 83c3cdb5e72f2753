"""The sensors that telemetry may have, as terms. A new one is its file in this room and its line here."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.estimate.orbit.field_calibration import FieldCalibration
from sunspin.estimate.terms.attitude import Attitude
from sunspin.estimate.terms.field_direction import FieldDirection, TurningAxes
from sunspin.estimate.terms.gyro import Gyro
from sunspin.estimate.terms.magnetometer import Magnetometer
from sunspin.estimate.terms.panels import Panels
from sunspin.estimate.terms.sun_direction import UNREAD, SunDirection
from sunspin.estimate.terms.term import Term
from sunspin.telemetry.assess import Assessment
from sunspin.vehicle import Vehicle

SENSORS = (Gyro, Magnetometer, Attitude)
"""Those beside the Sun's. An orbit calibrates the `Magnetometer` itself, not others of its kind."""

FIELD = "field"
"""Where directions come from without a Sun: a magnetometer."""


def sun_source(telemetry: xr.Dataset, wanted: str | None, field_known: bool = False) -> str:
    """Where the Sun comes from: the first of directions, Sun sensors, panels that there is, unless one is wanted; `FIELD` without
    any where the magnetometer's field is known, or at least its directions in the body."""
    has = {
        "directions": "sun_B" in telemetry and "sun_cov_B" in telemetry,
        "sun_sensor": "sun_sensor_B" in telemetry,
        "panels": "power_W" in telemetry or "current_A" in telemetry,
    }
    if wanted is None:
        wanted = next((name for name, there in has.items() if there), None)
    if wanted in (None, FIELD) and field_known:
        return FIELD
    if wanted not in has or not has[wanted]:
        there = (
            ", ".join(name for name, is_there in has.items() if is_there) or "nothing of the Sun"
        )
        do = f"use {', '.join(has)}"
        if wanted is None and "field_B" in telemetry:
            do = "a magnetometer alone needs its `noise` in the vehicle file, or an orbit (--tle)"
        raise InputError(
            f"the telemetry has no Sun from {wanted or 'panels or Sun sensors'}", got=there, do=do
        )
    return wanted


def read_terms(
    assessment: Assessment,
    source: str,
    calibration: FieldCalibration | None = None,
) -> tuple[tuple[Term, ...], np.ndarray]:
    """All that telemetry has, the Sun first, and a sentence for each sample (n); `calibration` of the magnetometer, by an orbit."""
    vehicle, telemetry = assessment.vehicle, assessment.sensors
    part = vehicle.sensors.magnetometer
    if source == FIELD and calibration is None and part is not None:
        field, why = FieldDirection.alone(part, telemetry)
        return (field, TurningAxes(), *_read(vehicle, telemetry, Magnetometer)), why
    if source == FIELD:
        sun, why = None, np.full(telemetry.sizes["time"], UNREAD, dtype=object)
    else:
        sun, why = (
            Panels.read(assessment)
            if source == "panels"
            else SunDirection.read(vehicle, telemetry, source)
        )
    t_s = np.asarray(telemetry["time"], dtype=np.float64)
    others = [
        x
        if type(x) is not Magnetometer
        else x.with_own_zero(t_s)
        if calibration is None
        else replace(x, calibration=calibration)
        for x in _read(vehicle, telemetry)
    ]
    return tuple(term for term in (sun, *others) if term is not None), why


def _read(vehicle: Vehicle, telemetry: xr.Dataset, but: type[Term] | None = None) -> Iterator[Term]:
    """The sensors beside the Sun's that telemetry has, `but` one kind."""
    found = (sensor.read(vehicle, telemetry) for sensor in SENSORS if sensor is not but)
    return (term for term in found if term is not None)
