"""The method on twins: its pieces against independent ones, its statistics against what they must give, its file and command."""

import json
import re
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from sunspin.base.errors import InputError, MotionError
from sunspin.cli import cli
from sunspin.compute.rows import ensemble
from sunspin.dynamics.ensemble import Rows
from sunspin.dynamics.propagate import propagate
from sunspin.estimate.scan import coverage as lv
from sunspin.estimate.scan.end_rates import end_rates
from sunspin.estimate.scan.metrics import emd
from sunspin.estimate.scan.table import make_table
from sunspin.estimate.scan.volume import scan
from sunspin.philae import coverage as wo
from sunspin.philae import coverage_results, coverage_rows, threshold
from sunspin.philae import rebound as rb
from sunspin.philae.coverage_results import Coverage
from sunspin.philae.coverage_twins import LEAST_TOLD, TwinRows, draw_twin, samples_z, truth_distance
from sunspin.telemetry.case import load_case

CASE = load_case("philae")
COARSE = 25  # 5 x 5 x 2 motions
AXES = {
    "omega_x": np.array([-0.2, 0.3]),
    "omega_y": np.array([0.1, 0.5, 0.6]),
    "omega_z": np.array([-0.1, 0.2]),
}


@pytest.fixture(scope="module")
def table():
    return make_table(CASE.vehicle, rb.first_sun(CASE), AXES, 865.0, rb.window_s(CASE))


def test_a_table_gives_the_bits_of_a_scan_for_every_target(table):
    rng = np.random.default_rng(3)
    for _ in range(3):
        z = rng.uniform(0.05, 0.95, 16)
        alone = scan(CASE.vehicle, z, rb.first_sun(CASE), *AXES.values(), 865.0, rb.window_s(CASE))
        np.testing.assert_array_equal(table.volume(z).values, alone.values)
    assert table.volume(z).dims == alone.dims and table.volume(z).attrs == alone.attrs


@pytest.mark.evidence("worth", "validated", "SciPy's Wasserstein distance of heyoka trajectories")
def test_distances_agree_with_the_reference_trajectory_and_scipy(table):
    z = np.random.default_rng(4).uniform(0.05, 0.95, 16)
    found = table.volume(z)
    for x, y, w in ((-0.2, 0.5, 0.2), (0.3, 0.1, -0.1)):
        reference = emd(rb.seen_z(CASE, np.array([x, y, w])), z)
        assert found.sel(omega_x=x, omega_y=y, omega_z=w).item() == pytest.approx(
            reference, abs=2e-3
        )


def test_rates_at_the_end_are_those_of_the_reference():
    starts = np.array([[0.1, -0.3, 0.2], [0.0, 0.0, 0.0], [-0.4, 0.6, -0.2]])
    back = rb.at_touchdown(CASE, starts, 865.0)
    for omega, found in zip(starts, back, strict=True):
        run = propagate(
            CASE.vehicle, omega, rb.first_sun(CASE), 865.0, [0.0, -rb.after_touchdown_s(CASE)]
        )
        np.testing.assert_allclose(found, run["omega_B"].values[-1], atol=1e-9)


def test_rates_at_the_end_follow_a_wheel_that_stops_but_not_back_into_one_that_is_stuck():
    omega, sun = np.array([[0.1, 0.0, 0.0]]), rb.first_sun(CASE)
    run = propagate(CASE.vehicle, omega[0], sun, 865.0, [0.0, 3000.0])
    assert run["wheel_speed_rad_s"].values[-1] == 0
    found = end_rates(CASE.vehicle, Rows(omega, sun[None], np.array([[865.0]])), 3000.0)
    np.testing.assert_allclose(found, run["omega_B"].values[-1:], atol=1e-8)
    with pytest.raises(MotionError, match="its past is not determined"):
        end_rates(CASE.vehicle, Rows(found, sun[None], np.array([[0.0]])), -60.0)


