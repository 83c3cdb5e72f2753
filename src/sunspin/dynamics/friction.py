"""Bearing friction of a wheel from a spin-down test, and how a wheel runs down with it.

The speed W of a wheel on a fixed body follows J dW/dt = -mu0 - mu1 W for W > 0 (paper, eq. 5): Coulomb and viscous friction.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.base.errors import MotionError
from sunspin.base.provenance import provenance
from sunspin.vehicle import FloatArray, Friction, frozen_array

MIN_SAMPLES = 4
"""The curve has three parameters; a fourth sample is needed to estimate their errors."""


class SpinDownFit(xr.Dataset):
    """Curve ``c1 exp(c2 t) + c3`` fitted to a spin-down: a Dataset with its numbers as attributes of the same names."""

    __slots__ = ()

    @property
    def c1_rad_s(self) -> float:
        """Return the coefficient of the decaying part."""
        return self["c1_rad_s"].item()

    @property
    def c2_per_s(self) -> float:
        """Return the rate of the decay, negative."""
        return self["c2_per_s"].item()

    @property
    def c3_rad_s(self) -> float:
        """Return the limit of the curve for late times, at or below zero."""
        return self["c3_rad_s"].item()

    @property
    def covariance(self) -> FloatArray:
        """Return the covariance (3, 3) of (c1, c2, c3)."""
        return frozen_array(self["covariance"].values)

    @property
    def rms_rad_s(self) -> float:
        """Return the rms of the residual."""
        return self["rms_rad_s"].item()

    @property
    def friction(self) -> Friction:
        """Return the wheel's friction."""
        return Friction(self["coulomb_N_m"].item(), self["viscous_N_m_s"].item())

    def __call__(self, t_s: npt.ArrayLike) -> FloatArray:
        """Return the fitted wheel speed (rad/s) at `t_s`."""
        return spin_down_curve(
            np.asarray(t_s, dtype=np.float64), self.c1_rad_s, self.c2_per_s, self.c3_rad_s
        )


