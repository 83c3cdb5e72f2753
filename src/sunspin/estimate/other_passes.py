"""Passes that are fitted again from the steady rotation of other passes of the file, as a search may lose a motion in one of them.

A satellite that rotates steadily about one axis in most passes hardly does otherwise in another. If that one needs torques, or does
not fit, its search may have dropped the true motion. The rate is known from the other passes; the attitude is not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sunspin.estimate.chain import costs, propagate
from sunspin.estimate.evidence import PassFits, best_fit, merge_fits
from sunspin.estimate.model import AS_STATED, Model, Track
from sunspin.estimate.one_pass import fit_tracks, without_too_weak_torques
from sunspin.estimate.settings import LadderSettings, RatesSettings
from sunspin.estimate.terms.field import KnownField
from sunspin.estimate.terms.term import facing
from sunspin.solve.rotations import rotate_attitude
from sunspin.vehicle.response.planes import sphere

STEADY = 0.1
"""Largest change of the rate in a pass, as a share of the rate, of a rotation that counts as steady."""

DIRECTIONS, ANGLES = 150, 24
"""Trial attitudes: directions of the Sun, 17 degrees apart, and angles about it."""

MOST = 16
"""Trial motions that are fitted: those that cost least."""


def fit_from_other_passes(fits: Sequence[PassFits], s: RatesSettings) -> list[PassFits]:
    """Return the fits of all passes, with further ones of each that needs torques or does not fit.

    The further fits begin at the rate of the nearest pass that rotates steadily without torques. If there is no such pass, there
    are none.
    """
    rate_of_pass = [
        None if _is_strained(of_pass, s.ladder) else _steady_rate(of_pass) for of_pass in fits
    ]
    steady = {k: rate for k, rate in enumerate(rate_of_pass) if rate is not None}
    result = list(fits)
    for k, of_pass in enumerate(fits):
        stated = [fitted.model for fitted in of_pass.fits if fitted.model.what == AS_STATED]
        if not (steady and stated and _is_strained(of_pass, s.ladder)):
            continue
        nearest = min(steady, key=lambda other: abs(other - k))
        begin = _motions_of_rate(stated[0], steady[nearest])
        further = fit_tracks(stated[0], [begin], s.search.noise, s)
        merged = merge_fits([*of_pass.fits, *further], s.ladder, s.search)
        strong = without_too_weak_torques(of_pass.nominal, merged, s.ladder)
        result[k] = replace(of_pass, fits=tuple(strong))
    return result


def _is_strained(of_pass: PassFits, s: LadderSettings) -> bool:
    """Return whether the most probable motion of a pass does not fit, or needs strong torques or an alternative model."""
    best = best_fit(of_pass.fits)
    misfits = best.motions.cost[0] > of_pass.nominal.obs.cost_limit
    strong = best.model.noise.acceleration >= s.strained
    return bool(misfits or strong or best.model.what != AS_STATED)


def _steady_rate(of_pass: PassFits) -> np.ndarray | None:
    """Return the mean rate (3), rad/s, of the most probable motion of a pass; None if the rate changes along the pass."""
    omega = best_fit(of_pass.fits).motions.omega[0]
    mean = omega.mean(axis=0)
    change = np.linalg.norm(omega - mean, axis=1).max()
    return mean if change < STEADY * np.linalg.norm(mean) else None


def _motions_of_rate(model: Model, rate: np.ndarray) -> Track:
    """Return the motions with the rate (3) at the middle sample, and attitudes of all kinds there, that cost least."""
    (searched, *_) = model.for_search(model.noise)
    # without a known field the angle about the Sun changes nothing
    count = 1 if model.obs.of_kind(KnownField) is None else ANGLES
    directions = sphere(DIRECTIONS)[:, None]
    turns = np.linspace(0, 2 * np.pi, count, endpoint=False)[:, None] * directions
    attitudes = rotate_attitude(facing(directions), turns).reshape(-1, 3, 3)
    rates = np.broadcast_to(rate, (len(attitudes), 3))
    trials = propagate(searched, len(model.obs) // 2, attitudes, rates)
    order = np.argsort(costs(searched.obs, trials).sum(axis=1), kind="stable")
    return trials.take(order[:MOST])
