"""The estimate of one pass: which motions fit it, under every model that may explain it, and how probable each is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import repeat

import numpy as np

from sunspin.base.errors import InputError
from sunspin.estimate.alternatives import alternatives
from sunspin.estimate.budget import Budget
from sunspin.estimate.chain import Chain, Fit, fit
from sunspin.estimate.evidence import (
    PassFits,
    best_cost,
    best_fit,
    best_motions,
    ladder,
    merge_fits,
    rescale_unknowns,
)
from sunspin.estimate.field_led import leading_field, models_to_search, prepare_fit, to_nominal_axes
from sunspin.estimate.images import images_of, with_images
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
from sunspin.estimate.terms.field import FieldChange


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
    nominal: Model, settings: RatesSettings, budget: Budget, begin: Track | None = None
) -> PassFits:
    """Return every motion of one pass under every model that may explain it, with evidence.

    `nominal`: the nominal model of the samples kept for the search. `begin`: motions of the same pass under a model that hardly
    differs; the fit then begins from them, without a search.
    """
    s, limit = settings, nominal.obs.cost_limit
    # each pass has its own, as passes are estimated side by side
    flat = s.search.flat_budget if len(images_of(nominal)) > 1 else 1.0
    budget = replace(budget, most=flat * budget.most)

    def search_and_fit(
        model: Model, noise: float, slowest: float = 0.0, inertia_held: bool = True
    ) -> list[Fit]:
        """Return the fits of the motions that a search of `model` under unknown torques of this strength leaves."""
        tracks = search_motions(model, noise, s.search, budget, slowest, inertia_held)
        return fit_tracks(nominal, tracks, noise, s)

    # Search with the inertia held: all motions that the readings allow. Then the fit, with all unknowns free.
    exact = nominal
    nominal, tracks = search_first(exact, begin, s.search, budget)
    fits = fit_tracks(nominal, tracks, s.search.noise, s)

    # First doubt: an inertia that is wrong looks like torques. If no motion fits, search as if strong ones acted. The most probable
    # motion is asked, since under the strongest torques nearly everything fits.
    under_strong_torques = cache(partial(search_and_fit, nominal, s.ladder.strong))
    if len(nominal.body.errors) and best_cost(fits) > limit:
        fits = min(fits, under_strong_torques(), key=best_cost)
    inertia_by_sun = bool(len(nominal.body.errors) and nominal.obs.only_sun)
    # A long body that turns over its middle axis leaves any motion of the stated inertia, one sigma off, within a few turns.
    if inertia_by_sun and not nominal.body.sphere and best_cost(fits) > limit:
        free = search_and_fit(nominal, s.ladder.strong, inertia_held=False)
        fits = min(fits, free, key=best_cost)
    # Second: torques stand for the nutation of a body that the search took for a sphere, and for errors of a known inertia.
    strained = any(map(len, fits)) and best_fit(fits).model.noise.acceleration >= s.ladder.strained
    if strained and inertia_by_sun:
        fits = merge_fits(fits + under_strong_torques(), s.ladder, s.search)
    # Third: without an inertia a motion beyond a largest rate that nobody stated may fit as well. `wider`: the nominal model with a
    # larger limit, only for search and aliases.
    beyond = s.alternatives.beyond if inertia_by_sun and nominal.body.sphere else 1.0
    wider = replace(nominal, rate_sigma=beyond * nominal.rate_sigma)
    if beyond > 1 and is_fast(fits):
        faster = search_and_fit(wider, s.search.noise, nominal.rate_max)
        fits = merge_fits(fits + faster, s.ladder, s.search)
    if not any(map(len, fits)):
        raise InputError(
            "no motion has a well-defined probability",
            got=f"{len(nominal.obs)} samples in the pass from {nominal.obs.t_s[0]:.0f} s",
            do="add samples, or check their errors",
        )

    # Motions that the search may lose, as it holds the inertia: bodies of another shape, then whole revolutions more or less of
    # all that is found. This order, as a body without an inertia has its aliases only when its shape is known. Revolutions about
    # two axes are also tried beyond a largest rate that nobody stated, whatever the body: they are few.
    widest = replace(nominal, rate_sigma=s.alternatives.beyond * nominal.rate_sigma)
    for related, model in (
        (other_bodies, wider),
        (partial(aliases, s=s.alternatives), wider),
        (partial(aliases_about_two_axes, s=s.alternatives), widest),
    ):
        # of the three most probable motions: each has many
        others = related(best_motions(fits, 3, s.search), model)
        budget.spend(len(others) * len(nominal.obs))
        fits += ladder(nominal, others, s.ladder, s.search, s.ladder.strong)
        fits = merge_fits(fits, s.ladder, s.search)

    fits = with_alternatives(nominal, fits, s, budget)
    # a stated strength of torques, a ladder of one rung, says that the body does not swing
    if nominal.obs.only_sun and best_cost(fits) <= limit and len(s.ladder.rungs) > 1:
        fits += swings_by_all_ways(nominal, fits, s.alternatives, s.ladder)

    # All rungs are equally likely, until the passes of the file are compared (`evidence.share_noise`).
    even = np.full(len(s.ladder.rungs), -np.log(len(s.ladder.rungs)))
    return PassFits(
        nominal=exact,
        fits=tuple(fits),
        rungs=s.ladder.rungs,
        log_rung=even,
        used=budget.used,
        cut=budget.cut,
    )


def search_first(
    nominal: Model, begin: Track | None, s: SearchSettings, budget: Budget
) -> tuple[Model, list[Track]]:
    """Return the nominal model, with the errors of times that were rounded, and the motions that a first search leaves.

    How much the errors of the times change a reading is known once a motion is. Motions are searched again if that is much; else
    the one search drops less. `begin`: motions that take the place of those of a search.
    """
    rounded = nominal.obs.time_sigma_s > 0
    loose = replace(s, drop=s.drop * s.drop_if_rounded) if rounded else s
    searched = begin is None
    tracks = search_motions(nominal, s.noise, loose, budget) if searched else [begin]
    with_errors = with_time_errors(nominal, tracks, s.least_drift_rad)
    turns_far = with_time_errors(nominal, tracks, s.large_drift_rad) is not nominal
    if turns_far and searched:
        tracks = search_motions(with_errors, s.noise, s, budget)
    return with_errors, tracks


def with_alternatives(
    nominal: Model, fits: list[Fit], settings: RatesSettings, budget: Budget
) -> list[Fit]:
    """Return the fits of the nominal model and of all models of what else may have moved the body."""
    fits, search = list(fits), settings.search
    # the generator sees `fits` grow: a second step of the rate is added to the first
    for model in alternatives(nominal, fits, settings.alternatives):
        if budget.exhausted():
            break
        new = fits_of_alternative(model, fits, settings, budget)
        if new and doubts_field(model):
            # The search believed the magnetometer. If it is not calibrated the true motion may be lost, and an alias stands there.
            of_nominal = best_fit([fitted for fitted in fits if fitted.model.what == AS_STATED])
            gain = best_fit(new).log_evidence.max() - of_nominal.log_evidence.max()
            if gain > settings.alternatives.doubted:
                with suppress(InputError):  # nothing else may fit
                    tracks = search_motions(model, search.noise, search, budget)
                    again = fit_tracks(model, tracks, search.noise, settings)
                    new = merge_fits(new + again, settings.ladder, search)
        fits += new
    return fits


def doubts_field(model: Model) -> bool:
    """Return whether a model takes a magnetometer whose zero the file does not state for one that is not calibrated."""
    fields = [term for term in model.obs.terms if isinstance(term, FieldChange)]
    return any(len(term.zero_shares) > 1 for term in fields)


def with_time_errors(nominal: Model, tracks: Sequence[Track], least_drift_rad: float) -> Model:
    """Return the nominal model with the errors of the samples' times added to those of the readings.

    A time error changes a reading by the rate times it. The rate is that of the motion of least cost in `tracks`, for all motions:
    with errors of its own a fast alias would fit anything. The model is returned as it is if one sigma of time turns the body (or
    the Sun in it, if only the Sun is read) by less than `least_drift_rad` at all samples.

    Costs count residuals in sigmas, without the logs of the sigmas. So `log_prior` is lowered by what these logs grow. Estimates of
    the pass with other wheels or columns, and so other errors, then stay comparable.
    """
    obs = nominal.obs
    best = [track.take(slice(0, 1)) for track in tracks if len(track)]
    if not (obs.time_sigma_s and best):
        return nominal
    motion = min(best, key=lambda track: track.cost.sum())
    of_sun, of_body = obs.turned_in_time_sigma(motion)
    if max(of_sun.max(), 0.0 if obs.only_sun else of_body.max()) < least_drift_rad:
        return nominal
    wider = obs.with_time_errors(motion)
    log_growth = sum(
        after.log_errors() - before.log_errors()
        for before, after in zip(obs.terms, wider.terms, strict=True)
    )
    return replace(nominal, obs=wider, log_prior=nominal.log_prior - log_growth)


def search_motions(
    nominal: Model,
    noise: float,
    s: SearchSettings,
    budget: Budget,
    slowest: float = 0.0,
    inertia_held: bool = True,
) -> list[Track]:
    """Return the motions that a search under unknown torques of strength `noise` leaves.

    There is a track for each model that is searched: several if readings may mean several things, as those of panels whose full
    scale is in doubt (`Model.for_search`). No start is slower than `slowest`, rad/s. Without such a limit a search that leaves no
    motion raises InputError. With one, slower motions were searched before, so that one pair of samples to start from is enough,
    and the list may be empty. The inertia is held, or has its errors as unknowns while the window grows, which takes longer.
    """
    # Axes that follow the field turn in space, so that a right motion may cost more than the limit there, and would ask for further
    # pairs of samples.
    search_settings = s if leading_field(nominal) is None else replace(s, more_places=0)
    tracks = []
    for loose in models_to_search(nominal, Noise(noise)):
        starts, body = pair_starts(loose, s, slowest), loose.body
        if not inertia_held:
            body = nominal.body
            starts = (
                (window, replace(begin, u=np.zeros((len(begin), len(body.errors)))))
                for window, begin in starts
            )
        chain = Chain(replace(loose, body=body), s)
        try:
            places = 1 if slowest else pairs_to_try(loose, s)
            motions = search(chain, starts, search_settings, budget, places)
        except InputError:
            if not slowest:
                raise
            continue
        tracks.append(to_nominal_axes(nominal, loose, drop_faster(loose, motions, s), s))
    return tracks


def drop_faster(model: Model, motions: Track, s: SearchSettings) -> Track:
    """Return motions without those that turn faster than the largest rate in the mean, if one that does not fits.

    A start at the largest rate may end beyond it: at even samples in an alias that no reading rules out.
    """
    speed = np.linalg.norm(motions.omega, axis=2).mean(axis=1)
    slow = np.flatnonzero(speed <= model.rate_max)
    fits = motions.cost[slow].min(initial=np.inf) < s.good_enough * model.obs.cost_limit
    return motions.take(slow) if fits else motions


def is_fast(fits: Sequence[Fit]) -> bool:
    """Return whether the most probable motion turns by more than half a revolution in the shortest interval."""
    if not any(map(len, fits)):
        return False
    best = best_fit(fits)
    speed = np.linalg.norm(best.motions.omega[best.log_evidence.argmax()], axis=1).mean()
    return bool(speed * np.diff(best.model.obs.t_s).min() > np.pi)


def fit_tracks(
    nominal: Model, tracks: Sequence[Track], noise: float, s: RatesSettings
) -> list[Fit]:
    """Return fits of motions and their images under every strength of torques; `noise`, that of their search, comes first."""
    fits = []
    for motions in tracks:
        begin = prepare_fit(nominal.under(noise), with_images(motions, nominal, s.search))
        fits += ladder(nominal, begin, s.ladder, s.search, noise)
    fits = merge_fits(fits, s.ladder, s.search)
    again = begin_again(fits, s)
    return merge_fits(fits + again, s.ladder, s.search) if again else fits


def begin_again(fits: Sequence[Fit], s: RatesSettings) -> list[Fit]:
    """Return fits of the most probable motion with unknowns guessed again, if a fit that begins so ends at a lower cost; or none.

    The first guess of the Earth's light is made along motions of a search, which take Sun and Earth's light together for the Sun.
    It may lead to a second minimum; along the fitted motion it is better. Without this a pass was decided 7 sigma off whose true
    motion cost 11 less.
    """
    if not any(map(len, fits)):
        return []
    best = best_fit(fits)
    motion = best.take(np.array([np.argmax(best.log_evidence)])).to_begin_from
    begin = prepare_fit(best.model, Track.free(motion.attitude, motion.omega))
    if not begin.u.any():  # no term guesses its unknowns
        return []
    again = fit(best.model, begin, s.ladder.first_steps, s.ladder.tolerance).motions
    if again.cost[0] >= motion.cost[0] - s.ladder.creeping:
        return []
    return ladder(best.model, again, s.ladder, s.search, best.model.noise.acceleration)


def fits_of_alternative(
    model: Model, fits: Sequence[Fit], s: RatesSettings, budget: Budget
) -> list[Fit]:
    """Return fits of an alternative model, under the strengths of torques that are not hopeless next to the best of `fits`."""
    most_probable = best_fit([fitted for fitted in fits if fitted.model.what == AS_STATED])
    # The fit begins under the torques that the nominal model wants, so that the alternative can take their place. A stated strength
    # may hold the motion too stiffly for that.
    rung = most_probable.model.noise.acceleration
    if len(s.ladder.rungs) == 1:
        rung = max(rung, s.search.noise)
    top = float(best_fit(fits).log_evidence.max())
    begin = best_motions(fits, 5, s.search)  # the most probable ones
    begin = rescale_unknowns(begin, most_probable.model, model.under(rung))
    ladder_settings = replace(s.ladder, hopeless=s.alternatives.hopeless)
    new = ladder(model, begin, ladder_settings, s.search, rung, top)
    budget.spend(sum(len(fitted) for fitted in new) * len(model.obs))
    return [fitted for fitted in new if fitted.log_evidence.max() > top - ladder_settings.hopeless]


def _one_pass_if_any(
    nominal: Model, settings: RatesSettings, budget: Budget, begin: Track | None
) -> PassFits | None:
    """Return the fits of a pass as :func:`one_pass` does; None if the model allows no motion at all."""
    try:
        return one_pass(nominal, settings, budget, begin)
    except InputError:
        return None
