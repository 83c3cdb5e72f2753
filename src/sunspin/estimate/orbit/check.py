"""Is an orbit consistent with telemetry? A check that needs no attitude.

Three things that a rotating body sees do not depend on its attitude: the strength of the magnetic field, its angle to the Sun, and
whether the Sun is up. The orbit predicts them but for its along-track offset. Zero and matrix of the magnetometer are fitted with
the offset, so that a poor calibration is no reason to refuse an orbit. The same is fitted to copies of the orbit with random node
and phase. Right elements fit better than nearly all copies: their rank is the answer, and how clearly copies can differ from the
orbit in these data says whether there is one. Clear Sun in the Earth's shadow refuses elements without a rank (:mod:`.shadow`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.special import erfc

from sunspin.environment.orbit import Orbit
from sunspin.estimate.orbit.axes import axes_matrix, axes_words, contradicted, turned_axes
from sunspin.estimate.orbit.calibration import (
    MOST_SAMPLES,
    Calibration,
    CalibrationStart,
    by_sun_sensors,
)
from sunspin.estimate.orbit.invariants import (
    FEWEST,
    MATRIX,
    ZERO,
    OffsetFits,
    Predicted,
    Sky,
    field_of,
    fit_at_offsets,
    residuals_left,
)
from sunspin.estimate.orbit.readings import Readings, read
from sunspin.estimate.orbit.shadow import SunInShadow, sun_in_shadow
from sunspin.estimate.settings import ORBIT, OrbitSettings
from sunspin.telemetry.assess import Assessment, assess
from sunspin.vehicle import Vehicle


class Verdict(Enum):
    """What the rank says; the values are the sentences."""

    FITS = "elements consistent with the telemetry"
    REFUSED = "elements not consistent with the telemetry; not used"
    UNDECIDED = "inconclusive: this telemetry cannot distinguish the elements from random ones; the along-track prior is unchanged"


@dataclass(frozen=True)
class OrbitCheck:
    """The answer of :func:`check_orbit`.

    `shift_s` at mid-file and its drift, with their sigmas; Sun sensors determine the drift, else it stays as it was. `better` of
    `copies` comparison orbits fit better, and `mistaken` are expected to by chance. With the node rotated by `turn_rad` residuals
    are `turn_times` smaller. `samples`: numbers that show something. Residuals are medians. `eclipse`: samples that show the Sun in
    the predicted shadow, and all there. `matrix`, `zero`: field in T = matrix reading - zero, None without a magnetometer.
    `border`: the shift is at the border of what was tried. `clock_behind_s`: the clock error with which the elements would fit,
    else 0. `sign_turned`: the field with the opposite sign fits the Sun clearly better. `turned_axes`: other axes of the
    magnetometer with which its angle to the Sun fits, in words. `made`: the fit of all sensors, if there are Sun sensors.
    `sun_in_shadow`: samples with clear Sun that contradict the orbit at any offset within the prior.
    """

    shift_s: float
    shift_sigma_s: float
    verdict: Verdict = Verdict.UNDECIDED
    better: int = 0
    copies: int = 0
    mistaken: float = float(ORBIT.copies)
    turn_rad: float = 0.0
    turn_times: float = 1.0
    samples: dict[str, int] = field(default_factory=dict)
    strength_residual_T: float = np.nan
    angle_residual_rad: float = np.nan
    eclipse: tuple[int, int] = (0, 0)
    matrix: np.ndarray | None = None
    zero: np.ndarray | None = None
    border: bool = False
    clock_behind_s: float = 0.0
    sign_turned: bool = False
    turned_axes: str = ""
    drift_s_day: float = 0.0
    drift_sigma_s_day: float = 0.0
    made: Calibration | None = None
    sun_in_shadow: SunInShadow = SunInShadow()

    def start(self, orbit: Orbit) -> CalibrationStart | None:
        """Return where a fit of all sensors along the orbit may begin; None without a magnetometer."""
        if self.matrix is None or self.zero is None:
            return None
        shift_s = self.shift_s - orbit.shift_s
        return CalibrationStart(self.matrix, self.zero, shift_s, self.strength_residual_T)


def check_orbit(
    orbit: Orbit,
    vehicle: Vehicle,
    telemetry: xr.Dataset | Assessment,
    *,
    seed: int = 0,
    settings: OrbitSettings = ORBIT,
) -> OrbitCheck:
    """Rank an orbit among comparison orbits of random node and phase, by what the telemetry shows at any attitude.

    The along-track offset of every orbit is sought within three sigmas of its prior (of offset and clock together), which counts.
    `telemetry`: Dataset of `read_telemetry`, or its Assessment. `seed`: of the random orbits.
    """
    s, assessment = settings, assess(vehicle, telemetry)
    shown = read(assessment, s.samples)
    along = float(np.hypot(orbit.shift_sigma_s, orbit.clock_sigma_s))
    unchecked = OrbitCheck(
        orbit.shift_s,
        along,
        drift_s_day=orbit.drift_s_day,
        drift_sigma_s_day=orbit.drift_sigma_s_day,
    )
    if not len(shown.t_s):
        return unchecked
    # angles that are too few judge no orbit
    judging = shown if shown.has_angle.sum() >= FEWEST else shown.without_sun()
    trial = Trial(judging, along, s)
    here = trial.predicted(orbit)
    own = trial.fit(here)
    way = None
    if "sun_sensor_angle" not in assessment.telemetry:
        way = turned_axes(judging, here.at([own.best]), vehicle)
    if way is not None:  # from here on as if the vehicle file named the axes rightly
        trial = replace(trial, readings=judging.with_axes(axes_matrix(way)))
        own = trial.fit(here)

    # the rank among comparison orbits, and what may overrule it: too little to rank by, and Sun in the shadow, which comes last
    rank = trial.rank(orbit, own, here, seed)
    readings, at_best = trial.readings, here.at([own.best])
    calibration = own.calibration[own.best]
    enough = max(readings.has_field.sum(), np.isfinite(readings.light).sum()) >= FEWEST
    verdict = Verdict.FITS
    if rank.better > s.better or rank.turn_times > s.times:
        verdict = Verdict.REFUSED
    elif contradicted(readings, at_best, calibration):
        verdict = Verdict.UNDECIDED
    if not enough or rank.mistaken > s.mistaken:
        verdict = Verdict.UNDECIDED
    shadow = sun_in_shadow(orbit, assessment, s.span)
    if shadow.samples:  # no other orbit need fit better: this one is wrong, or the clock is
        verdict = Verdict.REFUSED
    # what a field of the opposite sign, or another clock, must be clearly below to be named
    lowest = rank.lowest if verdict is Verdict.REFUSED else float(own.cost.min())
    lowest -= float(trial.prior(trial.shifts)[own.best])

    shift_s, shift_sigma_s, border = trial.shift(orbit, own)
    in_shadow = np.isfinite(readings.light) & (here.lit[own.best] < 0.5)
    answer = replace(
        unchecked,
        shift_s=orbit.shift_s + shift_s,
        shift_sigma_s=shift_sigma_s,
        verdict=verdict,
        better=rank.better,
        copies=s.copies,
        mistaken=rank.mistaken,
        turn_rad=rank.turn_rad,
        turn_times=rank.turn_times,
        samples=_counts(readings),
        eclipse=(int((in_shadow & (readings.light != 0)).sum()), int(in_shadow.sum())),
        border=border,
        sun_in_shadow=shadow,
    )
    if np.isfinite(calibration).all():
        answer = _calibrated(answer, trial, at_best, calibration, lowest)
        few_angles = not judging.has_angle.any() and shown.has_angle.any()
        if few_angles:
            answer = _with_few_angles(answer, replace(trial, readings=shown), at_best)
    if way is not None and answer.matrix is not None and verdict is not Verdict.REFUSED:
        words = axes_words(way, assessment)
        answer = replace(answer, matrix=answer.matrix @ axes_matrix(way), turned_axes=words)
    if verdict is Verdict.FITS:
        return _with_sun_sensors(answer, orbit, assessment)
    return replace(answer, clock_behind_s=trial.clock_behind_s(orbit, rank.lowest))


class Rank(NamedTuple):
    """How an orbit compares with others.

    `better` comparison orbits fit better, and `mistaken` would by chance; with the node rotated by `turn_rad` residuals are
    `turn_times` smaller. `lowest`: the cost of the best of the orbit and its copies.
    """

    better: int
    mistaken: float
    turn_rad: float
    turn_times: float
    lowest: float


@dataclass(frozen=True)
class Trial:
    """What orbits are compared with: readings, and offsets along the track, of which `along_s` is one sigma."""

    readings: Readings
    along_s: float
    s: OrbitSettings

    @property
    def shifts(self) -> np.ndarray:
        """Offsets (K) in s that are tried."""
        steps = np.ceil(self.s.span * self.along_s / self.s.step_s)
        half = int(np.clip(steps, 3, self.s.most_steps // 2))
        return self.s.span * self.along_s / half * np.arange(-half, half + 1)

    def prior(self, shifts: np.ndarray) -> np.ndarray:
        """Return the cost (K) of offsets by their prior."""
        return (shifts / self.along_s) ** 2 / 2

    def predicted(self, orbit: Orbit, node_rad: float = 0.0, phase_s: float = 0.0) -> Predicted:
        """Return what an orbit, or a comparison orbit, predicts at every offset."""
        return Sky.along(orbit, self.readings.t_s, self.shifts, node_rad, phase_s).invariants()

    def fit(
        self,
        predicted: Predicted,
        reach: float = np.inf,
        readings: Readings | None = None,
        scatter: np.ndarray | None = None,
    ) -> OffsetFits:
        """Return an orbit's fits at all offsets; at every third only, if none of these comes near the cost `reach` of its rival.

        `readings`, `scatter`: in place of those of the file and of their estimated noise.
        """
        readings = self.readings if readings is None else readings
        prior = self.prior(self.shifts)
        if np.isfinite(reach):
            third = slice(1, None, 3)
            coarse = fit_at_offsets(readings, predicted.at(third), prior[third], scatter)
            if coarse.cost.min() > reach + self.s.near:
                return coarse
        return fit_at_offsets(readings, predicted, prior, scatter)

    def rank(self, orbit: Orbit, own: OffsetFits, predicted: Predicted, seed: int) -> Rank:
        """Return how an orbit compares with copies of random node and phase, and with other nodes.

        `own`, `predicted`: its fits, and what it predicts at every offset.
        """
        rng, count = np.random.default_rng(seed), self.s.copies
        nodes = rng.uniform(0, 2 * np.pi, count)
        phases = rng.uniform(0, orbit.elements[0].period_s, count)
        copies = [self.predicted(orbit, *pair) for pair in zip(nodes, phases, strict=True)]
        ranked = [self.fit(copy, reach=float(own.cost.min())) for copy in copies]
        better = sum(int(copy.cost.min() <= own.cost.min()) for copy in ranked)
        winner = min([own, *ranked], key=lambda fits: fits.cost.min())
        mistaken = self.mistaken(predicted.at([own.best]), copies, winner)
        return Rank(better, mistaken, *self.other_node(orbit, own), float(winner.cost.min()))

    def mistaken(self, right: Predicted, copies: list[Predicted], winner: OffsetFits) -> float:
        """Return how many copies would fit better by chance if the orbit were right, by the noise of the best of all orbits.

        `right`: the predictions of the orbit at one offset, which become noiseless readings. The cost of a copy for these is higher
        than that of the orbit by D. With noise the difference is normal, of mean D and sigma sqrt(2 D). It is negative, and the
        copy fits better, with the probability erfc(sqrt(D) / 2) / 2.
        """
        scatter = np.minimum(winner.scatter[winner.best], self.s.most_scatter)
        noiseless = as_predicted(self.readings, right, winner.calibration[winner.best])
        own_cost = float(fit_at_offsets(noiseless, right, np.zeros(1), scatter).cost[0])
        costs = [self.fit(copy, own_cost, noiseless, scatter).cost.min() for copy in copies]
        higher = np.maximum(np.array(costs) - own_cost, 0)
        return float((erfc(np.sqrt(higher) / 2) / 2).sum())

    def other_node(self, orbit: Orbit, own: OffsetFits) -> tuple[float, float]:
        """Return the rotation of the node (rad) with which the orbit fits best, and how many times smaller residuals are then.

        That is (0, 1) if none fits better. N residuals that are all smaller by a factor lower the cost by N times its log.
        """
        count = self.readings.has_field.sum()
        if count < FEWEST:
            return 0.0, 1.0
        nodes = np.radians(self.s.nodes_deg)
        costs = np.array([self.fit(self.predicted(orbit, node)).cost.min() for node in nodes])
        gain = (own.cost.min() - costs.min()) / (count + self.readings.has_angle.sum())
        return (float(nodes[costs.argmin()]), float(np.exp(gain))) if gain > 0 else (0.0, 1.0)

    def clock_behind_s(self, orbit: Orbit, lowest: float) -> float:
        """Return how far the clock is behind UTC, in s, if it is off by whole hours and the elements are right.

        It is 0 unless this fits clearly better than the lowest cost of the orbit and all copies.
        """
        clocks = 3600.0 * np.array(self.s.hours)
        other = [replace(orbit, clock_s=orbit.clock_s + clock) for clock in clocks]
        costs = [self.fit(self.predicted(one), lowest).cost.min() for one in other]
        return float(clocks[np.argmin(costs)]) if min(costs) < lowest - self.s.clearly else 0.0

    def opposite(self, at: Predicted) -> float:
        """Return the cost of the field with the opposite sign at one offset, without the offset's prior."""
        opposite = self.readings._replace(field=-self.readings.field)
        return float(fit_at_offsets(opposite, at, np.zeros(1)).cost[0])

    def shift(self, orbit: Orbit, own: OffsetFits) -> tuple[float, float, bool]:
        """Return the offset in addition to the orbit's own (s), its sigma, and whether it is at the border of what was tried.

        They are mean and sigma of the density exp(-cost), all minima counted. The sigma is at least what leaving out each part of
        the file changes (jackknife): calibration drifts, and beacons of a pass err as one. `own`: the fits at all offsets.
        """
        s, tried = self.s, self.shifts
        step = tried[1] - tried[0]
        likely = tried[own.cost < own.cost.min() + s.deep]
        fine = np.linspace(likely.min() - step, likely.max() + step, s.fine)
        t_s = self.readings.t_s
        predicted = Sky.along(orbit, t_s, fine).invariants()
        cost = fit_at_offsets(self.readings, predicted, self.prior(fine)).cost
        mean, sigma = _moments(fine, cost)
        at_border = own.best < 2 or own.best > len(tried) - 3
        if len(t_s) < s.blocks * FEWEST / 2:
            return mean, sigma, at_border
        near = mean + sigma * np.linspace(-3, 3, s.around)
        predicted = Sky.along(orbit, t_s, near).invariants()
        means = []
        for block in np.array_split(np.arange(len(t_s)), s.blocks):
            rest = np.setdiff1d(np.arange(len(t_s)), block)
            cost = fit_at_offsets(
                self.readings.take(rest), predicted.take(rest), self.prior(near)
            ).cost
            means.append(_moments(near, cost)[0])
        jackknife = (1 - 1 / s.blocks) * ((np.array(means) - np.mean(means)) ** 2).sum()
        return mean, max(sigma, s.few * float(np.sqrt(jackknife))), at_border