def test_a_wheel_at_rest_at_the_first_sample_is_taken_to_have_stood_still_since_the_touchdown():
    omega = np.array([[0.1, -0.3, 0.2]])
    run = propagate(
        CASE.vehicle,
        omega[0],
        rb.first_sun(CASE),
        0.0,
        [0.0, -rb.after_touchdown_s(CASE)],
        wheel_mode="hold",
    )
    np.testing.assert_allclose(
        rb.at_touchdown(CASE, omega, 0.0), run["omega_B"].values[-1:], atol=1e-9
    )


def test_a_twin_without_noise_and_with_dense_samples_fits_its_truth():
    """Negative control beside it: the samples of another motion do not fit."""
    truth, other = np.array([-0.27, 0.07, 0.08]), np.array([0.5, 0.5, -0.2])
    assert truth_distance(CASE, truth, rb.seen_z(CASE, truth)) < 1e-3
    assert truth_distance(CASE, other, rb.seen_z(CASE, truth)) > 0.02


def test_twins_look_like_the_synthetic_telemetry():
    counts = [
        samples_z(CASE, np.array([-0.27, 0.07, 0.08]), np.random.default_rng(i)).size
        for i in range(5)
    ]
    assert min(counts) >= 10 and max(counts) <= 23
    truth, z = draw_twin(CASE, "grid", np.random.default_rng(0))
    assert z.size >= LEAST_TOLD and np.all(np.abs(truth) <= 1)
    on_line, _ = draw_twin(CASE, "lines", np.random.default_rng(0))
    away = [np.linalg.norm(np.cross(on_line - p, d)) for p, d in rb.published_lines(CASE)]
    assert min(away) < 1e-12


def test_a_twin_is_the_same_alone_in_company_and_resumed(tmp_path):
    rows = TwinRows("philae", "lines", 4, 7, COARSE)
    together = ensemble(rows, chunk=4)
    alone = ensemble(rows, index=[2])
    kept = ensemble(rows, chunk=1, store=tmp_path / "twins")
    again = ensemble(rows, chunk=1, store=tmp_path / "twins")
    for name, values in together.items():
        np.testing.assert_array_equal(alone[name][0], values[2])
        np.testing.assert_array_equal(kept[name], values)
        np.testing.assert_array_equal(again[name], values)


def test_what_is_kept_of_a_twin_is_consistent():
    rows = TwinRows("philae", "grid", 3, 1, COARSE)
    out, ground = ensemble(rows), rows.ground()
    assert np.all(out["points"] >= 1) and np.all(np.diff(out["level_count"], axis=1) >= 0)
    assert np.all(out["bound_set"] >= ground.touchdown_speed.min())
    speed = np.where(np.isnan(out["level_speed"]), np.inf, out["level_speed"])
    assert np.all(speed[:, 1:] <= speed[:, :-1])  # larger sets have smaller bounds
    assert np.all(out["emd_min"] > 0) and np.all(out["truth_to_set"] >= 0)


@pytest.mark.parametrize(
    "wrong",
    [{"prior": "ring"}, {"factor": 1.0}, {"n": 0}, {"seed": -1}, {"coarser": 0}, {"n": True}],
    ids=str,
)
def test_wrong_setups_are_refused(wrong):
    with pytest.raises(InputError, match="must"):
        replace(TwinRows("philae", "lines", 4, 0), **wrong)


def _twins(emd_truth, emd_min):
    n = len(emd_min)
    twin = {name: np.ones(n) for name in lv.UNITS} | {"emd_truth": emd_truth, "emd_min": emd_min}
    table = {
        "at": np.array([1.0, 2.0, 3.0]),
        "count": np.ones((3, 3)),
        "speed": np.ones((3, 3)),
        "holds": np.array([1, n - 1, n]),
    }
    return lv.Twins(twin, table, table)


