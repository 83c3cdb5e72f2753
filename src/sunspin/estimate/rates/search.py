"""How :mod:`sunspin.estimate.rates` searches: starts of a pair of neighbours are tried on samples around, and grow.

Starts (:mod:`sunspin.estimate.rates.start`) are coarse, and a Student law lets a start that misses most samples rest where it is.
So they are tried, and first smoothed, with errors as wide as the starts are apart; the best are smoothed as measured, and the
window grows by a sixth at either end while hypotheses that have become alike or improbable are dropped.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from sunspin.base.errors import InputError
from sunspin.estimate.effort import may_go_on
from sunspin.estimate.rates.copies import Outline
from sunspin.estimate.rates.images import FAMILIES, images_of, joined_images, one_of_each
from sunspin.estimate.rates.motion import step
from sunspin.estimate.rates.shoot import carried, shot
from sunspin.estimate.rates.smooth import cost_limit, costs, smooth
from sunspin.estimate.rates.start import (
    blind_axis,
    candidates,
    gyro_decides,
    mirrored,
    starts,
    steady,
)
from sunspin.estimate.rates.state import Motion, Observations, Track, joined
from sunspin.estimate.rates.valley import neighbours
from sunspin.estimate.terms.known_field import KnownField
from sunspin.estimate.terms.magnetometer import Magnetometer
from sunspin.estimate.terms.panels import Panels
from sunspin.estimate.terms.term import SUN_N, SunTerm, facing

WINDOW = 2
"""Samples on either side of the first pair on which the rates are first tried."""

DENSE_RAD = 2.2
"""Samples so close that the body turns by less than this between them leave no doubt about whole turns."""

CROWD, PAIRED, CHOSEN = 3000, 20_000, 1500
"""More starts than the first number are thinned before they are tried on the whole window: on the pair, to the second number at
most, and smoothed on the four samples around it, to the third."""

BLUR = 0.6
"""Errors of starts as a share of their distance from each other."""

SEED_NOISE = 1e-4
"""rad/s^1.5; hypotheses grow under at least this much of unknown torque, however well the motion is known."""

COOLING = 1.7
"""The unknown torque falls by exp(1.7) at each step from there to what is asked for."""

GROW_SHARE = 6
"""The window grows by a sixth of its samples at either end: what is known then still carries."""

FEWEST_SUNS = 4
"""Samples that show the Sun; with fewer, a search begins with the field where it is known."""

FIELD_TURNS = 8
"""Turns about the field that are tried."""

UNSEEN = 100.0
"""Intervals count so many times longer where a sample does not show the Sun: none is begun with."""

POOR, DRIFT_RAD = 0.4, 0.1
"""A hypothesis that costs more than this share of what is called bad is shot anew, where unknown torques turn the body by less
than the second number."""

PAIRS, MORE_PAIRS, BADLY = 3, 2, 0.8
"""Pairs to start from; how many more where even the best hypothesis costs more than this share of what is called bad."""

BLIND_PAIRS = 4
"""Pairs to start from where panels lie in one plane, so that a sample limited by the battery looks like a Sun that stands aside."""

WIDE_RAD = 1.0
"""A sample that allows directions of the Sun farther apart than this gives no direction: one panel alone leaves a ring around its
normal."""

DIM_PENALTY = 3.0
"""So much longer is a pair of samples reckoned where both are dark."""

MAX_TURNS = 100
"""Whole turns between two samples, at most: where both bound the Sun only, as many would make a million rates to try."""

KEEP_FIRST, KEEP = 120, 32
"""Hypotheses kept after the first trial, and while the window grows."""

DROP = 18.0
"""Hypotheses less probable than the best by exp(-18) are dropped."""


def wider(o: Observations, noise: float, index: int, apart_rad: float) -> Observations:
    """The same measurements, trusted as far as starts at sample `index` go: those are `apart_rad` apart at the next sample, and
    the farther a sample is the more unknown torques (`noise`, rad/s^1.5) have changed."""
    t = np.abs(o.t_s - o.t_s[index])
    dt = o.t_s[index + 1] - o.t_s[index]
    drift = np.hypot(noise * np.sqrt(t**3 / 3), BLUR * apart_rad * t / dt)
    drift_rad_s = float(np.hypot(BLUR * apart_rad / dt, noise * np.sqrt(t.max())))
    return replace(o, terms=tuple(term.wider(drift, drift_rad_s) for term in o.terms))


def first_tracks(
    o: Observations, index: int, motion: Motion, rate_max: float, trust: bool = False
) -> tuple[Track, int, int]:
    """The best rates around the pair (index, index + 1), smoothed on samples low to high - 1; `trust`: the gyro is one of them."""
    low, high = max(0, index - WINDOW), min(len(o), index + 2 + WINDOW)
    o, index = o.part(low, high), index - low
    dt = o.t_s[index + 1] - o.t_s[index]
    if not rate_max * dt < 2 * np.pi * MAX_TURNS:
        raise InputError(
            "too many whole turns fit between two samples to try them all",
            got=f"{rate_max * dt / (2 * np.pi):.3g} turns",
            do="give a smaller --max-rate-deg-s (max_rate_rad_s)",
        )
    suns, rates, apart = starts(o, index, motion, rate_max, trust)
    if len(rates) > CROWD:
        suns, rates = _thinned(o, index, suns, rates, motion, apart)
    if not len(rates):
        return Track(np.zeros((0, len(o), 3, 3)), np.zeros((0, len(o), 3))), low, high
    track = _best(o, index, suns, rates, motion, apart, KEEP_FIRST)
    for share in (1.0, 0.3, 0.0):
        track = distinct(
            shot(wider(o, motion.noise, index, share * apart), index, track, motion, 4),
            o.t_s,
            KEEP_FIRST,
        )
    return distinct(smooth(o, track, motion, steps=6), o.t_s), low, high


def _best(o, index, suns, rates, motion, apart, keep) -> Track:
    """The `keep` starts at sample `index` that fit all samples of `o` best, moved to them."""
    loose = wider(o, motion.noise, index, apart)
    track = carried(o, index, facing(suns), rates, motion)
    parts = np.array_split(np.arange(len(rates)), 1 + len(rates) // 4000)
    cost = np.concatenate([costs(loose, track.take(part)).sum(axis=1) for part in parts])
    cost += (rates**2).sum(axis=1) / (2 * motion.rate_prior**2)
    return track.take(np.argsort(cost, kind="stable")[:keep])


def _require_directions(o: Observations, tried: np.ndarray) -> None:
    """Raise `InputError` if each pair (i, i + 1) of samples `tried` has one that leaves the direction of the Sun open."""
    spread = [
        np.arccos(np.clip((c @ c.T).min(), -1, 1)) for c in map(partial(_one_sun, o), range(len(o)))
    ]
    wide = np.array(spread) > WIDE_RAD
    if not (wide[tried] | wide[tried + 1]).all():
        return
    do = "`sunspin check` prints what each sample determines"
    for panels in (term for term in o.of_sun if isinstance(term, Panels)):
        read = np.isfinite(panels.sigma)
        most, count = int(read.sum(axis=1).max()), panels.sigma.shape[1] - len(panels.left_out)
        if most < count:
            do = (
                f"a row has readings of {most} of {count} panels at most: "
                "set sample_span_s under [telemetry] to the time in which all are read"
            )
    raise InputError(
        "too few Sun directions to estimate a rate",
        got=f"{np.count_nonzero(~wide)} of {len(o)} samples in the pass from {o.t_s[0]:.0f} s give one",
        do=do,
    )


def _one_sun(o: Observations, index: int) -> np.ndarray:
    """Return directions (n, 3) that span what the sample `index` allows, of symmetric ones only one."""
    return one_of_each(o, candidates(o, index))


def _thinned(o, index, suns, rates, motion, apart) -> tuple[np.ndarray, np.ndarray]:
    """The better ones of a crowd of starts, smoothed on four samples at errors as wide as the starts are apart."""
    pair = _best(o.part(index, index + 2), 0, suns, rates, motion, apart, PAIRED)
    low, high = max(0, index - 1), min(len(o), index + 3)
    around, index = o.part(low, high), index - low
    track = _best(around, index, pair.sun_B[:, 0], pair.omega[:, 0], motion, apart, CHOSEN)
    track = shot(wider(around, motion.noise, index, apart), index, track, motion, 3)
    track = distinct(track, around.t_s, CHOSEN, np.inf)
    return track.sun_B[:, index], track.omega[:, index]


def distinct(track: Track, times: np.ndarray, keep: int = KEEP, drop: float = DROP) -> Track:
    """Without the improbable and without copies, best first."""
    return track.take(distinct_index(track, times, keep, drop))


def distinct_index(
    track: Track, times: np.ndarray, keep: int = KEEP, drop: float = DROP
) -> np.ndarray:
    """Which hypotheses those are."""
    order = np.argsort(track.cost, kind="stable")
    if not len(order):
        return order
    order = order[track.cost[order] < track.cost[order[0]] + drop]
    outline = Outline.of(track, times)
    chosen = np.zeros(0, dtype=int)
    for i in order:
        if not outline.copies(i, outline.take(chosen)).any():
            chosen = np.append(chosen, i)
        if len(chosen) == keep:
            break
    return chosen


def grow(o: Observations, track: Track, low: int, high: int, motion: Motion) -> Track:
    """Carry hypotheses of samples low to high - 1 over all samples."""
    while len(track.omega) and (low > 0 or high < len(o)):
        part = o.part(low, high)
        # the covariance of what does not fit says nothing
        fitting = np.flatnonzero(track.cost < POOR * cost_limit(part))
        more = neighbours(part, track.take(fitting), motion)
        attitude = np.concatenate([track.attitude, more.attitude])
        omega = np.concatenate([track.omega, more.omega])
        for _ in range(max(1, (high - low) // GROW_SHARE)):
            if high < len(o):
                dt = np.full(len(omega), o.t_s[high] - o.t_s[high - 1])
                ends = motion.body.seen(o.wheels(high - 1, high), attitude[:, -1], o.t_s[high - 1])
                made, rate = step(motion.body, omega[:, -1], dt, ends)
                attitude = np.concatenate([attitude, (made @ attitude[:, -1])[:, None]], axis=1)
                omega = np.concatenate([omega, rate[:, None]], axis=1)
                high += 1
            if low > 0:
                dt = np.full(len(omega), o.t_s[low - 1] - o.t_s[low])
                ends = motion.body.seen(o.wheels(low, low - 1), attitude[:, 0], o.t_s[low])
                made, rate = step(motion.body, omega[:, 0], dt, ends)
                attitude = np.concatenate([(made @ attitude[:, 0])[:, None], attitude], axis=1)
                omega = np.concatenate([rate[:, None], omega], axis=1)
                low -= 1
        part = o.part(low, high)
        track = _freed(
            part, distinct(smooth(part, Track(attitude, omega), motion, steps=4), part.t_s), motion
        )
    return track


def _freed(o: Observations, track: Track, motion: Motion) -> Track:
    """Return hypotheses with those moved that fit badly in a window so short that the motion is stiff."""
    poor = np.flatnonzero(track.cost > POOR * cost_limit(o))
    if not len(poor) or not _stiff(o, motion):
        return track
    good = np.setdiff1d(np.arange(len(track.cost)), poor)
    moved = _shot(o, track.take(poor), motion)
    return distinct(joined([track.take(good), moved]) if len(good) else moved, o.t_s)


def _stiff(o: Observations, motion: Motion) -> bool:
    """Return whether unknown torques hardly turn the body over the samples: the smoother creeps there, and shooting does not."""
    half_s = np.abs(o.t_s - o.t_s[len(o) // 2]).max()
    return bool(motion.noise * np.sqrt(half_s**3 / 3) <= DRIFT_RAD)


def _shot(o: Observations, track: Track, motion: Motion) -> Track:
    """Return hypotheses fitted by shooting from the middle sample, and smoothed."""
    middle = len(o) // 2
    return smooth(
        o, shot(wider(o, motion.noise, middle, 0.0), middle, track, motion, 8), motion, steps=4
    )


def search(o: Observations, motion: Motion, rate_max: float, pairs: int | None = None) -> Track:
    """All modes of a pass, best first."""
    loose = replace(motion, noise=max(motion.noise, SEED_NOISE))
    return cooled(o, with_images(o, seeds(o, loose, rate_max, pairs), loose), loose.noise, motion)


def with_images(o: Observations, track: Track, motion: Motion) -> Track:
    """The modes with all images of the best that are not images of each other."""
    images = images_of(o)
    if len(images) == 1:
        return track
    chosen: list[int] = []
    outline = Outline.of(track, o.t_s)
    for i in range(len(track.cost)):
        as_seen = Outline.of(joined_images(track.take(np.array([i])), images), o.t_s)
        others = outline.take(np.array(chosen, dtype=int))
        if not any(as_seen.steps_alike(m, others).any() for m in range(len(images))):
            chosen.append(i)
        if len(chosen) == FAMILIES:
            break
    others = smooth(o, joined_images(track.take(np.array(chosen)), images[1:]), motion)
    return distinct(joined([track, others]), o.t_s)


def guesses(o: Observations) -> list[Observations]:
    """What is searched: each sensor trusted no further than its common errors, and whatever else its readings may mean; by the
    field's directions in place of the Sun's where hardly any sample shows the Sun."""
    if field_leads(o):
        others = (term for term in o.terms if not isinstance(term, SunTerm | Magnetometer))
        return [replace(o, terms=(_known(o).directions(), *(term.forgiving() for term in others)))]
    return [replace(o, terms=terms) for terms in product(*(term.guesses() for term in o.terms))]


def field_leads(o: Observations) -> bool:
    """Whether a field that is known in space leads the search: too few samples show the Sun."""
    return bool(
        o.informed.sum() < FEWEST_SUNS
        and any(isinstance(x, Magnetometer) and x.known is not None for x in o.terms)
    )


def _known(o: Observations) -> KnownField:
    return next(
        term.known for term in o.terms if isinstance(term, Magnetometer) and term.known is not None
    )


def out_of_field(o: Observations, track: Track, motion: Motion) -> Track:
    """Hypotheses in axes that follow the field, as the search by its directions gives them, brought to N: smoothed with the field
    as it is known, from several turns about it, of which the field's turning in space leaves few."""
    known = _known(o)
    frames, turning = known.frames(), known.turning(o.t_s)
    tried = []
    for angle in 2 * np.pi / FIELD_TURNS * np.arange(FIELD_TURNS):
        attitude = track.attitude @ Rotation.from_rotvec(angle * SUN_N).as_matrix() @ frames
        tried.append(Track(attitude, track.omega + np.einsum("knij,nj->kni", attitude, turning)))
    with_field = replace(
        o, terms=tuple(known if isinstance(term, Magnetometer) else term for term in o.terms)
    )
    return distinct(joined([smooth(with_field, one, motion, steps=12) for one in tried]), o.t_s)


