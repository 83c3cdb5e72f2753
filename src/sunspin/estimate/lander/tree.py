"""The result of `posterior` as a DataTree: draws, solutions, and the numbers of the search and the sampling."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from sunspin.estimate.lander.carrier import Stage
from sunspin.estimate.lander.fit import FINAL_ERROR
from sunspin.estimate.lander.mixture import Mixture
from sunspin.estimate.lander.sample import resampled

LEAST_COUNTED = 0.01
"""A solution with less probability does not count: neither for uniqueness nor as an alias."""

LEAST_PROBABILITY = 1e-4
"""Solutions with less probability are not listed."""

TOO_FEW = 10.0
"""Effective sample size below which the covariance of a solution is that of all rates proposed there, as the few draws that have
weight spread too little. A solution with a probability below `LEAST_COUNTED` is then not listed."""

OF_SOLUTION = 4000
"""Draws of equal weight that give mean and covariance of a solution."""

BEST_OF = 100
"""Draws of a solution, in addition to those in the result, among which the one of the largest likelihood is chosen."""

EACH = ("chain", "draw")
"""Dimensions of the draws."""


def group(tree: xr.DataTree, name: str) -> xr.Dataset:
    """Return the variables of one group of the result of `posterior`."""
    return tree.children[name].to_dataset()


def tree_of(
    mix: Mixture, picked: np.ndarray, stages: Sequence[Stage], prior_sigma: float
) -> xr.DataTree:
    """Return the groups `posterior`, `solutions`, `search` and `sampling` of the result.

    `picked`: indices of draws of equal weight, those of the result; `stages`: the windows of the search; `prior_sigma` (rad/s): of
    a component of the rate before the data.
    """
    likelihood = mix.log_likelihood(picked)
    numbers, rounds = np.array(stages, dtype=np.int64).reshape(-1, 3), mix.draws.rounds
    search = ("samples", "hypotheses", "kept")  # hypotheses: motions that were fitted
    sampling = ("log_evidence", "effective_share", "pareto_k")
    groups = {
        "posterior": _draws(mix, picked, likelihood),
        "solutions": _solution_rows(mix, picked, likelihood, prior_sigma),
        "search": xr.Dataset({name: ("stage", numbers[:, i]) for i, name in enumerate(search)}),
        "sampling": xr.Dataset({name: ("round", rounds[:, i]) for i, name in enumerate(sampling)}),
    }
    return xr.DataTree.from_dict(groups)


def _draws(mix: Mixture, picked: np.ndarray, log_likelihood: np.ndarray) -> xr.Dataset:
    """Return the draws of the result over (chain, draw): states at the first sample, unknowns, solution and likelihood.

    `picked` (n): indices of draws of equal weight; `log_likelihood` (n) of them.
    """
    first, values, count = mix.first_states(picked), mix.unknown_values(picked), len(picked)
    rate = {"units": "rad s-1", "long_name": "body rate at the first sample"}
    sun = {"units": "1", "long_name": "direction to the Sun at the first sample"}
    steady = {
        "units": "rad s-2",
        "long_name": "steady torques over the mean moment of inertia, in body axes at the first sample",
    }
    variables: dict[str, Any] = {
        "omega_B": ((*EACH, "axis"), first.omega[None], rate),
        "sun_B": ((*EACH, "axis"), first.sun[None], sun),
        "wheel_speed_rad_s": ((*EACH, "wheel"), first.wheels[None], {"units": "rad s-1"}),
        "solution_id": (EACH, mix.draws.solution[picked][None]),
        "log_weight": (EACH, np.full((1, count), -np.log(count)), {"units": "1"}),
        "log_likelihood_sum": (EACH, log_likelihood[None], {"units": "1"}),
        "steady_torque": ((*EACH, "stays_in", "axis"), first.steady[None], steady),
    }
    for unknown in mix.nominal.unknowns:
        if unknown.kind != "wheel_speed":  # `wheel_speed_rad_s` holds those
            about = {
                "units": unknown.unit,
                "prior_centre": unknown.centre,
                "prior_sigma": unknown.sigma,
            }
            variables[unknown.name] = (EACH, values[unknown.name][None], about)
    coords = {
        "axis": ["x", "y", "z"],
        "stays_in": ["body", "space"],
        "wheel": [wheel.name for wheel in mix.nominal.vehicle.wheels],
        "chain": [0],
        "draw": np.arange(count),
    }
    return xr.Dataset(variables, coords)


OF_SOLUTIONS = {
    "omega_B": "rad s-1",
    "omega_cov_B": "rad2 s-2",
    "sun_B": "1",
    "probability": "1",
    "log_evidence": "1",
    "best_omega_B": "rad s-1",
    "chi_square": "1",
    "lit_readings": "1",
    "starts": "1",
    "effective_draws": "1",
}
"""Variables of the group `solutions`, at the first sample -> their units."""


def _solution_rows(
    mix: Mixture, picked: np.ndarray, log_likelihood: np.ndarray, prior_sigma: float
) -> xr.Dataset:
    """Return the variables `OF_SOLUTIONS` of each listed solution, from its draws; the most probable solution comes first.

    `picked` (n): indices of the draws of the result; `log_likelihood` (n) of them; `prior_sigma` (rad/s) as in :func:`tree_of`.
    """
    rng = np.random.default_rng(0)
    count = _listed(mix)
    rows = []  # of each solution, the values of `OF_SOLUTIONS` in their order
    for solution in range(count):
        indices = mix.inside(solution)
        # draws of equal weight; one that was chosen several times is propagated once
        even = indices[resampled(mix.draws.log_weight[indices], OF_SOLUTION, rng)]
        distinct, times = np.unique(even, return_counts=True)
        weight, first = times / OF_SOLUTION, mix.first_states(distinct)
        mean, sun = weight @ first.omega, weight @ first.sun
        off = first.omega - mean
        covariance = np.einsum("n,ni,nj->ij", weight, off, off)
        effective = mix.effective(solution)
        if effective < TOO_FEW:
            covariance = _proposed_covariance(mix, indices, mean, prior_sigma)

        # The draw of the largest likelihood: of those in the result, and of some more, as the result may have none of a solution.
        in_result = mix.draws.solution[picked] == solution
        tried = np.concatenate([picked[in_result], even[:BEST_OF]])
        likelihoods = [log_likelihood[in_result], mix.log_likelihood(even[:BEST_OF])]
        best = tried[[int(np.argmax(np.concatenate(likelihoods)))]]
        rows.append(
            (
                mean,
                covariance,
                sun / np.linalg.norm(sun),
                mix.share[solution],
                mix.draws.log_evidence + np.log(mix.share[solution]),
                mix.first_states(best).omega[0],
                *_chi_square(mix, best),
                int(mix.starts[solution]),
                effective,
            )
        )
    variables = {}
    for (name, units), values in zip(OF_SOLUTIONS.items(), zip(*rows, strict=True), strict=True):
        value = np.array(values)
        dims = ("solution", "axis", "axis2")[: value.ndim]
        variables[name] = (dims, value, {"units": units})
    return xr.Dataset(variables, {"solution": np.arange(count), "axis": ["x", "y", "z"]})


def _listed(mix: Mixture) -> int:
    """Return how many solutions are listed: those before the first that is too improbable, but one at least.

    Too improbable are those below `LEAST_PROBABILITY`, and those below `LEAST_COUNTED` with an effective size below `TOO_FEW`.
    """
    for solution, share in enumerate(mix.share):
        too_few = share < LEAST_COUNTED and mix.effective(solution) < TOO_FEW
        if share <= LEAST_PROBABILITY or too_few:
            return max(1, solution)
    return len(mix.share)


def _proposed_covariance(
    mix: Mixture, indices: np.ndarray, mean: np.ndarray, prior_sigma: float
) -> np.ndarray:
    """Return the covariance (3, 3) about `mean` (3) of the rates of the draws `indices`, all with the same weight, (rad/s)^2.

    If they are too few the covariance is that of the prior. If they are many, evenly spaced ones are used.
    """
    if len(indices) < TOO_FEW:
        return prior_sigma**2 * np.eye(3)
    step = -(-len(indices) // OF_SOLUTION)  # rounded up
    off = mix.first_states(indices[::step]).omega - mean
    return off.T @ off / len(off)


def _chi_square(mix: Mixture, best: np.ndarray) -> tuple[float, int]:
    """Return the sum of squared residuals of lit readings in stated sigmas, and the number of these, for the draw `best` (1)."""
    model, _, motions = next(mix.by_model(best))
    panels = model.panels
    states = model.sun_states(motions, FINAL_ERROR)
    residual, *_ = panels.residuals(states, motions.u[:, model.of_panels])
    lit = panels.lit
    return float(np.sum(residual.value[0][lit] ** 2)), int(np.count_nonzero(lit))
