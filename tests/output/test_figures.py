"""Figures: which directions a line connects, and how long error bars are."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.output.kinds.outcomes import clip_errors
from sunspin.output.kinds.telemetry import connected_stretches, sun_directions_figure
from tests.support.figures import covered


def test_the_test_for_legends_on_curves_detects_one():
    """The check that the figures of the study pass does accuse."""
    for place, said in (("upper left", []), ("lower right", []), ("center", ["rising"])):
        axes = (figure := Figure()).subplots()
        axes.plot(np.linspace(0, 1, 50), np.linspace(0, 1, 50), label="diagonal")
        axes.set_title("rising")
        axes.legend(loc=place)
        assert covered(figure) == said, place


def directions(hours: list[float], known: list[int], phase: list[str] | None = None) -> xr.Dataset:
    sun = np.full((len(hours), 3), np.nan)
    sun[known] = (0.0, 0.6, 0.8)
    data = xr.Dataset({"sun_B": (("time", "axis"), sun)}, coords={"time": 3600 * np.array(hours)})
    return data if phase is None else data.assign_coords(phase=("time", phase))


@pytest.mark.parametrize(
    ("hours", "known", "phase", "pieces"),
    [
        (list(range(6)), [0, 2, 3, 5], list("aaabbb"), [[0, 2], [3, 5]]),
        ([0, 1, 2, 30, 31], [0, 1, 2, 3, 4], None, [[0, 1, 2], [3, 4]]),
        (list(range(20)), [0, 1, 13, 14], None, [[0, 1], [13, 14]]),
        ([0, 1, 2], [0, 2], list("aba"), [[0, 2]]),
        ([0, 1, 2], [1], None, []),
    ],
)
def test_lines_connect_successive_directions_of_a_phase_and_cross_no_gap(
    hours, known, phase, pieces
):
    found = connected_stretches(np.array(hours, dtype=float), directions(hours, known, phase))
    assert [piece.tolist() for piece in found] == pieces


@pytest.mark.parametrize("turned", [50, 70])
def test_no_line_connects_directions_too_far_apart_to_interpolate(turned):
    sun = directions(list(range(6)), list(range(6)))
    sun["sun_B"].values[3:] = Rotation.from_euler("x", turned, degrees=True).apply([0.0, 0.6, 0.8])
    found = [piece.tolist() for piece in connected_stretches(np.arange(6.0), sun)]
    assert found == ([[0, 1, 2, 3, 4, 5]] if turned < 60 else [[0, 1, 2], [3, 4, 5]])


def test_error_bars_of_a_probability_stay_between_zero_and_one():
    rng = np.random.default_rng(0)
    value, error = rng.uniform(size=200).round(1), rng.uniform(size=200)
    low, high = clip_errors(value, error)
    assert np.all(value - low >= -1e-12)
    assert np.all(value + high <= 1 + 1e-12)
    assert np.all(np.stack([low, high]) >= 0)


def test_the_figure_of_sun_directions_draws_the_connecting_lines():
    case = ss.load_case("philae")
    sun, telemetry = ss.sun_directions(case.vehicle, case.telemetry), case.telemetry
    figure = sun_directions_figure(sun, telemetry)
    solid = [line for line in figure.axes[1].lines if line.get_linestyle() == "-"]
    drawn = [line.get_xdata() for line in solid if len(line.get_xdata()) > 1]
    pieces = connected_stretches(sun["time"].values / 3600, sun)
    assert len(drawn) == 3 * len(pieces) and len(pieces) >= 3
    for k, piece in enumerate(pieces):
        assert np.array_equal(drawn[3 * k], sun["time"].values[piece] / 3600)
        assert len(set(sun["phase"].values[piece])) == 1
