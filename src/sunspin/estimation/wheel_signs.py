"""Whether wheels turn the way the file says: signs of a wheel's axis and speed are conventions, so the other sign is tried.

A wheel turns the rate of the body round. Half a turn forward and half a turn back between two samples end alike, so that a wheel
of the wrong sign may fit as well, with another motion. A reversed wheel is named if it clearly fits better than the wheel as the
file has it, and its motion is one that the file's errors exclude. If both signs fit alike the file is believed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from sunspin.estimation.budget import Budget
from sunspin.estimation.carry import RATE, nutation
from sunspin.estimation.equivalence import CLEARLY, WEAK_RAD, wheel_changes
from sunspin.estimation.evidence import PassFits, leading, likeliest
from sunspin.estimation.model import Model, Observations
from sunspin.estimation.observe import Pass, wheel_models
from sunspin.estimation.quick import MOTIONS, quick_evidence
from sunspin.estimation.settings import RatesSettings
from sunspin.estimation.solutions import solutions
from sunspin.estimation.verdict import misfit
from sunspin.vehicle import Vehicle

FAR = 20.0
"""Log evidence by which reversed wheels are out of the question if they are worse in a quick search, which holds the inertia."""

WRAPPED_RAD = 10.0
"""Nor are wheels tried that turn the rate round by more than this from sample to sample: at 42 rad one of five right files was
accused."""

AS_WELL = 1.0
"""Log evidence by which reversed wheels may be worse in one pass and are still tried on the next."""

OTHER_SIGMAS = 3.0
"""A motion is another one if its rates are so many sigmas from the file's at half of the samples."""

FitPasses = Callable[[Sequence[Model]], Sequence[PassFits | None]]
"""Function that fits passes, None for one that has no motion."""


@dataclass(frozen=True)
class Reversed:
    """Wheels, by their numbers, that may turn the other way, and the `gain` in log evidence if they do.

    And the longest pass as estimated so: whether it `fits`, its times (n) in s, rates (n, 3) in rad/s and directions of the Sun
    (n, 3).
    """

    wheels: tuple[int, ...]
    gain: float
    fits: bool
    t_s: np.ndarray
    omega: np.ndarray
    sun_B: np.ndarray


def momentum_of_each(vehicle: Vehicle, telemetry: xr.Dataset, name: str) -> np.ndarray:
    """Return the momentum (n_wheel, n, 3) of each wheel in mean moments of inertia times rad/s.

    `name`: what the wheels do, a key of :func:`wheel_models`. That gives the sum over all wheels: the sum with one wheel reversed
    is less by twice the momentum of this wheel.
    """
    total = wheel_models(vehicle, telemetry).get(name)
    if vehicle.inertia_kg_m2 is None or total is None:
        return np.zeros((0, telemetry.sizes["time"], 3))
    each = np.zeros((len(vehicle.wheels), *total.shape))
    for k, wheel in enumerate(vehicle.wheels):
        wheels = list(vehicle.wheels)
        wheels[k] = replace(wheel, axis_B=-np.asarray(wheel.axis_B))
        with_reversed = wheel_models(replace(vehicle, wheels=tuple(wheels)), telemetry)[name]
        each[k] = (total - with_reversed) / 2
    return each


def reversed_momenta(
    vehicle: Vehicle, each: np.ndarray, inertia: np.ndarray, t_s: np.ndarray
) -> dict[tuple[int, ...], np.ndarray]:
    """Return the wheels' momenta (n, 3) with each wheel reversed, and with all, by the numbers of those that are reversed.

    Without wheels so slow that they hardly turn the rate round, or so fast that they wrap. `each` (n_wheel, n, 3): their momenta
    as the file has them; `inertia` (3, 3) in mean moments.
    """
    if not len(each) or not each.any():
        return {}
    momenta = {}
    for change in wheel_changes(vehicle):
        of_reversed = each[list(change.reversed_wheels)].sum(axis=0)
        rate = float(nutation(inertia, of_reversed).max(initial=0.0))
        wraps = rate * float(np.median(np.diff(t_s))) >= WRAPPED_RAD
        if rate * float(np.ptp(t_s)) > WEAK_RAD and not wraps:
            momenta[change.reversed_wheels] = each.sum(axis=0) - 2 * of_reversed
    return momenta


def doubted_signs(
    obs: Observations,
    momenta: dict[tuple[int, ...], np.ndarray],
    passes: Sequence[Pass],
    models: Sequence[Model],
    fits: Sequence[PassFits],
    fit_passes: FitPasses,
    settings: RatesSettings,
    budget: Budget,
) -> Reversed | None:
    """Return the wheels whose sign the data doubt; None if they do not, or cannot.

    Wheels are doubted if, reversed, they raise the log evidence of all compared passes together by :data:`CLEARLY`, and if one of
    the passes then has another motion. Most are refused sooner: by a quick search, or as soon as the passes are worse together.

    `obs`: all samples of the file; `momenta`: with wheels reversed, of all samples; `passes`: those that are compared, the longest
    first, with the `models` and `fits` of the file as it is written.
    """
    if not momenta:
        return None
    doubted: list[Reversed] = []
    known = leading(fits[0].fits, MOTIONS, settings.search)
    quick_as_written = quick_evidence(models[0], settings, replace(budget), known)
    for which, momentum in momenta.items():
        reversed_models = [
            replace(model, obs=replace(model.obs, momentum=momentum[one.kept]))
            for model, one in zip(models, passes, strict=True)
        ]
        quick = quick_evidence(reversed_models[0], settings, replace(budget))
        if quick < quick_as_written - FAR:
            continue
        gain, has_another_motion, new_fits = 0.0, False, []
        for model, as_written in zip(reversed_models, fits, strict=True):
            (fitted,) = fit_passes([model])
            if fitted is None:
                break
            gain += log_evidence(fitted) - log_evidence(as_written)
            if gain < -AS_WELL:
                break
            has_another_motion |= _is_another(as_written, fitted)
            new_fits.append(fitted)
        if len(new_fits) < len(passes) or not has_another_motion or gain < CLEARLY:
            continue
        whole = replace(obs, momentum=momentum).of_pass(passes[0].samples)
        longest = solutions(
            new_fits[0], whole, passes[0].kept_in_pass, settings.solutions, settings.search
        )
        agree = all(misfit(part[0]).fits for part in longest.residual.values())
        fits_well = bool(agree and longest.track.cost[0] <= longest.cost_limit)
        track = longest.track
        best = longest.obs.t_s, track.omega[0], track.sun_B[0]
        doubted.append(Reversed(which, gain, fits_well, *best))
    return max(doubted, key=lambda one: one.gain, default=None)


def log_evidence(one: PassFits) -> float:
    """Return the log evidence of a pass, all rungs, models and motions summed."""
    return float(np.logaddexp.reduce(one.log_evidence_of_rungs() + one.log_rung))


def _is_another(first: PassFits, second: PassFits) -> bool:
    """Return whether the most probable motion of the second is none that the first allows."""
    best_fits = likeliest(first.fits), likeliest(second.fits)
    a, b = (one.motions.take(np.array([np.argmax(one.log_evidence)])) for one in best_fits)
    sigma = np.sqrt(np.einsum("nii->ni", a.covariance[0, :, RATE, RATE]))
    off = np.abs(b.omega[0] - a.omega[0]) / sigma
    return bool(np.median(off.max(axis=1)) > OTHER_SIGMAS)
