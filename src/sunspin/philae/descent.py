"""Philae before its first touchdown: a cubic rate about z fitted to the directions of the Sun (paper, section 3.1, Figs. 10, 11).

The samples that the folded legs spoil are recognised by their Delta (`clean_from`); the end is the published span of the fit,
or the touchdown if that comes first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from numpy.polynomial.polynomial import polyval

from sunspin.base.errors import TelemetryError
from sunspin.estimate.scan.mask import allows, reconstructible_mask
from sunspin.estimate.scan.metrics import direction_error
from sunspin.estimate.spin import SpinFit, error_of_rate, errors_of_rates, fit_spin
from sunspin.output.figures import COLOURS, titled
from sunspin.philae.rebound import case_seconds
from sunspin.philae.row import Row, row
from sunspin.telemetry.case import Case
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
    """

    case: Case
    sun: xr.Dataset
    number: tuple[int, int]
    delta_limit: float
    fit: SpinFit
    simulated_B: np.ndarray
    predicted: np.ndarray

    @property
    def synthetic(self) -> bool:
        """Whether the telemetry is."""
        return bool(self.sun.attrs.get("synthetic"))

    def rate_range(self, coefficients: np.ndarray | None = None) -> tuple[float, float]:
        """Smallest and largest rate (rad/s) over the fitted window, of the fit or of other coefficients."""
        t = np.linspace(0.0, float(self.sun["time"].values[-1]), 2001)
        rate = polyval(t, self.fit.coefficients if coefficients is None else coefficients)
        return float(rate.min()), float(rate.max())


def delta_limit(sun: xr.Dataset) -> float:
    """Delta above which a sample does not fit whole, unshadowed panels: four robust sigma of all that redundancy checks."""
    checked = sun["delta"].values[sun["status"].values == SunStatus.OK]
    if checked.size < 2 * LEAST_RUN:
        raise TelemetryError(
            "too few samples with more than three lit panels to tell what Delta is usual",
            got=f"{checked.size}",
        )
    # sigma of a Gaussian from the median of its absolute value: four lit panels leave one degree of freedom
    return DELTA_SIGMAS * 1.4826 * float(np.median(checked))


