"""The kinds of readings that a person may give a posterior beside the panels'."""

from __future__ import annotations

from sunspin.estimate.terms.angular_speed import AngularSpeed
from sunspin.estimate.terms.gyro import GyroReading
from sunspin.estimate.terms.reading import Reading
from sunspin.estimate.terms.sun_angle import SunAngle
from sunspin.estimate.terms.sun_direction import SunReading

READINGS: dict[str, type[Reading]] = {
    one.kind: one for one in (AngularSpeed, GyroReading, SunReading, SunAngle)
}
