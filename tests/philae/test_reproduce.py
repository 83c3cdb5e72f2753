"""The steps of the study together: order, ids, figures, and telemetry with missing parts."""

import threading
from concurrent.futures import as_completed

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.text import Text

from sunspin.base.errors import MotionError, TelemetryError
from sunspin.cases import load_case
from sunspin.output.kind import Drawing
from sunspin.philae import data_check, inputs, pictures, published_lines
from sunspin.philae import rebound as rb
from sunspin.philae import study as rp
from sunspin.philae.headline import conclusions, headline
from sunspin.philae.reproduction import make_figure_rows
from sunspin.philae.steps import REPORTED, Steps
from tests.support.figures import covered
from tests.support.study import leave_out
from validation import controls

CASE = load_case("philae")
SLOW = "motions collision speeds strategies sensitivity precession".split()
"""Steps that are left out here and have tests of their own; the others take seconds on a coarse grid."""


def rows_by_step(study: rp.Study) -> dict:
    return {outcome.key: outcome.rows for outcome in study.outcomes if outcome.rows}


def without(*phases: str) -> xr.Dataset:
    data = CASE.telemetry
    return data.isel(time=np.flatnonzero(~np.isin(data["phase"].values, phases)))


@pytest.fixture(scope="module")
def quick():
    with pytest.MonkeyPatch.context() as patch:
        leave_out(patch, *SLOW)
        patch.setattr(rp, "LEAST_RUNS", 60)
        patch.setattr(rp, "LANDING_RUNS", 1)
        patch.setattr(data_check, "SHUFFLES", 3)
        patch.setattr(published_lines, "LINE_POINTS", 3)
        usual = {"coarser": 10, "simulations": 30}
        yield lambda case, **options: rp.compute(case, **(usual | options))


@pytest.mark.long
def test_telemetry_without_the_descent_reproduces_the_rest_and_names_the_gap(quick):
    found = quick(rb.with_telemetry(CASE, without("descent", "deployment")), coarser=20)
    assert list(found.missing) == ["descent"] and found.descent.result is None
    assert "no sample before the first touchdown" in found.missing["descent"]
    with_rows = "phases carries level_set touchdown mechanics published_lines inputs".split()
    assert list(rows_by_step(found)) == with_rows
    gap = "Section 3.1: the descent: not reproduced"
    assert any(said.startswith(gap) for said in conclusions(found))
    assert "too few samples" in headline(found)[0]
    ids = [row.id for row in found.rows]
    assert len(ids) == len(set(ids)) and not {"descent_E", "descent_unique"} & set(ids)
    sheets = list(pictures.list_drawings(found))
    names = {sheet.name for sheet in sheets}
    assert "fig10_11_descent" not in names
    assert {"fig03_measured", "fig09_lines", "fig12_touchdown"} <= names
    assert all(sheet.alt and sheet.caption for sheet in sheets)
    for sheet in sheets:  # synthetic readings were not measured
        figure = sheet.make()
        assert not covered(figure), (sheet.name, covered(figure))
        drawn = [text.get_text() for text in figure.findobj(Text)]
        texts = (*drawn, sheet.alt, sheet.caption)
        said = [text for text in texts if "measured" in text.lower() and "no measured" not in text]
        assert not said, (sheet.name, said)


@pytest.mark.long
def test_with_measured_telemetry_input_figures_become_tests(quick):
    data = CASE.telemetry.copy()
    own = ("synthetic", "sha256")  # says that it is synthetic, and that it is the case's own file
    data.attrs = {key: value for key, value in CASE.telemetry.attrs.items() if key not in own}
    rows = quick(rb.with_telemetry(CASE, data), coarser=20).rows
    assert not any(row.note.startswith("synthetic telemetry") for row in rows)
    kinds = {row.id: row.kind for row in rows}
    # neither made from these figures nor selected for them
    names = "delta_mean descent_rate_cubic shadowed_panel lines_found sun_height_range"
    assert {kinds[name] for name in names.split()} == {"test"}


