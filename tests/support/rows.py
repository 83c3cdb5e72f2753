"""Row functions for tests of the engine, in a module of their own so that other processes can import them."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

import sunspin

PATHS = Path(sunspin.__file__).parents[1], Path(__file__).parents[2]
ELSEWHERE = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, PATHS))}
"""The environment of other processes, which find this module and the package under test."""


def heed_interrupts() -> None:
    """Restore the usual reaction to Ctrl-C and hang-ups, which a process started in the background or under nohup ignores."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


@dataclass(frozen=True, init=False)
class Waves:
    """Cheap rows with results of several kinds and shapes; some are minus zero, infinite or not a number."""

    n_rows: int
    pitch: float

    outputs: ClassVar = {"height": ("float64", ()), "kind": ("int8", ())}
    outputs["path"] = "float32", (2, 3)

    def __init__(self, n_rows=1000, pitch=0.37, seconds_per_row=0.0, bad_row=-1, log=None):
        """The last three change no row and are no fields."""
        self.__dict__.update(n_rows=n_rows, pitch=pitch, bad_row=bad_row, log=log)
        self.__dict__.update(seconds_per_row=seconds_per_row)

    def __call__(self, index):
        if self.bad_row in index:
            raise ArithmeticError(f"row {self.bad_row} is bad")
        time.sleep(self.seconds_per_row * len(index))
        if self.log is not None:
            with open(self.log, "a") as file:
                file.write("".join(f"{row}\n" for row in index))
        height = np.sin(index * self.pitch) * (index + 1.0)
        height[index % 7 == 0] = -0.0
        height[index % 11 == 3] = np.nan
        height[index % 13 == 5] = np.inf
        path = (index[:, None, None] * np.ones((2, 3)) * self.pitch).astype(np.float32)
        return {"height": height, "kind": (index % 5).astype(np.int8), "path": path}


def same(values, wanted) -> bool:
    """Return whether results are the wanted ones, to 1e-9 and of the same types."""
    return set(values) == set(wanted) and all(
        values[name].dtype == array.dtype
        and np.allclose(values[name], array, rtol=1e-9, atol=0, equal_nan=True)
        for name, array in wanted.items()
    )
