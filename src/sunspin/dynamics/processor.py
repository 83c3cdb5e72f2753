"""Settings of the compiler numba, made before anything is compiled, and a cache of machine code that is never outdated.

**Processor.** numba determines the processor's features once per process, when the first function is decorated. On many processors
with 512-bit vectors LLVM uses only 256 bits unless told otherwise; the Philae scan takes 107 microseconds a motion with 512 bits
and 142 without. A processor that the user has chosen with numba's own environment variables is kept.

**Cache.** numba stores machine code next to the source, or in the user's cache, with the time stamp of *one* file: that of the
cached function. It does not notice changes of other files whose functions were compiled into it. Therefore only entry points, the
functions that Python calls, are cached. Each is a closure over the digest of all sources that it is compiled from: numba uses the
values that a closure holds as keys of its cache. An entry point is written as

    def _entry(sources: int):
        @cached("compiling ...")
        def run(...):
            _ = sources
            return advance(...)  # plain functions, `compiled` and not cached
        return run

    run = _entry(digest(__file__, another_module.__file__))

A function that is called from compiled code must not read environment variables: two processes would share its machine code.

The step of `rates` is not kept in this cache: :mod:`sunspin.dynamics.machine_code`.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
from numba import njit as njit
from numba import types
from numba.core import config as numba_config
from numba.core import event, registry
from numba.core.caching import FunctionCache

# its settings are made at run time, where no type checker sees them
config: Any = numba_config

_features = llvm.get_host_cpu_features()
if _features.get("avx512f") and not (config.CPU_NAME or config.CPU_FEATURES):
    _features["prefer-256-bit"] = False
    config.CPU_NAME = llvm.get_host_cpu_name()
    config.CPU_FEATURES = _features.flatten()

OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": {"contract"}}
"""Threads run side by side; a division by zero gives infinity; products and sums may be fused, nothing else is reordered."""

compiled = njit(**OPTIONS, no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""Decorator of functions that are called from compiled code only: they are compiled into their callers, and stored with them."""

_messages: dict[Any, str] = {}
"""For the Python function of each entry point the message that it is being compiled, until that is printed."""


def cached(message: str) -> Callable[[Callable[..., Any]], Any]:
    """Return the decorator of an entry point, whose machine code is stored on disk if numba can write.

    `message` is printed on standard error, once, if the function has to be compiled because no machine code is stored.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        _messages[function] = message
        entry: Any = njit(**OPTIONS)(function)
        # RuntimeError: neither the package's folder nor the user's cache can be written
        with suppress(RuntimeError):
            entry._cache = _StoredCode(function)
        return entry

    return decorate


def object_code(function: Callable[..., Any], arrays: str, sizes: int) -> tuple[str, bytes]:
    """Compile a function that needs neither Python nor numba at run time; return its name in the object code, and that code.

    Its arguments are addresses of `arrays`, a letter for each: "d" of float64, "i" of int64. Then come so many `sizes`, int64. It
    returns nothing, and may not create arrays, since numba's own library would have to count their references.
    """
    elements = {"d": types.float64, "i": types.int64}
    addresses = [types.CPointer(elements[letter]) for letter in arrays]
    signature = types.void(*addresses, *[types.int64] * sizes)
    alone = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "_nrt": False}
    entry: Any = njit(signature, **OPTIONS, **alone)(function)
    (result,) = entry.overloads.values()
    _, _, (code, _) = result.library.serialize_using_object_code()
    return result.fndesc.llvm_func_name, code


class _StoredCode(FunctionCache):
    """The machine code of an entry point on disk. An index that names a class which was renamed since counts as empty."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the machine code for a signature, or None if none is stored."""
        try:
            return super().load_overload(sig, target_context)
        except (AttributeError, ImportError):  # numba reads the index before it checks its age
            self.flush()
            return None


class _Announcement(event.Listener):
    """Print the message of an entry point when its compilation begins. Loading from the cache is no compilation."""

    def on_start(self, event: event.Event) -> None:
        """Print the message of the function that is being compiled, if it is an entry point."""
        function = getattr((event.data or {}).get("dispatcher"), "py_func", None)
        if message := _messages.pop(function, None):
            print(message, file=sys.stderr, flush=True)

    def on_end(self, event: event.Event) -> None:
        """Do nothing: numba requires this method."""


event.register("numba:compile", _Announcement())


def digest(*files: str | Path) -> int:
    """Return a hash of the content of source files, of this one, and of the versions that compile them (:func:`compiler`)."""
    content = hashlib.sha256(compiler().encode())
    for path in map(Path, (__file__, *files)):
        content.update(path.name.encode() + path.read_bytes())
    return int.from_bytes(content.digest()[:7], "big")  # numba takes integers of up to 64 bits


def compiler() -> str:
    """Return what machine code depends on besides its sources: Python, numba, architecture, processor, its features."""
    cpu_target: Any = registry.cpu_target
    processor = cpu_target.target_context.codegen().magic_tuple()
    return " ".join((str(sys.implementation.cache_tag), metadata.version("numba"), *processor))
