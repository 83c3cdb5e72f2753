"""The form of a result, which output and the paper's study read by a stored list."""

from __future__ import annotations

from typing import Any

import xarray as xr

KINDS = {str: "text", int: "integer", float: "number", list: "list"}


def schema(result: xr.Dataset | xr.DataTree) -> dict[str, Any]:
    """Return dimensions, kind and attributes of each variable, and the kind of each attribute."""
    return {
        "variables": {
            str(name): {
                "dims": list(part.dims),
                "kind": part.dtype.kind,
                "attrs": {key: str(value) for key, value in sorted(part.attrs.items())},
            }
            for name, part in sorted(result.variables.items())
        },
        "attrs": {
            name: next(word for kind, word in KINDS.items() if isinstance(value, kind))
            for name, value in sorted(result.attrs.items())
        },
    }
