"""The study of the paper's printed results: its weights, its statistics, its program."""

import json

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from studies import printed_results as study
from sunspin.cases import load_case
from sunspin.dynamics.propagate import propagate
from sunspin.philae import rebound as rb

CASE = load_case("philae")
COARSE = 10  # 11 x 11 x 5 motions


@pytest.fixture(scope="module")
def scan():
    return study.make_scan(CASE, COARSE, 1)


def row(omega, weight, emd_min, line, passed=True):
    found = {"emd_min": emd_min, "line_rad_s": [line] * 4, "passed": passed}
    return {"omega_B": omega, "sun_B": rb.first_sun(CASE).tolist(), "weight": weight} | found


def test_weights_are_positive_and_bounded_and_make_the_box_even(scan):
    """With weights, the mean of the weights is 1 and each rate has the mean and the spread of an even distribution."""
    rng, limits = np.random.default_rng(3), rb.scan_limits(CASE)
    omega = np.array([scan.proposal.draw(rng) for _ in range(20_000)])
    weight = np.array([scan.proposal.weight(x) for x in omega])
    assert np.all(omega >= limits[:, 0]) and np.all(omega <= limits[:, 1])
    assert np.all(weight > 0) and weight.max() <= 1 / study.EVEN_SHARE
    assert weight.std() > 0.2  # else nothing is concentrated
    assert weight.mean() == pytest.approx(1.0, abs=0.03)
    x = (omega - limits.mean(axis=1)) / np.ptp(limits, axis=1)
    np.testing.assert_allclose(np.average(x, axis=0, weights=weight), 0.0, atol=0.015)
    np.testing.assert_allclose(np.average(x**2, axis=0, weights=weight), 1 / 12, atol=0.004)


def test_the_proposal_prefers_rates_whose_distribution_is_that_of_the_lines(scan):
    on_line = rb.points_on_lines(rb.published_lines(CASE), [0.0])[:, 0]
    weight = [scan.proposal.weight(x) for x in on_line]
    assert max(weight) < 1 < scan.proposal.weight(np.array([0.99, 0.99, 0.29]))


def test_a_draw_is_the_same_in_any_block(scan, monkeypatch):
    monkeypatch.setattr(study, "BLOCK", 8)
    draws = study.simulate_block(scan, 5, 0)["draws"]
    monkeypatch.setattr(study, "BLOCK", 4)
    later, earlier = (study.simulate_block(scan, 5, k)["draws"] for k in (1, 0))
    for draw, again in zip(draws, earlier + later, strict=True):
        # steps of the motions depend on the times of the whole block, which moves directions within their error
        assert draw == again | {"emd_min": pytest.approx(again["emd_min"], abs=1e-6)}
    assert draws[0]["omega_B"] != study.simulate_block(scan, 6, 0)["draws"][0]["omega_B"]
    # draw 0 is scanned without screens, if it gives directions enough
    blocks = [study.simulate_block(scan, seed, 0)["draws"] for seed in range(4)]
    assert any(block[0]["emd_min"] is not None for block in blocks)


def test_simulated_directions_agree_with_the_reference_trajectory(scan, monkeypatch):
    """The readings of a rebound with panels as drawn and without noise are those of heyoka's trajectory."""
    used = {}

    def exact(vehicle, samples, tilt, sigma, rng):
        used["t"], used["sun_B"] = samples.t_s, samples.sun_B
        return samples.exact_power(vehicle, tilt)

    monkeypatch.setattr(study, "add_rebound_noise", exact)
    (rebound,) = study.simulate_rebounds(scan, 1, range(1))
    t = used["t"] - used["t"][0]
    run = propagate(CASE.vehicle, rebound.omega_B, rebound.sun_B, 865.0, t)
    np.testing.assert_allclose(used["sun_B"], run["sun_B"].values, atol=3 * study.DIRECTION_ERROR)


def test_tolerances_accept_and_the_table_agrees_with_figures_by_hand(monkeypatch):
    monkeypatch.setattr(study, "LEAST_ACCEPTED", 1)
    on_line = rb.points_on_lines(rb.published_lines(CASE), [0.0])[2, 0].tolist()
    found = [(3.0, 0.0350, 0.05), (1.0, 0.0326, None), (1.0, 0.0426, 0.01)]
    found += [(1.0, 0.0326, 0.01, False), (1.0, None, None)]
    rows = [row(on_line, 1.0, 0.0326, 0.01), *(row([0.5, 0.5, 0.0], *each) for each in found)]
    draws = study.collect_draws(CASE, rows)
    assert draws.accepted["wide"].tolist() == [True, True, False, False, False, False]
    assert draws.accepted["strict"].tolist() == [True] + [False] * 5
    assert np.flatnonzero(draws.accepted["strict without screens"]).tolist() == [4]
    table = study.make_table(CASE, draws).set_index(["sample", "quantity", "statistic"])["value"]
    assert table["wide", "effective number", "count"] == pytest.approx(4**2 / 10)
    assert table["wide", "probability of acceptance", "mean"] == pytest.approx(4 / 6)
    near = f"share within {study.ON_LINE_RAD_S:g} rad/s of a published line"
    assert table["wide", near, "mean"] == pytest.approx(1 / 4)
    assert table["strict", near, "mean"] == 1
    meaning, _ = study.QUANTITIES["smaller"]
    assert table["strict", meaning, "mean"] == pytest.approx(31.7, abs=0.5)  # L3: theta
    assert "1 and 1 (strict)" in study.format_table(study.make_table(CASE, draws), draws)


def test_weighted_quantiles_agree_with_those_of_repeated_values():
    x, times = np.array([3.0, 1.0, 2.0, 5.0]), np.array([2, 1, 4, 3])
    for level in (0.05, 0.3, 0.5, 0.9):
        expected = np.quantile(np.repeat(x, times), level, method="inverted_cdf")
        assert study.weighted_quantile(x, times.astype(float), level) == expected


def test_the_study_resumes_with_the_same_draws_and_takes_more(tmp_path, capsys, monkeypatch, scan):
    monkeypatch.setattr(study, "BLOCK", 4)
    monkeypatch.setattr(study, "make_scan", lambda *_: scan)
    figure = study.printed_figure
    monkeypatch.setattr(study, "printed_figure", lambda *_: Figure())
    arguments = [str(tmp_path), f"--coarser={COARSE}", "--workers=1"]
    assert study.main([*arguments, "--draws=8"]) == 0
    assert "Simulated: 8 draws" in capsys.readouterr().out
    names = ("printed_results.csv", "printed_results.md")
    before = {name: (tmp_path / name).read_bytes() for name in names}
    files = sorted(tmp_path.glob("draws-*/*.json"))
    kept = {path: path.read_bytes() for path in files}
    assert len(kept) == 2 and len(json.loads(kept[files[0]])["draws"]) == 4
    files[0].unlink()
    assert study.main([*arguments, "--draws=8"]) == 0
    assert before == {name: (tmp_path / name).read_bytes() for name in names}
    assert kept == {path: path.read_bytes() for path in files}
    monkeypatch.setattr(study, "printed_figure", figure)
    assert study.main([*arguments, "--draws=10"]) == 0
    assert kept.items() <= {p: p.read_bytes() for p in tmp_path.glob("draws-*/*.json")}.items()
    table = pd.read_csv(tmp_path / "printed_results.csv")
    assert table["value"][0] == 10 and (tmp_path / "printed_results.png").is_file()
    assert study.main([*arguments, "--draws=0"]) == 2
