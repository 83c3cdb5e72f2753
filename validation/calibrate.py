"""Is the posterior right? Twins drawn from its own prior, their ranks in it, and how often its regions hold the truth.

    python -m validation.calibrate OUT --twins 100 --kind unknown
    python -m validation.calibrate OUT --twins 30 --kind turned --max-rate 0.3 --samples 23 --interval 120

Every twin is a file in OUT, written whole; the same command goes on where it was stopped, within a twin too. Twin i depends on
seed and i alone. Kinds: "known", "unknown", and with panels that stand off "tilted" and "turned" are drawn from the prior that the
posterior is told; "untold" is "turned" with a posterior that takes panels to stand as drawn; "shadow", "dead", "jitter" break its
assumptions a little; "swapped" and "wheel_off" are telemetry of another model, which the predictive check has to refuse.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path
from shutil import rmtree
from typing import Any

import numpy as np
import xarray as xr
from scipy.stats import binomtest, kstest

from sunspin.base.errors import Interrupted, SunspinError
from sunspin.compute.campaign import command, kept, rows_folder
from sunspin.compute.identity import code
from sunspin.dynamics import gyrostat as g
from sunspin.estimate.posterior.brightness import brightness
from sunspin.estimate.posterior.data import group, readings
from sunspin.estimate.posterior.estimate import DIRECTION_ERROR, posterior
from sunspin.estimate.posterior.fit import FILES
from sunspin.estimate.posterior.likelihood import Likelihood
from sunspin.estimate.posterior.model import Model, State, model, rate_and_direction
from sunspin.estimate.posterior.modes import standing
from sunspin.estimate.posterior.tilt import AS_DRAWN
from sunspin.estimate.synthetic import Truth, synthetic_telemetry
from sunspin.telemetry.case import load_case
from sunspin.vehicle import Vehicle, load_vehicle

KINDS = (
    "known",
    "unknown",
    "shadow",
    "dead",
    "jitter",
    "swapped",
    "wheel_off",
    "tilted",
    "turned",
    "untold",
)

QUANTITIES = ("omega_x", "omega_y", "omega_z", "momentum", "theta", "alpha", "log_likelihood")
"""What is ranked: rates, |H|, the angles of H from z and from the Sun, and the log-likelihood."""

KNOWN = {"inertia": 0.0, "friction": 0.0, "wheel_speed": 0.0}

TURNED = {"tilt": float(np.radians(1.0)), "tilt_common": float(np.radians(5.0))}
TILTS = {"tilted": AS_DRAWN | {"tilt": float(np.radians(5.0))}, "turned": TURNED, "untold": TURNED}
"""Sigmas by which panels stand off, whatever the vehicle's file says. Those of "turned" make E and Delta of Philae's descent as
published."""

JITTER_S = 6.0
"""Sample times are irregular by up to this."""

TAG_S = 0.1
"""Error of the time tags of the kind "jitter"."""

STEPS = ("brightness", "modes", "family", "mixture", "hypotheses", "check", "verdict", "estimate")
DECIDING = (*FILES, *(f"estimate/posterior/{name}.py" for name in STEPS))
"""Files whose text decides what a twin gives; each row keeps their digest."""

NEAR_SIGMAS = 4.5
"""A mode counts as the true one within this many sigmas of its rates."""


def prior_truth(unknown: Model, rng: np.random.Generator) -> State:
    """One draw of the prior, at the first sample; the scale is left at its centre, as its prior is all but flat."""
    omega, sun = rate_and_direction(unknown.max_rate, rng)
    u = rng.standard_normal((1, len(unknown.unknowns)))
    u[:, unknown.where("scale")] = 0.0
    return State(omega, sun, u)


def make(
    vehicle: Vehicle, kind: str, max_rate: float, samples: int, interval_s: float, seed: int, i: int
) -> tuple[xr.Dataset, State, Model, dict[str, Any]]:
    """Telemetry of twin i, the truth, the model it was drawn from and the priors that the posterior is told.

    No torque acts, and the posterior is told so: `validation/torques.py` is about those.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i, KINDS.index(kind))))
    priors: dict[str, Any] = {"max_rate_rad_s": max_rate, "steady_torque": 0.0} | (
        KNOWN if kind == "known" else {}
    )
    priors |= TILTS.get(kind, AS_DRAWN)
    scale = vehicle.require_noise() / (0.02 * float(vehicle.panel_gains.max()))
    unknown, _ = model(vehicle, priors, scale)
    truth = prior_truth(unknown, rng)
    t = interval_s * np.arange(samples) + np.concatenate(
        [[0.0], rng.uniform(-1, 1, samples - 1)]
    ) * min(JITTER_S, interval_s / 4)
    noise = vehicle.require_noise() * float(np.exp(unknown.relative(truth.u, "noise", 1)[0, 0]))
    speeds = unknown.wheel_speeds(truth.u)[0] * (0.0 if kind == "wheel_off" else 1.0)
    off = 0.0 if unknown.turns is None else np.tensordot(truth.u[0], unknown.turns, axes=1)
    told = Truth(truth.omega[0], truth.sun[0], t, speeds, scale=scale, noise=noise, tilt_B_rad=off)
    telemetry = synthetic_telemetry(
        unknown.bodies(truth.u).vehicle(vehicle, 0), told, seed=int(rng.integers(2**31))
    )
    telemetry = _spoilt(telemetry, kind, rng)
    if kind == "jitter":
        truth = _at_first_tag(unknown, truth, float(telemetry["time"].values[0]) - float(t[0]))
    if kind == "untold":
        unknown, kept = standing(unknown)
        truth, priors = replace(truth, u=truth.u[:, kept]), priors | AS_DRAWN
    return telemetry, truth, unknown, priors


