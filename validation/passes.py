"""Simulated passes with known motion, of every kind for which a verdict of `rates` may be wrong. All telemetry is synthetic.

They are made without the package's own dynamics: Euler's equations with a torque are integrated by a Runge-Kutta method, and the
light on a panel is gain times cosine.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from sunspin import rates
from sunspin.base.errors import SunspinError
from sunspin.estimate.verdict import DECIDED, NARROWER
from sunspin.vehicle import Panel, TelemetryForm, Vehicle, Wheel
from sunspin.vehicle.sensors import Gyro, Magnetometer, Sensors
from validation.truths import is_listed, is_wrong

FACES = np.vstack([np.eye(3), -np.eye(3)])
NAMES = ("+x", "+y", "+z", "-x", "-y", "-z")
MOMENTS = np.array([0.042, 0.05, 0.03])
GYRO = Gyro(("x", "y", "z"), 1.0, np.zeros(3), 2e-3, zero_sigma=np.full(3, 2e-3), scale_sigma=0.01)
STEP_S = 0.25

CHANGE, STRONG = np.radians(1.0), np.radians(3.0)
"""Change of the rate by a torque or a step over a pass in rad/s, and that by a strong torque."""

# The position of a kind is part of its seed: new kinds are appended.
KINDS = {
    "right model": 24,
    "steady torque": 12,
    "step of the rate": 12,
    "jitter": 12,
    "columns exchanged": 12,
    "stop and go": 12,
    "prior given back": 12,
    "strong torque in the body": 12,
    "strong torque in space": 12,
    "slews": 12,
    "time tags": 12,
    "few samples": 40,
    "few samples, bad readings": 40,
    "slow": 12,
    "60 s apart": 12,
    "even, sampled as jitter": 12,
    "slow, wide range": 120,
    "exchanged, six panels": 48,
    "four sides": 24,
    "inertia unknown": 24,
    **{f"fault: {name}": 12 for name in ("albedo", "power limited", "dead string", "quantised")},
    "fault: gyro zero off": 12,
    "wheel braked": 12,
}
"""Number of passes of each kind. The scoreboard makes four of each, or with --full half of them, for each seed."""

AT_ALL_SAMPLES = ("wheel braked",)
"""Kinds that are judged at all samples of a pass, and not only in its middle: the motion changes there."""

ZERO_OFF = np.radians(0.5)
"""Error in rad/s of each axis of a gyro whose zero the vehicle file takes for known."""

Push = Callable[[float, np.ndarray], np.ndarray]
"""Function from time and attitude B_from_N to an angular acceleration (3) in body axes."""

BRAKING_S = 20.0
"""Time in s that a wheel is braked."""

Momentum = Callable[[float], tuple[np.ndarray, np.ndarray]]
"""Function from time to the momentum (3) of the wheels in body axes and its derivative, in the unit of the moments times rad/s."""


class SimulatedPass(NamedTuple):
    """A vehicle, its telemetry, the true rates (n, 3) in rad/s, and the largest rate that is stated.

    `exchanged`: names of the two panels whose columns are exchanged in the file, empty if none are.
    """

    vehicle: Vehicle
    telemetry: xr.Dataset
    omega: np.ndarray
    max_rate_rad_s: float
    exchanged: tuple[str, ...] = ()


def unit(rng: np.random.Generator) -> np.ndarray:
    """Draw a direction (3), uniform on the sphere."""
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def spin(
    omega: np.ndarray,
    t_s: np.ndarray,
    push: Push | None = None,
    moments: np.ndarray = MOMENTS,
    wheels: Momentum | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return rates (n, 3) and attitudes (n, 3, 3) from space to body of a body with these principal moments (3) at times (n).

    `omega` (3) in rad/s and the identity at the first time; `push` is an angular acceleration in addition to the free motion, and
    `wheels` the momentum that wheels carry.
    """

    def change(w: np.ndarray, t: float, attitude: np.ndarray) -> np.ndarray:
        """Return dw/dt of Euler's equations in principal axes."""
        if wheels is None:
            return np.cross(moments * w, w) / moments + (0.0 if push is None else push(t, attitude))
        # the total momentum I w + h is constant in space: what a wheel loses the body gains
        h, change_of_h = wheels(t)
        return (np.cross(moments * w + h, w) - change_of_h) / moments

    rates, attitudes, w, attitude, now = [], [], np.array(omega), np.eye(3), float(t_s[0])
    for t in t_s:
        steps = max(1, int(np.ceil((t - now) / STEP_S)))
        h = (t - now) / steps
        for _ in range(steps if h > 0 else 0):
            a = change(w, now, attitude)
            b = change(w + h / 2 * a, now + h / 2, attitude)
            c = change(w + h / 2 * b, now + h / 2, attitude)
            new = w + h / 6 * (a + 2 * b + 2 * c + change(w + h * c, now + h, attitude))
            attitude = Rotation.from_rotvec(-h * (w + new) / 2).as_matrix() @ attitude
            w, now = new, now + h
        rates.append(w)
        attitudes.append(attitude)
    return np.array(rates), np.array(attitudes)


