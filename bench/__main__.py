"""Run the five benchmarks, or those that are named, and print their tables: ``python -m bench``."""

from __future__ import annotations

import argparse
import os
import platform
from collections.abc import Sequence
from importlib import import_module, metadata

from bench.timing import cores

NAMES = ("start", "scan", "emd", "accuracy", "kernels")
"""Fresh processes first, before this one has filled caches and warmed the processor."""

LIBRARIES = ("numpy", "scipy", "numba", "heyoka")


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the machine, the versions of the libraries and the tables of the benchmarks."""
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small sizes and few repeats")
    parser.add_argument("--only", choices=NAMES, action="append", help="repeatable")
    options = parser.parse_args(arguments)
    load = f"load {os.getloadavg()[0]:.2g}" if hasattr(os, "getloadavg") else "load not known"
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in LIBRARIES)
    print(f"{platform.machine()}, {cores()} cores, {load}; {versions}", flush=True)
    for name in options.only or NAMES:
        print(f"\n{import_module(f'bench.{name}').run(options.quick).text()}", flush=True)


if __name__ == "__main__":
    main()
