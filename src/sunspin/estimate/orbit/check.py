"""Does this orbit belong to this telemetry? A check that needs no attitude.

Three things that a tumbling body sees do not depend on how it is turned: how strong the field is, the angle between field and Sun,
and whether the Sun is up. The orbit predicts all three up to its shift along the track; the magnetometer's zero and its matrix
(scale, soft iron, axes) are fitted with the shift, so that a badly calibrated sensor is no reason to refuse an orbit. The same is
fitted to copies of the orbit, its node and phase turned at random. Elements that are right predict better than nearly all copies;
the rank among them is the answer, and how clearly the copies differ from the orbit in these data says whether there is one.
Elements are refused without that rank if samples with clear Sun lie in the Earth's shadow (:mod:`sunspin.estimate.orbit.shadow`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.special import erfc

from sunspin.environment.orbit import Orbit
from sunspin.estimate.orbit.invariants import (
    FEWEST,
    Fits,
    Predicted,
    Seen,
    angles,
    axes_words,
    contradicted,
    fit,
    predict,
    predicted_angles,
    seen_in,
    turned_axes,
)
from sunspin.estimate.orbit.sensor_calibration import Calibration, Start, by_sun_sensors
from sunspin.estimate.orbit.shadow import SunInShadow, sun_in_shadow
from sunspin.estimate.wiring import axes_matrix
from sunspin.telemetry.assess import Assessment, assess
from sunspin.vehicle import Vehicle

COPIES = 50
BETTER = 1
"""Copies that may predict better: right elements are refused once in 50 times at most."""

TURNS_DEG = (-24.0, -12.0, -6.0, -3.0, 3.0, 6.0, 12.0, 24.0)
TIMES = 1.3
"""Turns of the node beside the copies; elements are refused too if one of them makes residuals so many times smaller. On skCUBE,
whose plane is known, some of them do by 1.05: a sensor's own errors."""

SPAN, STEP_S, MOST_STEPS = 3.0, 20.0, 37
"""The shift is sought within so many sigmas, in such steps; a wider span has wider steps."""

MISTAKEN = 0.2
"""If more copies than this are expected to win by chance against right elements, the data cannot rank."""

NEAR = 60.0
"""A copy is fitted at a third of the shifts first, and at all of them where its cost comes so near to the one that counts."""

MOST_SCATTER = np.array([0.1, 3.0])
"""Noise that is believed, where no orbit fits: of strength, as a part of it, and in sigmas of the Sun."""

HOURS, CLEARLY = range(-12, 15), 12.0
"""Errors of a clock that are tried, those of time zones; and by how much (in log likelihood) one must fit better."""

ROUND = 0.5
"""A field of the wrong sign is named where, turned round, its angle to the Sun is left off by less than this part."""

FINE, DEEP = 33, 10.0
"""The shift is found among so many steps, between the ends of what costs no more than this above the least: all minima count."""

BLOCKS, AROUND, BESIDE = 8, 9, 3.0
"""Parts of the file that are left out in turn, with so many steps of the shift within so many sigmas."""

FEW = 1.15
"""By so much a sigma from so few parts is too small for 90 % to lie within 1.645 of it: Student's law, 7 degrees of freedom."""


class Verdict(Enum):
    """What the rank says; the values are the sentences."""

    FITS = "elements consistent with the telemetry"
    REFUSED = "elements not consistent with the telemetry; not used"
    UNDECIDED = "inconclusive: this telemetry cannot distinguish the elements from random ones; the along-track prior is unchanged"


@dataclass(frozen=True)
class OrbitCheck:
    """The answer: `better` copies of `copies` predict better; residuals are medians; `calibration`: field (T) = matrix reading -
    zero, None without magnetometer. With the node turned by `turn_rad` residuals are `turn_times` smaller. `eclipse` counts
    samples that show the Sun in the predicted shadow, and all there. `clock_behind_s`: what would make the elements fit, 0 where
    nothing does. `sign_turned`: the field read with the opposite sign fits clearly better to the Sun. `turned_axes`: by which
    reading of its columns the magnetometer fits the Sun where as stated it does not, in words; else empty. The shift is that in the
    middle of the telemetry; its drift is found where Sun sensors are, by the fit `made`, else it stays as it was."""

    shift_s: float
    shift_sigma_s: float
    verdict: Verdict = Verdict.UNDECIDED
    better: int = 0
    copies: int = 0
    mistaken: float = float(COPIES)
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
    """Samples with clear Sun that contradict the orbit at every offset within the prior."""