def as_predicted(readings: Readings, right: Predicted, calibration: np.ndarray) -> Readings:
    """Return the readings without noise: as they would be if the orbit were right, at its one offset.

    The field has the predicted strength and angle to the Sun, in the half plane where it was read; it is dark in the shadow.
    `calibration` (12): matrix and zero by which fields become readings again.
    """
    dark = np.isfinite(readings.light) & (right.lit[0] < 0.5)
    readings = readings._replace(light=np.where(dark, 0.0, readings.light))
    if not np.isfinite(calibration).all():
        return readings
    sun, read_unit = readings.sun, field_of(readings.field, calibration)
    read_unit /= np.linalg.norm(read_unit, axis=1, keepdims=True)
    across = read_unit - (read_unit * sun).sum(axis=1, keepdims=True) * sun
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    strength = right.strength[0][:, None]
    cosine = right.toward[0][:, None] / strength
    unit = cosine * sun + np.sqrt(1 - cosine**2) * across  # NaN without a Sun
    field = strength * np.where(np.isfinite(unit), unit, read_unit)
    matrix = calibration[MATRIX].reshape(3, 3)
    return readings._replace(field=np.linalg.solve(matrix, (field + calibration[ZERO]).T).T)


def _counts(readings: Readings) -> dict[str, int]:
    """Return how many samples show field, light, and the angle between field and Sun."""
    shows = {
        "field": readings.has_field,
        "light": np.isfinite(readings.light),
        "field and Sun": readings.has_angle,
    }
    return {what: int(which.sum()) for what, which in shows.items()}


