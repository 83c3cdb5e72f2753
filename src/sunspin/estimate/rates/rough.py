"""A rough answer while :mod:`sunspin.estimate.rates` is still at work: how fast the motions turn that were found first.

They fit the plain model best. Nothing is weighed yet: no errors in common, no other model, no neighbour, no verdict.
"""

from __future__ import annotations

import numpy as np

from sunspin.estimate.rates.state import Observations, Track

NAMED, MOST = 0.05, 3
"""Motions that are named: lighter than the heaviest by no more than the first, and so many."""


def roughly(o: Observations, track: Track) -> str:
    """A line on a pass: when it begins, its samples, the speeds (deg/s, two figures) of its heaviest motions so far."""
    order = np.argsort(-track.log_weight, kind="stable")
    heavy = order[track.log_weight[order] > track.log_weight[order[0]] + np.log(NAMED)]
    speed = np.degrees(np.linalg.norm(track.omega[heavy], axis=-1).mean(axis=1))
    told = list(dict.fromkeys(f"{float(f'{one:.2g}'):g}" for one in speed))
    others = " or others" if len(told) > MOST else ""
    return f"  {o.t_s[0]:10.0f} s  {len(o):3d} samples  rough, not weighed yet: {' or '.join(told[:MOST])}{others} deg/s"
