"""The estimate of one pass: which motions fit it, under every model that may explain it, and how probable each is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import repeat
from typing import Any

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
    best_nominal_fit,
    ladder,
    merge_fits,
    rescale_unknowns,
)
from sunspin.estimate.field_led import (
    leading_field,
    models_to_search,
    prepare_fit,
    sunlit_window,
    to_nominal_axes,
    with_coarse_field_fits,
    with_known_field,
)
from sunspin.estimate.images import with_images
from sunspin.estimate.model import Model, Noise, Track
from sunspin.estimate.quick import quick_evidence
from sunspin.estimate.search import search
from sunspin.estimate.settings import LadderSettings, RatesSettings, SearchSettings
from sunspin.estimate.starts import (
    aliases,
    aliases_about_two_axes,
    inertia_leads_away,
    other_bodies,
    pair_starts,
    pairs_to_try,
)
from sunspin.estimate.swings import fits_of_oscillation
from sunspin.estimate.terms.field import FieldChange
from sunspin.estimate.terms.torques import GravityTorque


@dataclass(frozen=True)
class PassFitter:
    """Fits passes side by side, each with a copy of the `budget`; `run` is `map`, or that of a pool of processes."""

    settings: RatesSettings
    budget: Budget
    run: Callable = map

    def fits(self, models: Sequence[Model]) -> Iterable[PassFits]:
        """Yield the fits of each pass by :func:`one_pass`; `models`: the nominal model of each."""
        return self.run(one_pass, models, repeat(self.settings), repeat(self.budget))

    def quick_evidence(self, models: Sequence[Model]) -> Iterable[float]:
        """Yield the log evidence of each pass by a quick search (:mod:`sunspin.estimate.quick`)."""
        budgets = [replace(self.budget) for _ in models]
        return self.run(quick_evidence, models, repeat(self.settings), budgets)

    def fits_if_any(
        self, models: Sequence[Model], begin: Sequence[Track | None] | None = None
    ) -> list[PassFits | None]:
        """Return the fits of each pass, None if its model allows no motion.

        `begin`: for each pass the motions from which its fit begins, None for a search; default: a search for all.
        """
        begin_of_each = repeat(None) if begin is None else begin
        shared = repeat(self.settings), repeat(self.budget)
        return list(self.run(_one_pass_if_any, models, *shared, begin_of_each))


def one_pass(
    nominal: Model, settings: RatesSettings, budget: Budget, begin: Track | None = None
) -> PassFits:
    """Return the fits of all motions of one pass, under every model that may explain it, with their evidence.

    `nominal`: that of the samples kept for the search. `begin`: motions under a similar model, which replace the first search.
    """
    s, given = settings, nominal
    # each pass has its own budget, as passes are estimated side by side
    budget = replace(budget)

    # the search finds all motions that the readings allow, mostly with the inertia held; in the fit all unknowns are free
    nominal, tracks = search_first(given, begin, s.search, budget)
    fits = fit_tracks(nominal, tracks, s.search.noise, s)
    fits = search_again(nominal, fits, s, budget)
    if not any(map(len, fits)):
        raise InputError(
            "no motion has a well-defined probability",
            got=f"{len(nominal.obs)} samples in the pass from {nominal.obs.t_s[0]:.0f} s",
            do="add samples, or check their errors",
        )

    # Motions that the search may lose if it holds the inertia: bodies of another shape, then whole revolutions more or less of all
    # that is found. This order, as a body without an inertia has its aliases only when its shape is known. `factor`: on a largest
    # rate that nobody stated; revolutions about two axes are few, so any body may exceed it by them.
    beyond = s.alternatives.beyond if _inertia_by_sun(nominal) and nominal.body.sphere else 1.0
    for related, factor in (
        (other_bodies, beyond),
        (partial(aliases, s=s.alternatives), beyond),
        (partial(aliases_about_two_axes, s=s.alternatives), s.alternatives.beyond),
    ):
        # of the three most probable motions: each has many
        wider = replace(nominal, rate_sigma=factor * nominal.rate_sigma)
        others = related(best_motions(fits, 3, s.search), wider)
        budget.spend(len(others) * len(nominal.obs))
        fits += ladder(nominal, others, s.ladder, s.search, s.ladder.strong)
        fits = merge_fits(fits, s.ladder, s.search)

    fits = with_alternatives(nominal, fits, s, budget)
    # a stated strength of torques, a ladder of one rung, excludes an oscillation
    fits_well = best_cost(fits) <= nominal.obs.cost_limit
    if nominal.obs.only_sun and fits_well and len(s.ladder.rungs) > 1:
        fits += fits_of_oscillation(nominal, fits, s.alternatives, s.ladder)
    fits = without_too_weak_torques(nominal, fits, s.ladder)

    # all rungs are equally likely, until the passes of the file are compared (`evidence.share_noise`)
    even = np.full(len(s.ladder.rungs), -np.log(len(s.ladder.rungs)))
    return PassFits(given, tuple(fits), s.ladder.rungs, even, budget.used, budget.cut)


def without_too_weak_torques(nominal: Model, fits: Sequence[Fit], s: LadderSettings) -> list[Fit]:
    """Return the fits without those under torques weaker than the gravity gradient on a slow body, if that is not modelled.

    In the time T a constant acceleration g changes the rate by g T, and random ones of the strength q by q sqrt(T). So q must be at
    least g sqrt(T). A body that turns once or more in T averages the gradient out, and keeps all fits.
    """
    if nominal.obs.of_kind(GravityTorque) is not None or not any(map(len, fits)):
        return list(fits)
    omega, span_s = best_fit(fits).motions.omega[0], float(np.ptp(nominal.obs.t_s))
    if np.linalg.norm(omega, axis=1).mean() * span_s >= 2 * np.pi:
        return list(fits)
    low, middle, high = np.linalg.eigvalsh(nominal.body.inertia)
    acceleration = s.gradient_share * 1.5 * s.low_orbit_rad_s**2 * (high - low) / middle
    least = acceleration * np.sqrt(span_s)
    strong = [fitted for fitted in fits if fitted.model.noise.acceleration >= least]
    return strong if any(map(len, strong)) else list(fits)


def search_again(nominal: Model, fits: list[Fit], s: RatesSettings, budget: Budget) -> list[Fit]:
    """Return the fits of a pass after the further searches that the first one may call for.

    1. The most probable motion does not fit: under strong torques, as a wrong inertia looks like these.
    2. It still does not, and only the Sun shows the inertia: with the errors of the inertia as unknowns.
    3. It needs torques: under strong torques, and the motions are added.
    4. It is fast, and nobody stated inertia or largest rate: up to a larger rate, and the motions are added.

    `nominal`: with the errors of times that were rounded. `fits`: those after the first search, of the nominal model.
    """

    def search_and_fit(model: Model, noise: float, **options: Any) -> list[Fit]:
        """Return the fits of the motions that a search of `model` under unknown torques of the strength `noise` leaves."""
        tracks = search_motions(model, noise, s.search, budget, **options)
        return fit_tracks(nominal, tracks, noise, s)

    limit, inertia_by_sun = nominal.obs.cost_limit, _inertia_by_sun(nominal)
    # 1. An inertia that is wrong looks like torques. If the most probable motion does not fit, search as if strong ones
    # acted, once at most. Other motions do not count, since under the strongest torques nearly everything fits.
    under_strong_torques = cache(partial(search_and_fit, nominal, s.ladder.strong))
    if len(nominal.body.errors) and best_cost(fits) > limit:
        fits = min(fits, under_strong_torques(), key=best_cost)
    # 2. A long body that turns about its middle axis soon departs from any motion of an inertia that is one sigma off.
    if inertia_by_sun and not nominal.body.sphere and best_cost(fits) > limit:
        free = search_and_fit(nominal, s.ladder.strong, inertia_held=False)
        fits = min(fits, free, key=best_cost)
    # 3. Torques stand for the nutation of a body that the search took for a sphere, and for errors of a known inertia; or they
    # act, as the magnetic one, and one direction does not tell which motion they bend.
    strained = any(map(len, fits)) and best_fit(fits).model.noise.acceleration >= s.ladder.strained
    if strained and (inertia_by_sun or leading_field(nominal) is not None):
        fits = merge_fits(fits + under_strong_torques(), s.ladder, s.search)
    # 4. Without an inertia a motion beyond a largest rate that nobody stated may fit as well.
    may_be_faster = inertia_by_sun and nominal.body.sphere and s.alternatives.beyond > 1
    if may_be_faster and is_fast(fits):
        # a larger largest rate, for the search alone
        wider = replace(nominal, rate_sigma=s.alternatives.beyond * nominal.rate_sigma)
        faster = search_and_fit(wider, s.search.noise, slowest=nominal.rate_max)
        fits = merge_fits(fits + faster, s.ladder, s.search)
    return fits


def _inertia_by_sun(nominal: Model) -> bool:
    """Return whether the inertia is uncertain, and only the Sun shows whether a trial inertia is right."""
    return bool(len(nominal.body.errors) and nominal.obs.only_sun)


def search_first(
    nominal: Model, begin: Track | None, s: SearchSettings, budget: Budget
) -> tuple[Model, list[Track]]:
    """Return the nominal model with the errors of rounded times, and the motions that a first search leaves.

    How much an error of a time changes a reading is known only with a motion. So a first search drops fewer motions, and is
    repeated with the errors if they are large. `begin`: motions that replace those of the search.
    """
    rounded = nominal.obs.time_sigma_s > 0
    loose = replace(s, drop=s.drop * s.drop_if_rounded) if rounded else s
    searched = begin is None
    tracks = search_motions(nominal, s.noise, loose, budget) if searched else [begin]
    with_errors = with_time_errors(nominal, tracks, s.least_drift_rad)
    errors_are_large = with_time_errors(nominal, tracks, s.large_drift_rad) is not nominal
    if errors_are_large and searched:
        tracks = search_motions(with_errors, s.noise, s, budget)
    return with_errors, tracks


def with_alternatives(
    nominal: Model, fits: list[Fit], settings: RatesSettings, budget: Budget
) -> list[Fit]:
    """Return `fits`, those of the nominal model, and the fits of alternative models whose evidence is not far below the best.

    The models are tried in turn until the budget is used up. If a magnetometer has an unknown zero offset, the search may have
    dropped the true motion and kept an alias. So it is repeated under the model with such an offset if that has more evidence.
    """
    fits, search = list(fits), settings.search
    # `alternatives` reads this list while it grows: it tries a second step of the rate only if the first one raised the evidence
    for model in alternatives(nominal, fits, settings.alternatives):
        if budget.exhausted():
            break
        new = fits_of_alternative(model, fits, settings, budget)
        # several possible sigmas of the zero mark the model of a magnetometer without a stated one (`alternatives.another_zero`)
        field = model.obs.of_kind(FieldChange)
        if new and field is not None and len(field.zero_shares) > 1:
            gain = best_fit(new).log_evidence[0] - best_nominal_fit(fits).log_evidence[0]
            if gain > settings.alternatives.doubted:
                with suppress(InputError):  # the search may find no motion
                    tracks = search_motions(model, search.noise, search, budget)
                    again = fit_tracks(model, tracks, search.noise, settings)
                    new = merge_fits(new + again, settings.ladder, search)
        fits += new
    return fits


def with_time_errors(nominal: Model, tracks: Sequence[Track], least_drift_rad: float) -> Model:
    """Return the nominal model with the errors of the samples' times added to those of the readings.

    A time error changes a reading by the rate times it. For all motions the rate is that of the motion of least cost in `tracks`:
    if each had errors by its own rate, a fast alias would fit anything. The model is returned as it is if one sigma of time turns
    the body (or the Sun in it, if only the Sun is read) by less than `least_drift_rad` at all samples.

    Costs count residuals in sigmas, without the logs of the sigmas. So `log_prior` is lowered by the growth of these logs.
    Estimates of the pass with other wheels or columns, and so other errors, then stay comparable.
    """
    obs = nominal.obs
    best = [track.take(slice(0, 1)) for track in tracks if len(track)]
    if not (obs.time_sigma_s and best):
        return nominal
    motion = min(best, key=lambda track: track.cost.sum())
    of_sun, of_body = obs.turned_in_time_sigma(motion)
    if max(of_sun.max(), 0.0 if obs.only_sun else of_body.max()) < least_drift_rad:
        return nominal
    with_errors = obs.with_time_errors(motion)
    log_growth = sum(
        after.log_errors() - before.log_errors()
        for before, after in zip(obs.terms, with_errors.terms, strict=True)
    )
    return replace(nominal, obs=with_errors, log_prior=nominal.log_prior - log_growth)


def search_motions(
    nominal: Model,
    noise: float,
    s: SearchSettings,
    budget: Budget,
    *,
    slowest: float = 0.0,
    inertia_held: bool = True,
) -> list[Track]:
    """Return the motions that a search under unknown torques of the strength `noise` (rad/s^1.5) leaves, in axes N of `nominal`.

    There is a track for each model that is searched: several if readings may mean several things, as those of panels whose full
    scale is in doubt (`Model.for_search`). A model without a motion has no track. `slowest` (rad/s): slower starts are left out, as
    a search before this one had them. A single pair of samples to start from is then enough, and there may be no track at all. If
    `slowest` is zero that raises InputError. `inertia_held`: the inertia is fixed in the search, unless only the Sun is
    measured and its errors may lead a fast body away. If it is not fixed, its errors are unknowns.
    """
    # If the known field leads the search, N follows the field, which turns in space. Even the true motion may then miss the limit
    # at which a motion fits, so a misfit is no reason to start from further pairs.
    search_settings = s if leading_field(nominal) is None else replace(s, more_places=0)
    # If the Sun is not seen for long, the search begins where it is, and continues with the field as it is known in N.
    sunlit = sunlit_window(nominal, s)
    tracks, refused = [], None
    for model in models_to_search(nominal, Noise(noise)):
        in_window = model if sunlit is None else model.seeing(sunlit)
        starts, body = pair_starts(in_window, s, slowest), in_window.body
        held = inertia_held and not (in_window.obs.only_sun and inertia_leads_away(in_window, s))
        if not held:
            # the errors of the inertia become unknowns again, zero in each start
            body = nominal.body
            starts = (
                (window, replace(motions, u=np.zeros((len(motions), len(body.errors)))))
                for window, motions in starts
            )
        steps = s.steps if held else s.steps_if_inertia_free
        chain = Chain(replace(in_window, body=body), replace(s, steps=steps))
        try:
            places = 1 if slowest else pairs_to_try(in_window, s)
            motions = search(chain, starts, search_settings, budget, places)
            if sunlit is not None:
                # the angle about the Sun is known in the window, by the field, and so is the field in all other samples
                begin = prepare_fit(nominal.seeing(sunlit), motions)
                from_window = [(sunlit, Track.unfitted(begin.attitude, begin.omega))]
                whole = Chain(with_known_field(nominal, model), s)
                motions = search(whole, from_window, replace(s, more_places=0), budget, places=1)
        except InputError as error:
            refused = error
            continue
        tracks.append(to_nominal_axes(nominal, model, drop_faster(model, motions, s), s))
    if refused is not None and not (tracks or slowest):
        raise refused
    return tracks


def drop_faster(model: Model, motions: Track, s: SearchSettings) -> Track:
    """Return motions without those whose mean speed exceeds the largest rate, if a slower one fits; else all.

    A fit that begins at the largest rate may end beyond it. At even samples that may be an alias that no reading rules out.
    """
    speed = np.linalg.norm(motions.omega, axis=2).mean(axis=1)
    slow = np.flatnonzero(speed <= model.rate_max)
    slow_fits = motions.cost[slow].min(initial=np.inf) < s.good_enough * model.obs.cost_limit
    return motions.take(slow) if slow_fits else motions


def is_fast(fits: Sequence[Fit]) -> bool:
    """Return whether the most probable motion turns by more than half a revolution in the shortest interval."""
    if not any(map(len, fits)):
        return False
    best = best_fit(fits)
    speed = np.linalg.norm(best.motions.omega[0], axis=1).mean()
    return bool(speed * np.diff(best.model.obs.t_s).min() > np.pi)


def fit_tracks(
    nominal: Model, tracks: Sequence[Track], noise: float, s: RatesSettings
) -> list[Fit]:
    """Return fits of a search's motions and their mirror images under every strength of torques, first under `noise`.

    The most probable one is fitted once more from new first guesses (:func:`begin_again`).
    """
    fits = []
    for motions in tracks:
        under = nominal.under(noise)
        begin = prepare_fit(under, with_images(motions, nominal, s.search))
        begin = with_coarse_field_fits(under, begin)
        fits += ladder(nominal, begin, s.ladder, s.search, noise)
    fits = merge_fits(fits, s.ladder, s.search)
    again = begin_again(fits, s)
    return merge_fits(fits + again, s.ladder, s.search) if again else fits


def begin_again(fits: Sequence[Fit], s: RatesSettings) -> list[Fit]:
    """Return fits of the most probable motion from new first guesses of its unknowns; none if the cost hardly falls.

    The Earth's light is first guessed for a motion of the search (`Term.first_guess`). A search takes the light of Sun and Earth
    together for the Sun's, so that guess may lead the fit to a second minimum. The fitted motion gives a better one. Without this
    step a wrong motion, 7 sigma off, was decided in a pass, while the true one had a cost lower by 11.
    """
    if not any(map(len, fits)):
        return []
    best = best_fit(fits)
    motion = best.to_begin_from
    begin = prepare_fit(best.model, Track.unfitted(motion.attitude, motion.omega))
    if not begin.u.any():  # no term guesses anything but zero
        return []
    again = fit(best.model, begin, s.ladder.first_steps, s.ladder.tolerance).motions
    # a cost that is hardly lower is that of the same minimum
    if again.cost[0] >= motion.cost[0] - s.ladder.creeping:
        return []
    return ladder(best.model, again, s.ladder, s.search, best.model.noise.acceleration)


def fits_of_alternative(
    model: Model, fits: Sequence[Fit], s: RatesSettings, budget: Budget
) -> list[Fit]:
    """Return fits of an alternative model, under each strength of torques that is not hopeless compared with the best of `fits`."""
    of_nominal = best_nominal_fit(fits)
    # The fit begins under the torques that the nominal model needs, so that the alternative can replace them. A single stated
    # strength may be too weak for the motion to move in a fit.
    rung = of_nominal.model.noise.acceleration
    if len(s.ladder.rungs) == 1:
        rung = max(rung, s.search.noise)
    best = float(best_fit(fits).log_evidence[0])
    begin = best_motions(fits, 5, s.search)  # the five most probable ones
    begin = rescale_unknowns(begin, of_nominal.model, model.under(rung))
    ladder_settings = replace(s.ladder, hopeless=s.alternatives.hopeless)
    new = ladder(model, begin, ladder_settings, s.search, rung, rival=best)
    budget.spend(sum(len(fitted) for fitted in new) * len(model.obs))
    return [fitted for fitted in new if fitted.log_evidence.max() > best - s.alternatives.hopeless]


def _one_pass_if_any(
    nominal: Model, settings: RatesSettings, budget: Budget, begin: Track | None
) -> PassFits | None:
    """Return the fits of a pass as :func:`one_pass` does; None if the model allows no motion at all."""
    try:
        return one_pass(nominal, settings, budget, begin)
    except InputError:
        return None