@pytest.mark.slow
def test_entries_that_need_no_telemetry_do_not_change_with_it(quick):
    """A lander that never tumbled: the section on the printed lines stays to the digit, what follows from the telemetry moves."""
    # the points of a coarser grid miss the motion that stands still
    own = quick(CASE, coarser=3)
    of_file = [row for row in own.rows if row.chain not in ("none", "published")]
    assert len(of_file) > 20 and all("synthetic telemetry" in row.note for row in of_file)
    still = quick(rb.with_telemetry(CASE, controls.CONTROLS["never tumbled"](CASE)), coarser=3)
    rows, rows_of_still = rows_by_step(own), rows_by_step(still)
    steps = [step for step in own.outcomes if step.section == "no_telemetry" and step.rows]
    assert [step.key for step in steps] == ["mechanics", "published_lines"]
    for step in steps:
        assert [row.ours for row in step.rows] == [row.ours for row in rows_of_still[step.key]]
    pairs = zip(rows["touchdown"], rows_of_still["touchdown"], strict=True)
    moved = [a.id for a, b in pairs if (a.low, a.high) != (b.low, b.high)]
    bound = {"rate_at_touchdown_min", "rate_at_touchdown_bound"}
    assert bound | {"angle_smaller", "sun_height_range"} <= set(moved)
    told, before = " ".join(headline(still)), " ".join(headline(own))
    assert "consistent with no rotation" in told
    assert "0 of the 4 published lines" in told and "4 of the 4 published lines" in before
    assert "was selected" in before and "was selected" not in told
    for text in conclusions(still)[:4]:
        assert "four lines" not in text


@pytest.mark.long
def test_the_study_runs_with_a_wheel_at_rest(quick):
    found = quick(load_case("philae", changes={"wheel.speed_rad_s": 0}), coarser=20)
    assert not found.missing
    rows = {row.id: row for row in found.rows}
    assert rows["wheel_stop"].ours is None and "descent_wheel_speed" not in rows
    assert np.isfinite(rows["rate_at_touchdown_min"].low)


@pytest.mark.long
def test_telemetry_of_no_landing_gives_no_conclusion(quick):
    exchanged = controls.CONTROLS["panels 1 and 2 exchanged"](CASE)
    found = quick(rb.with_telemetry(CASE, exchanged), coarser=20)
    assert found.candidate_sets.result is None and "touchdown" in found.missing
    assert not [row for row in found.rows if row.depends == "candidates"]
    told = headline(found)
    assert "cannot be concluded" in told[1] and "lit pattern" in told[1]
    assert "No conclusions" in told[2]
    assert "lit pattern" in found.candidate_sets.error.problem
    of_scan = found.scan.rows
    assert of_scan and all(row.kind != "test" and row.agrees is None for row in of_scan)
    drawn = {drawing.name for drawing in pictures.list_drawings(found)}
    assert "fig12_lines" in drawn and "fig12_touchdown" not in drawn


def test_every_numbered_figure_of_the_paper_has_an_entry(tmp_path):
    names = ["fig03_measured", "fig09_lines", "fig09_telemetry", "fig10_11_descent", "growth"]
    rows = make_figure_rows([Drawing(name, Figure, "alt", f"{name}.") for name in names])
    assert [row.id for row in rows] == [f"figure_{number}" for number in range(1, 14)]
    shown = {row.id: row.ours for row in rows}
    assert shown["figure_9"] == "fig09_lines.png, fig09_telemetry.png"
    assert shown["figure_10"] == shown["figure_11"] == "fig10_11_descent.png"
    assert shown["figure_3"] == "fig03_measured.png"
    assert shown["figure_13"] == "not drawn"
    assert shown["figure_1"].startswith("not drawn: a picture")


