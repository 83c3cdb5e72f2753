"""Rows on disk: a Zarr group that a killed run resumes from, with the same bits in the end.

One array per output, cut along the rows into chunks of a size that the store keeps for good; and an array `done` with the
SHA-256 of each finished chunk. That record is written last, so a chunk without it, or with bytes that do not answer to it,
counts as not computed. Every file is written beside its place and renamed. One process at a time may write; a
complete store may be read by any number.
"""

from __future__ import annotations

import asyncio
import fcntl
import json
import math
import os
from collections.abc import Generator, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import zarr
from zarr.storage import LocalStore, MemoryStore

from sunspin.base.atomic_write import make_folder
from sunspin.base.errors import InputError, OutputError, sentence
from sunspin.compute.identity import bits, fingerprint, plain

if TYPE_CHECKING:
    from sunspin.compute.pieces import Piece, RowFunction, Values

FORMAT = 1
KEY = "sunspin_rows"
"""The group's attribute by which a store is known."""

DONE = "done"
LOCK = "lock"
PART = ".part"
RECORD = 32
"""Bytes of a chunk's record, a SHA-256."""

FORM = ("shape", "data_type", "chunk_grid", "chunk_key_encoding", "fill_value", "codecs")
"""What a reader of an array goes by."""

MAX_METADATA_BYTES = 100_000_000
"""Of a group or array: the measured track is in it, which is a MB at most."""

MAX_FILES = 10_000
"""Chunks per output at most: beyond that a store of many small chunks is cut more coarsely."""

UNREADABLE = (ValueError, KeyError, TypeError, AttributeError, RuntimeError, OSError)
"""What Zarr raises on files that are cut off, missing or not what they should be."""


class Disk(LocalStore):
    """A Zarr store of files that appear whole or not at all."""

    async def set(self, key: str, value: Any) -> None:
        self._check_writable()
        await asyncio.to_thread(_write_whole, self.root / key, value.to_bytes())

    def set_sync(self, key: str, value: Any) -> None:
        self._check_writable()
        _write_whole(self.root / key, value.to_bytes())


