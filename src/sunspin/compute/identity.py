"""What a result depends on, as JSON: so that a store can tell whether it belongs to a run."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import lru_cache
from importlib import metadata, resources
from importlib.resources.abc import Traversable
from typing import Any

import numpy as np

PHYSICS = (
    "vehicle",
    "environment",
    "dynamics",
    "compute/compiler.py",
    "telemetry/sun.py",
    *(f"estimate/scan/{name}.py" for name in ("rows", "histogram", "mask", "metrics")),
)
"""Files and folders of the package whose text decides what a row gives."""

SMALL = 16
"""Arrays up to this size are written out, for people to read."""


def plain(value: Any) -> Any:
    """Data as JSON knows it: large arrays become their shape, type and SHA-256, small ones lists, data classes objects, without
    their fields `unsaid` where those say nothing: newer ones, whose absence keeps the identity that stored results have."""
    if is_dataclass(value) and not isinstance(value, type):
        beside, unsaid = (getattr(value, name, ()) for name in ("beside", "unsaid"))
        said = {
            field.name: getattr(value, field.name)
            for field in fields(value)
            if field.name not in beside
        }
        return {
            name: plain(item)
            for name, item in said.items()
            if name not in unsaid or isinstance(item, np.ndarray) or item
        }
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray) and value.size <= SMALL:
        return plain(value.tolist())
    if isinstance(value, np.ndarray):
        return {"dtype": str(value.dtype), "shape": list(value.shape), "sha256": bits(value)}
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, float) and not np.isfinite(value):
        return repr(value)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"no identity is known for {type(value).__name__}")


def bits(*arrays: np.ndarray) -> str:
    """SHA-256 over the bytes of arrays, as hexadecimal digits."""
    found = hashlib.sha256()
    for array in arrays:
        found.update(np.ascontiguousarray(array).view(np.uint8).data if array.size else b"")
    return found.hexdigest()


def fingerprint(identity: Mapping[str, Any]) -> str:
    """SHA-256 of an identity, whatever the order of its keys."""
    return hashlib.sha256(
        json.dumps(identity, sort_keys=True, separators=(",", ":")).encode()
    ).hexdigest()


@lru_cache(maxsize=8)
def code(*more: str) -> dict[str, str]:
    """Versions of sunspin and of the compiler, and the SHA-256 of the files that decide what a row gives: `PHYSICS` and `more`."""
    found, root = hashlib.sha256(), resources.files("sunspin")
    for name in PHYSICS + more:
        for path, file in _files(name, root.joinpath(name)):
            found.update(f"{path}\n".encode() + file.read_bytes())
    return {
        "sunspin": metadata.version("sunspin"),
        "physics_sha256": found.hexdigest(),
        "numba": metadata.version("numba"),
    }


def _files(path: str, place: Traversable) -> Iterator[tuple[str, Traversable]]:
    """The Python files at a place, those of folders in it included."""
    if not place.is_dir():
        yield path, place
        return
    for item in sorted(place.iterdir(), key=lambda item: item.name):
        if item.is_dir() or item.name.endswith(".py"):
            yield from _files(f"{path}/{item.name}", item)
