"""What may be wrong with the model of a pass of :mod:`sunspin.estimate.rates`: tried, weighed by evidence, and counted in.

Beside the model as stated each pass is fitted with a constant torque in body axes or in axes fixed in space, with steps of the
rate, with stronger unknown torques, with a swinging too quick for the samples, with sensors worse than stated, with a gyro's zero
that is off though the file takes it for known, and where samples are few without one reading or two. Each is the list of terms with
one entry changed (:mod:`sunspin.estimate.rates.hypotheses`) and begins at the best modes found. All are as likely before the data,
and so is each size of a swinging, since satellites under control do swing. How strong a torque is nobody knows even to a power of
ten, nor when a step comes: sizes are log-uniform over wide ranges and a step may be anywhere, which costs evidence; so does a
reading left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunspin.estimate.rates.common_errors import Common, again, places_of
from sunspin.estimate.rates.copies import Outline
from sunspin.estimate.rates.hypotheses import AS_STATED, Hypothesis
from sunspin.estimate.rates.motion import step
from sunspin.estimate.rates.noise import falling
from sunspin.estimate.rates.search import distinct_index
from sunspin.estimate.rates.smooth import TURN_PRIOR, Intervals, cost_limit, log_noise
from sunspin.estimate.rates.state import Track
from sunspin.estimate.rates.wandering import about_most, log_evidence
from sunspin.estimate.terms.steady_torque import WORDS, SteadyTorque, sizes
from sunspin.estimate.terms.term import MotionTerm, PairTerm, StateTerm, SunTerm, normal
from sunspin.estimate.terms.unsteady import RateStep, Swinging
from sunspin.solve.rotations import rotate_by_smallest, rotation_between

SLOWER = np.geomspace(1.0, 1 / 30, 6)
"""How much less than up to the largest rate a body may turn: each as likely as any other where the rate may be of any size."""

MODES, LIGHTEST, MORE_MODES = 2, 0.02, 5
"""Modes from which alternatives begin, at most, and the least weight of one; and modes from which those begin that may lead far."""

STRONGER = (3.0, 10.0, 30.0)
"""How much stronger unknown torques may be than elsewhere in the file."""

CALMER = (0.3, 0.1, 0.03)
"""How much weaker unknown torques along the axis of a spin may be than across it: what passes for torques there, other light and
soft iron and moments, hardly changes the spin."""

SPIN_RAD = 2 * np.pi * 10
"""A body spins if its mean rate turns it so far in a pass."""

COARSER = (1.5, 2.5, 5.0)
"""How much worse a sensor may be than stated."""

ZEROS = np.radians(np.geomspace(0.03, 3.0, 5))
"""rad/s by which a gyro's zero may be off where the file states no sigma: each as likely as any other."""

FEW, MOST_BAD = 6, 2
"""Samples of a pass up to which readings are left out, since a bad one is not outvoted; and how many are, at most."""

BAD = float(np.log(0.1 / 0.9))
"""Log odds that a reading is bad, whatever its sensor states: it may then be anything."""

MOST_STEPS = 4
"""Steps of the rate in a pass, at most."""

STEP_SIZES = float(np.log(np.log(100.0)))
"""What it costs in log evidence that the size of a step is known to a factor of a hundred only, and put where it comes out."""

HOPELESS, WORSE = 6.0, 1.0
"""Log evidence by which an alternative must be no worse than the model as stated, and a smaller noise no worse than a larger one,
if more of the kind is to be tried."""

STEPS, CLOSE = 6, 0.03
"""Steps of a fit at most; one that promises to gain less than the second, in log density, is the last."""

SWINGS, OTHER_MODES = (0.05, 0.15, 0.5), float(np.log(5.0))
"""rad by which a swinging turns the body between two samples; and what the modes add to the log evidence of one that is found from
few: a body that swings may have turned any number of times, and many such motions fit."""

WANDERS = (0.15, 0.3, 0.6, 1.2)
"""The same of a swinging of which all ways are counted."""

ROUGHLY = 0.5
"""Log evidence a sample by which the quick guess at what they can reach may be too low."""

ALIASED = 1.5
"""rad turned between two samples beyond which whole turns may be a swinging's doing."""

COUNTED = 0.01
"""A mode of an alternative that holds less than this part of the weight is left out."""

TORQUES_STRONGER, SWINGS_QUICKLY = (
    "unknown torques stronger than in the rest of the file",
    "a swinging quicker than the samples",
)
"""What such hypotheses change, in words."""


