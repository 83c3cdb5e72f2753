"""Spin about one body axis with a slowly changing rate, fitted to directions of the Sun by E (paper, eq. 12 and section 3.1).

The rate is a polynomial in time. With phase Theta(t), the integral of the rate, the Sun keeps its component along the axis
and goes round it by -Theta. For a given phase the best direction at the start is known in closed form: with the measured
directions split into a, along the axis, and the complex w, across it,

    E = (1 - sqrt(mean(a)^2 + |mean(w exp(i Theta))|^2)) / 2.

So E needs to be searched over the rate only. Sparse samples make it a comb of aliases: it is scanned over all of them, with
a drift of the rate as a second dimension, and each deep minimum is refined.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from sunspin.base.errors import InputError
from sunspin.solve.rotations import components_after_rotation

PHASE_STEP = 0.7
"""rad; between neighbours of the scan the phase at either end of the window differs by half of this at most."""

DRIFT_PHASE = 6.0
"""rad; the scanned drifts of the rate bend the phase by up to this in the middle of the window, either way."""

REFINED = 12
"""Minima of the scan that are refined, at most: the deepest, down to half the depth of the first, and always two."""

DISTINCT = 1.0
"""Fits whose mean rates differ by less than this times the inverse of the window (rad/s) are one."""

TIED = 25.0
"""Two fits whose chi-square differs by less than this (five sigma) fit equally well."""


@dataclass(frozen=True)
class SpinFit:
    """The rate about `axis_B` as a polynomial, and how good and how unique it is.

    Attributes
    ----------
    coefficients : (degree + 1,)
        Of the rate: rad/s, rad/s2, ..., in t_s, lowest first.
    covariance : (degree + 1, degree + 1)
        Of the coefficients, from the scatter of the directions about the fit.
    E : float
        Paper, eq. 12, at the fit.
    sun_B : (3,)
        Fitted direction to the Sun at t = 0, body axes.
    axis_B : (3,)
        Axis of the spin.
    aliases : (n, 2)
        Mean rate over the window (rad/s) and E of every distinct minimum that was refined, best first.
    alias_gap : float
        Chi-square by which the second best fit is worse.
    scan_rate, scan_E : (n,)
        E along the scan, least over the drifts, against the mean rate over the window (rad/s).
    """

    coefficients: np.ndarray
    covariance: np.ndarray
    E: float
    sun_B: np.ndarray
    axis_B: np.ndarray
    aliases: np.ndarray
    alias_gap: float
    scan_rate: np.ndarray
    scan_E: np.ndarray

    @property
    def sigma(self) -> np.ndarray:
        """One-sigma errors (degree + 1) of the coefficients."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def unique(self) -> bool:
        """Whether the second best fit is worse by more than five sigma."""
        return self.alias_gap > TIED

    def rate(self, t_s: npt.ArrayLike) -> np.ndarray:
        """Rate (rad/s) at t_s."""
        return np.polynomial.polynomial.polyval(
            np.asarray(t_s, dtype=np.float64), self.coefficients
        )

    def directions(self, t_s: npt.ArrayLike) -> np.ndarray:
        """Directions to the Sun (n, 3) at t_s, body axes."""
        return turned(self.sun_B, self.axis_B, phase(self.coefficients, t_s))


def phase(coefficients: npt.ArrayLike, t_s: npt.ArrayLike) -> np.ndarray:
    """Angle (..., n) (rad) turned since t = 0 by t_s (n) at rates of these coefficients (..., degree + 1), lowest first."""
    lowest_first = np.moveaxis(np.asarray(coefficients, dtype=np.float64), -1, 0)
    integral = np.polynomial.polynomial.polyint(lowest_first)
    return np.polynomial.polynomial.polyval(np.asarray(t_s, dtype=np.float64), integral)


def turned(sun_B: npt.ArrayLike, axis_B: npt.ArrayLike, angle: np.ndarray) -> np.ndarray:
    """The Sun's direction (n, 3) in body axes when the body has turned by each angle (n) about the axis."""
    return components_after_rotation(
        np.asarray(sun_B, dtype=np.float64), np.asarray(angle)[:, None] * np.asarray(axis_B)
    )


def error_of_rate(
    coefficients: npt.ArrayLike,
    t_s: np.ndarray,
    sun_B: np.ndarray,
    axis_B: npt.ArrayLike = (0, 0, 1),
) -> float:
    """E (paper, eq. 12) of a rate polynomial with the direction at the start chosen best; samples t_s (n), sun_B (n, 3)."""
    return float(errors_of_rates(np.asarray(coefficients)[None], t_s, sun_B, axis_B)[0])


def errors_of_rates(
    coefficients: np.ndarray, t_s: np.ndarray, sun_B: np.ndarray, axis_B: npt.ArrayLike = (0, 0, 1)
) -> np.ndarray:
    """The same (m) for many polynomials (m, degree + 1)."""
    along, across, _ = _split(sun_B, axis_B)
    return _error(along, np.mean(across * np.exp(1j * phase(coefficients, t_s)), axis=-1))


