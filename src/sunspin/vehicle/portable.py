"""How the frozen parts of a vehicle are copied and sent to other processes."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

import numpy as np


class Portable:
    """Copies and pickles as plain data, bit by bit: vectors are not normalised again, and stay read-only as mappings do."""

    def __getstate__(self) -> dict[str, Any]:
        return {key: dict(value) if isinstance(value, MappingProxyType) else value for key, value in vars(self).items()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for key, value in state.items():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
            vars(self)[key] = MappingProxyType(value) if isinstance(value, dict) else value
