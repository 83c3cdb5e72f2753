"""How strong the unknown torques are that a pass of :mod:`sunspin.estimate.rates` shows: white angular acceleration, by evidence.

Twice: for the search, which holds the body for what its file says and takes all that it is not for torques; and once the motion is
found, with inertia, a magnetic torque and the light of the Earth as unknowns, which then explain most of that.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from sunspin.base.errors import InputError
from sunspin.estimate.rates.common_errors import Clock, Common, cooler, with_common
from sunspin.estimate.rates.motion import Body
from sunspin.estimate.rates.rough import roughly
from sunspin.estimate.rates.search import SEED_NOISE, cooled, distinct_index, guesses, seeds
from sunspin.estimate.rates.state import Motion, Observations, Track

NOISE_LADDER = (5e-7, 5e-6, 2e-5, 1e-4, 3e-4)
"""Angular-acceleration noises (rad/s^1.5) tried where none is given; at 3e-4 a rate wanders by 0.3 deg/s in 5 minutes."""

HIGHER_NOISES = (1e-3, 3e-3)
"""Tried where the highest of these is the best: strong torques, or a body with other moments than the file says."""

LADDER_PASSES = 2
"""Passes whose evidence chooses among them."""

CLEARLY = 2.0
"""Log of the evidence: where the data hardly tell, less noise would promise more than is known."""

EVIDENCE_MODES = 4
"""Hypotheses that are fitted with gains that are unknown where the evidence of a noise is asked for."""

SPHERE_NOISES = (1e-2,)
"""Tried too where no inertia is known: for the search the body is a sphere, and all that it is not looks like torques."""


def choose(
    o: Observations,
    parts: list[np.ndarray],
    body: Body,
    rate_max: float,
    noise: float | None,
    wheels: dict[str, np.ndarray],
    run: Callable[[Sequence[Task]], list[np.ndarray]],
) -> tuple[float, Observations, str]:
    """The acceleration noise (of `NOISE_LADDER`, unless given) and what the wheels do, by their evidence over the passes with
    the most samples; with these wheels in the observations, and in words. `run`: what :func:`evidence_of_noises` makes of each."""
    noises = NOISE_LADDER if noise is None else (noise,)
    if len(noises) * len(wheels) == 1:
        name = next(iter(wheels))
        return noises[0], replace(o, momentum=wheels[name]), name
    longest = sorted(parts, key=len, reverse=True)[:LADDER_PASSES]
    evidence: dict[tuple[float, str], float] = {}
    ladder = (
        (noises, HIGHER_NOISES)
        if len(noises) == 1 or not body.spherical
        else (noises + HIGHER_NOISES + SPHERE_NOISES,)
    )
    open_still = list(wheels)
    for rungs in ladder:
        tasks = [
            (replace(o, momentum=wheels[what]).take(part), body, rungs, rate_max)
            for what in open_still
            for part in longest
        ]
        totals = np.reshape(run(tasks), (len(open_still), len(longest), len(rungs))).sum(axis=1)
        for what, total in zip(open_still, totals, strict=True):
            evidence |= {
                (rung, what): float(value) for rung, value in zip(rungs, total, strict=True)
            }
        best = {
            what: max(rungs, key=lambda rung, what=what: evidence[rung, what])
            for what in open_still
        }
        open_still = [
            what for what, rung in best.items() if noise is None and rung == NOISE_LADDER[-1]
        ]
        if not open_still:
            break
    level, name = max(evidence, key=lambda one: evidence[one])
    others = [value for (_, other), value in evidence.items() if other != name]
    told = (
        f"{name} (evidence {evidence[level, name] - max(others):.1f} above any other)"
        if others
        else name
    )
    return level, replace(o, momentum=wheels[name]), told


Task = tuple[Observations, Body, tuple[float, ...], float]
"""A pass, its body, noises (rad/s^1.5) and the largest rate (rad/s)."""


def evidence_of_noises(
    o: Observations, body: Body, noises: tuple[float, ...], rate_max: float
) -> tuple[np.ndarray, str]:
    """Log of the probability of a pass under each noise, up to a constant, minus infinity where nothing fits at all; and a rough
    answer, empty there.

    From the loosest to the stiffest, each from where the one before ended. Gains that are unknown are so here too: held at the
    vehicle file's, what they do to the Sun's direction would pass for strong torques. The inertia is the file's.
    """
    each, words = zip(
        *(_evidence_of(o, guess, body, noises, rate_max) for guess in guesses(o)), strict=True
    )
    return np.logaddexp.reduce(each, axis=0), words[0]


QUICK_NOISES = (1e-4, 5e-6)
"""Those under which wirings are compared: the search's own, and a quiet one."""


