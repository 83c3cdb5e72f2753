"""Bearing friction of a wheel from a spin-down test, and how long a wheel runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.base.errors import MotionError
from sunspin.base.provenance import provenance
from sunspin.vehicle import FloatArray, Friction, frozen_array

MIN_SAMPLES = 4
"""Three parameters need a fourth sample before the fit says anything about its error."""


class SpinDownFit(xr.Dataset):
    """``c1 exp(c2 t) + c3`` fitted to a spin-down: a Dataset whose numbers are also plain attributes of these names."""

    __slots__ = ()

    @property
    def c1_rad_s(self) -> float:
        """Coefficient of the decaying part."""
        return self["c1_rad_s"].item()

    @property
    def c2_per_s(self) -> float:
        """Rate of the decay, negative."""
        return self["c2_per_s"].item()

    @property
    def c3_rad_s(self) -> float:
        """Speed that it decays to, at or below zero."""
        return self["c3_rad_s"].item()

    @property
    def covariance(self) -> FloatArray:
        """Of (c1, c2, c3), (3, 3)."""
        return frozen_array(self["covariance"].values)

    @property
    def rms_rad_s(self) -> float:
        """Of the residual."""
        return self["rms_rad_s"].item()

    @property
    def friction(self) -> Friction:
        """The wheel's friction."""
        return Friction(self["coulomb_N_m"].item(), self["viscous_N_m_s"].item())

    def __call__(self, t_s: npt.ArrayLike) -> FloatArray:
        """The fitted wheel speed (rad/s) at `t_s`."""
        return spin_down_curve(
            np.asarray(t_s, dtype=np.float64), self.c1_rad_s, self.c2_per_s, self.c3_rad_s
        )


def fit_spin_down(
    t_s: npt.ArrayLike, wheel_speed_rad_s: npt.ArrayLike, inertia_kg_m2: float
) -> SpinDownFit:
    """Fit the friction of a wheel that runs down freely on a fixed body (paper, section 2.2).

    Parameters
    ----------
    t_s : (n,) s
        Increasing; only the decaying part of a record, without the wheel at rest.
    wheel_speed_rad_s : (n,) rad/s
        Of one sign (a wheel turning backward gives the same friction).
    inertia_kg_m2 : float
        Axial inertia of the wheel.

    Returns
    -------
    xarray.Dataset
        `c1_rad_s`, `c2_per_s`, `c3_rad_s` of ``c1 exp(c2 t) + c3``, their `covariance (coefficient, coefficient2)`; `rms_rad_s` of
        the residual; the friction, `coulomb_N_m` and `viscous_N_m_s`; the sizes of speeds, `recorded_rad_s` and `fitted_rad_s
        (time)`. As returned it also has the numbers as attributes (``fit.c1_rad_s``), ``fit.friction``, and called with times
        gives the fitted speed.

    Raises
    ------
    MotionError
        Fewer than four samples, times that do not increase, a speed that is not finite, changes sign or does not decay.
    """
    from scipy.optimize import curve_fit

    t, speed = _record(t_s, wheel_speed_rad_s)
    span = t[-1] - t[0]
    start = _first_guess(t - t[0], speed)
    # scaled to numbers near one, so that the fit is the same whatever the units of the record suggest
    scale = np.array([speed.max(), 1.0 / span, speed.max()])
    bounds = (
        np.array([0.0, -np.inf, -np.inf]),
        np.array([np.inf, 0.0, 0.0]),
    )  # friction never drives the wheel

    def scaled(x, a, b, c):
        return spin_down_curve(x, *(np.array([a, b, c]) * scale))

    best, covariance = curve_fit(
        scaled, t - t[0], speed, p0=start / scale, bounds=bounds, xtol=1e-14, ftol=1e-14, gtol=1e-14
    )
    c1, c2, c3 = best * scale
    covariance = covariance * np.outer(scale, scale)
    rms = float(np.sqrt(np.mean((spin_down_curve(t - t[0], c1, c2, c3) - speed) ** 2)))
    c1, covariance = _moved_to_time_zero(c1, c2, covariance, t[0])
    c1, c2, c3 = float(c1), float(c2), float(c3)
    return _fit(
        t, speed, (c1, c2, c3), covariance, rms, Friction.from_spin_down(c1, c2, c3, inertia_kg_m2)
    )


