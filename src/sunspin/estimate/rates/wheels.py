"""How fast the wheels turn while a satellite is watched: measured, held at their nominal speed, or coasting against friction.

The smoother of :mod:`sunspin.estimate.rates` needs the wheels' momentum at every sample. Given as a function of time it is exact
whatever torque makes it so; what a coasting wheel gains from the body's own turning is below J / Theta of it and left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr

from sunspin.dynamics.friction import spin_down_speed
from sunspin.estimate.rates.motion import mean_moment
from sunspin.estimate.wheel_speeds import filled
from sunspin.vehicle import Vehicle

MEASURED = "measured"
HELD = "held at the nominal speed"
COASTING = "coasting from the nominal speed at the first sample"


def wheel_momenta(vehicle: Vehicle, telemetry: xr.Dataset) -> dict[str, np.ndarray]:
    """What the wheels may be doing -> their momentum at each sample (n, 3), in mean moments of inertia times rad/s.

    Measured speeds leave one possibility. Without them the wheels are held, or coast with the friction of the vehicle file or
    with one of its alternatives: which, is for the data to say.
    """
    t = np.asarray(telemetry["time"], dtype=np.float64)
    if vehicle.inertia_kg_m2 is None or not vehicle.wheels:
        return {"none": np.zeros((len(t), 3))}
    return {
        what: _momentum(vehicle, speed)
        for what, speed in wheel_speeds(vehicle, telemetry, t).items()
    }


def wheel_speeds(vehicle: Vehicle, telemetry: xr.Dataset, t: np.ndarray) -> dict[str, np.ndarray]:
    """What the wheels may be doing -> their speeds (n, n_wheel), rad/s, at times t (n), s from the epoch; those that coast do so
    from the first sample."""
    if "wheel_speed_rad_s" in telemetry:
        return {MEASURED: filled(t, telemetry, vehicle)}
    nominal = np.array([wheel.speed_rad_s for wheel in vehicle.wheels])
    found = {HELD: np.broadcast_to(nominal, (len(t), len(nominal)))}
    if np.any(nominal):
        begin = float(telemetry["time"].values[0])
        names = dict.fromkeys(
            name for wheel in vehicle.wheels for name in wheel.alternative_frictions
        )
        for name in (None, *names):
            frictions = [
                w.friction if name is None else w.alternative_frictions.get(name, w.friction)
                for w in vehicle.wheels
            ]
            if any(friction.coulomb_N_m or friction.viscous_N_m_s for friction in frictions):
                speed = [
                    spin_down_speed(
                        f.coulomb_N_m, f.viscous_N_m_s, w.inertia_kg_m2, w.speed_rad_s, t - begin
                    )
                    for w, f in zip(vehicle.wheels, frictions, strict=True)
                ]
                found[COASTING + (f", friction {name!r}" if name else "")] = np.stack(speed, axis=1)
    return found


def momentum_of_each(vehicle: Vehicle, telemetry: xr.Dataset, doing: str) -> np.ndarray:
    """Momentum (n_wheel, n, 3) of each wheel at each sample, in mean moments of inertia times rad/s; `doing`: what the wheels do, a
    key of :func:`wheel_momenta`, with or without its evidence."""
    name = doing.split(" (evidence")[0]
    every = wheel_momenta(vehicle, telemetry)
    if name not in every or vehicle.inertia_kg_m2 is None:
        return np.zeros((0, telemetry.sizes["time"], 3))
    shares = np.zeros((len(vehicle.wheels), *every[name].shape))
    for k in range(len(shares)):
        turned = tuple(
            replace(w, axis_B=-np.asarray(w.axis_B)) if i == k else w
            for i, w in enumerate(vehicle.wheels)
        )
        shares[k] = (
            every[name] - wheel_momenta(replace(vehicle, wheels=turned), telemetry)[name]
        ) / 2
    return shares


def _momentum(vehicle: Vehicle, speed: np.ndarray) -> np.ndarray:
    axes = np.array([wheel.inertia_kg_m2 * np.asarray(wheel.axis_B) for wheel in vehicle.wheels])
    return speed @ axes / mean_moment(vehicle)
