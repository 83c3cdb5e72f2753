"""The posterior beside the paper's lines: volumes, the nearest line, the figure."""

from __future__ import annotations

import numpy as np
import pytest

import sunspin as ss
from posteriors import philae_draws
from sunspin.estimate.information import rate_volume
from sunspin.philae import rebound as rb
from sunspin.philae.against_lines import against, along_line
from sunspin.philae.figures.posterior_and_lines import draw


@pytest.fixture(scope="module")
def compared():
    return against(ss.load_case("philae"), philae_draws(300, 0.002)[0], coarser=8)


def test_volumes_are_those_of_cells_and_of_an_ellipsoid(compared):
    cell = (8 * 0.015) ** 3
    for points, size in compared.sets.values():
        assert points is None or size == pytest.approx(len(points) * cell, rel=1e-12)
    assert len(compared.sets) == 4  # the paper's, two calibrated ones, the printed lines
    *calibrated, printed = (size for _, size in compared.sets.values())
    factors = [float(name.split()[2]) for name in compared.sets if name.startswith("EMD < ")]
    assert len(factors) == 3 and np.all(np.diff(np.array(calibrated)[np.argsort(factors)]) >= 0)
    assert compared.volume == pytest.approx(
        rate_volume(0.002**2 * np.eye(3)), rel=0.25
    )  # 300 draws
    assert compared.factors["printed lines, one grid step wide"] == pytest.approx(
        printed / compared.volume, rel=1e-12
    )


def test_the_twins_truth_is_on_the_third_line(compared):
    assert compared.nearest == 2 and compared.distance < 0.001
    ends = along_line(compared.lines[2], -0.1, 0.2)
    assert np.allclose(ends[:, 2], [-0.1, 0.2], rtol=0, atol=1e-12)
    assert np.allclose(
        np.cross(ends[1] - ends[0], rb.published_lines(ss.load_case("philae"))[2][1]),
        0,
        rtol=0,
        atol=1e-12,
    )


def test_the_figure_names_what_is_synthetic_and_the_factor(compared):
    figure = draw(compared)
    title = figure.get_suptitle()
    assert (
        "synthetic" in title
        and f"{min(compared.factors.values()):.0f} times" in title
        and len(figure.axes) == 6
    )
