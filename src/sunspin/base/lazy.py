"""Modules that are imported when one of their attributes is first used.

Parts of SciPy take longer to import than a small scan takes to run.
"""

from __future__ import annotations

from importlib import import_module
from types import ModuleType
from typing import Any


class lazy(ModuleType):
    """A stand-in for the module of this name, which is imported at its first use. Type checkers see the real import."""

    def __getattr__(self, name: str) -> Any:
        return getattr(import_module(self.__name__), name)
