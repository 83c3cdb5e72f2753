"""Summary, figures and files of each kind of result. Each module registers its kinds in `KINDS`."""

from sunspin.output.kind import KINDS
from sunspin.output.kinds import (  # noqa: F401
    calibration,
    collision,
    comparison,
    history,
    motion,
    outcomes,
    panels,
    plan,
    pointing,
    posterior,
    predictions,
    rates,
    scan,
    strategies,
    telemetry,
)

__all__ = ["KINDS"]