def _fit(
    t: FloatArray,
    speed: FloatArray,
    curve: tuple[float, float, float],
    covariance: FloatArray,
    rms: float,
    friction: Friction,
) -> SpinDownFit:
    of_rate = {"units": "rad s-1"}
    return SpinDownFit(
        {
            "c1_rad_s": ((), curve[0], of_rate),
            "c2_per_s": ((), curve[1], {"units": "s-1"}),
            "c3_rad_s": ((), curve[2], of_rate),
            "covariance": (
                ("coefficient", "coefficient2"),
                covariance,
                {"long_name": "of c1, c2, c3, in products of their units"},
            ),
            "rms_rad_s": ((), rms, of_rate | {"long_name": "rms of the residual"}),
            "coulomb_N_m": ((), friction.coulomb_N_m, {"units": "N m"}),
            "viscous_N_m_s": ((), friction.viscous_N_m_s, {"units": "N m s"}),
            "recorded_rad_s": (
                "time",
                speed,
                of_rate | {"long_name": "size of the wheel's speed, recorded"},
            ),
            "fitted_rad_s": (
                "time",
                spin_down_curve(t, *curve),
                of_rate | {"long_name": "the same as fitted"},
            ),
        },
        coords={"time": ("time", t, {"units": "s"}), "coefficient": ["c1", "c2", "c3"]},
        attrs=provenance("spin_down", source="paper, section 2.2"),
    )


def spin_down_time(friction: Friction, inertia_kg_m2: float, speed_rad_s: float) -> float:
    """Seconds until a free wheel on a fixed body stops: J/mu1 ln(1 + mu1 |W| / mu0) by eq. (5), inf without mu0.

    On a free body the wheel stops sooner by a part J u.inverse(Theta) u, for Philae 0.04 %.
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
    """Speed c1 exp(c2 t) + c3 (rad/s) at times t (s) of a wheel that runs down (paper, section 2.2)."""
    return c1 * np.exp(c2 * t) + c3


LONGEST_BACK = 300.0
"""Times J / mu1 that a speed is followed back: it was e^300 times as large then, which is no wheel's, but still a number."""


def spin_down_speed(
    coulomb_N_m: Any,
    viscous_N_m_s: Any,
    inertia_kg_m2: Any,
    speed_rad_s: npt.ArrayLike,
    t: npt.ArrayLike,
) -> FloatArray:
    """Speed (rad/s) at times t (s) of a wheel begun at `speed_rad_s` on a fixed body; zero once it has stopped.

    J dW/dt = -mu0 - mu1 W (paper, eq. 5) in closed form. All arguments are broadcast; a time before the beginning gives the
    speed that the wheel came from.
    """
    decay = np.asarray(viscous_N_m_s / inertia_kg_m2 * np.asarray(t, dtype=np.float64))
    decay = np.maximum(decay, -LONGEST_BACK)
    small = np.abs(decay) < 1e-8
    relaxed = np.where(small, 1.0 - 0.5 * decay, -np.expm1(-decay) / np.where(small, 1.0, decay))
    left = (
        np.abs(speed_rad_s) * np.exp(-decay) - coulomb_N_m / inertia_kg_m2 * np.asarray(t) * relaxed
    )
    return np.sign(speed_rad_s) * np.maximum(left, 0.0)


def _record(t_s: npt.ArrayLike, wheel_speed_rad_s: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
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
    """The best of a ladder of rates c2: for each, c1 and c3 are linear."""
    best, best_misfit = np.array([speed[0], -1.0 / t[-1], 0.0]), np.inf
    for c2 in -np.geomspace(1e-3, 1e2, 61) / t[-1]:
        design = np.column_stack([np.exp(c2 * t), np.ones_like(t)])
        (c1, c3), *_ = np.linalg.lstsq(design, speed, rcond=None)
        misfit = np.sum((design @ [c1, c3] - speed) ** 2)
        if misfit < best_misfit and c1 > 0 and c3 <= 0:
            best, best_misfit = np.array([c1, c2, c3]), misfit
    return best


def _moved_to_time_zero(
    c1: float, c2: float, covariance: FloatArray, t0: float
) -> tuple[float, FloatArray]:
    """c1 and the covariance for time counted from zero instead of from the first sample t0."""
    factor = np.exp(-c2 * t0)
    jacobian = np.array([[factor, -c1 * t0 * factor, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    return c1 * factor, jacobian @ covariance @ jacobian.T
