"""The evidence of a pass by a quick search, to compare vehicles whose columns, axes or signs differ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import logsumexp

from sunspin.base.errors import InputError
from sunspin.estimate.budget import Budget
from sunspin.estimate.chain import Chain
from sunspin.estimate.evidence import ladder
from sunspin.estimate.model import Model, Noise, Track
from sunspin.estimate.search import search
from sunspin.estimate.settings import RatesSettings
from sunspin.estimate.starts import pair_starts
from sunspin.estimate.terms.panels import Panels

RUNGS = (1e-4, 5e-6)
"""Strengths of unknown torques (rad/s^1.5) that are compared: that of the search, and a weak one."""

MOTIONS = 8
"""Motions whose evidence is summed, at most: the best ones of a search."""


def quick_evidence(
    nominal: Model, settings: RatesSettings, budget: Budget, known: Track | None = None
) -> float:
    """Return the log evidence of a pass from a quick search, up to a constant that depends only on the number of readings.

    It is minus infinity if the model allows no motion. To save time, inertia and gains are held at the values of the vehicle file,
    the search begins at one pair of samples, and only two strengths of unknown torques, `RUNGS`, are tried: the larger evidence
    counts. `known`: motions (K) of the pass from which the fits begin; then no search is made.
    """
    s = replace(settings.search, more_places=0)  # begins at one place
    ladder_settings = replace(settings.ladder, rungs=RUNGS)
    log_evidence = np.full(len(RUNGS), -np.inf)
    # a model for each possible meaning of the readings (`Model.for_search`); their evidence is summed
    for model in nominal.for_search(Noise(s.noise)):
        if known is None:
            try:
                motions = search(Chain(model, s), pair_starts(model, s), s, budget, places=1)
            except InputError:  # this meaning allows no motion
                continue
        else:
            motions = Track.unfitted(known.attitude, known.omega)
        for fitted in ladder(model, motions.take(slice(MOTIONS)), ladder_settings, s, s.noise):
            rung = RUNGS.index(fitted.model.noise.acceleration)
            log_evidence[rung] = np.logaddexp(log_evidence[rung], logsumexp(fitted.log_evidence))
    # densities of panel readings have a factor 1 / sigma, which costs leave out; it must count, as sigmas depend on the vehicle
    panels = nominal.obs.of_kind(Panels)
    return float(log_evidence.max()) - (0.0 if panels is None else sum_of_log_sigmas(panels))


def sum_of_log_sigmas(panels: Panels) -> float:
    """Return the sum of the logs of the sigmas of all panel readings, and of the brightness factor of each sample.

    It is the part of minus log likelihood that comes from the normalisation 1 / sigma of each density, which the costs leave out.
    Sigmas belong to columns: evidence that compares orders of the columns must include it. A reading that is left out, with an
    infinite sigma, counts with full Sun as its sigma: as if it could be anything up to that. Panels that count in no sample of the
    file, and samples without a finite sigma of the brightness, are left out of the sum.
    """
    sigma = np.where(np.isfinite(panels.sigma), panels.sigma, panels.full_sun)
    sigma = sigma[:, panels.ever_shown]
    scale = panels.scale_sigma[np.isfinite(panels.scale_sigma)]
    return float(np.log(sigma).sum() + np.log(scale).sum())
