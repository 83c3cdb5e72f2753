"""The unknowns of the posterior and what is known of them beforehand.

A hypothesis is a body rate, a direction to the Sun and a vector `u` of further unknowns, each in units of its prior sigma
about its prior centre, so that its prior is the standard normal. Rates are uniform in a ball, directions on the sphere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp

from sunspin.base.errors import InputError
from sunspin.dynamics import batch
from sunspin.dynamics.bodies import Bodies
from sunspin.dynamics.friction import spin_down_speed
from sunspin.dynamics.torques import NOTHING, Acting, Steady
from sunspin.dynamics.wheel_modes import friction_limit
from sunspin.estimate import inertia
from sunspin.estimate.posterior import tilt
from sunspin.estimate.terms.steady_torque import TURNED, sizes
from sunspin.estimate.terms.steady_torque import unknowns as of_steady_torque
from sunspin.estimate.terms.term import Unknown
from sunspin.vehicle import Vehicle

DEFAULT_MAX_RATE = 0.6
"""rad/s: the ball of rates searched unless the vehicle or the caller says otherwise."""

ASSUMED = {"inertia": inertia.ASSUMED, "wheel_speed": 0.005, "friction": 0.05}
"""Relative sigmas assumed where the vehicle's file states none; known exactly they would make any answer too sure of itself."""

NOISE_SIGMA = 0.3
"""Of the logarithm of the noise about what the vehicle states."""

NOISE_UNKNOWN = 1.0
"""The same where the vehicle states none."""

SCALE_SIGMA = {True: 0.06, False: 1.0}
"""Of the logarithm of the brightness where gains have a unit (cell temperature, distance) and where they are relative."""

MOST_TURNED = 300.0
"""deg by which a steady torque may turn the body over the window, unless the caller says otherwise."""

KEYS = {
    "max_rate_rad_s",
    "steady_torque",
    "inertia",
    "wheel_speed",
    "wheel_inertia",
    "friction",
    "gain",
    "noise",
    "scale",
    "time_s",
    "tilt",
    "tilt_common",
}

MOMENTS = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2)}

MASS = ("inertia", "wheel_inertia")
"""Kinds of unknowns that may describe a body that cannot exist."""

HALVINGS = 30
"""Bisections that find how far the unknowns of kind `MASS` may be from their centres: to 1e-9 of their distance."""

PRIOR_DRAWS = 20_000
"""Draws by which the truncated part of the prior is measured: half of it to 1 %, 3 % of it (moments with wide sigmas) to 4 %."""

COMPUTABLE_ERROR = 1e-7
"""rad: error of the directions in runs by which it is seen whether motions can be computed, that of the finest in fits."""

STANDING = ("scale", "noise", "gain", *tilt.KINDS)
"""Kinds of unknowns on which readings depend and the motion does not."""


@dataclass(frozen=True)
class State:
    """n hypotheses: rates (n, 3) rad/s, directions to the Sun (n, 3), further unknowns (n, k) in prior sigmas."""

    omega: np.ndarray
    sun: np.ndarray
    u: np.ndarray

    def __len__(self) -> int:
        return len(self.omega)

    def take(self, index: Any) -> State:
        return State(self.omega[index], self.sun[index], self.u[index])

    @classmethod
    def joined(cls, parts: list[State]) -> State:
        return cls(
            *(
                np.concatenate([getattr(part, name) for part in parts])
                for name in ("omega", "sun", "u")
            )
        )


