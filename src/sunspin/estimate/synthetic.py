"""Simulated telemetry of any vehicle: of a given motion, and of a random pass with the errors of real sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.dynamics.propagate import propagate
from sunspin.dynamics.torques import Steady
from sunspin.environment import Surroundings
from sunspin.environment.ephemeris import Ephemeris, utc_from_jd
from sunspin.environment.orbit import Orbit, Source, in_orbit
from sunspin.solve.rotations import matrix_from_quaternion
from sunspin.telemetry.sun import per_panel
from sunspin.telemetry.synthetic import (
    draw_tilts,
    generator,
    noisy_power,
    on_time_grid,
    telemetry_dataset,
)
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import panel_power

EPOCH_UTC = "2000-01-01T12:00:00Z"
"""Epoch if neither the vehicle file nor an orbit gives one."""

NOISE = 0.02
"""Noise of a reading as a part of full Sun, one sigma, if the vehicle file states none. With relative gains the signal of full Sun
is chosen so that the stated noise is this part of it."""

GAIN_ERROR = 0.05
"""Relative error of the gain of each panel of a random pass, one sigma: cells of one batch differ by a few per cent."""

EARTH_LIGHT = (0.02, 0.1)
"""Smallest and largest light of the Earth in a random pass without an orbit, in parts of full Sun: a low orbit has up to a third
over bright ground, and a few per cent over the sea."""

MOMENTS = (0.7, 1.3)
"""Range of the relative moments of inertia in a random pass if the vehicle file does not state the inertia."""

WITHIN_DAYS = 1.0
"""A random pass in an orbit begins within so many days after the epoch of the elements."""

LIT = 0.5
"""A sample that sees more of the Sun's disc than this is in sunlight."""

LEAST_SUNLIT = 0.5
"""A random pass has at least this part of its samples in sunlight."""

TRIES = 1000
"""Largest number of times that are tried for a pass in sunlight."""

DAY_S = 86400.0


@dataclass(frozen=True)
class Truth:
    """The motion behind simulated telemetry, and how the panels see it.

    Attributes
    ----------
    omega_B, sun_B : (3)
        Rate in rad/s and direction to the Sun at ``t_s[0]``, body axes.
    t_s : (n)
        Times of the samples, s from the epoch.
    wheel_speed_rad_s, wheel_mode, torques
        As in :func:`sunspin.propagate`; default: the vehicle's nominal speeds.
    scale : float
        Signal of a panel of gain 1 in full Sun; default: `full_signal_scale`.
    noise : float or (n_input)
        One sigma in the unit of the signal; default: the vehicle's, zero if it states none.
    tilt_B_rad : float or (n_panel, 3)
        Rotation vectors of the panels' normals. A number is the sigma of their angles to each side, which the seed then determines.
    """

    omega_B: npt.ArrayLike
    sun_B: npt.ArrayLike
    t_s: npt.ArrayLike
    wheel_speed_rad_s: npt.ArrayLike | None = None
    wheel_mode: Any = "coast"
    scale: float | None = None
    noise: npt.ArrayLike | None = None
    tilt_B_rad: npt.ArrayLike = 0.0
    torques: Sequence[str | Steady] = ()


def synthetic_telemetry(
    vehicle: Vehicle, truth: Truth | Mapping[str, Any], seed: int = 0
) -> xr.Dataset:
    """Return telemetry of a vehicle that moves as `truth` says. See :func:`sunspin.twin`, which calls this for a vehicle."""
    vehicle.require_panels()
    truth = _checked(truth)
    noise = vehicle.input_noise if truth.noise is None else truth.noise
    rule = "the noise of a twin must be zero or positive"
    noise = per_panel(vehicle, 0.0 if noise is None else noise, np.greater_equal, rule)
    scale = full_signal_scale(vehicle) if truth.scale is None else float(truth.scale)
    speeds = truth.wheel_speed_rad_s
    if speeds is None:
        speeds = [wheel.speed_rad_s for wheel in vehicle.wheels]
    t = on_time_grid(np.atleast_1d(truth.t_s))
    motion = propagate(
        vehicle,
        truth.omega_B,
        truth.sun_B,
        speeds,
        t,
        wheel_mode=truth.wheel_mode,
        torques=truth.torques,
    )
    sun = motion["sun_B"].values
    tilt = _tilt(truth, vehicle, generator(seed, 1))
    exact = panel_power(vehicle, sun)
    if tilt is not None:
        exact = vehicle.response_in().power(sun, tilt=tilt)
    power = noisy_power(vehicle, scale * exact, noise, generator(seed, 0))
    true_values = {
        "omega_B": np.array(truth.omega_B, dtype=np.float64),
        "sun_B": np.array(truth.sun_B, dtype=np.float64),
        "wheel_speed_rad_s": np.atleast_1d(np.array(speeds, dtype=np.float64)),
        "wheel_mode": str(truth.wheel_mode),
        "scale": scale,
        "noise": float(noise[0]) if (noise == noise[0]).all() else noise,
        "seed": seed,
    }
    if tilt is not None:
        true_values["tilt_B_rad"] = tilt.ravel()  # attributes of NetCDF have one dimension
    epoch = vehicle.telemetry.epoch_utc or EPOCH_UTC
    return telemetry_dataset(vehicle, t, power, sun, epoch, true_values)


