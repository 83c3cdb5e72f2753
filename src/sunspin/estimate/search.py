"""The search for all motions that the readings of a stretch allow.

Between two samples the body may turn whole turns more, or about another axis, so that the posterior density has many maxima. A
search begins where few starts are enough, with neighbouring samples. Candidates are fitted to them, those that the readings rule
out fall, and the window grows, by one sample at each end or more. A rate that is known from a window predicts the phase one window
further, so that a candidate stays near its minimum. Where a window leaves a direction of the rate nearly free, further candidates
stand along it (`Chain.widened`), and the search begins at several pairs of samples.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Protocol

import numpy as np

from sunspin.base.errors import InputError
from sunspin.estimate.budget import Budget
from sunspin.estimate.settings import SearchSettings


class Carrier(Protocol):
    """How motions are fitted, compared and carried on; windows are slices of the samples at `t_s` (n)."""

    t_s: np.ndarray

    def fit(self, motions: Any, window: slice) -> Any:
        """Return motions fitted to the samples of a window."""

    def kept(self, motions: Any, window: slice) -> Any:
        """Return motions without copies and improbable ones, best first."""

    def widened(self, motions: Any, window: slice, wider: slice) -> Any:
        """Return motions of a window at the samples of a wider one, with further ones that the window leaves open."""

    def joined(self, motions: list[Any]) -> Any:
        """Return the motions of several searches."""

    def cost_limit(self, window: slice) -> float:
        """Return the cost that a true motion does not exceed in a window."""


def search(
    carrier: Carrier,
    starts: Iterable[tuple[slice, Any]],
    s: SearchSettings,
    budget: Budget,
    places: int | None = None,
) -> Any:
    """Return all motions that the readings allow, best first.

    `starts`: windows with candidate motions, the most promising place first. Windows grow from each of the first `places` (default:
    that of the settings) to the whole stretch; from up to `s.more_places` more if no motion fits.
    """
    ends: list[Any] = []  # of each place the motions that reached the whole stretch
    everything = slice(0, len(carrier.t_s))
    places = s.places if places is None else places
    for number, (first, candidates) in enumerate(starts):
        window, motions = first, candidates
        while len(motions):
            motions = carrier.kept(carrier.fit(motions, window), window)
            budget.spend(len(motions) * (window.stop - window.start))
            if s.watch is not None:
                s.watch(window, motions)
            if window == everything:
                if len(motions):
                    ends.append(motions)
                break
            wider = grown(carrier.t_s, window, s.growth)
            motions, window = carrier.widened(motions, window, wider), wider
        best = min((float(motions.cost[0]) for motions in ends), default=np.inf)
        fits = best < s.good_enough * carrier.cost_limit(everything)
        # enough places have led to the end and one motion fits, or the last place that is allowed was tried
        if (len(ends) >= places and fits) or number + 1 == places + s.more_places:
            break
        if ends and budget.exhausted():  # never before there is any motion
            break
    if not ends:
        raise InputError(
            "no rate up to the largest allowed takes the Sun from one sample to the next",
            do="raise --max-rate-deg-s, or check the times and the directions",
        )
    return carrier.kept(carrier.joined(ends), everything)


def grown(t_s: np.ndarray, window: slice, growth: float) -> slice:
    """Return the window enlarged by the factor `growth`: half of the new samples at either end, and one there at least.

    At an end of the stretch it grows on the other side alone.
    """
    added = max(1, int((growth - 1) / 2 * (window.stop - window.start)))
    return slice(max(0, window.start - added), min(len(t_s), window.stop + added))
