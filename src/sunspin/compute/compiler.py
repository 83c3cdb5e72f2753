"""numba, set up before anything is compiled with it. Whatever is compiled takes `njit` from here.

numba settles the processor's features for the whole process when the first function is decorated.
"""

from __future__ import annotations

from inspect import getsource
from types import ModuleType
from typing import Any

import llvmlite.binding as llvm
from numba import njit as njit
from numba.core import config as numba_config
from numba.core import registry

config: Any = numba_config  # its settings are made at run time: no type checker sees them
cpu_target: Any = registry.cpu_target


def _use_full_vectors() -> None:
    """Let LLVM use 512-bit vectors where the processor has them; its default for many of them is 256.

    Measured on the Philae scan: 107 against 142 microseconds a row. Not where the user has chosen a processor.
    """
    features = llvm.get_host_cpu_features()
    if features.get("avx512f") and not (config.CPU_NAME or config.CPU_FEATURES):
        features["prefer-256-bit"] = False
        config.CPU_NAME = llvm.get_host_cpu_name()
        config.CPU_FEATURES = features.flatten()


_use_full_vectors()


def compiled_with(*modules: ModuleType) -> Any:
    """A decorator that compiles functions which call compiled ones of `modules`, and keeps them until a file of these changes, too:
    of itself numba looks at a function's own file only."""
    texts = tuple(getsource(module) for module in modules)

    def made(function: Any) -> Any:
        kept: Any = njit(nogil=True, cache=True)(function)
        if hasattr(kept, "_cache"):  # numba may be told not to compile
            file = kept._cache._cache_file
            file._source_stamp = (file._source_stamp, texts)
        return kept

    return made


def target() -> tuple[str, str, str]:
    """What machine code is made for: architecture, processor, its features."""
    return cpu_target.target_context.codegen().magic_tuple()


def vector_bits() -> int:
    """Width in bits of the vectors that this process compiles for: 512 with AVX-512, 256 with AVX2, else 128 (SSE, NEON)."""
    features = set(target()[2].split(","))
    if {"+avx512f", "-prefer-256-bit"} <= features:
        return 512
    return 256 if "+avx2" in features else 128