def full_signal_scale(vehicle: Vehicle) -> float:
    """Return the signal of a panel of gain 1 in full Sun.

    It is 1 if gains have a unit or no noise is stated. Otherwise the noise of the input with the largest gain is the part `NOISE`
    of the full signal of that input.
    """
    noise, gains = vehicle.input_noise, vehicle.input_gains
    if vehicle.gain_unit is not None or noise is None:
        return 1.0
    return float(noise[np.argmax(gains)] / (NOISE * gains.max()))


def _checked(truth: Truth | Mapping[str, Any]) -> Truth:
    """Return the truth; raise `InputError` for unknown or missing fields, or a scale that is not positive."""
    if not isinstance(truth, Truth):
        names = [field.name for field in fields(Truth)]
        wrong = [f"unknown {name}" for name in sorted(set(truth) - set(names))]
        wrong += [f"no {name}" for name in ("omega_B", "sun_B", "t_s") if name not in truth]
        if wrong:
            raise InputError(f"a truth has the fields {', '.join(names)}", got=", ".join(wrong))
        truth = Truth(**truth)
    if truth.scale is not None and not (np.isfinite(truth.scale) and truth.scale > 0):
        raise InputError("the scale of a twin must be positive", got=truth.scale)
    return truth


def _tilt(truth: Truth, vehicle: Vehicle, rng: np.random.Generator) -> np.ndarray | None:
    """Return the rotation vectors (n_panel, 3) of the panels' normals, rad; None if there are no misalignments."""
    given = np.asarray(truth.tilt_B_rad, dtype=np.float64)
    if not np.any(given):
        return None
    shape = (len(vehicle.panels), 3)
    if (
        given.shape not in ((), shape)
        or not np.all(np.isfinite(given))
        or (given.ndim == 0 and given < 0)
    ):
        what = f"tilt_B_rad of a twin is one sigma, or turns of shape {shape}, in rad"
        raise InputError(what, got=given.shape or float(given))
    return given if given.ndim else draw_tilts(vehicle, float(given), rng)


class SimulatedPass(NamedTuple):
    """A random pass: telemetry, true rates (n, 3) in rad/s, and the orbit; None without one."""

    telemetry: xr.Dataset
    omega_B: np.ndarray
    environment: Orbit | None


