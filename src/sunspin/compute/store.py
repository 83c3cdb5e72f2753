"""Storage of rows on disk: a folder of chunks from which a run that was killed at any moment resumes.

Each finished chunk is a file `rows-DIGEST-START-STOP.npz`, written atomically. DIGEST is a hash of everything the rows depend
on, including the package's code, so that chunks of other inputs or code are never used. A chunk that cannot be read counts as
missing. The file `lock` is locked by the run that writes; any number of runs may read a complete store.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sunspin.base.atomic_write import (
    TEMPORARY_NAME,
    lock_file,
    make_folder,
    remove_abandoned,
    write_atomically,
)
from sunspin.base.errors import InputError, OutputError
from sunspin.compute.identity import code_identity, fingerprint

if TYPE_CHECKING:
    from sunspin.compute.rows import RowFunction, Values

LOCK = "lock"
"""Name of the lock file."""
CHUNK_FILE = re.compile(r"rows-([0-9a-f]{16})-(\d{1,15})-(\d{1,15})\.npz")
"""Name of a chunk: digest, first row, end row."""


@contextmanager
def open_store(
    path: str | Path, function: RowFunction, chunk: int, out: Values
) -> Generator[tuple[Callable[[slice], None], list[slice]]]:
    """Read the stored rows of a function into `out`; yield a function that stores rows of `out`, and the missing chunks.

    The store stays locked for other runs within the `with` block, unless it is complete. Raises `InputError` for a store of other
    inputs or one that another run is writing to, `OutputError` if it cannot be written.
    """
    folder = Path(path)
    digest = fingerprint([code_identity(), type(function).__name__, function])[:16]
    with ExitStack() as stack:
        try:
            missing = _read_chunks(folder, digest, chunk, out)
            if missing:
                make_folder(folder)
                lock_file(stack.enter_context(open(folder / LOCK, "a+b")))
                remove_abandoned(folder)
                # again, because another run may have added some before the lock
                missing = _read_chunks(folder, digest, chunk, out)
        except BlockingIOError:
            what, do = "another run is writing to this store", "wait for it or choose another"
            raise InputError(what, do=do, where=str(folder)) from None
        except OSError as error:
            raise _write_error(folder, error) from None
        yield partial(_write_chunk, folder, digest, out), missing


def _write_chunk(folder: Path, digest: str, out: Values, rows: slice) -> None:
    """Write the rows `rows` of `out` to the file of their chunk. Raises `OutputError`."""
    arrays: dict[str, Any] = {name: array[rows] for name, array in out.items()}

    def write(part: Path) -> None:
        """Write the arrays to a temporary file."""
        with open(part, "wb") as file:  # for a file name NumPy would append .npz
            np.savez(file, **arrays)

    try:
        write_atomically(folder / f"rows-{digest}-{rows.start:010d}-{rows.stop:010d}.npz", write)
    except OSError as error:
        raise _write_error(folder, error) from None


def _write_error(folder: Path, error: OSError) -> OutputError:
    """Return the error for a store that cannot be written."""
    what = f"the store cannot be written ({error.strerror or error}); nothing that it holds is lost"
    do = "free space and run the same command, or choose another store"
    return OutputError(what, do=do, where=str(folder))


def _read_chunks(folder: Path, digest: str, chunk: int, out: Values) -> list[slice]:
    """Read all complete chunks of a folder into `out`; return the missing rows as slices of at most `chunk` rows.

    Files of other inputs, which have another digest, and files that are no chunks raise `InputError`.
    """
    done = np.zeros(len(next(iter(out.values()))), dtype=bool)
    for path in folder.iterdir() if folder.exists() else ():
        name = CHUNK_FILE.fullmatch(path.name)
        if name is not None and name[1] == digest:
            rows = slice(int(name[2]), int(name[3]))
            try:
                with open(path, "rb") as file, np.load(file) as chunk_file:
                    arrays = {key: chunk_file[key] for key in out}
            except Exception:  # on damaged files NumPy raises errors of many types
                continue
            expected = {key: (array.dtype, array[rows].shape) for key, array in out.items()}
            # a damaged file may have arrays of another form: it counts as missing
            if expected == {key: (array.dtype, array.shape) for key, array in arrays.items()}:
                for key, array in arrays.items():
                    out[key][rows] = array
                done[rows] = True
        elif path.name != LOCK and not TEMPORARY_NAME.fullmatch(path.name):
            what = "this is no store, or one of other inputs or of another version of sunspin"
            do = "give the same inputs or choose another folder"
            raise InputError(what, got=path.name, do=do, where=str(folder))
    # first and end row of each gap: the rows at which `done` changes
    gaps = np.flatnonzero(np.diff(done, prepend=True, append=True)).reshape(-1, 2).tolist()
    return [
        slice(begin, min(begin + chunk, stop))
        for start, stop in gaps
        for begin in range(start, stop, chunk)
    ]
