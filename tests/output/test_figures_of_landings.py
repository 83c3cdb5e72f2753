"""Figures and first sentence of `outcomes` for a lander that is not Philae."""

from __future__ import annotations

import json

import pytest

from sunspin.landing.scenario import Scenario
from sunspin.landing.strategies import compare, comparison_tree
from sunspin.output.kinds.outcomes import distributions_figure, sun_height_figure
from sunspin.output.kinds.strategies import landing_summary, read_runs
from sunspin.vehicle import Friction, Wheel
from tests.support.figures import covered
from tests.support.vehicles import small_lander

STRATEGIES = ["off", "held", "brake", "delay:30"]


@pytest.fixture(scope="module")
def landing():
    wheel = Wheel("w", [0, 0, 1], 1e-4, 300.0, Friction(1e-4, 1e-7), brake_torque_N_m=0.01)
    vehicle = small_lander(wheel)
    # slow, with the Sun near the z axis: the density of its height is large at the left and at the right
    scenario = Scenario((0.6, 0.0, 0.8), (300.0,), 300.0, landing_speed_m_s=0.05)
    table, runs = compare(vehicle, [[0.3, 0.1, 0.02]], STRATEGIES, 100, 0, scenario)
    return comparison_tree(table, runs, None)


def test_legends_of_landings_cover_no_curve(landing):
    assert covered(sun_height_figure(read_runs(landing))) == []


def test_the_axis_of_leg_tip_speeds_ends_at_the_fastest_one(landing):
    """A slow lander once had its speeds in a tenth of an axis that was made for Philae's, and a fast one beyond its end."""
    runs = read_runs(landing)
    fastest = max(float(data["leg_tip_speed"].max()) for data in runs.values())
    axes = distributions_figure(runs).axes[1]
    assert axes.get_xlim() == pytest.approx((0.0, fastest))


def test_the_first_sentence_of_a_landing_compares_the_commands(landing, tmp_path, undrawn):
    """Further lines of the command follow it, and do not part the head of a strategy from its numbers."""
    landing.sunspin.save(tmp_path / "out", lines=["Candidates: as given"])
    sentences = json.loads((tmp_path / "out" / "summary.json").read_text("utf-8"))["sentences"]
    assert sentences[0].startswith("4 commands to the wheel, 100 runs each; comes to rest on its")
    estimates = landing_summary(landing)["strategies"]
    for strategy in STRATEGIES:
        share = estimates[strategy]["rest_leg"]["value"]
        assert f"{strategy} {share:.2f}" in sentences[0]
    assert sentences[1] == "Candidates: as given"
    head = sentences.index("wheels off: 100 runs")
    assert sentences[head + 1].startswith("a leg touches first")


def test_a_single_command_is_compared_with_nothing(landing):
    table = landing["strategies"].to_dataset().sel(strategy=["held"])
    tree = comparison_tree(table, {"held": read_runs(landing)["held"]}, None)
    assert landing_summary(tree).lines[0] == "wheels held: 100 runs"
