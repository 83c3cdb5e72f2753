"""Collisions weighted by the trajectory kernel, in numbers, in words and as a figure."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError, sentence
from sunspin.output.kinds.kind import Drawing
from sunspin.philae.collision import KERNEL, condition, kernel_facts
from sunspin.philae.figures.collision import collision_figure
from sunspin.telemetry.case import case_names, load_case


def against_kernel(case_name: str, runs: xr.Dataset, data: Path | None) -> tuple[dict[str, Any], list[str], list[Drawing]]:
    """The simulated collisions `runs` against the kernel in the folder `data`, or against the facts that come with the case.

    Raises
    ------
    InputError
        No such kernel is known for the case, or the runs have no collision.
    """
    case = load_case(case_name) if case_name in case_names() else None
    if case is None or "kernel_speed_before" not in case.published or not np.isfinite(runs["speed_after"]).any():
        raise InputError(sentence("--condition needs collisions of a case with a trajectory kernel", do="use it with philae"))
    there = data if data is not None and data.joinpath(*KERNEL).is_file() else None
    found = condition(case, runs, None if there is None else kernel_facts(case, there))
    head = f"collision: {found.explained} of the runs come near the kernel's jump and speed"
    lines = [
        f"  {line['name']}: worth {line['effective_runs']:.0f} runs, rate before {line['rate_before']}, after {line['rate_after']} "
        f"rad/s, median period after {line['median_period_after']:.1f} s"
        for line in found.table
    ]
    drawing = Drawing(
        "collision", lambda: collision_figure(found), "Simulated collisions against the speeds of the trajectory kernel.",
        "Simulated collisions and what the trajectory shows; angular speeds after it as drawn and weighted by the kernel's speeds.",
    )  # fmt: skip
    return {"collision": {"facts": found.facts, "explained": found.explained, "table": found.table}}, [head, *lines], [drawing]
