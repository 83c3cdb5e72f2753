"""The estimate of one pass: which motions fit it, under every model that may explain it, and how probable each is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import repeat

import numpy as np

from sunspin.base.errors import InputError
from sunspin.estimate.alternatives import alternatives
from sunspin.estimate.budget import Budget
from sunspin.estimate.chain import Chain, Fit
from sunspin.estimate.evidence import (
    PassFits,
    ladder,
    leading,
    likeliest,
    likeliest_cost,
    restated,
    united,
)
from sunspin.estimate.field_led import begun, field_of, in_axes_of, models_to_search
from sunspin.estimate.images import with_images
from sunspin.estimate.model import AS_STATED, Model, Noise, Track
from sunspin.estimate.quick import quick_evidence
from sunspin.estimate.search import search
from sunspin.estimate.settings import RatesSettings, SearchSettings
from sunspin.estimate.starts import (
    aliases,
    aliases_about_two_axes,
    other_bodies,
    pair_starts,
    pairs_to_try,
)
from sunspin.estimate.swings import swings_by_all_ways


@dataclass(frozen=True)
class PassFitter:
    """Fits passes side by side, each with a `budget` of its own; `run` is `map`, or that of a pool of processes."""

    settings: RatesSettings
    budget: Budget
    run: Callable = map

    def fits(self, models: Sequence[Model]) -> Iterable[PassFits]:
        """Yield the fits of passes, each as :func:`one_pass` returns them for its nominal model."""
        return self.run(one_pass, models, repeat(self.settings), repeat(self.budget))

    def quick_evidence(self, models: Sequence[Model]) -> Iterable[float]:
        """Yield the log evidence of passes by a quick search each (:mod:`sunspin.estimate.quick`)."""
        budgets = [replace(self.budget) for _ in models]
        return self.run(quick_evidence, models, repeat(self.settings), budgets)

    def fits_if_any(
        self, models: Sequence[Model], begin: Sequence[Track | None] | None = None
    ) -> list[PassFits | None]:
        """Return the fits of passes, None for one whose model allows no motion.

        `begin`: for each pass the motions from which its fit begins, or None if it is searched for them; by default all are.
        """
        every_begin = repeat(None) if begin is None else begin
        shared = repeat(self.settings), repeat(self.budget)
        return list(self.run(_one_pass_if_any, models, *shared, every_begin))


def one_pass(
    stated: Model, settings: RatesSettings, budget: Budget, begin: Track | None = None
) -> PassFits:
    """Return every motion of one pass under every model that may explain it, with evidence.

    `stated`: the nominal model of the samples kept for the search. `begin`: motions from which the fit begins, for which no search
    is made then: those of the same pass under a model that hardly differs.
    """
    s = settings
    budget = replace(budget)  # passes are estimated side by side, each with its own
    limit = stated.obs.cost_limit

    # Search: all motions that the readings allow while the inertia is held; then the fit, with all unknowns free.
    tracks = [begin] if begin is not None else searched(stated, s.search.noise, s.search, budget)
    fits = fitted(stated, tracks, s.search.noise, s)

    @cache
    def under_strong() -> list[Fit]:
        """Return the fits of a search as if strong torques acted, which two doubts may ask for."""
        tracks = searched(stated, s.ladder.strong, s.search, budget)
        return fitted(stated, tracks, s.ladder.strong, s)

    # An inertia that is wrong looks like torques: if no motion fits, search as if strong ones acted. Asked of the most probable
    # motion, as under the strongest torques nearly everything fits.
    if len(stated.body.errors) and likeliest_cost(fits) > limit:
        fits = min(fits, under_strong(), key=likeliest_cost)
    # Torques stand for the nutation of a body that the search took for a sphere, and for errors of a known inertia.
    strained = any(map(len, fits)) and likeliest(fits).model.noise.acceleration >= s.ladder.strained
    if strained and len(stated.body.errors) and stated.obs.only_sun:
        fits = united(fits + under_strong(), s.ladder, s.search)
    taken_for_sphere = bool(stated.body.sphere and len(stated.body.errors) and stated.obs.only_sun)
    # Without an inertia a motion beyond a largest rate that nobody stated may fit as well.
    beyond = s.alternatives.beyond if taken_for_sphere else 1.0
    # the nominal model with a larger limit, only for search and aliases
    reach = replace(stated, rate_sigma=beyond * stated.rate_sigma)
    if beyond > 1 and is_fast(fits, s.alternatives.fast_rad):
        tracks = searched(reach, s.search.noise, s.search, budget, stated.rate_max)
        fits = united(fits + fitted(stated, tracks, s.search.noise, s), s.ladder, s.search)
    if not any(len(one) for one in fits):
        raise InputError(
            "no motion has a well-defined probability",
            got=f"{len(stated.obs)} samples in the pass from {stated.obs.t_s[0]:.0f} s",
            do="add samples, or check their errors",
        )

    # Motions that the search may lose, as it holds the inertia: bodies of another shape, then whole revolutions more or less of
    # all that is found. This order, as a body without an inertia has its aliases only when its shape is known.
    far = replace(stated, rate_sigma=s.alternatives.beyond * stated.rate_sigma)
    for related, model in (
        (other_bodies, reach),
        (partial(aliases, s=s.alternatives), reach),
        (partial(aliases_about_two_axes, s=s.alternatives), far),
    ):
        others = related(leading(fits, s.alternatives.relatives_of, s.search), model)
        budget.spend(len(others) * len(stated.obs))
        fits += ladder(stated, others, s.ladder, s.search, s.ladder.strong)
        fits = united(fits, s.ladder, s.search)

    # Alternatives: what else may have moved the body. The generator sees `fits` grow: a second step of the rate is added to the
    # first.
    for model in alternatives(stated, fits, s.alternatives):
        if budget.exhausted():
            break
        fits += fits_of_alternative(model, fits, s, budget)
    # a stated strength of torques, a ladder of one rung, says that the body does not swing
    if stated.obs.only_sun and likeliest_cost(fits) <= limit and len(s.ladder.rungs) > 1:
        fits += swings_by_all_ways(stated, fits, s.alternatives, s.ladder)

    # All rungs are equally likely, until the passes of the file are compared (`evidence.share_noise`).
    even = np.full(len(s.ladder.rungs), -np.log(len(s.ladder.rungs)))
    return PassFits(
        stated=stated,
        fits=tuple(fits),
        rungs=s.ladder.rungs,
        log_rung=even,
        used=budget.used,
        cut=budget.cut,
    )


def searched(
    stated: Model, noise: float, s: SearchSettings, budget: Budget, slowest: float = 0.0
) -> list[Track]:
    """Return the motions that a search under unknown torques of this strength leaves: a track for each meaning of the readings.

    No start is slower than `slowest`, rad/s. A model that allows no motion has none, if slower ones were searched before.
    """
    # axes that follow the field turn: a motion that misses the limit there is no reason to begin elsewhere too
    if field_of(stated) is not None:
        of_search = replace(s, more_places=0)
    else:
        of_search = s
    tracks = []
    for loose in models_to_search(stated, Noise(noise)):
        chain, starts = Chain(loose, s), pair_starts(loose, s, slowest)
        try:
            places = 1 if slowest else pairs_to_try(loose, s)
            motions = search(chain, starts, of_search, budget, places)
        except InputError:
            if not slowest:
                raise
            continue
        tracks.append(in_axes_of(stated, loose, no_faster(loose, motions, s), s))
    return tracks


def no_faster(model: Model, motions: Track, s: SearchSettings) -> Track:
    """Return motions without those that turn faster than the largest rate in the mean, if one that does not fits.

    A start at the largest rate may end beyond it: at even samples in an alias that no reading rules out.
    """
    speed = np.linalg.norm(motions.omega, axis=2).mean(axis=1)
    slow = np.flatnonzero(speed <= model.rate_max)
    fits = motions.cost[slow].min(initial=np.inf) < s.good_enough * model.obs.cost_limit
    return motions.take(slow) if fits else motions


def is_fast(fits: Sequence[Fit], fast_rad: float) -> bool:
    """Return whether the most probable motion turns by more than `fast_rad` in the shortest interval between samples."""
    if not any(len(one) for one in fits):
        return False
    best = likeliest(fits)
    speed = np.linalg.norm(best.motions.omega[best.log_evidence.argmax()], axis=1).mean()
    return bool(speed * np.diff(best.model.obs.t_s).min() > fast_rad)


def fitted(stated: Model, tracks: Sequence[Track], noise: float, s: RatesSettings) -> list[Fit]:
    """Return fits on all rungs of motions and of their images; the first rung is the strength of torques of their search."""
    fits = []
    for motions in tracks:
        begin = begun(stated.under(noise), with_images(motions, stated, s.search))
        fits += ladder(stated, begin, s.ladder, s.search, noise)
    return united(fits, s.ladder, s.search)


def fits_of_alternative(
    model: Model, fits: Sequence[Fit], s: RatesSettings, budget: Budget
) -> list[Fit]:
    """Return fits of an alternative model, on the rungs that are not hopeless next to the best of the `fits` so far."""
    nominal = likeliest([one for one in fits if one.model.what == AS_STATED])
    # under the torques that the nominal model wants an alternative can grow; a stated strength may be too stiff for that
    rung = nominal.model.noise.acceleration
    rung = rung if len(s.ladder.rungs) > 1 else max(rung, s.search.noise)
    top = float(likeliest(fits).log_evidence.max())
    begin = leading(fits, s.alternatives.begin_with, s.search)
    begin = restated(begin, nominal.model, model.under(rung))
    of_ladder = replace(s.ladder, hopeless=s.alternatives.hopeless)
    new = ladder(model, begin, of_ladder, s.search, rung, top)
    budget.spend(sum(len(one) for one in new) * len(model.obs))
    return [one for one in new if one.log_evidence.max() > top - of_ladder.hopeless]


def _one_pass_if_any(
    stated: Model, settings: RatesSettings, budget: Budget, begin: Track | None
) -> PassFits | None:
    """Return the fits of a pass as :func:`one_pass` does; None if the model allows no motion at all."""
    try:
        return one_pass(stated, settings, budget, begin)
    except InputError:
        return None