def _at_first_tag(unknown: Model, truth: State, after_s: float) -> State:
    """The truth at the instant that the first sample's tag names, which is what the posterior tells.

    Philae's rates change by more than their sigmas in a tenth of a second; the speed of its wheel does not.
    """
    run = unknown.run(unknown.rows(truth), [after_s], DIRECTION_ERROR)
    return State(run.omega_B[:, 0], run.sun_B[:, 0], truth.u)


def _spoilt(telemetry: xr.Dataset, kind: str, rng: np.random.Generator) -> xr.Dataset:
    telemetry = telemetry.copy(deep=True)
    name = "power_W" if "power_W" in telemetry else "current_A"
    value = telemetry[name].values
    if kind == "shadow":  # the panel that gives most, in three samples after another
        start = int(rng.integers(len(value) - 3))
        panel = int(np.argmax(value[start : start + 3].sum(axis=0)))
        value[start : start + 3, panel] *= 0.3
    elif kind == "dead":
        value[:, int(rng.integers(value.shape[1]))] = 0.0
    elif kind == "swapped":
        a, b = rng.choice(value.shape[1], 2, replace=False)
        value[:, [a, b]] = value[:, [b, a]]
    elif kind == "jitter":
        times = telemetry["time"].values + TAG_S * rng.standard_normal(len(value))
        telemetry = telemetry.assign_coords(time=("time", times, telemetry["time"].attrs))
    return telemetry


def quantities(unknown: Model, state: State) -> dict[str, np.ndarray]:
    """Rates, |H|, theta and alpha (n) of states at the first sample."""
    momentum = g.total_momentum(unknown.bodies(state.u), state.omega, unknown.wheel_speeds(state.u))
    size = np.linalg.norm(momentum, axis=1)
    return {
        "omega_x": state.omega[:, 0],
        "omega_y": state.omega[:, 1],
        "omega_z": state.omega[:, 2],
        "momentum": size,
        "theta": np.arccos(np.clip(momentum[:, 2] / size, -1, 1)),
        "alpha": np.arccos(np.clip(np.sum(momentum * state.sun, axis=1) / size, -1, 1)),
    }