def brightness(o: Observations) -> np.ndarray:
    """Light (n) of each sample as a share of full Sun, where panels say it."""
    relative = [term.relative() for term in o.of_sun if isinstance(term, Panels)]
    return np.linalg.norm(np.concatenate(relative, axis=1), axis=1) if relative else np.ones(len(o))


def cooled(o: Observations, track: Track, noise: float, motion: Motion) -> Track:
    """Hypotheses of a loose motion (`noise`) brought to a stiffer one by steps: at once, they would stay where they are."""
    steps = int(np.ceil(abs(np.log(noise / motion.noise)) / COOLING))
    for level in np.geomspace(noise, motion.noise, steps + 1)[1:]:
        track = distinct(smooth(o, track, replace(motion, noise=float(level)), steps=12), o.t_s)
    track = distinct(smooth(o, track, motion, steps=25), o.t_s)
    if len(track.cost) > 1 and _stiff(o, motion):
        # those that still creep along the valley of the best are copies of it, which they are at its end
        others = _shot(o, track.take(slice(1, None)), motion)
        track = distinct(joined([track.take(slice(1)), others]), o.t_s)
    return track


def bright_pairs(o: Observations) -> np.ndarray:
    """Pairs of neighbours, those first whose whole windows are bright: there the Sun stands in the plane of the panels and the
    battery limits nothing. Windows that overlap come later, since what spoils one spoils the other."""
    dim = 1 - np.minimum(brightness(o), 1.0)
    ends = np.arange(len(o) - 1)
    window = [dim[max(0, i - 1) : i + 3].mean() for i in ends]
    order = np.argsort(np.diff(o.t_s) * (1 + DIM_PENALTY * np.array(window)), kind="stable")
    first: list[int] = []
    for i in order:
        if all(abs(i - j) > WINDOW for j in first):
            first.append(i)
    return np.array(first + [i for i in order if i not in first])


