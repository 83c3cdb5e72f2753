"""Simulated passes whose motion is known, of every kind for which a verdict of `rates` may be wrong. All telemetry is synthetic.

Nothing of the package's own dynamics makes them: Euler's equations with a torque by Runge and Kutta, light as gain times cosine.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from sunspin.base.errors import SunspinError
from sunspin.estimate.rates.estimate import rates
from sunspin.estimate.rates.result import DECIDED
from sunspin.estimate.verdict import NARROWER
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from sunspin.vehicle.sensors import Gyro, Magnetometer, Sensors
from validation.truths import is_listed, is_wrong

FACES = np.vstack([np.eye(3), -np.eye(3)])
NAMES = ("+x", "+y", "+z", "-x", "-y", "-z")
MOMENTS = np.array([0.042, 0.05, 0.03])
GYRO = Gyro(("x", "y", "z"), 1.0, np.zeros(3), 2e-3, zero_sigma=np.full(3, 2e-3), scale_sigma=0.01)
STEP_S = 0.25

CHANGE, STRONG = np.radians(1.0), np.radians(3.0)
"""rad/s by which a torque or a step changes the rate over a pass, and a strong torque."""

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
}
"""Kind of pass -> how many."""

Push = Callable[[float, np.ndarray], np.ndarray]
"""Angular acceleration (3) in body axes at a time and an attitude B_from_N."""


class SimulatedPass(NamedTuple):
    """A vehicle, its telemetry, the true rates (n, 3), and the largest rate that is told."""

    vehicle: Vehicle
    telemetry: xr.Dataset
    omega: np.ndarray
    max_rate_rad_s: float


def unit(rng: np.random.Generator) -> np.ndarray:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def spin(
    omega: np.ndarray,
    t_s: np.ndarray,
    push: Push | None = None,
    moments: np.ndarray = MOMENTS,
) -> tuple[np.ndarray, np.ndarray]:
    """Rates (n, 3) and attitudes (n, 3, 3) of the body with these principal moments (3) at times (n)."""

    def change(w: np.ndarray, t: float, attitude: np.ndarray) -> np.ndarray:
        return np.cross(moments * w, w) / moments + (0.0 if push is None else push(t, attitude))

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


def seen(
    normals: np.ndarray,
    omega: np.ndarray,
    attitude: np.ndarray,
    t_s: np.ndarray,
    noise: float,
    rng: np.random.Generator,
    gyro: bool = False,
    max_rate_rad_s: float = 0.15,
) -> SimulatedPass:
    """What panels, and a gyro, see of a motion."""
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
    light = np.maximum((attitude @ unit(rng)) @ normals.T, 0.0)
    power = np.maximum(light + noise * rng.normal(size=light.shape), 0.0)
    data = {
        "power_W": (("time", "panel"), power),
        "flag": ("time", np.zeros(len(t_s), dtype=np.uint8)),
    }
    if gyro:
        read = omega * (1 + GYRO.scale_sigma * rng.normal()) + GYRO.zero_sigma * rng.normal(size=3)
        data["gyro_B"] = (("time", "axis"), read + GYRO.noise_rad_s * rng.normal(size=omega.shape))
    attrs = {"epoch_utc": "2026-01-01T00:00:00Z", "synthetic": 1}
    return SimulatedPass(
        vehicle, xr.Dataset(data, {"time": t_s, "panel": list(names)}, attrs), omega, max_rate_rad_s
    )


def draw_times(rng: np.random.Generator, count: int, interval_s: float) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(interval_s * rng.uniform(0.8, 1.2, count - 1))])


def make_tumbling(
    rng: np.random.Generator,
    push: Callable[[np.random.Generator, float], Push] | None = None,
    deg_s: tuple[float, float] = (0.5, 4.0),
    apart_s: tuple[float, float] = (5.0, 15.0),
) -> SimulatedPass:
    """Six faces, 25 to 40 samples so far apart, so fast, noise of 0.5 to 3 %; a gyro on one in four."""
    t = draw_times(rng, int(rng.integers(25, 41)), rng.uniform(*apart_s))
    start = np.radians(rng.uniform(*deg_s)) * unit(rng)
    noise, gyro = 10 ** rng.uniform(-2.3, -1.5), bool(rng.random() < 0.25)
    return seen(
        FACES, *spin(start, t, None if push is None else push(rng, t[-1])), t, noise, rng, gyro
    )


def steady_torque(
    rng: np.random.Generator, span_s: float, change: float = CHANGE, in_body: bool | None = None
) -> Push:
    """A torque that changes the rate by `change`, fixed in the body or in space."""
    size = change / span_s * unit(rng)
    in_body = rng.random() < 0.5 if in_body is None else in_body
    return lambda _, attitude: size if in_body else attitude @ size * MOMENTS.mean() / MOMENTS


def rate_step(rng: np.random.Generator, span_s: float) -> Push:
    """A thruster that changes the rate by `CHANGE` within two seconds."""
    size, at = CHANGE / 2 * unit(rng), rng.uniform(0.2, 0.8) * span_s
    return lambda t, _: size if at <= t < at + 2 else np.zeros(3)


def several_thrusts(rng: np.random.Generator, span_s: float) -> Push:
    """Two to four thrusts of two seconds, each of which changes the rate by half of `CHANGE` to twice that."""
    count = int(rng.integers(2, 5))
    sizes = np.array([CHANGE / 2 * rng.uniform(0.5, 2.0) * unit(rng) for _ in range(count)])
    at = (np.arange(count) + rng.uniform(0.2, 0.8, count)) / count * span_s
    return lambda t, _: sizes[(at <= t) & (t < at + 2)].sum(axis=0)


def shift_time_tags(made: SimulatedPass, rng: np.random.Generator) -> SimulatedPass:
    """The same with every time tag off by a second or two at random, in whole seconds."""
    t = made.telemetry["time"].values
    tags = np.round(t + rng.uniform(0.5, 2.0) * rng.normal(size=len(t)))
    return made._replace(
        telemetry=made.telemetry.assign_coords(
            time=np.maximum.accumulate(tags + 1e-3 * np.arange(len(t)))
        )
    )


def make_unconstrained(rng: np.random.Generator) -> SimulatedPass:
    """A few samples of much noise close together, and a largest rate that is told and below what they could show."""
    t = draw_times(rng, int(rng.integers(4, 8)), rng.uniform(5.0, 12.0))
    limit = np.radians(rng.uniform(0.2, 0.6))
    return seen(
        FACES,
        *spin(rng.uniform(0.0, 0.9) * limit * unit(rng), t),
        t,
        rng.uniform(0.15, 0.4),
        rng,
        False,
        limit,
    )


def make_jitter(rng: np.random.Generator) -> SimulatedPass:
    """Nine panels of much noise, samples 30 to 120 s apart, and wheels that swing the body to and fro within 20 s."""
    normals = np.array([unit(rng) for _ in range(9)])
    t = draw_times(rng, int(rng.integers(8, 13)), rng.uniform(30.0, 120.0))
    pushes = 10 ** rng.uniform(-3.0, -2.3) * rng.normal(
        size=(int(t[-1]) + 2, 3)
    )  # white, one a second
    drag = 0.05  # 1/s, so that the rates stay as small as those of a body under control
    rates = np.zeros_like(pushes)
    for k in range(1, len(pushes)):
        rates[k] = (1 - drag) * rates[k - 1] + pushes[k]
    attitude = np.array(
        list(
            accumulate(
                rates,
                lambda one, rate: Rotation.from_rotvec(-rate).as_matrix() @ one,
                initial=np.eye(3),
            )
        )
    )
    at = t.astype(int)
    return seen(
        normals,
        rates[at],
        attitude[at],
        at.astype(float),
        rng.uniform(0.05, 0.3),
        rng,
        False,
        np.radians(3.0),
    )


def make_even(rng: np.random.Generator) -> SimulatedPass:
    """A body that turns as its moments have it, seen by such panels at such intervals as one that swings."""
    normals = np.array([unit(rng) for _ in range(9)])
    t = draw_times(rng, int(rng.integers(8, 13)), rng.uniform(30.0, 120.0))
    motion = spin(np.radians(rng.uniform(0.2, 2.5)) * unit(rng), t)
    return seen(normals, *motion, t, rng.uniform(0.05, 0.3), rng, False, np.radians(3.0))


def exchange_columns(made: SimulatedPass, rng: np.random.Generator) -> SimulatedPass:
    """The same with the columns of two panels exchanged."""
    a, b = rng.choice(len(FACES), 2, replace=False)
    power = made.telemetry["power_W"].values.copy()
    power[:, [a, b]] = power[:, [b, a]]
    return made._replace(telemetry=made.telemetry.assign(power_W=(("time", "panel"), power)))


def make_slow(rng: np.random.Generator) -> SimulatedPass:
    """A body of 0.05 to 0.3 deg/s that is searched up to 8 deg/s: 24 even samples 10 to 30 s apart, six panels of 1 to 7 % noise,
    principal moments 0.7 to 1.3 of their mean, each stated to 1 %."""
    t = rng.uniform(10.0, 30.0) * np.arange(24)
    moments = MOMENTS.mean() * rng.uniform(0.7, 1.3, 3)
    start = np.radians(rng.uniform(0.05, 0.3)) * unit(rng)
    motion = spin(start, t, moments=moments)
    noise = rng.uniform(0.01, 0.07)
    made = seen(FACES, *motion, t, noise, rng, False, np.radians(8.0))
    stated = np.diag(moments * (1 + 0.01 * rng.normal(size=3)))
    return made._replace(vehicle=replace(made.vehicle, inertia_kg_m2=stated))


def make_few_samples(rng: np.random.Generator) -> SimulatedPass:
    """Three to six directions of a Sun sensor, good to 2 to 10 degrees, 10 to 45 s apart; on some a gyro, a magnetometer."""
    t = draw_times(rng, int(rng.integers(3, 7)), rng.uniform(10.0, 45.0))
    omega, attitude = spin(np.radians(rng.uniform(0.3, 3.0)) * unit(rng), t)
    made = seen(FACES, omega, attitude, t, 0.01, rng, bool(rng.random() < 0.3), np.radians(4.0))
    sigma = np.radians(rng.uniform(2.0, 10.0))
    sun = attitude @ unit(rng) + sigma * rng.normal(size=(len(t), 3))
    data = made.telemetry.drop_vars("power_W").assign(
        sun_sensor_B=(("time", "axis"), sun / np.linalg.norm(sun, axis=1, keepdims=True)),
        sun_sensor_cov_B=(("time", "axis", "axis2"), np.tile(sigma**2 * np.eye(3), (len(t), 1, 1))),
    )
    if rng.random() < 0.5:
        data["field_B"] = (
            ("time", "axis"),
            attitude @ unit(rng) + 0.03 * rng.normal(size=(len(t), 3)),
        )
        part = Magnetometer(("x", "y", "z"), np.zeros(3), 0.03)
        made = made._replace(
            vehicle=replace(made.vehicle, sensors=replace(made.vehicle.sensors, magnetometer=part))
        )
    return made._replace(telemetry=data)


def rotate_sun_directions(made: SimulatedPass, rng: np.random.Generator) -> SimulatedPass:
    """The same with one or two of the Sun's directions off, by two of their sigmas to 70 degrees."""
    sun = made.telemetry["sun_sensor_B"].values.copy()
    sigma = np.sqrt(made.telemetry["sun_sensor_cov_B"].values[0, 0, 0])
    for k in rng.choice(len(sun), int(rng.integers(1, 3)), replace=False):
        about = np.cross(sun[k], unit(rng))
        off = np.exp(rng.uniform(np.log(2 * sigma), np.log(np.radians(70.0))))
        sun[k] = Rotation.from_rotvec(off * about / np.linalg.norm(about)).apply(sun[k])
    return made._replace(telemetry=made.telemetry.assign(sun_sensor_B=(("time", "axis"), sun)))


