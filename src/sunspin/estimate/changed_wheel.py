"""A wheel that changes its speed within a pass, braked or driven by a command that the vehicle file does not state.

The body takes up the momentum that the wheel loses, which looks like a step of the rate along the wheel's axis. The momentum that
is left in the wheel then turns the rate of the body at another frequency. With the momentum of the file, 6 of 16 decided
passes with a braked wheel were right until the wheel was braked, and 19 to 50 sigma off at some sample after it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sunspin.estimate.alternatives import changes_of_rate
from sunspin.estimate.evidence import PassFits, best_fit, best_motions
from sunspin.estimate.model import Model, Track
from sunspin.estimate.observe import Pass, longest_passes
from sunspin.estimate.one_pass import PassFitter
from sunspin.estimate.terms.torques import Ramp, WheelChange
from sunspin.vehicle import Vehicle

SURELY = 20.0
"""Growth of the log evidence by a change of a wheel after which no other change is tried."""

MOST_WHEELS = 2
"""At each step so many wheels are tried, those whose axes are nearest to it."""

TIME_SIGMA = 2.0
"""Sigma of the times at which a change begins and ends, in usual intervals between samples."""

MOST_ROUNDS, GROWS, BEGIN_FROM = 5, 0.3, 3
"""A change is fitted and then assumed as fitted, at most so often, as long as the log evidence grows by so much. Each such fit
begins from so many motions of the one before."""


@dataclass(frozen=True)
class Change:
    """A change of the momentum of a wheel, by its number, along its axis: `ramp`, in mean moments times rad/s."""

    wheel: int
    ramp: Ramp

    def assumed_in(self, nominal: Model, vehicle: Vehicle, price: float) -> Model:
        """Return the nominal model of a file with the change, whose errors are unknown; it costs `price` in log evidence."""
        obs = nominal.obs
        axis = np.asarray(vehicle.wheels[self.wheel].axis_B)
        momentum = obs.momentum + np.outer(self.ramp.change(obs.t_s), axis)
        time_sigma_s = TIME_SIGMA * float(np.median(np.diff(obs.t_s)))
        term = WheelChange(obs.t_s, axis, self.ramp, time_sigma_s, nominal.body.inertia, momentum)
        changed = replace(obs, momentum=momentum, terms=(*obs.terms, term))
        return replace(nominal, obs=changed, log_prior=nominal.log_prior - price)

    def fitted(self, fits: PassFits) -> Change:
        """Return the change in the most probable motion of a pass that was fitted with it."""
        best = best_fit(fits.fits)
        (changed,) = (
            term.with_errors(best.motions.u[0, u_slice])
            for term, u_slice in best.model.terms_with_slices
            if isinstance(term, WheelChange)
        )
        return replace(self, ramp=changed)

    def words(self, vehicle: Vehicle) -> str:
        """Return the change in words."""
        wheel = vehicle.wheels[self.wheel]
        assert vehicle.inertia_kg_m2 is not None
        speed = self.ramp.size * np.trace(vehicle.inertia_kg_m2) / 3 / wheel.inertia_kg_m2
        times = f"between {self.ramp.begin_s:.0f} and {self.ramp.end_s:.0f} s"
        return f"{wheel.name}: speed changed by about {speed:.3g} rad/s {times}"


class ChangedWheel(NamedTuple):
    """A change of a wheel's speed, the nominal model of the file with it, and the fits of each pass under that model."""

    change: Change
    nominal: Model
    fits: list[PassFits]


