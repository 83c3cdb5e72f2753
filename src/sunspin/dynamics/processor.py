"""numba, set up before anything is compiled with it, and the rule by which its cache never serves outdated code.

**Processor.** numba settles the processor's features for the whole process when the first function is decorated. LLVM uses
256-bit vectors on many processors that have 512-bit ones; the Philae scan takes 107 microseconds a motion with these and 142
without. A processor that the user has chosen with numba's own variables stays.

**Cache.** numba keeps machine code beside the source, or in the user's cache, under the time stamp of *one* file: that of the
cached function. It does not notice that another file changed whose functions were compiled into it. Therefore only entry points
are cached, and each is a closure over the digest of all sources that it is compiled from: numba counts what a closure holds
among the keys of its cache. An entry point is written as

    def _entry(sources: int):
        @cached
        def run(...):
            _ = sources
            return advance(...)  # plain functions, `compiled` and not cached
        return run

    run = _entry(digest(__file__, another_module.__file__))

A function that is called from compiled code must not read environment variables: two processes would share its machine code.
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
from numba.core import config as numba_config
from numba.core import event, registry
from numba.core.caching import FunctionCache

config: Any = numba_config  # its settings are made at run time, where no type checker sees them

_features = llvm.get_host_cpu_features()
if _features.get("avx512f") and not (config.CPU_NAME or config.CPU_FEATURES):
    _features["prefer-256-bit"] = False
    config.CPU_NAME = llvm.get_host_cpu_name()
    config.CPU_FEATURES = _features.flatten()

OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": {"contract"}}
"""Threads run side by side; a division by zero gives infinity; products and sums may be fused, nothing else is reordered."""

compiled = njit(**OPTIONS, no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""Decorator of what is called from compiled code: it is compiled into its callers, and kept with them."""

_announced: dict[Any, str] = {}
"""Entry points by their Python function, with the sentence that says what is being compiled."""


def cached(message: str) -> Callable[[Callable[..., Any]], Any]:
    """Return the decorator of an entry point: kept on disk where numba can write.

    `message` is printed on standard error, once, if the function has to be compiled because no machine code is kept.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        _announced[function] = message
        entry: Any = njit(**OPTIONS)(function)
        # an error says that neither the package's folder nor the user's cache can be written
        with suppress(RuntimeError):
            entry._cache = _KeptCode(function)
        return entry

    return decorate


class _KeptCode(FunctionCache):
    """The machine code of an entry point on disk. An index that names a class which was renamed since counts as empty."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the machine code for a signature, or None if none is kept."""
        try:
            return super().load_overload(sig, target_context)
        except (AttributeError, ImportError):  # numba reads the index before it asks how old it is
            self.flush()
            return None


class _Announcement(event.Listener):
    """Print the message of an entry point as its compilation begins; code that is loaded from the cache begins none."""

    def on_start(self, event: event.Event) -> None:
        function = getattr((event.data or {}).get("dispatcher"), "py_func", None)
        if message := _announced.pop(function, None):
            print(message, file=sys.stderr, flush=True)

    def on_end(self, event: event.Event) -> None:
        """Do nothing."""


event.register("numba:compile", _Announcement())


def digest(*files: str | Path) -> int:
    """Return a number that stands for the content of source files, of this one, and of the packages that compile them."""
    content = hashlib.sha256(compiler().encode())
    for path in map(Path, (__file__, *files)):
        content.update(path.name.encode() + path.read_bytes())
    return int.from_bytes(content.digest()[:7], "big")  # numba takes integers of up to 64 bits


def compiler() -> str:
    """Return what machine code is made by and for: Python, numba, architecture, processor, its features."""
    cpu_target: Any = registry.cpu_target
    made_for = cpu_target.target_context.codegen().magic_tuple()
    return " ".join((str(sys.implementation.cache_tag), metadata.version("numba"), *made_for))
