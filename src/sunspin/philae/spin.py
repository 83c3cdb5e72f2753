"""Spin about one body axis with a slowly changing rate, fitted to directions of the Sun by E (paper, eq. 12 and section 3.1).

The rate is a polynomial in time. The phase Theta(t) is the integral of the rate. In body axes the Sun keeps its component along the
axis and rotates about it by -Theta. For a given phase the best direction at the start is known in closed form. With the components
of the measured directions along the axis, a, and across it as complex numbers, w,

    E = (1 - sqrt(mean(a)^2 + |mean(w exp(i Theta))|^2)) / 2.

So only the rate has to be searched. With sparse samples E has a minimum at each alias of the mean rate. E is scanned over all
aliases, and over linear drifts of the rate. Each deep minimum is refined.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from sunspin.base.errors import InputError

PHASE_STEP = 0.7
"""Step of the scan, rad: the phases of neighbours differ by at most half of this at either end of the window."""

DRIFT_PHASE = 6.0
"""Largest deviation from a linear phase, halfway through the window, by the drifts of the rate that are scanned, rad."""

REFINED = 12
"""Largest number of minima of the scan that are refined: the deepest two, and others of at least half the largest depth."""

DISTINCT = 1.0
"""Fits are the same if their mean rates differ by less than this divided by the length of the window, rad."""

TIED = 25.0
"""Difference of chi-square (five sigma) below which two fits are equally good."""


@dataclass(frozen=True)
class SpinFit:
    """A fitted rate about `axis_B` as a polynomial, with its error and its aliases.

    Attributes
    ----------
    coefficients : (degree + 1,)
        Coefficients of the rate: rad/s, rad/s2, ..., in t_s, lowest first.
    covariance : (degree + 1, degree + 1)
        Covariance of the coefficients, from the scatter of the directions about the fit.
    E : float
        E (paper, eq. 12) of the fit.
    sun_B : (3,)
        Fitted direction to the Sun at t = 0, body axes.
    axis_B : (3,)
        Axis of the spin.
    aliases : (n, 2)
        Mean rate over the window (rad/s) and E of every distinct minimum that was refined, best first.
    alias_gap : float
        Chi-square of the second best fit minus that of the best.
    scan_rate, scan_E : (n,)
        Mean rate over the window (rad/s) along the scan, and the smallest E over the drifts.
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
        """Return the one-sigma errors (degree + 1) of the coefficients."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def unique(self) -> bool:
        """Return whether the second best fit is worse by more than five sigma."""
        return self.alias_gap > TIED

    def rate(self, t_s: npt.ArrayLike) -> np.ndarray:
        """Return the rate (rad/s) at t_s."""
        return np.polynomial.polynomial.polyval(
            np.asarray(t_s, dtype=np.float64), self.coefficients
        )

    def directions(self, t_s: npt.ArrayLike) -> np.ndarray:
        """Return the directions to the Sun (n, 3) at t_s, body axes."""
        return rotated_sun(self.sun_B, self.axis_B, phase(self.coefficients, t_s))


def phase(coefficients: npt.ArrayLike, t_s: npt.ArrayLike) -> np.ndarray:
    """Return the angle (..., n), rad, of the rotation from t = 0 to t_s (n).

    `coefficients` (..., degree + 1): those of the rate, lowest first.
    """
    lowest_first = np.moveaxis(np.asarray(coefficients, dtype=np.float64), -1, 0)
    integral = np.polynomial.polynomial.polyint(lowest_first)
    return np.polynomial.polynomial.polyval(np.asarray(t_s, dtype=np.float64), integral)


def rotated_sun(sun_B: npt.ArrayLike, axis_B: npt.ArrayLike, angle: np.ndarray) -> np.ndarray:
    """Return the Sun directions (n, 3) in body axes after the body has rotated by each angle (n), rad, about the axis."""
    along, across, basis = _split(np.asarray(sun_B, dtype=np.float64), axis_B)
    rotated = across * np.exp(-1j * np.asarray(angle))
    return along * np.asarray(axis_B) + np.stack([rotated.real, rotated.imag], axis=-1) @ basis.T


def error_of_rate(
    coefficients: npt.ArrayLike,
    t_s: np.ndarray,
    sun_B: np.ndarray,
    axis_B: npt.ArrayLike = (0, 0, 1),
) -> float:
    """Return E (paper, eq. 12) of one rate polynomial; see `errors_of_rates`."""
    return float(errors_of_rates(np.asarray(coefficients)[None], t_s, sun_B, axis_B)[0])


def errors_of_rates(
    coefficients: np.ndarray, t_s: np.ndarray, sun_B: np.ndarray, axis_B: npt.ArrayLike = (0, 0, 1)
) -> np.ndarray:
    """Return E (m) of rate polynomials (m, degree + 1), each with the best direction at the start.

    `t_s` (n), s, and `sun_B` (n, 3), body axes: the samples.
    """
    along, across, _ = _split(sun_B, axis_B)
    return _error(along, np.mean(across * np.exp(1j * phase(coefficients, t_s)), axis=-1))


class _Samples(NamedTuple):
    """Directions with the time relative to their window, and split into components.

    `x` (n): time, -1 at the first sample and 1 at the last; `half_s`: half the length of the window; `along` (n): components along
    the axis; `across` (n): complex components across it.
    """

    x: np.ndarray
    half_s: float
    along: np.ndarray
    across: np.ndarray


def fit_spin(
    t_s: npt.ArrayLike,
    sun_B: npt.ArrayLike,
    *,
    degree: int = 3,
    axis_B: npt.ArrayLike = (0.0, 0.0, 1.0),
    rate_range: tuple[float, float] | None = None,
    tolerance: float = 1e-12,
) -> SpinFit:
    """Fit the rate polynomial with the smallest E among all aliases in a range of mean rates.

    Parameters
    ----------
    t_s : (n,) s
        Times of the samples. The polynomial is in this time.
    sun_B : (n, 3)
        Measured directions, body axes. Rows with NaN are left out.
    degree : int
        Degree of the rate; 3 in the paper.
    axis_B : (3,)
        Body axis about which the body spins.
    rate_range : (low, high) rad/s, optional
        Range of mean rates. Default: two alias distances, 2 pi over the median interval, to either side of zero.
    tolerance : float
        Relative tolerance of coefficients and E at the end of the refinement. If no polynomial fits the samples, there are many
        steps of little gain, and a larger tolerance saves them.
    """
    t, directions, axis = _checked(t_s, sun_B, axis_B, degree)
    along, across, basis = _split(directions, axis)
    # the alias distance is that of all samples, those without a direction included
    distance = 2 * np.pi / np.median(np.diff(np.asarray(t_s, dtype=np.float64)))
    low, high = rate_range or (-2 * distance, 2 * distance)
    if not low < high:
        raise InputError("rate_range must be (low, high) in rad/s", got=(low, high))
    middle, half = (t[0] + t[-1]) / 2, (t[-1] - t[0]) / 2
    samples = _Samples((t - t[0]) / half - 1, half, along, across)
    scan_rate, scan_E, drift = _scan(samples, low, high)
    refined = [
        _refine(samples, degree, float(scan_rate[i]), float(drift[i]), tolerance)
        for i in _deepest(scan_E)
    ]
    aliases = _distinct(refined, DISTINCT / (2 * half))  # pairs of E and Legendre coefficients
    error, legendre = aliases[0]
    # Variance (rad2) of one tangent component: the squares of the chords add up to 4 E n. Fitted are the coefficients of the rate
    # and two angles of the start.
    variance = 4 * t.size * error / max(2 * t.size - degree - 3, 1)
    gap = np.inf
    if len(aliases) > 1:
        gap = 4 * t.size * (aliases[1][0] - error) / max(variance, 1e-300)
    to_power = _legendre_to_power(degree, middle, half)
    coefficients = to_power @ legendre
    mean = np.mean(across * np.exp(1j * phase(coefficients, t)))
    start = along.mean() * axis + basis @ [mean.real, mean.imag]
    return SpinFit(
        coefficients=coefficients,
        covariance=to_power @ _covariance(samples, legendre, variance) @ to_power.T,
        E=error,
        sun_B=start / np.linalg.norm(start),
        axis_B=axis,
        aliases=np.array([(legendre[0], error) for error, legendre in aliases]),
        alias_gap=float(gap),
        scan_rate=scan_rate,
        scan_E=scan_E,
    )


def _checked(
    t_s: npt.ArrayLike, sun_B: npt.ArrayLike, axis_B: npt.ArrayLike, degree: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times (n), directions (n, 3) and axis of the samples with a direction; raise `InputError` if they allow no fit."""
    t, sun, axis = (np.asarray(values, dtype=np.float64) for values in (t_s, sun_B, axis_B))
    if t.ndim != 1 or sun.shape != (t.size, 3) or not np.all(np.diff(t) > 0):
        shapes = f"{t.shape}, {sun.shape}"
        raise InputError(
            "t_s must be increasing times (n) and sun_B their directions (n, 3)", got=shapes
        )
    if axis.shape != (3,) or abs(np.linalg.norm(axis) - 1) > 1e-3:
        raise InputError("axis_B must be a unit vector of three components", got=axis_B)
    known = np.all(np.isfinite(sun), axis=1)
    if known.sum() < degree + 4:
        raise InputError(
            f"a rate of degree {degree} needs at least {degree + 4} directions",
            got=f"{known.sum()} of {t.size} samples",
        )
    return t[known], sun[known], axis / np.linalg.norm(axis)


