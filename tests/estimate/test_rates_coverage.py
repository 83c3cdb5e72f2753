"""Do the intervals of rates hold what they say, with every kind of fault and all of them? The telemetry is synthetic."""

import numpy as np
import pytest

from coverage_twins import FAULTS, coverage

KINDS = [name for name in FAULTS if name != "sides"]  # those of four faces: test_rates_four


@pytest.mark.slow
def test_intervals_hold_the_truth_with_all_faults_at_once():
    """Eight twins, 24 components: enough to notice intervals that are wrong by a factor, which the control shows."""
    found = coverage(FAULTS["everything"], 8, seed=5)
    assert 0.25 < found.half < 0.8 and found.ninety > 0.66
    assert found.too_narrow < 0.5
    assert found.error < np.radians(0.05)  # of 1 to 3 deg/s


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_intervals_hold_the_truth(name):
    """Forty twins, 120 components, not independent within a twin: a share is known to about 5 %."""
    found = coverage(FAULTS[name], 40, seed=1)
    print(
        f"{name}: 50 % holds {found.half:.0%}, 90 % holds {found.ninety:.0%}, error {np.degrees(found.error):.3f} deg/s"
    )
    assert 0.35 < found.half < 0.8
    assert found.ninety > 0.74
    assert found.too_narrow < 0.55
