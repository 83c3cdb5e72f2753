"""The same kernels on an NVIDIA GPU, by numba-cuda: one thread runs one trajectory.

The text is the processor's, generated for a single lane: the equations, the events and the order of the operations are the same,
and so are the steps. Only what a GPU does not have is put in other words (`SUBSTITUTIONS`), and the entry is cuda_template.py.
Bits differ from the processor's, which contracts other products and sums and has other sines.
"""

from __future__ import annotations

import importlib.util
import re
import threading
import warnings
from functools import lru_cache
from importlib import metadata
from types import ModuleType
from typing import Any

import numpy as np

from sunspin.base.errors import InputError, sentence
from sunspin.dynamics.ensemble import codegen as c
from sunspin.dynamics.ensemble.compiled import module_of, source, template

DEVICES = ("cpu", "cuda")

THREADS = 64
"""Threads of a block: few, since one thread needs many registers."""

SUBSTITUTIONS = (
    (r"^from sunspin\.compute\.compiler import njit$", "from numba import cuda"),
    (r"^(jit|estimate) = njit\(.*$", r"\1 = cuda.jit(device=True)"),
    # scratch of a thread; no array is empty, and none is made while the kernel runs
    (r"np\.empty\((.+)\)$", r"cuda.local.array(\1, np.float64)"),
    (r"np\.isfinite\(", "math.isfinite("),
)
"""Patterns of the processor's text, each of which must be found, and what stands on the GPU in their place."""

Group = tuple[np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]
"""Numbers of rows with the same plan, and its segments: steps, their lengths (s), outputs due."""

_lock = threading.Lock()


def check_device(device: str) -> str:
    """The device by its name; `InputError` for another than `DEVICES`."""
    if device not in DEVICES:
        raise InputError(sentence('device must be "cpu" or "cuda"', got=device))
    return device


def require_device(device: str) -> None:
    """`InputError` where this machine lacks what the device needs."""
    if check_device(device) == "cpu":
        return
    if importlib.util.find_spec("numba_cuda") is None:
        raise InputError(
            sentence(
                'device "cuda" needs numba-cuda, which is not installed',
                do='pip install "sunspin[gpu]"',
            )
        )
    if not _is_available():
        raise InputError(
            sentence(
                'device "cuda" needs an NVIDIA GPU with its driver, and the CUDA libraries of pip install "sunspin[gpu]"',
                got="none that works here",
                do='use device "cpu"',
            )
        )


@lru_cache(maxsize=1)
def _is_available() -> bool:
    from numba import cuda

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what is missing is told in one sentence
        return bool(cuda.is_available())


def device_identity(device: str) -> dict[str, str]:
    """What the bits of a row depend on by the choice of the device, as JSON knows it."""
    if check_device(device) == "cpu" or importlib.util.find_spec("numba_cuda") is None:
        return {"device": device}
    return {"device": device, "numba_cuda": metadata.version("numba-cuda")}


def cuda_source(structure: c.Structure) -> str:
    """The complete source of the kernel for this structure on a GPU."""
    text, found, _ = source(structure, lanes=1).partition("\n\n\n@jit\ndef run(")
    if not found:
        raise RuntimeError("the driver has no entry to replace")
    # a vehicle without wheels has scratch for them that is never used
    text = text.replace("np.empty(N_WHEELS)", f"np.empty({max(len(structure.axes), 1)})")
    for pattern, replacement in SUBSTITUTIONS:
        text, count = re.subn(pattern, replacement, text, flags=re.MULTILINE)
        if not count:
            raise RuntimeError(f"the driver has nothing like {pattern}")
    return f"{text}\n\n\n{template('cuda')}"


@lru_cache(maxsize=32)
def cuda_kernel(structure: c.Structure) -> ModuleType:
    """The module with the kernel `run` for this structure; it is compiled when it is first launched."""
    return module_of(
        cuda_source(structure), f"{metadata.version('numba')} {metadata.version('numba-cuda')}"
    )


def launch(
    structure: c.Structure,
    work: np.ndarray,
    groups: list[Group],
    modes: np.ndarray,
    normals: np.ndarray,
    result: Any,
) -> None:
    """Run groups of rows of `work` (n, ROWS) and put what they give into `result`, as the processor's `run` does.

    Neighbouring threads have the same plan, so that a warp takes its steps together. One launch at a time: the memory of the
    GPU holds the rows of one call, whatever the number of threads of the caller.
    """
    from numba import cuda

    index = np.concatenate([rows for rows, _ in groups])
    plans = np.repeat(np.arange(len(groups)), [len(rows) for rows, _ in groups])
    begins = np.cumsum([0, *(len(steps) for _, (steps, _, _) in groups)])
    parts = [
        np.concatenate(column) for column in zip(*(segments for _, segments in groups), strict=True)
    ]
    n, run = len(index), cuda_kernel(structure).run
    given = [
        work[index],
        plans,
        begins,
        modes,
        normals if normals.size else np.zeros(1, np.float32),
        *parts,
    ]
    taken = [result.hist, result.track, result.outcome, result.evenness]
    with _lock, warnings.catch_warnings():
        warnings.filterwarnings(
            "ignore", message="(?s).*Grid size"
        )  # few rows do not fill a GPU, and that is all right
        arrays = [cuda.to_device(np.ascontiguousarray(array)) for array in given]
        room = [cuda.device_array((n, *array.shape[1:]), array.dtype) for array in taken]
        run[(n + THREADS - 1) // THREADS, THREADS](*arrays, *room)
        for array, values in zip(taken, room, strict=True):
            if array.size:
                array[index] = values.copy_to_host()