def judge(
    vehicle: Vehicle,
    telemetry: xr.Dataset,
    truth: State,
    unknown: Model,
    priors: dict[str, Any],
    seed: int,
    **options: Any,
) -> dict[str, Any]:
    """Run the posterior on a twin and compare it with the truth."""
    began = time.process_time()
    tree = posterior(vehicle, telemetry, priors, seed, **options)
    took = time.process_time() - began
    found = group(tree, "posterior")
    omega = found["omega_B"].values[0]
    # u of the draws, in the order of the model that knows the scale's centre
    data, _, _ = readings(vehicle, telemetry)
    model_, _ = model(vehicle, priors, brightness(vehicle, data))
    u = np.stack([_value(found, x.name) for x in model_.unknowns], axis=1)
    centre, sigma = (
        np.array([getattr(x, key) for x in model_.unknowns]) for key in ("centre", "sigma")
    )
    drawn = State(omega, found["sun_B"].values[0], (u - centre) / sigma)
    own = np.array(truth.u)
    for i in model_.where("scale"):
        own[:, i] = (unknown.values(truth.u)[:, i] - model_.unknowns[i].centre) / model_.unknowns[
            i
        ].sigma
    exact = State(truth.omega, truth.sun, own)
    likelihood = Likelihood(
        replace(model_, time_sigma_s=tree.attrs["time_sigma_s"]), data, DIRECTION_ERROR
    )
    log_true = float(likelihood(exact)[0])
    every, true = quantities(model_, drawn), quantities(model_, exact)
    every["log_likelihood"], true["log_likelihood"] = (
        found["log_likelihood_sum"].values[0],
        np.array([log_true]),
    )
    density = every["log_likelihood"] + model_.log_prior(drawn)
    level = float(np.mean(density > log_true + model_.log_prior(exact)[0]))
    modes = group(tree, "modes")
    off = truth.omega[0] - modes["omega_B"].values
    spread = modes["omega_cov_B"].values + 1e-14 * np.eye(3)
    distance = [float(o @ np.linalg.solve(c, o)) ** 0.5 for o, c in zip(off, spread, strict=True)]
    return {
        "ranks": {name: float(np.mean(every[name] < true[name][0])) for name in QUANTITIES},
        "level": level,
        "recalled": bool(min(distance) < NEAR_SIGMAS),
        "main": bool(distance[0] < NEAR_SIGMAS),
        "modes": len(distance),
        "weight_of_true": float(modes["weight"].values[int(np.argmin(distance))])
        if min(distance) < NEAR_SIGMAS
        else 0.0,
        "word": tree.attrs["verdict_word"],
        "verdict": tree.attrs["verdict"],
        "p": tree.attrs["p_value"],
        "noise_sigmas": tree.attrs["noise_sigmas"],
        "effective": tree.attrs["effective_draws"],
        "pareto_k": tree.attrs["pareto_k"],
        "log_true": log_true,
        "log_best": float(every["log_likelihood"].max()),
        "error": float(np.min(np.linalg.norm(off, axis=1))),
        "sigma": float(np.sqrt(np.trace(modes["omega_cov_B"].values[0]))),
        "omega": truth.omega[0].tolist(),
        "samples": tree.attrs["samples"],
        "time_sigma_s": tree.attrs["time_sigma_s"],
        "processor_s": took,
        "code": code(*DECIDING)["physics_sha256"],
    }


def _value(found: xr.Dataset, name: str) -> np.ndarray:
    return (
        found["wheel_speed_rad_s"].values[0][:, 0]
        if name.startswith("wheel_speed")
        else found[name].values[0]
    )


