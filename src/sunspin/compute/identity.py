"""What a result depends on, as JSON: so that a store can tell whether it belongs to a run."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

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


@lru_cache(maxsize=1)
def code() -> dict[str, str]:
    """Versions of sunspin and of the compiler, and the SHA-256 of the package's Python files."""
    digest, root = hashlib.sha256(), Path(__file__).parents[1]
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return {
        "sunspin": metadata.version("sunspin"),
        "code_sha256": digest.hexdigest(),
        "numba": metadata.version("numba"),
    }
