"""Machine code of a compiled function, stored on disk and loaded without numba.

To import numba, and to restore a function from its cache, takes 0.5 s. That is a sixth of the time of a short `rates`, which calls
a single compiled function. llvmlite, the part of numba that runs machine code, loads that function in 0.03 s. numba is imported
only if the function must be compiled.

The file is named by a hash of all that the code depends on: sources, processor, versions. So outdated code is never loaded.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from importlib import metadata
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import llvmlite.binding as llvm
import numpy as np

from sunspin.base.atomic_write import make_folder, write_atomically

PACKAGE = Path(__file__).parent

_engines: list[Any] = []
"""What holds the machine code of the functions that were loaded, as long as this process lives."""


def compiled_function(
    name: str,
    sources: Sequence[str],
    arguments: tuple[int, int],
    compile_it: Callable[[], tuple[str, bytes]],
) -> Callable[..., Any]:
    """Load a function from its stored machine code; if there is none, compile it and store the code.

    Without a folder that can be written it is compiled in each process. The function releases Python's lock. Its `arguments`: how
    many addresses of arrays it takes, and then how many whole numbers. `sources`: the files of this package that it is compiled
    from. `compile_it` compiles it, and returns its name in the object code, and that code
    (:func:`sunspin.dynamics.processor.object_code`).
    """
    file = f"{name}-{_digest(sources)}.npz"
    loaded = next(filter(None, (_read(folder / file) for folder in _folders())), None)
    symbol, code = loaded or compile_it()
    if loaded is None:
        _store(file, symbol, code)
    # numba's convention: a function returns a status, and first takes two more addresses, for its result and its error. This one
    # has neither: the status is zero, and null is written to both.
    addresses, numbers = arguments
    kinds = [ctypes.c_void_p] * (2 + addresses) + [ctypes.c_int64] * numbers
    function = ctypes.CFUNCTYPE(ctypes.c_int32, *kinds)(_link(symbol, code))
    nothing = ctypes.pointer(ctypes.c_void_p())
    return partial(function, nothing, nothing)


def _digest(sources: Sequence[str]) -> str:
    """Return a hash of source files and of this one, of the processor, and of the compiler with its settings."""
    settings = [os.environ.get(f"NUMBA_{name}", "") for name in ("CPU_NAME", "CPU_FEATURES", "OPT")]
    features = llvm.get_host_cpu_features().flatten()
    processor = [platform.machine(), llvm.get_default_triple(), llvm.get_host_cpu_name(), features]
    versions = [metadata.version("numba"), metadata.version("llvmlite")]
    content = hashlib.sha256(" ".join([*processor, *versions, *settings]).encode())
    for source in (Path(__file__).name, *sources):
        content.update((PACKAGE / source).read_bytes())
    return content.hexdigest()[:16]


def _folders() -> Iterator[Path]:
    """Yield the folders for machine code, as numba has them: the one of NUMBA_CACHE_DIR, else beside this file, or the user's."""
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        yield Path(chosen)
        return
    yield PACKAGE / "__pycache__"
    with suppress(RuntimeError):  # no home
        yield Path.home() / ".cache" / "sunspin"


def _read(path: Path) -> tuple[str, bytes] | None:
    """Return the name of a function in its object code, and that code; None if there is no file, or not a whole one."""
    # RuntimeError: damaged bits say that the archive is encrypted, or of a version that Python does not know
    faults = (OSError, ValueError, KeyError, EOFError, BadZipFile, RuntimeError)
    with suppress(*faults), np.load(BytesIO(path.read_bytes())) as stored:
        return str(stored["symbol"]), stored["code"].tobytes()
    return None


def _store(file: str, symbol: str, code: bytes) -> None:
    """Store object code in the first folder that can be written, if there is one."""

    def write(path: Path) -> None:
        with path.open("wb") as part:
            np.savez(part, symbol=np.array(symbol), code=np.frombuffer(code, np.uint8))

    for folder in _folders():
        with suppress(OSError):
            make_folder(folder)
            write_atomically(folder / file, write)
            return


def _link(symbol: str, code: bytes) -> int:
    """Return the address of a function in this process after linking its object code."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine()
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    _engines.append(engine)
    return engine.get_function_address(symbol)