def fit_spin(
    t_s: npt.ArrayLike,
    sun_B: npt.ArrayLike,
    *,
    degree: int = 3,
    axis_B: npt.ArrayLike = (0.0, 0.0, 1.0),
    rate_range: tuple[float, float] | None = None,
    tolerance: float = 1e-12,
) -> SpinFit:
    """The rate polynomial with the smallest E, found among all aliases in a range of mean rates.

    Parameters
    ----------
    t_s : (n,) s
        Times of the samples; the polynomial is in this time.
    sun_B : (n, 3)
        Measured directions, body axes; rows with NaN are left out.
    degree : int
        Of the rate; 3 in the paper.
    axis_B : (3,)
        Body axis about which the body spins.
    rate_range : (low, high) rad/s, optional
        Mean rates to look at. Default: two alias distances, 2 pi over the median interval, to either side of zero.
    tolerance : float
        Of the last step, relative, in coefficients and in E: where samples fit no polynomial, steps gain little and are many.
    """
    t, n, axis = _checked(t_s, sun_B, axis_B, degree)
    along, across, basis = _split(n, axis)
    low, high = rate_range or _default_range(
        np.asarray(t_s, dtype=np.float64)
    )  # of all samples, with a direction or not
    if not low < high:
        raise InputError("rate_range must be (low, high) in rad/s", got=(low, high))
    scan_rate, scan_E, drift = _scan(t, along, across, low, high)
    middle, half = (t[0] + t[-1]) / 2, (t[-1] - t[0]) / 2
    fits = [
        _refine(t, along, across, degree, float(scan_rate[i]), float(drift[i]), tolerance)
        for i in _deepest(scan_E)
    ]
    kept = _distinct(fits, DISTINCT / (2 * half))
    error, legendre = kept[0]
    variance = (
        4 * t.size * error / max(2 * t.size - degree - 3, 1)
    )  # of one tangent component, rad2
    gap = 4 * t.size * (kept[1][0] - error) / max(variance, 1e-300) if len(kept) > 1 else np.inf
    to_power = _legendre_to_power(degree, middle, half)
    coefficients = to_power @ legendre
    spread = to_power @ _covariance(t, across, legendre, variance) @ to_power.T
    mean = np.mean(across * np.exp(1j * phase(coefficients, t)))
    start = along.mean() * axis + basis @ [mean.real, mean.imag]
    return SpinFit(
        coefficients,
        spread,
        error,
        start / np.linalg.norm(start),
        axis,
        np.array([(legendre[0], e) for e, legendre in kept]),
        float(gap),
        scan_rate,
        scan_E,
    )