@dataclass(frozen=True)
class Model:
    """A vehicle with its unknowns.

    Rates and direction are those at the reference, `after_s` after the first sample, wheel speeds those at the first sample.
    `time_sigma_s` is that of each sample's time tag. `acting`: the torques, their motion beginning at the first sample.

    A steady torque in the axes of `frame` ("": none) is in body axes at the reference, over the mean moment of inertia. Its sigma
    is the widest of those that it may have, all alike beforehand: its `shares` of that. Fits are under one of them, `share`.
    """

    vehicle: Vehicle
    unknowns: tuple[Unknown, ...]
    max_rate: float
    wheel_mode: str | tuple[str, ...] = "coast"
    time_sigma_s: float = 0.0
    after_s: float = 0.0
    acting: Acting = NOTHING
    frame: Literal["", "B", "N"] = ""
    shares: tuple[float, ...] = ()
    share: float = 1.0

    @property
    def precision(self) -> np.ndarray:
        """Of the unknowns' priors (k) in fits, in units of their sigmas."""
        return np.array(
            [self.share**-2 if x.kind == "steady_torque" else 1.0 for x in self.unknowns]
        )

    @property
    def turned(self) -> bool:
        """Whether the motion depends on the turn about the Sun, which is then an unknown."""
        return bool(self.where("turn"))

    def where(self, kind: str) -> list[int]:
        """Places of the unknowns of a kind."""
        return [i for i, unknown in enumerate(self.unknowns) if unknown.kind == kind]

    @property
    def moving(self) -> list[int]:
        """Places of the unknowns on which the motion depends, so that a derivative needs another run."""
        return [i for i, x in enumerate(self.unknowns) if x.kind not in STANDING]

    @cached_property
    def turns(self) -> np.ndarray | None:
        """Turns (k, n_panel, 3) of the panels by one sigma of each unknown; None where they stand as drawn."""
        return tilt.turns(self.vehicle, self.unknowns) if any(map(self.where, tilt.KINDS)) else None

    @property
    def dimension(self) -> int:
        return 5 + len(self.unknowns)

    def values(self, u: np.ndarray) -> np.ndarray:
        """The unknowns in their own units (n, k)."""
        centre, sigma = (
            np.array([getattr(x, key) for x in self.unknowns]) for key in ("centre", "sigma")
        )
        return centre + sigma * u if len(self.unknowns) else u

    def relative(self, u: np.ndarray, kind: str, count: int) -> np.ndarray:
        """Values (n, count) of the unknowns of a kind in the order of their index; 0 for those that are known."""
        out = np.zeros((len(u), count))
        for i in self.where(kind):
            out[:, self.unknowns[i].index] = self.unknowns[i].sigma * u[:, i]
        return out

    def wheel_speeds(self, u: np.ndarray) -> np.ndarray:
        """Speeds at the reference (n, n_wheel), rad/s."""
        speeds = np.tile([wheel.speed_rad_s for wheel in self.vehicle.wheels], (len(u), 1))
        for i in self.where("wheel_speed"):
            speeds[:, self.unknowns[i].index] = (
                self.unknowns[i].centre + self.unknowns[i].sigma * u[:, i]
            )
        if not self.after_s:
            return speeds
        bodies, commands = self.bodies(u), batch.one_command(self.vehicle, self.wheel_mode)
        for i, (wheel, command) in enumerate(zip(self.vehicle.wheels, commands, strict=True)):
            if command != "hold":
                brake = friction_limit(wheel, command) - wheel.friction.coulomb_N_m
                dry, viscous = bodies.coulomb_N_m[:, i] + brake, bodies.viscous_N_m_s[:, i]
                speeds[:, i] = spin_down_speed(
                    dry, viscous, bodies.wheel_inertia_kg_m2[:, i], speeds[:, i], self.after_s
                )
        return speeds

    def rows(self, state: State) -> batch.Rows:
        """Initial states for the kernel."""
        rows = batch.Rows(
            state.omega,
            state.sun,
            self.wheel_speeds(state.u),
            B_from_N=self._attitudes(state) if self.turned else None,
        )
        if not any(
            self.where(kind)
            for kind in ("inertia", "coulomb", "viscous", "wheel_inertia", "steady_torque")
        ):
            return rows
        return replace(rows, bodies=self.bodies(state.u))

    def _attitudes(self, state: State) -> np.ndarray:
        """Quaternions B_from_N (n, 4): the shortest turn that takes the Sun to its direction, and then the unknown one about it."""
        here = replace(self.acting, start_s=self.acting.start_s + self.after_s).here()
        sun_N = np.zeros(3) if here is None else here.sun_N[0]
        shortest = np.concatenate(
            [np.cross(sun_N, state.sun), 1.0 + state.sun @ sun_N[:, None]], axis=1
        )
        across = [
            *np.cross(sun_N, np.eye(3)[np.argmin(np.abs(sun_N))]),
            0.0,
        ]  # half a turn about any axis across, if opposite
        shortest = np.where(
            np.linalg.norm(shortest, axis=1, keepdims=True) < 1e-9, across, shortest
        )
        about = Rotation.from_rotvec(self.relative(state.u, "turn", 1) * state.sun)
        return (about * Rotation.from_quat(shortest)).as_quat()

    def run(
        self,
        rows: batch.Rows,
        times_s: npt.ArrayLike,
        direction_error: float,
        attitude: bool = False,
    ) -> batch.Motion:
        """Motions from initial states at the reference to times from there, all later or all earlier."""
        return batch.run(
            self.vehicle,
            rows,
            times_s,
            command=self.wheel_mode,
            error=direction_error,
            acting=replace(self.acting, start_s=self.acting.start_s + self.after_s),
            attitude=attitude,
            leave_long=True,  # one draw far out in the priors must not end them all
        )

    def possible(self, u: np.ndarray, inside: float = 1.0) -> np.ndarray:
        """Return unknowns (n, k) with bodies that can exist.

        If a body cannot, its inertias are drawn towards their centres, to the part `inside` of the distance at which it could. The
        nominal body can exist, and so can all on the way: the conditions are convex in the tensor, and on the way a wheel has at
        most the inertia of the straight line, as exp is convex.
        """
        mass = [i for kind in MASS for i in self.where(kind)]
        if not mass or not len(u):
            return u
        out = np.flatnonzero(~inertia.is_body(self._bodies(u), self.vehicle))
        if not len(out):
            return u
        low, high = np.zeros(len(out)), np.ones(len(out))
        found = np.array(u)
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            found[out[:, None], mass] = middle[:, None] * u[out[:, None], mass]
            fine = inertia.is_body(self._bodies(found[out]), self.vehicle)
            low, high = np.where(fine, middle, low), np.where(fine, high, middle)
        found[out[:, None], mass] = inside * low[:, None] * u[out[:, None], mass]
        return found

    @cached_property
    def log_truncated(self) -> float:
        """Log of the part of the normal prior that describes bodies that can exist; 0 where all of it does."""
        if not any(map(self.where, MASS)):
            return 0.0
        rng = np.random.default_rng(0)  # the same for all: part of the prior, not of the draws
        u = rng.standard_normal((PRIOR_DRAWS, len(self.unknowns)))
        count = np.count_nonzero(inertia.is_body(self._bodies(u), self.vehicle))
        return float(np.log(max(count, 1) / PRIOR_DRAWS))

    def bodies(self, u: np.ndarray) -> Bodies:
        """Return inertia, wheel inertia, friction and steady torques of each hypothesis.

        A body that cannot exist is replaced by the last that can on the way from the nominal one: runs for derivatives, and from
        starts far out, never have another.
        """
        return self._bodies(self.possible(u))

    def _bodies(self, u: np.ndarray) -> Bodies:
        """Return the bodies that the unknowns describe, also those that cannot exist."""
        wheels = len(self.vehicle.wheels)
        body = Bodies.of(self.vehicle, len(u))
        tensor = np.array(body.inertia_kg_m2)
        for i in self.where("inertia"):
            a, b = divmod(self.unknowns[i].index, 3)
            tensor[:, a, b] += self.unknowns[i].sigma * u[:, i]
            if a != b:
                tensor[:, b, a] += self.unknowns[i].sigma * u[:, i]
        factors = {
            key: np.array(getattr(body, key)) * np.exp(self.relative(u, kind, wheels))
            for key, kind in (
                ("wheel_inertia_kg_m2", "wheel_inertia"),
                ("coulomb_N_m", "coulomb"),
                ("viscous_N_m_s", "viscous"),
            )
        }
        steady = np.zeros((len(u), 2, 3))
        mean = np.trace(self.vehicle.require_inertia()) / 3
        steady[:, "BN".index(self.frame or "B")] = mean * self.relative(u, "steady_torque", 3)
        return replace(body, inertia_kg_m2=tensor, steady_N_m=steady, **factors)

    def log_prior(self, state: State) -> np.ndarray:
        """Return the log density (n) over rad/s cubed, the sphere, and u: minus infinity if the body cannot exist or rotates faster
        than `max_rate`, and normalised over the others."""
        ball = np.log(4 / 3 * np.pi * self.max_rate**3)
        steady = self.where("steady_torque")
        plain = np.delete(state.u, steady, axis=1)
        out = -ball - np.log(4 * np.pi) - 0.5 * np.sum(plain**2 + np.log(2 * np.pi), axis=1)
        if steady:
            share = np.array(self.shares)[:, None]
            each = (
                -0.5 * np.sum(state.u[:, steady] ** 2, axis=1) / share**2
                - 3 * np.log(share)
                - 1.5 * np.log(2 * np.pi)
            )
            out += logsumexp(each, axis=0) - np.log(len(share))
        # a fit that ends on the largest rate may exceed it by rounding
        allowed = np.linalg.norm(state.omega, axis=1) <= self.max_rate * (1 + 1e-12)
        if any(map(self.where, MASS)):
            allowed &= inertia.is_body(self._bodies(state.u), self.vehicle)
            out -= self.log_truncated
        return np.where(allowed, out, -np.inf)


