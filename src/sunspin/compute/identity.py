"""Identity of a result, as JSON and hash of everything it depends on: a store uses it to recognise its own run."""

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
    """Return data as JSON types.

    Dataclasses become the fields that they are constructed from; arrays of more than 16 elements become shape, type and
    SHA-256. Raises TypeError for other types.
    """
    if is_dataclass(value) and not isinstance(value, type):
        return {x.name: to_json(getattr(value, x.name)) for x in fields(value) if x.init}
    if isinstance(value, Mapping):
        return {str(key): to_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(item) for item in value]
    if hasattr(value, "__array__"):
        array = np.asarray(value)
        if array.size <= 16:  # small arrays stay readable
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
    """Return the SHA-256 of data, independent of the order of keys."""
    text = json.dumps(to_json(value), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


@lru_cache(maxsize=1)
def code_identity() -> dict[str, str]:
    """Return the versions of sunspin and of the compiler, and the SHA-256 of the package's Python files."""
    digest, root = hashlib.sha256(), Path(__file__).parents[1]
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    versions = {name: metadata.version(name) for name in ("sunspin", "numba")}
    return versions | {"code_sha256": digest.hexdigest()}