def fit_spin_down(
    t_s: npt.ArrayLike, wheel_speed_rad_s: npt.ArrayLike, inertia_kg_m2: float
) -> SpinDownFit:
    """Return the friction of a wheel, fitted to its speed while it runs down freely on a fixed body (paper, section 2.2).

    Parameters
    ----------
    t_s : (n,) s
        Increasing; only the decaying part of a record, without the wheel at rest.
    wheel_speed_rad_s : (n,) rad/s
        Of one sign (a wheel that turns backward gives the same friction).
    inertia_kg_m2 : float
        Axial inertia of the wheel.

    Returns
    -------
    xarray.Dataset
        `c1_rad_s`, `c2_per_s`, `c3_rad_s` of ``c1 exp(c2 t) + c3``, their `covariance (coefficient, coefficient2)`; `rms_rad_s` of
        the residual; the friction, `coulomb_N_m` and `viscous_N_m_s`; absolute speeds, `recorded_rad_s` and `fitted_rad_s
        (time)`. The numbers are also attributes (``fit.c1_rad_s``, ``fit.friction``). Called with times it returns the fitted
        speed.

    Raises
    ------
    MotionError
        Fewer than four samples, times that do not increase, a speed that is not finite, changes sign or does not decay.
    """
    from scipy.optimize import curve_fit

    t, speed = _checked_record(t_s, wheel_speed_rad_s)
    span = t[-1] - t[0]
    start = _first_guess(t - t[0], speed)
    # parameters are scaled to numbers near one, so that the fit does not depend on the units of the record
    scale = np.array([speed.max(), 1.0 / span, speed.max()])
    # c1 >= 0, c2 <= 0, c3 <= 0: friction never drives the wheel
    bounds = np.array([0.0, -np.inf, -np.inf]), np.array([np.inf, 0.0, 0.0])

    def scaled(x, a, b, c):
        """Return the curve for scaled parameters."""
        return spin_down_curve(x, *(np.array([a, b, c]) * scale))

    best, covariance = curve_fit(
        scaled, t - t[0], speed, p0=start / scale, bounds=bounds, xtol=1e-14, ftol=1e-14, gtol=1e-14
    )
    c1, c2, c3 = best * scale
    covariance = covariance * np.outer(scale, scale)
    rms = float(np.sqrt(np.mean((spin_down_curve(t - t[0], c1, c2, c3) - speed) ** 2)))
    # the fit counts time from the first sample, the result from zero: c1 is scaled, with its derivatives by c1 and c2
    to_zero = np.exp(-c2 * t[0])
    jacobian = np.array([[to_zero, -c1 * t[0] * to_zero, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    c1, covariance = c1 * to_zero, jacobian @ covariance @ jacobian.T
    c1, c2, c3 = float(c1), float(c2), float(c3)
    friction = Friction.from_spin_down(c1, c2, c3, inertia_kg_m2)
    rate = {"units": "rad s-1"}
    of_covariance = {"long_name": "of c1, c2, c3, in products of their units"}
    of_record = rate | {"long_name": "size of the wheel's speed, recorded"}
    of_fit = rate | {"long_name": "the same as fitted"}
    return SpinDownFit(
        {
            "c1_rad_s": ((), c1, rate),
            "c2_per_s": ((), c2, {"units": "s-1"}),
            "c3_rad_s": ((), c3, rate),
            "covariance": (("coefficient", "coefficient2"), covariance, of_covariance),
            "rms_rad_s": ((), rms, rate | {"long_name": "rms of the residual"}),
            "coulomb_N_m": ((), friction.coulomb_N_m, {"units": "N m"}),
            "viscous_N_m_s": ((), friction.viscous_N_m_s, {"units": "N m s"}),
            "recorded_rad_s": ("time", speed, of_record),
            "fitted_rad_s": ("time", spin_down_curve(t, c1, c2, c3), of_fit),
        },
        coords={"time": ("time", t, {"units": "s"}), "coefficient": ["c1", "c2", "c3"]},
        attrs=provenance("spin_down", source="paper, section 2.2"),
    )


def spin_down_time(friction: Friction, inertia_kg_m2: float, speed_rad_s: float) -> float:
    """Return the time (s) until a free wheel on a fixed body stops: J/mu1 ln(1 + mu1 |W| / mu0) by eq. (5), inf without mu0.

    On a free body the wheel stops sooner by a part J u.inverse(Theta) u (u: axis, Theta: inertia), for Philae 0.04 %.
    """
    coulomb, viscous, speed = friction.coulomb_N_m, friction.viscous_N_m_s, abs(float(speed_rad_s))
    if speed == 0.0:
        return 0.0
    if coulomb == 0.0:
        return float("inf")
    if viscous == 0.0:
        return inertia_kg_m2 * speed / coulomb
    return inertia_kg_m2 / viscous * float(np.log1p(viscous * speed / coulomb))


def spin_down_curve(
    t: FloatArray | float, c1: FloatArray | float, c2: float, c3: float
) -> FloatArray:
    """Return the speed c1 exp(c2 t) + c3 (rad/s), at times t (s), of a wheel that runs down (paper, section 2.2)."""
    return c1 * np.exp(c2 * t) + c3


LONGEST_BACK = 300.0
"""Multiples of J / mu1 that a speed is followed back. It was e^300 times as large then: no real wheel's, but finite."""


def spin_down_speed(
    coulomb_N_m: Any,
    viscous_N_m_s: Any,
    inertia_kg_m2: Any,
    speed_rad_s: npt.ArrayLike,
    t: npt.ArrayLike,
) -> FloatArray:
    """Return the speed (rad/s), at times t (s), of a free wheel on a fixed body; zero once it has stopped.

    `speed_rad_s` is that at t = 0. All arguments are broadcast. Times before 0 give the speed that the wheel had then.
    """
    # closed form with x = mu1 t / J: |W| = |W0| exp(-x) - mu0 t / J (1 - exp(-x)) / x; for small x the series of the last factor
    decay = np.asarray(viscous_N_m_s / inertia_kg_m2 * np.asarray(t, dtype=np.float64))
    decay = np.maximum(decay, -LONGEST_BACK)
    small = np.abs(decay) < 1e-8
    relaxed = np.where(small, 1.0 - 0.5 * decay, -np.expm1(-decay) / np.where(small, 1.0, decay))
    by_coulomb = coulomb_N_m / inertia_kg_m2 * np.asarray(t) * relaxed
    size = np.abs(speed_rad_s) * np.exp(-decay) - by_coulomb
    return np.sign(speed_rad_s) * np.maximum(size, 0.0)


def _checked_record(
    t_s: npt.ArrayLike, wheel_speed_rad_s: npt.ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return times (n), s, and absolute speeds (n), rad/s, of a spin-down; raise MotionError for an unusable record."""
    t, speed = np.asarray(t_s, dtype=np.float64), np.asarray(wheel_speed_rad_s, dtype=np.float64)
    if t.ndim != 1 or t.shape != speed.shape or t.size < MIN_SAMPLES:
        raise MotionError(
            f"a spin-down needs {MIN_SAMPLES} or more times and as many speeds",
            got=f"{t.shape} and {speed.shape}",
        )
    if not (np.all(np.isfinite(t)) and np.all(np.isfinite(speed)) and np.all(np.diff(t) > 0)):
        raise MotionError("the times of a spin-down must increase, and times and speeds be finite")
    if np.any(speed == 0) or np.any(np.sign(speed) != np.sign(speed[0])):
        raise MotionError(
            "the wheel stops or reverses within the record",
            do="cut the record before the wheel stops",
        )
    speed = np.abs(speed)
    if not speed[-1] < speed[0]:
        raise MotionError(
            "the wheel does not slow down",
            got=f"{speed[0]:g} to {speed[-1]:g} rad/s",
            do="cut to the decaying part",
        )
    return t, speed


def _first_guess(t: FloatArray, speed: FloatArray) -> FloatArray:
    """Return a start (c1, c2, c3) for the fit, times counted from the first: the best of 61 rates c2, with c1 and c3 linear."""
    best, best_misfit = np.array([speed[0], -1.0 / t[-1], 0.0]), np.inf
    for c2 in -np.geomspace(1e-3, 1e2, 61) / t[-1]:
        design = np.column_stack([np.exp(c2 * t), np.ones_like(t)])
        (c1, c3), *_ = np.linalg.lstsq(design, speed, rcond=None)
        misfit = np.sum((design @ [c1, c3] - speed) ** 2)
        if misfit < best_misfit and c1 > 0 and c3 <= 0:
            best, best_misfit = np.array([c1, c2, c3]), misfit
    return best