def model(
    vehicle: Vehicle, priors: Mapping[str, Any] | None, brightness: float, wheel_mode: Any = "coast"
) -> tuple[Model, dict[str, str]]:
    """The unknowns of a vehicle under `priors` (see :func:`sunspin.estimate.posterior.posterior`), and where each comes from.

    `brightness` is a first guess of the scale, signal of a panel of gain one at normal incidence.
    """
    vehicle.require_inertia()
    priors = dict(priors or {})
    unknown = sorted(set(priors) - KEYS)
    if unknown:
        raise InputError(
            f"priors know {', '.join(sorted(KEYS))}",
            got=", ".join(map(str, unknown)),
            do="leave it out",
        )
    mode = wheel_mode if isinstance(wheel_mode, str) else tuple(wheel_mode)
    commands = batch.one_command(vehicle, mode)
    told: dict[str, str] = {}
    made = [
        Unknown(
            "log_scale",
            "scale",
            "1",
            float(np.log(brightness)),
            _scale_sigma(vehicle, priors, told),
        )
    ]
    noise = _sigma(
        priors, "noise", None, NOISE_UNKNOWN if vehicle.input_noise is None else NOISE_SIGMA, told
    )
    made.append(Unknown("log_noise", "noise", "1", 0.0, noise))
    made += _wheels(vehicle, priors, commands, told)
    made += _inertia(vehicle, priors, told)
    gain = _sigma(priors, "gain", None, 0.0, told)
    made += [
        Unknown(f"log_gain_{name}", "gain", "1", 0.0, gain, j)
        for j, name in enumerate(vehicle.input_names)
        if gain
    ]
    made += _tilts(vehicle, priors, told)
    limit = (
        priors.get("max_rate_rad_s")
        or vehicle.sensors.disturbance.max_rate_rad_s
        or DEFAULT_MAX_RATE
    )
    if not (np.isfinite(limit) and limit > 0):
        raise InputError("max_rate_rad_s must be positive", got=limit)
    told["rate"] = f"uniform in a ball of {limit:g} rad/s"
    told["steady_torque"] = _most_turned(priors)
    unknown_ = Model(
        vehicle,
        tuple(x for x in made if x.sigma > 0),
        float(limit),
        mode,
        _tags(priors, told),
    )
    if unknown_.log_truncated:
        share = np.exp(unknown_.log_truncated)
        told["inertia"] += f", truncated to bodies that can exist ({share:.2g} of it)"
    return unknown_, told


