"""The built-in case of Philae for tests: its Sun directions, an older telemetry file, draws about the truth, a small chain.

`CASE` and `SUN` are the case and its Sun directions, computed once for all tests. `AS_DRAWN` is the case with panels exactly as
drawn in the paper and telemetry without a direction at rest: of forty seeds, the one whose speed after the collision is nearest to
the magnetometer's. It is in `tests/philae/panels_as_drawn.csv`, with its truth beside it.
"""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr

import sunspin as ss
from sunspin.cases import Case
from sunspin.philae import candidates
from sunspin.philae.rebound import make_rebound, published_candidates, scan_grid, with_telemetry
from sunspin.vehicle import Vehicle
from tests.support.posteriors import tree_of

CASE = ss.load_case("philae")
SUN = ss.sun_directions(CASE.vehicle, CASE.telemetry)


def with_panels_as_drawn(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle without the sigmas of its panels' normals."""
    normals = {key for key in vehicle.facts if key.endswith(("normal_B", "turned_B_rad"))}
    drawn = {key: replace(vehicle.facts[key], sigma=None) for key in normals}
    return replace(vehicle, facts=vehicle.facts | drawn)


AS_DRAWN_FILE = Path(__file__).parents[1] / "philae" / "panels_as_drawn.csv"
AS_DRAWN_TRUTH = tomllib.loads(AS_DRAWN_FILE.with_suffix(".toml").read_text("utf-8"))
CASE_AS_DRAWN = replace(CASE, vehicle=with_panels_as_drawn(CASE.vehicle))
AS_DRAWN = with_telemetry(CASE_AS_DRAWN, ss.read_telemetry(AS_DRAWN_FILE, CASE.vehicle))
SUN_AS_DRAWN = ss.sun_directions(AS_DRAWN.vehicle, AS_DRAWN.telemetry)


def philae_draws(n: int, spread: float = 0.0, seed: int = 0) -> xr.DataTree:
    """Return a posterior of `n` draws about the truth of `AS_DRAWN`.

    Rates are scattered by `spread` rad/s, moments by 0.5 %, the wheel's speed by 0.25 % and its friction by 2.5 %; without `spread`
    all are the truth.
    """
    rng, vehicle = np.random.default_rng(seed), AS_DRAWN.vehicle
    truth, sun = (np.array(AS_DRAWN_TRUTH[key]) for key in ("omega_B", "sun_B"))
    off = rng.standard_normal((n, 6)) * (spread > 0)
    inertia = vehicle.require_inertia()
    unknowns = {
        f"inertia_{a}{a}": inertia[k, k] * (1 + 0.005 * off[:, k]) for k, a in enumerate("xyz")
    }
    unknowns["wheel_speed_rad_s"] = vehicle.wheels[0].speed_rad_s * (1 + 0.0025 * off[:, 3:4])
    for k, kind in enumerate(("coulomb", "viscous"), 4):
        unknowns[f"log_{kind}"] = 0.025 * off[:, k]
    samples = AS_DRAWN.telemetry["phase"].values == "first_rebound"
    last = float(AS_DRAWN.telemetry["time"].values[samples][-1])
    omega = truth + spread * rng.standard_normal((n, 3))
    suns, epoch = np.tile(sun / np.linalg.norm(sun), (n, 1)), "2014-11-12T08:35:00Z"
    return tree_of(vehicle, omega, suns, unknowns, (25200.0, last), epoch_utc=epoch)


def chain_on_the_lines(case: Case) -> candidates.CandidateSets:
    """Return the chain of the study: candidates on the published lines, a coarse grid as scan range, a few as the paper's set."""
    rebound = make_rebound(case, ss.sun_directions(case.vehicle, case.telemetry))
    axes = scan_grid(case, 15)
    points_of_grid = np.stack(np.meshgrid(*axes.values(), indexing="ij"), axis=-1).reshape(-1, 3)
    lines = published_candidates(case)

    def made(name: str, points: np.ndarray, source: str = "scan") -> candidates.Candidates:
        about, states = f"{name} of the test", rebound.states(points)
        return candidates.make_candidates(rebound, states, 0, source=source, about=about)

    sets = made("set", lines, "published"), made("scan_range", points_of_grid)
    near_minimum = made("near_minimum", lines[::7])
    return candidates.CandidateSets(case, rebound, *sets, near_minimum, None, float("nan"))
