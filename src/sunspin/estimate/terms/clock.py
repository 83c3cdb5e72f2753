"""The latency of all sensors other than the Sun's relative to the Sun of their row: one number, estimated with the motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

from sunspin.estimate.model import Unknown
from sunspin.estimate.terms.term import Term
from sunspin.vehicle.sensors import Clock


@dataclass(frozen=True)
class Latency(Term):
    """Gyro, magnetometer and attitude of a row are `late_s` (s) older than its Sun, with the sigma `sigma_s` (s) of that.

    It reads nothing: a fit moves a motion back by so much before it asks these sensors.
    """

    name: ClassVar[str] = "clock"
    label: ClassVar[str] = "clock"

    late_s: float
    sigma_s: float

    @classmethod
    def of(cls, clock: Clock) -> Self:
        """Return what the vehicle file states."""
        return cls(clock.late_s, clock.sigma_s)

    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the latency, unless it is known exactly."""
        if not self.sigma_s:
            return ()
        return (Unknown("late_s", "clock", "s", self.late_s, self.sigma_s),)

    def for_search(self) -> list[Self]:
        """Return a latency of zero: it is small against the errors of starts, which a search adds to those of the sensors."""
        return [replace(self, late_s=0.0, sigma_s=0.0)]