def require_computable(model_: Model, times_s: np.ndarray, limit_rad_s: float) -> None:
    """Refuse samples at `times_s` (s from the reference) over which the nominal body, at the largest rate, needs too many steps.

    A wheel at a speed in the wrong unit does that. The sentence names a window that is short enough.
    """
    omega = np.full((1, 3), limit_rad_s / np.sqrt(3))
    one = State(omega, np.array([[0.0, 0.0, 1.0]]), np.zeros((1, len(model_.unknowns))))
    rows = model_.rows(one)

    problem = batch.Problem(
        model_.vehicle,
        rows,
        batch.one_command(model_.vehicle, model_.wheel_mode),
        replace(model_.acting, start_s=model_.acting.start_s + model_.after_s),
    )

    def fine(part: float) -> bool:
        ends = part * np.array([times_s.min(), times_s.max()])
        return all(batch.steps_needed(problem, end)[0] <= batch.MAX_STEPS for end in ends)

    part = 1.0
    while not fine(part):
        part /= 2
    if part < 1.0:
        span, speeds = float(np.ptp(times_s)), np.abs(rows.wheel_speed_rad_s).max(initial=0.0)
        raise InputError(
            f"the motion over the {span:.6g} s of the samples needs too many steps",
            got=f"rates up to {limit_rad_s:.3g} rad/s, wheels at {speeds:.3g} rad/s",
            do=f"use {part * span:.3g} s of them at most with --from and --to (begin_s, end_s), or check wheel speeds and inertias",
        )


