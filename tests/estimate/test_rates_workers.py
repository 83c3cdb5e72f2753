"""Rates on one or several processes: the same result and the same computing budget."""

import numpy as np
import pytest
import xarray as xr

import sunspin as ss
from validation.passes import FACES, observe, spin


@pytest.mark.long
@pytest.mark.parametrize("noise", [1e-5, None])
def test_rates_do_not_depend_on_the_number_of_workers(noise):
    """Eight passes of four samples of a cube."""
    t = np.concatenate([np.arange(0.0, 80.0, 20.0) + start for start in 3000.0 * np.arange(8)])
    each_pass = [spin(np.radians([1.0, -0.5, 0.8]), part) for part in np.split(t, 8)]
    omega, attitude = (np.concatenate(parts) for parts in zip(*each_pass, strict=True))
    made = observe(FACES, omega, attitude, t, 0.01, np.random.default_rng(3))
    setting = {"max_rate_rad_s": 0.03, "acceleration_noise": noise}
    one, two = (
        ss.rates(made.vehicle, made.telemetry, workers=workers, **setting) for workers in (1, 2)
    )
    assert one.sizes["pass_id"] == 8
    xr.testing.assert_allclose(one.drop_attrs(), two.drop_attrs(), rtol=1e-9)
    assert (
        one.attrs["verdict"] == two.attrs["verdict"] and one.attrs["effort"] == two.attrs["effort"]
    )