def observe(
    normals: np.ndarray,
    omega: np.ndarray,
    attitude: np.ndarray,
    t_s: np.ndarray,
    noise: float,
    rng: np.random.Generator,
    gyro: bool = False,
    max_rate_rad_s: float = 0.15,
) -> SimulatedPass:
    """Return the readings of panels with these normals (n_panel, 3), and of a gyro if there is one, during a motion."""
    names = NAMES if len(normals) == len(NAMES) else tuple(f"p{i}" for i in range(len(normals)))
    panels = tuple(Panel(name, normal, 1.0) for name, normal in zip(names, normals, strict=True))
    vehicle = Vehicle(
        "simulated",
        inertia_kg_m2=np.diag(MOMENTS),
        gain_unit="W",
        panels=panels,
        telemetry=TelemetryForm(noise=noise),
        sensors=Sensors(gyro=GYRO) if gyro else Sensors(),
    )
    light = np.maximum((attitude @ unit(rng)) @ normals.T, 0.0)  # of a Sun in a random direction
    power = np.maximum(light + noise * rng.normal(size=light.shape), 0.0)
    data = {
        "power_W": (("time", "panel"), power),
        "flag": ("time", np.zeros(len(t_s), dtype=np.uint8)),
    }
    if gyro:
        scale_error, zero_error = rng.normal(), rng.normal(size=3)
        rates = omega * (1 + GYRO.scale_sigma * scale_error) + GYRO.zero_sigma * zero_error
        data["gyro_B"] = (("time", "axis"), rates + GYRO.noise_rad_s * rng.normal(size=omega.shape))
    attrs = {"epoch_utc": "2026-01-01T00:00:00Z", "synthetic": 1}
    return SimulatedPass(
        vehicle, xr.Dataset(data, {"time": t_s, "panel": list(names)}, attrs), omega, max_rate_rad_s
    )


def draw_times(rng: np.random.Generator, count: int, interval_s: float) -> np.ndarray:
    """Draw `count` times in s with intervals that vary by 20 %."""
    return np.concatenate([[0.0], np.cumsum(interval_s * rng.uniform(0.8, 1.2, count - 1))])


def make_tumbling(
    rng: np.random.Generator,
    push: Callable[[np.random.Generator, float], Push] | None = None,
    deg_s: tuple[float, float] = (0.5, 4.0),
    apart_s: tuple[float, float] = (5.0, 15.0),
) -> SimulatedPass:
    """Make a pass of six panels, 25 to 40 samples, noise of 0.5 to 3 %, with a gyro in one of four.

    Speed (deg/s) and interval (s) are drawn from the ranges given; `push` draws an angular acceleration.
    """
    t = draw_times(rng, int(rng.integers(25, 41)), rng.uniform(*apart_s))
    start = np.radians(rng.uniform(*deg_s)) * unit(rng)
    noise, gyro = 10 ** rng.uniform(-2.3, -1.5), bool(rng.random() < 0.25)
    return observe(
        FACES, *spin(start, t, None if push is None else push(rng, t[-1])), t, noise, rng, gyro
    )