class Trial(NamedTuple):
    """A hypothesis fitted from some modes (K); `log_evidence` (K) of each."""

    hypothesis: Hypothesis
    fit: Common
    log_evidence: np.ndarray

    @property
    def best(self) -> float:
        return float(np.max(self.log_evidence, initial=-np.inf))

    @property
    def any_size(self) -> np.ndarray:
        """What each mode (K) gains in log evidence if nobody knows to a power of ten how fast the body turns; nothing where the fit
        ended on a slope, with a covariance that is none."""
        track, prior = self.fit.track, self.hypothesis.motion.rate_prior
        covariance = track.covariance[:, 0, 3:, 3:] / prior**2
        fine = np.linalg.eigvalsh(np.nan_to_num(covariance))[:, 0] > 0
        gains = (
            _sized(
                track.omega[:, 0] / prior,
                np.where(fine[:, None, None], covariance, np.eye(3)),
                SLOWER,
            )
            * fine
        )
        return np.logaddexp.reduce(gains, axis=0) - np.log(len(SLOWER))

    def take(self, index: np.ndarray) -> Trial:
        """The modes `index`."""
        return Trial(self.hypothesis, self.fit.take(index), self.log_evidence[index])


class Others(NamedTuple):
    """How alternatives are tried: `free`, the acceleration noise was chosen by the data, so that less of it may be left where
    something else explains the motion; `clock_time`: a time (s) in words."""

    free: bool
    clock_time: Callable[[float], str]


def weighed(one: Hypothesis, fit: Common) -> Trial:
    """A fit with its evidence."""
    return Trial(one, fit, fit.track.log_weight - log_noise(one.fitted(), one.motion) + one.debt)


def alternatives(stated: Trial, how: Others) -> list[Trial]:
    """The model as stated and its alternatives."""
    weight = pooled([stated])
    order = np.argsort(-weight, kind="stable")[:MODES]
    start = stated.take(order[weight[order] > LIGHTEST * weight.max()])
    noises = [stated, *_stronger(start)]
    calmer = list(_steady_spin(start))
    loosest = max(
        [start, *noises[1:]], key=lambda trial: trial.best
    )  # where torques and steps that the noise holds down can grow
    rungs = falling(
        loosest.hypothesis.motion.noise, 0.0 if how.free else stated.hypothesis.motion.noise
    )[1:]
    shared = [
        trial._replace(log_evidence=trial.log_evidence - np.log(1 + len(STRONGER) + len(calmer)))
        for trial in (*noises, *calmer)
    ]
    found = [
        *shared,
        *_torques(loosest, rungs),
        *_steps(loosest, rungs, how.clock_time),
        *_coarser(start),
        *_off_zero(start),
    ]
    found += _without_readings(stated, how.clock_time)
    found += (
        [*_swinging(stated), *_wandering(stated)] if how.free else []
    )  # else the vehicle's file says what torques there are
    return [one for one in found if np.isfinite(one.best)]


def pooled(trials: list[Trial]) -> np.ndarray:
    """Weights of the modes of all trials, one after another, that add to one: of each the larger of two, with every rate up to the
    largest as likely, most of which are near the largest, and with every size of it. Whole turns more may fit alike, and which
    motion is the likelier must not hang on what was taken for likely before."""
    log = np.concatenate([trial.log_evidence for trial in trials])
    each = [log, log + np.concatenate([trial.any_size for trial in trials])]
    most = np.max([np.exp(one - np.logaddexp.reduce(one)) for one in each], axis=0)
    return most / most.sum()


def _tried(one: Hypothesis, begin: Trial) -> Trial:
    """A hypothesis fitted from where another ended."""
    fit = again(
        one.fitted(), begin.fit, begin.hypothesis.fitted(), one.motion, one.clock, STEPS, CLOSE
    )
    return weighed(one, fit)


def _quieter(begin: Trial, rungs: list[float]) -> Iterator[Trial]:
    """A trial, and it under ever less of other torques, as long as that is no worse."""
    yield begin
    for noise in rungs:
        one = begin.hypothesis
        trial = _tried(replace(one, motion=replace(one.motion, noise=noise)), begin)
        yield trial
        if trial.best < begin.best - WORSE:
            return
        begin = trial


