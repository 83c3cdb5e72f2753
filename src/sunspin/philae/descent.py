"""Philae before its first touchdown: a cubic rate about z fitted to the directions of the Sun (paper, section 3.1, Figs. 10, 11).

The samples that the folded legs spoil are recognised by their Delta (`clean_from`); the end is the published span of the fit,
or the touchdown if that comes first.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from numpy.polynomial.polynomial import polyval

from sunspin.base.errors import TelemetryError
from sunspin.cases import Case
from sunspin.estimate.scan.mask import allows, reconstructible_mask
from sunspin.estimate.spin import SpinFit, error_of_rate, errors_of_rates, fit_spin
from sunspin.output.figures import COLOURS, titled
from sunspin.philae.rebound import event_seconds
from sunspin.philae.row import Row, row
from sunspin.telemetry.sun import SunStatus, is_reconstructed

DELTA_SIGMAS = 4.0
"""A sample counts as spoiled if its Delta exceeds this many times the robust sigma of all Deltas: for Philae that lies between
what the paper has before the legs unfolded (0.1 to 0.2) and the largest after (0.07)."""

LEAST_RUN = 2
"""Spoiled samples must outnumber good ones by this in a run at the beginning before it is taken as one."""

FACTOR_OF_E = 2.0
"""An E put in comes back where it is within this factor of the published one: it is the mean of seeds that is put in."""

CUBIC_CHI2 = 16.25
"""Chi-square with four degrees that is exceeded with probability 0.0027, as three sigma are with one."""


class Descent(NamedTuple):
    """The descent's samples (`sun`, of `sun_directions`, time in s from the first of them) and the fit.

    `number`: of the first and the last, counted from 1 in the telemetry; `delta_limit`: Delta above which a sample counts as
    spoiled; `fitted_B` (n, 3): fitted direction at every sample, reconstructed or not; `in_view` (n): whether the panels allow
    to reconstruct it.
    """

    case: Case
    sun: xr.Dataset
    number: tuple[int, int]
    delta_limit: float
    fit: SpinFit
    fitted_B: np.ndarray
    in_view: np.ndarray

    def rate_range(self, coefficients: np.ndarray) -> tuple[float, float]:
        """Smallest and largest rate (rad/s) with these coefficients over the fitted window."""
        rate = polyval(np.linspace(0.0, float(self.sun["time"].values[-1]), 2001), coefficients)
        return float(rate.min()), float(rate.max())


def clean_from(sun: xr.Dataset) -> tuple[int, float]:
    """Index of the first sample after a run of spoiled ones at the beginning, 0 if there is none; Delta above which one is spoiled.

    The rule: of the samples whose Delta checks something (more than three lit panels) those above the limit, four robust sigma,
    count +1 and the others -1; the run is the beginning with the largest sum, if that is at least `LEAST_RUN`. What follows
    counts as clean from the next sample that Delta has checked and judged good: those between can be neither accused nor cleared.
    """
    checked = np.flatnonzero(sun["status"].values == SunStatus.OK)
    delta = sun["delta"].values[checked]
    if delta.size < 2 * LEAST_RUN:
        what = "too few samples with more than three lit panels to tell what Delta is usual"
        raise TelemetryError(what, got=f"{delta.size}")
    # sigma of a Gaussian from the median of its absolute value: four lit panels leave one degree of freedom
    limit = DELTA_SIGMAS * 1.4826 * float(np.median(delta))
    votes = np.cumsum(np.where(delta > limit, 1, -1))
    end = int(np.argmax(votes))
    if votes[end] < LEAST_RUN:
        return 0, limit
    if end + 1 == checked.size:
        what = "no sample is clean: Delta is large to the end"
        raise TelemetryError(what, do="check the panels' gains and names")
    return int(checked[end + 1]), limit


def compute(case: Case, sun: xr.Dataset) -> Descent:
    """Recognise the clean samples of the descent in `sun` (of `sun_directions`, whole landing) and fit the cubic rate."""
    touchdown = event_seconds(case, sun, "first_touchdown")
    before = sun.isel(time=np.flatnonzero(sun["time"].values < touchdown))
    if before.sizes["time"] == 0:
        what, do = "no sample before the first touchdown", "check the times of the telemetry"
        raise TelemetryError(what, do=do)
    first, limit = clean_from(before)
    time = before["time"].values - before["time"].values[first]
    # published to 0.1 h, about two intervals
    span = 3600.0 * case.published["descent_span"].value + float(np.median(np.diff(time))) / 2
    samples = before.isel(time=np.flatnonzero((time >= 0) & (time <= span)))
    samples = samples.assign_coords(time=samples["time"] - samples["time"].values[0])
    t = samples["time"].values
    fit = fit_spin(t, samples["sun_B"].values)
    fitted, number = fit.directions(t), (first + 1, first + len(t))
    in_view = allows(reconstructible_mask(case.vehicle), fitted)
    return Descent(case, samples, number, limit, fit, fitted, in_view)


def rows(r: Descent) -> list[Row]:
    """Published figures of section 3.1 with ours."""
    case, fit, t, n = r.case, r.fit, r.sun["time"].values, r.sun["sun_B"].values
    paper = {key: figure.value for key, figure in case.published.items()}
    seen, synthetic = is_reconstructed(r.sun["status"]), bool(r.sun.attrs.get("synthetic"))
    row_of = partial(row, case)

    rms, meant = (float(np.degrees(2 * np.sqrt(E))) for E in (fit.E, paper["descent_E"]))
    comes_back = 1 / FACTOR_OF_E <= fit.E / paper["descent_E"] <= FACTOR_OF_E
    given = {"holds": comes_back, "says": ("note", "note_put_in")} if synthetic else {"holds": None}
    of_E = row_of("descent_E", fit.E, rms=rms, meant=meant, factor=FACTOR_OF_E, **given)

    cubic = np.array(paper["descent_rate_cubic"])
    off = fit.coefficients - cubic
    distance = float(off @ np.linalg.solve(fit.covariance, off))
    of_cubic = row_of(
        "descent_rate_cubic",
        fit.coefficients.tolist(),
        tolerance=(np.sqrt(CUBIC_CHI2) * fit.sigma).tolist(),
        agrees=bool(distance <= CUBIC_CHI2),
        distance=distance,
        asked=CUBIC_CHI2,
        sigmas="[" + ", ".join(f"{sigma:.1e}" for sigma in fit.sigma) + "]",
        printed_E=error_of_rate(cubic, t[seen], n[seen]),
    )
    second = fit.aliases[1] if len(fit.aliases) > 1 else np.array([np.nan, np.nan])
    minima = {"minima": len(fit.aliases), "within": fit.scan_rate[-1], "gap": fit.alias_gap}
    unique = row_of("descent_unique", fit.unique, agrees=fit.unique, second=second, **minima)
    low, high = r.rate_range(fit.coefficients)
    mean_rate = float(fit.rate(np.linspace(0, t[-1], 2001)).mean())
    result = [
        of_E,
        of_cubic,
        unique,
        row_of("descent_rate_range", [low, high], printed=r.rate_range(cubic)),
        row_of("descent_rate_romap", mean_rate),
    ]
    wheel = case.vehicle.wheels[0]
    if nominal := wheel.speed_rad_s:
        # without external torque Theta_uu omega + J W stays (paper, eq. 3, for spin about the wheel's axis u)
        inertia = float(wheel.axis_B @ case.vehicle.require_inertia() @ wheel.axis_B)
        change = inertia * (high - low) / wheel.inertia_kg_m2
        share = 100 * change / abs(nominal)
        result.append(row_of("descent_wheel_speed", share, change=change, nominal=nominal))
    z, agreed = n[seen, 2], float(np.mean(r.in_view == seen))
    dark, lit = int((~seen).sum()), int(seen.sum())
    rightly = {"dark_right": (~seen & ~r.in_view).sum(), "lit_right": (seen & r.in_view).sum()}
    return [
        *result,
        row_of("descent_samples", list(r.number), limit=r.delta_limit),
        row_of("nz_descent", float(z.mean()), spread=z.std()),
        row_of("descent_behind", agreed, agrees=agreed >= 0.95, dark=dark, lit=lit, **rightly),
    ]


def figure_11(r: Descent) -> tuple[np.ndarray, np.ndarray]:
    """Constant terms of the rate (n) in rad/s near the fitted one, and E (n) with the other three coefficients as fitted."""
    scan, centre = r.fit.scan_rate, r.fit.coefficients[0]
    omega_0 = np.unique(np.append(np.linspace(scan[0], scan[-1], 8001), centre))
    omega_0 = omega_0[np.abs(omega_0 - centre) < 2e-3]
    rates = np.column_stack([omega_0, np.tile(r.fit.coefficients[1:], (omega_0.size, 1))])
    seen, n = is_reconstructed(r.sun["status"]), r.sun["sun_B"].values
    return omega_0, errors_of_rates(rates, r.sun["time"].values[seen], n[seen])


def draw(r: Descent) -> Figure:
    """Measured and fitted directions (Fig. 10), E over all aliases and near its minimum (Fig. 11)."""
    figure = Figure(figsize=(13.5, 4.4), layout="constrained")
    sphere, wide, near = figure.subplots(1, 3)
    cubic, flown_E = (r.case.published[f"descent_{name}"].value for name in ("rate_cubic", "E"))

    # Fig. 10 as a map of the sphere; lines join what was measured to what the fit says
    n, seen = r.sun["sun_B"].values, is_reconstructed(r.sun["status"])
    azimuth, fitted = (np.degrees(np.arctan2(each[:, 1], each[:, 0])) for each in (n, r.fitted_B))
    z, fitted_z = n[:, 2], r.fitted_B[:, 2]
    joined = seen & (np.abs(azimuth - fitted) < 180)  # not across the edge of the map
    pairs = np.stack([azimuth, fitted])[:, joined], np.stack([z, fitted_z])[:, joined]
    sphere.plot(*pairs, lw=0.6, color=COLOURS[7])
    label = f"from the telemetry ({seen.sum()})"
    sphere.plot(azimuth[seen], z[seen], "o", ms=4.5, mfc="none", color=COLOURS[0], label=label)
    for marker, size, colour, chosen, label in (
        (".", 4, COLOURS[1], seen, "fitted, same samples"),
        ("+", 6, COLOURS[6], ~seen & ~r.in_view, "fitted, behind the lander ({})"),
        ("x", 6, COLOURS[3], ~seen & r.in_view, "fitted in view, no direction ({})"),
    ):
        if chosen.any():
            style: dict[str, Any] = {"color": colour, "label": label.format(chosen.sum())}
            sphere.plot(fitted[chosen], fitted_z[chosen], marker, ms=size, **style)
    sphere.set(xlim=(-185, 185), ylim=(0.4, 0.8), xticks=range(-180, 181, 90))
    sphere.set(xlabel="azimuth of the Sun about z (deg)", ylabel="$z$ component")
    sphere.legend(fontsize=8, loc="upper left")

    label = "scan, least over drifts of the rate"
    wide.semilogy(1e3 * r.fit.scan_rate, r.fit.scan_E, lw=0.6, color=COLOURS[7], label=label)
    mean_rate, E = r.fit.aliases.T
    label = "next minima, refined"
    wide.plot(1e3 * mean_rate[1:4], E[1:4], "v", ms=6, color=COLOURS[1], label=label)
    wide.plot(1e3 * mean_rate[0], E[0], "o", ms=6, color=COLOURS[0], label="smallest E")
    wide.axhline(flown_E, ls=":", lw=1, color=COLOURS[6], label="published E (flight data)")
    wide.set(xlabel="mean rate about z (mrad/s)", ylabel="E", ylim=(E.min() / 20, None))

    omega_0, E = figure_11(r)
    near.plot(1e3 * omega_0, E, lw=1, color=COLOURS[0])
    near.axvline(1e3 * cubic[0], ls="--", lw=1, color=COLOURS[1], label="published")
    near.set(xlabel=r"$\omega_0$ (mrad/s), other coefficients as fitted")
    near.set(ylabel="E", ylim=(0, None))
    for axes in (wide, near):
        axes.legend(fontsize=8, loc="lower left")
    for axes, title in (
        (sphere, f"directions to the Sun, body axes; E = {r.fit.E:.2g}"),
        (wide, "E over the aliases of the sampling"),
        (near, r"E against $\omega_0$"),
    ):
        axes.set_title(title, fontsize=9)
    title = f"Descent, samples {r.number[0]} to {r.number[1]}: cubic rate about z"
    figure.suptitle(titled(title, r.sun.attrs.get("synthetic")), fontsize=11)
    return figure
