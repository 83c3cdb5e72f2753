"""Rows on threads: the result depends on no chunk size, worker or other row; errors and interruptions."""

import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import sunspin as ss
from sunspin import cli
from sunspin.base.errors import Interrupted
from sunspin.compute.rows import ensemble
from tests.support.rows import ELSEWHERE, Waves, heed_interrupts, same

ROWS = Waves()


@pytest.mark.evidence(
    "scan", "verified", "all rows in one chunk, for any chunk size and number of threads"
)
@pytest.mark.parametrize(("workers", "chunk"), [(1, 1), (1, 5000), (2, 7), (5, 333)])
def test_rows_do_not_depend_on_chunks_and_workers(workers, chunk):
    assert same(ensemble(ROWS, workers=workers, chunk=chunk), ROWS(np.arange(1000)))


def test_an_executor_of_the_user_computes_the_rows_and_stays_open():
    function = Waves(n_rows=150)
    with ThreadPoolExecutor(2) as executor:
        result = ensemble(function, scheduler=executor, chunk=40)
        assert executor.submit(int).result() == 0
    assert same(result, ensemble(function, workers=1))


def test_no_rows_give_empty_arrays(tmp_path):
    for store in (None, tmp_path / "store"):
        out = ensemble(Waves(n_rows=0), store=store)
        assert out["height"].shape == (0,) and out["path"].shape == (0, 2, 3)


def test_bad_arguments_of_ensemble_are_named():
    for change in ({"workers": 0}, {"workers": 1.5}, {"chunk": 0}, {"chunk": True}):
        with pytest.raises(ss.InputError, match=next(iter(change))):
            ensemble(ROWS, **change)


def test_an_exception_of_a_row_stops_the_other_rows_at_once(tmp_path):
    log = tmp_path / "rows"
    rows = Waves(n_rows=100_000, seconds_per_row=0.01, bad_row=3, log=str(log))
    begun = time.monotonic()
    with pytest.raises(ArithmeticError, match="row 3 is bad"):
        ensemble(rows, workers=2, chunk=10)
    assert time.monotonic() - begun < 2
    time.sleep(0.3)  # chunks that were running end
    assert len(log.read_text().splitlines()) <= 30


def test_progress_counts_rows(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    ensemble(ROWS, progress=True, label="waves", chunk=100)
    assert "waves" in capsys.readouterr().err
    ensemble(ROWS)
    assert capsys.readouterr().err == ""


SCRIPT = """
import sys
from tests.support.rows import Waves
from sunspin.base.errors import Interrupted
from sunspin.compute.rows import ensemble
log, store = sys.argv[1:]
try:
    ensemble(Waves(n_rows=2000, seconds_per_row=0.005, log=log), workers=2, chunk=20, store=store or None)
except Interrupted as stop:
    print(stop)
    sys.exit(130)
"""


@pytest.mark.parametrize("kept", [False, True])
def test_an_interruption_names_the_finished_rows_and_how_to_resume(kept, tmp_path):
    log, store = tmp_path / "rows", tmp_path / "store"
    command = [sys.executable, "-c", SCRIPT, str(log), str(store) if kept else ""]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(command, env=ELSEWHERE, preexec_fn=heed_interrupts, **pipes)
    try:
        while process.poll() is None and not (log.exists() and log.read_text().count("\n") > 100):
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        said, complaint = process.communicate(timeout=20)
    finally:
        process.kill()
    assert (process.returncode, complaint) == (130, "")
    assert said.count("\n") == 1 and "of 2000 rows" in said
    if not kept:
        assert "nothing is kept" in said
        return
    done = int(said.split("interrupted, ")[1].split()[0])
    assert done >= 40 and "run the same command again" in said and str(store) in said
    log.unlink()
    rows = Waves(n_rows=2000, log=str(log))
    assert same(ensemble(rows, store=store), rows(np.arange(0, 2000)))
    # those that are compared with, too; rows that ended after the sentence was printed are kept as well
    assert log.read_text().count("\n") <= 2000 - done + 2000


def test_the_command_line_prints_the_sentence_on_an_interruption(monkeypatch, capsys):
    def stopped(*_, **__):
        raise Interrupted("interrupted, 5 of 9 rows are done")

    monkeypatch.setattr("sunspin.vehicle.load_vehicle", stopped)
    monkeypatch.setattr(sys, "argv", ["sunspin", "scan", "philae", "telemetry.csv"])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert stop.value.code == 130
    assert capsys.readouterr().err.strip() == "sunspin: interrupted, 5 of 9 rows are done"