def _torques(start: Trial, rungs: list[float]) -> Iterator[Trial]:
    """One that hardly turns the body over the pass is no other hypothesis."""
    stated = start.hypothesis
    tried = sizes(float(np.ptp(stated.o.t_s)))
    for frame in ("B", "N"):
        term = SteadyTorque(tried[-1], frame, stated.motion.body.inertia)
        quieter = _quieter(_tried(stated.beside("", term), start), rungs)
        trials = [(trial, *_over_sizes(trial, _place(trial), tried)) for trial in quieter]
        trial, gains, evidence = max(trials, key=lambda one: float(one[2].max()))
        k = int(np.argmax(evidence))
        size = int(np.argmax(gains[:, k]))
        if size and evidence[k] > start.best - HOPELESS:
            sized = term.sized(float(tried[size] / tried[-1]))
            trial = _tried(
                trial.hypothesis.swapped(trial.hypothesis.o.terms[-1], sized),
                _in_sigmas_of(sized, term, trial),
            )
            pulled = np.linalg.norm(trial.fit.error[k, _place(trial)]) * sized.sigma
            what = f"a steady torque of {pulled:.1g} rad/s2 in {WORDS[frame]}"
            evidence = evidence - np.log(1 + len(rungs))
            yield trial._replace(
                hypothesis=replace(trial.hypothesis, what=what), log_evidence=evidence
            )


def _in_sigmas_of(sized: SteadyTorque, term: SteadyTorque, trial: Trial) -> Trial:
    """A trial whose torque was fitted in sigmas of one term, in those of another: the same torque."""
    error = trial.fit.error.copy()
    error[:, _place(trial)] *= term.sigma / sized.sigma
    return trial._replace(fit=trial.fit._replace(error=error))


def _place(trial: Trial) -> slice:
    """Where the unknowns of a steady torque stand."""
    one = trial.hypothesis
    return next(
        place
        for term, place in places_of(one.fitted(), one.motion, one.clock).motion
        if isinstance(term, SteadyTorque)
    )


