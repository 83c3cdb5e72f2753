"""Rows on disk: killed anywhere and resumed, the same bits; anything that is not this run's store is left alone."""

import errno
import fcntl
import hashlib
import os
import random
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import zarr

import sunspin as ss
import sunspin.compute.store as disk
from rowsets import ELSEWHERE, Waves
from sunspin.compute.rows import ensemble

ROWS = Waves()
WHOLE = ROWS(np.arange(1000))


def same(a, b=WHOLE) -> bool:
    return all(a[name].tobytes() == b[name].tobytes() for name in b)


def tree(folder: Path) -> dict[str, str]:
    """Every file under a folder with its content's hash."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
    }


def refused(folder: Path, *words: str, rows: Waves = ROWS) -> None:
    """One sentence that names the folder and says the words, and nothing touched."""
    before = tree(folder) if folder.is_dir() else folder.read_bytes()
    with pytest.raises(ss.InputError) as said:
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
    assert same(ensemble(Waves(log=str(log)), store=folder, **arguments))
    return log.read_text().count("\n")


def test_a_store_changes_no_bit_and_a_complete_one_is_read(tmp_path):
    for chunk in (1000, 64, 9):
        folder = tmp_path / str(chunk)
        assert computed(tmp_path, folder, chunk=chunk, workers=3) == 1000
        before = tree(folder)
        assert computed(tmp_path, folder, chunk=50) == 0
        assert tree(folder) == before


class Crash(Exception):
    """The end of the process, as far as files can tell."""


def crash_at(monkeypatch, step: int) -> None:
    """Let the process end at a step of writing: each file has three, with half of it, all of it, and in its place."""
    steps = iter(range(10**6))

    def write(target, data):
        target.parent.mkdir(parents=True, exist_ok=True)
        part = disk.temporary(target)
        for content in (data[: len(data) // 2], data):
            part.write_bytes(content)
            if next(steps) >= step:
                raise Crash
        os.replace(part, target)
        if next(steps) >= step:
            raise Crash

    monkeypatch.setattr(disk, "_write_whole", write)


@pytest.mark.parametrize(
    "steps",
    [[0, 4, 14, 17, 21, 28, 35, 42, 50, 51], pytest.param(range(52), marks=pytest.mark.long)],
)
def test_a_run_that_ends_at_any_step_of_writing_is_resumed(steps, tmp_path):
    """Five files make the store, then four per chunk of which there are three: 17 files, 51 steps."""
    rows = Waves(n_rows=30)
    wanted = rows(np.arange(30))
    for step in steps:
        folder = tmp_path / str(step)
        with pytest.MonkeyPatch.context() as patch:
            crash_at(patch, step)
            if step < 51:
                with pytest.raises(Crash):
                    ensemble(rows, store=folder, chunk=12, workers=1)
            else:
                ensemble(rows, store=folder, chunk=12, workers=1)
        assert same(ensemble(rows, store=folder, chunk=7), wanted), step
        assert same(ensemble(rows, store=folder), wanted), step
        assert not list(folder.rglob(f"*{disk.PART}")), step


KILLED = """
import sys
from rowsets import Waves
from sunspin.compute.rows import ensemble
ensemble(Waves(n_rows=int(sys.argv[2]), seconds_per_row=0.004), store=sys.argv[1], chunk=10, workers=2)
"""


@pytest.mark.evidence("scan", "verified", "a run that was never stopped")
@pytest.mark.parametrize(
    ("n_rows", "least"), [(350, 2), pytest.param(900, 4, marks=pytest.mark.long)]
)
def test_a_run_killed_again_and_again_ends_with_the_same_bits(n_rows, least, tmp_path):
    """SIGKILL at random moments, a little later when the run got nowhere, until a run gets through."""
    draw, kills, folder = random.Random(4), 0, tmp_path / "store"
    while True:
        process = subprocess.Popen(
            [sys.executable, "-c", KILLED, str(folder), str(n_rows)], env=ELSEWHERE
        )
        before = len(list(folder.glob("done/c/*")))
        deadline = time.monotonic() + 20
        while (
            process.poll() is None
            and len(list(folder.glob("done/c/*"))) < before + 12
            and time.monotonic() < deadline
        ):
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
    assert not list(folder.rglob(f"*{disk.PART}"))


def test_a_chunk_that_does_not_answer_to_its_record_is_computed_again(tmp_path, complete):
    chunk = complete / "height" / "c" / "3"
    data = chunk.read_bytes()
    flipped = bytes([data[0] ^ 1]) + data[1:]
    for damage in (flipped, data[:-8], data[:100], b"", data + b"\0" * 8, None):
        chunk.unlink() if damage is None else chunk.write_bytes(damage)
        assert computed(tmp_path, complete) == 90
        assert chunk.read_bytes() == data
    record = complete / "done" / "c" / "11"
    for damage in (b"", b"\0" * 32, b"x" * 31):
        record.write_bytes(damage)
        assert computed(tmp_path, complete) == 10  # the last chunk is shorter


def test_other_inputs_are_named_and_refused(complete):
    refused(complete, "other inputs", "pitch", rows=Waves(pitch=0.38))
    refused(complete, "other inputs", "pitch, rows", rows=Waves(pitch=0.38, n_rows=999))


@pytest.mark.parametrize("name", ["zarr.json", "height/zarr.json", "done/zarr.json"])
def test_damaged_metadata_are_refused(complete, name):
    text = (complete / name).read_bytes()
    for size in (0, 1, len(text) // 2, len(text) - 2):
        (complete / name).write_bytes(text[:size])
        refused(complete, "damaged")
    for damage in (
        b"[]",
        b"{}",
        b"null",
        b"\xff\xfe",
        text.replace(b"float64", b"float32").replace(b"uint8", b"int16"),
    ):
        if damage != text:
            (complete / name).write_bytes(damage)
            refused(complete, "damaged")


def test_an_identity_that_was_edited_is_refused(complete):
    about = complete / "zarr.json"
    about.write_text(about.read_text().replace("0.37", "0.38"))
    refused(complete, "damaged", rows=Waves(pitch=0.38))


def test_what_is_no_store_is_refused(tmp_path):
    (tmp_path / "file").write_text("mine")
    refused(tmp_path / "file", "cannot be a store")
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.jpg").write_text("meow")
    refused(tmp_path / "photos", "not a store")
    (tmp_path / "photos" / "done").mkdir()
    refused(tmp_path / "photos", "not a store")
    zarr.create_group(tmp_path / "group", attributes={"mine": 1})
    refused(tmp_path / "group", "not a store of sunspin")
    zarr.create_group(tmp_path / "later", attributes={disk.KEY: {"format": disk.FORMAT + 1}})
    refused(tmp_path / "later", "does not know")
    with pytest.raises(ss.OutputError, match="cannot be written"):
        ensemble(ROWS, store=tmp_path / "file" / "below")


def test_an_empty_folder_will_do_and_missing_ones_are_made(tmp_path):
    (tmp_path / "empty").mkdir()
    assert same(ensemble(ROWS, store=tmp_path / "empty"))
    assert same(ensemble(ROWS, store=str(tmp_path / "a" / "b" / "c")))


def test_one_run_at_a_time_writes_and_a_complete_store_is_read_by_all(tmp_path, complete):
    with open(complete / "done" / "lock") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        assert same(ensemble(ROWS, store=complete))
        (complete / "done" / "c" / "0").unlink()
        refused(complete, "another run")
    assert computed(tmp_path, complete) == 90


def test_a_disk_that_is_full_is_said_and_the_store_goes_on_later(tmp_path, monkeypatch):
    def full(target, data, write=disk._write_whole):
        if target.parent.parent.name == "done" and target.name == "4":
            with monkeypatch.context() as inner:
                inner.setattr(
                    os, "fsync", refuse
                )  # as a disk without room does, half of the bytes being there
                return write(target, data)
        write(target, data)

    def refuse(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(disk, "_write_whole", full)
        with pytest.raises(ss.OutputError, match="No space left.*free space"):
            ensemble(ROWS, store=tmp_path / "store", chunk=100, workers=1)
    assert not list((tmp_path / "store").rglob(f"*{disk.PART}"))
    assert computed(tmp_path, tmp_path / "store") == 600


def test_only_files_of_the_store_are_swept(complete):
    """What a killed run left beside its chunks goes; what anybody else put there stays, whatever it is called."""
    (complete / "done" / "c" / "0").unlink()
    left = [
        disk.temporary(complete / name)
        for name in ("zarr.json", "height/zarr.json", "path/c/3/0/0", "done/c/0")
    ]
    theirs = [
        complete / place / name
        for place in ("", "height", "path/c", "done/c")
        for name in (
            ".thesis.part",
            ".sunspin-store-thesis.part",
            ".zarr.json.part",
            ".0.part",
            "a.part",
        )
    ]
    for path in (*left, *theirs):
        path.write_bytes(b"x")
    assert same(ensemble(ROWS, store=complete))
    assert not [path for path in left if path.exists()] and all(
        path.read_bytes() == b"x" for path in theirs
    )


def test_chunks_on_disk_are_not_more_than_a_folder_bears(tmp_path, monkeypatch):
    monkeypatch.setattr(disk, "MAX_FILES", 10)
    assert same(ensemble(ROWS, store=tmp_path / "store", chunk=3))
    assert len(list((tmp_path / "store" / "height" / "c").iterdir())) == 10


def test_other_programs_read_the_store(complete):
    with xr.open_zarr(complete, consolidated=False) as data:
        assert data["path"].sizes == {"row": 1000, "path_1": 2, "path_2": 3}
        assert np.array_equal(data["height"].values, WHOLE["height"], equal_nan=True)


@pytest.mark.parametrize("name", ["done", "a/b", "__x", ".x", "zarr.json"])
def test_outputs_whose_names_would_collide_are_refused(name, tmp_path):
    rows = type("Rows", (Waves,), {"outputs": {name: ("float64", ())}})()
    with pytest.raises(ss.InputError, match="cannot be kept"):
        ensemble(rows, store=tmp_path / "store")
    assert not (tmp_path / "store").exists()
