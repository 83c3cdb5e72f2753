"""Simulated telemetry of any vehicle: of a given motion ("twin"), and of a random pass with the errors of real sensors."""

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
"""Noise of a reading, one sigma, as a part of full Sun, if the vehicle file states none. If gains have no unit, the signal in full
Sun is chosen so that the stated noise is this part of it."""

GAIN_ERROR = 0.05
"""Relative error of the gain of each panel of a random pass, one sigma: cells of one batch differ by a few per cent."""

EARTH_LIGHT = (0.02, 0.1)
"""Limits of the Earth's light in a random pass without an orbit, in parts of full Sun. In a low orbit it is up to a third over
bright ground, and a few per cent over the sea."""

MOMENT_RANGE = (0.7, 1.3)
"""Range of the relative moments of inertia in a random pass if the vehicle file does not state the inertia."""

WITHIN_DAYS = 1.0
"""A random pass in an orbit begins within this number of days after the epoch of the elements."""

LIT_FRACTION, LEAST_SUNLIT = 0.5, 0.5
"""Visible part of the Sun's disc above which a sample is in sunlight; smallest part of the samples of a random pass in sunlight."""

MOST_TRIES = 1000
"""Largest number of random times that are tried to find a pass in sunlight."""

DAY_S = 86400.0


@dataclass(frozen=True)
class Truth:
    """The motion behind simulated telemetry, and the signals of the panels.

    Attributes
    ----------
    omega_B, sun_B : (3), rate in rad/s and direction to the Sun at ``t_s[0]``, body axes
    t_s : (n), times of the samples, s from the epoch
    wheel_speed_rad_s, wheel_mode, torques : as in :func:`sunspin.propagate`; default: the vehicle's nominal speeds
    scale : signal of a panel of gain 1 in full Sun; default: `full_signal_scale`
    noise : number or (n_input), one sigma in the unit of the signal; default: the vehicle's, zero if it states none
    tilt_B_rad : (n_panel, 3), rotation vectors of the panels' normals (rad, B); or the sigma of their two components across the
        normal, with which they are drawn
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
    """Return simulated telemetry of a vehicle with the motion `truth`, as :func:`sunspin.twin` documents."""
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
        # attributes of NetCDF have one dimension
        true_values["tilt_B_rad"] = tilt.ravel()
    epoch = vehicle.telemetry.epoch_utc or EPOCH_UTC
    return telemetry_dataset(vehicle, t, power, sun, epoch, true_values)


def full_signal_scale(vehicle: Vehicle) -> float:
    """Return the signal of a panel of gain 1 in full Sun, in the unit of the readings.

    It is 1 if gains have a unit, or if the vehicle file states no noise. Otherwise gains are relative and noise is in the unit of
    the readings: the noise of the input with the largest gain is then taken as `NOISE` times its signal in full Sun.
    """
    noise, gains = vehicle.input_noise, vehicle.input_gains
    if vehicle.gain_unit is not None or noise is None:
        return 1.0
    return float(noise[np.argmax(gains)] / (NOISE * gains.max()))


def _checked(truth: Truth | Mapping[str, Any]) -> Truth:
    """Return `truth` as a `Truth`; raise `InputError` for unknown or missing fields, or a scale that is not positive."""
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
    """Return the rotation vectors (n_panel, 3) of the panels' normals (rad, B), drawn if only a sigma is given; None if zero."""
    given = np.asarray(truth.tilt_B_rad, dtype=np.float64)
    if not np.any(given):
        return None
    shape = (len(vehicle.panels), 3)
    valid = given.shape in ((), shape) and np.all(np.isfinite(given))
    if not valid or (given.ndim == 0 and given < 0):
        what = f"tilt_B_rad of a twin is one sigma, or turns of shape {shape}, in rad"
        raise InputError(what, got=given.shape or float(given))
    return given if given.ndim else draw_tilts(vehicle, float(given), rng)