def steady_torque(
    rng: np.random.Generator, span_s: float, change: float = CHANGE, in_body: bool | None = None
) -> Push:
    """Draw a torque that changes the rate by `change` over the pass, fixed in the body or in space."""
    acceleration = change / span_s * unit(rng)
    in_body = rng.random() < 0.5 if in_body is None else in_body
    if in_body:
        return lambda _, attitude: acceleration
    # a torque fixed in space accelerates a body with the mean moment by this
    return lambda _, attitude: attitude @ acceleration * MOMENTS.mean() / MOMENTS


def rate_step(rng: np.random.Generator, span_s: float) -> Push:
    """Draw a thrust of two seconds that changes the rate by `CHANGE`."""
    acceleration, begin_s = CHANGE / 2 * unit(rng), rng.uniform(0.2, 0.8) * span_s
    return lambda t, _: acceleration if begin_s <= t < begin_s + 2 else np.zeros(3)


def several_thrusts(rng: np.random.Generator, span_s: float) -> Push:
    """Draw two to four thrusts of two seconds, each of which changes the rate by half of `CHANGE` to twice that."""
    count = int(rng.integers(2, 5))
    accelerations = np.array([CHANGE / 2 * rng.uniform(0.5, 2.0) * unit(rng) for _ in range(count)])
    begin_s = (np.arange(count) + rng.uniform(0.2, 0.8, count)) / count * span_s
    return lambda t, _: accelerations[(begin_s <= t) & (t < begin_s + 2)].sum(axis=0)


def shift_time_tags(simulated: SimulatedPass, rng: np.random.Generator) -> SimulatedPass:
    """Return the pass with every time tag off by a second or two at random, in whole seconds.

    Tags that would not increase are raised to a millisecond after the one before.
    """
    t = simulated.telemetry["time"].values
    tags = np.round(t + rng.uniform(0.5, 2.0) * rng.normal(size=len(t)))
    increasing = np.maximum.accumulate(tags + 1e-3 * np.arange(len(t)))
    return simulated._replace(telemetry=simulated.telemetry.assign_coords(time=increasing))


def make_unconstrained(rng: np.random.Generator) -> SimulatedPass:
    """Make a pass of few noisy samples close together, whose stated largest rate is below what they could constrain."""
    t = draw_times(rng, int(rng.integers(4, 8)), rng.uniform(5.0, 12.0))
    limit = np.radians(rng.uniform(0.2, 0.6))
    return observe(
        FACES,
        *spin(rng.uniform(0.0, 0.9) * limit * unit(rng), t),
        t,
        rng.uniform(0.15, 0.4),
        rng,
        False,
        limit,
    )


def make_jitter(rng: np.random.Generator) -> SimulatedPass:
    """Make a pass of nine noisy panels, 30 to 120 s between samples, with oscillations by wheels within 20 s."""
    normals = np.array([unit(rng) for _ in range(9)])
    t = draw_times(rng, int(rng.integers(8, 13)), rng.uniform(30.0, 120.0))
    # white noise of angular acceleration, one value a second
    pushes = 10 ** rng.uniform(-3.0, -2.3) * rng.normal(size=(int(t[-1]) + 2, 3))
    drag = 0.05  # 1/s, so that the rates stay as small as those of a body under control
    rates = np.zeros_like(pushes)
    for k in range(1, len(pushes)):
        rates[k] = (1 - drag) * rates[k - 1] + pushes[k]
    attitude = np.array(
        list(
            accumulate(
                rates,
                lambda before, rate: Rotation.from_rotvec(-rate).as_matrix() @ before,
                initial=np.eye(3),
            )
        )
    )
    second = t.astype(int)  # of each sample
    return observe(
        normals,
        rates[second],
        attitude[second],
        second.astype(float),
        rng.uniform(0.05, 0.3),
        rng,
        False,
        np.radians(3.0),
    )


