"""numba, set up before anything is compiled with it: whatever is compiled takes `njit` from here.

numba settles the processor's features for the whole process when the first function is decorated. LLVM uses 256-bit vectors on
many processors that have 512-bit ones; the Philae scan takes 107 microseconds a row with these and 142 without. A processor that
the user has chosen stays.
"""

from __future__ import annotations

import sys
from importlib import metadata
from typing import Any

import llvmlite.binding as llvm
from numba import njit as njit
from numba.core import config as numba_config
from numba.core import registry

config: Any = numba_config  # made at run time: no type checker sees its settings

_features = llvm.get_host_cpu_features()
if _features.get("avx512f") and not (config.CPU_NAME or config.CPU_FEATURES):
    _features["prefer-256-bit"] = False
    config.CPU_NAME = llvm.get_host_cpu_name()
    config.CPU_FEATURES = _features.flatten()


def compiler() -> str:
    """What machine code is made by and for: Python, numba, architecture, processor, its features."""
    cpu_target: Any = registry.cpu_target
    made_for = cpu_target.target_context.codegen().magic_tuple()
    return " ".join((str(sys.implementation.cache_tag), metadata.version("numba"), *made_for))
