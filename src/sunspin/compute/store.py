"""Rows on disk: a folder of chunks that a killed run resumes from.

`store.json` says what the rows depend on, `lock` is held by the run that writes, and each finished chunk of rows is a file
`rows-NAME-NUMBER.npz` that appears whole or not at all. NAME is a hash of what the rows depend on, the package's code included, so
that no chunk of another state is used. A chunk that cannot be read counts as not computed. A complete store may be read by any
number of runs.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sunspin.base.atomic_write import LIST, PART, make_folder, sweep, write_whole
from sunspin.base.errors import InputError, OutputError, sentence
from sunspin.compute.identity import fingerprint, plain

if TYPE_CHECKING:
    from sunspin.compute.pieces import Piece, RowFunction, Values

FORMAT = 2
ABOUT, LOCK = "store.json", "lock"

MAX_ABOUT_BYTES = 100_000_000
"""Of `store.json`: the measured track is in it, which is a MB at most."""

MAX_FILES = 10_000
"""Chunks at most: beyond that a store of many small chunks is cut more coarsely."""

HEADER_BYTES = 4096
"""What the file of an array may have beyond its numbers."""


class RowStore:
    """An open store of `n_rows` rows in chunks of `chunk_rows`."""

    def __init__(self, path: Path, wanted: Mapping[str, Any], chunk_rows: int) -> None:
        self.path: Path = path
        self.chunk_rows: int = chunk_rows
        self.n_rows: int = wanted["rows"]
        self.n_chunks: int = -(-self.n_rows // chunk_rows)
        self.rows_kept: int = 0
        self._name = fingerprint(wanted)[:16]
        self._left = np.full(self.n_chunks, chunk_rows)
        self._left[-1] = self.n_rows - (self.n_chunks - 1) * chunk_rows

    def place(self, number: int) -> Path:
        """The file of a chunk."""
        return self.path / f"rows-{self._name}-{number:05d}.npz"

    def span(self, number: int) -> slice:
        """The rows of a chunk."""
        return slice(number * self.chunk_rows, min((number + 1) * self.chunk_rows, self.n_rows))

    def read_into(self, out: Values) -> list[Piece]:
        """Read what is done into `out`; return the ranges of rows that are not."""
        missing: list[Piece] = []
        self.rows_kept = 0
        for number in range(self.n_chunks):
            rows = self.span(number)
            if _read(self.place(number), {name: array[rows] for name, array in out.items()}):
                self.rows_kept += rows.stop - rows.start
                self._left[number] = 0
            elif missing and missing[-1][1] == rows.start:
                missing[-1] = missing[-1][0], rows.stop
            else:
                missing.append((rows.start, rows.stop))
        return missing

    def filled(self, start: int, stop: int, out: Values) -> None:
        """Rows start..stop of `out` are computed: write the chunks that this completes."""
        for number in range(start // self.chunk_rows, -(-stop // self.chunk_rows)):
            rows = self.span(number)
            self._left[number] -= min(stop, rows.stop) - max(start, rows.start)
            if self._left[number] == 0:
                self._write(number, {name: array[rows] for name, array in out.items()})
                self.rows_kept += rows.stop - rows.start

    def _write(self, number: int, arrays: dict[str, Any]) -> None:
        def save(part: Path) -> None:
            with open(part, "wb") as file:  # a name would be given an ending of NumPy's
                np.savez(file, **arrays)

        try:
            write_whole(self.place(number), save)
        except OSError as error:
            raise _cannot_write(self.path, error) from None


def _read(file: Path, arrays: Values) -> bool:
    """Fill arrays from the file of a chunk; false where it is not there, damaged or of another form."""
    try:
        with zipfile.ZipFile(file) as members:
            sizes = {member.filename: member for member in members.infolist()}
            for name, array in arrays.items():
                member = sizes[f"{name}.npy"]
                if member.compress_type or member.file_size > array.nbytes + HEADER_BYTES:
                    return False
        with np.load(file) as kept:
            for name, array in arrays.items():
                read = kept[name]
                if read.shape != array.shape or read.dtype != array.dtype:
                    return False
                array[...] = read
    except (OSError, ValueError, KeyError, EOFError, NotImplementedError, zipfile.BadZipFile):
        return False
    return True


def _cannot_write(path: Path, error: OSError) -> OutputError:
    reason = error.strerror or str(error)
    what = f"the store cannot be written ({reason}); nothing that it holds is lost"
    do = "free space and run the same command, or choose another store"
    return OutputError(sentence(what, do=do, where=str(path)))


@contextmanager
def open_store(
    path: Any, function: RowFunction, chunk: int, out: Values
) -> Generator[tuple[RowStore, list[Piece]]]:
    """Open or make the store of a function's rows and read what it has into `out`; gives it and the ranges not yet done.

    Raises `InputError`, and changes nothing, where the path is something else, of other inputs, damaged or in use.
    """
    folder, wanted = Path(path), _wanted(function)
    store = _existing(folder, wanted)
    if store is not None and not (missing := store.read_into(out)):
        yield store, missing
        return
    with _locked(folder):
        sweep(folder)
        store = _existing(folder, wanted) or _new(folder, wanted, chunk)
        yield store, store.read_into(out)


def _wanted(function: RowFunction) -> dict[str, Any]:
    """What the rows of a function depend on, as it comes back from JSON."""
    outputs = {
        name: [np.dtype(dtype).str, list(shape)]
        for name, (dtype, shape) in function.outputs.items()
    }
    own = {"file", "allow_pickle"}  # of NumPy
    if names := [name for name in outputs if not name.isidentifier() or name in own]:
        raise InputError(sentence("no store keeps an output of this name", got=", ".join(names)))
    whole = {
        **function.identity(),
        "function": type(function).__name__,
        "rows": function.n_rows,
        "outputs": outputs,
    }
    return json.loads(json.dumps(plain(whole)))


def _existing(folder: Path, wanted: Mapping[str, Any]) -> RowStore | None:
    """The store at this place; None if there is room for a new one."""
    where = str(folder)
    try:
        names = {entry.name for entry in folder.iterdir()} if folder.exists() else set()
    except OSError as error:
        what = f"this cannot be a store ({error.strerror or error})"
        raise InputError(sentence(what, do="give a new folder", where=where)) from None
    if ABOUT not in names:
        if "zarr.json" in names:
            what = "this is a store of an earlier version, which this one does not read"
            raise InputError(sentence(what, do="choose another folder", where=where))
        begun = {name for name in names if PART.fullmatch(name) or LIST.fullmatch(name)}
        if names - begun - {LOCK}:
            what = "the folder is not empty and not a store of sunspin"
            raise InputError(sentence(what, do="choose another folder", where=where))
        return None
    try:
        if (folder / ABOUT).stat().st_size > MAX_ABOUT_BYTES:
            raise ValueError
        about = json.loads((folder / ABOUT).read_text("utf-8"))
        known, identity, chunk_rows = (about[key] for key in ("format", "identity", "chunk_rows"))
        if not isinstance(chunk_rows, int) or not 1 <= chunk_rows <= max(identity["rows"], 1):
            raise ValueError
        if fingerprint(identity) != about["sha256"]:
            raise ValueError
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        what = "the store is damaged and cannot be resumed"
        raise InputError(sentence(what, do="choose another or remove it", where=where)) from None
    if known != FORMAT:
        what = "the store has a form that this version does not know"
        raise InputError(sentence(what, do="choose another folder", where=where))
    differs = sorted(key for key in {*identity, *wanted} if identity.get(key) != wanted.get(key))
    if differs:
        what = f"the store was made with other inputs, which differ in {', '.join(differs)}"
        do = "give the same inputs or choose another folder"
        raise InputError(sentence(what, do=do, where=where))
    return RowStore(folder, wanted, chunk_rows)


def _new(folder: Path, wanted: Mapping[str, Any], chunk: int) -> RowStore:
    chunk_rows = min(max(chunk, -(-wanted["rows"] // MAX_FILES)), wanted["rows"])
    about = {
        "format": FORMAT,
        "chunk_rows": chunk_rows,
        "sha256": fingerprint(wanted),
        "identity": wanted,
    }
    try:
        write_whole(folder / ABOUT, lambda part: part.write_text(json.dumps(about), "utf-8"))
    except OSError as error:
        raise _cannot_write(folder, error) from None
    return RowStore(folder, wanted, chunk_rows)


@contextmanager
def _locked(folder: Path) -> Generator[None]:
    """Hold the store alone; the system lets go of it when the process ends, however it ends."""
    try:
        make_folder(folder)
        lock = open(folder / LOCK, "a+b")
    except OSError as error:
        raise _cannot_write(folder, error) from None
    with lock:
        try:
            hold(lock)
        except BlockingIOError:
            what = "another run is writing to this store"
            do = "wait for it or choose another"
            raise InputError(sentence(what, do=do, where=str(folder))) from None
        except OSError as error:
            raise _cannot_write(folder, error) from None
        yield


def hold(file: Any) -> None:
    """Hold an open file alone until it is closed; `BlockingIOError` where another process holds it."""
    try:
        import fcntl
    except ModuleNotFoundError:  # Windows
        msvcrt: Any = import_module("msvcrt")
        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError as error:
            raise BlockingIOError(*error.args) from None
    else:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