def _over_sizes(trial: Trial, place: slice, tried: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of unknowns fitted under the widest of the prior sigmas `tried` (m): gains of each (m, K), and the evidence over all (K)."""
    gains = _sized(
        trial.fit.error[:, place], trial.fit.covariance[:, place, place], tried / tried[-1]
    )
    return gains, trial.log_evidence + np.logaddexp.reduce(gains, axis=0) - np.log(len(tried))


def _sized(error: np.ndarray, covariance: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Gain in log evidence (m, K) if the prior sigma of some unknowns, fitted to (K, u) with covariance (K, u, u) under a sigma of
    one, were `shares` (m) of that: exact where the readings answer to them linearly."""
    eye = np.eye(error.shape[1])
    inverse = np.linalg.inv(covariance)
    slope = (inverse @ error[..., None])[..., 0]
    before = np.einsum("ki,kij,kj->k", error, inverse, error)
    found = []
    for share in shares:
        matrix = inverse + (1 / share**2 - 1) * eye
        after = np.einsum("ki,ki->k", slope, np.linalg.solve(matrix, slope[..., None])[..., 0])
        size = (
            np.linalg.slogdet(inverse)[1]
            - np.linalg.slogdet(matrix)[1]
            - 2 * len(eye) * np.log(share)
        )
        found.append((after - before + size) / 2)
    return np.array(found)


def _steps(start: Trial, rungs: list[float], clock_time: Callable[[float], str]) -> Iterator[Trial]:
    """Where neighbours fit the motion worst, one after another, as long as the evidence grows above that without any."""
    t_s = start.hypothesis.o.t_s[start.hypothesis.kept]
    middle = (t_s[1:] + t_s[:-1]) / 2
    trials, at, wanted = [start], [], start.best - HOPELESS
    for _ in range(min(MOST_STEPS, len(middle) - 1)):
        best = max(trials, key=lambda trial: trial.best)
        off = _defects(best)[1]
        off[at] = 0.0
        k = int(np.argmax(off))
        lower = [noise for noise in rungs if noise < best.hypothesis.motion.noise]
        new = _step(best, k, lower, wanted, -np.log(len(middle)))
        top = max(trial.best for trial in new)
        if top < wanted:
            break
        trials, at, wanted = new, sorted([*at, k]), top
        if top < start.best:
            break
    if at:
        words = f"{'steps' if len(at) > 1 else 'a step'} of the rate at {', '.join(clock_time(middle[k]) for k in at)}"
        if wanted > start.best:
            trials = [*trials, *_elsewhere(max(trials, key=lambda trial: trial.best))]
        for trial in trials:
            evidence = trial.log_evidence - np.log(1 + len(rungs))
            yield trial._replace(
                hypothesis=replace(trial.hypothesis, what=words), log_evidence=evidence
            )


def _elsewhere(best: Trial) -> Iterator[Trial]:
    """The same steps, each also in the intervals beside its own: near a sample, the data hardly tell before from after."""
    one = best.hypothesis
    for term in one.o.terms:
        if isinstance(term, RateStep):
            k = int(np.flatnonzero(term.before[one.kept])[0])
            for other in range(max(0, k - 1), min(k + 2, len(one.kept) - 1)):
                if other != k:
                    yield _tried(one.swapped(term, term.at(one.kept[other])), best)


def _step(best: Trial, k: int, rungs: list[float], wanted: float, odds: float) -> list[Trial]:
    """One more step, after the kept sample `k`, under ever less of other torques: as large as one of any size comes out."""
    one = best.hypothesis
    widest = one.motion.rate_prior
    jump = RateStep(widest, np.zeros(len(one.o), dtype=bool)).at(one.kept[k])
    wide = _tried(one.beside(one.what, jump, odds - STEP_SIZES), best)
    size = float(
        np.clip(np.linalg.norm(_defects(wide)[0][k, 3:]) / np.sqrt(3), 1e-3 * widest, widest)
    )
    if wide.best + 3 * np.log(widest / size) < wanted:  # no more can be gained
        return [wide]
    first = _tried(wide.hypothesis.swapped(jump, replace(jump, sigma=size)), wide)
    return list(_quieter(first, rungs))


def _defects(trial: Trial) -> tuple[np.ndarray, np.ndarray]:
    """Of a trial's best mode: by how much turn and rate miss the motion between neighbours (n - 1, 6), and in sigmas, squared
    (n - 1)."""
    one, o = trial.hypothesis, trial.hypothesis.fitted()
    track = trial.fit.track.take(np.array([np.argmax(trial.log_evidence)]))
    over = Intervals.of(o, track, one.motion)
    value = over.defect(track.omega, *over.step(one.motion.body, track.omega, step))[0]
    return np.linalg.solve(over.white, value[..., None])[..., 0], (value**2).sum(axis=1)


def _stronger(start: Trial) -> Iterator[Trial]:
    one, begin = start.hypothesis, start
    for factor in STRONGER:
        motion = replace(one.motion, noise=factor * one.motion.noise)
        begin = _tried(replace(one, what=TORQUES_STRONGER, motion=motion), begin)
        yield begin
        if begin.best < start.best - HOPELESS:
            return


def _steady_spin(start: Trial) -> Iterator[Trial]:
    """Torques along the axis about which the best mode spins are steady, as large as the white ones over the pass, of which less is
    left."""
    stated, begin = start.hypothesis, start
    mean = start.fit.track.omega[np.argmax(start.log_evidence)].mean(axis=0)
    speed, duration_s = np.linalg.norm(mean), np.ptp(stated.o.t_s)
    sigma = stated.motion.noise / np.sqrt(duration_s)
    steady = stated.beside(stated.what, SteadyTorque(sigma, "B", stated.motion.body.inertia))
    for factor in CALMER if speed * duration_s > SPIN_RAD else ():
        shares = np.eye(3) - (1 - factor**2) * np.outer(mean, mean) / speed**2
        begin = _tried(replace(steady, motion=replace(steady.motion, shares=shares)), begin)
        yield begin
        if begin.best < start.best - WORSE:
            return


def _coarser(start: Trial) -> Iterator[Trial]:
    """Each sensor so much worse as its residuals want it to be."""
    stated = start.hypothesis
    for term in stated.o.terms:
        if not isinstance(term, SunTerm | StateTerm) or not term.present()[stated.kept].any():
            continue
        factor = _wanted(start, term)
        if factor == 1.0:
            continue
        numbers = int(term.freedom()[stated.kept].sum())
        one = stated.swapped(term, term.coarser(factor))
        one = replace(
            one,
            what=f"readings of the {term.called} {factor:g} times worse than stated",
            debt=stated.debt - np.log(len(COARSER)) - numbers * np.log(factor),
        )
        yield _tried(one, start)


def _wanted(start: Trial, term: SunTerm | StateTerm) -> float:
    """How much worse than stated the residuals of the best mode want a sensor to be."""
    one, fit = start.hypothesis, start.fit.take(np.array([0]))
    o = one.fitted()
    places = places_of(o, one.motion, one.clock)
    kept, place = next(
        (mine, place) for mine, place in (*places.state, *places.sun) if mine.called == term.called
    )
    seen = fit.seen if isinstance(term, SunTerm) else fit.track
    numbers = kept.freedom().sum()
    costs = [
        normal(kept.coarser(f), seen, fit.error[:, place])[2].sum() + numbers * np.log(f)
        for f in (1.0, *COARSER)
    ]
    return (1.0, *COARSER)[int(np.argmin(costs))]


def _off_zero(start: Trial) -> Iterator[Trial]:
    """A gyro that reads a rate at rest though the file takes its zero for known; one hardly off is no other hypothesis."""
    one = start.hypothesis
    for term in one.o.of_state:
        off = term.off_zero(float(ZEROS[-1]))
        if off is None:
            continue
        trial = _tried(one.swapped(term, off), start)
        places = places_of(trial.hypothesis.fitted(), one.motion, one.clock).state
        first = next(place.start for mine, place in places if mine.called == term.called)
        place = slice(first, first + 3)
        gains, evidence = _over_sizes(trial, place, ZEROS)
        k = int(np.argmax(evidence))
        if np.argmax(gains[:, k]):
            x, y, z = np.degrees(ZEROS[-1] * trial.fit.error[k, place]).round(2) + 0.0
            what = f"a zero of the {term.called} of ({x:.2f}, {y:.2f}, {z:.2f}) deg/s in body axes besides that of the file: "
            what += "state its zero with a sigma"
            yield trial._replace(
                hypothesis=replace(trial.hypothesis, what=what), log_evidence=evidence
            )


def _without_readings(stated: Trial, clock_time: Callable[[float], str]) -> Iterator[Trial]:
    """Of a short pass: without each reading, and without each other beside the one that is missed least."""
    if len(stated.hypothesis.kept) > FEW:
        return
    begin = stated.take(np.argsort(-stated.log_evidence, kind="stable")[:MORE_MODES])
    for _ in range(MOST_BAD):
        found = [_tried(one, begin) for one in _one_fewer(begin.hypothesis, clock_time)]
        yield from found
        begin = max(found, key=lambda trial: trial.best, default=begin)
        if not found or begin.best < stated.best - HOPELESS:
            return


def _one_fewer(one: Hypothesis, clock_time: Callable[[float], str]) -> Iterator[Hypothesis]:
    """Without each reading of a sensor that has more: as if it had seen anything."""
    t_s = one.o.t_s[one.kept]
    for term in one.o.terms:
        if isinstance(term, MotionTerm):
            continue
        whole = term.take(one.kept).freed(t_s)
        for k in np.flatnonzero(term.present()[one.kept]):
            left = term.blind(int(one.kept[k])).take(one.kept).freed(t_s)
            if not (left.pairs() if isinstance(left, PairTerm) else left.present()).any():
                continue
            what = (
                "without the reading" if one.what == AS_STATED else f"{one.what} and without that"
            )
            debt = one.debt + BAD + whole.unrelated(t_s) - left.unrelated(t_s)
            swapped = one.swapped(term, term.blind(int(one.kept[k])))
            yield replace(
                swapped, what=f"{what} of the {term.called} at {clock_time(t_s[k])}", debt=debt
            )


def _swinging(stated: Trial) -> Iterator[Trial]:
    """From all modes, however improbable without it, and from the least turns that take the Sun where the best sees it."""
    one, order = stated.hypothesis, np.argsort(-stated.log_evidence, kind="stable")
    begin = stated.take(order[:MORE_MODES])
    t_s = one.o.t_s[one.kept]
    usual = float(np.median(np.diff(t_s)))
    if np.any(np.linalg.norm(begin.fit.track.omega[0, :-1], axis=1) * np.diff(t_s) > ALIASED):
        begin = _joined(begin, _slowest(begin.fit.track.take(slice(1)), t_s))
    for angle in SWINGS:
        last = begin.best
        begin = _tried(
            one.beside(SWINGS_QUICKLY, Swinging(angle / np.sqrt(usual)), OTHER_MODES), begin
        )
        begin = begin.take(distinct_index(begin.fit.track, t_s))
        yield begin
        if begin.best < min(last, stated.best - HOPELESS):
            return


def _wandering(stated: Trial) -> Iterator[Trial]:
    """A swinging about a rate near zero, all its ways counted: where nothing but the Sun is seen, and the model as stated
    fits. Where it does not, that is said already, and wrong wiring would pass for a swinging."""
    one, o = stated.hypothesis, stated.hypothesis.fitted()
    if not o.of_sun or any(term.present().any() for term in (*o.of_state, *o.of_pairs)):
        return
    wander = np.array(WANDERS) / np.sqrt(float(np.median(np.diff(o.t_s))))
    begin = stated.take(np.array([np.argmax(stated.log_evidence)]))
    if begin.fit.track.cost[0] > cost_limit(o):
        return
    # the sum takes the place of the attitudes' Gaussian, that of the rate stays; the turn about the Sun has no prior there
    wanted = (
        stated.best
        - HOPELESS
        - np.log(2 * TURN_PRIOR)
        - 3 * np.log(one.motion.rate_prior)
        - one.debt
    )
    if about_most(o, begin.fit.seen, wander).max() + ROUGHLY * len(o) < wanted:
        return
    still = _slowest(begin.fit.track, o.t_s)
    begin = begin._replace(
        fit=begin.fit._replace(track=Track(still.attitude, np.zeros_like(still.omega)))
    )
    for noise, log in zip(wander, log_evidence(o, wander), strict=True):
        if log > wanted:
            trial = _tried(one.beside(SWINGS_QUICKLY, Swinging(float(noise))), begin)
            rate = np.linalg.slogdet(trial.fit.track.covariance[:, 0, 3:, 3:])[1] / 2
            yield trial._replace(log_evidence=log + one.debt + rate + np.log(2 * TURN_PRIOR))


def _joined(start: Trial, more: Track) -> Trial:
    """Modes to begin with, and one more with the errors in common of the first."""
    first = start.fit.track
    both = Track(
        np.concatenate([first.attitude, more.attitude]), np.concatenate([first.omega, more.omega])
    )
    return start._replace(
        fit=start.fit._replace(
            track=both, error=np.concatenate([start.fit.error, start.fit.error[:1]])
        )
    )


def _slowest(track: Track, t_s: np.ndarray) -> Track:
    """Motions that see the Sun as these do, and turn least."""
    attitude, omega = track.attitude.copy(), np.zeros_like(track.omega)
    sun = track.sun_B
    for i, dt in enumerate(np.diff(t_s)):
        x, y = (
            rotate_by_smallest(sun[:, i], sun[:, i + 1], attitude[:, i, :, axis]) for axis in (0, 1)
        )
        attitude[:, i + 1] = np.stack([x, y, np.cross(x, y)], axis=-1)
        omega[:, i] = rotation_between(attitude[:, i], attitude[:, i + 1]) / dt
    omega[:, 1:-1] = (omega[:, :-2] + omega[:, 1:-1]) / 2
    omega[:, -1] = omega[:, -2]
    return Track(attitude, omega)


class Counted(NamedTuple):
    """One motion of a pass with all hypotheses that lead to it: `members`, the trial and its mode, heaviest first, and their
    weights, which add to that of the motion."""

    members: list[tuple[int, int]]
    weights: np.ndarray


def _outline(trial: Trial) -> Outline:
    one = trial.hypothesis
    return Outline.of(trial.fit.seen, one.o.t_s[one.kept], trial.fit.track.covariance)


def counted(trials: list[Trial]) -> list[Counted]:
    """The motions that the trials leave, heaviest first, with weights that add to one."""
    weights = pooled(trials)
    order = np.argsort(-weights, kind="stable")
    order = order[weights[order] > COUNTED * weights.max()]
    every = [(i, k) for i, trial in enumerate(trials) for k in range(len(trial.log_evidence))]
    every, weights = [every[m] for m in order], weights[order]
    found: list[tuple[Outline, list[int]]] = []
    outlines = {i: _outline(trials[i]) for i in {i for i, _ in every}}
    for m, (i, k) in enumerate(every):
        one = trials[i].hypothesis
        for head, members in found:
            others = all(every[n][0] != i for n in members) or any(
                term.several() for term in one.o.terms
            )
            if outlines[i].same(k, head, models_differ=others)[0]:
                members.append(m)
                break
        else:
            found.append((outlines[i].take(np.array([k])), [m]))
    groups = [
        Counted([every[m] for m in members], weights[members] / weights.sum())
        for _, members in found
    ]
    return sorted(groups, key=lambda one: -one.weights.sum())
