"""Posterior of Philae with panels as drawn, simulated without the package.

The vehicle file is read as text, the gyrostat is integrated here, panels are cosines. The panels are not misaligned and the wheel
coasts. Moments, friction and wheel speed differ from the file by the posterior's own sigmas. Every reading has noise and negative
ones are clipped. The noise that the vehicle states is right or 15 % off. Case i depends on seed and i alone. The first three are
fixed in all but the draws: cases like these were lost, did not end or took five minutes.
"""

from __future__ import annotations

import json
import multiprocessing
import resource
import time
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.integrate import solve_ivp

from sunspin import posterior
from sunspin.base.errors import SunspinError
from sunspin.cases import load_case
from validation.truths import is_in_solutions

CASES = 24

SAMPLES, INTERVALS_S, MAX_RATES, MOST_TURNS = (13, 21), (30.0, 120.0), (0.2, 0.45), 4.5
"""Ranges of the number of samples, of their intervals (s) and of the stated largest rates (rad/s), and largest number of
revolutions between two samples.
"""

NOISES, STATED = (0.015, 0.04), (1.0, 0.85, 1.15)
"""Range of the noise, as a part of the largest panel's full power, and ratios of the stated noise to the true one, in turn."""

MOMENTS, FRICTION, SPEED = 0.01, 0.05, 0.005
"""Relative sigmas of moments, friction and wheel speed about the values of the file."""

FULL_W = 2.5
"""Power (W) of the largest panel at normal incidence."""

NEAR_SIGMAS = 4.5
"""Largest distance of a solution from the truth, in sigmas of its rates, as in the calibration."""

LIMIT_S = 400.0
"""Largest processor time (s) of a case."""


@dataclass(frozen=True)
class Case:
    """Parameters of a case. `rate`: rad/s at the first sample, NaN to draw it; `noise`: part of the largest panel's power."""

    seed: int
    number: int
    samples: int
    interval_s: float
    max_rate: float
    noise: float
    stated: float
    rate: float = float("nan")


def cases(seed: int = 0) -> Iterator[Case]:
    """Yield the cases of a seed."""
    yield Case(seed, 0, 13, 60.0, 0.261, 0.036, 0.85, float(np.radians(14.6)))
    yield Case(seed, 1, 15, 120.0, 0.236, 0.03, 1.0)
    yield Case(seed, 2, 17, 30.0, 0.45, 0.03, 1.15)
    for i in range(3, CASES):
        rng = np.random.default_rng([seed, i])
        samples = int(rng.integers(SAMPLES[0], SAMPLES[1] + 1))
        interval = round(rng.uniform(*INTERVALS_S), 1)
        fastest = min(MAX_RATES[1], MOST_TURNS * 2 * np.pi / interval)
        limit = round(rng.uniform(MAX_RATES[0], fastest), 3)
        yield Case(seed, i, samples, interval, limit, round(rng.uniform(*NOISES), 4), STATED[i % 3])


class Simulation(NamedTuple):
    """Telemetry of a case, its true rate (3) at the first sample in rad/s, and the true noise in W."""

    telemetry: xr.Dataset
    omega_B: np.ndarray
    noise_W: float


def simulate(case: Case) -> Simulation:
    """Return telemetry in the form of `read_telemetry`, the rate (3) at the first sample in rad/s, and the true noise in W."""
    rng = np.random.default_rng([case.seed, case.number, 1])
    philae = tomllib.loads(
        files("sunspin").joinpath("cases/philae/vehicle.toml").read_text("utf-8")
    )
    wheel = philae["wheel"][0]
    spin_down = {name: entry["value"] for name, entry in wheel["friction"]["spin_down"].items()}
    inertia = np.array(philae["body"]["inertia_kg_m2"]["value"])
    inertia[np.diag_indices(3)] *= 1 + MOMENTS * rng.standard_normal(3)
    wheel_inertia = wheel["inertia_kg_m2"]["value"]
    speed = wheel["speed_rad_s"]["value"] * (1 + SPEED * rng.standard_normal())
    # friction of the spin-down c1 exp(c2 t) + c3: dry c2 c3 J, viscous -c2 J
    dry = (
        spin_down["c2_per_s"]
        * spin_down["c3_rad_s"]
        * wheel_inertia
        * np.exp(FRICTION * rng.standard_normal())
    )
    viscous = -spin_down["c2_per_s"] * wheel_inertia * np.exp(FRICTION * rng.standard_normal())
    axis, sun = (vector / np.linalg.norm(vector) for vector in rng.standard_normal((2, 3)))
    drawn_rate = case.max_rate * rng.random() ** (1 / 3)  # uniform in the ball of rates
    omega = axis * (case.rate if np.isfinite(case.rate) else drawn_rate)
    t = case.interval_s * np.arange(case.samples)
    seen = simulate_directions(
        inertia,
        np.array(wheel["axis_B"]["value"]),
        wheel_inertia,
        (dry, viscous),
        (omega, sun, speed),
        t,
    )
    normals = np.array([panel["normal_B"]["value"] for panel in philae["panel"]])
    cells = np.array([panel["cells"]["value"] for panel in philae["panel"]])
    noise = case.noise * FULL_W
    power = FULL_W * cells / cells.max() * np.maximum(seen @ normals.T, 0.0)
    power = np.maximum(power + noise * rng.standard_normal(power.shape), 0.0)
    names = [panel["name"] for panel in philae["panel"]]
    data = {
        "power_W": (("time", "panel"), power, {"units": "W"}),
        "flag": ("time", np.zeros(len(t), np.uint8)),
    }
    attrs = {"epoch_utc": "2014-11-12T15:34:04Z", "synthetic": 1, "quantity": "power_W"}
    coords = {"time": ("time", t, {"units": "s"}), "panel": names}
    return Simulation(xr.Dataset(data, coords, attrs), omega, noise)