def simulate_pass(
    vehicle: Vehicle,
    t_s: npt.ArrayLike,
    speed_rad_s: float,
    rng: np.random.Generator,
    *,
    bits: int | None = None,
    orbit: tuple[Source, ...] = (),
) -> SimulatedPass:
    """Simulate a pass of a body that rotates with this speed about a random axis, from a random attitude, its wheels held.

    Readings have noise, and each panel an error of its gain. The Earth shines on the panels as well.

    Parameters
    ----------
    t_s : (n)
        Times of the samples, s.
    bits : int, optional
        Bits of the converter, whose range is 1.2 times full Sun; without them readings have no steps.
    orbit : tuple of element sets or tables of positions, optional
        Eclipses and the light of the Earth are then those of the orbit, at a random time. Otherwise the Sun always shines, and the
        light of the Earth comes from a random direction.
    """
    t_s = on_time_grid(t_s)
    axis, first_quaternion = rng.standard_normal(3), rng.standard_normal(4)
    body = vehicle
    if vehicle.inertia_kg_m2 is None:
        body = replace(vehicle, inertia_kg_m2=np.diag(rng.uniform(*MOMENTS, 3)), wheels=())
    motion = propagate(
        body,
        speed_rad_s * axis / np.linalg.norm(axis),
        np.array([0.0, 0.0, 1.0]),
        [wheel.speed_rad_s for wheel in body.wheels],
        t_s,
        wheel_mode="hold",
        rtol=1e-9,
    )
    # the attitudes of `motion` are relative to that of the first sample, which is random
    first_B_from_N = matrix_from_quaternion(first_quaternion / np.linalg.norm(first_quaternion))
    B_from_N = matrix_from_quaternion(motion["B_from_N"].values) @ first_B_from_N
    if orbit:
        environment, surroundings = _sunlit_orbit(orbit, t_s, rng)
        epoch = environment.epoch_utc
    else:
        environment, epoch = None, vehicle.telemetry.epoch_utc or EPOCH_UTC
        sun, earth = rng.standard_normal((2, 3))
        earth = rng.uniform(*EARTH_LIGHT) * earth / np.linalg.norm(earth)
        n = (len(t_s), 1)
        surroundings = Surroundings(
            sun_N=np.tile(sun / np.linalg.norm(sun), n),
            lit=np.ones(len(t_s)),
            albedo_light_N=np.tile(earth, n),
        )
    lit, earth_N = surroundings.lit, surroundings.albedo_light_N
    assert lit is not None and earth_N is not None  # an orbit knows both
    sun_B, earth_B = (
        np.einsum("nij,nj->ni", B_from_N, vector) for vector in (surroundings.sun_N, earth_N)
    )
    of_sun = panel_power(vehicle, sun_B) * lit[:, None]
    power = _readings(vehicle, of_sun, earth_B, bits, rng)
    telemetry = telemetry_dataset(vehicle, t_s, power, sun_B, epoch, {})
    return SimulatedPass(telemetry, motion["omega_B"].values, environment)


def _sunlit_orbit(
    sources: tuple[Source, ...], t_s: np.ndarray, rng: np.random.Generator
) -> tuple[Orbit, Surroundings]:
    """Return an orbit at a random time of the sources, and its surroundings at times t_s (n) after it, enough of them sunlit."""
    first_jd, days = sum(sources[0].epoch_jd), WITHIN_DAYS
    if isinstance(sources[0], Ephemeris):
        first_jd, last_jd = sources[0].span_jd
        days = last_jd - first_jd - t_s[-1] / DAY_S
    if days < 0:
        raise InputError("the table of positions is shorter than a pass", got=f"{t_s[-1]:.0f} s")
    for _ in range(TRIES):
        epoch = utc_from_jd(first_jd + days * rng.uniform())
        try:
            orbit = in_orbit(sources, epoch, t_s)
        except InputError:  # a gap of the table
            continue
        surroundings = orbit.at(t_s)
        assert surroundings.lit is not None  # an orbit knows it
        if (surroundings.lit > LIT).mean() >= LEAST_SUNLIT:
            return orbit, surroundings
    raise InputError(
        "no pass of this length is half in sunlight",
        got=f"{t_s[-1]:.0f} s",
        do="choose shorter intervals or fewer samples",
    )


def _readings(
    vehicle: Vehicle,
    of_sun: np.ndarray,
    earth_B: np.ndarray,
    bits: int | None,
    rng: np.random.Generator,
) -> np.ndarray:
    """Return the readings (n, n_input) of panels with errors, from the exact signals of the Sun (n, n_input).

    `earth_B` (n, 3): light of the Earth in parts of full Sun, body axes. Errors are noise, gains and, with `bits`, rounding.
    """
    size = np.linalg.norm(earth_B, axis=1)
    to_earth = earth_B / np.where(size > 0, size, 1.0)[:, None]
    scale = full_signal_scale(vehicle)
    exact = scale * (of_sun + panel_power(vehicle, to_earth) * size[:, None])
    full = scale * np.max(panel_power(vehicle, vehicle.panel_normals_B), axis=0)  # of each input
    noise = NOISE * full if vehicle.input_noise is None else vehicle.input_noise
    gain = 1 + GAIN_ERROR * rng.standard_normal(exact.shape[1])
    read = np.maximum(exact * gain + noise * rng.standard_normal(exact.shape), 0.0)
    if bits is None:
        return read
    step = 1.2 * full.max() / (2**bits - 1)
    return np.round(read / step) * step
