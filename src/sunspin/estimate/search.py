"""The search for all motions that the readings of a pass allow.

Between two samples the body may make more whole revolutions, or rotate about another axis, so the posterior density has many
maxima. A search begins with two or three neighbouring samples, for which few starts suffice. These trial solutions are fitted,
those that the readings rule out are dropped, and the window of samples grows at both ends. A rate that is known from a window
predicts the phase one window further, so a trial solution stays near its maximum. If a window hardly determines a direction of the
rate, further ones are placed along it (`Chain.widened`). `rates` repeats the search elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Protocol

import numpy as np

from sunspin.base.errors import InputError
from sunspin.estimate.budget import Budget
from sunspin.estimate.settings import SearchSettings


class Carrier(Protocol):
    """How a search fits, compares and propagates motions of its own type; windows are slices of the samples at `t_s` (n), s."""

    t_s: np.ndarray

    def fit(self, motions: Any, window: slice) -> Any:
        """Return motions fitted to the samples of a window."""

    def kept(self, motions: Any, window: slice) -> Any:
        """Return motions fitted to a window without copies and improbable ones, the best first."""

    def widened(self, motions: Any, window: slice, wider: slice) -> Any:
        """Return the motions of a window at the samples of a wider one, and further ones that the window also allows."""

    def joined(self, motions: list[Any]) -> Any:
        """Return the motions of several parts as one object."""

    def cost_limit(self, window: slice) -> float:
        """Return the cost that a true motion does not exceed in a window."""


def search(
    carrier: Carrier,
    starts: Iterable[tuple[slice, Any]],
    s: SearchSettings,
    budget: Budget,
    places: int | None = None,
) -> Any:
    """Return all motions that the readings allow, the best first.

    `starts`: windows with the motions from which a search begins there, the most promising window first. From each of the first
    `places` (default: that of the settings) the window grows to all samples; from up to `s.more_places` more if no motion fits.
    """
    ends: list[Any] = []  # motions that reached all samples, one entry for each place
    everything = slice(0, len(carrier.t_s))
    places = s.places if places is None else places
    for number, (window, motions) in enumerate(starts):
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
        # end if enough places have led to all samples and a motion fits, or if this was the last place that is allowed
        if (len(ends) >= places and fits) or number + 1 == places + s.more_places:
            break
        if ends and budget.exhausted():  # not before there is a motion
            break
    if not ends:  # a carrier that always keeps some motions, as that of a lander, does not get here
        raise InputError(
            "no rate up to the largest allowed takes the Sun from one sample to the next",
            do="raise --max-rate-deg-s, or check the times and the directions",
        )
    return carrier.kept(carrier.joined(ends), everything)


def grown(t_s: np.ndarray, window: slice, growth: float) -> slice:
    """Return the window enlarged by the factor `growth`: half of the new samples at either end, at least one.

    At the first and last of all samples, at times `t_s` (n), it grows on the other side alone.
    """
    added = max(1, int((growth - 1) / 2 * (window.stop - window.start)))
    return slice(max(0, window.start - added), min(len(t_s), window.stop + added))
