"""Kernels are compiled in processes of their own, before they are needed where that is known.

Compilation takes ten to twenty seconds of one core for each structure, and numba compiles one function at a time in a process;
the disk cache carries the machine code over.
"""

from __future__ import annotations

import atexit
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType
from typing import IO

import numpy as np

from sunspin.base.atomic_write import ensure_writable, lock_file
from sunspin.base.errors import OutputError
from sunspin.dynamics.ensemble import codegen as c
from sunspin.dynamics.ensemble.compiled import kernel, lasting_folder, loaded

_lock = threading.Lock()
_over = threading.Event()
_under_way: dict[Path, subprocess.Popen] = {}
_ready: set[Path] = set()
"""Modules known to be on disk with their machine code: a kernel is asked for before every piece of a run."""

POLL_S = 0.05

WAIT_S = 120.0
"""Another process that has not compiled a kernel in this time is stopped or starved."""


def compile_ahead(structures: Iterable[c.Structure]) -> None:
    """Begin to compile the kernels of these structures that this machine has not kept, in the order given; returns at once."""
    if (os.cpu_count() or 1) > 1:
        _begin([_path(kernel(structure)) for structure in structures])


def compile_all(structures: Iterable[c.Structure]) -> Path:
    """Compile the kernels of these structures, two at a time, and return the folder that keeps them; `OutputError` if none does."""
    todo, folder = list(dict.fromkeys(structures)), lasting_folder()
    if not ensure_writable(folder):
        do = "set SUNSPIN_CACHE to a folder that can be written"
        raise OutputError("compiled kernels cannot be kept here", do=do, where=str(folder))
    for some in (todo[::2], todo[1::2]):
        compile_ahead(some)
    missing = [structure for structure in todo if not is_kept(_path(ready_kernel(structure)))]
    if missing:
        what = f"{len(missing)} of {len(todo)} kernels could not be compiled or kept"
        raise OutputError(what, do="see whether the disk is full", where=str(folder))
    return folder


def _begin(paths: list[Path]) -> None:
    with _lock:
        todo = [path for path in paths if path not in _under_way and not is_kept(path)]
        if not todo or not sys.executable:
            return
        if not _under_way:  # called before Python waits for threads, which may wait for a kernel
            getattr(threading, "_register_atexit", atexit.register)(_stop)
        nothing = subprocess.DEVNULL
        try:
            code = f"from {__name__} import main; main()"
            command = [sys.executable, "-c", code, *map(str, todo)]
            process = subprocess.Popen(command, stdin=nothing, stdout=nothing, stderr=nothing)
        except OSError:
            return  # then they are compiled here, when they are needed
        _under_way.update(dict.fromkeys(todo, process))


def _stop() -> None:
    """As this process ends, after Ctrl-C perhaps: the kernels are not wanted any more."""
    _over.set()
    for process in set(_under_way.values()):
        process.kill()
        process.wait()


def ready_kernel(structure: c.Structure) -> ModuleType:
    """The module with the compiled function `run` for this structure; waits until another process has compiled it."""
    module = kernel(structure)
    path = _path(module)
    if path not in _ready:
        _begin([path])
        process = _under_way.get(path)
        while process is not None and process.poll() is None and not is_kept(path):
            time.sleep(POLL_S)
        if _over.is_set():
            raise RuntimeError("the process ends")
        _ready.add(path)
    return module


def is_kept(path: Path) -> bool:
    """Whether the machine code of a generated module is on disk (numba writes it whole or not at all, the entry last)."""
    return any((path.parent / "__pycache__").glob(f"{path.stem}.run-*.nbc"))


def _path(module: ModuleType) -> Path:
    return Path(str(module.__file__))


def main() -> None:
    """In the other process: compile the generated modules at these paths, each unless another process does so by now."""
    for path in map(Path, sys.argv[1:]):
        with open(path, "rb") as file:
            _wait_for_others(file)
            if not is_kept(path):
                compile_run(loaded(path.stem, path))


def _wait_for_others(file: IO) -> None:
    """Lock a generated module until its file is closed, or go on after a while: a second compilation costs time only."""
    end = time.monotonic() + WAIT_S
    while time.monotonic() < end:
        try:
            lock_file(file)
            return
        except BlockingIOError:
            time.sleep(POLL_S)
        except OSError:
            return


def compile_run(module: ModuleType) -> None:
    """Compile the entry of a generated module for the types of `run.launch`."""
    real, whole, single = (np.zeros(0, dtype) for dtype in (np.float64, np.int64, np.float32))
    plane, table, hist = np.zeros((0, 0)), np.zeros((0, 0, 0)), np.zeros((0, 0), np.float32)
    module.run(plane, whole, table, single, whole, real, whole, hist, table, whole, real)