def _calibrated(
    answer: OrbitCheck, trial: Trial, at: Predicted, calibration: np.ndarray, lowest: float
) -> OrbitCheck:
    """Return the answer with the magnetometer's calibration (12), its residuals, and whether its sign is the opposite one.

    `at`: predictions at the one offset; `lowest`: the cost that the opposite sign must be clearly below. A calibration that itself
    reverses the readings is of the opposite sign too, if the angle to the Sun fits only by this.
    """
    readings = trial.readings
    field = field_of(readings.field, calibration)
    strength, angle = residuals_left(field, readings.sun, at)
    sign_turned = trial.opposite(at) < lowest - trial.s.clearly
    reverses = np.linalg.det(calibration[MATRIX].reshape(3, 3)) < 0
    if reverses and answer.verdict is not Verdict.REFUSED and readings.has_angle.sum() >= FEWEST:
        _, other = residuals_left(-field, readings.sun, at)
        sign_turned |= angle < trial.s.mirrored * other
    return replace(
        answer,
        matrix=calibration[MATRIX].reshape(3, 3),
        zero=calibration[ZERO],
        strength_residual_T=strength,
        angle_residual_rad=angle,
        sign_turned=bool(sign_turned),
    )


def _with_few_angles(answer: OrbitCheck, trial: Trial, at: Predicted) -> OrbitCheck:
    """Return the answer with the residual of angles that are too few to judge an orbit, and with the sign that they show."""
    readings = trial.readings
    own = fit_at_offsets(readings, at, np.zeros(1))
    clearly = trial.opposite(at) < own.cost[0] - trial.s.clearly
    field = field_of(readings.field, own.calibration[0])
    return replace(
        answer,
        angle_residual_rad=residuals_left(field, readings.sun, at)[1],
        sign_turned=bool(clearly) and answer.verdict is not Verdict.REFUSED,
        samples=_counts(readings),
    )


