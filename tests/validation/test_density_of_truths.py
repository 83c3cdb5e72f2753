"""The density that ranks the truth of a simulated case among draws."""

import numpy as np

from sunspin.cases import load_case
from validation.calibrate import log_density, make


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
