"""Tests of other columns, axes and signs on a pass for which the vehicle file may state wrong ones.

One list of changes is tried: two panels' columns exchanged, a panel or a wheel reversed, a second sensor's axes permuted or
reversed, a quaternion read the other way. A change is named only if the pass fits with it, and better by :data:`CLEARLY` in log
evidence. :mod:`sunspin.estimate.columns` says which passes are tested: those that do not fit, and some of a file of panels alone.

Changes look the same (:mod:`sunspin.estimate.equivalence`) if a rotation or mirror M of the body maps the readings under one onto
those under the other. No data distinguish them: they are named together, each with its rate, and none is recommended.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from string import ascii_lowercase
from typing import Any, NamedTuple

import numpy as np
import tomlkit
import xarray as xr

from sunspin.estimate.budget import Budget
from sunspin.estimate.equivalence import (
    AS_WRITTEN,
    CLEARLY,
    FULL_SUN_QUANTILE,
    READINGS,
    ColumnChange,
    Observed,
    column_changes,
    equivalence,
    equivalent_changes,
    full_sun_readings,
    rate_under,
    wheel_changes,
)
from sunspin.estimate.observe import middle_sample
from sunspin.estimate.settings import FIELD_TURN, GYRO_DRIFTS, GYRO_ZEROS
from sunspin.estimate.verdict import DECIDED, in_sigma, misfit
from sunspin.telemetry.assess import Assessment, assess
from sunspin.telemetry.signals import signals
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.planes import sphere
from sunspin.vehicle.sensors import VARIABLES, Attitude, Gyro

MOST_SQUARE = 30.0
"""Largest square, in sigmas, that counts of a reading of a second sensor, or of a sample of panels: some are spikes."""

SENSOR_NAMES = {"gyro_B": "gyro", "field_B": "magnetometer", "attitude_B_from_N": "quaternion"}
"""Variable of the telemetry -> what a person calls it."""

DIRECTIONS, READING_ERROR = 3000, 0.06
"""Number of Sun directions in which a sample is compared with the panels, 3.5 degrees apart, and the error of a reading there, as a
share of full Sun: half of that distance, and gains."""

MOST_BRIGHTNESS = 1.15
"""Brightness of a sample, in full Suns, that panels may show at most. There is no lower limit, since a full battery dims samples:
with one of 0.85 four right passes of skCUBE seemed to have a reversed panel, and of simulated exchanges no more were seen."""

MOST_COMPARED = 60
"""Largest number of samples that are compared with the panels each by itself; of more, every second, third or further one is."""

WORTH_A_SEARCH = 30.0
"""On a pass that does not fit, a change is searched with if the samples, each by itself, cost (minus log likelihood) at most this
more than under the best change. Of 60 files with two columns exchanged the right change was at most 0.8 from the best."""

AS_GOOD = 3.0
"""On a pass that fits, a change is searched with if the samples cost at most this more than under the file as it is written. Of 60
files with exchanged columns the right change cost at most 0.8 more than the wrong file."""

EXCHANGED = 0.01
"""Prior probability that the columns of a file are exchanged; supposed."""

AS_PROBABLE = float(np.log((1 - DECIDED) / DECIDED * (1 - EXCHANGED) / EXCHANGED))
"""Log evidence (2.4) by which a change of columns must be better than the file to have one in ten of the probability. Then a pass
with another rate is not decided."""

EXCLUDED = float(np.log(99.0))
"""Log evidence (4.6) by which a change must be worse than the file to be excluded at 1 in 100, if both are equally probable before
the data."""

CONTRADICTING_SIGMAS = 5.0
"""Two estimates of a rate contradict each other if a component differs by more than this many of its sigmas."""

MOST_RUNS = 3
"""Changes that are estimated in full, at most."""

MOST_NAMED = 6
"""Changes that are named, at most; of others the number is given."""


class ChangeWithRate(NamedTuple):
    """A change of the file that fits, and the body rate `omega` (3) in rad/s under it; None if that was not estimated."""

    change: ColumnChange
    omega: np.ndarray | None = None


@dataclass(frozen=True)
class BetterChanges:
    """Changes that fit better than the file as it is written, and that the telemetry cannot distinguish from each other.

    `gain`: log evidence by which they are better; `at_s`: time of their rates; `fits`: whether the pass fits with them, or only
    better than as written; `estimate`: result of `rates` with the first of them, None if none was made.
    """

    changes: tuple[ChangeWithRate, ...]
    gain: float
    at_s: float = np.nan
    fits: bool = True
    estimate: xr.Dataset | None = None

    @property
    def cost(self) -> float:
        """Return minus the log posterior of the best solution of `estimate`; NaN without one."""
        return np.nan if self.estimate is None else float(self.estimate["cost"].values[0, 0])

    def words(self, clock: Callable[[float], str] = lambda t: f"{t:.0f} s") -> str:
        """Return a sentence for the verdict, with a line for each of several changes.

        `clock`: function from a time of the telemetry (s) to its words.
        """
        better = f"the data fit {'' if self.fits else 'better '}with"
        gain = f"(log evidence better by {self.gain:.0f})"
        if len(self.changes) == 1:
            change = self.changes[0].change
            do = f"; if it is so, {change.do}" if change.do else ""
            signs = change.reversed_wheels and not change.columns
            check = "CHECK THE SIGNS" if signs else "CHECK THE COLUMNS"
            return f"{better} {change.what} {gain}: {check}{do}"
        shown = [
            f"({letter}) {_change_words(*change)}"
            for letter, change in zip(ascii_lowercase, self.changes[:MOST_NAMED], strict=False)
        ]
        unshown = len(self.changes) - len(shown)
        others = [f"and {unshown} other changes"] if unshown else []
        at = f"; rates at {clock(self.at_s)}" if np.isfinite(self.at_s) else ""
        first = (
            f"{better} each of {len(self.changes)} changes, and this telemetry cannot tell which is right {gain}: "
            f"CHECK THE COLUMNS, find out which one is right before you change the file{at}:"
        )
        return "\n".join([first, *shown, *others])


def _change_words(change: ColumnChange, omega: np.ndarray | None) -> str:
    """Return in words one change of several, with the rate `omega` (3) in rad/s under it."""
    do = f" ({change.do})" if change.axes or change.reversed_wheels else ""
    if omega is None:
        return f"{change.what}{do}"
    rate = ", ".join(f"{value:z.2f}" for value in np.degrees(omega))
    return f"{change.what}{do}: omega ({rate}) deg/s"


def rival_words(rival: BetterChanges, clock: Callable[[float], str]) -> str:
    """Return in words a change that the data do not exclude, with its rate; `clock` as of :meth:`BetterChanges.words`."""
    side = "higher" if rival.gain > 0 else "lower"
    count = len(rival.changes) - 1
    same = f", and with {count} more that look the same" if count else ""
    gain = f"(log evidence {side} by {abs(rival.gain):.1f}{same})"
    return f"with {_change_words(*rival.changes[0])} at {clock(rival.at_s)} {gain}"


@dataclass(frozen=True)
class ContradictingSensor:
    """A `sensor` that contradicts the motion of all others under any change of columns or axes that was tried."""

    sensor: str

    def words(self) -> str:
        """Return a sentence for the verdict."""
        option = "attitude" if self.sensor == "quaternion" else self.sensor
        return (
            f"without the {self.sensor} the other readings fit: look at its zero, scale, columns and clock (`--without {option}` "
            "gives the rates of the others)"
        )


@dataclass(frozen=True)
class UnstatedZero:
    """A `gyro` that fits only with a zero offset whose sigma the vehicle file does not state; its size is about `size_rad_s`."""

    size_rad_s: float
    gyro: Gyro

    def words(self) -> str:
        """Return a sentence for the verdict."""
        # the sigma in the unit of the columns, with two digits
        sigma = float(f"{self.size_rad_s / abs(self.gyro.scale_rad_s):.2g}")
        zero = {"value": self.gyro.zero.tolist(), "sigma": sigma}
        return (
            f"the gyro fits only with a zero offset of about {np.degrees(self.size_rad_s):.2g} deg/s, for which the vehicle file "
            "states no sigma, and the pass is not decided without the gyro: if its zero may be off so, "
            f"{advice_to_set('gyro', {'zero': zero})}"
        )


@dataclass(frozen=True)
class Estimators:
    """Functions that estimate a pass under a changed vehicle file, and the computing budget that they share.

    `evidence`: log evidence by a quick search; `estimate`: the whole estimate, None if it is not possible.
    """

    evidence: Callable[[Vehicle, xr.Dataset], float]
    estimate: Callable[[Vehicle, xr.Dataset], xr.Dataset | None]
    budget: Budget

    def estimate_if_fits(self, vehicle: Vehicle, telemetry: xr.Dataset) -> xr.Dataset | None:
        """Return the result of the whole estimate; None if it is not possible or the pass does not fit."""
        result = self.estimate(vehicle, telemetry)
        return result if result is not None and bool(result["fits"].values.all()) else None

    def quick_gains(
        self, vehicle: Vehicle, telemetry: xr.Dataset, changes: Sequence[ColumnChange], base: float
    ) -> np.ndarray:
        """Return the log evidence (m) of each change by a quick search, less that of the file as it is written (`base`).

        Changes that are left out when the budget is used up get -inf.
        """
        gains = np.full(len(changes), -np.inf)
        for k, change in enumerate(changes):
            if self.budget.exhausted():
                break
            gains[k] = self.evidence(*change.applied(vehicle, telemetry)) - base
        return gains


@dataclass(frozen=True)
class SampleCosts:
    """Costs of the samples of a pass, each by itself (:func:`sample_costs`): `as_written`, and under each of some changes.

    `changes` (m): of columns and panels; `of_changes` (m): the cost under each.
    """

    as_written: float
    changes: list[ColumnChange]
    of_changes: np.ndarray

    @classmethod
    def of(cls, vehicle: Vehicle, telemetry: xr.Dataset) -> SampleCosts:
        """Return the costs of the samples of a pass under the file as it is written and all changes of its columns."""
        changes = column_changes(vehicle, telemetry)
        as_written, *of_changes = sample_costs(vehicle, telemetry, [AS_WRITTEN, *changes])
        return cls(float(as_written), changes, np.array(of_changes))

    def contradict_the_columns(self) -> bool:
        """Return whether some change of columns fits the samples far better than the file as it is written."""
        return bool(self.as_written > self.of_changes.min(initial=np.inf) + WORTH_A_SEARCH)


def what_fits_better(
    observed: Observed, telemetry: xr.Dataset, estimators: Estimators
) -> BetterChanges | ContradictingSensor | None:
    """Return the changes with which a pass fits that does not fit as written; else the sensor that contradicts the others.

    None if neither is known. If the pass fits without one of the sensors, the cause is that sensor, or what only that sensor can
    see: other axes of the sensor are tried, then exchanged columns. The sensor itself is named only if it contradicts the motion of
    the others. If leaving out one sensor does not help, columns of panels and wheels are tried.
    """
    first_cause: BetterChanges | ContradictingSensor | None = None
    fits_without_one = False
    for name in SENSOR_NAMES:
        if name not in telemetry or not np.isfinite(telemetry[name].values).any():
            continue
        if estimators.budget.exhausted():
            break
        without = estimators.estimate_if_fits(observed.vehicle, telemetry.drop_vars(name))
        if without is None:
            continue
        fits_without_one = True
        # other axes of any sensor count before a contradicting sensor
        axes = _other_axes(observed, telemetry, name, without, estimators)
        if axes is not None:
            return _axes_or_columns(axes, observed, telemetry, estimators)
        if first_cause is None:
            first_cause = _exchanged_by_sensor(observed, telemetry, name, without, estimators)
        if first_cause is None and _contradicts(observed.vehicle, telemetry, name, without):
            first_cause = ContradictingSensor(SENSOR_NAMES[name])
    # if the others are too coarse to contradict a sensor, their columns are not what keeps the pass from fitting
    if fits_without_one or not observed.panels:
        return first_cause
    return _other_panels(observed, telemetry, estimators)


def denied_by_the_sun(
    vehicle: Vehicle, telemetry: xr.Dataset, motion: xr.Dataset, estimators: Estimators
) -> ContradictingSensor | None:
    """Return the magnetometer if the Sun alone allows no motion of a pass like that with the magnetometer; else None.

    A pass may fit although the axes of the magnetometer are wrong: over a small rotation its zero offset, which is mostly unknown,
    makes up for them. Which axes are right is not said: with few panels the motion by the Sun alone may be wrong too. `telemetry`:
    of one pass, without an orbit. `motion`: its rate `omega_B` with the magnetometer, and `omega_cov_B`.
    """
    # Panels in a plane leave the mirror image of each motion open, and one may not be found: of twenty right spinners one with two
    # panels was accused.
    normals = np.array([panel.normal_B for panel in vehicle.panels]).reshape(-1, 3)
    if "sun_sensor_B" not in telemetry and np.linalg.matrix_rank(normals) < 3:
        return None
    without = estimators.estimate_if_fits(vehicle, telemetry.drop_vars("field_B"))
    if without is None or not bool(without["search_complete"].values.all()):
        return None
    together = motion.sel(time=without["time"].values)
    omega = together["omega_B"].values
    variance = np.einsum("nii->ni", together["omega_cov_B"].values)
    # the most probable motion that the Sun allows is compared at all n samples, the others at the middle one
    sigma = np.sqrt(variance + np.einsum("nii->ni", without["omega_cov_B"].values))
    off = np.abs(without["omega_B"].values - omega) / sigma
    middle = middle_sample(without["time"].values)
    # rates and their sigmas (solution, 3) of the others; NaN if there are fewer
    rates, sigmas = (
        np.stack([without[f"{name}_{axis}"].values[0, 1:] for axis in "xyz"], axis=1)
        for name in ("omega", "sigma")
    )
    off_others = np.abs(rates - omega[middle]) / np.sqrt(sigmas**2 + variance[middle])
    if off.max() < CONTRADICTING_SIGMAS or (off_others < CONTRADICTING_SIGMAS).all(axis=1).any():
        return None
    return ContradictingSensor(SENSOR_NAMES["field_B"])


def unconfirmed_zero(
    observed: Observed, telemetry: xr.Dataset, motion: xr.Dataset, estimators: Estimators
) -> BetterChanges | ContradictingSensor | UnstatedZero | None:
    """Return what is in doubt if a gyro fits only with an offset for which the file states no sigma; None if nothing is.

    An unknown offset may make up for wrong axes of a gyro, or for a wrong unit, over a nearly steady rotation. So the pass is
    estimated without the gyro. If it is not decided then, the offset is in doubt. If it is, other axes that fit clearly better are
    named, or the gyro if the motion is another one. Else the offset is confirmed: None. `telemetry`: of one pass. `motion`: its
    rate `omega_B` with the gyro, and its covariance `omega_cov_B`.
    """
    gyro = observed.vehicle.sensors.gyro
    if gyro is None or gyro.zero_sigma.any():
        return None
    read = telemetry["gyro_B"].sel(time=motion["time"].values).values
    difference, variance = _difference_of_gyro(motion, read, gyro)
    if misfit(in_sigma((difference**2 / variance).sum(axis=1), 3)).fits:
        return None
    without = estimators.estimate_if_fits(observed.vehicle, telemetry.drop_vars("gyro_B"))
    # if it is not decided, its first solution may be a mirror image, which fits a gyro with mirrored axes
    if without is not None and bool(without["decided"].values.all()):
        axes = _other_axes(observed, telemetry, "gyro_B", without, estimators)
        if axes is not None:
            return _axes_or_columns(axes, observed, telemetry, estimators)
        off = np.abs(without["omega_B"].values - motion["omega_B"].sel(time=without["time"]).values)
        sigma = np.sqrt(np.einsum("nii->ni", without["omega_cov_B"].values))
        agrees = (off < CONTRADICTING_SIGMAS * sigma).all()
        return None if agrees else ContradictingSensor(SENSOR_NAMES["gyro_B"])
    return UnstatedZero(float(np.sqrt((difference**2).mean(axis=0)).max()), gyro)


# ------------------------------------------------------------------------------------------------------ columns of panels, wheels


def _other_panels(
    observed: Observed, telemetry: xr.Dataset, estimators: Estimators
) -> BetterChanges | None:
    """Return the changes of columns, panels and wheels with which a pass fits best; None if it fits with none.

    The samples, each by itself, exclude most changes without a search. First changes of one mistake are tried, then exchanged
    columns together with reversed wheels.
    """
    vehicle = observed.vehicle
    evidence_as_written = estimators.evidence(vehicle, telemetry)
    if not np.isfinite(evidence_as_written):
        return None
    wheels = wheel_changes(vehicle) if len(observed.momenta) else []
    changes = [AS_WRITTEN, *column_changes(vehicle, telemetry), *wheels]
    costs = sample_costs(vehicle, telemetry, changes)
    # the best first, those that are not far worse than the best; number 0 is the file as it is written
    order = np.argsort(costs, kind="stable")
    allowed = [int(k) for k in order if k and costs[k] <= costs[1:].min() + WORTH_A_SEARCH]
    of_one_mistake = [(changes[k], float(costs[k])) for k in allowed]
    names = [wheel.name for wheel in vehicle.wheels]
    # the samples, each by itself, do not see the wheels: the cost stays
    of_two_mistakes = [
        (change.with_wheels(wheel.reversed_wheels, names), cost)
        for change, cost in of_one_mistake
        if change.columns
        for wheel in wheels
    ]
    for candidates in (of_one_mistake, of_two_mistakes):
        better = _best_of_candidates(
            observed, telemetry, candidates, float(costs[0]), evidence_as_written, estimators
        )
        if better is not None:
            return better
    return None


def _best_of_candidates(
    observed: Observed,
    telemetry: xr.Dataset,
    candidates: Sequence[tuple[ColumnChange, float]],
    cost_as_written: float,
    evidence_as_written: float,
    estimators: Estimators,
) -> BetterChanges | None:
    """Return the candidates with which the pass fits best, with all that look the same as these; None if it fits with none.

    `candidates`: changes, each with its cost by :func:`sample_costs`. `cost_as_written`, `evidence_as_written`: the same cost, and
    the log evidence by a quick search, of the file as it is written.
    """
    # Of candidates that look the same one is searched with, and none that looks the same as the file. What looks the same costs
    # about the same, as its panels show the same: changes whose costs differ by CLEARLY need not be compared.
    distinct = [(AS_WRITTEN, cost_as_written)]
    for change, cost in candidates:
        of_same_cost = (earlier for earlier, its_cost in distinct if abs(cost - its_cost) < CLEARLY)
        if not any(len(equivalence(observed, earlier, change)) for earlier in of_same_cost):
            distinct.append((change, cost))
    searched = [change for change, _ in distinct[1:]]
    gains = estimators.quick_gains(observed.vehicle, telemetry, searched, evidence_as_written)
    ranked = [int(k) for k in np.argsort(-gains, kind="stable") if gains[k] > CLEARLY]

    # the best are estimated in full
    fitting: list[ChangeWithRate] = []
    best, best_estimate = -np.inf, None
    for k in ranked[:MOST_RUNS]:
        if gains[k] < best - CLEARLY:  # clearly worse than one that fits
            break
        result = estimators.estimate_if_fits(*searched[k].applied(observed.vehicle, telemetry))
        if result is not None:
            if best_estimate is None:
                best, best_estimate = float(gains[k]), result
            others = [change for change, _ in candidates]
            fitting += with_equivalents(observed, searched[k], result, others)
    if best_estimate is None:
        return None
    at_s = rate_at_mid_time(best_estimate)[1]
    return BetterChanges(tuple(fitting), best, at_s, estimate=best_estimate)


def rival_exchanges(
    observed: Observed,
    telemetry: xr.Dataset,
    costs: SampleCosts,
    noise: np.ndarray | float,
    estimators: Estimators,
    as_written: xr.Dataset | None,
) -> list[BetterChanges]:
    """Return changes of columns that the samples allow and that fit a pass about as well as the file, the most probable first.

    The samples, each by itself, cannot tell such columns apart, but a motion can. Both then explain all readings well, and only
    their evidence says which is right. A satellite with three lit panels was decided along a motion 74 sigma off that two exchanged
    columns made up; with the right ones the log evidence was better by 24. Changes that a quick search excludes (:data:`EXCLUDED`)
    are not estimated. `observed.sun_B`: Sun directions of the estimated motion. `costs`: of the samples of the pass. `noise`: one
    sigma of the panel readings, of each input (n_input) or of all. `as_written`: the whole estimate of the pass with the file as it
    is written, None if it is to be made.
    """
    dark, lit = _changes_to_compare(observed, telemetry, costs, noise)
    if not (dark or lit):
        return []
    # Each change with those that may look the same and then are named with it. `equivalence` compares lit columns only: it would
    # call all exchanges of dark ones the same.
    candidates = [(change, []) for change in dark] + [(change, costs.changes) for change in lit]
    vehicle = observed.vehicle
    quick_as_written = estimators.evidence(vehicle, telemetry)
    if not np.isfinite(quick_as_written):
        return []
    changes = [change for change, _ in candidates]
    gains = estimators.quick_gains(vehicle, telemetry, changes, quick_as_written)
    near = [int(k) for k in np.argsort(-gains, kind="stable") if gains[k] > -EXCLUDED]
    # A quick search holds inertia and gains. The evidence of a whole estimate tells more: of two files with exchanged columns the
    # right ones were better by 0.3 and 2.3 in a quick search, and by 2.6 and 4.6 in whole estimates.
    if not near:
        return []
    if as_written is None:
        as_written = estimators.estimate_if_fits(vehicle, telemetry)
        if as_written is None:
            return []
    rivals = []
    for k in near[:MOST_RUNS]:
        change, others = candidates[k]
        result = estimators.estimate_if_fits(*change.applied(vehicle, telemetry))
        if result is not None:
            gain = gain_in_evidence(result, as_written)
            same = tuple(with_equivalents(observed, change, result, others))
            at_s = rate_at_mid_time(result)[1]
            rivals.append(BetterChanges(same, gain, at_s, estimate=result))
    return sorted(rivals, key=lambda rival: -rival.gain)


def gain_in_evidence(result: xr.Dataset, as_written: xr.Dataset) -> float:
    """Return by how much a change of columns raises the log evidence of a pass; zero if the sign depends on the panels' sigmas.

    `result`, `as_written`: results of `rates` on that pass. Their sigmas of panel readings differ, as they follow from the data:
    light on panels that should be dark counts as the Earth's, and widens them. Neither narrower nor wider sigmas alone may make a
    change better. So the gain is computed with the factors 1 / sigma of the readings' densities, which `log_evidence` contains, and
    without them. The gain nearer to zero is returned, or zero if their signs differ.
    """
    gain = float(result.attrs["log_evidence"][0] - as_written.attrs["log_evidence"][0])
    # `log_evidence` contains minus `log_sigmas`, the sum of the logs of the sigmas; adding it takes it out
    log_widening = float(result.attrs["log_sigmas"][0] - as_written.attrs["log_sigmas"][0])
    gain_without_sigmas = gain + log_widening
    if gain * gain_without_sigmas <= 0:
        return 0.0
    return min((gain, gain_without_sigmas), key=abs)


def _changes_to_compare(
    observed: Observed, telemetry: xr.Dataset, costs: SampleCosts, noise: np.ndarray | float
) -> tuple[list[ColumnChange], list[ColumnChange]]:
    """Return two lists of changes that the samples of a pass allow, but its motion may not: exchanges of two dark columns; others.

    Arguments: see :func:`rival_exchanges`. Changes that give the readings of the file, or of reversed wheels, are left out.
    """
    vehicle = observed.vehicle
    # a change that looks the same as reversed wheels was tested with the signs of the wheels
    tested = [AS_WRITTEN, *(wheel_changes(vehicle) if len(observed.momenta) else [])]
    # light on each input along the estimated motion, and its readings (n, n_input), in sigmas
    light = vehicle.response_in().power(observed.sun_B) / noise
    read = np.nan_to_num(signals(telemetry)) / noise

    with_costs = zip(costs.changes, costs.of_changes, strict=True)
    allowed = [change for change, cost in with_costs if cost <= costs.as_written + AS_GOOD]
    dark, lit = [], []
    for change in allowed:
        # inputs that read another column: none if a panel is reversed
        moved = np.flatnonzero(np.asarray(change.columns) != np.arange(len(change.columns)))
        if len(moved) == 2 and not observed.lit[moved].any():
            # An exchange of two dark columns is compared if the motion lights them differently, or if their readings differ:
            # by more than CLEARLY in log likelihood. Others change nothing. A glint of 6 % of full Sun moved a rate by 5.6 sigma.
            differ = max(
                (np.diff(of_samples[:, moved], axis=1) ** 2).sum() / 2
                for of_samples in (light, read)
            )
            if differ > CLEARLY:
                dark.append(change)
        elif not any(len(equivalence(observed, other, change)) for other in tested):
            lit.append(change)
    if not (dark or lit):
        return dark, lit
    # Evidence can be compared only if the change leaves out panels without a signal as the file does: as many, of the same gains.
    silent = gains_of_silent_inputs(vehicle, telemetry, AS_WRITTEN)
    dark, lit = (
        [c for c in group if gains_of_silent_inputs(vehicle, telemetry, c) == silent]
        for group in (dark, lit)
    )
    return dark, lit


def gains_of_silent_inputs(
    vehicle: Vehicle, telemetry: xr.Dataset, change: ColumnChange
) -> list[float]:
    """Return the sorted gains of the inputs that are left out under a change, since their panels never show a signal."""
    silent = silent_inputs(assess(*change.applied(vehicle, telemetry)))
    return sorted(vehicle.input_gains[silent].tolist())


def silent_inputs(assessment: Assessment) -> np.ndarray:
    """Return which inputs (n_input) have no usable reading in any sample: they are dead, or never show a signal."""
    quality = assessment.quality
    return ~(quality["reading"].values & ~quality["dead"].values).any(axis=0)


def with_equivalents(
    observed: Observed, change: ColumnChange, result: xr.Dataset, others: Sequence[ColumnChange]
) -> list[ChangeWithRate]:
    """Return a change and those of the `others` that look the same, with their rates; `result`: the estimate under the change."""
    omega, _ = rate_at_mid_time(result)
    along = replace(observed, sun_B=np.nan_to_num(result["sun_B"].values))
    same = equivalent_changes(
        along, change, [other for other in others if other.what != change.what]
    )
    return [
        ChangeWithRate(change, omega),
        *(ChangeWithRate(equivalent, rate_under(matrix, omega)) for equivalent, matrix in same),
    ]


def rate_at_mid_time(result: xr.Dataset) -> tuple[np.ndarray, float]:
    """Return the body rate (3) in rad/s at the sample nearest to the middle of a result, and the time of that sample in s."""
    t = result["time"].values
    middle = middle_sample(t)
    return result["omega_B"].values[middle], float(t[middle])


def sample_costs(
    vehicle: Vehicle, telemetry: xr.Dataset, changes: Sequence[ColumnChange]
) -> np.ndarray:
    """Return the cost (m) of the samples under each change: minus their log likelihood, each in its own best direction of the Sun.

    No motion is needed, so that many changes are compared in little time. The square of a sample is the least
    |read - brightness light|^2 over all Sun directions, in which panels get `light`, and over a brightness of at most
    :data:`MOST_BRIGHTNESS`. All are shares of full Sun, in units of the error: :data:`READING_ERROR` and the noise of the inputs. A
    square counts up to :data:`MOST_SQUARE`.
    """
    sun = sphere(DIRECTIONS)
    stride = -(-max(telemetry.sizes["time"], 1) // MOST_COMPARED)
    telemetry = telemetry.isel(time=slice(None, None, stride))
    all_read = np.nan_to_num(signals(telemetry))
    variable = next(name for name in READINGS if name in telemetry)
    full_sun = full_sun_readings(vehicle, variable, all_read)
    noise = 0.0 if vehicle.input_noise is None else (vehicle.input_noise / full_sun).max()
    error = float(np.hypot(READING_ERROR, noise))
    sunlit = (all_read > error * full_sun.max()).any(axis=1)
    squares = []
    for change in changes:
        changed, data = change.applied(vehicle, telemetry.isel(time=sunlit))
        read = np.nan_to_num(signals(data)) / full_sun  # (n, n_input)
        light = changed.response_in().power(sun) / vehicle.input_gains  # (directions, n_input)
        # |read - b light|^2 = |read|^2 - 2 b (read . light) + b^2 |light|^2 is least at the brightness b = (read . light) /
        # |light|^2, if that is positive: (n, directions)
        along, light_square = read @ light.T, np.maximum((light**2).sum(axis=1), 1e-12)
        read_square = (read**2).sum(axis=1)[:, None]
        best_brightness = np.maximum(along, 0.0) / light_square
        full = 1.0
        if vehicle.gain_unit != variable[-1] and len(read):
            # gains without the unit of the readings: full Sun is a quantile of the brightness of samples in their best directions
            at_best = read_square - best_brightness * np.maximum(along, 0.0)
            direction = np.argmin(at_best, axis=1)
            at_direction = best_brightness[np.arange(len(read)), direction]
            full = float(np.quantile(at_direction, FULL_SUN_QUANTILE))
        brightness = np.minimum(best_brightness, MOST_BRIGHTNESS * full)
        square = read_square + brightness * (brightness * light_square - 2 * along)
        squares.append(square.min(axis=1) / error**2)
    by_sample = np.array(squares)  # (m, n)
    if not by_sample.size:
        return np.zeros(len(changes))
    # The Earth's light may be more than the error. Then even under the best change most samples have a square above the number of
    # inputs: all squares are made smaller by the same factor.
    by_sample /= max(1.0, float(np.median(by_sample, axis=1).min()) / len(full_sun))
    return np.minimum(by_sample, MOST_SQUARE).sum(axis=1) / 2


# ------------------------------------------------------------------------------------------------------------------ other sensors


def signed_axes() -> Iterator[tuple[str, list[int], tuple[float, ...]]]:
    """Yield the 48 ways to read three columns as axes: in words, column of each axis, sign of each axis.

    The first keeps the order and the signs that the vehicle file states.
    """
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            axes = ", ".join(
                f"{'-' if sign < 0 else '+'}{'xyz'[k]}"
                for k, sign in zip(order, signs, strict=True)
            )
            yield f"read as ({axes}) of its columns", list(order), signs


def axes_matrix(order: Sequence[int], signs: Sequence[float]) -> np.ndarray:
    """Return the matrix (3, 3) that takes a reading of three columns to axes: axis k is the column `order[k]` times `signs[k]`."""
    return np.eye(3)[list(order)] * np.array(signs)[:, None]


def advice_to_set(table: str, keys: Mapping[str, Any]) -> str:
    """Return the advice to set `keys` (key -> value) in a table of the vehicle file, each written as the file would state it.

    A value with its sigma is a mapping. It is written on one line: key = {value = ..., sigma = ...}.
    """
    lines = []
    for key, value in keys.items():
        if isinstance(value, Mapping):
            written = tomlkit.inline_table()
            written.update(value)
        else:
            written = value
        lines.append(tomlkit.dumps({key: written}).strip())
    return f"set {' and '.join(lines)} under [{table}] of the vehicle file"


def changes_of_sensor(vehicle: Vehicle, name: str) -> list[ColumnChange]:
    """Return all ways to read the sensor whose telemetry variable is `name`; the first is the way that the vehicle file states.

    A sensor with three axes has 48, their permutations with signs. A quaternion has four: where its scalar is, and its direction.
    """
    table = next(table for table, variable in VARIABLES.items() if variable == name)
    sensor = vehicle.sensors.with_columns[table]
    # each way: in words, the matrix by which readings are multiplied, and the keys of the vehicle file that state it
    if isinstance(sensor, Attitude):
        ways = list(_quaternion_conventions(sensor))
    else:
        ways = [
            (what, axes_matrix(order, signs), sensor.keys_for_axes(order, signs))
            for what, order, signs in signed_axes()
        ]
    return [
        ColumnChange(
            f"the {SENSOR_NAMES[name]} {what}", axes={name: matrix}, do=advice_to_set(table, keys)
        )
        for what, matrix, keys in ways
    ]


def _quaternion_conventions(sensor: Attitude) -> Iterator[tuple[str, np.ndarray, dict[str, Any]]]:
    """Yield the conventions of a quaternion: in words, the matrix (4, 4) that takes stated values to others, and keys of the file.

    Values are those that the vehicle file gives: scalar last, B_from_N. Its own convention comes first.
    """
    other_end, other_way = "with its scalar at the other end", "read the other way round"
    # row k is the quaternion of which only column k is not zero
    stated = sensor.interpret(np.eye(4)).values
    for what, other_scalar, other_direction in (
        ("read as the file states", False, False),
        (other_way, False, True),
        (other_end, True, False),
        (f"{other_end} and {other_way}", True, True),
    ):
        keys = sensor.keys_for_convention(other_scalar, other_direction)
        changed = replace(sensor, **keys).interpret(np.eye(4)).values
        yield what, changed.T @ stated, keys


def _other_axes(
    observed: Observed, telemetry: xr.Dataset, name: str, motion: xr.Dataset, estimators: Estimators
) -> BetterChanges | None:
    """Return other axes of a sensor with which the pass fits, and changes of columns that look the same; None if there are none.

    `name`: variable of the sensor; `motion`: the estimate without it. The sensor's readings, with each choice of axes, are
    compared with that motion, and a whole estimate confirms the best.
    """
    vehicle = observed.vehicle
    changes = changes_of_sensor(vehicle, name)  # the first is what the file states
    read = telemetry[name].sel(time=motion["time"].values).values
    costs = np.array(
        [_sensor_cost(motion, read @ change.axes[name].T, name, vehicle) for change in changes]
    )
    best = int(np.argmin(costs))
    gain = float(costs[0] - costs[best])
    if not gain > CLEARLY:
        return None
    result = estimators.estimate_if_fits(*changes[best].applied(vehicle, telemetry))
    if result is None:
        return None
    # axes that fit as well, those nearest to the stated ones first: a component that stays small may have any sign
    ties = [
        int(k)
        for k in np.flatnonzero(costs < costs[best] + CLEARLY)
        if k != best and costs[0] - costs[k] > CLEARLY
    ]
    ties.sort(key=lambda k: -np.trace(changes[k].axes[name]))
    omega, at_s = rate_at_mid_time(result)
    others = [*column_changes(vehicle, telemetry), *wheel_changes(vehicle)]
    same = with_equivalents(observed, changes[best], result, others)
    as_well = (ChangeWithRate(changes[k], omega) for k in ties)
    return BetterChanges((*same, *as_well), gain, at_s, estimate=result)


def _axes_or_columns(
    axes: BetterChanges, observed: Observed, telemetry: xr.Dataset, estimators: Estimators
) -> BetterChanges:
    """Return other axes of a sensor, or the changes of columns, panels and wheels that are clearly better; both if neither is.

    Two exchanged columns may nearly mirror the motion that the panels show. A right sensor then fits it along mirrored axes. Panels
    that are lit for a short time, and the inertia, tell such causes apart: as both have errors, both causes may fit.
    """
    columns = _other_panels(observed, telemetry, estimators) if observed.panels else None
    if columns is None or columns.estimate is None or axes.estimate is None:
        return axes
    gain = gain_in_evidence(columns.estimate, axes.estimate)
    if abs(gain) > CLEARLY:
        return columns if gain > 0 else axes
    named = {change.change.what for change in axes.changes}
    others = (change for change in columns.changes if change.change.what not in named)
    return replace(axes, changes=(*axes.changes, *others))


def _exchanged_by_sensor(
    observed: Observed, telemetry: xr.Dataset, name: str, motion: xr.Dataset, estimators: Estimators
) -> BetterChanges | None:
    """Return changes of panel columns that only one sensor can see, if the sensor fits the motion under them; else None.

    `name`: variable of the sensor; `motion`: the estimate without it, which its readings contradict. Without the sensor such a
    change looks the same as the file, but for a rotation or mirror M of the body. So its motion is that of the file under M, and
    the sensor is compared with it without a search.
    """
    # imported here, so that `sunspin check`, which needs only the names of the axes, starts sooner
    from scipy.spatial.transform import Rotation

    vehicle = observed.vehicle
    observed_without = replace(
        observed,
        sensors=observed.sensors - {name},
        sun_B=np.nan_to_num(motion["sun_B"].values),
    )
    # each change with its M (3, 3); the file as it is written first
    changes = [
        (AS_WRITTEN, np.eye(3)),
        *equivalent_changes(observed_without, AS_WRITTEN, column_changes(vehicle, telemetry)),
    ]
    read = telemetry[name].sel(time=motion["time"].values).values
    attitude = Rotation.from_quat(motion["B_from_N"].values).as_matrix()
    costs = np.zeros(len(changes))
    for k, (_, m) in enumerate(changes):
        # the motion under the change; M on both sides keeps the attitude a rotation if M is a mirror
        quaternion = Rotation.from_matrix(m @ attitude @ m.T).as_quat()
        mapped = motion.assign(
            omega_B=(motion["omega_B"].dims, rate_under(m, motion["omega_B"].values)),
            B_from_N=(motion["B_from_N"].dims, quaternion),
        )
        costs[k] = _sensor_cost(mapped, read, name, vehicle)
    best = int(np.argmin(costs))
    gain = float(costs[0] - costs[best])
    if not gain > CLEARLY:
        return None
    change, to_best = changes[best]
    result = estimators.estimate_if_fits(*change.applied(vehicle, telemetry))
    if result is None:
        return None
    omega, at_s = rate_at_mid_time(result)
    near = [int(k) for k in np.argsort(costs) if k and costs[k] < costs[best] + CLEARLY]
    # the rate under the best change, mapped back to the file as it is written and on to each of the others
    fitting = [
        ChangeWithRate(changes[k][0], rate_under(changes[k][1] @ to_best.T, omega)) for k in near
    ]
    return BetterChanges(tuple(fitting), gain, at_s)


def _contradicts(vehicle: Vehicle, telemetry: xr.Dataset, name: str, motion: xr.Dataset) -> bool:
    """Return whether a sensor's readings exclude the motion that the others show, within the errors of both.

    `name`: variable of the sensor; `motion`: the estimate without it. A pass may fit without a right sensor only because the
    others do not show what the model cannot follow. With a gyro a body that was rotated by hand did not fit, as its rate jumped;
    its panels gave the rate to 3 deg/s, and all readings of the gyro agreed.
    """
    read = telemetry[name].sel(time=motion["time"].values).values
    squares, _ = _sensor_squares(motion, read, name, vehicle)
    # a rate, a field, or a rotation from one attitude to the next: three degrees of freedom
    return not misfit(in_sigma(squares, 3)).fits


def _sensor_cost(motion: xr.Dataset, read: np.ndarray, name: str, vehicle: Vehicle) -> float:
    """Return minus the log likelihood of a sensor's readings along a motion: half of the squares, each at most `MOST_SQUARE`.

    Arguments are those of :func:`_sensor_squares`. An offset of a gyro that the file does not state adds its price.
    """
    squares, price = _sensor_squares(motion, read, name, vehicle)
    return float(np.minimum(squares, MOST_SQUARE).sum() / 2) + price


def _difference_of_gyro(
    motion: xr.Dataset, read: np.ndarray, gyro: Gyro
) -> tuple[np.ndarray, np.ndarray]:
    """Return the readings of a gyro less the rates of a motion, rad/s, and their variance by the errors of both, where it was read.

    `read` (n, 3): NaN where nothing was read; the results (m, 3) have the other samples.
    """
    known = np.isfinite(read).all(axis=1)
    rate_variance = np.einsum("nii->ni", motion["omega_cov_B"].values)  # the diagonals
    zero, scale = gyro.scale_rad_s * gyro.zero_sigma, gyro.scale_sigma / gyro.scale_rad_s
    sensor_variance = gyro.noise_rad_s**2 + zero**2 + (read * scale) ** 2
    difference = read - motion["omega_B"].values
    return difference[known], (rate_variance + sensor_variance)[known]


def _gyro_squares(motion: xr.Dataset, read: np.ndarray, gyro: Gyro) -> tuple[np.ndarray, float]:
    """Return squared differences (m), in sigmas, of a gyro and a motion, and the price in log likelihood of an offset of the gyro.

    Arguments are those of :func:`_difference_of_gyro`. If the file states no sigma of the zero offset, the median difference counts
    as the offset, up to three of the largest sigmas. If that fits better, the offset also drifts evenly, by as much as the medians
    of the first and the last third of the readings.
    """
    difference, variance = _difference_of_gyro(motion, read, gyro)
    if gyro.zero_sigma.any() or not len(difference):
        return (difference**2 / variance).sum(axis=1), 0.0
    most = 3 * GYRO_ZEROS[0]
    zero = np.clip(np.median(difference, axis=0), -most, most)
    precision = (1 / variance).sum(axis=0)
    price = _price_of_offset(zero, GYRO_ZEROS, precision)
    # the drift from the middle to the end; `share`: from -1 at the first reading to 1 at the last, as if they were evenly spaced
    share, third = np.linspace(-1, 1, len(difference)), -(-len(difference) // 3)
    change = np.median(difference[-third:], axis=0) - np.median(difference[:third], axis=0)
    drift = change / max(float(share[-third:].mean() - share[:third].mean()), 1.0)
    # the mean square of a number that is uniform in [-1, 1] is a third
    price_of_drift = _price_of_offset(drift, GYRO_DRIFTS, precision / 3)
    squares = ((difference - zero) ** 2 / variance).sum(axis=1)
    drifting = ((difference - zero - share[:, None] * drift) ** 2 / variance).sum(axis=1)
    gain = (np.minimum(squares, MOST_SQUARE) - np.minimum(drifting, MOST_SQUARE)).sum() / 2
    return (drifting, price + price_of_drift) if gain > price_of_drift else (squares, price)


def _price_of_offset(offset: np.ndarray, sizes: Sequence[float], precision: np.ndarray) -> float:
    """Return what a fitted offset (3), rad/s, costs in log likelihood: minus the log of the prior's share within its uncertainty.

    `precision` (3): one over the square of its sigma. Each component is normal with zero mean; its sigma may be any of the `sizes`,
    all equally likely.
    """
    sigma = np.array(sizes)[:, None]
    log_shares = -((offset / sigma) ** 2 + np.log1p(precision * sigma**2)).sum(axis=1) / 2
    return float(np.log(len(sizes)) - np.logaddexp.reduce(log_shares))


def _sensor_squares(
    motion: xr.Dataset, read: np.ndarray, name: str, vehicle: Vehicle
) -> tuple[np.ndarray, float]:
    """Return squared differences, in sigmas, between a sensor's readings and a motion, and the price of an offset of a gyro.

    The components of a difference are summed. The price, in log likelihood, is zero unless the file does not state the offset.

    `motion`: result of `rates` at n samples. `read` (n, 3, or 4 of a quaternion): readings of the variable `name` there, NaN if
    there are none. A gyro has one square for each reading, without its zero offset if the file does not state that. Fields and
    attitudes are compared from one sample to the next of a pass, as their frame in space is not known: one square for each pair.
    The sigmas contain the errors of the motion. Empty if the vehicle states no error of the sensor.
    """
    from scipy.spatial.transform import Rotation

    sensors = vehicle.sensors
    known = np.asarray(np.isfinite(read).all(axis=1))
    rate_variance = np.einsum("nii->ni", motion["omega_cov_B"].values)  # (n, 3): the diagonals
    if name == "gyro_B" and sensors.gyro is not None:
        return _gyro_squares(motion, read, sensors.gyro)

    same_pass = motion["pass_of"].values[1:] == motion["pass_of"].values[:-1]
    pairs = same_pass & known[1:] & known[:-1]
    attitude = Rotation.from_quat(motion["B_from_N"].values)
    interval_s = np.diff(motion["time"].values)
    # variance of the rotation between two samples, rad^2
    turn_variance = rate_variance[:-1].sum(axis=1) * interval_s**2
    magnetometer = sensors.magnetometer
    if name == "field_B" and magnetometer is not None and magnetometer.noise is not None:
        field_N = attitude.inv().apply(np.where(known[:, None], read, 0.0))
        strength = np.linalg.norm(field_N[:-1], axis=1)
        # the field itself turns in space along the orbit (FIELD_TURN), and the attitudes have errors
        motion_variance = ((FIELD_TURN * interval_s) ** 2 + turn_variance) * strength**2
        pair_variance = 2 * magnetometer.noise**2 + motion_variance
        return ((np.diff(field_N, axis=0) ** 2).sum(axis=1) / pair_variance)[pairs], 0.0
    if name == "attitude_B_from_N" and sensors.attitude is not None:
        read_attitude = Rotation.from_quat(np.where(known[:, None], read, [0.0, 0.0, 0.0, 1.0]))
        # rotation of the body from one sample to the next, as read and of the motion
        turn_read = read_attitude[1:] * read_attitude[:-1].inv()
        turn = attitude[1:] * attitude[:-1].inv()
        angle = (turn_read.inv() * turn).magnitude()
        return (angle**2 / (2 * sensors.attitude.sigma_rad**2 + turn_variance))[pairs], 0.0
    return np.zeros(0), 0.0
