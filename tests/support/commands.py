"""The command line in this process: starting a process for each command would cost more than its work."""

from __future__ import annotations

import contextlib
from pathlib import Path

from validation import border
from validation.border import CommandResult


def sunspin(*arguments: object, cwd: str | Path = ".", code: int = 0) -> CommandResult:
    """Return what the entry point prints in the folder `cwd`, and assert its exit code and that nothing was raised."""
    with contextlib.chdir(cwd):
        told = border.sunspin(*map(str, arguments))
    assert told.code == code and not told.escaped, told
    return told