def check_orbit(
    orbit: Orbit, vehicle: Vehicle, telemetry: xr.Dataset | Assessment, *, seed: int = 0
) -> OrbitCheck:
    """Rank an orbit against comparison orbits of random node and phase, by what the telemetry shows at any attitude.

    Every orbit's shift is sought within three sigmas of its prior (those of shift and clock together), and counts that prior.
    """
    assessment = assess(vehicle, telemetry)
    shown, grid = seen_in(assessment), _Grid.of(orbit)
    both = int(np.isfinite(shown.field + shown.sun).all(axis=1).sum())
    seen = (
        shown if both >= FEWEST else shown._replace(sun=np.full_like(shown.sun, np.nan))
    )  # so few angles judge no orbit
    if not len(seen.t_s):
        return OrbitCheck(
            orbit.shift_s,
            float(np.hypot(orbit.shift_sigma_s, orbit.clock_sigma_s)),
            drift_s_day=orbit.drift_s_day,
            drift_sigma_s_day=orbit.drift_sigma_s_day,
        )
    rng = np.random.default_rng(seed)
    turns = zip(
        rng.uniform(0, 2 * np.pi, COPIES),
        rng.uniform(0, orbit.elements[0].period_s, COPIES),
        strict=True,
    )
    here = predict(orbit, seen, grid.shifts)
    own = fit(seen, here, grid.prior)
    way = (
        None
        if "sun_sensor_angle" in assessment.telemetry
        else turned_axes(seen, here.take([own.cost.argmin()]))
    )
    if (
        way is not None
    ):  # what follows is of the readings as they are if the vehicle file names their axes rightly
        seen = seen._replace(field=seen.field @ axes_matrix(*way[1:]).T)
        own = fit(seen, here, grid.prior)
    copies = [predict(orbit, seen, grid.shifts, *one) for one in turns]
    fits = [_nearly(seen, copy, grid.prior, float(own.cost.min())) for copy in copies]
    turn, times = _turned(orbit, seen, grid, own)
    better = sum(fit.cost.min() <= own.cost.min() for fit in fits)
    best = min([own, *fits], key=lambda fit: fit.cost.min())
    mistaken = _mistaken(seen, here.take([own.cost.argmin()]), copies, best, grid.prior)
    enough = max(np.isfinite(seen.field).all(axis=1).sum(), np.isfinite(seen.light).sum()) >= FEWEST
    verdict = Verdict.REFUSED if better > BETTER or times > TIMES else Verdict.FITS
    k = int(own.cost.argmin())
    against = verdict is Verdict.FITS and contradicted(seen, here.take([k]), own.calibration[k])
    verdict = verdict if enough and mistaken <= MISTAKEN and not against else Verdict.UNDECIDED
    contradiction = sun_in_shadow(orbit, assessment, SPAN)
    if contradiction.samples:  # no other orbit need fit better: this one is wrong, or the clock is
        verdict = Verdict.REFUSED
    lowest = float((best if verdict is Verdict.REFUSED else own).cost.min())
    answer = _answer(
        orbit, seen, grid, here, own, verdict, (int(better), mistaken), (turn, times), lowest
    )
    answer = replace(answer, sun_in_shadow=contradiction)
    if 0 < both < FEWEST and answer.matrix is not None:
        answer = _with_few_angles(answer, shown, here.take([k]), grid.prior[[k]])
    if way is not None and answer.matrix is not None and verdict is not Verdict.REFUSED:
        words = axes_words(way, assessment)
        answer = replace(answer, matrix=answer.matrix @ axes_matrix(*way[1:]), turned_axes=words)
    if verdict is Verdict.FITS:
        return _with_sun_sensors(answer, orbit, assessment)
    return replace(answer, clock_behind_s=_clock_behind(orbit, seen, grid, best.cost.min()))


