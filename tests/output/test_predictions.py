"""Intervals, summary and figure of predictions."""

from __future__ import annotations

import json

import numpy as np
import pytest

from sunspin.base.errors import InputError
from sunspin.cli.values import parse_times
from sunspin.estimate.lander.predict import predict
from sunspin.landing.predictions import add_predictions
from sunspin.output.kinds.predictions import intervals, predicted_figure, predictions_summary
from tests.support.philae import AS_DRAWN, philae_draws

COLLISION, LATER = 27900.0, 31800.0


def test_predicted_intervals_are_the_quantiles_of_the_draws():
    tree = philae_draws(500, 0.003)
    table = intervals(predict(AS_DRAWN.vehicle, tree, [25200.0]))
    row = {row["quantity"]: row for row in table}
    omega = tree["posterior"]["omega_B"].values[0]
    expected = np.quantile(omega[:, 1], [0.05, 0.25, 0.5, 0.75, 0.95])
    got = [row["omega_y"][key] for key in ("low_90", "low_50", "median", "high_50", "high_90")]
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-9)
    assert row["omega_y"]["unit"] == "rad/s" and row["z_to_sun"]["unit"] == "rad"
    # all draws have one direction at the first sample
    assert row["sun_off"]["high_90"] < 1e-6 and row["sun_off"]["low_90"] == 0.0
    median = np.median(np.linalg.norm(omega, axis=1))
    assert row["rate"]["median"] == pytest.approx(median, abs=1e-9)


def test_a_prediction_is_saved_drawn_and_summarised():
    tree = philae_draws(50, 0.003)
    asked = parse_times("16:20,2014-11-12T17:25, 25300", tree.attrs["epoch_utc"])
    assert list(asked) == [25300.0, COLLISION, LATER]
    add_predictions(AS_DRAWN.vehicle, tree, asked, 0)
    group = tree["predictions"].to_dataset()
    summary = predictions_summary(group)
    assert len(summary["predicted"]) == 30 and json.dumps(summary)
    assert "at 2014-11-12T17:25 UTC, after the collision" in str(summary)
    assert "angular speed 27." in str(summary)
    figure = predicted_figure(group, list(asked.values()))
    assert "synthetic" in figure.get_suptitle() and len(figure.axes) == 12
    with pytest.raises(InputError, match="no epoch"):
        parse_times("16:20", None)
    with pytest.raises(InputError, match="ISO-8601"):  # taken to UTC it would lie before the year 1
        parse_times("0001-01-01T00:00:00+23:59", tree.attrs["epoch_utc"])
