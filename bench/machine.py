"""The machine and the versions that a result belongs to."""

from __future__ import annotations

import os
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

from bench.timing import cores

LIBRARIES = ("sunspin", "numpy", "scipy", "numba", "llvmlite", "heyoka", "POT", "xarray")


def version_of(name: str) -> str | None:
    """Version of an installed distribution, None where it is not installed."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def cpu_model() -> str:
    """The processor's name as the system tells it."""
    try:
        for line in Path("/proc/cpuinfo").read_text("utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def memory_gb() -> float | None:
    """Physical memory in GB."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    except (AttributeError, ValueError, OSError):
        return None


def load_average() -> float | None:
    """Programs at work over the last minute: more than none at the start means that the results share the machine."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None


def description() -> dict[str, Any]:
    """Processor, cores, memory, system and versions."""
    return {
        "cpu": cpu_model(),
        "cores": cores(),
        "memory_GB": memory_gb(),
        "load_average": load_average(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "libraries": {name: version_of(name) for name in LIBRARIES},
    }


def line(what: dict[str, Any]) -> str:
    """The description in one line, for the head of the printed tables."""
    versions = ", ".join(
        f"{name} {version or 'not installed'}" for name, version in what["libraries"].items()
    )
    return f"{what['cpu']}, {what['cores']} cores, load {what['load_average'] or 0:.2g}; Python {what['python']}; {versions}"