def under(model_: Model, acting: Acting) -> Model:
    """The model under torques; where they depend on directions beside the Sun's, the turn about the Sun becomes an unknown."""
    turn = (
        (Unknown("turn_about_sun_rad", "turn", "rad", 0.0, np.pi),) if acting.needs_attitude else ()
    )
    return replace(model_, acting=acting, unknowns=model_.unknowns + turn)


def pushed(model_: Model, frame: Literal["B", "N"], duration_s: float, most_deg: float) -> Model:
    """The model under a steady torque that nobody told of, which turns the body by `most_deg` over the readings' time at most."""
    turned = TURNED[TURNED <= np.radians(most_deg) * (1 + 1e-9)]
    tried = sizes(duration_s, turned if len(turned) else np.radians([most_deg]))
    more = of_steady_torque(float(tried[-1]))
    acting_ = replace(model_.acting, torques=(*model_.acting.torques, Steady()))
    shares = tuple((tried / tried[-1]).tolist())
    return replace(
        model_, acting=acting_, frame=frame, shares=shares, unknowns=model_.unknowns + more
    )


def _sigma(
    priors: Mapping[str, Any], key: str, stated: float | None, assumed: float, told: dict[str, str]
) -> float:
    """A relative sigma: the caller's, else the file's, else the assumed one."""
    value, source = assumed, "assumed"
    if stated is not None:
        value, source = stated, "vehicle file"
    if key in priors:
        value, source = priors[key], "given"
    _not_negative(value, f"the prior sigma of {key} must be zero (known) or positive")
    told[key] = f"{value:g} ({source})"
    return float(value)


def _not_negative(value: Any, said: str) -> None:
    """Refuse, as it is `said`, what is no finite number or a negative one."""
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float)
        or not (np.isfinite(value) and value >= 0)
    ):
        raise InputError(said, got=value)


def _tilts(vehicle: Vehicle, priors: Mapping[str, Any], told: dict[str, str]) -> list[Unknown]:
    """Turns of the panels, where the file or the caller says that they may stand off."""
    for key in ("tilt", "tilt_common"):
        _not_negative(
            priors.get(key, 0.0),
            f"the prior sigma of {key} must be zero (known) or positive, in rad",
        )
    own, common, words = tilt.told(priors, vehicle)
    told.update(words)
    if (vehicle.channels or vehicle.throttled) and (own.any() or common):
        what = "the posterior does not know turns of panels that share an input or are throttled"
        got = f"channel {vehicle.channels[0].name!r}" if vehicle.channels else "throttled = true"
        do = "take panels as drawn with --prior tilt=0 --prior tilt_common=0; sigmas of the rates then leave the turns out"
        raise InputError(what, got=got, do=do)
    return tilt.unknowns(vehicle, own, common)


