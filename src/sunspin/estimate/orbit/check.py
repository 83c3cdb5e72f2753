"""Check of an orbit against telemetry that needs no attitude.

Three things that a rotating body sees do not depend on its attitude: the strength of the magnetic field, its angle to the Sun, and
whether the Sun is up. The orbit predicts them but for its along-track offset. Zero and matrix of the magnetometer are fitted with
the offset, so that a poor calibration is no reason to refuse an orbit. The same is fitted to comparison orbits, which are copies of
the orbit with random node and phase. Right elements fit better than nearly all copies, so their rank decides. If copies would often
fit better by chance even against right elements, the data cannot decide. Clear Sun in the Earth's shadow refuses any
(:mod:`.shadow`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.special import erfc

from sunspin.environment.orbit import Orbit
from sunspin.estimate.orbit.axes import axes_words, better_axes, contradicted
from sunspin.estimate.orbit.calibration import (
    MOST_SAMPLES,
    Calibration,
    CalibrationStart,
    calibrate_with_sun_sensors,
)
from sunspin.estimate.orbit.invariants import (
    FEWEST,
    MATRIX,
    ZERO,
    OffsetFits,
    Predicted,
    Sky,
    calibrated_field,
    fit_at_offsets,
    median_residuals,
)
from sunspin.estimate.orbit.readings import Readings, orbit_readings
from sunspin.estimate.orbit.shadow import SunInShadow, sun_in_shadow
from sunspin.estimate.settings import ORBIT, OrbitSettings
from sunspin.telemetry.assess import Assessment, assess
from sunspin.vehicle import Vehicle


class Verdict(Enum):
    """Verdicts on an orbit; the values are sentences for a person."""

    FITS = "elements consistent with the telemetry"
    REFUSED = "elements not consistent with the telemetry; not used"
    UNDECIDED = "inconclusive: this telemetry cannot distinguish the elements from random ones; the along-track prior is unchanged"


LARGE_ANGLE_RAD = 0.17
"""Median residual of the angle between field and Sun above which few samples are a warning: sound panels and a sound magnetometer
agree to 5 degrees. Axes turned by 90 degrees gave 18 degrees in 12 samples, with consistent elements."""


@dataclass(frozen=True)
class OrbitCheck:
    """Result of :func:`check_orbit`.

    `shift_s`: along-track offset at mid-file, with its drift and the sigmas of both; only Sun sensors determine the drift. `better`
    of `copies` comparison orbits fit better, and `better_by_chance` are expected to if the orbit is right. With the node rotated by
    `node_rad` residuals are smaller by `node_factor`. `samples`: how many show field, light, or the angle between field and Sun.
    Residuals are medians. `eclipse`: samples that show the Sun in the predicted shadow, and all there. `matrix`, `zero`: field in T
    = matrix reading - zero, None without a magnetometer. `border`: the offset is at the border of those tried. `clock_behind_s`:
    clock error with which refused elements would fit, else 0. `sign_turned`: the field with the opposite sign fits the Sun clearly
    better. `turned_axes`: other axes of the magnetometer with which its angle to the Sun fits, in words. `fitted_sensors`: the fit
    of all sensors, if there are Sun sensors. `sun_in_shadow`: samples with clear Sun that contradict the orbit at any offset within
    the prior.
    """

    shift_s: float
    shift_sigma_s: float
    verdict: Verdict = Verdict.UNDECIDED
    better: int = 0
    copies: int = 0
    better_by_chance: float = float(ORBIT.copies)
    node_rad: float = 0.0
    node_factor: float = 1.0
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
    fitted_sensors: Calibration | None = None
    sun_in_shadow: SunInShadow = SunInShadow()

    @property
    def field_and_sun_disagree(self) -> bool:
        """Return whether angles between field and Sun, too few to refuse the orbit, are far off, and no other axes explain it."""
        few = FEW_ANGLES <= self.samples.get("field and Sun", 0) < FEWEST
        return few and self.angle_residual_rad > LARGE_ANGLE_RAD and not self.turned_axes

    def start(self, orbit: Orbit) -> CalibrationStart | None:
        """Return the calibration at which a fit of all sensors along the orbit begins; None without a magnetometer."""
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
    """Return whether an orbit is consistent with telemetry, and its along-track offset and magnetometer as fitted.

    The orbit is ranked among comparison orbits of random node and phase, by readings that do not depend on the attitude. Each is
    fitted at along-track offsets within three sigmas of their prior, whose density counts. `telemetry`: Dataset of
    `read_telemetry`, or its Assessment. `seed`: of the random orbits.
    """
    assessment = assess(vehicle, telemetry)
    every = orbit_readings(assessment, settings.samples)
    unchecked = OrbitCheck(
        orbit.shift_s,
        orbit.offset_sigma_s,
        drift_s_day=orbit.drift_s_day,
        drift_sigma_s_day=orbit.drift_sigma_s_day,
    )
    if not len(every.t_s):
        return unchecked
    # a few angles between field and Sun are no reason to refuse an orbit
    readings = every if every.has_angle.sum() >= FEWEST else every.without_sun()
    comparison = Comparison(readings, orbit.offset_sigma_s, settings)
    predicted = comparison.predicted(orbit)
    own = comparison.fit(predicted)
    change = None
    if "sun_sensor_angle" not in assessment.telemetry:
        change = better_axes(readings, predicted.at([own.best]), vehicle)
    if change is not None:  # from here on as if the vehicle file named these axes
        comparison = replace(comparison, readings=readings.with_axes(change.axes["field_B"]))
        own = comparison.fit(predicted)
    readings, at_best = comparison.readings, predicted.at([own.best])
    calibration = own.calibration[own.best]

    rank = comparison.rank(orbit, own, predicted, seed)
    shadow = sun_in_shadow(orbit, assessment, settings.span)
    angle_is_off = contradicted(readings, at_best, calibration)
    verdict = _verdict(rank, readings, angle_is_off, bool(shadow.samples), settings)
    shift_s, shift_sigma_s, border = comparison.shift(orbit, own)
    in_shadow = np.isfinite(readings.light) & (predicted.lit[own.best] < 0.5)
    answer = replace(
        unchecked,
        shift_s=orbit.shift_s + shift_s,
        shift_sigma_s=shift_sigma_s,
        verdict=verdict,
        better=rank.better,
        copies=settings.copies,
        better_by_chance=rank.better_by_chance,
        node_rad=rank.node_rad,
        node_factor=rank.node_factor,
        samples=_counts(readings),
        eclipse=(int((in_shadow & (readings.light != 0)).sum()), int(in_shadow.sum())),
        border=border,
        sun_in_shadow=shadow,
    )
    if np.isfinite(calibration).all():
        # what a field of the opposite sign must cost clearly less than, without the prior of the offset
        lowest = rank.lowest if verdict is Verdict.REFUSED else float(own.cost.min())
        lowest -= float(comparison.prior(comparison.shifts)[own.best])
        answer = _with_magnetometer(answer, comparison, at_best, calibration, lowest)
        if not readings.has_angle.any() and every.has_angle.any():
            answer = _with_few_angles(answer, replace(comparison, readings=every), at_best)
    verdict = answer.verdict
    if change is not None and answer.matrix is not None and verdict is not Verdict.REFUSED:
        words = axes_words(change, assessment)
        answer = replace(answer, matrix=answer.matrix @ change.axes["field_B"], turned_axes=words)
    if verdict is Verdict.FITS:
        return _with_sun_sensors(answer, orbit, assessment)
    return replace(answer, clock_behind_s=comparison.clock_behind_s(orbit, rank.lowest))


class Rank(NamedTuple):
    """Comparison of an orbit with its copies: fields of :class:`OrbitCheck`, and `lowest`, the cost of the best of all orbits."""

    better: int
    better_by_chance: float
    node_rad: float
    node_factor: float
    lowest: float


def _verdict(
    rank: Rank, readings: Readings, angle_is_off: bool, sun_in_shadow: bool, settings: OrbitSettings
) -> Verdict:
    """Return the verdict by the rank of the orbit, if there is enough to rank by; clear Sun in the shadow refuses any orbit.

    `angle_is_off`: the angle between field and Sun differs from the prediction, though no copy may fit better.
    """
    if sun_in_shadow:
        return Verdict.REFUSED
    enough = max(readings.has_field.sum(), np.isfinite(readings.light).sum()) >= FEWEST
    if not enough or rank.better_by_chance > settings.mistaken:
        return Verdict.UNDECIDED
    if rank.better > settings.better or rank.node_factor > settings.times:
        return Verdict.REFUSED
    doubtful = angle_is_off or rank.node_factor > settings.times_undecided
    return Verdict.UNDECIDED if doubtful else Verdict.FITS


FEW_ANGLES = 5
"""With fewer angles between field and Sun these do not count against an orbit."""


@dataclass(frozen=True)
class Comparison:
    """Fits of several orbits to the same readings, at the same along-track offsets, whose prior sigma is `along_s` (s)."""

    readings: Readings
    along_s: float
    settings: OrbitSettings

    @property
    def shifts(self) -> np.ndarray:
        """Offsets (K) in s that are tried, evenly spaced from -span to +span sigmas of their prior."""
        steps = np.ceil(self.settings.span * self.along_s / self.settings.step_s)
        half = int(np.clip(steps, 3, self.settings.most_steps // 2))
        return self.settings.span * self.along_s / half * np.arange(-half, half + 1)

    def prior(self, shifts: np.ndarray) -> np.ndarray:
        """Return the cost (K) of offsets (K, s) by their prior, minus the log of a normal density."""
        return (shifts / self.along_s) ** 2 / 2

    def predicted(self, orbit: Orbit, node_rad: float = 0.0, phase_s: float = 0.0) -> Predicted:
        """Return what an orbit, or a copy with its node rotated and its satellite `phase_s` ahead, predicts at every offset."""
        return Sky.along(orbit, self.readings.t_s, self.shifts, node_rad, phase_s).invariants()

    def fit(
        self,
        predicted: Predicted,
        reach: float = np.inf,
        readings: Readings | None = None,
        scatter: np.ndarray | None = None,
    ) -> OffsetFits:
        """Return the fits of an orbit with these predictions at all offsets, with the magnetometer fitted at each.

        `reach`: the lowest cost of a rival orbit. If it is finite, every third offset is fitted first. If even the best of these
        costs more than `reach + settings.near`, only these are returned: the orbit is too far behind to win. `readings`, `scatter`
        (2): in place of the readings of the file and of their estimated noise.
        """
        readings = self.readings if readings is None else readings
        prior = self.prior(self.shifts)
        if np.isfinite(reach):
            third = slice(1, None, 3)
            coarse = fit_at_offsets(readings, predicted.at(third), prior[third], scatter)
            if coarse.cost.min() > reach + self.settings.near:
                return coarse
        return fit_at_offsets(readings, predicted, prior, scatter)

    def rank(self, orbit: Orbit, own: OffsetFits, predicted: Predicted, seed: int) -> Rank:
        """Return how an orbit compares with copies of random node and phase, and with copies of which only the node differs.

        `own`, `predicted`: fits and predictions of the orbit at every offset. `seed`: of the random copies.
        """
        rng, count = np.random.default_rng(seed), self.settings.copies
        nodes = rng.uniform(0, 2 * np.pi, count)
        phases = rng.uniform(0, orbit.elements[0].period_s, count)
        copies = [self.predicted(orbit, *pair) for pair in zip(nodes, phases, strict=True)]
        ranked = [self.fit(copy, reach=float(own.cost.min())) for copy in copies]
        better = sum(int(copy.cost.min() <= own.cost.min()) for copy in ranked)
        winner = min([own, *ranked], key=lambda fits: fits.cost.min())
        by_chance = self.better_copies(predicted.at([own.best]), copies, winner)
        return Rank(better, by_chance, *self.other_node(orbit, own), float(winner.cost.min()))

    def better_copies(self, right: Predicted, copies: list[Predicted], winner: OffsetFits) -> float:
        """Return the expected number of copies that would fit better by chance if the orbit were right.

        Noiseless readings are made from the predictions `right` of the orbit at one offset. For these a copy costs more than the
        orbit by D. With noise the difference is normal, of mean D and sigma sqrt(2 D). It is negative, so that the copy fits
        better, with the probability erfc(sqrt(D) / 2) / 2. `copies`: predictions of each copy. The noise is that of the fit of
        the best of all orbits, `winner`.
        """
        scatter = np.minimum(winner.scatter[winner.best], self.settings.most_scatter)
        noiseless = noiseless_readings(self.readings, right, winner.calibration[winner.best])
        own_cost = float(fit_at_offsets(noiseless, right, np.zeros(1), scatter).cost[0])
        costs = [self.fit(copy, own_cost, noiseless, scatter).cost.min() for copy in copies]
        higher = np.maximum(np.array(costs) - own_cost, 0)
        return float((erfc(np.sqrt(higher) / 2) / 2).sum())

    def other_node(self, orbit: Orbit, own: OffsetFits) -> tuple[float, float]:
        """Return the rotation of the node (rad) with which the orbit fits best, and by which factor residuals are smaller then.

        They are (0, 1) if no other node fits better than the fits `own` of the orbit, or fewer than FEWEST samples show the field.
        N residuals that are all smaller by a factor lower the cost by N times its log.
        """
        count = self.readings.has_field.sum()
        if count < FEWEST:
            return 0.0, 1.0
        nodes = np.radians(self.settings.nodes_deg)
        costs = np.array([self.fit(self.predicted(orbit, node)).cost.min() for node in nodes])
        gain = (own.cost.min() - costs.min()) / (count + self.readings.has_angle.sum())
        return (float(nodes[costs.argmin()]), float(np.exp(gain))) if gain > 0 else (0.0, 1.0)

    def clock_behind_s(self, orbit: Orbit, lowest: float) -> float:
        """Return the error of the telemetry's clock, in s behind UTC, with which these elements fit clearly; 0 if with none.

        The whole hours of `settings.hours`, those of time zones, are tried; negative ones are a clock ahead of UTC. With the best,
        the orbit must cost less than `lowest`, by more than `settings.clearly`. `lowest`: the lowest cost of the orbit and all its
        copies, by the clock as it is.
        """
        behind_s = 3600.0 * np.array(self.settings.hours)
        shifted = [replace(orbit, clock_s=orbit.clock_s + clock_s) for clock_s in behind_s]
        # with `lowest` as `reach`, a clock that is far from fitting is fitted at every third offset only
        costs = [self.fit(self.predicted(other), lowest).cost.min() for other in shifted]
        is_clear = min(costs) < lowest - self.settings.clearly
        return float(behind_s[np.argmin(costs)]) if is_clear else 0.0

    def cost_of_opposite_field(self, at: Predicted) -> float:
        """Return the cost of the readings with the field reversed, without the prior of the offset; `at`: predictions at one."""
        opposite = self.readings._replace(field=-self.readings.field)
        return float(fit_at_offsets(opposite, at, np.zeros(1)).cost[0])

    def shift(self, orbit: Orbit, own: OffsetFits) -> tuple[float, float, bool]:
        """Return the offset in addition to the orbit's own (s), its sigma (s), and whether it is at the border of those tried.

        They are mean and sigma of the density exp(-cost) over all offsets. The sigma is at least that of a jackknife over parts of
        the file, as readings of one pass have errors in common. `own`: the fits at all offsets.
        """
        s, tried = self.settings, self.shifts
        step = tried[1] - tried[0]
        likely = tried[own.cost < own.cost.min() + s.deep]
        # a finer grid over all offsets that are not far less probable than the best
        fine = np.linspace(likely.min() - step, likely.max() + step, s.fine)
        t_s = self.readings.t_s
        predicted = Sky.along(orbit, t_s, fine).invariants()
        cost = fit_at_offsets(self.readings, predicted, self.prior(fine)).cost
        mean, sigma = _moments(fine, cost)
        at_border = own.best < 2 or own.best > len(tried) - 3
        if len(t_s) < s.blocks * FEWEST / 2:  # too few samples for a jackknife
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


def noiseless_readings(readings: Readings, right: Predicted, calibration: np.ndarray) -> Readings:
    """Return the readings as they would be without noise if the orbit were right at the one offset of the predictions.

    The field gets the predicted strength and angle to the Sun, in the half plane of the Sun and the measured field; without a Sun
    it keeps its direction. Samples in the shadow are dark; the light of the others stays as it was read. `calibration` (12): matrix
    and zero of the magnetometer, by which fields become readings.
    """
    dark = np.isfinite(readings.light) & (right.lit[0] < 0.5)
    readings = readings._replace(light=np.where(dark, 0.0, readings.light))
    if not np.isfinite(calibration).all():
        return readings
    sun, read_unit = readings.sun, calibrated_field(readings.field, calibration)
    read_unit /= np.linalg.norm(read_unit, axis=1, keepdims=True)
    across = read_unit - (read_unit * sun).sum(axis=1, keepdims=True) * sun
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    strength = right.strength[0][:, None]
    cosine = right.toward[0][:, None] / strength  # of the angle between field and Sun
    unit = cosine * sun + np.sqrt(1 - cosine**2) * across  # NaN without a Sun
    field = strength * np.where(np.isfinite(unit), unit, read_unit)
    matrix = calibration[MATRIX].reshape(3, 3)
    return readings._replace(field=np.linalg.solve(matrix, (field + calibration[ZERO]).T).T)


def _counts(readings: Readings) -> dict[str, int]:
    """Return how many samples show the field, the light, and the angle between field and Sun."""
    shows = {
        "field": readings.has_field,
        "light": np.isfinite(readings.light),
        "field and Sun": readings.has_angle,
    }
    return {what: int(which.sum()) for what, which in shows.items()}


def _with_magnetometer(
    answer: OrbitCheck,
    comparison: Comparison,
    at: Predicted,
    calibration: np.ndarray,
    lowest: float,
) -> OrbitCheck:
    """Return the answer with the magnetometer's calibration (12), its residuals, and whether its sign is the opposite one.

    `at`: predictions at the best offset. The sign is opposite in two cases: reversed readings cost clearly less than `lowest`; or
    the fitted matrix itself reverses them, and without that the angle to the Sun fits much worse.
    """
    readings = comparison.readings
    field = calibrated_field(readings.field, calibration)
    strength_residual, angle_residual = median_residuals(field, readings.sun, at)
    sign_turned = comparison.cost_of_opposite_field(at) < lowest - comparison.settings.clearly
    reverses = np.linalg.det(calibration[MATRIX].reshape(3, 3)) < 0
    if reverses and answer.verdict is not Verdict.REFUSED and readings.has_angle.sum() >= FEWEST:
        _, unreversed_residual = median_residuals(-field, readings.sun, at)
        sign_turned |= angle_residual < comparison.settings.mirrored * unreversed_residual
    return replace(
        answer,
        matrix=calibration[MATRIX].reshape(3, 3),
        zero=calibration[ZERO],
        strength_residual_T=strength_residual,
        angle_residual_rad=angle_residual,
        sign_turned=bool(sign_turned),
    )


def _with_few_angles(answer: OrbitCheck, comparison: Comparison, at: Predicted) -> OrbitCheck:
    """Return the answer with the residual of angles that are too few to refuse an orbit, and with the sign that they show.

    An orbit that fits is undecided if they are far off: with a clock that was an hour late the strengths of 45 samples fitted, and
    14 angles were off by 67 degrees. `comparison`: with all readings, angles included; `at`: predictions at the best offset.
    """
    readings = comparison.readings
    own = fit_at_offsets(readings, at, np.zeros(1))
    limit = own.cost[0] - comparison.settings.clearly
    opposite_is_better = comparison.cost_of_opposite_field(at) < limit
    field = calibrated_field(readings.field, own.calibration[0])
    verdict = answer.verdict
    if verdict is Verdict.FITS and contradicted(readings, at, own.calibration[0], FEW_ANGLES):
        verdict = Verdict.UNDECIDED
    return replace(
        answer,
        verdict=verdict,
        angle_residual_rad=median_residuals(field, readings.sun, at)[1],
        sign_turned=bool(opposite_is_better) and answer.verdict is not Verdict.REFUSED,
        samples=_counts(readings),
    )


def _with_sun_sensors(answer: OrbitCheck, orbit: Orbit, assessment: Assessment) -> OrbitCheck:
    """Return the answer with offset and calibration by a fit of magnetometer and Sun sensors together, if there are Sun sensors."""
    start = answer.start(orbit)
    if start is None or "sun_sensor_angle" not in assessment.telemetry:
        return answer
    readings = orbit_readings(assessment, MOST_SAMPLES)
    fitted = calibrate_with_sun_sensors(orbit, assessment.vehicle, readings, start)
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
        fitted_sensors=fitted,
    )


def _moments(shifts: np.ndarray, cost: np.ndarray) -> tuple[float, float]:
    """Return mean and sigma in s of the offset under the density exp(-cost), given at even offsets `shifts` (K)."""
    weight = np.exp(cost.min() - cost)
    weight /= weight.sum()
    mean = float(weight @ shifts)
    within_step = (shifts[1] - shifts[0]) ** 2 / 12  # variance of an even density over one step
    return mean, float(np.sqrt(weight @ (shifts - mean) ** 2 + within_step))
