"""The benchmarks run, write what they say they write, and their contestants integrate the problem that sunspin integrates.

No time is tested here.
"""

import numpy as np
import pytest

import sunspin as ss
from bench.__main__ import main
from bench.baselines import DormandPrince, TaylorBatch
from bench.problem import grid_sample, philae

PHILAE = philae()
RATES = grid_sample(PHILAE.axes(51, 51, 21), 3)


@pytest.fixture(scope="module")
def reference() -> list:
    starts = PHILAE.starts(RATES)
    args = PHILAE.sun_B, PHILAE.wheel_speed_rad_s, [0.0, PHILAE.window_s]
    return [ss.propagate(PHILAE.vehicle, omega, *args) for omega in PHILAE.rates(starts)]


def test_the_quick_emd_benchmark_runs_and_contestants_agree(capsys):
    main(["--quick", "--only", "emd"])
    lines = [line.split("|")[1:-1] for line in capsys.readouterr().out.splitlines() if "|" in line]
    differences = [float(cells[2]) for cells in lines[2:] if cells[2].strip() != "-"]
    assert len(differences) >= 2 and max(differences) < 1e-9


@pytest.mark.parametrize(
    ("make", "rows", "error"),
    [
        # two batches, the second not full
        (lambda problem: TaylorBatch(problem, 1e-9, 2), 3, 1e-4),
        (lambda problem: DormandPrince(problem, 1e-6), 1, 1e-2),
    ],
    ids=["batch", "scipy"],
)
def test_contestants_of_the_scan_benchmark_agree_with_the_reference(make, rows, error, reference):
    end = make(PHILAE)(PHILAE.starts(RATES)[:rows])
    stops = [run["event_time_s"].values for run in reference[:rows]]
    np.testing.assert_allclose(end.stop_s, np.concatenate(stops), atol=error)
    suns = [run["sun_B"].values[-1] for run in reference[:rows]]
    np.testing.assert_allclose(end.sun_B, suns, atol=error)
