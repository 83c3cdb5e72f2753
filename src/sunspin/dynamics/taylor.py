"""The reference integrator: heyoka's Taylor method over :mod:`sunspin.dynamics.gyrostat`, compiled once per wheel count and
list of torques.

Everything about a vehicle and its wheels' modes is a run-time parameter, so one compiled integrator serves them all.
"""

from __future__ import annotations

import threading
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from sunspin.base.lazy import lazy
from sunspin.dynamics import gyrostat as g
from sunspin.dynamics.torques.acting import (
    Torque,
    carried_names,
    directions_of,
    n_parameters,
    outside,
)
from sunspin.dynamics.wheel_modes import Turning, WheelState, parameters
from sunspin.vehicle import Vehicle

if TYPE_CHECKING:
    import heyoka as hk
else:
    hk = lazy("heyoka")

_COMMON = 9  # parameters of the body: 6 elements of A^-1, 3 of K
_PER_WHEEL = 11  # axis 3, 1/J, free, coulomb, viscous, J, stop watch, 1/limit^2, direction of time
_local = threading.local()


def _symbols(n_wheels: int, torques: tuple[Torque, ...]) -> tuple[g.Parameters, list]:
    """`Parameters` over heyoka's run-time parameters, and per wheel (J, stop watch, 1/limit^2, direction of time)."""
    par = hk.par
    wheels, extras = [], []
    for i in range(n_wheels):
        at = _COMMON + _PER_WHEEL * i
        axis = (par[at], par[at + 1], par[at + 2])
        wheels.append(g.WheelParameters(axis, par[at + 3], par[at + 4], par[at + 5], par[at + 6]))
        extras.append((par[at + 7], par[at + 8], par[at + 9], par[at + 10]))
    body = tuple(par[k] for k in range(6))
    at = _COMMON + _PER_WHEEL * n_wheels
    acting = outside(torques, [par[at + k] for k in range(n_parameters(torques))])
    return g.Parameters(body, (par[6], par[7], par[8]), tuple(wheels), acting), extras


@lru_cache(maxsize=8)
def _compiled(n_wheels: int, torques: tuple[Torque, ...], tol: float):
    """The integrator: state H (3), h (n_wheels), r (3), what torques need of directions, B_from_N (4); events stop_i and
    breakaway_i per wheel.

    Stop of wheel i: watch * W falls through zero, watch = sign of W (times the direction of time), 0 where not watched.
    Breakaway: (holding torque / limit)^2 rises through 1.
    """
    names = ["Hx", "Hy", "Hz", *(f"h{i}" for i in range(n_wheels)), "rx", "ry", "rz"]
    names += [*carried_names(torques), "qx", "qy", "qz", "qw"]
    variables = hk.make_vars(*names)
    H, h, q = variables[:3], variables[3 : 3 + n_wheels], variables[-4:]
    directions = directions_of(torques, variables[3 + n_wheels : -4])
    p, extras = _symbols(n_wheels, torques)
    dH, dh, dr = g.rhs(H, h, directions, p, hk.time)
    omega = g.body_rate(H, h, p)
    rates = [*dH, *dh, *dr, *g.quaternion_rate(q, omega)]
    events = []
    for i, (inertia, watch, inverse_limit2, sense) in enumerate(extras):
        speed = g.wheel_speed(h[i], omega, p.wheels[i])
        torque = g.holding_torque(H, h, p, p.wheels[i], inertia, directions, hk.time)
        # the constant keeps an unwatched event away from zero
        stop = watch * speed + (1.0 - watch * watch)
        events.append(hk.t_event(stop, direction=hk.event_direction.negative))
        overload = sense * (torque * torque * inverse_limit2 - 1.0)
        events.append(hk.t_event(overload, direction=hk.event_direction.positive))
    rates = [
        rate + 0.0 * variables[0] if not isinstance(rate, hk.expression) else rate for rate in rates
    ]
    pars = [0.0] * (_COMMON + _PER_WHEEL * n_wheels + n_parameters(torques))
    system = list(zip(variables, rates, strict=True))
    hk.set_logger_level_error()  # without a folder for its cache it warns on standard output
    return hk.taylor_adaptive(system, [0.0] * len(names), pars=pars, t_events=events, tol=tol)


def integrator(n_wheels: int, torques: tuple[Torque, ...], tol: float) -> Any:
    """This thread's copy of the compiled integrator (an integrator holds state and must not be shared)."""
    import copy

    cache = _local.__dict__.setdefault("integrators", {})
    if (n_wheels, torques, tol) not in cache:
        cache[n_wheels, torques, tol] = copy.deepcopy(_compiled(n_wheels, torques, tol))
    return cache[n_wheels, torques, tol]


def parameter_values(
    vehicle: Vehicle, states: tuple[WheelState, ...], backward: bool, outside_values: np.ndarray
) -> np.ndarray:
    """The run-time parameters for this vehicle with its wheels in these states, those of torques last."""
    p = parameters(vehicle, states)
    values = [*p.inverse, *p.held_momentum]
    for wheel, state, w in zip(vehicle.wheels, states, p.wheels, strict=True):
        watched = state.turning is Turning.FREE and state.limit > 0 and state.watch_from is None
        sense = -1.0 if backward else 1.0
        watch = state.sign * sense if watched else 0.0
        inverse_limit2 = 1.0 / state.limit**2 if state.turning is Turning.STUCK else 0.0
        values += [*w.axis, w.inverse_inertia, w.free, w.coulomb, w.viscous]
        values += [wheel.inertia_kg_m2, watch, inverse_limit2, sense]
    return np.array([*values, *outside_values])