def seeds(o: Observations, motion: Motion, rate_max: float, pairs: int | None = None) -> Track:
    """Modes under a loose motion: from the `pairs` shortest intervals, grown over the whole pass and joined.

    Default: three, or one where the samples begin so close together that no rate hides between them, where a grid holds all
    rates anyway, or a gyro tells. Where nothing found fits, more are tried before that is said. Panels in one plane bound the Sun
    so little that four pairs are tried in any case, and each motion found is tried mirrored.
    """
    blind = blind_axis(o)
    quality = np.where(o.points, 1.0, 2.0) * np.where(
        o.informed | (not o.informed.any()), 1.0, UNSEEN
    )
    order = (
        np.argsort(np.diff(o.t_s) * (quality[1:] + quality[:-1]), kind="stable")
        if blind is None
        else bright_pairs(o)
    )
    dense = np.diff(o.t_s)[:3].max(initial=0.0) * rate_max < DENSE_RAD
    trust = gyro_decides(o, int(order[0]))
    one = dense or trust or not steady(o, int(order[0]), motion, rate_max)
    pairs = BLIND_PAIRS if blind is not None else pairs or (1 if one else PAIRS)
    tracks: list[Track] = []
    for i in order[: pairs + MORE_PAIRS]:
        best = min((float(track.cost[0]) for track in tracks), default=np.inf)
        if (len(tracks) >= pairs and best < BADLY * cost_limit(o)) or (tracks and not may_go_on()):
            break
        track = grow(o, *first_tracks(o, int(i), motion, rate_max, trust and not tracks), motion)
        tracks += [track] if len(track.omega) else []
    if not tracks:
        _require_directions(o, order[: pairs + MORE_PAIRS])
        raise InputError(
            "no rate up to the largest allowed takes the Sun from one sample to the next",
            got=f"largest rate {rate_max:.4g} rad/s",
            do="raise --max-rate-deg-s, or check the times and the directions",
        )
    track = distinct(joined(tracks), o.t_s)
    if blind is None:
        return track
    return distinct(joined([track, smooth(o, mirrored(track, blind), motion)]), o.t_s)