def tally(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Figures of many twins, each share with its 95 % interval (Clopper and Pearson)."""

    def share(hits: list[bool]) -> list[float]:
        interval = binomtest(int(sum(hits)), len(hits)).proportion_ci()
        return [float(np.mean(hits)), float(interval.low), float(interval.high)]

    if not rows:
        return {"twins": 0}
    confident = [row for row in rows if row["word"] in ("unique", "aliases", "line")]
    return {
        "twins": len(rows),
        "words": dict(Counter(row["word"] for row in rows)),
        "recall": share([row["recalled"] for row in rows]),
        "in_50": share([row["level"] <= 0.5 for row in rows]),
        "in_90": share([row["level"] <= 0.9 for row in rows]),
        "not_explained": share([row["word"] == "not explained" for row in rows]),
        "confident_misses": sum(not row["recalled"] for row in confident),
        "confident": len(confident),
        "confident_in_90": share([row["level"] <= 0.9 for row in confident]) if confident else None,
        "ranks_p": {
            name: float(kstest([row["ranks"][name] for row in rows], "uniform").pvalue)
            for name in QUANTITIES
        },
        "pareto_k": float(np.median([row["pareto_k"] for row in rows])),
        "effective": float(np.median([row["effective"] for row in rows])),
        "processor_s": float(np.mean([row["processor_s"] for row in rows])),
        "states_of_code": len({row["code"] for row in rows}),
    }


def calibrate(
    out: Path,
    kind: str,
    twins: int,
    seed: int = 0,
    max_rate: float = 0.25,
    samples: int = 16,
    interval_s: float = 20.0,
    workers: int | None = None,
    vehicle: Vehicle | None = None,
) -> list[dict[str, Any]]:
    """Judge twins 0 to `twins` - 1 of a kind, reading those that are in `out` already."""
    craft = vehicle or load_case("philae").vehicle
    folder = rows_folder(out / f"{kind}-{seed}-{max_rate:g}-{samples}-{interval_s:g}")

    def row(i: int) -> dict[str, Any]:
        telemetry, truth, unknown, priors = make(
            craft, kind, max_rate, samples, interval_s, seed, i
        )
        try:
            return judge(
                craft,
                telemetry,
                truth,
                unknown,
                priors,
                seed,
                workers=workers,
                store=folder / f"{i:04d}-stages",
            )
        except Interrupted:
            raise
        except SunspinError as error:
            return {"refused": str(error)}

    rows = []
    for i in range(twins):
        rows.append(kept(folder / f"{i:04d}.json", partial(row, i)))
        rmtree(
            folder / f"{i:04d}-stages", ignore_errors=True
        )  # not before the row is kept: no run goes on from half of them
    return rows


def read(out: Path) -> dict[str, list[dict[str, Any]]]:
    """The judged twins in a folder, by kind; those that were refused are left out."""
    found: dict[str, list[dict[str, Any]]] = {}
    for path in sorted(out.glob("*/[0-9]*.json")):
        row = json.loads(path.read_text("utf-8"))
        if "refused" not in row:
            found.setdefault(path.parent.name.split("-")[0], []).append(row)
    return found


@command
def main(arguments: list[str] | None = None) -> None:
    """Run twins and print what they say."""
    parser = argparse.ArgumentParser(
        prog="python -m validation.calibrate", description=main.__doc__
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("--twins", type=int, default=100)
    parser.add_argument(
        "--kind", choices=KINDS, action="append", help="repeatable; unknown unless given"
    )
    parser.add_argument("--vehicle", default="philae", help="a vehicle file or the name of one")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--max-rate", type=float, default=0.25)
    parser.add_argument("--samples", type=int, default=16)
    parser.add_argument("--interval", type=float, default=20.0)
    parser.add_argument("--workers", type=int)
    given = parser.parse_args(arguments)
    for kind in given.kind or ["unknown"]:
        rows = calibrate(
            given.out,
            kind,
            given.twins,
            given.seed,
            given.max_rate,
            given.samples,
            given.interval,
            given.workers,
            load_vehicle(given.vehicle),
        )
        good = [row for row in rows if "refused" not in row]
        print(
            json.dumps({"kind": kind} | tally(good) | {"refused": len(rows) - len(good)}, indent=1),
            flush=True,
        )


if __name__ == "__main__":
    sys.exit(main())
