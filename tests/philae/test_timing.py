"""The third act of the study: the posterior of the rebound's samples, and the lines that are drawn beside it."""

import json
from contextlib import nullcontext

import numpy as np
import pytest

from sunspin.base.errors import TelemetryError
from sunspin.dynamics.batch import Outcome
from sunspin.philae import candidates, reproduction, timing
from sunspin.philae import rebound as rebounds
from sunspin.philae.metrics import (
    line_stretch,
    make_near_minimum_set,
    near_minimum_figure,
    propagate_grid,
)
from tests.output.conftest import small
from tests.support.figures import covered
from tests.support.philae import CASE, SUN

ALONG = np.array([1.0, 2.0, 2.0]) / 3.0


def test_a_fitted_line_is_drawn_along_its_own_points_only():
    position = np.arange(-0.2, 0.3, 0.01)
    points = np.array([0.1, 0.0, 0.1]) + position[:, None] * ALONG
    assert line_stretch(points, (points[20], ALONG), 0.015) == pytest.approx((-0.2, 0.29))
    clusters = points[np.abs(position) > 0.1]  # a line can be fitted through two clusters
    assert line_stretch(clusters, (points[20], ALONG), 0.015) is None
    assert line_stretch(points[:1], (points[0], ALONG), 0.015) is None


@pytest.fixture(scope="module")
def rebound():
    return rebounds.make_rebound(CASE, SUN)


@pytest.mark.long
@pytest.mark.evidence("reproduce", "verified", "the true motion of the built-in telemetry")
def test_the_posterior_of_the_built_in_telemetry_contains_the_truth(rebound):
    """One motion remains of the four lines: speeds within 90 % intervals that are narrow, and pictures that show it."""
    result = timing.compute(rebound, None, 200, rebounds.Options())
    rows = {row.id: row for row in timing.rows(result)}
    truth, text = result.truth, timing.describe(result)
    assert result.unique and "leaves one motion" in text
    assert f"{truth.touchdown:.3f} is true" in text
    for name, true, width in (
        ("timed_rate_at_touchdown", truth.touchdown, 0.02),
        ("timed_rate_at_collision", truth.collision, 0.003),
    ):
        row = rows[name]
        assert row.low <= true <= row.high and row.high - row.low < width, name
        assert row.chain == "posterior" and row.agrees is None
    assert truth.after < result.after.max()
    known = rebounds.read_truth(CASE)
    assert truth.speed[-1] == pytest.approx(np.linalg.norm(known["collision_omega_before_B"]))
    for figure in (
        timing.speeds_figure(result, result.touchdown, True),
        timing.posterior_figure(result, _near_minimum(rebound), True),
    ):
        assert not covered(figure)
        assert "synthetic" in figure.get_suptitle()
        labels = [axes.get_xlabel() for axes in figure.axes]
        assert all("rad/s" in label or "min" in label for label in labels)


def _near_minimum(rebound):
    """Near-minimum set of a coarse scan."""
    table = propagate_grid(CASE, rebound.sun_B, rebound.window_s, rebounds.Options(coarser=4))
    assert (table.outcome == Outcome.FINE).all()
    return make_near_minimum_set(CASE, table.volume(rebound.z), 1.3, 0)


@pytest.mark.long
def test_the_picture_of_the_scan_draws_the_fitted_and_the_published_lines(rebound):
    figure = near_minimum_figure(CASE, _near_minimum(rebound), "title")
    labels = [line.get_label() for line in figure.axes[0].lines]
    assert sum(label.startswith("fitted line") for label in labels) == 4
    assert {text.get_text() for text in figure.axes[0].texts} == {"L1", "L2", "L3", "L4"}


class LateHelper:
    """A helper in this process, which computes a call when its result is asked for."""

    def start(self, *call):
        self.call = call

    def result(self):
        function, *arguments = self.call
        return function(*arguments)


@pytest.mark.long
@pytest.mark.parametrize(
    "helper",
    [
        pytest.param(None, marks=pytest.mark.slow, id="later"),
        pytest.param(LateHelper(), id="meanwhile"),
    ],
)
def test_the_page_is_there_before_the_posterior_and_stays_if_it_fails(
    tmp_path, monkeypatch, helper
):
    seen = []

    def fail(vehicle, telemetry, span_s, options):
        begin_s, end_s = (
            CASE.timeline.event(name).t_s for name in ("first_touchdown", "collision")
        )
        assert begin_s < span_s[0] < span_s[1] < end_s and not options.progress
        raise TelemetryError("no motion explains the readings of the rebound")

    def look(written):
        summary = json.loads((written.folder / "summary.json").read_text("utf-8"))
        seen.append((written.report.is_file(), list(summary["missing"])))

    # the step that runs now looks the function up in its own module
    monkeypatch.setattr(candidates if helper else timing, "sample_posterior", fail)
    monkeypatch.setattr(reproduction, "helper_process", lambda *_: nullcontext(helper))
    with small():
        options = {"coarser": 25, "calibrate": 30, "seed": 0}
        written = reproduction.reproduce(tmp_path / "out", on_page=look, **options)
    assert len(seen) == 1 and seen[0][0] and "timing" not in seen[0][1]
    assert "no motion explains" in written.summary["missing"]["timing"]
    acts = written.summary["headline"]
    assert acts[1].startswith("1. The paper's method") and acts[2].startswith("2. What it cannot")
    assert written.report.is_file()
