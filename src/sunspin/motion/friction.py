"""Friction from a spin-down test, and how long a wheel takes to stop."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import curve_fit

from sunspin.errors import InputError, sentence
from sunspin.vehicle import Friction


class SpinDown(NamedTuple):
    """The fit ``c1 exp(c2 t) + c3`` (rad/s, 1/s, rad/s), its covariance (3, 3) and the friction that it means."""

    c1_rad_s: float
    c2_per_s: float
    c3_rad_s: float
    covariance: np.ndarray
    friction: Friction


def spin_down_curve(t_s: npt.ArrayLike, c1: float, c2: float, c3: float) -> np.ndarray:
    """Wheel speed c1 exp(c2 t) + c3 in rad/s (paper, section 2.2)."""
    return c1 * np.exp(c2 * np.asarray(t_s, dtype=np.float64)) + c3


def fit_spin_down(t_s: npt.ArrayLike, wheel_speed_rad_s: npt.ArrayLike, inertia_kg_m2: float) -> SpinDown:
    """Fit the speed record (n) of a freely coasting wheel, body at rest, and derive its friction.

    The record must cover the slowing only, with positive speeds; `inertia_kg_m2` is the wheel's axial inertia.
    """
    t, speed = np.asarray(t_s, dtype=np.float64), np.asarray(wheel_speed_rad_s, dtype=np.float64)
    if t.shape != speed.shape or t.ndim != 1 or t.size < 4 or not (np.isfinite(t).all() and np.isfinite(speed).all()):
        raise InputError(sentence("a spin-down fit needs at least 4 finite times and speeds", got=f"{t.shape}, {speed.shape}"))
    if not (np.all(np.diff(t) > 0) and speed[0] > speed[-1]):
        raise InputError(sentence("the spin-down record must have increasing times and a falling speed"))
    scale = t[-1] - t[0]
    drop = speed[0] - speed[-1]
    guess = (2 * drop, -1 / scale, speed[0] - 2 * drop)
    best, covariance = curve_fit(spin_down_curve, t - t[0], speed, p0=guess, x_scale=np.abs(guess), maxfev=10_000)
    c1, c2, c3 = (float(value) for value in best)
    # c1 refers to t = 0 of the record as given
    return SpinDown(c1 * np.exp(-c2 * t[0]), c2, c3, covariance, Friction.from_spin_down(c1, c2, c3, inertia_kg_m2))


def spin_down_time(friction: Friction, inertia_kg_m2: float, speed_rad_s: float) -> float:
    """Seconds until a wheel on a body at rest stops from `speed_rad_s`: J/mu1 ln(1 + mu1 W / mu0), closed form."""
    speed = abs(speed_rad_s)
    if friction.coulomb_N_m == 0:
        return np.inf if speed > 0 else 0.0
    if friction.viscous_N_m_s == 0:
        return inertia_kg_m2 * speed / friction.coulomb_N_m
    rate = friction.viscous_N_m_s / inertia_kg_m2
    return float(np.log1p(friction.viscous_N_m_s * speed / friction.coulomb_N_m) / rate)
