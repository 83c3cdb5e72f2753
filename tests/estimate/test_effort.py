"""The computing budget of a search: counting, limits, and the undecided result of a stopped search."""

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import sunspin as ss
from sunspin.cli.rates import rates as command
from sunspin.estimate.effort import BATCH, Effort, allowed, may_go_on, spend
from sunspin.estimate.rates.motion import Body
from sunspin.estimate.rates.observe import observations
from sunspin.estimate.rates.search import seeds
from sunspin.estimate.rates.state import Motion
from sunspin.vehicle import Panel, Vehicle

NORMALS = np.vstack([np.eye(3), -np.eye(3)])
SPHERE = Vehicle(
    "sphere",
    gain_unit="W",
    panels=[Panel(name, n, 1.0) for name, n in zip("abcdef", NORMALS, strict=True)],
)


def test_effort_spent_in_a_part_counts_in_every_whole():
    with Effort(10.0 + 3 * BATCH) as whole:
        part = whole.part(4.0 + 2 * BATCH)
        with part:
            spend(3)
            assert may_go_on() and part.left == 1 + BATCH
            spend(2)
            assert not may_go_on() and part.cut and not whole.cut
        assert may_go_on() and whole.spent == 5 + 2 * BATCH
        spend(6)
        with whole.part(100.0) as other:
            assert not may_go_on() and other.cut  # nothing is left of the whole
    spend(1)  # nobody counts
    assert may_go_on() and whole.spent == 11 + 3 * BATCH


@pytest.mark.parametrize("given", [0, -1, np.nan, True, "ten", None])
def test_an_effort_that_is_not_positive_is_refused(given):
    with pytest.raises(ss.InputError, match="effort must be a positive number"):
        allowed(given)


@pytest.mark.parametrize("given", ["0", "nan", "-3"])
def test_the_option_effort_refuses_what_is_not_positive(given):
    done = CliRunner().invoke(command, ["vehicle", "telemetry", "--effort", given])
    assert isinstance(
        done.exception, ss.InputError
    ) and "--effort must be a positive number or inf" in str(done.exception)


def seen(n):
    """A sphere seen every 40 s, which leaves doubt about whole turns."""
    t = 40.0 * np.arange(n)
    run = ss.propagate(
        Vehicle("truth", inertia_kg_m2=np.eye(3)), [0.004, -0.003, 0.012], [0.6, 0.0, 0.8], None, t
    )
    power = np.maximum(
        ss.panel_power(SPHERE, run["sun_B"].values)
        + 0.02 * np.random.default_rng(1).normal(size=(n, 6)),
        0,
    )
    variables = {
        "power_W": (("time", "panel"), power),
        "flag": ("time", np.zeros(n, dtype=np.uint8)),
    }
    return xr.Dataset(
        variables,
        {"time": t, "panel": list("abcdef")},
        {"epoch_utc": "2026-01-01T00:00:00Z", "synthetic": 1},
    )


def test_a_search_at_its_budget_returns_the_best_so_far():
    o = observations(SPHERE, seen(4))[0]
    motion = Motion(Body.of(SPHERE), 1e-4, 0.03)
    with Effort(np.inf) as whole:
        seeds(o, motion, 0.06)
    with Effort(1.0) as little:
        track = seeds(o, motion, 0.06)
    assert little.cut and not whole.cut and little.spent < whole.spent
    assert len(track.cost) and np.isfinite(track.cost).all()


@pytest.mark.long
def test_a_search_stopped_at_its_budget_is_never_decided():
    setting = {"acceleration_noise": 1e-4, "max_rate_rad_s": 0.06}
    usual, cut = (ss.rates(SPHERE, seen(4), effort=effort, **setting) for effort in (1.0, 1e-6))
    assert (
        usual.attrs["cut_passes"] == 0
        and usual["search_complete"].all()
        and "CUT" not in usual.attrs["verdict"]
    )
    assert (
        cut.attrs["cut_passes"] == 1
        and not cut["search_complete"].any()
        and not cut["decided"].any()
    )
    assert "SEARCH STOPPED" in cut.attrs["verdict"] and cut.attrs["effort"] < usual.attrs["effort"]
    assert np.isfinite(cut["omega_mean_B"].values[:, 0]).all()
