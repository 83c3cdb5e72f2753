"""Philae after the collision, all of it: sections 3.3 (:mod:`collision`) and 4 (:mod:`strategies`) on the same candidates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sunspin.philae import collision, strategies
from sunspin.philae.candidates import Chain
from sunspin.philae.row import Row
from sunspin.telemetry.case import Case


@dataclass(frozen=True)
class Landing:
    """The results of both sections."""

    chain: Chain
    collision: collision.AfterCollision
    strategies: strategies.Strategies


def compute(
    case: Case, chain: Chain, *, n: int = 100_000, seed: int = 0, **options: Any
) -> Landing:
    """Run both sections.

    Parameters
    ----------
    chain : Chain
        Candidates, box and recipe.
    n : int
        Runs of Fig. 13 and of the collision for the chosen candidates, half as many for the others; strategies get a fifth, each
        delay a tenth.
    options
        workers, progress, executor.
    """
    return Landing(
        chain,
        collision.compute(case, chain, n, seed, **options),
        strategies.compute(case, chain, max(n // 5, 1), seed, **options),
    )


def rows(landing: Landing) -> list[Row]:
    """Published figures of sections 3.3 and 4 beside ours."""
    return [*collision.rows(landing.collision), *strategies.rows(landing.strategies)]