def simulate_directions(
    inertia: np.ndarray,
    axis: np.ndarray,
    wheel_inertia: float,
    friction: tuple[float, float],
    start: tuple[np.ndarray, np.ndarray, float],
    t: np.ndarray,
) -> np.ndarray:
    """Return Sun directions (n, 3) in body axes at times `t` (n) of a gyrostat whose wheel coasts and then sticks to the body.

    `friction`: dry (N m) and viscous (N m s); `start`: rate, Sun, the wheel's speed at ``t[0]``. The state is total
    momentum H, Sun r and the wheel's own momentum h in body axes: dH/dt = H x omega, dh/dt = M(W), dr/dt = r x omega, omega =
    A^-1 (H - h u), with A the inertia less the wheel's about its axis u. A stuck wheel leaves omega = I^-1 H.
    """
    omega, sun, speed = start
    free_inverse = np.linalg.inv(inertia - wheel_inertia * np.outer(axis, axis))
    stuck_inverse = np.linalg.inv(inertia)

    def derivative(_, y, coasting):
        """Return the derivative of (H, r, h)."""
        momentum, sun_B, wheel_momentum = y[:3], y[3:6], y[6]
        rate = (
            free_inverse @ (momentum - wheel_momentum * axis)
            if coasting
            else stuck_inverse @ momentum
        )
        w = wheel_momentum / wheel_inertia - axis @ rate
        torque = -np.sign(w) * (friction[0] + friction[1] * abs(w)) if coasting else 0.0
        return np.concatenate([np.cross(momentum, rate), np.cross(sun_B, rate), [torque]])

    def relative_speed(_, y, coasting):
        """Return the speed of the wheel relative to the body, whose zero is the stop; 1 for a stuck wheel."""
        if not coasting:
            return 1.0
        return y[6] / wheel_inertia - axis @ (free_inverse @ (y[:3] - y[6] * axis))

    relative_speed.terminal = True  # ty: ignore[unresolved-attribute]
    momentum = inertia @ omega + wheel_inertia * speed * axis
    y = np.concatenate([momentum, sun, [wheel_inertia * (speed + axis @ omega)]])
    options = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-12}
    first = solve_ivp(
        derivative,
        (t[0], t[-1] + 1e-9),
        y,
        t_eval=t,
        events=relative_speed,
        args=(True,),
        **options,
    )
    seen = first.y[3:6].T
    if len(seen) < len(t):  # the wheel has stopped before the last sample
        rest = t[len(seen) :]
        stop_s, y = float(first.t_events[0][0]), first.y_events[0][0]
        later = solve_ivp(
            derivative, (stop_s, t[-1] + 1e-9), y, t_eval=rest, args=(False,), **options
        )
        seen = np.concatenate([seen, later.y[3:6].T])
    return seen


def run(case: Case) -> dict[str, Any]:
    """Run the posterior on a case and return its verdict and whether the truth is listed."""
    telemetry, omega, noise = simulate(case)
    vehicle = load_case("philae").vehicle
    vehicle = replace(vehicle, telemetry=replace(vehicle.telemetry, noise=case.stated * noise))
    began = time.process_time()
    try:
        priors = {"max_rate_rad_s": case.max_rate}
        tree = posterior(vehicle, telemetry, priors, 0, workers=1)
    except SunspinError as error:
        took = time.process_time() - began
        return {
            "word": "refused",
            "verdict": str(error),
            "recalled": False,
            "listed": False,
            "processor_s": took,
        }
    solutions = tree["solutions"]
    # distances of the solutions from the truth in sigmas; 1e-14 (rad/s)^2 keeps each covariance invertible
    errors = omega - solutions["omega_B"].values
    covariances = solutions["omega_cov_B"].values + 1e-14 * np.eye(3)
    distances = [
        np.sqrt(error @ np.linalg.solve(covariance, error))
        for error, covariance in zip(errors, covariances, strict=True)
    ]
    return {
        "word": tree.attrs["verdict_word"],
        "verdict": tree.attrs["verdict"],
        "recalled": bool(min(distances) < NEAR_SIGMAS),
        "listed": is_in_solutions(solutions.to_dataset(), omega),
        "processor_s": time.process_time() - began,
    }


def run_limited(case: Case, limit_s: float) -> dict[str, Any]:
    """Run a case in its own process and return its row; after `limit_s` of processor time the word is "did not end"."""

    def work(pipe: Any) -> None:
        """Run the case in the new process and send its row."""
        resource.setrlimit(resource.RLIMIT_CPU, (int(limit_s), int(limit_s) + 5))
        pipe.send(json.dumps(run(case)))

    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=work, args=(sender,))
    process.start()
    sender.close()
    try:
        row = json.loads(receiver.recv())
    except EOFError:
        row = {
            "word": "did not end",
            "verdict": "",
            "recalled": False,
            "listed": False,
            "processor_s": limit_s,
        }
    process.join()
    return row
