"""The computing budget of an estimate: counted in motions times samples, not in seconds, so that a result is the same anywhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sunspin.base.errors import InputError

USUAL = 8e4
"""Motions times samples that may be fitted in a pass with an effort of one. Passes of 40 samples took up to 2e3 with six panels,
and 4e3 to 6.7e4 with four or five, which bound the Sun direction less."""


@dataclass
class Budget:
    """How many motions times samples were `used` of the `most` allowed. `cut`: work was left out because the budget was used up."""

    most: float
    used: float = 0.0
    cut: bool = False

    @classmethod
    def of(cls, effort: float) -> Budget:
        """Return the budget of one pass for an effort: one is usual, infinity sets no limit."""
        number = isinstance(effort, int | float | np.number) and not isinstance(effort, bool)
        if not number or not effort > 0:
            what = "effort must be a positive number, or infinity"
            raise InputError(what, got=effort, do="1 is the usual effort")
        return cls(USUAL * float(effort))

    def spend(self, count: float) -> None:
        """Add so many motions times samples to those used."""
        self.used += count

    def exhausted(self) -> bool:
        """Return whether the budget is used up, and note in `cut` that the caller then leaves out the rest of its work."""
        if self.used >= self.most:
            self.cut = True
        return self.used >= self.most
