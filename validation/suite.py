"""What the suites of hostile cases share: a home for their files, and limits."""

from __future__ import annotations

import os
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Self

from validation.pool import Verdict, limit_memory

MORE_MEMORY = 2 * 1024**3
"""Bytes of address space that a case may take beyond what the imports took."""


class Suite:
    """Case number -> verdict. A context, as it makes files; `last` says what the last case was."""

    last: object = ""

    def __init__(
        self, seed: int = 0, memory: int | None = MORE_MEMORY, only: str | None = None
    ) -> None:
        self.seed, self.memory, self.only = seed, memory, only

    def __enter__(self) -> Self:
        self.stack = ExitStack()
        self.home = Path(
            self.stack.enter_context(tempfile.TemporaryDirectory(prefix="validation-"))
        )
        self.stack.callback(os.chdir, os.getcwd())
        self.prepare()
        if self.memory is not None:
            limit_memory(self.memory)
        return self

    def __exit__(self, *exception: object) -> None:
        self.stack.close()

    def prepare(self) -> None:
        """Make what all cases share; undone by `stack`."""
        raise NotImplementedError

    def __call__(self, index: int) -> Verdict:
        """Run one case."""
        raise NotImplementedError