def _split(sun_B: np.ndarray, axis_B: npt.ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the components of directions (n, 3) along the axis (n) and across it (n; complex), and the basis (3, 2) across it.

    The real and imaginary parts are components along the two vectors of the basis, which with the axis is right-handed.
    """
    axis = np.asarray(axis_B, dtype=np.float64)
    first = np.eye(3)[np.argmin(np.abs(axis))]
    first = first - (first @ axis) * axis
    first /= np.linalg.norm(first)
    basis = np.stack([first, np.cross(axis, first)], axis=1)
    return sun_B @ axis, sun_B @ basis @ np.array([1, 1j]), basis


def _error(along: np.ndarray, mean_across: npt.ArrayLike) -> np.ndarray:
    """Return E (...) from the components along the axis (n) and the means (...) of w exp(i Theta)."""
    return (1 - np.sqrt(along.mean() ** 2 + np.abs(mean_across) ** 2)) / 2


def _scan(samples: _Samples, low: float, high: float) -> tuple[np.ndarray, ...]:
    """Return mean rates (m), rad/s, the smallest E (m) over the drifts, and the drift (m) that gives it.

    The drift is the first Legendre coefficient of the rate, rad/s: half its change over the window.
    """
    x, half = samples.x, samples.half_s
    rates = np.linspace(low, high, max(int(np.ceil((high - low) * half / PHASE_STEP)) + 1, 2))
    bends = np.arange(-DRIFT_PHASE, DRIFT_PHASE + 1e-9, PHASE_STEP)  # rad, as of DRIFT_PHASE
    # the phase of a rate with a drift is linear in x plus a parabola; |mean(w exp(i Theta))| of all drifts (rows) and rates
    linear = np.exp(1j * np.outer(rates, half * x))
    with_parabola = (samples.across * np.exp(1j * bend * (x**2 - 1)) for bend in bends)
    means = np.stack([np.abs(linear @ w) for w in with_parabola]) / x.size
    best = np.argmax(means, axis=0)
    return rates, _error(samples.along, means[best, np.arange(rates.size)]), 2 * bends[best] / half


def _deepest(scan_E: np.ndarray) -> np.ndarray:
    """Return the indices of the deepest local minima of a scan, the deepest first."""
    padded = np.concatenate([[np.inf], scan_E, [np.inf]])
    minima = np.flatnonzero((scan_E <= padded[:-2]) & (scan_E < padded[2:]))
    ordered = minima[np.argsort(scan_E[minima], kind="stable")]
    deep = scan_E[ordered] < (scan_E.min() + np.median(scan_E)) / 2
    return ordered[: int(np.clip(deep.sum(), 2, REFINED))]


def _legendre_phases(samples: _Samples, degree: int) -> np.ndarray:
    """Return the phase (n, degree + 1) from the middle of the window per unit of each Legendre coefficient of the rate."""
    integrals = [np.polynomial.legendre.legint(unit, lbnd=0) for unit in np.eye(degree + 1)]
    values = [np.polynomial.legendre.legval(samples.x, integral) for integral in integrals]
    return samples.half_s * np.stack(values, axis=1)


def _refine(
    samples: _Samples, degree: int, rate: float, drift: float, tolerance: float
) -> tuple[float, np.ndarray]:
    """Return E and the Legendre coefficients of the minimum nearest to a mean rate and a drift, rad/s.

    Least squares of the chords between measured and fitted directions: their squares add up to 4 E n. Their components along the
    axis do not depend on the rate.
    """
    design = _legendre_phases(samples, degree)
    scale = np.abs(design).max(axis=0)  # unknowns in radians at the end of the window
    start = np.zeros(degree + 1)
    start[: min(2, degree + 1)] = [rate, drift][: degree + 1]
    across, mean_along = samples.across, samples.along.mean()

    def at_start(unknown: np.ndarray) -> tuple[np.ndarray, complex, float]:
        """Return the directions rotated back to the start (n), their mean, and the length of that with the part along the axis."""
        rotated = across * np.exp(1j * design @ (unknown / scale))
        mean = rotated.mean()
        return rotated, mean, np.hypot(abs(mean), mean_along)

    def chords(unknown: np.ndarray) -> np.ndarray:
        """Return the differences (2 n) of the directions to their mean direction."""
        rotated, mean, length = at_start(unknown)
        chord = rotated - mean / length
        return np.concatenate([chord.real, chord.imag])

    def jacobian(unknown: np.ndarray) -> np.ndarray:
        """Return the derivatives (2 n, degree + 1) of the chords: d(mean / length) with the length^2 = |mean|^2 + constant."""
        rotated, mean, length = at_start(unknown)
        by_unknown = 1j * (design / scale) * rotated[:, None]
        of_mean = by_unknown.mean(axis=0)
        half_of_square = mean.real * of_mean.real + mean.imag * of_mean.imag
        of_chord = by_unknown - of_mean / length + mean * half_of_square / length**3
        return np.concatenate([of_chord.real, of_chord.imag])

    derivative: Any = jacobian  # SciPy has no type for it, and its default is a string
    fit = least_squares(
        chords, start * scale, derivative, xtol=tolerance, ftol=tolerance, gtol=tolerance
    )
    legendre = fit.x / scale
    error = _error(samples.along, np.mean(across * np.exp(1j * design @ legendre)))
    return float(error), legendre


def _distinct(fits: list[tuple[float, np.ndarray]], apart: float) -> list[tuple[float, np.ndarray]]:
    """Return fits (E, Legendre coefficients), best first, without those whose mean rate is within `apart` of a better one's."""
    distinct: list[tuple[float, np.ndarray]] = []
    for error, legendre in sorted(fits, key=lambda fit: fit[0]):
        if all(abs(legendre[0] - better[0]) > apart for _, better in distinct):
            distinct.append((error, legendre))
    return distinct


def _covariance(samples: _Samples, legendre: np.ndarray, variance: float) -> np.ndarray:
    """Return the covariance of the Legendre coefficients for directions with this variance (rad2) of each component.

    The phase at a sample has the sigma of the direction divided by the distance of the direction from the axis.
    """
    design = _legendre_phases(samples, legendre.size - 1)
    n = len(design)
    centred = np.column_stack([design, np.ones(n)])  # the phase at the start is unknown as well
    weight = np.abs(samples.across) ** 2 / variance if variance > 0 else np.full(n, np.inf)
    if not np.all(np.isfinite(weight)):
        return np.zeros((legendre.size, legendre.size))
    scale = np.abs(centred).max(axis=0)
    information = (centred / scale).T @ ((centred / scale) * weight[:, None])
    return (np.linalg.inv(information) / np.outer(scale, scale))[:-1, :-1]


def _legendre_to_power(degree: int, middle: float, half: float) -> np.ndarray:
    """Return the matrix from Legendre coefficients over the window (`middle` and `half` its length, s) to those of powers of t."""
    columns = []
    for unit in np.eye(degree + 1):
        series = np.polynomial.Legendre(unit, domain=[middle - half, middle + half])
        power = series.convert(kind=np.polynomial.Polynomial, domain=[-1, 1]).coef
        columns.append(np.pad(power, (0, degree + 1 - power.size)))
    return np.stack(columns, axis=1)