def make_even(rng: np.random.Generator) -> SimulatedPass:
    """Make a pass of a free body with the panels and intervals of `make_jitter`."""
    normals = np.array([unit(rng) for _ in range(9)])
    t = draw_times(rng, int(rng.integers(8, 13)), rng.uniform(30.0, 120.0))
    motion = spin(np.radians(rng.uniform(0.2, 2.5)) * unit(rng), t)
    return observe(normals, *motion, t, rng.uniform(0.05, 0.3), rng, False, np.radians(3.0))


def exchange_columns(simulated: SimulatedPass, rng: np.random.Generator) -> SimulatedPass:
    """Return the pass with the columns of two panels exchanged."""
    a, b = rng.choice(len(FACES), 2, replace=False)
    power = simulated.telemetry["power_W"].values.copy()
    power[:, [a, b]] = power[:, [b, a]]
    names = simulated.vehicle.panel_names
    return simulated._replace(
        telemetry=simulated.telemetry.assign(power_W=(("time", "panel"), power)),
        exchanged=(names[min(a, b)], names[max(a, b)]),
    )


def make_slow(rng: np.random.Generator) -> SimulatedPass:
    """Make a pass of a body at 0.05 to 0.3 deg/s that is searched up to 8 deg/s.

    It has 24 even samples 10 to 30 s apart and six panels of 1 to 7 % noise. Principal moments are 0.7 to 1.3 of their mean and are
    stated to 1 %.
    """
    t = rng.uniform(10.0, 30.0) * np.arange(24)
    moments = MOMENTS.mean() * rng.uniform(0.7, 1.3, 3)
    start = np.radians(rng.uniform(0.05, 0.3)) * unit(rng)
    motion = spin(start, t, moments=moments)
    noise = rng.uniform(0.01, 0.07)
    simulated = observe(FACES, *motion, t, noise, rng, False, np.radians(8.0))
    stated = np.diag(moments * (1 + 0.01 * rng.normal(size=3)))
    return simulated._replace(vehicle=replace(simulated.vehicle, inertia_kg_m2=stated))


def make_six_panels(rng: np.random.Generator) -> SimulatedPass:
    """Make a pass of a body at 0.5 to 4 deg/s without a wheel: 24 samples 10 to 30 s apart, six panels of 1 to 7 % noise.

    Principal moments are 0.7 to 1.3 of their mean and are stated to 1 %.
    """
    t = draw_times(rng, 24, rng.uniform(10.0, 30.0))
    moments = MOMENTS.mean() * rng.uniform(0.7, 1.3, 3)
    start = np.radians(rng.uniform(0.5, 4.0)) * unit(rng)
    simulated = observe(
        FACES, *spin(start, t, moments=moments), t, rng.uniform(0.01, 0.07), rng, False
    )
    stated = np.diag(moments * (1 + 0.01 * rng.normal(size=3)))
    return simulated._replace(vehicle=replace(simulated.vehicle, inertia_kg_m2=stated))


def make_without_inertia(rng: np.random.Generator) -> SimulatedPass:
    """Make a pass of a body of which the vehicle file states no inertia."""
    simulated = make_tumbling(rng)
    return simulated._replace(vehicle=replace(simulated.vehicle, inertia_kg_m2=None))


