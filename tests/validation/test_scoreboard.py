"""The scoreboard: its rows, counts and comparisons, and that every area draws cases that run."""

import json
import pickle
from functools import partial
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from validation import scoreboard
from validation.areas import AREAS, _of_passes, _pass
from validation.scoreboard import (
    OUTCOMES,
    Task,
    changed_outcomes,
    figures,
    lost_truths,
    make_board,
    missing_cases,
    run_tasks,
    table,
)

ROOT = Path(__file__).parents[2]


def measured(outcome, off, sigma):
    return {"outcome": outcome, "off": off, "sigma": sigma}


def raising():
    raise ValueError("a defect")


def several():
    return {"outcome": "right", "cases": {"a": {"outcome": "right"}, "b": {"outcome": "wrong"}}}


def board_of(rows):
    """Return the board of rows of one kind, as it is read from its file."""
    numbered = {str(i): row | {"processor_s": 1.0} for i, row in enumerate(rows)}
    return json.loads(json.dumps(make_board({"rates: kind": numbered}, "abc", "quick", [0])))


def test_rows_of_the_scoreboard_are_kept_and_a_traceback_is_a_defect(tmp_path):
    tasks = [
        Task("rates", "kind", "0/1", partial(measured, "right", [], [])),
        Task("rates", "kind", "0/2", raising),
        Task("study", "rows", "all", several),
    ]
    said = []
    for _ in range(2):
        rows = run_tasks(tasks, tmp_path / "rows", 1, said.append)
    assert len(said) == 3  # each is computed once
    assert [row["outcome"] for row in rows["rates: kind"].values()] == ["right", "defect"]
    assert [rows["study: rows"][case]["outcome"] for case in ("a", "b")] == ["right", "wrong"]
    assert "a defect" in rows["rates: kind"]["0/2"]["says"]


def test_figures_of_the_scoreboard_count_decided_cases_only():
    rows = [
        measured("right", [0.5, -1.5], [1.0, 1.0]),
        measured("wrong", [6.0], [1.0]),
        measured("undecided", [9.0], [1.0]),
    ]
    numbers = figures([{"processor_s": 1.0} | row for row in rows])
    assert (numbers["right"], numbers["wrong"], numbers["undecided"]) == (1, 1, 1)
    assert numbers["in_68"] == pytest.approx(1 / 3) and numbers["in_95"] == pytest.approx(2 / 3)
    assert numbers["rms_pull"] == pytest.approx(np.sqrt((0.25 + 2.25 + 36) / 3))


def test_cases_that_got_worse_are_listed_first():
    def of(*outcomes):
        return board_of({"outcome": outcome, "measured": {"a": 0.5}} for outcome in outcomes)

    before, now = of("right", "right", "wrong", "open"), of("undecided", "wrong", "right", "open")
    turned = changed_outcomes(before, now)
    assert [worse for worse, _ in turned] == sorted((worse for worse, _ in turned), reverse=True)
    assert [sentence for _, sentence in turned] == [
        "rates: kind, case 1: right -> wrong",
        "rates: kind, case 0: right -> undecided",
        "rates: kind, case 2: wrong -> right",
    ]
    text = table(now, before)
    assert "| rates: kind | 4 | 2 / 1 |" in text and "0: a | 0.5 / 0.5 |" in text


def test_a_case_that_is_no_longer_run_and_a_truth_that_left_the_list_are_named():
    """Unless the case moved to another level or set."""

    def of(*listed):
        rows = ({} if one is None else {"listed": one} for one in listed)
        return board_of({"outcome": "open"} | row for row in rows) | {"level": "full"}

    before, now = of(True, True, False, None), of(True, False, False)
    assert missing_cases(before, now) == ["rates: kind, case 3: not run"]
    assert missing_cases(before, now | {"level": "quick"}) == []
    assert missing_cases(before, now | {"sets": {}}) == []
    assert lost_truths(before, now) == ["rates: kind, case 1: the truth is no longer listed"]
    assert not lost_truths(now, before)
    assert "| 2 of 3 / 1 of 3 |" in table(now, before)


@pytest.mark.parametrize(
    ("kind", "named", "rightly", "outcome"),
    [
        ("right model", [], False, "wrong"),
        ("columns exchanged", [], False, "open"),
        ("exchanged, six panels", ["the columns of +x and +y exchanged"], True, "right"),
        ("exchanged, six panels", ["the columns of +x and +y exchanged"], False, "wrong"),
    ],
)
def test_a_decided_mirror_solution_is_wrong_unless_columns_are_exchanged(
    monkeypatch, kind, named, rightly, outcome
):
    """A named exchange of columns is right only if it is the true one."""
    row = {"wrong": False, "mirrored": True, "empty": False, "leads": True, "why": ""}
    row |= {"named": named, "named_rightly": rightly, "decided": not named, "listed": bool(named)}
    row |= {"pull": 9.0, "off_deg_s": [1.0], "sigma_deg_s": [0.1]}
    monkeypatch.setattr("validation.passes.judge", lambda *_: row)
    assert _pass(kind, 0, 0)["outcome"] == outcome


def test_a_changed_working_tree_has_another_state_than_its_commit(monkeypatch):
    clean = {"rev-parse": "abc", "status": ""}
    monkeypatch.setattr(scoreboard, "_git", lambda command, *_: clean[command])
    assert scoreboard.package_state() == "abc"
    monkeypatch.setitem(clean, "status", " M src/sunspin/base/errors.py")
    assert scoreboard.package_state().startswith("abc-")


@pytest.mark.parametrize("name", AREAS)
def test_every_area_draws_cases_that_another_process_can_run(name):
    for level in ("quick", "full"):
        tasks = list(AREAS[name](level, 0))
        assert tasks and len({(task.name, task.case) for task in tasks}) == len(tasks)
        pickle.loads(pickle.dumps(tasks))
    assert len(tasks) >= len(list(AREAS[name]("quick", 0)))


@pytest.mark.parametrize(
    ("name", "kind"),
    [("files", "right file"), ("files", "fault: thousandths"), ("passes", "few samples")],
)
def test_a_case_of_the_scoreboard_gives_a_row(name, kind):
    task = next(task for task in AREAS[name]("quick", 0) if task.kind == kind)
    row = scoreboard.run_timed(task.run)
    assert row["outcome"] in OUTCOMES and row["outcome"] not in ("defect", "wrong")
    assert row["processor_s"] > 0


def test_a_file_of_several_passes_is_wrong_if_a_decided_pass_is():
    of = {  # decided and wrong, of each pass
        "wrong": [(True, False), (True, True)],
        "right": [(True, False), (False, True)],
        "undecided": [(False, False), (False, True)],
        "open": [(False, True)],
    }
    for outcome, each in of.items():
        both = {"off": [0.1], "sigma": [0.2]}
        passes = [{"decided": d, "wrong": w, "listed": not w} | both for d, w in each]
        row = _of_passes(passes, "off", "sigma")
        assert row["outcome"] == outcome and row["listed"] is not any(w for _, w in each)


@pytest.mark.parametrize("folder", ["validation", "studies", "bench"])
def test_every_module_next_to_the_package_can_be_imported(folder):
    """Campaigns import their parts when they run: a name that has moved would be missed only then."""
    for path in sorted((ROOT / folder).glob("*.py")):
        if path.stem != "__main__":
            import_module(f"{folder}.{path.stem}")
