"""Rows on disk: a run killed at any step is resumed to the same result, and other folders are not touched."""

import errno
import hashlib
import io
import os
import random
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import sunspin as ss
import sunspin.compute.store as disk
from sunspin.base.atomic_write import lock_file
from sunspin.compute import identity
from sunspin.compute.rows import ensemble
from tests.support.rows import ELSEWHERE, Waves, same

ROWS = Waves()
WHOLE = ROWS(np.arange(1000))


def tree(folder: Path) -> dict[str, str]:
    """Every file under a folder with its content's hash."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    contents = {str(path.relative_to(folder)): path.read_bytes() for path in files}
    return {name: hashlib.sha256(content).hexdigest() for name, content in contents.items()}


def refused(folder: Path, *words: str, rows: Waves = ROWS) -> None:
    """One sentence that names the folder and says the words, and nothing touched."""
    before = tree(folder) if folder.is_dir() else folder.read_bytes()
    with pytest.raises(ss.SunspinError) as said:
        ensemble(rows, store=folder)
    text = str(said.value)
    assert "\n" not in text and all(word in text for word in (str(folder), *words)), text
    assert (tree(folder) if folder.is_dir() else folder.read_bytes()) == before


@pytest.fixture
def complete(tmp_path) -> Path:
    ensemble(ROWS, store=tmp_path / "store", chunk=90)
    return tmp_path / "store"


def computed(tmp_path, folder, **arguments) -> int:
    """Rows that a run on this store computes; its result is checked."""
    log = tmp_path / "log"
    log.write_text("")
    assert same(ensemble(Waves(log=str(log)), store=folder, **arguments), WHOLE)
    return log.read_text().count("\n")


def test_rows_from_a_store_equal_computed_ones_and_a_complete_store_is_only_read(tmp_path):
    for chunk in (1000, 64, 9):
        folder = tmp_path / str(chunk)
        assert computed(tmp_path, folder, chunk=chunk, workers=3) == 1000
        before = tree(folder)
        assert computed(tmp_path, folder, chunk=50) == 0
        assert tree(folder) == before


def test_a_store_is_resumed_with_chunks_of_another_size(tmp_path, complete):
    for path in sorted(complete.glob("rows-*"))[2:7:2]:
        path.unlink()
    assert computed(tmp_path, complete, chunk=7) == 3 * 90
    assert computed(tmp_path, complete) == 0


class Crash(Exception):
    """The end of the process, as far as files can tell."""


def crash_at(monkeypatch, step: int) -> None:
    """Let the process end at a step of writing: each file has three, with half of it, all of it, and in its place."""
    steps = iter(range(10**6))

    def write(target, fill):
        part = target.with_name(f".sunspin-999999999-{'a' * 16}.part")
        fill(part)
        content = part.read_bytes()
        for some in (content[: len(content) // 2], content):
            part.write_bytes(some)
            if next(steps) >= step:
                raise Crash
        os.replace(part, target)
        if next(steps) >= step:
            raise Crash

    monkeypatch.setattr(disk, "write_atomically", write)


def test_a_run_that_ends_at_any_step_of_writing_is_resumed(tmp_path):
    """Three files make the store, of three chunks: 9 steps."""
    rows = Waves(n_rows=30)
    wanted = rows(np.arange(30))
    for step in range(9):
        folder = tmp_path / str(step)
        with pytest.MonkeyPatch.context() as patch:
            crash_at(patch, step)
            with pytest.raises(Crash):
                ensemble(rows, store=folder, chunk=12, workers=1)
        assert same(ensemble(rows, store=folder, chunk=7), wanted), step
        assert same(ensemble(rows, store=folder), wanted), step
        assert not list(folder.glob(".sunspin-*")) or step == 8, step


KILLED = """
import sys
from tests.support.rows import Waves
from sunspin.compute.rows import ensemble
ensemble(Waves(n_rows=int(sys.argv[2]), seconds_per_row=0.004), store=sys.argv[1], chunk=10, workers=2)
"""


@pytest.mark.evidence("scan", "verified", "the same run without an interruption")
@pytest.mark.parametrize(
    ("n_rows", "least"), [(350, 2), pytest.param(900, 4, marks=pytest.mark.long)]
)
def test_a_run_killed_again_and_again_ends_with_the_same_result(n_rows, least, tmp_path):
    """SIGKILL at random moments, a little later when the run got nowhere, until a run gets through."""
    draw, kills, folder = random.Random(4), 0, tmp_path / "store"
    while True:
        command = [sys.executable, "-c", KILLED, str(folder), str(n_rows)]
        process = subprocess.Popen(command, env=ELSEWHERE)
        enough = len(list(folder.glob("rows-*.npz"))) + 12
        deadline = time.monotonic() + 60
        while process.poll() is None and time.monotonic() < deadline:
            if len(list(folder.glob("rows-*.npz"))) >= enough:
                break
            time.sleep(0.01)
        time.sleep(draw.uniform(0, 0.05))
        process.kill()
        if process.wait() == 0:
            break
        kills += 1
        assert kills < 20
    assert kills >= least
    rows = Waves(n_rows=n_rows)
    assert same(ensemble(rows, store=folder), rows(np.arange(n_rows)))
    assert not list(folder.glob("*.part"))


def test_a_damaged_chunk_is_computed_again(tmp_path, complete):
    chunk = sorted(complete.glob("rows-*.npz"))[3]
    data = chunk.read_bytes()
    flipped = data[:200] + bytes([data[200] ^ 1]) + data[201:]
    other = io.BytesIO()
    np.savez(other, **{name: array[270:360].astype("float16") for name, array in WHOLE.items()})
    for damage in (flipped, data[:-8], data[:100], b"", b"\x00" * 99, other.getvalue(), None):
        chunk.unlink() if damage is None else chunk.write_bytes(damage)
        assert computed(tmp_path, complete) == 90
        assert computed(tmp_path, complete) == 0


def test_a_store_of_other_inputs_or_another_version_of_the_package_is_refused(
    complete, monkeypatch
):
    refused(complete, "other inputs", rows=Waves(pitch=0.38))
    refused(complete, "other inputs", rows=Waves(n_rows=999))
    monkeypatch.setattr(disk, "code_identity", lambda: {"code_sha256": "another"})
    refused(complete, "another version")


def test_a_folder_that_is_no_store_and_a_file_are_refused_as_a_store(tmp_path):
    for content in ("cat.jpg", "zarr.json", "store.json"):
        other = tmp_path / content.partition(".")[2]
        other.mkdir(exist_ok=True)
        (other / content).write_text("{}")
        refused(other, "no store", "another version", content)
        (other / content).unlink()
    (tmp_path / "file").write_text("mine")
    refused(tmp_path / "file", "cannot be written (Not a directory)")
    with pytest.raises(ss.OutputError, match="cannot be written"):
        ensemble(ROWS, store=tmp_path / "file" / "below")


def test_a_store_is_made_in_an_empty_or_a_missing_folder(tmp_path):
    (tmp_path / "empty").mkdir()
    assert same(ensemble(ROWS, store=tmp_path / "empty"), WHOLE)
    assert same(ensemble(ROWS, store=str(tmp_path / "a" / "b" / "c")), WHOLE)


def test_one_run_at_a_time_writes_and_a_complete_store_is_read_by_all(tmp_path, complete):
    with open(complete / "lock") as other:
        lock_file(other)
        assert same(ensemble(ROWS, store=complete), WHOLE)
        sorted(complete.glob("rows-*.npz"))[0].unlink()
        refused(complete, "another run")
    assert computed(tmp_path, complete) == 90


def test_a_full_disk_is_reported_and_the_store_is_resumed_later(tmp_path, monkeypatch):
    def full(target, fill, write=disk.write_atomically):
        if "-0000000400-" in target.name:
            with monkeypatch.context() as inner:
                inner.setattr(os, "fsync", refuse)  # as a disk without room does
                return write(target, fill)
        return write(target, fill)

    def refuse(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(disk, "write_atomically", full)
        with pytest.raises(ss.OutputError, match="No space left.*free space"):
            ensemble(ROWS, store=tmp_path / "store", chunk=100, workers=1)
    assert not list((tmp_path / "store").glob("*.part"))
    assert computed(tmp_path, tmp_path / "store") == 600


def test_a_changed_source_of_the_package_changes_the_identity_of_a_store(monkeypatch, tmp_path):
    before = identity.code_identity()
    (tmp_path / "compute").mkdir()
    (tmp_path / "compute" / "identity.py").write_text("")
    identity.code_identity.cache_clear()
    monkeypatch.setattr(identity, "__file__", str(tmp_path / "compute" / "identity.py"))
    try:
        changed = identity.code_identity()
        assert changed["code_sha256"] != before["code_sha256"]
        assert changed["sunspin"] == before["sunspin"]
    finally:
        identity.code_identity.cache_clear()
