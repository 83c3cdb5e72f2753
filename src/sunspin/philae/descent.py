"""Philae before its first touchdown: a cubic rate about z fitted to the Sun directions (paper, section 3.1, Figs. 10, 11).

Samples that the folded legs disturb are recognised by their Delta (`find_first_clean_sample`). The fit ends after the published
time span, or at the touchdown if that comes first.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.polynomial.polynomial import polyval

from sunspin.base.errors import TelemetryError
from sunspin.cases import Case
from sunspin.estimate.scan.directions import reconstructible_mask
from sunspin.output.figures import COLOURS, empty_figure, titled
from sunspin.philae.rebound import event_seconds
from sunspin.philae.row import Row, make_row
from sunspin.philae.spin import SpinFit, error_of_rate, errors_of_rates, fit_spin
from sunspin.telemetry.sun import SunStatus, is_reconstructed

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DELTA_SIGMAS = 4.0
"""A sample is an outlier if its Delta exceeds this many robust sigma of all Deltas. For Philae this limit lies between the values
of the paper before the legs unfolded (0.1 to 0.2) and the largest one after it (0.07).
"""

MIN_RUN_EXCESS = 2
"""Least number by which outliers exceed good samples in the disturbed part at the beginning."""

E_FACTOR = 2.0
"""Largest ratio between E of synthetic telemetry and the published E. The telemetry has the published E in the mean over seeds
only.
"""

CUBIC_CHI2 = 16.25
"""Chi-square with four degrees of freedom that is exceeded with probability 0.0027, as three sigma are with one."""


class Descent(NamedTuple):
    """Samples of the descent (`sun`, of `sun_directions`, time in s from the first of them) and the fitted spin.

    `number`: first and last sample, counted from 1 in the telemetry. `delta_limit`: Delta above which a sample is an outlier.
    `fitted_B` (n, 3): fitted direction at every sample, measured or not. `in_view` (n): whether the panels allow to reconstruct it.
    """

    case: Case
    sun: xr.Dataset
    number: tuple[int, int]
    delta_limit: float
    fit: SpinFit
    fitted_B: np.ndarray
    in_view: np.ndarray

    def rate_range(self, coefficients: np.ndarray) -> tuple[float, float]:
        """Return the smallest and largest rate (rad/s) of a cubic with these coefficients over the fitted time span."""
        rate = polyval(np.linspace(0.0, float(self.sun["time"].values[-1]), 2001), coefficients)
        return float(rate.min()), float(rate.max())


def find_first_clean_sample(sun: xr.Dataset) -> tuple[int, float]:
    """Return the index of the first sample after a run of outliers at the beginning, and the limit of Delta.

    The index is 0 if there is no such run. Only samples with more than three lit panels are judged, as Delta of the others is zero.
    Those above the limit count +1, the others -1. The run ends where the cumulative sum is largest, if that sum is at least
    `MIN_RUN_EXCESS`. The next judged sample is the first clean one; samples without a judgement before it are left out.

    Raises
    ------
    TelemetryError
        Too few samples can be judged, or all of them are outliers.
    """
    checked = np.flatnonzero(sun["status"].values == SunStatus.OK)
    delta = sun["delta"].values[checked]
    if delta.size < 2 * MIN_RUN_EXCESS:
        what = "too few samples with more than three lit panels to tell what Delta is usual"
        raise TelemetryError(what, got=f"{delta.size}")
    # sigma of a Gaussian from the median of its absolute value: four lit panels leave one degree of freedom
    limit = DELTA_SIGMAS * 1.4826 * float(np.median(delta))
    excess = np.cumsum(np.where(delta > limit, 1, -1))  # outliers minus good samples so far
    last_outlier = int(np.argmax(excess))
    if excess[last_outlier] < MIN_RUN_EXCESS:
        return 0, limit
    if last_outlier + 1 == checked.size:
        what = "no sample is clean: Delta is large to the end"
        raise TelemetryError(what, do="check the panels' gains and names")
    return int(checked[last_outlier + 1]), limit


def compute(case: Case, sun: xr.Dataset) -> Descent:
    """Select the clean samples of the descent in `sun` (of `sun_directions`, whole landing) and fit the cubic rate.

    Raises `TelemetryError` if there is no sample before the touchdown, or no clean one (`find_first_clean_sample`).
    """
    touchdown = event_seconds(case, sun, "first_touchdown")
    before = sun.isel(time=np.flatnonzero(sun["time"].values < touchdown))
    if before.sizes["time"] == 0:
        what, do = "no sample before the first touchdown", "check the times of the telemetry"
        raise TelemetryError(what, do=do)
    first, limit = find_first_clean_sample(before)
    time = before["time"].values - before["time"].values[first]
    # the span is published to 0.1 h, about two intervals: half an interval is added, so that its last sample is inside
    span_s = 3600.0 * case.published["descent_span"].value + float(np.median(np.diff(time))) / 2
    samples = before.isel(time=np.flatnonzero((time >= 0) & (time <= span_s)))
    samples = samples.assign_coords(time=samples["time"] - samples["time"].values[0])
    t = samples["time"].values
    fit = fit_spin(t, samples["sun_B"].values)
    fitted, number = fit.directions(t), (first + 1, first + len(t))
    in_view = reconstructible_mask(case.vehicle).contains(fitted)
    return Descent(case, samples, number, limit, fit, fitted, in_view)


def rows(descent: Descent) -> list[Row]:
    """Return the published figures of section 3.1 compared with ours."""
    case, fit, sun = descent.case, descent.fit, descent.sun
    t, n, seen = sun["time"].values, sun["sun_B"].values, is_reconstructed(sun["status"])
    synthetic = bool(sun.attrs.get("synthetic"))
    paper = {key: figure.value for key, figure in case.published.items()}
    # E is the mean of sin^2(angle / 2), so the rms angle is about 2 sqrt(E)
    rms, published_rms = (float(np.degrees(2 * np.sqrt(E))) for E in (fit.E, paper["descent_E"]))
    # synthetic telemetry was made to have the published E, so that agreement is expected and no test
    holds = 1 / E_FACTOR <= fit.E / paper["descent_E"] <= E_FACTOR
    E_note = f"{rms:.1f} deg rms, published {published_rms:.1f} deg"
    if synthetic:
        back = f"that of one comes back within a factor of {E_FACTOR:g}"
        E_note += f"; misaligned so that the mean E of twenty seeds is as published: {back}"

    # squared distance of the fitted coefficients from the published ones, in their covariance
    cubic = np.array(paper["descent_rate_cubic"])
    difference = fit.coefficients - cubic
    distance = float(difference @ np.linalg.solve(fit.covariance, difference))
    within: dict[str, Any] = {"tolerance": (np.sqrt(CUBIC_CHI2) * fit.sigma).tolist()}
    within["agrees"] = bool(distance <= CUBIC_CHI2)
    sigmas = ", ".join(f"{sigma:.1e}" for sigma in fit.sigma)
    printed_E = error_of_rate(cubic, t[seen], n[seen])
    printed_low, printed_high = descent.rate_range(cubic)
    # `aliases` (n, 2): mean rate and E of each minimum of E, the best first
    second_rate, second_E = fit.aliases[1] if len(fit.aliases) > 1 else (np.nan, np.nan)
    low, high = descent.rate_range(fit.coefficients)
    mean_rate = float(fit.rate(np.linspace(0, t[-1], 2001)).mean())
    # the fit predicts which samples give a direction: those whose Sun is in view of three panels
    z, agreed = n[seen, 2], float(np.mean(descent.in_view == seen))
    dark_right, lit_right = (~seen & ~descent.in_view).sum(), (seen & descent.in_view).sum()
    notes = {
        "descent_E": E_note,
        "descent_rate_cubic": f"criterion: chi-square of the difference {distance:.1f} (4 degrees of freedom) at most "
        f"{CUBIC_CHI2:g}; sigma [{sigmas}]; E of the printed cubic {printed_E:.5f}",
        "descent_unique": f"of {len(fit.aliases)} minima within {fit.scan_rate[-1]:.3f} rad/s the next has E {second_E:.4f} at "
        f"{second_rate:.4f} rad/s, chi-square {fit.alias_gap:.0f} more",
        "descent_rate_range": f"the printed coefficients themselves give {printed_low:.5f} to {printed_high:.5f}, not the printed "
        "range",
        "descent_samples": f"first clean sample by rule: Delta above {descent.delta_limit:.3f} (four robust sigma) outvotes the "
        "rest before it",
        "nz_descent": f"standard deviation {z.std():.3f}",
        "descent_behind": f"criterion: 95 %; the fit predicts {dark_right} of {(~seen).sum()} samples without a direction and "
        f"{lit_right} of {seen.sum()} with one",
    }
    row_of = partial(make_row, case, notes=notes)
    result = [
        row_of("descent_E", fit.E, holds=holds if synthetic else None),
        row_of("descent_rate_cubic", fit.coefficients.tolist(), **within),
        row_of("descent_unique", fit.unique, agrees=fit.unique),
        row_of("descent_rate_range", [low, high]),
        row_of("descent_rate_romap", mean_rate),
    ]
    wheel = case.vehicle.wheels[0]
    if nominal := wheel.speed_rad_s:
        # without external torque Theta_uu omega + J W stays (paper, eq. 3, for spin about the wheel's axis u)
        inertia = float(wheel.axis_B @ case.vehicle.require_inertia() @ wheel.axis_B)
        change = inertia * (high - low) / wheel.inertia_kg_m2
        share = 100 * change / abs(nominal)
        note = f"{change:.2f} rad/s of {nominal:g}, what the range of the rate implies if nothing else turns the lander"
        result.append(row_of("descent_wheel_speed", share, note=note))
    return [
        *result,
        row_of("descent_samples", list(descent.number)),
        row_of("nz_descent", float(z.mean())),
        row_of("descent_behind", agreed, agrees=agreed >= 0.95),
    ]


def errors_near_fit(descent: Descent) -> tuple[np.ndarray, np.ndarray]:
    """Return constant terms of the rate (n) in rad/s near the fitted one, and E (n) with the other coefficients as fitted."""
    scan, centre = descent.fit.scan_rate, descent.fit.coefficients[0]
    omega_0 = np.unique(np.append(np.linspace(scan[0], scan[-1], 8001), centre))
    omega_0 = omega_0[np.abs(omega_0 - centre) < 2e-3]  # rad/s: the minimum and its surroundings
    rates = np.column_stack([omega_0, np.tile(descent.fit.coefficients[1:], (omega_0.size, 1))])
    seen, n = is_reconstructed(descent.sun["status"]), descent.sun["sun_B"].values
    return omega_0, errors_of_rates(rates, descent.sun["time"].values[seen], n[seen])


def descent_figure(descent: Descent) -> Figure:
    """Draw measured and fitted directions (Fig. 10), E over all aliases and near its minimum (Fig. 11)."""
    figure = empty_figure(13.5, 4.4)
    sphere, wide, near = figure.subplots(1, 3)
    cubic, flown_E = (
        descent.case.published[f"descent_{name}"].value for name in ("rate_cubic", "E")
    )

    # Fig. 10 as a map of the sphere; lines join measured to fitted directions
    n, seen = descent.sun["sun_B"].values, is_reconstructed(descent.sun["status"])
    azimuth, fitted_azimuth = (
        np.degrees(np.arctan2(sun_B[:, 1], sun_B[:, 0])) for sun_B in (n, descent.fitted_B)
    )
    z, fitted_z = n[:, 2], descent.fitted_B[:, 2]
    joined = seen & (np.abs(azimuth - fitted_azimuth) < 180)  # not across the edge of the map
    pairs = np.stack([azimuth, fitted_azimuth])[:, joined], np.stack([z, fitted_z])[:, joined]
    sphere.plot(*pairs, lw=0.6, color=COLOURS[7])
    label = f"from the telemetry ({seen.sum()})"
    sphere.plot(azimuth[seen], z[seen], "o", ms=4.5, mfc="none", color=COLOURS[0], label=label)
    for marker, size, colour, chosen, label in (
        (".", 4, COLOURS[1], seen, "fitted, same samples"),
        ("+", 6, COLOURS[6], ~seen & ~descent.in_view, "fitted, behind the lander ({})"),
        ("x", 6, COLOURS[3], ~seen & descent.in_view, "fitted in view, no direction ({})"),
    ):
        if chosen.any():
            style: dict[str, Any] = {"color": colour, "label": label.format(chosen.sum())}
            sphere.plot(fitted_azimuth[chosen], fitted_z[chosen], marker, ms=size, **style)
    sphere.set(xlim=(-185, 185), ylim=(0.4, 0.8), xticks=range(-180, 181, 90))
    sphere.set(xlabel="azimuth of the Sun about z (deg)", ylabel="$z$ component")
    sphere.legend(fontsize=8, loc="upper left")

    label = "scan, least over drifts of the rate"
    wide.semilogy(
        1e3 * descent.fit.scan_rate, descent.fit.scan_E, lw=0.6, color=COLOURS[7], label=label
    )
    mean_rate, E = descent.fit.aliases.T
    label = "next minima, refined"
    wide.plot(1e3 * mean_rate[1:4], E[1:4], "v", ms=6, color=COLOURS[1], label=label)
    wide.plot(1e3 * mean_rate[0], E[0], "o", ms=6, color=COLOURS[0], label="smallest E")
    wide.axhline(flown_E, ls=":", lw=1, color=COLOURS[6], label="published E (flight data)")
    wide.set(xlabel="mean rate about z (mrad/s)", ylabel="E", ylim=(E.min() / 20, None))

    omega_0, E = errors_near_fit(descent)
    near.plot(1e3 * omega_0, E, lw=1, color=COLOURS[0])
    near.axvline(1e3 * cubic[0], ls="--", lw=1, color=COLOURS[1], label="published")
    near.set(xlabel=r"$\omega_0$ (mrad/s), other coefficients as fitted")
    near.set(ylabel="E", ylim=(0, None))
    for axes in (wide, near):
        axes.legend(fontsize=8, loc="lower left")
    for axes, title in (
        (sphere, f"directions to the Sun, body axes; E = {descent.fit.E:.2g}"),
        (wide, "E over the aliases of the sampling"),
        (near, r"E against $\omega_0$"),
    ):
        axes.set_title(title, fontsize=9)
    title = f"Descent, samples {descent.number[0]} to {descent.number[1]}: cubic rate about z"
    figure.suptitle(titled(title, descent.sun.attrs.get("synthetic")), fontsize=11)
    return figure
