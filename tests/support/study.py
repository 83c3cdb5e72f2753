"""The study of Philae without some of its steps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from sunspin.philae.steps import Steps


def leave_out(patch: pytest.MonkeyPatch, *keys: str) -> None:
    """Replace the steps with these keys by ones that have neither result nor rows."""
    run = Steps.run

    def run_others(
        self: Steps, key: str, title: str, compute: Callable[[], Any], *rows: Any, **about: Any
    ) -> Any:
        if key in keys:
            return run(self, key, title, lambda: None)
        return run(self, key, title, compute, *rows, **about)

    patch.setattr(Steps, "run", run_others)
