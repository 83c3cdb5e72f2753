"""The study of coverage: its parts compared with independent ones, its statistics, its program."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from studies import coverage as study
from sunspin.base.errors import InputError, MotionError
from sunspin.cases import load_case
from sunspin.cli import cli
from sunspin.dynamics.batch import Rows
from sunspin.dynamics.propagate import propagate
from sunspin.estimate.scan.metrics import emd
from sunspin.estimate.scan.volume import make_table
from sunspin.philae import rebound as rb
from sunspin.philae import threshold
from sunspin.philae.metrics import simulate_rz

CASE = load_case("philae")
COARSE = 25  # 5 x 5 x 2 motions
AXES = {
    "omega_x": np.array([-0.2, 0.3]),
    "omega_y": np.array([0.1, 0.5, 0.6]),
    "omega_z": np.array([-0.1, 0.2]),
}


@pytest.fixture(scope="module")
def table():
    return make_table(CASE.vehicle, rb.first_sun(CASE), AXES, 865.0, rb.published_window_s(CASE))


@pytest.mark.evidence(
    "reproduce", "validated", "SciPy's Wasserstein distance of heyoka trajectories"
)
def test_distances_agree_with_the_reference_trajectory_and_scipy(table):
    z = np.random.default_rng(4).uniform(0.05, 0.95, 16)
    found = table.volume(z)
    for x, y, w in ((-0.2, 0.5, 0.2), (0.3, 0.1, -0.1)):
        reference = emd(simulate_rz(CASE, np.array([x, y, w])), z)
        distance = found.sel(omega_x=x, omega_y=y, omega_z=w).item()
        assert distance == pytest.approx(reference, abs=2e-3)


def test_rates_at_the_end_of_the_rebound_agree_with_the_reference():
    """A wheel is followed to its stop, and not back from it."""
    starts = np.array([[0.1, -0.3, 0.2], [0.0, 0.0, 0.0], [-0.4, 0.6, -0.2]])
    back, sun = rb.rates_at_touchdown(CASE, starts, 865.0), rb.first_sun(CASE)
    for omega, found in zip(starts, back, strict=True):
        times = [0.0, -rb.first_sample_lead_s(CASE)]
        run = propagate(CASE.vehicle, omega, sun, 865.0, times)
        np.testing.assert_allclose(found, run["omega_B"].values[-1], atol=1e-9)
    run = propagate(CASE.vehicle, [0.1, 0.0, 0.0], sun, 865.0, [0.0, 3000.0])
    assert run["wheel_speed_rad_s"].values[-1] == 0
    start = Rows(np.array([[0.1, 0.0, 0.0]]), sun[None], np.array([[865.0]]))
    end = rb.end_rates(CASE.vehicle, start, 3000.0)
    np.testing.assert_allclose(end, run["omega_B"].values[-1:], atol=1e-8)
    with pytest.raises(MotionError, match="its past is not determined"):
        rb.end_rates(CASE.vehicle, Rows(end, sun[None], np.array([[0.0]])), -60.0)


def test_dense_samples_without_noise_fit_their_own_motion_and_no_other():
    truth, other = np.array([-0.27, 0.07, 0.08]), np.array([0.5, 0.5, -0.2])
    states = rb.start_states(CASE, np.array([truth, other]), rb.first_sun(CASE))
    target = simulate_rz(CASE, truth), None
    window = rb.published_window_s(CASE)
    own, wrong = threshold.emd_of_truths(CASE, states, window, [target, target])
    assert own < 1e-3 and wrong > 0.02


def test_too_few_simulated_rebounds_are_refused():
    with pytest.raises(InputError, match="too few simulations.*ask for more"):
        threshold.quantile_threshold(np.ones(10), 0.95)
    with pytest.raises(InputError, match="between 0 and 1"):
        threshold.threshold_index(100, 1.0)


def test_coverage_shares_and_their_table_agree_with_figures_by_hand():
    """Wilson's interval of 0 of 10 ends at z^2 / (n + z^2) = 0.2775."""
    assert study.format_share(np.zeros(10, dtype=bool)) == "0.0% (0.0% to 27.8%)"
    row = {
        "truth_touchdown_speed": 0.2,
        "emd_min": 0.01,
        "bound_set": 0.1,
        "line_angle": [0.1] * 4,
        "factor_count": list(range(1, 81)),
        "factor_speed": [0.05] * 80,
    }
    rows = [row | {"emd_truth": 0.01 * (1 + k / 20)} for k in range(1, 21)]
    text = study.table({"lines": study.collect_values(rows)}, 160)
    at = int(np.searchsorted(study.FACTORS, 1.95)) + 1
    assert "| 20 | 5.0% (0.9% to 23.6%) | 100.0% (83.9% to 100.0%) | 1.95 (" in text
    assert f"| {at / 160:.0%} | 0.050 | 6, 6, 6, 6 |" in text


def test_the_coverage_study_resumes_and_writes_table_and_figure(tmp_path, capsys, framed):
    arguments = [str(tmp_path), "--twins=20", f"--coarser={COARSE}"]
    assert study.main(arguments) == 0
    assert "| truth on the published lines | 20 |" in capsys.readouterr().out
    names = ("coverage.md", "coverage.png")
    before = {name: (tmp_path / name).read_bytes() for name in names}
    kept = sorted(tmp_path.glob("*/*.json"))
    assert len(kept) == 40
    kept[7].unlink()
    assert study.main(arguments) == 0
    assert before == {name: (tmp_path / name).read_bytes() for name in names}
    assert study.main([str(tmp_path), "--twins=10"]) == 2
    assert "too few simulations" in capsys.readouterr().err


def test_a_scan_takes_a_calibrated_threshold():
    grid = "--omega-x-deg-s=-18:18:18 --omega-y-deg-s=-18:18:18 --omega-z-deg-s=0:12:12"
    options = f"--from=25200 --to=27899 {grid} --lines=0 --json".split()
    arguments = ["scan", "philae", str(CASE.folder / "telemetry.csv"), *options]
    usual, wide = (
        json.loads(CliRunner().invoke(cli, [*arguments, *more]).output)
        for more in ([], ["--threshold=1"])
    )
    assert usual["near_minimum_points"] < wide["near_minimum_points"] <= wide["rows"] == 18
    refused = CliRunner().invoke(cli, [*arguments, "--threshold=1e-9"])
    said = str(refused.exception or refused.output)
    assert refused.exit_code != 0 and "no motion of the grid comes below --threshold" in said


def test_the_readme_states_the_coverage_of_the_study_page():
    """The README counts the sets that held the truth; the page of the study gives their share."""
    root = Path(__file__).parents[2]
    readme = re.sub(r"\s+", " ", (root / "README.md").read_text("utf-8"))
    table = (root / "docs" / "studies.md").read_text("utf-8")
    rebounds, share = re.search(r"published lines \| (\d+) \| ([\d.]+)%", table).groups()
    held = re.search(r"It held the true motion in (\d+) of (\d+) simulated rebounds", readme)
    assert held is not None
    assert held[2] == rebounds and f"{100 * int(held[1]) / int(held[2]):.1f}" == share