def make_wheel_braked(rng: np.random.Generator) -> SimulatedPass:
    """Make a pass of a tumbling body whose wheel loses 20 to 70 % of its momentum within `BRAKING_S` in the middle of the pass.

    The momentum is that of the body at 2 to 8 deg/s, along one of its axes. The vehicle file states the speed before, and no
    column gives the speed: of what the file allows, held or coasting, neither is true.
    """
    t = draw_times(rng, int(rng.integers(25, 41)), rng.uniform(5.0, 15.0))
    momentum = MOMENTS.mean() * np.radians(rng.uniform(2.0, 8.0)) * rng.choice([-1.0, 1.0])
    axis, lost = np.eye(3)[rng.integers(3)], rng.uniform(0.2, 0.7)
    begin_s = rng.uniform(0.4, 0.6) * t[-1]

    def wheels(t_s: float) -> tuple[np.ndarray, np.ndarray]:
        done = np.clip((t_s - begin_s) / BRAKING_S, 0.0, 1.0)
        braking = lost / BRAKING_S if 0.0 < done < 1.0 else 0.0
        return momentum * (1 - lost * done) * axis, -momentum * braking * axis

    start = np.radians(rng.uniform(0.5, 4.0)) * unit(rng)
    omega, attitude = spin(start, t, wheels=wheels)
    simulated = observe(FACES, omega, attitude, t, 10 ** rng.uniform(-2.3, -1.5), rng)
    wheel = Wheel("wheel", axis, 1e-5, momentum / 1e-5)
    return simulated._replace(vehicle=replace(simulated.vehicle, wheels=(wheel,)))


def make_four_sides(rng: np.random.Generator) -> SimulatedPass:
    """Make a pass of panels on four sides with a dead string, albedo, a full battery and coarse readings."""
    from tests.support.simulate import FAULTS_OF_FOUR_SIDES, FOUR_SIDES, cube_with_faults

    telemetry, run = cube_with_faults(FAULTS_OF_FOUR_SIDES, rng, FOUR_SIDES)
    return SimulatedPass(FOUR_SIDES, telemetry, run["omega_B"].values, 0.15)


def make_faulty(rng: np.random.Generator, name: str) -> SimulatedPass:
    """Make a pass of the cube with one fault of its panels, or with a gyro whose zero is off though it is stated as known."""
    from tests.support import simulate

    if name != "gyro zero off":
        fault = getattr(simulate, name.replace(" ", "_"))
        telemetry, run = simulate.cube_with_faults((fault,), rng)
        return SimulatedPass(simulate.CUBE, telemetry, run["omega_B"].values, 0.15)
    telemetry, run = simulate.cube_with_faults((), rng)
    omega = run["omega_B"].values
    read = omega + ZERO_OFF * unit(rng) + GYRO.noise_rad_s * rng.normal(size=omega.shape)
    known = replace(GYRO, zero_sigma=np.full(3, 1e-4))
    vehicle = replace(simulate.CUBE, sensors=Sensors(gyro=known))
    return SimulatedPass(vehicle, telemetry.assign(gyro_B=(("time", "axis"), read)), omega, 0.15)


def make_few_samples(rng: np.random.Generator) -> SimulatedPass:
    """Make a pass of three to six directions of a Sun sensor, good to 2 to 10 degrees, 10 to 45 s apart.

    Some have a gyro or a magnetometer too.
    """
    t = draw_times(rng, int(rng.integers(3, 7)), rng.uniform(10.0, 45.0))
    omega, attitude = spin(np.radians(rng.uniform(0.3, 3.0)) * unit(rng), t)
    simulated = observe(
        FACES, omega, attitude, t, 0.01, rng, bool(rng.random() < 0.3), np.radians(4.0)
    )
    sigma = np.radians(rng.uniform(2.0, 10.0))
    sun = attitude @ unit(rng) + sigma * rng.normal(size=(len(t), 3))
    data = simulated.telemetry.drop_vars("power_W").assign(
        sun_sensor_B=(("time", "axis"), sun / np.linalg.norm(sun, axis=1, keepdims=True)),
        sun_sensor_cov_B=(("time", "axis", "axis2"), np.tile(sigma**2 * np.eye(3), (len(t), 1, 1))),
    )
    if rng.random() < 0.5:
        data["field_B"] = (
            ("time", "axis"),
            attitude @ unit(rng) + 0.03 * rng.normal(size=(len(t), 3)),
        )
        part = Magnetometer(("x", "y", "z"), np.zeros(3), 0.03)
        simulated = simulated._replace(
            vehicle=replace(
                simulated.vehicle, sensors=replace(simulated.vehicle.sensors, magnetometer=part)
            )
        )
    return simulated._replace(telemetry=data)