def quick_evidence(o: Observations, part: np.ndarray, body: Body, rate_max: float) -> float:
    """Log of the probability of a pass, up to a constant that only the readings' number decides: for comparing wirings.

    With the sigmas of the readings counted, which follow the wiring; one that is left out counts as if it might be anything up to
    full light.
    """
    o = o.take(part)
    size = sum(term.log_size() for term in o.of_sun)
    return float(evidence_of_noises(o, body, QUICK_NOISES, rate_max)[0].max() - size)


def _evidence_of(
    o: Observations, guess: Observations, body: Body, noises: tuple[float, ...], rate_max: float
) -> tuple[np.ndarray, str]:
    """The same with the motions that are found as `guess` has the measurements."""
    found, rough = np.full(len(noises), -np.inf), ""
    motion = Motion(body, max(*noises, SEED_NOISE), rate_max / 2)
    try:
        track, last = seeds(guess, motion, rate_max, pairs=1), motion.noise
    except InputError:
        return found, rough
    for k in np.argsort(noises)[::-1]:
        motion = replace(motion, noise=noises[k])
        track, last = cooled(guess, track, last, motion), noises[k]
        rough = rough or roughly(o, track)
        known = replace(motion, body=replace(body, errors=body.errors[:0]))
        free = any(term.unknowns() for term in o.of_sun)
        fit = (
            with_common(o, track.take(slice(EVIDENCE_MODES)), known, None).track if free else track
        )
        found[k] = np.logaddexp.reduce(fit.log_weight) - 6 * (len(o) - 1) * np.log(noises[k])
    return found, rough


def falling(begin: float, end: float = 0.0) -> list[float]:
    """The rungs (rad/s^1.5) from that of the search downward, as far as `end`."""
    between = (
        noise for noise in sorted(NOISE_LADDER + HIGHER_NOISES, reverse=True) if end < noise < begin
    )
    return [begin, *between, *([end] if 0.0 < end < begin else [])]


def refined(passes: list[tuple[Observations, Track]], motion: Motion) -> float:
    """The acceleration noise (rad/s^1.5) with all unknowns of a pass in place, at most that of the search: by the evidence of the
    best modes of the longest passes, falling rung by rung, the largest that is not clearly worse than the best."""
    longest = sorted(passes, key=lambda one: len(one[0]), reverse=True)[:LADDER_PASSES]
    rungs = falling(motion.noise)
    total = np.zeros(len(rungs))
    for o, track in longest:
        fit = with_common(o, track.take(np.array([0])), motion, None)
        for k, noise in enumerate(rungs):
            fit = cooler(o, fit, replace(motion, noise=noise))
            total[k] += float(fit.track.log_weight[0]) - 6 * (len(o) - 1) * np.log(noise)
    return rungs[int(np.argmax(total > total.max() - CLEARLY))]


def settled(
    o: Observations,
    track: Track,
    motion: Motion,
    clock: Clock | None,
    begin: float,
    thinned: bool = False,
) -> Common:
    """Hypotheses that were found under an acceleration noise `begin`, fitted with all unknowns, there first, then rung by rung;
    `thinned`: without copies and the improbable at each."""
    first, *others = falling(begin, motion.noise)
    fit = with_common(o, track, replace(motion, noise=first), clock)
    for noise in others:
        fit = fit.take(distinct_index(fit.track, o.t_s)) if thinned else fit
        fit = cooler(
            o, fit, replace(motion, noise=noise), clock, 20 if noise == motion.noise else 8
        )
    return fit
