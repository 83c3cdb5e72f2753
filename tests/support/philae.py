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
from sunspin.estimate.posterior.model import State, model
from sunspin.philae import candidates
from sunspin.philae.rebound import make_rebound, published_candidates, scan_grid, with_telemetry
from sunspin.vehicle import Vehicle
from tests.support.posteriors import tree_of
from validation.calibrate import AS_DRAWN as PRIORS_AS_DRAWN

CASE = ss.load_case("philae")
SUN = ss.sun_directions(CASE.vehicle, CASE.telemetry)


def with_panels_as_drawn(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle without the sigmas of its panels' normals."""
    normals = {key for key in vehicle.facts if key.endswith(("normal_B", "turned_B_rad"))}
    facts = {
        key: replace(fact, sigma=None) if key in normals else fact
        for key, fact in vehicle.facts.items()
    }
    return replace(vehicle, facts=facts)


AS_DRAWN_FILE = Path(__file__).parents[1] / "philae" / "panels_as_drawn.csv"
AS_DRAWN_TRUTH = tomllib.loads(AS_DRAWN_FILE.with_suffix(".toml").read_text("utf-8"))
AS_DRAWN = with_telemetry(
    replace(CASE, vehicle=with_panels_as_drawn(CASE.vehicle)),
    ss.read_telemetry(AS_DRAWN_FILE, CASE.vehicle),
)
SUN_AS_DRAWN = ss.sun_directions(AS_DRAWN.vehicle, AS_DRAWN.telemetry)


def philae_draws(n: int, spread: float = 0.0, seed: int = 0) -> tuple[xr.DataTree, State]:
    """Return a posterior of `n` draws about the truth of `AS_DRAWN`, as a tree and as a state.

    Rates are scattered by `spread` rad/s, the other unknowns by half of their prior sigma; without `spread` all are the truth.
    """
    rng = np.random.default_rng(seed)
    unknown, _ = model(AS_DRAWN.vehicle, PRIORS_AS_DRAWN, 1.0)
    truth, sun = (np.array(AS_DRAWN_TRUTH[key]) for key in ("omega_B", "sun_B"))
    u = 0.5 * rng.standard_normal((n, len(unknown.unknowns))) * (spread > 0)
    u[:, unknown.where("scale")] = np.log(0.02)
    state = State(
        truth + spread * rng.standard_normal((n, 3)), np.tile(sun / np.linalg.norm(sun), (n, 1)), u
    )
    last = float(
        AS_DRAWN.telemetry["time"].values[AS_DRAWN.telemetry["phase"].values == "first_rebound"][-1]
    )
    return tree_of(
        AS_DRAWN.vehicle,
        state,
        PRIORS_AS_DRAWN,
        25200.0,
        last,
        23,
        epoch_utc="2014-11-12T08:35:00Z",
    ), state


def chain_on_the_lines(case: Case) -> candidates.CandidateSets:
    """Return the chain of the study: candidates on the published lines, a coarse grid as scan range, a few as the paper's set."""
    rebound = make_rebound(case, ss.sun_directions(case.vehicle, case.telemetry))
    axes = scan_grid(case, 15)
    points_of_grid = np.stack(np.meshgrid(*axes.values(), indexing="ij"), axis=-1).reshape(-1, 3)
    lines = published_candidates(case)
    sets = {
        "set": ("published", lines),
        "scan_range": ("scan", points_of_grid),
        "near_minimum": ("scan", lines[::7]),
    }
    chosen, scan_range, near_minimum = (
        candidates.make_candidates(
            rebound, rebound.states(points), 0, source=source, about=f"{name} of the test"
        )
        for name, (source, points) in sets.items()
    )
    return candidates.CandidateSets(
        case, rebound, chosen, scan_range, near_minimum, None, float("nan")
    )