def _with_sun_sensors(answer: OrbitCheck, orbit: Orbit, assessment: Assessment) -> OrbitCheck:
    """Return the answer with offset and calibration of the fit of all sensors, if there are Sun sensors."""
    start = answer.start(orbit)
    if start is None or "sun_sensor_angle" not in assessment.telemetry:
        return answer
    readings = read(assessment, MOST_SAMPLES)
    fitted = by_sun_sensors(orbit, assessment.vehicle, readings, start)
    if fitted is None:
        return answer
    return replace(
        answer,
        shift_s=orbit.shift_s + fitted.shift_s,
        shift_sigma_s=fitted.shift_sigma_s,
        drift_s_day=orbit.drift_s_day + fitted.drift_s_day,
        drift_sigma_s_day=fitted.drift_sigma_s_day,
        matrix=fitted.matrix_T,
        zero=fitted.matrix_T @ fitted.zero,
        strength_residual_T=float(fitted.strength[1]),
        angle_residual_rad=float(fitted.angle[1]),
        made=fitted,
    )


def _moments(shifts: np.ndarray, cost: np.ndarray) -> tuple[float, float]:
    """Return mean and sigma in s of the offset under the density exp(-cost), given at even offsets `shifts` (K)."""
    weight = np.exp(cost.min() - cost)
    weight /= weight.sum()
    mean = float(weight @ shifts)
    within_step = (shifts[1] - shifts[0]) ** 2 / 12  # variance of an even density over one step
    return mean, float(np.sqrt(weight @ (shifts - mean) ** 2 + within_step))
