"""What each kind of result can do: its numbers in words, its figures, its files. A module enters its kinds in `KINDS`."""

from sunspin.output.kind import KINDS
from sunspin.output.kinds import (  # noqa: F401
    calibration,
    collision,
    comparison,
    motion,
    outcomes,
    panels,
    posterior,
    predictions,
    rates,
    scan,
    strategies,
    telemetry,
)

__all__ = ["KINDS"]
