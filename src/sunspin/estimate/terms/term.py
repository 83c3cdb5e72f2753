"""What a posterior estimates beside the motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Unknown:
    """Something that is estimated beside the motion: its name, what kind it is, unit, prior centre and sigma, which of its kind it
    is, and how far (sigmas) a trial may be from the centre."""

    name: str
    kind: str
    unit: str
    centre: float
    sigma: float
    index: int = 0
    limit: float = np.inf
