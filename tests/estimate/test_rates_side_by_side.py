"""Passes estimated in one process or in several: the same result and the same effort."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import xarray as xr

import sunspin as ss
from sunspin.estimate.effort import BATCH, Effort, may_go_on, spend
from sunspin.estimate.rates.side_by_side import begun, each
from validation.passes import FACES, seen, spin


def work(count):
    """What may be done of so much."""
    done = 0
    while done < count and may_go_on():
        spend(1)
        done += 1
    return done


def test_each_task_has_its_own_effort_wherever_it_runs():
    with ThreadPoolExecutor(2) as pool:
        for executor in (None, pool):
            with Effort(
                4.0 * (1 + BATCH)
            ) as whole:  # less than all may take: a task knows nothing of the others
                found = list(each(work, [(2,), (5,), (1,)], 3.0 * (1 + BATCH), whole, executor))
                assert found == [(2, False), (3, True), (1, False)]
                assert whole.spent == 6 * (1 + BATCH) and not may_go_on()


def test_tasks_that_are_begun_are_done_before_they_are_taken_and_counted_then():
    here, done = Effort(100.0 * (1 + BATCH)), []
    with ThreadPoolExecutor(1) as pool:
        taken = begun(
            lambda count: done.append(count) or work(count), [(2,), (5,)], 3.0 * (1 + BATCH), pool
        )
        pool.submit(int).result()  # whose turn comes after them
        assert done == [2, 5] and here.spent == 0
        with here:
            assert list(taken(here)) == [(2, False), (3, True)]
    assert here.spent == 5 * (1 + BATCH)


@pytest.mark.long
@pytest.mark.parametrize("noise", [1e-5, None])
def test_the_result_does_not_depend_on_the_workers(noise):
    """Eight passes of four samples of a cube."""
    t = np.concatenate([np.arange(0.0, 80.0, 20.0) + start for start in 3000.0 * np.arange(8)])
    each_pass = [spin(np.radians([1.0, -0.5, 0.8]), part) for part in np.split(t, 8)]
    omega, attitude = (np.concatenate(parts) for parts in zip(*each_pass, strict=True))
    made = seen(FACES, omega, attitude, t, 0.01, np.random.default_rng(3))
    setting = {"max_rate_rad_s": 0.03, "acceleration_noise": noise}
    one, two = (
        ss.rates(made.vehicle, made.telemetry, workers=workers, **setting) for workers in (1, 2)
    )
    assert one.sizes["pass_id"] == 8
    xr.testing.assert_allclose(one.drop_attrs(), two.drop_attrs(), rtol=1e-9)
    assert (
        one.attrs["verdict"] == two.attrs["verdict"] and one.attrs["effort"] == two.attrs["effort"]
    )
