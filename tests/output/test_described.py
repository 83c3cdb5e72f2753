"""Flat plots of the page: the description that the page draws is the one that the folder's pictures show."""

import base64

import numpy as np
import pytest

from sunspin.output.report import measured, overview
from sunspin.output.report.described import figure_of
from sunspin.output.report.page import write_report
from sunspin.output.report.read import read_results


def unpacked(values):
    return np.frombuffer(base64.b64decode(values["bdata"]), dtype=values["dtype"]).astype(float)


@pytest.mark.parametrize("run", ["sun", "rates"])
def test_panel_powers_are_the_same_numbers_in_page_and_picture(user_runs, run):
    (plot,) = measured.powers(read_results(user_runs[run])).items
    for view in range(max(len(plot.views), 1)):
        figure, shown = (
            figure_of(plot, view),
            plot.views[view]["show"] if plot.views else range(len(plot.data)),
        )
        figure.canvas.draw()
        drawn = [line.get_ydata() for axes in figure.axes for line in axes.get_lines()]
        wanted = [unpacked(plot.data[k]["y"]) for k in shown]
        assert len(drawn) == len(wanted) and len(figure.axes) == sum(
            key.startswith("yaxis") for key in plot.layout
        )
        assert all(any(np.array_equal(one, other) for other in drawn) for one in wanted)
        if plot.views:
            low, high = (
                np.datetime64(round(end), "ms").astype("datetime64[us]").astype(float) / 864e8
                for end in plot.views[view]["range"]
            )
            np.testing.assert_allclose(figure.axes[0].get_xlim(), (low, high), rtol=0, atol=1e-6)


def test_the_first_picture_of_a_study_has_its_bands_scales_and_events(study):
    plot = overview.hero(read_results(study))
    figure = figure_of(plot)
    assert [axes.get_yscale() for axes in figure.axes] == ["log", "log"]
    assert sum(len(axes.patches) for axes in figure.axes) == sum(
        "fill" in trace for trace in plot.data
    )
    texts = {text.get_text() for axes in figure.axes for text in axes.texts}
    assert texts == {note["text"] for note in plot.layout["annotations"]}
    shown = {text.get_text() for text in figure.legends[0].get_texts()}
    assert shown == {trace["name"] for trace in plot.data if trace.get("showlegend", True)}


def test_the_command_writes_them_beside_the_page(user_runs, tmp_path):
    for name in (".sunspin-results", "telemetry.nc", "summary.json", "vehicle.toml"):
        (tmp_path / name).write_bytes((user_runs["sun"] / name).read_bytes())
    write_report(tmp_path)
    assert not [*tmp_path.glob("*.svg")]
    write_report(tmp_path, figures=True)
    assert {path.name for path in tmp_path.glob("powers.*")} == {"powers.png", "powers.svg"}