def test_shares_by_hand():
    """Wilson's interval of 0 of 10 ends at z^2 / (n + z^2) = 0.2775."""
    low, high = lv.Share(0, 10).interval
    assert low == pytest.approx(0.0, abs=1e-12) and high == pytest.approx(0.27754, abs=1e-4)
    assert lv.Share(5, 10).value == 0.5 and lv.Share(0, 0).interval == (0.0, 1.0)


@pytest.mark.evidence("worth", "verified", "order statistics of 4,000 drawn studies")
def test_a_threshold_holds_a_further_truth_as_often_as_it_says(reached):
    """Over many studies of 99 twins a further twin lies below the 90 % threshold in 90 % of the cases: exactly 90 of 100 ranks."""
    rng = np.random.default_rng(11)
    n, studies = 99, 4000
    held = [
        rng.gamma(2.0) < _twins(rng.gamma(2.0, size=n), np.ones(n)).threshold(0.9, True)[0]
        for _ in range(studies)
    ]
    assert np.mean(held) == pytest.approx(0.9, abs=4 * np.sqrt(0.09 / studies))
    assert np.mean(held) != pytest.approx(
        0.85, abs=4 * np.sqrt(0.09 / studies)
    )  # a wrong confidence would be noticed
    reached("share of further truths held, asked for 0.9", np.mean(held))
    covered = 0
    for _ in range(500):
        _, low, high = _twins(rng.uniform(size=200), np.ones(200)).threshold(0.9, True)
        covered += low <= 0.9 <= high
    assert covered / 500 > 0.92


def test_too_few_twins_are_refused():
    with pytest.raises(InputError, match="too few twins.*ask for more"):
        _twins(np.ones(10), np.ones(10)).threshold(0.95, False)
    with pytest.raises(InputError, match="between 0 and 1"):
        lv.check_confidence(100, 1.0)


def test_the_bound_is_looked_up_from_where_it_holds_for_good():
    twins = _twins(np.ones(100), np.ones(100))
    assert twins.bound_threshold(0.9, False) == 2.0 and twins.bound_threshold(1.0, True) == 3.0
    assert twins.at(2.5, False)["threshold"] == 3.0


@pytest.mark.evidence("worth", "modelled", "300 synthetic rebounds of known truth")
def test_the_shipped_study_says_what_its_rows_say(reached):
    worth = wo.shipped(CASE)
    assert worth.attrs["command"] == "sunspin worth --twins 300 --seed 0" and set(
        lv.twins_of(worth)
    ) == {"lines", "grid"}
    rows = {row.id: row for row in coverage_rows.rows(CASE, worth)}
    lines = lv.twins_of(worth)["lines"]
    assert rows["worth_truth_in_set"].ours == pytest.approx(np.mean(lines.ratio < 1.1))
    assert (
        rows["worth_truth_in_set"].ours < 0.035 and 2.66 < rows["worth_factor_90"].ours < 5
    )  # both of panels as drawn
    reached("truth within 1.1 times the smallest EMD", rows["worth_truth_in_set"].ours)
    assert all("synthetic" in row.note for row in rows.values() if "sunspin worth" in row.note)
    again = lv.from_json(json.dumps(lv.to_json(worth)), "here")
    assert lv.to_json(again) == lv.to_json(worth)
    with pytest.raises(InputError, match="no result of `sunspin coverage`"):
        lv.from_json("{}", "here")


