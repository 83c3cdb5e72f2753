"""What the wheels do if the file does not state it, and whether they turn in the direction that it states.

Wheels without measured speeds are held at their nominal speed, or coast from it: the evidence of the longest passes decides.

Signs of a wheel's axis and speed are conventions, so the other sign is tried. A wheel turns the vector of the rate in the body.
Half a revolution forward and half a revolution back between two samples end alike, so a wheel of the wrong sign may fit as well,
with another motion. A reversed wheel is named if it clearly fits better than the wheel in the file, which else is believed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from sunspin.estimate.carry import nutation, require_followed
from sunspin.estimate.equivalence import CLEARLY, WEAK_RAD, wheel_changes
from sunspin.estimate.evidence import PassFits, best_motions
from sunspin.estimate.model import Model, Observations, Track
from sunspin.estimate.observe import Pass, longest_passes, wheel_models, wheel_speeds
from sunspin.estimate.one_pass import PassFitter, one_pass
from sunspin.estimate.quick import MOTIONS, quick_evidence
from sunspin.estimate.solutions import solutions
from sunspin.estimate.verdict import misfit
from sunspin.telemetry.assess import Assessment
from sunspin.vehicle import Vehicle

EVIDENCE = " (evidence "
"""What separates the name of a wheel model from its evidence, in words."""

QUICK_LOSS = 20.0
"""Reversed wheels are not fitted if a quick search, which holds the inertia, finds their log evidence worse by this."""

WRAPPED_RAD = 10.0
"""Wheels that turn the rate by more than this between samples are not reversed: at 42 rad one of five right files was doubted."""

LOSS = 1.0
"""Log evidence by which reversed wheels may be worse in the passes so far and are still tried on the next."""


@dataclass(frozen=True)
class DecidedWheels:
    """What the wheels do: the `name` of the model, and `words` with its evidence too.

    `momentum` (n, 3) of all wheels at all samples of the file, in mean moments times rad/s. `fits`: of the passes that were
    compared for it, by their index among all passes.
    """

    name: str
    words: str
    momentum: np.ndarray
    fits: dict[int, PassFits]


@dataclass(frozen=True)
class Reversed:
    """`wheels`, by their numbers, that may turn the other way, and the `gain` in log evidence if they do.

    Of the longest pass with them reversed: whether it `fits`, times `t_s` (n), rates `omega` (n, 3), Sun directions `sun_B` (n, 3).
    """

    wheels: tuple[int, ...]
    gain: float
    fits: bool
    t_s: np.ndarray
    omega: np.ndarray
    sun_B: np.ndarray


def decide_wheels(
    assessment: Assessment, nominal: Model, passes: Sequence[Pass], fitter: PassFitter
) -> DecidedWheels:
    """Return what the wheels do: of the models of :func:`wheel_models` that under which the longest passes have most evidence.

    `nominal`: the nominal model of the whole file, with any momentum of the wheels. InputError if wheels turn the rate too far
    between two samples, or if no model allows a motion.
    """
    momenta = wheel_models(assessment.vehicle, assessment.telemetry)  # by name
    for a_pass in passes:
        longest_s = float(np.diff(nominal.obs.t_s[a_pass.kept]).max())
        for momentum in momenta.values():
            require_followed(nominal.body.inertia, momentum[a_pass.kept], longest_s)
    first, *others = momenta
    if not others:
        return DecidedWheels(first, first, momenta[first], {})

    # by name of the wheel model and index of a compared pass: the model of the pass
    compared = longest_passes(passes)
    models = {
        (name, k): passes[k].model_of_kept(nominal.with_momentum(momentum))
        for name, momentum in momenta.items()
        for k in compared
    }

    # Wheel models that turn the body nearly as the first one does have nearly its motions: their fits begin from these, without a
    # search. All other models are searched, side by side.
    s = fitter.settings.search
    alike = [
        name
        for name in others
        if all(_turn_alike(models[first, k], models[name, k], s.basin_rad) for k in compared)
    ]
    jobs = [(name, k) for name in momenta if name not in alike for k in compared]
    fits = dict(zip(jobs, fitter.fits_if_any([models[job] for job in jobs]), strict=True))
    # for each pass the motions under the first model, from which fits begin; None, for a search, if it allows none
    begin: dict[int, Track | None] = dict.fromkeys(compared)
    for k in compared:
        of_first = fits[first, k]
        if of_first is not None:
            best = best_motions(of_first.fits, s.most, s)
            begin[k] = Track.unfitted(best.attitude, best.omega) if len(best) else None
    jobs = [(name, k) for name in alike for k in compared]
    fitted = fitter.fits_if_any([models[job] for job in jobs], [begin[k] for _, k in jobs])
    fits |= dict(zip(jobs, fitted, strict=True))

    evidence = {
        job: -np.inf if pass_fits is None else pass_fits.log_evidence
        for job, pass_fits in fits.items()
    }
    if not np.isfinite(list(evidence.values())).any():
        # no model allows a motion in any pass: this estimate fails again, and raises the error that says why
        one_pass(models[first, compared[0]], fitter.settings, fitter.budget)
    total = {name: sum(evidence[name, k] for k in compared) for name in momenta}
    best, second = sorted(total, key=lambda name: total[name], reverse=True)[:2]
    words = f"{best}{EVIDENCE}{total[best] - total[second]:.1f} above any other)"
    done = {k: of_pass for k in compared if (of_pass := fits[best, k]) is not None}
    return DecidedWheels(best, words, momenta[best], done)


def name_of_wheels(words: str) -> str:
    """Return the name of a wheel model from words that also give its evidence (`DecidedWheels.words`)."""
    return words.split(EVIDENCE)[0]


def _turn_alike(first: Model, second: Model, basin_rad: float) -> bool:
    """Return whether the wheels of two models turn the rate of the body alike in a pass, to `basin_rad`.

    A fit under the second model then finds its motion from that of the first. The difference of the momenta turns the rate at the
    angular frequency of :func:`nutation`, whose integral is the angle that is compared. A fit keeps the motions together at the
    middle sample, so the angle counts from there to either end.
    """
    t_s = first.obs.t_s
    frequency = nutation(first.body.inertia, second.obs.momentum - first.obs.momentum)
    middle = len(t_s) // 2
    halves = slice(middle + 1), slice(middle, None)
    return max(float(np.trapezoid(frequency[half], t_s[half])) for half in halves) < basin_rad


def momentum_of_each(vehicle: Vehicle, telemetry: xr.Dataset, name: str) -> np.ndarray:
    """Return the momentum (n_wheel, n, 3) of each wheel in body axes; (0, n, 3) without an inertia.

    It is divided by the mean moment of inertia of the body: rad/s. `name`: of the model of the wheels, a key of
    :func:`wheel_models`, which gives the sum over all wheels.
    """
    t_s = np.asarray(telemetry["time"], dtype=np.float64)
    speed = wheel_speeds(vehicle, telemetry, t_s).get(name)
    if vehicle.inertia_kg_m2 is None or speed is None:
        return np.zeros((0, len(t_s), 3))
    axes = [wheel.inertia_kg_m2 * np.asarray(wheel.axis_B) for wheel in vehicle.wheels]
    mean_moment = float(np.trace(vehicle.inertia_kg_m2)) / 3
    return speed.T[..., None] * np.reshape(axes, (-1, 1, 3)) / mean_moment


def reversed_momenta(
    vehicle: Vehicle, of_wheels: np.ndarray, inertia: np.ndarray, t_s: np.ndarray
) -> dict[tuple[int, ...], np.ndarray]:
    """Return indices of reversed wheels -> total momentum (n, 3) of all wheels: with each wheel reversed, and with all.

    Wheels are left out if they hardly turn the rate of the body in the whole file, or turn it by more than :data:`WRAPPED_RAD`
    between two samples. `of_wheels` (n_wheel, n, 3), rad/s: momenta with the signs of the file, body axes, and `inertia` (3, 3):
    both over the mean moment of inertia.
    """
    momenta: dict[tuple[int, ...], np.ndarray] = {}
    if not of_wheels.any():
        return momenta
    usual_s, span_s = float(np.median(np.diff(t_s))), float(np.ptp(t_s))
    for change in wheel_changes(vehicle):
        of_reversed = of_wheels[list(change.reversed_wheels)].sum(axis=0)
        frequency = float(nutation(inertia, of_reversed).max(initial=0.0))  # rad/s
        if frequency * span_s > WEAK_RAD and frequency * usual_s < WRAPPED_RAD:
            momenta[change.reversed_wheels] = of_wheels.sum(axis=0) - 2 * of_reversed
    return momenta


def search_reversed(
    assessment: Assessment,
    name: str,
    nominal: Model,
    longest_pass: Pass,
    fitter: PassFitter,
    change: np.ndarray | float = 0.0,
) -> tuple[dict[tuple[int, ...], np.ndarray], Iterable[float]]:
    """Begin a quick search of the longest pass for each choice of reversed wheels; return their momenta and log evidence.

    The momenta are those of :func:`reversed_momenta`, at all n samples of the file, plus the `change` (n, 3) by a wheel whose speed
    changes in a pass. The log evidence (:func:`sunspin.estimate.quick.quick_evidence`) is in the same order. With a pool of
    processes all searches begin now; without one each is made when its evidence is read. `name`: model of the wheels (a key of
    :func:`wheel_models`) that gives their speeds; `nominal`: nominal model of the whole file.
    """
    vehicle = assessment.vehicle
    of_wheels = momentum_of_each(vehicle, assessment.telemetry, name)
    momenta = reversed_momenta(vehicle, of_wheels, nominal.body.inertia, nominal.obs.t_s)
    momenta = {numbers: momentum + change for numbers, momentum in momenta.items()}
    models = [
        longest_pass.model_of_kept(nominal.with_momentum(momentum)) for momentum in momenta.values()
    ]
    return momenta, fitter.quick_evidence(models)


def doubted_signs(
    obs: Observations,
    compared: Sequence[tuple[Pass, PassFits]],
    momenta: Mapping[tuple[int, ...], np.ndarray],
    quick_evidences: Iterable[float],
    fitter: PassFitter,
) -> Reversed | None:
    """Return the wheels whose sign in the file the data contradict; None if there are none.

    The sign is doubted if reversed wheels raise the log evidence of all compared passes together by :data:`CLEARLY`. Most wheels
    are excluded before that: by a quick search, or as soon as the evidence of the passes so far falls. Of several the one with the
    largest gain is returned. Its motion may agree with that of the file within the errors, which are large under the strong torques
    that a wrong file needs; it is returned all the same, since exchanged columns that fit like the reversed wheel have another one.

    `obs`: all samples of the file. `compared`: the longest passes with their fits for the file as it is. `momenta`,
    `quick_evidences`: of :func:`search_reversed` for the first of them.
    """
    if not momenta:
        return None
    settings, (longest_pass, of_longest) = fitter.settings, compared[0]
    # the motions of the file as it is are known: its quick evidence begins from them, without a search
    known = best_motions(of_longest.fits, MOTIONS, settings.search)
    quick_of_file = quick_evidence(of_longest.nominal, settings, replace(fitter.budget), known)
    doubted: list[Reversed] = []
    for (numbers, momentum), quick in zip(momenta.items(), quick_evidences, strict=True):
        if quick < quick_of_file - QUICK_LOSS:
            continue
        gain, fits_reversed = 0.0, []
        for a_pass, fits_of_file in compared:
            model = fits_of_file.nominal.with_momentum(momentum[a_pass.kept])
            (pass_fits,) = fitter.fits_if_any([model])
            if pass_fits is None:
                break
            gain += pass_fits.log_evidence - fits_of_file.log_evidence
            if gain < -LOSS:
                break
            fits_reversed.append(pass_fits)
        if len(fits_reversed) < len(compared) or gain < CLEARLY:
            continue
        # the most probable solution of the longest pass, at all its samples
        whole = replace(obs, momentum=momentum).of_pass(longest_pass.samples)
        kept = longest_pass.kept_in_pass
        solved = solutions(fits_reversed[0], whole, kept, settings.solutions, settings.search)
        sensors_fit = all(misfit(residual[0]).fits for residual in solved.residual.values())
        fits_well = bool(sensors_fit and solved.track.cost[0] <= solved.cost_limit)
        omega, sun_B = solved.track.omega[0], solved.track.sun_B[0]
        doubted.append(Reversed(numbers, gain, fits_well, solved.obs.t_s, omega, sun_B))
    return max(doubted, key=lambda reversed_wheels: reversed_wheels.gain, default=None)