def changed_wheel(
    vehicle: Vehicle,
    nominal: Model,
    passes: Sequence[Pass],
    fits: Sequence[PassFits],
    fitter: PassFitter,
) -> ChangedWheel | None:
    """Return the change of a wheel's speed by which the evidence of a long pass grows most; None if it grows by none.

    `nominal`: of the file, without a change; `fits`: of each pass under it. In later passes the wheel has kept the new speed, or
    that of the file again; their evidence decides.
    """
    for k in longest_passes(passes):
        found = change_in_pass(vehicle, nominal, passes[k], fits[k], fitter)
        if found is None:
            continue
        change, in_pass = found
        begin: list[Track | None] = [None] * len(passes)
        begin[k] = best_motions(in_pass.fits, BEGIN_FROM, fitter.settings.search)
        end_s = float(nominal.obs.t_s[passes[k].samples].max())
        returns = replace(change, ramp=replace(change.ramp, until_s=end_s))
        results = []
        for way in [change, returns] if end_s < nominal.obs.t_s[-1] else [change]:
            model = way.assumed_in(nominal, vehicle, _price(fits[k], fitter))
            of_passes = [each.model_of_kept(model) for each in passes]
            new_fits = [each for each in fitter.fits_if_any(of_passes, begin) if each is not None]
            if len(new_fits) == len(passes):
                results.append(ChangedWheel(way, model, new_fits))
        if results:
            return max(results, key=lambda result: sum(each.log_evidence for each in result.fits))
    return None


def change_in_pass(
    vehicle: Vehicle, nominal: Model, of_pass: Pass, fits: PassFits, fitter: PassFitter
) -> tuple[Change, PassFits] | None:
    """Return the change by which the evidence of one pass grows most, with its fits; None if it grows by none."""
    evidence, found = fits.log_evidence, None
    for first in sudden_changes(vehicle, fits, fitter.settings.ladder.strong):
        for change, with_change in refined(first, vehicle, nominal, of_pass, fits, fitter):
            if with_change.log_evidence > evidence:
                evidence, found = with_change.log_evidence, (change, with_change)
        # others need not be tried if this one leaves no step
        sure = found is not None and evidence > fits.log_evidence + SURELY
        if sure and not best_fit(found[1].fits).model.noise.steps:
            break
    return found


def sudden_changes(vehicle: Vehicle, fits: PassFits, strong: float) -> Iterator[Change]:
    """Yield the changes of wheels that may have caused steps of the rate in the most probable motion of a pass.

    Without steps, but under torques of the strength `strong` (rad/s^1.5) or more, these are the two intervals in which the motion
    violates the equations of motion most. Of many wheels the two are tried whose axes are nearest to the step.
    """
    best = best_fit(fits.fits)
    t_s, inertia = best.model.obs.t_s, best.model.body.inertia
    violations = changes_of_rate(best.model, best.motions)
    intervals = [interval for interval, _ in best.model.noise.steps]
    if not intervals and best.model.noise.acceleration >= strong:
        intervals = np.argsort(-np.linalg.norm(violations, axis=1))[:2].tolist()
    for interval in intervals:
        gained = inertia @ violations[interval]
        # it may begin an interval before that of the step, and end one after it
        begin_s, end_s = t_s[max(interval - 1, 0)], t_s[min(interval + 2, len(t_s) - 1)]
        along = np.array([wheel.axis_B for wheel in vehicle.wheels]) @ gained
        for number in np.argsort(-np.abs(along))[:MOST_WHEELS].tolist():
            yield Change(number, Ramp(float(begin_s), float(end_s), -float(along[number])))


def refined(
    change: Change,
    vehicle: Vehicle,
    nominal: Model,
    of_pass: Pass,
    fits: PassFits,
    fitter: PassFitter,
) -> Iterator[tuple[Change, PassFits]]:
    """Yield a change, then again with size and times as fitted, each with the fits of the pass, as long as the evidence grows.

    The fits of the first begin by a search, those of the others from the motions before. `fits`: those without a change.
    """
    begin, before = None, fits.log_evidence
    for _ in range(MOST_ROUNDS):
        model = change.assumed_in(nominal, vehicle, _price(fits, fitter))
        (with_change,) = fitter.fits_if_any([of_pass.model_of_kept(model)], [begin])
        if with_change is None or with_change.log_evidence < before + GROWS:
            return
        yield change, with_change
        begin = best_motions(with_change.fits, BEGIN_FROM, fitter.settings.search)
        before = with_change.log_evidence
        change = change.fitted(with_change)


def _price(fits: PassFits, fitter: PassFitter) -> float:
    """Return what the unknown time of a change costs in log evidence: as much as that of a step of the rate."""
    return np.log(len(fits.nominal.obs) - 1) + fitter.settings.alternatives.step_sizes
