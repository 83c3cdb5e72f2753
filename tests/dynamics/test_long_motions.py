"""Motions that need more steps than allowed."""

import numpy as np
import pytest

from sunspin.base.errors import SunspinError
from sunspin.dynamics import batch
from tests.support.vehicles import small_cube


def test_one_motion_that_exceeds_its_steps_does_not_end_the_others():
    cube, sun = small_cube(), np.tile([0.6, 0.0, 0.8], (2, 1))
    rows = batch.Rows(np.array([[0.1, 0.0, 0.0], [1e6, 0.0, 0.0]]), sun, np.zeros((2, 0)))
    with pytest.raises(SunspinError, match="needs"):
        batch.run(cube, rows, [100.0])
    run = batch.run(cube, rows, [100.0], leave_long=True)
    assert run.outcome.tolist() == [batch.Outcome.FINE, batch.Outcome.NOT_FINITE]
    alone = batch.run(cube, rows.take(np.array([0])), [100.0])
    np.testing.assert_array_equal(run.sun_B[0], alone.sun_B[0])
    assert np.isnan(run.sun_B[1]).all()
