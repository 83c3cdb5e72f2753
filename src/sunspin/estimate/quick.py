"""How probable a pass is, by a quick search: to compare vehicles whose columns, axes or signs differ."""

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
"""Strengths of unknown torques (rad/s^1.5) that are compared: the search's own, and a quiet one."""

MOTIONS = 8
"""Motions of a search whose probabilities are summed, at most."""


def quick_evidence(
    nominal: Model, settings: RatesSettings, budget: Budget, known: Track | None = None
) -> float:
    """Return the log of the probability of a pass, up to a constant that depends only on the number of readings.

    It is minus infinity if no motion is possible. Inertia and gains are those of the file, the search begins at one pair of
    samples, and the better one of two strengths of torques counts. `known`: motions of the pass that a search has found already; no
    search is made then.
    """
    s = replace(settings.search, more_places=0)
    few = replace(settings.ladder, rungs=RUNGS)
    log = np.full(len(RUNGS), -np.inf)
    for loose in nominal.for_search(Noise(s.noise)):
        try:
            motions = (
                search(Chain(loose, s), pair_starts(loose, s), s, budget, 1)
                if known is None
                else Track.free(known.attitude, known.omega)
            )
        except InputError:
            continue
        for fitted in ladder(loose, motions.take(slice(MOTIONS)), few, s, s.noise):
            rung = RUNGS.index(fitted.model.noise.acceleration)
            log[rung] = np.logaddexp(log[rung], logsumexp(fitted.log_evidence))
    return float(log.max()) - sum(
        log_size(term) for term in nominal.obs.terms if isinstance(term, Panels)
    )


def log_size(panels: Panels) -> float:
    """Return the sum of the logs of all sigmas of readings and of brightness: the norm of their likelihood.

    The sigmas depend on the order of the columns, which the evidence is to compare. A reading that is left out counts with full Sun
    as its sigma. Readings of panels without any signal do not count.
    """
    sigma = np.where(np.isfinite(panels.sigma), panels.sigma, panels.full_sun)
    sigma = sigma[:, panels.ever_shown]
    scale = panels.scale_sigma[np.isfinite(panels.scale_sigma)]
    return float(np.log(sigma).sum() + np.log(scale).sum())
