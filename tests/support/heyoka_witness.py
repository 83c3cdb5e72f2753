"""heyoka as a witness of the kernels of motion: another Taylor method, other code, equations typed here.

State: momentum H, axial momenta h, and the attitude as a quaternion; directions in space follow from the attitude. A wheel that
comes to rest, breaks away or reverses ends an integration and begins the next one.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from functools import lru_cache

import heyoka as hk
import numpy as np
from scipy.spatial.transform import Rotation

from sunspin.vehicle import Vehicle

TAKE_OFF_RAD = 1e-3
"""A wheel that begins to slip is watched for a stop only after the body has turned so far: its speed is rounding before."""


@dataclass(frozen=True)
class Torques:
    """What acts on the body: constant in body axes, and in space (N m)."""

    body: np.ndarray = field(default_factory=lambda: np.zeros(3))
    space: np.ndarray = field(default_factory=lambda: np.zeros(3))


@dataclass
class Wheel:
    """One wheel between two events: "free", "stuck" or "held", the sign of its speed, the limit of dry friction, and from when it
    is watched for a stop (None: it is)."""

    mode: str
    speed: float
    sign: float
    limit: float
    watch_from: float | None = None


@dataclass(frozen=True)
class Track:
    """What a witness saw at its times: (n, 3), (n, n_wheel), matrices (n, 3, 3), and events (s, wheel, what)."""

    sun_B: np.ndarray
    omega_B: np.ndarray
    speeds: np.ndarray
    attitude: np.ndarray
    events: list[tuple[float, int, str]]


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def times(m, b):
    return [sum((m[i][j] * b[j] for j in range(1, 3)), m[i][0] * b[0]) for i in range(3)]


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def matrix(values):
    return [[values[3 * i + j] for j in range(3)] for i in range(3)]


class Equations:
    """Right-hand side over heyoka's expressions or over numbers.

    `par`: A^-1 (9), K (3), torques (6), then for each wheel axis (3), J, free, signed dry friction, viscous friction, stop watch,
    1 / limit^2, direction of time.
    """

    COMMON, PER_WHEEL = 18, 10

    def __init__(self, state, par, n_wheels):
        self.H, self.h, self.q = state[:3], state[3 : 3 + n_wheels], state[-4:]
        self.wheels = [
            par[self.COMMON + self.PER_WHEEL * i :][: self.PER_WHEEL] for i in range(n_wheels)
        ]
        rest = [self.H[k] - par[9 + k] for k in range(3)]
        for h, w in zip(self.h, self.wheels, strict=True):
            rest = [rest[k] - w[4] * h * w[k] for k in range(3)]
        inverse = matrix(par)
        self.omega = times(inverse, rest)
        self.speeds = [
            h / w[3] - dot(w[:3], self.omega) for h, w in zip(self.h, self.wheels, strict=True)
        ]
        self.friction = [
            -w[4] * (w[5] + w[6] * speed) for w, speed in zip(self.wheels, self.speeds, strict=True)
        ]
        space = self.seen(par[15:18])
        turned = cross(self.H, self.omega)
        self.moment = [turned[k] + par[12 + k] + space[k] for k in range(3)]
        body = self.moment
        for friction, w in zip(self.friction, self.wheels, strict=True):
            body = [body[k] - friction * w[k] for k in range(3)]
        acceleration = times(inverse, body)
        self.holding = [w[3] * dot(w[:3], acceleration) for w in self.wheels]

    def seen(self, v):
        """A vector in N from the body, whose attitude is the quaternion q."""
        x, y, z, w = self.q
        t = [2.0 * c for c in cross([x, y, z], v)]
        u = cross([x, y, z], t)
        return [v[k] + w * t[k] + u[k] for k in range(3)]

    def rates(self):
        x, y, z, w = self.q
        a, b, c = (0.5 * component for component in self.omega)
        turn = [
            -(a * w + b * z - c * y),
            -(b * w + c * x - a * z),
            -(c * w + a * y - b * x),
            a * x + b * y + c * z,
        ]
        return [*self.moment, *self.friction, *turn]


@lru_cache(maxsize=8)
def integrator(n_wheels: int, tolerance: float):
    names = ["Hx", "Hy", "Hz", *(f"h{i}" for i in range(n_wheels)), "qx", "qy", "qz", "qw"]
    variables = hk.make_vars(*names)
    count = Equations.COMMON + Equations.PER_WHEEL * n_wheels
    e = Equations(variables, [hk.par[k] for k in range(count)], n_wheels)
    events = []
    for w, speed, holding in zip(e.wheels, e.speeds, e.holding, strict=True):
        # the constant keeps a wheel that is not watched from zero
        stop = w[7] * speed + (1.0 - w[7] * w[7])
        overload = w[9] * (holding * holding * w[8] - 1.0)
        events.append(hk.t_event(stop, direction=hk.event_direction.negative))
        events.append(hk.t_event(overload, direction=hk.event_direction.positive))
    system, start = list(zip(variables, e.rates(), strict=True)), [0.0] * len(names)
    hk.set_logger_level_error()
    more = {"t_events": events, "tol": tolerance}
    return hk.taylor_adaptive(system, start, pars=[0.0] * count, **more)


class Run:
    """One motion, from event to event."""

    def __init__(self, vehicle: Vehicle, omega, speeds, t, command, torques: Torques):
        self.vehicle, self.torques = vehicle, torques
        self.backward = t[-1] < t[0]
        self.t, self.events = float(t[0]), []
        self.inertia = np.array(vehicle.inertia_kg_m2)
        self.axes = np.array([w.axis_B for w in vehicle.wheels]).reshape(-1, 3)
        self.J = np.array([w.inertia_kg_m2 for w in vehicle.wheels])
        momentum = self.inertia @ omega + (self.J * speeds) @ self.axes
        axial = self.J * (speeds + self.axes @ omega)
        self.y = np.concatenate([momentum, axial, [0.0, 0.0, 0.0, 1.0]])
        self.wheels = []
        for wheel, speed in zip(vehicle.wheels, speeds, strict=True):
            dry = wheel.friction.coulomb_N_m
            if command == "brake":
                dry += wheel.brake_torque_N_m
            mode = "stuck" if speed == 0 and dry > 0 else "free"
            if command == "hold":
                mode, dry = "held", 0.0
            self.wheels.append(Wheel(mode, float(speed), float(np.sign(speed)), dry))
        if not self.backward:
            self.settle()

    def parameters(self) -> np.ndarray:
        tensor, held = self.inertia.copy(), np.zeros(3)
        for w, u, J in zip(self.wheels, self.axes, self.J, strict=True):
            if w.mode == "free":
                tensor -= J * np.outer(u, u)
            else:
                held += J * w.speed * u
        values = [np.linalg.inv(tensor).ravel(), held, self.torques.body, self.torques.space]
        for w, u, J, wheel in zip(self.wheels, self.axes, self.J, self.vehicle.wheels, strict=True):
            free, sense = float(w.mode == "free"), -1.0 if self.backward else 1.0
            watched = w.mode == "free" and w.limit > 0 and w.watch_from is None
            stuck = 1 / w.limit**2 if w.mode == "stuck" else 0.0
            watch = w.sign * sense if watched else 0.0
            numbers = [J, free, w.sign * w.limit, wheel.friction.viscous_N_m_s]
            values += [u, [*numbers, watch, stuck, sense]]
        return np.concatenate(values)

    def equations(self, y: np.ndarray) -> Equations:
        return Equations(list(y), list(self.parameters()), len(self.wheels))

    def settle(self) -> None:
        """Release the stuck wheels that friction cannot hold, the most overloaded first."""
        while True:
            holding = self.equations(self.y).holding
            loads = [
                abs(torque) / w.limit if w.mode == "stuck" else 0.0
                for torque, w in zip(holding, self.wheels, strict=True)
            ]
            if max(loads, default=0.0) <= 1.0:
                return
            self.slip(int(np.argmax(loads)), holding)

    def slip(self, i: int, holding) -> None:
        self.refresh()
        self.wheels[i] = Wheel("free", 0.0, -float(np.sign(holding[i])), self.wheels[i].limit)

    def refresh(self) -> None:
        """Bring the speeds, and h of the wheels that are not free, up to the present state."""
        e = self.equations(self.y)
        for i, w in enumerate(self.wheels):
            if w.mode == "free":
                w.speed = float(e.speeds[i])
            self.y[3 + i] = self.J[i] * (w.speed + self.axes[i] @ np.array(e.omega))

    def watch(self) -> None:
        """Begin to watch wheels that have gathered speed since they began to slip."""
        self.refresh()
        rate = float(np.linalg.norm(self.equations(self.y).omega))
        for w in self.wheels:
            if w.mode != "free" or w.limit == 0:
                continue
            if w.watch_from == self.t:
                w.watch_from = None
                if w.sign * w.speed <= 0:
                    w.mode, w.speed, w.sign = "stuck", 0.0, 0.0
            elif w.watch_from is None and abs(w.speed) < 1e-9:
                delay = TAKE_OFF_RAD / max(rate, 1e-6)
                w.watch_from = self.t + (-delay if self.backward else delay)

    def go(self, end: float, ta):
        """Integrate to an event, to the time from which a wheel is watched, or to the end; return the dense output."""
        choose = max if self.backward else min
        target = end
        for w in self.wheels:
            if w.watch_from is not None:
                target = choose(target, w.watch_from)
        ta.pars[:], ta.state[:], ta.time = self.parameters(), self.y, self.t
        result = ta.propagate_until(target, c_output=True)
        self.y, code = ta.state.copy(), int(result[0])
        happened = -code - 1 if -2 * len(self.wheels) <= code < 0 else None
        self.t = float(ta.time if happened is not None else target)
        self.y_dense, self.w_dense = result[4], copy.deepcopy(self.wheels)
        return happened

    def change(self, happened: int | None, ta) -> None:
        if happened is not None:
            i, breaks_away = divmod(happened, 2)
            self.refresh()
            before = copy.copy(self.wheels[i])
            if breaks_away:
                assert not self.backward
                self.slip(i, self.equations(self.y).holding)
                self.settle()
                self.events.append((self.t, i, "breaks away"))
            else:
                self.wheels[i] = Wheel("stuck", 0.0, 0.0, before.limit)
                self.refresh()
                self.settle()
                stays = self.wheels[i].mode == "stuck"
                assert not (self.backward and stays)
                if self.backward:
                    self.wheels[i] = Wheel("free", 0.0, -before.sign, before.limit)
                self.events.append((self.t, i, "stops" if stays else "reverses"))
        if self.wheels:
            ta.reset_cooldowns()
            self.watch()


def witness(
    vehicle, omega, sun, speeds, t, command="coast", torques=None, tolerance=2.3e-16
) -> Track:
    """The motion at the times `t`, forward or backward, N being the body's axes at the start."""
    torques = Torques() if torques is None else torques
    t, speeds = np.asarray(t, float), np.atleast_1d(np.asarray(speeds, float))
    run = Run(vehicle, np.asarray(omega, float), speeds, t, command, torques)
    ta = copy.deepcopy(integrator(len(run.wheels), tolerance))
    states, rates, wheel_speeds = np.empty((len(t), len(run.y))), np.empty((len(t), 3)), []
    states[0], filled = run.y, 1
    rates[0] = omega
    wheel_speeds.append(speeds)
    run.watch()
    while run.t != t[-1]:
        happened = run.go(t[-1], ta)
        reached = int(np.count_nonzero(t >= run.t if run.backward else t <= run.t))
        for k in range(filled, reached):
            states[k] = run.y_dense(t[k])
            now, run.wheels = run.wheels, run.w_dense
            e = run.equations(states[k])
            rates[k] = e.omega
            wheel_speeds.append(
                [
                    s if w.mode == "free" else w.speed
                    for s, w in zip(e.speeds, run.wheels, strict=True)
                ]
            )
            run.wheels = now
        filled = max(filled, reached)
        run.change(happened, ta)
    attitude = Rotation.from_quat(states[:, -4:])
    return Track(
        attitude.apply(sun),
        rates,
        np.array(wheel_speeds).reshape(len(t), -1),
        attitude.as_matrix(),
        run.events,
    )
