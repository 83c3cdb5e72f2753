"""Compiled kernels: generated source in a module named by the hash of that source.

numba's disk cache keys a function by its file and its time stamp and does not notice changes in what it inlines from
elsewhere. A module whose name is the hash of everything in it can be cached for good: an edit to the physics is another
module.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
import tempfile
import threading
from enum import IntEnum
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from types import ModuleType

import llvmlite.binding as llvm
import numba

from sunspin.motion import codegen as c

_lock = threading.Lock()


class Outcome(IntEnum):
    """How a row ended; the text is in `OUTCOME_TEXT`."""

    FINE = 0
    CHATTERS = 1
    PAST_UNKNOWN = 2
    NOT_FINITE = 3


OUTCOME_TEXT = {
    Outcome.FINE: "computed as asked",
    Outcome.CHATTERS: "a wheel stops and starts too often to be followed",
    Outcome.PAST_UNKNOWN: "running backward, a wheel comes to rest: its past is not determined",
    Outcome.NOT_FINITE: "the motion left the range of numbers",
}


def _use_full_vectors() -> None:
    """Let LLVM use 512-bit vectors where the processor has them; its default for many of them is 256.

    Measured on the Philae scan: 107 against 142 microseconds a row. Only before numba has set up its compiler, and not
    where the user has chosen a processor.
    """
    features = llvm.get_host_cpu_features()
    if features.get("avx512f") and not (numba.config.CPU_NAME or numba.config.CPU_FEATURES):
        features["prefer-256-bit"] = False
        numba.config.CPU_NAME = llvm.get_host_cpu_name()
        numba.config.CPU_FEATURES = features.flatten()


_use_full_vectors()


def source(structure: c.Structure) -> str:
    """The complete source of the kernel for this structure."""
    rows = c.Rows(len(structure.axes))
    text = Path(__file__).with_name("kernel_template.py").read_text(encoding="utf-8")
    constants = {
        "LANES": structure.lanes,
        "N_WHEELS": rows.n_wheels,
        "N_STATE": rows.n_state,
        "ROWS": rows.count,
        "NEW": rows.new,
        "DT": rows.dt,
        "INVERSE": rows.inverse,
        "WHEEL": rows.wheel(0),
        "PER_WHEEL": len(c.WHEEL_ROWS),
        "BINS": structure.bins,
        "SAMPLES": structure.samples,
        **{name.upper(): offset for offset, name in enumerate(c.WHEEL_ROWS)},
        **{outcome.name: int(outcome) for outcome in Outcome},
    }
    for name, value in constants.items():
        text = text.replace(f'{name} = "{name}"', f"{name} = {value}")
    bodies = {
        "        pass  # STEP_LANES": c.step_body(structure, structure.lanes),
        "        pass  # START_LANES": c.start_body(structure, structure.lanes) if structure.bins else [],
        "        pass  # SAMPLE_LANES": c.sample_body(structure, structure.lanes) if structure.bins else [],
        "        pass  # OBSERVE_LANES": c.observe_body(structure, structure.lanes),
        "    pass  # STEP_ONE": c.step_body(structure, 1),
        "    pass  # OBSERVE_ONE": c.observe_body(structure, 1),
        "    pass  # OMEGA_ONE": c.omega_body(structure),
    }
    for marker, lines in bodies.items():
        indent = marker[: len(marker) - len(marker.lstrip())]
        text = text.replace(marker, "\n".join(indent + line for line in lines) or f"{indent}pass")
    return text


def cache_folder() -> Path:
    """Where generated modules and their machine code are kept: the user's cache, or a private temporary folder."""
    base = os.environ.get("SUNSPIN_CACHE") or os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    folder = Path(base) / "sunspin" / "kernels"
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        if os.access(folder, os.W_OK):
            return folder
    except OSError:
        pass
    return _private_folder()


@lru_cache(maxsize=1)
def _private_folder() -> Path:
    return Path(tempfile.mkdtemp(prefix="sunspin-kernels-"))


@lru_cache(maxsize=32)
def kernel(structure: c.Structure) -> ModuleType:
    """The module with the compiled functions `run` and `emd_rows` for this structure."""
    text = source(structure)
    key = f"{metadata.version('numba')}\n{text}"
    name = f"sunspin_kernel_{hashlib.sha256(key.encode()).hexdigest()[:24]}"
    with _lock:
        if name in sys.modules:
            return sys.modules[name]
        path = cache_folder() / f"{name}.py"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            part = path.with_suffix(f".{os.getpid()}.part")
            part.write_text(text, encoding="utf-8")
            os.replace(part, path)
        spec = importlib.util.spec_from_file_location(name, path)
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
        return module
