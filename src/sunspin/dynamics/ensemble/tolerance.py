"""What a caller may ask for: an error of the Sun's direction at the end of a run, or of the EMD of its distribution."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sunspin.base.errors import InputError

DIRECTION_ERROR = 1e-5
"""Default error of the Sun's direction at the end of a run, rad."""

SMALLEST_DIRECTION_ERROR = 1e-11
"""What double precision can promise over some thousand radians."""

EMD_ERROR = 1e-3
SMALLEST_EMD_ERROR = 2e-4
"""Below it the histogram's bins, and the three points that stand for a way, set a limit."""

NODE_ANGLE = 0.9
"""rad turned between nodes of the histogram where an EMD may err by EMD_ERROR; the error goes with its third power."""

PHASE_ERROR = 0.1
"""Error of the direction at the end (rad) where an EMD may err by EMD_ERROR: the same path, run through early or late."""

MIN_WAYS = 1024
"""Ways between nodes in a run: the distribution of a slow motion would be coarse otherwise."""


@dataclass(frozen=True)
class Accuracy:
    """What a run must reach: direction at the end (rad), longest way between nodes (rad), and whether only the EMD counts."""

    direction_error: float
    node_angle: float
    distribution_only: bool

    @classmethod
    def of_direction(cls, error: float | None) -> Accuracy:
        """For an error (rad) of the Sun's direction at the end; a histogram is then as good as EMD_ERROR."""
        error = DIRECTION_ERROR if error is None else error
        return cls(_checked("direction_error", error, SMALLEST_DIRECTION_ERROR), NODE_ANGLE, False)

    @classmethod
    def of_emd(cls, error: float) -> Accuracy:
        """For an error of the EMD."""
        share = _checked("emd_error", error, SMALLEST_EMD_ERROR) / EMD_ERROR
        return cls(PHASE_ERROR * share, NODE_ANGLE * min(1.0, share) ** (1 / 3), share >= 1.0)

    def with_true_phase(self) -> Accuracy:
        """The same with the direction as good as it must be for the distribution of a motion that hangs on it."""
        return replace(self, direction_error=0.1 * self.direction_error, distribution_only=False)


def accuracy(direction_error: float | None, emd_error: float | None) -> Accuracy:
    """What is asked for, checked: one of the two errors, or none for the default of the direction's."""
    if direction_error is not None and emd_error is not None:
        raise InputError(
            "ask for an error of the direction or of the EMD", got="both", do="give one of them"
        )
    return (
        Accuracy.of_direction(direction_error) if emd_error is None else Accuracy.of_emd(emd_error)
    )


def _checked(name: str, error: float, smallest: float) -> float:
    if not smallest <= error < np.inf:
        raise InputError(f"{name} must be at least {smallest:g}", got=error, do="ask for less")
    return float(error)
