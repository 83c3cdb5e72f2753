"""Modules that are imported when something in them is first used: SymPy, heyoka and parts of SciPy take longer to import than a
small scan takes to run; and modules of ours that follow the import of another one."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any


class _Lazy(ModuleType):
    def __getattr__(self, name: str) -> Any:
        return getattr(import_module(self.__name__), name)


def lazy(name: str) -> ModuleType:
    """The module of this name, imported at its first use; type checkers are given the import itself."""
    return _Lazy(name)


class _Follower(MetaPathFinder):
    """Finds the module `first` as the other finders do, and imports `then` once it has been executed."""

    def __init__(self, first: str, then: str) -> None:
        self.first, self.then = first, then

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        if fullname != self.first:
            return None
        others = (
            finder.find_spec(fullname, path, target)
            for finder in sys.meta_path
            if finder is not self
        )
        spec = next((one for one in others if one is not None), None)
        if spec is not None and spec.loader is not None:
            execute, loader = spec.loader.exec_module, spec.loader

            def exec_module(module: ModuleType) -> None:
                execute(module)
                if self in sys.meta_path:
                    sys.meta_path.remove(self)
                import_module(self.then)

            loader.exec_module = exec_module  # of this loader alone: each import makes its own
        return spec


def import_after(first: str, then: str) -> None:
    """Import the module `then` as soon as `first` has been imported by anybody: now, if it is there already."""
    if first in sys.modules:
        import_module(then)
    else:
        sys.meta_path.insert(0, _Follower(first, then))
