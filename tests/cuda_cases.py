"""Short runs for a GPU or its simulator, and a program that runs them: `python cuda_cases.py results.npz`."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

import sunspin as ss
from sunspin.dynamics import ensemble as k
from sunspin.estimate.posterior.data import readings
from sunspin.estimate.posterior.likelihood import Likelihood
from sunspin.estimate.posterior.model import State, model
from vehicles import FIRST_SUN, philae_body, random_vehicle


def _rows(omega: list, speeds: list) -> k.Rows:
    n = len(omega)
    return k.Rows(
        np.array(omega, float), np.tile(FIRST_SUN, (n, 1)), np.tile(np.array(speeds, float), (n, 1))
    )


PHILAE, WHEELLESS = philae_body(), random_vehicle(np.random.default_rng(8), 0)
TUMBLING = [[0.3, -0.2, 0.1], [-0.4, 0.7, 0.2], [0.02, 0.01, -0.03]]
PANELS = k.Mask(
    np.array([[1.0, 0.0, 0.0], [0.6, 0.0, 0.8]]), (((0, True), (1, True)), ((0, False), (1, False)))
)

CASES = {
    # 0.5 rad/s about the body: friction stops the wheel after some seconds
    "a wheel that stops": (
        PHILAE,
        _rows(TUMBLING, [0.5]),
        np.array([3.0, 9.0]),
        {"direction_error": 1e-8},
    ),
    "backward": (PHILAE, _rows(TUMBLING, [865.0]), -2.0, {"direction_error": 1e-8}),
    "no wheel": (WHEELLESS, _rows(TUMBLING, []), 9.0, {"direction_error": 1e-8}),
    "a distribution": (PHILAE, _rows(TUMBLING, [0.5]), 30.0, {"emd_error": 1e-3, "bins": 64}),
    "of what counts": (
        PHILAE,
        _rows(TUMBLING[:1], [0.5]),
        30.0,
        {"emd_error": 1e-3, "bins": 64, "mask": PANELS},
    ),
    "with directions": (
        WHEELLESS,
        _rows(TUMBLING[:1], []),
        30.0,
        {"direction_error": 1e-6, "bins": 64, "mask": PANELS},
    ),
    "past unknown": (PHILAE, _rows(TUMBLING[:1], [0.0]), -2.0, {"direction_error": 1e-8}),
}


def run_case(name: str, device: str) -> k.BlockResult:
    vehicle, rows, duration, options = CASES[name]
    return k.run_rows(vehicle, rows, duration, device=device, **options)


def log_likelihoods(device: str) -> np.ndarray:
    """Of two motions of Philae under three samples of its twin, as a posterior asks for them."""
    case = ss.load_case("philae")
    data, start_s, _ = readings(case.vehicle, case.telemetry, phase="first_rebound")
    unknown, _ = model(case.vehicle, {}, 0.02)
    u = 0.3 * np.ones((2, len(unknown.unknowns)))
    motions = State(
        np.array([[-0.27, 0.07, 0.08], [0.1, 0.2, -0.1]]), np.tile(FIRST_SUN, (2, 1)), u
    )
    return Likelihood(replace(unknown, device=device), data.take(np.arange(3)), 1e-8)(motions)


def main(path: str) -> None:
    found = {"log_likelihoods": log_likelihoods("cuda")}
    for name in CASES:
        result = run_case(name, "cuda")
        for field in ("track", "hist", "outcome", "steps", "evenness"):
            found[f"{name}/{field}"] = getattr(result, field)
    np.savez(path, **found)


if __name__ == "__main__":
    main(sys.argv[1])
