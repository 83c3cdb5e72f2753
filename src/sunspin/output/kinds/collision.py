"""Simulated collisions weighted by what a trajectory shows of the true one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from sunspin.landing.weighted import explained, facts_of, weightings
from sunspin.output.kind import Context, Drawing, Summary


def collision_summary(found: Any) -> Summary:
    """How many collisions come near the trajectory's speeds, and rates and periods under each weighting."""
    table = weightings(found)
    lines = [
        f"  {line['name']}: worth {line['effective_runs']:.0f} runs, rate before {line['rate_before']}, after {line['rate_after']} "
        f"rad/s, median period after {line['median_period_after']:.1f} s"
        for line in table
    ]
    numbers = {"facts": facts_of(found), "explained": explained(found), "table": table}
    return Summary(
        numbers,
        [
            f"collision: {explained(found)} of the runs come near the kernel's jump and speed",
            *lines,
        ],
    )


def collision_drawings(found: Any, _: Context) -> Iterator[Drawing]:
    from sunspin.output.figures.collision import collision_figure

    yield Drawing(
        "collision",
        lambda: collision_figure(found),
        "Simulated collisions against the speeds of the trajectory kernel.",
        "Simulated collisions and what the trajectory shows; angular speeds after it as drawn and weighted by the kernel's speeds.",
    )
