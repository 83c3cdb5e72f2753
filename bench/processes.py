"""Fresh processes, timed from outside."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]


def call(*arguments: str, cache: str | None = None) -> tuple[float, str]:
    """Wall time in s and output of ``python ARGUMENTS``, with the kernels' cache in a folder of its own if named."""
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = os.environ | {"PYTHONPATH": path} | ({"SUNSPIN_CACHE": cache} if cache else {})
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, *arguments], env=environment, capture_output=True, text=True
    )
    seconds = time.perf_counter() - start
    if done.returncode != 0:
        raise RuntimeError(f"python {' '.join(arguments)} failed:\n{done.stderr}")
    return seconds, done.stdout


def child(*arguments: str, cache: str | None = None) -> tuple[float, dict]:
    """Wall time in s and what `bench.child` tells."""
    seconds, output = call("-m", "bench.child", *arguments, cache=cache)
    return seconds, json.loads(output)