class SimulatedPass(NamedTuple):
    """A random pass: simulated telemetry, true rates (n, 3) in rad/s, body axes, and the orbit, or None."""

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
    """Return a simulated pass of a body without torques: its attitude and the axis of its first rate are random, its wheels held.

    The readings have noise, an error of the gain of each panel, and the light of the Earth. Without an inertia in the vehicle file
    the moments are random (`MOMENT_RANGE`), and there are no wheels.

    Parameters
    ----------
    t_s : (n), times of the samples, s
    speed_rad_s : angular speed at the first sample
    rng : generator of all random numbers
    bits : bits of the converter, whose range is 1.2 times full Sun; None: readings are not rounded
    orbit : element sets or tables of positions. The pass begins at a random time in the orbit, which gives eclipses and the light
        of the Earth. If empty, the Sun always shines, and the light of the Earth comes from a random direction
    """
    t_s = on_time_grid(t_s)
    axis, first_quaternion = rng.standard_normal(3), rng.standard_normal(4)
    body = vehicle
    if vehicle.inertia_kg_m2 is None:
        # relative moments only, in which the momentum of wheels is not known: `rates` leaves them out too
        body = replace(vehicle, inertia_kg_m2=np.diag(rng.uniform(*MOMENT_RANGE, 3)), wheels=())
    omega_B = speed_rad_s * axis / np.linalg.norm(axis)
    speeds = [wheel.speed_rad_s for wheel in body.wheels]
    # `propagate` needs a direction to the Sun; only the rates and relative attitudes of its result are used
    z_B = np.array([0.0, 0.0, 1.0])
    motion = propagate(body, omega_B, z_B, speeds, t_s, wheel_mode="hold", rtol=1e-9)
    # the attitudes of `motion` are relative to that of the first sample, which gets a random one
    first_B_from_N = matrix_from_quaternion(first_quaternion / np.linalg.norm(first_quaternion))
    B_from_N = matrix_from_quaternion(motion["B_from_N"].values) @ first_B_from_N
    if orbit:
        environment, surroundings = _sunlit_orbit(orbit, t_s, rng)
        epoch = environment.epoch_utc
    else:
        environment, epoch = None, vehicle.telemetry.epoch_utc or EPOCH_UTC
        sun, earth = rng.standard_normal((2, 3))
        earth = rng.uniform(*EARTH_LIGHT) * earth / np.linalg.norm(earth)
        repeats = (len(t_s), 1)
        surroundings = Surroundings(
            sun_N=np.tile(sun / np.linalg.norm(sun), repeats),
            lit=np.ones(len(t_s)),
            albedo_light_N=np.tile(earth, repeats),
        )
    lit, earth_N = surroundings.lit, surroundings.albedo_light_N
    # an orbit gives both
    assert lit is not None and earth_N is not None
    sun_B, earth_B = (
        np.einsum("nij,nj->ni", B_from_N, vector) for vector in (surroundings.sun_N, earth_N)
    )
    sunlight = panel_power(vehicle, sun_B) * lit[:, None]
    power = _readings(vehicle, sunlight, earth_B, bits, rng)
    telemetry = telemetry_dataset(vehicle, t_s, power, sun_B, epoch, {})
    return SimulatedPass(telemetry, motion["omega_B"].values, environment)


def _sunlit_orbit(
    sources: tuple[Source, ...], t_s: np.ndarray, rng: np.random.Generator
) -> tuple[Orbit, Surroundings]:
    """Return an orbit whose epoch is a random time, and its surroundings `t_s` (n), s, after it, of which enough are in sunlight.

    `sources`: element sets, or tables of positions that limit the time.
    """
    first_jd, days = sum(sources[0].epoch_jd), WITHIN_DAYS
    if isinstance(sources[0], Ephemeris):
        first_jd, last_jd = sources[0].span_jd
        days = last_jd - first_jd - t_s[-1] / DAY_S
    if days < 0:
        raise InputError("the table of positions is shorter than a pass", got=f"{t_s[-1]:.0f} s")
    for _ in range(MOST_TRIES):
        epoch = utc_from_jd(first_jd + days * rng.uniform())
        try:
            orbit = in_orbit(sources, epoch, t_s)
        except InputError:
            # the time is in a gap of the table
            continue
        surroundings = orbit.at(t_s)
        assert surroundings.lit is not None
        if (surroundings.lit > LIT_FRACTION).mean() >= LEAST_SUNLIT:
            return orbit, surroundings
    raise InputError(
        "no pass of this length is half in sunlight",
        got=f"{t_s[-1]:.0f} s",
        do="choose shorter intervals or fewer samples",
    )


def _readings(
    vehicle: Vehicle,
    sunlight: np.ndarray,
    earth_B: np.ndarray,
    bits: int | None,
    rng: np.random.Generator,
) -> np.ndarray:
    """Return the readings (n, n_input) of panels with noise, gain errors and, with `bits`, rounding.

    `sunlight` (n, n_input): exact signals of the Sun at a scale of one; `earth_B` (n, 3): vector to the light of the Earth, as long
    as that light in parts of full Sun, body axes.
    """
    size = np.linalg.norm(earth_B, axis=1)
    to_earth = earth_B / np.where(size > 0, size, 1.0)[:, None]
    scale = full_signal_scale(vehicle)
    exact = scale * (sunlight + panel_power(vehicle, to_earth) * size[:, None])
    # largest signal of each input
    full = scale * np.max(panel_power(vehicle, vehicle.panel_normals_B), axis=0)
    noise = NOISE * full if vehicle.input_noise is None else vehicle.input_noise
    gain = 1 + GAIN_ERROR * rng.standard_normal(exact.shape[1])
    read = np.maximum(exact * gain + noise * rng.standard_normal(exact.shape), 0.0)
    if bits is None:
        return read
    step = 1.2 * full.max() / (2**bits - 1)
    return np.round(read / step) * step