def rotate_sun_directions(simulated: SimulatedPass, rng: np.random.Generator) -> SimulatedPass:
    """Return the pass with one or two of its Sun directions off, by two of their sigmas to 70 degrees."""
    sun = simulated.telemetry["sun_sensor_B"].values.copy()
    sigma = np.sqrt(simulated.telemetry["sun_sensor_cov_B"].values[0, 0, 0])
    for k in rng.choice(len(sun), int(rng.integers(1, 3)), replace=False):
        about = np.cross(sun[k], unit(rng))
        off = np.exp(rng.uniform(np.log(2 * sigma), np.log(np.radians(70.0))))
        sun[k] = Rotation.from_rotvec(off * about / np.linalg.norm(about)).apply(sun[k])
    return simulated._replace(
        telemetry=simulated.telemetry.assign(sun_sensor_B=(("time", "axis"), sun))
    )


def make_stop_and_go(rng: np.random.Generator) -> SimulatedPass:
    """Make a pass of a body that is rotated on the ground about its own axes, 5 to 20 s at 2 to 6 deg/s, with rests in between.

    Samples are 1 s apart.
    """
    t = np.arange(int(rng.integers(200, 320)), dtype=float)
    omega, begin = np.zeros((len(t), 3)), 0
    while begin < len(t):
        axis = rng.choice([-1.0, 1.0]) * np.eye(3)[rng.integers(3)]
        rotating_s, resting_s = rng.integers(5, 21), rng.integers(5, 31)
        omega[begin : begin + rotating_s] = np.radians(rng.uniform(2.0, 6.0)) * axis
        begin += rotating_s + resting_s
    attitude = [np.eye(3)]
    for rate in omega[:-1]:
        attitude.append(Rotation.from_rotvec(-rate).as_matrix() @ attitude[-1])
    return observe(
        FACES, omega, np.array(attitude), t, rng.uniform(0.02, 0.1), rng, bool(rng.random() < 0.5)
    )


def make(kind: str, seed: int, i: int) -> SimulatedPass:
    """Return pass `i` of a kind.

    Passes with exchanged columns, wrong time tags or bad readings are passes of another kind with that change.
    """
    # kind -> kind of the passes that it changes
    unchanged_kinds = {
        "columns exchanged": "right model",
        "time tags": "right model",
        "few samples, bad readings": "few samples",
    }
    base = unchanged_kinds.get(kind, kind)
    rng = np.random.default_rng(
        np.random.SeedSequence(seed, spawn_key=(list(KINDS).index(base), i))
    )
    makers = {
        "right model": make_tumbling,
        "steady torque": lambda r: make_tumbling(r, steady_torque),
        "step of the rate": lambda r: make_tumbling(r, rate_step),
        "jitter": make_jitter,
        "stop and go": make_stop_and_go,
        "prior given back": make_unconstrained,
        "slews": lambda r: make_tumbling(r, several_thrusts),
        "strong torque in the body": lambda r: make_tumbling(
            r, partial(steady_torque, change=STRONG, in_body=True)
        ),
        "strong torque in space": lambda r: make_tumbling(
            r, partial(steady_torque, change=STRONG, in_body=False)
        ),
        "few samples": make_few_samples,
        "even, sampled as jitter": make_even,
        "slow": lambda r: make_tumbling(r, deg_s=(0.02, 0.3)),
        "60 s apart": lambda r: make_tumbling(r, deg_s=(2.0, 6.0), apart_s=(60.0, 60.0)),
        "slow, wide range": make_slow,
        "exchanged, six panels": make_six_panels,
        "four sides": make_four_sides,
        "inertia unknown": make_without_inertia,
        "wheel braked": make_wheel_braked,
    }
    if base.startswith("fault: "):
        return make_faulty(rng, base.removeprefix("fault: "))
    simulated = makers[base](rng)
    changes = {
        "columns exchanged": exchange_columns,
        "exchanged, six panels": exchange_columns,
        "time tags": shift_time_tags,
        "few samples, bad readings": rotate_sun_directions,
    }
    return changes[kind](simulated, rng) if kind in changes else simulated


