"""The telemetry phase by phase: Delta, r_z and illumination patterns of the paper."""

import numpy as np
import pytest

import sunspin as ss
from sunspin.philae import sun_directions
from sunspin.philae.rebound import with_telemetry
from tests.support.philae import AS_DRAWN, CASE


@pytest.fixture(scope="module")
def result():
    return sun_directions.compute(CASE)


def rows(case):
    return {row.id: row for row in sun_directions.rows(sun_directions.compute(case))}


def test_phases_come_from_the_timeline_and_hold_every_sample(result):
    labels = CASE.telemetry["phase"].values
    assert list(result.phases) == list(dict.fromkeys(labels))
    bare = with_telemetry(CASE, CASE.telemetry.drop_vars("phase"))
    for phases in (result.phases, sun_directions.compute(bare).phases):
        assert all(np.array_equal(phases[name], labels == name) for name in phases)


@pytest.mark.evidence(
    "reproduce", "validated", "the paper's statistics of Delta, on synthetic telemetry"
)
def test_entries_on_sun_directions_agree_with_the_paper():
    """With panels as drawn; where they are turned the folded legs stand out less."""
    drawn = rows(AS_DRAWN)
    assert rows(CASE)["lit_patterns_before"].agrees
    assert all(drawn[key].agrees for key in ("delta_shadowed", "nz_folded", "lit_patterns_before"))
    assert drawn["lit_patterns_allowed"].ours == 16
    assert drawn["lit_patterns_noise"].ours < -50


def test_a_panel_that_fails_in_the_descent_is_detected():
    """Negative control: panel 3 dead from the first sample on."""
    broken = CASE.telemetry.copy(deep=True)
    broken["power_W"].loc[{"panel": "3"}] = 0.0
    before = rows(with_telemetry(CASE, broken))["lit_patterns_before"]
    assert before.agrees is False and before.ours > 30
    assert ("3",) in ss.panel_health(CASE.vehicle, broken.isel(time=slice(0, 150)))["explanations"]
