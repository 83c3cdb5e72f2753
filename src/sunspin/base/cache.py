"""Folders of a user's cache."""

from __future__ import annotations

import os
from pathlib import Path


def is_writable(folder: Path) -> bool:
    """Make a folder, for this user alone, where it is not there yet; whether files can be written into it."""
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    except OSError:
        return False
    return os.access(folder, os.W_OK)
