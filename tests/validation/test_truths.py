"""When a rate is wrong, when the truth is in a list of solutions, and how its density ranks among draws."""

import numpy as np
import xarray as xr

from sunspin.cases import load_case
from validation.calibrate import log_density, make
from validation.truths import is_in_solutions, is_listed, is_wrong

FAST, SLOW = np.radians([1.0, 0.0, 0.0]), np.radians([0.2, 0.0, 0.0])
SHARP = np.radians([0.001, 0.001, 0.001])


def test_wrong_is_five_sigmas_and_a_tenth_of_a_degree_or_a_fifth_of_a_slow_rate():
    for truth, off_deg_s, sigma_deg_s, wrong in (
        (FAST, 0.09, 0.001, False),  # many sigmas, and less than 0.1 deg/s
        (FAST, 0.11, 0.001, True),
        (FAST, 0.11, 0.03, False),  # fewer than five sigmas
        (SLOW, 0.05, 0.001, True),  # more than a fifth of a slow rate
        (SLOW, 0.03, 0.001, False),
    ):
        omega = truth + np.radians([0.0, off_deg_s, 0.0])
        assert is_wrong(omega, np.radians(np.full(3, sigma_deg_s)), truth) is wrong


def test_a_truth_is_listed_if_any_printed_solution_contains_it():
    omega = np.stack([FAST + np.radians([2.0, 0, 0]), FAST, np.full(3, np.nan)])
    sigma = np.stack([SHARP, SHARP, np.full(3, np.nan)])
    assert is_listed(omega, sigma, np.array([0.99, 0.01, np.nan]), FAST)
    assert not is_listed(omega, sigma, np.array([0.9999, 1e-4, np.nan]), FAST)
    assert not is_listed(omega[:1], sigma[:1], np.ones(1), FAST)
    # a fifth of the true speed is near enough, whatever the sigma
    assert is_listed(1.15 * FAST[None], SHARP[None], np.ones(1), FAST)
    assert not is_listed(1.25 * FAST[None], SHARP[None], np.ones(1), FAST)


def test_the_solutions_of_a_posterior_are_judged_by_their_covariance():
    covariance = np.radians(0.3) ** 2 * np.eye(3)
    solutions = xr.Dataset(
        {
            "omega_B": (("solution", "axis"), (2 * FAST)[None]),
            "omega_cov_B": (("solution", "axis", "axis2"), covariance[None]),
            "probability": ("solution", np.ones(1)),
        }
    )
    assert is_in_solutions(solutions, FAST)
    assert not is_in_solutions(solutions.assign(omega_cov_B=solutions["omega_cov_B"] / 9), FAST)


def test_the_density_of_the_truth_exceeds_that_of_motions_beside_it():
    """Of a case drawn from the prior: a rate that is off by 0.2 deg/s, or a moment by 3 %, is less likely by far."""
    vehicle = load_case("philae").vehicle
    telemetry, truth, priors = make(vehicle, "unknown", 0.25, 16, 20.0, 0, 0)
    omega, sun = np.tile(truth.omega_B, (3, 1)), np.tile(truth.sun_B, (3, 1))
    omega[1, 0] += np.radians(0.2)
    values = {name: np.full(3, value) for name, value in truth.values.items()}
    values["inertia_zz"][2] *= 1.03
    true, *beside = log_density(vehicle, telemetry, priors, omega, sun, values)
    assert np.isfinite(true) and true > 4 + max(beside)