def make_stop_and_go(rng: np.random.Generator) -> SimulatedPass:
    """Turned on the ground about axes of its body, 5 to 20 s at 2 to 6 deg/s, with rests in between; samples 1 s apart."""
    t = np.arange(int(rng.integers(200, 320)), dtype=float)
    omega, at = np.zeros((len(t), 3)), 0
    while at < len(t):
        axis = rng.choice([-1.0, 1.0]) * np.eye(3)[rng.integers(3)]
        turning, resting = rng.integers(5, 21), rng.integers(5, 31)
        omega[at : at + turning] = np.radians(rng.uniform(2.0, 6.0)) * axis
        at += turning + resting
    attitude = [np.eye(3)]
    for rate in omega[:-1]:
        attitude.append(Rotation.from_rotvec(-rate).as_matrix() @ attitude[-1])
    return seen(
        FACES, omega, np.array(attitude), t, rng.uniform(0.02, 0.1), rng, bool(rng.random() < 0.5)
    )


def make(kind: str, seed: int, i: int) -> SimulatedPass:
    """Pass `i` of a kind; one whose columns are exchanged, or times are off, is that of the right model otherwise."""
    of_others = {
        "columns exchanged": "right model",
        "time tags": "right model",
        "few samples, bad readings": "few samples",
    }
    base = of_others.get(kind, kind)
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
    }
    made = makers[base](rng)
    changes = {
        "columns exchanged": exchange_columns,
        "time tags": shift_time_tags,
        "few samples, bad readings": rotate_sun_directions,
    }
    return changes.get(kind, lambda made, _: made)(made, rng)


