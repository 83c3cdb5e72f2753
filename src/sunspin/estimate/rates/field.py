"""How the Earth's field turns along the orbit, unknowns of a pass of :mod:`sunspin.estimate.rates` that has a magnetometer.

Along a pass the field in N changes the same way for minutes, by up to two turns an orbit. Taken for noise from sample to sample
that averages out, and the turn about the Sun line, which only the field tells, is off by more than it says.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sunspin.estimate.rates.smooth import field_pairs, field_sigmas
from sunspin.estimate.rates.state import FIELD_TURN_RATE, Observations, Track, drifting

LEFT = 0.2
"""Part of the field's turning that does not change evenly over a pass, and stays noise."""


def count(o: Observations) -> int:
    """How many unknowns there are."""
    return o.field_unknowns.shape[1] if _is_read(o) else 0


def _is_read(o: Observations) -> bool:
    return bool(np.isfinite(o.field_sigma) and field_pairs(o).any())


def with_drift(o: Observations) -> Observations:
    """The same with the rate of change of the field in N, and of that, as unknowns of the pass."""
    if not _is_read(o):
        return o
    sigma = FIELD_TURN_RATE * np.nanmedian(np.linalg.norm(o.field, axis=1)) / np.sqrt(3)
    return replace(o, field_unknowns=drifting(o.t_s, sigma, FIELD_TURN_RATE), field_turn_rate=LEFT * FIELD_TURN_RATE)


def gained(o: Observations, track: Track) -> np.ndarray:
    """What one sigma of each unknown adds to the residuals of the field over each interval (K, n - 1, 3, m)."""
    change = np.einsum("knij,nmj->knim", track.attitude[:, 1:], o.field_unknowns[:-1])
    return change * np.where(field_pairs(o), np.diff(o.t_s) / field_sigmas(o), 0.0)[:, None, None]