class _Grid(NamedTuple):
    """Shifts (K) s beside the orbit's own, their cost by the prior (K), and one sigma of that, s."""

    shifts: np.ndarray
    prior: np.ndarray
    along: float = 1.0

    @classmethod
    def of(cls, orbit: Orbit) -> _Grid:
        along = float(np.hypot(orbit.shift_sigma_s, orbit.clock_sigma_s))
        half = int(np.clip(np.ceil(SPAN * along / STEP_S), 3, MOST_STEPS // 2))
        return cls(np.zeros(0), np.zeros(0), along).at(
            SPAN * along / half * np.arange(-half, half + 1)
        )

    def at(self, shifts: np.ndarray) -> _Grid:
        """The same prior at other shifts."""
        return self._replace(shifts=shifts, prior=(shifts / self.along) ** 2 / 2)


# ------------------------------------------------------------------------------------------------------------------------ judging


def _nearly(
    seen: Seen, copy: Predicted, prior: np.ndarray, reach: float, scatter: np.ndarray | None = None
) -> Fits:
    """A copy's fits: at every third shift, and at all where one of those comes near the cost that would win."""
    some = slice(1, None, 3)
    coarse = fit(seen, copy.take(some), prior[some], scatter)
    return coarse if coarse.cost.min() > reach + NEAR else fit(seen, copy, prior, scatter)


def _turned(orbit: Orbit, seen: Seen, grid: _Grid, own: Fits) -> tuple[float, float]:
    """The turn of the node (rad), among some, with which the orbit fits best, and how many times smaller residuals are then; (0, 1)
    where none fits better."""
    field = np.isfinite(seen.field).all(axis=1)
    if field.sum() < FEWEST:
        return 0.0, 1.0
    turned = [predict(orbit, seen, grid.shifts, turn) for turn in np.radians(TURNS_DEG)]
    costs = [_nearly(seen, one, grid.prior, np.inf).cost.min() for one in turned]
    gain = (own.cost.min() - min(costs)) / (
        field.sum() + (field & np.isfinite(seen.sun).all(axis=1)).sum()
    )
    return (
        (float(np.radians(TURNS_DEG)[np.argmin(costs)]), float(np.exp(gain)))
        if gain > 0
        else (0.0, 1.0)
    )


def _clock_behind(orbit: Orbit, seen: Seen, grid: _Grid, lowest: float) -> float:
    """By how many s the telemetry's clock is behind UTC if it is off by whole hours and the elements are right: what fits best,
    where it fits clearly better than the orbit and all its copies; else 0."""
    clocks = [replace(orbit, clock_s=orbit.clock_s + 3600.0 * hours) for hours in HOURS if hours]
    costs = [
        _nearly(seen, predict(other, seen, grid.shifts), grid.prior, lowest).cost.min()
        for other in clocks
    ]
    return (
        clocks[int(np.argmin(costs))].clock_s - orbit.clock_s
        if min(costs) < lowest - CLEARLY
        else 0.0
    )


def _mistaken(
    seen: Seen, right: Predicted, copies: list[Predicted], best: Fits, prior: np.ndarray
) -> float:
    """How many copies are expected to predict better than this orbit if it is right, by the noise that the best
    of all orbits leaves.

    Data without noise, as the orbit predicts them, are fitted by every copy; what a copy leaves of them is the mean of the D by
    which its cost is higher, and noise of the data makes that D +- sqrt(2 D).
    """
    k = int(best.cost.argmin())
    clean, scatter = (
        _as_predict(seen, right, best.calibration[k]),
        np.minimum(best.scatter[k], MOST_SCATTER),
    )
    zero = float(fit(clean, right, np.zeros(1), scatter).cost[0])
    higher = np.array(
        [_nearly(clean, copy, prior, zero, scatter).cost.min() - zero for copy in copies]
    )
    return float((erfc(np.sqrt(np.maximum(higher, 0)) / 2) / 2).sum())


def _as_predict(seen: Seen, right: Predicted, calibration: np.ndarray) -> Seen:
    """The samples as they would be if the orbit were right and nothing had noise: the field of the predicted strength and angle
    to the Sun, in the half plane where it was read; dark in the predicted shadow."""
    light = np.where(np.isfinite(seen.light) & (right.lit[0] < 0.5), 0.0, seen.light)
    if not np.isfinite(calibration).all():
        return seen._replace(light=light)
    matrix, zero = calibration[:9].reshape(3, 3), calibration[9:]
    unit = seen.field @ matrix.T - zero
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    strength = right.strength[0][:, None]
    across = unit - (unit * seen.sun).sum(axis=1, keepdims=True) * seen.sun
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    cosine = right.to_sun[0][:, None] / strength
    turned_to = cosine * seen.sun + np.sqrt(1 - cosine**2) * across
    field = strength * np.where(np.isfinite(turned_to), turned_to, unit)
    return seen._replace(
        field=np.linalg.solve(matrix, (field + zero)[..., None])[..., 0], light=light
    )


def _answer(
    orbit: Orbit,
    seen: Seen,
    grid: _Grid,
    here: Predicted,
    own: Fits,
    verdict: Verdict,
    rank: tuple[int, float],
    beside: tuple[float, float],
    lowest: float,
) -> OrbitCheck:
    """What is told of a verdict; `lowest`: the cost that a field of the opposite sign must be clearly below to be named."""
    shift, sigma, at_border = _shift(orbit, seen, grid, own)
    k = int(own.cost.argmin())
    dark, shadow = seen.light == 0, here.lit[k] < 0.5
    known = np.isfinite(seen.light)
    calibrated = bool(np.isfinite(own.calibration[k]).all())
    strength, angle = (
        _left(seen, here.take([k]), own.calibration[k]) if calibrated else (np.nan, np.nan)
    )
    opposite = fit(seen._replace(field=-seen.field), here.take([k]), grid.prior[[k]])
    sign_turned = bool(opposite.cost[0] < lowest - CLEARLY)
    sign_turned |= (
        verdict is not Verdict.REFUSED
        and calibrated
        and _mirrored(seen, here.take([k]), own.calibration[k])
    )
    return OrbitCheck(
        drift_s_day=orbit.drift_s_day,
        drift_sigma_s_day=orbit.drift_sigma_s_day,
        verdict=verdict,
        better=rank[0],
        copies=COPIES,
        mistaken=rank[1],
        turn_rad=beside[0],
        turn_times=beside[1],
        sign_turned=sign_turned,
        shift_s=orbit.shift_s + shift,
        shift_sigma_s=sigma,
        border=at_border,
        strength_residual_T=strength,
        angle_residual_rad=angle,
        samples={
            "field": int(np.isfinite(seen.field).all(axis=1).sum()),
            "light": int(known.sum()),
            "field and Sun": int(np.isfinite(seen.field + seen.sun).all(axis=1).sum()),
        },
        eclipse=(int((known & shadow & ~dark).sum()), int((known & shadow).sum())),
        matrix=own.calibration[k][:9].reshape(3, 3) if calibrated else None,
        zero=own.calibration[k][9:] if calibrated else None,
    )


def _with_few_angles(
    answer: OrbitCheck, shown: Seen, here: Predicted, prior: np.ndarray
) -> OrbitCheck:
    """The answer with the angle between field and Sun of samples too few to judge an orbit, and the sign that they show."""
    as_read, opposite = (
        fit(shown, here, prior),
        fit(shown._replace(field=-shown.field), here, prior),
    )
    clearly = bool(opposite.cost[0] < as_read.cost[0] - CLEARLY)
    return replace(
        answer,
        angle_residual_rad=_left(shown, here, as_read.calibration[0])[1],
        sign_turned=clearly and answer.verdict is not Verdict.REFUSED,
        samples=answer.samples
        | {"field and Sun": int(np.isfinite(shown.field + shown.sun).all(axis=1).sum())},
    )


def _with_sun_sensors(answer: OrbitCheck, orbit: Orbit, assessment: Assessment) -> OrbitCheck:
    """The answer with shift and calibration of the fit that counts biases and scales of Sun sensors, where there are any."""
    start = start_of(answer, orbit)
    made = None if start is None else by_sun_sensors(orbit, assessment, start)
    if made is None:
        return answer
    return replace(
        answer,
        shift_s=orbit.shift_s + made.shift_s,
        shift_sigma_s=made.shift_sigma_s,
        made=made,
        drift_s_day=orbit.drift_s_day + made.drift_s_day,
        drift_sigma_s_day=made.drift_sigma_s_day,
        matrix=made.matrix_T,
        zero=made.matrix_T @ made.zero,
        strength_residual_T=float(made.strength[1]),
        angle_residual_rad=float(made.angle[1]),
    )


def start_of(found: OrbitCheck, orbit: Orbit) -> Start | None:
    """Where a fit with Sun sensors may begin; None where the check has not calibrated a magnetometer."""
    if found.matrix is None or found.zero is None:
        return None
    return Start(found.matrix, found.zero, found.shift_s - orbit.shift_s, found.strength_residual_T)


def _left(seen: Seen, there: Predicted, calibration: np.ndarray) -> tuple[float, float]:
    """Medians of what is left of the field's strength (T) and of its angle to the Sun (rad), NaN where no sample shows both."""
    field = seen.field @ calibration[:9].reshape(3, 3).T - calibration[9:]
    size = np.linalg.norm(field, axis=1)
    both = [angles(field, seen.sun), predicted_angles(there)]
    angle = float(np.nanmedian(np.abs(both[0] - both[1]))) if np.isfinite(both[0]).any() else np.nan
    return float(np.nanmedian(np.abs(size - there.strength[0]))), angle


def _mirrored(seen: Seen, there: Predicted, calibration: np.ndarray) -> bool:
    """Whether a calibration turns the readings round, and by this their angle to the Sun fits that else would not."""
    if (
        np.linalg.det(calibration[:9].reshape(3, 3)) > 0
        or np.isfinite(seen.field + seen.sun).all(axis=1).sum() < FEWEST
    ):
        return False
    return _left(seen, there, calibration)[1] < ROUND * _left(seen, there, -calibration)[1]


def _shift(orbit: Orbit, seen: Seen, grid: _Grid, own: Fits) -> tuple[float, float, bool]:
    """The shift beside the orbit's own, its sigma, and whether it lies at the border of what was tried.

    Mean and sigma are those of the density that falls with the cost, all minima counted. The sigma is at least what leaving out
    each eighth of the file changes (jackknife): calibration drifts, and a pass of beacons errs as one.
    """
    k, step = int(own.cost.argmin()), grid.shifts[1] - grid.shifts[0]
    deep = grid.shifts[own.cost < own.cost.min() + DEEP]
    fine = grid.at(np.linspace(deep.min() - step, deep.max() + step, FINE))
    mean, sigma = _lowest(
        fine.shifts, fit(seen, predict(orbit, seen, fine.shifts), fine.prior).cost
    )
    near = grid.at(mean + sigma * np.linspace(-BESIDE, BESIDE, AROUND))
    part, found = predict(orbit, seen, near.shifts), []
    blocks = np.array_split(np.arange(len(seen.t_s)), BLOCKS)
    for block in blocks if len(seen.t_s) >= BLOCKS * FEWEST / 2 else ():
        rest = np.setdiff1d(np.arange(len(seen.t_s)), block)
        some = Seen(*(each[rest] for each in seen))
        cost = fit(some, Predicted(*(each[:, rest] for each in part)), near.prior).cost
        found.append(_lowest(near.shifts, cost)[0])
    if found:
        apart = float(
            np.sqrt((BLOCKS - 1) / BLOCKS * ((np.array(found) - np.mean(found)) ** 2).sum())
        )
        sigma = max(sigma, FEW * apart)
    return mean, sigma, k < 2 or k > len(grid.shifts) - 3


def _lowest(shifts: np.ndarray, cost: np.ndarray) -> tuple[float, float]:
    """Mean and sigma of the shift under the density that falls with the cost."""
    weight = np.exp(cost.min() - cost)
    weight /= weight.sum()
    mean = float(weight @ shifts)
    return mean, float(np.sqrt(weight @ (shifts - mean) ** 2 + (shifts[1] - shifts[0]) ** 2 / 12))