def test_a_coverage_keeps_its_names_beside_its_variables(monkeypatch):
    """Scripts ask for rows and sentences by name; a Dataset is what is stored."""
    shipped = wo.shipped(CASE)
    rows = json.dumps([asdict(row) for row in coverage_rows.rows(CASE, shipped)])
    found = Coverage(shipped.data_vars, shipped.coords, shipped.attrs).assign_attrs(
        figures=rows, seconds=1.5
    )
    assert "the truth lies in the set within 1.1 times the smallest EMD" in found["sentences"][0]
    assert {row["id"]: row["ours"] for row in found["figures"]}["worth_factor_90"] > 2.3
    assert (found["seconds"], found["folder"], found["changes"], found["confidence"]) == (
        1.5,
        None,
        [],
        0.9,
    )
    assert (
        found["line_angle"].dims == ("prior", "twin", "line")
        and found["line_angle"].attrs["units"] == "rad"
    )
    with pytest.raises(KeyError):
        found["nonsense"]
    without_lines = found.assign(line_angle=found["line_angle"] * np.nan)
    assert (
        "no set has four lines" in without_lines["sentences"][0]
        and "nan" not in without_lines["sentences"][0]
    )
    monkeypatch.setattr(coverage_results, "coverage", lambda *_, **__: found)
    printed = CliRunner().invoke(cli, ["coverage"], catch_exceptions=False).output.splitlines()
    assert printed[0] == found["sentences"][0] and len(printed) > 10


def test_the_command_writes_a_study_that_can_be_read_again(tmp_path, framed):
    out = tmp_path / "out"
    arguments = [
        "worth",
        "--twins=10",
        "--confidence=0.5",
        f"--coarser={COARSE}",
        f"--out={out}",
        "--json",
    ]
    done = CliRunner().invoke(cli, arguments, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    summary = json.loads(done.output)
    assert summary["synthetic_telemetry"] is True and any(
        row["id"] == "worth_factor_50" for row in summary["figures"]
    )
    found = lv.from_json((out / "worth.json").read_text("utf-8"), "out")
    assert lv.twins_of(found)["grid"].n == 10 and f"--coarser {COARSE}" in found.attrs["command"]
    page = (out / "report.html").read_text("utf-8")
    assert (
        "Synthetic telemetry" in page
        and (out / "worth.png").is_file()
        and (out / "coverage.nc").is_file()
    )


def test_results_of_coverage_have_their_accessor_in_a_fresh_process():
    """The command uses it before any public name is asked for, which would register it."""
    code = (
        "import xarray, sunspin.philae.coverage_results; assert hasattr(xarray.Dataset, 'sunspin')"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_the_command_refuses_before_the_work(tmp_path):
    from sunspin.philae.coverage_results import worth

    with pytest.raises(InputError, match="too few twins"):
        worth(tmp_path / "out", 10, confidence=0.95)


def test_a_scan_takes_a_calibrated_threshold():
    arguments = [
        "scan",
        "philae",
        str(CASE.folder / "telemetry.csv"),
        "--from=25200",
        "--to=27899",
        "--omega-x=-0.3:0.3:0.3",
        "--omega-y=-0.3:0.3:0.3",
        "--omega-z=0:0.2:0.2",
        "--lines=0",
        "--json",
    ]
    found = [
        json.loads(CliRunner().invoke(cli, [*arguments, *more]).output)
        for more in ([], ["--threshold=1"])
    ]
    assert (
        found[0]["near_minimum_points"] < found[1]["near_minimum_points"] <= found[1]["rows"] == 18
    )
    refused = CliRunner().invoke(cli, [*arguments, "--threshold=1e-9"])
    assert refused.exit_code != 0 and "no motion of the grid comes below --threshold" in str(
        refused.exception or refused.output
    )


def test_the_readme_states_the_figures_that_ship():
    """Shares of the shipped study of twins, factor of the shipped calibration: what the README says is what the files hold."""
    text = re.sub(r"\s+", " ", (Path(__file__).parents[2] / "README.md").read_text("utf-8"))
    share = lv.twins_of(wo.shipped(CASE))["lines"].in_set(1.1)
    low, high = share.interval
    assert (
        f"in {share.value * 100:.1f} % of {share.n} ({low * 100:.1f} to {high * 100:.1f} %)" in text
    )
    path = CASE.folder / threshold.SHIPPED
    factor = threshold.from_json(path.read_text("utf-8"), str(path), "shipped").factor()[0]
    assert f"90 % region: {factor:.2f} times the smallest EMD" in text
