"""Philae before its first touchdown: a cubic rate about z fitted to the directions of the Sun (paper, section 3.1, Figs. 10, 11).

The samples that the folded legs spoil are recognised by their Delta (`clean_from`); the end is the published span of the fit,
or the touchdown if that comes first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from sunspin.base.errors import TelemetryError
from sunspin.estimate.scan.mask import allows, reconstructible_mask
from sunspin.estimate.scan.metrics import direction_error
from sunspin.estimate.spin import SpinFit, error_of_rate, errors_of_rates, fit_spin
from sunspin.philae.rebound import case_seconds
from sunspin.philae.row import Row, row
from sunspin.telemetry.case import Case
from sunspin.telemetry.sun import SunStatus, is_reconstructed

DELTA_SIGMAS = 4.0
"""A sample counts as spoiled if its Delta exceeds this many times the robust sigma of all Deltas: for Philae that lies between
what the paper has before the legs unfolded (0.1 to 0.2) and the largest after (0.07)."""

LEAST_RUN = 2
"""Spoiled samples must outnumber good ones by this in a run at the beginning before it is taken as one."""

MAD_TO_SIGMA = 1.4826
"""Sigma over the median of the absolute value, for a Gaussian: four lit panels leave one degree of freedom."""

FACTOR_OF_E = 2.0
"""An E put in comes back where it is within this factor of the published one: it is the mean of seeds that is put in."""

CUBIC_CHI2 = 16.25
"""Chi-square with four degrees that is exceeded with probability 0.0027, as three sigma are with one."""


@dataclass(frozen=True)
class Descent:
    """The descent's samples (`sun`, time in s from the first of them) and the fit.

    Attributes
    ----------
    case : Case
    sun : Dataset of `sun_directions` on the samples of the fit
    number : (first, last), counted from 1 in the telemetry
    delta_limit : Delta above which a sample counts as spoiled
    fit : SpinFit
    simulated_B : (n, 3) fitted directions at every sample, whether it was reconstructed or not
    predicted : (n,) whether the fitted direction is one that the panels allow to reconstruct
    published_E : E of the published cubic on these samples, direction at the start chosen best
    first_direction_E : E of the fit when the Sun starts at the first measured direction instead of the best one
    omega_0, slice_E : (n,) constant term of the rate (rad/s), and E with the other three coefficients of the fit (Fig. 11)
    """

    case: Case
    sun: xr.Dataset
    number: tuple[int, int]
    delta_limit: float
    fit: SpinFit
    simulated_B: np.ndarray
    predicted: np.ndarray
    published_E: float
    first_direction_E: float
    omega_0: np.ndarray
    slice_E: np.ndarray

    @property
    def told(self) -> np.ndarray:
        """Which samples (n) gave a direction."""
        return is_reconstructed(self.sun["status"])

    @property
    def synthetic(self) -> bool:
        return bool(self.sun.attrs.get("synthetic"))

    def rate_range(self, coefficients: np.ndarray | None = None) -> tuple[float, float]:
        """Smallest and largest rate (rad/s) over the fitted window, of the fit or of other coefficients."""
        t = np.linspace(0.0, float(self.sun["time"].values[-1]), 2001)
        chosen = self.fit.coefficients if coefficients is None else coefficients
        rate = np.polynomial.polynomial.polyval(t, chosen)
        return float(rate.min()), float(rate.max())


def delta_limit(sun: xr.Dataset) -> float:
    """Delta above which a sample does not fit whole, unshadowed panels: four robust sigma of all that redundancy checks."""
    checked = sun["delta"].values[sun["status"].values == SunStatus.OK]
    if checked.size < 2 * LEAST_RUN:
        raise TelemetryError(
            "too few samples with more than three lit panels to tell what Delta is usual",
            got=f"{checked.size}",
        )
    return DELTA_SIGMAS * MAD_TO_SIGMA * float(np.median(checked))


def clean_from(sun: xr.Dataset) -> int:
    """Index of the first sample after a run of spoiled ones at the beginning; 0 if there is none.

    The rule: of the samples whose Delta checks something (more than three lit panels) those above `delta_limit` count +1
    and the others -1; the run is the beginning with the largest sum, if that is at least `LEAST_RUN`. What follows counts
    as clean from the next sample that Delta has checked and found good: those between can be neither accused nor cleared.
    """
    checked = np.flatnonzero(sun["status"].values == SunStatus.OK)
    votes = np.cumsum(np.where(sun["delta"].values[checked] > delta_limit(sun), 1, -1))
    end = int(np.argmax(votes))
    if votes[end] < LEAST_RUN:
        return 0
    if end + 1 == checked.size:
        raise TelemetryError(
            "no sample is clean: Delta is large to the end", do="check the panels' gains and names"
        )
    return int(checked[end + 1])


def compute(case: Case, sun: xr.Dataset) -> Descent:
    """Recognise the clean samples of the descent in `sun` (of `sun_directions`, whole landing) and fit the cubic rate."""
    touchdown = case_seconds(case, sun, "first_touchdown")
    before = sun.isel(time=np.flatnonzero(sun["time"].values < touchdown))
    if before.sizes["time"] == 0:
        raise TelemetryError(
            "no sample before the first touchdown", do="check the times of the telemetry"
        )
    first = clean_from(before)
    time = before["time"].values - before["time"].values[first]
    interval = float(np.median(np.diff(time)))
    span = (
        3600.0 * case.published["descent_span"].value + interval / 2
    )  # published to 0.1 h, about two intervals
    part = before.isel(time=np.flatnonzero((time >= 0) & (time <= span)))
    part = part.assign_coords(time=part["time"] - part["time"].values[0])
    t, n = part["time"].values, part["sun_B"].values
    fit = fit_spin(t, n)
    known = np.isfinite(n[:, 0])
    simulated = fit.directions(t)
    published = np.array(case.published["descent_rate_cubic"].value)
    omega_0 = np.unique(
        np.concatenate(
            [np.linspace(fit.scan_rate[0], fit.scan_rate[-1], 8001), fit.coefficients[:1]]
        )
    )
    rates = np.column_stack([omega_0, np.tile(fit.coefficients[1:], (omega_0.size, 1))])
    return Descent(
        case,
        part,
        (first + 1, first + int(part.sizes["time"])),
        delta_limit(before),
        fit,
        simulated,
        allows(reconstructible_mask(case.vehicle), simulated),
        error_of_rate(published, t[known], n[known]),
        float(direction_error(replace(fit, sun_B=n[0]).directions(t), n)),
        omega_0,
        errors_of_rates(rates, t[known], n[known]),
    )


def implied_wheel_change(case: Case, rate_change_rad_s: float) -> float:
    """Change of the wheel's speed (rad/s, relative to the body) that changes the body's rate about the wheel by this much.

    Without external torque Theta_uu omega + J W stays (paper, eq. 3, for spin about the axis u of the only wheel).
    """
    wheel = case.vehicle.wheels[0]
    inertia = float(wheel.axis_B @ case.vehicle.require_inertia() @ wheel.axis_B)
    return -inertia * rate_change_rad_s / wheel.inertia_kg_m2


def rows(result: Descent) -> list[Row]:
    """Published figures of section 3.1 beside ours."""
    return [*_fit_rows(result), *_rate_rows(result), *_sample_rows(result)]


def _twin(result: Descent) -> str:
    return "synthetic telemetry, made with the published cubic; " if result.synthetic else ""


def _put_in(result: Descent) -> str:
    made = (
        "synthetic telemetry: its panels stand off by angles chosen so that the mean E of twenty seeds is as published; "
        f"that of one comes back if within a factor of {FACTOR_OF_E:g}; "
    )
    return made if result.synthetic else ""


def _fit_rows(r: Descent) -> list[Row]:
    case, fit = r.case, r.fit
    published = np.array(case.published["descent_rate_cubic"].value)
    off = fit.coefficients - published
    distance = float(off @ np.linalg.solve(fit.covariance, off))
    flown_E = float(case.published["descent_E"].value)
    rms, meant = (float(np.degrees(2 * np.sqrt(E))) for E in (fit.E, flown_E))
    back = 1 / FACTOR_OF_E <= fit.E / flown_E <= FACTOR_OF_E if r.synthetic else None
    return [
        row(
            case,
            "descent_E",
            fit.E,
            holds=back,
            twin=_put_in(r),
            rms=rms,
            meant=meant,
            first_E=r.first_direction_E,
        ),
        row(
            case,
            "descent_rate_cubic",
            fit.coefficients.tolist(),
            published=published.tolist(),
            tolerance=(np.sqrt(CUBIC_CHI2) * fit.sigma).tolist(),
            agrees=bool(distance <= CUBIC_CHI2),
            twin=_twin(r),
            distance=distance,
            asked=CUBIC_CHI2,
            sigmas=_digits(fit.sigma),
            printed_E=r.published_E,
            rounding=0.5e-5 * float(r.sun["time"].values[-1]),
        ),
        row(
            case,
            "descent_unique",
            fit.unique,
            agrees=fit.unique,
            minima=len(fit.aliases),
            within=fit.scan_rate[-1],
            second=fit.aliases[1] if len(fit.aliases) > 1 else np.array([np.nan, np.nan]),
            gap=fit.alias_gap,
        ),
    ]


def _digits(values: np.ndarray) -> str:
    return "[" + ", ".join(f"{value:.1e}" for value in values) + "]"


def _rate_rows(r: Descent) -> list[Row]:
    case, ours = r.case, r.rate_range()
    printed = r.rate_range(np.array(case.published["descent_rate_cubic"].value))
    t = np.linspace(0.0, float(r.sun["time"].values[-1]), 2001)
    change = abs(implied_wheel_change(case, ours[1] - ours[0]))
    nominal = case.vehicle.wheels[0].speed_rad_s
    found = [
        row(case, "descent_rate_range", list(ours), twin=_twin(r), printed=printed),
        row(case, "descent_rate_romap", float(r.fit.rate(t).mean()), twin=_twin(r)),
    ]
    if nominal == 0:  # what changes by what part of nothing?
        return found
    return [
        *found,
        row(
            case,
            "descent_wheel_speed",
            100 * change / abs(nominal),
            twin=_twin(r),
            change=change,
            nominal=nominal,
        ),
    ]


def _sample_rows(r: Descent) -> list[Row]:
    case, z, dark = r.case, r.sun["sun_B"].values[r.told, 2], ~r.told
    agreed = float(np.mean(r.predicted == r.told))
    return [
        row(case, "descent_samples", list(r.number), limit=r.delta_limit),
        row(case, "nz_descent", float(z.mean()), twin=_twin(r), spread=z.std()),
        row(
            case,
            "descent_behind",
            agreed,
            agrees=agreed >= 0.95,
            dark_right=int((dark & ~r.predicted).sum()),
            dark=int(dark.sum()),
            told_right=int((r.told & ~r.predicted).sum()),
            told=int(r.told.sum()),
        ),
    ]