def judge(kind: str, seed: int, i: int) -> dict[str, Any]:
    """What is said of a simulated pass, and whether it is true; of one that is not decided, whether its best motion `leads`:
    holds the probability that is asked for, fits, and has a speed above its error."""
    made = make(kind, seed, i)
    try:
        result = rates(made.vehicle, made.telemetry, max_rate_rad_s=made.max_rate_rad_s)
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
    return compare_with_truth(result, made)


def compare_with_truth(result: Any, made: SimulatedPass) -> dict[str, Any]:
    """The first pass against the truth."""
    t = result["time"].values[result["pass_of"].values == 0]
    at = t[np.argmin(np.abs(t - (t[0] + t[-1]) / 2))]
    truth = made.omega[np.argmin(np.abs(made.telemetry["time"].values - at))]
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
    told = result["constrained_speed"].values[0]  # else an upper limit is the right answer
    return {
        "decided": bool(result["decided"].values[0]),
        "leads": bool(result["probability"].values[0, 0] >= DECIDED and fitted and told),
        "wrong": wrong and not mirrored,
        "mirrored": mirrored,
        "listed": is_listed(omegas, sigmas, result["probability"].values[0], truth),
        "empty": bool((sigma > NARROWER * result.attrs["max_rate_rad_s"] / 2).any()),
        "off_deg_s": np.degrees(omega - truth).tolist(),
        "sigma_deg_s": np.degrees(sigma).tolist(),
        "pull": float((miss / sigma).max()),
        "miss_deg_s": float(np.degrees(miss.max())),
        "why": str(result["why_not_decided"].values[0]),
    }
