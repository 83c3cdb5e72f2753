"""The telemetry phase by phase: what the paper says of Delta, n_z and lit patterns."""

import numpy as np
import pytest

import sunspin as ss
from philae_sun import AS_DRAWN, CASE
from sunspin.philae import phases


@pytest.fixture(scope="module")
def result():
    return phases.compute(CASE)


def test_phases_come_from_the_timeline_and_hold_every_sample(result):
    labels = CASE.telemetry["phase"].values
    assert {phase.name: phase.samples for phase in result.phases} == {
        n: int((labels == n).sum()) for n in dict.fromkeys(labels)
    }
    bare = phases.compute(CASE, CASE.telemetry.drop_vars("phase"))
    assert [p.samples for p in bare.phases] == [p.samples for p in result.phases]


@pytest.mark.evidence(
    "reproduce", "validated", "the paper's statistics of Delta, on synthetic telemetry"
)
def test_rows_agree_with_the_paper(result):
    """With panels as drawn; where they are turned the folded legs stand out less."""
    rows = {row.id: row for row in phases.rows(phases.compute(AS_DRAWN))}
    assert {row.id: row for row in phases.rows(result)}["lit_patterns_before"].agrees
    assert (
        rows["delta_shadowed"].agrees
        and rows["nz_folded"].agrees
        and rows["lit_patterns_before"].agrees
    )
    assert rows["lit_patterns_allowed"].ours == 16
    assert rows["lit_patterns_noise"].ours < -50
    of_telemetry = ("delta_shadowed", "nz_folded", "lit_patterns_before", "lit_patterns_noise")
    assert all("synthetic" in rows[key].note for key in of_telemetry)


def test_a_panel_that_fails_in_the_descent_is_noticed(result):
    """Negative control: panel 3 dead from the first sample on."""
    broken = CASE.telemetry.copy(deep=True)
    broken["power_W"].loc[{"panel": "3"}] = 0.0
    rows = {row.id: row for row in phases.rows(phases.compute(CASE, broken))}
    assert rows["lit_patterns_before"].agrees is False and rows["lit_patterns_before"].ours > 30
    assert ("3",) in ss.panel_health(CASE.vehicle, broken.isel(time=slice(0, 150)))["explanations"]


def test_noise_is_judged_sample_by_sample(result):
    forbidden = result.sun["status"].values == 2
    assert np.array_equal(np.isfinite(result.log10_probability), forbidden)
    assert result.log10_probability[forbidden].max() <= 0
    total = sum(verdict.log10_together for verdict in result.health["noise"].values())
    assert result.log10_probability[forbidden].sum() == pytest.approx(total, rel=1e-12)
