"""Modules that are imported when something in them is first used: SymPy, heyoka and parts of SciPy take longer to import than a
small scan takes to run."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType
from typing import Any


class lazy(ModuleType):
    """The module of this name, imported at its first use; type checkers are given the import itself."""

    def __getattr__(self, name: str) -> Any:
        return getattr(import_module(self.__name__), name)