def clean_from(sun: xr.Dataset) -> int:
    """Index of the first sample after a run of spoiled ones at the beginning; 0 if there is none.

    The rule: of the samples whose Delta checks something (more than three lit panels) those above `delta_limit` count +1
    and the others -1; the run is the beginning with the largest sum, if that is at least `LEAST_RUN`. What follows counts
    as clean from the next sample that Delta has checked and judged good: those between can be neither accused nor cleared.
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
    # published to 0.1 h, about two intervals
    span = 3600.0 * case.published["descent_span"].value + float(np.median(np.diff(time))) / 2
    samples = before.isel(time=np.flatnonzero((time >= 0) & (time <= span)))
    t = samples["time"].values - samples["time"].values[0]
    fit = fit_spin(t, samples["sun_B"].values)
    return Descent(
        case,
        samples.assign_coords(time=samples["time"] - samples["time"].values[0]),
        (first + 1, first + len(t)),
        delta_limit(before),
        fit,
        fit.directions(t),
        allows(reconstructible_mask(case.vehicle), fit.directions(t)),
    )


def rows(r: Descent) -> list[Row]:
    """Published figures of section 3.1 with ours."""
    case, fit, t, n = r.case, r.fit, r.sun["time"].values, r.sun["sun_B"].values
    row_of = partial(row, case)
    seen = is_reconstructed(r.sun["status"])
    twin = "synthetic telemetry, made with the published cubic; " if r.synthetic else ""
    put_in = (
        "synthetic telemetry: its panel misalignment is chosen so that the mean E of twenty seeds is as published; "
        f"that of one comes back if within a factor of {FACTOR_OF_E:g}; "
    )
    flown_E = float(case.published["descent_E"].value)
    back = 1 / FACTOR_OF_E <= fit.E / flown_E <= FACTOR_OF_E
    rms, meant = (float(np.degrees(2 * np.sqrt(E))) for E in (fit.E, flown_E))
    published = np.array(case.published["descent_rate_cubic"].value)
    off = fit.coefficients - published
    distance = float(off @ np.linalg.solve(fit.covariance, off))
    low, high = r.rate_range()
    mean_rate = float(fit.rate(np.linspace(0, t[-1], 2001)).mean())
    result = [
        row_of(
            "descent_E",
            fit.E,
            holds=back if r.synthetic else None,
            twin=put_in if r.synthetic else "",
            rms=rms,
            meant=meant,
            first_E=float(direction_error(replace(fit, sun_B=n[0]).directions(t), n)),
        ),
        row_of(
            "descent_rate_cubic",
            fit.coefficients.tolist(),
            published=published.tolist(),
            tolerance=(np.sqrt(CUBIC_CHI2) * fit.sigma).tolist(),
            agrees=bool(distance <= CUBIC_CHI2),
            twin=twin,
            distance=distance,
            asked=CUBIC_CHI2,
            sigmas="[" + ", ".join(f"{sigma:.1e}" for sigma in fit.sigma) + "]",
            printed_E=error_of_rate(published, t[seen], n[seen]),
            rounding=0.5e-5 * float(t[-1]),
        ),
        row_of(
            "descent_unique",
            fit.unique,
            agrees=fit.unique,
            minima=len(fit.aliases),
            within=fit.scan_rate[-1],
            second=fit.aliases[1] if len(fit.aliases) > 1 else np.array([np.nan, np.nan]),
            gap=fit.alias_gap,
        ),
        row_of("descent_rate_range", [low, high], twin=twin, printed=r.rate_range(published)),
        row_of("descent_rate_romap", mean_rate, twin=twin),
    ]
    wheel = case.vehicle.wheels[0]
    if wheel.speed_rad_s:
        # without external torque Theta_uu omega + J W stays (paper, eq. 3, for spin about the wheel's axis u)
        inertia = float(wheel.axis_B @ case.vehicle.require_inertia() @ wheel.axis_B)
        change = inertia * (high - low) / wheel.inertia_kg_m2
        nominal = wheel.speed_rad_s
        share = 100 * change / abs(nominal)
        result.append(
            row_of("descent_wheel_speed", share, twin=twin, change=change, nominal=nominal)
        )
    z, behind = n[seen, 2], ~r.predicted
    agreed = float(np.mean(behind == ~seen))
    return [
        *result,
        row_of("descent_samples", list(r.number), limit=r.delta_limit),
        row_of("nz_descent", float(z.mean()), twin=twin, spread=z.std()),
        row_of(
            "descent_behind",
            agreed,
            agrees=agreed >= 0.95,
            dark_right=int((~seen & behind).sum()),
            dark=int((~seen).sum()),
            told_right=int((seen & behind).sum()),
            told=int(seen.sum()),
        ),
    ]


def figure_11(r: Descent, within: float = 2e-3) -> tuple[np.ndarray, np.ndarray]:
    """Constant terms of the rate (n) in rad/s no further than `within` from the fitted one, and E (n) with the other three
    coefficients as fitted."""
    scan, centre = r.fit.scan_rate, r.fit.coefficients[0]
    omega_0 = np.unique(np.append(np.linspace(scan[0], scan[-1], 8001), centre))
    omega_0 = omega_0[np.abs(omega_0 - centre) < within]
    rates = np.column_stack([omega_0, np.tile(r.fit.coefficients[1:], (omega_0.size, 1))])
    seen, n = is_reconstructed(r.sun["status"]), r.sun["sun_B"].values
    return omega_0, errors_of_rates(rates, r.sun["time"].values[seen], n[seen])


def draw(r: Descent) -> Figure:
    """Measured and fitted directions (Fig. 10), the rate, E over all aliases and near its minimum (Fig. 11)."""
    figure = Figure(figsize=(11, 8.2), layout="constrained")
    (sphere, rates), (wide, near) = figure.subplots(2, 2)
    _draw_figure_10(sphere, r)
    cubic, low_high, flown_E = (
        np.array(r.case.published[f"descent_{name}"].value)
        for name in ("rate_cubic", "rate_range", "E")
    )

    # rates are drawn in mrad/s
    t = np.linspace(0, float(r.sun["time"].values[-1]), 300)
    powers = t[:, None] ** np.arange(r.fit.coefficients.size)
    sigma = 1e3 * np.sqrt(np.einsum("ni,ij,nj->n", powers, r.fit.covariance, powers))
    rate, hours = 1e3 * r.fit.rate(t), t / 3600
    band: dict[str, Any] = {"color": COLOURS[5], "alpha": 0.5, "lw": 0, "label": "fit, 2 sigma"}
    rates.fill_between(hours, rate - 2 * sigma, rate + 2 * sigma, **band)
    rates.plot(hours, rate, color=COLOURS[0], label="fit")
    label = "published coefficients"
    rates.plot(hours, 1e3 * polyval(t, cubic), "--", color=COLOURS[1], label=label)
    rates.axhspan(*(1e3 * low_high), color=COLOURS[7], alpha=0.25, lw=0, label="published range")
    rates.set(xlabel="time since the first sample of the fit (h)", ylabel="rate about z (mrad/s)")
    rates.legend(fontsize=8)
    rates.set_title("rate", fontsize=9)

    label = "scan, least over drifts of the rate"
    wide.semilogy(1e3 * r.fit.scan_rate, r.fit.scan_E, lw=0.6, color=COLOURS[7], label=label)
    mean_rate, E = r.fit.aliases.T
    label = "next minima, refined"
    wide.plot(1e3 * mean_rate[1:4], E[1:4], "v", ms=6, color=COLOURS[1], label=label)
    wide.plot(1e3 * mean_rate[0], E[0], "o", ms=6, color=COLOURS[0], label="smallest E")
    wide.axhline(flown_E, ls=":", lw=1, color=COLOURS[6], label="published E (flown data)")
    wide.set(xlabel="mean rate about z (mrad/s)", ylabel="E")
    wide.set_title("E over the aliases of the sampling", fontsize=9)

    omega_0, E = figure_11(r)
    near.plot(1e3 * omega_0, E, lw=1, color=COLOURS[0])
    near.axvline(1e3 * cubic[0], ls="--", lw=1, color=COLOURS[1], label="published")
    near.set(xlabel=r"$\omega_0$ (mrad/s), other coefficients as fitted")
    near.set(ylabel="E", ylim=(0, None))
    near.set_title(r"E against $\omega_0$", fontsize=9)
    for axes in (wide, near):
        axes.legend(fontsize=8, loc="lower left")
    title = f"Descent, samples {r.number[0]} to {r.number[1]}: cubic rate about z"
    figure.suptitle(titled(title, r.synthetic), fontsize=11)
    return figure


def _draw_figure_10(axes: Any, r: Descent) -> None:
    """As a map of the sphere: azimuth and z. Lines join what was measured to what the fit says."""
    seen, behind = is_reconstructed(r.sun["status"]), ~r.predicted
    azimuth, fitted = (
        np.degrees(np.arctan2(n[:, 1], n[:, 0])) for n in (r.sun["sun_B"].values, r.simulated_B)
    )
    z, fitted_z = r.sun["sun_B"].values[:, 2], r.simulated_B[:, 2]
    near = seen & (np.abs(azimuth - fitted) < 180)  # not across the edge of the map
    pairs = np.stack([azimuth, fitted])[:, near], np.stack([z, fitted_z])[:, near]
    axes.plot(*pairs, lw=0.6, color=COLOURS[7])
    label = f"from the telemetry ({seen.sum()})"
    axes.plot(azimuth[seen], z[seen], "o", ms=4.5, mfc="none", color=COLOURS[0], label=label)
    for marker, size, colour, chosen, label in (
        (".", 4, COLOURS[1], seen, "fitted, same samples"),
        ("+", 6, COLOURS[6], ~seen & behind, "fitted, behind the lander ({})"),
        ("x", 6, COLOURS[3], ~seen & ~behind, "fitted in view, no direction ({})"),
    ):
        if chosen.any():
            label = label.format(chosen.sum())
            axes.plot(fitted[chosen], fitted_z[chosen], marker, ms=size, color=colour, label=label)
    axes.set(xlim=(-185, 185), ylim=(0.4, 0.8), ylabel="$z$ component")
    axes.set(xlabel="azimuth of the Sun about z (deg)")
    axes.set_xticks(range(-180, 181, 90))
    axes.legend(fontsize=8, loc="upper left", ncols=2)
    axes.set_title(f"directions to the Sun, body axes; E = {r.fit.E:.2g}", fontsize=9)
