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


def to_json(value: Any) -> Any:
    """Data as JSON knows it: large arrays as their shape, type and SHA-256, data classes as the fields that they are made from."""
    if is_dataclass(value) and not isinstance(value, type):
        return {x.name: to_json(getattr(value, x.name)) for x in fields(value) if x.init}
    if isinstance(value, Mapping):
        return {str(key): to_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(item) for item in value]
    if hasattr(value, "__array__"):
        array = np.asarray(value)
        if array.size <= 16:  # written out, for people to read
            return to_json(array.tolist())
        digest = hashlib.sha256(np.ascontiguousarray(array).view(np.uint8).data).hexdigest()
        return {"dtype": str(array.dtype), "shape": list(array.shape), "sha256": digest}
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, float) and not np.isfinite(value):
        return repr(value)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"no identity is known for {type(value).__name__}")


def fingerprint(value: Any) -> str:
    """SHA-256 of data, whatever the order of keys."""
    text = json.dumps(to_json(value), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


@lru_cache(maxsize=1)
def code_identity() -> dict[str, str]:
    """Versions of sunspin and of the compiler, and the SHA-256 of the package's Python files."""
    digest, root = hashlib.sha256(), Path(__file__).parents[1]
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    versions = {name: metadata.version(name) for name in ("sunspin", "numba")}
    return versions | {"code_sha256": digest.hexdigest()}
