"""Faults of the machine: full disk, little memory, killed runs, the time of day."""

import os
import resource
import subprocess
import sys
import time
from functools import partial

import numpy as np
import pytest

from sunspin.output.folder import results_folder, write_whole
from tests.support.commands import sunspin
from validation.kill import agree_to_rounding, environment, is_whole

START = ["--omega-deg-s=6,0,0", "--sun=0,0.6,0.8"]


def limited(kind, most, *arguments):
    """The command line in another process that may not have more of something; exit code, complaint."""
    command = [sys.executable, "-m", "sunspin.cli", *map(str, arguments)]
    options = {"env": environment(), "capture_output": True, "text": True}
    limit = partial(resource.setrlimit, kind, (most, most))
    done = subprocess.run(command, preexec_fn=limit, **options)
    return done.returncode, done.stderr


def said(outcome, *words):
    code, complaint = outcome
    assert code == 2 and complaint.startswith("sunspin: error: "), complaint
    assert complaint.count("\n") == 1, complaint
    assert all(word in complaint for word in words), complaint


def test_a_full_disk_is_reported_and_leaves_no_partial_results(tmp_path):
    out = tmp_path / "out"
    given = ["sun", "philae", "philae", "--out", out]
    said(limited(resource.RLIMIT_FSIZE, 20_000, *given), "free space", "nothing")
    assert not out.exists()


@pytest.mark.long
def test_too_little_memory_is_reported():
    given = ["simulate", "philae", *START, "--duration=200000", "--step=0.101"]
    said(limited(resource.RLIMIT_AS, 900_000_000, *given), "memory")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_write_permission_is_reported(tmp_path):
    tmp_path.chmod(0o500)
    given = ["simulate", "philae", *START, "--duration=3", "--out", tmp_path / "out"]
    said(limited(resource.RLIMIT_CPU, 60, *given), "Permission denied")


def begun(folder, process):
    """What a process leaves that is killed while it writes a file."""
    part = folder / f".sunspin-{process}-0123456789abcdef.part"
    part.write_bytes(b"half")
    return part


def process_that_ended():
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    return ended.pid


def test_files_of_a_killed_run_are_removed_and_those_of_a_running_one_kept(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    begun(folder, process_that_ended())
    living = begun(folder, os.getppid())
    with pytest.raises(Exception, match="not empty"):
        results_folder(folder, "sun")
    living.unlink()
    results_folder(folder, "sun")
    assert [path.name for path in folder.iterdir()] == [".sunspin-results"]


def test_only_temporary_files_of_sunspin_are_removed(tmp_path):
    """What has not our temporary name stays, and so does a link that has it."""
    folder, ended = results_folder(tmp_path / "out", "sun"), process_that_ended()
    stems = (".thesis", "sun", f".sunspin-{ended}", f".sunspin-{ended}-{'0' * 15}", ".sunspin")
    theirs = [folder / f"{stem}.{end}part" for stem in stems for end in ("", "1.", f"{ended}.")]
    theirs += [tmp_path / "thesis.tex", folder / "thesis.tex"]
    for path in theirs:
        path.write_bytes(b"mine")
    link, ours = folder / f".sunspin-{ended}-{'f' * 16}.part", begun(folder, ended)
    link.symlink_to(tmp_path / "thesis.tex")
    results_folder(folder, "sun")
    assert all(path.read_bytes() == b"mine" for path in (*theirs, link)) and not ours.exists()


def test_a_failed_write_keeps_the_old_file(tmp_path):
    target = tmp_path / "a.json"
    write_whole(target, lambda part: part.write_text("1"))

    def fails(part):
        part.write_text("half")
        raise RuntimeError

    with pytest.raises(RuntimeError):
        write_whole(target, fails)
    assert target.read_text() == "1" and list(tmp_path.iterdir()) == [target]


def test_results_do_not_depend_on_the_time_of_day(tmp_path, monkeypatch, undrawn):
    """The second run is at a later second, and `time.time` gives a time before 1970, then one after 2100."""
    for place, time_of_day in (("first", -1e9), ("second", 5e9)):
        (tmp_path / place).mkdir()
        monkeypatch.chdir(tmp_path / place)
        with pytest.MonkeyPatch.context() as clock:
            clock.setattr(time, "time", lambda value=time_of_day: value)
            sunspin("sun", "philae", "philae", "--out", "sun")
            sunspin("simulate", "philae", *START, "--duration=5", "--out", "motion")
        time.sleep(1.0 if place == "first" else 0.0)
    first, second = (
        {path.relative_to(root): path.read_bytes() for path in root.rglob("*") if path.is_file()}
        for root in (tmp_path / "first", tmp_path / "second")
    )
    assert len(first) > 6 and first == second


@pytest.mark.parametrize(
    ("name", "whole", "half"),
    [
        ("a.json", b'{"a": 1}\n', b'{"a": '),
        ("a.html", b"<html></html>\n", b"<html>"),
        ("a.svg", b"<svg></svg>", b"<svg>"),
        ("a.png", b"\x89PNG IEND\xaeB`\x82", b"\x89PNG"),
        ("a.csv", b"a\n", b""),
        ("a.nc", None, b"\x89HDF\r\n\x1a\n"),
    ],
)
def test_the_kill_campaign_detects_partial_files(name, whole, half, tmp_path):
    path = tmp_path / name
    path.write_bytes(half)
    assert not is_whole(path)
    if whole is not None:
        path.write_bytes(whole)
        assert is_whole(path)


def test_the_kill_campaign_compares_results_to_nine_digits():
    one, nan = {"a": [1.0, None, "x"]}, np.array([np.nan, 1.0])
    assert agree_to_rounding(one, {"a": [1.0 + 1e-12, None, "x"]})
    assert agree_to_rounding({"a": 1.0, "seconds": 2.0}, {"a": 1.0, "seconds": 3.0})
    assert agree_to_rounding(nan, nan.copy())
    pairs = (one, {"a": [1.0 + 1e-6, None, "x"]}), ([1.0], [1.0, 2.0]), (None, "x")
    for ours, theirs in (*pairs, (np.array([1, 2]), np.array([1, 3]))):
        assert not agree_to_rounding(ours, theirs)