def _checked(
    t_s: npt.ArrayLike, sun_B: npt.ArrayLike, axis_B: npt.ArrayLike, degree: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    t, n, axis = (np.asarray(x, dtype=np.float64) for x in (t_s, sun_B, axis_B))
    if t.ndim != 1 or n.shape != (t.size, 3) or not np.all(np.diff(t) > 0):
        shapes = f"{t.shape}, {n.shape}"
        raise InputError(
            "t_s must be increasing times (n) and sun_B their directions (n, 3)", got=shapes
        )
    if axis.shape != (3,) or abs(np.linalg.norm(axis) - 1) > 1e-3:
        raise InputError("axis_B must be a unit vector of three components", got=axis_B)
    known = np.all(np.isfinite(n), axis=1)
    if known.sum() < degree + 4:
        raise InputError(
            f"a rate of degree {degree} needs at least {degree + 4} directions",
            got=f"{known.sum()} of {t.size} samples",
        )
    return t[known], n[known], axis / np.linalg.norm(axis)


def _split(sun_B: np.ndarray, axis_B: npt.ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Components along the axis (n), across it as complex numbers (n), and the basis (3, 2) across it, right-handed."""
    axis = np.asarray(axis_B, dtype=np.float64)
    first = np.eye(3)[np.argmin(np.abs(axis))]
    first = first - (first @ axis) * axis
    first /= np.linalg.norm(first)
    basis = np.stack([first, np.cross(axis, first)], axis=1)
    return sun_B @ axis, sun_B @ basis @ np.array([1, 1j]), basis


def _error(along: np.ndarray, mean_across: npt.ArrayLike) -> np.ndarray:
    return (1 - np.sqrt(along.mean() ** 2 + np.abs(mean_across) ** 2)) / 2


def _default_range(t: np.ndarray) -> tuple[float, float]:
    distance = 2 * np.pi / np.median(np.diff(t))
    return -2 * distance, 2 * distance


def _scan(
    t: np.ndarray, along: np.ndarray, across: np.ndarray, low: float, high: float
) -> tuple[np.ndarray, ...]:
    """Mean rates, E least over the drifts, and the drift (rad/s, first Legendre coefficient) where it is least."""
    half = (t[-1] - t[0]) / 2
    x = (t - t[0]) / half - 1
    rates = np.linspace(low, high, max(int(np.ceil((high - low) * half / PHASE_STEP)) + 1, 2))
    bends = np.arange(-DRIFT_PHASE, DRIFT_PHASE + 1e-9, PHASE_STEP)
    wheel = np.exp(1j * np.outer(rates, half * x))
    means = (
        np.stack([np.abs(wheel @ (across * np.exp(1j * bend * (x**2 - 1)))) for bend in bends])
        / t.size
    )
    best = np.argmax(means, axis=0)
    return rates, _error(along, means[best, np.arange(rates.size)]), 2 * bends[best] / half


def _deepest(scan_E: np.ndarray) -> np.ndarray:
    """Places of the deepest local minima of a scan."""
    padded = np.concatenate([[np.inf], scan_E, [np.inf]])
    minima = np.flatnonzero((scan_E <= padded[:-2]) & (scan_E < padded[2:]))
    ordered = minima[np.argsort(scan_E[minima], kind="stable")]
    deep = scan_E[ordered] < (scan_E.min() + np.median(scan_E)) / 2
    return ordered[: int(np.clip(deep.sum(), 2, REFINED))]


def _legendre_phases(t: np.ndarray, degree: int) -> np.ndarray:
    """Phase (n, degree + 1) from the middle of the window per unit of each Legendre coefficient of the rate."""
    half = (t[-1] - t[0]) / 2
    x = (t - t[0]) / half - 1
    unit = np.eye(degree + 1)
    series = [np.polynomial.legendre.legint(unit[k], lbnd=0) for k in range(degree + 1)]
    return half * np.stack([np.polynomial.legendre.legval(x, s) for s in series], axis=1)


def _refine(
    t: np.ndarray,
    along: np.ndarray,
    across: np.ndarray,
    degree: int,
    rate: float,
    drift: float,
    tolerance: float,
) -> tuple[float, np.ndarray]:
    """E and Legendre coefficients of the nearest minimum: least squares of chords, whose squares add up to 4 E n."""
    design = _legendre_phases(t, degree)
    scale = np.abs(design).max(axis=0)
    start = np.zeros(degree + 1)
    start[: min(2, degree + 1)] = [rate, drift][: degree + 1]
    height = along.mean()

    def chords(unknown: np.ndarray) -> np.ndarray:
        spun = across * np.exp(1j * design @ (unknown / scale))
        mean = spun.mean()
        off = spun - mean / np.hypot(abs(mean), height)
        return np.concatenate([off.real, off.imag])

    def slopes(unknown: np.ndarray) -> np.ndarray:
        spun = across * np.exp(1j * design @ (unknown / scale))
        mean = spun.mean()
        turn = 1j * (design / scale) * spun[:, None]
        shift = turn.mean(axis=0)
        length = np.hypot(abs(mean), height)
        off = (
            turn
            - shift / length
            + mean * (mean.real * shift.real + mean.imag * shift.imag) / length**3
        )
        return np.concatenate([off.real, off.imag])

    jacobian: Any = slopes  # SciPy declares nothing, and the default of this argument is a word
    found = (
        least_squares(
            chords, start * scale, jacobian, xtol=tolerance, ftol=tolerance, gtol=tolerance
        ).x
        / scale
    )
    return float(_error(along, np.mean(across * np.exp(1j * design @ found)))), found


def _distinct(fits: list[tuple[float, np.ndarray]], apart: float) -> list[tuple[float, np.ndarray]]:
    """Fits (E, Legendre coefficients), best first, without those whose mean rate a better one already has."""
    kept: list[tuple[float, np.ndarray]] = []
    for error, legendre in sorted(fits, key=lambda found: found[0]):
        if all(abs(legendre[0] - other[0]) > apart for _, other in kept):
            kept.append((error, legendre))
    return kept


def _covariance(
    t: np.ndarray, across: np.ndarray, legendre: np.ndarray, variance: float
) -> np.ndarray:
    """Of the Legendre coefficients: the phase at each sample is known to sigma over the distance from the axis."""
    design = _legendre_phases(t, legendre.size - 1)
    centred = np.column_stack([design, np.ones(t.size)])  # the phase at the start is free as well
    weight = np.abs(across) ** 2 / variance if variance > 0 else np.full(t.size, np.inf)
    if not np.all(np.isfinite(weight)):
        return np.zeros((legendre.size, legendre.size))
    scale = np.abs(centred).max(axis=0)
    information = (centred / scale).T @ ((centred / scale) * weight[:, None])
    return (np.linalg.inv(information) / np.outer(scale, scale))[:-1, :-1]


def _legendre_to_power(degree: int, middle: float, half: float) -> np.ndarray:
    """Matrix from Legendre coefficients over the window to those of powers of t."""
    columns = []
    for unit in np.eye(degree + 1):
        series = np.polynomial.Legendre(unit, domain=[middle - half, middle + half])
        power = series.convert(kind=np.polynomial.Polynomial, domain=[-1, 1]).coef
        columns.append(np.pad(power, (0, degree + 1 - power.size)))
    return np.stack(columns, axis=1)
