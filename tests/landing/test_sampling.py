"""The study of sampling periods: widths of a few motions, and full posteriors that go on where they were stopped."""

from __future__ import annotations

import numpy as np
import pytest

import sunspin as ss
from sunspin.landing import sampling
from sunspin.output.figures.sampling import draw


@pytest.fixture(scope="module")
def craft():
    return ss.load_case("philae").vehicle


@pytest.fixture(scope="module")
def found(craft):
    return sampling.widths(craft, count=2)


def test_fewer_and_noisier_samples_are_never_better(found):
    """Of periods that divide each other, as samples of the longer are then among those of the shorter."""
    chain = [sampling.PERIODS_S.index(p) for p in (5, 10, 30, 60, 120, 240)]
    assert np.all(np.diff(found.volume_by_noise[:, chain], axis=1) > 0)
    assert np.all(np.diff(found.volume_by_noise, axis=0) > 0) and np.all(
        np.diff(found.speed_by_noise, axis=0) > 0
    )


def test_panels_are_philaes_and_two_more(found, craft):
    assert {n: len(names) for n, names in found.subsets.items()} == {
        1: 8,
        2: 28,
        3: 56,
        4: 70,
        5: 56,
        6: 28,
        7: 8,
        8: 1,
    }
    own = found.subsets[6].index(tuple(craft.panel_names))
    usual = (
        sampling.NOISES.index(sampling.USUAL_NOISE),
        sampling.PERIODS_S.index(sampling.USUAL_PERIOD_S),
    )
    assert np.allclose(
        found.speed_by_panels[6][own], found.speed_by_noise[usual], rtol=1e-9, atol=0
    )
    assert np.all(found.speed_by_panels[8] <= found.speed_by_panels[6].min(axis=0) * (1 + 1e-9))


def test_aliases_go_on_and_are_drawn(found, craft, tmp_path, monkeypatch):
    made = []

    def one(vehicle, period_s, irregular, i, seed, workers):
        made.append((period_s, irregular, i))
        return {
            "period_s": period_s,
            "irregular": irregular,
            "twin": i,
            "motions": 1 + i,
            "weight_of_true": 1.0,
        }

    monkeypatch.setattr(sampling, "neighbours_left", one)
    first = sampling.aliases(craft, tmp_path, 1, periods=(30.0, 60.0))
    rows = sampling.aliases(craft, tmp_path, 2, periods=(30.0, 60.0))
    assert len(first) == 4 and len(rows) == 8 and len(made) == 8 and rows[:4] == first
    figure = draw(found, rows)
    assert "synthetic" in figure.get_suptitle() and len(figure.axes) == 4


@pytest.mark.long
def test_two_minutes_leave_one_motion(craft):
    often = sampling.neighbours_left(craft, 120.0, True, 0, 0, 1)
    assert often["motions"] == 1 and often["weight_of_true"] > 0.99


@pytest.mark.long
def test_regular_seven_and_a_half_minutes_leave_several_motions(craft):
    """Of the twin of the test above, whose third part of samples cannot tell turns between them apart."""
    seldom = sampling.neighbours_left(craft, 450.0, False, 0, 0, 1)
    assert seldom["samples"] == 7 and seldom["motions"] > 1 and seldom["weight_of_true"] < 0.9


def test_motions_are_linked_by_chains_and_within_their_widths():
    points = np.array([[0.0, 0, 0], [0.9, 0, 0], [1.8, 0, 0], [5.0, 0, 0]])
    sharp = np.tile(1e-6 * np.eye(3), (4, 1, 1))
    assert (
        sampling.linked(points, sharp, 1.0).tolist() == [0, 0, 0, 1]
        and len(set(sampling.linked(points, sharp, 0.5))) == 4
    )
    sharp[2:, 0, 0] = 4.0  # 3.2 apart with a sigma of 2.8, and 1.8 from the first with one of 2
    assert len(set(sampling.linked(points, sharp, 0.5))) == 1