def test_a_changed_value_is_not_marked_as_used_from_the_paper():
    """And the paper's tables stay the paper's, whatever body the run has."""
    changed = load_case("philae", ["body.mass_kg=100", "wheel.speed_rad_s=833"])
    rows = [{row.id: row for row in inputs.rows(case)} for case in (CASE, changed)]
    for name in ("table_2", "wheel_speed"):
        assert all(found[name].published == rows[0][name].ours for found in rows), name
        assert rows[1][name].ours != rows[0][name].ours, name
        assert rows[1][name].note.startswith("not as published"), name
    same = set(rows[0]) - {"table_2", "wheel_speed", "rate_at_touchdown_min_rounded"}
    assert all(rows[0][name] == rows[1][name] for name in same)
    assert rows[0]["table_2"].note.startswith("used as published")


def failing(*_):
    raise MotionError("no motion")


def submit(steps: Steps, key: str, compute, *rows, **about):
    return steps.run(key, f"Step {key}", compute, *rows, **about)


def test_steps_of_the_study_can_end_in_any_order():
    """What needs a step that failed is left out and nothing else."""
    fast_is_seen, seen = threading.Event(), []

    def slow():
        assert fast_is_seen.wait(20), "no other step ran at the same time"
        return "slow"

    with Steps(workers=2) as steps:
        of = steps.of
        first = submit(steps, "slow", slow, lambda result: [f"row of {result}"])
        fast = submit(steps, "fast", lambda: "fast", lambda result: [f"row of {result}"])
        failed = submit(steps, "failing", lambda: failing(of(fast)))
        lost = submit(steps, "lost", lambda: ["lost", of(failed).get()])
        behind = submit(steps, "behind", lambda: ["behind", of(lost).get()])
        both = submit(steps, "both", lambda: (of(first).get(), of(failed).result))
        for _ in as_completed(steps.submitted):
            seen.append([step.result().result for step in (first, fast, both) if step.done()])
            if fast.done():
                fast_is_seen.set()
    assert seen[-1] == ["slow", "fast", ("slow", None)] and ["fast"] in seen
    assert first.result().rows == ("row of slow",) and fast.result().rows == ("row of fast",)
    assert [step.result().reason for step in (failed, lost, behind)] == [
        "Step failing: not reproduced, as no motion",
        "Step lost: not computed, as it rests on what is missing",
        "Step behind: not computed, as it rests on what is missing",
    ]
    for step in (lost, behind):  # the error is that of the step that failed
        assert step.result().result is None and step.result().error is failed.result().error


@pytest.mark.parametrize("workers", [1, 2])
def test_steps_that_wait_do_not_block_those_that_they_wait_for(workers):
    with Steps(workers) as steps:
        chain = [submit(steps, "first", lambda: 1)]
        for number in range(20):
            chain.append(
                submit(steps, f"{number}", lambda before=chain[-1]: steps.of(before).get() + 1)
            )
        for step in steps.submitted:
            step.result(20)
    assert chain[-1].result().result == 21


def test_a_failed_step_that_is_needed_ends_the_study():
    ended = []
    with pytest.raises(MotionError, match="no motion"), Steps(workers=1) as steps:
        failed = submit(steps, "failing", failing, fatal=REPORTED)
        submit(steps, "after", lambda: ended.append(steps.of(failed)))
        for step in steps.submitted:
            step.result(20)
    assert not ended and failed.exception() is not None


def test_no_step_begins_after_an_interrupt():
    running, go_on, begun = threading.Event(), threading.Event(), []

    def wait_for_the_interrupt():
        running.set()
        return go_on.wait(20)

    with pytest.raises(KeyboardInterrupt), Steps(workers=2) as steps:
        first = submit(steps, "first", wait_for_the_interrupt)
        second = submit(steps, "second", lambda: begun.append(steps.of(first).get()))
        third = submit(steps, "third", lambda: begun.append(1))
        assert running.wait(20)
        raise KeyboardInterrupt
    go_on.set()
    assert first.result(20).result and second.result(20).result is None
    assert third.cancelled() and not begun


def test_telemetry_without_the_first_rebound_is_refused_at_once(quick):
    with pytest.raises(TelemetryError, match="no sample between first touchdown and collision"):
        quick(rb.with_telemetry(CASE, without("first_rebound")))