def judge(kind: str, seed: int, i: int) -> dict[str, Any]:
    """Run `rates` on a simulated pass and return its verdict and whether that is true.

    `leads` says of an undecided pass whether its best solution has the required probability, fits, and has a constrained speed.
    """
    simulated = make(kind, seed, i)
    try:
        result = rates(
            simulated.vehicle,
            simulated.telemetry,
            max_rate_rad_s=simulated.max_rate_rad_s,
        )
    except SunspinError as error:
        return {
            "decided": False,
            "leads": False,
            "wrong": False,
            "mirrored": False,
            "empty": False,
            "listed": False,
            "why": str(error),
        }
    row = compare_with_truth(result, simulated)
    if kind in AT_ALL_SAMPLES:
        row["wrong"] |= is_wrong_at_a_sample(result, simulated)
    return row


def is_wrong_at_a_sample(result: Any, simulated: SimulatedPass) -> bool:
    """Return whether the rate of a result with one pass is wrong at any of its samples."""
    times = simulated.telemetry["time"].values
    for t, omega, covariance in zip(
        result["time"].values,
        result["omega_B"].values,
        result["omega_cov_B"].values,
        strict=True,
    ):
        truth = simulated.omega[np.argmin(np.abs(times - t))]
        if is_wrong(omega, np.sqrt(np.diag(covariance)), truth):
            return True
    return False


def compare_with_truth(result: Any, simulated: SimulatedPass) -> dict[str, Any]:
    """Return the comparison of the first pass of a result with the truth, at the sample nearest to its middle.

    "mirrored": the rate is not wrong if the signs of two of its components are changed. "empty": its sigma is too large for
    the rate to be constrained by the data. "pull": largest normalised error of a component. "named": the changes of columns that
    the verdict names, and "named_rightly" whether the true one is among them.
    """
    t = result["time"].values[result["pass_of"].values == 0]
    middle_s = t[np.argmin(np.abs(t - (t[0] + t[-1]) / 2))]
    truth = simulated.omega[np.argmin(np.abs(simulated.telemetry["time"].values - middle_s))]
    omegas, sigmas = (
        np.stack([result[f"{name}_{axis}"].values[0] for axis in "xyz"], axis=1)
        for name in ("omega", "sigma")
    )
    omega, sigma = omegas[0], sigmas[0]
    miss = np.abs(omega - truth)
    wrong = is_wrong(omega, sigma, truth)
    mirrored = wrong and any(
        not is_wrong(omega, sigma, (2 * keep - 1) * truth) for keep in np.eye(3)
    )
    fitted = result["cost"].values[0, 0] <= result["cost_limit"].values[0]
    constrained = result["constrained_speed"].values[0]  # else an upper limit is the right answer
    named = [change["what"] for change in json.loads(result.attrs.get("columns_changes", "[]"))]
    true_change = f"the columns of panels {' and '.join(simulated.exchanged)} exchanged"
    return {
        "decided": bool(result["decided"].values[0]),
        "leads": bool(result["probability"].values[0, 0] >= DECIDED and fitted and constrained),
        "wrong": wrong and not mirrored,
        "mirrored": mirrored,
        "listed": is_listed(omegas, sigmas, result["probability"].values[0], truth),
        "empty": bool((sigma > NARROWER * result.attrs["max_rate_rad_s"] / 2).any()),
        "off_deg_s": np.degrees(omega - truth).tolist(),
        "sigma_deg_s": np.degrees(sigma).tolist(),
        "pull": float((miss / sigma).max()),
        "miss_deg_s": float(np.degrees(miss.max())),
        "why": str(result["why_not_decided"].values[0]),
        "named": named,
        "named_rightly": true_change in named,
    }
