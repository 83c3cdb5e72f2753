"""The file of a posterior opens in ArviZ: up to 0.x as InferenceData, from 1.0 as a DataTree."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
import xarray as xr

from sunspin.output.folder import write_netcdf
from tests.support.philae import philae_draws

pytestmark = pytest.mark.filterwarnings("ignore")  # ArviZ's own


def summary(path):
    """The table of ArviZ for a file, by the old package or by the parts of the new one."""
    options = {"var_names": ["omega_B", "inertia_xx"], "kind": "stats"}
    if importlib.util.find_spec("arviz") is not None:
        import arviz

        if int(arviz.__version__.split(".")[0]) < 1:
            return arviz.summary(arviz.from_netcdf(str(path), engine="h5netcdf"), **options)
        return arviz.summary(xr.open_datatree(path), round_to="none", **options)
    stats = pytest.importorskip("arviz_stats", reason="neither arviz nor arviz-stats is installed")
    if not hasattr(stats, "summary"):
        pytest.skip("arviz-stats without its extra [xarray]")
    return stats.summary(xr.open_datatree(path), round_to="none", **options)


@pytest.mark.evidence("posterior", "validated", "ArviZ reads the file and computes the same means")
def test_arviz_opens_and_summarises_the_file_of_a_posterior(tmp_path):
    tree = philae_draws(400, 0.003)
    table = summary(write_netcdf(tmp_path / "posterior.nc", tree))
    mean, draws = table["mean"].astype(float), tree["posterior"]["omega_B"].values[0]
    assert list(table.index) == ["omega_B[x]", "omega_B[y]", "omega_B[z]", "inertia_xx"]
    assert np.allclose(mean.iloc[:3], draws.mean(axis=0), rtol=0, atol=6e-4)
    assert mean.iloc[3] == pytest.approx(13.905, abs=0.05)
