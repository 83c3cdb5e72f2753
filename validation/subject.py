"""Which estimation package is judged: the one place that says it.

Campaigns take what they judge from here. A process judges one package; its workers are told which when they start.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

ROOMS = {"estimate": "sunspin.estimate.rates.estimate", "estimation": "sunspin.estimation.rates"}
"""Packages that can be judged -> the module of each that has the function `rates`."""

_judged = ["estimate"]
"""The package that this process judges."""


def judge_room(room: str) -> None:
    """Judge this package from now on in this process."""
    if room not in ROOMS:
        raise ValueError(f"no such package: {room}; one of {', '.join(ROOMS)}")
    _judged[0] = room


def room() -> str:
    """Return the package that this process judges."""
    return _judged[0]


def rates(*arguments: Any, **options: Any) -> Any:
    """Estimate rates with the package that is judged."""
    run: Callable[..., Any] = import_module(ROOMS[room()]).rates
    return run(*arguments, **options)