def _most_turned(priors: Mapping[str, Any]) -> str:
    most = priors.get("steady_torque", MOST_TURNED)
    _not_negative(
        most,
        "steady_torque, the most that one may turn the body over the samples, must be zero or positive, in degrees",
    )
    source = "given" if "steady_torque" in priors else "assumed"
    return f"turns by up to {most:g} deg ({source})" if most else f"none ({source})"


def _tags(priors: Mapping[str, Any], told: dict[str, str]) -> float:
    """Sigma of the samples' times in s."""
    value = priors.get("time_s", 0.0)
    _not_negative(value, "time_s, the sigma of the samples' times, must be zero or positive, in s")
    told["time_s"] = f"{value:g} s ({'given' if 'time_s' in priors else 'assumed'})"
    return float(value)


def _stated(vehicle: Vehicle, key: str) -> Any:
    fact = vehicle.facts.get(key)
    return None if fact is None else fact.sigma


def _scale_sigma(vehicle: Vehicle, priors: Mapping[str, Any], told: dict[str, str]) -> float:
    if vehicle.throttled:
        told["scale"] = "free in each sample (throttled)"
        return 0.0
    return _sigma(priors, "scale", None, SCALE_SIGMA[vehicle.gain_unit is not None], told)


def _wheels(
    vehicle: Vehicle, priors: Mapping[str, Any], commands: tuple[str, ...], told: dict[str, str]
) -> list[Unknown]:
    made = []
    for i, (wheel, command) in enumerate(zip(vehicle.wheels, commands, strict=True)):
        at = f"wheel.{wheel.name}"
        tail = "" if len(vehicle.wheels) == 1 else f"_{wheel.name}"
        stated = _stated(vehicle, f"{at}.speed_rad_s")
        speed = abs(wheel.speed_rad_s)
        relative = None if stated is None or not speed else float(stated) / speed
        assumed = ASSUMED["wheel_speed"] if command != "hold" else 0.0  # a motor keeps its speed
        sigma = speed * _sigma(priors, "wheel_speed", relative, assumed, told)
        made.append(
            Unknown(f"wheel_speed{tail}", "wheel_speed", "rad/s", wheel.speed_rad_s, sigma, i)
        )
        stated = _stated(vehicle, f"{at}.inertia_kg_m2")
        relative = None if stated is None else float(stated) / wheel.inertia_kg_m2
        own = _sigma(priors, "wheel_inertia", relative, 0.0, told)
        made.append(Unknown(f"log_wheel_inertia{tail}", "wheel_inertia", "1", 0.0, own, i))
        for kind, key, value in (
            ("coulomb", "coulomb_N_m", wheel.friction.coulomb_N_m),
            ("viscous", "viscous_N_m_s", wheel.friction.viscous_N_m_s),
        ):
            stated = _stated(vehicle, f"{at}.friction.{key}")
            relative = None if stated is None or not value else float(stated) / value
            own = (
                _sigma(priors, "friction", relative, ASSUMED["friction"], told)
                if value and command == "coast"
                else 0.0
            )
            made.append(Unknown(f"log_{kind}{tail}", kind, "1", 0.0, own, i))
    return made


def _inertia(vehicle: Vehicle, priors: Mapping[str, Any], told: dict[str, str]) -> list[Unknown]:
    """The moments, each with the same relative sigma, or the elements for which the file states one."""
    tensor = np.array(vehicle.require_inertia())
    sigma = inertia.stated_sigma(vehicle)
    if sigma is not None and "inertia" not in priors:
        told["inertia"] = "vehicle file"
        return [
            Unknown(
                f"inertia_{'xyz'[a]}{'xyz'[b]}",
                "inertia",
                "kg m2",
                tensor[a, b],
                float(sigma[a, b]),
                3 * a + b,
            )
            for a in range(3)
            for b in range(a, 3)
        ]
    relative = _sigma(priors, "inertia", None, ASSUMED["inertia"], told)
    return [
        Unknown(
            f"inertia_{name}", "inertia", "kg m2", tensor[a, a], relative * tensor[a, a], 3 * a + b
        )
        for name, (a, b) in MOMENTS.items()
    ]