def _write_whole(target: Path, data: bytes) -> None:
    make_folder(target.parent)
    part = temporary(target)
    try:
        with open(part, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(
                file.fileno()
            )  # a power failure may still lose the name: then the record does not match, the chunk is redone
        os.replace(part, target)
    finally:
        part.unlink(missing_ok=True)


def temporary(target: Path) -> Path:
    """Where a file of the store is written first. Only the one process that holds the store writes there."""
    return target.with_name(f".sunspin-store-{target.name}{PART}")


class RowStore:
    """An open store of `n_rows` rows in chunks of `chunk_rows`."""

    def __init__(
        self, path: Path, group: zarr.Group, wanted: Mapping[str, Any], chunk_rows: int
    ) -> None:
        self.path: Path = path
        self.chunk_rows: int = chunk_rows
        self.n_rows: int = wanted["rows"]
        self.n_chunks: int = -(-self.n_rows // chunk_rows)
        # zeros are results too: a chunk of them must be on disk like any other (minus zero would else lose its sign)
        with zarr.config.set({"array.write_empty_chunks": True}):
            self._arrays = {
                name: self._array(group, name, (self.n_rows, *shape), (chunk_rows, *shape), dtype)
                for name, (dtype, shape) in wanted["outputs"].items()
            }
            self._done = self._array(group, DONE, (self.n_chunks * RECORD,), (RECORD,), "uint8")
        self._left = np.full(self.n_chunks, chunk_rows)
        self._left[-1] = self.n_rows - (self.n_chunks - 1) * chunk_rows
        self.rows_kept: int = 0
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="sunspin-store")

    def close(self) -> None:
        """Wait until nothing is being written."""
        self._writer.shutdown(wait=True)

    def _array(
        self, group: zarr.Group, name: str, shape: tuple, chunks: tuple, dtype: str
    ) -> zarr.Array:
        chunks = tuple(max(size, 1) for size in chunks)
        names = [
            "row" if name != DONE else "record",
            *(f"{name}_{i}" for i in range(1, len(shape))),
        ]
        form: dict[str, Any] = {"shape": shape, "chunks": chunks, "dtype": dtype, "fill_value": 0}
        form |= {"compressors": None, "dimension_names": names}
        if not (self.path / name / "zarr.json").exists():  # new, or killed while it was made
            return group.create_array(name, **form)
        array = group[name]
        made, wanted = (
            part.metadata.to_dict() for part in (array, zarr.create_array(MemoryStore(), **form))
        )
        # the codecs too: a few bytes that somebody has changed could unpack to any size
        if not isinstance(array, zarr.Array) or any(
            made.get(key) != wanted.get(key) for key in FORM
        ):
            raise ValueError(f"{name} does not have the form the group says")
        return array

    def span(self, number: int) -> slice:
        """The rows of a chunk."""
        return slice(number * self.chunk_rows, min((number + 1) * self.chunk_rows, self.n_rows))

    def read_into(self, out: Values) -> list[Piece]:
        """Read what is done into `out`; return the ranges of rows that are not."""
        missing: list[Piece] = []
        self.rows_kept = 0
        for number in range(self.n_chunks):
            rows = self.span(number)
            if self._read(number, rows, out):
                self.rows_kept += rows.stop - rows.start
                self._left[number] = 0
            elif missing and missing[-1][1] == rows.start:
                missing[-1] = missing[-1][0], rows.stop
            else:
                missing.append((rows.start, rows.stop))
        return missing

    def _read(self, number: int, rows: slice, out: Values) -> bool:
        with suppress(*UNREADABLE):
            record = np.asarray(self._done[number * RECORD : (number + 1) * RECORD])
            if record.any():
                for name, array in self._arrays.items():
                    chunk = (
                        self.path
                        / name
                        / array.metadata.encode_chunk_key((number,) + (0,) * (array.ndim - 1))
                    )
                    if chunk.stat().st_size != math.prod(array.chunks) * array.dtype.itemsize:
                        return False
                    out[name][rows] = array[rows]
                return bytes.fromhex(self._digest(rows, out)) == record.tobytes()
        return False

    def _digest(self, rows: slice, out: Values) -> str:
        return bits(*(out[name][rows] for name in sorted(self._arrays)))

    def filled(self, start: int, stop: int, out: Values) -> None:
        """Rows start..stop of `out` are computed: write the chunks that this completes.

        A Ctrl-C meanwhile comes through when they are written, so that what is said to be kept is what is kept.
        """
        writing = self._writer.submit(self._fill, start, stop, out)
        try:
            writing.result()
        except KeyboardInterrupt:
            wait([writing])
            raise

    def _fill(self, start: int, stop: int, out: Values) -> None:
        for number in range(start // self.chunk_rows, -(-stop // self.chunk_rows)):
            rows = self.span(number)
            self._left[number] -= min(stop, rows.stop) - max(start, rows.start)
            if self._left[number] == 0:
                self._write(number, rows, out)
                self.rows_kept += rows.stop - rows.start

    def _write(self, number: int, rows: slice, out: Values) -> None:
        try:
            for name, array in self._arrays.items():
                array[rows] = out[name][rows]
            record = bytes.fromhex(self._digest(rows, out))
            self._done[number * RECORD : (number + 1) * RECORD] = np.frombuffer(
                record, dtype=np.uint8
            )
        except OSError as error:
            raise _cannot_write(self.path, error) from None

    def sweep(self) -> None:
        """Remove what a killed run had begun to write: beside a file of the store, whose names its arrays tell."""
        for array in (*self._arrays.values(), self._done):
            folder = self.path / array.basename
            keys = ((number,) + (0,) * (array.ndim - 1) for number in range(self.n_chunks))
            for file in ("zarr.json", *map(array.metadata.encode_chunk_key, keys)):
                temporary(folder / file).unlink(missing_ok=True)
        temporary(self.path / "zarr.json").unlink(missing_ok=True)


def _cannot_write(path: Path, error: OSError) -> OutputError:
    reason = error.strerror or str(error)
    what = f"the store cannot be written ({reason}); nothing that it holds is lost"
    return OutputError(
        sentence(
            what, do="free space and run the same command, or choose another store", where=str(path)
        )
    )


@contextmanager
def open_store(
    path: Any, function: RowFunction, chunk: int, out: Values
) -> Generator[tuple[RowStore, list[Piece]]]:
    """Open or make the store of a function's rows and read what it has into `out`; gives it and the ranges not yet done.

    Raises `InputError`, and changes nothing, where the path is something else, of other inputs, damaged or in use.
    """
    folder = Path(path)
    wanted = _wanted(function)
    found = _find(folder, wanted)
    if found is not None and not (missing := found.read_into(out)):
        yield found, missing
        return
    with _locked(folder):
        store = _find(folder, wanted, mend=True) or _create(folder, wanted, chunk)
        store.sweep()
        with closing(store):
            yield store, store.read_into(out)


def _wanted(function: RowFunction) -> dict[str, Any]:
    """The identity of a run, as it comes back from JSON."""
    outputs = {
        name: [np.dtype(dtype).str, list(shape)]
        for name, (dtype, shape) in function.outputs.items()
    }
    names = {DONE, "zarr.json"} & set(outputs) or [
        name for name in outputs if name.startswith((".", "__")) or "/" in name
    ]
    if names:
        raise InputError(
            sentence("an output of this name cannot be kept in a store", got=", ".join(names))
        )
    whole = {
        **function.identity(),
        "function": type(function).__name__,
        "rows": function.n_rows,
        "outputs": outputs,
    }
    return json.loads(json.dumps(plain(whole)))


def _find(folder: Path, wanted: Mapping[str, Any], mend: bool = False) -> RowStore | None:
    """The store at this place; None if there is room for a new one.

    A run killed while it made the store left out arrays: they are made now if the store is to be mended, else it counts as None.
    """
    where = str(folder)
    if not (folder / "zarr.json").is_file():
        _require_room(folder)
        return None
    damaged = InputError(
        sentence(
            "the store is damaged and cannot be resumed",
            do="choose another or remove it",
            where=where,
        )
    )
    if any(
        path.stat().st_size > MAX_METADATA_BYTES
        for path in (folder / "zarr.json", *folder.glob("*/zarr.json"))
    ):
        raise damaged
    try:
        group = zarr.open_group(Disk(folder), mode="r+", zarr_format=3)
        about = group.attrs.asdict().get(KEY)
    except UNREADABLE:
        raise damaged from None
    if about is None:
        raise InputError(
            sentence(
                "this Zarr group is not a store of sunspin", do="choose another folder", where=where
            )
        )
    if not isinstance(about, dict) or about.get("format") != FORMAT:
        raise InputError(
            sentence(
                "the store has a form that this version does not know",
                do="choose another folder",
                where=where,
            )
        )
    identity, chunk_rows = about.get("identity"), about.get("chunk_rows")
    if (
        not isinstance(identity, dict)
        or not isinstance(chunk_rows, int)
        or fingerprint(identity) != about.get("sha256")
    ):
        raise damaged
    if differs := sorted(
        key for key in {*identity, *wanted} if identity.get(key) != wanted.get(key)
    ):
        raise InputError(
            sentence(
                f"the store was made with other inputs, which differ in {', '.join(differs)}",
                do="give the same inputs or choose another folder",
                where=where,
            )
        )
    if not mend and not all(
        (folder / name / "zarr.json").exists() for name in (*wanted["outputs"], DONE)
    ):
        return None
    try:
        return RowStore(folder, group, wanted, chunk_rows)
    except UNREADABLE:
        raise damaged from None


def _require_room(folder: Path) -> None:
    """Refuse a file, and a folder with anything in it but the beginnings of a store."""
    try:
        if not folder.exists():
            return
        names = {entry.name for entry in folder.iterdir()} - {temporary(folder / "zarr.json").name}
        if DONE in names and {entry.name for entry in (folder / DONE).iterdir()} <= {LOCK}:
            names.remove(DONE)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(
            sentence(
                f"this cannot be a store ({reason})", do="give a new folder", where=str(folder)
            )
        ) from None
    if names:
        raise InputError(
            sentence(
                "the folder is not empty and not a store of sunspin",
                do="choose another folder",
                where=str(folder),
            )
        )


def _create(folder: Path, wanted: Mapping[str, Any], chunk: int) -> RowStore:
    chunk_rows = min(max(chunk, -(-wanted["rows"] // MAX_FILES)), wanted["rows"])
    about = {
        "format": FORMAT,
        "chunk_rows": chunk_rows,
        "sha256": fingerprint(wanted),
        "identity": wanted,
    }
    try:
        group = zarr.create_group(Disk(folder), zarr_format=3, attributes={KEY: about})
        return RowStore(folder, group, wanted, chunk_rows)
    except OSError as error:
        raise _cannot_write(folder, error) from None


@contextmanager
def _locked(folder: Path) -> Generator[None]:
    """Hold the store alone; the kernel lets go of it when the process ends, however it ends.

    The lock is inside an array's folder, where readers of the group do not take it for a part of the data.
    """
    try:
        make_folder(folder / DONE)
        lock = os.open(folder / DONE / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise _cannot_write(folder, error) from None
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(
                sentence(
                    "another run is writing to this store",
                    do="wait for it or choose another",
                    where=str(folder),
                )
            ) from None
        except OSError as error:
            raise _cannot_write(folder, error) from None
        yield
    finally:
        os.close(lock)
